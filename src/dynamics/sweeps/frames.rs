//! The body frames of the sweeps.
//!
//! If a joint rotates about an axis of its parent's frame, the constants of the body absorb a signed permutation of
//! axes without rounding: at zero angle, the z axis of the body is parallel to an axis of its parent, and its x and y
//! axes to the next two in cyclic order. The transform of a revolute joint then reduces to a rotation about z with a
//! sign and one of three cyclic orders of the parent's components. If the joint frame is rotated about its z axis at
//! zero angle by more than a permutation, the angle has a constant *offset*. An axis that is not parallel to an axis of
//! its parent is *oblique*: it has a [constant rotation](ConstantRotation) from one of them.
//!
//! An [`AxisPermutation`] leads from the frame of a body in the model to the frame that the passes use.

use super::joint::{Joint, JointAxis};
use crate::filter::Rows;
use crate::model::{Body, Model, Motion};
use crate::scalar::Real;
use crate::spatial::inertial_parameters::{ENTRIES, Parameters, place};
use crate::spatial::transform::{AboutAxis, ConstantRotation, ConstantSlide};
use nalgebra::{Matrix3, Vector3, Vector6};

/// The bodies of a scene in the frames of the sweeps.
pub(super) struct Framed {
    /// Each from its frame to the frame of its parent; for a revolute joint at zero angle.
    pub bodies: Vec<Body<f64>>,
    pub joints: Vec<Joint>,
    /// Sine and cosine of the angle offset of a joint; None without an offset.
    pub angle_offsets: Vec<Option<[f64; 2]>>,
    /// The offsets of the origins as the inward pass uses them: for a revolute joint in its frame at zero angle, or in
    /// its parent's frame if the axis is oblique.
    pub offsets_inward: Vec<Vector3<f64>>,
    /// The rotations of oblique axes.
    pub constant_rotations: Vec<ConstantRotation<f64>>,
    /// The shifts of prismatic joints.
    pub slides: Vec<ConstantSlide<f64>>,
    /// The rotation from each body's frame in the model; its entries are zeros and ones of either sign.
    pub from_model: Vec<Matrix3<f64>>,
}

impl Framed {
    pub fn of(model: &Model<f64>) -> Self {
        let count = model.bodies.len();
        let mut framed = Self {
            bodies: Vec::with_capacity(count),
            joints: Vec::with_capacity(count),
            angle_offsets: Vec::with_capacity(count),
            offsets_inward: Vec::with_capacity(count),
            constant_rotations: Vec::new(),
            slides: Vec::new(),
            from_model: Vec::with_capacity(count),
        };
        let mut shifts = 0;
        for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
            let outer = stage.parent.map_or_else(Matrix3::identity, |parent| framed.from_model[parent]);
            let rotation = outer * body.tree.rotation;
            let turns = matches!(body.motion, Motion::Revolute) && model.simplifications.permuted_axes;
            let tilted = || if model.simplifications.oblique_axes { AboutAxis::tilted(&rotation) } else { None };
            let slides = matches!(body.motion, Motion::Prismatic) && model.simplifications.permuted_axes;
            let sliding = || AboutAxis::sliding(&rotation, model.simplifications.oblique_axes);
            let sliding = if slides { sliding() } else { None };
            let about = if turns { AboutAxis::of(&rotation).or_else(tilted) } else { None };
            let mut here = *body;
            let (joint, frame, offset) = if let Some(AboutAxis { axis, tilt, frame, offset }) = about {
                here.tree.rotation = tilt.map_or_else(|| axis.rotation(), |tilt| tilt.matrix());
                let mut axis = JointAxis::Aligned(axis);
                if let Some(rotation) = tilt {
                    axis = JointAxis::Oblique(framed.constant_rotations.len());
                    framed.constant_rotations.push(rotation);
                }
                (Joint::Axial(axis), frame, offset)
            } else {
                let frame = sliding.as_ref().map_or_else(Matrix3::identity, |about| about.frame);
                here.tree.rotation = rotation * frame.transpose();
                let joint = match &sliding {
                    Some(_) => Joint::Prismatic(shifts, framed.slides.len()),
                    None if matches!(stage.rows, Rows::Six) && stage.parent.is_none() => Joint::Free(shifts),
                    None => Joint::General(shifts),
                };
                framed.slides.extend(sliding.as_ref().map(ConstantSlide::of));
                shifts += 1;
                (joint, frame, None)
            };
            here.tree.lever = outer * body.tree.lever;
            framed.offsets_inward.push(match joint {
                Joint::Axial(axis) => axis.axis().rotation().transpose() * here.tree.lever,
                _ => here.tree.rotate_back(&here.tree.lever),
            });
            here.inertia.first_moment = frame * body.inertia.first_moment;
            here.inertia.rotational = body.inertia.rotational.congruence(&frame);
            here.inertia_terms = Vector6::from(AxisPermutation::of(&frame, |x| x).apply(&body.inertia_terms)).abs();
            framed.bodies.push(here);
            framed.joints.push(joint);
            framed.angle_offsets.push(offset);
            framed.from_model.push(frame);
        }
        framed
    }
}

