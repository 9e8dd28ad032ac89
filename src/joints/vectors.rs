//! Vector operations on slices.

use crate::scalar::Real;
use nalgebra::Vector3;

/// The first three entries of a slice as a vector.
#[inline(always)]
pub(crate) fn triple<T: Real>(x: &[T]) -> Vector3<T> {
    Vector3::new(x[0], x[1], x[2])
}

/// a x b.
#[inline(always)]
pub(crate) fn cross<T: Real>(a: &Vector3<T>, b: &Vector3<T>) -> Vector3<T> {
    Vector3::new(
        (a[1] * b[2]).minus_product(a[2], b[1]),
        (a[2] * b[0]).minus_product(a[0], b[2]),
        (a[0] * b[1]).minus_product(a[1], b[0]),
    )
}

/// a + s b.
#[inline(always)]
pub(crate) fn plus<T: Real>(a: &Vector3<T>, s: T, b: &Vector3<T>) -> Vector3<T> {
    Vector3::new(s.mul_add(b[0], a[0]), s.mul_add(b[1], a[1]), s.mul_add(b[2], a[2]))
}

/// Writes a vector to the first three entries of a slice.
#[inline(always)]
pub(crate) fn write<T: Real>(to: &mut [T], x: &Vector3<T>) {
    to[0] = x[0];
    to[1] = x[1];
    to[2] = x[2];
}
