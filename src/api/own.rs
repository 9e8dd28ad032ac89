//! The compiled kernels of one state that a workspace carries.

use crate::algorithm::{Algorithm, Arguments};
use crate::batch::evaluator::Evaluated;
use crate::batch::instruction_set::InstructionSet;
use crate::filter::Form;
use crate::scene::Scene;
use crate::spatial::SpatialVector;
use crate::workspace::OwnKernels;

/// Scratch of M and M^-1, which can be as large as they, is made with the workspace up to so many degrees of freedom.
const MATRICES_AHEAD: usize = 128;

/// Kernels for `scene` that need nothing more: each algorithm was run once, and has made its scratch.
pub(super) fn ready(scene: &Scene) -> OwnKernels {
    let mut kernels = OwnKernels::default();
    let (q, zeros) = (scene.neutral(), vec![0.0; scene.nv()]);
    let forces = vec![SpatialVector::zeros(); scene.model().bodies.len()];
    let mut out = vec![0.0; scene.nv()];
    let mut run = |algorithm, state: &Arguments<'_>, out: &mut Vec<f64>| {
        out.resize(scene.width(algorithm), 0.0);
        self::run(&mut kernels, scene, algorithm, state, out);
    };
    let full = Arguments { q: &q, qd: &zeros, u: &zeros, wrenches: &forces, ..Arguments::default() };
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

/// One state, of lengths that fit; false where its results mean nothing: it is in doubt, or the kernels are another
/// scene's.
#[inline]
pub(super) fn run(
    own: &mut OwnKernels,
    scene: &Scene,
    algorithm: Algorithm,
    state: &Arguments<'_>,
    out: &mut [f64],
) -> bool {
    let (of, kernels) = own
        .0
        .get_or_insert_with(|| (scene.identity(), f64::kernels(InstructionSet::of_process(), scene).for_one_state()));
    *of == scene.identity() && kernels.run(algorithm, std::slice::from_ref(state), out) & 1 == 0
}
