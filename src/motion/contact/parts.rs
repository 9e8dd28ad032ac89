//! The parts of a step that is divided at its impacts, and the rows that a part passes without their impulses.

use super::super::reversed_substeps::Substep;

/// A row is at its surface up to this gap, m or rad.
const AT_SURFACE: f64 = 1e-12;

/// A part of a step, as its adjoint repeats it.
pub(super) struct Part {
    pub passing: Vec<usize>,
    pub struck: Option<usize>,
    pub kept: Vec<f64>,
    /// The row whose impact follows.
    pub ended: Option<usize>,
}

/// The division of the current step.
#[derive(Default)]
pub(super) struct Division {
    /// Length of the whole step, s.
    pub whole: f64,
    pub divides: bool,
    /// Steps without impulses are those of a flight: the displacement is that of the mean velocities.
    pub flies: bool,
    /// The row whose impact begins this part.
    pub struck: Option<usize>,
    /// The rows that this part passes, and their gaps at its end.
    pub passing: Vec<usize>,
    pub ends: Vec<f64>,
    /// The parts of the last step; none if it is whole.
    pub parts: Vec<(Substep, Part)>,
}

impl Division {
    /// Moves the rows of `near` that this part passes, and those with a gap that rebound, to `passing`.
    pub fn pass(
        &self,
        (passing, near): (&mut Vec<usize>, &mut Vec<usize>),
        gaps: &[f64],
        restitution: impl Fn(usize) -> f64,
    ) {
        near.retain(|&i| {
            let rebounds = || self.divides && self.struck.is_none() && gaps[i] > AT_SURFACE && restitution(i) > 0.0;
            let known = passing.contains(&i);
            let passes = known || rebounds();
            if passes && !known {
                passing.push(i);
            }
            !passes
        });
    }

    /// The gap of a row at the end of the part, if the part passes it.
    pub fn end_of(&self, row: usize) -> f64 {
        self.passing.iter().zip(&self.ends).find(|(i, _)| **i == row).map_or(f64::NAN, |(_, &gap)| gap)
    }

    /// The row with the least gap at the end of the part, and this gap.
    pub fn lowest(&self) -> (Option<usize>, f64) {
        let each = self.passing.iter().zip(&self.ends);
        each.fold((None, f64::INFINITY), |low, (&i, &gap)| if gap < low.1 { (Some(i), gap) } else { low })
    }
}
