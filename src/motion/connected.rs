//! Steps of scenes with connections by the compiled kernels, for one state per lane of a scalar.
//!
//! At the end of a step, positions and velocities are projected onto the connections with factors of M and of G at the
//! new configuration; those of the last stage correct the positions first, where the result is the same. In explicit
//! methods the first stage of the next step uses the factors of the end. A state needs the [checked
//! step](super::constrained) if its rows are dependent, if an error estimate exceeds the tolerance, if a projection
//! does not converge in a few steps, or if a joint reaches a stop.

mod reverse;

pub(super) use reverse::ConnectedReverse;

use super::manifold::advance;
use super::scratch::{Scratch, add_scaled};
use super::step_settings::StepSettings;
use crate::batch::accelerations::KernelArguments;
use crate::batch::connected::{self, factor_rows, factors};
use crate::batch::factor;
use crate::batch::instruction_set::{Target, Vectorized, within_target};
use crate::dynamics::constraints::{CLOSED, ConstraintKernel, FARTHEST, ROUNDED, Residuals, extent, largest_of};
use crate::dynamics::contacts::LimitRow;
use crate::dynamics::sweeps::{self, SweepModel, SweepScratch};
use crate::filter::Form;
use crate::model::Model;
use crate::scalar::{Real, lanes_but};
use crate::scene::Scene;
use crate::scene::constraint::Constraints;

/// Largest number of steps of a projection; a state that needs more is projected by the checked step.
const STEPS: usize = 4;

/// The largest error of a stage, rad or m, which is not projected, and the largest time derivative of an error relative
/// to the joint velocities. Beyond, the usual form of the rows can differ between lanes and one state.
const SLACK: f64 = 0.1;

/// An error below this, relative to the size, is rounding after one step with the factors of a configuration nearby.
const NEAR: f64 = 1e3 * ROUNDED;

/// Factors of a configuration nearby remove an error if it, times the distance of this configuration, is below this,
/// relative to the size: the results differ by that much.
const ALIKE: f64 = 128.0 * ROUNDED;

/// A limit is reached if the step ends further outside than this, rad or m.
const LATE: f64 = 1e-12;

/// Scratch memory of one state per lane.
#[derive(Debug)]
pub(super) struct Connected<T: Vectorized> {
    rows: ConstraintKernel<T>,
    /// The factors of the projection, if the noise of the steps contains more than the rotor inertias.
    own: Option<Box<Projection<T>>>,
    /// e^- of the tree or of a projection.
    innovations: Vec<T>,
    /// The change of a projection, and the configuration that it leads to.
    change: Vec<T>,
    moved: Vec<T>,
    /// q and v at the end of the last run.
    end: Vec<T>,
    limits: Vec<LimitRow>,
    /// One plus the distance of the bodies from the base, m.
    size: f64,
    /// The lanes that hold states.
    active: u64,
    /// True if the factors of the steps are those of the start of the next step; the lanes that they do not suit.
    is_ready: bool,
    doubt: u64,
    /// The lanes whose residual needed a correction in the first stage of the step.
    corrected: u64,
    /// True if no lane can complete the step.
    is_hopeless: bool,
}

/// The factors of M without damping and springs, and of its rows.
#[derive(Debug)]
struct Projection<T: Vectorized> {
    model: Model<T>,
    constants: SweepModel<T>,
    sweeps: SweepScratch<T>,
    rows: ConstraintKernel<T>,
}

