//! Continuation along a curve for large coefficients of friction, for which the interior-point method with
//! monotonically decreasing e does not converge.
//!
//! All contacts are lifted with t times a velocity along each normal, and e = t times a small number in the law of
//! [`super::interior`]. At t = 1 all contacts are nearly open, and the solution is unique; at t = 0 the law is
//! Coulomb's. The solutions between form a curve on which t can temporarily increase. The curve is therefore
//! parametrized by its arc length, with each unknown scaled by its size, and not by t.

use super::interior::{Interior, Point};
use super::law::{Cone, Limits};
use super::scaled::Scaled;
use nalgebra::{DMatrix, DVector};

/// Largest distance of a point from the curve, relative to e; a tenth of that for velocities.
const BESIDE: f64 = 0.1;

/// Largest number of Newton steps back to the curve, and of reductions of a step along it.
const BACK: usize = 6;
const SHORTENINGS: usize = 40;

/// Smallest and largest factor by which a step changes a positive variable.
const FALLS: f64 = 0.1;
const GROWS: f64 = 10.0;

/// Value of t at which the continuation ends, and smallest length of a step.
const NEAR: f64 = 1e-6;
const NOWHERE: f64 = 1e-9;

/// A point of the curve: z, v and l of each contact, and t.
#[derive(Debug, Clone)]
pub(super) struct Path<'a> {
    problem: Scaled<'a>,
    /// Velocity by which contacts are lifted at t = 1, and e there.
    lift: f64,
    start: f64,
    x: DVector<f64>,
    /// Unit tangent of the curve, with each unknown relative to its size.
    tangent: DVector<f64>,
    length: f64,
}

/// F, its derivatives by the scaled unknowns, and the scales of the unknowns.
struct Slope {
    f: DVector<f64>,
    by_part: DMatrix<f64>,
    parts: DVector<f64>,
}

impl<'a> Path<'a> {
    /// The start of the curve, at which all contacts are nearly open.
    pub fn new(cone: &'a Cone, c: &DVector<f64>, limits: &Limits, (lift, start): (f64, f64)) -> Self {
        let problem = Scaled::new(cone, c, limits);
        let n = problem.len();
        let start = start * lift / (1.0 + cone.friction.iter().copied().fold(0.0, f64::max));
        let mut x = DVector::zeros(5 * n + 1);
        let mut tangent = DVector::zeros(5 * n + 1);
        (x[5 * n], tangent[5 * n]) = (1.0, -1.0);
        for i in 0..n {
            let (slides, apart) = (problem.c.fixed_rows::<2>(3 * i), problem.c[3 * i + 2] + lift);
            x[3 * n + i] = apart;
            x[3 * i + 2] = problem.least[i] + start / apart;
            let q = problem.cone.friction[i] * x[3 * i + 2];
            // l (1 - |u_t|^2/l^2) q = e
            let half = if q > 0.0 { 0.5 * start / q } else { 1.0 };
            let slip = half + half.hypot(slides.norm());
            x[4 * n + i] = slip;
            x[3 * i] = -q * slides[0] / slip;
            x[3 * i + 1] = -q * slides[1] / slip;
        }
        Self { problem, lift, start, x, tangent, length: 0.1 }
    }

    /// True if the continuation has ended, so that the interior-point method can take over.
    pub fn ends(&self) -> bool {
        self.x[5 * self.problem.len()] < NEAR || self.length < NOWHERE
    }

    pub fn impulses(&self, limits: &Limits) -> DVector<f64> {
        self.problem.impulses(&self.impulses_of(&self.x), limits)
    }

