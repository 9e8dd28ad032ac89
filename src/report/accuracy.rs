//! Error against run time: each way to get the accelerations, its time a state and its distance from double-double.

use super::growth::median_ns;
use crate::dynamics::{self, mass_inverse::InverseScratch};
use crate::error::Error;
use crate::filter::Form;
use crate::scalar::{DoubleDouble, Real};
use crate::scene::{Model, Scene};
use crate::workspace::Workspace;
use crate::{memory, watch};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::{ldlt, llt};
use faer::{MatMut, Par, Spec};
use std::hint::black_box;

/// A way from torques to accelerations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Kalman filter and Bryson-Frazier smoother in covariance form, O(N).
    Filter,
    /// The same in square-root form.
    SquareRoot,
    /// M^-1 in closed form (6.1), times torque less bias.
    ClosedInverse,
    /// M and bias, then faer's LDLT of M, taken from the tip.
    DenseLdlt,
    /// M and bias, then faer's Cholesky of M.
    DenseCholesky,
}

/// Every method with the name it has in Python.
pub const METHODS: [(&str, Method); 4] = [
    ("filter and smoother", Method::Filter),
    ("M^-1 (6.1) times torque", Method::ClosedInverse),
    ("dense LDLT (faer)", Method::DenseLdlt),
    ("dense Cholesky (faer)", Method::DenseCholesky),
];

/// Degrees of freedom, of all states together, in a timed pass between two questions whether to go on.
const LONG: usize = 2_048;

/// States of a scene, row by row.
#[derive(Debug, Clone, Copy)]
pub struct States<'a> {
    /// (n x nq).
    pub q: &'a [f64],
    /// (n x nv).
    pub qd: &'a [f64],
    /// (n x nv).
    pub tau: &'a [f64],
}

/// Time and error of one method in one precision.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// Median time a state, ns.
    pub ns: f64,
    /// For each state: largest error of an acceleration over the largest acceleration; NaN where the method failed.
    pub errors: Vec<f64>,
}

/// A scalar that faer factors.
pub trait Dense: Real + faer::traits::RealField {}
impl<T: Real + faer::traits::RealField> Dense for T {}

/// The accelerations in double-double, (n x nv): the reference, about 31 digits.
///
/// # Errors
///
/// [`Error::SingularJoint`] where a pivot is lost even there.
pub fn reference(scene: &Scene, states: States<'_>) -> Result<Vec<DoubleDouble>, Error> {
    let (nq, nv) = (scene.nq(), scene.nv());
    let model: Model<DoubleDouble> = scene.model().cast();
    let mut workspace = Workspace::new(&model).in_form(Form::Covariance);
    let wide = |x: &[f64]| -> Vec<DoubleDouble> { x.iter().map(|&v| DoubleDouble::from_f64(v)).collect() };
    let mut all = memory::with_capacity("q", states.qd.len())?;
    let mut qdd = vec![DoubleDouble::from_f64(f64::NAN); nv];
    for i in 0..states.qd.len().checked_div(nv).unwrap_or(0) {
        watch::check()?;
        let q = wide(&states.q[i * nq..(i + 1) * nq]);
        let qd = wide(&states.qd[i * nv..(i + 1) * nv]);
        let tau = wide(&states.tau[i * nv..(i + 1) * nv]);
        let monitor = dynamics::forward_dynamics(&model, &mut workspace, &q, &qd, &tau, &[], &mut qdd);
        if workspace.lost_pivot(&model, &monitor).is_some() {
            return Err(Error::argument("scene", "a singular joint", "a mass matrix of full rank").in_state(i));
        }
        all.extend_from_slice(&qdd);
    }
    Ok(all)
}

/// Everything one method needs for one state, allocated once.
pub(super) struct Solver<T: Dense> {
    model: Model<T>,
    workspace: Workspace<T>,
    scratch: InverseScratch<T>,
    matrix: Vec<T>,
    right: Vec<T>,
    buffer: MemBuffer,
}

impl<T: Dense> Solver<T> {
    /// Scratch for one method; the two forms need no matrix.
    pub fn new(scene: &Scene, method: Method) -> Result<Self, Error> {
        let model: Model<T> = scene.model().cast();
        let nv = model.nv();
        let dense = !matches!(method, Method::Filter | Method::SquareRoot);
        let order = if dense { nv } else { 0 };
        let need = ldlt::factor::cholesky_in_place_scratch::<T>(order, Par::Seq, Spec::default())
            .or(llt::factor::cholesky_in_place_scratch::<T>(order, Par::Seq, Spec::default()));
        Ok(Self {
            workspace: Workspace::new(&model),
            scratch: InverseScratch::new(&model),
            matrix: memory::filled("scene", order.saturating_mul(order), T::from_f64(f64::NAN))?,
            right: vec![T::from_f64(f64::NAN); nv],
            buffer: MemBuffer::new(need),
            model,
        })
    }