/// A signed permutation of axes, from the frame of a body in the model to the frame that the passes use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct AxisPermutation<N> {
    /// Entry i in the passes is `sign[i]` times entry `from[i]` in the model.
    pub from: [u8; 3],
    pub sign: [N; 3],
}

impl<N: Copy> AxisPermutation<N> {
    /// The identity.
    pub fn identity(one: N) -> Self {
        Self { from: [0, 1, 2], sign: [one; 3] }
    }

    /// From a rotation with one entry of 1 or -1 in each row and column, and zeros.
    #[allow(clippy::cast_possible_truncation)] // below three
    pub fn of(rotation: &Matrix3<f64>, number: impl Fn(f64) -> N) -> Self {
        Self {
            from: [0, 1, 2].map(|i| rotation.row(i).iter().position(|&x| x != 0.0).unwrap_or(i) as u8),
            sign: [0, 1, 2].map(|i| number(rotation.row(i).sum())),
        }
    }

    /// Converts a motion or a force from the frame of the model.
    #[inline(always)]
    pub fn apply<T: Real<Parameter = N>>(&self, v: &Vector6<T>) -> [T; 6] {
        let mut here: [T; 6] = (*v).into();
        for (i, here) in here.iter_mut().enumerate() {
            let from = v[usize::from(self.from[i % 3]) + i / 3 * 3];
            *here = from * from.splat(self.sign[i % 3]);
        }
        here
    }

    /// Converts a motion or a force back to the frame of the model.
    #[inline(always)]
    pub fn back<T: Real<Parameter = N>>(&self, here: &[T; 6]) -> Vector6<T> {
        let mut there = Vector6::from(*here);
        for (i, &value) in here.iter().enumerate() {
            there[usize::from(self.from[i % 3]) + i / 3 * 3] = value * value.splat(self.sign[i % 3]);
        }
        there
    }

    /// The rotation to the frame of the passes after `rotation`, which leads to that of the model.
    pub fn after<T: Real<Parameter = N>>(&self, like: T, rotation: &Matrix3<f64>) -> Matrix3<f64> {
        let sign = |i: usize| like.splat(self.sign[i]).lane(0);
        Matrix3::from_fn(|i, j| sign(i) * rotation[(usize::from(self.from[i]), j)])
    }

    /// Converts inertial parameters, or their changes, from the frame of the model.
    #[inline(always)]
    pub fn parameters<T: Real<Parameter = N>>(&self, parameters: &Parameters<T>) -> Parameters<T> {
        let like = parameters[0];
        let o = like.constant(0.0);
        let first = self.apply(&Vector6::new(parameters[1], parameters[2], parameters[3], o, o, o));
        let mut here = *parameters;
        here[1..4].copy_from_slice(&first[..3]);
        for (to, [i, j]) in here[4..].iter_mut().zip(ENTRIES) {
            let (from, sign) = self.entry(like, i, j);
            *to = sign * parameters[place(from)];
        }
        here
    }

