//! Joint friction and stops of scenes with connections. A step in which a joint sticks, is held, or would end beyond a
//! limit is repeated with torques r of the set-valued law of [`stops`](super::stops), all rows together, as in the
//! first-order time stepping of J. J. Moreau.
//!
//! ```text
//! v_free: velocities at the end without friction and stops, on the connections; h w_free: the displacement
//! W: columns h P M^-1 e_j, with P the projection onto the connections of least kinetic energy
//! (e_j (w_free + W r/2), r_j) on the graph of row j             q' = q exp(h (w_free + W r/2)), on the connections
//! the same with rest or rebound at the stops that are reached    v' = v_free + W r, on the connections
//! ```
//!
//! Constant torques change the mean velocity by half of what they change that at the end. A joint that is held from the
//! start of the step to its end thus has no part in its error, nor have joints on which no row acts.
//!
//! At a dead center connections can prevent a joint from returning to its limits. Such a demand is dropped in this
//! step.

use super::constrained::{Constrained, Failure, solution_of_stuck};
use super::events::{Ending, Rebound, Reversal, StopImpact, largest, sliding};
use super::limit_rows::{is_violent, rebounds, settle_at};
use super::manifold::advance;
use super::modes::STUCK_NOISE;
use super::scratch::Scratch;
use super::step_settings::StepSettings;
use super::stops::{Bound, Drive, Graph, Hold, Line, Piece, SetValued, settle};
use super::totals::note_dropped;
use super::works::RowWork;
use crate::contact::{Cone, Cones, expansion_kept};
use crate::dynamics::constraints::ProjectionStep;
use crate::dynamics::contacts::LimitRow;
use crate::dynamics::solve;
use nalgebra::{DMatrix, DVector};

/// A limit that was inactive becomes active if the step ends further outside than this, rad or m.
const LATE: f64 = 1e-12;

/// A joint that the projection onto the connections moves further beyond its limit than this, rad or m, is corrected,
/// at most this number of times.
const CURVED: f64 = 1e-13;
const CORRECTIONS: usize = 10;

/// A velocity demanded by a stop is not met if it is missed by more than this, relative to the largest change.
const MISSED: f64 = 1e-5;

/// Relative rounding errors of velocities and of torques.
const ROUNDING: f64 = 1e-12;

/// True if a step ends beyond a limit, or begins there, so that its stop acts.
pub(super) fn is_past(of: &SetValued, s: &Scratch<f64>) -> bool {
    of.stops && (!(of.beyond(&s.q_next) <= LATE) || of.is_outside(&s.q))
}

/// The rows that can act in a step.
struct Acting {
    near: Vec<usize>,
    /// h P M^-1 `e_j` of each of them, and the changes of their velocities.
    columns: Vec<Vec<f64>>,
    g: DMatrix<f64>,
    /// Per row of the scene: 0, or 1 if its stop only prevents motion further outside, or 2 if it is dropped.
    reduced: Vec<u8>,
    /// The control laws with limits of effort, over the mean velocity and over that at the end.
    drives: Vec<Option<[Drive; 2]>>,
}

/// The unknowns of the law: mean velocities of the step, or those at its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Level {
    Mean,
    End,
}

impl Level {
    /// The change by constant torques, relative to that at the end.
    fn share(self) -> f64 {
        match self {
            Self::Mean => 0.5,
            Self::End => 1.0,
        }
    }
}

/// A solution of the set-valued law: all velocities, and the torques and pieces of the acting rows.
#[derive(Clone)]
struct Solution {
    velocities: Vec<f64>,
    torques: DVector<f64>,
    holds: Vec<Option<Hold>>,
    /// The torque of friction of a moving row, and that of the control law, with its piece.
    rubbing: Vec<f64>,
    driven: Vec<f64>,
    lines: Vec<Line>,
}

