//! Velocity and proper acceleration of a frame on a link, and their derivatives by the state, all expressed in that
//! frame.
//!
//! With the column s of each degree of freedom, and the velocity `V_p` of the parent of its joint: dV/dq = `V_p` x s,
//! dA/dq = `A_p` x s + dV/dq x (V - `V_p`), dA/dqd = V(k) x s - (V - `V_p`) x s, where V(k) is the velocity outboard of
//! the joint and `A_p` includes the weight.

use crate::filter::Rows;
use crate::kinematics::{Frame, local_jacobian};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{angular, cross, cross_motion, linear, scaled, scaled_add, spatial, sum, zero};
use nalgebra::{Vector3, Vector6};

/// The degrees of freedom between the base and a frame.
#[derive(Debug, Clone)]
pub(super) struct LinkPath {
    /// Indices in qd, from the base outward.
    pub rows: Vec<usize>,
    /// For each, the positions in `rows` of the first and last degree of freedom of its joint.
    joints: Vec<(usize, usize)>,
}

impl LinkPath {
    pub fn new<T: Real>(model: &Model<T>, frame: &Frame<f64>) -> Self {
        let mut stages = Vec::new();
        let mut at = frame.body;
        while let Some(k) = at {
            stages.push(&model.system.stages[k]);
            at = model.system.stages[k].parent;
        }
        let (mut rows, mut joints) = (Vec::new(), Vec::new());
        for stage in stages.into_iter().rev() {
            let (first, count) = (rows.len(), stage.rows.count());
            debug_assert!(!matches!(stage.rows, Rows::None) || count == 0);
            rows.extend(stage.first_row..stage.first_row + count);
            joints.extend(std::iter::repeat_n((first, first + count.max(1) - 1), count));
        }
        Self { rows, joints }
    }
}

/// The motion of a frame; entries per degree of freedom are in the order of its [`LinkPath`].
#[derive(Debug, Clone)]
pub(super) struct LinkMotion<T: Real> {
    /// Jacobian of the frame, (6 x nv) row by row.
    jacobian: Vec<T>,
    /// Velocities and accelerations outboard of each degree of freedom.
    moved: Vec<Vector6<T>>,
    added: Vec<Vector6<T>>,
    pub velocity: Vector6<T>,
    /// Acceleration of the origin as a point, minus gravity.
    pub acceleration: Vector3<T>,
    /// dV/dqd.
    pub columns: Vec<Vector6<T>>,
    /// dV/dq.
    pub velocity_by_q: Vec<Vector6<T>>,
    /// Derivatives of the acceleration at constant qdd. The derivative by qdd is the linear half of `columns`.
    pub acceleration_by_q: Vec<Vector3<T>>,
    pub acceleration_by_qd: Vec<Vector3<T>>,
}

impl<T: Real> LinkMotion<T> {
    pub fn new(nv: usize) -> Self {
        let nan = T::from_f64(f64::NAN);
        let (vector, triple) = (Vector6::from_element(nan), Vector3::from_element(nan));
        Self {
            jacobian: vec![nan; 6 * nv],
            moved: vec![vector; nv],
            added: vec![vector; nv],
            velocity: vector,
            acceleration: triple,
            columns: vec![vector; nv],
            velocity_by_q: vec![vector; nv],
            acceleration_by_q: vec![triple; nv],
            acceleration_by_qd: vec![triple; nv],
        }
    }

    /// The motion at a state; the acceleration only if `qdd` is given.
    pub fn evaluate(
        &mut self,
        model: &Model<T>,
        (frame, path): (&Frame<T>, &LinkPath),
        (q, qd, qdd): (&[T], &[T], Option<&[T]>),
    ) {
        let nv = model.nv();
        let placement = local_jacobian(model, q, frame, &mut self.jacobian);
        let mut velocity = zero();
        for (p, &row) in path.rows.iter().enumerate() {
            let at = |i: usize| self.jacobian[i * nv + row];
            self.columns[p] = Vector6::new(at(0), at(1), at(2), at(3), at(4), at(5));
            velocity = scaled_add(&self.columns[p], qd[row], &velocity);
            self.moved[p] = velocity;
        }
        self.velocity = velocity;
        for (p, &(first, _)) in path.joints.iter().enumerate() {
            self.velocity_by_q[p] = cross_motion(&before(&self.moved, first), &self.columns[p]);
        }
        let Some(qdd) = qdd else { return };
        let mut added = zero();
        for (p, (&row, &(first, _))) in path.rows.iter().zip(&path.joints).enumerate() {
            let turned = cross_motion(&before(&self.moved, first), &scaled(&self.columns[p], qd[row]));
            added = sum(&scaled_add(&self.columns[p], qdd[row], &added), &turned);
            self.added[p] = added;
        }
        let g = placement.rotate_back(&model.gravity);
        let weight = spatial(&Vector3::from_element(T::zero()), &Vector3::new(-g[0], -g[1], -g[2]));
        let minus = T::one().constant(-1.0);
        let turning = |change: &Vector6<T>| {
            let of_rotation = cross(&angular(change), &linear(&velocity));
            let of_motion = cross(&angular(&velocity), &linear(change));
            Vector3::new(of_rotation[0] + of_motion[0], of_rotation[1] + of_motion[1], of_rotation[2] + of_motion[2])
        };
        let of_point = |spatial: &Vector6<T>, more: &Vector3<T>| {
            Vector3::new(spatial[3] + more[0], spatial[4] + more[1], spatial[5] + more[2])
        };
        let centripetal = cross(&angular(&velocity), &linear(&velocity));
        self.acceleration = of_point(&sum(&weight, &added), &centripetal);
        for (p, &(first, last)) in path.joints.iter().enumerate() {
            let column = &self.columns[p];
            let inboard = before(&self.moved, first);
            let relative = scaled_add(&inboard, minus, &velocity);
            let at_parent = sum(&weight, &before(&self.added, first));
            let by_q = sum(&cross_motion(&at_parent, column), &cross_motion(&self.velocity_by_q[p], &relative));
            let outboard = scaled_add(&relative, minus, &self.moved[last]);
            let by_qd = cross_motion(&outboard, column);
            self.acceleration_by_q[p] = of_point(&by_q, &turning(&self.velocity_by_q[p]));
            self.acceleration_by_qd[p] = of_point(&by_qd, &turning(column));
        }
    }
}

/// The sum inboard of the joint that begins at `first`.
#[inline(always)]
fn before<T: Real>(sums: &[Vector6<T>], first: usize) -> Vector6<T> {
    first.checked_sub(1).map_or_else(zero, |inboard| sums[inboard])
}
