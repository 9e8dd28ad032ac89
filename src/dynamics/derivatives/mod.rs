//! Analytic derivatives of the dynamics with respect to configuration, velocities and torques: (nv x nv) Jacobians.
//!
//! Derivatives with respect to q are taken along tangents d of q (+) d, as in
//! [`Scene::integrate`](crate::Scene::integrate): coordinates of one axis add, spherical joints rotate by d in the axes
//! of the child, free joints move by the screw of d = (linear, angular) in the frame of the child. Wrenches are
//! constant in the frame of their body. Armature is part of M only.
//!
//! Perturb joint j by the twist s = S d. All bodies outboard of j move rigidly with it, so in their body frames the
//! perturbation is equivalent to moving the inboard part of the mechanism by -s. With the motion `V_p`, `A_p` of the
//! parent of j at j, the velocity of a body outboard changes by Psi1 = `V_p` x s and its acceleration by Psi2 = `A_p` x
//! s + `V_p` x Psi1, apart from the transport. Forces that are propagated inward from j change in addition by s x* F,
//! because the frame that they are expressed in moves. All quantities are in body frames, so that precision does not
//! depend on the distance of a robot from the base's origin.
//!
//! ```
//! use phipsi::Workspace;
//! use phipsi::dynamics::derivatives::{DerivativeScratch, inverse_dynamics_derivatives};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(3)?;
//! let model = scene.model();
//! let (mut workspace, mut scratch) = (Workspace::new(model), DerivativeScratch::new(model));
//! let mut out = [f64::NAN; 27]; // dtau/dq, dtau/dqd and M, row by row
//! let state = (&[0.3; 3][..], &[0.1; 3][..], &[1.0; 3][..]);
//! inverse_dynamics_derivatives(model, &mut workspace, &mut scratch, state, &[], &mut out);
//!
//! // As `Scene` does it, with the compiled kernels and all arguments checked.
//! let mut checked = [f64::NAN; 27];
//! scene.inverse_dynamics_derivatives(&mut scene.workspace(), &[0.3; 3], &[0.1; 3], &[1.0; 3], &[], &mut checked)?;
//! assert!(out.iter().zip(&checked).all(|(a, b)| (a - b).abs() <= 1e-12));
//! # Ok(())
//! # }
//! ```

mod adjoint;
mod columns;
mod coriolis;
mod forward;
mod hessian;
mod hinge;
mod inverse;
mod outward;
mod parameters;
mod product;
mod products;
mod regressor;
mod tangent;

pub use crate::spatial::inertial_parameters::Parameters;
#[doc(hidden)]
pub use crate::spatial::inertial_parameters::{inertia, parameters};
pub(crate) use adjoint::CoStates;
pub use adjoint::Constants;
pub(crate) use columns::DerivativeColumns;
#[doc(hidden)]
pub use coriolis::BodyCoriolis;
pub use forward::forward_dynamics_derivatives;
pub(crate) use forward::linear_system;
pub(crate) use hessian::join;
pub use hessian::{HessianScratch, forward_dynamics_hvp, inverse_dynamics_hvp};
pub(crate) use hinge::Matrices;
pub use inverse::{coriolis_matrix, inverse_dynamics_derivatives, mass_matrix_derivative};
pub(crate) use inverse::{in_sweeps, with_transpose};
pub(crate) use parameters::{ConstantParts, GradientParts, constants_of};
pub use parameters::{of_body, of_link};
pub(crate) use product::Product;
pub use products::{
    ProductScratch, forward_dynamics_jvp, forward_dynamics_vjp, inverse_dynamics_jvp, inverse_dynamics_vjp,
};
pub(crate) use products::{gradients_in_sweeps, tangent_in_sweeps};
pub use regressor::{RegressorScratch, joint_torque_regressor};
pub(crate) use tangent::Changes;
pub use tangent::Directions;

