//! The contact law relaxed by an energy per contact, whose impulses are smooth functions of the velocities.
//!
//! A point of the central path of [`super::interior`], at which e does not decrease to zero. With q = mu `p_n`, for
//! given energies e and mu k:
//!
//! ```text
//! p_n u_n = e,     u_t = -mu k p_t / (q^2 - |p_t|^2)
//! ```
//!
//! Every contact is slightly open and slips slightly inside its cone, and there are no modes. Both are gradients of
//! logarithms, so that the impulses are unique without friction, also if G is singular. A large ratio of friction can
//! have several solutions, as the exact law has; the solver then returns one of them.
//!
//! Newton's method in the variables of the interior-point method starts at the solutions of the single contacts, one
//! after another. If that fails, it starts at large energies, which decrease to the given ones.

use super::gram::add_rows;
use super::implicit::Linearization;
use super::interior::{Interior, Point};
use super::law::{Cone, Limits};
use super::report::SolveReport;
use super::scaled::Scaled;
use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, Vector2, Vector3};

/// The residual at which a solution is accepted, relative to the scale of the velocities.
const TOLERANCE: f64 = 1e-10;

/// Largest number of Newton steps from one start, and of consecutive steps whose fraction is below the next constant.
const STEPS: usize = 80;
const STUCK: usize = 8;
const ALL_BUT_NONE: f64 = 0.02;

/// Largest number of halvings of a step, and the part of its predicted decrease of the errors that is required.
const HALVINGS: usize = 12;
const DECREASE: f64 = 1e-4;

/// An error, relative to the terms of an equation, below which the quadratic convergence ends in rounding; and the
/// error at which a search ends.
const NEAR: f64 = 1e-9;
const ROUNDING: f64 = 1e-14;

/// Number of passes over the single contacts, and of bisections of the friction of one.
const PASSES: usize = 4;
const BISECTIONS: usize = 40;

/// Other starts: normal impulses in scaled variables, whether steps are careful, and whether energies decrease.
const STARTS: [(f64, bool, bool); 6] = [
    (1.0, false, false),
    (100.0, false, false),
    (0.01, false, false),
    (1.0, true, false),
    (1.0, false, true),
    (1.0, true, true),
];

/// Factor of the energies at the last start, and by which they decrease.
const LARGEST: f64 = 1e8;
const DECREASES: f64 = 0.3;

/// Below this distance from its cone, relative to it, a contact has its distance from its slip velocity.
const CANCELS: f64 = 1e-2;

/// The energies of a contact, J.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Relaxation {
    /// e, the product of normal impulse and normal velocity.
    pub normal: f64,
    /// k, which the coefficient of friction multiplies.
    pub tangent: f64,
}

impl Cone {
    /// The impulses of the relaxed law for free velocities `c`, and a report. `scale` is the velocity to which its
    /// residual is relative.
    pub fn relaxed(
        &self,
        c: &DVector<f64>,
        start: Option<&DVector<f64>>,
        energies: &[Relaxation],
        scale: f64,
    ) -> (DVector<f64>, SolveReport) {
        let limits = Limits::beside(c);
        let largest = energies.iter().map(|of| of.normal).fold(0.0, f64::max);
        let problem = Scaled::with_energy(self, c, &limits, largest);
        let scaled = |energy: f64| energy / problem.unit / problem.unit;
        let each = energies.iter().zip(&self.friction);
        let aims: Vec<[f64; 2]> = each.map(|(of, mu)| [scaled(of.normal), scaled(mu * of.tangent)]).collect();
        let z = start.map_or_else(|| DVector::zeros(c.len()), |start| problem.of_impulses(start));
        let mut report = SolveReport { residual: f64::INFINITY, converged: false, ..SolveReport::nothing() };
        let mut best = DVector::zeros(c.len());
        let mut search = Interior::at(problem.clone(), one_by_one(&problem, &aims, z));
        for start in [None].into_iter().chain(STARTS.map(Some)) {
            if let Some((height, careful, falls)) = start {
                search = Interior::central(problem.clone(), (height, careful));
                if falls {
                    search.descend(&aims, &mut report.iterations);
                }
            }
            search.centre(&aims, &mut report.iterations);
            let (residual, floor) = search.relaxed_residual(&aims, scale);
            if residual < report.residual {
                report = SolveReport { residual, converged: residual <= TOLERANCE.max(floor), ..report };
                best = search.impulses(&limits);
            }
            if report.converged {
                break;
            }
        }
        (best, report)
    }

