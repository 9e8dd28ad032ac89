//! Scratch of the sweeps.

use super::body::SweepBody;
use super::model::SweepModel;
use crate::algorithm::Algorithm;
use crate::filter::Form;
use crate::filter::cancellation::weight;
use crate::filter::pivots::Scale;
use crate::filter::riccati::Measured;
use crate::filter::tolerance::Tolerance;
use crate::model::{Body, Model};
use crate::scalar::Real;
use crate::spatial::transform::{AxialRotation, ConstantRotation};
use crate::spatial::{BodyInertia, BodyRoot, RigidShift, Root6, Symmetric3};
use nalgebra::{Vector3, Vector6};

/// Angular velocity, angular acceleration and acceleration of the origin (kept for shifts only).
pub(in crate::dynamics) type Moving<T> = [[T; 3]; 3];

/// Of one body, read again by its own later steps only.
#[derive(Debug, Clone, Copy)]
pub(in crate::dynamics) struct BodyState<T> {
    /// Of a body on a revolute joint.
    pub turn: AxialRotation<T>,
    /// Of a body on a revolute joint until its step outward, the acceleration of its origin in its parent's frame, in the first three. Then b(k), or its coordinates
    /// in the body's root; then z(k) in inverse dynamics, and z^+(k) where the digits are watched.
    pub force: [T; 6],
}

/// What the bodies that hang on one send to it: its own noise and force are added when it is its turn.
#[derive(Debug, Clone, Copy)]
pub(in crate::dynamics) struct Arriving<T> {
    /// 6 + 9 + 6 numbers of the covariance: angular, coupling by rows, linear.
    pub p: [T; 21],
    /// The bounds on their terms, where they follow it.
    pub scale: Scale<T>,
    pub force: [T; 6],
}

impl<T: Real> Arriving<T> {
    fn filled(value: T) -> Self {
        Self { p: [value; 21], scale: Scale::filled(value), force: [value; 6] }
    }
}

/// What the watch sends to a body.
#[derive(Debug, Clone, Copy)]
pub(in crate::dynamics) struct ProbeArriving<T> {
    /// Bounds on the terms of the diagonal of P^-.
    pub terms: [T; 6],
    /// The force of the second right side.
    pub zeta: [T; 6],
}

/// What the watch has of a body.
#[derive(Debug, Clone, Copy)]
pub(in crate::dynamics) struct Watched<T> {
    /// Bounds on the terms of the diagonal of P^-.
    pub terms: [T; 6],
    /// b(k).
    pub bias: [T; 6],
    /// Of zeta^+, the squares of its halves.
    pub zeta: (T, T),
    /// The co-state of the probe, where the factor of M is watched.
    pub nu: [T; 6],
}

/// A body with some of what hangs on it: the root of P, and z = L y + t.
#[derive(Debug, Clone, Copy)]
pub(in crate::dynamics) struct Rooted<T> {
    pub root: Root6<T>,
    pub y: [T; 6],
    pub t: [T; 6],
    /// The bounds on the terms of P.
    pub scale: Scale<T>,
}

impl<T: Real> Rooted<T> {
    pub fn filled(value: T) -> Self {
        Self { root: Root6::filled(value), y: [value; 6], t: [value; 6], scale: Scale::filled(value) }
    }
}

/// What the watch has: a second right side, and the bounds.
#[derive(Debug)]
pub(in crate::dynamics) struct Watching<T> {
    /// w of each row.
    pub probe: Vec<T>,
    /// Another one: for a second look, and for where there is no right side.
    pub other_probe: Vec<T>,
    /// Innovations of w.
    pub innovations: Vec<T>,
    /// In slots, inward; the first is always zero.
    pub arriving: Vec<ProbeArriving<T>>,
    /// Of each body.
    pub own: Vec<Watched<T>>,
    /// lambda^- and nu, in slots, outward; the first, of the base, is zero.
    pub co_states: Vec<[[T; 6]; 2]>,
}

