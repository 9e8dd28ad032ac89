//! The class `SceneBuilder`: a scene from code.

use super::choice::read_mimic;
use super::cost::WORTH_DETACHING;
use super::description::{Description, joint_kind, left_out};
use super::interrupts::detached_checked;
use super::object::Object;
use super::scene::PyScene;
use super::{errors, input};
use crate::error::Error;
use crate::scene::{Inertial, JointDescription, Limits, LinkDescription, Mimic, SceneBuilder, Spring};
use crate::spatial::{RigidShift, Symmetric3};
use nalgebra::{Matrix3, Rotation3};
use pyo3::prelude::*;
use std::path::PathBuf;

/// How far an inertia given as a 3x3 matrix may be from symmetric, relative to its largest entry.
const ASYMMETRY: f64 = 1e-9;

/// Collects links and joints by name, each call returning the builder; build() checks them and makes the Scene.
///
/// Builders pickle and copy; a copy goes its own way.
#[pyclass(name = "SceneBuilder", module = "phipsi")]
pub(crate) struct PySceneBuilder {
    pub(super) builder: SceneBuilder,
}

#[pymethods]
impl PySceneBuilder {
    #[new]
    fn new() -> Self {
        Self { builder: SceneBuilder::new() }
    }

    /// Adds a link.
    ///
    /// mass: kg. com: (3,), mass centre in the link's frame, m. inertia: (3, 3), about the mass centre, axes parallel to
    /// the link's frame, kg m^2; None for a point mass. A link without mass and inertia is a mere frame.
    ///
    /// Raises ShapeError or ArgumentError for com and inertia, naming the link; build() checks the rest.
    #[pyo3(signature = (name, mass=0.0, com=None, inertia=None),
           text_signature = "($self, name, mass=0.0, com=(0, 0, 0), inertia=None)")]
    fn link<'py>(
        mut slf: PyRefMut<'py, Self>,
        name: String,
        mass: f64,
        com: Option<&Object<'py>>,
        inertia: Option<&Object<'py>>,
    ) -> PyResult<PyRefMut<'py, Self>> {
        let inertial = inertial(&|argument| format!("{argument} of link {name:?}"), mass, com, inertia)?;
        let inertial = (mass != 0.0 || inertia.is_some()).then_some(inertial);
        slf.change(|builder| builder.link(LinkDescription { name, inertial }));
        Ok(slf)
    }

    /// Adds a joint; the links that it names may come later.
    ///
    /// type: "fixed", "revolute", "continuous", "prismatic", "screw", "planar", "universal", "spherical" or "floating". xyz: (3,), m,
    /// and rpy: (3,), rad, R = Rz(yaw) Ry(pitch) Rx(roll), or rotation: (3, 3): the child's frame at zero configuration
    /// seen from the parent's. axis: (3,), in the child's frame, of any length. pitch: m/rad, for a screw. armature: kg m^2
    /// or kg for each degree of freedom, part of the mass matrix. damping (N m s/rad or N s/m), friction (N m or N),
    /// stiffness (N m/rad or N/m) and rest (the joint's coordinates there, None: the neutral ones): simulation only. lower, upper,
    /// velocity, effort: limits; lower and upper are stops in simulations, the others are reported. mimic: a joint that this one should follow, as mimic_multiplier
    /// times its coordinate plus mimic_offset (rad or m); build(mimic="couple") has it follow.
    ///
    /// Raises SceneError for an unknown type or a missing pitch; ShapeError or ArgumentError for arrays, naming the joint;
    /// build() checks the rest.
    #[pyo3(signature = (name, r#type, parent, child, *, xyz=None, rpy=None, rotation=None, axis=None, pitch=None,
                        armature=0.0, damping=0.0, friction=0.0, stiffness=0.0, rest=None, lower=None, upper=None, velocity=None,
                        effort=None, mimic=None, mimic_multiplier=1.0, mimic_offset=0.0),
           text_signature = "($self, name, type, parent, child, *, xyz=(0, 0, 0), rpy=None, rotation=None, \
                             axis=(0, 0, 1), pitch=None, armature=0.0, damping=0.0, friction=0.0, stiffness=0.0, rest=None, \
                             lower=None, upper=None, velocity=None, effort=None, mimic=None, mimic_multiplier=1.0, mimic_offset=0.0)")]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn joint<'py>(
        mut slf: PyRefMut<'py, Self>,
        name: String,
        r#type: &str,
        parent: String,
        child: String,
        xyz: Option<&Object<'py>>,
        rpy: Option<&Object<'py>>,
        rotation: Option<&Object<'py>>,
        axis: Option<&Object<'py>>,
        pitch: Option<f64>,
        armature: f64,
        damping: f64,
        friction: f64,
        stiffness: f64,
        rest: Option<&Object<'py>>,
        lower: Option<f64>,
        upper: Option<f64>,
        velocity: Option<f64>,
        effort: Option<f64>,
        mimic: Option<String>,
        mimic_multiplier: f64,
        mimic_offset: f64,
    ) -> PyResult<PyRefMut<'py, Self>> {
        let of_joint = |argument: &str| format!("{argument} of joint {name:?}");
        let none = Limits::default();
        let kind = joint_kind(&name, r#type, pitch)?;
        let rest = match rest {
            None => Vec::new(),
            Some(rest) if kind.nq() == 1 => input::spread(&of_joint("rest"), rest, 1.into())?,
            Some(rest) => input::fixed(&of_joint("rest"), rest, &[kind.nq()])?,
        };
        let joint = JointDescription {
            kind,
            parent,
            child,
            origin: RigidShift {
                rotation: orientation(&of_joint, rpy, rotation)?,
                lever: optional_triple(&of_joint("xyz"), xyz, [0.0; 3])?.into(),
            },
            axis: optional_triple(&of_joint("axis"), axis, [0.0, 0.0, 1.0])?.into(),
            armature,
            damping,
            friction,
            spring: Spring { stiffness, rest },
            limits: Limits {
                lower: lower.unwrap_or(none.lower),
                upper: upper.unwrap_or(none.upper),
                velocity: velocity.unwrap_or(none.velocity),
                effort: effort.unwrap_or(none.effort),
            },
            mimic: mimic.map(|joint| Mimic { joint, multiplier: mimic_multiplier, offset: mimic_offset }),
            name,
        };
        slf.change(|builder| builder.joint(joint));
        Ok(slf)
    }

    /// Checks everything and makes the Scene; the builder can be used again.
    ///
    /// floating_base: puts a free joint under the root link, named as in Scene.from_urdf. gravity: (3,), m/s^2, in the base
    /// frame. strict: unphysical inertias raise instead of warning. leave_out, mimic: as in Scene.from_urdf. What is None is as the
    /// builder has it: a fixed base, (0, 0, -9.81), False, all and "free" in a new one, the scene's own in one from Scene.to_builder.
    ///
    /// tolerance: geometric tolerance of linkages, an angle in rad or a length over the reach of the loop, 0 to 0.1: rows of connections that depend on each other to within it
    /// count as dependent, with a LinkageWarning at the first call that finds one (Scene.project has the details). None: 3e-5; 5e-3, 2e-3 or 2e-4 for a URDF whose angles have two, three or four
    /// decimals. With strict=True only rows that depend on each other to within rounding do, and an axis that is drawn 1e-6 rad off makes a planar linkage rigid.
    ///
    /// Raises SceneError, naming link or joint, for: no link, a name used twice, an unknown parent or child, two parents,
    /// two roots, a cycle, an axis without direction, numbers that are not finite, negative mass, armature, damping or
    /// friction, lower above upper, a floating base of what floats already; naming the connection, for links or joints that are not there or cannot be connected. Warns InertiaWarning for
    /// inertias that no body can have, and MimicWarning, as Scene.from_urdf does.
    #[pyo3(signature = (floating_base=None, gravity=None, strict=None, *, leave_out=None, mimic=None, tolerance=None))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn build(
        &self,
        py: Python<'_>,
        floating_base: Option<bool>,
        gravity: Option<&Object<'_>>,
        strict: Option<bool>,
        leave_out: Option<&Object<'_>>,
        mimic: Option<&str>,
        tolerance: Option<f64>,
    ) -> PyResult<PyScene> {
        let mimic = mimic.map(read_mimic).transpose()?;
        let simplifications = leave_out.map(|given| left_out(Some(given))).transpose()?;
        let gravity = gravity.map(|gravity| input::triple("gravity", gravity)).transpose()?;
        let build = || {
            let builder = &self.builder;
            let floating_base = floating_base.unwrap_or(builder.is_floating());
            let strict = strict.unwrap_or(builder.is_strict());
            let simplifications = simplifications.unwrap_or(builder.left_out());
            let gravity = gravity.unwrap_or(builder.gravity_vector());
            let builder = builder.clone().floating_base(floating_base).gravity(gravity);
            let mimic = mimic.unwrap_or(builder.of_mimic_joints());
            let tolerance = tolerance.or(builder.tolerance_of_linkages());
            builder.strict(strict).simplifications(simplifications).mimic_joints(mimic).tolerance(tolerance).build()
        };
        // A builder that is being read without the GIL refuses to grow: that is for those which take long.
        let scene = if self.builder.links().len() < WORTH_DETACHING { build()? } else { detached_checked(py, build)? };
        errors::warn(py, &scene)?;
        Ok(PyScene::new(scene))
    }

    /// The file that scenes of this builder come from, for readers in Python.
    fn _set_file(&mut self, file: PathBuf) {
        self.change(|builder| builder.with_file(Some(file)));
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Object<'py>, (Description,))> {
        let rebuild = slf.py().import("phipsi._core")?.getattr("_rebuild_builder")?;
        Ok((rebuild, (Description::of(&slf.borrow().builder)?,)))
    }

    fn __copy__(&self) -> Self {
        Self { builder: self.builder.clone() }
    }

    #[pyo3(signature = (memo, /))]
    fn __deepcopy__(&self, memo: &Object<'_>) -> Self {
        let _ = memo;
        self.__copy__()
    }

    fn __repr__(&self) -> String {
        let (links, joints, connections) =
            (self.builder.links().len(), self.builder.joints().len(), self.builder.connections().len());
        let closed = if connections > 0 { format!(", {connections} connections") } else { String::new() };
        let contacts = self.builder.contacts().len();
        let touching = if contacts > 0 { format!(", {contacts} contacts") } else { String::new() };
        format!("<phipsi.SceneBuilder: {links} links, {joints} joints{closed}{touching}>")
    }
}

