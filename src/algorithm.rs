//! What is computed, from which arguments, and who computes it.

use crate::filter::Form;
use crate::spatial::SpatialVector;

/// What is computed from one state (q, qd, u).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Algorithm {
    /// u = tau; gives qdd, (nv).
    ForwardDynamics(Form),
    /// u = qdd; gives tau, (nv).
    InverseDynamics,
    /// No u; gives the torque of the bias, (nv).
    BiasTorque,
    /// q alone; gives M, (nv x nv) row by row.
    MassMatrix,
    /// q alone; gives M^-1, (nv x nv) row by row.
    MassMatrixInverse(Form),
}

/// The arguments of one state, in f64 or f32; what an algorithm does not take is empty.
#[derive(Debug, Clone, Copy, Default)]
pub struct Arguments<'a, P = f64> {
    /// Configuration, (nq).
    pub q: &'a [P],
    /// Rates, (nv).
    pub qd: &'a [P],
    /// Torques or accelerations, (nv).
    pub u: &'a [P],
    /// Forces on bodies, each in the body's frame, f64 always; empty where there are none.
    pub wrenches: &'a [SpatialVector<f64>],
}

/// What runs chunks of states in `P`, whatever its scalar.
pub trait Chunks<P>: Send + Sync {
    /// How many states at once.
    fn lanes(&self) -> usize;

    /// Runs `algorithm` on one state or more, at most as many as there are lanes, of equal shapes; results one after another in
    /// `out`. Gives the lanes in doubt as bits; their results mean nothing.
    fn run(&mut self, algorithm: Algorithm, states: &[Arguments<'_, P>], out: &mut [P]) -> u64;

    /// The estimated error of the largest acceleration of one lane of the last run of forward dynamics in form `auto`, in its unit.
    fn error(&self, lane: usize) -> f64;
}