impl<T: Vectorized> Connected<T> {
    /// Scratch memory for the connections of a scene, with its stops. `s` is the scratch memory of its steps.
    pub fn new(scene: &Scene, settings: &StepSettings, s: &Scratch<T>, limits: Vec<LimitRow>) -> Self {
        let (model, nan) = (scene.model(), T::from_f64(f64::NAN));
        let rows_of = |scene_of: (&Model<T>, &SweepModel<T>)| kernel_of_rows(scene_of, scene.constraints());
        let shares = settings.noise(&settings.scheme) == settings.properties.armature
            && !(settings.regularized && settings.scheme.implicit);
        let own = (!shares).then(|| {
            let mut model = model.clone();
            model.system.noise.clone_from(&settings.properties.armature);
            let constants = SweepModel::new(&model);
            let model = model.cast::<T>();
            let sweeps = SweepScratch::new(&model, &constants).accepting(settings.given.tolerance);
            let rows = rows_of((&model, &constants));
            Box::new(Projection { model, constants, sweeps, rows })
        });
        Self {
            rows: rows_of((&s.model, &s.constants)),
            own,
            innovations: vec![nan; model.nv()],
            change: vec![nan; model.nv()],
            moved: vec![nan; model.nq],
            end: vec![nan; model.nq + model.nv()],
            limits,
            size: 1.0 + extent(model),
            active: u64::MAX,
            is_ready: false,
            doubt: 0,
            corrected: 0,
            is_hopeless: false,
        }
    }

    /// Begins a run of steps of this number of states from the state of the scratch memory. The factors of the last run
    /// remain if it ended there.
    pub fn begin(&mut self, states: usize, s: &Scratch<T>) {
        self.active = u64::MAX >> (64 - states);
        let (q, v) = self.end.split_at(s.q.len());
        let is_same = |a: &[T], b: &[T]| a.iter().zip(b).all(|(a, b)| a.lanes() == b.lanes());
        self.is_ready &= is_same(q, &s.q) && is_same(v, &s.v);
    }

    /// Ends a run of steps at the state of the scratch memory.
    pub fn end(&mut self, s: &Scratch<T>) {
        let (q, v) = self.end.split_at_mut(s.q.len());
        q.copy_from_slice(&s.q);
        v.copy_from_slice(&s.v);
    }

    /// Must be called if a state of the next step is not that of [`Connected::finish`].
    pub fn replaced(&mut self) {
        self.is_ready = false;
    }

    /// The accelerations of a stage. Returns the lanes that need the fallback.
    pub fn accelerations<I: Target>(
        &mut self,
        (target, form, is_first): (I, Form, bool),
        KernelArguments { scene, scratch, state: (q, v, u), qdd, .. }: KernelArguments<'_, T>,
    ) -> u64 {
        if !is_first && self.is_hopeless {
            return u64::MAX;
        }
        let doubt = if is_first {
            // As for the error estimate of trees, the later stages are similar.
            let is_ready = std::mem::take(&mut self.is_ready);
            if !is_ready {
                self.doubt = factors((target, form), scene, (scratch, &mut self.rows), (q, v), &mut self.change);
            }
            self.is_hopeless = self.active & !self.doubt == 0;
            if self.is_hopeless {
                return u64::MAX;
            }
            factor::innovations(target, scene, scratch, (q, v, u), (&[], &mut self.innovations));
            self.doubt
        } else {
            let lost = factor::with_innovations(target, scene, scratch, (q, v, u), &mut self.innovations);
            lost | factor_rows(target, scene, scratch, &mut self.rows, (q, v))
        };
        // The first stage decides for the others too, which residuals are corrected.
        let allowed = if is_first { u64::MAX } else { self.corrected };
        let vectors = (u, &mut self.innovations[..], qdd);
        let lanes = (self.active & !doubt, allowed);
        let (corrected, open) = connected::accelerations(target, scene, scratch, &mut self.rows, vectors, lanes);
        if is_first {
            self.corrected = corrected;
        }
        doubt | open
    }

    /// Ends a step: projects `q_next` and `v_next` onto the connections. Returns the lanes that need the fallback.
    #[inline(never)]
    pub fn finish<I: Target>(&mut self, target: I, form: Form, s: &mut Scratch<T>) -> u64 {
        if self.is_hopeless {
            return u64::MAX;
        }
        finish(target, self, form, s)
    }
}

