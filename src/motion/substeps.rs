//! One step of one state in substeps, which are short enough for fast motion and use the set-valued law when joints
//! stick, slip, or reach a stop.
//!
//! A substep whose modes change before its end is an *event*: one step of the implicit Euler method with the law of
//! [`stops`](super::stops) at its end. Its error is of second order if joints stick or slip, and such events are rare,
//! so that methods keep an order of up to two. The time of an impact is resolved to one step only, which is an error of
//! first order. At a stop the joint ends the step on the stop, with the rebound velocity, or at rest if the rebound
//! would end within the step.

use super::manifold::advance;
use super::method::{Method, Scheme};
use super::modes::{STUCK_NOISE, speeds_and_errors};
use super::scratch::{Scratch, clear};
use super::solver::Checked;
use super::step::{set_friction, stage, step};
use super::step_settings::{StepArguments, StepSettings};
use super::stops::{Graph, Hold, Piece, SetValued, settle};
use super::totals::{ERROR, EVENTS, FRICTION, LENGTH, MOST, STOPS, SUBSTEPS, TOTALS, UNSETTLED, WORKS};
use super::works::add_work;
use crate::dynamics;
use crate::interrupt;
use crate::workspace::Workspace;

/// Largest number of substeps of a step.
const MOST_SUBSTEPS: u32 = 1 << 10;

/// With error control, the first and the shortest substep, as fractions of the step.
const FIRST: f64 = 1e-2;
const SHORTEST: f64 = 1e-7;
/// The same for an event whose estimated error exceeds the bound.
const SHORTEST_EXACT: f64 = 1e-10;
/// Length of substeps in which a joint returns from outside of its stops, s; each of them is an event.
const RETURNING: f64 = 5e-4;
/// With error control, the largest number of substeps of a step.
const MOST_CONTROLLED: usize = 1_000_000;

/// Largest rotation of a joint in an event, rad, unless the substep has at most this length, in units of the shortest.
const EVENT_ANGLE: f64 = 5e-3;
const SHORTEST_EVENT: u32 = 1;

/// Number of substeps of one length before a longer one is tried.
const ROUNDS_BEFORE_LONGER: u32 = 4;

/// Relative rounding errors of velocities and of torques.
const ROUNDING: f64 = 1e-13;
const ROUNDING_OF_TORQUES: f64 = 1e-11;

/// An impact of a joint on one of its stops.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct StopImpact {
    /// Index of the state in the batch.
    pub state: usize,
    /// Index in qd of the degree of freedom.
    pub row: usize,
    /// True for the upper stop.
    pub upper: bool,
    /// Time of the end of the substep, s.
    pub time: f64,
    /// Speed before the impact, rad/s or m/s.
    pub speed: f64,
    /// Impulse of the stop on the joint, N m s or N s.
    pub impulse: f64,
}

