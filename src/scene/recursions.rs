//! The algorithms on one state by the general recursions, with arguments checked and faults named.

use super::Scene;
use crate::batch::chunk::{Algorithm, Arguments};
use crate::dynamics;
use crate::dynamics::mass_inverse::InverseScratch;
use crate::error::{Error, check_length};
use crate::planar;
use crate::workspace::Workspace;

impl Scene {
    /// One algorithm on one state by the recursion of the paper, in `f64` and with every check: what [`Scene::forward_dynamics`] and its
    /// like do where the compiled kernels are in doubt, three times as slow.
    ///
    /// Of `state` it looks at what the algorithm takes and at nothing else. It sets the workspace's form to that of the algorithm. `inverse`: scratch for M^-1; None: made for this call. A scene whose
    /// joints move in one plane goes by three-vectors where the workspace is [`Scene::workspace`]'s.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, a workspace of another scene, [`Error::SingularJoint`] where a pivot is lost, and in
    /// square-root form an inertia that has no root.
    pub fn recursion(
        &self,
        workspace: &mut Workspace<f64>,
        inverse: Option<&mut InverseScratch<f64>>,
        algorithm: Algorithm,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        let named = Named::of(algorithm);
        let state = &named.read_of(state);
        let &Arguments { q, qd, u, wrenches } = state;
        self.check_configuration("q", q)?;
        if named.reads_rates {
            self.check_rates("qd", qd)?;
        }
        if let Some(name) = named.u {
            self.check_rates(name, u)?;
            self.check_wrenches(wrenches)?;
        }
        check_length(named.out, out.len(), self.width(algorithm))?;
        self.check_workspace(workspace)?;
        if let Algorithm::ForwardDynamics(form) | Algorithm::MassMatrixInverse(form) = algorithm {
            workspace.form = form;
            self.check_form(workspace)?;
        }
        if self.in_the_plane(algorithm, workspace, state, out) {
            return Ok(());
        }
        let model = &self.model;
        match algorithm {
            Algorithm::ForwardDynamics(_) => {
                let monitor = dynamics::forward_dynamics(model, workspace, q, qd, u, wrenches, out);
                self.check_pivots(workspace, monitor)?;
            }
            Algorithm::InverseDynamics => dynamics::inverse_dynamics(model, workspace, q, qd, u, wrenches, out),
            Algorithm::BiasTorque => dynamics::bias_torque(model, workspace, q, qd, &[], out),
            Algorithm::MassMatrix => dynamics::mass_matrix(model, workspace, q, out),
            Algorithm::MassMatrixInverse(_) => {
                let mut own = None;
                let scratch = inverse.unwrap_or_else(|| own.insert(self.inverse_scratch()));
                scratch.check(model)?;
                let monitor = dynamics::mass_matrix_inverse(model, workspace, scratch, q, out);
                self.check_pivots(workspace, monitor)?;
            }
        }
        self.check_result(named.what, out)
    }

    /// Runs an algorithm in the plane, where the scene has one and the workspace is this scene's; false where 6-vectors are to do it:
    /// no planar way, a pivot near the bound of its terms, or a result that is not finite.
    fn in_the_plane(
        &self,
        algorithm: Algorithm,
        workspace: &mut Workspace<f64>,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> bool {
        let (Some(model), Some(scratch)) = (&self.planar, &mut workspace.planar) else { return false };
        planar::covers(algorithm)
            && planar::run(algorithm, model, scratch, (state.q, state.qd, state.u), state.wrenches, out) == 0
            && out.iter().all(|x| x.is_finite())
    }
}

/// What an algorithm and its arguments are called in messages, and what it reads beside q.
struct Named {
    what: &'static str,
    reads_rates: bool,
    /// Torques or accelerations; with them go wrenches.
    u: Option<&'static str>,
    out: &'static str,
}

impl Named {
    fn of(algorithm: Algorithm) -> Self {
        let (what, reads_rates, u, out) = match algorithm {
            Algorithm::ForwardDynamics(_) => ("forward dynamics", true, Some("tau"), "qdd"),
            Algorithm::InverseDynamics => ("inverse dynamics", true, Some("qdd"), "tau"),
            Algorithm::BiasTorque => ("bias torque", true, None, "tau"),
            Algorithm::MassMatrix => ("mass matrix", false, None, "out"),
            Algorithm::MassMatrixInverse(_) => ("mass matrix inverse", false, None, "out"),
        };
        Self { what, reads_rates, u, out }
    }

    /// What the algorithm reads of a state; the rest is empty.
    fn read_of<'a>(&self, state: &Arguments<'a>) -> Arguments<'a> {
        let mut read = Arguments { q: state.q, ..Arguments::default() };
        if self.reads_rates {
            read.qd = state.qd;
        }
        if self.u.is_some() {
            (read.u, read.wrenches) = (state.u, state.wrenches);
        }
        read
    }
}
