//! One state per call, on the chains and robots of the peers: `cargo bench --features urdf,lanes --bench dynamics`.
//!
//! 256 random states are drawn outside the timed part and used in turn; none is zero. Form `auto` is also timed in
//! static equilibrium, passive at rest and passive in motion. The robots need the files of `make peers`.

mod common;

use common::{ALGORITHMS, CHAINS, KINDS, ROBOTS, arguments, batch_of, model, states, states_of};
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::DMatrixView;
use phipsi::filter::FORMS;
use phipsi::kinematics::Frame;
use phipsi::kinematics::ReferenceFrame;
use phipsi::{Algorithm, Arguments, Form, Scene, dynamics, scenes};
use std::hint::black_box;

/// Every algorithm on one scene, as group/name: one state per call, and with `batches` one batch per call on one
/// thread. The group `forms` has the other forms.
///
/// The public calls, with checks of lengths, NaN, pivots and results.
fn algorithms(c: &mut Criterion, name: &str, scene: &Scene, batches: bool) {
    let states = states(scene);
    let mut evaluator = scene.evaluator();
    for (group, algorithm) in ALGORITHMS {
        let mut out = vec![0.0; scene.width(algorithm)];
        let all: Vec<_> = states.iter().map(|state| arguments(algorithm, state)).collect();
        let mut cycle = all.iter().cycle();
        c.benchmark_group(group).bench_function(name, |b| {
            b.iter(|| {
                let state = black_box(cycle.next().expect("a cycle has no end"));
                let out = black_box(&mut out[..]);
                scene.evaluate(&mut evaluator, algorithm, std::slice::from_ref(state), out).expect("a state");
            });
        });
        if !batches {
            continue;
        }
        let many: Vec<_> = all.iter().cycle().take(batch_of(algorithm)).copied().collect();
        let mut out = vec![0.0; scene.width(algorithm) * many.len()];
        let mut group = c.benchmark_group(format!("{group}_batch"));
        group.throughput(Throughput::Elements(many.len() as u64)).sample_size(20);
        group.bench_function(name, |b| {
            b.iter(|| {
                let states = black_box(&many[..]);
                scene.evaluate(&mut evaluator, algorithm, states, black_box(&mut out)).expect("states");
            });
        });
    }
}

fn chains(c: &mut Criterion) {
    for n in CHAINS {
        algorithms(c, &format!("chain_{n}"), &scenes::chain(n).expect("a chain"), n == 7);
    }
}

/// Forward dynamics and M^-1 in each form, for ratios to covariance.
fn forms(c: &mut Criterion) {
    for n in [7, 64] {
        let scene = scenes::chain(n).expect("a chain");
        let states = states(&scene);
        let mut evaluator = scene.evaluator();
        for &(name, form) in FORMS {
            for (what, algorithm) in [
                ("forward_dynamics", Algorithm::ForwardDynamics(form)),
                ("mass_matrix_inverse", Algorithm::MassMatrixInverse(form)),
            ] {
                let all: Vec<_> = states.iter().map(|state| arguments(algorithm, state)).collect();
                let mut out = vec![0.0; scene.width(algorithm)];
                let mut cycle = all.iter().cycle();
                let mut group = c.benchmark_group("forms");
                group.bench_function(BenchmarkId::new(format!("{what}/{name}"), n), |b| {
                    b.iter(|| {
                        let state = black_box(cycle.next().expect("a cycle has no end"));
                        let out = black_box(&mut out[..]);
                        scene.evaluate(&mut evaluator, algorithm, std::slice::from_ref(state), out).expect("a state");
                    });
                });
                let lanes = evaluator.lanes();
                let mut out = vec![0.0; scene.width(algorithm) * lanes];
                group.throughput(Throughput::Elements(lanes as u64));
                group.bench_function(BenchmarkId::new(format!("{what}_lanes/{name}"), n), |b| {
                    b.iter(|| {
                        let states = black_box(&all[..lanes]);
                        scene.evaluate(&mut evaluator, algorithm, states, black_box(&mut out)).expect("states");
                    });
                });
            }
        }
    }
}

