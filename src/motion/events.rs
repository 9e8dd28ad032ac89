//! Steps of trees in which joints stick, slip, or reach a stop, with the set-valued law.
//!
//! A substep whose modes change before its end is an *event*: one step of the implicit Euler method with the law of
//! [`stops`](super::stops) at its end. Its error is of second order if joints stick or slip, and such events are rare,
//! so that methods keep an order of up to two. The time of an impact is resolved to one substep only, which is an error
//! of first order; a rebound is therefore an event of the shortest length. At a stop the joint ends the substep on the
//! stop, with the rebound velocity, or at rest if the rebound would end within the step.

use super::manifold::advance;
use super::method::{Method, Scheme};
use super::modes::STUCK_NOISE;
use super::scratch::{Scratch, clear};
use super::solver::Checked;
use super::step::{Part, do_part, set_friction};
use super::step_settings::StepSettings;
use super::stops::{Drive, Graph, Hold, Line, Piece, SetValued, settle};
use super::totals::{STOPS, TOTALS, UNSETTLED, WORKS};
use super::works::{RowWork, add_work};
use crate::batch::instruction_set::Baseline;
use crate::dynamics;
use crate::workspace::Workspace;

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

/// Length of an event, the time of its end, and the destination of its impacts on stops.
pub(super) type Ending<'a> = (f64, f64, &'a mut Vec<StopImpact>);

/// Scratch for events.
#[derive(Debug)]
pub(super) struct Events {
    torque: Vec<f64>,
    given: Vec<f64>,
    noise: Vec<f64>,
    graphs: Vec<Graph>,
    pieces: Vec<Piece>,
    solutions: Vec<EventSolution>,
    reached: Vec<(usize, f64)>,
    rebound: Option<Rebound>,
    reversals: Vec<Reversal>,
}

impl Events {
    pub fn new(settings: &StepSettings, s: &Scratch<f64>) -> Self {
        let (rows, count) = (|| vec![0.0; s.v.len()], settings.set_valued.len());
        Self {
            torque: rows(),
            given: rows(),
            noise: rows(),
            graphs: Vec::with_capacity(count),
            pieces: Vec::with_capacity(count),
            solutions: Vec::new(),
            reached: Vec::new(),
            rebound: None,
            reversals: Vec::new(),
        }
    }

