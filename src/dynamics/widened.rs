//! A state with twice the digits, for answers that lost theirs.

use crate::filter::Form;
use crate::model::Model;
use crate::scalar::{DoubleDouble, Real};
use crate::workspace::Workspace;
use nalgebra::Vector6;
use std::any::Any;

/// A model and a state in double-double arithmetic, with a workspace in square-root form.
pub(super) struct Widened {
    pub model: Model<DoubleDouble>,
    pub workspace: Workspace<DoubleDouble>,
    pub q: Vec<DoubleDouble>,
    pub qd: Vec<DoubleDouble>,
    pub tau: Vec<DoubleDouble>,
    pub wrenches: Vec<Vector6<DoubleDouble>>,
}

impl Widened {
    /// None where there is no model to widen (only f64 has one), or a body's inertia has no root.
    pub fn of<T: Real>(model: &Model<T>, state: (&[T], &[T], &[T]), wrenches: &[Vector6<T>]) -> Option<Self> {
        // Numbers that hold more than a value, such as dual ones, would come back without the rest.
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
}
