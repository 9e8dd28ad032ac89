//! States of a scene through the fastest code that this processor has: one by one, or in lanes.

use super::Fault;
use super::arms::Arm;
use super::chunk::{Algorithm, Arguments, Chunk, Chunks};
use crate::dynamics::mass_inverse::InverseScratch;
use crate::error::Error;
use crate::scalar::Fused;
use crate::scene::Scene;
use crate::workspace::Workspace;

/// Scratch for the algorithms of one scene on one thread, for one state and for as many as fit in a register.
///
/// What it computes has the same bits in any lane and with any neighbours, but for the sign of a zero in M^-1.
pub struct Evaluator {
    arm: Arm,
    one: Box<dyn Chunks>,
    many: Option<Box<dyn Chunks>>,
    checked: Checked,
}

/// What a state in doubt is done again with.
struct Checked {
    workspace: Workspace<f64>,
    inverse: Option<InverseScratch<f64>>,
}

impl std::fmt::Debug for Evaluator {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Evaluator").field("arm", &self.arm).field("lanes", &self.lanes()).finish_non_exhaustive()
    }
}

impl Evaluator {
    /// Scratch for `scene` on the arm of this process.
    #[must_use]
    pub fn new(scene: &Scene) -> Self {
        Self::on(Arm::of_process(), scene)
    }

    /// The same on an arm of the caller's choice; on the baseline where this processor cannot run it.
    #[must_use]
    pub fn on(arm: Arm, scene: &Scene) -> Self {
        let arm = if arm.available() { arm } else { Arm::Baseline };
        let one: Box<dyn Chunks> = match arm {
            Arm::Baseline => Box::new(Chunk::<f64>::new(scene)),
            Arm::Avx2 | Arm::Avx512 => Box::new(Chunk::<Fused>::new(scene)),
        };
        #[cfg(target_arch = "x86_64")]
        let many: Option<Box<dyn Chunks>> = match arm {
            Arm::Baseline => None,
            Arm::Avx2 => Some(Box::new(Chunk::<crate::scalar::Lanes<pulp::x86::V3>>::new(scene))),
            Arm::Avx512 => Some(Box::new(Chunk::<crate::scalar::Lanes<pulp::x86::V4>>::new(scene))),
        };
        #[cfg(not(target_arch = "x86_64"))]
        let many = None;
        // Without scratch for the plane: what was in doubt there is done in 6-vectors.
        let workspace = Workspace::new(scene.model());
        Self { arm, one, many, checked: Checked { workspace, inverse: None } }
    }

    /// The arm that it runs on.
    #[must_use]
    pub fn arm(&self) -> Arm {
        self.arm
    }

    /// How many states one call of a kernel takes at the most.
    #[must_use]
    pub fn lanes(&self) -> usize {
        self.many.as_ref().map_or(1, |many| many.lanes())
    }

    /// The kernel alone, on one state or at most as many as there are lanes, of equal shapes: no lengths are checked. Results one
    /// after another in `out`; the bits of the result are the states in doubt, which [`Scene::evaluate`] would do again.
    pub fn run(&mut self, algorithm: Algorithm, states: &[Arguments<'_>], out: &mut [f64]) -> u64 {
        match &mut self.many {
            Some(many) if states.len() > 1 => many.run(algorithm, states, out),
            _ => self.one.run(algorithm, states, out),
        }
    }
}

impl Scene {
    /// Scratch for [`Scene::evaluate`]; one for each thread.
    #[must_use]
    pub fn evaluator(&self) -> Evaluator {
        Evaluator::new(self)
    }

    /// One algorithm on any number of states: the results one after another in `out`, as long for each state.
    ///
    /// As many states at once as the processor's registers hold; a state whose arguments, pivots or digits are in doubt is done
    /// once more by the checked method of one state ([`Scene::forward_dynamics`] and its like), in the form asked for.
    ///
    /// # Errors
    ///
    /// [`Fault`] of the lowest state that failed, with the error of the checked method; `out` is then partly written.
    pub fn evaluate(
        &self,
        evaluator: &mut Evaluator,
        algorithm: Algorithm,
        states: &[Arguments<'_>],
        out: &mut [f64],
    ) -> Result<(), Fault> {
        let width = self.width(algorithm);
        if out.len() != width * states.len() {
            let error = Error::Shape {
                argument: "out".to_owned(),
                found: format!("({},)", out.len()),
                expected: format!("{width} numbers for each of {} states", states.len()),
            };
            return Err(Fault { state: 0, error });
        }
        let lanes = evaluator.lanes();
        for (i, (states, out)) in states.chunks(lanes).zip(out.chunks_mut((width * lanes).max(1))).enumerate() {
            let fits = states.iter().all(|state| self.fits(algorithm, state));
            let mut doubt = if fits { evaluator.run(algorithm, states, out) } else { u64::MAX };
            doubt &= u64::MAX >> (64 - states.len());
            while doubt != 0 {
                let lane = doubt.trailing_zeros() as usize;
                doubt &= doubt - 1;
                let out = &mut out[lane * width..(lane + 1) * width];
                self.evaluate_checked(&mut evaluator.checked, algorithm, &states[lane], out)
                    .map_err(|error| Fault { state: i * lanes + lane, error })?;
            }
        }
        Ok(())
    }

    /// How many numbers an algorithm gives for one state.
    #[must_use]
    pub fn width(&self, algorithm: Algorithm) -> usize {
        match algorithm {
            Algorithm::MassMatrix | Algorithm::MassMatrixInverse(_) => self.nv() * self.nv(),
            _ => self.nv(),
        }
    }

    /// Whether the arguments of a state have the lengths that an algorithm reads.
    fn fits(&self, algorithm: Algorithm, state: &Arguments<'_>) -> bool {
        let nv = self.nv();
        let (qd, u) = match algorithm {
            Algorithm::ForwardDynamics(_) | Algorithm::InverseDynamics => (nv, nv),
            Algorithm::BiasTorque => (nv, 0),
            Algorithm::MassMatrix | Algorithm::MassMatrixInverse(_) => (0, 0),
        };
        let forces = state.wrenches.len();
        (state.q.len(), state.qd.len(), state.u.len()) == (self.nq(), qd, u)
            && (forces == 0 || forces == self.model().bodies.len())
    }

    /// One state by the checked method.
    fn evaluate_checked(
        &self,
        scratch: &mut Checked,
        algorithm: Algorithm,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        let Checked { workspace, inverse } = scratch;
        let &Arguments { q, qd, u, wrenches } = state;
        match algorithm {
            Algorithm::ForwardDynamics(form) => {
                workspace.form = form;
                self.forward_dynamics(workspace, q, qd, u, wrenches, out)
            }
            Algorithm::InverseDynamics => self.inverse_dynamics(workspace, q, qd, u, wrenches, out),
            Algorithm::BiasTorque => self.bias_torque(workspace, q, qd, out),
            Algorithm::MassMatrix => self.mass_matrix(workspace, q, out),
            Algorithm::MassMatrixInverse(form) => {
                workspace.form = form;
                let scratch = inverse.get_or_insert_with(|| self.inverse_scratch());
                self.mass_matrix_inverse(workspace, scratch, q, out)
            }
        }
    }
}
