//! Methods of `Scene`: derivatives of the dynamics, and the linear system of small deviations.

use super::bad_states::Errors;
use super::call::Call;
use super::choice::read_form;
use super::cost::Cost;
use super::errors::asked_by;
use super::object::{Object, imported};
use super::output::Output;
use super::scene::PyScene;
use super::scratch::Scratch;
use super::wrenches::Wrench;
use crate::dynamics::derivatives::{ForwardDerivatives, InverseDerivatives};
use crate::error::Error;
use crate::scene::Scene;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// Rough times in one state, ns (see [`Cost`]).
mod cost {
    /// Of one body: its motion, its composite and what it lets others feel.
    pub const BODY: usize = 150;
    /// The same with the factor of M.
    pub const WITH_FACTOR: usize = 500;
    /// Of two degrees of freedom: their entries of the results.
    pub const PAIR: usize = 60;
}

/// What names a state: q, qd, and the third with its name.
type State<'a, 'py> = (&'a Object<'py>, &'a Object<'py>, (&'static str, &'a Object<'py>));

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
    /// Returns a phipsi.InverseDynamicsDerivatives (dtau_dq, dtau_dqd, M), each (..., nv, nv), SI units.
    ///
    /// Raises ArgumentError above 4000 degrees of freedom; ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q, qd, qdd, *, wrenches=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn inverse_dynamics_derivatives<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        qdd: &Object<'py>,
        wrenches: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        self.check_dense("inverse_dynamics_derivatives", "differences of inverse_dynamics")?;
        let nv = self.scene.nv();
        let class = imported!(py, "phipsi._results", "InverseDynamicsDerivatives")?;
        let call = self.derivative_call((q, qd, ("qdd", qdd)), wrenches, (self.errors(errors, None)?, cost::BODY))?;
        call.matrices(py, class, &[[nv, nv]; 3], |scene, scratch, [q, qd, qdd], [dtau_dq, dtau_dqd, mass_matrix]| {
            let (workspace, derivatives, forces) = scratch.for_derivatives(scene);
            let mut out = InverseDerivatives { dtau_dq, dtau_dqd, mass_matrix };
            scene.inverse_dynamics_derivatives(workspace, derivatives, q, qd, qdd, forces, &mut out)
        })
    }

    /// Derivatives of forward dynamics, in the tangent space of q: dqdd/dq = -M^-1 dtau/dq, dqdd/dqd = -M^-1 dtau/dqd and dqdd/dtau = M^-1.
    ///
    /// q: (..., nq); qd, tau: (..., nv); SI units, radians; leading axes broadcast. form, wrenches and errors: as in forward_dynamics; wrenches stay as
    /// they are in their link's frame. In form "auto" a state whose digits cancel, by an estimate down to 1e-9 of the largest entry, is done with twice the
    /// digits, some thirty times as long.
    ///
    /// Row i is the acceleration qdd_i; columns as in inverse_dynamics_derivatives, whose results at the accelerations of the state are multiplied by
    /// M^-1 (6.1).
    ///
    /// Returns a phipsi.ForwardDynamicsDerivatives (dqdd_dq, dqdd_dqd, Minv), each (..., nv, nv), SI units.
    ///
    /// Raises SingularJointError where a joint has no inertia along its axis; ArgumentError above 4000 degrees of freedom, and for the square-root form
    /// of an inertia that no body can have; ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q, qd, tau, *, form="auto", wrenches=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn forward_dynamics_derivatives<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        tau: &Object<'py>,
        form: &str,
        wrenches: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        self.check_dense("forward_dynamics_derivatives", "differences of forward_dynamics")?;
        let (form, nv) = (read_form(form)?, self.scene.nv());
        let class = imported!(py, "phipsi._results", "ForwardDynamicsDerivatives")?;
        let choices = (self.errors(errors, Some(form))?, cost::WITH_FACTOR);
        let call = self.derivative_call((q, qd, ("tau", tau)), wrenches, choices)?;
        call.matrices(py, class, &[[nv, nv]; 3], |scene, scratch, [q, qd, tau], out| {
            let [dqdd_dq, dqdd_dqd, mass_matrix_inverse] = out;
            let (workspace, derivatives, forces) = scratch.for_derivatives(scene);
            workspace.form = form;
            let mut out = ForwardDerivatives { dqdd_dq, dqdd_dqd, mass_matrix_inverse };
            scene.forward_dynamics_derivatives(workspace, derivatives, q, qd, tau, forces, &mut out)
        })
    }

    /// The linear system dx/dt = A x + B u of small deviations from the motion through a state, x = (tangent of q, change of qd), u a change of tau.
    ///
    /// q: (..., nq); qd, tau: (..., nv); SI units, radians; leading axes broadcast. form, wrenches and errors: as in forward_dynamics_derivatives.
    ///
    /// A = [[-ad(qd), 1], [dqdd_dq, dqdd_dqd]], B = [[0], [M^-1]]. ad(qd) is zero at rest and for joints of one axis; it is the cross product by the
    /// angular velocity for spherical joints, and the bracket of (linear, angular) velocities for free joints, since the deviation is in axes that turn
    /// with the motion: difference(q, q of the neighbour).
    ///
    /// Returns a phipsi.LinearSystem (A, B), (..., 2 nv, 2 nv) and (..., 2 nv, nv), in continuous time, SI units.
    ///
    /// Raises as forward_dynamics_derivatives.
    #[pyo3(signature = (q, qd, tau, *, form="auto", wrenches=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn linearize<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        tau: &Object<'py>,
        form: &str,
        wrenches: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        self.check_dense("linearize", "differences of forward_dynamics")?;
        let (form, nv) = (read_form(form)?, self.scene.nv());
        let class = imported!(py, "phipsi._results", "LinearSystem")?;
        let choices = (self.errors(errors, Some(form))?, cost::WITH_FACTOR);
        let call = self.derivative_call((q, qd, ("tau", tau)), wrenches, choices)?;
        call.matrices(py, class, &[[2 * nv, 2 * nv], [2 * nv, nv]], |scene, scratch, [q, qd, tau], [a, b]| {
            let (workspace, derivatives, forces) = scratch.for_derivatives(scene);
            workspace.form = form;
            scene.linearize(workspace, derivatives, q, qd, tau, forces, (a, b))
        })
    }
}

