"""CPU time of the first release build and size of the executable of a small Rust program that depends on phipsi.

Usage: python benches/rust_crate.py [--markdown FILE] [--features "none none/small default ..."]; `make rust-crate`.
Needs cargo.

Each set of features is built in an empty target folder, without the default features unless "default" is in the set.
The program computes the forward dynamics of one state; a second program, built afterwards, measures the time per call.
CPU time is the sum over all processes of the build (user and system time), which depends little on other work of the
machine; elapsed time depends on it.
"""

import argparse
import math
import os
import platform
import resource
import subprocess
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: Sets of features, of which "none" is the empty one, each with a profile after a slash.
SETS = ["none", "none/one-unit", "default", "none/small", "lanes"]
#: Release profiles of the program. One codegen unit avoids optimizing functions twice that several units inline.
PROFILES = {
    "": "",
    "one-unit": "codegen-units = 1",
    "small": 'opt-level = "s"\ncodegen-units = 1\nlto = true\npanic = "abort"',
}
#: The features that add derivatives.
WITH_DERIVATIVES = {"default", "derivatives", "motion", "estimation", "codegen", "report"}

MANIFEST = """[package]
name = "dependent"
version = "0.1.0"
edition = "2024"

[dependencies]
phipsi = {{ path = {root!r}, default-features = false, features = [{features}] }}

[workspace]

[profile.release]
{profile}
"""

PROGRAM = """fn main() -> Result<(), phipsi::Error> {
    let scene = phipsi::scenes::chain(7)?;
    let mut qdd = [f64::NAN; 7];
    scene.forward_dynamics(&mut scene.workspace(), &[0.3; 7], &[0.1; 7], &[1.0; 7], &[], &mut qdd)?;
    println!("{qdd:?}");
    Ok(())
}
"""

TIMED = """use phipsi::{Algorithm, Arguments, Form};
use std::hint::black_box;
use std::time::Instant;

/// The shortest of 20 times of a call, ns.
fn least(calls: usize, mut call: impl FnMut()) -> f64 {
    let once = |_| {
        let start = Instant::now();
        (0..calls).for_each(|_| call());
        start.elapsed().as_secs_f64() * 1e9 / calls as f64
    };
    (0..20).map(once).fold(f64::INFINITY, f64::min)
}

fn main() -> Result<(), phipsi::Error> {
    let scene = phipsi::scenes::chain(7)?;
    let (q, qd, tau) = ([0.3; 7], [0.1; 7], [1.0; 7]);
    let mut workspace = scene.workspace();
    let mut qdd = [f64::NAN; 7];
    let one = least(10_000, || {
        scene.forward_dynamics(&mut workspace, black_box(&q), &qd, &tau, &[], &mut qdd).expect("a state");
    });
    DERIVATIVES
    let states = [Arguments { q: &q, qd: &qd, u: &tau, ..Arguments::default() }; 256];
    let (mut evaluator, mut out) = (scene.evaluator(), [f64::NAN; 7 * 256]);
    let batch = least(100, || {
        let algorithm = Algorithm::ForwardDynamics(Form::Auto);
        scene.evaluate(&mut evaluator, algorithm, black_box(&states), &mut out).expect("states");
    });
    println!("{one} {derivatives} {}", batch / 256.0);
    Ok(())
}
"""


DERIVATIVES = """let mut matrices = [f64::NAN; 147];
    let derivatives = least(2_000, || {
        let out = &mut matrices;
        scene.forward_dynamics_derivatives(&mut workspace, black_box(&q), &qd, &tau, &[], out).expect("a state");
    });"""


def cpu() -> float:
    """User and system time of the finished child processes, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measure(which: str) -> list[str]:
    """The cells of one row."""
    features, _, profile = which.partition("/")
    features = "" if features == "none" else features
    with tempfile.TemporaryDirectory() as folder:
        package = Path(folder)
        (package / "src/bin").mkdir(parents=True)
        listed = ", ".join(f'"{feature}"' for feature in features.split(",") if feature)
        manifest = MANIFEST.format(root=str(ROOT), features=listed, profile=PROFILES[profile]).replace("'", '"')
        (package / "Cargo.toml").write_text(manifest)
        (package / "Cargo.lock").write_bytes((ROOT / "Cargo.lock").read_bytes())
        (package / "src/bin/dependent.rs").write_text(PROGRAM)
        build = ["cargo", "build", "--release", "--quiet"]
        environment = {**os.environ, "CARGO_TARGET_DIR": str(package / "target"), "CARGO_INCREMENTAL": "0"}
        subprocess.run(["cargo", "fetch", "--quiet"], cwd=package, env=environment, check=True)
        before, start = cpu(), time.perf_counter()
        subprocess.run(build, cwd=package, env=environment, check=True)
        seconds, elapsed = cpu() - before, time.perf_counter() - start
        program = package / "target/release/dependent"
        stripped = package / "stripped"
        subprocess.run(["strip", "-o", stripped, program], check=True)
        sizes = [path.stat().st_size / 1e6 for path in (program, stripped)]
        derivatives = DERIVATIVES if WITH_DERIVATIVES & set(features.split(",")) else "let derivatives = f64::NAN;"
        (package / "src/bin/timed.rs").write_text(TIMED.replace("DERIVATIVES", derivatives))
        subprocess.run([*build, "--bin", "timed"], cwd=package, env=environment, check=True)
        timed = subprocess.run([package / "target/release/timed"], capture_output=True, text=True, check=True)
        calls = [float(text) for text in timed.stdout.split()]
        figures = ["-" if math.isnan(figure) else f"{figure:.0f}" for figure in calls]
        return [f"{seconds:.0f}", f"{elapsed:.0f}", *(f"{size:.2f}" for size in sizes), *figures]


def written(rows: list[list[str]]) -> str:
    """The page with these rows."""
    head = ["features/profile", "CPU time of the build, s", "elapsed, s", "executable, MB", "stripped, MB"]
    head += ["one state, ns", "derivatives of one state, ns", "one of 256 states, ns"]
    table = "\n".join("| " + " | ".join(row) + " |" for row in [head, ["---"] + ["---:"] * (len(head) - 1), *rows])
    rustc = subprocess.run(["rustc", "--version"], capture_output=True, text=True, check=True).stdout.strip()
    return f"""# Build time and size of a program that uses the crate

Written by `make rust-crate` (benches/rust_crate.py) with {rustc} on {platform.machine()}: a program that computes the forward dynamics of a chain of seven links, built with `cargo build --release` into an empty target folder, with `default-features = false` except where the set contains `default`. CPU time is the
user and system time of all processes of the build, including the dependencies; the elapsed time is for a machine with {os.cpu_count()} processors that also did other work. "none" has no derivatives; "one-unit" is the release profile with `codegen-units = 1`, and "small" that with `opt-level = "s"`, `codegen-units = 1`, `lto = true` and `panic = "abort"`. The times per call are the shortest of 20, on
one thread, with `Form::Auto`; on a busy machine they are upper bounds.

{table}

[Use as a Rust crate](../rust.md) describes the features.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--markdown", type=Path, help="write the page to this file, anew after each set")
    parser.add_argument("--features", default=" ".join(SETS), help="sets of features, separated by spaces")
    options = parser.parse_args()
    rows = []
    for which in options.features.split():
        rows.append([which, *measure(which)])
        print(*rows[-1], flush=True)
        if options.markdown:
            options.markdown.write_text(written(rows))
    print(written(rows))


if __name__ == "__main__":
    main()
