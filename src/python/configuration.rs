//! Methods of `Scene`: configurations as a manifold, and limits.

use super::object::{Object, imported};
use super::output::{Array, from_numbers};
use super::scene::PyScene;
use crate::scene::Limits;
use pyo3::prelude::*;

/// Rough time of one body in one state, ns.
const COST: usize = 30;

#[pymethods]
impl PyScene {
    /// The neutral configuration, (nq,): zero everywhere, the identity (0, 0, 0, 1) for quaternions.
    #[pyo3(signature = ())]
    fn neutral<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        from_numbers(py, &self.scene.neutral(), &[self.scene.nq()])
    }

    /// The configuration reached from q by the constant velocity v in unit time, on the manifold.
    ///
    /// q: (..., nq); v: (..., nv); leading axes broadcast. Returns (..., nq), quaternions of unit norm. A free joint moves
    /// along the screw of its twist, a spherical joint turns about its rate, all others add.
    ///
    /// errors: as in forward_dynamics. Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q, v, *, errors="raise"))]
    fn integrate<'py>(&self, py: Python<'py>, q: &Object<'py>, v: &Object<'py>, errors: &str) -> Array<'py> {
        let inputs = [self.configuration("q", q)?, self.rate("v", v)?];
        let call = self.call(inputs, COST * self.size(), errors)?;
        call.array(py, &[self.scene.nq()], |scene, _, [q, v], out| scene.integrate(q, v, out))
    }

    /// The velocity that takes q0 to q1 in unit time, the inverse of integrate; rotations go the short way.
    ///
    /// q0, q1: (..., nq); leading axes broadcast. Returns (..., nv), SI units.
    ///
    /// errors: as in forward_dynamics. Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q0, q1, *, errors="raise"))]
    fn difference<'py>(&self, py: Python<'py>, q0: &Object<'py>, q1: &Object<'py>, errors: &str) -> Array<'py> {
        let inputs = [self.configuration("q0", q0)?, self.configuration("q1", q1)?];
        let call = self.call(inputs, COST * self.size(), errors)?;
        call.array(py, &[self.scene.nv()], |scene, _, [q0, q1], out| scene.difference(q0, q1, out))
    }

    /// Limits by degree of freedom, as the named tuple Limits(lower, upper, velocity, effort) of arrays (nv,).
    ///
    /// rad or m, rad/s or m/s, N m or N; infinite where there is none; a joint of several degrees of freedom repeats its own.
    /// Positions are stops in simulations (limits="report" switches them off); velocity and effort are reported only.
    #[getter]
    fn limits<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        let column = |of: fn(&Limits) -> f64| {
            let joints = self.scene.joints().iter();
            let numbers: Vec<f64> =
                joints.flat_map(|joint| std::iter::repeat_n(of(&joint.limits), joint.v.len())).collect();
            from_numbers(py, &numbers, &[self.scene.nv()])
        };
        let (lower, upper) = (column(|limits| limits.lower)?, column(|limits| limits.upper)?);
        let (velocity, effort) = (column(|limits| limits.velocity)?, column(|limits| limits.effort)?);
        imported!(py, "phipsi._results", "Limits")?.call1((lower, upper, velocity, effort))
    }
}
