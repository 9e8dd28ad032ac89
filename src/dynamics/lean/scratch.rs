//! Scratch of the lean sweeps.

use super::body::LeanModel;
use super::turn::Turn;
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
    /// Bounds on the terms of P^-.
    pub scale: Vec<Scale<T>>,
    /// The diagonal of P^+ of each body.
    pub kept: Vec<Vector6<T>>,
    /// lambda^- and nu of each body.
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
                scale: vec![Scale::filled(nan); bodies],
                kept: vec![Vector6::from_element(nan); bodies],
                co_states: vec![[Vector6::from_element(nan); 2]; bodies],
            },
            co_states,
            co_covariances: vec![[nan; 21]; bodies],
            spread_gains: vec![Vector6::from_element(nan); nv],
        }
    }
}
