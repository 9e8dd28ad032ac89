//! Robots as Rust crates and as CUDA kernels: compiled by rustc, and by the C compiler with a loop over threads, and
//! run in comparison with the methods of the scene.

use crate::common::codegen::{by_method, quadruped, tree};
use crate::common::lanes::{State, states};
use crate::common::tolerance;
use phipsi::codegen::{FUNCTIONS, Function, Width, cuda_sources, rust_sources};
use phipsi::{Scene, scenes};
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// A directory for this test with these files.
fn directory(name: &str, files: &[(String, String)]) -> PathBuf {
    let directory = std::env::temp_dir().join(format!("phipsi-languages-{}-{name}", std::process::id()));
    for (file, text) in files {
        let path = directory.join(file);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }
    directory
}

/// Output of a command.
fn run(command: &mut Command) -> String {
    let done = command.output().unwrap();
    let said = String::from_utf8_lossy(&done.stdout).into_owned();
    assert!(done.status.success(), "{command:?}: {said} {}", String::from_utf8_lossy(&done.stderr));
    said
}

fn rustc(directory: &Path) -> Command {
    let mut command = Command::new("rustc");
    command.current_dir(directory).args(["--edition", "2021", "-D", "warnings", "-L", "."]);
    command
}

/// Compiles the library of a crate in its directory, with or without the standard library.
fn library(directory: &Path, name: &str, by_std: bool) {
    let mut command = rustc(directory);
    command.args([
        "--crate-type",
        "rlib",
        "--crate-name",
        name,
        "src/lib.rs",
        "--check-cfg",
        "cfg(feature, values(\"std\"))",
    ]);
    if by_std {
        command.args(["--cfg", "feature=\"std\""]);
    }
    run(&mut command);
}

#[test]
fn rust_crates_pass_their_own_tests() {
    for (name, scene) in [
        ("floating", tree(5, 5)),
        ("fixed", tree(4, 5)),
        ("arm", scenes::chain(7).unwrap()),
        ("one", scenes::chain(1).unwrap()),
    ] {
        let functions = Function::of(&scene);
        let directory = directory(name, &rust_sources(&scene, name, &functions).unwrap());
        library(&directory, name, true);
        run(rustc(&directory).args(["--test", "tests/reference.rs", "-o", "reference", "--extern", name]));
        let said = run(&mut Command::new(directory.join("reference")));
        assert!(said.contains(&format!("{} passed; 0 failed", 2 * functions.len())), "{said}");
        std::fs::remove_dir_all(&directory).unwrap();
    }
}

#[test]
fn what_legs_repeat_is_a_loop_in_rust_and_in_kernels() {
    let (scene, functions) = (quadruped(), [Function::ForwardDynamicsDerivatives]);
    let files = rust_sources(&scene, "walker", &functions).unwrap();
    assert!(files[2].1.contains("    for row in 0..4 {\n        forward_dynamics_derivatives_"));
    let directory = directory("walker", &files);
    library(&directory, "walker", true);
    run(rustc(&directory).args(["--test", "tests/reference.rs", "-o", "reference", "--extern", "walker"]));
    let said = run(&mut Command::new(directory.join("reference")));
    assert!(said.contains("2 passed; 0 failed"), "{said}");
    std::fs::remove_dir_all(&directory).unwrap();

    let files = cuda_sources(&scene, "walker", &functions, Width::Double).unwrap();
    assert!(files[0].1.contains("    for (int i = 0; i < 4; i++)\n        walker_forward_dynamics_derivatives_"));
    assert_eq!(by_the_c_compiler("walker_kernels", "walker", &files).lines().count(), 3);
}

/// A program that reads states and prints the results of each function with this scalar type.
fn program(scene: &Scene, numbers: &str) -> String {
    let mut text = format!("{numbers}{READER}");
    for function in Function::of(scene) {
        let arguments = function.arguments(scene);
        let given = arguments.iter().map(|array| match array.name {
            "q" => "&q",
            "qd" => "&qd",
            _ => "&u",
        });
        let (given, results) = (given.collect::<Vec<_>>().join(", "), function.results(scene));
        let names: Vec<String> = (0..results.len()).map(|index| format!("found{index}")).collect();
        let parts: Vec<String> = names.iter().map(|name| format!("&{name}[..]")).collect();
        let pattern = if names.len() == 1 { names[0].clone() } else { format!("({})", names.join(", ")) };
        let _ = writeln!(text, "        let {pattern} = arm::{}({given});", function.name());
        let _ = writeln!(text, "        write(&[{}].concat());", parts.join(", "));
    }
    text.push_str("    }\n}\n");
    text
}

const READER: &str = "
use arm::{NQ, NV, Number};

fn take<const WIDTH: usize>(numbers: &mut impl Iterator<Item = f64>) -> [T; WIDTH] {
    core::array::from_fn(|_| T::constant(numbers.next().unwrap()))
}

