//! Backpropagation through the steps of one state with contacts: recomputes and differentiates each step, and sums the
//! gradients by the contacts.

use super::super::backward::StepGradients;
use super::super::manifold::displacement;
use super::super::reversed_substeps::{Parts, through_substeps};
use super::super::scratch::Scratch;
use super::super::step_settings::StepSettings;
use super::at::Connections;
use super::backward::{ContactAdjoint, ContactGradient};
use super::parts::Part;
use super::record::StepRecord;
use super::report::{begin, width};
use super::shaped::{self, Shaped};
use super::step::ContactStep;
use crate::contact::{ContactState, Limits};
use crate::error::{Error, in_language};
use crate::filter::Form;
use crate::scene::{Contact, Scene, Surface};
use nalgebra::Vector3;
use std::collections::{BTreeMap, BTreeSet};

/// Largest deviation of a recomputed step from the recorded one, relative to coordinates and velocities of at least
/// one.
const REPRODUCED: f64 = 1e-5;

/// Largest number of steps from which the impulses before a step are recomputed.
const BACK: usize = 16;

/// Propagates the gradients by the end of a step of the tree, for its settings and its start in the scratch.
pub(in crate::motion) type FlightAdjoint<'a> =
    dyn FnMut(&StepSettings, &Scratch<f64>, &mut StepGradients<f64>) -> Result<(), (String, Error)> + 'a;

/// Distance of a contact from another mode, m/s, and its state.
type Mode = (f64, ContactState);

/// A contact of a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum ContactId {
    /// One that the scene names, by its index.
    Named(usize),
    /// A pair of shapes that touch, by the indices of their colliders, the lower one first.
    Shapes([usize; 2]),
}

/// Gradients by a pair of shapes in one state, of a run in which it could touch.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ShapeGradients {
    /// Index of the state in the batch.
    pub state: usize,
    /// Indices of the colliders, the lower one first.
    pub colliders: [usize; 2],
    /// By the coefficient of friction of the pair.
    pub friction: f64,
    /// By the coefficient of restitution of the pair.
    pub restitution: f64,
    /// Smallest distance of a point of contact from another mode over all steps, m/s.
    pub margin: f64,
    /// The step with this distance.
    pub margin_step: usize,
}

/// A contact, or a point of contact of a pair of shapes, that is in another state in a step than in the step before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct ModeChange {
    /// Index of the state in the batch.
    pub state: usize,
    /// The first step in the new state.
    pub step: usize,
    /// The contact.
    pub contact: ContactId,
    /// State of the contact in the step before.
    pub before: ContactState,
    /// State of the contact in this step.
    pub after: ContactState,
}

/// Scratch memory for one state, with the sums over its steps.
pub(in crate::motion) struct ContactReverse {
    pub scratch: Scratch<f64>,
    pub gradients: StepGradients<f64>,
    step: ContactStep,
    adjoint: ContactAdjoint,
    connections: Connections,
    /// Impulses of the last recomputed step, from which the solves of the next one start.
    kept: Vec<f64>,
    /// The contacts of the last recomputed step, in the order of their rows.
    contacts: Vec<ContactId>,
    sums: BTreeMap<ContactId, ContactGradient>,
    modes: Modes,
    shaped: Option<Box<Shaped>>,
}

impl ContactReverse {
    /// Number of values per contact that [`ContactReverse::write`] writes: the gradients by friction, restitution,
    /// offset and unit normal, the margin and its step.
    pub const WIDTH: usize = 8;

    #[cold]
    pub fn new(scene: &Scene, settings: &StepSettings, form: Form, parameters: bool) -> Self {
        let scratch = Scratch::new(scene.model(), settings);
        let contacts = scene.contacts().len();
        let mut step = ContactStep::new(scene, settings, form);
        step.record = Some(StepRecord::default());
        Self {
            gradients: StepGradients::new(&scratch.model, settings, parameters),
            adjoint: ContactAdjoint::new(&scratch.model),
            connections: Connections::new(scene, settings, &scratch.model, parameters),
            step,
            scratch,
            kept: vec![0.0; width(contacts)],
            contacts: (0..contacts).map(ContactId::Named).collect(),
            sums: BTreeMap::new(),
            modes: Modes::default(),
            shaped: Shaped::new(scene).map(Box::new),
        }
    }

