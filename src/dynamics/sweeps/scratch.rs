//! The store of the passes: slots that are reused, or one slot per body that stores all results.
//!
//! The passes do not write P to memory. P^-(k) is the inertia of the body plus the sum over its children (3.6), which
//! the store holds, and the rows of the joint give P^+(k) from it, with the same bits as in the pass. In square-root
//! form the store holds the root of P^+(k).

use super::body::SweepBody;
use super::load::Load;
use super::model::SweepModel;
use crate::algorithm::Algorithm;
use crate::filter::cancellation::weight;
use crate::filter::pivots::Scale;
use crate::filter::riccati::{self, Measured};
use crate::filter::tolerance::Tolerance;
use crate::filter::{Form, Stage, System};
use crate::model::{Body, Model};
use crate::scalar::Real;
use crate::spatial::transform::{AxialRotation, ConstantRotation, unpacked};
use crate::spatial::{BodyInertia, BodyRoot, RigidShift, Root6, Symmetric3, Symmetric6, scaled};
use nalgebra::{Vector3, Vector6};

/// Angular velocity, angular acceleration and acceleration of the origin (stored for the general joint only).
pub(in crate::dynamics) type Moving<T> = [[T; 3]; 3];

/// The state of one body that only its own later steps read.
#[derive(Debug, Clone, Copy)]
pub(in crate::dynamics) struct BodyState<T> {
    /// The rotation of a revolute joint.
    pub turn: AxialRotation<T>,
    /// Before the outward step of a body on a revolute joint: the acceleration of its origin in its parent's frame, in
    /// the first three entries. Then b(k), or its coordinates in the body's root; then z(k) in inverse dynamics, and
    /// z^+(k) with an error estimate.
    pub force: [T; 6],
}

/// The sum over the children of a body: P^- without the body's own inertia, and z^- without its own force.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Accumulated<T> {
    /// 6 + 9 + 6 numbers of the covariance: angular, coupling by rows, linear.
    pub p: [T; 21],
    /// The bounds on their terms, stored next to them.
    pub scale: Scale<T>,
    pub force: [T; 6],
}

impl<T: Real> Accumulated<T> {
    fn filled(value: T) -> Self {
        Self { p: [value; 21], scale: Scale::filled(value), force: [value; 6] }
    }
}

/// The same sum for the error estimate.
#[derive(Debug, Clone, Copy)]
pub(in crate::dynamics) struct TestAccumulated<T> {
    /// Bounds on the terms of the diagonal of P^-.
    pub terms: [T; 6],
    /// The force of the test vector.
    pub zeta: [T; 6],
}

/// The state of one body for the error estimate.
#[derive(Debug, Clone, Copy)]
pub(in crate::dynamics) struct TestState<T> {
    /// Bounds on the terms of the diagonal of P^-.
    pub terms: [T; 6],
    /// b(k).
    pub bias: [T; 6],
    /// Squares of the angular and the linear half of zeta^+.
    pub zeta: (T, T),
}

/// The root of P and z = L y + t of a body with the children that have been joined to it.
#[derive(Debug, Clone, Copy)]
pub(in crate::dynamics) struct Rooted<T> {
    pub root: Root6<T>,
    pub y: [T; 6],
    pub t: [T; 6],
    /// The bounds on the terms of P.
    pub scale: Scale<T>,
}

impl<T: Real> Rooted<T> {
    pub fn filled(value: T) -> Self {
        Self { root: Root6::filled(value), y: [value; 6], t: [value; 6], scale: Scale::filled(value) }
    }
}

/// The error estimate: the test vector, which is a second right-hand side, and its state.
#[derive(Debug, Clone)]
pub(in crate::dynamics) struct TestVector<T> {
    /// w of each row.
    pub vector: Vec<T>,
    /// The second test vector: for states that the first one does not accept, and the right-hand side for the factor of
    /// M.
    pub other_vector: Vec<T>,
    /// Innovations of w.
    pub innovations: Vec<T>,
    /// In slots, inward; the first is always zero.
    pub accumulated: Vec<TestAccumulated<T>>,
    /// One per body.
    pub own: Vec<TestState<T>>,
    /// lambda^- and nu, in slots, outward; the first, of the base, is zero.
    pub co_states: Vec<[[T; 6]; 2]>,
    /// nu of each body, for the factor of M alone: apart, because form `auto` must fit the cache.
    pub nu: Vec<[T; 6]>,
}

