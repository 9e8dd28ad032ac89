//! The composite matrices of the paper: computed by the crate, and from definitions.
//!
//! By sweep: an operator applied to the columns of the identity. By definition: from E, H, Q and the Riccati
//! recursion on full matrices, with products and LU. Rows are ordered from base to tip, so that matrices that
//! are lower triangular in the paper are upper triangular here.

use nalgebra::{DMatrix, DVector};
use phipsi::operators::dense::Composite;
use phipsi::operators::{Factor, Kind, Operator};

pub type Matrix = DMatrix<f64>;
pub type Vector = DVector<f64>;

/// Composite matrices of one scene at one configuration, by their names in Python.
pub struct Matrices {
    pub e: Matrix,
    pub phi: Matrix,
    pub phi_strict: Matrix,
    pub psi: Matrix,
    pub a: Matrix,
    pub psi_a: Matrix,
    pub a_psi: Matrix,
    pub h: Matrix,
    pub q: Matrix,
    pub r: Matrix,
    pub p: Matrix,
    pub p_plus: Matrix,
    pub d: Matrix,
    pub d_inv: Matrix,
    pub g: Matrix,
    pub batch_gain: Matrix,
    pub lambda: Matrix,
    pub lambda_plus: Matrix,
    pub s: Matrix,
    pub k: Matrix,
    pub l: Matrix,
    pub m: Matrix,
    pub m_inv: Matrix,
}

/// An operator as a matrix: its sweep, applied to the columns of the identity.
pub fn swept(operator: &impl Operator<f64>) -> Matrix {
    let columns = operator.shape().1;
    apply(operator, &Matrix::identity(columns, columns))
}

/// The sweep of an operator on each column.
pub fn apply(operator: &impl Operator<f64>, x: &Matrix) -> Matrix {
    let mut y = Matrix::from_element(operator.shape().0, x.ncols(), f64::NAN);
    for (x, mut y) in x.column_iter().zip(y.column_iter_mut()) {
        operator.apply(x.as_slice(), y.as_mut_slice());
    }
    y
}

/// The inverse by LU.
pub fn inverse(m: &Matrix) -> Matrix {
    m.clone().try_inverse().expect("a matrix with an inverse")
}

/// The 6x6 diagonal blocks.
pub fn block_diagonal(m: &Matrix) -> Matrix {
    Matrix::from_fn(m.nrows(), m.ncols(), |i, j| if i / 6 == j / 6 { m[(i, j)] } else { 0.0 })
}

/// Block (i, j).
pub fn block(m: &Matrix, i: usize, j: usize) -> Matrix {
    m.view((6 * i, 6 * j), (6, 6)).into_owned()
}

impl Matrices {
    pub fn swept(factor: &Factor<f64>) -> Self {
        let of = |kind| swept(&factor.operator(kind));
        Self {
            e: of(Kind::Shifts),
            phi: of(Kind::Phi),
            phi_strict: of(Kind::PhiStrict),
            psi: of(Kind::Psi),
            a: of(Kind::ClosedLoop),
            psi_a: of(Kind::PsiA),
            a_psi: of(Kind::APsi),
            h: of(Kind::H),
            q: of(Kind::Q),
            r: of(Kind::R),
            p: of(Kind::P),
            p_plus: of(Kind::PFiltered),
            d: of(Kind::D),
            d_inv: Matrix::from_diagonal(&Vector::from_iterator(factor.nv(), factor.pivots().map(f64::recip))),
            g: of(Kind::Gain),
            batch_gain: of(Kind::BatchGain),
            lambda: of(Kind::Lambda),
            lambda_plus: of(Kind::LambdaPlus),
            s: of(Kind::S),
            k: of(Kind::K),
            l: of(Kind::L),
            m: of(Kind::Mass),
            m_inv: of(Kind::MassInverse),
        }
    }

    /// From E, H, Q, r and the Riccati recursion on full matrices; all others by products and LU.
    pub fn defined(composite: &Composite, noise: &Matrix) -> Self {
        let nv = composite.d.len();
        let copy = |m: &faer::Mat<f64>| Matrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)]);
        let (one, unit) = (Matrix::identity(6 * nv, 6 * nv), Matrix::identity(nv, nv));
        let (e, h, q, g) = (copy(&composite.shifts), copy(&composite.h), copy(&composite.q), copy(&composite.gain));
        let (p, p_plus) = (copy(&composite.p), copy(&composite.p_plus));
        let d = Matrix::from_diagonal(&Vector::from_column_slice(&composite.d));
        let d_inv = Matrix::from_diagonal(&d.diagonal().map(f64::recip));
        let phi = inverse(&(&one - &e));
        let phi_strict = &phi - &one;
        let a = &one - &g * &h;
        let psi = inverse(&(&one - &e * &a)) * &e;
        let r = &phi * &q * phi.transpose();
        let m = &h * &r * h.transpose() + noise;
        let m_inv = inverse(&m);
        let (h_phi, h_phi_strict) = (&h * &phi, &h * &phi_strict);
        let k = &h_phi_strict * &g;
        let l = &unit - inverse(&(&unit + &k));
        let co_state_plus = h_phi_strict.transpose() * &m_inv * &h_phi_strict;
        let psi_p = &psi * &p;
        Self {
            psi_a: &psi * &a,
            a_psi: &a * &psi,
            batch_gain: &r * h.transpose() * &m_inv,
            lambda: block_diagonal(&(h_phi.transpose() * &m_inv * &h_phi)),
            lambda_plus: block_diagonal(&co_state_plus),
            s: &p - &psi_p - psi_p.transpose() + &p * co_state_plus * &p,
            e,
            phi,
            phi_strict,
            psi,
            a,
            h,
            q,
            r,
            p,
            p_plus,
            d,
            d_inv,
            g,
            k,
            l,
            m,
            m_inv,
        }
    }
}
