//! Evaluation of states by the fastest kernels of this processor: one state at a time, or in lanes.

use super::Fault;
use super::independent::Independent;
use super::instruction_set::InstructionSet;
use crate::accuracy::Accuracy;
use crate::algorithm::{Algorithm, Arguments, KinematicQuantity};
use crate::error::Error;
use crate::scene::{Coupling, Scene};

/// Scratch for the algorithms of one scene on one thread: for one state, and for the number of states that fit in a
/// register.
///
/// The bits of a result do not depend on the lane or on the other lanes, except for the sign of a zero.
pub struct Evaluator {
    /// Identity of the scene.
    identity: u64,
    /// With mimic joints, the kernels of the tree with its rows.
    pub(super) independent: Independent,
    /// With mimic joints, those without gravity, created at first use.
    weightless: Option<Box<Independent>>,
}

impl std::fmt::Debug for Evaluator {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Evaluator")
            .field("arm", &self.instruction_set())
            .field("lanes", &self.lanes())
            .finish_non_exhaustive()
    }
}

impl Evaluator {
    /// Scratch for `scene` with the instruction set of this process.
    #[must_use]
    pub fn new(scene: &Scene) -> Self {
        Self::on(InstructionSet::of_process(), scene)
    }

    /// Scratch for a given instruction set, or for the baseline if this processor does not have it.
    #[must_use]
    pub fn on(arm: InstructionSet, scene: &Scene) -> Self {
        let arm = if arm.available() { arm } else { InstructionSet::Baseline };
        let independent = Independent::new(arm, scene.coupling().map_or(scene, Coupling::tied));
        Self { identity: scene.identity(), independent, weightless: None }
    }

    /// The instruction set of the kernels.
    #[must_use]
    pub fn instruction_set(&self) -> InstructionSet {
        self.independent.arm
    }

    /// The largest number of states per call of a kernel.
    #[must_use]
    pub fn lanes(&self) -> usize {
        self.independent.lanes()
    }

    /// Runs the kernel alone on one state, or on at most one state per lane. All states must have equal shapes; lengths
    /// are not checked. Writes the results one after another to `out`. Returns the states that need the fallback as
    /// bits; [`Scene::evaluate`] recomputes them.
    #[doc(hidden)]
    pub fn run(&mut self, algorithm: Algorithm, states: &[Arguments<'_>], out: &mut [f64]) -> u64 {
        self.independent.run(algorithm, states, out)
    }
}

impl Scene {
    /// Scratch for [`Scene::evaluate`]; one for each thread.
    #[must_use]
    pub fn evaluator(&self) -> Evaluator {
        Evaluator::new(self)
    }

    /// Runs one algorithm on any number of states. Writes the results one after another to `out`, with equal lengths.
    ///
    /// States are vectorized (SIMD) over the lanes of a register. A state whose arguments, pivots or error estimate
    /// fail a check is recomputed by the checked recursion ([`Scene::recursion`]) in the requested form.
    ///
    /// # Errors
    ///
    /// [`Fault`] of the lowest state that failed, with the error of the recursion; `out` is then partly written.
    /// [`Error::Argument`] for the evaluator of another scene.
    pub fn evaluate(
        &self,
        evaluator: &mut Evaluator,
        algorithm: Algorithm,
        states: &[Arguments<'_>],
        out: &mut [f64],
    ) -> Result<(), Fault> {
        self.evaluate_each(evaluator, algorithm, states, out, |_, _: &dyn Fn() -> Accuracy| {})
    }

    /// As [`Scene::evaluate`]. In form `auto`, `found` is called with the index of each state and a function that
    /// computes its accuracy. The accuracy is computed only if that function is called.
    #[inline]
    pub(super) fn evaluate_each(
        &self,
        evaluator: &mut Evaluator,
        algorithm: Algorithm,
        states: &[Arguments<'_>],
        out: &mut [f64],
        mut found: impl FnMut(usize, &dyn Fn() -> Accuracy),
    ) -> Result<(), Fault> {
        self.check_evaluator(evaluator)?;
        let width = self.width(algorithm);
        if out.len() != width * states.len() {
            let expected = format!("{width} numbers for each of {} states", states.len());
            return Err(Fault { state: 0, error: Error::shape("out", format!("({},)", out.len()), expected) });
        }
        for (state, arguments) in states.iter().enumerate().filter(|(_, state)| state.tolerance.is_some()) {
            self.check_tolerance(algorithm, arguments.tolerance).map_err(|error| Fault { state, error })?;
        }
        let Evaluator { independent, weightless, .. } = evaluator;
        let Some(coupling) = self.coupling() else {
            return self.evaluate_independent(independent, algorithm, (states, width), out, found);
        };
        let mut found = |state: usize, accuracy: Accuracy| found(state, &|| accuracy);
        self.evaluate_on_tied(coupling, (independent, weightless), algorithm, states, out, &mut found)
    }

    /// Computes a kinematic quantity of any number of states, with u = qdd. Writes the results one after another to
    /// `out`, with equal lengths.
    ///
    /// States are vectorized (SIMD) over the lanes of a register. A state whose arguments or results fail a check is
    /// recomputed by the method for one state ([`Scene::kinematic_quantity`]).
    ///
    /// # Errors
    ///
    /// [`Fault`] of the lowest state that failed, with the error of that method; `out` is then partly written.
    /// [`Error::Argument`] for the evaluator of another scene.
    pub fn evaluate_kinematic_quantity(
        &self,
        evaluator: &mut Evaluator,
        what: &KinematicQuantity<'_>,
        states: &[Arguments<'_>],
        out: &mut [f64],
    ) -> Result<(), Fault> {
        self.check_evaluator(evaluator)?;
        if let Some(frame) = what.frame() {
            self.check_frame(frame).map_err(|error| Fault { state: 0, error })?;
        }
        match self.coupling() {
            Some(coupling) => self.quantity_on_tied(coupling, &mut evaluator.independent, what, states, out),
            None => self.quantity_independent(&mut evaluator.independent, what, states, out),
        }
    }

    /// Checks that an evaluator was created for this scene: other evaluators have the constants of other scenes.
    fn check_evaluator(&self, evaluator: &Evaluator) -> Result<(), Fault> {
        if evaluator.identity == self.identity() {
            return Ok(());
        }
        let expected = "this scene's own, from scene.evaluator() or Evaluator::on(arm, &scene)";
        Err(Fault { state: 0, error: Error::argument("evaluator", "that of another scene", expected) })
    }
}
