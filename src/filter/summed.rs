//! Outputs that are weighted sums of rows. A sum is measured when all of its rows have been processed.
//!
//! Output s is `y_s = sum over its rows i of w_i (H_i z + v_i)`. The sweep tip to base processes these rows one after
//! another, often on different branches. It propagates the partial sum `u_s` together with the six scalars of the
//! state: a filter of the augmented state (z, u), whose covariance has the blocks P = cov(z), C = cov(z, u) and S =
//! cov(u). At the last row, or where the branches meet, u_s is measured like a state:
//!
//! - a row of the sum adds to it: `u_s += w H z`, so C_s += w P H^T, S_st += w H C_t,
//!   `S_ss += 2 w H C_s + w^2 (H P H^T + r)`;
//! - a complete sum is measured: `D = S_ss`, gains C_s / D of z and S_st / D of the other sums, as in (3.6, 3.10, 4.2,
//!   4.5);
//! - base to tip, its estimate `a_s = e_s / D - g* lambda - sum over t of g_t a_t` (4.9) is computed before its rows,
//!   each of which has `a_i = w_i a_s` (4.11).
//!
//! The estimates are those of the system with measurement rows G^T H phi, for joints with `qdd = G a`: (G^T M G)^-1 in
//! O(N + number of propagated sums).
//!
//! ```
//! use phipsi::filter::summed::Sums;
//! use phipsi::filter::{HingeMap, Rows, Stage, System};
//! // Two rows on branches of a third stage, measured together as y = x_1 - 2 x_2.
//! let stage = |parent, first_row| Stage { parent, rows: Rows::One(HingeMap::Axis(2)), first_row };
//! let system = System { stages: vec![stage(None, 0), stage(Some(0), 1), stage(Some(0), 2)], noise: vec![0.0; 3] };
//! let sums = Sums::new(&system, &[vec![(1, 1.0), (2, -2.0)]]);
//! assert_eq!(sums.count(), 1);
//! ```

use super::pivots::{Evidence, LostPivot, PIVOT_MARGIN, PivotMonitor, Scale, first_lost};
use super::riccati::{self, Measured};
use super::system::{HingeMap, System};
use crate::scalar::Real;
use crate::spatial::{RigidShift, Symmetric6, dot, scaled, scaled_add, sum, zero};
use nalgebra::Vector6;
use std::collections::BTreeSet;

/// The rows that are measured together, and their stages.
#[derive(Debug, Clone, PartialEq)]
pub struct Sums {
    /// For each row its sum and its weight; None if it is measured alone.
    of_row: Vec<Option<(usize, f64)>>,
    /// All stages, and one more for the base, at which sums over different roots end.
    stages: Vec<Waiting>,
    count: usize,
}

/// The active sums of one stage.
#[derive(Debug, Clone, PartialEq, Default)]
struct Waiting {
    /// Sums with rows at the stage or outboard of it that are not complete outboard of it.
    active: Vec<usize>,
    /// Sums that are complete where the branches meet, before the rows of the stage.
    complete_on_arrival: Vec<usize>,
    /// The sum that is complete with the row of the stage.
    complete_with_row: Option<usize>,
    /// The first index of the stage's values, one per active sum, and of its square blocks.
    first: usize,
    first_square: usize,
}

impl Waiting {
    /// True if a sum is propagated to the parent.
    fn passes_on(&self, sum: usize) -> bool {
        self.complete_with_row != Some(sum) && !self.complete_on_arrival.contains(&sum)
    }

    fn place(&self, sum: usize) -> Option<usize> {
        self.active.iter().position(|&active| active == sum)
    }
}

