//! Scrambled Sobol points, for unbiased estimates with an error estimate.
//!
//! The direction numbers are those of Joe and Kuo. Scrambling is linear (Matousek 1998): the binary digits of each
//! coordinate are multiplied by a random lower triangular matrix over the integers mod 2 and shifted by a random
//! vector. This preserves the net and makes every point uniform. The matrix is applied to the direction numbers, so
//! that it adds no cost per point.

use crate::error::Error;
use rand_chacha::rand_core::Rng;
use sobol::params::JoeKuoD6;
use statrs::function::erf::erfc_inv;

/// Number of samples that are drawn together: one stream of random numbers, one pass of each loop.
pub const BLOCK: usize = 64;

/// One number for each sample of a block.
pub type Lane = [f64; BLOCK];

/// The number of dimensions with direction numbers.
pub const DIMENSIONS: usize = 1000;

/// Binary digits of a coordinate: one fewer than a float holds, so that the middle of the last cell is a float too.
const DIGITS: u32 = 52;

/// Digits of the direction numbers: the sequence has 2^32 points.
const LEVELS: usize = 32;

/// A scrambled sequence.
#[derive(Debug, Clone)]
pub(super) struct Sobol {
    dimensions: Vec<Dimension>,
}

/// One coordinate: scrambled direction numbers and shift.
#[derive(Debug, Clone)]
struct Dimension {
    directions: [u64; LEVELS],
    shift: u64,
}

impl Sobol {
    pub fn new(dimension: usize, random: &mut impl Rng) -> Result<Self, Error> {
        if dimension > DIMENSIONS {
            return Err(Error::argument(
                "method",
                format!("Sobol points for a scene with {dimension} random numbers a sample"),
                format!("at most {DIMENSIONS}; use monte-carlo or sigma-points"),
            ));
        }
        let parameters = if dimension <= 100 { JoeKuoD6::minimal() } else { JoeKuoD6::standard() };
        let plain = sobol::Sobol::<u32>::init_direction_vals(dimension, LEVELS, &parameters);
        Ok(Self { dimensions: plain.iter().map(|directions| scramble(directions, random)).collect() })
    }

    /// Number of coordinates of a point.
    pub fn dimension(&self) -> usize {
        self.dimensions.len()
    }

    /// The points from `first`, which is a multiple of the block's length.
    pub fn run(&self, first: u64) -> Run<'_> {
        Run { dimensions: &self.dimensions, first, next: 0 }
    }
}

/// A random lower triangular matrix with ones on its diagonal, times the digits of each direction number; and a shift.
fn scramble(plain: &[u32], random: &mut impl Rng) -> Dimension {
    let mut directions = [0; LEVELS];
    for digit in 0..DIGITS {
        // The digits of the direction number whose sum is this digit of the result; the first digit is the highest.
        let earlier = if digit == 0 { 0 } else { u32::MAX << (32 - digit.min(32)) };
        let own = if digit < 32 { 1 << (31 - digit) } else { 0 };
        let row = (random.next_u32() & earlier) | own;
        for (scrambled, &direction) in directions.iter_mut().zip(plain) {
            let parity = u64::from((row & direction).count_ones() & 1);
            *scrambled |= parity << (DIGITS - 1 - digit);
        }
    }
    Dimension { directions, shift: random.next_u64() >> (64 - DIGITS) }
}

/// Consecutive points, coordinate by coordinate.
pub(super) struct Run<'a> {
    dimensions: &'a [Dimension],
    first: u64,
    next: usize,
}

