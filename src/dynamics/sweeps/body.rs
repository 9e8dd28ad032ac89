//! The constants of the bodies as the passes read them: one number for all lanes, in the [frames](super::frames) of the
//! passes.

use super::frames::AxisPermutation;
use super::joint::Joint;
use super::slots::Places;
use super::spin::Load;
use crate::filter::pivots::Scale;
use crate::scalar::Real;
use crate::spatial::transform::Offset;
use crate::spatial::{BodyInertia, Symmetric3};
use nalgebra::Vector3;

/// One body.
#[allow(clippy::struct_excessive_bools)] // independent facts
#[derive(Debug, Clone, PartialEq)]
pub(in crate::dynamics) struct SweepBody<N> {
    pub joint: Joint,
    /// For a revolute joint 1, or -1 if its z axis is reversed: velocity, acceleration and torque are those about z,
    /// times this.
    pub sense: N,
    /// From its frame in the model to its frame in the passes.
    pub frame: AxisPermutation<N>,
    /// Its index in the model, and that of its parent.
    pub index: usize,
    pub parent: Option<usize>,
    /// Its first row.
    pub row: usize,
    /// For a revolute joint, from the origin of the parent to that of the body, in the frame of the joint: that of the
    /// body at angle zero, or of the parent for an oblique axis.
    pub offset: Offset<N>,
    /// The same in the frame of the parent, for the acceleration of the origin.
    pub offset_at_parent: Offset<N>,
    /// M(k).
    pub load: Load<N>,
    /// The bounds on the terms of M(k).
    pub scale: [N; 2],
    /// The terms of its diagonal.
    pub terms: [N; 6],
    /// True if the weights of its root are positive, and those of its parent's root.
    pub is_definite: bool,
    pub hangs_on_definite: bool,
    pub places: Places,
    /// True if it has no children.
    pub is_leaf: bool,
    /// One past the place of its first child on a revolute joint, and of the next such child of its parent; 0 if there
    /// is none.
    pub first_axial: usize,
    pub next_axial: usize,
    /// True if it has a child on another kind of joint.
    pub carries_others: bool,
    /// The number of rows between the base and its own.
    pub depth: usize,
    /// One past the last row outboard of it.
    pub end_row: usize,
}

impl<N: Copy> SweepBody<N> {
    /// P^- (3.6): the body's inertia M(k), of which six entries are zero, plus the sum over its children.
    #[inline(always)]
    pub fn with_noise<T: Real<Parameter = N>>(&self, arrived: &[T; 21]) -> [T; 21] {
        let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *arrived;
        let [xx, xy, xz, yy, yz, zz] = self.load.rotational;
        let [x, y, z] = self.load.first_moment;
        let (x, y, z, m) = (a0.splat(x), a0.splat(y), a0.splat(z), a0.splat(self.load.mass));
        [
            a0 + a0.splat(xx),
            a1 + a0.splat(xy),
            a2 + a0.splat(xz),
            a3 + a0.splat(yy),
            a4 + a0.splat(yz),
            a5 + a0.splat(zz),
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
    pub fn with_inertia<T: Real<Parameter = N>>(&self, arrived: &BodyInertia<T>) -> BodyInertia<T> {
        arrived.add(&self.inertia(arrived.mass))
    }

    /// M(k), in every lane.
    #[inline(always)]
    pub fn inertia<T: Real<Parameter = N>>(&self, like: T) -> BodyInertia<T> {
        let ([x, y, z], [xx, xy, xz, yy, yz, zz]) = (self.load.first_moment, self.load.rotational);
        BodyInertia {
            mass: like.splat(self.load.mass),
            first_moment: Vector3::new(like.splat(x), like.splat(y), like.splat(z)),
            rotational: Symmetric3::new([
                like.splat(xx),
                like.splat(xy),
                like.splat(xz),
                like.splat(yy),
                like.splat(yz),
                like.splat(zz),
            ]),
        }
    }

    /// The bounds on the terms of M(k).
    #[inline(always)]
    pub fn scale_of_noise<T: Real<Parameter = N>>(&self, like: T) -> Scale<T> {
        let [angular, linear] = self.scale;
        Scale { angular: like.splat(angular), linear: like.splat(linear) }
    }

    /// The terms of the diagonal of P^-: those of M(k), plus the sum over its children.
    #[inline(always)]
    pub fn with_terms<T: Real<Parameter = N>>(&self, arrived: &[T; 6]) -> [T; 6] {
        let [a, b, c, d, e, f] = *arrived;
        let own = &self.terms;
        [
            a.splat(own[0]) + a,
            a.splat(own[1]) + b,
            a.splat(own[2]) + c,
            a.splat(own[3]) + d,
            a.splat(own[4]) + e,
            a.splat(own[5]) + f,
        ]
    }
}

/// Links each of the bodies, in the order of the passes, with its children.
pub(in crate::dynamics) fn link_children<N>(swept: &mut [SweepBody<N>]) {
    for place in (0..swept.len()).rev() {
        let Some(parent) = swept[place].places.parent.checked_sub(1) else { continue };
        if let Joint::Axial(_) = swept[place].joint {
            swept[place].next_axial = swept[parent].first_axial;
            swept[parent].first_axial = place + 1;
        } else {
            swept[parent].carries_others = true;
        }
    }
}

/// The angle of a revolute joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::dynamics) struct Turning<N> {
    /// The joint's coordinate.
    pub q: usize,
    /// The body's place in the order of the passes.
    pub place: usize,
    /// 1, or -1 if the z axis is reversed.
    pub sense: N,
    /// Sine and cosine of the constant angle that is added, if there is one.
    pub offset: Option<[N; 2]>,
}
