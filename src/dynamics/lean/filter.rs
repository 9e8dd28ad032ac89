//! Tip to base: Riccati recursion and filter in one pass, and the torques that forces need.

use super::body::{Carrier, LeanBody, LeanModel};
use super::scratch::{Covariance, LeanScratch};
use super::turn::{BRANCH, Renaming, TABLE, Turn};
use crate::filter::pivots::{PivotMonitor, Scale};
use crate::filter::riccati::{self, Measured};
use crate::filter::{HingeMap, System, innovations, terms};
use crate::scalar::Real;
use crate::scene::Model;
use crate::spatial::{RigidShift, Symmetric3, Symmetric6};
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
    fn of(system: &System<T>, row: usize) -> Self {
        Self { variance: system.noise[row], skips_zeros: system.skips_zeros_of(row) }
    }
}

/// Every stage's measurements (3.6, 4.2, 4.5) and the way to its parent; `innovations` receives e^-. `SIDES` is [`FACTOR`], [`FILTER`] or
/// [`WATCH`]. The pivots, and, watched, whether a single look may do.
#[inline(always)]
pub(super) fn tip_to_base<T: Real, const SIDES: usize>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    tau: &[T],
    innovations: &mut [T],
) -> [PivotMonitor<T>; 2] {
    let (mut monitor, mut near) = (PivotMonitor::new(), PivotMonitor::for_a_single_look());
    let like = T::zero();
    for (k, body) in lean.bodies.iter().enumerate().rev() {
        let Covariance { p, scale } =
            if body.is_leaf { noise_of(body, like) } else { scratch.covariances[body.inward] };
        if SIDES == WATCH && body.is_leaf {
            scratch.watching.terms[k] = terms_of_noise(body, like);
            scratch.watching.zeta[k] = [like; 6];
        }
        if body.arrives_first
            && let Some(parent) = body.parent
        {
            scratch.covariances[body.parent_inward] = noise_of(&lean.bodies[parent], like);
            if SIDES == WATCH {
                scratch.watching.terms[parent] = terms_of_noise(&lean.bodies[parent], like);
                scratch.watching.zeta[parent] = [like; 6];
            }
        }
        match &body.carrier {
            Carrier::Turn(renaming) => {
                let turn = scratch.turns[k];
                let row = body.row;
                let noise = Noise::of(&model.system, row);
                let (m, column) = measured(noise, &p);
                scratch.measured[row] = m;
                monitor.observe(m.pivot, &HingeMap::Axis(ABOUT_Z), &scale);
                if SIDES == WATCH {
                    near.observe(m.pivot, &HingeMap::Axis(ABOUT_Z), &scale);
                }
                if SIDES >= FILTER {
                    innovations[row] = measure(noise, &m, tau[row], &mut scratch.forces[k]);
                }
                if SIDES == WATCH {
                    let watching = &mut scratch.watching;
                    watching.innovations[row] = measure(noise, &m, watching.weights[row], &mut watching.zeta[k]);
                }
                let Some(parent) = body.parent else { continue };
                let at_parent = &mut scratch.covariances[body.parent_inward];
                at_parent.scale.add(&sent(body, &p, like));
                if SIDES == WATCH {
                    let sent = sent_terms(body, &kept_diagonal(noise, &p, &column, &m));
                    add_each(&renaming.sizes(&sent), &mut scratch.watching.terms[parent]);
                }
                if noise.skips_zeros {
                    carry::<T, false>(body, renaming, turn, &p, &column, (&m, noise.variance), &mut at_parent.p);
                } else {
                    carry::<T, true>(body, renaming, turn, &p, &column, (&m, noise.variance), &mut at_parent.p);
                }
                if SIDES >= FILTER {
                    let sent = in_joint_frame(body, turn, &scratch.forces[k]);
                    add_force::<_, T, BRANCH>(renaming, sent, &mut scratch.forces[parent]);
                }
                if SIDES == WATCH {
                    let sent = in_joint_frame(body, turn, &scratch.watching.zeta[k]);
                    add_force::<_, T, BRANCH>(renaming, sent, &mut scratch.watching.zeta[parent]);
                }
            }
            Carrier::Shift(at) => {
                let shift = &scratch.shifts[*at];
                let mut p = unpacked(&p);
                let (sent, before) = (Scale::sent_by(&p, shift), p.diagonal());
                let at_stage = (&model.system, k);
                let measured = &mut scratch.measured;
                let carried = riccati::through_stage::<T, false>(
                    at_stage,
                    shift,
                    (&mut p, &scale),
                    measured,
                    &mut monitor,
                    |_, _| {},
                );
                if SIDES == WATCH {
                    near.observe_stage(&model.system.stages[k], measured, &scale);
                }
                if SIDES >= FILTER {
                    through_general_stage(at_stage, shift, measured, (tau, innovations), &mut scratch.forces);
                }
                if SIDES == WATCH {
                    let watching = &mut scratch.watching;
                    let right_side = (&watching.weights[..], &mut watching.innovations[..]);
                    through_general_stage(at_stage, shift, measured, right_side, &mut watching.zeta);
                }
                if let Some(parent) = body.parent {
                    let at_parent = &mut scratch.covariances[body.parent_inward];
                    at_parent.scale.add(&sent);
                    if SIDES == WATCH {
                        let left = terms::left(&model.system.stages[k], &before, &p);
                        let sent = terms::sent(&left, shift).into();
                        add_each(&sent, &mut scratch.watching.terms[parent]);
                    }
                    add_packed(&carried, &mut at_parent.p);
                }
            }
        }
    }
    [monitor, near]
}

