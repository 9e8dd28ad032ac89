//! One step of the filter: linearization, update by the readings, prediction.

use super::acceleration::Acceleration;
use super::closure::Closure;
use super::robot::{Belief, Record};
use super::rotate::{Readings, RotationScratch, combine, measure, project, triangularize};
use super::sensor_rows::SensorRows;
use super::settings::{LANES, Plan, Source};
use crate::batch::instruction_set::within_widest;
use crate::error::Error;
use crate::kinematics::manifold::step_jacobians;
use crate::scene::Scene;

/// Scratch of a step; one per thread.
#[derive(Debug)]
pub(crate) struct Scratch {
    pub(super) acceleration: Acceleration,
    closure: Option<Closure>,
    rows: SensorRows,
    torque: Vec<f64>,
    /// Derivatives of the accelerations at the prior estimate, then at the start of the step.
    pub(super) flow: Vec<f64>,
    /// H by columns, H L, and errors and standard deviations of the readings that exist.
    h: Vec<f64>,
    projected: Vec<f64>,
    errors: Vec<f64>,
    deviations: Vec<f64>,
    /// For each sensor, its first row and number of rows in H.
    spans: Vec<(usize, usize)>,
    /// For each sensor, its number of rejected readings.
    outliers: Vec<usize>,
    change: Vec<f64>,
    rotation: RotationScratch,
    marginal: Vec<f64>,
    step: Vec<f64>,
    /// Root of the prediction, with the columns of the random walks.
    predicted: Vec<f64>,
    /// A reflection, one entry per column.
    axis: Vec<f64>,
    /// Jacobians of a step of each group: see [`step_jacobians`].
    jacobians: Vec<[[f64; 36]; 2]>,
}

impl Scratch {
    pub fn new(plan: &Plan, scene: &Scene) -> Self {
        let ([column, wide], readings) = (plan.strides(), plan.reading_stride());
        let (nv, width) = (plan.nv, plan.width);
        let largest = plan.sensors.iter().map(|sensor| sensor.range.len()).max().unwrap_or(0);
        Self {
            acceleration: Acceleration::new(plan, scene),
            closure: Closure::new(scene),
            rows: SensorRows::new(largest, scene),
            torque: vec![f64::NAN; nv],
            flow: vec![0.0; width * plan.flow_stride()],
            h: vec![0.0; width * readings],
            projected: vec![0.0; width * readings],
            errors: vec![0.0; readings],
            deviations: vec![1.0; readings],
            spans: vec![(0, 0); plan.sensors.len()],
            outliers: vec![0; plan.sensors.len()],
            change: vec![0.0; wide],
            rotation: RotationScratch::new(width),
            marginal: vec![0.0; largest * (largest + 1)],
            step: vec![0.0; nv],
            predicted: vec![0.0; (width + plan.walks.len()) * column],
            axis: vec![0.0; width + plan.walks.len()],
            jacobians: vec![[[0.0; 36]; 2]; plan.groups.len()],
        }
    }

    /// Readings of a record into its estimate, then the prediction of the next time into `belief`.
    pub fn step(
        &mut self,
        (plan, scene): (&Plan, &Scene),
        belief: &mut Belief,
        record: &mut Record,
    ) -> Result<(), Error> {
        switch(plan, belief, record);
        self.update((plan, scene), belief, record)?;
        belief.acting.copy_from_slice(&record.acting);
        self.predict((plan, scene), record, belief)
    }

    /// Conditions an initial estimate on the connections, which it must satisfy.
    pub fn condition(&mut self, (plan, scene): (&Plan, &Scene), belief: &mut Belief) -> Result<(), Error> {
        let Some(closure) = &mut self.closure else { return Ok(()) };
        scene.check_closed(&belief.q, &belief.qd)?;
        closure.close(scene, &mut self.acceleration.workspace, (&mut belief.q, &mut belief.qd))?;
        let root = closure.conditioned(&plan.initial[plan.rest..])?;
        let [column, _] = plan.strides();
        for (own, root) in belief.root.chunks_exact_mut(column).skip(plan.rest).zip(root.column_iter()) {
            own[plan.rest..plan.states].copy_from_slice(root.as_slice());
        }
        Ok(())
    }

