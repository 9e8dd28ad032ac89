//! What is computed, from which arguments, and who computes it.

use crate::filter::Form;
use crate::kinematics::{AccelerationKind, Frame, ReferenceFrame};
use crate::spatial::SpatialVector;

/// What is computed from one state (q, qd, u).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Algorithm {
    /// u = tau; gives qdd, (nv).
    ForwardDynamics(Form),
    /// u = tau, seed = the compliance of each row of the connections (m), or nothing where none gives way; gives qdd (nv), the forces of the connections (m), the rank of their rows and
    /// the largest that is left of these, as [`Scene::constrained_dynamics`](crate::Scene::constrained_dynamics).
    ConstrainedDynamics(Form),
    /// u = qdd; gives tau, (nv).
    InverseDynamics,
    /// No u; gives the torque of the bias, (nv).
    BiasTorque,
    /// q alone; gives M, (nv x nv) row by row.
    MassMatrix,
    /// q alone; gives M^-1, (nv x nv) row by row.
    MassMatrixInverse(Form),
    /// Matrices that come of derivatives.
    Derivatives(Derivatives),
    /// Products with Jacobians, without the matrices.
    Products(Products),
}

/// A product with the Jacobian of inverse or forward dynamics; see [`dynamics::derivatives`](crate::dynamics::derivatives).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Products {
    /// u = qdd, seed = (dq, dqd, dqdd); gives dtau, (nv).
    InverseTangent,
    /// The same along changes of what is constant too, with which the third vector of the seed goes on: armature (nv), gravity (3), wrenches (bodies x 6), inertial
    /// parameters (bodies x 10), as [`Directions`](crate::dynamics::derivatives::Directions) has them.
    InverseTangents,
    /// u = qdd, seed = the cotangent of tau; gives those of q, qd and qdd, (3 x nv).
    InverseGradient,
    /// The same and those of what is constant, one after another: armature (nv), gravity (3), wrenches (bodies x 6), inertial parameters (bodies x 10), as
    /// [`Constants`](crate::dynamics::derivatives::Constants) has them.
    InverseGradients,
    /// u = tau, seed = (dq, dqd, dtau); gives dqdd, (nv).
    ForwardTangent(Form),
    /// The same along changes of what is constant too, as [`Products::InverseTangents`].
    ForwardTangents(Form),
    /// u = tau, seed = the cotangent of qdd; gives those of q, qd and tau, (3 x nv).
    ForwardGradient(Form),
    /// The same and those of what is constant, as [`Products::InverseGradients`].
    ForwardGradients(Form),
}

impl Products {
    /// What u is.
    #[must_use]
    #[doc(hidden)]
    pub fn third(self) -> &'static str {
        if self.form().is_some() { "tau" } else { "qdd" }
    }

    /// What the seed is, by the names of its vectors, (nv) each but where the third goes on with changes of what is constant.
    #[must_use]
    pub fn seeds(self) -> &'static [&'static str] {
        match self {
            Self::InverseTangent | Self::InverseTangents => &["dq", "dqd", "dqdd"],
            Self::ForwardTangent(_) | Self::ForwardTangents(_) => &["dq", "dqd", "dtau"],
            _ => &["cotangent"],
        }
    }

    /// Whether it goes along changes of what is constant too.
    #[must_use]
    pub(crate) fn takes_constants(self) -> bool {
        matches!(self, Self::InverseTangents | Self::ForwardTangents(_))
    }

    /// Whether it gives the gradients by what is constant too.
    #[must_use]
    pub(crate) fn gives_constants(self) -> bool {
        matches!(self, Self::InverseGradients | Self::ForwardGradients(_))
    }

    /// How many vectors, (nv) each, of a state it gives.
    #[must_use]
    #[doc(hidden)]
    pub fn count(self) -> usize {
        4 - self.seeds().len()
    }

    /// The form that it is done in, where it has any.
    #[must_use]
    pub fn form(self) -> Option<Form> {
        match self {
            Self::ForwardTangent(form)
            | Self::ForwardTangents(form)
            | Self::ForwardGradient(form)
            | Self::ForwardGradients(form) => Some(form),
            Self::InverseTangent | Self::InverseTangents | Self::InverseGradient | Self::InverseGradients => None,
        }
    }
}

/// What is differentiated; see [`dynamics::derivatives`](crate::dynamics::derivatives).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Derivatives {
    /// u = qdd; gives dtau/dq, dtau/dqd and M, (3 x nv x nv).
    InverseDynamics,
    /// u = tau; gives dqdd/dq, dqdd/dqd and M^-1, (3 x nv x nv).
    ForwardDynamics(Form),
    /// No u; gives the Coriolis matrix, (nv x nv).
    CoriolisMatrix,
    /// No u; gives dM/dt, (nv x nv).
    MassMatrix,
}

