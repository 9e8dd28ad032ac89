//! One step of one state with contacts.

use super::super::faults::fault_of;
use super::super::limit_rows::{least_velocity, limit_rows, rebounds, settle_at};
use super::super::scratch::Scratch;
use super::super::solver::Checked;
use super::super::step::step;
use super::super::step_settings::StepSettings;
use super::super::substeps::StopImpact;
use super::super::totals::STOPS;
use super::super::works::add_work;
use super::project::out_of_planes;
use super::record::{Laws, StepRecord};
use super::report::ContactReport;
use crate::contact::{Cone, ContactState, Effort, Impact, Limits, SolveReport, impact, passive};
use crate::dynamics::contacts::ContactScratch;
use crate::dynamics::forward::factorise;
use crate::error::Error;
use crate::filter::Form;
use crate::joints::Motion;
use crate::model::Model;
use crate::scene::Scene;
use crate::scene::contact_point::ContactPoint;
use crate::spatial::RigidShift;
use nalgebra::{DVector, Matrix3, Vector3};

/// A residual above this is an error; a residual between the tolerance and this value is accepted.
const REFUSED: f64 = 1e-5;

/// An inactive contact becomes active if the step ends with a larger penetration, m.
const LATE: f64 = 1e-12;

/// Scratch memory for one state.
pub(super) struct ContactStep {
    pub solver: Checked,
    pub rows: ContactScratch,
    /// Impacts of joints on stops in the last step.
    pub impacts: Vec<StopImpact>,
    /// The last step, if its adjoint follows.
    pub record: Option<StepRecord>,
}

/// Gaps and velocities of contacts at the start of a step.
#[derive(Debug, Clone)]
pub(super) struct StepStart {
    pub gaps: Vec<f64>,
    /// J v, and J times the velocities without contacts.
    pub start: DVector<f64>,
    pub free: DVector<f64>,
}

/// Results of the contacts in a step.
pub(super) struct Outcome {
    pub near: Vec<usize>,
    /// Impulses of impacts, and impulses of persistent contact.
    pub hit: Option<Impact>,
    held: DVector<f64>,
    pub states: Vec<ContactState>,
    report: ContactReport,
    /// Velocities at the end, if joints that reach a stop end the step slower than they moved in it.
    slowed: Option<Vec<f64>>,
    /// The solves of the law, if they are recorded.
    pub laws: Option<Laws>,
}

impl Outcome {
    /// The result without active contacts.
    fn nothing() -> Self {
        Self {
            near: Vec::new(),
            hit: None,
            held: DVector::zeros(0),
            states: Vec::new(),
            report: ContactReport::nothing(),
            slowed: None,
            laws: None,
        }
    }
}

impl ContactStep {
    pub fn new(scene: &Scene, settings: &StepSettings, form: Form) -> Self {
        let limits = if settings.stops { limit_rows(scene) } else { Vec::new() };
        Self {
            solver: Checked::new(scene.model(), None, form).accepting(settings.tolerance),
            rows: ContactScratch::new(scene.model(), scene.contact_points(), limits),
            impacts: Vec::new(),
            record: None,
        }
    }

    /// One step from `q`, `v` to `q_next`, `v_next`; stores impulses and report in `kept`. Returns the joint and the
    /// error if it fails.
    pub fn step(
        &mut self,
        scene: &Scene,
        settings: &StepSettings,
        s: &mut Scratch<f64>,
        kept: &mut [f64],
    ) -> Result<(), (String, Error)> {
        step((settings, &settings.scheme), s, &mut self.solver);
        let lost = self.solver.lost.take();
        if let Some(fault) = fault_of(scene, settings, s, lost) {
            return Err(fault);
        }
        let (h, points) = (settings.step, scene.contact_points());
        to_axes_at_rest(&s.model, h, &s.v, &mut s.v_next);
        self.rows.place(&s.model, points, &s.q);
        let start = self.rows.velocities(&s.model, points, &s.v);
        let free = self.rows.velocities(&s.model, points, &s.v_next);
        let before = StepStart { gaps: self.rows.gaps.clone(), start, free };
        let v_free = self.record.is_some().then(|| s.v_next.clone());
        let mut outcome = self.touch(scene, settings, s, &before, kept)?;
        self.record = v_free.map(|v_free| StepRecord::new(v_free, &s.v_next, &before, &mut outcome));
        move_along(h, s);
        if let Some(slowed) = outcome.slowed.take() {
            s.v_next = slowed;
        }
        add_work(settings, s);
        let ends = axes_of_free_joints(&s.model, &s.q, &s.q_next);
        let workspace = &mut self.solver.workspace;
        let ways = (&mut s.q_next[..], &mut s.q_stage[..]);
        let pushes = self.record.as_mut().map(|record| &mut record.pushes);
        let (depth, iterations) = out_of_planes(&s.model, points, workspace, &mut self.rows, ways, pushes)
            .map_err(|lost| pivot_fault(scene, lost.stage, scene.singular(lost)))?;
        for (row, turn) in ends {
            rotated(&mut s.v_next[row..], &turn);
        }
        self.settle(settings, s, &before, &outcome, points.len());
        keep(kept, &outcome, points.len());
        #[allow(clippy::cast_precision_loss)] // a small count
        let iterations = outcome.report.iterations + iterations as f64;
        ContactReport::add(kept, &ContactReport { iterations, depth, ..outcome.report });
        fault_of(scene, settings, s, None).map_or(Ok(()), Err)
    }

