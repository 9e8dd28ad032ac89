//! Forward dynamics of many states, each with the form that computed it and its estimated error.

use super::Fault;
use super::evaluator::Evaluator;
use crate::accuracy::Accuracy;
use crate::algorithm::{Algorithm, Arguments};
use crate::error::check_length;
use crate::filter::Form;
use crate::scene::Scene;

impl Scene {
    /// Joint accelerations with the same bits as [`Scene::evaluate`] with [`Algorithm::ForwardDynamics`], and the
    /// accuracy of each state.
    ///
    /// In form `auto` the estimate is part of the computation. The forms `covariance` and `square-root` also run the
    /// general recursion, which takes about five times as long.
    ///
    /// # Errors
    ///
    /// As [`Scene::evaluate`], and [`Error::Shape`](crate::Error::Shape) if the number of entries differs from the
    /// number of states.
    pub fn evaluate_with_accuracy(
        &self,
        evaluator: &mut Evaluator,
        form: Form,
        states: &[Arguments<'_>],
        out: &mut [f64],
        accuracy: &mut [Accuracy],
    ) -> Result<(), Fault> {
        check_length("accuracy", accuracy.len(), states.len()).map_err(|error| Fault { state: 0, error })?;
        if form == Form::Auto {
            let auto = Algorithm::ForwardDynamics(form);
            evaluator.independent.checked.workspace.estimates_error = true;
            let outcome = self.evaluate_each(evaluator, auto, states, out, |state, found| accuracy[state] = found());
            evaluator.independent.checked.workspace.estimates_error = false;
            return outcome;
        }
        self.evaluate(evaluator, Algorithm::ForwardDynamics(form), states, out)?;
        accuracy.fill(Accuracy::unknown(form));
        // The general recursion estimates the error of these forms. Its results are equally accurate, but differ in the
        // last bits.
        let mut again = vec![f64::NAN; self.nv()];
        let checked = &mut evaluator.independent.checked;
        checked.workspace.estimates_error = true;
        let outcome = states.iter().zip(accuracy).enumerate().try_for_each(|(i, (state, accuracy))| {
            crate::interrupt::check().map_err(|error| Fault { state: i, error })?;
            if self.evaluate_checked(checked, Algorithm::ForwardDynamics(form), state, &mut again).is_ok() {
                *accuracy = checked.workspace.accuracy;
            }
            Ok(())
        });
        checked.workspace.estimates_error = false;
        outcome
    }
}
