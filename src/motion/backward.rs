//! Adjoint of one step: from gradients of a scalar by the end state to gradients by the initial state and by the
//! torques, joint properties and inertias of the step.
//!
//! With a bar for the gradient of the scalar by a variable of `step`, the lines of the step are differentiated in
//! reverse order:
//!
//! ```text
//! q' = q exp(x), v' = v + h sum b_i m_i         l_i_bar += h b_i x_bar, m_i_bar += h b_i v'_bar
//! l_i = c_i + h gamma_ii m_i                    m_i_bar += h gamma_ii l_i_bar
//! (M + N) m_i = u_i - bias                      u_i_bar = (M + N)^-1 m_i_bar; q_i, v_i and constants by the
//!                                               reverse product of inverse dynamics at m_i
//! N = r + h g d + h^2 g^2 k                     N_bar = -u_i_bar m_i, row by row
//! ```
//!
//! and likewise for the joint torques and the preceding stages. Gradients by configurations are in their tangent spaces
//! ([`Motion`](crate::joints::Motion)). A stage costs one factorization of M, one additional solve and one reverse
//! product, all O(N), with the sweeps of forward dynamics.

use super::events::RowSolution;
use super::manifold::advance_cotangents;
use super::method::STAGES;
use super::modes::{STUCK_NOISE, rounded_speed};
use super::scratch::{KD, KP, Scratch, add_scaled, clear};
use super::solver::{Checked, Solver};
use super::step::{Part, at_stage, do_part};
use super::step_settings::{StepArguments, StepSettings};
use super::wrenches::LinkWrenches;
use crate::batch::accelerations::KernelArguments;
use crate::batch::instruction_set::{Target, Vectorized, Work};
use crate::batch::{factor::with_factor, gradients::gradients};
use crate::dynamics;
use crate::dynamics::derivatives::{self, CoStates, Constants, Parameters, ProductScratch};
use crate::dynamics::forces::Motion;
use crate::dynamics::sweeps::SweepModel;
use crate::error::Error;
use crate::filter::Form;
use crate::model::Model;
use crate::scalar::{Real, lanes_but};
use crate::scene::{Coupling, Scene};
use crate::workspace::Workspace;
use std::sync::Arc;

/// Gradients by the initial state of a step and by the quantities that act during it; NaN initially.
#[derive(Debug)]
pub(super) struct StepGradients<T> {
    /// By the end state of the step.
    pub end: [Vec<T>; 2],
    /// By the increment of the step, besides those by its end; empty if there are none.
    pub end_increment: Vec<T>,
    /// By the initial state of the step.
    pub start: [Vec<T>; 2],
    /// By torque, target, target velocity, armature, damping, stiffness and friction, (nv) each.
    pub acting: [Vec<T>; ACTING],
    /// By the wrenches on links, 6 each.
    pub wrenches: Vec<T>,
    /// By the inertial parameters of each body; empty if they are not requested.
    pub parameters: Vec<Parameters<T>>,
    /// By the inertial parameters, of one stage.
    stage_parameters: Vec<Parameters<T>>,
    /// By the velocities l and accelerations m of the stages.
    l: [Vec<T>; STAGES],
    m: [Vec<T>; STAGES],
    /// Of one stage: by its increment and its transported velocity, and by (q, v, u) of forward dynamics.
    x: Vec<T>,
    c: Vec<T>,
    of_dynamics: Vec<T>,
    /// By the secant coefficient of regularized friction, which is evaluated at the start of the step.
    chord: Vec<T>,
    /// The increment of the whole step.
    increment: Vec<T>,
    spring: Vec<T>,
}

/// Number of quantities per degree of freedom with gradients.
pub(super) const ACTING: usize = 7;
/// Indices; the first ones are inputs, which can change from step to step.
pub(super) const TORQUE: usize = 0;
pub(super) const TARGET: usize = 1;
pub(super) const RATE: usize = 2;
pub(super) const INPUTS: usize = 3;
pub(super) const ARMATURE: usize = 3;
const DAMPING: usize = 4;
const STIFFNESS: usize = 5;
pub(super) const FRICTION: usize = 6;

