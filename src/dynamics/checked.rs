//! The algorithms on one state by the passes on the general model, with argument checks and error messages.

use super::constraints::{self, ConstraintScratch};
use super::mass_inverse::{InverseScratch, mass_matrix_inverse};
use super::{forward, inverse, mass_matrix};
use crate::accuracy::Accuracy;
use crate::algorithm::table::Sizes;
use crate::algorithm::{Algorithm, Arguments, constants_width};
use crate::error::{Error, check_finite, check_length, number};
use crate::filter::pivots::PivotMonitor;
use crate::model::StateModel;
use crate::scene::{Scene, check_tolerance};
use crate::spatial::SpatialVector;
use crate::workspace::Workspace;

impl Scene {
    /// One algorithm on one state by the recursion of the paper, in `f64` and with every check.
    /// [`Scene::forward_dynamics`] and similar methods run it if the kernels need a fallback; it takes three times
    /// longer.
    ///
    /// It reads only the fields of `state` that the algorithm takes. It sets the form of the workspace to that of the
    /// algorithm, and the tolerance to that of the state. `inverse` is scratch for M^-1; None: allocated for this call.
    ///
    /// # Errors
    ///
    /// Wrong lengths, values that are not finite, a workspace of another scene, [`Error::SingularJoint`] if a pivot is
    /// lost, and in square-root form an inertia without a root.
    pub fn recursion(
        &self,
        workspace: &mut Workspace<f64>,
        inverse: Option<&mut InverseScratch<f64>>,
        algorithm: Algorithm,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        if let Some((scene, state)) = self.of_own_model(state)? {
            let mut own = scene.workspace();
            scene.recursion(&mut own, None, algorithm, &state, out)?;
            workspace.accuracy = own.accuracy;
            return Ok(());
        }
        let (reads_rates, third) = algorithm.reads();
        let state = &state.read_by(algorithm);
        let &Arguments { q, qd, u, wrenches, .. } = state;
        self.check_configuration("q", q)?;
        if reads_rates {
            self.check_rates("qd", qd)?;
        }
        if let Some(name) = third {
            self.check_rates(name, u)?;
            self.check_wrenches(wrenches)?;
        }
        let entry = algorithm.entry();
        let out_name = match (algorithm, entry.results) {
            (Algorithm::ForwardDynamics(_) | Algorithm::InverseDynamics | Algorithm::BiasTorque, [(name, _)]) => name,
            _ => "out",
        };
        check_length(out_name, out.len(), self.width(algorithm))?;
        self.check_workspace(workspace)?;
        if let Some(form) = algorithm.form() {
            workspace.form = form;
            self.check_form(workspace)?;
        }
        self.check_tolerance(algorithm, state.tolerance)?;
        workspace.tolerance = state.tolerance;
        let model = self.model();
        self.check_seed(algorithm, state.seed)?;
        match algorithm {
            Algorithm::ForwardDynamics(_) if !self.constraints().is_empty() => {
                self.through_connections(workspace, (q, qd, u), (wrenches, &[]), (out, None))?;
            }
            Algorithm::ConstrainedDynamics(_) => {
                let (qdd, rest) = out.split_at_mut(self.nv());
                self.through_connections(workspace, (q, qd, u), (wrenches, state.seed[0]), (qdd, Some(rest)))?;
            }
            Algorithm::ForwardDynamics(_) => {
                let monitor = forward::forward_dynamics(model, workspace, q, qd, u, wrenches, out);
                self.check_pivots(workspace, monitor)?;
            }
            Algorithm::InverseDynamics => inverse::inverse_dynamics(model, workspace, q, qd, u, wrenches, out),
            Algorithm::BiasTorque => inverse::bias_torque(model, workspace, q, qd, &[], out),
            Algorithm::MassMatrix => mass_matrix::mass_matrix(model, workspace, q, out),
            Algorithm::MassMatrixInverse(_) => {
                let mut own = None;
                let scratch = inverse.unwrap_or_else(|| own.insert(InverseScratch::new(model)));
                self.check_scratch("scratch", scratch.identity(), "scene.inverse_scratch()")?;
                let monitor = mass_matrix_inverse(model, workspace, scratch, q, out);
                self.check_pivots(workspace, monitor)?;
            }
            #[cfg(feature = "derivatives")]
            Algorithm::Derivatives(which) => self.derivatives(workspace, which, state, out)?,
            #[cfg(feature = "derivatives")]
            Algorithm::Products(which) => self.products(workspace, which, state, out)?,
        }
        if out.iter().all(|value| value.is_finite()) {
            return Ok(());
        }
        self.check_result(&entry.name.replace('_', " "), out)
    }

