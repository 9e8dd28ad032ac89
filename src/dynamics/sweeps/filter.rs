//! Tip to base: Riccati recursion and filter in one pass.

use super::body::SweepBody;
use super::joint::{self, with_joint};
use super::model::SweepModel;
use super::rows::Measures;
use super::scratch::{Arriving, BodyState, ProbeArriving, SweepScratch, Watched, Watching};
use crate::filter::pivots::{PivotMonitor, Scale};
use crate::filter::riccati::Measured;
use crate::filter::rounding::squares;
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::transform::Transform;

/// Only the factor: D and g of each row.
pub(super) const FACTOR: usize = 0;
/// The factor and the filter of one right side.
pub(super) const FILTER: usize = 1;
/// The factor, and the filters of the right side and of the probe.
pub(super) const WATCH: usize = 2;

/// What a sweep inward reads and writes.
struct Inward<'a, T: Real> {
    arriving: &'a mut [Arriving<T>],
    measured: &'a mut [Measured<T>],
    tau: &'a [T],
    innovations: &'a mut [T],
    /// Of the second right side: what arrives, w and e^-.
    probe_arriving: &'a mut [ProbeArriving<T>],
    probe: &'a [T],
    probe_innovations: &'a mut [T],
    monitor: PivotMonitor<T>,
    near: PivotMonitor<T>,
}

/// Every joint's measurements (3.6, 4.2, 4.5) and the way to its parent; `innovations` receives e^-. `SIDES` is [`FACTOR`], [`FILTER`] or
/// [`WATCH`]. The pivots, and, watched, whether a single look may do. Of a revolute joint D, g and e^- are those about its z.
#[inline(always)]
pub(super) fn tip_to_base<T: Real, const SIDES: usize>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    tau: &[T],
    innovations: &mut [T],
) -> [PivotMonitor<T>; 2] {
    let SweepScratch { own, arriving, shifts, measured, watching, .. } = scratch;
    // Of one length, for the compiler to see: a row of one is a row of all.
    let rows = measured.len();
    let (tau, innovations) =
        if SIDES >= FILTER { (&tau[..rows], &mut innovations[..rows]) } else { (tau, innovations) };
    let Watching { probe, innovations: probe_innovations, arriving: probe_arriving, own: watched, .. } = watching;
    let mut inward = Inward {
        arriving,
        measured,
        tau,
        innovations,
        probe_arriving,
        probe: &probe[..rows],
        probe_innovations: &mut probe_innovations[..rows],
        monitor: PivotMonitor::new(),
        near: PivotMonitor::for_a_single_look(),
    };
    for ((body, own), watched) in sweeps.swept().iter().zip(own).zip(watched).rev() {
        with_joint!(body, own.turn, (model, sweeps, shifts), transform, rows, {
            inward.step::<SIDES>(body, (transform, rows), own, watched);
        });
    }
    [inward.monitor, inward.near]
}

// In debug builds these are calls: in one frame, where nothing shares a place, they would take more than a thread's stack has.
impl<T: Real> Inward<'_, T> {
    /// One body: its measurements, and what it sends to its parent.
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn step<const SIDES: usize>(
        &mut self,
        body: &SweepBody<T::Parameter>,
        (transform, rows): (&impl Transform<T>, &impl Measures<T>),
        own: &mut BodyState<T>,
        watched: &mut Watched<T>,
    ) {
        // P^- = M(k) + what the children sent (3.6); D, g and P^+; phi P^+ phi* to the parent.
        let arrived = &self.arriving[body.places.inward];
        let p_minus = body.with_noise(&arrived.p);
        let scale = arrived.scale.sum(&body.scale_of_noise(p_minus[0]));
        let (gains, p_plus) = rows.measure(&p_minus, self.measured);
        if body.parent.is_some() {
            let traces = (p_minus[0] + p_minus[3] + p_minus[5], p_minus[15] + p_minus[18] + p_minus[20]);
            let (begins, to) = (body.places.arrives_first, &mut self.arriving[body.places.parent_inward]);
            transform.send_covariance(&p_plus, begins, &mut to.p);
            to.scale.accumulate(&Scale::sent(traces, transform.offset_square()), begins);
        }
        rows.keep(gains, self.measured);
        rows.observe(self.measured, &scale, &mut self.monitor);
        if SIDES >= FILTER {
            self.filter(body, (transform, rows), own, if SIDES == WATCH { Some(&mut watched.bias) } else { None });
        }
        if SIDES == WATCH {
            rows.observe(self.measured, &scale, &mut self.near);
            self.watch(body, (transform, rows), &rows.terms_left(&p_minus, &p_plus), watched);
        }
    }

    /// z^- = b + what the children sent; e^- (4.2) and z^+ (4.5); phi z^+ to the parent (4.4). Watched, b and z^+ stay.
    #[inline(always)]
    fn filter(
        &mut self,
        body: &SweepBody<T::Parameter>,
        (transform, rows): (&impl Transform<T>, &impl Measures<T>),
        own: &mut BodyState<T>,
        bias: Option<&mut [T; 6]>,
    ) {
        let mut z = own.force;
        for (z, &arrived) in z.iter_mut().zip(&self.arriving[body.places.inward].force) {
            *z += arrived;
        }
        rows.filter(self.measured, self.tau, &mut z, self.innovations);
        if body.parent.is_some() {
            let to = &mut self.arriving[body.places.parent_inward];
            transform.send_force(&z, body.places.arrives_first, &mut to.force);
        }
        if let Some(bias) = bias {
            (*bias, own.force) = (own.force, z);
        }
    }

    /// The filter of the probe, and the terms of the diagonal of P^-.
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn watch(
        &mut self,
        body: &SweepBody<T::Parameter>,
        (transform, rows): (&impl Transform<T>, &impl Measures<T>),
        terms_left: &[T; 6],
        watched: &mut Watched<T>,
    ) {
        let ProbeArriving { terms, mut zeta } = self.probe_arriving[body.places.inward];
        watched.terms = body.with_terms(&terms);
        rows.filter(self.measured, self.probe, &mut zeta, self.probe_innovations);
        watched.zeta = squares(&zeta.into());
        if body.parent.is_some() {
            let (begins, to) = (body.places.arrives_first, &mut self.probe_arriving[body.places.parent_inward]);
            transform.send_force(&zeta, begins, &mut to.zeta);
            transform.send_terms(terms_left, begins, &mut to.terms);
        }
    }
}
