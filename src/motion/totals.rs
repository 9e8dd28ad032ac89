//! Values that a rollout accumulates per state: the works of all joint torques, and the numbers of substeps.
//!
//! Let x be the displacement in a step and w = h (v + v')/2 the step times the mean velocity. A torque with the impulse
//! p does the work p w/h, which for constant M is the kinetic energy that it adds; a constant torque does tau x.
//! Wrenches on links do the sum of the works of the stages, F . V times their weights. The difference between the
//! change of energy and the sum of the works is the error of the method.

/// The number of values.
pub(super) const TOTALS: usize = 13;

pub(super) const TORQUE: usize = 0;
pub(super) const DAMPING: usize = 1;
pub(super) const FRICTION: usize = 2;
pub(super) const CONTROL: usize = 3;
pub(super) const STOPS: usize = 4;
/// Indices of the works.
pub(super) const WORKS: [usize; 5] = [TORQUE, DAMPING, FRICTION, CONTROL, STOPS];
/// Substeps of the method and events.
pub(super) const SUBSTEPS: usize = 5;
/// Largest number of substeps of one step.
pub(super) const MOST: usize = 6;
pub(super) const EVENTS: usize = 7;
/// With error control: the sum of the errors of all substeps, and the initial length of the next substep.
pub(super) const ERROR: usize = 8;
pub(super) const LENGTH: usize = 9;
/// Events without a solution.
pub(super) const UNSETTLED: usize = 10;
/// Steps in which connections or contacts prevent a stop from acting, and the last row with such a stop.
const DROPPED: usize = 11;
const DROPPED_ROW: usize = 12;

/// Counts a substep in which the demand of a stop is dropped, with the row of its joint.
pub(super) fn note_dropped(totals: &mut [f64], row: Option<usize>) {
    if let Some(row) = row {
        totals[DROPPED] += 1.0;
        #[allow(clippy::cast_precision_loss)] // index of a joint
        let row = row as f64;
        totals[DROPPED_ROW] = row;
    }
}

/// Works and numbers of substeps of one state since it began.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct Totals {
    /// Work of the applied torques and of the wrenches on links, J.
    pub torque: f64,
    /// Work of damping, J; zero or negative.
    pub damping: f64,
    /// Work of friction, J.
    pub friction: f64,
    /// Work of the control law, J.
    pub control: f64,
    /// Work of the stops, J.
    pub stops: f64,
    /// Number of substeps in all steps that were divided or had an event.
    pub substeps: f64,
    /// Largest number of substeps of one step.
    pub most_substeps: f64,
    /// Number of substeps in which a joint stuck, slipped, or reached or left a stop; with connections, also of those
    /// in which friction or a stop held one.
    pub events: f64,
    /// With error control, the sum of the estimated errors of all substeps: rad, m, and relative to the fastest joint
    /// velocity if that exceeds 1.
    pub error: f64,
    /// Number of events whose friction and stop torques contradict each other, because the mass matrix is indefinite,
    /// with a joint that was then treated as stuck; and of steps with contacts that leave a control law with limits of
    /// effort without a solution, whose joint was then at its limit.
    pub unsettled: f64,
    /// Number of substeps in which connections, at a dead center, or contacts prevent a joint from returning to its
    /// limits or from stopping there.
    pub dropped: f64,
    /// The degree of freedom of the last of these joints.
    pub dropped_row: f64,
}

impl Totals {
    /// From the values that a rollout stores.
    pub(super) fn of(values: &[f64]) -> Self {
        let at = |i: usize| values.get(i).copied().unwrap_or(0.0);
        Self {
            torque: at(TORQUE),
            damping: at(DAMPING),
            friction: at(FRICTION),
            control: at(CONTROL),
            stops: at(STOPS),
            substeps: at(SUBSTEPS),
            most_substeps: at(MOST),
            events: at(EVENTS),
            error: at(ERROR),
            unsettled: at(UNSETTLED),
            dropped: at(DROPPED),
            dropped_row: at(DROPPED_ROW),
        }
    }
}