/// The kernel of the rows in steps.
pub(super) fn kernel_of_rows<T: Real>(
    scene: (&Model<T>, &SweepModel<T>),
    constraints: &Constraints,
) -> ConstraintKernel<T> {
    let mut rows = ConstraintKernel::new(scene, constraints);
    rows.slack = SLACK;
    rows
}

/// The lanes in which a step begins beyond a limit, or ends there.
#[inline(always)]
fn beyond_limits<T: Vectorized>(limits: &[LimitRow], (q, q_next): (&[T], &[T])) -> u64 {
    let Some(first) = q.first() else { return 0 };
    let (zero, mut within) = (first.constant(0.0), first.constant(1.0));
    for limit in limits {
        let (at, sign, bound) = (limit.coordinate, zero.constant(limit.sign()), zero.constant(limit.bound));
        within = within.worst(sign * (q_next[at] - bound) + zero.constant(LATE)).worst(sign * (q[at] - bound));
    }
    lanes_but::<T>(|lane| within.lane(lane) >= 0.0)
}

within_target! {
    /// As [`Connected::finish`].
    fn finish<'a, T, I>(target; connected: &'a mut Connected<T>, form: Form, s: &'a mut Scratch<T>) -> u64 {
        let Connected { rows, own, innovations, change, moved, active, .. } = connected;
        let Scratch { model, constants, sweeps, q, q_stage, q_next, v_next, .. } = s;
        let zero = model.gravity[0].constant(0.0);
        let mut doubt = beyond_limits(&connected.limits, (q, q_next));
        let is_shared = own.is_none();
        let (scene, sweeps, rows) = match own {
            Some(own) => ((&own.model, &own.constants), &mut own.sweeps, &mut own.rows),
            None => ((&*model, &*constants), sweeps, rows),
        };
        let size = zero.constant(connected.size);
        let mut of_factor;
        let mut before = zero.constant(f64::INFINITY);
        let mut step = 0;
        // The factors of the last stage are those of a configuration nearby: they remove the errors of the step, so
        // that usually only the factors at the end are computed. The results differ by the error times the distance
        // of the configurations. A lane does not depend on others.
        for (moved, (end, stage)) in moved.iter_mut().zip(q_next.iter().zip(&*q_stage)) {
            *moved = *end - *stage;
        }
        let distance = largest_of(moved, zero);
        let mut open = if is_shared { *active & !doubt } else { 0 };
        while open != 0 && step < STEPS {
            sweeps::place(scene.1, sweeps, T::Columns::from_f64(0.0), q_next);
            rows.rows.errors_at(scene, sweeps, q_next);
            let left = rows.largest(Residuals::Errors);
            open &= open_lanes(left, before, size, 0.5);
            open &= lanes_but::<T>(|lane| !(left.lane(lane) * distance.lane(lane) <= ALIKE * size.lane(lane)));
            if open == 0 {
                break;
            }
            (before, step) = (left, step + 1);
            let vectors = (&mut innovations[..], &mut change[..], &mut moved[..]);
            doubt |= step_back((target, scene), (sweeps, rows), vectors, (q_next, open));
            open &= lanes_but::<T>(|lane| left.lane(lane) <= NEAR * size.lane(lane));
        }
        (before, step) = (zero.constant(f64::INFINITY), 0);
        loop {
            of_factor = factors((target, form), scene, (sweeps, rows), (q_next, v_next), change);
            let left = rows.largest(Residuals::Errors);
            let open = open_lanes(left, before, size, 0.5);
            if open & *active & !doubt & !of_factor == 0 || step == STEPS {
                doubt |= open;
                break;
            }
            (before, step) = (left, step + 1);
            let vectors = (&mut innovations[..], &mut change[..], &mut moved[..]);
            doubt |= step_back((target, scene), (sweeps, rows), vectors, (q_next, open));
        }
        doubt |= of_factor;
        let lanes = (size, *active & !doubt);
        doubt |= slow((target, scene), (sweeps, rows), (innovations, change), (v_next, lanes), None);
        (connected.is_ready, connected.doubt) = (is_shared, of_factor);
        doubt
    }
}

