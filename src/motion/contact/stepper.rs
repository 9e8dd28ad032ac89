//! Steps of states with contacts, one after another, and records of their contacts.

use super::super::job::{Impacts, Job};
use super::super::scratch::Scratch;
use super::super::step_settings::StepSettings;
use super::super::torque::{StepFault, Torque};
use super::super::totals::TOTALS;
use super::super::touches::Touches;
use super::closed::{onto_connections, positions_onto_connections};
use super::project::{along_surfaces, onto_surfaces, out_of_planes};
use super::report::RECORD;
use super::shaped::{Shaped, step};
use super::shapes::Shapes;
use super::step::ContactStep;
use crate::dynamics::contacts::{ContactScratch, slip};
use crate::error::Error;
use crate::filter::Form;
use crate::model::Model;
use crate::scene::Scene;
use crate::scene::contact_point::ContactPoint;

/// Scratch memory for one state of a scene with contacts.
pub(in crate::motion) struct ContactStepper {
    pub(super) scratch: Scratch<f64>,
    pub(super) touching: ContactStep,
    shaped: Option<Box<Shaped>>,
}

impl ContactStepper {
    #[cold]
    pub fn new(scene: &Scene, settings: &StepSettings, form: Form) -> Self {
        Self {
            scratch: Scratch::new(scene.model(), settings),
            touching: ContactStep::new(scene, settings, form),
            shaped: Shaped::new(scene).map(Box::new),
        }
    }

    /// Exchanges the shapes with those of the same state, which may know its contacts.
    pub fn exchange(&mut self, shapes: &mut Box<Shapes>) {
        if let Some(shaped) = &mut self.shaped {
            std::mem::swap(&mut shaped.shapes, shapes);
        }
    }

    /// Runs a job; returns the fault of the earliest step, and of the lowest state in it.
    pub fn run(&mut self, mut job: Job<'_, '_>) -> Result<(), StepFault> {
        let width = job.settings.width(job.scene);
        let mut outcome: Result<(), StepFault> = Ok(());
        for lane in 0..job.states.len() {
            let Err(fault) = self.run_one(&mut job, lane, width) else { continue };
            if outcome.as_ref().err().is_none_or(|known| fault.step < known.step) {
                outcome = Err(fault);
            }
        }
        outcome
    }

    fn run_one(&mut self, job: &mut Job<'_, '_>, lane: usize, width: usize) -> Result<(), StepFault> {
        let (scene, settings, state) = (job.scene, job.settings, job.states.at(lane));
        let (nq, nv) = (scene.nq(), scene.nv());
        let current = &mut job.current[lane * width..(lane + 1) * width];
        let (q, rest) = current.split_at_mut(nq);
        let (v, rest) = rest.split_at_mut(nv);
        let (totals, kept) = rest.split_at_mut(TOTALS);
        let s = &mut self.scratch;
        if settings.accuracy.is_some() {
            s.adopt(settings, &settings.scheme);
        }
        s.take_gains(settings, 1, |_| state);
        s.q.copy_from_slice(q);
        s.v.copy_from_slice(v);
        s.totals.copy_from_slice(totals);
        match job.torque {
            Torque::Constant(torque) => s.torque.copy_from_slice(torque.state(state)),
            _ => s.torque.fill(0.0),
        }
        let mut outcome = Ok(());
        for n in job.steps.clone() {
            let s = &mut self.scratch;
            if let Torque::Steps { torque, first } = job.torque {
                let at = (n - first) * nv;
                s.torque.copy_from_slice(&torque.state(state)[at..at + nv]);
            }
            s.take_targets(settings, (n, 1), |_| state);
            let impacts = job.impacts.map(|impacts| (impacts, job.begun[lane]));
            outcome = self.step((scene, settings), (n, state), kept, (impacts, job.touches));
            let s = &mut self.scratch;
            if outcome.is_err() {
                break;
            }
            std::mem::swap(&mut s.q, &mut s.q_next);
            std::mem::swap(&mut s.v, &mut s.v_next);
        }
        q.copy_from_slice(&self.scratch.q);
        v.copy_from_slice(&self.scratch.v);
        totals.copy_from_slice(&self.scratch.totals);
        outcome
    }

