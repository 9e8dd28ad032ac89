//! All contacts of a scene with planes of the base, for one state per lane of a scalar: gaps, velocities, G = J M^-1 J*
//! of all contacts, and the effect of impulses. The factor of M is in the scratch of the
//! [sweeps](crate::dynamics::sweeps).
//!
//! The rows are those of [`contacts`](super::contacts): t1, t2, n of the plane of each contact; or the axes of the base
//! frame.

use super::contact_rows::UnitForces;
use super::sweeps::{
    Forces, MOST_FORCES, Path, SweepModel, SweepScratch, WhitenedRows, accelerations_along, frame_here, placement_along,
};
use crate::model::Model;
use crate::scalar::Real;
use crate::scene::contact_point::ContactPoint;
use crate::spatial::RigidShift;
use nalgebra::{Matrix3, Vector3, Vector6};

/// One contact, in the scalar of the kernel.
#[derive(Debug)]
struct Touching<T> {
    /// The pose of the frame at the center of the sphere, with the axes of the body in the model, in the body frame of
    /// the sweeps.
    frame: RigidShift<T>,
    /// The step of its path that is the body.
    step: usize,
    /// The directions of the rows, and the normal of the plane.
    axes: Matrix3<T>,
    normal: Vector3<T>,
    offset: T,
    radius: T,
}

impl<T: Real> Touching<T> {
    /// The distance of the sphere from the plane, for the pose of its frame in the base frame.
    #[inline(always)]
    fn gap(&self, place: &RigidShift<T>) -> T {
        let (n, center) = (&self.normal, &place.lever);
        n[0] * center[0] + n[1] * center[1] + n[2] * center[2] - self.radius - self.offset
    }
}

/// The contacts of one scene at the current states; initialized with NaN.
#[derive(Debug)]
pub(crate) struct ContactKernel<T> {
    contacts: Vec<Touching<T>>,
    /// W and G, three rows per contact.
    whitened: WhitenedRows<T>,
    units: Vec<UnitForces<T>>,
    /// One per step of the longest path.
    forces: Vec<Forces<T>>,
    motions: Vec<[T; 6]>,
    /// No torques act with the unit forces.
    torque: Vec<T>,
    /// The distance of each contact to its plane, m.
    pub gaps: Vec<T>,
}

impl<T: Real> ContactKernel<T> {
    pub fn new((model, sweeps): (&Model<T>, &SweepModel<T>), points: &[ContactPoint]) -> Self {
        let (nan, zero, n) = (T::from_f64(f64::NAN), T::zero(), points.len());
        let paths = points.iter().map(|point| Path::new(sweeps, (&point.path, &point.path), &[point.body]));
        let paths: Vec<_> = paths.enumerate().map(|(i, path)| (path, 3 * i..3 * i + 3)).collect();
        let contact = |(point, (path, _)): (&ContactPoint, &(Path, _))| {
            let step = path.step_of(point.body).unwrap_or_default();
            let center = RigidShift { rotation: Matrix3::identity(), lever: point.center };
            Touching {
                frame: frame_here(sweeps, (path, step), &center.cast()),
                step,
                axes: point.axes.map(T::from_f64),
                normal: point.normal().map(T::from_f64),
                offset: T::from_f64(point.offset),
                radius: T::from_f64(point.radius),
            }
        };
        let contacts = points.iter().zip(&paths).map(contact).collect();
        let whitened = WhitenedRows::new(model, paths);
        let longest = whitened.longest();
        Self {
            contacts,
            whitened,
            units: vec![UnitForces::zero(); n],
            forces: vec![Forces { z: [[nan; 6]; MOST_FORCES], moments: [nan; MOST_FORCES] }; longest],
            motions: vec![[nan; 6]; longest],
            torque: vec![zero; model.nv()],
            gaps: vec![nan; n],
        }
    }

    /// With rows along the axes of the base frame.
    pub fn along_base_axes(mut self) -> Self {
        self.contacts.iter_mut().for_each(|contact| contact.axes = Matrix3::identity());
        self
    }

