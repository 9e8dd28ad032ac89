//! The models of states in lanes, for batches whose states differ in inertia or armature.

use super::instruction_set::{Vectorized, within_target};
use crate::algorithm::Arguments;
use crate::dynamics::sweeps::{AxisPermutation, SweepModel};
use crate::model::Model;
use crate::scalar::{MOST_LANES, lanes_but};
use crate::scene::Scene;
use crate::spatial::inertial_parameters::inertia;
use nalgebra::Matrix3;

/// Noise in place of zero in a row that has noise in other lanes. It does not change the digits of a pivot, and its
/// sign makes the pivot of a joint without inertia singular.
pub(crate) const FREE: f64 = -1e-200;

/// The body of each joint, and the rotation from the frame of its link to that of the body in the model, which has the
/// same origin. Bodies without a link have no inertia.
#[derive(Debug, Clone)]
pub(crate) struct InertiaPlaces(Vec<(usize, Matrix3<f64>)>);

impl InertiaPlaces {
    pub fn new(scene: &Scene) -> Self {
        Self(scene.links_of_joints().map(|(body, placement)| (body, placement.rotation)).collect())
    }
}

/// A rotation in lanes.
#[derive(Debug)]
enum Turn<T: Vectorized> {
    Permuted(AxisPermutation<T::Parameter>),
    Turned(Matrix3<T>),
}

impl<T: Vectorized> Turn<T> {
    fn of(rotation: &Matrix3<f64>) -> Self {
        let nearest = rotation.map(f64::round);
        if (rotation - nearest).amax() <= 4.0 * f64::EPSILON {
            Self::Permuted(AxisPermutation::of(&nearest, T::parameter))
        } else {
            Self::Turned(rotation.map(T::from_f64))
        }
    }
}

/// The inertias of states in lanes, from their parameters in the frames of the links.
#[derive(Debug)]
pub(crate) struct OwnInertias<T: Vectorized> {
    links: Vec<(usize, Turn<T>)>,
    parameters: Vec<T>,
}

impl<T: Vectorized> OwnInertias<T> {
    #[cold]
    pub fn new(InertiaPlaces(places): &InertiaPlaces, sweeps: &SweepModel<T>) -> Self {
        let turn = |body: usize, rotation| Turn::of(&sweeps.frame(body).after(T::zero(), rotation));
        let links: Vec<_> = places.iter().map(|(body, rotation)| (*body, turn(*body, rotation))).collect();
        Self { parameters: vec![T::zero(); 10 * links.len()], links }
    }

    /// Loads the inertias of the states. Returns zero in the lanes in which they are finite and no mass and no moment
    /// of inertia is negative, else NaN.
    #[inline(always)]
    pub fn load<'a>(&mut self, sweeps: &mut SweepModel<T>, of: impl Fn(usize) -> &'a [f64]) -> T {
        let Self { links, parameters } = self;
        let fault = T::take_lanes(parameters, of);
        let mut least = T::one();
        for ((body, turn), parameters) in links.iter().zip(parameters.as_chunks::<10>().0) {
            let [mass, _, _, _, xx, _, yy, _, _, zz] = *parameters;
            least = least.worst(mass).worst(xx).worst(yy).worst(zz);
            let inertia = match turn {
                Turn::Permuted(frame) => inertia(&frame.parameters(parameters)),
                Turn::Turned(rotation) => inertia(parameters).rotated(rotation),
            };
            sweeps.set_inertia(*body, &inertia);
        }
        fault + fault_below_zero(least)
    }
}

/// Zero, or NaN in the lanes that are negative.
#[inline(always)]
fn fault_below_zero<T: Vectorized>(mut least: T) -> T {
    for lane in least.lanes_mut() {
        *lane = if *lane >= 0.0 { 0.0 } else { f64::NAN };
    }
    least
}

/// The model of the states of a chunk.
#[derive(Debug)]
pub(super) struct OwnModel<T: Vectorized> {
    pub model: Model<T>,
    pub sweeps: SweepModel<T>,
    inertias: OwnInertias<T>,
    /// True if the inertias are those of states.
    differs: bool,
}

impl<T: Vectorized> OwnModel<T> {
    #[cold]
    pub fn new(places: &InertiaPlaces, model: &Model<T>, sweeps: &SweepModel<T>) -> Self {
        let inertias = OwnInertias::new(places, sweeps);
        Self { model: model.clone(), sweeps: sweeps.clone(), inertias, differs: false }
    }
}

within_target! {
    /// Loads the models of the states; returns the lanes whose numbers are invalid.
    pub(super) fn load<'a, T>(
        own: &'a mut OwnModel<T>,
        scene: (&'a Model<T>, &'a SweepModel<T>),
        states: &'a [&'a Arguments<'a>; MOST_LANES],
    ) -> u64 {
        let OwnModel { model, sweeps, inertias, differs } = own;
        let mut fault = T::zero();
        if !states[0].model.inertias.is_empty() {
            fault += inertias.load(sweeps, |lane| states[lane].model.inertias);
            *differs = true;
        } else if *differs {
            sweeps.copy_inertias(scene.1);
            *differs = false;
        }
        if states[0].model.armature.is_empty() {
            model.system.noise.copy_from_slice(&scene.0.system.noise);
        } else {
            fault += T::take_lanes(&mut model.system.noise, |lane| states[lane].model.armature);
            for noise in &mut model.system.noise {
                fault += fault_below_zero(*noise);
                replace_zeros(noise);
            }
        }
        lanes_but::<T>(|lane| fault.lane(lane) == 0.0)
    }
}

/// Replaces zeros by [`FREE`] if some lanes have noise.
#[inline(always)]
pub(crate) fn replace_zeros<T: Vectorized>(noise: &mut T) {
    let lanes = noise.lanes_mut();
    let mut most = 0.0;
    for &lane in &*lanes {
        most = if lane == 0.0 { most } else { lane };
    }
    for lane in lanes {
        *lane = if most != 0.0 && *lane == 0.0 { FREE } else { *lane };
    }
}
