//! Backpropagation through the substeps of a step of one state.

use super::backward::StepGradients;
use super::drives::pieces;
use super::events::{Event, EventSolution, Rebound, Reversal};
use super::method::Scheme;
use super::scratch::{Scratch, add_scaled};
use super::step_settings::StepSettings;
use super::stops::Piece;
use crate::error::Error;

/// The scratch memory and the gradients of one state.
pub(super) trait Parts {
    fn parts(&mut self) -> (&mut Scratch<f64>, &mut StepGradients<f64>);
}

/// Propagates the gradients through the substeps of a step, from the last to the first, each by `through`.
pub(super) fn through_substeps<O: Parts>(
    one: &mut O,
    settings: &StepSettings,
    made: Vec<Substep>,
    mut through: impl FnMut(&mut O, Substep) -> Result<(), (String, Error)>,
) -> Result<(), (String, Error)> {
    let mut sums: Option<Vec<Vec<f64>>> = None;
    for mut substep in made.into_iter().rev() {
        let (scratch, _) = one.parts();
        std::mem::swap(&mut scratch.q, &mut substep.q);
        std::mem::swap(&mut scratch.v, &mut substep.v);
        scratch.adopt(settings, &substep.scheme);
        through(one, substep)?;
        let (_, gradients) = one.parts();
        let StepGradients { start, end, .. } = &mut *gradients;
        std::mem::swap(start, end);
        let acting = gradients.results().skip(2);
        match &mut sums {
            None => sums = Some(acting.map(|numbers| numbers.to_vec()).collect()),
            Some(sums) => sums.iter_mut().zip(acting).for_each(|(sum, more)| add_scaled(sum, 1.0, more)),
        }
    }
    let (_, gradients) = one.parts();
    let StepGradients { start, end, .. } = &mut *gradients;
    std::mem::swap(start, end);
    for (numbers, sum) in gradients.results().skip(2).zip(sums.into_iter().flatten()) {
        numbers.copy_from_slice(&sum);
    }
    Ok(())
}

/// A substep of the step forward.
pub(super) struct Substep {
    q: Vec<f64>,
    v: Vec<f64>,
    pub scheme: Scheme,
    /// The pieces of the control laws, if they are not those of its start.
    pub pieces: Vec<Piece>,
    pub event: Option<RecordedEvent>,
}

/// An event, with the rows that end at a stop.
pub(super) struct RecordedEvent {
    pub solutions: Vec<EventSolution>,
    pub reached: Vec<usize>,
    pub rebound: Option<Rebound>,
    pub reversals: Vec<Reversal>,
}

impl Substep {
    pub fn new(settings: &StepSettings, scheme: &Scheme, s: &Scratch<f64>, event: Option<&Event<'_>>) -> Self {
        let event = event.map(|event| RecordedEvent {
            solutions: event.solutions.to_vec(),
            reached: event.reached.iter().map(|&(i, _)| settings.set_valued[i].row).collect(),
            rebound: event.rebound.cloned(),
            reversals: event.reversals.to_vec(),
        });
        let pieces = if settings.given.accuracy.is_none() { pieces(settings, s) } else { Vec::new() };
        Self { q: s.q.clone(), v: s.v.clone(), scheme: *scheme, pieces, event }
    }
}
