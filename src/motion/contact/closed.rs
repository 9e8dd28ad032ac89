//! Connections and coupled joints in steps with contacts: their rows hold exactly at the end of each step.
//!
//! ```text
//! M (v' - v_free) = J_k* lambda + J_c* p,   J_k v' = 0,   contact law for p
//! ```
//!
//! `v_free` is first projected onto the connections; contact impulses then act on the complement of their rows. At the
//! end of the step, positions and velocities are projected onto the connections.

use super::super::step_settings::StepSettings;
use super::step::pivot_fault;
use crate::dynamics::constraints::{Elimination, NoDirection, Projected};
use crate::dynamics::contacts::ContactScratch;
use crate::error::Error;
use crate::model::Model;
use crate::scene::Scene;
use crate::workspace::Workspace;

/// The fix that the error of a step suggests.
const SMALLER: &str = "a step that ends near a configuration that satisfies the connections: take a smaller dt";

/// The rows of the connections of a scene, or of its coupled joints.
pub(super) fn eliminated(scene: &Scene, settings: &StepSettings) -> Option<Box<Elimination>> {
    let constraints = match &settings.coupling {
        Some(coupling) => coupling.as_constraints(),
        None => scene.constraints().clone(),
    };
    (!constraints.is_empty()).then(|| Box::new(Elimination::new(scene.model(), constraints)))
}

/// Projects `v` onto the velocities that satisfy the connections at `q`, if there are any, and factorizes their rows
/// there.
pub(super) fn onto_connections(
    scene: &Scene,
    (model, workspace): (&Model<f64>, &mut Workspace<f64>),
    rows: &mut ContactScratch,
    (q, v): (&[f64], &mut [f64]),
) -> Result<(), (String, Error)> {
    let Some(closed) = &mut rows.closed else { return Ok(()) };
    if !q.iter().chain(&*v).all(|x| x.is_finite()) {
        // A diverging motion is reported as such.
        return Ok(());
    }
    let projected = closed.velocities(model, workspace, (q, v));
    check(scene, (model, workspace), projected, "m/s or rad/s")
}

/// Projects `q` onto the connections, if there are any.
pub(super) fn positions_onto_connections(
    scene: &Scene,
    (model, workspace): (&Model<f64>, &mut Workspace<f64>),
    rows: &mut ContactScratch,
    q: &mut [f64],
) -> Result<(), (String, Error)> {
    let Some(closed) = &mut rows.closed else { return Ok(()) };
    if !q.iter().all(|x| x.is_finite()) {
        return Ok(());
    }
    let projected = closed.positions(model, workspace, q);
    check(scene, (model, workspace), projected, "m or rad")
}

/// The fault of a projection.
fn check(
    scene: &Scene,
    (model, workspace): (&Model<f64>, &mut Workspace<f64>),
    projected: Result<Projected, NoDirection>,
    unit: &str,
) -> Result<(), (String, Error)> {
    let projected = projected.map_err(|at| (String::new(), scene.no_direction(at)))?;
    if let Some(lost) = workspace.lost_pivot(model, &projected.pivots) {
        return Err(pivot_fault(scene, lost.stage, scene.singular(lost)));
    }
    let Some(row) = projected.stays else { return Ok(()) };
    Err((String::new(), scene.open_at("the end of a step", row, projected.left, unit, SMALLER)))
}
