//! Dynamics of closed kinematic loops (connections) at one state. Each method checks its arguments before it computes.

use crate::algorithm::{Algorithm, Arguments};
use crate::dynamics::constraints::{self, ConstraintScratch, errors_of_rows, jacobian_of_rows};
use crate::error::{Error, check_length, number};
use crate::scene::Scene;
use crate::spatial::SpatialVector;
use crate::workspace::Workspace;

/// Diagnostics of [`Scene::constrained_dynamics`] and [`Scene::constrained_inverse_dynamics`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Constrained {
    /// Rank of the constraint Jacobian: the number of independent rows.
    pub rank: usize,
    /// Largest absolute entry of J qdd + J' qd after the solve, rad/s^2 or m/s^2.
    pub residual: f64,
}

/// Diagnostics of [`Scene::project`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// Rank of the constraint Jacobian at the projected configuration.
    pub rank: usize,
    /// Largest remaining constraint error, m or rad.
    pub error: f64,
    /// Largest remaining constraint velocity, m/s or rad/s; zero if no velocities were given.
    pub rate: f64,
}

/// The `expected` part of the error of a projection that does not converge.
const NEARER: &str = "a start closer to a configuration that satisfies the connections";

impl Scene {
    /// Scratch memory for the methods on connections. Each thread needs its own.
    #[must_use]
    pub fn constraint_scratch(&self) -> ConstraintScratch {
        ConstraintScratch::new(self.model(), self.constraints())
    }

    /// Constraint error of the connections at `q`, written to `out` (m entries).
    ///
    /// Translational rows are in m, in the axes of the connection's first frame. Rotational rows are 2 sin(t/2) times
    /// the rotation axis for a rotation by the angle t, which is t for small angles. Rotational rows precede
    /// translational rows. O(m depth).
    ///
    /// # Errors
    ///
    /// [`Error::Shape`] for a wrong length, [`Error::NotFinite`], and [`Error::Constraint`] for a rod whose end points
    /// coincide, because its direction is then undefined.
    pub fn constraint_error(&self, q: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.check_configuration("q", q)?;
        check_length("out", out.len(), self.constraint_rows())?;
        errors_of_rows(self.model(), self.constraints(), q, out).map_err(|at| self.row_fault(at))?;
        self.check_result("constraint error", out)
    }

    /// Constraint Jacobian J at `q`, (m x nv), row-major, written to `out`.
    ///
    /// J qd is the exact time derivative of [`Scene::constraint_error`] at every `q`. O(m depth), plus clearing `out`.
    ///
    /// # Errors
    ///
    /// As [`Scene::constraint_error`], and [`Error::Argument`] for scratch of another scene.
    pub fn constraint_jacobian(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut ConstraintScratch,
        q: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        self.check_configuration("q", q)?;
        self.check_scratch_of_rows(workspace, scratch)?;
        check_length("out", out.len(), self.constraint_rows() * self.nv())?;
        let (system, rest) = ((self.model(), self.constraints()), std::mem::take(&mut workspace.rest));
        let placed = scratch.rows.place(system.0, workspace, (q, &rest));
        workspace.rest = rest;
        placed.map_err(|at| self.row_fault(at))?;
        jacobian_of_rows(&scratch.rows, system, (&workspace.store.shifts, &mut scratch.state), out);
        self.check_result("constraint jacobian", out)
    }

    /// Constraint bias J' qd, written to `out` (m entries): the second time derivative of [`Scene::constraint_error`]
    /// for zero joint accelerations. O(N + m depth).
    ///
    /// # Errors
    ///
    /// As [`Scene::constraint_jacobian`].
    pub fn constraint_bias(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut ConstraintScratch,
        q: &[f64],
        qd: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        self.check_configuration("q", q)?;
        self.check_rates("qd", qd)?;
        self.check_scratch_of_rows(workspace, scratch)?;
        check_length("out", out.len(), self.constraint_rows())?;
        scratch.rows.place(self.model(), workspace, (q, qd)).map_err(|at| self.row_fault(at))?;
        for (out, row) in out.iter_mut().zip(&scratch.rows.all) {
            *out = row.gamma;
        }
        self.check_result("constraint bias", out)
    }

