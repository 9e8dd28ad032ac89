//! Closed loops at one state, with arguments checked and faults named.

use crate::algorithm::{Algorithm, Arguments};
use crate::dynamics::constraints::{self, ConstraintScratch, accelerations_of_rows, errors_of_rows, jacobian_of_rows};
use crate::error::{Error, check_length, number};
use crate::kinematics::placements_base_to_tip;
use crate::scene::Scene;
use crate::spatial::SpatialVector;
use crate::workspace::Workspace;

/// What [`Scene::constrained_dynamics`] and [`Scene::constrained_inverse_dynamics`] tell beside their result.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Constrained {
    /// How many of the rows are independent.
    pub rank: usize,
    /// The largest entry of J qdd + J' qd that is left, rad/s^2 or m/s^2.
    pub residual: f64,
}

/// What [`Scene::project`] tells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// How many of the rows are independent where it ended.
    pub rank: usize,
    /// The largest error that is left, m or rad.
    pub error: f64,
    /// The largest rate of an error that is left, m/s or rad/s; zero without velocities.
    pub rate: f64,
}

/// What a projection that fails expects.
const NEARER: &str = "a start from which small moves meet the connections, and connections that can be met";

impl Scene {
    /// Scratch for the methods on connections; one for each thread.
    #[must_use]
    pub fn constraint_scratch(&self) -> ConstraintScratch {
        ConstraintScratch::new(self.model(), self.constraints())
    }

    /// How far each row of the connections is from holding at `q`, into `out` (m): origins in m, in the first frame's axes; rotations as 2 sin(t/2)
    /// about their axis, t the angle, which is t where it is small; angular rows before linear ones. O(m depth).
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, and a rod whose ends coincide.
    pub fn constraint_error(&self, q: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.check_configuration("q", q)?;
        check_length("out", out.len(), self.constraint_rows())?;
        errors_of_rows(self.model(), self.constraints(), q, out).map_err(|at| self.no_direction(at))?;
        self.check_result("constraint error", out)
    }

