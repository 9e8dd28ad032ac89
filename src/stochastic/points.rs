//! Sources of standard normal numbers: counter-based pseudo-random streams, or scrambled Sobol points.

use super::sobol::{BLOCK, Lane, Run, Sobol};
use crate::error::Error;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

/// A sequence of points with independent standard normal coordinates, with random access to its blocks.
#[derive(Debug, Clone)]
pub struct Points(Kind);

#[derive(Debug, Clone)]
enum Kind {
    Random { seed: u64 },
    Sobol(Sobol),
}

impl Points {
    /// Pseudo-random points: block i is stream i of the `ChaCha8` generator with this seed.
    #[must_use]
    pub fn random(seed: u64) -> Self {
        Self(Kind::Random { seed })
    }

    /// Sobol points in `dimension` dimensions, scrambled by the seed and the number of the replicate.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for more dimensions than there are direction numbers.
    pub fn sobol(dimension: usize, seed: u64, replicate: u64) -> Result<Self, Error> {
        // Streams from the end of the range, so that no scramble shares a stream with a block of samples.
        let mut random = stream(seed, u64::MAX - replicate);
        Ok(Self(Kind::Sobol(Sobol::new(dimension, &mut random)?)))
    }

    /// Checks that a point has one coordinate for each random number of a sample.
    pub(super) fn check(&self, dimension: usize) -> Result<(), Error> {
        match &self.0 {
            Kind::Sobol(sobol) if sobol.dimension() < dimension => {
                let found = format!("Sobol points in {} dimensions", sobol.dimension());
                Err(Error::argument("points", found, format!("{dimension}, one for each random number of a sample")))
            }
            _ => Ok(()),
        }
    }

    /// The coordinates of block `index`, to be read one after another.
    pub(super) fn block(&self, index: u64) -> Coordinates<'_> {
        match &self.0 {
            Kind::Random { seed } => Coordinates::Random(Box::new(stream(*seed, index))),
            Kind::Sobol(sobol) => Coordinates::Sobol(sobol.run(index * BLOCK as u64)),
        }
    }
}

fn stream(seed: u64, index: u64) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(index);
    random
}

/// The coordinates of the points of one block.
pub(super) enum Coordinates<'a> {
    Random(Box<ChaCha8Rng>),
    Sobol(Run<'a>),
}

impl Coordinates<'_> {
    /// The next coordinate of every point.
    pub fn next(&mut self, lane: &mut Lane) {
        match self {
            Self::Random(random) => lane.iter_mut().for_each(|x| *x = StandardNormal.sample(random)),
            Self::Sobol(run) => run.next(lane),
        }
    }
}