impl<T: Real> StepGradients<T> {
    pub fn new(model: &Model<T>, settings: &StepSettings, parameters: bool) -> Self {
        let nan = T::from_f64(f64::NAN);
        let rates = || vec![nan; model.nv()];
        let bodies = if parameters { model.bodies.len() } else { 0 };
        let links = settings.wrenches.as_ref().map_or(0, |wrenches| wrenches.links());
        Self {
            end: [rates(), rates()],
            end_increment: Vec::new(),
            start: [rates(), rates()],
            acting: std::array::from_fn(|_| rates()),
            wrenches: vec![nan; 6 * links],
            parameters: vec![[nan; 10]; bodies],
            stage_parameters: vec![[nan; 10]; bodies],
            l: std::array::from_fn(|_| rates()),
            m: std::array::from_fn(|_| rates()),
            x: rates(),
            c: rates(),
            of_dynamics: vec![nan; 3 * model.nv()],
            chord: rates(),
            increment: rates(),
            spring: rates(),
        }
    }

    /// All results that [`backward`] writes for its caller.
    pub fn results(&mut self) -> impl Iterator<Item = &mut [T]> {
        let Self { start, acting, wrenches, parameters, .. } = self;
        let rates = start.iter_mut().chain(acting).chain([wrenches]).map(Vec::as_mut_slice);
        rates.chain(std::iter::once(parameters.as_flattened_mut()))
    }
}

/// The gradients of a stage: by q, v and u, (3 nv) into `out`, for the `cotangent` of qdd, and by the parameters if
/// `parameters` is not empty.
pub(super) struct StageGradients<'a, T> {
    pub cotangent: &'a [T],
    pub parameters: &'a mut [Parameters<T>],
    pub out: &'a mut [T],
}

impl StepGradients<f64> {
    /// Checks that all results are finite. Returns the joint and the error if they are not.
    pub fn check(&mut self, scene: &Scene) -> Result<(), (String, Error)> {
        let mut results = self.results();
        results.try_for_each(|numbers| scene.check_result("gradients", numbers)).map_err(|error| (String::new(), error))
    }
}

/// Computes the accelerations of a stage and their gradients. Both methods return, as bits, the lanes whose error
/// estimate exceeds the tolerance.
pub(super) trait BackwardSolver<T: Real> {
    /// Writes qdd and keeps the factor of M, unless both are known.
    #[inline(always)]
    fn factor(&mut self, _: KernelArguments<'_, T>) -> u64 {
        0
    }

    /// The gradients with the factor of the last [`BackwardSolver::factor`].
    fn gradients(&mut self, call: KernelArguments<'_, T>, to: StageGradients<'_, T>) -> u64;
}

/// Solver with the compiled kernels of one instruction set.
pub(super) struct VectorizedBackward<T, I> {
    target: I,
    form: Form,
    co_states: CoStates<T>,
    x: Vec<T>,
}

impl<T: Real, I> VectorizedBackward<T, I> {
    pub fn new(target: I, form: Form, (model, sweeps): (&Model<T>, &SweepModel<T>)) -> Self {
        Self { target, form, co_states: CoStates::new(sweeps), x: vec![T::from_f64(f64::NAN); model.nv()] }
    }
}

impl<T: Vectorized, I: Target> BackwardSolver<T> for VectorizedBackward<T, I> {
    #[inline(always)]
    fn factor(&mut self, call: KernelArguments<'_, T>) -> u64 {
        with_factor(self.target, self.form, call)
    }

    #[inline(always)]
    fn gradients(&mut self, call: KernelArguments<'_, T>, to: StageGradients<'_, T>) -> u64 {
        let StageGradients { cotangent, parameters, out } = to;
        let KernelArguments { scene, scratch, state: (q, qd, _), wrenches, qdd } = call;
        let motion = Motion { q, qd, qdd: Some(qdd), wrenches };
        let constants = &mut Constants { parameters, ..Constants::default() };
        let room = (scene, (scratch, &mut self.co_states));
        gradients(self.target, Some(self.form), room, (motion, cotangent), (constants, &mut self.x, out))
    }
}

/// Solver for one state with all checks, in the form of the workspace.
pub(super) struct CheckedBackward {
    pub solver: Checked,
    products: ProductScratch<f64>,
}

