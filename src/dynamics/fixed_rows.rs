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
    margin = margin.worst(rows.begin(scene, scratch, (qd, tau), &innovations));
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
