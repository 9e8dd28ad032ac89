//! The class `Scene`: its sources, its names, and its behavior as a Python object.

use super::axis::Axis;
use super::choice::{names, read_mimic};
use super::cost::WORTH_DETACHING;
use super::description::{self, Description, body_names};
use super::errors::refuse;
use super::input::in_python;
use super::interrupts::detached_checked;
use super::object::{Object, imported};
use super::output::{Names, property};
use super::scratch::Scratch;
use super::{errors, input};
use crate::batch::{self, Pool};
use crate::error::Error;
use crate::memory;
use crate::scene::{Scene, SceneBuilder};
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PySlice, PyTuple};
use std::path::{Path, PathBuf};

/// Articulated system of links and joints under gravity: immutable, and usable from any number of threads.
///
/// Create it with phipsi.load, Scene.from_urdf, Scene.from_mujoco, Scene.from_pinocchio or SceneBuilder.build.
/// Units are SI and radians. Spatial 6-vectors are angular first: wrench = (moment, force), velocity = (angular,
/// linear).
#[doc = section!(Notes)]
/// **Coordinates.** Movable joints are in depth-first order, siblings in file order. In q, a revolute joint is an
/// angle (rad), a prismatic joint a length (m), a screw joint an angle (pitch in m/rad), a planar joint (u, v,
/// theta), a universal joint two angles (about x, then y), a spherical joint a quaternion (x, y, z, w), and a free
/// joint (x, y, z, qx, qy, qz, qw) with the velocity (linear, angular) in the body frame. Quaternions whose norm
/// differs from 1 by at most 1e-3 are normalized.
///
/// **Order of six-vectors.** Spatial vectors of links (velocities, wrenches, rows of Jacobians) are (angular, linear).
/// The entries of qd, qdd and tau of a free joint are the other way round: (linear, angular) and (force, moment).
/// q_index and v_index select its parts by name: qd[scene.v_index("root_joint", "angular")].
///
/// **Arrays** are (..., nq) or (..., nv). Leading batch axes broadcast; the result has the batch axes of the
/// arguments. Lists, float32, integers, strided and Fortran-ordered arrays are converted; C-contiguous float64
/// arrays are not copied. An argument of one state may be a dict from joint names to values. Labels (the index of a
/// pandas Series, the columns of a DataFrame of pandas, polars or Arrow, the last dimension of an xarray DataArray)
/// are matched by joint name or rejected; a default RangeIndex counts as no labels. Masked entries raise, except in
/// estimate.
///
/// **Threads.** Calls release the GIL if they take longer than some microseconds. Large batches run on several
/// threads (RAYON_NUM_THREADS, by default one per core), with bit-identical results for any number of threads. On
/// the main thread, Ctrl-C ends a long call within some tenths of a second; `out` may then be partly written.
///
/// **Errors.** Arguments raise ShapeError, NotFiniteError or ArgumentError (see phipsi.errors), which name the
/// argument and the state. Results that do not fit in memory raise OutOfMemoryError with the number of bytes.
///
/// Scenes can be pickled. They compare and hash by identity; a copy is the scene itself.
#[doc = section!(Examples)]
/// >>> import numpy as np
/// >>> import phipsi
/// >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
/// >>> q = scene.neutral()
/// >>> np.allclose(scene.forward_dynamics(q, np.zeros(6), scene.gravity_torque(q)), 0.0)
/// True
#[pyclass(frozen, name = "Scene", module = "phipsi")]
pub(crate) struct PyScene {
    pub(super) scene: Scene,
    pub(super) pool: Pool<Scratch>,
}

impl PyScene {
    pub(super) fn new(scene: Scene) -> Self {
        Self { scene, pool: Pool::default() }
    }

    /// Makes a scene from this one, without the GIL if it is large.
    pub(super) fn derived(&self, py: Python<'_>, make: impl FnOnce() -> Result<Scene, Error> + Send) -> PyResult<Self> {
        Ok(Self::new(if self.size() < WORTH_DETACHING { make()? } else { detached_checked(py, make)? }))
    }

    /// Checks that the workspaces of the threads of a batch fit in memory, if they are large.
    pub(super) fn check_scratch(&self, states: usize) -> Result<(), Error> {
        /// Approximate size of the workspace of a thread per body, in bytes, including lanes.
        const A_BODY: usize = 10_000;
        /// Below this number of bodies, workspaces are smaller than the rest of a process.
        const MANY: usize = 5_000;
        let bodies = self.scene.model().bodies.len();
        if bodies < MANY {
            return Ok(());
        }
        let threads = batch::threads().min(states).saturating_sub(self.pool.idle());
        memory::room("scene", memory::bytes_of::<[u8; A_BODY]>(&[bodies, threads]))
    }

