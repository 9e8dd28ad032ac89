//! One elementary step of one state, or of one state per lane, by any method.
//!
//! Joints with exact Coulomb friction or with stops have a *mode* during the step, which their state at its start decides: locked (at rest, held by friction or by a stop),
//! or moving in one direction, with constant friction against it. In these modes the motion is smooth, and the step has the order of its method. The step also evaluates whether
//! the modes hold until its end ([`Scratch::consistent`]) and whether it is short enough ([`Scratch::short_enough`]); where one fails,
//! [`substeps`](super::substeps) does the step with shorter ones and with the set-valued law.

use super::conserve::{KEPT, Keeper};
use super::constrained::Stabilisation;
use super::contact;
use super::manifold::{advance, carry_back};
use super::method::{Method, STAGES, Scheme};
use super::properties::{Gains, Properties};
use super::stops::SetValued;
use super::tally::TALLY;
use crate::batch::accelerations::{Call, by_covariance, watched};
use crate::batch::arms::{Baseline, Target, Vectorised};
use crate::dynamics;
use crate::dynamics::auto::Errors;
use crate::dynamics::coupled::CoupledAccelerations;
use crate::dynamics::sweeps::{SweepModel, SweepScratch};
use crate::filter::pivots::LostPivot;
use crate::filter::{Form, HingeMap, Rows};
use crate::model::Model;
use crate::scalar::{Real, larger};
use crate::scene::{Coupling, Scene};
use crate::workspace::Workspace;
use std::sync::Arc;

/// What every step of a rollout has in common, in numbers of one state.
#[derive(Debug, Clone)]
pub(super) struct Law {
    /// The step of the run, s.
    pub step: f64,
    /// What advances a state; never [`Method::Auto`].
    pub method: Method,
    /// Whether the method was chosen by [`Method::Auto`], which also divides steps that are too long.
    pub divides: bool,
    /// The method at the step of the run.
    pub scheme: Scheme,
    pub properties: Properties,
    pub gains: Option<Gains>,
    /// The bodies that trees begin with whose momentum is kept; empty where it is left to the method.
    pub roots: Vec<usize>,
    /// How joints follow each other, where some do; the numbers are then those of the tree.
    pub coupling: Option<Arc<Coupling>>,
    /// Whether some joint has regularized friction.
    pub rubs: bool,
    /// The bound on the error of a substep, where the substeps are chosen by it.
    pub accuracy: Option<f64>,
    /// The rows with exact friction or stops.
    pub set_valued: Vec<SetValued>,
    /// The coefficient of restitution of the stops.
    pub restitution: f64,
    /// What the error estimate makes of each degree of freedom.
    pub kinds: Vec<RateKind>,
    /// Of a scene with connections, what keeps states on them.
    pub connected: Option<Stabilisation>,
    /// Bodies whose joints have a spring, and bodies that the control law pulls.
    pub sprung: Vec<bool>,
    pub pulled: Vec<bool>,
}

impl Law {
    pub fn new(
        model: &Model<f64>,
        step: f64,
        method: Method,
        (properties, gains): (Properties, Option<Gains>),
        roots: Vec<usize>,
    ) -> Self {
        let stiff = |values: &[f64]| {
            let stages = model.system.stages.iter();
            stages.map(|s| values[s.first_row..][..s.rows.count()].iter().any(|&k| k != 0.0)).collect()
        };
        Self {
            step,
            method,
            divides: false,
            scheme: Scheme::new(method, step),
            coupling: None,
            rubs: properties.friction_speed > 0.0 && properties.friction.iter().any(|&f| f != 0.0),
            accuracy: None,
            set_valued: Vec::new(),
            restitution: 0.0,
            kinds: rate_kinds(model),
            sprung: stiff(&properties.stiffness),
            pulled: gains.as_ref().map_or_else(|| vec![false; model.bodies.len()], |g| stiff(&g.proportional)),
            properties,
            gains,
            roots,
            connected: None,
        }
    }