impl Run<'_> {
    /// The next coordinate of every point, as a standard normal number.
    pub fn next(&mut self, lane: &mut Lane) {
        debug_assert_eq!(self.first % BLOCK as u64, 0);
        let Some(dimension) = self.dimensions.get(self.next) else {
            lane.fill(f64::NAN);
            return;
        };
        self.next += 1;
        // Points in the order of Gray codes: consecutive points differ by one direction number.
        let gray = self.first ^ (self.first >> 1);
        let set = dimension.directions.iter().enumerate().filter(|(level, _)| gray >> level & 1 == 1);
        let mut digits = set.fold(dimension.shift, |digits, (_, direction)| digits ^ direction);
        for (point, x) in (self.first..).zip(lane.iter_mut()) {
            *x = normal(digits);
            digits ^= dimension.directions[((point + 1).trailing_zeros() as usize).min(LEVELS - 1)];
        }
    }
}

/// The quantile of the standard normal distribution at the middle of a cell of the unit interval.
fn normal(digits: u64) -> f64 {
    // Twice the probability: (digits + 1/2) / 2^52 is exact, its double too.
    #[allow(clippy::cast_precision_loss)] // 53 bits
    let twice = (2 * digits + 1) as f64 / (1_u64 << DIGITS) as f64;
    -std::f64::consts::SQRT_2 * erfc_inv(twice)
}

#[cfg(test)]
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // numbers of cells
mod tests {
    use super::*;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use statrs::function::erf::erfc;

    fn uniform(sobol: &Sobol, points: usize) -> Vec<Vec<f64>> {
        let mut columns = vec![Vec::new(); sobol.dimensions.len()];
        for block in 0..points / BLOCK {
            let mut run = sobol.run((block * BLOCK) as u64);
            for column in &mut columns {
                let mut lane = [f64::NAN; BLOCK];
                run.next(&mut lane);
                column.extend(lane.iter().map(|x| erfc(-x / std::f64::consts::SQRT_2) / 2.0));
            }
        }
        columns
    }

    #[test]
    fn every_coordinate_has_one_point_in_each_cell() {
        let sobol = Sobol::new(150, &mut ChaCha8Rng::seed_from_u64(1)).expect("few dimensions");
        for column in uniform(&sobol, 256) {
            let mut cells: Vec<u32> = column.iter().map(|u| (u * 256.0) as u32).collect();
            cells.sort_unstable();
            assert_eq!(cells, (0..256).collect::<Vec<_>>());
        }
    }

    #[test]
    fn the_first_two_coordinates_are_a_net() {
        let sobol = Sobol::new(2, &mut ChaCha8Rng::seed_from_u64(2)).expect("few dimensions");
        let columns = uniform(&sobol, 256);
        for across in [2.0_f64, 4.0, 16.0, 64.0, 128.0] {
            let along = 256.0 / across;
            let cell = |(u, v): (&f64, &f64)| (u * across) as u32 * along as u32 + (v * along) as u32;
            let mut cells: Vec<u32> = columns[0].iter().zip(&columns[1]).map(cell).collect();
            cells.sort_unstable();
            assert_eq!(cells, (0..256).collect::<Vec<_>>(), "{across} by {along}");
        }
    }

    #[test]
    fn a_run_from_the_middle_is_the_sequence() {
        let sobol = Sobol::new(3, &mut ChaCha8Rng::seed_from_u64(3)).expect("few dimensions");
        let dimension = &sobol.dimensions[2];
        let mut lane = [f64::NAN; BLOCK];
        let mut run = sobol.run(5 * BLOCK as u64);
        (0..3).for_each(|_| run.next(&mut lane));
        for (point, x) in (5 * BLOCK as u64..).zip(lane) {
            let gray = point ^ (point >> 1);
            let digits = (0..LEVELS).filter(|level| gray >> level & 1 == 1);
            let digits = digits.fold(dimension.shift, |digits, level| digits ^ dimension.directions[level]);
            assert_eq!(x.to_bits(), normal(digits).to_bits());
        }
    }

    #[test]
    fn too_many_dimensions_say_what_to_use() {
        let error = Sobol::new(DIMENSIONS + 1, &mut ChaCha8Rng::seed_from_u64(4)).expect_err("too many");
        assert!(error.to_string().contains("monte-carlo"), "{error}");
    }
}
