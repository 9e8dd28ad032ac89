//! M^-1: the factor, and the [product](super::inverse_product) of its parts.

use super::filter;
use super::model::SweepModel;
use super::motion::carriers;
use super::scratch::SweepScratch;
use crate::filter::pivots::PivotMonitor;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};

/// The factor of M at `q`, in the scratch, in covariance form.
#[inline(always)]
pub(crate) fn factor<T: Real, C: ColumnsOf<T>>(
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    q: &[T],
) -> PivotMonitor<T> {
    carriers(scene.1, scratch, C::zero(), q);
    refactor(scene, scratch)
}

/// [`factor`] with the rotations and shifts of the joints in the scratch.
#[inline(always)]
pub(crate) fn refactor<T: Real>(scene: (&Model<T>, &SweepModel<T>), scratch: &mut SweepScratch<T>) -> PivotMonitor<T> {
    let [monitor, _] = filter::tip_to_base::<T, { filter::FACTOR }>(scene, scratch, &[], &mut []);
    monitor
}
