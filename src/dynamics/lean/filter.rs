//! Tip to base: Riccati recursion and filter in one pass, and the torques that forces need.

use super::afloat;
use super::body::{Carrier, LeanBody, LeanModel};
use super::motion::{cross, minus_cross_number};
use super::scratch::{Arriving, Besides, LeanScratch, Own, Watched, Watching, arrive, arrive_after};
use super::segment::Segment;
use super::turn::{Axis, Turn, about, packed_to_parent, to_parent};
use crate::filter::pivots::{PivotMonitor, Scale};
use crate::filter::riccati::{self, Measured};
use crate::filter::rounding::squares;
use crate::filter::{HingeMap, System, innovations, terms};
use crate::scalar::Real;
use crate::scene::Model;
use crate::spatial::{RigidShift, Symmetric3, Symmetric6, absolute};
use nalgebra::{Matrix3, Vector6};

/// The row of a turn.
pub(super) const ABOUT_Z: usize = 2;

/// Only the factor: D and g of each row.
pub(super) const FACTOR: usize = 0;
/// The factor and the filter of one right side.
pub(super) const FILTER: usize = 1;
/// The factor, and the filters of the right side and of the weights.
pub(super) const WATCH: usize = 2;

/// The noise of one row's measurement.
#[derive(Clone, Copy)]
struct Noise<T> {
    variance: T,
    /// Whether row and column 2 of P^+ are zero and not formed.
    skips_zeros: bool,
}

impl<T: Real> Noise<T> {
    #[inline(always)]
    fn of(system: &System<T>, variance: T) -> Self {
        Self { variance, skips_zeros: system.skips_zeros_at(variance) }
    }
}

/// What a sweep inward reads and writes.
struct Inward<'a, T: Real> {
    system: &'a System<T>,
    /// The system's, as long as `measured`.
    noise: &'a [T],
    arriving: &'a mut [Arriving<T>],
    shifts: &'a [RigidShift<T>],
    measured: &'a mut [Measured<T>],
    tau: &'a [T],
    innovations: &'a mut [T],
    /// Of the second right side: what arrives, w and e^-.
    besides: &'a mut [Besides<T>],
    weights: &'a [T],
    weighed: &'a mut [T],
    monitor: PivotMonitor<T>,
    near: PivotMonitor<T>,
}

/// Every stage's measurements (3.6, 4.2, 4.5) and the way to its parent; `innovations` receives e^-. `SIDES` is [`FACTOR`], [`FILTER`] or
/// [`WATCH`]. The pivots, and, watched, whether a single look may do. Of a turn D, g and e^- are those about its z.
#[inline(always)]
pub(super) fn tip_to_base<T: Real, const SIDES: usize>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    tau: &[T],
    innovations: &mut [T],
) -> [PivotMonitor<T>; 2] {
    let LeanScratch { own, arriving, shifts, measured, watching, .. } = scratch;
    // Of one length, for the compiler to see: a row of one is a row of all.
    let rows = measured.len();
    let noise = &model.system.noise[..rows];
    let (tau, innovations) =
        if SIDES >= FILTER { (&tau[..rows], &mut innovations[..rows]) } else { (tau, innovations) };
    let Watching { weights, innovations: weighed, arriving: besides, own: watched, .. } = watching;
    let (weights, weighed) =
        if SIDES == WATCH { (&weights[..rows], &mut weighed[..rows]) } else { (&weights[..], &mut weighed[..]) };
    let slots = arriving.len();
    let mut inward = Inward {
        system: &model.system,
        noise,
        arriving,
        shifts,
        measured,
        tau,
        innovations,
        besides: &mut besides[..slots],
        weights,
        weighed,
        monitor: PivotMonitor::new(),
        near: PivotMonitor::for_a_single_look(),
    };
    for ((body, own), watched) in lean.swept().iter().zip(own).zip(watched).rev() {
        match body.carrier {
            Carrier::Turn(_) => inward.about_z::<SIDES>(body, own, watched),
            Carrier::Shift(_) if body.is_about_z => inward.about_z::<SIDES>(body, own, watched),
            Carrier::Shift(_) if afloat::is_noise_free(body.is_afloat, body.row, &model.system) => {
                inward.afloat::<SIDES>(body, own, watched);
            }
            Carrier::Shift(at) => inward.shift::<SIDES>(body, (own, watched), at),
        }
    }
    [inward.monitor, inward.near]
}