    /// The linearization of a step at a state, by a prediction whose root is the identity.
    #[cfg(feature = "python")]
    pub fn transition(
        &mut self,
        (plan, scene): (&Plan, &Scene),
        (q, qd, rest): (&[f64], &[f64], &[f64]),
        tau: &[f64],
    ) -> Result<Transition, Error> {
        let ([column, wide], stride) = (plan.strides(), plan.flow_stride());
        let (mut record, mut next) = (Record::new(plan)?, Belief::new(plan, q, qd));
        for i in 0..plan.width {
            record.root[i * wide + i] = 1.0;
        }
        for (to, from) in [(&mut record.q, q), (&mut record.qd, qd), (&mut record.rest, rest), (&mut record.tau, tau)] {
            to.copy_from_slice(from);
        }
        record.noise.fill(0.0);
        self.predict((plan, scene), &mut record, &mut next)?;
        let carried = self.carried((plan, scene), &record)?;
        let columns = || plan.public_order().chain(plan.states..plan.width);
        let matrix = plan.public_order().flat_map(|i| columns().map(move |j| carried[j * column + i])).collect();
        self.acceleration.at((plan, scene), (q, qd, rest), tau, &mut self.flow)?;
        let by_error = (0..plan.nv).flat_map(|i| columns().map(move |j| (i, j)));
        let by_error = by_error.map(|(i, j)| self.flow[j * stride + i]).collect();
        let qdd = self.acceleration.value.clone();
        Ok(Transition { q: next.q, qd: next.qd, rest: next.rest, matrix, qdd, by_error })
    }

    fn update(&mut self, (plan, scene): (&Plan, &Scene), prior: &Belief, record: &mut Record) -> Result<(), Error> {
        let [column, wide] = plan.strides();
        record.root.fill(0.0);
        for (to, from) in record.root.chunks_exact_mut(wide).zip(prior.root.chunks_exact(column)) {
            to[..plan.states].copy_from_slice(&from[..plan.states]);
        }
        for (i, &deviation) in record.timing.torque_deviations.iter().enumerate() {
            let at = plan.states + i;
            record.root[at * wide + at] = deviation;
        }
        record.count = self.gather((plan, scene), prior, record)?;
        self.change.fill(0.0);
        record.nis = 0.0;
        record.by_sensor.fill((0.0, 0));
        record.rejected.fill(0.0);
        if record.count > 0 {
            process(self, plan, record);
        }
        scene.check_result("normalized innovation squared", &[record.nis])?;
        let change = &self.change;
        scene.integrate(&prior.q, &change[plan.q()..plan.qd()], &mut record.q)?;
        for (to, from) in [
            (&mut record.qd, (&prior.qd, &change[plan.qd()..plan.states])),
            (&mut record.rest, (&prior.rest, &change[..plan.rest])),
        ] {
            for (to, (x, dx)) in to.iter_mut().zip(from.0.iter().zip(from.1)) {
                *to = x + dx;
            }
        }
        record.noise.copy_from_slice(&change[plan.states..plan.width]);
        // The error in the tangent space of the corrected q, to first order in the correction.
        for &(first, size) in &plan.groups {
            let at = plan.q() + first;
            let [_, right] = step_jacobians(&change[at..at + size]);
            for own in record.root.chunks_exact_mut(wide) {
                multiply(&right, size, &mut own[at..at + size]);
            }
        }
        self.close((plan, scene), (&mut record.q, &mut record.qd), record.root.chunks_exact_mut(wide))
    }

