//! Decisions at the start of a rollout: the method that `Method::Auto` selects, and the rows with exact friction or
//! stops.

use super::method::Method;
use super::properties::{Gains, Properties};
use super::settings::{Settings, Stabilization};
use super::stops::SetValued;
use crate::dynamics::{factorise, solve};
use crate::error::{Error, in_language};
use crate::filter::Form;
use crate::scene::{Coupling, Scene};
use crate::workspace::Workspace;
use std::collections::HashMap;

/// The rows with exact friction or stops. For coupled joints, these are the independent rows, with the friction and
/// limits of the joints that follow them.
pub(super) fn set_valued(
    scene: &Scene,
    coupling: Option<&Coupling>,
    properties: &Properties,
    stops: bool,
) -> Vec<SetValued> {
    let exact = properties.friction_speed == 0.0;
    let reduced = coupling.map(|coupling| {
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
            let friction = if exact { friction[row] } else { 0.0 };
            if friction > 0.0 || bounds.is_some() {
                let coordinate = joint.q.start;
                rows.push(SetValued { row, coordinate, friction, stops: bounds.is_some(), lower, upper });
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
pub(super) const CONTROLLED: f64 = 1e-3;

/// The method that [`Method::Auto`] selects: the explicit method of order 4 if springs, damping and gains are slow for
/// this step, by the bounds sum d (M^-1)_jj and sum k (M^-1)_jj at the first state, and friction is exact.
pub(super) fn choose(scene: &Scene, dt: f64, properties: &Properties, gains: Option<&Gains>, q: &[f64]) -> Method {
    let (nq, nv) = (scene.nq(), scene.nv());
    let with = |own: &[f64], settings: Option<&[f64]>| -> Vec<f64> {
        own.iter().enumerate().map(|(i, x)| x + settings.map_or(0.0, |settings| settings[i])).collect()
    };
    let damping = with(&properties.damping, gains.map(|gains| &gains.derivative[..]));
    let stiffness = with(&properties.stiffness, gains.map(|gains| &gains.proportional[..]));
    let regularized = properties.friction_speed > 0.0 && properties.friction.iter().any(|&f| f > 0.0);
    if regularized {
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
    let (touches, method) = (!scene.contacts().is_empty(), settings.method);
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

/// Checks that the connections of a scene with contacts are rigid and projected: the only treatment in its steps.
pub(super) fn check_connections_of_contacts(
    scene: &Scene,
    stabilization: Stabilization,
    compliance: &[f64],
) -> Result<(), Error> {
    if scene.contacts().is_empty() || scene.constraints().is_empty() {
        return Ok(());
    }
    if let Stabilization::Baumgarte(rate) = stabilization {
        let expected = format!(
            "{} in a scene with contacts, whose connections are projected",
            in_language("Stabilization::Projection", "None")
        );
        return Err(Error::argument("baumgarte", format!("{rate}"), expected));
    }
    if compliance.iter().any(|&c| c != 0.0) {
        let expected = "rigid connections in a scene with contacts: omit compliance";
        return Err(Error::argument("compliance", "compliance of connections", expected));
    }
    Ok(())
}
