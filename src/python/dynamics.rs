//! Methods of `Scene`: forces, accelerations, and the mass matrix.

use super::arrays::Input;
use super::choice::choose;
use super::evaluate::Call;
use super::scene::PyScene;
use super::wrenches::Wrench;
use crate::batch::chunk::Algorithm;
use crate::error::Error;
use crate::filter::{FORMS, Form};
use numpy::PyArrayDyn;
use pyo3::prelude::*;

type Array<'py> = PyResult<Bound<'py, PyArrayDyn<f64>>>;

/// Dense matrices stop here: (4000, 4000) are 128 MB a state.
const DENSE_LIMIT: usize = 4000;

/// Rough time of one body in one state, ns (see `Call::new`).
mod cost {
    pub const FORWARD: usize = 130;
    pub const INVERSE: usize = 60;
    pub const COMPOSITE: usize = 80;
    pub const CLOSED_FORM: usize = 200;
    /// Of one entry of a matrix.
    pub const ENTRY: usize = 12;
}

#[pymethods]
impl PyScene {
    /// Joint accelerations from joint torques, in O(N): the smoother's estimates given the torques as measurements.
    ///
    /// q: (..., nq); qd, tau: (..., nv); SI units, radians; leading axes broadcast. wrenches: dict from link names to
    /// (..., 6), each a (moment, force) acting on that link, at its origin and in its frame. form: how P is carried, "covariance"
    /// (3.6), "joseph", "square-root", or "auto". out: C-contiguous float64 of the result's shape that overlaps no argument, returned.
    ///
    /// Returns qdd, (..., nv), with M qdd + bias = tau + J^T w (4.4 to 4.11).
    ///
    /// Raises `SingularJointError` where a joint has no inertia along its axis, `ShapeError`, `NotFiniteError`, `ArgumentError`,
    /// each naming the argument and the state. After an error out is partly written.
    #[pyo3(signature = (q, qd, tau, *, form="auto", wrenches=None, out=None))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn forward_dynamics<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        qd: &Bound<'py, PyAny>,
        tau: &Bound<'py, PyAny>,
        form: &str,
        wrenches: Option<&Bound<'py, PyAny>>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> Array<'py> {
        let form = read_form(form)?;
        let nv = self.scene.nv();
        let inputs = [Input::new("q", q, self.scene.nq())?, Input::new("qd", qd, nv)?, Input::new("tau", tau, nv)?];
        let wrenches = Wrench::read(&self.scene, wrenches)?;
        let call = Call::new(self, inputs, wrenches, cost::FORWARD * self.size())?;
        call.algorithm(py, Algorithm::ForwardDynamics(form), &[nv], out)
    }

    /// Joint torques from joint accelerations, in O(N), gravity and armature included.
    ///
    /// q: (..., nq); qd, qdd: (..., nv); SI units, radians; leading axes broadcast. wrenches and out as in `forward_dynamics`.
    ///
    /// Returns tau, (..., nv) = H phi (Q lambda + b) + armature qdd - J^T w (1.5, 2.9, 2.10).
    ///
    /// Raises `ShapeError`, `NotFiniteError`, `ArgumentError`, each naming the argument and the state.
    #[pyo3(signature = (q, qd, qdd, *, wrenches=None, out=None))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn inverse_dynamics<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        qd: &Bound<'py, PyAny>,
        qdd: &Bound<'py, PyAny>,
        wrenches: Option<&Bound<'py, PyAny>>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> Array<'py> {
        let nv = self.scene.nv();
        let inputs = [Input::new("q", q, self.scene.nq())?, Input::new("qd", qd, nv)?, Input::new("qdd", qdd, nv)?];
        let wrenches = Wrench::read(&self.scene, wrenches)?;
        let call = Call::new(self, inputs, wrenches, cost::INVERSE * self.size())?;
        call.algorithm(py, Algorithm::InverseDynamics, &[nv], out)
    }

    /// The bias torque H phi b: what the joints must give so that none accelerates, gravity included.
    ///
    /// q: (..., nq); qd: (..., nv); leading axes broadcast. Returns (..., nv), N m or N.
    ///
    /// Raises `ShapeError`, `NotFiniteError`, `ArgumentError`, each naming the argument and the state.
    #[pyo3(signature = (q, qd))]
    fn bias_torque<'py>(&self, py: Python<'py>, q: &Bound<'py, PyAny>, qd: &Bound<'py, PyAny>) -> Array<'py> {
        let nv = self.scene.nv();
        let inputs = [Input::new("q", q, self.scene.nq())?, Input::new("qd", qd, nv)?];
        let call = Call::new(self, inputs, Vec::new(), cost::INVERSE * self.size())?;
        call.algorithm(py, Algorithm::BiasTorque, &[nv], None)
    }

    /// The joint-space mass matrix, the covariance of the measurements (5.1), armature on its diagonal.
    ///
    /// q: (..., nq). Returns (..., nv, nv), full and exactly symmetric, SI units.
    ///
    /// Raises `ArgumentError` above 4000 degrees of freedom: `inverse_dynamics` multiplies by the matrix without forming it.
    /// Raises `ShapeError`, `NotFiniteError`, `ArgumentError` for a bad q, naming the state.
    #[pyo3(signature = (q))]
    fn mass_matrix<'py>(&self, py: Python<'py>, q: &Bound<'py, PyAny>) -> Array<'py> {
        self.check_dense("mass_matrix", "inverse_dynamics, which multiplies by it")?;
        let nv = self.scene.nv();
        let inputs = [Input::new("q", q, self.scene.nq())?];
        let call = Call::new(self, inputs, Vec::new(), cost::COMPOSITE * self.size() + cost::ENTRY * nv * nv)?;
        call.algorithm(py, Algorithm::MassMatrix, &[nv, nv], None)
    }

    /// The inverse of the mass matrix in closed form (6.1), without forming or factoring the matrix.
    ///
    /// q: (..., nq). form: as in `forward_dynamics`. Returns (..., nv, nv), full and exactly symmetric, SI units.
    ///
    /// Raises `ArgumentError` above 4000 degrees of freedom: `forward_dynamics` multiplies by the inverse without forming it.
    /// Raises `SingularJointError`, `ShapeError`, `NotFiniteError`, `ArgumentError`, naming the state.
    #[pyo3(signature = (q, *, form="auto"))]
    fn mass_matrix_inverse<'py>(&self, py: Python<'py>, q: &Bound<'py, PyAny>, form: &str) -> Array<'py> {
        let form = read_form(form)?;
        self.check_dense("mass_matrix_inverse", "forward_dynamics, which multiplies by it")?;
        let nv = self.scene.nv();
        let inputs = [Input::new("q", q, self.scene.nq())?];
        let call = Call::new(self, inputs, Vec::new(), cost::CLOSED_FORM * self.size() + cost::ENTRY * nv * nv)?;
        call.algorithm(py, Algorithm::MassMatrixInverse(form), &[nv, nv], None)
    }
}

impl PyScene {
    fn check_dense(&self, method: &str, instead: &str) -> Result<(), Error> {
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

/// The form of that name.
pub(super) fn read_form(form: &str) -> Result<Form, Error> {
    choose("form", form, &FORMS)
}
