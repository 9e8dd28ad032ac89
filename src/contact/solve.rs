//! The solver: Newton's method; if it fails, an interior-point method; if that fails, continuation along a curve. For
//! redundant contacts an active-set method ends the solve.

use super::gram::Gram;
use super::held::Held;
use super::interior::Interior;
use super::law::{Cone, Limits};
use super::newton::{Known, PROXIMAL};
use super::path::Path;
use super::report::{Effort, SolveReport, TOLERANCE};
use nalgebra::{DVector, Matrix3};

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

/// Largest number of contacts whose curves are followed: a step factorizes a dense matrix of five rows for each.
const MOST_ALONG: usize = 64;

/// Coefficients of friction above this are first replaced by it: contacts that stick with it also stick with more
/// friction.
const STRONG: f64 = 1000.0;

/// A residual this small after the continuation cannot be improved by another curve.
const SMALL: f64 = 1e-6;

/// Compliance of equal springs, relative to their unit ([`Cone::spring`]), that makes the impulses of redundant
/// contacts unique; and decreasing compliances for stiff problems whose impulses are far from those.
const SPRINGS: f64 = 1e-6;
const STIFFER: [f64; 4] = [1e-8, 1e-10, 1e-12, 1e-14];

/// Number of Newton steps that remove the compliance from the impulses that determine rebounds. The springs are their
/// proximal term, because a smaller one would move impulses in the null space of G by rounding errors.
const CORRECTIONS: usize = 4;

/// Compliance of the springs of these steps, for which rounding errors of the shares are a tenth of those of the
/// others.
const SOFTER: f64 = 1e-5;

/// Impulses with at most this residual share their loads evenly, whatever their residual was before.
const ROUNDING: f64 = 1e-13;

/// The proximal term of Newton's method on springs, relative to their compliance. A larger one would determine the
/// rate of convergence.
const BESIDE_SPRINGS: f64 = 1e-2;

/// Impulses on springs with a residual below this are tried as a start before the springs are solved by the slower
/// methods.
const CLOSE: f64 = 1e-3;

/// The proximal term of the active-set method relative to the residual, and its smallest value. The velocities in the
/// null space of G are as large as the residual, so that a step can move the impulses by a multiple of their size.
const BY_RESIDUAL: f64 = 1e-2;
const LEAST_PROXIMAL: f64 = 1e-14;

/// The active-set method ends without success at a residual above this.
const FAR: f64 = 0.1;

/// Velocity, relative to the scale, that is added to the normal of a contact that the active-set method opens.
const OPENED: f64 = 1e3;

/// A solve in progress, with the best impulses so far.
struct Search<'a> {
    cone: &'a Cone,
    c: &'a DVector<f64>,
    limits: &'a Limits,
    effort: Effort,
    /// Compliance of the springs in the matrices of Newton's method, and the last factor.
    proximal: f64,
    known: Known,
    best: DVector<f64>,
    solved: SolveReport,
}

impl<'a> Search<'a> {
    fn new(cone: &'a Cone, c: &'a DVector<f64>, limits: &'a Limits, effort: Effort) -> Self {
        let solved = SolveReport { residual: f64::INFINITY, converged: false, ..SolveReport::nothing() };
        let mut best = DVector::zeros(c.len());
        cone.project(&mut best, &limits.least);
        Self { cone, c, limits, effort, proximal: PROXIMAL, known: Known::default(), best, solved }
    }

    /// Updates the best impulses; returns the residual, or `None` if it meets the tolerance.
    fn left(&mut self, p: &DVector<f64>) -> Option<f64> {
        let x = self.cone.targets(p, self.c);
        let residual = self.cone.residual_at(p, &x, self.limits);
        if residual < self.solved.residual {
            self.best.copy_from(p);
            self.solved.residual = residual;
            self.solved.converged =
                residual <= self.effort.tolerance || residual <= self.cone.floor_at(p, (self.c, &x), self.limits);
        }
        (!self.solved.converged).then_some(residual)
    }

