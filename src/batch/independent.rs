//! Evaluation of states of a scene with independent joints by the fastest kernels of this processor: one state at a
//! time, or in lanes.

use super::Fault;
use super::compiled;
use super::instruction_set::InstructionSet;
use crate::accuracy::{Accuracy, largest};
use crate::algorithm::{Algorithm, Arguments, Chunks, KinematicQuantity};
use crate::dynamics::mass_inverse::InverseScratch;
use crate::error::{Error, check_length};
use crate::filter::Form;
use crate::filter::tolerance::Tolerance;
use crate::scene::Scene;
use crate::workspace::Workspace;

/// The kernels of one scene on one thread, and the scratch of their fallback.
pub(super) struct Independent {
    pub arm: InstructionSet,
    kernels: Kernels,
    pub checked: Checked,
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
    pub workspace: Workspace<f64>,
    inverse: Option<InverseScratch<f64>>,
}

impl Checked {
    /// The accuracy of accelerations that the kernels accepted with this tolerance and this estimated error.
    fn accepted(&self, error: f64, given: Option<f64>, qdd: &[f64]) -> Accuracy {
        let tolerance = Tolerance { given, ..self.workspace.accepted_error() }.of_covariance(f64::EPSILON);
        Accuracy { error, ..Accuracy::unknown(Form::Covariance) }.judged(tolerance, largest(qdd), true)
    }
}

impl Independent {
    /// For an instruction set that this processor has.
    pub fn new(arm: InstructionSet, scene: &Scene) -> Self {
        let checked = Checked { workspace: Workspace::new(scene.model()), inverse: None };
        Self { arm, kernels: Kernels::new(arm, scene), checked }
    }

    /// The largest number of states per call of a kernel.
    pub fn lanes(&self) -> usize {
        self.kernels.many.as_ref().map_or(1, |many| many.lanes())
    }

    /// As [`Evaluator::run`](super::Evaluator::run).
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

    /// As [`Independent::run`].
    fn run(&mut self, algorithm: Algorithm, states: &[Arguments<'_>], out: &mut [f64]) -> u64 {
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
    /// As [`Scene::evaluate_each`], for a scene with independent joints, of whose results the shape is checked.
    #[inline]
    pub(super) fn evaluate_independent(
        &self,
        evaluator: &mut Independent,
        algorithm: Algorithm,
        (states, width): (&[Arguments<'_>], usize),
        out: &mut [f64],
        mut found: impl FnMut(usize, &dyn Fn() -> Accuracy),
    ) -> Result<(), Fault> {
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

    /// As [`Scene::evaluate_kinematic_quantity`], for a scene with independent joints.
    pub(super) fn quantity_independent(
        &self,
        evaluator: &mut Independent,
        what: &KinematicQuantity<'_>,
        states: &[Arguments<'_>],
        out: &mut [f64],
    ) -> Result<(), Fault> {
        let lanes = evaluator.lanes();
        let (width, nv) = (what.width(self.nv()), self.nv());
        check_length("out", out.len(), width * states.len()).map_err(|error| Fault { state: 0, error })?;
        let Independent { kernels, checked, .. } = evaluator;
        // Quantities of frames do not depend on models.
        let (reads, lengths, is_of_frame) = (what.reads(), [self.nq(), nv, nv], what.frame().is_some());
        let mut run = |first: usize, states: &[Arguments<'_>], out: &mut [f64]| {
            let fits = |state: &Arguments<'_>| {
                let given = [state.q.len(), state.qd.len(), state.u.len()];
                let model = &state.model;
                (0..3).all(|k| given[k] == if k < reads { lengths[k] } else { 0 })
                    && (is_of_frame || model.is_of_scene() || self.requirements(Algorithm::BiasTorque).fits(model))
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
