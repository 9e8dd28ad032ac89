//! Operational space: the inverse inertia of bodies and task frames is the covariance of their co-states, without M.

use super::forward::factorise;
use super::refined::DoubleDoubleState;
use super::sweeps::{SweepScratch, co_state_covariances};
use crate::filter::Form;
use crate::filter::innovations::past_rows;
use crate::filter::pivots::PivotMonitor;
use crate::interrupt;
pub use crate::kinematics::Frame;
use crate::kinematics::propagation::inward_along_path;
use crate::model::Model;
use crate::scalar::{DoubleDouble, Real};
use crate::spatial::{RigidShift, Symmetric6, dot};
use crate::workspace::{Made, Workspace};
use nalgebra::{Matrix6, Vector6};

/// Pairs of frames between checks for interruption.
pub(crate) const MANY: usize = 16;

/// Scratch that only the operational-space inertia needs.
#[derive(Debug, Clone)]
pub struct OperationalScratch<T: Real> {
    /// Lambda^- of each body.
    co_state_covariance: Vec<Symmetric6<T>>,
    /// The frames of a call, resolved from names.
    pub(crate) frames: Vec<Frame<T>>,
    /// Identity of the model.
    pub(crate) identity: u64,
}

impl<T: Real> OperationalScratch<T> {
    /// Scratch for `model`.
    pub fn new(model: &Model<T>) -> Self {
        let nan = Symmetric6::filled(T::from_f64(f64::NAN));
        Self {
            co_state_covariance: vec![nan; model.bodies.len()],
            frames: Vec::with_capacity(4),
            identity: model.identity(),
        }
    }
}

/// Omega = J M^-1 J^T of m frames at `q` into `out`, (6m x 6m) row by row, full and exactly symmetric.
///
/// J stacks the Jacobians of the frames, (angular, linear) at the origin of each frame and in its axes: forces F on the
/// frames change their accelerations by Omega F. For bodies, Omega is phi* H* M^-1 H phi = cov(lambda^-) (2.9, 5.5 as
/// corrected). With c the nearest common ancestor of bodies i and j, which may be one of them, its block is X(c,i)*
/// Lambda^-(c) X(c,j). X = Psi A propagates forces from the outboard side of one body to that of another;
/// X(c,c) = 1. The block is zero without a common ancestor, and on the base. O(N + m^2 depth), without allocation.
///
/// In form `auto`, a state is recomputed in double-double arithmetic and rounded if the error estimate of the factor of
/// M exceeds the tolerance (f64 only). If [`Workspace::lost_pivot`] finds a lost pivot with the returned monitor, or if
/// an [`interrupt`] ends the work, `out` is undefined. The body of a frame must be one of the model's.
pub fn operational_inverse_inertia<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut OperationalScratch<T>,
    q: &[T],
    frames: &[Frame<T>],
    out: &mut [T],
) -> PivotMonitor<T> {
    let monitor = factorise(model, workspace, q);
    let is_in_doubt = workspace.form == Form::Auto && monitor.of_roots;
    let lambda = &mut scratch.co_state_covariance;
    let SweepScratch { shifts, measured, .. } = &workspace.store;
    co_state_covariances(&model.system, (shifts, measured), lambda, |_, _, _| {});
    if is_in_doubt && doubled((model, &mut workspace.wide), q, frames, out) {
        return monitor;
    }
    let width = 6 * frames.len();
    for (i, first) in frames.iter().enumerate() {
        for (j, second) in frames.iter().enumerate().skip(i) {
            if interrupt::check_at(i * frames.len() + j + 1, MANY).is_err() {
                return monitor;
            }
            let block = covariance_between(model, workspace, lambda, [first, second]);
            for row in 0..6 {
                // A diagonal block is mirrored too, because its lower and upper triangles differ by rounding.
                for column in if i == j { row } else { 0 }..6 {
                    out[(6 * i + row) * width + 6 * j + column] = block[(row, column)];
                    out[(6 * j + column) * width + 6 * i + row] = block[(row, column)];
                }
            }
        }
    }
    monitor
}

/// The same in double-double arithmetic, see [`DoubleDoubleState::recompute`].
fn doubled<T: Real>(model: (&Model<T>, &mut Made), q: &[T], frames: &[Frame<T>], out: &mut [T]) -> bool {
    let narrow = |RigidShift { rotation, lever }: &RigidShift<T>| RigidShift {
        rotation: rotation.map(|x| x.lane(0)),
        lever: lever.map(|x| x.lane(0)),
    };
    let frames: Vec<Frame<DoubleDouble>> =
        frames.iter().map(|frame| Frame { body: frame.body, placement: narrow(&frame.placement) }.cast()).collect();
    DoubleDoubleState::recompute(model, (q, &[], &[]), &[], out, |wide, out| {
        let DoubleDoubleState { model, workspace, q, .. } = wide;
        operational_inverse_inertia(model, workspace, &mut OperationalScratch::new(model), q, &frames, out);
        true
    })
}

/// The covariance of the co-states of two frames: unit forces on both are propagated inward to their common ancestor.
fn covariance_between<T: Real>(
    model: &Model<T>,
    workspace: &Workspace<T>,
    co_state_covariance: &[Symmetric6<T>],
    frames: [&Frame<T>; 2],
) -> Matrix6<T> {
    let stages = &model.system.stages;
    let [mut i, mut j] = frames.map(|frame| frame.body);
    while i != j {
        // Parents precede children: the body with the larger index is no ancestor of the other.
        let side = if i > j { &mut i } else { &mut j };
        *side = side.and_then(|k| stages[k].parent);
    }
    let Some(meeting) = i else { return Matrix6::from_element(T::zero()) };
    let SweepScratch { shifts, measured, .. } = &workspace.store;
    let [left, right] = frames.map(|frame| {
        let forces = unit_forces(&frame.placement);
        inward_along_path(stages, shifts, [frame.body, i], forces, |k, forces| {
            for force in forces {
                past_rows(&stages[k], measured, 0..stages[k].rows.count(), force);
            }
        })
    });
    let right = right.map(|force| co_state_covariance[meeting].mul_vector(&force));
    Matrix6::from_fn(|row, column| dot(&left[row], &right[column]))
}

/// Unit moments and forces on a frame, as forces on its body.
fn unit_forces<T: Real>(placement: &RigidShift<T>) -> [Vector6<T>; 6] {
    let matrix = placement.to_matrix();
    std::array::from_fn(|i| matrix.column(i).into_owned())
}

impl OperationalScratch<f64> {
    /// The scale of the terms of a frame's motion in the last call, angular and linear, as standard deviations: the
    /// maximum over its body and the bodies inward, transported by the lever of the frame.
    ///
    /// The rounding of an entry of Omega is eps times the product of two of them; the entry may be much smaller, or
    /// zero to rounding. The scales are traces, because rotations mix the components of the angular part and those of
    /// the linear part, but not both parts. O(depth).
    pub(crate) fn term_sizes(&self, model: &Model<f64>, frame: &Frame<f64>) -> [f64; 2] {
        let size = |e: &[f64; 6]| (e[0] + e[3] + e[5]).abs().sqrt();
        let inward = std::iter::successors(frame.body, |&k| model.system.stages[k].parent);
        let [angular, linear] = inward.fold([0.0_f64; 2], |[angular, linear], k| {
            let lambda = &self.co_state_covariance[k];
            [angular.max(size(&lambda.angular.entries)), linear.max(size(&lambda.linear.entries))]
        });
        [angular, linear + frame.placement.lever.norm() * angular]
    }
}
