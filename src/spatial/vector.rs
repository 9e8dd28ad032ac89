//! Spatial vectors and their cross products.

use crate::scalar::Real;
use nalgebra::{Matrix3, Vector3, Vector6};

/// A spatial force (moment, force) or motion (angular, linear), in SI units, in the frame that its owner names.
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

/// The cross product a x b.
#[inline(always)]
pub fn cross<T: Real>(a: &Vector3<T>, b: &Vector3<T>) -> Vector3<T> {
    Vector3::new(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
}

/// The matrix of the cross product, `skew(a) b = a x b`.
pub fn skew<T: Real>(a: &Vector3<T>) -> Matrix3<T> {
    let o = T::zero();
    Matrix3::new(o, -a[2], a[1], a[2], o, -a[0], -a[1], a[0], o)
}

/// The scalar product of two spatial vectors, a force times a motion.
#[inline(always)]
pub fn dot<T: Real>(a: &Vector6<T>, b: &Vector6<T>) -> T {
    (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3]) + (a[4] * b[4] + a[5] * b[5])
}

/// Rate of change of the motion `m` carried along by the motion `v`: (w x `m_w`, w x `m_v` + v x `m_w`).
#[inline(always)]
pub fn cross_motion<T: Real>(v: &Vector6<T>, m: &Vector6<T>) -> Vector6<T> {
    let (w, u) = (angular(v), linear(v));
    let (mw, mv) = (angular(m), linear(m));
    spatial(&cross(&w, &mw), &(cross(&w, &mv) + cross(&u, &mw)))
}

/// Rate of change of the force `f` carried along by the motion `v`: (w x n + v x f, w x f).
#[inline(always)]
pub fn cross_force<T: Real>(v: &Vector6<T>, f: &Vector6<T>) -> Vector6<T> {
    let (w, u) = (angular(v), linear(v));
    let (n, p) = (angular(f), linear(f));
    spatial(&(cross(&w, &n) + cross(&u, &p)), &cross(&w, &p))
}
