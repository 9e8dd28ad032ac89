//! Reference results of the scene for the arguments of a function, one after another; generated tests compare with
//! them.

use crate::algorithm::{Algorithm, Arguments};
use crate::dynamics::auto::{self, ErrorEstimate};
use crate::dynamics::sweeps::{SweepModel, SweepScratch, general};
use crate::error::Error;
use crate::scene::Scene;

/// An algorithm at one state: the arguments in the order of the table.
pub(super) fn evaluated(
    scene: &Scene,
    tolerance: Option<f64>,
    algorithm: Algorithm,
    given: &[&[f64]],
    out: &mut [f64],
) -> Result<(), Error> {
    let (state, seeds) = given.split_at(algorithm.entry().state);
    let of = |arrays: &[&'_ [f64]], place: usize| arrays.get(place).map_or_else(Vec::new, |array| array.to_vec());
    let [q, qd, u] = [0, 1, 2].map(|place| of(state, place));
    let seed = [0, 1, 2].map(|place| of(seeds, place));
    let state = Arguments {
        q: &q,
        qd: &qd,
        u: &u,
        seed: seed.each_ref().map(|seed| &seed[..]),
        tolerance: algorithm.form().and(tolerance),
        ..Arguments::default()
    };
    scene.evaluate(&mut scene.evaluator(), algorithm, &[state], out).map_err(|fault| fault.error)
}

/// The accelerations, and the margin of a single error estimate.
pub(super) fn forward_dynamics_watched(scene: &Scene, tolerance: Option<f64>, given: &[&[f64]], out: &mut [f64]) {
    let (model, sweeps) = (scene.model(), SweepModel::<f64>::new(scene.model()));
    let mut scratch = SweepScratch::new(model, &sweeps).accepting(tolerance);
    let (qdd, margin) = out.split_at_mut(scene.nv());
    let state = (given[0], given[1], given[2]);
    let estimate = general::forward_dynamics_with_estimate((model, &sweeps), &mut scratch, state, &[], qdd);
    margin[0] = ErrorEstimate::of_one_vector(estimate, scratch.accepted_square).margin();
}

/// The margin of the factor of M at `q`.
pub(super) fn margin_of_factor(scene: &Scene, tolerance: Option<f64>, q: &[f64]) -> f64 {
    let (model, sweeps) = (scene.model(), SweepModel::<f64>::new(scene.model()));
    let mut scratch = SweepScratch::new(model, &sweeps).accepting(tolerance);
    let mut estimates = vec![f64::NAN; scene.nv()];
    auto::estimated_factor((model, &sweeps), &mut scratch, q, &mut estimates).margin()
}
