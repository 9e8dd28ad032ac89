//! The recursions of forward and inverse dynamics, M and M^-1: each pass once, generic over the scalar, the kinds of
//! joints and the store.
//!
//! - *Scalar*: f64, lanes of states, double-double, dual and traced numbers. Constants of the scene are one number for
//!   all lanes.
//! - *Joints*: the kernels' model ([`SweepModel::new`]) has a transform per kind of joint. A revolute joint about an
//!   axis of the parent's frame is a rotation about z and a constant lever; [`frames`] are chosen so that one of three
//!   orders of the parent's axes remains, and each is compiled separately. Any other axis adds a constant rotation. P
//!   passes a prismatic joint by constant angles. All other joints use the general shift. The general model
//!   ([`SweepModel::general`]) uses the general shift for every joint, in the frames of the model.
//! - *Store*: each body has [slots]. In the kernels' model a slot is reused after the last body that reads it: a chain
//!   has two. In the general model each body has its own, so that P, D, g, forces and co-states of every body can be
//!   read afterwards.
//!
//! The kernels compile these passes inline for each instruction set. [`general`] compiles each of them once per scalar.

pub(super) mod body;
mod co_states;
pub(super) mod column_layout;
mod error_estimate;
mod filter;
mod frames;
pub(crate) mod general;
mod inverse_product;
pub(super) mod joint;
mod load;
mod mass_matrix;
pub(super) mod model;
pub(super) mod motion;
mod path_rows;
mod paths;
mod root_filter;
pub(super) mod rows;
pub(super) mod scratch;
mod slots;
mod solve;
mod spin;
mod tiles;

pub use co_states::co_state_covariances;
pub(crate) use error_estimate::{ErrorTerms, factor_with_estimate, forward_dynamics_with_estimate};
pub(crate) use filter::factor;
#[cfg(feature = "python")]
pub(crate) use filter::refactor;
pub(crate) use frames::AxisPermutation;
pub(crate) use inverse_product::InverseColumns;
pub(crate) use inverse_product::multiplied_out;
pub(crate) use mass_matrix::MassColumns;
pub(crate) use mass_matrix::mass_matrix;
pub(crate) use model::SweepModel;
pub(crate) use path_rows::{PathRows, WhitenedRows};
pub(crate) use paths::{
    Forces, MOST_FORCES, Path, accelerations_along, frame_here, motions_along, origin_along, placement_along,
    point_along,
};
#[cfg(feature = "operators")]
pub(crate) use scratch::Accumulated;
pub(crate) use scratch::SweepScratch;
#[cfg(feature = "report")]
pub(crate) use scratch::bytes;
#[cfg(feature = "operators")]
pub(crate) use scratch::covariances_of_root;
pub(crate) use solve::{innovations_of_factor, smooth, solve};
pub(crate) use tiles::Entries;

use super::forces::Motion;
#[cfg(feature = "report")]
use crate::algorithm::Algorithm;
use crate::filter::Form;
use crate::filter::pivots::PivotMonitor;
use crate::filter::rounding::RoundingBound;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};
use nalgebra::Vector6;

/// True if an algorithm has kernels, in form `auto` at least for states that need no fallback.
#[cfg(feature = "report")]
pub(crate) fn covers(algorithm: Algorithm) -> bool {
    algorithm.form() != Some(Form::SquareRoot)
        || matches!(algorithm, Algorithm::ForwardDynamics(_) | Algorithm::ConstrainedDynamics(_))
}

/// Joint accelerations in covariance form.
#[inline(always)]
pub(crate) fn forward_dynamics<T: Real, C: ColumnsOf<T>>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> PivotMonitor<T> {
    let monitor = innovations_and_factor::<T, C>((model, sweeps), scratch, (q, qd, tau), wrenches, qdd);
    solve::base_to_tip::<T, false>((model, sweeps), scratch, qdd);
    monitor
}

/// The factor of M and e^- of a state (3.6, 4.2) in one pass; [`smooth`] computes the accelerations from them.
#[inline(always)]
pub(crate) fn innovations_and_factor<T: Real, C: ColumnsOf<T>>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    innovations: &mut [T],
) -> PivotMonitor<T> {
    let state = Motion { q, qd, qdd: None, wrenches };
    motion::base_to_tip::<T, C, false>((model, sweeps), scratch, state);
    let [monitor, _] = filter::tip_to_base::<T, { filter::FILTER }>((model, sweeps), scratch, tau, innovations);
    monitor
}

/// The rotation or shift of every joint at `q`, for paths without a factor of M.
#[inline(always)]
pub(crate) fn place<T: Real, C: ColumnsOf<T>>(sweeps: &SweepModel<T>, scratch: &mut SweepScratch<T>, like: C, q: &[T]) {
    motion::carriers::<T, C>(sweeps, scratch, like, q);
}

/// Joint accelerations in square-root form, and the bound on their rounding.
#[inline(always)]
pub(crate) fn forward_dynamics_by_roots<T: Real, C: ColumnsOf<T>>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> (PivotMonitor<T>, RoundingBound<T>) {
    let state = Motion { q, qd, qdd: None, wrenches };
    motion::base_to_tip::<T, C, true>((model, sweeps), scratch, state);
    let monitor = root_filter::tip_to_base::<T, false>((model, sweeps), scratch, tau, qdd);
    let outward = solve::base_to_tip::<T, true>((model, sweeps), scratch, qdd);
    (monitor.pivots, RoundingBound::of(&monitor, outward))
}

/// Joint torques; without `qdd` those of the bias.
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
    motion::tip_to_base::<T, false>((model, sweeps), scratch, tau);
    if let Some(qdd) = qdd {
        add_armature(model, qdd, tau);
    }
}

/// Adds the torque of the rotor inertias, r qdd.
#[inline(always)]
fn add_armature<T: Real>(model: &Model<T>, qdd: &[T], tau: &mut [T]) {
    for ((tau, &qdd), &armature) in tau.iter_mut().zip(qdd).zip(&model.system.noise) {
        *tau += armature * qdd;
    }
}