/// Tip to base, open loop: the torque H z of every row, z carried inward (1.5).
#[inline(always)]
pub(super) fn predict<T: Real>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    torques: &mut [T],
) {
    for (k, body) in lean.bodies.iter().enumerate().rev() {
        match &body.carrier {
            Carrier::Turn(renaming) => {
                let force = &scratch.forces[k];
                torques[body.row] = force[ABOUT_Z];
                if let Some(parent) = body.parent {
                    let sent = in_joint_frame(body, scratch.turns[k], force);
                    add_force::<_, T, BRANCH>(renaming, sent, &mut scratch.forces[parent]);
                }
            }
            Carrier::Shift(at) => {
                let force = Vector6::from(scratch.forces[k]);
                let stage = &model.system.stages[k];
                for i in 0..stage.rows.count() {
                    torques[body.row + i] = stage.rows.row(i).project(&force);
                }
                if let Some(parent) = body.parent {
                    add_vector(&scratch.shifts[*at].force_to_parent(&force), &mut scratch.forces[parent]);
                }
            }
        }
    }
}

/// M(k), and the bounds on its terms.
#[inline(always)]
fn noise_of<T: Real>(body: &LeanBody<T::Parameter>, like: T) -> Covariance<T> {
    let o = like.constant(0.0);
    let [xx, xy, xz, yy, yz, zz] = body.rotational;
    let [x, y, z] = body.first_moment;
    let (x, y, z, m) = (like.everywhere(x), like.everywhere(y), like.everywhere(z), like.everywhere(body.mass));
    Covariance {
        p: [
            like.everywhere(xx),
            like.everywhere(xy),
            like.everywhere(xz),
            like.everywhere(yy),
            like.everywhere(yz),
            like.everywhere(zz),
            o,
            -z,
            y,
            z,
            o,
            -x,
            -y,
            x,
            o,
            m,
            o,
            o,
            m,
            o,
            m,
        ],
        scale: Scale { angular: like.everywhere(body.scale[0]), linear: like.everywhere(body.scale[1]) },
    }
}

/// Without nalgebra's operators, which are not inlined.
#[inline(always)]
fn add_each<T: Real>(x: &[T; 6], to: &mut Vector6<T>) {
    for (i, &x) in x.iter().enumerate() {
        to[i] += x;
    }
}

