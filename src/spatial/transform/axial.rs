//! Transform of a revolute joint: rotation about z by the joint angle, a constant rotation for an oblique axis, the
//! offset, and a permutation of axes.

use super::axes::Axes;
use super::axial_rotation::AxialRotation;
use super::covariance::along_offset;
use super::offset::Offset;
use super::rotation::Rotates;
use super::{TERMS_SPREAD, Transform};
use crate::scalar::{ColumnsOf, Real};
use crate::spatial::{BodyInertia, Root6, RootColumns, Symmetric3};
use nalgebra::Vector3;

/// phi of a revolute joint.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Axial<T, R, A> {
    rotation: R,
    axes: A,
    /// In the joint frame, relative to which the body rotates; for an oblique axis in the parent frame.
    offset: Offset<T>,
}

impl<T: Real, R: Rotates<T>, A: Axes> Axial<T, R, A> {
    /// The transform with this offset in the joint frame.
    #[inline(always)]
    pub fn new(rotation: R, axes: A, offset: &Offset<T::Parameter>) -> Self {
        let offset = offset.splat(rotation.turn().s);
        Self { rotation, axes, offset }
    }

    /// The same transform for several columns.
    #[inline(always)]
    pub fn spread<C: ColumnsOf<T>>(&self, like: C) -> Axial<C, R::Spread<C>, A> {
        Axial { rotation: self.rotation.spread(like), axes: self.axes, offset: self.offset.spread(like) }
    }

    /// Free vectors from the parent frame to the body frame.
    #[inline(always)]
    pub fn free_to_child<const N: usize>(&self, vectors: [[T; 3]; N]) -> [[T; 3]; N] {
        let mut vectors = self.axes.free_to_joint(vectors);
        for v in &mut vectors {
            *v = self.rotation.rotate_back(*v);
        }
        vectors
    }

    /// phi z in the joint frame, about the parent origin.
    #[inline(always)]
    fn in_joint_frame(&self, z: &[T; 6]) -> [T; 6] {
        let force = self.rotation.rotate([z[3], z[4], z[5]]);
        let [a, b, c] = self.offset.moment(force, self.rotation.rotate([z[0], z[1], z[2]]));
        [a, b, c, force[0], force[1], force[2]]
    }

    /// Bounds on the diagonal entries in the joint frame. For a rotation about z, x and y each take from both; for an
    /// oblique axis each axis takes from the parts along it and across it.
    #[inline(always)]
    fn terms(&self, diagonal: &[T; 6]) -> [T; 6] {
        let like = diagonal[0];
        let (two, four) = (like.constant(2.0), like.constant(TERMS_SPREAD));
        let [x, y, z] = self.offset.entries;
        let (x, y, z) = (two * x * x, two * y * y, two * z * z);
        let (across, along) = (four * (diagonal[3].abs() + diagonal[4].abs()), four * diagonal[5].abs());
        let (turned, about) = (four * (diagonal[0].abs() + diagonal[1].abs()), four * diagonal[2].abs());
        if R::IS_OBLIQUE {
            let o = like.constant(0.0);
            let axis = self.rotation.tilt([o, o, like.constant(1.0)]);
            let [turned_x, turned_y, turned_z] = along_axes(axis, turned, about);
            let [moved_x, moved_y, moved_z] = along_axes(axis, across, along);
            return [
                y.mul_add(moved_z, z.mul_add(moved_y, turned_x)),
                z.mul_add(moved_x, x.mul_add(moved_z, turned_y)),
                x.mul_add(moved_y, y.mul_add(moved_x, turned_z)),
                moved_x,
                moved_y,
                moved_z,
            ];
        }
        [
            y.mul_add(along, z.mul_add(across, turned)),
            x.mul_add(along, z.mul_add(across, turned)),
            (x + y).mul_add(across, about),
            across,
            across,
            along,
        ]
    }
}

impl<T: Real, R: Rotates<T>, A: Axes> Transform<T> for Axial<T, R, A> {
    #[inline(always)]
    fn offset_square(&self) -> T {
        self.offset.square
    }

    #[inline(always)]
    fn rotate_to_parent(&self, v: [T; 3]) -> [T; 3] {
        self.axes.vector(self.rotation.rotate(v))
    }

    #[inline(always)]
    fn rotate_to_child(&self, v: [T; 3]) -> [T; 3] {
        let [v] = self.free_to_child([v]);
        v
    }

    #[inline(always)]
    fn offset_at_parent(&self) -> [T; 3] {
        self.axes.vector(self.offset.entries)
    }

    #[inline(always)]
    fn send_force(&self, z: &[T; 6], begins: bool, sum: &mut [T; 6]) {
        self.axes.send_vector(&self.in_joint_frame(z), begins, sum);
    }

