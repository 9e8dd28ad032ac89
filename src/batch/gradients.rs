//! Gradients of torques or of accelerations, for one state per lane of a scalar.

use super::instruction_set::{Target, Vectorized, within_target};
use crate::dynamics::derivatives::{CoStates, Constants, gradients_in_sweeps};
use crate::dynamics::forces::Motion;
use crate::dynamics::sweeps::{SweepModel, SweepScratch};
use crate::filter::Form;
use crate::model::Model;

/// A scene, and the scratch of gradients.
type Room<'a, T> = ((&'a Model<T>, &'a SweepModel<T>), (&'a mut SweepScratch<T>, &'a mut CoStates<T>));

/// All cotangents of a state: of torques, or of accelerations if a form is given, with the factor in the scratch.
/// Returns the lanes that need the fallback as bits. Compiled once for batches and for trajectories.
#[inline(never)]
pub(crate) fn gradients<T: Vectorized, I: Target>(
    target: I,
    form: Option<Form>,
    room: Room<'_, T>,
    state: (Motion<'_, T>, &[T]),
    (constants, x, out): (&mut Constants<'_, T>, &mut [T], &mut [T]),
) -> u64 {
    let off = all_gradients(target, form.is_some(), room, state, (constants, x, out));
    if form == Some(Form::Auto) { (0..T::LANES).map(|lane| u64::from(off.lane(lane) > 0.0) << lane).sum() } else { 0 }
}

within_target! {
    #[inline(always)]
    fn all_gradients<'a, 'c, T>(
        solves: bool,
        room: Room<'a, T>,
        state: (Motion<'a, T>, &'a [T]),
        results: (&'a mut Constants<'c, T>, &'a mut [T], &'a mut [T]),
    ) -> T {
        gradients_in_sweeps::<T, T::Columns>(room.0, room.1, state, solves, results)
    }
}
