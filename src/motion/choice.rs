//! Decisions at the start of a rollout: the settings of its steps, the method that `Method::Auto` selects, and the rows
//! with exact friction or stops.

use super::method::Method;
use super::properties::{FRICTION_SPEED, Gains, Properties};
use super::settings::Settings;
use super::step_settings::StepSettings;
use super::stops::SetValued;
use crate::dynamics::{factorise, solve};
use crate::error::Error;
use crate::filter::Form;
use crate::scene::{Coupling, Scene};
use crate::workspace::Workspace;
use std::collections::HashMap;
use std::sync::Arc;

/// The settings of the steps of a scene, with its contacts or as without them, from the configurations `q`.
pub(super) fn step_settings(
    scene: &Scene,
    given: &Arc<Settings>,
    (mut properties, gains, coupling): (Properties, Option<Gains>, Option<Arc<Coupling>>),
    (q, touches): (&[f64], bool),
) -> StepSettings {
    let Settings { dt, method, accuracy, .. } = **given;
    let is_tree = scene.constraints().is_empty() && !touches;
    if touches && properties.friction_speed == 0.0 {
        properties.friction_speed = FRICTION_SPEED;
    }
    let chosen = match method {
        _ if touches => Method::Contact,
        // With error control the accuracy determines the step, and explicit methods are stable for longer steps.
        Method::Auto if accuracy.is_some() => match choose(scene, CONTROLLED, &properties, gains.as_ref(), q) {
            Method::RungeKutta4 => Method::DormandPrince5,
            _ => Method::Rosenbrock3,
        },
        Method::Auto => choose(scene, dt, &properties, gains.as_ref(), q),
        method => method,
    };
    if let Some(coupling) = &coupling {
        coupling.give_armature(&mut properties.armature);
    }
    let mut of = StepSettings::new(scene.model(), Arc::clone(given), chosen, (properties, gains));
    of.coupling = coupling;
    of.divides = method == Method::Auto && !touches;
    if let Some(gains) = &of.gains {
        (of.limits_sum, of.has_motors) = (gains.limits_sum, !gains.stall.is_empty());
        of.limited = (0..scene.nv()).filter(|&row| gains.is_limited(scene.nv(), row)).collect();
    }
    of.set_valued = set_valued(scene, &of, of.stops() && is_tree);
    of.connected = !scene.constraints().is_empty();
    of
}

/// The settings of a state with its own properties, by the method of the settings of all.
pub(super) fn settings_of_state(scene: &Scene, all: &StepSettings, mut properties: Properties) -> StepSettings {
    let free = all.free.as_ref().map(|free| Box::new(settings_of_state(scene, free, properties.clone())));
    let touches = all.method == Method::Contact;
    if touches && properties.friction_speed == 0.0 {
        properties.friction_speed = FRICTION_SPEED;
    }
    if let Some(coupling) = &all.coupling {
        coupling.give_armature(&mut properties.armature);
    }
    let mut of = all.clone();
    of.free = free;
    of.adopt_properties(scene.model(), properties);
    let is_tree = scene.constraints().is_empty() && !touches;
    of.set_valued = set_valued(scene, &of, of.stops() && is_tree);
    of
}

/// For a scene with connections: the rows with exact friction, stops or limits of effort.
pub(super) fn closed_rows(scene: &Scene, settings: &StepSettings) -> Vec<SetValued> {
    set_valued(scene, settings, settings.stops())
}

/// The rows with exact friction, stops or limits of effort. For coupled joints, friction and stops are those of the
/// independent rows, with the friction and limits of the joints that follow them.
fn set_valued(scene: &Scene, settings: &StepSettings, stops: bool) -> Vec<SetValued> {
    let StepSettings { properties, limited, .. } = settings;
    let exact = properties.friction_speed == 0.0;
    let reduced = settings.coupling.as_ref().map(|coupling| {
        let friction = coupling.torques(&coupling.reduce_friction(&properties.friction));
        let limits: HashMap<usize, _> =
            coupling.independent_coordinates_at().iter().copied().zip(coupling.limits()).collect();
        (friction, limits)
    });
    let mut rows = Vec::new();
    for joint in scene.joints() {
        let own = (joint.limits.lower, joint.limits.upper);
        let (friction, limits) = match &reduced {
            None => (&properties.friction, Some(own)),
            // A joint that follows another has neither.
            Some((friction, limits)) => (friction, limits.get(&joint.q.start).copied()),
        };
        let bounds = limits.filter(|(lower, upper)| {
            let one = joint.v.len() == 1 && joint.q.len() == 1;
            stops && one && (lower.is_finite() || upper.is_finite())
        });
        let (lower, upper) = bounds.unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
        for row in joint.v.clone() {
            let curve = properties.curves.get(row).filter(|curve| !curve.is_flat());
            let friction = if exact { curve.map_or(friction[row], |curve| curve.size(friction[row])) } else { 0.0 };
            let drives = limited.contains(&row);
            if friction > 0.0 || bounds.is_some() || drives {
                let (coordinate, friction) = (joint.q.start, [friction; 2]);
                rows.push(SetValued { row, coordinate, friction, stops: bounds.is_some(), lower, upper, drives });
            }
        }
    }
    rows
}

