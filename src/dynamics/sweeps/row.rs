//! Past the row of a revolute joint: what its measurement tells and what it leaves.

use super::axial_rotation::ABOUT_Z;
use crate::filter::riccati::Measured;
use crate::scalar::Real;
use nalgebra::Vector6;

/// The noise of one row's measurement.
#[derive(Clone, Copy)]
pub(super) struct Noise<T> {
    pub variance: T,
    /// Whether it is zero: then H g = 1 and H P^+ = 0 are written, not computed.
    pub is_free: bool,
}

impl<T: Real> Noise<T> {
    #[inline(always)]
    pub fn of(variance: T) -> Self {
        Self { variance, is_free: variance.lane(0) == 0.0 }
    }
}

/// D and g of a revolute joint (3.6, 3.10), with P^- H^T but for the entry that H picks.
#[inline(always)]
pub(super) fn measured<T: Real>(noise: Noise<T>, &[c0, c1, c2, c3, c4, c5]: &[T; 6]) -> (Measured<T>, [T; 5]) {
    let pivot = c2 + noise.variance;
    let pivot_inverse = pivot.recip();
    let column = [c0, c1, c3, c4, c5];
    let own = if noise.is_free { pivot.constant(1.0) } else { c2 * pivot_inverse };
    let gain = Vector6::new(
        column[0] * pivot_inverse,
        column[1] * pivot_inverse,
        own,
        column[2] * pivot_inverse,
        column[3] * pivot_inverse,
        column[4] * pivot_inverse,
    );
    (Measured { pivot, pivot_inverse, gain }, column)
}

/// The diagonal of P^+, of that of P^-.
#[inline(always)]
pub(super) fn diagonal_past<T: Real>(
    noise: Noise<T>,
    &[p0, p1, _, p3, p4, p5]: &[T; 6],
    [ph0, ph1, ph3, ph4, ph5]: &[T; 5],
    m: &Measured<T>,
) -> Vector6<T> {
    let g = &m.gain;
    let own = if noise.is_free { g[2].constant(0.0) } else { noise.variance * g[2] };
    Vector6::new(
        p0.minus_product(g[0], *ph0),
        p1.minus_product(g[1], *ph1),
        own,
        p3.minus_product(g[3], *ph3),
        p4.minus_product(g[4], *ph4),
        p5.minus_product(g[5], *ph5),
    )
}

/// The filter across a revolute joint: e^- (4.2), and z^+ of z^- (4.5).
#[inline(always)]
pub(super) fn measure<T: Real>(noise: Noise<T>, m: &Measured<T>, measurement: T, z: &[T; 6]) -> (T, [T; 6]) {
    let e = measurement - z[ABOUT_Z];
    let g = &m.gain;
    // H z^+ = tau - (r / D) e^-, which a sum with a large H z^- would not give.
    let own = if noise.is_free { measurement } else { measurement.minus_product(e, noise.variance * m.pivot_inverse) };
    let z = [
        g[0].mul_add(e, z[0]),
        g[1].mul_add(e, z[1]),
        own,
        g[3].mul_add(e, z[3]),
        g[4].mul_add(e, z[4]),
        g[5].mul_add(e, z[5]),
    ];
    (e, z)
}
