//! The iterations: derivatives of all steps, the filter from the end to the start, and the motion under its law.

use super::array::write_system;
use super::costs::{Cost, CostScratch, Motion, Term};
use super::dynamics::{AT_ONCE, Dynamics};
use super::knot::{Law, Sizes, Step, Turn, Value};
use super::problem::{Iteration, Linearization, Outcome, Problem, Start};
use super::rollout::{Laws, Rollouts};
use super::rows::Rows;
use super::stage::{Bounds, Model, Scratch, stage};
use crate::error::{Error, check_finite, check_length, check_positive};
use crate::interrupt;
use crate::memory;
use crate::scene::Scene;

/// The optimizer of one problem: its memory is kept between searches, so that a model predictive controller does not
/// allocate.
#[derive(Debug)]
pub struct Optimizer {
    problem: Problem,
    dynamics: Dynamics,
    sizes: Sizes,
    motion: Motion,
    rows: Vec<Rows>,
    trial_rows: Vec<Rows>,
    by_state: Vec<f64>,
    by_control: Vec<f64>,
    turns: Vec<Turn>,
    defects: Vec<f64>,
    gains: Vec<f64>,
    offsets: Vec<f64>,
    value: Value,
    stage: Scratch,
    costs: CostScratch,
    rollouts: Rollouts,
    bounds: [Vec<f64>; 2],
    /// Multipliers of the rows of each cost that is an inequality, and the weight of their squares.
    multipliers: Vec<Vec<f64>>,
    penalty: f64,
    /// The weight of defects in the merit of a motion.
    defect_weight: f64,
}

/// Step lengths after which a search has failed.
const SHORTEST: f64 = 1.0 / 1024.0;
/// The share of the decrease of the model that a step must reach.
const ARMIJO: f64 = 1e-4;
/// Largest damping with which the decrease of the model shows a minimum.
const DAMPING_OF_A_MINIMUM: f64 = 1e-2;
/// Least and largest damping.
const DAMPING: [f64; 2] = [1e-9, 1e10];
/// Largest number of times that multipliers change, and of iterations between two changes.
const MULTIPLIER_ROUNDS: i32 = 30;
const ITERATIONS_OF_A_ROUND: usize = 20;
/// The expected decrease, relative to the cost, at which multipliers change first.
const LOOSEST: f64 = 1e-3;

impl Optimizer {
    /// The optimizer of `problem` for `scene`.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] and [`Error::Shape`] for a time step that is not positive, no steps, bounds that exclude
    /// each other, costs that do not fit, and friction that is not Coulomb's.
    pub fn new(scene: &Scene, mut problem: Problem) -> Result<Self, Error> {
        check_positive("dt", problem.dt)?;
        check_positive("tolerance", problem.tolerance)?;
        check_positive("limit_tolerance", problem.limit_tolerance)?;
        check_positive("friction_speed", problem.friction_speed)?;
        let (nq, nv, steps) = (scene.nq(), scene.nv(), problem.steps);
        if steps == 0 {
            return Err(Error::argument("steps", "0", "at least 1"));
        }
        for bounds in &problem.effort {
            check_length("effort", bounds.len(), nv)?;
        }
        let [lower, upper] = &problem.effort;
        for joint in scene.joints() {
            for row in joint.v.clone() {
                // A comparison that fails for NaN.
                if !(lower[row] <= upper[row]) {
                    let found = format!("{} to {} for joint {:?}", lower[row], upper[row], joint.name);
                    return Err(Error::argument("effort", found, "a lower limit that is at most the upper one"));
                }
            }
        }
        let driven = (0..nv).filter(|&row| lower[row] != 0.0 || upper[row] != 0.0).collect();
        let dynamics = Dynamics::new(scene, problem.dt, driven, (problem.friction_speed, problem.smoothing))?;
        for (at, cost) in problem.costs.iter_mut().enumerate() {
            cost.check(&dynamics, steps, at)?;
        }
        let has_rate = problem.costs.iter().any(|cost| matches!(cost.term, Term::EffortRate { .. }));
        let sizes = dynamics.sizes(has_rate);
        let (n, m, nan) = (sizes.state(), sizes.controls, |length: usize| vec![f64::NAN; length]);
        let numbers = nv * (2 * nv + m) + m * n + (AT_ONCE + 1) * (nq + 2 * nv);
        let per_step = numbers * size_of::<f64>() + dynamics.turning() * size_of::<Turn>();
        memory::room("steps", per_step as u128 * steps as u128)?;
        Ok(Self {
            motion: Motion { q: nan((steps + 1) * nq), qd: nan((steps + 1) * nv), tau: nan(steps * nv) },
            rows: vec![Rows::default(); problem.costs.len()],
            trial_rows: vec![Rows::default(); problem.costs.len()],
            by_state: nan(steps * 2 * nv * nv),
            by_control: nan(steps * nv * m),
            turns: vec![Turn::default(); steps * dynamics.turning()],
            defects: Vec::new(),
            gains: vec![0.0; steps * m * n],
            offsets: vec![0.0; steps * m],
            value: Value::new(sizes),
            stage: Scratch::new(sizes),
            costs: CostScratch::default(),
            rollouts: Rollouts::new(nq, nv, steps),
            bounds: [nan(m), nan(m)],
            multipliers: vec![Vec::new(); problem.costs.len()],
            penalty: f64::NAN,
            defect_weight: 0.0,
            dynamics,
            sizes,
            problem,
        })
    }

