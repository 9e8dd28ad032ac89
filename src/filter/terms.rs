//! Bounds on the terms that form the diagonal of P^-, axis by axis: what [`cancellation`](super::cancellation) takes rounding relative to.
//!
//! [`Scale`](super::pivots::Scale) has one number for all three axes. A slender body that turns fast about its own axis, where it has
//! next to no inertia, then seems to lose what it never had. Here each axis has its own.

use super::system::{HingeMap, Rows, Stage};
use crate::scalar::Real;
use crate::spatial::{RigidShift, Symmetric6, absolute};
use nalgebra::{Vector3, Vector6};

/// As [`sent`] multiplies: the rounding of P^+ itself, and what a square of a sum has more than the sum of squares.
pub const SPREAD: f64 = 4.0;

/// What P of a stage, with this diagonal, can bring to the diagonal of its parent's: the terms of phi P phi*.
///
/// Of R A R*, entry i is formed of at most the square of sum |R_ij| sqrt(A_jj), which is below the trace, and below three times the sum of
/// the squares; of a lever's cross product likewise, with two. About 50 operations.
#[inline(always)]
#[must_use]
pub fn sent<T: Real>(diagonal: &Vector6<T>, shift: &RigidShift<T>) -> Vector6<T> {
    let (a, b) = (crate::spatial::angular(diagonal), crate::spatial::linear(diagonal));
    let (r, l) = (&shift.rotation, &shift.lever);
    let (turned, moved) = (turned(r, &a), turned(r, &b));
    let (two, four) = (a[0].constant(2.0), a[0].constant(SPREAD));
    let square = [two * l[0] * l[0], two * l[1] * l[1], two * l[2] * l[2]];
    Vector6::new(
        four * (square[1] * moved[2] + square[2] * moved[1] + turned[0]),
        four * (square[2] * moved[0] + square[0] * moved[2] + turned[1]),
        four * (square[0] * moved[1] + square[1] * moved[0] + turned[2]),
        four * moved[0],
        four * moved[1],
        four * moved[2],
    )
}

/// The terms of the diagonal of R diag(a) R*.
#[inline(always)]
fn turned<T: Real>(r: &nalgebra::Matrix3<T>, a: &Vector3<T>) -> [T; 3] {
    let (trace, three) = (a[0] + a[1] + a[2], a[0].constant(3.0));
    let (r0, r1, r2) = (three * a[0], three * a[1], three * a[2]);
    let row = |i: usize| {
        let sum = r[(i, 0)] * r[(i, 0)] * r0 + r[(i, 1)] * r[(i, 1)] * r1 + r[(i, 2)] * r[(i, 2)] * r2;
        sum.worst(trace)
    };
    [row(0), row(1), row(2)]
}

/// The diagonal that a stage sends on: that of P^+, or of P^- where a row mixes components.
///
/// What rounding makes of P^+ itself is seen from the stage, and where H P^+ = 0 is written the parent sees no more of it; of a row that
/// mixes components it holds to rounding only.
#[inline(always)]
#[must_use]
pub fn left<T: Real>(stage: &Stage<T>, before: &Vector6<T>, after: &Symmetric6<T>) -> Vector6<T> {
    let mixes = matches!(stage.rows, Rows::One(HingeMap::Screw(_)));
    absolute(&if mixes { *before } else { after.diagonal() })
}
