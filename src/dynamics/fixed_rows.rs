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
    let margin = factor(scene, (scratch, rows), (q, qd), is_estimated);
    general::forces::<_, false>(scene, scratch, Motion { q, qd, qdd: None, wrenches: &[] });
    general::innovations::<_, true>(scene, scratch, tau, qdd);
    margin.worst(through_rows(scene, (scratch, rows), tau, qdd))
}

/// The factors of M at `q` and of the rows. Returns the margin, as [`forward_dynamics`].
pub(crate) fn factor<T: Real>(
    scene: (&Model<T>, &SweepModel<T>),
    (scratch, rows): (&mut SweepScratch<T>, &mut ConstraintKernel<T>),
    (q, qd): (&[T], &[T]),
    is_estimated: bool,
) -> T {
    let of_tree = if is_estimated {
        auto::estimated_factor(scene, scratch, q, &mut vec![T::zero(); qd.len()]).margin()
    } else {
        general::factor(scene, scratch, q).margin()
    };
    of_tree.worst(rows.factor(scene, scratch, qd))
}

/// M^-1 through the rows times torques, for rows whose J' qd is zero, with both factors in the scratch. Returns the
/// margin of the residual.
pub(crate) fn solve<T: Real>(
    scene: (&Model<T>, &SweepModel<T>),
    (scratch, rows): (&mut SweepScratch<T>, &mut ConstraintKernel<T>),
    tau: &[T],
    qdd: &mut [T],
) -> T {
    general::innovations::<_, false>(scene, scratch, tau, qdd);
    through_rows(scene, (scratch, rows), tau, qdd)
}

/// Accelerations from torques; `qdd` holds the innovations of the tree on entry. Returns the margin of the residual.
fn through_rows<T: Real>(
    scene: (&Model<T>, &SweepModel<T>),
    (scratch, rows): (&mut SweepScratch<T>, &mut ConstraintKernel<T>),
    tau: &[T],
    qdd: &mut [T],
) -> T {
    let (mut innovations, mut margin) = (qdd.to_vec(), T::one());
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
