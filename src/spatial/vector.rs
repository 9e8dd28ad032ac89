//! Spatial vectors, their cross products, and sums of products.
//!
//! Vectorized code calls functions that are always inlined, and no closures: a closure that is called twice becomes a
//! function compiled for the baseline instruction set instead of that of the arm.

use crate::scalar::Real;
use nalgebra::{Matrix3, Vector3, Vector6};

/// A spatial force (moment, force) or motion (angular, linear), in SI units; the documentation of each use names its
/// frame.
pub type SpatialVector<T> = Vector6<T>;

/// The angular (first) half: moment in N m, angular velocity in rad/s.
#[inline(always)]
pub fn angular<T: Real>(x: &Vector6<T>) -> Vector3<T> {
    Vector3::new(x[0], x[1], x[2])
}

/// The linear (second) half: force in N, velocity in m/s.
#[inline(always)]
pub fn linear<T: Real>(x: &Vector6<T>) -> Vector3<T> {
    Vector3::new(x[3], x[4], x[5])
}

/// The spatial vector with the given halves.
#[inline(always)]
pub fn spatial<T: Real>(angular: &Vector3<T>, linear: &Vector3<T>) -> Vector6<T> {
    Vector6::new(angular[0], angular[1], angular[2], linear[0], linear[1], linear[2])
}

/// a b - c d.
#[inline(always)]
pub(crate) fn minus<T: Real>(a: T, b: T, c: T, d: T) -> T {
    a.mul_add(b, -(c * d))
}