    /// Meaning of the entries of q.
    pub(super) fn coordinates(&self) -> Axis<'_> {
        Axis::Coordinates(&self.scene)
    }

    /// Meaning of the entries of qd, qdd and tau.
    pub(super) fn rates(&self) -> Axis<'_> {
        Axis::Rates(&self.scene)
    }

    /// The scene, as of the groups of its methods.
    pub(super) fn as_scene(&self) -> &Self {
        self
    }

    /// Number of moving bodies, at least one, for the estimate of the time of a call.
    pub(super) fn size(&self) -> usize {
        self.scene.model().bodies.len().max(1)
    }
}

typed_methods! {
    static in PyScene;

    /// Create the scene of a URDF file or text.
    #[doc = section!(Parameters)]
    /// source : str or os.PathLike
    ///     Path, or the XML text: a str that starts with "<" after white space.
    /// floating_base : bool, default False
    ///     If true, add a free joint below the root link: joint_names[0], "root_joint", with "_" appended if the file
    ///     has that name.
    /// gravity : (3,) array_like, default (0, 0, -9.81)
    ///     Gravity in the base frame, m/s^2.
    /// strict : bool, default False
    ///     If true, raise instead of warning, except for mimic joints whose source exists.
    #[doc = entries!(leave_out)]
    /// mimic : {"free", "couple"}, default "free"
    ///     "couple": joints with <mimic> follow the joint that they name and have no coordinates of their own; q, tau
    ///     and M are those of the other joints. "free": they are independent, with a MimicWarning for each.
    /// contacts : {"all", "plane"}, optional
    ///     "all": the shapes of <collision> become colliders. "plane": they touch only the plane z = 0 of the base, the
    ///     collider "ground". None: no shapes are read. See phipsi.load.
    #[doc = section!(Returns)]
    /// scene : Scene
    ///     The robot, including the damping, friction, limits and extensions (armature, stiffness, rest) of its joints.
    #[doc = section!(Raises)]
    /// SceneError
    ///     A file that cannot be read or built. The message names the link or joint.
    /// ArgumentError
    ///     A source that is neither a path nor a text, or an invalid argument.
    #[doc = section!(Warns)]
    /// InertiaWarning
    ///     An inertia that no rigid body can have, or moving links without any mass.
    /// MimicWarning
    ///     A mimic joint that is independent.
    /// LimitWarning
    ///     Invalid limits, which are ignored.
    /// UnknownTagWarning
    ///     Elements, attributes and text that are ignored; one warning per file.
    /// MeshWarning, ModelWarning
    ///     With `contacts`: shapes and parameters of contacts that cannot be read, and links that overlap.
    #[doc = section!(Notes)]
    /// Operators and estimation need the simplifications "fixed_joints" and "base_links". Scenes with coupled joints
    /// support kinematics, dynamics, derivatives and simulation; the other methods raise ArgumentError.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM, floating_base=True)
    /// >>> scene.joint_names[:2], scene.nv
    /// (('root_joint', 'joint1'), 12)
    #[staticmethod]
    fn from_urdf[py: Python<'py>](
        source: &Object<'py>; floating_base: bool = false, gravity: Option<&Object<'py>> = None => "(0, 0, -9.81)",
        strict: bool = false, leave_out: Option<&Object<'py>> = None, mimic: &str = "free",
        contacts: Option<&Object<'py>> = None
    ) -> PyResult<Object<'py>> {
        let mimic = read_mimic(mimic)?;
        let given = source;
        let simplifications = description::left_out(leave_out)?;
        let gravity = gravity.map(|gravity| input::triple("gravity", gravity)).transpose()?;
        let source = Source::read(source)?;
        let scene = detached_checked(py, || {
            let builder = match source {
                // Shapes cannot be read from the source later, as those of a file.
                Source::Text(xml) => SceneBuilder::from_urdf(&xml)?.with_shapes(xml.contains("<visual").then_some(xml)),
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
        let scene = Bound::new(py, Self::new(scene))?.into_any();
        match contacts {
            Some(_) => imported!(py, "phipsi._urdf_colliders", "read")?.call1((scene, given, contacts, strict)),
            None => Ok(scene),
        }
    }

    /// Create the scene of a MuJoCo model; needs the extra phipsi[mujoco].
    #[doc = section!(Parameters)]
    /// source : path, str, mujoco.MjModel or mujoco.MjSpec
    ///     Path of an MJCF, URDF or .mjb file, an XML text, or a model.
    /// gravity : (3,) array_like, optional
    ///     Gravity in the base frame, m/s^2; by default that of the model.
    /// strict : bool, default False
    ///     If true, raise instead of warning.
    #[doc = entries!(leave_out)]
    /// ignore : collection of str, optional
    ///     Parts of the model to omit without a warning: "actuators" (armature and damping of those that do not act on
    ///     a hinge or slide), "armature" and "friction" (of free joints), "contacts", "equality", "flexes", "fluid",
    ///     "gravcomp", "keyframes" (their time and mocap poses), "limits" (of ball joints), "mocap", "nonlinear"
    ///     (springs, damping, plasticity), "plugins", "softness" (of constraints) and "tendons".
    /// contacts : {"all", "plane"}, optional
    ///     "all": geoms that can collide become colliders, by MuJoCo's rules. "plane": only fixed planes touch other
    ///     geoms, and those of <pair> each other. None: contacts are not read.
    #[doc = section!(Returns)]
    /// scene : Scene
    ///     The robot. phipsi.mujoco converts states and forces: the conventions differ for ball and free joints.
    #[doc = section!(Raises)]
    /// SceneError
    ///     A model that cannot be read, or parts of it that change the motion and that scenes do not have: other
    ///     equality constraints, tendons with springs, losses or armature, gravcomp, a medium denser than air, plugins,
    ///     deformable objects, nonlinear springs and damping, springs, friction and armature of free joints, mocap
    ///     bodies that carry or hold others. The message names the part and the `ignore` that omits it.
    /// ImportError
    ///     MuJoCo is not installed.
    /// ArgumentError
    ///     Any other source, or an invalid argument.
    #[doc = section!(Warns)]
    /// ModelWarning
    ///     Contacts, limits of tendons and ball joints, air, soft equality constraints, and time, act and mocap poses of
    ///     keyframes, which are omitted. With `contacts`: geoms without a shape (ellipsoids, signed distance fields,
    ///     planes and height fields that move, meshes without volume), friction of condim 4 and 6, two coefficients of a
    ///     <pair>, gaps above the margin, soft contacts; with "plane", other pairs that can collide.
    /// MeshWarning
    ///     Missing files on which no inertia depends.
    /// MimicWarning
    ///     A joint that an ignored equality constraint couples linearly.
    #[doc = section!(Notes)]
    /// Joints and bodies keep their names and order. A joint whose anchor is not at the origin of its body, or that is
    /// not the last of its body, moves a link "body/joint". Named sites become links that are fixed to their bodies.
    /// Unnamed bodies and joints are named "body3", "joint0" and so on; a name that exists gets "_" appended, a site
    /// with the name of a body "/site".
    ///
    /// The equality constraints connect, weld and joint (linear) become rigid connections with their names or "equality
    /// 0" and so on; solref and solimp are not read. Armature and damping of actuators are added to those of their
    /// joint, times the square of the gear ratio; their forcerange is the effort limit. Stops are at range, moved
    /// inward by margin. Sensors and the integrator are not read; scene.actuators are those of hinges and slides, with
    /// the controls of keyframes. scene.initial() is qpos0, and scene.initial(keyframe) the qpos of a keyframe.
    ///
    /// With `contacts`, a collider has the name of its geom, or "geom3" and so on; a mesh stands for its convex hull.
    /// contype, conaffinity, filterparent, <exclude>, <pair>, priority, condim, margin, gap and the flag override have
    /// their effects; friction is the sliding one. Contacts begin at the distance margin - gap.
    #[doc = section!(Examples)]
    /// >>> text = '''<mujoco><worldbody><body name="rod"><joint name="hinge" type="hinge" axis="0 1 0"/>
    /// ... <geom type="capsule" fromto="0 0 0 0 0 -1" size="0.05"/></body></worldbody></mujoco>'''
    /// >>> scene = phipsi.Scene.from_mujoco(text, ignore=["contacts"])
    /// >>> scene.joint_names
    /// ('hinge',)
    #[staticmethod]
    fn from_mujoco[py: Python<'py>](
        source: &Object<'py>; gravity: Option<&Object<'py>> = None, strict: bool = false,
        leave_out: Option<&Object<'py>> = None, ignore: Option<&Object<'py>> = None => "()",
        contacts: Option<&Object<'py>> = None
    ) -> PyResult<Object<'py>> {
        let ignored = ignore.map(|ignore| names("ignore", ignore, "a list of names")).transpose()?.unwrap_or_default();
        imported!(py, "phipsi.mujoco", "read")?.call1((source, gravity, strict, leave_out, ignored, contacts))
    }

    /// Create the scene of a Pinocchio model: joints, inertias, armature, damping, dry friction, limits and gravity.
    #[doc = section!(Parameters)]
    /// model : pinocchio.Model
    ///     The model.
    /// gravity : (3,) array_like, optional
    ///     Gravity in the base frame, m/s^2; by default that of the model.
    /// strict : bool, default False
    ///     If true, unphysical inertias raise instead of warning.
    #[doc = entries!(leave_out)]
    #[doc = section!(Returns)]
    /// scene : Scene
    ///     The robot. phipsi.pinocchio converts states between the conventions.
    #[doc = section!(Raises)]
    /// SceneError
    ///     Composite and mimic joints, joints with Euler angles, and planar joints with armature or friction, which
    ///     Pinocchio applies along axes of the body and phipsi along axes of the parent. The message names the joint.
    /// ImportError
    ///     Pinocchio is not installed.
    /// ArgumentError
    ///     An object that is not a model, or an invalid argument.
    #[doc = section!(Notes)]
    /// Joints keep their names, bodies have the names of their frames, in depth-first order. A body that is fixed to
    /// another body keeps its frame; its mass is part of the other body, as in Pinocchio. Warnings are those of
    /// SceneBuilder.build.
    #[doc = section!(Examples)]
    /// >>> import pinocchio
    /// >>> model = pinocchio.buildModelFromXML(phipsi.BUNDLED_ARM)
    /// >>> phipsi.Scene.from_pinocchio(model).nv
    /// 6
    #[staticmethod]
    fn from_pinocchio[py: Python<'py>](
        model: &Object<'py>; gravity: Option<&Object<'py>> = None, strict: bool = false,
        leave_out: Option<&Object<'py>> = None
    ) -> PyResult<Object<'py>> {
        imported!(py, "phipsi.pinocchio", "read")?.call1((model, gravity, strict, leave_out))
    }
}

