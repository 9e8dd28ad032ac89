//! The constants of a scene as these sweeps read them: one number for all lanes, in frames of their own.
//!
//! Where an exact renaming of axes stands between a body and its parent, signs and places become part of the body's constants, no digit of
//! them touched: its z is then one axis of its parent's at zero angle, its x and y the two that follow it in their cycle. What is left of a
//! turn is a rotation about z, to one side or the other, and one of three ways to read the parent's vectors.

use super::slots::{Places, last_children};
use super::turn::{Axis, Renaming, renames_axes};
use crate::filter::pivots::Scale;
use crate::scalar::Real;
use crate::scene::{Body, Model, Motion};
use crate::spatial::BodyInertia;
use nalgebra::{Matrix3, Vector6};

/// As many joints inward of both as two joints may have, on average over all pairs, for M^-1 to be multiplied out: it takes less time below, on
/// chains and robots, for one state and in lanes.
const SHALLOW: usize = 10;

/// As many bodies are swept in an order of their own; of more, neighbours in it would be too far from each other in memory.
const INTERLEAVED: usize = 500;

/// The order of the sweeps over one vector a body, parents first: those at equal depth one after another, for they do not wait for each
/// other, and what a body waits for was done a while ago.
fn interleaved(parents: &[Option<usize>]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..parents.len()).collect();
    if parents.len() <= INTERLEAVED {
        let mut depths: Vec<usize> = Vec::with_capacity(parents.len());
        for parent in parents {
            depths.push(parent.map_or(0, |parent| depths[parent] + 1));
        }
        order.sort_by_key(|&k| depths[k]);
    }
    order
}

/// How a body hangs on its parent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Carrier {
    /// A revolute joint about an axis of its parent's frame.
    Turn(Axis),
    /// Any other: index among those.
    Shift(usize),
}

/// One body.
#[allow(clippy::struct_excessive_bools)] // facts, each by itself
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LeanBody<N> {
    pub carrier: Carrier,
    /// Of a turn, 1, or -1 where its z points the other way: angle, rate, acceleration and torque are those about z, times this.
    pub sense: N,
    /// To its frame here from its frame in the model.
    pub frame: Renaming<N>,
    /// Its index, and that of the body inward.
    pub index: usize,
    pub parent: Option<usize>,
    /// Its first row.
    pub row: usize,
    /// Its first coordinate.
    pub q: usize,
    /// From the parent's origin to the body's, in the joint's frame: the body's at zero angle.
    pub lever: [N; 3],
    /// Whether the lever is there: not zero, or not left out.
    pub has_lever: bool,
    /// The lever's square.
    pub lever_square: N,
    /// Mass, first moment, rotational inertia about the origin.
    pub mass: N,
    pub first_moment: [N; 3],
    pub rotational: [N; 6],
    /// The bounds on the terms of M(k).
    pub scale: [N; 2],
    /// The terms of its diagonal.
    pub terms: [N; 6],
    /// Twice the squares of the lever's entries.
    pub lever_squares: [N; 3],
    pub needs_no_force: bool,
    /// In the order of the sweeps over one vector a body, and in that of the rows.
    pub swept: Places,
    pub by_rows: Places,
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
}

impl<N> LeanBody<N> {
    /// Whether a later body hangs on the same parent.
    #[inline(always)]
    pub fn sibling_follows(&self) -> bool {
        self.parent.is_some() && !self.by_rows.arrives_first
    }
}

/// A body with all outboard of it, which turn rigidly about it as far as M goes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CompositeBody<N> {
    pub mass: N,
    /// The mass times the lever.
    pub lever: [N; 3],
    /// Twice the body's lever; and entry by entry the lever times the above.
    pub twice_lever: [N; 3],
    pub lever_moment: [N; 3],
}

/// The bodies of a scene.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LeanModel<T: Real> {
    pub(super) bodies: Vec<LeanBody<T::Parameter>>,
    /// The same in the order of the sweeps over one vector a body; none where that is theirs.
    reordered: Vec<LeanBody<T::Parameter>>,
    /// Where each body is in that order: what these sweeps keep of it is there.
    pub(super) at: Vec<usize>,
    /// What M needs of them besides.
    pub(super) composites: Vec<CompositeBody<T::Parameter>>,
    /// Those that are not on a turn, whole: their frames are the model's, those of their parents need not be.
    pub(super) shifting: Vec<Body<T>>,
    /// First coordinate of every body on a turn, and its place in the order of the sweeps.
    pub(super) turning: Vec<(usize, usize)>,
    pub(super) outward_slots: usize,
    pub(super) inward_slots: usize,
    /// The acceleration that errors are seen beside where the digits are watched; zero where each digit of the result counts.
    pub(super) beside: f64,
    /// Whether M^-1 is its factors multiplied out.
    pub(super) is_shallow: bool,
}

