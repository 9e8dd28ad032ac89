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
    /// Matrices that come of derivatives.
    Derivatives(Derivatives),
}

/// What is differentiated; see [`dynamics::derivatives`](crate::dynamics::derivatives).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Derivatives {
    /// u = qdd; gives dtau/dq, dtau/dqd and M, (3 x nv x nv).
    InverseDynamics,
    /// u = tau; gives dqdd/dq, dqdd/dqd and M^-1, (3 x nv x nv).
    ForwardDynamics(Form),
    /// No u; gives the Coriolis matrix, (nv x nv).
    CoriolisMatrix,
    /// No u; gives dM/dt, (nv x nv).
    MassMatrix,
}

impl Derivatives {
    /// What u is; none is taken where there is no name.
    #[must_use]
    pub fn third(self) -> Option<&'static str> {
        match self {
            Self::InverseDynamics => Some("qdd"),
            Self::ForwardDynamics(_) => Some("tau"),
            Self::CoriolisMatrix | Self::MassMatrix => None,
        }
    }

    /// How many matrices.
    #[must_use]
    pub fn count(self) -> usize {
        if self.third().is_some() { 3 } else { 1 }
    }
}

impl Algorithm {
    /// Whether it takes rates, and what its u is: none where there is no name. Wrenches go with u.
    #[must_use]
    pub fn reads(self) -> (bool, Option<&'static str>) {
        match self {
            Self::ForwardDynamics(_) => (true, Some("tau")),
            Self::InverseDynamics => (true, Some("qdd")),
            Self::BiasTorque => (true, None),
            Self::MassMatrix | Self::MassMatrixInverse(_) => (false, None),
            Self::Derivatives(which) => (true, which.third()),
        }
    }

    /// The form that it is done in, where it has any.
    #[must_use]
    pub fn form(self) -> Option<Form> {
        match self {
            Self::ForwardDynamics(form)
            | Self::MassMatrixInverse(form)
            | Self::Derivatives(Derivatives::ForwardDynamics(form)) => Some(form),
            _ => None,
        }
    }
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

impl<P> Arguments<'_, P> {
    /// What an algorithm takes of them; the rest is empty.
    #[must_use]
    pub fn read_by(self, algorithm: Algorithm) -> Self {
        let (rates, third) = algorithm.reads();
        let qd = if rates { self.qd } else { &[] };
        let (u, wrenches) = if third.is_some() { (self.u, self.wrenches) } else { (&[][..], &[][..]) };
        Self { q: self.q, qd, u, wrenches }
    }
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
