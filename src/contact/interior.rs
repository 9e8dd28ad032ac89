//! Interior-point method for the exact contact law: Newton steps on a perturbed law in which every contact is slightly
//! open and slips slightly inside its friction cone.
//!
//! With y = `p_n` - a, q = mu `p_n`, the distance from the cone s = q - |`p_t`|^2/q, a normal velocity v and a slip
//! speed l as additional unknowns, all of them positive:
//!
//! ```text
//! v = u_n,     u_t = -l p_t/q,     y v = e,     l s = e
//! ```
//!
//! For e = 0 this is Coulomb's law with friction opposite to slip. Cones are not approximated by polyhedra, and the law
//! is not modified to that of an optimization problem. A step aims at a smaller e, which is the smaller the longer the
//! step with e = 0 could be (S. Mehrotra, SIAM Journal on Optimization 2, 1992, 575-601). y, v, l and s remain
//! positive. Redundant contacts and large mass ratios are admissible.

use super::gram::Factor;
use super::law::{Cone, Limits};
use super::scaled::Scaled;
use nalgebra::{DVector, Matrix3};

/// Smallest fraction of a positive variable that remains after a step.
const KEPT: f64 = 0.005;

/// Largest number of halvings of a step whose nonlinearity increases the violation of the velocity equations.
const HALVINGS: usize = 12;

/// An interior point.
#[derive(Debug, Clone)]
pub(super) struct Interior<'a> {
    pub problem: Scaled<'a>,
    pub now: Point,
    /// True if e stays constant while velocities and impulses disagree: slower, but it converges in some other cases.
    pub careful: bool,
}

/// Impulses, and the additional variables of each contact.
#[derive(Debug, Clone)]
pub(super) struct Point {
    pub z: DVector<f64>,
    /// v, l and s of each contact.
    pub apart: Vec<f64>,
    pub slip: Vec<f64>,
    pub room: Vec<f64>,
}

impl<'a> Interior<'a> {
    /// Starts in the middle of each cone, with all normal impulses `height` above their lower bound.
    pub fn new(cone: &'a Cone, c: &DVector<f64>, limits: &Limits, start: (f64, bool)) -> Self {
        Self::central(Scaled::new(cone, c, limits), start)
    }

    /// The same for a scaled problem.
    pub fn central(problem: Scaled<'a>, (height, careful): (f64, bool)) -> Self {
        let n = problem.len();
        let z = DVector::from_fn(3 * n, |i, _| if i % 3 == 2 { problem.least[i / 3] + height } else { 0.0 });
        let room = (0..n).map(|i| problem.radius(i, &z)).collect();
        Self { problem, now: Point { z, apart: vec![height; n], slip: vec![height; n], room }, careful }
    }

    /// Starts at a given interior point.
    pub fn at(problem: Scaled<'a>, now: Point) -> Self {
        Self { problem, now, careful: false }
    }

    pub fn impulses(&self, limits: &Limits) -> DVector<f64> {
        self.problem.impulses(&self.now.z, limits)
    }

