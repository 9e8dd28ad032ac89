//! Generated programs of single robots compared with the methods of the scene; their C code compiled by the system's
//! compiler and run.

use crate::common::codegen::{by_method, quadruped, tree};
use crate::common::lanes::{State, states};
use crate::common::{Random, random_inertial, tolerance};
use phipsi::codegen::{Function, Program, WATCHED, Width, sources};
use phipsi::kinematics::{REFERENCE_FRAMES, ReferenceFrame};
use phipsi::scene::{
    Connection, ConnectionKind, JointDescription, JointKind, LinkDescription, Mimic, MimicJoints, Polynomial,
};
use phipsi::spatial::RigidShift;
use phipsi::{Scene, SceneBuilder, scenes};
use std::process::Command;

/// All functions; those of one link for the first, a middle and the last link.
fn functions(scene: &Scene) -> Vec<Function> {
    let (links, mut all) = (scene.links(), Function::of(scene));
    for at in [0, links.len() / 2, links.len() - 1] {
        let link = || links[at].name.clone();
        all.push(Function::Placement(link()));
        all.extend(REFERENCE_FRAMES.iter().map(|&(_, frame)| Function::Jacobian(link(), frame)));
    }
    all
}

/// Typical states: random, at rest, static equilibrium, passive, one joint moving; the third array is a torque.
fn states_of_people(scene: &Scene) -> Vec<State> {
    let (q, qd, u) = states(scene, 1).remove(0);
    let still = vec![0.0; scene.nv()];
    let mut held = still.clone();
    scene.bias_torque(&mut scene.workspace(), &q, &still, &mut held).unwrap();
    let mut one = still.clone();
    one[scene.nv() / 2] = 1.5;
    vec![
        (q.clone(), qd.clone(), u),
        (scene.neutral(), still.clone(), still.clone()),
        (q.clone(), still.clone(), held),
        (q.clone(), qd, still.clone()),
        (q, one, still),
    ]
}

/// In the code, its header and its test, for each function.
#[test]
fn c_has_functions_for_batches_only_on_request() {
    let scene = scenes::chain(3).unwrap();
    let functions = [Function::ForwardDynamics, Function::MassMatrix];
    for (width, batches) in
        [(Width::Double, false), (Width::Double, true), (Width::Single, false), (Width::Single, true)]
    {
        let files = sources(&scene, "arm", &functions, (width, batches)).unwrap();
        for (file, text) in files.iter().filter(|(file, _)| file != "Makefile") {
            for function in &functions {
                let (one, many) = (format!("arm_{}(", function.name()), format!("arm_{}_batch(", function.name()));
                assert!(text.contains(&one), "{file}: no {one}");
                assert_eq!(text.contains(&many), batches, "{file}: {many}");
            }
        }
        let text = |name: &str| &files.iter().find(|(file, _)| file == name).unwrap().1;
        assert_eq!(text("arm.h").contains("<stddef.h>"), batches);
        // Between the two lines are the functions of one state.
        let guards = ["#ifndef ARM_BATCHES_ALONE", "#endif /* ARM_BATCHES_ALONE */"];
        let places = guards.map(|guard| text("arm.c").find(guard));
        let [one, many] = ["void arm_mass_matrix(", "int arm_mass_matrix_batch("].map(|of| text("arm.c").find(of));
        assert_eq!(places.map(|place| place.is_some()), [batches; 2]);
        assert!(!batches || (places[0] < one && one < places[1] && places[1] < many), "{places:?}");
    }
}

