//! One step of one state with contacts.

use super::super::checked::CheckedState;
use super::super::drives::{LINEAR, contradictions, give, pieces};
use super::super::events::StopImpact;
use super::super::faults::fault_of;
use super::super::limit_rows::{is_violent, least_velocity, limit_rows, rebounds, settle_at};
use super::super::manifold::displacement;
use super::super::scratch::{Scratch, take_lane};
use super::super::solver::Checked;
use super::super::step::step;
use super::super::step_settings::StepSettings;
use super::super::stops::Piece;
use super::super::totals::{STOPS, UNSETTLED, note_dropped};
use super::super::works::add_work;
use super::closed::{eliminated, onto_connections};
use super::faults::{REFUSED, check, check_movable, check_normals, factorised, held_still};
use super::free_axes::{move_along, to_axes_at_end, to_axes_at_rest};
use super::moves::Pulled;
use super::pairs::{from_fixed_axes, into_fixed_axes};
use super::parts::Division;
use super::project::{onto_surfaces, out_of_planes};
use super::record::{Laws, Outcome, StepRecord, StepStart};
use super::report::ContactReport;
use crate::batch::instruction_set::Baseline;
use crate::contact::{Cones, ContactState, Effort, Impact, Limits, SolveReport, impact, passive};
use crate::dynamics::contacts::ContactScratch;
use crate::error::Error;
use crate::filter::Form;
use crate::model::Model;
use crate::scalar::Real;
use crate::scene::Scene;
use crate::scene::contact_point::ContactPoint;
use nalgebra::DVector;
use std::ops::RangeInclusive;

/// A contact that leaves or approaches its surface at most at this multiple of the accuracy, m/s, rests on it.
pub(super) const RESTS: f64 = 10.0;

/// An inactive contact becomes active if the step ends with a larger penetration, m.
pub(super) const LATE: f64 = 1e-12;

/// The stop of a joint outside of its limits takes part in a contradiction if its impulse is larger than this, relative
/// to the largest: contradicting demands have unbounded impulses.
const TAKES_PART: f64 = 1e-6;

/// A contact up to this gap takes part in an impact, and if both of its bodies move in any step, m.
const TOUCHING: f64 = 1e-9;

/// Rounding errors of impulses relative to the largest, and of their work relative to impulse times velocity.
const ROUNDING: f64 = 1e-9;

/// Number of changes of all contradicted pieces of control laws together, and the largest number of changes of single
/// ones.
const BLOCK_ROUNDS: usize = 4;
const MOST_ROUNDS: usize = 200;

/// Scratch memory for one state.
pub(super) struct ContactStep {
    pub solver: Checked,
    pub rows: ContactScratch,
    /// Impacts of joints on stops in the last step.
    pub impacts: Vec<StopImpact>,
    /// The last step, if its adjoint follows.
    pub record: Option<StepRecord>,
    /// The largest acceleration of a joint without contacts in the last step, and whether friction changed its
    /// direction.
    pub acceleration: f64,
    pub reverses: bool,
    pub division: Division,
    /// The steps of the tree, for parts in which no contact acts.
    flight: Option<Box<CheckedState>>,
    form: Form,
    /// The control laws whose pieces the last step contradicts, with the pieces to which they must change.
    contradicted: Vec<(usize, Piece)>,
    /// The control laws that this step leaves at a limit.
    frozen: Vec<usize>,
}

/// An attempt to make a part without contact forces.
enum Flight {
    /// It was made; false if its end is not accepted.
    Made(bool),
    /// A contact acts; with the velocities J v at the start if the contacts are placed there.
    None(Option<DVector<f64>>),
}

impl ContactStep {
    pub fn new(scene: &Scene, settings: &StepSettings, form: Form) -> Self {
        let limits = if settings.stops() { limit_rows(scene) } else { Vec::new() };
        let mut rows = ContactScratch::new(scene.model(), scene.contact_points(), limits);
        rows.closed = eliminated(scene, settings);
        // The equations of motion are those of the tree; coupled joints are rows of the step.
        let solver = Checked::new(scene.model(), None, form).accepting(settings.given.tolerance);
        let (impacts, division) = (Vec::new(), Division::default());
        let (contradicted, frozen) = (Vec::new(), Vec::new());
        let (record, acceleration, reverses, flight) = (None, 0.0, false, None);
        Self { solver, rows, impacts, record, acceleration, reverses, division, flight, form, contradicted, frozen }
    }

