//! Error against run time: each method for the joint accelerations, its time per state and its error relative to
//! double-double arithmetic.
//!
//! The measured calls are the public ones: [`Scene::evaluate`] with one state per call. Errors and times are those of
//! the same calls.
//!
//! ```
//! use phipsi::report::accuracy::{States, reference};
//! use phipsi::scalar::Real;
//! # fn main() -> Result<(), phipsi::Error> {
//! // The accelerations of one state with about 31 digits, and the error of a call relative to them.
//! let scene = phipsi::scenes::chain(4)?;
//! let (q, qd, tau) = ([0.3; 4], [0.1; 4], [1.0; 4]);
//! let exact = reference(&scene, States { q: &q, qd: &qd, tau: &tau })?;
//! let mut qdd = [f64::NAN; 4];
//! scene.forward_dynamics(&mut scene.workspace(), &q, &qd, &tau, &[], &mut qdd)?;
//! let largest = qdd.iter().fold(0.0_f64, |most, a| most.max(a.abs()));
//! assert!(qdd.iter().zip(&exact).all(|(a, b)| (a - b.lane(0)).abs() <= 1e-13 * largest));
//! # Ok(())
//! # }
//! ```

use super::growth::median_ns;
use crate::algorithm::{Algorithm, Arguments};
use crate::batch::evaluator::Evaluator;
use crate::dynamics;
use crate::error::{Error, check_length};
use crate::filter::Form;
use crate::model::Model;
use crate::scalar::{DoubleDouble, Real};
use crate::scene::Scene;
use crate::workspace::Workspace;
use crate::{interrupt, memory};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::{ldlt, llt};
use faer::{MatMut, Par, Spec};
use std::hint::black_box;

/// A method that computes accelerations from torques.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Method {
    /// Forward dynamics in the given form: Kalman filter and Bryson-Frazier smoother, O(N).
    Filter(Form),
    /// M^-1 in closed form (6.1), in form `auto`, times torque minus bias.
    ClosedInverse,
    /// M and bias, then faer's LDLT of M with the joints in order from the tip.
    DenseLdlt,
    /// M and bias, then faer's Cholesky of M.
    DenseCholesky,
}

/// All methods with their Python names. `auto`, the default of calls, is the first.
pub const METHODS: &[(&str, Method)] = &[
    ("auto", Method::Filter(Form::Auto)),
    ("covariance", Method::Filter(Form::Covariance)),
    ("square-root", Method::Filter(Form::SquareRoot)),
    ("M^-1 (6.1) times torque", Method::ClosedInverse),
    (LDLT, Method::DenseLdlt),
    (CHOLESKY, Method::DenseCholesky),
];

/// Degrees of freedom, summed over all states of a timed pass, between two interruption checks.
const LONG: usize = 2_048;

/// Names of the two dense methods, also in the report on extreme scenes.
pub(super) const LDLT: &str = "dense LDLT (faer)";
pub(super) const CHOLESKY: &str = "dense Cholesky (faer)";

impl Method {
    /// The Rust calls of the method.
    #[must_use]
    pub const fn call(self) -> &'static str {
        match self {
            Self::Filter(_) => "Scene::evaluate(ForwardDynamics)",
            Self::ClosedInverse => "Scene::evaluate(MassMatrixInverse), Scene::evaluate(BiasTorque), product",
            Self::DenseLdlt => "Scene::evaluate(MassMatrix), Scene::evaluate(BiasTorque), faer's LDLT",
            Self::DenseCholesky => "Scene::evaluate(MassMatrix), Scene::evaluate(BiasTorque), faer's Cholesky",
        }
    }

    /// The form of its calls; `None` if they have none.
    #[must_use]
    pub const fn form(self) -> Option<Form> {
        match self {
            Self::Filter(form) => Some(form),
            Self::ClosedInverse => Some(Form::Auto),
            Self::DenseLdlt | Self::DenseCholesky => None,
        }
    }

    /// True if the method forms an nv x nv matrix.
    pub(super) const fn is_dense(self) -> bool {
        !matches!(self, Self::Filter(_))
    }
}

/// States of a scene, row-major.
#[derive(Debug, Clone, Copy)]
pub struct States<'a> {
    /// (n x nq).
    pub q: &'a [f64],
    /// (n x nv).
    pub qd: &'a [f64],
    /// (n x nv).
    pub tau: &'a [f64],
}