    /// Forward dynamics of a scene with connections; if requested, also the forces, the rank and the residual.
    fn through_connections(
        &self,
        workspace: &mut Workspace<f64>,
        state: (&[f64], &[f64], &[f64]),
        given: (&[SpatialVector<f64>], &[f64]),
        (qdd, rest): (&mut [f64], Option<&mut [f64]>),
    ) -> Result<(), Error> {
        let mut made =
            workspace.connected.take(self.identity(), || ConstraintScratch::new(self.model(), self.constraints()));
        let done = self.accelerations_through_connections(workspace, &mut made.1, state, given, qdd);
        if let (Ok(told), Some(rest)) = (&done, rest) {
            let (forces, told_to) = rest.split_at_mut(self.constraints().rows);
            forces.copy_from_slice(&made.1.forces);
            #[allow(clippy::cast_precision_loss)] // a count
            told_to.copy_from_slice(&[told.0 as f64, told.1]);
        }
        workspace.connected.keep(made);
        done.map(|_| ())
    }

    /// As above; leaves the forces and the factor in the scratch and returns the rank and the residual.
    pub(super) fn accelerations_through_connections(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut ConstraintScratch,
        state: (&[f64], &[f64], &[f64]),
        (wrenches, compliance): (&[SpatialVector<f64>], &[f64]),
        qdd: &mut [f64],
    ) -> Result<(usize, f64), Error> {
        let system = (self.model(), self.constraints());
        workspace.accuracy = Accuracy::unknown(workspace.form);
        let outcome = constraints::constrained_dynamics(system, workspace, scratch, state, (wrenches, compliance), qdd)
            .map_err(|at| self.row_fault(at))?;
        self.check_pivots(workspace, outcome.pivots)?;
        // The estimate of the error of the tree is not that of the rows.
        let Accuracy { form, doubled, .. } = workspace.accuracy;
        workspace.accuracy = Accuracy { doubled, ..Accuracy::unknown(form) };
        // An overflow is not a contradiction.
        if qdd.iter().all(|a| a.is_finite()) {
            self.check_agreement(&outcome)?;
        }
        // A compliant connection may have an error.
        if compliance.is_empty() {
            self.check_closed_rows(&scratch.rows, (state.0, state.1))?;
        }
        Ok((outcome.rank, outcome.residual))
    }

    /// An error for a scene with connections.
    pub(crate) fn check_no_connections(&self, what: &str) -> Result<(), Error> {
        if self.constraints().is_empty() {
            return Ok(());
        }
        let names: Vec<String> = self.constraints().all.iter().take(8).map(|of| format!("{:?}", of.name)).collect();
        Err(Error::argument(
            what,
            format!("a scene with connections ({})", names.join(", ")),
            "a tree: scene.without_constraints() is the same one without them",
        ))
    }

    /// Checks that a seed has the right lengths and finite values.
    pub(super) fn check_seed(&self, algorithm: Algorithm, seed: [&[f64]; 3]) -> Result<(), Error> {
        if matches!(algorithm, Algorithm::ConstrainedDynamics(_)) {
            return self.check_compliance(seed[0]);
        }
        for (i, (&(name, _), seed)) in algorithm.seeds().iter().zip(seed).enumerate() {
            check_length(name, seed.len(), self.seed_width(algorithm, i))?;
            #[cfg(feature = "derivatives")]
            self.check_changes(name, seed)?;
        }
        Ok(())
    }

    /// One nonnegative value per row of the connections, or none.
    pub(crate) fn check_compliance(&self, compliance: &[f64]) -> Result<(), Error> {
        if compliance.is_empty() {
            return Ok(());
        }
        check_length("compliance", compliance.len(), self.constraint_rows())?;
        check_finite("compliance", compliance)?;
        match compliance.iter().position(|&c| c < 0.0) {
            Some(row) => {
                let found = format!("{} at row {row}", number(compliance[row]));
                Err(Error::argument("compliance", found, "numbers of zero or above, (m/s^2)/N or (rad/s^2)/(N m)"))
            }
            None => Ok(()),
        }
    }

    /// Number of scalars in vector `i` of an algorithm's seed; zero beyond the last vector.
    #[must_use]
    pub fn seed_width(&self, algorithm: Algorithm, i: usize) -> usize {
        let nv = self.nv();
        match algorithm {
            Algorithm::ConstrainedDynamics(_) if i == 0 => self.constraint_rows(),
            Algorithm::ConstrainedDynamics(_) => 0,
            _ if i == 2 && algorithm.takes_constants() => nv + constants_width(nv, self.model().bodies.len()),
            _ if i < algorithm.seeds().len() => nv,
            _ => 0,
        }
    }

