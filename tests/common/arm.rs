//! A small arm in parts, for tests that break one part.

use nalgebra::Vector3;
use phipsi::scene::{Inertial, JointDescription, JointKind, Limits, LinkDescription, SceneBuilder};
use phipsi::spatial::Symmetric3;

/// A body of 2 kg.
pub fn solid() -> Inertial {
    Inertial {
        mass: 2.0,
        center: Vector3::new(0.1, 0.0, 0.2),
        central: Symmetric3::new([0.02, 0.0, 0.001, 0.03, 0.0, 0.025]),
    }
}

/// A link by name.
pub fn link(name: &str, inertial: Option<Inertial>) -> LinkDescription {
    LinkDescription { name: name.into(), inertial }
}

/// base - shoulder - arm - wrist - hand, the wrist spherical.
pub fn parts() -> (Vec<LinkDescription>, Vec<JointDescription>) {
    let mut shoulder = JointDescription::new("shoulder", JointKind::Revolute, "base", "arm");
    shoulder.axis = Vector3::y();
    shoulder.limits = Limits::default().with_lower(-1.0).with_upper(1.0).with_velocity(3.0).with_effort(10.0);
    let mut wrist = JointDescription::new("wrist", JointKind::Spherical, "arm", "hand");
    wrist.origin.lever = Vector3::new(0.0, 0.0, 0.4);
    (vec![link("base", None), link("arm", Some(solid())), link("hand", Some(solid()))], vec![shoulder, wrist])
}

/// A builder of these parts.
pub fn assembled((links, joints): (Vec<LinkDescription>, Vec<JointDescription>)) -> SceneBuilder {
    let builder = links.into_iter().fold(SceneBuilder::new(), SceneBuilder::link);
    joints.into_iter().fold(builder, SceneBuilder::joint)
}
