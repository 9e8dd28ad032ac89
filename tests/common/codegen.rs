//! Scenes that are compiled, and what their methods give.

use super::lanes::State;
use super::{ALL_KINDS, Tree};
use phipsi::Scene;
use phipsi::codegen::Function;

/// Trees of all joints: of an even seed on a fixed base, of an odd one floating.
pub fn tree(seed: u64) -> Scene {
    Tree { seed, bodies: 9, kinds: &ALL_KINDS, floating: seed % 2 == 1, branching: 0.3, armature: 0.1 }.scene()
}

/// What the scene's own method gives.
pub fn by_method(scene: &Scene, function: Function, (q, qd, u): &State) -> Vec<f64> {
    let (mut workspace, mut out) = (scene.workspace(), vec![f64::NAN; function.width(scene.nv())]);
    match function {
        Function::ForwardDynamics => scene.forward_dynamics(&mut workspace, q, qd, u, &[], &mut out),
        Function::InverseDynamics => scene.inverse_dynamics(&mut workspace, q, qd, u, &[], &mut out),
        Function::BiasTorque => scene.bias_torque(&mut workspace, q, qd, &mut out),
        Function::MassMatrix => scene.mass_matrix(&mut workspace, q, &mut out),
        Function::MassMatrixInverse => {
            scene.mass_matrix_inverse(&mut workspace, &mut scene.inverse_scratch(), q, &mut out)
        }
    }
    .unwrap();
    out
}