/// One for each thread; starts as NaN.
#[derive(Debug)]
pub(crate) struct SweepScratch<T: Real> {
    /// Of each body.
    pub(in crate::dynamics) own: Vec<BodyState<T>>,
    /// Of those that are not on a revolute joint.
    pub(in crate::dynamics) shifts: Vec<RigidShift<T>>,
    /// In slots, outward.
    pub(in crate::dynamics) motions: Vec<Moving<T>>,
    /// In slots, inward; the first, of a body that nothing hangs on, is always zero.
    pub(in crate::dynamics) arriving: Vec<Arriving<T>>,
    /// The same of M.
    pub(in crate::dynamics) composites: Vec<BodyInertia<T>>,
    /// D and g of each row.
    pub(in crate::dynamics) measured: Vec<Measured<T>>,
    /// In slots, outward.
    pub(in crate::dynamics) co_states: Vec<[T; 6]>,
    pub(in crate::dynamics) watching: Watching<T>,
    /// Of b(k), what is not in its coordinates.
    pub(in crate::dynamics) added: Vec<[T; 6]>,
    /// In slots, inward: what the square-root form has of a body before its measurements; the first is any leaf's while it is its turn.
    pub(in crate::dynamics) rooted: Vec<Rooted<T>>,
    /// The square of the largest estimated error that form `auto` accepts, relative to the largest entry, in units of eps^2.
    pub(crate) accepted_square: T,
    /// The same of products with derivatives, in units of eps, and not squared.
    pub(crate) accepted_of_products: T,
    /// Number of rows on the longest path from the base.
    longest_path: usize,
}

impl<T: Real> SweepScratch<T> {
    pub fn new(model: &Model<T>, sweeps: &SweepModel<T>) -> Self {
        let nan = T::from_f64(f64::NAN);
        let (bodies, nv) = (sweeps.bodies.len(), model.nv());
        // The base has no co-state, and what its motion is each call says.
        let mut co_states = vec![[nan; 6]; sweeps.swept_slots.outward];
        co_states[0] = [T::zero(); 6];
        let mut watched = vec![[[nan; 6]; 2]; sweeps.swept_slots.outward];
        watched[0] = [[T::zero(); 6]; 2];
        // Nothing arrives at a body that nothing hangs on.
        let mut arriving = vec![Arriving::filled(nan); sweeps.swept_slots.inward];
        arriving[0] = Arriving::filled(T::zero());
        let besides = |value| ProbeArriving { terms: [value; 6], zeta: [value; 6] };
        let mut arriving_besides = vec![besides(nan); sweeps.swept_slots.inward];
        arriving_besides[0] = besides(T::zero());
        let composite = |value| BodyInertia {
            mass: value,
            first_moment: Vector3::from_element(value),
            rotational: Symmetric3::new([value; 6]),
        };
        let mut composites = vec![composite(nan); sweeps.swept_slots.inward];
        composites[0] = composite(T::zero());
        Self {
            own: vec![BodyState { turn: AxialRotation { s: nan, c: nan }, force: [nan; 6] }; bodies],
            shifts: vec![RigidShift::filled(nan); sweeps.shifting.len()],
            motions: vec![[[nan; 3]; 3]; sweeps.swept_slots.outward],
            arriving,
            composites,
            measured: vec![Measured::filled(nan); nv],
            watching: Watching {
                probe: (0..nv).map(|row| T::from_f64(weight(row))).collect(),
                other_probe: (nv..2 * nv).map(|row| T::from_f64(weight(row))).collect(),
                innovations: vec![nan; nv],
                arriving: arriving_besides,
                own: vec![Watched { terms: [nan; 6], bias: [nan; 6], zeta: (nan, nan), nu: [nan; 6] }; bodies],
                co_states: watched,
            },
            co_states,
            added: vec![[nan; 6]; bodies],
            rooted: vec![Rooted::filled(nan); sweeps.swept_slots.inward],
            accepted_square: nan,
            accepted_of_products: nan,
            longest_path: sweeps.longest_path,
        }
        .accepting(None)
    }

    /// The same, to accept estimated errors up to this tolerance, relative to the largest entry; None: the usual one.
    pub(crate) fn accepting(mut self, tolerance: Option<f64>) -> Self {
        let [square, of_products] = self.accepted(tolerance);
        self.accepted_square = T::from_f64(square);
        self.accepted_of_products = T::from_f64(of_products);
        self
    }

    /// The accepted errors with this tolerance: the square in units of eps^2, and that of products in units of eps.
    pub(crate) fn accepted(&self, given: Option<f64>) -> [f64; 2] {
        let (tolerance, epsilon) = (Tolerance { given, rows: self.longest_path }, T::epsilon().lane(0));
        [(tolerance.of_covariance(epsilon) / epsilon).powi(2), tolerance.of_products() / epsilon]
    }
}

impl<T: Real> SweepScratch<T> {
    /// 1 / D of a row, of the factor that is there.
    #[inline(always)]
    pub(crate) fn pivot_inverse(&self, row: usize) -> T {
        self.measured[row].pivot_inverse
    }

