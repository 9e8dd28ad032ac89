//! Common parts of the Rust tests: random scenes and states from a seed, and the table of tolerances.

pub mod arm;
#[cfg(feature = "codegen")]
pub mod codegen;
#[cfg(feature = "dense")]
pub mod filter;
#[cfg(feature = "derivatives")]
pub mod gate;
#[cfg(feature = "derivatives")]
pub mod lanes;
pub mod loops;
#[cfg(feature = "dense")]
pub mod matrices;
pub mod oracle;
#[cfg(feature = "dense")]
pub mod paper;
#[cfg(feature = "dense")]
pub mod sampling;
pub mod tolerance;

use nalgebra::{Matrix3, Rotation3, Vector3};
use phipsi::Scene;
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
use phipsi::spatial::{RigidShift, Symmetric3};

/// A small counter-based generator (splitmix64), so that every test has an explicit seed.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0xD1B5_4A32_D192_ED03)
    }

    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform in [low, high).
    #[allow(clippy::cast_precision_loss)] // 53 bits
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * ((self.bits() >> 11) as f64 / (1u64 << 53) as f64)
    }

    pub fn below(&mut self, n: usize) -> usize {
        usize::try_from(self.bits() % n as u64).unwrap()
    }

    pub fn vector(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.uniform(-1.0, 1.0))
    }

    pub fn rotation(&mut self) -> Matrix3<f64> {
        *Rotation3::new(self.vector() * 3.0).matrix()
    }

    pub fn array(&mut self, n: usize, size: f64) -> Vec<f64> {
        (0..n).map(|_| self.uniform(-size, size)).collect()
    }
}

/// Types of joints in a random scene.
pub const ALL_KINDS: [JointKind; 8] = [
    JointKind::Revolute,
    JointKind::Revolute,
    JointKind::Prismatic,
    JointKind::Continuous,
    JointKind::Screw { pitch: 0.2 },
    JointKind::Planar,
    JointKind::Spherical,
    JointKind::Floating,
];

/// A body of about 1 kg and 0.3 m with a physically possible inertia: six point masses and a shell.
pub fn random_inertial(random: &mut Random) -> Inertial {
    let mass = random.uniform(0.5, 2.0);
    let rotation = random.rotation();
    let (a, b, c) = (random.uniform(0.01, 0.05), random.uniform(0.01, 0.05), random.uniform(0.01, 0.05));
    let principal = Matrix3::from_diagonal(&Vector3::new(b + c, a + c, a + b));
    Inertial {
        mass,
        center: random.vector() * 0.3,
        central: Symmetric3::from_upper(&(rotation * principal * rotation.transpose())),
    }
}

/// All types, including fixed joints.
pub const KINDS_WITH_FIXED: [JointKind; 9] = [
    JointKind::Revolute,
    JointKind::Fixed,
    JointKind::Prismatic,
    JointKind::Continuous,
    JointKind::Screw { pitch: -0.3 },
    JointKind::Planar,
    JointKind::Spherical,
    JointKind::Floating,
    JointKind::Fixed,
];

/// Parameters of a random tree, which is reproducible.
#[derive(Debug, Clone, Copy)]
pub struct Tree<'k> {
    pub seed: u64,
    /// Number of joints, and of links except the base.
    pub bodies: usize,
    pub kinds: &'k [JointKind],
    /// Probability that a link is attached to any previous link and not to the last one; 0 gives a chain.
    pub branching: f64,
    /// Largest armature; 0: none.
    pub armature: f64,
    /// True if the base floats; it then has mass.
    pub floating: bool,
}

impl Tree<'_> {
    pub fn builder(self) -> SceneBuilder {
        let mut random = Random::new(self.seed);
        let inertial = self.floating.then(|| random_inertial(&mut random));
        let mut builder = SceneBuilder::new()
            .gravity([0.3, -0.5, -9.6])
            .floating_base(self.floating)
            .link(LinkDescription { name: "base".into(), inertial });
        for k in 0..self.bodies {
            let parent = if k == 0 {
                "base".to_owned()
            } else if random.uniform(0.0, 1.0) < self.branching {
                format!("link{}", random.below(k))
            } else {
                format!("link{}", k - 1)
            };
            let kind = self.kinds[random.below(self.kinds.len())];
            let mut joint = JointDescription::new(format!("joint{k}"), kind, parent, format!("link{k}"));
            joint.origin = RigidShift { rotation: random.rotation(), lever: random.vector() * 0.5 };
            joint.axis = random.vector();
            joint.armature = self.armature * random.uniform(0.1, 1.0);
            let inertial = Some(random_inertial(&mut random));
            builder = builder.link(LinkDescription { name: format!("link{k}"), inertial }).joint(joint);
        }
        builder
    }

    pub fn scene(self) -> Scene {
        self.builder().build().expect("a random scene is valid")
    }
}

/// A pendulum of rods that rotate about parallel axes: gravity and motion load every joint, including those with
/// springs.
pub fn swinging(rods: usize) -> Scene {
    let rod = Inertial {
        mass: 1.0,
        center: [0.0, 0.0, -0.15].into(),
        central: Symmetric3::new([0.01, 0.0, 0.0, 0.01, 0.0, 0.002]),
    };
    let mut builder = SceneBuilder::new().gravity([2.0, 0.5, -9.0]);
    builder = builder.link(LinkDescription { name: "base".into(), inertial: None });
    for k in 0..rods {
        let parent = if k == 0 { "base".into() } else { format!("link{}", k - 1) };
        let mut joint = JointDescription::new(format!("j{k}"), JointKind::Revolute, parent, format!("link{k}"));
        joint.axis = Vector3::y();
        joint.origin.lever = if k == 0 { Vector3::zeros() } else { Vector3::new(0.0, 0.0, -0.3) };
        builder = builder.link(LinkDescription { name: format!("link{k}"), inertial: Some(rod) }).joint(joint);
    }
    builder.build().expect("rods on hinges")
}

/// A random tree of `bodies` joints on a base link; `branching` 0 gives a chain.
pub fn random_scene(seed: u64, bodies: usize, kinds: &[JointKind], branching: f64, armature: f64) -> Scene {
    Tree { seed, bodies, kinds, branching, armature, floating: false }.scene()
}

/// A random state: q with unit quaternions, qd, and a torque.
pub fn random_state(scene: &Scene, random: &mut Random) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
    let step = random.array(scene.nv(), 2.0);
    let mut q = scene.neutral();
    scene.integrate(&scene.neutral(), &step, &mut q).unwrap();
    (q, random.array(scene.nv(), 1.0), random.array(scene.nv(), 5.0))
}
