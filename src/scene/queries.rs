//! The algorithms on one state of a scene, with arguments checked and faults named.

use super::{Joint, Link, Scene};
use crate::batch::chunk::{Algorithm, Arguments};
use crate::batch::own::OwnKernels;
use crate::dynamics::mass_inverse::InverseScratch;
use crate::dynamics::{self, Energy};
use crate::error::{Error, check_finite, check_length};
use crate::filter::Form;
use crate::filter::pivots::{LostPivot, PivotMonitor};
use crate::kinematics;
use crate::planar::PlanarScratch;
use crate::spatial::{RigidShift, SpatialVector};
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// How far the norm of a quaternion may be from one.
pub const QUATERNION_SLACK: f64 = 1e-3;

/// Scratch of M and M^-1, which can be as large as they, is made with the workspace up to so many degrees of freedom.
pub const MATRICES_AHEAD: usize = 128;

/// Wrenches on links, as forces on bodies: empty, or one a body in the body's frame.
pub type BodyWrenches = Vec<SpatialVector<f64>>;

impl Scene {
    /// Scratch for the methods below; one for each thread.
    ///
    /// With the compiled kernels of one state, so that these methods allocate nothing; but scratch of the two matrices is made by their
    /// first call where the scene has more than 128 degrees of freedom.
    #[must_use]
    pub fn workspace(&self) -> Workspace<f64> {
        let planar = self.planar.as_ref().map(PlanarScratch::new);
        Workspace { planar, kernels: OwnKernels::ready(self), ..Workspace::new(&self.model) }
    }

    /// Scratch for [`Scene::mass_matrix_inverse`].
    #[must_use]
    pub fn inverse_scratch(&self) -> InverseScratch<f64> {
        InverseScratch::new(&self.model)
    }

    /// Checks a configuration: length, finite, quaternions within 1e-3 of unit norm.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], or [`Error::Argument`] naming the joint of the quaternion.
    pub fn check_configuration(&self, argument: &str, q: &[f64]) -> Result<(), Error> {
        check_length(argument, q.len(), self.nq())?;
        check_finite(argument, q)?;
        for joint in self.joints() {
            let Some(quaternion) = joint.quaternion() else { continue };
            let norm = q[quaternion].iter().map(|x| x * x).sum::<f64>().sqrt();
            if !((norm - 1.0).abs() <= QUATERNION_SLACK) {
                return Err(Error::argument(
                    argument,
                    format!("a quaternion of norm {norm} for joint {:?}", joint.name),
                    "unit norm, to within 1e-3",
                ));
            }
        }
        Ok(())
    }

    /// Checks rates, accelerations or torques of one state.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`] or [`Error::NotFinite`].
    pub fn check_rates(&self, argument: &str, values: &[f64]) -> Result<(), Error> {
        check_length(argument, values.len(), self.nv())?;
        check_finite(argument, values)
    }

    /// Forward dynamics of one state, in the form of the workspace.
    ///
    /// By the compiled kernels of [`Scene::evaluate`], as all of these five; a state that they doubt is done again by
    /// [`Scene::recursion`], and so is every state where the workspace is to estimate errors. What else the workspace holds afterwards is
    /// not said.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, a workspace of another scene, and [`Error::SingularJoint`] where a pivot is lost.
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
        self.run_one(workspace, None, algorithm, &Arguments { q, qd, u: tau, wrenches }, qdd)
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
        self.run_one(workspace, None, Algorithm::InverseDynamics, &Arguments { q, qd, u: qdd, wrenches }, tau)
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

    /// The mass matrix at `q`, (nv x nv) row by row.
    ///
    /// # Errors
    ///
    /// Wrong lengths and numbers that are not finite.
    pub fn mass_matrix(&self, workspace: &mut Workspace<f64>, q: &[f64], out: &mut [f64]) -> Result<(), Error> {
        let state = Arguments { q, ..Arguments::default() };
        self.run_one(workspace, None, Algorithm::MassMatrix, &state, out)
    }

