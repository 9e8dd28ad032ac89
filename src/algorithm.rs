//! The algorithms, the kinematic quantities and the table of their functions.
//!
//! The table has one row per function: its arguments and results with their shapes, its cost, and the function of which
//! it is the derivative. The evaluator, the argument checks, the methods of Python, the generated code and
//! `phipsi.compile` read it.

pub(crate) mod table;

use crate::error::{Error, choose};
use crate::filter::Form;
use crate::kinematics::{AccelerationKind, Frame, Link, ReferenceFrame};
use crate::model::StateModel;
use crate::spatial::SpatialVector;
use table::{Array, Axis, Compiled, CompiledFor, FunctionEntry, Sizes, functions};

/// The axes of the arrays in the table.
const Q: &[Axis] = &[Axis::Coordinates];
const V: &[Axis] = &[Axis::Velocities];
const VV: &[Axis] = &[Axis::Velocities, Axis::Velocities];
const SCALAR: &[Axis] = &[];
const POINT: &[Axis] = &[Axis::Fixed(3)];
const SPATIAL: &[Axis] = &[Axis::Fixed(6)];
const POSE: &[Axis] = &[Axis::Fixed(4), Axis::Fixed(4)];
const POSES: &[Axis] = &[Axis::Links, Axis::Fixed(4), Axis::Fixed(4)];
const POINT_V: &[Axis] = &[Axis::Fixed(3), Axis::Velocities];
const SPATIAL_V: &[Axis] = &[Axis::Fixed(6), Axis::Velocities];
const SPATIAL_VV: &[Axis] = &[Axis::Fixed(6), Axis::Velocities, Axis::Velocities];
const ROWS: &[Axis] = &[Axis::ConnectionRows];
const CONTACTS: &[Axis] = &[Axis::Contacts];
const CONTACT_POINTS: &[Axis] = &[Axis::Contacts, Axis::Fixed(3)];
const CONTACT_PAIRS: &[Axis] = &[Axis::Contacts, Axis::Fixed(3), Axis::Contacts, Axis::Fixed(3)];

/// Code for one robot, from this number of states.
const fn compiled(few: usize) -> Compiled {
    Compiled { few, watched: None, scenes: CompiledFor::Every }
}

/// As [`compiled`], with a function that also returns a margin.
const fn watched(few: usize, watched: &'static str) -> Compiled {
    Compiled { few, watched: Some(watched), scenes: CompiledFor::Every }
}