/// The builder of what SceneBuilder.__reduce__ gave.
#[pyfunction]
#[pyo3(name = "_rebuild_builder", signature = (description, /))]
pub(super) fn rebuild_builder(description: &Object<'_>) -> PyResult<PySceneBuilder> {
    Ok(PySceneBuilder { builder: Description::read("pickled builder", description)?.builder()? })
}

impl PySceneBuilder {
    /// Through the builder's methods, which take it and give it back.
    pub(super) fn change(&mut self, step: impl FnOnce(SceneBuilder) -> SceneBuilder) {
        self.builder = step(std::mem::take(&mut self.builder));
    }
}

/// Mass, mass centre and inertia from the arguments of those names, in messages as `named` says.
pub(super) fn inertial(
    named: &dyn Fn(&str) -> String,
    mass: f64,
    com: Option<&Object<'_>>,
    inertia: Option<&Object<'_>>,
) -> PyResult<Inertial> {
    let center = optional_triple(&named("com"), com, [0.0; 3])?.into();
    let central = inertia.map_or(Ok(Symmetric3::zero()), |inertia| symmetric(&named("inertia"), inertia))?;
    Ok(Inertial { mass, center, central })
}

pub(super) fn optional_triple(name: &str, value: Option<&Object<'_>>, default: [f64; 3]) -> PyResult<[f64; 3]> {
    value.map_or(Ok(default), |value| input::triple(name, value))
}

