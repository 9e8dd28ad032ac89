//! Derivatives of the velocity, the acceleration and the Jacobian of a frame by q, in the tangent space of q.
//!
//! Motions are expressed at the origin of the frame and in its axes, S(j) the column of degree of freedom j in J. Each
//! is constant in its body, so that a change of q(k) moves S(j) by S(k) x S(j) if joint k is inboard of j or the same,
//! and moves the frame itself by S(k). Relative to the frame,
//!
//! ```text
//! dJ(j)/dq(k)  = -S(k) x S(j) where k is outboard of j, otherwise 0
//! dV/dq(k)     = V(p) x S(k),                                       p the body inboard of joint k
//! dA/dq(k)     = A(p) x S(k) + (V(p) x S(k)) x (V - V(p))
//! dA/dqd(k)    = V(p) x S(k) + S(k) x (V - V(k))                    which is J' + dV/dq
//! ```
//!
//! In another reference frame, the motion of the frame relative to it is added: see [`ReferenceFrame`].

use super::frame::{AccelerationKind, Frame, ReferenceFrame};
use super::jacobian::{Columns, added, local_jacobian_in, rows, velocity_on_path};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{angular, cross_add, cross_motion, linear, scaled_add, spatial, sum, zero};
use nalgebra::{Vector3, Vector6};

/// dV/dq and J of a frame at q and qd into `out`, (2 x 6 x nv) row by row, with V expressed in `reference`. O(depth),
/// plus the zeros.
#[inline(always)]
pub fn velocity_derivatives<T: Real>(
    model: &Model<T>,
    (q, qd): (&[T], &[T]),
    frame: &Frame<T>,
    reference: ReferenceFrame,
    out: &mut [T],
) {
    let size = 6 * model.nv();
    let (by_q, by_qd) = out.split_at_mut(size);
    by_q.fill(T::zero());
    let at = Columns::of_matrix(model.nv());
    let placement = local_jacobian_in(model, q, frame, at, by_qd);
    let whole = velocity_on_path(model, frame, qd, by_qd);
    let mut inboard = whole;
    let mut body = frame.body;
    while let Some(k) = body {
        let stage = &model.system.stages[k];
        let own = added(&zero(), stage, qd, by_qd);
        inboard = scaled_add(&own, own[0].constant(-1.0), &inboard);
        for j in rows(stage) {
            let s = at.column(by_qd, j);
            let change = moved(reference, &s, &whole, &cross_motion(&inboard, &s));
            at.write(by_q, j, &reference.express(&placement, &change));
            at.write(by_qd, j, &reference.express(&placement, &s));
        }
        body = stage.parent;
    }
}

/// dA/dq, dA/dqd and J of a frame at q, qd and qdd into `out`, (3 x 6 x nv) row by row, with A of this kind expressed
/// in `reference`, without gravity. O(depth), plus the zeros.
#[inline(always)]
pub fn acceleration_derivatives<T: Real>(
    model: &Model<T>,
    (q, qd, qdd): (&[T], &[T], &[T]),
    frame: &Frame<T>,
    (reference, kind): (ReferenceFrame, AccelerationKind),
    out: &mut [T],
) {
    let size = 6 * model.nv();
    let (by_q, rest) = out.split_at_mut(size);
    let (by_qd, by_qdd) = rest.split_at_mut(size);
    by_q.fill(T::zero());
    by_qd.fill(T::zero());
    let at = Columns::of_matrix(model.nv());
    let placement = local_jacobian_in(model, q, frame, at, by_qdd);
    let velocity = velocity_on_path(model, frame, qd, by_qdd);
    // A = sum of S qdd + V(k) x S qd, inward.
    let (mut acceleration, mut own_velocity, mut body) = (zero(), velocity, frame.body);
    while let Some(k) = body {
        let stage = &model.system.stages[k];
        let own = added(&zero(), stage, qd, by_qdd);
        let pushed = added(&zero(), stage, qdd, by_qdd);
        acceleration = sum(&acceleration, &sum(&pushed, &cross_motion(&own_velocity, &own)));
        own_velocity = scaled_add(&own, own[0].constant(-1.0), &own_velocity);
        body = stage.parent;
    }
    let seen = reference.express(&placement, &velocity);
    let (minus_one, mut outboard) = (velocity[0].constant(-1.0), zero());
    let (mut inboard, mut inboard_acceleration, mut body) = (velocity, acceleration, frame.body);
    while let Some(k) = body {
        let stage = &model.system.stages[k];
        let own = added(&zero(), stage, qd, by_qdd);
        let pushed = added(&zero(), stage, qdd, by_qdd);
        let added = sum(&pushed, &cross_motion(&inboard, &own));
        inboard_acceleration = scaled_add(&added, minus_one, &inboard_acceleration);
        inboard = scaled_add(&own, minus_one, &inboard);
        let with_own: Vector6<T> = sum(&outboard, &own);
        for j in rows(stage) {
            let s = at.column(by_qdd, j);
            // V(p) x S is both dV/dq and, for a joint of one axis, the change of S with time.
            let turned = cross_motion(&inboard, &s);
            let of_motion = cross_motion(&turned, &with_own);
            let relative = sum(&cross_motion(&inboard_acceleration, &s), &of_motion);
            let change = moved(reference, &s, &acceleration, &relative);
            let change_of_velocity = moved(reference, &s, &velocity, &turned);
            let by_rate = sum(&turned, &cross_motion(&s, &outboard));
            let mut a = reference.express(&placement, &change);
            let mut b = reference.express(&placement, &by_rate);
            if kind == AccelerationKind::Classical {
                let v = reference.express(&placement, &change_of_velocity);
                a = with_product(&a, &seen, &v);
                b = with_product(&b, &seen, &reference.express(&placement, &s));
            }
            at.write(by_q, j, &a);
            at.write(by_qd, j, &b);
        }
        outboard = with_own;
        body = stage.parent;
    }
    let mut body = frame.body;
    while let Some(k) = body {
        let stage = &model.system.stages[k];
        for j in rows(stage) {
            let column = reference.express(&placement, &at.column(by_qdd, j));
            at.write(by_qdd, j, &column);
        }
        body = stage.parent;
    }
}