    #[inline(always)]
    fn carry_motion(&self, lambda: &[T; 6]) -> [T; 6] {
        let [a, b, c, d, e, f] = self.axes.to_joint(lambda);
        let v = self.offset.velocity([a, b, c], [d, e, f]);
        let (w, v) = (self.rotation.rotate_back([a, b, c]), self.rotation.rotate_back(v));
        [w[0], w[1], w[2], v[0], v[1], v[2]]
    }

    #[inline(always)]
    fn send_covariance(&self, p: &[T; 21], begins: bool, sum: &mut [T; 21]) {
        self.axes.send_covariance(&along_offset(&self.offset, &self.rotation.covariance(p)), begins, sum);
    }

    /// Applies the z, y and x components of the offset in turn, with s = h + m l: I' = I + (l.h + l.s) 1 - (h l* + l
    /// s*).
    #[inline(always)]
    fn composite_to_parent(&self, r: &BodyInertia<T>) -> BodyInertia<T> {
        let (m, mut h) = (r.mass, self.rotation.rotate(r.first_moment.into()));
        let mut i = self.rotation.symmetric(r.rotational.entries);
        let [x, y, z] = self.offset.entries;
        let s = m.mul_add(z, h[2]);
        let both = z * (h[2] + s);
        i = [i[0] + both, i[1], i[2].minus_product(h[0], z), i[3] + both, i[4].minus_product(h[1], z), i[5]];
        h[2] = s;
        let s = m.mul_add(y, h[1]);
        let both = y * (h[1] + s);
        i = [i[0] + both, i[1].minus_product(h[0], y), i[2], i[3], i[4].minus_product(y, h[2]), i[5] + both];
        h[1] = s;
        let s = m.mul_add(x, h[0]);
        let both = x * (h[0] + s);
        i = [i[0], i[1].minus_product(x, h[1]), i[2].minus_product(x, h[2]), i[3] + both, i[4], i[5] + both];
        h[0] = s;
        BodyInertia {
            mass: m,
            first_moment: Vector3::from(self.axes.vector(h)),
            rotational: Symmetric3::new(self.axes.symmetric(&i)),
        }
    }

    #[inline(always)]
    fn send_terms(&self, diagonal: &[T; 6], begins: bool, sum: &mut [T; 6]) {
        self.axes.send_vector(&self.terms(diagonal), begins, sum);
    }

    #[inline(always)]
    fn root_to_parent(&self, root: &Root6<T>, columns: &mut RootColumns<T>) {
        let turn = self.rotation.turn();
        let AxialRotation { s, c } = turn;
        let (o, one) = (s.constant(0.0), s.constant(1.0));
        for (weight, &of_root) in columns.weights.iter_mut().zip(&root.weights) {
            *weight = of_root;
        }
        let r = &root.rows;
        // The linear parts (1, a, b), (0, 1, d) and (0, 0, 1).
        let (fx, fy) = (c.minus_product(s, r[1][0]), c.mul_add(r[1][0], s));
        let mut forces = [[fx, fy, r[2][0]], [-s, c, r[2][1]], [o, o, one]];
        let (x, y) = (c.minus_product(s, r[4][3]), c.mul_add(r[4][3], s));
        let mut moments = [
            [r[3][0], r[4][0], r[5][0]],
            [r[3][1], r[4][1], r[5][1]],
            [r[3][2], r[4][2], r[5][2]],
            [x, y, r[5][3]],
            [-s, c, r[5][4]],
            [o, o, one],
        ];
        for moment in &mut moments[..3] {
            (moment[0], moment[1]) = turn.pair(moment[0], moment[1]);
        }
        if R::IS_OBLIQUE {
            for force in &mut forces {
                *force = self.rotation.tilt(*force);
            }
            for moment in &mut moments {
                *moment = self.rotation.tilt(*moment);
            }
        }
        for j in 0..if R::IS_OBLIQUE { 3 } else { 2 } {
            moments[j] = self.offset.moment(forces[j], moments[j]);
        }
        if !R::IS_OBLIQUE {
            // The third force is (0, 0, 1).
            let [lx, ly, _] = self.offset.entries;
            (moments[2][0], moments[2][1]) = (moments[2][0] + ly, moments[2][1] - lx);
        }
        self.axes.put_columns(&mut columns.rows, &forces, &moments);
    }
}

/// Bounds along x, y and z from the parts across and along an axis: the square of a sum of two terms is at most twice
/// the sum of their squares, and at most the trace.
#[inline(always)]
fn along_axes<T: Real>([x, y, z]: [T; 3], across: T, along: T) -> [T; 3] {
    let (xx, yy, zz, trace) = (x * x, y * y, z * z, across + along);
    let (across, along) = (across + across, along + along);
    [
        (yy + zz).mul_add(across, xx * along).worst(trace),
        (zz + xx).mul_add(across, yy * along).worst(trace),
        (xx + yy).mul_add(across, zz * along).worst(trace),
    ]
}