copied_as_itself!(PyScene);

#[pymethods]
impl PyScene {
    /// Inertial parameters of the bodies, (bodies, 10), read-only: mass, mass moments and moments of inertia.
    ///
    /// Row b belongs to the link body_names[b] with the links fixed to it. The parameters are (m, m cx, m cy, m cz,
    /// Ixx, Ixy, Iyy, Ixz, Iyz, Izz) in the frame of the link, moments of inertia about its origin, as in regressor
    /// and Identification.parameters; kg, kg m and kg m^2. forward_dynamics and other methods take one such array
    /// per state as `inertias`.
    #[getter]
    fn inertial_parameters<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        let numbers = self.scene.inertial_parameters();
        property(py, &numbers, &[numbers.len() / 10, 10])
    }

    /// Create a scene in which joints are fixed at their coordinates in q; the names of links remain.
    #[doc = section!(Parameters)]
    /// joints : iterable of str
    ///     Names of movable joints. "root_joint" fixes a floating base.
    /// q : (nq,) array_like
    ///     Joint positions, rad or m; only those of the locked joints matter.
    #[doc = section!(Returns)]
    /// scene : Scene
    ///     The scene without these joints, whose bodies are merged: locked joints cost nothing.
    #[doc = raises!(arguments)]
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3).lock(["j1"], [0.0, 0.5, 0.0])
    /// >>> scene.joint_names
    /// ('j0', 'j2')
    fn lock(&self, py: Python<'_>, joints: &Object<'_>, q: &Object<'_>) -> PyResult<Self> {
        let names = names("joints", joints, "a list of joint names")?;
        let q = input::state("q", q, self.coordinates())?;
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        self.derived(py, || self.scene.lock(&names, &q))
    }

    fn __repr__(&self) -> String {
        description::summary(&self.scene)
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Object<'py>, (Description,))> {
        let rebuild = slf.py().import("phipsi._core")?.getattr("_rebuild_scene")?;
        Ok((rebuild, (Description::of(slf.get().scene.source())?,)))
    }
}

