//! Steps with contacts by the compiled kernels, for one state per lane of a scalar.
//!
//! Free velocities, gaps, G and the effect of impulses are vectorized; the contact law is solved for one state after
//! another. A state needs the [checked step](super::step) if an error estimate exceeds the tolerance, if it flies, if a
//! contact rebounds, if a joint reaches a stop, if a further contact closes because of the impulses, or if the law is
//! not solved.

use super::super::drives::agreement;
use super::super::faults::strays;
use super::super::limit_rows::limit_rows;
use super::super::scratch::{Scratch, fill, take_end, take_lane};
use super::super::step_settings::StepSettings;
use super::super::works::add_work;
use super::faults::REFUSED;
use super::free_axes::{move_along, to_axes_at_end, to_axes_at_rest};
use super::gap::touching_gap;
use super::project::{TOUCHES, out_of_planes};
use super::record::Outcome;
use super::report::ContactReport;
use super::step::{LATE, keep, report, rest_speed};
use super::stepper::ContactStepper;
use crate::batch::factor;
use crate::batch::instruction_set::{Vectorized, lanes_of, within_target};
use crate::contact::{Cone, Cones, Effort, Limits, SolveReport, passive};
use crate::dynamics::contact_kernel::ContactKernel;
use crate::dynamics::contacts::LimitRow;
use crate::dynamics::sweeps::{SweepScratch, place};
use crate::filter::Form;
use crate::model::Model;
use crate::scalar::lanes_but;
use crate::scene::Scene;
use nalgebra::{DMatrix, DVector};

/// The values of the states, their number per state, and the index of the first value of the contacts.
type OfContacts<'a> = (&'a mut [f64], usize, usize);

/// Scratch memory of one state per lane.
pub(in crate::motion) struct Touching<T: Vectorized> {
    kernel: ContactKernel<T>,
    /// The joints at the end of the step.
    ahead: SweepScratch<T>,
    limits: Vec<LimitRow>,
    /// J v of all contacts at the start of the step, without impulses, and with them.
    start: Vec<T>,
    free: Vec<T>,
    after: Vec<T>,
    impulses: Vec<T>,
    innovations: Vec<T>,
    solved: Vec<Solved>,
}

/// The contacts of one state in a step.
struct Solved {
    outcome: Outcome,
    /// J v of the near contacts without impulses.
    free: DVector<f64>,
    report: SolveReport,
    impulse_kept: f64,
}

impl<T: Vectorized> Touching<T> {
    pub fn new(scene: &Scene, settings: &StepSettings, s: &Scratch<T>) -> Self {
        let (nan, n) = (T::from_f64(f64::NAN), scene.contact_points().len());
        let nothing = || Solved {
            outcome: Outcome::default(),
            free: DVector::zeros(0),
            report: SolveReport::nothing(),
            impulse_kept: 1.0,
        };
        Self {
            kernel: ContactKernel::new((&s.model, &s.constants), scene.contact_points()),
            ahead: SweepScratch::new(&s.model, &s.constants),
            limits: if settings.stops() { limit_rows(scene) } else { Vec::new() },
            start: vec![nan; 3 * n],
            free: vec![nan; 3 * n],
            after: vec![nan; 3 * n],
            impulses: vec![T::zero(); 3 * n],
            innovations: vec![nan; s.model.nv()],
            solved: (0..T::LANES).map(|_| nothing()).collect(),
        }
    }

    /// The contacts that are near in one lane: those that touch, or would end the step below their plane.
    fn find_near(&mut self, settings: &StepSettings, lane: usize) {
        let Self { kernel, free, solved, .. } = self;
        let near = &mut solved[lane].outcome.near;
        near.clear();
        let gap = |i: usize| kernel.gaps[i].lanes()[lane];
        let ends = |i: usize| gap(i) + settings.step * free[3 * i + 2].lanes()[lane];
        near.extend((0..kernel.gaps.len()).filter(|&i| gap(i) <= 0.0 || ends(i) <= 0.0));
    }

    /// True if one lane moves without contacts that rest, so that its step is that of a flight.
    fn flies(&self, settings: &StepSettings, model: &Model<T>, lane: usize) -> bool {
        let (h, least) = (settings.step, touching_gap(model, settings.step));
        settings.free.is_some()
            && (0..self.kernel.gaps.len()).all(|i| {
                let (gap, speed) = (self.kernel.gaps[i].lanes()[lane], self.start[3 * i + 2].lanes()[lane]);
                !(gap <= least && h * speed.abs() <= least)
            })
    }