functions! {
    // Dynamics. Functions of code generation are in the order of its list.
    FORWARD_DYNAMICS = forward_dynamics(q: Q, qd: V, tau: V) -> (qdd: V),
        "Joint accelerations from torques",
        cost: [90, 0], has_form: true, has_dtype: true, compiled: Some(watched(48, "forward_dynamics_watched"));
    CONSTRAINED_DYNAMICS = constrained_dynamics(q: Q, qd: V, tau: V, compliance: ROWS)
        -> (qdd: V, forces: ROWS, rank: SCALAR, residual: SCALAR),
        "Joint accelerations through the connections of the scene, and the forces of these", has_form: true,
        compiled: Some(watched(48, "constrained_dynamics_watched").of(CompiledFor::Loops));
    INVERSE_DYNAMICS = inverse_dynamics(q: Q, qd: V, qdd: V) -> (tau: V),
        "Joint torques from joint accelerations", cost: [50, 0], has_dtype: true, compiled: Some(compiled(128));
    BIAS_TORQUE = bias_torque(q: Q, qd: V) -> (tau: V),
        "Joint torques at which no joint accelerates", cost: [50, 0], has_dtype: true, compiled: Some(compiled(128));
    MASS_MATRIX = mass_matrix(q: Q) -> (mass: VV),
        "The mass matrix, row by row",
        instead: Some("inverse_dynamics, which multiplies by it"),
        cost: [30, 0], has_dtype: true, compiled: Some(compiled(64));
    MASS_MATRIX_INVERSE = mass_matrix_inverse(q: Q) -> (inverse: VV),
        "The inverse of the mass matrix, row by row",
        instead: Some("forward_dynamics, which multiplies by it"),
        cost: [60, 0], has_form: true, has_dtype: true, compiled: Some(watched(32, "mass_matrix_inverse_watched"));
    FORWARD_DYNAMICS_DERIVATIVES = forward_dynamics_derivatives(q: Q, qd: V, tau: V)
        -> (dqdd_dq: VV, dqdd_dqd: VV, Minv: VV),
        "Derivatives of joint accelerations with respect to q, qd and tau, each row by row",
        derivative_of: Some("forward_dynamics"),
        instead: Some("differences of forward_dynamics"), cost: [200, 10], has_form: true,
        compiled: Some(watched(24, "forward_dynamics_derivatives_watched").of(CompiledFor::Trees));
    INVERSE_DYNAMICS_DERIVATIVES = inverse_dynamics_derivatives(q: Q, qd: V, qdd: V)
        -> (dtau_dq: VV, dtau_dqd: VV, M: VV),
        "Derivatives of joint torques with respect to q, qd and qdd, each row by row",
        derivative_of: Some("inverse_dynamics"),
        instead: Some("differences of inverse_dynamics"), cost: [80, 10], compiled: Some(compiled(24));
    FORWARD_DYNAMICS_JVP = forward_dynamics_jvp(q: Q, qd: V, tau: V, dq: V, dqd: V, dtau: V) -> (dqdd: V),
        "The change of joint accelerations along a direction",
        derivative_of: Some("forward_dynamics"), cost: [250, 0], has_form: true,
        compiled: Some(watched(48, "forward_dynamics_jvp_watched").of(CompiledFor::Trees));
    FORWARD_DYNAMICS_VJP = forward_dynamics_vjp(q: Q, qd: V, tau: V, cotangent: V)
        -> (gradient_q: V, gradient_qd: V, gradient_tau: V),
        "Gradients of cotangent . qdd with respect to q, qd and tau",
        derivative_of: Some("forward_dynamics"), cost: [250, 0], has_form: true,
        compiled: Some(watched(48, "forward_dynamics_vjp_watched").of(CompiledFor::Trees));
    INVERSE_DYNAMICS_JVP = inverse_dynamics_jvp(q: Q, qd: V, qdd: V, dq: V, dqd: V, dqdd: V) -> (dtau: V),
        "The change of joint torques along a direction",
        derivative_of: Some("inverse_dynamics"), cost: [120, 0], compiled: Some(compiled(48));
    INVERSE_DYNAMICS_VJP = inverse_dynamics_vjp(q: Q, qd: V, qdd: V, cotangent: V)
        -> (gradient_q: V, gradient_qd: V, gradient_qdd: V),
        "Gradients of cotangent . tau with respect to q, qd and qdd",
        derivative_of: Some("inverse_dynamics"), cost: [120, 0], compiled: Some(compiled(48));
    CORIOLIS_MATRIX = coriolis_matrix(q: Q, qd: V) -> (C: VV),
        "The Coriolis matrix, row by row", instead: Some("bias_torque"), cost: [80, 10];
    MASS_MATRIX_DERIVATIVE = mass_matrix_derivative(q: Q, qd: V) -> (dM_dt: VV),
        "The time derivative of the mass matrix, row by row", derivative_of: Some("mass_matrix"),
        instead: Some("differences of mass_matrix"), cost: [80, 10];

    // Kinematic quantities. For a frame, the cost is per body on the path to the base.
    PLACEMENTS = placements(q: Q) -> (placements: POSES),
        "The poses of all links: homogeneous matrices from link to base, row by row",
        cost: [60, 0], compiled: Some(compiled(24));
    POSES_OF_LINKS = poses(q: Q) -> (poses: POSES),
        "The poses of all links in one array: homogeneous matrices from link to base, row by row", cost: [60, 0];
    PLACEMENT = placement(q: Q) -> (placement: POSE),
        "The pose of the link: a homogeneous matrix from link to base, row by row",
        cost: [40, 0], of_link: true, compiled: Some(compiled(128));
    JACOBIAN = jacobian(q: Q) -> (jacobian: SPATIAL_V),
        "The Jacobian of the link, row by row: its velocity (angular, linear) is J qd",
        derivative_of: Some("placement"), cost: [60, 0], of_link: true, compiled: Some(compiled(64));
    JACOBIAN_RATE = jacobian_rate(q: Q, qd: V) -> (rate: SPATIAL_V),
        "The time derivative of the Jacobian of the link, row by row",
        derivative_of: Some("jacobian"), cost: [120, 0], of_link: true;
    JACOBIAN_RATE_PRODUCT = jacobian_rate_product(q: Q, qd: V) -> (product: SPATIAL),
        "The time derivative of the Jacobian of the link times qd",
        derivative_of: Some("jacobian"), cost: [60, 0], of_link: true;
    VELOCITY = velocity(q: Q, qd: V) -> (velocity: SPATIAL),
        "The velocity (angular, linear) of the link", derivative_of: Some("placement"), cost: [60, 0], of_link: true;
    ACCELERATION = acceleration(q: Q, qd: V, qdd: V) -> (acceleration: SPATIAL),
        "The acceleration (angular, linear) of the link", derivative_of: Some("velocity"), cost: [60, 0], of_link: true;
    VELOCITY_DERIVATIVES = velocity_derivatives(q: Q, qd: V) -> (dv_dq: SPATIAL_V, jacobian: SPATIAL_V),
        "Derivatives of the velocity of the link with respect to q and qd, each row by row",
        derivative_of: Some("velocity"), cost: [150, 0], of_link: true;
    ACCELERATION_DERIVATIVES = acceleration_derivatives(q: Q, qd: V, qdd: V)
        -> (da_dq: SPATIAL_V, da_dqd: SPATIAL_V, jacobian: SPATIAL_V),
        "Derivatives of the acceleration of the link with respect to q, qd and qdd, each row by row",
        derivative_of: Some("acceleration"), cost: [250, 0], of_link: true;
    JACOBIAN_DERIVATIVES = jacobian_derivatives(q: Q) -> (hessian: SPATIAL_VV),
        "Derivatives of the Jacobian of the link with respect to q, row by row",
        derivative_of: Some("jacobian"), cost: [60, 20], of_link: true;
    CENTER_OF_MASS = center_of_mass(q: Q) -> (position: POINT),
        "The center of mass", needs_mass: true, cost: [40, 0];
    CENTER_OF_MASS_VELOCITY = center_of_mass_velocity(q: Q, qd: V) -> (velocity: POINT),
        "The velocity of the center of mass", derivative_of: Some("center_of_mass"), needs_mass: true, cost: [80, 0];
    CENTER_OF_MASS_ACCELERATION = center_of_mass_acceleration(q: Q, qd: V, qdd: V) -> (acceleration: POINT),
        "The acceleration of the center of mass",
        derivative_of: Some("center_of_mass_velocity"), needs_mass: true, cost: [80, 0];
    CENTER_OF_MASS_JACOBIAN = center_of_mass_jacobian(q: Q) -> (jacobian: POINT_V),
        "The Jacobian of the center of mass, row by row",
        derivative_of: Some("center_of_mass"), needs_mass: true, cost: [100, 0];
    CENTROIDAL_MOMENTUM_MATRIX = centroidal_momentum_matrix(q: Q) -> (matrix: SPATIAL_V),
        "The centroidal momentum matrix, row by row", needs_mass: true, cost: [100, 0];
    CENTROIDAL_MOMENTUM_MATRIX_RATE = centroidal_momentum_matrix_rate(q: Q, qd: V) -> (rate: SPATIAL_V),
        "The time derivative of the centroidal momentum matrix, row by row",
        derivative_of: Some("centroidal_momentum_matrix"), needs_mass: true, cost: [200, 0];
    CENTROIDAL_MOMENTUM_DERIVATIVES = centroidal_momentum_derivatives(q: Q, qd: V)
        -> (dh_dq: SPATIAL_V, matrix: SPATIAL_V),
        "Derivatives of the centroidal momentum with respect to q and qd, each row by row",
        derivative_of: Some("centroidal_momentum_matrix"), needs_mass: true, cost: [200, 0];
    MOMENTUM = momentum(q: Q, qd: V) -> (momentum: SPATIAL),
        "The momentum (angular about the origin of the base, linear)", cost: [60, 0];
    KINETIC_ENERGY = kinetic_energy(q: Q, qd: V) -> (kinetic: SCALAR),
        "The kinetic energy", cost: [60, 0];
    POTENTIAL_ENERGY = potential_energy(q: Q) -> (potential: SCALAR),
        "The potential energy of gravity", cost: [60, 0];
    ENERGY = energy(q: Q, qd: V) -> (kinetic: SCALAR, potential: SCALAR),
        "The kinetic and the potential energy", cost: [100, 0];

    // Contacts.
    CONTACT_GAPS = contact_gaps(q: Q) -> (gaps: CONTACTS),
        "The distance of each contact from its plane", cost: [20, 0],
        compiled: Some(compiled(128).of(CompiledFor::Contacts));
    CONTACT_VELOCITIES = contact_velocities(q: Q, qd: V) -> (velocities: CONTACT_POINTS),
        "The velocity of the point of each contact in the base frame", cost: [20, 0],
        compiled: Some(compiled(128).of(CompiledFor::Contacts));
    CONTACT_GRAM = contact_gram(q: Q) -> (gram: CONTACT_PAIRS),
        "J M^-1 J^T of the points of all contacts in the base frame, row by row", cost: [60, 10], has_form: true,
        compiled: Some(compiled(24).of(CompiledFor::TreesWithContacts));

    // In generated code only.
    FACTOR_WATCHED = factor_watched(q: Q) -> (margin: SCALAR),
        "The margin of the factor of the mass matrix; precision may be lost where it is negative";
}

