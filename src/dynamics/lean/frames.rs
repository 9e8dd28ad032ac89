//! The frames that these sweeps have the bodies in.
//!
//! Where a joint turns about an axis of its parent's frame, signs and places become part of the body's constants, no digit of them touched:
//! its z is then one axis of its parent's at zero angle, its x and y the two that follow it in their cycle. What is left of a turn is a
//! rotation about z, to one side or the other, and one of three ways to read the parent's vectors; and where the joint's frame is turned about
//! its z at zero angle by what is no renaming of axes, a constant *offset* of the angle.

use super::body::Carrier;
use super::loads::{Load, loads};
use super::turn::{AboutAxis, Renaming};
use crate::scene::{Body, Model, Motion};
use nalgebra::{Matrix3, Vector6};

/// The bodies of a scene in those frames.
pub(super) struct Framed {
    /// Each from its frame to that of its parent; of a turn where its angle is zero.
    pub bodies: Vec<Body<f64>>,
    pub carriers: Vec<Carrier>,
    /// Sine and cosine of the turn's angle where the joint's is zero, where they are not those of none.
    pub offsets: Vec<Option<[f64; 2]>>,
    /// From each body's frame in the model, zeros and ones.
    pub from_model: Vec<Matrix3<f64>>,
    /// What their forces see of them.
    pub loads: Vec<Load<f64>>,
}

impl Framed {
    pub fn of(model: &Model<f64>) -> Self {
        let count = model.bodies.len();
        let mut framed = Self {
            bodies: Vec::with_capacity(count),
            carriers: Vec::with_capacity(count),
            offsets: Vec::with_capacity(count),
            from_model: Vec::with_capacity(count),
            loads: Vec::new(),
        };
        let mut shifts = 0;
        for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
            let outer = stage.parent.map_or_else(Matrix3::identity, |parent| framed.from_model[parent]);
            let rotation = outer * body.tree.rotation;
            let turns = matches!(body.motion, Motion::Revolute) && model.omissions.renamed_axes;
            let about = if turns { AboutAxis::of(&rotation) } else { None };
            let mut here = *body;
            let (carrier, frame, offset) = if let Some(AboutAxis { axis, frame, offset }) = about {
                here.tree.rotation = axis.rotation();
                (Carrier::Turn(axis), frame, offset)
            } else {
                here.tree.rotation = rotation;
                shifts += 1;
                (Carrier::Shift(shifts - 1), Matrix3::identity(), None)
            };
            here.tree.lever = outer * body.tree.lever;
            here.inertia.first_moment = frame * body.inertia.first_moment;
            here.inertia.rotational = body.inertia.rotational.congruence(&frame);
            here.inertia_terms = Vector6::from(Renaming::of(&frame, |x| x).apply(&body.inertia_terms)).abs();
            framed.bodies.push(here);
            framed.carriers.push(carrier);
            framed.offsets.push(offset);
            framed.from_model.push(frame);
        }
        framed.loads = loads(model, &framed.bodies, &framed.carriers);
        framed
    }
}

#[cfg(test)]
mod tests {
    use super::{Carrier, Framed};
    use crate::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
    use crate::spatial::Symmetric3;
    use nalgebra::{Matrix3, Rotation3, Vector3};
    use std::f64::consts::{FRAC_PI_2, PI};

    fn rpy(roll: f64, pitch: f64, yaw: f64) -> Matrix3<f64> {
        Rotation3::from_euler_angles(roll, pitch, yaw).into_inner()
    }

    /// A joint about this axis of a frame turned so: whether it is a turn, its offset, and by how much what it is made of differs from what it is.
    fn of(rotation: Matrix3<f64>, axis: Vector3<f64>) -> (bool, Option<[f64; 2]>, f64) {
        let central = Symmetric3::new([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]);
        let inertial = Some(Inertial { mass: 1.0, centre: [0.1, 0.2, 0.3].into(), central });
        let mut joint = JointDescription::new("joint", JointKind::Revolute, "base", "link");
        joint.origin.rotation = rotation;
        joint.axis = axis;
        let scene = SceneBuilder::new()
            .link(LinkDescription { name: "base".into(), inertial: None })
            .link(LinkDescription { name: "link".into(), inertial })
            .joint(joint)
            .build()
            .expect("a scene");
        let framed = Framed::of(scene.model());
        let [s, c] = framed.offsets[0].unwrap_or([0.0, 1.0]);
        let about_z = Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0);
        let made = framed.bodies[0].tree.rotation * about_z * framed.from_model[0];
        let off = (made - scene.model().bodies[0].tree.rotation).amax();
        (matches!(framed.carriers[0], Carrier::Turn(_)), framed.offsets[0], off)
    }

    #[test]
    fn right_angles_as_doubles_have_them_rename_axes() {
        for rotation in
            [rpy(0.0, 0.0, 0.0), rpy(FRAC_PI_2, 0.0, 0.0), rpy(-FRAC_PI_2, 0.0, PI), rpy(0.0, -FRAC_PI_2, 0.0)]
        {
            for axis in [Vector3::x(), -Vector3::y(), Vector3::z()] {
                let (turns, offset, off) = of(rotation, axis);
                assert!(turns && offset.is_none() && off <= 4.0 * f64::EPSILON, "{rotation}");
            }
        }
        // As URDF files round them: what they say is kept.
        assert!(!of(rpy(FRAC_PI_2 - 5e-12, 0.0, 0.0), Vector3::z()).0);
        assert!(!of(rpy(0.3, 0.0, 0.0), Vector3::z()).0);
        // Nor is what is no rotation to rounding, though the builder takes it.
        assert!(!of(Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 5e-10, 0.0, 1.0), Vector3::z()).0);
        assert!(!of(rpy(0.0, 0.0, 0.3) * (1.0 + 2e-11), Vector3::z()).0);
    }

    #[test]
    fn what_turns_about_the_joints_own_axis_is_an_offset() {
        for axis in [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::z()] {
            let rotation = Rotation3::from_scaled_axis(axis.abs() * 0.3).into_inner();
            let (turns, offset, off) = of(rotation, axis);
            assert!(turns && offset.is_some() && off <= 4.0 * f64::EPSILON, "{axis}: {off}");
        }
    }
}
