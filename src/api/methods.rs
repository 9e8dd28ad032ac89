//! The algorithms on one state of a scene, with arguments checked and faults named.

use super::own;
use crate::algorithm::{Algorithm, Arguments, KinematicQuantity};
use crate::dynamics::coupled::CoupledScratch;
use crate::dynamics::mass_inverse::InverseScratch;
use crate::dynamics::{self, Energy};
use crate::error::{Error, Fault, check_finite};
use crate::kinematics;
use crate::scene::{Coupling, Link, Scene};
use crate::spatial::{RigidShift, SpatialVector};
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// Wrenches on links, as forces on bodies: empty, or one a body in the body's frame.
pub type BodyWrenches = Vec<SpatialVector<f64>>;

impl Scene {
    /// Scratch for the methods below; one for each thread.
    ///
    /// With the compiled kernels of one state, so that these methods allocate nothing; but scratch of the two matrices is made by their
    /// first call where the scene has more than 128 degrees of freedom.
    #[must_use]
    pub fn workspace(&self) -> Workspace<f64> {
        let tree = self.tree();
        Workspace { kernels: own::ready(tree), ..Workspace::new(tree.model()) }
    }

    /// Scratch for [`Scene::mass_matrix_inverse`].
    #[must_use]
    pub fn inverse_scratch(&self) -> InverseScratch<f64> {
        InverseScratch::new(self.model())
    }

    /// Forward dynamics of one state, in the form of the workspace.
    ///
    /// By the compiled kernels of [`Scene::evaluate`], as all of these five; a state that they doubt is done again by
    /// [`Scene::recursion`], and so is every state where the workspace is to estimate errors. Of a scene with connections the accelerations are those of
    /// [`Scene::constrained_dynamics`]. What else the workspace holds afterwards is not said.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, a workspace of another scene, [`Error::SingularJoint`] where a pivot is lost, and
    /// [`Error::Constraint`] where connections contradict each other, or the state does not meet them (see [`Scene::constrained_dynamics`]).
    #[allow(clippy::too_many_arguments)] // a state is three arrays; scratch and result are the caller's
    pub fn forward_dynamics(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        tau: &[f64],
        wrenches: &[SpatialVector<f64>],
        qdd: &mut [f64],
    ) -> Result<(), Error> {
        let algorithm = Algorithm::ForwardDynamics(workspace.form);
        self.run_one(workspace, None, algorithm, &Arguments { q, qd, u: tau, wrenches, ..Arguments::default() }, qdd)
    }

    /// Inverse dynamics of one state.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, and a workspace of another scene.
    #[allow(clippy::too_many_arguments)] // as above
    pub fn inverse_dynamics(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        qdd: &[f64],
        wrenches: &[SpatialVector<f64>],
        tau: &mut [f64],
    ) -> Result<(), Error> {
        self.run_one(
            workspace,
            None,
            Algorithm::InverseDynamics,
            &Arguments { q, qd, u: qdd, wrenches, ..Arguments::default() },
            tau,
        )
    }

    /// The bias torque H phi b of one state, gravity included.
    ///
    /// # Errors
    ///
    /// Wrong lengths and numbers that are not finite.
    pub fn bias_torque(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        tau: &mut [f64],
    ) -> Result<(), Error> {
        let state = Arguments { q, qd, ..Arguments::default() };
        self.run_one(workspace, None, Algorithm::BiasTorque, &state, tau)
    }

    /// The torques that hold the scene at `q` against gravity, dU/dq along the tangent of q: the bias torque at rest.
    ///
    /// # Errors
    ///
    /// Wrong lengths and numbers that are not finite.
    pub fn gravity_torque(&self, workspace: &mut Workspace<f64>, q: &[f64], tau: &mut [f64]) -> Result<(), Error> {
        let rest = std::mem::take(&mut workspace.rest);
        // Of a scene whose joints follow each other they are fewer than the workspace's.
        let outcome = self.bias_torque(workspace, q, &rest[..rest.len().min(self.nv())], tau);
        workspace.rest = rest;
        outcome
    }

    /// The mass matrix at `q`, (nv x nv) row by row.
    ///
    /// # Errors
    ///
    /// Wrong lengths and numbers that are not finite.
    pub fn mass_matrix(&self, workspace: &mut Workspace<f64>, q: &[f64], out: &mut [f64]) -> Result<(), Error> {
        let state = Arguments { q, ..Arguments::default() };
        self.run_one(workspace, None, Algorithm::MassMatrix, &state, out)
    }

    /// The inverse of the mass matrix at `q` in closed form (6.1), (nv x nv) row by row: the tree's, whatever connections there are.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, and [`Error::SingularJoint`].
    pub fn mass_matrix_inverse(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut InverseScratch<f64>,
        q: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        self.check_scratch("scratch", scratch.identity(), "scene.inverse_scratch()")?;
        let algorithm = Algorithm::MassMatrixInverse(workspace.form);
        self.run_one(workspace, Some(scratch), algorithm, &Arguments { q, ..Arguments::default() }, out)
    }

    /// By the kernels of one state; what they doubt, by the recursion.
    pub(super) fn run_one(
        &self,
        workspace: &mut Workspace<f64>,
        inverse: Option<&mut InverseScratch<f64>>,
        algorithm: Algorithm,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        self.check_workspace(workspace)?;
        let tolerance = algorithm.form().and(workspace.tolerance);
        let state = &Arguments { tolerance, ..*state };
        self.check_tolerance(algorithm, tolerance)?;
        if let Some(coupling) = self.coupling() {
            return self.run_coupled(coupling, workspace, algorithm, state, out);
        }
        // Only the recursion writes its accuracy into the workspace.
        let estimated = workspace.estimates_error && matches!(algorithm, Algorithm::ForwardDynamics(_));
        let fits = self.fits(algorithm, state) && out.len() == self.width(algorithm);
        if fits && !estimated && own::run(&mut workspace.kernels, self, algorithm, state, out) {
            return Ok(());
        }
        self.recursion(workspace, inverse, algorithm, state, out)
    }