    /// The motion of the last search.
    #[must_use]
    pub fn motion(&self) -> &Motion {
        &self.motion
    }

    /// The gains K of u = tau - K x at each step, (steps x controls x state), and the degrees of freedom with a
    /// control. x = (q (-) `motion.q`, qd - `motion.qd`), and, if the rate of the efforts has a cost, the change of the
    /// efforts of the step before.
    #[must_use]
    pub fn gains(&self) -> (&[f64], &[usize]) {
        (&self.gains, &self.dynamics.driven)
    }

    /// The length of x.
    #[must_use]
    pub fn state_width(&self) -> usize {
        self.sizes.state()
    }

    /// Replaces terms of the cost, of which there are not more than before, to change their targets between two
    /// searches.
    ///
    /// # Errors
    ///
    /// As [`Optimizer::new`], and for a rate of efforts where there was none.
    pub fn set_costs(&mut self, mut costs: Vec<Cost>) -> Result<(), Error> {
        let found = format!("{} terms", costs.len());
        if costs.len() > self.problem.costs.len() {
            let expected = format!("at most the {} terms of the problem", self.problem.costs.len());
            return Err(Error::argument("costs", found, expected));
        }
        for (at, (cost, old)) in costs.iter_mut().zip(&self.problem.costs).enumerate() {
            if std::mem::discriminant(&cost.term) != std::mem::discriminant(&old.term) {
                let (found, expected) = (format!("{:?}", cost.term), format!("{:?}", old.term));
                return Err(Error::argument(format!("costs[{at}]"), found, format!("{expected}, as before")));
            }
            cost.check(&self.dynamics, self.problem.steps, at)?;
        }
        for (to, cost) in self.problem.costs.iter_mut().zip(costs) {
            *to = cost;
        }
        Ok(())
    }

    /// Sets the largest number of iterations of the next searches.
    pub fn set_iterations(&mut self, iterations: usize) {
        self.problem.iterations = iterations;
    }

