//! The arrays of a step, for one state or for one state per lane.

use super::friction_curve::{CurvedRow, curved_rows};
use super::method::{STAGES, Scheme};
use super::properties::Gains;
use super::step_settings::StepSettings;
use super::stops::SetValued;
use super::totals::TOTALS;
use super::wrenches::WrenchScratch;
use crate::batch::instruction_set::{Vectorized, take_states};
use crate::batch::own_model::FREE;
use crate::dynamics::sweeps::{SweepModel, SweepScratch};
use crate::model::Model;
use crate::scalar::Real;

/// Indices of the gains and limits of effort of a state.
pub(super) const KP: usize = 0;
pub(super) const KD: usize = 1;
pub(super) const LOWER: usize = 2;
pub(super) const UPPER: usize = 3;
pub(super) const STALL: usize = 4;
pub(super) const DECLINE: usize = 5;

/// Constants of one row in the scalar type of the lanes.
#[derive(Debug, Clone, Copy)]
pub(super) struct RowTerms<T> {
    /// Measurement noise without the part of friction.
    pub noise: T,
    pub armature: T,
    pub damping: T,
    pub stiffness: T,
    pub friction: T,
    /// The gains that act in this step, and the constant torque of a control law at a limit of effort.
    pub proportional: T,
    pub derivative: T,
    pub held: T,
    /// The part of the gains in the noise.
    pub slope: T,
    /// 1 if the control law is at its upper limit, -1 at its lower one, else 0; and 1 if the limit there declines with
    /// speed, 2 if it is zero because of the speed, else 0.
    pub side: T,
    pub phase: T,
    /// The torque of the law without limits at the start of the step, and 1 if the step is made again because the mean
    /// torque of the law was beyond the limit, else 0.
    pub start: T,
    pub clipped: T,
    /// True if the kernels have noise in this row.
    pub has_noise: bool,
}

/// A row with exact friction or stops, in the scalar type of the lanes.
#[derive(Debug, Clone, Copy)]
pub(super) struct ModeTerms<T> {
    pub row: usize,
    /// Index of its coordinate in q, and the limits; infinite if there are none.
    pub coordinate: usize,
    pub lower: T,
    pub upper: T,
    pub friction: T,
    /// 1 if the row is stuck in this step, else 0; and its acceleration while stuck, which is nonzero only in an event.
    pub stuck: T,
    pub target: T,
    /// 1 if the row is at its lower, or upper, stop, else 0.
    pub at_lower: T,
    pub at_upper: T,
}

/// The arrays of a step.
#[derive(Debug)]
pub(super) struct Scratch<T: Real> {
    pub model: Model<T>,
    pub constants: SweepModel<T>,
    pub sweeps: SweepScratch<T>,
    pub rows: Vec<RowTerms<T>>,
    pub rest: Vec<T>,
    pub target: Vec<T>,
    pub target_rate: Vec<T>,
    /// Gains and limits of effort of the state: see [`drives`](super::drives); empty without a control law.
    pub gains: [Vec<T>; 6],
    /// True if the caller gives the pieces of the control law.
    pub are_sides_given: bool,
    /// Noise in place of zero, in rows in which the kernels have noise.
    pub vanishing: f64,
    /// The applied torque, constant during the step.
    pub torque: Vec<T>,
    /// The wrenches on links in the step.
    pub wrenches: WrenchScratch<T>,
    pub q: Vec<T>,
    pub v: Vec<T>,
    pub q_next: Vec<T>,
    pub v_next: Vec<T>,
    /// Stages: velocities of the increment, and accelerations.
    pub l: [Vec<T>; STAGES],
    pub m: [Vec<T>; STAGES],
    /// Increment, configuration, velocity, transported velocity and torque of a stage.
    pub x: Vec<T>,
    pub q_stage: Vec<T>,
    pub v_stage: Vec<T>,
    pub c: Vec<T>,
    pub u: Vec<T>,
    /// Secant coefficient of regularized friction, f / sqrt(v^2 + v0^2) at the start of the step.
    pub chord: Vec<T>,
    /// Rows with friction curves.
    pub curved: Vec<CurvedRow>,
    /// Rows with exact friction or stops, and their friction torques in this step, zero for stuck rows.
    pub modes: Vec<ModeTerms<T>>,
    pub dry: Vec<T>,
    /// Impulse of the control law in this step without that of its noise, N m s or N s.
    pub control: Vec<T>,
    /// Positive if all modes hold until the end of the step; positive if the step is short enough; and positive if both
    /// hold but perhaps for the pieces of control laws.
    pub consistent: T,
    pub short_enough: T,
    pub without_drives: T,
    /// Works and numbers of substeps of the run: see [`totals`](super::totals).
    pub totals: [T; TOTALS],
    /// Displacement of the stage from the rest configuration of the springs, and from the target of the control law.
    pub displaced: Vec<T>,
    pub displaced_target: Vec<T>,
}

