//! Gradients of a function of a trajectory by backpropagation through all steps of a rollout, from the last recorded
//! row to the start.
//!
//! Recorded rows are the checkpoints. Between two of them the steps are recomputed and stored. If there are many, only
//! some are stored, from which the others are recomputed, so that the memory per thread grows with the square root of
//! the number of steps between rows. If every step is recorded, none is recomputed. With contacts, the whole run is
//! repeated and every step is stored. `reverser` iterates over the steps; `backward` differentiates one.

use super::backward::{RATE, TARGET, TORQUE};
use super::contact::{ContactReverse, ModeChange, ShapeGradients, check_reproduced};
use super::gradient_layout::{CONTACTS, INPUT, Layout, PARAMETERS, ROWS, RecordedRows, WRENCHES};
use super::job::Records;
use super::method::Method;
use super::properties::check_coulomb;
use super::reverser::{Job, Reverser};
use super::rollout::{GRAIN, Rollout};
use super::torque::{StepFault, Torque};
use super::wrenches::LinkWrenches;
use crate::batch::instruction_set::InstructionSet;
use crate::batch::{Batch, Fault, Pool};
use crate::dynamics::derivatives::Parameters;
use crate::error::{Error, check_finite, check_length};
use crate::scene::Scene;
use crate::{interrupt, memory};
use std::borrow::Borrow;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// Gradients of a scalar function of recorded rows, computed for each state separately, one state after another.
#[derive(Debug, Clone, PartialEq)]
pub struct RolloutGradients {
    /// By the initial configuration, in its tangent space, (nv).
    pub q: Vec<f64>,
    /// By the initial joint velocities, (nv).
    pub qd: Vec<f64>,
    /// By the applied torques in their shape: (nv) for constant torques, also if there are none, or (steps, nv).
    pub torque: Vec<f64>,
    /// By the targets of the control law, in the tangent space of each, (nv), or (steps, nv) if they change; empty
    /// without a control law.
    pub target: Vec<f64>,
    /// By its target velocities, likewise.
    pub target_rate: Vec<f64>,
    /// By the wrenches on links, (links, 6) in their order in [`Wrenches`](super::Wrenches), or (steps, links, 6) if
    /// they change; empty without wrenches.
    pub wrenches: Vec<f64>,
    /// By the armature, (nv).
    pub armature: Vec<f64>,
    /// By the damping, (nv).
    pub damping: Vec<f64>,
    /// By the stiffness, (nv).
    pub stiffness: Vec<f64>,
    /// By the friction, (nv).
    pub friction: Vec<f64>,
    /// By (m, m c, I) of each body of the model about the origin of its frame, in the order of [`Parameters`],
    /// (bodies); empty if not requested.
    pub parameters: Vec<Parameters<f64>>,
    /// By the contacts of the scene.
    pub contacts: ContactGradients,
    /// By the pairs of shapes that could touch in the run, sorted by state and colliders.
    pub shapes: Vec<ShapeGradients>,
    /// Changes of contacts between two steps, sorted by state, step and contact. At such a change, and where a margin
    /// is small, the gradients are those of the modes of this run: on the other side of the change they differ.
    pub mode_changes: Vec<ModeChange>,
}

/// Gradients by the contacts of a scene, in their order, one state after another; empty without contacts.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub struct ContactGradients {
    /// By the coefficient of friction, (contacts).
    pub friction: Vec<f64>,
    /// By the coefficient of restitution, (contacts).
    pub restitution: Vec<f64>,
    /// By the offset of the plane, (contacts); NaN for a contact with a sphere or a box.
    pub offset: Vec<f64>,
    /// By the unit normal of the plane, tangent to the unit sphere, in the frame of [`Contact::normal`], (contacts);
    /// NaN for a contact with a sphere or a box.
    ///
    /// [`Contact::normal`]: crate::scene::Contact::normal
    pub normal: Vec<[f64; 3]>,
    /// Smallest distance from another mode over all steps, m/s, (contacts): the change of a velocity of the contact
    /// after which it would open, close, stick or slide.
    pub margin: Vec<f64>,
    /// The step with this distance, (contacts).
    pub margin_step: Vec<usize>,
}

