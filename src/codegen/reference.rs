//! What the scene's own methods give for the arguments of a function, all results one after another.

use super::tracing::Place;
use crate::dynamics::auto::{self, ErrorEstimate};
use crate::dynamics::sweeps::{SweepModel, SweepScratch, general};
use crate::error::Error;
use crate::scene::Scene;
use crate::workspace::Workspace;

/// A scene with its workspace, and the frame that the function is of.
type Room<'a> = (&'a Scene, &'a mut Workspace<f64>, Place);

/// Writes the results for the arguments.
pub(super) type ByScene = fn(Room<'_>, &[&[f64]], &mut [f64]) -> Result<(), Error>;

pub(super) fn forward_dynamics(
    (scene, workspace, _): Room<'_>,
    given: &[&[f64]],
    out: &mut [f64],
) -> Result<(), Error> {
    scene.forward_dynamics(workspace, given[0], given[1], given[2], &[], out)
}

/// The accelerations, and the margin of a single look at them.
#[allow(clippy::unnecessary_wraps)] // as all of the table
pub(super) fn forward_dynamics_watched(
    (scene, workspace, _): Room<'_>,
    given: &[&[f64]],
    out: &mut [f64],
) -> Result<(), Error> {
    let (model, sweeps) = (scene.model(), SweepModel::<f64>::new(scene.model()));
    let mut scratch = SweepScratch::new(model, &sweeps).accepting(workspace.tolerance);
    let (qdd, margin) = out.split_at_mut(scene.nv());
    let state = (given[0], given[1], given[2]);
    let look = general::forward_dynamics_with_estimate((model, &sweeps), &mut scratch, state, &[], qdd);
    margin[0] = ErrorEstimate::of_one_vector(look, scratch.accepted_square).margin();
    Ok(())
}

/// M^-1, and the margin of its factor.
pub(super) fn mass_matrix_inverse_watched(
    (scene, workspace, _): Room<'_>,
    given: &[&[f64]],
    out: &mut [f64],
) -> Result<(), Error> {
    let (inverse, margin) = out.split_at_mut(scene.nv().pow(2));
    scene.mass_matrix_inverse(workspace, &mut scene.inverse_scratch(), given[0], inverse)?;
    margin[0] = margin_of_factor(scene, workspace.tolerance, given[0]);
    Ok(())
}

#[allow(clippy::unnecessary_wraps)] // as all of the table
pub(super) fn factor_watched((scene, workspace, _): Room<'_>, given: &[&[f64]], out: &mut [f64]) -> Result<(), Error> {
    out[0] = margin_of_factor(scene, workspace.tolerance, given[0]);
    Ok(())
}

fn margin_of_factor(scene: &Scene, tolerance: Option<f64>, q: &[f64]) -> f64 {
    let (model, sweeps) = (scene.model(), SweepModel::<f64>::new(scene.model()));
    let mut scratch = SweepScratch::new(model, &sweeps).accepting(tolerance);
    let mut estimates = vec![f64::NAN; scene.nv()];
    auto::estimated_factor((model, &sweeps), &mut scratch, q, &mut estimates).margin()
}

pub(super) fn inverse_dynamics(
    (scene, workspace, _): Room<'_>,
    given: &[&[f64]],
    out: &mut [f64],
) -> Result<(), Error> {
    scene.inverse_dynamics(workspace, given[0], given[1], given[2], &[], out)
}

pub(super) fn bias_torque((scene, workspace, _): Room<'_>, given: &[&[f64]], out: &mut [f64]) -> Result<(), Error> {
    scene.bias_torque(workspace, given[0], given[1], out)
}

pub(super) fn mass_matrix((scene, workspace, _): Room<'_>, given: &[&[f64]], out: &mut [f64]) -> Result<(), Error> {
    scene.mass_matrix(workspace, given[0], out)
}

pub(super) fn mass_matrix_inverse(
    (scene, workspace, _): Room<'_>,
    given: &[&[f64]],
    out: &mut [f64],
) -> Result<(), Error> {
    scene.mass_matrix_inverse(workspace, &mut scene.inverse_scratch(), given[0], out)
}

pub(super) fn forward_dynamics_derivatives(
    (scene, workspace, _): Room<'_>,
    given: &[&[f64]],
    out: &mut [f64],
) -> Result<(), Error> {
    scene.forward_dynamics_derivatives(workspace, given[0], given[1], given[2], &[], out)
}

pub(super) fn inverse_dynamics_derivatives(
    (scene, workspace, _): Room<'_>,
    given: &[&[f64]],
    out: &mut [f64],
) -> Result<(), Error> {
    scene.inverse_dynamics_derivatives(workspace, given[0], given[1], given[2], &[], out)
}

pub(super) fn forward_dynamics_jvp(
    (scene, workspace, _): Room<'_>,
    given: &[&[f64]],
    out: &mut [f64],
) -> Result<(), Error> {
    scene.forward_dynamics_jvp(workspace, given[0], given[1], given[2], &[], [given[3], given[4], given[5]], out)
}

pub(super) fn forward_dynamics_vjp(
    (scene, workspace, _): Room<'_>,
    given: &[&[f64]],
    out: &mut [f64],
) -> Result<(), Error> {
    scene.forward_dynamics_vjp(workspace, given[0], given[1], given[2], &[], given[3], out)
}

pub(super) fn inverse_dynamics_jvp(
    (scene, workspace, _): Room<'_>,
    given: &[&[f64]],
    out: &mut [f64],
) -> Result<(), Error> {
    scene.inverse_dynamics_jvp(workspace, given[0], given[1], given[2], &[], [given[3], given[4], given[5]], out)
}

pub(super) fn inverse_dynamics_vjp(
    (scene, workspace, _): Room<'_>,
    given: &[&[f64]],
    out: &mut [f64],
) -> Result<(), Error> {
    scene.inverse_dynamics_vjp(workspace, given[0], given[1], given[2], &[], given[3], out)
}

pub(super) fn placements((scene, _, _): Room<'_>, given: &[&[f64]], out: &mut [f64]) -> Result<(), Error> {
    for (placement, out) in scene.placements(given[0])?.iter().zip(out.chunks_exact_mut(16)) {
        placement.homogeneous(out);
    }
    Ok(())
}

pub(super) fn placement((scene, _, (frame, _)): Room<'_>, given: &[&[f64]], out: &mut [f64]) -> Result<(), Error> {
    scene.placement(given[0], frame)?.homogeneous(out);
    Ok(())
}

pub(super) fn jacobian(
    (scene, _, (frame, reference)): Room<'_>,
    given: &[&[f64]],
    out: &mut [f64],
) -> Result<(), Error> {
    scene.jacobian(given[0], frame, reference, out)
}
