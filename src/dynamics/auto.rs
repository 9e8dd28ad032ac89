//! Forward dynamics in covariance form, watched; in square-root form, judged, where the covariance form lost digits; and with
//! twice the digits where that is in doubt too.

use super::forces::Motion;
use super::forward::{covariances_of_noise, forces_and_noise};
use super::forward_root;
use super::refined::{Judged, forward_dynamics_judged};
use super::sweeps::{self, Look, SweepModel, SweepScratch};
use crate::accuracy::{Accuracy, largest};
use crate::filter::cancellation::{self, Cancellation, Margins, Probe};
use crate::filter::pivots::PivotMonitor;
use crate::filter::tolerance::Tolerance;
use crate::filter::{Form, System, innovations};
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real, lanes_but};
use crate::spatial::Symmetric6;
use crate::spatial::transform::Transform;
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// How [`forward_dynamics_auto`] came to its answer.
#[derive(Debug, Clone, Copy)]
pub struct Choice<T> {
    /// The form that `qdd` comes from; its P or its root is in the workspace.
    pub form: Form,
    /// The pivots of that form.
    pub pivots: PivotMonitor<T>,
    /// What the covariance form lost.
    pub cancellation: Cancellation<T>,
    /// True if the error estimate of the covariance form exceeds its bounds in a lane.
    pub is_covariance_in_doubt: bool,
    /// How the square-root form did, where it was run; it says whether double-double arithmetic had the last word.
    pub judged: Option<Judged<T>>,
    /// Whether the covariance form lost digits, and a body without a root (its inertia is not positive) left no other form.
    pub without_root: bool,
}

impl<T: Real> Choice<T> {
    /// Whether the answer of one lane may have lost digits: in doubt, and nothing better to be had.
    #[must_use]
    pub fn in_doubt(&self, lane: usize) -> bool {
        self.judged.as_ref().map_or(self.without_root, |judged| judged.in_doubt(lane))
    }
}

/// Joint accelerations as [`forward_dynamics`](super::forward_dynamics) gives them, and where these lost digits, as
/// the square-root form does.
///
/// The choice is made after both sweeps, for all lanes of `T` together: where the watched covariance form is in doubt, it is looked
/// at once more with other weights, and where it stays in doubt (or a pivot is), the square-root form is run, and judged in its turn. See [`cancellation`] and [`rounding`](crate::filter::rounding); `cargo bench --bench dynamics forms` has what it costs.
pub fn forward_dynamics_auto<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    q: &[T],
    qd: &[T],
    tau: &[T],
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> Choice<T> {
    let watched = forward_dynamics_watched(model, workspace, (q, qd, tau), wrenches, qdd);
    let Watched { pivots, cancellation, .. } = watched;
    let kept = watched.kept_in_every_lane();
    let without_root = !kept && model.inertia_roots.iter().any(Option::is_none);
    if kept || without_root {
        workspace.tally.in_doubt += usize::from(without_root);
        workspace.accuracy = watched.accuracy(workspace.accepted_error(), qdd);
        let is_covariance_in_doubt = !kept;
        let form = Form::Covariance;
        return Choice { form, pivots, cancellation, is_covariance_in_doubt, judged: None, without_root };
    }
    workspace.tally.square_root += 1;
    let judged = forward_dynamics_judged(model, workspace, q, qd, tau, wrenches, qdd);
    let (pivots, judged) = (judged.pivots, Some(judged));
    Choice { form: Form::SquareRoot, pivots, cancellation, is_covariance_in_doubt: true, judged, without_root }
}

/// The factor of M, with phi already in the workspace: in covariance form, and where that lost digits in square-root form.
///
/// There is no right side to watch, so two are made up: the weights of the probe, and others. What is judged is the solution of one,
/// by the other. `seen` is called with each row's P^-, of the form that is kept.
pub(super) fn factorise<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    seen: &mut dyn FnMut(usize, &Symmetric6<T>),
) -> PivotMonitor<T> {
    let watched = watch_factor(model, workspace, seen);
    if watched.kept_in_every_lane() || model.inertia_roots.iter().any(Option::is_none) {
        return watched.pivots;
    }
    forward_root::factorise(model, workspace, seen)
}

