//! Gradients of a function of a trajectory: backward through all steps of a rollout, from its last recorded row to its start.
//!
//! Recorded rows are the checkpoints. Between two of them the steps are made again and kept, or where they are many some of them, from which the others are made in turn: the
//! memory of a thread grows with the root of how many lie between two rows. With every row recorded no step is made again. `reverser` goes through the steps, `backward`
//! through one.

use super::backward::ACTING;
use super::reverser::{Job, Reverser};
use super::rollout::{GRAIN, Rollout};
use super::torque::{StepFault, Torque};
use crate::batch::{Batch, Fault, Pool};
use crate::dynamics::derivatives::Parameters;
use crate::error::{Error, check_finite, check_length};
use crate::scene::Scene;
use crate::{interrupt, memory};
use std::borrow::Borrow;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// The rows of a rollout, as [`Records`](super::Records) were written, and the gradients of a scalar by them.
#[derive(Debug, Clone, Copy)]
pub struct RecordedRows<'a> {
    /// Configurations, (states, rows, nq), the first at the start.
    pub q: &'a [f64],
    /// Rates, (states, rows, nv).
    pub qd: &'a [f64],
    /// A row after so many steps.
    pub every: usize,
    /// The gradients by `q`, in the tangent space of each row, (states, rows, nv).
    pub by_q: &'a [f64],
    /// By `qd`, (states, rows, nv).
    pub by_qd: &'a [f64],
}

/// Gradients of a scalar of recorded rows, for each state by itself, one state after another.
#[derive(Debug, Clone, PartialEq)]
pub struct RolloutGradients {
    /// By the configuration at the start, in its tangent space, (nv).
    pub q: Vec<f64>,
    /// By the rates at the start, (nv).
    pub qd: Vec<f64>,
    /// By the torques as they were given: (nv), or (steps, nv) of steps. Where none were given, as for constant ones.
    pub torque: Vec<f64>,
    /// By the armature of every degree of freedom, (nv).
    pub armature: Vec<f64>,
    /// By its damping, (nv).
    pub damping: Vec<f64>,
    /// By its stiffness, (nv).
    pub stiffness: Vec<f64>,
    /// By its friction, (nv).
    pub friction: Vec<f64>,
    /// By (m, m c, I) of each body of the model about its frame's origin, in the order of [`Parameters`], (bodies); empty where not asked for.
    pub parameters: Vec<Parameters<f64>>,
}

/// As many times as long as a step forward one backward takes, roughly; decides about threads.
const COST: usize = 4;

impl<S: Borrow<Scene>> Rollout<S> {
    /// Gradients of a scalar of the rows that a rollout recorded: one that was made as this one, and advanced by `steps` steps with these torques. Of this one's states only their
    /// number is read.
    ///
    /// By the adjoint of every step, O(N) a stage; steps after the last row change nothing. `parameters`: whether to give those by inertias. In the form of the rollout: a
    /// step in doubt is gone back through with every check.
    ///
    /// ```
    /// use phipsi::motion::{RecordedRows, Records, Rollout, Settings, Torque};
    /// # fn main() -> Result<(), phipsi::Error> {
    /// let scene = phipsi::scenes::chain(7)?;
    /// let mut rollout = Rollout::new(&scene, Settings::new(&scene, 1e-3), &[0.3; 7], &[0.0; 7])?;
    /// let (mut q, mut qd) = ([0.0; 101 * 7], [0.0; 101 * 7]);
    /// let mut records = Records { q: &mut q, qd: &mut qd, contacts: &mut [], every: 1 };
    /// rollout.advance(100, &Torque::Zero, Some(&mut records)).map_err(|fault| fault.error)?;
    /// // Of the first joint's angle at the end.
    /// let mut by_q = [0.0; 101 * 7];
    /// by_q[100 * 7] = 1.0;
    /// let rows = RecordedRows { q: &q, qd: &qd, every: 1, by_q: &by_q, by_qd: &[0.0; 101 * 7] };
    /// let gradients = rollout.gradients(&Torque::Zero, 100, &rows, false).map_err(|fault| fault.error)?;
    /// // A torque at that joint turns it, the more the less inertia there is.
    /// assert!(gradients.torque[0] > 0.0);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    ///
    /// Rows or torques of other lengths than they should have, and numbers that are not finite; `conserve_momentum`, whose corrections have no gradient here. As
    /// [`Rollout::advance`], with the step at fault; gradients that are not finite.
    pub fn gradients(
        &self,
        torque: &Torque<'_>,
        steps: usize,
        rows: &RecordedRows<'_>,
        parameters: bool,
    ) -> Result<RolloutGradients, StepFault> {
        let refuse = |error| StepFault { step: 0, state: 0, joint: String::new(), error };
        self.scene().check_no_connections("gradients of a simulation").map_err(refuse)?;
        self.scene().check_no_contacts("gradients of a simulation").map_err(refuse)?;
        let torques = self.check_torque_from(0, torque, steps);
        torques.map_err(|fault| StepFault { state: fault.state, ..refuse(fault.error) })?;
        let count =
            self.check_rows(rows, steps).map_err(|fault| StepFault { state: fault.state, ..refuse(fault.error) })?;
        let (scene, states) = (self.scene(), self.states());
        let (nv, bodies) = (scene.nv(), if parameters { scene.model().bodies.len() } else { 0 });
        let layout = Layout { nv, torques: if matches!(torque, Torque::Steps { .. }) { steps } else { 1 }, bodies };
        let width = layout.width();
        let mut all = memory::filled("q", states.saturating_mul(width), 0.0).map_err(refuse)?;
        let settings = &self.settings.backward();
        let pool = Pool::default();
        let (form, arm, cost) = (self.form, self.arm, COST.saturating_mul(self.cost()).saturating_mul(steps.max(1)));
        let make = || Reverser::new(form, arm);
        let fault: Mutex<Option<StepFault>> = Mutex::new(None);
        let outcome = Batch { states, cost, pool: &pool, make }.run_pieces(GRAIN, &mut all, |reverser, range, out| {
            let lanes = reverser.lanes();
            for from in range.clone().step_by(lanes) {
                let to = (from + lanes).min(range.end);
                let out = &mut out[(from - range.start) * width..(to - range.start) * width];
                let job = Job { scene, settings, torque, rows, count, states: from..to, layout };
                if let Err(found) = reverser.run(&job, out) {
                    let mut fault = fault.lock().unwrap_or_else(PoisonError::into_inner);
                    if fault.as_ref().is_none_or(|known| found.state < known.state) {
                        *fault = Some(found);
                    }
                }
            }
            Ok(())
        });
        outcome.map_err(|fault| refuse(fault.error))?;
        if let Some(fault) = fault.into_inner().unwrap_or_else(PoisonError::into_inner) {
            return Err(fault);
        }
        layout.apart(&all, states).map_err(refuse)
    }

