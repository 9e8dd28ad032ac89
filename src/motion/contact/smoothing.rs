//! Steps with the relaxed contact law (`smoothing`): every contact acts at every distance, so that gradients exist
//! before contact and through changes from sticking to sliding.
//!
//! For the length s, contact i has the reference force F, its equal share of the weight of its tree. In a step of h,
//! with the gap at the start, the velocities u at the end, the force f = p/h and g the acceleration of gravity:
//!
//! ```text
//! f_n (gap + h u_n) = s F,     u_t = -sqrt(g s) F mu f_t / ((mu f_n)^2 - |f_t|^2)
//! ```
//!
//! A contact at rest that carries F has the gap s. The first equation is the implicit step of the potential energy
//! -s F log(gap), so that the sum of all energies does not increase. [`crate::contact`] solves both as its relaxed law.

use super::super::limit_rows::limit_rows;
use super::super::scratch::Scratch;
use super::super::step_settings::StepSettings;
use super::closed::positions_onto_connections;
use super::faults::{check, check_movable, factorised};
use super::pairs::from_fixed_axes;
use super::record::Laws;
use super::record::{Outcome, StepStart};
use super::report::ContactReport;
use super::step::ContactStep;
use crate::contact::{Cones, ContactState, Limits, Relaxation};
use crate::error::{Error, in_language};
use crate::model::Model;
use crate::motion::properties::joint_of_row;
use crate::scene::Scene;
use crate::scene::contact_point::ContactPoint;
use nalgebra::{DVector, Vector3};

/// Acceleration of gravity of scenes without gravity, m/s^2.
const STANDARD: f64 = 9.806_65;

/// A contact with less than this fraction of its reference force is reported as open, and one whose friction exceeds
/// this fraction of its bound as sliding.
const OPENS: f64 = 0.1;
const SLIDES: f64 = 0.9;

/// Relaxation of the contact law by a length.
#[derive(Debug, Clone)]
pub(in crate::motion) struct Smoothing {
    /// The length s, m, and the speed sqrt(g s), m/s.
    pub length: f64,
    speed: f64,
    shares: Vec<Share>,
}

/// The reference force of a contact.
#[derive(Debug, Clone)]
struct Share {
    /// F, N.
    force: f64,
    /// The bodies of the tree, and the derivative of F by their masses.
    bodies: Vec<usize>,
    by_mass: f64,
}

impl Smoothing {
    /// Checks the length and the scene; `None` for the exact law.
    pub fn new(scene: &Scene, length: f64, stops: bool) -> Result<Option<Self>, Error> {
        let refuse = |found: String, expected: &str| Err(Error::argument("smoothing", found, expected));
        if !(length.is_finite() && length >= 0.0) {
            return refuse(format!("{length}"), "a length in m, zero or positive");
        }
        if length == 0.0 {
            return Ok(None);
        }
        let points = scene.contact_points();
        if points.is_empty() {
            return refuse(format!("{length} for a scene without contacts"), "0");
        }
        if let Some(point) = points.iter().find(|point| point.restitution > 0.0) {
            let found = format!("{length} with contact {:?} of restitution {}", point.name, point.restitution);
            return refuse(found, "0, because smoothed contacts do not rebound");
        }
        if let Some(limit) = limit_rows(scene).first().filter(|_| stops) {
            let joint = joint_of_row(scene, limit.row);
            let expected = in_language("Limits::Report, or smoothing 0", "limits=\"report\", or smoothing=0");
            return refuse(format!("{length} with stops at joint {joint:?}"), expected);
        }
        let model = scene.model();
        let gravity = model.gravity.norm();
        let gravity = if gravity > 0.0 { gravity } else { STANDARD };
        let root = roots(model);
        let of = |body: usize| {
            let bodies: Vec<usize> = (0..root.len()).filter(|&k| root[k] == root[body]).collect();
            let on = |point: &&ContactPoint| {
                let other = point.other_body();
                root[point.body] == root[body] || other.is_some_and(|k| root[k] == root[body])
            };
            #[allow(clippy::cast_precision_loss)] // a number of contacts
            let by_mass = gravity / points.iter().filter(on).count() as f64;
            let force = by_mass * bodies.iter().map(|&k| model.bodies[k].inertia.mass).sum::<f64>();
            Share { force, bodies, by_mass }
        };
        let mut shares = Vec::with_capacity(points.len());
        for point in points {
            let mut share = of(point.body);
            if let Some(other) = point.other_body().map(of)
                && other.force < share.force
            {
                share = other;
            }
            if !(share.force > 0.0) {
                return refuse(format!("{length} with contact {:?} on a tree without mass", point.name), "0");
            }
            shares.push(share);
        }
        Ok(Some(Self { length, speed: (gravity * length).sqrt(), shares }))
    }

    /// The energies of the relaxed law in a step of `h`.
    fn energies(&self, h: f64) -> Vec<Relaxation> {
        let of =
            |share: &Share| Relaxation { normal: self.length * share.force, tangent: self.speed * h * share.force };
        self.shares.iter().map(of).collect()
    }

    /// The velocity that a contact adds to its normal velocity in the law, m/s, and its derivative by the gap. For a
    /// penetration it is at most sqrt(g s), so that a deep one does not cause a fast motion.
    fn target(&self, gap: f64, h: f64) -> [f64; 2] {
        let velocity = gap / h;
        if gap >= 0.0 {
            return [velocity, 1.0 / h];
        }
        let part = (velocity / self.speed).tanh();
        [self.speed * part, (1.0 - part * part) / h]
    }

    /// The derivative of the target of contact `i` by its gap.
    pub fn by_gap(&self, gap: f64, h: f64) -> f64 {
        self.target(gap, h)[1]
    }