/// Receives each accepted substep: its scheme, its initial state, and the solution of an event.
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
    solutions: Vec<EventSolution>,
    reached: Vec<(usize, f64)>,
    /// Impacts on stops, with the time since the start of the step.
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
            solutions: Vec::new(),
            reached: Vec::new(),
            impacts: Vec::new(),
        }
    }

    /// One step of the run from `q`, `v` to `q_next`, `v_next`. Calls `visit` before each substep is accepted, while
    /// `q` and `v` are still its initial state.
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
            Some(accuracy) => self.controlled((settings, accuracy), s, solver, visit),
            None => self.through(settings, s, solver, visit),
        }
        s.q_next.copy_from_slice(&s.q);
        s.v_next.copy_from_slice(&s.v);
        s.q.copy_from_slice(&self.q);
        s.v.copy_from_slice(&self.v);
    }

    /// All substeps, in place. Ends at a singular pivot or a result that is not finite.
    fn through(
        &mut self,
        settings: &StepSettings,
        s: &mut Scratch<f64>,
        solver: &mut Checked,
        visit: &mut Visitor<'_>,
    ) {
        // Lengths are in units of the shortest substep.
        let shortest = settings.step / f64::from(MOST_SUBSTEPS);
        let mut size = MOST_SUBSTEPS;
        let (mut left, mut calm, mut made, mut tried) = (MOST_SUBSTEPS, 0, 0_u32, 0_u32);
        while left > 0 {
            tried += 1;
            if tried % 64 == 0 && interrupt::check().is_err() {
                s.v.fill(f64::NAN);
                break;
            }
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
                && !(scheme.step * speeds_and_errors((settings, &scheme), s)[0].0 <= EVENT_ANGLE)
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
                visit(&scheme, s, Some(&Event { solutions: &self.solutions, reached: &self.reached }));
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
            if calm >= ROUNDS_BEFORE_LONGER && left % (2 * size) == 0 {
                (size, calm) = (2 * size, 0);
            }
        }
        s.totals[SUBSTEPS] += f64::from(made);
        s.totals[MOST] = s.totals[MOST].max(f64::from(made));
    }

    /// All substeps with error control, in place. The error estimate of each substep, from the embedded method or from
    /// the difference between one step and two of half its length, is within the bound. A change of modes ends a
    /// substep, by bisection until the estimated error of the event is within the bound too.
    #[allow(clippy::too_many_lines)] // one loop
    fn controlled(
        &mut self,
        (settings, accuracy): (&StepSettings, f64),
        s: &mut Scratch<f64>,
        solver: &mut Checked,
        visit: &mut Visitor<'_>,
    ) {
        // Order of the error estimate.
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
            let holds = |s: &Scratch<f64>, h: f64| {
                let passes = |of: &SetValued| of.passes((&s.q, &s.v), (&s.q_next, &s.v_next), h);
                s.consistent > 0.0 && !settings.set_valued.iter().any(passes)
            };
            let mut consistent = holds(s, scheme.step);
            let fastest = largest(&v, 1.0);
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
                        consistent = holds(s, half.step);
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
                at_start(s, (&mut q, &mut v), |s| visit(&scheme, s, None));
                s.totals[ERROR] += error;
                made += 2.0;
                left = if is_last { 0.0 } else { left - part };
                let longer = 0.9 * (accuracy / error.max(1e-300)).powf(1.0 / (order + 1.0));
                // A substep that is cut short by the end of the step does not shorten the next one.
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
                    // Shorter substeps do not help: the substep is accepted, and its error is reported.
                    std::mem::swap(&mut s.q, &mut whole_q);
                    std::mem::swap(&mut s.v, &mut whole_v);
                    s.totals[ERROR] += error;
                } else {
                    let impacts = self.impacts.len();
                    let error = self.event(settings, scheme.step, s, solver, settings.step * (1.0 - left + part));
                    if !(error <= accuracy) && part > SHORTEST_EXACT && !returns {
                        s.totals = totals;
                        self.impacts.truncate(impacts);
                        length = (0.25 * part).max(SHORTEST_EXACT);
                        continue;
                    }
                    s.totals[ERROR] += error;
                    s.totals[EVENTS] += 1.0;
                    std::mem::swap(&mut s.q, &mut s.q_next);
                    std::mem::swap(&mut s.v, &mut s.v_next);
                }
                if !s.v.iter().chain(&s.q).all(|x| x.is_finite()) {
                    break;
                }
                at_start(s, (&mut q, &mut v), |s| visit(&scheme, s, None));
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

    /// One implicit Euler step with the set-valued law, to `q_next`, `v_next`. Returns an estimate of its error, as of
    /// error control: velocities and accelerations change at an unknown time within the step, and rebounds are omitted.
    /// The motion of a joint that returns from outside of its stops is defined by these steps.
    fn event(&mut self, settings: &StepSettings, h: f64, s: &mut Scratch<f64>, solver: &mut Checked, time: f64) -> f64 {
        let scheme = Scheme::new(Method::ImplicitEuler, h);
        let by = (settings, &scheme);
        s.adopt(settings, &scheme);
        if settings.regularized {
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
        self.solutions.clear();
        self.store_solution(settings, h, s);
        for (x, next) in s.x.iter_mut().zip(&s.v_next) {
            *x = h * next;
        }
        // Positions come from the solution in which joints reach their stops, velocities from that of the rebound.
        self.reached.clear();
        let mut hits = Vec::new();
        let (fastest, mut omitted) = (largest(&s.v, 1.0), 0.0);
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
                // A rebound that ends within the step, or is neither higher nor faster than the error, is ignored.
                let rounding = 1e-14 * (1.0 + q.abs());
                let is_low = match settings.accuracy {
                    None => back * back <= 2.0 * slowing * rounding,
                    // A joint that accelerates away from its stop does not return.
                    Some(accuracy) => {
                        let height = accuracy.max(rounding);
                        back <= accuracy * fastest && back * back <= 2.0 * toward * free[of.row] * height
                    }
                };
                let rests = !(back > 2.0 * h * slowing) || is_low;
                if rests && back > 0.0 {
                    omitted += (back / fastest).max(back * back / (2.0 * slowing));
                }
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
            // Friction opposes the motion; at rest it compensates the other torques up to its bound.
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
        let jump = s.v_next.iter().zip(&s.v).fold(0.0_f64, |most, (next, v)| most.max((next - v).abs()));
        let returns = hits.is_empty() && settings.set_valued.iter().any(|of| of.is_outside(&s.q));
        let late = if returns { 0.0 } else { largest(&free, 0.0) / fastest };
        h * jump.max(late) + omitted
    }

    /// Velocities after impacts on stops, by J. J. Moreau's law: rebound velocities, with restitution halved until the
    /// impacts do not add kinetic energy.
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
        self.store_solution(settings, h, s);
    }

    /// Stores the accelerations of the stuck rows in the current solution, and the torques of the moving ones.
    fn store_solution(&mut self, settings: &StepSettings, h: f64, s: &Scratch<f64>) {
        let each = settings.set_valued.iter().zip(&self.graphs).zip(&self.pieces).map(|((of, graph), &piece)| {
            let Some((velocity, hold)) = graph.velocity(piece) else {
                return RowSolution { stuck: 0.0, torque: graph.torque(piece), target: 0.0, slopes: [0.0; 2] };
            };
            let [by_q, by_v] = graph.slopes(hold);
            let target = (velocity - s.v[of.row]) / h;
            RowSolution { stuck: 1.0, torque: 0.0, target, slopes: [by_q / h, (by_v - 1.0) / h] }
        });
        self.solutions.push(EventSolution { rows: each.collect(), accelerations: s.m[0].clone() });
    }

    /// Accelerations and final velocities under the set-valued law; returns the accelerations of the initial pieces.
    ///
    /// Let c have the prescribed accelerations of the stuck rows and zeros elsewhere, and a' = a - c. Then (M + N +
    /// noise of stuck rows) a' = u + r - bias - (M + N) c, and the torque that holds a stuck row is its noise times
    /// -a'.
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
                    s.model.system.noise[of.row] = STUCK_NOISE;
                } else {
                    right[of.row] += graph.torque(piece);
                }
            }
            solver.factorise_and_solve(&s.model, &s.q, &right, &mut s.m[1]);
            s.model.system.noise.copy_from_slice(noise);
            for ((of, graph), &piece) in rows() {
                // The torque that holds a stuck row, and the size of the torques whose difference it is.
                let held = graph.velocity(piece).map(|_| -(STUCK_NOISE * s.m[1][of.row]));
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
            let fastest = largest(&s.m[0], 0.0);
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
        // Prevents that rounding errors move a joint out of a stop or reverse its velocity.
        for ((of, graph), &piece) in settings.set_valued.iter().zip(&*graphs).zip(&*pieces) {
            s.v_next[of.row] = graph.within(piece, s.v_next[of.row]);
        }
        s.totals[UNSETTLED] += f64::from(u8::from(!settled));
        free
    }
}

