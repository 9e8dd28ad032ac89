//! The measurements of a joint: D and g, the filter, the smoother, and the measurement in square-root form; one type
//! per kind of rows.
//!
//! The passes do not depend on the kind of joint: [`Measures`] has the measurements, and
//! [`Transform`](crate::spatial::transform::Transform) the propagation to the parent. All quantities of a revolute
//! joint are about its z, D, g and e^- included, if its axis is reversed too.

mod about_z;
mod along_z;
mod six;

pub(in crate::dynamics) use about_z::{ABOUT_Z, AboutZ, along};
pub(in crate::dynamics) use along_z::AlongZ;
pub(in crate::dynamics) use six::{PICKED, Six, picked};

use crate::filter::cancellation::{Cancellation, StageState};
use crate::filter::pivots::{PivotMonitor, Scale};
use crate::filter::riccati::{self, Measured};
use crate::filter::rounding::{Outward, RootMonitor};
use crate::filter::square_root;
use crate::filter::{HingeMap, System, innovations, smoother};
use crate::scalar::Real;
use crate::spatial::transform::{packed, unpacked};
use crate::spatial::{Root6, cross_motion};
use nalgebra::Vector6;

/// z = L y + t of a body, in square-root form.
pub(in crate::dynamics) type RootMean<'a, T> = (&'a mut [T; 6], &'a mut Vector6<T>);

/// The rows of one joint. Slices hold one value, or D and g, for every row of the scene.
pub(in crate::dynamics) trait Measures<T: Real> {
    /// D and g, if they are not written at once.
    type Gains;

    /// The stage of the rows. The default methods use it where a kind of rows has no method of its own.
    fn stage(&self) -> (&System<T>, usize);

    /// D and g (3.6, 3.10), and P^+ from P^-, in 6 + 9 + 6 scalars. The remaining results are written by
    /// [`keep`](Self::keep) after the last use of P: earlier writes could alias P for the compiler, which would then
    /// read all of P first.
    fn measure(&self, p: &[T; 21], measured: &mut [Measured<T>]) -> (Self::Gains, [T; 21]);

    /// Writes D and g.
    fn keep(&self, gains: Self::Gains, measured: &mut [Measured<T>]);

    /// Observes every pivot.
    #[inline(always)]
    fn observe(&self, measured: &[Measured<T>], scale: &Scale<T>, monitor: &mut PivotMonitor<T>) {
        let (system, k) = self.stage();
        monitor.observe_stage(&system.stages[k], measured, scale);
    }

    /// As [`Stage::terms_left`](crate::filter::Stage::terms_left), of P^- and P^+.
    #[inline(always)]
    fn terms_left(&self, before: &[T; 21], after: &[T; 21]) -> [T; 6] {
        let (system, k) = self.stage();
        system.stages[k].terms_left(diagonal(before), diagonal(after))
    }

    /// e^- of the rows (4.2); z^- becomes z^+ (4.5).
    #[inline(always)]
    fn filter(&self, measured: &[Measured<T>], measurement: &[T], z: &mut [T; 6], innovations: &mut [T]) {
        let mut state = Vector6::from(*z);
        innovations::through_stage(self.stage(), measured, measurement, &mut state, innovations);
        *z = state.into();
    }

    /// H z of the rows (1.5).
    #[inline(always)]
    fn project(&self, z: &[T; 6], measurement: &mut [T]) {
        let ((system, k), z) = (self.stage(), Vector6::from(*z));
        let stage = &system.stages[k];
        for i in 0..stage.rows.count() {
            measurement[stage.first_row + i] = stage.rows.row(i).project(&z);
        }
    }

    /// Adds H* u: the contribution of the joint velocities or accelerations `u` to the body.
    #[inline(always)]
    fn spread(&self, u: &[T], motion: &mut [T; 6]) {
        let ((system, k), mut sum) = (self.stage(), Vector6::from(*motion));
        let stage = &system.stages[k];
        for i in 0..stage.rows.count() {
            sum = stage.rows.row(i).spread_onto(&sum, u[stage.first_row + i]);
        }
        *motion = sum.into();
    }

    /// Adds H* qd to the velocity V of a body, and V x H* qd to its acceleration: the contribution of a joint rotates
    /// with the body inboard of it.
    #[inline(always)]
    fn spread_moving(&self, qd: &[T], velocity: &mut [T; 6], acceleration: &mut [T; 6]) {
        let mut joint = [velocity[0].constant(0.0); 6];
        self.spread(qd, &mut joint);
        let turning = cross_motion(&(*velocity).into(), &joint.into());
        for i in 0..6 {
            velocity[i] += joint[i];
            acceleration[i] += turning[i];
        }
    }

