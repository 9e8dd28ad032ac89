//! One step of one state, or of one state a lane, by any method.

use super::conserve::{KEPT, Keeper};
use super::constrained::Stabilisation;
use super::contact::width_of_contacts;
use super::manifold::{advance, carry_back};
use super::method::{Method, STAGES, Tableau};
use super::properties::{Gains, Properties, joint_of_row};
use crate::batch::accelerations::{Call, by_covariance, watched};
use crate::batch::arms::{Target, Vectorised};
use crate::dynamics;
use crate::dynamics::auto::Errors;
use crate::dynamics::sweeps::{SweepModel, SweepScratch};
use crate::error::Error;
use crate::filter::Form;
use crate::filter::pivots::LostPivot;
use crate::model::Model;
use crate::scalar::Real;
use crate::scene::Scene;
use crate::workspace::Workspace;

/// What every step of a rollout has in common, in numbers of one state.
#[derive(Debug, Clone)]
pub(super) struct Law {
    pub step: f64,
    pub method: Method,
    /// The coefficients, times the step.
    pub tableau: Tableau,
    pub implicit: bool,
    pub properties: Properties,
    pub gains: Option<Gains>,
    /// The bodies that trees begin with whose momentum is kept; empty where it is left to the method.
    pub roots: Vec<usize>,
    /// Whether some joint has friction.
    pub rubs: bool,
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
            tableau: method.tableau().times(step),
            implicit: method.is_implicit(),
            rubs: properties.friction.iter().any(|&f| f != 0.0),
            sprung: stiff(&properties.stiffness),
            pulled: gains.as_ref().map_or_else(|| vec![false; model.bodies.len()], |g| stiff(&g.proportional)),
            properties,
            gains,
            roots,
            connected: None,
        }
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

    /// How many numbers a rollout has of each state: q, qd, and where momentum is kept, what is kept and two corrections; of a scene with
    /// contacts, their impulses and what is told of them.
    pub fn width(&self, scene: &Scene) -> usize {
        let kept = if self.roots.is_empty() { 0 } else { KEPT * self.roots.len() + 2 };
        let touching = if self.method == Method::Contact { width_of_contacts(scene.contact_points().len()) } else { 0 };
        scene.nq() + scene.nv() + kept + touching
    }

    /// Damping and stiffness of one degree of freedom, the control law's with the joint's own.
    fn implicit_terms(&self, row: usize) -> (f64, f64) {
        let (d, k) = (self.properties.damping[row], self.properties.stiffness[row]);
        self.gains.as_ref().map_or((d, k), |gains| (d + gains.derivative[row], k + gains.proportional[row]))
    }

    /// Measurement noise r + h g d + h^2 g^2 k of every row, but for friction's part.
    pub fn noise(&self) -> Vec<f64> {
        // All stages of a method have the same g.
        let hg = if self.implicit { self.tableau.gamma[0][0] } else { 0.0 };
        let armature = self.properties.armature.iter().enumerate();
        armature
            .map(|(row, r)| {
                let (d, k) = self.implicit_terms(row);
                r + hg * (d + hg * k)
            })
            .collect()
    }
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
    /// How far the stage is from where the springs are at rest, and from the control law's target.
    pub displaced: Vec<T>,
    pub displaced_target: Vec<T>,
    pub keeper: Keeper<T>,
}