/// Calls `visit` with the state at the start of a substep.
fn at_start(s: &mut Scratch<f64>, (q, v): (&mut Vec<f64>, &mut Vec<f64>), visit: impl FnOnce(&Scratch<f64>)) {
    let mut swap = |s: &mut Scratch<f64>| {
        std::mem::swap(&mut s.q, q);
        std::mem::swap(&mut s.v, v);
    };
    swap(s);
    visit(s);
    swap(s);
}

/// The largest absolute value, at least `least`.
pub(super) fn largest(x: &[f64], least: f64) -> f64 {
    x.iter().fold(least, |most, x| most.max(x.abs()))
}

/// The next length to try after a rejected substep: at most half, by the error estimate.
fn shorter(by: StepArguments<'_>, s: &Scratch<f64>, size: u32) -> u32 {
    let excess = speeds_and_errors(by, s)
        .iter()
        .fold(0.0_f64, |most, (speed, error)| most.max(if *error > 0.0 { error / (by.1.share * speed) } else { 0.0 }));
    let mut shorter = size / 2;
    // The estimate decreases at least with the square of the step.
    let mut reached = 4.0;
    while shorter > 1 && !(excess <= reached) && reached < 1e6 {
        shorter /= 2;
        reached *= 4.0;
    }
    shorter
}

/// Largest accepted energy error of an event, relative to the kinetic energy or to the largest work.
const ENERGY: f64 = 1e-2;

/// True if the energy change in an event equals the work, within the accepted error; `totals` are those before it.
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
    /// For the rows with friction or stops: one solution for positions and velocities, or, with rebounds, one for
    /// positions and one for velocities.
    pub solutions: &'a [EventSolution],
    /// Rows that end at a stop, as indices in that list, and their final coordinates.
    pub reached: &'a [(usize, f64)],
}

/// One solution of the set-valued law.
#[derive(Debug, Clone)]
pub(super) struct EventSolution {
    /// Per row with friction or stops.
    pub rows: Vec<RowSolution>,
    /// The accelerations of all joints.
    pub accelerations: Vec<f64>,
}

/// The prescribed acceleration of a stuck row in an event, or the torque of a moving row.
#[derive(Debug, Clone, Copy)]
pub(super) struct RowSolution {
    /// 1 if the row is stuck, else 0.
    pub stuck: f64,
    /// Friction torque of a moving row.
    pub torque: f64,
    /// Acceleration of a stuck row, and its derivatives by q and v of the row.
    pub target: f64,
    pub slopes: [f64; 2],
}
