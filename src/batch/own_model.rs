//! The models of states in lanes, for batches whose states differ in inertia or armature.

use super::instruction_set::{Vectorized, in_lanes, within_target};
use crate::algorithm::Arguments;
use crate::dynamics::sweeps::{AxisPermutation, SweepModel};
use crate::model::Model;
use crate::scalar::{MOST_LANES, lanes_but};
use crate::scene::Scene;
use crate::spatial::BodyInertia;
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
    /// In the frames of the passes, or in those of the model.
    #[cold]
    pub fn new(InertiaPlaces(places): &InertiaPlaces, sweeps: Option<&SweepModel<T>>) -> Self {
        let turn = |(body, rotation): &(usize, Matrix3<f64>)| {
            let frame = sweeps.map_or(*rotation, |sweeps| sweeps.frame(*body).after(T::zero(), rotation));
            (*body, Turn::of(&frame))
        };
        Self { links: places.iter().map(turn).collect(), parameters: vec![T::zero(); 10 * places.len()] }
    }

    /// Passes the inertias of the states to `set`, with the index of the body. Returns zero in the lanes in which they
    /// are finite and no mass and no moment of inertia is negative, else NaN.
    #[inline(always)]
    pub fn load<'a>(&mut self, of: impl Fn(usize) -> &'a [f64], mut set: impl FnMut(usize, BodyInertia<T>)) -> T {
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
            set(*body, inertia);
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
pub(crate) struct OwnModel<T: Vectorized> {
    pub model: Model<T>,
    pub sweeps: SweepModel<T>,
    inertias: OwnInertias<T>,
    /// True if the inertias are those of states.
    differs: bool,
}

impl<T: Vectorized> OwnModel<T> {
    #[cold]
    pub fn new(places: &InertiaPlaces, model: &Model<T>, sweeps: &SweepModel<T>) -> Self {
        let inertias = OwnInertias::new(places, Some(sweeps));
        Self { model: model.clone(), sweeps: sweeps.clone(), inertias, differs: false }
    }
}

/// The model of the states of a chunk in the frames of the scene, for kinematic quantities.
#[derive(Debug)]
pub(super) struct OwnBodies<T: Vectorized> {
    pub model: Model<T>,
    inertias: OwnInertias<T>,
}

impl<T: Vectorized> OwnBodies<T> {
    #[cold]
    pub fn new(places: &InertiaPlaces, model: &Model<T>) -> Self {
        Self { model: model.clone(), inertias: OwnInertias::new(places, None) }
    }

    /// Loads the models of the states; returns zero in the lanes whose numbers are valid, else NaN.
    #[inline(always)]
    pub fn load(&mut self, scene: &Model<T>, states: &[&Arguments<'_>; MOST_LANES]) -> T {
        let Model { bodies, system, .. } = &mut self.model;
        let fault = load_armature(&mut system.noise, &scene.system.noise, states);
        if states[0].model.inertias.is_empty() {
            for (own, body) in bodies.iter_mut().zip(&scene.bodies) {
                own.inertia = body.inertia;
            }
            return fault;
        }
        fault + self.inertias.load(|lane| states[lane].model.inertias, |body, inertia| bodies[body].inertia = inertia)
    }
}

/// True if the states have their own models; None if they differ in what these contain.
#[inline]
pub(crate) fn have_models(states: &[Arguments<'_>]) -> Option<bool> {
    let lengths = |state: &Arguments<'_>| [state.model.inertias.len(), state.model.armature.len()];
    let first = lengths(&states[0]);
    states.iter().all(|state| lengths(state) == first).then_some(first != [0; 2])
}

/// Loads the armature of the states, or that of the scene; returns zero in the lanes in which it is valid, else NaN.
#[inline(always)]
fn load_armature<T: Vectorized>(noise: &mut [T], scene: &[T], states: &[&Arguments<'_>; MOST_LANES]) -> T {
    if states[0].model.armature.is_empty() {
        noise.copy_from_slice(scene);
        return T::zero();
    }
    let fault = T::take_lanes(noise, |lane| states[lane].model.armature);
    noise.iter().fold(fault, |fault, armature| fault + fault_below_zero(*armature))
}

within_target! {
    /// Loads the models of the states; returns the lanes whose numbers are invalid.
    pub(crate) fn load<'a, T>(
        own: &'a mut OwnModel<T>,
        scene: (&'a Model<T>, &'a SweepModel<T>),
        states: &'a [Arguments<'a>],
    ) -> u64 {
        let states = &in_lanes(states);
        let OwnModel { model, sweeps, inertias, differs } = own;
        let mut fault = T::zero();
        if !states[0].model.inertias.is_empty() {
            fault += inertias
                .load(|lane| states[lane].model.inertias, |body, inertia| sweeps.set_inertia(body, &inertia));
            *differs = true;
        } else if *differs {
            sweeps.copy_inertias(scene.1);
            *differs = false;
        }
        fault += load_armature(&mut model.system.noise, &scene.0.system.noise, states);
        model.system.noise.iter_mut().for_each(replace_zeros);
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
