//! Contacts at one state: gaps, velocities, G = J M^-1 J* of the active contacts, and the effect of impulses on joint
//! velocities.
//!
//! The rows of a contact are t1, t2, n of its surface: u = J v is the velocity of the material point of the link
//! nearest to the surface, relative to the link of the surface. The innovations W of a unit force along each row, and
//! of the opposite force on the other link, are propagated inward to the base. G = W* W as for
//! [connections](super::constraints), without subtraction. Contacts whose trees are not coupled have separate blocks of
//! G.
//!
//! With connections or coupled joints, W is first projected onto the complement of their rows
//! ([`Elimination`](super::constraints::Elimination)): G and the responses are those on the connections.
//!
//! Joint limits are additional contacts without friction, numbered after the others. Their normal velocity is that of
//! the joint, away from the limit, and the two tangential velocities are zero.

pub(crate) mod derivatives;

use super::constraints::Elimination;
use super::sweeps::general;
use crate::filter::innovations;
use crate::filter::riccati::Measured;
use crate::kinematics::propagation::{inward_along_path, tip_to_base};
use crate::kinematics::{placements_base_to_tip, placements_on_base, velocities_base_to_tip};
use crate::model::Model;
use crate::scene::contact_point::{ContactPoint, Touch};
use crate::spatial::{RigidShift, dot, spatial, zero};
use crate::workspace::Workspace;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3, Vector6};

/// A row of W that the projection reduces below this, relative to its size, is zero: the connections fix its motion.
const HELD: f64 = 1e-12;

/// No row.
const NONE: usize = usize::MAX;

/// A joint limit as a row of the contact law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LimitRow {
    /// The child body of the joint.
    pub body: usize,
    /// The degree of freedom, an index in v, and the coordinate, an index in q.
    pub row: usize,
    pub coordinate: usize,
    /// True if it is the upper limit.
    pub upper: bool,
    /// The limit, rad or m.
    pub bound: f64,
}

impl LimitRow {
    /// +1 for a lower limit, -1 for an upper one: the direction away from it.
    pub fn sign(&self) -> f64 {
        if self.upper { -1.0 } else { 1.0 }
    }

    /// The distance to the limit at `q`, rad or m; negative outside.
    pub fn gap(&self, q: &[f64]) -> f64 {
        self.sign() * (q[self.coordinate] - self.bound)
    }

    /// The velocity away from the limit, rad/s or m/s.
    pub fn velocity(&self, v: &[f64]) -> f64 {
        self.sign() * v[self.row]
    }
}

/// Scratch of contacts and joint limits: about 400 bytes per body and 24 nv bytes per contact.
#[derive(Debug, Clone)]
pub(crate) struct ContactScratch {
    pub shift: Vec<RigidShift<f64>>,
    /// The pose of each body in the base frame.
    pub places: Vec<RigidShift<f64>>,
    /// The joint limits.
    pub limits: Vec<LimitRow>,
    /// The distance of each contact to its surface, m, and of each joint to its limit, rad or m.
    pub gaps: Vec<f64>,
    /// Rows t1, t2, n of each contact in the base frame.
    pub axes: Vec<Matrix3<f64>>,
    /// Unit forces along the rows of each contact, on its body, and the opposite forces on the body of its surface.
    units: Vec<[Vector6<f64>; 3]>,
    opposite: Vec<[Vector6<f64>; 3]>,
    /// The rows of connections and coupled joints, if the scene has any.
    pub closed: Option<Box<Elimination>>,
    velocity: Vec<Vector6<f64>>,
    state: Vec<Vector6<f64>>,
    torque: Vec<f64>,
    innovations: Vec<f64>,
    /// The body next to the base on the path of each body.
    roots: Vec<usize>,
    /// The first row in W of each body; `NONE` without rows.
    rows: Vec<usize>,
    /// The result of [`ContactScratch::respond`], (nv).
    pub response: Vec<f64>,
}

