//! Contacts at one state: gaps, velocities, G = J M^-1 J* of those that touch, and what impulses do to the rates.
//!
//! The rows of a contact are t1, t2, n of its plane: u = J v is the velocity of the material point of the link nearest to the plane. A unit force
//! along a row, run inward to the base, collects innovations W; G = W* W as for [connections](super::constraints), never a difference.

use crate::filter::{innovations, smoother};
use crate::kinematics::{joint_motion, placements_base_to_tip};
use crate::model::Model;
use crate::scene::contact_point::ContactPoint;
use crate::spatial::{RigidShift, angular, dot, linear, spatial, sum, zero};
use crate::workspace::Workspace;
use nalgebra::{DMatrix, DVector, Vector3, Vector6};

/// Scratch of contacts, about 400 bytes a body and 24 nv for each contact.
#[derive(Debug, Clone)]
pub(crate) struct ContactScratch {
    shift: Vec<RigidShift<f64>>,
    /// From each body to the base.
    places: Vec<RigidShift<f64>>,
    /// How far each contact is above its plane, m.
    pub gaps: Vec<f64>,
    /// Unit forces along the rows of each contact, on its body.
    units: Vec<[Vector6<f64>; 3]>,
    velocity: Vec<Vector6<f64>>,
    /// W*, a row of nv for each row of the contacts that touch.
    whitened: Vec<f64>,
    state: Vec<Vector6<f64>>,
    still: Vec<f64>,
    /// What [`ContactScratch::respond`] gives, (nv).
    pub response: Vec<f64>,
}

impl ContactScratch {
    pub fn new(model: &Model<f64>, points: &[ContactPoint]) -> Self {
        let (bodies, nv) = (model.bodies.len(), model.nv());
        Self {
            shift: vec![RigidShift::identity(); bodies],
            places: vec![RigidShift::identity(); bodies],
            gaps: vec![f64::NAN; points.len()],
            units: vec![[zero(); 3]; points.len()],
            velocity: vec![zero(); bodies],
            whitened: Vec::new(),
            state: vec![zero(); bodies],
            still: vec![0.0; nv],
            response: vec![0.0; nv],
        }
    }

    /// Gaps and rows at `q`. O(N + contacts).
    pub fn place(&mut self, model: &Model<f64>, points: &[ContactPoint], q: &[f64]) {
        placements_base_to_tip(model, q, &mut self.shift);
        for (k, stage) in model.system.stages.iter().enumerate() {
            self.places[k] = match stage.parent {
                Some(parent) => self.places[parent].compose(&self.shift[k]),
                None => self.shift[k],
            };
        }
        for (i, point) in points.iter().enumerate() {
            let place = &self.places[point.body];
            let normal = point.normal();
            self.gaps[i] = normal.dot(&(place.rotate(&point.centre) + place.lever)) - point.radius - point.offset;
            let arm = point.centre - place.rotate_back(&normal) * point.radius;
            self.units[i] = std::array::from_fn(|row| {
                let force = place.rotate_back(&point.axes.row(row).transpose());
                spatial(&arm.cross(&force), &force)
            });
        }
    }

    /// J v of all contacts, m/s, where [`ContactScratch::place`] was. O(N + contacts).
    pub fn velocities(&mut self, model: &Model<f64>, points: &[ContactPoint], v: &[f64]) -> DVector<f64> {
        for (k, stage) in model.system.stages.iter().enumerate() {
            let own = joint_motion(&model.bodies[k], stage.first_row, v);
            self.velocity[k] = match stage.parent {
                Some(parent) => sum(&self.shift[k].motion_to_child(&self.velocity[parent]), &own),
                None => own,
            };
        }
        DVector::from_fn(3 * points.len(), |i, _| dot(&self.units[i / 3][i % 3], &self.velocity[points[i / 3].body]))
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
        self.whitened.clear();
        self.whitened.resize(m * nv, 0.0);
        for row in 0..m {
            let (i, point) = (near[row / 3], &points[near[row / 3]]);
            // A force on a body lowers the force that its joint has to transmit.
            let mut z = -self.units[i][row % 3];
            let out = &mut self.whitened[row * nv..(row + 1) * nv];
            for &k in &point.path {
                innovations::through_stage((system, k), &workspace.measured, &self.still, &mut z, out);
                let stage = &system.stages[k];
                let joint = stage.first_row..stage.first_row + stage.rows.count();
                for (out, measured) in out[joint.clone()].iter_mut().zip(&workspace.measured[joint]) {
                    *out *= measured.pivot_inverse.sqrt();
                }
                z = self.shift[k].force_to_parent(&z);
            }
        }
        let whitened = DMatrix::from_column_slice(nv, m, &self.whitened);
        let mut gram = whitened.tr_mul(&whitened);
        gram.fill_lower_triangle_with_upper_triangle();
        gram
    }

    /// M^-1 J* p of the contacts `near`, in `response`: one more right side. O(N).
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
            for (row, unit) in self.units[i].iter().enumerate() {
                self.state[points[i].body] -= unit * impulses[3 * at + row];
            }
        }
        let Workspace { measured, co_state, .. } = workspace;
        innovations::sweep(&model.system, &self.shift, measured, &self.still, &mut self.state, &mut self.response);
        smoother::sweep(&model.system, &self.shift, measured, co_state, &mut self.response);
    }
}

/// The velocity in the plane of a contact, in the base frame, from its rows.
pub(crate) fn slip(point: &ContactPoint, rows: &[f64]) -> Vector3<f64> {
    point.axes.tr_mul(&Vector3::new(rows[0], rows[1], 0.0))
}

/// Gaps of the contacts at `q`, into `out`, m. O(depth) each.
pub(crate) fn gaps(model: &Model<f64>, points: &[ContactPoint], q: &[f64], out: &mut [f64]) {
    for (point, gap) in points.iter().zip(out) {
        let mut centre = point.centre;
        for &k in &point.path {
            let shift = crate::kinematics::joint_shift(&model.bodies[k], q);
            centre = shift.rotate(&centre) + shift.lever;
        }
        *gap = point.normal().dot(&centre) - point.radius - point.offset;
    }
}

/// Velocity of the material point of a contact nearest to its plane, in the base frame, m/s. O(depth).
pub(crate) fn velocity(model: &Model<f64>, point: &ContactPoint, q: &[f64], qd: &[f64]) -> Vector3<f64> {
    let frame = crate::kinematics::Frame { body: Some(point.body), placement: RigidShift::identity() };
    let motion = crate::kinematics::frame_motion(model, q, qd, None, &frame);
    let arm = point.centre - motion.placement.rotate_back(&point.normal()) * point.radius;
    motion.placement.rotate(&(linear(&motion.velocity) + angular(&motion.velocity).cross(&arm)))
}
