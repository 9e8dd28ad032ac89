//! One step of a batch of arms by every method, compared with one forward dynamics of the same batch: `cargo bench
//! --bench motion`.
//!
//! Times are of the whole batch on one core: divide by 1024 for a state. `--features parallel` adds threads.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use phipsi::motion::{METHODS, Rollout, Settings, Torque};
use phipsi::{Algorithm, Arguments, Form};
use std::hint::black_box;

const STATES: usize = 1024;

fn steps(c: &mut Criterion) {
    let scene = phipsi::scenes::chain(7).expect("a chain");
    #[allow(clippy::cast_precision_loss)] // small counts
    let numbers =
        |scale: f64, size: f64| (0..STATES * 7).map(|i| size * (scale * i as f64).sin()).collect::<Vec<f64>>();
    let (q, qd) = (numbers(0.37, 1.0), numbers(0.17, 0.1));
    let mut group = c.benchmark_group("seven joints");
    group.throughput(Throughput::Elements(STATES as u64));
    for (form, name) in [(Form::Covariance, "covariance"), (Form::Auto, "auto")] {
        let mut evaluator = scene.evaluator();
        let states: Vec<Arguments<'_>> = (0..STATES)
            .map(|i| Arguments { q: &q[7 * i..][..7], qd: &qd[7 * i..][..7], u: &[0.0; 7], ..Arguments::default() })
            .collect();
        let mut out = vec![0.0; 7 * STATES];
        group.bench_function(format!("forward dynamics, {name}"), |b| {
            b.iter(|| scene.evaluate(&mut evaluator, Algorithm::ForwardDynamics(form), black_box(&states), &mut out));
        });
        for (method_name, method) in METHODS {
            for (stiffness, springs) in [(0.0, ""), (10.0, ", springs")] {
                let mut settings = Settings::new(&scene, 1e-5).with_method(method).with_form(form);
                settings.properties.stiffness.fill(stiffness);
                settings.properties.damping.fill(0.01 * stiffness);
                let mut rollout = Rollout::new(&scene, settings, &q, &qd).expect("a rollout");
                group.bench_function(format!("{method_name}, {name}{springs}"), |b| {
                    b.iter_custom(|count| {
                        let start = std::time::Instant::now();
                        let steps = usize::try_from(count).expect("a count");
                        rollout.advance(black_box(steps), &Torque::Zero, None).expect("steps");
                        start.elapsed()
                    });
                });
            }
        }
    }
    group.finish();
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20).warm_up_time(std::time::Duration::from_millis(300))
        .measurement_time(std::time::Duration::from_millis(1200));
    targets = steps
}
criterion_main!(benches);
