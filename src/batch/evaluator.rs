//! Evaluation of states by the fastest kernels of this processor: one state at a time, or in lanes.

use super::Fault;
use super::compiled;
use super::coupled::CoupledEvaluator;
use super::instruction_set::InstructionSet;
use crate::accuracy::{Accuracy, largest};
use crate::algorithm::{Algorithm, Arguments, Chunks, KinematicQuantity};
use crate::dynamics::mass_inverse::InverseScratch;
use crate::error::{Error, check_length};
use crate::filter::Form;
use crate::filter::tolerance::Tolerance;
use crate::scene::Scene;
use crate::workspace::Workspace;

/// Scratch for the algorithms of one scene on one thread: for one state, and for the number of states that fit in a
/// register.
///
/// The bits of a result do not depend on the lane or on the other lanes, except for the sign of a zero.
pub struct Evaluator {
    arm: InstructionSet,
    /// Identity of the scene.
    identity: u64,
    pub(super) kernels: Kernels,
    pub(super) checked: Checked,
    /// Evaluator of the tree for scenes with mimic joints; there are no other kernels then.
    pub(super) coupled: Option<Box<CoupledEvaluator>>,
}

/// The compiled kernels of one instruction set. States without a kernel are computed by the checked recursion.
pub struct Kernels {
    /// For one state.
    one: Option<Box<dyn Chunks>>,
    /// For one state per lane.
    many: Option<Box<dyn Chunks>>,
}

/// Scratch of the fallback.
pub(super) struct Checked {
    pub(super) workspace: Workspace<f64>,
    inverse: Option<InverseScratch<f64>>,
}

impl Checked {
    /// The accuracy of accelerations that the kernels accepted with this tolerance and this estimated error.
    fn accepted(&self, error: f64, given: Option<f64>, qdd: &[f64]) -> Accuracy {
        let tolerance = Tolerance { given, ..self.workspace.accepted_error() }.of_covariance(f64::EPSILON);
        Accuracy { error, ..Accuracy::unknown(Form::Covariance) }.judged(tolerance, largest(qdd), true)
    }
}

impl std::fmt::Debug for Evaluator {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Evaluator").field("arm", &self.arm).field("lanes", &self.lanes()).finish_non_exhaustive()
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
        let workspace = Workspace::new(scene.model());
        let checked = Checked { workspace, inverse: None };
        let coupled = CoupledEvaluator::of(arm, scene);
        let kernels = if coupled.is_some() { Kernels { one: None, many: None } } else { Kernels::new(arm, scene) };
        Self { arm, identity: scene.identity(), kernels, checked, coupled }
    }

    /// The instruction set of the kernels.
    #[must_use]
    pub fn instruction_set(&self) -> InstructionSet {
        self.arm
    }

    /// The largest number of states per call of a kernel.
    #[must_use]
    pub fn lanes(&self) -> usize {
        match &self.coupled {
            Some(coupled) => coupled.tied.lanes(),
            None => self.kernels.many.as_ref().map_or(1, |many| many.lanes()),
        }
    }

    /// Runs the kernel alone on one state, or on at most one state per lane. All states must have equal shapes; lengths
    /// are not checked. Writes the results one after another to `out`. Returns the states that need the fallback as
    /// bits; [`Scene::evaluate`] recomputes them.
    #[doc(hidden)]
    pub fn run(&mut self, algorithm: Algorithm, states: &[Arguments<'_>], out: &mut [f64]) -> u64 {
        self.kernels.run(algorithm, states, out)
    }
}

impl Kernels {
    /// The kernels of an instruction set that this processor has.
    pub(crate) fn new(arm: InstructionSet, scene: &Scene) -> Self {
        let one = match arm {
            InstructionSet::Baseline => compiled::plain::kernels(scene),
            #[cfg(all(target_arch = "x86_64", feature = "avx512"))]
            InstructionSet::Avx512 => compiled::fused_avx512::kernels(scene),
            #[cfg(all(feature = "lanes", any(target_arch = "x86_64", target_arch = "aarch64")))]
            InstructionSet::Avx2 | InstructionSet::Neon => compiled::fused::kernels(scene),
            // Not compiled, and therefore never selected.
            #[allow(unreachable_patterns)]
            _ => None,
        };
        let many = match arm {
            #[cfg(all(target_arch = "x86_64", feature = "lanes"))]
            InstructionSet::Avx2 => compiled::avx2::kernels(scene),
            #[cfg(all(target_arch = "x86_64", feature = "avx512"))]
            InstructionSet::Avx512 => compiled::avx512::kernels(scene),
            #[cfg(all(target_arch = "aarch64", feature = "lanes"))]
            InstructionSet::Neon => compiled::neon::kernels(scene),
            _ => None,
        };
        Self { one, many }
    }

    /// The kernels for this number of states.
    #[inline]
    fn of(&mut self, states: usize) -> Option<&mut Box<dyn Chunks>> {
        if states == 1 || self.many.is_none() { self.one.as_mut().or(self.many.as_mut()) } else { self.many.as_mut() }
    }

    /// As [`Evaluator::run`].
    pub(super) fn run(&mut self, algorithm: Algorithm, states: &[Arguments<'_>], out: &mut [f64]) -> u64 {
        self.of(states.len()).map_or(u64::MAX, |kernels| kernels.run(algorithm, states, out))
    }

    /// As [`Self::run`], for a kinematic quantity.
    fn kinematic_quantity(&mut self, what: &KinematicQuantity<'_>, states: &[Arguments<'_>], out: &mut [f64]) -> u64 {
        self.of(states.len()).map_or(u64::MAX, |kernels| kernels.kinematic_quantity(what, states, out))
    }