/// An algorithm of one state (q, qd, u).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Algorithm {
    /// u = tau; returns qdd, (nv).
    ForwardDynamics(Form),
    /// u = tau, seed = the compliance of each row of the connections (m), or empty for rigid connections; returns qdd
    /// (nv), the forces of the connections (m), the rank of their rows and the largest residual of a row, as
    /// [`Scene::constrained_dynamics`](crate::Scene::constrained_dynamics).
    ConstrainedDynamics(Form),
    /// u = qdd; returns tau, (nv).
    InverseDynamics,
    /// No u; returns the torque of the bias, (nv).
    BiasTorque,
    /// q only; returns M, (nv x nv) row by row.
    MassMatrix,
    /// q only; returns M^-1, (nv x nv) row by row.
    MassMatrixInverse(Form),
    /// Matrices of derivatives.
    #[cfg(feature = "derivatives")]
    Derivatives(Derivatives),
    /// Products with Jacobians, without the matrices.
    #[cfg(feature = "derivatives")]
    Products(Products),
}

/// Number of scalars of all constants by which products with Jacobians differentiate: armature (nv), gravity (3),
/// wrenches (bodies x 6) and inertial parameters (bodies x 10).
pub(crate) fn constants_width(nv: usize, bodies: usize) -> usize {
    nv + 3 + 16 * bodies
}