impl<T: Real> Inward<'_, T> {
    /// A body that turns about its z.
    #[inline(always)]
    fn about_z<const SIDES: usize>(
        &mut self,
        body: &LeanBody<T::Parameter>,
        own: &mut Own<T>,
        watched: &mut Watched<T>,
    ) {
        let noise = Noise::of(self.system, self.noise[body.row]);
        // All of it in each arm: what both begin with would be there at once, and not in registers.
        if noise.skips_zeros {
            self.about_z_past::<SIDES, false>(body, noise, own, watched);
        } else {
            self.about_z_past::<SIDES, true>(body, noise, own, watched);
        }
    }

    /// The same; whether row and column 2 of P^+ are there is known.
    ///
    /// P leaves before anything is written: the compiler could take that for P's, and would read all of it before.
    #[inline(always)]
    fn about_z_past<const SIDES: usize, const NOISY: bool>(
        &mut self,
        body: &LeanBody<T::Parameter>,
        noise: Noise<T>,
        own: &mut Own<T>,
        watched: &mut Watched<T>,
    ) {
        let (row, turn) = (body.row, own.turn);
        let noise = Noise { skips_zeros: !NOISY, ..noise };
        let arrived = &self.arriving[body.places.inward];
        let (m, column) = measured(noise, &pivot_column(body, &arrived.p));
        let (scale, sent_scale) = (scale_of(body, &arrived.scale), sent(body, &diagonal(body, &arrived.p)));
        let mut kept_diagonal = m.gain;
        if SIDES == WATCH {
            kept_diagonal = diagonal_past(noise, &diagonal(body, &arrived.p), &column, &m);
        }
        if body.parent.is_some() {
            let p = with_noise(body, &arrived.p);
            let to = &mut self.arriving[body.places.parent_inward];
            match body.carrier {
                Carrier::Turn(axis) => {
                    // Not all of it for each axis, which takes no less time here and the compiler more.
                    let sent = carried::<T, NOISY>(body, turn, &p, &column, (&m, noise.variance));
                    about!(axis, X, Y, Z, arrive(body, &packed_to_parent::<T, X, Y, Z>(&sent), &mut to.p));
                }
                Carrier::Shift(at) => {
                    let kept = unpacked(&kept::<T, NOISY>(&p, &column, (&m, noise.variance)));
                    let shift = &self.shifts[at];
                    let sent =
                        if NOISY { shift.inertia_to_parent(&kept) } else { shift.inertia_to_parent_past_z(&kept) };
                    arrive(body, &packed(&sent), &mut to.p);
                }
            }
            arrive_bounds(body, sent_scale, &mut to.scale);
        }
        self.monitor.observe(m.pivot, &HingeMap::Axis(ABOUT_Z), &scale);
        if SIDES >= FILTER {
            let z = sum(own.force, &self.arriving[body.places.inward].force);
            let sense = z[0].everywhere(body.sense);
            let (e, force) = measure(noise, &m, sense * self.tau[row], &z);
            if body.parent.is_some() {
                let to = &mut self.arriving[body.places.parent_inward];
                match body.carrier {
                    Carrier::Turn(axis) => {
                        let sent = in_joint_frame(body.lever_if_any(), turn, &force);
                        about!(axis, X, Y, Z, arrive(body, &to_parent::<T, X, Y, Z>(&sent), &mut to.force));
                    }
                    Carrier::Shift(at) => {
                        arrive(body, &self.shifts[at].force_to_parent(&force.into()).into(), &mut to.force);
                    }
                }
            }
            self.innovations[row] = e;
            if SIDES == WATCH {
                own.force = force;
                self.near.observe(m.pivot, &HingeMap::Axis(ABOUT_Z), &scale);
            }
        }
        self.measured[row] = m;
        if SIDES == WATCH {
            self.watch_about_z(body, turn, &kept_diagonal, watched);
        }
    }

    /// What is watched besides of such a body, after P has left it.
    #[inline(always)]
    fn watch_about_z(
        &mut self,
        body: &LeanBody<T::Parameter>,
        turn: Turn<T>,
        kept_diagonal: &Vector6<T>,
        watched: &mut Watched<T>,
    ) {
        let row = body.row;
        let arrived = &self.besides[body.places.inward];
        let sense = arrived.terms[0].everywhere(body.sense);
        watched.terms = sum(terms_of_noise(body, sense), &arrived.terms);
        let noise = Noise::of(self.system, self.noise[row]);
        let zeta;
        (self.weighed[row], zeta) = measure(noise, &self.measured[row], sense * self.weights[row], &arrived.zeta);
        watched.zeta = squares(&zeta.into());
        if body.parent.is_none() {
            return;
        }
        let to = &mut self.besides[body.places.parent_inward];
        match body.carrier {
            Carrier::Turn(axis) => {
                let (terms, zeta) = (sent_terms(body, kept_diagonal), in_joint_frame(body.lever_if_any(), turn, &zeta));
                about!(axis, X, Y, Z, {
                    arrive(body, &to_parent::<T, X, Y, Z>(&terms), &mut to.terms);
                    arrive(body, &to_parent::<T, X, Y, Z>(&zeta), &mut to.zeta);
                });
            }
            Carrier::Shift(at) => {
                let shift = &self.shifts[at];
                arrive(body, &terms::sent(&absolute(kept_diagonal), shift).into(), &mut to.terms);
                arrive(body, &shift.force_to_parent(&zeta.into()).into(), &mut to.zeta);
            }
        }
    }

    /// A body that floats.
    #[inline(always)]
    fn afloat<const SIDES: usize>(
        &mut self,
        body: &LeanBody<T::Parameter>,
        own: &mut Own<T>,
        watched: &mut Watched<T>,
    ) {
        let (arrived, rows) = (&self.arriving[body.places.inward], afloat::rows(body.row));
        let measured = &mut self.measured[rows.clone()];
        let scale = scale_of(body, &arrived.scale);
        afloat::measure(with_noise(body, &arrived.p), &scale, measured, &mut self.monitor);
        if SIDES >= FILTER {
            own.force = sum(own.force, &arrived.force);
            afloat::filter(measured, &self.tau[rows.clone()], &mut own.force, &mut self.innovations[rows.clone()]);
        }
        if SIDES == WATCH {
            self.near.observe_stage(&self.system.stages[body.index], self.measured, &scale);
            let Besides { terms, mut zeta } = self.besides[body.places.inward];
            watched.terms = sum(terms_of_noise(body, terms[0]), &terms);
            let weights = &self.weights[rows.clone()];
            afloat::filter(&self.measured[rows.clone()], weights, &mut zeta, &mut self.weighed[rows]);
            watched.zeta = squares(&zeta.into());
        }
    }

    /// Any other body.
    #[inline(always)]
    fn shift<const SIDES: usize>(
        &mut self,
        body: &LeanBody<T::Parameter>,
        (own, watched): (&mut Own<T>, &mut Watched<T>),
        at: usize,
    ) {
        let (shift, stage) = (&self.shifts[at], &self.system.stages[body.index]);
        let arrived = &self.arriving[body.places.inward];
        let arrived_force = arrived.force;
        let mut p = unpacked(&with_noise(body, &arrived.p));
        let scale = scale_of(body, &arrived.scale);
        let (sent, before) = (Scale::sent_by(&p, shift), p.diagonal());
        let at_stage = (self.system, body.index);
        let carried = riccati::through_stage::<T, false>(
            at_stage,
            shift,
            (&mut p, &scale),
            self.measured,
            &mut self.monitor,
            |_, _| {},
        );
        let to = &mut self.arriving[body.places.parent_inward];
        if body.parent.is_some() {
            arrive_bounds(body, sent, &mut to.scale);
            arrive(body, &packed(&carried), &mut to.p);
        }
        if SIDES >= FILTER {
            own.force = sum(own.force, &arrived_force);
            let right_side = (self.tau, &mut *self.innovations);
            let sent = through_general_stage(at_stage, shift, self.measured, right_side, &mut own.force);
            if body.parent.is_some() {
                arrive(body, &sent, &mut to.force);
            }
        }
        if SIDES == WATCH {
            self.near.observe_stage(stage, self.measured, &scale);
            let Besides { terms, mut zeta } = self.besides[body.places.inward];
            watched.terms = sum(terms_of_noise(body, terms[0]), &terms);
            let right_side = (self.weights, &mut *self.weighed);
            let sent = through_general_stage(at_stage, shift, self.measured, right_side, &mut zeta);
            watched.zeta = squares(&zeta.into());
            if body.parent.is_some() {
                let to = &mut self.besides[body.places.parent_inward];
                arrive(body, &sent, &mut to.zeta);
                let terms = terms::sent(&terms::left(stage, &before, &p), shift);
                arrive(body, &terms.into(), &mut to.terms);
            }
        }
    }
}

