//! Kinematic quantities, for one state per lane of a scalar.

use super::instruction_set::Vectorized;
use crate::algorithm::KinematicQuantity;
use crate::dynamics::quantities::{of_all_bodies, of_frame};
use crate::model::Model;
use crate::workspace::Workspace;

/// Scratch of the quantities of all bodies, allocated by the first call that needs it, and results.
#[derive(Debug)]
pub(super) struct QuantityKernel<T: Vectorized> {
    workspace: Option<Box<Workspace<T>>>,
    results: Vec<T>,
}

impl<T: Vectorized> Default for QuantityKernel<T> {
    fn default() -> Self {
        Self { workspace: None, results: Vec::new() }
    }
}

/// Computes a quantity of states (q, qd, qdd), of which it reads the part that `what` requires.
#[inline(always)]
pub(super) fn run<'k, T: Vectorized>(
    model: &Model<T>,
    kernel: &'k mut QuantityKernel<T>,
    what: &KinematicQuantity<'_>,
    state: (&[T], &[T], &[T]),
) -> &'k [T] {
    let QuantityKernel { workspace, results } = kernel;
    results.resize(what.width(model.nv()), T::zero());
    if !of_frame(model, what, state, results) {
        let workspace = workspace.get_or_insert_with(|| Box::new(Workspace::new(model)));
        of_all_bodies(model, workspace, what, state, results);
    }
    results
}
