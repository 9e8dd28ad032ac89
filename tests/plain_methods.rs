//! The plain methods of a scene run the compiled kernels of this scene.

use crate::common::lanes::{ALGORITHMS, arguments, states, trees};
use phipsi::batch::Fault;
use phipsi::{Algorithm, Arguments, Derivatives, Error, Form, Products, Scene, Workspace, scenes};

/// One algorithm by the method of the scene.
fn plain(
    scene: &Scene,
    workspace: &mut Workspace<f64>,
    algorithm: Algorithm,
    state: &Arguments<'_>,
) -> Result<Vec<f64>, Error> {
    let mut out = vec![f64::NAN; scene.width(algorithm)];
    let &Arguments { q, qd, u, wrenches, seed, .. } = state;
    match algorithm {
        Algorithm::ForwardDynamics(form) => {
            workspace.form = form;
            scene.forward_dynamics(workspace, q, qd, u, wrenches, &mut out)
        }
        Algorithm::ConstrainedDynamics(form) => {
            workspace.form = form;
            let (qdd, rest) = out.split_at_mut(scene.nv());
            let (forces, told) = rest.split_at_mut(scene.constraint_rows());
            let scratch = &mut scene.constraint_scratch();
            let found = scene.constrained_dynamics(workspace, scratch, q, qd, u, wrenches, (qdd, forces));
            #[allow(clippy::cast_precision_loss)] // a count
            found.map(|found| told.copy_from_slice(&[found.rank as f64, found.residual]))
        }
        Algorithm::InverseDynamics => scene.inverse_dynamics(workspace, q, qd, u, wrenches, &mut out),
        Algorithm::BiasTorque => scene.bias_torque(workspace, q, qd, &mut out),
        Algorithm::MassMatrix => scene.mass_matrix(workspace, q, &mut out),
        Algorithm::MassMatrixInverse(form) => {
            workspace.form = form;
            scene.mass_matrix_inverse(workspace, &mut scene.inverse_scratch(), q, &mut out)
        }
        Algorithm::Derivatives(Derivatives::InverseDynamics) => {
            scene.inverse_dynamics_derivatives(workspace, q, qd, u, wrenches, &mut out)
        }
        Algorithm::Derivatives(Derivatives::ForwardDynamics(form)) => {
            workspace.form = form;
            scene.forward_dynamics_derivatives(workspace, q, qd, u, wrenches, &mut out)
        }
        Algorithm::Products(which) => {
            let (tangent, gradient) = (Products::tangent(which.form()), Products::gradient(which.form()));
            workspace.form = which.form().unwrap_or_default();
            match which.form() {
                None if which == tangent => scene.inverse_dynamics_jvp(workspace, q, qd, u, wrenches, seed, &mut out),
                None if which == gradient => {
                    scene.inverse_dynamics_vjp(workspace, q, qd, u, wrenches, seed[0], &mut out)
                }
                None if which == tangent.with_constants() => scene.inverse_dynamics_along(workspace, state, &mut out),
                None => scene.inverse_dynamics_gradients(workspace, q, qd, u, wrenches, seed[0], &mut out),
                _ if which == tangent => scene.forward_dynamics_jvp(workspace, q, qd, u, wrenches, seed, &mut out),
                _ if which == gradient => scene.forward_dynamics_vjp(workspace, q, qd, u, wrenches, seed[0], &mut out),
                _ if which == tangent.with_constants() => scene.forward_dynamics_along(workspace, state, &mut out),
                _ => scene.forward_dynamics_gradients(workspace, q, qd, u, wrenches, seed[0], &mut out),
            }
        }
        Algorithm::Derivatives(Derivatives::CoriolisMatrix) => scene.coriolis_matrix(workspace, q, qd, &mut out),
        Algorithm::Derivatives(Derivatives::MassMatrix) => scene.mass_matrix_derivative(workspace, q, qd, &mut out),
        other => unreachable!("{other:?}: an algorithm without a method here"),
    }?;
    Ok(out)
}

fn evaluated(scene: &Scene, algorithm: Algorithm, state: &Arguments<'_>) -> Vec<f64> {
    let mut out = vec![f64::NAN; scene.width(algorithm)];
    scene
        .evaluate(&mut scene.evaluator(), algorithm, &[*state], &mut out)
        .map_err(|Fault { error, .. }| error)
        .unwrap();
    out
}