impl<T: Real> Scratch<T> {
    pub fn new(scene_model: &Model<f64>, law: &Law) -> Self {
        let mut of_step = scene_model.clone();
        of_step.system.noise = law.noise();
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
            displaced: rates(),
            displaced_target: rates(),
            keeper: Keeper::new(&model, &law.roots),
            model,
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
    /// Writes qdd; gives the lanes that it doubts as bits.
    fn solve(
        &mut self,
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
        scene: (&Model<T>, &SweepModel<T>),
        scratch: &mut SweepScratch<T>,
        state: (&[T], &[T], &[T]),
        qdd: &mut [T],
    ) -> u64 {
        by_covariance(self.0, Call { scene, scratch, state, wrenches: &[], qdd })
    }
}

/// The same, watched.
pub(super) struct Watched<T, I>(pub I, pub Errors<T>);

impl<T: Vectorised, I: Target> Solver<T> for Watched<T, I> {
    #[inline(always)]
    fn solve(
        &mut self,
        scene: (&Model<T>, &SweepModel<T>),
        scratch: &mut SweepScratch<T>,
        state: (&[T], &[T], &[T]),
        qdd: &mut [T],
    ) -> u64 {
        let call = Call { scene, scratch, state, wrenches: &[], qdd };
        watched(self.0, call, &mut self.1)
    }
}

/// One state with every check, in the form of the workspace.
pub(super) struct Checked {
    pub workspace: Workspace<f64>,
    /// The first pivot that was lost, since it was last taken.
    pub lost: Option<LostPivot>,
}

impl Checked {
    pub fn new(model: &Model<f64>, form: Form) -> Self {
        Self { workspace: Workspace::new(model).in_form(form), lost: None }
    }
}

impl Solver<f64> for Checked {
    fn solve(
        &mut self,
        (model, _): (&Model<f64>, &SweepModel<f64>),
        _scratch: &mut SweepScratch<f64>,
        (q, v, u): (&[f64], &[f64], &[f64]),
        qdd: &mut [f64],
    ) -> u64 {
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

/// The accelerations of the state that [`Scratch::set_stage`] has set, in `m[0]`, by a law that takes nothing implicitly.
#[cfg(feature = "adaptive")]
pub(super) fn accelerations<T: Real, S: Solver<T>>(law: &Law, s: &mut Scratch<T>, solver: &mut S) {
    forces(law, s, 0);
    solver.solve((&s.model, &s.constants), &mut s.sweeps, (&s.q_stage, &s.v_stage, &s.u), &mut s.m[0]);
}

/// From `q`, `v` to `q_next`, `v_next`; gives the lanes in doubt as bits.
#[inline(always)]
pub(super) fn step<T: Real, S: Solver<T>>(law: &Law, s: &mut Scratch<T>, solver: &mut S) -> u64 {
    let t = &law.tableau;
    let mut doubt = 0;
    if law.rubs {
        set_friction(law, s);
    }
    for i in 0..t.stages {
        stage(law, s, i);
        doubt |= solver.solve((&s.model, &s.constants), &mut s.sweeps, (&s.q_stage, &s.v_stage, &s.u), &mut s.m[i]);
        finish_stage(law, s, i);
    }
    clear(&mut s.x);
    s.v_next.copy_from_slice(&s.v);
    for i in 0..t.stages {
        add_scaled(&mut s.x, t.weights[i], &s.l[i]);
        add_scaled(&mut s.v_next, t.weights[i], &s.m[i]);
    }
    advance(&s.model, &s.q, &s.x, &mut s.q_next);
    if s.keeper.keeps() {
        s.keeper.correct(&s.model, &mut s.q_next, &mut s.v_next);
    }
    doubt
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
pub(super) fn stage<T: Real>(law: &Law, s: &mut Scratch<T>, i: usize) {
    let t = &law.tableau;
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
    forces(law, s, i);
}

/// The rate of the increment in stage `i`, whose accelerations are there.
#[inline(always)]
pub(super) fn finish_stage<T: Real>(law: &Law, s: &mut Scratch<T>, i: usize) {
    s.l[i].copy_from_slice(&s.c);
    add_scaled(&mut s.l[i], law.tableau.gamma[i][i], &s.m[i]);
}

/// Friction as damping, f / sqrt(v^2 + v0^2) at the step's start: never zero where f is not, so a row has noise in all lanes or
/// in none. Taken implicitly, it cannot turn a velocity round.
#[inline(always)]
pub(super) fn set_friction<T: Real>(law: &Law, s: &mut Scratch<T>) {
    let hg = law.tableau.gamma[0][0];
    for (row, of) in s.rows.iter().enumerate() {
        if law.properties.friction[row] == 0.0 {
            continue;
        }
        let chord = of.friction * rounded_speed(law, s.v[row]).recip();
        s.chord[row] = chord;
        if law.implicit {
            s.model.system.noise[row] = chord.mul_add(chord.constant(hg), of.noise);
        }
    }
}

/// sqrt(v^2 + v0^2).
#[inline(always)]
pub(super) fn rounded_speed<T: Real>(law: &Law, v: T) -> T {
    let v0 = v.constant(law.properties.friction_speed);
    v.mul_add(v, v0 * v0).sqrt()
}

/// The right side of stage `i`.
#[inline(always)]
fn forces<T: Real>(law: &Law, s: &mut Scratch<T>, i: usize) {
    let t = &law.tableau;
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
        u = u.minus_product(of.derivative, v - s.target_rate[row]);
        u = u.minus_product(of.proportional, s.displaced_target[row]);
        let mut damping = of.damping + of.derivative;
        if law.rubs {
            u = u.minus_product(of.friction * v, rounded_speed(law, v).recip());
            damping += s.chord[row];
        }
        if law.implicit {
            let c = s.c[row];
            let (mut moved, mut sped) = (c * c.constant(t.gamma[i][i]), c.constant(0.0));
            for j in 0..i {
                let gamma = c.constant(t.gamma[i][j]);
                moved = s.l[j][row].mul_add(gamma, moved);
                sped = s.m[j][row].mul_add(gamma, sped);
            }
            u = u.minus_product(of.stiffness + of.proportional, moved);
            u = u.minus_product(damping, sped);
        }
        s.u[row] = u;
    }
}

/// A joint that moves by more than this in one step (rad or m) has left what can be called motion.
pub(super) const FARTHEST: f64 = 1e9;

/// What is wrong with a checked step: the joint and the error.
pub(super) fn fault_of(scene: &Scene, law: &Law, s: &Scratch<f64>, lost: Option<LostPivot>) -> Option<(String, Error)> {
    let limit = FARTHEST / law.step;
    let strayed = s.v_next.iter().position(|v| !(v.abs() <= limit));
    let finite = s.v.iter().chain(&s.q).all(|x| x.is_finite());
    if let Some(lost) = lost {
        // A pivot that is not finite comes of a state that ran away within the step.
        if lost.pivot.is_finite() && lost.terms.is_finite() && finite {
            let joint = scene.joint_of_body(lost.stage).map(|joint| joint.name.clone()).unwrap_or_default();
            return Some((joint, scene.singular(lost)));
        }
    }
    if strayed.is_none() && s.q_next.iter().all(|q| q.is_finite()) && !s.keeper.correction.iter().all(|x| x.is_finite())
    {
        let joint = law.roots.first().map(|&k| joint_of_row(scene, scene.model().system.stages[k].first_row));
        let found = "a tree whose inertia about its mass centre is lost in rounding";
        let expected = "free joints at bodies that are not much further from the mass centre than the tree is large";
        return Some((joint.unwrap_or_default(), Error::argument("conserve_momentum", found, expected)));
    }
    let row = strayed.or_else(|| s.q_next.iter().any(|q| !q.is_finite()).then_some(0))?;
    let joint = joint_of_row(scene, row);
    let error = Error::Argument {
        argument: format!("rate of joint {joint:?}"),
        found: format!("{} after a step of {} s, from {}", s.v_next[row], law.step, s.v[row]),
        expected: format!(
            "a rate below {limit:.1e}: motion has diverged; take a smaller dt, or an implicit method for stiff joints"
        ),
    };
    Some((joint, error))
}