fn matrix(name: &str, value: &Object<'_>) -> PyResult<Matrix3<f64>> {
    Ok(Matrix3::from_row_slice(&input::fixed(name, value, &[3, 3])?))
}

/// A symmetric matrix; NaN and infinities pass, the scene's own checks name them.
fn symmetric(name: &str, value: &Object<'_>) -> PyResult<Symmetric3<f64>> {
    let m = matrix(name, value)?;
    let defect = (m - m.transpose()).amax();
    if defect > ASYMMETRY * m.amax() {
        let found = format!("a matrix whose two triangles differ by {defect:.1e}");
        return Err(Error::argument(name, found, "a symmetric matrix").into());
    }
    Ok(Symmetric3::from_upper(&m))
}

/// The rotation of an origin, from angles or from a matrix.
pub(super) fn orientation(
    of_joint: &dyn Fn(&str) -> String,
    rpy: Option<&Object<'_>>,
    rotation: Option<&Object<'_>>,
) -> PyResult<Matrix3<f64>> {
    match (rpy, rotation) {
        (None, None) => Ok(Matrix3::identity()),
        (Some(rpy), None) => {
            let [roll, pitch, yaw] = input::triple(&of_joint("rpy"), rpy)?;
            Ok(*Rotation3::from_euler_angles(roll, pitch, yaw).matrix())
        }
        (None, Some(rotation)) => matrix(&of_joint("rotation"), rotation),
        (Some(_), Some(_)) => Err(Error::argument(of_joint("rotation"), "rpy as well", "one of the two").into()),
    }
}
