//! Dynamics algorithms at one state. Each method checks its arguments before it computes.

use super::declared::{algorithms, quantities};
use super::kernels;
use crate::algorithm::{Algorithm, Arguments, KinematicQuantity};
use crate::dynamics::Energy;
use crate::dynamics::coupled::Ask;
use crate::dynamics::mass_inverse::InverseScratch;
use crate::error::{Error, Fault, check_finite};
use crate::scene::{Coupling, Link, Scene};
use crate::spatial::{RigidShift, SpatialVector};
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// Wrenches on links, converted to spatial forces on bodies: empty, or one per body in its body frame.
pub type BodyWrenches = Vec<SpatialVector<f64>>;

impl Scene {
    /// Scratch memory for the methods on one state. Each thread needs its own.
    ///
    /// The workspace includes the compiled kernels with their scratch, so that the methods do not allocate, with these
    /// exceptions: the first call of derivatives, and of products with them, allocates their scratch in the workspace,
    /// and so does the first call of the mass matrix and its inverse if the scene has more than 128 degrees of freedom.
    /// Derivatives that no kernel computes allocate scratch in each call, and so do the methods of scenes with coupled
    /// joints.
    #[must_use]
    pub fn workspace(&self) -> Workspace<f64> {
        let tree = self.coupling().map_or(self, Coupling::tied);
        Workspace { kernels: kernels::ready(tree), ..Workspace::new(tree.model()) }
    }

    /// Scratch memory for [`Scene::mass_matrix_inverse`].
    #[must_use]
    pub fn inverse_scratch(&self) -> InverseScratch<f64> {
        InverseScratch::new(self.model())
    }

    /// Joint torques (nv) that compensate gravity at `q`, dU/dq in the tangent space of q: the bias torque for zero
    /// velocities, N m or N.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`] and [`Error::NotFinite`].
    pub fn gravity_torque(&self, workspace: &mut Workspace<f64>, q: &[f64], tau: &mut [f64]) -> Result<(), Error> {
        let rest = std::mem::take(&mut workspace.rest);
        // The vector of a scene with coupled joints is shorter than that of the workspace, which belongs to its tree.
        let outcome = self.bias_torque(workspace, q, &rest[..rest.len().min(self.nv())], tau);
        workspace.rest = rest;
        outcome
    }

    /// Inverse M^-1 of the joint-space mass matrix at `q` in closed form (6.1), (nv x nv), row-major, written to `out`.
    ///
    /// Connections are ignored: M^-1 is that of the tree. [`Scene::constrained_mass_matrix_inverse`] accounts for them.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], and [`Error::SingularJoint`].
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

    /// Runs the kernels of one state, and the recursion if the kernels report failure or a large error estimate.
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
        // Only the recursion writes the error estimate to the workspace.
        let estimated = workspace.estimates_error && matches!(algorithm, Algorithm::ForwardDynamics(_));
        let fits = self.requirements(algorithm).met_by(state) && out.len() == self.width(algorithm);
        if fits && !estimated && kernels::run(&mut workspace.kernels, self, algorithm, state, out) {
            return Ok(());
        }
        self.recursion(workspace, inverse, algorithm, state, out)
    }

    /// [`Scene::run_one`] for a scene with coupled joints.
    fn run_coupled(
        &self,
        coupling: &Coupling,
        workspace: &mut Workspace<f64>,
        algorithm: Algorithm,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        let ask: &mut Ask<'_> = &mut |is_weightless, algorithm, states, out, _| {
            if is_weightless {
                // Columns of M^-1 are states in lanes.
                let scene = coupling.weightless();
                let mut made = workspace.weightless.take(scene.identity(), || scene.evaluator());
                let done = scene.evaluate(&mut made.1, algorithm, states, out);
                workspace.weightless.keep(made);
                return done;
            }
            let done = coupling.tied().run_one(workspace, None, algorithm, &states[0], out);
            done.map_err(|error| Fault { state: 0, error })
        };
        let done = self.evaluate_coupled(coupling, ask, algorithm, &[*state], out, &mut |_, _| {});
        done.map_err(|fault| fault.error)
    }

    /// Kinetic energy (armature included) and potential energy, J. O(N).
    ///
    /// # Errors
    ///
    /// [`Error::Shape`] and [`Error::NotFinite`].
    pub fn energy(&self, workspace: &mut Workspace<f64>, q: &[f64], qd: &[f64]) -> Result<Energy<f64>, Error> {
        let [kinetic, potential] = self.numbers_of(Some(workspace), &KinematicQuantity::Energy, &[q, qd])?;
        Ok(Energy { kinetic, potential })
    }

    /// Kinetic energy without the potential energy, J; armature is included. O(N).
    ///
    /// # Errors
    ///
    /// [`Error::Shape`] and [`Error::NotFinite`].
    pub fn kinetic_energy(&self, workspace: &mut Workspace<f64>, q: &[f64], qd: &[f64]) -> Result<f64, Error> {
        self.numbers_of(Some(workspace), &KinematicQuantity::KineticEnergy, &[q, qd]).map(|[kinetic]| kinetic)
    }

    /// Potential energy of gravity alone, J, zero with the center of mass at the origin of the base.
    ///
    /// # Errors
    ///
    /// Wrong lengths and numbers that are not finite.
    pub fn potential_energy(&self, workspace: &mut Workspace<f64>, q: &[f64]) -> Result<f64, Error> {
        self.numbers_of(Some(workspace), &KinematicQuantity::PotentialEnergy, &[q]).map(|[potential]| potential)
    }

    /// Forward kinematics: the pose of every link, from the link frame to the base frame, in the order of
    /// [`Scene::links`]. O(N).
    ///
    /// # Errors
    ///
    /// [`Error::Shape`] and [`Error::NotFinite`].
    pub fn placements(&self, q: &[f64]) -> Result<Vec<RigidShift<f64>>, Error> {
        let q = &*self.tree_configuration("q", q)?;
        let mut bodies = vec![RigidShift::identity(); self.model().bodies.len()];
        self.place_bodies(q, &mut bodies);
        let placements: Vec<_> = self.links().iter().map(|link| on_base(link, &bodies)).collect();
        placements.iter().try_for_each(|placement| self.check_result("placements", placement.lever.as_slice()))?;
        Ok(placements)
    }

    /// The poses of all links as [`Scene::placements`], as homogeneous matrices (links, 4, 4) that are written to `out`
    /// row by row. O(N), without allocation.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], and [`Error::Argument`] for a workspace of another scene.
    pub fn poses(&self, workspace: &mut Workspace<f64>, q: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.quantity(Some(workspace), &KinematicQuantity::Poses(self.links()), &[q], out)
    }

    /// Converts wrenches (moment, force) on links, each at the origin of its link frame and in its axes, to spatial
    /// forces on bodies.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for an unknown link, and [`Error::NotFinite`].
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

