//! P as 21 entries, 6 + 9 + 6: the angular block, the coupling block by rows, the linear block.

use super::offset::Offset;
use crate::scalar::Real;
use crate::spatial::{Symmetric3, Symmetric6};
use nalgebra::Matrix3;

/// Shifts P along the z, x and y components of the offset in turn: C' = C + l~ B, A' = A + l~ C^T + C' l~^T.
#[inline(always)]
pub(crate) fn along_offset<T: Real>(offset: &Offset<T>, p: &[T; 21]) -> [T; 21] {
    let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *p;
    let (mut a0, mut a1, mut a2, mut a3, mut a4, mut a5) = (a0, a1, a2, a3, a4, a5);
    let (mut c0, mut c1, mut c2, mut c3, mut c4, mut c5, mut c6, mut c7, mut c8) = (c0, c1, c2, c3, c4, c5, c6, c7, c8);
    let [x, y, z] = offset.entries;
    // Along z.
    let (s0, s1, s2) = (c0.minus_product(z, b1), c1.minus_product(z, b3), c2.minus_product(z, b4));
    let (s3, s4, s5) = (z.mul_add(b0, c3), z.mul_add(b1, c4), z.mul_add(b2, c5));
    a0 = a0.minus_product(z, s1 + c1);
    a1 = z.mul_add(s0 - c4, a1);
    a3 = z.mul_add(s3 + c3, a3);
    a2 = a2.minus_product(z, c7);
    a4 = z.mul_add(c6, a4);
    (c0, c1, c2, c3, c4, c5) = (s0, s1, s2, s3, s4, s5);
    // Along x.
    let (s3, s4, s5) = (c3.minus_product(x, b2), c4.minus_product(x, b4), c5.minus_product(x, b5));
    let (s6, s7, s8) = (x.mul_add(b1, c6), x.mul_add(b3, c7), x.mul_add(b4, c8));
    a1 = a1.minus_product(x, c2);
    a2 = x.mul_add(c1, a2);
    a3 = a3.minus_product(x, s5 + c5);
    a4 = x.mul_add(s4 - c8, a4);
    a5 = x.mul_add(s7 + c7, a5);
    (c3, c4, c5, c6, c7, c8) = (s3, s4, s5, s6, s7, s8);
    // Along y.
    let (s0, s1, s2) = (y.mul_add(b2, c0), y.mul_add(b4, c1), y.mul_add(b5, c2));
    let (s6, s7, s8) = (c6.minus_product(y, b0), c7.minus_product(y, b1), c8.minus_product(y, b2));
    a0 = y.mul_add(s2 + c2, a0);
    a1 = y.mul_add(c5, a1);
    a2 = y.mul_add(c8 - s0, a2);
    a4 = a4.minus_product(y, c3);
    a5 = a5.minus_product(y, s6 + c6);
    (c0, c1, c2, c6, c7, c8) = (s0, s1, s2, s6, s7, s8);
    [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5]
}

/// Conversion to the type that the general stages use.
#[inline(always)]
pub(crate) fn unpacked<T: Real>(p: &[T; 21]) -> Symmetric6<T> {
    let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *p;
    Symmetric6 {
        angular: Symmetric3::new([a0, a1, a2, a3, a4, a5]),
        coupling: Matrix3::new(c0, c1, c2, c3, c4, c5, c6, c7, c8),
        linear: Symmetric3::new([b0, b1, b2, b3, b4, b5]),
    }
}

/// Conversion to the type that these sweeps use.
#[inline(always)]
pub(crate) fn packed<T: Real>(p: &Symmetric6<T>) -> [T; 21] {
    let ([a0, a1, a2, a3, a4, a5], [b0, b1, b2, b3, b4, b5], c) = (p.angular.entries, p.linear.entries, &p.coupling);
    [
        a0,
        a1,
        a2,
        a3,
        a4,
        a5,
        c[(0, 0)],
        c[(0, 1)],
        c[(0, 2)],
        c[(1, 0)],
        c[(1, 1)],
        c[(1, 2)],
        c[(2, 0)],
        c[(2, 1)],
        c[(2, 2)],
        b0,
        b1,
        b2,
        b3,
        b4,
        b5,
    ]
}
