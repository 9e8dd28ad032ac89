//! One step of one state in substeps: short enough for fast motion, and by the set-valued law where joints stick, slip, or meet a stop.
//!
//! A substep whose modes do not hold until its end is an *event*: one step of the implicit Euler method with the law of [`stops`](super::stops) at its end. Its error is of second
//! order in the step where joints stick or slip, and such events are few, so the order of a method up to two remains; the instant of an impact is known to a step only, an error of
//! first order. At a stop the joint ends the step on it, and with the velocity of the rebound, or at rest where the rebound would end within the step.

use super::manifold::advance;
use super::method::{Method, Scheme};
use super::modes::{LOCKED, speeds_and_errors};
use super::scratch::{Scratch, clear};
use super::solver::Checked;
use super::step::{set_friction, stage, step};
use super::step_settings::{By, StepSettings};
use super::stops::{Graph, Hold, Piece, settle};
use super::totals::{ERROR, EVENTS, FRICTION, LENGTH, MOST, STOPS, SUBSTEPS, TOTALS, UNSETTLED, WORKS};
use super::works::add_work;
use crate::dynamics;
use crate::interrupt;
use crate::workspace::Workspace;

/// A step is divided into at most so many substeps.
const MOST_SUBSTEPS: u32 = 1 << 10;

/// With error control, the first and the shortest substep, parts of the step.
const FIRST: f64 = 1e-2;
const SHORTEST: f64 = 1e-7;
/// A joint outside of its stops returns in substeps of this length, s: each is an event.
const RETURNING: f64 = 5e-4;
/// With error control, a step is given up after so many substeps.
const MOST_CONTROLLED: usize = 1_000_000;

/// Joints rotate by no more than this in an event, rad, unless the substep is as short as this, in the shortest.
const TURN_OF_EVENT: f64 = 5e-3;
const SHORTEST_EVENT: u32 = 1;

/// Substeps of one length before a longer one is tried.
const CALM: u32 = 4;

/// Parts of velocities, and of torques, that are rounding.
const ROUNDING: f64 = 1e-13;
const ROUNDING_OF_TORQUES: f64 = 1e-11;

/// A joint that met one of its stops.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StopImpact {
    /// Index of the state in the batch.
    pub state: usize,
    /// The degree of freedom, an index in qd.
    pub row: usize,
    /// True if it was the upper stop.
    pub upper: bool,
    /// When, at the end of a substep, s.
    pub time: f64,
    /// How fast it moved, rad/s or m/s.
    pub speed: f64,
    /// The impulse of the stop on it, N m s or N s.
    pub impulse: f64,
}

/// Sees each substep that is accepted: its scheme, its start, and the solution of an event.
type Visitor<'a> = dyn FnMut(&Scheme, &Scratch<f64>, Option<&Event<'_>>) + 'a;

/// Scratch for substeps.
#[derive(Debug)]
pub(super) struct Substeps {
    q: Vec<f64>,
    v: Vec<f64>,
    torque: Vec<f64>,
    given: Vec<f64>,
    noise: Vec<f64>,
    graphs: Vec<Graph>,
    pieces: Vec<Piece>,
    locks: Vec<Locks>,
    reached: Vec<(usize, f64)>,
    /// Joints that met a stop, with the time since the step's start.
    pub impacts: Vec<StopImpact>,
}

impl Substeps {
    pub fn new(settings: &StepSettings, s: &Scratch<f64>) -> Self {
        let (q, v) = (vec![0.0; s.q.len()], vec![0.0; s.v.len()]);
        let count = settings.set_valued.len();
        Self {
            q,
            torque: v.clone(),
            given: v.clone(),
            noise: v.clone(),
            v,
            graphs: Vec::with_capacity(count),
            pieces: Vec::with_capacity(count),
            locks: Vec::new(),
            reached: Vec::new(),
            impacts: Vec::new(),
        }
    }

