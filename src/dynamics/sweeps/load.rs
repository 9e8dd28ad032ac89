//! The inertia of each body in the lanes of the passes, in their [frames](super::frames): one model for all states, or
//! one for each.

use crate::filter::pivots::Scale;
use crate::scalar::Real;
use crate::spatial::{BodyInertia, Symmetric3};
use nalgebra::{Vector3, Vector6};

/// The process noise M(k) of a body, and the bounds on its rounding.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::dynamics) struct Load<T> {
    /// Mass, first moment, rotational inertia about the origin.
    pub mass: T,
    pub first_moment: [T; 3],
    pub rotational: [T; 6],
    /// The bounds on the terms of M(k).
    pub scale: Scale<T>,
    /// The terms of its diagonal.
    pub terms: [T; 6],
}

impl<T: Real> Load<T> {
    /// Of a body with this inertia, in its frame in the passes.
    #[inline(always)]
    pub fn of(inertia: &BodyInertia<T>, terms: &Vector6<T>) -> Self {
        let BodyInertia { mass, first_moment, rotational } = inertia;
        Self {
            mass: *mass,
            first_moment: (*first_moment).into(),
            rotational: rotational.entries,
            scale: Scale::of_noise(terms),
            terms: (*terms).into(),
        }
    }

    /// M(k).
    #[inline(always)]
    pub fn inertia(&self) -> BodyInertia<T> {
        let [x, y, z] = self.first_moment;
        BodyInertia {
            mass: self.mass,
            first_moment: Vector3::new(x, y, z),
            rotational: Symmetric3::new(self.rotational),
        }
    }

    /// P^- (3.6): the body's inertia M(k), of which six entries are zero, plus the sum over its children.
    #[inline(always)]
    pub fn with_noise(&self, arrived: &[T; 21]) -> [T; 21] {
        let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *arrived;
        let ([xx, xy, xz, yy, yz, zz], [x, y, z], m) = (self.rotational, self.first_moment, self.mass);
        [
            a0 + xx,
            a1 + xy,
            a2 + xz,
            a3 + yy,
            a4 + yz,
            a5 + zz,
            c0,
            c1 - z,
            c2 + y,
            c3 + z,
            c4,
            c5 - x,
            c6 - y,
            c7 + x,
            c8,
            b0 + m,
            b1,
            b2,
            b3 + m,
            b4,
            b5 + m,
        ]
    }

    /// The composite inertia (3.5): the body's own plus the sum over its children.
    #[inline(always)]
    pub fn with_inertia(&self, arrived: &BodyInertia<T>) -> BodyInertia<T> {
        arrived.add(&self.inertia())
    }

    /// The terms of the diagonal of P^-: those of M(k), plus the sum over its children.
    #[inline(always)]
    pub fn with_terms(&self, arrived: &[T; 6]) -> [T; 6] {
        let [a, b, c, d, e, f] = *arrived;
        let own = &self.terms;
        [own[0] + a, own[1] + b, own[2] + c, own[3] + d, own[4] + e, own[5] + f]
    }
}
