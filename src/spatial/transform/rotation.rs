//! Rotations of a body on a revolute joint.

use super::AxialRotation;
use super::axes::{Axes, Axis, Order, about};
use super::constant_rotation::ConstantRotation;
use crate::scalar::{ColumnsOf, Real};

/// The rotation from the frame of a body on a revolute joint to the joint frame: about z by the joint angle
/// ([`AxialRotation`]); for an oblique axis followed by a constant rotation to the parent frame ([`ObliqueRotation`]).
pub(crate) trait Rotates<T: Real>: Copy {
    /// True if there is a constant rotation.
    const IS_OBLIQUE: bool;

    /// The same rotation for several columns.
    type Spread<C: ColumnsOf<T>>: Rotates<C>;

    /// The rotation by the joint angle alone.
    fn turn(&self) -> AxialRotation<T>;

    /// Applies the constant rotation alone.
    fn tilt(&self, v: [T; 3]) -> [T; 3];

    /// A vector from the body frame to the joint frame.
    fn rotate(&self, v: [T; 3]) -> [T; 3];

    /// A vector from the joint frame to the body frame.
    fn rotate_back(&self, v: [T; 3]) -> [T; 3];

    /// A symmetric matrix from the body frame to the joint frame.
    fn symmetric(&self, a: [T; 6]) -> [T; 6];

    /// A covariance in 6 + 9 + 6 entries from the body frame to the joint frame.
    fn covariance(&self, p: &[T; 21]) -> [T; 21];

    /// The same rotation for several columns.
    fn spread<C: ColumnsOf<T>>(&self, like: C) -> Self::Spread<C>;
}

impl<T: Real> Rotates<T> for AxialRotation<T> {
    const IS_OBLIQUE: bool = false;

    type Spread<C: ColumnsOf<T>> = AxialRotation<C>;

    #[inline(always)]
    fn turn(&self) -> AxialRotation<T> {
        *self
    }

    #[inline(always)]
    fn tilt(&self, v: [T; 3]) -> [T; 3] {
        v
    }

    #[inline(always)]
    fn rotate(&self, [x, y, z]: [T; 3]) -> [T; 3] {
        let (x, y) = self.pair(x, y);
        [x, y, z]
    }

    #[inline(always)]
    fn rotate_back(&self, [x, y, z]: [T; 3]) -> [T; 3] {
        let AxialRotation { s, c } = *self;
        [c.mul_add(x, s * y), (c * y).minus_product(s, x), z]
    }

    #[inline(always)]
    fn symmetric(&self, [xx, xy, xz, yy, yz, zz]: [T; 6]) -> [T; 6] {
        let (xz, yz) = self.pair(xz, yz);
        let (xx, xy, yy) = self.plane((xx, xy, yy));
        [xx, xy, xz, yy, yz, zz]
    }

    #[inline(always)]
    fn covariance(&self, p: &[T; 21]) -> [T; 21] {
        let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *p;
        let (a0, a1, a3) = self.plane((a0, a1, a3));
        let (b0, b1, b3) = self.plane((b0, b1, b3));
        let (b2, b4) = self.pair(b2, b4);
        let [c0, c1, c3, c4] = self.square([c0, c1, c3, c4]);
        let (c2, c5) = self.pair(c2, c5);
        let ((a2, a4), (c6, c7)) = (self.pair(a2, a4), self.pair(c6, c7));
        [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5]
    }

    #[inline(always)]
    fn spread<C: ColumnsOf<T>>(&self, like: C) -> AxialRotation<C> {
        AxialRotation { s: like.spread(self.s), c: like.spread(self.c) }
    }
}

/// The rotation about an oblique axis.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ObliqueRotation<T> {
    turn: AxialRotation<T>,
    axis: Axis,
    about_x: AxialRotation<T>,
    about_z: AxialRotation<T>,
    turns_about_z: bool,
}

impl<T: Real> ObliqueRotation<T> {
    #[inline(always)]
    pub fn new(turn: AxialRotation<T>, tilt: &ConstantRotation<T::Parameter>) -> Self {
        Self {
            turn,
            axis: tilt.axis,
            about_x: AxialRotation::splat(turn.s, tilt.about_x),
            about_z: AxialRotation::splat(turn.s, tilt.about_z),
            turns_about_z: tilt.turns_about_z,
        }
    }

    /// Applies the second constant rotation and the permutation of axes.
    #[inline(always)]
    fn and_about_z(&self, mut p: [T; 21]) -> [T; 21] {
        if self.turns_about_z {
            p = self.about_z.covariance(&p);
        }
        about!(self.axis, X, Y, Z, Order::<X, Y, Z>::covariance(&p))
    }
}

impl<T: Real> Rotates<T> for ObliqueRotation<T> {
    const IS_OBLIQUE: bool = true;

    type Spread<C: ColumnsOf<T>> = ObliqueRotation<C>;

    #[inline(always)]
    fn turn(&self) -> AxialRotation<T> {
        self.turn
    }

    #[inline(always)]
    fn tilt(&self, [x, y, z]: [T; 3]) -> [T; 3] {
        let (y, z) = self.about_x.pair(y, z);
        let mut v = [x, y, z];
        if self.turns_about_z {
            v = self.about_z.rotate(v);
        }
        about!(self.axis, X, Y, Z, Order::<X, Y, Z>.vector(v))
    }

    #[inline(always)]
    fn rotate(&self, v: [T; 3]) -> [T; 3] {
        self.tilt(self.turn.rotate(v))
    }

