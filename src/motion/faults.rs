//! What is wrong with a step.

use super::properties::joint_of_row;
use super::scratch::Scratch;
use super::step_settings::StepSettings;
use crate::error::Error;
use crate::filter::pivots::LostPivot;
use crate::scene::Scene;

/// A joint that moves by more than this in one step (rad or m) has left what can be called motion.
pub(super) const FARTHEST: f64 = 1e9;

/// What is wrong with a checked step: the joint and the error.
pub(super) fn fault_of(
    scene: &Scene,
    settings: &StepSettings,
    s: &Scratch<f64>,
    lost: Option<LostPivot>,
) -> Option<(String, Error)> {
    let limit = FARTHEST / settings.step;
    let strayed = s.v_next.iter().position(|v| !(v.abs() <= limit));
    let finite = s.v.iter().chain(&s.q).all(|x| x.is_finite());
    if let Some(lost) = lost {
        // A pivot that is not finite comes of a state that ran away within the step.
        if lost.pivot.is_finite() && lost.terms.is_finite() && finite {
            let joint = scene.joint_of_body(lost.stage).map(|joint| joint.name.clone()).unwrap_or_default();
            return Some((joint, scene.singular(lost)));
        }
    }
    if strayed.is_none() && s.q_next.iter().all(|q| q.is_finite()) && !s.keeper.correction.iter().all(|x| x.is_finite())
    {
        let joint = settings.roots.first().map(|&k| joint_of_row(scene, scene.model().system.stages[k].first_row));
        let found = "a tree whose inertia about its mass center is lost in rounding";
        let expected = "free joints at bodies that are not much further from the mass center than the tree is large";
        return Some((joint.unwrap_or_default(), Error::argument("conserve_momentum", found, expected)));
    }
    let row = strayed.or_else(|| s.q_next.iter().any(|q| !q.is_finite()).then_some(0))?;
    let joint = joint_of_row(scene, row);
    let error = Error::Argument {
        argument: format!("rate of joint {joint:?}"),
        found: format!("{} after a step of {} s, from {}", s.v_next[row], settings.step, s.v[row]),
        expected: format!("a rate below {limit:.1e}: motion has diverged; take a smaller dt, or method=\"auto\""),
    };
    Some((joint, error))
}
