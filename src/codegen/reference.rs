//! Reference results of the scene for the arguments of a function, one after another; generated tests compare with
//! them.

use crate::algorithm::{Algorithm, Arguments};
use crate::error::Error;
use crate::scene::Scene;

/// An algorithm at one state: the arguments in the order of the table.
pub(super) fn evaluated(scene: &Scene, algorithm: Algorithm, given: &[&[f64]], out: &mut [f64]) -> Result<(), Error> {
    let (state, seeds) = given.split_at(algorithm.entry().state);
    let of = |arrays: &[&'_ [f64]], place: usize| arrays.get(place).map_or_else(Vec::new, |array| array.to_vec());
    let [q, qd, u] = [0, 1, 2].map(|place| of(state, place));
    let seed = [0, 1, 2].map(|place| of(seeds, place));
    let state =
        Arguments { q: &q, qd: &qd, u: &u, seed: seed.each_ref().map(|seed| &seed[..]), ..Arguments::default() };
    scene.evaluate(&mut scene.evaluator(), algorithm, &[state], out).map_err(|fault| fault.error)
}
