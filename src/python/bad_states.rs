//! The argument `errors`: whether an invalid state raises, or its results become NaN.

use super::choice::choose;
use super::errors::{batch_index, classes, fault};
use crate::batch::Fault;
use crate::error::Error;
use crate::memory;
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use std::sync::{Mutex, PoisonError};

/// Largest number of reasons in the text of the warning.
const TOLD: usize = 3;

/// Treatment of the faults of states.
#[derive(Default)]
pub(super) enum Errors {
    /// The fault of the lowest state raises.
    #[default]
    Raise,
    /// The faults of all threads are collected.
    Nan(Mutex<Vec<Fault>>),
}

/// True if the value of the argument selects NaN.
pub(super) fn is_nan(errors: &str) -> Result<bool, Error> {
    choose("errors", errors, &[("raise", false), ("nan", true)])
}

impl Errors {
    /// Reads the argument.
    pub fn read(errors: &str) -> Result<Self, Error> {
        Ok(if is_nan(errors)? { Self::Nan(Mutex::default()) } else { Self::Raise })
    }

    /// True if the results of invalid states become NaN.
    pub fn are_gathered(&self) -> bool {
        matches!(self, Self::Nan(_))
    }

    /// Collects a fault, or returns it to be raised. Interrupts and allocation failures are always raised, because they
    /// do not belong to a state.
    pub fn note(&self, fault: Fault) -> Result<(), Fault> {
        match (self, &fault.error) {
            (Self::Raise, _) | (_, Error::Interrupted | Error::Memory { .. }) => Err(fault),
            (Self::Nan(faults), _) => {
                let mut faults = faults.lock().unwrap_or_else(PoisonError::into_inner);
                if faults.try_reserve(1).is_err() {
                    let bytes = memory::bytes_of::<Fault>(&[2, faults.len()]);
                    return Err(Fault { state: fault.state, error: Error::memory("errors", bytes, None) });
                }
                faults.push(fault);
                Ok(())
            }
        }
    }

    /// Issues one warning for the collected faults, at the line of the caller.
    pub fn warn(&self, py: Python<'_>, batch: &[usize]) -> PyResult<()> {
        let Self::Nan(faults) = self else { return Ok(()) };
        let mut faults = std::mem::take(&mut *faults.lock().unwrap_or_else(PoisonError::into_inner));
        if faults.is_empty() {
            return Ok(());
        }
        // The sort is stable: of several faults of one state, the first one found remains.
        faults.sort_by_key(|fault| fault.state);
        faults.dedup_by_key(|fault| fault.state);
        let bad = faults.len();
        let (mut states, mut reasons) = (Vec::with_capacity(bad), Vec::with_capacity(bad));
        for found in faults {
            let index =
                if batch.is_empty() { PyTuple::empty(py).into_any() } else { batch_index(py, found.state, batch)? };
            states.push(index);
            reasons.push(fault(py, found, batch).into_value(py));
        }
        let told: Vec<String> = reasons.iter().take(TOLD).map(|reason| reason.bind(py).to_string()).collect();
        let more = if bad > TOLD { "; ..." } else { "" };
        let total: usize = batch.iter().product();
        let text = format!(
            "{bad} of {total} states could not be computed and {} NaN: {}{more} \
             (.states and .reasons of this warning list all)",
            if bad == 1 { "is" } else { "are" },
            told.join("; ")
        );
        let classes = classes(py)?;
        let warning = classes.getattr("BadStateWarning")?.call1((text,))?;
        warning.setattr("states", PyTuple::new(py, states)?)?;
        warning.setattr("reasons", PyTuple::new(py, reasons)?)?;
        classes.getattr("warn")?.call1((warning,)).map(drop)
    }
}
