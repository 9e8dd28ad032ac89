//! Kinematic quantities, for one state per lane of a scalar.

use super::instruction_set::Vectorized;
use super::own_model::{InertiaPlaces, OwnBodies};
use crate::algorithm::{Arguments, KinematicQuantity};
use crate::dynamics::quantities::{of_all_bodies, of_frame};
use crate::model::Model;
use crate::scalar::MOST_LANES;
use crate::workspace::Workspace;

/// Scratch of the quantities of all bodies and the models of states, allocated by the first call that needs them, and
/// results.
#[derive(Debug)]
pub(super) struct QuantityKernel<T: Vectorized> {
    workspace: Option<Box<Workspace<T>>>,
    own: Option<Box<OwnBodies<T>>>,
    results: Vec<T>,
}

impl<T: Vectorized> Default for QuantityKernel<T> {
    fn default() -> Self {
        Self { workspace: None, own: None, results: Vec::new() }
    }
}

/// Computes a quantity of states (q, qd, qdd), of which it reads the part that `what` requires, with the models of
/// `given` or that of the scene. Returns zero in the lanes whose models are valid, else NaN, and the results.
#[inline(always)]
pub(super) fn run<'k, T: Vectorized>(
    (mut model, places): (&Model<T>, &InertiaPlaces),
    kernel: &'k mut QuantityKernel<T>,
    what: &KinematicQuantity<'_>,
    state: (&[T], &[T], &[T]),
    given: Option<&[&Arguments<'_>; MOST_LANES]>,
) -> (T, &'k [T]) {
    let (QuantityKernel { workspace, own, results }, mut fault) = (kernel, T::zero());
    if let Some(states) = given {
        let own = own.get_or_insert_with(|| Box::new(OwnBodies::new(places, model)));
        fault = own.load(model, states);
        model = &own.model;
    }
    results.resize(what.width(model.nv()), T::zero());
    if !of_frame(model, what, state, results) {
        let workspace = workspace.get_or_insert_with(|| Box::new(Workspace::new(model)));
        of_all_bodies(model, workspace, what, state, results);
    }
    (fault, results)
}
