//! Contacts of shapes in one step: which pairs can be reached, and their points as contacts of the step.
//!
//! A pair is examined if the boxes about its shapes, enlarged by how far the shapes can move in the step, overlap. Its
//! points have the features that are near at the start of the step. A pair that is apart at the start and does not meet
//! on its way has no contact: a ball that passes a box is not deflected. Points that no joint moves along their normal
//! are omitted.

use super::gap::touching_gap;
use crate::collision::{Against, Near, contacts, distance, on_line};
use crate::kinematics::{placements_base_to_tip, placements_on_base, velocities_base_to_tip};
use crate::scene::Scene;
use crate::scene::collider_pairs::{Colliders, Placed};
use crate::scene::contact_point::{ContactPoint, OtherSurface, Shape, Touch, plane_axes, probing_rates};
use crate::spatial::{RigidShift, angular, linear, zero};
use nalgebra::{Rotation3, Vector3, Vector6};
use std::collections::HashMap;
use std::sync::Arc;

/// Largest number of distances of a pair on its way.
const MOST_LOOKS: usize = 32;

/// Two spheres are level above a face up to this difference of their heights, and edges up to this height above a face
/// do not rise above it, relative to the radius.
const LEVEL: f64 = 1e-5;
const FLUSH: f64 = 1e-7;

/// A velocity below this, relative to its terms, is rounding.
const STILL: f64 = 1e-12;

/// Bounds of the displacement of a shape in a step, m, and of the change of its velocity, m/s.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Range {
    pub displacement: f64,
    pub change: f64,
}

/// The pair of colliders of a contact, and whether its point belongs to the second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PairOf {
    pub colliders: [usize; 2],
    pub on_second: bool,
    /// True if the surface is a face.
    pub is_face: bool,
}

/// Scratch memory for the shapes of one state.
pub(in crate::motion) struct Shapes {
    all: Arc<Colliders>,
    /// Distance of the farthest point of each collider from the origin of its body, m.
    radii: Vec<f64>,
    shift: Vec<RigidShift<f64>>,
    /// Poses of the bodies, and of the colliders, in the base frame.
    bodies: Vec<RigidShift<f64>>,
    places: Vec<RigidShift<f64>>,
    /// Velocities of the bodies in their frames; those of joints that all move.
    velocity: Vec<Vector6<f64>>,
    probing: Vec<Vector6<f64>>,
    probe: Vec<f64>,
    ranges: Vec<Range>,
    boxes: Vec<(Vector3<f64>, Vector3<f64>)>,
    order: Vec<usize>,
    near: Vec<Near>,
    paths: HashMap<[Option<usize>; 2], Arc<[usize]>>,
    names: HashMap<[usize; 2], Arc<str>>,
    /// The contacts that were found, and their pairs.
    pub(super) points: Vec<ContactPoint>,
    pub(super) pairs: Vec<PairOf>,
    /// The state of the last search by [`Shapes::find`].
    found_at: (Vec<f64>, Vec<f64>),
    step: f64,
    /// The least gap of the last search, m; infinite if there is none.
    pub least: f64,
}

impl Shapes {
    /// `None` for a scene without shapes that can touch.
    pub fn new(scene: &Scene) -> Option<Self> {
        let (all, model) = (scene.shapes()?, scene.model());
        let (n, bodies) = (all.all.len(), model.bodies.len());
        Some(Self {
            radii: all.all.iter().map(|of| of.geometry.reach(&of.frame)).collect(),
            shift: vec![RigidShift::identity(); bodies],
            bodies: vec![RigidShift::identity(); bodies],
            places: vec![RigidShift::identity(); n],
            velocity: vec![zero(); bodies],
            probing: vec![zero(); bodies],
            probe: probing_rates(model.nv()),
            ranges: vec![Range::default(); n],
            boxes: vec![(Vector3::zeros(), Vector3::zeros()); n],
            order: (0..n).collect(),
            near: Vec::new(),
            paths: HashMap::new(),
            names: HashMap::new(),
            points: Vec::new(),
            pairs: Vec::new(),
            found_at: (Vec::new(), Vec::new()),
            step: f64::NAN,
            least: f64::INFINITY,
            all: Arc::clone(all),
        })
    }

