//! One step of one state.

use super::super::faults::fault_of;
use super::super::limit_rows::{least_velocity, limit_rows, rebounds, settle_at};
use super::super::scratch::Scratch;
use super::super::solver::Checked;
use super::super::step::step;
use super::super::step_settings::StepSettings;
use super::super::substeps::StopImpact;
use super::super::tally::STOPS;
use super::super::works::add_work;
use super::kept::ContactReport;
use super::project::out_of_planes;
use crate::contact::{Cone, ContactState, Effort, Impact, Limits, Told, impact, passive};
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

/// A residual above it is an error; one between this and the tolerance is told.
const REFUSED: f64 = 1e-5;

/// A contact that was left out and ends deeper joins, m.
const LATE: f64 = 1e-12;

/// Scratch of one state.
pub(super) struct Touching {
    solver: Checked,
    pub rows: ContactScratch,
    /// Joints that met a stop in the last step.
    pub impacts: Vec<StopImpact>,
}

/// Where contacts are and how they move when a step begins.
struct Before {
    gaps: Vec<f64>,
    /// J v, and J of the velocities without contacts.
    start: DVector<f64>,
    free: DVector<f64>,
}

/// What the contacts did.
struct Outcome {
    near: Vec<usize>,
    /// Impulses of impacts, and those that hold.
    hit: Option<Impact>,
    held: DVector<f64>,
    states: Vec<ContactState>,
    report: ContactReport,
    /// Velocities at the end, where joints that reach a stop end the step slower than they moved in it.
    slowed: Option<Vec<f64>>,
}

impl Outcome {
    /// Nothing touches.
    fn nothing() -> Self {
        Self {
            near: Vec::new(),
            hit: None,
            held: DVector::zeros(0),
            states: Vec::new(),
            report: ContactReport::nothing(),
            slowed: None,
        }
    }
}

impl Touching {
    pub fn new(scene: &Scene, law: &StepSettings, form: Form) -> Self {
        let limits = if law.stops { limit_rows(scene) } else { Vec::new() };
        Self {
            solver: Checked::new(scene.model(), None, form).accepting(law.tolerance),
            rows: ContactScratch::new(scene.model(), scene.contact_points(), limits),
            impacts: Vec::new(),
        }
    }

    /// From `q`, `v` to `q_next`, `v_next`; the impulses and what is told go to `kept`. The joint and the error where there is no step.
    pub fn step(
        &mut self,
        scene: &Scene,
        law: &StepSettings,
        s: &mut Scratch<f64>,
        kept: &mut [f64],
    ) -> Result<(), (String, Error)> {
        step((law, &law.scheme), s, &mut self.solver);
        let lost = self.solver.lost.take();
        if let Some(fault) = fault_of(scene, law, s, lost) {
            return Err(fault);
        }
        let (h, points) = (law.step, scene.contact_points());
        to_axes_at_rest(&s.model, h, &s.v, &mut s.v_next);
        self.rows.place(&s.model, points, &s.q);
        let start = self.rows.velocities(&s.model, points, &s.v);
        let free = self.rows.velocities(&s.model, points, &s.v_next);
        let before = Before { gaps: self.rows.gaps.clone(), start, free };
        let mut outcome = self.touch(scene, law, s, &before, kept)?;
        move_along(h, s);
        if let Some(slowed) = outcome.slowed.take() {
            s.v_next = slowed;
        }
        add_work(law, s);
        let ends = axes_of_free_joints(&s.model, &s.q, &s.q_next);
        let workspace = &mut self.solver.workspace;
        let (depth, iterations) =
            out_of_planes(&s.model, points, workspace, &mut self.rows, (&mut s.q_next, &mut s.q_stage))
                .map_err(|lost| pivot_fault(scene, lost.stage, scene.singular(lost)))?;
        for (row, turn) in ends {
            turned(&mut s.v_next[row..], &turn);
        }
        self.settle(law, s, &before, &outcome, points.len());
        keep(kept, &outcome, points.len());
        #[allow(clippy::cast_precision_loss)] // a count
        let iterations = outcome.report.iterations + iterations as f64;
        ContactReport::add(kept, &ContactReport { iterations, depth, ..outcome.report });
        fault_of(scene, law, s, None).map_or(Ok(()), Err)
    }