    /// The same for joints that follow each other.
    pub fn with_coupling(self, coupling: Option<Arc<Coupling>>) -> Self {
        Self { coupling, ..self }
    }

    /// Whether steps are vectorized: those of a tree whose joints are independent, without error control.
    pub fn is_vectorized(&self) -> bool {
        self.coupling.is_none() && self.connected.is_none() && self.accuracy.is_none()
    }

    /// The same for a way back, which tells of springs that are not there too: how far every joint is from rest.
    pub fn backward(&self) -> Self {
        let mut law = self.clone();
        law.sprung.fill(true);
        law
    }

    /// The time of a step, counted from the start of the run, s.
    #[allow(clippy::cast_precision_loss)] // steps of a run
    pub fn time(&self, steps: usize) -> f64 {
        steps as f64 * self.step
    }

    /// The number of values that a rollout stores per state: q, qd, the [`Tally`](super::tally); where momentum is conserved, its value and two corrections; of a scene
    /// with contacts, their impulses and their report.
    pub fn width(&self, scene: &Scene) -> usize {
        let kept = if self.roots.is_empty() { 0 } else { KEPT * self.roots.len() + 2 };
        let touching = if self.method == Method::Contact { contact::width(scene.contact_points().len()) } else { 0 };
        scene.nq() + scene.nv() + TALLY + kept + touching
    }

    /// Damping and stiffness of one degree of freedom, the control law's with the joint's own.
    fn implicit_terms(&self, row: usize) -> (f64, f64) {
        let (d, k) = (self.properties.damping[row], self.properties.stiffness[row]);
        self.gains.as_ref().map_or((d, k), |gains| (d + gains.derivative[row], k + gains.proportional[row]))
    }

    /// Measurement noise r + h g d + h^2 g^2 k of every row in a step by `scheme`, without that of regularized friction and of locked joints.
    pub fn noise(&self, scheme: &Scheme) -> Vec<f64> {
        // All stages of a method have the same g.
        let hg = if scheme.implicit { scheme.tableau.gamma[0][0] } else { 0.0 };
        let armature = self.properties.armature.iter().enumerate();
        armature
            .map(|(row, r)| {
                let (d, k) = self.implicit_terms(row);
                r + hg * (d + hg * k)
            })
            .collect()
    }
}

/// Measurement noise of a locked joint, in kg m^2 or kg: as large as numbers allow whose products with inertias are numbers. Its acceleration is then exactly zero beside any
/// other, and noise times acceleration is the torque that holds it.
pub(super) const LOCKED: f64 = 1e200;
/// That of a joint which may be locked and is not, where there are several lanes: a row has noise in all of them or in none. It changes no digit of a pivot, and its sign makes the
/// pivot of a joint without inertia a lost one.
const FREE: f64 = -1e-200;
/// What makes zero pass where zero or more is allowed.
const BARELY: f64 = 1e-300;

/// What the error estimate makes of one degree of freedom.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RateKind {
    /// A rotation: how far it goes in a step, and how exact it is, decide about substeps.
    Rotation,
    /// A linear velocity in axes that rotate: how exact it is decides, too.
    InRotatingAxes,
    /// A translation along an axis of the parent.
    Translation,
}

fn rate_kinds(model: &Model<f64>) -> Vec<RateKind> {
    use RateKind::{InRotatingAxes, Rotation, Translation};
    let mut kinds = Vec::new();
    for stage in &model.system.stages {
        match stage.rows {
            Rows::None => {}
            Rows::One(HingeMap::Axis(3..)) => kinds.push(Translation),
            Rows::One(_) => kinds.push(Rotation),
            Rows::Angular => kinds.extend([Rotation; 3]),
            Rows::Six => kinds.extend([InRotatingAxes, InRotatingAxes, InRotatingAxes, Rotation, Rotation, Rotation]),
        }
    }
    kinds
}

