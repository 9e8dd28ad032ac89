//! One step backward: gradients of a scalar by where a step ended become gradients by where it began, and by what acted meanwhile.
//!
//! With a bar for the gradient of the scalar by a variable of `step`, each line of the step, from its last to its first, hands its gradient on:
//!
//! ```text
//! q' = q exp(x), v' = v + h sum b_i m_i         l_i_bar += h b_i x_bar, m_i_bar += h b_i v'_bar
//! l_i = c_i + h gamma_ii m_i                    m_i_bar += h gamma_ii l_i_bar
//! (M + N) m_i = u_i - bias                      u_i_bar = (M + N)^-1 m_i_bar, and the reverse product of inverse dynamics at m_i for q_i, v_i and constants
//! N = r + h g d + h^2 g^2 k                     N_bar = -u_i_bar m_i, row by row
//! ```
//!
//! and so on through torques of joints and stages. Configurations have gradients in their tangent spaces ([`Motion`](crate::joints::Motion)). A stage costs a factor of M, one
//! more right side and a reverse product, all O(N), on the same sweeps as forward dynamics.

use super::method::STAGES;
use super::modes::{LOCKED, observe_locks, set_modes};
use super::scratch::{Scratch, add_scaled, clear};
use super::step::{finish_stage, finish_step, rounded_speed, set_friction, stage};
use super::step_settings::By;
use super::substeps::Lock;
use crate::batch::accelerations::KernelArguments;
use crate::batch::instruction_set::{Target, Vectorised};
use crate::batch::{factor::with_factor, products};
use crate::dynamics;
use crate::dynamics::derivatives::{self, CoStates, Constants, Parameters, ProductScratch};
use crate::dynamics::forces::Motion;
use crate::dynamics::sweeps::SweepModel;
use crate::filter::Form;
use crate::filter::pivots::LostPivot;
use crate::model::Model;
use crate::scalar::{Real, lanes_but};
use crate::workspace::Workspace;

/// Gradients by what a step begins with, and by what acts during it; starts as NaN.
#[derive(Debug)]
pub(super) struct StepGradients<T> {
    /// By the state at the step's end.
    pub end: [Vec<T>; 2],
    /// By the state at its start.
    pub start: [Vec<T>; 2],
    /// By torque, armature, damping, stiffness and friction, (nv) each.
    pub acting: [Vec<T>; ACTING],
    /// By the inertial parameters of each body; empty where they are not asked for.
    pub parameters: Vec<Parameters<T>>,
    /// The same of one stage.
    stage_parameters: Vec<Parameters<T>>,
    /// Of the stages' rates and accelerations.
    l: [Vec<T>; STAGES],
    m: [Vec<T>; STAGES],
    /// Of one stage: by its increment and by the carried velocity, and those by (q, v, u) of forward dynamics.
    x: Vec<T>,
    c: Vec<T>,
    of_dynamics: Vec<T>,
    /// By friction's damping, which is that of the step's start.
    chord: Vec<T>,
    /// The increment of the whole step.
    increment: Vec<T>,
    spring: Vec<T>,
}

/// How many kinds of numbers act at every degree of freedom.
pub(super) const ACTING: usize = 5;
/// The torque that was given is the first of them.
pub(super) const TORQUE: usize = 0;
const ARMATURE: usize = 1;
const DAMPING: usize = 2;
const STIFFNESS: usize = 3;
const FRICTION: usize = 4;

