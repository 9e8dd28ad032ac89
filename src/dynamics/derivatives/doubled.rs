//! Derivatives in double-double arithmetic, for states whose error estimate exceeds the tolerance.

use super::{DerivativeScratch, forward_dynamics_derivatives};
use crate::dynamics::double_double_state::DoubleDoubleState;
use crate::model::Model;
use crate::scalar::Real;
use nalgebra::Vector6;

/// The derivatives of forward dynamics in double-double arithmetic, see [`DoubleDoubleState::recompute`].
pub(super) fn derivatives<T: Real>(
    model: &Model<T>,
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    out: &mut [T],
) -> bool {
    DoubleDoubleState::recompute(model, state, wrenches, out, |wide, out| {
        let DoubleDoubleState { model, workspace, q, qd, tau, wrenches } = wide;
        let scratch = &mut DerivativeScratch::new(model);
        forward_dynamics_derivatives(model, workspace, scratch, (q, qd, tau), wrenches, out).is_ok()
    })
}