    /// J of the connections at `q`, (m x nv) row by row into `out`: J qd is the rate of [`Scene::constraint_error`], exactly and at every `q`. O(m
    /// depth), beside the zeros.
    ///
    /// # Errors
    ///
    /// As [`Scene::constraint_error`], and scratch of another scene.
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
        placements_base_to_tip(self.model(), q, &mut workspace.store.shifts);
        let at = (q, &workspace.rest[..]);
        jacobian_of_rows(self.model(), self.constraints(), scratch, &workspace.store.shifts, at, out)
            .map_err(|at| self.no_direction(at))?;
        self.check_result("constraint jacobian", out)
    }

    /// J' qd of the connections, into `out` (m): the second derivative of [`Scene::constraint_error`] where no joint accelerates. O(m depth).
    ///
    /// # Errors
    ///
    /// As [`Scene::constraint_error`].
    pub fn constraint_bias(&self, q: &[f64], qd: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.check_configuration("q", q)?;
        self.check_rates("qd", qd)?;
        check_length("out", out.len(), self.constraint_rows())?;
        let mut terms = vec![0.0; out.len()];
        accelerations_of_rows(self.model(), self.constraints(), (q, qd), None, (out, &mut terms))
            .map_err(|at| self.no_direction(at))?;
        self.check_result("constraint bias", out)
    }

    /// Accelerations `qdd` (nv) and the forces of the connections (m) from torques: M qdd + bias = tau + J^T forces with J qdd + J' qd = 0.
    ///
    /// Forces are what a connection does to its `link`, a row each, N m and N, at the origin of its first frame and in its axes; the other link gets
    /// the opposite. A rod pushes where its force is positive. Rows that depend on each other have the forces of least sum `(J M^-1 J^T)_ii`
    /// `forces_i`^2; the accelerations are unique. In the workspace's form. O(N + m^2 depth + m^3).
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
    /// let told = scene.constrained_dynamics(&mut workspace, &mut scratch, &q, &zero, &zero, &[], (&mut qdd, &mut forces))?;
    /// assert!(told.rank > 0 && told.residual < 1e-9);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, scratch of another scene, [`Error::SingularJoint`] of the tree, a rod whose ends coincide, and
    /// [`Error::Constraint`] where no forces meet all rows, or where the state does not meet the connections to within 1e-3 (m or rad; m/s or rad/s, relative
    /// to the fastest joint where that is faster than 1): [`Scene::project`] gives one that does.
    #[allow(clippy::too_many_arguments)] // as forward dynamics
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
        // Of a scene whose joints follow each other they are fewer than the tree's.
        scratch.results.resize(self.width(algorithm), f64::NAN);
        self.run_one(workspace, None, algorithm, &state, &mut scratch.results)?;
        let (accelerations, rest) = scratch.results.split_at(nv);
        qdd.copy_from_slice(accelerations);
        forces.copy_from_slice(&rest[..m]);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a count
        Ok(Constrained { rank: rest[m] as usize, residual: rest[m + 1] })
    }

    /// The configuration nearest to `q` that meets the connections, and the velocities nearest to `qd` that keep them so, both in place.
    ///
    /// Newton steps -M^-1 J^T G^+ error, each of least kinetic energy; velocities less M^-1 J^T G^+ J qd, as by an impact without rebound.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, scratch of another scene, [`Error::SingularJoint`] of the tree; [`Error::Constraint`] where an
    /// error or a rate stays: from there no small moves meet the connections.
    pub fn project(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut ConstraintScratch,
        q: &mut [f64],
        qd: Option<&mut [f64]>,
    ) -> Result<Projection, Error> {
        self.project_compliant(workspace, scratch, q, qd, &[])
    }

    /// The same where each row gives way by its `compliance` (m, zero or above; empty: none does): errors and velocities of rows are -compliance times what pushes the state there,
    /// so that q is where half the squared distance from the start, by kinetic energy, plus the sum of error^2/(2 compliance) is least.
    ///
    /// # Errors
    ///
    /// As [`Scene::project`], and a compliance below zero or not finite.
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
        let positions = constraints::project_positions(system, workspace, scratch, q, compliance)
            .map_err(|at| self.no_direction(at))?;
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
            .map_err(|at| self.no_direction(at))?;
        self.check_pivots(workspace, velocities.pivots)?;
        if let Some(row) = velocities.stays {
            return Err(self.open_at("qd", row, velocities.left, "m/s or rad/s", NEARER));
        }
        self.check_result("qd", qd)?;
        Ok(Projection { rank: velocities.rank, error: positions.left, rate: velocities.left })
    }

    /// Torques `tau` (nv) and forces of the connections (m) that give the accelerations `qdd`: tau + J^T forces = M qdd + bias, tau zero at joints that are not
    /// `actuated` (nv; empty: all are).
    ///
    /// Where that leaves a choice, tau has the least tau^T M^-1 tau: torques that do not load the connections. Whether `qdd` meets the connections is
    /// told by the residual.
    ///
    /// # Errors
    ///
    /// As [`Scene::constrained_dynamics`], and [`Error::Argument`] where a joint without a motor would need a torque.
    #[allow(clippy::too_many_arguments)] // as inverse dynamics
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
        self.check_closed(q, qd)?;
        let (system, state) = ((self.model(), self.constraints()), (q, qd, qdd));
        let outcome =
            constraints::constrained_inverse_dynamics(system, workspace, scratch, state, wrenches, actuated, tau)
                .map_err(|at| self.no_direction(at))?;
        self.check_pivots(workspace, outcome.pivots)?;
        self.check_result("tau", tau)?;
        self.check_result("forces", &scratch.forces)?;
        if let Some((row, torque)) = outcome.unmet {
            let joint = self.joints().iter().find(|joint| joint.v.contains(&row)).map_or("", |joint| &joint.name);
            return Err(Error::argument(
                "actuated",
                format!("joint {joint:?} without a motor, which would need {} (N m or N)", number(torque)),
                "motors that can give these accelerations, or accelerations that they can give",
            ));
        }
        forces.copy_from_slice(&scratch.forces);
        Ok(Constrained { rank: outcome.rank, residual: outcome.residual })
    }

    /// M^-1 - M^-1 J^T G^+ J M^-1 at `q`, (nv x nv) row by row into `out`: how torques accelerate the joints through the connections; symmetric, of
    /// rank nv less that of G.
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
            .map_err(|at| self.no_direction(at))?;
        self.check_pivots(workspace, pivots)?;
        self.check_result("constrained mass matrix inverse", out)
    }

    fn check_scratch_of_rows(&self, workspace: &Workspace<f64>, scratch: &ConstraintScratch) -> Result<(), Error> {
        self.check_workspace(workspace)?;
        self.check_scratch("scratch", scratch.identity, "scene.constraint_scratch()")
    }
}
