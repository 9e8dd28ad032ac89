//! Methods of `Scene` that give a changed one: the way back to the builder, properties of joints, loads on links.

use super::axis::Axis;
use super::builder::{PySceneBuilder, inertial};
use super::choice::items;
use super::object::Object;
use super::scene::PyScene;
use super::{errors, input};
use crate::error::Error;
use crate::scene::{Inertial, Joint, Property, Scene};
use pyo3::prelude::*;
use pyo3::types::PyMapping;

#[pymethods]
impl PyScene {
    /// A builder that holds what the scene was made of: links, joints, gravity, base, and what is left out.
    ///
    /// build() without arguments gives a scene with the same results, bit for bit; links and joints can be added before.
    #[pyo3(signature = ())]
    fn to_builder(&self) -> PySceneBuilder {
        PySceneBuilder { builder: self.scene.source().clone() }
    }

    /// A new scene with other properties of joints; what is not given stays.
    ///
    /// armature: kg m^2 or kg; damping: N m s/rad or N s/m; friction: N m or N; stiffness: N m/rad or N/m. Each is a dict from joint
    /// names to numbers, one number for all movable joints (a floating base's "root_joint" among them: name joints to leave it out),
    /// or an array: (nv,), or a number a joint in the order of joint_names. A joint has one number for all its degrees of freedom.
    ///
    /// Raises ArgumentError, named after the property, for a joint that is unknown or fixed and for a value that is negative or
    /// not finite; ShapeError.
    #[pyo3(signature = (*, armature=None, damping=None, friction=None, stiffness=None))]
    fn with_properties(
        &self,
        py: Python<'_>,
        armature: Option<&Object<'_>>,
        damping: Option<&Object<'_>>,
        friction: Option<&Object<'_>>,
        stiffness: Option<&Object<'_>>,
    ) -> PyResult<Self> {
        let mut changes = Vec::new();
        for (property, given) in Property::ALL.into_iter().zip([armature, damping, friction, stiffness]) {
            if let Some(given) = given {
                let each = of_joints(&self.scene, property.name(), given)?;
                changes.extend(each.into_iter().map(|(joint, value)| (joint, property, value)));
            }
        }
        let changes = changes.iter().map(|(joint, property, value)| (joint.as_str(), *property, *value));
        self.changed(py, self.scene.with_properties(changes)?)
    }

    /// A new scene with a rigid body added to a link: what a gripper holds, a tool, a battery.
    ///
    /// link: its name. mass: kg. com: (3,), the body's mass centre in the link's frame, m. inertia: (3, 3), about that mass centre,
    /// axes parallel to the link's frame, kg m^2; None for a point mass. On a link of the base it changes nothing.
    ///
    /// Raises ArgumentError for an unknown link and for a mass that is negative; ShapeError, ArgumentError for arrays. Warns
    /// InertiaWarning where link and body together have an inertia that no body can have.
    #[pyo3(signature = (link, mass, com=None, inertia=None),
           text_signature = "($self, link, mass, com=(0, 0, 0), inertia=None)")]
    fn with_payload(
        &self,
        py: Python<'_>,
        link: &str,
        mass: f64,
        com: Option<&Object<'_>>,
        inertia: Option<&Object<'_>>,
    ) -> PyResult<Self> {
        let payload = inertial(&str::to_owned, mass, com, inertia)?;
        self.changed(py, self.scene.with_payload(link, &payload)?)
    }

    /// A new scene whose named links have other inertias: of a better model, of an identification, of a random robot for learning.
    ///
    /// links: from names to (mass, com, inertia): kg; (3,), the mass centre in the link's frame, m; (3, 3), about the mass centre, axes parallel to the link's
    /// frame, kg m^2, or None for a point mass. Other links keep theirs, those that are fixed onto a named one too.
    ///
    /// Raises ArgumentError for an unknown link and for a mass that is negative; ShapeError, ArgumentError for arrays, by the link's name. Warns
    /// InertiaWarning for inertias that no body can have.
    fn with_inertias(&self, py: Python<'_>, links: &Object<'_>) -> PyResult<Self> {
        let expected = "a dict from names of links to (mass, com, inertia)";
        let refused = |found: String| Error::argument("links", found, expected);
        let Ok(mapping) = links.cast::<PyMapping>() else {
            return Err(refused(links.repr()?.to_string()).into());
        };
        let each = items("links", mapping, "names of links")?.into_iter().map(|(link, given)| {
            let Ok((mass, com, inertia)) = given.extract::<(f64, Object<'_>, Object<'_>)>() else {
                return Err(refused(format!("{} for link {link:?}", given.repr()?)).into());
            };
            let inertia = (!inertia.is_none()).then_some(&inertia);
            let inertial = inertial(&|argument| format!("{argument} of link {link:?}"), mass, Some(&com), inertia)?;
            Ok((link, inertial))
        });
        let given = each.collect::<PyResult<Vec<(String, Inertial)>>>()?;
        let given: Vec<(&str, Inertial)> = given.iter().map(|(link, inertial)| (&**link, *inertial)).collect();
        self.changed(py, self.scene.with_inertias(&given)?)
    }
}

impl PyScene {
    /// A scene made from this one, with the warnings that this one does not have.
    fn changed(&self, py: Python<'_>, scene: Scene) -> PyResult<Self> {
        errors::warn_beyond(py, &scene, self.scene.warnings())?;
        Ok(Self::new(scene))
    }
}

/// A property of joints by name: from a dict of some, one number for all, or an array by joint or by degree of freedom.
fn of_joints(scene: &Scene, name: &str, given: &Object<'_>) -> PyResult<Vec<(String, f64)>> {
    if let Ok(mapping) = given.cast::<PyMapping>() {
        let each = items(name, mapping, "names of joints")?.into_iter().map(|(joint, value)| {
            let count = scene.joint(&joint).map_err(|error| error.of_argument(name))?.v.len();
            let numbers = input::spread(&format!("{name}[{joint:?}]"), &value, count.into())?;
            Ok((equal(name, &joint, &numbers)?, joint))
        });
        return each.map(|entry| entry.map(|(value, joint)| (joint, value))).collect();
    }
    let (shape, numbers) = input::shaped(name, given, Axis::Joints(scene))?;
    let joints = scene.joints();
    let of_joint = |(at, joint): (usize, &Joint)| {
        let value = match shape[..] {
            [] => numbers[0],
            [count] if count == joints.len() => numbers[at],
            [count] if count == scene.nv() => equal(name, &joint.name, &numbers[joint.v.clone()])?,
            _ => {
                let expected = format!("(), ({},) or ({},)", scene.nv(), joints.len());
                return Err(input::wrong_shape(name, &shape, expected));
            }
        };
        Ok((joint.name.clone(), value))
    };
    joints.iter().enumerate().map(of_joint).collect()
}

/// The one number of a joint's degrees of freedom.
fn equal(name: &str, joint: &str, numbers: &[f64]) -> Result<f64, Error> {
    let first = numbers.first().copied().unwrap_or(0.0);
    // Bits, so that a NaN comes through to the check that names it.
    if numbers.iter().all(|number| number.to_bits() == first.to_bits()) {
        return Ok(first);
    }
    let expected = "one number for all degrees of freedom of a joint";
    Err(Error::argument(name, format!("{numbers:?} for joint {joint:?}"), expected))
}
