//! Run time as a function of the number of bodies.

use crate::algorithm::{Algorithm, Arguments};
use crate::error::Error;
use crate::filter::Form;
use crate::operators::{KINDS, Operator};
use crate::scenes;
use crate::workspace::Workspace;
use crate::{interrupt, memory};
use std::hint::black_box;
use std::time::Instant;

/// Times of [`Scene::evaluate`] on a chain, with one state per call.
///
/// [`Scene::evaluate`]: crate::Scene::evaluate
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Growth {
    /// Number of bodies.
    pub bodies: usize,
    /// Forward dynamics in form `auto`, ns per body.
    pub forward: f64,
    /// Forward dynamics in covariance form, ns per body.
    pub covariance: f64,
    /// Inverse dynamics, ns per body.
    pub inverse: f64,
}

/// Median times per body of forward and inverse dynamics on the chain of `bodies` equal links, over `repeats` passes.
///
/// # Errors
///
/// As the construction of the chain and the calls; [`Error::Memory`] for too many repeats.
pub fn growth(bodies: usize, repeats: usize) -> Result<Growth, Error> {
    let scene = scenes::chain(bodies).map_err(|error| error.asked_by("bodies"))?;
    let mut evaluator = scene.evaluator();
    let (q, qd, tau) = (wave(bodies, 2.0), wave(bodies, 0.5), wave(bodies, 3.0));
    let state = Arguments { q: &q, qd: &qd, u: &tau, wrenches: &[], ..Arguments::default() };
    let mut out = vec![0.0; bodies];
    // Small chains are called repeatedly, so that overhead and resolution of the clock are negligible.
    let calls = (2_000 / bodies.max(1)).max(1);
    #[allow(clippy::cast_precision_loss)] // counts
    let work = (calls * bodies.max(1)) as f64;
    let mut timed = |algorithm| -> Result<f64, Error> {
        scene.evaluate(&mut evaluator, algorithm, &[state], &mut out).map_err(|fault| fault.error)?;
        let ns = median_ns(repeats, &mut || {
            for _ in 0..calls {
                let (states, out) = black_box(([state], &mut out));
                let _ = black_box(scene.evaluate(&mut evaluator, algorithm, &states, out));
            }
        })?;
        Ok(ns / work)
    };
    Ok(Growth {
        bodies,
        forward: timed(Algorithm::ForwardDynamics(Form::Auto))?,
        covariance: timed(Algorithm::ForwardDynamics(Form::Covariance))?,
        inverse: timed(Algorithm::InverseDynamics)?,
    })
}

/// Median time per body of applying each operator, and its transpose (marked by a star), on the chain of `bodies`
/// links, ns.
///
/// # Errors
///
/// As the construction of the chain; [`Error::Memory`] for too many repeats.
pub fn operator_growth(bodies: usize, repeats: usize) -> Result<Vec<(String, f64)>, Error> {
    let scene = scenes::chain(bodies).map_err(|error| error.asked_by("bodies"))?;
    let factor = scene.factor(&mut Workspace::new(scene.model()), &wave(bodies, 2.0))?;
    let calls = (2_000 / bodies.max(1)).max(1);
    #[allow(clippy::cast_precision_loss)] // counts
    let work = (calls * bodies.max(1)) as f64;
    let mut all = Vec::with_capacity(2 * KINDS.len());
    for &(name, kind) in KINDS {
        let operator = factor.operator(kind);
        let (rows, columns) = operator.shape();
        let (x, mut y) = (wave(columns, 1.0), vec![f64::NAN; rows]);
        let mut forward = || (0..calls).for_each(|_| operator.apply(black_box(&x), black_box(&mut y)));
        all.push((name.to_owned(), median_ns(repeats, &mut forward)? / work));
        let (x, mut y) = (wave(rows, 1.0), vec![f64::NAN; columns]);
        let mut backward = || (0..calls).for_each(|_| operator.apply_transpose(black_box(&x), black_box(&mut y)));
        all.push((format!("{name}*"), median_ns(repeats, &mut backward)? / work));
    }
    Ok(all)
}

/// Values that are nonzero and distinct.
fn wave(length: usize, scale: f64) -> Vec<f64> {
    #[allow(clippy::cast_precision_loss)] // an index
    (0..length).map(|i| scale * (1.0 + 0.7 * i as f64).sin()).collect()
}

/// Median wall time of `call`, ns, after one call that warms the caches. Fails for too many repeats and if interrupted.
pub(super) fn median_ns(repeats: usize, call: &mut impl FnMut()) -> Result<f64, Error> {
    let repeats = repeats.max(1);
    let mut times = memory::with_capacity("repeats", repeats)?;
    call();
    for _ in 0..repeats {
        interrupt::check()?;
        let start = Instant::now();
        call();
        times.push(start.elapsed().as_secs_f64() * 1e9);
    }
    times.sort_by(f64::total_cmp);
    Ok(times[times.len() / 2])
}