/// Approximate cost of a step backward relative to a step forward; it determines the number of threads.
const COST: usize = 4;

impl<S: Borrow<Scene>> Rollout<S> {
    /// Gradients of a scalar function of the rows that a rollout recorded, by backpropagation.
    ///
    /// The rollout must have been created like this one and advanced by `steps` steps with these torques. Only the
    /// number of states of this rollout is used. Uses the adjoint of every step, O(N) per stage; steps after the last
    /// row do not contribute. `parameters` requests the gradients by inertial parameters. The form is that of the
    /// rollout; a step whose error estimate exceeds the tolerance is recomputed with all checks. Steps with contacts
    /// are all recomputed, and differentiated in the modes of their contacts (open, sticking, sliding). Steps with
    /// connections are recomputed too, and differentiated through the connections and the projections at their ends.
    /// For coupled joints, all arrays are those of the [`tree`](Scene::tree), and
    /// [`Coupling::reduce`](crate::scene::Coupling::reduce) gives the gradients by the independent coordinates of the
    /// start.
    ///
    /// ```
    /// use phipsi::motion::{RecordedRows, Records, Rollout, Settings, Torque};
    /// # fn main() -> Result<(), phipsi::Error> {
    /// let scene = phipsi::scenes::chain(7)?;
    /// let mut rollout = Rollout::new(&scene, Settings::new(&scene, 1e-3), &[0.3; 7], &[0.0; 7])?;
    /// let (mut q, mut qd) = ([0.0; 101 * 7], [0.0; 101 * 7]);
    /// let mut records = Records::new(&mut q, &mut qd);
    /// rollout.advance(100, &Torque::Zero, Some(&mut records))?;
    /// // The scalar is the first joint angle at the end.
    /// let mut by_q = [0.0; 101 * 7];
    /// by_q[100 * 7] = 1.0;
    /// let rows = RecordedRows { q: &q, qd: &qd, every: 1, by_q: &by_q, by_qd: &[0.0; 101 * 7] };
    /// let gradients = rollout.gradients(&Torque::Zero, 100, &rows, false)?;
    /// // A torque at that joint increases its angle.
    /// assert!(gradients.torque[0] > 0.0);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    ///
    /// Wrong lengths of rows or torques, and values that are not finite; in closed loops without contacts, a rebound
    /// that the kinetic energy limits; the errors of [`Rollout::advance`], with the failed step; gradients that are not
    /// finite; with contacts, rows that this rollout does not reproduce.
    pub fn gradients(
        &self,
        torque: &Torque<'_>,
        steps: usize,
        rows: &RecordedRows<'_>,
        parameters: bool,
    ) -> Result<RolloutGradients, StepFault> {
        let refuse = |error| StepFault { step: 0, state: 0, joint: String::new(), error };
        let touches = self.settings.method == Method::Contact;
        let torques = self.check_torque_from(0, torque, steps);
        torques.map_err(|fault| StepFault { state: fault.state, ..refuse(fault.error) })?;
        let count =
            self.check_rows(rows, steps).map_err(|fault| StepFault { state: fault.state, ..refuse(fault.error) })?;
        if touches && rows.every > 1 {
            return self.gradients_of_all_steps(torque, steps, rows, (count, parameters));
        }
        let (whole, population): (&Scene, _) = (self.scene.borrow(), self.population.as_deref());
        let (scene, states) = (self.scene(), self.states());
        let (nv, bodies) = (scene.nv(), if parameters { scene.model().bodies.len() } else { 0 });
        let each = |changes: bool| if changes { steps } else { 1 };
        let gains = self.settings.gains.as_deref();
        let inputs = [
            each(matches!(torque, Torque::Steps { .. })),
            gains.map_or(0, |gains| each(!gains.targets.is_empty())),
            gains.map_or(0, |gains| each(!gains.target_rates.is_empty())),
        ];
        let contacts = if touches { scene.contacts().len() } else { 0 };
        let wrenches = self.settings.wrenches.as_deref();
        let links = wrenches.map_or(0, LinkWrenches::links);
        let wrenches = wrenches.map_or(0, |wrenches| each(wrenches.given.steps.is_some()));
        let [torques, targets, rates] = inputs.map(|count| [count, nv]);
        let (of_rows, contacts) = ([Layout::OF_ROWS, nv], [contacts, ContactReverse::WIDTH]);
        let layout =
            Layout { parts: [of_rows, torques, targets, rates, [wrenches, 6 * links], contacts, [bodies, 10]] };
        let width = layout.width();
        let mut all = memory::filled("q", states.saturating_mul(width), 0.0).map_err(refuse)?;
        let settings = &self.settings.backward();
        let pool = Pool::default();
        // Steps with contacts are not vectorized.
        let arm = if touches { InstructionSet::Baseline } else { settings.given.arm };
        let (form, cost) = (settings.given.form, COST.saturating_mul(self.cost()).saturating_mul(steps.max(1)));
        let make = || Reverser::new(form, arm);
        let fault: Mutex<Option<StepFault>> = Mutex::new(None);
        let changes: Mutex<Vec<ModeChange>> = Mutex::new(Vec::new());
        let shapes: Mutex<Vec<ShapeGradients>> = Mutex::new(Vec::new());
        let outcome = Batch { states, cost, pool: &pool, make }.run_pieces(GRAIN, &mut all, |reverser, range, out| {
            let mut from = range.start;
            while from < range.end {
                let to = (from + reverser.lanes()).min(range.end);
                // The states of one model are in lanes.
                let to = population.map_or(to, |population| population.alike(from..to));
                let out = &mut out[(from - range.start) * width..(to - range.start) * width];
                let states = from..to;
                let member = population.map(|population| population.of(from));
                let own = member.map(|member| member.scene(whole)).transpose();
                let own = own.map_err(|error| Fault { state: from, error })?;
                let scene = own.as_deref().map_or(scene, Scene::tree);
                let own_settings = member.map(|member| member.settings.backward());
                let settings = own_settings.as_ref().unwrap_or(settings);
                let mut own_reverser = member.map(|_| make());
                let reverser = own_reverser.as_mut().unwrap_or(&mut *reverser);
                let job =
                    Job { scene, settings, torque, rows, count, states, layout, changes: &changes, shapes: &shapes };
                if let Err(found) = reverser.run(&job, out) {
                    let mut fault = fault.lock().unwrap_or_else(PoisonError::into_inner);
                    if fault.as_ref().is_none_or(|known| found.state < known.state) {
                        *fault = Some(found);
                    }
                }
                from = to;
            }
            Ok(())
        });
        outcome.map_err(|fault| refuse(fault.error))?;
        if let Some(fault) = fault.into_inner().unwrap_or_else(PoisonError::into_inner) {
            return Err(fault);
        }
        let mut mode_changes = changes.into_inner().unwrap_or_else(PoisonError::into_inner);
        mode_changes.sort_by_key(|change| (change.state, change.step, change.contact));
        let mut shapes = shapes.into_inner().unwrap_or_else(PoisonError::into_inner);
        shapes.sort_by_key(|of| (of.state, of.colliders));
        let gradients = RolloutGradients::of(layout, &all, states).map_err(refuse)?;
        Ok(RolloutGradients { shapes, mode_changes, ..gradients })
    }

