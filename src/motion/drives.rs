//! The torque of the control law up to its limits of effort.
//!
//! With the displacement x of a joint from its target and the target velocity w, the torque of the law in a step from v
//! to v' = v + h a is that at the end of the step:
//!
//! ```text
//! clip(-kp (x + h v') - kd (v' - w), lower, upper) = clip(c - (kd + h kp) v', lower, upper)
//! ```
//!
//! with limits that can themselves decline with the speed in their direction, min(E, max(S - D v', 0)) upward for the
//! limit of effort E, the stall torque S of a motor and its decline D: one more monotone graph of torque over velocity,
//! beside those of [`stops`](super::stops). During a step the law is on one of its pieces: linear, with the gains as
//! measurement noise, or at a limit, with a constant torque and no noise, or with the decline as noise. The torque at
//! the start of the step determines the piece. The end of the step tests it, and a step that contradicts the pieces of
//! some rows is made again with the pieces that they must change to ([`change_drives`]).

use super::scratch::{DECLINE, KD, KP, LOWER, STALL, Scratch, UPPER};
use super::step_settings::{StepArguments, StepSettings};
use super::stops::{Drive, Line, Piece};
use crate::scalar::{Real, lanes_but, larger};

/// Rounding errors of torques, relative to the torques of the law at a displacement and a velocity of one.
const ROUNDING: f64 = 1e-15;
/// Added to a test of a piece that does not apply.
const ENDLESS: f64 = 1e200;

/// The piece between the limits, 0 and 2, or 3 and 4 where they decline, or 5 and 6 where they are zero.
pub(super) const LINEAR: Piece = Piece::Between(1);

impl<T: Real> Scratch<T> {
    /// Sets the gains that act on a row, the constant torque beside them, and the noise of the row.
    #[inline(always)]
    pub fn drive(&mut self, hg: f64, row: usize, ([kp, kd], held): ([T; 2], T)) {
        let (of, hg) = (&mut self.rows[row], kp.constant(hg));
        (of.proportional, of.derivative, of.held) = (kp, kd, held);
        of.slope = hg * (kd + hg * kp);
        let noise = of.armature + hg * ((of.damping + kd) + hg * (of.stiffness + kp));
        of.noise = if of.has_noise { noise + noise.one_if_zero() * noise.constant(self.vanishing) } else { noise };
        self.model.system.noise[row] = of.noise;
    }

    /// Sets the gains of the state on all rows, without limits.
    #[inline(always)]
    pub fn drive_all(&mut self, settings: &StepSettings, hg: f64) {
        for row in 0..self.rows.len() {
            let zero = self.rows[row].damping.constant(0.0);
            let gains = if settings.gains.is_some() { [KP, KD].map(|i| self.gains[i][row]) } else { [zero; 2] };
            self.drive(hg, row, (gains, zero));
        }
    }

    /// Removes the law from the rows with limits, whose torques the caller determines.
    pub fn release_drives(&mut self, settings: &StepSettings, hg: f64) {
        for &row in &settings.limited {
            let zero = self.rows[row].damping.constant(0.0);
            self.drive(hg, row, ([zero; 2], zero));
        }
    }

    /// The displacements from the targets, at the start of the step or at its end.
    #[inline(always)]
    pub fn displace_from_targets(&mut self, settings: &StepSettings, at_end: bool) {
        let q = if at_end { &self.q_next } else { &self.q };
        for (k, body) in self.model.bodies.iter().enumerate().filter(|(k, _)| settings.controlled_bodies[*k]) {
            let (row, at) = (self.model.system.stages[k].first_row, body.q);
            body.motion.displacement(&self.target[at..], &q[at..], &mut self.displaced_target[row..]);
        }
    }

    /// The limits of the torque of the law on a row. A limit that is infinite never acts.
    #[inline(always)]
    fn limits(&self, settings: &StepSettings, row: usize) -> Limits<T> {
        let upper = self.gains[UPPER][row];
        let endless = upper.constant(ENDLESS);
        Limits {
            effort: [(-self.gains[LOWER][row]).worst(endless), upper.worst(endless)],
            stall: self.gains[STALL][row].worst(endless),
            decline: self.gains[DECLINE][row],
            has_motors: settings.has_motors,
            applied: if settings.limits_sum { self.torque[row] } else { upper.constant(0.0) },
        }
    }

    /// The torque of the law without limits, for the displacement and velocity of a row.
    #[inline(always)]
    fn law(&self, row: usize, displaced: T, v: T) -> T {
        let torque = v.constant(0.0).minus_product(self.gains[KD][row], v - self.target_rate[row]);
        torque.minus_product(self.gains[KP][row], displaced)
    }
}