/// A product with the Jacobian of inverse or forward dynamics; see
/// [`dynamics::derivatives`](crate::dynamics::derivatives).
#[cfg(feature = "derivatives")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Products {
    form: Option<Form>,
    is_gradient: bool,
    has_constants: bool,
}

#[cfg(feature = "derivatives")]
impl Products {
    /// The change along a direction, (nv). Without a form of inverse dynamics: u = qdd, seed = (dq, dqd, dqdd); returns
    /// dtau. With a form of forward dynamics: u = tau, seed = (dq, dqd, dtau); returns dqdd.
    #[must_use]
    pub const fn tangent(form: Option<Form>) -> Self {
        Self { form, is_gradient: false, has_constants: false }
    }

    /// The gradients for a cotangent, (3 x nv). Without a form of inverse dynamics: u = qdd, seed = the cotangent of
    /// tau; returns those of q, qd and qdd. With a form of forward dynamics: u = tau, seed = the cotangent of qdd;
    /// returns those of q, qd and tau.
    #[must_use]
    pub const fn gradient(form: Option<Form>) -> Self {
        Self { form, is_gradient: true, has_constants: false }
    }

    /// The same with constants: armature (nv), gravity (3), wrenches (bodies x 6), inertial parameters (bodies x 10).
    ///
    /// A direction has their changes at the end of the third vector of the seed, in the order of
    /// [`Directions`](crate::dynamics::derivatives::Directions). Gradients are followed by theirs, in the order of
    /// [`Constants`](crate::dynamics::derivatives::Constants).
    #[must_use]
    pub const fn with_constants(self) -> Self {
        Self { has_constants: true, ..self }
    }