    /// From `q`, `v` to `q_next`, `v_next` in one step of the run; `visit` is called before each substep is accepted, with the state at its start still in `q` and `v`.
    pub fn advance(
        &mut self,
        settings: &StepSettings,
        s: &mut Scratch<f64>,
        solver: &mut Checked,
        visit: &mut Visitor<'_>,
    ) {
        self.q.copy_from_slice(&s.q);
        self.v.copy_from_slice(&s.v);
        self.impacts.clear();
        match settings.accuracy {
            Some(accuracy) => self.controlled(settings, accuracy, s, solver),
            None => self.through(settings, s, solver, visit),
        }
        s.q_next.copy_from_slice(&s.q);
        s.v_next.copy_from_slice(&s.v);
        s.q.copy_from_slice(&self.q);
        s.v.copy_from_slice(&self.v);
    }

    /// All substeps, in place; stops where a pivot is lost or a result is not finite.
    fn through(
        &mut self,
        settings: &StepSettings,
        s: &mut Scratch<f64>,
        solver: &mut Checked,
        visit: &mut Visitor<'_>,
    ) {
        // Lengths count in the shortest substep.
        let shortest = settings.step / f64::from(MOST_SUBSTEPS);
        let mut size = MOST_SUBSTEPS;
        let (mut left, mut calm, mut made) = (MOST_SUBSTEPS, 0, 0_u32);
        while left > 0 {
            size = size.min(left);
            let scheme = Scheme::new(settings.method, shortest * f64::from(size));
            s.adopt(settings, &scheme);
            step((settings, &scheme), s, solver);
            if solver.lost.is_some() {
                s.v.fill(f64::NAN);
                break;
            }
            if !(s.short_enough > 0.0) && size > 1 {
                (size, calm) = (shorter((settings, &scheme), s, size), 0);
                continue;
            }
            if s.consistent > 0.0 {
                visit(&scheme, s, None);
                add_work(settings, s);
            } else if settings.divides
                && size > SHORTEST_EVENT
                && !(scheme.step * speeds_and_errors((settings, &scheme), s)[0].0 <= TURN_OF_EVENT)
            {
                (size, calm) = (size / 2, 0);
                continue;
            } else if s.v_next.iter().all(|v| v.is_finite()) {
                let time = shortest * f64::from(MOST_SUBSTEPS - left + size);
                let (totals, impacts) = (s.totals, self.impacts.len());
                self.event(settings, scheme.step, s, solver, time);
                if settings.divides && size > 1 && !conserves(settings, s, &totals, &mut solver.workspace) {
                    s.totals = totals;
                    self.impacts.truncate(impacts);
                    (size, calm) = (size / 2, 0);
                    continue;
                }
                let scheme = Scheme::new(Method::ImplicitEuler, scheme.step);
                visit(&scheme, s, Some(&Event { locks: &self.locks, reached: &self.reached }));
                s.totals[EVENTS] += 1.0;
            }
            std::mem::swap(&mut s.q, &mut s.q_next);
            std::mem::swap(&mut s.v, &mut s.v_next);
            if !s.v.iter().chain(&s.q).all(|x| x.is_finite()) {
                break;
            }
            left -= size;
            made += 1;
            calm += 1;
            if calm >= CALM && left % (2 * size) == 0 {
                (size, calm) = (2 * size, 0);
            }
        }
        s.totals[SUBSTEPS] += f64::from(made);
        s.totals[MOST] = s.totals[MOST].max(f64::from(made));
    }