impl Sums {
    /// Sums of rows by (row, weight). A row is in at most one sum and is the only row of its stage.
    #[must_use]
    pub fn new<T: Real>(system: &System<T>, sums: &[Vec<(usize, f64)>]) -> Self {
        let base = system.stages.len();
        let mut of_row = vec![None; system.rows()];
        let mut stages = vec![Waiting::default(); base + 1];
        let stage_of = |row: usize| system.stages.partition_point(|stage| stage.first_row <= row) - 1;
        for (s, rows) in sums.iter().enumerate() {
            let mut at: Vec<usize> = Vec::with_capacity(rows.len());
            for &(row, weight) in rows {
                of_row[row] = Some((s, weight));
                // Stages without rows share the first row of the next.
                at.push(stage_of(row));
            }
            // Parents precede children: the stage with the largest index is no ancestor of the others.
            let mut front: BTreeSet<Option<usize>> = at.iter().copied().map(Some).collect();
            let met = loop {
                // The base, None, is the ancestor of all stages.
                let latest = front.pop_last().flatten();
                if front.is_empty() {
                    break latest.unwrap_or(base);
                }
                let Some(stage) = latest else { continue };
                stages[stage].active.push(s);
                front.insert(system.stages[stage].parent);
            };
            stages[met].active.push(s);
            if at.contains(&met) {
                stages[met].complete_with_row = Some(s);
            } else {
                stages[met].complete_on_arrival.push(s);
            }
        }
        let (mut first, mut first_square) = (0, 0);
        for stage in &mut stages {
            (stage.first, stage.first_square) = (first, first_square);
            first += stage.active.len();
            // One gain per measurement at the stage, and the covariance.
            first_square += stage.active.len() * stage.active.len();
        }
        Self { of_row, stages, count: sums.len() }
    }

    /// Number of sums.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// The number of outputs: single rows and sums.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.count + self.of_row.iter().filter(|of| of.is_none()).count()
    }

    fn numbers(&self) -> [usize; 2] {
        self.stages.last().map_or([0; 2], |base| {
            let active = base.active.len();
            [base.first + active, base.first_square + active * active]
        })
    }
}

/// The monitors of the pivots of a factor.
#[derive(Debug, Clone, Copy)]
pub struct Seen<T> {
    /// True if some pivot may be lost.
    pub lost: PivotMonitor<T>,
    /// True if some pivot has lost more than five digits.
    pub doubt: PivotMonitor<T>,
}

impl<T: Real> Seen<T> {
    fn observe(&mut self, pivot: T, hinge: &HingeMap<T>, scale: &Scale<T>) {
        self.lost.observe(pivot, hinge, scale);
        self.doubt.observe(pivot, hinge, scale);
    }
}

/// The factor of the covariance of all outputs, and scratch for right-hand sides.
#[derive(Debug, Clone)]
pub struct SummedFactor<T: Real> {
    p: Vec<Symmetric6<T>>,
    scale: Vec<Scale<T>>,
    /// D and g of rows that are measured alone; for other rows the values of a row that is not measured.
    measured: Vec<Measured<T>>,
    /// D of each sum, and the gain of z.
    sums: Vec<Measured<T>>,
    /// The bound of the terms of each D of a sum.
    bound: Vec<T>,
    /// C and S of the partial sums at each stage.
    columns: Vec<Vector6<T>>,
    squares: Vec<T>,
    /// Gains of the partial sums, for each row of a stage and for each sum that is complete there.
    row_gains: Vec<T>,
    sum_gains: Vec<T>,
    /// The largest number of rows of a stage.
    widest: usize,
    /// H C of one row; means of the partial sums.
    crossed: Vec<T>,
    means: Vec<T>,
    /// Innovations of sums, then their estimates.
    estimates: Vec<T>,
    co_state: Vec<Vector6<T>>,
}