    /// Its row of the table, the same with and without constants.
    #[must_use]
    pub fn entry(self) -> &'static FunctionEntry {
        match (self.form, self.is_gradient) {
            (None, false) => &INVERSE_DYNAMICS_JVP,
            (None, true) => &INVERSE_DYNAMICS_VJP,
            (Some(_), false) => &FORWARD_DYNAMICS_JVP,
            (Some(_), true) => &FORWARD_DYNAMICS_VJP,
        }
    }

    /// True if the direction includes changes of constants (armature, gravity, wrenches, inertial parameters).
    #[must_use]
    pub(crate) fn takes_constants(self) -> bool {
        self.has_constants && !self.is_gradient
    }

    /// True if the results include the gradients with respect to these constants.
    #[must_use]
    pub(crate) fn gives_constants(self) -> bool {
        self.has_constants && self.is_gradient
    }

    /// True if it computes gradients from a cotangent, false if it computes a change along a direction.
    pub(crate) fn is_gradient(self) -> bool {
        self.is_gradient
    }

    /// Its form, if it is of forward dynamics.
    #[must_use]
    pub fn form(self) -> Option<Form> {
        self.form
    }
}

/// A matrix of derivatives; see [`dynamics::derivatives`](crate::dynamics::derivatives).
#[cfg(feature = "derivatives")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Derivatives {
    /// u = qdd; returns dtau/dq, dtau/dqd and M, (3 x nv x nv).
    InverseDynamics,
    /// u = tau; returns dqdd/dq, dqdd/dqd and M^-1, (3 x nv x nv).
    ForwardDynamics(Form),
    /// No u; returns the Coriolis matrix, (nv x nv).
    CoriolisMatrix,
    /// No u; returns dM/dt, (nv x nv).
    MassMatrix,
}

#[cfg(feature = "derivatives")]
impl Derivatives {
    /// Its row of the table.
    #[must_use]
    pub fn entry(self) -> &'static FunctionEntry {
        match self {
            Self::InverseDynamics => &INVERSE_DYNAMICS_DERIVATIVES,
            Self::ForwardDynamics(_) => &FORWARD_DYNAMICS_DERIVATIVES,
            Self::CoriolisMatrix => &CORIOLIS_MATRIX,
            Self::MassMatrix => &MASS_MATRIX_DERIVATIVE,
        }
    }
}

