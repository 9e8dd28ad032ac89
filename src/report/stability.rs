//! Numerical stability: the error of every method on one state relative to the exact result, in two
//! norms.

use super::accuracy::{CHOLESKY, LDLT, Method, Solver};
use super::sensitivity::{Difference, Exact, Quantity, State};
use crate::algorithm::{Algorithm, Arguments, Derivatives};
use crate::batch::evaluator::Evaluator;
use crate::filter::Form;
use crate::scalar::DoubleDouble;
use crate::scene::Scene;

/// All methods for the accelerations with their Python names, the default first.
pub const FORMS: &[(&str, Method)] = &[
    ("auto", Method::Filter(Form::Auto)),
    ("covariance form", Method::Filter(Form::Covariance)),
    ("square-root form", Method::Filter(Form::SquareRoot)),
    (LDLT, Method::DenseLdlt),
    (CHOLESKY, Method::DenseCholesky),
];

/// Largest number of degrees of freedom for dense matrices.
pub(crate) const DENSE_CAP: usize = 1000;

/// The reason why a method has no result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Failure {
    /// A pivot is below the rounding error of its terms, or not positive.
    Pivot,
    /// A value overflowed or is NaN.
    NotFinite,
    /// The mass matrix is too large.
    TooLarge,
}

impl Failure {
    /// Text of the reason.
    #[must_use]
    pub const fn reason(self) -> &'static str {
        match self {
            Self::Pivot => "a pivot is lost or not positive",
            Self::NotFinite => "a result is not finite",
            Self::TooLarge => "the mass matrix is not formed at this size",
        }
    }
}

/// The error of joint accelerations computed by `method`.
///
/// # Errors
///
/// [`Failure`], which is a result of the comparison.
///
/// # Panics
///
/// If [`Exact::new`] rejects the state.
pub fn forward_error(scene: &Scene, method: Method, state: State<'_>, exact: &Exact) -> Result<Difference, Failure> {
    if method.is_dense() && scene.nv() > DENSE_CAP {
        return Err(Failure::TooLarge);
    }
    let mut qdd = vec![f64::NAN; scene.nv()];
    let mut solver = Solver::new(scene, method).map_err(|_| Failure::TooLarge)?;
    let sound = solver.run(state.q, state.qd, state.u, &mut qdd);
    if !sound {
        return Err(Failure::Pivot);
    }
    finite(&qdd, exact)
}

/// The error of another quantity computed by [`Scene::evaluate`]; forward dynamics in
/// covariance form.
///
/// # Errors
///
/// As [`forward_error`].
pub fn recursion_error(
    scene: &Scene,
    quantity: Quantity,
    state: State<'_>,
    exact: &Exact,
) -> Result<Difference, Failure> {
    if quantity.count(scene.nv()) > DENSE_CAP * DENSE_CAP {
        return Err(Failure::TooLarge);
    }
    let algorithm = match quantity {
        Quantity::ForwardDynamics => Algorithm::ForwardDynamics(Form::Covariance),
        Quantity::InverseDynamics => Algorithm::InverseDynamics,
        Quantity::BiasTorque => Algorithm::BiasTorque,
        Quantity::MassMatrix => Algorithm::MassMatrix,
        Quantity::AccelerationDerivative => Algorithm::Derivatives(Derivatives::ForwardDynamics(Form::Covariance)),
    };
    let state = Arguments { q: state.q, qd: state.qd, u: state.u, ..Arguments::default() }.read_by(algorithm);
    let mut out = vec![f64::NAN; scene.width(algorithm)];
    if scene.evaluate(&mut Evaluator::new(scene), algorithm, &[state], &mut out).is_err() {
        let is_factored = algorithm.form().is_some();
        return Err(if is_factored { Failure::Pivot } else { Failure::NotFinite });
    }
    // The first matrix of the derivatives.
    finite(&out[..exact.values.len().min(out.len())], exact)
}

fn finite(found: &[f64], exact: &Exact) -> Result<Difference, Failure> {
    let found = DoubleDouble::each_of(found);
    let all = exact.difference(&found);
    if found.iter().all(|x| x.high.is_finite()) { Ok(all) } else { Err(Failure::NotFinite) }
}