impl PyScene {
    /// A call on whole states, of so many ns a body beside the pairs.
    fn derivative_call<'a, 'py>(
        &'a self,
        (q, qd, (name, u)): State<'_, 'py>,
        wrenches: Option<&Object<'py>>,
        (errors, body): (Errors, usize),
    ) -> PyResult<Call<'a, 'py>> {
        let inputs = vec![self.configuration("q", q)?, self.rate("qd", qd)?, self.rate(name, u)?];
        let nv = self.scene.nv();
        let cost = body * self.size() + cost::PAIR.saturating_mul(nv.saturating_mul(nv));
        Ok(Call::new(self, inputs, Wrench::read(&self.scene, wrenches)?, Cost::of(cost))?.with(errors))
    }
}

impl<'py> Call<'_, 'py> {
    /// Evaluates every state into several matrices, and makes a named tuple of them; shapes are those of one state.
    fn matrices<K, const N: usize, const M: usize>(
        &self,
        py: Python<'py>,
        class: &Object<'py>,
        shapes: &[[usize; 2]; M],
        kernel: K,
    ) -> PyResult<Object<'py>>
    where
        K: Fn(&Scene, &mut Scratch, [&[f64]; N], [&mut [f64]; M]) -> Result<(), Error> + Sync,
    {
        let sizes = shapes.map(|[rows, columns]| rows * columns);
        let width = sizes.iter().sum();
        let mut results = self.scratch_results(py, width)?;
        self.numbers(py, results.numbers()?, |scene, scratch, arguments, out| {
            let mut rest = out;
            kernel(
                scene,
                scratch,
                arguments,
                sizes.map(|size| {
                    let (first, others) = std::mem::take(&mut rest).split_at_mut(size);
                    rest = others;
                    first
                }),
            )
        })?;
        let results = results.numbers()?;
        let mut at = 0;
        let mut made = Vec::with_capacity(M);
        for (shape, size) in shapes.iter().zip(sizes) {
            let gathered = Output::unwritten(py, &[&self.batch[..], shape].concat()).and_then(|mut output| {
                let states = results.chunks_exact(width.max(1));
                output.gather(py, size, states.map(|state| &state[at..at + size]))?;
                Ok(output.finish())
            });
            made.push(asked_by(py, &self.asking(), gathered)?);
            at += size;
        }
        class.call1(PyTuple::new(py, made)?)
    }
}
