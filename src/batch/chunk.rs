//! A few states at once, one in each lane of a scalar, through one algorithm compiled for one arm.
//!
//! Kernels raise no errors: they return the lanes whose arguments, pivots, precision or results fail a check, and the
//! caller recomputes those states with every check (see [`Evaluator`](super::evaluator::Evaluator)).

use super::accelerations::{self, KernelCall};
use super::connected::{self, ConnectedKernel};
#[cfg(feature = "derivatives")]
use super::derivatives::{self, DerivativeKernel};
use super::factor;
use super::finite::{any_not_finite, not_finite};
use super::instruction_set::{Entry, Target, Vectorized, Work, in_lanes, within_target};
use super::own_model::{self, InertiaPlaces, OwnModel};
#[cfg(feature = "derivatives")]
use super::products::{self, ProductKernel};
use super::quantities::{self, QuantityKernel};
#[cfg(feature = "derivatives")]
use crate::algorithm::Derivatives;
use crate::algorithm::{Algorithm, Arguments, KinematicQuantity};
use crate::dynamics::auto::Errors;
#[cfg(feature = "derivatives")]
use crate::dynamics::derivatives::with_transpose;
use crate::dynamics::sweeps::{self, Entries, InverseColumns, MassColumns, SweepModel, SweepScratch};
use crate::filter::Form;
use crate::filter::rounding::ROUNDING_MARGIN;
use crate::joints::quaternion::QUATERNION_SLACK;
use crate::model::Model;
use crate::scalar::{MOST_LANES, Real, lanes_but};
use crate::scene::Scene;
use crate::scene::constraint::Constraints;
use nalgebra::Vector6;
use std::sync::Arc;

/// False without the feature `lanes`: the square-root form and kinematic quantities then have no kernels, which would
/// take a tenth of the compile time, and every state is computed by the fallback.
const HAS_ALL_KERNELS: bool = cfg!(feature = "lanes");

/// The constants of a scene in the scalar of the lanes, one for all threads.
#[derive(Debug)]
struct Numbers<T: Vectorized> {
    model: Model<T>,
    sweeps: SweepModel<T>,
    /// The indices of the quaternions in q.
    quaternions: Vec<usize>,
    constraints: Constraints,
    places: InertiaPlaces,
}

/// Scratch for one state per lane of `T`.
#[derive(Debug)]
pub struct Chunk<T: Vectorized> {
    numbers: Arc<Numbers<T>>,
    sweep_scratch: SweepScratch<T>,
    inverse_columns: InverseColumns<T, T::Columns>,
    mass_columns: MassColumns<T, T::Columns>,
    arguments: [Vec<T>; 3],
    wrenches: Vec<Vector6<T>>,
    results: Vec<T>,
    /// The error estimates of form `auto`.
    errors: Errors<T>,
    /// True if every lane accepts the default error, and a bit mask of the lanes whose tolerance is below the error
    /// that the first bound of the square-root form guarantees.
    accepts_usual: bool,
    strict: u64,
    #[cfg(feature = "derivatives")]
    derivatives: Option<Box<DerivativeKernel<T>>>,
    #[cfg(feature = "derivatives")]
    products: Option<Box<ProductKernel<T>>>,
    connected: Option<Box<ConnectedKernel<T>>>,
    quantities: Option<Box<QuantityKernel<T>>>,
    /// The models of the states, and whether the states of this run have their own.
    own_model: Option<Box<OwnModel<T>>>,
    has_own_model: bool,
}