    /// Step `n` of the state in the scratch, to `q_next` and `v_next`. Adds its impacts on stops, for the step at which
    /// the state began, and the contacts of its shapes.
    pub(super) fn step(
        &mut self,
        (scene, settings): (&Scene, &StepSettings),
        (n, state): (usize, usize),
        kept: &mut [f64],
        (impacts, touches): (Option<(&Impacts, usize)>, Option<&Touches>),
    ) -> Result<(), StepFault> {
        let Self { scratch: s, touching, shaped } = self;
        let made = step(shaped.as_deref_mut(), touching, (scene, settings), s, kept);
        made.map_err(|(joint, error)| StepFault { step: n, state, joint, error })?;
        if let Some(coupling) = &settings.coupling {
            coupling.restore(&mut s.q_next, &mut s.v_next);
        }
        if let (Some(touches), Some(shaped)) = (touches, shaped)
            && touches.counts(n)
        {
            touches.add(shaped.forces((&s.q_next, settings.step), (state, n + 1)));
        }
        if let Some((impacts, begun)) = impacts
            && !touching.impacts.is_empty()
        {
            impacts.add(&touching.impacts, state, settings.time(n - begun));
        }
        Ok(())
    }
}

impl ContactStepper {
    /// Ends a substep of error control: the contacts `touching` move along their surfaces, or away from them if they
    /// rebound, and the connections hold; with `positions`, these contacts are on their surfaces, and others not below.
    /// Returns the joint and the error if it fails.
    pub(super) fn project(
        &mut self,
        (scene, settings): (&Scene, &StepSettings),
        (touching, rebounds, positions): (&[usize], bool, bool),
        (q, v): (&mut [f64], &mut [f64]),
    ) -> Result<(), (String, Error)> {
        let Self { scratch: s, touching: ContactStep { solver, rows, .. }, .. } = self;
        let (system, workspace) = ((scene, &s.model), &mut solver.workspace);
        if positions && settings.smoothing.is_none() {
            onto_surfaces(system, workspace, rows, (&mut *q, &mut s.q_stage), touching)?;
            out_of_planes(system, workspace, rows, (&mut *q, &mut s.q_stage), (None, &[]))?;
        } else if positions {
            positions_onto_connections(scene, (&s.model, workspace), rows, q, None)?;
        }
        if settings.smoothing.is_none() {
            along_surfaces(system, workspace, rows, (&*q, &mut *v), (touching, rebounds))?;
        }
        onto_connections(scene, (&s.model, workspace), rows, (&*q, &mut *v), None)?;
        if let Some(coupling) = &settings.coupling {
            coupling.restore(q, v);
        }
        Ok(())
    }
}

/// Writes one row of contacts: gap and slip velocity of the state, force during the step that ends there, stored
/// impulse of impacts, and contact state during that step.
pub(in crate::motion) fn record(
    model: &Model<f64>,
    points: &[ContactPoint],
    rows: &mut ContactScratch,
    (q, v): (&[f64], &[f64]),
    (kept, h): (&[f64], f64),
    to: &mut [f64],
) {
    let (held, struck) = kept.split_at(3 * points.len());
    rows.place(model, points, q);
    let u = rows.velocities(model, points, v);
    for (i, (point, to)) in points.iter().zip(to.chunks_exact_mut(RECORD)).enumerate() {
        let of = |p: &[f64]| point.axes.tr_mul(&nalgebra::Vector3::new(p[3 * i], p[3 * i + 1], p[3 * i + 2]));
        to[0] = rows.gaps[i];
        to[1..4].copy_from_slice(slip(&rows.axes[i], &u.as_slice()[3 * i..]).as_slice());
        to[4..7].copy_from_slice((of(held) / h).as_slice());
        to[7..10].copy_from_slice(of(struck).as_slice());
        to[10] = struck[3 * points.len() + i];
    }
}