impl<T: Real> SummedFactor<T> {
    /// Scratch for a system and its sums; initialized with NaN.
    #[must_use]
    pub fn new(system: &System<T>, sums: &Sums) -> Self {
        let nan = T::from_f64(f64::NAN);
        let stages = system.stages.len();
        let [numbers, squares] = sums.numbers();
        let widest = system.stages.iter().map(|stage| stage.rows.count()).max().unwrap_or(0);
        let most = sums.stages.iter().map(|waiting| waiting.active.len()).max().unwrap_or(0);
        Self {
            p: vec![Symmetric6::filled(nan); stages],
            scale: vec![Scale::filled(nan); stages],
            measured: vec![Measured::filled(nan); system.rows()],
            sums: vec![Measured::filled(nan); sums.count],
            bound: vec![nan; sums.count],
            columns: vec![Vector6::from_element(nan); numbers],
            squares: vec![nan; squares],
            row_gains: vec![nan; numbers * widest],
            sum_gains: vec![nan; squares],
            widest,
            crossed: vec![nan; most],
            means: vec![nan; numbers],
            estimates: vec![nan; sums.count],
            co_state: vec![Vector6::from_element(nan); stages],
        }
    }

    /// The process noise Q(k) of each stage and the bound of its terms, to be set before [`SummedFactor::factorise`].
    pub fn noise(&mut self) -> (&mut [Symmetric6<T>], &mut [Scale<T>]) {
        (&mut self.p, &mut self.scale)
    }

    /// Tip to base: D and gains of every row and every sum. P contains Q(k) on entry and P^+ on return.
    pub fn factorise(&mut self, system: &System<T>, sums: &Sums, shift: &[RigidShift<T>]) -> Seen<T> {
        let mut seen = Seen { lost: PivotMonitor::new(), doubt: PivotMonitor::for_a_single_estimate() };
        self.columns.fill(zero());
        self.squares.fill(T::zero());
        self.row_gains.fill(T::zero());
        self.bound.fill(T::zero());
        for k in (0..system.stages.len()).rev() {
            let (stage, waiting) = (&system.stages[k], &sums.stages[k]);
            let sent = Scale::sent_by(&self.p[k], &shift[k]);
            let mut p = self.p[k];
            for &s in &waiting.complete_on_arrival {
                self.measure_sum(waiting, s, Some(&mut p), &mut seen);
            }
            for i in (0..stage.rows.count()).rev() {
                let row = stage.first_row + i;
                let (hinge, noise) = (stage.rows.row(i), system.noise[row]);
                for (t, crossed) in self.crossed[..waiting.active.len()].iter_mut().enumerate() {
                    *crossed = hinge.project(&self.columns[waiting.first + t]);
                }
                if let Some((s, weight)) = sums.of_row[row] {
                    self.add_row(waiting, s, T::from_f64(weight), (k, &hinge, noise), &p);
                    // As a row that is not measured.
                    let infinite = T::from_f64(f64::INFINITY);
                    self.measured[row] = Measured { pivot: infinite, pivot_inverse: T::zero(), gain: zero() };
                    if waiting.complete_with_row == Some(s) {
                        self.measure_sum(waiting, s, Some(&mut p), &mut seen);
                    }
                } else {
                    let measured = riccati::measurement_update(&mut p, &hinge, noise);
                    seen.observe(measured.pivot, &hinge, &self.scale[k]);
                    self.past_row(waiting, (i, &hinge, noise), &measured);
                    self.measured[row] = measured;
                }
            }
            self.p[k] = p;
            let parent = stage.parent.unwrap_or(system.stages.len());
            if let Some(parent) = stage.parent {
                self.p[parent] = self.p[parent].add(&shift[k].inertia_to_parent(&p));
                self.scale[parent] = self.scale[parent].sum(&sent);
            }
            self.send(waiting, &sums.stages[parent], |column| shift[k].force_to_parent(column));
        }
        let base = &sums.stages[system.stages.len()];
        for &s in &base.complete_on_arrival {
            self.measure_sum(base, s, None, &mut seen);
        }
        seen
    }