    /// Projects an estimate, and the columns of a root of its covariance, onto the connections of the scene.
    pub fn close<'a>(
        &mut self,
        (plan, scene): (&Plan, &Scene),
        state: (&mut [f64], &mut [f64]),
        columns: impl Iterator<Item = &'a mut [f64]>,
    ) -> Result<(), Error> {
        let Some(closure) = &mut self.closure else { return Ok(()) };
        closure.close(scene, &mut self.acceleration.workspace, state)?;
        closure.project_columns(plan, columns);
        Ok(())
    }

    /// Linearizes the readings that exist at the prior estimate; returns their number.
    fn gather(&mut self, (plan, scene): (&Plan, &Scene), prior: &Belief, record: &mut Record) -> Result<usize, Error> {
        let stride = plan.reading_stride();
        let (mut count, mut has_flow) = (0, false);
        self.h.fill(0.0);
        for (s, sensor) in plan.sensors.iter().enumerate() {
            let readings = &record.readings[sensor.range.clone()];
            self.spans[s] = (count, 0);
            let is_missing = |reading: &f64| reading.is_nan();
            if readings.iter().all(is_missing) || sensor.is_whole() && readings.iter().any(is_missing) {
                continue;
            }
            if sensor.needs_acceleration() && !has_flow {
                let state = (&*prior.q, &*prior.qd, &*prior.rest);
                self.acceleration.at((plan, scene), state, &record.tau, &mut self.flow)?;
                has_flow = true;
            }
            let state = (&*prior.q, &*prior.qd, &*self.acceleration.value);
            self.rows.evaluate(scene, sensor, state, &record.tau);
            if let Source::Pose(_, inverse) = &sensor.source {
                self.rows.whiten_pose(readings, inverse);
            }
            for (i, &reading) in readings.iter().enumerate() {
                if reading.is_nan() {
                    continue;
                }
                let bias = sensor.bias.map(|bias| bias + i);
                self.errors[count] = reading - self.rows.value[i] - bias.map_or(0.0, |bias| prior.rest[bias]);
                self.deviations[count] = sensor.deviations[i];
                if let Some(bias) = bias {
                    self.h[bias * stride + count] = 1.0;
                }
                self.rows.write(plan, i, &self.flow, (&mut self.h[count..], stride));
                count += 1;
            }
            self.spans[s].1 = count - self.spans[s].0;
        }
        Ok(count)
    }

    /// Rotates the readings into the root, and sums their innovations.
    #[inline(always)]
    fn process(&mut self, plan: &Plan, record: &mut Record) {
        let ([_, wide], stride) = (plan.strides(), plan.reading_stride());
        project(&self.h, stride, (&record.root, wide, plan.width), &mut self.projected);
        self.reject(plan, record);
        for (s, own) in record.by_sensor.iter_mut().enumerate() {
            let span = self.spans[s];
            *own = (if span.0 == 0 { 0.0 } else { self.innovation(span, stride) }, span.1 - self.outliers[s]);
        }
        let mut readings = Readings {
            rows: &mut self.projected,
            stride,
            count: record.count,
            errors: &mut self.errors,
            deviations: &self.deviations,
        };
        let outliers: usize = self.outliers.iter().sum();
        record.nis = measure(&mut readings, (&mut record.root, wide), &mut self.rotation, &mut self.change);
        record.count -= outliers;
        // The sensor whose readings are processed first is not conditioned on others.
        for (own, &(first, size)) in record.by_sensor.iter_mut().zip(&self.spans) {
            if first == 0 {
                own.0 = self.errors[..size].iter().sum();
            }
        }
    }

    /// Removes readings beyond the gate of their sensor: rows and errors of zero change nothing.
    #[inline(always)]
    fn reject(&mut self, plan: &Plan, record: &mut Record) {
        let stride = plan.reading_stride();
        for (s, sensor) in plan.sensors.iter().enumerate() {
            self.outliers[s] = 0;
            let (first, count) = self.spans[s];
            if sensor.gate.is_infinite() || count == 0 {
                continue;
            }
            let mut row = first;
            for at in sensor.range.clone() {
                if record.readings[at].is_nan() {
                    continue;
                }
                let mut variance = self.deviations[row] * self.deviations[row];
                for column in self.projected.chunks_exact(stride) {
                    variance = column[row].mul_add(column[row], variance);
                }
                if self.errors[row] * self.errors[row] > sensor.gate * variance {
                    self.errors[row] = 0.0;
                    self.projected.chunks_exact_mut(stride).for_each(|column| column[row] = 0.0);
                    record.rejected[at] = 1.0;
                    self.outliers[s] += 1;
                }
                row += 1;
            }
            if sensor.is_whole() && self.outliers[s] > 0 {
                self.outliers[s] = count;
                self.errors[first..first + count].fill(0.0);
                self.projected.chunks_exact_mut(stride).for_each(|column| column[first..first + count].fill(0.0));
                record.rejected[sensor.range.clone()].fill(1.0);
            }
        }
    }

    /// Normalized innovation squared of one sensor alone: e* (R + H L L* H*)^-1 e by a Cholesky factor.
    #[inline(always)]
    fn innovation(&mut self, (first, size): (usize, usize), stride: usize) -> f64 {
        let (matrix, white) = self.marginal.split_at_mut(size * size);
        if size == 3 {
            gram::<3>(&self.projected, stride, first, matrix);
        } else {
            matrix.fill(0.0);
            for row in self.projected.chunks_exact(stride) {
                let row = &row[first..first + size];
                for (i, &x) in row.iter().enumerate() {
                    for (sum, &y) in matrix[i * size..].iter_mut().zip(&row[..=i]) {
                        *sum = x.mul_add(y, *sum);
                    }
                }
            }
        }
        let mut squares = 0.0;
        for i in 0..size {
            let deviation = self.deviations[first + i];
            matrix[i * size + i] = deviation.mul_add(deviation, matrix[i * size + i]);
            let (done, own) = matrix.split_at_mut(i * size);
            let mut error = self.errors[first + i];
            for j in 0..i {
                let other = &done[j * size..=j * size + j];
                let mut sum = own[j];
                for (x, y) in own[..j].iter().zip(other) {
                    sum = (-x).mul_add(*y, sum);
                }
                let entry = sum / other[j];
                own[j] = entry;
                own[i] = (-entry).mul_add(entry, own[i]);
                error = (-entry).mul_add(white[j], error);
            }
            own[i] = own[i].sqrt();
            white[i] = error / own[i];
            squares = white[i].mul_add(white[i], squares);
        }
        squares
    }

    /// The prediction from the estimate of a record, with the acceleration a in the middle of the step: qd1 = qd + h a,
    /// q (+) h (qd + qd1)/2.
    pub fn predict(
        &mut self,
        (plan, scene): (&Plan, &Scene),
        record: &mut Record,
        next: &mut Belief,
    ) -> Result<(), Error> {
        let h = record.timing.dt;
        for (sum, (tau, noise)) in self.torque.iter_mut().zip(record.tau.iter().zip(&record.noise)) {
            *sum = tau + noise;
        }
        let state = (&*record.q, &*record.qd, &*record.rest);
        let flows = (&mut *self.flow, &mut *record.flow, &mut *record.by_wrench);
        self.acceleration.in_the_middle(
            (plan, scene, self.closure.as_mut()),
            &record.timing,
            state,
            &self.torque,
            flows,
        )?;
        for (next, (qd, qdd)) in next.qd.iter_mut().zip(record.qd.iter().zip(&self.acceleration.value)) {
            *next = qd + h * qdd;
        }
        self.mean_step(plan, h, (&record.qd, &next.qd));
        scene.integrate(&record.q, &self.step, &mut next.q)?;
        for (next, (decay, rest)) in next.rest.iter_mut().zip(record.timing.decay.iter().zip(&record.rest)) {
            *next = decay * rest;
        }
        self.close((plan, scene), (&mut next.q, &mut next.qd), std::iter::empty())?;
        predict_root(self, plan, record, Some(&mut next.root));
        scene.check_result("estimate", &next.qd)?;
        // The covariance can overflow where its root does not.
        for root in [&record.root, &next.root] {
            scene.check_result("covariance of the estimate", &[root.iter().map(|x| x * x).sum()])?;
        }
        record.next_q.copy_from_slice(&next.q);
        record.next_qd.copy_from_slice(&next.qd);
        record.next_rest.copy_from_slice(&next.rest);
        Ok(())
    }

    /// The step h (qd + qd1)/2, and its Jacobians for each group.
    fn mean_step(&mut self, plan: &Plan, h: f64, (qd, next): (&[f64], &[f64])) {
        for (step, (qd, next)) in self.step.iter_mut().zip(qd.iter().zip(next)) {
            *step = 0.5 * h * (qd + next);
        }
        for (own, &(first, size)) in self.jacobians.iter_mut().zip(&plan.groups) {
            *own = step_jacobians(&self.step[first..first + size]);
        }
    }

    /// The root of the prediction, in the rows and columns of `root`.
    #[inline(always)]
    fn predict_root(&mut self, plan: &Plan, record: &Record, root: Option<&mut [f64]>) {
        let [column, _] = plan.strides();
        self.carry(plan, record);
        let Some(root) = root else { return };
        let sizes = (plan.states, plan.rest, plan.width);
        triangularize(&mut self.predicted, column, sizes, &plan.walks, &mut self.axis);
        for (j, (to, from)) in root.chunks_exact_mut(column).zip(self.predicted.chunks_exact(column)).enumerate() {
            to[..j].fill(0.0);
            to[j..plan.states].copy_from_slice(&from[j..plan.states]);
        }
    }

    /// [F B] times the root of (error, torque noise), and the growth of the random walks, into `predicted`.
    #[inline(always)]
    fn carry(&mut self, plan: &Plan, record: &Record) {
        let ([column, wide], stride, h) = (plan.strides(), plan.flow_stride(), record.timing.dt);
        let half = 0.5 * h;
        let (q, qd, nv) = (plan.q(), plan.qd(), plan.nv);
        let (carried, walks) = self.predicted.split_at_mut(plan.width * column);
        // After a correction of a group its rows are not triangular.
        let is_triangular = plan.groups.is_empty() && self.closure.is_none();
        for (j, (to, from)) in carried.chunks_exact_mut(column).zip(record.root.chunks_exact(wide)).enumerate() {
            let first = if is_triangular { j } else { j.min(q) };
            for ((to, from), decay) in to[..plan.rest].iter_mut().zip(from).zip(&record.timing.decay) {
                *to = decay * from;
            }
            for block in (0..nv).step_by(LANES) {
                let sums = combine(&from[first..plan.width], (&record.flow[first * stride..], stride, block));
                for (i, sum) in (block..nv).zip(sums) {
                    to[qd + i] = h.mul_add(sum, from[qd + i]);
                    to[q + i] = half.mul_add(from[qd + i] + to[qd + i], from[q + i]);
                }
            }
            for (&(first, size), [back, right]) in plan.groups.iter().zip(&self.jacobians) {
                let mut rate: [f64; 6] = [0.0; 6];
                let both = from[qd + first..].iter().zip(&to[qd + first..]);
                rate[..size].iter_mut().zip(both).for_each(|(rate, (a, b))| *rate = a + b);
                multiply(right, size, &mut rate[..size]);
                let own = &mut to[q + first..q + first + size];
                own.copy_from_slice(&from[q + first..q + first + size]);
                multiply(back, size, own);
                for (own, rate) in own.iter_mut().zip(rate) {
                    *own = half.mul_add(rate, *own);
                }
            }
        }
        walks.fill(0.0);
        let walk = &record.timing.walk;
        // Half of the growth of a wrench acts in the middle of the step. The mean of a wrench over the step, given both
        // ends, has the variance of its growth over 12.
        let within = plan.walks.len() - plan.grown;
        let growth = plan.walks[..plan.grown].iter().map(|&row| (row, walk[row], half * walk[row]));
        let inside = plan.walks[..within].iter().map(|&row| (row, 0.0, h / 12.0_f64.sqrt() * walk[row]));
        for (to, (row, added, acting)) in walks.chunks_exact_mut(column).zip(growth.chain(inside)) {
            to[row] = added;
            for (i, by_wrench) in record.by_wrench.iter().skip(row * stride).take(nv).enumerate() {
                to[qd + i] = acting * by_wrench;
                to[q + i] = half * to[qd + i];
            }
            for (&(first, size), [_, right]) in plan.groups.iter().zip(&self.jacobians) {
                multiply(right, size, &mut to[q + first..q + first + size]);
            }
        }
        if let Some(closure) = &self.closure {
            closure.project_columns(plan, self.predicted.chunks_exact_mut(column));
        }
    }

    /// [F B] root of a record, with the columns of the random walks, (states) rows per column, for the smoother.
    pub fn carried(&mut self, (plan, scene): (&Plan, &Scene), record: &Record) -> Result<&[f64], Error> {
        self.mean_step(plan, record.timing.dt, (&record.qd, &record.next_qd));
        let (mut q, mut qd) = (record.next_q.clone(), record.next_qd.clone());
        self.close((plan, scene), (&mut q, &mut qd), std::iter::empty())?;
        predict_root(self, plan, record, None);
        Ok(&self.predicted)
    }
}

