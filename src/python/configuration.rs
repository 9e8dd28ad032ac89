//! Methods of `Scene`: configurations on the manifold, and joint limits.

use super::description::limits_as_array;
use super::object::{Object, imported};
use super::output::{from_numbers, property};
use super::scene::PyScene;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// Approximate time per body and state, ns.
const COST: usize = 30;

methods! {
    /// Configuration that the constant joint velocity v reaches from q in unit time, on the manifold.
    #[doc = parameters!(q)]
    /// v : (..., nv) array_like
    ///     Displacement in the tangent space of q, rad or m.
    #[doc = entries!(errors)]
    #[doc = section!(Returns)]
    /// q : (..., nq) ndarray
    ///     Joint positions, with quaternions of unit norm.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// A free joint moves along the screw motion of its twist, a spherical joint rotates about its angular velocity,
    /// and the coordinates of all other joints are added.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> scene.integrate([0.3, 0.2, 0.1], [0.1, 0.0, 0.0])
    /// array([0.4, 0.2, 0.1])
    fn integrate(q, v; errors) |scene, py| {
        let (shape, cost) = ([scene.scene.nq()], COST * scene.size());
        scene.each(py, [("q", q), ("v", v)], &shape, cost, errors, |scene, _, [q, v], out| scene.integrate(q, v, out))
    }

    /// Joint velocity that moves q0 to q1 in unit time, the inverse of integrate, on the manifold.
    #[doc = section!(Parameters)]
    /// q0 : (..., nq) array_like
    ///     Joint positions at the start, rad or m.
    /// q1 : (..., nq) array_like
    ///     Joint positions at the end, rad or m.
    #[doc = entries!(errors)]
    #[doc = section!(Returns)]
    /// v : (..., nv) ndarray
    ///     Displacement in the tangent space of q0, rad or m. Rotations take the shorter way.
    #[doc = raises!(arguments)]
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> scene.difference([0.3, 0.2, 0.1], [0.5, 0.2, 0.1]).round(3)
    /// array([0.2, 0. , 0. ])
    fn difference(q0, q1; errors) |scene, py| {
        let inputs = [scene.configuration("q0", q0)?, scene.configuration("q1", q1)?];
        let call = scene.call(inputs, COST * scene.size(), errors)?;
        call.array(py, &[scene.scene.nv()], |scene, _, [q0, q1], out| scene.difference(q0, q1, out)).map(Bound::into_any)
    }
}

#[pymethods]
impl PyScene {
    /// Neutral configuration: zero everywhere, and the identity (0, 0, 0, 1) for quaternions.
    #[doc = section!(Returns)]
    /// q : (nq,) ndarray
    ///     Joint positions, rad or m.
    #[doc = section!(Examples)]
    /// >>> phipsi.scenes.chain(3).neutral()
    /// array([0., 0., 0.])
    fn neutral<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        from_numbers(py, &self.scene.neutral(), &[self.scene.nq()])
    }

    /// Joint limits per degree of freedom, as phipsi.Limits with fields of shape (nv,), read-only; infinite for none.
    ///
    /// The fields are lower, upper (rad or m), velocity, effort (N m or N), acceleration, deceleration and jerk. A
    /// joint of several degrees of freedom repeats its limits. Position limits are stops in simulations, unless
    /// limits="report"; limits of effort are those of PD(effort=True) and effort="clip". The others are reported only.
    #[getter]
    fn limits<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        let joints = self.scene.joints().iter();
        let rows = joints.flat_map(|joint| std::iter::repeat_n(limits_as_array(&joint.limits), joint.v.len()));
        let rows: Vec<[f64; 7]> = rows.collect();
        let column = |at: usize| property(py, &rows.iter().map(|row| row[at]).collect::<Vec<_>>(), &[rows.len()]);
        let columns = (0..7).map(column).collect::<PyResult<Vec<_>>>()?;
        imported!(py, "phipsi._results", "Limits")?.call1(PyTuple::new(py, columns)?)
    }
}
