//! The torque of the control law up to its limits of effort.
//!
//! With the displacement x of a joint from its target and the target velocity w, the torque of the law in a step from v
//! to v' = v + h a is that at the end of the step:
//!
//! ```text
//! clip(-kp (x + h v') - kd (v' - w), lower, upper) = clip(c - (kd + h kp) v', lower, upper)
//! ```
//!
//! one more monotone graph of torque over velocity, beside those of [`stops`](super::stops). During a step the law is
//! on one of its three pieces: linear, with the gains as measurement noise, or at a limit, with a constant torque and
//! no noise. The torque at the start of the step determines the piece, and the end of the step tests it. In steps of
//! one stage the test is the law itself. In others both the torque at the end and the mean torque of the step have to
//! be on the piece.

use super::scratch::Scratch;
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

/// The piece between the limits, 0 and 2.
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

    /// The gains of a row, and the limits of the torque of the law.
    #[inline(always)]
    fn terms(&self, settings: &StepSettings, row: usize) -> [T; 4] {
        let [kp, kd, lower, upper] = [KP, KD, LOWER, UPPER].map(|i| self.gains[i][row]);
        let applied = if settings.limits_sum { self.torque[row] } else { kp.constant(0.0) };
        [kp, kd, lower - applied, upper - applied]
    }

    /// The torque of the law without limits, for the displacement and velocity of a row.
    #[inline(always)]
    fn law(&self, row: usize, displaced: T, v: T) -> T {
        let torque = v.constant(0.0).minus_product(self.gains[KD][row], v - self.target_rate[row]);
        torque.minus_product(self.gains[KP][row], displaced)
    }
}

impl Drive {
    /// The law of a row in a step of h from the state in the scratch, from whose target its displacement is known.
    pub fn of(settings: &StepSettings, s: &Scratch<f64>, row: usize, h: f64) -> Self {
        let [kp, kd, lower, upper] = s.terms(settings, row);
        let offset = kd * s.target_rate[row] - kp * s.displaced_target[row];
        Self { offset, slope: kd + h * kp, lower, upper }
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
        let [kp, kd, lower, upper] = s.terms(settings, row);
        let (zero, one) = (kp.constant(0.0), kp.constant(1.0));
        if !s.are_sides_given {
            let torque = s.law(row, s.displaced_target[row], s.v[row]);
            let [below, above] = [lower - torque, torque - upper].map(|beyond| larger(beyond, zero).one_if_zero());
            s.rows[row].side = below - above;
        }
        let side = s.rows[row].side;
        let [is_linear, at_upper, at_lower] = [side, side - one, side + one].map(T::one_if_zero);
        // A limit that is infinite never acts.
        let endless = one.constant(ENDLESS);
        let held = upper.worst(endless) * at_upper + larger(lower, -endless) * at_lower;
        s.drive(settings, scheme.implicit_step(), row, ([kp * is_linear, kd * is_linear], held));
    }
}

/// The torque of a row without limits and that of its piece at the end of a step of one stage, for its velocity there.
#[inline(always)]
fn at_end_of_stage<T: Real>((_, scheme): StepArguments<'_>, (s, ends): (&Scratch<T>, &[T]), row: usize) -> T {
    let hg = s.v[row].constant(scheme.implicit_step());
    let v = if scheme.implicit { ends[row] } else { s.v[row] };
    s.law(row, v.mul_add(hg, s.displaced_target[row]), v)
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
        let [.., lower, upper] = s.terms(settings, row);
        let is_held = of.side.abs();
        // A row at a limit is tested on its side alone.
        let other = is_held.mul_add(is_held.constant(ENDLESS), rounding);
        let mut test = |torque: T| {
            least = least.worst(upper - torque + other).worst(torque - lower + other);
        };
        let torque = if is_one_stage {
            at_end_of_stage(by, (s, &s.v_next), row)
        } else {
            test(s.control_impulse(row) * one.constant(1.0 / scheme.step));
            s.law(row, displaced, s.v_next[row])
        };
        test(torque);
        least = least.worst(of.side * (torque - of.held) + rounding);
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
        let (of, torque) = (&s.rows[row], at_end_of_stage(by, (s, ends), row));
        let (slack, [.., lower, upper]) = (rounding(s, row, s.displaced_target[row]), s.terms(by.0, row));
        let piece = if of.side == 0.0 {
            let beyond = [torque < lower - slack, torque > upper + slack];
            beyond.iter().position(|&beyond| beyond).map(|upper| 2 * upper)
        } else {
            (of.side * (torque - of.held) < -slack).then_some(1)
        };
        found.extend(piece.map(|piece| (i, Piece::Between(piece))));
    }
}

/// The pieces of the rows with limits.
pub(super) fn pieces(settings: &StepSettings, s: &Scratch<f64>) -> Vec<Piece> {
    let piece = |&row: &usize| match s.rows[row].side {
        side if side < 0.0 => Piece::Between(0),
        side if side > 0.0 => Piece::Between(2),
        _ => LINEAR,
    };
    settings.limited.iter().map(piece).collect()
}

/// Gives the pieces of the rows with limits.
pub(super) fn give(settings: &StepSettings, s: &mut Scratch<f64>, pieces: &[Piece]) {
    for (&row, piece) in settings.limited.iter().zip(pieces) {
        s.rows[row].side = match *piece {
            Piece::Between(0) => -1.0,
            LINEAR => 0.0,
            _ => 1.0,
        };
    }
    s.are_sides_given = true;
}