    /// All substeps, in place, each so long that its estimated error meets the bound: by the embedded method, or as the difference between one step and two of half its length; a change of modes ends a substep, by bisection.
    fn controlled(&mut self, settings: &StepSettings, accuracy: f64, s: &mut Scratch<f64>, solver: &mut Checked) {
        // That of the error estimate.
        let order = f64::from(settings.method.order()) - f64::from(u8::from(settings.scheme.embedded));
        let (mut left, mut made, mut tried) = (1.0, 0.0, 0_usize);
        let mut length = if s.totals[LENGTH] > 0.0 { s.totals[LENGTH] } else { FIRST };
        let (mut q, mut v) = (s.q.clone(), s.v.clone());
        let (mut whole_q, mut whole_v) = (q.clone(), v.clone());
        while left > 0.0 {
            let is_last = length >= left;
            let part = if is_last { left } else { length };
            q.copy_from_slice(&s.q);
            v.copy_from_slice(&s.v);
            let totals = s.totals;
            let scheme = Scheme::new(settings.method, settings.step * part);
            s.adopt(settings, &scheme);
            step((settings, &scheme), s, solver);
            whole_q.copy_from_slice(&s.q_next);
            whole_v.copy_from_slice(&s.v_next);
            let mut consistent = s.consistent > 0.0;
            let fastest = v.iter().fold(1.0_f64, |most, v| most.max(v.abs()));
            let error = if scheme.embedded {
                let [of_q, of_v] = [&s.l, &s.m].map(|stages| {
                    let row = |row: usize| scheme.error.iter().zip(stages).map(|(e, k)| e * k[row]).sum::<f64>().abs();
                    (0..v.len()).map(row).fold(0.0, f64::max)
                });
                add_work(settings, s);
                std::mem::swap(&mut s.q, &mut s.q_next);
                std::mem::swap(&mut s.v, &mut s.v_next);
                of_q.max(of_v / fastest)
            } else {
                let half = Scheme::new(settings.method, 0.5 * settings.step * part);
                s.adopt(settings, &half);
                for _ in 0..2 {
                    if consistent {
                        step((settings, &half), s, solver);
                        consistent = s.consistent > 0.0;
                        add_work(settings, s);
                        std::mem::swap(&mut s.q, &mut s.q_next);
                        std::mem::swap(&mut s.v, &mut s.v_next);
                    }
                }
                let size = |x: &[f64], y: &[f64]| x.iter().zip(y).fold(0.0_f64, |most, (x, y)| most.max((x - y).abs()));
                size(&s.q, &whole_q).max(size(&s.v, &whole_v) / fastest)
                    / (f64::from(settings.method.order()).exp2() - 1.0)
            };
            tried += 1;
            let interrupted = tried % 256 == 0 && interrupt::check().is_err();
            if solver.lost.is_some() || tried > MOST_CONTROLLED || interrupted {
                s.v.fill(f64::NAN);
                break;
            }
            if consistent && error <= accuracy {
                s.totals[ERROR] += error;
                made += 2.0;
                left = if is_last { 0.0 } else { left - part };
                let longer = 0.9 * (accuracy / error.max(1e-300)).powf(1.0 / (order + 1.0));
                // One that ends where a row is due does not shorten the next.
                length = if is_last { length.max(part * longer.min(5.0)) } else { part * longer.clamp(0.3, 5.0) };
                continue;
            }
            s.totals = totals;
            s.q.copy_from_slice(&q);
            s.v.copy_from_slice(&v);
            let returns =
                !consistent && scheme.step <= RETURNING && settings.set_valued.iter().any(|of| of.is_outside(&s.q));
            if part <= SHORTEST || returns {
                if consistent {
                    // Nothing shorter helps: the step is taken, and the report has its error.
                    std::mem::swap(&mut s.q, &mut whole_q);
                    std::mem::swap(&mut s.v, &mut whole_v);
                    s.totals[ERROR] += error;
                } else {
                    self.event(settings, scheme.step, s, solver, settings.step * (1.0 - left + part));
                    s.totals[EVENTS] += 1.0;
                    std::mem::swap(&mut s.q, &mut s.q_next);
                    std::mem::swap(&mut s.v, &mut s.v_next);
                }
                if !s.v.iter().chain(&s.q).all(|x| x.is_finite()) {
                    break;
                }
                made += 1.0;
                left = if is_last { 0.0 } else { left - part };
                length = FIRST;
                continue;
            }
            let shorter = 0.9 * (accuracy / error).powf(1.0 / (order + 1.0));
            length = part * if consistent && shorter.is_finite() { shorter.clamp(0.1, 0.5) } else { 0.25 };
            length = length.max(SHORTEST);
        }
        s.totals[LENGTH] = length;
        s.totals[SUBSTEPS] += made;
        s.totals[MOST] = s.totals[MOST].max(made);
    }