    /// The inverse of the mass matrix at `q` in closed form (6.1), (nv x nv) row by row.
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
        let algorithm = Algorithm::MassMatrixInverse(workspace.form);
        self.run_one(workspace, Some(scratch), algorithm, &Arguments { q, ..Arguments::default() }, out)
    }

    /// By the kernels of one state; what they doubt, by the recursion.
    fn run_one(
        &self,
        workspace: &mut Workspace<f64>,
        inverse: Option<&mut InverseScratch<f64>>,
        algorithm: Algorithm,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        self.check_workspace(workspace)?;
        // Only the recursion writes its accuracy into the workspace.
        let estimated = workspace.estimates_error && matches!(algorithm, Algorithm::ForwardDynamics(_));
        let fits = self.fits(algorithm, state) && out.len() == self.width(algorithm);
        if fits && !estimated && workspace.kernels.run(self, algorithm, state, out) {
            return Ok(());
        }
        self.recursion(workspace, inverse, algorithm, state, out)
    }

    /// Whether a workspace has the lengths of this scene's.
    pub(crate) fn check_workspace(&self, workspace: &Workspace<f64>) -> Result<(), Error> {
        let (bodies, nv) = (workspace.shift.len(), workspace.measured.len());
        if (bodies, nv) == (self.model.bodies.len(), self.nv()) {
            return Ok(());
        }
        let found = format!("that of a scene of {bodies} bodies and {nv} degrees of freedom");
        let expected = format!(
            "this scene's own, from scene.workspace(): {} bodies and {} degrees of freedom",
            self.model.bodies.len(),
            self.nv()
        );
        Err(Error::argument("workspace", found, expected))
    }

    /// Kinetic and potential energy, J.
    ///
    /// # Errors
    ///
    /// Wrong lengths and numbers that are not finite.
    pub fn energy(&self, workspace: &mut Workspace<f64>, q: &[f64], qd: &[f64]) -> Result<Energy<f64>, Error> {
        self.check_configuration("q", q)?;
        self.check_rates("qd", qd)?;
        self.check_workspace(workspace)?;
        let energy = dynamics::energy(&self.model, workspace, q, qd);
        self.check_result("energy", &[energy.kinetic, energy.potential])?;
        Ok(energy)
    }

    /// Spatial momentum (angular about the base's origin, linear) in the base frame.
    ///
    /// # Errors
    ///
    /// Wrong lengths and numbers that are not finite.
    pub fn momentum(&self, workspace: &mut Workspace<f64>, q: &[f64], qd: &[f64]) -> Result<SpatialVector<f64>, Error> {
        self.check_configuration("q", q)?;
        self.check_rates("qd", qd)?;
        self.check_workspace(workspace)?;
        let momentum = dynamics::momentum(&self.model, workspace, q, qd);
        self.check_result("momentum", momentum.as_slice())?;
        Ok(momentum)
    }

    /// Where every link is: from its frame to the base's, in the order of [`Scene::links`].
    ///
    /// # Errors
    ///
    /// Wrong lengths and numbers that are not finite.
    pub fn placements(&self, q: &[f64]) -> Result<Vec<RigidShift<f64>>, Error> {
        self.check_configuration("q", q)?;
        let mut bodies: Vec<RigidShift<f64>> = Vec::with_capacity(self.model.bodies.len());
        for (body, stage) in self.model.bodies.iter().zip(&self.model.system.stages) {
            let shift = kinematics::joint_shift(body, q);
            bodies.push(match stage.parent {
                Some(parent) => bodies[parent].compose(&shift),
                None => shift,
            });
        }
        Ok(self.links().iter().map(|link| on_base(link, &bodies)).collect())
    }

    /// The Jacobian of a link, (6 x nv) row by row: its spatial velocity (angular, linear) at its origin and in its own
    /// frame is J qd, and a wrench w on it there gives the joint torques J^T w.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, an unknown link.
    pub fn jacobian(&self, q: &[f64], link: &str, out: &mut [f64]) -> Result<(), Error> {
        let link = self.link(link)?;
        self.check_configuration("q", q)?;
        let nv = self.nv();
        check_length("out", out.len(), 6 * nv)?;
        out.fill(0.0);
        // Inward from the link: `to_body` carries forces on the link to the body at hand, so its transpose carries motions.
        let mut to_body = link.placement;
        let mut at = link.body;
        while let Some(k) = at {
            let stage = &self.model.system.stages[k];
            for i in 0..stage.rows.count() {
                let column = to_body.motion_to_child(&stage.rows.row(i).to_column());
                for (row, value) in column.iter().enumerate() {
                    out[row * nv + stage.first_row + i] = *value;
                }
            }
            to_body = kinematics::joint_shift(&self.model.bodies[k], q).compose(&to_body);
            at = stage.parent;
        }
        self.check_result("jacobian", out)
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
        let mut on_bodies = vec![Vector6::zeros(); self.model.bodies.len()];
        for (name, wrench) in wrenches {
            let link = self.link(name).map_err(|error| error.of_argument("wrenches"))?;
            check_finite(&format!("wrench on {name:?}"), wrench.as_slice())?;
            if let Some(body) = link.body {
                on_bodies[body] += link.placement.force_to_parent(&wrench);
            }
        }
        Ok(on_bodies)
    }

    /// Turns a lost pivot into an error that names the joint; a pivot that is not finite comes of overflow.
    pub(crate) fn check_pivots(&self, workspace: &Workspace<f64>, monitor: PivotMonitor<f64>) -> Result<(), Error> {
        workspace.lost_pivot(&self.model, &monitor).map_or(Ok(()), |lost| Err(self.singular(lost)))
    }

    /// The error that names the joint of a lost pivot.
    pub(crate) fn singular(&self, lost: LostPivot) -> Error {
        let joint = self.joint_of_body(lost.stage);
        let name = |of: fn(&Joint) -> &String| joint.map(of).cloned().unwrap_or_default();
        if let Some(&value) = [lost.pivot, lost.terms].iter().find(|value| !value.is_finite()) {
            let what = name(|joint| &joint.name);
            let argument = format!("inertia along the axis of joint {what:?} (result; the arguments overflow)");
            return Error::NotFinite { argument, index: lost.row, value, state: None };
        }
        Error::SingularJoint {
            joint: name(|joint| &joint.name),
            link: name(|joint| &joint.child),
            state: None,
            pivot: lost.pivot,
            terms: lost.terms,
        }
    }

    /// The square-root form needs a root of every inertia.
    pub(crate) fn check_form(&self, workspace: &Workspace<f64>) -> Result<(), Error> {
        self.check_roots(workspace.form)
    }

    /// The same of a form.
    pub(crate) fn check_roots(&self, form: Form) -> Result<(), Error> {
        if form != Form::SquareRoot {
            return Ok(());
        }
        self.model.inertia_roots.iter().position(Option::is_none).map_or(Ok(()), |body| Err(self.indefinite(body)))
    }

    /// What is wrong with the inertia of a body that has no root.
    pub(crate) fn indefinite(&self, body: usize) -> Error {
        let link = self.joint_of_body(body).map(|joint| joint.child.clone()).unwrap_or_default();
        Error::argument(
            format!("inertia of link {link:?}"),
            "a negative principal inertia",
            "an inertia that a body can have: as the covariance of a force it has a square root",
        )
    }

    pub(super) fn check_wrenches(&self, wrenches: &[SpatialVector<f64>]) -> Result<(), Error> {
        if !wrenches.is_empty() {
            check_length("wrenches", wrenches.len(), self.model.bodies.len())?;
            wrenches.iter().try_for_each(|wrench| check_finite("wrenches", wrench.as_slice()))?;
        }
        Ok(())
    }

    /// Finite arguments can still overflow on the way.
    #[allow(clippy::unused_self)] // reads as the other checks do
    pub(crate) fn check_result(&self, what: &str, values: &[f64]) -> Result<(), Error> {
        // The name is written only where it is needed: this is on the path of every call.
        if values.iter().all(|value| value.is_finite()) {
            return Ok(());
        }
        check_finite(&format!("{what} (result; the arguments overflow)"), values)
    }
}

impl Joint {
    /// Where its quaternion is in q, if it has one.
    #[must_use]
    pub fn quaternion(&self) -> Option<std::ops::Range<usize>> {
        use super::JointKind::{Floating, Spherical};
        match self.kind {
            Spherical => Some(self.q.clone()),
            Floating => Some(self.q.start + 3..self.q.end),
            _ => None,
        }
    }
}

/// A link's placement on the base, from those of the bodies.
fn on_base(link: &Link, bodies: &[RigidShift<f64>]) -> RigidShift<f64> {
    match link.body {
        Some(body) => bodies[body].compose(&link.placement),
        None => link.placement,
    }
}