    /// A step, or a part of it, from `q`, `v` to `q_next`, `v_next`; stores impulses and report in `kept`. Returns the
    /// joint and the error if it fails, and false, without an effect, if the least gap at the end of the rows that the
    /// part passes is not `accepted`. It is repeated until the pieces of the control laws with limits agree with its
    /// end, first with all that contradict it changed together, then one after another; a joint on no piece stays at
    /// its limit.
    pub fn part(
        &mut self,
        (scene, settings): (&Scene, &StepSettings),
        s: &mut Scratch<f64>,
        kept: &mut [f64],
        accepted: &RangeInclusive<f64>,
    ) -> Result<bool, (String, Error)> {
        s.are_sides_given = false;
        let start = match self.fly((scene, settings), s, kept, accepted) {
            Flight::Made(made) => return Ok(made),
            Flight::None(start) => start,
        };
        if settings.limited.is_empty() {
            return self.on_pieces((scene, settings), s, kept, (accepted, start));
        }
        let (totals, passing) = (s.totals, self.division.passing.clone());
        self.frozen.clear();
        let mut outcome = self.on_pieces((scene, settings), s, kept, (accepted, start));
        let (mut pieces, mut at, mut before) = (pieces(settings, s), 0, None);
        for round in 0.. {
            let found = std::mem::take(&mut self.contradicted);
            let next = found.iter().find(|(i, _)| *i >= at).or(found.first());
            let Some(&(i, piece)) = next.filter(|_| outcome.is_ok()) else { break };
            if round < BLOCK_ROUNDS {
                for &(i, piece) in &found {
                    pieces[i] = piece;
                }
            } else if before == Some((i, piece)) || round > MOST_ROUNDS {
                // Contacts can make the law of a joint ambiguous, or leave it without a solution in this step.
                pieces[i] = if piece == LINEAR { pieces[i] } else { piece };
                self.frozen.push(i);
            } else {
                (at, before) = (i, Some((i, pieces[i])));
                pieces[i] = piece;
            }
            give(settings, s, &pieces);
            s.totals = totals;
            self.division.passing.clone_from(&passing);
            outcome = self.on_pieces((scene, settings), s, kept, (accepted, None));
        }
        s.totals[UNSETTLED] += f64::from(u8::from(!self.frozen.is_empty()));
        outcome
    }

    /// A part in which no contact acts, and none rests at its start: a step of the tree, by its method.
    fn fly(
        &mut self,
        (scene, settings): (&Scene, &StepSettings),
        s: &mut Scratch<f64>,
        kept: &mut [f64],
        accepted: &RangeInclusive<f64>,
    ) -> Flight {
        let Self { rows, division, flight, record, .. } = self;
        let is_flight = settings.given.accuracy.is_none() && division.struck.is_none();
        let Some(free) = settings.free.as_ref().filter(|_| is_flight) else { return Flight::None(None) };
        let points = scene.contact_points();
        rows.place(&s.model, points, &s.q);
        let start = rows.velocities(&s.model, points, &s.v);
        let gaps = rows.gaps.clone();
        let opens = |i: usize| gaps[i] > TOUCHING || start[3 * i + 2] > 0.0;
        if division.rests(&s.model, &gaps[..points.len()], &start) || !(0..points.len()).all(opens) {
            return Flight::None(Some(start));
        }
        let flight = flight.get_or_insert_with(|| Box::new(CheckedState::new(scene, free, self.form)));
        take_lane(&mut flight.scratch, s, 0);
        if flight.step(scene, free, &mut |_, _, _| ()).is_err() {
            return Flight::None(None);
        }
        // A tip can pass a surface and return.
        let straight = rows.velocities(&s.model, points, &displacement(&s.model, &s.q, &flight.scratch.q_next));
        rows.place(&s.model, points, &flight.scratch.q_next);
        let before = division.passing.clone();
        let mut acting =
            (0..points.len()).filter(|&i| !(rows.gaps[i].min(gaps[i] + straight[3 * i + 2]) >= -LATE)).collect();
        let rest_speed = rest_speed(&s.model, division.whole, None);
        division.pass(&mut acting, &gaps, |i| bounce(&points[i], start[3 * i + 2], rest_speed));
        if !acting.is_empty() {
            division.passing = before;
            return Flight::None(None);
        }
        if !division.end(&rows.gaps, accepted) {
            return Flight::Made(false);
        }
        s.q_next.copy_from_slice(&flight.scratch.q_next);
        s.v_next.copy_from_slice(&flight.scratch.v_next);
        s.totals = flight.scratch.totals;
        self.impacts.clone_from(&flight.substeps.impacts);
        self.reverses = false;
        if record.is_some() {
            let before = StepStart { gaps, start, ..StepStart::default() };
            *record = Some(StepRecord { flies: true, moving: s.v_next.clone(), before, ..StepRecord::default() });
        }
        keep(kept, &Outcome::default(), points.len());
        Flight::Made(true)
    }

