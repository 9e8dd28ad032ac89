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
//! the start of the step determines the piece, and the end of the step tests it. In steps of one stage the test is the
//! law itself. In others both the torque at the end and the mean torque of the step have to be on the piece.

use super::scratch::Scratch;
use super::step_settings::{StepArguments, StepSettings};
use super::stops::{Drive, Line, Piece};
use crate::scalar::{Real, larger};

/// Rounding errors of torques, relative to the torques of the law at a displacement and a velocity of one.
const ROUNDING: f64 = 1e-15;
/// Added to a test of a piece that does not apply.
const ENDLESS: f64 = 1e200;

/// Indices of the gains and limits of effort of a state.
pub(super) const KP: usize = 0;
pub(super) const KD: usize = 1;
pub(super) const LOWER: usize = 2;
pub(super) const UPPER: usize = 3;
pub(super) const STALL: usize = 4;
const DECLINE: usize = 5;

/// The piece between the limits, 0 and 2, or 3 and 4 where they decline, or 5 and 6 where they are zero.
pub(super) const LINEAR: Piece = Piece::Between(1);

impl<T: Real> Scratch<T> {
    /// Sets the gains that act on a row, the constant torque beside them, and the noise of the row.
    #[inline(always)]
    pub fn drive(&mut self, settings: &StepSettings, hg: f64, row: usize, ([kp, kd], held): ([T; 2], T)) {
        let (of, armature) = (&mut self.rows[row], settings.properties.armature[row]);
        let (hg, armature) = (kp.constant(hg), kp.constant(armature));
        (of.proportional, of.derivative, of.held) = (kp, kd, held);
        of.slope = hg * (kd + hg * kp);
        let noise = armature + hg * ((of.damping + kd) + hg * (of.stiffness + kp));
        of.noise = if of.has_noise { noise + noise.one_if_zero() * noise.constant(self.vanishing) } else { noise };
        self.model.system.noise[row] = of.noise;
    }

    /// Sets the gains of the state on all rows, without limits.
    #[inline(always)]
    pub fn drive_all(&mut self, settings: &StepSettings, hg: f64) {
        for row in 0..self.rows.len() {
            let zero = self.rows[row].damping.constant(0.0);
            let gains = if settings.gains.is_some() { [KP, KD].map(|i| self.gains[i][row]) } else { [zero; 2] };
            self.drive(settings, hg, row, (gains, zero));
        }
    }