impl CheckedBackward {
    pub fn new(model: &Model<f64>, coupling: Option<Arc<Coupling>>, form: Form, tolerance: Option<f64>) -> Self {
        let solver = Checked::new(model, coupling, form).accepting(tolerance);
        Self { solver, products: ProductScratch::new(model) }
    }

    /// The same solver for a step with known accelerations.
    pub fn known<'a>(&'a mut self, accelerations: &'a [f64]) -> KnownAccelerations<'a> {
        KnownAccelerations {
            solver: &mut self.solver,
            products: &mut self.products,
            accelerations: Some(accelerations),
        }
    }
}

impl BackwardSolver<f64> for CheckedBackward {
    fn factor(&mut self, call: KernelArguments<'_, f64>) -> u64 {
        self.solver.solve(true, call)
    }

    fn gradients(&mut self, call: KernelArguments<'_, f64>, to: StageGradients<'_, f64>) -> u64 {
        let StageGradients { cotangent, parameters, out } = to;
        let KernelArguments { scene: (model, _), state, wrenches, qdd, .. } = call;
        let mut u_bar = vec![f64::NAN; cotangent.len()];
        if self.solver.solve_coupled(model, (state.0, None), cotangent, &mut u_bar) {
            let room = (&mut self.solver.workspace, &mut self.products);
            gradients_by_torques(model, room, (state.0, state.1, qdd), &u_bar, (parameters, out));
            return 0;
        }
        let Self { solver: Checked { workspace, lost, .. }, products } = self;
        let constants = &mut Constants { parameters, ..Constants::default() };
        let found =
            derivatives::forward_dynamics_vjp(model, workspace, products, state, wrenches, cotangent, (constants, out));
        if let Err(found) = found {
            lost.get_or_insert(found);
        }
        0
    }
}

/// Solver for a step whose accelerations are known: those of an event; or, without them, those in the scratch, with the
/// factor of M in the workspace.
pub(super) struct KnownAccelerations<'a> {
    pub solver: &'a mut Checked,
    pub products: &'a mut ProductScratch<f64>,
    pub accelerations: Option<&'a [f64]>,
}

impl BackwardSolver<f64> for KnownAccelerations<'_> {
    fn factor(&mut self, call: KernelArguments<'_, f64>) -> u64 {
        self.accelerations.iter().for_each(|known| call.qdd.copy_from_slice(known));
        0
    }

    fn gradients(&mut self, call: KernelArguments<'_, f64>, to: StageGradients<'_, f64>) -> u64 {
        let StageGradients { cotangent, parameters, out } = to;
        let KernelArguments { scene: (model, _), state: (q, qd, _), qdd, .. } = call;
        let mut u_bar = vec![f64::NAN; cotangent.len()];
        match self.accelerations {
            Some(_) => self.solver.factorise_and_solve(model, q, cotangent, &mut u_bar),
            None => dynamics::solve(model, &mut self.solver.workspace, cotangent, &mut u_bar),
        }
        let (room, qdd) = ((&mut self.solver.workspace, &mut *self.products), self.accelerations.unwrap_or(qdd));
        gradients_by_torques(model, room, (q, qd, qdd), &u_bar, (parameters, out));
        0
    }
}

/// Gradients by q, v and u at known accelerations, (3 nv) into `out`, and by the parameters, from the gradient `u_bar`
/// by the torques.
fn gradients_by_torques(
    model: &Model<f64>,
    (workspace, products): (&mut Workspace<f64>, &mut ProductScratch<f64>),
    state: (&[f64], &[f64], &[f64]),
    u_bar: &[f64],
    (parameters, out): (&mut [Parameters<f64>], &mut [f64]),
) {
    let negative: Vec<f64> = u_bar.iter().map(|x| -x).collect();
    let constants = &mut Constants { parameters, ..Constants::default() };
    derivatives::inverse_dynamics_vjp(model, workspace, products, state, &[], &negative, (constants, out));
    let last = out.len() - u_bar.len();
    out[last..].copy_from_slice(u_bar);
}

