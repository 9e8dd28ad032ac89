//! One state a call, on the chains and robots that the peers run too: `cargo bench --features urdf --bench dynamics`.
//!
//! 256 random states are drawn outside the timed part and cycled through; none is zero. The robots are there once
//! `make peers` has written their files.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::DMatrixView;
use phipsi::dynamics::operational::Frame;
use phipsi::filter::{FORMS, Form};
use phipsi::{Scene, dynamics, scenes};
use std::hint::black_box;

const STATES: usize = 256;

/// (q, qd, tau) of one state.
type State = [Vec<f64>; 3];

/// Random states of a scene: velocities and torques in -1 to 1, configurations that far from the neutral one.
fn states(scene: &Scene) -> Vec<State> {
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

/// Every algorithm on one scene, as group/name.
fn algorithms(c: &mut Criterion, name: &str, scene: &Scene) {
    let model = scene.model();
    let states = states(scene);
    let mut cycle = states.iter().cycle();
    let mut next = move || black_box(cycle.next().expect("a cycle has no end"));
    // The form that the peers run; the group `forms` has the others.
    let (mut workspace, mut scratch) = (scene.workspace().in_form(Form::Covariance), scene.inverse_scratch());
    let mut vector = vec![0.0; scene.nv()];
    let mut matrix = vec![0.0; scene.nv() * scene.nv()];
    let mut bench = |group: &str, call: &mut dyn FnMut(&State)| {
        c.benchmark_group(group).bench_function(name, |b| b.iter(|| call(next())));
    };
    bench("forward_dynamics", &mut |[q, qd, tau]| {
        black_box(dynamics::forward_dynamics(model, &mut workspace, q, qd, tau, &[], black_box(&mut vector)));
    });
    bench("inverse_dynamics", &mut |[q, qd, qdd]| {
        dynamics::inverse_dynamics(model, &mut workspace, q, qd, qdd, &[], black_box(&mut vector));
    });
    bench("mass_matrix", &mut |[q, ..]| {
        dynamics::mass_matrix(model, &mut workspace, q, black_box(&mut matrix));
    });
    bench("mass_matrix_inverse", &mut |[q, ..]| {
        black_box(dynamics::mass_matrix_inverse(model, &mut workspace, &mut scratch, q, black_box(&mut matrix)));
    });
}

fn chains(c: &mut Criterion) {
    for n in [7, 16, 30, 64] {
        algorithms(c, &format!("chain_{n}"), &scenes::chain(n).expect("a chain"));
    }
}

/// Forward dynamics and M^-1 in each form: ratios to covariance are what counts.
fn forms(c: &mut Criterion) {
    for n in [7, 64] {
        let scene = scenes::chain(n).expect("a chain");
        let model = scene.model();
        let states = states(&scene);
        let (mut vector, mut matrix) = (vec![0.0; scene.nv()], vec![0.0; scene.nv() * scene.nv()]);
        let mut scratch = scene.inverse_scratch();
        for (name, form) in FORMS {
            let mut workspace = scene.workspace().in_form(form);
            let mut cycle = states.iter().cycle();
            let mut group = c.benchmark_group("forms");
            group.bench_function(BenchmarkId::new(format!("forward_dynamics/{name}"), n), |b| {
                b.iter(|| {
                    let [q, qd, tau] = black_box(cycle.next().expect("a cycle has no end"));
                    black_box(dynamics::forward_dynamics(
                        model,
                        &mut workspace,
                        q,
                        qd,
                        tau,
                        &[],
                        black_box(&mut vector),
                    ))
                });
            });
            group.bench_function(BenchmarkId::new(format!("mass_matrix_inverse/{name}"), n), |b| {
                b.iter(|| {
                    let [q, ..] = black_box(cycle.next().expect("a cycle has no end"));
                    let out = black_box(&mut matrix[..]);
                    black_box(dynamics::mass_matrix_inverse(model, &mut workspace, &mut scratch, q, out))
                });
            });
        }
    }
}

/// The robots of `make peers`, on the base that the peers give them.
#[cfg(feature = "urdf")]
fn robots(c: &mut Criterion) {
    for (name, floating) in [("ur5", false), ("panda", false), ("anymal", true), ("g1", true), ("talos", true)] {
        let path = format!("{}/target/peers/models/{name}.urdf", env!("CARGO_MANIFEST_DIR"));
        if !std::path::Path::new(&path).exists() {
            eprintln!("{name}: no {path}; `make peers` writes it");
            continue;
        }
        let builder = phipsi::SceneBuilder::from_urdf_file(&path).expect("a robot").floating_base(floating);
        algorithms(c, name, &builder.build().expect("a robot"));
    }
}

#[cfg(not(feature = "urdf"))]
fn robots(_: &mut Criterion) {}

/// Time a body from 10 to 100,000 bodies: criterion's throughput is bodies a second.
fn growth(c: &mut Criterion) {
    for n in [10, 100, 1_000, 10_000, 100_000] {
        let scene = scenes::chain(n).expect("a chain");
        let model = scene.model();
        let mut workspace = scene.workspace().in_form(Form::Covariance);
        #[allow(clippy::cast_precision_loss)] // an index
        let wave = |scale: f64| -> Vec<f64> { (0..n).map(|i| scale * (1.0 + 0.7 * i as f64).sin()).collect() };
        let (q, qd, tau) = (wave(2.0), wave(0.5), wave(3.0));
        let mut out = vec![0.0; n];
        let mut group = c.benchmark_group("growth");
        group.throughput(Throughput::Elements(n as u64)).sample_size(20);
        group.bench_function(BenchmarkId::new("forward_dynamics", n), |b| {
            b.iter(|| {
                let (q, qd, tau) = black_box((&q, &qd, &tau));
                dynamics::forward_dynamics(model, &mut workspace, q, qd, tau, &[], black_box(&mut out))
            });
        });
        group.bench_function(BenchmarkId::new("inverse_dynamics", n), |b| {
            b.iter(|| {
                let (q, qd, tau) = black_box((&q, &qd, &tau));
                dynamics::inverse_dynamics(model, &mut workspace, q, qd, tau, &[], black_box(&mut out));
            });
        });
        group.finish();
    }
}

/// Omega of the last link, and of it and one half way, of chains: in O(N), and where M^-1 is small enough as J M^-1 J^T.
fn operational(c: &mut Criterion) {
    for n in [8, 64, 512] {
        let scene = scenes::chain(n).expect("a chain");
        let model = scene.model();
        let states = states(&scene);
        let mut cycle = states.iter().cycle();
        let mut next = move || black_box(cycle.next().expect("a cycle has no end"));
        let (mut workspace, mut scratch) = (scene.workspace(), scene.operational_scratch());
        let mut inverse_scratch = scene.inverse_scratch();
        let link = |body: usize| {
            let at = scene.links().iter().find(|link| link.body == Some(body)).expect("a link");
            (at.name.as_str(), Frame { body: at.body, placement: at.placement })
        };
        let (names, frames): (Vec<&str>, Vec<Frame<f64>>) = [link(n - 1), link(n / 2)].into_iter().unzip();
        let mut group = c.benchmark_group("operational");
        for (what, m) in [("one", 1), ("pair", 2)] {
            let mut omega = vec![0.0; 36 * m * m];
            group.bench_function(BenchmarkId::new(what, n), |b| {
                b.iter(|| {
                    let [q, ..] = next();
                    let omega = black_box(&mut omega[..]);
                    dynamics::operational_inverse_inertia(model, &mut workspace, &mut scratch, q, &frames[..m], omega)
                });
            });
            if n > 64 {
                continue;
            }
            let (mut inverse, mut jacobian) = (vec![0.0; n * n], vec![0.0; 6 * m * n]);
            group.bench_function(BenchmarkId::new(format!("{what}_dense"), n), |b| {
                b.iter(|| {
                    let [q, ..] = next();
                    dynamics::mass_matrix_inverse(model, &mut workspace, &mut inverse_scratch, q, &mut inverse);
                    for (name, rows) in names[..m].iter().zip(jacobian.chunks_exact_mut(6 * n)) {
                        scene.jacobian(q, name, rows).expect("a jacobian");
                    }
                    let j = DMatrixView::from_slice(&jacobian, n, 6 * m);
                    black_box(j.transpose() * (DMatrixView::from_slice(&inverse, n, n) * j))
                });
            });
        }
        group.finish();
    }
}

criterion_group!(benches, chains, robots, growth, operational, forms);
criterion_main!(benches);
