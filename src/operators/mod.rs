//! The operators of the paper as objects: phi, Psi, K, L, D, P and others, applied by sweeps in O(N).
//!
//! There is one block row per degree of freedom, in the order of qd (base to tip). phi, Psi, K and L are therefore
//! strictly *upper* block triangular, while the paper numbers from the tip and prints them lower triangular. A joint
//! with d degrees of freedom has d states without shifts between them; the inertia of the body enters at the outermost
//! one. States are in body frames.
//!
//! ```
//! use phipsi::operators::{Kind, Operator};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(4)?;
//! let factor = scene.factor(&mut scene.workspace(), &[0.3; 4])?; // M = (1 + K) D (1 + K*)
//! // M^-1 x by filter and smoother, and M of that: x again.
//! let (x, mut y, mut back) = ([1.0; 4], [f64::NAN; 4], [f64::NAN; 4]);
//! factor.operator(Kind::MassInverse).apply(&x, &mut y);
//! factor.operator(Kind::Mass).apply(&y, &mut back);
//! assert!(x.iter().zip(&back).all(|(x, back)| (x - back).abs() <= 1e-12));
//! // (5.1): M = H phi Q phi* H*, for there is no armature.
//! let [h, phi, q] = [Kind::H, Kind::Phi, Kind::Q].map(|kind| factor.operator(kind));
//! let mass = h.compose(phi).compose(q).compose(phi.transposed()).compose(h.transposed());
//! mass.apply(&y, &mut back);
//! assert!(x.iter().zip(&back).all(|(x, back)| (x - back).abs() <= 1e-12));
//! # Ok(())
//! # }
//! ```

mod compose;
#[cfg(feature = "dense")]
pub mod dense;
#[cfg(feature = "dense")]
mod estimate_batch;
mod factor;
mod sweeps;
mod update;

#[cfg(feature = "dense")]
pub use estimate_batch::{BatchCovariance, BatchEstimate, estimate_batch};

pub use compose::{Diagonal, Identity, Product, Sum, Transpose};
pub use factor::Factor;
pub use update::Updated;

use crate::error::named;
use crate::scalar::Real;

named! {
    /// The kind of an operator.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
    #[non_exhaustive]
    enum Kind;
    /// Every kind with its name in Python.
    const KINDS {
        /// phi = (1 - E)^-1, with the identity diagonal (1.7).
        Phi = "phi",
        /// E: the shifts between adjacent bodies, phi^-1 = 1 - E.
        Shifts = "E",
        /// Phi = phi - 1 (3.4).
        PhiStrict = "Phi",
        /// Psi = (1 - E A)^-1 E, closed loop, from the inboard side of a joint to the outboard side of the next (3.11).
        Psi = "psi",
        /// A = 1 - g H, block diagonal: the measurement update of the closed loop (3.9).
        ClosedLoop = "A",
        /// Psi A, from outboard side to outboard side (5.2 for the predicted error, 5.5 for lambda^-).
        PsiA = "Psi_A",
        /// A Psi, from inboard side to inboard side (5.2 for the filtered error, 5.5 for lambda^+).
        APsi = "A_Psi",
        /// The state-to-output map H (1.5).
        H = "H",
        /// Process noise Q = diag M(k) (1.6).
        Q = "Q",
        /// State covariance R = phi Q phi* (2.3).
        R = "R",
        /// Articulated inertia P^- as a block diagonal (3.6).
        P = "P",
        /// Articulated inertia P^+ after the measurement (3.6).
        PFiltered = "P_plus",
        /// Hinge inertia D, a diagonal (3.8).
        D = "D",
        /// Kalman gain g, a block diagonal column (3.10).
        Gain = "g",
        /// Batch Kalman gain G = R H* M^-1 (2.2).
        BatchGain = "G",
        /// Covariance Lambda^- of the co-states outboard of each row, a block diagonal (5.6).
        Lambda = "Lambda",
        /// Covariance Lambda^+ of the co-states inboard of each row, a block diagonal (5.7).
        LambdaPlus = "Lambda_plus",
        /// S = P - P Psi* - Psi P + P Psi* H* D^-1 H Psi P, with M^-1 = D^-1 H S H* D^-1 + r D^-2 (6.2).
        S = "S",
        /// K = H Phi g (3.8).
        K = "K",
        /// L = H Psi g (3.14).
        L = "L",
        /// The mass matrix, H R H* plus armature (5.1).
        Mass = "M",
        /// Its inverse by the factor, (1 - L*) D^-1 (1 - L) (3.3).
        MassInverse = "M_inv",
    }
}

impl Kind {
    /// True if it uses the covariances of forces or co-states, which a factor computes at their first use.
    #[must_use]
    #[doc(hidden)]
    pub fn needs_covariances(self) -> bool {
        matches!(self, Self::P | Self::PFiltered | Self::S | Self::Lambda | Self::LambdaPlus)
    }

    /// (rows, columns) for `nv` degrees of freedom.
    #[must_use]
    pub fn shape(self, nv: usize) -> (usize, usize) {
        match self {
            Self::H => (nv, 6 * nv),
            Self::Gain | Self::BatchGain => (6 * nv, nv),
            Self::D | Self::K | Self::L | Self::Mass | Self::MassInverse => (nv, nv),
            _ => (6 * nv, 6 * nv),
        }
    }
}

/// A linear operator that is applied without being formed.
pub trait Operator<T: Real> {
    /// (rows, columns).
    fn shape(&self) -> (usize, usize);
    /// y = A x.
    ///
    /// # Panics
    ///
    /// If the length of `x` or `y` differs from [`Operator::shape`].
    fn apply(&self, x: &[T], y: &mut [T]);
    /// y = A^T x.
    ///
    /// # Panics
    ///
    /// As [`Operator::apply`].
    fn apply_transpose(&self, x: &[T], y: &mut [T]);

    /// A^T as an operator.
    fn transposed(self) -> Transpose<Self>
    where
        Self: Sized,
    {
        Transpose(self)
    }

    /// A B as an operator, where `inner` is B.
    fn compose<B: Operator<T>>(self, inner: B) -> Product<Self, B>
    where
        Self: Sized,
    {
        Product(self, inner)
    }

    /// A + scale B as an operator.
    fn plus<B: Operator<T>>(self, scale: f64, other: B) -> Sum<Self, B>
    where
        Self: Sized,
    {
        Sum { left: self, scale, right: other }
    }
}

/// One of the operators of a factor.
#[derive(Debug, Clone, Copy)]
pub struct Applied<'f, T: Real> {
    factor: &'f Factor<T>,
    kind: Kind,
}

impl<T: Real> Operator<T> for Applied<'_, T> {
    fn shape(&self) -> (usize, usize) {
        self.kind.shape(self.factor.nv())
    }

    fn apply(&self, x: &[T], y: &mut [T]) {
        assert_lengths(self.shape(), (y.len(), x.len()));
        sweeps::apply(self.factor, self.kind, x, y);
    }

    fn apply_transpose(&self, x: &[T], y: &mut [T]) {
        assert_lengths(self.shape(), (x.len(), y.len()));
        sweeps::apply_transpose(self.factor, self.kind, x, y);
    }
}

/// Checks the lengths of the vectors of an operator of this shape, (rows, columns).
fn assert_lengths(shape: (usize, usize), lengths: (usize, usize)) {
    assert!(shape == lengths, "an operator of shape {shape:?} for vectors of lengths {lengths:?}");
}