/// Computes the gradients by the start of the step from those by its end; the step starts at `s.q` and `s.v`.
///
/// Returns as bits the lanes whose error estimate exceeds the tolerance, whose modes change before the end, or whose
/// step is too long. `solutions` has the stuck rows of an event, for one state; `None` if the initial state determines
/// the modes.
#[inline(always)]
pub(super) fn backward<T: Real, I: Target, S: BackwardSolver<T>>(
    target: I,
    by @ (_, scheme): StepArguments<'_>,
    s: &mut Scratch<T>,
    to: &mut StepGradients<T>,
    solver: &mut S,
    solutions: Option<&[RowSolution]>,
) -> u64 {
    let (last, is_event) = (scheme.tableau.last_stage(), solutions.is_some());
    let mut fallback = 0;
    do_part(target, Part::Begin { drives: !is_event }, by, s);
    if let Some(solutions) = solutions {
        set_event_modes(by, s, solutions);
    }
    for i in 0..last {
        do_part(target, Part::Stage(i), by, s);
        fallback |= solver.factor(at_stage(s, i));
        do_part(target, Part::FinishStage(i), by, s);
    }
    clear(&mut s.control);
    for i in (0..=last).rev() {
        do_part(target, Part::Stage(i), by, s);
        fallback |= solver.factor(at_stage(s, i));
        do_part(target, if i == last { Part::FinishStage(i) } else { Part::Hold(i) }, by, s);
        reverse_part(target, ReversePart::Before { stage: i, is_event }, by, s, to);
        let StepGradients { m, stage_parameters, of_dynamics, .. } = to;
        let of_stage = StageGradients { cotangent: &m[i], parameters: stage_parameters, out: of_dynamics };
        fallback |= solver.gradients(at_stage(s, i), of_stage);
        reverse_part(target, ReversePart::After { stage: i }, by, s, to);
    }
    reverse_part(target, ReversePart::Start { is_event }, by, s, to);
    if let Some(solutions) = solutions {
        to.of_stuck_rows(s, solutions);
    } else {
        do_part(target, Part::Finish, by, s);
        fallback |= lanes_but::<T>(|lane| s.consistent.lane(lane) > 0.0 && s.short_enough.lane(lane) > 0.0);
    }
    fallback
}

/// The parts of the adjoint of a step between the gradients of the accelerations of its stages.
#[derive(Debug, Clone, Copy)]
enum ReversePart {
    /// Gradients by the accelerations of a stage; in the last one those by the end of the step first.
    Before { stage: usize, is_event: bool },
    /// From the gradients of these accelerations to those by torques, wrenches and the stages before.
    After { stage: usize },
    /// By the start of the step.
    Start { is_event: bool },
}

struct InReversePart<'a, T: Real>(ReversePart, StepArguments<'a>, &'a mut Scratch<T>, &'a mut StepGradients<T>);

impl<T: Real> Work for InReversePart<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self(part, by @ (settings, scheme), s, to) = self;
        match part {
            ReversePart::Before { stage: i, is_event } => {
                if i == scheme.tableau.last_stage() {
                    to.of_end(by, s);
                }
                if !is_event {
                    release(s, &mut to.l[i]);
                }
                add_scaled(&mut to.m[i], scheme.tableau.gamma[i][i], &to.l[i]);
                if !is_event {
                    release(s, &mut to.m[i]);
                }
                to.c.copy_from_slice(&to.l[i]);
            }
            ReversePart::After { stage: i } => {
                to.of_torques(by, s, i);
                if let Some(wrenches) = &settings.wrenches {
                    to.of_wrenches(wrenches, s);
                }
                to.of_stage(by, s, i);
            }
            ReversePart::Start { is_event } => {
                to.of_friction(by, s);
                if !is_event {
                    // A joint that is at rest stays at rest for all perturbations.
                    release(s, &mut to.start[1]);
                }
            }
        }
    }
}

/// A part of the adjoint of a step, with the instructions of `target`; compiled once for all solvers, as [`do_part`].
#[inline(never)]
fn reverse_part<T: Real, I: Target>(
    target: I,
    part: ReversePart,
    by: StepArguments<'_>,
    s: &mut Scratch<T>,
    to: &mut StepGradients<T>,
) {
    target.within(InReversePart(part, by, s, to));
}