/// One row's constants in the scalar of the lanes.
#[derive(Debug, Clone, Copy)]
pub(super) struct RowTerms<T> {
    /// Noise without friction's part.
    pub noise: T,
    pub damping: T,
    pub stiffness: T,
    pub friction: T,
    pub proportional: T,
    pub derivative: T,
}

/// A row with exact friction or stops, in the scalar of the lanes.
#[derive(Debug, Clone, Copy)]
pub(super) struct ModeTerms<T> {
    pub row: usize,
    /// Its coordinate in q, and the bounds on it; infinite where it has none.
    pub coordinate: usize,
    pub lower: T,
    pub upper: T,
    pub friction: T,
    /// One where it is locked in this step, else zero; and its acceleration then, which is not zero in an event only.
    pub locked: T,
    pub target: T,
    /// One where it is at its lower, and at its upper stop.
    pub at_lower: T,
    pub at_upper: T,
}

/// The arrays of a step.
#[derive(Debug)]
pub(super) struct Scratch<T: Real> {
    pub model: Model<T>,
    pub constants: SweepModel<T>,
    pub sweeps: SweepScratch<T>,
    pub rows: Vec<RowTerms<T>>,
    pub rest: Vec<T>,
    pub target: Vec<T>,
    pub target_rate: Vec<T>,
    /// The torque that is given, held over the step.
    pub torque: Vec<T>,
    pub q: Vec<T>,
    pub v: Vec<T>,
    pub q_next: Vec<T>,
    pub v_next: Vec<T>,
    /// Stages: rates of the increment, and accelerations.
    pub l: [Vec<T>; STAGES],
    pub m: [Vec<T>; STAGES],
    /// Increment, configuration, velocity, carried velocity and torque of a stage.
    pub x: Vec<T>,
    pub q_stage: Vec<T>,
    pub v_stage: Vec<T>,
    pub c: Vec<T>,
    pub u: Vec<T>,
    /// Friction's damping, f / sqrt(v^2 + v0^2) at the step's start.
    pub chord: Vec<T>,
    /// Rows with exact friction or stops, and their friction in this step, zero where they are locked.
    pub modes: Vec<ModeTerms<T>>,
    pub dry: Vec<T>,
    /// What the control law gave in this step, N m s or N s.
    pub control: Vec<T>,
    /// Positive where all modes hold until the step's end; and where the step is short enough.
    pub consistent: T,
    pub short_enough: T,
    /// What acted during the run: see [`tally`](super::tally).
    pub tally: [T; TALLY],
    /// How far the stage is from where the springs are at rest, and from the control law's target.
    pub displaced: Vec<T>,
    pub displaced_target: Vec<T>,
    pub keeper: Keeper<T>,
}