    /// Mean of the products y v and l s.
    pub fn gap(&self) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for i in 0..self.problem.len() {
            sum += self.problem.above(i, &self.now.z) * self.now.apart[i];
            count += 1.0;
            if self.problem.grips(i) {
                sum += self.now.slip[i] * self.now.room[i];
                count += 1.0;
            }
        }
        sum / count
    }

    /// Largest violation of the equations between velocities and v, l.
    pub fn disagreement(&self) -> f64 {
        let Point { z, apart, slip, .. } = &self.now;
        let u = self.problem.a.times(z) + &self.problem.c;
        let of = |i: usize| {
            let normal = (u[3 * i + 2] - apart[i]).abs();
            if !self.problem.grips(i) {
                return normal;
            }
            let slides = self.problem.pull(i, z) * slip[i];
            normal.max((u[3 * i] + slides[0]).hypot(u[3 * i + 1] + slides[1]))
        };
        (0..self.problem.len()).map(of).fold(0.0, f64::max)
    }

    /// The factor of the matrix of a step after elimination of v, l and s; `None` if it is singular.
    pub fn slope(&self) -> Option<Factor> {
        let Point { z, apart, slip, room } = &self.now;
        let of = |i: usize| {
            let (mut a, mut b) = (Matrix3::zeros(), Matrix3::identity());
            a[(2, 2)] = apart[i] / self.problem.above(i, z);
            if !self.problem.grips(i) {
                (a[(0, 0)], a[(1, 1)], b[(0, 0)], b[(1, 1)]) = (1.0, 1.0, 0.0, 0.0);
                return (a, b);
            }
            let (mu, q, pull) = (self.problem.cone.friction[i], self.problem.radius(i, z), self.problem.pull(i, z));
            for row in 0..2 {
                a[(row, row)] = slip[i] / q;
                for column in 0..2 {
                    a[(row, column)] += 2.0 * slip[i] / room[i] * pull[row] * pull[column];
                }
                a[(row, 2)] = -(slip[i] * mu * pull[row] * (1.0 / q + (1.0 + pull.norm_squared()) / room[i]));
            }
            (a, b)
        };
        let blocks: Vec<_> = (0..self.problem.len()).map(of).collect();
        self.problem.a.factor(&blocks, 0.0)
    }

    /// The Newton step toward y v and l s with the given values for each contact.
    pub fn towards(&self, slope: &Factor, aim: impl Fn(usize) -> [f64; 2]) -> Option<Point> {
        let Point { z, apart, slip, room } = &self.now;
        let n = self.problem.len();
        let mut right = -(self.problem.a.times(z) + &self.problem.c);
        for i in 0..n {
            let [normal, tangent] = aim(i);
            right[3 * i + 2] += normal / self.problem.above(i, z);
            let pull = if self.problem.grips(i) { self.problem.pull(i, z) * (tangent / room[i]) } else { continue };
            right[3 * i] -= pull[0];
            right[3 * i + 1] -= pull[1];
        }
        for i in (0..n).filter(|&i| !self.problem.grips(i)) {
            right.fixed_rows_mut::<2>(3 * i).fill(0.0);
        }
        let dz = slope.solve(&right)?;
        if !dz.iter().all(|x| x.is_finite()) {
            return None;
        }
        let mut step = Point { z: dz, apart: vec![0.0; n], slip: vec![0.0; n], room: vec![0.0; n] };
        for i in 0..n {
            let ([normal, tangent], above) = (aim(i), self.problem.above(i, z));
            step.apart[i] = normal / above - apart[i] - apart[i] / above * step.z[3 * i + 2];
            if self.problem.grips(i) {
                step.room[i] = self.problem.room_change(i, z, &step.z);
                step.slip[i] = tangent / room[i] - slip[i] - slip[i] / room[i] * step.room[i];
            }
        }
        Some(step)
    }

    /// The largest fraction of a step for which all variables remain positive, to first order.
    pub fn reach(&self, step: &Point) -> f64 {
        let mut reach: f64 = 1.0;
        let mut limit = |now: f64, change: f64| {
            if change < 0.0 {
                reach = reach.min(-(1.0 - KEPT) * now / change);
            }
        };
        for i in 0..self.problem.len() {
            limit(self.problem.above(i, &self.now.z), step.z[3 * i + 2]);
            limit(self.now.apart[i], step.apart[i]);
            if self.problem.grips(i) {
                limit(self.now.slip[i], step.slip[i]);
                limit(self.now.room[i], step.room[i]);
            }
        }
        reach
    }

    /// Makes one step and returns its fraction; `None` if the matrix is singular.
    pub fn step(&mut self) -> Option<f64> {
        let slope = self.slope()?;
        let (gap, before) = (self.gap(), self.disagreement());
        let free = self.reach(&self.towards(&slope, |_| [0.0; 2])?);
        let waits = self.careful && gap < 1e-2 && before > gap.sqrt();
        let part = if waits { 1.0 } else { (1.0 - free).powi(3).clamp(1e-4, 0.9) };
        let step = self.towards(&slope, |_| [part * gap; 2])?;
        Some(self.advance(&step, gap, before))
    }

    /// Moves along a step as far as all variables remain positive and its nonlinearity does not increase the violation
    /// `before` of the velocity equations; returns the fraction.
    pub fn advance(&mut self, step: &Point, gap: f64, before: f64) -> f64 {
        let mut made = self.reach(step);
        let start = self.now.clone();
        // A violation of first order has the size of the gap; a larger one is an effect of the step.
        let most = 10.0 * before.max(0.1 * gap.sqrt().min(1.0));
        for halving in 0..=HALVINGS {
            self.go(&start, step, made);
            if halving == HALVINGS || self.disagreement() <= most {
                break;
            }
            made *= 0.5;
        }
        made
    }

    /// Moves to `start` + `made` * `step`.
    pub fn go(&mut self, start: &Point, step: &Point, made: f64) {
        self.now.z = &start.z + &step.z * made;
        for i in 0..self.problem.len() {
            self.now.apart[i] = start.apart[i] + made * step.apart[i];
            if self.problem.grips(i) {
                self.now.slip[i] = start.slip[i] + made * step.slip[i];
                let room = start.room[i] + made * step.room[i];
                self.now.room[i] = self.problem.draw_in(i, &mut self.now.z, room);
            }
        }
    }
}
