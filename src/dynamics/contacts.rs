//! Contacts at one state: gaps, velocities, G = J M^-1 J* of the active contacts, and the effect of impulses on joint
//! velocities.
//!
//! The rows of a contact are t1, t2, n of its surface: u = J v is the velocity of the material point of the link
//! nearest to the surface, relative to the link of the surface. The innovations W of unit forces along the rows are
//! propagated inward along the path of the contact, and G = W* W without subtraction, as for all
//! [rows](super::sweeps). Contacts whose trees are not coupled have separate blocks of G. Only the contacts that are
//! asked for have W and G.
//!
//! With connections or coupled joints, W is first projected onto the complement of their rows
//! ([`Elimination`](super::constraints::Elimination)): G and the responses are those on the connections.
//!
//! Joint limits are additional contacts without friction, numbered after the others. Their normal velocity is that of
//! the joint, away from the limit, and the two tangential velocities are zero.

pub(crate) mod derivatives;

use super::constraints::Elimination;
use super::contact_rows::UnitForces;
use super::sweeps::{Forces, MOST_FORCES, Path, PathRows, SweepModel, WhitenedRows, general};
use crate::contact::{Gram, RowPattern};
use crate::filter::riccati::Measured;
use crate::kinematics::{placements_base_to_tip, placements_on_base, velocities_base_to_tip};
use crate::model::Model;
use crate::scene::contact_point::{ContactPoint, Touch};
use crate::spatial::{RigidShift, zero};
use crate::workspace::Workspace;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3, Vector6};
use std::sync::Arc;

/// A row of W that the projection reduces below this, relative to its size, is zero: the connections fix its motion.
const HELD: f64 = 1e-12;

/// No group.
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

/// Scratch of contacts and joint limits: about 400 bytes per body, and 48 nv bytes per active contact of a block.
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
    /// Unit forces along the rows of each contact; zero for limits.
    units: Vec<UnitForces<f64>>,
    /// The rows of connections and coupled joints, if the scene has any.
    pub closed: Option<Box<Elimination>>,
    velocity: Vec<Vector6<f64>>,
    state: Vec<Vector6<f64>>,
    torque: Vec<f64>,
    /// The body next to the base on the path of each body.
    roots: Vec<usize>,
    /// The blocks of the last G, and W on the connections, one column per row.
    blocks: Vec<Block>,
    /// The bodies of the contacts of the blocks, if they are not those of the scene.
    bodies: Vec<[Option<usize>; 2]>,
    projected: DMatrix<f64>,
    /// The result of [`ContactScratch::respond`], (nv).
    pub response: Vec<f64>,
}

/// Contacts and joint limits whose trees are coupled.
#[derive(Debug, Clone)]
struct Block {
    which: Vec<usize>,
    /// Their indices among the contacts of G.
    members: Vec<usize>,
    /// The steps of the path of each on which its forces act.
    ends: Vec<[Option<usize>; 2]>,
    whitened: WhitenedRows<f64>,
    /// The joints of its contacts, if G is kept as W* W.
    pattern: Option<Arc<RowPattern>>,
    forces: Vec<Forces<f64>>,
}

impl Block {
    fn new(
        (model, sweeps): (&Model<f64>, &SweepModel<f64>),
        (points, limits): (&[ContactPoint], &[LimitRow]),
        (which, is_closed): (Vec<usize>, bool),
    ) -> Self {
        let (mut ends, mut paths) = (Vec::with_capacity(which.len()), Vec::with_capacity(which.len()));
        for (at, &i) in which.iter().enumerate() {
            let path = if let Some(point) = points.get(i) {
                let on = [Some(point.body), point.other_body()];
                let act_on: Vec<usize> = on.into_iter().flatten().collect();
                let path = Path::new(sweeps, (&point.path, &[]), &act_on);
                ends.push(on.map(|body| path.step_of(body?)));
                (path, 3 * at..3 * at + 3)
            } else {
                let body = limits[i - points.len()].body;
                let bodies = std::iter::successors(Some(body), |&k| model.system.stages[k].parent);
                ends.push([Some(0), None]);
                (Path::new(sweeps, (&bodies.collect::<Vec<_>>(), &[]), &[body]), 3 * at + 2..3 * at + 3)
            };
            paths.push(path);
        }
        let joints = |path: &Path| path.rows_shared(path, model).into_iter().flatten().collect();
        let pattern =
            if is_closed { None } else { RowPattern::of_many(paths.iter().map(|(path, _)| joints(path)).collect()) };
        let mut whitened = WhitenedRows::with_gram(model, paths, pattern.is_none());
        // Joint limits have no tangents.
        whitened.gram.fill(0.0);
        let none = Forces { z: [[f64::NAN; 6]; MOST_FORCES], moments: [f64::NAN; MOST_FORCES] };
        let forces = vec![none; whitened.longest()];
        Self { forces, which, members: Vec::new(), ends, whitened, pattern: pattern.map(Arc::new) }
    }

