//! One state a call, on the chains that the peers run too: `cargo bench --bench dynamics`.
//!
//! 256 random states are drawn outside the timed part and cycled through; none is zero.

use criterion::{Criterion, criterion_group, criterion_main};
use phipsi::{Scene, dynamics, scenes};
use std::hint::black_box;

const STATES: usize = 256;

/// Random states of a scene with one-axis joints: (q, qd, tau), values in -1 to 1.
fn states(scene: &Scene) -> Vec<[Vec<f64>; 3]> {
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
    (0..STATES).map(|_| [draw(scene.nq()), draw(scene.nv()), draw(scene.nv())]).collect()
}

fn chains(c: &mut Criterion) {
    for n in [7, 16, 30, 64] {
        let scene = scenes::chain(n).expect("a chain");
        let model = scene.model();
        let states = states(&scene);
        let mut workspace = scene.workspace();
        let mut scratch = scene.inverse_scratch();
        let mut vector = vec![0.0; n];
        let mut matrix = vec![0.0; n * n];
        let name = format!("chain_{n}");
        let mut next = (0..STATES).cycle();

        let mut group = c.benchmark_group("forward_dynamics");
        group.bench_function(&name, |b| {
            b.iter(|| {
                let [q, qd, tau] = black_box(&states[next.next().unwrap_or(0)]);
                dynamics::forward_dynamics(model, &mut workspace, q, qd, tau, &[], black_box(&mut vector))
            });
        });
        group.finish();
        let mut group = c.benchmark_group("inverse_dynamics");
        group.bench_function(&name, |b| {
            b.iter(|| {
                let [q, qd, tau] = black_box(&states[next.next().unwrap_or(0)]);
                dynamics::inverse_dynamics(model, &mut workspace, q, qd, tau, &[], black_box(&mut vector));
            });
        });
        group.finish();
        let mut group = c.benchmark_group("mass_matrix");
        group.bench_function(&name, |b| {
            b.iter(|| {
                let [q, ..] = black_box(&states[next.next().unwrap_or(0)]);
                dynamics::mass_matrix(model, &mut workspace, q, black_box(&mut matrix));
            });
        });
        group.finish();
        let mut group = c.benchmark_group("mass_matrix_inverse");
        group.bench_function(&name, |b| {
            b.iter(|| {
                let [q, ..] = black_box(&states[next.next().unwrap_or(0)]);
                dynamics::mass_matrix_inverse(model, &mut workspace, &mut scratch, q, black_box(&mut matrix))
            });
        });
        group.finish();
    }
}

criterion_group!(benches, chains);
criterion_main!(benches);