/// Forward dynamics in form `auto` and `covariance` by kind of state: one state per call, and one register of states.
fn auto_states(c: &mut Criterion) {
    for name in ["chain_7"].into_iter().chain(ROBOTS.map(|(name, _)| name)) {
        let Some(scene) = model(name) else { continue };
        let (random, mut evaluator) = (states(&scene), scene.evaluator());
        let lanes = evaluator.lanes();
        for (kind, states) in KINDS.map(|(text, kind)| (text, states_of(kind, &scene, &random))) {
            for (form_name, form) in
                FORMS.iter().copied().filter(|(_, form)| matches!(form, Form::Auto | Form::Covariance))
            {
                let algorithm = Algorithm::ForwardDynamics(form);
                let all: Vec<_> = states.iter().map(|state| arguments(algorithm, state)).collect();
                for (what, a_call) in [("one", 1), ("lanes", lanes)] {
                    let mut out = vec![0.0; scene.width(algorithm) * a_call];
                    let mut cycle = all.chunks_exact(a_call).cycle();
                    let mut group = c.benchmark_group("auto_states");
                    group.throughput(Throughput::Elements(a_call as u64));
                    group.bench_function(BenchmarkId::new(format!("{kind}/{form_name}/{what}"), name), |b| {
                        b.iter(|| {
                            let states = black_box(cycle.next().expect("a cycle has no end"));
                            scene.evaluate(&mut evaluator, algorithm, states, black_box(&mut out)).expect("states");
                        });
                    });
                }
            }
        }
    }
}

/// The robots of `make peers`, with the base of the peers.
fn robots(c: &mut Criterion) {
    for (name, _) in ROBOTS {
        let Some(scene) = model(name) else { continue };
        algorithms(c, name, &scene, name == "g1" || name == "talos");
    }
}

/// Time per body from 10 to 100,000 bodies: criterion's throughput is bodies per second.
fn growth(c: &mut Criterion) {
    for n in [10, 100, 1_000, 10_000, 100_000] {
        let scene = scenes::chain(n).expect("a chain");
        let mut evaluator = scene.evaluator();
        #[allow(clippy::cast_precision_loss)] // an index
        let wave = |scale: f64| -> Vec<f64> { (0..n).map(|i| scale * (1.0 + 0.7 * i as f64).sin()).collect() };
        let (q, qd, tau) = (wave(2.0), wave(0.5), wave(3.0));
        let mut out = vec![0.0; n];
        let mut group = c.benchmark_group("growth");
        group.throughput(Throughput::Elements(n as u64)).sample_size(20);
        for (what, algorithm) in &ALGORITHMS[..2] {
            group.bench_function(BenchmarkId::new(*what, n), |b| {
                b.iter(|| {
                    let state = black_box(Arguments { q: &q, qd: &qd, u: &tau, wrenches: &[], ..Arguments::default() });
                    scene.evaluate(&mut evaluator, *algorithm, &[state], black_box(&mut out)).expect("a state");
                });
            });
        }
        group.finish();
    }
}

/// Omega of the last link, and of it and one at half length, of chains: in O(N), and if M^-1 is small enough as J
/// M^-1 J^T.
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
                        scene.jacobian(q, *name, ReferenceFrame::Local, rows).expect("a jacobian");
                    }
                    let j = DMatrixView::from_slice(&jacobian, n, 6 * m);
                    black_box(j.transpose() * (DMatrixView::from_slice(&inverse, n, n) * j))
                });
            });
        }
        group.finish();
    }
}

/// Derivatives of inverse and forward dynamics, one state per call by the public methods: chains, and the floating
/// robots of the peers.
fn derivatives(c: &mut Criterion) {
    let chains = [7, 20, 50].map(|n| (format!("chain_{n}"), scenes::chain(n).ok()));
    let robots = ["g1", "talos"].map(|name| (name.to_owned(), model(name)));
    for (name, scene) in chains.into_iter().chain(robots) {
        let Some(scene) = scene else { continue };
        let states = states(&scene);
        let mut cycle = states.iter().cycle();
        let mut next = move || black_box(cycle.next().expect("a cycle has no end"));
        let (mut workspace, mut out) = (scene.workspace(), vec![0.0; 3 * scene.nv() * scene.nv()]);
        let mut group = c.benchmark_group("derivatives");
        group.bench_function(BenchmarkId::new("inverse", &name), |b| {
            b.iter(|| {
                let [q, qd, u] = next();
                scene
                    .inverse_dynamics_derivatives(&mut workspace, q, qd, u, &[], black_box(&mut out))
                    .expect("a state");
            });
        });
        for &(form_name, form) in FORMS {
            workspace.form = form;
            group.bench_function(BenchmarkId::new(format!("forward/{form_name}"), &name), |b| {
                b.iter(|| {
                    let [q, qd, u] = next();
                    scene
                        .forward_dynamics_derivatives(&mut workspace, q, qd, u, &[], black_box(&mut out))
                        .expect("a state");
                });
            });
        }
        group.finish();
    }
}

criterion_group!(benches, chains, robots, growth, operational, forms, auto_states, derivatives);
criterion_main!(benches);
