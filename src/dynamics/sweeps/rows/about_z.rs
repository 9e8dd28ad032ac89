//! The row of a revolute joint: the moment about its z.

use super::{Measures, RootMean, diagonal};
use crate::filter::cancellation::{Cancellation, StageState};
use crate::filter::pivots::{PivotMonitor, Scale};
use crate::filter::riccati::Measured;
use crate::filter::rounding::{Outward, RootMonitor};
use crate::filter::square_root;
use crate::filter::{HingeMap, System};
use crate::scalar::Real;
use crate::spatial::{Root6, absolute};
use nalgebra::Vector6;

/// The entry that H selects.
pub(in crate::dynamics) const ABOUT_Z: usize = 2;

/// One row. Velocity, acceleration and torque of the joint are those about z, times its sense, which is 1 or -1.
#[derive(Debug, Clone, Copy)]
pub(in crate::dynamics) struct AboutZ<'a, T: Real> {
    row: usize,
    sense: T::Parameter,
    system: &'a System<T>,
    k: usize,
}

impl<'a, T: Real> AboutZ<'a, T> {
    #[inline(always)]
    pub fn new((row, sense): (usize, T::Parameter), system: &'a System<T>, k: usize) -> Self {
        Self { row, sense, system, k }
    }

    #[inline(always)]
    fn noise(&self) -> Noise<T> {
        Noise::of(self.system.noise[self.row])
    }
}

impl<T: Real> Measures<T> for AboutZ<'_, T> {
    type Gains = Measured<T>;

    #[inline(always)]
    fn stage(&self) -> (&System<T>, usize) {
        (self.system, self.k)
    }

    #[inline(always)]
    fn measure(&self, p: &[T; 21], _measured: &mut [Measured<T>]) -> (Measured<T>, [T; 21]) {
        past_row(self.noise(), p)
    }

    #[inline(always)]
    fn keep(&self, gains: Measured<T>, measured: &mut [Measured<T>]) {
        measured[self.row] = gains;
    }

    #[inline(always)]
    fn observe(&self, measured: &[Measured<T>], scale: &Scale<T>, monitor: &mut PivotMonitor<T>) {
        monitor.observe(measured[self.row].pivot, &HingeMap::Axis(ABOUT_Z), scale);
    }

    #[inline(always)]
    fn terms_left(&self, _before: &[T; 21], after: &[T; 21]) -> [T; 6] {
        absolute(&diagonal(after).into()).into()
    }

    #[inline(always)]
    fn filter(&self, measured: &[Measured<T>], measurement: &[T], z: &mut [T; 6], innovations: &mut [T]) {
        let torque = z[0].splat(self.sense) * measurement[self.row];
        (innovations[self.row], *z) = measure(self.noise(), &measured[self.row], torque, z);
    }

    #[inline(always)]
    fn project(&self, z: &[T; 6], measurement: &mut [T]) {
        measurement[self.row] = z[ABOUT_Z] * z[ABOUT_Z].splat(self.sense);
    }

    #[inline(always)]
    fn spread(&self, u: &[T], motion: &mut [T; 6]) {
        motion[ABOUT_Z] = u[self.row].mul_add(motion[0].splat(self.sense), motion[ABOUT_Z]);
    }

    #[inline(always)]
    fn spread_moving(&self, qd: &[T], velocity: &mut [T; 6], acceleration: &mut [T; 6]) {
        let rate = qd[self.row] * velocity[0].splat(self.sense);
        let [turn_x, turn_y, _, move_x, move_y, _] = *velocity;
        acceleration[0] = turn_y.mul_add(rate, acceleration[0]);
        acceleration[1] = acceleration[1].minus_product(turn_x, rate);
        acceleration[3] = move_y.mul_add(rate, acceleration[3]);
        acceleration[4] = acceleration[4].minus_product(move_x, rate);
        velocity[ABOUT_Z] += rate;
    }

    #[inline(always)]
    fn weights(&self, measured: &[Measured<T>]) -> [T; 2] {
        let weight = measured[self.row].pivot_inverse;
        [weight, weight.constant(0.0)]
    }

    #[inline(always)]
    fn smooth(&self, measured: &[Measured<T>], lambda: &mut [T; 6], estimates: &mut [T]) {
        let (m, to) = (&measured[self.row], &mut estimates[self.row]);
        let estimate = but_along(*to * m.pivot_inverse, &m.gain.into(), lambda);
        *to = estimate * estimate.splat(self.sense);
        lambda[ABOUT_Z] += estimate;
    }

    #[inline(always)]
    fn smooth_both<const ALLOWS: bool>(
        &self,
        seen: &mut Cancellation<T>,
        swept: &StageState<'_, T>,
        co_states: (&mut [T; 6], &mut [T; 6]),
        (estimates, innovations): (&mut [T], &[T]),
    ) {
        let right_sides = (estimates[self.row], innovations[self.row]);
        let m = &swept.measured[self.row];
        let estimate = seen.through_axis::<ABOUT_Z, ALLOWS>(m, swept, co_states, right_sides);
        estimates[self.row] = estimate * estimate.splat(self.sense);
    }

    #[inline(always)]
    fn observe_estimates(&self, estimates: &[T], seen: &mut Outward<T>) {
        seen.observe_estimate(estimates[self.row]);
    }

    #[inline(always)]
    fn measure_root(
        &self,
        (root, scale, is_definite): (&mut Root6<T>, &Scale<T>, bool),
        (y, t): RootMean<'_, T>,
        (measurement, innovations): (&[T], &mut [T]),
        measured: &mut [Measured<T>],
        monitor: &mut RootMonitor<T>,
    ) -> bool {
        let (noise, hinge) = (self.noise(), HingeMap::Axis(ABOUT_Z));
        let mean = (y, t, measurement[self.row] * measurement[self.row].splat(self.sense));
        let at_row = (&hinge, noise.variance);
        let (m, e) = if is_definite {
            square_root::measure_row::<T, true>(at_row, root, mean)
        } else {
            square_root::measure_row::<T, false>(at_row, root, mean)
        };
        monitor.observe(&m, &hinge, scale);
        (measured[self.row], innovations[self.row]) = (m, e);
        noise.is_free
    }
}

