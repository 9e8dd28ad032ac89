//! A problem scaled to values of order one, and the distance of a contact from the boundary of its cone.

use super::gram::Gram;
use super::law::{Cone, Limits};
use nalgebra::{DVector, Vector2};

/// Distances from the boundary below this fraction of mu `p_n` are independent variables, because a difference would
/// lose precision.
const NEAR_THE_EDGE: f64 = 0.1;

/// The scaled problem A = w G w with p = w z times a unit and w = sqrt(r). Each contact has one scale, which preserves
/// cones.
#[derive(Debug, Clone)]
pub(super) struct Scaled<'a> {
    pub cone: &'a Cone,
    /// G in scaled variables.
    pub a: Gram,
    /// Free velocities, scaled to a largest entry of at most 1.
    pub c: DVector<f64>,
    /// Lower bound of the normal impulse of each contact.
    pub least: Vec<f64>,
    /// Factor from z to impulses, three equal entries per contact.
    into_impulses: DVector<f64>,
    /// Factor from scaled velocities to velocities times w; its square is that of energies.
    pub unit: f64,
}

impl<'a> Scaled<'a> {
    pub fn new(cone: &'a Cone, c: &DVector<f64>, limits: &Limits) -> Self {
        Self::with_energy(cone, c, limits, 0.0)
    }

    /// The scaled problem, with a unit for which an energy, J, is at most one too.
    pub fn with_energy(cone: &'a Cone, c: &DVector<f64>, limits: &Limits, energy: f64) -> Self {
        let m = 3 * cone.len();
        let w = DVector::from_fn(m, |i, _| cone.lengths[i / 3].sqrt());
        let a = cone.g.scaled(&w);
        let c = c.component_mul(&w);
        let least: Vec<f64> = limits.least.iter().enumerate().map(|(i, least)| least / w[3 * i]).collect();
        let unit = least.iter().fold(c.amax(), |largest, &least| largest.max(least)).max(energy.sqrt());
        let unit = unit.max(f64::MIN_POSITIVE);
        let least = least.iter().map(|least| least / unit).collect();
        Self { cone, a, c: c / unit, least, into_impulses: w * unit, unit }
    }

    /// Number of contacts.
    pub fn len(&self) -> usize {
        self.cone.len()
    }

    /// True if a contact has friction.
    pub fn grips(&self, i: usize) -> bool {
        self.cone.friction[i] > 0.0
    }

    /// Radius of the friction disc of `p_t`, mu `p_n`.
    pub fn radius(&self, i: usize, z: &DVector<f64>) -> f64 {
        self.cone.friction[i] * z[3 * i + 2]
    }

    /// `p_t` relative to mu `p_n`.
    pub fn pull(&self, i: usize, z: &DVector<f64>) -> Vector2<f64> {
        Vector2::new(z[3 * i], z[3 * i + 1]) / self.radius(i, z)
    }

    /// Normal impulse minus its lower bound.
    pub fn above(&self, i: usize, z: &DVector<f64>) -> f64 {
        z[3 * i + 2] - self.least[i]
    }

    /// Distance of a contact from the boundary of its cone, q - |`p_t`|^2/q with q = mu `p_n`; zero on the boundary.
    pub fn room(&self, i: usize, z: &DVector<f64>) -> f64 {
        let (q, t) = (self.radius(i, z), z[3 * i].hypot(z[3 * i + 1]));
        (q - t) * (q + t) / q
    }

    /// First-order change of that distance for a change dz of z.
    pub fn room_change(&self, i: usize, z: &DVector<f64>, dz: &DVector<f64>) -> f64 {
        let pull = self.pull(i, z);
        let wider = self.cone.friction[i] * (1.0 + pull.norm_squared()) * dz[3 * i + 2];
        wider - 2.0 * (pull[0] * dz[3 * i] + pull[1] * dz[3 * i + 1])
    }

    /// Reduces `p_t` until the distance of a contact from the boundary has its first-order value, because a step moves
    /// `p_t` along the curved boundary. Returns the resulting distance.
    pub fn draw_in(&self, i: usize, z: &mut DVector<f64>, first_order: f64) -> f64 {
        let q = self.radius(i, z);
        let room = self.room(i, z);
        let wanted = first_order.min(NEAR_THE_EDGE * q);
        if room < wanted {
            let kept = (q * (q - wanted)).sqrt() / z[3 * i].hypot(z[3 * i + 1]);
            z[3 * i] *= kept;
            z[3 * i + 1] *= kept;
            return wanted;
        }
        // Near the boundary the difference cancels, and the propagated first-order value is more precise.
        let rounding = 16.0 * f64::EPSILON * q;
        if (room - first_order).abs() < rounding { first_order } else { room }
    }

    /// Scaled impulses.
    pub fn of_impulses(&self, p: &DVector<f64>) -> DVector<f64> {
        p.component_div(&self.into_impulses)
    }

    /// The impulses, N s, projected onto their cones.
    pub fn impulses(&self, z: &DVector<f64>, limits: &Limits) -> DVector<f64> {
        let mut p = z.component_mul(&self.into_impulses);
        // Scaling back can round them out of the cones.
        self.cone.project(&mut p, &limits.least);
        p
    }
}
