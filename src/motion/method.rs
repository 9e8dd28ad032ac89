//! Integration methods: coefficients of Runge-Kutta and Rosenbrock-W methods.
//!
//! All methods are instances of one scheme. With y = (q, v), its time derivative f, and an approximation A of df/dy,
//! the stages of a step h are
//!
//! ```text
//! k_i = f(Y_i) + h A_i sum_{j <= i} gamma_ij k_j,   Y_i = y + h sum_{j < i} alpha_ij k_j
//! y(t + h) = y + h sum_i b_i k_i
//! ```
//!
//! Without gamma this is an explicit Runge-Kutta method. With gamma it is a Rosenbrock method, and a W-method if its
//! order does not require A to be the Jacobian (T. Steihaug and A. Wolfbrandt, Math. Comp. 33, 1979, 521-534; E. Hairer
//! and G. Wanner, Solving Ordinary Differential Equations II, IV.7). Here A contains springs and damping only, joint by
//! joint:
//!
//! ```text
//! A_i = ( 0  1 ; -M(q_i)^-1 k  -M(q_i)^-1 d ),     q_i of the stage
//! ```
//!
//! so that with `k_i = (l_i, m_i)` a stage is one forward dynamics with the measurement noise r + h g d + h^2 g^2 k,
//! where `g = gamma_ii`:
//!
//! ```text
//! l_i = c_i + h g m_i,    c_i = V_i + h sum_{j < i} gamma_ij m_j
//! (M + h g d + h^2 g^2 k) m_i = F(Y_i) - h k (g c_i + sum_{j < i} gamma_ij l_j) - h d sum_{j < i} gamma_ij m_j
//! ```
//!
//! `A_i` differs between stages, because it uses the mass matrix of the stage. Expanding `k_i` in h for an arbitrary
//! function A of y, with `alpha_i = sum_j alpha_ij` and `gamma_i = sum_{j<=i} gamma_ij`, gives the order conditions of
//! W-methods and one more:
//!
//! ```text
//! order 1   sum b_i = 1
//! order 2   sum b_i alpha_i = 1/2      sum b_i gamma_i = 0
//! order 3   sum b_i alpha_i^2 = 1/3    sum b_i alpha_ij alpha_j = 1/6    sum b_i alpha_ij gamma_j = 0
//!           sum b_i gamma_ij alpha_j = 0   sum b_i gamma_ij gamma_j = 0
//!           sum b_i alpha_i gamma_i = 0  (A' f, of A_i)
//! ```
//!
//! On the manifold the stages are increments in the Lie algebra, and `Y_i = y exp(h sum alpha_ij k_j)`, with f
//! transported by the inverse of the derivative of the exponential map (H. Munthe-Kaas, Appl. Numer. Math. 29, 1999,
//! 115-127).

use crate::error::{Error, choose};

/// Largest number of stages of a method.
pub(crate) const STAGES: usize = 7;

/// An integration method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Method {
    /// [`Method::Rosenbrock2`], or [`Method::RungeKutta4`] if bounds at the initial state show that springs, damping
    /// and gains are slow for this step. Steps in which joints rotate too far for the method are divided.
    #[default]
    Auto,
    /// v' = v + h a(q, v), then q' = q exp(h v'). Order 1; symplectic for constant M.
    SemiImplicitEuler,
    /// The classical explicit method of order 4.
    RungeKutta4,
    /// The explicit method of order 5 of J. R. Dormand and P. J. Prince, J. Comp. Appl. Math. 6, 1980, 19-26, with an
    /// embedded method of order 4 that estimates the error. Error control uses it for motion that is not stiff.
    DormandPrince5,
    /// Linearly implicit Euler method, order 1: springs and damping of any size are evaluated at the end of the step.
    /// L-stable for them: components faster than the step are damped.
    ImplicitEuler,
    /// Two stages, order 2 for any A, L-stable for springs and damping, g = 1 - 1/sqrt(2): ROS2 of J. G. Verwer, E. J.
    /// Spee, J. G. Blom and W. Hundsdorfer, SIAM J. Sci. Comput. 20, 1999, 1456-1480.
    Rosenbrock2,
    /// Four stages, order 3 for any A that can differ between stages, L-stable for springs and damping, stiffly
    /// accurate, g = 1/3. The coefficients solve the nine conditions above with small errors of order 4.
    Rosenbrock3,
    /// The method of all steps in which contacts act, order 1: springs and damping as in the implicit Euler method,
    /// contact impulses at the end of the step, impacts with Poisson's hypothesis. As the method of a run, it is that
    /// of every step; with all other methods, a step in which no contact can act is that of the scene without contacts.
    Contact,
}

/// Short names.
const SHORT: [(&str, Method); 2] = [("semi-implicit", Method::SemiImplicitEuler), ("implicit", Method::ImplicitEuler)];

/// All methods for scenes without contacts, with their names.
pub const METHODS: &[(&str, Method)] = &[
    ("auto", Method::Auto),
    ("semi-implicit-euler", Method::SemiImplicitEuler),
    ("rk4", Method::RungeKutta4),
    ("dormand-prince-5", Method::DormandPrince5),
    ("implicit-euler", Method::ImplicitEuler),
    ("rosenbrock-2", Method::Rosenbrock2),
    ("rosenbrock-3", Method::Rosenbrock3),
];

