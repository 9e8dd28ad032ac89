//! Hessians of inverse and forward dynamics times a vector, in O(N): the gradients of one run on dual numbers.

use super::adjoint::Constants;
use super::forward::accelerations;
use super::products::{ProductScratch, inverse_dynamics_vjp, solved};
use super::tangent::Directions;
use crate::dynamics::forces::Motion;
use crate::dynamics::refined::DoubleDoubleState;
use crate::dynamics::solve;
use crate::filter::Form;
use crate::filter::pivots::LostPivot;
use crate::kinematics::coordinate_rates;
use crate::model::Model;
use crate::scalar::{DoubleDouble, Dual, Real, larger};
use crate::spatial::RigidShift;
use crate::workspace::{Made, Workspace};
use nalgebra::{Vector3, Vector6};

/// Scratch of these products: a model in dual numbers, and a state; initialized with NaN.
#[derive(Debug)]
pub struct HessianScratch<S: Real<Parameter = S> = f64> {
    model: Model<Dual<S>>,
    workspace: Workspace<Dual<S>>,
    dual: ProductScratch<Dual<S>>,
    plain: ProductScratch<S>,
    q: Vec<Dual<S>>,
    qd: Vec<Dual<S>>,
    u: Vec<Dual<S>>,
    cotangent: Vec<Dual<S>>,
    wrenches: Vec<Vector6<Dual<S>>>,
    out: Vec<Dual<S>>,
    /// dq/dt, (nq); accelerations and their change, x and its change, and zeros, (nv) each.
    rates: Vec<S>,
    accelerations: [Vec<S>; 2],
    co_states: [Vec<S>; 2],
    zeros: Vec<S>,
}

impl<S: Real<Parameter = S>> HessianScratch<S> {
    /// Scratch for `model`.
    #[must_use]
    pub fn new(model: &Model<f64>) -> Self {
        let number = S::from_f64(f64::NAN);
        let (nan, nv, nq) = (Dual::constant_of(number), model.nv(), model.nq);
        let dual: Model<Dual<S>> = model.cast();
        let numbers = || vec![number; nv];
        Self {
            workspace: Workspace::new(&dual),
            dual: ProductScratch::new(&dual),
            model: dual,
            plain: ProductScratch::new(&model.cast()),
            q: vec![nan; nq],
            qd: vec![nan; nv],
            u: vec![nan; nv],
            cotangent: vec![nan; nv],
            wrenches: vec![Vector6::from_element(nan); model.bodies.len()],
            out: vec![nan; 3 * nv],
            rates: vec![number; nq],
            accelerations: [numbers(), numbers()],
            co_states: [numbers(), numbers()],
            zeros: vec![S::zero(); nv],
        }
    }

    /// The model that it was made for.
    pub(crate) fn identity(&self) -> u64 {
        self.model.identity()
    }

    /// The gradients of torques, in dual numbers, from q, qd, wrenches, u and the cotangent in the scratch.
    fn gradients(&mut self, has_wrenches: bool) {
        let Self { model, workspace, dual, q, qd, u, cotangent, wrenches, out, .. } = self;
        let wrenches = if has_wrenches { &wrenches[..] } else { &[] };
        let results = (&mut Constants::default(), &mut out[..]);
        inverse_dynamics_vjp(model, workspace, dual, (q, qd, u), wrenches, cotangent, results);
    }

    /// The gradients by q, qd and qdd of x . tau of inverse dynamics at (q, qd), in dual numbers: along (dq, dqd), with
    /// the changes of qdd and of x.
    pub(crate) fn along(
        &mut self,
        model: &Model<S>,
        Motion { q, qd, qdd, wrenches }: Motion<'_, S>,
        [dq, dqd, dqdd]: [&[S]; 3],
        [x, dx]: [&[S]; 2],
    ) -> DualGradients<'_, S> {
        self.set(model, (q, qd), wrenches, [dq, dqd]);
        join(&mut self.u, qdd.unwrap_or_default(), dqdd);
        join(&mut self.cotangent, x, dx);
        self.gradients(!wrenches.is_empty());
        let Self { model, workspace, q, qd, u, out, .. } = self;
        DualGradients { model, shifts: &workspace.store.shifts, q, qd, qdd: u, out }
    }

    /// q along the tangent dq, qd along dqd, and constant wrenches.
    fn set(&mut self, model: &Model<S>, (q, qd): (&[S], &[S]), wrenches: &[Vector6<S>], [dq, dqd]: [&[S]; 2]) {
        coordinate_rates(model, q, dq, &mut self.rates);
        join(&mut self.q, q, &self.rates);
        join(&mut self.qd, qd, dqd);
        for (to, wrench) in self.wrenches.iter_mut().zip(wrenches) {
            *to = wrench.map(Dual::constant_of);
        }
    }
}

