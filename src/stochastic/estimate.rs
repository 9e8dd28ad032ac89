//! M from the covariance of T (5.1): Monte Carlo, scrambled Sobol points, sigma points.

use super::interval::{Quantiles, students_quantile};
use super::model::{Block, COST, RandomModel, Wanted};
use super::points::Points;
use super::sobol::BLOCK;
use crate::batch::{Batch, Pool};
use crate::error::Error;
use crate::memory;

/// Number of samples that one thread sums before the sums of other threads are added; fixed, so that results do not
/// depend on the number of threads.
const PIECE: usize = 256 * BLOCK;

/// Number of scalars of piece sums that are stored at a time, and the bounds on the number of pieces.
const AT_ONCE: usize = 1 << 22;
const LEAST: usize = 32;
const MOST: usize = 1 << 14;

/// The estimator of M.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Method {
    /// Independent samples.
    MonteCarlo {
        /// Number of samples.
        samples: usize,
        /// Seed of the random numbers.
        seed: u64,
        /// Confidence level of the intervals, between 0 and 1.
        confidence: f64,
    },
    /// Scrambled Sobol points, several scrambles of a power of two each.
    Sobol {
        /// Total number of samples.
        samples: usize,
        /// Seed of the scrambles.
        seed: u64,
        /// Number of scrambles; their scatter gives the intervals.
        replicates: usize,
        /// Confidence level of the intervals, between 0 and 1.
        confidence: f64,
    },
    /// The sigma points: exact.
    SigmaPoints,
}

/// An estimate of the mass matrix, (nv x nv) row by row, symmetric.
#[derive(Debug, Clone, PartialEq)]
pub struct MassEstimate {
    /// The estimate.
    pub mass_matrix: Vec<f64>,
    /// Its error estimate; None for sigma points.
    pub spread: Option<Spread>,
    /// Number of points.
    pub samples: usize,
}

/// Standard errors and confidence intervals of single entries: the stated confidence holds for each entry, not for all
/// entries together.
#[derive(Debug, Clone, PartialEq)]
pub struct Spread {
    /// Standard error of each entry.
    pub standard_error: Vec<f64>,
    /// Lower bounds.
    pub low: Vec<f64>,
    /// Upper bounds.
    pub high: Vec<f64>,
}

impl RandomModel {
    /// M from the covariance of the centered torques T (5.1), in kg m^2: the acceleration variance cancels.
    ///
    /// O(samples nv^2). Monte Carlo and Sobol estimates are parallel; their bits do not depend on the number of
    /// threads.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for zero samples, a confidence out of range, Sobol samples that are not `replicates` times a
    /// power of two, fewer than two replicates, or more than 1000 random numbers per sample with Sobol points;
    /// [`Error::Memory`] if the replicates or the matrix exceed the available memory; [`Error::Interrupted`] if an
    /// [`interrupt`](crate::interrupt) ends the work.
    pub fn mass_matrix(&self, method: Method) -> Result<MassEstimate, Error> {
        let nv = self.nv();
        // M, its error, the bounds of the intervals, and intermediate sums.
        memory::room("scene", memory::bytes_of::<f64>(&[nv, nv, 6]))?;
        match method {
            Method::MonteCarlo { samples, seed, confidence } => {
                let quantiles = Quantiles::new(samples, confidence)?;
                let mass_matrix = self.second_moment(&Points::random(seed), samples)?;
                let spread = Some(self.spread_of_samples(&mass_matrix, samples, &quantiles));
                Ok(MassEstimate { mass_matrix, spread, samples })
            }
            Method::Sobol { samples, seed, replicates, confidence } => {
                memory::room("replicates", memory::bytes_of::<f64>(&[nv * nv + 4, replicates]))?;
                let quantile = students_quantile(replicates, confidence)?;
                let each = samples / replicates;
                if each * replicates != samples || !each.is_power_of_two() {
                    let near = each.max(1).checked_next_power_of_two().and_then(|each| each.checked_mul(replicates));
                    let such = near.map_or_else(String::new, |near| format!(", such as {near}"));
                    let expected = format!("{replicates} replicates of a power of two each{such}");
                    return Err(Error::argument("samples", samples.to_string(), expected));
                }
                let mut estimates = memory::with_capacity("replicates", replicates)?;
                for replicate in 0..replicates as u64 {
                    estimates.push(self.sobol_estimate(each, seed, replicate)?);
                }
                Ok(of_replicates(&estimates, quantile, samples))
            }
            Method::SigmaPoints => {
                let mut mass_matrix = vec![f64::NAN; nv * nv];
                let samples = self.sigma_points(&mut mass_matrix)?;
                Ok(MassEstimate { mass_matrix, spread: None, samples })
            }
        }
    }

    /// One scramble of Sobol points. Its error cannot be estimated without replicates.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for more than 1000 random numbers per sample.
    pub fn sobol_estimate(&self, samples: usize, seed: u64, replicate: u64) -> Result<Vec<f64>, Error> {
        self.second_moment(&Points::sobol(self.dimension(), seed, replicate)?, samples)
    }