    /// The place and the sign in the model of entry (i, j) of a symmetric matrix.
    #[inline(always)]
    pub fn entry<T: Real<Parameter = N>>(&self, like: T, i: usize, j: usize) -> ([usize; 2], T) {
        ([usize::from(self.from[i]), usize::from(self.from[j])], like.splat(self.sign[i]) * like.splat(self.sign[j]))
    }
}

#[cfg(test)]
mod tests {
    use super::{Framed, Joint, JointAxis};
    use crate::model::Simplifications;
    use crate::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
    use crate::spatial::Symmetric3;
    use nalgebra::{Matrix3, Rotation3, Vector3};
    use std::f64::consts::{FRAC_PI_2, PI};

    fn rpy(roll: f64, pitch: f64, yaw: f64) -> Matrix3<f64> {
        Rotation3::from_euler_angles(roll, pitch, yaw).into_inner()
    }

    /// The kind of transform of a joint whose frame is rotated by a given matrix.
    #[derive(Debug, PartialEq)]
    enum Kind {
        Plain,
        /// The number of axes about which it is rotated.
        Tilted(usize),
        Shift,
    }

    /// The frames of a body whose joint rotates about or translates along an axis of a rotated frame, and the rotation
    /// in the model.
    fn framed(
        kind: JointKind,
        (rotation, axis): (Matrix3<f64>, Vector3<f64>),
        simplifications: Simplifications,
    ) -> (Framed, Matrix3<f64>) {
        let mut joint = JointDescription::new("joint", kind, "base", "link");
        (joint.origin.rotation, joint.axis) = (rotation, axis);
        let central = Symmetric3::new([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]);
        let inertial = Some(Inertial { mass: 1.0, center: [0.1, 0.2, 0.3].into(), central });
        let scene = SceneBuilder::new()
            .simplifications(simplifications)
            .link(LinkDescription { name: "base".into(), inertial: None })
            .link(LinkDescription { name: "link".into(), inertial })
            .joint(joint)
            .build()
            .expect("a scene");
        (Framed::of(scene.model()), scene.model().bodies[0].tree.rotation)
    }