getters! {
    in PyScene;

    /// URDF or MJCF file of the scene, a pathlib.Path; None for a scene from text or code.
    file: Option<&Path> = |of, _| of.scene.source().file();

    /// URDF texts whose `<visual>` elements are drawn, in addition to those of the file.
    _shapes: Vec<&str> = |of, _| of.scene.source().shapes().iter().map(String::as_str).collect();

    /// Number of coordinates in q.
    nq: usize = |of, _| of.scene.nq();

    /// Inertia of rotors and gears that each degree of freedom adds to M, (nv,), kg m^2 or kg, read-only.
    armature: PyResult<Object<'py>> = |of, py| property(py, &of.properties().armature, &[of.scene.nv()]);

    /// Number of degrees of freedom: the length of qd, qdd and tau.
    nv: usize = |of, _| of.scene.nv();

    /// Names of the movable joints in the order of q, that of a floating base ("root_joint") first.
    joint_names: Names<'py> = |of, py| PyTuple::new(py, of.scene.joints().iter().map(|joint| &joint.name));

    /// Names of the links that movable joints carry, one for each entry of an axis of bodies.
    ///
    /// They are in the order of joint_names. With mimic joints they include the links of the joints that follow others,
    /// which joint_names does not list.
    body_names: Names<'py> = |of, py| PyTuple::new(py, body_names(&of.scene));

    /// Names of all links in depth-first order, including links on fixed joints.
    link_names: Names<'py> = |of, py| PyTuple::new(py, of.scene.links().iter().map(|link| &link.name));

    /// Gravity in the base frame, (3,), m/s^2, read-only.
    gravity: PyResult<Object<'py>> = |of, py| property(py, of.scene.model().gravity.as_slice(), &[3]);
}