impl<T: Real> Scratch<T> {
    pub fn new(scene_model: &Model<f64>, law: &Law) -> Self {
        let mut of_step = scene_model.clone();
        of_step.system.noise = law.noise(&law.scheme);
        if T::LANES > 1 {
            for of in &law.set_valued {
                let noise = &mut of_step.system.noise[of.row];
                *noise = if *noise == 0.0 { FREE } else { *noise };
            }
        }
        let constants = SweepModel::new(&of_step);
        let model = of_step.cast::<T>();
        let (nq, nv) = (model.nq, model.nv());
        let row = |row: usize| {
            let p = &law.properties;
            let (kp, kd) =
                law.gains.as_ref().map_or((0.0, 0.0), |gains| (gains.proportional[row], gains.derivative[row]));
            RowTerms {
                noise: T::from_f64(of_step.system.noise[row]),
                damping: T::from_f64(p.damping[row]),
                stiffness: T::from_f64(p.stiffness[row]),
                friction: T::from_f64(p.friction[row]),
                proportional: T::from_f64(kp),
                derivative: T::from_f64(kd),
            }
        };
        let mode = |of: &SetValued| ModeTerms {
            row: of.row,
            coordinate: of.coordinate,
            lower: T::from_f64(of.lower),
            upper: T::from_f64(of.upper),
            friction: T::from_f64(of.friction),
            locked: T::zero(),
            target: T::zero(),
            at_lower: T::zero(),
            at_upper: T::zero(),
        };
        let coordinates = || vec![T::zero(); nq];
        let rates = || vec![T::zero(); nv];
        Self {
            sweeps: SweepScratch::new(&model, &constants),
            constants,
            rows: (0..nv).map(row).collect(),
            rest: law.properties.rest.iter().map(|&x| T::from_f64(x)).collect(),
            target: coordinates(),
            target_rate: rates(),
            torque: rates(),
            q: coordinates(),
            v: rates(),
            q_next: coordinates(),
            v_next: rates(),
            l: std::array::from_fn(|_| rates()),
            m: std::array::from_fn(|_| rates()),
            x: rates(),
            q_stage: coordinates(),
            v_stage: rates(),
            c: rates(),
            u: rates(),
            chord: rates(),
            modes: law.set_valued.iter().map(mode).collect(),
            dry: rates(),
            control: rates(),
            consistent: T::one(),
            short_enough: T::one(),
            tally: [T::zero(); TALLY],
            displaced: rates(),
            displaced_target: rates(),
            keeper: Keeper::new(&model, &law.roots),
            model,
        }
    }
}

impl<T: Real> Scratch<T> {
    /// Sets the measurement noise of a scheme.
    pub fn adopt(&mut self, law: &Law, scheme: &Scheme) {
        for ((row, noise), of_model) in self.rows.iter_mut().zip(law.noise(scheme)).zip(&mut self.model.system.noise) {
            row.noise = T::from_f64(noise);
            *of_model = row.noise;
        }
    }
}

#[cfg(feature = "adaptive")]
impl<T: Real> Scratch<T> {
    /// The state that [`accelerations`] are of.
    pub fn set_stage(&mut self, q: &[T], v: &[T]) {
        self.q_stage.copy_from_slice(q);
        self.v_stage.copy_from_slice(v);
    }
}

/// How the accelerations of a stage are found.
pub(super) trait Solver<T: Real> {
    /// Writes qdd; gives the lanes whose error estimate exceeds its bound as bits. `estimates`: whether the error is estimated, else only pivots are checked.
    fn solve(
        &mut self,
        estimates: bool,
        scene: (&Model<T>, &SweepModel<T>),
        scratch: &mut SweepScratch<T>,
        state: (&[T], &[T], &[T]),
        qdd: &mut [T],
    ) -> u64;
}

/// The compiled kernels of these instructions: the covariance form, trusted where its pivots are clear.
pub(super) struct Plain<I>(pub I);

impl<T: Vectorised, I: Target> Solver<T> for Plain<I> {
    #[inline(always)]
    fn solve(
        &mut self,
        _estimates: bool,
        scene: (&Model<T>, &SweepModel<T>),
        scratch: &mut SweepScratch<T>,
        state: (&[T], &[T], &[T]),
        qdd: &mut [T],
    ) -> u64 {
        by_covariance(self.0, Call { scene, scratch, state, wrenches: &[], qdd })
    }
}

/// The same with an error estimate in the first stage of a step, whose later stages are near.
pub(super) struct Watched<T, I>(pub I, pub Errors<T>);

impl<T: Vectorised, I: Target> Solver<T> for Watched<T, I> {
    #[inline(always)]
    fn solve(
        &mut self,
        estimates: bool,
        scene: (&Model<T>, &SweepModel<T>),
        scratch: &mut SweepScratch<T>,
        state: (&[T], &[T], &[T]),
        qdd: &mut [T],
    ) -> u64 {
        let call = Call { scene, scratch, state, wrenches: &[], qdd };
        if estimates { watched(self.0, call, &mut self.1) } else { by_covariance(self.0, call) }
    }
}

