//! Golden outputs: stored results of every algorithm with every instruction set.
//!
//! Oracles detect errors; this test detects *changes*. `PHIPSI_GOLDEN=bits` requires bitwise equality (for changes
//! that only move code),
//! `PHIPSI_GOLDEN=write` stores the results. Without either, rounding differences pass, and instruction sets without
//! results are skipped.

use crate::common::gate::{ALGORITHMS, SCENES, scene};
use crate::common::lanes::{arguments, arms, on_a_large_stack, states};
use crate::common::tolerance::{assert_near, size};
use phipsi::Algorithm;
use phipsi::batch::Evaluator;
use phipsi::batch::InstructionSet;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

/// Largest difference of the results of one state relative to the largest: M of these scenes has a condition number
/// below 1e4.
const ROUNDING: f64 = 1e-11;

/// Number of states of a scene; the first one also runs alone.
const COUNT: u64 = 3;

fn file() -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "tests", "data", "golden.txt"].iter().collect()
}

/// Some values of a result, and a hash of its bits (FNV-1a). For a matrix, its product with irregular values, which
/// depends on every entry.
fn condensed(algorithm: Algorithm, nv: usize, result: &[f64]) -> (u64, Vec<f64>) {
    // The sign of a zero is undefined.
    let hash = result
        .iter()
        .fold(0xcbf2_9ce4_8422_2325_u64, |hash, &x| (hash ^ (x + 0.0).to_bits()).wrapping_mul(0x0000_0100_0000_01b3));
    let numbers = match algorithm {
        Algorithm::MassMatrix
        | Algorithm::MassMatrixInverse(_)
        | Algorithm::Derivatives(_)
        | Algorithm::Products(_) => {
            let weights = (0_u32..).map(|i| (1.0 + 2.3 * f64::from(i)).cos());
            let product = |row: &[f64]| row.iter().zip(weights.clone()).map(|(m, w)| m * w).sum();
            result.chunks(nv).map(product).collect()
        }
        _ => result.to_vec(),
    };
    (hash, numbers)
}

/// Results of an instruction set, by "arm scene algorithm state".
fn found(arm: InstructionSet) -> BTreeMap<String, (u64, Vec<f64>)> {
    let mut all = BTreeMap::new();
    for name in SCENES {
        let scene = scene(name).expect("a scene");
        let mut evaluator = Evaluator::on(arm, &scene);
        let states = states(&scene, COUNT);
        for (algorithm_name, algorithm) in ALGORITHMS {
            let width = scene.width(algorithm);
            let given: Vec<_> = states.iter().map(|state| arguments(algorithm, state, &[])).collect();
            let (mut one, mut many) = (vec![f64::NAN; width], vec![f64::NAN; width * given.len()]);
            scene.evaluate(&mut evaluator, algorithm, &given[..1], &mut one).expect("a state");
            scene.evaluate(&mut evaluator, algorithm, &given, &mut many).expect("states");
            for (which, result) in std::iter::once(&one[..]).chain(many.chunks(width)).enumerate() {
                let key = format!("{} {name} {algorithm_name} {which}", arm.name());
                all.insert(key, condensed(algorithm, scene.nv(), result));
            }
        }
    }
    all
}

fn stored() -> BTreeMap<String, (u64, Vec<f64>)> {
    let text = std::fs::read_to_string(file()).expect("tests/data/golden.txt");
    let line = |line: &str| {
        let words: Vec<&str> = line.split(' ').collect();
        let hash = u64::from_str_radix(words[4], 16).expect("a hash");
        let numbers = words[5..].iter().map(|x| x.parse().expect("a number")).collect();
        (words[..4].join(" "), (hash, numbers))
    };
    text.lines().map(line).collect()
}

fn write(all: &BTreeMap<String, (u64, Vec<f64>)>) {
    let mut text = String::new();
    for (key, (hash, numbers)) in all {
        write!(text, "{key} {hash:016x}").unwrap();
        for x in numbers {
            write!(text, " {x:e}").unwrap();
        }
        text.push('\n');
    }
    std::fs::write(file(), text).unwrap();
}

#[test]
fn every_algorithm_gives_what_it_gave() {
    on_a_large_stack(|| {
        let mode = std::env::var("PHIPSI_GOLDEN").unwrap_or_default();
        let found: BTreeMap<_, _> = arms().flat_map(found).collect();
        if mode == "write" {
            return write(&found);
        }
        let stored = stored();
        let mut compared = 0;
        for (key, (hash, numbers)) in &found {
            let Some((expected_hash, expected)) = stored.get(key) else { continue };
            assert!(mode != "bits" || hash == expected_hash, "{key}: other bits");
            assert_near(key, numbers, expected, ROUNDING * size(expected));
            compared += 1;
        }
        // The baseline uses splat.
        assert!(compared >= SCENES.len() * ALGORITHMS.len() * (usize::try_from(COUNT).unwrap() + 1));
    });
}