    /// Joint accelerations `qdd` (nv) and constraint forces (m) for given joint torques.
    ///
    /// Solves M qdd + bias = tau + J^T forces subject to J qdd + J' qd = 0. The force of a row (N m for rotational
    /// rows, N for translational rows) acts on the `link` of the connection, at the origin of the connection's first
    /// frame and in its axes; the opposite force acts on the other link. The force of a rod is positive in compression.
    /// If rows are linearly dependent, the accelerations are still unique, and the forces are those of least sum
    /// `(J M^-1 J^T)_ii forces_i^2`. The factorization form is that of the workspace. O(N + m^2 depth + m^3).
    ///
    /// ```
    /// use phipsi::scene::{Connection, ConnectionKind};
    /// # fn main() -> Result<(), phipsi::Error> {
    /// let mut tip = Connection::new("tip", ConnectionKind::Point, "link2", None);
    /// tip.frame.lever = [0.0, 0.0, 0.3].into();
    /// let scene = phipsi::scenes::chain(3)?.source().clone().connect(tip).build()?;
    /// let (mut workspace, mut scratch) = (scene.workspace(), scene.constraint_scratch());
    /// let (mut qdd, mut forces) = ([f64::NAN; 3], [f64::NAN; 3]);
    /// let (q, zero) = (scene.neutral(), [0.0; 3]);
    /// let results = (&mut qdd[..], &mut forces[..]);
    /// let solved = scene.constrained_dynamics(&mut workspace, &mut scratch, &q, &zero, &zero, &[], results)?;
    /// assert!(solved.rank > 0 && solved.residual < 1e-9);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], [`Error::Argument`] for scratch of another scene,
    /// [`Error::SingularJoint`] of the tree, and [`Error::Constraint`] if a rod's end points coincide, if no forces
    /// satisfy all rows, or if the state violates the connections by more than 1e-3 (m or rad; m/s or rad/s, relative
    /// to the fastest joint velocity if that exceeds 1). [`Scene::project`] computes a state that satisfies them.
    #[allow(clippy::too_many_arguments)] // same arguments as forward dynamics
    pub fn constrained_dynamics(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut ConstraintScratch,
        q: &[f64],
        qd: &[f64],
        tau: &[f64],
        wrenches: &[SpatialVector<f64>],
        (qdd, forces): (&mut [f64], &mut [f64]),
    ) -> Result<Constrained, Error> {
        let (nv, m) = (self.nv(), self.constraint_rows());
        check_length("qdd", qdd.len(), nv)?;
        check_length("forces", forces.len(), m)?;
        self.check_scratch_of_rows(workspace, scratch)?;
        let state = Arguments { q, qd, u: tau, wrenches, ..Arguments::default() };
        let algorithm = Algorithm::ConstrainedDynamics(workspace.form);
        // The results of a scene with coupled joints are shorter than those of its tree.
        scratch.results.resize(self.width(algorithm), f64::NAN);
        self.run_one(workspace, None, algorithm, &state, &mut scratch.results)?;
        let (accelerations, rest) = scratch.results.split_at(nv);
        qdd.copy_from_slice(accelerations);
        forces.copy_from_slice(&rest[..m]);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a small count, stored as f64
        Ok(Constrained { rank: rest[m] as usize, residual: rest[m + 1] })
    }

    /// Projects `q` and `qd` in place onto the configurations and velocities that satisfy the connections.
    ///
    /// Each Newton step -M^-1 J^T G^+ error is the one of least kinetic energy, with G = J M^-1 J^T. The velocity
    /// correction -M^-1 J^T G^+ J qd equals that of a perfectly inelastic impact.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], [`Error::Argument`] for scratch of another scene,
    /// [`Error::SingularJoint`] of the tree, and [`Error::Constraint`] if the iteration ends with a constraint error or
    /// velocity above its tolerance.
    pub fn project(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut ConstraintScratch,
        q: &mut [f64],
        qd: Option<&mut [f64]>,
    ) -> Result<Projection, Error> {
        self.project_compliant(workspace, scratch, q, qd, &[])
    }

    /// [`Scene::project`] with a `compliance` per row (m entries, each zero or positive; empty for none).
    ///
    /// Minimizes half the squared distance from the start, measured by kinetic energy, plus the sum of error^2 / (2
    /// compliance). At the solution, the error and the velocity of a row are -compliance times its multiplier.
    ///
    /// # Errors
    ///
    /// As [`Scene::project`], and [`Error::Argument`] for a compliance that is negative or not finite.
    pub fn project_compliant(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut ConstraintScratch,
        q: &mut [f64],
        qd: Option<&mut [f64]>,
        compliance: &[f64],
    ) -> Result<Projection, Error> {
        self.check_compliance(compliance)?;
        self.check_configuration("q", q)?;
        if let Some(qd) = &qd {
            self.check_rates("qd", qd)?;
        }
        self.check_scratch_of_rows(workspace, scratch)?;
        self.check_form(workspace)?;
        let system = (self.model(), self.constraints());
        let positions = constraints::project_positions(system, workspace, scratch, (q, compliance), None)
            .map_err(|at| self.row_fault(at))?;
        self.check_pivots(workspace, positions.pivots)?;
        if let Some(row) = positions.stays {
            return Err(self.open_at("q", row, positions.left, "m or rad", NEARER));
        }
        let mut rest = Vec::new();
        let qd = qd.unwrap_or_else(|| {
            rest.resize(self.nv(), 0.0);
            &mut rest
        });
        let velocities = constraints::project_velocities(system, workspace, scratch, (q, qd), compliance)
            .map_err(|at| self.row_fault(at))?;
        self.check_pivots(workspace, velocities.pivots)?;
        if let Some(row) = velocities.stays {
            return Err(self.open_at("qd", row, velocities.left, "m/s or rad/s", NEARER));
        }
        self.check_result("qd", qd)?;
        Ok(Projection { rank: velocities.rank, error: positions.left, rate: velocities.left })
    }