    /// A Newton step; `None` if its matrix is singular.
    fn step(&mut self, p: &DVector<f64>) -> Option<DVector<f64>> {
        self.cone.newton(p, self.c, self.limits, (self.proximal, &mut self.known))
    }

    /// Newton steps while the residual decreases; returns whether the tolerance is met.
    fn polish(&mut self, start: &DVector<f64>) -> bool {
        let Some(mut residual) = self.left(start) else { return true };
        let mut p = start.clone();
        for _ in 0..STEPS.min(self.effort.iterations) {
            let Some(next) = self.step(&p) else { return false };
            self.solved.iterations += 1;
            let Some(left) = self.left(&next) else {
                // A larger proximal term leaves an error that is within the tolerance, but not rounding.
                if self.proximal > PROXIMAL
                    && let Some(last) = self.step(&next)
                {
                    self.left(&last);
                }
                return true;
            };
            if !(left < FALLS * residual) {
                return false;
            }
            (p, residual) = (next, left);
        }
        false
    }

    /// Active-set method for redundant contacts whose velocities without impulses are slightly inconsistent, such as
    /// those of four corners with gaps of rounding size; returns whether the tolerance is met.
    ///
    /// Velocities in the null space of G do not depend on the impulses, so that a contact has to open. Newton steps
    /// with a small proximal term move the impulses in the null space until the first normal impulse is zero; that
    /// contact remains open until the others are solved, and closes again if it approaches its surface.
    fn open_in_turn(&mut self, start: &DVector<f64>) -> bool {
        let (mut p, mut c, n) = (start.clone(), self.c.clone(), self.cone.len());
        let (mut open, mut least) = (vec![false; n], f64::INFINITY);
        for _ in 0..(3 * n + 6).min(self.effort.iterations) {
            let residual = self.cone.residual(&p, &c, self.limits);
            if !(residual <= FAR) {
                return false;
            }
            if residual <= self.effort.tolerance || residual <= self.cone.floor(&p, &c, self.limits) {
                let u = self.cone.velocities(&p, self.c);
                let closing: Vec<usize> = (0..n).filter(|&i| open[i] && u[3 * i + 2] < 0.0).collect();
                if closing.is_empty() {
                    return false;
                }
                for i in closing {
                    (open[i], c[3 * i + 2]) = (false, self.c[3 * i + 2]);
                }
                least = f64::INFINITY;
                continue;
            }
            // Between the steps, the residual is temporarily larger because directions of slip change.
            least = least.min(residual);
            let proximal = (BY_RESIDUAL * least).clamp(LEAST_PROXIMAL, PROXIMAL);
            let step = self.cone.newton_to_bound(&p, &c, self.limits, proximal);
            let Some((next, first)) = step else { return false };
            self.solved.iterations += 1;
            if self.left(&next).is_none() {
                return true;
            }
            p = next;
            if let Some(i) = first.filter(|&i| self.limits.least[i] == 0.0) {
                (open[i], least) = (true, f64::INFINITY);
                c[3 * i + 2] += OPENED * self.limits.scale;
            }
        }
        false
    }

    /// Newton's method and the active-set method.
    fn finish(&mut self, start: &DVector<f64>) -> bool {
        self.polish(start) || {
            let best = self.best.clone();
            self.open_in_turn(&best)
        }
    }

    /// Starts from the impulses for which all contacts stick, as far as they are in their cones.
    fn stick(&mut self) -> bool {
        let held = vec![(Matrix3::zeros(), Matrix3::identity()); self.cone.len()];
        self.solved.iterations += 1;
        let factor = self.cone.g.factor(&held, PROXIMAL * self.cone.spring);
        let Some(solved) = factor.and_then(|factor| factor.solve(self.c)) else { return false };
        let mut p = -solved;
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
        if !self.newton(start) {
            self.globally();
        }
    }

