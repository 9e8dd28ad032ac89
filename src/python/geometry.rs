//! Methods of `Scene`: where all links are, energy and momentum.

use super::errors::asked_by;
use super::object::{Object, imported};
use super::output::Output;
use super::scene::PyScene;
use crate::algorithm::KinematicQuantity;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Rough time of one body (or link) in one state, ns.
mod cost {
    pub const PLACEMENT: usize = 60;
    pub const ENERGY: usize = 100;
    pub const MOMENTUM: usize = 60;
}

#[pymethods]
impl PyScene {
    /// Where every link is: a dict from link names to homogeneous matrices, link frame to base frame.
    ///
    /// q: (..., nq). Each value: (..., 4, 4), [[R, p], [0, 1]] with p in m; an array of its own, in the order of link_names.
    ///
    /// errors: as in forward_dynamics. Raises ShapeError, NotFiniteError, ArgumentError for a bad q, naming the state.
    #[pyo3(signature = (q, *, errors="raise"))]
    fn placements<'py>(&self, py: Python<'py>, q: &Object<'py>, errors: &str) -> PyResult<Bound<'py, PyDict>> {
        let links = self.scene.links();
        let call = self.call([self.configuration("q", q)?], cost::PLACEMENT * (self.size() + links.len()), errors)?;
        let mut all = call.scratch_results(py, 16 * links.len())?;
        call.numbers(py, all.numbers()?, |scene, _, [q], out| {
            for (shift, out) in scene.placements(q)?.iter().zip(out.chunks_exact_mut(16)) {
                shift.homogeneous(out);
            }
            Ok(())
        })?;
        let shape = [&call.batch[..], &[4, 4]].concat();
        let placements = PyDict::new(py);
        for (at, link) in links.iter().enumerate() {
            let mut output = asked_by(py, &call.asking(), Output::new(py, &shape))?;
            output.gather(py, 16, all.numbers()?.chunks_exact(16).skip(at).step_by(links.len()))?;
            placements.set_item(&link.name, output.finish())?;
        }
        Ok(placements)
    }

    /// Kinetic energy (armature included) and potential energy, as the named tuple Energy(kinetic, potential).
    ///
    /// q: (..., nq); qd: (..., nv); leading axes broadcast. Each (...), J; the potential is zero with the mass centre at the
    /// base's origin.
    ///
    /// errors: as in forward_dynamics. Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q, qd, *, errors="raise"))]
    fn energy<'py>(&self, py: Python<'py>, q: &Object<'py>, qd: &Object<'py>, errors: &str) -> PyResult<Object<'py>> {
        let inputs = [self.configuration("q", q)?, self.rate("qd", qd)?];
        let call = self.call(inputs, cost::ENERGY * self.size(), errors)?;
        let mut both = call.scratch_results(py, 2)?;
        call.quantity_in_chunks(py, &KinematicQuantity::Energy, both.numbers()?)?;
        let mut part = |which: usize| {
            let mut output = asked_by(py, &call.asking(), Output::new(py, &call.batch))?;
            output.gather(py, 1, both.numbers()?.chunks_exact(2).map(|state| &state[which..=which]))?;
            output.finish_or_scalar()
        };
        imported!(py, "phipsi._results", "Energy")?.call1((part(0)?, part(1)?))
    }

    /// Kinetic energy alone, armature included: half of qd M qd.
    ///
    /// q: (..., nq); qd: (..., nv); leading axes broadcast. Returns (...), J. O(N).
    ///
    /// errors: as in forward_dynamics. Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q, qd, *, errors="raise"))]
    fn kinetic_energy<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        let cost = cost::MOMENTUM * self.size();
        self.kinematic_quantity(py, &KinematicQuantity::KineticEnergy, [("q", q), ("qd", qd)], (&[], cost), errors)
    }

    /// Spatial momentum of all moving bodies: (angular about the base's origin, linear), in the base frame.
    ///
    /// q: (..., nq); qd: (..., nv); leading axes broadcast. Returns (..., 6), N m s and N s. Armature adds nothing here.
    ///
    /// errors: as in forward_dynamics. Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q, qd, *, errors="raise"))]
    fn momentum<'py>(&self, py: Python<'py>, q: &Object<'py>, qd: &Object<'py>, errors: &str) -> PyResult<Object<'py>> {
        let size = (&[6][..], cost::MOMENTUM * self.size());
        self.kinematic_quantity(py, &KinematicQuantity::Momentum, [("q", q), ("qd", qd)], size, errors)
    }
}
