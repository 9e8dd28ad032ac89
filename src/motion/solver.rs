//! Solvers for the accelerations of a stage: compiled kernels, with or without an error estimate, or the general
//! recursions with all checks.

use super::connected::{Connected, kernel_of_rows};
use crate::batch::accelerations::{KernelArguments, by_covariance, watched};
use crate::batch::connected;
use crate::batch::factor::{self, with_factor};
use crate::batch::instruction_set::{Baseline, InstructionSet, Target, Vectorized, on_instruction_set};
use crate::dynamics;
use crate::dynamics::auto::Errors;
use crate::dynamics::constraints::{ConstraintKernel, ConstraintScratch, constrained_dynamics};
use crate::dynamics::sweeps::{SweepModel, SweepScratch};
use crate::filter::Form;
use crate::filter::pivots::LostPivot;
use crate::model::Model;
use crate::scalar::Real;
use crate::scene::Coupling;
use crate::scene::constraint::Constraints;
use crate::workspace::Workspace;
use nalgebra::Vector6;
use std::sync::Arc;

/// Computes the accelerations of a stage.
pub(super) trait Solver<T: Real> {
    /// Writes qdd, and returns as bits the lanes whose error estimate exceeds the tolerance. `estimates`: whether the
    /// error is estimated; otherwise only pivots are checked.
    fn solve(&mut self, estimates: bool, call: KernelArguments<'_, T>) -> u64;
}

/// The compiled kernels of one instruction set, in covariance form. In form auto they estimate the error in the first
/// stage of a step; the later stages are similar.
pub(super) struct Kernels<'a, T: Vectorized, I> {
    target: I,
    errors: Errors<T>,
    form: Form,
    /// For scenes with connections.
    pub connected: Option<&'a mut Connected<T>>,
    /// True if more right-hand sides follow with the factor of M.
    pub factors: bool,
}

impl<'a, T: Vectorized, I> Kernels<'a, T, I> {
    /// Kernels for [`Form::Covariance`] or [`Form::Auto`].
    #[inline(always)]
    pub fn new(target: I, form: Form, connected: Option<&'a mut Connected<T>>) -> Self {
        Self { target, errors: Errors::unknown(), form, connected, factors: false }
    }
}

impl<T: Vectorized, I: Target> Solver<T> for Kernels<'_, T, I> {
    #[inline(always)]
    fn solve(&mut self, estimates: bool, call: KernelArguments<'_, T>) -> u64 {
        if let Some(connected) = &mut self.connected {
            return connected.accelerations((self.target, self.form, estimates), call);
        }
        if self.factors {
            return with_factor(self.target, self.form, call);
        }
        if estimates && self.form != Form::Covariance {
            watched(self.target, call, &mut self.errors)
        } else {
            by_covariance(self.target, call)
        }
    }
}

