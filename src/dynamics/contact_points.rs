//! Material points of contacts with planes of the base, for any scalar: gaps, velocities and J M^-1 J*.

use super::sweeps::{SweepModel, SweepScratch, general};
use crate::kinematics::{Frame, ReferenceFrame, frame_motion, jacobian, placement};
use crate::model::Model;
use crate::scalar::Real;
use crate::scene::contact_point::ContactPoint;
use crate::spatial::{RigidShift, angular, cross, linear};
use nalgebra::{Matrix3, Vector3};

/// The geometry of a contact, in any scalar.
struct Sphere<T: Real> {
    body: Frame<T>,
    center: Vector3<T>,
    radius: T,
    normal: Vector3<T>,
    offset: T,
}

impl<T: Real> Sphere<T> {
    fn of(point: &ContactPoint) -> Self {
        let ContactPoint { body, center, radius, axes, offset, .. } = point;
        let axes: Matrix3<T> = axes.map(T::from_f64);
        Self {
            body: Frame { body: Some(*body), placement: RigidShift::identity() },
            center: center.map(T::from_f64),
            radius: T::from_f64(*radius),
            normal: axes.row(2).transpose(),
            offset: T::from_f64(*offset),
        }
    }

    /// The material point nearest to the plane, in the frame of the body, whose pose is `place`.
    fn nearest(&self, place: &RigidShift<T>) -> Vector3<T> {
        self.center - place.rotate_back(&self.normal) * self.radius
    }
}

/// Gaps of the contacts at `q`, into `out`, m.
pub(crate) fn gaps<T: Real>(model: &Model<T>, points: &[ContactPoint], q: &[T], out: &mut [T]) {
    for (point, gap) in points.iter().zip(out) {
        let sphere = Sphere::of(point);
        let place = placement(model, q, &sphere.body);
        let center = place.rotate(&sphere.center) + place.lever;
        *gap = sphere.normal.dot(&center) - sphere.radius - sphere.offset;
    }
}

/// Velocities of the material points nearest to the planes, in the base frame, into `out`, (contacts x 3), m/s.
pub(crate) fn velocities<T: Real>(model: &Model<T>, points: &[ContactPoint], (q, qd): (&[T], &[T]), out: &mut [T]) {
    for (point, out) in points.iter().zip(out.chunks_exact_mut(3)) {
        let sphere = Sphere::of(point);
        let motion = frame_motion(model, q, qd, None, &sphere.body);
        let turning = cross(&angular(&motion.velocity), &sphere.nearest(&motion.placement));
        let velocity = motion.placement.rotate(&(linear(&motion.velocity) + turning));
        out.copy_from_slice(velocity.as_slice());
    }
}

/// J M^-1 J* of these points in the base frame, (3 contacts x 3 contacts), with the factor of M in the scratch: the
/// velocities due to unit impulses. As for [connections](super::constraints), the innovations of unit impulses are
/// multiplied, without subtraction.
pub(crate) fn gram<T: Real>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    points: &[ContactPoint],
    q: &[T],
    out: &mut [T],
) {
    let (nv, m) = (model.nv(), 3 * points.len());
    let (mut columns, mut innovations) = (vec![T::zero(); 6 * nv], vec![T::zero(); m * nv]);
    for (point, own) in points.iter().zip(innovations.chunks_exact_mut(3 * nv.max(1))) {
        let sphere = Sphere::of(point);
        let lever = sphere.nearest(&placement(model, q, &sphere.body));
        let frame = Frame { placement: RigidShift { lever, ..RigidShift::identity() }, ..sphere.body };
        columns.fill(T::zero());
        jacobian(model, q, &frame, ReferenceFrame::LocalWorldAligned, &mut columns);
        // The linear rows.
        for (row, own) in columns[3 * nv..].chunks_exact(nv.max(1)).zip(own.chunks_exact_mut(nv.max(1))) {
            general::innovations::<_, false>((model, sweeps), scratch, row, own);
        }
    }
    for i in 0..m {
        for j in 0..=i {
            let mut sum = T::zero();
            for row in 0..nv {
                let weighted = innovations[i * nv + row] * scratch.pivot_inverse(row);
                sum = weighted.mul_add(innovations[j * nv + row], sum);
            }
            out[i * m + j] = sum;
            out[j * m + i] = sum;
        }
    }
}
