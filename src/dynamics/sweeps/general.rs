//! Each pass compiled once per scalar, for callers whose time does not depend on the kernels. The functions of
//! [`dynamics`](crate::dynamics) are compositions of these passes.
//!
//! Most callers use the general model ([`SweepModel::general`]), whose store has one slot per body, because they read
//! the results of a pass for every body. Code generation uses the model of the kernels.

use super::error_estimate::{self, ErrorTerms};
use super::filter::{ESTIMATE, FACTOR, FILTER};
use super::model::SweepModel;
use super::motion;
use super::scratch::SweepScratch;
use super::{MassColumns, add_armature};
use crate::dynamics::forces::{Motion, Needed};
use crate::filter::cancellation::Cancellation;
use crate::filter::pivots::PivotMonitor;
use crate::filter::rounding::{OfRoot, Outward, RootMonitor, Rounding, RoundingBound, squares};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::transform::Transform;
use nalgebra::Vector6;

type Scene<'a, T> = (&'a Model<T>, &'a SweepModel<T>);

/// Base to tip: the force that the motion of each body needs (1.3, 2.9); with `ROOT` in the coordinates of its root.
#[inline(never)]
pub(crate) fn forces<T: Real, const ROOT: bool>(
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    state: Motion<'_, T>,
) {
    motion::base_to_tip::<T, T, ROOT>(scene, scratch, state);
}

/// Tip to base: the torque H z of every row (1.5), and the whole force z(k) that each body transmits in the place of
/// its own.
#[inline(never)]
pub(crate) fn predict<T: Real>(scene: Scene<'_, T>, scratch: &mut SweepScratch<T>, torques: &mut [T]) {
    super::motion::tip_to_base::<T, true>(scene, scratch, torques);
}

/// Joint torques for the motion of a state (1.5, 2.9, 2.10), those of the bias without accelerations. The store keeps
/// the whole force z(k) of each body.
pub(crate) fn inverse_dynamics<T: Real>(
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    state: Motion<'_, T>,
    torques: &mut [T],
) {
    forces::<T, false>(scene, scratch, state);
    predict(scene, scratch, torques);
    if let Some(qdd) = state.qdd {
        add_armature(scene.0, qdd, torques);
    }
}

/// M a = H phi Q phi* H* a + r a (2.8), with phi in the store.
#[inline(never)]
pub(crate) fn mul_mass<T: Real>(scene: Scene<'_, T>, scratch: &mut SweepScratch<T>, a: &[T], out: &mut [T]) {
    let (still, needed) = ([T::zero(); 3], Needed { velocity: false, acceleration: true });
    let state = Motion { q: &[], qd: a, qdd: Some(a), wrenches: &[] };
    motion::forces::<T, false>(scene.1, scratch, still, state, needed);
    predict(scene, scratch, out);
    add_armature(scene.0, a, out);
}

/// M at `q` into `out`, (nv x nv) row by row (3.4, 3.5).
#[inline(never)]
pub(crate) fn mass_matrix<T: Real>(
    (model, sweeps): Scene<'_, T>,
    (scratch, columns): (&mut SweepScratch<T>, &mut MassColumns<T, T>),
    q: &[T],
    out: &mut [T],
) {
    columns.prepare(model, sweeps);
    super::mass_matrix::<T, T, false>((model, sweeps), (scratch, columns), q, out);
}

/// Tip to base: Riccati recursion and filter (3.6, 4.2, 4.5), `SIDES` as in [`filter`](super::filter).
#[inline(never)]
fn filter<T: Real, const SIDES: usize>(
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    tau: &[T],
    innovations: &mut [T],
) -> [PivotMonitor<T>; 2] {
    super::filter::tip_to_base::<T, SIDES>(scene, scratch, tau, innovations)
}

/// Tip to base: Riccati recursion and filter of the forces in the store; `innovations` receives e^- (4.2).
pub(crate) fn filter_forces<T: Real>(
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    tau: &[T],
    innovations: &mut [T],
) -> PivotMonitor<T> {
    let [monitor, _] = filter::<T, FILTER>(scene, scratch, tau, innovations);
    monitor
}

