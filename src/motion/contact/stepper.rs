//! Steps of one state with contacts, and records of its contacts.

use super::super::job::Impacts;
use super::super::scratch::Scratch;
use super::super::step_settings::StepSettings;
use super::super::torque::StepFault;
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
    pub scratch: Scratch<f64>,
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

    /// Step `n` of the state in the scratch, to `q_next` and `v_next`. Adds its impacts on stops, for the step at which
    /// the state began, and the contacts of its shapes.
    pub fn step(
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
