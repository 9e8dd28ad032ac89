//! Methods of `Scene`: derivatives of the dynamics, and the linear system of small deviations.

use super::call::Call;
use super::choice::read_form;
use super::cost::Cost;
use super::errors::asked_by;
use super::evaluate::Keywords;
use super::object::{Object, imported};
use super::output::{Output, part};
use super::scene::PyScene;
use super::wrenches::Wrench;
use crate::algorithm::{Algorithm, Derivatives};
use numpy::{PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// Linear systems between two looks at signals.
const AT_A_TIME: usize = 1024;

/// Rough times in one state, ns (see [`Cost`](super::cost::Cost)).
mod cost {
    /// Of one body: its motion, its composite and what it lets others feel.
    pub const BODY: usize = 80;
    /// The same with the factor of M.
    pub const WITH_FACTOR: usize = 200;
    /// Of two degrees of freedom: their entries of the results.
    pub const PAIR: usize = 10;
}

#[pymethods]
impl PyScene {
    /// Derivatives of inverse dynamics, in the tangent space of q: dtau/dq, dtau/dqd and dtau/dqdd = M, analytic, in O(N depth).
    ///
    /// q: (..., nq); qd, qdd: (..., nv); SI units, radians; leading axes broadcast. wrenches and errors: as in forward_dynamics; they stay as they
    /// are in their link's frame.
    ///
    /// Row i is the torque tau_i. Column j of dtau_dq is the derivative along integrate(q, v) by v_j: an angle or a length for joints of one axis, a
    /// rotation in the child's frame for spherical joints, (linear, angular) in the child's frame for free joints. Armature is in M alone. Entries of
    /// joints on different branches are zero.
    ///
    /// out: C-contiguous float64, (..., 3, nv, nv), overlapping no argument, of which the results are views; large batches take half the time into one that was
    /// used before.
    ///
    /// Returns a phipsi.InverseDynamicsDerivatives (dtau_dq, dtau_dqd, M), each (..., nv, nv), SI units.
    ///
    /// Raises ArgumentError above 4000 degrees of freedom; ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q, qd, qdd, *, wrenches=None, out=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn inverse_dynamics_derivatives<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        qdd: &Object<'py>,
        wrenches: Option<&Object<'py>>,
        out: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        self.check_dense("inverse_dynamics_derivatives", "differences of inverse_dynamics")?;
        let class = imported!(py, "phipsi._results", "InverseDynamicsDerivatives")?;
        let keywords = Keywords { wrenches, out, dtype: None, errors, tolerance: None, info: false };
        let given = [("q", q), ("qd", qd), ("qdd", qdd)];
        let all = self.derivatives(py, Derivatives::InverseDynamics, cost::BODY, given, &keywords)?;
        class.call1((part(&all, 2, 0)?, part(&all, 2, 1)?, part(&all, 2, 2)?))
    }

    /// Derivatives of forward dynamics, in the tangent space of q: dqdd/dq = -M^-1 dtau/dq, dqdd/dqd = -M^-1 dtau/dqd and dqdd/dtau = M^-1.
    ///
    /// q: (..., nq); qd, tau: (..., nv); SI units, radians; leading axes broadcast. form, wrenches and errors: as in forward_dynamics; wrenches stay as
    /// they are in their link's frame. In form "auto" a state is recomputed in double-double arithmetic, which takes some thirty times as long, where the error of
    /// the factor of M exceeds the tolerance of forward_dynamics, or the estimated error of a derivative 1e-11 of its largest entry. tolerance: replaces both.
    ///
    /// Row i is the acceleration qdd_i; columns as in inverse_dynamics_derivatives, whose results at the accelerations of the state are multiplied by
    /// M^-1 (6.1).
    ///
    /// out: as in inverse_dynamics_derivatives.
    ///
    /// Returns a phipsi.ForwardDynamicsDerivatives (dqdd_dq, dqdd_dqd, Minv), each (..., nv, nv), SI units.
    ///
    /// Raises SingularJointError where a joint has no inertia along its axis; ArgumentError above 4000 degrees of freedom, and for the square-root form
    /// of an inertia that no body can have; ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q, qd, tau, *, form="auto", tolerance=None, wrenches=None, out=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn forward_dynamics_derivatives<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        tau: &Object<'py>,
        form: &str,
        tolerance: Option<f64>,
        wrenches: Option<&Object<'py>>,
        out: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        self.check_dense("forward_dynamics_derivatives", "differences of forward_dynamics")?;
        let which = Derivatives::ForwardDynamics(read_form(form)?);
        self.scene.check_tolerance(Algorithm::Derivatives(which), tolerance)?;
        let class = imported!(py, "phipsi._results", "ForwardDynamicsDerivatives")?;
        let keywords = Keywords { wrenches, out, dtype: None, errors, tolerance, info: false };
        let given = [("q", q), ("qd", qd), ("tau", tau)];
        let all = self.derivatives(py, which, cost::WITH_FACTOR, given, &keywords)?;
        class.call1((part(&all, 2, 0)?, part(&all, 2, 1)?, part(&all, 2, 2)?))
    }

    /// The linear system dx/dt = A x + B u of small deviations from the motion through a state, x = (tangent of q, change of qd), u a change of tau.
    ///
    /// q: (..., nq); qd, tau: (..., nv); SI units, radians; leading axes broadcast. form, tolerance, wrenches and errors: as in forward_dynamics_derivatives.
    ///
    /// A = [[-ad(qd), 1], [dqdd_dq, dqdd_dqd]], B = [[0], [M^-1]]. ad(qd) is zero at rest and for joints of one axis; it is the cross product by the
    /// angular velocity for spherical joints, and the bracket of (linear, angular) velocities for free joints, since the deviation is in axes that turn
    /// with the motion: difference(q, q of the neighbour).
    ///
    /// Returns a phipsi.LinearSystem (A, B), (..., 2 nv, 2 nv) and (..., 2 nv, nv), in continuous time, SI units.
    ///
    /// Raises as forward_dynamics_derivatives.
    #[pyo3(signature = (q, qd, tau, *, form="auto", tolerance=None, wrenches=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn linearize<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        tau: &Object<'py>,
        form: &str,
        tolerance: Option<f64>,
        wrenches: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        self.check_dense("linearize", "differences of forward_dynamics")?;
        let which = Derivatives::ForwardDynamics(read_form(form)?);
        self.scene.check_tolerance(Algorithm::Derivatives(which), tolerance)?;
        let class = imported!(py, "phipsi._results", "LinearSystem")?;
        let keywords = Keywords { wrenches, out: None, dtype: None, errors, tolerance, info: false };
        let given = [("q", q), ("qd", qd), ("tau", tau)];
        let all = self.derivatives(py, which, cost::WITH_FACTOR, given, &keywords)?;
        let nv = self.scene.nv();
        let all = all.cast::<PyArrayDyn<f64>>()?.try_readonly()?;
        let batch = &all.shape()[..all.shape().len() - 3];
        let rates = self.rate("qd", qd)?;
        let over = rates.over(batch)?;
        let output = |shape: &[usize]| {
            Output::unwritten(py, &[batch, shape].concat()).or_else(|failed| {
                let inputs = vec![self.configuration::<f64>("q", q)?, self.rate("qd", qd)?, self.rate("tau", tau)?];
                let call = Call::new(self, inputs, Wrench::read(&self.scene, wrenches)?, Cost::of(0))?;
                asked_by(py, &call.asking(), Err(failed))
            })
        };
        let mut outputs = [output(&[2 * nv, 2 * nv])?, output(&[2 * nv, nv])?];
        let [a, b] = &mut outputs;
        if nv > 0 {
            let states = all.as_slice()?.chunks_exact(3 * nv * nv);
            let systems = a.numbers()?.chunks_exact_mut(4 * nv * nv).zip(b.numbers()?.chunks_exact_mut(2 * nv * nv));
            for (i, (of_state, (a, b))) in states.zip(systems).enumerate() {
                // A bad state's, all of it.
                if of_state[0].is_nan() {
                    a.fill(f64::NAN);
                    b.fill(f64::NAN);
                } else {
                    self.scene.linear_system(over.state(i), of_state, (a, b));
                }
                if i % AT_A_TIME == 0 {
                    py.check_signals()?;
                }
            }
        }
        let [a, b] = outputs.map(Output::finish);
        class.call1((a, b))
    }

    /// The Coriolis matrix C: C qd is the torque of the rates alone, and dM/dt - 2 C is antisymmetric.
    ///
    /// q: (..., nq); qd: (..., nv); leading axes broadcast; out and errors as in forward_dynamics. Returns (..., nv, nv), SI units. For joints of one axis it is the one
    /// of Christoffel's symbols. Computed in O(N depth).
    ///
    /// Raises ArgumentError above 4000 degrees of freedom; ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q, qd, *, out=None, errors="raise"))]
    fn coriolis_matrix<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        out: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        self.check_dense("coriolis_matrix", "bias_torque")?;
        let keywords = Keywords { wrenches: None, out, dtype: None, errors, tolerance: None, info: false };
        self.derivatives(py, Derivatives::CoriolisMatrix, cost::BODY, [("q", q), ("qd", qd)], &keywords)
    }

    /// dM/dt, how the mass matrix changes along the rates: C + C^T with the Coriolis matrix C.
    ///
    /// q: (..., nq); qd: (..., nv); leading axes broadcast; out and errors as in forward_dynamics. Returns (..., nv, nv), exactly symmetric, SI units. Armature is
    /// constant and not in it. Computed in O(N depth).
    ///
    /// Raises ArgumentError above 4000 degrees of freedom; ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q, qd, *, out=None, errors="raise"))]
    fn mass_matrix_derivative<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        out: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        self.check_dense("mass_matrix_derivative", "differences of mass_matrix")?;
        let keywords = Keywords { wrenches: None, out, dtype: None, errors, tolerance: None, info: false };
        self.derivatives(py, Derivatives::MassMatrix, cost::BODY, [("q", q), ("qd", qd)], &keywords)
    }
}

impl PyScene {
    /// Evaluates derivatives, of so many ns a body beside those of its pairs.
    fn derivatives<'py, const N: usize>(
        &self,
        py: Python<'py>,
        which: Derivatives,
        body: usize,
        given: [(&'static str, &Object<'py>); N],
        keywords: &Keywords<'_, 'py>,
    ) -> PyResult<Object<'py>> {
        let body = body + cost::PAIR * self.scene.nv();
        self.evaluate(py, Algorithm::Derivatives(which), body, given, keywords)
    }
}