    /// The solution of the last event.
    pub fn solution(&self) -> Event<'_> {
        let Self { solutions, reached, rebound, reversals, .. } = self;
        Event { solutions, reached, rebound: rebound.as_ref(), reversals }
    }

    /// The forces of an implicit Euler step from `q`, `v`, and the graphs and initial pieces of the rows.
    fn begin(&mut self, settings: &StepSettings, h: f64, s: &mut Scratch<f64>) {
        let scheme = Scheme::new(Method::ImplicitEuler, h);
        let by = (settings, &scheme);
        s.adopt(settings, &scheme);
        s.release_drives(settings, h);
        if settings.regularized {
            set_friction(by, s);
        }
        clear(&mut s.dry);
        clear(&mut s.control);
        do_part(Baseline, Part::Stage(0), by, s);
        self.given.copy_from_slice(&s.u);
        self.noise.copy_from_slice(&s.model.system.noise);
        self.graphs.clear();
        self.pieces.clear();
        for of in &settings.set_valued {
            let drive = of.drives.then(|| Drive::of(settings, s, (of.row, false), h));
            let u = s.u[of.row] + drive.map_or(0.0, |drive| drive.torque(s.v[of.row]));
            let graph = Graph::new(&s.at_start(of, u), (s.q[of.coordinate], s.v[of.row]), h, drive);
            self.graphs.push(graph);
            self.pieces.push(graph.piece(s.v[of.row]));
        }
    }

    /// Accelerations of all joints after an event of length h with an impact, for its adjoint. Leaves `q` and `v` of
    /// the scratch, and overwrites the solution.
    pub fn accelerations_after(
        &mut self,
        settings: &StepSettings,
        (h, rebound): (f64, &Rebound),
        s: &mut Scratch<f64>,
        solver: &mut Checked,
    ) -> Vec<f64> {
        let before = (s.q.clone(), std::mem::replace(&mut s.v, rebound.velocities.clone()));
        for of in settings.set_valued.iter().filter(|of| rebound.rows.contains(&of.row)) {
            s.q[of.coordinate] = if before.1[of.row] > 0.0 { of.upper } else { of.lower };
        }
        self.begin(settings, h, s);
        self.solve(settings, h, s, solver);
        (s.q, s.v) = before;
        s.v_next.iter().zip(&rebound.velocities).map(|(next, v)| (next - v) / h).collect()
    }

    /// One implicit Euler step with the set-valued law, to `q_next`, `v_next`. Returns an estimate of its error, as of
    /// error control: velocities and accelerations change at an unknown time within the step, and rebounds are omitted.
    /// The motion of a joint that returns from outside of its stops is defined by these steps. Adds the impacts on
    /// stops, with the given time.
    pub fn event(
        &mut self,
        settings: &StepSettings,
        s: &mut Scratch<f64>,
        solver: &mut Checked,
        (h, time, impacts): Ending<'_>,
    ) -> f64 {
        self.begin(settings, h, s);
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
                let (back, slowing) = (settings.given.restitution * v * toward, free[of.row].abs());
                // A rebound that ends within the step, or is neither higher nor faster than the error, is ignored.
                let rounding = 1e-14 * (1.0 + q.abs());
                let is_low = match settings.given.accuracy {
                    None => back * back <= 2.0 * slowing * rounding,
                    // A joint that accelerates away from its stop does not return.
                    Some(accuracy) => {
                        let height = accuracy.max(rounding);
                        back <= accuracy * fastest && back * back <= 2.0 * toward * free[of.row] * height
                    }
                };
                let longest = if settings.given.accuracy.is_none() { settings.step } else { h };
                let rests = !(back > 2.0 * longest * slowing) || is_low;
                if rests && back > 0.0 {
                    omitted += (back / fastest).max(back * back / (2.0 * slowing));
                }
                hits.push((i, k, if rests { 0.0 } else { settings.given.restitution }));
            }
        }
        self.reversals.clear();
        if hits.is_empty() {
            let change: Vec<f64> = s.m[0].iter().zip(&free).map(|(after, before)| h * (after - before)).collect();
            let each = settings.set_valued.iter().zip(self.graphs.iter().zip(&self.pieces));
            self.reversals.extend(each.filter(|(of, _)| of.rubs()).filter_map(|(of, (graph, &piece))| {
                let hold = graph.velocity(piece).map(|(_, hold)| hold);
                Reversal::new((of.row, graph.friction, hold), self.torque[of.row], (&s.v, &s.v_next), &change)
            }));
        } else {
            self.rebound(settings, h, s, solver, &hits);
        }
        advance(&s.model, &s.q, &s.x, &mut s.q_next);
        for (row, bound) in &self.reached {
            s.q_next[settings.set_valued[*row].coordinate] = *bound;
        }
        for (i, of) in settings.set_valued.iter().enumerate() {
            if of.drives {
                s.control[of.row] = h * self.graphs[i].line(self.pieces[i]).at(s.v_next[of.row]);
            }
            let impulse = self.work(i, of, h, s).add(s);
            let upper = match self.graphs[i].velocity(self.pieces[i]) {
                Some((_, Hold::Lower)) if s.v[of.row] < 0.0 => false,
                Some((_, Hold::Upper)) if s.v[of.row] > 0.0 => true,
                _ => continue,
            };
            impacts.push(StopImpact { state: 0, row: of.row, upper, time, speed: s.v[of.row].abs(), impulse });
        }
        add_work(settings, s);
        let hitting = |&(i, ..): &(usize, usize, f64)| {
            let row = settings.set_valued[i].row;
            (s.v[row] * self.torque[row] < 0.0).then_some(row)
        };
        let rows: Vec<usize> = hits.iter().filter_map(hitting).collect();
        self.rebound = (!rows.is_empty()).then(|| Rebound {
            rows,
            velocities: s.v_next.clone(),
            accelerations_before: free.clone(),
        });
        let jump = s.v_next.iter().zip(&s.v).fold(0.0_f64, |most, (next, v)| most.max((next - v).abs()));
        let returns = hits.is_empty() && settings.set_valued.iter().any(|of| of.is_outside(&s.q));
        let late = if returns { 0.0 } else { largest(&free, 0.0) / fastest };
        h * jump.max(late) + omitted
    }

    /// The works of friction and stop of a row in the current solution.
    fn work(&self, i: usize, of: &SetValued, h: f64, s: &Scratch<f64>) -> RowWork {
        let hold = self.graphs[i].velocity(self.pieces[i]).map(|(_, hold)| hold);
        RowWork::new((of.row, self.graphs[i].friction), (h, self.torque[of.row], hold), s)
    }

    /// Velocities after impacts on stops, by J. J. Moreau's law: rebound velocities, with restitution halved until the
    /// impacts do not add kinetic energy.
    ///
    /// With impulses p of the rows and h f of all other forces, M (v' - v) = h f + p, so that the kinetic energy
    /// changes by (h f + p)' (v + v')/2, of which p' (v + v')/2 is the part of the impacts.
    fn rebound(
        &mut self,
        settings: &StepSettings,
        h: f64,
        s: &mut Scratch<f64>,
        solver: &mut Checked,
        hits: &[(usize, usize, f64)],
    ) {
        const HALVINGS: i32 = 8;
        let (graphs, pieces) = (self.graphs.clone(), self.pieces.clone());
        for halving in 0..=HALVINGS {
            let part = if halving == HALVINGS { 0.0 } else { 0.5_f64.powi(halving) };
            (self.graphs, self.pieces) = (graphs.clone(), pieces.clone());
            for &(i, k, restitution) in hits {
                let (of, kept) = (&settings.set_valued[i], part * restitution);
                self.graphs[i] = graphs[i].rebounding(k, (kept, s.v[of.row]));
                self.pieces[i] = self.graphs[i].piece(-kept * s.v[of.row]);
            }
            self.solve(settings, h, s, solver);
            let (mut added, mut size) = (0.0, 0.0);
            for (i, of) in settings.set_valued.iter().enumerate() {
                let work = self.work(i, of, h, s).stop;
                added += work;
                size += work.abs();
            }
            if added <= ROUNDING_OF_TORQUES * size {
                break;
            }
        }
        self.store_solution(settings, h, s);
    }

    /// Stores the accelerations of the stuck rows in the current solution, and the torques of the moving ones.
    fn store_solution(&mut self, settings: &StepSettings, h: f64, s: &Scratch<f64>) {
        let each = settings.set_valued.iter().zip(&self.graphs).zip(&self.pieces).map(|((of, graph), &piece)| {
            let driven = graph.line(piece);
            let Some((velocity, hold)) = graph.velocity(piece) else {
                let torque = graph.torque(piece);
                return RowSolution { stuck: 0.0, torque, target: 0.0, slopes: [0.0; 2], driven };
            };
            let [by_q, by_v] = graph.slopes(hold);
            let target = (velocity - s.v[of.row]) / h;
            RowSolution { stuck: 1.0, torque: 0.0, target, slopes: [by_q / h, (by_v - 1.0) / h], driven }
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
            for ((of, graph), &piece) in rows() {
                s.model.system.noise[of.row] += h * graph.line(piece).slope;
            }
            dynamics::inverse_dynamics(&s.model, &mut solver.workspace, &s.q, &s.v, &s.m[0], &[], torque);
            for ((right, given), torque) in right.iter_mut().zip(&*given).zip(&*torque) {
                *right = given - torque;
            }
            for ((of, graph), &piece) in rows() {
                if graph.velocity(piece).is_some() {
                    s.model.system.noise[of.row] = STUCK_NOISE;
                } else {
                    right[of.row] += graph.torque(piece) + graph.line(piece).at(s.v[of.row]);
                }
            }
            solver.factorise_and_solve(&s.model, &s.q, &right, &mut s.m[1]);
            s.model.system.noise.copy_from_slice(noise);
            for ((of, graph), &piece) in rows() {
                // The torque that holds a stuck row, and the size of the torques whose difference it is.
                let driven = graph.line(piece);
                let held = graph.velocity(piece).map(|_| -(STUCK_NOISE * s.m[1][of.row]));
                torque[of.row] = held.map_or_else(|| graph.torque(piece), |held| held - driven.torque);
                let size = driven.torque.abs() + (driven.slope * s.v[of.row]).abs();
                right[of.row] =
                    right[of.row].abs() + given[of.row].abs() + graph.friction[0].max(graph.friction[1]) + size;
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
                let slow = ROUNDING * s.v[of.row].abs() + ROUNDING_OF_TORQUES * h * fastest;
                let value = match piece {
                    Piece::At(_) => torque[of.row] + graph.line(piece).torque,
                    Piece::Between(_) => s.v_next[of.row],
                };
                let change = graph.contradicted(piece, value, [slow, ROUNDING_OF_TORQUES * right[of.row]]);
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

/// The largest absolute value, at least `least`.
pub(super) fn largest(x: &[f64], least: f64) -> f64 {
    x.iter().fold(least, |most, x| most.max(x.abs()))
}

/// Largest accepted energy error of an event, relative to the kinetic energy or to the largest work.
const ENERGY: f64 = 1e-2;

/// The same for the work of stops on joints of loops, which the curvature of connections moves away from their stops.
const CURVED: f64 = 1e-6;

/// True if the energy change in an event equals the work, within the accepted error, and if stops add none to joints
/// within their limits: a joint that leaves its stop and returns within the step would. `totals` are those before it,
/// and `returns` is true if some joint is outside of its stops.
pub(super) fn conserves(
    settings: &StepSettings,
    s: &mut Scratch<f64>,
    (totals, returns): (&[f64; TOTALS], bool),
    workspace: &mut Workspace<f64>,
) -> bool {
    s.model.system.noise.copy_from_slice(&settings.properties.armature);
    let before = dynamics::energy(&s.model, workspace, &s.q, &s.v);
    let after = dynamics::energy(&s.model, workspace, &s.q_next, &s.v_next);
    let change = after.kinetic - before.kinetic + after.potential - before.potential;
    let springs: f64 = s.rows.iter().zip(&s.displaced).zip(&s.x).map(|((of, away), x)| -of.stiffness * away * x).sum();
    let works = WORKS.map(|i| s.totals[i] - totals[i]);
    let exchanged = works.iter().fold(before.kinetic.max(after.kinetic), |most, work| most.max(work.abs()));
    let accepted = if settings.connected { CURVED } else { ROUNDING_OF_TORQUES };
    let pushes = !returns && s.totals[STOPS] - totals[STOPS] > accepted * exchanged;
    !pushes && (change - works.iter().sum::<f64>() - springs).abs() <= ENERGY * exchanged + f64::MIN_POSITIVE
}

/// The solution of an event.
pub(super) struct Event<'a> {
    /// For the rows with friction or stops: one solution for positions and velocities, or, with rebounds, one for
    /// positions and one for velocities.
    pub solutions: &'a [EventSolution],
    /// Rows that end at a stop, as indices in that list, and their final coordinates.
    pub reached: &'a [(usize, f64)],
    pub rebound: Option<&'a Rebound>,
    pub reversals: &'a [Reversal],
}

/// The end of the sliding of a joint within a step, whose velocity `v_i` crosses zero with accelerations a before and
/// a+ after. A change dv of `v_i` makes this later by -dv/`a_i`, and changes the velocities after it by (a+ - a)
/// dv/`a_i` (as for [`Rebound`]), `v_i` itself to (`a+_i`/`a_i`) dv. In the step, in which the friction at the end acts
/// from the start on, it changes by dv if it slides back, or by zero if it ends at rest, from where it may slide back
/// later.
#[derive(Debug, Clone)]
pub(super) struct Reversal {
    row: usize,
    /// The derivatives of all velocities at the end by `v_i`, besides those of the step.
    by_rate: Vec<f64>,
}

/// The torque of sliding friction at velocity v.
pub(super) fn sliding([back, ahead]: [f64; 2], v: f64) -> f64 {
    if v > 0.0 { -ahead } else { back }
}

impl Reversal {
    /// For a row with the torque of friction at the end of the step, the velocities at its start and end, and their
    /// `change` by the change of the torque since the start. `None` if the velocity does not cross zero.
    pub fn new(
        (row, friction, hold): (usize, [f64; 2], Option<Hold>),
        torque: f64,
        (v, next): (&[f64], &[f64]),
        change: &[f64],
    ) -> Option<Self> {
        let (before, after) = (sliding(friction, v[row]), sliding(friction, -v[row]));
        let (own, slowing) = (change[row], next[row] - v[row] - change[row]);
        let crosses = v[row] * next[row] <= 0.0 && v[row] * slowing < 0.0 && own != 0.0;
        (crosses && matches!(hold, None | Some(Hold::Friction))).then(|| {
            let kept = (1.0 + own * (after - before) / ((torque - before) * slowing)).clamp(0.0, 1.0);
            let more = (kept - f64::from(u8::from(hold.is_none()))) / own;
            Self { row, by_rate: change.iter().map(|x| more * x).collect() }
        })
    }

    /// Adds the gradients by the velocities at the start, from those by the velocities at the end. Of several joints
    /// that reverse in one step, each changes its own motion only.
    pub fn add(reversals: &[Self], of_v: &[f64], start: &mut [f64]) {
        for Self { row, by_rate } in reversals {
            let each = by_rate.iter().zip(of_v).enumerate().filter(|(i, _)| reversals.len() == 1 || i == row);
            start[*row] += each.map(|(_, (by_rate, of_v))| by_rate * of_v).sum::<f64>();
        }
    }
}

/// An event in which joints hit their stops, and rebound or stay there, seen as an instant: with other initial states
/// the impact is at another time.
#[derive(Debug, Clone)]
pub(super) struct Rebound {
    /// The rows that hit a stop.
    pub rows: Vec<usize>,
    /// The velocities of all joints after it.
    pub velocities: Vec<f64>,
    /// The accelerations of all joints before it.
    pub accelerations_before: Vec<f64>,
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
    /// The torque of its control law with limits of effort.
    pub driven: Line,
}