/// The factor in covariance form with phi in the workspace, and what two made-up right sides say of it.
fn watch_factor<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    seen: &mut dyn FnMut(usize, &Symmetric6<T>),
) -> Watched<T> {
    let (system, zero) = (&model.system, crate::spatial::zero());
    let (nv, tolerance) = (model.nv(), workspace.accepted_square());
    covariances_of_noise(model, workspace);
    terms_of_noise(model, workspace);
    let mut pivots = PivotMonitor::new();
    for k in (0..system.stages.len()).rev() {
        watched_step(system, k, workspace, &mut pivots, seen);
    }
    let Workspace { shift, measured, terms, z, bias, co_state, velocity, weights, probe, estimates, .. } =
        &mut *workspace;
    bias.fill(zero);
    z.fill(zero);
    innovations::sweep(system, shift, measured, &weights[nv..], z, estimates);
    velocity.fill(zero);
    innovations::sweep(system, shift, measured, &weights[..nv], velocity, probe);
    let mut both = Probe { shift, measured, terms, z, bias, innovations: probe, co_state: velocity };
    let cancellation = cancellation::sweep(system, &mut both, co_state, estimates);
    // The forces are zero, and nu is what right sides to come are judged by.
    bias.copy_from_slice(velocity);
    Watched::of_a_factor(pivots, cancellation, tolerance)
}

/// The terms of M(k), from which the bounds of P^-(k) are summed up.
#[inline(always)]
fn terms_of_noise<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>) {
    for (terms, body) in workspace.terms.iter_mut().zip(&model.bodies) {
        *terms = body.inertia_terms;
    }
}

/// One stage of the covariance form, and the bounds on what its parent's P^- is formed of.
fn watched_step<T: Real>(
    system: &System<T>,
    k: usize,
    workspace: &mut Workspace<T>,
    pivots: &mut PivotMonitor<T>,
    seen: &mut dyn FnMut(usize, &Symmetric6<T>),
) {
    let before = workspace.p[k].diagonal();
    workspace.covariances().step(system, k, pivots, seen);
    let stage = &system.stages[k];
    if let Some(parent) = stage.parent {
        let left = stage.terms_left(before.into(), workspace.p[k].diagonal().into());
        workspace.shift[k].send_terms(&left, false, workspace.terms[parent].as_mut());
    }
}

/// The estimated errors of the lanes of one run. A state's is the same whatever its neighbours need.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Errors<T> {
    first: T,
    both: T,
    clear_before: u64,
}

impl<T: Real> Errors<T> {
    /// Of nothing yet.
    pub fn unknown() -> Self {
        let nan = T::from_f64(f64::NAN);
        Self { first: nan, both: nan, clear_before: 0 }
    }

    /// That of one lane.
    pub fn of(&self, lane: usize) -> f64 {
        if self.clear_before >> lane & 1 == 1 { self.first.lane(lane) } else { self.both.lane(lane) }
    }
}

/// The covariance form's answer, and what is known of the digits that it lost.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Watched<T> {
    pub pivots: PivotMonitor<T>,
    pub cancellation: Cancellation<T>,
    /// What the first look found.
    first: Cancellation<T>,
    /// The square of the tolerance, in units of eps^2.
    tolerance: T,
    /// How far the estimate stays below its margin: negative or NaN in a lane that is in doubt.
    slack: T,
    /// Lanes that an earlier look found clear, as bits: what their neighbours need does not touch them.
    clear_before: u64,
}

impl<T: Real> Watched<T> {
    /// What one probe saw of the right side: nothing, of a pivot that is not `near` the bound of its terms.
    #[inline(always)]
    pub fn once((pivots, near, cancellation): Look<T>, tolerance: T) -> Self {
        let slack = cancellation.slack(tolerance, &Margins::CLOSE).worst(near.margin());
        Self { pivots, cancellation, first: cancellation, tolerance, slack, clear_before: 0 }
    }

