//! Propagation of quantities in body frames through phi: from tip to base over the whole tree, and inward along a path.
//!
//! Connections, contacts, operational space, momentum and composite inertias are sums of this form. The passes of
//! [`sweeps`](crate::dynamics) do the same in the kernels, with a transform per kind of joint.

use crate::filter::Stage;
use crate::scalar::Real;
use crate::spatial::{BodyInertia, FirstMoment, RigidShift, Symmetric6, sum, zero};
use nalgebra::Vector6;

/// A quantity of a body that adds up at its parent: a force, a momentum, an inertia, or the covariance of a force.
pub(crate) trait Accumulates<T: Real>: Copy {
    /// phi x: the same quantity about the origin of the parent, in the frame of the parent.
    fn propagated(&self, shift: &RigidShift<T>) -> Self;

    /// The sum of two quantities in the same frame.
    fn plus(&self, other: &Self) -> Self;
}

/// Forces and momenta.
impl<T: Real> Accumulates<T> for Vector6<T> {
    #[inline(always)]
    fn propagated(&self, shift: &RigidShift<T>) -> Self {
        shift.force_to_parent(self)
    }

    #[inline(always)]
    fn plus(&self, other: &Self) -> Self {
        sum(self, other)
    }
}

impl<T: Real> Accumulates<T> for BodyInertia<T> {
    #[inline(always)]
    fn propagated(&self, shift: &RigidShift<T>) -> Self {
        self.to_parent(shift)
    }

    #[inline(always)]
    fn plus(&self, other: &Self) -> Self {
        self.add(other)
    }
}

impl<T: Real> Accumulates<T> for FirstMoment<T> {
    #[inline(always)]
    fn propagated(&self, shift: &RigidShift<T>) -> Self {
        self.at_parent(shift)
    }

    #[inline(always)]
    fn plus(&self, other: &Self) -> Self {
        self.add(other)
    }
}

/// Covariances of forces.
impl<T: Real> Accumulates<T> for Symmetric6<T> {
    #[inline(always)]
    fn propagated(&self, shift: &RigidShift<T>) -> Self {
        shift.inertia_to_parent(self)
    }

    #[inline(always)]
    fn plus(&self, other: &Self) -> Self {
        self.add(other)
    }
}

/// Several quantities of one body.
impl<T: Real, X: Accumulates<T>, const N: usize> Accumulates<T> for [X; N] {
    #[inline(always)]
    fn propagated(&self, shift: &RigidShift<T>) -> Self {
        self.map(|x| x.propagated(shift))
    }

    #[inline(always)]
    fn plus(&self, other: &Self) -> Self {
        std::array::from_fn(|i| self[i].plus(&other[i]))
    }
}

/// Tip to base over all bodies: x(k) becomes the sum of the quantities of body k and of all bodies outboard of it.
#[inline(always)]
pub(crate) fn sum_tip_to_base<T: Real, X: Accumulates<T>>(stages: &[Stage<T>], shifts: &[RigidShift<T>], x: &mut [X]) {
    tip_to_base(stages, shifts, (0..stages.len()).rev(), x, |_, _| {});
}

/// Tip to base over `bodies`, outermost first: the bodies of the tree, or those of a path with its branches.
///
/// `at` is called with each body and its whole x(k), and may change the copy that is propagated: the measurements of
/// the joint, for forces. Only x of `bodies` and of the parent of the last one is used.
#[inline(always)]
pub(crate) fn tip_to_base<T: Real, X: Accumulates<T>>(
    stages: &[Stage<T>],
    shifts: &[RigidShift<T>],
    bodies: impl Iterator<Item = usize>,
    x: &mut [X],
    mut at: impl FnMut(usize, &mut X),
) {
    for k in bodies {
        let mut carried = x[k];
        at(k, &mut carried);
        if let Some(parent) = stages[k].parent {
            x[parent] = x[parent].plus(&carried.propagated(&shifts[k]));
        }
    }
}

