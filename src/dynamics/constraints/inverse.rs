//! Inverse dynamics and the inverse mass matrix through connections.

use super::RowFault;
use super::mobility::jacobian_of_rows;
use super::scratch::ConstraintScratch;
use crate::accuracy::largest;
use crate::decompositions::singular_values;
use crate::dynamics::forward::factorise;
use crate::dynamics::inverse::inverse_dynamics;
use crate::dynamics::sweeps::general;
use crate::filter::pivots::PivotMonitor;
use crate::model::Model;
use crate::scene::constraint::Constraints;
use crate::workspace::Workspace;
use nalgebra::{DMatrix, DVector, Vector6};

/// Singular values below this fraction of the largest are rounding errors.
const SMALL: f64 = 1e-11;

/// An unactuated torque below this fraction of its terms is rounding.
const UNNOTICED: f64 = 1e-8;

/// The result of constrained inverse dynamics.
#[derive(Debug, Clone)]
pub(crate) struct InverseOutcome {
    pub pivots: PivotMonitor<f64>,
    /// The rank of G.
    pub rank: usize,
    /// The largest entry of J qdd + gamma, rad/s^2 or m/s^2.
    pub residual: f64,
    /// An unactuated row that would need a torque, and the torque.
    pub unmet: Option<(usize, f64)>,
}

/// Torques `tau` and connection forces lambda (in the scratch) with tau + J* lambda = f, where f is the inverse
/// dynamics of the tree, and tau is zero where `actuated` is false.
///
/// If the solution is not unique, tau minimizes tau* M^-1 tau. If all rows are actuated, lambda = G^+ J M^-1 f,
/// in O(N + m^2 depth + m^3); otherwise a dense problem in the m rows and nv is solved.
pub(crate) fn constrained_inverse_dynamics(
    (model, constraints): (&Model<f64>, &Constraints),
    workspace: &mut Workspace<f64>,
    scratch: &mut ConstraintScratch,
    (q, qd, qdd): (&[f64], &[f64], &[f64]),
    wrenches: &[Vector6<f64>],
    actuated: &[bool],
    tau: &mut [f64],
) -> Result<InverseOutcome, RowFault> {
    let (nv, m) = (model.nv(), constraints.rows);
    inverse_dynamics(model, workspace, q, qd, qdd, wrenches, tau);
    let pivots = factorise(model, workspace, q);
    if workspace.lost_pivot(model, &pivots).is_some() {
        return Ok(InverseOutcome { pivots, rank: 0, residual: f64::NAN, unmet: None });
    }
    scratch.factorise_moving((model, constraints), workspace, (q, qd), &[])?;
    let ConstraintScratch { rows, residual, terms, .. } = &mut *scratch;
    rows.times::<true>((model, &workspace.sweeps), &workspace.store, qdd, (residual, terms));
    let residual = largest(residual);

    let white = whitened(model, workspace, tau);
    let w = scratch.whitened(&workspace.store);
    if actuated.iter().all(|&a| a) {
        let against = w.tr_mul(&white);
        scratch.inverse.apply(against.as_slice(), &mut scratch.forces);
    } else {
        let mut jacobian = vec![0.0; m * nv];
        let on_bodies = (&workspace.store.shifts[..], &mut scratch.state[..]);
        jacobian_of_rows(&scratch.rows, (model, constraints), on_bodies, &mut jacobian);
        let free: Vec<usize> = (0..nv).filter(|&row| !actuated[row]).collect();
        // Rows are scaled by the inertia at each joint, columns by the innovations of the rows of the connections.
        let weight = |row: usize| workspace.store.measured[row].pivot_inverse.sqrt();
        let forces = scratch.inverse.scaled_forces();
        let of_free = DMatrix::from_fn(free.len(), m, |r, i| jacobian[i * nv + free[r]] * weight(free[r]));
        let right = DVector::from_iterator(free.len(), free.iter().map(|&row| tau[row] * weight(row)));
        let mu = least(&(of_free * &forces), &right, &(&w * &forces), &white);
        scratch.forces.copy_from_slice((forces * mu).as_slice());
    }

    scratch.spread();
    let ConstraintScratch { wrenches, torque, estimates, .. } = scratch;
    let (scene, store) = workspace.passes(model);
    store.set_forces(wrenches.iter().copied());
    general::predict(scene, store, estimates);
    let mut unmet: Option<(usize, f64)> = None;
    for row in 0..nv {
        let taken = estimates[row] + torque[row];
        let size = tau[row].abs() + taken.abs();
        tau[row] -= taken;
        if !actuated[row] {
            let is_worse = unmet.is_none_or(|(_, other)| tau[row].abs() > other.abs());
            if tau[row].abs() > UNNOTICED * size.max(1e-3 * largest(estimates)) && is_worse {
                unmet = Some((row, tau[row]));
            }
            tau[row] = 0.0;
        }
    }
    Ok(InverseOutcome { pivots, rank: scratch.inverse.rank, residual, unmet })
}