/// Sets the rows of stuck joints to zero.
#[inline(always)]
fn release<T: Real>(s: &Scratch<T>, rates: &mut [T]) {
    for mode in &s.modes {
        let free = mode.stuck.constant(1.0) - mode.stuck;
        rates[mode.row] *= free;
    }
}

/// Sets the modes of an event.
fn set_event_modes<T: Real>((settings, scheme): StepArguments<'_>, s: &mut Scratch<T>, solutions: &[RowSolution]) {
    let hg = if settings.regularized { scheme.tableau.gamma[0][0] } else { 0.0 };
    for (of, solution) in settings.set_valued.iter().zip(solutions).filter(|(of, _)| of.drives) {
        let (is_limit, zero) = (solution.driven.is_limit, T::zero());
        let decline = T::from_f64(solution.driven.slope);
        s.rows[of.row].side = T::from_f64(f64::from(u8::from(is_limit)));
        // The law has a target velocity at a limit that declines too.
        let held = T::from_f64(solution.driven.torque).minus_product(decline, s.target_rate[of.row]);
        let [kp, kd] = [KP, KD].map(|i| s.gains[i][of.row]);
        let terms = if is_limit { ([zero, decline], held) } else { ([kp, kd], zero) };
        s.drive(scheme.implicit_step(), of.row, terms);
    }
    for (mode, row_solution) in s.modes.iter_mut().zip(solutions) {
        (mode.stuck, mode.target) = (T::from_f64(row_solution.stuck), T::from_f64(row_solution.target));
        s.dry[mode.row] = T::from_f64(row_solution.torque);
        let of = &s.rows[mode.row];
        let moving = s.chord[mode.row].mul_add(T::from_f64(hg), of.noise);
        s.model.system.noise[mode.row] = if row_solution.stuck > 0.0 { T::from_f64(STUCK_NOISE) } else { moving };
    }
}

impl<T: Real> StepGradients<T> {
    /// Gradients by the end of the step; all others are zero.
    #[inline(always)]
    fn of_end(&mut self, (_, scheme): StepArguments<'_>, s: &Scratch<T>) {
        let t = &scheme.tableau;
        let Self { end, end_increment, start, acting, wrenches, parameters, l, m, x, chord, increment, .. } = self;
        for numbers in acting.iter_mut().chain([wrenches]) {
            clear(numbers);
        }
        clear(parameters.as_flattened_mut());
        clear(chord);
        clear(increment);
        clear(x);
        clear(&mut start[0]);
        start[1].copy_from_slice(&end[1]);
        for i in 0..t.stages {
            add_scaled(increment, t.weights[i], &s.l[i]);
        }
        advance_cotangents(&s.model, increment, &end[0], (&mut start[0], x));
        if !end_increment.is_empty() {
            add_scaled(x, 1.0, end_increment);
        }
        for i in 0..t.stages {
            clear(&mut l[i]);
            clear(&mut m[i]);
            add_scaled(&mut l[i], t.weights[i], x);
            add_scaled(&mut m[i], t.weights[i], &end[1]);
        }
    }