impl<T: Real> LeanModel<T> {
    pub fn new(model: &Model<f64>) -> Self {
        let parents: Vec<_> = model.system.stages.iter().map(|stage| stage.parent).collect();
        let order = interleaved(&parents);
        let mut at = vec![0; order.len()];
        for (place, &k) in order.iter().enumerate() {
            at[k] = place;
        }
        let (swept, swept_slots) = Places::of(&parents, &order);
        let (by_rows, slots) = Places::of(&parents, &(0..parents.len()).collect::<Vec<_>>());
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
        let number = T::parameter;
        // From the model's frame of each body to ours, zeros and ones.
        let mut frames: Vec<Matrix3<f64>> = Vec::with_capacity(parents.len());
        let (mut model_here, mut shifting, mut turning) = (model.clone(), Vec::new(), Vec::new());
        let mut composites = Vec::with_capacity(parents.len());
        let bodies = model_here.bodies.iter_mut().zip(&model.system.stages).enumerate().map(|(k, (body, stage))| {
            let turns = matches!(body.motion, Motion::Revolute)
                && model.omissions.renamed_axes
                && renames_axes(&body.tree.rotation);
            let outer = stage.parent.map_or_else(Matrix3::identity, |parent| frames[parent]);
            let rotation = outer * body.tree.rotation;
            body.tree.lever = outer * body.tree.lever;
            body.tree.rotation = rotation;
            let (carrier, frame) = if turns {
                turning.push((body.q, at[k]));
                let axis = Axis::new(rotation.column(2).iamax());
                (Carrier::Turn(axis), axis.rotation().transpose() * rotation)
            } else {
                shifting.push(k);
                (Carrier::Shift(shifting.len() - 1), Matrix3::identity())
            };
            frames.push(frame);
            // Of any other body the lever is in no frame that a sweep knows: only its length is asked for.
            let turned = frame * rotation.transpose() * body.tree.lever;
            let BodyInertia { mass, .. } = &body.inertia;
            let (first_moment, rotational) =
                (frame * body.inertia.first_moment, body.inertia.rotational.congruence(&frame));
            let (renaming, exactly) = (Renaming::of(&frame, number), Renaming::of(&frame, |x| x));
            let terms: [f64; 6] = exactly.from_model(&body.inertia_terms).map(f64::abs);
            let scale = Scale::of_noise(&Vector6::from(terms));
            let lever = <[f64; 3]>::from(turned);
            composites.push(CompositeBody {
                mass: number(composite_mass[k]),
                lever: lever.map(|l| number(composite_mass[k] * l)),
                twice_lever: lever.map(|l| number(2.0 * l)),
                lever_moment: lever.map(|l| number(composite_mass[k] * l * l)),
            });
            LeanBody {
                carrier,
                sense: number(frame[(2, 2)]),
                frame: renaming,
                index: k,
                parent: stage.parent,
                row: stage.first_row,
                q: body.q,
                lever: [number(turned[0]), number(turned[1]), number(turned[2])],
                has_lever: !model.omissions.zero_levers || lever.iter().any(|&x| x != 0.0),
                lever_square: number(turned.dot(&turned)),
                mass: number(*mass),
                first_moment: [number(first_moment[0]), number(first_moment[1]), number(first_moment[2])],
                rotational: rotational.entries.map(number),
                scale: [number(scale.angular), number(scale.linear)],
                terms: terms.map(number),
                lever_squares: [0, 1, 2].map(|i| number(2.0 * turned[i] * turned[i])),
                needs_no_force: body.needs_no_force,
                swept: swept[k],
                by_rows: by_rows[k],
                is_leaf: last_child[k].is_none(),
                sibling: stage.parent.and_then(|parent| youngest[parent].replace(k)),
                depth: 0,
                end_row: end_row[k],
                is_parted: false,
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
        let whole = model_here.cast::<T>();
        let shifting = shifting.into_iter().map(|k| whole.bodies[k]).collect();
        let in_order = order.iter().enumerate().all(|(place, &k)| place == k);
        let reordered = if in_order { Vec::new() } else { order.iter().map(|&k| bodies[k].clone()).collect() };
        turning.sort_by_key(|&(_, place)| place);
        Self {
            bodies,
            reordered,
            at,
            composites,
            shifting,
            turning,
            beside: 0.0,
            is_shallow,
            // Enough for either order.
            outward_slots: swept_slots[0].max(slots[0]),
            inward_slots: swept_slots[1].max(slots[1]),
        }
    }

    /// The bodies in the order of the sweeps over one vector a body.
    #[inline(always)]
    pub(super) fn swept(&self) -> &[LeanBody<T::Parameter>] {
        if self.reordered.is_empty() { &self.bodies } else { &self.reordered }
    }

    /// The same, watched for errors beside an acceleration of this size (m/s^2, rad/s^2) where the result is smaller.
    pub fn beside(self, acceleration: f64) -> Self {
        Self { beside: acceleration, ..self }
    }
}