    /// The mean of T T^T over the first `samples` points, divided by the acceleration variance.
    fn second_moment(&self, points: &Points, samples: usize) -> Result<Vec<f64>, Error> {
        let nv = self.nv();
        let width = nv * (nv + 1) / 2;
        let pieces = samples.div_ceil(PIECE);
        self.check_blocks()?;
        // A limited number of pieces is summed at a time, in their order, so that memory does not grow with the
        // samples.
        let together = (AT_ONCE / width.max(1)).clamp(LEAST, MOST).min(pieces);
        let mut sums = memory::filled("scene", together * width, f64::NAN)?;
        let mut total = memory::filled("scene", width, 0.0)?;
        let pool = Pool::default();
        let cost = (PIECE.min(samples) * COST).saturating_mul(self.dimension() + nv * nv / 16);
        for begin in (0..pieces).step_by(together.max(1)) {
            let states = together.min(pieces - begin);
            let sums = &mut sums[..states * width];
            let batch = Batch { states, cost, pool: &pool, make: || self.block() };
            let done = batch.run(sums, |block, piece, sums| {
                sums.fill(0.0);
                let piece = begin + piece;
                let end = samples.min((piece + 1) * PIECE);
                for first in (piece * PIECE..end).step_by(BLOCK) {
                    self.draw(block, points.block((first / BLOCK) as u64), Wanted::CentredTorque)?;
                    add_products(block, BLOCK.min(end - first), sums);
                }
                Ok(())
            });
            done.map_err(|fault| fault.error)?;
            for sums in sums.chunks_exact(width.max(1)) {
                for (total, sum) in total.iter_mut().zip(sums) {
                    *total += sum;
                }
            }
        }
        #[allow(clippy::cast_precision_loss)] // a count
        let scale = 1.0 / (samples as f64 * self.acceleration_variance());
        let mut moment = vec![f64::NAN; nv * nv];
        let pairs = (0..nv).flat_map(|i| (i..nv).map(move |j| (i, j)));
        for (sum, (i, j)) in total.into_iter().zip(pairs) {
            moment[i * nv + j] = sum * scale;
            moment[j * nv + i] = sum * scale;
        }
        Ok(moment)
    }

    fn spread_of_samples(&self, m: &[f64], samples: usize, quantiles: &Quantiles) -> Spread {
        let nv = self.nv();
        let mut spread = Spread::unset(nv);
        #[allow(clippy::cast_precision_loss)] // a count
        let n = samples as f64;
        for i in 0..nv {
            for j in 0..nv {
                let (at, variances) = (i * nv + j, (m[i * nv + i], m[j * nv + j]));
                (spread.low[at], spread.high[at]) = quantiles.interval(variances, m[at]);
                // The fourth moments of normal variables, with estimates in the place of the true moments.
                spread.standard_error[at] = ((variances.0 * variances.1 + m[at] * m[at]) / n).sqrt();
            }
        }
        spread
    }
}

impl Spread {
    fn unset(nv: usize) -> Self {
        let unset = || vec![f64::NAN; nv * nv];
        Self { standard_error: unset(), low: unset(), high: unset() }
    }
}

/// Adds the products of the torques of the first `count` samples, upper triangle by rows.
fn add_products(block: &Block, count: usize, sums: &mut [f64]) {
    let mut at = 0;
    for (i, left) in block.torque.iter().enumerate() {
        for right in &block.torque[i..] {
            sums[at] += inner(&left[..count], &right[..count]);
            at += 1;
        }
    }
}

/// The inner product in eight partial sums, which the compiler turns into vector instructions.
fn inner(a: &[f64], b: &[f64]) -> f64 {
    let mut partial = [0.0; 8];
    let (left, right) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f64 = left.remainder().iter().zip(right.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in left.zip(right) {
        for (sum, (a, b)) in partial.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    partial.iter().sum::<f64>() + rest
}

/// Mean and scatter of independent estimates.
fn of_replicates(estimates: &[Vec<f64>], quantile: f64, samples: usize) -> MassEstimate {
    let entries = estimates.first().map_or(0, Vec::len);
    #[allow(clippy::cast_precision_loss)] // a count
    let count = estimates.len() as f64;
    let mean: Vec<f64> = (0..entries).map(|at| estimates.iter().map(|m| m[at]).sum::<f64>() / count).collect();
    let standard_error: Vec<f64> = (0..entries)
        .map(|at| {
            let squares: f64 = estimates.iter().map(|m| (m[at] - mean[at]).powi(2)).sum();
            (squares / (count * (count - 1.0))).sqrt()
        })
        .collect();
    let end = |sign: f64| mean.iter().zip(&standard_error).map(|(m, e)| m + sign * quantile * e).collect();
    let spread = Some(Spread { low: end(-1.0), high: end(1.0), standard_error });
    MassEstimate { mass_matrix: mean, spread, samples }
}

#[cfg(all(test, feature = "parallel"))]
mod tests {
    use super::*;

    #[test]
    fn same_bits_for_any_number_of_threads() -> Result<(), Error> {
        let model = crate::scenes::chain(7)?.random_model(&[0.4; 7], Some(&[0.2; 7]), 2.0)?;
        let all = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| -> Result<_, Error> {
                let monte_carlo = Method::MonteCarlo { samples: 40_000, seed: 3, confidence: 0.9 };
                let sobol = Method::Sobol { samples: 1 << 16, seed: 3, replicates: 2, confidence: 0.9 };
                let samples = model.sample(&Points::random(5), 7..2_000)?;
                Ok((model.mass_matrix(monte_carlo)?, model.mass_matrix(sobol)?, samples))
            })
        };
        let alone = all(1)?;
        assert!(alone.0.mass_matrix.iter().chain(&alone.2.force).all(|x| x.is_finite()));
        assert_eq!(alone, all(2)?);
        assert_eq!(alone, all(5)?);
        Ok(())
    }
}
