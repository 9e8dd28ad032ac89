//! Form `auto`: the covariance form with an error estimate, and the square-root form for states whose estimate exceeds
//! the tolerance.

use super::refined::{SquareRootResult, factorise_by_roots, forward_dynamics_square_root};
use super::sweeps::{self, ErrorTerms, SweepModel, SweepScratch, general};
use crate::accuracy::{Accuracy, largest};
use crate::filter::Form;
use crate::filter::cancellation::{Cancellation, Margins};
use crate::filter::pivots::PivotMonitor;
use crate::filter::tolerance::Tolerance;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real, lanes_but};
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// The results of [`forward_dynamics_auto`] in addition to the accelerations.
#[derive(Debug, Clone, Copy)]
pub struct Choice<T> {
    /// The form that computed `qdd`; its P or its root is in the workspace.
    pub form: Form,
    /// The pivots of that form.
    pub pivots: PivotMonitor<T>,
    /// The error estimate of the covariance form.
    pub cancellation: Cancellation<T>,
    /// True if the error estimate of the covariance form exceeds its bounds in a lane.
    pub covariance_needs_fallback: bool,
    /// The result of the square-root form, if it was run. It reports whether the state was recomputed in double-double
    /// arithmetic.
    pub square_root: Option<SquareRootResult<T>>,
    /// True if the error estimate of the covariance form exceeds its bounds and the square-root form is not available
    /// because the inertia of a body is not positive.
    pub without_root: bool,
}

impl<T: Real> Choice<T> {
    /// True if the error estimate of one lane exceeds the tolerance in the last form that was run.
    #[must_use]
    pub fn needs_fallback(&self, lane: usize) -> bool {
        self.square_root.as_ref().map_or(self.without_root, |result| result.needs_fallback(lane))
    }
}

/// Joint accelerations in covariance form, or in square-root form if the error estimate of the covariance form exceeds
/// its bounds.
///
/// The decision is made after the passes, for all lanes of `T` together. If the estimate of the first test vector
/// exceeds its bound, the state is recomputed with a second one. If both exceed it, or a pivot is lost, the square-root
/// form is run, which has its own error estimate. See [`cancellation`](crate::filter::cancellation) and
/// [`rounding`](crate::filter::rounding); `cargo bench --bench dynamics forms` measures the cost.
pub fn forward_dynamics_auto<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    q: &[T],
    qd: &[T],
    tau: &[T],
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> Choice<T> {
    let estimate = forward_dynamics_with_estimate(model, workspace, (q, qd, tau), wrenches, qdd);
    let ErrorEstimate { pivots, cancellation, .. } = estimate;
    let is_accepted = estimate.is_accepted_in_every_lane();
    let without_root = !is_accepted && model.inertia_roots.iter().any(Option::is_none);
    if is_accepted || without_root {
        workspace.tally.unresolved += usize::from(without_root);
        workspace.accuracy = estimate.accuracy(workspace.accepted_error(), qdd);
        let (form, covariance_needs_fallback) = (Form::Covariance, !is_accepted);
        return Choice { form, pivots, cancellation, covariance_needs_fallback, square_root: None, without_root };
    }
    workspace.tally.square_root += 1;
    let result = forward_dynamics_square_root(model, workspace, q, qd, tau, wrenches, qdd);
    let (form, pivots, square_root) = (Form::SquareRoot, result.pivots, Some(result));
    Choice { form, pivots, cancellation, covariance_needs_fallback: true, square_root, without_root }
}

/// The factor of M at `q`: in covariance form, or in square-root form if its error estimate exceeds the tolerance.
///
/// There is no right-hand side, so the error estimate takes two test vectors: the second one estimates the error of the
/// solution for the first one.
pub(super) fn factorise<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, q: &[T]) -> PivotMonitor<T> {
    workspace.store.accept(workspace.tolerance);
    let Workspace { sweeps, store, estimates, .. } = &mut *workspace;
    let estimate = estimated_factor((model, sweeps), store, q, estimates);
    if estimate.is_accepted_in_every_lane() || model.inertia_roots.iter().any(Option::is_none) {
        return estimate.pivots;
    }
    factorise_by_roots(model, workspace, q)
}

/// The factor of M at `q` in covariance form, with its error estimate; `estimates` is scratch, (nv).
pub(crate) fn estimated_factor<T: Real>(
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    q: &[T],
    estimates: &mut [T],
) -> ErrorEstimate<T> {
    let (pivots, cancellation) = general::factor_with_estimate(scene, scratch, q, estimates);
    ErrorEstimate::of_a_factor(pivots, cancellation, scratch.accepted_square)
}

/// The estimated errors of the lanes of one run. The estimate of a state does not depend on the other lanes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Errors<T> {
    first: T,
    both: T,
    clear_before: u64,
}

impl<T: Real> Errors<T> {
    /// NaN in every lane.
    pub fn unknown() -> Self {
        let nan = T::from_f64(f64::NAN);
        Self { first: nan, both: nan, clear_before: 0 }
    }