    /// Begins with the last step of a state.
    pub fn begin(&mut self) {
        begin(&mut self.kept);
        self.sums.clear();
        self.modes = Modes::default();
    }

    /// Makes a step, with the contacts of shapes that it can reach.
    fn make(&mut self, scene: &Scene, settings: &StepSettings) -> Result<(), (String, Error)> {
        let Self { scratch, step, kept, shaped, .. } = self;
        shaped::step(shaped.as_deref_mut(), step, (scene, settings), scratch, kept)
    }

    /// Repeats step `n` until it ends at the recorded row. With friction the law can have several solutions, of which
    /// the one near the impulses of the step before is found: they are recomputed from more and more of the rows
    /// before.
    fn reproduce(
        &mut self,
        (scene, settings): (&Scene, &StepSettings),
        n: usize,
        recorded: (&[f64], &[f64]),
        row_before: impl Fn(usize) -> Option<Vec<f64>>,
    ) -> Result<(), (String, Error)> {
        let start = (self.scratch.q.clone(), self.scratch.v.clone());
        for back in 0.. {
            let missed = check_reproduced(n, recorded, (&self.scratch.q_next, &self.scratch.v_next));
            let rows: Option<Vec<_>> = (1..=back).rev().map(&row_before).collect();
            let (Err(_), Some(rows)) = (&missed, rows.filter(|_| back <= BACK)) else {
                return missed.map_err(|error| (String::new(), error));
            };
            begin(&mut self.kept);
            for row in rows {
                let (q, v) = row.split_at(start.0.len());
                (self.scratch.q, self.scratch.v) = (q.to_vec(), v.to_vec());
                self.make(scene, settings)?;
            }
            (self.scratch.q, self.scratch.v) = start.clone();
            self.make(scene, settings)?;
        }
        Ok(())
    }