    /// The gradients from sparse rows of a scene with contacts: the run is repeated and every step recorded.
    ///
    /// A step depends on the impulses of the step before, from which the solution of the contact law is found; with
    /// friction the law can have several. A step that is recomputed from a row alone can therefore be another one.
    fn gradients_of_all_steps(
        &self,
        torque: &Torque<'_>,
        steps: usize,
        rows: &RecordedRows<'_>,
        (count, parameters): (usize, bool),
    ) -> Result<RolloutGradients, StepFault> {
        let refuse = |error| StepFault { step: 0, state: 0, joint: String::new(), error };
        let (scene, states) = (self.scene(), self.states());
        let (nq, nv, whole) = (scene.nq(), scene.nv(), steps + 1);
        let starts = |all: &[f64], width: usize| -> Vec<f64> {
            all.chunks_exact((count * width).max(1)).flat_map(|state| &state[..width]).copied().collect()
        };
        let numbers = states.saturating_mul(whole);
        let room = |width: usize| memory::filled("record_every", numbers.saturating_mul(width), 0.0).map_err(refuse);
        let [mut q, mut qd, mut by_q, mut by_qd] = [room(nq)?, room(nv)?, room(nv)?, room(nv)?];
        let (q0, qd0) = (starts(rows.q, nq), starts(rows.qd, nv));
        let mut rollout =
            Rollout::of_states(self.scene.borrow(), self.settings(), states, (&q0, &qd0)).map_err(refuse)?;
        rollout.advance(steps, torque, Some(&mut Records { q: &mut q, qd: &mut qd, contacts: &mut [], every: 1 }))?;
        for (state, row) in (0..states).flat_map(|state| (0..count).map(move |row| (state, row))) {
            let (from, to) = (state * count + row, state * whole + row * rows.every);
            let recorded = (&rows.q[from * nq..][..nq], &rows.qd[from * nv..][..nv]);
            check_reproduced(
                (row * rows.every).saturating_sub(1),
                recorded,
                (&q[to * nq..][..nq], &qd[to * nv..][..nv]),
            )
            .map_err(|error| StepFault { state, ..refuse(error) })?;
            by_q[to * nv..][..nv].copy_from_slice(&rows.by_q[from * nv..][..nv]);
            by_qd[to * nv..][..nv].copy_from_slice(&rows.by_qd[from * nv..][..nv]);
        }
        let every_row = RecordedRows { q: &q, qd: &qd, every: 1, by_q: &by_q, by_qd: &by_qd };
        self.gradients(torque, steps, &every_row, parameters)
    }