impl<T: Real> StepGradients<T> {
    pub fn new(model: &Model<T>, parameters: bool) -> Self {
        let nan = T::from_f64(f64::NAN);
        let rates = || vec![nan; model.nv()];
        let bodies = if parameters { model.bodies.len() } else { 0 };
        Self {
            end: [rates(), rates()],
            start: [rates(), rates()],
            acting: std::array::from_fn(|_| rates()),
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

    /// All that [`backward`] writes for others.
    pub fn results(&mut self) -> impl Iterator<Item = &mut [T]> {
        let Self { start, acting, parameters, .. } = self;
        let rates = start.iter_mut().chain(acting).map(Vec::as_mut_slice);
        rates.chain(std::iter::once(parameters.as_flattened_mut()))
    }
}

/// How accelerations of a stage, and gradients of a scalar of them, are found; both give the lanes that they doubt as bits.
pub(super) trait BackwardSolver<T: Real> {
    /// Writes qdd, and keeps the factor of M.
    fn factor(&mut self, call: KernelArguments<'_, T>) -> u64;

    /// Gradients by q, v and u where `cotangent` is that by qdd, with the factor that [`BackwardSolver::factor`] left; and by the parameters that there is room for.
    fn gradients(
        &mut self,
        call: KernelArguments<'_, T>,
        cotangent: &[T],
        parameters: &mut [Parameters<T>],
        out: &mut [T],
    ) -> u64;
}

/// The compiled kernels of these instructions.
pub(super) struct InLanes<T, I> {
    target: I,
    form: Form,
    co_states: CoStates<T>,
    x: Vec<T>,
}

impl<T: Real, I> InLanes<T, I> {
    pub fn new(target: I, form: Form, (model, sweeps): (&Model<T>, &SweepModel<T>)) -> Self {
        Self { target, form, co_states: CoStates::new(sweeps), x: vec![T::from_f64(f64::NAN); model.nv()] }
    }
}

impl<T: Vectorised, I: Target> BackwardSolver<T> for InLanes<T, I> {
    #[inline(always)]
    fn factor(&mut self, call: KernelArguments<'_, T>) -> u64 {
        with_factor(self.target, self.form, call)
    }

    #[inline(always)]
    fn gradients(
        &mut self,
        call: KernelArguments<'_, T>,
        cotangent: &[T],
        parameters: &mut [Parameters<T>],
        out: &mut [T],
    ) -> u64 {
        let KernelArguments { scene, scratch, state: (q, qd, _), wrenches, qdd } = call;
        let motion = Motion { q, qd, qdd: Some(qdd), wrenches };
        let constants = &mut Constants { parameters, ..Constants::default() };
        let room = (scene, (scratch, &mut self.co_states));
        products::gradients(self.target, Some(self.form), room, (motion, cotangent), (constants, &mut self.x, out))
    }
}

/// One state with every check, in the form of the workspace.
pub(super) struct CheckedBackward {
    workspace: Workspace<f64>,
    products: ProductScratch<f64>,
    /// The first pivot that was lost, since it was last taken.
    pub lost: Option<LostPivot>,
}

impl CheckedBackward {
    pub fn new(model: &Model<f64>, form: Form, tolerance: Option<f64>) -> Self {
        let workspace = Workspace { tolerance, ..Workspace::new(model) }.in_form(form);
        Self { workspace, products: ProductScratch::new(model), lost: None }
    }
}

impl BackwardSolver<f64> for CheckedBackward {
    fn factor(&mut self, call: KernelArguments<'_, f64>) -> u64 {
        let KernelArguments { scene: (model, _), state: (q, qd, u), wrenches, qdd, .. } = call;
        let monitor = dynamics::forward_dynamics(model, &mut self.workspace, q, qd, u, wrenches, qdd);
        if self.lost.is_none() {
            self.lost = self.workspace.lost_pivot(model, &monitor);
        }
        0
    }

    fn gradients(
        &mut self,
        call: KernelArguments<'_, f64>,
        cotangent: &[f64],
        parameters: &mut [Parameters<f64>],
        out: &mut [f64],
    ) -> u64 {
        let Self { workspace, products, lost } = self;
        let KernelArguments { scene: (model, _), state, wrenches, .. } = call;
        let constants = &mut Constants { parameters, ..Constants::default() };
        let found =
            derivatives::forward_dynamics_vjp(model, workspace, products, state, wrenches, cotangent, (constants, out));
        if let Err(found) = found {
            lost.get_or_insert(found);
        }
        0
    }
}

/// The solution of an event, whose accelerations are known.
pub(super) struct OfEvent<'a> {
    pub solver: &'a mut CheckedBackward,
    pub accelerations: &'a [f64],
}

impl BackwardSolver<f64> for OfEvent<'_> {
    fn factor(&mut self, call: KernelArguments<'_, f64>) -> u64 {
        call.qdd.copy_from_slice(self.accelerations);
        0
    }

    fn gradients(
        &mut self,
        call: KernelArguments<'_, f64>,
        cotangent: &[f64],
        parameters: &mut [Parameters<f64>],
        out: &mut [f64],
    ) -> u64 {
        let CheckedBackward { workspace, products, lost } = &mut *self.solver;
        let KernelArguments { scene: (model, _), state: (q, qd, _), wrenches, .. } = call;
        let pivots = dynamics::factorise(model, workspace, q, |_, _| {});
        if lost.is_none() {
            *lost = workspace.lost_pivot(model, &pivots);
        }
        let mut u_bar = vec![f64::NAN; cotangent.len()];
        dynamics::solve(model, workspace, cotangent, &mut u_bar);
        let negative: Vec<f64> = u_bar.iter().map(|x| -x).collect();
        let constants = &mut Constants { parameters, ..Constants::default() };
        let state = (q, qd, self.accelerations);
        derivatives::inverse_dynamics_vjp(model, products, state, wrenches, &negative, (constants, out));
        let last = out.len() - u_bar.len();
        out[last..].copy_from_slice(&u_bar);
        0
    }
}

/// What [`BackwardSolver`] reads and writes at stage `i`.
#[inline(always)]
fn at_stage<T: Real>(s: &mut Scratch<T>, i: usize) -> KernelArguments<'_, T> {
    KernelArguments {
        scene: (&s.model, &s.constants),
        scratch: &mut s.sweeps,
        state: (&s.q_stage, &s.v_stage, &s.u),
        wrenches: &[],
        qdd: &mut s.m[i],
    }
}