algorithms! {
    /// Forward dynamics: joint accelerations `qdd` (nv) of M qdd + bias = tau + J^T wrenches.
    ///
    /// `q` (nq), `qd` and `tau` (nv) are in SI units; `wrenches` is empty or holds one spatial force (moment, force)
    /// per body, in its body frame. The factorization form is that of the workspace. O(N).
    ///
    /// The compiled kernels of [`Scene::evaluate`] compute the result. A state whose error estimate exceeds the
    /// tolerance is recomputed by [`Scene::recursion`], and so is every state if the workspace estimates errors. For a
    /// scene with connections the accelerations are those of [`Scene::constrained_dynamics`]. The remaining content of
    /// the workspace is unspecified after the call.
    ///
    /// ```
    /// # fn main() -> Result<(), phipsi::Error> {
    /// let scene = phipsi::scenes::chain(3)?;
    /// let mut workspace = scene.workspace();
    /// let (q, qd, mut tau, mut qdd) = ([0.3; 3], [0.0; 3], [0.0; 3], [f64::NAN; 3]);
    /// scene.gravity_torque(&mut workspace, &q, &mut tau)?;
    /// scene.forward_dynamics(&mut workspace, &q, &qd, &tau, &[], &mut qdd)?;
    /// assert!(qdd.iter().all(|a| a.abs() < 1e-12)); // static equilibrium
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], [`Error::Argument`] for a workspace of another scene,
    /// [`Error::SingularJoint`] if a pivot has no significant digits, and [`Error::Constraint`] if the connections
    /// contradict each other or the state violates them (see [`Scene::constrained_dynamics`]).
    fn forward_dynamics(q, qd, tau) -> qdd = Algorithm::ForwardDynamics;

    /// Inverse dynamics: joint torques `tau` (nv) of tau = M qdd + bias - J^T wrenches.
    ///
    /// `q` (nq), `qd` and `qdd` (nv) are in SI units; `wrenches` is as in [`Scene::forward_dynamics`]. O(N).
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], and [`Error::Argument`] for a workspace of another scene.
    fn inverse_dynamics(q, qd, qdd) -> tau = |_| Algorithm::InverseDynamics;

    /// Nonlinear effects at one state: the bias torque H phi b (nv), with Coriolis, centrifugal and gravity terms, N m
    /// or N.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`] and [`Error::NotFinite`].
    fn bias_torque(q, qd) -> tau = |_| Algorithm::BiasTorque;

    /// Joint-space mass matrix M at `q`, (nv x nv), row-major, written to `out`. Armature is included.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`] and [`Error::NotFinite`].
    fn mass_matrix(q) -> out = |_| Algorithm::MassMatrix;
}

quantities! {
    /// Spatial momentum in the base frame: (angular momentum about the base origin, linear momentum), N m s and N s.
    /// O(N).
    ///
    /// # Errors
    ///
    /// [`Error::Shape`] and [`Error::NotFinite`].
    fn momentum(q, qd) -> SpatialVector = Momentum;
}

/// Pose of a link in the base frame, given the poses of all bodies.
fn on_base(link: &Link, bodies: &[RigidShift<f64>]) -> RigidShift<f64> {
    match link.body {
        Some(body) => bodies[body].compose(&link.placement),
        None => link.placement,
    }
}
