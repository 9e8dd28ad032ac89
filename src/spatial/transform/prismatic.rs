//! What crosses a prismatic joint: its rotation is constant, and of P it is names of axes, here and at the parent, and up to three constant angles between,
//! about z, about x and about z again. The offset changes. Everything but P goes by the matrix.

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

/// The constants of one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ConstantSlide<N> {
    /// First about z, by this sine and cosine, where it is there.
    about_z: [N; 2],
    turns: bool,
    /// Then from z to its direction at the parent; about x where that is there.
    tilt: ConstantRotation<N>,
    tilts: bool,
}

impl ConstantSlide<f64> {
    /// Of a body whose frame is so named that nothing but the offset turns it about z.
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
    /// The same with other numbers.
    pub fn map<M>(&self, number: impl Fn(N) -> M) -> ConstantSlide<M> {
        let Self { about_z: [s, c], turns, tilts, .. } = *self;
        ConstantSlide { about_z: [number(s), number(c)], turns, tilt: self.tilt.map(number), tilts }
    }

    /// R P R*, in the parent's frame.
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

/// phi of a prismatic joint: where the body is now, and how its frame lies there always.
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

    /// What constant angles make is what the matrix makes: of directions along each of the parent's axes, to both sides, in a plane of two, and
    /// in none, about which the frame is turned by nothing, by right angles and by others. No more of the angles are there than it takes.
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
                // To none of the planes by the shortest way: there something is left to turn.
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
