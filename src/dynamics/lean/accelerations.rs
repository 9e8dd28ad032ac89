//! Base to tip: the smoother.

use super::body::{Carrier, LeanBody, LeanModel};
use super::motion::{cross_number, four, three};
use super::scratch::{Halves, LeanScratch};
use super::turn::{Renaming, Turn};
use crate::filter::riccati::Measured;
use crate::filter::smoother;
use crate::scalar::Real;
use crate::scene::Model;
use nalgebra::Vector6;

/// Co-states and estimates (4.9 to 4.11); `estimates` holds e^- on entry and a on return.
#[inline(always)]
pub(super) fn base_to_tip<T: Real>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    estimates: &mut [T],
) {
    for (k, body) in lean.bodies.iter().enumerate() {
        let lambda = match &body.carrier {
            Carrier::Turn(renaming) => {
                let mut lambda = carried(body, renaming, scratch.turns[k], &scratch.co_states[body.parent_outward]);
                let a = estimated(&scratch.measured[body.row], estimates[body.row], &lambda);
                lambda[0][2] += a;
                estimates[body.row] = a;
                lambda
            }
            Carrier::Shift(at) => {
                let mut lambda = scratch.shifts[*at].motion_to_child(&whole(&scratch.co_states[body.parent_outward]));
                smoother::through_stage(&model.system.stages[k], &scratch.measured, &mut lambda, estimates);
                halves(&lambda)
            }
        };
        if !body.is_leaf {
            scratch.co_states[body.outward] = [four(lambda[0]), four(lambda[1])];
        }
    }
}

/// phi* lambda across a turn.
#[inline(always)]
pub(super) fn carried<T: Real>(
    body: &LeanBody<T::Parameter>,
    renaming: &Renaming<T::Parameter>,
    turn: Turn<T>,
    lambda: &Halves<T>,
) -> [[T; 3]; 2] {
    let (w, v) = (renaming.back(&lambda[0]), renaming.back(&lambda[1]));
    let v = if body.has_lever { cross_number(w, body.lever, v) } else { v };
    [turn.rotate_back(w), turn.rotate_back(v)]
}

/// e / D - g* lambda.
#[inline(always)]
pub(super) fn estimated<T: Real>(m: &Measured<T>, e: T, [w, v]: &[[T; 3]; 2]) -> T {
    e.mul_add(m.pivot_inverse, -along(&m.gain, w, v))
}

/// g* lambda, in two chains of products.
#[inline(always)]
pub(super) fn along<T: Real>(g: &Vector6<T>, w: &[T; 3], v: &[T; 3]) -> T {
    let turning = g[0].mul_add(w[0], g[1].mul_add(w[1], g[2] * w[2]));
    let moving = g[3].mul_add(v[0], g[4].mul_add(v[1], g[5] * v[2]));
    turning + moving
}

/// As the general stages take it.
#[inline(always)]
pub(super) fn whole<T: Real>(x: &Halves<T>) -> Vector6<T> {
    let ([a, b, c], [d, e, f]) = (three(&x[0]), three(&x[1]));
    Vector6::new(a, b, c, d, e, f)
}

#[inline(always)]
fn halves<T: Real>(x: &Vector6<T>) -> [[T; 3]; 2] {
    [[x[0], x[1], x[2]], [x[3], x[4], x[5]]]
}

/// As it is kept in a place.
#[inline(always)]
pub(super) fn split<T: Real>(x: &Vector6<T>) -> Halves<T> {
    let [w, v] = halves(x);
    [four(w), four(v)]
}