/// The method for scenes with contacts only.
const OF_CONTACTS: [(&str, Method); 1] = [("contact", Method::Contact)];

impl std::str::FromStr for Method {
    type Err = Error;

    /// As [`Method::named`].
    fn from_str(name: &str) -> Result<Self, Error> {
        Self::named(name)
    }
}

impl std::fmt::Display for Method {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

impl Method {
    /// The method named `name`; "semi-implicit" and "implicit" are short names of the Euler methods.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`], which lists the existing names.
    pub fn named(name: &str) -> Result<Self, Error> {
        let known: Vec<_> = METHODS.iter().copied().chain(OF_CONTACTS).collect();
        choose("method", name, &SHORT).or_else(|_| choose("method", name, &known))
    }

    /// The name of the method.
    #[must_use]
    pub fn name(self) -> &'static str {
        METHODS.iter().chain(&OF_CONTACTS).find(|(_, method)| *method == self).map_or("", |(name, _)| name)
    }

    /// Order of convergence for smooth motion; for [`Method::Auto`], the lowest order that it selects.
    #[must_use]
    pub fn order(self) -> u32 {
        match self {
            Self::SemiImplicitEuler | Self::ImplicitEuler | Self::Contact => 1,
            Self::Auto | Self::Rosenbrock2 => 2,
            Self::Rosenbrock3 => 3,
            Self::RungeKutta4 => 4,
            Self::DormandPrince5 => 5,
        }
    }

    /// True if springs and damping are implicit.
    #[must_use]
    pub fn is_implicit(self) -> bool {
        matches!(self, Self::Auto | Self::ImplicitEuler | Self::Rosenbrock2 | Self::Rosenbrock3 | Self::Contact)
    }

    pub(crate) fn tableau(self) -> Tableau {
        let row = |values: &[f64]| -> [f64; STAGES] { std::array::from_fn(|j| values.get(j).copied().unwrap_or(0.0)) };
        let rows = |values: &[&[f64]]| -> [[f64; STAGES]; STAGES] {
            std::array::from_fn(|i| row(values.get(i).copied().unwrap_or_default()))
        };
        match self {
            // Positions use the velocity at the end of the step; forces do not.
            Self::SemiImplicitEuler | Self::ImplicitEuler | Self::Contact => {
                Tableau { stages: 1, alpha: rows(&[]), gamma: rows(&[&[1.0]]), weights: row(&[1.0]) }
            }
            Self::RungeKutta4 => Tableau {
                stages: 4,
                alpha: rows(&[&[], &[0.5], &[0.0, 0.5], &[0.0, 0.0, 1.0]]),
                gamma: rows(&[]),
                weights: row(&[1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0]),
            },
            Self::DormandPrince5 => {
                let weights = [35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0];
                let alpha = rows(&[
                    &[],
                    &[1.0 / 5.0],
                    &[3.0 / 40.0, 9.0 / 40.0],
                    &[44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0],
                    &[19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0],
                    &[9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0],
                    &weights,
                ]);
                Tableau { stages: 7, alpha, gamma: rows(&[]), weights: row(&weights) }
            }
            Self::Auto | Self::Rosenbrock2 => {
                let g = 1.0 - std::f64::consts::FRAC_1_SQRT_2;
                let gamma = rows(&[&[g], &[-2.0 * g, g]]);
                Tableau { stages: 2, alpha: rows(&[&[], &[1.0]]), gamma, weights: row(&[0.5, 0.5]) }
            }
            Self::Rosenbrock3 => {
                let g = 1.0 / 3.0;
                let alpha = rows(&[
                    &[],
                    &[0.43],
                    &[0.76, -0.342_311_564_274_196_3],
                    &[0.05, 1.319_192_490_141_570_6, -0.524_975_613_684_137_7],
                ]);
                let gamma = rows(&[
                    &[g],
                    &[-0.211_431_805_443_481_3, g],
                    &[-0.555_783_210_976_123_3, 0.834_520_966_160_829_2, g],
                    &[0.118_164_642_334_620_23, -0.476_420_318_084_064_3, 0.180_705_465_958_677_85, g],
                ]);
                // The last stage is the end of the step.
                let weights = std::array::from_fn(|j| alpha[3][j] + gamma[3][j]);
                Tableau { stages: 4, alpha, gamma, weights }
            }
        }
    }
}

/// The coefficients of a method.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tableau {
    pub stages: usize,
    pub alpha: [[f64; STAGES]; STAGES],
    pub gamma: [[f64; STAGES]; STAGES],
    pub weights: [f64; STAGES],
}

impl Tableau {
    /// The last stage with a weight; later ones serve only the error estimate.
    pub fn last_stage(&self) -> usize {
        self.weights.iter().rposition(|&weight| weight != 0.0).unwrap_or(0)
    }

