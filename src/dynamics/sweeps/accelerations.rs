//! Base to tip: the smoother.

use super::axial_rotation::ABOUT_Z;
use super::axial_rotation::{Axis, about, to_turn};
use super::carrier::Carrier;
use super::carry::in_joint_frame;
use super::constant_rotation::JointAxis;
use super::free_joint;
use super::lever::Lever;
use super::model::SweepModel;
use super::rotation::{ObliqueRotation, Rotates, rotated};
use super::scratch::{CoState, SweepScratch};
use crate::filter::rounding::Outward;
use crate::filter::smoother;
use crate::model::Model;
use crate::scalar::Real;
use nalgebra::Vector6;

/// Co-states and estimates (4.9 to 4.11); `estimates` holds e^- on entry and a on return. Where `SEEN` the largest estimates are told, and the
/// largest co-states that shifts carry; else nothing is.
#[inline(always)]
pub(super) fn base_to_tip<T: Real, const SEEN: bool>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    estimates: &mut [T],
) -> Outward<T> {
    let mut seen = Outward::new();
    let SweepScratch { own, shifts, measured, co_states, .. } = scratch;
    // Of one length, for the compiler to see.
    let estimates = &mut estimates[..measured.len()];
    for (place, (body, own)) in sweeps.segments.iter().zip(own).enumerate() {
        let outer = &co_states[body.parent_outward];
        if SEEN && !body.is_on_base {
            let square = match body.carrier {
                Carrier::Axial(_) => outer.estimate.splat(sweeps.swept()[place].lever_square),
                Carrier::Shift(at) => shifts[at].lever_square(),
            };
            seen.observe_carried(&Vector6::from(outer.whole()), square);
        }
        let lambda = match body.carrier {
            Carrier::Axial(_) if body.is_on_base => {
                // Nothing is carried to it.
                let (m, to) = (&measured[body.row], &mut estimates[body.row]);
                let estimate = *to * m.pivot_inverse;
                *to = estimate * estimate.splat(body.sense);
                CoState { carried: [estimate.constant(0.0); 6], estimate }
            }
            Carrier::Axial(axle) => rotated!(axle, own.turn, sweeps.tilts, rotation, X, Y, Z, {
                // The parent's z in this frame, along which its estimate is.
                const ITS_Z: usize = if X == ABOUT_Z {
                    0
                } else if Y == ABOUT_Z {
                    1
                } else {
                    2
                };
                let (mut there, its) = (to_turn::<T, X, Y, Z>(&outer.carried), outer.estimate);
                let (m, to) = (&measured[body.row], &mut estimates[body.row]);
                let lever = body.arm.in_axes::<X, Y, Z>();
                let estimate = if body.waits_for_parent {
                    // phi g waits for nothing, the estimate not for phi* lambda, and of the parent's estimate only the last step.
                    let g = in_joint_frame(&lever, &rotation, &m.gain.into());
                    but_along(*to * m.pivot_inverse, &g, &there).minus_product(g[ITS_Z], its)
                } else {
                    *to * m.pivot_inverse
                };
                there[ITS_Z] += its;
                let carried = carried(&lever, &rotation, &there);
                let estimate =
                    if body.waits_for_parent { estimate } else { but_along(estimate, &m.gain.into(), &carried) };
                *to = estimate * estimate.splat(body.sense);
                CoState { carried, estimate }
            }),
            Carrier::Shift(_) if free_joint::is_noise_free(body.is_free_joint, body.row, &model.system) => {
                let rows = free_joint::rows(body.row);
                CoState::of(free_joint::smooth(&measured[rows.clone()], &mut estimates[rows]))
            }
            Carrier::Shift(at) => {
                let mut lambda = shifts[at].motion_to_child(&Vector6::from(outer.whole()));
                smoother::through_stage(&model.system.stages[body.index], measured, &mut lambda, estimates);
                CoState::of(lambda.into())
            }
        };
        if SEEN {
            for i in 0..if body.is_about_z { 1 } else { model.system.stages[body.index].rows.count() } {
                seen.observe_estimate(estimates[body.row + i]);
            }
        }
        if !body.is_leaf {
            co_states[body.outward] = lambda;
        }
    }
    seen
}

/// phi* lambda across a revolute joint with this lever; lambda in the joint's frame.
#[inline(always)]
pub(super) fn carried<T: Real>(lever: &Lever<T::Parameter>, rotation: &impl Rotates<T>, lambda: &[T; 6]) -> [T; 6] {
    let (w, v) = ([lambda[0], lambda[1], lambda[2]], [lambda[3], lambda[4], lambda[5]]);
    let (w, v) = (rotation.rotate_back(w), rotation.rotate_back(lever.velocity(w, v)));
    [w[0], w[1], w[2], v[0], v[1], v[2]]
}

/// x - g* y.
#[inline(always)]
fn but_along<T: Real>(x: T, g: &[T; 6], y: &[T; 6]) -> T {
    let turning = x.minus_product(g[0], y[0]).minus_product(g[1], y[1]).minus_product(g[2], y[2]);
    let moving = g[3].mul_add(y[3], g[4].mul_add(y[4], g[5] * y[5]));
    turning - moving
}

/// g* y, in two chains of products.
#[inline(always)]
pub(super) fn along<T: Real>(g: &[T; 6], y: &[T; 6]) -> T {
    let turning = g[0].mul_add(y[0], g[1].mul_add(y[1], g[2] * y[2]));
    let moving = g[3].mul_add(y[3], g[4].mul_add(y[4], g[5] * y[5]));
    turning + moving
}