    /// Searches from a start.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, and a start whose motion or costs cannot be computed.
    pub fn solve(&mut self, start: &Start<'_>) -> Result<Outcome, Error> {
        self.begin(start)?;
        let mut history = Vec::with_capacity(self.problem.iterations);
        let mut damping = 0.0;
        let mut violation = self.evaluate_motion()?;
        self.begin_multipliers();
        let (mut rounds, mut in_round, mut least_violation) = (0, 0, f64::INFINITY);
        let mut reason = "the largest number of iterations";
        let mut converged = false;
        for _ in 0..self.problem.iterations {
            interrupt::check()?;
            self.linearize()?;
            let Some((model, array_stages)) = self.backward(damping) else {
                damping = raised(damping);
                if damping > DAMPING[1] {
                    reason = "the curvature of the controls is not positive: give the efforts a cost";
                    break;
                }
                continue;
            };
            let merit = self.merit(&self.rows, self.defects_sum());
            let expected = model.decrease(1.0);
            let scale = merit.abs().max(f64::MIN_POSITIVE);
            let is_feasible = self.defects.is_empty();
            let is_within = violation <= self.problem.limit_tolerance;
            if is_feasible && is_within && expected <= self.problem.tolerance * scale {
                // With damping, steps are short and their decrease is small far from a minimum, too.
                if damping > DAMPING_OF_A_MINIMUM {
                    damping = lowered(damping);
                    continue;
                }
                (converged, reason) = (true, "the model has no further decrease");
                break;
            }
            // The first multipliers are far from the last ones: the minimum for them is not worth many digits.
            in_round += 1;
            let loose = self.problem.tolerance.max(LOOSEST * 0.1_f64.powi(rounds));
            if is_feasible && !is_within && (expected <= loose * scale || in_round > ITERATIONS_OF_A_ROUND) {
                (rounds, in_round) = (rounds + 1, 0);
                if rounds > MULTIPLIER_ROUNDS {
                    reason = "the inequalities contradict each other or the dynamics";
                    break;
                }
                self.update_multipliers(violation, least_violation)?;
                least_violation = least_violation.min(violation);
                continue;
            }
            let slope = self.slope(&model);
            // The slope determines the weight of the defects.
            let merit = self.merit(&self.rows, self.defects_sum());
            let (length, found) = self.search(merit, slope, &model);
            if length > 0.0 {
                violation = found;
                damping = match length {
                    length if length >= 0.5 => lowered(damping),
                    length if length < 0.25 => raised(damping),
                    _ => damping,
                };
            } else {
                damping = raised(damping);
            }
            history.push(Iteration {
                cost: self.cost(),
                expected,
                length,
                damping,
                defects: self.defects_sum(),
                violation,
                array_stages,
            });
            if length == 0.0 {
                let rounding = 1e3 * f64::EPSILON * scale;
                if is_feasible && expected <= rounding && violation <= self.problem.limit_tolerance {
                    (converged, reason) = (true, "the decrease that is left is rounding");
                    break;
                }
                if damping > DAMPING[1] {
                    reason = "no step decreases the cost";
                    break;
                }
            }
        }
        if self.problem.iterations == 0 {
            self.linearize()?;
            while self.backward(damping).is_none() && damping <= DAMPING[1] {
                damping = raised(damping);
            }
        }
        Ok(Outcome { converged, cost: self.cost(), history, reason })
    }

    /// The system and the cost about the motion.
    ///
    /// # Errors
    ///
    /// An error of the derivatives.
    pub fn linearization(&mut self) -> Result<Linearization, Error> {
        self.linearize()?;
        let (steps, n, m) = (self.problem.steps, self.sizes.state(), self.sizes.controls);
        let all = n + m;
        let (mut a, mut b) = (vec![0.0; steps * n * n], vec![0.0; steps * n * m]);
        let by_torque = self.by_torque()?;
        let mut hessian = vec![0.0; (steps + 1) * all * all];
        for knot in 0..=steps {
            if knot < steps {
                let step = self.step(knot);
                write_system(self.sizes, &step, &mut a[knot * n * n..][..n * n], &mut b[knot * n * m..][..n * m]);
            }
            let to = &mut hessian[knot * all * all..][..all * all];
            let costs = self.problem.costs.iter().zip(&self.rows).filter(|(cost, _)| !cost.is_limit);
            costs.for_each(|(_, rows)| rows.add_squares(knot, all, to));
        }
        Ok(Linearization { a, b, by_torque, hessian })
    }

    /// As B, for all joints.
    fn by_torque(&mut self) -> Result<Vec<f64>, Error> {
        let nv = self.sizes.nv;
        let sizes = Sizes { nv, controls: nv, has_rate: false };
        let driven = std::mem::replace(&mut self.dynamics.driven, (0..nv).collect());
        let mut all = vec![0.0; self.problem.steps * 2 * nv * nv];
        let mut by_control = vec![0.0; self.problem.steps * nv * nv];
        let done = self.differentiate(&mut by_control);
        let mut a = vec![0.0; 4 * nv * nv];
        let columns = by_control.chunks_exact((nv * nv).max(1));
        for (k, (by_control, by_torque)) in columns.zip(all.chunks_exact_mut((2 * nv * nv).max(1))).enumerate() {
            write_system(sizes, &Step { by_control, ..self.step(k) }, &mut a, by_torque);
        }
        self.dynamics.driven = driven;
        done.map(|()| all)
    }

