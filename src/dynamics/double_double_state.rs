//! A state in double-double arithmetic, for results whose error estimate exceeds the tolerance.

use crate::filter::Form;
use crate::model::Model;
use crate::scalar::{DoubleDouble, Real};
use crate::workspace::Workspace;
use nalgebra::Vector6;
use std::any::Any;

/// A model and a state in double-double arithmetic, with a workspace in square-root form.
pub(super) struct DoubleDoubleState {
    pub model: Model<DoubleDouble>,
    pub workspace: Workspace<DoubleDouble>,
    pub q: Vec<DoubleDouble>,
    pub qd: Vec<DoubleDouble>,
    pub tau: Vec<DoubleDouble>,
    pub wrenches: Vec<Vector6<DoubleDouble>>,
}

impl DoubleDoubleState {
    /// None if the scalar is not f64, or the inertia of a body has no root.
    pub fn of<T: Real>(model: &Model<T>, state: (&[T], &[T], &[T]), wrenches: &[Vector6<T>]) -> Option<Self> {
        // Scalars that hold more than a value, such as dual numbers, would lose the rest.
        let model = (model as &dyn Any).downcast_ref::<Model<f64>>()?;
        if model.inertia_roots.iter().any(Option::is_none) {
            return None;
        }
        let widened = |x: T| DoubleDouble::from_f64(x.lane(0));
        let all = |numbers: &[T]| numbers.iter().map(|&x| widened(x)).collect();
        let model: Model<DoubleDouble> = model.cast();
        Some(Self {
            workspace: Workspace::new(&model).in_form(Form::SquareRoot),
            model,
            q: all(state.0),
            qd: all(state.1),
            tau: all(state.2),
            wrenches: wrenches.iter().map(|wrench| wrench.map(widened)).collect(),
        })
    }
    /// Computes a result in double-double arithmetic and square-root form, and rounds it into `out`. False, with `out`
    /// unchanged, if the scalar is not f64, a body has no root, `compute` fails, or a value is not finite.
    #[cold]
    pub fn recompute<T: Real>(
        model: &Model<T>,
        state: (&[T], &[T], &[T]),
        wrenches: &[Vector6<T>],
        out: &mut [T],
        compute: impl FnOnce(&mut Self, &mut [DoubleDouble]) -> bool,
    ) -> bool {
        let Some(mut wide) = Self::of(model, state, wrenches) else { return false };
        let mut found = vec![DoubleDouble::from_f64(f64::NAN); out.len()];
        if !compute(&mut wide, &mut found) || !found.iter().all(|x| x.high.is_finite()) {
            return false;
        }
        for (to, from) in out.iter_mut().zip(&found) {
            *to = T::from_f64(from.high);
        }
        true
    }
}