    /// The same after a second look, by another probe.
    #[inline(always)]
    pub fn and(&self, (_, _, second): &Look<T>) -> Self {
        // Each by its own probe: what the problem allows is seen by the same.
        let slack = |of: &Cancellation<T>| of.slack(self.tolerance, &Margins::USUAL);
        let slack = slack(&self.cancellation).worst(slack(second));
        let cancellation = self.cancellation.larger(second);
        Self { cancellation, slack, clear_before: self.kept_lanes(), ..*self }
    }

    /// What one probe saw of another, where there is no right side.
    #[inline(always)]
    fn of_a_factor(pivots: PivotMonitor<T>, cancellation: Cancellation<T>, tolerance: T) -> Self {
        let slack = cancellation.slack(tolerance, &Margins::OF_A_FACTOR);
        Self { pivots, cancellation, first: cancellation, tolerance, slack, clear_before: 0 }
    }

    /// The estimated error of the largest acceleration, in its unit: of the first look, and of both in the lanes that needed the second.
    #[inline(always)]
    pub fn errors(&self) -> Errors<T> {
        Errors { first: self.first.error(), both: self.cancellation.error(), clear_before: self.clear_before }
    }

    /// The accuracy of lane 0, with this tolerance and these accelerations.
    pub fn accuracy(&self, tolerance: Tolerance, qdd: &[T]) -> Accuracy {
        let accuracy = Accuracy { error: self.errors().of(0), ..Accuracy::unknown(Form::Covariance) };
        accuracy.judged(tolerance.of_covariance(T::epsilon().lane(0)), largest(qdd), self.kept(0))
    }

    /// How far pivots and estimate stay within their bounds: below zero, or NaN, in a lane that is in doubt.
    pub fn margin(&self) -> T {
        self.slack.worst(self.pivots.margin())
    }

    /// Whether one lane kept its digits.
    #[inline(always)]
    pub fn kept(&self, lane: usize) -> bool {
        self.clear_before >> lane & 1 == 1 || (self.pivots.clear(lane) && self.slack.lane(lane) >= 0.0)
    }

    /// The lanes that kept their digits, as bits.
    #[inline(always)]
    fn kept_lanes(&self) -> u64 {
        lanes_but::<T>(|lane| !self.kept(lane))
    }

    #[inline(always)]
    fn kept_in_every_lane(&self) -> bool {
        let mut all = true;
        for lane in 0..T::LANES {
            all &= self.kept(lane);
        }
        all
    }
}

/// The covariance form, with an estimate of its error: looked at once more, with another probe, where a lane is in doubt.
pub(crate) fn forward_dynamics_watched<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> Watched<T> {
    let first = Watched::once(look(model, workspace, state, wrenches, qdd), workspace.accepted_square());
    if first.kept_in_every_lane() {
        return first;
    }
    workspace.exchange_probes();
    let second = look(model, workspace, state, wrenches, qdd);
    workspace.exchange_probes();
    first.and(&second)
}

/// The covariance form, looked at with the first probe of the workspace.
fn look<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> Look<T> {
    forces_and_noise(model, workspace, Motion { q, qd, qdd: None, wrenches });
    // Velocities have become forces by now; their place is the probe's.
    workspace.velocity.fill(crate::spatial::zero());
    terms_of_noise(model, workspace);
    workspace.bias.copy_from_slice(&workspace.z);
    let system = &model.system;
    let (mut pivots, mut near) = (PivotMonitor::new(), PivotMonitor::for_a_single_look());
    for k in (0..system.stages.len()).rev() {
        watched_step(system, k, workspace, &mut pivots, &mut |_, _| {});
        near.observe_stage(&system.stages[k], &workspace.measured, &workspace.scale[k]);
        let Workspace { shift, measured, z, velocity, weights, probe, .. } = workspace;
        innovations::step(system, k, shift, measured, tau, z, qdd);
        innovations::step(system, k, shift, measured, weights, velocity, probe);
    }
    let Workspace { shift, measured, terms, z, bias, co_state, velocity, probe, .. } = &mut *workspace;
    let mut probe = Probe { shift, measured, terms, z, bias, innovations: probe, co_state: velocity };
    (pivots, near, cancellation::sweep(system, &mut probe, co_state, qdd))
}