/// Time and error of one method.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// Median time per state, ns.
    pub ns: f64,
    /// Per state, the largest error of an acceleration relative to the largest acceleration; NaN if the method failed.
    pub errors: Vec<f64>,
}

/// The number of states, after checking the array lengths.
fn count_of(scene: &Scene, states: States<'_>) -> Result<usize, Error> {
    scene.check_independent()?;
    let count = states.qd.len().checked_div(scene.nv()).unwrap_or(0);
    for (name, found, width) in
        [("q", states.q.len(), scene.nq()), ("qd", states.qd.len(), scene.nv()), ("tau", states.tau.len(), scene.nv())]
    {
        check_length(name, found, count * width)?;
    }
    Ok(count)
}

/// Reference accelerations in double-double arithmetic, (n x nv), about 31 digits.
///
/// # Errors
///
/// [`Error::Shape`] for wrong lengths, and [`Error::SingularJoint`] if a pivot is singular also in this arithmetic.
pub fn reference(scene: &Scene, states: States<'_>) -> Result<Vec<DoubleDouble>, Error> {
    let (nq, nv, count) = (scene.nq(), scene.nv(), count_of(scene, states)?);
    let model: Model<DoubleDouble> = scene.model().cast();
    let mut workspace = Workspace::new(&model).in_form(Form::Covariance);
    let mut all = memory::with_capacity("q", states.qd.len())?;
    let mut qdd = vec![DoubleDouble::from_f64(f64::NAN); nv];
    for i in 0..count {
        interrupt::check()?;
        let q = DoubleDouble::each_of(&states.q[i * nq..(i + 1) * nq]);
        let qd = DoubleDouble::each_of(&states.qd[i * nv..(i + 1) * nv]);
        let tau = DoubleDouble::each_of(&states.tau[i * nv..(i + 1) * nv]);
        let monitor = dynamics::forward_dynamics(&model, &mut workspace, &q, &qd, &tau, &[], &mut qdd);
        if workspace.lost_pivot(&model, &monitor).is_some() {
            return Err(Error::argument("scene", "a singular joint", "a mass matrix of full rank").in_state(i));
        }
        all.extend_from_slice(&qdd);
    }
    Ok(all)
}

/// Scratch memory of one method.
pub(super) struct Solver<'a> {
    scene: &'a Scene,
    method: Method,
    evaluator: Evaluator,
    matrix: Vec<f64>,
    right: Vec<f64>,
    buffer: MemBuffer,
}

impl<'a> Solver<'a> {
    /// Scratch memory for one method; filter methods allocate no matrix.
    pub fn new(scene: &'a Scene, method: Method) -> Result<Self, Error> {
        let nv = scene.nv();
        let order = if method.is_dense() { nv } else { 0 };
        let need = ldlt::factor::cholesky_in_place_scratch::<f64>(order, Par::Seq, Spec::default())
            .or(llt::factor::cholesky_in_place_scratch::<f64>(order, Par::Seq, Spec::default()));
        Ok(Self {
            scene,
            method,
            evaluator: Evaluator::new(scene),
            matrix: memory::filled("scene", order.saturating_mul(order), f64::NAN)?,
            right: vec![f64::NAN; nv],
            buffer: MemBuffer::new(need),
        })
    }

    /// Evaluates one state. Returns false if a pivot is singular or a result is not finite.
    pub fn run(&mut self, q: &[f64], qd: &[f64], tau: &[f64], qdd: &mut [f64]) -> bool {
        let Self { scene, method, evaluator, matrix, right, buffer } = self;
        let state = Arguments { q, qd, u: tau, ..Arguments::default() };
        let mut call =
            |algorithm, out: &mut [f64]| scene.evaluate(evaluator, algorithm, &[state.read_by(algorithm)], out).is_ok();
        let of_matrix = match *method {
            Method::Filter(form) => return call(Algorithm::ForwardDynamics(form), qdd),
            Method::ClosedInverse => Algorithm::MassMatrixInverse(Form::Auto),
            Method::DenseLdlt | Method::DenseCholesky => Algorithm::MassMatrix,
        };
        if !(call(of_matrix, matrix) && call(Algorithm::BiasTorque, right)) {
            return false;
        }
        for (right, &tau) in right.iter_mut().zip(tau) {
            *right = tau - *right;
        }
        if *method == Method::ClosedInverse {
            let nv = qdd.len();
            for (row, qdd) in matrix.chunks_exact(nv.max(1)).zip(qdd.iter_mut()) {
                *qdd = row.iter().zip(&*right).fold(0.0, |sum, (&m, &t)| sum + m * t);
            }
            return true;
        }
        qdd.copy_from_slice(right);
        dense_solve(matrix, qdd, MemStack::new(buffer), *method == Method::DenseLdlt)
    }
}