    /// One state; false where the method met a bad pivot.
    pub fn run(&mut self, method: Method, q: &[T], qd: &[T], tau: &[T], qdd: &mut [T]) -> bool {
        match method {
            Method::Filter => {
                self.workspace.form = Form::Covariance;
                let monitor = dynamics::forward_dynamics(&self.model, &mut self.workspace, q, qd, tau, &[], qdd);
                self.workspace.lost_pivot(&self.model, &monitor).is_none()
            }
            Method::SquareRoot => {
                let (model, workspace) = (&self.model, &mut self.workspace);
                workspace.form = Form::SquareRoot;
                let monitor = dynamics::forward_dynamics(model, workspace, q, qd, tau, &[], qdd);
                monitor.clear(0) || workspace.pivots_are_positive()
            }
            Method::ClosedInverse => {
                self.workspace.form = Form::Covariance;
                self.centred_torque(q, qd, tau);
                let monitor = dynamics::mass_matrix_inverse(
                    &self.model,
                    &mut self.workspace,
                    &mut self.scratch,
                    q,
                    &mut self.matrix,
                );
                let nv = qdd.len();
                for (row, qdd) in self.matrix.chunks_exact(nv.max(1)).zip(qdd.iter_mut()) {
                    *qdd = row.iter().zip(&self.right).fold(T::zero(), |sum, (m, t)| sum + *m * *t);
                }
                self.workspace.lost_pivot(&self.model, &monitor).is_none()
            }
            Method::DenseLdlt | Method::DenseCholesky => {
                self.centred_torque(q, qd, tau);
                dynamics::mass_matrix(&self.model, &mut self.workspace, q, &mut self.matrix);
                qdd.copy_from_slice(&self.right);
                self.dense_solve(method == Method::DenseLdlt, qdd)
            }
        }
    }

    /// tau less the bias torque, into `right`.
    fn centred_torque(&mut self, q: &[T], qd: &[T], tau: &[T]) {
        dynamics::bias_torque(&self.model, &mut self.workspace, q, qd, &[], &mut self.right);
        for (right, tau) in self.right.iter_mut().zip(tau) {
            *right = *tau - *right;
        }
    }

    fn dense_solve(&mut self, with_diagonal: bool, right: &mut [T]) -> bool {
        let n = right.len();
        let mut matrix = MatMut::from_column_major_slice_mut(&mut self.matrix, n, n);
        let mut right = MatMut::from_column_major_slice_mut(right, n, 1);
        let stack = MemStack::new(&mut self.buffer);
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
}

/// Times `method` in the scalar `T` over all states, and compares with the reference.
///
/// # Errors
///
/// [`Error::Memory`] for more states or repeats than there is room for; [`Error::Interrupted`] under a [`watch`] that ends the work.
pub fn measure<T: Dense>(
    scene: &Scene,
    method: Method,
    states: States<'_>,
    reference: &[DoubleDouble],
    repeats: usize,
) -> Result<Measurement, Error> {
    let (nq, nv) = (scene.nq(), scene.nv());
    let mut solver = Solver::<T>::new(scene, method)?;
    let cast = |x: &[f64]| -> Result<Vec<T>, Error> {
        let mut all = memory::with_capacity("q", x.len())?;
        all.extend(x.iter().map(|&v| <T as Real>::from_f64(v)));
        Ok(all)
    };
    let (q, qd, tau) = (cast(states.q)?, cast(states.qd)?, cast(states.tau)?);
    let count = qd.len().checked_div(nv).unwrap_or(0);
    let mut qdd = vec![<T as Real>::from_f64(f64::NAN); nv];
    let state = |i: usize| (&q[i * nq..(i + 1) * nq], &qd[i * nv..(i + 1) * nv], &tau[i * nv..(i + 1) * nv]);

    let mut errors = memory::with_capacity("q", count)?;
    for i in 0..count {
        watch::check()?;
        let (q, qd, tau) = state(i);
        let fine = solver.run(method, q, qd, tau, &mut qdd);
        errors.push(if fine { error(&qdd, &reference[i * nv..(i + 1) * nv]) } else { f64::NAN });
    }
    let mut outcome = Ok(());
    let together = (LONG / nv.max(1)).max(1);
    let ns = median_ns(repeats, &mut || {
        for i in 0..count {
            // So seldom that the time does not show it.
            outcome = watch::check_at(i + 1, together);
            if outcome.is_err() {
                return;
            }
            let (q, qd, tau) = black_box(state(i));
            black_box(solver.run(method, q, qd, tau, black_box(&mut qdd)));
        }
    })?;
    outcome?;
    #[allow(clippy::cast_precision_loss)] // a count
    let ns = ns / count.max(1) as f64;
    Ok(Measurement { ns, errors })
}

/// Largest error over the largest entry of the reference.
fn error<T: Real>(found: &[T], reference: &[DoubleDouble]) -> f64 {
    let scale = reference.iter().map(|r| r.lane(0).abs()).fold(0.0, f64::max);
    let worst = found
        .iter()
        .zip(reference)
        .map(|(x, r)| (DoubleDouble::from_f64(x.lane(0)) - *r).lane(0).abs())
        .fold(0.0_f64, |m, e| if e <= m || m.is_nan() { m } else { e });
    worst / scale
}