    /// The equations of the relaxed law, linearized at its solution `p`.
    ///
    /// With u + b(p) = 0 and K = r db/dp, they are (1 + K)^-1 (K dp + r du + r db) = 0, where db is the change of b by
    /// the data. For small energies they are those of the exact law in its modes.
    pub fn linearized_relaxed(&self, p: &DVector<f64>, c: &DVector<f64>, energies: &[Relaxation]) -> Linearization {
        let (n, u) = (self.len(), self.velocities(p, c));
        let mut by_velocity = Vec::with_capacity(n);
        let (mut by_friction, mut by_energy) = (Vec::with_capacity(n), Vec::with_capacity(n));
        let (mut matrix, g) = (DMatrix::zeros(3 * n, 3 * n), self.g.dense());
        for (i, of) in energies.iter().enumerate() {
            let (r, mu, normal) = (self.lengths[i], self.friction[i], p[3 * i + 2]);
            let held = 1.0 / (1.0 + r * of.normal / (normal * normal));
            let mut b = Matrix3::zeros();
            b[(2, 2)] = r * held;
            let mut a = Matrix3::identity();
            a[(2, 2)] = r * of.normal / (normal * normal) * held;
            let (mut of_friction, mut of_energy) = (Vector3::zeros(), Vector3::new(0.0, 0.0, -of.normal / normal));
            if mu > 0.0 {
                let (tangent, slip) = (Vector2::new(p[3 * i], p[3 * i + 1]), Vector2::new(u[3 * i], u[3 * i + 1]));
                let q = mu * normal;
                let mut room = (q - tangent.norm()) * (q + tangent.norm());
                if room < CANCELS * q * q {
                    room = mu * of.tangent * tangent.norm() / slip.norm();
                }
                // u_t + beta p_t = 0
                let beta = mu * of.tangent / room;
                let by_tangent = (Matrix2::identity() + tangent * tangent.transpose() * (2.0 / room)) * (r * beta);
                let by_normal = tangent * (-2.0 * mu * q / room * r * beta);
                let along = tangent.try_normalize(0.0).unwrap_or_else(Vector2::x);
                // (1 + K)^-1 of the tangents: both directions are eigenvectors.
                let across = 1.0 / (1.0 + r * beta);
                let radial = 1.0 / (1.0 + r * beta * (1.0 + 2.0 * tangent.norm_squared() / room));
                let inverse = Matrix2::identity() * across + along * along.transpose() * (radial - across);
                let coupled = -(inverse * by_normal) * held;
                let mut kept = Matrix3::zeros();
                kept.fixed_view_mut::<2, 2>(0, 0).copy_from(&inverse);
                kept.fixed_view_mut::<2, 1>(0, 2).copy_from(&coupled);
                kept[(2, 2)] = held;
                b = kept * r;
                a.fixed_view_mut::<2, 2>(0, 0).copy_from(&(inverse * by_tangent));
                a.fixed_view_mut::<2, 1>(0, 2).copy_from(&-coupled);
                // beta falls as 1 / mu - 2 mu p_n^2 / room
                let by_mu = tangent * (beta * (1.0 / mu - 2.0 * q * normal / room));
                of_friction = b * Vector3::new(by_mu[0], by_mu[1], 0.0);
                of_energy += Vector3::new(beta * tangent[0], beta * tangent[1], 0.0);
            }
            add_rows(&g, i, (&a, &b), &mut matrix);
            by_velocity.push(b);
            by_friction.push(of_friction);
            by_energy.push(b * of_energy);
        }
        Linearization {
            by_velocity,
            by_friction,
            by_least: vec![0.0; n],
            by_energy,
            matrix,
            // The impulses are unique.
            spring: 0.0,
            impulses: p.clone(),
        }
    }
}