/// The state of a scratch in dual numbers, phi of every body there, and the gradients by q, qd and qdd, (3 x nv).
pub(crate) struct DualGradients<'a, S: Real<Parameter = S>> {
    pub model: &'a Model<Dual<S>>,
    pub shifts: &'a [RigidShift<Dual<S>>],
    pub q: &'a [Dual<S>],
    pub qd: &'a [Dual<S>],
    pub qdd: &'a [Dual<S>],
    pub out: &'a mut [Dual<S>],
}

/// Values with their tangents.
pub(crate) fn join<S: Real>(to: &mut [Dual<S>], values: &[S], tangents: &[S]) {
    for ((to, &value), &tangent) in to.iter_mut().zip(values).zip(tangents) {
        *to = Dual { value, tangent };
    }
}

/// The derivative of the gradients of [`inverse_dynamics_vjp`] along a direction (dq, dqd, dqdd), (3 x nv) into `out`:
/// the Hessian of x . tau times the direction. O(N), about three times the cost of the gradients.
///
/// Arguments as in [`inverse_dynamics_vjp`]. The gradient by q is expressed in the tangent space at q, which moves with
/// q. For spherical and free joints this Hessian is therefore not symmetric.
pub fn inverse_dynamics_hvp(
    model: &Model<f64>,
    scratch: &mut HessianScratch,
    (q, qd, qdd): (&[f64], &[f64], &[f64]),
    wrenches: &[Vector6<f64>],
    cotangent: &[f64],
    [dq, dqd, dqdd]: [&[f64]; 3],
    out: &mut [f64],
) {
    let zeros = vec![0.0; cotangent.len()];
    let motion = Motion { q, qd, qdd: Some(qdd), wrenches };
    let found = scratch.along(model, motion, [dq, dqd, dqdd], [cotangent, &zeros]);
    for (to, from) in out.iter_mut().zip(found.out) {
        *to = from.tangent;
    }
}

/// The derivative of the gradients of [`forward_dynamics_vjp`](super::forward_dynamics_vjp) along a direction (dq, dqd,
/// dtau), (3 x nv) into `out`: the Hessian of c . qdd times the direction. One factor and four right-hand sides, O(N).
///
/// The change of the accelerations is that of [`forward_dynamics_jvp`](super::forward_dynamics_jvp). The change of x =
/// M^-1 c is -M^-1 (dM x), where dM x is the change of M x along dq. Arguments as in `forward_dynamics_vjp`; P is
/// propagated in the form of the workspace. In form `auto`, a state is recomputed in double-double arithmetic and
/// rounded if the error estimate of the factor of M exceeds the tolerance, or if the estimated error of either change
/// exceeds the tolerance of products.
///
/// # Errors
///
/// The lost pivot furthest from the base; `out` is then undefined.
#[allow(clippy::too_many_arguments)] // a state, a cotangent, a direction and results
pub fn forward_dynamics_hvp(
    model: &Model<f64>,
    workspace: &mut Workspace<f64>,
    scratch: &mut HessianScratch,
    state: (&[f64], &[f64], &[f64]),
    wrenches: &[Vector6<f64>],
    cotangent: &[f64],
    direction: [&[f64]; 3],
    out: &mut [f64],
) -> Result<(), LostPivot> {
    let is_in_doubt = product((model, workspace, scratch), state, wrenches, (cotangent, direction), out)?;
    if is_in_doubt {
        // If there is no wider model, the result is kept.
        doubled((model, &mut workspace.wide), state, wrenches, (cotangent, direction), out);
    }
    Ok(())
}

