//! Adjoint of steps of scenes with connections by the compiled kernels, for one state per lane of a scalar.
//!
//! The step is made again and keeps the factors of M and of the rows at every stage, at every Newton step of the
//! projection and at its end. In reverse order, each solution of M x - J* p = f, J x = g has an adjoint of the same
//! kind with the same factors: one more right-hand side. A state needs the [checked
//! adjoint](super::super::closed_reverse) if the step or one of these solutions needs the checked step.

use super::super::backward::{ARMATURE, BackwardSolver, StageGradients, StepGradients, backward};
use super::super::manifold::advance_cotangents;
use super::super::scratch::{Scratch, add_scaled, clear};
use super::super::solver::Solver;
use super::super::step::step;
use super::super::step_settings::StepSettings;
use super::{Connected, STEPS, beyond_limits, factors, keep, kernel_of_rows, open_lanes, replace, slow, step_back};
use crate::batch::accelerations::KernelArguments;
use crate::batch::instruction_set::{Target, Vectorized};
use crate::batch::row_products::{AtRows, RowProductScratch, failed};
use crate::dynamics::constraints::{ConstraintKernel, Pushed, Residuals, SolutionGradients};
use crate::dynamics::contacts::LimitRow;
use crate::dynamics::derivatives::Constants;
use crate::dynamics::forces::Motion;
use crate::dynamics::sweeps::{SweepModel, SweepScratch};
use crate::filter::Form;
use crate::model::Model;
use crate::scene::Scene;

/// Scratch memory of one state per lane.
pub(in crate::motion) struct ConnectedReverse<T: Vectorized> {
    connected: Connected<T>,
    /// The factors of each stage of the step.
    stages: Vec<Factors<T>>,
    /// The Newton steps of the projection; the last factors are those of its end.
    newton: Vec<NewtonStep<T>>,
    gradients: SolutionGradients<T>,
    products: RowProductScratch<T>,
    /// The velocities before their projection, then its change; its forces, and those of one of its steps.
    change: Vec<T>,
    forces: [Vec<T>; 2],
    /// The cotangents of the end of the step, of the start of a Newton step and of its displacement.
    end: [Vec<T>; 2],
    of_start: Vec<T>,
    of_x: Vec<T>,
}

/// The factors of M and of the rows at one configuration.
struct Factors<T: Vectorized> {
    sweeps: SweepScratch<T>,
    rows: ConstraintKernel<T>,
}

impl<T: Vectorized> Factors<T> {
    fn parts(&mut self) -> (&mut SweepScratch<T>, &mut ConstraintKernel<T>) {
        (&mut self.sweeps, &mut self.rows)
    }
}

/// x = M^-1 J* p from q, in the lanes given as bits, with the factors at q.
struct NewtonStep<T: Vectorized> {
    at: Factors<T>,
    q: Vec<T>,
    x: Vec<T>,
    p: Vec<T>,
    lanes: u64,
}

impl<T: Vectorized> ConnectedReverse<T> {
    pub fn new(
        scene: &Scene,
        settings: &StepSettings,
        s: &Scratch<T>,
        (limits, parameters): (Vec<LimitRow>, bool),
    ) -> Self {
        let connected = Connected::new(scene, settings, s, limits);
        let (of_step, constraints) = ((&s.model, &s.constants), scene.constraints());
        let factors = |of: (&Model<T>, &SweepModel<T>)| Factors {
            sweeps: SweepScratch::new(of.0, of.1).accepting(settings.given.tolerance),
            rows: kernel_of_rows(of, constraints),
        };
        let of_end = connected.own.as_ref().map_or(of_step, |own| (&own.model, &own.constants));
        let rates = || vec![T::zero(); s.model.nv()];
        let of_rows = || vec![T::zero(); constraints.rows];
        let newton = || NewtonStep { at: factors(of_end), q: s.q.clone(), x: rates(), p: of_rows(), lanes: 0 };
        Self {
            stages: (0..settings.scheme.tableau.stages).map(|_| factors(of_step)).collect(),
            newton: (0..=STEPS).map(|_| newton()).collect(),
            gradients: SolutionGradients::new(&s.model, constraints, parameters),
            products: RowProductScratch::new(of_step),
            change: rates(),
            forces: [of_rows(), of_rows()],
            end: [rates(), rates()],
            of_start: rates(),
            of_x: rates(),
            connected,
        }
    }

    /// From `to.end` to all results of [`StepGradients`], for the first `states` lanes. Returns the lanes that need the
    /// fallback.
    #[inline(always)]
    pub fn step<I: Target>(
        &mut self,
        kernels: (I, Form),
        (settings, states): (&StepSettings, usize),
        s: &mut Scratch<T>,
        to: &mut StepGradients<T>,
    ) -> u64 {
        let by = (settings, &settings.scheme);
        self.connected.begin(states, s);
        self.connected.replaced();
        let mut fallback = step(kernels.0, by, s, &mut Recorded { reverse: self, kernels, at: 0 });
        fallback |= beyond_limits(&self.connected.limits, (&s.q, &s.q_next));
        if self.connected.active & !fallback == 0 {
            return u64::MAX;
        }
        for (kept, end) in self.end.iter_mut().zip(&to.end) {
            kept.copy_from_slice(end);
        }
        fallback |= self.projections(kernels, fallback, s, &mut to.end);
        let at = settings.scheme.tableau.last_stage() + 1;
        s.are_sides_given = true;
        fallback |= backward(kernels.0, by, s, to, &mut Recorded { reverse: self, kernels, at }, None);
        s.are_sides_given = false;
        add_scaled(&mut to.acting[ARMATURE], 1.0, &self.gradients.noise);
        add_scaled(to.parameters.as_flattened_mut(), 1.0, self.gradients.parameters.as_flattened());
        // A lane that needs the fallback begins with them.
        for (end, kept) in to.end.iter_mut().zip(&self.end) {
            end.copy_from_slice(kept);
        }
        fallback
    }

