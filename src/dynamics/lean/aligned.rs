//! The bodies of a scene in frames that are parallel to each other at zero angles: as the mass matrix, which no choice of frames changes,
//! reads them.
//!
//! An exact renaming of axes between a body and its parent becomes part of the body's constants: signs and places, no digit of them is
//! touched. What is left of a turn is a rotation about one of three axes, one way or the other.

use super::body::{Carrier, LeanBody};
use crate::scalar::Real;
use crate::scene::{Body, Model};
use nalgebra::Matrix3;

/// One body.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct AlignedBody<N> {
    /// Of a turn: the axis that it is about, 0 to 2, and its sense, 1 or -1.
    pub axis: usize,
    pub sense: N,
    /// From the parent's origin to the body's, in the parent's frame.
    pub lever: [N; 3],
    /// Mass of it and of all outboard of it, times the lever.
    pub composite_lever: [N; 3],
    /// Twice the lever; and entry by entry the lever times the above.
    pub twice_lever: [N; 3],
    pub lever_moment: [N; 3],
    /// First moment and rotational inertia about the origin.
    pub first_moment: [N; 3],
    pub rotational: [N; 6],
}

/// The bodies of a scene.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Aligned<T: Real> {
    pub bodies: Vec<AlignedBody<T::Parameter>>,
    /// Those that are not on a turn, whole: their own frames are the model's, those of their parents are not.
    pub shifts: Vec<Body<T>>,
    /// First coordinate and index of every body on a turn.
    pub turning: Vec<(usize, usize)>,
}

impl<T: Real> Aligned<T> {
    pub fn new(model: &Model<f64>, lean: &[LeanBody<T::Parameter>], composite_mass: &[f64]) -> Self {
        let mut model = model.clone();
        // From the model's frame of a body to ours, zeros and ones.
        let mut frames: Vec<Matrix3<f64>> = Vec::with_capacity(lean.len());
        let number = T::parameter;
        let mut bodies = Vec::with_capacity(lean.len());
        for ((lean, body), mass) in lean.iter().zip(&mut model.bodies).zip(composite_mass) {
            let outer = lean.parent.map_or_else(Matrix3::identity, |parent| frames[parent]);
            body.tree.rotation = outer * body.tree.rotation;
            body.tree.lever = outer * body.tree.lever;
            let frame = match lean.carrier {
                Carrier::Turn(_) => body.tree.rotation,
                Carrier::Shift(_) => Matrix3::identity(),
            };
            let axis = frame.column(2).iamax();
            let lever = <[f64; 3]>::from(body.tree.lever);
            bodies.push(AlignedBody {
                axis,
                sense: number(frame[(axis, 2)]),
                lever: lever.map(number),
                composite_lever: lever.map(|l| number(mass * l)),
                twice_lever: lever.map(|l| number(2.0 * l)),
                lever_moment: lever.map(|l| number(mass * l * l)),
                first_moment: <[f64; 3]>::from(frame * body.inertia.first_moment).map(number),
                rotational: body.inertia.rotational.congruence(&frame).entries.map(number),
            });
            frames.push(frame);
        }
        let whole = model.cast::<T>().bodies.into_iter().zip(lean);
        let shifts =
            whole.filter(|(_, lean)| matches!(lean.carrier, Carrier::Shift(_))).map(|(body, _)| body).collect();
        let turning = lean.iter().enumerate().filter(|(_, lean)| matches!(lean.carrier, Carrier::Turn(_)));
        let turning = turning.map(|(k, lean)| (lean.q, k)).collect();
        Self { bodies, shifts, turning }
    }
}