    /// The kernels for a single state, without the scratch of the others.
    pub(crate) fn for_one_state(self) -> Option<Box<dyn Chunks>> {
        self.one.or(self.many)
    }

    /// The estimated error of one lane, after a run of this number of states in form `auto`.
    #[inline]
    fn error(&self, states: usize, lane: usize) -> f64 {
        let kernels = match (&self.one, &self.many) {
            (Some(one), _) if states == 1 => Some(one),
            (one, many) => many.as_ref().or(one.as_ref()),
        };
        kernels.map_or(f64::NAN, |kernels| kernels.error(lane))
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
        if let (Some(coupling), Some(coupled)) = (self.coupling(), &mut evaluator.coupled) {
            let mut found = |state: usize, accuracy: Accuracy| found(state, &|| accuracy);
            return coupled.evaluate((self, coupling), algorithm, states, out, &mut found);
        }
        let required = self.requirements(algorithm);
        if let [state] = states {
            // A single state skips the divisions and loops for many states.
            if required.met_by(state) && evaluator.run(algorithm, states, out) & 1 == 0 {
                found(0, &|| evaluator.checked.accepted(evaluator.kernels.error(1, 0), state.tolerance, out));
                return Ok(());
            }
            self.evaluate_checked(&mut evaluator.checked, algorithm, state, out)
                .map_err(|error| Fault { state: 0, error })?;
            found(0, &|| evaluator.checked.workspace.accuracy);
            return Ok(());
        }
        let lanes = evaluator.lanes();
        for (i, (states, out)) in states.chunks(lanes).zip(out.chunks_mut((width * lanes).max(1))).enumerate() {
            let fits = states.iter().all(|state| required.met_by(state));
            let mut doubt = if fits { evaluator.run(algorithm, states, out) } else { u64::MAX };
            doubt &= u64::MAX >> (64 - states.len());
            for lane in (0..states.len()).filter(|lane| doubt >> lane & 1 == 0) {
                let (error, qdd) = (|| evaluator.kernels.error(states.len(), lane), &out[lane * width..][..width]);
                found(i * lanes + lane, &|| evaluator.checked.accepted(error(), states[lane].tolerance, qdd));
            }
            while doubt != 0 {
                let lane = doubt.trailing_zeros() as usize;
                doubt &= doubt - 1;
                // The fallback takes up to a thousand times longer.
                crate::interrupt::check().map_err(|error| Fault { state: i * lanes + lane, error })?;
                let out = &mut out[lane * width..(lane + 1) * width];
                self.evaluate_checked(&mut evaluator.checked, algorithm, &states[lane], out)
                    .map_err(|error| Fault { state: i * lanes + lane, error })?;
                found(i * lanes + lane, &|| evaluator.checked.workspace.accuracy);
            }
        }
        Ok(())
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
        if what.is_by_coordinates() {
            self.check_independent().map_err(|error| Fault { state: 0, error })?;
        }
        if let (Some(coupling), Some(coupled)) = (self.coupling(), &mut evaluator.coupled) {
            return coupled.kinematic_quantity((self, coupling), what, states, out);
        }
        let lanes = evaluator.lanes();
        let (width, nv) = (what.width(self.nv()), self.nv());
        check_length("out", out.len(), width * states.len()).map_err(|error| Fault { state: 0, error })?;
        let Evaluator { kernels, checked, .. } = evaluator;
        let (reads, lengths) = (what.reads(), [self.nq(), nv, nv]);
        let mut run = |first: usize, states: &[Arguments<'_>], out: &mut [f64]| {
            let fits = |state: &Arguments<'_>| {
                let given = [state.q.len(), state.qd.len(), state.u.len()];
                let model = &state.model;
                (0..3).all(|k| given[k] == if k < reads { lengths[k] } else { 0 })
                    && (model.is_of_scene() || self.requirements(Algorithm::BiasTorque).fits(model))
            };
            let doubt = if states.iter().all(fits) { kernels.kinematic_quantity(what, states, out) } else { u64::MAX };
            for lane in (0..states.len()).filter(|lane| doubt >> lane & 1 == 1) {
                let (state, out) = (&states[lane], &mut out[lane * width..(lane + 1) * width]);
                self.quantity_of_model(&mut checked.workspace, what, state, out)
                    .map_err(|error| Fault { state: first + lane, error })?;
            }
            Ok(())
        };
        if states.len() == 1 && width > 0 {
            // A single state skips the divisions for many states.
            return run(0, states, out);
        }
        for (i, (states, out)) in states.chunks(lanes).zip(out.chunks_mut((width * lanes).max(1))).enumerate() {
            run(i * lanes, states, out)?;
        }
        Ok(())
    }

    /// Checks that an evaluator was created for this scene: other evaluators have the constants of other scenes.
    fn check_evaluator(&self, evaluator: &Evaluator) -> Result<(), Fault> {
        if evaluator.identity == self.identity() {
            return Ok(());
        }
        let expected = "this scene's own, from scene.evaluator() or Evaluator::on(arm, &scene)";
        Err(Fault { state: 0, error: Error::argument("evaluator", "that of another scene", expected) })
    }

    /// One state by the checked recursion.
    #[cold]
    pub(super) fn evaluate_checked(
        &self,
        scratch: &mut Checked,
        algorithm: Algorithm,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        if matches!(algorithm, Algorithm::MassMatrixInverse(_)) {
            scratch.inverse.get_or_insert_with(|| self.inverse_scratch());
        }
        self.recursion(&mut scratch.workspace, scratch.inverse.as_mut(), algorithm, state, out)
    }
}