/// One state with every check, in the form of the workspace.
pub(super) struct Checked {
    pub workspace: Workspace<f64>,
    form: Form,
    /// Whether the kernels come first, which leave no factor in the workspace.
    kernels_first: bool,
    coupled: Option<(CoupledAccelerations, Arc<Coupling>)>,
    /// The first pivot that was lost, since it was last taken.
    pub lost: Option<LostPivot>,
}

impl Checked {
    pub fn new(model: &Model<f64>, coupling: Option<Arc<Coupling>>, form: Form) -> Self {
        let coupled = coupling.map(|of| (CoupledAccelerations::new(model, of.sums()), of));
        Self { workspace: Workspace::new(model).in_form(form), form, kernels_first: false, coupled, lost: None }
    }

    /// The same with the kernels first, whose results stay where their error estimate meets its bound.
    pub fn with_kernels(self) -> Self {
        Self { kernels_first: self.coupled.is_none(), ..self }
    }

    /// M^-1 of a right side, with the noise of the model.
    pub fn factorise_and_solve(&mut self, model: &Model<f64>, q: &[f64], right: &[f64], out: &mut [f64]) {
        if let Some((solver, coupling)) = &mut self.coupled {
            solver.set_noise(&model.system.noise);
            let lost = solver.factorise(coupling.sums(), self.form, q, None);
            solver.solve(coupling.sums(), right, out);
            self.lost = self.lost.take().or(lost);
            return;
        }
        let pivots = dynamics::factorise(model, &mut self.workspace, q, |_, _| {});
        dynamics::solve(model, &mut self.workspace, right, out);
        if self.lost.is_none() {
            self.lost = self.workspace.lost_pivot(model, &pivots);
        }
    }

    /// The accelerations of joints that follow each other; the pivot that is lost, where one is.
    fn solve_coupled(
        (solver, coupling): &mut (CoupledAccelerations, Arc<Coupling>),
        form: Form,
        model: &Model<f64>,
        (q, v, u): (&[f64], &[f64], &[f64]),
        qdd: &mut [f64],
    ) -> Option<LostPivot> {
        solver.set_noise(&model.system.noise);
        let lost = solver.factorise(coupling.sums(), form, q, Some((v, &[])));
        solver.solve(coupling.sums(), u, qdd);
        lost
    }
}

impl Solver<f64> for Checked {
    fn solve(
        &mut self,
        estimates: bool,
        (model, constants): (&Model<f64>, &SweepModel<f64>),
        scratch: &mut SweepScratch<f64>,
        (q, v, u): (&[f64], &[f64], &[f64]),
        qdd: &mut [f64],
    ) -> u64 {
        if self.kernels_first {
            let call = Call { scene: (model, constants), scratch, state: (q, v, u), wrenches: &[], qdd: &mut *qdd };
            let doubt = if self.form == Form::Covariance || !estimates {
                by_covariance(Baseline, call)
            } else {
                watched(Baseline, call, &mut Errors::unknown())
            };
            if doubt & 1 == 0 {
                return 0;
            }
        }
        if let Some(coupled) = &mut self.coupled {
            let lost = Self::solve_coupled(coupled, self.form, model, (q, v, u), qdd);
            self.lost = self.lost.take().or(lost);
            return 0;
        }
        let monitor = dynamics::forward_dynamics(model, &mut self.workspace, q, v, u, &[], qdd);
        if self.lost.is_none() {
            self.lost = self.workspace.lost_pivot(model, &monitor);
        }
        0
    }
}

/// sum + c x, in place.
#[inline(always)]
pub(super) fn add_scaled<T: Real>(sum: &mut [T], c: f64, x: &[T]) {
    if c == 0.0 {
        return;
    }
    for (sum, &x) in sum.iter_mut().zip(x) {
        *sum = x.mul_add(x.constant(c), *sum);
    }
}

