//! Traces of the sweeps of each function on a scalar that records its operations.

use crate::dynamics::constraints::ConstraintKernel;
use crate::dynamics::contact_kernel::ContactKernel;
use crate::dynamics::derivatives::{
    Changes, CoStates, Constants, DerivativeColumns, Directions, Kept, Matrices, Product, gradients_in_sweeps,
    in_sweeps, tangent_in_sweeps,
};
use crate::dynamics::fixed_rows;
use crate::dynamics::forces::Motion;
use crate::dynamics::sweeps::place;
use crate::dynamics::traced::TracedSweeps;
use crate::kinematics::{self, Frame, ReferenceFrame};
use crate::model::Model;
use crate::scalar::{Real, Traced};
use crate::scene::Scene;
use crate::spatial::RigidShift;
use num_traits::Zero;

/// The frame of a function of one link, and the frame in which its motion is expressed.
pub(super) type Place = (Frame<f64>, ReferenceFrame);

/// The arguments of the sweeps, and their scratch. For a scene with mimic joints, they are those of its tree.
pub(super) struct Tracer<'a> {
    scene: &'a Scene,
    place: Place,
    pub traced: TracedSweeps,
    /// False if the tolerance is infinite.
    is_estimated: bool,
    /// The rows of the connections or of mimic joints, for functions that are computed through them.
    rows: Option<ConstraintKernel<Traced>>,
}

/// Writes the results, one after another, from the arguments.
pub(super) type Trace = fn(&mut Tracer<'_>, &[Vec<Traced>], &mut [Traced]);

impl<'a> Tracer<'a> {
    pub fn new(scene: &'a Scene, model: &Model<f64>, place: Place, tolerance: Option<f64>) -> Self {
        let traced = TracedSweeps::accepting(model, tolerance);
        Self { scene, place, traced, is_estimated: tolerance.is_none_or(f64::is_finite), rows: None }
    }

    /// With the connections of the scene.
    pub fn with_rows(mut self) -> Self {
        let TracedSweeps { model, sweeps, .. } = &self.traced;
        self.rows = Some(ConstraintKernel::new((model, sweeps), self.scene.constraints()));
        self
    }
}

pub(super) fn forward_dynamics(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    let (qdd, margin) = out.split_at_mut(tracer.traced.model.nv());
    if tracer.rows.is_some() {
        // Without a margin in the results, it is dead code.
        margin.fill(through_connections(tracer, given, qdd));
        return;
    }
    let state = (&given[0][..], &given[1][..], &given[2][..]);
    match margin {
        [margin] => *margin = tracer.traced.forward_dynamics_and_margin(state, qdd),
        _ => tracer.traced.forward_dynamics(state, &[], qdd),
    }
}

/// Joint accelerations, with the connections in the tracer. Returns the margin.
fn through_connections(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], qdd: &mut [Traced]) -> Traced {
    let Tracer { traced: TracedSweeps { model, sweeps, scratch }, rows: Some(rows), is_estimated, .. } = tracer else {
        return Traced::from_f64(f64::NAN);
    };
    if let Some(compliance) = given.get(3) {
        rows.compliance.copy_from_slice(compliance);
    }
    let state = (&given[0][..], &given[1][..], &given[2][..]);
    fixed_rows::forward_dynamics((model, sweeps), (scratch, rows), state, *is_estimated, qdd)
}

/// The factors of M and of the rows of mimic joints in the tracer. Returns the margin.
pub(super) fn factor_of_mimic_joints(tracer: &mut Tracer<'_>, state: (&[Traced], &[Traced])) -> Traced {
    let Tracer { traced: TracedSweeps { model, sweeps, scratch }, rows: Some(rows), .. } = tracer else {
        return Traced::from_f64(f64::NAN);
    };
    fixed_rows::factor((model, sweeps), (scratch, rows), state)
}

