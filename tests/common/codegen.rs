//! Scenes for generated code, and results of their methods.

use super::{ALL_KINDS, Random, Tree, random_inertial};
use nalgebra::Vector3;
use phipsi::codegen::Function;
use phipsi::scene::{JointDescription, JointKind, LinkDescription};
use phipsi::{Scene, SceneBuilder};

/// Trees with all types of joints: with an even seed on a fixed base, with an odd one floating.
pub fn tree(seed: u64, bodies: usize) -> Scene {
    Tree { seed, bodies, kinds: &ALL_KINDS, floating: seed % 2 == 1, branching: 0.3, armature: 0.1 }.scene()
}

/// A floating trunk on four legs with three joints, whose programs share the code of a leg: the constants differ from
/// leg to leg.
pub fn quadruped() -> Scene {
    let random = &mut Random::new(8);
    let mut link = |name: &str| LinkDescription { name: name.to_owned(), inertial: Some(random_inertial(random)) };
    let mut builder = SceneBuilder::new().floating_base(true).link(link("trunk"));
    for (leg, (front, side)) in [(0.4, 0.2), (0.4, -0.2), (-0.4, 0.2), (-0.4, -0.2)].into_iter().enumerate() {
        let mut parent = "trunk".to_owned();
        for (at, axis) in [Vector3::x(), Vector3::y(), Vector3::y()].into_iter().enumerate() {
            let child = format!("link{leg}{at}");
            let mut joint = JointDescription::new(format!("joint{leg}{at}"), JointKind::Revolute, &parent, &child);
            joint.axis = axis;
            joint.origin.lever =
                if at == 0 { Vector3::new(front, side, 0.05) } else { Vector3::new(0.01, side / 3.0, -0.3) };
            builder = builder.link(link(&child)).joint(joint);
            parent = child;
        }
    }
    builder.build().unwrap()
}

/// Result of the scene's method, with all results concatenated.
pub fn by_method(scene: &Scene, function: &Function, given: &[Vec<f64>]) -> Vec<f64> {
    let (mut workspace, mut out) = (scene.workspace(), vec![f64::NAN; function.width(scene)]);
    let w = &mut workspace;
    let at = |argument: usize| given.get(argument).map_or(&[][..], |values| &values[..]);
    let (q, qd, u, along) = (at(0), at(1), at(2), [at(3), at(4), at(5)]);
    match function {
        Function::ForwardDynamics => scene.forward_dynamics(w, q, qd, u, &[], &mut out),
        Function::ConstrainedDynamics => {
            let scratch = &mut scene.constraint_scratch();
            let (qdd, rest) = out.split_at_mut(scene.nv());
            let (forces, told) = rest.split_at_mut(scene.constraint_rows());
            scene.constrained_dynamics(w, scratch, q, qd, u, &[], (qdd, forces)).map(|found| {
                #[allow(clippy::cast_precision_loss)] // small
                told.copy_from_slice(&[found.rank as f64, found.residual]);
            })
        }
        Function::Watched(_) | Function::FactorWatched => unreachable!("no method has a margin"),
        Function::InverseDynamics => scene.inverse_dynamics(w, q, qd, u, &[], &mut out),
        Function::BiasTorque => scene.bias_torque(w, q, qd, &mut out),
        Function::MassMatrix => scene.mass_matrix(w, q, &mut out),
        Function::MassMatrixInverse => scene.mass_matrix_inverse(w, &mut scene.inverse_scratch(), q, &mut out),
        Function::ForwardDynamicsDerivatives => scene.forward_dynamics_derivatives(w, q, qd, u, &[], &mut out),
        Function::InverseDynamicsDerivatives => scene.inverse_dynamics_derivatives(w, q, qd, u, &[], &mut out),
        Function::ForwardDynamicsJvp => scene.forward_dynamics_jvp(w, q, qd, u, &[], along, &mut out),
        Function::ForwardDynamicsVjp => scene.forward_dynamics_vjp(w, q, qd, u, &[], at(3), &mut out),
        Function::InverseDynamicsJvp => scene.inverse_dynamics_jvp(w, q, qd, u, &[], along, &mut out),
        Function::InverseDynamicsVjp => scene.inverse_dynamics_vjp(w, q, qd, u, &[], at(3), &mut out),
        Function::Placements => scene.placements(q).map(|all| {
            all.iter().zip(out.chunks_exact_mut(16)).for_each(|(link, out)| link.homogeneous(out));
        }),
        Function::Placement(link) => scene.placement(q, link).map(|place| place.homogeneous(&mut out)),
        Function::Jacobian(link, frame) => scene.jacobian(q, link, *frame, &mut out),
        other => unreachable!("{other:?}: a function without a method here"),
    }
    .unwrap();
    out
}
