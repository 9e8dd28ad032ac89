//! Contacts at one state: gaps, velocities, G = J M^-1 J* of the active contacts, and the effect of impulses on joint
//! velocities.
//!
//! The rows of a contact are t1, t2, n of its plane: u = J v is the velocity of the material point of the link nearest
//! to the plane. The innovations W of a unit force along each row are propagated inward to the base. G = W* W as for
//! [connections](super::constraints), without subtraction.
//!
//! Joint limits are additional contacts without friction, numbered after the others. Their normal velocity is that of
//! the joint, away from the limit, and the two tangential velocities are zero.

pub(crate) mod derivatives;

use super::sweeps::general;
use crate::filter::innovations;
use crate::kinematics::propagation::inward_along_path;
use crate::kinematics::{placements_base_to_tip, placements_on_base, velocities_base_to_tip};
use crate::model::Model;
use crate::scene::contact_point::ContactPoint;
use crate::spatial::{RigidShift, angular, dot, linear, spatial, zero};
use crate::workspace::Workspace;
use nalgebra::{DMatrix, DVector, Vector3, Vector6};

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
    shift: Vec<RigidShift<f64>>,
    /// The pose of each body in the base frame.
    places: Vec<RigidShift<f64>>,
    /// The joint limits.
    pub limits: Vec<LimitRow>,
    /// The distance of each contact to its plane, m, and of each joint to its limit, rad or m.
    pub gaps: Vec<f64>,
    /// Unit forces along the rows of each contact, on its body.
    units: Vec<[Vector6<f64>; 3]>,
    velocity: Vec<Vector6<f64>>,
    /// W*, one row of length nv for each row of the active contacts.
    whitened: Vec<f64>,
    state: Vec<Vector6<f64>>,
    torque: Vec<f64>,
    /// The result of [`ContactScratch::respond`], (nv).
    pub response: Vec<f64>,
}

impl ContactScratch {
    pub fn new(model: &Model<f64>, points: &[ContactPoint], limits: Vec<LimitRow>) -> Self {
        let (bodies, nv) = (model.bodies.len(), model.nv());
        Self {
            shift: vec![RigidShift::identity(); bodies],
            places: vec![RigidShift::identity(); bodies],
            gaps: vec![f64::NAN; points.len() + limits.len()],
            limits,
            units: vec![[zero(); 3]; points.len()],
            velocity: vec![zero(); bodies],
            whitened: Vec::new(),
            state: vec![zero(); bodies],
            torque: vec![0.0; nv],
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
            let normal = point.normal();
            self.gaps[i] = normal.dot(&(place.rotate(&point.center) + place.lever)) - point.radius - point.offset;
            let arm = point.center - place.rotate_back(&normal) * point.radius;
            self.units[i] = std::array::from_fn(|row| {
                let force = place.rotate_back(&point.axes.row(row).transpose());
                spatial(&arm.cross(&force), &force)
            });
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
            (Some(point), row) => dot(&self.units[i / 3][row], &self.velocity[point.body]),
            (None, 2) => self.limits[i / 3 - points.len()].velocity(v),
            (None, _) => 0.0,
        })
    }

    /// G of the contacts `near`, with the factor of M in the workspace. O(m depth + m^2 depth) for m rows.
    pub fn gram(
        &mut self,
        model: &Model<f64>,
        points: &[ContactPoint],
        workspace: &Workspace<f64>,
        near: &[usize],
    ) -> DMatrix<f64> {
        let (system, nv, m) = (&model.system, model.nv(), 3 * near.len());
        let measured = &workspace.store.measured;
        self.whitened.clear();
        self.whitened.resize(m * nv, 0.0);
        for row in 0..m {
            let i = near[row / 3];
            // A force on a body reduces the force that its joint transmits; a limit acts as a torque of its joint.
            let (force, body) = match points.get(i) {
                Some(point) => (-self.units[i][row % 3], point.body),
                None if row % 3 == 2 => {
                    let limit = &self.limits[i - points.len()];
                    self.torque[limit.row] = limit.sign();
                    (zero(), limit.body)
                }
                None => continue,
            };
            let out = &mut self.whitened[row * nv..(row + 1) * nv];
            inward_along_path(&system.stages, &self.shift, [Some(body), None], force, |k, z| {
                innovations::through_stage((system, k), measured, &self.torque, z, out);
                let stage = &system.stages[k];
                let joint = stage.first_row..stage.first_row + stage.rows.count();
                for (out, measured) in out[joint.clone()].iter_mut().zip(&measured[joint]) {
                    *out *= measured.pivot_inverse.sqrt();
                }
            });
            self.torque.fill(0.0);
        }
        let whitened = DMatrix::from_column_slice(nv, m, &self.whitened);
        let mut gram = whitened.tr_mul(&whitened);
        gram.fill_lower_triangle_with_upper_triangle();
        gram
    }

    /// M^-1 J* p of the contacts `near`, into `response`: one more right-hand side. O(N).
    pub fn respond(
        &mut self,
        model: &Model<f64>,
        points: &[ContactPoint],
        workspace: &mut Workspace<f64>,
        near: &[usize],
        impulses: &DVector<f64>,
    ) {
        self.state.fill(zero());
        for (at, &i) in near.iter().enumerate() {
            let Some(point) = points.get(i) else {
                let limit = &self.limits[i - points.len()];
                self.torque[limit.row] += limit.sign() * impulses[3 * at + 2];
                continue;
            };
            for (row, unit) in self.units[i].iter().enumerate() {
                self.state[point.body] -= unit * impulses[3 * at + row];
            }
        }
        let (scene, store) = workspace.passes(model);
        store.set_forces(self.state.iter().copied());
        general::solve::<f64, true>(scene, store, &self.torque, &mut self.response);
        self.torque.fill(0.0);
    }
}

/// The velocity in the plane of a contact, in the base frame, from its rows.
pub(crate) fn slip(point: &ContactPoint, rows: &[f64]) -> Vector3<f64> {
    point.axes.tr_mul(&Vector3::new(rows[0], rows[1], 0.0))
}

/// Gaps of the contacts at `q`, into `out`, m. O(depth) each.
pub(crate) fn gaps(model: &Model<f64>, points: &[ContactPoint], q: &[f64], out: &mut [f64]) {
    for (point, gap) in points.iter().zip(out) {
        let mut center = point.center;
        for &k in &point.path {
            let shift = crate::kinematics::joint_shift(&model.bodies[k], q);
            center = shift.rotate(&center) + shift.lever;
        }
        *gap = point.normal().dot(&center) - point.radius - point.offset;
    }
}

/// Velocity of the material point of a contact nearest to its plane, in the base frame, m/s. O(depth).
pub(crate) fn velocity(model: &Model<f64>, point: &ContactPoint, q: &[f64], qd: &[f64]) -> Vector3<f64> {
    let frame = crate::kinematics::Frame { body: Some(point.body), placement: RigidShift::identity() };
    let motion = crate::kinematics::frame_motion(model, q, qd, None, &frame);
    let arm = point.center - motion.placement.rotate_back(&point.normal()) * point.radius;
    motion.placement.rotate(&(linear(&motion.velocity) + angular(&motion.velocity).cross(&arm)))
}