/// The same by the sweeps that keep nothing but the result.
#[inline(always)]
pub(crate) fn watched_in_sweeps<T: Real, C: ColumnsOf<T>>(
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> Watched<T> {
    let mut first: Option<Watched<T>> = None;
    // The kernel is compiled into one place.
    loop {
        let look = sweeps::forward_dynamics_watched::<T, C>(scene, scratch, state, wrenches, qdd);
        if let Some(first) = first {
            scratch.exchange_probes();
            return first.and(&look);
        }
        let watched = Watched::once(look, scratch.accepted_square);
        if watched.kept_in_every_lane() {
            return watched;
        }
        scratch.exchange_probes();
        first = Some(watched);
    }
}

/// The factor of M by the same sweeps, in the scratch; `estimates` is scratch, (nv).
#[inline(always)]
pub(crate) fn factor_watched_in_sweeps<T: Real, C: ColumnsOf<T>>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    q: &[T],
    estimates: &mut [T],
) -> Watched<T> {
    let (pivots, cancellation) = sweeps::factor_watched::<T, C>((model, sweeps), scratch, q, estimates);
    Watched::of_a_factor(pivots, cancellation, scratch.accepted_square)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Inertial, JointDescription, JointKind, LinkDescription, Scene, SceneBuilder};
    use crate::scenes;
    use crate::spatial::Symmetric3;
    use nalgebra::Vector3;

    /// A long arm and a short one, joints about axes of either sense and one between them, the tip of the long one of this mass.
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

    /// The sweeps and the general recursions see the same digits lost: a state that the first look doubts is kept by the second, by both.
    #[test]
    fn the_second_look_is_the_same_by_either_sweep() {
        let heavy_tip = |tip| scenes::extreme("heavy-tip", Some(tip), None, 0).expect("a scene").scene;
        let makes: [&dyn Fn(f64) -> Scene; 2] = [&heavy_tip, &two_arms];
        let mut kept = 0;
        for make in makes {
            let mut doubted = 0;
            // In steps that fall between the margins of one look and of two.
            for exponent in 0..192 {
                let scene = make(10_f64.powf(0.0625 * f64::from(exponent)));
                let (model, nv) = (scene.model(), scene.nv());
                let wave =
                    |scale: f64| -> Vec<f64> { (1_u32..).take(nv).map(|i| (scale * f64::from(i)).sin()).collect() };
                let (q, qd, tau, mut qdd) = (wave(1.7), wave(2.3), wave(0.9), vec![f64::NAN; nv]);
                let mut workspace = scene.workspace();
                let expected = forward_dynamics_watched(model, &mut workspace, (&q, &qd, &tau), &[], &mut qdd);
                let sweeps = SweepModel::new(model);
                let (sweeps, mut scratch) = ((model, &sweeps), SweepScratch::new(model, &sweeps));
                let look =
                    sweeps::forward_dynamics_watched::<_, f64>(sweeps, &mut scratch, (&q, &qd, &tau), &[], &mut qdd);
                let first = Watched::once(look, scratch.accepted_square);
                let found = watched_in_sweeps::<_, f64>(sweeps, &mut scratch, (&q, &qd, &tau), &[], &mut qdd);
                let (one, other) = (found.cancellation.relative_error(0), expected.cancellation.relative_error(0));
                // Bounds for a turn are a little closer than those for any shift.
                assert!(one <= 4.0 * other && other <= 4.0 * one, "{exponent}: {one:e} {other:e}");
                doubted += usize::from(!first.kept(0));
                kept += usize::from(!first.kept(0) && found.kept(0) && expected.kept(0));
            }
            assert!(doubted > 0);
        }
        assert!(kept > 0);
    }
}
