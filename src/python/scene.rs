//! The class `Scene`: where it comes from, its names, and its place among Python objects.

use super::axis::Axis;
use super::choice::{names, read_mimic};
use super::cost::WORTH_DETACHING;
use super::description::{self, Description};
use super::interrupts::detached_checked;
use super::object::{Object, imported};
use super::scratch::Scratch;
use super::{errors, input, output};
use crate::batch::{self, Pool};
use crate::error::Error;
use crate::memory;
use crate::motion::Properties;
use crate::scene::{Scene, SceneBuilder};
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PySlice, PyTuple};
use std::path::{Path, PathBuf};

/// An articulated system: bodies, joints, gravity, and the names of them; immutable, for any number of threads.
///
/// Made by Scene.from_urdf, from_mujoco, from_pinocchio, phipsi.load or SceneBuilder.build. SI units and radians. Spatial 6-vectors are angular first:
/// wrench = (moment, force), velocity = (angular, linear). Movable joints are in depth-first order, siblings in file order.
///
/// Arrays are (..., nq) or (..., nv): leading batch axes broadcast, rank in = rank out. Lists, float32, integers, strided
/// and Fortran-ordered arrays are converted; C-contiguous float64 is used without a copy. In q a revolute joint is an angle
/// (rad), a prismatic one a length (m), a screw an angle (its pitch in m/rad), a planar one (u, v, theta), a universal one
/// two angles (about x, then y), a spherical one a quaternion (x, y, z, w), a free one (x, y, z, qx, qy, qz, qw) with the
/// rates (linear, angular) in the body's frame.
/// Quaternions may be off unit norm by 1e-3, and are normalised.
///
/// Arguments raise ShapeError, NotFiniteError or ArgumentError (see phipsi.errors), naming the argument and the state.
/// The GIL is released in all calls longer than some microseconds; large batches run on several threads (as many as
/// RAYON_NUM_THREADS says, else one a core), with the same bits for any number of them. On the main thread Ctrl-C ends any long call within
/// some tenths of a second, on all threads of it; out is partly written then.
///
/// Results that memory has no room for raise OutOfMemoryError (a MemoryError), naming the arguments that ask for them and the bytes.
///
/// An argument of one state may be a dict from joint names to numbers (arrays for joints of several coordinates). Labels are matched by
/// joint name, or refused: the index of a pandas Series, the columns of a DataFrame (pandas, polars, Arrow) or the last dimension
/// of an xarray DataArray; a default RangeIndex is none. Masked entries raise but in estimate. Neither is silently dropped.
///
/// Scenes pickle, compare and hash by identity; copies are the scene itself.
#[pyclass(frozen, name = "Scene", module = "phipsi")]
pub(crate) struct PyScene {
    pub(super) scene: Scene,
    pub(super) pool: Pool<Scratch>,
}

impl PyScene {
    pub(super) fn new(scene: Scene) -> Self {
        Self { scene, pool: Pool::default() }
    }

    /// Whether there is room for what the threads of a batch compute in, where that is large.
    pub(super) fn check_scratch(&self, states: usize) -> Result<(), Error> {
        /// About what a thread needs for a body, in bytes, lanes included.
        const A_BODY: usize = 10_000;
        /// The rest of a process takes more than the scratch of so many bodies.
        const MANY: usize = 5_000;
        let bodies = self.scene.model().bodies.len();
        if bodies < MANY {
            return Ok(());
        }
        let threads = batch::threads().min(states).saturating_sub(self.pool.idle());
        memory::room("scene", memory::bytes_of::<[u8; A_BODY]>(&[bodies, threads]))
    }

    /// What the entries of q, and of a result like it, belong to.
    pub(super) fn coordinates(&self) -> Axis<'_> {
        Axis::Coordinates(&self.scene)
    }

    /// What the entries of qd, qdd and tau belong to.
    pub(super) fn rates(&self) -> Axis<'_> {
        Axis::Rates(&self.scene)
    }

    /// Number of moving bodies, at least one: what the time of a call is counted in.
    pub(super) fn size(&self) -> usize {
        self.scene.model().bodies.len().max(1)
    }
}

