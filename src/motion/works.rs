//! Works during an elementary step.

use super::scratch::Scratch;
use super::step_settings::StepSettings;
use super::stops::Hold;
use super::totals::{CONTROL, DAMPING, FRICTION, STOPS, TORQUE};
use crate::scalar::Real;
use crate::scene::FrictionCurve;

/// Adds the works of an elementary step from `q`, `v` to `q_next`, `v_next` with displacement `x`. Exact friction is
/// that of the modes of the step.
#[inline(always)]
pub(super) fn add_work<T: Real>(settings: &StepSettings, s: &mut Scratch<T>) {
    for row in 0..s.rows.len() {
        let (v, next, x) = (s.v[row], s.v_next[row], s.x[row]);
        let mean = (v + next) * v.constant(0.5);
        s.totals[TORQUE] = s.torque[row].mul_add(x, s.totals[TORQUE]);
        s.totals[DAMPING] = s.totals[DAMPING].minus_product(s.rows[row].damping * x, mean);
        if settings.gains.is_some() {
            s.totals[CONTROL] = s.control_impulse(row).mul_add(mean, s.totals[CONTROL]);
        }
        if settings.regularized && settings.properties.curves.get(row).is_none_or(FrictionCurve::is_flat) {
            s.totals[FRICTION] = s.totals[FRICTION].minus_product(s.chord[row] * x, mean);
        }
    }
    for of in &s.curved {
        let mean = (s.v[of.row] + s.v_next[of.row]) * T::from_f64(0.5);
        s.totals[FRICTION] = mean.mul_add(T::from_f64(of.impulse), s.totals[FRICTION]);
    }
    if settings.wrenches.is_some() {
        s.totals[TORQUE] += s.wrenches.work(&s.x);
    }
    for mode in &s.modes {
        s.totals[FRICTION] = s.dry[mode.row].mul_add(s.x[mode.row], s.totals[FRICTION]);
    }
}

/// The works of friction and of the stop of a row in an event.
pub(super) struct RowWork {
    friction: f64,
    pub stop: f64,
    /// The impulse of the stop.
    impulse: f64,
}

impl RowWork {
    /// For a row and its friction in both directions, in an event of length h with this torque of friction and stop.
    /// Friction opposes the motion; at rest it compensates the other torques up to its bound. Stops do not pull.
    pub fn new(
        (row, [back, ahead]): (usize, [f64; 2]),
        (h, torque, hold): (f64, f64, Option<Hold>),
        s: &Scratch<f64>,
    ) -> Self {
        let along = 0.5 * h * (s.v[row] + s.v_next[row]);
        let sliding = if along < 0.0 { back } else { -ahead };
        let rubbing = match hold {
            Some(Hold::Lower) if along != 0.0 => sliding.min(torque),
            Some(Hold::Upper) if along != 0.0 => sliding.max(torque),
            _ => torque.clamp(-ahead, back),
        };
        Self { friction: rubbing * along, stop: (torque - rubbing) * along, impulse: h * (torque - rubbing) }
    }

    /// Adds them to the totals. Returns the impulse of the stop.
    pub fn add(&self, s: &mut Scratch<f64>) -> f64 {
        s.totals[FRICTION] += self.friction;
        s.totals[STOPS] += self.stop;
        self.impulse
    }
}