    /// The co-state of the probe of the body at a place, after the factor of M was watched.
    #[inline(always)]
    pub(in crate::dynamics) fn probe_co_state(&self, place: usize) -> [T; 6] {
        self.watching.own[place].nu
    }

    /// Takes the co-states of a probe that another recursion watched the factor of M with, by places.
    pub(in crate::dynamics) fn take_probe(&mut self, nu: &[Vector6<T>]) {
        for (own, nu) in self.watching.own.iter_mut().zip(nu) {
            own.nu = (*nu).into();
        }
    }

    /// The other probe in the place of the first, for a second look.
    #[inline(always)]
    pub(crate) fn exchange_probes(&mut self) {
        let Watching { probe, other_probe, .. } = &mut self.watching;
        std::mem::swap(probe, other_probe);
    }
}

/// Bytes that an algorithm reads or writes in f64, arguments and results not counted: constants of the scene, which all lanes share, and what there is of
/// each state.
pub(crate) fn bytes(sweeps: &SweepModel<f64>, nv: usize, algorithm: Algorithm) -> [usize; 2] {
    let bodies = sweeps.bodies.len();
    let shifts = sweeps.shifting.len() * (size_of::<RigidShift<f64>>() + size_of::<Body<f64>>())
        + sweeps.constant_rotations.len() * size_of::<ConstantRotation<f64>>();
    let turns = bodies * size_of::<AxialRotation<f64>>();
    let root = if algorithm == Algorithm::ForwardDynamics(Form::SquareRoot) { size_of::<BodyRoot<f64>>() } else { 0 };
    let constants = size_of::<SweepBody<f64>>() + root;
    let model = bodies * constants;
    let noise = nv * size_of::<f64>();
    let motions = sweeps.swept_slots.outward * size_of::<Moving<f64>>() + bodies * size_of::<[f64; 6]>();
    let filter = sweeps.swept_slots.inward * size_of::<Arriving<f64>>() + nv * size_of::<Measured<f64>>();
    // Two numbers a row; bounds and squares of a body; and what arrives inward and outward.
    let watching = nv * 2 * size_of::<f64>()
        + bodies * size_of::<Watched<f64>>()
        + sweeps.swept_slots.inward * size_of::<ProbeArriving<f64>>()
        + sweeps.swept_slots.outward * size_of::<[[f64; 6]; 2]>();
    let product = sweeps.swept_slots.outward * sweeps.longest_path * size_of::<[f64; 6]>() + nv * nv * size_of::<f64>();
    let swept = match algorithm {
        Algorithm::InverseDynamics | Algorithm::BiasTorque => motions,
        Algorithm::MassMatrix => sweeps.swept_slots.inward * size_of::<BodyInertia<f64>>() + nv * size_of::<[f64; 6]>(),
        Algorithm::ForwardDynamics(Form::Auto) | Algorithm::ConstrainedDynamics(Form::Auto) => {
            motions + filter + watching
        }
        Algorithm::ForwardDynamics(Form::SquareRoot) => {
            let of_bodies = bodies * size_of::<[f64; 6]>();
            let slots = sweeps.swept_slots.inward * size_of::<Rooted<f64>>()
                + sweeps.swept_slots.outward * size_of::<[f64; 6]>();
            motions + of_bodies + slots + nv * size_of::<Measured<f64>>()
        }
        Algorithm::ForwardDynamics(_) | Algorithm::ConstrainedDynamics(_) => {
            motions + filter + sweeps.swept_slots.outward * size_of::<[f64; 6]>()
        }
        // And a right side that is made up, with its forces.
        Algorithm::MassMatrixInverse(Form::Auto) => {
            filter + watching + product + nv * size_of::<f64>() + bodies * size_of::<[f64; 6]>()
        }
        Algorithm::MassMatrixInverse(_) => filter + product,
        // What goes outward and inward beside the dynamics: of each body, and of each state.
        Algorithm::Products(which) => {
            let factor = if which.form().is_some() { filter } else { 0 };
            motions + factor + bodies * size_of::<[[f64; 6]; 6]>() + nv * size_of::<[f64; 5]>()
        }
        // The three matrices and their columns; what else there is is small beside it.
        Algorithm::Derivatives(_) => motions + filter + product + 3 * nv * nv * size_of::<f64>(),
    };
    [model, noise + shifts + turns + swept]
}
