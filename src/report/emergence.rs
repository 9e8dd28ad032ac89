//! Five methods for M, each with its time and error: sampling of the random model (5.1), and algebra.

use crate::algorithm::{Algorithm, Arguments};
use crate::batch::evaluator::Evaluator;
use crate::dynamics;
use crate::error::{Error, named};
use crate::memory;
use crate::model::Model;
use crate::operators::dense::Composite;
use crate::report::growth::median_ns;
use crate::scalar::{DoubleDouble, Real};
use crate::scene::Scene;
use crate::stochastic::{Method, RandomModel};
use crate::workspace::Workspace;
use std::hint::black_box;

named! {
    /// A method that computes M at q.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    #[non_exhaustive]
    enum Route;
    /// All routes with their names.
    const ROUTES {
        /// Independent samples.
        MonteCarlo = "monte-carlo",
        /// One scramble of Sobol points.
        Sobol = "sobol",
        /// Sigma points.
        SigmaPoints = "sigma-points",
        /// Composite inertias (3.5), with [`Scene::evaluate`].
        Recursion = "recursion",
        /// H phi Q phi* H* with dense matrices (5.1).
        DenseProduct = "dense product",
    }
}

impl Route {
    /// M at `q`; `samples` and `seed` are used by the first two routes only.
    fn run(
        self,
        scene: &Scene,
        evaluator: &mut Evaluator,
        q: &[f64],
        (samples, seed): (usize, u64),
    ) -> Result<Vec<f64>, Error> {
        let nv = scene.nv();
        let centerd = || -> Result<RandomModel, Error> { scene.random_model(q, None, 1.0) };
        match self {
            Self::MonteCarlo => {
                let method = Method::MonteCarlo { samples, seed, confidence: 0.95 };
                Ok(centerd()?.mass_matrix(method)?.mass_matrix)
            }
            Self::Sobol => centerd()?.sobol_estimate(samples, seed, 0),
            Self::SigmaPoints => Ok(centerd()?.mass_matrix(Method::SigmaPoints)?.mass_matrix),
            Self::Recursion => {
                let mut m = memory::filled("scene", nv.saturating_mul(nv), f64::NAN)?;
                let state = Arguments { q, ..Arguments::default() };
                scene.evaluate(evaluator, Algorithm::MassMatrix, &[state], &mut m).map_err(|fault| fault.error)?;
                Ok(m)
            }
            Self::DenseProduct => {
                let m = Composite::new(scene.model(), q)?.mass_matrix()?;
                Ok((0..nv * nv).map(|at| m[(at / nv, at % nv)]).collect())
            }
        }
    }
}

/// Median time of one route, ns, including the construction of its random model and result matrix, and its error: the
/// Frobenius norm of the difference from M in double-double arithmetic, relative to that of M.
///
/// # Errors
///
/// As the route.
pub fn emergence(
    scene: &Scene,
    q: &[f64],
    route: Route,
    (samples, seed): (usize, u64),
    repeats: usize,
) -> Result<(f64, f64), Error> {
    let mut evaluator = scene.evaluator();
    let found = route.run(scene, &mut evaluator, q, (samples, seed))?;
    let mut outcome = Ok(());
    let ns = median_ns(repeats, &mut || {
        let found = black_box(route.run(scene, &mut evaluator, black_box(q), (samples, seed)));
        outcome = found.map(|_| ());
    })?;
    outcome?;
    let model: Model<DoubleDouble> = scene.model().cast();
    let mut exact = memory::filled("scene", found.len(), DoubleDouble::from_f64(f64::NAN))?;
    dynamics::mass_matrix(&model, &mut Workspace::new(&model), &DoubleDouble::each_of(q), &mut exact);
    let (mut off, mut size) = (0.0, 0.0);
    for (&found, &exact) in found.iter().zip(&exact) {
        off += (DoubleDouble::from_f64(found) - exact).lane(0).powi(2);
        size += exact.lane(0).powi(2);
    }
    Ok((ns, if size == 0.0 { 0.0 } else { (off / size).sqrt() }))
}