typed_methods! {
    in PyScene;

    /// Write the scene as URDF, which from_urdf reads back to the same numbers, apart from the rounding of angles.
    #[doc = section!(Parameters)]
    /// path : str or os.PathLike, optional
    ///     File to write. None: no file.
    /// name : str, default "robot"
    ///     Name of the robot.
    #[doc = section!(Returns)]
    /// text : str
    ///     The URDF.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     Parts that URDF cannot represent: connections, contacts, screw and universal joints, springs of joints with
    ///     several coordinates, losses of a floating base. The message names the part.
    #[doc = section!(Notes)]
    /// The free joint of a floating base is not written: read the file with floating_base=True. The start and the
    /// keyframes are not written, with a ModelWarning. Armature, stiffness and rest are attributes of <dynamics>, which
    /// other programs ignore. Shapes are copied from the URDF of the scene if it still exists; those of a MuJoCo model are
    /// written as <visual>, without meshes and ellipsoids, and other colliders of links as <collision>, without hulls,
    /// height fields and colliders of the base, with a ModelWarning. A revolute joint without limits is written as
    /// continuous.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> copy = phipsi.Scene.from_urdf(scene.to_urdf())
    /// >>> copy.joint_names == scene.joint_names
    /// True
    fn to_urdf[slf: &Bound<'py, Self>](
        path: Option<&Object<'py>> = None; name: &str = "robot"
    ) -> PyResult<Object<'py>> {
        imported!(slf.py(), "phipsi._urdf", "to_urdf")?.call1((slf, path, name))
    }

    /// Draw random configurations: joint positions uniformly within the limits, orientations uniformly.
    #[doc = section!(Parameters)]
    /// seed : int or numpy.random.Generator, optional
    ///     Seed or generator; None: fresh entropy.
    /// size : int or tuple of int, default ()
    ///     Batch axes.
    #[doc = section!(Returns)]
    /// q : (*size, nq) ndarray
    ///     Configurations. Without limits, or with a limit beyond 20 rad or m, an angle is drawn from (-pi, pi) and a
    ///     length from (-1, 1) m. Coupled joints and connections are not considered; see loops.project.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     Any other seed or size.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    /// >>> q = scene.random_configuration(7, size=100)
    /// >>> bool(np.all((scene.limits.lower <= q) & (q <= scene.limits.upper)))
    /// True
    fn random_configuration[slf: &Bound<'py, Self>](
        seed: Option<&Object<'py>> = None; size: Option<&Object<'py>> = None => "()"
    ) -> PyResult<Object<'py>> {
        imported!(slf.py(), "phipsi._random", "configuration")?.call1((slf, seed, size))
    }
}