    /// Reads a start.
    fn begin(&mut self, start: &Start<'_>) -> Result<(), Error> {
        let Self { dynamics, motion, problem, defects, .. } = self;
        let scene = dynamics.scene();
        let (nq, nv, steps) = (scene.nq(), scene.nv(), problem.steps);
        scene.check_coordinates("q0", start.q)?;
        check_length("qd0", start.qd.len(), nv)?;
        check_finite("qd0", start.qd)?;
        scene.check_start(start.q, start.qd)?;
        defects.clear();
        self.defect_weight = 0.0;
        // The last search had its own: rows are penalized when they have new ones.
        self.multipliers.iter_mut().for_each(Vec::clear);
        motion.q[..nq].copy_from_slice(start.q);
        motion.qd[..nv].copy_from_slice(start.qd);
        if start.tau.is_empty() {
            let mut hold = vec![0.0; nv];
            scene.gravity_torque(&mut scene.workspace(), start.q, &mut hold)?;
            motion.tau.chunks_exact_mut(nv.max(1)).for_each(|tau| tau.copy_from_slice(&hold));
        } else {
            check_length("tau", start.tau.len(), steps * nv)?;
            check_finite("tau", start.tau)?;
            motion.tau.copy_from_slice(start.tau);
        }
        let [lower, upper] = &problem.effort;
        for tau in motion.tau.chunks_exact_mut(nv.max(1)) {
            for row in 0..nv {
                tau[row] = tau[row].clamp(lower[row], upper[row]);
            }
        }
        if let Some([q, qd]) = start.states {
            check_length("q", q.len(), steps * nq)?;
            check_length("qd", qd.len(), steps * nv)?;
            check_finite("qd", qd)?;
            for (row, q) in q.chunks_exact(nq.max(1)).enumerate() {
                scene.check_coordinates("q", q).map_err(|error| error.in_state(row))?;
            }
            motion.q[nq..].copy_from_slice(q);
            motion.qd[nv..].copy_from_slice(qd);
            return self.measure_defects();
        }
        self.gains.fill(0.0);
        self.offsets.fill(0.0);
        // With zero gains no deviation is needed: the configurations of the old motion are those of the start.
        for knot in 1..=steps {
            self.motion.q.copy_within(..nq, knot * nq);
            self.motion.qd.copy_within(..nv, knot * nv);
        }
        let laws = Laws {
            about: &self.motion,
            gains: &self.gains,
            offsets: &self.offsets,
            defects: &[],
            bounds: self.problem.effort.each_ref().map(|bounds| &bounds[..]),
        };
        self.rollouts.run(&mut self.dynamics, self.sizes, &laws, &[1.0]);
        if let Some(error) = self.rollouts.faults[0].take() {
            return Err(error);
        }
        std::mem::swap(&mut self.motion, &mut self.rollouts.motions[0]);
        Ok(())
    }

    /// Computes the defects of the motion.
    fn measure_defects(&mut self) -> Result<(), Error> {
        let (nq, nv, steps) = (self.dynamics.scene().nq(), self.sizes.nv, self.problem.steps);
        self.defects.resize(steps * 2 * nv, 0.0);
        let mut accelerations = vec![f64::NAN; AT_ONCE * nv];
        let (mut x, mut moved) = (vec![0.0; nv], vec![0.0; nq]);
        for first in (0..steps).step_by(AT_ONCE) {
            let last = (first + AT_ONCE).min(steps);
            let motion = &self.motion;
            let states = (first..last)
                .map(|k| (&motion.q[k * nq..][..nq], &motion.qd[k * nv..][..nv], &motion.tau[k * nv..][..nv]));
            let out = &mut accelerations[..(last - first) * nv];
            self.dynamics.accelerations(states, out).map_err(|fault| fault.error.in_state(first + fault.state))?;
            for k in first..last {
                let defect = &mut self.defects[k * 2 * nv..][..2 * nv];
                let state =
                    (&motion.q[k * nq..][..nq], &motion.qd[k * nv..][..nv], &accelerations[(k - first) * nv..][..nv]);
                self.dynamics.advance(state, &mut x, (&mut moved, &mut defect[nv..]))?;
                for (defect, v) in defect[nv..].iter_mut().zip(&motion.qd[(k + 1) * nv..]) {
                    *defect -= v;
                }
                self.dynamics.scene().difference(&motion.q[(k + 1) * nq..][..nq], &moved, &mut defect[..nv])?;
            }
        }
        if self.defects.iter().all(|&defect| defect == 0.0) {
            self.defects.clear();
        }
        Ok(())
    }