/// Tip to base, open loop: the torque H z of every row, z carried inward (1.5).
#[inline(always)]
pub(super) fn predict<T: Real>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    torques: &mut [T],
) {
    let LeanScratch { own, shifts, .. } = scratch;
    let bodies = &lean.segments[..];
    let own = &mut own[..bodies.len()];
    for (place, body) in bodies.iter().enumerate().rev() {
        let Own { turn, force } = own[place];
        let to = if body.parent > 0 { Some(&mut own[body.parent - 1].force) } else { None };
        match body.carrier {
            Carrier::Turn(axis) => about!(axis, X, Y, Z, {
                torques[body.row] = force[ABOUT_Z] * force[ABOUT_Z].everywhere(body.sense);
                if let Some(to) = to {
                    send_force::<T, X, Y, Z>(body, turn, &force, to);
                }
            }),
            Carrier::Shift(at) => {
                let (force, stage) = (Vector6::from(force), &model.system.stages[body.index]);
                for i in 0..stage.rows.count() {
                    torques[body.row + i] = stage.rows.row(i).project(&force);
                }
                if let Some(to) = to {
                    arrive_after(&lean.swept()[place], false, &shifts[at].force_to_parent(&force).into(), to);
                }
            }
        }
    }
}

/// Adds a force across a turn to what its parent has.
#[inline(always)]
fn send_force<T: Real, const X: usize, const Y: usize, const Z: usize>(
    body: &Segment<T::Parameter>,
    turn: Turn<T>,
    force: &[T; 6],
    to: &mut [T; 6],
) {
    let (like, [x, y, z]) = (force[0], body.lever::<X, Y, Z>());
    let lever = [like.everywhere(x), like.everywhere(y), like.everywhere(z)];
    if T::LIMBS > 1 && body.limbs > 1 {
        // One after another, as where they are bodies by themselves.
        for limb in (0..body.limbs).rev() {
            let [a, b, c, d, e, f] = *force;
            let force =
                [a.of_limb(limb), b.of_limb(limb), c.of_limb(limb), d.of_limb(limb), e.of_limb(limb), f.of_limb(limb)];
            let lever = [lever[0].of_limb(limb), lever[1].of_limb(limb), lever[2].of_limb(limb)];
            let turn = Turn { s: turn.s.of_limb(limb), c: turn.c.of_limb(limb) };
            *to = with_force::<T, X, Y, Z>((lever, body.has_lever), turn, &force, to);
        }
        return;
    }
    let mut force = *force;
    if T::LIMBS > 1 && !body.is_on_all_limbs {
        // Nothing from a limb that has no such body: a sum with products of zero changes no bit.
        for number in &mut force {
            *number *= like.everywhere(body.stands_for_itself);
        }
    }
    *to = with_force::<T, X, Y, Z>((lever, body.has_lever), turn, &force, to);
}