    #[inline(always)]
    fn rotate_back(&self, v: [T; 3]) -> [T; 3] {
        let mut v = about!(self.axis, X, Y, Z, Order::<X, Y, Z>::vector_to_joint(v));
        if self.turns_about_z {
            v = self.about_z.rotate_back(v);
        }
        let (y, z) = self.about_x.inverse().pair(v[1], v[2]);
        self.turn.rotate_back([v[0], y, z])
    }

    #[inline(always)]
    fn symmetric(&self, a: [T; 6]) -> [T; 6] {
        let [xx, xy, xz, yy, yz, zz] = self.turn.symmetric(a);
        let (yy, yz, zz) = self.about_x.plane((yy, yz, zz));
        let (xy, xz) = self.about_x.pair(xy, xz);
        let mut a = [xx, xy, xz, yy, yz, zz];
        if self.turns_about_z {
            a = self.about_z.symmetric(a);
        }
        about!(self.axis, X, Y, Z, Order::<X, Y, Z>.symmetric(&a))
    }

    #[inline(always)]
    fn covariance(&self, p: &[T; 21]) -> [T; 21] {
        self.and_about_z(about_x(self.about_x, &self.turn.covariance(p)))
    }

    #[inline(always)]
    fn spread<C: ColumnsOf<T>>(&self, like: C) -> ObliqueRotation<C> {
        let Self { turn, axis, about_x, about_z, turns_about_z } = *self;
        ObliqueRotation {
            turn: turn.spread(like),
            axis,
            about_x: about_x.spread(like),
            about_z: about_z.spread(like),
            turns_about_z,
        }
    }
}

/// Rx P Rx*.
#[inline(always)]
pub(crate) fn about_x<T: Real>(turn: AxialRotation<T>, p: &[T; 21]) -> [T; 21] {
    let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *p;
    let ((a3, a4, a5), (b3, b4, b5)) = (turn.plane((a3, a4, a5)), turn.plane((b3, b4, b5)));
    let ((a1, a2), (b1, b2)) = (turn.pair(a1, a2), turn.pair(b1, b2));
    let [c4, c5, c7, c8] = turn.square([c4, c5, c7, c8]);
    let ((c1, c2), (c3, c6)) = (turn.pair(c1, c2), turn.pair(c3, c6));
    [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5]
}

#[cfg(test)]
mod tests {
    use super::{ObliqueRotation, Rotates};
    use crate::spatial::transform::ConstantRotation;
    use crate::spatial::transform::covariance::unpacked;
    use crate::spatial::transform::{AxialRotation, Axis};
    use crate::spatial::{Symmetric3, Symmetric6};
    use nalgebra::{Matrix3, Matrix6, Vector3};

    fn wave(i: usize) -> f64 {
        (1.7 * f64::from(u8::try_from(i).expect("small")) + 0.3).sin()
    }

    fn near(found: &[f64], expected: &[f64]) -> bool {
        found.len() == expected.len() && found.iter().zip(expected).all(|(a, b)| (a - b).abs() <= 16.0 * f64::EPSILON)
    }

    fn twice(rotation: &Matrix3<f64>) -> Matrix6<f64> {
        let mut both = Matrix6::zeros();
        both.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation);
        both.fixed_view_mut::<3, 3>(3, 3).copy_from(rotation);
        both
    }

    fn check(rotation: &impl Rotates<f64>, matrix: &Matrix3<f64>) {
        let (v, back) = (Vector3::from_fn(|i, _| wave(i)), matrix.transpose());
        assert!(near(&rotation.rotate(v.into()), (matrix * v).as_slice()));
        assert!(near(&rotation.rotate_back(v.into()), (back * v).as_slice()));
        let symmetric = Symmetric3::new(std::array::from_fn(|i| wave(i + 6)));
        assert!(near(&rotation.symmetric(symmetric.entries), &symmetric.congruence(matrix).entries));
        let p: [f64; 21] = std::array::from_fn(|i| wave(i + 20));
        let whole = |p: &[f64; 21]| -> Matrix6<f64> { Symmetric6::to_matrix(&unpacked(p)) };
        let there = |p: &[f64; 21]| twice(matrix) * whole(p) * twice(&back);
        assert!(near(whole(&rotation.covariance(&p)).as_slice(), there(&p).as_slice()));
    }

    /// Every operation of a rotation equals that of its matrix.
    #[test]
    fn what_is_rotated_plane_by_plane_is_rotated_by_the_matrix() {
        for (direction, axis, in_plane) in [
            (Vector3::new(0.0, -0.6, 0.8), 2, true),
            (Vector3::new(-0.6, 0.0, 0.8), 0, true),
            (Vector3::new(0.6, -0.8, 0.0), 1, true),
            (Vector3::new(0.6, -0.64, -0.48), 0, false),
            (Vector3::new(0.6, -0.64, -0.48), 1, false),
            (Vector3::new(0.6, -0.64, -0.48), 2, false),
        ] {
            let tilt = ConstantRotation::to(&direction, Axis::new(axis), in_plane);
            assert!(near((tilt.matrix() * Vector3::z()).as_slice(), direction.as_slice()));
            let turn = AxialRotation { s: 0.28, c: 0.96 };
            let rotation = ObliqueRotation::new(turn, &tilt);
            let about_z = Matrix3::new(0.96, -0.28, 0.0, 0.28, 0.96, 0.0, 0.0, 0.0, 1.0);
            check(&rotation, &(tilt.matrix() * about_z));
            check(&turn, &about_z);
            let v = Vector3::from_fn(|i, _| wave(i));
            assert!(near(&rotation.tilt(v.into()), (tilt.matrix() * v).as_slice()));
            assert!(near(&turn.tilt(v.into()), v.as_slice()));
        }
    }
}
