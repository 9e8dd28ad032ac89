//! Common parts of the benches: algorithms, models (chains, and the robots of `make peers`), states, and timing.
#![allow(dead_code)] // each bench uses its own part

use phipsi::{Algorithm, Arguments, Derivatives, Form, Scene, scenes};
use std::time::{Duration, Instant};

/// Algorithms that the peers have too, in the form that they use.
pub const ALGORITHMS: [(&str, Algorithm); 6] = [
    ("forward_dynamics", Algorithm::ForwardDynamics(Form::Covariance)),
    ("inverse_dynamics", Algorithm::InverseDynamics),
    ("mass_matrix", Algorithm::MassMatrix),
    ("mass_matrix_inverse", Algorithm::MassMatrixInverse(Form::Covariance)),
    ("inverse_dynamics_derivatives", Algorithm::Derivatives(Derivatives::InverseDynamics)),
    ("forward_dynamics_derivatives", Algorithm::Derivatives(Derivatives::ForwardDynamics(Form::Covariance))),
];

/// Numbers of bodies of the chains, as for the peers.
pub const CHAINS: [usize; 4] = [7, 16, 30, 64];

/// Robots of `make peers`, and whether they have a floating base.
pub const ROBOTS: [(&str, bool); 5] =
    [("ur5", false), ("panda", false), ("anymal", true), ("g1", true), ("talos", true)];

const STATES: usize = 256;

/// States of a batch; fewer for derivatives, with three matrices each, because more would measure the memory
/// bandwidth.
pub fn batch_of(algorithm: Algorithm) -> usize {
    if matches!(algorithm, Algorithm::Derivatives(_)) { 256 } else { 4096 }
}

/// (q, qd, tau) of one state.
pub type State = [Vec<f64>; 3];

/// Random states of a scene: velocities and torques in -1 to 1, configurations displaced by that much from the
/// neutral one.
pub fn states(scene: &Scene) -> Vec<State> {
    let mut seed = 0x1234_5678_9abc_def0_u64;
    let mut draw = |n: usize| -> Vec<f64> {
        (0..n)
            .map(|_| {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                #[allow(clippy::cast_precision_loss)] // 53 bits
                let unit = (seed >> 11) as f64 / (1u64 << 53) as f64;
                2.0 * unit - 1.0
            })
            .collect()
    };
    (0..STATES)
        .map(|_| {
            let mut q = scene.neutral();
            scene.integrate(&scene.neutral(), &draw(scene.nv()), &mut q).expect("a configuration");
            [q, draw(scene.nv()), draw(scene.nv())]
        })
        .collect()
}

/// A kind of states other than random ones; python/phipsi/report/kinds.py defines them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Static equilibrium: zero velocities, the torques of the bias.
    Held,
    /// Passive, at rest: zero velocities and torques.
    AtRest,
    /// Passive, in motion: zero torques.
    Falling,
}

/// Every kind by its name, with a hyphen for a space.
pub const KINDS: [(&str, Kind); 3] = [("held", Kind::Held), ("at-rest", Kind::AtRest), ("falling", Kind::Falling)];

/// States of a kind, with the configurations and velocities of random ones.
pub fn states_of(kind: Kind, scene: &Scene, states: &[State]) -> Vec<State> {
    let zero = || vec![0.0; scene.nv()];
    let mut workspace = scene.workspace();
    let of = |[q, qd, _]: &State| -> State {
        let (qd, mut tau) = (if kind == Kind::Falling { qd.clone() } else { zero() }, zero());
        if kind == Kind::Held {
            scene.bias_torque(&mut workspace, q, &qd, &mut tau).expect("a torque");
        }
        [q.clone(), qd, tau]
    };
    states.iter().map(of).collect()
}

/// The arguments of an algorithm for one state.
pub fn arguments(algorithm: Algorithm, [q, qd, u]: &State) -> Arguments<'_> {
    Arguments { q, qd, u, wrenches: &[], seed: [qd, u, qd], ..Arguments::default() }.read_by(algorithm)
}

/// A robot of `make peers`, with the base of the peers; `None`, with a message, if its file does not exist.
#[cfg(feature = "urdf")]
pub fn robot(name: &str, floating: bool) -> Option<Scene> {
    let path = format!("{}/target/peers/models/{name}.urdf", env!("CARGO_MANIFEST_DIR"));
    if !std::path::Path::new(&path).exists() {
        eprintln!("{name}: no {path}; `make peers` writes it");
        return None;
    }
    let builder = phipsi::SceneBuilder::from_urdf_file(&path).expect("a robot").floating_base(floating);
    Some(builder.build().expect("a robot"))
}

/// Not available without URDF.
#[cfg(not(feature = "urdf"))]
pub fn robot(_: &str, _: bool) -> Option<Scene> {
    None
}

/// A chain of [`CHAINS`], as `chain_7`, or one of [`ROBOTS`]; `None` if it is neither, or its file does not exist.
pub fn model(name: &str) -> Option<Scene> {
    if let Some(&bodies) = CHAINS.iter().find(|bodies| format!("chain_{bodies}") == name) {
        return Some(scenes::chain(bodies).expect("a chain"));
    }
    ROBOTS.iter().find(|(known, _)| *known == name).and_then(|(_, floating)| robot(name, *floating))
}

/// Duration of the shortest repetition, so that the cost of the clock is negligible.
const REPEAT: Duration = Duration::from_micros(200);

/// Median nanoseconds per state of `cycle`, which processes that many states: after a warm-up, repetitions of whole
/// cycles fill `seconds`, as in `benches/peers/pinocchio_bench.cpp`.
#[allow(clippy::cast_precision_loss)] // counts
pub fn median_ns(seconds: f64, states: usize, mut cycle: impl FnMut()) -> f64 {
    cycle();
    let (began, mut repeats) = (Instant::now(), Vec::new());
    while repeats.is_empty() || began.elapsed().as_secs_f64() < seconds {
        let (start, mut cycles) = (Instant::now(), 0);
        let elapsed = loop {
            cycle();
            cycles += 1;
            let elapsed = start.elapsed();
            if elapsed >= REPEAT {
                break elapsed;
            }
        };
        repeats.push(elapsed.as_secs_f64() * 1e9 / (cycles * states) as f64);
    }
    repeats.sort_by(f64::total_cmp);
    repeats[repeats.len() / 2]
}