/// The limits of the sum of the torque of a law and of that applied, in the negative and in the positive direction.
struct Limits<T> {
    effort: [T; 2],
    stall: T,
    decline: T,
    /// False if no limit declines, in any row.
    has_motors: bool,
    applied: T,
}

// Without closures: one that is not inlined is compiled for the baseline.
impl<T: Real> Limits<T> {
    /// The torque of a motor that declines with its speed in a direction, 0 or 1: what the limit is between zero and
    /// the limit of effort.
    #[inline(always)]
    fn declining(&self, side: usize, v: T) -> T {
        self.stall.minus_product(self.decline, if side == 0 { -v } else { v })
    }

    /// The size of the limit of the sum in a direction at velocity v.
    #[inline(always)]
    fn size(&self, side: usize, v: T) -> T {
        let full = self.effort[side];
        if self.has_motors { larger(self.declining(side, v).worst(full), v.constant(0.0)) } else { full }
    }

    /// The lower and the upper limit of the law at velocity v.
    #[inline(always)]
    fn at(&self, v: T) -> [T; 2] {
        [-self.size(0, v) - self.applied, self.size(1, v) - self.applied]
    }

    /// The phase of the limit on a side, 1, -1 or 0, at velocity v: 0 if it is constant, 1 if it declines, 2 if it is
    /// zero.
    #[inline(always)]
    fn phase(&self, side: T, v: T) -> T {
        let (zero, one) = (v.constant(0.0), v.constant(1.0));
        if !self.has_motors {
            return zero;
        }
        let mut phase = zero;
        for (direction, sign) in [(0, -1.0), (1, 1.0)] {
            let torque = self.declining(direction, v);
            let is_less = one - is_none(self.effort[direction] - torque);
            phase = is(side, sign).mul_add(is_less.mul_add(is_none(torque), is_less), phase);
        }
        phase
    }

    /// The margin of the phase of a row at a limit at velocity v, negative if it is in another one.
    #[inline(always)]
    fn margin(&self, (side, phase): (T, T), v: T) -> T {
        let mut margin = v.constant(0.0);
        if !self.has_motors {
            return margin;
        }
        for (direction, sign) in [(0, -1.0), (1, 1.0)] {
            let torque = self.declining(direction, v);
            let below = self.effort[direction] - torque;
            let others = is(phase, 0.0).mul_add(below, is(phase, 2.0) * torque);
            margin = is(side, sign).mul_add((is(phase, 1.0) * below.worst(torque)) - others, margin);
        }
        margin
    }

    /// The torque of the law at a limit, zero for a linear row, for the target velocity that it has there too.
    #[inline(always)]
    fn held(&self, (side, phase): (T, T), rate: T) -> T {
        let mut held = rate.constant(0.0);
        for (direction, sign) in [(0, -1.0), (1, 1.0)] {
            let mut size = self.effort[direction];
            if self.has_motors {
                size = is(phase, 0.0).mul_add(size, is(phase, 1.0) * self.declining(direction, rate));
            }
            held = is(side, sign).mul_add(size.mul_add(size.constant(sign), -self.applied), held);
        }
        held
    }
}

/// 1 if the two are equal, else 0.
#[inline(always)]
fn is<T: Real>(x: T, k: f64) -> T {
    (x - x.constant(k)).one_if_zero()
}

/// 1 for a margin or torque that is zero or negative, else 0.
#[inline(always)]
fn is_none<T: Real>(x: T) -> T {
    larger(x, x.constant(0.0)).one_if_zero()
}

impl Drive {
    /// The law of a row in a step of h from the state in the scratch, from whose target its displacement is known: over
    /// the velocity at the end, or over the mean of those at both ends.
    pub fn of(settings: &StepSettings, s: &Scratch<f64>, (row, is_mean): (usize, bool), h: f64) -> Self {
        let [kp, kd] = [KP, KD].map(|i| s.gains[i][row]);
        // v' = 2 u - v for the mean u.
        let (twice, start) = if is_mean { (2.0, s.v[row]) } else { (1.0, 0.0) };
        let offset = kd * (s.target_rate[row] + start) - kp * s.displaced_target[row];
        let Limits { effort: [down, up], stall, decline, applied, .. } = s.limits(settings, row);
        let of = |torque: f64, decline: f64| {
            let torque = torque - applied + decline * start;
            Line { torque, slope: twice * decline, is_limit: true }
        };
        let limits =
            [[of(-down, 0.0), of(-stall, decline), of(0.0, 0.0)], [of(up, 0.0), of(stall, decline), of(0.0, 0.0)]];
        Self { offset, slope: twice * kd + h * kp, limits }
    }
}