    /// Gradients through the joint torques of stage `i` (springs, damping, friction, control law), from `of_dynamics`.
    #[inline(always)]
    fn of_torques(&mut self, (settings, scheme): StepArguments<'_>, s: &Scratch<T>, i: usize) {
        let t = &scheme.tableau;
        let nv = s.rows.len();
        let Self { acting, parameters, stage_parameters, l, m, c, of_dynamics, chord, spring, .. } = self;
        for (sum, &more) in parameters.as_flattened_mut().iter_mut().zip(stage_parameters.as_flattened()) {
            *sum += more;
        }
        let (by_q, rest) = of_dynamics.split_at_mut(nv);
        let (by_v, by_u) = rest.split_at_mut(nv);
        for (row, of) in s.rows.iter().enumerate() {
            let (v, u_bar) = (s.v_stage[row], by_u[row]);
            let hg = v.constant(t.gamma[i][i]);
            let slower = rounded_speed(settings, v).recip();
            let noise_bar = -(u_bar * s.m[i][row]);
            let v0 = settings.properties.friction_speed;
            acting[TORQUE][row] += u_bar;
            let is_linear = v.constant(1.0) - of.side.abs();
            acting[RATE][row] = (of.derivative * is_linear).mul_add(u_bar, acting[RATE][row]);
            acting[ARMATURE][row] += noise_bar;
            acting[DAMPING][row] = acting[DAMPING][row].minus_product(v, u_bar);
            acting[STIFFNESS][row] = acting[STIFFNESS][row].minus_product(s.displaced[row], u_bar);
            // The friction of rows with exact friction is part of their modes.
            if settings.regularized || settings.properties.friction[row] == 0.0 {
                acting[FRICTION][row] = acting[FRICTION][row].minus_product(v * slower, u_bar);
            }
            // d/dv of v/sqrt(v^2 + v0^2) is v0^2/sqrt(v^2 + v0^2)^3.
            let rubbing = if v0 == 0.0 {
                // The cube of the reciprocal of a velocity that is only rounding overflows.
                v.constant(0.0)
            } else {
                of.friction * (slower * slower) * slower * v.constant(v0 * v0)
            };
            by_v[row] = by_v[row].minus_product(of.damping + of.derivative + rubbing, u_bar);
            if scheme.implicit {
                let (stiffness, damping) = (of.stiffness + of.proportional, of.damping + of.derivative + s.chord[row]);
                let (mut moved, mut sped) = (s.c[row] * hg, v.constant(0.0));
                for j in 0..i {
                    let gamma = v.constant(t.gamma[i][j]);
                    moved = s.l[j][row].mul_add(gamma, moved);
                    sped = s.m[j][row].mul_add(gamma, sped);
                    l[j][row] = l[j][row].minus_product(gamma * stiffness, u_bar);
                    m[j][row] = m[j][row].minus_product(gamma * damping, u_bar);
                }
                c[row] = c[row].minus_product(hg * stiffness, u_bar);
                // Gradients by the damping of joint and controller, and by the implicit part of the spring.
                let by_damping = (hg * noise_bar).minus_product(sped, u_bar);
                let by_stiffness = (hg * hg * noise_bar).minus_product(moved, u_bar);
                acting[DAMPING][row] += by_damping;
                acting[STIFFNESS][row] += by_stiffness;
                chord[row] += by_damping;
            }
        }
        // At a limit of the sum, the applied torque has no effect.
        for &row in settings.limited.iter().filter(|_| settings.limits_sum) {
            acting[TORQUE][row] = acting[TORQUE][row].minus_product(s.rows[row].side.abs(), by_u[row]);
        }
        // A joint without friction can have that of joints that follow it, which the loop above contains.
        let rubs = |row: usize| settings.properties.friction[row] != 0.0;
        for (mode, of) in s.modes.iter().zip(&settings.set_valued).filter(|(_, of)| of.rubs() && rubs(of.row)) {
            let by_friction = s.dry[mode.row] * mode.friction.recip();
            acting[FRICTION][of.row] = by_friction.mul_add(by_u[of.row], acting[FRICTION][of.row]);
        }
        for (k, body) in s.model.bodies.iter().enumerate() {
            let stage = &s.model.system.stages[k];
            let (rows, at) = (stage.first_row..stage.first_row + stage.rows.count(), body.q);
            for (is_pulled, rest, by_spring) in
                [(settings.sprung_bodies[k], &s.rest, true), (settings.controlled_bodies[k], &s.target, false)]
            {
                if !is_pulled {
                    continue;
                }
                for row in rows.clone() {
                    let of = &s.rows[row];
                    spring[row] = -((if by_spring { of.stiffness } else { of.proportional }) * by_u[row]);
                }
                let (row, ends) = (rows.start, (&rest[at..], &s.q_stage[at..]));
                body.motion.displacement_cotangent(ends, &spring[row..], &mut by_q[row..]);
                if !by_spring {
                    body.motion.rest_cotangent(ends, &spring[row..], &mut acting[TARGET][row..]);
                }
            }
        }
    }

    /// Gradients through the wrenches of a stage, from `of_dynamics`.
    #[inline(always)]
    fn of_wrenches(&mut self, wrenches: &LinkWrenches, s: &mut Scratch<T>) {
        let (by_q, rest) = self.of_dynamics.split_at_mut(s.v.len());
        let (by_u, results) = (&rest[s.v.len()..], (by_q, &mut self.wrenches[..]));
        s.wrenches.add_gradients(&s.model, wrenches, &s.q_stage, by_u, results);
    }

