//! How many digits the covariance form lost: an estimate of its error, from one more right side.
//!
//! The covariance form subtracts: P^+ = P^- - g D g* (3.6), z^+ = z^- + g e^- (4.5). Where little is left, as inboard of a heavy
//! body that joints set free, the rounding of what was there stays, and meets small pivots further in. To first order, an error
//! dP in P and df in z of stage k changes the estimates as a force dP lambda(k) + df on that stage would, so that for any
//! weights w on the rows
//!
//! `w* da = sum over k of nu(k)* (dP(k) lambda(k) + df(k))`, nu = the co-states of the measurements w alone, M a = w.
//!
//! One more right side, irregular numbers of either sign, therefore sees the error of every row through every gain, with the
//! contraction of the closed loop (a bound that adds up norms has none, and calls every long chain lost) and with what the outward
//! sweep makes of a small error at the root of a long lever. The smoother's own rounding is added as in [`rounding`](super::rounding). Rounding is taken as dP about eps times the terms of P^-
//! ([`terms`](super::terms), axis by axis), df about eps times z^+ and g e^-, independent from stage to stage: squares are
//! added. The whole costs a filter and a smoother more for w, about 330 operations a stage, no branch on a value, and one comparison
//! in the end.
//!
//! It is an estimate, not a bound: as a rule five to ten times the true error in the max norm of all rows. The weights of one right side
//! may cancel: what is not far from doubt is looked at again with others ([`look_again`]). What neither sees: errors made before the sweep (in phi, in velocities, in b), which every form
//! shares; a component that is small beside the largest; in float32, squares of what is below 1e-19.

use super::riccati::Measured;
use super::rounding::{carried, squares};
use super::system::{Stage, System};
use crate::scalar::Real;
use crate::spatial::{RigidShift, dot, scaled_add, times_each, zero};
use nalgebra::Vector6;

/// The estimated error, in eps and relative to the largest estimate, above which digits were lost: 5e-14 in f64.
///
/// Of 400,000 random scenes none has a true error above 1e-12, or 20 times the sensitivity, with an estimate below it.
pub const CANCELLATION_MARGIN: f64 = 225.0;

/// The same where one set of weights has been looked at, which may cancel: 1e-14 in f64.
pub const CLOSE_MARGIN: f64 = 45.0;

/// The square of the terms that [`terms`](super::terms) bounds, against that of the rounding of a usual entry in eps.
const BOUND_SQUARED: f64 = 64.0;

/// The weight of a row: between 3/4 and 5/4, of either sign, and unlike those of its neighbours, lest errors cancel.
#[must_use]
pub fn weight(row: usize) -> f64 {
    // The mixing of splitmix64.
    let mixed = (row as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let [high, low, sign, ..] = mixed.to_be_bytes();
    let size = 0.75 + 0.5 * f64::from(u16::from_be_bytes([high, low])) / 65536.0;
    if sign & 1 == 0 { size } else { -size }
}

/// What a smoothing sweep found out about its own rounding.
#[derive(Debug, Clone, Copy)]
pub struct Cancellation<T> {
    /// The estimated square of w* da, over eps^2: what P and the forces make of it.
    noise: T,
    /// The same of the smoother.
    smoother: T,
    /// Minus the largest estimate, or minus what errors are seen beside where that is larger.
    size: T,
}

impl<T: Real> Cancellation<T> {
    /// A monitor that has seen nothing.
    #[inline(always)]
    #[must_use]
    pub fn new() -> Self {
        Self::beside(T::zero())
    }

    /// The same for estimates whose digits below eps times `size` nobody asks for.
    #[inline(always)]
    #[must_use]
    pub fn beside(size: T) -> Self {
        Self { noise: T::zero(), smoother: T::zero(), size: -size }
    }

    /// The estimated error of one lane's estimates, relative to the largest of them, or to what they are seen [beside](Self::beside); NaN where it cannot be told.
    #[inline(always)]
    #[must_use]
    pub fn error(&self, lane: usize) -> f64 {
        let (noise, size) = ((self.noise + self.smoother).lane(lane), -self.size.lane(lane));
        if noise == 0.0 { noise } else { noise.sqrt() * T::epsilon().lane(lane) / size }
    }

    /// Whether the covariance form of one lane kept its digits.
    #[inline(always)]
    #[must_use]
    pub fn clear(&self, lane: usize) -> bool {
        self.slack(CANCELLATION_MARGIN).lane(lane) >= 0.0
    }

    /// How far below a margin in eps the error stays, as a difference of squares: negative or NaN in a lane that is in doubt.
    #[inline(always)]
    #[must_use]
    pub fn slack(&self, margin: f64) -> T {
        let allowed = self.size * self.size.constant(margin);
        allowed * allowed - (self.noise + self.smoother)
    }
}

impl<T: Real> Default for Cancellation<T> {
    fn default() -> Self {
        Self::new()
    }
}

/// The arrays of the filter after its sweep, and the second right side.
#[derive(Debug)]
pub struct Probe<'a, T: Real> {
    /// phi of each stage to its parent.
    pub shift: &'a [RigidShift<T>],
    /// D and g of each row.
    pub measured: &'a [Measured<T>],
    /// Bounds on the terms of the diagonal of each P^-(k).
    pub terms: &'a [Vector6<T>],
    /// z^+(k).
    pub z: &'a [Vector6<T>],
    /// e^- of each row for the measurements w.
    pub innovations: &'a [T],
    /// In, for [`sweep`]: zeta^+(k), the filtered states of the measurements w. Out: nu(k).
    pub co_state: &'a mut [Vector6<T>],
}

