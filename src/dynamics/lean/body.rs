//! The constants of a scene as these sweeps read them: one number for all lanes.

use super::aligned::Aligned;
use super::slots::{Slots, last_children};
use super::turn::Renaming;
use crate::filter::pivots::Scale;
use crate::scalar::Real;
use crate::scene::{Model, Motion};
use crate::spatial::BodyInertia;

/// As many joints inward of both as two joints may have, on average over all pairs, for M^-1 to be multiplied out: it takes less time below, on
/// chains and robots, for one state and in lanes.
const SHALLOW: usize = 10;

/// How a body hangs on its parent.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Carrier<N> {
    /// A revolute joint whose frame is its parent's with the axes renamed.
    Turn(Renaming<N>),
    /// Any other: index among those.
    Shift(usize),
}

/// One body.
#[allow(clippy::struct_excessive_bools)] // facts, each by itself
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LeanBody<N> {
    pub carrier: Carrier<N>,
    /// The body inward.
    pub parent: Option<usize>,
    /// Its first row.
    pub row: usize,
    /// Its first coordinate.
    pub q: usize,
    /// From the parent's origin to the body's, in the joint's frame (after the renaming, before the turn).
    pub lever: [N; 3],
    /// Whether the lever is there: not zero, or not left out.
    pub has_lever: bool,
    /// The lever's square.
    pub lever_square: N,
    /// Mass, first moment, rotational inertia about the origin.
    pub mass: N,
    pub first_moment: [N; 3],
    pub rotational: [N; 6],
    /// Mass of it and of all outboard of it.
    pub composite_mass: N,
    /// The bounds on the terms of M(k).
    pub scale: [N; 2],
    /// The terms of its diagonal.
    pub terms: [N; 6],
    /// Twice the squares of the lever's entries.
    pub lever_squares: [N; 3],
    pub needs_no_force: bool,
    /// Its place and its parent's, outward; 0 is the base's.
    pub outward: usize,
    pub parent_outward: usize,
    /// Its place and its parent's, inward.
    pub inward: usize,
    pub parent_inward: usize,
    /// Whether anything hangs on it.
    pub is_leaf: bool,
    /// The body before it on the same parent.
    pub sibling: Option<usize>,
    /// How many rows there are from the base to its own.
    pub depth: usize,
    /// One past the last row of what hangs on it.
    pub end_row: usize,
    /// Whether a later body hangs on its parent, or on that of one inward of it.
    pub is_parted: bool,
    /// Whether it is the first to arrive at its parent, inward: outward, the last that reads it.
    pub arrives_first: bool,
}

impl<N> LeanBody<N> {
    /// Whether a later body hangs on the same parent.
    #[inline(always)]
    pub fn sibling_follows(&self) -> bool {
        self.parent.is_some() && !self.arrives_first
    }
}

/// The bodies of a scene.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LeanModel<T: Real> {
    pub(super) bodies: Vec<LeanBody<T::Parameter>>,
    /// The same in frames of their own, for M.
    pub(super) aligned: Aligned<T>,
    pub(super) outward_slots: usize,
    pub(super) inward_slots: usize,
    pub(super) shifts: usize,
    /// The acceleration that errors are seen beside where the digits are watched; zero where each digit of the result counts.
    pub(super) beside: f64,
    /// Whether M^-1 is its factors multiplied out.
    pub(super) is_shallow: bool,
}

impl<T: Real> LeanModel<T> {
    pub fn new(model: &Model<f64>) -> Self {
        let parents: Vec<_> = model.system.stages.iter().map(|stage| stage.parent).collect();
        let (outward, inward) = (Slots::outward(&parents), Slots::inward(&parents));
        let mut shifts = 0;
        let mut composite_mass: Vec<f64> = model.bodies.iter().map(|body| body.inertia.mass).collect();
        for (k, parent) in parents.iter().enumerate().rev() {
            if let Some(parent) = *parent {
                composite_mass[parent] += composite_mass[k];
            }
        }
        let mut end_row: Vec<usize> =
            model.system.stages.iter().map(|stage| stage.first_row + stage.rows.count()).collect();
        for (k, parent) in parents.iter().enumerate().rev() {
            if let Some(parent) = *parent {
                end_row[parent] = end_row[parent].max(end_row[k]);
            }
        }
        // Of each body the last child; and the last up to the body at hand.
        let (last_child, mut youngest) = (last_children(&parents), vec![None; parents.len()]);
        let place = |slots: &Slots, body: Option<usize>| body.map_or(0, |body| slots.of[body]);
        let bodies = model.bodies.iter().zip(&model.system.stages).enumerate().map(|(k, (body, stage))| {
            let renaming = match body.motion {
                Motion::Revolute if model.omissions.renamed_axes => Renaming::of(&body.tree.rotation, T::parameter),
                _ => None,
            };
            let tree = &body.tree;
            let turned = tree.rotate_back(&tree.lever);
            let BodyInertia { mass, first_moment, rotational } = &body.inertia;
            let scale = Scale::of_noise(&body.inertia_terms);
            let carrier = renaming.map_or_else(
                || {
                    shifts += 1;
                    Carrier::Shift(shifts - 1)
                },
                Carrier::Turn,
            );
            let number = T::parameter;
            LeanBody {
                carrier,
                parent: stage.parent,
                row: stage.first_row,
                q: body.q,
                lever: [number(turned[0]), number(turned[1]), number(turned[2])],
                has_lever: !model.omissions.zero_levers || tree.lever.iter().any(|&x| x != 0.0),
                lever_square: number(turned.dot(&turned)),
                mass: number(*mass),
                first_moment: [number(first_moment[0]), number(first_moment[1]), number(first_moment[2])],
                rotational: rotational.entries.map(number),
                composite_mass: number(composite_mass[k]),
                scale: [number(scale.angular), number(scale.linear)],
                terms: [0, 1, 2, 3, 4, 5].map(|i| number(body.inertia_terms[i])),
                lever_squares: [0, 1, 2].map(|i| number(2.0 * turned[i] * turned[i])),
                needs_no_force: body.needs_no_force,
                outward: outward.of[k],
                parent_outward: place(&outward, stage.parent),
                inward: inward.of[k],
                parent_inward: place(&inward, stage.parent),
                is_leaf: last_child[k].is_none(),
                sibling: stage.parent.and_then(|parent| youngest[parent].replace(k)),
                depth: 0,
                end_row: end_row[k],
                is_parted: false,
                arrives_first: stage.parent.is_some_and(|parent| last_child[parent] == Some(k)),
            }
        });
        let mut bodies: Vec<_> = bodies.collect();
        let mut steps = 0;
        for k in 0..bodies.len() {
            let count = |k: usize| model.system.stages[k].rows.count();
            bodies[k].depth = parents[k].map_or(0, |parent| bodies[parent].depth + count(parent));
            steps += count(k) * (end_row[k] - bodies[k].row).pow(2);
            bodies[k].is_parted =
                bodies[k].sibling_follows() || bodies[k].parent.is_some_and(|parent| bodies[parent].is_parted);
        }
        let is_shallow = steps <= SHALLOW * model.nv().pow(2);
        let aligned = Aligned::new(model, &bodies, &composite_mass);
        Self {
            bodies,
            aligned,
            beside: 0.0,
            is_shallow,
            outward_slots: outward.count,
            inward_slots: inward.count,
            shifts,
        }
    }

    /// The same, watched for errors beside an acceleration of this size (m/s^2, rad/s^2) where the result is smaller.
    pub fn beside(self, acceleration: f64) -> Self {
        Self { beside: acceleration, ..self }
    }
}