    /// Applies impacts and contact forces of the step to `v_next`.
    fn touch(
        &mut self,
        scene: &Scene,
        settings: &StepSettings,
        s: &mut Scratch<f64>,
        before: &StepStart,
        kept: &[f64],
    ) -> Result<Outcome, (String, Error)> {
        let Self { solver, rows, record, .. } = self;
        let (workspace, points, h, records) =
            (&mut solver.workspace, scene.contact_points(), settings.step, record.is_some());
        let StepStart { gaps, start, free } = before;
        let (n, all_rows) = (points.len(), gaps.len());
        let mut near: Vec<usize> =
            (0..all_rows).filter(|&i| gaps[i] <= 0.0 || gaps[i] + h * free[3 * i + 2] <= 0.0).collect();
        let mut outcome = Outcome::nothing();
        if near.is_empty() {
            return Ok(outcome);
        }
        let pivots = factorise(&s.model, workspace, &s.q);
        if let Some(lost) = workspace.lost_pivot(&s.model, &pivots) {
            return Err(pivot_fault(scene, lost.stage, scene.singular(lost)));
        }
        // The velocity that gravity adds in a step: slower rebounds would last less than two steps.
        let rest_speed = s.model.gravity.norm() * h;
        let v_free = s.v_next.clone();
        let mut iterations = 0;
        for _ in 0..=all_rows {
            let pick =
                |all: &dyn Fn(usize) -> f64| DVector::from_fn(3 * near.len(), |i, _| all(3 * near[i / 3] + i % 3));
            let friction = near.iter().map(|&i| points.get(i).map_or(0.0, |point| point.friction)).collect();
            let cone = Cone::new(rows.gram(&s.model, points, workspace, &near), friction);
            check_movable(scene, &near, &cone)?;
            let free_here = pick(&|i| free[i]);
            let rebound = restitutions(points, &near, (start, free), (rest_speed, settings.restitution));
            let mut u = free_here.clone();
            let mut warm = Some(pick(&|i| if i < 3 * n { kept[i] } else { 0.0 }));
            let touching = near.iter().filter(|&&i| i < n).count();
            let (mut hit, mut lost) = (None, 0.0);
            if rebound.iter().any(|&e| e > 0.0) {
                let middle = (pick(&|i| start[i]) + &u) * 0.5;
                let struck = impact(&cone, &middle, &rebound, Effort::default());
                lost = lost_at_contacts(&cone, &middle, &struck.impulses, touching);
                u += &cone.g * &struck.impulses;
                warm = None;
                hit = Some(struck);
            }
            let mut c = u.clone();
            for (at, &i) in near.iter().enumerate() {
                c[3 * at + 2] -=
                    if i < n { -gaps[i].max(0.0) / h } else { least_velocity(gaps[i], start[3 * i + 2], h) };
            }
            let mut limits = Limits::beside(&c);
            limits.scale = limits.scale.max(free_here.amax());
            let (held, mut solved) = cone.impulses(&c, warm.as_ref(), &limits, Effort::default());
            // A joint that returns from outside of its limits gains energy.
            let returns = near.iter().any(|&i| i >= n && gaps[i] < 0.0);
            let (mut held, mut impulse_kept) = if returns { (held, 1.0) } else { passive(&cone, &u, held) };
            let mut all = held.clone();
            if let Some(hit) = &hit {
                all += &hit.impulses;
                solved = solved.with(hit.solved);
                impulse_kept = impulse_kept.min(hit.impulse_kept);
            }
            iterations += solved.iterations;
            rows.respond(&s.model, points, workspace, &near, &all);
            for (i, v) in s.v_next.iter_mut().enumerate() {
                *v = v_free[i] + rows.response[i];
            }
            let after = rows.velocities(&s.model, points, &s.v_next);
            let late = |i: &usize| !near.contains(i) && gaps[*i].max(0.0) + h * after[3 * *i + 2] < -LATE;
            let late: Vec<usize> = (0..all_rows).filter(late).collect();
            if late.is_empty() {
                let arrives = |at: usize| near[at] >= n && gaps[near[at]] > 0.0 && held[3 * at + 2] > 0.0;
                let arriving: Vec<usize> = (touching..near.len()).filter(|&at| arrives(at)).collect();
                let mut after = after;
                let middle = || (pick(&|i| start[i]) + &free_here) * 0.5;
                outcome.laws = records.then(|| Laws::new(&cone, &rebound, middle(), (&c, &held), &arriving));
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
                    rows.respond(&s.model, points, workspace, &near, &all);
                    let slowed: Vec<f64> = v_free.iter().zip(&rows.response).map(|(v, dv)| v + dv).collect();
                    after = rows.velocities(&s.model, points, &slowed);
                    outcome.slowed = Some(slowed);
                }
                let after_here = pick(&|i| after[i]);
                let landed = |at: usize| start[3 * near[at] + 2] < -rest_speed;
                let (hit_now, velocities) = ((lost, hit.as_ref()), (&held, &u, &after_here));
                outcome.report = report(&solved, iterations, impulse_kept, hit_now, velocities, (touching, &landed));
                check(scene, &near, &solved)?;
                outcome.states = cone.states(&held, &c, &limits);
                if let Some(hit) = &hit {
                    states_of_rebounds(&cone, &hit.impulses, &mut outcome.states);
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

/// Coefficient of restitution of each contact and joint limit in this step: zero if it does not rebound.
fn restitutions(
    points: &[ContactPoint],
    near: &[usize],
    (start, free): (&DVector<f64>, &DVector<f64>),
    (rest_speed, of_stops): (f64, f64),
) -> Vec<f64> {
    let each = near.iter().map(|&i| match (points.get(i), start[3 * i + 2]) {
        (Some(point), speed) if speed < -rest_speed => point.restitution,
        (None, speed) if rebounds(speed, free[3 * i + 2], of_stops) => of_stops,
        _ => 0.0,
    });
    each.collect()
}

/// Kinetic energy dissipated by an impact at contacts, without joint limits, J, for velocities u.
fn lost_at_contacts(cone: &Cone, u: &DVector<f64>, impulses: &DVector<f64>, contacts: usize) -> f64 {
    let change = &cone.g * impulses;
    -(0..3 * contacts).map(|i| impulses[i] * (u[i] + 0.5 * change[i])).sum::<f64>()
}

/// Sets the states of contacts that had an impact but no persistent force to their state during the impact.
fn states_of_rebounds(cone: &Cone, impulses: &DVector<f64>, states: &mut [ContactState]) {
    /// Rounding errors relative to the largest impulse and to the friction bound.
    const ROUNDING: f64 = 1e-9;
    let largest = impulses.amax();
    for (i, state) in states.iter_mut().enumerate().filter(|(_, state)| **state == ContactState::Open) {
        let (pressed, drag) = (impulses[3 * i + 2], impulses[3 * i].hypot(impulses[3 * i + 1]));
        if pressed > ROUNDING * largest {
            let sticks = drag < (1.0 - ROUNDING) * cone.friction[i] * pressed;
            *state = if sticks { ContactState::Sticking } else { ContactState::Sliding };
        }
    }
}

/// The report of a step, for contact velocities u before the persistent impulses and `after` them; the first rows are
/// those of contacts.
fn report(
    solved: &SolveReport,
    iterations: usize,
    impulse_kept: f64,
    (lost, hit): (f64, Option<&Impact>),
    (held, u, after): (&DVector<f64>, &DVector<f64>, &DVector<f64>),
    (touching, landed): (usize, &dyn Fn(usize) -> bool),
) -> ContactReport {
    let (mut impacts, mut friction) = (lost, 0.0);
    for at in 0..touching {
        let (p, u, after) = (held.fixed_rows::<3>(3 * at), u.fixed_rows::<3>(3 * at), after.fixed_rows::<3>(3 * at));
        if landed(at) {
            impacts -= 0.5 * p.dot(&(u + after));
        } else {
            friction -= p[0] * after[0] + p[1] * after[1];
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
        depth: 0.0,
    }
}

/// Returns an error for a solve with a large residual.
fn check(scene: &Scene, near: &[usize], solved: &SolveReport) -> Result<(), (String, Error)> {
    if solved.residual <= REFUSED {
        return Ok(());
    }
    let found = format!("a residual of {:.1e} after {} iterations", solved.residual, solved.iterations);
    let expected =
        "impulses with a residual of at most 1e-5 of the fastest contact velocity: take a smaller dt, or less friction";
    Err((String::new(), Error::argument(named(scene, near), found, expected)))
}

/// Returns an error for a contact that no joint can move.
fn check_movable(scene: &Scene, near: &[usize], cone: &Cone) -> Result<(), (String, Error)> {
    let Some(at) = cone.lengths.iter().position(|r| !r.is_finite()) else { return Ok(()) };
    let found = "a point that no joint can move in this configuration";
    let error = Error::argument(named(scene, &near[at..=at]), found, "contacts that joints can move");
    Err((String::new(), error))
}

/// Text that names some contacts. Joint limits are excluded, because they can always be satisfied.
fn named(scene: &Scene, which: &[usize]) -> String {
    let points = which.iter().filter_map(|&i| scene.contact_points().get(i));
    let names: Vec<String> = points.take(8).map(|point| format!("{:?}", point.name)).collect();
    let more = if which.len() > names.len() { ", ..." } else { "" };
    format!("contact{} {}{more}", if which.len() == 1 { "" } else { "s" }, names.join(", "))
}

/// The fault of a singular pivot, with its joint.
fn pivot_fault(scene: &Scene, body: usize, error: Error) -> (String, Error) {
    (scene.joint_of_body(body).map(|joint| joint.name.clone()).unwrap_or_default(), error)
}

/// Stores the results of a step: persistent impulses, sums of the impulses of impacts, and contact states.
fn keep(kept: &mut [f64], outcome: &Outcome, contacts: usize) {
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

/// Index in qd of the first velocity of each free joint, and the body that it moves.
pub(super) fn free_joints(model: &Model<f64>) -> impl Iterator<Item = (usize, usize)> {
    let each = model.bodies.iter().zip(&model.system.stages).enumerate();
    each.filter(|(_, (body, _))| body.motion.is_free()).map(|(k, (_, stage))| (k, stage.first_row))
}

/// Adds w x v to the accelerations of free joints: the acceleration of the origin in axes that are fixed at the start
/// of the step.
fn to_axes_at_rest(model: &Model<f64>, h: f64, v: &[f64], v_next: &mut [f64]) {
    for (_, row) in free_joints(model) {
        let (linear, angular) = (triple(&v[row..]), triple(&v[row + 3..]));
        let turning = angular.cross(&linear) * h;
        for i in 0..3 {
            v_next[row + i] += turning[i];
        }
    }
}

/// `q_next` = q exp(h `v_next`), where the origins of free joints move on straight lines.
fn move_along(h: f64, s: &mut Scratch<f64>) {
    for (x, v) in s.x.iter_mut().zip(&s.v_next) {
        *x = h * v;
    }
    for (body, stage) in s.model.bodies.iter().zip(&s.model.system.stages) {
        let x = &mut s.x[stage.first_row..];
        if body.motion.is_free() {
            let along = rotation(&s.q[body.q..]) * triple(x);
            x[..3].fill(0.0);
            body.motion.advance(&s.q[body.q..], x, &mut s.q_next[body.q..]);
            for i in 0..3 {
                s.q_next[body.q + i] = s.q[body.q + i] + along[i];
            }
        } else {
            body.motion.advance(&s.q[body.q..], x, &mut s.q_next[body.q..]);
        }
    }
}

/// For each free joint, the index of its first velocity, and the rotation from its initial to its final axes.
fn axes_of_free_joints(model: &Model<f64>, q: &[f64], q_next: &[f64]) -> Vec<(usize, Matrix3<f64>)> {
    let turn = |(k, row): (usize, usize)| {
        let at = model.bodies[k].q;
        (row, rotation(&q_next[at..]).transpose() * rotation(&q[at..]))
    };
    free_joints(model).map(turn).collect()
}

/// The rotation from the axes of a free joint to those of its parent.
pub(super) fn rotation(q: &[f64]) -> Matrix3<f64> {
    Motion::Free.shift(&RigidShift::identity(), q).rotation
}

fn rotated(v: &mut [f64], turn: &Matrix3<f64>) {
    let linear = turn * triple(v);
    v[..3].copy_from_slice(linear.as_slice());
}

pub(super) fn triple(x: &[f64]) -> Vector3<f64> {
    Vector3::new(x[0], x[1], x[2])
}
