//! The parts of a step that is divided at its impacts, and the rows that a part passes without their impulses.

use super::super::reversed_substeps::Substep;
use super::gap::touching_gap;
use crate::model::Model;
use nalgebra::DVector;
use std::ops::RangeInclusive;

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
    pub fn pass(&mut self, near: &mut Vec<usize>, gaps: &[f64], restitution: impl Fn(usize) -> f64) {
        let divides = self.divides && self.struck.is_none();
        near.retain(|&i| {
            if divides && gaps[i] > AT_SURFACE && restitution(i) > 0.0 && !self.passing.contains(&i) {
                self.passing.push(i);
            }
            !self.passing.contains(&i)
        });
    }

    /// True if a contact rests at its surface, for the rules of the whole step.
    pub fn rests(&self, model: &Model<f64>, gaps: &[f64], start: &DVector<f64>) -> bool {
        let least = touching_gap(model, self.whole);
        gaps.iter().enumerate().any(|(i, &gap)| gap <= least && self.whole * start[3 * i + 2].abs() <= least)
    }

    /// Stores the gaps at the end of the part, of all rows. Returns true if the least one is accepted.
    pub fn end(&mut self, gaps: &[f64], accepted: &RangeInclusive<f64>) -> bool {
        self.ends = self.passing.iter().map(|&i| gaps[i]).collect();
        self.passing.is_empty() || accepted.contains(&self.lowest().1)
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