    /// As [`ContactStep::part`], for given pieces. Stops, without an effect on `kept`, if its end contradicts them.
    /// `placed`: the velocities J v at the start, if the contacts are placed there.
    fn on_pieces(
        &mut self,
        (scene, settings): (&Scene, &StepSettings),
        s: &mut Scratch<f64>,
        kept: &mut [f64],
        (accepted, placed): (&RangeInclusive<f64>, Option<DVector<f64>>),
    ) -> Result<bool, (String, Error)> {
        self.contradicted.clear();
        step(Baseline, (settings, &settings.scheme), s, &mut self.solver);
        let lost = self.solver.lost.take();
        if let Some(fault) = fault_of(scene, settings, s, lost) {
            return Err(fault);
        }
        let (h, points) = (settings.step, scene.contact_points());
        self.acceleration = s.v_next.iter().zip(&s.v).fold(0.0, |most, (next, v)| (next - v).abs().max(most)) / h;
        to_axes_at_rest(&s.model, h, &s.v, &mut s.v_next);
        let mut pulls = self.record.is_some().then(<[Pulled; 2]>::default);
        let at_start = (&s.model, &mut self.solver.workspace);
        let [free, end] = pulls.as_mut().map_or([None, None], |pulls| pulls.each_mut().map(Some));
        onto_connections(scene, at_start, &mut self.rows, (&s.q, &mut s.v_next), free)?;
        let start = placed.unwrap_or_else(|| {
            self.rows.place(&s.model, points, &s.q);
            self.rows.velocities(&s.model, points, &s.v)
        });
        check_normals(scene, &self.rows.gaps)?;
        let free = self.rows.velocities(&s.model, points, &s.v_next);
        let before = StepStart { gaps: self.rows.gaps.clone(), axes: self.rows.axes.clone(), start, free };
        let v_free = self.record.is_some().then(|| s.v_next.clone());
        let smoothing = settings.smoothing.as_ref();
        let mut outcome = match smoothing {
            Some(smoothing) => self.touch_smoothed((scene, settings, smoothing), s, &before, kept)?,
            None => self.touch(scene, settings, s, &before, kept)?,
        };
        self.reverses = outcome.reverses;
        self.record = v_free.map(|v_free| StepRecord::new(v_free, &s.v_next, &before, &mut outcome));
        contradictions((settings, &settings.scheme), (s, &s.v_next), &mut self.contradicted);
        self.contradicted.retain(|(i, _)| !self.frozen.contains(i));
        if !self.contradicted.is_empty() {
            return Ok(false);
        }
        move_along(h, s);
        if let Some(slowed) = outcome.slowed.take() {
            s.v_next = slowed;
        }
        if !self.division.passing.is_empty() {
            self.rows.place(&s.model, points, &s.q_next);
            if !self.division.end(&self.rows.gaps, accepted) {
                return Ok(false);
            }
        }
        add_work(settings, s);
        let (depth, iterations) = if let Some(smoothing) = smoothing {
            let (depth, hover) = self.end_smoothed((scene, settings, smoothing), s, &outcome.held)?;
            outcome.report.hover = hover;
            (depth, 0)
        } else {
            let workspace = &mut self.solver.workspace;
            if settings.given.accuracy.is_some() {
                // The error is then smooth in the length of the step.
                let held = outcome
                    .near
                    .iter()
                    .enumerate()
                    .filter(|(at, i)| **i < points.len() && outcome.held[3 * at + 2] > 0.0);
                let held: Vec<usize> = held.map(|(_, &i)| i).collect();
                onto_surfaces((scene, &s.model), workspace, &mut self.rows, (&mut s.q_next, &mut s.q_stage), &held)?;
            }
            let ends = (&mut s.q_next[..], &mut s.q_stage[..]);
            let moves = self.record.as_mut().map(|record| &mut record.moves);
            out_of_planes((scene, &s.model), workspace, &mut self.rows, ends, (moves, &self.division.passing))?
        };
        let workspace = &mut self.solver.workspace;
        to_axes_at_end(&s.model, (&s.q, &s.q_next), &mut s.v_next);
        if self.rows.closed.is_some() {
            // The implicit terms of the step are not part of the kinetic energy.
            let noise = std::mem::replace(&mut s.model.system.noise, settings.properties.armature.clone());
            let ends = (&s.q_next[..], &mut s.v_next[..]);
            let projected = onto_connections(scene, (&s.model, workspace), &mut self.rows, ends, end);
            s.model.system.noise = noise;
            projected?;
        }
        if let (Some(record), Some([free, end])) = (&mut self.record, pulls) {
            (record.free, record.end) = (free, end);
        }
        self.settle(settings, s, &before, &outcome, points.len());
        let impulses = outcome.hit.as_mut().map(|hit| &mut hit.impulses).into_iter().chain([&mut outcome.held]);
        into_fixed_axes(points, (&before.axes, &outcome.near), impulses);
        keep(kept, &outcome, points.len());
        #[allow(clippy::cast_precision_loss)] // a small count
        let iterations = outcome.report.iterations + iterations as f64;
        ContactReport::add(kept, &ContactReport { iterations, depth, ..outcome.report });
        fault_of(scene, settings, s, None).map_or(Ok(true), Err)
    }

