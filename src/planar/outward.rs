//! Base to tip in the plane: where the bodies are, how they move, and the force that this needs.

use super::model::{Direction, PlanarBody, PlanarModel};
use super::scratch::Of;
use crate::scalar::Real;
use nalgebra::Vector6;

/// One state of a planar scene.
#[derive(Clone, Copy)]
pub(super) struct State<'a, T> {
    pub q: &'a [T],
    pub qd: &'a [T],
    /// Without joint accelerations the force is the bias b(k).
    pub qdd: Option<&'a [T]>,
    /// Empty, or one a body in the frame of the model's body.
    pub wrenches: &'a [Vector6<T>],
}

/// R x, R the turn by the angle of this cosine and sine.
#[inline(always)]
pub(super) fn turned<T: Real>([c, s]: [T; 2], [x, y]: [T; 2]) -> [T; 2] {
    [(c * x).minus_product(s, y), s.mul_add(x, c * y)]
}

/// R* x.
#[inline(always)]
pub(super) fn turned_back<T: Real>([c, s]: [T; 2], [x, y]: [T; 2]) -> [T; 2] {
    [c.mul_add(x, s * y), (c * y).minus_product(s, x)]
}

/// x cross y, along the normal.
#[inline(always)]
pub(super) fn cross<T: Real>([ax, ay]: [T; 2], [bx, by]: [T; 2]) -> T {
    (ax * by).minus_product(ay, bx)
}

/// Places body `k` on its parent.
#[inline(always)]
pub(super) fn place<T: Real>(body: &PlanarBody<T>, q: T, of: &mut Of<T>) {
    let [x, y] = body.lever;
    match body.direction {
        Direction::Turns { .. } => {
            let (sine, cosine) = body.along(q).sin_cos();
            (of.turn, of.lever) = ([cosine, sine], [x, y]);
        }
        Direction::Slides { cosine, sine } => {
            (of.turn, of.lever) = ([cosine, sine], [cosine.mul_add(q, x), sine.mul_add(q, y)]);
        }
    }
}

/// Base to tip: turns and levers.
#[inline(always)]
pub(super) fn placements<T: Real>(model: &PlanarModel<T>, of: &mut [Of<T>], q: &[T]) {
    for (k, body) in model.bodies.iter().enumerate() {
        place(body, q[k], &mut of[k]);
    }
}

/// Base to tip: turns, levers, spins w, accelerations a of the origins, and the force that each body needs,
/// f = m a + w' e x h - w^2 h with the moment J w' + h x a.
///
/// An origin's acceleration is its parent's with w' e x l - w^2 l; a slide adds qdd along itself and 2 w qd across.
#[inline(always)]
pub(super) fn forces<T: Real>(model: &PlanarModel<T>, of: &mut [Of<T>], state: State<'_, T>) {
    let zero = model.gravity[0].constant(0.0);
    for (k, body) in model.bodies.iter().enumerate() {
        place(body, state.q[k], &mut of[k]);
        let own = of[k];
        let [lx, ly] = own.lever;
        let (mut spin, mut angular, mut linear) = (zero, zero, [-model.gravity[0], -model.gravity[1]]);
        if let Some(parent) = body.parent {
            let Of { spin: [rate, square], motion, .. } = of[parent];
            (spin, angular) = (rate, motion[0]);
            linear = [motion[1].minus_product(square, lx), motion[2].minus_product(square, ly)];
            if state.qdd.is_some() {
                linear = [linear[0].minus_product(angular, ly), angular.mul_add(lx, linear[1])];
            }
        }
        let [mut x, mut y] = turned_back(own.turn, linear);
        if let Direction::Slides { .. } = body.direction {
            let twice = spin + spin;
            y = twice.mul_add(state.qd[k], y);
            if let Some(qdd) = state.qdd {
                x += qdd[k];
            }
        } else {
            spin += body.along(state.qd[k]);
            if let Some(qdd) = state.qdd {
                angular += body.along(qdd[k]);
            }
        }
        let square = spin * spin;
        let [hx, hy] = body.first_moment;
        let moment = cross([hx, hy], [x, y]);
        let mut force = [moment, (body.mass * x).minus_product(square, hx), (body.mass * y).minus_product(square, hy)];
        if state.qdd.is_some() {
            force = [
                body.inertia.mul_add(angular, moment),
                force[1].minus_product(angular, hy),
                angular.mul_add(hx, force[2]),
            ];
        }
        if !state.wrenches.is_empty() {
            let given = in_plane(body, &state.wrenches[k]);
            force = [force[0] - given[0], force[1] - given[1], force[2] - given[2]];
        }
        let own = &mut of[k];
        (own.spin, own.motion, own.force) = ([spin, square], [angular, x, y], force);
    }
}

/// The components of a spatial force that do work in the plane.
#[inline(always)]
fn in_plane<T: Real>(body: &PlanarBody<T>, wrench: &Vector6<T>) -> [T; 3] {
    let [x, y, normal] = body.frame;
    let (moment, force) = ([wrench[0], wrench[1], wrench[2]], [wrench[3], wrench[4], wrench[5]]);
    [dot(normal, moment), dot(x, force), dot(y, force)]
}

/// The sum of three products.
#[inline(always)]
pub(super) fn dot<T: Real>(a: [T; 3], b: [T; 3]) -> T {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

/// phi f: a force (moment, x, y) from the body's frame to its parent's.
#[inline(always)]
pub(super) fn force_to_parent<T: Real>(turn: [T; 2], [lx, ly]: [T; 2], [moment, x, y]: [T; 3]) -> [T; 3] {
    let [x, y] = turned(turn, [x, y]);
    [lx.mul_add(y, moment.minus_product(ly, x)), x, y]
}
