//! Tip to base: the Riccati recursion (3.6, 3.10) and the filter (4.2, 4.4, 4.5) in one pass.
//!
//! [`factor`] computes the factor of M alone, for M^-1 and for further right-hand sides.

use super::body::SweepBody;
use super::joint::{self, with_joint};
use super::load::Load;
use super::model::SweepModel;
use super::motion::carriers;
use super::rows::Measures;
use super::scratch::{Accumulated, BodyState, SweepScratch, TestAccumulated, TestState, TestVector};
use crate::filter::pivots::{PivotMonitor, Scale};
use crate::filter::riccati::Measured;
use crate::filter::rounding::squares;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};
use crate::spatial::transform::Transform;

/// Only the factor: D and g of each row.
pub(super) const FACTOR: usize = 0;
/// The factor and the filter of one right-hand side.
pub(super) const FILTER: usize = 1;
/// The factor, the filter of the right-hand side, and that of the test vector for the error estimate.
pub(super) const ESTIMATE: usize = 2;

/// The arguments of the pass.
struct Inward<'a, T: Real> {
    accumulated: &'a mut [Accumulated<T>],
    measured: &'a mut [Measured<T>],
    tau: &'a [T],
    innovations: &'a mut [T],
    /// The test vector: the sums over children, w and e^-.
    test_accumulated: &'a mut [TestAccumulated<T>],
    vector: &'a [T],
    test_innovations: &'a mut [T],
    monitor: PivotMonitor<T>,
    near: PivotMonitor<T>,
}

/// The measurements of every joint (3.6, 4.2, 4.5) and the propagation to its parent; `innovations` receives e^-.
/// `SIDES` is [`FACTOR`], [`FILTER`] or [`ESTIMATE`]. Returns the pivots, and with an error estimate, or for a scalar
/// that records its operations, whether one test vector suffices to accept them. D, g and e^- of a revolute joint are
/// those about its z.
#[inline(always)]
pub(super) fn tip_to_base<T: Real, const SIDES: usize>(
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    tau: &[T],
    innovations: &mut [T],
) -> [PivotMonitor<T>; 2] {
    tip_to_base_where::<T, SIDES>(scene, scratch, (tau, innovations), |_, _| true)
}

/// The same for the bodies for which `is_due` holds, given the index of a body and that of its parent.
#[inline(always)]
pub(super) fn tip_to_base_where<T: Real, const SIDES: usize>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    (tau, innovations): (&[T], &mut [T]),
    is_due: impl Fn(usize, Option<usize>) -> bool,
) -> [PivotMonitor<T>; 2] {
    let SweepScratch { own, accumulated, shifts, measured, test, .. } = scratch;
    // Of the same length, so that the compiler omits bounds checks.
    let rows = measured.len();
    let (tau, innovations) =
        if SIDES >= FILTER { (&tau[..rows], &mut innovations[..rows]) } else { (tau, innovations) };
    let TestVector { vector, innovations: test_innovations, accumulated: test_accumulated, own: tested, .. } = test;
    let mut inward = Inward {
        accumulated,
        measured,
        tau,
        innovations,
        test_accumulated,
        vector: &vector[..rows],
        test_innovations: &mut test_innovations[..rows],
        monitor: PivotMonitor::new(),
        near: PivotMonitor::for_a_single_estimate(),
    };
    for ((body, own), tested) in sweeps.swept().iter().zip(own).zip(tested).rev() {
        if !is_due(body.index, body.parent) {
            continue;
        }
        with_joint!(body, own.turn, (model, sweeps, shifts), transform, rows, {
            inward.step::<SIDES>((body, sweeps.load(body)), (transform, rows), own, tested);
        });
    }
    [inward.monitor, inward.near]
}

