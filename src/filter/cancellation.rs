//! The error estimate of the covariance form, from a test vector: one more right-hand side.
//!
//! The covariance form subtracts: P^+ = P^- - g D g* (3.6), z^+ = z^- + g e^- (4.5). If the difference is small, as
//! inboard of a heavy body that joints leave free, the rounding of the operands remains and is divided by small pivots
//! further inward. To first order, an error dP in P and df in z of stage k changes the estimates as a force
//! dP lambda(k) + df on that stage does. For any weights w on the rows
//!
//! `w* da = sum over k of nu(k)* (dP(k) lambda(k) + df(k))`, nu = the co-states of the measurements w alone, M a = w.
//!
//! A test vector w of irregular numbers of either sign therefore measures the error of every row through every gain. It
//! includes the contraction of the closed loop (a bound that adds norms does not, and rejects every long chain) and the
//! growth of a small error at the root of a long lever in the outward pass. The rounding of the smoother is added as in
//! [`rounding`](super::rounding). The rounding errors are assumed to be independent, so that squares are added: dP is
//! about eps times the terms of P^- (axis by axis), df about eps times z^+ and g e^-. The estimate costs a filter and a
//! smoother of w, about 370 operations a stage, without a branch on a value, and one comparison at the end.
//!
//! The estimated error is accepted if it is below a fraction of the largest estimate, or below the sensitivity of the
//! problem to one unit in the last place of its data ([`Margins`]). The accelerations of a robot in static equilibrium
//! are rounding: one unit in the last place of a torque, or of a force that a joint transmits, changes them as much as
//! any algorithm does. The same sums with the same nu give the effect of such units on w* a:
//!
//! - of the forces at rest, `nu(k)_i f(k)_i`: f = z^+ + P^+ lambda is the force that the body transmits, and `f_i^2` is
//!   above `z_i^2 / 2 - P_ii (lambda* P lambda)`. For a body in free fall it is zero.
//! - of the bias, `nu(k)_i b(k)_i`: the body's own weight, velocity effects and wrench.
//!
//! It is an estimate, not a bound: usually five to ten times the true error in the max norm of all rows. The weights of
//! one test vector may cancel, so `dynamics::auto` recomputes states near the bound with a second one. Neither measures
//! errors made before the filter (in phi, in velocities, in b), which all forms share; and a component that is small
//! compared with the largest.

use super::riccati::Measured;
use super::rounding::carried;
use super::system::Stage;
use crate::scalar::{Real, larger};
use crate::spatial::{dot, scaled_add, times_each, zero};
use nalgebra::Vector6;

/// The accepted multiples of the sensitivity of the problem: to the bias and to the forces at rest, as a sum of
/// squares. The tolerance relative to the largest estimate is accepted in any case.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Margins {
    /// In units of the sensitivity to one unit in the last place of the forces at rest.
    pub of_rest: f64,
    /// The same for the bias.
    pub of_bias: f64,
    /// The limit of the contribution of the bias, in eps of the largest estimate.
    pub of_bias_at_most: f64,
}

impl Margins {
    /// For one test vector, whose weights may cancel.
    pub const CLOSE: Self = Self { of_rest: 2.5, of_bias: 60.0, of_bias_at_most: 1500.0 };

    /// For two test vectors.
    ///
    /// Of 400,000 random cases a dozen have a true error above 1e-12 and 20 times the sensitivity with an estimate
    /// below it, by a factor of 2.3 at the most.
    pub const USUAL: Self = Self { of_rest: 3.0, of_bias: 60.0, of_bias_at_most: 2500.0 };

    /// For a factor: without a right-hand side there is no sensitivity.
    pub const OF_A_FACTOR: Self = Self { of_rest: 0.0, of_bias: 0.0, of_bias_at_most: 0.0 };
}

/// The ratio of the squared bound on the terms of P^- to the squared rounding of a typical entry in eps.
const BOUND_SQUARED: f64 = 64.0;