/// Sets the pieces of the rows with limits, from the state at the start of the step unless they are given.
#[inline(always)]
pub(super) fn set_drives<T: Real>((settings, scheme): StepArguments<'_>, s: &mut Scratch<T>) {
    if settings.limited.is_empty() {
        return;
    }
    let is_tested = !s.are_sides_given || scheme.tableau.stages > 1;
    if is_tested {
        s.displace_from_targets(settings, false);
    }
    for &row in &settings.limited {
        let (limits, v) = (s.limits(settings, row), s.v[row]);
        let (zero, one) = (v.constant(0.0), v.constant(1.0));
        if is_tested {
            s.rows[row].start = s.law(row, s.displaced_target[row], v);
        }
        let of = &mut s.rows[row];
        if !s.are_sides_given {
            let [lower, upper] = limits.at(v);
            of.side = is_none(lower - of.start) - is_none(of.start - upper);
            of.phase = limits.phase(of.side, v);
            of.clipped = zero;
        }
        let (at, is_linear) = ((of.side, of.phase), one - of.side.abs());
        let (kp, kd) = (s.gains[KP][row] * is_linear, s.gains[KD][row] * is_linear);
        let kd = if settings.has_motors { is(at.1, 1.0).mul_add(limits.decline, kd) } else { kd };
        let held = limits.held(at, s.target_rate[row]);
        s.drive(scheme.implicit_step(), row, ([kp, kd], held));
    }
}

/// The torque of a row without limits at the end of a step of one stage, for its velocity there, and this velocity.
#[inline(always)]
fn at_end_of_stage<T: Real>((_, scheme): StepArguments<'_>, (s, ends): (&Scratch<T>, &[T]), row: usize) -> (T, T) {
    let hg = s.v[row].constant(scheme.implicit_step());
    let v = if scheme.implicit { ends[row] } else { s.v[row] };
    (s.law(row, v.mul_add(hg, s.displaced_target[row]), v), v)
}

/// Rounding errors of the torque of a row.
#[inline(always)]
fn rounding<T: Real>(s: &Scratch<T>, row: usize, displaced: T) -> T {
    let one = displaced.constant(1.0);
    let size = s.gains[KP][row] * (one + displaced.abs()) + s.gains[KD][row] * (one + s.v_next[row].abs());
    let scale = size + s.rows[row].held.abs();
    scale.mul_add(one.constant(ROUNDING), one.constant(f64::MIN_POSITIVE))
}

/// The result of the test of the piece of a row.
struct Verdict<T> {
    /// The margin of the torque from those that contradict the piece; not positive if it does.
    margin: T,
    /// The side and the phase of the piece to which the row must then change.
    side: T,
    phase: T,
}

/// Tests the piece of a row by the velocities `ends` at the end of the step.
///
/// In steps of one stage, and with error control, the torque at the end has to be on the piece. In others a row changes
/// its piece in the step that contains the larger part of the change: the law is linear if its mean torque is within
/// the limits, and is at a limit if the mean of the torques without limits at start and end is beyond it, or if that at
/// the end is. A row whose mean torque was clipped stays at that limit, unless the step ends beyond the other one.
#[inline(always)]
fn judge<T: Real>(
    by @ (settings, scheme): StepArguments<'_>,
    (s, ends): (&Scratch<T>, &[T]),
    row: usize,
) -> Verdict<T> {
    let (of, displaced, is_one_stage) = (&s.rows[row], s.displaced_target[row], scheme.tableau.stages == 1);
    let (one, rounding) = (displaced.constant(1.0), rounding(s, row, displaced));
    let endless = one.constant(ENDLESS);
    let (torque, v) =
        if is_one_stage { at_end_of_stage(by, (s, ends), row) } else { (s.law(row, displaced, ends[row]), ends[row]) };
    let mean = if is_one_stage { torque } else { s.control_impulse(row) * one.constant(1.0 / scheme.step) };
    let limits = s.limits(settings, row);
    let ([lower, upper], is_held) = (limits.at(v), of.side.abs());
    let (below, above) = (mean - lower + rounding, upper - mean + rounding);
    let mut linear = below.worst(above);
    let rate = s.target_rate[row];
    let beyond = of.side * (torque - of.held.minus_product(of.derivative, v - rate));
    let mut held = beyond;
    if settings.given.accuracy.is_some() {
        linear = linear.worst(upper - torque + rounding).worst(torque - lower + rounding);
    } else if !is_one_stage {
        let at_start = of.side * (of.start - of.held.minus_product(of.derivative, s.v[row] - rate));
        let from_other = of.side * torque - one.constant(0.5) * (of.side * (lower + upper) - (upper - lower));
        held = larger(beyond, from_other.worst(of.clipped.mul_add(endless, at_start + beyond)));
    }
    held += rounding;
    let leaves = is_none(held);
    let side = (one - is_held).mul_add(is_none(above) - is_none(below), of.side * (one - leaves));
    let of_phase = limits.margin((of.side, of.phase), v) + rounding;
    Verdict { margin: is_held.mul_add(endless, linear).worst(held).worst(of_phase), side, phase: limits.phase(side, v) }
}

