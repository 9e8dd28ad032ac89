//! Contacts as plain tuples of numbers and names, for pickling.

use crate::scene::Contact;

/// A contact as numbers and names: name, link, point, radius, normal, offset, friction, restitution.
pub(super) type ContactTuple = (String, String, [f64; 3], f64, [f64; 3], f64, f64, f64);

/// The complete description of a contact.
pub(super) fn contact_tuple(contact: &Contact) -> ContactTuple {
    let Contact { name, link, point, radius, normal, offset, friction, restitution } = contact;
    let (point, normal) = ((*point).into(), (*normal).into());
    (name.clone(), link.clone(), point, *radius, normal, *offset, *friction, *restitution)
}

/// The contact of a tuple.
pub(super) fn contact_of(tuple: ContactTuple) -> Contact {
    let (name, link, point, radius, normal, offset, friction, restitution) = tuple;
    Contact { name, link, point: point.into(), radius, normal: normal.into(), offset, friction, restitution }
}