#[test]
fn programs_compute_what_the_methods_do() {
    let mut all: Vec<Scene> = (0..6).map(|seed| tree(seed, 9)).collect();
    all.push(scenes::chain(7).unwrap());
    all.push(scenes::chain(1).unwrap());
    for (index, scene) in all.iter().enumerate() {
        let seeds: [Vec<f64>; 3] = [11, 12, 13].map(|seed| Random::new(seed).array(scene.nv(), 1.0));
        for function in functions(scene) {
            let program = Program::new(scene, &function).unwrap();
            for (which, (q, qd, u)) in states_of_people(scene).into_iter().enumerate() {
                let mut given = vec![q, qd, u];
                given.extend(seeds.clone());
                let given = &given[..program.arguments.len()];
                let expected = by_method(scene, &function, given);
                let found = program.run(&given.concat()).unwrap();
                let mut mass = vec![f64::NAN; scene.nv() * scene.nv()];
                scene.mass_matrix(&mut scene.workspace(), &given[0], &mut mass).unwrap();
                let cond = tolerance::conditioning(scene.nv(), &mass).number;
                // Each result relative to the terms of all results, because at rest some consist of rounding errors.
                let bound = 64.0 * f64::EPSILON * tolerance::size(&expected).max(1.0) * (cond + 16.0);
                let what = format!("{index} {} in state {which}", function.symbol());
                tolerance::assert_near(&what, &found, &expected, bound);
            }
        }
    }
}

/// The margin of the error estimate: if it is not negative, the result is accurate; it is negative for a heavy tip,
/// and in few states of ordinary robots.
#[test]
fn what_is_watched_tells_where_digits_are_lost() {
    let (mut doubted, mut tame, mut tame_in_doubt) = (0, 0, 0);
    let ratios =
        (0..13).map(|decades| scenes::extreme("heavy-tip", Some(10_f64.powi(decades)), None, 0).unwrap().scene);
    let people = (0..4).map(|seed| tree(seed, 7)).chain([scenes::chain(7).unwrap()]);
    for (scene, is_tame) in people.map(|scene| (scene, true)).chain(ratios.map(|scene| (scene, false))) {
        // Trees have no connections.
        for function in
            WATCHED.iter().filter(|function| **function != Function::Watched(&Function::ConstrainedDynamics))
        {
            let program = Program::new(&scene, function).unwrap();
            for (which, (q, qd, u)) in states_of_people(&scene).into_iter().enumerate() {
                tame += usize::from(is_tame);
                let seeds = [21, 22, 23].map(|seed| Random::new(seed).array(scene.nv(), 1.0));
                let given = &[&[q, qd, u][..], &seeds].concat()[..program.arguments.len()];
                let (mut workspace, mut expected) = (scene.workspace(), vec![f64::NAN; function.width(&scene) - 1]);
                match function {
                    Function::Watched(Function::ForwardDynamics) => {
                        scene.forward_dynamics(&mut workspace, &given[0], &given[1], &given[2], &[], &mut expected)
                    }
                    Function::Watched(Function::MassMatrixInverse) => {
                        let mut scratch = scene.inverse_scratch();
                        scene.mass_matrix_inverse(&mut workspace, &mut scratch, &given[0], &mut expected)
                    }
                    Function::Watched(Function::ForwardDynamicsDerivatives) => {
                        let [q, qd, u] = [0, 1, 2].map(|i| &given[i][..]);
                        scene.forward_dynamics_derivatives(&mut workspace, q, qd, u, &[], &mut expected)
                    }
                    Function::Watched(Function::ForwardDynamicsJvp) => {
                        let ([q, qd, u], along) = ([0, 1, 2].map(|i| &given[i][..]), [3, 4, 5].map(|i| &given[i][..]));
                        scene.forward_dynamics_jvp(&mut workspace, q, qd, u, &[], along, &mut expected)
                    }
                    Function::Watched(Function::ForwardDynamicsVjp) => {
                        let [q, qd, u, cotangent] = [0, 1, 2, 3].map(|i| &given[i][..]);
                        scene.forward_dynamics_vjp(&mut workspace, q, qd, u, &[], cotangent, &mut expected)
                    }
                    _ => Ok(()),
                }
                .unwrap();
                let found = program.run(&given.concat()).unwrap();
                let (found, margin) = (&found[..expected.len()], found[expected.len()]);
                if margin >= 0.0 {
                    // Effect of one unit in the last place of the torques on states in static equilibrium.
                    let held = given.get(2).map_or(0.0, |u| tolerance::size(u));
                    let bound = 1e-11 * (tolerance::size(&expected) + held);
                    tolerance::assert_near(&function.symbol(), found, &expected, bound);
                } else {
                    // A straight chain at rest is close to the limit of precision.
                    assert!(!is_tame || which > 0, "{} of a drawn state is in doubt: {margin:e}", function.symbol());
                    tame_in_doubt += usize::from(is_tame);
                    doubted += usize::from(!is_tame);
                }
            }
        }
    }
    assert!(doubted > 20 && 4 * tame_in_doubt < tame, "{doubted}, {tame_in_doubt} of {tame}");
}

