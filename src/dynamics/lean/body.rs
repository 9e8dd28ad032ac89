//! The constants of a scene as these sweeps read them: one number for all lanes (or limbs), in [frames](super::frames) of their own.

use super::frames::Framed;
use super::lever::Lever;
use super::limbs::ranks;
use super::loads::Load;
use super::scales::scales_at_all_angles;
use super::segment::{OfSegment, Segment, alone_at_depth, segments};
use super::slide::Slide;
use super::slots::{Ordered, Places, SlotCounts, last_children};
use super::tilt::{Axle, Tilt};
use super::turn::Renaming;
use crate::filter::pivots::Scale;
use crate::filter::{HingeMap, Rows};
use crate::scalar::Real;
use crate::scene::{Body, Model};
use crate::spatial::{BodyInertia, BodyRoot};
use nalgebra::Matrix3;

/// As many joints inward of both as two joints may have, on average over all pairs, for M^-1 to be multiplied out: it takes less time below, on
/// chains and robots. On a chain of 64, 21 on average, a tenth less for one state and a tenth more in lanes; one number for both, or a state's bits would depend
/// on whether it is alone.
const SHALLOW: usize = 15;

/// As many bodies are swept in an order of their own: what is kept of them fits in the caches then, whatever the order. Not timed beyond.
pub(super) const INTERLEAVED: usize = 500;

/// How many bodies there are between each and the base.
pub(super) fn bodies_inward(parents: &[Option<usize>]) -> Vec<usize> {
    let mut counts: Vec<usize> = Vec::with_capacity(parents.len());
    for parent in parents {
        counts.push(parent.map_or(0, |parent| counts[parent] + 1));
    }
    counts
}

/// The order of the sweeps, but for M^-1 in closed form, parents first: those at equal depth one after another, for they do not wait for each
/// other, and what a body waits for was done a while ago. Those at equal depth by their `rank`.
pub(super) fn interleaved<R: Ord>(parents: &[Option<usize>], rank: impl Fn(usize) -> R) -> Vec<usize> {
    let mut order: Vec<usize> = (0..parents.len()).collect();
    if parents.len() <= INTERLEAVED {
        let bodies_inward = bodies_inward(parents);
        order.sort_by_key(|&k| (bodies_inward[k], rank(k)));
    }
    order
}

/// Of each body its own value joined with those of all outboard of it.
fn with_all_outboard<V: Copy>(parents: &[Option<usize>], mut values: Vec<V>, join: impl Fn(V, V) -> V) -> Vec<V> {
    for (k, parent) in parents.iter().enumerate().rev() {
        if let Some(parent) = *parent {
            values[parent] = join(values[parent], values[k]);
        }
    }
    values
}

/// Tells bodies, in the order of the rows, how many rows there are inward of them, whether they hang on a first turn, and whether they are parted from what comes later. Gives the steps that M^-1 by
/// its rows takes, and how many rows the longest path from the base has.
fn measure_paths<N>(model: &Model<f64>, bodies: &mut [LeanBody<N>]) -> (usize, usize) {
    let (mut steps, mut longest_path) = (0, 0);
    for k in 0..bodies.len() {
        let count = |k: usize| model.system.stages[k].rows.count();
        let parent = bodies[k].parent;
        bodies[k].depth = parent.map_or(0, |parent| bodies[parent].depth + count(parent));
        longest_path = longest_path.max(bodies[k].depth + count(k));
        steps += count(k) * (bodies[k].end_row - bodies[k].row).pow(2);
        let turns = |k: usize| matches!(bodies[k].carrier, Carrier::Turn(_));
        let is_first = |parent: usize| bodies[parent].parent.is_none() && turns(parent);
        bodies[k].hangs_on_first = turns(k) && parent.is_some_and(is_first);
        bodies[k].is_parted = bodies[k].sibling_follows() || parent.is_some_and(|parent| bodies[parent].is_parted);
    }
    (steps, longest_path)
}

/// A root in a body's frame here; NaN where there is none, or where something is left beside it, which depends on the frame.
fn root_in(frame: &Matrix3<f64>, root: Option<&BodyRoot<f64>>) -> BodyRoot<f64> {
    match root.map(|root| root.turned(frame)) {
        Some(root) if root.rest.iter().all(|&x| x == 0.0) => root,
        _ => BodyRoot::zero().map(|_| f64::NAN),
    }
}

