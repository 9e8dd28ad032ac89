//! Forward dynamics: joint torques are measurements, the smoother's estimates are the joint accelerations.

use super::auto;
use super::forces::{Motion, forces_base_to_tip};
use super::{forward_root, refined};
use crate::accuracy::Accuracy;
use crate::filter::pivots::{PivotMonitor, Scale};
use crate::filter::riccati::{self, Covariances};
use crate::filter::{Form, System, innovations, smoother};
use crate::kinematics::placements_base_to_tip;
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::zero;
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// Joint accelerations from joint torques in O(N): filter tip to base (3.6, 4.4 to 4.6), smoother base to tip (4.9 to 4.11).
///
/// `q` (nq), `qd`, `tau`, `qdd` (nv) are one state, SI units; `wrenches` is empty or holds a spatial force a body, in that
/// body's frame at its origin, acting on it. P is carried as the workspace's form says. About 810 operations a one-axis joint
/// in the covariance form, as they are counted. Where [`Workspace::lost_pivot`] finds
/// one with the returned monitor, `qdd` means nothing.
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
        Form::Auto => return auto::forward_dynamics_auto(model, workspace, q, qd, tau, wrenches, qdd).pivots,
        Form::SquareRoot => {
            return refined::forward_dynamics_judged(model, workspace, q, qd, tau, wrenches, qdd).pivots;
        }
        Form::Covariance => workspace.accuracy = Accuracy::unknown(workspace.form),
    }
    if workspace.estimates_error {
        // Whatever it lost.
        let watched = auto::forward_dynamics_watched(model, workspace, (q, qd, tau), wrenches, qdd);
        workspace.accuracy = watched.accuracy(workspace.accepted_error(), qdd);
        return watched.pivots;
    }
    forces_and_noise(model, workspace, Motion { q, qd, qdd: None, wrenches });
    let monitor = filter_tip_to_base(&model.system, workspace, tau, qdd);
    smoother::sweep(&model.system, &workspace.shift, &workspace.measured, &mut workspace.co_state, qdd);
    monitor
}

/// Base to tip: phi, velocities, mean forces (the bias b(k) where no joint accelerates), and the process noise M(k) in
/// place for the filter.
pub(super) fn forces_and_noise<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, state: Motion<'_, T>) {
    forces_base_to_tip(model, workspace, state);
    covariances_of_noise(model, workspace);
}

/// Tip to base: Riccati recursion and filter in one pass; `innovations` receives e^-.
pub(super) fn filter_tip_to_base<T: Real>(
    system: &System<T>,
    workspace: &mut Workspace<T>,
    tau: &[T],
    innovations: &mut [T],
) -> PivotMonitor<T> {
    let mut monitor = PivotMonitor::new();
    for k in (0..system.stages.len()).rev() {
        workspace.covariances().step(system, k, &mut monitor, &mut |_, _| {});
        innovations::step(system, k, &workspace.shift, &workspace.measured, tau, &mut workspace.z, innovations);
    }
    monitor
}

/// The factor of M at `q`: phi, D, g and P^+ in the workspace (3.6, 3.10); `seen` is called with each row's P^-.
pub fn factorise<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    q: &[T],
    mut seen: impl FnMut(usize, &crate::spatial::Symmetric6<T>),
) -> PivotMonitor<T> {
    placements_base_to_tip(model, q, &mut workspace.shift);
    match workspace.form {
        Form::Auto => auto::factorise(model, workspace, &mut seen),
        Form::SquareRoot => forward_root::factorise(model, workspace, &mut seen),
        Form::Covariance => riccati::sweep(&model.system, &mut covariances_of_noise(model, workspace), seen),
    }
}

/// The arrays of the Riccati recursion, M(k) in place with the bounds on its terms.
pub(super) fn covariances_of_noise<'a, T: Real>(
    model: &Model<T>,
    workspace: &'a mut Workspace<T>,
) -> Covariances<'a, T> {
    for (k, body) in model.bodies.iter().enumerate() {
        workspace.p[k] = body.inertia.to_symmetric();
        workspace.scale[k] = Scale::of_noise(&body.inertia_terms);
    }
    workspace.covariances()
}

/// M^-1 tau = (1 - L*) D^-1 (1 - L) tau (4.1), with the factor already in the workspace; no bias enters.
pub fn solve<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, tau: &[T], qdd: &mut [T]) {
    workspace.z.fill(zero());
    innovations::sweep(&model.system, &workspace.shift, &workspace.measured, tau, &mut workspace.z, qdd);
    smoother::sweep(&model.system, &workspace.shift, &workspace.measured, &mut workspace.co_state, qdd);
}
