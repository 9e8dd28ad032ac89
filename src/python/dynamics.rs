//! Methods of `Scene`: forces, accelerations, and the mass matrix.

use super::choice::read_judged;
use super::evaluate::Keywords;
use super::fresh;
use super::object::Object;
use super::scene::PyScene;
use crate::algorithm::Algorithm;
use crate::error::Error;
use pyo3::prelude::*;

/// An array of float64, or of float32 where that was asked for.
type Array<'py> = PyResult<Object<'py>>;

/// Dense matrices stop here: (4000, 4000) are 128 MB a state.
const DENSE_LIMIT: usize = 4000;

/// Rough time of one body in one state, ns (see [`Cost`](super::cost::Cost)).
mod cost {
    pub const FORWARD: usize = 90;
    pub const INVERSE: usize = 50;
    pub const COMPOSITE: usize = 30;
    pub const CLOSED_FORM: usize = 60;
}

#[pymethods]
impl PyScene {
    /// Joint accelerations from joint torques, in O(N): the smoother's estimates given the torques as measurements.
    ///
    /// q: (..., nq); qd, tau: (..., nv); SI units, radians; leading axes broadcast. wrenches: dict from link names (links on fixed joints
    /// too) to (..., 6), each a (moment, force) acting on that link, at its origin and in its frame. form: how P is carried: "covariance"
    /// (3.6), "square-root" (right at extreme mass ratios too, at about twice the time), or "auto", which takes the first and recomputes a state
    /// in square-root form, and in double-double arithmetic where that is not enough, if its estimated error exceeds the tolerance and what rounding of the
    /// forces by a unit in the last place makes of it. tolerance: the largest accepted error relative to the largest acceleration, above 0 and below 1, for the forms "auto"
    /// and "square-root"; None: max(5e-14, 4 n eps), n being the number of degrees of freedom on the longest path to the base. out: C-contiguous, of the
    /// result's shape and dtype, overlapping no argument; it is returned. dtype: float64, or float32 to compute in twice as many SIMD
    /// lanes: about 6 digits, fewer by those of the condition number of M; a state that loses more than 4 in form "auto" is done in
    /// float64 and rounded, and so is all that docs/lanes.md lists. Arguments are converted to it.
    /// errors: "raise", or "nan" to go on past bad states (numbers that are not finite, a quaternion off unit norm, a singular joint,
    /// an overflow): their results are NaN, and one BadStateWarning has .states and .reasons. Wrong shapes raise all the same.
    ///
    /// **tau of a free joint is (force, moment), as its qd is (linear, angular); wrenches are (moment, force).**
    ///
    /// return_info: whether to tell the accuracy too, one entry a state, for about five times the time in the forms "covariance" and
    /// "square-root", next to nothing in "auto".
    ///
    /// Of a scene with connections the accelerations go through them, as constrained_dynamics has them; no error is estimated.
    /// Contacts act in simulation only: of a scene with contacts these are the accelerations of the tree.
    ///
    /// Returns qdd, (..., nv), with M qdd + bias = tau + J^T w (4.4 to 4.11); with return_info (qdd, Accuracy): .form, the form that gave
    /// the result; .error, the estimated error of the largest acceleration; and .bound, the bound that this error meets.
    ///
    /// Raises SingularJointError where a joint has no inertia along its axis; ConstraintError where connections contradict each other; ArgumentError,
    /// naming the link, for the square-root form of an inertia that no body can have; ShapeError, NotFiniteError, ArgumentError, each naming the
    /// argument and the state. After an error out is partly written.
    #[pyo3(signature = (q, qd, tau, *, form="auto", tolerance=None, wrenches=None, out=None, dtype=None, errors="raise", return_info=false))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn forward_dynamics<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        tau: &Object<'py>,
        form: &str,
        tolerance: Option<f64>,
        wrenches: Option<&Object<'py>>,
        out: Option<&Object<'py>>,
        dtype: Option<&Object<'py>>,
        errors: &str,
        return_info: bool,
    ) -> Array<'py> {
        let (algorithm, tolerance) = read_judged(&self.scene, (form, tolerance), Algorithm::ForwardDynamics)?;
        let given = [("q", q), ("qd", qd), ("tau", tau)];
        let keywords = Keywords { wrenches, out, dtype, errors, tolerance, info: return_info };
        let is_tree = self.scene.connections().is_empty();
        let cost = if is_tree { cost::FORWARD } else { self.cost_through_connections() };
        self.evaluate(py, algorithm, cost, given, &keywords)
    }

    /// Joint torques from joint accelerations, in O(N), gravity and armature included.
    ///
    /// q: (..., nq); qd, qdd: (..., nv); SI units, radians; leading axes broadcast. wrenches, out, dtype and errors as in forward_dynamics.
    ///
    /// **tau of a free joint is (force, moment), as its qd and qdd are (linear, angular); wrenches are (moment, force).**
    ///
    /// Returns tau, (..., nv) = H phi (Q lambda + b) + armature qdd - J^T w (1.5, 2.9, 2.10).
    ///
    /// Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q, qd, qdd, *, wrenches=None, out=None, dtype=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn inverse_dynamics<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        qdd: &Object<'py>,
        wrenches: Option<&Object<'py>>,
        out: Option<&Object<'py>>,
        dtype: Option<&Object<'py>>,
        errors: &str,
    ) -> Array<'py> {
        let given = [("q", q), ("qd", qd), ("qdd", qdd)];
        let keywords = Keywords { wrenches, out, dtype, errors, tolerance: None, info: false };
        self.evaluate(py, Algorithm::InverseDynamics, cost::INVERSE, given, &keywords)
    }

    /// The bias torque H phi b: what the joints must give so that none accelerates, gravity included.
    ///
    /// q: (..., nq); qd: (..., nv); leading axes broadcast; out, dtype and errors as in forward_dynamics. Returns (..., nv), N m or N.
    ///
    /// Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    #[pyo3(signature = (q, qd, *, out=None, dtype=None, errors="raise"))]
    fn bias_torque<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        out: Option<&Object<'py>>,
        dtype: Option<&Object<'py>>,
        errors: &str,
    ) -> Array<'py> {
        let keywords = Keywords { wrenches: None, out, dtype, errors, tolerance: None, info: false };
        self.evaluate(py, Algorithm::BiasTorque, cost::INVERSE, [("q", q), ("qd", qd)], &keywords)
    }

    /// The torques that hold the scene against gravity, dU/dq along the tangent of q: the bias torque at rest.
    ///
    /// q: (..., nq); out, dtype and errors as in forward_dynamics. Returns (..., nv), N m or N. O(N).
    ///
    /// Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q, *, out=None, dtype=None, errors="raise"))]
    fn gravity_torque<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        out: Option<&Object<'py>>,
        dtype: Option<&Object<'py>>,
        errors: &str,
    ) -> Array<'py> {
        let rest = fresh::zeros::<f64>(py, &[self.scene.nv()])?.into_any();
        let keywords = Keywords { wrenches: None, out, dtype, errors, tolerance: None, info: false };
        self.evaluate(py, Algorithm::BiasTorque, cost::INVERSE, [("q", q), ("qd", &rest)], &keywords)
    }

    /// The joint-space mass matrix, the covariance of the measurements (5.1), armature on its diagonal.
    ///
    /// q: (..., nq); out, dtype and errors as in forward_dynamics. Returns (..., nv, nv), full and exactly symmetric, SI units. Large batches of
    /// matrices take less time into an out that was used before: new memory is cleared by the system first.
    ///
    /// Raises ArgumentError above 4000 degrees of freedom: inverse_dynamics multiplies by the matrix without forming it.
    /// Raises ShapeError, NotFiniteError, ArgumentError for a bad q, naming the state.
    #[pyo3(signature = (q, *, out=None, dtype=None, errors="raise"))]
    fn mass_matrix<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        out: Option<&Object<'py>>,
        dtype: Option<&Object<'py>>,
        errors: &str,
    ) -> Array<'py> {
        self.check_dense("mass_matrix", "inverse_dynamics, which multiplies by it")?;
        let keywords = Keywords { wrenches: None, out, dtype, errors, tolerance: None, info: false };
        self.evaluate(py, Algorithm::MassMatrix, cost::COMPOSITE, [("q", q)], &keywords)
    }

    /// The inverse of the mass matrix in closed form (6.1), without forming or factoring the matrix.
    ///
    /// q: (..., nq). form, tolerance, out, dtype and errors: as in forward_dynamics, the error being that of the factor of M. Returns (..., nv, nv), full and exactly symmetric, SI units: the tree's,
    /// whatever connections there are (constrained_mass_matrix_inverse is through them).
    ///
    /// Raises ArgumentError above 4000 degrees of freedom: forward_dynamics multiplies by the inverse without forming it.
    /// Raises SingularJointError, ShapeError, NotFiniteError, ArgumentError, naming the state.
    #[pyo3(signature = (q, *, form="auto", tolerance=None, out=None, dtype=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn mass_matrix_inverse<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        form: &str,
        tolerance: Option<f64>,
        out: Option<&Object<'py>>,
        dtype: Option<&Object<'py>>,
        errors: &str,
    ) -> Array<'py> {
        let (algorithm, tolerance) = read_judged(&self.scene, (form, tolerance), Algorithm::MassMatrixInverse)?;
        self.check_dense("mass_matrix_inverse", "forward_dynamics, which multiplies by it")?;
        let keywords = Keywords { wrenches: None, out, dtype, errors, tolerance, info: false };
        self.evaluate(py, algorithm, cost::CLOSED_FORM, [("q", q)], &keywords)
    }
}

impl PyScene {
    pub(super) fn check_dense(&self, method: &str, instead: &str) -> Result<(), Error> {
        let nv = self.scene.nv();
        if nv <= DENSE_LIMIT {
            return Ok(());
        }
        Err(Error::argument(
            method,
            format!("a scene of {nv} degrees of freedom"),
            format!("at most {DENSE_LIMIT} for a dense matrix; use {instead}"),
        ))
    }
}
