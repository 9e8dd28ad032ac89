//! The arguments of the outward pass: one state, and flags of its nonzero quantities.

use crate::model::Model;
use crate::scalar::Real;
use nalgebra::Vector6;

/// One state of a scene, as the passes read it.
#[derive(Clone, Copy)]
pub(crate) struct Motion<'a, T: Real> {
    pub q: &'a [T],
    pub qd: &'a [T],
    /// Without joint accelerations the force is the bias b(k).
    pub qdd: Option<&'a [T]>,
    /// Empty, or one per body in its frame.
    pub wrenches: &'a [Vector6<T>],
}

/// The quantities of motion and force that a call computes.
#[derive(Clone, Copy)]
pub(super) struct Needed {
    /// A joint velocity is not zero.
    pub velocity: bool,
    /// An acceleration is not zero: gravity, that of the velocities, or joint accelerations.
    pub acceleration: bool,
}

impl Needed {
    /// For all lanes together; NaN is not zero.
    #[inline(always)]
    pub fn of<T: Real>(model: &Model<T>, state: Motion<'_, T>) -> Self {
        let simplifications = &model.simplifications;
        let velocity = !(simplifications.zero_velocity && is_zero(state.qd));
        let weightless = simplifications.zero_gravity && is_zero(model.gravity.as_slice());
        Self { velocity, acceleration: velocity || state.qdd.is_some() || !weightless }
    }
}

/// True if all values are zero in all lanes.
#[inline(always)]
fn is_zero<T: Real>(numbers: &[T]) -> bool {
    // Usually the first value decides.
    for number in numbers {
        for lane in 0..T::LANES {
            if number.lane(lane) != 0.0 {
                return false;
            }
        }
    }
    true
}