    /// Newton's method, from `start` and from contacts that stick.
    fn newton(&mut self, start: Option<&DVector<f64>>) -> bool {
        // Many contacts without impulses rest on each other: they are more likely to stick than to open.
        let is_cold = matches!(self.cone.g, Gram::Rows { .. }) && start.is_some_and(|start| start.amax() == 0.0);
        let start = start.filter(|_| !is_cold).map(|start| {
            let mut start = start.clone();
            self.cone.project(&mut start, &self.limits.least);
            start
        });
        start.is_some_and(|start| self.polish(&start)) || self.stick()
    }

    /// The methods that converge from any start.
    fn globally(&mut self) {
        if self.weaker() {
            return;
        }
        for &start in STARTS.iter().take(self.effort.attempts) {
            if self.inside(Interior::new(self.cone, self.c, self.limits, start)) {
                return;
            }
        }
        if self.effort.attempts <= STARTS.len() || self.cone.len() > MOST_ALONG {
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
    /// If the velocities of redundant contacts are inconsistent by less than the compliance, not all of them can be
    /// pressed: the active-set method opens some. If they would all stick except for a slip that is tiny compared with
    /// the other velocities, impulses grow in the null space of G until a contact reaches the boundary of its cone and
    /// slips; gradually decreasing compliance finds these impulses.
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
        // A smaller proximal term would move the impulses in the null space of G by rounding errors.
        search.proximal = SPRINGS;
        let on_springs = self.on_springs(SPRINGS);
        let mut springs = Search::new(&on_springs, c, limits, effort);
        // Its matrices are those of the other search.
        springs.proximal = 0.0;
        let mut done = springs.newton(start);
        search.known = std::mem::take(&mut springs.known);
        done = (done || springs.solved.residual < CLOSE) && search.finish(&springs.best);
        if !done && !springs.solved.converged {
            springs.globally();
            done = search.finish(&springs.best);
        }
        search.solved.iterations += springs.solved.iterations;
        let mut near = springs.best;
        for part in STIFFER.iter().take(effort.attempts) {
            if done {
                break;
            }
            let stiffer = self.on_springs(*part);
            let mut springs = Search::new(&stiffer, c, limits, effort);
            springs.proximal = BESIDE_SPRINGS * part;
            springs.run(Some(&near));
            search.solved.iterations += springs.solved.iterations;
            near = springs.best;
            done = search.finish(&near);
        }
        (search.best, search.solved)
    }
    /// Impulses that satisfy the law, with the precision that rounding allows. Those of redundant contacts are
    /// otherwise those of equal springs up to the tolerance over the compliance, and each determines the rebound of its
    /// contact.
    pub fn shared_evenly(&self, p: DVector<f64>, c: &DVector<f64>, limits: &Limits) -> DVector<f64> {
        let springs = self.on_springs(SOFTER);
        let soft = springs.polished(&p, c, limits).filter(|(_, left)| *left <= TOLERANCE);
        let corrected = soft.and_then(|(soft, _)| {
            let mut known = Known::default();
            let correct = |p: DVector<f64>, _| self.newton(&p, c, limits, (SOFTER, &mut known));
            let on_springs = springs.modes(&soft, c, limits);
            let p = (0..CORRECTIONS).try_fold(soft, correct)?;
            // On springs, a contact slides that sticks at the boundary of its cone.
            let is_inside = self.modes(&p, c, limits) == on_springs;
            Some((p, is_inside))
        });
        let at_boundary = || {
            self.shared_at_boundary(&p, c, limits).or_else(|| {
                let springs = self.on_springs(SPRINGS);
                let mut search = Search::new(&springs, c, limits, Effort::default());
                search.globally();
                self.shared_at_boundary(&search.best, c, limits)
            })
        };
        let shared = match corrected {
            Some((p, true)) => Some(p),
            corrected => at_boundary().or(corrected.map(|(p, _)| p)),
        };
        let most = self.residual(&p, c, limits).max(self.floor(&p, c, limits)).max(ROUNDING);
        shared.filter(|shared| self.residual(shared, c, limits) <= most).unwrap_or(p)
    }
}
