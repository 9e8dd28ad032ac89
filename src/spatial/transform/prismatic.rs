//! Transform of a prismatic joint. Its rotation is constant; for P it is decomposed into permutations of axes and up to
//! three constant rotations, about z, about x and about z. The offset varies. All other quantities use the rotation
//! matrix.

use super::axes::{Order, about};
use super::axial_rotation::AxialRotation;
use super::constant_rotation::ConstantRotation;
use super::covariance::along_offset;
use super::decomposed::AboutAxis;
use super::offset::Offset;
use super::rotation::{Rotates, about_x};
use super::{Transform, accumulate};
use crate::scalar::Real;
use crate::spatial::{BodyInertia, RigidShift, Root6, RootColumns};

/// The constants of a prismatic joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ConstantSlide<N> {
    /// The first rotation about z, as sine and cosine, if it is needed.
    about_z: [N; 2],
    turns: bool,
    /// Then the rotation from z to its direction in the parent frame, about x if it is needed.
    tilt: ConstantRotation<N>,
    tilts: bool,
}

impl ConstantSlide<f64> {
    /// For a body whose axes are permuted such that only `about.offset` rotates it about z.
    pub fn of(about: &AboutAxis) -> Self {
        Self {
            about_z: about.offset.unwrap_or([0.0, 1.0]),
            turns: about.offset.is_some(),
            tilt: about.tilt.unwrap_or_else(|| ConstantRotation::none(about.axis)),
            tilts: about.tilt.is_some(),
        }
    }
}

impl<N: Copy> ConstantSlide<N> {
    /// Converts each value.
    pub fn map<M>(&self, number: impl Fn(N) -> M) -> ConstantSlide<M> {
        let Self { about_z: [s, c], turns, tilts, .. } = *self;
        ConstantSlide { about_z: [number(s), number(c)], turns, tilt: self.tilt.map(number), tilts }
    }

    /// R P R*, in the parent frame.
    #[inline(always)]
    fn covariance<T: Real<Parameter = N>>(&self, p: &[T; 21]) -> [T; 21] {
        let (like, mut p) = (p[0], *p);
        if self.turns {
            p = AxialRotation::splat(like, self.about_z).covariance(&p);
        }
        if self.tilts {
            p = about_x(AxialRotation::splat(like, self.tilt.about_x), &p);
        }
        if self.tilt.turns_about_z {
            p = AxialRotation::splat(like, self.tilt.about_z).covariance(&p);
        }
        about!(self.tilt.axis, X, Y, Z, Order::<X, Y, Z>::covariance(&p))
    }
}

/// phi of a prismatic joint: the current pose of the body, and its constant decomposed rotation.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Prismatic<'a, T: Real> {
    pub shift: &'a RigidShift<T>,
    pub rotation: &'a ConstantSlide<T::Parameter>,
}

impl<T: Real> Transform<T> for Prismatic<'_, T> {
    #[inline(always)]
    fn offset_square(&self) -> T {
        self.shift.offset_square()
    }

    #[inline(always)]
    fn rotate_to_parent(&self, v: [T; 3]) -> [T; 3] {
        self.shift.rotate_to_parent(v)
    }

    #[inline(always)]
    fn rotate_to_child(&self, v: [T; 3]) -> [T; 3] {
        self.shift.rotate_to_child(v)
    }

    #[inline(always)]
    fn offset_at_parent(&self) -> [T; 3] {
        self.shift.offset_at_parent()
    }

    #[inline(always)]
    fn send_force(&self, z: &[T; 6], begins: bool, sum: &mut [T; 6]) {
        self.shift.send_force(z, begins, sum);
    }

    #[inline(always)]
    fn carry_motion(&self, lambda: &[T; 6]) -> [T; 6] {
        self.shift.carry_motion(lambda)
    }

    #[inline(always)]
    fn send_covariance(&self, p: &[T; 21], begins: bool, sum: &mut [T; 21]) {
        let offset = Offset { entries: self.shift.lever.into(), square: p[0] };
        accumulate(&along_offset(&offset, &self.rotation.covariance(p)), begins, sum);
    }

    #[inline(always)]
    fn composite_to_parent(&self, r: &BodyInertia<T>) -> BodyInertia<T> {
        self.shift.composite_to_parent(r)
    }

    #[inline(always)]
    fn send_terms(&self, diagonal: &[T; 6], begins: bool, sum: &mut [T; 6]) {
        self.shift.send_terms(diagonal, begins, sum);
    }

    #[inline(always)]
    fn root_to_parent(&self, root: &Root6<T>, columns: &mut RootColumns<T>) {
        self.shift.root_to_parent(root, columns);
    }
}

