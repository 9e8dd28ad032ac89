//! Traces of the sweeps of each function on a scalar that records its operations.

use crate::dynamics::derivatives::{
    Changes, CoStates, Constants, DerivativeColumns, Directions, Kept, Matrices, Product, gradients_in_sweeps,
    in_sweeps, tangent_in_sweeps,
};
use crate::dynamics::forces::Motion;
use crate::dynamics::traced::TracedSweeps;
use crate::kinematics::{self, Frame, ReferenceFrame};
use crate::model::Model;
use crate::scalar::{Real, Traced};
use crate::scene::Scene;
use crate::spatial::RigidShift;

/// The frame of a function of one link, and the frame in which its motion is expressed.
pub(super) type Place = (Frame<f64>, ReferenceFrame);

/// The arguments of the sweeps, and their scratch.
pub(super) struct Tracer<'a> {
    scene: &'a Scene,
    place: Place,
    traced: TracedSweeps,
}

/// Writes the results, one after another, from the arguments.
pub(super) type Trace = fn(&mut Tracer<'_>, &[Vec<Traced>], &mut [Traced]);

impl<'a> Tracer<'a> {
    pub fn new(scene: &'a Scene, model: &Model<f64>, place: Place, tolerance: Option<f64>) -> Self {
        Self { scene, place, traced: TracedSweeps::accepting(model, tolerance) }
    }
}

pub(super) fn forward_dynamics(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    tracer.traced.forward_dynamics((&given[0], &given[1], &given[2]), &[], out);
}

pub(super) fn forward_dynamics_watched(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    let (qdd, margin) = out.split_at_mut(tracer.traced.model.nv());
    margin[0] = tracer.traced.forward_dynamics_and_margin((&given[0], &given[1], &given[2]), qdd);
}

pub(super) fn mass_matrix_inverse_watched(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    let (inverse, margin) = out.split_at_mut(tracer.traced.model.nv().pow(2));
    factor_watched(tracer, given, margin);
    tracer.traced.multiplied_out(inverse);
}

pub(super) fn factor_watched(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    let mut estimates = vec![Traced::from_f64(f64::NAN); tracer.traced.model.nv()];
    out[0] = tracer.traced.factor_with_estimate(&given[0], &mut estimates).margin();
}

pub(super) fn inverse_dynamics(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    let qdd = given.get(2).map(|qdd| &qdd[..]);
    tracer.traced.inverse_dynamics((&given[0], &given[1], qdd), &[], out);
}

pub(super) fn mass_matrix(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    tracer.traced.mass_matrix(&given[0], out);
}

pub(super) fn mass_matrix_inverse(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    tracer.traced.factor(&given[0]);
    tracer.traced.multiplied_out(out);
}

pub(super) fn forward_dynamics_derivatives(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    let qdd = accelerations(tracer, given);
    derivatives_of_torques(tracer, (&given[0], &given[1], &qdd), out);
    let inverse = 2 * out.len() / 3;
    tracer.traced.multiplied_out(&mut out[inverse..]);
    let like = (Traced::from_f64(0.0), Traced::from_f64(0.0));
    Product::new().in_place((&tracer.traced.model, &tracer.traced.sweeps), like, out);
}

pub(super) fn inverse_dynamics_derivatives(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    derivatives_of_torques(tracer, (&given[0], &given[1], &given[2]), out);
}

/// The accelerations of a state; leaves the factor of M in the scratch.
fn accelerations(tracer: &mut Tracer<'_>, given: &[Vec<Traced>]) -> Vec<Traced> {
    let mut qdd = vec![Traced::from_f64(f64::NAN); tracer.traced.model.nv()];
    forward_dynamics(tracer, given, &mut qdd);
    qdd
}

/// dtau/dq, dtau/dqd and M.
fn derivatives_of_torques(
    tracer: &mut Tracer<'_>,
    (q, qd, qdd): (&[Traced], &[Traced], &[Traced]),
    out: &mut [Traced],
) {
    let TracedSweeps { model, sweeps, scratch } = &mut tracer.traced;
    let mut columns: DerivativeColumns<Traced, Traced> = DerivativeColumns::new();
    columns.prepare(model, sweeps);
    let mut kept = Kept::new(sweeps, model.nv());
    let state = Motion { q, qd, qdd: Some(qdd), wrenches: &[] };
    in_sweeps((model, sweeps), (scratch, &mut kept, &mut columns), state, Matrices::Derivatives, out);
}

pub(super) fn forward_dynamics_jvp(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    let qdd = accelerations(tracer, given);
    tangent(tracer, given, (&qdd, true), out);
}

pub(super) fn inverse_dynamics_jvp(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    tangent(tracer, given, (&given[2], false), out);
}

/// The change along a direction: of torques, or with `solves` of accelerations, with the factor in the scratch.
fn tangent(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], (qdd, solves): (&[Traced], bool), out: &mut [Traced]) {
    let TracedSweeps { model, sweeps, scratch } = &mut tracer.traced;
    let motion = Motion { q: &given[0], qd: &given[1], qdd: Some(qdd), wrenches: &[] };
    let along = Directions { q: &given[3], qd: &given[4], u: &given[5], ..Directions::default() };
    let (mut changes, mut right) = (Changes::new(sweeps), vec![Traced::from_f64(f64::NAN); model.nv()]);
    let scratch = (scratch, &mut changes);
    tangent_in_sweeps::<Traced, Traced>((model, sweeps), scratch, (motion, along), (solves, false), (&mut right, out));
}

pub(super) fn forward_dynamics_vjp(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    let qdd = accelerations(tracer, given);
    gradients(tracer, given, (&qdd, true), out);
}

pub(super) fn inverse_dynamics_vjp(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    gradients(tracer, given, (&given[2], false), out);
}

/// The gradients of torques, or with `solves` of accelerations.
fn gradients(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], (qdd, solves): (&[Traced], bool), out: &mut [Traced]) {
    let TracedSweeps { model, sweeps, scratch } = &mut tracer.traced;
    let motion = Motion { q: &given[0], qd: &given[1], qdd: Some(qdd), wrenches: &[] };
    let (mut co_states, mut x) = (CoStates::new(sweeps), vec![Traced::from_f64(f64::NAN); model.nv()]);
    let results = (&mut Constants::default(), &mut x[..], out);
    let scratch = (scratch, &mut co_states);
    // Generated code does not check the precision.
    let _ = gradients_in_sweeps::<Traced, Traced>((model, sweeps), scratch, (motion, &given[3]), solves, results);
}

pub(super) fn placements(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    let Tracer { scene, traced: TracedSweeps { model, .. }, .. } = tracer;
    let bodies = model.bodies.len();
    let mut of_bodies = vec![RigidShift::identity(); bodies];
    kinematics::placements_on_the_way(model, &given[0], &mut vec![true; bodies], &mut of_bodies);
    for (link, out) in scene.links().iter().zip(out.chunks_exact_mut(16)) {
        let on_body = link.placement.cast();
        link.body.map_or(on_body, |body| of_bodies[body].compose(&on_body)).homogeneous(out);
    }
}

pub(super) fn placement(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    let Tracer { traced: TracedSweeps { model, .. }, place: (frame, _), .. } = tracer;
    kinematics::placement(model, &given[0], &frame.cast()).homogeneous(out);
}

pub(super) fn jacobian(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    let Tracer { traced: TracedSweeps { model, .. }, place: (frame, reference), .. } = tracer;
    kinematics::jacobian(model, &given[0], &frame.cast(), *reference, out);
}
