//! One scene, many threads: bitwise equal to one thread alone.

use crate::common::{ALL_KINDS, Random, Tree, random_state};
use phipsi::operators::Factor;
use phipsi::scene::{Model, SceneBuilder};
use phipsi::{Error, Scene, Workspace};

const THREADS: u64 = 4;
const STATES: u64 = 24;

/// Checked by the compiler.
const fn shared_between_threads<T: Send + Sync + 'static>() {}
const _: () = shared_between_threads::<Scene>();
const _: () = shared_between_threads::<Model<f64>>();
const _: () = shared_between_threads::<Factor<f64>>();
const _: () = shared_between_threads::<SceneBuilder>();
const _: () = shared_between_threads::<Workspace<f64>>();
const _: () = shared_between_threads::<Error>();

/// All results of the scene in a state drawn from `seed`, as bits.
fn bits(scene: &Scene, workspace: &mut Workspace<f64>, factor: &Factor<f64>, seed: u64) -> Vec<u64> {
    let (q, qd, tau) = random_state(scene, &mut Random::new(seed));
    let nv = scene.nv();
    let (mut a, mut b, mut c) = (vec![f64::NAN; nv], vec![f64::NAN; nv], vec![f64::NAN; nv]);
    let (mut m, mut inverse) = (vec![f64::NAN; nv * nv], vec![f64::NAN; nv * nv]);
    scene.forward_dynamics(workspace, &q, &qd, &tau, &[], &mut a).unwrap();
    scene.inverse_dynamics(workspace, &q, &qd, &tau, &[], &mut b).unwrap();
    scene.mass_matrix(workspace, &q, &mut m).unwrap();
    scene.mass_matrix_inverse(workspace, &mut scene.inverse_scratch(), &q, &mut inverse).unwrap();
    factor.solve(&tau, &mut c);
    let energy = scene.energy(workspace, &q, &qd).unwrap();
    let scalars = [energy.kinetic, energy.potential];
    let all = [&a[..], &b, &c, &m, &inverse, &scalars].concat();
    assert!(all.iter().all(|x| x.is_finite()));
    all.into_iter().map(f64::to_bits).collect()
}

#[test]
fn threads_share_a_scene_and_a_factor() {
    let tree = Tree { seed: 9, bodies: 12, kinds: &ALL_KINDS, branching: 0.5, armature: 0.1, floating: true };
    let scene = tree.scene();
    let (q, ..) = random_state(&scene, &mut Random::new(0));
    let (factor, monitor) = Factor::new(scene.model(), &mut scene.workspace(), &q);
    assert!(monitor.clear(0));
    let mut workspace = scene.workspace();
    let alone: Vec<_> = (0..STATES).map(|seed| bits(&scene, &mut workspace, &factor, seed)).collect();
    let start = std::sync::Barrier::new(usize::try_from(THREADS).unwrap());
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..THREADS)
            .map(|thread| {
                let (scene, factor, start) = (&scene, &factor, &start);
                scope.spawn(move || {
                    let mut workspace = scene.workspace();
                    start.wait();
                    // Each thread uses the states in a different order.
                    let order = (0..STATES).map(|i| (i * (2 * thread + 5) + thread) % STATES);
                    order.map(|seed| (seed, bits(scene, &mut workspace, factor, seed))).collect::<Vec<_>>()
                })
            })
            .collect();
        for thread in threads {
            for (seed, found) in thread.join().unwrap() {
                assert_eq!(found, alone[usize::try_from(seed).unwrap()], "state {seed}");
            }
        }
    });
}
