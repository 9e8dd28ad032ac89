//! Derivatives of the dynamics by configuration, rates and torques: Jacobians of (nv x nv), analytic.
//!
//! By q they are taken along tangents d of q (+) d, as [`Scene::integrate`](crate::Scene::integrate) adds them: coordinates of one axis add, spherical
//! joints turn by d in the child's axes, free joints move by the screw of d = (linear, angular) in the child's frame.
//! Wrenches are held in their body's frame; armature is in M and in nothing else.
//!
//! What a turn of joint j by the twist s does to body k outboard of it is that the world inboard of j moves by -s: with `V_p`, `A_p` the motion of j's
//! parent seen at j, the velocity that k feels changes by Psi1 = `V_p` x s and its acceleration by Psi2 = `A_p` x s + `V_p` x Psi1, but for what is
//! carried along. Forces that are handed inward from j change in addition by s x* F, for a frame that moved carries them.
//! Everything is in body frames, where digits do not depend on how far from the base's origin a robot is.

mod columns;
mod coriolis;
mod doubled;
mod forward;
mod hinge;
mod inverse;
mod linear;
mod outward;

pub use coriolis::BodyCoriolis;
pub use forward::{ForwardDerivatives, forward_dynamics_derivatives};
pub use inverse::{InverseDerivatives, inverse_dynamics_derivatives};
pub use linear::linearize;

use super::mass_inverse::InverseScratch;
use crate::error::Error;
use crate::model::Model;
use crate::scalar::Real;
use outward::Felt;

/// Bodies between questions whether to stop; scenes of fewer are done without.
pub(crate) const AT_A_TIME: usize = 16;

/// Operations a body of one column through filter and smoother.
const A_COLUMN: usize = 109;

/// Scratch that only derivatives need, beside the workspace; starts as NaN.
#[derive(Debug, Clone)]
pub struct DerivativeScratch<T: Real> {
    /// B(k), then that of all bodies outboard of joint k.
    coriolis: Vec<BodyCoriolis<T>>,
    /// What a unit of each degree of freedom lets its body feel.
    felt: Vec<Felt<T>>,
    /// One number a degree of freedom: torques, then a column, and what becomes of it.
    column: Vec<T>,
    product: Vec<T>,
    /// The largest entry of each row of M^-1.
    largest: Vec<T>,
    /// The accelerations of the state.
    acceleration: Vec<T>,
    /// The last body outboard of each.
    last: Vec<usize>,
    /// Whether columns through filter and smoother are fewer operations than products with M^-1.
    by_columns: bool,
    inverse: InverseScratch<T>,
}

impl<T: Real> DerivativeScratch<T> {
    /// Scratch for `model`.
    #[must_use]
    pub fn new(model: &Model<T>) -> Self {
        let nan = T::from_f64(f64::NAN);
        let (bodies, nv) = (model.bodies.len(), model.nv());
        let stages = &model.system.stages;
        let mut last: Vec<usize> = (0..bodies).collect();
        let mut inboard = vec![0; bodies];
        for (k, stage) in stages.iter().enumerate() {
            inboard[k] = stage.parent.map_or(0, |parent: usize| inboard[parent] + stages[parent].rows.count());
        }
        for (k, stage) in stages.iter().enumerate().rev() {
            if let Some(parent) = stage.parent {
                last[parent] = last[parent].max(last[k]);
            }
        }
        let entries: usize = stages
            .iter()
            .zip(last.iter().zip(&inboard))
            .map(|(stage, (&last, inboard))| {
                let end = stages[last].first_row + stages[last].rows.count();
                stage.rows.count() * (inboard + end - stage.first_row)
            })
            .sum();
        Self {
            coriolis: vec![BodyCoriolis::filled(nan); bodies],
            felt: vec![Felt::filled(nan); nv],
            column: vec![nan; nv],
            product: vec![nan; nv],
            largest: vec![nan; nv],
            acceleration: vec![nan; nv],
            by_columns: 2 * entries > A_COLUMN * bodies,
            last,
            inverse: InverseScratch::new(model),
        }
    }
}

impl DerivativeScratch<f64> {
    /// Whether this is scratch of the lengths of `model`'s.
    pub(crate) fn check(&self, model: &Model<f64>) -> Result<(), Error> {
        let (bodies, nv) = (self.coriolis.len(), self.felt.len());
        if (bodies, nv) == (model.bodies.len(), model.nv()) {
            return Ok(());
        }
        let found = format!("that of a scene of {bodies} bodies and {nv} degrees of freedom");
        Err(Error::argument("scratch", found, "this scene's own, from scene.derivative_scratch()"))
    }
}
