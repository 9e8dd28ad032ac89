//! Scratch of the lean sweeps.

use super::aligned::AlignedBody;
use super::body::{LeanBody, LeanModel};
use super::turn::Turn;
use crate::batch::chunk::Algorithm;
use crate::filter::Form;
use crate::filter::cancellation::weight;
use crate::filter::pivots::Scale;
use crate::filter::riccati::Measured;
use crate::scalar::Real;
use crate::scene::Model;
use crate::spatial::RigidShift;
use nalgebra::Vector6;

/// Angular velocity, angular acceleration and acceleration of the origin, four numbers each, the last unused.
pub(super) type Moving<T> = [[T; 4]; 3];

/// A motion or a force, angular half first, four numbers each, the last unused.
pub(super) type Halves<T> = [[T; 4]; 2];

/// A covariance on its way inward: 6 + 9 + 6 numbers (angular, coupling by rows, linear), and the bounds on their terms.
#[derive(Debug, Clone, Copy)]
pub(super) struct Covariance<T> {
    pub p: [T; 21],
    pub scale: Scale<T>,
}

/// First moment and rotational inertia of a body with all outboard of it; their mass is a constant.
#[derive(Debug, Clone, Copy)]
pub(super) struct Composite<T> {
    pub first_moment: [T; 3],
    pub rotational: [T; 6],
}

/// What the watch keeps besides: a second right side, and the bounds.
#[derive(Debug)]
pub(super) struct Watching<T> {
    /// w of each row.
    pub weights: Vec<T>,
    /// Others, for where there is no right side.
    pub others: Vec<T>,
    /// Innovations of w.
    pub innovations: Vec<T>,
    /// zeta^+ of each body.
    pub zeta: Vec<[T; 6]>,
    /// Bounds on the terms of the diagonal of P^-.
    pub terms: Vec<Vector6<T>>,
    /// lambda^- and nu of the base, zero, and of each body.
    pub co_states: Vec<[Vector6<T>; 2]>,
}

/// One for each thread; starts as NaN.
#[derive(Debug)]
pub(crate) struct LeanScratch<T: Real> {
    /// Of bodies on a turn.
    pub(super) turns: Vec<Turn<T>>,
    /// Of the others.
    pub(super) shifts: Vec<RigidShift<T>>,
    /// In slots, outward.
    pub(super) motions: Vec<Moving<T>>,
    /// b(k), then z^+(k).
    pub(super) forces: Vec<[T; 6]>,
    /// In slots, inward.
    pub(super) covariances: Vec<Covariance<T>>,
    /// In slots, inward.
    pub(super) composites: Vec<Composite<T>>,
    /// D and g of each row.
    pub(super) measured: Vec<Measured<T>>,
    /// In slots, outward.
    pub(super) co_states: Vec<Halves<T>>,
    pub(super) watching: Watching<T>,
    /// Lambda^- of each body.
    pub(super) co_covariances: Vec<[T; 21]>,
    /// Lambda^+ g of each row.
    pub(super) spread_gains: Vec<Vector6<T>>,
}

impl<T: Real> LeanScratch<T> {
    pub fn new(model: &Model<T>, lean: &LeanModel<T>) -> Self {
        let nan = T::from_f64(f64::NAN);
        let (bodies, nv) = (lean.bodies.len(), model.nv());
        // The base has no co-state, and what its motion is each call says.
        let mut co_states = vec![[[nan; 4]; 2]; lean.outward_slots];
        co_states[0] = [[T::zero(); 4]; 2];
        let mut watched = vec![[Vector6::from_element(nan); 2]; bodies + 1];
        watched[0] = [Vector6::from_element(T::zero()); 2];
        Self {
            turns: vec![Turn { s: nan, c: nan }; bodies],
            shifts: vec![RigidShift::filled(nan); lean.shifts],
            motions: vec![[[nan; 4]; 3]; lean.outward_slots],
            forces: vec![[nan; 6]; bodies],
            covariances: vec![Covariance { p: [nan; 21], scale: Scale::filled(nan) }; lean.inward_slots],
            composites: vec![Composite { first_moment: [nan; 3], rotational: [nan; 6] }; lean.inward_slots],
            measured: vec![Measured::filled(nan); nv],
            watching: Watching {
                weights: (0..nv).map(|row| T::from_f64(weight(row))).collect(),
                others: (nv..2 * nv).map(|row| T::from_f64(weight(row))).collect(),
                innovations: vec![nan; nv],
                zeta: vec![[nan; 6]; bodies],
                terms: vec![Vector6::from_element(nan); bodies],
                co_states: watched,
            },
            co_states,
            co_covariances: vec![[nan; 21]; bodies],
            spread_gains: vec![Vector6::from_element(nan); nv],
        }
    }
}

/// Bytes of model and scratch that an algorithm reads or writes for one state in f64, arguments and results not counted.
pub(crate) fn bytes(lean: &LeanModel<f64>, nv: usize, algorithm: Algorithm) -> usize {
    let bodies = lean.bodies.len();
    let shifts = lean.shifts * size_of::<RigidShift<f64>>();
    let turns = (bodies - lean.shifts) * size_of::<Turn<f64>>();
    // The noise of each row, too.
    let model = bodies * size_of::<LeanBody<f64>>() + nv * size_of::<f64>();
    let motions = lean.outward_slots * size_of::<Moving<f64>>() + bodies * size_of::<[f64; 6]>();
    let filter = lean.inward_slots * size_of::<Covariance<f64>>() + nv * size_of::<Measured<f64>>();
    // Three numbers a row; a force, bounds and two co-states a body.
    let watching = nv * 3 * size_of::<f64>() + bodies * 4 * size_of::<Vector6<f64>>();
    let columns = lean.outward_slots * nv * size_of::<[f64; 6]>();
    let closed_form = columns
        + if lean.is_shallow {
            nv * nv * size_of::<f64>()
        } else {
            bodies * size_of::<[f64; 21]>() + nv * size_of::<Vector6<f64>>()
        };
    let swept = match algorithm {
        Algorithm::InverseDynamics | Algorithm::BiasTorque => motions,
        Algorithm::MassMatrix => {
            let aligned = bodies * size_of::<AlignedBody<f64>>();
            aligned + lean.inward_slots * size_of::<Composite<f64>>() + nv * size_of::<[f64; 6]>()
        }
        Algorithm::ForwardDynamics(Form::Auto) => motions + filter + watching,
        Algorithm::ForwardDynamics(_) => motions + filter + lean.outward_slots * size_of::<Halves<f64>>(),
        Algorithm::MassMatrixInverse(Form::Auto) => filter + watching + closed_form,
        Algorithm::MassMatrixInverse(_) => filter + closed_form,
    };
    model + shifts + turns + swept
}
