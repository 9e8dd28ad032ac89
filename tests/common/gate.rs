//! Scenes for instruction counts and golden outputs: together they contain all variants of the joint transformations.

use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
use phipsi::spatial::Symmetric3;
use phipsi::{Algorithm, Derivatives, Form, Products, Scene, scenes};

/// Every algorithm with kernels, by its name.
pub const ALGORITHMS: [(&str, Algorithm); 16] = [
    ("forward_dynamics/auto", Algorithm::ForwardDynamics(Form::Auto)),
    ("forward_dynamics/covariance", Algorithm::ForwardDynamics(Form::Covariance)),
    ("forward_dynamics/square-root", Algorithm::ForwardDynamics(Form::SquareRoot)),
    ("inverse_dynamics", Algorithm::InverseDynamics),
    ("bias_torque", Algorithm::BiasTorque),
    ("mass_matrix", Algorithm::MassMatrix),
    ("mass_matrix_inverse/auto", Algorithm::MassMatrixInverse(Form::Auto)),
    ("mass_matrix_inverse/covariance", Algorithm::MassMatrixInverse(Form::Covariance)),
    ("inverse_dynamics_derivatives", Algorithm::Derivatives(Derivatives::InverseDynamics)),
    ("forward_dynamics_derivatives/auto", Algorithm::Derivatives(Derivatives::ForwardDynamics(Form::Auto))),
    ("forward_dynamics_derivatives/covariance", Algorithm::Derivatives(Derivatives::ForwardDynamics(Form::Covariance))),
    ("coriolis_matrix", Algorithm::Derivatives(Derivatives::CoriolisMatrix)),
    ("inverse_dynamics_vjp", Algorithm::Products(Products::gradient(None))),
    ("forward_dynamics_jvp/auto", Algorithm::Products(Products::tangent(Some(Form::Auto)))),
    ("forward_dynamics_vjp/auto", Algorithm::Products(Products::gradient(Some(Form::Auto)))),
    ("forward_dynamics_vjp/constants", Algorithm::Products(Products::gradient(Some(Form::Auto)).with_constants())),
];

/// Names of the scenes.
pub const SCENES: [&str; 4] = ["chain_7", "oblique", "slides", "branched"];

/// One of [`SCENES`].
pub fn scene(name: &str) -> Option<Scene> {
    match name {
        "chain_7" => scenes::chain(7).ok(),
        "oblique" => Arm::new().chain("base", &OBLIQUE).scene(false),
        "slides" => Arm::new().chain("base", &SLIDES).scene(false),
        "branched" => {
            let mut arm = Arm::new();
            for _ in 0..4 {
                arm = arm.chain("base", &LEG);
            }
            for _ in 0..2 {
                arm = arm.chain("base", &OBLIQUE[..4]);
            }
            arm.scene(true)
        }
        _ => None,
    }
}

/// A joint: its type, its axis, and the rotation of its frame at zero as (x, y, z) angles about the axes of the
/// parent.
type Joint = (JointKind, [f64; 3], [f64; 3]);

/// Axes that are not parallel to those of the parent, and one after a right angle.
const OBLIQUE: [Joint; 7] = [
    (JointKind::Revolute, [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]),
    (JointKind::Revolute, [0.0, 0.6, 0.8], [0.0, 0.0, 0.0]),
    (JointKind::Revolute, [0.48, 0.6, 0.64], [0.0, 0.0, 0.0]),
    (JointKind::Revolute, [0.0, 1.0, 0.0], [0.5, 0.0, 0.0]),
    (JointKind::Continuous, [0.0, 0.0, 1.0], [std::f64::consts::FRAC_PI_2, 0.0, 0.3]),
    (JointKind::Revolute, [1.0, 0.0, 0.0], [0.2, -0.4, 0.7]),
    (JointKind::Revolute, [0.0, 0.0, -1.0], [0.0, 0.5, 0.0]),
];

/// A rail, an arm, an oblique and an aligned finger; a screw and a joint with three degrees of freedom.
const SLIDES: [Joint; 8] = [
    (JointKind::Prismatic, [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
    (JointKind::Revolute, [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]),
    (JointKind::Revolute, [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]),
    (JointKind::Prismatic, [0.0, 0.6, 0.8], [0.3, 0.0, 0.0]),
    (JointKind::Screw { pitch: 0.05 }, [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]),
    (JointKind::Spherical, [0.0, 0.0, 1.0], [0.1, 0.2, 0.3]),
    (JointKind::Prismatic, [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]),
    (JointKind::Revolute, [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
];

/// A leg with a canted hip.
const LEG: [Joint; 3] = [
    (JointKind::Revolute, [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
    (JointKind::Revolute, [0.0, 1.0, 0.0], [0.4, 0.0, 0.0]),
    (JointKind::Revolute, [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]),
];

/// Links and joints with irregular constants, all different.
struct Arm {
    builder: SceneBuilder,
    bodies: u32,
}

impl Arm {
    fn new() -> Self {
        let mut arm = Self { builder: SceneBuilder::new(), bodies: 0 };
        let base = arm.link("base".to_owned());
        arm.builder = arm.builder.link(base);
        arm
    }

    /// A value in -1 to 1 for this body.
    fn number(&self, which: u32) -> f64 {
        (1.0 + 2.7 * f64::from(self.bodies) + 4.1 * f64::from(which)).sin()
    }

    fn link(&self, name: String) -> LinkDescription {
        let at = |i| self.number(i);
        let central = [0.3 + 0.02 * at(3), 0.02, -0.01 * at(4), 0.25, 0.03 * at(5), 0.28];
        let inertial = Inertial {
            mass: 1.5 + 0.5 * at(6),
            center: [0.1 * at(0), 0.1 * at(1), 0.2 * at(2)].into(),
            central: Symmetric3::new(central.map(|x| 0.1 * x)),
        };
        LinkDescription { name, inertial: Some(inertial) }
    }

    fn chain(mut self, on: &str, joints: &[Joint]) -> Self {
        let mut parent = on.to_owned();
        for &(kind, axis, angles) in joints {
            self.bodies += 1;
            let name = format!("link_{}", self.bodies);
            let mut joint = JointDescription::new(format!("joint_{}", self.bodies), kind, &parent, &name);
            joint.axis = axis.into();
            joint.origin.rotation = *nalgebra::Rotation3::from_euler_angles(angles[0], angles[1], angles[2]).matrix();
            joint.origin.lever = [0.2 * self.number(7), 0.1 * self.number(8), 0.4].into();
            self.builder = std::mem::take(&mut self.builder).link(self.link(name.clone())).joint(joint);
            parent = name;
        }
        self
    }

    fn scene(self, floating: bool) -> Option<Scene> {
        self.builder.floating_base(floating).build().ok()
    }
}
