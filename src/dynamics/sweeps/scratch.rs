//! Scratch of the sweeps sweeps.

use super::axial_rotation::AxialRotation;
use super::body::{CompositeBody, SweepBody};
use super::constant_rotation::ConstantRotation;
use super::model::SweepModel;
use super::segment::Segment;
use crate::algorithm::Algorithm;
use crate::filter::Form;
use crate::filter::cancellation::weight;
use crate::filter::pivots::Scale;
use crate::filter::riccati::Measured;
use crate::model::{Body, Model};
use crate::scalar::Real;
use crate::spatial::{BodyRoot, RigidShift, Root6};

/// Angular velocity, angular acceleration and acceleration of the origin (kept for shifts only).
pub(super) type Moving<T> = [[T; 3]; 3];

/// Of one body, read again by its own later steps only.
#[derive(Debug, Clone, Copy)]
pub(super) struct BodyState<T> {
    /// Of a body on a revolute joint.
    pub turn: AxialRotation<T>,
    /// Of a body on a revolute joint until its step outward, the acceleration of its origin in its parent's frame, in the first three. Then b(k), or its coordinates
    /// in the body's root; then z(k) in inverse dynamics, and z^+(k) where the digits are watched.
    pub force: [T; 6],
}

/// lambda, in two parts: those who read it have the larger one at hand while the estimate is still on its way.
#[derive(Debug, Clone, Copy)]
pub(super) struct CoState<T> {
    /// What was carried here from the base.
    pub carried: [T; 6],
    /// Of a revolute joint, what its own measurement adds along z.
    pub estimate: T,
}

impl<T: Real> CoState<T> {
    /// Of a body whose measurements are in it.
    #[inline(always)]
    pub fn of(lambda: [T; 6]) -> Self {
        Self { carried: lambda, estimate: lambda[0].constant(0.0) }
    }

    /// Both.
    #[inline(always)]
    pub fn whole(&self) -> [T; 6] {
        let mut lambda = self.carried;
        lambda[2] += self.estimate;
        lambda
    }
}

/// What the bodies that hang on one send to it: its own noise and force are added when it is its turn.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arriving<T> {
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
pub(super) struct ProbeArriving<T> {
    /// Bounds on the terms of the diagonal of P^-.
    pub terms: [T; 6],
    /// The force of the second right side.
    pub zeta: [T; 6],
}

/// What the watch has of a body.
#[derive(Debug, Clone, Copy)]
pub(super) struct Watched<T> {
    /// Bounds on the terms of the diagonal of P^-.
    pub terms: [T; 6],
    /// b(k).
    pub bias: [T; 6],
    /// Of zeta^+, the squares of its halves.
    pub zeta: (T, T),
}

/// Adds what one body sends to what is there already, or begins with it.
#[inline(always)]
pub(super) fn accumulate<T: Real, const N: usize>(body: &SweepBody<T::Parameter>, sent: &[T; N], to: &mut [T; N]) {
    if body.places.arrives_first {
        put(sent, to);
    } else {
        for (to, &sent) in to.iter_mut().zip(sent) {
            *to += sent;
        }
    }
}

/// A copy, number by number where there are many: that of the whole would read at once what was just written in parts, and wait for it.
#[inline(always)]
fn put<T: Copy, const N: usize>(sent: &[T; N], to: &mut [T; N]) {
    if let (Some(sent), Some(to)) = (sent.first_chunk::<21>(), to.first_chunk_mut::<21>()) {
        let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *sent;
        (to[0], to[1], to[2], to[3], to[4], to[5], to[6]) = (a0, a1, a2, a3, a4, a5, c0);
        (to[7], to[8], to[9], to[10], to[11], to[12], to[13]) = (c1, c2, c3, c4, c5, c6, c7);
        (to[14], to[15], to[16], to[17], to[18], to[19], to[20]) = (c8, b0, b1, b2, b3, b4, b5);
    } else {
        *to = *sent;
    }
}

/// A body with some of what hangs on it: the root of P, and z = L y + t.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rooted<T> {
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

/// First moment and rotational inertia of a body with all outboard of it; their mass is a constant.
#[derive(Debug, Clone, Copy)]
pub(super) struct Composite<T> {
    pub first_moment: [T; 3],
    pub rotational: [T; 6],
}