    /// Solves the contact law of one lane; returns false if it needs the fallback.
    fn solve(
        &mut self,
        (scene, settings): (&Scene, &StepSettings),
        model: &Model<T>,
        lane: usize,
        kept: &[f64],
    ) -> bool {
        let Self { kernel, start, free, impulses, solved, .. } = self;
        let Solved { outcome, free: free_here, report, impulse_kept } = &mut solved[lane];
        let (points, h, near) = (scene.contact_points(), settings.step, &outcome.near);
        let rest_speed = rest_speed(model, h, settings.given.accuracy);
        let hits = |&i: &usize| points[i].restitution > 0.0 && start[3 * i + 2].lanes()[lane] < -rest_speed;
        if near.iter().any(hits) {
            return false;
        }
        let (m, all, gram) = (3 * near.len(), 3 * points.len(), kernel.gram());
        let row = |i: usize| 3 * near[i / 3] + i % 3;
        let entry = |i: usize, j: usize| gram[row(i.max(j)) * all + row(i.min(j))].lanes()[lane];
        let cone = Cone::new(DMatrix::from_fn(m, m, entry), near.iter().map(|&i| points[i].friction).collect());
        *free_here = DVector::from_fn(m, |i, _| free[row(i)].lanes()[lane]);
        let mut c = free_here.clone();
        for (at, &i) in near.iter().enumerate() {
            c[3 * at + 2] += kernel.gaps[i].lanes()[lane].max(0.0) / h;
        }
        // NaN fails.
        if !cone.lengths.iter().chain(&c).all(|x| x.is_finite()) {
            return false;
        }
        let cone = Cones::split(cone);
        let limits = Limits::of_step(&c, free_here);
        let warm = DVector::from_fn(m, |i, _| kept[row(i)]);
        let (held, found) = cone.impulses(&c, Some(&warm), &limits, Effort::default());
        let (held, part) = passive(&cone, free_here, held);
        for (i, &impulse) in held.iter().enumerate() {
            impulses[row(i)].lanes_mut()[lane] = impulse;
        }
        outcome.states = cone.states(&held, &c, &limits);
        (outcome.held, *report, *impulse_kept) = (held, found, part);
        found.residual <= REFUSED
    }

    /// The report of one lane; returns false if a further contact closes.
    fn report_on(&mut self, settings: &StepSettings, model: &Model<T>, lane: usize) -> bool {
        let Self { kernel, start, after, solved, .. } = self;
        let Solved { outcome, free, report: solved, impulse_kept } = &mut solved[lane];
        let near = &outcome.near;
        let late = |i: usize| {
            let gap = kernel.gaps[i].lanes()[lane].max(0.0);
            gap + settings.step * after[3 * i + 2].lanes()[lane] < -LATE
        };
        if (0..kernel.gaps.len()).any(|i| late(i) && !near.contains(&i)) {
            return false;
        }
        let pick = |all: &[T]| DVector::from_fn(3 * near.len(), |i, _| all[3 * near[i / 3] + i % 3].lanes()[lane]);
        let velocities = (&outcome.held, [&pick(start), &*free, &pick(after)]);
        let counted = (near.len(), rest_speed(model, settings.step, settings.given.accuracy));
        outcome.report = report(solved, solved.iterations, *impulse_kept, (0.0, None), velocities, counted);
        true
    }
}

