//! Construction of the extreme scenes: links in a chain or on a hub.

use crate::error::Error;
use crate::interrupt;
use crate::scene::{AT_A_TIME, Inertial, JointDescription, JointKind, LinkDescription, Scene, SceneBuilder};
use crate::spatial::{RigidShift, Symmetric3};
use nalgebra::{Matrix3, Vector3};

/// Axes of successive joints: along coordinate axes, and oblique.
pub(super) const AXES: [[f64; 3]; 3] = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.3]];

/// A link with its joint. All frames are parallel at zero configuration, so that other programs read the same values.
#[derive(Debug, Clone)]
pub(super) struct Part {
    /// Index of the parent part; `None` for the base.
    pub parent: Option<usize>,
    /// Position of the joint on the parent, m.
    pub lever: Vector3<f64>,
    pub kind: JointKind,
    pub axis: Vector3<f64>,
    pub armature: f64,
    /// `None` for a massless link.
    pub inertial: Option<Inertial>,
}

/// All parts of a scene, and whether its base is floating.
#[derive(Debug, Clone, Default)]
pub(super) struct Blueprint {
    pub parts: Vec<Part>,
    pub floating: bool,
}

/// Inertia of a body of the given mass along x with length `length`, with its center of mass off the axis to avoid
/// symmetry.
pub(super) fn slab(mass: f64, length: f64) -> Inertial {
    let square = mass * length * length;
    Inertial {
        mass,
        center: Vector3::new(0.5 * length, 0.1 * length, 0.0),
        central: Symmetric3::new([0.02 * square, 0.0, 0.0, 0.08 * square, 0.0, 0.09 * square]),
    }
}

/// A chain of `count` revolute joints, 0.5 m apart along x, with bodies of 1 kg and axes in three directions.
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

/// Length of an ordinary link, m.
pub(super) const LENGTH: f64 = 0.5;

impl Blueprint {
    /// Sets the mass of each part; the shape is the same.
    pub fn masses(mut self, mass: impl Fn(usize) -> f64) -> Self {
        for (k, part) in self.parts.iter_mut().enumerate() {
            part.inertial = Some(slab(mass(k), LENGTH));
        }
        self
    }

    /// Builds the scene, with links `link0`, `link1`, ... on joints `joint0`, `joint1`, ...
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