    /// Impacts and contact of the step: `v_next` becomes what they make of it.
    fn touch(
        &mut self,
        scene: &Scene,
        law: &StepSettings,
        s: &mut Scratch<f64>,
        before: &Before,
        kept: &[f64],
    ) -> Result<Outcome, (String, Error)> {
        let Self { solver, rows, .. } = self;
        let (workspace, points, h) = (&mut solver.workspace, scene.contact_points(), law.step);
        let Before { gaps, start, free } = before;
        let (n, all_rows) = (points.len(), gaps.len());
        let mut near: Vec<usize> =
            (0..all_rows).filter(|&i| gaps[i] <= 0.0 || gaps[i] + h * free[3 * i + 2] <= 0.0).collect();
        let mut outcome = Outcome::nothing();
        if near.is_empty() {
            return Ok(outcome);
        }
        let pivots = factorise(&s.model, workspace, &s.q, |_, _| {});
        if let Some(lost) = workspace.lost_pivot(&s.model, &pivots) {
            return Err(pivot_fault(scene, lost.stage, scene.singular(lost)));
        }
        // What gravity gives in a step: slower bounces would last less than two.
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
            let rebound = restitutions(points, &near, (start, free), (rest_speed, law.restitution));
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
            let (held, mut told) = cone.impulses(&c, warm.as_ref(), &limits, Effort::default());
            // A joint that returns from outside of its limits gains energy.
            let returns = near.iter().any(|&i| i >= n && gaps[i] < 0.0);
            let (mut held, mut impulse_kept) = if returns { (held, 1.0) } else { passive(&cone, &u, held) };
            let mut all = held.clone();
            if let Some(hit) = &hit {
                all += &hit.impulses;
                told = told.with(hit.told);
                impulse_kept = impulse_kept.min(hit.impulse_kept);
            }
            iterations += told.iterations;
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
                if !arriving.is_empty() {
                    for at in arriving {
                        c[3 * at + 2] = u[3 * at + 2];
                    }
                    let (slower, more) = cone.impulses(&c, Some(&held), &limits, Effort::default());
                    let (slower, part) = if returns { (slower, 1.0) } else { passive(&cone, &u, slower) };
                    (told, impulse_kept, iterations) =
                        (told.with(more), impulse_kept.min(part), iterations + more.iterations);
                    all += &slower - &held;
                    held = slower;
                    rows.respond(&s.model, points, workspace, &near, &all);
                    let slowed: Vec<f64> = v_free.iter().zip(&rows.response).map(|(v, dv)| v + dv).collect();
                    after = rows.velocities(&s.model, points, &slowed);
                    outcome.slowed = Some(slowed);
                }
                let after_here = pick(&|i| after[i]);
                let landed = |at: usize| start[3 * near[at] + 2] < -rest_speed;
                let (hit_now, velocities) = ((lost, hit.as_ref()), (&held, &u, &after_here));
                outcome.report = report(&told, iterations, impulse_kept, hit_now, velocities, (touching, &landed));
                check(scene, &near, &told)?;
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

    /// Ends the step of joints at their stops: their work and their impacts.
    fn settle(
        &mut self,
        law: &StepSettings,
        s: &mut Scratch<f64>,
        before: &Before,
        outcome: &Outcome,
        contacts: usize,
    ) {
        self.impacts.clear();
        let h = law.step;
        for (at, &i) in outcome.near.iter().enumerate().filter(|(_, i)| **i >= contacts) {
            let (limit, start) = (self.rows.limits[i - contacts], before.start[3 * i + 2]);
            let struck = outcome.hit.as_ref().map_or(0.0, |hit| hit.impulses[3 * at + 2]);
            let impulse = outcome.held[3 * at + 2] + struck;
            let rests = (struck == 0.0 && impulse > 0.0).then(|| least_velocity(before.gaps[i].min(0.0), start, h));
            let ends = (&mut s.q_next[..], &mut s.v_next[..]);
            self.impacts.extend(settle_at(&limit, (h, start), (impulse, rests), ends));
            s.tally[STOPS] += 0.5 * impulse * limit.sign() * (s.v[limit.row] + s.v_next[limit.row]);
        }
    }
}

/// The coefficient of restitution of each contact and joint limit in this step: zero where it does not rebound.
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

/// The kinetic energy that an impact takes at contacts, without joint limits, J: at velocities u.
fn lost_at_contacts(cone: &Cone, u: &DVector<f64>, impulses: &DVector<f64>, contacts: usize) -> f64 {
    let change = &cone.g * impulses;
    -(0..3 * contacts).map(|i| impulses[i] * (u[i] + 0.5 * change[i])).sum::<f64>()
}

/// What the contacts do that an impact touched and nothing holds any more: what they did in it.
fn states_of_rebounds(cone: &Cone, impulses: &DVector<f64>, states: &mut [ContactState]) {
    /// Parts of the largest impulse, and of the bound of friction, that are rounding.
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

/// The report of a step, with contact velocities u before the impulses that hold and `after` them; the first rows are those of contacts.
fn report(
    told: &Told,
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
    #[allow(clippy::cast_precision_loss)] // a count
    ContactReport {
        residual: told.residual,
        converged: told.converged,
        iterations: iterations as f64,
        lost_in_impacts: impacts,
        lost_in_friction: friction,
        expansion_kept: hit.map_or(1.0, |hit| hit.expansion_kept),
        impulse_kept,
        depth: 0.0,
    }
}

/// An error for a solve that is far from the law.
fn check(scene: &Scene, near: &[usize], told: &Told) -> Result<(), (String, Error)> {
    if told.residual <= REFUSED {
        return Ok(());
    }
    let found = format!("a residual of {:.1e} after {} iterations", told.residual, told.iterations);
    let expected = "impulses that meet the law of contacts to 1e-5 of the fastest: take a smaller dt, or less friction";
    Err((String::new(), Error::argument(named(scene, near), found, expected)))
}

/// An error for a contact that no joint can move.
fn check_movable(scene: &Scene, near: &[usize], cone: &Cone) -> Result<(), (String, Error)> {
    let Some(at) = cone.lengths.iter().position(|r| !r.is_finite()) else { return Ok(()) };
    let found = "a point that nothing can move in this configuration";
    let error = Error::argument(named(scene, &near[at..=at]), found, "contacts that joints can move");
    Err((String::new(), error))
}

/// The words for some contacts; joint limits can always be met.
fn named(scene: &Scene, which: &[usize]) -> String {
    let points = which.iter().filter_map(|&i| scene.contact_points().get(i));
    let names: Vec<String> = points.take(8).map(|point| format!("{:?}", point.name)).collect();
    let more = if which.len() > names.len() { ", ..." } else { "" };
    format!("contact{} {}{more}", if which.len() == 1 { "" } else { "s" }, names.join(", "))
}

/// A pivot that was lost, with its joint.
fn pivot_fault(scene: &Scene, body: usize, error: Error) -> (String, Error) {
    (scene.joint_of_body(body).map(|joint| joint.name.clone()).unwrap_or_default(), error)
}

/// What a step did into what is kept: the impulses that hold, the sum of those of impacts, and what each contact does.
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

/// Where the rates of free joints begin in qd, and which bodies they move.
fn free_joints(model: &Model<f64>) -> impl Iterator<Item = (usize, usize)> {
    let each = model.bodies.iter().zip(&model.system.stages).enumerate();
    each.filter(|(_, (body, _))| body.motion.is_free()).map(|(k, (_, stage))| (k, stage.first_row))
}

/// Adds w x v to the accelerations of free joints: of the origin, in axes at rest where the step begins.
fn to_axes_at_rest(model: &Model<f64>, h: f64, v: &[f64], v_next: &mut [f64]) {
    for (_, row) in free_joints(model) {
        let (linear, angular) = (triple(&v[row..]), triple(&v[row + 3..]));
        let turning = angular.cross(&linear) * h;
        for i in 0..3 {
            v_next[row + i] += turning[i];
        }
    }
}

/// `q_next` = q exp(h `v_next`); the origins of free joints straight on.
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

/// For each free joint, where its rates begin, and what takes vectors from its axes at the start to those at the end.
fn axes_of_free_joints(model: &Model<f64>, q: &[f64], q_next: &[f64]) -> Vec<(usize, Matrix3<f64>)> {
    let turn = |(k, row): (usize, usize)| {
        let at = model.bodies[k].q;
        (row, rotation(&q_next[at..]).transpose() * rotation(&q[at..]))
    };
    free_joints(model).map(turn).collect()
}

/// The axes of a free joint in its parent's.
fn rotation(q: &[f64]) -> Matrix3<f64> {
    Motion::Free.shift(&RigidShift::identity(), q).rotation
}

fn turned(v: &mut [f64], turn: &Matrix3<f64>) {
    let linear = turn * triple(v);
    v[..3].copy_from_slice(linear.as_slice());
}

fn triple(x: &[f64]) -> Vector3<f64> {
    Vector3::new(x[0], x[1], x[2])
}