/// Changes the configuration of the lanes given as bits so that the errors of the rows vanish to first order. Returns
/// those of them whose change is too large.
#[inline(always)]
fn step_back<T: Vectorized, I: Target>(
    (target, scene): (I, (&Model<T>, &SweepModel<T>)),
    (sweeps, rows): (&mut SweepScratch<T>, &mut ConstraintKernel<T>),
    (innovations, change, moved): (&mut [T], &mut [T], &mut [T]),
    (q, lanes): (&mut [T], u64),
) -> u64 {
    rows.step_against(Residuals::Errors, innovations);
    change.copy_from_slice(innovations);
    factor::smooth(target, scene, sweeps, change);
    let longest = largest_of(change, scene.0.gravity[0].constant(0.0));
    advance(scene.0, q, change, moved);
    replace(q, moved, lanes);
    lanes & lanes_but::<T>(|lane| longest.lane(lane) <= FARTHEST)
}

/// Changes the velocities of the lanes given as bits so that the rates of the rows vanish, in a few steps; `size` is
/// that of the robot. Adds the forces to the second of two vectors. Returns the lanes that need more steps.
#[inline(always)]
fn slow<T: Vectorized, I: Target>(
    (target, scene): (I, (&Model<T>, &SweepModel<T>)),
    (sweeps, rows): (&mut SweepScratch<T>, &mut ConstraintKernel<T>),
    (innovations, changed): (&mut [T], &mut [T]),
    (v, (size, lanes)): (&mut [T], (T, u64)),
    mut forces: Option<[&mut [T]; 2]>,
) -> u64 {
    let zero = size.constant(0.0);
    let speed = largest_of(v, zero).mul_add(size, zero.constant(1.0));
    let (mut before, mut step) = (zero.constant(f64::INFINITY), 0);
    loop {
        let left = rows.largest(Residuals::Rates);
        let open = open_lanes(left, before, speed, 0.25);
        let going = open & lanes;
        if going == 0 || step == STEPS {
            return open;
        }
        (before, step) = (left, step + 1);
        rows.step_against(Residuals::Rates, innovations);
        factor::smooth(target, scene, sweeps, innovations);
        for (changed, (v, change)) in changed.iter_mut().zip(v.iter().zip(&*innovations)) {
            *changed = *v + *change;
        }
        replace(v, changed, going);
        rows.rows.at_velocities(scene, sweeps, v);
        if let Some([own, sum]) = &mut forces {
            own.copy_from_slice(rows.step());
            keep(own, going, zero);
            add_scaled(sum, 1.0, own);
        }
    }
}

/// The lanes whose largest residual is above rounding. A residual that is small and no longer decreases by `falls` is
/// rounding too.
#[inline(always)]
fn open_lanes<T: Real>(left: T, before: T, size: T, falls: f64) -> u64 {
    lanes_but::<T>(|lane| {
        let (left, before, size) = (left.lane(lane), before.lane(lane), size.lane(lane));
        let is_rounding = before.is_finite() && !(left < falls * before) && left <= CLOSED * size;
        left <= ROUNDED * size || is_rounding
    })
}

/// Copies the lanes given as bits.
#[inline(always)]
fn replace<T: Vectorized>(to: &mut [T], from: &[T], lanes: u64) {
    for (to, from) in to.iter_mut().zip(from) {
        for (lane, (to, from)) in to.lanes_mut().iter_mut().zip(from.lanes()).enumerate() {
            if lanes >> lane & 1 == 1 {
                *to = *from;
            }
        }
    }
}

/// Sets all lanes but those given as bits to zero.
#[inline(always)]
fn keep<T: Vectorized>(numbers: &mut [T], lanes: u64, zero: T) {
    for number in numbers {
        for (lane, number) in number.lanes_mut().iter_mut().enumerate() {
            if lanes >> lane & 1 == 0 {
                *number = zero.lanes()[lane];
            }
        }
    }
}
