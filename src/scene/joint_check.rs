//! Checks the values of a joint.

use super::description::{FrictionCurve, JointDescription};
use super::spring::check_spring;
use crate::error::{Error, number};
use crate::joints::JointKind;
use nalgebra::Matrix3;

/// Checks that the values of a joint are finite and of the right sign, and that its axis is not zero.
pub(super) fn check_joint(joint: &JointDescription) -> Result<(), Error> {
    let refuse = |found: String, expected: &str| Err(Error::scene(format!("joint {:?}", joint.name), found, expected));
    let origin = joint.origin.rotation.iter().chain(joint.origin.lever.iter());
    if let Some(value) = origin.into_iter().find(|x| !x.is_finite()) {
        return refuse(format!("{value} in its origin"), "finite numbers");
    }
    let r = &joint.origin.rotation;
    let defect = (r.transpose() * r - Matrix3::identity()).amax();
    if !(defect <= 1e-9 && r.determinant() > 0.0) {
        return refuse(format!("an origin whose rotation is off by {defect:.1e}"), "a rotation matrix");
    }
    let usable = joint.axis.iter().all(|x| x.is_finite()) && joint.axis.amax() > 0.0;
    if joint.kind.has_axis() && !usable {
        let [x, y, z] = <[f64; 3]>::from(joint.axis).map(number);
        return refuse(format!("axis ({x}, {y}, {z})"), "an axis that is not zero");
    }
    if let JointKind::Screw { pitch } = joint.kind
        && !pitch.is_finite()
    {
        return refuse(format!("pitch {}", number(pitch)), "a finite pitch in m/rad");
    }
    for (name, value) in [("armature", joint.armature), ("damping", joint.damping), ("friction", joint.friction)] {
        if !(value.is_finite() && value >= 0.0) {
            return refuse(format!("{name} {}", number(value)), "a finite number, zero or positive");
        }
    }
    check_friction_curve(joint, refuse)?;
    check_spring(&joint.name, joint.kind, &joint.spring)?;
    if let Some(mimic) = &joint.mimic
        && !(mimic.multiplier.is_finite() && mimic.offset.is_finite())
    {
        let found = format!("a mimic with multiplier {} and offset {}", mimic.multiplier, mimic.offset);
        return refuse(found, "finite numbers");
    }
    let mut limits = joint.limits;
    if !(limits.lower <= limits.upper) {
        return refuse(
            format!("limits from {} to {}", number(limits.lower), number(limits.upper)),
            "a lower limit that is not above the upper one",
        );
    }
    for (name, value) in limits.of_one_sign() {
        if !(*value >= 0.0) {
            return refuse(format!("{name} limit {}", number(*value)), "a limit that is zero or positive");
        }
    }
    Ok(())
}

/// Checks that friction is never negative at rest and decreases with the load.
fn check_friction_curve(
    joint: &JointDescription,
    refuse: impl Fn(String, &str) -> Result<(), Error>,
) -> Result<(), Error> {
    let FrictionCurve { offset, stribeck, stribeck_speed, load } = joint.friction_curve;
    if !offset.is_finite() {
        return refuse(format!("friction_offset {}", number(offset)), "a finite number");
    }
    if !(stribeck.is_finite() && stribeck + joint.friction >= 0.0) {
        let found = format!("stribeck {} with friction {}", number(stribeck), number(joint.friction));
        return refuse(found, "a finite number, so that their sum is zero or positive");
    }
    if !(stribeck_speed.is_finite() && stribeck_speed * stribeck_speed > 0.0) {
        return refuse(format!("stribeck_speed {}", number(stribeck_speed)), "a finite speed above zero");
    }
    if !(0.0..1.0).contains(&load) {
        return refuse(format!("load_friction {}", number(load)), "a number from 0 to below 1");
    }
    Ok(())
}