/// From the gradients by the step's end to those by its start, the step being from `s.q` and `s.v`; gives the lanes whose error estimate exceeds its bound, whose modes do not
/// hold until the end, or whose step is too long, as bits. `locks`: those of an event, in one state; none for a step whose modes follow from its start.
#[inline(always)]
pub(super) fn backward<T: Real, S: BackwardSolver<T>>(
    by @ (law, scheme): By<'_>,
    s: &mut Scratch<T>,
    to: &mut StepGradients<T>,
    solver: &mut S,
    locks: Option<&[Lock]>,
) -> u64 {
    // Stages without weight only estimate the error.
    let last = scheme.tableau.weights.iter().rposition(|&weight| weight != 0.0).unwrap_or(0);
    let mut doubt = 0;
    if law.rubs {
        set_friction(by, s);
    }
    set_modes(by, s);
    if let Some(locks) = locks {
        set_locks(by, s, locks);
    }
    for i in 0..last {
        stage(by, s, i);
        doubt |= solver.factor(at_stage(s, i));
        observe_locks(s, i);
        finish_stage(by, s, i);
    }
    for i in (0..=last).rev() {
        stage(by, s, i);
        doubt |= solver.factor(at_stage(s, i));
        observe_locks(s, i);
        if i == last {
            finish_stage(by, s, i);
            to.of_end(by, s);
        }
        if locks.is_none() {
            release(s, &mut to.l[i]);
        }
        add_scaled(&mut to.m[i], scheme.tableau.gamma[i][i], &to.l[i]);
        if locks.is_none() {
            release(s, &mut to.m[i]);
        }
        to.c.copy_from_slice(&to.l[i]);
        let StepGradients { m, stage_parameters, of_dynamics, .. } = to;
        doubt |= solver.gradients(at_stage(s, i), &m[i], stage_parameters, of_dynamics);
        to.of_torques(by, s, i);
        to.of_stage(by, s, i);
    }
    to.of_friction(by, s);
    if let Some(locks) = locks {
        to.of_locks(s, locks);
    } else {
        // A joint at rest stays at rest, whatever follows from it.
        release(s, &mut to.start[1]);
        finish_step(by, s);
        doubt |= lanes_but::<T>(|lane| s.consistent.lane(lane) > 0.0 && s.short_enough.lane(lane) > 0.0);
    }
    doubt
}

/// Zero in the rows that are locked.
#[inline(always)]
fn release<T: Real>(s: &Scratch<T>, rates: &mut [T]) {
    for mode in &s.modes {
        let free = mode.locked.constant(1.0) - mode.locked;
        rates[mode.row] *= free;
    }
}

/// The modes of an event.
fn set_locks<T: Real>((law, scheme): By<'_>, s: &mut Scratch<T>, locks: &[Lock]) {
    let hg = if law.rubs { scheme.tableau.gamma[0][0] } else { 0.0 };
    for (mode, lock) in s.modes.iter_mut().zip(locks) {
        (mode.locked, mode.target) = (T::from_f64(lock.locked), T::from_f64(lock.target));
        s.dry[mode.row] = T::from_f64(lock.torque);
        let of = &s.rows[mode.row];
        let moving = s.chord[mode.row].mul_add(T::from_f64(hg), of.noise);
        s.model.system.noise[mode.row] = if lock.locked > 0.0 { T::from_f64(LOCKED) } else { moving };
    }
}