#[test]
fn results_of_several_arrays_have_their_names_and_shapes() {
    let scene = scenes::chain(3).unwrap();
    let shapes = |function: Function| -> Vec<(&'static str, Vec<usize>)> {
        let program = Program::new(&scene, &function).unwrap();
        program.results.into_iter().map(|array| (array.name, array.shape)).collect()
    };
    assert_eq!(
        shapes(Function::ForwardDynamicsDerivatives),
        [("dqdd_dq", vec![3, 3]), ("dqdd_dqd", vec![3, 3]), ("Minv", vec![3, 3])]
    );
    assert_eq!(
        shapes(Function::InverseDynamicsVjp),
        [("gradient_q", vec![3]), ("gradient_qd", vec![3]), ("gradient_qdd", vec![3])]
    );
    assert_eq!(shapes(Function::Placements), [("placements", vec![scene.links().len(), 4, 4])]);
    let files = sources(&scene, "arm", &[Function::ForwardDynamicsDerivatives], (Width::Double, true)).unwrap();
    let header = &files[1].1;
    assert!(header.contains("double dqdd_dq[9], double dqdd_dqd[9], double Minv[9]);"), "{header}");
    assert!(header.contains("double *dqdd_dq, double *dqdd_dqd, double *Minv);"), "{header}");
}

fn link(name: &str) -> LinkDescription {
    LinkDescription { name: name.to_owned(), inertial: Some(random_inertial(&mut Random::new(3))) }
}

/// A hinge on the base.
fn joint(name: &str, child: &str) -> JointDescription {
    JointDescription::new(name, JointKind::Revolute, "base", child)
}

#[test]
fn functions_of_links_are_named_by_them() {
    let scene = SceneBuilder::new()
        .link(link("base"))
        .link(link("tool-0"))
        .link(link("tool_0"))
        .joint(joint("a", "tool-0"))
        .joint(joint("b", "tool_0"))
        .build()
        .unwrap();
    let (one, other) = (Function::Placement("tool-0".to_owned()), Function::Placement("tool_0".to_owned()));
    assert_eq!(one.symbol(), "placement_tool_0");
    let world = Function::Jacobian("tool-0".to_owned(), ReferenceFrame::LocalWorldAligned);
    assert_eq!(world.symbol(), "jacobian_tool_0_local_world_aligned");
    let files = sources(&scene, "arm", &[one.clone(), world], (Width::Double, false)).unwrap();
    assert!(files[1].1.contains("void arm_placement_tool_0(const double q[2], double placement[16]);"));
    let error = sources(&scene, "arm", &[one, other], (Width::Double, false)).unwrap_err().to_string();
    assert!(error.contains("tool-0") && error.contains("tool_0"), "{error}");
    let unknown = Program::new(&scene, &Function::Placement("hand".to_owned())).unwrap_err().to_string();
    assert!(unknown.contains("hand") && unknown.contains("tool-0"), "{unknown}");
}

