//! The number of threads: set, told, refused, and without effect on a bit. One process, one number: so one test.
#![cfg(feature = "parallel")]

use phipsi::Error;
use phipsi::batch::{Batch, Pool, set_threads, threads};
use std::collections::HashSet;
use std::sync::Mutex;
use std::thread::ThreadId;

/// Results of many states that are worth threads, and the threads that computed them.
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
        assert_eq!(seen.contains(&here), wanted == 1, "the caller computes where it is alone");
    }
    for absurd in [usize::MAX, 1 << 40] {
        let error = set_threads(absurd).unwrap_err();
        assert!(matches!(error, Error::Argument { ref argument, .. } if argument == "threads"), "{error}");
        assert!(error.to_string().contains(&absurd.to_string()));
        assert_eq!(threads(), 5, "what was set before stays");
    }
    // Changed while batches run: they keep theirs.
    std::thread::scope(|scope| {
        let batches: Vec<_> = (0..4).map(|_| scope.spawn(|| (0..20).map(|_| run().0).collect::<Vec<_>>())).collect();
        for wanted in [2, 1, 4, 0, 3].into_iter().cycle().take(50) {
            set_threads(wanted).unwrap();
        }
        for batch in batches {
            assert!(batch.join().unwrap().iter().all(|found| *found == expected));
        }
    });
    // A pool that the caller is in is used, whatever was set.
    let own = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    set_threads(3).unwrap();
    assert_eq!(own.install(threads), 2);
    assert_eq!(own.install(|| run().0), expected);
    set_threads(0).unwrap();
    assert_eq!(threads(), of_the_machine);
}