    /// The same where joints follow each other.
    fn run_coupled(
        &self,
        coupling: &Coupling,
        workspace: &mut Workspace<f64>,
        algorithm: Algorithm,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        let mut made = workspace.coupled.take(self.identity(), || CoupledScratch::new(coupling));
        let mut ask = |algorithm: Algorithm, states: &[Arguments<'_>], out: &mut [f64]| {
            let done = coupling.tree().run_one(workspace, None, algorithm, &states[0], out);
            done.map_err(|error| Fault { state: 0, error })
        };
        let state = [*state];
        let done = self.evaluate_coupled(coupling, (&mut made.1, &mut ask), algorithm, &state, out, &mut |_, _| {});
        workspace.coupled.keep(made);
        done.map_err(|fault| fault.error)
    }

    /// Kinetic and potential energy, J.
    ///
    /// # Errors
    ///
    /// Wrong lengths and numbers that are not finite.
    pub fn energy(&self, workspace: &mut Workspace<f64>, q: &[f64], qd: &[f64]) -> Result<Energy<f64>, Error> {
        let (q, qd) = (&*self.tree_configuration("q", q)?, &*self.tree_rates("qd", qd)?);
        self.check_workspace(workspace)?;
        let energy = dynamics::energy(self.model(), workspace, q, qd);
        self.check_result("energy", &[energy.kinetic, energy.potential])?;
        Ok(energy)
    }

    /// Kinetic energy alone, J, armature included.
    ///
    /// # Errors
    ///
    /// Wrong lengths and numbers that are not finite.
    pub fn kinetic_energy(&self, workspace: &mut Workspace<f64>, q: &[f64], qd: &[f64]) -> Result<f64, Error> {
        let (q, qd) = (&*self.tree_configuration("q", q)?, &*self.tree_rates("qd", qd)?);
        self.check_workspace(workspace)?;
        let kinetic = dynamics::kinetic_energy(self.model(), workspace, q, qd);
        self.check_result("kinetic energy", &[kinetic])?;
        Ok(kinetic)
    }

    /// Potential energy of gravity alone, J, zero with the center of mass at the origin of the base.
    ///
    /// # Errors
    ///
    /// Wrong lengths and numbers that are not finite.
    pub fn potential_energy(&self, workspace: &mut Workspace<f64>, q: &[f64]) -> Result<f64, Error> {
        let mut potential = [f64::NAN];
        self.kinematic_quantity(workspace, &KinematicQuantity::PotentialEnergy, [q, &[], &[]], &mut potential)?;
        Ok(potential[0])
    }

    /// Spatial momentum (angular about the base's origin, linear) in the base frame.
    ///
    /// # Errors
    ///
    /// Wrong lengths and numbers that are not finite.
    pub fn momentum(&self, workspace: &mut Workspace<f64>, q: &[f64], qd: &[f64]) -> Result<SpatialVector<f64>, Error> {
        let (q, qd) = (&*self.tree_configuration("q", q)?, &*self.tree_rates("qd", qd)?);
        self.check_workspace(workspace)?;
        let momentum = dynamics::momentum(self.model(), workspace, q, qd);
        self.check_result("momentum", momentum.as_slice())?;
        Ok(momentum)
    }

    /// Where every link is: from its frame to the base's, in the order of [`Scene::links`].
    ///
    /// # Errors
    ///
    /// Wrong lengths and numbers that are not finite.
    pub fn placements(&self, q: &[f64]) -> Result<Vec<RigidShift<f64>>, Error> {
        let q = &*self.tree_configuration("q", q)?;
        let mut bodies: Vec<RigidShift<f64>> = Vec::with_capacity(self.model().bodies.len());
        for (body, stage) in self.model().bodies.iter().zip(&self.model().system.stages) {
            let shift = kinematics::joint_shift(body, q);
            bodies.push(match stage.parent {
                Some(parent) => bodies[parent].compose(&shift),
                None => shift,
            });
        }
        let placements: Vec<_> = self.links().iter().map(|link| on_base(link, &bodies)).collect();
        placements.iter().try_for_each(|placement| self.check_result("placements", placement.lever.as_slice()))?;
        Ok(placements)
    }

    /// Wrenches (moment, force) on links, each at its link's origin and in its frame, as forces on bodies.
    ///
    /// # Errors
    ///
    /// An unknown link or numbers that are not finite.
    pub fn body_wrenches<'a>(
        &self,
        wrenches: impl IntoIterator<Item = (&'a str, SpatialVector<f64>)>,
    ) -> Result<BodyWrenches, Error> {
        let mut on_bodies = vec![Vector6::zeros(); self.model().bodies.len()];
        for (name, wrench) in wrenches {
            let link = self.link(name).map_err(|error| error.of_argument("wrenches"))?;
            check_finite(&format!("wrench on {name:?}"), wrench.as_slice())?;
            if let Some(body) = link.body {
                on_bodies[body] += link.placement.force_to_parent(&wrench);
            }
        }
        Ok(on_bodies)
    }
}

/// A link's placement on the base, from those of the bodies.
fn on_base(link: &Link, bodies: &[RigidShift<f64>]) -> RigidShift<f64> {
    match link.body {
        Some(body) => bodies[body].compose(&link.placement),
        None => link.placement,
    }
}
