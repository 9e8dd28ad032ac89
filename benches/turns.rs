//! Time of an algorithm on request of benches/peers/compare.py, which interleaves it with Pinocchio's harness.
//!
//! `turns serve` prints a line of JSON with the instruction set of this process and all those of the processor. Then
//! it reads lines `GROUP MODEL SECONDS`, measures for about that long, and answers each with a line: nanoseconds per
//! state. Without `serve` (as `cargo bench` starts it) it does nothing.
//!
//! A group is an algorithm of [`ALGORITHMS`], with `_batch` for batches of 4096 states (256 for derivatives). It may
//! be followed by a form other than covariance, an instruction set other than that of the process, and a kind of
//! states other than random ones: `forward_dynamics/square-root`, `forward_dynamics_batch/avx2`,
//! `forward_dynamics/auto/held`. All use [`Scene::evaluate`], with the checks of every argument and result.

mod common;

use common::{ALGORITHMS, KINDS, Kind, State, arguments, batch_of, median_ns, model, states, states_of};
use phipsi::batch::Evaluator;
use phipsi::batch::{INSTRUCTION_SETS, InstructionSet};
use phipsi::filter::FORMS;
use phipsi::{Algorithm, Derivatives, Scene};
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::hint::black_box;
use std::process::ExitCode;

/// Meaning of a group.
struct Group {
    algorithm: Algorithm,
    batch: bool,
    arm: InstructionSet,
    /// None: random states.
    kind: Option<Kind>,
}

fn named<T: Copy>(table: &[(&str, T)], name: &str) -> Option<T> {
    table.iter().find(|(known, _)| *known == name).map(|&(_, value)| value)
}

impl Group {
    fn new(text: &str) -> Result<Self, String> {
        let mut parts = text.split('/');
        let first = parts.next().unwrap_or_default();
        let (name, batch) = first.strip_suffix("_batch").map_or((first, false), |name| (name, true));
        let algorithm = named(&ALGORITHMS, name).ok_or_else(|| format!("no algorithm {name:?}"))?;
        let mut group = Self { algorithm, batch, arm: InstructionSet::of_process(), kind: None };
        for part in parts {
            if let Some(form) = named(FORMS, part) {
                group.algorithm = match algorithm {
                    Algorithm::ForwardDynamics(_) => Algorithm::ForwardDynamics(form),
                    Algorithm::MassMatrixInverse(_) => Algorithm::MassMatrixInverse(form),
                    Algorithm::Derivatives(Derivatives::ForwardDynamics(_)) => {
                        Algorithm::Derivatives(Derivatives::ForwardDynamics(form))
                    }
                    _ => return Err(format!("{name} has no forms, so no {part:?}")),
                };
            } else if let Some(kind) = named(&KINDS, part) {
                group.kind = Some(kind);
            } else {
                // Otherwise another instruction set than the requested one would be measured.
                let arm = named(INSTRUCTION_SETS, part).filter(|arm| arm.available());
                group.arm =
                    arm.ok_or_else(|| format!("{part:?} is no form, no kind of states, and no arm of this processor"))?;
            }
        }
        Ok(group)
    }
}

/// A scene with everything for its evaluation, created on the first request.
struct Kept {
    scene: Scene,
    /// By kind; random states always exist.
    states: HashMap<Option<Kind>, Vec<State>>,
    evaluators: HashMap<InstructionSet, Evaluator>,
}

impl Kept {
    fn new(name: &str) -> Result<Self, String> {
        let scene = model(name).ok_or_else(|| format!("no model {name:?}"))?;
        Ok(Self { states: HashMap::from([(None, states(&scene))]), scene, evaluators: HashMap::new() })
    }

    /// Nanoseconds per state; `out` is reused for results, because a batch for every scene would exceed the memory.
    fn measure(&mut self, group: &Group, seconds: f64, out: &mut Vec<f64>) -> f64 {
        let Self { scene, states, evaluators } = self;
        let &Group { algorithm, batch, arm, kind } = group;
        if let (Some(wanted), false) = (kind, states.contains_key(&kind)) {
            let of_kind = states_of(wanted, scene, &states[&None]);
            states.insert(kind, of_kind);
        }
        let states = &states[&kind];
        let evaluator = evaluators.entry(arm).or_insert_with(|| Evaluator::on(arm, scene));
        let a_call = if batch { batch_of(algorithm) } else { 1 };
        let count = states.len().max(a_call);
        let states: Vec<_> = states.iter().map(|state| arguments(algorithm, state)).cycle().take(count).collect();
        let width = scene.width(algorithm) * a_call;
        out.resize(width.max(out.len()), 0.0);
        let out = &mut out[..width];
        median_ns(seconds, count, || {
            for states in states.chunks(a_call) {
                scene.evaluate(evaluator, algorithm, black_box(states), black_box(&mut *out)).expect("states");
            }
        })
    }
}

fn answer(models: &mut HashMap<String, Kept>, out: &mut Vec<f64>, line: &str) -> Result<f64, String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let [group, name, seconds] = words[..] else { return Err("expected GROUP MODEL SECONDS".to_owned()) };
    let group = Group::new(group)?;
    let seconds = seconds.parse().ok().filter(|&seconds| seconds >= 0.0).ok_or("not a time in seconds")?;
    let kept = match models.entry(name.to_owned()) {
        Entry::Occupied(found) => found.into_mut(),
        Entry::Vacant(place) => place.insert(Kept::new(name)?),
    };
    Ok(kept.measure(&group, seconds, out))
}

fn main() -> ExitCode {
    if std::env::args().nth(1).is_none_or(|first| first != "serve") {
        eprintln!("turns: asked by benches/peers/compare.py, nothing to do here");
        return ExitCode::SUCCESS;
    }
    let arms: Vec<_> =
        INSTRUCTION_SETS.iter().filter(|(_, arm)| arm.available()).map(|(name, _)| format!("\"{name}\"")).collect();
    println!("{{\"arm\": \"{}\", \"arms\": [{}]}}", InstructionSet::of_process().name(), arms.join(", "));
    let (mut models, mut out) = (HashMap::new(), Vec::new());
    for line in std::io::stdin().lines().map_while(Result::ok) {
        match answer(&mut models, &mut out, &line) {
            Ok(ns) => println!("{ns:.2}"),
            Err(error) => {
                eprintln!("turns: {error}; asked: {line}");
                return ExitCode::FAILURE;
            }
        }
    }
    ExitCode::SUCCESS
}
