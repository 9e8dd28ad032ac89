//! Forward dynamics through connections as a fixed sequence of operations, for a scalar that records them.
//!
//! The operations are those of [`ConstraintKernel`], which contains no branch on values. Rows that move no joint are
//! masked. Where the sequence does not apply (dependent rows, a state that violates the connections, a residual above
//! rounding), the margin is negative, and the method of the scene computes the state.

use super::auto;
use super::constraints::ConstraintKernel;
use super::forces::Motion;
use super::sweeps::{SweepModel, SweepScratch, general};
use crate::model::Model;
use crate::scalar::Real;

/// The number of refinements that remove the rounding error of the rows.
const CORRECTIONS: usize = 1;

/// Joint accelerations into `qdd`; the forces of the rows, their rank and the residual are in `rows`. Returns the
/// margin, which with `is_estimated` includes the error estimate of the factor of M: negative or NaN for a state that
/// the method of the scene has to compute.
pub(crate) fn forward_dynamics<T: Real>(
    scene: (&Model<T>, &SweepModel<T>),
    (scratch, rows): (&mut SweepScratch<T>, &mut ConstraintKernel<T>),
    (q, qd, tau): (&[T], &[T], &[T]),
    is_estimated: bool,
    qdd: &mut [T],
) -> T {
    let mut margin = if is_estimated {
        auto::estimated_factor(scene, scratch, q, qdd).margin()
    } else {
        general::factor(scene, scratch, q).margin()
    };
    let mut innovations = vec![T::zero(); qdd.len()];
    general::forces::<_, false>(scene, scratch, Motion { q, qd, qdd: None, wrenches: &[] });
    general::innovations::<_, true>(scene, scratch, tau, &mut innovations);
    margin = margin.worst(factor_rows(scene, (scratch, rows), (q, qd)));
    rows.first_step(scratch, tau, &innovations, true);
    for correction in 0..=CORRECTIONS {
        rows.take(&mut innovations);
        qdd.copy_from_slice(&innovations);
        general::smooth(scene, scratch, qdd);
        let [_, within_rounding] = rows.look(scene, scratch, qdd);
        if correction == CORRECTIONS {
            margin = margin.worst(within_rounding);
        }
    }
    margin
}

/// The factor of the rows, compiled once.
#[inline(never)]
fn factor_rows<T: Real>(
    scene: (&Model<T>, &SweepModel<T>),
    (scratch, rows): (&mut SweepScratch<T>, &mut ConstraintKernel<T>),
    at: (&[T], &[T]),
) -> T {
    rows.factor(scene, scratch, at)
}

/// The factors of M at `q` and of the rows of mimic joints. Returns the margin, which is negative or NaN if pivots may
/// have lost five digits.
pub(crate) fn factor<T: Real>(
    scene: (&Model<T>, &SweepModel<T>),
    (scratch, rows): (&mut SweepScratch<T>, &mut ConstraintKernel<T>),
    (q, qd): (&[T], &[T]),
) -> T {
    let [_, near] = general::factor_and_nearness(scene, scratch, q);
    near.margin().worst(factor_rows(scene, (scratch, rows), (q, qd)))
}

/// The accelerations of mimic joints from torques with both factors in the scratch, with the bias of (q, qd) or
/// without. Of each group only the heaviest joint is read, so that rounding errors of the rows are not corrected.
pub(crate) fn solve<T: Real>(
    scene: (&Model<T>, &SweepModel<T>),
    (scratch, rows): (&mut SweepScratch<T>, &mut ConstraintKernel<T>),
    biased: Option<(&[T], &[T])>,
    (tau, qdd): (&[T], &mut [T]),
) {
    if let Some((q, qd)) = biased {
        general::forces::<_, false>(scene, scratch, Motion { q, qd, qdd: None, wrenches: &[] });
        general::innovations::<_, true>(scene, scratch, tau, qdd);
    } else {
        general::innovations::<_, false>(scene, scratch, tau, qdd);
    }
    rows.first_step(scratch, tau, qdd, false);
    rows.take(qdd);
    general::smooth(scene, scratch, qdd);
}