    /// Applies impacts and contact forces of the step to `v_next`.
    #[allow(clippy::too_many_lines)] // one solve of the law, with the rows that it adds
    fn touch(
        &mut self,
        scene: &Scene,
        settings: &StepSettings,
        s: &mut Scratch<f64>,
        before: &StepStart,
        kept: &[f64],
    ) -> Result<Outcome, (String, Error)> {
        let Self { solver, rows, record, division, .. } = self;
        let records = record.is_some();
        let (workspace, points, h) = (&mut solver.workspace, scene.contact_points(), settings.step);
        let StepStart { gaps, start, free, .. } = before;
        let (n, all_rows) = (points.len(), gaps.len());
        // Bodies that touch fall together without contacts: which of their gaps are above zero depends on rounding.
        let touches = |i: usize| gaps[i] <= if is_between_bodies(points, i) { TOUCHING } else { 0.0 };
        let closes = |i: usize| gaps[i] + h * free[3 * i + 2] <= 0.0;
        let mut near: Vec<usize> = (0..all_rows).filter(|&i| touches(i) || closes(i)).collect();
        let mut outcome = Outcome::default();
        // The rules for slow contacts are those of the whole step.
        let rest_speed = rest_speed(&s.model, division.whole, settings.given.accuracy);
        let whole = division.whole;
        let change = |i: usize| (free[3 * i + 2] - start[3 * i + 2]) * whole / h;
        let of_stops = settings.given.restitution;
        let restitution = |i: usize, speed: f64| match points.get(i) {
            Some(point) => bounce(point, speed, rest_speed),
            None if rebounds(speed, speed + change(i), of_stops) => of_stops,
            _ => 0.0,
        };
        let is_free = settings.free.is_some() && !division.rests(&s.model, &gaps[..n], start);
        // The part of an impact has no other forces of contacts, and the velocities after it are those of the next
        // part.
        let is_impact = division.struck.is_some();
        if is_impact {
            near = (0..all_rows).filter(|&i| gaps[i] <= TOUCHING).collect();
        }
        division.pass(&mut near, gaps, |i| restitution(i, start[3 * i + 2]));
        if near.is_empty() {
            return Ok(outcome);
        }
        // With connections, the projection of the velocities has left the factor.
        if rows.closed.is_none() {
            factorised(scene, (&s.model, &s.q), workspace)?;
        }
        let v_free = s.v_next.clone();
        // Velocities at the end of a free step are those of the time of its end, those of contact steps lag by half a
        // step.
        let part = if is_free || is_impact { 0.0 } else { 0.5 };
        let mut iterations = 0;
        let kept = from_fixed_axes(points, &before.axes, kept);
        // The stops whose joints do not return in this step, but only move no further outside.
        let mut dropped: Vec<usize> = Vec::new();
        for _ in 0..=2 * all_rows {
            let blocks = rows.gram(&s.model, points, workspace, &mut near);
            let pick =
                |all: &dyn Fn(usize) -> f64| DVector::from_fn(3 * near.len(), |i, _| all(3 * near[i / 3] + i % 3));
            let friction: Vec<f64> = near.iter().map(|&i| points.get(i).map_or(0.0, |of| of.friction)).collect();
            let cone = Cones::new(blocks, &friction);
            let lengths = cone.lengths();
            if let Some(at) = held_still(points, &near, &lengths) {
                near.remove(at);
                continue;
            }
            check_movable((scene, &rows.limits), &near, &lengths)?;
            let free_here = pick(&|i| free[i]);
            let rebound: Vec<f64> = near.iter().map(|&i| restitution(i, start[3 * i + 2])).collect();
            let mut u = free_here.clone();
            let middle = |free: &DVector<f64>| {
                let start = pick(&|i| start[i]);
                &start + (free - &start) * part
            };
            let mut warm = Some(pick(&|i| if i < 3 * n { kept[i] } else { 0.0 }));
            let touching = near.iter().filter(|&&i| i < n).count();
            let (mut hit, mut lost) = (None, 0.0);
            if rebound.iter().any(|&e| e > 0.0) {
                let middle = middle(&free_here);
                let struck = impact(&cone, &middle, &rebound, Effort::default());
                lost = lost_at_contacts(&cone, &middle, &struck.impulses, touching);
                u += cone.response(&struck.impulses);
                warm = None;
                hit = Some(struck);
            }
            let mut c = to_least_velocities(&u, (&near, n), (before, &dropped), h);
            if is_impact {
                for at in 0..near.len() {
                    c[3 * at + 2] = 1.0;
                }
            }
            let limits = Limits::of_step(&c, &free_here);
            let (held, mut solved) = cone.impulses(&c, warm.as_ref(), &limits, Effort::default());
            // A joint that returns from outside of its limits gains energy.
            let returning = |&i: &usize| i >= n && gaps[i] < 0.0 && !dropped.contains(&i);
            let returns = near.iter().any(returning);
            let (mut held, mut impulse_kept) = if returns { (held, 1.0) } else { passive(&cone, &u, held) };
            let mut all = held.clone();
            if let Some(hit) = &hit {
                all += &hit.impulses;
                solved = solved.with(hit.solved);
                impulse_kept = impulse_kept.min(hit.impulse_kept);
            }
            iterations += solved.iterations;
            rows.respond(&s.model, workspace, &all);
            for (i, v) in s.v_next.iter_mut().enumerate() {
                *v = v_free[i] + rows.response[i];
            }
            let after = rows.velocities(&s.model, points, &s.v_next);
            let late = |i: &usize| {
                gaps[*i].max(0.0) + h * after[3 * i + 2] < -LATE && near.binary_search(i).is_err() && !is_impact
            };
            // Connections and contacts can prevent a joint from returning to its limits.
            let is_met = solved.residual <= REFUSED && !is_violent(&s.v_next, &v_free);
            let outside = |at: usize| returning(&near[at]) && gaps[near[at]] < -LATE;
            let takes_part = |at: usize| outside(at) && held[3 * at + 2] > TAKES_PART * held.amax();
            let prevented: Vec<usize> = (0..near.len()).filter(|&at| !is_met && takes_part(at)).collect();
            if !prevented.is_empty() {
                dropped.extend(prevented.into_iter().map(|at| near[at]));
                continue;
            }
            let mut late: Vec<usize> = (0..all_rows).filter(late).collect();
            division.pass(&mut late, gaps, |i| restitution(i, after[3 * i + 2]));
            if late.is_empty() {
                let arrives = |at: usize| near[at] >= n && gaps[near[at]] > 0.0 && held[3 * at + 2] > 0.0;
                // A joint that arrives at one limit from outside of the other one returns no further.
                let joint = |at: usize| rows.limits[near[at] - n].row;
                let arrived: Vec<usize> = (touching..near.len()).filter(|&at| arrives(at)).map(joint).collect();
                let arriving: Vec<usize> = (touching..near.len()).filter(|&at| arrived.contains(&joint(at))).collect();
                let mut after = after;
                let of_impact = || (middle(&free_here), part);
                outcome.laws = records.then(|| Laws::new(cone.whole(), &rebound, of_impact(), (&c, &held), &arriving));
                outcome.laws.iter_mut().for_each(|laws| laws.dropped.clone_from(&dropped));
                note_dropped(&mut s.totals, dropped.first().map(|i| rows.limits[i - n].row));
                if !arriving.is_empty() {
                    for at in arriving {
                        c[3 * at + 2] = u[3 * at + 2];
                    }
                    let (slower, more) = cone.impulses(&c, Some(&held), &limits, Effort::default());
                    let (slower, part) = if returns { (slower, 1.0) } else { passive(&cone, &u, slower) };
                    (solved, impulse_kept, iterations) =
                        (solved.with(more), impulse_kept.min(part), iterations + more.iterations);
                    all += &slower - &held;
                    outcome.laws.iter_mut().for_each(|laws| laws.slower = Some((c.clone(), slower.clone())));
                    held = slower;
                    rows.respond(&s.model, workspace, &all);
                    let slowed: Vec<f64> = v_free.iter().zip(&rows.response).map(|(v, dv)| v + dv).collect();
                    after = rows.velocities(&s.model, points, &slowed);
                    outcome.slowed = Some(slowed);
                }
                let after_here = pick(&|i| after[i]);
                let velocities = (&held, [&pick(&|i| start[i]), &u, &after_here]);
                let (hit_now, counted) = ((lost, hit.as_ref()), (touching, rest_speed));
                outcome.report = report(&solved, iterations, impulse_kept, hit_now, velocities, counted);
                check((scene, &rows.limits), &near, &solved)?;
                outcome.states = cone.states(&held, &c, &limits);
                outcome.reverses = outcome.states[..touching].iter().enumerate().any(|(at, &state)| {
                    let [before, after] = [velocities.1[0], &after_here].map(|u| u.fixed_rows::<2>(3 * at));
                    let turned = before.dot(&after) < 0.5 * before.norm() * after.norm();
                    state == ContactState::Sliding && friction[at] > 0.0 && turned
                });
                if let Some(hit) = &hit {
                    states_of_rebounds((&cone, &friction), (&middle(&free_here), &hit.impulses), &mut outcome.states);
                }
                (outcome.near, outcome.hit, outcome.held) = (near, hit, held);
                break;
            }
            near.extend(late);
            near.sort_unstable();
        }
        Ok(outcome)
    }

