//! Base to tip: the smoother.

use super::afloat;
use super::body::{Carrier, LeanBody, LeanModel};
use super::filter::{ABOUT_Z, in_joint_frame};
use super::motion::cross_number;
use super::scratch::LeanScratch;
use super::turn::{Axis, Turn, about, to_turn};
use crate::filter::riccati::Measured;
use crate::filter::rounding::Outward;
use crate::filter::smoother;
use crate::scalar::Real;
use crate::scene::Model;
use nalgebra::Vector6;

/// Co-states and estimates (4.9 to 4.11); `estimates` holds e^- on entry and a on return. Where `SEEN` the largest estimates are told, and the
/// largest co-states that shifts carry; else nothing is.
#[inline(always)]
pub(super) fn base_to_tip<T: Real, const SEEN: bool>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    estimates: &mut [T],
) -> Outward<T> {
    let mut seen = Outward::new();
    let LeanScratch { own, shifts, measured, co_states, .. } = scratch;
    for (body, own) in lean.swept().iter().zip(own) {
        let outer = &co_states[body.places.parent_outward];
        if SEEN && body.parent.is_some() {
            let square = match body.carrier {
                Carrier::Turn(_) => outer[0].everywhere(body.lever_square),
                Carrier::Shift(at) => shifts[at].lever_square(),
            };
            seen.observe_carried(&Vector6::from(*outer), square);
        }
        let lambda = match body.carrier {
            Carrier::Turn(axis) => {
                let outer = about!(axis, X, Y, Z, to_turn::<T, X, Y, Z>(outer));
                let estimate = &mut estimates[body.row];
                let a = estimated(body, own.turn, &measured[body.row], *estimate, &outer);
                *estimate = a * a.everywhere(body.sense);
                let mut lambda = carried(body, own.turn, &outer);
                lambda[2] += a;
                lambda
            }
            Carrier::Shift(at) if body.is_about_z => {
                let mut lambda: [T; 6] = shifts[at].motion_to_child(&Vector6::from(*outer)).into();
                let (m, estimate) = (&measured[body.row], &mut estimates[body.row]);
                *estimate = estimate.mul_add(m.pivot_inverse, -along(&m.gain.into(), &lambda));
                lambda[ABOUT_Z] += *estimate;
                lambda
            }
            Carrier::Shift(_) if afloat::is_noise_free(body, &model.system) => {
                afloat::smooth(&measured[afloat::rows(body)], &mut estimates[afloat::rows(body)])
            }
            Carrier::Shift(at) => {
                let mut lambda = shifts[at].motion_to_child(&Vector6::from(*outer));
                smoother::through_stage(&model.system.stages[body.index], measured, &mut lambda, estimates);
                lambda.into()
            }
        };
        if SEEN {
            let is_there = if T::LIMBS > 1 { Some(lambda[0].everywhere(body.stands_for_itself)) } else { None };
            for i in 0..if body.is_about_z { 1 } else { model.system.stages[body.index].rows.count() } {
                seen.observe_estimate(estimates[body.row + i], is_there);
            }
        }
        if !body.is_leaf {
            co_states[body.places.outward] = lambda;
        }
    }
    seen
}

/// phi* lambda across a turn, lambda in the turn's frame.
#[inline(always)]
pub(super) fn carried<T: Real>(body: &LeanBody<T::Parameter>, turn: Turn<T>, lambda: &[T; 6]) -> [T; 6] {
    let (w, v) = ([lambda[0], lambda[1], lambda[2]], [lambda[3], lambda[4], lambda[5]]);
    let v = if body.has_lever { cross_number(w, body.lever, v) } else { v };
    let (w, v) = (turn.rotate_back(w), turn.rotate_back(v));
    [w[0], w[1], w[2], v[0], v[1], v[2]]
}

/// e / D - g* phi* lambda, lambda in the turn's frame: phi g waits for nothing, and a does not wait for phi* lambda.
#[inline(always)]
fn estimated<T: Real>(body: &LeanBody<T::Parameter>, turn: Turn<T>, m: &Measured<T>, e: T, lambda: &[T; 6]) -> T {
    let g = in_joint_frame(body, turn, &m.gain.into());
    e.mul_add(m.pivot_inverse, -along(&g, lambda))
}

/// g* y, in two chains of products.
#[inline(always)]
pub(super) fn along<T: Real>(g: &[T; 6], y: &[T; 6]) -> T {
    let turning = g[0].mul_add(y[0], g[1].mul_add(y[1], g[2] * y[2]));
    let moving = g[3].mul_add(y[3], g[4].mul_add(y[4], g[5] * y[5]));
    turning + moving
}