/// The accelerations of the state that [`Scratch::set_stage`] has set, in `m[0]`, with nothing implicit.
#[cfg(feature = "adaptive")]
pub(super) fn accelerations<T: Real, S: Solver<T>>(law: &Law, s: &mut Scratch<T>, solver: &mut S) {
    forces((law, &law.scheme), s, 0);
    solver.solve(true, (&s.model, &s.constants), &mut s.sweeps, (&s.q_stage, &s.v_stage, &s.u), &mut s.m[0]);
}

/// From `q`, `v` to `q_next`, `v_next` by one step of a scheme; gives the lanes whose error estimate exceeds its bound as bits.
#[inline(always)]
pub(super) fn step<T: Real, S: Solver<T>>(by @ (law, scheme): By<'_>, s: &mut Scratch<T>, solver: &mut S) -> u64 {
    let t = &scheme.tableau;
    let mut doubt = 0;
    if law.rubs {
        set_friction(by, s);
    }
    set_modes(by, s);
    clear(&mut s.control);
    for i in 0..t.stages {
        stage(by, s, i);
        let state = (&s.q_stage[..], &s.v_stage[..], &s.u[..]);
        doubt |= solver.solve(i == 0, (&s.model, &s.constants), &mut s.sweeps, state, &mut s.m[i]);
        observe_locks(s, i);
        finish_stage(by, s, i);
    }
    finish_step(by, s);
    doubt
}

/// The end of a step whose stages are there, and whether it is consistent and short enough.
#[inline(always)]
pub(super) fn finish_step<T: Real>(by @ (_, scheme): By<'_>, s: &mut Scratch<T>) {
    let t = &scheme.tableau;
    clear(&mut s.x);
    s.v_next.copy_from_slice(&s.v);
    for i in 0..t.stages {
        add_scaled(&mut s.x, t.weights[i], &s.l[i]);
        add_scaled(&mut s.v_next, t.weights[i], &s.m[i]);
    }
    advance(&s.model, &s.q, &s.x, &mut s.q_next);
    observe_end(by, s);
}

/// What a step is made by: what all steps of the run have in common, and a scheme at some step.
pub(super) type By<'a> = (&'a Law, &'a Scheme);

/// The mode of each row with exact friction or stops, from the state at the step's start.
#[inline(always)]
pub(super) fn set_modes<T: Real>((law, scheme): By<'_>, s: &mut Scratch<T>) {
    let hg = if scheme.implicit && law.rubs { scheme.tableau.gamma[0][0] } else { 0.0 };
    s.consistent = s.v.first().map_or_else(T::one, |v| v.constant(1.0));
    for (mode, of) in s.modes.iter_mut().zip(&law.set_valued) {
        let (v, q) = (s.v[mode.row], s.q[mode.coordinate]);
        mode.target = v.constant(0.0);
        let (o, at_rest) = (v.constant(0.0), v.one_if_zero());
        if of.stops {
            mode.at_lower = larger(q - mode.lower, o).one_if_zero();
            mode.at_upper = larger(mode.upper - q, o).one_if_zero();
        }
        if of.friction > 0.0 {
            mode.locked = at_rest;
            s.dry[mode.row] = -(mode.friction * v * (v.abs() + at_rest).recip());
        } else {
            mode.locked = at_rest * larger(mode.at_lower, mode.at_upper);
        }
        let moving = s.chord[mode.row].mul_add(v.constant(hg), s.rows[mode.row].noise);
        s.model.system.noise[mode.row] = mode.locked.mul_add(v.constant(LOCKED), moving);
    }
}