    /// Adds the gradients by the masses of bodies, for the cotangents of relative changes of the energies.
    pub fn add_masses(&self, of_energy: &[f64], parameters: &mut [[f64; 10]]) {
        for (share, bar) in self.shares.iter().zip(of_energy) {
            for &k in &share.bodies {
                if let Some(of) = parameters.get_mut(k) {
                    of[0] += bar * share.by_mass / share.force;
                }
            }
        }
    }

    /// The state that is reported for a contact.
    fn state(&self, i: usize, friction: f64, p: &Vector3<f64>, h: f64) -> ContactState {
        let drag = p[0].hypot(p[1]);
        if p[2] < OPENS * self.shares[i].force * h {
            ContactState::Open
        } else if friction > 0.0 && drag <= SLIDES * friction * p[2] {
            ContactState::Sticking
        } else {
            ContactState::Sliding
        }
    }
}

/// The outermost ancestor of each body.
fn roots(model: &Model<f64>) -> Vec<usize> {
    let mut roots: Vec<usize> = Vec::with_capacity(model.bodies.len());
    for (k, stage) in model.system.stages.iter().enumerate() {
        roots.push(stage.parent.map_or(k, |parent| roots[parent]));
    }
    roots
}

impl ContactStep {
    /// Applies the relaxed forces of all contacts to `v_next`.
    pub(super) fn touch_smoothed(
        &mut self,
        (scene, settings, smoothing): (&Scene, &StepSettings, &Smoothing),
        s: &mut Scratch<f64>,
        before: &StepStart,
        kept: &[f64],
    ) -> Result<Outcome, (String, Error)> {
        let Self { solver, rows, record, .. } = self;
        let (workspace, points, h) = (&mut solver.workspace, scene.contact_points(), settings.step);
        let mut near: Vec<usize> = (0..points.len()).collect();
        // With connections, the projection of the velocities has left the factor.
        if rows.closed.is_none() {
            factorised(scene, (&s.model, &s.q), workspace)?;
        }
        let blocks = rows.gram(&s.model, points, workspace, &mut near);
        let friction: Vec<f64> = points.iter().map(|point| point.friction).collect();
        let cone = Cones::new(blocks, &friction).whole();
        check_movable((scene, &[]), &near, &cone.lengths)?;
        let mut c = before.free.clone();
        for (i, &gap) in before.gaps.iter().enumerate() {
            c[3 * i + 2] += smoothing.target(gap, h)[0];
        }
        let warm = from_fixed_axes(points, &before.axes, kept);
        let energies = smoothing.energies(h);
        let limits = Limits { scale: Limits::beside(&before.free).scale, ..Limits::beside(&c) };
        let (held, solved) = cone.relaxed(&c, Some(&warm), &energies, limits.scale);
        rows.respond(&s.model, workspace, &held);
        for (v, response) in s.v_next.iter_mut().zip(&rows.response) {
            *v += response;
        }
        let after = rows.velocities(&s.model, points, &s.v_next);
        check((scene, &[]), &near, &solved)?;
        let (mut normal, mut tangent, mut creep) = (0.0, 0.0, 0.0_f64);
        let mut states = Vec::with_capacity(points.len());
        for (i, point) in points.iter().enumerate() {
            let [p, start, after] = [&held, &before.start, &after].map(|rows| rows.fixed_rows::<3>(3 * i));
            tangent -= 0.5 * p.xy().dot(&(start.xy() + after.xy()));
            normal -= 0.5 * p[2] * (start[2] + after[2]);
            let state = smoothing.state(i, point.friction, &p.into(), h);
            if state == ContactState::Sticking {
                creep = creep.max(after.xy().norm());
            }
            states.push(state);
        }
        let mut outcome = Outcome::default();
        #[allow(clippy::cast_precision_loss)] // a small count
        let iterations = solved.iterations as f64;
        outcome.report = ContactReport {
            residual: solved.residual,
            converged: solved.converged,
            iterations,
            lost_in_impacts: normal,
            lost_in_friction: tangent,
            bias: cone.residual(&held, &c, &limits),
            creep,
            ..ContactReport::default()
        };
        outcome.states = states;
        outcome.laws =
            record.is_some().then(|| Laws::new(cone.clone(), &[], (DVector::zeros(0), 0.5), (&c, &held), &[]));
        outcome.laws.iter_mut().for_each(|laws| laws.energies = Some(energies.clone()));
        (outcome.near, outcome.held) = (near, held);
        Ok(outcome)
    }

    /// Ends a step at `q_next`: the connections hold. Returns the largest penetration, and the largest gap of a contact
    /// whose force is at least its reference force, m.
    pub(super) fn end_smoothed(
        &mut self,
        (scene, settings, smoothing): (&Scene, &StepSettings, &Smoothing),
        s: &mut Scratch<f64>,
        held: &DVector<f64>,
    ) -> Result<(f64, f64), (String, Error)> {
        let Self { solver, rows, record, .. } = self;
        let moves = record.as_mut().map(|record| &mut record.moves);
        positions_onto_connections(scene, (&s.model, &mut solver.workspace), rows, &mut s.q_next, moves)?;
        rows.place(&s.model, scene.contact_points(), &s.q_next);
        let depth = -rows.gaps.iter().fold(0.0_f64, |lowest, &gap| lowest.min(gap));
        let carries = |i: &usize| held[3 * i + 2] >= smoothing.shares[*i].force * settings.step;
        let loaded = (0..rows.gaps.len()).filter(carries);
        Ok((depth, loaded.map(|i| rows.gaps[i]).fold(0.0, f64::max)))
    }
}
