//! What the extreme scenes are made of: links in a row or on a hub, before they become a scene.

use crate::error::Error;
use crate::interrupt;
use crate::scene::{AT_A_TIME, Inertial, JointDescription, JointKind, LinkDescription, Scene, SceneBuilder};
use crate::spatial::{RigidShift, Symmetric3};
use nalgebra::{Matrix3, Vector3};

/// Axes of successive joints: along coordinates and across them.
pub(super) const AXES: [[f64; 3]; 3] = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.3]];

/// One link and the joint that carries it; frames are parallel at zero configuration, so that other programs read the same numbers.
#[derive(Debug, Clone)]
pub(super) struct Part {
    /// Index of the part that carries it; none on the base.
    pub parent: Option<usize>,
    /// Where its joint is on the parent, m.
    pub lever: Vector3<f64>,
    pub kind: JointKind,
    pub axis: Vector3<f64>,
    pub armature: f64,
    /// None for a link without mass.
    pub inertial: Option<Inertial>,
}

/// All parts of a scene, and whether its base floats.
#[derive(Debug, Clone, Default)]
pub(super) struct Blueprint {
    pub parts: Vec<Part>,
    pub floating: bool,
}

/// A body of that mass along x over `length`, a little off its axis so that nothing is symmetric.
pub(super) fn slab(mass: f64, length: f64) -> Inertial {
    let square = mass * length * length;
    Inertial {
        mass,
        center: Vector3::new(0.5 * length, 0.1 * length, 0.0),
        central: Symmetric3::new([0.02 * square, 0.0, 0.0, 0.08 * square, 0.0, 0.09 * square]),
    }
}

/// `count` revolute joints in a row, 0.5 m apart along x, with bodies of 1 kg and axes in three directions.
pub(super) fn row(count: usize) -> Blueprint {
    let part = |k: usize| Part {
        parent: k.checked_sub(1),
        lever: Vector3::new(if k == 0 { 0.0 } else { LENGTH }, 0.0, 0.0),
        kind: JointKind::Revolute,
        axis: AXES[k % 3].into(),
        armature: 0.0,
        inertial: Some(slab(1.0, LENGTH)),
    };
    Blueprint { parts: (0..count).map(part).collect(), floating: false }
}

/// The length of an ordinary link, m.
pub(super) const LENGTH: f64 = 0.5;

impl Blueprint {
    /// Gives each part its mass, the body otherwise of the same shape.
    pub fn masses(mut self, mass: impl Fn(usize) -> f64) -> Self {
        for (k, part) in self.parts.iter_mut().enumerate() {
            part.inertial = Some(slab(mass(k), LENGTH));
        }
        self
    }

    /// The scene: links `link0`, `link1`, ... on joints `joint0`, `joint1`, ...
    pub fn build(self) -> Result<Scene, Error> {
        let base = self.floating.then(|| slab(1.0, LENGTH));
        let mut builder = SceneBuilder::new()
            .floating_base(self.floating)
            .link(LinkDescription { name: "base".into(), inertial: base });
        for (k, part) in self.parts.into_iter().enumerate() {
            interrupt::check_at(k, AT_A_TIME)?;
            let parent = part.parent.map_or_else(|| "base".to_owned(), |parent| format!("link{parent}"));
            let mut joint = JointDescription::new(format!("joint{k}"), part.kind, parent, format!("link{k}"));
            joint.origin = RigidShift { rotation: Matrix3::identity(), lever: part.lever };
            joint.axis = part.axis;
            joint.armature = part.armature;
            builder = builder.link(LinkDescription { name: format!("link{k}"), inertial: part.inertial }).joint(joint);
        }
        builder.build()
    }
}
