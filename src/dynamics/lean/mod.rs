//! Forward and inverse dynamics where nothing but the result is wanted, for states in lanes and for one state: the covariance form, and of
//! accelerations the square-root form ([`root_filter`]).
//!
//! The recursions are those of [`forward`](super::forward), [`forward_root`](super::forward_root) and [`inverse`](super::inverse), which keep
//! everything for whoever asks later, and are what these are tested against. Four things are different. What is read once more only by the next body (motions,
//! P, co-states) has a *slot*, which another body takes over; of a chain there are two. Constants of the scene are one number for all
//! lanes. And a revolute joint about an axis of its parent's frame (as all about x, y or z are that a URDF gives without rpy) is
//! carried by its angle alone: first about z, where H P^+ = 0 leaves a third out, then along the lever, a constant there. Frames are
//! chosen so that what is left of the renaming is one of three orders of the parent's axes ([`frames`]): each is compiled by itself. About any other axis a
//! constant angle or two come between ([`tilt`]).
//! Of a body that slides P goes by constant angles too ([`slide`]); every other body, and all else of that one, goes through the general shift. Bodies at equal depth come one after another, for they do not wait for each other;
//!

mod about_axis;
mod accelerations;
mod afloat;
mod body;
mod bounds;
mod carrier;
mod carry;
mod columns;
mod entries;
mod filter;
mod frames;
mod inverse_product;
mod lever;
mod mass_columns;
mod mass_inverse;
mod mass_matrix;
mod model;
mod motion;
mod packed;
mod predict;
mod root_filter;
mod rotation;
mod row;
mod scratch;
mod segment;
mod slide;
mod slots;
mod spin;
mod tiles;
mod tilt;
mod turn;
mod vectors;
mod watch;
mod way;

pub(crate) use about_axis::{turns_about_a_tilted_axis, turns_about_an_axis};
pub(crate) use columns::LeanColumns;
pub(crate) use entries::Entries;
pub(crate) use inverse_product::multiplied_out;
pub(crate) use mass_columns::MassColumns;
pub(crate) use mass_inverse::factor;
pub(crate) use mass_matrix::mass_matrix;
pub(crate) use model::LeanModel;
pub(crate) use scratch::{LeanScratch, bytes};
pub(crate) use watch::{factor_watched, forward_dynamics_watched, hand_over};

use super::forces::Motion;
use crate::algorithm::Algorithm;
use crate::filter::Form;
use crate::filter::pivots::PivotMonitor;
use crate::filter::rounding::Reach;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};
use nalgebra::Vector6;

/// Whether an algorithm is done by these sweeps, or in form `auto` at least looked at first.
pub(crate) fn covers(algorithm: Algorithm) -> bool {
    !matches!(
        algorithm,
        Algorithm::ForwardDynamics(Form::Joseph) | Algorithm::MassMatrixInverse(Form::SquareRoot | Form::Joseph)
    )
}

/// Joint accelerations, as [`forward_dynamics`](super::forward_dynamics) in covariance form gives them to rounding.
#[inline(always)]
pub(crate) fn forward_dynamics<T: Real, C: ColumnsOf<T>>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> PivotMonitor<T> {
    let state = Motion { q, qd, qdd: None, wrenches };
    motion::base_to_tip::<T, C, false>((model, lean), scratch, state);
    let [monitor, _] = filter::tip_to_base::<T, { filter::FILTER }>((model, lean), scratch, tau, qdd);
    accelerations::base_to_tip::<T, false>((model, lean), scratch, qdd);
    monitor
}

/// Joint accelerations in square-root form, and the first look at them, to rounding as
/// [`forward_dynamics_judged`](super::refined::forward_dynamics_judged) takes them.
#[inline(always)]
pub(crate) fn forward_dynamics_by_roots<T: Real, C: ColumnsOf<T>>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> (PivotMonitor<T>, Reach<T>) {
    let state = Motion { q, qd, qdd: None, wrenches };
    motion::base_to_tip::<T, C, true>((model, lean), scratch, state);
    let monitor = root_filter::tip_to_base((model, lean), scratch, tau, qdd);
    let outward = accelerations::base_to_tip::<T, true>((model, lean), scratch, qdd);
    (monitor.pivots, Reach::of(&monitor, outward))
}

/// Joint torques, as [`inverse_dynamics`](super::inverse_dynamics) gives them to rounding; those of the bias without `qdd`.
#[inline(always)]
pub(crate) fn inverse_dynamics<T: Real, C: ColumnsOf<T>>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    (q, qd, qdd): (&[T], &[T], Option<&[T]>),
    wrenches: &[Vector6<T>],
    tau: &mut [T],
) {
    let state = Motion { q, qd, qdd, wrenches };
    motion::base_to_tip::<T, C, false>((model, lean), scratch, state);
    predict::tip_to_base((model, lean), scratch, tau);
    if let Some(qdd) = qdd {
        for ((tau, &qdd), &armature) in tau.iter_mut().zip(qdd).zip(&model.system.noise) {
            *tau += armature * qdd;
        }
    }
}
