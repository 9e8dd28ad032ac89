//! Changes of the velocity and acceleration of the bodies outboard of one degree of freedom per unit of it, expressed
//! in the frames of those bodies.

use super::Matrices;
use super::hinge::{halves, motion_cross_hinge};
use crate::filter::HingeMap;
use crate::scalar::{ColumnsOf, Real};
use crate::spatial::cross_motion;
use nalgebra::Vector6;

/// The effect of one degree of freedom with the column S, at its body.
#[derive(Debug, Clone, Copy)]
pub(super) struct Effect<T> {
    /// The angular half of Psi1 = `V_p` x S, the derivative of the velocity by q. The linear half is not used.
    pub velocity: [T; 3],
    /// Psi2 = `A_p` x S + `V_p` x Psi1, the derivative of the acceleration by q.
    pub acceleration: [T; 6],
    /// Psi1 + V x S, the derivative of the acceleration by qd. For the Coriolis matrix V x S only.
    pub by_rate: [T; 6],
}

impl<T: Real> Effect<T> {
    pub fn filled(value: T) -> Self {
        Self { velocity: [value; 3], acceleration: [value; 6], by_rate: [value; 6] }
    }

    /// From the motion of the parent transported to the joint, gravity included, and the velocity of the body. S is
    /// `sense` times the row.
    #[inline(always)]
    pub fn new(
        (hinge, sense): (&HingeMap<T>, T),
        [velocity, acceleration]: &[[T; 6]; 2],
        own: &[T; 6],
        matrices: Matrices,
    ) -> Self {
        let turned = motion_cross_hinge(velocity, hinge);
        let twice = cross_motion(&Vector6::from(*velocity), &Vector6::from(turned));
        let (at_base, mut by_rate) = (motion_cross_hinge(acceleration, hinge), motion_cross_hinge(own, hinge));
        let mut changed = [sense; 6];
        for i in 0..6 {
            changed[i] = sense * (at_base[i] + twice[i]);
            if matrices == Matrices::Derivatives {
                by_rate[i] += turned[i];
            }
            by_rate[i] *= sense;
        }
        let ([x, y, z], _) = halves(&turned);
        Self { velocity: [sense * x, sense * y, sense * z], acceleration: changed, by_rate }
    }

    /// The same for a block of columns.
    #[inline(always)]
    pub fn spread<C: ColumnsOf<T>>(&self, like: C) -> Effect<C> {
        let mut spread = Effect::filled(like);
        for i in 0..3 {
            spread.velocity[i] = like.spread(self.velocity[i]);
        }
        for i in 0..6 {
            spread.acceleration[i] = like.spread(self.acceleration[i]);
            spread.by_rate[i] = like.spread(self.by_rate[i]);
        }
        spread
    }
}