    /// The interior-point method at the current point.
    pub fn inside(self) -> Interior<'a> {
        let n = self.problem.len();
        let z = self.impulses_of(&self.x);
        let room = (0..n).map(|i| if self.problem.grips(i) { self.problem.room(i, &z) } else { 0.0 }).collect();
        let of = |from: usize| self.x.rows(from, n).iter().copied().collect();
        let now = Point { z, apart: of(3 * n), slip: of(4 * n), room };
        Interior::at(self.problem, now)
    }

    fn impulses_of(&self, x: &DVector<f64>) -> DVector<f64> {
        x.rows(0, 3 * self.problem.len()).into_owned()
    }

    /// Scale of each unknown: its value, y for `p_n`, and mu `p_n` for `p_t`.
    fn parts(&self, x: &DVector<f64>) -> DVector<f64> {
        let n = self.problem.len();
        DVector::from_fn(5 * n + 1, |k, _| match (k < 3 * n, k % 3) {
            (true, 2) => x[k] - self.problem.least[k / 3],
            (true, _) if self.problem.grips(k / 3) => self.problem.cone.friction[k / 3] * x[k / 3 * 3 + 2],
            (true, _) => 1.0,
            (false, _) => x[k],
        })
    }

    /// True if all positive variables are positive.
    fn is_inside(&self, x: &DVector<f64>, z: &DVector<f64>) -> bool {
        let n = self.problem.len();
        let above = (0..n).all(|i| self.problem.above(i, z) > 0.0);
        let in_cones = (0..n).all(|i| !self.problem.grips(i) || self.problem.room(i, z) > 0.0);
        above && in_cones && x.rows(3 * n, 2 * n + 1).iter().all(|&x| x > 0.0)
    }

    /// F of the law at t; the caller sets its last row.
    fn slope(&self, x: &DVector<f64>) -> Slope {
        let (n, z) = (self.problem.len(), self.impulses_of(x));
        let (size, lifted) = (5 * n + 1, x[5 * n]);
        let e = lifted * self.start;
        let u = self.problem.a.times(&z) + &self.problem.c;
        let mut f = DVector::zeros(size);
        let mut by_part = DMatrix::zeros(size, size);
        by_part.view_mut((0, 0), (3 * n, 3 * n)).copy_from(&*self.problem.a.dense());
        for i in 0..n {
            let at = 3 * i;
            let (above, apart, slip) = (self.problem.above(i, &z), x[3 * n + i], x[4 * n + i]);
            f[at + 2] = u[at + 2] + lifted * self.lift - apart;
            by_part[(at + 2, 3 * n + i)] = -1.0;
            by_part[(at + 2, 5 * n)] = self.lift;
            f[3 * n + i] = above * apart / e - 1.0;
            by_part[(3 * n + i, at + 2)] = apart / e;
            by_part[(3 * n + i, 3 * n + i)] = above / e;
            by_part[(3 * n + i, 5 * n)] = -above * apart / e / lifted;
            if !self.problem.grips(i) {
                for row in [at, at + 1, 4 * n + i] {
                    by_part.row_mut(row).fill(0.0);
                    by_part[(row, row)] = 1.0;
                }
                continue;
            }
            let (mu, q, pull) = (self.problem.cone.friction[i], self.problem.radius(i, &z), self.problem.pull(i, &z));
            let room = self.problem.room(i, &z);
            for row in 0..2 {
                f[at + row] = u[at + row] + slip * pull[row];
                by_part[(at + row, at + row)] += slip / q;
                by_part[(at + row, at + 2)] -= slip * pull[row] / q * mu;
                by_part[(at + row, 4 * n + i)] = pull[row];
                by_part[(4 * n + i, at + row)] = -2.0 * pull[row] * slip / e;
            }
            f[4 * n + i] = slip * room / e - 1.0;
            by_part[(4 * n + i, at + 2)] = mu * (1.0 + pull.norm_squared()) * slip / e;
            by_part[(4 * n + i, 4 * n + i)] = room / e;
            by_part[(4 * n + i, 5 * n)] = -slip * room / e / lifted;
        }
        let parts = self.parts(x);
        for (mut column, part) in by_part.column_iter_mut().zip(&parts) {
            column *= *part;
        }
        Slope { f, by_part, parts }
    }

    /// Distance from the curve, relative to e.
    fn beside(&self, x: &DVector<f64>, f: &DVector<f64>) -> f64 {
        let n = self.problem.len();
        let of = |i: usize| {
            let velocities = (f[3 * i + 2].abs() / x[3 * n + i]).max(f[3 * i].hypot(f[3 * i + 1]) / x[4 * n + i]);
            f[3 * n + i].abs().max(f[4 * n + i].abs()).max(10.0 * velocities)
        };
        (0..n).map(of).fold(0.0, |worst, of| if of > worst || of.is_nan() { of } else { worst })
    }

    /// x + dx, with `p_t` moved into the cones.
    fn moved(&self, x: &DVector<f64>, dx: &DVector<f64>) -> DVector<f64> {
        let (n, z, dz) = (self.problem.len(), self.impulses_of(x), self.impulses_of(dx));
        let mut next = &z + &dz;
        for i in (0..n).filter(|&i| self.problem.grips(i)) {
            let room = self.problem.room(i, &z) + self.problem.room_change(i, &z, &dz);
            self.problem.draw_in(i, &mut next, room);
        }
        let mut moved = x + dx;
        moved.rows_mut(0, 3 * n).copy_from(&next);
        moved
    }

    /// Newton steps perpendicular to the tangent until x is on the curve; returns whether that succeeds.
    fn back(&self, x: &mut DVector<f64>, tangent: &DVector<f64>, steps: &mut usize) -> bool {
        let last = x.len() - 1;
        let mut before = f64::INFINITY;
        for _ in 0..=BACK {
            let Slope { mut f, mut by_part, parts } = self.slope(x);
            let beside = self.beside(x, &f);
            if beside < BESIDE {
                return true;
            }
            if !(beside < before) {
                return false;
            }
            before = beside;
            by_part.row_mut(last).copy_from(&tangent.transpose());
            f[last] = 0.0;
            *steps += 1;
            let Some(step) = by_part.lu().solve(&f) else { return false };
            *x = self.moved(x, &-step.component_mul(&parts));
            if !self.is_inside(x, &self.impulses_of(x)) {
                return false;
            }
        }
        false
    }

    /// One step along the curve; returns whether it succeeds. `steps` counts factorizations.
    pub fn step(&mut self, steps: &mut usize) -> bool {
        let (n, last) = (self.problem.len(), self.x.len() - 1);
        let Slope { mut by_part, parts, .. } = self.slope(&self.x);
        by_part.row_mut(last).copy_from(&self.tangent.transpose());
        let along = DVector::from_fn(last + 1, |k, _| if k == last { 1.0 } else { 0.0 });
        *steps += 1;
        let Some(tangent) = by_part.lu().solve(&along) else { return false };
        let tangent = tangent.normalize();
        let z = self.impulses_of(&self.x);
        let signed = (0..=last).filter(|k| k % 3 == 2 || *k >= 3 * n).map(|k| tangent[k]);
        let (falls, grows) =
            signed.fold((0.0_f64, 0.0_f64), |(falls, grows), part| (falls.max(-part), grows.max(part)));
        let mut length = self.length.min((1.0 - FALLS) / falls).min((GROWS - 1.0) / grows);
        for _ in 0..SHORTENINGS {
            let mut x = self.moved(&self.x, &(tangent.component_mul(&parts) * length));
            let next = self.impulses_of(&x);
            let keeps_room = |i: usize| self.problem.room(i, &next) > FALLS * self.problem.room(i, &z);
            let inside = self.is_inside(&x, &next) && (0..n).all(|i| !self.problem.grips(i) || keeps_room(i));
            if inside && self.back(&mut x, &tangent, steps) {
                // The same direction in the scales of the new point.
                self.tangent = tangent.component_mul(&parts).component_div(&self.parts(&x)).normalize();
                self.length = 3.0 * length;
                self.x = x;
                return true;
            }
            length *= 0.4;
        }
        false
    }
}