// In debug builds these are calls: inlined, their variables do not share stack, and a thread's stack would not suffice.
impl<T: Real> Inward<'_, T> {
    /// One body: its measurements, and the propagation to its parent.
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn step<const SIDES: usize>(
        &mut self,
        (body, load): (&SweepBody<T::Parameter>, &Load<T>),
        (transform, rows): (&impl Transform<T>, &impl Measures<T>),
        own: &mut BodyState<T>,
        tested: &mut TestState<T>,
    ) {
        // P^- = M(k) + the sum over the children (3.6); D, g and P^+; phi P^+ phi* to the parent.
        let sum = &self.accumulated[body.places.inward];
        let p_minus = load.with_noise(&sum.p);
        let scale = sum.scale.sum(&load.scale);
        let (gains, p_plus) = rows.measure(&p_minus, self.measured);
        if body.parent.is_some() {
            let traces = (p_minus[0] + p_minus[3] + p_minus[5], p_minus[15] + p_minus[18] + p_minus[20]);
            let (begins, to) = (body.places.accumulates_first, &mut self.accumulated[body.places.parent_inward]);
            transform.send_covariance(&p_plus, begins, &mut to.p);
            to.scale.accumulate(&Scale::sent(traces, transform.offset_square()), begins);
        }
        rows.keep(gains, self.measured);
        rows.observe(self.measured, &scale, &mut self.monitor);
        if SIDES >= FILTER {
            self.filter(body, (transform, rows), own, if SIDES == ESTIMATE { Some(&mut tested.bias) } else { None });
        }
        // A scalar that records operations drops what is not read.
        if SIDES == ESTIMATE || !T::IS_KNOWN {
            rows.observe(self.measured, &scale, &mut self.near);
        }
        if SIDES == ESTIMATE {
            self.estimate((body, load), (transform, rows), &rows.terms_left(&p_minus, &p_plus), tested);
        }
    }

    /// z^- = b + the sum over the children; e^- (4.2) and z^+ (4.5); phi z^+ to the parent (4.4). The error estimate
    /// reads b and z^+ later.
    #[inline(always)]
    fn filter(
        &mut self,
        body: &SweepBody<T::Parameter>,
        (transform, rows): (&impl Transform<T>, &impl Measures<T>),
        own: &mut BodyState<T>,
        bias: Option<&mut [T; 6]>,
    ) {
        let mut z = own.force;
        for (z, &sent) in z.iter_mut().zip(&self.accumulated[body.places.inward].force) {
            *z += sent;
        }
        rows.filter(self.measured, self.tau, &mut z, self.innovations);
        if body.parent.is_some() {
            let to = &mut self.accumulated[body.places.parent_inward];
            transform.send_force(&z, body.places.accumulates_first, &mut to.force);
        }
        if let Some(bias) = bias {
            (*bias, own.force) = (own.force, z);
        }
    }

    /// The filter of the test vector, and the terms of the diagonal of P^-.
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn estimate(
        &mut self,
        (body, load): (&SweepBody<T::Parameter>, &Load<T>),
        (transform, rows): (&impl Transform<T>, &impl Measures<T>),
        terms_left: &[T; 6],
        tested: &mut TestState<T>,
    ) {
        let TestAccumulated { terms, mut zeta } = self.test_accumulated[body.places.inward];
        tested.terms = load.with_terms(&terms);
        rows.filter(self.measured, self.vector, &mut zeta, self.test_innovations);
        tested.zeta = squares(&zeta.into());
        if body.parent.is_some() {
            let (begins, to) = (body.places.accumulates_first, &mut self.test_accumulated[body.places.parent_inward]);
            transform.send_force(&zeta, begins, &mut to.zeta);
            transform.send_terms(terms_left, begins, &mut to.terms);
        }
    }
}

/// The factor of M at `q`, in the scratch, in covariance form.
#[inline(always)]
pub(crate) fn factor<T: Real, C: ColumnsOf<T>>(
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    q: &[T],
) -> PivotMonitor<T> {
    carriers(scene.1, scratch, C::zero(), q);
    refactor(scene, scratch)
}

/// [`factor`] with the rotations and shifts of the joints in the scratch.
#[inline(always)]
pub(crate) fn refactor<T: Real>(scene: (&Model<T>, &SweepModel<T>), scratch: &mut SweepScratch<T>) -> PivotMonitor<T> {
    let [monitor, _] = tip_to_base::<T, FACTOR>(scene, scratch, &[], &mut []);
    monitor
}
