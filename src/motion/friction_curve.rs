//! Dry friction that depends on direction, speed and load: the terms of [`FrictionCurve`] beside Coulomb friction.
//!
//! With the direction s of the motion, 1 or -1 (v / sqrt(v^2 + v0^2) where friction is regularized), the friction
//! without load, d = f + g exp(-(v/v_s)^2), and the sum u of all other torques of a joint, the torque t that reaches
//! the bodies, its load, is the solution of t = u - o - s (d + c |t|):
//!
//! ```text
//! t = w/(1 + s c sign(w)),     w = u - o - s d
//! ```
//!
//! The factor is the efficiency of the transmission. In implicit steps it multiplies the noise of the row too, with
//! which M + N stays symmetric. Where a joint can be held or change its direction, the friction of both directions is
//! that of the start of the step.

use super::properties::{Properties, joint_of_row};
use super::step_settings::StepSettings;
use crate::error::{Error, check_length};
use crate::scene::{Coupling, FrictionCurve, Scene};

impl FrictionCurve {
    /// d, the friction without load.
    pub(super) fn unloaded(&self, coulomb: f64, v: f64) -> f64 {
        coulomb + self.stribeck * (-(v / self.stribeck_speed).powi(2)).exp()
    }

    /// t/w for the direction s.
    pub(super) fn efficiency(&self, s: f64, w: f64) -> f64 {
        1.0 / (1.0 + s * self.load * if w == 0.0 { 0.0 } else { w.signum() })
    }

    /// The friction against motion in the negative and in the positive direction, beside the torques u.
    pub(super) fn both(&self, coulomb: f64, (v, u): (f64, f64)) -> [f64; 2] {
        let d = self.unloaded(coulomb, v);
        [-1.0, 1.0].map(|s| {
            let w = u - self.offset - s * d;
            s * (u - self.efficiency(s, w) * w)
        })
    }

    /// A bound of friction for a load of one.
    pub(super) fn size(&self, coulomb: f64) -> f64 {
        coulomb + self.stribeck.abs() + self.offset.abs() + self.load
    }
}

/// A row with a friction curve.
#[derive(Debug, Clone, Copy)]
pub(super) struct CurvedRow {
    pub row: usize,
    pub coulomb: f64,
    pub curve: FrictionCurve,
    /// The direction of a row that slides with exact friction, else zero, and t/w in this step.
    pub direction: f64,
    pub efficiency: f64,
    /// Impulse of friction in a step of stages, N m s or N s.
    pub impulse: f64,
}

/// Checks that no joint that follows another, or that others follow, has a friction curve.
pub(super) fn check_curves(scene: &Scene, coupling: Option<&Coupling>, properties: &Properties) -> Result<(), Error> {
    if ![0, scene.nv()].contains(&properties.curves.len()) {
        check_length("curves", properties.curves.len(), scene.nv())?;
    }
    let (Some(coupling), curves) = (coupling, &properties.curves) else { return Ok(()) };
    let alone = |row: &usize| coupling.rows_with(*row) == 1;
    let Some(row) = (0..curves.len()).find(|row| !curves[*row].is_flat() && !alone(row)) else { return Ok(()) };
    let joint = joint_of_row(scene, row);
    let found =
        format!("friction_offset, stribeck or load_friction of joint {joint:?}, which follows others or moves them");
    Err(Error::argument("scene", found, "Coulomb friction alone at joints that mimic joints follow"))
}

/// The rows with friction curves, with their Coulomb friction.
pub(super) fn curved_rows(settings: &StepSettings) -> Vec<CurvedRow> {
    let curves = settings.properties.curves.iter().enumerate().filter(|(_, curve)| !curve.is_flat());
    let row = |(row, &curve): (usize, &FrictionCurve)| {
        let coulomb = settings.properties.friction[row];
        CurvedRow { row, coulomb, curve, direction: 0.0, efficiency: 1.0, impulse: 0.0 }
    };
    curves.map(row).collect()
}