/// A quantity that depends on the state (q, qd, qdd) alone, not on forces: the motion of a frame on a link, the
/// center of mass, momentum, energy.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum KinematicQuantity<'a> {
    /// q; [`Scene::poses`](crate::Scene::poses) of these links, (links x 4 x 4).
    Poses(&'a [Link]),
    /// q; the pose of a frame, as a homogeneous matrix to the base, (4 x 4):
    /// [`Scene::placement`](crate::Scene::placement).
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
    /// q, qd; [`Scene::velocity_derivatives`](crate::Scene::velocity_derivatives) of a frame, (2 x 6 x nv).
    VelocityDerivatives(&'a Frame<f64>, ReferenceFrame),
    /// q, qd, qdd; [`Scene::acceleration_derivatives`](crate::Scene::acceleration_derivatives) of a frame,
    /// (3 x 6 x nv).
    AccelerationDerivatives(&'a Frame<f64>, ReferenceFrame, AccelerationKind),
    /// q; [`Scene::jacobian_derivatives`](crate::Scene::jacobian_derivatives) of a frame, (6 x nv x nv).
    JacobianDerivatives(&'a Frame<f64>, ReferenceFrame),
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
    /// q, qd; [`Scene::centroidal_momentum_derivatives`](crate::Scene::centroidal_momentum_derivatives), (2 x 6 x nv).
    CentroidalMomentumDerivatives,
    /// q, qd; [`Scene::momentum`](crate::Scene::momentum), (6).
    Momentum,
    /// q, qd; [`Scene::kinetic_energy`](crate::Scene::kinetic_energy), (1).
    KineticEnergy,
    /// q; [`Scene::potential_energy`](crate::Scene::potential_energy), (1).
    PotentialEnergy,
    /// q, qd; kinetic and potential energy, [`Scene::energy`](crate::Scene::energy), (2).
    Energy,
}

impl KinematicQuantity<'_> {
    /// Its frame, if it is a quantity of a frame.
    pub(crate) fn frame(&self) -> Option<&Frame<f64>> {
        match self {
            Self::Placement(frame)
            | Self::Velocity(frame, _)
            | Self::Acceleration(frame, ..)
            | Self::Jacobian(frame, _)
            | Self::JacobianRate(frame, _)
            | Self::JacobianRateProduct(frame, _)
            | Self::VelocityDerivatives(frame, _)
            | Self::AccelerationDerivatives(frame, ..)
            | Self::JacobianDerivatives(frame, _) => Some(frame),
            _ => None,
        }
    }

    /// Its row of the table.
    #[must_use]
    pub fn entry(&self) -> &'static FunctionEntry {
        match self {
            Self::Poses(_) => &POSES_OF_LINKS,
            Self::Placement(_) => &PLACEMENT,
            Self::Velocity(..) => &VELOCITY,
            Self::Acceleration(..) => &ACCELERATION,
            Self::Jacobian(..) => &JACOBIAN,
            Self::JacobianRate(..) => &JACOBIAN_RATE,
            Self::JacobianRateProduct(..) => &JACOBIAN_RATE_PRODUCT,
            Self::VelocityDerivatives(..) => &VELOCITY_DERIVATIVES,
            Self::AccelerationDerivatives(..) => &ACCELERATION_DERIVATIVES,
            Self::JacobianDerivatives(..) => &JACOBIAN_DERIVATIVES,
            Self::CenterOfMass => &CENTER_OF_MASS,
            Self::CenterOfMassVelocity => &CENTER_OF_MASS_VELOCITY,
            Self::CenterOfMassAcceleration => &CENTER_OF_MASS_ACCELERATION,
            Self::CenterOfMassJacobian => &CENTER_OF_MASS_JACOBIAN,
            Self::CentroidalMomentumMatrix => &CENTROIDAL_MOMENTUM_MATRIX,
            Self::CentroidalMomentumMatrixRate => &CENTROIDAL_MOMENTUM_MATRIX_RATE,
            Self::CentroidalMomentumDerivatives => &CENTROIDAL_MOMENTUM_DERIVATIVES,
            Self::Momentum => &MOMENTUM,
            Self::KineticEnergy => &KINETIC_ENERGY,
            Self::PotentialEnergy => &POTENTIAL_ENERGY,
            Self::Energy => &ENERGY,
        }
    }

    /// The lengths of its axes for a robot of `nv` degrees of freedom.
    pub(crate) fn sizes(&self, nv: usize) -> Sizes {
        let links = if let Self::Poses(links) = self { links.len() } else { 0 };
        Sizes { nv, links, ..Sizes::default() }
    }

    /// The number of values for one state of a robot of `nv` degrees of freedom.
    #[must_use]
    pub fn width(&self, nv: usize) -> usize {
        self.entry().width(&self.sizes(nv))
    }

    /// The number of state arrays that it reads: q, then qd, then qdd.
    #[must_use]
    pub fn reads(&self) -> usize {
        self.entry().state
    }
}

impl std::str::FromStr for Algorithm {
    type Err = Error;

    /// The algorithm with the name of a method of the scene, for instance `forward_dynamics`; in form `auto` if it has
    /// a form.
    fn from_str(name: &str) -> Result<Self, Error> {
        let known: Vec<_> = Self::all(Form::Auto).map(|algorithm| (algorithm.entry().name, algorithm)).collect();
        choose("algorithm", name, &known)
    }
}

impl std::fmt::Display for Algorithm {
    /// The name, without the form.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.entry().name)
    }
}

