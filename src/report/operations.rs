//! Operation counts of each algorithm on a scene, obtained by running the code on [`Traced`] scalars, and the memory it
//! accesses.

use crate::algorithm::{Algorithm, Arguments};
use crate::dynamics;
use crate::dynamics::constraints::ConstraintKernel;
use crate::dynamics::derivatives::{
    Constants, DerivativeScratch, Directions, ProductScratch, forward_dynamics_jvp, forward_dynamics_vjp,
    inverse_dynamics_jvp, inverse_dynamics_vjp, of_state,
};
use crate::dynamics::mass_inverse::InverseScratch;
use crate::dynamics::sweeps::{self, SweepModel};
use crate::dynamics::traced::TracedSweeps;
use crate::filter::pivots::Scale;
use crate::filter::riccati::Measured;
use crate::filter::{FORMS, Form, Stage};
use crate::model::{Body, Model, Simplifications};
use crate::operators::{Factor, Updated};
use crate::scalar::{Operations, Real, Traced};
use crate::scene::Scene;
use crate::spatial::{BodyRoot, RigidShift, Root6, SpatialVector, Symmetric6};
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// The computation to count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Task {
    /// An algorithm with its results.
    Algorithm(Algorithm),
    /// The factorization of M at q in some form: phi, D, g and P^+ of every joint.
    Factor(Form),
}

/// All tasks with their names; a form follows the colon.
#[must_use]
pub fn tasks() -> Vec<(String, Task)> {
    let mut all = vec![
        ("inverse dynamics".to_owned(), Task::Algorithm(Algorithm::InverseDynamics)),
        ("bias torque".to_owned(), Task::Algorithm(Algorithm::BiasTorque)),
        ("mass matrix".to_owned(), Task::Algorithm(Algorithm::MassMatrix)),
    ];
    for &(name, form) in FORMS {
        all.push((format!("forward dynamics: {name}"), Task::Algorithm(Algorithm::ForwardDynamics(form))));
        all.push((format!("inverse of the mass matrix: {name}"), Task::Algorithm(Algorithm::MassMatrixInverse(form))));
        all.push((format!("factor: {name}"), Task::Factor(form)));
    }
    all
}

/// Operation counts of one task for one state.
#[derive(Debug, Clone, PartialEq)]
pub struct Count {
    /// Operations, including those of the error estimate if the form has one.
    pub operations: Operations,
    /// The results, bit-identical to those of f64; for a factor the pivots D.
    pub results: Vec<f64>,
}

/// Counts the operations of one task on one state, as [`Scene::evaluate`] runs it.
///
/// Uses the sweeps that store only the result, if the task has them; scratch memory is allocated before. Arguments that
/// a task does not take are not read. The counts are those of a scalar without double-double fallback: a state whose
/// error estimate exceeds the tolerance also in square-root form costs more in f64.
///
/// # Panics
///
/// If an argument that the task takes is too short for the scene.
#[must_use]
pub fn count(scene: &Scene, task: Task, state: &Arguments<'_>) -> Count {
    match task {
        Task::Algorithm(algorithm) if sweeps::covers(algorithm) && !is_by_recursion(algorithm) => {
            count_in_sweeps(scene, scene.model().simplifications, algorithm, state)
        }
        _ => count_recursion(scene, task, state),
    }
}

/// Constrained forward dynamics as in the kernels, with one evaluation of the residual. Returns false if the error
/// estimate exceeds the tolerance.
fn through_connections(
    traced: &mut TracedSweeps,
    rows: &mut ConstraintKernel<Traced>,
    form: Form,
    (q, qd, tau): (&[Traced], &[Traced], &[Traced]),
    wrenches: &[Vector6<Traced>],
    out: &mut [Traced],
) -> bool {
    let nv = traced.model.nv();
    let (qdd, rest) = out.split_at_mut(nv);
    let kept = match form {
        Form::Auto => traced.factor_with_estimate(q, qdd).is_accepted(0),
        _ => traced.factor(q),
    };
    traced.innovations_of_factor((q, qd, tau), wrenches, qdd);
    let TracedSweeps { model, sweeps, scratch } = traced;
    let regular = rows.factor((model, sweeps), scratch, (q, qd));
    rows.first_step(scratch, tau, qdd, true);
    rows.take(qdd);
    traced.smooth(qdd);
    let TracedSweeps { model, sweeps, scratch } = traced;
    let [_, far] = rows.look((model, sweeps), scratch, qdd);
    let m = rows.forces_of_rows.len();
    rest[..m].copy_from_slice(&rows.forces_of_rows);
    (rest[m], rest[m + 1]) = (rows.rank, rows.residual);
    kept && regular.lane(0) > 0.0 && far.lane(0) >= 0.0
}

