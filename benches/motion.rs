//! One step of a batch of arms by every method, compared with one forward dynamics of the same batch: `cargo bench
//! --bench motion`.
//!
//! Times are of the whole batch on one core: divide by 1024 for a state. `--features parallel` adds threads.
//!
//! `cargo bench --bench motion --features urdf,lanes observer`: one step of the observer of a UR5 (a chain of six
//! without its file) with encoders, an IMU with biases and a wrench on the tool.

mod common;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use phipsi::estimation::{ExternalWrench, Observer, ObserverSettings, Quantity, Sensor};
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
        for &(method_name, method) in METHODS {
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

/// 24 components of the error and 12 readings. The history stores a step for the smoother.
fn observer_steps(c: &mut Criterion) {
    let scene = common::model("ur5").unwrap_or_else(|| phipsi::scenes::chain(6).expect("a chain"));
    let tool = scene.joints().last().expect("a joint").child.clone();
    let with_bias = |name: &str, quantity, noise, bias: f64| {
        Sensor::new(name, quantity, noise).with_bias(bias).with_bias_walk(0.05 * bias)
    };
    let sensors = vec![
        Sensor::new("encoder", Quantity::Encoder(None), 1e-4),
        with_bias("gyro", Quantity::Gyro(tool.as_str().into()), 5e-3, 0.02),
        with_bias("accelerometer", Quantity::Accelerometer(tool.as_str().into()), 0.05, 0.1),
    ];
    let mut settings = ObserverSettings::new(&scene, 2e-3, sensors)
        .with_torque_noise([0.01; 6])
        .with_wrenches([ExternalWrench::new(tool, [1.0, 1.0, 1.0, 100.0, 100.0, 100.0])])
        .with_initial([[1e-3; 6], [1e-2; 6]].concat());
    let (q, qd) = ([0.3, -0.6, 0.9, 0.1, 0.4, 0.2], [0.0; 6]);
    let mut held = [0.0; 6];
    scene.gravity_torque(&mut scene.workspace(), &q, &mut held).expect("torques");
    let mut readings = [0.0; 12];
    readings[..6].copy_from_slice(&q);
    let turn = scene.placement(&q, settings.wrenches[0].link.as_str()).expect("a pose").rotation;
    readings[9..].copy_from_slice((-(turn.transpose() * scene.model().gravity)).as_slice());
    let mut group = c.benchmark_group("observer");
    for history in [0, 1000] {
        settings.history = history;
        let mut observer = Observer::new(&scene, &settings, &q, &qd).expect("an observer");
        let mut covariance = [0.0; 24 * 24];
        group.bench_function(format!("step, history {history}"), |b| {
            b.iter(|| observer.step(black_box(&held), black_box(&readings)).expect("a step"));
        });
        group.bench_function(format!("step and covariance, history {history}"), |b| {
            b.iter(|| {
                observer.step(black_box(&held), black_box(&readings)).expect("a step");
                observer.estimate(0).expect("an estimate").covariance(&mut covariance).expect("a covariance");
                black_box(&covariance);
            });
        });
    }
    group.finish();
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20).warm_up_time(std::time::Duration::from_millis(300))
        .measurement_time(std::time::Duration::from_millis(1200));
    targets = steps, observer_steps
}
criterion_main!(benches);