/// D^-1/2 (1 - L) tau, with the factor of M in the workspace.
fn whitened(model: &Model<f64>, workspace: &mut Workspace<f64>, tau: &[f64]) -> DVector<f64> {
    let mut e = vec![0.0; tau.len()];
    let (scene, store) = workspace.passes(model);
    general::innovations::<f64, false>(scene, store, tau, &mut e);
    DVector::from_iterator(e.len(), e.iter().zip(&store.measured).map(|(e, row)| e * row.pivot_inverse.sqrt()))
}

/// The mu that minimizes |A mu - b|, and among these |B mu - c|.
fn least(a: &DMatrix<f64>, b: &DVector<f64>, to: &DMatrix<f64>, c: &DVector<f64>) -> DVector<f64> {
    // A square matrix, so that all right singular vectors are computed.
    let count = a.ncols();
    if count == 0 {
        return DVector::zeros(0);
    }
    let mut square = DMatrix::zeros(a.nrows().max(count), count);
    square.rows_mut(0, a.nrows()).copy_from(a);
    let Some(svd) = singular_values(square, true, true) else { return DVector::from_element(count, f64::NAN) };
    let (Some(u), Some(v)) = (&svd.u, &svd.v_t) else { return DVector::zeros(count) };
    let most = svd.singular_values.iter().fold(0.0, |most: f64, s| most.max(*s));
    let mut mu = DVector::zeros(count);
    let mut open = Vec::new();
    for (i, &s) in svd.singular_values.iter().enumerate() {
        if s > SMALL * most {
            let along = u.column(i).rows(0, b.len()).dot(b) / s;
            mu += v.row(i).transpose() * along;
        } else {
            open.push(i);
        }
    }
    if open.is_empty() {
        return mu;
    }
    let basis = DMatrix::from_fn(count, open.len(), |i, j| v[(open[j], i)]);
    let (left, moves) = (c - to * &mu, to * &basis);
    let chosen = singular_values(moves, true, true).and_then(|svd| svd.solve(&left, SMALL * to.norm()).ok());
    chosen.map_or_else(|| DVector::from_element(count, f64::NAN), |nu| mu + basis * nu)
}

/// M^-1 - M^-1 J* G^+ J M^-1 at `q` into `out`, (nv x nv): the accelerations that torques cause within the connections.
///
/// It is computed as a Gram matrix, without subtraction: with Y = D^-1/2 (1 - L), and P the projection onto the
/// orthogonal complement of the columns of W, it is Y* P Y. At most O(nv^3).
pub(crate) fn constrained_mass_matrix_inverse(
    (model, constraints): (&Model<f64>, &Constraints),
    workspace: &mut Workspace<f64>,
    scratch: &mut ConstraintScratch,
    q: &[f64],
    out: &mut [f64],
) -> Result<PivotMonitor<f64>, RowFault> {
    let nv = model.nv();
    let pivots = factorise(model, workspace, q);
    if workspace.lost_pivot(model, &pivots).is_some() {
        return Ok(pivots);
    }
    scratch.factorise((model, constraints), workspace, q, &[])?;
    let whole = scratch.whitened(&workspace.store) * scratch.inverse.columns();
    let basis = if whole.is_empty() { whole } else { whole.qr().q() };
    let mut unit = vec![0.0; nv];
    let mut columns = DMatrix::zeros(nv, nv);
    for j in 0..nv {
        unit[j] = 1.0;
        columns.set_column(j, &whitened(model, workspace, &unit));
        unit[j] = 0.0;
    }
    // Projects twice: the second projection removes the rounding errors of the first.
    for _ in 0..2 {
        let along = basis.tr_mul(&columns);
        columns -= &basis * along;
    }
    for i in 0..nv {
        for j in i..nv {
            let entry = columns.column(i).dot(&columns.column(j));
            out[i * nv + j] = entry;
            out[j * nv + i] = entry;
        }
    }
    Ok(pivots)
}