/// Solves M x = right in place, overwriting M. Returns false if a pivot is not positive.
fn dense_solve(matrix: &mut [f64], right: &mut [f64], stack: &mut MemStack, with_diagonal: bool) -> bool {
    let n = right.len();
    let mut matrix = MatMut::from_column_major_slice_mut(matrix, n, n);
    let mut right = MatMut::from_column_major_slice_mut(right, n, 1);
    if with_diagonal {
        let done = ldlt::factor::cholesky_in_place(
            matrix.as_mut(),
            ldlt::factor::LdltRegularization::default(),
            Par::Seq,
            stack,
            Spec::default(),
        );
        if done.is_err() {
            return false;
        }
        let factor = matrix.as_ref();
        ldlt::solve::solve_in_place(factor, factor.diagonal(), right.as_mut(), Par::Seq, stack);
    } else {
        let done = llt::factor::cholesky_in_place(
            matrix.as_mut(),
            llt::factor::LltRegularization::default(),
            Par::Seq,
            stack,
            Spec::default(),
        );
        if done.is_err() {
            return false;
        }
        llt::solve::solve_in_place(matrix.as_ref(), right.as_mut(), Par::Seq, stack);
    }
    true
}

/// Times `method` over all states, one per call, and compares the results with the reference.
///
/// # Errors
///
/// [`Error::Shape`] for wrong lengths, [`Error::Memory`] for too many states or repeats, and [`Error::Interrupted`] if
/// [`interrupt`] stops the work.
pub fn measure(
    scene: &Scene,
    method: Method,
    states: States<'_>,
    reference: &[DoubleDouble],
    repeats: usize,
) -> Result<Measurement, Error> {
    let (nq, nv, count) = (scene.nq(), scene.nv(), count_of(scene, states)?);
    check_length("reference", reference.len(), count * nv)?;
    let mut solver = Solver::new(scene, method)?;
    let States { q, qd, tau } = states;
    let mut qdd = vec![f64::NAN; nv];
    let state = |i: usize| (&q[i * nq..(i + 1) * nq], &qd[i * nv..(i + 1) * nv], &tau[i * nv..(i + 1) * nv]);

    let mut errors = memory::with_capacity("q", count)?;
    for i in 0..count {
        interrupt::check()?;
        let (q, qd, tau) = state(i);
        let fine = solver.run(q, qd, tau, &mut qdd);
        errors.push(if fine { error(&qdd, &reference[i * nv..(i + 1) * nv]) } else { f64::NAN });
    }
    let mut outcome = Ok(());
    let together = (LONG / nv.max(1)).max(1);
    let ns = median_ns(repeats, &mut || {
        for i in 0..count {
            // Infrequent, so that the check does not affect the time.
            outcome = interrupt::check_at(i + 1, together);
            if outcome.is_err() {
                return;
            }
            let (q, qd, tau) = black_box(state(i));
            black_box(solver.run(q, qd, tau, black_box(&mut qdd)));
        }
    })?;
    outcome?;
    #[allow(clippy::cast_precision_loss)] // a count
    let ns = ns / count.max(1) as f64;
    Ok(Measurement { ns, errors })
}

/// Largest error relative to the largest entry of the reference.
fn error(found: &[f64], reference: &[DoubleDouble]) -> f64 {
    let scale = reference.iter().map(|r| r.lane(0).abs()).fold(0.0, f64::max);
    let worst = found
        .iter()
        .zip(reference)
        .map(|(x, r)| (DoubleDouble::from_f64(*x) - *r).lane(0).abs())
        .fold(0.0_f64, |m, e| if e <= m || m.is_nan() { m } else { e });
    worst / scale
}