    /// Propagates the gradients through step `n`, whose end is `recorded`; `row_before` gives (q, qd) some steps before
    /// it, if the run has begun. `flight` propagates them through parts without contacts. Calls `changed` with the
    /// changes of contacts between this step and the next one. Returns the joint and the error if it fails.
    pub fn through(
        &mut self,
        (scene, settings): (&Scene, &StepSettings),
        n: usize,
        recorded: (&[f64], &[f64]),
        row_before: impl Fn(usize) -> Option<Vec<f64>>,
        (flight, changed): (&mut FlightAdjoint<'_>, impl FnMut(ContactId, ContactState, ContactState)),
    ) -> Result<(), (String, Error)> {
        self.make(scene, settings)?;
        self.reproduce((scene, settings), n, recorded, row_before)?;
        let shaped = self.shaped.take();
        let of_step = shaped.as_ref().map_or(scene, |shaped| &shaped.scene);
        let of_shapes = shaped.iter().flat_map(|shaped| &shaped.shapes.pairs);
        self.contacts.truncate(scene.contacts().len());
        self.contacts.extend(of_shapes.map(|pair| ContactId::Shapes(pair.colliders)));
        let through = self.through_parts((of_step, settings), flight);
        self.shaped = shaped;
        self.modes.add(n, self.contacts.iter().copied().zip(through?), changed);
        self.gradients.check(scene)
    }

    /// Propagates the gradients through the parts of a step, which end at impacts: with b(h) the product of the
    /// cotangent of the end of a part and the derivative of that end by the length of the part, a longer part changes
    /// the result by b less that of the last part, which is then shorter, and a larger gap at its end makes it longer.
    fn through_parts(
        &mut self,
        (scene, settings): (&Scene, &StepSettings),
        flight: &mut FlightAdjoint<'_>,
    ) -> Result<Vec<Mode>, (String, Error)> {
        let parts = std::mem::take(&mut self.step.division.parts);
        if parts.is_empty() {
            return self.through_part((scene, settings), None, flight);
        }
        let (mut own, mut last, mut modes) = (settings.clone(), None, Vec::new());
        let (made, mut parts): (Vec<_>, Vec<_>) = parts.into_iter().unzip();
        through_substeps(self, settings, made, |one, made| {
            let Some(part) = parts.pop() else { return Ok(()) };
            // The length of the part of an impact is constant.
            let (by_length, of_gap) = if last.is_some() && part.ended.is_none() {
                (0.0, 0.0)
            } else {
                one.by_length((scene, &mut own), made.scheme.step, &part)?
            };
            own.adopt(made.scheme.step);
            one.step.repeat((scene, &own), &mut one.scratch, &part)?;
            let by_last = *last.get_or_insert(by_length);
            let of_gap = part.ended.map(|row| (row, (by_last - by_length) / of_gap));
            let now = one.through_part((scene, &own), of_gap, flight)?;
            if modes.is_empty() {
                modes = now;
                return Ok(());
            }
            for ((least, state), (margin, before)) in modes.iter_mut().zip(now) {
                *least = least.min(margin);
                *state = if *state == ContactState::Open { before } else { *state };
            }
            Ok(())
        })?;
        self.scratch.adopt(settings, &settings.scheme);
        Ok(modes)
    }

    /// The derivatives by the length of a part: of the product of the cotangent and its end, and of the gap at which it
    /// ends, by one-sided differences of second order.
    fn by_length(
        &mut self,
        (scene, settings): (&Scene, &mut StepSettings),
        length: f64,
        part: &Part,
    ) -> Result<(f64, f64), (String, Error)> {
        /// Differences of lengths relative to the step, of parts with contact forces and of flights: the end of the
        /// former is nearly a polynomial of second degree in the length, but solved for less accurately.
        const OF_CONTACTS: f64 = 2e-3;
        const OF_FLIGHT: f64 = 2e-4;
        let Self { scratch: s, step, gradients, .. } = self;
        let (mut difference, mut ends) = (0.0, Vec::new());
        for k in [0.0_f64, 1.0, 2.0] {
            settings.adopt(k.mul_add(difference, length));
            step.repeat((scene, settings), s, part)?;
            let flies = step.record.as_ref().is_some_and(|record| record.flies);
            difference = if flies { OF_FLIGHT } else { OF_CONTACTS } * step.division.whole;
            let gap = part.ended.map_or(0.0, |row| step.division.end_of(row));
            ends.push((s.q_next.clone(), s.v_next.clone(), gap));
        }
        let [(q, v, gap), near, far] = &ends[..] else { return Ok((0.0, 0.0)) };
        let slope = |start: f64, near: f64, far: f64| (4.0 * (near - start) - (far - start)) / (2.0 * difference);
        let [to_near, to_far] = [near, far].map(|end| displacement(&s.model, q, &end.0));
        let by_q = (0..v.len()).map(|i| gradients.end[0][i] * slope(0.0, to_near[i], to_far[i]));
        let by_v = (0..v.len()).map(|i| gradients.end[1][i] * slope(v[i], near.1[i], far.1[i]));
        Ok((by_q.chain(by_v).sum(), slope(*gap, near.2, far.2)))
    }

    /// Propagates the gradients through the step, or the part, that was made and recorded.
    fn through_part(
        &mut self,
        (scene, settings): (&Scene, &StepSettings),
        of_gap: Option<(usize, f64)>,
        flight: &mut FlightAdjoint<'_>,
    ) -> Result<Vec<Mode>, (String, Error)> {
        let Self { scratch: s, gradients, step, adjoint, connections, contacts, sums, .. } = self;
        adjoint.step(scene, settings, (step, s), connections, gradients, of_gap)?;
        if let Some(free) = settings.free.as_ref().filter(|_| step.record.as_ref().is_some_and(|record| record.flies)) {
            flight(free, s, gradients)?;
        }
        for (contact, more) in contacts.iter().zip(&adjoint.contacts) {
            let sum = sums.entry(*contact).or_default();
            sum.friction += more.friction;
            sum.restitution += more.restitution;
            sum.offset += more.offset;
            sum.normal += more.normal;
        }
        Ok(now(scene, settings, s, step))
    }

    /// Writes the sums of the contacts that the scene names, [`ContactReverse::WIDTH`] values per contact.
    #[allow(clippy::cast_precision_loss)] // number of steps of a run
    pub fn write(&self, scene: &Scene, out: &mut [f64]) {
        let each = scene.contacts().iter().zip(out.chunks_exact_mut(Self::WIDTH));
        for (i, (contact, out)) in each.enumerate() {
            let id = ContactId::Named(i);
            let sum = self.sums.get(&id).copied().unwrap_or_default();
            let (margin, step) = self.modes.margins.get(&id).copied().unwrap_or((f64::INFINITY, 0));
            let (offset, normal) = by_plane(scene, contact, &sum);
            out[..3].copy_from_slice(&[sum.friction, sum.restitution, offset]);
            out[3..6].copy_from_slice(normal.as_slice());
            out[6..].copy_from_slice(&[margin, step as f64]);
        }
    }

    /// The sums of the pairs of shapes, for the index of the state.
    pub fn of_shapes(&self, state: usize) -> impl Iterator<Item = ShapeGradients> + '_ {
        self.sums.iter().filter_map(move |(contact, sum)| {
            let ContactId::Shapes(colliders) = *contact else { return None };
            let (margin, margin_step) = self.modes.margins.get(contact).copied().unwrap_or((f64::INFINITY, 0));
            let (friction, restitution) = (sum.friction, sum.restitution);
            Some(ShapeGradients { state, colliders, friction, restitution, margin, margin_step })
        })
    }
}

