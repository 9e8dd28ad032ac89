//! Derivatives of a state that loses digits: once more with twice the digits.

use super::{DerivativeScratch, ForwardDerivatives, forward_dynamics_derivatives};
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
    out: &mut ForwardDerivatives<'_, T>,
) -> bool {
    let Some(mut widened) = Widened::of(model, state, wrenches) else { return false };
    let Widened { model, workspace, q, qd, tau, wrenches } = &mut widened;
    let mut scratch = DerivativeScratch::new(model);
    let nan = DoubleDouble::from_f64(f64::NAN);
    let mut wide = [(); 3].map(|()| vec![nan; model.nv() * model.nv()]);
    let [dqdd_dq, dqdd_dqd, mass_matrix_inverse] = &mut wide;
    let mut room = ForwardDerivatives { dqdd_dq, dqdd_dqd, mass_matrix_inverse };
    let done = forward_dynamics_derivatives(model, workspace, &mut scratch, q, qd, tau, wrenches, &mut room);
    if done.is_err() || !wide.iter().flatten().all(|x| x.lane(0).is_finite()) {
        return false;
    }
    let rounded = [&mut *out.dqdd_dq, &mut *out.dqdd_dqd, &mut *out.mass_matrix_inverse];
    for (to, from) in rounded.into_iter().flatten().zip(wide.iter().flatten()) {
        *to = T::from_f64(from.lane(0));
    }
    true
}