    /// Gradients through the state of stage `i` to the stages before it and to the start of the step.
    #[inline(always)]
    fn of_stage(&mut self, (_, scheme): StepArguments<'_>, s: &Scratch<T>, i: usize) {
        let t = &scheme.tableau;
        let nv = s.rows.len();
        let Self { start: [start_q, start_v], l, m, x, c, of_dynamics, .. } = self;
        let (by_q, by_v) = of_dynamics[..2 * nv].split_at(nv);
        if i > 0 {
            clear(x);
            for (m, &gamma) in m.iter_mut().zip(&t.gamma[i][..i]) {
                add_scaled(m, gamma, c);
            }
            for (body, stage) in s.model.bodies.iter().zip(&s.model.system.stages) {
                let row = stage.first_row;
                let along = (&s.x[row..], &s.v_stage[row..]);
                body.motion.carry_back_cotangents(along, &mut c[row..], &mut x[row..]);
                body.motion.advance_cotangents(&s.x[row..], &by_q[row..], &mut start_q[row..], &mut x[row..]);
            }
        } else {
            add_scaled(start_q, 1.0, by_q);
        }
        // c and by_v are both gradients by the velocity of the stage.
        for by_velocity in [&c[..], by_v] {
            add_scaled(start_v, 1.0, by_velocity);
            for (m, &alpha) in m.iter_mut().zip(&t.alpha[i][..i]) {
                add_scaled(m, alpha, by_velocity);
            }
        }
        for (l, &alpha) in l.iter_mut().zip(&t.alpha[i][..i]) {
            add_scaled(l, alpha, x);
        }
    }

    /// Gradients through the prescribed accelerations of stuck rows of an event, which depend on its initial state.
    fn of_stuck_rows(&mut self, s: &Scratch<T>, solutions: &[RowSolution]) {
        let nv = s.rows.len();
        let Self { start: [start_q, start_v], of_dynamics, .. } = self;
        let by_u = &of_dynamics[2 * nv..];
        for (mode, row_solution) in s.modes.iter().zip(solutions).filter(|(_, row_solution)| row_solution.stuck > 0.0) {
            let by_target = by_u[mode.row] * T::from_f64(STUCK_NOISE);
            let [by_q, by_v] = row_solution.slopes;
            start_q[mode.row] = by_target.mul_add(T::from_f64(by_q), start_q[mode.row]);
            start_v[mode.row] = by_target.mul_add(T::from_f64(by_v), start_v[mode.row]);
        }
    }

    /// Adds the gradients through the noise of M in other equations than those of the stages, r + h d + h^2 k + h f/s.
    pub fn add_noise(&mut self, by: StepArguments<'_>, s: &Scratch<T>, noise: &[T]) {
        let hg = by.1.tableau.gamma[0][0];
        add_scaled(&mut self.acting[ARMATURE], 1.0, noise);
        add_scaled(&mut self.acting[DAMPING], hg, noise);
        add_scaled(&mut self.acting[STIFFNESS], hg * hg, noise);
        clear(&mut self.chord);
        add_scaled(&mut self.chord, hg, noise);
        self.of_friction(by, s);
    }

    /// Gradients through the secant coefficient of friction, f/sqrt(v^2 + v0^2) at the start of the step, in implicit
    /// methods.
    #[inline(always)]
    fn of_friction(&mut self, (settings, scheme): StepArguments<'_>, s: &Scratch<T>) {
        if !scheme.implicit || settings.properties.friction_speed == 0.0 {
            return;
        }
        for (row, of) in s.rows.iter().enumerate() {
            let v = s.v[row];
            let slower = rounded_speed(settings, v).recip();
            let by_chord = self.chord[row] * slower;
            self.acting[FRICTION][row] += by_chord;
            let turned = of.friction * v * (slower * slower);
            self.start[1][row] = self.start[1][row].minus_product(turned, by_chord);
        }
    }
}

#[cfg(test)]
mod tests;
