//! The compiled kernels of one state that a workspace carries, for the methods of the scene that it is of.

use super::arms::Arm;
use super::chunk::{Algorithm, Arguments};
use super::evaluator::{Evaluated, Kernels};
use crate::filter::Form;
use crate::scene::Scene;
use crate::scene::queries::MATRICES_AHEAD;
use crate::spatial::SpatialVector;

/// Kernels with the constants of one scene; made by the first call where there are none, and never used for another scene.
#[derive(Default)]
pub(crate) struct OwnKernels(Option<(u64, Kernels<f64>)>);

/// A copy has none yet: kernels are not copied, but made again.
impl Clone for OwnKernels {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl std::fmt::Debug for OwnKernels {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("OwnKernels").field(&self.0.as_ref().map(|(scene, _)| scene)).finish()
    }
}

impl OwnKernels {
    /// Kernels for `scene` that need nothing more: each algorithm was run once, and has made its scratch.
    pub fn ready(scene: &Scene) -> Self {
        let mut kernels = Self::default();
        let (q, zeros) = (scene.neutral(), vec![0.0; scene.nv()]);
        let forces = vec![SpatialVector::zeros(); scene.model().bodies.len()];
        let mut out = vec![0.0; scene.nv()];
        let mut run = |algorithm, state: &Arguments<'_>, out: &mut Vec<f64>| {
            out.resize(scene.width(algorithm), 0.0);
            kernels.run(scene, algorithm, state, out);
        };
        let full = Arguments { q: &q, qd: &zeros, u: &zeros, wrenches: &forces };
        for form in [Form::Auto, Form::Covariance, Form::SquareRoot] {
            run(Algorithm::ForwardDynamics(form), &full, &mut out);
        }
        run(Algorithm::InverseDynamics, &full, &mut out);
        if scene.nv() <= MATRICES_AHEAD {
            let configuration = Arguments { q: &q, ..Arguments::default() };
            for algorithm in [
                Algorithm::MassMatrix,
                Algorithm::MassMatrixInverse(Form::Auto),
                Algorithm::MassMatrixInverse(Form::Covariance),
            ] {
                run(algorithm, &configuration, &mut out);
            }
        }
        kernels
    }

    /// One state, of lengths that fit; false where its results mean nothing: it is in doubt, or the kernels are another scene's.
    #[inline]
    pub fn run(&mut self, scene: &Scene, algorithm: Algorithm, state: &Arguments<'_>, out: &mut [f64]) -> bool {
        let (of, kernels) =
            self.0.get_or_insert_with(|| (scene.identity(), f64::kernels(Arm::of_process(), scene).for_one_state()));
        *of == scene.identity() && kernels.run(algorithm, std::slice::from_ref(state), out) & 1 == 0
    }
}