fn bits(numbers: &[f64]) -> Vec<u64> {
    numbers.iter().map(|x| x.to_bits()).collect()
}

/// Bitwise equal to the kernels, which differ from the recursions in the last place.
#[test]
fn a_plain_method_is_the_kernel_of_one_state() {
    for scene in trees().chain([scenes::chain(7).unwrap()]) {
        let mut workspace = scene.workspace();
        for algorithm in ALGORITHMS {
            for state in &states(&scene, 3) {
                let state = arguments(algorithm, state, &[]);
                let found = plain(&scene, &mut workspace, algorithm, &state).unwrap();
                assert_eq!(bits(&found), bits(&evaluated(&scene, algorithm, &state)), "{algorithm:?}");
            }
        }
    }
}

/// Chains of seven for which the recursions and the kernels differ by the order of their sums: the plain method is
/// not the recursion.
#[test]
fn a_plain_method_is_not_the_recursion() {
    let scene = scenes::chain(7).unwrap();
    if scene.evaluator().instruction_set().name() == "baseline" {
        return;
    }
    let algorithm = Algorithm::ForwardDynamics(Form::Covariance);
    let mut workspace = scene.workspace();
    let differ = states(&scene, 20).iter().any(|state| {
        let state = arguments(algorithm, state, &[]);
        let mut out = vec![f64::NAN; 7];
        scene.recursion(&mut workspace, None, algorithm, &state, &mut out).unwrap();
        out != plain(&scene, &mut workspace, algorithm, &state).unwrap()
    });
    assert!(differ);
}

/// A workspace of another scene is refused by name, even with the same size, by all calls with a workspace.
#[test]
fn a_workspace_of_another_scene_is_refused() {
    let (scene, other) = (scenes::chain(7).unwrap(), scenes::chain(9).unwrap());
    let alike = scenes::extreme("heavy-tip", Some(10.0), Some(7), 0).unwrap().scene;
    assert_eq!((scene.nv(), scene.model().bodies.len()), (alike.nv(), alike.model().bodies.len()));
    let state = &states(&scene, 1)[0];
    let (q, qd, _) = state;
    for mut foreign in [alike.workspace(), other.workspace(), scenes::chain(3).unwrap().workspace()] {
        let refused = |what: &str, outcome: Result<(), Error>| {
            let text = outcome.expect_err(what).to_string();
            assert!(text.contains("workspace") && text.contains("scene.workspace()"), "{what}: {text}");
        };
        for algorithm in ALGORITHMS {
            let outcome = plain(&scene, &mut foreign, algorithm, &arguments(algorithm, state, &[]));
            refused(&format!("{algorithm:?}"), outcome.map(drop));
        }
        refused("energy", scene.energy(&mut foreign, q, qd).map(drop));
        refused("momentum", scene.momentum(&mut foreign, q, qd).map(drop));
        refused("factor", scene.factor(&mut foreign, q).map(drop));
        let mut factor = scene.factor(&mut scene.workspace(), q).unwrap();
        refused("update_factor", scene.update_factor(&mut foreign, &mut factor, q).map(drop));
        let (mut scratch, mut omega) = (scene.operational_scratch(), [0.0; 36]);
        let outcome = scene.operational_inverse_inertia(&mut foreign, &mut scratch, q, &["link6"], &mut omega);
        refused("operational_inverse_inertia", outcome);
    }
    // And so is scratch memory for the inverse, if the recursion reads it.
    let mut workspace = scene.workspace().in_form(Form::SquareRoot);
    let outcome = scene.mass_matrix_inverse(&mut workspace, &mut other.inverse_scratch(), q, &mut [0.0; 49]);
    assert!(outcome.unwrap_err().to_string().contains("scene.inverse_scratch()"));
}

/// A copy, and a workspace created for the recursions, create their own kernels.
#[test]
fn any_workspace_of_this_size_will_do() {
    let scene = scenes::chain(7).unwrap();
    let own = scene.workspace();
    for mut workspace in [own.clone(), Workspace::new(scene.model())] {
        for algorithm in ALGORITHMS {
            let state = &states(&scene, 1)[0];
            let state = arguments(algorithm, state, &[]);
            let found = plain(&scene, &mut workspace, algorithm, &state).unwrap();
            assert_eq!(bits(&found), bits(&evaluated(&scene, algorithm, &state)), "{algorithm:?}");
        }
    }
}
