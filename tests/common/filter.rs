//! Filter and smoother over a tree, stage by stage from the rows of `phipsi::filter`: what the passes of the product
//! are compared with.

use nalgebra::Vector6;
use phipsi::filter::riccati::{self, Measured};
use phipsi::filter::{System, innovations, smoother};
use phipsi::spatial::{RigidShift, Symmetric6};

/// D and g of each row, P^- of each row, and P^+ of each body.
pub type Covariances = (Vec<Measured<f64>>, Vec<Symmetric6<f64>>, Vec<Symmetric6<f64>>);

/// Tip to base: D and g of each row, P^- of each row, and P^+ of each stage (3.6, 3.10), from the process noise of each
/// stage.
pub fn riccati(system: &System<f64>, shift: &[RigidShift<f64>], mut p: Vec<Symmetric6<f64>>) -> Covariances {
    let mut measured = vec![Measured::filled(f64::NAN); system.rows()];
    let mut p_minus = vec![Symmetric6::filled(f64::NAN); system.rows()];
    for (k, stage) in system.stages.iter().enumerate().rev() {
        for i in (0..stage.rows.count()).rev() {
            let row = stage.first_row + i;
            p_minus[row] = p[k];
            measured[row] = riccati::measurement_update(&mut p[k], &stage.rows.row(i), system.noise[row]);
        }
        if let Some(parent) = stage.parent {
            p[parent] = p[parent].add(&shift[k].inertia_to_parent(&p[k]));
        }
    }
    (measured, p_minus, p)
}

/// Tip to base: `e` receives e^- of each row (4.2); `z` holds b(k) on entry and z^+(k) on return (4.4, 4.5).
pub fn innovations(
    system: &System<f64>,
    shift: &[RigidShift<f64>],
    measured: &[Measured<f64>],
    measurement: &[f64],
    z: &mut [Vector6<f64>],
    e: &mut [f64],
) {
    for (k, stage) in system.stages.iter().enumerate().rev() {
        let mut state = z[k];
        innovations::through_stage((system, k), measured, measurement, &mut state, e);
        z[k] = state;
        if let Some(parent) = stage.parent {
            z[parent] += shift[k].force_to_parent(&state);
        }
    }
}

/// Base to tip: co-states lambda^-(k) (4.10, 4.11), and the estimates (4.9) in the place of e^-.
pub fn smoother(
    system: &System<f64>,
    shift: &[RigidShift<f64>],
    measured: &[Measured<f64>],
    co_state: &mut [Vector6<f64>],
    estimates: &mut [f64],
) {
    for (k, stage) in system.stages.iter().enumerate() {
        let mut lambda = stage.parent.map_or_else(Vector6::zeros, |p| shift[k].motion_to_child(&co_state[p]));
        smoother::through_stage(stage, measured, &mut lambda, estimates);
        co_state[k] = lambda;
    }
}

/// Tip to base: the whole forces z(k) of the forces w(k), and their torques (1.5).
pub fn predict(system: &System<f64>, shift: &[RigidShift<f64>], z: &mut [Vector6<f64>], predicted: &mut [f64]) {
    for (k, stage) in system.stages.iter().enumerate().rev() {
        for i in 0..stage.rows.count() {
            predicted[stage.first_row + i] = stage.rows.row(i).project(&z[k]);
        }
        if let Some(parent) = stage.parent {
            let carried = shift[k].force_to_parent(&z[k]);
            z[parent] += carried;
        }
    }
}