/// [`Method::Auto`] is explicit if the largest rate of springs and damping times the step is below this value. The
/// stability bound is 2.8; the margin allows for inertias that change with q.
const SLOW: f64 = 0.5;

/// The explicit method is tested with this step, s, under error control: a tenth of the steps it takes for motion of a
/// few rad/s.
const CONTROLLED: f64 = 1e-3;

/// The method that [`Method::Auto`] selects: the explicit method of order 4 if springs, damping and gains are slow for
/// this step, by the bounds sum d (M^-1)_jj and sum k (M^-1)_jj at the first state, and friction is exact.
fn choose(scene: &Scene, dt: f64, properties: &Properties, gains: Option<&Gains>, q: &[f64]) -> Method {
    let (nq, nv) = (scene.nq(), scene.nv());
    let with = |own: &[f64], which: usize| -> Vec<f64> {
        let gain = |row: usize| gains.map_or(0.0, |gains| gains.largest(nv, row)[which]);
        own.iter().enumerate().map(|(row, x)| x + gain(row)).collect()
    };
    let (damping, stiffness) = (with(&properties.damping, 1), with(&properties.stiffness, 0));
    if properties.is_regularized() {
        return Method::Rosenbrock2;
    }
    if damping.iter().chain(&stiffness).all(|&x| x == 0.0) {
        return Method::RungeKutta4;
    }
    // (M^-1)_jj is at most 1 / (inertia of joint j with all other joints free), which one solve per joint with the
    // factor computes.
    let Some(q) = q.get(..nq) else { return Method::Rosenbrock2 };
    let mut model = scene.model().clone();
    model.system.noise.clone_from(&properties.armature);
    let mut workspace = Workspace::new(&model).in_form(Form::Auto);
    let pivots = factorise(&model, &mut workspace, q);
    if workspace.lost_pivot(&model, &pivots).is_some() {
        return Method::Rosenbrock2;
    }
    let (mut unit, mut column) = (vec![0.0; nv], vec![0.0; nv]);
    let (mut fast, mut square) = (0.0, 0.0);
    for row in (0..nv).filter(|&row| damping[row] > 0.0 || stiffness[row] > 0.0) {
        unit[row] = 1.0;
        solve(&model, &mut workspace, &unit, &mut column);
        unit[row] = 0.0;
        fast += damping[row] * column[row];
        square += stiffness[row] * column[row];
    }
    let slow = dt * fast <= SLOW && dt * dt * square <= SLOW * SLOW;
    if slow { Method::RungeKutta4 } else { Method::Rosenbrock2 }
}

/// Checks that the method is valid for the contacts of the scene.
pub(super) fn check_method(scene: &Scene, settings: &Settings) -> Result<(), Error> {
    let (touches, method) = (scene.touches(), settings.method);
    if !touches && method == Method::Contact {
        let expected = "another method, because the scene has no contacts";
        return Err(Error::argument("method", format!("{:?}", method.name()), expected));
    }
    if touches && settings.smoothing > 0.0 && !matches!(method, Method::Auto | Method::Contact) {
        let found = format!("{:?} with smoothing", method.name());
        let expected = "\"auto\" or \"contact\", because smoothed contacts act at every distance";
        return Err(Error::argument("method", found, expected));
    }
    Ok(())
}

/// Checks that the connections of a scene with contacts are rigid: the only treatment in its steps.
pub(super) fn check_connections_of_contacts(scene: &Scene, compliance: &[f64]) -> Result<(), Error> {
    if !scene.touches() || scene.constraints().is_empty() {
        return Ok(());
    }
    if compliance.iter().any(|&c| c != 0.0) {
        let expected = "rigid connections in a scene with contacts: omit compliance";
        return Err(Error::argument("compliance", "compliance of connections", expected));
    }
    Ok(())
}
