//! The square-root form with an error estimate, and double-double arithmetic for states whose estimate exceeds the
//! tolerance.

use super::sweeps::general;
use crate::accuracy::{Accuracy, Bound, largest};
use crate::filter::Form;
use crate::filter::pivots::PivotMonitor;
use crate::filter::rounding::{ROUNDING_MARGIN, Rounding};
use crate::model::Model;
use crate::scalar::{DoubleDouble, Real};
use crate::workspace::{Made, Workspace};
use nalgebra::Vector6;
use std::any::Any;

/// The results of [`forward_dynamics_square_root`] in addition to the accelerations.
#[derive(Debug, Clone, Copy)]
pub struct SquareRootResult<T> {
    /// The pivots of the square-root form.
    pub pivots: PivotMonitor<T>,
    /// The error estimate of the square-root form; None if the bound on its rounding is met in every lane.
    pub rounding: Option<Rounding<T>>,
    /// The largest estimated error that is accepted, relative to the largest acceleration.
    pub tolerance: f64,
    /// True if `qdd` was recomputed in double-double arithmetic and rounded.
    pub refined: bool,
}

impl<T: Real> SquareRootResult<T> {
    /// True if the error estimate of one lane exceeds the tolerance and the state was not recomputed.
    #[must_use]
    pub fn needs_fallback(&self, lane: usize) -> bool {
        !self.refined && self.rounding.is_some_and(|rounding| !rounding.clear(lane, self.tolerance))
    }
}

/// Joint accelerations in square-root form, independent of the form of the workspace. A state whose estimated error
/// exceeds the tolerance is recomputed in double-double arithmetic and rounded.
///
/// Only states in f64 are recomputed, one at a time. The results of other scalars and of lanes are kept, and
/// [`needs_fallback`](SquareRootResult::needs_fallback) reports them. A recomputed state takes 60 to 130 times as long
/// as in covariance form, and scratch of 4 kB per body from then on. The workspace counts both, see
/// [`Workspace::tally`]; its roots and pivots remain those of the square-root form.
pub fn forward_dynamics_square_root<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    q: &[T],
    qd: &[T],
    tau: &[T],
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> SquareRootResult<T> {
    let (scene, store) = workspace.passes(model);
    let (pivots, bound) = general::forward_dynamics_by_roots(scene, store, (q, qd, tau), wrenches, qdd);
    workspace.accuracy = Accuracy::unknown(Form::SquareRoot);
    let epsilon = T::epsilon().lane(0);
    let tolerance = workspace.accepted_error().of_roots(epsilon);
    // The bound assumes the precision of f64 and the default tolerance.
    let is_applicable = epsilon <= f64::EPSILON && tolerance >= ROUNDING_MARGIN * epsilon;
    let clear = is_applicable && (0..T::LANES).all(|lane| bound.clear(lane));
    let unrefined = |rounding| SquareRootResult { pivots, rounding, tolerance, refined: false };
    if clear && !workspace.estimates_error {
        return unrefined(None);
    }
    let (scene, store) = workspace.passes(model);
    let rounding = general::rounding_of_roots(scene, store, (tau, qdd));
    let is_accepted = clear || (0..T::LANES).all(|lane| rounding.clear(lane, tolerance));
    let accuracy = Accuracy { error: rounding.error().lane(0), ..workspace.accuracy };
    workspace.accuracy = accuracy.judged(tolerance, largest(qdd), is_accepted);
    if clear && workspace.accuracy.bound == Bound::Sensitivity {
        workspace.accuracy.bound = Bound::Pivots;
    }
    if is_accepted {
        return unrefined((!clear).then_some(rounding));
    }
    let refined =
        DoubleDoubleState::recompute((model, &mut workspace.wide), (q, qd, tau), wrenches, qdd, |wide, qdd| {
            let DoubleDoubleState { model, workspace, q, qd, tau, wrenches } = wide;
            let (scene, store) = workspace.passes(model);
            general::forward_dynamics_by_roots(scene, store, (q, qd, tau), wrenches, qdd);
            true
        });
    workspace.tally.refined += usize::from(refined);
    workspace.tally.unresolved += usize::from(!refined);
    if refined {
        // Rounded once: the error of the double-double values is negligible.
        let largest = largest(qdd);
        let accuracy = Accuracy { doubled: true, error: 0.5 * f64::EPSILON * largest, ..workspace.accuracy };
        workspace.accuracy = accuracy.judged(tolerance, largest, false);
    }
    SquareRootResult { pivots, rounding: Some(rounding), tolerance, refined }
}

/// The factor of M at `q` in square-root form: phi, D, g and the roots of P in the workspace (3.6, 3.10).
pub(super) fn factorise_by_roots<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, q: &[T]) -> PivotMonitor<T> {
    let Workspace { sweeps, store, rest, estimates, .. } = workspace;
    general::factor_by_roots((model, sweeps), store, q, (rest, estimates))
}