/// A solution of the law in a step, for its adjoint: v = `v_free` + s W r.
#[derive(Default)]
pub(super) struct LawSolution {
    /// s: one half for mean velocities.
    pub share: f64,
    pub velocities: Vec<f64>,
    /// r of every row of the model, and the part of friction in that of moving rows.
    pub torques: Vec<f64>,
    pub rubbing: Vec<f64>,
    /// The rows on vertical pieces, and those on the slope of a control law.
    pub stuck: Vec<StuckRow>,
    /// The rows whose control law is at a limit of effort.
    pub at_limit: Vec<usize>,
    /// The rows that friction holds: projections do not move them.
    pub locked: Vec<usize>,
}

/// A row whose velocity is prescribed, or is linear in its torque.
pub(super) struct StuckRow {
    /// Index in v.
    pub row: usize,
    /// 1/(s h b) for the slope b of a control law, else zero.
    pub compliance: f64,
    /// The derivatives of its velocity by q and v at the start, and by the curvature of the connections.
    pub slopes: [f64; 2],
    pub by_bent: f64,
}

/// The displacement of a step by the velocities of a solution.
pub(super) struct Displacement {
    pub solution: LawSolution,
    /// The steps of its projection onto the connections, and its end; none if no joint moves.
    pub newton: Vec<ProjectionStep>,
    pub end: Option<Vec<f64>>,
}

/// The solutions of the law in a step.
#[derive(Default)]
pub(super) struct StopRecord {
    /// The velocities at the end without friction and stops, and the mean ones.
    pub free: Vec<f64>,
    pub mean: Vec<f64>,
    /// The displacements that were tried; each uses the curvature of the connections along the one before.
    pub displacements: Vec<Displacement>,
    /// The velocities at the end.
    pub last: LawSolution,
    /// The fraction of the rebounds that the kinetic energy allows; 1 without rebounds.
    pub kept: f64,
    /// The rows of v that rebound.
    bounced: Vec<usize>,
    pub reversals: Vec<Reversal>,
}

impl StopRecord {
    /// The rebounds of an event of length h.
    pub fn rebound(&self, s: &Scratch<f64>, h: f64) -> Option<Rebound> {
        let before = self.free.iter().zip(&s.v).map(|(free, v)| (free - v) / h);
        (!self.bounced.is_empty()).then(|| Rebound {
            rows: self.bounced.clone(),
            velocities: s.v_next.clone(),
            accelerations_before: before.collect(),
        })
    }
}

