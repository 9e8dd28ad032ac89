//! The step of an optimal control problem: v' = v + h a, q' = q exp(h v'), with a from forward dynamics.
//!
//! Springs, damping and friction act at the end of the step, as in [`Method::ImplicitEuler`](crate::motion::Method):
//! they are measurement noise, r = h (d + c) + h^2 k, beside the armature. Friction is c = f / sqrt(v^2 + v0^2) times
//! the velocity.

use super::contacts::ContactSteps;
use super::knot::{Sizes, Turn};
use crate::algorithm::{Algorithm, Arguments, Derivatives};
use crate::batch::Evaluator;
use crate::error::{Error, Fault, in_language};
use crate::filter::Form;
use crate::kinematics::manifold::step_jacobians;
use crate::model::StateModel;
use crate::motion::properties::{check_coulomb, joint_of_row};
use crate::scene::Scene;
use nalgebra::Matrix6;
use std::ops::Range;

/// Knots that are differentiated, and step lengths that are tried, at once.
pub const AT_ONCE: usize = 8;

/// The step of one scene, with its scratch.
#[derive(Debug)]
pub struct Dynamics {
    /// The scene of the caller.
    whole: Scene,
    /// Its motion: with r beside the armature, without friction and contacts.
    scene: Scene,
    evaluator: Evaluator,
    /// The steps in which contacts act, instead of forward dynamics.
    contacts: Option<ContactSteps>,
    pub h: f64,
    /// h k: springs act on the displacement at the end of the step.
    ahead: Vec<f64>,
    friction: Vec<f64>,
    friction_speed: f64,
    has_joint_forces: bool,
    armature: Vec<f64>,
    /// The degrees of freedom with a control.
    pub driven: Vec<usize>,
    /// Degrees of freedom of the joints with a rotation.
    turning: Vec<Range<usize>>,
    torque: Vec<f64>,
    noise: Vec<f64>,
    three: Vec<f64>,
}

impl Dynamics {
    /// The step of `scene` whose joints `driven` have controls; contacts act if the length `smoothing` is not zero.
    ///
    /// # Errors
    ///
    /// Friction that is not Coulomb's, and friction of scenes with mimic joints, each by name; scenes whose contacts
    /// cannot be relaxed.
    pub fn new(
        scene: &Scene,
        h: f64,
        driven: Vec<usize>,
        (friction_speed, smoothing): (f64, f64),
    ) -> Result<Self, Error> {
        let whole = scene.clone();
        let contacts =
            if smoothing == 0.0 { None } else { Some(ContactSteps::new(scene, h, friction_speed, smoothing)?) };
        let plain = scene.tree().touches().then(|| scene.without_contacts()).transpose()?;
        let scene = plain.as_ref().unwrap_or(scene);
        let (nv, forces) = (scene.nv(), scene.joint_forces());
        check_coulomb(scene.tree(), &forces.curves, "")?;
        let is_coupled = scene.coupling().is_some();
        if is_coupled && let Some(row) = forces.friction.iter().position(|&friction| friction != 0.0) {
            let joint = joint_of_row(scene.tree(), row);
            let found = format!("friction of joint {joint:?} in a scene whose joints follow others (mimic)");
            return Err(Error::argument(
                "scene",
                found,
                in_language(
                    "one without friction: SceneBuilder::with_properties",
                    "one without friction: scene.with_properties(friction=0.0)",
                ),
            ));
        }
        // The springs and the damping of coupled joints are explicit.
        let none = || vec![0.0; nv];
        let (damping, stiffness, friction) = if is_coupled {
            (none(), none(), none())
        } else {
            (forces.damping.clone(), forces.stiffness.clone(), forces.friction.clone())
        };
        let ahead: Vec<f64> = stiffness.iter().map(|k| h * k).collect();
        let rubbing: Vec<f64> = damping.iter().zip(&ahead).map(|(d, hk)| d + hk).collect();
        let mut stepping = scene.clone();
        let mut armature = Vec::new();
        if !is_coupled {
            armature = scene.model().system.noise.iter().zip(&rubbing).map(|(r, d)| r + h * d).collect();
            if rubbing.iter().any(|&d| d != 0.0) {
                stepping = scene.with_state_model(&StateModel { inertias: &[], armature: &armature })?;
            }
        }
        let stepping = stepping.with_open_connections();
        let turning = scene.joints().iter().filter(|joint| joint.quaternion().is_some());
        Ok(Self {
            evaluator: stepping.evaluator(),
            contacts,
            h,
            has_joint_forces: forces.damping.iter().chain(&forces.stiffness).any(|&value| value != 0.0),
            ahead,
            friction: if friction.iter().any(|&f| f != 0.0) { friction } else { Vec::new() },
            friction_speed,
            armature,
            driven,
            turning: turning.map(|joint| joint.v.clone()).collect(),
            torque: vec![f64::NAN; AT_ONCE * nv],
            noise: vec![f64::NAN; AT_ONCE * nv],
            three: vec![f64::NAN; AT_ONCE * 3 * nv * nv],
            scene: stepping,
            whole,
        })
    }

    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The scene with its colliders.
    pub fn whole(&self) -> &Scene {
        &self.whole
    }

