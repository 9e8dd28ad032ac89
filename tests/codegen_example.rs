//! The crate in `examples/build_script`: its build script generates the code of a robot, and its program, compiled by
//! rustc, includes and runs it.

#![cfg(feature = "urdf")]

#[allow(dead_code)] // its main, which Cargo runs
#[path = "../examples/build_script/build.rs"]
mod build;

use std::path::Path;
use std::process::Command;

#[test]
fn a_program_includes_what_its_build_script_wrote() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let directory = std::env::temp_dir().join(format!("phipsi-build-script-{}", std::process::id()));
    build::generate(&root.join("assets/puma560.urdf"), &directory).unwrap();
    let program = directory.join("program");
    let built = Command::new("rustc")
        .args(["--edition", "2021", "-D", "warnings", "-o"])
        .args([&program, &root.join("examples/build_script/src/main.rs")])
        .env("OUT_DIR", &directory)
        .output()
        .unwrap();
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    let run = Command::new(&program).output().unwrap();
    let said = String::from_utf8_lossy(&run.stdout);
    assert!(run.status.success() && said.lines().count() == 2, "{said} {}", String::from_utf8_lossy(&run.stderr));
    std::fs::remove_dir_all(&directory).unwrap();
}

#[test]
fn a_robot_that_is_not_there_is_told() {
    let error = build::generate(Path::new("no-such-robot.urdf"), &std::env::temp_dir()).unwrap_err().to_string();
    assert!(error.contains("no-such-robot.urdf"), "{error}");
}