/// True if the general recursion of an algorithm is counted, although sweeps exist for it.
fn is_by_recursion(algorithm: Algorithm) -> bool {
    matches!(algorithm, Algorithm::Derivatives(_) | Algorithm::Products(_))
}

/// Counts the operations of an algorithm in the sweeps that store only the result, with other simplifications than
/// those of the scene.
pub(crate) fn count_in_sweeps(
    scene: &Scene,
    simplifications: Simplifications,
    algorithm: Algorithm,
    state: &Arguments<'_>,
) -> Count {
    let model = Model { simplifications, ..scene.model().clone() };
    let mut traced = TracedSweeps::new(&model);
    let ([q, qd, u], wrenches) = on_counted(state);
    if matches!(algorithm, Algorithm::MassMatrixInverse(_)) && !traced.sweeps.is_shallow() {
        return count_recursion(scene, Task::Algorithm(algorithm), state);
    }
    let mut out = vec![Traced::from_f64(f64::NAN); scene.width(algorithm)];
    let constraints = scene.constraints();
    let (kept, operations) = Traced::counted(|| {
        let state = (&q[..], &qd[..], &u[..]);
        match algorithm {
            Algorithm::ForwardDynamics(Form::Auto) => traced.forward_dynamics_with_estimate(state, &wrenches, &mut out),
            Algorithm::MassMatrixInverse(Form::Auto) => {
                let nv = traced.model.nv();
                let kept = traced.factor_with_estimate(&q, &mut out[..nv]).is_accepted(0);
                traced.multiplied_out(&mut out);
                kept
            }
            Algorithm::ForwardDynamics(Form::SquareRoot) => {
                traced.forward_dynamics_by_roots(state, &wrenches, &mut out)
            }
            Algorithm::ForwardDynamics(_) => {
                traced.forward_dynamics(state, &wrenches, &mut out);
                true
            }
            Algorithm::InverseDynamics | Algorithm::BiasTorque => {
                let u = (algorithm == Algorithm::InverseDynamics).then_some(&u[..]);
                traced.inverse_dynamics((&q, &qd, u), &wrenches, &mut out);
                true
            }
            Algorithm::MassMatrix => {
                traced.mass_matrix(&q, &mut out);
                true
            }
            Algorithm::MassMatrixInverse(_) => {
                traced.factor(&q);
                traced.multiplied_out(&mut out);
                true
            }
            Algorithm::ConstrainedDynamics(form) => {
                let mut rows = ConstraintKernel::new((&traced.model, &traced.sweeps), constraints);
                through_connections(&mut traced, &mut rows, form, state, &wrenches, &mut out)
            }
            // Their general recursion is counted.
            Algorithm::Derivatives(_) | Algorithm::Products(_) => false,
        }
    });
    let mut count = Count { operations, results: out.into_iter().map(|x| x.lane(0)).collect() };
    if !kept {
        // Recomputed by the checked method.
        let checked = count_recursion(scene, Task::Algorithm(algorithm), state);
        count = Count { operations: count.operations + checked.operations, results: checked.results };
    }
    count
}

/// The arguments of a state as counting scalars.
fn on_counted(state: &Arguments<'_>) -> ([Vec<Traced>; 3], Vec<SpatialVector<Traced>>) {
    let numbers = [state.q, state.qd, state.u].map(|given| given.iter().map(|&x| Traced::from_f64(x)).collect());
    (numbers, state.wrenches.iter().map(|force| force.map(Traced::from_f64)).collect())
}