/// Whether the torques that hold locked rows in stage `i` are within their bounds; their accelerations become exactly what they are locked at.
#[inline(always)]
pub(super) fn observe_locks<T: Real>(s: &mut Scratch<T>, i: usize) {
    for mode in &s.modes {
        let m = &mut s.m[i][mode.row];
        let held = -(*m * mode.locked * m.constant(LOCKED));
        let (endless, barely) = (m.constant(LOCKED), m.constant(BARELY));
        let below = mode.at_lower.mul_add(endless, mode.friction - held);
        let above = mode.at_upper.mul_add(endless, mode.friction + held);
        s.consistent = s.consistent.worst(below + barely).worst(above + barely);
        *m = mode.target.mul_add(mode.locked, *m * (m.constant(1.0) - mode.locked));
    }
}

/// Whether sliding joints still slide at the step's end, whether all are within their stops, and whether the step was short enough.
#[inline(always)]
fn observe_end<T: Real>(by @ (law, scheme): By<'_>, s: &mut Scratch<T>) {
    for (mode, of) in s.modes.iter().zip(&law.set_valued) {
        let (v, next, q) = (s.v[mode.row], s.v_next[mode.row], s.q_next[mode.coordinate]);
        if of.friction > 0.0 {
            s.consistent = s.consistent.worst(v.mul_add(next, mode.locked));
        }
        if of.stops {
            let barely = q.constant(BARELY);
            s.consistent = s.consistent.worst(q - mode.lower + barely).worst(mode.upper - q + barely);
        }
    }
    if law.divides {
        let [(fastest, error), (linear, linear_error)] = speeds_and_errors(by, s);
        let share = fastest.constant(scheme.share);
        let slow = fastest.constant(scheme.angle) - fastest * fastest.constant(scheme.step);
        let exact = fastest.mul_add(share, -error).worst(linear.mul_add(share, -linear_error));
        s.short_enough = larger(slow, exact) + slow.constant(BARELY);
    }
}

/// The fastest rotation of a joint in a step, rad/s, and an estimate of the error in these velocities; and the same of linear velocities in rotating axes, m/s.
#[inline(always)]
pub(super) fn speeds_and_errors<T: Real>((law, scheme): By<'_>, s: &Scratch<T>) -> [(T, T); 2] {
    let zero = s.v.first().map_or_else(T::zero, |v| v.constant(0.0));
    let mut found = [(zero, zero); 2];
    for (row, kind) in law.kinds.iter().enumerate() {
        let (speed, worst) = match kind {
            RateKind::Rotation => &mut found[0],
            RateKind::InRotatingAxes => &mut found[1],
            RateKind::Translation => continue,
        };
        let mut error = zero;
        for i in 0..scheme.tableau.stages {
            error = s.m[i][row].mul_add(error.constant(scheme.error[i]), error);
        }
        *speed = larger(*speed, larger(s.v[row].abs(), s.v_next[row].abs()));
        *worst = larger(*worst, error.abs());
    }
    found
}

/// Zero.
#[inline(always)]
pub(super) fn clear<T: Real>(numbers: &mut [T]) {
    for x in numbers {
        *x = x.constant(0.0);
    }
}

/// Increment, configuration, velocity, carried velocity and torque of stage `i`, from the stages before it.
#[inline(always)]
pub(super) fn stage<T: Real>(by @ (_, scheme): By<'_>, s: &mut Scratch<T>, i: usize) {
    let t = &scheme.tableau;
    s.v_stage.copy_from_slice(&s.v);
    if i == 0 {
        s.q_stage.copy_from_slice(&s.q);
        s.c.copy_from_slice(&s.v);
    } else {
        clear(&mut s.x);
        for j in 0..i {
            add_scaled(&mut s.x, t.alpha[i][j], &s.l[j]);
            add_scaled(&mut s.v_stage, t.alpha[i][j], &s.m[j]);
        }
        advance(&s.model, &s.q, &s.x, &mut s.q_stage);
        s.c.copy_from_slice(&s.v_stage);
        carry_back(&s.model, &s.x, &mut s.c);
        for j in 0..i {
            add_scaled(&mut s.c, t.gamma[i][j], &s.m[j]);
        }
    }
    forces(by, s, i);
}