/// Copies state, torque, wrenches, targets and totals of one lane before a step.
pub(super) fn take_lane<T: Vectorized>(one: &mut Scratch<f64>, s: &Scratch<T>, lane: usize) {
    for (to, from) in [
        (&mut one.q, &s.q),
        (&mut one.v, &s.v),
        (&mut one.torque, &s.torque),
        (&mut one.target, &s.target),
        (&mut one.target_rate, &s.target_rate),
    ] {
        scatter(from, lane, to);
    }
    for (to, from) in one.gains.iter_mut().zip(&s.gains) {
        scatter(from, lane, to);
    }
    if !s.wrenches.given.is_empty() {
        one.wrenches.prepare(&one.model, s.wrenches.given.len() / 6);
        scatter(&s.wrenches.given, lane, &mut one.wrenches.given);
    }
    scatter(&s.totals, lane, &mut one.totals);
}

/// Copies the end of a step of one lane, and the noise in it.
pub(super) fn take_end<T: Vectorized>(one: &mut Scratch<f64>, s: &Scratch<T>, lane: usize) {
    scatter(&s.q_next, lane, &mut one.q_next);
    scatter(&s.model.system.noise, lane, &mut one.model.system.noise);
}

/// Copies one lane of an array.
#[inline(always)]
pub(super) fn scatter<T: Vectorized>(numbers: &[T], lane: usize, out: &mut [f64]) {
    for (value, number) in out.iter_mut().zip(numbers) {
        *value = number.lanes()[lane];
    }
}

impl<T: Real> Scratch<T> {
    pub fn new(scene_model: &Model<f64>, settings: &StepSettings) -> Self {
        let mut of_step = scene_model.clone();
        of_step.system.noise = settings.noise(&settings.scheme);
        for of in settings.set_valued.iter().filter(|of| of.rubs() || of.stops) {
            let noise = &mut of_step.system.noise[of.row];
            *noise = if *noise == 0.0 { FREE } else { *noise };
        }
        let (constants, curved) = (SweepModel::new(&of_step), curved_rows(settings));
        let model = of_step.cast::<T>();
        let (nq, nv) = (model.nq, model.nv());
        let row = |row: usize| {
            let p = &settings.properties;
            let ([kp, kd], noise) = (settings.largest[row], of_step.system.noise[row]);
            RowTerms {
                noise: T::from_f64(noise),
                armature: T::from_f64(p.armature[row]),
                damping: T::from_f64(p.damping[row]),
                stiffness: T::from_f64(p.stiffness[row]),
                friction: T::from_f64(if curved.iter().any(|of| of.row == row) { 0.0 } else { p.friction[row] }),
                proportional: T::from_f64(kp),
                derivative: T::from_f64(kd),
                held: T::zero(),
                slope: T::zero(),
                side: T::zero(),
                phase: T::zero(),
                start: T::zero(),
                clipped: T::zero(),
                has_noise: noise != 0.0,
            }
        };
        let mode = |of: &SetValued| ModeTerms {
            row: of.row,
            coordinate: of.coordinate,
            lower: T::from_f64(of.lower),
            upper: T::from_f64(of.upper),
            friction: T::from_f64(of.rubbing()),
            stuck: T::zero(),
            target: T::zero(),
            at_lower: T::zero(),
            at_upper: T::zero(),
        };
        let width = if settings.gains.is_some() { nv } else { 0 };
        let usual = |i: usize| match i {
            LOWER => f64::NEG_INFINITY,
            UPPER | STALL => f64::INFINITY,
            _ => 0.0,
        };
        let coordinates = || vec![T::zero(); nq];
        let rates = || vec![T::zero(); nv];
        Self {
            sweeps: SweepScratch::new(&model, &constants).accepting(settings.given.tolerance),
            constants,
            rows: (0..nv).map(row).collect(),
            rest: settings.properties.rest.iter().map(|&x| T::from_f64(x)).collect(),
            target: coordinates(),
            target_rate: rates(),
            gains: std::array::from_fn(|i| vec![T::from_f64(usual(i)); width]),
            are_sides_given: false,
            vanishing: FREE,
            torque: rates(),
            wrenches: WrenchScratch::default(),
            q: coordinates(),
            v: rates(),
            q_next: coordinates(),
            v_next: rates(),
            l: std::array::from_fn(|_| rates()),
            m: std::array::from_fn(|_| rates()),
            x: rates(),
            q_stage: coordinates(),
            v_stage: rates(),
            c: rates(),
            u: rates(),
            chord: rates(),
            curved,
            modes: settings.set_valued.iter().map(mode).collect(),
            dry: rates(),
            control: rates(),
            consistent: T::one(),
            short_enough: T::one(),
            without_drives: T::one(),
            totals: [T::zero(); TOTALS],
            displaced: rates(),
            displaced_target: rates(),
            model,
        }
    }
}