/// Begins and ends wrenches of an estimate as a record says: one that does not act is zero without error, and one that
/// begins has its initial variance.
fn switch(plan: &Plan, belief: &mut Belief, record: &Record) {
    let [column, _] = plan.strides();
    for (w, (&before, &now)) in belief.acting.iter().zip(&record.acting).enumerate() {
        if before.to_bits() == now.to_bits() {
            continue;
        }
        for row in 6 * w..6 * w + 6 {
            belief.rest[row] = 0.0;
            belief.root.chunks_exact_mut(column).for_each(|own| own[row] = 0.0);
            if now > 0.0 {
                add_variance(&mut belief.root, column, (row, plan.initial[row]));
            }
        }
    }
}

/// Adds the square of a deviation to the variance of a component, in a lower triangular root.
fn add_variance(root: &mut [f64], column: usize, (row, deviation): (usize, f64)) {
    let mut added = vec![0.0; column];
    added[row] = deviation;
    for (k, own) in root.chunks_exact_mut(column).enumerate().skip(row) {
        let size = own[k].hypot(added[k]);
        if size == 0.0 {
            continue;
        }
        let (cosine, sine) = (own[k] / size, added[k] / size);
        for (x, y) in own[k..].iter_mut().zip(&mut added[k..]) {
            (*x, *y) = (cosine * *x + sine * *y, cosine * *y - sine * *x);
        }
    }
}

