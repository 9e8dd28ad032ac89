//! Methods of `Scene` that create changed scenes: the builder, joint properties, payloads, inertias.

use super::axis::Axis;
use super::builder::{PySceneBuilder, inertial};
use super::choice::{items, refuse_unknown};
use super::description::body_names;
use super::object::Object;
use super::scene::PyScene;
use super::{errors, input};
use crate::error::Error;
use crate::scene::{Inertial, Joint, Property, Scene};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};

typed_methods! {
    in PyScene;

    /// Create a builder that has the links, joints, gravity, base and simplifications of the scene.
    #[doc = section!(Returns)]
    /// builder : SceneBuilder
    ///     Its build() without arguments creates a scene with bit-identical results; parts can be added before.
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.scenes.chain(3).to_builder().link("tool", mass=0.2)
    /// >>> builder.joint("flange", "fixed", "link2", "tool").build().total_mass
    /// 3.2
    fn to_builder[&self]() -> PySceneBuilder {
        PySceneBuilder { builder: self.scene.source().clone() }
    }

    /// Create a scene with other joint properties; properties that are not given remain.
    #[doc = section!(Parameters)]
    /// armature : dict of str to float, float or array_like, optional
    ///     Armature, kg m^2 or kg: by joint name, one value for all movable joints (including "root_joint"), or an
    ///     array: (nv,), or one value per joint in the order of joint_names. All degrees of freedom of a joint have one
    ///     value.
    /// damping : dict of str to float, float or array_like, optional
    ///     Viscous damping, N m s/rad or N s/m.
    /// friction : dict of str to float, float or array_like, optional
    ///     Coulomb friction, N m or N.
    /// stiffness : dict of str to float, float or array_like, optional
    ///     Stiffness of the springs, N m/rad or N/m.
    /// friction_offset, stribeck, stribeck_speed, load_friction : dict of str to float, float or array_like, optional
    ///     Further terms of friction, as in SceneBuilder.joint.
    #[doc = returns!(scene)]
    #[doc = section!(Raises)]
    /// ShapeError, ArgumentError
    ///     An unknown or fixed joint, or a value that is negative or not finite. The message names the property.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3).with_properties(armature=0.01, damping={"j2": 0.5})
    /// >>> scene.armature, scene.damping
    /// (array([0.01, 0.01, 0.01]), array([0. , 0. , 0.5]))
    fn with_properties[&self, py: Python<'py>](
        ; armature: Option<&Object<'py>> = None, damping: Option<&Object<'py>> = None,
        friction: Option<&Object<'py>> = None, stiffness: Option<&Object<'py>> = None,
        friction_offset: Option<&Object<'py>> = None, stribeck: Option<&Object<'py>> = None,
        stribeck_speed: Option<&Object<'py>> = None, load_friction: Option<&Object<'py>> = None
    ) -> PyResult<Self> {
        let mut changes = Vec::new();
        let all = [armature, damping, friction, stiffness, friction_offset, stribeck, stribeck_speed, load_friction];
        for (property, given) in Property::ALL.iter().copied().zip(all) {
            if let Some(given) = given {
                let each = of_joints(&self.scene, property.name(), given)?;
                changes.extend(each.into_iter().map(|(joint, value)| (joint, property, value)));
            }
        }
        let changes = changes.iter().map(|(joint, property, value)| (joint.as_str(), *property, *value));
        self.changed(py, self.scene.with_properties(changes)?)
    }

    /// Create a scene with a rigid body attached to a link, such as a tool or a gripped object.
    #[doc = section!(Parameters)]
    /// link : str
    ///     Name of the link. On a link of the base, the payload has no effect.
    /// mass : float
    ///     Mass, kg.
    /// com : (3,) array_like, default (0, 0, 0)
    ///     Center of mass of the body in the link frame, m.
    /// inertia : (3, 3) array_like, optional
    ///     Inertia about that center of mass, with axes parallel to the link frame, kg m^2. None: a point mass.
    #[doc = returns!(scene)]
    #[doc = section!(Raises)]
    /// ShapeError, ArgumentError
    ///     An unknown link, a negative mass, or an invalid array.
    #[doc = section!(Warns)]
    /// InertiaWarning
    ///     Link and body together have an inertia that no rigid body can have.
    #[doc = section!(Examples)]
    /// >>> phipsi.scenes.chain(3).with_payload("link2", 0.5, com=(0, 0, 0.3)).total_mass
    /// 3.5
    fn with_payload[&self, py: Python<'py>](
        link: &str, mass: f64, com: Option<&Object<'py>> = None => "(0, 0, 0)", inertia: Option<&Object<'py>> = None,
        **unknown
    ) -> PyResult<Self> {
        refuse_unknown(py, "Scene.with_payload", unknown)?;
        let payload = inertial(&str::to_owned, mass, com, inertia)?;
        self.changed(py, self.scene.with_payload(link, &payload)?)
    }

    /// Create the scene of the part of the robot that a link carries, with this link as its root.
    #[doc = section!(Parameters)]
    /// link : str
    ///     Name of the link.
    /// floating_base : bool, default False
    ///     If true, the base moves freely.
    #[doc = returns!(scene)]
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     An unknown link; a connection or a mimic joint between this part and the rest.
    #[doc = section!(Notes)]
    /// Contacts, colliders, actuators and the start of these links and joints come with it.
    #[doc = section!(Examples)]
    /// >>> phipsi.scenes.chain(5).subtree("link1").joint_names
    /// ('j2', 'j3', 'j4')
    fn subtree[&self, py: Python<'py>](link: &str; floating_base: bool = false) -> PyResult<Self> {
        self.changed(py, self.scene.subtree(link, floating_base)?)
    }

    /// Create the scene of the same robot with another link as its root.
    #[doc = section!(Parameters)]
    /// link : str
    ///     Name of the link.
    /// floating_base : bool, optional
    ///     If true, the base moves freely. None: as in this scene.
    #[doc = returns!(scene)]
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     An unknown link; a planar, universal or spherical joint between the two roots; a free joint with armature,
    ///     losses or a spring; starts with velocities; connections, contacts and colliders of a fixed base.
    #[doc = section!(Notes)]
    /// The joints between the two roots carry the links on their other side, about the opposite axes: joint positions,
    /// velocities and torques, limits and losses are the same, but their order in q is that of the new tree. Each of
    /// these joints carries a massless link, named after the link and the joint. The free joint of a floating base
    /// carries the new root, also in starts and keyframes; without one, the frame of the base is that of the new root.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> scene.rerooted("link2").joint_names
    /// ('j2', 'j1', 'j0')
    fn rerooted[&self, py: Python<'py>](link: &str; floating_base: Option<bool> = None) -> PyResult<Self> {
        let floating = floating_base.unwrap_or(self.scene.source().is_floating());
        self.changed(py, self.scene.rerooted(link, floating)?)
    }
}

