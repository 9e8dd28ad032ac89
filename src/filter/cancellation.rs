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
//! (axis by axis), df about eps times z^+ and g e^-, independent from stage to stage: squares are
//! added. The whole costs a filter and a smoother more for w, about 370 operations a stage, no branch on a value, and one comparison
//! in the end.
//!
//! The estimated error is allowed to be as large as [`Margins`] say: a part of the largest estimate, or what the problem itself makes
//! of one unit in the last place. A robot that is held against gravity accelerates by nothing but rounding: there one unit in the last
//! place of a torque, or of a force that a joint transmits, moves the estimates as far as any algorithm does. What such units make of
//! w* a comes out of the same sums, by the same nu:
//!
//! - of the forces at rest, `nu(k)_i f(k)_i`: f = z^+ + P^+ lambda is the force that the body transmits, and `f_i^2` is above
//!   `z_i^2 / 2 - P_ii (lambda* P lambda)`. Where a body is free to fall nothing is left of it.
//! - of the bias, `nu(k)_i b(k)_i`: the body's own weight, velocity effects and wrench.
//!
//! It is an estimate, not a bound: as a rule five to ten times the true error in the max norm of all rows. The weights of one right side
//! may cancel: what is not far from doubt is looked at again with others (by `dynamics::auto`). What neither sees: errors made before the sweep (in phi, in velocities, in b), which every form
//! shares; a component that is small beside the largest; in float32, squares of what is below 1e-19.

use super::riccati::Measured;
use super::rounding::{carried, squares};
use super::system::{Stage, System};
use crate::scalar::{Real, larger};
use crate::spatial::{RigidShift, dot, scaled_add, times_each, zero};
use nalgebra::Vector6;

/// How large the estimated error may be for the sensitivity of the problem: what the bias allows, and what the forces at rest allow beside it, as a sum of
/// squares. A part of the largest estimate is allowed in any problem: the tolerance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Margins {
    /// In units of what one unit in the last place of the forces at rest makes of the estimates.
    pub of_rest: f64,
    /// The same of the bias...
    pub of_bias: f64,
    /// ... but no more than so many eps of the largest estimate.
    pub of_bias_at_most: f64,
}

impl Margins {
    /// Where one set of weights has been looked at, which may cancel.
    pub const CLOSE: Self = Self { of_rest: 2.5, of_bias: 60.0, of_bias_at_most: 1500.0 };

    /// Where two sets have been looked at.
    ///
    /// Of 400,000 random cases a dozen have a true error above 1e-12 and 20 times the sensitivity with an estimate below it, by a factor of 2.3 at the most.
    pub const USUAL: Self = Self { of_rest: 3.0, of_bias: 60.0, of_bias_at_most: 2500.0 };

    /// For right sides that nobody gave: there is no problem whose sensitivity would matter.
    pub const OF_A_FACTOR: Self = Self { of_rest: 0.0, of_bias: 0.0, of_bias_at_most: 0.0 };
}

/// The square of the terms that bounds of P^- say, against that of the rounding of a usual entry in eps.
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
    /// The square of what one unit in the last place of the forces at rest makes of w* a, over eps^2.
    rest: T,
    /// The same of the bias.
    bias: T,
    /// Minus the largest estimate.
    size: T,
}

impl<T: Real> Cancellation<T> {
    /// A monitor that has seen nothing.
    #[inline(always)]
    #[must_use]
    pub fn new() -> Self {
        let o = T::zero();
        Self { noise: o, smoother: o, rest: o, bias: o, size: o }
    }

    /// The estimated error of the largest estimate, in its unit, with what one unit in the last place of the forces makes of it; NaN where
    /// it cannot be told.
    #[inline(always)]
    #[must_use]
    pub fn error(&self) -> T {
        ((self.noise + self.smoother) + (self.rest + self.bias)).sqrt() * T::epsilon()
    }

    /// The same of one lane, relative to the largest estimate.
    #[must_use]
    pub fn relative_error(&self, lane: usize) -> f64 {
        let error = self.error().lane(lane);
        if error == 0.0 { error } else { error / -self.size.lane(lane) }
    }

    /// How far the error stays below the tolerance, given as its square in units of eps^2, or below the margins, as a difference of squares: negative or NaN in
    /// a lane whose error is too large.
    #[inline(always)]
    #[must_use]
    pub fn slack(&self, tolerance: T, margins: &Margins) -> T {
        let square = |x: f64| self.size.constant(x * x);
        let size = self.size * self.size;
        let of_bias = (self.bias * square(margins.of_bias)).worst(size * square(margins.of_bias_at_most));
        let allowed = larger(size * tolerance, of_bias);
        self.rest.mul_add(square(margins.of_rest), allowed) - (self.noise + self.smoother)
    }

    /// The larger of both in each part: of what two sets of weights saw.
    #[inline(always)]
    pub(crate) fn larger(&self, other: &Self) -> Self {
        Self {
            noise: larger(self.noise, other.noise),
            smoother: larger(self.smoother, other.smoother),
            rest: larger(self.rest, other.rest),
            bias: larger(self.bias, other.bias),
            size: self.size.worst(other.size),
        }
    }