/// What the filter left of one stage.
#[derive(Debug)]
pub(crate) struct Swept<'a, T: Real> {
    /// z^+.
    pub z: &'a Vector6<T>,
    /// Bounds on the terms of the diagonal of P^-.
    pub terms: &'a Vector6<T>,
    /// D and g of every row.
    pub measured: &'a [Measured<T>],
}

impl<T: Real> Cancellation<T> {
    /// Leaves out what was seen since `before` in the lanes where `counts` is zero, and not one.
    #[inline(always)]
    pub(crate) fn leave_out_of(&mut self, before: &Self, counts: T) {
        self.noise = counts.mul_add(self.noise - before.noise, before.noise);
        self.smoother = counts.mul_add(self.smoother - before.smoother, before.smoother);
        self.size = counts.mul_add(self.size - before.size, before.size);
    }

    /// Whether what all lanes saw, each of other stages of one system, is within a margin in eps, whatever the order of their sums.
    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    pub(crate) fn surely_within(&self, margin: f64) -> bool {
        let (mut noise, mut size) = (0.0, self.size.lane(0));
        for lane in 0..T::LANES {
            noise += (self.noise + self.smoother).lane(lane);
            size = size.worst(self.size.lane(lane));
        }
        let allowed = size * margin;
        noise <= allowed * allowed * (1.0 - 1e-6)
    }

    /// What the smoother's rounding is, of a co-state `outer` carried past a lever of this square to where zeta^+ has these [`squares`].
    #[inline(always)]
    pub(crate) fn carried(&mut self, zeta: (T, T), outer: &Vector6<T>, lever_square: T) {
        self.smoother += carried(zeta, outer, lever_square);
    }

    /// [`through_stage`](Self::through_stage) of one row that picks entry `PICKED` of its state; e^- of both right sides in, the estimate out.
    ///
    /// Each number is read where it is needed: all of them at once are more than there are registers.
    #[inline(always)]
    pub(crate) fn through_axis<const PICKED: usize>(
        &mut self,
        measured: &Measured<T>,
        (z, terms): (&[T; 6], &[T; 6]),
        (lambda, nu): (&mut [T; 6], &mut [T; 6]),
        (e, e_w): (T, T),
    ) -> T {
        let Measured { pivot_inverse, gain, .. } = measured;
        let share = e * *pivot_inverse;
        let a = share - dot(gain, &Vector6::from(*lambda));
        self.smoother = (e_w * e_w).mul_add(share.mul_add(share, a * a), self.smoother);
        lambda[PICKED] += a;
        nu[PICKED] += (e_w * *pivot_inverse) - dot(gain, &Vector6::from(*nu));
        self.size = self.size.worst(-a.abs());
        let o = a.constant(0.0);
        let (mut of_p_nu, mut of_p_lambda, mut of_forces) = (o, o, o);
        for i in 0..6 {
            let (square, added) = (nu[i] * nu[i], gain[i] * e);
            of_p_nu = terms[i].mul_add(square, of_p_nu);
            of_p_lambda = terms[i].mul_add(lambda[i] * lambda[i], of_p_lambda);
            of_forces = added.mul_add(added, z[i] * z[i]).mul_add(square, of_forces);
        }
        self.noise = (of_p_nu * of_p_lambda).mul_add(o.constant(1.0 / BOUND_SQUARED), self.noise) + of_forces;
        a
    }

