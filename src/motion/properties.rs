//! Joint properties in simulation: armature, damping, springs, friction, and a control law of proportional-derivative
//! form.

use crate::error::{Error, check_finite, check_length, in_language};
use crate::scene::{FrictionCurve, JointForces, Scene};
use crate::setters::setters;

/// Default speed of regularized friction, rad/s or m/s; see [`Properties::friction_speed`].
pub const FRICTION_SPEED: f64 = 1e-2;

/// Joint properties in simulation, per degree of freedom; initialized from a scene and freely modifiable.
///
/// Armature, damping, stiffness and friction are those of all states, (nv), or one set per state, one after another.
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
    /// Further terms of dry friction, (nv); empty if no joint has any.
    pub curves: Vec<FrictionCurve>,
    /// Speed v0 of friction, rad/s or m/s. Zero selects exact Coulomb friction, which can hold a joint at rest; in
    /// scenes with connections, and in steps in which contacts act, zero stands for [`FRICTION_SPEED`]. A positive
    /// value selects the regularized torque -f v / sqrt(v^2 + v0^2), which is within 1 % of f above 7 v0 and viscous
    /// below v0, so that joints creep.
    pub friction_speed: f64,
    /// Inertial parameters of each state, (states, joints, 10), as those of
    /// [`Scene::inertial_parameters`](crate::Scene::inertial_parameters); empty for the inertias of the scene.
    pub inertias: Vec<f64>,
    /// Coefficients of friction of the contacts and then the colliders of each state, (states, contacts + colliders);
    /// empty for those of the scene.
    pub contact_friction: Vec<f64>,
    /// Their coefficients of restitution, likewise.
    pub contact_restitution: Vec<f64>,
}

setters!(Properties {
    with_inertias: inertias => Vec<f64>,
    with_contact_friction: contact_friction => Vec<f64>,
    with_contact_restitution: contact_restitution => Vec<f64>,
    with_armature: armature => Vec<f64>,
    with_damping: damping => Vec<f64>,
    with_stiffness: stiffness => Vec<f64>,
    with_rest: rest => Vec<f64>,
    with_friction: friction => Vec<f64>,
    with_curves: curves => Vec<FrictionCurve>,
    with_friction_speed: friction_speed: f64,
});

impl Properties {
    /// The properties in the description of the scene.
    #[must_use]
    pub fn of(scene: &Scene) -> Self {
        let JointForces { damping, stiffness, rest, friction, curves } = &*scene.joint_forces();
        Self {
            armature: scene.model().system.noise.clone(),
            damping: damping.clone(),
            stiffness: stiffness.clone(),
            rest: rest.clone(),
            friction: friction.clone(),
            curves: curves.clone(),
            friction_speed: 0.0,
            inertias: Vec::new(),
            contact_friction: Vec::new(),
            contact_restitution: Vec::new(),
        }
    }

    /// True if all states have the same properties.
    pub(super) fn are_of_all(&self, nv: usize) -> bool {
        let of_bodies = [&self.inertias, &self.contact_friction, &self.contact_restitution];
        of_bodies.iter().all(|values| values.is_empty()) && self.of_rows().iter().all(|values| values.len() == nv)
    }

    /// The properties that each state can have for itself, in the order of their names in `check`.
    fn of_rows(&self) -> [&Vec<f64>; 4] {
        [&self.armature, &self.damping, &self.stiffness, &self.friction]
    }

    /// The properties of one state.
    pub(super) fn of_state(&self, (nv, states): (usize, usize), state: usize) -> Self {
        let own = |values: &[f64], width: usize| values[state * width..][..width].to_vec();
        let row = |values: &[f64]| if values.len() == nv { values.to_vec() } else { own(values, nv) };
        let body = |values: &[f64]| own(values, values.len() / states.max(1));
        Self {
            armature: row(&self.armature),
            damping: row(&self.damping),
            stiffness: row(&self.stiffness),
            rest: self.rest.clone(),
            friction: row(&self.friction),
            curves: self.curves.clone(),
            friction_speed: self.friction_speed,
            inertias: body(&self.inertias),
            contact_friction: body(&self.contact_friction),
            contact_restitution: body(&self.contact_restitution),
        }
    }

