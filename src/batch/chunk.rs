//! A few states at once, one in each lane of a scalar, through one algorithm compiled for one arm.

use super::arms::{Vectorised, Work};
use crate::dynamics;
use crate::dynamics::mass_inverse::InverseScratch;
use crate::filter::Form;
use crate::scene::Model;
use crate::workspace::Workspace;
use std::sync::Arc;

/// What is computed from (q, qd, u) of a state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Algorithm {
    /// u = tau to qdd.
    ForwardDynamics(Form),
    /// u = qdd to tau.
    InverseDynamics,
    /// q to M.
    MassMatrix,
    /// q to M^-1.
    MassMatrixInverse(Form),
}

/// The arguments of one state: q, qd, u.
pub type Arguments<'a> = [&'a [f64]; 3];

/// Scratch for as many states as there are lanes.
#[derive(Debug)]
pub struct Chunk<T: Vectorised> {
    model: Arc<Model<T>>,
    workspace: Workspace<T>,
    inverse: Option<InverseScratch<T>>,
    arguments: [Vec<T>; 3],
    results: Vec<T>,
}

impl<T: Vectorised> Chunk<T> {
    /// Scratch for `model`.
    pub fn new(model: &Model<f64>) -> Self {
        let model: Model<T> = model.cast();
        let workspace = Workspace::new(&model);
        Self { model: Arc::new(model), workspace, inverse: None, arguments: Default::default(), results: Vec::new() }
    }

    /// Runs `algorithm` on up to as many states as there are lanes, results one after another; which lanes are in doubt, as bits.
    pub fn run(&mut self, algorithm: Algorithm, states: &[Arguments<'_>], out: &mut [f64]) -> u64 {
        T::within(Run { chunk: self, algorithm, states, out })
    }
}

struct Run<'a, T: Vectorised> {
    chunk: &'a mut Chunk<T>,
    algorithm: Algorithm,
    states: &'a [Arguments<'a>],
    out: &'a mut [f64],
}

impl<T: Vectorised> Work for Run<'_, T> {
    type Output = u64;

    #[inline(always)]
    fn call(self) -> u64 {
        let Chunk { model, workspace, arguments, results, inverse } = self.chunk;
        let (nv, states, count) = (model.nv(), self.states, self.states.len());
        for (k, argument) in arguments.iter_mut().enumerate() {
            let width = states[0][k].len();
            argument.resize(width, T::zero());
            for lane in 0..T::LANES {
                // Lanes without a state of their own repeat the last.
                let state = states[lane.min(count - 1)][k];
                for (number, &value) in argument.iter_mut().zip(state) {
                    number.lanes_mut()[lane] = value;
                }
            }
        }
        let width = self.out.len() / count;
        results.resize(width, T::zero());
        let [q, qd, u] = &*arguments;
        let mut doubt = 0;
        match self.algorithm {
            Algorithm::ForwardDynamics(form) => {
                let _ = form;
                let monitor = dynamics::forward::covariance_form::<T, false>(model, workspace, q, qd, u, &[], results);
                for lane in 0..count {
                    doubt |= u64::from(!monitor.clear(lane)) << lane;
                }
            }
            Algorithm::InverseDynamics => dynamics::inverse_dynamics(model, workspace, q, qd, u, &[], results),
            Algorithm::MassMatrix => dynamics::mass_matrix(model, workspace, q, results),
            Algorithm::MassMatrixInverse(form) => {
                workspace.form = form;
                let scratch = inverse.get_or_insert_with(|| InverseScratch::new(model));
                let monitor = dynamics::mass_matrix_inverse(model, workspace, scratch, q, results);
                for lane in 0..count {
                    doubt |= u64::from(!monitor.clear(lane)) << lane;
                }
            }
        }
        let _ = nv;
        for (lane, out) in self.out.chunks_exact_mut(width).enumerate() {
            for (value, number) in out.iter_mut().zip(results.iter()) {
                *value = number.lane(lane);
            }
        }
        doubt
    }
}
