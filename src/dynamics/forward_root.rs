//! Forward dynamics in square-root form: roots of inertias, and bias forces in their coordinates.

use crate::filter::pivots::{PivotMonitor, Scale};
use crate::filter::rounding::RootMonitor;
use crate::filter::smoother;
use crate::filter::square_root::{self, Mean, Roots};
use crate::kinematics::{base_acceleration, joint_shift, motion_step};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{BodyRoot, Root6, Symmetric6, scaled_add, spatial};
use crate::workspace::Workspace;
use nalgebra::{Vector3, Vector6};

/// Joint accelerations as [`forward_dynamics`](super::forward_dynamics) documents them, before anyone judges them.
///
/// The body forces enter as L y, y = L^-1 b in the body's own parameters, and never as a sum with what joints transmit: a heavy
/// body's weight is turned into the columns of the bodies inboard of it, not subtracted there. A body whose inertia has no root
/// leaves NaN.
pub(super) fn forward_dynamics<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    q: &[T],
    qd: &[T],
    tau: &[T],
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> RootMonitor<T> {
    bias_base_to_tip(model, workspace, q, qd, wrenches);
    let Workspace { shift, root, scale, measured, coordinates, z, .. } = workspace;
    let mut roots = Roots { shift, root, scale, measured };
    let mut mean = Mean { coordinates, added: z, measurement: tau, innovations: qdd };
    let monitor = square_root::sweep(&model.system, &mut roots, Some(&mut mean), |_, _| {});
    smoother::sweep(&model.system, &workspace.shift, &workspace.measured, &mut workspace.co_state, qdd);
    monitor
}

/// Base to tip: phi, velocities, the coordinates of the bias forces, and the roots of the process noise.
fn bias_base_to_tip<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    q: &[T],
    qd: &[T],
    wrenches: &[Vector6<T>],
) {
    let (still, base) = (crate::spatial::zero(), base_acceleration(model));
    let none = Vector3::new(T::zero(), T::zero(), T::zero());
    for (k, body) in model.bodies.iter().enumerate() {
        let stage = &model.system.stages[k];
        let shift = joint_shift(body, q);
        let parent = match stage.parent {
            Some(parent) => (&workspace.velocity[parent], &workspace.acceleration[parent]),
            None => (&still, &base),
        };
        let (velocity, acceleration) = motion_step(body, stage.first_row, &shift, parent, qd);
        let (root, (y, rest)) = if let Some(root) = &model.inertia_roots[k] {
            (root.to_root(), root.coordinates(&velocity, &acceleration))
        } else {
            let nan = T::from_f64(f64::NAN);
            (Root6::filled(nan), ([nan; 6], none))
        };
        workspace.root[k] = root;
        workspace.coordinates[k] = y;
        workspace.z[k] = spatial(&rest, &none);
        if !wrenches.is_empty() {
            workspace.z[k] = scaled_add(&wrenches[k], none[0].constant(-1.0), &workspace.z[k]);
        }
        workspace.scale[k] = Scale::of_noise(&body.inertia_terms);
        workspace.shift[k] = shift;
        workspace.velocity[k] = velocity;
        workspace.acceleration[k] = acceleration;
    }
}

/// The factor of M, with phi already in the workspace: D, g and P^+ (3.6, 3.10); `seen` is called with each row's P^-.
pub(super) fn factorise<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    seen: &mut dyn FnMut(usize, &Symmetric6<T>),
) -> PivotMonitor<T> {
    for (k, body) in model.bodies.iter().enumerate() {
        let root = model.inertia_roots[k].as_ref();
        workspace.root[k] = root.map_or_else(|| Root6::filled(T::from_f64(f64::NAN)), BodyRoot::to_root);
        workspace.scale[k] = Scale::of_noise(&body.inertia_terms);
    }
    let Workspace { shift, root, scale, measured, p, .. } = workspace;
    let mut roots = Roots { shift, root, scale, measured };
    let monitor = square_root::sweep(&model.system, &mut roots, None, |row, root| seen(row, &root.to_symmetric()));
    for (p, root) in p.iter_mut().zip(root) {
        *p = root.to_symmetric();
    }
    monitor.pivots
}
