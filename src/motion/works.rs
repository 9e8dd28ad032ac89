//! Works during an elementary step.

use super::scratch::Scratch;
use super::step_settings::StepSettings;
use super::totals::{CONTROL, DAMPING, FRICTION, TORQUE};
use crate::scalar::Real;

/// Adds the works of an elementary step from `q`, `v` to `q_next`, `v_next` with displacement `x`. Exact friction is
/// that of the modes of the step.
#[inline(always)]
pub(super) fn add_work<T: Real>(settings: &StepSettings, s: &mut Scratch<T>) {
    for (row, of) in s.rows.iter().enumerate() {
        let (v, next, x) = (s.v[row], s.v_next[row], s.x[row]);
        let mean = (v + next) * v.constant(0.5);
        s.totals[TORQUE] = s.torque[row].mul_add(x, s.totals[TORQUE]);
        s.totals[DAMPING] = s.totals[DAMPING].minus_product(of.damping * x, mean);
        if settings.gains.is_some() {
            s.totals[CONTROL] = s.control[row].mul_add(mean, s.totals[CONTROL]);
        }
        if settings.regularized {
            s.totals[FRICTION] = s.totals[FRICTION].minus_product(s.chord[row] * x, mean);
        }
    }
    for mode in &s.modes {
        s.totals[FRICTION] = s.dry[mode.row].mul_add(s.x[mode.row], s.totals[FRICTION]);
    }
}