    /// The largest properties of all states.
    pub(super) fn largest(&self, nv: usize) -> Self {
        let of = |values: &[f64]| {
            let mut most = vec![0.0; nv];
            for (at, &value) in values.iter().enumerate() {
                most[at % nv] = value.max(most[at % nv]);
            }
            most
        };
        let [armature, damping, stiffness, friction] = self.of_rows().map(|values| of(values));
        let mut all = self.of_state((nv, 1), 0);
        (all.inertias, all.contact_friction, all.contact_restitution) = (Vec::new(), Vec::new(), Vec::new());
        Self { armature, damping, stiffness, friction, ..all }
    }

    /// True if friction acts and is regularized.
    pub(super) fn is_regularized(&self) -> bool {
        self.friction_speed > 0.0 && (!self.curves.is_empty() || self.friction.iter().any(|&f| f != 0.0))
    }

    pub(super) fn check(&self, scene: &Scene, states: usize) -> Result<(), Error> {
        for (name, values) in [
            ("armature", &self.armature),
            ("damping", &self.damping),
            ("stiffness", &self.stiffness),
            ("friction", &self.friction),
        ] {
            check_positive(scene, name, values, states)?;
        }
        if !self.inertias.is_empty() {
            check_length("inertias", self.inertias.len(), states * 10 * scene.joints().len())?;
            check_finite("inertias", &self.inertias)?;
        }
        for (name, values) in
            [("contact_friction", &self.contact_friction), ("contact_restitution", &self.contact_restitution)]
        {
            if !values.is_empty() {
                check_length(name, values.len(), states * scene.contact_coefficients())?;
                check_finite(name, values)?;
            }
        }
        scene.check_configuration("rest", &self.rest)?;
        if !(self.friction_speed.is_finite() && self.friction_speed >= 0.0) {
            let expected = "a speed, finite; zero for exact Coulomb friction";
            return Err(Error::argument("friction_speed", format!("{}", self.friction_speed), expected));
        }
        Ok(())
    }
}

/// Checks values per degree of freedom, for all states or for each: their number, finite, none negative.
fn check_positive(scene: &Scene, name: &str, values: &[f64], states: usize) -> Result<(), Error> {
    check_width(name, values, (scene.nv(), states))?;
    check_finite(name, values)?;
    let Some(at) = values.iter().position(|&value| value < 0.0) else { return Ok(()) };
    let joint = joint_of_row(scene, at % scene.nv());
    Err(Error::argument(name, format!("{} for joint {joint:?}", values[at]), "values that are zero or positive"))
}

/// Checks the number of values, `width` for all states or for each.
fn check_width(name: &str, values: &[f64], (width, states): (usize, usize)) -> Result<(), Error> {
    if values.len() == width { Ok(()) } else { check_length(name, values.len(), width * states) }
}

/// Checks that friction is that of Coulomb alone, for `what` (such as "gradients with ").
pub(crate) fn check_coulomb(scene: &Scene, curves: &[FrictionCurve], what: &str) -> Result<(), Error> {
    let Some(row) = curves.iter().position(|curve| !curve.is_flat()) else { return Ok(()) };
    let joint = joint_of_row(scene, row);
    let found = format!("{what}friction_offset, stribeck or load_friction of joint {joint:?}");
    Err(Error::argument("scene", found, "a scene with these properties set to zero"))
}

/// Name of the joint that owns a degree of freedom.
pub(crate) fn joint_of_row(scene: &Scene, row: usize) -> String {
    scene.joints().iter().find(|joint| joint.v.contains(&row)).map(|joint| joint.name.clone()).unwrap_or_default()
}