    /// Adds what a stage makes of w* a.
    #[inline(always)]
    fn add(&mut self, stage: &OfStage<T>) {
        let OfStage { p, state, bias, .. } = *stage;
        self.add_noise(stage);
        // Less what may be accelerated of it; never less than nothing.
        let transmitted = state.mul_add(p.constant(-0.5), p);
        self.rest -= transmitted.worst(p.constant(0.0));
        self.bias += bias;
    }

    /// The same of its rounding alone.
    #[inline(always)]
    fn add_noise(&mut self, stage: &OfStage<T>) {
        let OfStage { p, state, added, .. } = *stage;
        self.noise = p.mul_add(p.constant(1.0 / BOUND_SQUARED), self.noise) + (state + added);
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
    /// b(k).
    pub bias: &'a [Vector6<T>],
    /// e^- of each row for the measurements w.
    pub innovations: &'a [T],
    /// In, for [`sweep`]: zeta^+(k), the filtered states of the measurements w. Out: nu(k).
    pub co_state: &'a mut [Vector6<T>],
}

impl<T: Real> Probe<'_, T> {
    #[inline(always)]
    fn swept(&self, k: usize) -> Swept<'_, T> {
        let (z, bias, terms) = (self.z[k].as_ref(), self.bias[k].as_ref(), self.terms[k].as_ref());
        Swept { z, bias, terms, measured: self.measured }
    }
}

/// What the filter left of one stage.
#[derive(Debug)]
pub(crate) struct Swept<'a, T: Real> {
    /// z^+.
    pub z: &'a [T; 6],
    /// b.
    pub bias: &'a [T; 6],
    /// Bounds on the terms of the diagonal of P^-.
    pub terms: &'a [T; 6],
    /// D and g of every row.
    pub measured: &'a [Measured<T>],
}

/// Squares of what one unit in the last place of one stage makes of w* a, over eps^2: of P, z^+, what its measurements added, and b.
#[derive(Debug, Clone, Copy)]
struct OfStage<T> {
    p: T,
    state: T,
    added: T,
    bias: T,
}

impl<T: Real> OfStage<T> {
    /// From the squares of g e^-, summed over the rows.
    #[inline(always)]
    fn new(swept: &Swept<'_, T>, added: &Vector6<T>, (nu, lambda): (&Vector6<T>, &Vector6<T>)) -> Self {
        let (terms, z, bias) = (Vector6::from(*swept.terms), Vector6::from(*swept.z), Vector6::from(*swept.bias));
        Self {
            p: squared(&terms, nu) * squared(&terms, lambda),
            state: squared(&times_each(&z, &z), nu),
            added: squared(added, nu),
            bias: squared(&times_each(&bias, &bias), nu),
        }
    }
}

impl<T: Real> Cancellation<T> {
    /// What the smoother's rounding is, of a co-state `outer` carried past a lever of this square to where zeta^+ has these [`squares`].
    #[inline(always)]
    pub(crate) fn carried(&mut self, zeta: (T, T), outer: &Vector6<T>, lever_square: T) {
        self.smoother += carried(zeta, outer, lever_square);
    }

    /// [`through_stage`](Self::through_stage) of one row that picks entry `PICKED` of its state; e^- of both right sides in, the estimate out.
    ///
    /// Without ALLOWS what the problem allows is not summed up: there is none where nobody gave the right side. Each number is read where
    /// it is needed: all of them at once are more than there are registers.
    #[inline(always)]
    pub(crate) fn through_axis<const PICKED: usize, const ALLOWS: bool>(
        &mut self,
        measured: &Measured<T>,
        &Swept { z, bias, terms, .. }: &Swept<'_, T>,
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
        let (mut of_p_nu, mut of_p_lambda, mut state, mut added, mut of_bias) = (o, o, o, o, o);
        for i in 0..6 {
            let square = nu[i] * nu[i];
            of_p_nu = terms[i].mul_add(square, of_p_nu);
            of_p_lambda = terms[i].mul_add(lambda[i] * lambda[i], of_p_lambda);
            state = (z[i] * z[i]).mul_add(square, state);
            added = (gain[i] * gain[i]).mul_add(square, added);
            if ALLOWS {
                of_bias = (bias[i] * bias[i]).mul_add(square, of_bias);
            }
        }
        let of_stage = OfStage { p: of_p_nu * of_p_lambda, state, added: e * e * added, bias: of_bias };
        if ALLOWS {
            self.add(&of_stage);
        } else {
            self.add_noise(&of_stage);
        }
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
        let mut added = zero();
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
            added = scaled_add(&times_each(&m.gain, &m.gain), e * e, &added);
            estimates[row] = a;
            self.size = self.size.worst(-a.abs());
        }
        self.add(&OfStage::new(swept, &added, (nu, lambda)));
    }
}

/// The sum of t x^2.
#[inline(always)]
fn squared<T: Real>(terms: &Vector6<T>, x: &Vector6<T>) -> T {
    dot(&times_each(terms, x), x)
}

/// Base to tip: the smoother, as [`smoother::sweep`](super::smoother::sweep), for both right sides, and what their products say.
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
        let swept = probe.swept(k);
        seen.through_stage(stage, &swept, (&mut lambda, &mut nu), (estimates, probe.innovations));
        co_state[k] = lambda;
        probe.co_state[k] = nu;
    }
    seen
}
