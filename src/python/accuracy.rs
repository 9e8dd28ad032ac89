//! Accuracy of forward dynamics for Python: the form and the estimated error of each state.

use super::object::{Object, imported};
use crate::accuracy::Accuracy;
use crate::algorithm::Arguments;
use crate::batch::Fault;
use crate::batch::evaluator::Evaluator;
use crate::error::Error;
use crate::filter::Form;
use crate::memory;
use crate::scalar::MOST_LANES;
use crate::scene::Scene;
use numpy::IntoPyArray;
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};

/// Accuracy of every state of a call, written by all of its threads.
pub(super) struct BatchAccuracy {
    form: Form,
    of_states: Mutex<Vec<Accuracy>>,
}

impl BatchAccuracy {
    /// Allocates the entries of `states` states.
    pub fn new(form: Form, states: usize) -> Result<Self, Error> {
        let of_states = memory::filled("return_info", states, Accuracy::unknown(form))?;
        Ok(Self { form, of_states: Mutex::new(of_states) })
    }

    /// Evaluates neighboring states from index `first` of the batch on, and stores their accuracy.
    pub fn evaluate(
        &self,
        scene: &Scene,
        evaluator: &mut Evaluator,
        states: &[Arguments<'_>],
        first: usize,
        out: &mut [f64],
    ) -> Result<(), Fault> {
        let mut found = [Accuracy::unknown(self.form); MOST_LANES];
        let found = &mut found[..states.len()];
        let outcome = scene.evaluate_with_accuracy(evaluator, self.form, states, out, found);
        let mut of_states = self.of_states.lock().unwrap_or_else(PoisonError::into_inner);
        of_states[first..first + found.len()].copy_from_slice(found);
        outcome
    }

    /// Creates the `Accuracy` of a batch with these leading axes.
    pub fn finish<'py>(self, py: Python<'py>, batch: &[usize]) -> PyResult<Object<'py>> {
        let of_states = self.of_states.into_inner().unwrap_or_else(PoisonError::into_inner);
        let class = imported!(py, "phipsi._results", "Accuracy")?;
        if let ([], [one]) = (batch, &*of_states) {
            return class.call1((one.name(), one.error, one.bound.name()));
        }
        // The names of forms and bounds, the lists from which NumPy reads them, and the errors.
        memory::room("return_info", memory::bytes_of::<[u64; 9]>(&[of_states.len()]))?;
        let names: Vec<&str> = of_states.iter().map(Accuracy::name).collect();
        let bounds: Vec<&str> = of_states.iter().map(|accuracy| accuracy.bound.name()).collect();
        let errors: Vec<f64> = of_states.iter().map(|accuracy| accuracy.error).collect();
        let shape = batch.to_vec();
        // The dtype has the width of the longest name, whether or not a state has that form.
        let in_batch = |names: Vec<&str>, width: &str| {
            py.import("numpy")?.call_method1("array", (names, width))?.call_method1("reshape", (shape.clone(),))
        };
        let (form, bound) = (in_batch(names, "U13")?, in_batch(bounds, "U11")?);
        let error = errors.into_pyarray(py).call_method1("reshape", (shape.clone(),))?;
        class.call1((form, error, bound))
    }
}