    /// Ends the step of joints at their stops: their works and impacts.
    fn settle(
        &mut self,
        settings: &StepSettings,
        s: &mut Scratch<f64>,
        before: &StepStart,
        outcome: &Outcome,
        contacts: usize,
    ) {
        self.impacts.clear();
        let h = settings.step;
        for (at, &i) in outcome.near.iter().enumerate().filter(|(_, i)| **i >= contacts) {
            let (limit, start) = (self.rows.limits[i - contacts], before.start[3 * i + 2]);
            let struck = outcome.hit.as_ref().map_or(0.0, |hit| hit.impulses[3 * at + 2]);
            let impulse = outcome.held[3 * at + 2] + struck;
            let rests = (struck == 0.0 && impulse > 0.0).then(|| least_velocity(before.gaps[i].min(0.0), start, h));
            let ends = (&mut s.q_next[..], &mut s.v_next[..]);
            self.impacts.extend(settle_at(&limit, (h, start), (impulse, rests), ends));
            s.totals[STOPS] += 0.5 * impulse * limit.sign() * (s.v[limit.row] + s.v_next[limit.row]);
        }
    }
}

/// The restitution of a contact that approaches its surface at a speed.
fn bounce(point: &ContactPoint, speed: f64, rest_speed: f64) -> f64 {
    if speed < -rest_speed { point.restitution } else { 0.0 }
}