    /// States that the kernels compute at once.
    pub fn lanes(&self) -> usize {
        self.evaluator.lanes()
    }

    pub fn sizes(&self, has_rate: bool) -> Sizes {
        Sizes { nv: self.scene.nv(), controls: self.driven.len(), has_rate }
    }

    /// f / sqrt(v^2 + v0^2).
    fn chord(&self, row: usize, v: f64) -> f64 {
        self.friction[row] / v.hypot(self.friction_speed)
    }

    /// The torque of a state with those of springs, damping and friction, and the armature of the state; both go to the
    /// places of state `at`.
    fn load(&mut self, at: usize, (q, v, u): (&[f64], &[f64], &[f64])) -> Result<(), Error> {
        let nv = v.len();
        let mut torque = std::mem::take(&mut self.torque);
        let of_state = &mut torque[at * nv..][..nv];
        of_state.copy_from_slice(u);
        let mut done = Ok(());
        if self.has_joint_forces {
            done = self.scene.add_linear_joint_forces(q, v, of_state);
            for ((torque, hk), v) in of_state.iter_mut().zip(&self.ahead).zip(v) {
                *torque -= hk * v;
            }
        }
        if !self.friction.is_empty() {
            for row in 0..nv {
                let chord = self.chord(row, v[row]);
                of_state[row] -= chord * v[row];
                self.noise[at * nv + row] = self.h * chord + self.armature[row];
            }
        }
        self.torque = torque;
        done
    }

