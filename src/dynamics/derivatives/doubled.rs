//! Derivatives of a state that loses digits: once more with twice the digits.

use super::{DerivativeScratch, forward_dynamics_derivatives};
use crate::dynamics::widened::Widened;
use crate::model::Model;
use crate::scalar::{DoubleDouble, Real};
use nalgebra::Vector6;

/// The derivatives of forward dynamics in double-double arithmetic and square-root form, rounded into `out`; false, and `out` as it was, where there
/// is no model to widen (only f64 has one), a body's inertia has no root, or the wider numbers overflow as well.
#[cold]
pub(super) fn derivatives<T: Real>(
    model: &Model<T>,
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    out: &mut [T],
) -> bool {
    let Some(mut widened) = Widened::of(model, state, wrenches) else { return false };
    let Widened { model, workspace, q, qd, tau, wrenches } = &mut widened;
    let mut scratch = DerivativeScratch::new(model);
    let mut wide = vec![DoubleDouble::from_f64(f64::NAN); out.len()];
    let done = forward_dynamics_derivatives(model, workspace, &mut scratch, (q, qd, tau), wrenches, &mut wide);
    if done.is_err() || !wide.iter().all(|x| x.lane(0).is_finite()) {
        return false;
    }
    for (to, from) in out.iter_mut().zip(&wide) {
        *to = T::from_f64(from.lane(0));
    }
    true
}