/// The weight of a row: between 3/4 and 5/4, of either sign, and different from those of its neighbors, so that errors
/// do not cancel.
#[must_use]
pub fn weight(row: usize) -> f64 {
    // The mixing of splitmix64.
    let mixed = (row as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let [high, low, sign, ..] = mixed.to_be_bytes();
    let size = 0.75 + 0.5 * f64::from(u16::from_be_bytes([high, low])) / 65536.0;
    if sign & 1 == 0 { size } else { -size }
}

/// The error estimate, as the smoother accumulates it.
#[derive(Debug, Clone, Copy)]
pub struct Cancellation<T> {
    /// The estimated square of w* da, over eps^2: the contributions of P, of the forces and of the smoother.
    noise: T,
    /// The square of the effect on w* a of one unit in the last place of the forces at rest, over eps^2.
    rest: T,
    /// The same of the bias.
    bias: T,
    /// Minus the largest estimate.
    size: T,
}

impl<T: Real> Cancellation<T> {
    /// The estimate before the first stage.
    #[inline(always)]
    #[must_use]
    pub fn new() -> Self {
        let o = T::zero();
        Self { noise: o, rest: o, bias: o, size: o }
    }

    /// The estimated error of the largest estimate, in its unit, including the effect of one unit in the last place of
    /// the forces; NaN if it cannot be estimated.
    #[inline(always)]
    #[must_use]
    pub fn error(&self) -> T {
        (self.noise + (self.rest + self.bias)).sqrt() * T::epsilon()
    }

    /// The same of one lane, relative to the largest estimate.
    #[must_use]
    pub fn relative_error(&self, lane: usize) -> f64 {
        let error = self.error().lane(lane);
        if error == 0.0 { error } else { error / -self.size.lane(lane) }
    }

    /// The margin of the error to the tolerance, given as its square in units of eps^2, or to `margins`, as a
    /// difference of squares: negative or NaN in a lane whose error is too large.
    #[inline(always)]
    #[must_use]
    pub fn slack(&self, tolerance: T, margins: &Margins) -> T {
        let square = |x: f64| self.size.constant(x * x);
        let size = self.size * self.size;
        let of_bias = (self.bias * square(margins.of_bias)).worst(size * square(margins.of_bias_at_most));
        let allowed = larger(size * tolerance, of_bias);
        self.rest.mul_add(square(margins.of_rest), allowed) - self.noise
    }

    /// The larger value of each part, for two test vectors.
    #[inline(always)]
    pub(crate) fn larger(&self, other: &Self) -> Self {
        Self {
            noise: larger(self.noise, other.noise),
            rest: larger(self.rest, other.rest),
            bias: larger(self.bias, other.bias),
            size: self.size.worst(other.size),
        }
    }

    /// Adds the contributions of a stage to w* a.
    #[inline(always)]
    fn add(&mut self, stage: &StageRounding<T>) {
        let StageRounding { p, state, bias, .. } = *stage;
        self.add_noise(stage);
        // The transmitted force, minus the part that may be an acceleration; never negative.
        let transmitted = state.mul_add(p.constant(-0.5), p);
        self.rest -= transmitted.worst(p.constant(0.0));
        self.bias += bias;
    }

    /// The contributions of rounding alone.
    #[inline(always)]
    fn add_noise(&mut self, stage: &StageRounding<T>) {
        let StageRounding { p, state, added, .. } = *stage;
        self.noise = p.mul_add(p.constant(1.0 / BOUND_SQUARED), self.noise) + (state + added);
    }
}

impl<T: Real> Default for Cancellation<T> {
    fn default() -> Self {
        Self::new()
    }
}

/// The filter's results for one stage.
#[derive(Debug)]
pub(crate) struct StageState<'a, T: Real> {
    /// z^+.
    pub z: &'a [T; 6],
    /// b.
    pub bias: &'a [T; 6],
    /// Bounds on the terms of the diagonal of P^-.
    pub terms: &'a [T; 6],
    /// D and g of every row.
    pub measured: &'a [Measured<T>],
}

/// Squares of the effect on w* a of one unit in the last place of one stage, over eps^2: of P, of z^+, of the changes
/// by its measurements, and of b.
#[derive(Debug, Clone, Copy)]
struct StageRounding<T> {
    p: T,
    state: T,
    added: T,
    bias: T,
}

impl<T: Real> StageRounding<T> {
    /// From the squares of g e^-, summed over the rows.
    #[inline(always)]
    fn new(swept: &StageState<'_, T>, added: &Vector6<T>, (nu, lambda): (&Vector6<T>, &Vector6<T>)) -> Self {
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
    /// Adds the smoother's rounding of a co-state `outer` that is propagated over a lever of this square, where the
    /// squares of zeta^+ are these [`squares`].
    #[inline(always)]
    pub(crate) fn carried(&mut self, zeta: (T, T), outer: &Vector6<T>, lever_square: T) {
        self.noise += carried(zeta, outer, lever_square);
    }

    /// [`through_stage`](Self::through_stage) for one row that selects entry `PICKED` of its state: e^- of both
    /// right-hand sides in, the estimate out.
    ///
    /// Without ALLOWS, the sensitivity of the problem is not accumulated: a factor has no right-hand side of its own.
    /// Each value is read where it is needed, because all of them together exceed the number of registers.
    #[inline(always)]
    pub(crate) fn through_axis<const PICKED: usize, const ALLOWS: bool>(
        &mut self,
        measured: &Measured<T>,
        &StageState { z, bias, terms, .. }: &StageState<'_, T>,
        (lambda, nu): (&mut [T; 6], &mut [T; 6]),
        (e, e_w): (T, T),
    ) -> T {
        let Measured { pivot_inverse, gain, .. } = measured;
        let share = e * *pivot_inverse;
        let a = share - dot(gain, &Vector6::from(*lambda));
        self.noise = (e_w * e_w).mul_add(share.mul_add(share, a * a), self.noise);
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
        let of_stage = StageRounding { p: of_p_nu * of_p_lambda, state, added: e * e * added, bias: of_bias };
        if ALLOWS {
            self.add(&of_stage);
        } else {
            self.add_noise(&of_stage);
        }
        a
    }

    /// The rows of one stage for both right-hand sides, as [`smoother::through_stage`](super::smoother::through_stage):
    /// co-states lambda^+ and nu^+ in, lambda^- and nu out; e^- in, estimates out for the first, e^- of the second.
    #[inline(always)]
    pub(crate) fn through_stage(
        &mut self,
        stage: &Stage<T>,
        swept: &StageState<'_, T>,
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
            self.noise += e_w * e_w * (share * share + a * a);
            let c = e_w * m.pivot_inverse - dot(&m.gain, nu);
            *lambda = hinge.spread_onto(lambda, a);
            *nu = hinge.spread_onto(nu, c);
            added = scaled_add(&times_each(&m.gain, &m.gain), e * e, &added);
            estimates[row] = a;
            self.size = self.size.worst(-a.abs());
        }
        self.add(&StageRounding::new(swept, &added, (nu, lambda)));
    }
}

/// The sum of t x^2.
#[inline(always)]
fn squared<T: Real>(terms: &Vector6<T>, x: &Vector6<T>) -> T {
    dot(&times_each(terms, x), x)
}
