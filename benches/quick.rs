//! One minute of benchmarks: `cargo bench --bench quick`, with `--features lanes` for the kernels of this processor.
//!
//! The six algorithms of the peers on a chain of seven links, for one state per call and for a batch of 256 states on
//! one thread. States are random and drawn outside the timed part.

mod common;

use common::{ALGORITHMS, arguments, states};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use std::time::Duration;

fn quick(c: &mut Criterion) {
    let scene = phipsi::scenes::chain(7).expect("a chain");
    let states = states(&scene);
    let mut evaluator = scene.evaluator();
    for (name, algorithm) in ALGORITHMS {
        let all: Vec<_> = states.iter().map(|state| arguments(algorithm, state)).collect();
        let mut out = vec![f64::NAN; scene.width(algorithm) * all.len()];
        let mut group = c.benchmark_group(name);
        group.sample_size(20).warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(2));
        for count in [1, all.len()] {
            group.throughput(Throughput::Elements(count as u64));
            let mut chunks = all.chunks_exact(count).cycle();
            let out = &mut out[..scene.width(algorithm) * count];
            group.bench_function(if count == 1 { "1 state".to_owned() } else { format!("{count} states") }, |b| {
                b.iter(|| {
                    let states = black_box(chunks.next().expect("a cycle has no end"));
                    scene.evaluate(&mut evaluator, algorithm, states, black_box(&mut *out)).expect("states");
                });
            });
        }
    }
}

criterion_group!(benches, quick);
criterion_main!(benches);