impl Parts for ContactReverse {
    fn parts(&mut self) -> (&mut Scratch<f64>, &mut StepGradients<f64>) {
        (&mut self.scratch, &mut self.gradients)
    }
}

/// The modes of contacts in the steps of a run, from the last one.
#[derive(Default)]
struct Modes {
    /// The smallest distance of each contact from another mode, m/s, and its step.
    margins: BTreeMap<ContactId, (f64, usize)>,
    /// The states of the contacts in the last recomputed step: several points of a pair of shapes in a fixed order, so
    /// that their number counts, not which is which.
    states: Option<BTreeMap<ContactId, Vec<ContactState>>>,
}

impl Modes {
    /// Adds the contacts of step `n`, which precedes those before. Calls `changed` with each change.
    fn add(
        &mut self,
        n: usize,
        now: impl Iterator<Item = (ContactId, Mode)>,
        mut changed: impl FnMut(ContactId, ContactState, ContactState),
    ) {
        let mut states: BTreeMap<ContactId, Vec<ContactState>> = BTreeMap::new();
        for (contact, (margin, state)) in now {
            let least = self.margins.entry(contact).or_insert((f64::INFINITY, 0));
            if margin < least.0 {
                *least = (margin, n);
            }
            states.entry(contact).or_default().push(state);
        }
        for of in states.values_mut() {
            of.sort_by(|a, b| b.number().total_cmp(&a.number()));
        }
        if let Some(later) = &self.states {
            let ids: BTreeSet<_> = states.keys().chain(later.keys()).collect();
            for &contact in ids {
                let [before, after] = [&states, later].map(|of| of.get(&contact).map_or(&[][..], |of| of));
                for i in 0..before.len().max(after.len()) {
                    let [before, after] = [before, after].map(|of| of.get(i).copied().unwrap_or(ContactState::Open));
                    if before != after {
                        changed(contact, before, after);
                    }
                }
            }
        }
        self.states = Some(states);
    }
}