/// From each parent's origin to the body's, in the parent's frame.
fn arms<N: Copy>(framed: &Framed, leaves_out: bool, number: impl Copy + Fn(f64) -> N) -> Vec<Lever<N>> {
    framed.bodies.iter().map(|body| Lever::new(body.tree.lever.into(), leaves_out, number)).collect()
}

/// How a body hangs on its parent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Carrier {
    /// A revolute joint.
    Turn(Axle),
    /// Any other, and what is left of those: index among them.
    Shift(usize),
}

/// One body.
#[allow(clippy::struct_excessive_bools)] // facts, each by itself
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LeanBody<N> {
    pub carrier: Carrier,
    /// Of what slides by constant angles, its place among those.
    pub slide: Option<usize>,
    /// Of a turn, 1, or -1 where its z points the other way: rate, acceleration and torque are those about z, times this.
    pub sense: N,
    /// To its frame here from its frame in the model.
    pub frame: Renaming<N>,
    /// Its index, and that of the body inward.
    pub index: usize,
    pub parent: Option<usize>,
    /// Its first row.
    pub row: usize,
    /// Of a turn, from the parent's origin to the body's, in the turn's frame: the body's at its zero angle, or the parent's where it is tilted.
    pub lever: Lever<N>,
    /// The lever's square.
    pub lever_square: N,
    /// Mass, first moment, rotational inertia about the origin.
    pub mass: N,
    pub first_moment: [N; 3],
    pub rotational: [N; 6],
    /// The bounds on the terms of M(k); and those on the terms of P^- at all angles, where they are [known](LeanModel::knows_scales).
    pub scale: [N; 2],
    pub scale_at_all_angles: [N; 2],
    /// The terms of its diagonal.
    pub terms: [N; 6],
    /// Twice the squares of its entries.
    pub lever_squares: [N; 3],
    /// Whether its one row is a turn about z, and whether it is [afloat](super::afloat).
    pub is_about_z: bool,
    pub is_afloat: bool,
    /// Whether the weights of its root are positive, and of its parent's.
    pub is_definite: bool,
    pub hangs_on_definite: bool,
    /// Whether it is on a turn and hangs on a body that turns on the base: that one asks of it what H picks, and nothing else.
    pub hangs_on_first: bool,
    /// How many bodies [side by side](super::limbs) in the lanes hang on one; 1 where lanes are states, and further out on limbs.
    pub limbs: usize,
    /// Whether each of the limbs has such a body; and 1 in the lanes of those that have, else 0.
    pub is_on_all_limbs: bool,
    pub stands_for_itself: N,
    pub places: Places,
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
        self.parent.is_some() && !self.places.arrives_first
    }

    /// Its numbers, but for the lever's.
    #[cfg(target_arch = "x86_64")]
    pub fn numbers_mut(&mut self) -> impl Iterator<Item = &mut N> {
        let one = [&mut self.sense, &mut self.lever_square, &mut self.mass];
        let three = [&mut self.frame.sign, &mut self.first_moment, &mut self.lever_squares];
        let six = [&mut self.rotational, &mut self.terms];
        one.into_iter()
            .chain(three.into_iter().flatten())
            .chain(six.into_iter().flatten())
            .chain(&mut self.scale)
            .chain(&mut self.scale_at_all_angles)
    }
}

/// A body with all outboard of it, held still against each other.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CompositeBody<N> {
    pub mass: N,
    /// The mass times the lever.
    pub lever: [N; 3],
    /// Twice the body's lever; and entry by entry the lever times the above.
    pub twice_lever: [N; 3],
    pub lever_moment: [N; 3],
}

impl<N> CompositeBody<N> {
    fn new(mass: f64, lever: [f64; 3], number: impl Fn(f64) -> N) -> Self {
        Self {
            mass: number(mass),
            lever: lever.map(|l| number(mass * l)),
            twice_lever: lever.map(|l| number(2.0 * l)),
            lever_moment: lever.map(|l| number(mass * l * l)),
        }
    }
}

/// What the angle of a turn is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Turning<N> {
    /// The joint's coordinate.
    pub q: usize,
    /// The body's place in the order of the sweeps.
    pub place: usize,
    /// 1, or -1 where the turn's z points the other way.
    pub sense: N,
    /// Sine and cosine where the joint's angle is zero, where they are not those of none.
    pub offset: Option<[N; 2]>,
}