impl<T: Vectorized> Chunk<T> {
    /// Scratch for a scene, with its constants rounded to the precision of the lanes.
    #[must_use]
    pub fn new(scene: &Scene) -> Self {
        let numbers = scene.shared().get_or_make(|| {
            let model = scene.model();
            Numbers::<T> {
                model: model.cast(),
                sweeps: SweepModel::new(model),
                quaternions: model.quaternions(),
                constraints: scene.constraints().clone(),
                places: InertiaPlaces::new(scene),
            }
        });
        let Numbers { model, sweeps, .. } = &*numbers;
        Self {
            sweep_scratch: SweepScratch::new(model, sweeps),
            inverse_columns: InverseColumns::new(),
            mass_columns: MassColumns::new(),
            arguments: [vec![T::zero(); model.nq], vec![T::zero(); model.nv()], vec![T::zero(); model.nv()]],
            wrenches: Vec::new(),
            results: Vec::new(),
            errors: Errors::unknown(),
            accepts_usual: true,
            strict: 0,
            #[cfg(feature = "derivatives")]
            derivatives: None,
            #[cfg(feature = "derivatives")]
            products: None,
            connected: None,
            quantities: None,
            own_model: None,
            has_own_model: false,
            numbers,
        }
    }

    /// As [`Chunks::lanes`](crate::algorithm::Chunks::lanes).
    #[must_use]
    pub fn lanes() -> usize {
        T::LANES
    }

    /// As [`Chunks::error`](crate::algorithm::Chunks::error).
    #[must_use]
    pub fn error(&self, lane: usize) -> f64 {
        self.errors.of(lane)
    }