/// The sum of three products.
#[inline(always)]
pub(crate) fn sum3<T: Real>(a: [T; 3], b: [T; 3]) -> T {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

/// a - b.
#[inline(always)]
pub(crate) fn less<T: Real>(a: &Vector3<T>, b: &Vector3<T>) -> Vector3<T> {
    Vector3::new(a[0] - b[0], a[1] - b[1], a[2] - b[2])
}

/// The square of the length.
#[inline(always)]
pub(crate) fn square<T: Real>(a: &Vector3<T>) -> T {
    sum3([a[0], a[1], a[2]], [a[0], a[1], a[2]])
}

/// Row `i` of a matrix.
#[inline(always)]
pub(crate) fn row<T: Real>(m: &Matrix3<T>, i: usize) -> [T; 3] {
    [m[(i, 0)], m[(i, 1)], m[(i, 2)]]
}

/// Column `j` of a matrix.
#[inline(always)]
pub(crate) fn column<T: Real>(m: &Matrix3<T>, j: usize) -> [T; 3] {
    [m[(0, j)], m[(1, j)], m[(2, j)]]
}

/// A B.
#[inline(always)]
pub(crate) fn product<T: Real>(a: &Matrix3<T>, b: &Matrix3<T>) -> Matrix3<T> {
    from_rows(times(row(a, 0), b), times(row(a, 1), b), times(row(a, 2), b))
}

/// t C for a row t.
#[inline(always)]
pub(crate) fn times<T: Real>(t: [T; 3], c: &Matrix3<T>) -> [T; 3] {
    [sum3(t, column(c, 0)), sum3(t, column(c, 1)), sum3(t, column(c, 2))]
}

/// The matrix with these rows.
#[inline(always)]
pub(crate) fn from_rows<T: Real>(x: [T; 3], y: [T; 3], z: [T; 3]) -> Matrix3<T> {
    Matrix3::new(x[0], x[1], x[2], y[0], y[1], y[2], z[0], z[1], z[2])
}

/// The cross product a x b.
#[inline(always)]
pub fn cross<T: Real>(a: &Vector3<T>, b: &Vector3<T>) -> Vector3<T> {
    Vector3::new(minus(a[1], b[2], a[2], b[1]), minus(a[2], b[0], a[0], b[2]), minus(a[0], b[1], a[1], b[0]))
}

/// a x b + c.
#[inline(always)]
pub(crate) fn cross_add<T: Real>(a: &Vector3<T>, b: &Vector3<T>, c: &Vector3<T>) -> Vector3<T> {
    Vector3::new(
        a[1].mul_add(b[2], c[0].minus_product(a[2], b[1])),
        a[2].mul_add(b[0], c[1].minus_product(a[0], b[2])),
        a[0].mul_add(b[1], c[2].minus_product(a[1], b[0])),
    )
}

/// The matrix of the cross product, `skew(a) b = a x b`.
#[inline(always)]
pub fn skew<T: Real>(a: &Vector3<T>) -> Matrix3<T> {
    let o = T::zero();
    Matrix3::new(o, -a[2], a[1], a[2], o, -a[0], -a[1], a[0], o)
}

/// The scalar product of two spatial vectors, such as a force and a motion.
#[inline(always)]
pub fn dot<T: Real>(a: &Vector6<T>, b: &Vector6<T>) -> T {
    // Two chains of dependent products, each half as long.
    let even = a[0].mul_add(b[0], a[2].mul_add(b[2], a[4] * b[4]));
    let odd = a[1].mul_add(b[1], a[3].mul_add(b[3], a[5] * b[5]));
    even + odd
}

/// The zero vector.
#[inline(always)]
#[must_use]
pub fn zero<T: Real>() -> Vector6<T> {
    let o = T::zero();
    Vector6::new(o, o, o, o, o, o)
}

/// Entrywise products.
#[inline(always)]
pub(crate) fn times_each<T: Real>(x: &Vector6<T>, y: &Vector6<T>) -> Vector6<T> {
    Vector6::new(x[0] * y[0], x[1] * y[1], x[2] * y[2], x[3] * y[3], x[4] * y[4], x[5] * y[5])
}

/// Entrywise absolute values.
#[inline(always)]
pub(crate) fn absolute<T: Real>(x: &Vector6<T>) -> Vector6<T> {
    Vector6::new(x[0].abs(), x[1].abs(), x[2].abs(), x[3].abs(), x[4].abs(), x[5].abs())
}

/// x s + y.
#[inline(always)]
pub fn scaled_add<T: Real>(x: &Vector6<T>, s: T, y: &Vector6<T>) -> Vector6<T> {
    Vector6::new(
        x[0].mul_add(s, y[0]),
        x[1].mul_add(s, y[1]),
        x[2].mul_add(s, y[2]),
        x[3].mul_add(s, y[3]),
        x[4].mul_add(s, y[4]),
        x[5].mul_add(s, y[5]),
    )
}

/// x s.
#[inline(always)]
pub fn scaled<T: Real>(x: &Vector6<T>, s: T) -> Vector6<T> {
    Vector6::new(x[0] * s, x[1] * s, x[2] * s, x[3] * s, x[4] * s, x[5] * s)
}

/// x + y, entry by entry.
#[inline(always)]
pub fn sum<T: Real>(x: &Vector6<T>, y: &Vector6<T>) -> Vector6<T> {
    Vector6::new(x[0] + y[0], x[1] + y[1], x[2] + y[2], x[3] + y[3], x[4] + y[4], x[5] + y[5])
}

/// Motion cross product v x m = (w x `m_w`, w x `m_v` + v x `m_w`): the time derivative of the motion `m` fixed in a
/// frame that moves with `v`.
#[inline(always)]
pub fn cross_motion<T: Real>(v: &Vector6<T>, m: &Vector6<T>) -> Vector6<T> {
    let (w, u) = (angular(v), linear(v));
    let (mw, mv) = (angular(m), linear(m));
    spatial(&cross(&w, &mw), &cross_add(&w, &mv, &cross(&u, &mw)))
}

/// Force cross product v x* f = (w x n + v x f, w x f): the time derivative of the force `f` fixed in a frame that
/// moves with `v`.
#[inline(always)]
pub fn cross_force<T: Real>(v: &Vector6<T>, f: &Vector6<T>) -> Vector6<T> {
    let (w, u) = (angular(v), linear(v));
    let (n, p) = (angular(f), linear(f));
    spatial(&cross_add(&w, &n, &cross(&u, &p)), &cross(&w, &p))
}
