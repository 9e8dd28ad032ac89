//! Steps with relaxed contacts: v' is the velocity after a contact step of the [simulation](crate::motion).

use crate::batch::{Broadcast, Fault};
use crate::error::Error;
use crate::motion::{Limits, Method, RecordedRows, Records, Rollout, Settings, StepFault, Torque};
use crate::scene::Scene;

/// The contact steps of a scene; q' = q exp(h v') is not theirs.
#[derive(Debug)]
pub struct ContactSteps {
    scene: Scene,
    settings: Settings,
    /// q, v and u of the states, then rows of the rollout and their cotangents.
    given: [Vec<f64>; 3],
    rows: [Vec<f64>; 2],
}

/// A state (q, v, u).
pub type State<'a> = (&'a [f64], &'a [f64], &'a [f64]);

impl ContactSteps {
    /// The steps of `scene` with contacts relaxed by the length `smoothing`, m.
    ///
    /// # Errors
    ///
    /// Scenes with connections or joints that follow others, and what [`Rollout::new`] refuses.
    pub fn new(scene: &Scene, h: f64, friction_speed: f64, smoothing: f64) -> Result<Self, Error> {
        let tree = scene.tree();
        let unfit = [
            (scene.coupling().is_some(), "whose joints follow others (mimic)"),
            (!tree.constraints().is_empty(), "whose links are connected"),
            (!tree.touches(), "without contacts"),
        ];
        if let Some((_, what)) = unfit.iter().find(|(is_unfit, _)| *is_unfit) {
            let found = format!("{smoothing} for a scene {what}");
            return Err(Error::argument("smoothing", found, "0: contacts do not act in the plan"));
        }
        let mut settings =
            Settings::new(scene, h).with_method(Method::Contact).with_limits(Limits::Report).with_smoothing(smoothing);
        settings.properties.friction_speed = friction_speed;
        Rollout::new(scene, settings.clone(), &scene.neutral(), &vec![0.0; scene.nv()])?;
        Ok(Self { scene: scene.clone(), settings, given: Default::default(), rows: Default::default() })
    }

    /// The accelerations (v' - v) / h, (states x nv).
    ///
    /// # Errors
    ///
    /// An error of the step, with the index of the state.
    pub fn accelerations<'a>(&mut self, states: impl Iterator<Item = State<'a>>, out: &mut [f64]) -> Result<(), Fault> {
        let (nv, h) = (self.scene.nv().max(1), self.settings.dt);
        run((&self.scene, &self.settings), (&mut self.given, &mut self.rows), states, 1).map_err(fault)?;
        for (out, rows) in out.chunks_exact_mut(nv).zip(self.rows[1].chunks_exact(2 * nv)) {
            for ((a, before), after) in out.iter_mut().zip(&rows[..nv]).zip(&rows[nv..]) {
                *a = (after - before) / h;
            }
        }
        Ok(())
    }

    /// dv'/d(q, v), (states x nv x 2 nv), and dv'/du, (states x nv x driven): the adjoint of the step for each entry of
    /// v'.
    ///
    /// # Errors
    ///
    /// As [`ContactSteps::accelerations`].
    pub fn derivatives<'a>(
        &mut self,
        states: impl Iterator<Item = State<'a>>,
        driven: &[usize],
        (by_state, by_control): (&mut [f64], &mut [f64]),
    ) -> Result<(), Fault> {
        let Self { scene, settings, given, rows } = self;
        let nv = scene.nv();
        let of_copy = |mut found: Fault| {
            found.state /= nv.max(1);
            found
        };
        let rollout = run((scene, settings), (given, rows), states, nv).map_err(|found| of_copy(fault(found)))?;
        let count = rollout.states();
        let (by_q, mut by_qd) = (vec![0.0; count * 2 * nv], vec![0.0; count * 2 * nv]);
        for copy in 0..count {
            by_qd[(2 * copy + 1) * nv + copy % nv] = 1.0;
        }
        let ([_, _, u], [q, qd]) = (given, rows);
        let rows = RecordedRows { q, qd, every: 1, by_q: &by_q, by_qd: &by_qd };
        let torque = torques(u, nv).map_err(|error| Fault { state: 0, error })?;
        let found = rollout.gradients(&torque, 1, &rows, false).map_err(|found| of_copy(fault(found)))?;
        let gradients = found.q.chunks_exact(nv).zip(found.qd.chunks_exact(nv));
        for ((by_q, by_qd), to) in gradients.zip(by_state.chunks_exact_mut(2 * nv)) {
            to[..nv].copy_from_slice(by_q);
            to[nv..].copy_from_slice(by_qd);
        }
        for (by_u, to) in found.torque.chunks_exact(nv).zip(by_control.chunks_exact_mut(driven.len().max(1))) {
            for (to, &row) in to.iter_mut().zip(driven) {
                *to = by_u[row];
            }
        }
        Ok(())
    }
}

/// Collects states, each `copies` times, and makes a step: rows of q and of qd, (states, 2, nq) and (states, 2, nv).
fn run<'s, 'a>(
    (scene, settings): (&'s Scene, &Settings),
    ([q, v, u], [rows_q, rows_v]): (&mut [Vec<f64>; 3], &mut [Vec<f64>; 2]),
    states: impl Iterator<Item = State<'a>>,
    copies: usize,
) -> Result<Rollout<&'s Scene>, StepFault> {
    for all in [&mut *q, v, u] {
        all.clear();
    }
    for state in states {
        for _ in 0..copies {
            for (all, of) in [&mut *q, v, u].into_iter().zip([state.0, state.1, state.2]) {
                all.extend_from_slice(of);
            }
        }
    }
    rows_q.resize(2 * q.len(), f64::NAN);
    rows_v.resize(2 * v.len(), f64::NAN);
    let refuse = |error| StepFault { step: 0, state: 0, joint: String::new(), error };
    let mut rollout = Rollout::new(scene, settings.clone(), q, v).map_err(refuse)?;
    let torque = torques(u, scene.nv()).map_err(refuse)?;
    rollout.advance(1, &torque, Some(&mut Records::new(rows_q, rows_v)))?;
    Ok(rollout)
}

/// The torques of the states, (states x nv).
fn torques(u: &[f64], nv: usize) -> Result<Torque<'_>, Error> {
    let states = [u.len() / nv.max(1)];
    Ok(Torque::Constant(Broadcast::new("tau", u, nv, &states, &states)?))
}

fn fault(found: StepFault) -> Fault {
    Fault { state: found.state, error: found.error }
}