#[test]
fn what_a_scene_does_not_need_is_not_written() {
    let size = |scene: &Scene, function| Program::new(scene, &function).unwrap().operations();
    let (chain, weightless) = (scenes::chain(7).unwrap(), {
        let source = scenes::chain(7).unwrap().source().clone();
        source.gravity([0.0; 3]).build().unwrap()
    });
    let (with, without) = (size(&chain, Function::BiasTorque), size(&weightless, Function::BiasTorque));
    assert!(without.flops() < with.flops());
    // One joint about an axis: its inertia is constant.
    let one = scenes::chain(1).unwrap();
    let mass = size(&one, Function::MassMatrix);
    assert_eq!(mass.flops(), 0);
    // M needs the sine and cosine of each angle except the first.
    assert_eq!(size(&chain, Function::MassMatrix).sines, 6);
}

/// Generates C code of these functions, compiles it and runs its test; returns the output.
fn tested(name: &str, (scene, functions): (&Scene, &[Function]), width: Width) -> String {
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".to_owned());
    let directory = std::env::temp_dir().join(format!("phipsi-codegen-{}-{name}", std::process::id()));
    std::fs::create_dir_all(&directory).unwrap();
    for (file, text) in sources(scene, name, functions, (width, true)).unwrap() {
        std::fs::write(directory.join(file), text).unwrap();
    }
    let binary = directory.join("run");
    let built = Command::new(&compiler)
        .args(["-std=c99", "-O0", "-Wall", "-Wextra", "-Werror", "-pedantic"])
        .args([format!("test_{name}.c"), format!("{name}.c")])
        .args(["-lm", "-o"])
        .arg(&binary)
        .current_dir(&directory)
        .output()
        .unwrap();
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    let run = Command::new(&binary).output().unwrap();
    let said = String::from_utf8_lossy(&run.stdout).into_owned();
    assert!(run.status.success(), "{said}");
    std::fs::remove_dir_all(&directory).unwrap();
    said
}

#[test]
fn the_c_code_compiles_and_passes_its_own_test() {
    // In single precision a chain with a well-conditioned mass matrix.
    for (name, scene, width) in
        [("arm", tree(5, 4), Width::Double), ("arm_f", scenes::chain(3).unwrap(), Width::Single)]
    {
        let functions = functions(&scene);
        let results: usize = functions.iter().map(|function| function.results(&scene).len()).sum();
        // One state alone, and eleven in lanes.
        assert_eq!(tested(name, (&scene, &functions), width).lines().count(), 12 * results);
    }
}

#[test]
fn what_legs_repeat_is_a_loop_in_c_that_passes_its_own_test() {
    let (scene, functions) = (quadruped(), [Function::ForwardDynamicsDerivatives]);
    let source = &sources(&scene, "walker", &functions, (Width::Double, true)).unwrap()[0].1;
    // The function for one state, and that for lanes.
    for table in ["walker_forward_dynamics_derivatives_", "    forward_dynamics_derivatives_lanes_"] {
        let loops = source.split("for (int i = ").filter(|part| part.contains(&format!("    {}", table.trim_start())));
        assert!(loops.count() > 4, "{table}");
    }
    for (name, width) in [("walker", Width::Double), ("walker_f", Width::Single)] {
        assert_eq!(tested(name, (&scene, &functions), width).lines().count(), 12 * 3);
    }
}

#[test]
fn names_that_are_none_in_c_are_refused() {
    let scene = scenes::chain(2).unwrap();
    for name in ["", "7dof", "ur-5", "a b", "robot\"; system(\"x"] {
        let error = sources(&scene, name, &Function::of(&scene), (Width::Double, false)).unwrap_err().to_string();
        assert!(error.contains("name"), "{error}");
    }
    let error = sources(&scene, "robot", &[], (Width::Double, false)).unwrap_err().to_string();
    assert!(error.contains("functions"), "{error}");
}

/// A configuration of [`held_chain`].
const BENT: [f64; 6] = [0.3, 0.8, -0.4, 0.6, -0.5, 0.7];

