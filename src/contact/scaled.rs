//! A problem in numbers near one, and how far a contact is from the edge of its cone.

use super::law::{Cone, Limits};
use nalgebra::{DMatrix, DVector, Vector2};

/// Room that is less than this part of mu `p_n` is solved by itself: a difference would lose its digits.
const NEAR_THE_EDGE: f64 = 0.1;

/// A problem as A = w G w, p = w z times a unit, w = sqrt r: one number a contact, so that cones stay cones.
#[derive(Debug, Clone)]
pub(super) struct Scaled<'a> {
    pub cone: &'a Cone,
    /// G in these numbers.
    pub a: DMatrix<f64>,
    /// Free velocities, the largest entry 1 or less.
    pub c: DVector<f64>,
    /// The least normal impulse of each contact.
    pub least: Vec<f64>,
    /// What turns z into impulses, a contact's number three times.
    into_impulses: DVector<f64>,
}

impl<'a> Scaled<'a> {
    pub fn new(cone: &'a Cone, c: &DVector<f64>, limits: &Limits) -> Self {
        let m = 3 * cone.len();
        let w = DVector::from_fn(m, |i, _| cone.lengths[i / 3].sqrt());
        let a = DMatrix::from_fn(m, m, |i, j| w[i] * cone.g[(i, j)] * w[j]);
        let c = c.component_mul(&w);
        let least: Vec<f64> = limits.least.iter().enumerate().map(|(i, least)| least / w[3 * i]).collect();
        let unit = least.iter().fold(c.amax(), |largest, &least| largest.max(least)).max(f64::MIN_POSITIVE);
        let least = least.iter().map(|least| least / unit).collect();
        Self { cone, a, c: c / unit, least, into_impulses: w * unit }
    }

    /// How many contacts.
    pub fn len(&self) -> usize {
        self.cone.len()
    }

    /// Whether a contact has any friction.
    pub fn grips(&self, i: usize) -> bool {
        self.cone.friction[i] > 0.0
    }

    /// The radius of the disc that holds `p_t`, mu `p_n`.
    pub fn radius(&self, i: usize, z: &DVector<f64>) -> f64 {
        self.cone.friction[i] * z[3 * i + 2]
    }

    /// `p_t` over mu `p_n`.
    pub fn pull(&self, i: usize, z: &DVector<f64>) -> Vector2<f64> {
        Vector2::new(z[3 * i], z[3 * i + 1]) / self.radius(i, z)
    }

    /// The normal impulse above the least.
    pub fn above(&self, i: usize, z: &DVector<f64>) -> f64 {
        z[3 * i + 2] - self.least[i]
    }

    /// The room of a contact, q - |`p_t`|^2/q with q = mu `p_n`: zero at the edge of its cone.
    pub fn room(&self, i: usize, z: &DVector<f64>) -> f64 {
        let (q, t) = (self.radius(i, z), z[3 * i].hypot(z[3 * i + 1]));
        (q - t) * (q + t) / q
    }

    /// How the room changes where z does by dz, to first order.
    pub fn room_change(&self, i: usize, z: &DVector<f64>, dz: &DVector<f64>) -> f64 {
        let pull = self.pull(i, z);
        let wider = self.cone.friction[i] * (1.0 + pull.norm_squared()) * dz[3 * i + 2];
        wider - 2.0 * (pull[0] * dz[3 * i] + pull[1] * dz[3 * i + 1])
    }

    /// Draws `p_t` in until a contact has the room that a step's first order gives it: a step turns `p_t` along the edge, which is round. The room
    /// that it has.
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
        // The difference of two that are almost equal: what was carried along has more digits.
        let rounding = 16.0 * f64::EPSILON * q;
        if (room - first_order).abs() < rounding { first_order } else { room }
    }

    /// The impulses, N s, in their cones.
    pub fn impulses(&self, z: &DVector<f64>, limits: &Limits) -> DVector<f64> {
        let mut p = z.component_mul(&self.into_impulses);
        // Scaling back may round them out.
        self.cone.project(&mut p, &limits.least);
        p
    }
}