/// One for each thread; starts as NaN.
#[derive(Debug, Clone)]
pub(crate) struct SweepScratch<T: Real> {
    /// One per body.
    pub(in crate::dynamics) own: Vec<BodyState<T>>,
    /// phi of each joint that is not revolute; in the general model of each joint.
    pub(crate) shifts: Vec<RigidShift<T>>,
    /// In slots, outward.
    pub(in crate::dynamics) motions: Vec<Moving<T>>,
    /// In slots, inward; the first, of leaves that have no slot, is always zero.
    pub(in crate::dynamics) accumulated: Vec<Accumulated<T>>,
    /// The same of M.
    pub(in crate::dynamics) composites: Vec<BodyInertia<T>>,
    /// D and g of each row.
    pub(crate) measured: Vec<Measured<T>>,
    /// In slots, outward.
    pub(in crate::dynamics) co_states: Vec<[T; 6]>,
    pub(in crate::dynamics) test: TestVector<T>,
    /// The part of b(k) that is not in its coordinates.
    pub(in crate::dynamics) added: Vec<[T; 6]>,
    /// In slots, inward: the roots. Leaves that have no slot use the first.
    pub(in crate::dynamics) rooted: Vec<Rooted<T>>,
    /// The square of the largest estimated error that form `auto` accepts, relative to the largest entry, in units of
    /// eps^2.
    pub(crate) accepted_square: T,
    /// The same of products with derivatives, in units of eps, and not squared.
    pub(crate) accepted_of_products: T,
    /// Number of rows on the longest path from the base.
    longest_path: usize,
}

impl<T: Real> SweepScratch<T> {
    pub fn new(model: &Model<T>, sweeps: &SweepModel<T>) -> Self {
        let nan = T::from_f64(f64::NAN);
        let (bodies, nv) = (sweeps.bodies.len(), model.nv());
        // The base has no co-state. Each call sets its motion.
        let mut co_states = vec![[nan; 6]; sweeps.swept_slots.outward];
        co_states[0] = [T::zero(); 6];
        let mut test_co_states = vec![[[nan; 6]; 2]; sweeps.swept_slots.outward];
        test_co_states[0] = [[T::zero(); 6]; 2];
        // The slot of a leaf stays zero.
        let mut accumulated = vec![Accumulated::filled(nan); sweeps.swept_slots.inward];
        let empty = || sweeps.bodies.iter().filter(|body| body.is_leaf).map(|body| body.places.inward).chain([0]);
        empty().for_each(|slot| accumulated[slot] = Accumulated::filled(T::zero()));
        let test_sum = |value| TestAccumulated { terms: [value; 6], zeta: [value; 6] };
        let mut test_accumulated = vec![test_sum(nan); sweeps.swept_slots.inward];
        empty().for_each(|slot| test_accumulated[slot] = test_sum(T::zero()));
        let composite = |value| BodyInertia {
            mass: value,
            first_moment: Vector3::from_element(value),
            rotational: Symmetric3::new([value; 6]),
        };
        let mut composites = vec![composite(nan); sweeps.swept_slots.inward];
        empty().for_each(|slot| composites[slot] = composite(T::zero()));
        Self {
            own: vec![BodyState { turn: AxialRotation { s: nan, c: nan }, force: [nan; 6] }; bodies],
            shifts: vec![RigidShift::filled(nan); sweeps.shifting.len()],
            motions: vec![[[nan; 3]; 3]; sweeps.swept_slots.outward],
            accumulated,
            composites,
            measured: vec![Measured::filled(nan); nv],
            test: TestVector {
                vector: (0..nv).map(|row| T::from_f64(weight(row))).collect(),
                other_vector: (nv..2 * nv).map(|row| T::from_f64(weight(row))).collect(),
                innovations: vec![nan; nv],
                accumulated: test_accumulated,
                own: vec![TestState { terms: [nan; 6], bias: [nan; 6], zeta: (nan, nan) }; bodies],
                nu: vec![[nan; 6]; bodies],
                co_states: test_co_states,
            },
            co_states,
            added: vec![[nan; 6]; bodies],
            rooted: vec![Rooted::filled(nan); sweeps.swept_slots.inward],
            accepted_square: nan,
            accepted_of_products: nan,
            longest_path: sweeps.longest_path,
        }
        .accepting(None)
    }

    /// The same scratch with this tolerance on estimated errors, relative to the largest entry; None: the default.
    pub(crate) fn accepting(mut self, tolerance: Option<f64>) -> Self {
        self.accept(tolerance);
        self
    }