/// What the watch has: a second right side, and the bounds.
#[derive(Debug)]
pub(super) struct Watching<T> {
    /// w of each row.
    pub weights: Vec<T>,
    /// Others, for where there is no right side.
    pub others: Vec<T>,
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
    pub(super) own: Vec<BodyState<T>>,
    /// Of those that are not on a revolute joint.
    pub(super) shifts: Vec<RigidShift<T>>,
    /// In slots, outward.
    pub(super) motions: Vec<Moving<T>>,
    /// In slots, inward; the first, of a body that nothing hangs on, is always zero.
    pub(super) arriving: Vec<Arriving<T>>,
    /// The same of M.
    pub(super) composites: Vec<Composite<T>>,
    /// D and g of each row.
    pub(super) measured: Vec<Measured<T>>,
    /// In slots, outward.
    pub(super) co_states: Vec<CoState<T>>,
    pub(super) watching: Watching<T>,
    /// Of b(k), what is not in its coordinates.
    pub(super) added: Vec<[T; 6]>,
    /// In slots, inward: what the square-root form has of a body before its measurements; the first is any leaf's while it is its turn.
    pub(super) rooted: Vec<Rooted<T>>,
}

impl<T: Real> SweepScratch<T> {
    pub fn new(model: &Model<T>, sweeps: &SweepModel<T>) -> Self {
        let nan = T::from_f64(f64::NAN);
        let (bodies, nv) = (sweeps.bodies.len(), model.nv());
        // The base has no co-state, and what its motion is each call says.
        let mut co_states = vec![CoState { carried: [nan; 6], estimate: nan }; sweeps.swept_slots.outward];
        co_states[0] = CoState { carried: [T::zero(); 6], estimate: T::zero() };
        let mut watched = vec![[[nan; 6]; 2]; sweeps.swept_slots.outward];
        watched[0] = [[T::zero(); 6]; 2];
        // Nothing arrives at a body that nothing hangs on.
        let mut arriving = vec![Arriving::filled(nan); sweeps.swept_slots.inward];
        arriving[0] = Arriving::filled(T::zero());
        let besides = |value| ProbeArriving { terms: [value; 6], zeta: [value; 6] };
        let mut arriving_besides = vec![besides(nan); sweeps.swept_slots.inward];
        arriving_besides[0] = besides(T::zero());
        let composite = |value| Composite { first_moment: [value; 3], rotational: [value; 6] };
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
                weights: (0..nv).map(|row| T::from_f64(weight(row))).collect(),
                others: (nv..2 * nv).map(|row| T::from_f64(weight(row))).collect(),
                innovations: vec![nan; nv],
                arriving: arriving_besides,
                own: vec![Watched { terms: [nan; 6], bias: [nan; 6], zeta: (nan, nan) }; bodies],
                co_states: watched,
            },
            co_states,
            added: vec![[nan; 6]; bodies],
            rooted: vec![Rooted::filled(nan); sweeps.swept_slots.inward],
        }
    }
}

/// Bytes that an algorithm reads or writes in f64, arguments and results not counted: constants of the scene, which all lanes share, and what there is of
/// each state.
pub(crate) fn bytes(sweeps: &SweepModel<f64>, nv: usize, algorithm: Algorithm) -> [usize; 2] {
    let bodies = sweeps.bodies.len();
    let shifts = sweeps.shifting.len() * (size_of::<RigidShift<f64>>() + size_of::<Body<f64>>())
        + sweeps.tilts.len() * size_of::<ConstantRotation<f64>>();
    let turns = bodies * size_of::<AxialRotation<f64>>();
    let segment = size_of::<Segment<f64>>();
    let constants = match algorithm {
        Algorithm::InverseDynamics | Algorithm::BiasTorque => segment,
        Algorithm::MassMatrix => size_of::<SweepBody<f64>>() + size_of::<CompositeBody<f64>>(),
        Algorithm::ForwardDynamics(Form::SquareRoot) => {
            segment + size_of::<SweepBody<f64>>() + size_of::<BodyRoot<f64>>()
        }
        Algorithm::ForwardDynamics(_) => segment + size_of::<SweepBody<f64>>(),
        Algorithm::MassMatrixInverse(_) => size_of::<SweepBody<f64>>(),
    };
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
        Algorithm::MassMatrix => sweeps.swept_slots.inward * size_of::<Composite<f64>>() + nv * size_of::<[f64; 6]>(),
        Algorithm::ForwardDynamics(Form::Auto) => motions + filter + watching,
        Algorithm::ForwardDynamics(Form::SquareRoot) => {
            let of_bodies = bodies * size_of::<[f64; 6]>();
            let slots = sweeps.swept_slots.inward * size_of::<Rooted<f64>>()
                + sweeps.swept_slots.outward * size_of::<CoState<f64>>();
            motions + of_bodies + slots + nv * size_of::<Measured<f64>>()
        }
        Algorithm::ForwardDynamics(_) => motions + filter + sweeps.swept_slots.outward * size_of::<CoState<f64>>(),
        // And a right side that is made up, with its forces.
        Algorithm::MassMatrixInverse(Form::Auto) => {
            filter + watching + product + nv * size_of::<f64>() + bodies * size_of::<[f64; 6]>()
        }
        Algorithm::MassMatrixInverse(_) => filter + product,
    };
    [model, noise + shifts + turns + swept]
}
