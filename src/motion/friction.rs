//! Dry friction that depends on direction, speed and load, in a step: see [`friction_curve`](super::friction_curve).

use super::friction_curve::CurvedRow;
use super::scratch::{ModeTerms, Scratch};
use super::step_settings::StepArguments;
use super::stops::SetValued;
use crate::scalar::Real;

impl<T: Real> Scratch<T> {
    /// Friction against motion in the negative and in the positive direction at the start of a step, beside the torques
    /// u, of which those of wrenches do not pass the transmission.
    pub fn friction_of(&self, row: usize, usual: [f64; 2], u: f64) -> [f64; 2] {
        let curved = self.curved.iter().find(|of| of.row == row);
        let u = u - self.wrenches.torque.get(row).map_or(0.0, |torque| torque.lane(0));
        curved.map_or(usual, |of| of.curve.both(of.coulomb, (self.v[row].lane(0), u)))
    }

    /// As [`Self::friction_of`], beside the torques in `u`. That of a moving row, which can be negative in one
    /// direction, holds nothing: the usual one.
    #[inline(always)]
    pub fn friction_of_mode(&self, mode: &ModeTerms<T>) -> [T; 2] {
        if self.curved.is_empty() || mode.stuck.lane(0) == 0.0 {
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

    /// Adds the part of friction in the noise of the rows with friction curves to its impulse, from the accelerations
    /// of stage `i`.
    pub fn rub_by_noise(&mut self, (settings, scheme): StepArguments<'_>, i: usize) {
        let slides = |of: &CurvedRow| settings.properties.friction_speed > 0.0 || of.direction != 0.0;
        for of in self.curved.iter_mut().filter(|of| scheme.implicit && slides(of)) {
            let noise = self.rows[of.row].noise.lane(0) - self.model.system.noise[of.row].lane(0);
            of.impulse += scheme.tableau.weights[i] * noise * self.m[i][of.row].lane(0);
        }
    }
}