use super::mass_inverse::InverseScratch;
use super::sweeps::SweepModel;
use crate::algorithm::Derivatives;
use crate::filter::pivots::LostPivot;
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{BodyInertia, Symmetric3};
use crate::workspace::Workspace;
use hinge::Effect;
use nalgebra::{Vector3, Vector6};

/// Columns between checks for interruption.
const AT_A_TIME: usize = 16;

/// The results of the outward pass that the inward pass reads; initialized with NaN.
#[derive(Debug, Clone)]
pub(crate) struct Kept<T> {
    /// Velocity and acceleration, weight included, in slots outward; the first is the base's.
    motions: Vec<[[T; 6]; 2]>,
    /// One per place in the sweeps: M(k), then the sum over all bodies outboard of joint k; likewise B(k) and the force
    /// that a body needs.
    composites: Vec<BodyInertia<T>>,
    coriolis: Vec<BodyCoriolis<T>>,
    forces: Vec<[T; 6]>,
    /// One per row: the change of the motion outboard per unit of each degree of freedom.
    effect: Vec<Effect<T>>,
}

impl<T: Real> Kept<T> {
    pub fn new(sweeps: &SweepModel<T>, nv: usize) -> Self {
        let nan = T::from_f64(f64::NAN);
        let bodies = sweeps.bodies.len();
        let body =
            BodyInertia { mass: nan, first_moment: Vector3::from_element(nan), rotational: Symmetric3::new([nan; 6]) };
        Self {
            motions: vec![[[nan; 6]; 2]; sweeps.swept_slots.outward],
            composites: vec![body; bodies],
            coriolis: vec![BodyCoriolis::filled(nan); bodies],
            forces: vec![[nan; 6]; bodies],
            effect: vec![Effect::filled(nan); nv],
        }
    }
}

/// The derivatives `which` of one state, in any scalar of one lane; Err: a pivot of the factor that is lost.
pub(crate) fn of_state<T: Real<Parameter = T>>(
    which: Derivatives,
    model: &Model<T>,
    (workspace, scratch): (&mut Workspace<T>, &mut DerivativeScratch<T>),
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    out: &mut [T],
) -> Result<(), LostPivot> {
    let (q, qd, _) = state;
    match which {
        Derivatives::InverseDynamics => inverse_dynamics_derivatives(model, workspace, scratch, state, wrenches, out),
        Derivatives::ForwardDynamics(_) => {
            return forward_dynamics_derivatives(model, workspace, scratch, state, wrenches, out);
        }
        Derivatives::CoriolisMatrix => coriolis_matrix(model, workspace, scratch, q, qd, out),
        Derivatives::MassMatrix => mass_matrix_derivative(model, workspace, scratch, q, qd, out),
    }
    Ok(())
}

/// Scratch of derivatives in any scalar of one lane, in addition to the store of the workspace; initialized with NaN.
#[derive(Debug)]
pub struct DerivativeScratch<T: Real<Parameter = T>> {
    kept: Kept<T>,
    columns: DerivativeColumns<T, T>,
    /// One scalar per degree of freedom: a column, its solution, the largest entry of each row of M^-1, and the
    /// accelerations of the state.
    column: Vec<T>,
    solved: Vec<T>,
    largest: Vec<T>,
    acceleration: Vec<T>,
    inverse: InverseScratch<T>,
}

impl<T: Real<Parameter = T>> DerivativeScratch<T> {
    /// Scratch for `model`.
    #[must_use]
    pub fn new(model: &Model<T>) -> Self {
        let (nan, nv, sweeps) = (T::from_f64(f64::NAN), model.nv(), SweepModel::general(model));
        Self {
            kept: Kept::new(&sweeps, nv),
            columns: DerivativeColumns::new(),
            column: vec![nan; nv],
            solved: vec![nan; nv],
            largest: vec![nan; nv],
            acceleration: vec![nan; nv],
            inverse: InverseScratch::new(model),
        }
    }
}
