//! Tip to base: Riccati recursion and filter in one pass.

use super::axial_rotation::ABOUT_Z;
use super::axial_rotation::{Axis, about, packed_to_parent, to_parent};
use super::body::SweepBody;
use super::bounds::{scale_splat, sent, sent_terms, terms_of_noise};
use super::carrier::Carrier;
use super::carry::{carried, diagonal, in_joint_frame, pivot_column, with_noise};
use super::constant_rotation::JointAxis;
use super::free_joint;
use super::model::SweepModel;
use super::packed::{packed, unpacked};
use super::prismatic::{ALONG_Z, ConstantSlide, past_slide};
use super::rotation::{ObliqueRotation, Rotates, rotated};
use super::row::{Noise, diagonal_past, measure, measured};
use super::scratch::{Arriving, BodyState, ProbeArriving, SweepScratch, Watched, Watching, accumulate};
use crate::filter::pivots::{PivotMonitor, Scale};
use crate::filter::riccati::{self, Measured};
use crate::filter::rounding::squares;
use crate::filter::{HingeMap, System, innovations, terms};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{RigidShift, absolute};
use nalgebra::Vector6;

/// Only the factor: D and g of each row.
pub(super) const FACTOR: usize = 0;
/// The factor and the filter of one right side.
pub(super) const FILTER: usize = 1;
/// The factor, and the filters of the right side and of the weights.
pub(super) const WATCH: usize = 2;

/// What a sweep inward reads and writes.
struct Inward<'a, T: Real> {
    system: &'a System<T>,
    /// The system's, as long as `measured`.
    noise: &'a [T],
    arriving: &'a mut [Arriving<T>],
    shifts: &'a [RigidShift<T>],
    slides: &'a [ConstantSlide<T::Parameter>],
    measured: &'a mut [Measured<T>],
    tau: &'a [T],
    innovations: &'a mut [T],
    /// Of the second right side: what arrives, w and e^-.
    probe_arriving: &'a mut [ProbeArriving<T>],
    weights: &'a [T],
    weighed: &'a mut [T],
    monitor: PivotMonitor<T>,
    near: PivotMonitor<T>,
}

/// Every stage's measurements (3.6, 4.2, 4.5) and the way to its parent; `innovations` receives e^-. `SIDES` is [`FACTOR`], [`FILTER`] or
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
    let noise = &model.system.noise[..rows];
    let (tau, innovations) =
        if SIDES >= FILTER { (&tau[..rows], &mut innovations[..rows]) } else { (tau, innovations) };
    let Watching { weights, innovations: weighed, arriving: probe_arriving, own: watched, .. } = watching;
    let (weights, weighed) =
        if SIDES == WATCH { (&weights[..rows], &mut weighed[..rows]) } else { (&weights[..], &mut weighed[..]) };
    let slots = arriving.len();
    let mut inward = Inward {
        system: &model.system,
        noise,
        arriving,
        shifts,
        slides: &sweeps.slides,
        measured,
        tau,
        innovations,
        probe_arriving: &mut probe_arriving[..slots],
        weights,
        weighed,
        monitor: PivotMonitor::new(),
        near: PivotMonitor::for_a_single_look(),
    };
    for ((body, own), watched) in sweeps.swept().iter().zip(own).zip(watched).rev() {
        match body.carrier {
            Carrier::Axial(axle) => rotated!(axle, own.turn, sweeps.tilts, rotation, {
                inward.about_z::<SIDES>(body, (axle.axis(), &rotation), own, watched);
            }),
            Carrier::Shift(_) if free_joint::is_noise_free(body.is_free_joint, body.row, &model.system) => {
                inward.free_joint::<SIDES>(body, own, watched);
            }
            Carrier::Shift(at) => inward.shift::<SIDES>(body, (own, watched), at),
        }
    }
    [inward.monitor, inward.near]
}

