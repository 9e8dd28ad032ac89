//! The operators of the paper on chains of 10 to 10,000 links; samples per second of the random model.
//!
//! `RAYON_NUM_THREADS=1 cargo bench --features stochastic,parallel --bench paper sampling` measures one core.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use phipsi::operators::{KINDS, Operator};
use phipsi::scenes;
use phipsi::stochastic::{Method, Points};
use std::hint::black_box;
use std::time::Duration;

fn wave(length: usize, scale: f64) -> Vec<f64> {
    #[allow(clippy::cast_precision_loss)] // an index
    (0..length).map(|i| scale * (1.0 + 0.7 * i as f64).sin()).collect()
}

/// Elements per second are bodies per second: independent of the size if the cost is linear in N.
fn operators(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("operators");
    group.sample_size(20).warm_up_time(Duration::from_millis(200)).measurement_time(Duration::from_millis(600));
    for bodies in [10_usize, 100, 1_000, 10_000] {
        let scene = scenes::chain(bodies).expect("a chain");
        let factor = scene.factor(&mut scene.workspace(), &wave(bodies, 2.0)).expect("no singular joint");
        group.throughput(Throughput::Elements(bodies as u64));
        for &(name, kind) in KINDS {
            let operator = factor.operator(kind);
            let (rows, columns) = operator.shape();
            let (x, mut y) = (wave(columns, 1.0), vec![f64::NAN; rows]);
            group.bench_function(BenchmarkId::new(name, bodies), |bencher| {
                bencher.iter(|| operator.apply(black_box(&x), black_box(&mut y)));
            });
        }
    }
    group.finish();
}

/// A chain of seven links: the mass matrix from samples, and the samples themselves.
fn sampling(criterion: &mut Criterion) {
    let scene = scenes::chain(7).expect("a chain");
    let model = scene.random_model(&wave(7, 2.0), Some(&wave(7, 0.5)), 1.0).expect("a model");
    let mut group = criterion.benchmark_group("sampling");
    group.sample_size(10);
    let samples = 1_usize << 18;
    group.throughput(Throughput::Elements(samples as u64));
    group.bench_function("mass matrix, monte-carlo", |bencher| {
        let method = Method::MonteCarlo { samples, seed: 1, confidence: 0.95 };
        bencher.iter(|| model.mass_matrix(black_box(method)));
    });
    group.bench_function("mass matrix, sobol", |bencher| {
        bencher.iter(|| model.sobol_estimate(black_box(samples), 1, 0));
    });
    group.bench_function("torques", |bencher| {
        bencher.iter(|| model.sample_torque(black_box(&Points::random(1)), 0..samples as u64));
    });
    group.finish();
}

criterion_group!(benches, operators, sampling);
criterion_main!(benches);