impl ContactScratch {
    pub fn new(model: &Model<f64>, points: &[ContactPoint], limits: Vec<LimitRow>) -> Self {
        let (bodies, nv) = (model.bodies.len(), model.nv());
        let mut roots: Vec<usize> = Vec::with_capacity(bodies);
        for (k, stage) in model.system.stages.iter().enumerate() {
            roots.push(stage.parent.map_or(k, |parent| roots[parent]));
        }
        Self {
            shift: vec![RigidShift::identity(); bodies],
            places: vec![RigidShift::identity(); bodies],
            gaps: vec![f64::NAN; points.len() + limits.len()],
            limits,
            axes: points.iter().map(|point| point.axes).collect(),
            units: vec![[zero(); 3]; points.len()],
            opposite: vec![[zero(); 3]; points.len()],
            closed: None,
            velocity: vec![zero(); bodies],
            state: vec![zero(); bodies],
            torque: vec![0.0; nv],
            innovations: vec![0.0; nv],
            roots,
            rows: vec![NONE; bodies],
            response: vec![0.0; nv],
        }
    }

    /// Gaps and rows at `q`. O(N + contacts).
    pub fn place(&mut self, model: &Model<f64>, points: &[ContactPoint], q: &[f64]) {
        placements_base_to_tip(model, q, &mut self.shift);
        self.places.copy_from_slice(&self.shift);
        placements_on_base(model, 0..model.bodies.len(), &mut self.places);
        for (i, point) in points.iter().enumerate() {
            let place = &self.places[point.body];
            let other = point.other_body().map(|k| self.places[k]);
            let Touch { axes, gap, at } = point.touch(place, &other.unwrap_or_else(RigidShift::identity));
            (self.axes[i], self.gaps[i]) = (axes, gap);
            let arm = point.center - place.rotate_back(&axes.row(2).transpose()) * point.radius;
            let unit = |place: &RigidShift<f64>, arm: &Vector3<f64>, row: usize| {
                let force = place.rotate_back(&axes.row(row).transpose());
                spatial(&arm.cross(&force), &force)
            };
            self.units[i] = std::array::from_fn(|row| unit(place, &arm, row));
            if let Some(other) = other {
                let arm = other.rotate_back(&(at - other.lever));
                self.opposite[i] = std::array::from_fn(|row| -unit(&other, &arm, row));
            }
        }
        for (gap, limit) in self.gaps[points.len()..].iter_mut().zip(&self.limits) {
            *gap = limit.gap(q);
        }
    }

    /// J v of all contacts, m/s, and of all joint limits, at the configuration of [`ContactScratch::place`]. O(N +
    /// contacts).
    pub fn velocities(&mut self, model: &Model<f64>, points: &[ContactPoint], v: &[f64]) -> DVector<f64> {
        velocities_base_to_tip(model, &self.shift, v, &mut self.velocity);
        DVector::from_fn(3 * self.gaps.len(), |i, _| match (points.get(i / 3), i % 3) {
            (Some(point), row) => {
                let own = dot(&self.units[i / 3][row], &self.velocity[point.body]);
                point.other_body().map_or(own, |k| own + dot(&self.opposite[i / 3][row], &self.velocity[k]))
            }
            (None, 2) => self.limits[i / 3 - points.len()].velocity(v),
            (None, _) => 0.0,
        })
    }

    /// The rates of the gaps of all contacts, m/s, as [`ContactScratch::velocities`].
    pub fn rates(&mut self, model: &Model<f64>, points: &[ContactPoint], v: &[f64], out: &mut [f64]) {
        velocities_base_to_tip(model, &self.shift, v, &mut self.velocity);
        for ((out, point), (unit, opposite)) in out.iter_mut().zip(points).zip(self.units.iter().zip(&self.opposite)) {
            let own = dot(&unit[2], &self.velocity[point.body]);
            *out = point.other_body().map_or(own, |k| own + dot(&opposite[2], &self.velocity[k]));
        }
    }

    /// The contacts `near`, by index in it, in groups whose trees they do not couple.
    fn coupled(&self, points: &[ContactPoint], near: &[usize]) -> Vec<Vec<usize>> {
        let one = |i: usize| points.get(i).map_or_else(|| self.limits[i - points.len()].body, |point| point.body);
        let Some(&first) = near.first() else { return Vec::new() };
        if near.iter().all(|&i| self.roots[one(i)] == self.roots[one(first)]) {
            return vec![(0..near.len()).collect()];
        }
        let mut leader: Vec<usize> = (0..self.roots.len()).collect();
        for &i in near {
            if let Some(k) = points.get(i).and_then(ContactPoint::other_body) {
                let (a, b) = (led_by(&mut leader, self.roots[one(i)]), led_by(&mut leader, self.roots[k]));
                leader[a] = b;
            }
        }
        let (mut groups, mut group_of): (Vec<Vec<usize>>, _) = (Vec::new(), vec![NONE; leader.len()]);
        for (at, &i) in near.iter().enumerate() {
            let group = &mut group_of[led_by(&mut leader, self.roots[one(i)])];
            if *group == NONE {
                *group = groups.len();
                groups.push(Vec::new());
            }
            groups[*group].push(at);
        }
        groups
    }

