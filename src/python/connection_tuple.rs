//! Connections as plain tuples of numbers and names, for pickling.

use crate::error::Error;
use crate::scene::{Connection, ConnectionKind, Polynomial};
use crate::spatial::RigidShift;
use nalgebra::Matrix3;

/// A connection as numbers and names: name, kind, axis, length, coefficients of a polynomial, link, other, and the two
/// frames (rotation in row-major order, lever).
pub(super) type ConnectionTuple = (
    String,
    String,
    Option<[f64; 3]>,
    Option<f64>,
    Option<[f64; 5]>,
    String,
    Option<String>,
    FrameTuple,
    Option<FrameTuple>,
);

/// A frame as numbers: its rotation in row-major order, and its origin.
pub(super) type FrameTuple = ([f64; 9], [f64; 3]);

pub(super) fn frame_tuple(frame: &RigidShift<f64>) -> FrameTuple {
    let mut rotation = [0.0; 9];
    rotation.copy_from_slice(frame.rotation.transpose().as_slice());
    (rotation, frame.lever.into())
}

pub(super) fn frame_from((rotation, lever): FrameTuple) -> RigidShift<f64> {
    RigidShift { rotation: Matrix3::from_row_slice(&rotation), lever: lever.into() }
}

/// The complete description of a connection.
pub(super) fn connection_tuple(connection: &Connection) -> ConnectionTuple {
    let Connection { name, kind, link, other, frame, other_frame } = connection;
    let (axis, length, polynomial) = match *kind {
        ConnectionKind::Axis(axis) => (Some(axis.into()), None, None),
        ConnectionKind::Distance(length) => (None, length, None),
        ConnectionKind::Joint(polynomial) => (None, None, Some(polynomial.coefficients())),
        _ => (None, None, None),
    };
    let other_frame = other_frame.as_ref().map(frame_tuple);
    (
        name.clone(),
        kind.name().to_owned(),
        axis,
        length,
        polynomial,
        link.clone(),
        other.clone(),
        frame_tuple(frame),
        other_frame,
    )
}

/// The connection of a tuple.
pub(super) fn connection_of(tuple: ConnectionTuple) -> Result<Connection, Error> {
    let (name, kind, axis, length, polynomial, link, other, frame, other_frame) = tuple;
    let kind = match polynomial {
        Some(coefficients) => ConnectionKind::Joint(Polynomial::new(coefficients)),
        None => ConnectionKind::named(&name, &kind, axis.map(Into::into), length)?,
    };
    let (frame, other_frame) = (frame_from(frame), other_frame.map(frame_from));
    Ok(Connection { name, kind, link, other, frame, other_frame })
}