// In debug builds these are calls: in one frame, where nothing shares a place, they would take more than a thread's stack has.
impl<T: Real> Inward<'_, T> {
    /// The bound on the terms of P^-: of M(k) and of what arrived.
    #[inline(always)]
    fn scale_of(body: &SweepBody<T::Parameter>, arrived: &Scale<T>) -> Scale<T> {
        arrived.sum(&scale_splat(body.scale, arrived.angular))
    }

    /// A body on a revolute joint.
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn about_z<const SIDES: usize>(
        &mut self,
        body: &SweepBody<T::Parameter>,
        (axis, rotation): (Axis, &impl Rotates<T>),
        own: &mut BodyState<T>,
        watched: &mut Watched<T>,
    ) {
        let row = body.row;
        let noise = Noise::of(self.noise[row]);
        let (m, scale, kept_diagonal) = self.send_past_z::<SIDES>(body, noise, (axis, rotation));
        self.monitor.observe(m.pivot, &HingeMap::Axis(ABOUT_Z), &scale);
        if SIDES >= FILTER {
            let z = sum(own.force, &self.arriving[body.places.inward].force);
            let sense = z[0].splat(body.sense);
            let (e, force) = measure(noise, &m, sense * self.tau[row], &z);
            if body.parent.is_some() {
                let to = &mut self.arriving[body.places.parent_inward];
                let sent = in_joint_frame(&body.lever, rotation, &force);
                about!(axis, X, Y, Z, accumulate(body, &to_parent::<T, X, Y, Z>(&sent), &mut to.force));
            }
            self.innovations[row] = e;
            if SIDES == WATCH {
                (watched.bias, own.force) = (own.force, force);
                self.near.observe(m.pivot, &HingeMap::Axis(ABOUT_Z), &scale);
            }
        }
        self.measured[row] = m;
        if SIDES == WATCH {
            self.watch_about_z(body, (axis, rotation), &kept_diagonal, watched);
        }
    }

    /// D and g of such a body, and P on its way to the parent. Gives them, the bounds on P^-, and where it is watched the diagonal of P^+.
    ///
    /// P leaves before anything is written: the compiler could take that for P's, and would read all of it before.
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn send_past_z<const SIDES: usize>(
        &mut self,
        body: &SweepBody<T::Parameter>,
        noise: Noise<T>,
        (axis, rotation): (Axis, &impl Rotates<T>),
    ) -> (Measured<T>, Scale<T>, Vector6<T>) {
        let arrived = &self.arriving[body.places.inward];
        let (m, column) = measured(noise, &pivot_column(body, &arrived.p));
        let scale = Self::scale_of(body, &arrived.scale);
        let mut kept_diagonal = m.gain;
        if SIDES == WATCH {
            kept_diagonal = diagonal_past(noise, &diagonal(body, &arrived.p), &column, &m);
        }
        if body.parent.is_some() {
            let (p, sent_scale) = (with_noise(body, &arrived.p), sent(body, &diagonal(body, &arrived.p)));
            let to = &mut self.arriving[body.places.parent_inward];
            // Not all of it for each axis, which takes no less time here and the compiler more.
            let sent = carried(body, rotation, &p, &column, (&m, noise));
            about!(axis, X, Y, Z, accumulate(body, &packed_to_parent::<T, X, Y, Z>(&sent), &mut to.p));
            accumulate_bounds(body, sent_scale, &mut to.scale);
        }
        (m, scale, kept_diagonal)
    }

    /// What is watched besides of such a body, after P has left it.
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn watch_about_z(
        &mut self,
        body: &SweepBody<T::Parameter>,
        (axis, rotation): (Axis, &impl Rotates<T>),
        kept_diagonal: &Vector6<T>,
        watched: &mut Watched<T>,
    ) {
        let row = body.row;
        let arrived = &self.probe_arriving[body.places.inward];
        let sense = arrived.terms[0].splat(body.sense);
        watched.terms = sum(terms_of_noise(body, sense), &arrived.terms);
        let noise = Noise::of(self.noise[row]);
        let zeta;
        (self.weighed[row], zeta) = measure(noise, &self.measured[row], sense * self.weights[row], &arrived.zeta);
        watched.zeta = squares(&zeta.into());
        if body.parent.is_none() {
            return;
        }
        let to = &mut self.probe_arriving[body.places.parent_inward];
        let (terms, zeta) = (sent_terms(body, rotation, kept_diagonal), in_joint_frame(&body.lever, rotation, &zeta));
        about!(axis, X, Y, Z, {
            accumulate(body, &to_parent::<T, X, Y, Z>(&terms), &mut to.terms);
            accumulate(body, &to_parent::<T, X, Y, Z>(&zeta), &mut to.zeta);
        });
    }

    /// A body that floats.
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn free_joint<const SIDES: usize>(
        &mut self,
        body: &SweepBody<T::Parameter>,
        own: &mut BodyState<T>,
        watched: &mut Watched<T>,
    ) {
        let (arrived, rows) = (&self.arriving[body.places.inward], free_joint::rows(body.row));
        let scale = Self::scale_of(body, &arrived.scale);
        let measured = &mut self.measured[rows.clone()];
        free_joint::measure(with_noise(body, &arrived.p), &scale, measured, &mut self.monitor);
        if SIDES >= FILTER {
            if SIDES == WATCH {
                watched.bias = own.force;
            }
            own.force = sum(own.force, &arrived.force);
            free_joint::filter(measured, &self.tau[rows.clone()], &mut own.force, &mut self.innovations[rows.clone()]);
        }
        if SIDES == WATCH {
            self.near.observe_stage(&self.system.stages[body.index], self.measured, &scale);
            let ProbeArriving { terms, mut zeta } = self.probe_arriving[body.places.inward];
            watched.terms = sum(terms_of_noise(body, terms[0]), &terms);
            let weights = &self.weights[rows.clone()];
            free_joint::filter(&self.measured[rows.clone()], weights, &mut zeta, &mut self.weighed[rows]);
            watched.zeta = squares(&zeta.into());
        }
    }

    /// Any other body.
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn shift<const SIDES: usize>(
        &mut self,
        body: &SweepBody<T::Parameter>,
        (own, watched): (&mut BodyState<T>, &mut Watched<T>),
        at: usize,
    ) {
        let arrived = &self.arriving[body.places.inward];
        let (arrived_force, scale) = (arrived.force, Self::scale_of(body, &arrived.scale));
        let left = match body.slide {
            Some(slide) => self.send_past_slide(body, (at, slide), &scale),
            None => self.send_past_stage(body, at, &scale),
        };
        let (shift, stage, at_stage) = (&self.shifts[at], &self.system.stages[body.index], (self.system, body.index));
        if SIDES >= FILTER {
            if SIDES == WATCH {
                watched.bias = own.force;
            }
            own.force = sum(own.force, &arrived_force);
            let right_side = (self.tau, &mut *self.innovations);
            let sent = through_general_stage(at_stage, shift, self.measured, right_side, &mut own.force);
            if body.parent.is_some() {
                accumulate(body, &sent, &mut self.arriving[body.places.parent_inward].force);
            }
        }
        if SIDES == WATCH {
            self.near.observe_stage(stage, self.measured, &scale);
            let ProbeArriving { terms, mut zeta } = self.probe_arriving[body.places.inward];
            watched.terms = sum(terms_of_noise(body, terms[0]), &terms);
            let right_side = (self.weights, &mut *self.weighed);
            let sent = through_general_stage(at_stage, shift, self.measured, right_side, &mut zeta);
            watched.zeta = squares(&zeta.into());
            if body.parent.is_some() {
                let to = &mut self.probe_arriving[body.places.parent_inward];
                accumulate(body, &sent, &mut to.zeta);
                accumulate(body, &terms::sent(&left, shift).into(), &mut to.terms);
            }
        }
    }

    /// D and g of a body on any joint, and P on its way to the parent. Gives what [`terms::left`] does.
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn send_past_stage(&mut self, body: &SweepBody<T::Parameter>, at: usize, scale: &Scale<T>) -> Vector6<T> {
        let (shift, stage) = (&self.shifts[at], &self.system.stages[body.index]);
        let mut p = unpacked(&with_noise(body, &self.arriving[body.places.inward].p));
        let sent = Scale::sent_by(&p, shift);
        let before = p.diagonal();
        let carried = riccati::through_stage::<T, false>(
            (self.system, body.index),
            shift,
            (&mut p, scale),
            self.measured,
            &mut self.monitor,
            |_, _| {},
        );
        if body.parent.is_some() {
            let to = &mut self.arriving[body.places.parent_inward];
            accumulate_bounds(body, sent, &mut to.scale);
            accumulate(body, &packed(&carried), &mut to.p);
        }
        terms::left(stage, &before, &p)
    }

    /// The same of a body that slides.
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn send_past_slide(
        &mut self,
        body: &SweepBody<T::Parameter>,
        (at, slide): (usize, usize),
        scale: &Scale<T>,
    ) -> Vector6<T> {
        let (shift, slide) = (&self.shifts[at], &self.slides[slide]);
        let p = with_noise(body, &self.arriving[body.places.inward].p);
        let (m, after) = past_slide(Noise::of(self.noise[body.row]), &p);
        if body.parent.is_some() {
            let to = &mut self.arriving[body.places.parent_inward];
            let traces = (p[0] + p[3] + p[5], p[15] + p[18] + p[20]);
            accumulate_bounds(body, Scale::sent(traces, shift.lever_square()), &mut to.scale);
            let l = &shift.lever;
            accumulate(body, &slide.at_parent(&after, [l[0], l[1], l[2]]), &mut to.p);
        }
        self.monitor.observe(m.pivot, &HingeMap::Axis(ALONG_Z), scale);
        self.measured[body.row] = m;
        absolute(&Vector6::new(after[0], after[3], after[5], after[15], after[18], after[20]))
    }
}

/// As [`accumulate`], of the bounds.
#[inline(always)]
fn accumulate_bounds<T: Real>(body: &SweepBody<T::Parameter>, sent: Scale<T>, to: &mut Scale<T>) {
    let mut sum = [to.angular, to.linear];
    accumulate(body, &[sent.angular, sent.linear], &mut sum);
    [to.angular, to.linear] = sum;
}

/// Entry by entry.
#[inline(always)]
fn sum<T: Real, const N: usize>(mut a: [T; N], b: &[T; N]) -> [T; N] {
    for (a, &b) in a.iter_mut().zip(b) {
        *a += b;
    }
    a
}

/// The filter at a stage with any joint: its rows, z^- becoming z^+; gives that as it is at the parent.
#[inline(always)]
fn through_general_stage<T: Real>(
    at_stage: (&System<T>, usize),
    shift: &RigidShift<T>,
    measured: &[Measured<T>],
    (measurement, innovations): (&[T], &mut [T]),
    z: &mut [T; 6],
) -> [T; 6] {
    let mut state = Vector6::from(*z);
    innovations::through_stage(at_stage, measured, measurement, &mut state, innovations);
    *z = state.into();
    shift.force_to_parent(&state).into()
}