/// The products of `N` rows with each other, of a matrix by columns, in registers.
#[inline(always)]
fn gram<const N: usize>(columns: &[f64], stride: usize, first: usize, out: &mut [f64]) {
    let mut sums = [[0.0; N]; N];
    for column in columns.chunks_exact(stride) {
        let mut own = [0.0; N];
        own.copy_from_slice(&column[first..first + N]);
        for (x, sums) in own.iter().zip(&mut sums) {
            for (y, sum) in own.iter().zip(sums) {
                *sum = x.mul_add(*y, *sum);
            }
        }
    }
    out.copy_from_slice(sums.as_flattened());
}

/// The next state of a step, and its derivatives by error and torque noise in the order (q, qd, wrenches, biases,
/// noise), row by row.
#[cfg(feature = "python")]
#[derive(Debug)]
pub(crate) struct Transition {
    pub q: Vec<f64>,
    pub qd: Vec<f64>,
    pub rest: Vec<f64>,
    /// [F B].
    pub matrix: Vec<f64>,
    /// Accelerations at the start, and their derivatives.
    pub qdd: Vec<f64>,
    pub by_error: Vec<f64>,
}

/// A vector times a matrix (size x size), in place.
#[inline(always)]
pub(super) fn multiply(matrix: &[f64; 36], size: usize, x: &mut [f64]) {
    let mut product = [0.0; 6];
    for (i, sum) in product[..size].iter_mut().enumerate() {
        for (j, entry) in x.iter().enumerate() {
            *sum += matrix[size * i + j] * entry;
        }
    }
    x.copy_from_slice(&product[..size]);
}