    /// Gaps and unit forces at the q of the scratch.
    #[inline(always)]
    pub fn place(&mut self, scene: (&Model<T>, &SweepModel<T>), scratch: &SweepScratch<T>) {
        let zero = scene.0.gravity[0].constant(0.0);
        let Self { contacts, whitened, units, gaps, .. } = self;
        for (((contact, of), units), gap) in contacts.iter().zip(&whitened.paths).zip(units).zip(gaps) {
            let Touching { frame, step, axes, normal, radius, .. } = contact;
            let place = placement_along(scene, scratch, (&of.path, *step), (frame, &[zero; 3]));
            *gap = contact.gap(&place);
            let arm = Vector3::new(-(normal[0] * *radius), -(normal[1] * *radius), -(normal[2] * *radius));
            units.set(0, (axes, &arm), (&place, frame));
        }
    }

    /// The gaps at the q of another scratch; the unit forces remain.
    #[inline(always)]
    pub fn place_gaps(&mut self, scene: (&Model<T>, &SweepModel<T>), scratch: &SweepScratch<T>) {
        let zero = scene.0.gravity[0].constant(0.0);
        for ((contact, of), gap) in self.contacts.iter().zip(&self.whitened.paths).zip(&mut self.gaps) {
            *gap =
                contact.gap(&placement_along(scene, scratch, (&of.path, contact.step), (&contact.frame, &[zero; 3])));
        }
    }

    /// J v of all contacts, m/s, into `out`.
    #[inline(always)]
    pub fn velocities(
        &mut self,
        scene: (&Model<T>, &SweepModel<T>),
        scratch: &SweepScratch<T>,
        v: &[T],
        out: &mut [T],
    ) {
        let Self { contacts, whitened, units, motions, .. } = self;
        for (at, (contact, of)) in contacts.iter().zip(&whitened.paths).enumerate() {
            accelerations_along(scene, scratch, (&of.path, v), motions);
            let velocity = Vector6::from(motions[contact.step]);
            for row in 0..3 {
                out[3 * at + row] = units[at].velocity(row, &velocity, None);
            }
        }
    }

    /// W and G of all contacts.
    #[inline(always)]
    pub fn multiply(&mut self, scene: (&Model<T>, &SweepModel<T>), scratch: &SweepScratch<T>) {
        let zero = scene.0.gravity[0].constant(0.0);
        let Self { contacts, whitened, units, forces, torque, .. } = self;
        for (at, (contact, units)) in contacts.iter().zip(units).enumerate() {
            units.put(forces, [Some(contact.step), None], zero);
            whitened.innovations_of(at, scene, scratch, (forces, torque));
        }
        whitened.multiply(zero);
    }

    /// G, in the lower triangle, (3 contacts x 3 contacts).
    pub fn gram(&self) -> &[T] {
        &self.whitened.gram
    }

    /// G at the q of the scratch, row by row.
    pub fn gram_at(&mut self, scene: (&Model<T>, &SweepModel<T>), scratch: &SweepScratch<T>, out: &mut [T]) {
        self.place(scene, scratch);
        self.multiply(scene, scratch);
        let m = 3 * self.gaps.len();
        for (at, out) in out.iter_mut().enumerate() {
            let (i, j) = (at / m, at % m);
            *out = self.gram()[i.max(j) * m + i.min(j)];
        }
    }

    /// J v + G p of all contacts, into `out`, from J v.
    #[inline(always)]
    pub fn velocities_after(&self, before: &[T], impulses: &[T], out: &mut [T]) {
        let (m, gram) = (before.len(), self.gram());
        for (i, out) in out.iter_mut().enumerate() {
            let own = &gram[i * m..=i * m + i];
            let mut sum = before[i];
            for (&g, &p) in own.iter().zip(impulses) {
                sum = g.mul_add(p, sum);
            }
            for (j, &p) in impulses.iter().enumerate().skip(i + 1) {
                sum = gram[j * m + i].mul_add(p, sum);
            }
            *out = sum;
        }
    }

    /// The innovations of impulses at the contacts, into `innovations`; the smoother computes M^-1 J* p from them.
    #[inline(always)]
    pub fn innovations_of(&self, impulses: &[T], innovations: &mut [T]) {
        for e in innovations.iter_mut() {
            *e = e.constant(0.0);
        }
        self.whitened.add(impulses, innovations);
    }
}