/// The kernels of one state, in the scalar of an instruction set.
trait Alone: Send + Sync {
    /// Writes qdd, and returns true if its error estimate, or else its pivots, are accepted.
    fn solve(&mut self, estimates: bool, call: KernelArguments<'_, f64>) -> bool;
}

/// Kernels with the model, and with room for the arguments, in their scalar.
struct InScalar<T: Vectorized, I> {
    target: I,
    form: Form,
    model: Model<T>,
    constants: SweepModel<T>,
    scratch: SweepScratch<T>,
    state: [Vec<T>; 3],
    wrenches: Vec<Vector6<T>>,
    qdd: Vec<T>,
}

impl<T: Vectorized, I: Target> InScalar<T, I> {
    fn boxed(model: &Model<f64>, tolerance: Option<f64>, form: Form, target: I) -> Box<dyn Alone> {
        let (constants, model) = (SweepModel::new(model), model.cast());
        let scratch = SweepScratch::new(&model, &constants).accepting(tolerance);
        let (state, qdd) = (std::array::from_fn(|_| Vec::new()), vec![T::from_f64(f64::NAN); model.nv()]);
        Box::new(Self { target, form, model, constants, scratch, state, wrenches: Vec::new(), qdd })
    }
}

impl<T: Vectorized, I: Target> Alone for InScalar<T, I> {
    fn solve(&mut self, estimates: bool, call: KernelArguments<'_, f64>) -> bool {
        fn fill<T: Real>(to: &mut Vec<T>, from: &[f64]) {
            to.clear();
            to.extend(from.iter().map(|&x| T::from_f64(x)));
        }
        let Self { target, form, model, constants, scratch, state, wrenches, qdd } = self;
        let KernelArguments { scene: (given, _), state: (q, v, u), .. } = call;
        fill(&mut model.system.noise, &given.system.noise);
        model.gravity = given.gravity.map(T::from_f64);
        for (to, from) in state.iter_mut().zip([q, v, u]) {
            fill(to, from);
        }
        wrenches.clear();
        wrenches.extend(call.wrenches.iter().map(|wrench| wrench.map(T::from_f64)));
        let [q, v, u] = &*state;
        let own = KernelArguments { scene: (model, constants), scratch, state: (q, v, u), wrenches, qdd };
        let is_accepted = Kernels::new(*target, *form, None).solve(estimates, own) & 1 == 0;
        for (to, from) in call.qdd.iter_mut().zip(qdd) {
            *to = from.lane(0);
        }
        is_accepted
    }
}

/// One state with all checks, in the form of the workspace.
pub(super) struct Checked {
    pub workspace: Workspace<f64>,
    form: Form,
    /// The kernels that run first, if any; they leave no factor in the workspace.
    kernels: Option<Box<dyn Alone>>,
    followed: Option<Box<Followed>>,
    /// The first singular pivot, until it is taken.
    pub lost: Option<LostPivot>,
}

/// The rows of mimic joints.
struct Followed {
    coupling: Arc<Coupling>,
    rows: ConstraintScratch,
    /// The kernels that run first, if any.
    kernels: Option<RowKernels>,
    /// The model without gravity, in which a right-hand side at rest has no bias, and velocities of zero.
    weightless: Model<f64>,
    rest: Vec<f64>,
}

impl Followed {
    fn new(model: &Model<f64>, coupling: Arc<Coupling>) -> Self {
        let rows = ConstraintScratch::new(model, coupling.tied().constraints());
        let (mut weightless, zeros) = (model.clone(), vec![0.0; model.nv()]);
        weightless.gravity.fill(0.0);
        Self { coupling, rows, kernels: None, weightless, rest: zeros }
    }
}

/// The kernels of rows for one state, created by the first call.
#[derive(Default)]
pub(super) struct RowKernels {
    kernel: Option<ConstraintKernel<f64>>,
    innovations: Vec<f64>,
}

impl RowKernels {
    /// The accelerations of a stage. Returns false if they need the fallback.
    pub fn solve(
        &mut self,
        constraints: &Constraints,
        (form, estimates): (Form, bool),
        call: KernelArguments<'_, f64>,
    ) -> bool {
        let KernelArguments { scene, scratch, state, qdd, .. } = call;
        if form == Form::SquareRoot {
            return false;
        }
        let Self { kernel, innovations } = self;
        innovations.resize(qdd.len(), f64::NAN);
        let rows = kernel.get_or_insert_with(|| kernel_of_rows(scene, constraints));
        let doubt = if estimates && form != Form::Covariance {
            let at = (state.0, state.1);
            let doubt = connected::factors((Baseline, form), scene, (&mut *scratch, &mut *rows), at, qdd);
            factor::innovations(Baseline, scene, scratch, state, (&[], innovations));
            doubt
        } else {
            let lost = factor::with_innovations(Baseline, scene, scratch, state, innovations);
            lost | connected::factor_rows(Baseline, scene, scratch, rows, (state.0, state.1))
        };
        let vectors = (state.2, &mut innovations[..], qdd);
        let (_, open) = connected::accelerations(Baseline, scene, scratch, rows, vectors, (!doubt, u64::MAX));
        (doubt | open) & 1 == 0
    }
}

impl Checked {
    pub fn new(model: &Model<f64>, coupling: Option<Arc<Coupling>>, form: Form) -> Self {
        let followed = coupling.map(|of| Box::new(Followed::new(model, of)));
        Self { workspace: Workspace::new(model).in_form(form), form, kernels: None, followed, lost: None }
    }

