//! Impacts that do not increase the kinetic energy, of one problem or of independent groups.

use super::groups::Cones;
use super::law::Limits;
use super::report::{Effort, SolveReport};
use nalgebra::DVector;

/// Change of the kinetic energy by impulses p at contact velocities u, J: u p + p G p/2. It does not depend on masses.
pub(crate) fn work(cone: &Cones, u: &DVector<f64>, p: &DVector<f64>) -> f64 {
    u.dot(p) + 0.5 * p.dot(&cone.response(p))
}

/// Scales p down if an unfinished solve would increase the kinetic energy; returns the impulses and the factor.
pub(crate) fn passive(cone: &Cones, u: &DVector<f64>, p: DVector<f64>) -> (DVector<f64>, f64) {
    if work(cone, u, &p) <= 0.0 {
        return (p, 1.0);
    }
    let square = p.dot(&cone.response(&p));
    let kept = if square > 0.0 { (-2.0 * u.dot(&p) / square).clamp(0.0, 1.0) } else { 0.0 };
    (p * kept, kept)
}

/// The largest factor s in [0, 1] for which p1 + s p2 does not increase the kinetic energy, provided that p1 does not.
pub(crate) fn expansion_kept(cone: &Cones, u: &DVector<f64>, p1: &DVector<f64>, p2: &DVector<f64>) -> f64 {
    if work(cone, u, &(p1 + p2)) <= 0.0 {
        return 1.0;
    }
    let a = 0.5 * p2.dot(&cone.response(p2));
    let b = (u + cone.response(p1)).dot(p2);
    let c = work(cone, u, p1).min(0.0);
    let root = (b * b - 4.0 * a * c).max(0.0).sqrt();
    let s = if b > 0.0 { -2.0 * c / (b + root) } else { (root - b) / (2.0 * a) };
    if s.is_finite() { s.clamp(0.0, 1.0) } else { 0.0 }
}

/// The result of an impact.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Impact {
    /// The impulses, N s.
    pub impulses: DVector<f64>,
    pub solved: SolveReport,
    /// Factor applied to the impulses of the expansion phase.
    pub expansion_kept: f64,
    /// Factor applied to the impulses of the compression phase; 1 if its solve converged.
    pub impulse_kept: f64,
    /// Change of the kinetic energy, J; at most rounding above zero.
    pub work: f64,
    /// Impulses of compression, and those of expansion before their factor; none without expansion.
    pub phases: (DVector<f64>, Option<DVector<f64>>),
}

/// Impact with Poisson's hypothesis, as two problems.
///
/// Compression: u1 = u + G p1 with Coulomb friction for u1. Expansion: u2 = u1 + G p2 with normal impulses of at least
/// e `p1_n` and Coulomb friction for u2. The result is p = p1 + s p2, where s <= 1 is the largest factor that does not
/// increase the kinetic energy.
pub(crate) fn impact(cone: &Cones, u: &DVector<f64>, restitution: &[f64], effort: Effort) -> Impact {
    let limits = Limits::beside(u);
    let (p1, first) = cone.impulses(u, None, &limits, effort);
    let rebounds = restitution.iter().any(|&e| e > 0.0);
    let p1 = if rebounds { cone.shared_evenly(p1, u, &limits) } else { p1 };
    let (p1, impulse_kept) = passive(cone, u, p1);
    let least: Vec<f64> = restitution.iter().enumerate().map(|(i, e)| e * p1[3 * i + 2]).collect();
    if least.iter().all(|&a| a == 0.0) {
        let phases = (p1.clone(), None);
        let work = work(cone, u, &p1);
        return Impact { impulses: p1, solved: first, expansion_kept: 1.0, impulse_kept, work, phases };
    }
    let start = DVector::from_fn(p1.len(), |i, _| restitution[i / 3] * p1[i]);
    let between = u + cone.response(&p1);
    let limits = Limits { least, ..limits };
    let (p2, second) = cone.impulses(&between, Some(&start), &limits, effort);
    let p2 = cone.shared_evenly(p2, &between, &limits);
    let kept = expansion_kept(cone, u, &p1, &p2);
    let impulses = &p1 + &p2 * kept;
    let work = work(cone, u, &impulses);
    let (solved, phases) = (first.with(second), (p1, Some(p2)));
    Impact { impulses, solved, expansion_kept: kept, impulse_kept, work, phases }
}