methods_in_python! {
    /// Show a configuration or a motion of the robot in a browser; needs the extra phipsi[view].
    #[doc = section!(Parameters)]
    /// motion : (nq,) or (k, nq) array_like, or Trajectory, optional
    ///     A configuration, configurations at the times t, or a trajectory of one state. None: the start,
    ///     initial().
    /// t : (k,) array_like, optional
    ///     Times of the configurations, s.
    /// forces : tuple of two (k, n, 3) array_like, optional
    ///     (at, force): arrows at points in the base frame, m and N, drawn to scale. None: those of the contacts or
    ///     connections of a Trajectory, if known.
    /// urdf : str or os.PathLike, optional
    ///     File whose meshes are drawn. None: that of the scene. Links without a shape are drawn as capsules of their
    ///     inertia.
    /// to : str or os.PathLike, optional
    ///     File for a self-contained page (.html) or a picture (.png; .webp, animated for a motion). Nothing is served
    ///     then.
    /// port : int, default 0
    ///     Port of the server; 0 selects a free one.
    /// host : str, default "127.0.0.1"
    ///     Address of the server. "0.0.0.0" makes the viewer accessible from other machines.
    /// title : str, optional
    ///     Title of the page and of the panel. None: the name of the robot.
    /// browser : bool, optional
    ///     True: open a browser with a server. None: that at a prompt; in a notebook, the viewer is displayed below the
    ///     cell; in a script, a temporary self-contained page opens, which outlives the script, and its address is
    ///     printed.
    /// collision : bool, default False
    ///     True: the colliders are drawn instead of the shapes of the links.
    #[doc = section!(Returns)]
    /// viewer : phipsi.view.Viewer or pathlib.Path
    ///     update(q) moves the robot, wait() serves it until Ctrl-C, close() ends it. With `to`, the path of the page.
    #[doc = section!(Raises)]
    /// ImportError
    ///     The extra `view` is not installed.
    #[doc = entries!(arguments)]
    #[doc = section!(Warns)]
    /// MeshWarning
    ///     A mesh that is not found.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    /// >>> viewer = scene.show(scene.neutral(), browser=False)
    /// >>> viewer.close()
    #[pyo3(text_signature = "($self, motion=None, *, t=None, forces=None, urdf=None, to=None, port=0, \
                  host=\"127.0.0.1\", title=None, browser=None, collision=False)")]
    fn show(motion = None) = "phipsi.view", "show";
}

/// Source of a scene.
enum Source {
    Text(String),
    File(PathBuf),
}

impl Source {
    fn read(source: &Object<'_>) -> PyResult<Self> {
        if let Ok(text) = source.extract::<std::borrow::Cow<'_, str>>()
            && text.trim_start_matches('\u{feff}').trim_start().starts_with('<')
        {
            // The text is not stripped, so that line numbers in messages are those of the user.
            return Ok(Self::Text(text.into_owned()));
        }
        if let Ok(path) = source.extract::<PathBuf>() {
            return Ok(Self::File(path));
        }
        let found = format!("an object of type {}", source.get_type().name()?);
        refuse("source", found, "a path (str or os.PathLike) or the text of a URDF")
    }
}

pub(super) fn slice<'py>(py: Python<'py>, range: &std::ops::Range<usize>) -> PyResult<Bound<'py, PySlice>> {
    Ok(PySlice::new(py, isize::try_from(range.start)?, isize::try_from(range.end)?, 1))
}

/// Rebuilds a scene from the result of Scene.__reduce__, without the warnings, which were issued when it was first
/// built.
#[pyfunction]
#[pyo3(name = "_rebuild_scene", signature = (description, /))]
pub(super) fn rebuild_scene(py: Python<'_>, description: &Object<'_>) -> PyResult<PyScene> {
    let description = Description::read("pickled scene", description)?;
    Ok(PyScene::new(detached_checked(py, || description.builder()?.build())?))
}

/// Reads an argument of a method written in Python as float64, of any shape; with a scene, the last axis has the
/// entries of q or qd.
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

impl PyScene {
    /// Degrees of freedom from names of joints or a boolean array (nv,): true for those that are named.
    pub(super) fn joint_mask(&self, argument: &str, given: &Object<'_>) -> PyResult<Vec<bool>> {
        let flags = imported!(given.py(), "phipsi._arguments", "flags")?;
        if let Some(mask) = in_python(flags, argument, given, self.rates())?.extract()? {
            return Ok(mask);
        }
        let mut mask = vec![false; self.scene.nv()];
        for joint in names(argument, given, "names of joints, or a boolean array (nv,)")? {
            mask[self.scene.joint(&joint).map_err(|error| error.of_argument(argument))?.v.clone()].fill(true);
        }
        Ok(mask)
    }
}
