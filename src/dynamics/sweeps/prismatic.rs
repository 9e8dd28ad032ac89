//! Bodies that slide: P on its way to the parent.
//!
//! What a turn does with its angle, a slide does with constants: its rotation is names of axes, here and at the parent, and up to three constant angles between, about z, about x and
//! about z again. Its row is the force along z, entry 5: with the halves of P exchanged that is entry 2, and past it the same zeros
//! are left as past a revolute joint's. Everything else of a slide goes the general way.

use super::about_axis::AboutAxis;
use super::axial_rotation::{AxialRotation, Axis, about, packed_to_parent};
use super::constant_rotation::ConstantRotation;
use super::lever::Lever;
use super::packed::{along_lever, kept};
use super::rotation::{Rotates, about_x};
use super::row::{Noise, measured};
use crate::filter::riccati::Measured;
use crate::scalar::Real;
use nalgebra::Vector6;

/// The row of a slide.
pub(super) const ALONG_Z: usize = 5;

/// The constants of one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ConstantSlide<N> {
    /// First about z, by this sine and cosine, where it is there.
    pub about_z: [N; 2],
    pub turns: bool,
    /// Then from z to its direction at the parent; about x where that is there.
    pub tilt: ConstantRotation<N>,
    pub tilts: bool,
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
        about!(self.tilt.axis, X, Y, Z, packed_to_parent::<T, X, Y, Z>(&p))
    }

    /// P at the parent, of P^+ here; `lever` is where the body is now, there.
    #[inline(always)]
    pub fn at_parent<T: Real<Parameter = N>>(&self, p: &[T; 21], lever: [T; 3]) -> [T; 21] {
        along_lever(&Lever { entries: lever, along: [true; 3] }, &self.covariance(p))
    }
}

/// The angular half where the linear one was.
#[inline(always)]
fn exchanged<T: Copy>(p: &[T; 21]) -> [T; 21] {
    let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *p;
    [b0, b1, b2, b3, b4, b5, c0, c3, c6, c1, c4, c7, c2, c5, c8, a0, a1, a2, a3, a4, a5]
}

/// D and g of a slide (3.6, 3.10), and P^+ of P^-.
#[inline(always)]
pub(super) fn past_slide<T: Real>(noise: Noise<T>, p: &[T; 21]) -> (Measured<T>, [T; 21]) {
    let p = exchanged(p);
    let (m, column) = measured(noise, &[p[2], p[4], p[5], p[12], p[13], p[14]]);
    let after = kept(&p, &column, (&m, noise.variance));
    let g = &m.gain;
    (Measured { gain: Vector6::new(g[3], g[4], g[5], g[0], g[1], g[2]), ..m }, exchanged(&after))
}

#[cfg(test)]
mod tests {
    use super::{ALONG_Z, ConstantSlide, past_slide};
    use crate::dynamics::sweeps::about_axis::AboutAxis;
    use crate::dynamics::sweeps::axial_rotation::PACKED;
    use crate::dynamics::sweeps::packed::unpacked;
    use crate::dynamics::sweeps::row::Noise;
    use crate::filter::HingeMap;
    use crate::spatial::RigidShift;
    use nalgebra::{Matrix3, Matrix6, Rotation3, Unit, Vector3};
    use std::f64::consts::{FRAC_PI_2, PI};

    fn about(axis: Vector3<f64>, angle: f64) -> Matrix3<f64> {
        Rotation3::from_axis_angle(&Unit::new_normalize(axis), angle).into_inner()
    }

    fn wave(i: usize) -> f64 {
        (1.7 * f64::from(u8::try_from(i).expect("small")) + 0.3).sin()
    }

    fn near(found: &Matrix6<f64>, expected: &Matrix6<f64>) -> bool {
        (found - expected).iter().all(|x| x.abs() <= 64.0 * f64::EPSILON)
    }

    /// What constant angles make of P is what the shift makes of it: of directions along each of the parent's axes, to both sides, in a plane of two, and
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
        let p: [f64; 21] = std::array::from_fn(wave);
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
                let sent = slide.at_parent(&p, shift.lever.into());
                let (found, phi) = (unpacked(&sent).to_matrix(), shift.to_matrix());
                let expected = phi * unpacked(&p).to_matrix() * phi.transpose();
                assert!(near(&found, &expected), "{rotation} {slide:?}: {found} {expected}");
            }
        }
        for bring in [Matrix3::identity(), about(x, PI), about(y, 0.4)] {
            let no_rotation = bring * Matrix3::new(1.0, 0.0, 1e-6, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
            assert!(AboutAxis::sliding(&no_rotation, true).is_none(), "{no_rotation}");
        }
    }

    /// P^+ is what is left of P^- past the force along z, with noise and without.
    #[test]
    fn the_row_is_the_force_along_z() {
        let root = Matrix6::from_fn(|i, j| wave(6 * i + j));
        let before = root * root.transpose();
        let mut p = [0.0; 21];
        for i in 0..3 {
            for j in 0..3 {
                (p[PACKED[i][j]], p[15 + PACKED[i][j]]) = (before[(i, j)], before[(3 + i, 3 + j)]);
                p[6 + 3 * i + j] = before[(i, 3 + j)];
            }
        }
        let hinge = HingeMap::<f64>::Axis(ALONG_Z).to_column();
        for variance in [0.0, 0.7] {
            let (m, after) = past_slide(Noise::of(variance), &p);
            let pivot = (hinge.transpose() * before * hinge)[(0, 0)] + variance;
            let gain = before * hinge / pivot;
            assert!((m.pivot - pivot).abs() <= 1e-15 * pivot && (m.pivot_inverse * pivot - 1.0).abs() <= 1e-15);
            assert!((m.gain - gain).norm() <= 1e-15, "{m:?}");
            let expected = before - gain * pivot * gain.transpose();
            assert!(near(&unpacked(&after).to_matrix(), &expected), "{variance}: {expected}");
        }
    }
}