    /// Joint torques `tau` (nv) and constraint forces (m) for given joint accelerations `qdd`.
    ///
    /// Solves tau + J^T forces = M qdd + bias with tau = 0 at joints that are not `actuated` (nv entries; empty if all
    /// are actuated). If the solution is not unique, tau is the one with the least tau^T M^-1 tau, which does not load
    /// the connections. The residual reports whether `qdd` satisfies the connections.
    ///
    /// # Errors
    ///
    /// As [`Scene::constrained_dynamics`], and [`Error::Argument`] if an unactuated joint would need a torque.
    #[allow(clippy::too_many_arguments)] // same arguments as inverse dynamics
    pub fn constrained_inverse_dynamics(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut ConstraintScratch,
        q: &[f64],
        qd: &[f64],
        qdd: &[f64],
        wrenches: &[SpatialVector<f64>],
        actuated: &[bool],
        (tau, forces): (&mut [f64], &mut [f64]),
    ) -> Result<Constrained, Error> {
        self.check_configuration("q", q)?;
        self.check_rates("qd", qd)?;
        self.check_rates("qdd", qdd)?;
        self.check_wrenches(wrenches)?;
        check_length("tau", tau.len(), self.nv())?;
        check_length("forces", forces.len(), self.constraint_rows())?;
        let all = vec![true; self.nv()];
        let actuated = if actuated.is_empty() { &all } else { actuated };
        check_length("actuated", actuated.len(), self.nv())?;
        self.check_scratch_of_rows(workspace, scratch)?;
        self.check_form(workspace)?;
        let (system, state) = ((self.model(), self.constraints()), (q, qd, qdd));
        let outcome =
            constraints::constrained_inverse_dynamics(system, workspace, scratch, state, wrenches, actuated, tau)
                .map_err(|at| self.row_fault(at))?;
        self.check_pivots(workspace, outcome.pivots)?;
        self.check_closed_rows(&scratch.rows, (q, qd))?;
        self.check_result("tau", tau)?;
        self.check_result("forces", &scratch.forces)?;
        if let Some((row, torque)) = outcome.unmet {
            let joint = self.joints().iter().find(|joint| joint.v.contains(&row)).map_or("", |joint| &joint.name);
            return Err(Error::argument(
                "actuated",
                format!("joint {joint:?}, which is not actuated and would need {} (N m or N)", number(torque)),
                "accelerations that the actuated joints can produce, or more actuated joints",
            ));
        }
        forces.copy_from_slice(&scratch.forces);
        Ok(Constrained { rank: outcome.rank, residual: outcome.residual })
    }

    /// Inverse mass matrix of the constrained system, M^-1 - M^-1 J^T G^+ J M^-1 at `q`, (nv x nv), row-major, written
    /// to `out`: joint accelerations per joint torque with the connections closed. Symmetric, with rank nv - rank(G).
    ///
    /// # Errors
    ///
    /// As [`Scene::constraint_jacobian`], and [`Error::SingularJoint`] of the tree.
    pub fn constrained_mass_matrix_inverse(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut ConstraintScratch,
        q: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        self.check_configuration("q", q)?;
        check_length("out", out.len(), self.nv() * self.nv())?;
        self.check_scratch_of_rows(workspace, scratch)?;
        self.check_form(workspace)?;
        let system = (self.model(), self.constraints());
        let pivots = constraints::constrained_mass_matrix_inverse(system, workspace, scratch, q, out)
            .map_err(|at| self.row_fault(at))?;
        self.check_pivots(workspace, pivots)?;
        self.check_result("constrained mass matrix inverse", out)
    }

    fn check_scratch_of_rows(&self, workspace: &Workspace<f64>, scratch: &ConstraintScratch) -> Result<(), Error> {
        self.check_workspace(workspace)?;
        self.check_scratch("scratch", scratch.identity, "scene.constraint_scratch()")
    }
}