/// Counts the operations of one task on one state with the recursions of the paper, the unchecked functions of
/// [`dynamics`], which store the quantities of every body.
///
/// # Panics
///
/// As [`count`].
#[must_use]
pub fn count_recursion(scene: &Scene, task: Task, state: &Arguments<'_>) -> Count {
    let model: Model<Traced> = scene.model().cast();
    let ([q, qd, u], wrenches) = on_counted(state);
    let mut workspace = Workspace::new(&model);
    let mut inverse = InverseScratch::new(&model);
    let mut derivatives = DerivativeScratch::new(&model);
    let mut products = ProductScratch::new(&model);
    let seed = state.seed.map(|given| given.iter().map(|&x| Traced::from_f64(x)).collect::<Vec<_>>());
    let (width, form) = match task {
        Task::Algorithm(algorithm) => (scene.width(algorithm), algorithm.form()),
        Task::Factor(form) => (0, Some(form)),
    };
    workspace.form = form.unwrap_or_default();
    let mut out = vec![Traced::from_f64(f64::NAN); width];
    let ((), operations) = Traced::counted(|| match task {
        Task::Algorithm(Algorithm::ForwardDynamics(_)) => {
            dynamics::forward_dynamics(&model, &mut workspace, &q, &qd, &u, &wrenches, &mut out);
        }
        // The general recursion exists for f64 only; the count is that of the tree, which dominates.
        Task::Algorithm(Algorithm::ConstrainedDynamics(_)) => {
            dynamics::forward_dynamics(&model, &mut workspace, &q, &qd, &u, &wrenches, &mut out[..model.nv()]);
        }
        Task::Algorithm(Algorithm::InverseDynamics) => {
            dynamics::inverse_dynamics(&model, &mut workspace, &q, &qd, &u, &wrenches, &mut out);
        }
        Task::Algorithm(Algorithm::BiasTorque) => {
            dynamics::bias_torque(&model, &mut workspace, &q, &qd, &wrenches, &mut out);
        }
        Task::Algorithm(Algorithm::MassMatrix) => dynamics::mass_matrix(&model, &mut workspace, &q, &mut out),
        Task::Algorithm(Algorithm::MassMatrixInverse(_)) => {
            dynamics::mass_matrix_inverse(&model, &mut workspace, &mut inverse, &q, &mut out);
        }
        Task::Algorithm(Algorithm::Derivatives(which)) => {
            // A lost pivot is not counted.
            let _ = of_state(which, &model, (&mut workspace, &mut derivatives), (&q, &qd, &u), &wrenches, &mut out);
        }
        Task::Algorithm(Algorithm::Products(which)) => {
            let at = (&q[..], &qd[..], &u[..]);
            let (seeds, mut forces) = ([&seed[0][..], &seed[1], &seed[2]], Vec::new());
            let (none, scratch) = (&mut Constants::default(), &mut products);
            // A lost pivot is not counted.
            let results = &mut out[..];
            let bodies = model.bodies.len();
            let of_seed = |forces| Directions::of_seed(seeds, bodies, forces);
            let along = if which.is_gradient() { Directions::default() } else { of_seed(&mut forces) };
            let _ = match (which.form(), which.is_gradient()) {
                (None, false) => {
                    inverse_dynamics_jvp(&model, &mut workspace, scratch, at, &wrenches, &along, results);
                    Ok(())
                }
                (None, true) => {
                    inverse_dynamics_vjp(&model, &mut workspace, scratch, at, &wrenches, &seed[0], (none, results));
                    Ok(())
                }
                (_, false) => forward_dynamics_jvp(&model, &mut workspace, scratch, at, &wrenches, &along, results),
                (_, true) => {
                    forward_dynamics_vjp(&model, &mut workspace, scratch, at, &wrenches, &seed[0], (none, results))
                }
            };
        }
        Task::Factor(_) => {
            dynamics::factorise(&model, &mut workspace, &q);
        }
    });
    if let Task::Factor(_) = task {
        out.extend(workspace.store.measured.iter().map(|row| row.pivot));
    }
    Count { operations, results: out.into_iter().map(|x| x.lane(0)).collect() }
}