    /// The estimated error of one lane.
    pub fn of(&self, lane: usize) -> f64 {
        if self.clear_before >> lane & 1 == 1 { self.first.lane(lane) } else { self.both.lane(lane) }
    }
}

/// The error estimate of the covariance form.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ErrorEstimate<T> {
    pub pivots: PivotMonitor<T>,
    pub cancellation: Cancellation<T>,
    /// The estimate by the first test vector.
    first: Cancellation<T>,
    /// The square of the tolerance, in units of eps^2.
    tolerance: T,
    /// The margin of the estimate to its bound: negative or NaN in a lane that exceeds it.
    slack: T,
    /// Lanes that the first test vector accepted, as bits. The second test vector, which other lanes need, does not
    /// change them.
    clear_before: u64,
}

impl<T: Real> ErrorEstimate<T> {
    /// The estimate by one test vector. It does not accept a pivot that is not `near` the bound of its terms.
    #[inline(always)]
    pub fn of_one_vector((pivots, near, cancellation): ErrorTerms<T>, tolerance: T) -> Self {
        let slack = cancellation.slack(tolerance, &Margins::CLOSE).worst(near.margin());
        Self { pivots, cancellation, first: cancellation, tolerance, slack, clear_before: 0 }
    }

    /// The estimate by both test vectors.
    #[inline(always)]
    pub fn with_second_vector(&self, (_, _, second): &ErrorTerms<T>) -> Self {
        // The bound of each estimate is the sensitivity by the same test vector.
        let slack = |of: &Cancellation<T>| of.slack(self.tolerance, &Margins::USUAL);
        let slack = slack(&self.cancellation).worst(slack(second));
        let cancellation = self.cancellation.larger(second);
        Self { cancellation, slack, clear_before: self.accepted_lanes(), ..*self }
    }

    /// The estimate for a factor: there is no right-hand side, and one test vector estimates the error of the solution
    /// for the other.
    #[inline(always)]
    fn of_a_factor(pivots: PivotMonitor<T>, cancellation: Cancellation<T>, tolerance: T) -> Self {
        let slack = cancellation.slack(tolerance, &Margins::OF_A_FACTOR);
        Self { pivots, cancellation, first: cancellation, tolerance, slack, clear_before: 0 }
    }

    /// The estimated error of the largest acceleration, in its unit: by the first test vector, or by both in lanes that
    /// needed the second one.
    #[inline(always)]
    pub fn errors(&self) -> Errors<T> {
        Errors { first: self.first.error(), both: self.cancellation.error(), clear_before: self.clear_before }
    }

    /// The accuracy of lane 0, with this tolerance and these accelerations.
    pub fn accuracy(&self, tolerance: Tolerance, qdd: &[T]) -> Accuracy {
        let accuracy = Accuracy { error: self.errors().of(0), ..Accuracy::unknown(Form::Covariance) };
        accuracy.judged(tolerance.of_covariance(T::epsilon().lane(0)), largest(qdd), self.is_accepted(0))
    }

    /// The margin of pivots and estimate to their bounds: negative or NaN in a lane that needs a fallback.
    pub fn margin(&self) -> T {
        self.slack.worst(self.pivots.margin())
    }

    /// True if the pivots and the estimate of one lane are within their bounds.
    #[inline(always)]
    pub fn is_accepted(&self, lane: usize) -> bool {
        self.clear_before >> lane & 1 == 1 || (self.pivots.clear(lane) && self.slack.lane(lane) >= 0.0)
    }

    /// The accepted lanes, as bits.
    #[inline(always)]
    fn accepted_lanes(&self) -> u64 {
        lanes_but::<T>(|lane| !self.is_accepted(lane))
    }

    #[inline(always)]
    fn is_accepted_in_every_lane(&self) -> bool {
        let mut all = true;
        for lane in 0..T::LANES {
            all &= self.is_accepted(lane);
        }
        all
    }
}

/// The covariance form with an error estimate; repeated with the second test vector if the estimate of a lane exceeds
/// its bound.
pub(crate) fn forward_dynamics_with_estimate<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> ErrorEstimate<T> {
    workspace.store.accept(workspace.tolerance);
    let (scene, store) = workspace.passes(model);
    estimated(scene, store, state, wrenches, qdd)
}

