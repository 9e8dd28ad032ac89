//! Planar joint: motion in the plane perpendicular to the axis, (u, v, theta), with two massless bodies.

use super::Motion;
use super::frames::{axis_onto_z, turn};
use super::parts::Parts;
use nalgebra::Vector3;

/// Along u, along v, then about the normal; each frame has its own axis along z.
pub(super) fn parts(axis: &Vector3<f64>) -> Parts {
    let align = axis_onto_z(axis);
    let (along_u, along_v) = (axis_onto_z(&Vector3::x()), axis_onto_z(&Vector3::y()));
    Parts {
        motions: vec![
            (turn(align * along_u), Motion::Prismatic),
            (turn(along_u.transpose() * along_v), Motion::Prismatic),
            (turn(along_v.transpose()), Motion::Revolute),
        ],
        end: turn(align.transpose()),
    }
}
