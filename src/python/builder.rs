//! The class `SceneBuilder`: creates scenes from code.

use super::choice::{choose, read_mimic, refuse_unknown};
use super::collider_tuple::colliders_of_link;
use super::cost::WORTH_DETACHING;
use super::description::{Description, counted, joint_kind, left_out, limits_as_array, limits_from};
use super::errors::refuse;
use super::interrupts::detached_checked;
use super::object::{Object, imported};
use super::scene::PyScene;
use super::{errors, input};
use crate::scene::{FrictionCurve, Inertial, JointDescription, Limits, LinkDescription, Mimic, SceneBuilder, Spring};
use crate::spatial::{RigidShift, Symmetric3};
use nalgebra::{Matrix3, Rotation3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// Largest asymmetry of a 3x3 inertia matrix, relative to its largest entry.
const ASYMMETRY: f64 = 1e-9;

/// Builder of a Scene: collects links, joints, connections and contacts by name; build() checks them.
///
/// Every method that adds a part returns the builder, so calls can be chained. Builders can be pickled and copied;
/// a copy is independent.
#[doc = section!(Examples)]
/// >>> import phipsi
/// >>> builder = phipsi.SceneBuilder().link("base").link("rod", mass=1.0, com=(0, 0, -0.5))
/// >>> scene = builder.joint("hinge", "revolute", "base", "rod", axis=(0, 1, 0)).build()
/// >>> scene.mass_matrix([0.0])
/// array([[0.25]])
#[pyclass(name = "SceneBuilder", module = "phipsi")]
pub(crate) struct PySceneBuilder {
    pub(super) builder: SceneBuilder,
}

/// Result of methods that add a part: the same builder.
pub(super) type Added<'py> = PyResult<PyRefMut<'py, PySceneBuilder>>;

#[pymethods]
impl PySceneBuilder {
    #[new]
    fn new() -> Self {
        Self { builder: SceneBuilder::new() }
    }

    /// Sets the file of the scenes of this builder, for readers in Python.
    fn _set_file(&mut self, file: PathBuf) {
        self.change(|builder| builder.with_file(Some(file)));
    }

    /// Adds a text with shapes that are drawn, for readers in Python.
    fn _add_shapes(&mut self, text: String) {
        self.change(|builder| builder.with_shapes([text]));
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
        let (links, joints) = (self.builder.links().len(), self.builder.joints().len());
        let closed = counted(self.builder.connections().len(), "connections");
        let touching = counted(self.builder.contacts().len(), "contacts");
        format!("<phipsi.SceneBuilder: {links} links, {joints} joints{closed}{touching}>")
    }
}

typed_methods! {
    in PySceneBuilder;

    /// Add a link.
    #[doc = section!(Parameters)]
    /// name : str
    ///     Name of the link.
    /// mass : float, default 0
    ///     Mass, kg. A link without mass and inertia is a frame.
    /// com : (3,) array_like, optional
    ///     Center of mass in the link frame, m. None: the center of the shapes if the inertia is theirs, otherwise
    ///     (0, 0, 0).
    /// inertia : (3, 3) array_like, optional
    ///     Inertia about the center of mass, with axes parallel to the link frame, kg m^2. None: that of a uniform body
    ///     of these shapes about its center; without shapes a point mass.
    /// shape : phipsi.shapes.Box, Sphere, Cylinder, Capsule or Mesh, or a sequence of them, optional
    ///     Shapes with which `show` draws the link. Volumes of several shapes are added, also where they overlap.
    /// collide : bool, default False
    ///     True: the shapes are colliders as well, as those of collider(). Their names are that of the link, followed by
    ///     "/0", "/1", ... if there are several.
    /// friction : float, default 1
    ///     Coefficient of Coulomb friction of these colliders.
    #[doc = returns!(builder)]
    #[doc = section!(Raises)]
    /// ShapeError, ArgumentError
    ///     Invalid com, inertia or shape. The message names the link; build() checks the rest.
    #[doc = section!(Warns)]
    /// InertiaWarning
    ///     The inertia is that of the shapes, and com is not their center: the uniform body is moved to com. Or a shape
    ///     is a Mesh, and the link is a point mass.
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.SceneBuilder().link("base")
    /// >>> builder = builder.link("ball", mass=2.0, shape=phipsi.shapes.Sphere(0.1))
    /// >>> builder.joint("free", "floating", "base", "ball").build().total_mass
    /// 2.0
    fn link[slf: PyRefMut<'py, Self>](
        name: String, mass: f64 = 0.0, com: Option<&Object<'py>> = None, inertia: Option<&Object<'py>> = None;
        shape: Option<&Object<'py>> = None, collide: bool = false, friction: f64 = 1.0, **unknown
    ) -> Added<'py> {
        refuse_unknown(slf.py(), "SceneBuilder.link", unknown)?;
        let colliders = if collide { colliders_of_link(&name, shape, friction)? } else { Vec::new() };
        let described = |shape| imported!(slf.py(), "phipsi.shapes", "to_urdf")?.call1((&name, shape))?.extract();
        let drawn: Option<String> = shape.map(described).transpose()?;
        let mut inertial = inertial(&|argument| format!("{argument} of link {name:?}"), mass, com, inertia)?;
        if let (Some(shape), None, true) = (shape, inertia, mass != 0.0) {
            let com: Option<[f64; 3]> = com.map(|_| inertial.center.into());
            let uniform = imported!(slf.py(), "phipsi.shapes", "uniform_body")?.call1((&name, mass, com, shape))?;
            if let Some((center, entries)) = uniform.extract::<Option<([f64; 3], [f64; 6])>>()? {
                (inertial.center, inertial.central) = (center.into(), Symmetric3::new(entries));
            }
        }
        let inertial = (mass != 0.0 || inertia.is_some()).then_some(inertial);
        Ok(Self::with(slf, |builder| {
            let builder = builder.link(LinkDescription { name, inertial }).with_shapes(drawn);
            colliders.into_iter().fold(builder, SceneBuilder::collider)
        }))
    }

    /// Add a joint. The links that it names may be added later.
    #[doc = section!(Parameters)]
    /// name : str
    ///     Name of the joint.
    /// type : str
    ///     "fixed", "revolute", "continuous", "prismatic", "screw", "planar", "universal", "spherical" or "floating".
    /// parent : str
    ///     Name of the parent link.
    /// child : str
    ///     Name of the child link.
    /// xyz : (3,) array_like, default (0, 0, 0)
    ///     Origin of the child frame at zero configuration, in the parent frame, m.
    /// rpy : (3,) array_like, optional
    ///     Orientation of the child frame at zero configuration, rad: R = Rz(yaw) Ry(pitch) Rx(roll).
    /// rotation : (3, 3) array_like, optional
    ///     The same as a matrix, instead of rpy.
    /// axis : (3,) array_like, or "x", "y", "z", "-x", "-y" or "-z", default (0, 0, 1)
    ///     Axis in the child frame, of any length.
    /// pitch : float, optional
    ///     Pitch of a screw joint, m/rad.
    /// armature : float, default 0
    ///     Rotor inertia of each degree of freedom, kg m^2 or kg, part of the mass matrix.
    /// damping : float, default 0
    ///     Viscous damping, N m s/rad or N s/m, in simulations.
    /// friction : float, default 0
    ///     Coulomb friction, N m or N, in simulations.
    /// friction_offset : float, default 0
    ///     Half of the difference between friction in the positive and in the negative direction, N m or N.
    /// stribeck : float, default 0
    ///     Excess of friction at rest over Coulomb friction, N m or N, which decreases by
    ///     exp(-(qd / stribeck_speed)^2).
    /// stribeck_speed : float, default 0.1
    ///     Speed at which that part has decreased to 1/e, rad/s or m/s.
    /// load_friction : float, default 0
    ///     Friction per torque that the joint transmits, below 1.
    /// stiffness : float, default 0
    ///     Stiffness of the spring, N m/rad or N/m, in simulations.
    /// rest : float or array_like, optional
    ///     Coordinates of the joint where the spring is at rest. None: the neutral ones.
    /// lower : float, optional
    ///     Lower position limit, rad or m: a stop in simulations.
    /// upper : float, optional
    ///     Upper position limit, rad or m: a stop in simulations.
    /// velocity : float, optional
    ///     Velocity limit, rad/s or m/s; reported only.
    /// effort : float, optional
    ///     Effort limit, N m or N; reported only.
    /// acceleration, deceleration, jerk : float, optional
    ///     Limits of the acceleration, of the deceleration, rad/s^2 or m/s^2, and of the jerk, rad/s^3 or m/s^3;
    ///     reported only.
    /// mimic : str, optional
    ///     Name of a joint to follow, with build(mimic="couple").
    /// mimic_multiplier : float, default 1
    ///     Factor of the coordinate of that joint.
    /// mimic_offset : float, default 0
    ///     Offset that is added, rad or m.
    #[doc = returns!(builder)]
    #[doc = section!(Raises)]
    /// SceneError
    ///     An unknown type, or a screw joint without a pitch.
    /// ShapeError, ArgumentError
    ///     Invalid arrays. The message names the joint; build() checks the rest.
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.SceneBuilder().link("base").link("slider", mass=2.0)
    /// >>> scene = builder.joint("rail", "prismatic", "base", "slider", axis=(1, 0, 0), upper=0.5).build()
    /// >>> scene.limits.upper
    /// array([0.5])
    fn joint[slf: PyRefMut<'py, Self>](
        name: String, r#type: &str, parent: String, child: String; xyz: Option<&Object<'py>> = None => "(0, 0, 0)",
        rpy: Option<&Object<'py>> = None, rotation: Option<&Object<'py>> = None,
        axis: Option<&Object<'py>> = None => "(0, 0, 1)", pitch: Option<f64> = None, armature: f64 = 0.0,
        damping: f64 = 0.0, friction: f64 = 0.0, friction_offset: f64 = 0.0, stribeck: f64 = 0.0,
        stribeck_speed: f64 = 0.1, load_friction: f64 = 0.0, stiffness: f64 = 0.0, rest: Option<&Object<'py>> = None,
        lower: Option<f64> = None, upper: Option<f64> = None, velocity: Option<f64> = None, effort: Option<f64> = None,
        acceleration: Option<f64> = None, deceleration: Option<f64> = None, jerk: Option<f64> = None,
        mimic: Option<String> = None, mimic_multiplier: f64 = 1.0, mimic_offset: f64 = 0.0, **unknown
    ) -> Added<'py> {
        refuse_unknown(slf.py(), "SceneBuilder.joint", unknown)?;
        let of_joint = |argument: &str| format!("{argument} of joint {name:?}");
        let limits = [lower, upper, velocity, effort, acceleration, deceleration, jerk];
        let none = limits_as_array(&Limits::default());
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
            origin: frame_of(&of_joint, xyz, rpy, rotation)?,
            axis: axis.map_or(Ok([0.0, 0.0, 1.0]), |axis| direction(&of_joint("axis"), axis))?.into(),
            armature,
            damping,
            friction,
            friction_curve: FrictionCurve { offset: friction_offset, stribeck, stribeck_speed, load: load_friction },
            spring: Spring { stiffness, rest },
            limits: limits_from(std::array::from_fn(|at| limits[at].unwrap_or(none[at]))),
            mimic: mimic.map(|joint| Mimic { joint, multiplier: mimic_multiplier, offset: mimic_offset }),
            name,
        };
        Ok(Self::with(slf, |builder| builder.joint(joint)))
    }

    /// Attach another robot to a link by a fixed joint, such as a gripper to an arm.
    #[doc = section!(Parameters)]
    /// scene : Scene
    ///     The other robot. A floating base of it becomes fixed.
    /// link : str
    ///     Name of the link of this builder that carries its root link.
    /// prefix : str, default ""
    ///     Begin of all its names here, for names that both robots have.
    /// xyz, rpy, rotation
    ///     Pose of its root link in the frame of the link, as in joint().
    /// name : str, optional
    ///     Name of the fixed joint. None: that of its root link with the prefix, followed by "_mount".
    #[doc = returns!(builder)]
    #[doc = section!(Raises)]
    /// ArgumentError, ShapeError
    ///     An unknown link, names that both robots have, or an invalid pose.
    #[doc = section!(Notes)]
    /// Its joints, connections, contacts, colliders, actuators, start and keyframes come with it, but colliders of its
    /// base, such as a ground, do not. Gravity and the other settings are those of this builder.
    #[doc = section!(Examples)]
    /// >>> arm, gripper = phipsi.scenes.chain(3), phipsi.scenes.chain(2)
    /// >>> builder = arm.to_builder().attach(gripper, "link2", prefix="finger_", xyz=(0, 0, 0.3))
    /// >>> builder.build().joint_names
    /// ('j0', 'j1', 'j2', 'finger_j0', 'finger_j1')
    fn attach[mut slf: PyRefMut<'py, Self>](
        scene: &Bound<'py, PyScene>, link: &str; prefix: &str = "", xyz: Option<&Object<'py>> = None => "(0, 0, 0)",
        rpy: Option<&Object<'py>> = None, rotation: Option<&Object<'py>> = None, name: Option<&str> = None, **unknown
    ) -> Added<'py> {
        let py = slf.py();
        refuse_unknown(py, "SceneBuilder.attach", unknown)?;
        let origin = frame_of(&|argument: &str| argument.to_owned(), xyz, rpy, rotation)?;
        let drawn: Vec<String> = imported!(py, "phipsi.shapes", "prefixed")?.call1((scene, prefix))?.extract()?;
        let other = scene.get().scene.source();
        let attached = slf.builder.clone().attach(other, (link, name), prefix, origin)?;
        slf.builder = attached.with_shapes(drawn);
        Ok(slf)
    }

    /// Check all parts and create the Scene. The builder can be used again.
    #[doc = section!(Parameters)]
    /// floating_base : bool, optional
    ///     If true, add a free joint below the root link, as in Scene.from_urdf.
    /// gravity : (3,) array_like, optional
    ///     Gravity in the base frame, m/s^2.
    /// strict : bool, optional
    ///     If true, unphysical inertias raise instead of warning.
    #[doc = entries!(leave_out)]
    /// mimic : {"free", "couple"}, optional
    ///     Treatment of mimic joints, as in Scene.from_urdf.
    /// tolerance : float, optional
    ///     Geometric tolerance of linkages, 0 to 0.1: an angle in rad, or a length relative to the reach of the loop.
    ///     Rows of connections that are dependent within it count as dependent, with a LinkageWarning at the first call
    ///     that finds one (see Scene.loops.project). Default: 3e-5, or 5e-3, 2e-3 or 2e-4 for a URDF whose angles have two,
    ///     three or four decimals. With strict=True, only rows that are dependent within rounding count.
    #[doc = section!(Returns)]
    /// scene : Scene
    ///     The scene.
    #[doc = section!(Raises)]
    /// SceneError
    ///     No link, duplicate names, an unknown parent or child, two parents, two roots, a cycle, an axis of length
    ///     zero, non-finite numbers, negative mass, armature, damping or friction, lower above upper, a floating base
    ///     of a floating robot, or connections and contacts that name unknown or unsuitable parts. The message names
    ///     the part.
    #[doc = entries!(arguments)]
    #[doc = section!(Warns)]
    /// InertiaWarning
    ///     An inertia that no rigid body can have.
    /// MimicWarning
    ///     A mimic joint that is independent.
    #[doc = section!(Notes)]
    /// None means the value of the builder: a fixed base, gravity (0, 0, -9.81), strict=False, all simplifications and
    /// mimic="free" in a new builder; the values of the scene in a builder from Scene.to_builder.
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.SceneBuilder().link("base", mass=1.0)
    /// >>> scene = builder.build(floating_base=True, gravity=(0, 0, 0))
    /// >>> scene.nv
    /// 6
    fn build[&self, py: Python<'py>](
        floating_base: Option<bool> = None, gravity: Option<&Object<'py>> = None, strict: Option<bool> = None;
        leave_out: Option<&Object<'py>> = None, mimic: Option<&str> = None, tolerance: Option<f64> = None
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
        // A builder that is read without the GIL rejects changes, so only large scenes are built without the GIL.
        let scene = if self.builder.links().len() < WORTH_DETACHING { build()? } else { detached_checked(py, build)? };
        errors::warn(py, &scene)?;
        Ok(PyScene::new(scene))
    }
}

