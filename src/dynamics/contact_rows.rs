//! The three rows of a contact, for any scalar: unit forces on its links, velocities, and the forces whose innovations
//! are its rows of W.

use super::sweeps::Forces;
use crate::scalar::Real;
use crate::spatial::{RigidShift, cross, dot, spatial, zero};
use nalgebra::{Matrix3, Vector3, Vector6};

/// Unit forces along the rows of a contact on its body, and the opposite forces on the body of its surface, each in the
/// frame that the passes use for the body; zero for other surfaces.
#[derive(Debug, Clone, Copy)]
pub(crate) struct UnitForces<T>(pub [[Vector6<T>; 3]; 2]);

impl<T: Real> UnitForces<T> {
    pub fn zero() -> Self {
        Self([[zero(); 3]; 2])
    }

    /// Sets the forces on one of the bodies, along the rows of `axes`: `place` is the pose of a frame in the base
    /// frame, `frame` its pose in the frame of the body, and `arm` the vector from its origin to the point of contact
    /// in the base frame.
    #[inline(always)]
    pub fn set(
        &mut self,
        end: usize,
        (axes, arm): (&Matrix3<T>, &Vector3<T>),
        (place, frame): (&RigidShift<T>, &RigidShift<T>),
    ) {
        let arm = place.rotate_back(arm);
        // Without closures, which are compiled for the baseline where they are not inlined.
        for (row, unit) in self.0[end].iter_mut().enumerate() {
            let axis = Vector3::new(axes[(row, 0)], axes[(row, 1)], axes[(row, 2)]);
            let force = place.rotate_back(&if end == 0 { axis } else { -axis });
            *unit = frame.force_to_parent(&spatial(&cross(&arm, &force), &force));
        }
    }

    /// J v of one row, m/s, from the velocities of the bodies.
    #[inline(always)]
    pub fn velocity(&self, row: usize, own: &Vector6<T>, other: Option<&Vector6<T>>) -> T {
        let [units, opposite] = &self.0;
        let velocity = dot(&units[row], own);
        match other {
            Some(other) => velocity + dot(&opposite[row], other),
            None => velocity,
        }
    }

    /// Sets the forces of the rows on the bodies at the ends of a path. Those on its other bodies are set by the first
    /// that they receive.
    #[inline(always)]
    pub fn put(&self, forces: &mut [Forces<T>], ends: [Option<usize>; 2], zero: T) {
        for step in ends.into_iter().flatten() {
            let on = &mut forces[step];
            (on.z[0], on.z[1], on.z[2]) = ([zero; 6], [zero; 6], [zero; 6]);
            (on.moments[0], on.moments[1], on.moments[2]) = (zero, zero, zero);
        }
        for (step, units) in ends.into_iter().zip(&self.0) {
            let Some(step) = step else { continue };
            // A force on a body reduces the force that its joint transmits.
            for (z, unit) in forces[step].z.iter_mut().zip(units) {
                for i in 0..6 {
                    z[i] -= unit[i];
                }
            }
        }
    }
}
