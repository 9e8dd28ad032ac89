//! The solver: ADMM with De Saxce's correction, finished by Newton steps.

use super::law::{Cone, Limits};
use super::newton::PROXIMAL;
use super::told::{Effort, Told};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// One way to try: the penalty, whether it adapts, and the most iterations.
#[derive(Debug, Clone, Copy)]
struct Attempt {
    penalty: f64,
    adapts: bool,
    most: usize,
}

const fn attempt(penalty: f64, adapts: bool, most: usize) -> Attempt {
    Attempt { penalty, adapts, most }
}

/// What is tried in this order until the residual is met. The first is enough in 99.7 % of problems.
const ATTEMPTS: [Attempt; 5] = [
    attempt(0.1, false, 200),
    attempt(0.03, false, 400),
    attempt(0.1, true, 400),
    attempt(1.0, false, 400),
    attempt(0.01, false, 800),
];

/// Newton steps in a row, and how much each must take off the residual.
const STEPS: usize = 12;
const FALLS: f64 = 0.7;

/// Iterations between two tries of Newton's method.
const BETWEEN: usize = 8;

/// A residual so near the tolerance that another attempt would end in the same rounding.
const NEAR: f64 = 100.0;

/// Parts of 1/r that are tried where impulses have to travel, the steps of each, and the residual that is worth it.
const TRAVELS: [f64; 4] = [1e-7, 1e-6, 1e-8, 1e-5];
const TRAVEL_STEPS: usize = 60;
const WORTH_TRAVELLING: f64 = 1e-2;

/// Compliance, in parts of 1/r, that makes impulses of redundant contacts unique.
const SPRINGS: f64 = 1e-6;

/// A solve under way: the best impulses so far.
struct Search<'a> {
    cone: &'a Cone,
    c: &'a DVector<f64>,
    limits: &'a Limits,
    effort: Effort,
    best: DVector<f64>,
    told: Told,
}

impl Search<'_> {
    /// Takes note of impulses in the cones; whether they are good enough.
    fn take(&mut self, p: &DVector<f64>, residual: f64) -> bool {
        if residual < self.told.residual {
            self.best.copy_from(p);
            self.told.residual = residual;
        }
        self.told.floor = self.cone.floor(&self.best, self.c, self.limits);
        self.told.converged = self.told.residual <= self.effort.tolerance.max(self.told.floor);
        self.told.converged
    }

    /// Newton steps for as long as the residual falls; whether they end it.
    fn polish(&mut self, p: &DVector<f64>, mut residual: f64) -> bool {
        let mut p = p.clone();
        for _ in 0..STEPS.min(self.effort.iterations) {
            let Some(next) = self.cone.newton(&p, self.c, self.limits, PROXIMAL) else { return false };
            self.told.iterations += 1;
            let left = self.cone.residual(&next, self.c, self.limits);
            if !(left < FALLS * residual) {
                return false;
            }
            (p, residual) = (next, left);
            if self.take(&p, residual) {
                return true;
            }
        }
        false
    }

    /// Newton steps whose residual need not fall. Where redundant contacts would all stick but for a slip that is tiny beside the rest, impulses grow along what G
    /// does not see, with a residual that stays, until one of them is at the edge of its cone and slips.
    fn travel(&mut self) -> bool {
        if !(self.told.residual <= WORTH_TRAVELLING) {
            return false;
        }
        let start = self.best.clone();
        for proximal in TRAVELS {
            let mut p = start.clone();
            for _ in 0..TRAVEL_STEPS.min(self.effort.iterations) {
                let Some(next) = self.cone.newton(&p, self.c, self.limits, proximal) else { break };
                self.told.iterations += 1;
                let residual = self.cone.residual(&next, self.c, self.limits);
                if self.take(&next, residual) {
                    return true;
                }
                p = next;
            }
        }
        false
    }

    /// One attempt from `start`; whether it ends the search. In scaled numbers, A = w G w, p = w z, w = sqrt r: one number a contact, so that cones
    /// stay cones.
    fn attempt(&mut self, Attempt { penalty, adapts, most }: Attempt, start: &DVector<f64>) -> bool {
        let (cone, m) = (self.cone, start.len());
        let w = DVector::from_fn(m, |i, _| cone.lengths[i / 3].sqrt());
        let a = DMatrix::from_fn(m, m, |i, j| w[i] * cone.g[(i, j)] * w[j]);
        let c = self.c.component_mul(&w);
        let least: Vec<f64> = self.limits.least.iter().enumerate().map(|(i, least)| least / w[3 * i]).collect();
        let mut z = start.component_div(&w);
        let mut x = z.clone();
        // Its negative estimates the corrected velocity.
        let mut y = -(&a * &z + &c);
        let mut penalty = penalty;
        let mut factor: Option<Cholesky<f64, Dyn>> = None;
        for k in 1..=most.min(self.effort.iterations) {
            if factor.is_none() {
                let mut shifted = a.clone();
                for i in 0..m {
                    shifted[(i, i)] += penalty + PROXIMAL;
                }
                factor = shifted.cholesky();
            }
            let Some(solved) = &factor else { return false };
            let mut right = &z * penalty + &x * PROXIMAL - &c - &y;
            for i in 0..cone.len() {
                right[3 * i + 2] -= cone.friction[i] * y[3 * i].hypot(y[3 * i + 1]);
            }
            x = solved.solve(&right);
            let mut next = &x + &y / penalty;
            cone.project(&mut next, &least);
            let before = std::mem::replace(&mut z, next);
            y += (&x - &z) * penalty;
            self.told.iterations += 1;
            let mut p = z.component_mul(&w);
            // Scaling back may round them out of the cones.
            cone.project(&mut p, &self.limits.least);
            let residual = cone.residual(&p, self.c, self.limits);
            if self.take(&p, residual) || (k % BETWEEN == 0 && self.polish(&p, residual)) {
                return true;
            }
            if !residual.is_finite() {
                return false;
            }
            if adapts && k % 10 == 0 {
                let (apart, moved) = ((&x - &z).amax(), penalty * (&z - &before).amax());
                if apart > 10.0 * moved {
                    (penalty, factor) = (penalty * 4.0, None);
                } else if moved > 10.0 * apart {
                    (penalty, factor) = (penalty / 4.0, None);
                }
            }
        }
        false
    }
}