    /// Sets the tolerance on estimated errors, relative to the largest entry; None: the default.
    pub(crate) fn accept(&mut self, tolerance: Option<f64>) {
        let [square, of_products] = self.accepted(tolerance);
        self.accepted_square = T::from_f64(square);
        self.accepted_of_products = T::from_f64(of_products);
    }

    /// The accepted errors with this tolerance: the square in units of eps^2, and that of products in units of eps.
    pub(crate) fn accepted(&self, given: Option<f64>) -> [f64; 2] {
        let (tolerance, epsilon) = (Tolerance { given, rows: self.longest_path }, T::epsilon().lane(0));
        [(tolerance.of_covariance(epsilon) / epsilon).powi(2), tolerance.of_products() / epsilon]
    }

    /// 1 / D of a row of the factor.
    #[inline(always)]
    pub(crate) fn pivot_inverse(&self, row: usize) -> T {
        self.measured[row].pivot_inverse
    }

    /// The co-state of the test vector at a place, of the factor of M with an error estimate.
    #[inline(always)]
    pub(in crate::dynamics) fn test_co_state(&self, place: usize) -> [T; 6] {
        self.test.nu[place]
    }

    /// Exchanges the two test vectors.
    #[inline(always)]
    pub(crate) fn exchange_test_vectors(&mut self) {
        let TestVector { vector, other_vector, .. } = &mut self.test;
        std::mem::swap(vector, other_vector);
    }
}

/// Number of bytes that an algorithm reads or writes in f64, without arguments and results: the constants of the scene,
/// which all lanes share, and the data of each state.
#[cfg(feature = "report")]
pub(crate) fn bytes(sweeps: &SweepModel<f64>, nv: usize, algorithm: Algorithm) -> [usize; 2] {
    let bodies = sweeps.bodies.len();
    let shifts = sweeps.shifting.len() * (size_of::<RigidShift<f64>>() + size_of::<Body<f64>>())
        + sweeps.constant_rotations.len() * size_of::<ConstantRotation<f64>>();
    let turns = bodies * size_of::<AxialRotation<f64>>();
    let root = if algorithm == Algorithm::ForwardDynamics(Form::SquareRoot) { size_of::<BodyRoot<f64>>() } else { 0 };
    let constants = size_of::<SweepBody<f64>>() + size_of::<Load<f64>>() + root;
    let model = bodies * constants;
    let noise = nv * size_of::<f64>();
    let motions = sweeps.swept_slots.outward * size_of::<Moving<f64>>() + bodies * size_of::<[f64; 6]>();
    let filter = sweeps.swept_slots.inward * size_of::<Accumulated<f64>>() + nv * size_of::<Measured<f64>>();
    // Two values per row, the bounds and squares of each body, and the propagated values inward and outward.
    let test = nv * 2 * size_of::<f64>()
        + bodies * size_of::<TestState<f64>>()
        + sweeps.swept_slots.inward * size_of::<TestAccumulated<f64>>()
        + sweeps.swept_slots.outward * size_of::<[[f64; 6]; 2]>();
    let product = sweeps.swept_slots.outward * sweeps.longest_path * size_of::<[f64; 6]>() + nv * nv * size_of::<f64>();
    let swept = match algorithm {
        Algorithm::InverseDynamics | Algorithm::BiasTorque => motions,
        Algorithm::MassMatrix => sweeps.swept_slots.inward * size_of::<BodyInertia<f64>>() + nv * size_of::<[f64; 6]>(),
        Algorithm::ForwardDynamics(Form::Auto) | Algorithm::ConstrainedDynamics(Form::Auto) => motions + filter + test,
        Algorithm::ForwardDynamics(Form::SquareRoot) => {
            let of_bodies = bodies * size_of::<[f64; 6]>();
            let slots = sweeps.swept_slots.inward * size_of::<Rooted<f64>>()
                + sweeps.swept_slots.outward * size_of::<[f64; 6]>();
            motions + of_bodies + slots + nv * size_of::<Measured<f64>>()
        }
        Algorithm::ForwardDynamics(_) | Algorithm::ConstrainedDynamics(_) => {
            motions + filter + sweeps.swept_slots.outward * size_of::<[f64; 6]>()
        }
        // Plus a test vector with its forces.
        Algorithm::MassMatrixInverse(Form::Auto) => {
            filter + test + product + nv * size_of::<f64>() + bodies * size_of::<[f64; 6]>()
        }
        Algorithm::MassMatrixInverse(_) => filter + product,
        // The state of each body in the outward and the inward pass of the product, and of each row.
        Algorithm::Products(which) => {
            let factor = if which.form().is_some() { filter } else { 0 };
            motions + factor + bodies * size_of::<[[f64; 6]; 6]>() + nv * size_of::<[f64; 5]>()
        }
        // The three matrices and their columns; other data is negligible.
        Algorithm::Derivatives(_) => motions + filter + product + 3 * nv * nv * size_of::<f64>(),
    };
    [model, noise + shifts + turns + swept]
}

