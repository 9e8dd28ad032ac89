//! Products, sums and transposes of operators, which are operators too, so that equations of the paper can be written
//! directly.
//!
//! ```
//! use phipsi::operators::{Identity, Kind, Operator};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(4)?;
//! let factor = scene.factor(&mut scene.workspace(), &[0.3; 4])?;
//! // (3.12) as it holds: Psi = (1 - Psi g H) Phi.
//! let [psi, gain, h, phi] = [Kind::Psi, Kind::Gain, Kind::H, Kind::PhiStrict].map(|kind| factor.operator(kind));
//! let right = Identity(24).plus(-1.0, psi.compose(gain).compose(h)).compose(phi);
//! let (x, mut y, mut z) = ([1.0; 24], [f64::NAN; 24], [f64::NAN; 24]);
//! factor.operator(Kind::Psi).apply(&x, &mut y);
//! right.apply(&x, &mut z);
//! assert!(y.iter().zip(&z).all(|(y, z)| (y - z).abs() <= 1e-12));
//! # Ok(())
//! # }
//! ```

use super::{Operator, assert_lengths};
use crate::scalar::Real;

/// The identity of that size.
#[derive(Debug, Clone, Copy)]
pub struct Identity(pub usize);

/// A diagonal, such as D^-1.
#[derive(Debug, Clone)]
pub struct Diagonal<T>(pub Vec<T>);

/// A^T.
#[derive(Debug, Clone, Copy)]
pub struct Transpose<A>(pub A);

/// A B: applies B first.
#[derive(Debug, Clone, Copy)]
pub struct Product<A, B>(pub A, pub B);

/// A + scale B.
#[derive(Debug, Clone, Copy)]
pub struct Sum<A, B> {
    /// A.
    pub left: A,
    /// The factor of B.
    pub scale: f64,
    /// B.
    pub right: B,
}

impl<T: Real> Operator<T> for Identity {
    fn shape(&self) -> (usize, usize) {
        (self.0, self.0)
    }

    fn apply(&self, x: &[T], y: &mut [T]) {
        y.copy_from_slice(x);
    }

    fn apply_transpose(&self, x: &[T], y: &mut [T]) {
        y.copy_from_slice(x);
    }
}

impl<T: Real> Operator<T> for Diagonal<T> {
    fn shape(&self) -> (usize, usize) {
        (self.0.len(), self.0.len())
    }

    fn apply(&self, x: &[T], y: &mut [T]) {
        assert_lengths((self.0.len(), self.0.len()), (y.len(), x.len()));
        for ((y, &x), &entry) in y.iter_mut().zip(x).zip(&self.0) {
            *y = entry * x;
        }
    }

    fn apply_transpose(&self, x: &[T], y: &mut [T]) {
        self.apply(x, y);
    }
}

impl<T: Real, A: Operator<T>> Operator<T> for Transpose<A> {
    fn shape(&self) -> (usize, usize) {
        let (rows, columns) = self.0.shape();
        (columns, rows)
    }

    fn apply(&self, x: &[T], y: &mut [T]) {
        self.0.apply_transpose(x, y);
    }

    fn apply_transpose(&self, x: &[T], y: &mut [T]) {
        self.0.apply(x, y);
    }
}

impl<T: Real, A: Operator<T>, B: Operator<T>> Operator<T> for Product<A, B> {
    fn shape(&self) -> (usize, usize) {
        (self.0.shape().0, self.1.shape().1)
    }

    fn apply(&self, x: &[T], y: &mut [T]) {
        let mut between = vec![T::zero(); self.1.shape().0];
        self.1.apply(x, &mut between);
        self.0.apply(&between, y);
    }

    fn apply_transpose(&self, x: &[T], y: &mut [T]) {
        let mut between = vec![T::zero(); self.0.shape().1];
        self.0.apply_transpose(x, &mut between);
        self.1.apply_transpose(&between, y);
    }
}

impl<T: Real, A: Operator<T>, B: Operator<T>> Operator<T> for Sum<A, B> {
    fn shape(&self) -> (usize, usize) {
        self.left.shape()
    }

    fn apply(&self, x: &[T], y: &mut [T]) {
        let mut other = vec![T::zero(); y.len()];
        self.left.apply(x, y);
        self.right.apply(x, &mut other);
        add_scaled(y, self.scale, &other);
    }

    fn apply_transpose(&self, x: &[T], y: &mut [T]) {
        let mut other = vec![T::zero(); y.len()];
        self.left.apply_transpose(x, y);
        self.right.apply_transpose(x, &mut other);
        add_scaled(y, self.scale, &other);
    }
}

fn add_scaled<T: Real>(y: &mut [T], scale: f64, other: &[T]) {
    let scale = T::from_f64(scale);
    for (y, &other) in y.iter_mut().zip(other) {
        *y += scale * other;
    }
}
