//! Faults of steps with contacts.

use crate::contact::SolveReport;
use crate::dynamics::forward::factorise;
use crate::error::Error;
use crate::filter::pivots::LostPivot;
use crate::model::Model;
use crate::scene::Scene;
use crate::workspace::Workspace;

/// A residual above this is an error; a residual between the tolerance and this value is accepted.
pub(super) const REFUSED: f64 = 1e-5;

/// Returns an error for a solve with a large residual.
pub(super) fn check(scene: &Scene, near: &[usize], solved: &SolveReport) -> Result<(), (String, Error)> {
    if solved.residual <= REFUSED {
        return Ok(());
    }
    let found = format!("a residual of {:.1e} after {} iterations", solved.residual, solved.iterations);
    let expected =
        "impulses with a residual of at most 1e-5 of the fastest contact velocity: take a smaller dt, or less friction";
    Err((String::new(), Error::argument(named(scene, near), found, expected)))
}

/// Returns an error for a contact that no joint can move, for r of each contact.
pub(super) fn check_movable(scene: &Scene, near: &[usize], lengths: &[f64]) -> Result<(), (String, Error)> {
    let Some(at) = lengths.iter().position(|r| !r.is_finite()) else { return Ok(()) };
    let found = "a point that the joints and connections cannot move in this configuration";
    let error = Error::argument(named(scene, &near[at..=at]), found, "contacts that joints can move");
    Err((String::new(), error))
}

/// Text that names some contacts. Joint limits are excluded, because they can always be satisfied.
fn named(scene: &Scene, which: &[usize]) -> String {
    let points = which.iter().filter_map(|&i| scene.contact_points().get(i));
    let names: Vec<String> = points.take(8).map(|point| format!("{:?}", point.name)).collect();
    let more = if which.len() > names.len() { ", ..." } else { "" };
    format!("contact{} {}{more}", if which.len() == 1 { "" } else { "s" }, names.join(", "))
}

/// Factorizes M at `q`; the error of a singular pivot names its joint.
pub(super) fn factorised(
    scene: &Scene,
    (model, q): (&Model<f64>, &[f64]),
    workspace: &mut Workspace<f64>,
) -> Result<(), (String, Error)> {
    let pivots = factorise(model, workspace, q);
    let lost = workspace.lost_pivot(model, &pivots);
    lost.map_or(Ok(()), |lost| Err(pivot_fault(scene, lost)))
}

/// The fault of a singular pivot, with its joint.
pub(super) fn pivot_fault(scene: &Scene, lost: LostPivot) -> (String, Error) {
    let joint = scene.joint_of_body(lost.stage).map(|joint| joint.name.clone()).unwrap_or_default();
    (joint, scene.singular(lost))
}

/// Returns an error for two spheres without a normal.
pub(super) fn check_normals(scene: &Scene, gaps: &[f64]) -> Result<(), (String, Error)> {
    let Some(at) = gaps.iter().position(|gap| gap.is_nan()) else { return Ok(()) };
    let expected = "spheres whose centers are apart: take a smaller dt";
    Err((String::new(), Error::argument(named(scene, &[at]), "two spheres whose centers coincide", expected)))
}