    /// The pairs that penetrate each other at a state, and their depth at each point, m.
    pub fn depths(&mut self, scene: &Scene, state: (&[f64], &[f64])) -> Vec<([usize; 2], f64)> {
        self.find_within(scene, 1.0, state, |_, _| Range::default());
        let model = scene.model();
        let depth = |(point, pair): (&ContactPoint, &PairOf)| (pair.colliders, -point.touch_at(model, state.0).gap);
        self.points.iter().zip(&self.pairs).map(depth).filter(|(_, depth)| *depth > 0.0).collect()
    }

    /// Poses and velocities at a state.
    fn place(&mut self, scene: &Scene, (q, v): (&[f64], &[f64])) {
        let model = scene.model();
        placements_base_to_tip(model, q, &mut self.shift);
        self.bodies.copy_from_slice(&self.shift);
        placements_on_base(model, 0..model.bodies.len(), &mut self.bodies);
        velocities_base_to_tip(model, &self.shift, v, &mut self.velocity);
        for (place, of) in self.places.iter_mut().zip(&self.all.all) {
            *place = of.body.map_or(of.frame, |k| self.bodies[k].compose(&of.frame));
        }
    }

    /// The ranges in a step of `h` at the velocities of the last state, and those of free fall.
    fn range(&mut self, scene: &Scene, h: f64) {
        let slack = 2.0 * touching_gap(scene.model(), h);
        for (at, of) in self.all.all.iter().enumerate() {
            let moving = || Range { displacement: h * self.speed(at) + slack, change: slack / h };
            self.ranges[at] = of.body.map_or_else(Range::default, |_| moving());
        }
    }

    /// A bound of the speed of the points of a collider, m/s.
    fn speed(&self, at: usize) -> f64 {
        let of = |k: usize| linear(&self.velocity[k]).norm() + angular(&self.velocity[k]).norm() * self.radii[at];
        self.all.all[at].body.map_or(0.0, of)
    }

    /// Finds the contacts that a step of `h` from a state can reach.
    pub fn find(&mut self, scene: &Scene, h: f64, state: (&[f64], &[f64])) {
        if self.step.to_bits() == h.to_bits() && self.found_at.0 == state.0 && self.found_at.1 == state.1 {
            return;
        }
        self.place(scene, state);
        self.range(scene, h);
        self.search(scene, h);
        self.step = h;
        self.found_at.0.clear();
        self.found_at.0.extend_from_slice(state.0);
        self.found_at.1.clear();
        self.found_at.1.extend_from_slice(state.1);
    }

    /// Finds the contacts that a step from a state can reach, for the ranges of a body at a distance from its origin.
    pub(super) fn find_within(
        &mut self,
        scene: &Scene,
        h: f64,
        state: (&[f64], &[f64]),
        of: impl Fn(usize, f64) -> Range,
    ) {
        self.place(scene, state);
        for (at, collider) in self.all.all.iter().enumerate() {
            self.ranges[at] = collider.body.map_or_else(Range::default, |k| of(k, self.radii[at]));
        }
        self.search(scene, h);
    }

    /// True if a shape moves farther at these velocities than the last search assumed; the ranges are then theirs.
    pub fn exceeds(&mut self, scene: &Scene, h: f64, v: &[f64]) -> bool {
        let before = self.ranges.clone();
        velocities_base_to_tip(scene.model(), &self.shift, v, &mut self.velocity);
        self.range(scene, h);
        let mut exceeds = false;
        for (now, before) in self.ranges.iter_mut().zip(before) {
            exceeds |= now.displacement > before.displacement + before.change * h;
            now.displacement = now.displacement.max(before.displacement);
        }
        exceeds
    }