    /// Computes the rows of all costs; returns the largest violation of an inequality.
    fn evaluate(&mut self, motion: &Motion, rows: &mut [Rows]) -> Result<f64, Error> {
        let mut violation: f64 = 0.0;
        for (cost, (rows, multipliers)) in self.problem.costs.iter().zip(rows.iter_mut().zip(&self.multipliers)) {
            cost.evaluate(&self.dynamics, (self.sizes, self.problem.steps), motion, &mut self.costs, rows)?;
            if cost.is_limit {
                violation = violation.max(rows.largest());
                if !multipliers.is_empty() {
                    rows.penalize(multipliers, self.penalty);
                }
            }
        }
        Ok(violation)
    }

    /// Computes the rows of the motion; returns the largest violation of an inequality.
    fn evaluate_motion(&mut self) -> Result<f64, Error> {
        let (motion, mut rows) = (std::mem::take(&mut self.motion), std::mem::take(&mut self.rows));
        let found = self.evaluate(&motion, &mut rows);
        (self.motion, self.rows) = (motion, rows);
        found
    }

    /// Begins with multipliers of zero, and with a penalty from the cost of the start.
    fn begin_multipliers(&mut self) {
        let cost: f64 = self.costs_of(&self.rows, false);
        self.penalty = 10.0 * cost.max(1e-3);
        for (cost, (rows, multipliers)) in
            self.problem.costs.iter().zip(self.rows.iter_mut().zip(&mut self.multipliers))
        {
            if cost.is_limit {
                multipliers.clear();
                multipliers.resize(rows.len(), 0.0);
                rows.penalize(multipliers, self.penalty);
            }
        }
    }

    /// Updates the multipliers, and the penalty if the violation did not become a quarter of the least one before.
    fn update_multipliers(&mut self, violation: f64, before: f64) -> Result<(), Error> {
        for (cost, (rows, multipliers)) in self.problem.costs.iter().zip(self.rows.iter().zip(&mut self.multipliers)) {
            if cost.is_limit {
                // The penalized residual is sqrt(penalty) (g + multiplier / penalty), where it is positive.
                for (multiplier, error) in multipliers.iter_mut().zip(rows.errors()) {
                    *multiplier = self.penalty.sqrt() * error.max(0.0);
                }
            }
        }
        if violation > 0.25 * before {
            self.penalty *= 10.0;
        }
        self.evaluate_motion().map(|_| ())
    }

    fn costs_of(&self, rows: &[Rows], with_limits: bool) -> f64 {
        let each = self.problem.costs.iter().zip(rows);
        each.filter(|(cost, _)| with_limits || !cost.is_limit).map(|(_, rows)| rows.cost()).sum()
    }

    fn cost(&self) -> f64 {
        self.costs_of(&self.rows, false)
    }

    fn merit(&self, rows: &[Rows], defects: f64) -> f64 {
        self.costs_of(rows, true) + self.defect_weight * defects
    }

    fn defects_sum(&self) -> f64 {
        self.defects.iter().map(|defect| defect.abs()).sum()
    }

    /// The derivatives of all steps.
    fn linearize(&mut self) -> Result<(), Error> {
        let mut by_control = std::mem::take(&mut self.by_control);
        let done = self.differentiate(&mut by_control);
        self.by_control = by_control;
        let (nv, count) = (self.sizes.nv, self.dynamics.turning());
        if count > 0 {
            for (k, turns) in self.turns.chunks_exact_mut(count).enumerate() {
                self.dynamics.turns(&self.motion.qd[(k + 1) * nv..][..nv], turns);
            }
        }
        done
    }