/// The accelerations of mimic joints from torques, with these factors; with the bias of a state or without.
pub(super) fn solve_mimic_joints(
    tracer: &mut Tracer<'_>,
    biased: Option<(&[Traced], &[Traced])>,
    (tau, qdd): (&[Traced], &mut [Traced]),
) {
    if let Tracer { traced: TracedSweeps { model, sweeps, scratch }, rows: Some(rows), .. } = tracer {
        fixed_rows::solve((model, sweeps), (scratch, rows), biased, (tau, qdd));
    }
}

pub(super) fn constrained_dynamics(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    let (qdd, rest) = out.split_at_mut(tracer.traced.model.nv());
    let found = through_connections(tracer, given, qdd);
    let Some(ConstraintKernel { forces_of_rows, rank, residual, .. }) = &tracer.rows else { return };
    let (forces, rest) = rest.split_at_mut(forces_of_rows.len());
    forces.copy_from_slice(forces_of_rows);
    let (others, margin) = rest.split_at_mut(2);
    others.copy_from_slice(&[*rank, *residual]);
    margin.fill(found);
}

pub(super) fn factor(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
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
    let (inverse, margin) = out.split_at_mut(tracer.traced.model.nv().pow(2));
    if margin.is_empty() {
        tracer.traced.factor(&given[0]);
    } else {
        factor(tracer, given, margin);
    }
    tracer.traced.multiplied_out(inverse);
}

pub(super) fn forward_dynamics_derivatives(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    let (out, margin) = out.split_at_mut(3 * tracer.traced.model.nv().pow(2));
    let (qdd, of_factor) = accelerations(tracer, given, !margin.is_empty());
    let of_product = derivatives_of_accelerations(tracer, given, &qdd, out);
    with_factor(margin, of_product, of_factor);
}

/// Sets the margin, if there is one in the results, to the smaller of two.
fn with_factor(margin: &mut [Traced], own: Traced, of_factor: Option<Traced>) {
    if let ([margin], Some(of_factor)) = (margin, of_factor) {
        *margin = own.worst(of_factor);
    }
}

/// dqdd/dq, dqdd/dqd and M^-1, with the factor in the scratch. Returns the margin of the product with M^-1.
fn derivatives_of_accelerations(
    tracer: &mut Tracer<'_>,
    given: &[Vec<Traced>],
    qdd: &[Traced],
    out: &mut [Traced],
) -> Traced {
    derivatives_of_torques(tracer, (&given[0], &given[1], qdd), out);
    let inverse = 2 * out.len() / 3;
    tracer.traced.multiplied_out(&mut out[inverse..]);
    let TracedSweeps { model, sweeps, scratch } = &tracer.traced;
    Product::new(false).in_place((model, sweeps), (Traced::from_f64(0.0), scratch.accepted_of_products), out)
}

pub(super) fn inverse_dynamics_derivatives(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    derivatives_of_torques(tracer, (&given[0], &given[1], &given[2]), out);
}

/// The accelerations of a state, which leave the factor of M in the scratch; with an error estimate, the margin
/// of the factor too, whose test vector estimates the errors of solutions.
fn accelerations(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], are_watched: bool) -> (Vec<Traced>, Option<Traced>) {
    let mut qdd = vec![Traced::from_f64(f64::NAN); tracer.traced.model.nv()];
    if !are_watched {
        forward_dynamics(tracer, given, &mut qdd);
        return (qdd, None);
    }
    let margin = tracer.traced.factor_with_estimate(&given[0], &mut qdd).margin();
    tracer.traced.innovations_of_factor((&given[0], &given[1], &given[2]), &[], &mut qdd);
    tracer.traced.smooth(&mut qdd);
    (qdd, Some(margin))
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
    let (out, margin) = out.split_at_mut(tracer.traced.model.nv());
    let (qdd, of_factor) = accelerations(tracer, given, !margin.is_empty());
    let excess = tangent(tracer, given, &qdd, (true, !margin.is_empty()), out);
    with_factor(margin, -excess, of_factor);
}

