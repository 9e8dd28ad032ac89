//! Methods of `Scene`: its mass, its mass centre, and the momentum about it.

use super::object::Object;
use super::scene::PyScene;
use crate::algorithm::KinematicQuantity;
use pyo3::prelude::*;

/// Rough time of one body in one state, ns.
mod cost {
    pub const CENTRE: usize = 40;
    pub const MOTION: usize = 80;
    pub const MATRIX: usize = 100;
    pub const RATE: usize = 200;
}

#[pymethods]
impl PyScene {
    /// Mass of all links that move, kg: those on fixed joints to them included, links on the base not, nor rotors (armature is no mass).
    #[getter]
    fn total_mass(&self) -> f64 {
        self.scene.total_mass()
    }

    /// The mass centre of all links that move, in the base frame.
    ///
    /// q: (..., nq). Returns (..., 3), m, from the base's origin. O(N). Links on the base are not part of it.
    ///
    /// errors: as in forward_dynamics. Raises ArgumentError where nothing that moves has mass; ShapeError, NotFiniteError, ArgumentError for a bad q,
    /// naming the state.
    #[pyo3(signature = (q, *, errors="raise"))]
    fn center_of_mass<'py>(&self, py: Python<'py>, q: &Object<'py>, errors: &str) -> PyResult<Object<'py>> {
        self.scene.check_has_mass()?;
        let size = (&[3][..], cost::CENTRE * self.size());
        self.kinematic_quantity(py, &KinematicQuantity::CenterOfMass, [("q", q)], size, errors)
    }

    /// The velocity of the mass centre in the base's axes: linear momentum by mass.
    ///
    /// q: (..., nq); qd: (..., nv); leading axes broadcast. Returns (..., 3), m/s. O(N).
    ///
    /// errors: as in forward_dynamics. Raises as center_of_mass, naming the argument.
    #[pyo3(signature = (q, qd, *, errors="raise"))]
    fn center_of_mass_velocity<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        self.scene.check_has_mass()?;
        let (given, cost) = ([("q", q), ("qd", qd)], cost::MOTION * self.size());
        self.kinematic_quantity(py, &KinematicQuantity::CenterOfMassVelocity, given, (&[3], cost), errors)
    }

    /// The acceleration of the mass centre in the base's axes, at joint accelerations qdd; gravity is not in it.
    ///
    /// q: (..., nq); qd, qdd: (..., nv); leading axes broadcast. Returns (..., 3), m/s^2: times total_mass it is the force from outside, weight included,
    /// that such a motion takes. O(N).
    ///
    /// errors: as in forward_dynamics. Raises as center_of_mass, naming the argument.
    #[pyo3(signature = (q, qd, qdd, *, errors="raise"))]
    fn center_of_mass_acceleration<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        qdd: &Object<'py>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        self.scene.check_has_mass()?;
        let (given, cost) = ([("q", q), ("qd", qd), ("qdd", qdd)], cost::MOTION * self.size());
        self.kinematic_quantity(py, &KinematicQuantity::CenterOfMassAcceleration, given, (&[3], cost), errors)
    }

    /// The Jacobian J of the mass centre: its velocity in the base's axes is J qd.
    ///
    /// q: (..., nq). Returns (..., 3, nv), SI units: the linear rows of centroidal_momentum_matrix by mass. O(N).
    ///
    /// errors: as in forward_dynamics. Raises as center_of_mass.
    #[pyo3(signature = (q, *, errors="raise"))]
    fn center_of_mass_jacobian<'py>(&self, py: Python<'py>, q: &Object<'py>, errors: &str) -> PyResult<Object<'py>> {
        self.scene.check_has_mass()?;
        let (shape, cost) = ([3, self.scene.nv()], cost::MATRIX * self.size());
        self.kinematic_quantity(py, &KinematicQuantity::CenterOfMassJacobian, [("q", q)], (&shape, cost), errors)
    }

    /// The centroidal momentum matrix A: the momentum of all links that move, (angular about the mass centre, linear) in the base's axes, is A qd.
    ///
    /// q: (..., nq). Returns (..., 6, nv), SI units. O(N): column j is r S of the composite inertia (3.5) of what is outboard of joint j. Armature adds
    /// nothing. Rows are angular, then linear; Pinocchio's Ag has (linear, angular).
    ///
    /// errors: as in forward_dynamics. Raises as center_of_mass.
    #[pyo3(signature = (q, *, errors="raise"))]
    fn centroidal_momentum_matrix<'py>(&self, py: Python<'py>, q: &Object<'py>, errors: &str) -> PyResult<Object<'py>> {
        self.scene.check_has_mass()?;
        let (shape, cost) = ([6, self.scene.nv()], cost::MATRIX * self.size());
        self.kinematic_quantity(py, &KinematicQuantity::CentroidalMomentumMatrix, [("q", q)], (&shape, cost), errors)
    }

    /// The rate A' of the centroidal momentum matrix along qd: the momentum about the mass centre changes at A qdd + A' qd.
    ///
    /// q: (..., nq); qd: (..., nv); leading axes broadcast. Returns (..., 6, nv), SI units, rows as those of A. O(N). For a tree that floats that is
    /// weight and wrenches, the moment about the mass centre.
    ///
    /// errors: as in forward_dynamics. Raises as center_of_mass, naming the argument.
    #[pyo3(signature = (q, qd, *, errors="raise"))]
    fn centroidal_momentum_matrix_rate<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        self.scene.check_has_mass()?;
        let (given, shape) = ([("q", q), ("qd", qd)], [6, self.scene.nv()]);
        let size = (&shape[..], cost::RATE * self.size());
        self.kinematic_quantity(py, &KinematicQuantity::CentroidalMomentumMatrixRate, given, size, errors)
    }
}
