//! Impacts that cannot raise the kinetic energy.

use super::law::{Cone, Limits};
use super::report::{Effort, SolveReport};
use nalgebra::DVector;

/// What impulses p change of the kinetic energy at contact velocities u, J: u p + p G p/2. No mass enters.
pub(crate) fn work(cone: &Cone, u: &DVector<f64>, p: &DVector<f64>) -> f64 {
    u.dot(p) + 0.5 * p.dot(&(&cone.g * p))
}

/// p, or less of it where an unfinished solve would raise the kinetic energy; and the part that is kept.
pub(crate) fn passive(cone: &Cone, u: &DVector<f64>, p: DVector<f64>) -> (DVector<f64>, f64) {
    if work(cone, u, &p) <= 0.0 {
        return (p, 1.0);
    }
    let square = p.dot(&(&cone.g * &p));
    let kept = if square > 0.0 { (-2.0 * u.dot(&p) / square).clamp(0.0, 1.0) } else { 0.0 };
    (p * kept, kept)
}

/// The largest part s of [0, 1] for which p1 + s p2 does not raise the kinetic energy, where p1 alone does not.
pub(crate) fn expansion_kept(cone: &Cone, u: &DVector<f64>, p1: &DVector<f64>, p2: &DVector<f64>) -> f64 {
    if work(cone, u, &(p1 + p2)) <= 0.0 {
        return 1.0;
    }
    let a = 0.5 * p2.dot(&(&cone.g * p2));
    let b = (u + &cone.g * p1).dot(p2);
    let c = work(cone, u, p1).min(0.0);
    let root = (b * b - 4.0 * a * c).max(0.0).sqrt();
    let s = if b > 0.0 { -2.0 * c / (b + root) } else { (root - b) / (2.0 * a) };
    if s.is_finite() { s.clamp(0.0, 1.0) } else { 0.0 }
}

/// What an impact is.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Impact {
    /// The impulses, N s.
    pub impulses: DVector<f64>,
    pub solved: SolveReport,
    /// How much of the expansion the energy allows.
    pub expansion_kept: f64,
    /// How much of the compression, 1 where its solve converged.
    pub impulse_kept: f64,
    /// What it changes of the kinetic energy, J: never more than rounding above zero.
    pub work: f64,
}

/// Poisson's law in two problems. Compression: u1 = u + G p1, Coulomb with u1. Expansion: u2 = u1 + G p2, normal impulses at least e `p1_n`, Coulomb
/// with u2. p = p1 + s p2, s = 1 or as much as does not raise the kinetic energy.
pub(crate) fn impact(cone: &Cone, u: &DVector<f64>, restitution: &[f64], effort: Effort) -> Impact {
    let limits = Limits::beside(u);
    let (p1, first) = cone.impulses(u, None, &limits, effort);
    let (p1, impulse_kept) = passive(cone, u, p1);
    let least: Vec<f64> = restitution.iter().enumerate().map(|(i, e)| e * p1[3 * i + 2]).collect();
    if least.iter().all(|&a| a == 0.0) {
        return Impact { work: work(cone, u, &p1), impulses: p1, solved: first, expansion_kept: 1.0, impulse_kept };
    }
    let start = DVector::from_fn(p1.len(), |i, _| restitution[i / 3] * p1[i]);
    let between = u + &cone.g * &p1;
    let (p2, second) = cone.impulses(&between, Some(&start), &Limits { least, ..limits }, effort);
    let kept = expansion_kept(cone, u, &p1, &p2);
    let impulses = p1 + p2 * kept;
    let work = work(cone, u, &impulses);
    Impact { impulses, solved: first.with(second), expansion_kept: kept, impulse_kept, work }
}