within_target! {
    /// Ends a step: impulses, `v_next` and `q_next`, the works, and the stored values of the contacts. Returns the
    /// lanes that need the fallback, with those that already do.
    #[inline(never)]
    pub(in crate::motion) fn finish_contacts<'a, T, I>(
        target;
        touching: &'a mut Touching<T>,
        checked: (Form, &'a mut Option<Box<ContactStepper>>),
        of: (&'a Scene, &'a StepSettings),
        s: &'a mut Scratch<T>,
        contacts: (OfContacts<'a>, u64),
    ) -> u64 {
        let ((form, alone), ((kept, width, at), mut fallback)) = (checked, contacts);
        let ((scene, settings), count) = (of, kept.len() / width);
        let h = settings.step;
        let zero = s.model.gravity[0].constant(0.0);
        to_axes_at_rest(&s.model, h, &s.v, &mut s.v_next);
        let constants = (&s.model, &s.constants);
        touching.kernel.place(constants, &s.sweeps);
        touching.kernel.velocities(constants, &s.sweeps, &s.v, &mut touching.start);
        touching.kernel.velocities(constants, &s.sweeps, &s.v_next, &mut touching.free);
        fallback |= touching.at_limits(h, &s.q, &s.v_next);
        let mut touched = 0_u64;
        for lane in 0..count {
            touching.find_near(settings, lane);
            touched |= u64::from(!touching.solved[lane].outcome.near.is_empty()) << lane;
            fallback |= u64::from(touching.flies(settings, &s.model, lane)) << lane;
        }
        if touched != 0 {
            touching.kernel.multiply(constants, &s.sweeps);
            touching.impulses.fill(zero);
            for lane in lanes_of(touched & !fallback) {
                let kept = &kept[lane * width + at..(lane + 1) * width];
                fallback |= u64::from(!touching.solve(of, &s.model, lane, kept)) << lane;
            }
            let Touching { kernel, innovations, impulses, free, after, .. } = &mut *touching;
            kernel.innovations_of(impulses, innovations);
            factor::smooth(target, constants, &mut s.sweeps, innovations);
            for (v, change) in s.v_next.iter_mut().zip(&*innovations) {
                *v += *change;
            }
            kernel.velocities_after(free, impulses, after);
            for lane in lanes_of(touched & !fallback) {
                fallback |= u64::from(!touching.report_on(settings, &s.model, lane)) << lane;
            }
            fallback |= touching.at_limits(h, &s.q, &s.v_next);
        }
        let agrees = agreement((settings, &settings.scheme), s);
        fallback |= lanes_but::<T>(|lane| agrees.lane(lane) > 0.0);
        move_along(h, s);
        add_work(settings, s);
        place::<T, T>(&s.constants, &mut touching.ahead, zero, &s.q_next);
        touching.kernel.place_gaps((&s.model, &s.constants), &touching.ahead);
        fallback |= strays(settings, s);
        for lane in lanes_of((u64::MAX >> (64 - count)) & !fallback) {
            let kept = &mut kept[lane * width + at..(lane + 1) * width];
            let gaps = touching.kernel.gaps.iter().map(|gap| gap.lanes()[lane]);
            let mut depth = -gaps.fold(0.0, f64::min);
            let mut iterations = 0;
            if depth > TOUCHES {
                let alone = alone.get_or_insert_with(|| Box::new(ContactStepper::new(scene, settings, form)));
                let ContactStepper { scratch: one, touching: step, .. } = &mut **alone;
                take_lane(one, s, lane);
                take_end(one, s, lane);
                let ends = (&mut one.q_next[..], &mut one.q_stage[..]);
                let workspace = &mut step.solver.workspace;
                let found = out_of_planes((scene, &one.model), workspace, &mut step.rows, ends, (None, &[]));
                let Ok(found) = found else {
                    fallback |= 1 << lane;
                    continue;
                };
                (depth, iterations) = found;
                fill(&mut s.q_next, lane, &one.q_next);
            }
            let mut nothing = Outcome::default();
            let outcome = &mut touching.solved[lane].outcome;
            let outcome = if touched >> lane & 1 == 1 { outcome } else { &mut nothing };
            keep(kept, outcome, scene.contact_points().len());
            #[allow(clippy::cast_precision_loss)] // a small count
            let iterations = outcome.report.iterations + iterations as f64;
            ContactReport::add(kept, &ContactReport { iterations, depth, ..outcome.report });
        }
        to_axes_at_end(&s.model, (&s.q, &s.q_next), &mut s.v_next);
        fallback
    }
}

impl<T: Vectorized> Touching<T> {
    /// The lanes in which a joint reaches a limit or is beyond it.
    #[inline(always)]
    fn at_limits(&self, h: f64, q: &[T], v_next: &[T]) -> u64 {
        let Some(mut within) = q.first().map(|q| q.constant(1.0)) else { return 0 };
        for limit in &self.limits {
            let (sign, bound) = (within.constant(limit.sign()), within.constant(limit.bound));
            let gap = sign * (q[limit.coordinate] - bound);
            let end = (sign * v_next[limit.row]).mul_add(within.constant(h), gap);
            within = within.worst(gap).worst(end);
        }
        lanes_but::<T>(|lane| within.lane(lane) > 0.0)
    }
}
