//! The Jacobian of a frame and its time derivative: the effect of each degree of freedom inboard of the frame.

use super::frame::{Frame, ReferenceFrame};
use super::inward::PathToBase;
use crate::filter::{HingeMap, Stage};
use crate::joints::vectors::plus;
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{RigidShift, cross_motion, minus, scaled_add, spatial, zero};
use nalgebra::{Vector3, Vector6};

/// J of a frame at `q` into `out`, (6 x nv) row by row: its velocity (angular, linear), expressed in `reference`, is J
/// qd. O(depth), plus the zeros.
#[inline(always)]
pub fn jacobian<T: Real>(model: &Model<T>, q: &[T], frame: &Frame<T>, reference: ReferenceFrame, out: &mut [T]) {
    let placement = local_jacobian(model, q, frame, out);
    if reference != ReferenceFrame::Local {
        let nv = model.nv();
        each_stage(model, frame, |stage| {
            for j in rows(stage) {
                let column = reference.express(&placement, &Columns::of_matrix(nv).column(out, j));
                write_column(out, nv, j, column.as_slice());
            }
        });
    }
}

/// J' of a frame at q and qd into `out`, (6 x nv) row by row: the time derivative of J as expressed in `reference`.
/// O(depth), plus the zeros.
///
/// A column in the axes of the frame is a motion that is constant in its body k. Its derivative is (V(k) - V) x column,
/// where V is the velocity of the frame; in `reference`, V x column is added for the motion relative to it.
#[inline(always)]
pub fn jacobian_rate<T: Real>(
    model: &Model<T>,
    q: &[T],
    qd: &[T],
    frame: &Frame<T>,
    reference: ReferenceFrame,
    out: &mut [T],
) {
    let placement = local_jacobian(model, q, frame, out);
    let nv = model.nv();
    let velocity = velocity_on_path(model, frame, qd, out);
    // V(k) plus the contribution of `reference`, minus V.
    let mut turning = reference.seen_from(&velocity);
    let back: Vector6<T> = zero();
    each_stage(model, frame, |stage| {
        let own = added(&back, stage, qd, out);
        for j in rows(stage) {
            let rate = cross_motion(&turning, &Columns::of_matrix(nv).column(out, j));
            write_column(out, nv, j, reference.express(&placement, &rate).as_slice());
        }
        turning = scaled_add(&own, own[0].constant(-1.0), &turning);
    });
}

/// The places of columns of six numbers in an array: the distance of their rows, and that of columns.
#[derive(Debug, Clone, Copy)]
pub(super) struct Columns {
    pub row: usize,
    pub column: usize,
}

impl Columns {
    /// The columns of a matrix with rows of length `nv`.
    #[inline(always)]
    pub fn of_matrix(nv: usize) -> Self {
        Self { row: nv, column: 1 }
    }

    /// Column `j`.
    #[inline(always)]
    pub fn column<T: Real>(self, array: &[T], j: usize) -> Vector6<T> {
        let (first, row) = (j * self.column, self.row);
        let [a, b, c] = [array[first], array[first + row], array[first + 2 * row]];
        Vector6::new(a, b, c, array[first + 3 * row], array[first + 4 * row], array[first + 5 * row])
    }

    /// Writes column `j`.
    #[inline(always)]
    pub fn write<T: Real>(self, array: &mut [T], j: usize, column: &Vector6<T>) {
        for i in 0..6 {
            array[j * self.column + i * self.row] = column[i];
        }
    }
}

/// J of the frame in its own axes. Returns the pose of the frame on the base.
#[inline(always)]
pub(crate) fn local_jacobian<T: Real>(model: &Model<T>, q: &[T], frame: &Frame<T>, out: &mut [T]) -> RigidShift<T> {
    local_jacobian_in(model, q, frame, Columns::of_matrix(model.nv()), out)
}

/// [`local_jacobian`] with its columns in these places of `out`, the rest of which is zero.
#[inline(always)]
pub(super) fn local_jacobian_in<T: Real>(
    model: &Model<T>,
    q: &[T],
    frame: &Frame<T>,
    at: Columns,
    out: &mut [T],
) -> RigidShift<T> {
    out.fill(T::zero());
    let mut path = PathToBase::from(model, q, frame);
    while let Some(k) = path.body {
        let stage = &model.system.stages[k];
        for i in 0..stage.rows.count() {
            at.write(out, stage.first_row + i, &hinge_to_child(&path.placement, &stage.rows.row(i)));
        }
        path.past(k);
    }
    path.placement
}

/// phi^T H^T of one row of H: [`RigidShift::motion_to_child`] of a motion along or about one axis. At most 9 products.
#[inline(always)]
fn hinge_to_child<T: Real>(shift: &RigidShift<T>, hinge: &HingeMap<T>) -> Vector6<T> {
    let (r, l) = (&shift.rotation, &shift.lever);
    // R^T e, R^T (e x L)
    let axis = |i: usize| Vector3::new(r[(i, 0)], r[(i, 1)], r[(i, 2)]);
    let swept = |i: usize| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        let entry = |c: usize| minus(l[j], r[(k, c)], l[k], r[(j, c)]);
        Vector3::new(entry(0), entry(1), entry(2))
    };
    match *hinge {
        HingeMap::Axis(i) if i < 3 => spatial(&axis(i), &swept(i)),
        HingeMap::Axis(i) => spatial(&Vector3::from_element(l[0].constant(0.0)), &axis(i - 3)),
        HingeMap::Screw(pitch) => spatial(&axis(2), &plus(&swept(2), pitch, &axis(2))),
    }
}

/// Calls a function for the joint of each body from the frame inward.
#[inline(always)]
fn each_stage<T: Real>(model: &Model<T>, frame: &Frame<T>, mut work: impl FnMut(&Stage<T>)) {
    let mut at = frame.body;
    while let Some(k) = at {
        let stage = &model.system.stages[k];
        work(stage);
        at = stage.parent;
    }
}

/// The degrees of freedom of a joint.
#[inline(always)]
pub(super) fn rows<T: Real>(stage: &Stage<T>) -> std::ops::Range<usize> {
    stage.first_row..stage.first_row + stage.rows.count()
}

/// A motion and the contribution of a joint to it, the sum of the columns of J times x.
#[inline(always)]
pub(super) fn added<T: Real>(motion: &Vector6<T>, stage: &Stage<T>, x: &[T], jacobian: &[T]) -> Vector6<T> {
    // No closure: in lanes it would be a function without the instructions of the arm.
    let (at, mut total) = (Columns::of_matrix(x.len()), *motion);
    for j in rows(stage) {
        total = scaled_add(&at.column(jacobian, j), x[j], &total);
    }
    total
}

/// V of a frame at qd, from the columns of J in its own axes.
#[inline(always)]
pub(super) fn velocity_on_path<T: Real>(model: &Model<T>, frame: &Frame<T>, qd: &[T], jacobian: &[T]) -> Vector6<T> {
    let (mut velocity, mut body) = (zero(), frame.body);
    while let Some(k) = body {
        let stage = &model.system.stages[k];
        velocity = added(&velocity, stage, qd, jacobian);
        body = stage.parent;
    }
    velocity
}

/// Writes column `j` of a matrix with rows of length `nv`.
#[inline(always)]
pub(crate) fn write_column<T: Real>(matrix: &mut [T], nv: usize, j: usize, column: &[T]) {
    for (row, &value) in column.iter().enumerate() {
        matrix[row * nv + j] = value;
    }
}