/// Base to tip: the smoother (4.9 to 4.11). `estimates` holds e^- on entry and a on return. With `SEEN` as in
/// [`accelerations`].
#[inline(never)]
fn smoother<T: Real, const SEEN: bool>(
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    estimates: &mut [T],
) -> Outward<T> {
    super::solve::base_to_tip::<T, SEEN>(scene, scratch, estimates)
}

/// The smoother alone: `estimates` holds e^- on entry and a on return.
pub(crate) fn smooth<T: Real>(scene: Scene<'_, T>, scratch: &mut SweepScratch<T>, estimates: &mut [T]) {
    smoother::<T, false>(scene, scratch, estimates);
}

/// Joint accelerations in covariance form.
pub(crate) fn forward_dynamics<T: Real>(
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> PivotMonitor<T> {
    forces::<T, false>(scene, scratch, Motion { q, qd, qdd: None, wrenches });
    let monitor = filter_forces(scene, scratch, tau, qdd);
    smooth(scene, scratch, qdd);
    monitor
}

/// [`forward_dynamics`] with an error estimate.
pub(crate) fn forward_dynamics_with_estimate<T: Real>(
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> ErrorTerms<T> {
    forces::<T, false>(scene, scratch, Motion { q, qd, qdd: None, wrenches });
    let [monitor, near] = filter::<T, ESTIMATE>(scene, scratch, tau, qdd);
    (monitor, near, smooth_both::<T, true>(scene, scratch, qdd))
}

/// Base to tip: the smoother for the right-hand side and for the test vector; with `ALLOWS` with the sensitivity of the
/// problem.
#[inline(never)]
fn smooth_both<T: Real, const ALLOWS: bool>(
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    estimates: &mut [T],
) -> Cancellation<T> {
    error_estimate::base_to_tip::<T, ALLOWS>(scene, scratch, estimates)
}

/// phi of every joint at `q`, and forces of zero.
fn at_rest<T: Real>(scene: Scene<'_, T>, scratch: &mut SweepScratch<T>, q: &[T]) {
    motion::carriers::<T, T>(scene.1, scratch, T::zero(), q);
    scratch.set_forces(std::iter::repeat(Vector6::from_element(T::zero())));
}

/// The factor of M at `q`: phi, D, g and P (3.6, 3.10).
pub(crate) fn factor<T: Real>(scene: Scene<'_, T>, scratch: &mut SweepScratch<T>, q: &[T]) -> PivotMonitor<T> {
    motion::carriers::<T, T>(scene.1, scratch, T::zero(), q);
    refactor(scene, scratch)
}

/// [`factor`] for a scalar that records its operations, and whether pivots are near the bounds of their terms.
pub(crate) fn factor_and_nearness<T: Real>(
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    q: &[T],
) -> [PivotMonitor<T>; 2] {
    motion::carriers::<T, T>(scene.1, scratch, T::zero(), q);
    filter::<T, FACTOR>(scene, scratch, &[], &mut [])
}

/// [`factor`] with phi in the store.
pub(crate) fn refactor<T: Real>(scene: Scene<'_, T>, scratch: &mut SweepScratch<T>) -> PivotMonitor<T> {
    let [monitor, _] = filter::<T, FACTOR>(scene, scratch, &[], &mut []);
    monitor
}

/// [`refactor`] for the bodies for which `is_changed` holds; their unchanged children propagate their previous values
/// again.
#[inline(never)]
pub(crate) fn update_factor<T: Real>(
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    is_changed: &dyn Fn(usize) -> bool,
) -> PivotMonitor<T> {
    let is_due = |body: usize, parent: Option<usize>| is_changed(body) || parent.is_some_and(is_changed);
    let [monitor, _] = super::filter::tip_to_base_where::<T, FACTOR>(scene, scratch, (&[], &mut []), is_due);
    monitor
}

/// The factor of M at `q`, and the error estimate of one test vector by the other; `estimates` is scratch, (nv).
pub(crate) fn factor_with_estimate<T: Real>(
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    q: &[T],
    estimates: &mut [T],
) -> (PivotMonitor<T>, Cancellation<T>) {
    at_rest(scene, scratch, q);
    // Moved out and back because it is read while the rest of the scratch is written; this does not allocate.
    let other = std::mem::take(&mut scratch.test.other_vector);
    let [monitor, _] = filter::<T, ESTIMATE>(scene, scratch, &other, estimates);
    scratch.test.other_vector = other;
    (monitor, smooth_both::<T, false>(scene, scratch, estimates))
}

/// Tip to base: the square-root form (3.6, 4.2, 4.5) of the coordinates in the store.
#[inline(never)]
fn filter_roots<T: Real>(
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    tau: &[T],
    innovations: &mut [T],
) -> RootMonitor<T> {
    super::root_filter::tip_to_base::<T, true>(scene, scratch, tau, innovations)
}

/// The factor of M at `q` in square-root form; `zeros` and `innovations` are (nv), the latter scratch.
pub(crate) fn factor_by_roots<T: Real>(
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    q: &[T],
    (zeros, innovations): (&[T], &mut [T]),
) -> PivotMonitor<T> {
    at_rest(scene, scratch, q);
    scratch.added.fill([T::zero(); 6]);
    filter_roots(scene, scratch, zeros, innovations).pivots
}

/// Joint accelerations in square-root form, and the bound on their rounding.
///
/// The body forces enter as L y, with y = L^-1 b in the parameters of the body itself, and never as a sum with
/// transmitted forces: the weight of a heavy body is rotated into the columns of the bodies inboard of it and not
/// subtracted there. A body whose inertia has no root gives NaN.
pub(crate) fn forward_dynamics_by_roots<T: Real>(
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> (PivotMonitor<T>, RoundingBound<T>) {
    forces::<T, true>(scene, scratch, Motion { q, qd, qdd: None, wrenches });
    let monitor = filter_roots(scene, scratch, tau, qdd);
    let outward = smoother::<T, true>(scene, scratch, qdd);
    (monitor.pivots, RoundingBound::of(&monitor, outward))
}

/// The error estimate of the accelerations `qdd` that [`forward_dynamics_by_roots`] has just computed on the general
/// model: a filter and a smoother of a test vector.
#[inline(never)]
pub(crate) fn rounding_of_roots<T: Real>(
    (model, sweeps): Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    (tau, qdd): (&[T], &[T]),
) -> Rounding<T> {
    // Moved out and back because they are used while the rest of the scratch is written; this does not allocate.
    let (vector, mut weighed) =
        (std::mem::take(&mut scratch.test.vector), std::mem::take(&mut scratch.test.innovations));
    innovations::<T, false>((model, sweeps), scratch, &vector, &mut weighed);
    let SweepScratch { own, shifts, measured, co_states, rooted, test, .. } = &mut *scratch;
    let pairs = &mut test.co_states;
    let mut seen = Rounding::new();
    for (body, own) in sweeps.swept().iter().zip(own) {
        let (outer, [_, outer_nu]) = (&co_states[body.places.parent_outward], &pairs[body.places.parent_outward]);
        let (mut lambda, mut nu) = ([T::zero(); 6], [T::zero(); 6]);
        if body.parent.is_some() {
            let shift = &shifts[body.index];
            seen.carried(squares(&own.force.into()), &Vector6::from(*outer), shift.lever_square());
            (lambda, nu) = (shift.carry_motion(outer), shift.carry_motion(outer_nu));
        }
        let here = &rooted[body.places.inward];
        let of_root = OfRoot { root: &here.root, y: &here.y, t: &here.t, measured };
        let mut co_states = (Vector6::from(lambda), Vector6::from(nu));
        let stage = &model.system.stages[body.index];
        seen.through_stage(stage, &of_root, (tau, qdd, &weighed), (&mut co_states.0, &mut co_states.1));
        pairs[body.places.outward][1] = co_states.1.into();
    }
    (scratch.test.vector, scratch.test.innovations) = (vector, weighed);
    seen
}

/// Tip to base: the innovations of a right-hand side (4.2, 4.4, 4.5) with the factor in the store; with `BIASED` with
/// the force of each body.
#[inline(never)]
pub(crate) fn innovations<T: Real, const BIASED: bool>(
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    tau: &[T],
    innovations: &mut [T],
) {
    super::solve::tip_to_base::<T, BIASED, true>(scene, scratch, tau, innovations);
}

/// M^-1 (tau - H phi b) (4.1) with the factor in the store; with `BIASED` with the force b of each body, else without.
pub(crate) fn solve<T: Real, const BIASED: bool>(
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    tau: &[T],
    estimates: &mut [T],
) {
    innovations::<T, BIASED>(scene, scratch, tau, estimates);
    smooth(scene, scratch, estimates);
}