    /// G as W* W, with the rows of each contact. Joint limits have a normal row only.
    fn wide(&self, pattern: &Arc<RowPattern>, measured: &[Measured<f64>]) -> Gram {
        let of = |(of, joints): (&PathRows, &Vec<usize>)| {
            let mut entries = vec![Vector3::zeros(); joints.len()];
            for (row, i) in (3 - of.rows.len()..3).zip(of.rows.clone()) {
                let own = self.whitened.scaled_row(of, i, measured);
                entries.iter_mut().zip(own).for_each(|(to, (_, entry))| to[row] = entry);
            }
            entries
        };
        Gram::of_rows(pattern, self.whitened.paths.iter().zip(&pattern.contacts).map(of).collect())
    }

    /// G.
    fn gram(&mut self, measured: &[Measured<f64>]) -> Gram {
        let m = 3 * self.which.len();
        if let Some(pattern) = &self.pattern {
            return self.wide(pattern, measured);
        }
        self.whitened.multiply(0.0);
        let mut gram = DMatrix::from_row_slice(m, m, &self.whitened.gram);
        gram.fill_upper_triangle_with_lower_triangle();
        gram.into()
    }
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
            units: vec![UnitForces::zero(); points.len() + limits.len()],
            limits,
            axes: points.iter().map(|point| point.axes).collect(),
            closed: None,
            velocity: vec![zero(); bodies],
            state: vec![zero(); bodies],
            torque: vec![0.0; nv],
            roots,
            blocks: Vec::new(),
            bodies: Vec::new(),
            projected: DMatrix::zeros(0, 0),
            response: vec![0.0; nv],
        }
    }

    /// Makes room for other contacts; the next use is [`ContactScratch::place`].
    pub fn resize(&mut self, points: &[ContactPoint]) {
        let rows = points.len() + self.limits.len();
        self.gaps.resize(rows, f64::NAN);
        self.units.resize(rows, UnitForces::zero());
        // Units of limits are zero, and those of contacts are set anew.
        self.units.fill(UnitForces::zero());
        self.axes.resize(points.len(), Matrix3::identity());
        let bodies = || points.iter().map(|point| [Some(point.body), point.other_body()]);
        if !self.bodies.iter().copied().eq(bodies()) {
            self.bodies = bodies().collect();
            self.blocks.clear();
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
            let on_body = RigidShift { rotation: Matrix3::identity(), lever: point.center };
            let (arm, _) = point.arm(Some(place), &axes.row(2).transpose());
            self.units[i].set(0, (&axes, &arm), (place, &on_body));
            if let Some(other) = other {
                self.units[i].set(1, (&axes, &(at - other.lever)), (&other, &RigidShift::identity()));
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
            (Some(point), row) => self.velocity_of((point, i / 3), row),
            (None, 2) => self.limits[i / 3 - points.len()].velocity(v),
            (None, _) => 0.0,
        })
    }

    /// The rates of the gaps of all contacts, m/s, as [`ContactScratch::velocities`].
    pub fn rates(&mut self, model: &Model<f64>, points: &[ContactPoint], v: &[f64], out: &mut [f64]) {
        velocities_base_to_tip(model, &self.shift, v, &mut self.velocity);
        for (i, (out, point)) in out.iter_mut().zip(points).enumerate() {
            *out = self.velocity_of((point, i), 2);
        }
    }

    fn velocity_of(&self, (point, i): (&ContactPoint, usize), row: usize) -> f64 {
        self.units[i].velocity(row, &self.velocity[point.body], point.other_body().map(|k| &self.velocity[k]))
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
    ) -> Vec<(Vec<usize>, Gram)> {
        let groups = if self.closed.is_some() { vec![(0..near.len()).collect()] } else { self.coupled(points, near) };
        let scene = (model, &workspace.sweeps);
        let mut known = std::mem::take(&mut self.blocks).into_iter();
        for members in groups {
            let which: Vec<usize> = members.iter().map(|&at| near[at]).collect();
            let block = known.next().filter(|block| block.which == which);
            let mut block =
                block.unwrap_or_else(|| Block::new(scene, (points, &self.limits), (which, self.closed.is_some())));
            block.members = members;
            for (at, &i) in block.which.iter().enumerate() {
                self.units[i].put(&mut block.forces, block.ends[at], 0.0);
                let limit = i.checked_sub(points.len()).map(|at| self.limits[at]);
                if let Some(limit) = limit {
                    self.torque[limit.row] = limit.sign();
                }
                block.whitened.innovations_of(at, scene, &workspace.store, (&mut block.forces, &self.torque));
                if let Some(limit) = limit {
                    self.torque[limit.row] = 0.0;
                }
            }
            self.blocks.push(block);
        }
        if self.closed.is_some() {
            return vec![self.on_connections(points, workspace, near)];
        }
        self.blocks.iter_mut().map(|block| (block.members.clone(), block.gram(&workspace.store.measured))).collect()
    }

    /// G of the contacts `near` after the projection of W onto the complement of the rows of connections; removes joint
    /// limits that the connections fix.
    fn on_connections(
        &mut self,
        points: &[ContactPoint],
        workspace: &Workspace<f64>,
        near: &mut Vec<usize>,
    ) -> (Vec<usize>, Gram) {
        let mut whitened = DMatrix::zeros(self.response.len(), 3 * near.len());
        for block in &self.blocks {
            block.whitened.scaled(&workspace.store.measured, whitened.as_mut_slice());
        }
        let sizes: Vec<f64> = whitened.column_iter().map(|column| column.norm()).collect();
        if let Some(closed) = &self.closed {
            closed.project(&mut whitened);
        }
        for (mut column, size) in whitened.column_iter_mut().zip(sizes) {
            if column.norm() <= HELD * size {
                column.fill(0.0);
            }
        }
        let moves = |&at: &usize| near[at] < points.len() || whitened.column(3 * at + 2).amax() > 0.0;
        let moving: Vec<usize> = (0..near.len()).filter(moves).collect();
        if moving.len() < near.len() {
            whitened = whitened.select_columns(&moving.iter().flat_map(|at| 3 * at..3 * at + 3).collect::<Vec<_>>());
            *near = moving.iter().map(|&at| near[at]).collect();
        }
        let mut gram = whitened.tr_mul(&whitened);
        gram.fill_lower_triangle_with_upper_triangle();
        self.projected = whitened;
        ((0..near.len()).collect(), gram.into())
    }

    /// M^-1 J* p of the contacts of the last [`ContactScratch::gram`] into `response`: the smoother, from the sum of W
    /// p. The forces of connections keep their velocities unchanged. O(N).
    pub fn respond(&mut self, model: &Model<f64>, workspace: &mut Workspace<f64>, impulses: &DVector<f64>) {
        let (scene, store) = workspace.passes(model);
        self.response.fill(0.0);
        if self.closed.is_some() {
            let whitened = &self.projected * impulses;
            for ((out, e), m) in self.response.iter_mut().zip(&whitened).zip(&store.measured) {
                *out = e / m.pivot_inverse.sqrt();
            }
        } else {
            for block in &self.blocks {
                let own: Vec<f64> =
                    block.members.iter().flat_map(|at| (3 * at..3 * at + 3).map(|i| impulses[i])).collect();
                block.whitened.add(&own, &mut self.response);
            }
        }
        general::smooth(scene, store, &mut self.response);
    }
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
