//! The frames that these sweeps have the bodies in.
//!
//! Where an exact renaming of axes stands between a body and its parent, signs and places become part of the body's constants, no digit of
//! them touched: its z is then one axis of its parent's at zero angle, its x and y the two that follow it in their cycle. What is left of a
//! turn is a rotation about z, to one side or the other, and one of three ways to read the parent's vectors.

use super::body::Carrier;
use super::turn::{Axis, Renaming, renames_axes};
use crate::scene::{Body, Model, Motion};
use nalgebra::{Matrix3, Vector6};

/// The bodies of a scene in those frames.
pub(super) struct Framed {
    /// Each from its frame to that of its parent.
    pub bodies: Vec<Body<f64>>,
    pub carriers: Vec<Carrier>,
    /// From each body's frame in the model, zeros and ones.
    pub from_model: Vec<Matrix3<f64>>,
}

impl Framed {
    pub fn of(model: &Model<f64>) -> Self {
        let count = model.bodies.len();
        let mut framed = Self {
            bodies: Vec::with_capacity(count),
            carriers: Vec::with_capacity(count),
            from_model: Vec::with_capacity(count),
        };
        let mut shifts = 0;
        for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
            let outer = stage.parent.map_or_else(Matrix3::identity, |parent| framed.from_model[parent]);
            let rotation = outer * body.tree.rotation;
            let turns = matches!(body.motion, Motion::Revolute)
                && model.omissions.renamed_axes
                && renames_axes(&body.tree.rotation);
            let (carrier, frame) = if turns {
                let axis = Axis::new(rotation.column(2).iamax());
                (Carrier::Turn(axis), axis.rotation().transpose() * rotation)
            } else {
                shifts += 1;
                (Carrier::Shift(shifts - 1), Matrix3::identity())
            };
            let mut here = *body;
            here.tree.rotation = rotation * frame.transpose();
            here.tree.lever = outer * body.tree.lever;
            here.inertia.first_moment = frame * body.inertia.first_moment;
            here.inertia.rotational = body.inertia.rotational.congruence(&frame);
            here.inertia_terms = Vector6::from(Renaming::of(&frame, |x| x).apply(&body.inertia_terms)).abs();
            framed.bodies.push(here);
            framed.carriers.push(carrier);
            framed.from_model.push(frame);
        }
        framed
    }
}
