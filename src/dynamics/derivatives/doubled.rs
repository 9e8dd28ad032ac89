//! Derivatives of a state that loses digits: once more with twice the digits.

use super::{DerivativeScratch, ForwardDerivatives, forward_dynamics_derivatives};
use crate::filter::Form;
use crate::model::Model;
use crate::scalar::{DoubleDouble, Real};
use crate::workspace::Workspace;
use nalgebra::Vector6;
use std::any::Any;

/// The derivatives of forward dynamics in double-double arithmetic and square-root form, rounded into `out`; false, and `out` as it was, where there
/// is no model to widen (only f64 has one), a body's inertia has no root, or the wider numbers overflow as well.
#[cold]
pub(super) fn derivatives<T: Real>(
    model: &Model<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    out: &mut ForwardDerivatives<'_, T>,
) -> bool {
    // Numbers that hold more than a value, such as dual ones, would come back without the rest.
    let Some(model) = (model as &dyn Any).downcast_ref::<Model<f64>>() else { return false };
    if model.inertia_roots.iter().any(Option::is_none) {
        return false;
    }
    let widened = |x: T| DoubleDouble::from_f64(x.lane(0));
    let [q, qd, tau] = [q, qd, tau].map(|x| x.iter().map(|&x| widened(x)).collect::<Vec<_>>());
    let wrenches: Vec<_> = wrenches.iter().map(|wrench| wrench.map(widened)).collect();
    let model: Model<DoubleDouble> = model.cast();
    let mut workspace = Workspace::new(&model).in_form(Form::SquareRoot);
    let mut scratch = DerivativeScratch::new(&model);
    let nan = DoubleDouble::from_f64(f64::NAN);
    let mut wide = [(); 3].map(|()| vec![nan; model.nv() * model.nv()]);
    let [dqdd_dq, dqdd_dqd, mass_matrix_inverse] = &mut wide;
    let mut room = ForwardDerivatives { dqdd_dq, dqdd_dqd, mass_matrix_inverse };
    let done = forward_dynamics_derivatives(&model, &mut workspace, &mut scratch, &q, &qd, &tau, &wrenches, &mut room);
    if done.is_err() || !wide.iter().flatten().all(|x| x.lane(0).is_finite()) {
        return false;
    }
    let rounded = [&mut *out.dqdd_dq, &mut *out.dqdd_dqd, &mut *out.mass_matrix_inverse];
    for (to, from) in rounded.into_iter().flatten().zip(wide.iter().flatten()) {
        *to = T::from_f64(from.lane(0));
    }
    true
}
