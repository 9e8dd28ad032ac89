//! The algorithms in a loop, so that callgrind can count instructions: `make instructions`, see
//! benches/instructions/count.py.
//!
//! `instructions count <scene> <algorithm> <states> <repeats>` evaluates that many states per call, with the
//! instruction set of `PHIPSI_INSTRUCTION_SET`. Without `count` (as `cargo bench` starts it) it does nothing. The scene
//! is one of tests/common/gate.rs, or a model of `make peers`.

mod common;
#[path = "../tests/common/gate.rs"]
mod gate;

use common::{arguments, model, states};
use gate::{ALGORITHMS, SCENES};
use phipsi::batch::InstructionSet;
use phipsi::{Algorithm, Scene};
use std::hint::black_box;

fn run(scene: &Scene, algorithm: Algorithm, count: usize, repeats: usize) {
    let mut evaluator = scene.evaluator();
    let kept = states(scene);
    let states: Vec<_> = kept.iter().take(count).map(|state| arguments(algorithm, state)).collect();
    let mut out = vec![0.0; scene.width(algorithm) * count];
    for _ in 0..repeats {
        scene.evaluate(&mut evaluator, algorithm, black_box(&states), black_box(&mut out)).expect("states");
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match &arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        // All cases, one per line.
        ["list"] => {
            for scene in SCENES {
                for (name, _) in ALGORITHMS {
                    println!("{scene} {name}");
                }
            }
        }
        ["count", scene, algorithm, states, repeats] => {
            let number = |text: &str| text.parse().unwrap_or_else(|_| panic!("not a number: {text}"));
            let (_, found) =
                *ALGORITHMS.iter().find(|(name, _)| name == algorithm).unwrap_or_else(|| panic!("no {algorithm}"));
            // Otherwise another instruction set than the requested one would be counted.
            let (wanted, arm) =
                (std::env::var("PHIPSI_INSTRUCTION_SET").unwrap_or_default(), InstructionSet::of_process().name());
            assert!(wanted == arm, "PHIPSI_INSTRUCTION_SET is {wanted:?}, this processor runs {arm:?}");
            let found_scene = gate::scene(scene).or_else(|| model(scene));
            run(&found_scene.unwrap_or_else(|| panic!("no scene {scene}")), found, number(states), number(repeats));
        }
        _ => eprintln!("instructions: counted by `make instructions`, nothing to do here"),
    }
}
