//! Programs of single robots beside the scene's methods; their C compiled by the system's compiler and run.

mod common;

use common::codegen::{by_method, tree};
use common::lanes::states;
use common::tolerance;
use phipsi::codegen::{FUNCTIONS, Function, Program, Width, sources};
use phipsi::scene::{Connection, ConnectionKind};
use phipsi::{Scene, scenes};
use std::process::Command;

#[test]
fn programs_compute_what_the_methods_do() {
    let mut all: Vec<Scene> = (0..6).map(tree).collect();
    all.push(scenes::chain(7).unwrap());
    all.push(scenes::chain(1).unwrap());
    for (index, scene) in all.iter().enumerate() {
        for function in FUNCTIONS {
            let program = Program::new(scene, function).unwrap();
            for state in states(scene, 3) {
                let expected = by_method(scene, function, &state);
                let (q, qd, u) = &state;
                let parts = [&q[..], &qd[..], &u[..]];
                let found = program.run(&parts[..function.arguments().len()].concat()).unwrap();
                let mut mass = vec![f64::NAN; scene.nv() * scene.nv()];
                scene.mass_matrix(&mut scene.workspace(), q, &mut mass).unwrap();
                let cond = tolerance::conditioning(scene.nv(), &mass).number;
                let bound = 64.0 * f64::EPSILON * tolerance::size(&expected) * (cond + 16.0);
                tolerance::assert_near(&format!("{index} {}", function.name()), &found, &expected, bound);
            }
        }
    }
}

#[test]
fn what_a_scene_does_not_need_is_not_written() {
    let size = |scene: &Scene, function| Program::new(scene, function).unwrap().size();
    let (chain, weightless) = (scenes::chain(7).unwrap(), {
        let source = scenes::chain(7).unwrap().source().clone();
        source.gravity([0.0; 3]).build().unwrap()
    });
    let (with, without) = (size(&chain, Function::BiasTorque), size(&weightless, Function::BiasTorque));
    assert!(without.sums + without.fused + without.products < with.sums + with.fused + with.products);
    // One joint about an axis: its inertia is a constant.
    let one = scenes::chain(1).unwrap();
    let mass = size(&one, Function::MassMatrix);
    assert_eq!((mass.sums, mass.products, mass.fused, mass.sines), (0, 0, 0, 0));
    // M needs the sine and the cosine of each angle but the first.
    assert_eq!(size(&chain, Function::MassMatrix).sines, 12);
}

#[test]
fn the_c_code_compiles_and_passes_its_own_test() {
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".to_owned());
    for (name, width) in [("arm", Width::Double), ("arm_f", Width::Single)] {
        let directory = std::env::temp_dir().join(format!("phipsi-codegen-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&directory).unwrap();
        // In single precision a chain, whose mass matrix is tame.
        let scene = match width {
            Width::Double => tree(5),
            Width::Single => scenes::chain(3).unwrap(),
        };
        for (file, text) in sources(&scene, name, &FUNCTIONS, (width, true)).unwrap() {
            std::fs::write(directory.join(file), text).unwrap();
        }
        let binary = directory.join("run");
        let built = Command::new(&compiler)
            .args(["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic"])
            .args([format!("test_{name}.c"), format!("{name}.c")])
            .args(["-lm", "-o"])
            .arg(&binary)
            .current_dir(&directory)
            .output()
            .unwrap();
        assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
        // One state by itself, and eleven in lanes.
        let run = Command::new(&binary).output().unwrap();
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stdout));
        assert_eq!(String::from_utf8_lossy(&run.stdout).lines().count(), 12 * FUNCTIONS.len());
        std::fs::remove_dir_all(&directory).unwrap();
    }
}

#[test]
fn names_that_are_none_in_c_are_refused() {
    let scene = scenes::chain(2).unwrap();
    for name in ["", "7dof", "ur-5", "a b", "robot\"; system(\"x"] {
        let error = sources(&scene, name, &FUNCTIONS, (Width::Double, false)).unwrap_err().to_string();
        assert!(error.contains("name"), "{error}");
    }
    let error = sources(&scene, "robot", &[], (Width::Double, false)).unwrap_err().to_string();
    assert!(error.contains("functions"), "{error}");
}

#[test]
fn scenes_with_connections_are_refused_by_name() {
    let mut tip = Connection::new("tip", ConnectionKind::Point, "link2", None);
    tip.frame.lever = [0.0, 0.0, 0.3].into();
    let scene = scenes::chain(3).unwrap().source().clone().connect(tip).build().unwrap();
    let error = Program::new(&scene, Function::ForwardDynamics).unwrap_err().to_string();
    assert!(error.contains("tip"), "{error}");
}
