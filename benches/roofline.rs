//! Peak performance of this machine, and the performance of each algorithm: `make roofline`, see benches/roofline.py.
//!
//! `roofline measure [seconds]` prints JSON; each value takes that long (default 0.2). Without `measure` (as `cargo
//! bench` starts it) it does nothing. One thread.

mod common;

use common::{arguments, batch_of, robot, states};
use phipsi::batch::Evaluator;
use phipsi::batch::{INSTRUCTION_SETS, InstructionSet, Target, Vectorized, Work};
use phipsi::report::operations::{Task, count, footprint};
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
use phipsi::scalar::Lanes;
use phipsi::scalar::Operations;
use phipsi::{Algorithm, Form, Scene, scenes};
#[cfg(target_arch = "x86_64")]
use pulp::x86::{V3, V4};
use std::hint::black_box;
use std::time::Instant;

const ALGORITHMS: [(&str, Algorithm); 6] = [
    ("forward dynamics, covariance", Algorithm::ForwardDynamics(Form::Covariance)),
    ("forward dynamics, auto", Algorithm::ForwardDynamics(Form::Auto)),
    ("forward dynamics, square-root", Algorithm::ForwardDynamics(Form::SquareRoot)),
    ("inverse dynamics", Algorithm::InverseDynamics),
    ("mass matrix", Algorithm::MassMatrix),
    ("inverse of the mass matrix", Algorithm::MassMatrixInverse(Form::Covariance)),
];

/// Multiply-adds per call of [`Products`] for each of its values.
const ROUNDS: u32 = 4096;

/// `K` independent chains of multiply-adds.
struct Products<T, const K: usize> {
    start: f64,
    of: std::marker::PhantomData<T>,
}

impl<T: Vectorized, const K: usize> Work for Products<T, K> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let (b, c) = (T::from_f64(0.999_999), T::from_f64(1e-6));
        let mut x = [T::from_f64(self.start); K];
        for (i, number) in (0_u32..).zip(&mut x) {
            *number += T::from_f64(f64::from(i));
        }
        for _ in 0..ROUNDS {
            for number in &mut x {
                *number = number.mul_add(b, c);
            }
        }
        black_box(&x);
    }
}

/// Independent divisions, `ROUNDS` of them for each of eight values.
struct Quotients<T> {
    start: f64,
    of: std::marker::PhantomData<T>,
}

impl<T: Vectorized> Work for Quotients<T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let by = T::from_f64(self.start);
        let mut x = [T::one(); 8];
        for _ in 0..ROUNDS {
            for number in &mut x {
                *number /= by;
            }
        }
        black_box(&x);
    }
}

/// Reads every value of an array and accumulates them in eight sums.
struct Loads<'a, T>(&'a [T]);

impl<T: Vectorized> Work for Loads<'_, T> {
    type Output = f64;

    #[inline(always)]
    fn call(self) -> f64 {
        let mut sums = [T::zero(); 8];
        for numbers in self.0.as_chunks::<8>().0 {
            for (sum, &number) in sums.iter_mut().zip(numbers) {
                *sum += number;
            }
        }
        sums.iter().fold(T::zero(), |sum, &number| sum + number).lane(0)
    }
}

/// Reads, changes and writes every value of an array.
struct Updates<'a, T>(&'a mut [T]);

impl<T: Vectorized> Work for Updates<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let c = T::from_f64(1e-6);
        for number in self.0 {
            *number += c;
        }
    }
}

/// Times of a call in ns, sorted: at least nine measurements of many calls, which take `seconds` together.
fn times_ns(seconds: f64, mut call: impl FnMut()) -> Vec<f64> {
    let mut many = |calls: u32| {
        let start = Instant::now();
        (0..calls).for_each(|_| call());
        start.elapsed().as_secs_f64()
    };
    let mut calls = 1;
    while many(calls) < seconds / 50.0 {
        calls *= 2;
    }
    let (began, mut times) = (Instant::now(), Vec::new());
    while times.len() < 9 || began.elapsed().as_secs_f64() < seconds {
        times.push(many(calls) * 1e9 / f64::from(calls));
    }
    times.sort_by(f64::total_cmp);
    times
}

/// The median: time of an algorithm.
fn median_ns(seconds: f64, call: impl FnMut()) -> f64 {
    let times = times_ns(seconds, call);
    times[times.len() / 2]
}

/// The minimum: peak of the machine.
fn shortest_ns(seconds: f64, call: impl FnMut()) -> f64 {
    times_ns(seconds, call)[0]
}

/// Peak values of one instruction set, as JSON: multiply-adds on `K` chains and on one, divisions, reading and
/// updating of arrays that fit in L1, in L2, and in neither. `None` if this processor does not support it.
#[allow(clippy::cast_precision_loss)] // counts
fn arm<T: Vectorized, const K: usize>(name: &str, seconds: f64) -> Option<String> {
    let target = T::Least::here()?;
    let products = |start| target.within(Products::<T, K> { start, of: std::marker::PhantomData });
    let quotients = |start| target.within(Quotients::<T> { start, of: std::marker::PhantomData });
    let chain = |start| target.within(Products::<T, 1> { start, of: std::marker::PhantomData });
    let all = shortest_ns(seconds, || products(black_box(0.5)));
    let one = shortest_ns(seconds, || chain(black_box(0.5)));
    let divided = shortest_ns(seconds, || quotients(black_box(0.999_999)));
    let divided = divided / (8.0 * f64::from(ROUNDS) * T::LANES as f64);
    let peak = 2.0 * f64::from(ROUNDS) * (K * T::LANES) as f64 / all;
    let mut parts = vec![
        format!("\"name\": \"{name}\", \"lanes\": {}, \"gflops\": {peak:.3}", T::LANES),
        format!("\"division_ns\": {divided:.4}, \"dependent_ns\": {:.4}", one / f64::from(ROUNDS)),
    ];
    for (level, bytes) in [("l1", 24 << 10), ("l2", 768 << 10), ("far", 64 << 20)] {
        let mut numbers = vec![T::one(); bytes / size_of::<T>()];
        let read = shortest_ns(seconds, || _ = black_box(target.within(Loads(black_box(&numbers)))));
        let update = shortest_ns(seconds, || target.within(Updates(black_box(&mut numbers))));
        // An update reads and writes.
        let (read, update) = (bytes as f64 / read, 2.0 * bytes as f64 / update);
        parts.push(format!("\"{level}_read\": {read:.2}, \"{level}_update\": {update:.2}"));
    }
    Some(format!("{{{}}}", parts.join(", ")))
}