    /// The sums of 1 / D over the rows that measure a moment, and over those that measure a force.
    #[inline(always)]
    fn weights(&self, measured: &[Measured<T>]) -> [T; 2] {
        let (system, k) = self.stage();
        let (stage, zero) = (&system.stages[k], measured[0].pivot_inverse.constant(0.0));
        let (mut of_moment, mut of_force) = (zero, zero);
        for row in 0..stage.rows.count() {
            let weight = measured[stage.first_row + row].pivot_inverse;
            match stage.rows.row(row) {
                HingeMap::Axis(axis) if axis < 3 => of_moment += weight,
                HingeMap::Axis(_) => of_force += weight,
                HingeMap::Screw(pitch) => {
                    of_moment += weight;
                    of_force = (pitch * pitch).mul_add(weight, of_force);
                }
            }
        }
        [of_moment, of_force]
    }

    /// Replaces e^- by the estimates (4.9) and lambda^+ by lambda^- (4.11).
    #[inline(always)]
    fn smooth(&self, measured: &[Measured<T>], lambda: &mut [T; 6], estimates: &mut [T]) {
        let ((system, k), mut state) = (self.stage(), Vector6::from(*lambda));
        smoother::through_stage(&system.stages[k], measured, &mut state, estimates);
        *lambda = state.into();
    }

    /// The same for two right-hand sides, with the error estimate of the first by the second; with `ALLOWS` with the
    /// sensitivity of the problem.
    #[inline(always)]
    fn smooth_both<const ALLOWS: bool>(
        &self,
        seen: &mut Cancellation<T>,
        swept: &StageState<'_, T>,
        (lambda, nu): (&mut [T; 6], &mut [T; 6]),
        right_sides: (&mut [T], &[T]),
    ) {
        let ((system, k), mut state, mut probe) = (self.stage(), Vector6::from(*lambda), Vector6::from(*nu));
        seen.through_stage(&system.stages[k], swept, (&mut state, &mut probe), right_sides);
        (*lambda, *nu) = (state.into(), probe.into());
    }

    /// Observes the estimates.
    #[inline(always)]
    fn observe_estimates(&self, estimates: &[T], seen: &mut Outward<T>) {
        let (system, k) = self.stage();
        let stage = &system.stages[k];
        for &estimate in &estimates[stage.first_row..][..stage.rows.count()] {
            seen.observe_estimate(estimate);
        }
    }

    /// D, g and e^- in square-root form (3.6, 4.2, 4.5), and the root of P^+ from that of P^-. The root has its bounds
    /// and a flag that all of its weights are positive. A further flag states that the row is one rotation without
    /// noise, after which two columns have no linear part.
    #[inline(always)]
    fn measure_root(
        &self,
        (root, scale, _): (&mut Root6<T>, &Scale<T>, bool),
        (y, t): RootMean<'_, T>,
        (measurement, innovations): (&[T], &mut [T]),
        measured: &mut [Measured<T>],
        monitor: &mut RootMonitor<T>,
    ) -> bool {
        square_root::through_stage(self.stage(), (root, scale), (y, t, measurement, innovations), measured, monitor)
    }
}

/// The diagonal of a covariance in 6 + 9 + 6 numbers.
#[inline(always)]
fn diagonal<T: Real>(p: &[T; 21]) -> [T; 6] {
    [p[0], p[3], p[5], p[15], p[18], p[20]]
}

/// The rows of any joint, processed one after another.
#[derive(Debug, Clone, Copy)]
pub(in crate::dynamics) struct AnyRows<'a, T: Real>(pub &'a System<T>, pub usize);

impl<T: Real> Measures<T> for AnyRows<'_, T> {
    type Gains = ();

    #[inline(always)]
    fn stage(&self) -> (&System<T>, usize) {
        (self.0, self.1)
    }

    #[inline(always)]
    fn measure(&self, p: &[T; 21], measured: &mut [Measured<T>]) -> ((), [T; 21]) {
        let mut p = unpacked(p);
        riccati::measure_stage(self.0, self.1, &mut p, measured, |_, _| {});
        ((), packed(&p))
    }

    #[inline(always)]
    fn keep(&self, (): (), _measured: &mut [Measured<T>]) {}
}