    /// As [`Chunks::run`](crate::algorithm::Chunks::run), for these instructions; all of it is inlined into the caller.
    #[inline(always)]
    pub fn run<I: Target>(
        &mut self,
        target: I,
        algorithm: Algorithm,
        states: &[Arguments<'_>],
        out: &mut [f64],
    ) -> u64 {
        if states.is_empty() || out.is_empty() {
            return 0;
        }
        self.gather_wrenches(states);
        self.accept(states);
        let invalid = match self.take_models(target, states) {
            _ if !self.has_own_model => 0,
            // The roots of inertias are the scene's.
            _ if algorithm.form() == Some(Form::SquareRoot) => return u64::MAX,
            invalid => invalid,
        };
        let is_connected = !self.numbers.constraints.is_empty();
        let call = ChunkArguments { chunk: self, algorithm, states, out };
        invalid
            | match algorithm {
                Algorithm::ForwardDynamics(_) | Algorithm::ConstrainedDynamics(_) if is_connected => {
                    target.within(Run::<T, I, CONNECTED>(call, target))
                }
                Algorithm::ForwardDynamics(_) => target.within(Run::<T, I, ACCELERATIONS>(call, target)),
                Algorithm::InverseDynamics | Algorithm::BiasTorque => target.within(Run::<T, I, TORQUES>(call, target)),
                Algorithm::MassMatrix => target.within(Run::<T, I, MASS>(call, target)),
                Algorithm::MassMatrixInverse(_) => target.within(Run::<T, I, INVERSE>(call, target)),
                #[cfg(feature = "derivatives")]
                Algorithm::Derivatives(_) => target.within(Run::<T, I, DERIVATIVES>(call, target)),
                #[cfg(feature = "derivatives")]
                Algorithm::Products(_) => target.within(Run::<T, I, PRODUCTS>(call, target)),
                _ => u64::MAX,
            }
    }

    /// As [`Chunks::kinematic_quantity`](crate::algorithm::Chunks::kinematic_quantity), for these instructions.
    #[inline(always)]
    pub fn kinematic_quantity<I: Target>(
        &mut self,
        target: I,
        what: &KinematicQuantity<'_>,
        states: &[Arguments<'_>],
        out: &mut [f64],
    ) -> u64 {
        if HAS_ALL_KERNELS {
            return quantity_in_lanes(target, self, what, states, out);
        }
        u64::MAX
    }

    /// Writes the tolerance of each state to its lane. Most calls have the default tolerance, like the previous call.
    fn accept(&mut self, states: &[Arguments<'_>]) {
        self.strict = 0;
        let is_usual = states.iter().all(|state| state.tolerance.is_none());
        if is_usual && self.accepts_usual {
            return;
        }
        self.accepts_usual = is_usual;
        let scratch = &mut self.sweep_scratch;
        for lane in 0..T::LANES {
            let tolerance = states[lane.min(states.len() - 1)].tolerance;
            let [square, of_products] = scratch.accepted(tolerance);
            scratch.accepted_square.lanes_mut()[lane] = square;
            scratch.accepted_of_products.lanes_mut()[lane] = of_products;
            let is_strict = tolerance.is_some_and(|given| given < ROUNDING_MARGIN * f64::EPSILON);
            self.strict |= u64::from(is_strict) << lane;
        }
    }

    /// Loads the models of the states, if they have their own; returns the lanes whose numbers are invalid.
    #[inline]
    fn take_models<I: Target>(&mut self, target: I, states: &[Arguments<'_>]) -> u64 {
        let have_models = own_model::have_models(states);
        self.has_own_model = have_models != Some(false);
        match have_models {
            None => return u64::MAX,
            Some(false) => return 0,
            Some(true) => {}
        }
        let Numbers { model, sweeps, places, .. } = &*self.numbers;
        let own = self.own_model.get_or_insert_with(|| Box::new(OwnModel::new(places, model, sweeps)));
        own_model::load(target, own, (model, sweeps), states)
    }

    /// Gathers forces on bodies into lanes; empty if no state has any.
    fn gather_wrenches(&mut self, states: &[Arguments<'_>]) {
        self.wrenches.clear();
        if states.iter().all(|state| state.wrenches.is_empty()) {
            return;
        }
        self.wrenches.resize(self.numbers.model.bodies.len(), Vector6::from_element(T::zero()));
        for lane in 0..T::LANES {
            let state = &states[lane.min(states.len() - 1)];
            for (force, given) in self.wrenches.iter_mut().zip(state.wrenches) {
                for (number, &value) in force.iter_mut().zip(given) {
                    number.lanes_mut()[lane] = value;
                }
            }
        }
    }
}

/// Minus the largest deviation of the norm of a quaternion, or NaN.
#[inline(always)]
pub(super) fn nearness<T: Real>(quaternions: &[usize], q: &[T]) -> T {
    let mut nearness = T::zero();
    for &at in quaternions {
        let [x, y, z, w] = [q[at], q[at + 1], q[at + 2], q[at + 3]];
        let off = x.mul_add(x, y.mul_add(y, z.mul_add(z, w * w))) - T::one();
        nearness = nearness.worst(-off.abs());
    }
    nearness
}

/// True if a norm may deviate by more than the tolerance: the bound is on its square, so that half of it passes here.
#[inline(always)]
pub(super) fn is_far<T: Real>(nearness: T, lane: usize) -> bool {
    !(nearness.lane(lane) >= -QUATERNION_SLACK)
}

/// From this number of scalars per state, the scalars are copied before they are checked.
const LONG: usize = 32;

/// Gathers one argument of every state into lanes. Returns zero if all values are finite, otherwise NaN.
#[inline(always)]
fn gather<'a, T: Vectorized>(
    numbers: &mut [T],
    states: &[&'a Arguments<'_>; MOST_LANES],
    of: impl Fn(&'a Arguments<'_>) -> &'a [f64],
) -> T {
    if T::LANES == 1 && numbers.len() < LONG {
        // Checked during the copy, four values at a time.
        let mut faults = [T::zero(); 4];
        let (fours, rest) = numbers.as_chunks_mut::<4>();
        let (values, rest_of_values) = of(states[0]).as_chunks::<4>();
        for (four, values) in fours.iter_mut().zip(values) {
            for i in 0..4 {
                four[i].lanes_mut()[0] = values[i];
                faults[i] += not_finite(four[i]);
            }
        }
        for ((number, &value), fault) in rest.iter_mut().zip(rest_of_values).zip(&mut faults) {
            number.lanes_mut()[0] = value;
            *fault += not_finite(*number);
        }
        return (faults[0] + faults[1]) + (faults[2] + faults[3]);
    }
    T::take_lanes(numbers, |lane| of(states[lane]))
}

/// Gathers q, qd and u of every state into lanes. Returns zero if all values are finite, otherwise NaN.
#[inline(always)]
fn gather_state<T: Vectorized>([q, qd, u]: [&mut [T]; 3], states: &[&Arguments<'_>; MOST_LANES]) -> T {
    let mut fault = gather(q, states, |state| state.q);
    fault += gather(qd, states, |state| state.qd);
    fault += gather(u, states, |state| state.u);
    fault
}

/// Gathers the vectors of the seed of every state into lanes. Returns zero if all values are finite, otherwise NaN.
#[cfg(feature = "derivatives")]
#[inline(always)]
fn gather_seeds<T: Vectorized>(seeds: &mut [Vec<T>; 3], states: &[&Arguments<'_>; MOST_LANES]) -> T {
    let mut fault = T::zero();
    for (i, seed) in seeds.iter_mut().enumerate() {
        if !states[0].seed[i].is_empty() {
            seed.resize(states[0].seed[i].len(), T::zero());
            fault += gather(seed, states, |state| state.seed[i]);
        }
    }
    fault
}

/// The lanes with a quaternion that is not normalized, or with a value that is not finite.
#[inline(always)]
fn doubtful<T: Real>(states: usize, nearness: T, fault: T) -> u64 {
    let mut doubt = 0;
    for lane in 0..states {
        doubt |= u64::from(is_far(nearness, lane) || fault.lane(lane) != 0.0) << lane;
    }
    doubt
}

// Groups of algorithms, each compiled into one function: in a single function M^-1 executes a fifth more instructions.

/// Forward dynamics.
const ACCELERATIONS: u8 = 0;
/// Inverse dynamics and the bias.
const TORQUES: u8 = 1;
/// M.
const MASS: u8 = 2;
/// M^-1.
const INVERSE: u8 = 3;
/// Derivatives of forward and inverse dynamics, and the Coriolis matrix.
#[cfg(feature = "derivatives")]
const DERIVATIVES: u8 = 4;
/// Products with Jacobians.
#[cfg(feature = "derivatives")]
const PRODUCTS: u8 = 5;
/// Forward dynamics through connections.
const CONNECTED: u8 = 6;

/// A chunk with its arguments.
struct ChunkArguments<'a, T: Vectorized> {
    chunk: &'a mut Chunk<T>,
    algorithm: Algorithm,
    states: &'a [Arguments<'a>],
    out: &'a mut [f64],
}

/// A chunk to be run on an instruction set; the algorithm belongs to GROUP.
struct Run<'a, T: Vectorized, I: Target, const GROUP: u8>(ChunkArguments<'a, T>, I);

impl<T: Vectorized, I: Target, const GROUP: u8> Work for Run<'_, T, I, GROUP> {
    type Output = u64;

    #[inline(always)]
    fn call(self) -> u64 {
        let Self(ChunkArguments { chunk, algorithm, states, out }, target) = self;
        let Chunk {
            numbers: constants,
            sweep_scratch,
            inverse_columns,
            mass_columns,
            arguments,
            wrenches,
            results,
            errors,
            #[cfg(feature = "derivatives")]
            derivatives,
            #[cfg(feature = "derivatives")]
            products,
            connected,
            strict,
            own_model,
            has_own_model,
            ..
        } = chunk;
        let Numbers { model, sweeps, quaternions, constraints, .. } = &**constants;
        let (model, sweeps) = match own_model {
            Some(own) if *has_own_model => (&own.model, &own.sweeps),
            _ => (model, sweeps),
        };
        let [q, qd, u] = arguments;
        let given = in_lanes(states);
        let mut fault = gather_state([&mut *q, qd, u], &given);
        let nearness = nearness(quaternions, q);
        for force in wrenches.iter() {
            for &number in force.iter() {
                fault += not_finite(number);
            }
        }
        let scene = (model, sweeps);
        let mut doubt = doubtful(states.len(), nearness, fault);
        #[cfg(feature = "derivatives")]
        if let (Algorithm::Derivatives(which), true) = (algorithm, GROUP == DERIVATIVES) {
            let new = || Box::new(DerivativeKernel::new(scene, constraints));
            let (kernel, scratch) = (&mut **derivatives.get_or_insert_with(new), sweep_scratch);
            let call = KernelCall { scene, scratch, kernel, state: (q, qd, u), wrenches, out: &mut *out };
            doubt |= derivatives::run(target, which, call, inverse_columns);
            if which == Derivatives::MassMatrix {
                for matrix in out.chunks_exact_mut(model.nv() * model.nv()) {
                    with_transpose(model.nv(), matrix, |a, b| a + b);
                }
            }
            return doubt;
        }
        #[cfg(feature = "derivatives")]
        if let (Algorithm::Products(which), true) = (algorithm, GROUP == PRODUCTS) {
            let kernel = &mut **products.get_or_insert_with(|| Box::new(ProductKernel::new(scene, constraints)));
            let fault = gather_seeds(&mut kernel.seeds, &given);
            for lane in 0..states.len() {
                doubt |= u64::from(fault.lane(lane) != 0.0) << lane;
            }
            let call = KernelCall { scene, scratch: sweep_scratch, kernel, state: (q, qd, u), wrenches, out };
            return doubt | products::run(target, which, call);
        }
        if let (Some(form), true) = (algorithm.form(), GROUP == CONNECTED) {
            let kernel = &mut **connected.get_or_insert_with(|| Box::new(ConnectedKernel::new(scene, constraints)));
            let compliance = &mut kernel.rows.compliance;
            if given[0].seed[0].is_empty() {
                compliance.fill(T::zero());
            } else {
                let fault = gather(compliance, &given, |state| state.seed[0]);
                doubt |= lanes_but::<T>(|lane| fault.lane(lane) == 0.0);
            }
            let (scratch, states) = (sweep_scratch, states.len());
            let call = KernelCall { scene, scratch, kernel, state: (q, qd, u), wrenches, out };
            return doubt | connected::run(target, form, call, states);
        }
        let entries = entries_of::<T, GROUP>(algorithm, scene, inverse_columns, mass_columns);
        // `auto` also stores one value per row.
        let width = if entries.is_some() { model.nv() } else { out.len() / states.len().min(T::LANES) };
        let mut numbers = entries.map(|entries| std::mem::take(&mut entries.numbers)).unwrap_or_default();
        let to = T::entries_in(&mut numbers, out);
        let result_fault;
        if GROUP == MASS {
            sweeps::mass_matrix::<T, T::Columns, true>(scene, (sweep_scratch, mass_columns), q, to);
        } else {
            results.resize(width, T::zero());
            if GROUP == ACCELERATIONS && algorithm == Algorithm::ForwardDynamics(Form::SquareRoot) {
                doubt |= *strict;
            }
            let (scratch, state) = ((&mut *sweep_scratch, &mut *inverse_columns), (&q[..], &qd[..], &u[..]));
            doubt |=
                compute::<T, I, GROUP>((algorithm, target), scene, scratch, state, wrenches, (to, results, errors));
        }
        if let Some(entries) = entries_of::<T, GROUP>(algorithm, scene, inverse_columns, mass_columns) {
            entries.numbers = numbers;
            result_fault = entries.fault();
            T::put_entries(&entries.numbers, entries.chosen(), out);
        } else {
            result_fault = any_not_finite(results);
            T::put_lanes(results, out);
        }
        for lane in 0..states.len() {
            doubt |= u64::from(result_fault.lane(lane) != 0.0) << lane;
        }
        doubt
    }
}

within_target! {
    /// Results of a kinematic quantity; the lanes that need the fallback.
    #[inline(always)]
    fn quantity_in_lanes<'a, T>(
        chunk: &'a mut Chunk<T>,
        what: &'a KinematicQuantity<'a>,
        states: &'a [Arguments<'a>],
        out: &'a mut [f64],
    ) -> u64 {
        let Chunk { numbers: constants, arguments, quantities, .. } = chunk;
        let Numbers { model, quaternions, places, .. } = &**constants;
        // Quantities of frames do not depend on models.
        let has_models = if what.frame().is_some() { Some(false) } else { own_model::have_models(states) };
        let Some(has_models) = has_models else { return u64::MAX };
        let ([q, qd, qdd], given) = (arguments, in_lanes(states));
        let mut fault = gather_state([&mut *q, qd, qdd], &given);
        let nearness = nearness(quaternions, q);
        let kernel = quantities.get_or_insert_default();
        let own = has_models.then_some(&given);
        let (invalid, results) = quantities::run((model, places), kernel, what, (q, qd, qdd), own);
        fault += invalid + any_not_finite(results);
        T::put_lanes(results, out);
        doubtful(states.len(), nearness, fault)
    }
}

