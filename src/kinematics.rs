//! Base to tip: placements, velocities, and the accelerations that are there without joint accelerations.

use crate::model::{Body, Model, Motion};
use crate::scalar::Real;
use crate::spatial::{RigidShift, cross_motion, from_rows, minus, product, row, sum, zero};
use nalgebra::{Matrix3, Vector3, Vector6};

/// How far the norm of a quaternion may be from one.
pub const QUATERNION_SLACK: f64 = 1e-3;

/// Rotation matrix of a quaternion (x, y, z, w), normalised by its squared norm.
#[inline(always)]
pub fn quaternion_rotation<T: Real>(q: &[T]) -> Matrix3<T> {
    let (x, y, z, w) = (q[0], q[1], q[2], q[3]);
    let one = x.constant(1.0);
    let two = one + one;
    let s = two / (x * x + y * y + z * z + w * w);
    Matrix3::new(
        one - s * (y * y + z * z),
        s * (x * y - z * w),
        s * (x * z + y * w),
        s * (x * y + z * w),
        one - s * (x * x + z * z),
        s * (y * z - x * w),
        s * (x * z - y * w),
        s * (y * z + x * w),
        one - s * (x * x + y * y),
    )
}

/// phi from the body's frame to its parent's, at configuration `q`: the tree's shift, then the joint's.
#[inline(always)]
pub fn joint_shift<T: Real>(body: &Body<T>, q: &[T]) -> RigidShift<T> {
    let tree = &body.tree;
    let along_z = |distance: T| {
        let r = &tree.rotation;
        let l = &tree.lever;
        Vector3::new(
            r[(0, 2)].mul_add(distance, l[0]),
            r[(1, 2)].mul_add(distance, l[1]),
            r[(2, 2)].mul_add(distance, l[2]),
        )
    };
    match body.motion {
        Motion::Revolute => RigidShift { rotation: turned_about_z(&tree.rotation, q[body.q]), lever: tree.lever },
        Motion::Prismatic => RigidShift { rotation: tree.rotation, lever: along_z(q[body.q]) },
        Motion::Screw(pitch) => {
            RigidShift { rotation: turned_about_z(&tree.rotation, q[body.q]), lever: along_z(pitch * q[body.q]) }
        }
        Motion::Spherical => RigidShift {
            rotation: product(&tree.rotation, &quaternion_rotation(&q[body.q..body.q + 4])),
            lever: tree.lever,
        },
        Motion::Free => {
            let at = &q[body.q..body.q + 7];
            RigidShift {
                rotation: product(&tree.rotation, &quaternion_rotation(&at[3..])),
                lever: tree.rotate(&Vector3::new(at[0], at[1], at[2])) + tree.lever,
            }
        }
        Motion::Fixed => *tree,
    }
}

/// R Rz(angle): 12 products.
#[inline(always)]
fn turned_about_z<T: Real>(r: &Matrix3<T>, angle: T) -> Matrix3<T> {
    let (s, c) = angle.sin_cos();
    from_rows(turned_row(row(r, 0), s, c), turned_row(row(r, 1), s, c), turned_row(row(r, 2), s, c))
}

/// One row of R Rz.
#[inline(always)]
fn turned_row<T: Real>(r: [T; 3], s: T, c: T) -> [T; 3] {
    [r[0].mul_add(c, r[1] * s), minus(r[1], c, r[0], s), r[2]]
}

/// H^T u in the body's frame, for the joint rates (or accelerations) `u` of all joints; `row` is the joint's first.
#[inline(always)]
pub fn joint_motion<T: Real>(body: &Body<T>, row: usize, u: &[T]) -> Vector6<T> {
    // Not from `u`: a body that does not move has no row.
    let o = body.tree.lever[0].constant(0.0);
    match body.motion {
        Motion::Revolute => Vector6::new(o, o, u[row], o, o, o),
        Motion::Prismatic => Vector6::new(o, o, o, o, o, u[row]),
        Motion::Screw(pitch) => Vector6::new(o, o, u[row], o, o, pitch * u[row]),
        Motion::Spherical => Vector6::new(u[row], u[row + 1], u[row + 2], o, o, o),
        Motion::Free => Vector6::new(u[row + 3], u[row + 4], u[row + 5], u[row], u[row + 1], u[row + 2]),
        Motion::Fixed => zero(),
    }
}