    /// Removes the law from the rows with limits, whose torques the caller determines.
    pub fn release_drives(&mut self, settings: &StepSettings, hg: f64) {
        for &row in &settings.limited {
            let zero = self.rows[row].damping.constant(0.0);
            self.drive(settings, hg, row, ([zero; 2], zero));
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
        let [lower, upper, stall, decline] = [LOWER, UPPER, STALL, DECLINE].map(|i| self.gains[i][row]);
        let endless = upper.constant(ENDLESS);
        let applied = if settings.limits_sum { self.torque[row] } else { upper.constant(0.0) };
        Limits {
            effort: [-lower, upper].map(|limit| limit.worst(endless)),
            stall: stall.worst(endless),
            decline,
            applied,
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
    applied: T,
}

impl<T: Real> Limits<T> {
    /// The torque of a motor that declines with its speed in a direction, 0 or 1: what the limit is between zero and
    /// the limit of effort.
    #[inline(always)]
    fn declining(&self, side: usize, v: T) -> T {
        let along = if side == 0 { -v } else { v };
        self.stall.minus_product(self.decline, along)
    }

    /// The lower and the upper limit of the law at velocity v.
    #[inline(always)]
    fn at(&self, v: T) -> [T; 2] {
        let zero = v.constant(0.0);
        let [down, up] = [0, 1].map(|side| larger(self.declining(side, v).worst(self.effort[side]), zero));
        [-down - self.applied, up - self.applied]
    }

    /// The phase of a limit at velocity v: 0 if it is constant, 1 if it declines, 2 if it is zero.
    #[inline(always)]
    fn phase(&self, side: usize, v: T) -> T {
        let (zero, one, torque) = (v.constant(0.0), v.constant(1.0), self.declining(side, v));
        let is_less = one - larger(self.effort[side] - torque, zero).one_if_zero();
        is_less + is_less * larger(torque, zero).one_if_zero()
    }

    /// The margin of a phase at velocity v, negative if it is another one.
    #[inline(always)]
    fn margin(&self, (side, phase): (usize, T), v: T) -> T {
        let (torque, [full, declines, idles]) = (self.declining(side, v), phases(phase));
        let below = self.effort[side] - torque;
        declines.mul_add(below.worst(torque), -(full * below) - idles * torque)
    }

    /// The torque of the law at a limit, for the target velocity that it has there too.
    #[inline(always)]
    fn held(&self, (side, phase): (usize, T), rate: T) -> T {
        let [full, declines, _] = phases(phase);
        let size = full.mul_add(self.effort[side], declines * self.declining(side, rate));
        (if side == 0 { -size } else { size }) - self.applied
    }
}

/// 1 for the given phase, else 0.
#[inline(always)]
fn phases<T: Real>(phase: T) -> [T; 3] {
    [0.0, 1.0, 2.0].map(|k| (phase - phase.constant(k)).one_if_zero())
}

impl Drive {
    /// The law of a row in a step of h from the state in the scratch, from whose target its displacement is known.
    pub fn of(settings: &StepSettings, s: &Scratch<f64>, row: usize, h: f64) -> Self {
        let [kp, kd] = [KP, KD].map(|i| s.gains[i][row]);
        let offset = kd * s.target_rate[row] - kp * s.displaced_target[row];
        let Limits { effort: [down, up], stall, decline, applied } = s.limits(settings, row);
        let of = |torque: f64, decline: f64| Line { torque: torque - applied, slope: decline, is_limit: true };
        let limits =
            [[of(-down, 0.0), of(-stall, decline), of(0.0, 0.0)], [of(up, 0.0), of(stall, decline), of(0.0, 0.0)]];
        Self { offset, slope: kd + h * kp, limits }
    }
}

/// Sets the pieces of the rows with limits, from the state at the start of the step unless they are given.
#[inline(always)]
pub(super) fn set_drives<T: Real>((settings, scheme): StepArguments<'_>, s: &mut Scratch<T>) {
    if settings.limited.is_empty() {
        return;
    }
    if !s.are_sides_given {
        s.displace_from_targets(settings, false);
    }
    for &row in &settings.limited {
        let (limits, v) = (s.limits(settings, row), s.v[row]);
        let (zero, one) = (v.constant(0.0), v.constant(1.0));
        if !s.are_sides_given {
            let (torque, [lower, upper]) = (s.law(row, s.displaced_target[row], v), limits.at(v));
            let [is_below, is_above] =
                [lower - torque, torque - upper].map(|beyond| one - larger(beyond, zero).one_if_zero());
            s.rows[row].side = is_above - is_below;
            s.rows[row].phase = is_below.mul_add(limits.phase(0, v), is_above * limits.phase(1, v));
        }
        let (side, phase) = (s.rows[row].side, s.rows[row].phase);
        let [is_linear, at_upper, at_lower] = [side, side - one, side + one].map(T::one_if_zero);
        let [kp, kd] = [KP, KD].map(|i| s.gains[i][row] * is_linear);
        let [_, declines, _] = phases(phase);
        let [down, up] = [0, 1].map(|i| limits.held((i, phase), s.target_rate[row]));
        let held = up.mul_add(at_upper, down * at_lower);
        s.drive(settings, scheme.implicit_step(), row, ([kp, kd + limits.decline * declines], held));
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

/// The smallest margin, over all rows with limits, of the torques at the end of a step from those that contradict the
/// pieces; positive if they agree. `v_next` and `q_next` are those of the end.
#[inline(always)]
pub(super) fn agreement<T: Real>(by @ (settings, scheme): StepArguments<'_>, s: &mut Scratch<T>) -> T {
    let one = s.v.first().map_or_else(T::one, |v| v.constant(1.0));
    let (mut least, is_one_stage) = (one, scheme.tableau.stages == 1);
    if !settings.limited.is_empty() && !is_one_stage {
        s.displace_from_targets(settings, true);
    }
    for &row in &settings.limited {
        let (of, displaced) = (&s.rows[row], s.displaced_target[row]);
        let rounding = rounding(s, row, displaced);
        let (torque, v) = if is_one_stage {
            at_end_of_stage(by, (s, &s.v_next), row)
        } else {
            (s.law(row, displaced, s.v_next[row]), s.v_next[row])
        };
        let limits = s.limits(settings, row);
        let ([lower, upper], is_held) = (limits.at(v), of.side.abs());
        // A row at a limit is tested on its side alone.
        let other = is_held.mul_add(is_held.constant(ENDLESS), rounding);
        let mut test = |torque: T| {
            least = least.worst(upper - torque + other).worst(torque - lower + other);
        };
        if !is_one_stage {
            test(s.control_impulse(row) * one.constant(1.0 / scheme.step));
        }
        test(torque);
        let piece = of.held.minus_product(of.derivative, v - s.target_rate[row]);
        least = least.worst(of.side * (torque - piece) + rounding);
        let [at_lower, at_upper] = [of.side + one, of.side - one].map(T::one_if_zero);
        let [down, up] = [0, 1].map(|i| limits.margin((i, of.phase), v));
        least = least.worst(up.mul_add(at_upper, down * at_lower) + rounding);
    }
    least
}

/// Lists the rows with limits whose torque at the velocities `ends` of a step of one stage contradicts their piece, by
/// their index in the list of these rows, with the piece to which they must change.
pub(super) fn contradictions(
    by: StepArguments<'_>,
    (s, ends): (&Scratch<f64>, &[f64]),
    found: &mut Vec<(usize, Piece)>,
) {
    for (i, &row) in by.0.limited.iter().enumerate() {
        let (of, (torque, v)) = (&s.rows[row], at_end_of_stage(by, (s, ends), row));
        let (slack, limits) = (rounding(s, row, s.displaced_target[row]), s.limits(by.0, row));
        let ([lower, upper], line) = (limits.at(v), of.held - of.derivative * (v - s.target_rate[row]));
        if of.side == 0.0 {
            let beyond = [torque < lower - slack, torque > upper + slack].iter().position(|&beyond| beyond);
            found.extend(beyond.map(|side| (i, limit_piece(side, limits.phase(side, v)))));
        } else if of.side * (torque - line) < -slack {
            found.push((i, LINEAR));
        } else {
            let side = usize::from(of.side > 0.0);
            let is_past = limits.margin((side, of.phase), v) < -slack;
            found.extend(is_past.then(|| (i, limit_piece(side, limits.phase(side, v)))));
        }
    }
}

/// The piece at the lower or upper limit, 0 or 1, in one of its phases.
fn limit_piece(side: usize, phase: f64) -> Piece {
    match phase {
        0.0 => Piece::Between(2 * side),
        phase => Piece::Between(if phase < 2.0 { 3 + side } else { 5 + side }),
    }
}

/// The pieces of the rows with limits.
pub(super) fn pieces(settings: &StepSettings, s: &Scratch<f64>) -> Vec<Piece> {
    let piece = |&row: &usize| match s.rows[row].side {
        0.0 => LINEAR,
        side => limit_piece(usize::from(side > 0.0), s.rows[row].phase),
    };
    settings.limited.iter().map(piece).collect()
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
