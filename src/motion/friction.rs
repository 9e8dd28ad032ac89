//! Dry friction that depends on direction, speed and load: the terms of [`FrictionCurve`] beside Coulomb friction.
//!
//! With the direction s of the motion, 1 or -1 (v / sqrt(v^2 + v0^2) where friction is regularized), the friction
//! without load, d = f + g exp(-(v/v_s)^2), and the sum u of all other torques of a joint, the torque t that reaches the
//! bodies, its load, is the solution of t = u - o - s (d + c |t|):
//!
//! ```text
//! t = w/(1 + s c sign(w)),     w = u - o - s d
//! ```
//!
//! The factor is the efficiency of the transmission. In implicit steps it multiplies the noise of the row too, with
//! which M + N stays symmetric. Where a joint can be held or change its direction, the friction of both directions is
//! that of the start of the step.

use super::properties::{Properties, joint_of_row};
use super::scratch::{ModeTerms, Scratch};
use super::step_settings::{StepArguments, StepSettings};
use super::stops::SetValued;
use crate::error::{Error, check_length};
use crate::scalar::Real;
use crate::scene::{Coupling, FrictionCurve, Scene};

impl FrictionCurve {
    /// d, the friction without load.
    fn unloaded(&self, coulomb: f64, v: f64) -> f64 {
        coulomb + self.stribeck * (-(v / self.stribeck_speed).powi(2)).exp()
    }

    /// t/w for the direction s.
    fn efficiency(&self, s: f64, w: f64) -> f64 {
        1.0 / (1.0 + s * self.load * if w == 0.0 { 0.0 } else { w.signum() })
    }

    /// The friction against motion in the negative and in the positive direction, beside the torques u.
    fn both(&self, coulomb: f64, (v, u): (f64, f64)) -> [f64; 2] {
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
    coulomb: f64,
    curve: FrictionCurve,
    /// The direction of a row that slides with exact friction, else zero, and t/w in this step.
    direction: f64,
    efficiency: f64,
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

impl<T: Real> Scratch<T> {
    /// Friction against motion in the negative and in the positive direction at the start of a step, beside the torques
    /// u.
    pub fn friction_of(&self, row: usize, usual: [f64; 2], u: f64) -> [f64; 2] {
        let curved = self.curved.iter().find(|of| of.row == row);
        curved.map_or(usual, |of| of.curve.both(of.coulomb, (self.v[row].lane(0), u)))
    }

    /// As [`Self::friction_of`], beside the torques in `u`.
    #[inline(always)]
    pub fn friction_of_mode(&self, mode: &ModeTerms<T>) -> [T; 2] {
        if self.curved.is_empty() {
            return [mode.friction; 2];
        }
        let u = self.u[mode.row].lane(0);
        self.friction_of(mode.row, [mode.friction.lane(0); 2], u).map(T::from_f64)
    }

    /// The set-valued law of a row with the friction at the start of a step, beside the torques u.
    pub fn at_start(&self, of: &SetValued, u: f64) -> SetValued {
        let friction = if of.rubs() { self.friction_of(of.row, of.friction, u) } else { of.friction };
        SetValued { friction, ..*of }
    }

    /// Adds the friction torques in stage `i` of the rows with friction curves to all other torques in `u`. These rows
    /// are not in lanes.
    pub fn rub(&mut self, (settings, scheme): StepArguments<'_>, i: usize) {
        let v0 = settings.properties.friction_speed;
        let Self { curved, rows, model, dry, chord, v_stage, u: torques, .. } = self;
        for of in curved {
            let (v, u) = (v_stage[of.row].lane(0), torques[of.row].lane(0));
            let d = of.curve.unloaded(of.coulomb, v);
            if i == 0 {
                // The mode of the row has the direction.
                let torque = std::mem::replace(&mut dry[of.row], T::zero()).lane(0);
                of.direction = if torque == 0.0 { 0.0 } else { -torque.signum() };
                of.impulse = 0.0;
            }
            let s = if v0 > 0.0 { v / v.hypot(v0) } else { of.direction };
            if v0 == 0.0 && s == 0.0 {
                continue;
            }
            let w = u - of.curve.offset - s * d;
            if i == 0 {
                of.efficiency = of.curve.efficiency(s, w);
                if scheme.implicit {
                    let secant = if v0 > 0.0 { d / v.hypot(v0) } else { 0.0 };
                    chord[of.row] = T::from_f64(secant);
                    let armature = settings.properties.armature[of.row];
                    let noise = scheme.tableau.gamma[0][0].mul_add(secant, rows[of.row].noise.lane(0)) - armature;
                    model.system.noise[of.row] = T::from_f64(of.efficiency.mul_add(noise, armature));
                }
            }
            let torque = of.efficiency * w - u;
            torques[of.row] += T::from_f64(torque);
            of.impulse += scheme.tableau.weights[i] * torque;
        }
    }

    /// Adds the part of friction in the noise of the rows with friction curves to its impulse, from the accelerations of
    /// stage `i`.
    pub fn rub_by_noise(&mut self, (settings, scheme): StepArguments<'_>, i: usize) {
        let slides = |of: &CurvedRow| settings.properties.friction_speed > 0.0 || of.direction != 0.0;
        for of in self.curved.iter_mut().filter(|of| scheme.implicit && slides(of)) {
            let noise = self.rows[of.row].noise.lane(0) - self.model.system.noise[of.row].lane(0);
            of.impulse += scheme.tableau.weights[i] * noise * self.m[i][of.row].lane(0);
        }
    }
}