    /// A row of a sum: adds w (H z + v) to `u_s`.
    fn add_row(
        &mut self,
        waiting: &Waiting,
        s: usize,
        weight: T,
        (k, hinge, noise): (usize, &HingeMap<T>, T),
        p: &Symmetric6<T>,
    ) {
        let Some(place) = waiting.place(s) else { return };
        let active = waiting.active.len();
        let column = hinge.covariance_column(p);
        let variance = hinge.project(&column) + noise;
        let own = &mut self.columns[waiting.first + place];
        *own = scaled_add(&column, weight, own);
        for (t, &crossed) in self.crossed[..active].iter().enumerate() {
            let added = crossed * weight;
            // The diagonal entry gets it twice.
            self.squares[waiting.first_square + place * active + t] += added;
            self.squares[waiting.first_square + t * active + place] += added;
        }
        self.squares[waiting.first_square + place * active + place] += weight * weight * variance;
        let crossed = (self.crossed[place] * weight).abs();
        self.bound[s] += crossed + crossed + weight * weight * (self.scale[k].of_row(hinge) + noise);
    }

    /// The update of C and S by a row that is measured alone.
    fn past_row(&mut self, waiting: &Waiting, (i, hinge, noise): (usize, &HingeMap<T>, T), measured: &Measured<T>) {
        let active = waiting.active.len();
        for t in 0..active {
            let crossed = self.crossed[t];
            let column = &mut self.columns[waiting.first + t];
            *column = scaled_add(&measured.gain, -crossed, column);
            if let HingeMap::Axis(at) = *hinge
                && noise.lane(0) == 0.0
            {
                column[at] = T::zero();
            }
            let gain = crossed * measured.pivot_inverse;
            self.row_gains[(waiting.first + t) * self.widest + i] = gain;
            for u in 0..active {
                let entry = &mut self.squares[waiting.first_square + t * active + u];
                *entry = entry.minus_product(gain, self.crossed[u]);
            }
        }
    }

    /// A sum is complete: D = `S_ss` and the gains. The sum is not propagated further.
    fn measure_sum(&mut self, waiting: &Waiting, s: usize, p: Option<&mut Symmetric6<T>>, seen: &mut Seen<T>) {
        let Some(place) = waiting.place(s) else { return };
        let active = waiting.active.len();
        let at = |t: usize, u: usize| waiting.first_square + t * active + u;
        let pivot = self.squares[at(place, place)];
        let bound = Scale { angular: self.bound[s], linear: T::zero() };
        seen.observe(pivot, &HingeMap::Axis(0), &bound);
        let pivot_inverse = pivot.recip();
        let column = self.columns[waiting.first + place];
        let gain = scaled(&column, pivot_inverse);
        self.sums[s] = Measured { pivot, pivot_inverse, gain };
        if let Some(p) = p {
            *p = p.add_rank_one(&-gain, &column);
        }
        for t in 0..active {
            self.sum_gains[at(place, t)] = T::zero();
        }
        for t in (0..active).filter(|&t| t != place) {
            let gain_t = self.squares[at(t, place)] * pivot_inverse;
            self.sum_gains[at(place, t)] = gain_t;
            let other = &mut self.columns[waiting.first + t];
            *other = scaled_add(&column, -gain_t, other);
            for u in (0..active).filter(|&u| u != place) {
                let taken = gain_t * self.squares[at(place, u)];
                self.squares[at(t, u)] -= taken;
            }
        }
        self.columns[waiting.first + place] = zero();
        for t in 0..active {
            self.squares[at(t, place)] = T::zero();
            self.squares[at(place, t)] = T::zero();
        }
    }

