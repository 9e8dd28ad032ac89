//! Variances of as many states at once as a register has lanes, with the instructions of the arm of this process.
//!
//! The accelerations are given; gains are those of the covariance form. A lane whose pivots or results are not in order
//! is reported, and the caller recomputes that state with
//! [`forward_dynamics_variance`](super::forward_dynamics_variance).

use super::parameter_roots::ParameterRoots;
use super::variance::{
    BodyMotions, Factored, JointCovariance, TorqueVariance, VarianceScratch, Variances, base_to_tip, tip_to_base,
    torques_tip_to_base,
};
use crate::algorithm::Arguments;
use crate::batch::instruction_set::{Baseline, InstructionSet, Target, Vectorized, take_states, within_target};
use crate::batch::own_model::{self, InertiaPlaces, OwnModel};
use crate::dynamics::sweeps::{SweepModel, SweepScratch, refactor};
use crate::filter::riccati::Measured;
use crate::kinematics::Frame;
use crate::model::Model;
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
use crate::scalar::Lanes;
use crate::scene::Scene;
use crate::spatial::{RigidShift, Symmetric6};
#[cfg(target_arch = "aarch64")]
use pulp::aarch64::Neon;
#[cfg(target_arch = "x86_64")]
use pulp::x86::V3;
#[cfg(all(target_arch = "x86_64", feature = "avx512"))]
use pulp::x86::V4;
use std::sync::{Arc, Mutex, PoisonError};

/// The uncertain quantities and the requested results, the same for all states of a batch.
pub(crate) struct Question<'a> {
    /// Of accelerations, or of torques.
    pub forward: bool,
    pub parameters: &'a Arc<ParameterRoots<f64>>,
    pub torque: TorqueVariance<'a, f64>,
    /// Frames whose accelerations are wanted.
    pub frames: &'a [Frame<f64>],
}

/// Variances of some states at once.
pub(crate) trait VarianceLanes: Send {
    /// The number of states.
    fn lanes(&self) -> usize;

    /// Takes the constants of a question, before the first run and for each other question.
    fn ask(&mut self, question: &Question<'_>);

    /// Variances (nv), then the covariance (6, 6) of each frame, of each state, whose u is qdd; a bit for each state
    /// that is to be recomputed.
    fn run(&mut self, states: &[Arguments<'_>], out: &mut [f64]) -> u64;
}

/// Numbers of a call, and the roots computed from them.
type KeptRoots = (Vec<f64>, Arc<ParameterRoots<f64>>);

/// Kernels of a scene, and the roots of the last call, which the next call needs again.
#[derive(Default)]
pub(crate) struct Kept {
    roots: Mutex<Option<KeptRoots>>,
    kernels: Mutex<Vec<Box<dyn VarianceLanes>>>,
}

impl Kept {
    /// The kernels and roots that a scene keeps.
    pub fn of(scene: &Scene) -> Arc<Self> {
        scene.shared().get_or_make(Self::default)
    }

    /// The roots of the parameters `numbers`; computed with `make` unless those of the last call.
    pub fn roots<E>(
        &self,
        numbers: Vec<f64>,
        make: impl FnOnce(&[f64]) -> Result<ParameterRoots<f64>, E>,
    ) -> Result<Arc<ParameterRoots<f64>>, E> {
        let mut kept = self.roots.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, roots)) = kept.as_ref().filter(|(last, _)| *last == numbers) {
            return Ok(Arc::clone(roots));
        }
        let roots = Arc::new(make(&numbers)?);
        *kept = Some((numbers, Arc::clone(&roots)));
        Ok(roots)
    }

    /// A kernel that no call uses, with the constants of `question`, in the widest registers of this process.
    pub fn kernel(&self, scene: &Scene, question: &Question<'_>) -> Box<dyn VarianceLanes> {
        let kept = self.kernels.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut kernel = kept.unwrap_or_else(|| variance_lanes(scene));
        kernel.ask(question);
        kernel
    }

    /// Takes kernels back.
    pub fn give_back(&self, kernels: Vec<Box<dyn VarianceLanes>>) {
        self.kernels.lock().unwrap_or_else(PoisonError::into_inner).extend(kernels);
    }
}

fn variance_lanes(scene: &Scene) -> Box<dyn VarianceLanes> {
    match InstructionSet::of_process() {
        #[cfg(target_arch = "x86_64")]
        InstructionSet::Avx2 => of_target::<Lanes<V3>, V3>(scene),
        #[cfg(all(target_arch = "x86_64", feature = "avx512"))]
        InstructionSet::Avx512 => of_target::<Lanes<V4>, V4>(scene),
        #[cfg(target_arch = "aarch64")]
        InstructionSet::Neon => of_target::<Lanes<Neon>, Neon>(scene),
        _ => of_target::<f64, Baseline>(scene),
    }
}

fn of_target<T: Vectorized + Send + 'static, I: Target>(scene: &Scene) -> Box<dyn VarianceLanes> {
    match I::here() {
        Some(target) => Box::new(Kernel::<T, I>::new(scene, target)),
        None => Box::new(Kernel::<f64, Baseline>::new(scene, Baseline)),
    }
}