/// v x (H^T qd), the acceleration that the joint's rate adds; for one-axis joints most of it is zero.
#[inline(always)]
fn velocity_product<T: Real>(body: &Body<T>, v: &Vector6<T>, joint: &Vector6<T>) -> Vector6<T> {
    let o = v[0].constant(0.0);
    match body.motion {
        Motion::Revolute => {
            let w = joint[2];
            Vector6::new(v[1] * w, -(v[0] * w), o, v[4] * w, -(v[3] * w), o)
        }
        Motion::Prismatic => {
            let u = joint[5];
            Vector6::new(o, o, o, v[1] * u, -(v[0] * u), o)
        }
        Motion::Fixed => zero(),
        _ => cross_motion(v, joint),
    }
}

/// The acceleration of the base: minus gravity, so that weight enters every b(k).
#[inline(always)]
pub fn base_acceleration<T: Real>(model: &Model<T>) -> Vector6<T> {
    let (o, g) = (T::zero(), &model.gravity);
    Vector6::new(o, o, o, -g[0], -g[1], -g[2])
}

/// Base to tip: phi of every body at `q`.
#[inline(always)]
pub fn placements_base_to_tip<T: Real>(model: &Model<T>, q: &[T], shift: &mut [RigidShift<T>]) {
    for (shift, body) in shift.iter_mut().zip(&model.bodies) {
        *shift = joint_shift(body, q);
    }
}

/// Velocity v(k) of body k, and the part of its acceleration that the rates cause, from its parent's: phi^T of both,
/// plus the joint's own. The parent's acceleration may contain joint accelerations; those of this joint are the caller's to add.
#[inline(always)]
pub fn motion_step<T: Real>(
    body: &Body<T>,
    row: usize,
    shift: &RigidShift<T>,
    parent: (&Vector6<T>, &Vector6<T>),
    qd: &[T],
) -> (Vector6<T>, Vector6<T>) {
    let joint = joint_motion(body, row, qd);
    let velocity = sum(&shift.motion_to_child(parent.0), &joint);
    let acceleration = sum(&shift.motion_to_child(parent.1), &velocity_product(body, &velocity, &joint));
    (velocity, acceleration)
}

/// dq/dt for the velocity `v` at `q`: v itself, but for quaternions (half q times the angular velocity) and for the position
/// of a free joint (its linear velocity turned into the parent's frame).
pub fn coordinate_rates<T: Real>(model: &Model<T>, q: &[T], v: &[T], rates: &mut [T]) {
    let half = T::from_f64(0.5);
    let quaternion_rates = |q: &[T], w: &[T], rates: &mut [T]| {
        rates[0] = half * (q[3] * w[0] + q[1] * w[2] - q[2] * w[1]);
        rates[1] = half * (q[3] * w[1] + q[2] * w[0] - q[0] * w[2]);
        rates[2] = half * (q[3] * w[2] + q[0] * w[1] - q[1] * w[0]);
        rates[3] = -(half * (q[0] * w[0] + q[1] * w[1] + q[2] * w[2]));
    };
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        let (at, row) = (body.q, stage.first_row);
        match body.motion {
            Motion::Spherical => quaternion_rates(&q[at..at + 4], &v[row..row + 3], &mut rates[at..at + 4]),
            Motion::Free => {
                let turned = RigidShift {
                    rotation: quaternion_rotation(&q[at + 3..at + 7]),
                    lever: Vector3::from_element(T::zero()),
                }
                .rotate(&Vector3::new(v[row], v[row + 1], v[row + 2]));
                rates[at..at + 3].copy_from_slice(turned.as_slice());
                quaternion_rates(&q[at + 3..at + 7], &v[row + 3..row + 6], &mut rates[at + 3..at + 7]);
            }
            Motion::Fixed => {}
            _ => rates[at] = v[row],
        }
    }
}
