//! What joints do by themselves: armature, damping, springs, friction, and a control law that acts like them.

use crate::error::{Error, check_finite, check_length};
use crate::scene::Scene;
use std::collections::HashMap;

/// The speed below which regularized friction falls off, rad/s or m/s, where friction is not exact and no other is given.
pub const FRICTION_SPEED: f64 = 1e-2;

/// Properties of the joints in simulation, by degree of freedom; copied from a scene and free to change.
#[derive(Debug, Clone, PartialEq)]
pub struct Properties {
    /// Inertia of the rotors, (nv), kg m^2 or kg: part of M.
    pub armature: Vec<f64>,
    /// Viscous damping d, (nv), N m s/rad or N s/m: the torque -d v.
    pub damping: Vec<f64>,
    /// Stiffness k, (nv), N m/rad or N/m: the torque -k s, s the displacement from rest.
    pub stiffness: Vec<f64>,
    /// Configuration where the springs are at rest, (nq).
    pub rest: Vec<f64>,
    /// Coulomb friction f, (nv), N m or N.
    pub friction: Vec<f64>,
    /// v0, rad/s or m/s. Zero: exact Coulomb friction, which holds a joint at rest; in scenes with contacts or connections it stands for
    /// [`FRICTION_SPEED`]. Positive: the regularized torque -f v / sqrt(v^2 + v0^2), within 1 % of f from 7 v0 on, and viscous below v0, so that joints creep.
    pub friction_speed: f64,
}

impl Properties {
    /// The properties that the scene's description gives.
    #[must_use]
    pub fn of(scene: &Scene) -> Self {
        let scene = scene.tree();
        let nv = scene.nv();
        let described: HashMap<&str, _> =
            scene.source().joints().iter().map(|joint| (joint.name.as_str(), joint)).collect();
        let mut properties = Self {
            armature: scene.model().system.noise.clone(),
            damping: vec![0.0; nv],
            stiffness: vec![0.0; nv],
            rest: scene.neutral(),
            friction: vec![0.0; nv],
            friction_speed: 0.0,
        };
        let root = scene.source().root_joint(String::new());
        for joint in scene.joints() {
            // The free joint of a floating base is not among those described.
            let of = described.get(joint.name.as_str()).copied().unwrap_or(&root);
            properties.damping[joint.v.clone()].fill(of.damping);
            properties.friction[joint.v.clone()].fill(of.friction);
            properties.stiffness[joint.v.clone()].fill(of.spring.stiffness);
            if !of.spring.rest.is_empty() {
                properties.rest[joint.q.clone()].copy_from_slice(&of.spring.rest);
            }
        }
        properties
    }

    pub(super) fn check(&self, scene: &Scene) -> Result<(), Error> {
        for (name, values) in [
            ("armature", &self.armature),
            ("damping", &self.damping),
            ("stiffness", &self.stiffness),
            ("friction", &self.friction),
        ] {
            check_positive(scene, name, values)?;
        }
        scene.check_configuration("rest", &self.rest)?;
        if !(self.friction_speed.is_finite() && self.friction_speed >= 0.0) {
            let expected = "a speed, finite; zero for exact Coulomb friction";
            return Err(Error::argument("friction_speed", format!("{}", self.friction_speed), expected));
        }
        Ok(())
    }
}

/// Numbers by degree of freedom: as many as there are, finite, none negative.
fn check_positive(scene: &Scene, name: &str, values: &[f64]) -> Result<(), Error> {
    check_length(name, values.len(), scene.nv())?;
    check_finite(name, values)?;
    let Some(row) = values.iter().position(|&value| value < 0.0) else { return Ok(()) };
    let joint = joint_of_row(scene, row);
    Err(Error::argument(name, format!("{} for joint {joint:?}", values[row]), "numbers that are zero or positive"))
}

/// The name of the joint that a degree of freedom belongs to.
pub(crate) fn joint_of_row(scene: &Scene, row: usize) -> String {
    scene.joints().iter().find(|joint| joint.v.contains(&row)).map(|joint| joint.name.clone()).unwrap_or_default()
}

/// A control law that acts like a spring and a damper: the torque kp (target - q) + kd (target rate - v), the difference on the
/// manifold. Implicit methods take it implicitly, so gains may be as stiff as one likes.
#[derive(Debug, Clone, PartialEq)]
pub struct Gains {
    /// kp, (nv), N m/rad or N/m.
    pub proportional: Vec<f64>,
    /// kd, (nv), N m s/rad or N s/m.
    pub derivative: Vec<f64>,
    /// Target configurations, (nq) for all states, or one for each, one after another.
    pub target: Vec<f64>,
    /// Target rates, (nv) for all states, or one for each.
    pub target_rate: Vec<f64>,
}

impl Gains {
    pub(super) fn check(&self, scene: &Scene, states: usize) -> Result<(), Error> {
        check_positive(scene, "pd.kp", &self.proportional)?;
        check_positive(scene, "pd.kd", &self.derivative)?;
        for (name, values, width) in
            [("pd.target", &self.target, scene.nq()), ("pd.target_rate", &self.target_rate, scene.nv())]
        {
            if values.len() != width {
                check_length(name, values.len(), width * states)?;
            }
            check_finite(name, values)?;
        }
        self.target.chunks_exact(scene.nq().max(1)).try_for_each(|q| scene.check_configuration("pd.target", q))
    }
}

/// Target or target rate of one state.
pub(super) fn of_state(values: &[f64], width: usize, state: usize) -> &[f64] {
    if values.len() == width { values } else { &values[state * width..(state + 1) * width] }
}