    /// One implicit Euler step with the set-valued law, to `q_next`, `v_next`.
    fn event(&mut self, settings: &StepSettings, h: f64, s: &mut Scratch<f64>, solver: &mut Checked, time: f64) {
        let scheme = Scheme::new(Method::ImplicitEuler, h);
        let by = (settings, &scheme);
        s.adopt(settings, &scheme);
        if settings.rubs {
            set_friction(by, s);
        }
        clear(&mut s.dry);
        clear(&mut s.control);
        stage(by, s, 0);
        self.given.copy_from_slice(&s.u);
        self.noise.copy_from_slice(&s.model.system.noise);
        self.graphs.clear();
        self.pieces.clear();
        for of in &settings.set_valued {
            let graph = Graph::new(of, (s.q[of.coordinate], s.v[of.row]), h);
            self.graphs.push(graph);
            self.pieces.push(graph.piece(s.v[of.row]));
        }
        let free = self.solve(settings, h, s, solver);
        self.locks.clear();
        self.note_locks(settings, h, s);
        for (x, next) in s.x.iter_mut().zip(&s.v_next) {
            *x = h * next;
        }
        // Positions are those of joints that reach their stops; velocities those of the rebound.
        self.reached.clear();
        let mut hits = Vec::new();
        for (i, of) in settings.set_valued.iter().enumerate() {
            let Piece::At(k) = self.pieces[i] else { continue };
            let Some((velocity, hold)) = self.graphs[i].velocity(self.pieces[i]) else { continue };
            let (bound, toward) = match hold {
                Hold::Friction => continue,
                Hold::Lower => (of.lower, -1.0),
                Hold::Upper => (of.upper, 1.0),
            };
            let (q, v) = (s.q[of.coordinate], s.v[of.row]);
            if toward * (q - bound) > 0.0 {
                continue;
            }
            self.reached.push((i, bound));
            if toward * v > 0.0 || velocity != 0.0 {
                let (back, slowing) = (settings.restitution * v * toward, free[of.row].abs());
                // A rebound that ends within the step, or that is no higher than the error, is none.
                let height = settings.accuracy.unwrap_or(0.0).max(1e-14 * (1.0 + q.abs()));
                let rests = !(back > 2.0 * h * slowing && back * back > 2.0 * slowing * height);
                hits.push((i, k, if rests { 0.0 } else { settings.restitution }));
            }
        }
        if !hits.is_empty() {
            self.rebound(settings, h, s, solver, &hits);
        }
        advance(&s.model, &s.q, &s.x, &mut s.q_next);
        for (row, bound) in &self.reached {
            s.q_next[settings.set_valued[*row].coordinate] = *bound;
        }
        for (i, of) in settings.set_valued.iter().enumerate() {
            let (piece, graph, torque) = (self.pieces[i], &self.graphs[i], self.torque[of.row]);
            let along = 0.5 * h * (s.v[of.row] + s.v_next[of.row]);
            let at_a_stop = graph.velocity(piece).is_some_and(|(_, hold)| hold != Hold::Friction);
            // Friction opposes the motion; at rest it takes up what it can.
            let rubbing = if at_a_stop && along != 0.0 {
                -of.friction * along.signum()
            } else {
                torque.clamp(-of.friction, of.friction)
            };
            s.totals[FRICTION] += rubbing * along;
            s.totals[STOPS] += (torque - rubbing) * along;
            let upper = match graph.velocity(piece) {
                Some((_, Hold::Lower)) if s.v[of.row] < 0.0 => false,
                Some((_, Hold::Upper)) if s.v[of.row] > 0.0 => true,
                _ => continue,
            };
            let impulse = h * (torque - rubbing);
            self.impacts.push(StopImpact { state: 0, row: of.row, upper, time, speed: s.v[of.row].abs(), impulse });
        }
        add_work(settings, s);
    }