/// The entries of a matrix in lanes; None for algorithms without a matrix, or whose results are already in order.
#[inline(always)]
fn entries_of<'a, T: Vectorized, const GROUP: u8>(
    algorithm: Algorithm,
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    columns: &'a mut InverseColumns<T, T::Columns>,
    mass_columns: &'a mut MassColumns<T, T::Columns>,
) -> Option<&'a mut Entries<T, T::Columns>> {
    match algorithm {
        _ if GROUP == MASS => Some(mass_columns.prepare(model, sweeps)),
        Algorithm::MassMatrixInverse(Form::Auto | Form::Covariance) if GROUP == INVERSE => {
            columns.prepare(model, sweeps)
        }
        _ => None,
    }
}

/// Runs the algorithm; returns the lanes that need the fallback as bits.
#[inline(always)]
fn compute<T: Vectorized, I: Target, const GROUP: u8>(
    (algorithm, target): (Algorithm, I),
    scene: (&Model<T>, &SweepModel<T>),
    (scratch, columns): (&mut SweepScratch<T>, &mut InverseColumns<T, T::Columns>),
    (q, qd, u): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    (entries, results, errors): (&mut [Entry<T>], &mut [T], &mut Errors<T>),
) -> u64 {
    let (model, sweeps) = scene;
    match algorithm {
        Algorithm::ForwardDynamics(form) if GROUP == ACCELERATIONS => {
            let call = accelerations::KernelArguments { scene, scratch, state: (q, qd, u), wrenches, qdd: results };
            match form {
                Form::Auto => accelerations::watched(target, call, errors),
                Form::Covariance => accelerations::by_covariance(target, call),
                Form::SquareRoot if HAS_ALL_KERNELS => accelerations::by_roots(target, call),
                Form::SquareRoot => u64::MAX,
            }
        }
        Algorithm::MassMatrixInverse(form @ (Form::Auto | Form::Covariance))
            if GROUP == INVERSE && sweeps.is_shallow() =>
        {
            let doubt = if form == Form::Auto {
                let estimates = &mut results[..model.nv()];
                factor::watched(target, scene, scratch, (q, estimates))
            } else {
                factor::unwatched(target, scene, scratch, q)
            };
            factor::multiplied_out(target, scene, (scratch, columns), entries);
            doubt
        }
        Algorithm::InverseDynamics | Algorithm::BiasTorque if GROUP == TORQUES => {
            let u = (algorithm == Algorithm::InverseDynamics).then_some(u);
            sweeps::inverse_dynamics::<T, T::Columns>(scene, scratch, (q, qd, u), wrenches, results);
            0
        }
        // Rare algorithms; M has its own columns.
        _ => u64::MAX,
    }
}
