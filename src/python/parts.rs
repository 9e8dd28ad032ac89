//! Methods of `Scene`: links and joints by name, as they were given.

use super::connection_tuple::{ConnectionTuple, connection_tuple};
use super::contact_tuple::{ContactTuple, contact_tuple};
use super::description::joint_tuple;
use super::object::{Object, imported};
use super::output::property;
use super::scene::{PyScene, slice};
use crate::error::Error;
use crate::scene::{Inertial, JointDescription, LinkDescription, Scene};
use crate::spatial::Symmetric3;
use nalgebra::Vector3;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PySlice};
use std::borrow::Cow;
use std::collections::HashMap;

#[pymethods]
impl PyScene {
    /// Properties of a link as it was given, including links on fixed joints.
    #[doc = section!(Parameters)]
    /// name : str
    ///     Name of the link.
    #[doc = section!(Returns)]
    /// link : Link
    ///     Named tuple (name, mass, com, inertia, parent, joint).
    #[doc = raises!(unknown)]
    #[doc = section!(Examples)]
    /// >>> phipsi.scenes.chain(3).link("link1").parent
    /// 'link0'
    #[pyo3(signature = (name, /))]
    fn link<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Object<'py>> {
        self.scene.link(name)?;
        let carrier = joints(&self.scene).find(|joint| joint.child == name);
        let mut links = self.scene.source().links().iter();
        let link = links.find(|link| link.name == name).ok_or_else(|| missing("link", name))?;
        link_parts(py, link, carrier.as_deref())
    }

    /// Properties of a joint as it was given, including fixed joints.
    #[doc = section!(Parameters)]
    /// name : str
    ///     Name of the joint.
    #[doc = section!(Returns)]
    /// joint : Joint
    ///     Named tuple (name, type, parent, child, xyz, ...).
    #[doc = raises!(unknown)]
    #[doc = section!(Examples)]
    /// >>> phipsi.scenes.chain(3).joint("j1").type
    /// 'revolute'
    #[pyo3(signature = (name, /))]
    fn joint<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Object<'py>> {
        match joints(&self.scene).find(|joint| joint.name == name) {
            Some(joint) => joint_parts(py, &joint),
            // The error lists the movable joints, because one of them is usually meant.
            None => Err(self.scene.joint(name).err().unwrap_or_else(|| missing("joint", name)).into()),
        }
    }

    /// Slice of the coordinates of a joint in q.
    #[doc = section!(Parameters)]
    /// joint : str
    ///     Name of a movable joint.
    /// part : {"position", "quaternion"}, optional
    ///     Part of a free joint, or "quaternion" of a spherical joint. None: all coordinates.
    #[doc = section!(Returns)]
    /// slice
    ///     Position in q.
    #[doc = raises!(unknown)]
    #[doc = section!(Examples)]
    /// >>> phipsi.scenes.chain(3).q_index("j1")
    /// slice(1, 2, 1)
    /// >>> phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM, floating_base=True).q_index("root_joint", "quaternion")
    /// slice(3, 7, 1)
    #[pyo3(signature = (joint, /, part=None))]
    fn q_index<'py>(&self, py: Python<'py>, joint: &str, part: Option<&str>) -> PyResult<Bound<'py, PySlice>> {
        let joint = self.scene.joint(joint)?;
        slice(py, &part.map_or_else(|| Ok(joint.q.clone()), |part| joint.q_part(part))?)
    }

    /// Slice of the degrees of freedom of a joint in qd, qdd and tau.
    #[doc = section!(Parameters)]
    /// joint : str
    ///     Name of a movable joint.
    /// part : {"linear", "angular"}, optional
    ///     Part of a free joint (in tau force and moment), or "angular" of a spherical joint. None: all degrees of freedom.
    #[doc = section!(Returns)]
    /// slice
    ///     Position in qd, qdd and tau.
    #[doc = raises!(unknown)]
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM, floating_base=True)
    /// >>> scene.q_index("joint1"), scene.v_index("joint1")
    /// (slice(7, 8, 1), slice(6, 7, 1))
    /// >>> scene.v_index("root_joint", "angular")
    /// slice(3, 6, 1)
    #[pyo3(signature = (joint, /, part=None))]
    fn v_index<'py>(&self, py: Python<'py>, joint: &str, part: Option<&str>) -> PyResult<Bound<'py, PySlice>> {
        let joint = self.scene.joint(joint)?;
        slice(py, &part.map_or_else(|| Ok(joint.v.clone()), |part| joint.v_part(part))?)
    }

    /// All links by name, in the order of link_names: a new dict of Link.
    #[getter]
    fn links<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let described: HashMap<&str, &LinkDescription> =
            self.scene.source().links().iter().map(|link| (link.name.as_str(), link)).collect();
        let carriers: HashMap<String, Cow<'_, JointDescription>> =
            joints(&self.scene).map(|joint| (joint.child.clone(), joint)).collect();
        let all = PyDict::new(py);
        for link in self.scene.links() {
            let link = described.get(link.name.as_str()).ok_or_else(|| missing("link", &link.name))?;
            all.set_item(&link.name, link_parts(py, link, carriers.get(&link.name).map(|joint| &**joint))?)?;
        }
        Ok(all)
    }

    /// All joints by name, including fixed ones, in the order they were given: a new dict of Joint.
    #[getter]
    fn joints<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let all = PyDict::new(py);
        for joint in joints(&self.scene) {
            all.set_item(&joint.name, joint_parts(py, &joint)?)?;
        }
        Ok(all)
    }

    /// Connections as they were given, for the visualization of their forces.
    #[pyo3(name = "_connections")]
    fn connections_as_given(&self) -> Vec<ConnectionTuple> {
        self.scene.source().connections().iter().map(connection_tuple).collect()
    }

    /// Contacts as they were given.
    #[pyo3(name = "_contacts")]
    fn contacts_as_given(&self) -> Vec<ContactTuple> {
        self.scene.source().contacts().iter().map(contact_tuple).collect()
    }
}