    /// Searches again within the present ranges, from velocities `v`.
    pub fn search_again(&mut self, scene: &Scene, h: f64, v: &[f64]) {
        velocities_base_to_tip(scene.model(), &self.shift, v, &mut self.velocity);
        self.search(scene, h);
    }

    fn search(&mut self, scene: &Scene, h: f64) {
        self.step = f64::NAN;
        self.points.clear();
        self.pairs.clear();
        self.least = f64::INFINITY;
        let all = Arc::clone(&self.all);
        for (at, of) in all.all.iter().enumerate() {
            let (center, half) = of.geometry.bounds(&self.places[at]);
            self.boxes[at] = (center, half.add_scalar(self.ranges[at].displacement + 0.5 * all.margin));
        }
        let boxes = &self.boxes;
        let low = |i: usize| if boxes[i].1[0].is_finite() { boxes[i].0[0] - boxes[i].1[0] } else { f64::NEG_INFINITY };
        self.order.sort_unstable_by(|&i, &j| low(i).total_cmp(&low(j)));
        let order = std::mem::take(&mut self.order);
        let mut probed = false;
        for (from, &i) in order.iter().enumerate() {
            let high = self.boxes[i].0[0] + self.boxes[i].1[0];
            for &j in &order[from + 1..] {
                let (other, half) = self.boxes[j];
                if other[0] - half[0] > high {
                    break;
                }
                if all.can_touch(i, j) && self.overlap(i, j) {
                    let (i, j) = (i.min(j), i.max(j));
                    self.meet(scene, h, [i, j], &mut probed);
                }
            }
        }
        self.order = order;
        self.omit_hidden();
    }

    /// Omits contacts with edges and corners that a face hides: a sphere or rim on a face, or another point of its body
    /// that is level with it, touches the plane of the face before anything on or below that plane. A ball or a
    /// cylinder that rolls over flush tiles or triangles does not hit their edges.
    fn omit_hidden(&mut self) {
        let Self { points, pairs, bodies, .. } = self;
        let surface = |i: usize| points[i].other_body().map_or_else(RigidShift::identity, |k| bodies[k]);
        let touch = |i: usize| points[i].touch(&bodies[points[i].body], &surface(i));
        let mut order: Vec<usize> = (0..points.len()).collect();
        order.sort_by_key(|&i| points[i].body);
        let mut hidden = vec![false; points.len()];
        for of_body in order.chunk_by(|&i, &j| points[i].body == points[j].body) {
            let place = &bodies[points[of_body[0]].body];
            let below = |i: usize, normal: &Vector3<f64>| {
                place.rotate(&points[i].center) + points[i].arm(Some(place), normal).0
            };
            let is_round = |i: &&usize| points[**i].radius > 0.0 && pairs[**i].is_face;
            for &i in of_body.iter().filter(is_round) {
                let (face, size) = (touch(i), points[i].radius);
                if !points[i].is_on_face(&face, &surface(i)) {
                    continue;
                }
                let normal = face.normal();
                for &j in of_body.iter().filter(|&&j| points[j].other_body() == points[i].other_body()) {
                    let edge = touch(j);
                    let height = |x: &Touch| normal.dot(&(x.at - x.normal() * x.gap));
                    hidden[j] |= !(pairs[j].is_face && points[j].is_on_face(&edge, &surface(j)))
                        && normal.dot(&(below(i, &normal) - below(j, &normal))).abs() <= LEVEL * size
                        && height(&edge) - height(&face) <= FLUSH * size;
                }
            }
        }
        let mut of_points = hidden.iter();
        points.retain(|_| !of_points.next().is_some_and(|hidden| *hidden));
        let mut of_pairs = hidden.iter();
        pairs.retain(|_| !of_pairs.next().is_some_and(|hidden| *hidden));
    }

    fn overlap(&self, i: usize, j: usize) -> bool {
        let (a, b) = (&self.boxes[i], &self.boxes[j]);
        (0..3).all(|axis| (a.0[axis] - b.0[axis]).abs() <= a.1[axis] + b.1[axis])
    }

