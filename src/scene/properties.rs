//! Modified joint properties: a new scene with other armature, damping, friction or stiffness.

use super::Scene;
use super::description::JointDescription;
use crate::error::Error;
use crate::joints::JointKind;
use std::collections::HashMap;

/// A scalar property of a joint, which applies to each of its degrees of freedom.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Property {
    /// Armature (rotor inertia reflected to the joint), kg m^2 or kg: part of M.
    Armature,
    /// Viscous damping, N m s/rad or N s/m (simulation and linearization only).
    Damping,
    /// Coulomb friction, N m or N (simulation only).
    Friction,
    /// Stiffness of the spring, N m/rad or N/m (simulation and linearization only).
    Stiffness,
    /// [`FrictionCurve::offset`](super::FrictionCurve::offset), of either sign.
    FrictionOffset,
    /// [`FrictionCurve::stribeck`](super::FrictionCurve::stribeck), of either sign.
    Stribeck,
    /// [`FrictionCurve::stribeck_speed`](super::FrictionCurve::stribeck_speed).
    StribeckSpeed,
    /// [`FrictionCurve::load`](super::FrictionCurve::load).
    LoadFriction,
}

impl Property {
    /// All properties.
    pub const ALL: &[Self] = &[
        Self::Armature,
        Self::Damping,
        Self::Friction,
        Self::Stiffness,
        Self::FrictionOffset,
        Self::Stribeck,
        Self::StribeckSpeed,
        Self::LoadFriction,
    ];

    /// The name used in Python and in messages.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Armature => "armature",
            Self::Damping => "damping",
            Self::Friction => "friction",
            Self::Stiffness => "stiffness",
            Self::FrictionOffset => "friction_offset",
            Self::Stribeck => "stribeck",
            Self::StribeckSpeed => "stribeck_speed",
            Self::LoadFriction => "load_friction",
        }
    }

    fn of(self, joint: &mut JointDescription) -> &mut f64 {
        match self {
            Self::Armature => &mut joint.armature,
            Self::Damping => &mut joint.damping,
            Self::Friction => &mut joint.friction,
            Self::Stiffness => &mut joint.spring.stiffness,
            Self::FrictionOffset => &mut joint.friction_curve.offset,
            Self::Stribeck => &mut joint.friction_curve.stribeck,
            Self::StribeckSpeed => &mut joint.friction_curve.stribeck_speed,
            Self::LoadFriction => &mut joint.friction_curve.load,
        }
    }
}

/// Properties of the free joint of a floating base, which has no description, in the order of [`Property::ALL`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Properties(pub [f64; 8]);

impl Default for Properties {
    fn default() -> Self {
        let mut joint = JointDescription::new("", JointKind::Floating, "", "");
        Self(std::array::from_fn(|at| *Property::ALL[at].of(&mut joint)))
    }
}

impl Properties {
    /// Assigns them to a joint.
    pub(super) fn give(&self, joint: &mut JointDescription) {
        for (property, value) in Property::ALL.iter().copied().zip(self.0) {
            *property.of(joint) = value;
        }
    }
}

impl Scene {
    /// The scene with other properties for some joints, given as (joint, property, value); everything else is
    /// unchanged.
    ///
    /// The free joint of a floating base has the name "`root_joint`". For a joint of several degrees of freedom the
    /// value applies to each of them.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`], named after the property, for a joint that is unknown or fixed and for a value that is not
    /// finite, or negative where it must not be.
    pub fn with_properties<'a>(
        &self,
        changes: impl IntoIterator<Item = (&'a str, Property, f64)>,
    ) -> Result<Self, Error> {
        let mut source = self.source().clone();
        let index: HashMap<String, usize> =
            source.joints.iter().enumerate().map(|(at, joint)| (joint.name.clone(), at)).collect();
        for (name, property, value) in changes {
            self.joint(name).map_err(|error| error.of_argument(property.name()))?;
            let is_signed = matches!(property, Property::FrictionOffset | Property::Stribeck);
            if !(value.is_finite() && (is_signed || value >= 0.0)) {
                let found = format!("{value} for joint {name:?}");
                let expected = if is_signed { "finite numbers" } else { "finite numbers, zero or positive" };
                return Err(Error::argument(property.name(), found, expected));
            }
            if let Some(&at) = index.get(name) {
                *property.of(&mut source.joints[at]) = value;
            } else {
                // The free joint of a floating base is the only movable joint without a description.
                source.root.0[property as usize] = value;
            }
        }
        source.build()
    }
}