/// Rebuilds a builder from the result of SceneBuilder.__reduce__.
#[pyfunction]
#[pyo3(name = "_rebuild_builder", signature = (description, /))]
pub(super) fn rebuild_builder(description: &Object<'_>) -> PyResult<PySceneBuilder> {
    Ok(PySceneBuilder { builder: Description::read("pickled builder", description)?.builder()? })
}

impl PySceneBuilder {
    /// Adds a part.
    pub(super) fn with(
        mut slf: PyRefMut<'_, Self>,
        add: impl FnOnce(SceneBuilder) -> SceneBuilder,
    ) -> PyRefMut<'_, Self> {
        slf.change(add);
        slf
    }

    /// Applies a method of the builder, which consumes and returns it.
    pub(super) fn change(&mut self, step: impl FnOnce(SceneBuilder) -> SceneBuilder) {
        self.builder = step(std::mem::take(&mut self.builder));
    }
}

/// Reads mass, center of mass and inertia; `named` gives the names for messages.
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

/// Reads an axis: three numbers, or the name of a coordinate axis.
fn direction(name: &str, value: &Object<'_>) -> PyResult<[f64; 3]> {
    const NAMED: [(&str, [f64; 3]); 6] = [
        ("x", [1.0, 0.0, 0.0]),
        ("y", [0.0, 1.0, 0.0]),
        ("z", [0.0, 0.0, 1.0]),
        ("-x", [-1.0, 0.0, 0.0]),
        ("-y", [0.0, -1.0, 0.0]),
        ("-z", [0.0, 0.0, -1.0]),
    ];
    let Ok(given) = value.extract::<String>() else { return input::triple(name, value) };
    Ok(choose(name, &given, &NAMED)?)
}