    /// Adds C and S of the propagated sums to those of the parent.
    fn send(&mut self, waiting: &Waiting, parent: &Waiting, carry: impl Fn(&Vector6<T>) -> Vector6<T>) {
        let places = |waiting: &Waiting, s: usize| waiting.passes_on(s).then(|| parent.place(s)).flatten();
        for (t, &s) in waiting.active.iter().enumerate() {
            let Some(to) = places(waiting, s) else { continue };
            self.columns[parent.first + to] =
                sum(&self.columns[parent.first + to], &carry(&self.columns[waiting.first + t]));
            for (u, &other) in waiting.active.iter().enumerate() {
                if let Some(and) = places(waiting, other) {
                    let entry = self.squares[waiting.first_square + t * waiting.active.len() + u];
                    self.squares[parent.first_square + to * parent.active.len() + and] += entry;
                }
            }
        }
    }

    /// Estimates of all rows from their measurements, tip to base and back. Rows of a sum have `a_i = w_i a_s`.
    ///
    /// `measurement` holds tau of each row; the measurement of a sum is the weighted sum of these. `z` holds b(k) on
    /// entry and z^+ on return. `estimates` receives a of each row.
    pub fn solve(
        &mut self,
        system: &System<T>,
        sums: &Sums,
        shift: &[RigidShift<T>],
        measurement: &[T],
        z: &mut [Vector6<T>],
        estimates: &mut [T],
    ) {
        self.means.fill(T::zero());
        self.estimates.fill(T::zero());
        for (row, of) in sums.of_row.iter().enumerate() {
            if let Some((s, weight)) = *of {
                self.estimates[s] += measurement[row] * T::from_f64(weight);
            }
        }
        for k in (0..system.stages.len()).rev() {
            self.innovate(system, sums, k, measurement, &mut z[k], estimates);
            if let Some(parent) = system.stages[k].parent {
                z[parent] = sum(&z[parent], &shift[k].force_to_parent(&z[k]));
            }
            let (waiting, parent) = (&sums.stages[k], system.stages[k].parent.unwrap_or(system.stages.len()));
            let inward = &sums.stages[parent];
            for (t, &s) in waiting.active.iter().enumerate().filter(|&(_, &s)| waiting.passes_on(s)) {
                if let Some(to) = inward.place(s) {
                    let mean = self.means[waiting.first + t];
                    self.means[inward.first + to] += mean;
                }
            }
        }
        let base = &sums.stages[system.stages.len()];
        for &s in &base.complete_on_arrival {
            self.innovate_sum(base, s, &mut zero());
        }
        for &s in base.complete_on_arrival.iter().rev() {
            self.estimate_sum(base, s, &zero());
        }
        for (k, shift) in shift.iter().enumerate() {
            self.smooth(system, sums, k, shift, estimates);
        }
    }

    /// One stage inward: replaces z^- by z^+ and updates the means of the partial sums; innovations of rows and sums.
    fn innovate(
        &mut self,
        system: &System<T>,
        sums: &Sums,
        k: usize,
        measurement: &[T],
        z: &mut Vector6<T>,
        innovations: &mut [T],
    ) {
        let (stage, waiting) = (&system.stages[k], &sums.stages[k]);
        for &s in &waiting.complete_on_arrival {
            self.innovate_sum(waiting, s, z);
        }
        for i in (0..stage.rows.count()).rev() {
            let (row, hinge) = (stage.first_row + i, stage.rows.row(i));
            if let Some((s, weight)) = sums.of_row[row] {
                if let Some(place) = waiting.place(s) {
                    self.means[waiting.first + place] += hinge.project(z) * T::from_f64(weight);
                }
                if waiting.complete_with_row == Some(s) {
                    self.innovate_sum(waiting, s, z);
                }
                continue;
            }
            let innovation = measurement[row] - hinge.project(z);
            *z = scaled_add(&self.measured[row].gain, innovation, z);
            for t in 0..waiting.active.len() {
                let gain = self.row_gains[(waiting.first + t) * self.widest + i];
                self.means[waiting.first + t] += gain * innovation;
            }
            innovations[row] = innovation;
        }
    }