/// What a parent has and a force across a turn: what was there comes in where the sum begins, so that nothing waits for it.
#[inline(always)]
fn with_force<T: Real, const X: usize, const Y: usize, const Z: usize>(
    (lever, has_lever): ([T; 3], bool),
    turn: Turn<T>,
    force: &[T; 6],
    to: &[T; 6],
) -> [T; 6] {
    let Turn { s, c } = turn;
    let [nx, ny, nz, ..] = *force;
    let f = turn.rotate([force[3], force[4], force[5]]);
    let mut n = [c.mul_add(nx, to[X]).minus_product(s, ny), s.mul_add(nx, c.mul_add(ny, to[Y])), nz + to[Z]];
    if has_lever {
        n = cross(lever, f, n);
    }
    let mut sum = *to;
    (sum[X], sum[Y], sum[Z]) = (n[0], n[1], n[2]);
    (sum[3 + X], sum[3 + Y], sum[3 + Z]) = (f[0] + to[3 + X], f[1] + to[3 + Y], f[2] + to[3 + Z]);
    sum
}

/// As [`arrive`], of the bounds.
#[inline(always)]
fn arrive_bounds<T: Real>(body: &LeanBody<T::Parameter>, sent: Scale<T>, to: &mut Scale<T>) {
    let mut sum = [to.angular, to.linear];
    arrive(body, &[sent.angular, sent.linear], &mut sum);
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

/// The bound on the terms of P^-: of M(k), and of what arrived.
#[inline(always)]
fn scale_of<T: Real>(body: &LeanBody<T::Parameter>, arrived: &Scale<T>) -> Scale<T> {
    let [angular, linear] = body.scale;
    arrived.sum(&Scale { angular: arrived.angular.everywhere(angular), linear: arrived.linear.everywhere(linear) })
}

/// M(k), of which six entries are zero, and what arrived.
#[inline(always)]
fn with_noise<T: Real>(body: &LeanBody<T::Parameter>, arrived: &[T; 21]) -> [T; 21] {
    let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *arrived;
    let [xx, xy, xz, yy, yz, zz] = body.rotational;
    let [x, y, z] = body.first_moment;
    let (x, y, z, m) = (a0.everywhere(x), a0.everywhere(y), a0.everywhere(z), a0.everywhere(body.mass));
    [
        a0 + a0.everywhere(xx),
        a1 + a0.everywhere(xy),
        a2 + a0.everywhere(xz),
        a3 + a0.everywhere(yy),
        a4 + a0.everywhere(yz),
        a5 + a0.everywhere(zz),
        c0,
        c1 - z,
        c2 + y,
        c3 + z,
        c4,
        c5 - x,
        c6 - y,
        c7 + x,
        c8,
        b0 + m,
        b1,
        b2,
        b3 + m,
        b4,
        b5 + m,
    ]
}

/// Of the same P^- column 2, which H picks.
#[inline(always)]
fn pivot_column<T: Real>(body: &LeanBody<T::Parameter>, arrived: &[T; 21]) -> [T; 6] {
    let [_, _, xz, _, yz, zz] = body.rotational;
    let (like, [x, y, _]) = (arrived[5], body.first_moment);
    [
        arrived[2] + like.everywhere(xz),
        arrived[4] + like.everywhere(yz),
        arrived[5] + like.everywhere(zz),
        arrived[12] - like.everywhere(y),
        arrived[13] + like.everywhere(x),
        arrived[14],
    ]
}

/// And the diagonal.
#[inline(always)]
fn diagonal<T: Real>(body: &LeanBody<T::Parameter>, arrived: &[T; 21]) -> [T; 6] {
    let [xx, _, _, yy, _, zz] = body.rotational;
    let like = arrived[0];
    let m = like.everywhere(body.mass);
    [
        arrived[0] + like.everywhere(xx),
        arrived[3] + like.everywhere(yy),
        arrived[5] + like.everywhere(zz),
        arrived[15] + m,
        arrived[18] + m,
        arrived[20] + m,
    ]
}

/// The terms of the diagonal of M(k).
#[inline(always)]
fn terms_of_noise<T: Real>(body: &LeanBody<T::Parameter>, like: T) -> [T; 6] {
    let [a, b, c, d, e, f] = body.terms;
    [
        like.everywhere(a),
        like.everywhere(b),
        like.everywhere(c),
        like.everywhere(d),
        like.everywhere(e),
        like.everywhere(f),
    ]
}

/// As [`terms::sent`] of a stage on a turn with this diagonal of P^+, in the joint's frame: about z, each of x and y takes from both.
#[inline(always)]
fn sent_terms<T: Real>(body: &LeanBody<T::Parameter>, kept: &Vector6<T>) -> [T; 6] {
    let like = kept[0];
    let four = like.constant(terms::SPREAD);
    let [x, y, z] = body.lever_squares;
    let (x, y, z) = (like.everywhere(x), like.everywhere(y), like.everywhere(z));
    let (across, along) = (four * (kept[3].abs() + kept[4].abs()), four * kept[5].abs());
    let turned = four * (kept[0].abs() + kept[1].abs());
    [
        y.mul_add(along, z.mul_add(across, turned)),
        x.mul_add(along, z.mul_add(across, turned)),
        (x + y).mul_add(across, four * kept[2].abs()),
        across,
        across,
        along,
    ]
}

/// D and g of a turn (3.6, 3.10), with P^- H^T but for the entry that H picks.
#[inline(always)]
fn measured<T: Real>(noise: Noise<T>, &[c0, c1, c2, c3, c4, c5]: &[T; 6]) -> (Measured<T>, [T; 5]) {
    let pivot = c2 + noise.variance;
    let pivot_inverse = pivot.recip();
    let column = [c0, c1, c3, c4, c5];
    let own = if noise.skips_zeros { pivot.constant(1.0) } else { c2 * pivot_inverse };
    let gain = Vector6::new(
        column[0] * pivot_inverse,
        column[1] * pivot_inverse,
        own,
        column[2] * pivot_inverse,
        column[3] * pivot_inverse,
        column[4] * pivot_inverse,
    );
    (Measured { pivot, pivot_inverse, gain }, column)
}

/// The diagonal of P^+, of that of P^-.
#[inline(always)]
fn diagonal_past<T: Real>(
    noise: Noise<T>,
    &[p0, p1, _, p3, p4, p5]: &[T; 6],
    [ph0, ph1, ph3, ph4, ph5]: &[T; 5],
    m: &Measured<T>,
) -> Vector6<T> {
    let g = &m.gain;
    let own = if noise.skips_zeros { g[2].constant(0.0) } else { noise.variance * g[2] };
    Vector6::new(
        p0.minus_product(g[0], *ph0),
        p1.minus_product(g[1], *ph1),
        own,
        p3.minus_product(g[3], *ph3),
        p4.minus_product(g[4], *ph4),
        p5.minus_product(g[5], *ph5),
    )
}

/// The filter across a turn: e^- (4.2), and z^+ of z^- (4.5).
#[inline(always)]
fn measure<T: Real>(noise: Noise<T>, m: &Measured<T>, measurement: T, z: &[T; 6]) -> (T, [T; 6]) {
    let e = measurement - z[ABOUT_Z];
    let g = &m.gain;
    // H z^+ = tau - (r / D) e^-, which a sum with a large H z^- would not give.
    let own =
        if noise.skips_zeros { measurement } else { measurement.minus_product(e, noise.variance * m.pivot_inverse) };
    let z = [
        g[0].mul_add(e, z[0]),
        g[1].mul_add(e, z[1]),
        own,
        g[3].mul_add(e, z[3]),
        g[4].mul_add(e, z[4]),
        g[5].mul_add(e, z[5]),
    ];
    (e, z)
}

/// What P^- of a stage can bring to the entries of its parent, as [`Scale::sent_by`] has it.
#[inline(always)]
fn sent<T: Real>(body: &LeanBody<T::Parameter>, diagonal: &[T; 6]) -> Scale<T> {
    let [p0, p1, p2, p3, p4, p5] = *diagonal;
    let (like, four) = (p0, p0.constant(4.0));
    let (a, b) = (p0 + p1 + p2, p3 + p4 + p5);
    Scale { angular: four * b.mul_add(like.everywhere(body.lever_square), a), linear: four * b }
}

/// P^+ = P^- - g H P^- past a turn about z (3.6): the five rows that H does not pick. Row and column 2 are zero, or where `NOISY` r g, by which
/// they are given.
#[inline(always)]
fn kept<T: Real, const NOISY: bool>(
    p: &[T; 21],
    [ph0, ph1, ph3, ph4, ph5]: &[T; 5],
    (m, r): (&Measured<T>, T),
) -> [T; 21] {
    let g = &m.gain;
    let [a0, a1, _, a3, _, _, c0, c1, c2, c3, c4, c5, _, _, _, b0, b1, b2, b3, b4, b5] = *p;
    let o = ph0.constant(0.0);
    let [a2, a4, a5, c6, c7, c8] =
        if NOISY { [r * g[0], r * g[1], r * g[2], r * g[3], r * g[4], r * g[5]] } else { [o; 6] };
    [
        a0.minus_product(g[0], *ph0),
        a1.minus_product(g[0], *ph1),
        a2,
        a3.minus_product(g[1], *ph1),
        a4,
        a5,
        c0.minus_product(g[0], *ph3),
        c1.minus_product(g[0], *ph4),
        c2.minus_product(g[0], *ph5),
        c3.minus_product(g[1], *ph3),
        c4.minus_product(g[1], *ph4),
        c5.minus_product(g[1], *ph5),
        c6,
        c7,
        c8,
        b0.minus_product(g[3], *ph3),
        b1.minus_product(g[3], *ph4),
        b2.minus_product(g[3], *ph5),
        b3.minus_product(g[4], *ph4),
        b4.minus_product(g[4], *ph5),
        b5.minus_product(g[5], *ph5),
    ]
}

/// [`kept`] of a turn, about z and along the lever.
#[inline(always)]
#[allow(clippy::too_many_lines)] // 21 entries, each in its place
fn carried<T: Real, const NOISY: bool>(
    body: &LeanBody<T::Parameter>,
    turn: Turn<T>,
    p: &[T; 21],
    column: &[T; 5],
    (m, variance): (&Measured<T>, T),
) -> [T; 21] {
    let o = column[0].constant(0.0);
    let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] =
        kept::<T, NOISY>(p, column, (m, variance));
    // About z.
    let (a0, a1, a3) = turn.symmetric((a0, a1, a3));
    let (b0, b1, b3) = turn.symmetric((b0, b1, b3));
    let (b2, b4) = turn.pair(b2, b4);
    let [c0, c1, c3, c4] = turn.square([c0, c1, c3, c4]);
    let (c2, c5) = turn.pair(c2, c5);
    let (mut a2, mut a4, mut a5, mut c6, mut c7, c8) = (a2, a4, a5, c6, c7, c8);
    if NOISY {
        (a2, a4) = turn.pair(a2, a4);
        (c6, c7) = turn.pair(c6, c7);
    }
    if !body.has_lever {
        return [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5];
    }
    // Along the lever: C' = C + l~ B, A' = A + l~ C^T + C' l~^T.
    let [x, y, z] = body.lever;
    let (x, y, z) = (o.everywhere(x), o.everywhere(y), o.everywhere(z));
    let s0 = y.mul_add(b2, c0.minus_product(z, b1));
    let s1 = y.mul_add(b4, c1.minus_product(z, b3));
    let s2 = y.mul_add(b5, c2.minus_product(z, b4));
    let s3 = z.mul_add(b0, c3.minus_product(x, b2));
    let s4 = z.mul_add(b1, c4.minus_product(x, b4));
    let s5 = z.mul_add(b2, c5.minus_product(x, b5));
    let s6 = x.mul_add(b1, c6.minus_product(y, b0));
    let s7 = x.mul_add(b3, c7.minus_product(y, b1));
    let s8 = x.mul_add(b4, c8.minus_product(y, b2));
    let a0 = y.mul_add(s2 + c2, a0.minus_product(z, s1 + c1));
    let a1 = z.mul_add(s0, y.mul_add(c5, a1.minus_product(z, c4)).minus_product(x, s2));
    let a3 = z.mul_add(s3 + c3, a3.minus_product(x, s5 + c5));
    if NOISY {
        a2 = y.mul_add(c8, a2.minus_product(z, c7));
        a4 = z.mul_add(c6, a4.minus_product(x, c8));
        a5 = x.mul_add(c7, a5.minus_product(y, c6));
    }
    let a2 = x.mul_add(s1, a2.minus_product(y, s0));
    let a4 = x.mul_add(s4, a4.minus_product(y, s3));
    let a5 = x.mul_add(s7, a5.minus_product(y, s6));
    [a0, a1, a2, a3, a4, a5, s0, s1, s2, s3, s4, s5, s6, s7, s8, b0, b1, b2, b3, b4, b5]
}