impl Algorithm {
    /// Every name of an algorithm once, in this form and without changes of constants.
    pub(crate) fn all(form: Form) -> impl Iterator<Item = Self> {
        [
            Self::ForwardDynamics(form),
            Self::ConstrainedDynamics(form),
            Self::InverseDynamics,
            Self::BiasTorque,
            Self::MassMatrix,
            Self::MassMatrixInverse(form),
            #[cfg(feature = "derivatives")]
            Self::Derivatives(Derivatives::ForwardDynamics(form)),
            #[cfg(feature = "derivatives")]
            Self::Derivatives(Derivatives::InverseDynamics),
            #[cfg(feature = "derivatives")]
            Self::Derivatives(Derivatives::CoriolisMatrix),
            #[cfg(feature = "derivatives")]
            Self::Derivatives(Derivatives::MassMatrix),
            #[cfg(feature = "derivatives")]
            Self::Products(Products::tangent(Some(form))),
            #[cfg(feature = "derivatives")]
            Self::Products(Products::gradient(Some(form))),
            #[cfg(feature = "derivatives")]
            Self::Products(Products::tangent(None)),
            #[cfg(feature = "derivatives")]
            Self::Products(Products::gradient(None)),
        ]
        .into_iter()
    }

    /// Its row of the table.
    #[must_use]
    pub fn entry(self) -> &'static FunctionEntry {
        match self {
            Self::ForwardDynamics(_) => &FORWARD_DYNAMICS,
            Self::ConstrainedDynamics(_) => &CONSTRAINED_DYNAMICS,
            Self::InverseDynamics => &INVERSE_DYNAMICS,
            Self::BiasTorque => &BIAS_TORQUE,
            Self::MassMatrix => &MASS_MATRIX,
            Self::MassMatrixInverse(_) => &MASS_MATRIX_INVERSE,
            #[cfg(feature = "derivatives")]
            Self::Derivatives(which) => which.entry(),
            #[cfg(feature = "derivatives")]
            Self::Products(which) => which.entry(),
        }
    }

    /// True if it takes velocities, and the name of its u, None if it takes no u. Wrenches are taken with u.
    #[must_use]
    pub fn reads(self) -> (bool, Option<&'static str>) {
        self.entry().reads()
    }

    /// The vectors of its seed: a direction, a cotangent, the compliance of connections; most algorithms have none.
    #[must_use]
    pub fn seeds(self) -> &'static [Array] {
        self.entry().seeds()
    }

    /// True if it computes accelerations, which depend on the connections of a scene.
    pub(crate) fn goes_through_connections(self) -> bool {
        match self {
            Self::ForwardDynamics(_) | Self::ConstrainedDynamics(_) => true,
            #[cfg(feature = "derivatives")]
            Self::Derivatives(Derivatives::ForwardDynamics(_)) => true,
            #[cfg(feature = "derivatives")]
            Self::Products(which) => which.form().is_some(),
            _ => false,
        }
    }

    /// True if the direction in its seed includes changes of constants (armature, gravity, wrenches, inertial
    /// parameters).
    pub(crate) fn takes_constants(self) -> bool {
        match self {
            #[cfg(feature = "derivatives")]
            Self::Products(which) => which.takes_constants(),
            _ => false,
        }
    }

    /// True if its results include the gradients with respect to these constants.
    pub(crate) fn gives_constants(self) -> bool {
        match self {
            #[cfg(feature = "derivatives")]
            Self::Products(which) => which.gives_constants(),
            _ => false,
        }
    }

    /// Its form, if it has one.
    #[must_use]
    pub fn form(self) -> Option<Form> {
        match self {
            Self::ForwardDynamics(form) | Self::ConstrainedDynamics(form) | Self::MassMatrixInverse(form) => Some(form),
            #[cfg(feature = "derivatives")]
            Self::Derivatives(Derivatives::ForwardDynamics(form)) => Some(form),
            #[cfg(feature = "derivatives")]
            Self::Products(which) => which.form(),
            _ => None,
        }
    }
}