/// dJ/dq of a frame at q into `out`, (6 x nv x nv) row by row: entry (i, j, k) is dJ(i, j)/dq(k), with J expressed in
/// `reference`. O(depth^2), plus the zeros.
#[inline(always)]
pub fn jacobian_derivatives<T: Real>(
    model: &Model<T>,
    q: &[T],
    frame: &Frame<T>,
    reference: ReferenceFrame,
    out: &mut [T],
) {
    let nv = model.nv();
    // J in the places (i, j, j), whose derivatives are written last.
    let diagonal = Columns { row: nv * nv, column: nv + 1 };
    let placement = local_jacobian_in(model, q, frame, diagonal, out);
    let mut of_column = frame.body;
    while let Some(k) = of_column {
        let stage = &model.system.stages[k];
        for j in rows(stage) {
            let s = diagonal.column(out, j);
            let (mut moving, mut is_outboard) = (frame.body, true);
            while let Some(m) = moving {
                let by = &model.system.stages[m];
                is_outboard = is_outboard && m != k;
                for i in rows(by) {
                    if i == j {
                        continue;
                    }
                    let mover = diagonal.column(out, i);
                    let relative = if is_outboard { cross_motion(&s, &mover) } else { zero() };
                    let change = reference.express(&placement, &moved(reference, &mover, &s, &relative));
                    write_entry(out, nv, (j, i), &change);
                }
                moving = by.parent;
            }
        }
        of_column = stage.parent;
    }
    let mut of_column = frame.body;
    while let Some(k) = of_column {
        let stage = &model.system.stages[k];
        for j in rows(stage) {
            let s = diagonal.column(out, j);
            let change = reference.express(&placement, &moved(reference, &s, &s, &zero()));
            diagonal.write(out, j, &change);
        }
        of_column = stage.parent;
    }
}

/// The derivative in `reference` of a motion `x` of the frame, from that relative to the frame, which moves by `s`.
#[inline(always)]
fn moved<T: Real>(reference: ReferenceFrame, s: &Vector6<T>, x: &Vector6<T>, relative: &Vector6<T>) -> Vector6<T> {
    match reference {
        ReferenceFrame::Local => *relative,
        _ => sum(relative, &cross_motion(&reference.seen_from(s), x)),
    }
}

/// A change of the acceleration with that of w x v added to its linear half, for the velocity (w, v) and its change.
#[inline(always)]
fn with_product<T: Real>(change: &Vector6<T>, velocity: &Vector6<T>, by: &Vector6<T>) -> Vector6<T> {
    let first: Vector3<T> = cross_add(&angular(by), &linear(velocity), &linear(change));
    spatial(&angular(change), &cross_add(&angular(velocity), &linear(by), &first))
}

/// Writes the entries (i, j, k) of an array (6 x nv x nv) for all six i.
#[inline(always)]
fn write_entry<T: Real>(out: &mut [T], nv: usize, (j, k): (usize, usize), change: &Vector6<T>) {
    for i in 0..6 {
        out[(i * nv + j) * nv + k] = change[i];
    }
}