    /// The velocities after impacts on stops, by J. J. Moreau's law: those of the rebounds, with restitution halved until the impacts give no kinetic energy.
    fn rebound(
        &mut self,
        settings: &StepSettings,
        h: f64,
        s: &mut Scratch<f64>,
        solver: &mut Checked,
        hits: &[(usize, usize, f64)],
    ) {
        const HALVINGS: i32 = 8;
        let (graphs, pieces, reached) = (self.graphs.clone(), self.pieces.clone(), s.v_next.clone());
        let energy = |s: &mut Scratch<f64>, v: &[f64], solver: &mut Checked| {
            s.model.system.noise.copy_from_slice(&settings.properties.armature);
            dynamics::kinetic_energy(&s.model, &mut solver.workspace, &s.q, v)
        };
        let (before, held) = (s.v.clone(), energy(s, &reached, solver));
        let most = energy(s, &before, solver).max(held);
        for halving in 0..=HALVINGS {
            let part = if halving == HALVINGS { 0.0 } else { 0.5_f64.powi(halving) };
            (self.graphs, self.pieces) = (graphs.clone(), pieces.clone());
            for &(i, k, restitution) in hits {
                let (of, kept) = (&settings.set_valued[i], part * restitution);
                self.graphs[i] = graphs[i].rebounding(k, (kept, s.v[of.row]), of.friction);
                self.pieces[i] = self.graphs[i].piece(-kept * s.v[of.row]);
            }
            self.solve(settings, h, s, solver);
            let after = s.v_next.clone();
            if energy(s, &after, solver) <= most * (1.0 + 1e-12) {
                break;
            }
        }
        s.model.system.noise.copy_from_slice(&self.noise);
        self.note_locks(settings, h, s);
    }

    /// Stores what the rows are locked at in the solution at hand, or the torque of those that move.
    fn note_locks(&mut self, settings: &StepSettings, h: f64, s: &Scratch<f64>) {
        let each = settings.set_valued.iter().zip(&self.graphs).zip(&self.pieces).map(|((of, graph), &piece)| {
            let Some((velocity, hold)) = graph.velocity(piece) else {
                return Lock { locked: 0.0, torque: graph.torque(piece), target: 0.0, slopes: [0.0; 2] };
            };
            let [by_q, by_v] = graph.slopes(hold);
            let target = (velocity - s.v[of.row]) / h;
            Lock { locked: 1.0, torque: 0.0, target, slopes: [by_q / h, (by_v - 1.0) / h] }
        });
        self.locks.push(Locks { rows: each.collect(), accelerations: s.m[0].clone() });
    }

    /// Accelerations and velocities at the end under the set-valued law; the accelerations of the first pieces.
    ///
    /// With a' = a - c, where c has the accelerations of the locked rows and zeros: (M + N + locks) a' = u + r - bias - (M + N) c, and the torque that holds a locked row is the lock's
    /// noise times -a'.
    fn solve(&mut self, settings: &StepSettings, h: f64, s: &mut Scratch<f64>, solver: &mut Checked) -> Vec<f64> {
        let Self { torque, given, noise, graphs, pieces, .. } = self;
        let (mut free, mut right) = (Vec::new(), vec![0.0; given.len()]);
        let settled = settle(pieces, |pieces, found| {
            let rows = || settings.set_valued.iter().zip(&*graphs).zip(pieces);
            s.m[0].fill(0.0);
            for ((of, graph), &piece) in rows() {
                if let Some((velocity, _)) = graph.velocity(piece) {
                    s.m[0][of.row] = (velocity - s.v[of.row]) / h;
                }
            }
            if let Some(coupling) = &settings.coupling {
                s.m[0] = coupling.rates(&coupling.independent_rates(&s.m[0]));
            }
            s.model.system.noise.copy_from_slice(noise);
            dynamics::inverse_dynamics(&s.model, &mut solver.workspace, &s.q, &s.v, &s.m[0], &[], torque);
            for ((right, given), torque) in right.iter_mut().zip(&*given).zip(&*torque) {
                *right = given - torque;
            }
            for ((of, graph), &piece) in rows() {
                if graph.velocity(piece).is_some() {
                    s.model.system.noise[of.row] = LOCKED;
                } else {
                    right[of.row] += graph.torque(piece);
                }
            }
            solver.factorise_and_solve(&s.model, &s.q, &right, &mut s.m[1]);
            s.model.system.noise.copy_from_slice(noise);
            for ((of, graph), &piece) in rows() {
                // The torque that holds a locked row, and the size of the torques whose difference it is.
                let held = graph.velocity(piece).map(|_| -(LOCKED * s.m[1][of.row]));
                torque[of.row] = held.unwrap_or_else(|| graph.torque(piece));
                right[of.row] = right[of.row].abs() + given[of.row].abs() + of.friction;
                if held.is_some() {
                    s.m[1][of.row] = 0.0;
                }
            }
            let [m, rest, ..] = &mut s.m;
            for (row, next) in s.v_next.iter_mut().enumerate() {
                m[row] += rest[row];
                *next = h.mul_add(m[row], s.v[row]);
            }
            for ((of, graph), &piece) in rows() {
                if let Some((velocity, _)) = graph.velocity(piece) {
                    s.v_next[of.row] = velocity;
                }
            }
            if free.is_empty() {
                free.clone_from(&s.m[0]);
            }
            let fastest = s.m[0].iter().fold(0.0_f64, |most, a| most.max(a.abs()));
            for (i, ((of, graph), &piece)) in rows().enumerate() {
                let change = match piece {
                    Piece::At(_) => graph.contradicted(piece, torque[of.row], ROUNDING_OF_TORQUES * right[of.row]),
                    Piece::Between(_) => {
                        let slow = ROUNDING * s.v[of.row].abs() + ROUNDING_OF_TORQUES * h * fastest;
                        graph.contradicted(piece, s.v_next[of.row], slow)
                    }
                };
                found.extend(change.map(|piece| (i, piece)));
            }
        });
        // Rounding moves no joint out of a stop, and turns none round.
        for ((of, graph), &piece) in settings.set_valued.iter().zip(&*graphs).zip(&*pieces) {
            s.v_next[of.row] = graph.within(piece, s.v_next[of.row]);
        }
        s.totals[UNSETTLED] += f64::from(u8::from(!settled));
        free
    }
}