    /// The kind of a revolute joint with this rotation, its angle offset, and the error of the rotation composed from
    /// both.
    fn of(rotation: Matrix3<f64>, axis: Vector3<f64>) -> (Kind, Option<[f64; 2]>, f64) {
        let (framed, given) = framed(JointKind::Revolute, (rotation, axis), Simplifications::all());
        let [s, c] = framed.angle_offsets[0].unwrap_or([0.0, 1.0]);
        let about_z = Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0);
        let made = framed.bodies[0].tree.rotation * about_z * framed.from_model[0];
        let off = (made - given).amax();
        let kind = match framed.joints[0] {
            Joint::Axial(JointAxis::Aligned(_)) => Kind::Plain,
            Joint::Axial(JointAxis::Oblique(at)) => {
                Kind::Tilted(1 + usize::from(framed.constant_rotations[at].turns_about_z))
            }
            _ => Kind::Shift,
        };
        (kind, framed.angle_offsets[0], off)
    }

    #[test]
    fn right_angles_as_doubles_have_them_rename_axes() {
        for rotation in
            [rpy(0.0, 0.0, 0.0), rpy(FRAC_PI_2, 0.0, 0.0), rpy(-FRAC_PI_2, 0.0, PI), rpy(0.0, -FRAC_PI_2, 0.0)]
        {
            for axis in [Vector3::x(), -Vector3::y(), Vector3::z()] {
                let (kind, offset, off) = of(rotation, axis);
                assert!(kind == Kind::Plain && offset.is_none() && off <= 4.0 * f64::EPSILON, "{rotation}");
            }
        }
        // A rotation that is orthonormal to less than rounding is replaced by the nearest one when the scene is built.
        for rotation in [
            Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 5e-10, 0.0, 1.0),
            rpy(0.0, 0.0, 0.3) * (1.0 + 2e-11),
            rpy(0.4, 0.2, 0.3) * (1.0 + 2e-11),
        ] {
            let (kind, _, off) = of(rotation, Vector3::z());
            assert!(kind != Kind::Shift && off <= 1e-9, "{rotation}");
        }
    }

    #[test]
    fn what_brings_the_axis_anywhere_tilts_it() {
        // Right angles as rounded in URDF files are preserved.
        let about = |angle: f64| (angle * 1e4).round() / 1e4;
        for (rotation, axes) in [
            (rpy(FRAC_PI_2 - 5e-12, 0.0, 0.0), 1),
            (rpy(about(FRAC_PI_2), 0.0, 0.0), 1),
            (rpy(about(FRAC_PI_2), 0.0, about(FRAC_PI_2)), 2),
            (rpy(about(PI), -about(FRAC_PI_2), 0.0), 2),
            (rpy(0.0, -0.1749, 0.0), 1),
            (rpy(0.3, 0.0, 0.0), 1),
            (rpy(0.0, 2.1, 0.0), 1),
            (rpy(0.0, -2.1, 0.7), 2),
            (rpy(-1e-9, 1e-8, 3.0), 2),
            (rpy(0.3, -0.2, 1.1), 2),
        ] {
            let (kind, _, off) = of(rotation, Vector3::z());
            assert!(kind == Kind::Tilted(axes) && off <= 8.0 * f64::EPSILON, "{rotation} {kind:?} {off}");
            for axis in [Vector3::x(), -Vector3::y(), -Vector3::z(), Vector3::new(0.3, -0.4, 0.8)] {
                let (kind, _, off) = of(rotation, axis.normalize());
                assert!(kind != Kind::Shift && off <= 8.0 * f64::EPSILON, "{rotation} {axis} {off}");
            }
        }
        // The offset in addition to the joint angle.
        let (kind, offset, _) = of(rpy(0.3, 0.0, 0.0) * rpy(0.0, 0.0, 0.5), Vector3::z());
        assert!(kind == Kind::Tilted(1) && offset.is_some());
        let (kind, offset, _) = of(rpy(0.3, 0.0, 0.0) * rpy(0.0, 0.0, FRAC_PI_2), Vector3::z());
        assert!(kind == Kind::Tilted(1) && offset.is_none());
    }

    #[test]
    fn what_turns_about_the_joints_own_axis_is_an_offset() {
        for axis in [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::z()] {
            let rotation = Rotation3::from_scaled_axis(axis.abs() * 0.3).into_inner();
            let (kind, offset, off) = of(rotation, axis);
            assert!(kind == Kind::Plain && offset.is_some() && off <= 4.0 * f64::EPSILON, "{axis}: {off}");
        }
    }

    /// A prismatic joint uses constants if the simplifications allow it, and keeps its frame otherwise.
    #[test]
    fn what_slides_goes_by_constants_where_it_may() {
        let all = Simplifications::all();
        let (untilted, unnamed) =
            (Simplifications { oblique_axes: false, ..all }, Simplifications { permuted_axes: false, ..all });
        for (rotation, axis, is_tilted) in [
            (rpy(0.0, 0.0, 0.0), -Vector3::y(), false),
            (rpy(FRAC_PI_2, 0.0, 0.0), Vector3::z(), false),
            (rpy(0.0, 0.0, -0.7), Vector3::x(), true),
            (rpy(0.3, -0.2, 1.1), Vector3::x(), true),
        ] {
            for (simplifications, is_there) in [(all, true), (untilted, !is_tilted), (unnamed, false)] {
                let (framed, given) = framed(JointKind::Prismatic, (rotation, axis), simplifications);
                let expected = if is_there { Joint::Prismatic(0, 0) } else { Joint::General(0) };
                assert_eq!((framed.joints[0], framed.slides.len()), (expected, usize::from(is_there)));
                let made = framed.bodies[0].tree.rotation * framed.from_model[0];
                assert!((made - given).amax() <= 4.0 * f64::EPSILON);
                assert!(is_there || framed.from_model[0] == Matrix3::identity(), "{}", framed.from_model[0]);
            }
        }
    }
}