#[pymethods]
impl PyScene {
    /// The scene of a URDF file or text.
    ///
    /// source: a path (str or os.PathLike), or the XML itself: a str that starts with "<" after white space.
    /// floating_base: puts a free joint under the root link, "root_joint", or with "_" behind where the file has that name
    /// (it is joint_names[0]). gravity: (3,), m/s^2, in the base frame. strict: what is warned of raises, but for mimic
    /// joints whose source is there. leave_out: names of what may be left out, of "fixed_joints",
    /// "base_links", "permuted_axes", "oblique_axes", "zero_velocity" and "zero_gravity"; None: all.
    /// Results are the same to rounding, but operators and estimates need the first two (ArgumentError).
    /// mimic: "couple", joints with <mimic> follow the joint that they name, and have no coordinates of their own: q, tau and M are those of the others; or "free", they
    /// are independent, and a MimicWarning names each. Coupled scenes have all of kinematics, dynamics, derivatives and simulation; what has no form for them
    /// says so (operators, estimation, operational space, gradients of simulations and by parameters).
    ///
    /// Raises SceneError for a file that cannot be read or built, naming link or joint; ArgumentError for a source that is
    /// neither. Warns InertiaWarning for inertias that no body can have and for moving links that all have no mass,
    /// MimicWarning for free mimic joints, LimitWarning for limits that mean nothing (they are taken as none), and
    /// UnknownTagWarning, once, for elements, attributes and text that are not understood (they are passed over).
    #[staticmethod]
    #[pyo3(signature = (source, *, floating_base=false, gravity=None, strict=false, leave_out=None, mimic="free"),
           text_signature = "(source, *, floating_base=False, gravity=(0, 0, -9.81), strict=False, leave_out=None, mimic='free')")]
    fn from_urdf(
        py: Python<'_>,
        source: &Object<'_>,
        floating_base: bool,
        gravity: Option<&Object<'_>>,
        strict: bool,
        leave_out: Option<&Object<'_>>,
        mimic: &str,
    ) -> PyResult<Self> {
        let mimic = read_mimic(mimic)?;
        let simplifications = description::left_out(leave_out)?;
        let gravity = gravity.map(|gravity| input::triple("gravity", gravity)).transpose()?;
        let source = Source::read(source)?;
        let scene = detached_checked(py, || {
            let builder = match source {
                Source::Text(xml) => SceneBuilder::from_urdf(&xml)?,
                Source::File(path) => SceneBuilder::from_urdf_file(&path)?,
            };
            let builder = if let Some(gravity) = gravity { builder.gravity(gravity) } else { builder };
            builder
                .floating_base(floating_base)
                .strict(strict)
                .simplifications(simplifications)
                .mimic_joints(mimic)
                .build()
        })?;
        errors::warn(py, &scene)?;
        Ok(Self::new(scene))
    }

    /// The scene of a MuJoCo model: its bodies, joints, armature, damping, frictionloss, springs and limits. Needs phipsi[mujoco].
    ///
    /// source: a path of MJCF, URDF or .mjb, as MuJoCo reads them, XML, mujoco.MjModel or mujoco.MjSpec. gravity: (3,), m/s^2; None: the model's. strict: what is
    /// warned about raises. leave_out: as in Scene.from_urdf. ignore: names of parts of the model to omit, without a warning: "actuators" (armature and damping of those
    /// that do not act on a hinge or slide), "armature" and "friction" (of free joints), "contacts", "equality", "flexes", "fluid", "gravcomp", "limits" (of ball
    /// joints), "mocap", "nonlinear" (springs, damping, plasticity), "plugins", "softness" (of equality constraints) and "tendons".
    ///
    /// Joints and bodies keep their names and order; a joint whose anchor is off its body's origin, or that is not its body's last, moves a link
    /// "body/joint". Sites with names become links that are fixed to their bodies. Bodies and joints without a name get "body3", "joint0" and so on; where the file has such a name, or a
    /// site has that of a body, "_" is appended or "/site". phipsi.mujoco converts states and forces: the conventions differ at ball and free joints.
    ///
    /// Equality constraints connect, weld and joint (linear) become connections, by their names or "equality 0" and so on; they are rigid: solref and solimp are
    /// not read, neither are those of limits and friction. Armature and damping of actuators are added to those of their joint, times the square of the gear ratio; their
    /// forcerange gives the joint's effort limit. Stops are at range, moved inward by margin. Controls, sensors and the integrator are not read.
    ///
    /// Raises SceneError for a model that cannot be read, and for parts of it that change the motion and that scenes do not have, by name, with the `ignore` that omits them: other
    /// equality constraints, tendons with springs, losses or armature, gravcomp, a medium denser than air, plugins, deformable objects, nonlinear springs and damping, springs, friction
    /// and armature of free joints, mocap bodies that carry or hold others. Raises ImportError without the extra; ArgumentError for other sources. Warns ModelWarning for contacts, limits of
    /// tendons and ball joints, air and soft equality constraints, which are omitted; MeshWarning for missing files that no inertia depends on; otherwise as SceneBuilder.build does, with
    /// MimicWarning for joints that an ignored equality ties linearly.
    #[staticmethod]
    #[pyo3(signature = (source, *, gravity=None, strict=false, leave_out=None, ignore=None),
           text_signature = "(source, *, gravity=None, strict=False, leave_out=None, ignore=())")]
    fn from_mujoco<'py>(
        py: Python<'py>,
        source: &Object<'py>,
        gravity: Option<&Object<'py>>,
        strict: bool,
        leave_out: Option<&Object<'py>>,
        ignore: Option<&Object<'py>>,
    ) -> PyResult<Object<'py>> {
        let ignored = ignore.map(|ignore| names("ignore", ignore, "a list of names")).transpose()?.unwrap_or_default();
        imported!(py, "phipsi.mujoco", "read")?.call1((source, gravity, strict, leave_out, ignored))
    }

    /// The scene of a Pinocchio model: its joints, inertias, armature, damping, dry friction, limits and gravity.
    ///
    /// model: pinocchio.Model. gravity: (3,), m/s^2; None: the model's. strict: unphysical inertias raise instead of warning. leave_out: as in Scene.from_urdf.
    ///
    /// Joints keep their names, bodies those of their frames, in depth-first order. phipsi.pinocchio takes states from Pinocchio's conventions to phipsi's and
    /// back. A body that is fixed to another keeps its frame; its mass is in the other one, as Pinocchio has it.
    ///
    /// Raises SceneError, naming the joint, for composite and mimic joints, for those of Euler angles, and for planar joints with armature or friction (Pinocchio applies
    /// them along axes of the body, phipsi along those of the parent); ImportError without Pinocchio; ArgumentError for
    /// what is no model. Warns as SceneBuilder.build does.
    #[staticmethod]
    #[pyo3(signature = (model, *, gravity=None, strict=false, leave_out=None),
           text_signature = "(model, *, gravity=None, strict=False, leave_out=None)")]
    fn from_pinocchio<'py>(
        py: Python<'py>,
        model: &Object<'py>,
        gravity: Option<&Object<'py>>,
        strict: bool,
        leave_out: Option<&Object<'py>>,
    ) -> PyResult<Object<'py>> {
        imported!(py, "phipsi.pinocchio", "read")?.call1((model, gravity, strict, leave_out))
    }

    /// The file, URDF or MJCF, that the scene comes from, a pathlib.Path; None where it comes from text or code.
    #[getter]
    fn file(&self) -> Option<&Path> {
        self.scene.source().file()
    }

    /// Number of coordinates in q.
    #[getter]
    fn nq(&self) -> usize {
        self.scene.nq()
    }

    /// Armature of each degree of freedom, (nv,), kg m^2 or kg; a copy. It is the variance of the measurement noise.
    #[getter]
    fn armature<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        let armature = self.properties_of_scene(&Properties::of(&self.scene)).armature;
        output::from_numbers(py, &armature, &[self.scene.nv()])
    }

    /// Number of degrees of freedom: the length of qd, qdd and tau.
    #[getter]
    fn nv(&self) -> usize {
        self.scene.nv()
    }

    /// Names of the movable joints, in the order of q; the free joint of a floating base is the first, "root_joint".
    #[getter]
    fn joint_names<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.scene.joints().iter().map(|joint| &joint.name).collect::<Vec<_>>())
    }

    /// Names of the links that the movable joints carry, in the order of joint_names.
    #[getter]
    fn body_names<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.scene.joints().iter().map(|joint| &joint.child).collect::<Vec<_>>())
    }

    /// Names of all links, depth first, those on fixed joints included.
    #[getter]
    fn link_names<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.scene.links().iter().map(|link| &link.name).collect::<Vec<_>>())
    }

    /// Gravity in the base frame, (3,), m/s^2; a copy.
    #[getter]
    fn gravity<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        output::from_numbers(py, self.scene.model().gravity.as_slice(), &[3])
    }

    /// Where a joint is in q, a slice.
    ///
    /// Raises ArgumentError, with the names that there are, for an unknown joint.
    #[pyo3(signature = (joint, /))]
    fn q_index<'py>(&self, py: Python<'py>, joint: &str) -> PyResult<Bound<'py, PySlice>> {
        slice(py, &self.scene.joint(joint)?.q)
    }

    /// Where a joint is in qd, qdd and tau, a slice.
    ///
    /// Raises ArgumentError, with the names that there are, for an unknown joint.
    #[pyo3(signature = (joint, /))]
    fn v_index<'py>(&self, py: Python<'py>, joint: &str) -> PyResult<Bound<'py, PySlice>> {
        slice(py, &self.scene.joint(joint)?.v)
    }

    /// A new scene with the named joints fixed where q, (nq,), has them; names of links stay.
    ///
    /// What is locked is folded into the bodies around it and costs nothing. Locking "root_joint" gives a fixed base.
    ///
    /// Raises ArgumentError for an unknown joint; ShapeError, NotFiniteError or ArgumentError for a bad q.
    fn lock(&self, py: Python<'_>, joints: &Object<'_>, q: &Object<'_>) -> PyResult<Self> {
        let names = names("joints", joints, "a list of joint names")?;
        let q = input::state("q", q, self.coordinates())?;
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let lock = || self.scene.lock(&names, &q);
        Ok(Self::new(if self.size() < WORTH_DETACHING { lock()? } else { detached_checked(py, lock)? }))
    }

    /// The scene as URDF, which from_urdf reads back to the same numbers but for the rounding of angles; a str.
    ///
    /// path: a file to write it to; None: none. name: of the robot. The free joint of a floating base is not written: read it with floating_base=True. Armature,
    /// stiffness and rest are attributes of <dynamics>, which other programs pass over. Shapes are those of the scene's file, where it is a URDF that is still there. A revolute joint without limits is written as
    /// continuous.
    ///
    /// Raises ArgumentError for what URDF cannot hold, by name: connections, contacts, screw and universal joints, springs at joints of several coordinates, losses of a
    /// floating base.
    #[pyo3(signature = (path=None, *, name="robot"))]
    fn to_urdf<'py>(slf: &Bound<'py, Self>, path: Option<&Object<'py>>, name: &str) -> PyResult<Object<'py>> {
        imported!(slf.py(), "phipsi._urdf", "to_urdf")?.call1((slf, path, name))
    }

    /// Shows the robot in a browser: one pose with a slider a joint, or a motion with a play button. Needs phipsi[view].
    ///
    /// motion: None, the neutral configuration; (nq,), a configuration; (k, nq), configurations at the times t, (k,), s; or a Trajectory of one state.
    /// forces: (at, force), (k, n, 3) each, arrows at points in the base frame, m, and N; None: those of the contacts or connections of a Trajectory, where
    /// they are known. They are drawn to scale, with one on the ground that says how many newtons it is.
    /// urdf: the file whose meshes are drawn; None: the one that the scene was read from. Links without a shape there are drawn as capsules of their
    /// inertia. to: a file (.html or .htm) that gets the page, which holds all it needs and opens without phipsi or a network; nothing is served then. port: of
    /// 127.0.0.1; 0: any that is free. title: of the panel. browser: whether to open one.
    ///
    /// Returns a phipsi.view.Viewer: update(q) moves the robot, wait() keeps a script going, close() ends it; with `to` the path of the page.
    ///
    /// Raises ImportError without the extra; ShapeError, NotFiniteError, ArgumentError. Warns MeshWarning where a mesh is not found.
    #[pyo3(signature = (motion=None, **how),
           text_signature = "($self, motion=None, *, t=None, forces=None, urdf=None, to=None, port=0, title=None, browser=True)")]
    fn show<'py>(
        slf: &Bound<'py, Self>,
        motion: Option<&Object<'py>>,
        how: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Object<'py>> {
        imported!(slf.py(), "phipsi.view", "show")?.call((slf, motion), how)
    }

    fn __repr__(&self) -> String {
        description::summary(&self.scene)
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Object<'py>, (Description,))> {
        let rebuild = slf.py().import("phipsi._core")?.getattr("_rebuild_scene")?;
        Ok((rebuild, (Description::of(slf.get().scene.source())?,)))
    }

    /// The scene itself: it cannot change.
    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// The scene itself: it cannot change.
    #[pyo3(signature = (memo, /))]
    fn __deepcopy__(slf: Py<Self>, memo: &Object<'_>) -> Py<Self> {
        let _ = memo;
        slf
    }
}