/// A chain whose tip is held where it is in a bent configuration, and two of whose joints are geared.
fn held_chain() -> Scene {
    let mut tip = Connection::new("tip", ConnectionKind::Point, "link5", None);
    tip.frame.lever = [0.0, 0.0, 0.3].into();
    let place = scenes::chain(6).unwrap().placement(&BENT, "link5").unwrap();
    let lever = place.rotate(&tip.frame.lever) + place.lever;
    tip.other_frame = Some(RigidShift { lever, ..RigidShift::identity() });
    let coupling = ConnectionKind::Joint(Polynomial::linear(-0.5, 0.0));
    let gear = Connection::new("gear", coupling, "j2", Some("j1"));
    scenes::chain(6).unwrap().source().clone().connect(tip).connect(gear).build().unwrap()
}

#[test]
fn programs_go_through_connections() {
    let scene = held_chain();
    let (mut workspace, mut scratch) = (scene.workspace(), scene.constraint_scratch());
    for seed in 0..4 {
        let mut random = Random::new(seed);
        let (mut q, mut qd, tau) = (random.array(6, 0.1), random.array(6, 1.0), random.array(6, 5.0));
        q.iter_mut().zip(BENT).for_each(|(q, bent)| *q += bent);
        scene.project(&mut workspace, &mut scratch, &mut q, Some(&mut qd)).unwrap();
        let given = [q, qd, tau, vec![0.0; scene.constraint_rows()]];
        for (function, watched) in [
            (Function::ForwardDynamics, Function::Watched(&Function::ForwardDynamics)),
            (Function::ConstrainedDynamics, Function::Watched(&Function::ConstrainedDynamics)),
        ] {
            let expected = by_method(&scene, &function, &given[..3]);
            for function in [&function, &watched] {
                let program = Program::new(&scene, function).unwrap();
                let found = program.run(&given[..program.arguments.len()].concat()).unwrap();
                let (found, margin) = found.split_at(expected.len());
                let bound = 1e-11 * tolerance::size(&expected);
                tolerance::assert_near(&function.symbol(), found, &expected, bound);
                assert!(margin.iter().all(|margin| *margin >= 0.0), "{margin:?}");
            }
        }
        // A state that violates the connections is reported.
        let mut open = given[0].clone();
        open[0] += 0.01;
        let program = Program::new(&scene, &Function::Watched(&Function::ForwardDynamics)).unwrap();
        let found = program.run(&[&open[..], &given[1], &given[2]].concat()).unwrap();
        assert!(found[6] < 0.0, "{found:?}");
    }
}

#[test]
fn derivatives_through_connections_are_refused_by_name() {
    let scene = held_chain();
    for function in [Function::ForwardDynamicsDerivatives, Function::ForwardDynamicsJvp, Function::ForwardDynamicsVjp] {
        let error = Program::new(&scene, &function).unwrap_err().to_string();
        assert!(error.contains("\"tip\", \"gear\"") && error.contains(function.name()), "{error}");
    }
    let error = Program::new(&scenes::chain(2).unwrap(), &Function::ConstrainedDynamics).unwrap_err().to_string();
    assert!(error.contains("without connections"), "{error}");
    // Neither poses nor inverse dynamics depend on them.
    assert!(Program::new(&scene, &Function::Placement("link2".to_owned())).is_ok());
    assert!(Program::new(&scene, &Function::InverseDynamicsVjp).is_ok());
}

#[test]
fn programs_of_joints_that_follow_others() {
    let mut finger = joint("b", "right");
    finger.mimic = Some(Mimic::of("a"));
    let scene = SceneBuilder::new().link(link("base")).link(link("left")).link(link("right"));
    let scene = scene.joint(joint("a", "left")).joint(finger).mimic_joints(MimicJoints::Coupled).build().unwrap();
    let given: Vec<Vec<f64>> = (1..7).map(|seed| Random::new(seed).array(scene.nv(), 1.0)).collect();
    for function in functions(&scene) {
        let program = Program::new(&scene, &function).unwrap();
        let given = &given[..program.arguments.len()];
        let (found, expected) = (program.run(&given.concat()).unwrap(), by_method(&scene, &function, given));
        tolerance::assert_near(&function.symbol(), &found, &expected, 1e-13 * tolerance::size(&expected).max(1.0));
    }
}