pub(super) fn inverse_dynamics_jvp(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    tangent(tracer, given, &given[2], (false, false), out);
}

/// The change along a direction: of torques, or with `solves` of accelerations, with the factor in the scratch. Returns
/// a positive value if a solution is `judged` and its estimated error exceeds the tolerance.
fn tangent(
    tracer: &mut Tracer<'_>,
    given: &[Vec<Traced>],
    qdd: &[Traced],
    solves_and_judged: (bool, bool),
    out: &mut [Traced],
) -> Traced {
    let TracedSweeps { model, sweeps, scratch } = &mut tracer.traced;
    let motion = Motion { q: &given[0], qd: &given[1], qdd: Some(qdd), wrenches: &[] };
    let along = Directions { q: &given[3], qd: &given[4], u: &given[5], ..Directions::default() };
    let (mut changes, mut right) = (Changes::new(sweeps), vec![Traced::from_f64(f64::NAN); model.nv()]);
    let (scene, scratch) = ((&*model, &*sweeps), (scratch, &mut changes));
    tangent_in_sweeps::<Traced, Traced>(scene, scratch, (motion, along), solves_and_judged, (&mut right, out))
}

pub(super) fn forward_dynamics_vjp(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    let (out, margin) = out.split_at_mut(3 * tracer.traced.model.nv());
    let (qdd, of_factor) = accelerations(tracer, given, !margin.is_empty());
    let excess = gradients(tracer, given, (&qdd, true), out);
    with_factor(margin, -excess, of_factor);
}

pub(super) fn inverse_dynamics_vjp(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    gradients(tracer, given, (&given[2], false), out);
}

/// The gradients of torques, or with `solves` of accelerations. Returns a positive value if precision is lost.
fn gradients(
    tracer: &mut Tracer<'_>,
    given: &[Vec<Traced>],
    (qdd, solves): (&[Traced], bool),
    out: &mut [Traced],
) -> Traced {
    let TracedSweeps { model, sweeps, scratch } = &mut tracer.traced;
    let motion = Motion { q: &given[0], qd: &given[1], qdd: Some(qdd), wrenches: &[] };
    let (mut co_states, mut x) = (CoStates::new(sweeps), vec![Traced::from_f64(f64::NAN); model.nv()]);
    let results = (&mut Constants::default(), &mut x[..], out);
    let scratch = (scratch, &mut co_states);
    gradients_in_sweeps::<Traced, Traced>((model, sweeps), scratch, (motion, &given[3]), solves, results)
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

pub(super) fn contact_gaps(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    out.copy_from_slice(&contacts_at(tracer, &given[0]).gaps);
}

pub(super) fn contact_velocities(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    let mut contacts = contacts_at(tracer, &given[0]);
    let TracedSweeps { model, sweeps, scratch } = &tracer.traced;
    contacts.velocities((model, sweeps), scratch, &given[1], out);
}

pub(super) fn contact_gram(tracer: &mut Tracer<'_>, given: &[Vec<Traced>], out: &mut [Traced]) {
    tracer.traced.factor(&given[0]);
    let TracedSweeps { model, sweeps, scratch } = &tracer.traced;
    let points = tracer.scene.tree().contact_points();
    ContactKernel::new((model, sweeps), points).along_base_axes().gram_at((model, sweeps), scratch, out);
}

/// The contacts at `q`, with rows along the axes of the base frame.
fn contacts_at(tracer: &mut Tracer<'_>, q: &[Traced]) -> ContactKernel<Traced> {
    let TracedSweeps { model, sweeps, scratch } = &mut tracer.traced;
    place::<Traced, Traced>(sweeps, scratch, Traced::zero(), q);
    let mut contacts = ContactKernel::new((model, sweeps), tracer.scene.tree().contact_points()).along_base_axes();
    contacts.place((model, sweeps), scratch);
    contacts
}