    fn innovate_sum(&mut self, waiting: &Waiting, s: usize, z: &mut Vector6<T>) {
        let Some(place) = waiting.place(s) else { return };
        let active = waiting.active.len();
        let innovation = self.estimates[s] - self.means[waiting.first + place];
        *z = scaled_add(&self.sums[s].gain, innovation, z);
        for t in 0..active {
            let gain = self.sum_gains[waiting.first_square + place * active + t];
            self.means[waiting.first + t] += gain * innovation;
        }
        self.estimates[s] = innovation;
    }

    /// `a_s = e_s / D - g* lambda - sum over t of g_t a_t`. The other sums t of the stage are complete further inward,
    /// so their estimates are known.
    fn estimate_sum(&mut self, waiting: &Waiting, s: usize, lambda: &Vector6<T>) {
        let Some(place) = waiting.place(s) else { return };
        let active = waiting.active.len();
        let Measured { pivot_inverse, gain, .. } = &self.sums[s];
        let mut a = self.estimates[s].mul_add(*pivot_inverse, -dot(gain, lambda));
        for (t, &other) in waiting.active.iter().enumerate() {
            a = a.minus_product(self.sum_gains[waiting.first_square + place * active + t], self.estimates[other]);
        }
        self.estimates[s] = a;
    }

    /// One stage outward: replaces lambda^+ by lambda^- and innovations by estimates.
    fn smooth(&mut self, system: &System<T>, sums: &Sums, k: usize, shift: &RigidShift<T>, estimates: &mut [T]) {
        let (stage, waiting) = (&system.stages[k], &sums.stages[k]);
        let mut lambda = stage.parent.map_or_else(zero, |parent| shift.motion_to_child(&self.co_state[parent]));
        for i in 0..stage.rows.count() {
            let (row, hinge) = (stage.first_row + i, stage.rows.row(i));
            let a = if let Some((s, weight)) = sums.of_row[row] {
                if waiting.complete_with_row == Some(s) {
                    self.estimate_sum(waiting, s, &lambda);
                }
                self.estimates[s] * T::from_f64(weight)
            } else {
                let Measured { pivot_inverse, gain, .. } = &self.measured[row];
                let mut a = estimates[row].mul_add(*pivot_inverse, -dot(gain, &lambda));
                for (t, &other) in waiting.active.iter().enumerate() {
                    a = a.minus_product(self.row_gains[(waiting.first + t) * self.widest + i], self.estimates[other]);
                }
                a
            };
            lambda = hinge.spread_onto(&lambda, a);
            estimates[row] = a;
        }
        for &s in waiting.complete_on_arrival.iter().rev() {
            self.estimate_sum(waiting, s, &lambda);
        }
        self.co_state[k] = lambda;
    }

    /// The lost pivot furthest from the base, if any. `noise_terms` returns the terms of the diagonal of Q(k).
    pub fn lost_pivot(
        &self,
        system: &System<T>,
        sums: &Sums,
        shift: &[RigidShift<T>],
        seen: &Seen<T>,
        noise_terms: impl Fn(usize) -> Vector6<T>,
    ) -> Option<LostPivot> {
        if seen.lost.clear(0) {
            return None;
        }
        let evidence = Evidence { shift, p: &self.p, measured: &self.measured, scale: &self.scale };
        let of_sum = || {
            (0..system.stages.len()).rev().find_map(|stage| {
                let row = system.stages[stage].first_row;
                let (s, _) = (system.stages[stage].rows.count() == 1).then(|| sums.of_row[row]).flatten()?;
                let (pivot, terms) = (self.sums[s].pivot.lane(0), self.bound[s].lane(0));
                let is_lost = !(pivot > PIVOT_MARGIN * f64::EPSILON * terms);
                is_lost.then_some(LostPivot { stage, row, pivot, terms })
            })
        };
        // If the pivot of a sum is lost, all values inward of it are undefined.
        of_sum().or_else(|| first_lost(system, &evidence, &seen.lost, noise_terms))
    }
}

#[cfg(test)]
mod tests;
