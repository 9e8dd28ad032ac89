//! What the benches share: states, and the robots of `make peers`.
#![allow(dead_code)] // each bench uses its own part

use phipsi::Scene;
use phipsi::batch::chunk::{Algorithm, Arguments};

const STATES: usize = 256;

/// States of a batch.
pub const BATCH: usize = 4096;

/// (q, qd, tau) of one state.
pub type State = [Vec<f64>; 3];

/// Random states of a scene: velocities and torques in -1 to 1, configurations that far from the neutral one.
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

/// The arguments that an algorithm reads of a state.
pub fn arguments(algorithm: Algorithm, [q, qd, u]: &State) -> Arguments<'_> {
    match algorithm {
        Algorithm::ForwardDynamics(_) | Algorithm::InverseDynamics => Arguments { q, qd, u, wrenches: &[] },
        Algorithm::BiasTorque => Arguments { q, qd, ..Arguments::default() },
        Algorithm::MassMatrix | Algorithm::MassMatrixInverse(_) => Arguments { q, ..Arguments::default() },
    }
}

/// A robot of `make peers`, on the base that the peers give it; none, and a word about it, where its file is not there.
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

/// Without URDF there is none.
#[cfg(not(feature = "urdf"))]
pub fn robot(_: &str, _: bool) -> Option<Scene> {
    None
}
