//! The solver: Newton's method; if it fails, an interior-point method; if that fails, continuation along a curve.

use super::held::Held;
use super::interior::Interior;
use super::law::{Cone, Limits};
use super::newton::PROXIMAL;
use super::path::Path;
use super::report::{Effort, SolveReport};
use nalgebra::DVector;

/// Largest number of consecutive Newton steps, and the factor by which each must reduce the residual.
const STEPS: usize = 12;
const FALLS: f64 = 0.7;

/// Starts of the interior-point method in scaled variables: height, and whether it is careful. The first one usually
/// suffices.
const STARTS: [(f64, bool); 3] = [(1.0, false), (100.0, false), (1.0, true)];

/// Largest number of steps of the interior-point method; largest number of consecutive steps whose fraction is below
/// the next constant; and the factor by which the residual must decrease before Newton's method is tried again.
const INSIDE: usize = 60;
const STUCK: usize = 8;
const ALL_BUT_NONE: f64 = 0.02;
const TRIED_AGAIN: f64 = 0.3;

/// Lift and e at the start of the curves; largest number of steps along a curve; number of steps between trials of
/// Newton's method.
const CURVES: [(f64, f64); 2] = [(2.0, 1e-2), (10.0, 1e-3)];
const ALONG: usize = 600;
const BETWEEN: usize = 10;

/// Coefficients of friction above this are first replaced by it: contacts that stick with it also stick with more
/// friction.
const STRONG: f64 = 1000.0;

/// A residual this small after the continuation cannot be improved by another curve.
const SMALL: f64 = 1e-6;

/// Compliance, relative to 1/r, that makes the impulses of redundant contacts unique; and decreasing compliances for
/// stiff problems whose impulses are far from those.
const SPRINGS: f64 = 1e-6;
const STIFFER: [f64; 4] = [1e-8, 1e-10, 1e-12, 1e-14];

/// A solve in progress, with the best impulses so far.
struct Search<'a> {
    cone: &'a Cone,
    c: &'a DVector<f64>,
    limits: &'a Limits,
    effort: Effort,
    best: DVector<f64>,
    solved: SolveReport,
}

impl<'a> Search<'a> {
    fn new(cone: &'a Cone, c: &'a DVector<f64>, limits: &'a Limits, effort: Effort) -> Self {
        let solved = SolveReport { residual: f64::INFINITY, converged: false, ..SolveReport::nothing() };
        let mut best = DVector::zeros(c.len());
        cone.project(&mut best, &limits.least);
        Self { cone, c, limits, effort, best, solved }
    }

    /// Updates the best impulses; returns the residual, or `None` if it meets the tolerance.
    fn left(&mut self, p: &DVector<f64>) -> Option<f64> {
        let residual = self.cone.residual(p, self.c, self.limits);
        if residual < self.solved.residual {
            self.best.copy_from(p);
            self.solved.residual = residual;
            self.solved.floor = self.cone.floor(p, self.c, self.limits);
            self.solved.converged = residual <= self.effort.tolerance.max(self.solved.floor);
        }
        (!self.solved.converged).then_some(residual)
    }

    /// Newton steps while the residual decreases; returns whether the tolerance is met.
    fn polish(&mut self, start: &DVector<f64>) -> bool {
        let Some(mut residual) = self.left(start) else { return true };
        let mut p = start.clone();
        for _ in 0..STEPS.min(self.effort.iterations) {
            let Some(next) = self.cone.newton(&p, self.c, self.limits, PROXIMAL) else { return false };
            self.solved.iterations += 1;
            let Some(left) = self.left(&next) else { return true };
            if !(left < FALLS * residual) {
                return false;
            }
            (p, residual) = (next, left);
        }
        false
    }

    /// Starts from the impulses for which all contacts stick, as far as they are in their cones.
    fn stick(&mut self) -> bool {
        let mut g = self.cone.g.clone();
        for i in 0..g.nrows() {
            g[(i, i)] += PROXIMAL / self.cone.lengths[i / 3];
        }
        self.solved.iterations += 1;
        let Some(solved) = g.cholesky() else { return false };
        let mut p = -solved.solve(self.c);
        self.cone.project(&mut p, &self.limits.least);
        self.polish(&p)
    }

    /// The interior-point method, with Newton's method when the residual has decreased enough.
    fn inside(&mut self, mut inside: Interior<'_>) -> bool {
        let (mut tried, mut stuck) = (f64::INFINITY, 0);
        for _ in 0..INSIDE.min(self.effort.iterations) {
            let Some(made) = inside.step() else { return false };
            self.solved.iterations += 1;
            stuck = if made < ALL_BUT_NONE { stuck + 1 } else { 0 };
            let p = inside.impulses(self.limits);
            let Some(residual) = self.left(&p) else { return true };
            if residual < TRIED_AGAIN * tried {
                tried = residual;
                if self.polish(&p) {
                    return true;
                }
            }
            if stuck > STUCK {
                return false;
            }
        }
        false
    }

