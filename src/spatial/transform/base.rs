//! Transform between a floating body and the base, to which nothing is propagated.

use super::Transform;
use crate::scalar::Real;
use crate::spatial::{BodyInertia, Root6, RootColumns};

/// phi to the base: sums are unchanged, and motions are zero. The value determines only the type of the zeros.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Base<T>(pub T);

impl<T: Real> Transform<T> for Base<T> {
    #[inline(always)]
    fn offset_square(&self) -> T {
        self.0.constant(0.0)
    }

    #[inline(always)]
    fn rotate_to_parent(&self, v: [T; 3]) -> [T; 3] {
        v
    }

    #[inline(always)]
    fn rotate_to_child(&self, v: [T; 3]) -> [T; 3] {
        v
    }

    #[inline(always)]
    fn offset_at_parent(&self) -> [T; 3] {
        [self.0.constant(0.0); 3]
    }

    #[inline(always)]
    fn send_force(&self, _z: &[T; 6], _begins: bool, _sum: &mut [T; 6]) {}

    #[inline(always)]
    fn carry_motion(&self, _lambda: &[T; 6]) -> [T; 6] {
        [self.0.constant(0.0); 6]
    }

    #[inline(always)]
    fn send_covariance(&self, _p: &[T; 21], _begins: bool, _sum: &mut [T; 21]) {}

    #[inline(always)]
    fn composite_to_parent(&self, r: &BodyInertia<T>) -> BodyInertia<T> {
        *r
    }

    #[inline(always)]
    fn send_terms(&self, _diagonal: &[T; 6], _begins: bool, _sum: &mut [T; 6]) {}

    #[inline(always)]
    fn root_to_parent(&self, _root: &Root6<T>, _columns: &mut RootColumns<T>) {}
}
