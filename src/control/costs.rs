//! The terms of a cost: residuals divided by their standard deviations, and inequalities.

use super::dynamics::Dynamics;
use super::knot::{Sizes, Turn};
use super::rows::Rows;
use crate::error::{Error, check_finite, check_length};
use crate::inverse_kinematics::{Task, TaskRows, Tasks};
use crate::workspace::Workspace;
use std::fmt;

/// A motion: configurations (knots x nq), velocities (knots x nv) and efforts (steps x nv), with one knot more than
/// steps.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Motion {
    /// Configurations, (knots x nq).
    pub q: Vec<f64>,
    /// Joint velocities, (knots x nv).
    pub qd: Vec<f64>,
    /// Joint torques, (steps x nv).
    pub tau: Vec<f64>,
}

/// A residual of the caller: a function of configuration, velocity and effort of one knot.
pub trait Residual: Send + Sync {
    /// The number of residuals of a knot.
    fn count(&self) -> usize;

    /// Writes the residuals of consecutive knots, (knots x count), and their derivatives by q, in its tangent space, by
    /// qd and by tau, each (knots x count x nv). The efforts of the last knot of a motion are zero.
    ///
    /// # Errors
    ///
    /// An error of the caller.
    fn evaluate(&self, state: [&[f64]; 3], residuals: &mut [f64], derivatives: [&mut [f64]; 3]) -> Result<(), Error>;
}

/// A term of the cost.
#[non_exhaustive]
pub enum Term {
    /// Tasks of inverse kinematics: one list for all knots, or one for each.
    Tasks(Vec<Vec<Task>>),
    /// The deviation from a state, with the reciprocals of standard deviations, (nv) each. `q` and `qd` are one state
    /// for all knots, or one for each.
    State {
        /// Configurations, (nq) or (knots x nq).
        q: Vec<f64>,
        /// Joint velocities, (nv) or (knots x nv).
        qd: Vec<f64>,
        /// Reciprocal standard deviations of q, (nv).
        by_q: Vec<f64>,
        /// The same of qd, (nv).
        by_qd: Vec<f64>,
    },
    /// The deviation from efforts, with the reciprocals of standard deviations, (nv).
    Effort {
        /// Joint torques, (nv) or (steps x nv).
        tau: Vec<f64>,
        /// Reciprocal standard deviations, (nv).
        by_tau: Vec<f64>,
    },
    /// The rate of the efforts, with the reciprocals of standard deviations, (nv). `before` is the effort before the
    /// first step, empty if its change has no cost.
    EffortRate {
        /// Reciprocal standard deviations, (nv).
        by_rate: Vec<f64>,
        /// Joint torques, (nv) or empty.
        before: Vec<f64>,
    },
    /// Position and velocity limits: `sign` (x - bound) is not positive, for entry x of q or of qd.
    Limits(Vec<Limit>),
    /// A function of the caller.
    Own(Box<dyn Residual>),
}

/// One inequality of a state: `sign` (x - bound) <= 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limit {
    /// True for an entry of qd.
    pub is_rate: bool,
    /// The index in q or in qd.
    pub index: usize,
    /// The degree of freedom.
    pub row: usize,
    /// 1 for an upper bound, -1 for a lower one.
    pub sign: f64,
    /// The bound.
    pub bound: f64,
}

impl fmt::Debug for Term {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Tasks(_) => "Tasks",
            Self::State { .. } => "State",
            Self::Effort { .. } => "Effort",
            Self::EffortRate { .. } => "EffortRate",
            Self::Limits(_) => "Limits",
            Self::Own(_) => "Own",
        })
    }
}

/// A term at the knots from `first` to `last`, inclusive. At all knots but the end of the motion its squares are
/// multiplied by the time step.
#[derive(Debug)]
pub struct Cost {
    /// The term.
    pub term: Term,
    /// First knot.
    pub first: usize,
    /// Last knot; that after the last step is the end.
    pub last: usize,
    /// True if the residuals must not be positive, instead of being a cost.
    pub is_limit: bool,
}

/// Scratch of all terms.
#[derive(Debug, Default)]
pub struct CostScratch {
    workspace: Option<Workspace<f64>>,
    rows: TaskRows,
    apart: Vec<f64>,
    turns: Vec<Turn>,
    own: [Vec<f64>; 4],
    efforts: Vec<f64>,
}

/// The entry of knot `at` of an array with one entry for all knots or one for each.
fn of_knot(all: &[f64], width: usize, at: usize) -> &[f64] {
    if all.len() == width { all } else { &all[at * width..(at + 1) * width] }
}