/// The constants in the scalar of the lanes, and scratch.
struct Kernel<T: Vectorized, I> {
    target: I,
    /// The roots that `numbers` has in the scalar of the lanes.
    given: Option<Arc<ParameterRoots<f64>>>,
    numbers: Numbers<T>,
    places: InertiaPlaces,
    own_model: Option<Box<OwnModel<T>>>,
    scratch: Scratch<T>,
}

struct Numbers<T: Vectorized> {
    model: Model<T>,
    sweeps: SweepModel<T>,
    forward: bool,
    parameters: ParameterRoots<T>,
    noise: Vec<T>,
    joints: Vec<JointCovariance<T>>,
    friction_speed: T,
    frames: Vec<(Option<usize>, RigidShift<T>)>,
}

struct Scratch<T: Vectorized> {
    variance: VarianceScratch<T>,
    q: Vec<T>,
    qd: Vec<T>,
    /// The factor of M.
    store: SweepScratch<T>,
    bodies: Vec<Symmetric6<T>>,
    results: Vec<T>,
}

impl<T: Vectorized, I> Kernel<T, I> {
    fn new(scene: &Scene, target: I) -> Self {
        let model: Model<T> = scene.model().cast();
        let nan = T::from_f64(f64::NAN);
        let sweeps = SweepModel::general(&model);
        let scratch = Scratch {
            variance: VarianceScratch::new(&model),
            q: vec![nan; model.nq],
            qd: vec![nan; model.nv()],
            store: SweepScratch::new(&model, &sweeps),
            bodies: Vec::new(),
            results: Vec::new(),
        };
        let none: [[_; 0]; 0] = [];
        let numbers = Numbers {
            model,
            sweeps,
            forward: true,
            parameters: ParameterRoots::new(none),
            noise: Vec::new(),
            joints: Vec::new(),
            friction_speed: nan,
            frames: Vec::new(),
        };
        Self { target, given: None, numbers, places: InertiaPlaces::new(scene), own_model: None, scratch }
    }
}

impl<T: Vectorized + Send, I: Target> VarianceLanes for Kernel<T, I> {
    fn lanes(&self) -> usize {
        T::LANES
    }

    fn ask(&mut self, question: &Question<'_>) {
        let Question { forward, parameters, ref torque, frames } = *question;
        let Self { given, numbers, scratch, .. } = self;
        let nan = T::from_f64(f64::NAN);
        numbers.forward = forward;
        if !given.as_ref().is_some_and(|given| Arc::ptr_eq(given, parameters)) {
            numbers.parameters = parameters.cast();
            *given = Some(Arc::clone(parameters));
        }
        let wide = |joint: &JointCovariance<f64>| joint.map(|row| row.map(T::from_f64));
        numbers.noise = torque.noise.iter().map(|&x| T::from_f64(x)).collect();
        numbers.joints = torque.joints.iter().map(wide).collect();
        numbers.friction_speed = T::from_f64(torque.friction_speed);
        numbers.frames = frames.iter().map(|frame| (frame.body, frame.placement.cast())).collect();
        let (bodies, nv) = (numbers.model.bodies.len(), numbers.model.nv());
        scratch.bodies.resize(if frames.is_empty() { 0 } else { bodies }, Symmetric6::filled(nan));
        scratch.results.resize(nv + 36 * frames.len(), nan);
    }