/// The solution of each contact alone, with the impulses of the others, in a few passes.
fn one_by_one(problem: &Scaled<'_>, aims: &[[f64; 2]], mut z: DVector<f64>) -> Point {
    let (n, a) = (problem.len(), problem.a.dense());
    let mut room = vec![0.0; n];
    for _ in 0..PASSES {
        for i in 0..n {
            let (at, [normal, tangent]) = (3 * i, aims[i]);
            let own = a.fixed_view::<3, 3>(at, at);
            let by_all = a.fixed_rows::<3>(at) * &z + problem.c.fixed_rows::<3>(at);
            let others = by_all[2] - own[(2, 2)] * z[at + 2];
            z[at + 2] = normal_impulse(own[(2, 2)], others, normal);
            if !problem.grips(i) {
                continue;
            }
            let before = Vector2::new(z[at], z[at + 1]);
            let others = by_all.xy() - own.fixed_view::<2, 2>(0, 0) * before;
            let (q, easy) = (problem.radius(i, &z), 0.5 * (own[(0, 0)] + own[(1, 1)]));
            let pull = friction(easy * q, tangent / q, others.norm());
            let along = others.try_normalize(0.0).unwrap_or_else(Vector2::zeros) * (-pull * q);
            (z[at], z[at + 1]) = (along[0], along[1]);
            room[i] = q * (1.0 - pull) * (1.0 + pull);
        }
    }
    let slip = (0..n).map(|i| if problem.grips(i) { aims[i][1] / room[i] } else { 0.0 }).collect();
    let apart = (0..n).map(|i| aims[i][0] / z[3 * i + 2]).collect();
    Point { z, apart, slip, room }
}

/// The positive p with p (g p + u) = e.
fn normal_impulse(g: f64, u: f64, e: f64) -> f64 {
    let root = u.hypot(2.0 * (g * e).sqrt());
    if u > 0.0 {
        2.0 * e / (u + root)
    } else if g > 0.0 {
        (root - u) / (2.0 * g)
    } else {
        1.0
    }
}

/// The r in [0, 1) with `easy` r + `beta` r / (1 - r^2) = u, about.
fn friction(easy: f64, beta: f64, u: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..BISECTIONS {
        let r = 0.5 * (low + high);
        if easy * r + beta * r / ((1.0 - r) * (1.0 + r)) < u { low = r } else { high = r }
    }
    low
}

