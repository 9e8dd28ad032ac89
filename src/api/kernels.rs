//! The compiled kernels for one state that a workspace stores.

use crate::algorithm::{Algorithm, Arguments};
use crate::batch::independent::Kernels;
use crate::batch::instruction_set::InstructionSet;
use crate::filter::Form;
use crate::scene::Scene;
use crate::spatial::SpatialVector;
use crate::workspace::OwnKernels;

/// A workspace allocates the scratch of M and M^-1 in advance up to this number of degrees of freedom, because it is as
/// large as the matrices.
const MATRICES_AHEAD: usize = 128;

/// Kernels of `scene` that allocate nothing more: runs each algorithm once, so that it allocates its scratch.
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

/// Runs one state, whose array lengths were checked. Returns false if the result is invalid: the error estimate exceeds
/// the tolerance, or the kernels belong to another scene.
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
        .get_or_insert_with(|| (scene.identity(), Kernels::new(InstructionSet::of_process(), scene).for_one_state()));
    let Some(kernels) = kernels else { return false };
    *of == scene.identity() && kernels.run(algorithm, std::slice::from_ref(state), out) & 1 == 0
}