    /// All coefficients multiplied by the step.
    pub fn times(mut self, step: f64) -> Self {
        self.alpha.iter_mut().chain(&mut self.gamma).flatten().for_each(|x| *x *= step);
        self.weights.iter_mut().for_each(|x| *x *= step);
        self
    }
}

/// A method with a given step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scheme {
    /// The step, s.
    pub step: f64,
    /// The coefficients multiplied by the step.
    pub tableau: Tableau,
    /// True if springs, damping and control law are implicit.
    pub implicit: bool,
    /// The step times weights of the stages that sum to zero: the error estimate.
    pub error: [f64; STAGES],
    /// True if an embedded method provides the estimate, so that error control can use it.
    pub embedded: bool,
    /// A step is short enough if joints rotate by less than `angle`, rad, or if the error estimate is below `share`
    /// times the fastest joint velocity.
    pub angle: f64,
    pub share: f64,
}

impl Scheme {
    /// h g, the length over which a stage is implicit, the same for all stages of a method; zero for explicit ones.
    #[inline(always)]
    pub fn implicit_step(&self) -> f64 {
        if self.implicit { self.tableau.gamma[0][0] } else { 0.0 }
    }

    pub fn new(method: Method, step: f64) -> Self {
        let t = 1.0 / 6.0;
        // The weights of the method minus those of its embedded method.
        let embedded =
            [71.0 / 57600.0, 0.0, -71.0 / 16695.0, 71.0 / 1920.0, -17253.0 / 339_200.0, 22.0 / 525.0, -0.025];
        let o = 0.0;
        // The explicit methods conserve energy only to their error; the implicit ones damp fast components.
        let (error, angle, share) = match method {
            Method::RungeKutta4 => ([t, -t, -t, t, o, o, o], 0.05, 2e-7),
            Method::DormandPrince5 => (embedded, 0.05, 2e-7),
            Method::Rosenbrock3 => ([-0.5, o, o, 0.5, o, o, o], 0.1, 1e-3),
            _ => ([-0.5, 0.5, o, o, o, o, o], 0.1, 1e-3),
        };
        let error = error.map(|weight| weight * step);
        let embedded = method == Method::DormandPrince5;
        Self {
            step,
            tableau: method.tableau().times(step),
            implicit: method.is_implicit(),
            error,
            embedded,
            angle,
            share,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// sum of `b_i x_i`.
    fn weighed(t: &Tableau, x: impl Fn(usize) -> f64) -> f64 {
        (0..t.stages).map(|i| t.weights[i] * x(i)).sum()
    }

    fn row(of: &[[f64; STAGES]; STAGES], i: usize) -> f64 {
        of[i].iter().sum()
    }

    fn product(of: &[[f64; STAGES]; STAGES], i: usize, x: impl Fn(usize) -> f64) -> f64 {
        (0..STAGES).map(|j| of[i][j] * x(j)).sum()
    }

    #[test]
    fn the_conditions_of_the_orders_hold() {
        for &(name, method) in METHODS {
            let t = method.tableau();
            let (a, g) = (|i: usize| row(&t.alpha, i), |i: usize| row(&t.gamma, i));
            let mut found = vec![(weighed(&t, |_| 1.0), 1.0)];
            if method.order() >= 2 {
                found.extend([(weighed(&t, a), 0.5), (weighed(&t, g), 0.0)]);
            }
            if method.order() >= 3 {
                found.extend([
                    (weighed(&t, |i| a(i) * a(i)), 1.0 / 3.0),
                    (weighed(&t, |i| product(&t.alpha, i, a)), 1.0 / 6.0),
                    (weighed(&t, |i| product(&t.alpha, i, g)), 0.0),
                    (weighed(&t, |i| product(&t.gamma, i, a)), 0.0),
                    (weighed(&t, |i| product(&t.gamma, i, g)), 0.0),
                    (weighed(&t, |i| a(i) * g(i)), 0.0),
                ]);
            }
            for (k, (found, expected)) in found.into_iter().enumerate() {
                assert!((found - expected).abs() <= 16.0 * f64::EPSILON, "{name}, condition {k}: {found}");
            }
        }
    }

    /// Stability function R(z) = 1 + z b^T (1 - z B)^-1 1 with B = alpha + gamma, of a step for y' = lambda y with z =
    /// h lambda and exact A.
    fn stability(t: &Tableau, z: f64) -> f64 {
        let mut k = [0.0; STAGES];
        for i in 0..t.stages {
            let sum: f64 = (0..i).map(|j| (t.alpha[i][j] + t.gamma[i][j]) * k[j]).sum();
            k[i] = (1.0 + z * sum) / (1.0 - z * t.gamma[i][i]);
        }
        1.0 + z * weighed(t, |i| k[i])
    }

    #[test]
    fn the_implicit_methods_forget_what_is_infinitely_fast() {
        for &(name, method) in METHODS {
            if !method.is_implicit() {
                continue;
            }
            let t = method.tableau();
            assert!(stability(&t, -1e12).abs() <= 1e-9, "{name}");
            for z in [-1e-3, -0.1, -1.0, -10.0, -1e3, -1e6] {
                assert!(stability(&t, z).abs() <= 1.0, "{name} at {z}");
            }
        }
    }
}
