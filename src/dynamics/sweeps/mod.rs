//! Forward and inverse dynamics, M and M^-1 where nothing but the result is wanted, for states in lanes and for one state.
//!
//! The recursions are those of [`forward`](super::forward), [`forward_root`](super::forward_root) and [`inverse`](super::inverse), which keep
//! everything for whoever asks later, and against which these are tested. Four things differ.
//!
//! - What only the next body reads (motions, P, co-states) is in a *slot*, which another body takes over; a chain has two.
//! - Constants of the scene are one number for all lanes.
//! - A revolute joint about an axis of its parent's frame is carried by its angle alone: about z, then along the constant lever. [`frames`] are chosen
//!   so that one of three orders of the parent's axes is left, and each is compiled by itself. About any other axis a
//!   [constant rotation](constant_rotation) comes between. Of a [prismatic] joint P goes by constant angles too. Everything else goes through the general shift.
//! - Bodies at equal depth come one after another: they do not wait for each other.

mod accelerations;
pub(super) mod body;
pub(super) mod column_layout;
mod entries;
mod filter;
mod frames;
mod inverse_columns;
mod inverse_product;
pub(super) mod joint;
mod mass_columns;
mod mass_inverse;
mod mass_matrix;
pub(super) mod model;
pub(super) mod motion;
mod paths;
mod predict;
mod renaming;
mod root_filter;
pub(super) mod rows;
pub(super) mod scratch;
mod slots;
mod solve;
mod spin;
mod tiles;
mod vectors;
mod watch;

pub(crate) use entries::Entries;
pub(crate) use inverse_columns::InverseColumns;
pub(crate) use inverse_product::multiplied_out;
pub(crate) use mass_columns::MassColumns;
pub(crate) use mass_inverse::factor;
pub(crate) use mass_matrix::mass_matrix;
pub(crate) use model::SweepModel;
pub(crate) use paths::{
    Forces, MOST_FORCES, Path, accelerations_along, frame_here, innovations_along, motions_along, origin_along,
    placement_along,
};
pub(crate) use scratch::{SweepScratch, bytes};
pub(crate) use solve::{innovations_of_factor, smooth, solve};
pub(crate) use watch::{Look, factor_watched, forward_dynamics_watched};

use super::forces::Motion;
use crate::algorithm::{Algorithm, Derivatives, Products};
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
        Algorithm::MassMatrixInverse(Form::SquareRoot)
            | Algorithm::Derivatives(Derivatives::ForwardDynamics(Form::SquareRoot))
            | Algorithm::Products(
                Products::ForwardTangent(Form::SquareRoot)
                    | Products::ForwardTangents(Form::SquareRoot)
                    | Products::ForwardGradient(Form::SquareRoot)
                    | Products::ForwardGradients(Form::SquareRoot)
            )
    )
}

/// Joint accelerations, as [`forward_dynamics`](super::forward_dynamics) in covariance form gives them to rounding.
#[inline(always)]
pub(crate) fn forward_dynamics<T: Real, C: ColumnsOf<T>>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> PivotMonitor<T> {
    let state = Motion { q, qd, qdd: None, wrenches };
    motion::base_to_tip::<T, C, false>((model, sweeps), scratch, state);
    let [monitor, _] = filter::tip_to_base::<T, { filter::FILTER }>((model, sweeps), scratch, tau, qdd);
    accelerations::base_to_tip::<T, false>((model, sweeps), scratch, qdd);
    monitor
}

/// Joint accelerations in square-root form, and the first look at them, to rounding as
/// [`forward_dynamics_judged`](super::refined::forward_dynamics_judged) takes them.
#[inline(always)]
pub(crate) fn forward_dynamics_by_roots<T: Real, C: ColumnsOf<T>>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> (PivotMonitor<T>, Reach<T>) {
    let state = Motion { q, qd, qdd: None, wrenches };
    motion::base_to_tip::<T, C, true>((model, sweeps), scratch, state);
    let monitor = root_filter::tip_to_base((model, sweeps), scratch, tau, qdd);
    let outward = accelerations::base_to_tip::<T, true>((model, sweeps), scratch, qdd);
    (monitor.pivots, Reach::of(&monitor, outward))
}

/// Joint torques, as [`inverse_dynamics`](super::inverse_dynamics) gives them to rounding; those of the bias without `qdd`.
#[inline(always)]
pub(crate) fn inverse_dynamics<T: Real, C: ColumnsOf<T>>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    (q, qd, qdd): (&[T], &[T], Option<&[T]>),
    wrenches: &[Vector6<T>],
    tau: &mut [T],
) {
    let state = Motion { q, qd, qdd, wrenches };
    motion::base_to_tip::<T, C, false>((model, sweeps), scratch, state);
    predict::tip_to_base((model, sweeps), scratch, tau);
    if let Some(qdd) = qdd {
        for ((tau, &qdd), &armature) in tau.iter_mut().zip(qdd).zip(&model.system.noise) {
            *tau += armature * qdd;
        }
    }
}