    /// The block of G of each group of the contacts `near` that are coupled, and their indices in `near`, with the
    /// factor of M in the workspace. Joint limits whose joints the connections fix are removed from `near`. O(m depth +
    /// m^2 depth) for m rows of a group.
    pub fn gram(
        &mut self,
        model: &Model<f64>,
        points: &[ContactPoint],
        workspace: &Workspace<f64>,
        near: &mut Vec<usize>,
    ) -> Vec<(Vec<usize>, DMatrix<f64>)> {
        if self.closed.is_some() {
            let whitened = self.whiten_on_connections(model, points, workspace, near);
            return vec![((0..near.len()).collect(), squared(&whitened))];
        }
        let groups = self.coupled(points, near);
        let of = |members: Vec<usize>| {
            let which: Vec<usize> = members.iter().map(|&at| near[at]).collect();
            let whitened = self.whiten(model, points, workspace, &which);
            (members, squared(&whitened))
        };
        groups.into_iter().map(of).collect()
    }

    /// W of some contacts, with the rows of the joints on their paths.
    fn whiten(
        &mut self,
        model: &Model<f64>,
        points: &[ContactPoint],
        workspace: &Workspace<f64>,
        which: &[usize],
    ) -> DMatrix<f64> {
        let (system, m) = (&model.system, 3 * which.len());
        let measured = &workspace.store.measured;
        let Self { shift, limits, units, opposite, state, torque, innovations, rows, closed, .. } = self;
        let (mut height, mut bodies) = (0, Vec::new());
        let mut add = |k: usize| {
            if rows[k] == NONE {
                rows[k] = height;
                height += system.stages[k].rows.count();
                bodies.push(k);
            }
        };
        if closed.is_some() {
            // The rows of all joints, in the order of the rows of connections.
            (0..system.stages.len()).for_each(&mut add);
        } else {
            for &i in which {
                if let Some(point) = points.get(i) {
                    point.path.iter().copied().for_each(&mut add);
                } else {
                    let mut body = Some(limits[i - points.len()].body);
                    while let Some(k) = body {
                        add(k);
                        body = system.stages[k].parent;
                    }
                }
            }
        }
        let mut whitened = DMatrix::zeros(height, m);
        for row in 0..m {
            let (i, out) = (which[row / 3], &mut whitened.as_mut_slice()[row * height..(row + 1) * height]);
            // A force on a body reduces the force that its joint transmits; a limit acts as a torque of its joint.
            let (force, body) = match points.get(i) {
                Some(point) => (-units[i][row % 3], point.body),
                None if row % 3 == 2 => {
                    let limit = &limits[i - points.len()];
                    torque[limit.row] = limit.sign();
                    (zero(), limit.body)
                }
                None => continue,
            };
            let past = |k: usize, z: &mut Vector6<f64>| {
                whiten((model, k), (measured, torque), (innovations, z), &mut out[rows[k]..]);
            };
            match points.get(i).and_then(|point| Some((point, point.other_body()?))) {
                Some((point, other)) => {
                    for &k in &point.path {
                        state[k] = zero();
                    }
                    state[body] += force;
                    state[other] -= opposite[i][row % 3];
                    tip_to_base(&system.stages, shift, point.path.iter().copied(), state, past);
                }
                None => {
                    inward_along_path(&system.stages, shift, [Some(body), None], force, past);
                }
            }
            if let Some(limit) = i.checked_sub(points.len()) {
                torque[limits[limit].row] = 0.0;
            }
        }
        for k in bodies {
            rows[k] = NONE;
        }
        whitened
    }

