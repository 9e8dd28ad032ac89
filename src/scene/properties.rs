//! Modified joint properties: a new scene with other armature, damping, friction or stiffness.

use super::Scene;
use super::description::JointDescription;
use crate::error::Error;
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
}

impl Property {
    /// All properties.
    pub const ALL: [Self; 4] = [Self::Armature, Self::Damping, Self::Friction, Self::Stiffness];

    /// The name used in Python and in messages.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Armature => "armature",
            Self::Damping => "damping",
            Self::Friction => "friction",
            Self::Stiffness => "stiffness",
        }
    }

    fn of(self, joint: &mut JointDescription) -> &mut f64 {
        match self {
            Self::Armature => &mut joint.armature,
            Self::Damping => &mut joint.damping,
            Self::Friction => &mut joint.friction,
            Self::Stiffness => &mut joint.spring.stiffness,
        }
    }
}

/// Properties of the free joint of a floating base, which has no description, in the order of [`Property::ALL`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Properties(pub [f64; 4]);

impl Properties {
    /// Assigns them to a joint.
    pub(super) fn give(&self, joint: &mut JointDescription) {
        for (property, value) in Property::ALL.into_iter().zip(self.0) {
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
    /// [`Error::Argument`], named after the property, for a joint that is unknown or fixed and for a value that is
    /// negative or not finite.
    pub fn with_properties<'a>(
        &self,
        changes: impl IntoIterator<Item = (&'a str, Property, f64)>,
    ) -> Result<Self, Error> {
        let mut source = self.source().clone();
        let index: HashMap<String, usize> =
            source.joints.iter().enumerate().map(|(at, joint)| (joint.name.clone(), at)).collect();
        for (name, property, value) in changes {
            self.joint(name).map_err(|error| error.of_argument(property.name()))?;
            if !(value.is_finite() && value >= 0.0) {
                let found = format!("{value} for joint {name:?}");
                return Err(Error::argument(property.name(), found, "finite numbers, zero or positive"));
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