fn matrix(name: &str, value: &Object<'_>) -> PyResult<Matrix3<f64>> {
    Ok(Matrix3::from_row_slice(&input::fixed(name, value, &[3, 3])?))
}

/// Reads a symmetric matrix. NaN and infinities pass, because the checks of the scene name them.
fn symmetric(name: &str, value: &Object<'_>) -> PyResult<Symmetric3<f64>> {
    let m = matrix(name, value)?;
    let defect = (m - m.transpose()).amax();
    if defect > ASYMMETRY * m.amax() {
        return refuse(name, format!("a matrix whose two triangles differ by {defect:.1e}"), "a symmetric matrix");
    }
    Ok(Symmetric3::from_upper(&m))
}

/// Reads a frame from its origin and its rotation.
pub(super) fn frame_of(
    of: &dyn Fn(&str) -> String,
    xyz: Option<&Object<'_>>,
    rpy: Option<&Object<'_>>,
    rotation: Option<&Object<'_>>,
) -> PyResult<RigidShift<f64>> {
    let lever = optional_triple(&of("xyz"), xyz, [0.0; 3])?.into();
    Ok(RigidShift { rotation: orientation(of, rpy, rotation)?, lever })
}

/// Reads the rotation of an origin, from angles or from a matrix.
fn orientation(
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
        (Some(_), Some(_)) => refuse(of_joint("rotation"), "rpy and rotation", "either rpy or rotation"),
    }
}
