//! Conservation of the momentum of floating trees, to rounding.
//!
//! A tree that a free joint connects to the base conserves nine quantities if gravity is the only external force. With
//! the center of mass c in base axes, its velocity v and the angular momentum L about it,
//!
//! ```text
//! L(t) = L(0),     v(t) = v(0) + g t,     c(t) = c(0) + v(0) t + g t^2/2
//! ```
//!
//! A step satisfies them to its order. Afterwards the tree is displaced, and its velocity changed, as one rigid body so
//! that it satisfies them. With mass m, center of mass p and central inertia J of the whole tree (the composite inertia
//! of the body of the free joint, in its axes),
//!
//! ```text
//! x += c(t) - c,     w += dw,     u += (v(t) - v) - dw x p,     J dw = L(t) - L
//! ```
//!
//! for the position x and the velocity (u, w) of the free joint. Joint coordinates inside the tree do not change, and
//! momentum is linear in the velocities, so that one correction is exact to rounding. It is of the size of the error of
//! the step, and preserves the order of the method. The targets follow from the initial state and the time, not from
//! the previous step, so that rounding errors do not accumulate.

use super::properties::{Gains, Properties};
use crate::error::Error;
use crate::joints::vectors::{cross, plus, triple, write};
use crate::kinematics::propagation::{Accumulates, sum_tip_to_base};
use crate::kinematics::{placements_base_to_tip, velocities_base_to_tip};
use crate::model::Model;
use crate::scalar::{Real, larger};
use crate::scene::Scene;
use crate::spatial::{BodyInertia, RigidShift, Symmetric3, angular, dot, linear, sum, zero};
use nalgebra::{Vector3, Vector6};

/// Number of conserved quantities of a tree: L, v and c at the start, in base axes.
pub(super) const CONSERVED: usize = 9;

/// The largest momentum correction in a step of a run.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct Correction {
    /// Relative velocity correction sqrt(E'/(E + E')), where E' is the kinetic energy of the correction alone and E
    /// that of the tree without rotors before it; zero at rest.
    pub velocity: f64,
    /// Correction of the center of mass, m.
    pub position: f64,
}

/// Name of the joint that moves a body.
fn joint_name(scene: &Scene, body: usize) -> String {
    scene.joint_of_body(body).map(|joint| joint.name.clone()).unwrap_or_default()
}

/// The root bodies of the trees, if every tree is on a free joint without torques.
pub(super) fn roots(scene: &Scene, properties: &Properties, gains: Option<&Gains>) -> Result<Vec<usize>, Error> {
    let refuse = |found: String, expected: &str| Err(Error::argument("conserve_momentum", found, expected));
    let model = scene.model();
    let mut roots = Vec::new();
    for (k, (body, stage)) in model.bodies.iter().zip(&model.system.stages).enumerate() {
        if stage.parent.is_some() {
            continue;
        }
        if !body.motion.is_free() {
            let name = joint_name(scene, k);
            let found = if name.is_empty() { "a fixed body".to_owned() } else { format!("joint {name:?}") };
            return refuse(
                found + " on the base",
                "every tree on a free joint, because the base would absorb momentum",
            );
        }
        let rows = stage.first_row..stage.first_row + 6;
        let mut acting = vec![
            ("armature", &properties.armature),
            ("damping", &properties.damping),
            ("stiffness", &properties.stiffness),
            ("friction", &properties.friction),
        ];
        if let Some(gains) = gains {
            let [proportional, derivative, ..] = Gains::names();
            acting.extend([(proportional, &gains.proportional), (derivative, &gains.derivative)]);
        }
        for (name, values) in acting {
            if let Some(value) = values[rows.clone()].iter().find(|&&value| value != 0.0) {
                let found = format!("{name} {value} along free joint {:?}", joint_name(scene, k));
                return refuse(found, "zero for free joints, because external torques change the momentum");
            }
        }
        roots.push(k);
    }
    if roots.is_empty() {
        return refuse("a scene without degrees of freedom".to_owned(), "trees on free joints");
    }
    Ok(roots)
}

/// The error for an applied torque along a free joint, if there is one.
pub(super) fn outer_torque(scene: &Scene, roots: &[usize], torque: &[f64]) -> Option<Error> {
    let nv = scene.nv().max(1);
    torque.chunks_exact(nv).find_map(|torque| {
        roots.iter().find_map(|&k| {
            let first = scene.model().system.stages[k].first_row;
            let acting = torque[first..first + 6].iter().find(|&&value| value != 0.0)?;
            let found = format!("{acting} along free joint {:?}", joint_name(scene, k));
            Some(Error::argument("tau", found, "zero for free joints with conserve_momentum"))
        })
    })
}