#[pymethods]
impl PyScene {
    /// Create a scene with other inertial parameters of all bodies, such as those of one member of a population.
    #[doc = section!(Parameters)]
    /// parameters : (bodies, 10) array_like
    ///     In the order of inertial_parameters. Each link of body_names has the inertia of all links fixed to it, which
    ///     become massless.
    #[doc = returns!(scene)]
    #[doc = section!(Raises)]
    /// ShapeError, NotFiniteError, ArgumentError
    ///     A negative mass or moment of inertia, or an invalid array. The message names the link.
    #[doc = section!(Warns)]
    /// InertiaWarning
    ///     An inertia that no rigid body can have.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> scene.with_inertial_parameters(2.0 * scene.inertial_parameters).total_mass
    /// 6.0
    #[pyo3(signature = (parameters, /))]
    fn with_inertial_parameters(&self, py: Python<'_>, parameters: &Object<'_>) -> PyResult<Self> {
        let given = input::fixed("parameters", parameters, &[body_names(&self.scene).len(), 10])?;
        self.changed(py, self.scene.with_inertial_parameters(&given)?)
    }

    /// Create a scene in which links have other inertias, for instance identified or randomized ones.
    #[doc = section!(Parameters)]
    /// links : dict of str to (mass, com, inertia)
    ///     By link name: mass, kg; center of mass in the link frame, (3,), m; inertia about it with axes parallel to
    ///     the link frame, (3, 3), kg m^2, or None for a point mass. All other links keep theirs.
    #[doc = returns!(scene)]
    #[doc = section!(Raises)]
    /// ShapeError, ArgumentError
    ///     An unknown link, a negative mass, or an invalid array. The message names the link.
    #[doc = section!(Warns)]
    /// InertiaWarning
    ///     An inertia that no rigid body can have.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3).with_inertias({"link2": (2.0, (0, 0, 0.2), 0.01 * np.eye(3))})
    /// >>> scene.link("link2").mass
    /// 2.0
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
    /// Wraps a scene that was created from this one, and issues the warnings that this one does not have.
    fn changed(&self, py: Python<'_>, scene: Scene) -> PyResult<Self> {
        errors::warn_beyond(py, &scene, self.scene.warnings())?;
        Ok(Self::new(scene))
    }
}

/// Reads a joint property: from a dict by joint name, one value for all joints, or an array by joint or degree of
/// freedom.
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

/// The common value of all degrees of freedom of a joint.
fn equal(name: &str, joint: &str, numbers: &[f64]) -> Result<f64, Error> {
    let first = numbers.first().copied().unwrap_or(0.0);
    // Bits are compared, so that a NaN reaches the check that names it.
    if numbers.iter().all(|number| number.to_bits() == first.to_bits()) {
        return Ok(first);
    }
    let expected = "one number for all degrees of freedom of a joint";
    Err(Error::argument(name, format!("{numbers:?} for joint {joint:?}"), expected))
}
