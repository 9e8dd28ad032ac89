//! Run time against the number of bodies.

use crate::dynamics;
use crate::error::Error;
use crate::scenes;
use std::hint::black_box;
use std::time::Instant;

/// Time of one call on a chain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Growth {
    /// Bodies.
    pub bodies: usize,
    /// Forward dynamics, ns a body.
    pub forward: f64,
    /// Inverse dynamics, ns a body.
    pub inverse: f64,
}

/// Median time a body of forward and inverse dynamics on the equal-link chain of `bodies` links, over `repeats` passes.
///
/// # Errors
///
/// Those of building the chain.
pub fn growth(bodies: usize, repeats: usize) -> Result<Growth, Error> {
    let scene = scenes::chain(bodies)?;
    let model = scene.model();
    let mut workspace = scene.workspace();
    let state = |scale: f64| -> Vec<f64> {
        #[allow(clippy::cast_precision_loss)] // an index
        (0..bodies).map(|i| scale * (1.0 + 0.7 * i as f64).sin()).collect()
    };
    let (q, qd, tau) = (state(2.0), state(0.5), state(3.0));
    let mut out = vec![0.0; bodies];
    // Small chains are called many times, so that the clock's own cost and grain do not show.
    let calls = (2_000 / bodies.max(1)).max(1);
    let mut forward = || {
        for _ in 0..calls {
            let (q, qd, tau) = black_box((&q, &qd, &tau));
            black_box(dynamics::forward_dynamics(model, &mut workspace, q, qd, tau, &[], &mut out));
        }
    };
    let forward_ns = median_ns(repeats, &mut forward);
    let mut inverse = || {
        for _ in 0..calls {
            let (q, qd, tau) = black_box((&q, &qd, &tau));
            dynamics::inverse_dynamics(model, &mut workspace, q, qd, tau, &[], black_box(&mut out));
        }
    };
    let inverse_ns = median_ns(repeats, &mut inverse);
    #[allow(clippy::cast_precision_loss)] // counts
    let work = (calls * bodies.max(1)) as f64;
    Ok(Growth { bodies, forward: forward_ns / work, inverse: inverse_ns / work })
}

/// Median wall time of `call`, ns; one call beforehand warms the caches.
pub(super) fn median_ns(repeats: usize, call: &mut impl FnMut()) -> f64 {
    call();
    let mut times: Vec<f64> = (0..repeats.max(1))
        .map(|_| {
            let start = Instant::now();
            call();
            start.elapsed().as_secs_f64() * 1e9
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}