impl Derivatives {
    /// What u is; none is taken where there is no name.
    #[must_use]
    #[doc(hidden)]
    pub fn third(self) -> Option<&'static str> {
        match self {
            Self::InverseDynamics => Some("qdd"),
            Self::ForwardDynamics(_) => Some("tau"),
            Self::CoriolisMatrix | Self::MassMatrix => None,
        }
    }

    /// How many matrices.
    #[must_use]
    #[doc(hidden)]
    pub fn count(self) -> usize {
        if self.third().is_some() { 3 } else { 1 }
    }
}

/// What is asked of a robot beside its dynamics, at one state (q, qd, qdd), of which it reads what it needs: frames on links, mass centre, momentum, energy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Everyday<'a> {
    /// q; where a frame is, as a homogeneous matrix to the base, (4 x 4): [`Scene::placement`](crate::Scene::placement).
    Placement(&'a Frame<f64>),
    /// q, qd; [`Scene::velocity`](crate::Scene::velocity) of a frame, (6).
    Velocity(&'a Frame<f64>, ReferenceFrame),
    /// q, qd, qdd; [`Scene::acceleration`](crate::Scene::acceleration) of a frame, (6).
    Acceleration(&'a Frame<f64>, ReferenceFrame, AccelerationKind),
    /// q; [`Scene::jacobian`](crate::Scene::jacobian) of a frame, (6 x nv).
    Jacobian(&'a Frame<f64>, ReferenceFrame),
    /// q, qd; [`Scene::jacobian_rate`](crate::Scene::jacobian_rate) of a frame, (6 x nv).
    JacobianRate(&'a Frame<f64>, ReferenceFrame),
    /// q, qd; [`Scene::jacobian_rate_product`](crate::Scene::jacobian_rate_product) of a frame, (6).
    JacobianRateProduct(&'a Frame<f64>, ReferenceFrame),
    /// q; [`Scene::center_of_mass`](crate::Scene::center_of_mass), (3).
    CenterOfMass,
    /// q, qd; [`Scene::center_of_mass_velocity`](crate::Scene::center_of_mass_velocity), (3).
    CenterOfMassVelocity,
    /// q, qd, qdd; [`Scene::center_of_mass_acceleration`](crate::Scene::center_of_mass_acceleration), (3).
    CenterOfMassAcceleration,
    /// q; [`Scene::center_of_mass_jacobian`](crate::Scene::center_of_mass_jacobian), (3 x nv).
    CenterOfMassJacobian,
    /// q; [`Scene::centroidal_momentum_matrix`](crate::Scene::centroidal_momentum_matrix), (6 x nv).
    CentroidalMomentumMatrix,
    /// q, qd; [`Scene::centroidal_momentum_matrix_rate`](crate::Scene::centroidal_momentum_matrix_rate), (6 x nv).
    CentroidalMomentumMatrixRate,
    /// q, qd; [`Scene::momentum`](crate::Scene::momentum), (6).
    Momentum,
    /// q, qd; [`Scene::kinetic_energy`](crate::Scene::kinetic_energy), (1).
    KineticEnergy,
    /// q, qd; kinetic and potential energy, [`Scene::energy`](crate::Scene::energy), (2).
    Energy,
}

impl Everyday<'_> {
    /// The frame that it is of, if it is of one.
    pub(crate) fn frame(&self) -> Option<&Frame<f64>> {
        match self {
            Self::Placement(frame)
            | Self::Velocity(frame, _)
            | Self::Acceleration(frame, ..)
            | Self::Jacobian(frame, _)
            | Self::JacobianRate(frame, _)
            | Self::JacobianRateProduct(frame, _) => Some(frame),
            _ => None,
        }
    }

    /// Whether it gives a matrix with a column for each degree of freedom.
    pub(crate) fn has_columns(&self) -> bool {
        matches!(
            self,
            Self::Jacobian(..)
                | Self::JacobianRate(..)
                | Self::CenterOfMassJacobian
                | Self::CentroidalMomentumMatrix
                | Self::CentroidalMomentumMatrixRate
        )
    }

    /// How many numbers it is for one state of a robot of `nv` degrees of freedom.
    #[must_use]
    pub fn width(&self, nv: usize) -> usize {
        match self {
            Self::Placement(_) => 16,
            Self::Velocity(..) | Self::Acceleration(..) | Self::JacobianRateProduct(..) | Self::Momentum => 6,
            Self::CenterOfMass | Self::CenterOfMassVelocity | Self::CenterOfMassAcceleration => 3,
            Self::CenterOfMassJacobian => 3 * nv,
            Self::Jacobian(..)
            | Self::JacobianRate(..)
            | Self::CentroidalMomentumMatrix
            | Self::CentroidalMomentumMatrixRate => 6 * nv,
            Self::KineticEnergy => 1,
            Self::Energy => 2,
        }
    }

    /// How many arrays of a state it reads: q, then qd, then qdd.
    #[must_use]
    pub fn reads(&self) -> usize {
        match self {
            Self::Placement(_)
            | Self::Jacobian(..)
            | Self::CenterOfMass
            | Self::CenterOfMassJacobian
            | Self::CentroidalMomentumMatrix => 1,
            Self::Acceleration(..) | Self::CenterOfMassAcceleration => 3,
            _ => 2,
        }
    }
}

impl Algorithm {
    /// Whether it takes rates, and what its u is: none where there is no name. Wrenches go with u.
    #[must_use]
    pub fn reads(self) -> (bool, Option<&'static str>) {
        match self {
            Self::ForwardDynamics(_) | Self::ConstrainedDynamics(_) => (true, Some("tau")),
            Self::InverseDynamics => (true, Some("qdd")),
            Self::BiasTorque => (true, None),
            Self::MassMatrix | Self::MassMatrixInverse(_) => (false, None),
            Self::Derivatives(which) => (true, which.third()),
            Self::Products(which) => (true, Some(which.third())),
        }
    }

    /// What its seed is; most have none.
    #[must_use]
    pub fn seeds(self) -> &'static [&'static str] {
        match self {
            Self::Products(which) => which.seeds(),
            Self::ConstrainedDynamics(_) => &["compliance"],
            _ => &[],
        }
    }

    /// True if accelerations are computed: through the connections of a scene that has some.
    pub(crate) fn goes_through_connections(self) -> bool {
        match self {
            Self::ForwardDynamics(_)
            | Self::ConstrainedDynamics(_)
            | Self::Derivatives(Derivatives::ForwardDynamics(_)) => true,
            Self::Products(which) => which.form().is_some(),
            _ => false,
        }
    }

    /// The form that it is done in, where it has any.
    #[must_use]
    pub fn form(self) -> Option<Form> {
        match self {
            Self::ForwardDynamics(form)
            | Self::ConstrainedDynamics(form)
            | Self::MassMatrixInverse(form)
            | Self::Derivatives(Derivatives::ForwardDynamics(form)) => Some(form),
            Self::Products(which) => which.form(),
            _ => None,
        }
    }
}

/// The arguments of one state, in f64 or f32; what an algorithm does not take is empty.
#[derive(Debug, Clone, Copy, Default)]
pub struct Arguments<'a, P = f64> {
    /// Configuration, (nq).
    pub q: &'a [P],
    /// Rates, (nv).
    pub qd: &'a [P],
    /// Torques or accelerations, (nv).
    pub u: &'a [P],
    /// Forces on bodies, each in the body's frame, f64 always; empty where there are none.
    pub wrenches: &'a [SpatialVector<f64>],
    /// A direction or a cotangent: what [`Products`] multiply.
    pub seed: [&'a [P]; 3],
    /// The largest estimated error that form `auto` accepts, relative to the largest entry of the result; None: the usual one. See
    /// [`Workspace::tolerance`](crate::Workspace::tolerance).
    pub tolerance: Option<f64>,
}

impl<P> Arguments<'_, P> {
    /// What an algorithm takes of them; the rest is empty.
    #[must_use]
    pub fn read_by(self, algorithm: Algorithm) -> Self {
        let (rates, third) = algorithm.reads();
        let qd = if rates { self.qd } else { &[] };
        let (u, wrenches) = if third.is_some() { (self.u, self.wrenches) } else { (&[][..], &[][..]) };
        let mut seed = [&[][..]; 3];
        for (seed, (given, _)) in seed.iter_mut().zip(self.seed.into_iter().zip(algorithm.seeds())) {
            *seed = given;
        }
        Self { q: self.q, qd, u, wrenches, seed, tolerance: algorithm.form().and(self.tolerance) }
    }
}

/// What runs chunks of states in `P`, whatever its scalar.
pub trait Chunks<P>: Send + Sync {
    /// How many states at once.
    fn lanes(&self) -> usize;

    /// Runs `algorithm` on one state or more, at most as many as there are lanes, of equal shapes; results one after another in
    /// `out`. Gives the lanes in doubt as bits; their results mean nothing.
    fn run(&mut self, algorithm: Algorithm, states: &[Arguments<'_, P>], out: &mut [P]) -> u64;

    /// The same of an everyday function: every lane is in doubt where there are no kernels, as of f32.
    fn everyday(&mut self, what: &Everyday<'_>, states: &[Arguments<'_, P>], out: &mut [P]) -> u64;

    /// The estimated error of the largest acceleration of one lane of the last run of forward dynamics in form `auto`, in its unit.
    fn error(&self, lane: usize) -> f64;
}