/// The bodies of a scene.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LeanModel<T: Real> {
    pub(super) bodies: Vec<LeanBody<T::Parameter>>,
    /// The bodies in the order of the sweeps, with their places in it; none where that is theirs.
    pub(super) reordered: Vec<LeanBody<T::Parameter>>,
    /// What motions, forces and co-states need of them, in that order.
    pub(super) segments: Vec<Segment<T::Parameter>>,
    /// The same with every mass at its own body; empty where none was moved.
    pub(super) whole_segments: Vec<Segment<T::Parameter>>,
    /// What tilts turns, and how bodies slide.
    pub(super) tilts: Vec<Tilt<T::Parameter>>,
    pub(super) slides: Vec<Slide<T::Parameter>>,
    /// Where each body is in that order: what these sweeps keep of it is there.
    pub(super) at: Vec<usize>,
    /// What the square-root form needs of them, in the order of the sweeps: NaN of a body that has no root, or whose
    /// spin needs a force outside of it.
    pub(super) roots: Vec<BodyRoot<T::Parameter>>,
    /// What M needs of them besides, in that order.
    pub(super) composites: Vec<CompositeBody<T::Parameter>>,
    /// Those that are not on a turn, whole: the frames of those that do not slide are the model's, those of their parents need not be.
    pub(super) shifting: Vec<Body<T>>,
    /// Those on a turn, in the order of the sweeps.
    pub(super) turning: Vec<Turning<T::Parameter>>,
    /// How many slots there are in the order of the rows, and in that of those sweeps.
    pub(super) row_slots: SlotCounts,
    pub(super) swept_slots: SlotCounts,
    /// Whether the pivots' bounds are those at all angles.
    pub(super) knows_scales: bool,
    /// Whether M^-1 is its factors multiplied out.
    pub(super) is_shallow: bool,
    /// As many rows has the longest path from the base.
    pub(super) longest_path: usize,
}

/// The bodies that are carried by any shift, and what carries those that turn, by their places in the sweeps.
fn by_carrier<T: Real>(framed: &Framed, whole: &Model<T>, at: &[usize]) -> (Vec<Body<T>>, Vec<Turning<T::Parameter>>) {
    let of_carrier = |turns: bool| {
        let carriers = framed.carriers.iter().enumerate();
        carriers.filter(move |(_, carrier)| matches!(carrier, Carrier::Turn(_)) == turns).map(|(k, _)| k)
    };
    let shifting = of_carrier(false).map(|k| whole.bodies[k]).collect();
    let turning_of = |k: usize| Turning {
        q: whole.bodies[k].q,
        place: at[k],
        sense: T::parameter(framed.from_model[k][(2, 2)]),
        offset: framed.offsets[k].map(|offset| offset.map(T::parameter)),
    };
    let mut turning: Vec<_> = of_carrier(true).map(turning_of).collect();
    turning.sort_by_key(|turning| turning.place);
    (shifting, turning)
}