    /// Projects the end of the step onto the connections, and propagates its gradients through the projections, in
    /// place. Returns the lanes that need the fallback.
    #[inline(always)]
    fn projections<I: Target>(
        &mut self,
        kernels @ (target, form): (I, Form),
        mut doubt: u64,
        s: &mut Scratch<T>,
        [of_q, of_v]: &mut [Vec<T>; 2],
    ) -> u64 {
        let Self { connected, newton, gradients, products, change, forces: [forces, of_rows], of_start, of_x, .. } =
            self;
        let Connected { own, innovations, moved, active, size, .. } = connected;
        let Scratch { model, constants, q_next, v_next, .. } = s;
        let scene = own.as_ref().map_or((&*model, &*constants), |own| (&own.model, &own.constants));
        let zero = model.gravity[0].constant(0.0);
        let (size, active) = (zero.constant(*size), *active);
        let (mut before, mut made) = (zero.constant(f64::INFINITY), 0);
        loop {
            let NewtonStep { at: Factors { sweeps, rows }, q, x, p, lanes } = &mut newton[made];
            let of_factor = factors((target, form), scene, (sweeps, rows), (q_next, v_next), x);
            let left = rows.largest(Residuals::Errors);
            let open = open_lanes(left, before, size, 0.5);
            let going = open & active & !doubt & !of_factor;
            if going == 0 || made == STEPS {
                doubt |= open | of_factor;
                break;
            }
            (before, made, *lanes) = (left, made + 1, going);
            q.copy_from_slice(q_next);
            doubt |= step_back((target, scene), (sweeps, rows), (innovations, x, moved), (q_next, going));
            p.copy_from_slice(rows.step());
            for numbers in [x, p] {
                keep(numbers, going, zero);
            }
        }
        let (before_end, end) = newton.split_at_mut(made);
        let end = &mut end[0].at;
        change.copy_from_slice(v_next);
        clear(forces);
        let (Factors { sweeps, rows }, lanes) = (&mut *end, (size, active & !doubt));
        let vectors = (&mut innovations[..], &mut of_x[..]);
        doubt |= slow((target, scene), (sweeps, rows), vectors, (v_next, lanes), Some([of_rows, &mut forces[..]]));
        for (change, &v) in change.iter_mut().zip(&*v_next) {
            *change = v - *change;
        }

        gradients.begin();
        let mut at = AtRows::new(kernels, scene, (end.parts(), products), q_next);
        doubt |= at.solve(gradients, (of_v, &[]), active & !doubt);
        let velocities = (&v_next[..], Pushed { x: change, p: forces });
        doubt |= failed(gradients.of_projection(&mut at, velocities, of_v, of_q));
        // The steps end where the next one would be rounding. Perturbed configurations are moved by this step too.
        doubt |= at.solve(gradients, (of_q, &[]), active & !doubt);
        gradients.of_last_step(&mut at, of_q);
        for NewtonStep { at, q, x, p, lanes } in before_end.iter_mut().rev() {
            clear(of_start);
            clear(of_x);
            advance_cotangents(scene.0, x, of_q, (&mut *of_start, &mut *of_x));
            let mut at = AtRows::new(kernels, scene, (at.parts(), products), q);
            doubt |= at.solve(gradients, (of_x, &[]), active & !doubt);
            doubt |= failed(gradients.of_position_step(&mut at, Pushed { x, p }, of_x, of_start));
            replace(of_q, of_start, *lanes);
        }
        doubt
    }
}

/// The accelerations of the stages with their factors: forward, where `at` is the next stage, and backward, where it is
/// the stage after the next one.
struct Recorded<'a, T: Vectorized, I> {
    reverse: &'a mut ConnectedReverse<T>,
    kernels: (I, Form),
    at: usize,
}

impl<T: Vectorized, I: Target> Solver<T> for Recorded<'_, T, I> {
    #[inline(always)]
    fn solve(&mut self, estimates: bool, call: KernelArguments<'_, T>) -> u64 {
        let (ConnectedReverse { connected, stages, .. }, (target, form)) = (&mut *self.reverse, self.kernels);
        // The first stage, also of a step that is made again.
        self.at = if estimates { 0 } else { self.at };
        let Factors { sweeps, rows } = &mut stages[self.at];
        self.at += 1;
        std::mem::swap(&mut connected.rows, rows);
        let call = KernelArguments { scratch: sweeps, ..call };
        let lanes = connected.accelerations((target, form, estimates), call);
        std::mem::swap(&mut connected.rows, rows);
        lanes
    }
}

impl<T: Vectorized, I: Target> BackwardSolver<T> for Recorded<'_, T, I> {
    #[inline(always)]
    fn gradients(&mut self, call: KernelArguments<'_, T>, to: StageGradients<'_, T>) -> u64 {
        let StageGradients { cotangent, parameters, out } = to;
        let KernelArguments { scene, state: (q, qd, _), wrenches, qdd, .. } = call;
        let ConnectedReverse { connected, stages, gradients, products, forces: [forces, _], .. } = &mut *self.reverse;
        self.at -= 1;
        let factors = &mut stages[self.at];
        forces.copy_from_slice(&factors.rows.forces_of_rows);
        let mut at = AtRows::new(self.kernels, scene, (factors.parts(), products), q);
        let doubt = at.solve(gradients, (cotangent, &[]), connected.active);
        let motion = Motion { q, qd, qdd: Some(qdd), wrenches };
        let constants = &mut Constants { parameters, ..Constants::default() };
        doubt | failed(gradients.of_accelerations(&mut at, (motion, forces), (constants, out)))
    }
}