/// Joint descriptions, that of the free joint of a floating base first.
fn joints(scene: &Scene) -> impl Iterator<Item = Cow<'_, JointDescription>> {
    let source = scene.source();
    // The free joint of a floating base is the first joint.
    let root = scene.joints().first().filter(|_| source.is_floating());
    let root = root.map(|root| Cow::Owned(source.root_joint(root.child.clone())));
    root.into_iter().chain(source.joints().iter().map(Cow::Borrowed))
}

fn missing(what: &str, name: &str) -> Error {
    Error::argument(what, format!("{name:?}"), "a name of the scene")
}

fn vector<'py>(py: Python<'py>, v: &Vector3<f64>) -> PyResult<Object<'py>> {
    property(py, v.as_slice(), &[3])
}

/// Named tuple of a link that is carried by the joint `carrier`.
fn link_parts<'py>(
    py: Python<'py>,
    link: &LinkDescription,
    carrier: Option<&JointDescription>,
) -> PyResult<Object<'py>> {
    let massless = Inertial { mass: 0.0, center: Vector3::zeros(), central: Symmetric3::zero() };
    let Inertial { mass, center, central } = link.inertial.unwrap_or(massless);
    let inertia = property(py, central.to_matrix().as_slice(), &[3, 3])?;
    let (parent, joint) = (carrier.and_then(parent_of), carrier.map(|joint| joint.name.as_str()));
    let parts = (&link.name, mass, vector(py, &center)?, inertia, parent, joint);
    imported!(py, "phipsi._results", "Link")?.call1(parts)
}

/// Name of the parent link; None for the free joint of a floating base.
fn parent_of(joint: &JointDescription) -> Option<&str> {
    Some(joint.parent.as_str()).filter(|parent| !parent.is_empty())
}

/// Named tuple of a joint, with its axis as a unit vector and the rest coordinates of its spring.
fn joint_parts<'py>(py: Python<'py>, joint: &JointDescription) -> PyResult<Object<'py>> {
    let mut told = joint.clone();
    told.axis = (joint.axis / joint.axis.amax()).normalize();
    if told.spring.rest.is_empty() {
        told.spring.rest = joint.kind.neutral();
    }
    imported!(py, "phipsi._results", "joint_of")?.call1((joint_tuple(&told), joint.kind.has_axis()))
}