/// The arguments of one state. Arguments that an algorithm does not take are empty.
#[derive(Debug, Clone, Copy, Default)]
pub struct Arguments<'a> {
    /// Configuration, (nq).
    pub q: &'a [f64],
    /// Joint velocities, (nv).
    pub qd: &'a [f64],
    /// Torques or accelerations, (nv).
    pub u: &'a [f64],
    /// Forces on bodies, each in the frame of its body; empty without forces.
    pub wrenches: &'a [SpatialVector<f64>],
    /// A direction or a cotangent, by which [`Products`] multiply.
    pub seed: [&'a [f64]; 3],
    /// The largest estimated error that form `auto` accepts, relative to the largest entry of the result; None: the
    /// default. See [`Workspace::tolerance`](crate::Workspace::tolerance).
    pub tolerance: Option<f64>,
    /// The numbers of the model in which this state differs from the scene.
    pub model: StateModel<'a>,
}

impl Arguments<'_> {
    /// The arguments that an algorithm takes; the others become empty.
    #[must_use]
    pub fn read_by(self, algorithm: Algorithm) -> Self {
        let (rates, third) = algorithm.reads();
        let qd = if rates { self.qd } else { &[] };
        let (u, wrenches) = if third.is_some() { (self.u, self.wrenches) } else { (&[][..], &[][..]) };
        let mut seed = [&[][..]; 3];
        for (seed, (given, _)) in seed.iter_mut().zip(self.seed.into_iter().zip(algorithm.seeds())) {
            *seed = given;
        }
        let tolerance = algorithm.form().and(self.tolerance);
        Self { q: self.q, qd, u, wrenches, seed, tolerance, model: self.model }
    }
}

/// Kernels that run chunks of states, for any scalar type.
pub trait Chunks: Send + Sync {
    /// Number of states per call.
    fn lanes(&self) -> usize;

    /// Runs `algorithm` on one or more states of equal shapes, at most one state per lane. Writes the results one after
    /// another to `out`. Returns the lanes that need the fallback as bits; their results are undefined.
    fn run(&mut self, algorithm: Algorithm, states: &[Arguments<'_>], out: &mut [f64]) -> u64;

    /// As [`Chunks::run`], for a kinematic quantity: every lane needs the fallback if there are no kernels.
    fn kinematic_quantity(&mut self, what: &KinematicQuantity<'_>, states: &[Arguments<'_>], out: &mut [f64]) -> u64;

    /// The estimated error of the largest acceleration of one lane of the last run of forward dynamics in form
    /// `auto`, in its unit.
    fn error(&self, lane: usize) -> f64;
}
