//! Bounds on the terms that form the diagonal of P^-, axis by axis: what [`cancellation`](super::cancellation) takes rounding relative to.
//!
//! [`Scale`](super::pivots::Scale) has one number for all three axes. A slender body that turns fast about its own axis, where it has
//! next to no inertia, then seems to lose what it never had. Here each axis has its own.

use super::system::{HingeMap, Rows, Stage};
use crate::scalar::Real;
use crate::spatial::{RigidShift, Symmetric6, absolute};
use nalgebra::Vector6;

/// As [`sent`] multiplies: the rounding of P^+ itself, and what a square of a sum has more than the sum of squares.
pub const SPREAD: f64 = 4.0;

/// What P of a stage, with this diagonal, can bring to the diagonal of its parent's: the terms of phi P phi*.
///
/// Of R A R*, entry i is formed of at most the square of the sum of `|R_ij| sqrt(A_jj)`, which is below the trace, and below three times the sum of
/// the squares; of a lever's cross product likewise, with two. About 50 operations.
#[inline(always)]
#[must_use]
pub fn sent<T: Real>(diagonal: &Vector6<T>, shift: &RigidShift<T>) -> Vector6<T> {
    let (turned, moved) =
        (turned(shift, diagonal[0], diagonal[1], diagonal[2]), turned(shift, diagonal[3], diagonal[4], diagonal[5]));
    let (two, four) = (turned[0].constant(2.0), turned[0].constant(SPREAD));
    let l = &shift.lever;
    let (x, y, z) = (two * l[0] * l[0], two * l[1] * l[1], two * l[2] * l[2]);
    Vector6::new(
        four * y.mul_add(moved[2], z.mul_add(moved[1], turned[0])),
        four * z.mul_add(moved[0], x.mul_add(moved[2], turned[1])),
        four * x.mul_add(moved[1], y.mul_add(moved[0], turned[2])),
        four * moved[0],
        four * moved[1],
        four * moved[2],
    )
}

/// The terms of the diagonal of R A R*, by the diagonal of A.
#[inline(always)]
fn turned<T: Real>(shift: &RigidShift<T>, a: T, b: T, c: T) -> [T; 3] {
    let trace = a + b + c;
    let three = a.constant(3.0);
    let thrice = [three * a, three * b, three * c];
    [
        of_row(shift, 0, &thrice).worst(trace),
        of_row(shift, 1, &thrice).worst(trace),
        of_row(shift, 2, &thrice).worst(trace),
    ]
}

/// The squares of a row of R, weighed.
#[inline(always)]
fn of_row<T: Real>(shift: &RigidShift<T>, i: usize, weights: &[T; 3]) -> T {
    let (x, y, z) = (shift.rotation[(i, 0)], shift.rotation[(i, 1)], shift.rotation[(i, 2)]);
    (x * x).mul_add(weights[0], (y * y).mul_add(weights[1], z * z * weights[2]))
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

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix6, Rotation3, Vector3};

    /// No entry of the diagonal of phi P phi* is above the bound, and none of the bounds is far above the largest entry that there can be.
    #[test]
    fn nothing_that_a_shift_sends_is_above_the_bound() {
        #[allow(clippy::cast_precision_loss)] // small indices
        let wave = |seed: usize, i: usize| (1.0 + 7.3 * seed as f64 + 2.9 * i as f64).sin();
        for seed in 0..200 {
            let root = Matrix6::from_fn(|i, j| wave(seed, 6 * i + j) * 10_f64.powf(3.0 * wave(seed + 1000, j)));
            let p = root * root.transpose();
            let turn = Vector3::from_fn(|i, _| 3.0 * wave(seed + 2000, i));
            let lever = Vector3::from_fn(|i, _| 10_f64.powf(wave(seed, i)) * wave(seed + 3000, i));
            let shift = RigidShift { rotation: *Rotation3::new(turn).matrix(), lever };
            let phi = shift.to_matrix();
            let sent_there = (phi * p * phi.transpose()).diagonal();
            let bound = sent(&p.diagonal(), &shift);
            for i in 0..6 {
                assert!(sent_there[i] <= bound[i], "{seed} {i}: {} {}", sent_there[i], bound[i]);
            }
            let most = SPREAD * 3.0 * (p.trace() * (1.0 + 2.0 * lever.norm_squared()));
            assert!(bound.max() <= most, "{seed}: {} {most}", bound.max());
        }
    }
}
