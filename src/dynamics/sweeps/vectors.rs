//! Products of vectors whose entries are in lanes.

use crate::scalar::Real;

/// c - a x k, k in every lane.
#[inline(always)]
pub(super) fn minus_cross_number<T: Real>(a: [T; 3], k: [T::Parameter; 3], c: [T; 3]) -> [T; 3] {
    let (x, y, z) = (a[0].splat(k[0]), a[0].splat(k[1]), a[0].splat(k[2]));
    [
        a[2].mul_add(y, c[0].minus_product(a[1], z)),
        a[0].mul_add(z, c[1].minus_product(a[2], x)),
        a[1].mul_add(x, c[2].minus_product(a[0], y)),
    ]
}

/// a x b + c.
#[inline(always)]
pub(super) fn cross<T: Real>(a: [T; 3], b: [T; 3], c: [T; 3]) -> [T; 3] {
    [
        a[1].mul_add(b[2], c[0].minus_product(a[2], b[1])),
        a[2].mul_add(b[0], c[1].minus_product(a[0], b[2])),
        a[0].mul_add(b[1], c[2].minus_product(a[1], b[0])),
    ]
}