    /// The same solver with another tolerance; `None` for the default.
    pub fn accepting(mut self, tolerance: Option<f64>) -> Self {
        self.workspace.tolerance = tolerance;
        self
    }

    /// The same solver with the kernels of an instruction set first, whose result is accepted if its error estimate is
    /// within the tolerance.
    pub fn with_kernels(mut self, model: &Model<f64>, arm: InstructionSet) -> Self {
        let (tolerance, form) = (self.workspace.tolerance, self.form);
        match &mut self.followed {
            Some(followed) => followed.kernels = Some(RowKernels::default()),
            None => self.kernels = Some(on_instruction_set!((arm, true), InScalar::boxed(model, tolerance, form))),
        }
        self
    }

    /// M^-1 times a right-hand side, with the noise of the model.
    pub fn factorise_and_solve(&mut self, model: &Model<f64>, q: &[f64], right: &[f64], out: &mut [f64]) {
        if self.solve_coupled(model, (q, None), right, out) {
            return;
        }
        let pivots = dynamics::factorise(model, &mut self.workspace, q);
        dynamics::solve(model, &mut self.workspace, right, out);
        if self.lost.is_none() {
            self.lost = self.workspace.lost_pivot(model, &pivots);
        }
    }

    /// M^-1 (right - bias) for coupled joints, or M^-1 right without velocities. Returns false if no joints are
    /// coupled.
    pub fn solve_coupled(
        &mut self,
        model: &Model<f64>,
        (q, v): (&[f64], Option<&[f64]>),
        right: &[f64],
        out: &mut [f64],
    ) -> bool {
        let Some(followed) = &mut self.followed else { return false };
        let Followed { coupling, rows, weightless, rest, .. } = &mut **followed;
        weightless.system.noise.copy_from_slice(&model.system.noise);
        let (model, v) = v.map_or((&*weightless, &rest[..]), |v| (model, v));
        let system = (model, coupling.tied().constraints());
        let wanted = (&[][..], &[][..]);
        match constrained_dynamics(system, &mut self.workspace, rows, (q, v, right), wanted, out) {
            Ok(outcome) if outcome.contradicted.is_empty() => {
                self.lost = self.lost.take().or_else(|| self.workspace.lost_pivot(model, &outcome.pivots));
            }
            // Numbers overflow: the step reports a state that is not finite.
            _ => out.fill(f64::NAN),
        }
        coupling.restore_rates(&model.system.noise, out);
        true
    }
}

impl Solver<f64> for Checked {
    fn solve(&mut self, estimates: bool, mut call: KernelArguments<'_, f64>) -> u64 {
        let (model, _) = call.scene;
        if let Some(Followed { kernels: Some(kernels), coupling, .. }) = self.followed.as_deref_mut()
            && kernels.solve(coupling.tied().constraints(), (self.form, estimates), call.again())
        {
            coupling.restore_rates(&model.system.noise, call.qdd);
            return 0;
        }
        if let Some(kernels) = &mut self.kernels
            && kernels.solve(estimates, call.again())
        {
            return 0;
        }
        let KernelArguments { state: (q, v, u), qdd, .. } = call;
        if self.solve_coupled(model, (q, Some(v)), u, qdd) {
            return 0;
        }
        let monitor = dynamics::forward_dynamics(model, &mut self.workspace, q, v, u, &[], qdd);
        if self.lost.is_none() {
            self.lost = self.workspace.lost_pivot(model, &monitor);
        }
        0
    }
}