/// Gradients by the offset of a plane and by its unit normal, tangent to the unit sphere, in the frame in which the
/// contact gives them; NaN for another surface.
fn by_plane(scene: &Scene, contact: &Contact, sum: &ContactGradient) -> (f64, Vector3<f64>) {
    if contact.surface != Surface::Plane {
        return (f64::NAN, Vector3::repeat(f64::NAN));
    }
    let link = contact.other.as_ref().and_then(|name| scene.link(name).ok());
    let frame = link.map_or(contact.other_frame, |link| link.placement.compose(&contact.other_frame));
    // The distance of the plane from the origin of the body is offset + n . lever.
    let by_normal = frame.rotate_back(&(sum.normal + frame.lever * sum.offset));
    let normal = contact.unit_normal();
    (sum.offset, by_normal - normal * normal.dot(&by_normal))
}

/// Distance of each contact from another mode, m/s, and its state, in the step that was recorded.
fn now(scene: &Scene, settings: &StepSettings, s: &Scratch<f64>, step: &mut ContactStep) -> Vec<Mode> {
    let ContactStep { rows, record, division, .. } = step;
    let points = scene.contact_points();
    let Some(record) = record else { return Vec::new() };
    if settings.smoothing.is_some() {
        // The relaxed law has no modes.
        return vec![(f64::INFINITY, ContactState::Open); points.len()];
    }
    let moving = rows.velocities(&s.model, points, &record.moving);
    let mut found: Vec<_> = (0..points.len())
        .map(|i| ((record.before.gaps[i] / settings.step + moving[3 * i + 2]).abs(), ContactState::Open))
        .collect();
    // A contact that ends a part is at its surface then.
    for &i in division.passing.iter().filter(|i| **i < points.len()) {
        found[i].0 = f64::INFINITY;
    }
    let Some(laws) = &record.laws else { return found };
    let mut margins = laws.cone.margins(&laws.held, &laws.c, &Limits::beside(&laws.c));
    let mut least = |more: Vec<f64>| margins.iter_mut().zip(more).for_each(|(least, more)| *least = least.min(more));
    if let Some(hit) = &record.hit {
        let (first, second) = &hit.phases;
        least(laws.cone.margins(first, &laws.middle, &Limits::beside(&laws.middle)));
        if let Some(second) = second {
            let between = &laws.middle + laws.cone.g.times(first);
            let bound = laws.rebound.iter().enumerate().map(|(k, e)| e * first[3 * k + 2]).collect();
            least(laws.cone.margins(second, &between, &Limits { least: bound, ..Limits::beside(&laws.middle) }));
        }
    }
    for (k, &i) in record.near.iter().enumerate().filter(|(_, i)| **i < points.len()) {
        found[i] = (margins[k], record.states[k]);
    }
    found
}

/// Returns an error if a recomputed step does not end at the recorded row.
pub(in crate::motion) fn check_reproduced(
    n: usize,
    recorded: (&[f64], &[f64]),
    made: (&[f64], &[f64]),
) -> Result<(), Error> {
    for (name, recorded, made) in [("q", recorded.0, made.0), ("qd", recorded.1, made.1)] {
        let size = recorded.iter().fold(1.0_f64, |most, x| most.max(x.abs()));
        let off = recorded.iter().zip(made).fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()));
        if !(off <= REPRODUCED * size) {
            let found =
                format!("a row after step {} that the step recomputed from the row before misses by {off:.1e}", n + 1);
            let expected = in_language(
                "rows of Rollout::advance with the same settings, at best with every = 1",
                "rows of simulate with the same arguments, at best with record_every=1",
            );
            return Err(Error::argument(name, found, expected));
        }
    }
    Ok(())
}
