//! Checks of a step.

use super::method::Method;
use super::properties::joint_of_row;
use super::scratch::Scratch;
use super::settings::Settings;
use super::step_settings::StepSettings;
use crate::batch::instruction_set::Vectorized;
use crate::error::{Error, in_language};
use crate::filter::pivots::LostPivot;
use crate::scalar::lanes_but;
use crate::scene::Scene;

/// Largest displacement of a joint in one step, rad or m; beyond, the motion has diverged.
pub(super) const LARGEST_STEP: f64 = 1e9;

/// The fault of a checked step: the joint and the error.
pub(super) fn fault_of(
    scene: &Scene,
    settings: &StepSettings,
    s: &Scratch<f64>,
    lost: Option<LostPivot>,
) -> Option<(String, Error)> {
    let limit = LARGEST_STEP / settings.step;
    let strayed = s.v_next.iter().position(|v| !(v.abs() <= limit));
    let finite = s.v.iter().chain(&s.q).all(|x| x.is_finite());
    if let Some(lost) = lost {
        // A pivot that is not finite follows from a state that diverged within the step.
        if lost.pivot.is_finite() && lost.terms.is_finite() && finite {
            return Some(pivot_fault(scene, lost));
        }
    }
    let row = strayed.or_else(|| s.q_next.iter().any(|q| !q.is_finite()).then_some(0))?;
    let joint = joint_of_row(scene, row);
    let error = Error::Argument {
        argument: format!("velocity of joint {joint:?}"),
        found: format!("{} after a step of {} s, from {}", s.v_next[row], settings.step, s.v[row]),
        expected: format!(
            "a velocity below {limit:.1e}: the motion has diverged; take a smaller dt{}",
            remedy(settings)
        ),
    };
    Some((joint, error))
}

/// The fault of a singular pivot, with its joint.
pub(super) fn pivot_fault(scene: &Scene, lost: LostPivot) -> (String, Error) {
    let joint = scene.joint_of_body(lost.stage).map(|joint| joint.name.clone()).unwrap_or_default();
    (joint, scene.singular(lost))
}

/// Another fix for a motion that diverges: settings that the run does not have.
fn remedy(settings: &StepSettings) -> &'static str {
    let Settings { method, accuracy, .. } = &*settings.given;
    match method {
        Method::Auto if settings.divides && accuracy.is_none() => {
            in_language(", or set Settings::accuracy", ", or set accuracy=1e-6")
        }
        Method::Auto => ", or smaller gains and torques",
        Method::Contact => "",
        _ => in_language(", or Method::Auto", ", or method=\"auto\""),
    }
}

/// The lanes whose end is not finite or moved too far.
#[allow(clippy::eq_op)] // x - x is zero for finite x, else NaN
#[inline(always)]
pub(super) fn strays<T: Vectorized>(settings: &StepSettings, s: &Scratch<T>) -> u64 {
    let mut worst = s.model.gravity[0].constant(1.0);
    for &v in &s.v_next {
        worst = worst.worst(v.constant(LARGEST_STEP / settings.step) - v.abs());
    }
    for &q in &s.q_next {
        worst += q - q;
    }
    lanes_but::<T>(|lane| worst.lane(lane) >= 0.0)
}
