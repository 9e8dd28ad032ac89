//! The torque of the control law up to its limits of effort.
//!
//! With the displacement x of a joint from its target and the target velocity w, the torque of the law in a step from v
//! to v' = v + h a is that at the end of the step:
//!
//! ```text
//! clip(-kp (x + h v') - kd (v' - w), lower, upper) = clip(c - (kd + h kp) v', lower, upper)
//! ```
//!
//! with lower and upper limits that can themselves decline with v', max(-E, -S - D v') and min(E, S - D v') for the
//! stall torque S of a motor and its decline D: one more monotone graph of torque over velocity, beside those of [`stops`](super::stops). During a step the law is
//! on one of its pieces: linear, with the gains as measurement noise, or at a limit, with a constant torque and no
//! noise, or with the decline as noise. The torque at the start of the step determines the piece, and the end of the step tests it. In steps of
//! one stage the test is the law itself. In others both the torque at the end and the mean torque of the step have to
//! be on the piece.

use super::scratch::{RowTerms, Scratch};
use super::step_settings::{StepArguments, StepSettings};
use super::stops::{Drive, Piece};
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

/// The piece between the limits, 0 and 2, or 3 and 4 where they decline.
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

    /// The limits of the torque of the law on a row: the constant ones, and at rest those that decline with the last
    /// factor. A limit that is infinite never acts.
    #[inline(always)]
    fn limits(&self, settings: &StepSettings, row: usize) -> Limits<T> {
        let [lower, upper, stall, decline] = [LOWER, UPPER, STALL, DECLINE].map(|i| self.gains[i][row]);
        let (endless, zero) = (upper.constant(ENDLESS), upper.constant(0.0));
        let applied = if settings.limits_sum { self.torque[row] } else { zero };
        let (upper, stall) = (upper.worst(endless), stall.worst(endless));
        Limits {
            constant: [larger(lower, -endless) - applied, upper - applied],
            at_rest: [-stall - applied, stall - applied],
            decline,
        }
    }

    /// The torque of the law without limits, for the displacement and velocity of a row.
    #[inline(always)]
    fn law(&self, row: usize, displaced: T, v: T) -> T {
        let torque = v.constant(0.0).minus_product(self.gains[KD][row], v - self.target_rate[row]);
        torque.minus_product(self.gains[KP][row], displaced)
    }
}

/// The limits of the torque of a law, lower and upper.
struct Limits<T> {
    constant: [T; 2],
    at_rest: [T; 2],
    decline: T,
}

impl<T: Real> Limits<T> {
    /// The limits at velocity v, and by how much the constant ones are nearer than those that decline; negative if they
    /// are not.
    #[inline(always)]
    fn at(&self, v: T) -> ([T; 2], [T; 2]) {
        let [low, high] = self.at_rest.map(|torque| torque.minus_product(self.decline, v));
        let [lower, upper] = self.constant;
        ([larger(lower, low), upper.worst(high)], [lower - low, high - upper])
    }
}

impl Drive {
    /// The law of a row in a step of h from the state in the scratch, from whose target its displacement is known.
    pub fn of(settings: &StepSettings, s: &Scratch<f64>, row: usize, h: f64) -> Self {
        let [kp, kd] = [KP, KD].map(|i| s.gains[i][row]);
        let offset = kd * s.target_rate[row] - kp * s.displaced_target[row];
        let Limits { constant, at_rest, decline } = s.limits(settings, row);
        Self { offset, slope: kd + h * kp, constant, at_rest, decline }
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
            let (torque, ([lower, upper], [below, above])) = (s.law(row, s.displaced_target[row], v), limits.at(v));
            let [is_below, is_above] =
                [lower - torque, torque - upper].map(|beyond| one - larger(beyond, zero).one_if_zero());
            s.rows[row].side = is_above - is_below;
            let declines = [below, above].map(|nearer| one - larger(-nearer, zero).one_if_zero());
            s.rows[row].declines = is_below.mul_add(declines[0], is_above * declines[1]);
        }
        let RowTerms { side, declines, .. } = s.rows[row];
        let [is_linear, at_upper, at_lower] = [side, side - one, side + one].map(T::one_if_zero);
        let [kp, kd] = [KP, KD].map(|i| s.gains[i][row] * is_linear);
        let decline = limits.decline * declines;
        // The law has a target velocity there too.
        let held = |i: usize| {
            let at_rest = limits.at_rest[i].minus_product(decline, s.target_rate[row]);
            declines.mul_add(at_rest - limits.constant[i], limits.constant[i])
        };
        let held = held(1).mul_add(at_upper, held(0) * at_lower);
        s.drive(settings, scheme.implicit_step(), row, ([kp, kd + decline], held));
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
        let ([lower, upper], nearer) = s.limits(settings, row).at(v);
        let is_held = of.side.abs();
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
        // The nearer of the limits on that side.
        let [at_lower, at_upper] = [of.side + one, of.side - one].map(T::one_if_zero);
        let is_nearer = (one - of.declines - of.declines) * (at_lower * nearer[0] + at_upper * nearer[1]);
        least = least.worst(is_nearer + rounding);
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
        let (slack, ([lower, upper], nearer)) = (rounding(s, row, s.displaced_target[row]), s.limits(by.0, row).at(v));
        let line = of.held - of.derivative * (v - s.target_rate[row]);
        let side = match of.side {
            side if side == 0.0 => usize::from(torque > upper + slack),
            side if side * (torque - line) < -slack => {
                found.push((i, LINEAR));
                continue;
            }
            side => usize::from(side > 0.0),
        };
        let is_inside = of.side == 0.0 && torque >= lower - slack && torque <= upper + slack;
        let margin = if of.side == 0.0 { 0.0 } else { slack };
        let declines = if of.declines > 0.0 { nearer[side] < margin } else { nearer[side] < -margin };
        let is_same = of.side != 0.0 && declines == (of.declines > 0.0);
        if !is_inside && !is_same {
            found.push((i, limit_piece(side, declines)));
        }
    }
}

/// The piece at the lower or upper limit, 0 or 1.
fn limit_piece(side: usize, declines: bool) -> Piece {
    Piece::Between(if declines { 3 + side } else { 2 * side })
}

/// The pieces of the rows with limits.
pub(super) fn pieces(settings: &StepSettings, s: &Scratch<f64>) -> Vec<Piece> {
    let piece = |&row: &usize| match s.rows[row].side {
        0.0 => LINEAR,
        side => limit_piece(usize::from(side > 0.0), s.rows[row].declines > 0.0),
    };
    settings.limited.iter().map(piece).collect()
}

/// Gives the pieces of the rows with limits.
pub(super) fn give(settings: &StepSettings, s: &mut Scratch<f64>, pieces: &[Piece]) {
    for (&row, piece) in settings.limited.iter().zip(pieces) {
        (s.rows[row].side, s.rows[row].declines) = match *piece {
            LINEAR => (0.0, 0.0),
            Piece::Between(0) => (-1.0, 0.0),
            Piece::Between(3) => (-1.0, 1.0),
            Piece::Between(4) => (1.0, 1.0),
            _ => (1.0, 0.0),
        };
    }
    s.are_sides_given = true;
}