impl Cost {
    /// Checks the term for a motion of `steps` steps.
    ///
    /// # Errors
    ///
    /// Knots that do not exist, wrong lengths, and numbers that are not finite or negative; each names the cost by its
    /// index `at`.
    pub fn check(&mut self, dynamics: &Dynamics, steps: usize, at: usize) -> Result<(), Error> {
        let name = |what: &str| format!("{what} of costs[{at}]");
        let scene = dynamics.scene();
        let (nq, nv) = (scene.nq(), scene.nv());
        if self.first > self.last || self.last > steps {
            let found = format!("{} to {}", self.first, self.last);
            return Err(Error::argument(name("knots"), found, format!("knots within 0 to {steps}, the end")));
        }
        let knots = self.last + 1 - self.first;
        let weights = |what: &str, given: &[f64]| {
            check_length(&name(what), given.len(), nv)?;
            match given.iter().find(|weight| !(**weight >= 0.0 && weight.is_finite())) {
                Some(found) => {
                    Err(Error::argument(name(what), (1.0 / found).to_string(), "positive deviations, or inf"))
                }
                None => Ok(()),
            }
        };
        let array = |what: &str, given: &[f64], width: usize, count: usize| {
            if given.len() != width && given.len() != width * count {
                let found = format!("({},)", given.len());
                return Err(Error::shape(&name(what), found, format!("({width},) or ({count}, {width})")));
            }
            check_finite(&name(what), given)
        };
        match &mut self.term {
            Term::Tasks(sets) => {
                if sets.len() != 1 && sets.len() != knots {
                    let found = format!("{} targets", sets.len());
                    return Err(Error::shape(&name("target"), found, format!("one, or one for each of {knots} knots")));
                }
                for set in sets {
                    for task in set {
                        *task = task
                            .checked(dynamics.whole(), 0)
                            .map_err(|error| error.of_argument(&format!("costs[{at}]")))?;
                    }
                }
                Ok(())
            }
            Term::State { q, qd, by_q, by_qd } => {
                array("q", q, nq, knots)?;
                for (row, q) in q.chunks_exact(nq.max(1)).enumerate() {
                    scene.check_coordinates("q", q).map_err(|error| error.in_state(row))?;
                }
                array("qd", qd, nv, knots)?;
                weights("position", by_q).and_then(|()| weights("velocity", by_qd))
            }
            Term::Effort { tau, by_tau } => {
                array("tau", tau, nv, knots)?;
                weights("effort", by_tau)
            }
            Term::EffortRate { by_rate, before } => {
                if !before.is_empty() {
                    check_length(&name("before"), before.len(), nv)?;
                    check_finite(&name("before"), before)?;
                }
                weights("rate", by_rate)
            }
            Term::Limits(_) | Term::Own(_) => Ok(()),
        }
    }