/// The length that the error estimate of a refused substep asks for: its half or less.
fn shorter(by: By<'_>, s: &Scratch<f64>, size: u32) -> u32 {
    let excess = speeds_and_errors(by, s)
        .iter()
        .fold(0.0_f64, |most, (speed, error)| most.max(if *error > 0.0 { error / (by.1.share * speed) } else { 0.0 }));
    let mut shorter = size / 2;
    // The estimate falls with the square of the step at least.
    let mut reached = 4.0;
    while shorter > 1 && !(excess <= reached) && reached < 1e6 {
        shorter /= 2;
        reached *= 4.0;
    }
    shorter
}

/// The largest part of the kinetic energy, or of the largest work, that the error of an event may be.
const ENERGY: f64 = 1e-2;

/// True if the energy changes by the work in an event, up to the error that it may have; `totals` is that before it.
fn conserves(
    settings: &StepSettings,
    s: &mut Scratch<f64>,
    totals: &[f64; TOTALS],
    workspace: &mut Workspace<f64>,
) -> bool {
    s.model.system.noise.copy_from_slice(&settings.properties.armature);
    let before = dynamics::energy(&s.model, workspace, &s.q, &s.v);
    let after = dynamics::energy(&s.model, workspace, &s.q_next, &s.v_next);
    let change = after.kinetic - before.kinetic + after.potential - before.potential;
    let springs: f64 = s.rows.iter().zip(&s.displaced).zip(&s.x).map(|((of, away), x)| -of.stiffness * away * x).sum();
    let works = WORKS.map(|i| s.totals[i] - totals[i]);
    let exchanged = works.iter().fold(before.kinetic.max(after.kinetic), |most, work| most.max(work.abs()));
    (change - works.iter().sum::<f64>() - springs).abs() <= ENERGY * exchanged + f64::MIN_POSITIVE
}

/// The solution of an event.
pub(super) struct Event<'a> {
    /// Of each row with friction or stops: for positions and velocities, or where joints rebound, for positions, then for velocities.
    pub locks: &'a [Locks],
    /// Rows that end at a stop, indices in the list of these, and where.
    pub reached: &'a [(usize, f64)],
}

/// One solution of the set-valued law.
#[derive(Debug, Clone)]
pub(super) struct Locks {
    /// Of each row with friction or stops.
    pub rows: Vec<Lock>,
    /// The accelerations of all joints.
    pub accelerations: Vec<f64>,
}

/// The acceleration that one row is locked at in an event, or the torque of one that moves.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lock {
    /// One where it is locked, else zero.
    pub locked: f64,
    /// The torque of friction where it moves.
    pub torque: f64,
    /// The acceleration where it is locked, and its derivatives by q and v of the row.
    pub target: f64,
    pub slopes: [f64; 2],
}