/// The noise of one row's measurement.
#[derive(Clone, Copy)]
pub(super) struct Noise<T> {
    pub variance: T,
    /// True if it is zero: then H g = 1 and H P^+ = 0 are written, not computed.
    pub is_free: bool,
}

impl<T: Real> Noise<T> {
    #[inline(always)]
    pub fn of(variance: T) -> Self {
        Self { variance, is_free: variance.lane(0) == 0.0 }
    }
}

/// D and g of a revolute joint (3.6, 3.10), with P^- H^T except for the entry that H selects.
#[inline(always)]
fn measured<T: Real>(noise: Noise<T>, &[c0, c1, c2, c3, c4, c5]: &[T; 6]) -> (Measured<T>, [T; 5]) {
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

/// D and g of this row (3.6, 3.10), and P^+ of P^-.
#[inline(always)]
pub(super) fn past_row<T: Real>(noise: Noise<T>, p: &[T; 21]) -> (Measured<T>, [T; 21]) {
    let (m, column) = measured(noise, &[p[2], p[4], p[5], p[12], p[13], p[14]]);
    let after = filtered(p, &column, (&m, noise.variance));
    (m, after)
}

/// P^+ = P^- - g H P^- past a revolute joint about z (3.6). Row and column 2, which H selects, are r g: exactly zero if
/// r is zero.
#[inline(always)]
fn filtered<T: Real>(p: &[T; 21], [ph0, ph1, ph3, ph4, ph5]: &[T; 5], (m, r): (&Measured<T>, T)) -> [T; 21] {
    let g = &m.gain;
    let [a0, a1, _, a3, _, _, c0, c1, c2, c3, c4, c5, _, _, _, b0, b1, b2, b3, b4, b5] = *p;
    let [a2, a4, a5, c6, c7, c8] = [r * g[0], r * g[1], r * g[2], r * g[3], r * g[4], r * g[5]];
    [
        a0.minus_product(g[0], *ph0),
        a1.minus_product(g[0], *ph1),
        a2,
        a3.minus_product(g[1], *ph1),
        a4,
        a5,
        c0.minus_product(g[0], *ph3),
        c1.minus_product(g[0], *ph4),
        c2.minus_product(g[0], *ph5),
        c3.minus_product(g[1], *ph3),
        c4.minus_product(g[1], *ph4),
        c5.minus_product(g[1], *ph5),
        c6,
        c7,
        c8,
        b0.minus_product(g[3], *ph3),
        b1.minus_product(g[3], *ph4),
        b2.minus_product(g[3], *ph5),
        b3.minus_product(g[4], *ph4),
        b4.minus_product(g[4], *ph5),
        b5.minus_product(g[5], *ph5),
    ]
}

/// The filter past a revolute joint: e^- (4.2), and z^+ from z^- (4.5).
#[inline(always)]
fn measure<T: Real>(noise: Noise<T>, m: &Measured<T>, measurement: T, z: &[T; 6]) -> (T, [T; 6]) {
    let e = measurement - z[ABOUT_Z];
    let g = &m.gain;
    // H z^+ = tau - (r / D) e^-: a sum with a large H z^- would lose precision.
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

/// x - g* y.
#[inline(always)]
fn but_along<T: Real>(x: T, g: &[T; 6], y: &[T; 6]) -> T {
    let turning = x.minus_product(g[0], y[0]).minus_product(g[1], y[1]).minus_product(g[2], y[2]);
    let moving = g[3].mul_add(y[3], g[4].mul_add(y[4], g[5] * y[5]));
    turning - moving
}

/// g* y, in two chains of products.
#[inline(always)]
pub(in crate::dynamics) fn along<T: Real>(g: &[T; 6], y: &[T; 6]) -> T {
    let turning = g[0].mul_add(y[0], g[1].mul_add(y[1], g[2] * y[2]));
    let moving = g[3].mul_add(y[3], g[4].mul_add(y[4], g[5] * y[5]));
    turning + moving
}