impl<T: Real> Scratch<T> {
    /// Sets the measurement noise for a scheme.
    pub fn adopt(&mut self, settings: &StepSettings, scheme: &Scheme) {
        self.vanishing = 0.0;
        self.drive_all(settings, scheme.implicit_step());
    }

    /// The impulse of the control law on a row, N m s or N s, for its velocity at the end of the step.
    #[inline(always)]
    pub fn control_impulse(&self, row: usize) -> T {
        self.control[row].minus_product(self.rows[row].slope, self.v_next[row] - self.v[row])
    }
}

impl<T: Vectorized> Scratch<T> {
    /// Takes the gains and targets of the state of each lane.
    #[inline(always)]
    pub fn take_gains(&mut self, settings: &StepSettings, count: usize, state: impl Fn(usize) -> usize) {
        let Some(gains) = &settings.gains else { return };
        let nv = self.target_rate.len();
        if !gains.changes() {
            self.aim(gains, (0, count), &state);
        }
        for (i, to) in self.gains.iter_mut().enumerate().filter(|(i, _)| !gains.of_state(nv, 0)[*i].is_empty()) {
            take_states(to, count, |lane| gains.of_state(nv, state(lane))[i]);
        }
        self.drive_all(settings, settings.scheme.implicit_step());
    }

    /// Takes the wrenches of step `n`, and its targets if they change.
    #[inline(always)]
    pub fn take_targets(
        &mut self,
        settings: &StepSettings,
        (n, count): (usize, usize),
        state: impl Fn(usize) -> usize,
    ) {
        if let Some(gains) = settings.gains.as_ref().filter(|gains| gains.changes()) {
            self.aim(gains, (n, count), &state);
        }
        if let Some(wrenches) = &settings.wrenches {
            self.wrenches.take(&self.model, wrenches, (n, count), &state);
        }
    }

    #[inline(always)]
    fn aim(&mut self, gains: &Gains, (n, count): (usize, usize), state: &impl Fn(usize) -> usize) {
        let size = (self.target.len(), self.target_rate.len());
        take_states(&mut self.target, count, |lane| gains.targets_of(size, state(lane), n)[0]);
        take_states(&mut self.target_rate, count, |lane| gains.targets_of(size, state(lane), n)[1]);
    }
}

/// Copies values into one lane of an array.
pub(super) fn fill<T: Vectorized>(numbers: &mut [T], lane: usize, values: &[f64]) {
    for (number, &value) in numbers.iter_mut().zip(values) {
        number.lanes_mut()[lane] = value;
    }
}

/// sum += c x.
#[inline(always)]
pub(super) fn add_scaled<T: Real>(sum: &mut [T], c: f64, x: &[T]) {
    if c == 0.0 {
        return;
    }
    for (sum, &x) in sum.iter_mut().zip(x) {
        *sum = x.mul_add(x.constant(c), *sum);
    }
}

/// Sets all entries to zero.
#[inline(always)]
pub(super) fn clear<T: Real>(numbers: &mut [T]) {
    for x in numbers {
        *x = x.constant(0.0);
    }
}