/// The arrays of the correction; empty if momentum is not conserved.
#[derive(Debug, Clone)]
pub(super) struct MomentumProjection<T> {
    roots: Vec<usize>,
    shift: Vec<RigidShift<T>>,
    velocity: Vec<Vector6<T>>,
    outboard: Vec<Outboard<T>>,
    /// The [`CONSERVED`] quantities of each tree.
    pub start: Vec<T>,
    /// Time since the start of each state, s.
    pub time: T,
    /// The last correction: relative velocity and position (m), the largest over the trees.
    pub correction: [T; 2],
    /// The largest correction of the run.
    pub largest: [T; 2],
}

/// Momentum, twice the kinetic energy, and composite inertia of a body and all bodies outboard of it.
#[derive(Debug, Clone, Copy)]
struct Outboard<T> {
    momentum: Vector6<T>,
    energy: T,
    composite: BodyInertia<T>,
}

impl<T: Real> Accumulates<T> for Outboard<T> {
    #[inline(always)]
    fn propagated(&self, shift: &RigidShift<T>) -> Self {
        let Self { momentum, energy, composite } = self;
        Self { momentum: shift.force_to_parent(momentum), energy: *energy, composite: composite.to_parent(shift) }
    }

    #[inline(always)]
    fn plus(&self, other: &Self) -> Self {
        Self {
            momentum: sum(&self.momentum, &other.momentum),
            energy: self.energy + other.energy,
            composite: self.composite.add(&other.composite),
        }
    }
}

/// A tree as one rigid body, in the axes of its root body.
struct RigidTree<T> {
    mass: T,
    /// Center of mass from the origin of the root body.
    center: Vector3<T>,
    /// Velocity of the center of mass, and angular momentum about it.
    velocity: Vector3<T>,
    spin: Vector3<T>,
    /// Inertia about the center of mass.
    inertia: Symmetric3<T>,
}

impl<T: Real> MomentumProjection<T> {
    pub fn new(model: &Model<T>, roots: &[usize]) -> Self {
        let bodies = if roots.is_empty() { 0 } else { model.bodies.len() };
        let o = T::zero();
        Self {
            roots: roots.to_vec(),
            shift: vec![RigidShift::filled(o); bodies],
            velocity: vec![zero(); bodies],
            outboard: vec![Outboard { momentum: zero(), energy: o, composite: BodyInertia::zero() }; bodies],
            start: vec![o; CONSERVED * roots.len()],
            time: o,
            correction: [o; 2],
            largest: [o; 2],
        }
    }

    /// True if the momentum of any tree is conserved.
    #[inline(always)]
    pub fn is_active(&self) -> bool {
        !self.roots.is_empty()
    }

    /// Accumulates momentum, energy and inertia of every tree at its root body.
    #[inline(always)]
    fn gather(&mut self, model: &Model<T>, q: &[T], v: &[T]) {
        let Self { shift, velocity, outboard, .. } = self;
        placements_base_to_tip(model, q, shift);
        velocities_base_to_tip(model, shift, v, velocity);
        for ((outboard, velocity), body) in outboard.iter_mut().zip(velocity).zip(&model.bodies) {
            let momentum = body.inertia.mul_motion(velocity);
            *outboard = Outboard { momentum, energy: dot(velocity, &momentum), composite: body.inertia };
        }
        sum_tip_to_base(&model.system.stages, shift, outboard);
    }

    /// The tree with root body `k` as one rigid body, after [`MomentumProjection::gather`].
    #[inline(always)]
    fn whole(&self, k: usize) -> RigidTree<T> {
        let Outboard { momentum, composite, .. } = &self.outboard[k];
        let BodyInertia { mass, first_moment: h, rotational } = composite;
        let over = mass.recip();
        let center = times(h, over);
        let pushed = linear(momentum);
        let minus_one = over.constant(-1.0);
        let [xx, xy, xz, yy, yz, zz] = rotational.entries;
        let (x, y, z) = (h[0] * center[0], h[1] * center[1], h[2] * center[2]);
        RigidTree {
            mass: *mass,
            velocity: times(&pushed, over),
            spin: plus(&angular(momentum), minus_one, &cross(&center, &pushed)),
            inertia: Symmetric3::new([
                xx - (y + z),
                h[0].mul_add(center[1], xy),
                h[0].mul_add(center[2], xz),
                yy - (x + z),
                h[1].mul_add(center[2], yz),
                zz - (x + y),
            ]),
            center,
        }
    }

