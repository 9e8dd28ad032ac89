//! How the accelerations of a stage are found: by the kernels, with or without an error estimate, or by the general recursions with every check.

use crate::batch::accelerations::{Call, by_covariance, watched};
use crate::batch::arms::{Baseline, Target, Vectorised};
use crate::dynamics;
use crate::dynamics::auto::Errors;
use crate::dynamics::coupled::CoupledAccelerations;
use crate::dynamics::sweeps::{SweepModel, SweepScratch};
use crate::filter::Form;
use crate::filter::pivots::LostPivot;
use crate::model::Model;
use crate::scalar::Real;
use crate::scene::Coupling;
use crate::workspace::Workspace;
use std::sync::Arc;

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
    /// True if the kernels are tried first; they leave no factor in the workspace.
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

    /// The same with another tolerance than the usual one.
    pub fn accepting(mut self, tolerance: Option<f64>) -> Self {
        self.workspace.tolerance = tolerance;
        self
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
