//! Derivatives of a scene's dynamics at one state, with arguments checked and faults named.

use crate::dynamics::derivatives::{self, DerivativeScratch, ForwardDerivatives, InverseDerivatives};
use crate::error::{Error, check_length};
use crate::scene::Scene;
use crate::spatial::SpatialVector;
use crate::watch;
use crate::workspace::Workspace;

impl Scene {
    /// Scratch for the methods below; one for each thread.
    #[must_use]
    pub fn derivative_scratch(&self) -> DerivativeScratch<f64> {
        DerivativeScratch::new(self.model())
    }

    /// dtau/dq, dtau/dqd and M of inverse dynamics at one state, in the tangent space of `q`: see
    /// [`derivatives::inverse_dynamics_derivatives`].
    ///
    /// `q` (nq), `qd`, `qdd` (nv), SI units; `wrenches` is empty or holds a spatial force a body, held in that body's frame. O(N depth), without
    /// allocation.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, and a workspace or scratch of another scene.
    #[allow(clippy::too_many_arguments)] // a state is three arrays and forces; scratch and results are the caller's
    pub fn inverse_dynamics_derivatives(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut DerivativeScratch<f64>,
        q: &[f64],
        qd: &[f64],
        qdd: &[f64],
        wrenches: &[SpatialVector<f64>],
        out: &mut InverseDerivatives<'_, f64>,
    ) -> Result<(), Error> {
        self.check_derivatives(workspace, scratch, (q, qd, ("qdd", qdd)), wrenches)?;
        let nv = self.nv();
        check_length("dtau_dq", out.dtau_dq.len(), nv * nv)?;
        check_length("dtau_dqd", out.dtau_dqd.len(), nv * nv)?;
        check_length("mass_matrix", out.mass_matrix.len(), nv * nv)?;
        derivatives::inverse_dynamics_derivatives(self.model(), workspace, scratch, q, qd, qdd, wrenches, out);
        self.check_not_stopped()?;
        self.check_result("dtau/dq", out.dtau_dq)?;
        self.check_result("dtau/dqd", out.dtau_dqd)?;
        self.check_result("mass matrix", out.mass_matrix)
    }

    /// dqdd/dq, dqdd/dqd and M^-1 of forward dynamics at one state, in the form of the workspace and in the tangent space of `q`: see
    /// [`derivatives::forward_dynamics_derivatives`].
    ///
    /// `q` (nq), `qd`, `tau` (nv), SI units; `wrenches` as in [`Scene::inverse_dynamics_derivatives`]. Without allocation but for states in doubt.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, a workspace or scratch of another scene, [`Error::SingularJoint`] where a pivot is lost, and in
    /// square-root form an inertia that has no root.
    #[allow(clippy::too_many_arguments)] // as above
    pub fn forward_dynamics_derivatives(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut DerivativeScratch<f64>,
        q: &[f64],
        qd: &[f64],
        tau: &[f64],
        wrenches: &[SpatialVector<f64>],
        out: &mut ForwardDerivatives<'_, f64>,
    ) -> Result<(), Error> {
        self.check_derivatives(workspace, scratch, (q, qd, ("tau", tau)), wrenches)?;
        self.check_form(workspace)?;
        let nv = self.nv();
        check_length("dqdd_dq", out.dqdd_dq.len(), nv * nv)?;
        check_length("dqdd_dqd", out.dqdd_dqd.len(), nv * nv)?;
        check_length("mass_matrix_inverse", out.mass_matrix_inverse.len(), nv * nv)?;
        derivatives::forward_dynamics_derivatives(self.model(), workspace, scratch, q, qd, tau, wrenches, out)
            .map_err(|lost| self.singular(lost))?;
        self.check_not_stopped()?;
        self.check_result("dqdd/dq", out.dqdd_dq)?;
        self.check_result("dqdd/dqd", out.dqdd_dqd)?;
        self.check_result("mass matrix inverse", out.mass_matrix_inverse)
    }

    /// A (2nv x 2nv) and B (2nv x nv) of dx/dt = A x + B u, x = (d, change of qd), for small deviations q (+) d from the motion through one state: see
    /// [`derivatives::linearize`].
    ///
    /// Arguments as in [`Scene::forward_dynamics_derivatives`]; both results row by row.
    ///
    /// # Errors
    ///
    /// As [`Scene::forward_dynamics_derivatives`].
    #[allow(clippy::too_many_arguments)] // as above
    pub fn linearize(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut DerivativeScratch<f64>,
        q: &[f64],
        qd: &[f64],
        tau: &[f64],
        wrenches: &[SpatialVector<f64>],
        (a, b): (&mut [f64], &mut [f64]),
    ) -> Result<(), Error> {
        self.check_derivatives(workspace, scratch, (q, qd, ("tau", tau)), wrenches)?;
        self.check_form(workspace)?;
        let nv = self.nv();
        check_length("a", a.len(), 4 * nv * nv)?;
        check_length("b", b.len(), 2 * nv * nv)?;
        derivatives::linearize(self.model(), workspace, scratch, q, qd, tau, wrenches, (a, b))
            .map_err(|lost| self.singular(lost))?;
        self.check_not_stopped()?;
        self.check_result("A", a)?;
        self.check_result("B", b)
    }

    /// Whether the work was told to stop on its way.
    fn check_not_stopped(&self) -> Result<(), Error> {
        if self.model().bodies.len() < derivatives::AT_A_TIME { Ok(()) } else { watch::check() }
    }

    /// What all of these are given.
    fn check_derivatives(
        &self,
        workspace: &Workspace<f64>,
        scratch: &DerivativeScratch<f64>,
        (q, qd, (name, u)): (&[f64], &[f64], (&str, &[f64])),
        wrenches: &[SpatialVector<f64>],
    ) -> Result<(), Error> {
        self.check_configuration("q", q)?;
        self.check_rates("qd", qd)?;
        self.check_rates(name, u)?;
        self.check_wrenches(wrenches)?;
        self.check_workspace(workspace)?;
        scratch.check(self.model())
    }
}