    /// Stores the conserved quantities of a state at time zero.
    pub fn begin(&mut self, model: &Model<T>, q: &[T], v: &[T]) {
        self.gather(model, q, v);
        for i in 0..self.roots.len() {
            let k = self.roots[i];
            let (tree, shift) = (self.whole(k), &self.shift[k]);
            let one = tree.mass.constant(1.0);
            let place = plus(&shift.lever, one, &shift.rotate(&tree.center));
            let at = i * CONSERVED;
            write(&mut self.start[at..], &shift.rotate(&tree.spin));
            write(&mut self.start[at + 3..], &shift.rotate(&tree.velocity));
            write(&mut self.start[at + 6..], &place);
        }
    }

    /// Calls [`MomentumProjection::correct`] if the momentum of a tree is conserved.
    #[inline(always)]
    pub fn correct_if_active(&mut self, model: &Model<T>, q: &mut [T], v: &mut [T]) {
        if self.is_active() {
            self.correct(model, q, v);
        }
    }

    /// Corrects `q` and `v` of every tree to the conserved quantities at [`MomentumProjection::time`].
    #[inline(always)]
    pub fn correct(&mut self, model: &Model<T>, q: &mut [T], v: &mut [T]) {
        self.gather(model, q, v);
        for i in 0..self.roots.len() {
            let k = self.roots[i];
            let (tree, shift) = (self.whole(k), self.shift[k]);
            let kept = &self.start[i * CONSERVED..(i + 1) * CONSERVED];
            let (spin, velocity, place) = (triple(kept), triple(&kept[3..]), triple(&kept[6..]));
            let (g, one) = (&model.gravity, tree.mass.constant(1.0));
            let (t, minus_one) = (self.time, one.constant(-1.0));
            let fallen = plus(&velocity, one.constant(0.5) * t, g);
            let place = plus(&place, t, &fallen);
            let velocity = plus(&velocity, t, g);

            let behind = plus(&plus(&place, minus_one, &shift.lever), minus_one, &shift.rotate(&tree.center));
            let slower = plus(&shift.rotate_back(&velocity), minus_one, &tree.velocity);
            let missing = plus(&shift.rotate_back(&spin), minus_one, &tree.spin);
            let turn = solve(&tree.inertia, &missing);
            let push = plus(&slower, minus_one, &cross(&turn, &tree.center));

            let (at, row) = (model.bodies[k].q, model.system.stages[k].first_row);
            let moved = model.bodies[k].tree.rotate_back(&behind);
            add(&mut q[at..], &moved);
            add(&mut v[row..], &push);
            add(&mut v[row + 3..], &turn);

            let change = tree.mass.mul_add(product(&slower, &slower), product(&missing, &turn));
            let all = self.outboard[k].energy + change;
            let own = [(change / (all + all.one_if_zero())).sqrt(), product(&behind, &behind).sqrt()];
            self.correction = if i == 0 { own } else { largest(self.correction, own) };
        }
    }

    /// Updates the largest correction of the run.
    #[inline(always)]
    pub fn remember(&mut self) {
        self.largest = largest(self.largest, self.correction);
    }
}

/// The larger of each entry; NaN if either is NaN.
#[inline(always)]
fn largest<T: Real>(a: [T; 2], b: [T; 2]) -> [T; 2] {
    [larger(a[0], b[0]), larger(a[1], b[1])]
}

/// a += x.
#[inline(always)]
fn add<T: Real>(a: &mut [T], x: &Vector3<T>) {
    for i in 0..3 {
        a[i] += x[i];
    }
}

/// s x.
#[inline(always)]
fn times<T: Real>(x: &Vector3<T>, s: T) -> Vector3<T> {
    Vector3::new(x[0] * s, x[1] * s, x[2] * s)
}

/// a . b.
#[inline(always)]
fn product<T: Real>(a: &Vector3<T>, b: &Vector3<T>) -> T {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

/// a^-1 b for a positive definite a, by its L D L* factorization.
#[inline(always)]
fn solve<T: Real>(a: &Symmetric3<T>, b: &Vector3<T>) -> Vector3<T> {
    let [xx, xy, xz, yy, yz, zz] = a.entries;
    let first = xx.recip();
    let (l1, l2) = (xy * first, xz * first);
    let second = yy.minus_product(l1, xy).recip();
    let below = yz.minus_product(l1, xz);
    let l3 = below * second;
    let third = zz.minus_product(l2, xz).minus_product(l3, below).recip();
    let y = b[1].minus_product(l1, b[0]);
    let z = b[2].minus_product(l2, b[0]).minus_product(l3, y) * third;
    let y = (y * second).minus_product(l3, z);
    Vector3::new((b[0] * first).minus_product(l1, y).minus_product(l2, z), y, z)
}