    /// W of the contacts `near`, projected onto the complement of the rows of connections; removes joint limits that
    /// the connections fix.
    fn whiten_on_connections(
        &mut self,
        model: &Model<f64>,
        points: &[ContactPoint],
        workspace: &Workspace<f64>,
        near: &mut Vec<usize>,
    ) -> DMatrix<f64> {
        let mut whitened = self.whiten(model, points, workspace, near);
        let Some(closed) = &mut self.closed else { return whitened };
        let sizes: Vec<f64> = whitened.column_iter().map(|column| column.norm()).collect();
        closed.project(&mut whitened);
        for (mut column, size) in whitened.column_iter_mut().zip(sizes) {
            if column.norm() <= HELD * size {
                column.fill(0.0);
            }
        }
        let moves = |&at: &usize| near[at] < points.len() || whitened.column(3 * at + 2).amax() > 0.0;
        let moving: Vec<usize> = (0..near.len()).filter(moves).collect();
        if moving.len() < near.len() {
            let columns: Vec<usize> = moving.iter().flat_map(|at| 3 * at..3 * at + 3).collect();
            whitened = whitened.select_columns(&columns);
            closed.select(&columns);
            *near = moving.iter().map(|&at| near[at]).collect();
        }
        whitened
    }

    /// M^-1 J* p of the contacts `near`, which [`ContactScratch::gram`] has returned, into `response`: one more
    /// right-hand side. The forces of connections keep their velocities unchanged. O(N).
    pub fn respond(
        &mut self,
        model: &Model<f64>,
        points: &[ContactPoint],
        workspace: &mut Workspace<f64>,
        near: &[usize],
        impulses: &DVector<f64>,
    ) {
        let mut torque = std::mem::take(&mut self.torque);
        self.spread(points, (near, impulses), -1.0, &mut torque);
        self.torque = torque;
        if let Some(closed) = &mut self.closed {
            closed.add_forces(impulses, (&mut self.state, &mut self.torque));
        }
        let (scene, store) = workspace.passes(model);
        store.set_forces(self.state.iter().copied());
        general::solve::<f64, true>(scene, store, &self.torque, &mut self.response);
        self.torque.fill(0.0);
    }

    /// Sets `state` to the forces of impulses on the bodies, times `sign`, and adds those of joint limits to `torque`.
    fn spread(
        &mut self,
        points: &[ContactPoint],
        (near, impulses): (&[usize], &DVector<f64>),
        sign: f64,
        torque: &mut [f64],
    ) {
        self.state.fill(zero());
        for (at, &i) in near.iter().enumerate() {
            let Some(point) = points.get(i) else {
                let limit = &self.limits[i - points.len()];
                torque[limit.row] += limit.sign() * impulses[3 * at + 2];
                continue;
            };
            let sides = [Some((point.body, &self.units[i])), point.other_body().map(|k| (k, &self.opposite[i]))];
            for (k, units) in sides.into_iter().flatten() {
                for (row, unit) in units.iter().enumerate() {
                    self.state[k] += unit * (sign * impulses[3 * at + row]);
                }
            }
        }
    }
}

/// One stage of the inward pass of a unit force: its rows of W into `out`.
fn whiten(
    (model, k): (&Model<f64>, usize),
    (measured, torque): (&[Measured<f64>], &[f64]),
    (innovations, z): (&mut [f64], &mut Vector6<f64>),
    out: &mut [f64],
) {
    innovations::through_stage((&model.system, k), measured, torque, z, innovations);
    let stage = &model.system.stages[k];
    let joint = stage.first_row..stage.first_row + stage.rows.count();
    for ((out, e), measured) in out.iter_mut().zip(&innovations[joint.clone()]).zip(&measured[joint]) {
        *out = e * measured.pivot_inverse.sqrt();
    }
}

/// W* W.
fn squared(whitened: &DMatrix<f64>) -> DMatrix<f64> {
    let mut gram = whitened.tr_mul(whitened);
    gram.fill_lower_triangle_with_upper_triangle();
    gram
}

/// The first of a chain of leaders, with the chain shortened.
fn led_by(leader: &mut [usize], mut k: usize) -> usize {
    while leader[k] != k {
        leader[k] = leader[leader[k]];
        k = leader[k];
    }
    k
}

/// The velocity in the tangent plane of a contact, in the base frame, from its rows and their axes.
pub(crate) fn slip(axes: &Matrix3<f64>, rows: &[f64]) -> Vector3<f64> {
    axes.tr_mul(&Vector3::new(rows[0], rows[1], 0.0))
}

#[cfg(test)]
mod tests;
