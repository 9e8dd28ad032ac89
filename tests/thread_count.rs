//! The number of threads: set, reported, refused, and without effect on the bits. It is a property of the process:
//! one test.
#![cfg(feature = "parallel")]

use phipsi::Error;
use phipsi::batch::{Batch, Pool, set_threads, threads};
use std::collections::HashSet;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Barrier, Mutex};
use std::thread::ThreadId;
use std::time::{Duration, Instant};

/// Results of many states, enough for several threads, and the threads that computed them.
fn run() -> (Vec<u64>, HashSet<ThreadId>) {
    let (pool, seen) = (Pool::default(), Mutex::new(HashSet::new()));
    let mut results = vec![f64::NAN; 2000];
    let batch = Batch { states: 2000, cost: 100_000, pool: &pool, make: || () };
    let outcome = batch.run(&mut results, |(), i, out| {
        seen.lock().unwrap().insert(std::thread::current().id());
        out[0] = f64::from(u32::try_from(i).unwrap()).sqrt().sin();
        Ok(())
    });
    assert_eq!(outcome, Ok(()));
    (results.into_iter().map(f64::to_bits).collect(), seen.into_inner().unwrap())
}

/// Number of threads that are in a batch at the same time: each waits in its first state until that number has
/// arrived.
fn threads_that_meet(wanted: usize) -> usize {
    let (pool, seen, gone) = (Pool::default(), Mutex::new(HashSet::new()), Instant::now());
    let batch = Batch { states: 2000, cost: 100_000, pool: &pool, make: || () };
    let outcome = batch.run(&mut [0.0; 2000], |(), _, _| {
        seen.lock().unwrap().insert(std::thread::current().id());
        while seen.lock().unwrap().len() < wanted && gone.elapsed() < Duration::from_secs(20) {
            std::thread::yield_now();
        }
        Ok(())
    });
    assert_eq!(outcome, Ok(()));
    seen.into_inner().unwrap().len()
}

/// A long batch of one thread does not block a batch of another thread, which ends long before it.
fn a_short_batch_ends_before_a_long_one() {
    let (pool, short_has_ended) = (Pool::default(), AtomicBool::new(false));
    let (begun, gone, done) = (Barrier::new(2), Instant::now(), AtomicUsize::new(0));
    let batch = |states| Batch { states, cost: 1_000_000, pool: &pool, make: || () };
    std::thread::scope(|scope| {
        let long = scope.spawn(|| {
            let outcome = batch(2000).run(&mut [0.0; 2000], |(), state, _| {
                if state == 0 {
                    begun.wait();
                }
                // Until the short one has ended; then there is no deadline.
                if !short_has_ended.load(Ordering::Relaxed) && gone.elapsed() < Duration::from_secs(20) {
                    std::thread::sleep(Duration::from_millis(1));
                }
                done.fetch_add(1, Ordering::Relaxed);
                Ok(())
            });
            assert_eq!(outcome, Ok(()));
            short_has_ended.load(Ordering::Relaxed)
        });
        begun.wait();
        assert_eq!(batch(64).run(&mut [0.0; 64], |(), _, _| Ok(())), Ok(()));
        let done_before = done.load(Ordering::Relaxed);
        short_has_ended.store(true, Ordering::Relaxed);
        assert!(done_before < 1900, "the short batch waited for {done_before} of 2000 states of the long one");
        assert!(long.join().unwrap(), "the short batch waited for the long one");
    });
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let here = std::thread::current().id();
    let of_the_machine = threads();
    assert!(of_the_machine >= 1);
    let (expected, _) = run();
    for wanted in [1, 2, 3, 8, 1, 5] {
        set_threads(wanted).unwrap();
        assert_eq!(threads(), wanted);
        let (found, seen) = run();
        assert_eq!(found, expected);
        assert!(seen.len() <= wanted, "{} threads of {wanted}", seen.len());
        assert!(wanted > 1 || seen == HashSet::from([here]), "the caller computes where it is alone");
        assert_eq!(threads_that_meet(wanted), wanted, "the caller is one of them");
    }
    for absurd in [usize::MAX, 1 << 40] {
        let error = set_threads(absurd).unwrap_err();
        assert!(matches!(error, Error::Argument { ref argument, .. } if argument == "threads"), "{error}");
        assert!(error.to_string().contains(&absurd.to_string()));
        assert_eq!(threads(), 5, "what was set before stays");
    }
    // Changed while batches run: they keep their number.
    std::thread::scope(|scope| {
        let batches: Vec<_> = (0..4).map(|_| scope.spawn(|| (0..20).map(|_| run().0).collect::<Vec<_>>())).collect();
        for wanted in [2, 1, 4, 0, 3].into_iter().cycle().take(50) {
            set_threads(wanted).unwrap();
        }
        for batch in batches {
            assert!(batch.join().unwrap().iter().all(|found| *found == expected));
        }
    });
    set_threads(2).unwrap();
    a_short_batch_ends_before_a_long_one();
    // The pool of the caller is used, independent of the setting.
    let own = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    set_threads(3).unwrap();
    assert_eq!(own.install(threads), 2);
    assert_eq!(own.install(|| run().0), expected);
    set_threads(0).unwrap();
    assert_eq!(threads(), of_the_machine);
}