/// Where a scene comes from.
enum Source {
    Text(String),
    File(PathBuf),
}

impl Source {
    fn read(source: &Object<'_>) -> PyResult<Self> {
        if let Ok(text) = source.extract::<std::borrow::Cow<'_, str>>()
            && text.trim_start_matches('\u{feff}').trim_start().starts_with('<')
        {
            // Whole, so that lines are counted as the user counts them.
            return Ok(Self::Text(text.into_owned()));
        }
        if let Ok(path) = source.extract::<PathBuf>() {
            return Ok(Self::File(path));
        }
        let found = format!("an object of type {}", source.get_type().name()?);
        Err(Error::argument("source", found, "a path (str or os.PathLike) or the text of a URDF").into())
    }
}

fn slice<'py>(py: Python<'py>, range: &std::ops::Range<usize>) -> PyResult<Bound<'py, PySlice>> {
    Ok(PySlice::new(py, isize::try_from(range.start)?, isize::try_from(range.end)?, 1))
}

/// Builds a scene from what Scene.__reduce__ gave; without warnings, which the first building issued.
#[pyfunction]
#[pyo3(name = "_rebuild_scene", signature = (description, /))]
pub(super) fn rebuild_scene(py: Python<'_>, description: &Object<'_>) -> PyResult<PyScene> {
    let description = Description::read("pickled scene", description)?;
    Ok(PyScene::new(detached_checked(py, || description.builder()?.build())?))
}

/// An argument of a method written in Python as float64, of any shape: its last axis of q's entries or qd's where a scene is given.
#[pyfunction]
#[pyo3(name = "_numbers", signature = (name, value, scene=None, coordinates=false, /))]
pub(super) fn numbers<'py>(
    name: &str,
    value: &Object<'py>,
    scene: Option<&PyScene>,
    coordinates: bool,
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let axis = match scene {
        None => Axis::Plain(0),
        Some(scene) if coordinates => scene.coordinates(),
        Some(scene) => scene.rates(),
    };
    input::read(name, value, axis)
}