/// Operation counts of calls on the factor of M in covariance form.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OfFactor {
    /// Factorization.
    pub made: Operations,
    /// One [`solve`](Factor::solve).
    pub solved: Operations,
    /// One [`update`](Factor::update) to the second configuration.
    pub updated: Operations,
    /// Number of bodies that the update recomputes.
    pub bodies: usize,
}

/// Counts the calls on a factor made at `q` and updated to `moved`.
///
/// # Panics
///
/// If a configuration is too short for the scene, or if the scene has bodies that cannot move (see
/// `Simplifications::every_body_moves`).
#[must_use]
pub fn of_factor(scene: &Scene, q: &[f64], moved: &[f64]) -> OfFactor {
    let model: Model<Traced> = scene.model().cast();
    let [q, moved] = [q, moved].map(|given| given.iter().map(|&x| Traced::from_f64(x)).collect::<Vec<_>>());
    let mut workspace = Workspace::new(&model).in_form(Form::Covariance);
    let ((mut factor, _), made) = Traced::counted(|| Factor::new(&model, &mut workspace, &q));
    let (tau, mut out) = (vec![Traced::from_f64(1.0); scene.nv()], vec![Traced::from_f64(f64::NAN); scene.nv()]);
    let ((), solved) = Traced::counted(|| factor.solve(&tau, &mut out));
    let (Updated { bodies, .. }, updated) = Traced::counted(|| factor.update(&model, &mut workspace, &moved));
    OfFactor { made, solved, updated, bodies }
}

/// Bytes of the arrays that an algorithm reads or writes in f64, each counted once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Footprint {
    /// Constants of the scene, shared by the states of a chunk.
    pub scene: usize,
    /// Per state: arguments, scratch, results, and the parts of the model that each lane stores.
    pub state: usize,
}

/// The memory that an algorithm accesses on a scene.
#[must_use]
pub fn footprint(scene: &Scene, algorithm: Algorithm) -> Footprint {
    let number = size_of::<f64>();
    let (rates, third) = algorithm.reads();
    let arguments = scene.nq() + (usize::from(rates) + usize::from(third.is_some())) * scene.nv();
    let [shared, swept] = match algorithm {
        _ if !sweeps::covers(algorithm) => [0, of_general_sweeps(scene, algorithm)],
        _ => sweeps::bytes(&SweepModel::<f64>::new(scene.model()), scene.nv(), algorithm),
    };
    Footprint { scene: shared, state: swept + (arguments + scene.width(algorithm)) * number }
}

/// Model and scratch of the sweeps that store every body.
fn of_general_sweeps(scene: &Scene, algorithm: Algorithm) -> usize {
    let vector = size_of::<SpatialVector<f64>>();
    let symmetric = size_of::<Symmetric6<f64>>();
    let (number, scale) = (size_of::<f64>(), size_of::<Scale<f64>>());
    let root = size_of::<Option<BodyRoot<f64>>>() + size_of::<Root6<f64>>();
    let measured = size_of::<Measured<f64>>();
    // Per body, in addition to model and phi: P and its bounds, or root, bounds and P; per row, the measurement
    // results.
    let carried = match algorithm {
        Algorithm::MassMatrixInverse(Form::SquareRoot) => root + scale + symmetric,
        _ => symmetric + scale,
    };
    let (body, row) = match algorithm {
        Algorithm::MassMatrixInverse(_) => (symmetric + vector + size_of::<usize>(), measured + vector),
        // Velocity, acceleration, force and co-state.
        _ => (4 * vector, measured),
    };
    let model = size_of::<Body<f64>>() + size_of::<Stage<f64>>();
    scene.model().bodies.len() * (model + size_of::<RigidShift<f64>>() + carried + body) + scene.nv() * (number + row)
}