impl Cone {
    /// Impulses that meet the law for free velocities `c`, from `start` or from zero; the best found, which are always in the cones, and how near
    /// they are.
    pub fn solve(
        &self,
        c: &DVector<f64>,
        start: Option<&DVector<f64>>,
        limits: &Limits,
        effort: Effort,
    ) -> (DVector<f64>, Told) {
        let mut p = start.cloned().unwrap_or_else(|| DVector::zeros(c.len()));
        self.project(&mut p, &limits.least);
        let told = Told { residual: f64::INFINITY, ..Told::nothing() };
        let mut search = Search { cone: self, c, limits, effort, best: p.clone(), told };
        let residual = self.residual(&p, c, limits);
        let mut done = search.take(&p, residual) || (p.iter().any(|&p| p != 0.0) && search.polish(&p, residual));
        for (tried, &attempt) in ATTEMPTS.iter().take(effort.attempts).enumerate() {
            if done || (tried > 0 && search.told.residual <= NEAR * effort.tolerance) {
                break;
            }
            done = search.attempt(attempt, &p) || search.travel();
        }
        if !done && effort.attempts > ATTEMPTS.len() && search.told.residual > NEAR * effort.tolerance {
            self.follow(c, limits, &mut search);
        }
        (search.best, search.told)
    }

    /// Where all attempts failed, one problem in some thousands: from no friction up to mu, then from twice mu down to it.
    fn follow(&self, c: &DVector<f64>, limits: &Limits, search: &mut Search<'_>) {
        let once = Effort { attempts: 1, ..search.effort };
        let ways: [&[f64]; 2] = [&UP, &DOWN];
        for way in ways {
            let mut p: Option<DVector<f64>> = None;
            for part in way {
                let friction = self.friction.iter().map(|mu| part * mu).collect();
                let easier = Self { friction, ..self.clone() };
                let (next, told) = easier.solve(c, p.as_ref(), limits, once);
                search.told.iterations += told.iterations;
                p = Some(next);
            }
            let Some(p) = p else { continue };
            let residual = self.residual(&p, c, limits);
            if search.take(&p, residual) {
                break;
            }
        }
    }

    /// The impulses of least energy in equal springs at the contacts among those that meet the law: solved with compliance first, then as they are
    /// from there. Zero at once where all contacts part.
    pub fn impulses(
        &self,
        c: &DVector<f64>,
        start: Option<&DVector<f64>>,
        limits: &Limits,
        effort: Effort,
    ) -> (DVector<f64>, Told) {
        let parts = (0..self.len()).all(|i| c[3 * i + 2] >= 0.0 && limits.least[i] == 0.0);
        if parts {
            return (DVector::zeros(c.len()), Told::nothing());
        }
        let (near, first) = self.on_springs(SPRINGS).solve(c, start, limits, effort);
        let (p, told) = self.solve(c, Some(&near), limits, effort);
        (p, Told { iterations: first.iterations + told.iterations, ..told })
    }
}

/// Parts of mu, from none to all, and from twice to once.
const UP: [f64; 21] =
    [0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 1.0];
const DOWN: [f64; 11] = [2.0, 1.9, 1.8, 1.7, 1.6, 1.5, 1.4, 1.3, 1.2, 1.1, 1.0];