fn write(found: &[T]) {
    let all: Vec<String> = found.iter().map(|&x| format!(\"{:?}\", value(x))).collect();
    println!(\"{}\", all.join(\" \"));
}

fn main() {
    let text = std::io::read_to_string(std::io::stdin()).unwrap();
    let mut numbers = text.split_whitespace().map(|x| x.parse::<f64>().unwrap()).peekable();
    while numbers.peek().is_some() {
        let (q, qd, u) = (take::<NQ>(&mut numbers), take::<NV>(&mut numbers), take::<NV>(&mut numbers));
";

const PLAIN: &str = "type T = NUMBER;\nfn value(x: T) -> f64 { x as f64 }\n";

/// A scalar type without numbers.rs of the standard library.
const OWN: &str = "
use core::ops::{Add, Div, Mul, Neg, Sub};

#[derive(Clone, Copy)]
struct T(f64);

fn value(x: T) -> f64 { x.0 }

impl Add for T { type Output = T; fn add(self, b: T) -> T { T(self.0 + b.0) } }
impl Sub for T { type Output = T; fn sub(self, b: T) -> T { T(self.0 - b.0) } }
impl Mul for T { type Output = T; fn mul(self, b: T) -> T { T(self.0 * b.0) } }
impl Div for T { type Output = T; fn div(self, b: T) -> T { T(self.0 / b.0) } }
impl Neg for T { type Output = T; fn neg(self) -> T { T(-self.0) } }

impl Number for T {
    fn constant(x: f64) -> T { T(x) }
    fn sqrt(self) -> T { T(self.0.sqrt()) }
    fn sin_cos(self) -> (T, T) { (T(self.0.sin()), T(self.0.cos())) }
    fn abs(self) -> T { T(self.0.abs()) }
    fn smaller(self, other: T) -> T { T(self.0.min(other.0)) }
    fn one_if_zero(self) -> T { T(if self.0 == 0.0 { 1.0 } else { 0.0 }) }
}
";

/// A state as the arguments of a function: all except q and qd are torques.
fn given(scene: &Scene, function: &Function, (q, qd, u): &State) -> Vec<Vec<f64>> {
    let all = [q, qd, u, u, u, u].map(Clone::clone);
    all[..function.arguments(scene).len()].to_vec()
}

/// Writes a program for the library of `arm`, runs it with states, and compares.
fn compare(directory: &Path, scene: &Scene, (text, is_single): (&str, bool)) {
    std::fs::write(directory.join("main.rs"), text).unwrap();
    run(rustc(directory).args(["main.rs", "-o", "main", "--extern", "arm"]));
    let all = states(scene, 4);
    let mut child = Command::new(directory.join("main")).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let numbers = all.iter().flat_map(|(q, qd, u)| [q, qd, u]).flatten();
    let numbers: Vec<String> = numbers.map(|x| format!("{x:?}")).collect();
    child.stdin.take().unwrap().write_all(numbers.join(" ").as_bytes()).unwrap();
    let said = String::from_utf8(child.wait_with_output().unwrap().stdout).unwrap();
    let mut lines = said.lines();
    for state in &all {
        let mut mass = vec![f64::NAN; scene.nv() * scene.nv()];
        scene.mass_matrix(&mut scene.workspace(), &state.0, &mut mass).unwrap();
        let cond = tolerance::conditioning(scene.nv(), &mass).number;
        // A bias torque near zero by chance is compared with the torques of the same motion.
        let moving = tolerance::size(&by_method(
            scene,
            &Function::InverseDynamics,
            &given(scene, &Function::InverseDynamics, state),
        ));
        for function in Function::of(scene) {
            let expected = by_method(scene, &function, &given(scene, &function, state));
            let found: Vec<f64> = lines.next().unwrap().split(' ').map(|x| x.parse().unwrap()).collect();
            let is_bias = function == Function::BiasTorque;
            let size = tolerance::size(&expected).max(if is_bias { moving } else { 0.0 });
            let bound = 64.0 * f64::EPSILON * size * (cond + 16.0);
            let bound = if is_single { tolerance::single(bound) } else { bound };
            tolerance::assert_near(function.name(), &found, &expected, bound);
        }
    }
    assert_eq!(lines.next(), None);
}

#[test]
fn rust_gives_what_the_methods_give_in_numbers_of_any_kind() {
    for seed in [4, 5] {
        let scene = tree(seed, 5);
        let directory =
            directory(&format!("numbers{seed}"), &rust_sources(&scene, "arm", &Function::of(&scene)).unwrap());
        library(&directory, "arm", true);
        compare(&directory, &scene, (&program(&scene, &PLAIN.replace("NUMBER", "f64")), false));
        compare(&directory, &scene, (&program(&scene, &PLAIN.replace("NUMBER", "f32")), true));
        library(&directory, "arm", false);
        compare(&directory, &scene, (&program(&scene, OWN), false));
        std::fs::remove_dir_all(&directory).unwrap();
    }
}

/// Sine and cosine of lanes compared with f64: small and large angles, and non-finite values.
const SINES: &str = "
use arm::{Lanes, Number};

fn main() {
    let mut worst = [0.0_f64; 2];
    for i in -400_000..400_000 {
        // Multiples of a quarter turn too, and angles beyond the range of the reduction.
        let x = [0.02 * f64::from(i), f64::from(i) * core::f64::consts::FRAC_PI_2, 3.3 * f64::from(i), f64::from(i) * 1e-9];
        let (s, c) = Lanes(x).sin_cos();
        let single = x.map(|x| x as f32);
        let (t, d) = Lanes(single).sin_cos();
        for k in 0..4 {
            let of_single = f64::from(single[k]);
            for (found, expected) in [(s.0[k], x[k].sin()), (c.0[k], x[k].cos())] {
                worst[0] = worst[0].max((found - expected).abs() / expected.abs());
            }
            for (found, expected) in [(t.0[k], of_single.sin()), (d.0[k], of_single.cos())] {
                worst[1] = worst[1].max((f64::from(found) - expected).abs());
            }
        }
    }
    let (s, c) = Lanes([f64::NAN, f64::INFINITY, -0.0, 0.0]).sin_cos();
    assert!(s.0[0].is_nan() && c.0[0].is_nan() && s.0[1].is_nan() && c.0[1].is_nan());
    assert!(s.0[2] == 0.0 && c.0[3] == 1.0);
    println!(\"{:?} {:?}\", worst[0], worst[1]);
}
";

#[test]
fn sines_in_lanes_are_those_of_one_number() {
    let files = rust_sources(&scenes::chain(2).unwrap(), "arm", &[Function::MassMatrix]).unwrap();
    let directory = directory("sines", &files);
    library(&directory, "arm", true);
    std::fs::write(directory.join("main.rs"), SINES).unwrap();
    run(rustc(&directory).args(["-O", "main.rs", "-o", "main", "--extern", "arm"]));
    let said = run(&mut Command::new(directory.join("main")));
    let worst: Vec<f64> = said.split_whitespace().map(|x| x.parse().unwrap()).collect();
    // Units in the last place: for each value in f64, for one in f32.
    assert!(worst[0] < 2.0 * f64::EPSILON && worst[1] < f64::from(f32::EPSILON), "{said}");
    std::fs::remove_dir_all(&directory).unwrap();
}

/// Compiles the test of kernels as C in a directory with this name, and runs it; returns the output.
fn by_the_c_compiler(at: &str, name: &str, files: &[(String, String)]) -> String {
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".to_owned());
    let directory = directory(at, files);
    run(Command::new(&compiler)
        .args(["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic", "-x", "c"])
        .args([&format!("test_{name}.cu"), "-lm", "-o", "run"])
        .current_dir(&directory));
    let said = run(&mut Command::new(directory.join("run")));
    std::fs::remove_dir_all(&directory).unwrap();
    said
}

#[test]
fn kernels_as_c_pass_their_own_test() {
    for (name, width) in [("double", Width::Double), ("single", Width::Single)] {
        // In single precision a chain with a well-conditioned mass matrix.
        let scene = if width == Width::Double { tree(5, 5) } else { scenes::chain(3).unwrap() };
        let functions = Function::of(&scene);
        let said = by_the_c_compiler(name, name, &cuda_sources(&scene, name, &functions, width).unwrap());
        let results: usize = functions.iter().map(|function| function.results(&scene).len()).sum();
        assert_eq!(said.lines().count(), results, "{said}");
    }
}

#[test]
fn kernels_are_one_a_function_and_include_nothing() {
    let files = cuda_sources(&scenes::chain(3).unwrap(), "tail", &[Function::MassMatrix], Width::Single).unwrap();
    let source = &files[0].1;
    assert_eq!((files[0].0.as_str(), source.matches("__global__").count()), ("tail.cu", 1));
    assert!(!source.contains("#include") && !source.contains("double") && source.contains("[0 * count + state] ="));
}

#[test]
fn names_that_no_crate_can_have_are_refused() {
    let scene = scenes::chain(2).unwrap();
    for name in ["", "7dof", "ur-5", "fn", "core", "self", "_"] {
        let error = rust_sources(&scene, name, FUNCTIONS).unwrap_err().to_string();
        assert!(error.contains("name"), "{error}");
    }
    for name in ["", "7dof", "ur-5"] {
        let error = cuda_sources(&scene, name, FUNCTIONS, Width::Double).unwrap_err().to_string();
        assert!(error.contains("name"), "{error}");
    }
    assert!(rust_sources(&scene, "arm", &[]).unwrap_err().to_string().contains("functions"));
    assert!(cuda_sources(&scene, "arm", &[], Width::Double).unwrap_err().to_string().contains("functions"));
}
