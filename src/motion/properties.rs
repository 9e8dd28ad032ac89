//! Joint properties in simulation: armature, damping, springs, friction, and a control law of proportional-derivative
//! form.

use crate::error::{Error, check_finite, check_length, in_language};
use crate::scene::{JointForces, Scene};
use crate::setters::setters;

/// Default speed of regularized friction, rad/s or m/s; see [`Properties::friction_speed`].
pub const FRICTION_SPEED: f64 = 1e-2;

/// Joint properties in simulation, per degree of freedom; initialized from a scene and freely modifiable.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Properties {
    /// Armature (rotor inertia reflected to the joint), (nv), kg m^2 or kg: part of M.
    pub armature: Vec<f64>,
    /// Viscous damping d, (nv), N m s/rad or N s/m: the torque -d v.
    pub damping: Vec<f64>,
    /// Stiffness k, (nv), N m/rad or N/m: the torque -k s for the displacement s from the rest position.
    pub stiffness: Vec<f64>,
    /// Rest configuration of the springs, (nq).
    pub rest: Vec<f64>,
    /// Coulomb friction f, (nv), N m or N.
    pub friction: Vec<f64>,
    /// Speed v0 of friction, rad/s or m/s. Zero selects exact Coulomb friction, which can hold a joint at rest; in
    /// scenes with connections, and in steps in which contacts act, zero stands for [`FRICTION_SPEED`]. A positive
    /// value selects the regularized torque -f v / sqrt(v^2 + v0^2), which is within 1 % of f above 7 v0 and viscous
    /// below v0, so that joints creep.
    pub friction_speed: f64,
}

setters!(Properties {
    with_armature: armature => Vec<f64>,
    with_damping: damping => Vec<f64>,
    with_stiffness: stiffness => Vec<f64>,
    with_rest: rest => Vec<f64>,
    with_friction: friction => Vec<f64>,
    with_friction_speed: friction_speed: f64,
});

impl Properties {
    /// The properties in the description of the scene.
    #[must_use]
    pub fn of(scene: &Scene) -> Self {
        let JointForces { damping, stiffness, rest, friction } = &*scene.joint_forces();
        Self {
            armature: scene.model().system.noise.clone(),
            damping: damping.clone(),
            stiffness: stiffness.clone(),
            rest: rest.clone(),
            friction: friction.clone(),
            friction_speed: 0.0,
        }
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

/// Checks values per degree of freedom: their number, finite, none negative.
fn check_positive(scene: &Scene, name: &str, values: &[f64]) -> Result<(), Error> {
    check_length(name, values.len(), scene.nv())?;
    check_finite(name, values)?;
    let Some(row) = values.iter().position(|&value| value < 0.0) else { return Ok(()) };
    let joint = joint_of_row(scene, row);
    Err(Error::argument(name, format!("{} for joint {joint:?}", values[row]), "values that are zero or positive"))
}

/// Name of the joint that owns a degree of freedom.
pub(crate) fn joint_of_row(scene: &Scene, row: usize) -> String {
    scene.joints().iter().find(|joint| joint.v.contains(&row)).map(|joint| joint.name.clone()).unwrap_or_default()
}

/// Proportional-derivative control: the torque kp (target - q) + kd (target velocity - v), with the difference on the
/// configuration manifold. Implicit methods treat it implicitly, so that the gains can be arbitrarily stiff.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Gains {
    /// kp, (nv), N m/rad or N/m.
    pub proportional: Vec<f64>,
    /// kd, (nv), N m s/rad or N s/m.
    pub derivative: Vec<f64>,
    /// Target configurations, (nq) for all states, or one per state, one after another.
    pub target: Vec<f64>,
    /// Target joint velocities, (nv) for all states, or one per state.
    pub target_rate: Vec<f64>,
}

impl Gains {
    /// Gains `proportional` and `derivative` (nv each) toward configurations `target`, with target velocities of zero.
    #[must_use]
    pub fn new(
        proportional: impl Into<Vec<f64>>,
        derivative: impl Into<Vec<f64>>,
        target: impl Into<Vec<f64>>,
    ) -> Self {
        let derivative = derivative.into();
        let target_rate = vec![0.0; derivative.len()];
        Self { proportional: proportional.into(), derivative, target: target.into(), target_rate }
    }
}

setters!(Gains {
    with_proportional: proportional => Vec<f64>,
    with_derivative: derivative => Vec<f64>,
    with_target: target => Vec<f64>,
    with_target_rate: target_rate => Vec<f64>,
});

impl Gains {
    /// The names of the gains and targets in messages, in the order of the fields.
    pub(super) fn names() -> [&'static str; 4] {
        in_language(
            ["gains.proportional", "gains.derivative", "gains.target", "gains.target_rate"],
            ["pd.kp", "pd.kd", "pd.target", "pd.target_rate"],
        )
    }

    pub(super) fn check(&self, scene: &Scene, states: usize) -> Result<(), Error> {
        let [proportional, derivative, target, target_rate] = Self::names();
        check_positive(scene, proportional, &self.proportional)?;
        check_positive(scene, derivative, &self.derivative)?;
        for (name, values, width) in [(target, &self.target, scene.nq()), (target_rate, &self.target_rate, scene.nv())]
        {
            if values.len() != width {
                check_length(name, values.len(), width * states)?;
            }
            check_finite(name, values)?;
        }
        self.target.chunks_exact(scene.nq().max(1)).try_for_each(|q| scene.check_configuration(target, q))
    }
}

/// Target configuration or velocity of one state.
pub(super) fn of_state(values: &[f64], width: usize, state: usize) -> &[f64] {
    if values.len() == width { values } else { &values[state * width..(state + 1) * width] }
}