/// The rate of the increment in stage `i`, whose accelerations are there.
#[inline(always)]
pub(super) fn finish_stage<T: Real>((_, scheme): By<'_>, s: &mut Scratch<T>, i: usize) {
    s.l[i].copy_from_slice(&s.c);
    add_scaled(&mut s.l[i], scheme.tableau.gamma[i][i], &s.m[i]);
}

/// Friction as damping, f / sqrt(v^2 + v0^2) at the step's start: never zero where f is not, so a row has noise in all lanes or
/// in none. Taken implicitly, it cannot turn a velocity round.
#[inline(always)]
pub(super) fn set_friction<T: Real>((law, scheme): By<'_>, s: &mut Scratch<T>) {
    let hg = scheme.tableau.gamma[0][0];
    for (row, of) in s.rows.iter().enumerate() {
        if law.properties.friction[row] == 0.0 {
            continue;
        }
        let chord = of.friction * rounded_speed(law, s.v[row]).recip();
        s.chord[row] = chord;
        if scheme.implicit {
            s.model.system.noise[row] = chord.mul_add(chord.constant(hg), of.noise);
        }
    }
}

/// sqrt(v^2 + v0^2), never zero.
#[inline(always)]
pub(super) fn rounded_speed<T: Real>(law: &Law, v: T) -> T {
    let v0 = law.properties.friction_speed;
    if v0 == 0.0 {
        // Exact: the quotient with it is the sign.
        return v.abs() + v.one_if_zero();
    }
    v.mul_add(v, v.constant(v0 * v0)).sqrt()
}

/// The right side of stage `i`.
#[inline(always)]
pub(super) fn forces<T: Real>((law, scheme): By<'_>, s: &mut Scratch<T>, i: usize) {
    let t = &scheme.tableau;
    for (k, body) in s.model.bodies.iter().enumerate() {
        let stage = &s.model.system.stages[k];
        let (row, at) = (stage.first_row, body.q);
        if law.sprung[k] {
            body.motion.displacement(&s.rest[at..], &s.q_stage[at..], &mut s.displaced[row..]);
        }
        if law.pulled[k] {
            body.motion.displacement(&s.target[at..], &s.q_stage[at..], &mut s.displaced_target[row..]);
        }
    }
    for (row, of) in s.rows.iter().enumerate() {
        let v = s.v_stage[row];
        let mut u = s.torque[row];
        u = u.minus_product(of.damping, v);
        u = u.minus_product(of.stiffness, s.displaced[row]);
        let mut control = v.constant(0.0);
        if law.gains.is_some() {
            control = control.minus_product(of.derivative, v - s.target_rate[row]);
            control = control.minus_product(of.proportional, s.displaced_target[row]);
        }
        let mut damping = of.damping;
        if law.rubs {
            u = u.minus_product(of.friction * v, rounded_speed(law, v).recip());
            damping += s.chord[row];
        }
        if scheme.implicit {
            let c = s.c[row];
            let (mut moved, mut sped) = (c * c.constant(t.gamma[i][i]), c.constant(0.0));
            for j in 0..i {
                let gamma = c.constant(t.gamma[i][j]);
                moved = s.l[j][row].mul_add(gamma, moved);
                sped = s.m[j][row].mul_add(gamma, sped);
            }
            u = u.minus_product(of.stiffness, moved);
            u = u.minus_product(damping, sped);
            if law.gains.is_some() {
                control = control.minus_product(of.proportional, moved);
                control = control.minus_product(of.derivative, sped);
            }
        }
        s.u[row] = u + control;
        if law.gains.is_some() {
            s.control[row] = control.mul_add(control.constant(t.weights[i]), s.control[row]);
        }
    }
    for mode in &s.modes {
        s.u[mode.row] += s.dry[mode.row];
    }
}