/// True for a contact of two bodies that both move.
fn is_between_bodies(points: &[ContactPoint], i: usize) -> bool {
    points.get(i).is_some_and(|point| point.other_body().is_some())
}

/// The velocity that gravity adds in a step: slower rebounds would last less than two steps. With error control, at
/// least a multiple of the accuracy.
pub(super) fn rest_speed<T: Real>(model: &Model<T>, h: f64, accuracy: Option<f64>) -> f64 {
    let least = accuracy.map_or(0.0, |accuracy| RESTS * accuracy);
    (model.gravity.map(|g| g.lane(0)).norm() * h).max(least)
}

/// Velocities u of the contacts `near`, the first `n` of which are not joint limits, minus the least velocities with
/// which they end the step at their surface or limit; zero for the stops `dropped`.
fn to_least_velocities(
    u: &DVector<f64>,
    (near, n): (&[usize], usize),
    (before, dropped): (&StepStart, &[usize]),
    h: f64,
) -> DVector<f64> {
    let (mut c, StepStart { gaps, start, .. }) = (u.clone(), before);
    for (at, &i) in near.iter().enumerate().filter(|(_, i)| !dropped.contains(i)) {
        c[3 * at + 2] -= if i < n { -gaps[i].max(0.0) / h } else { least_velocity(gaps[i], start[3 * i + 2], h) };
    }
    c
}