    /// Runs an algorithm on loaded states.
    fn run<'a>(
        &mut self,
        algorithm: Algorithm,
        states: impl Iterator<Item = (&'a [f64], &'a [f64])>,
        out: &mut [f64],
    ) -> Result<(), Fault> {
        let nv = self.scene.nv();
        let has_noise = !self.friction.is_empty();
        let mut arguments = [Arguments::default(); AT_ONCE];
        let mut count = 0;
        for (lane, ((q, qd), of)) in states.zip(&mut arguments).enumerate() {
            let own = lane * nv..(lane + 1) * nv;
            let armature = if has_noise { &self.noise[own.clone()] } else { &[] };
            let model = StateModel { inertias: &[], armature };
            *of = Arguments { q, qd, u: &self.torque[own], model, ..Arguments::default() };
            count = lane + 1;
        }
        self.scene.evaluate(&mut self.evaluator, algorithm, &arguments[..count], out)
    }

    /// Accelerations (states x nv) of at most [`AT_ONCE`] states.
    ///
    /// # Errors
    ///
    /// An error of forward dynamics, with the index of the state.
    pub fn accelerations<'a>(
        &mut self,
        states: impl Iterator<Item = (&'a [f64], &'a [f64], &'a [f64])> + Clone,
        out: &mut [f64],
    ) -> Result<(), Fault> {
        if let Some(contacts) = &mut self.contacts {
            return contacts.accelerations(states, out);
        }
        for (state, of) in states.clone().enumerate() {
            self.load(state, of).map_err(|error| Fault { state, error })?;
        }
        self.run(Algorithm::ForwardDynamics(Form::Auto), states.map(|(q, v, _)| (q, v)), out)
    }

    /// The state after a step with the accelerations `a`: v' = v + h a and q' = q exp(x), x = h v'.
    ///
    /// # Errors
    ///
    /// A result that overflows.
    pub fn advance(
        &self,
        (q, v, a): (&[f64], &[f64], &[f64]),
        x: &mut [f64],
        (q_next, v_next): (&mut [f64], &mut [f64]),
    ) -> Result<(), Error> {
        for (((x, v_next), v), a) in x.iter_mut().zip(&mut *v_next).zip(v).zip(a) {
            *v_next = self.h * a + v;
            *x = self.h * *v_next;
        }
        self.scene.integrate(q, x, q_next)
    }

    /// F = h da/d(q, v) + [0, 1], (states x nv x 2 nv), and G = h da/du, (states x nv x controls), of at most
    /// [`AT_ONCE`] states, with the velocities after the step.
    ///
    /// # Errors
    ///
    /// An error of the derivatives of forward dynamics, with the index of the state.
    pub fn derivatives<'a>(
        &mut self,
        states: impl Iterator<Item = (&'a [f64], &'a [f64], &'a [f64], &'a [f64])> + Clone,
        (by_state, by_control): (&mut [f64], &mut [f64]),
    ) -> Result<(), Fault> {
        if let Some(contacts) = &mut self.contacts {
            let states = states.map(|(q, v, u, _)| (q, v, u));
            return contacts.derivatives(states, &self.driven, (by_state, by_control));
        }
        for (state, (q, v, u, _)) in states.clone().enumerate() {
            self.load(state, (q, v, u)).map_err(|error| Fault { state, error })?;
        }
        let (nv, m, h) = (self.scene.nv(), self.driven.len(), self.h);
        let (size, count) = (nv * nv, states.clone().count());
        let mut three = std::mem::take(&mut self.three);
        let which = Algorithm::Derivatives(Derivatives::ForwardDynamics(Form::Auto));
        let done = self.run(which, states.clone().map(|(q, v, ..)| (q, v)), &mut three[..count * 3 * size]);
        if done.is_ok() && nv > 0 {
            for (at, (q, v, _, v_next)) in states.enumerate() {
                let of = &three[at * 3 * size..][..3 * size];
                let [by_q, by_v, inverse] = [0, 1, 2].map(|part| &of[part * size..][..size]);
                let f = &mut by_state[at * 2 * size..][..2 * size];
                let g = &mut by_control[at * nv * m..][..nv * m];
                for i in 0..nv {
                    let row = &mut f[i * 2 * nv..][..2 * nv];
                    row[..nv].copy_from_slice(&by_q[i * nv..][..nv]);
                    row[nv..].copy_from_slice(&by_v[i * nv..][..nv]);
                    let inverse = &inverse[i * nv..][..nv];
                    if self.has_joint_forces {
                        self.scene.add_linear_joint_forces_to_row(q, inverse, row);
                        for ((by_v, hk), inverse) in row[nv..].iter_mut().zip(&self.ahead).zip(inverse) {
                            *by_v -= hk * inverse;
                        }
                    }
                    if !self.friction.is_empty() {
                        for j in 0..nv {
                            // d/dv of c v' with the velocity v' of the end, of which h da/dv is implicit already.
                            let chord = self.chord(j, v[j]);
                            let square = v[j] * v[j] + self.friction_speed * self.friction_speed;
                            row[nv + j] -= (chord - chord * v[j] / square * v_next[j]) * inverse[j];
                        }
                    }
                    for entry in row.iter_mut() {
                        *entry *= h;
                    }
                    row[nv + i] += 1.0;
                    for (g, &driven) in g[i * m..][..m].iter_mut().zip(&self.driven) {
                        *g = h * inverse[driven];
                    }
                }
            }
        }
        self.three = three;
        done
    }

    /// The Jacobians of q' = q exp(h v') of all joints with a rotation.
    pub fn turns(&self, v_next: &[f64], turns: &mut [Turn]) {
        for (own, turn) in self.turning.iter().zip(turns) {
            let mut x = [0.0; 6];
            for (x, v) in x.iter_mut().zip(&v_next[own.clone()]) {
                *x = self.h * v;
            }
            let [transport, jacobian] = step_jacobians(&x[..own.len()]);
            *turn = Turn { first: own.start, count: own.len(), transport, jacobian };
        }
    }

    /// The number of joints with a rotation.
    pub fn turning(&self) -> usize {
        self.turning.len()
    }

    /// The derivative of `difference(from, q)` = `apart` by q, (nv x nv) blocks of the joints with a rotation, written
    /// as the Jacobian of [`Turn`]; all others are one.
    pub fn difference_turns(&self, apart: &[f64], turns: &mut [Turn]) -> Result<(), Error> {
        for (own, turn) in self.turning.iter().zip(turns) {
            let count = own.len();
            let [_, jacobian] = step_jacobians(&apart[own.clone()]);
            // One beyond the block.
            let entry = |i: usize, j: usize| {
                if i.max(j) < count { jacobian[i * count + j] } else { f64::from(u8::from(i == j)) }
            };
            let Some(inverse) = Matrix6::from_fn(entry).try_inverse() else {
                return Err(Error::argument("costs", "a rotation by a whole turn", "configurations that are nearer"));
            };
            *turn = Turn { first: own.start, count, ..Turn::default() };
            for i in 0..count {
                for j in 0..count {
                    turn.jacobian[i * count + j] = inverse[(i, j)];
                }
            }
        }
        Ok(())
    }
}