impl<T: Real> Accumulated<T> {
    /// P^+ of a body with this inertia, on the inboard side of its joint, and the rest as in
    /// [`SweepScratch::filtered_covariance`].
    pub(crate) fn measured(
        &self,
        (system, k): (&System<T>, usize),
        inertia: &BodyInertia<T>,
        measured: &mut [Measured<T>],
        seen: impl FnMut(usize, &Symmetric6<T>),
    ) -> Symmetric6<T> {
        let mut p = unpacked(&self.p).add(&inertia.to_symmetric());
        riccati::measure_stage(system, k, &mut p, measured, seen);
        p
    }
}

/// P^+ of a stage, from the root of P; `seen` is called with the P^- of each row.
pub(crate) fn covariances_of_root<T: Real>(
    stage: &Stage<T>,
    filtered: &Symmetric6<T>,
    measured: &[Measured<T>],
    mut seen: impl FnMut(usize, &Symmetric6<T>),
) -> Symmetric6<T> {
    // P^- = P^+ + g D g* row by row: nothing is subtracted.
    let mut p = *filtered;
    for (i, m) in measured[stage.first_row..][..stage.rows.count()].iter().enumerate() {
        p = p.add_rank_one(&scaled(&m.gain, m.pivot), &m.gain);
        seen(stage.first_row + i, &p);
    }
    *filtered
}

impl<T: Real> SweepScratch<T> {
    /// P^+ of a body, on the inboard side of its joint. `seen` is called with the P^- of each row. `measured` receives
    /// D and g of the rows; in square-root form they are read from it.
    pub(in crate::dynamics) fn filtered_covariance(
        &self,
        (system, body, load): (&System<T>, &SweepBody<T::Parameter>, &Load<T>),
        measured: &mut [Measured<T>],
        of_roots: bool,
        seen: impl FnMut(usize, &Symmetric6<T>),
    ) -> Symmetric6<T> {
        let at = body.places.inward;
        if of_roots {
            let filtered = self.rooted[at].root.to_symmetric();
            return covariances_of_root(&system.stages[body.index], &filtered, measured, seen);
        }
        self.accumulated[at].measured((system, body.index), &load.inertia(), measured, seen)
    }

    /// In square-root form P^+ of every body, on the inboard side of its joint.
    pub(crate) fn filtered_roots(&self) -> Vec<Symmetric6<T>> {
        self.rooted[1..].iter().map(|rooted| rooted.root.to_symmetric()).collect()
    }

    /// The bound on the terms of P^- of a body.
    pub(in crate::dynamics) fn scale(
        &self,
        (body, load): (&SweepBody<T::Parameter>, &Load<T>),
        of_roots: bool,
    ) -> Scale<T> {
        if of_roots {
            return self.rooted[body.places.inward].scale;
        }
        let arrived = &self.accumulated[body.places.inward];
        arrived.scale.sum(&load.scale)
    }

    /// The sums over the children of each body: P^- without its own inertia, and the bound on the terms.
    pub(crate) fn covariances(&self) -> &[Accumulated<T>] {
        &self.accumulated[1..]
    }

    /// See [`SweepScratch::covariances`].
    pub(crate) fn covariances_mut(&mut self) -> &mut [Accumulated<T>] {
        &mut self.accumulated[1..]
    }

    /// The force of each body.
    pub(crate) fn forces(&self) -> impl Iterator<Item = Vector6<T>> + '_ {
        self.own.iter().map(|own| own.force.into())
    }

    /// Sets the force of each body: the right-hand side of the next filter.
    pub(crate) fn set_forces(&mut self, forces: impl IntoIterator<Item = Vector6<T>>) {
        for (own, force) in self.own.iter_mut().zip(forces) {
            own.force = force.into();
        }
    }
}