    /// Writes the rows of all knots of a motion.
    ///
    /// # Errors
    ///
    /// Errors of tasks and of functions of the caller, and rotations by a whole turn.
    pub fn evaluate(
        &self,
        dynamics: &Dynamics,
        (sizes, steps): (Sizes, usize),
        motion: &Motion,
        s: &mut CostScratch,
        rows: &mut Rows,
    ) -> Result<(), Error> {
        let scene = dynamics.scene();
        let (nq, nv) = (scene.nq(), scene.nv());
        let root = dynamics.h.sqrt();
        if let Term::Own(own) = &self.term {
            self.evaluate_own(own.as_ref(), (nq, nv), motion, s)?;
        }
        let whole = dynamics.whole();
        let workspace = s.workspace.get_or_insert_with(|| whole.workspace());
        rows.clear();
        for knot in 0..=steps {
            if knot < self.first || knot > self.last {
                rows.end_knot();
                continue;
            }
            let (at, is_end) = (knot - self.first, knot == steps);
            let weight = if is_end || self.is_limit { 1.0 } else { root };
            let (q, qd) = (&motion.q[knot * nq..][..nq], &motion.qd[knot * nv..][..nv]);
            match &self.term {
                Term::Tasks(sets) => {
                    let each = &sets[if sets.len() == 1 { 0 } else { at }];
                    Tasks { scene: whole, each, posture: None }.evaluate(workspace, q, &mut s.rows)?;
                    for (error, entries) in s.rows.errors.iter().zip(s.rows.jacobian.chunks_exact(nv.max(1))) {
                        rows.push(weight * error, 0, entries.iter().map(|entry| weight * entry));
                    }
                }
                Term::State { q: from, qd: rate, by_q, by_qd } => {
                    s.apart.resize(nv, f64::NAN);
                    scene.difference(of_knot(from, nq, at), q, &mut s.apart)?;
                    s.turns.resize(dynamics.turning(), Turn::default());
                    dynamics.difference_turns(&s.apart, &mut s.turns)?;
                    for row in (0..nv).filter(|&row| by_q[row] > 0.0) {
                        let share = weight * by_q[row];
                        let turn = s.turns.iter().find(|turn| (turn.first..turn.first + turn.count).contains(&row));
                        match turn {
                            Some(turn) => {
                                let line = &turn.jacobian[(row - turn.first) * turn.count..][..turn.count];
                                rows.push(share * s.apart[row], turn.first, line.iter().map(|entry| share * entry));
                            }
                            None => rows.push(share * s.apart[row], row, [share]),
                        }
                    }
                    let rate = of_knot(rate, nv, at);
                    for row in (0..nv).filter(|&row| by_qd[row] > 0.0) {
                        let share = weight * by_qd[row];
                        rows.push(share * (qd[row] - rate[row]), nv + row, [share]);
                    }
                }
                Term::Effort { tau, by_tau } if !is_end => {
                    let (wanted, own) = (of_knot(tau, nv, at), &motion.tau[knot * nv..][..nv]);
                    for (control, &row) in dynamics.driven.iter().enumerate().filter(|(_, row)| by_tau[**row] > 0.0) {
                        let share = weight * by_tau[row];
                        rows.push(share * (own[row] - wanted[row]), sizes.state() + control, [share]);
                    }
                }
                Term::EffortRate { by_rate, before } if !is_end && (knot > 0 || !before.is_empty()) => {
                    let (own, m) = (&motion.tau[knot * nv..][..nv], sizes.controls);
                    let last = if knot > 0 { &motion.tau[(knot - 1) * nv..][..nv] } else { before };
                    for (control, &row) in dynamics.driven.iter().enumerate().filter(|(_, row)| by_rate[**row] > 0.0) {
                        let share = weight * by_rate[row] / dynamics.h;
                        // From p of this control to u of this control; p of the first step is given.
                        let entries = (0..=m).map(|i| match i {
                            0 if knot > 0 => -share,
                            i if i == m => share,
                            _ => 0.0,
                        });
                        rows.push(share * (own[row] - last[row]), 2 * nv + control, entries);
                    }
                }
                Term::Effort { .. } | Term::EffortRate { .. } => {}
                Term::Limits(limits) => {
                    for limit in limits {
                        let x = if limit.is_rate { qd[limit.index] } else { q[limit.index] };
                        let column = if limit.is_rate { nv + limit.row } else { limit.row };
                        rows.push(limit.sign * (x - limit.bound), column, [limit.sign]);
                    }
                }
                Term::Own(own) => {
                    let [residuals, by_q, by_qd, by_tau] = &s.own;
                    let count = own.count();
                    for row in at * count..(at + 1) * count {
                        let line = |all: &'_ [f64]| [row * nv, (row + 1) * nv].map(|i| i.min(all.len()));
                        let [from, to] = line(by_q);
                        let state = by_q[from..to].iter().chain(&by_qd[from..to]).copied();
                        let rest = std::iter::repeat_n(0.0, sizes.state() - 2 * nv);
                        let efforts = dynamics.driven.iter().map(|&driven| by_tau[row * nv + driven]);
                        let all = state.chain(rest).chain(efforts.filter(|_| !is_end));
                        rows.push(weight * residuals[row], 0, all.map(|entry| weight * entry));
                    }
                }
            }
            rows.end_knot();
        }
        Ok(())
    }

    fn evaluate_own(
        &self,
        own: &dyn Residual,
        (nq, nv): (usize, usize),
        motion: &Motion,
        s: &mut CostScratch,
    ) -> Result<(), Error> {
        let (knots, count) = (self.last + 1 - self.first, own.count());
        let [residuals, derivatives @ ..] = &mut s.own;
        residuals.resize(knots * count, f64::NAN);
        for all in &mut *derivatives {
            all.resize(knots * count * nv, f64::NAN);
        }
        s.efforts.clear();
        s.efforts.extend_from_slice(&motion.tau[(self.first * nv).min(motion.tau.len())..]);
        s.efforts.resize(knots * nv, 0.0);
        let states =
            [&motion.q[self.first * nq..][..knots * nq], &motion.qd[self.first * nv..][..knots * nv], &s.efforts[..]];
        own.evaluate(states, residuals, derivatives.each_mut().map(|all| &mut all[..]))?;
        for (what, all) in ["residuals", "by_q", "by_qd", "by_tau"].iter().zip(&s.own) {
            check_finite(&format!("{what} of a function in costs"), all)?;
        }
        Ok(())
    }
}
