//! Connections and coupled joints in steps with contacts: their rows hold exactly at the end of each step.
//!
//! ```text
//! M (v' - v_free) = J_k* lambda + J_c* p,   J_k v' = 0,   contact law for p
//! ```
//!
//! `v_free` is first projected onto the connections; contact impulses then act on the complement of their rows. At the
//! end of the step, positions and velocities are projected onto the connections.

use super::super::constrained::{check_projection, named};
use super::super::step_settings::StepSettings;
use super::moves::{Move, Pulled};
use crate::dynamics::constraints::Elimination;
use crate::dynamics::contacts::ContactScratch;
use crate::error::Error;
use crate::model::Model;
use crate::scene::Scene;
use crate::scene::constraint::Constraints;
use crate::workspace::Workspace;

/// The rows of the connections of a scene, or of its coupled joints.
pub(super) fn constraints(scene: &Scene, settings: &StepSettings) -> Constraints {
    match &settings.coupling {
        Some(coupling) => coupling.tied().constraints().clone(),
        None => scene.constraints().clone(),
    }
}

/// The elimination of these rows, if there are any.
pub(super) fn eliminated(scene: &Scene, settings: &StepSettings) -> Option<Box<Elimination>> {
    let constraints = constraints(scene, settings);
    (!constraints.is_empty()).then(|| Box::new(Elimination::new(scene.model(), constraints)))
}

/// Projects `v` onto the velocities that satisfy the connections at `q`, if there are any, and factorizes their rows
/// there. Records the change in `pulled`.
pub(super) fn onto_connections(
    scene: &Scene,
    (model, workspace): (&Model<f64>, &mut Workspace<f64>),
    rows: &mut ContactScratch,
    (q, v): (&[f64], &mut [f64]),
    pulled: Option<&mut Pulled>,
) -> Result<(), (String, Error)> {
    let Some(closed) = &mut rows.closed else { return Ok(()) };
    if !q.iter().chain(&*v).all(|x| x.is_finite()) {
        // A diverging motion is reported as such.
        return Ok(());
    }
    let before = pulled.is_some().then(|| v.to_vec());
    let projected = closed.velocities(model, workspace, (q, v));
    if let (Some(pulled), Some(before)) = (pulled, before) {
        pulled.change = v.iter().zip(before).map(|(v, before)| v - before).collect();
        pulled.impulses = closed.forces().to_vec();
    }
    check_projection(scene, (model, workspace), projected, "m/s or rad/s").map_err(|failure| named(scene, failure))
}

/// Projects `q` onto the connections, if there are any. Records the Newton steps in `moves`.
pub(super) fn positions_onto_connections(
    scene: &Scene,
    (model, workspace): (&Model<f64>, &mut Workspace<f64>),
    rows: &mut ContactScratch,
    q: &mut [f64],
    moves: Option<&mut Vec<Move>>,
) -> Result<(), (String, Error)> {
    let Some(closed) = &mut rows.closed else { return Ok(()) };
    if !q.iter().all(|x| x.is_finite()) {
        return Ok(());
    }
    let mut steps = Vec::new();
    let projected = closed.positions(model, workspace, q, moves.is_some().then_some(&mut steps));
    if let Some(moves) = moves {
        moves.extend(steps.into_iter().map(Move::Pull));
    }
    check_projection(scene, (model, workspace), projected, "m or rad").map_err(|failure| named(scene, failure))
}

#[cfg(test)]
mod tests {
    use super::super::super::method::Method;
    use super::super::super::properties::Properties;
    use super::super::super::settings::Settings;
    use super::super::super::step_settings::StepSettings;
    use super::super::at::{At, Connections, Moved};
    use crate::dynamics::constraints::Elimination;
    use crate::dynamics::contacts::ContactScratch;
    use crate::dynamics::forward::factorise;
    use crate::scene::{Connection, ConnectionKind, Contact, Scene, Surface};
    use nalgebra::{DMatrix, DVector};
    use std::sync::Arc;

    /// A chain whose ends are a fixed distance apart, with that distance given twice, a contact with the ground
    /// and a pair of links.
    fn scene() -> Scene {
        let mut builder = crate::scenes::chain(5).unwrap().source().clone();
        for name in ["rod", "again"] {
            let mut rod = Connection::new(name, ConnectionKind::Distance(Some(0.6)), "link0", Some("link4"));
            rod.frame.lever = [0.1, 0.0, 0.0].into();
            builder = builder.connect(rod);
        }
        let pair = Contact::new("pair", "link2").with_radius(0.1).with_other("link4".to_owned());
        let pair = pair.with_surface(Surface::Box { size: [0.1, 0.2, 0.3].into() });
        builder.contact(pair).contact(Contact::new("ground", "link4").with_point([0.0, 0.1, 0.3])).build().unwrap()
    }