impl Constrained<'_> {
    /// Solves friction and stops of a step, from the end of a step without them, and records the solutions of the law.
    /// Returns an estimate of the error, as of error control.
    pub(super) fn stop(
        &mut self,
        settings: &StepSettings,
        rows: &[SetValued],
        (s, ending): (&mut Scratch<f64>, Ending<'_>),
        record: &mut StopRecord,
    ) -> Result<f64, Failure> {
        let noise = std::mem::replace(&mut s.model.system.noise, settings.properties.armature.clone());
        s.displace_from_targets(settings, false);
        let drive = |of: &SetValued| {
            of.drives.then(|| [true, false].map(|is_mean| Drive::of(settings, s, (of.row, is_mean), ending.0)))
        };
        let torque = |of: &SetValued| s.u[of.row] + drive(of).map_or(0.0, |[_, end]| end.torque(s.v[of.row]));
        let rows: Vec<SetValued> = rows.iter().map(|of| s.at_start(of, torque(of))).collect();
        let drives = rows.iter().map(drive).collect();
        let outcome = self.stopped(settings, (&rows, drives), (s, ending), record);
        s.model.system.noise = noise;
        outcome
    }

    fn stopped(
        &mut self,
        settings: &StepSettings,
        (rows, drives): (&[SetValued], Vec<Option<[Drive; 2]>>),
        (s, (h, time, impacts)): (&mut Scratch<f64>, Ending<'_>),
        record: &mut StopRecord,
    ) -> Result<f64, Failure> {
        record.free.clone_from(&s.v_next);
        record.mean.extend(s.x.iter().map(|x| x / h));
        let (mut free, mut mean) = (s.v_next.clone(), record.mean.clone());
        let pivots = self.factorise(&s.model, &s.q)?;
        for velocities in [&mut free, &mut mean] {
            self.velocities_with_factors(&s.model, pivots, velocities)?;
        }
        let limits: Vec<_> = rows.iter().map(|of| of.bounds((s.q[of.coordinate], s.v[of.row]), h)).collect();
        let bounds: Vec<[f64; 2]> = limits.iter().map(|of| of.map(|bound| bound.velocity)).collect();
        let (mut acting, n) = (self.acting(drives, (rows, h), s)?, rows.len());
        let (reached, is_still) = self.displace((rows, h), (&mut acting, &mean), &limits, (s, record))?;
        // Velocities at the end: zero at the stops, or rebound velocities limited so that the kinetic energy does not
        // increase.
        let stopped = |i: usize| {
            let at = acting.near.iter().position(|&near| near == i);
            at.and_then(|at| reached.holds[at]).filter(|&hold| hold != Hold::Friction)
        };
        let returning = |i: usize| {
            let at = |bound: f64| if rows[i].is_outside(&s.q) { bound } else { 0.0 };
            match stopped(i) {
                Some(Hold::Lower) => [at(bounds[i][0]), f64::INFINITY],
                Some(_) => [f64::NEG_INFINITY, at(bounds[i][1])],
                None => [f64::NEG_INFINITY, f64::INFINITY],
            }
        };
        let bounces = |i: usize| {
            let (start, u) = (s.v[rows[i].row], free[rows[i].row]);
            match stopped(i) {
                Some(Hold::Lower) => rebounds(start, u, settings.given.restitution),
                Some(_) => rebounds(-start, -u, settings.given.restitution),
                None => false,
            }
        };
        let back = |i: usize| {
            let ([low, high], speed) = (returning(i), -settings.given.restitution * s.v[rows[i].row]);
            match stopped(i) {
                Some(Hold::Lower) if bounces(i) => [speed, high],
                Some(_) if bounces(i) => [low, speed],
                _ => [low, high],
            }
        };
        let bounced: Vec<bool> = (0..n).map(bounces).collect();
        record.bounced = (0..n).filter(|&i| bounced[i]).map(|i| rows[i].row).collect();
        let elastic = bounced.contains(&true);
        let (resting, rebounding): (Vec<_>, Vec<_>) = (0..n).map(|i| (returning(i), back(i))).unzip();
        let mut last = acting.solved(rows, (Level::End, &free), |i| resting[i]);
        record.kept = 1.0;
        let mut pieces = last.clone();
        if elastic {
            (record.kept, pieces) = acting.expand(rows, &free, h, &mut last, |i| rebounding[i]);
        }
        record.last = acting.recorded((rows, h, Level::End), (&last, &pieces), |i, side| match () {
            () if bounced[i] => ([0.0, -settings.given.restitution], 0.0),
            () if rows[i].is_outside(&s.q) => (limits[i][side].slopes, 0.0),
            () => ([0.0; 2], 0.0),
        });
        s.v_next.copy_from_slice(&last.velocities);
        if !elastic {
            record.reversals = acting.reversals(rows, &last, s);
        }
        // The curvature of the connections, which changes the velocities below, does no work on the stops.
        let impulses = acting.add_works(rows, (&reached, &last), h, s);
        if !is_still {
            let held = acting.hold(rows, &last, s);
            let projected = self.velocities_onto_connections(&s.model, &s.q_next, &mut s.v_next);
            s.model.system.noise.copy_from_slice(&held);
            projected?;
        }
        impacts.extend(acting.finish(rows, (&reached, &impulses), (time, &resting, elastic), s));
        note_dropped(&mut s.totals, acting.reduced.iter().position(|&by| by > 0).map(|i| rows[i].row));
        Ok(acting.error(rows, (&reached, &bounced), (settings, h, &free), s))
    }

    /// The displacement of a step, with the mean velocities `mean` without friction and stops. Returns the solution of
    /// the law, and true if no joint moves.
    fn displace(
        &mut self,
        (rows, h): (&[SetValued], f64),
        (acting, mean): (&mut Acting, &[f64]),
        limits: &[[Bound; 2]],
        (s, record): (&mut Scratch<f64>, &mut StopRecord),
    ) -> Result<(Solution, bool), Failure> {
        let n = rows.len();
        let mut bent = vec![0.0; n];
        let mut correction = 0;
        loop {
            let wanted = |i: usize| limits[i].each_ref().map(|bound| bound.velocity - bent[i]);
            let mut found = acting.solved(rows, (Level::Mean, mean), wanted);
            for _ in 0..n {
                let late = |&i: &usize| {
                    let ([low, high], u) = (wanted(i), found.velocities[rows[i].row]);
                    !acting.near.contains(&i) && h * (low - u).max(u - high) > LATE
                };
                let late: Vec<usize> = (0..n).filter(late).collect();
                if late.is_empty() {
                    break;
                }
                self.join(acting, &late, (rows, h), s)?;
                found = acting.solved(rows, (Level::Mean, mean), wanted);
            }
            let by_bent = if record.displacements.is_empty() { 0.0 } else { -1.0 };
            let solution = acting.recorded((rows, h, Level::Mean), (&found, &found), |i, side| {
                let is_reduced = acting.reduced[i] > 0 && limits[i][side].velocity * [1.0, -1.0][side] > 0.0;
                if is_reduced { ([0.0; 2], 0.0) } else { (limits[i][side].slopes, by_bent) }
            });
            let moved = self.displaced(acting, (rows, h), (&found, solution), s)?;
            let is_still = moved.end.is_none();
            record.displacements.push(moved);
            if is_still {
                return Ok((found, true));
            }
            // The projection moves joints because of the curvature of the connections.
            let mut worst = 0.0_f64;
            for (i, of) in rows.iter().enumerate().filter(|(i, of)| of.stops && acting.reduced[*i] < 2) {
                let (straight, end) = (s.q[of.coordinate] + s.x[of.row], s.q_next[of.coordinate]);
                bent[i] = (end - straight) / h;
                worst = worst.max(of.beyond(&s.q_next) - (of.lower - straight).max(straight - of.upper).max(0.0));
            }
            correction += 1;
            if worst <= CURVED || correction > CORRECTIONS {
                return Ok((found, false));
            }
        }
    }

    /// The displacement by the velocities of a solution, onto the connections.
    fn displaced(
        &mut self,
        acting: &Acting,
        (rows, h): (&[SetValued], f64),
        (found, solution): (&Solution, LawSolution),
        s: &mut Scratch<f64>,
    ) -> Result<Displacement, Failure> {
        for (x, v) in s.x.iter_mut().zip(&found.velocities) {
            *x = h * v;
        }
        advance(&s.model, &s.q, &s.x, &mut s.q_next);
        let mut moved = Displacement { solution, newton: Vec::new(), end: None };
        if found.velocities.iter().all(|&v| v == 0.0) {
            s.q_next.copy_from_slice(&s.q);
            return Ok(moved);
        }
        let held = acting.hold(rows, found, s);
        let projected = self.positions_onto_connections(&s.model, &mut s.q_next, Some(&mut moved.newton));
        s.model.system.noise.copy_from_slice(&held);
        moved.end = Some(s.q_next.clone());
        projected.map(|()| moved)
    }

    /// The rows that act in every step: those with friction or limits of effort.
    fn acting(
        &mut self,
        drives: Vec<Option<[Drive; 2]>>,
        (rows, h): (&[SetValued], f64),
        s: &Scratch<f64>,
    ) -> Result<Acting, Failure> {
        let near: Vec<usize> = (0..rows.len()).filter(|&i| rows[i].rubs() || rows[i].drives).collect();
        let mut acting = Acting {
            near: Vec::new(),
            columns: Vec::new(),
            g: DMatrix::zeros(0, 0),
            reduced: vec![0; rows.len()],
            drives,
        };
        self.join(&mut acting, &near, (rows, h), s)?;
        Ok(acting)
    }

    /// Adds rows to the acting ones.
    fn join(
        &mut self,
        acting: &mut Acting,
        more: &[usize],
        (rows, h): (&[SetValued], f64),
        s: &Scratch<f64>,
    ) -> Result<(), Failure> {
        // A displacement leaves the factors at its end.
        let pivots = self.factorise(&s.model, &s.q)?;
        for &i in more {
            let (mut torque, mut column) = (vec![0.0; s.v.len()], vec![0.0; s.v.len()]);
            torque[rows[i].row] = h;
            solve(&s.model, &mut self.scratch.workspace, &torque, &mut column);
            self.velocities_with_factors(&s.model, pivots, &mut column)?;
            acting.near.push(i);
            acting.columns.push(column);
        }
        let n = acting.near.len();
        let g = DMatrix::from_fn(n, n, |a, b| acting.columns[b][rows[acting.near[a]].row]);
        acting.g = 0.5 * (&g + g.transpose());
        Ok(())
    }
}

impl Acting {
    /// The solution of the law from the velocities `free`, with the velocity bounds of the stops. A demand that the
    /// connections prevent is reduced.
    fn solved(
        &mut self,
        rows: &[SetValued],
        (level, free): (Level, &[f64]),
        bounds: impl Fn(usize) -> [f64; 2],
    ) -> Solution {
        let (n, share) = (self.near.len(), level.share());
        let own = DVector::from_fn(n, |a, _| free[rows[self.near[a]].row]);
        loop {
            let graph = |&i: &usize| {
                let [low, high] = match (self.reduced[i], bounds(i)) {
                    (0, bounds) => bounds,
                    (1, [low, high]) => [low.min(0.0), high.max(0.0)],
                    _ => [f64::NEG_INFINITY, f64::INFINITY],
                };
                let drive = self.drives[i].map(|[mean, end]| if level == Level::Mean { mean } else { end });
                Graph::between(low, high.max(low), rows[i].friction, drive)
            };
            let graphs: Vec<Graph> = self.near.iter().map(graph).collect();
            let mut pieces: Vec<Piece> = graphs.iter().zip(&own).map(|(graph, &u)| graph.piece(u)).collect();
            settle(&mut pieces, |pieces, found| {
                let (torques, u) = self.response((share, &own), &graphs, pieces);
                let (slow, weak) = (ROUNDING * (own.amax() + u.amax()), ROUNDING * torques.amax());
                for (a, (graph, &piece)) in graphs.iter().zip(pieces).enumerate() {
                    let value = if matches!(piece, Piece::At(_)) { torques[a] } else { u[a] };
                    let weak = weak + ROUNDING * rows[self.near[a]].rubbing();
                    found.extend(graph.contradicted(piece, value, [slow, weak]).map(|piece| (a, piece)));
                }
            });
            let (torques, u) = self.response((share, &own), &graphs, &pieces);
            let mut velocities = free.to_vec();
            for (column, torque) in self.columns.iter().zip(&torques) {
                for (v, change) in velocities.iter_mut().zip(column) {
                    *v += change * (share * torque);
                }
            }
            let holds: Vec<_> = graphs.iter().zip(&pieces).map(|(graph, &piece)| graph.velocity(piece)).collect();
            if self.reduce(&holds, (&own, &u), is_violent(&velocities, free)) {
                continue;
            }
            if largest(&velocities, 0.0) <= ROUNDING * largest(free, 0.0) {
                velocities.fill(0.0);
            }
            for (&i, hold) in self.near.iter().zip(&holds) {
                let v = &mut velocities[rows[i].row];
                *v = hold.map_or(*v, |(velocity, _)| if (*v - velocity).abs() <= LATE { velocity } else { *v });
            }
            let lines = || graphs.iter().zip(&pieces).map(|(graph, &piece)| graph.line(piece));
            return Solution {
                velocities,
                torques,
                holds: holds.iter().map(|hold| hold.map(|(_, hold)| hold)).collect(),
                rubbing: graphs.iter().zip(&pieces).map(|(graph, &piece)| graph.torque(piece)).collect(),
                driven: lines().zip(&u).map(|(line, u)| line.at(*u)).collect(),
                lines: lines().collect(),
            };
        }
    }

    /// Reduces the demands that are not met, and those of joints outside of their limits if others would move too fast.
    fn reduce(
        &mut self,
        holds: &[Option<(f64, Hold)>],
        (free, u): (&DVector<f64>, &DVector<f64>),
        violent: bool,
    ) -> bool {
        let size = (u - free).amax().max(free.amax());
        let mut any = false;
        for (a, hold) in holds.iter().enumerate() {
            let (missing, outside) = match hold {
                Some((low, Hold::Lower)) => (low - u[a], *low > 0.0),
                Some((high, Hold::Upper)) => (u[a] - high, *high < 0.0),
                _ => continue,
            };
            let is_met = missing <= MISSED * size && !(outside && violent);
            let reduced = &mut self.reduced[self.near[a]];
            if !is_met && *reduced < 2 {
                (*reduced, any) = (*reduced + 1, true);
            }
        }
        any
    }

    /// The torques of the rows on these pieces, and their velocities. Those of stuck rows, and of rows on the slope of
    /// a control law, r = c - b u, are unknown: u = w - r/b with w the prescribed velocity, or c/b.
    fn response(
        &self,
        (share, free): (f64, &DVector<f64>),
        graphs: &[Graph],
        pieces: &[Piece],
    ) -> (DVector<f64>, DVector<f64>) {
        let of_all = share * &self.g;
        let unknown = |(a, (graph, &piece)): (usize, (&Graph, &Piece))| match (graph.velocity(piece), graph.line(piece))
        {
            (Some((velocity, _)), _) => Some((a, velocity, 0.0)),
            (None, Line { torque, slope, .. }) if slope > 0.0 => {
                Some((a, (graph.torque(piece) + torque) / slope, 1.0 / slope))
            }
            _ => None,
        };
        let stuck: Vec<(usize, f64, f64)> = graphs.iter().zip(pieces).enumerate().filter_map(unknown).collect();
        let mut torques =
            DVector::from_fn(graphs.len(), |a, _| graphs[a].torque(pieces[a]) + graphs[a].line(pieces[a]).torque);
        let mut g = DMatrix::from_fn(stuck.len(), stuck.len(), |a, b| of_all[(stuck[a].0, stuck[b].0)]);
        for (a, (.., compliance)) in stuck.iter().enumerate() {
            g[(a, a)] += compliance;
        }
        let largest = (0..of_all.nrows()).fold(f64::MIN_POSITIVE, |most, a| most.max(of_all[(a, a)]));
        solution_of_stuck(g, largest, |found| {
            for (&(a, ..), torque) in stuck.iter().zip(found) {
                torques[a] = *torque;
            }
            let u = free + &of_all * &torques;
            DVector::from_fn(stuck.len(), |k, _| {
                let (a, velocity, compliance) = stuck[k];
                velocity - compliance * torques[a] - u[a]
            })
        });
        let u = free + &of_all * &torques;
        (torques, u)
    }

    /// Adds the rebounds to a solution, as far as they do not increase the kinetic energy.
    fn expand(
        &mut self,
        rows: &[SetValued],
        free: &[f64],
        h: f64,
        rest: &mut Solution,
        bounds: impl Fn(usize) -> [f64; 2],
    ) -> (f64, Solution) {
        let bounced = self.solved(rows, (Level::End, free), bounds);
        let normal = |of: &dyn Fn(usize) -> f64| {
            DVector::from_fn(3 * self.near.len(), |row, _| if row % 3 == 2 { of(row / 3) } else { 0.0 })
        };
        let mut g = DMatrix::zeros(3 * self.near.len(), 3 * self.near.len());
        for a in 0..self.near.len() {
            for b in 0..self.near.len() {
                g[(3 * a + 2, 3 * b + 2)] = self.g[(a, b)] / h;
            }
        }
        let cone = Cones::from(Cone::new(g, vec![0.0; self.near.len()]));
        let u = normal(&|a| free[rows[self.near[a]].row]);
        let more = &bounced.torques - &rest.torques;
        let kept = expansion_kept(&cone, &u, &normal(&|a| h * rest.torques[a]), &normal(&|a| h * more[a]));
        rest.torques += kept * more;
        for (v, bounced) in rest.velocities.iter_mut().zip(&bounced.velocities) {
            *v += kept * (bounced - *v);
        }
        for (torque, bounced) in rest.driven.iter_mut().zip(&bounced.driven) {
            *torque += kept * (bounced - *torque);
        }
        (kept, bounced)
    }

    /// A solution on these pieces for its adjoint. `slopes`: the derivatives of a bound, 0 or 1, of a row by q and v,
    /// and by the curvature of the connections.
    fn recorded(
        &self,
        (rows, h, level): (&[SetValued], f64, Level),
        (found, pieces): (&Solution, &Solution),
        slopes: impl Fn(usize, usize) -> ([f64; 2], f64),
    ) -> LawSolution {
        let (share, velocities) = (level.share(), found.velocities.clone());
        let mut solution = LawSolution { share, velocities, ..LawSolution::default() };
        solution.torques.resize(found.velocities.len(), 0.0);
        solution.rubbing.resize(found.velocities.len(), 0.0);
        for (a, &index) in self.near.iter().enumerate() {
            let row = rows[index].row;
            (solution.torques[row], solution.rubbing[row]) = (found.torques[a], pieces.rubbing[a]);
            if found.holds[a] == Some(Hold::Friction) {
                solution.locked.push(row);
            }
            let Line { slope, is_limit, .. } = pieces.lines[a];
            if is_limit {
                solution.at_limit.push(row);
            }
            let ((slopes, by_bent), compliance) = match pieces.holds[a] {
                None if slope > 0.0 => (([0.0; 2], 0.0), 1.0 / (share * h * slope)),
                None => continue,
                Some(Hold::Friction) => (([0.0; 2], 0.0), 0.0),
                Some(hold) => (slopes(index, usize::from(hold == Hold::Upper)), 0.0),
            };
            solution.stuck.push(StuckRow { row, compliance, slopes, by_bent });
        }
        solution
    }

    /// The reversals of sliding friction in a step.
    fn reversals(&self, rows: &[SetValued], last: &Solution, s: &Scratch<f64>) -> Vec<Reversal> {
        let each = self.near.iter().enumerate().filter(|(_, i)| rows[**i].rubs());
        each.filter_map(|(at, &i)| {
            let (of, torque) = (&rows[i], last.torques[at] - last.driven[at]);
            let change = torque - sliding(of.friction, s.v[of.row]);
            let change: Vec<f64> = self.columns[at].iter().map(|column| change * column).collect();
            Reversal::new((of.row, of.friction, last.holds[at]), torque, (&s.v, &last.velocities), &change)
        })
        .collect()
    }

    /// Adds the works of the rows in a step to the velocities in the scratch. Returns the impulses of the stops.
    fn add_works(
        &self,
        rows: &[SetValued],
        (reached, last): (&Solution, &Solution),
        h: f64,
        s: &mut Scratch<f64>,
    ) -> Vec<f64> {
        let of_row = |(at, &i): (usize, &usize)| {
            let (of, torque) = (&rows[i], last.torques[at] - last.driven[at]);
            if of.drives {
                s.control[of.row] = h * last.driven[at];
            }
            let hold = reached.holds[at].filter(|&hold| hold != Hold::Friction);
            RowWork::new((of.row, of.friction), (h, torque, hold), s).add(s)
        };
        self.near.iter().enumerate().map(of_row).collect()
    }

    /// Removes rounding errors of joints at their stops, and returns the impacts.
    fn finish(
        &self,
        rows: &[SetValued],
        (reached, impulses): (&Solution, &[f64]),
        (time, resting, elastic): (f64, &[[f64; 2]], bool),
        s: &mut Scratch<f64>,
    ) -> Vec<StopImpact> {
        let mut impacts = Vec::new();
        for (at, &i) in self.near.iter().enumerate() {
            let Some(hold) = reached.holds[at].filter(|&hold| hold != Hold::Friction) else { continue };
            let (of, upper) = (&rows[i], hold == Hold::Upper);
            let bound = if upper { of.upper } else { of.lower };
            let limit = LimitRow { body: 0, row: of.row, coordinate: of.coordinate, upper, bound };
            let impulse = impulses[at] * limit.sign();
            let rests = (!elastic && impulse > 0.0).then(|| limit.sign() * resting[i][usize::from(upper)]);
            let ends = (&mut s.q_next[..], &mut s.v_next[..]);
            impacts.extend(settle_at(&limit, (time, limit.velocity(&s.v)), (impulse, rests), ends));
        }
        impacts
    }

    /// An estimate of the error of a step. Velocities change at an unknown time within it, and so do accelerations,
    /// unless the same joints are held from its start on; rebounds are omitted.
    fn error(
        &self,
        rows: &[SetValued],
        (reached, bounced): (&Solution, &[bool]),
        (settings, h, free): (&StepSettings, f64, &[f64]),
        s: &Scratch<f64>,
    ) -> f64 {
        let fastest = largest(&s.v, 1.0);
        let jump = s.v_next.iter().zip(&s.v).fold(0.0_f64, |most, (next, v)| most.max((next - v).abs()));
        let (mut lasts, mut omitted) = (true, 0.0_f64);
        for (&i, &hold) in self.near.iter().zip(&reached.holds) {
            let (of, start) = (&rows[i], s.v[rows[i].row]);
            let is_at_stop = of.beyond(&s.q) >= 0.0;
            lasts &= match hold {
                Some(Hold::Friction) => start == 0.0,
                Some(_) => is_at_stop,
                None => !of.rubs() || start * s.v_next[of.row] >= 0.0,
            };
            if hold.is_some_and(|hold| hold != Hold::Friction) && !bounced[i] && !is_at_stop {
                let (back, slowing) = (settings.given.restitution * start.abs(), (free[of.row] - start).abs() / h);
                omitted += (back / fastest).max(back * back / (2.0 * slowing.max(f64::MIN_POSITIVE)));
            }
        }
        let late = |row: usize| {
            let rubbing = self.near.iter().zip(&self.columns).map(|(&i, column)| rows[i].rubbing() * column[row].abs());
            (free[row] - s.v[row]).abs() + rubbing.sum::<f64>()
        };
        let late = if lasts { 0.0 } else { (0..free.len()).map(late).fold(0.0, f64::max) / fastest };
        (h * jump).max(late) + omitted
    }

    /// Locks the joints that friction holds, so that projections do not move them. Returns the noise before.
    fn hold(&self, rows: &[SetValued], found: &Solution, s: &mut Scratch<f64>) -> Vec<f64> {
        let before = s.model.system.noise.clone();
        for (&i, _) in self.near.iter().zip(&found.holds).filter(|(_, hold)| **hold == Some(Hold::Friction)) {
            s.model.system.noise[rows[i].row] = STUCK_NOISE;
        }
        before
    }
}
