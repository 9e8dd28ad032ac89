//! The covariance form with an estimate of the digits that it lost: the first look of [`auto`](crate::dynamics::auto).

use super::accelerations::split;
use super::body::{Carrier, LeanModel};
use super::motion;
use super::scratch::LeanScratch;
use super::turn::Turn;
use super::{accelerations, filter};
use crate::dynamics::forces::{Motion, Needed};
use crate::filter::cancellation::{Cancellation, Swept};
use crate::filter::pivots::PivotMonitor;
use crate::filter::{HingeMap, Rows, Stage};
use crate::kinematics::turned_by;
use crate::scalar::Real;
use crate::scene::Model;
use crate::spatial::RigidShift;
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// [`forward_dynamics`](super::forward_dynamics), whether a single look at its pivots may do, and what
/// [`cancellation::sweep`](crate::filter::cancellation::sweep) finds.
#[inline(always)]
pub(crate) fn forward_dynamics_watched<T: Real>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> (PivotMonitor<T>, PivotMonitor<T>, Cancellation<T>) {
    let state = Motion { q, qd, qdd: None, wrenches };
    motion::forces_base_to_tip((model, lean), scratch, state, Needed::of(model, state));
    let [monitor, near] = filter::tip_to_base::<T, { filter::WATCH }>((model, lean), scratch, tau, qdd);
    (monitor, near, base_to_tip((model, lean), scratch, qdd))
}

/// The factor of M, and what two made-up right sides say of it; `estimates` is scratch, (nv).
#[inline(always)]
pub(crate) fn factor_watched<T: Real>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    q: &[T],
    estimates: &mut [T],
) -> (PivotMonitor<T>, Cancellation<T>) {
    motion::carriers((model, lean), scratch, q);
    scratch.forces.fill([T::zero(); 6]);
    // Borrowed from the scratch and given back: it is read beside the rest, and nothing is allocated.
    let weights = std::mem::take(&mut scratch.watching.others);
    let [monitor, _] = filter::tip_to_base::<T, { filter::WATCH }>((model, lean), scratch, &weights, estimates);
    scratch.watching.others = weights;
    (monitor, base_to_tip((model, lean), scratch, estimates))
}

/// What the first look left, as the second look of [`auto`](crate::dynamics::auto) reads it.
#[inline(always)]
pub(crate) fn hand_over<T: Real>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &LeanScratch<T>,
    workspace: &mut Workspace<T>,
) {
    let watching = &scratch.watching;
    workspace.measured.copy_from_slice(&scratch.measured);
    for (k, body) in lean.bodies.iter().enumerate() {
        workspace.shift[k] = match &body.carrier {
            Carrier::Turn(_) => {
                let Turn { s, c } = scratch.turns[k];
                let tree = &model.bodies[k].tree;
                RigidShift { rotation: turned_by(&tree.rotation, s, c), lever: tree.lever }
            }
            Carrier::Shift(at) => scratch.shifts[*at],
        };
        workspace.z[k] = Vector6::from(scratch.forces[k]);
        [workspace.co_state[k], _] = watching.co_states[k + 1];
        workspace.terms[k] = watching.terms[k];
    }
}

/// The smoother for both right sides.
#[inline(always)]
fn base_to_tip<T: Real>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    estimates: &mut [T],
) -> Cancellation<T> {
    let mut seen = Cancellation::beside(T::from_f64(lean.beside));
    let watching = &mut scratch.watching;
    for (k, body) in lean.bodies.iter().enumerate() {
        let [outer, outer_nu] = &watching.co_states[body.parent.map_or(0, |parent| parent + 1)];
        let (zeta, z) = (vector(&watching.zeta[k]), vector(&scratch.forces[k]));
        let swept = Swept { z: &z, terms: &watching.terms[k], measured: &scratch.measured };
        let (mut lambda, mut nu);
        match &body.carrier {
            Carrier::Turn(renaming) => {
                let turn = scratch.turns[k];
                seen.carried(&zeta, outer, outer[0].everywhere(body.lever_square));
                lambda = joined(accelerations::carried(body, renaming, turn, &split(outer)));
                nu = joined(accelerations::carried(body, renaming, turn, &split(outer_nu)));
                // Spelt out, so that the compiler sees which entry is meant.
                let stage = Stage { parent: body.parent, rows: Rows::One(HingeMap::Axis(2)), first_row: body.row };
                seen.through_stage(&stage, &swept, (&mut lambda, &mut nu), (estimates, &watching.innovations));
            }
            Carrier::Shift(at) => {
                let shift = &scratch.shifts[*at];
                let l = &shift.lever;
                seen.carried(&zeta, outer, l[0].mul_add(l[0], l[1].mul_add(l[1], l[2] * l[2])));
                lambda = shift.motion_to_child(outer);
                nu = shift.motion_to_child(outer_nu);
                let stage = &model.system.stages[k];
                seen.through_stage(stage, &swept, (&mut lambda, &mut nu), (estimates, &watching.innovations));
            }
        }
        watching.co_states[k + 1] = [lambda, nu];
    }
    seen
}

/// Entry by entry: a copy of the whole would be a call.
#[inline(always)]
fn vector<T: Real>(x: &[T; 6]) -> Vector6<T> {
    Vector6::new(x[0], x[1], x[2], x[3], x[4], x[5])
}

#[inline(always)]
fn joined<T: Real>([w, v]: [[T; 3]; 2]) -> Vector6<T> {
    Vector6::new(w[0], w[1], w[2], v[0], v[1], v[2])
}

#[cfg(test)]
mod tests {
    use super::{LeanModel, LeanScratch, forward_dynamics_watched};
    use crate::scenes;

    /// Torques that hold a chain against its weight leave next to nothing of it: beside what is left most digits are missing, beside
    /// gravity hardly one.
    #[test]
    fn what_is_held_still_is_seen_beside_gravity() {
        let scene = scenes::chain(7).expect("a chain");
        let model = scene.model();
        let (q, still) = ([0.3, -0.7, 0.5, 0.9, -0.4, 0.6, 0.2], [0.0; 7]);
        let mut torque = [f64::NAN; 7];
        scene.bias_torque(&mut scene.workspace(), &q, &still, &mut torque).expect("a state");
        // Off by a part in ten thousand million, which is what is left.
        torque[3] *= 1.0 + 1e-10;
        let error = |lean: &LeanModel<f64>| {
            let (mut scratch, mut qdd) = (LeanScratch::new(model, lean), [f64::NAN; 7]);
            let state = (&q[..], &still[..], &torque[..]);
            let (_, _, seen) = forward_dynamics_watched((model, lean), &mut scratch, state, &[], &mut qdd);
            assert!(qdd.iter().all(|a| a.abs() < 1e-6) && qdd.iter().any(|&a| a != 0.0), "{qdd:?}");
            (seen.error(0), qdd.iter().fold(0.0_f64, |largest, a| largest.max(a.abs())))
        };
        let gravity = model.gravity.norm();
        let (alone, left) = error(&LeanModel::new(model));
        let (beside, _) = error(&LeanModel::new(model).beside(gravity));
        assert!(alone > 1e-6 && beside < 1e-11, "{alone:e} {beside:e}");
        assert!((alone * left / (beside * gravity) - 1.0).abs() < 1e-12, "{alone:e} {beside:e}");
    }
}
