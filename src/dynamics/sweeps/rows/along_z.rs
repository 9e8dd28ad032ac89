//! The row of a prismatic joint: the force along its z.
//!
//! With the angular and linear halves of P exchanged it is the row about z, and P^+ has the same zeros. Vectors use the
//! general method.

use super::Measures;
use super::about_z::{Noise, past_row};
use crate::filter::System;
use crate::filter::riccati::Measured;
use crate::scalar::Real;
use nalgebra::Vector6;

/// One row.
#[derive(Debug, Clone, Copy)]
pub(in crate::dynamics) struct AlongZ<'a, T: Real>(pub &'a System<T>, pub usize);

impl<T: Real> Measures<T> for AlongZ<'_, T> {
    type Gains = Measured<T>;

    #[inline(always)]
    fn stage(&self) -> (&System<T>, usize) {
        (self.0, self.1)
    }

    #[inline(always)]
    fn measure(&self, p: &[T; 21], _measured: &mut [Measured<T>]) -> (Measured<T>, [T; 21]) {
        past_slide(Noise::of(self.0.noise[self.0.stages[self.1].first_row]), p)
    }

    #[inline(always)]
    fn keep(&self, gains: Measured<T>, measured: &mut [Measured<T>]) {
        measured[self.0.stages[self.1].first_row] = gains;
    }
}

/// The angular half, exchanged with the linear half.
#[inline(always)]
fn exchanged<T: Copy>(p: &[T; 21]) -> [T; 21] {
    let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *p;
    [b0, b1, b2, b3, b4, b5, c0, c3, c6, c1, c4, c7, c2, c5, c8, a0, a1, a2, a3, a4, a5]
}

/// D and g of a prismatic joint (3.6, 3.10), and P^+ of P^-.
#[inline(always)]
fn past_slide<T: Real>(noise: Noise<T>, p: &[T; 21]) -> (Measured<T>, [T; 21]) {
    let (m, after) = past_row(noise, &exchanged(p));
    let g = &m.gain;
    (Measured { gain: Vector6::new(g[3], g[4], g[5], g[0], g[1], g[2]), ..m }, exchanged(&after))
}

#[cfg(test)]
mod tests {
    use super::{Noise, past_slide};
    use crate::filter::HingeMap;
    use crate::spatial::transform::{packed, unpacked};
    use crate::spatial::{Symmetric3, Symmetric6};
    use nalgebra::Matrix6;

    fn near(found: &Matrix6<f64>, expected: &Matrix6<f64>) -> bool {
        (found - expected).iter().all(|x| x.abs() <= 64.0 * f64::EPSILON)
    }

    /// P^+ equals P^- after the measurement of the force along z, with and without noise.
    #[test]
    fn the_row_is_the_force_along_z() {
        let wave = |i: usize| (1.7 * f64::from(u8::try_from(i).expect("small")) + 0.3).sin();
        let root = Matrix6::from_fn(|i, j| wave(6 * i + j));
        let before = root * root.transpose();
        let half = |at: usize| Symmetric3::from_upper(&before.fixed_view::<3, 3>(at, at).into_owned());
        let coupling = before.fixed_view::<3, 3>(0, 3).into_owned();
        let p = packed(&Symmetric6 { angular: half(0), coupling, linear: half(3) });
        let hinge = HingeMap::<f64>::Axis(5).to_column();
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
