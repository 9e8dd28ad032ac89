//! The solver: Newton's steps where they end it, an interior method where they do not, and a curve to follow where that ends nowhere either.

use super::interior::Interior;
use super::law::{Cone, Limits};
use super::newton::PROXIMAL;
use super::path::Path;
use super::report::{Effort, SolveReport};
use nalgebra::DVector;

/// Newton steps in a row, and how much each must take off the residual.
const STEPS: usize = 12;
const FALLS: f64 = 0.7;

/// Where the interior method begins, in numbers near one, and whether it is careful. The first is enough for most.
const STARTS: [(f64, bool); 3] = [(1.0, false), (100.0, false), (1.0, true)];

/// Its steps at the most; how many in a row may be all but none; and what a residual must have fallen to before Newton's steps are tried again.
const INSIDE: usize = 60;
const STUCK: usize = 8;
const ALL_BUT_NONE: f64 = 0.02;
const TRIED_AGAIN: f64 = 0.3;

/// How contacts are lifted at the start of the curve, and e there; steps along it, and after how many Newton's are tried.
const CURVES: [(f64, f64); 2] = [(2.0, 1e-2), (10.0, 1e-3)];
const ALONG: usize = 600;
const BETWEEN: usize = 10;

/// Friction above this is first taken as this: what it holds, more holds too.
const STRONG: f64 = 1000.0;

/// A residual that is small beside what a curve leaves: it ends in the same rounding.
const SMALL: f64 = 1e-6;

/// Compliance, in parts of 1/r, that makes impulses of redundant contacts unique; and less and less of it, where stiff ones need impulses that are
/// far from those.
const SPRINGS: f64 = 1e-6;
const STIFFER: [f64; 4] = [1e-8, 1e-10, 1e-12, 1e-14];

/// A solve under way: the best impulses so far.
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

    /// Takes note of impulses in the cones; their residual, none where they end the search.
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

    /// Newton steps for as long as the residual falls; whether they end the search, and whether `start` does.
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

    /// From impulses with which nothing moves, all that cannot be cut off.
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

    /// The interior method, with Newton's steps where they may end it.
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

    /// Along a curve to its end, then inside.
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

    /// From what the law makes of friction that is strong, where there is stronger.
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

    /// All ways, one after another, until one ends it.
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
    /// Impulses that meet the law for free velocities `c`, from `start` or from those that hold all; the best found, which are always in the cones,
    /// and how near they are.
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

    /// The impulses of least energy in equal springs at the contacts among those that meet the law: solved with compliance first, then as they are
    /// from there. Zero at once where all contacts part.
    ///
    /// Where redundant contacts would all stick but for a slip that is tiny beside the rest, impulses grow along what G does not see until one of
    /// them is at the edge of its cone and slips: compliance that becomes less and less leads there.
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