    fn run(&mut self, states: &[Arguments<'_>], out: &mut [f64]) -> u64 {
        if states.is_empty() || out.is_empty() {
            return 0;
        }
        let Self { target, numbers, places, own_model, scratch, .. } = self;
        let scene = (&numbers.model, &numbers.sweeps);
        match own_model::have_models(states).filter(|_| numbers.forward) {
            Some(true) => {
                let own = own_model.get_or_insert_with(|| Box::new(OwnModel::new(places, scene.0, scene.1)));
                let invalid = own_model::load(*target, own, scene, states);
                invalid | in_lanes(*target, numbers, (&own.model, &own.sweeps), scratch, states, out)
            }
            // Torques do not depend on models, and the states of a call have the same parts of them.
            _ => in_lanes(*target, numbers, scene, scratch, states, out),
        }
    }
}

within_target! {
    /// The variances of states in lanes; the lanes that need the fallback.
    #[inline(always)]
    fn in_lanes<'a, T>(
        numbers: &'a Numbers<T>,
        scene: (&'a Model<T>, &'a SweepModel<T>),
        scratch: &'a mut Scratch<T>,
        states: &'a [Arguments<'a>],
        out: &'a mut [f64],
    ) -> u64 {
        let count = states.len();
        take_states(&mut scratch.q, count, |i| states[i].q);
        take_states(&mut scratch.qd, count, |i| states[i].qd);
        take_states(&mut scratch.variance.qdd, count, |i| states[i].u);
        let Scratch { variance, q, qd, .. } = &mut *scratch;
        variance.motions.base_to_tip(&numbers.model, (q, qd, &variance.qdd));
        variances(numbers, scene, scratch);
        T::put_lanes(&scratch.results, out);
        let width = scratch.results.len();
        let mut doubt = 0;
        for (lane, out) in out.chunks_exact(width).enumerate().take(count) {
            let is_lost = |m: &Measured<T>| !(m.pivot.lane(lane) > 0.0);
            let is_bad =
                !out.iter().all(|x| x.is_finite()) || (numbers.forward && scratch.store.measured.iter().any(is_lost));
            doubt |= u64::from(is_bad) << lane;
        }
        doubt
    }
}

#[inline(always)]
fn variances<T: Vectorized>(
    numbers: &Numbers<T>,
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut Scratch<T>,
) {
    let parameters = &numbers.parameters;
    let Scratch { variance, qd, store, bodies, results, .. } = scratch;
    let (joints, of_frames) = results.split_at_mut(model.nv());
    let torque =
        TorqueVariance { noise: &numbers.noise, joints: &numbers.joints, friction_speed: numbers.friction_speed };
    let BodyMotions { shift, velocity, acceleration } = &variance.motions;
    parameters.force_covariances(velocity, acceleration, &mut variance.own);
    if !numbers.forward {
        torque.evaluate(qd, &variance.qdd, joints);
        torques_tip_to_base(model, shift, &mut variance.own, joints);
        return;
    }
    torque.evaluate(qd, &variance.qdd, &mut variance.torque);
    // The pass of the factor reads phi from its store; the next state computes phi anew.
    std::mem::swap(&mut store.shifts, &mut variance.motions.shift);
    refactor((model, sweeps), store);
    let factor = Factored { shift: &store.shifts, measured: &store.measured };
    tip_to_base(model, factor, variance);
    base_to_tip(model, factor, variance, &mut Variances { joints, bodies });
    for (out, (body, placement)) in of_frames.chunks_exact_mut(36).zip(&numbers.frames) {
        let covariance = match *body {
            Some(body) => placement.co_covariance_to_child(&bodies[body]),
            None => Symmetric6::zero(),
        };
        for (i, column) in out.chunks_exact_mut(6).enumerate() {
            column.copy_from_slice(covariance.column(i).as_slice());
        }
    }
}
