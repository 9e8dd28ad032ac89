//! Universal joint: two angles about perpendicular axes, rad, first about x, then about the rotated y, with a massless
//! body.

use super::Motion;
use super::frames::{axis_onto_z, turn};
use super::parts::Parts;
use nalgebra::Vector3;

/// About x, then about y; each frame has its own axis along z.
pub(super) fn parts() -> Parts {
    let (on_x, on_y) = (axis_onto_z(&Vector3::x()), axis_onto_z(&Vector3::y()));
    Parts {
        motions: vec![(turn(on_x), Motion::Revolute), (turn(on_x.transpose() * on_y), Motion::Revolute)],
        end: turn(on_y.transpose()),
    }
}