impl<T: Real> StepGradients<T> {
    /// Of where the step ended, and nothing yet of all else.
    #[inline(always)]
    fn of_end(&mut self, (_, scheme): By<'_>, s: &Scratch<T>) {
        let t = &scheme.tableau;
        let Self { end, start, acting, parameters, l, m, x, chord, increment, .. } = self;
        for numbers in acting {
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
        for (body, stage) in s.model.bodies.iter().zip(&s.model.system.stages) {
            let row = stage.first_row;
            body.motion.advance_cotangents(&increment[row..], &end[0][row..], &mut start[0][row..], &mut x[row..]);
        }
        for i in 0..t.stages {
            clear(&mut l[i]);
            clear(&mut m[i]);
            add_scaled(&mut l[i], t.weights[i], x);
            add_scaled(&mut m[i], t.weights[i], &end[1]);
        }
    }

    /// Of what acts at the joints in stage `i`: springs, damping, friction and the control law, at `of_dynamics`.
    #[inline(always)]
    fn of_torques(&mut self, (law, scheme): By<'_>, s: &Scratch<T>, i: usize) {
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
            let slower = rounded_speed(law, v).recip();
            let noise_bar = -(u_bar * s.m[i][row]);
            let v0 = law.properties.friction_speed;
            acting[TORQUE][row] += u_bar;
            acting[ARMATURE][row] += noise_bar;
            acting[DAMPING][row] = acting[DAMPING][row].minus_product(v, u_bar);
            acting[STIFFNESS][row] = acting[STIFFNESS][row].minus_product(s.displaced[row], u_bar);
            // That of rows with exact friction is in their modes.
            if law.rubs || law.properties.friction[row] == 0.0 {
                acting[FRICTION][row] = acting[FRICTION][row].minus_product(v * slower, u_bar);
            }
            // d/dv of v/sqrt(v^2 + v0^2) is v0^2/sqrt(v^2 + v0^2)^3.
            let rubbing = of.friction * (slower * slower) * slower * v.constant(v0 * v0);
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
                // By damping, whosever it is, and by the spring's part that is taken at the end.
                let by_damping = (hg * noise_bar).minus_product(sped, u_bar);
                let by_stiffness = (hg * hg * noise_bar).minus_product(moved, u_bar);
                acting[DAMPING][row] += by_damping;
                acting[STIFFNESS][row] += by_stiffness;
                chord[row] += by_damping;
            }
        }
        for (mode, of) in s.modes.iter().zip(&law.set_valued).filter(|(_, of)| of.friction > 0.0) {
            let by_friction = s.dry[mode.row] * mode.friction.recip();
            acting[FRICTION][of.row] = by_friction.mul_add(by_u[of.row], acting[FRICTION][of.row]);
        }
        for (k, body) in s.model.bodies.iter().enumerate() {
            let stage = &s.model.system.stages[k];
            let (rows, at) = (stage.first_row..stage.first_row + stage.rows.count(), body.q);
            for (is_pulled, rest, by_spring) in [(law.sprung[k], &s.rest, true), (law.pulled[k], &s.target, false)] {
                if !is_pulled {
                    continue;
                }
                for row in rows.clone() {
                    let of = &s.rows[row];
                    spring[row] = -((if by_spring { of.stiffness } else { of.proportional }) * by_u[row]);
                }
                let row = rows.start;
                body.motion.displacement_cotangent((&rest[at..], &s.q_stage[at..]), &spring[row..], &mut by_q[row..]);
            }
        }
    }

    /// Of the state of stage `i`, on to the stages before it and to the step's start.
    #[inline(always)]
    fn of_stage(&mut self, (_, scheme): By<'_>, s: &Scratch<T>, i: usize) {
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
        // c is by the velocity of the stage now, as by_v is.
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

    /// Of the accelerations that an event locks rows at, which follow from its start.
    fn of_locks(&mut self, s: &Scratch<T>, locks: &[Lock]) {
        let nv = s.rows.len();
        let Self { start: [start_q, start_v], of_dynamics, .. } = self;
        let by_u = &of_dynamics[2 * nv..];
        for (mode, lock) in s.modes.iter().zip(locks).filter(|(_, lock)| lock.locked > 0.0) {
            let by_target = by_u[mode.row] * T::from_f64(LOCKED);
            let [by_q, by_v] = lock.slopes;
            start_q[mode.row] = by_target.mul_add(T::from_f64(by_q), start_q[mode.row]);
            start_v[mode.row] = by_target.mul_add(T::from_f64(by_v), start_v[mode.row]);
        }
    }

    /// Of friction's damping at the step's start, f/sqrt(v^2 + v0^2), which implicit methods take.
    #[inline(always)]
    fn of_friction(&mut self, (law, scheme): By<'_>, s: &Scratch<T>) {
        if !scheme.implicit || law.properties.friction_speed == 0.0 {
            return;
        }
        for (row, of) in s.rows.iter().enumerate() {
            let v = s.v[row];
            let slower = rounded_speed(law, v).recip();
            let by_chord = self.chord[row] * slower;
            self.acting[FRICTION][row] += by_chord;
            let turned = of.friction * v * (slower * slower);
            self.start[1][row] = self.start[1][row].minus_product(turned, by_chord);
        }
    }
}

#[cfg(test)]
mod tests;
