//! Contacts as plain tuples of numbers and names, for pickling.

use super::connection_tuple::{FrameTuple, frame_from, frame_tuple};
use crate::scene::{Contact, Surface};

/// A contact as numbers and names: name, link, point, radius, normal, offset, friction, restitution; link of the
/// surface, its frame, and the shape: no number for a plane, the radius of a sphere, or the size of a box.
pub(super) type ContactTuple =
    (String, String, [f64; 3], f64, [f64; 3], f64, f64, f64, Option<String>, FrameTuple, Vec<f64>);

/// The complete description of a contact.
pub(super) fn contact_tuple(contact: &Contact) -> ContactTuple {
    let Contact { name, link, point, radius, normal, offset, friction, restitution, other, other_frame, surface } =
        contact;
    let (point, normal) = ((*point).into(), (*normal).into());
    let shape = match surface {
        Surface::Plane => Vec::new(),
        Surface::Sphere { radius } => vec![*radius],
        Surface::Box { size } => size.as_slice().to_vec(),
    };
    let (name, link, other, frame) = (name.clone(), link.clone(), other.clone(), frame_tuple(other_frame));
    (name, link, point, *radius, normal, *offset, *friction, *restitution, other, frame, shape)
}

/// The contact of a tuple.
pub(super) fn contact_of(tuple: ContactTuple) -> Contact {
    let (name, link, point, radius, normal, offset, friction, restitution, other, other_frame, shape) = tuple;
    let surface = match shape[..] {
        [radius] => Surface::Sphere { radius },
        [x, y, z] => Surface::Box { size: [x, y, z].into() },
        _ => Surface::Plane,
    };
    let (point, normal, other_frame) = (point.into(), normal.into(), frame_from(other_frame));
    Contact { name, link, point, radius, normal, offset, other, other_frame, surface, friction, restitution }
}