    /// F of all steps, and G, (steps x nv x driven), into `by_control`.
    fn differentiate(&mut self, by_control: &mut [f64]) -> Result<(), Error> {
        let (nq, nv, steps) = (self.dynamics.scene().nq(), self.sizes.nv, self.problem.steps);
        let (motion, m) = (&self.motion, self.dynamics.driven.len());
        for first in (0..steps).step_by(AT_ONCE) {
            let last = (first + AT_ONCE).min(steps);
            let states = (first..last).map(|k| {
                let rates = &motion.qd[k * nv..(k + 2) * nv];
                (&motion.q[k * nq..][..nq], &rates[..nv], &motion.tau[k * nv..][..nv], &rates[nv..])
            });
            let by_state = &mut self.by_state[first * 2 * nv * nv..last * 2 * nv * nv];
            let done = self.dynamics.derivatives(states, (by_state, &mut by_control[first * nv * m..last * nv * m]));
            done.map_err(|fault| fault.error.in_state(first + fault.state))?;
        }
        Ok(())
    }

    fn step(&self, k: usize) -> Step<'_> {
        let (nv, m, count) = (self.sizes.nv, self.sizes.controls, self.dynamics.turning());
        Step {
            h: self.problem.dt,
            by_state: &self.by_state[k * 2 * nv * nv..][..2 * nv * nv],
            by_control: &self.by_control[k * nv * m..][..nv * m],
            turns: &self.turns[k * count..][..count],
            defect: if self.defects.is_empty() { &[] } else { &self.defects[k * 2 * nv..][..2 * nv] },
        }
    }

    /// The filter from the end to the start. `None` if the curvature of the controls of some step is not positive.
    fn backward(&mut self, damping: f64) -> Option<(Model, usize)> {
        let (nv, n, m, steps) = (self.sizes.nv, self.sizes.state(), self.sizes.controls, self.problem.steps);
        let mut value = std::mem::take(&mut self.value);
        let mut scratch = std::mem::take(&mut self.stage);
        let (mut gains, mut offsets) = (std::mem::take(&mut self.gains), std::mem::take(&mut self.offsets));
        let [mut lower, mut upper] = std::mem::take(&mut self.bounds);
        value.of_end(self.sizes, self.rows.iter(), steps);
        let (mut all, mut array_stages) = (Model::default(), 0);
        let is_bounded =
            self.dynamics.driven.iter().any(|&row| self.problem.effort.iter().any(|bounds| bounds[row].is_finite()));
        let mut is_positive = true;
        for k in (0..steps).rev() {
            for (control, &row) in self.dynamics.driven.iter().enumerate() {
                lower[control] = self.problem.effort[0][row] - self.motion.tau[k * nv + row];
                upper[control] = self.problem.effort[1][row] - self.motion.tau[k * nv + row];
            }
            let bounds = is_bounded.then_some(Bounds { lower: &lower, upper: &upper });
            let mut law = Law { gain: &mut gains[k * m * n..][..m * n], offset: &mut offsets[k * m..][..m] };
            let step = self.step(k);
            let found = stage(&mut scratch, &step, (&self.rows, k), (damping, bounds), &mut value, &mut law);
            let Some((model, is_array)) = found else {
                is_positive = false;
                break;
            };
            all.slope += model.slope;
            all.curvature += model.curvature;
            array_stages += usize::from(is_array);
        }
        (self.value, self.stage) = (value, scratch);
        (self.gains, self.offsets, self.bounds) = (gains, offsets, [lower, upper]);
        is_positive.then_some((all, array_stages))
    }

    /// The slope of the merit along the step, and the weight of the defects that makes it negative.
    fn slope(&mut self, model: &Model) -> f64 {
        if self.defects.is_empty() {
            return model.slope;
        }
        let (nv, n, m, steps) = (self.sizes.nv, self.sizes.state(), self.sizes.controls, self.problem.steps);
        let (mut x, mut u, mut next) = (vec![0.0; n], vec![0.0; m], vec![0.0; n]);
        let (mut a, mut b) = (vec![0.0; n * n], vec![0.0; n * m]);
        let mut slope = 0.0;
        for k in 0..=steps {
            if k < steps {
                for (i, u) in u.iter_mut().enumerate() {
                    let gain = &self.gains[(k * m + i) * n..][..n];
                    *u = self.offsets[k * m + i] - gain.iter().zip(&x).map(|(g, x)| g * x).sum::<f64>();
                }
            }
            for (error, start, values) in self.rows.iter().flat_map(|rows| rows.of_knot(k)) {
                let of = |at: usize| if at < n { x[at] } else { u[at - n] };
                slope += error * values.iter().zip(start..).map(|(value, at)| value * of(at)).sum::<f64>();
            }
            if k < steps {
                a.fill(0.0);
                b.fill(0.0);
                let step = self.step(k);
                write_system(self.sizes, &step, &mut a, &mut b);
                for (i, next) in next.iter_mut().enumerate() {
                    let of_x: f64 = a[i * n..][..n].iter().zip(&x).map(|(a, x)| a * x).sum();
                    let of_u: f64 = b[i * m..][..m].iter().zip(&u).map(|(b, u)| b * u).sum();
                    *next = of_x + of_u + if i < 2 * nv { step.defect[i] } else { 0.0 };
                }
                std::mem::swap(&mut x, &mut next);
            }
        }
        let defects = self.defects_sum();
        // Twice the least weight for which the step decreases the merit by half of the defects.
        let needed = (slope + 0.5 * model.curvature.max(0.0)) / (0.5 * defects);
        if self.defect_weight < needed {
            self.defect_weight = 2.0 * needed;
        }
        slope - self.defect_weight * defects
    }

    /// Tries step lengths until one decreases the merit enough; moves there. Returns the length, zero if there is none,
    /// and the largest violation of an inequality.
    fn search(&mut self, merit: f64, slope: f64, model: &Model) -> (f64, f64) {
        let lanes = self.dynamics.lanes().clamp(1, AT_ONCE);
        let mut longest = 1.0;
        let is_feasible = self.defects.is_empty();
        while longest >= SHORTEST {
            let mut lengths = [0.0; AT_ONCE];
            for length in &mut lengths[..lanes] {
                *length = longest;
                longest *= 0.5;
            }
            let laws = Laws {
                about: &self.motion,
                gains: &self.gains,
                offsets: &self.offsets,
                defects: &self.defects,
                bounds: self.problem.effort.each_ref().map(|bounds| &bounds[..]),
            };
            self.rollouts.run(&mut self.dynamics, self.sizes, &laws, &lengths[..lanes]);
            for (lane, &length) in lengths[..lanes].iter().enumerate() {
                if self.rollouts.faults[lane].is_some() {
                    continue;
                }
                let trial = std::mem::take(&mut self.rollouts.motions[lane]);
                let mut rows = std::mem::take(&mut self.trial_rows);
                let violation = self.evaluate(&trial, &mut rows);
                let left = (1.0 - length) * self.defects_sum();
                let found = self.merit(&rows, left);
                (self.trial_rows, self.rollouts.motions[lane]) = (rows, trial);
                let Ok(violation) = violation else { continue };
                let wanted = if is_feasible { model.decrease(length) } else { -length * slope };
                if merit - found >= ARMIJO * wanted && found.is_finite() {
                    std::mem::swap(&mut self.motion, &mut self.rollouts.motions[lane]);
                    std::mem::swap(&mut self.rows, &mut self.trial_rows);
                    if length >= 1.0 {
                        self.defects.clear();
                    }
                    self.defects.iter_mut().for_each(|defect| *defect *= 1.0 - length);
                    return (length, violation);
                }
            }
        }
        (0.0, f64::NAN)
    }
}

fn raised(damping: f64) -> f64 {
    (damping * 10.0).max(1e3 * DAMPING[0])
}

fn lowered(damping: f64) -> f64 {
    if damping * 0.1 < DAMPING[0] { 0.0 } else { damping * 0.1 }
}
