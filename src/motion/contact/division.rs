//! Division of a step at the impacts in it, for contacts and joint stops that rebound.
//!
//! A part of the step passes the rows that rebound later in it without their impulses, and ends where the first of them
//! is at its surface or stop. The impact of the rows that touch is a short part of its own, and the parts after it
//! begin with the velocities after the impact. The length of a part is the root of the least gap at its end, to
//! rounding, so that it is smooth in the start of the step. Its derivative is that of an implicit function, with the
//! change of the time of the impact (saltation).
//!
//! The rules for contacts that rest and for slow rebounds are those of the whole step, so that the rebounds of a body
//! whose bounces die out end, and the number of parts is bounded: the last part is made as a whole, with all impacts at
//! its start.

use super::super::events::{StopImpact, largest};
use super::super::reversed_substeps::Substep;
use super::super::scratch::Scratch;
use super::super::step_settings::StepSettings;
use super::parts::{Division, Part};
use super::step::ContactStep;
use crate::error::Error;
use crate::scene::Scene;
use std::ops::RangeInclusive;

/// Largest number of parts of a step.
const MOST_PARTS: usize = 32;
/// Length of the part of an impact, relative to the step.
const IMPACT: f64 = 1e-6;
/// The least gap at the end of a part, m or rad, relative to the coordinates.
const LEAST: f64 = 1e-13;
/// Largest number of trials of a part.
const MOST_TRIALS: usize = 40;

/// Any least gap.
const ANY: RangeInclusive<f64> = f64::NEG_INFINITY..=f64::INFINITY;
/// The stored state of a contact that does not act.
const OPEN: f64 = 0.0;

/// Takes the length of the next part.
fn adopt(settings: &mut StepSettings, s: &mut Scratch<f64>, h: f64) {
    settings.adopt(h);
    s.adopt(settings, &settings.scheme);
}

impl ContactStep {
    /// One step from `q`, `v` to `q_next`, `v_next`; stores impulses and report in `kept`. Returns the joint and the
    /// error if it fails.
    pub fn step(
        &mut self,
        scene: &Scene,
        settings: &StepSettings,
        s: &mut Scratch<f64>,
        kept: &mut [f64],
    ) -> Result<(), (String, Error)> {
        // The gains are those of the state, and the length that of error control.
        if settings.gains.is_some() || settings.given.accuracy.is_some() {
            s.adopt(settings, &settings.scheme);
        }
        let divides = settings.free.is_some() && settings.given.accuracy.is_none() && settings.smoothing.is_none();
        self.division = Division { whole: settings.step, divides, ..Division::default() };
        let least = -LEAST * largest(&s.q, 1.0);
        if self.part((scene, settings), s, kept, &(least..=f64::INFINITY))? {
            return Ok(());
        }
        let start = (s.q.clone(), s.v.clone());
        let made = self.divided((scene, &mut settings.clone()), s, kept, least);
        std::mem::swap(&mut s.q, &mut s.q_next);
        std::mem::swap(&mut s.v, &mut s.v_next);
        (s.q, s.v) = start;
        s.adopt(settings, &settings.scheme);
        made
    }

    /// Repeats a part of a step, for other lengths too.
    pub fn repeat(
        &mut self,
        of: (&Scene, &StepSettings),
        s: &mut Scratch<f64>,
        part: &Part,
    ) -> Result<(), (String, Error)> {
        let Division { divides, struck, passing, .. } = &mut self.division;
        (*divides, *struck) = (false, part.struck);
        passing.clone_from(&part.passing);
        s.adopt(of.1, &of.1.scheme);
        self.part(of, s, &mut part.kept.clone(), &ANY).map(drop)
    }