    /// Continuation along a curve to its end, then the interior-point method.
    fn follow(&mut self, curve: (f64, f64)) -> bool {
        let mut path = Path::new(self.cone, self.c, self.limits, curve);
        let mut tried = f64::INFINITY;
        for k in 1..=ALONG {
            if !path.step(&mut self.solved.iterations) || path.ends() {
                return self.inside(path.inside());
            }
            let p = path.impulses(self.limits);
            let Some(residual) = self.left(&p) else { return true };
            if residual < TRIED_AGAIN * tried || k % BETWEEN == 0 {
                tried = residual;
                if self.polish(&p) {
                    return true;
                }
            }
        }
        false
    }

    /// Starts from the solution with reduced friction, if coefficients of friction are very large.
    fn weaker(&mut self) -> bool {
        if self.effort.attempts <= STARTS.len() || self.cone.friction.iter().all(|&mu| mu <= STRONG) {
            return false;
        }
        let friction = self.cone.friction.iter().map(|mu| mu.min(STRONG)).collect();
        let weaker = Cone { friction, ..self.cone.clone() };
        let (p, solved) = weaker.solve(self.c, None, self.limits, self.effort);
        self.solved.iterations += solved.iterations;
        self.polish(&p)
    }

    /// Tries all methods in turn until one meets the tolerance.
    fn run(&mut self, start: Option<&DVector<f64>>) {
        let start = start.map(|start| {
            let mut start = start.clone();
            self.cone.project(&mut start, &self.limits.least);
            start
        });
        if start.is_some_and(|start| self.polish(&start)) || self.stick() {
            return;
        }
        if self.weaker() {
            return;
        }
        for &start in STARTS.iter().take(self.effort.attempts) {
            if self.inside(Interior::new(self.cone, self.c, self.limits, start)) {
                return;
            }
        }
        if self.effort.attempts <= STARTS.len() {
            return;
        }
        for curve in CURVES {
            if self.solved.residual < SMALL || self.follow(curve) {
                return;
            }
        }
    }
}

impl Cone {
    /// Impulses that satisfy the law for free velocities `c`, started from `start` or from sticking contacts. Returns
    /// the best impulses found, which are always in the cones, and a report.
    pub fn solve(
        &self,
        c: &DVector<f64>,
        start: Option<&DVector<f64>>,
        limits: &Limits,
        effort: Effort,
    ) -> (DVector<f64>, SolveReport) {
        let mut search = Search::new(self, c, limits, effort);
        search.run(start);
        (search.best, search.solved)
    }

    /// Among the impulses that satisfy the law, those of least energy in equal springs at the contacts.
    ///
    /// If G is regular, they are unique: those of contacts that all stick take one solve with a Cholesky factor, others
    /// start from `start`. If G is singular, first solves with compliance, then without it from that solution. Returns
    /// zero at once if all contacts separate.
    /// If redundant contacts would all stick except for a slip that is tiny compared with the other velocities,
    /// impulses grow in the null space of G until a contact reaches the boundary of its cone and slips; gradually
    /// decreasing compliance finds these impulses.
    pub fn impulses(
        &self,
        c: &DVector<f64>,
        start: Option<&DVector<f64>>,
        limits: &Limits,
        effort: Effort,
    ) -> (DVector<f64>, SolveReport) {
        let parts = (0..self.len()).all(|i| c[3 * i + 2] >= 0.0 && limits.least[i] == 0.0);
        if parts {
            return (DVector::zeros(c.len()), SolveReport::nothing());
        }
        let mut search = Search::new(self, c, limits, effort);
        if limits.least.iter().all(|&a| a == 0.0)
            && let Some(held) = Held::of(self)
        {
            // The impulses are unique.
            let stuck = self.may_stick(start).then(|| {
                let mut p = held.impulses(c);
                self.project(&mut p, &limits.least);
                p
            });
            search.solved.iterations += 1;
            if stuck.is_some_and(|p| search.left(&p).is_none()) {
                return (search.best, search.solved);
            }
            search.run(start);
            if search.solved.converged {
                return (search.best, search.solved);
            }
        }
        let (mut near, first) = self.on_springs(SPRINGS).solve(c, start, limits, effort);
        search.solved.iterations += first.iterations;
        let mut done = search.polish(&near);
        for part in STIFFER.iter().take(effort.attempts) {
            if done {
                break;
            }
            let (next, solved) = self.on_springs(*part).solve(c, Some(&near), limits, effort);
            search.solved.iterations += solved.iterations;
            done = search.polish(&next);
            near = next;
        }
        (search.best, search.solved)
    }
}