#[cfg(test)]
mod tests {
    use super::{ConstantSlide, Prismatic};
    use crate::spatial::RigidShift;
    use crate::spatial::transform::AboutAxis;
    use crate::spatial::transform::tests::check;
    use nalgebra::{Matrix3, Rotation3, Unit, Vector3};
    use std::f64::consts::{FRAC_PI_2, PI};

    fn about(axis: Vector3<f64>, angle: f64) -> Matrix3<f64> {
        Rotation3::from_axis_angle(&Unit::new_normalize(axis), angle).into_inner()
    }

    /// The constant rotations equal the matrix: for directions along each parent axis and its negative, in a plane of
    /// two axes and in none, with a rotation about the direction by zero, multiples of pi/2 and other angles. No
    /// unnecessary rotations are used.
    #[test]
    fn what_slides_sends_what_its_shift_does() {
        let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
        let along = [about(z, 0.0), about(y, FRAC_PI_2), about(x, -FRAC_PI_2)].map(|bring| (bring, [false, false]));
        let against = [about(x, PI), about(y, -FRAC_PI_2), about(x, FRAC_PI_2)].map(|bring| (bring, [true, false]));
        let in_plane = [about(y, -0.7), about(x, 2.1), about(z, 0.4) * about(y, FRAC_PI_2)];
        let anywhere = [about(Vector3::new(0.3, -0.8, 0.5), 1.1), about(Vector3::new(-0.4, 0.2, 0.9), 2.9)];
        let (in_plane, anywhere) =
            (in_plane.map(|bring| (bring, [true, false])), anywhere.map(|bring| (bring, [true, true])));
        for (k, (bring, [tilts, turns_about_z])) in
            [&along[..], &against, &in_plane, &anywhere].concat().into_iter().enumerate()
        {
            for (angle, turns) in [(0.0, false), (FRAC_PI_2, false), (PI, false), (0.6, true), (-2.2, true)] {
                let rotation = bring * about(z, angle);
                let found = AboutAxis::sliding(&rotation, true).expect("a rotation");
                assert_eq!(AboutAxis::sliding(&rotation, false).is_some(), k < 6, "{rotation}");
                let slide = ConstantSlide::of(&found);
                // The shortest rotation to none of the planes leaves a rotation about z.
                let expected = (tilts, turns_about_z, turns || k >= 9);
                assert_eq!((slide.tilts, slide.tilt.turns_about_z, slide.turns), expected, "{rotation}");
                let named = rotation * found.frame.transpose();
                assert!(found.frame[(2, 2)] > 0.0, "it slides along z: {}", found.frame);
                let shift = RigidShift { rotation: named, lever: Vector3::new(0.3, -0.2, 0.5) };
                check(&Prismatic { shift: &shift, rotation: &slide }, &shift.to_matrix());
            }
        }
        for bring in [Matrix3::identity(), about(x, PI), about(y, 0.4)] {
            let no_rotation = bring * Matrix3::new(1.0, 0.0, 1e-6, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
            assert!(AboutAxis::sliding(&no_rotation, true).is_none(), "{no_rotation}");
        }
    }
}
