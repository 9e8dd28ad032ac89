//! The mass matrix as the covariance of the measurements, M = H R H* (5.1), from the composite inertias r(k) (3.4,
//! 3.5).

use super::sweeps::general;
use crate::model::Model;
use crate::scalar::Real;
use crate::workspace::Workspace;

/// M at `q` into `out`, (nv x nv) row by row, full and symmetric, armature on the diagonal.
///
/// r(k) is propagated tip to base; column k of R H* is r(k) H*(k), propagated inward (3.4). O(N depth).
pub fn mass_matrix<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, q: &[T], out: &mut [T]) {
    let Workspace { sweeps, store, columns, .. } = workspace;
    general::mass_matrix((model, sweeps), (store, columns), q, out);
}

/// log det M = sum of log D(k), with the factor already in the workspace. In f64, because the scalars have no
/// logarithm.
#[must_use]
pub fn log_det_mass_matrix<T: Real>(workspace: &Workspace<T>) -> f64 {
    workspace.store.measured.iter().map(|m| m.pivot.lane(0).ln()).sum()
}