within_widest! {
    fn process<'a>(scratch: &'a mut Scratch, plan: &'a Plan, record: &'a mut Record) {
        scratch.process(plan, record);
    }

    /// Without a root: only the matrix that is rotated, for the smoother.
    fn predict_root<'a>(scratch: &'a mut Scratch, plan: &'a Plan, record: &'a Record, root: Option<&'a mut [f64]>) {
        scratch.predict_root(plan, record, root);
    }

    /// Covariance of the error of a record, row by row in the order (q, qd, wrenches, biases).
    pub(super) fn covariance<'a>(plan: &'a Plan, record: &'a Record, out: &'a mut [f64]) {
        write_covariance(plan, record, out);
    }
}

#[inline(always)]
fn write_covariance(plan: &Plan, record: &Record, out: &mut [f64]) {
    let (n, [_, wide]) = (plan.states, plan.strides());
    let place = |i: usize| if i < plan.rest { i + 2 * plan.nv } else { i - plan.rest };
    for rows in (0..n).step_by(LANES) {
        for columns in (0..=rows).step_by(LANES) {
            let mut sums = [[0.0; LANES]; LANES];
            for own in record.root.chunks_exact(wide) {
                let (left, right) = (&own[rows..rows + LANES], &own[columns..columns + LANES]);
                for (x, sums) in left.iter().zip(&mut sums) {
                    for (y, sum) in right.iter().zip(sums) {
                        *sum = x.mul_add(*y, *sum);
                    }
                }
            }
            for (i, sums) in (rows..n).zip(sums) {
                for (j, sum) in (columns..=i).zip(sums) {
                    out[place(i) * n + place(j)] = sum;
                    out[place(j) * n + place(i)] = sum;
                }
            }
        }
    }
}