    /// The rows of one stage for both right sides, as [`smoother::through_stage`](super::smoother::through_stage): co-states lambda^+ and
    /// nu^+ in, lambda^- and nu out; e^- in, estimates out for the first, e^- of the second.
    #[inline(always)]
    pub(crate) fn through_stage(
        &mut self,
        stage: &Stage<T>,
        swept: &Swept<'_, T>,
        (lambda, nu): (&mut Vector6<T>, &mut Vector6<T>),
        (estimates, weighed): (&mut [T], &[T]),
    ) {
        let mut forces = times_each(swept.z, swept.z);
        for i in 0..stage.rows.count() {
            let (row, hinge) = (stage.first_row + i, stage.rows.row(i));
            let m = &swept.measured[row];
            let (e, e_w) = (estimates[row], weighed[row]);
            let share = e * m.pivot_inverse;
            let a = share - dot(&m.gain, lambda);
            self.smoother += e_w * e_w * (share * share + a * a);
            let c = e_w * m.pivot_inverse - dot(&m.gain, nu);
            *lambda = hinge.spread_onto(lambda, a);
            *nu = hinge.spread_onto(nu, c);
            forces = scaled_add(&times_each(&m.gain, &m.gain), e * e, &forces);
            estimates[row] = a;
            self.size = self.size.worst(-a.abs());
        }
        self.noise += rounding_of_stage(swept.terms, &forces, (nu, lambda));
    }
}

/// The sum of t x^2.
#[inline(always)]
fn squared<T: Real>(terms: &Vector6<T>, x: &Vector6<T>) -> T {
    dot(&times_each(terms, x), x)
}

/// Base to tip: the smoother, as [`smoother::sweep`](super::smoother::sweep), for both right sides, and what their products say.
#[inline(always)]
pub fn sweep<T: Real>(
    system: &System<T>,
    probe: &mut Probe<'_, T>,
    co_state: &mut [Vector6<T>],
    estimates: &mut [T],
) -> Cancellation<T> {
    let mut seen = Cancellation::<T>::new();
    for (k, stage) in system.stages.iter().enumerate() {
        let (mut lambda, mut nu) = match stage.parent {
            Some(parent) => {
                let shift = &probe.shift[k];
                seen.carried(squares(&probe.co_state[k]), &co_state[parent], shift.lever.dot(&shift.lever));
                (shift.motion_to_child(&co_state[parent]), shift.motion_to_child(&probe.co_state[parent]))
            }
            None => (zero(), zero()),
        };
        let swept = Swept { z: &probe.z[k], terms: &probe.terms[k], measured: probe.measured };
        seen.through_stage(stage, &swept, (&mut lambda, &mut nu), (estimates, probe.innovations));
        co_state[k] = lambda;
        probe.co_state[k] = nu;
    }
    seen
}

/// The same estimate with other weights, after [`sweep`], whose `first` has the smoother's part: one set of weights may cancel. The larger of both.
///
/// `probe` has the co-states of the other weights; `co_state` receives lambda^- of the estimates.
#[inline(always)]
pub fn look_again<T: Real>(
    system: &System<T>,
    probe: &Probe<'_, T>,
    co_state: &mut [Vector6<T>],
    estimates: &[T],
    first: &Cancellation<T>,
) -> Cancellation<T> {
    let mut noise = T::zero();
    for (k, stage) in system.stages.iter().enumerate() {
        let mut forces = times_each(&probe.z[k], &probe.z[k]);
        let mut lambda = match stage.parent {
            Some(parent) => probe.shift[k].motion_to_child(&co_state[parent]),
            None => zero(),
        };
        for i in 0..stage.rows.count() {
            let row = stage.first_row + i;
            let m = &probe.measured[row];
            let e = m.pivot * (estimates[row] + dot(&m.gain, &lambda));
            forces = scaled_add(&times_each(&m.gain, &m.gain), e * e, &forces);
            lambda = stage.rows.row(i).spread_onto(&lambda, estimates[row]);
        }
        noise += rounding_of_stage(&probe.terms[k], &forces, (&probe.co_state[k], &lambda));
        co_state[k] = lambda;
    }
    Cancellation { noise: -(-noise).worst(-first.noise), ..*first }
}

/// The square of nu* (dP lambda + df), over eps^2.
#[inline(always)]
fn rounding_of_stage<T: Real>(terms: &Vector6<T>, forces: &Vector6<T>, (nu, lambda): (&Vector6<T>, &Vector6<T>)) -> T {
    let of_p = squared(terms, nu) * squared(terms, lambda);
    of_p * of_p.constant(1.0 / BOUND_SQUARED) + squared(forces, nu)
}
