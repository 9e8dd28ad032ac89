//! The square-root form, judged; and where it is in doubt, once more with twice the digits.

use super::forward_root;
use super::widened::Widened;
use crate::accuracy::{Accuracy, Bound, largest};
use crate::filter::pivots::PivotMonitor;
use crate::filter::rounding::{self, ROUNDING_MARGIN, Reach, Rounding, Swept, Weighed};
use crate::filter::{Form, innovations, smoother};
use crate::model::Model;
use crate::scalar::{DoubleDouble, Real};
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// How [`forward_dynamics_judged`] came to its answer.
#[derive(Debug, Clone, Copy)]
pub struct Judged<T> {
    /// The pivots of the square-root form.
    pub pivots: PivotMonitor<T>,
    /// What the judge says of the square-root form; none where the first look was clear in every lane.
    pub rounding: Option<Rounding<T>>,
    /// The largest estimated error that is accepted, relative to the largest acceleration.
    pub tolerance: f64,
    /// Whether `qdd` comes from double-double arithmetic, rounded.
    pub refined: bool,
}

impl<T: Real> Judged<T> {
    /// Whether the answer of one lane may have lost digits: in doubt, and not refined.
    #[must_use]
    pub fn in_doubt(&self, lane: usize) -> bool {
        !self.refined && self.rounding.is_some_and(|rounding| !rounding.clear(lane, self.tolerance))
    }
}

/// Joint accelerations in square-root form, whatever form the workspace has, judged: a state in doubt is done once more in
/// double-double arithmetic and rounded.
///
/// Only f64 is refined, one state at a time; the answers of other scalars, lanes among them, stay and are told to be
/// [`in_doubt`](Judged::in_doubt). A refined state takes about thirty times as long, and scratch of 2 kB a body for as long as it
/// lasts. The workspace counts both, see [`Workspace::tally`]; the roots and pivots in it stay those of the square-root form.
pub fn forward_dynamics_judged<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    q: &[T],
    qd: &[T],
    tau: &[T],
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> Judged<T> {
    let (pivots, reach) = forward_dynamics_looked_at(model, workspace, q, qd, tau, wrenches, qdd);
    workspace.accuracy = Accuracy::unknown(Form::SquareRoot);
    let epsilon = T::epsilon().lane(0);
    let tolerance = workspace.accepted_error().of_roots(epsilon);
    // The margins of the first look are made for the digits of f64, of fewer nothing may be left there; and for the usual tolerance.
    let may_do = epsilon <= f64::EPSILON && tolerance >= ROUNDING_MARGIN * epsilon;
    let clear = may_do && (0..T::LANES).all(|lane| reach.clear(lane));
    let unrefined = |rounding| Judged { pivots, rounding, tolerance, refined: false };
    if clear && !workspace.estimates_error {
        return unrefined(None);
    }
    let rounding = judge(model, workspace, tau, qdd);
    let is_accepted = clear || (0..T::LANES).all(|lane| rounding.clear(lane, tolerance));
    let accuracy = Accuracy { error: rounding.error().lane(0), ..workspace.accuracy };
    workspace.accuracy = accuracy.judged(tolerance, largest(qdd), is_accepted);
    if clear && workspace.accuracy.bound == Bound::Sensitivity {
        workspace.accuracy.bound = Bound::Pivots;
    }
    if is_accepted {
        return unrefined((!clear).then_some(rounding));
    }
    let refined = refine(model, q, qd, tau, wrenches, qdd);
    workspace.tally.refined += usize::from(refined);
    workspace.tally.in_doubt += usize::from(!refined);
    if refined {
        // Rounded once: the double-double numbers themselves are as good as exact.
        let largest = largest(qdd);
        let accuracy = Accuracy { doubled: true, error: 0.5 * f64::EPSILON * largest, ..workspace.accuracy };
        workspace.accuracy = accuracy.judged(tolerance, largest, false);
    }
    Judged { pivots, rounding: Some(rounding), tolerance, refined }
}

/// The square-root form, and the first look at it.
fn forward_dynamics_looked_at<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    q: &[T],
    qd: &[T],
    tau: &[T],
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> (PivotMonitor<T>, Reach<T>) {
    let monitor = forward_root::forward_dynamics(model, workspace, q, qd, tau, wrenches, qdd);
    let reach = Reach::new(&monitor, &model.system, &workspace.shift, &workspace.co_state, qdd);
    (monitor.pivots, reach)
}

/// The closer look at what the square-root form has just left in the workspace: a filter and a smoother more.
fn judge<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, tau: &[T], qdd: &[T]) -> Rounding<T> {
    let system = &model.system;
    // What the bodies' motion was kept in is free by now.
    let Workspace {
        shift,
        root,
        coordinates,
        z,
        measured,
        co_state,
        velocity,
        acceleration,
        weights,
        probe,
        estimates,
        ..
    } = workspace;
    let swept = Swept { shift, root, coordinates, added: z, measured, measurement: tau, estimates: qdd, co_state };
    let (state, second, e, c) = (velocity, acceleration, probe, estimates);
    state.fill(crate::spatial::zero());
    innovations::sweep(system, shift, measured, &weights[..model.nv()], state, e);
    c.copy_from_slice(e);
    smoother::sweep(system, shift, measured, second, c);
    rounding::judge(system, &swept, &Weighed { state, innovations: e, estimates: c, co_state: second })
}

/// The same state in double-double arithmetic, rounded into `qdd`; false, and `qdd` as it was, where there is no model to widen
/// or the wider numbers overflow as well.
fn refine<T: Real>(model: &Model<T>, q: &[T], qd: &[T], tau: &[T], wrenches: &[Vector6<T>], qdd: &mut [T]) -> bool {
    let Some(mut widened) = Widened::of(model, (q, qd, tau), wrenches) else { return false };
    let Widened { model, workspace, q, qd, tau, wrenches } = &mut widened;
    let mut wide = vec![DoubleDouble::from_f64(f64::NAN); qdd.len()];
    forward_root::forward_dynamics(model, workspace, q, qd, tau, wrenches, &mut wide);
    let finite = wide.iter().all(|x| x.lane(0).is_finite());
    if finite {
        for (qdd, wide) in qdd.iter_mut().zip(wide) {
            *qdd = T::from_f64(wide.lane(0));
        }
    }
    finite
}