/// A model and a state in double-double arithmetic, with a workspace in square-root form.
pub(super) struct DoubleDoubleState {
    pub model: Model<DoubleDouble>,
    pub workspace: Workspace<DoubleDouble>,
    pub q: Vec<DoubleDouble>,
    pub qd: Vec<DoubleDouble>,
    pub tau: Vec<DoubleDouble>,
    pub wrenches: Vec<Vector6<DoubleDouble>>,
}

impl DoubleDoubleState {
    fn of(model: &Model<f64>) -> Self {
        let model: Model<DoubleDouble> = model.cast();
        let workspace = Workspace::new(&model).in_form(Form::SquareRoot);
        Self { model, workspace, q: Vec::new(), qd: Vec::new(), tau: Vec::new(), wrenches: Vec::new() }
    }

    /// Computes with a state in double-double arithmetic. The wide bodies are `kept`: widening them takes as long as a
    /// sweep. False if the scalar is not f64, the inertia of a body has no root, or `compute` fails.
    #[cold]
    pub fn with<T: Real>(
        (model, kept): (&Model<T>, &mut Made),
        (q, qd, tau): (&[T], &[T], &[T]),
        wrenches: &[Vector6<T>],
        compute: impl FnOnce(&mut Self) -> bool,
    ) -> bool {
        // Scalars that hold more than a value, such as dual numbers, would lose the rest.
        let Some(model) = (model as &dyn Any).downcast_ref::<Model<f64>>() else { return false };
        if model.inertia_roots.iter().any(Option::is_none) {
            return false;
        }
        let mut made = kept.take(model.identity(), || Self::of(model));
        let wide = &mut made.1;
        wide.model.system.noise = DoubleDouble::each_of(&model.system.noise);
        wide.model.gravity = model.gravity.map(DoubleDouble::from_f64);
        wide.model.simplifications = model.simplifications;
        [wide.q, wide.qd, wide.tau] = [q, qd, tau].map(DoubleDouble::each_of);
        wide.wrenches = wrenches.iter().map(|wrench| wrench.map(|x| DoubleDouble::from_f64(x.lane(0)))).collect();
        let done = compute(wide);
        kept.keep(made);
        done
    }

    /// Computes a result in double-double arithmetic and square-root form, and rounds it into `out`. False, with `out`
    /// unchanged, if [`with`](Self::with) fails, or a value is not finite.
    pub fn recompute<T: Real>(
        model: (&Model<T>, &mut Made),
        state: (&[T], &[T], &[T]),
        wrenches: &[Vector6<T>],
        out: &mut [T],
        compute: impl FnOnce(&mut Self, &mut [DoubleDouble]) -> bool,
    ) -> bool {
        Self::with(model, state, wrenches, |wide| {
            let mut found = vec![DoubleDouble::from_f64(f64::NAN); out.len()];
            let done = compute(wide, &mut found) && found.iter().all(|x| x.high.is_finite());
            if done {
                narrow(&found, out);
            }
            done
        })
    }
}

/// Rounds every value.
pub(super) fn narrow<T: Real>(from: &[DoubleDouble], to: &mut [T]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = T::from_f64(from.high);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes;

    /// The kept bodies are those of the model, and its noise, gravity and state are those of the call.
    #[test]
    fn a_workspace_recomputes_one_state_after_another() {
        let case = scenes::extreme("heavy-tip", Some(1e6), None, 0).expect("a scene");
        let mut model = case.scene.model().clone();
        let nv = model.nv();
        let mut again = Workspace { tolerance: Some(1e-15), ..Workspace::new(&model) };
        let mut results = Vec::new();
        for round in 0..3 {
            let wave = |scale: f64| -> Vec<f64> { (1_u32..).take(nv).map(|i| (scale * f64::from(i)).sin()).collect() };
            let (q, qd, tau) = (wave(1.7 + f64::from(round)), wave(2.3), wave(0.9));
            model.system.noise.fill(0.1 * f64::from(round));
            model.gravity.fill(f64::from(round));
            let mut new = Workspace { tolerance: Some(1e-15), ..Workspace::new(&model) };
            let [first, second] = [&mut again, &mut new].map(|workspace| {
                let (mut qdd, before) = (vec![f64::NAN; nv], workspace.tally.refined);
                forward_dynamics_square_root(&model, workspace, &q, &qd, &tau, &[], &mut qdd);
                assert_eq!(workspace.tally.refined, before + 1);
                qdd
            });
            assert_eq!(first, second);
            assert!(!results.contains(&first) && first.iter().all(|x| x.is_finite()));
            results.push(first);
        }
    }
}
