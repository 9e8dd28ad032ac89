//! Transform of any joint, by a rotation matrix and an offset.

use super::covariance::{packed, unpacked};
use super::{TERMS_SPREAD, Transform, accumulate};
use crate::scalar::Real;
use crate::spatial::{BodyInertia, RigidShift, Root6, RootColumns};
use nalgebra::{Vector3, Vector6};

impl<T: Real> Transform<T> for RigidShift<T> {
    #[inline(always)]
    fn offset_square(&self) -> T {
        self.lever_square()
    }

    #[inline(always)]
    fn rotate_to_parent(&self, [x, y, z]: [T; 3]) -> [T; 3] {
        self.rotate(&Vector3::new(x, y, z)).into()
    }

    #[inline(always)]
    fn rotate_to_child(&self, [x, y, z]: [T; 3]) -> [T; 3] {
        self.rotate_back(&Vector3::new(x, y, z)).into()
    }

    #[inline(always)]
    fn offset_at_parent(&self) -> [T; 3] {
        self.lever.into()
    }

    #[inline(always)]
    fn send_force(&self, z: &[T; 6], begins: bool, sum: &mut [T; 6]) {
        accumulate(&self.force_to_parent(&Vector6::from(*z)).into(), begins, sum);
    }

    #[inline(always)]
    fn carry_motion(&self, lambda: &[T; 6]) -> [T; 6] {
        Self::motion_to_child(self, &Vector6::from(*lambda)).into()
    }

    #[inline(always)]
    fn send_covariance(&self, p: &[T; 21], begins: bool, sum: &mut [T; 21]) {
        accumulate(&packed(&self.inertia_to_parent(&unpacked(p))), begins, sum);
    }

    #[inline(always)]
    fn composite_to_parent(&self, r: &BodyInertia<T>) -> BodyInertia<T> {
        r.to_parent(self)
    }

    #[inline(always)]
    fn send_terms(&self, diagonal: &[T; 6], begins: bool, sum: &mut [T; 6]) {
        let [a, b, c, d, e, f] = *diagonal;
        let (turned, moved) = (turned(self, a, b, c), turned(self, d, e, f));
        let (two, four) = (a.constant(2.0), a.constant(TERMS_SPREAD));
        let l = &self.lever;
        let (x, y, z) = (two * l[0] * l[0], two * l[1] * l[1], two * l[2] * l[2]);
        let terms = [
            four * y.mul_add(moved[2], z.mul_add(moved[1], turned[0])),
            four * z.mul_add(moved[0], x.mul_add(moved[2], turned[1])),
            four * x.mul_add(moved[1], y.mul_add(moved[0], turned[2])),
            four * moved[0],
            four * moved[1],
            four * moved[2],
        ];
        accumulate(&terms, begins, sum);
    }

    #[inline(always)]
    fn root_to_parent(&self, root: &Root6<T>, columns: &mut RootColumns<T>) {
        Self::root_to_parent(self, root, columns);
    }
}

/// Bounds on the diagonal of R A R*, from those on the diagonal of A.
#[inline(always)]
fn turned<T: Real>(shift: &RigidShift<T>, a: T, b: T, c: T) -> [T; 3] {
    let trace = a + b + c;
    let three = a.constant(3.0);
    let thrice = [three * a, three * b, three * c];
    [
        of_row(shift, 0, &thrice).worst(trace),
        of_row(shift, 1, &thrice).worst(trace),
        of_row(shift, 2, &thrice).worst(trace),
    ]
}

/// The weighted sum of the squares of a row of R.
#[inline(always)]
fn of_row<T: Real>(shift: &RigidShift<T>, i: usize, weights: &[T; 3]) -> T {
    let (x, y, z) = (shift.rotation[(i, 0)], shift.rotation[(i, 1)], shift.rotation[(i, 2)]);
    (x * x).mul_add(weights[0], (y * y).mul_add(weights[1], z * z * weights[2]))
}
