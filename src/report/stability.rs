//! Stability: the error of every method on one state, against the exact answer, in two norms and in two precisions.

use super::accuracy::{Dense, METHODS, Method, Solver};
use super::sensitivity::{Difference, Exact, Quantity, State};
use crate::dynamics;
use crate::scalar::{DoubleDouble, Real};
use crate::scene::{Model, Scene};
use crate::workspace::Workspace;

/// Every way to the accelerations, with the name it has in Python.
pub const FORMS: [(&str, Method); 4] = [
    ("covariance form", Method::Filter),
    ("square-root form", Method::SquareRoot),
    (METHODS[2].0, Method::DenseLdlt),
    (METHODS[3].0, Method::DenseCholesky),
];

/// Nothing dense is formed beyond this many degrees of freedom.
pub const DENSE_CAP: usize = 1000;

/// Why there is no error to tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Failure {
    /// A pivot is lost in rounding, or not positive.
    Pivot,
    /// A number overflowed, or is none.
    NotFinite,
    /// The mass matrix is too large to be formed.
    TooLarge,
}

impl Failure {
    /// In words.
    #[must_use]
    pub const fn reason(self) -> &'static str {
        match self {
            Self::Pivot => "a pivot is lost or not positive",
            Self::NotFinite => "a result is not finite",
            Self::TooLarge => "the mass matrix is not formed at this size",
        }
    }
}

/// The error of joint accelerations by `method` in the scalar `T`; in float32 scene and state are rounded first.
///
/// # Errors
///
/// [`Failure`], which is a result and not a mistake of the caller.
pub fn forward_error<T: Dense>(
    scene: &Scene,
    method: Method,
    state: State<'_>,
    exact: &Exact,
) -> Result<Difference, Failure> {
    if matches!(method, Method::DenseLdlt | Method::DenseCholesky | Method::ClosedInverse) && scene.nv() > DENSE_CAP {
        return Err(Failure::TooLarge);
    }
    let (q, qd, u) = (cast::<T>(state.q), cast::<T>(state.qd), cast::<T>(state.u));
    let mut qdd = cast::<T>(&vec![f64::NAN; scene.nv()]);
    let mut solver = Solver::<T>::new(scene, method).map_err(|_| Failure::TooLarge)?;
    let sound = solver.run(method, &q, &qd, &u, &mut qdd);
    if !sound {
        return Err(Failure::Pivot);
    }
    finite(&qdd, exact)
}

/// The error of another quantity by this library's recursion in the scalar `T`.
///
/// # Errors
///
/// As of [`forward_error`].
pub fn recursion_error<T: Dense>(
    scene: &Scene,
    quantity: Quantity,
    state: State<'_>,
    exact: &Exact,
) -> Result<Difference, Failure> {
    if quantity == Quantity::MassMatrix && scene.nv() > DENSE_CAP {
        return Err(Failure::TooLarge);
    }
    let model: Model<T> = scene.model().cast();
    let mut workspace = Workspace::new(&model);
    let (q, qd, u) = (cast::<T>(state.q), cast::<T>(state.qd), cast::<T>(state.u));
    let mut out = cast::<T>(&vec![f64::NAN; exact.values.len()]);
    match quantity {
        Quantity::ForwardDynamics => return forward_error::<T>(scene, Method::Filter, state, exact),
        Quantity::InverseDynamics => dynamics::inverse_dynamics(&model, &mut workspace, &q, &qd, &u, &[], &mut out),
        Quantity::BiasTorque => dynamics::bias_torque(&model, &mut workspace, &q, &qd, &[], &mut out),
        Quantity::MassMatrix => dynamics::mass_matrix(&model, &mut workspace, &q, &mut out),
    }
    finite(&out, exact)
}

fn cast<T: Real>(x: &[f64]) -> Vec<T> {
    x.iter().map(|&v| T::from_f64(v)).collect()
}

fn finite<T: Real>(found: &[T], exact: &Exact) -> Result<Difference, Failure> {
    let found: Vec<DoubleDouble> = found.iter().map(|x| DoubleDouble::from_f64(x.lane(0))).collect();
    let all = exact.difference(&found);
    if found.iter().all(|x| x.lane(0).is_finite()) { Ok(all) } else { Err(Failure::NotFinite) }
}
