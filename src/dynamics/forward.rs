//! Forward dynamics: joint torques are the measurements, and the smoother's estimates are the joint accelerations.

use super::auto;
use super::refined;
use super::sweeps::general;
use crate::accuracy::Accuracy;
use crate::filter::Form;
use crate::filter::pivots::PivotMonitor;
use crate::model::Model;
use crate::scalar::Real;
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// Joint accelerations from joint torques in O(N): filter tip to base (3.6, 4.4 to 4.6), smoother base to tip (4.9 to
/// 4.11).
///
/// `q` (nq), `qd`, `tau`, `qdd` (nv) are one state, SI units. `wrenches` is empty or holds one spatial force per body,
/// which acts on the body at the origin of its frame and is expressed in that frame. P is propagated in the form of the
/// workspace. About 770 operations per joint with one axis in covariance form. If [`Workspace::lost_pivot`] finds a
/// lost pivot with the returned monitor, `qdd` is undefined.
pub fn forward_dynamics<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    q: &[T],
    qd: &[T],
    tau: &[T],
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> PivotMonitor<T> {
    match workspace.form {
        Form::Auto => auto::forward_dynamics_auto(model, workspace, q, qd, tau, wrenches, qdd).pivots,
        Form::SquareRoot => refined::forward_dynamics_square_root(model, workspace, q, qd, tau, wrenches, qdd).pivots,
        Form::Covariance if workspace.estimates_error => {
            // The result is kept for any error.
            let watched = auto::forward_dynamics_with_estimate(model, workspace, (q, qd, tau), wrenches, qdd);
            workspace.accuracy = watched.accuracy(workspace.accepted_error(), qdd);
            watched.pivots
        }
        Form::Covariance => {
            workspace.accuracy = Accuracy::unknown(workspace.form);
            let (scene, store) = workspace.passes(model);
            general::forward_dynamics(scene, store, (q, qd, tau), wrenches, qdd)
        }
    }
}

/// The factor of M at `q`: phi, D, g and P in the workspace (3.6, 3.10).
pub fn factorise<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, q: &[T]) -> PivotMonitor<T> {
    match workspace.form {
        Form::Auto => auto::factorise(model, workspace, q),
        Form::SquareRoot => refined::factorise_by_roots(model, workspace, q),
        Form::Covariance => {
            let (scene, store) = workspace.passes(model);
            general::factor(scene, store, q)
        }
    }
}

/// M^-1 tau = (1 - L*) D^-1 (1 - L) tau (4.1), with the factor already in the workspace, without bias.
pub fn solve<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, tau: &[T], qdd: &mut [T]) {
    let (scene, store) = workspace.passes(model);
    general::solve::<T, false>(scene, store, tau, qdd);
}
