//! Hessians of inverse and forward dynamics times a vector, in O(N): the gradients of one run on dual numbers.

use super::adjoint::Constants;
use super::forward::accelerations;
use super::products::{ProductScratch, inverse_dynamics_vjp, solved};
use super::tangent::Directions;
use crate::dynamics::forces::Motion;
use crate::dynamics::solve;
use crate::dynamics::sweeps::motion::carriers;
use crate::filter::pivots::LostPivot;
use crate::kinematics::coordinate_rates;
use crate::model::Model;
use crate::scalar::Dual;
use crate::workspace::Workspace;
use nalgebra::{Vector3, Vector6};

/// Scratch of these products: a model in dual numbers, and a state; starts as NaN.
#[derive(Debug)]
pub struct HessianScratch {
    model: Model<Dual<f64>>,
    dual: ProductScratch<Dual<f64>>,
    plain: ProductScratch<f64>,
    q: Vec<Dual<f64>>,
    qd: Vec<Dual<f64>>,
    u: Vec<Dual<f64>>,
    cotangent: Vec<Dual<f64>>,
    wrenches: Vec<Vector6<Dual<f64>>>,
    out: Vec<Dual<f64>>,
    /// dq/dt, (nq); accelerations and their change, x and its change, and zeros, (nv) each.
    rates: Vec<f64>,
    accelerations: [Vec<f64>; 2],
    co_states: [Vec<f64>; 2],
    zeros: Vec<f64>,
}

impl HessianScratch {
    /// Scratch for `model`.
    #[must_use]
    pub fn new(model: &Model<f64>) -> Self {
        let (nan, nv, nq) = (Dual::constant_of(f64::NAN), model.nv(), model.nq);
        let dual: Model<Dual<f64>> = model.cast();
        let numbers = || vec![f64::NAN; nv];
        Self {
            dual: ProductScratch::new(&dual),
            model: dual,
            plain: ProductScratch::new(model),
            q: vec![nan; nq],
            qd: vec![nan; nv],
            u: vec![nan; nv],
            cotangent: vec![nan; nv],
            wrenches: vec![Vector6::from_element(nan); model.bodies.len()],
            out: vec![nan; 3 * nv],
            rates: vec![f64::NAN; nq],
            accelerations: [numbers(), numbers()],
            co_states: [numbers(), numbers()],
            zeros: vec![0.0; nv],
        }
    }

    /// The model that it was made for.
    pub(crate) fn identity(&self) -> u64 {
        self.model.identity()
    }

    /// The gradients of torques, in dual numbers: q, qd, wrenches, u and cotangent as they were set.
    fn gradients(&mut self, has_wrenches: bool) {
        let Self { model, dual, q, qd, u, cotangent, wrenches, out, .. } = self;
        let wrenches = if has_wrenches { &wrenches[..] } else { &[] };
        let results = (&mut Constants::default(), &mut out[..]);
        inverse_dynamics_vjp(model, dual, (q, qd, u), wrenches, cotangent, results);
    }

    /// q along the tangent dq, qd along dqd, and constant wrenches.
    fn set(
        &mut self,
        model: &Model<f64>,
        (q, qd): (&[f64], &[f64]),
        wrenches: &[Vector6<f64>],
        [dq, dqd]: [&[f64]; 2],
    ) {
        coordinate_rates(model, q, dq, &mut self.rates);
        join(&mut self.q, q, &self.rates);
        join(&mut self.qd, qd, dqd);
        for (to, wrench) in self.wrenches.iter_mut().zip(wrenches) {
            *to = wrench.map(Dual::constant_of);
        }
    }
}

/// Values with their tangents.
fn join(to: &mut [Dual<f64>], values: &[f64], tangents: &[f64]) {
    for ((to, &value), &tangent) in to.iter_mut().zip(values).zip(tangents) {
        *to = Dual { value, tangent };
    }
}

/// How the gradients of [`inverse_dynamics_vjp`] change along a direction (dq, dqd, dqdd), (3 x nv) into `out`: the Hessian of x . tau times it. O(N), some three
/// times that.
///
/// Arguments as there. The gradient by q is that in the tangent space at q, which moves along: on spherical and free joints that Hessian is not symmetric.
pub fn inverse_dynamics_hvp(
    model: &Model<f64>,
    scratch: &mut HessianScratch,
    (q, qd, qdd): (&[f64], &[f64], &[f64]),
    wrenches: &[Vector6<f64>],
    cotangent: &[f64],
    [dq, dqd, dqdd]: [&[f64]; 3],
    out: &mut [f64],
) {
    scratch.set(model, (q, qd), wrenches, [dq, dqd]);
    join(&mut scratch.u, qdd, dqdd);
    for (to, &x) in scratch.cotangent.iter_mut().zip(cotangent) {
        *to = Dual::constant_of(x);
    }
    scratch.gradients(!wrenches.is_empty());
    for (to, from) in out.iter_mut().zip(&scratch.out) {
        *to = from.tangent;
    }
}

/// How the gradients of [`forward_dynamics_vjp`](super::forward_dynamics_vjp) change along a direction (dq, dqd, dtau), (3 x nv) into `out`: the Hessian of c . qdd times it.
/// One factor and four right sides, O(N).
///
/// The accelerations change by [`forward_dynamics_jvp`](super::forward_dynamics_jvp), and x = M^-1 c by -M^-1 (dM x), dM x being the change of M x along dq. Arguments as
/// there; P is carried as the workspace's form says.
///
/// # Errors
///
/// The lost pivot furthest from the base, where one was lost; then `out` means nothing.
#[allow(clippy::too_many_arguments)] // a state, a cotangent, a direction and results
pub fn forward_dynamics_hvp(
    model: &Model<f64>,
    workspace: &mut Workspace<f64>,
    scratch: &mut HessianScratch,
    state: (&[f64], &[f64], &[f64]),
    wrenches: &[Vector6<f64>],
    cotangent: &[f64],
    [dq, dqd, dtau]: [&[f64]; 3],
    out: &mut [f64],
) -> Result<(), LostPivot> {
    let ((q, qd, _), nv) = (state, model.nv());
    let HessianScratch { plain, accelerations: [qdd, qdd_change], co_states: [x, x_change], zeros, .. } = scratch;
    let monitor = accelerations(model, workspace, qdd, state, wrenches);
    if let Some(lost) = workspace.lost_pivot(model, &monitor) {
        return Err(lost);
    }
    carriers(&plain.sweeps, &mut plain.sweep_scratch, 0.0, q);
    let along = Directions { q: dq, qd: dqd, u: dtau, ..Directions::default() };
    let motion = Motion { q, qd, qdd: Some(qdd), wrenches };
    solved(model, workspace, plain, (motion, &along, &model.gravity), qdd_change);
    solve(model, workspace, cotangent, x);
    let along = Directions { q: dq, qd: zeros, u: zeros, ..Directions::default() };
    let motion = Motion { q, qd: zeros, qdd: Some(x), wrenches: &[] };
    solved(model, workspace, plain, (motion, &along, &Vector3::zeros()), x_change);
    join(&mut scratch.u, qdd, qdd_change);
    join(&mut scratch.cotangent, x, x_change);
    out[2 * nv..].copy_from_slice(x_change);
    scratch.set(model, (q, qd), wrenches, [dq, dqd]);
    scratch.gradients(!wrenches.is_empty());
    for (to, from) in out[..2 * nv].iter_mut().zip(&scratch.out) {
        *to = -from.tangent;
    }
    Ok(())
}