/// Proportional-derivative control: the torque kp (target - q) + kd (target velocity - v), with the difference on the
/// configuration manifold, up to the limits of effort. Implicit methods treat it implicitly, so that the gains can be
/// arbitrarily stiff; the limits apply to the torque at the end of the step.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Gains {
    /// kp, (nv) for all states, or one per state, N m/rad or N/m.
    pub proportional: Vec<f64>,
    /// kd, (nv) for all states, or one per state, N m s/rad or N s/m.
    pub derivative: Vec<f64>,
    /// Target configurations, (nq) for all states, or one per state, one after another.
    pub target: Vec<f64>,
    /// Target joint velocities, (nv) for all states, or one per state.
    pub target_rate: Vec<f64>,
    /// Targets of each step of the run instead of `target`, (steps, nq) for all states, or one after another for each;
    /// empty if they do not change.
    pub targets: Vec<f64>,
    /// Target velocities of each step instead of `target_rate`, (steps, nv), likewise.
    pub target_rates: Vec<f64>,
    /// Number of steps in `targets` and `target_rates`.
    pub steps: usize,
    /// Least torque, (nv) for all states, or one per state, zero or negative; empty if no torque is limited.
    pub effort_lower: Vec<f64>,
    /// Largest torque, likewise, zero or positive.
    pub effort_upper: Vec<f64>,
    /// Torque at rest of motors whose torque decreases with their speed, as `effort_upper`; empty if there are none.
    pub stall: Vec<f64>,
    /// The decrease of the torque of these motors per speed in its direction, N m s/rad or N s/m: the torque is at most
    /// stall - decline v, and at least -stall - decline v. As long as `stall`.
    pub decline: Vec<f64>,
    /// True if the limits are those of the sum of this torque and the applied one, also of rows without gains.
    pub limits_sum: bool,
}

impl Gains {
    /// Gains `proportional` and `derivative` (nv each) toward configurations `target`, with target velocities of zero
    /// and without limits of effort.
    #[must_use]
    pub fn new(
        proportional: impl Into<Vec<f64>>,
        derivative: impl Into<Vec<f64>>,
        target: impl Into<Vec<f64>>,
    ) -> Self {
        let derivative = derivative.into();
        let target_rate = vec![0.0; derivative.len()];
        Self {
            proportional: proportional.into(),
            derivative,
            target: target.into(),
            target_rate,
            targets: Vec::new(),
            target_rates: Vec::new(),
            steps: 0,
            effort_lower: Vec::new(),
            effort_upper: Vec::new(),
            stall: Vec::new(),
            decline: Vec::new(),
            limits_sum: false,
        }
    }
}

setters!(Gains {
    with_proportional: proportional => Vec<f64>,
    with_derivative: derivative => Vec<f64>,
    with_target: target => Vec<f64>,
    with_target_rate: target_rate => Vec<f64>,
    with_targets: targets => Vec<f64>,
    with_target_rates: target_rates => Vec<f64>,
    with_steps: steps: usize,
    with_effort_lower: effort_lower => Vec<f64>,
    with_effort_upper: effort_upper => Vec<f64>,
    with_stall: stall => Vec<f64>,
    with_decline: decline => Vec<f64>,
    with_limits_sum: limits_sum: bool,
});

impl Gains {
    /// The names of gains, targets and limits in messages, in the order of the fields.
    pub(super) fn names() -> [&'static str; 10] {
        in_language(
            [
                "gains.proportional",
                "gains.derivative",
                "gains.target",
                "gains.target_rate",
                "gains.targets",
                "gains.target_rates",
                "gains.stall",
                "gains.decline",
                "gains.effort_lower",
                "gains.effort_upper",
            ],
            [
                "pd.kp",
                "pd.kd",
                "pd.target",
                "pd.target_rate",
                "targets",
                "target_rates",
                "pd.stall",
                "pd.no_load_speed",
                "pd.effort",
                "pd.effort",
            ],
        )
    }