impl<T: Real> LeanModel<T> {
    pub fn new(model: &Model<f64>) -> Self {
        let framed = Framed::of(model);
        let ranks = ranks(model, &framed);
        let parents: Vec<_> = model.system.stages.iter().map(|stage| stage.parent).collect();
        let (order, is_alone) = (interleaved(&parents, |body| ranks[body]), alone_at_depth(&parents));
        let by_rows = Ordered::new(&parents, &(0..parents.len()).collect::<Vec<_>>());
        let swept = Ordered::new(&parents, &order);
        let masses = model.bodies.iter().map(|body| body.inertia.mass);
        let composite_mass = with_all_outboard(&parents, masses.collect(), |a, b| a + b);
        let end_rows = model.system.stages.iter().map(|stage| stage.first_row + stage.rows.count()).collect();
        let end_row = with_all_outboard(&parents, end_rows, usize::max);
        // The last child of each body; and the last up to the body at hand.
        let (last_child, mut youngest) = (last_children(&parents), vec![None; parents.len()]);
        let number = T::parameter;
        let scales = scales_at_all_angles(model, T::epsilon().lane(0));
        let mut composites = Vec::with_capacity(parents.len());
        let is_definite = |k: usize| model.inertia_roots[k].as_ref().is_some_and(BodyRoot::is_definite);
        let known = |k: usize| scales.as_ref().map_or([f64::NAN; 2], |of| [of[k].angular, of[k].linear]);
        let bodies = framed.bodies.iter().zip(&model.system.stages).enumerate().map(|(k, (body, stage))| {
            let (frame, turned) = (&framed.from_model[k], <[f64; 3]>::from(framed.levers[k]));
            let BodyInertia { mass, first_moment, rotational } = &body.inertia;
            let scale = Scale::of_noise(&body.inertia_terms);
            composites.push(CompositeBody::new(composite_mass[k], turned, number));
            LeanBody {
                carrier: framed.carriers[k],
                slide: framed.slide_at[k],
                sense: number(frame[(2, 2)]),
                frame: Renaming::of(frame, number),
                index: k,
                parent: stage.parent,
                row: stage.first_row,
                lever: Lever::new(turned, model.omissions.zero_levers, number),
                lever_square: number(turned[0] * turned[0] + turned[1] * turned[1] + turned[2] * turned[2]),
                mass: number(*mass),
                first_moment: [number(first_moment[0]), number(first_moment[1]), number(first_moment[2])],
                rotational: rotational.entries.map(number),
                scale: [number(scale.angular), number(scale.linear)],
                scale_at_all_angles: known(k).map(number),
                terms: [0, 1, 2, 3, 4, 5].map(|i| number(body.inertia_terms[i])),
                lever_squares: turned.map(|l| number(2.0 * l * l)),
                is_about_z: matches!(stage.rows, Rows::One(HingeMap::Axis(2))),
                is_afloat: matches!(stage.rows, Rows::Six) && stage.parent.is_none() && model.system.skips_zeros,
                is_definite: is_definite(k),
                hangs_on_definite: stage.parent.is_some_and(is_definite),
                hangs_on_first: false,
                limbs: 1,
                is_on_all_limbs: true,
                stands_for_itself: number(1.0),
                places: by_rows.places[k],
                is_leaf: last_child[k].is_none(),
                sibling: stage.parent.and_then(|parent| youngest[parent].replace(k)),
                depth: 0,
                end_row: end_row[k],
                is_parted: false,
            }
        });
        let mut bodies: Vec<_> = bodies.collect();
        let (steps, longest_path) = measure_paths(model, &mut bodies);
        let root = |&k: &usize| root_in(&framed.from_model[k], model.inertia_roots[k].as_ref()).map(number);
        let arms = arms(&framed, model.omissions.zero_levers, number);
        let whole = Model { bodies: framed.bodies.clone(), ..model.clone() }.cast::<T>();
        let (shifting, turning) = by_carrier(&framed, &whole, &swept.at);
        let composites = order.iter().map(|&k| composites[k].clone()).collect();
        let reordered = |&k: &usize| LeanBody { places: swept.places[k], ..bodies[k].clone() };
        let reordered = if order.is_sorted() { Vec::new() } else { order.iter().map(reordered).collect() };
        let in_order = if reordered.is_empty() { &bodies } else { &reordered };
        let with_loads = |load: &dyn Fn(usize) -> Load<f64>| {
            segments(in_order, |k| OfSegment {
                arm: arms[k],
                load: load(k).map(number),
                needs_no_force: whole.bodies[k].needs_no_force,
                waits_for_parent: is_alone[k],
            })
        };
        let moves_mass = framed.loads.iter().any(|load| load.is_off_axis);
        Self {
            segments: with_loads(&|k| framed.loads[k].clone()),
            whole_segments: if moves_mass { with_loads(&|k| Load::of(&framed.bodies[k])) } else { Vec::new() },
            bodies,
            tilts: framed.tilts.iter().map(|tilt| tilt.map(number)).collect(),
            slides: framed.slides.iter().map(|slide| slide.map(number)).collect(),
            reordered,
            at: swept.at,
            roots: order.iter().map(root).collect(),
            composites,
            shifting,
            turning,
            knows_scales: scales.is_some(),
            is_shallow: steps <= SHALLOW * model.nv().pow(2),
            longest_path,
            row_slots: by_rows.slots,
            swept_slots: swept.slots,
        }
    }

    /// How many slots M^-1 has, and how many columns each can hold: of its factors those on the longest path from the base.
    pub(super) fn column_slots(&self) -> (usize, usize) {
        if self.is_shallow {
            (self.swept_slots.outward, self.longest_path)
        } else {
            (self.row_slots.outward, self.bodies.iter().map(|body| body.end_row).max().unwrap_or(0))
        }
    }

    /// The segments with every mass at its own body.
    #[inline(always)]
    pub(super) fn whole_segments(&self) -> &[Segment<T::Parameter>] {
        if self.whole_segments.is_empty() { &self.segments } else { &self.whole_segments }
    }

    /// The bodies in the order of the sweeps.
    #[inline(always)]
    pub(super) fn swept(&self) -> &[LeanBody<T::Parameter>] {
        if self.reordered.is_empty() { &self.bodies } else { &self.reordered }
    }
}