/// The terms of the diagonal of M(k).
#[inline(always)]
fn terms_of_noise<T: Real>(body: &LeanBody<T::Parameter>, like: T) -> Vector6<T> {
    let [a, b, c, d, e, f] = body.terms;
    let of = |x| like.everywhere(x);
    Vector6::new(of(a), of(b), of(c), of(d), of(e), of(f))
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
fn measured<T: Real>(noise: Noise<T>, p: &[T; 21]) -> (Measured<T>, [T; 5]) {
    let pivot = p[5] + noise.variance;
    let pivot_inverse = pivot.recip();
    let column = [p[2], p[4], p[12], p[13], p[14]];
    let own = if noise.skips_zeros { pivot.constant(1.0) } else { p[5] * pivot_inverse };
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

/// The diagonal of P^+.
#[inline(always)]
fn kept_diagonal<T: Real>(
    noise: Noise<T>,
    p: &[T; 21],
    [ph0, ph1, ph3, ph4, ph5]: &[T; 5],
    m: &Measured<T>,
) -> Vector6<T> {
    let g = &m.gain;
    let own = if noise.skips_zeros { g[2].constant(0.0) } else { noise.variance * g[2] };
    Vector6::new(
        p[0].minus_product(g[0], *ph0),
        p[3].minus_product(g[1], *ph1),
        own,
        p[15].minus_product(g[3], *ph3),
        p[18].minus_product(g[4], *ph4),
        p[20].minus_product(g[5], *ph5),
    )
}

/// The filter across a turn: z^- becomes z^+ (4.5); gives e^- (4.2).
#[inline(always)]
fn measure<T: Real>(noise: Noise<T>, m: &Measured<T>, measurement: T, z: &mut [T; 6]) -> T {
    let e = measurement - z[ABOUT_Z];
    let g = &m.gain;
    // H z^+ = tau - (r / D) e^-, which a sum with a large H z^- would not give.
    let own =
        if noise.skips_zeros { measurement } else { measurement.minus_product(e, noise.variance * m.pivot_inverse) };
    *z = [
        g[0].mul_add(e, z[0]),
        g[1].mul_add(e, z[1]),
        own,
        g[3].mul_add(e, z[3]),
        g[4].mul_add(e, z[4]),
        g[5].mul_add(e, z[5]),
    ];
    e
}

/// What P^- of a stage can bring to the entries of its parent, as [`Scale::sent_by`] has it.
#[inline(always)]
fn sent<T: Real>(body: &LeanBody<T::Parameter>, p: &[T; 21], like: T) -> Scale<T> {
    let four = like.constant(4.0);
    let (a, b) = (p[0] + p[3] + p[5], p[15] + p[18] + p[20]);
    Scale { angular: four * b.mul_add(like.everywhere(body.lever_square), a), linear: four * b }
}

/// P^+ = P^- - g H P^- of a turn, about z, along the lever, renamed, and added to the parent's. Row and column 2 are not formed
/// unless `NOISY`: r g, by which they are given.
#[inline(always)]
#[allow(clippy::too_many_lines)] // 21 entries, each in its place
fn carry<T: Real, const NOISY: bool>(
    body: &LeanBody<T::Parameter>,
    renaming: &Renaming<T::Parameter>,
    turn: Turn<T>,
    p: &[T; 21],
    column: &[T; 5],
    (m, variance): (&Measured<T>, T),
    to: &mut [T; 21],
) {
    let (g, [ph0, ph1, ph3, ph4, ph5]) = (&m.gain, *column);
    let o = ph0.constant(0.0);
    let [a0, a1, _, a3, _, _, c0, c1, c2, c3, c4, c5, _, _, _, b0, b1, b2, b3, b4, b5] = *p;
    // (3.6), the five rows that H does not pick.
    let angular = (a0.minus_product(g[0], ph0), a1.minus_product(g[0], ph1), a3.minus_product(g[1], ph1));
    let upper = [c0.minus_product(g[0], ph3), c1.minus_product(g[0], ph4), c2.minus_product(g[0], ph5)];
    let lower = [c3.minus_product(g[1], ph3), c4.minus_product(g[1], ph4), c5.minus_product(g[1], ph5)];
    let linear = (b0.minus_product(g[3], ph3), b1.minus_product(g[3], ph4), b3.minus_product(g[4], ph4));
    let (b2, b4, b5) = (b2.minus_product(g[3], ph5), b4.minus_product(g[4], ph5), b5.minus_product(g[5], ph5));
    // About z.
    let (a0, a1, a3) = turn.symmetric(angular);
    let (b0, b1, b3) = turn.symmetric(linear);
    let (b2, b4) = turn.pair(b2, b4);
    let (c0, c3) = turn.pair(upper[0], lower[0]);
    let (c1, c4) = turn.pair(upper[1], lower[1]);
    let (c2, c5) = turn.pair(upper[2], lower[2]);
    let (c0, c1) = turn.pair(c0, c1);
    let (c3, c4) = turn.pair(c3, c4);
    // What the noise leaves of the row that H picks.
    let (mut a2, mut a4, mut a5, mut c6, mut c7, mut c8) = (o, o, o, o, o, o);
    if NOISY {
        let r = variance;
        (a2, a4) = turn.pair(r * g[0], r * g[1]);
        a5 = r * g[2];
        (c6, c7) = turn.pair(r * g[3], r * g[4]);
        c8 = r * g[5];
    }
    if !body.has_lever {
        let there = [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5];
        renaming.add_packed(&there, to);
        return;
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
    let there = [a0, a1, a2, a3, a4, a5, s0, s1, s2, s3, s4, s5, s6, s7, s8, b0, b1, b2, b3, b4, b5];
    renaming.add_packed(&there, to);
}

/// A force in the joint's frame, about the parent's origin.
#[inline(always)]
pub(super) fn in_joint_frame<T: Real>(body: &LeanBody<T::Parameter>, turn: Turn<T>, z: &[T; 6]) -> [[T; 3]; 2] {
    let force = turn.rotate([z[3], z[4], z[5]]);
    let moment = turn.rotate([z[0], z[1], z[2]]);
    // l x f = - f x l.
    [if body.has_lever { super::motion::minus_cross_number(force, body.lever, moment) } else { moment }, force]
}

/// Adds it to what is at the parent.
#[inline(always)]
fn add_force<N: Copy, T: Real<Parameter = N>, const BY: bool>(
    renaming: &Renaming<N>,
    [moment, force]: [[T; 3]; 2],
    to: &mut [T; 6],
) {
    renaming.add::<T, BY>(moment, &mut to[..3]);
    renaming.add::<T, BY>(force, &mut to[3..]);
}

/// A force at body `k` as it is at the parent; sweeps over a few bodies, one after another, call it.
#[inline(always)]
pub(super) fn one_inward<T: Real>(
    (k, body): (usize, &LeanBody<T::Parameter>),
    scratch: &LeanScratch<T>,
    force: &[T; 6],
) -> [T; 6] {
    match &body.carrier {
        Carrier::Turn(renaming) => {
            let mut there = [force[0].constant(0.0); 6];
            add_force::<_, T, TABLE>(renaming, in_joint_frame(body, scratch.turns[k], force), &mut there);
            there
        }
        Carrier::Shift(at) => scratch.shifts[*at].force_to_parent(&Vector6::from(*force)).into(),
    }
}

/// The filter at a stage with any joint: its rows, and the way to its parent.
#[inline(always)]
fn through_general_stage<T: Real>(
    (system, k): (&System<T>, usize),
    shift: &RigidShift<T>,
    measured: &[Measured<T>],
    (measurement, innovations): (&[T], &mut [T]),
    z: &mut [[T; 6]],
) {
    let mut state = Vector6::from(z[k]);
    innovations::through_stage((system, k), measured, measurement, &mut state, innovations);
    z[k] = state.into();
    if let Some(parent) = system.stages[k].parent {
        add_vector(&shift.force_to_parent(&state), &mut z[parent]);
    }
}

#[inline(always)]
fn add_vector<T: Real>(x: &Vector6<T>, to: &mut [T; 6]) {
    for (to, &x) in to.iter_mut().zip(x.iter()) {
        *to += x;
    }
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

#[inline(always)]
fn add_packed<T: Real>(p: &Symmetric6<T>, to: &mut [T; 21]) {
    for i in 0..6 {
        to[i] += p.angular.entries[i];
        to[15 + i] += p.linear.entries[i];
    }
    for i in 0..3 {
        for j in 0..3 {
            to[6 + 3 * i + j] += p.coupling[(i, j)];
        }
    }
}