    /// Adds the contacts of a pair.
    fn meet(&mut self, scene: &Scene, h: f64, [i, j]: [usize; 2], probed: &mut bool) {
        let all = Arc::clone(&self.all);
        let (a, b) = (&all.all[i], &all.all[j]);
        let relative = self.places[i].inverse().compose(&self.places[j]);
        let values = all.values(i, j);
        let reach = self.ranges[i].displacement + self.ranges[j].displacement + values.margin;
        let mut near = std::mem::take(&mut self.near);
        near.clear();
        contacts(&a.geometry, &b.geometry, &relative, reach, &mut near);
        let least = near.iter().fold(f64::INFINITY, |least, of| least.min(of.gap - values.margin));
        let slack = touching_gap(scene.model(), h);
        let meets = least <= slack || (least.is_finite() && self.meets_on_the_way([i, j], h, slack + values.margin));
        if meets && least.is_finite() {
            if !*probed {
                velocities_base_to_tip(scene.model(), &self.shift, &self.probe, &mut self.probing);
                *probed = true;
            }
            let name = self.names.entry([i, j]).or_insert_with(|| format!("{} on {}", a.name, b.name).into());
            let name = Arc::clone(name);
            for of in &near {
                let ends = if of.on_first { [i, j] } else { [j, i] };
                let Some((mut point, swapped)) = self.point_of(of, ends, &name) else { continue };
                (point.friction, point.restitution) = (values.friction, values.restitution);
                match &mut point.other {
                    None => point.offset += values.margin,
                    Some(surface) => surface.raise(values.margin),
                }
                if !self.can_move(&point) {
                    continue;
                }
                let bodies = [Some(point.body), point.other_body()];
                let path = self.paths.entry(bodies).or_insert_with(|| scene.inward_from(bodies).into());
                point.path = Arc::clone(path);
                self.least = self.least.min(of.gap - values.margin);
                self.points.push(point);
                self.pairs.push(PairOf { colliders: [i, j], on_second: of.on_first == swapped, is_face: of.is_face });
            }
        }
        self.near = near;
    }

    /// True if a pair that is apart meets within a step at its present velocities, up to a distance.
    fn meets_on_the_way(&self, [i, j]: [usize; 2], h: f64, slack: f64) -> bool {
        let all = &self.all.all;
        let slack = slack + h * (self.ranges[i].change + self.ranges[j].change);
        let moved = |at: usize, t: f64| match all[at].body {
            None => self.places[at],
            Some(k) => {
                let velocity = &self.velocity[k];
                let turn = *Rotation3::new(angular(velocity) * t).matrix();
                let step = RigidShift { rotation: turn, lever: linear(velocity) * t };
                self.bodies[k].compose(&step).compose(&all[at].frame)
            }
        };
        let speed = self.speed(i) + self.speed(j);
        let mut t = 0.0;
        for _ in 0..MOST_LOOKS {
            let relative = moved(i, t).inverse().compose(&moved(j, t));
            let rest = (h - t) * speed + slack;
            let Some(found) = distance(&all[i].geometry, &all[j].geometry, &relative, rest) else { return false };
            if found.distance <= slack {
                return true;
            }
            t += (found.distance - 0.5 * slack) / speed;
            if !(t < h) {
                return false;
            }
        }
        true
    }