    /// How many rows there are, if all lengths fit.
    fn check_rows(&self, rows: &RecordedRows<'_>, steps: usize) -> Result<usize, Fault> {
        let RecordedRows { q, qd, every, by_q, by_qd } = *rows;
        let (scene, states) = (self.scene(), self.states());
        let refuse = |error| Fault { state: 0, error };
        if !self.settings.roots.is_empty() {
            let expected = "a rollout without it, whose steps have gradients";
            return Err(refuse(Error::argument("conserve_momentum", "true", expected)));
        }
        if self.settings.coupling.is_some() {
            let expected = "a scene with mimic=\"free\", whose steps have gradients";
            return Err(refuse(Error::argument("scene", "joints that follow others (mimic)", expected)));
        }
        if every == 0 {
            return Err(refuse(Error::argument("every", "0", "at least 1")));
        }
        let count = (steps / every).saturating_add(1);
        for (name, given, width) in
            [("q", q, scene.nq()), ("qd", qd, scene.nv()), ("by_q", by_q, scene.nv()), ("by_qd", by_qd, scene.nv())]
        {
            let own = count.saturating_mul(width);
            check_length(name, given.len(), states.saturating_mul(own)).map_err(refuse)?;
            for (state, given) in given.chunks_exact(own.max(1)).enumerate() {
                check_finite(name, given).map_err(|error| Fault { state, error })?;
            }
        }
        for (row, q) in q.chunks_exact(scene.nq().max(1)).enumerate() {
            let checked = interrupt::check_at(row, 1_024).and_then(|()| scene.check_configuration("q", q));
            checked.map_err(|error| Fault { state: row / count, error })?;
        }
        Ok(count)
    }
}

/// Where the gradients of one state are, one after another: by q, qd, armature, damping, stiffness and friction, then torques, then parameters.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    pub nv: usize,
    /// As many as there are steps, or one.
    pub torques: usize,
    /// Zero where parameters are not asked for.
    pub bodies: usize,
}

impl Layout {
    /// How many have (nv) numbers each.
    const OF_ROWS: usize = ACTING + 1;

    pub fn width(&self) -> usize {
        self.torques.saturating_add(Self::OF_ROWS).saturating_mul(self.nv).saturating_add(10 * self.bodies)
    }

    pub fn torque(&self, index: usize) -> Range<usize> {
        let first = (Self::OF_ROWS + index) * self.nv;
        first..first + self.nv
    }

    pub fn parameters(&self) -> Range<usize> {
        let width = self.width();
        width - 10 * self.bodies..width
    }

    /// Each kind by itself, one state after another.
    fn apart(&self, all: &[f64], states: usize) -> Result<RolloutGradients, Error> {
        let gathered = |range: Range<usize>| -> Result<Vec<f64>, Error> {
            let mut own = memory::with_capacity("q", states * range.len())?;
            all.chunks_exact(self.width().max(1)).for_each(|state| own.extend_from_slice(&state[range.clone()]));
            Ok(own)
        };
        let of_rows = |i: usize| gathered(i * self.nv..(i + 1) * self.nv);
        Ok(RolloutGradients {
            q: of_rows(0)?,
            qd: of_rows(1)?,
            armature: of_rows(2)?,
            damping: of_rows(3)?,
            stiffness: of_rows(4)?,
            friction: of_rows(5)?,
            torque: gathered(self.torque(0).start..self.parameters().start)?,
            parameters: gathered(self.parameters())?.as_chunks().0.to_vec(),
        })
    }
}
