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
    /// Products with Jacobians, without the matrices.
    Products(Products),
}

/// A product with the Jacobian of inverse or forward dynamics; see [`dynamics::derivatives`](crate::dynamics::derivatives).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Products {
    /// u = qdd, seed = (dq, dqd, dqdd); gives dtau, (nv).
    InverseTangent,
    /// u = qdd, seed = the cotangent of tau; gives those of q, qd and qdd, (3 x nv).
    InverseGradient,
    /// u = tau, seed = (dq, dqd, dtau); gives dqdd, (nv).
    ForwardTangent(Form),
    /// u = tau, seed = the cotangent of qdd; gives those of q, qd and tau, (3 x nv).
    ForwardGradient(Form),
}

impl Products {
    /// What u is.
    #[must_use]
    pub fn third(self) -> &'static str {
        match self {
            Self::InverseTangent | Self::InverseGradient => "qdd",
            Self::ForwardTangent(_) | Self::ForwardGradient(_) => "tau",
        }
    }

    /// What the seed is, by the names of its vectors, (nv) each.
    #[must_use]
    pub fn seeds(self) -> &'static [&'static str] {
        match self {
            Self::InverseTangent => &["dq", "dqd", "dqdd"],
            Self::ForwardTangent(_) => &["dq", "dqd", "dtau"],
            Self::InverseGradient | Self::ForwardGradient(_) => &["cotangent"],
        }
    }

    /// How many vectors, (nv) each, it gives.
    #[must_use]
    pub fn count(self) -> usize {
        4 - self.seeds().len()
    }

    /// The form that it is done in, where it has any.
    #[must_use]
    pub fn form(self) -> Option<Form> {
        match self {
            Self::ForwardTangent(form) | Self::ForwardGradient(form) => Some(form),
            Self::InverseTangent | Self::InverseGradient => None,
        }
    }
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
            Self::Products(which) => (true, Some(which.third())),
        }
    }

    /// What its seed is; most have none.
    #[must_use]
    pub fn seeds(self) -> &'static [&'static str] {
        if let Self::Products(which) = self { which.seeds() } else { &[] }
    }

    /// The form that it is done in, where it has any.
    #[must_use]
    pub fn form(self) -> Option<Form> {
        match self {
            Self::ForwardDynamics(form)
            | Self::MassMatrixInverse(form)
            | Self::Derivatives(Derivatives::ForwardDynamics(form)) => Some(form),
            Self::Products(which) => which.form(),
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
    /// A direction or a cotangent, (nv) each: what [`Products`] multiply.
    pub seed: [&'a [P]; 3],
}

impl<P> Arguments<'_, P> {
    /// What an algorithm takes of them; the rest is empty.
    #[must_use]
    pub fn read_by(self, algorithm: Algorithm) -> Self {
        let (rates, third) = algorithm.reads();
        let qd = if rates { self.qd } else { &[] };
        let (u, wrenches) = if third.is_some() { (self.u, self.wrenches) } else { (&[][..], &[][..]) };
        let mut seed = [&[][..]; 3];
        for (seed, (given, _)) in seed.iter_mut().zip(self.seed.into_iter().zip(algorithm.seeds())) {
            *seed = given;
        }
        Self { q: self.q, qd, u, wrenches, seed }
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