/// A force in the joint's frame, about the parent's origin: at the end of this lever, if it has one.
#[inline(always)]
pub(super) fn in_joint_frame<T: Real>(lever: Option<[T::Parameter; 3]>, turn: Turn<T>, z: &[T; 6]) -> [T; 6] {
    let force = turn.rotate([z[3], z[4], z[5]]);
    let moment = turn.rotate([z[0], z[1], z[2]]);
    // l x f = - f x l.
    let [a, b, c] = if let Some(lever) = lever { minus_cross_number(force, lever, moment) } else { moment };
    [a, b, c, force[0], force[1], force[2]]
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

/// As the general stages take it.
#[inline(always)]
pub(super) fn unpacked<T: Real>(p: &[T; 21]) -> Symmetric6<T> {
    let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *p;
    Symmetric6 {
        angular: Symmetric3::new([a0, a1, a2, a3, a4, a5]),
        coupling: Matrix3::new(c0, c1, c2, c3, c4, c5, c6, c7, c8),
        linear: Symmetric3::new([b0, b1, b2, b3, b4, b5]),
    }
}

/// As these sweeps take it.
#[inline(always)]
pub(super) fn packed<T: Real>(p: &Symmetric6<T>) -> [T; 21] {
    let ([a0, a1, a2, a3, a4, a5], [b0, b1, b2, b3, b4, b5], c) = (p.angular.entries, p.linear.entries, &p.coupling);
    [
        a0,
        a1,
        a2,
        a3,
        a4,
        a5,
        c[(0, 0)],
        c[(0, 1)],
        c[(0, 2)],
        c[(1, 0)],
        c[(1, 1)],
        c[(1, 2)],
        c[(2, 0)],
        c[(2, 1)],
        c[(2, 2)],
        b0,
        b1,
        b2,
        b3,
        b4,
        b5,
    ]
}