/// [`forward_dynamics_with_estimate`] on scratch that has its bounds.
pub(crate) fn estimated<T: Real>(
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> ErrorEstimate<T> {
    let terms = general::forward_dynamics_with_estimate(scene, scratch, state, wrenches, qdd);
    let first = ErrorEstimate::of_one_vector(terms, scratch.accepted_square);
    if first.is_accepted_in_every_lane() {
        return first;
    }
    scratch.exchange_test_vectors();
    let second = general::forward_dynamics_with_estimate(scene, scratch, state, wrenches, qdd);
    scratch.exchange_test_vectors();
    first.with_second_vector(&second)
}

/// [`forward_dynamics_with_estimate`] in the kernels, on reused slots.
#[inline(always)]
pub(crate) fn estimated_in_lanes<T: Real, C: ColumnsOf<T>>(
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> ErrorEstimate<T> {
    let mut first: Option<ErrorEstimate<T>> = None;
    // A loop, so that the kernel is compiled only once.
    loop {
        let terms = sweeps::forward_dynamics_with_estimate::<T, C>(scene, scratch, state, wrenches, qdd);
        if let Some(first) = first {
            scratch.exchange_test_vectors();
            return first.with_second_vector(&terms);
        }
        let estimate = ErrorEstimate::of_one_vector(terms, scratch.accepted_square);
        if estimate.is_accepted_in_every_lane() {
            return estimate;
        }
        scratch.exchange_test_vectors();
        first = Some(estimate);
    }
}

/// [`estimated_factor`] in the kernels.
#[inline(always)]
pub(crate) fn factor_with_estimate_in_lanes<T: Real, C: ColumnsOf<T>>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    q: &[T],
    estimates: &mut [T],
) -> ErrorEstimate<T> {
    let (pivots, cancellation) = sweeps::factor_with_estimate::<T, C>((model, sweeps), scratch, q, estimates);
    ErrorEstimate::of_a_factor(pivots, cancellation, scratch.accepted_square)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Inertial, JointDescription, JointKind, LinkDescription, Scene, SceneBuilder};
    use crate::scenes;
    use crate::spatial::Symmetric3;
    use nalgebra::Vector3;

    /// A long arm and a short arm, with joints about axes of either sign and an oblique one; the tip of the long arm
    /// has this mass.
    fn two_arms(tip: f64) -> Scene {
        const AXES: [[f64; 3]; 8] = [
            [0.0, 0.0, -1.0],
            [0.0, -1.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [-1.0, 0.0, 0.0],
            [1.0, 1.0, 0.3],
            [0.0, -1.0, 0.0],
            [0.0, 0.0, 1.0],
        ];
        let inertial = |mass: f64| Inertial {
            mass,
            center: Vector3::new(0.2, 0.05, -0.03),
            central: Symmetric3::new([0.01 * mass, 0.0, 0.001 * mass, 0.02 * mass, 0.0, 0.03 * mass]),
        };
        let mut builder = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
        for (k, &axis) in AXES.iter().enumerate() {
            let parent = [None, Some(0), Some(1), Some(2), Some(3), Some(4), Some(5), Some(1)][k];
            let parent = parent.map_or_else(|| "base".to_owned(), |parent: usize| format!("link{parent}"));
            let mut joint = JointDescription::new(format!("joint{k}"), JointKind::Revolute, parent, format!("link{k}"));
            joint.origin.lever = Vector3::new(0.4, 0.1, 0.0);
            joint.axis = axis.into();
            let inertial = Some(inertial(if k == 6 { tip } else { 1.0 }));
            builder = builder.link(LinkDescription { name: format!("link{k}"), inertial }).joint(joint);
        }
        builder.build().expect("a scene")
    }

    /// The error estimates on the kernels' model and on the general model agree: a state that the first test vector
    /// does not accept is accepted with the second one on both.
    #[test]
    fn the_error_estimates_on_both_models_agree() {
        let heavy_tip = |tip| scenes::extreme("heavy-tip", Some(tip), None, 0).expect("a scene").scene;
        let makes: [&dyn Fn(f64) -> Scene; 2] = [&heavy_tip, &two_arms];
        let mut accepted = 0;
        for make in makes {
            let mut rejected = 0;
            // Steps between the bounds of one test vector and of two.
            for exponent in 0..192 {
                let scene = make(10_f64.powf(0.0625 * f64::from(exponent)));
                let (model, nv) = (scene.model(), scene.nv());
                let wave =
                    |scale: f64| -> Vec<f64> { (1_u32..).take(nv).map(|i| (scale * f64::from(i)).sin()).collect() };
                let (q, qd, tau, mut qdd) = (wave(1.7), wave(2.3), wave(0.9), vec![f64::NAN; nv]);
                let mut workspace = scene.workspace();
                let expected = forward_dynamics_with_estimate(model, &mut workspace, (&q, &qd, &tau), &[], &mut qdd);
                let sweeps = SweepModel::new(model);
                let (sweeps, mut scratch) = ((model, &sweeps), SweepScratch::new(model, &sweeps));
                let terms = sweeps::forward_dynamics_with_estimate::<_, f64>(
                    sweeps,
                    &mut scratch,
                    (&q, &qd, &tau),
                    &[],
                    &mut qdd,
                );
                let first = ErrorEstimate::of_one_vector(terms, scratch.accepted_square);
                let found = estimated_in_lanes::<_, f64>(sweeps, &mut scratch, (&q, &qd, &tau), &[], &mut qdd);
                let (one, other) = (found.cancellation.relative_error(0), expected.cancellation.relative_error(0));
                // Bounds for a revolute joint are slightly closer than those for a general shift.
                assert!(one <= 4.0 * other && other <= 4.0 * one, "{exponent}: {one:e} {other:e}");
                rejected += usize::from(!first.is_accepted(0));
                accepted += usize::from(!first.is_accepted(0) && found.is_accepted(0) && expected.is_accepted(0));
            }
            assert!(rejected > 0);
        }
        assert!(accepted > 0);
    }
}