/// The smallest margin of the pieces of all rows with limits at the end of a step, positive if the torques agree with
/// all of them. `v_next` and `q_next` are those of the end.
#[inline(always)]
pub(super) fn agreement<T: Real>(by @ (settings, scheme): StepArguments<'_>, s: &mut Scratch<T>) -> T {
    let mut least = s.v.first().map_or_else(T::one, |v| v.constant(1.0));
    if !settings.limited.is_empty() && scheme.tableau.stages > 1 {
        s.displace_from_targets(settings, true);
    }
    for &row in &settings.limited {
        least = least.worst(judge(by, (s, &s.v_next), row).margin);
    }
    least
}

/// Changes the pieces that the end of the last step contradicts, for that step again, in the lanes in which nothing
/// else speaks against it. Returns false if there are none.
#[inline(always)]
pub(super) fn change_drives<T: Real>(by: StepArguments<'_>, s: &mut Scratch<T>) -> bool {
    let is_else_right = s.without_drives.constant(1.0) - is_none(s.without_drives);
    let mut changed = s.without_drives.constant(0.0);
    for &row in &by.0.limited {
        let to = judge(by, (s, &s.v_next), row);
        let of = &mut s.rows[row];
        let is_wrong = is_else_right * is_none(to.margin);
        let (by_side, by_phase) = (is_wrong * (to.side - of.side), is_wrong * (to.phase - of.phase));
        of.clipped = larger(of.clipped, by_side.abs() * (of.side.constant(1.0) - of.side.abs()));
        of.side += by_side;
        of.phase += by_phase;
        changed = larger(changed, by_side.abs() + by_phase.abs());
    }
    lanes_but::<T>(|lane| !(changed.lane(lane) > 0.0)) != 0
}

/// Lists the rows with limits whose torque at the velocities `ends` of a step of one stage contradicts their piece, by
/// their index in the list of these rows, with the piece to which they must change.
pub(super) fn contradictions(
    by: StepArguments<'_>,
    (s, ends): (&Scratch<f64>, &[f64]),
    found: &mut Vec<(usize, Piece)>,
) {
    for (i, &row) in by.0.limited.iter().enumerate() {
        let Verdict { margin, side, phase } = judge(by, (s, ends), row);
        if !(margin > 0.0) {
            found.push((i, piece_of(side, phase)));
        }
    }
}

/// The piece of a side and a phase.
fn piece_of(side: f64, phase: f64) -> Piece {
    let upper = usize::from(side > 0.0);
    match phase {
        _ if side == 0.0 => LINEAR,
        0.0 => Piece::Between(2 * upper),
        phase => Piece::Between(if phase < 2.0 { 3 + upper } else { 5 + upper }),
    }
}

/// The pieces of the rows with limits.
pub(super) fn pieces(settings: &StepSettings, s: &Scratch<f64>) -> Vec<Piece> {
    settings.limited.iter().map(|&row| piece_of(s.rows[row].side, s.rows[row].phase)).collect()
}

/// Gives the pieces of the rows with limits.
pub(super) fn give(settings: &StepSettings, s: &mut Scratch<f64>, pieces: &[Piece]) {
    for (&row, piece) in settings.limited.iter().zip(pieces) {
        (s.rows[row].side, s.rows[row].phase) = match *piece {
            LINEAR => (0.0, 0.0),
            Piece::Between(0) => (-1.0, 0.0),
            Piece::Between(3) => (-1.0, 1.0),
            Piece::Between(4) => (1.0, 1.0),
            Piece::Between(5) => (-1.0, 2.0),
            Piece::Between(6) => (1.0, 2.0),
            _ => (1.0, 0.0),
        };
    }
    s.are_sides_given = true;
}