/// The product in double-double arithmetic, see [`DoubleDoubleState::recompute`].
fn doubled(
    (model, kept): (&Model<f64>, &mut Made),
    state: (&[f64], &[f64], &[f64]),
    wrenches: &[Vector6<f64>],
    (cotangent, direction): (&[f64], [&[f64]; 3]),
    out: &mut [f64],
) {
    let mut scratch = HessianScratch::new(model);
    let all = |numbers: &[f64]| -> Vec<_> { numbers.iter().map(|&x| DoubleDouble::from_f64(x)).collect() };
    let (cotangent, [dq, dqd, dtau]) = (all(cotangent), direction.map(all));
    DoubleDoubleState::recompute((model, kept), state, wrenches, out, |wide, out| {
        let DoubleDoubleState { model, workspace, q, qd, tau, wrenches } = wide;
        let along = (&cotangent[..], [&dq[..], &dqd[..], &dtau[..]]);
        product((model, workspace, &mut scratch), (q, qd, tau), wrenches, along, out).is_ok()
    });
}

/// The product in any scalar, and whether its estimated error exceeds what form `auto` accepts.
fn product<S: Real<Parameter = S>>(
    (model, workspace, scratch): (&Model<S>, &mut Workspace<S>, &mut HessianScratch<S>),
    state: (&[S], &[S], &[S]),
    wrenches: &[Vector6<S>],
    (cotangent, [dq, dqd, dtau]): (&[S], [&[S]; 3]),
    out: &mut [S],
) -> Result<bool, LostPivot> {
    let ((q, qd, _), nv) = (state, model.nv());
    let HessianScratch { plain, accelerations: [qdd, qdd_change], co_states: [x, x_change], zeros, .. } = scratch;
    let monitor = accelerations(model, workspace, qdd, state, wrenches);
    if let Some(lost) = workspace.lost_pivot(model, &monitor) {
        return Err(lost);
    }
    let judges = workspace.form == Form::Auto && !monitor.of_roots;
    let mut is_in_doubt = workspace.form == Form::Auto && monitor.of_roots;
    plain.judge(judges);
    let along = Directions { q: dq, qd: dqd, u: dtau, ..Directions::default() };
    let motion = Motion { q, qd, qdd: Some(qdd), wrenches };
    solved(model, workspace, plain, (motion, &along, &model.gravity), qdd_change);
    is_in_doubt |= judges && plain.has_lost(workspace, qdd_change);
    solve(model, workspace, cotangent, x);
    let along = Directions { q: dq, qd: zeros, u: zeros, ..Directions::default() };
    let motion = Motion { q, qd: zeros, qdd: Some(x), wrenches: &[] };
    solved(model, workspace, plain, (motion, &along, &Vector3::from_element(S::zero())), x_change);
    is_in_doubt |= judges && plain.has_lost(workspace, x_change);
    plain.judge(false);
    join(&mut scratch.u, qdd, qdd_change);
    join(&mut scratch.cotangent, x, x_change);
    out[2 * nv..].copy_from_slice(x_change);
    scratch.set(model, (q, qd), wrenches, [dq, dqd]);
    scratch.gradients(!wrenches.is_empty());
    for (to, from) in out[..2 * nv].iter_mut().zip(&scratch.out) {
        *to = -from.tangent;
    }
    // The gradients are sums over bodies; their forces, M x, must equal the cotangent.
    let HessianScratch { dual, out: gradients, .. } = scratch;
    let (mut off, mut size) = (S::epsilon() * dual.terms().value, S::zero());
    for (product, &c) in gradients[2 * nv..].iter().zip(cotangent) {
        off = larger(off, (product.value - c).abs());
        size = larger(size, c.abs());
    }
    is_in_doubt |=
        workspace.form == Form::Auto && !(off.lane(0) <= size.lane(0) * workspace.accepted_error().of_products());
    Ok(is_in_doubt)
}