    pub(super) fn check(&self, scene: &Scene, states: usize) -> Result<(), Error> {
        let [proportional, derivative, target, target_rate, targets, target_rates, stall, decline, lower, upper] =
            Self::names();
        let (nq, nv) = (scene.nq(), scene.nv());
        check_positive(scene, proportional, &self.proportional, states)?;
        check_positive(scene, derivative, &self.derivative, states)?;
        for (name, values, width, is_optional) in [
            (target, &self.target, nq, false),
            (target_rate, &self.target_rate, nv, false),
            (targets, &self.targets, nq * self.steps, true),
            (target_rates, &self.target_rates, nv * self.steps, true),
        ] {
            if !(is_optional && values.is_empty()) {
                check_width(name, values, (width, states))?;
                check_finite(name, values)?;
            }
        }
        if !(self.stall.is_empty() && self.decline.is_empty()) {
            check_width(stall, &self.stall, (nv, states))?;
            check_length(decline, self.decline.len(), self.stall.len())?;
            check_positive(scene, decline, &self.decline, states)?;
            if let Some(at) = self.stall.iter().position(|torque| !(*torque >= 0.0)) {
                let found = format!("{} for joint {:?}", self.stall[at], joint_of_row(scene, at % nv));
                return Err(Error::argument(stall, found, "torques that are zero or positive, infinite for no limit"));
            }
        }
        for (name, limits, sign) in [(lower, &self.effort_lower, -1.0), (upper, &self.effort_upper, 1.0)] {
            if limits.is_empty() && self.effort_lower.len() == self.effort_upper.len() {
                continue;
            }
            check_width(name, limits, (nv, states))?;
            // NaN is refused too.
            if let Some(at) = limits.iter().position(|limit| !(sign * limit >= 0.0)) {
                let found = format!("{} for joint {:?}", limits[at], joint_of_row(scene, at % nv));
                let expected = "limits of the torque that include zero, infinite for none";
                return Err(Error::argument(name, found, expected));
            }
        }
        let each =
            |name, values: &[f64]| values.chunks_exact(nq.max(1)).try_for_each(|q| scene.check_configuration(name, q));
        each(target, &self.target).and_then(|()| each(targets, &self.targets))
    }

    /// True if the targets change from step to step.
    pub(super) fn changes(&self) -> bool {
        !(self.targets.is_empty() && self.target_rates.is_empty())
    }

    /// Target and target velocity of one state in step `n` of the run.
    pub(super) fn targets_of(&self, (nq, nv): (usize, usize), state: usize, n: usize) -> [&[f64]; 2] {
        [(&self.target, &self.targets, nq), (&self.target_rate, &self.target_rates, nv)].map(|(one, each, width)| {
            if each.is_empty() {
                of_state(one, width, state)
            } else {
                &of_state(each, width * self.steps, state)[n * width..(n + 1) * width]
            }
        })
    }

    /// Gains and limits of effort of one state: kp, kd, the least and the largest torque, and stall torque and decline,
    /// (nv) each; empty without limits.
    pub(super) fn of_state(&self, nv: usize, state: usize) -> [&[f64]; 6] {
        let Self { proportional, derivative, effort_lower, effort_upper, stall, decline, .. } = self;
        [proportional, derivative, effort_lower, effort_upper, stall, decline]
            .map(|values| if values.is_empty() { &values[..] } else { of_state(values, nv, state) })
    }

    /// The largest gains of a row in any state, also of its limits of effort.
    pub(super) fn largest(&self, nv: usize, row: usize) -> [f64; 2] {
        let [kp, kd, decline] = [&self.proportional, &self.derivative, &self.decline]
            .map(|gains| gains.iter().skip(row).step_by(nv).fold(0.0_f64, |most, &gain| most.max(gain)));
        [kp, kd.max(decline)]
    }

    /// True if the law acts on a row, with a limit of effort in some state.
    pub(super) fn is_limited(&self, nv: usize, row: usize) -> bool {
        let mut limits = [&self.effort_lower, &self.effort_upper, &self.stall].into_iter();
        (self.limits_sum || self.largest(nv, row).iter().any(|&gain| gain > 0.0))
            && limits.any(|limits| limits.iter().skip(row).step_by(nv).any(|limit| limit.is_finite()))
    }
}

/// Target configuration or velocity of one state.
pub(super) fn of_state(values: &[f64], width: usize, state: usize) -> &[f64] {
    if values.len() == width { values } else { &values[state * width..(state + 1) * width] }
}