    /// A contact of the step, for the colliders of its point and of its surface, and whether their roles are exchanged:
    /// its point must be on a body that moves.
    fn point_of(&self, near: &Near, [own, other]: [usize; 2], name: &Arc<str>) -> Option<(ContactPoint, bool)> {
        let (point, surface) = (&self.all.all[own], &self.all.all[other]);
        let on_body = |of: &Placed, x: &Vector3<f64>| of.frame.rotate(x) + of.frame.lever;
        if let Some(body) = point.body {
            let (frame, shape) = match &near.against {
                Against::Plane { normal, offset } => {
                    let turned = surface.frame.rotate(normal);
                    (plane(&turned, on_body(surface, &(normal * *offset))), Shape::Plane)
                }
                Against::Sphere { center, radius } => {
                    let lever = on_body(surface, center);
                    (RigidShift { rotation: surface.frame.rotation, lever }, Shape::Sphere(*radius))
                }
                Against::Line { ends: [from, to], radius } => {
                    let along = surface.frame.rotate(&(to - from));
                    let half = Vector3::new(0.0, 0.0, 0.5 * along.norm());
                    (plane(&along.normalize(), on_body(surface, &((from + to) * 0.5))), Shape::Box(half, *radius))
                }
                Against::Box(half) => (surface.frame, Shape::Box(*half, 0.0)),
            };
            let center = on_body(point, &near.center);
            let made = contact_on(name, (body, center, near.radius), (surface.body, frame, shape));
            return Some((ContactPoint { rim: near.rim.map(|axis| point.frame.rotate(&axis)), ..made }, false));
        }
        // The point is on the base, and the surface moves: its nearest point touches what the base has there.
        let body = surface.body?;
        let (place, center) = (&self.places[other], on_body(point, &near.center));
        let sphere = RigidShift { rotation: point.frame.rotation, lever: center };
        // The nearest point of a line or box, and a sphere about it.
        let nearest =
            |at: Vector3<f64>, radius: f64| (on_body(surface, &at), radius, (sphere, Shape::Sphere(near.radius)));
        let (at, radius, on) = match &near.against {
            Against::Plane { normal, .. } => {
                let normal = place.rotate(normal);
                let rim = near.rim.map_or(normal, |axis| {
                    let axis = point.frame.rotate(&axis);
                    (normal - axis * axis.dot(&normal)).normalize()
                });
                let low = center - rim * near.radius;
                let at = place.rotate_back(&(low - normal * near.gap - place.lever));
                (on_body(surface, &at), 0.0, (plane(&-normal, low), Shape::Plane))
            }
            Against::Sphere { center, radius } => nearest(*center, *radius),
            Against::Line { ends, radius } => {
                nearest(on_line(ends, &place.rotate_back(&(center - place.lever))), *radius)
            }
            Against::Box(half) => {
                let x = place.rotate_back(&(center - place.lever));
                nearest(x.zip_map(half, |x, half| x.clamp(-half, half)), 0.0)
            }
        };
        Some((contact_on(name, (body, at, radius), (None, on.0, on.1)), true))
    }

    /// True if joint velocities can move a point along its normal.
    fn can_move(&self, point: &ContactPoint) -> bool {
        let of = |k: usize| (&self.bodies[k], &self.probing[k]);
        let (touch, velocity, terms) = point.moving(of(point.body), point.other_body().map(of));
        touch.normal().dot(&velocity).abs() > STILL * terms
    }

    /// The contacts of the last search after those that are named, for a step.
    pub fn put(&self, named: usize, points: &mut Vec<ContactPoint>) {
        points.truncate(named);
        points.extend_from_slice(&self.points);
    }
}

/// A contact of the step on a body that moves.
fn contact_on(
    name: &Arc<str>,
    (body, center, radius): (usize, Vector3<f64>, f64),
    (on_body, frame, shape): (Option<usize>, RigidShift<f64>, Shape),
) -> ContactPoint {
    let is_ground = on_body.is_none() && shape == Shape::Plane;
    let normal = frame.rotation.column(2).into_owned();
    ContactPoint {
        name: Arc::clone(name),
        body,
        center,
        radius,
        rim: None,
        axes: plane_axes(&normal),
        offset: if is_ground { normal.dot(&frame.lever) } else { 0.0 },
        other: (!is_ground).then_some(OtherSurface { body: on_body, frame, shape }),
        friction: 0.0,
        restitution: 0.0,
        path: Arc::new([]),
        found: true,
    }
}

/// The frame of a plane through a point.
fn plane(normal: &Vector3<f64>, at: Vector3<f64>) -> RigidShift<f64> {
    RigidShift { rotation: plane_axes(normal).transpose(), lever: at }
}