    /// G = J (M^-1 - M^-1 K* (K M^-1 K*)^+ K M^-1) J* by dense algebra with M and the Jacobians by columns, and the
    /// response to impulses, for which K dv = 0.
    #[test]
    fn responses_on_the_connections_are_those_of_dense_algebra() {
        let scene = scene();
        let (model, points, nv) = (scene.model(), scene.contact_points(), scene.nv());
        let q = [0.3, -0.4, 0.5, 0.2, 0.7];
        let mut workspace = scene.workspace();
        let mut m = DMatrix::zeros(nv, nv);
        scene.mass_matrix(&mut workspace, &q, m.as_mut_slice()).unwrap();
        let mut k = DMatrix::zeros(nv, scene.constraint_rows());
        let mut scratch = scene.constraint_scratch();
        scene.constraint_jacobian(&mut workspace, &mut scratch, &q, k.as_mut_slice()).unwrap();

        let mut rows = ContactScratch::new(model, points, Vec::new());
        rows.place(model, points, &q);
        let mut j = DMatrix::zeros(6, nv);
        for i in 0..nv {
            let mut unit = vec![0.0; nv];
            unit[i] = 1.0;
            j.set_column(i, &rows.velocities(model, points, &unit));
        }
        rows.closed = Some(Box::new(Elimination::new(model, scene.constraints().clone())));
        factorise(model, &mut workspace, &q);
        rows.closed.as_mut().unwrap().factorize(model, &workspace, &q).unwrap();
        let mut near = vec![0, 1];
        let gram = rows.gram(model, points, &workspace, &mut near).remove(0).1.dense().into_owned();

        // The two rods are one row.
        let inverse = m.try_inverse().unwrap();
        let first = k.columns(0, 1).into_owned();
        let (mk, kmk) = (&inverse * &first, (first.transpose() * &inverse * &first)[(0, 0)]);
        let on_rods = &inverse - &mk * mk.transpose() / kmk;
        let expected = &j * &on_rods * j.transpose();
        let size = (&j * &inverse * j.transpose()).amax();
        assert!((&gram - &expected).amax() <= 1e-12 * size, "{gram} {expected}");
        assert!((&gram - &j * &inverse * j.transpose()).amax() >= 1e-3 * size);

        let impulses = DVector::from_fn(6, |i, _| [0.3, -0.2, 0.9, 0.1, 0.4, 1.2][i]);
        rows.respond(model, &mut workspace, &impulses);
        let response = DVector::from_column_slice(&rows.response);
        let dense = on_rods * j.transpose() * impulses;
        assert!((&response - &dense).amax() <= 1e-11 * dense.amax(), "{response} {dense}");
        assert!((k.transpose() * &response).amax() <= 1e-12 * dense.amax());
    }
    /// The gradient of a function of the response to an impulse is its difference; without the terms of the connections
    /// it is not.
    #[test]
    fn gradients_of_responses_are_differences() {
        const STEP: f64 = 1e-3;
        let scene = scene();
        let (model, points, nv) = (scene.model(), scene.contact_points(), scene.nv());
        let settings = StepSettings::new(
            model,
            Arc::new(Settings::new(&scene, 1e-3)),
            Method::Contact,
            (Properties::of(&scene), None),
        );
        let (mut workspace, mut rows) = (scene.workspace(), ContactScratch::new(model, points, Vec::new()));
        let mut connections = Connections::new(&scene, &settings, model, false);
        let (workspace, rows, connections) = (&mut workspace, &mut rows, &mut connections);
        let mut at = At { scene: &scene, model, workspace, rows, connections };
        let q = [0.3, -0.4, 0.5, 0.2, 0.7];
        let (bar, torque) = ([0.4, -0.3, 0.9, 0.2, -0.7], [1.2, 0.3, -0.8, 0.5, 0.9]);
        at.place(&q).unwrap();
        let (y, m) = (at.solve(&torque), at.solve(&bar));
        let (mut found, mut naive) = (vec![0.0; nv], vec![0.0; nv]);
        at.add_gradient((&y, &m), &y.v, &mut found).unwrap();
        let still = |of: &Moved| Moved { v: of.v.clone(), lambda: vec![0.0; of.lambda.len()] };
        at.add_gradient((&still(&y), &still(&m)), &y.v, &mut naive).unwrap();
        let mut value = |joint: usize, step: f64| -> f64 {
            let mut moved = q;
            moved[joint] += step;
            at.place(&moved).unwrap();
            at.solve(&torque).v.iter().zip(bar).map(|(v, bar)| v * bar).sum()
        };
        let slopes: Vec<f64> = (0..nv)
            .map(|j| {
                let mut of = |step: f64| value(j, step) - value(j, -step);
                (8.0 * of(STEP) - of(2.0 * STEP)) / (12.0 * STEP)
            })
            .collect();
        let size = slopes.iter().fold(0.0_f64, |most, slope| most.max(slope.abs()));
        let off = |found: &[f64]| found.iter().zip(&slopes).fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()));
        assert!(off(&found) <= 1e-8 * size, "{found:?} {slopes:?}");
        assert!(off(&naive) >= 1e-2 * size, "{naive:?} {slopes:?}");
    }
}