    /// The number of rows, after checking all lengths.
    fn check_rows(&self, rows: &RecordedRows<'_>, steps: usize) -> Result<usize, Fault> {
        let RecordedRows { q, qd, every, by_q, by_qd } = *rows;
        let (scene, states) = (self.scene(), self.states());
        let refuse = |error| Fault { state: 0, error };
        if self.settings.given.accuracy.is_some() {
            let expected = "fixed steps, which have gradients";
            return Err(refuse(Error::argument("accuracy", "a simulation with error control", expected)));
        }
        check_coulomb(scene, &self.settings.properties.curves, "gradients with ").map_err(refuse)?;
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

impl RolloutGradients {
    /// Splits the gradients by kind, each with one state after another.
    fn of(layout: Layout, all: &[f64], states: usize) -> Result<Self, Error> {
        let gathered = |range: Range<usize>| -> Result<Vec<f64>, Error> {
            let mut own = memory::with_capacity("q", states * range.len())?;
            all.chunks_exact(layout.width().max(1)).for_each(|state| own.extend_from_slice(&state[range.clone()]));
            Ok(own)
        };
        let of_rows = |i: usize| gathered(layout.one(ROWS, i));
        Ok(Self {
            q: of_rows(0)?,
            qd: of_rows(1)?,
            armature: of_rows(2)?,
            damping: of_rows(3)?,
            stiffness: of_rows(4)?,
            friction: of_rows(5)?,
            torque: gathered(layout.all(INPUT + TORQUE))?,
            target: gathered(layout.all(INPUT + TARGET))?,
            target_rate: gathered(layout.all(INPUT + RATE))?,
            wrenches: gathered(layout.all(WRENCHES))?,
            parameters: gathered(layout.all(PARAMETERS))?.as_chunks().0.to_vec(),
            contacts: ContactGradients::of(&gathered(layout.all(CONTACTS))?),
            shapes: Vec::new(),
            mode_changes: Vec::new(),
        })
    }
}

impl ContactGradients {
    /// From the values of [`ContactReverse::write`].
    fn of(numbers: &[f64]) -> Self {
        let each: &[[f64; ContactReverse::WIDTH]] = numbers.as_chunks().0;
        let one = |i: usize| each.iter().map(|of| of[i]).collect();
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // indices of steps
        let margin_step = each.iter().map(|of| of[7] as usize).collect();
        Self {
            friction: one(0),
            restitution: one(1),
            offset: one(2),
            normal: each.iter().map(|of| [of[3], of[4], of[5]]).collect(),
            margin: one(6),
            margin_step,
        }
    }
}