    /// The parts of a step, the first of which cannot be the whole step, in place.
    fn divided(
        &mut self,
        (scene, settings): (&Scene, &mut StepSettings),
        s: &mut Scratch<f64>,
        kept: &mut [f64],
        least: f64,
    ) -> Result<(), (String, Error)> {
        let (n, mut left) = (scene.contact_points().len(), settings.step);
        let (mut sums, mut impacts) = (kept[..7 * n].to_vec(), Vec::new());
        sums[..3 * n].fill(0.0);
        sums[6 * n..].fill(OPEN);
        let mut hits = true;
        while left > 0.0 {
            let (begun, mut ended) = (kept.to_vec(), None);
            if self.division.struck.is_some() {
                adopt(settings, s, (IMPACT * self.division.whole).min(0.5 * left));
                self.part((scene, settings), s, kept, &ANY)?;
            } else if std::mem::take(&mut hits) || {
                adopt(settings, s, left);
                !self.part((scene, settings), s, kept, &(least..=f64::INFINITY))?
            } {
                self.until_impact((scene, &mut *settings), s, kept, (left, least))?;
                ended = self.division.lowest().0;
            }
            self.end_part((settings, s), (kept, begun), (&mut sums, &mut impacts), (self.division.whole - left, ended));
            left -= settings.step;
        }
        kept[..3 * n].copy_from_slice(&sums[..3 * n]);
        kept[6 * n..7 * n].copy_from_slice(&sums[6 * n..]);
        self.impacts = impacts;
        Ok(())
    }

    /// Makes the part up to the first impact on a row that it passes; a part of length `left` does not end there.
    fn until_impact(
        &mut self,
        (scene, settings): (&Scene, &mut StepSettings),
        s: &mut Scratch<f64>,
        kept: &mut [f64],
        (left, least): (f64, f64),
    ) -> Result<(), (String, Error)> {
        self.rows.place(&s.model, scene.contact_points(), &s.q);
        let gap = self.division.passing.iter().fold(f64::INFINITY, |low, &i| low.min(self.rows.gaps[i]));
        // The Illinois algorithm.
        let (mut low, mut high, mut side) = ((0.0, gap), (left, self.division.lowest().1), 0);
        for _ in 0..MOST_TRIALS {
            adopt(settings, s, (low.0 * high.1 - high.0 * low.1) / (high.1 - low.1));
            if self.part((scene, settings), s, kept, &(least..=-least))? {
                return Ok(());
            }
            let (length, gap) = (settings.step, self.division.lowest().1);
            if gap > 0.0 {
                high.1 *= if side > 0 { 0.5 } else { 1.0 };
                (low, side) = ((length, gap), 1);
            } else {
                low.1 *= if side < 0 { 0.5 } else { 1.0 };
                (high, side) = ((length, gap), -1);
            }
        }
        self.part((scene, settings), s, kept, &ANY).map(drop)
    }

    /// Ends a part: stores it, adds its impulses, states and impacts, and begins the next one at its end.
    fn end_part(
        &mut self,
        (settings, s): (&StepSettings, &mut Scratch<f64>),
        (kept, begun): (&[f64], Vec<f64>),
        (sums, impacts): (&mut [f64], &mut Vec<StopImpact>),
        (time, ended): (f64, Option<usize>),
    ) {
        let n = sums.len() / 7;
        sums[..3 * n].iter_mut().zip(kept).for_each(|(sum, force)| *sum += force);
        for (state, &now) in sums[6 * n..].iter_mut().zip(&kept[6 * n..]).filter(|(_, now)| **now != OPEN) {
            *state = now;
        }
        impacts.extend(self.impacts.drain(..).map(|of| StopImpact { time: of.time + time, ..of }));
        let Division { divides, struck, passing, parts, .. } = &mut self.division;
        let part = Part { passing: std::mem::take(passing), struck: *struck, kept: begun, ended };
        parts.push((Substep::new(settings, &settings.scheme, s, None), part));
        (*struck, *divides) = (ended, parts.len() + 1 < MOST_PARTS);
        std::mem::swap(&mut s.q, &mut s.q_next);
        std::mem::swap(&mut s.v, &mut s.v_next);
    }
}