impl Interior<'_> {
    /// Newton steps until the products y v and l s have the given values and the velocities agree, to rounding. The
    /// products first have larger values if a start has them.
    fn centre(&mut self, aims: &[[f64; 2]], iterations: &mut usize) {
        let (mut stuck, mut error) = (0, f64::INFINITY);
        let mut larger = self.above_aims(aims).max(1.0);
        for _ in 0..STEPS {
            let before = self.now.clone();
            let Some(made) = self.step_to(aims, &mut larger) else { return };
            *iterations += 1;
            let next = self.norm(|i| aims[i], &self.sizes());
            if larger <= 1.0 && error <= NEAR && !(next < 0.5 * error) {
                if !(next < error) {
                    self.now = before;
                }
                return;
            }
            if larger <= 1.0 && next <= ROUNDING {
                return;
            }
            stuck = if made < ALL_BUT_NONE { stuck + 1 } else { 0 };
            if stuck > STUCK || next.is_nan() {
                return;
            }
            error = next;
        }
    }

    /// Solves for energies that decrease from large ones to the given ones.
    fn descend(&mut self, aims: &[[f64; 2]], iterations: &mut usize) {
        let mut larger = LARGEST;
        while larger > 1.0 {
            let each: Vec<[f64; 2]> = aims.iter().map(|aim| aim.map(|aim| larger * aim)).collect();
            self.centre(&each, iterations);
            larger *= DECREASES;
        }
    }

    /// One step toward `larger` times the given values, after a reduction of this factor; returns its fraction. `None`
    /// if the matrix is singular.
    ///
    /// A careful step decreases the errors of all equations; others can increase them, and are usually faster.
    fn step_to(&mut self, aims: &[[f64; 2]], larger: &mut f64) -> Option<f64> {
        let slope = self.slope()?;
        if !self.careful {
            *larger = self.above_aims(aims);
        }
        if *larger > 1.0 {
            let free = self.reach(&self.towards(&slope, |_| [0.0; 2])?);
            *larger *= (1.0 - free).powi(3).clamp(1e-4, 0.9);
        }
        *larger = larger.max(1.0);
        let aim = |i: usize| aims[i].map(|aim| *larger * aim);
        let step = self.towards(&slope, aim)?;
        if !self.careful {
            let (gap, before) = (self.gap(), self.disagreement());
            return Some(self.advance(&step, gap, before));
        }
        let (start, sizes) = (self.now.clone(), self.sizes());
        let before = self.norm(aim, &sizes);
        let mut made = self.reach(&step);
        for _ in 0..HALVINGS {
            self.go(&start, &step, made);
            if self.norm(aim, &sizes) <= (1.0 - DECREASE * made) * before {
                break;
            }
            made *= 0.5;
        }
        Some(made)
    }

    /// Mean ratio of the products y v and l s to their aims.
    fn above_aims(&self, aims: &[[f64; 2]]) -> f64 {
        let Point { z, apart, slip, room } = &self.now;
        let (mut sum, mut count) = (0.0, 0.0);
        for (i, aim) in aims.iter().enumerate() {
            sum += self.problem.above(i, z) * apart[i] / aim[0];
            count += 1.0;
            if self.problem.grips(i) {
                sum += slip[i] * room[i] / aim[1];
                count += 1.0;
            }
        }
        sum / count
    }

    /// Errors of the equations of each contact: of the normal velocity and of the slip, and of the logarithms of the
    /// products y v and l s, which keep steps away from the boundary.
    fn errors(&self, aim: impl Fn(usize) -> [f64; 2]) -> Vec<[f64; 4]> {
        let Point { z, apart, slip, room } = &self.now;
        let u = self.problem.a.times(z) + &self.problem.c;
        let of = |i: usize| {
            let (mut errors, aim) = ([0.0; 4], aim(i));
            errors[0] = (u[3 * i + 2] - apart[i]).abs();
            errors[2] = (self.problem.above(i, z) * apart[i] / aim[0]).ln().abs();
            if self.problem.grips(i) {
                let pull = self.problem.pull(i, z) * slip[i];
                errors[1] = (u[3 * i] + pull[0]).hypot(u[3 * i + 1] + pull[1]);
                errors[3] = (slip[i] * room[i] / aim[1]).ln().abs();
            }
            errors
        };
        (0..self.problem.len()).map(of).collect()
    }

    /// Sizes of the terms of the normal velocity and of the slip of each contact.
    fn sizes(&self) -> Vec<[f64; 2]> {
        let mut terms = self.problem.c.abs();
        self.problem.a.add_sizes(&self.now.z, &mut terms);
        let of = |i: usize| {
            let (normal, tangent) = (terms[3 * i + 2], terms[3 * i].max(terms[3 * i + 1]));
            [normal.max(self.now.apart[i]), tangent.max(self.now.slip[i]).max(f64::MIN_POSITIVE)]
        };
        (0..self.problem.len()).map(of).collect()
    }

    /// The Euclidean norm of all errors, of velocities relative to the sizes of their terms.
    fn norm(&self, aim: impl Fn(usize) -> [f64; 2], sizes: &[[f64; 2]]) -> f64 {
        let each = self.errors(aim).into_iter().zip(sizes);
        let of = |([normal, tangent, of_normal, of_tangent], size): ([f64; 4], &[f64; 2])| {
            (normal / size[0]).hypot(tangent / size[1]).hypot(of_normal).hypot(of_tangent)
        };
        each.map(of).fold(0.0, f64::hypot)
    }

    /// The largest error of a contact velocity, and that of rounding alone, relative to a velocity.
    fn relaxed_residual(&self, aims: &[[f64; 2]], scale: f64) -> (f64, f64) {
        let (mut worst, mut floor) = (0.0_f64, 0.0_f64);
        let each = self.errors(|i| aims[i]).into_iter().zip(self.sizes()).enumerate();
        for (i, ([normal, tangent, of_normal, of_tangent], size)) in each {
            let unit = self.problem.unit / self.problem.cone.lengths[i].sqrt() / scale;
            let (of_normal, of_tangent) = (of_normal * self.now.apart[i], of_tangent * self.now.slip[i]);
            let residual = (normal + of_normal).hypot(tangent + of_tangent) * unit;
            if residual > worst || residual.is_nan() {
                worst = residual;
            }
            floor = floor.max(16.0 * f64::EPSILON * size[0].max(size[1]) * unit);
        }
        (worst, floor)
    }
}

#[cfg(test)]
mod tests;