/// Base to tip over all bodies: x(k) becomes phi^T x of the parent, a motion or a co-state, past the joint of body k.
///
/// `at` is called with each body and the propagated motion, zero for a root body, and changes it to that of the body.
#[inline(always)]
pub(crate) fn base_to_tip<T: Real>(
    stages: &[Stage<T>],
    shifts: &[RigidShift<T>],
    x: &mut [Vector6<T>],
    mut at: impl FnMut(usize, &mut Vector6<T>),
) {
    for (k, stage) in stages.iter().enumerate() {
        let mut carried = stage.parent.map_or_else(zero, |parent| shifts[k].motion_to_child(&x[parent]));
        at(k, &mut carried);
        x[k] = carried;
    }
}

/// Inward along the path from one body to another, or to the base: x of the body `from` becomes that on the body
/// `until`. `at` is called at each body before its joint, as in [`tip_to_base`].
#[inline(always)]
pub(crate) fn inward_along_path<T: Real, X: Accumulates<T>>(
    stages: &[Stage<T>],
    shifts: &[RigidShift<T>],
    [from, until]: [Option<usize>; 2],
    mut x: X,
    mut at: impl FnMut(usize, &mut X),
) -> X {
    let mut body = from;
    while body != until {
        let Some(k) = body else { break };
        at(k, &mut x);
        x = x.propagated(&shifts[k]);
        body = stages[k].parent;
    }
    x
}

#[cfg(test)]
mod tests {
    use super::{inward_along_path, sum_tip_to_base, tip_to_base};
    use crate::filter::{HingeMap, Rows, Stage};
    use crate::spatial::RigidShift;
    use nalgebra::{Rotation3, Vector3, Vector6};

    /// A body with two children, and one of the base: sums, and paths of one force, by the 6x6 matrices of phi.
    #[test]
    fn sums_and_paths_are_products_of_phi() {
        let stage = |parent, first_row| Stage { parent, rows: Rows::One(HingeMap::Axis(2)), first_row };
        let stages = [stage(None, 0), stage(Some(0), 1), stage(Some(0), 2), stage(Some(2), 3), stage(None, 4)];
        let number = |k: u32, i: u32| (f64::from(7 * k + 3 * i) * 0.618_034).fract() - 0.5;
        let shifts: Vec<_> = (0..5)
            .map(|k| RigidShift {
                rotation: *Rotation3::from_euler_angles(number(k, 1), number(k, 2), number(k, 3)).matrix(),
                lever: Vector3::new(number(k, 4), number(k, 5), number(k, 6)),
            })
            .collect();
        let forces: Vec<_> = (0..5).map(|k| Vector6::from_iterator((10..16).map(|i| number(k, i)))).collect();
        let phi = |k: usize| shifts[k].to_matrix();
        let off = |found: &Vector6<f64>, expected: &Vector6<f64>| (found - expected).amax();

        let mut sums = forces.clone();
        sum_tip_to_base(&stages, &shifts, &mut sums);
        let outer = forces[2] + phi(3) * forces[3];
        assert!(off(&sums[0], &(forces[0] + phi(1) * forces[1] + phi(2) * outer)) <= 1e-15);
        assert!(off(&sums[2], &outer) <= 1e-15 && sums[4] == forces[4]);

        // A path with one force, and the same over its bodies: each joint doubles what passes it.
        let mut seen = Vec::new();
        let on_root = inward_along_path(&stages, &shifts, [Some(3), Some(0)], forces[3], |k, z| {
            seen.push(k);
            *z *= 2.0;
        });
        assert!(seen == [3, 2] && off(&on_root, &(4.0 * phi(2) * phi(3) * forces[3])) <= 1e-15);
        let mut along = vec![Vector6::zeros(); 5];
        along[3] = forces[3];
        tip_to_base(&stages, &shifts, [3, 2, 0].into_iter(), &mut along, |_, z| *z *= 2.0);
        assert!(off(&along[0], &on_root) <= 1e-15 && along[1] == Vector6::zeros());
        let on_base = inward_along_path(&stages, &shifts, [Some(3), None], forces[3], |_, _| {});
        assert!(off(&on_base, &(phi(0) * phi(2) * phi(3) * forces[3])) <= 1e-15);
    }
}