/// Kinetic energy dissipated by an impact at contacts, without joint limits, J, for velocities u.
fn lost_at_contacts(cone: &Cones, u: &DVector<f64>, impulses: &DVector<f64>, contacts: usize) -> f64 {
    let change = cone.response(impulses);
    -(0..3 * contacts).map(|i| impulses[i] * (u[i] + 0.5 * change[i])).sum::<f64>()
}

/// Sets the states of contacts that had an impact but no persistent force: sticking if they do not slip after it, for
/// velocities u before it.
fn states_of_rebounds(
    (cone, friction): (&Cones, &[f64]),
    (u, impulses): (&DVector<f64>, &DVector<f64>),
    states: &mut [ContactState],
) {
    let (largest, after, scale) = (impulses.amax(), u + cone.response(impulses), Limits::beside(u).scale);
    for (i, state) in states.iter_mut().enumerate().filter(|(_, state)| **state == ContactState::Open) {
        if impulses[3 * i + 2] > ROUNDING * largest {
            *state = ContactState::of_slip(after[3 * i].hypot(after[3 * i + 1]), scale, friction[i]);
        }
    }
}

/// The report of a step, for contact velocities at its `start`, u before the persistent impulses, and `after` them; the
/// first rows are those of contacts. Friction acts at the mean of the velocities at start and end, which also counts
/// the energy that a jam takes (Painleve's paradox). Where an impulse on a contact that lands slowly, or that jams,
/// accelerates the slip at its start, its tangential part is not friction: the whole work is that of an impact.
pub(super) fn report(
    solved: &SolveReport,
    iterations: usize,
    impulse_kept: f64,
    (lost, hit): (f64, Option<&Impact>),
    (held, [start, u, after]): (&DVector<f64>, [&DVector<f64>; 3]),
    (touching, rest_speed): (usize, f64),
) -> ContactReport {
    let (mut impacts, mut friction) = (lost, 0.0);
    for at in 0..touching {
        let [p, start, u, after] = [held, start, u, after].map(|rows| rows.fixed_rows::<3>(3 * at));
        let rubbed = -0.5 * (p[0] * (start[0] + after[0]) + p[1] * (start[1] + after[1]));
        if start[2] < -rest_speed || rubbed < -ROUNDING * p.norm() * u.norm() {
            impacts -= 0.5 * p.dot(&(u + after));
        } else {
            friction += rubbed;
        }
    }
    #[allow(clippy::cast_precision_loss)] // a small count
    ContactReport {
        residual: solved.residual,
        converged: solved.converged,
        iterations: iterations as f64,
        lost_in_impacts: impacts,
        lost_in_friction: friction,
        expansion_kept: hit.map_or(1.0, |hit| hit.expansion_kept),
        impulse_kept,
        ..ContactReport::default()
    }
}

/// Stores the results of a step: persistent impulses, sums of the impulses of impacts, and contact states.
pub(super) fn keep(kept: &mut [f64], outcome: &Outcome, contacts: usize) {
    let (held, struck) = kept.split_at_mut(3 * contacts);
    let (struck, states) = struck.split_at_mut(3 * contacts);
    held.fill(0.0);
    states[..contacts].fill(ContactState::Open.number());
    for (at, &i) in outcome.near.iter().enumerate().filter(|(_, i)| **i < contacts) {
        states[i] = outcome.states[at].number();
        for row in 0..3 {
            held[3 * i + row] = outcome.held[3 * at + row];
            struck[3 * i + row] += outcome.hit.as_ref().map_or(0.0, |hit| hit.impulses[3 * at + row]);
        }
    }
}
