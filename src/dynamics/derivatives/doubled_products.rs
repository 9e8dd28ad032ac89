//! Products in double-double arithmetic, for states whose error estimate exceeds the tolerance.

use super::adjoint::Constants;
use super::products::{ProductScratch, forward_dynamics_jvp, forward_dynamics_vjp};
use super::tangent::Directions;
use crate::dynamics::double_double_state::DoubleDoubleState;
use crate::model::Model;
use crate::scalar::{DoubleDouble, Real};
use nalgebra::Vector6;

/// [`forward_dynamics_jvp`] in double-double arithmetic, see [`DoubleDoubleState::recompute`].
pub(super) fn tangent<T: Real>(
    model: &Model<T>,
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    along: &Directions<'_, T>,
    out: &mut [T],
) -> bool {
    DoubleDoubleState::recompute(model, state, wrenches, out, |wide, out| {
        let DoubleDoubleState { model, workspace, q, qd, tau, wrenches } = wide;
        let along = Directions {
            q: &all(along.q),
            qd: &all(along.qd),
            u: &all(along.u),
            wrenches: &along.wrenches.iter().map(|wrench| wrench.map(widened)).collect::<Vec<_>>(),
            parameters: &along.parameters.iter().map(|ten| ten.map(widened)).collect::<Vec<_>>(),
            armature: &all(along.armature),
            gravity: &all(along.gravity),
        };
        let scratch = &mut ProductScratch::new(model);
        forward_dynamics_jvp(model, workspace, scratch, (q, qd, tau), wrenches, &along, out).is_ok()
    })
}

/// [`forward_dynamics_vjp`] in double-double arithmetic.
#[cold]
pub(super) fn gradients<T: Real>(
    model: &Model<T>,
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    cotangent: &[T],
    (constants, out): (&mut Constants<'_, T>, &mut [T]),
) -> bool {
    let Some(mut wide) = DoubleDoubleState::of(model, state, wrenches) else { return false };
    let DoubleDoubleState { model, workspace, q, qd, tau, wrenches } = &mut wide;
    let mut scratch = ProductScratch::new(model);
    let nan = DoubleDouble::from_f64(f64::NAN);
    let mut found = vec![nan; out.len()];
    let (mut of_wrenches, mut parameters, mut armature, mut gravity) = (
        vec![Vector6::from_element(nan); constants.wrenches.len()],
        vec![[nan; 10]; constants.parameters.len()],
        vec![nan; constants.armature.len()],
        vec![nan; constants.gravity.len()],
    );
    let mut wide = Constants {
        wrenches: &mut of_wrenches,
        parameters: &mut parameters,
        armature: &mut armature,
        gravity: &mut gravity,
    };
    let (state, cotangent) = ((&q[..], &qd[..], &tau[..]), all(cotangent));
    let results = (&mut wide, &mut found[..]);
    let done = forward_dynamics_vjp(model, workspace, &mut scratch, state, wrenches, &cotangent, results);
    if done.is_err() || !rounded(&found, out) {
        return false;
    }
    for (to, from) in constants.wrenches.iter_mut().zip(&of_wrenches) {
        *to = from.map(narrowed);
    }
    for (to, from) in constants.parameters.iter_mut().zip(&parameters) {
        *to = from.map(narrowed);
    }
    for (to, from) in [(&mut *constants.armature, &armature), (&mut *constants.gravity, &gravity)] {
        for (to, &from) in to.iter_mut().zip(from) {
            *to = narrowed(from);
        }
    }
    true
}

fn widened<T: Real>(x: T) -> DoubleDouble {
    DoubleDouble::from_f64(x.lane(0))
}

fn narrowed<T: Real>(x: DoubleDouble) -> T {
    T::from_f64(x.lane(0))
}

fn all<T: Real>(numbers: &[T]) -> Vec<DoubleDouble> {
    numbers.iter().map(|&x| widened(x)).collect()
}

/// Rounds all values into `out` if they are finite.
fn rounded<T: Real>(found: &[DoubleDouble], out: &mut [T]) -> bool {
    if !found.iter().all(|x| x.lane(0).is_finite()) {
        return false;
    }
    for (to, &from) in out.iter_mut().zip(found) {
        *to = narrowed(from);
    }
    true
}