fn arms(seconds: f64) -> Vec<String> {
    let all = [
        arm::<f64, 12>("baseline", seconds),
        #[cfg(target_arch = "aarch64")]
        arm::<Lanes<pulp::aarch64::Neon>, 20>("neon", seconds),
        #[cfg(target_arch = "x86_64")]
        arm::<Lanes<V3>, 12>("avx2", seconds),
        #[cfg(target_arch = "x86_64")]
        arm::<Lanes<V4>, 12>("avx512", seconds),
    ];
    all.into_iter().flatten().collect()
}

/// Cycles per nanosecond, given that an integer multiplication takes three cycles on x86-64.
fn clock(seconds: f64) -> f64 {
    let ns = shortest_ns(seconds, || {
        let mut x = black_box(3_u64);
        for _ in 0..ROUNDS {
            x = x.wrapping_mul(black_box(6_364_136_223_846_793_005));
        }
        black_box(x);
    });
    3.0 * f64::from(ROUNDS) / ns
}

/// Every algorithm on one scene: operations and memory per state, and its time with each instruction set, for one
/// state and in a batch.
fn cases(name: &str, scene: &Scene, seconds: f64) -> Vec<String> {
    let kept = states(scene);
    let mut found = Vec::new();
    for (what, algorithm) in ALGORITHMS {
        let all: Vec<_> = kept.iter().map(|state| arguments(algorithm, state)).collect();
        // Few algorithms have a different count for each state: the mean over several.
        let some = 16;
        let mut totals = [("", 0.0); 6];
        let mut flops = 0.0;
        #[allow(clippy::cast_precision_loss)] // counts
        for state in &all[..some] {
            let operations: Operations = count(scene, Task::Algorithm(algorithm), state).operations;
            flops += operations.flops() as f64 / some as f64;
            for (total, (kind, number)) in totals.iter_mut().zip(operations.named()) {
                *total = (kind, total.1 + number as f64 / some as f64);
            }
        }
        let operations = totals.map(|(kind, number)| format!("\"{kind}\": {number}")).join(", ");
        let memory = footprint(scene, algorithm);
        let about = format!(
            "\"scene\": \"{name}\", \"dof\": {}, \"algorithm\": \"{what}\", \"flops\": {flops}, \"operations\": {{{operations}}}, \
             \"of_state\": {}, \"of_scene\": {}, \"results\": {}",
            scene.nv(),
            memory.state,
            memory.scene,
            scene.width(algorithm) * size_of::<f64>()
        );
        let mut add = |arm: InstructionSet, states: usize, lanes: usize, ns: f64| {
            found.push(format!(
                "{{{about}, \"arm\": \"{}\", \"states\": {states}, \"lanes\": {lanes}, \"ns\": {ns:.2}}}",
                arm.name()
            ));
        };
        for (_, arm) in INSTRUCTION_SETS.iter().copied().filter(|(_, arm)| arm.available()) {
            let mut evaluator = Evaluator::on(arm, scene);
            let mut out = vec![0.0; scene.width(algorithm)];
            let mut cycle = all.iter().cycle();
            let ns = median_ns(seconds, || {
                let state = black_box(cycle.next().expect("a cycle has no end"));
                scene
                    .evaluate(&mut evaluator, algorithm, std::slice::from_ref(state), black_box(&mut out))
                    .expect("a state");
            });
            add(arm, 1, 1, ns);
            // A batch on the baseline processes one state after another.
            if arm != InstructionSet::Baseline {
                let many: Vec<_> = all.iter().cycle().take(batch_of(algorithm)).copied().collect();
                let mut out = vec![0.0; scene.width(algorithm) * many.len()];
                let ns = median_ns(seconds, || {
                    scene.evaluate(&mut evaluator, algorithm, black_box(&many), black_box(&mut out)).expect("states");
                });
                #[allow(clippy::cast_precision_loss)] // a count
                add(arm, many.len(), evaluator.lanes(), ns / many.len() as f64);
            }
        }
    }
    found
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.first().is_none_or(|first| first != "measure") {
        eprintln!("roofline: measured by `make roofline`, nothing to do here");
        return;
    }
    let seconds = arguments.get(1).map_or(0.2, |text| text.parse().expect("seconds"));
    let mut found = Vec::new();
    for bodies in [7, 64] {
        found.extend(cases(&format!("chain of {bodies}"), &scenes::chain(bodies).expect("a chain"), seconds));
    }
    for name in ["g1", "talos"] {
        if let Some(scene) = robot(name, true) {
            found.extend(cases(name, &scene, seconds));
        }
    }
    let list = |items: Vec<String>| items.join(",\n  ");
    println!("{{\"clock_ghz\": {:.3},", clock(seconds));
    println!(" \"arms\": [\n  {}],", list(arms(seconds)));
    println!(" \"cases\": [\n  {}]}}", list(found));
}