    /// Number of scalars in the results of an algorithm for one state.
    #[must_use]
    pub fn width(&self, algorithm: Algorithm) -> usize {
        let (nv, width) = (self.nv(), algorithm.entry().width(&self.sizes()));
        if algorithm.gives_constants() { width + constants_width(nv, self.model().bodies.len()) } else { width }
    }

    /// The lengths of the axes of arguments and results for this scene.
    pub(crate) fn sizes(&self) -> Sizes {
        Sizes {
            nq: self.nq(),
            nv: self.nv(),
            links: self.links().len(),
            connection_rows: self.constraints().rows,
            contacts: self.contacts().len(),
        }
    }

    /// The lengths of the arguments of one state of an algorithm.
    #[inline]
    pub(crate) fn requirements(&self, algorithm: Algorithm) -> Requirements {
        let (rates, third) = algorithm.reads();
        let [qd, u] = [rates, third.is_some()].map(|is_read| if is_read { self.nv() } else { 0 });
        let seeds =
            if algorithm.seeds().is_empty() { [0; 3] } else { std::array::from_fn(|i| self.seed_width(algorithm, i)) };
        Requirements {
            widths: [self.nq(), qd, u],
            seeds,
            may_lack_seed: matches!(algorithm, Algorithm::ConstrainedDynamics(_)),
            bodies: self.model().bodies.len(),
            parameters: 10 * self.tree().joints().len(),
            nv: self.nv(),
        }
    }

    /// Checks that a workspace was made for this scene.
    pub(crate) fn check_workspace(&self, workspace: &Workspace<f64>) -> Result<(), Error> {
        self.check_scratch("workspace", workspace.identity, "scene.workspace()")
    }

    /// Checks that scratch was made for this scene, by the identity of its model; `made_by` is the call that makes it.
    pub(crate) fn check_scratch(&self, argument: &str, identity: u64, made_by: &str) -> Result<(), Error> {
        if identity == self.model().identity() {
            return Ok(());
        }
        Err(Error::argument(argument, "that of another scene", format!("this scene's own, from {made_by}")))
    }

    /// Converts a lost pivot into an error that names the joint. A pivot that is not finite is caused by overflow.
    pub(crate) fn check_pivots(&self, workspace: &Workspace<f64>, monitor: PivotMonitor<f64>) -> Result<(), Error> {
        workspace.lost_pivot(self.model(), &monitor).map_or(Ok(()), |lost| Err(self.singular(lost)))
    }

    /// A tolerance is accepted only for forms that estimate their error.
    pub(crate) fn check_tolerance(&self, algorithm: Algorithm, tolerance: Option<f64>) -> Result<(), Error> {
        let (Some(form), Some(tolerance)) = (algorithm.form(), tolerance) else { return Ok(()) };
        check_tolerance(
            form,
            tolerance,
            algorithm == Algorithm::ForwardDynamics(form) && self.constraints().is_empty(),
        )?;
        if self.coupling().is_some() {
            let found = format!("{} for a scene whose joints follow others (mimic)", number(tolerance));
            return Err(Error::argument("tolerance", found, "none: the error is not estimated there"));
        }
        Ok(())
    }

    /// The square-root form needs a root of every inertia.
    pub(crate) fn check_form(&self, workspace: &Workspace<f64>) -> Result<(), Error> {
        self.check_roots(workspace.form)
    }
}

/// The lengths of the arguments of one state.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Requirements {
    /// Of q, qd and u.
    widths: [usize; 3],
    seeds: [usize; 3],
    may_lack_seed: bool,
    bodies: usize,
    parameters: usize,
    nv: usize,
}

impl Requirements {
    /// True if the numbers of a model have the lengths of the scene.
    pub(crate) fn fits(&self, model: &StateModel<'_>) -> bool {
        [0, self.parameters].contains(&model.inertias.len()) && [0, self.nv].contains(&model.armature.len())
    }

    /// True if the kernels can compute a state: its arguments have the lengths that the algorithm reads.
    #[inline]
    pub(crate) fn met_by(&self, state: &Arguments<'_>) -> bool {
        let forces = state.wrenches.len();
        let unseeded = self.may_lack_seed && state.seed[0].is_empty();
        [state.q.len(), state.qd.len(), state.u.len()] == self.widths
            && (unseeded || state.seed.map(<[f64]>::len) == self.seeds)
            && (forces == 0 || forces == self.bodies)
            && (state.model.is_of_scene() || self.fits(&state.model))
    }
}
