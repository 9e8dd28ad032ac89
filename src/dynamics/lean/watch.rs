//! The covariance form with an estimate of the digits that it lost: the first look of [`auto`](crate::dynamics::auto).

use super::accelerations::split;
use super::body::{Carrier, LeanModel};
use super::motion;
use super::scratch::LeanScratch;
use super::{accelerations, filter};
use crate::dynamics::forces::{Motion, Needed};
use crate::filter::cancellation::{Cancellation, Swept};
use crate::filter::pivots::PivotMonitor;
use crate::filter::{HingeMap, Rows, Stage};
use crate::scalar::Real;
use crate::scene::Model;
use nalgebra::Vector6;

/// [`forward_dynamics`](super::forward_dynamics), and what [`cancellation::sweep`](crate::filter::cancellation::sweep) finds.
#[inline(always)]
pub(crate) fn forward_dynamics_watched<T: Real>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> (PivotMonitor<T>, Cancellation<T>) {
    let state = Motion { q, qd, qdd: None, wrenches };
    motion::forces_base_to_tip((model, lean), scratch, state, Needed::of(model, state));
    let monitor = filter::tip_to_base::<T, { filter::WATCH }>((model, lean), scratch, tau, qdd);
    (monitor, base_to_tip((model, lean), scratch, qdd))
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
    let monitor = filter::tip_to_base::<T, { filter::WATCH }>((model, lean), scratch, &weights, estimates);
    scratch.watching.others = weights;
    (monitor, base_to_tip((model, lean), scratch, estimates))
}

/// The smoother for both right sides.
#[inline(always)]
fn base_to_tip<T: Real>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    estimates: &mut [T],
) -> Cancellation<T> {
    let mut seen = Cancellation::new();
    let watching = &mut scratch.watching;
    for (k, body) in lean.bodies.iter().enumerate() {
        let (of_lambda, of_nu) = (&scratch.co_states[body.parent_outward], &watching.co_states[body.parent_outward]);
        let outer = accelerations::whole(of_lambda);
        let (zeta, z) = (Vector6::from(watching.zeta[k]), Vector6::from(scratch.forces[k]));
        let swept = Swept { z: &z, scale: &watching.scale[k], measured: &scratch.measured };
        let (mut lambda, mut nu);
        match &body.carrier {
            Carrier::Turn(renaming) => {
                let turn = scratch.turns[k];
                seen.carried(&zeta, &outer, outer[0].everywhere(body.lever_square));
                lambda = joined(accelerations::carried(body, renaming, turn, of_lambda));
                nu = joined(accelerations::carried(body, renaming, turn, of_nu));
                // Spelt out, so that the compiler sees which entry is meant.
                let stage = Stage { parent: body.parent, rows: Rows::One(HingeMap::Axis(2)), first_row: body.row };
                seen.through_stage(&stage, &swept, (&mut lambda, &mut nu), (estimates, &watching.innovations));
            }
            Carrier::Shift(at) => {
                let shift = &scratch.shifts[*at];
                seen.carried(&zeta, &outer, shift.lever.dot(&shift.lever));
                lambda = shift.motion_to_child(&outer);
                nu = shift.motion_to_child(&accelerations::whole(of_nu));
                let stage = &model.system.stages[k];
                seen.through_stage(stage, &swept, (&mut lambda, &mut nu), (estimates, &watching.innovations));
            }
        }
        if !body.is_leaf {
            scratch.co_states[body.outward] = split(&lambda);
            watching.co_states[body.outward] = split(&nu);
        }
    }
    seen
}

#[inline(always)]
fn joined<T: Real>([w, v]: [[T; 3]; 2]) -> Vector6<T> {
    Vector6::new(w[0], w[1], w[2], v[0], v[1], v[2])
}
