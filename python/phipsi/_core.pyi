"""The compiled half of phipsi: scenes, and the algorithms on them."""

import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias, final, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._actuators import Actuators
from ._functions import Function as _Function
from ._motion import PD, ContactMotion, StopImpact, Trajectory
from ._ode import Ode
from ._results import (
    _EstimateWithCovariance,
    Accuracy,
    ConstrainedDynamics,
    ConstrainedInverseDynamics,
    Distances,
    Energy,
    Estimate,
    ForwardDynamicsDerivatives,
    ForwardDynamicsGradients,
    InverseDynamicsDerivatives,
    InverseDynamicsGradients,
    Joint,
    Limits,
    LinearSystem,
    Link,
    MassEstimate,
    Plan,
    Projection,
    RolloutGradients,
    Samples,
)
from .estimation import (
    AccelerationVariance,
    Excitation,
    ExternalWrench,
    MomentumObserver,
    MotionUncertainty,
    Observer,
    Sensor,
)
from .control import MotionPlan
from .control._terms import Term as _Term
from .estimation._identification import Identification
from .operators import Factor
from .shapes import ColliderShape, Shape
from .tasks import InverseKinematics, Task, _InverseKinematicsWithCovariance
from .view import Viewer

__all__ = [
    "BUNDLED_ARM",
    "Contacts",
    "Exact",
    "FORMS",
    "Loops",
    "METHODS",
    "QUANTITIES",
    "ROUTES",
    "RandomModel",
    "RawFactor",
    "Reference",
    "Scene",
    "SceneBuilder",
    "Simulator",
    "_Optimizer",
    "_Observer",
    "__version__",
    "_function_table",
    "_log_likelihood",
    "_numbers",
    "_panic_for_tests",
    "_panic_place",
    "_rebuild_builder",
    "_rebuild_factor",
    "_rebuild_random_model",
    "_rebuild_scene",
    "_rebuild_simulator",
    "_rotate_chosen",
    "_rotate_rows",
    "_smooth_log",
    "_unwritten",
    "chain",
    "emergence",
    "extreme",
    "extreme_names",
    "get_num_threads",
    "growth",
    "measure",
    "method_call",
    "operator_growth",
    "reference",
    "residuals",
    "set_num_threads",
]

__version__: Final[str]

_Array: TypeAlias = NDArray[np.float64]
_Single: TypeAlias = NDArray[np.float32]
_Float64: TypeAlias = type[np.float64] | np.dtype[np.float64] | Literal["float64"] | None
# mypy accepts type[np.float32] as type[np.float64], so overloads of the two need type: ignore.
_Float32: TypeAlias = type[np.float32] | np.dtype[np.float32] | Literal["float32"]
_Errors: TypeAlias = Literal["raise", "nan"]
_Form: TypeAlias = Literal["auto", "covariance", "square-root"]
_Frame: TypeAlias = Literal["local", "world", "local-world-aligned"]
_Kind: TypeAlias = Literal["spatial", "classical"]
_Method: TypeAlias = Literal[
    "auto",
    "semi-implicit-euler",
    "rk4",
    "dormand-prince-5",
    "implicit-euler",
    "rosenbrock-2",
    "rosenbrock-3",
    "contact",
]
_Ignored: TypeAlias = Literal[
    "actuators",
    "armature",
    "contacts",
    "equality",
    "flexes",
    "fluid",
    "friction",
    "gravcomp",
    "limits",
    "mocap",
    "nonlinear",
    "plugins",
    "softness",
    "tendons",
]
_Switch: TypeAlias = Literal[
    "fixed_joints",
    "base_links",
    "permuted_axes",
    "oblique_axes",
    "zero_velocity",
    "zero_gravity",
]
_JointType: TypeAlias = Literal[
    "fixed", "revolute", "continuous", "prismatic", "screw", "planar", "universal", "spherical", "floating"
]

@final
class Scene:
    """Articulated system of links and joints under gravity: immutable, and usable from any number of threads.

    Create it with phipsi.load, Scene.from_urdf, Scene.from_mujoco, Scene.from_pinocchio or SceneBuilder.build.
    Units are SI and radians. Spatial 6-vectors are angular first: wrench = (moment, force), velocity = (angular,
    linear).

    Notes
    -----
    **Coordinates.** Movable joints are in depth-first order, siblings in file order. In q, a revolute joint is an
    angle (rad), a prismatic joint a length (m), a screw joint an angle (pitch in m/rad), a planar joint (u, v,
    theta), a universal joint two angles (about x, then y), a spherical joint a quaternion (x, y, z, w), and a free
    joint (x, y, z, qx, qy, qz, qw) with the velocity (linear, angular) in the body frame. Quaternions whose norm
    differs from 1 by at most 1e-3 are normalized.

    **Order of six-vectors.** Spatial vectors of links (velocities, wrenches, rows of Jacobians) are (angular, linear).
    The entries of qd, qdd and tau of a free joint are the other way round: (linear, angular) and (force, moment).
    q_index and v_index select its parts by name: qd[scene.v_index("root_joint", "angular")].

    **Arrays** are (..., nq) or (..., nv). Leading batch axes broadcast; the result has the batch axes of the
    arguments. Lists, float32, integers, strided and Fortran-ordered arrays are converted; C-contiguous float64
    arrays are not copied. An argument of one state may be a dict from joint names to values. Labels (the index of a
    pandas Series, the columns of a DataFrame of pandas, polars or Arrow, the last dimension of an xarray DataArray)
    are matched by joint name or rejected; a default RangeIndex counts as no labels. Masked entries raise, except in
    estimate.

    **Threads.** Calls release the GIL if they take longer than some microseconds. Large batches run on several
    threads (RAYON_NUM_THREADS, by default one per core), with bit-identical results for any number of threads. On
    the main thread, Ctrl-C ends a long call within some tenths of a second; `out` may then be partly written.

    **Errors.** Arguments raise ShapeError, NotFiniteError or ArgumentError (see phipsi.errors), which name the
    argument and the state. Results that do not fit in memory raise OutOfMemoryError with the number of bytes.

    Scenes can be pickled. They compare and hash by identity; a copy is the scene itself.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> q = scene.neutral()
    >>> np.allclose(scene.forward_dynamics(q, np.zeros(6), scene.gravity_torque(q)), 0.0)
    True
    """

    @staticmethod
    def from_urdf(
        source: str | os.PathLike[str],
        *,
        floating_base: bool = False,
        gravity: ArrayLike = (0, 0, -9.81),
        strict: bool = False,
        leave_out: Collection[_Switch] | None = None,
        mimic: Literal["couple", "free"] = "free",
        contacts: Literal["all", "plane"] | None = None,
    ) -> Scene:
        """Create the scene of a URDF file or text.

        Parameters
        ----------
        source : str or os.PathLike
            Path, or the XML text: a str that starts with "<" after white space.
        floating_base : bool, default False
            If true, add a free joint below the root link: joint_names[0], "root_joint", with "_" appended if the file
            has that name.
        gravity : (3,) array_like, default (0, 0, -9.81)
            Gravity in the base frame, m/s^2.
        strict : bool, default False
            If true, raise instead of warning, except for mimic joints whose source exists.
        leave_out : collection of str, optional
            Names of the simplifications to allow: "fixed_joints", "base_links", "permuted_axes", "oblique_axes",
            "zero_velocity" and "zero_gravity". None: all. They change results by rounding only; see Scene.plan.
        mimic : {"free", "couple"}, default "free"
            "couple": joints with <mimic> follow the joint that they name and have no coordinates of their own; q, tau
            and M are those of the other joints. "free": they are independent, with a MimicWarning for each.
        contacts : {"all", "plane"}, optional
            "all": the shapes of <collision> become colliders. "plane": they touch only the plane z = 0 of the base, the
            collider "ground". None: no shapes are read. See phipsi.load.

        Returns
        -------
        scene : Scene
            The robot, including the damping, friction, limits and extensions (armature, stiffness, rest) of its joints.

        Raises
        ------
        SceneError
            A file that cannot be read or built. The message names the link or joint.
        ArgumentError
            A source that is neither a path nor a text, or an invalid argument.

        Warns
        -----
        InertiaWarning
            An inertia that no rigid body can have, or moving links without any mass.
        MimicWarning
            A mimic joint that is independent.
        LimitWarning
            Invalid limits, which are ignored.
        UnknownTagWarning
            Elements, attributes and text that are ignored; one warning per file.
        MeshWarning, ModelWarning
            With `contacts`: shapes and parameters of contacts that cannot be read, and links that overlap.

        Notes
        -----
        Operators and estimation need the simplifications "fixed_joints" and "base_links". Scenes with coupled joints
        support kinematics, dynamics, derivatives and simulation; the other methods raise ArgumentError.

        Examples
        --------
        >>> scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM, floating_base=True)
        >>> scene.joint_names[:2], scene.nv
        (('root_joint', 'joint1'), 12)
        """

    @staticmethod
    def from_mujoco(
        source: Any,
        *,
        gravity: ArrayLike | None = None,
        strict: bool = False,
        leave_out: Collection[_Switch] | None = None,
        ignore: Collection[_Ignored] = (),
        contacts: Literal["all", "plane"] | None = None,
    ) -> Scene:
        """Create the scene of a MuJoCo model; needs the extra phipsi[mujoco].

        Parameters
        ----------
        source : path, str, mujoco.MjModel or mujoco.MjSpec
            Path of an MJCF, URDF or .mjb file, an XML text, or a model.
        gravity : (3,) array_like, optional
            Gravity in the base frame, m/s^2; by default that of the model.
        strict : bool, default False
            If true, raise instead of warning.
        leave_out : collection of str, optional
            Names of the simplifications to allow: "fixed_joints", "base_links", "permuted_axes", "oblique_axes",
            "zero_velocity" and "zero_gravity". None: all. They change results by rounding only; see Scene.plan.
        ignore : collection of str, optional
            Parts of the model to omit without a warning: "actuators" (armature and damping of those that do not act on
            a hinge or slide), "armature" and "friction" (of free joints), "contacts", "equality", "flexes", "fluid",
            "gravcomp", "keyframes" (their time and mocap poses), "limits" (of ball joints), "mocap", "nonlinear"
            (springs, damping, plasticity), "plugins", "softness" (of constraints) and "tendons".
        contacts : {"all", "plane"}, optional
            "all": geoms that can collide become colliders, by MuJoCo's rules. "plane": only fixed planes touch other
            geoms, and those of <pair> each other. None: contacts are not read.

        Returns
        -------
        scene : Scene
            The robot. phipsi.mujoco converts states and forces: the conventions differ for ball and free joints.

        Raises
        ------
        SceneError
            A model that cannot be read, or parts of it that change the motion and that scenes do not have: other
            equality constraints, tendons with springs, losses or armature, gravcomp, a medium denser than air, plugins,
            deformable objects, nonlinear springs and damping, springs, friction and armature of free joints, mocap
            bodies that carry or hold others. The message names the part and the `ignore` that omits it.
        ImportError
            MuJoCo is not installed.
        ArgumentError
            Any other source, or an invalid argument.

        Warns
        -----
        ModelWarning
            Contacts, limits of tendons and ball joints, air, soft equality constraints, and time, act and mocap poses of
            keyframes, which are omitted. With `contacts`: geoms without a shape (ellipsoids, signed distance fields,
            planes and height fields that move, meshes without volume), friction of condim 4 and 6, two coefficients of a
            <pair>, gaps above the margin, soft contacts; with "plane", other pairs that can collide.
        MeshWarning
            Missing files on which no inertia depends.
        MimicWarning
            A joint that an ignored equality constraint couples linearly.

        Notes
        -----
        Joints and bodies keep their names and order. A joint whose anchor is not at the origin of its body, or that is
        not the last of its body, moves a link "body/joint". Named sites become links that are fixed to their bodies.
        Unnamed bodies and joints are named "body3", "joint0" and so on; a name that exists gets "_" appended, a site
        with the name of a body "/site".

        The equality constraints connect, weld and joint (linear) become rigid connections with their names or "equality
        0" and so on; solref and solimp are not read. Armature and damping of actuators are added to those of their
        joint, times the square of the gear ratio; their forcerange is the effort limit. Stops are at range, moved
        inward by margin. Sensors and the integrator are not read; scene.actuators are those of hinges and slides, with
        the controls of keyframes. scene.initial() is qpos0, and scene.initial(keyframe) the qpos of a keyframe.

        With `contacts`, a collider has the name of its geom, or "geom3" and so on; a mesh stands for its convex hull.
        contype, conaffinity, filterparent, <exclude>, <pair>, priority, condim, margin, gap and the flag override have
        their effects; friction is the sliding one. Contacts begin at the distance margin - gap.

        Examples
        --------
        >>> text = '''<mujoco><worldbody><body name="rod"><joint name="hinge" type="hinge" axis="0 1 0"/>
        ... <geom type="capsule" fromto="0 0 0 0 0 -1" size="0.05"/></body></worldbody></mujoco>'''
        >>> scene = phipsi.Scene.from_mujoco(text, ignore=["contacts"])
        >>> scene.joint_names
        ('hinge',)
        """
    @staticmethod
    def from_pinocchio(
        model: Any,
        *,
        gravity: ArrayLike | None = None,
        strict: bool = False,
        leave_out: Collection[_Switch] | None = None,
    ) -> Scene:
        """Create the scene of a Pinocchio model: joints, inertias, armature, damping, dry friction, limits and gravity.

        Parameters
        ----------
        model : pinocchio.Model
            The model.
        gravity : (3,) array_like, optional
            Gravity in the base frame, m/s^2; by default that of the model.
        strict : bool, default False
            If true, unphysical inertias raise instead of warning.
        leave_out : collection of str, optional
            Names of the simplifications to allow: "fixed_joints", "base_links", "permuted_axes", "oblique_axes",
            "zero_velocity" and "zero_gravity". None: all. They change results by rounding only; see Scene.plan.

        Returns
        -------
        scene : Scene
            The robot. phipsi.pinocchio converts states between the conventions.

        Raises
        ------
        SceneError
            Composite and mimic joints, joints with Euler angles, and planar joints with armature or friction, which
            Pinocchio applies along axes of the body and phipsi along axes of the parent. The message names the joint.
        ImportError
            Pinocchio is not installed.
        ArgumentError
            An object that is not a model, or an invalid argument.

        Notes
        -----
        Joints keep their names, bodies have the names of their frames, in depth-first order. A body that is fixed to
        another body keeps its frame; its mass is part of the other body, as in Pinocchio. Warnings are those of
        SceneBuilder.build.

        Examples
        --------
        >>> import pinocchio
        >>> model = pinocchio.buildModelFromXML(phipsi.BUNDLED_ARM)
        >>> phipsi.Scene.from_pinocchio(model).nv
        6
        """
    @property
    def _shapes(self) -> list[str]: ...
    @property
    def file(self) -> Path | None:
        """URDF or MJCF file of the scene, a pathlib.Path; None for a scene from text or code."""

    @property
    def nq(self) -> int:
        """Number of coordinates in q."""

    @property
    def nv(self) -> int:
        """Number of degrees of freedom: the length of qd, qdd and tau."""

    @property
    def inertial_parameters(self) -> _Array:
        """Inertial parameters of the bodies, (bodies, 10), read-only: mass, mass moments and moments of inertia.

        Row b belongs to the link body_names[b] with the links fixed to it. The parameters are (m, m cx, m cy, m cz,
        Ixx, Ixy, Iyy, Ixz, Iyz, Izz) in the frame of the link, moments of inertia about its origin, as in regressor
        and Identification.parameters; kg, kg m and kg m^2. forward_dynamics and other methods take one such array
        per state as `inertias`.
        """

    @property
    def armature(self) -> _Array:
        """Inertia of rotors and gears that each degree of freedom adds to M, (nv,), kg m^2 or kg, read-only."""

    @property
    def damping(self) -> _Array:
        """Viscous damping of each degree of freedom, (nv,), N m s/rad or N s/m, read-only; used in simulations."""

    @property
    def friction_terms(self) -> _Array:
        """Terms of friction: friction_offset, stribeck, stribeck_speed and load_friction, (4, nv), read-only."""

    @property
    def friction(self) -> _Array:
        """Coulomb friction of each degree of freedom, (nv,), N m or N, read-only; used in simulations."""

    @property
    def stiffness(self) -> _Array:
        """Spring stiffness of each degree of freedom, (nv,), N m/rad or N/m, read-only; used in simulations."""

    @property
    def rest(self) -> _Array:
        """Configuration in which the springs are at rest, (nq,), read-only."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the movable joints in the order of q, that of a floating base ("root_joint") first."""

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the links that movable joints carry, one for each entry of an axis of bodies.

        They are in the order of joint_names. With mimic joints they include the links of the joints that follow others,
        which joint_names does not list.
        """

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of all links in depth-first order, including links on fixed joints."""

    @property
    def gravity(self) -> _Array:
        """Gravity in the base frame, (3,), m/s^2, read-only."""

    @property
    def total_mass(self) -> float:
        """Mass of all moving links, kg: links fixed to them included, links fixed to the base and armature excluded."""

    @property
    def limits(self) -> Limits:
        """Joint limits per degree of freedom, as phipsi.Limits with fields of shape (nv,), read-only; infinite for none.

        The fields are lower, upper (rad or m), velocity, effort (N m or N), acceleration, deceleration and jerk. A
        joint of several degrees of freedom repeats its limits. Position limits are stops in simulations, unless
        limits="report"; limits of effort are those of PD(effort=True) and effort="clip". The others are reported only.
        """

    def q_index(self, joint: str, /, part: Literal["position", "quaternion"] | None = None) -> slice[int, int, int]:
        """Slice of the coordinates of a joint in q.

        Parameters
        ----------
        joint : str
            Name of a movable joint.
        part : {"position", "quaternion"}, optional
            Part of a free joint, or "quaternion" of a spherical joint. None: all coordinates.

        Returns
        -------
        slice
            Position in q.

        Raises
        ------
        ArgumentError
            An unknown name. The message lists the names that exist.

        Examples
        --------
        >>> phipsi.scenes.chain(3).q_index("j1")
        slice(1, 2, 1)
        >>> phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM, floating_base=True).q_index("root_joint", "quaternion")
        slice(3, 7, 1)
        """

    def v_index(self, joint: str, /, part: Literal["linear", "angular"] | None = None) -> slice[int, int, int]:
        """Slice of the degrees of freedom of a joint in qd, qdd and tau.

        Parameters
        ----------
        joint : str
            Name of a movable joint.
        part : {"linear", "angular"}, optional
            Part of a free joint (in tau force and moment), or "angular" of a spherical joint. None: all degrees of freedom.

        Returns
        -------
        slice
            Position in qd, qdd and tau.

        Raises
        ------
        ArgumentError
            An unknown name. The message lists the names that exist.

        Examples
        --------
        >>> scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM, floating_base=True)
        >>> scene.q_index("joint1"), scene.v_index("joint1")
        (slice(7, 8, 1), slice(6, 7, 1))
        >>> scene.v_index("root_joint", "angular")
        slice(3, 6, 1)
        """

    def neutral(self) -> _Array:
        """Neutral configuration: zero everywhere, and the identity (0, 0, 0, 1) for quaternions.

        Returns
        -------
        q : (nq,) ndarray
            Joint positions, rad or m.

        Examples
        --------
        >>> phipsi.scenes.chain(3).neutral()
        array([0., 0., 0.])
        """

    @property
    def keyframes(self) -> tuple[str, ...]:
        """Names of the keyframes, in the order of the file; unnamed ones are called "key0" and so on."""
    @property
    def actuators(self) -> Actuators:
        """Actuators of the file (MJCF, or `<transmission>` of URDF) and of SceneBuilder.actuator, a sequence by name."""
    def initial(self, keyframe: str | int | None = None) -> _Array:
        """Configuration from which motions begin: that of the file (MJCF: qpos0), or of a keyframe.

        Parameters
        ----------
        keyframe : str or int, optional
            Name or index of a keyframe. None: the start.

        Returns
        -------
        q : (nq,) ndarray
            Joint positions, rad or m. The neutral ones, unless an MJCF file or SceneBuilder.start defines others.

        Raises
        ------
        ArgumentError
            An unknown keyframe. The message lists the names.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3).to_builder().start({"j1": 0.5}, keyframe="bent").build()
        >>> scene.keyframes, scene.initial("bent")
        (('bent',), array([0. , 0.5, 0. ]))
        """
    def initial_velocity(self, keyframe: str | int | None = None) -> _Array:
        """Joint velocities of the start or of a keyframe (MJCF: qvel), with which motions begin.

        Parameters
        ----------
        keyframe : str or int, optional
            Name or index of a keyframe. None: the start.

        Returns
        -------
        qd : (nv,) ndarray
            Joint velocities, rad/s or m/s. Zero, unless an MJCF file or SceneBuilder.start defines others.

        Raises
        ------
        ArgumentError
            An unknown keyframe. The message lists the names.

        Examples
        --------
        >>> phipsi.scenes.chain(3).initial_velocity()
        array([0., 0., 0.])
        """

    @overload
    def forward_dynamics(  # type: ignore[overload-overlap]
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        *,
        form: _Form = "auto",
        tolerance: float | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Array | None = None,
        dtype: _Float64 = None,
        errors: _Errors = "raise",
        return_info: Literal[False] = False,
    ) -> _Array:
        """Joint accelerations from joint torques and wrenches on links, in O(N): qdd of M qdd + bias = tau + J^T w.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        tau : (..., nv) array_like
            Joint torques, N m or N; those of a free joint are (force, moment).
        form : {"auto", "covariance", "square-root"}, default "auto"
            Form of the covariance P in the filter. "covariance" (eq. 3.6) is the fastest; "square-root" is accurate at
            extreme mass ratios too and takes about twice the time. "auto" runs the covariance form and recomputes a
            state in square-root form, and then in double-double arithmetic, if its error estimate exceeds the
            tolerance.
        tolerance : float, optional
            Largest accepted error relative to the largest acceleration, between 0 and 1, in the forms "auto" and
            "square-root". Default: max(5e-14, 4 n eps) with n degrees of freedom on the longest path to the base.
            Errors as small as the effect of one rounding of the forces are always accepted.
        wrenches : dict of str to (..., 6) array_like, optional
            External forces by link name (links on fixed joints too): (moment, force) at the origin and in the frame of
            the link, N m and N.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        out : ndarray, optional
            C-contiguous array of the shape and dtype of the result, without overlap with the arguments. It is returned.
        dtype : {"float64", "float32"} or numpy dtype, optional
            Type of the result, float64 by default. The arithmetic is in float64 in both cases; float32 results are the
            float64 results rounded, and a result beyond the range of float32 is an error.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states (not finite, a quaternion off unit norm, a singular joint, an overflow)
            are NaN, and one BadStateWarning has .states and .reasons. Wrong shapes raise in both cases.
        return_info : bool, default False
            If true, return an Accuracy too. That costs about five times the time in the forms "covariance" and
            "square-root", almost nothing in "auto".

        Returns
        -------
        qdd : (..., nv) ndarray
            Joint accelerations, rad/s^2 or m/s^2; those of a free joint are (linear, angular) in its body frame.
        info : Accuracy
            Only with return_info: .form, .error (estimated) and .bound of each state.

        Raises
        ------
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        ConstraintError
            Connections that contradict each other.
        ArgumentError
            The square-root form of an inertia that no rigid body can have. The message names the link.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        Equations 4.4 to 4.11. With connections, the result is that of loops.dynamics, without an error estimate.
        Contacts act in simulations only. If the call raises, `out` may be partly written.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd, tau = [0.3, 0.2, 0.1], [1.0, 0.0, 0.0], [0.0, 0.5, 0.0]
        >>> qdd = scene.forward_dynamics(q, qd, tau)
        >>> np.allclose(scene.inverse_dynamics(q, qd, qdd), tau)
        True
        """

    @overload
    def forward_dynamics(  # type: ignore[overload-overlap]
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        *,
        form: _Form = "auto",
        tolerance: float | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Array | None = None,
        dtype: _Float64 = None,
        errors: _Errors = "raise",
        return_info: Literal[True],
    ) -> tuple[_Array, Accuracy]: ...

    @overload
    def forward_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        *,
        form: _Form = "auto",
        tolerance: float | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Single | None = None,
        dtype: _Float32,
        errors: _Errors = "raise",
        return_info: Literal[False] = False,
    ) -> _Single: ...

    @overload
    def forward_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        *,
        form: _Form = "auto",
        tolerance: float | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Single | None = None,
        dtype: _Float32,
        errors: _Errors = "raise",
        return_info: Literal[True],
    ) -> tuple[_Single, Accuracy]: ...

    def simulate_vjp(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        cotangent_q: ArrayLike,
        cotangent_qd: ArrayLike,
        *,
        dt: float,
        steps: int,
        tau: ArrayLike | None = None,
        tau_steps: ArrayLike | None = None,
        method: _Method = "auto",
        record_every: int = 1,
        pd: PD | tuple[ArrayLike | None, ...] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        damping: ArrayLike | None = None,
        stiffness: ArrayLike | None = None,
        rest: ArrayLike | None = None,
        friction: ArrayLike | None = None,
        friction_speed: float | None = None,
        form: Literal["auto", "covariance"] = "auto",
        tolerance: float | None = None,
        parameters: bool = False,
        limits: Literal["stop", "report"] | None = None,
        restitution: float = 0.0,
        compliance: ArrayLike | None = None,
        smoothing: float = 0.0,
        targets: ArrayLike | None = None,
        target_rates: ArrayLike | None = None,
        effort: Literal["report", "clip"] | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        frame: Literal["link", "world"] | None = "link",
        contact_friction: ArrayLike | None = None,
        contact_restitution: ArrayLike | None = None,
    ) -> RolloutGradients:
        """Gradients of a function of a trajectory by the adjoint of every step, from recorded rows; as Trajectory.vjp.

        Parameters
        ----------
        q : (..., rows, nq) array_like
            Recorded joint positions, the first at the start.
        qd : (..., rows, nv) array_like
            Recorded joint velocities.
        cotangent_q : (..., rows, nv) array_like
            Gradient of the function with respect to q, in the tangent space of each row.
        cotangent_qd : (..., rows, nv) array_like
            Gradient of the function with respect to qd.
        dt : float
            Step, s.
        steps : int
            Number of steps.
        tau, tau_steps, method, record_every, pd, inertias, armature, damping, stiffness, rest, friction, friction_speed
            As given to simulate; tau is an array.
        form, tolerance
            As given to simulate.
        parameters : bool, default False
            If true, compute the gradients with respect to inertial parameters too.
        limits, restitution, compliance, smoothing, targets, target_rates, effort, wrenches, frame
            As given to simulate.
        contact_friction, contact_restitution
            As given to simulate.

        Returns
        -------
        gradients : RolloutGradients
            Named tuple (q, qd, tau, armature, damping, stiffness, friction, parameters, contacts, mode_changes, target,
            target_rate, control, wrenches): (..., nv) each; tau is (..., steps, nv) with tau_steps, target with targets
            and target_rate with target_rates; parameters is (..., bodies, 10) or None; contacts has the gradients by
            each contact, wrenches those by the wrench on each link, in the shape in which it was given, or None; control
            is None.

        Raises
        ------
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        OutOfMemoryError
            A result that does not fit in memory. The message names the argument that determines its size.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(N) per stage. Steps between rows, and steps with contacts, are recomputed. The memory of a thread grows with
        the square root of the number of steps between two rows; with contacts, the run is
        repeated and every step is stored. Steps after the last row have no effect. Contacts are
        differentiated in the modes of the trajectory (open, sticking, sliding): see docs/motion.md. In closed loops,
        steps are recomputed too, joints at stops or held by friction are differentiated in these modes, and the
        gradients by q and qd are those of changes that satisfy the connections. With mimic joints, q, qd and tau are
        those of the independent joints; parameters has all links of body_names, which include those of the joints that
        follow.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> path = scene.simulate([0.3, 0.2, 0.1], np.zeros(3), dt=1e-3, steps=100, method="rk4")
        >>> last = np.zeros_like(path.qd)
        >>> last[-1, 0] = 1.0     # the function is q[-1, 0]
        >>> keywords = dict(dt=1e-3, steps=100, method="rk4")
        >>> gradients = scene.simulate_vjp(path.q, path.qd, last, np.zeros_like(last), **keywords)
        >>> np.allclose(gradients.q[0], 1.0)     # the first joint is vertical
        True
        """

    def simulate(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        *,
        dt: float | None = None,
        steps: int | None = None,
        tau: ArrayLike | Callable[[float, _Array, _Array], ArrayLike] | None = None,
        tau_steps: ArrayLike | None = None,
        method: _Method = "auto",
        record_every: int = 1,
        pd: PD | tuple[ArrayLike | None, ...] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        damping: ArrayLike | None = None,
        stiffness: ArrayLike | None = None,
        rest: ArrayLike | None = None,
        friction: ArrayLike | None = None,
        friction_speed: float | None = None,
        form: Literal["auto", "covariance"] = "auto",
        tolerance: float | None = None,
        progress: Callable[[int, int], object] | None = None,
        compliance: ArrayLike | None = None,
        limits: Literal["stop", "report"] | None = None,
        restitution: float = 0.0,
        accuracy: float | None = None,
        smoothing: float = 0.0,
        duration: float | None = None,
        covariance: MotionUncertainty | ArrayLike | object | None = None,
        targets: ArrayLike | None = None,
        target_rates: ArrayLike | None = None,
        effort: Literal["report", "clip"] | None = None,
        control: Mapping[str, ArrayLike] | ArrayLike | None = None,
        activation: Mapping[str, ArrayLike] | ArrayLike | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        frame: Literal["link", "world"] | None = "link",
        contact_friction: ArrayLike | None = None,
        contact_restitution: ArrayLike | None = None,
    ) -> Trajectory:
        """Simulate one state or a batch in time: M(q) dv/dt + bias(q, v) = tau + forces of joints and stops, dq/dt = v.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions at the start, rad or m.
        qd : (..., nv) array_like
            Joint velocities at the start, rad/s or m/s.
        dt : float
            Step, s. With accuracy and duration: time between rows, duration / 1000 by default.
        steps : int
            Number of steps. Alternatively, give duration.
        tau : (..., nv) array_like or callable, optional
            Joint torques: constant, or a function of (t, q, qd) that returns (..., nv), called once per step with the
            batch. An error for one state and shape (steps, nv): use tau_steps.
        tau_steps : (..., steps, nv) array_like, optional
            Joint torques of each step, instead of tau.
        method : str, default "auto"
            "semi-implicit-euler", "rk4", "dormand-prince-5", "implicit-euler", "rosenbrock-2" or "rosenbrock-3";
            "contact", for scenes with contacts. "auto" selects "rk4" or "rosenbrock-2" and divides steps with fast
            rotations. Steps in which contacts act are those of "contact" with every method; with "contact" or
            smoothing, all are.
        record_every : int, default 1
            Steps between two rows.
        pd : PD, optional
            Control law PD(kp, kd, target, target_rate, effort), evaluated within the step.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of inertial_parameters: a
            model per state.
        armature : float or (..., nv) array_like, optional
            Armature instead of that of the scene, kg m^2 or kg. As damping, stiffness and friction, for all states or
            (..., nv) for each.
        damping : float or (nv,) array_like, optional
            Viscous damping instead of that of the scene, N m s/rad or N s/m.
        stiffness : float or (nv,) array_like, optional
            Stiffness of the springs instead of that of the scene, N m/rad or N/m.
        rest : (nq,) array_like, optional
            Configuration in which the springs are at rest, instead of that of the scene.
        friction : float or (nv,) array_like, optional
            Coulomb friction instead of that of the scene, N m or N.
        friction_speed : float, optional
            0 or None: exact Coulomb friction. Positive: friction is viscous below this speed, rad/s or m/s. 0 and
            None are 0.01 in steps in which contacts act.
        form : {"auto", "covariance"}, default "auto"
            "auto" recomputes steps whose error estimate exceeds the tolerance; "covariance" checks the pivots only.
        tolerance : float, optional
            As in forward_dynamics; with accuracy, the default is at least 1e-4 times accuracy.
        progress : callable, optional
            Function of (steps done, steps), called at most 20 times per second.
        compliance : float or (..., m) array_like, optional
            Compliance of each row of the connections in the order of loops.rows, (m/s^2)/N or (rad/s^2)/(N m), not
            negative. None: the connections are rigid.
        limits : {"stop", "report"}, optional
            "stop" (default): position limits are stops. "report": Trajectory.violations() lists them.
        restitution : float, default 0
            Coefficient of restitution of the stops, 0 to 1.
        accuracy : float, optional
            Error control: bound of the estimated error of each substep, rad or m, relative above 1 rad/s or m/s.
        smoothing : float, default 0
            Length by which contacts are smoothed, m; 0: the exact law. A contact at rest that carries its equal share
            of the weight has this gap; gradients exist before contact and at changes of its state. The bias is reported
            in Trajectory.contacts. An error for contacts with restitution and with limits="stop" at joints with limits.
        duration : float, optional
            Simulated time, s, instead of steps.
        covariance : MotionUncertainty or (bodies, 10, 10) array_like, optional
            Uncertainty of the start, the parameters and the torques, or the covariance of the inertial parameters
            alone. The trajectory then has .bands: standard deviations and covariances of each row, to first order, of
            each state by its own model. An error for impacts on stops, accuracy and functions tau.
        targets : (..., steps, nq) array_like, optional
            Target of pd in each step, instead of pd.target.
        target_rates : (..., steps, nv) array_like, optional
            Target velocity of pd in each step, instead of pd.target_rate.
        effort : {"report", "clip"}, default "report"
            "clip": the sum of tau and pd is limited to scene.limits.effort. "report": Trajectory.violations() lists
            rows with more.
        control : (n,) or (..., steps, n) array_like, or dict of str to float or array_like, optional
            Controls of scene.actuators: constant, or for each step (an axis of one step: for all steps); by name, a
            float or (..., steps), and 0 for the others. They are clipped to ctrlrange, which Trajectory.violations()
            lists. Servos act within the step, like pd, which cannot be given too; torques of tau are added.
        activation : (..., n) array_like or dict, optional
            Activations of the actuators at the start, as Trajectory.activation; None: zero.
        wrenches : dict of str to (6,) or (..., steps, 6) array_like, optional
            External forces by link name (links on fixed joints too): (moment, force) at the origin of the link, N m and
            N, constant or for each step (an axis of one step: for all steps). They act in all stages of a step.
        frame : {"link", "world"}, default "link"
            Axes of the wrenches: those of the link, with which they rotate, or those of the base.
        contact_friction, contact_restitution : float or (..., n) array_like, optional
            Coefficients of the contacts of contacts.names and then the colliders of collider_names, instead of those of
            the scene, for all states or for each.

        Returns
        -------
        trajectory : Trajectory
            Rows t (rows,), q (..., rows, nq) and qd (..., rows, nv), the first at the start, with the integrator,
            events and stops; bit-identical for any number of threads.

        Raises
        ------
        SimulationError
            The motion diverges, a pivot is lost, connections or contacts have no solution, or tau raises. .trajectory
            has the finished rows.
        SimulationInterrupted
            Ctrl-C (a KeyboardInterrupt), with .trajectory. Other exceptions of signal handlers are raised unchanged.
        ConstraintError
            The start violates the connections; see loops.project.
        OutOfMemoryError
            A result that does not fit in memory. The message names the argument that determines its size.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Warns
        -----
        UnitsWarning
            A step of 1 s or more without error control.
        FrictionWarning
            friction_speed=0 in a scene with contacts, in whose steps joint friction is regularized.
        ContactWarning
            Contacts that start below their surface, which the first step moves out, or slowly with smoothing.
        LimitWarning
            Joints that start outside of limits that are stops, or stops that connections or contacts prevent from
            acting.
        UncertaintyWarning
            With covariance, joints that friction holds, and contacts that errors can bring into another mode.

        Notes
        -----
        O(N) per stage. docs/motion.md has the equations, the methods and their orders, friction, stops, contacts,
        connections, error control and the energy audit.

        Examples
        --------
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # falls from its neutral configuration
        >>> path = scene.simulate(scene.neutral(), np.zeros(6), dt=1e-3, steps=1000, record_every=100)
        >>> path.q.shape, path.integrator, path.q[-1, 1:3].round(2)
        ((11, 6), 'rk4', array([0.79, 0.35]))
        """

    def simulator(
        self,
        q: ArrayLike,
        qd: ArrayLike | None = None,
        *,
        dt: float,
        method: _Method = "auto",
        pd: PD | tuple[ArrayLike | None, ...] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        damping: ArrayLike | None = None,
        stiffness: ArrayLike | None = None,
        rest: ArrayLike | None = None,
        friction: ArrayLike | None = None,
        friction_speed: float | None = None,
        form: Literal["auto", "covariance"] = "auto",
        tolerance: float | None = None,
        compliance: ArrayLike | None = None,
        limits: Literal["stop", "report"] | None = None,
        restitution: float = 0.0,
        accuracy: float | None = None,
        smoothing: float = 0.0,
        effort: Literal["report", "clip"] | None = None,
        contact_friction: ArrayLike | None = None,
        contact_restitution: ArrayLike | None = None,
        control: Mapping[str, ArrayLike] | ArrayLike | None = None,
        activation: Mapping[str, ArrayLike] | ArrayLike | None = None,
    ) -> Simulator:
        """Create a Simulator: one state or a batch that is advanced call by call.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions at the start, rad or m.
        qd : (..., nv) array_like, optional
            Joint velocities at the start, rad/s or m/s; zero by default.
        dt : float
            Step, s.
        method, pd, inertias, armature, damping, stiffness, rest, friction, friction_speed, form, tolerance
            As in simulate, for all steps.
        compliance, limits, restitution, accuracy, smoothing, effort, contact_friction, contact_restitution
            As in simulate, for all steps. The targets of pd can be changed by step.
        control : (..., n) array_like or dict of str to float, optional
            Controls of scene.actuators, which then act in all steps; step(control=...) changes them.
        activation : (..., n) array_like or dict, optional
            Activations of the actuators at the start; None: zero.

        Returns
        -------
        simulator : Simulator
            step(tau) costs one forward dynamics per stage and some tenths of a microsecond.

        Raises
        ------
        OutOfMemoryError
            A result that does not fit in memory. The message names the argument that determines its size.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Examples
        --------
        >>> simulator = phipsi.scenes.chain(3).simulator([0.3, 0.2, 0.1], [1.0, 0.0, 0.0], dt=1e-3)
        >>> simulator.step(steps=100)
        >>> simulator.q.round(3)
        array([0.4, 0.2, 0.1])
        """
    def ode(
        self,
        *,
        tau: ArrayLike | Callable[[float, _Array, _Array], ArrayLike] | None = None,
        pd: PD | tuple[ArrayLike | None, ...] | None = None,
        damping: ArrayLike | None = None,
        stiffness: ArrayLike | None = None,
        rest: ArrayLike | None = None,
        friction: ArrayLike | None = None,
        friction_speed: float = 0.01,
    ) -> Ode:
        """Equations of motion for SciPy's solve_ivp: right-hand side and Jacobian in tangent coordinates, and a solver.

        Parameters
        ----------
        tau : (nv,) array_like or callable, optional
            Joint torques: constant, or a function of (t, q, qd), called at every stage.
        pd : PD, optional
            Control law, as in simulate.
        damping : float or (nv,) array_like, optional
            Viscous damping instead of that of the scene, N m s/rad or N s/m.
        stiffness : float or (nv,) array_like, optional
            Stiffness of the springs instead of that of the scene, N m/rad or N/m.
        rest : (nq,) array_like, optional
            Configuration in which the springs are at rest, instead of that of the scene.
        friction : float or (nv,) array_like, optional
            Coulomb friction instead of that of the scene, N m or N.
        friction_speed : float, default 0.01
            Speed below which friction is viscous, rad/s or m/s; positive, because the solvers need smooth friction.

        Returns
        -------
        ode : Ode
            ode.solve(q, qd, t_span, method=..., rtol=..., atol=...) returns a Trajectory, with error control on the
            manifold.

        Raises
        ------
        ImportError
            SciPy is not installed.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Examples
        --------
        >>> ode = phipsi.scenes.chain(3).ode()
        >>> path = ode.solve([0.3, 0.2, 0.1], [1.0, 0.0, 0.0], (0.0, 0.5))
        >>> path.q[-1].round(3)
        array([0.8, 0.2, 0.1])
        """

    @overload
    def inverse_dynamics(  # type: ignore[overload-overlap]
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        *,
        wrenches: Mapping[str, ArrayLike] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Array | None = None,
        dtype: _Float64 = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Joint torques from joint accelerations, in O(N): tau = M qdd + bias - J^T w, including gravity and armature.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (..., nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.
        wrenches : dict of str to (..., 6) array_like, optional
            External forces by link name (links on fixed joints too): (moment, force) at the origin and in the frame of
            the link, N m and N.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        out : ndarray, optional
            C-contiguous array of the shape and dtype of the result, without overlap with the arguments. It is returned.
        dtype : {"float64", "float32"} or numpy dtype, optional
            Type of the result, float64 by default; float32 results are the float64 results rounded.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        tau : (..., nv) ndarray
            Joint torques, N m or N; those of a free joint are (force, moment), whereas wrenches are (moment, force).

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        tau = H phi (Q lambda + b) + armature qdd - J^T w (1.5, 2.9, 2.10). Damping, friction and springs act in
        simulations only.

        Examples
        --------
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> scene.inverse_dynamics(scene.neutral(), np.zeros(6), np.full(6, 0.5)).round(1)
        array([  2. , -33.5,   0.9,   0.1,   0.1,   0.1])
        """

    @overload
    def inverse_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        *,
        wrenches: Mapping[str, ArrayLike] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Single | None = None,
        dtype: _Float32,
        errors: _Errors = "raise",
    ) -> _Single: ...

    @overload
    def bias_torque(  # type: ignore[overload-overlap]
        self,
        q: ArrayLike,
        qd: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Array | None = None,
        dtype: _Float64 = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Joint torques for zero joint accelerations (Coriolis, centrifugal and gravity), in O(N): the bias torque.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        out : ndarray, optional
            C-contiguous array of the shape and dtype of the result, without overlap with the arguments. It is returned.
        dtype : {"float64", "float32"} or numpy dtype, optional
            Type of the result, float64 by default; float32 results are the float64 results rounded.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        tau : (..., nv) ndarray
            Bias torque, N m or N.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2]
        >>> nonlinear = scene.coriolis_matrix(q, qd) @ qd + scene.gravity_torque(q)
        >>> np.allclose(scene.bias_torque(q, qd), nonlinear)
        True
        """

    @overload
    def bias_torque(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Single | None = None,
        dtype: _Float32,
        errors: _Errors = "raise",
    ) -> _Single: ...

    @overload
    def gravity_torque(  # type: ignore[overload-overlap]
        self,
        q: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Array | None = None,
        dtype: _Float64 = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Gravity torque dU/dq: joint torques that hold the scene in static equilibrium, in O(N).

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        out : ndarray, optional
            C-contiguous array of the shape and dtype of the result, without overlap with the arguments. It is returned.
        dtype : {"float64", "float32"} or numpy dtype, optional
            Type of the result, float64 by default; float32 results are the float64 results rounded.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        tau : (..., nv) ndarray
            Gravity torque, N m or N, along the tangent space of q.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Examples
        --------
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> scene.gravity_torque(scene.neutral()).round(1)
        array([  0. , -37. ,   0.2,   0. ,   0. ,   0. ])
        """

    @overload
    def gravity_torque(
        self,
        q: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Single | None = None,
        dtype: _Float32,
        errors: _Errors = "raise",
    ) -> _Single: ...

    @overload
    def mass_matrix(  # type: ignore[overload-overlap]
        self,
        q: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Array | None = None,
        dtype: _Float64 = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Joint-space mass matrix M(q) of tau = M qdd + bias, including armature (5.1).

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        out : ndarray, optional
            C-contiguous array of the shape and dtype of the result, without overlap with the arguments. It is returned.
        dtype : {"float64", "float32"} or numpy dtype, optional
            Type of the result, float64 by default; float32 results are the float64 results rounded.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        M : (..., nv, nv) ndarray
            Mass matrix, kg m^2, kg m or kg; full and exactly symmetric.

        Raises
        ------
        ArgumentError
            A scene of more than 4000 degrees of freedom, too many for dense matrices.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        inverse_dynamics multiplies by M in O(N) without forming it. Large batches are faster into an `out` that is
        reused.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> M = scene.mass_matrix([0.3, 0.2, 0.1])
        >>> M.shape, bool((M == M.T).all())
        ((3, 3), True)
        """

    @overload
    def mass_matrix(
        self,
        q: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Single | None = None,
        dtype: _Float32,
        errors: _Errors = "raise",
    ) -> _Single: ...

    @overload
    def mass_matrix_inverse(  # type: ignore[overload-overlap]
        self,
        q: ArrayLike,
        *,
        form: _Form = "auto",
        tolerance: float | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Array | None = None,
        dtype: _Float64 = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Inverse of the joint-space mass matrix in closed form (eq. 6.1), without forming or factoring M.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        form : {"auto", "covariance", "square-root"}, default "auto"
            Form of the covariance P; see forward_dynamics.
        tolerance : float, optional
            Largest accepted relative error in the forms "auto" and "square-root"; see forward_dynamics.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        out : ndarray, optional
            C-contiguous array of the shape and dtype of the result, without overlap with the arguments. It is returned.
        dtype : {"float64", "float32"} or numpy dtype, optional
            Type of the result, float64 by default; float32 results are the float64 results rounded.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        Minv : (..., nv, nv) ndarray
            Inverse mass matrix of the kinematic tree, SI units; full and exactly symmetric.

        Raises
        ------
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        ArgumentError
            A scene of more than 4000 degrees of freedom, too many for dense matrices.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        forward_dynamics multiplies by the inverse in O(N) without forming it. The error estimate is that of the factor
        of M. loops.mass_matrix_inverse includes the connections.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q = [0.3, 0.2, 0.1]
        >>> np.allclose(scene.mass_matrix_inverse(q) @ scene.mass_matrix(q), np.eye(3))
        True
        """

    @overload
    def mass_matrix_inverse(
        self,
        q: ArrayLike,
        *,
        form: _Form = "auto",
        tolerance: float | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Single | None = None,
        dtype: _Float32,
        errors: _Errors = "raise",
    ) -> _Single: ...

    def poses(self, q: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """Poses of all links in one array (forward kinematics): homogeneous matrices from link to base frame.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        poses : (..., links, 4, 4) ndarray
            [[R, p], [0, 1]] with p in m, in the order of link_names.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(N). Faster than placements, which makes an array for each link.

        Examples
        --------
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> poses = scene.poses(scene.neutral())
        >>> poses[scene.link_names.index("flange"), :3, 3].round(3)
        array([0.412, 0.15 , 0.488])
        """

    def placements(self, q: ArrayLike, *, errors: _Errors = "raise") -> dict[str, _Array]:
        """Poses of all links by name (forward kinematics): homogeneous matrices from link to base frame.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        poses : dict of str to (..., 4, 4) ndarray
            [[R, p], [0, 1]] with p in m, in the order of link_names; each value is an array of its own.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(N). placement computes the poses of some links only.

        Examples
        --------
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> scene.placements(scene.neutral())["flange"][:3, 3].round(3)
        array([0.412, 0.15 , 0.488])
        """

    def placement(self, q: ArrayLike, link: str | Iterable[str], *, errors: _Errors = "raise") -> _Array:
        """Pose of one link or of several (forward kinematics): homogeneous matrices from link to base frame.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        link : str or sequence of str
            Link name or L link names; links on the base and repeated names are allowed.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        pose : (..., 4, 4) or (..., L, 4, 4) ndarray
            [[R, p], [0, 1]] with p in m; (..., L, 4, 4) for a sequence of names.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(depth): only the joints between the base and these links are evaluated.

        Examples
        --------
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> scene.placement(scene.neutral(), "flange")[:3, 3].round(3)
        array([0.412, 0.15 , 0.488])
        """

    def velocity(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        link: str,
        *,
        frame: _Frame = "local",
        at: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Spatial velocity of a link relative to the base, (angular, linear): J qd.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        link : str
            Name of the link.
        frame : {"local", "local-world-aligned", "world"}, default "local"
            "local": velocity of the point `at`, in the axes of the link. "local-world-aligned": the same in the axes of
            the base. "world": spatial velocity in the base frame, whose linear half is that of the point of the link
            that coincides with the origin of the base; independent of `at`. They are Pinocchio's LOCAL,
            LOCAL_WORLD_ALIGNED and WORLD, with the angular half first.
        at : (3,) array_like, optional
            Point fixed to the link, in the link frame, m; its origin by default.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        v : (..., 6) ndarray
            (angular, linear), rad/s and m/s.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(depth).

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2]
        >>> np.allclose(scene.velocity(q, qd, "link2"), scene.jacobian(q, "link2") @ qd)
        True
        """

    def acceleration(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        link: str,
        *,
        frame: _Frame = "local",
        at: ArrayLike | None = None,
        kind: _Kind = "spatial",
        errors: _Errors = "raise",
    ) -> _Array:
        """Spatial acceleration of a link relative to the base, (angular, linear): J qdd + J' qd, without gravity.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (..., nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.
        link : str
            Name of the link.
        frame : {"local", "world", "local-world-aligned"}, default "local"
            Frame of the result; see velocity.
        at : (3,) array_like, optional
            Point fixed to the link, in the link frame, m; its origin by default.
        kind : {"spatial", "classical"}, default "spatial"
            "spatial": time derivative of the spatial velocity, as in the Newton-Euler equations. "classical": the
            linear half is the acceleration of the point, which adds w x v.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        a : (..., 6) ndarray
            (angular, linear), rad/s^2 and m/s^2.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(depth).

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd, qdd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 1.0, 0.0]
        >>> expected = scene.jacobian(q, "link2") @ qdd + scene.jacobian_rate_product(q, qd, "link2")
        >>> np.allclose(scene.acceleration(q, qd, qdd, "link2"), expected)
        True
        """

    def jacobian(
        self,
        q: ArrayLike,
        link: str,
        *,
        frame: _Frame = "local",
        at: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Geometric Jacobian J of a link: its spatial velocity (angular, linear) is J qd.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        link : str
            Name of the link.
        frame : {"local", "world", "local-world-aligned"}, default "local"
            Frame of the result; see velocity.
        at : (3,) array_like, optional
            Point fixed to the link, in the link frame, m; its origin by default.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        J : (..., 6, nv) ndarray
            Jacobian, SI units, angular rows first. Columns of joints that do not move the link are zero.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        In frame "local", a wrench w = (moment, force) on the link at the point `at` causes the joint torques J^T w.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> J = scene.jacobian([0.3, 0.2, 0.1], "link2", frame="world")
        >>> np.allclose(J[:, 0], [0, 0, 1, 0, 0, 0])     # the first joint rotates about z of the base
        True
        """

    def jacobian_rate(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        link: str,
        *,
        frame: _Frame = "local",
        at: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Time derivative J' of the Jacobian of a link along qd, entry by entry in the given frame.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        link : str
            Name of the link.
        frame : {"local", "world", "local-world-aligned"}, default "local"
            Frame of the result; see velocity.
        at : (3,) array_like, optional
            Point fixed to the link, in the link frame, m; its origin by default.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        dJ : (..., 6, nv) ndarray
            Derivative of jacobian, SI units.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        J qdd + J' qd is the spatial acceleration in the frames "local" and "world", and the classical acceleration in
        "local-world-aligned". jacobian_rate_product computes J' qd alone, in O(depth).

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd = np.array([0.3, 0.2, 0.1]), np.array([1.0, 0.5, 0.2])
        >>> ahead, behind = (scene.jacobian(q + h * qd, "link2") for h in (1e-6, -1e-6))
        >>> np.allclose(scene.jacobian_rate(q, qd, "link2"), (ahead - behind) / 2e-6)
        True
        """

    def jacobian_rate_product(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        link: str,
        *,
        frame: _Frame = "local",
        at: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Acceleration J' qd of a link for zero joint accelerations, without forming J', in O(depth).

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        link : str
            Name of the link.
        frame : {"local", "world", "local-world-aligned"}, default "local"
            Frame of the result; see velocity.
        at : (3,) array_like, optional
            Point fixed to the link, in the link frame, m; its origin by default.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        a : (..., 6) ndarray
            (angular, linear), rad/s^2 and m/s^2: spatial in the frames "local" and "world", classical in
            "local-world-aligned".

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2]
        >>> np.allclose(scene.jacobian_rate_product(q, qd, "link2"), scene.jacobian_rate(q, qd, "link2") @ qd)
        True
        """

    def velocity_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        link: str,
        *,
        frame: _Frame = "local",
        at: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Derivatives of the velocity of a link with respect to q and qd; the second is its Jacobian.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        link : str
            Name of the link.
        frame : {"local", "world", "local-world-aligned"}, default "local"
            Frame of the result; see velocity.
        at : (3,) array_like, optional
            Point fixed to the link, in the link frame, m; its origin by default.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        dv : (..., 2, 6, nv) ndarray
            dv/dq and dv/dqd of velocity, SI units, angular rows first.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(depth). Derivatives with respect to q are along its tangent space, as those of the dynamics: column k is the
        change of v as q moves by integrate(q, e_k).

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd = np.array([0.3, 0.2, 0.1]), np.array([1.0, 0.5, 0.2])
        >>> by_q, by_qd = scene.velocity_derivatives(q, qd, "link2", frame="world")
        >>> np.allclose(by_qd, scene.jacobian(q, "link2", frame="world"))
        True
        >>> step = 1e-6 * np.array([0.0, 1.0, 0.0])
        >>> ahead, behind = (scene.velocity(q + h, qd, "link2", frame="world") for h in (step, -step))
        >>> np.allclose(by_q[:, 1], (ahead - behind) / 2e-6)
        True
        """

    def acceleration_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        link: str,
        *,
        frame: _Frame = "local",
        at: ArrayLike | None = None,
        kind: _Kind = "spatial",
        errors: _Errors = "raise",
    ) -> _Array:
        """Derivatives of the acceleration of a link with respect to q, qd and qdd; the third is its Jacobian.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (..., nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.
        link : str
            Name of the link.
        frame : {"local", "world", "local-world-aligned"}, default "local"
            Frame of the result; see velocity.
        at : (3,) array_like, optional
            Point fixed to the link, in the link frame, m; its origin by default.
        kind : {"spatial", "classical"}, default "spatial"
            As in acceleration.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        da : (..., 3, 6, nv) ndarray
            da/dq, da/dqd and da/dqdd of acceleration, SI units, angular rows first.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(depth). Derivatives with respect to q are along its tangent space, as in velocity_derivatives.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd, qdd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 1.0, 0.0]
        >>> by_q, by_qd, by_qdd = scene.acceleration_derivatives(q, qd, qdd, "link2")
        >>> expected = scene.jacobian_rate(q, qd, "link2") + scene.velocity_derivatives(q, qd, "link2")[0]
        >>> np.allclose(by_qd, expected)
        True
        """

    def jacobian_derivatives(
        self,
        q: ArrayLike,
        link: str,
        *,
        frame: _Frame = "local",
        at: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Derivatives of the Jacobian of a link with respect to q: its Hessian.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        link : str
            Name of the link.
        frame : {"local", "world", "local-world-aligned"}, default "local"
            Frame of the result; see velocity.
        at : (3,) array_like, optional
            Point fixed to the link, in the link frame, m; its origin by default.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        dJ : (..., 6, nv, nv) ndarray
            Entry [i, j, k] is the derivative of jacobian[i, j] along degree of freedom k, SI units.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(depth^2). Derivatives are along the tangent space of q, as in velocity_derivatives; dJ @ qd is jacobian_rate,
        and np.einsum("ijk,j", dJ, qd) is the first of velocity_derivatives.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2]
        >>> np.allclose(scene.jacobian_derivatives(q, "link2") @ qd, scene.jacobian_rate(q, qd, "link2"))
        True
        """

    def inverse_dynamics_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        *,
        wrenches: Mapping[str, ArrayLike] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Array | None = None,
        errors: _Errors = "raise",
    ) -> InverseDynamicsDerivatives:
        """Analytical derivatives of inverse dynamics, in the tangent space of q: dtau/dq, dtau/dqd and dtau/dqdd = M.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (..., nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.
        wrenches : dict of str to (..., 6) array_like, optional
            External forces by link name (links on fixed joints too): (moment, force) at the origin and in the frame of
            the link, N m and N.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        out : (..., 3, nv, nv) ndarray, optional
            C-contiguous float64 array; the results are views of it. Large batches take half the time into a reused one.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        derivatives : InverseDynamicsDerivatives
            Named tuple (dtau_dq, dtau_dqd, mass_matrix), each (..., nv, nv), SI units. Row i is the torque tau_i.

        Raises
        ------
        ArgumentError
            A scene of more than 4000 degrees of freedom, too many for dense matrices.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(N depth). Column j of dtau_dq is the derivative along integrate(q, v) with respect to v_j: an angle or a
        length, a rotation in the child frame for spherical joints, (linear, angular) in the child frame for free
        joints. Wrenches are constant in the frames of their links.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd, qdd = np.array([0.3, 0.2, 0.1]), [1.0, 0.5, 0.2], [0.0, 1.0, 0.0]
        >>> step = np.array([0.0, 1e-6, 0.0])
        >>> change = scene.inverse_dynamics(q + step, qd, qdd) - scene.inverse_dynamics(q - step, qd, qdd)
        >>> np.allclose(scene.inverse_dynamics_derivatives(q, qd, qdd).dtau_dq[:, 1], change / 2e-6)
        True
        """

    def forward_dynamics_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        *,
        form: _Form = "auto",
        tolerance: float | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Array | None = None,
        errors: _Errors = "raise",
    ) -> ForwardDynamicsDerivatives:
        """Analytical derivatives of forward dynamics in the tangent space of q: dqdd/dq, dqdd/dqd, dqdd/dtau = M^-1.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        tau : (..., nv) array_like
            Joint torques, N m or N; those of a free joint are (force, moment).
        form : {"auto", "covariance", "square-root"}, default "auto"
            Form of the covariance P; see forward_dynamics.
        tolerance : float, optional
            Replaces both bounds of form "auto": that of forward_dynamics for the factor of M, and 1e-11 of the largest
            entry for the derivatives. States beyond are recomputed in double-double arithmetic, which takes about 30
            times longer.
        wrenches : dict of str to (..., 6) array_like, optional
            External forces by link name (links on fixed joints too): (moment, force) at the origin and in the frame of
            the link, N m and N.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        out : (..., 3, nv, nv) ndarray, optional
            C-contiguous float64 array; the results are views of it. Large batches take half the time into a reused one.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        derivatives : ForwardDynamicsDerivatives
            Named tuple (dqdd_dq, dqdd_dqd, mass_matrix_inverse), each (..., nv, nv), SI units. Row i is the acceleration
            qdd_i.

        Raises
        ------
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        ArgumentError
            A scene of more than 4000 degrees of freedom, too many for dense matrices.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        dqdd/dq = -M^-1 dtau/dq and dqdd/dqd = -M^-1 dtau/dqd, by eq. 6.1 from inverse_dynamics_derivatives, whose
        columns they have. Wrenches are constant in the frames of their links.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd, tau = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 0.0, 0.0]
        >>> qdd = scene.forward_dynamics(q, qd, tau)
        >>> forward = scene.forward_dynamics_derivatives(q, qd, tau)
        >>> inverse = scene.inverse_dynamics_derivatives(q, qd, qdd)
        >>> np.allclose(inverse.mass_matrix @ forward.dqdd_dq, -inverse.dtau_dq)
        True
        """

    def linearize(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        *,
        form: _Form = "auto",
        tolerance: float | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        springs_and_damping: bool = True,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> LinearSystem:
        """Linearization dx/dt = A x + B u about a motion: x = (tangent of q, change of qd), u = change of tau.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        tau : (..., nv) array_like
            Joint torques, N m or N; those of a free joint are (force, moment).
        form : {"auto", "covariance", "square-root"}, default "auto"
            Form of the covariance P; see forward_dynamics.
        tolerance : float, optional
            As in forward_dynamics_derivatives.
        wrenches : dict of str to (..., 6) array_like, optional
            External forces by link name (links on fixed joints too): (moment, force) at the origin and in the frame of
            the link, N m and N.
        springs_and_damping : bool, default True
            If true, the springs and the viscous damping of the joints act in addition to tau, as in simulate. False:
            the linearization of forward_dynamics.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        system : LinearSystem
            Named tuple (A, B), (..., 2 nv, 2 nv) and (..., 2 nv, nv), in continuous time, SI units.

        Raises
        ------
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        ArgumentError
            A scene of more than 4000 degrees of freedom, too many for dense matrices.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        A = [[-ad(qd), 1], [dqdd_dq, dqdd_dqd]] and B = [[0], [M^-1]], with qdd = forward_dynamics(q, qd, tau -
        stiffness (q - rest) - damping qd), where q - rest is the displacement as in simulate. The deviation
        difference(q, q + dq) is expressed in axes that move with the motion: ad(qd) is zero at rest and for joints with
        one axis, the cross product with the angular velocity for spherical joints, and the bracket of (linear, angular)
        velocities for free joints.

        Dry friction is not included, because it has no derivative at rest: A and B describe the motion of joints
        without it. Subtract friction * sign(qd) from tau for joints that slide.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> A, B = scene.linearize([0.3, 0.2, 0.1], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
        >>> A.shape, B.shape
        ((6, 6), (6, 3))
        """

    def inverse_dynamics_jvp(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        dq: ArrayLike,
        dqd: ArrayLike,
        dqdd: ArrayLike,
        *,
        wrenches: Mapping[str, ArrayLike] | None = None,
        dwrenches: Mapping[str, ArrayLike] | None = None,
        dparameters: ArrayLike | None = None,
        darmature: ArrayLike | None = None,
        dgravity: ArrayLike | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Directional derivative of the joint torques, in O(N): dtau_dq dq + dtau_dqd dqd + M dqdd.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (..., nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.
        dq : (..., nv) array_like
            Change of q in its tangent space: the displacement that integrate(q, dq) applies.
        dqd : (..., nv) array_like
            Change of qd.
        dqdd : (..., nv) array_like
            Change of qdd.
        wrenches : dict of str to (..., 6) array_like, optional
            External forces by link name (links on fixed joints too): (moment, force) at the origin and in the frame of
            the link, N m and N.
        dwrenches : dict of str to (..., 6) array_like, optional
            Changes of the wrenches, by link name.
        dparameters : (..., bodies, 10) array_like, optional
            Changes of the inertial parameters of the links of body_names, as InverseDynamicsGradients orders them.
        darmature : (..., nv) array_like, optional
            Changes of the armature.
        dgravity : (..., 3) array_like, optional
            Change of gravity in the base frame.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        dtau : (..., nv) ndarray
            Change of the joint torques, N m or N.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        Wrenches are constant in the frames of their links, apart from dwrenches. Armature is part of M.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd, qdd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 1.0, 0.0]
        >>> dq, zero = [1.0, 0.0, -1.0], np.zeros(3)
        >>> product = scene.inverse_dynamics_jvp(q, qd, qdd, dq, zero, zero)
        >>> np.allclose(product, scene.inverse_dynamics_derivatives(q, qd, qdd).dtau_dq @ dq)
        True
        """

    def inverse_dynamics_vjp(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        cotangent: ArrayLike,
        *,
        wrenches: Mapping[str, ArrayLike] | None = None,
        parameters: bool = False,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> InverseDynamicsGradients:
        """Gradients of cotangent . tau, in O(N): cotangent dtau_dq, cotangent dtau_dqd and M cotangent.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (..., nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.
        cotangent : (..., nv) array_like
            Gradient of a scalar function with respect to tau.
        wrenches : dict of str to (..., 6) array_like, optional
            External forces by link name (links on fixed joints too): (moment, force) at the origin and in the frame of
            the link, N m and N.
        parameters : bool, default False
            If true, compute the gradients with respect to inertial parameters, armature and gravity too.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        gradients : InverseDynamicsGradients
            Named tuple (q, qd, qdd, wrenches, parameters, armature, gravity); what is not requested is None. The
            gradient with respect to q is in its tangent space, (..., nv).

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd, qdd, c = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 1.0, 0.0], [1.0, 2.0, 3.0]
        >>> gradients = scene.inverse_dynamics_vjp(q, qd, qdd, c)
        >>> np.allclose(gradients.q, c @ scene.inverse_dynamics_derivatives(q, qd, qdd).dtau_dq)
        True
        """

    def forward_dynamics_jvp(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        dq: ArrayLike,
        dqd: ArrayLike,
        dtau: ArrayLike,
        *,
        form: _Form = "auto",
        tolerance: float | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        dwrenches: Mapping[str, ArrayLike] | None = None,
        dparameters: ArrayLike | None = None,
        darmature: ArrayLike | None = None,
        dgravity: ArrayLike | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Directional derivative of the joint accelerations, in O(N): dqdd_dq dq + dqdd_dqd dqd + M^-1 dtau.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        tau : (..., nv) array_like
            Joint torques, N m or N; those of a free joint are (force, moment).
        dq : (..., nv) array_like
            Change of q in its tangent space: the displacement that integrate(q, dq) applies.
        dqd : (..., nv) array_like
            Change of qd.
        dtau : (..., nv) array_like
            Change of tau.
        form : {"auto", "covariance", "square-root"}, default "auto"
            Form of the covariance P; see forward_dynamics.
        tolerance : float, optional
            As in forward_dynamics_derivatives.
        wrenches : dict of str to (..., 6) array_like, optional
            External forces by link name (links on fixed joints too): (moment, force) at the origin and in the frame of
            the link, N m and N.
        dwrenches : dict of str to (..., 6) array_like, optional
            Changes of the wrenches, by link name.
        dparameters : (..., bodies, 10) array_like, optional
            Changes of the inertial parameters of the links of body_names, as InverseDynamicsGradients orders them.
        darmature : (..., nv) array_like, optional
            Changes of the armature.
        dgravity : (..., 3) array_like, optional
            Change of gravity in the base frame.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        dqdd : (..., nv) ndarray
            Change of the joint accelerations, rad/s^2 or m/s^2.

        Raises
        ------
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        One more right-hand side of the filter, with the gains of the state. In form "auto", a state is recomputed in
        double-double arithmetic if the error estimate of the factor of M or of the product exceeds the tolerance.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd, tau = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 0.0, 0.0]
        >>> dtau, zero = [1.0, 0.0, -1.0], np.zeros(3)
        >>> product = scene.forward_dynamics_jvp(q, qd, tau, zero, zero, dtau)
        >>> np.allclose(product, scene.mass_matrix_inverse(q) @ dtau)
        True
        """

    def forward_dynamics_vjp(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        cotangent: ArrayLike,
        *,
        form: _Form = "auto",
        tolerance: float | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        parameters: bool = False,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> ForwardDynamicsGradients:
        """Gradients of cotangent . qdd, in O(N): cotangent dqdd_dq, cotangent dqdd_dqd and M^-1 cotangent.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        tau : (..., nv) array_like
            Joint torques, N m or N; those of a free joint are (force, moment).
        cotangent : (..., nv) array_like
            Gradient of a scalar function with respect to qdd.
        form : {"auto", "covariance", "square-root"}, default "auto"
            Form of the covariance P; see forward_dynamics.
        tolerance : float, optional
            As in forward_dynamics_derivatives.
        wrenches : dict of str to (..., 6) array_like, optional
            External forces by link name (links on fixed joints too): (moment, force) at the origin and in the frame of
            the link, N m and N.
        parameters : bool, default False
            If true, compute the gradients with respect to inertial parameters, armature and gravity too.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        gradients : ForwardDynamicsGradients
            Named tuple (q, qd, tau, wrenches, parameters, armature, gravity); what is not requested is None. The
            gradient with respect to q is in its tangent space, (..., nv).

        Raises
        ------
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        x = M^-1 cotangent is one more filter and smoother; the other gradients are those of inverse_dynamics_vjp at the
        accelerations of the state, with the cotangent -x.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd, tau, c = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 0.0, 0.0], [1.0, 2.0, 3.0]
        >>> gradients = scene.forward_dynamics_vjp(q, qd, tau, c)
        >>> np.allclose(gradients.q, c @ scene.forward_dynamics_derivatives(q, qd, tau).dqdd_dq)
        True
        """

    def inverse_dynamics_hvp(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        cotangent: ArrayLike,
        dq: ArrayLike,
        dqd: ArrayLike,
        dqdd: ArrayLike,
        *,
        wrenches: Mapping[str, ArrayLike] | None = None,
        inertias: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> InverseDynamicsGradients:
        """Hessian of cotangent . tau times a direction, in O(N): change of the gradients of inverse_dynamics_vjp.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (..., nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.
        cotangent : (..., nv) array_like
            Gradient of a scalar function with respect to tau.
        dq : (..., nv) array_like
            Change of q in its tangent space: the displacement that integrate(q, dq) applies.
        dqd : (..., nv) array_like
            Change of qd.
        dqdd : (..., nv) array_like
            Change of qdd.
        wrenches : dict of str to (..., 6) array_like, optional
            External forces by link name (links on fixed joints too): (moment, force) at the origin and in the frame of
            the link, N m and N.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        product : InverseDynamicsGradients
            Changes of the gradients with respect to q, qd and qdd, each (..., nv); the other fields are None.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        Evaluated on dual numbers, one state at a time. The gradient with respect to q is that in the tangent space of
        the moving q, so the Hessian of spherical and free joints is not symmetric.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd, qdd, c = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 1.0, 0.0], [1.0, 2.0, 3.0]
        >>> dq, zero = np.array([1.0, 0.0, -1.0]), np.zeros(3)
        >>> product = scene.inverse_dynamics_hvp(q, qd, qdd, c, dq, zero, zero)
        >>> ahead, behind = (scene.inverse_dynamics_vjp(q + h * dq, qd, qdd, c).q for h in (1e-6, -1e-6))
        >>> np.allclose(product.q, (ahead - behind) / 2e-6)
        True
        """

    def forward_dynamics_hvp(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        cotangent: ArrayLike,
        dq: ArrayLike,
        dqd: ArrayLike,
        dtau: ArrayLike,
        *,
        form: _Form = "auto",
        tolerance: float | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> ForwardDynamicsGradients:
        """Hessian of cotangent . qdd times a direction, in O(N): change of the gradients of forward_dynamics_vjp.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        tau : (..., nv) array_like
            Joint torques, N m or N; those of a free joint are (force, moment).
        cotangent : (..., nv) array_like
            Gradient of a scalar function with respect to qdd.
        dq : (..., nv) array_like
            Change of q in its tangent space: the displacement that integrate(q, dq) applies.
        dqd : (..., nv) array_like
            Change of qd.
        dtau : (..., nv) array_like
            Change of tau.
        form : {"auto", "covariance", "square-root"}, default "auto"
            Form of the covariance P; see forward_dynamics.
        tolerance : float, optional
            As in forward_dynamics_derivatives.
        wrenches : dict of str to (..., 6) array_like, optional
            External forces by link name (links on fixed joints too): (moment, force) at the origin and in the frame of
            the link, N m and N.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        product : ForwardDynamicsGradients
            Changes of the gradients with respect to q, qd and tau, each (..., nv); the other fields are None.

        Raises
        ------
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        One factor and four right-hand sides, then dual numbers; otherwise as inverse_dynamics_hvp. Includes the
        connections of the scene.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd, tau, c = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 0.0, 0.0], [1.0, 2.0, 3.0]
        >>> dtau, zero = [1.0, 0.0, -1.0], np.zeros(3)
        >>> product = scene.forward_dynamics_hvp(q, qd, tau, c, zero, zero, dtau)
        >>> np.allclose(product.tau, 0.0)     # qdd is linear in tau
        True
        """

    def coriolis_matrix(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Array | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Coriolis matrix C: C qd is the torque of the joint velocities, and dM/dt - 2 C is antisymmetric.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        out : ndarray, optional
            C-contiguous array of the shape and dtype of the result, without overlap with the arguments. It is returned.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        C : (..., nv, nv) ndarray
            Coriolis matrix, SI units; for joints with one axis that of the Christoffel symbols.

        Raises
        ------
        ArgumentError
            A scene of more than 4000 degrees of freedom, too many for dense matrices.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(N depth).

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2]
        >>> skew = scene.mass_matrix_derivative(q, qd) - 2 * scene.coriolis_matrix(q, qd)
        >>> np.allclose(skew, -skew.T)
        True
        """

    def mass_matrix_derivative(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        out: _Array | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Time derivative dM/dt of the mass matrix along the joint velocities: C + C^T with the Coriolis matrix C.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        out : ndarray, optional
            C-contiguous array of the shape and dtype of the result, without overlap with the arguments. It is returned.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        dM : (..., nv, nv) ndarray
            Derivative, SI units; exactly symmetric. The armature is constant and does not contribute.

        Raises
        ------
        ArgumentError
            A scene of more than 4000 degrees of freedom, too many for dense matrices.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(N depth).

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd = np.array([0.3, 0.2, 0.1]), np.array([1.0, 0.5, 0.2])
        >>> change = scene.mass_matrix(q + 1e-6 * qd) - scene.mass_matrix(q - 1e-6 * qd)
        >>> np.allclose(scene.mass_matrix_derivative(q, qd), change / 2e-6)
        True
        """

    def operational_inverse_inertia(
        self,
        q: ArrayLike,
        links: str | Iterable[str],
        *,
        at: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        form: _Form = "auto",
        tolerance: float | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Accelerations of links per wrench on links, J M^-1 J^T, in O(N): operational-space inverse inertia (5.6).

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        links : str or sequence of str
            Link name or m link names; links on the base and repeated names are allowed.
        at : (3,) or (m, 3) array_like, optional
            Origins of the task frames in the link frames, m; zero by default. The same for the whole batch.
        rotation : (3, 3) or (m, 3, 3) array_like, optional
            Axes of the task frames in the link frames; the identity by default. The same for the whole batch.
        form : {"auto", "covariance", "square-root"}, default "auto"
            Form of the covariance P; see forward_dynamics.
        tolerance : float, optional
            Largest accepted relative error in the forms "auto" and "square-root"; see forward_dynamics.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        inverse : (..., 6m, 6m) ndarray
            Change of the stacked (angular, linear) accelerations of the frames per wrench (moment, force) on them, each
            at the origin and in the axes of its frame; SI units, exactly symmetric, zero for links on the base.

        Raises
        ------
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        Defined in singular configurations too, unlike operational_inertia. With connections, M^-1 is
        loops.mass_matrix_inverse, and with joints that follow others J and M^-1 are those of the independent
        joints; both cost O(N^3). Contacts have no effect: the wrenches are the only ones on the links.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q = [0.3, 0.2, 0.1]
        >>> J = scene.jacobian(q, "link2")
        >>> np.allclose(scene.operational_inverse_inertia(q, "link2"), J @ scene.mass_matrix_inverse(q) @ J.T)
        True
        """

    def operational_inertia(
        self,
        q: ArrayLike,
        links: str | Iterable[str],
        *,
        at: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        directions: ArrayLike | None = None,
        form: _Form = "auto",
        tolerance: float | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Operational-space inertia (S J M^-1 J^T S^T)^-1 of the task directions S; see operational_inverse_inertia.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        links : str or sequence of str
            Link name or m link names.
        at : (3,) or (m, 3) array_like, optional
            Origins of the task frames in the link frames, m; zero by default. The same for the whole batch.
        rotation : (3, 3) or (m, 3, 3) array_like, optional
            Axes of the task frames in the link frames; the identity by default. The same for the whole batch.
        directions : (k, 6m) array_like, optional
            S: each row is a direction in the stacked (angular, linear) velocities of the frames; all 6m by default. The
            same for the whole batch.
        form : {"auto", "covariance", "square-root"}, default "auto"
            Form of the covariance P; see forward_dynamics.
        tolerance : float, optional
            Largest accepted relative error in the forms "auto" and "square-root"; see forward_dynamics.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        inertia : (..., k, k) ndarray
            Inertia, SI units; exactly symmetric and positive definite.

        Raises
        ------
        SingularTaskError
            The directions are not independent: an eigenvalue of the scaled inverse inertia is at most 64 k eps. .links,
            .rank, .directions and .state describe the task.
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Examples
        --------
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> linear = np.eye(6)[3:]     # the translations, in the link frame
        >>> inertia = scene.operational_inertia(scene.neutral(), "flange", directions=linear)
        >>> inertia.diagonal().round(1)
        array([ 4.3, 25.3, 39. ])
        """

    def without_constraints(self) -> Scene:
        """Create the scene of the same kinematic tree without the connections, for methods that support trees only.

        Returns
        -------
        scene : Scene
            The tree.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1").build()
        >>> scene.without_constraints().loops.names
        ()
        """

    @property
    def collider_names(self) -> tuple[str, ...]:
        """Names of the colliders in the order of their creation."""
    def distances(
        self,
        q: ArrayLike,
        *,
        pairs: tuple[str, str] | Collection[tuple[str, str]] | None = None,
        limit: float | None = None,
        errors: _Errors = "raise",
    ) -> Distances:
        """Signed distances of colliders, their nearest points, and the derivatives of the distances.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        pairs : (str, str) or sequence of (str, str), optional
            Names of two colliders, or of k pairs of them. None: all pairs that can touch.
        limit : float, optional
            Largest distance of interest, m. Pairs beyond it cost little: their distance is infinite, their points and
            normal are NaN, and their gradient is zero. None: no limit.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        distances : phipsi.Distances
            pairs, distance, first, second, normal and gradient, in the order of the pairs. The normal is a unit vector
            from the first collider to the second, in the base frame.

        Raises
        ------
        ArgumentError
            An unknown collider, a collider with itself, two colliders that are half spaces or height fields, or a limit
            that is not a number.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        The distance of colliders that overlap is minus the length of the least translation that separates them. A pair
        of named colliders need not be able to touch. O(N), and one search for nearest points per pair.

        Distances of half spaces, spheres, capsules, boxes and hulls are exact to 1e-8 of their size or better, and so
        are gradients where the distance is differentiable. Pairs with a cylinder are iterated: to about 1e-7 of their size, and to about
        1e-3 in the normal and the gradient.

        Examples
        --------
        >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
        >>> builder = builder.collider("ball", phipsi.shapes.Sphere(0.1), link="ball")
        >>> scene = builder.collider("ground", phipsi.shapes.HalfSpace()).build(floating_base=True)
        >>> found = scene.distances([0, 0, 0.3, 0, 0, 0, 1])
        >>> found.pairs, found.distance.round(3), found.gradient.round(3)
        ((('ball', 'ground'),), array([0.2]), array([[0., 0., 1., 0., 0., 0.]]))
        """
    def without_contacts(self) -> Scene:
        """Create the same scene without the contacts, for methods that do not support contacts.

        Returns
        -------
        scene : Scene
            The scene without contacts.

        Examples
        --------
        >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
        >>> scene = builder.contact("foot", "ball", friction=0.5).build(floating_base=True)
        >>> scene.without_contacts().contacts.names
        ()
        """

    def energy(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> Energy:
        """Kinetic energy qd^T M qd / 2, including armature, and potential energy.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        energy : Energy
            Named tuple (kinetic, potential), each (...), J. The potential energy is zero with the center of mass at the
            origin of the base frame.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(N). Springs are not included.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> energy = scene.energy([0.3, 0.2, 0.1], [1.0, 0.0, 0.0])
        >>> round(float(energy.kinetic), 3), round(float(energy.potential), 3)
        (0.123, 7.357)
        """

    def kinetic_energy(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array | np.float64:
        """Kinetic energy qd^T M qd / 2, including armature, in O(N).

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        kinetic : (...) ndarray
            Kinetic energy, J.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd = np.array([0.3, 0.2, 0.1]), np.array([1.0, 0.5, 0.2])
        >>> np.allclose(scene.kinetic_energy(q, qd), qd @ scene.mass_matrix(q) @ qd / 2)
        True
        """

    def potential_energy(
        self,
        q: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array | np.float64:
        """Potential energy of gravity of all moving links, in O(N): minus gravity times the first moment of mass.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        potential : (...) ndarray
            Potential energy, J; zero with the center of mass at the origin of the base frame.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        Its derivative along the tangent space of q is gravity_torque(q). Springs do not contribute.

        Examples
        --------
        >>> scene, q = phipsi.scenes.chain(3), [0.3, 0.2, 0.1]
        >>> weight = scene.total_mass * np.array(scene.gravity)
        >>> np.allclose(scene.potential_energy(q), -weight @ scene.center_of_mass(q))
        True
        """

    def momentum(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Spatial momentum of all moving links in the base frame: (angular about its origin, linear).

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        h : (..., 6) ndarray
            Momentum, N m s and N s; armature does not contribute.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2]
        >>> np.allclose(scene.momentum(q, qd)[3:], scene.total_mass * scene.center_of_mass_velocity(q, qd))
        True
        """

    def center_of_mass(self, q: ArrayLike, *, inertias: ArrayLike | None = None, errors: _Errors = "raise") -> _Array:
        """Center of mass of all moving links, in the base frame.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        c : (..., 3) ndarray
            Center of mass, m, from the origin of the base frame.

        Raises
        ------
        ArgumentError
            A scene whose moving links have no mass.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(N). Links fixed to the base are excluded.

        Examples
        --------
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> scene.center_of_mass(scene.neutral()).round(3)
        array([0.113, 0.147, 0.023])
        """

    def center_of_mass_velocity(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Velocity of the center of mass in the base frame: linear momentum divided by mass, in O(N).

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        v : (..., 3) ndarray
            Velocity, m/s.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2]
        >>> np.allclose(scene.center_of_mass_velocity(q, qd), scene.center_of_mass_jacobian(q) @ qd)
        True
        """

    def center_of_mass_acceleration(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Acceleration of the center of mass in the base frame for joint accelerations qdd, without gravity, in O(N).

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (..., nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        a : (..., 3) ndarray
            Acceleration, m/s^2. Multiplied by total_mass, it is the sum of the external forces, weight included.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, still = [0.3, 0.2, 0.1], np.zeros(3)
        >>> a = scene.center_of_mass_acceleration(q, still, [1.0, 0.0, 0.0])
        >>> np.allclose(a, scene.center_of_mass_jacobian(q)[:, 0])
        True
        """

    def center_of_mass_jacobian(
        self,
        q: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Jacobian J of the center of mass: its velocity in the base frame is J qd.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        J : (..., 3, nv) ndarray
            Jacobian, m or 1: the linear rows of centroidal_momentum_matrix divided by the mass.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(N).

        Examples
        --------
        >>> phipsi.scenes.chain(3).center_of_mass_jacobian([0.3, 0.2, 0.1]).shape
        (3, 3)
        """

    def centroidal_momentum_matrix(
        self,
        q: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Centroidal momentum matrix A: A qd is (angular momentum about the center of mass, linear), in base axes.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        A : (..., 6, nv) ndarray
            Matrix in SI units; angular rows first. Pinocchio's Ag has the linear rows first.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(N): column j is r S, with the composite inertia r (eq. 3.5) of the bodies outboard of joint j. Armature does
        not contribute.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> A = scene.centroidal_momentum_matrix([0.3, 0.2, 0.1])
        >>> np.allclose(A[3:] / scene.total_mass, scene.center_of_mass_jacobian([0.3, 0.2, 0.1]))
        True
        """

    def centroidal_momentum_matrix_rate(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Time derivative A' of the centroidal momentum matrix along qd: the momentum changes at A qdd + A' qd.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        dA : (..., 6, nv) ndarray
            Matrix in SI units, with the rows of centroidal_momentum_matrix.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(N). For a floating tree, A qdd + A' qd is the sum of weight and external forces, with moments about the center
        of mass.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd = np.array([0.3, 0.2, 0.1]), np.array([1.0, 0.5, 0.2])
        >>> ahead, behind = (scene.centroidal_momentum_matrix(q + h * qd) for h in (1e-6, -1e-6))
        >>> np.allclose(scene.centroidal_momentum_matrix_rate(q, qd), (ahead - behind) / 2e-6)
        True
        """

    def centroidal_momentum_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        *,
        inertias: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Derivatives of the centroidal momentum A qd with respect to q and qd; the second is A.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        dh : (..., 2, 6, nv) ndarray
            dh/dq and dh/dqd in SI units, with the rows of centroidal_momentum_matrix.

        Raises
        ------
        ArgumentError
            A scene whose moving links have no mass.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(N). Derivatives with respect to q are along its tangent space, as in velocity_derivatives.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd = np.array([0.3, 0.2, 0.1]), np.array([1.0, 0.5, 0.2])
        >>> by_q, by_qd = scene.centroidal_momentum_derivatives(q, qd)
        >>> step = 1e-6 * np.array([0.0, 1.0, 0.0])
        >>> ahead, behind = (scene.centroidal_momentum_matrix(q + h) @ qd for h in (step, -step))
        >>> np.allclose(by_q[:, 1], (ahead - behind) / 2e-6)
        True
        """

    def integrate(self, q: ArrayLike, v: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """Configuration that the constant joint velocity v reaches from q in unit time, on the manifold.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        v : (..., nv) array_like
            Displacement in the tangent space of q, rad or m.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        q : (..., nq) ndarray
            Joint positions, with quaternions of unit norm.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        A free joint moves along the screw motion of its twist, a spherical joint rotates about its angular velocity,
        and the coordinates of all other joints are added.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> scene.integrate([0.3, 0.2, 0.1], [0.1, 0.0, 0.0])
        array([0.4, 0.2, 0.1])
        """

    def difference(self, q0: ArrayLike, q1: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """Joint velocity that moves q0 to q1 in unit time, the inverse of integrate, on the manifold.

        Parameters
        ----------
        q0 : (..., nq) array_like
            Joint positions at the start, rad or m.
        q1 : (..., nq) array_like
            Joint positions at the end, rad or m.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        v : (..., nv) ndarray
            Displacement in the tangent space of q0, rad or m. Rotations take the shorter way.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> scene.difference([0.3, 0.2, 0.1], [0.5, 0.2, 0.1]).round(3)
        array([0.2, 0. , 0. ])
        """

    def lock(self, joints: Iterable[str], q: ArrayLike) -> Scene:
        """Create a scene in which joints are fixed at their coordinates in q; the names of links remain.

        Parameters
        ----------
        joints : iterable of str
            Names of movable joints. "root_joint" fixes a floating base.
        q : (nq,) array_like
            Joint positions, rad or m; only those of the locked joints matter.

        Returns
        -------
        scene : Scene
            The scene without these joints, whose bodies are merged: locked joints cost nothing.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3).lock(["j1"], [0.0, 0.5, 0.0])
        >>> scene.joint_names
        ('j0', 'j2')
        """

    def link(self, name: str, /) -> Link:
        """Properties of a link as it was given, including links on fixed joints.

        Parameters
        ----------
        name : str
            Name of the link.

        Returns
        -------
        link : Link
            Named tuple (name, mass, com, inertia, parent, joint).

        Raises
        ------
        ArgumentError
            An unknown name. The message lists the names that exist.

        Examples
        --------
        >>> phipsi.scenes.chain(3).link("link1").parent
        'link0'
        """

    def joint(self, name: str, /) -> Joint:
        """Properties of a joint as it was given, including fixed joints.

        Parameters
        ----------
        name : str
            Name of the joint.

        Returns
        -------
        joint : Joint
            Named tuple (name, type, parent, child, xyz, ...).

        Raises
        ------
        ArgumentError
            An unknown name. The message lists the names that exist.

        Examples
        --------
        >>> phipsi.scenes.chain(3).joint("j1").type
        'revolute'
        """

    @property
    def links(self) -> dict[str, Link]:
        """All links by name, in the order of link_names: a new dict of Link."""

    @property
    def joints(self) -> dict[str, Joint]:
        """All joints by name, including fixed ones, in the order they were given: a new dict of Joint."""

    def _connections(self) -> list[tuple[Any, ...]]: ...
    def _contacts(self) -> list[tuple[Any, ...]]: ...
    def _collisions(self) -> tuple[Any, ...]: ...
    def _touching(self) -> list[tuple[list[str], float, float, float]]: ...
    def _contact_points(self, q: ArrayLike) -> _Array: ...
    def to_builder(self) -> SceneBuilder:
        """Create a builder that has the links, joints, gravity, base and simplifications of the scene.

        Returns
        -------
        builder : SceneBuilder
            Its build() without arguments creates a scene with bit-identical results; parts can be added before.

        Examples
        --------
        >>> builder = phipsi.scenes.chain(3).to_builder().link("tool", mass=0.2)
        >>> builder.joint("flange", "fixed", "link2", "tool").build().total_mass
        3.2
        """

    def with_properties(
        self,
        *,
        armature: Mapping[str, ArrayLike] | ArrayLike | None = None,
        damping: Mapping[str, ArrayLike] | ArrayLike | None = None,
        friction: Mapping[str, ArrayLike] | ArrayLike | None = None,
        stiffness: Mapping[str, ArrayLike] | ArrayLike | None = None,
        friction_offset: Mapping[str, ArrayLike] | ArrayLike | None = None,
        stribeck: Mapping[str, ArrayLike] | ArrayLike | None = None,
        stribeck_speed: Mapping[str, ArrayLike] | ArrayLike | None = None,
        load_friction: Mapping[str, ArrayLike] | ArrayLike | None = None,
    ) -> Scene:
        """Create a scene with other joint properties; properties that are not given remain.

        Parameters
        ----------
        armature : dict of str to float, float or array_like, optional
            Armature, kg m^2 or kg: by joint name, one value for all movable joints (including "root_joint"), or an
            array: (nv,), or one value per joint in the order of joint_names. All degrees of freedom of a joint have one
            value.
        damping : dict of str to float, float or array_like, optional
            Viscous damping, N m s/rad or N s/m.
        friction : dict of str to float, float or array_like, optional
            Coulomb friction, N m or N.
        stiffness : dict of str to float, float or array_like, optional
            Stiffness of the springs, N m/rad or N/m.
        friction_offset, stribeck, stribeck_speed, load_friction : dict of str to float, float or array_like, optional
            Further terms of friction, as in SceneBuilder.joint.

        Returns
        -------
        scene : Scene
            The new scene.

        Raises
        ------
        ShapeError, ArgumentError
            An unknown or fixed joint, or a value that is negative or not finite. The message names the property.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3).with_properties(armature=0.01, damping={"j2": 0.5})
        >>> scene.armature, scene.damping
        (array([0.01, 0.01, 0.01]), array([0. , 0. , 0.5]))
        """

    def with_payload(
        self, link: str, mass: float, com: ArrayLike = (0, 0, 0), inertia: ArrayLike | None = None
    ) -> Scene:
        """Create a scene with a rigid body attached to a link, such as a tool or a gripped object.

        Parameters
        ----------
        link : str
            Name of the link. On a link of the base, the payload has no effect.
        mass : float
            Mass, kg.
        com : (3,) array_like, default (0, 0, 0)
            Center of mass of the body in the link frame, m.
        inertia : (3, 3) array_like, optional
            Inertia about that center of mass, with axes parallel to the link frame, kg m^2. None: a point mass.

        Returns
        -------
        scene : Scene
            The new scene.

        Raises
        ------
        ShapeError, ArgumentError
            An unknown link, a negative mass, or an invalid array.

        Warns
        -----
        InertiaWarning
            Link and body together have an inertia that no rigid body can have.

        Examples
        --------
        >>> phipsi.scenes.chain(3).with_payload("link2", 0.5, com=(0, 0, 0.3)).total_mass
        3.5
        """

    def rerooted(self, link: str, *, floating_base: bool | None = None) -> Scene:
        """Create the scene of the same robot with another link as its root.

        Parameters
        ----------
        link : str
            Name of the link.
        floating_base : bool, optional
            If true, the base moves freely. None: as in this scene.

        Returns
        -------
        scene : Scene
            The new scene.

        Raises
        ------
        ArgumentError
            An unknown link; a planar, universal or spherical joint between the two roots; a free joint with armature,
            losses or a spring; starts with velocities; connections, contacts and colliders of a fixed base.

        Notes
        -----
        The joints between the two roots carry the links on their other side, about the opposite axes: joint positions,
        velocities and torques, limits and losses are the same, but their order in q is that of the new tree. Each of
        these joints carries a massless link, named after the link and the joint. The free joint of a floating base
        carries the new root, also in starts and keyframes; without one, the frame of the base is that of the new root.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> scene.rerooted("link2").joint_names
        ('j2', 'j1', 'j0')
        """
    def subtree(self, link: str, *, floating_base: bool = False) -> Scene:
        """Create the scene of the part of the robot that a link carries, with this link as its root.

        Parameters
        ----------
        link : str
            Name of the link.
        floating_base : bool, default False
            If true, the base moves freely.

        Returns
        -------
        scene : Scene
            The new scene.

        Raises
        ------
        ArgumentError
            An unknown link; a connection or a mimic joint between this part and the rest.

        Notes
        -----
        Contacts, colliders, actuators and the start of these links and joints come with it.

        Examples
        --------
        >>> phipsi.scenes.chain(5).subtree("link1").joint_names
        ('j2', 'j3', 'j4')
        """

    def with_inertial_parameters(self, parameters: ArrayLike, /) -> Scene:
        """Create a scene with other inertial parameters of all bodies, such as those of one member of a population.

        Parameters
        ----------
        parameters : (bodies, 10) array_like
            In the order of inertial_parameters. Each link of body_names has the inertia of all links fixed to it, which
            become massless.

        Returns
        -------
        scene : Scene
            The new scene.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            A negative mass or moment of inertia, or an invalid array. The message names the link.

        Warns
        -----
        InertiaWarning
            An inertia that no rigid body can have.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> scene.with_inertial_parameters(2.0 * scene.inertial_parameters).total_mass
        6.0
        """

    def with_inertias(self, links: Mapping[str, tuple[float, ArrayLike, ArrayLike | None]]) -> Scene:
        """Create a scene in which links have other inertias, for instance identified or randomized ones.

        Parameters
        ----------
        links : dict of str to (mass, com, inertia)
            By link name: mass, kg; center of mass in the link frame, (3,), m; inertia about it with axes parallel to
            the link frame, (3, 3), kg m^2, or None for a point mass. All other links keep theirs.

        Returns
        -------
        scene : Scene
            The new scene.

        Raises
        ------
        ShapeError, ArgumentError
            An unknown link, a negative mass, or an invalid array. The message names the link.

        Warns
        -----
        InertiaWarning
            An inertia that no rigid body can have.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3).with_inertias({"link2": (2.0, (0, 0, 0.2), 0.01 * np.eye(3))})
        >>> scene.link("link2").mass
        2.0
        """
    def inverse_kinematics_rates(
        self,
        tasks: Task | Collection[Task],
        q: ArrayLike,
        *,
        dt: float,
        gain: float = 1.0,
        damping: float = 1e-6,
        limits: bool = True,
        velocity: ArrayLike | None = None,
        inertias: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Joint velocities that reduce the errors of tasks within joint limits: one step of a control loop.

        Parameters
        ----------
        tasks : task or list of tasks
            As in inverse_kinematics.
        q : (..., nq) array_like
            Joint positions, rad or m.
        dt : float
            Time for which the velocities are held, s.
        gain : float, default 1
            Share of the errors that is removed in dt; below 1, errors decay exponentially.
        damping : float, default 1e-6
            Damping of each joint relative to its diagonal entry of J^T J over the variances, or to a thousandth of the
            largest entry; more keeps velocities small near singularities.
        limits : bool, default True
            If true, joints, and joints coupled to them, stay within their limits. A joint outside of its limits
            returns as fast as its velocity limit allows.
        velocity : float or (..., nv) array_like, optional
            Velocity limits instead of those of the joints, rad/s or m/s; inf: none. A floating base has limits only
            here.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        qd : (..., nv) ndarray
            Joint velocities, rad/s or m/s.

        Raises
        ------
        ArgumentError
            dt, gain or damping that is not positive, and as inverse_kinematics.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        Minimizes half the squares of J qd dt + gain e divided by the standard deviations, plus damping, over the
        velocities that limits and connections allow, by a projected Newton method. Connections are hard constraints
        whose errors are removed as far as the limits allow. If the step would increase the cost or pass its minimum, it
        is recomputed with more damping, so joints come to rest if a target is out of reach. O(tasks depth + nv^3).

        Examples
        --------
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> q, task = np.array([0.3, -0.6, 0.9, 0.1, 0.4, 0.0]), phipsi.tasks.Position("flange", (0.5, 0.1, 0.4))
        >>> for step in range(200):
        ...     q += 0.01 * scene.inverse_kinematics_rates(task, q, dt=0.01, gain=0.2)
        >>> scene.placement(q, "flange")[:3, 3].round(3)
        array([0.5, 0.1, 0.4])
        """

    @overload
    def inverse_kinematics(
        self,
        tasks: Task | Collection[Task],
        q0: ArrayLike | None = None,
        *,
        follow: bool = False,
        starts: int | None = None,
        posture: float | None = None,
        limits: bool = True,
        tolerance: float = 1e-9,
        iterations: int = 100,
        metric: Literal["coordinates", "mass"] = "coordinates",
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        covariance: Literal[True],
        seed: int = 0,
        errors: _Errors = "raise",
    ) -> _InverseKinematicsWithCovariance:
        """Most probable joint positions that reach tasks, within joint limits and with closed connections.

        Parameters
        ----------
        tasks : task or list of tasks
            Tasks of phipsi.tasks: Pose, Position, Orientation, Direction, LookAt, CenterOfMass, JointPosition, Distance.
            Leading axes of their targets are a batch, which broadcasts with that of q0.
        q0 : (..., nq) array_like, optional
            First start; the neutral configuration by default. A start outside of the limits begins at them.
        follow : bool, default False
            If true, the last batch axis of the targets is a path, (..., k, 4, 4) for Pose, and each search starts from
            the solution before, the first from q0, which has one configuration per path. Solutions of neighboring
            targets are then near each other, and a target that no start reaches has the local minimum next to the
            solution before. Axes before that of the path are a batch of paths.
        starts : int, optional
            Largest number of starts; None: 100, or 20 with a posture, and with follow 3 after a target that was not
            reached, until one is reached. Those after the first are drawn within the
            limits, of several draws the one nearest to the tasks. The search ends early when the tasks are reached, or
            when 40 starts have found the same least minimum, because the target is then probably out of reach.
        posture : float, optional
            Standard deviation of the joints from q0, rad or m, for robots with more freedom than the tasks; with follow
            from the solution before. None: no posture.
        limits : bool, default True
            If true, joints, and joints coupled to them, stay within their limits.
        tolerance : float, default 1e-9
            A task is reached if its error is at most this, m and rad.
        iterations : int, default 100
            Largest number of steps from each start.
        metric : {"coordinates", "mass"}, default "coordinates"
            Metric of the damping: coordinates, or kinetic energy, so that joints that carry more mass move less.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        covariance : bool, default False
            If true, compute the covariance of q.
        seed : int, default 0
            Seed of the starts.
        errors : {"raise", "nan"}, default "raise"
            As in forward_dynamics. An invalid state has NaN for q and errors, and reached False.

        Returns
        -------
        solution : phipsi.tasks.InverseKinematics
            q, reached, position_error, rotation_error, starts, iterations and covariance. If reached is False, q is the
            best local minimum.

        Raises
        ------
        ConstraintError
            No start leads to closed connections.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Warns
        -----
        UnitsWarning
            A target position is 20 times as far as the robot reaches, as one in millimeters is.

        Notes
        -----
        Minimizes half the sum of all squared errors divided by their variances, by Levenberg-Marquardt steps on the
        manifold, each the exact minimum of its model within the limits; no step increases the cost. Connections are
        hard constraints. O(tasks depth + nv^3) per step. Results are bit-identical for any number of threads.

        Examples
        --------
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> goal = scene.placement([0.3, -0.6, 0.9, 0.1, 0.4, 0.0], "flange")
        >>> found = scene.inverse_kinematics(phipsi.tasks.Pose("flange", goal))
        >>> found.reached, np.allclose(scene.placement(found.q, "flange"), goal)
        (True, True)
        """
    @overload
    def inverse_kinematics(
        self,
        tasks: Task | Collection[Task],
        q0: ArrayLike | None = None,
        *,
        follow: bool = False,
        starts: int | None = None,
        posture: float | None = None,
        limits: bool = True,
        tolerance: float = 1e-9,
        iterations: int = 100,
        metric: Literal["coordinates", "mass"] = "coordinates",
        covariance: bool = False,
        seed: int = 0,
        errors: _Errors = "raise",
    ) -> InverseKinematics: ...
    def regressor(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, *, errors: _Errors = "raise") -> NDArray[np.float64]:
        """Joint torque regressor Y: inverse_dynamics(q, qd, qdd) = Y parameters + armature qdd.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (..., nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        regressor : (..., nv, bodies, 10) ndarray
            Entry (i, b, p) is the derivative of torque i with respect to parameter p of the link body_names[b] and the
            links fixed to it. The parameters are (m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) in the frame of
            the link, moments of inertia about its origin, as in Identification.parameters; kg, kg m and kg m^2.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(N depth). The entries of links that are not outboard of the joint are zero. As in inverse_dynamics, the forces
        of connections and contacts are not part of the torques. With joints that follow others, (q, qd, qdd) and the
        rows are those of the independent joints; body_names includes the links of the joints that follow.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> scene.regressor([0.1, 0.2, 0.3], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]).shape
        (3, 3, 10)
        """

    @overload
    def forward_dynamics_variance(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        *,
        parameters: ArrayLike | object | None = None,
        joints: Mapping[str, ArrayLike] | ArrayLike | None = None,
        torque: ArrayLike | None = None,
        links: None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        friction_speed: float = 0.01,
        errors: _Errors = "raise",
    ) -> _Array:
        """Variances of the joint accelerations for uncertain inertial parameters, joint parameters and torques, O(N).

        At the true acceleration an error of the parameters pi is a force on the bodies: M d(qdd) = dtau - H phi Y
        d(pi), with Y the regressor at the qdd that forward dynamics gives. The variances are those of a filter and
        smoother whose gains were made for another noise. First order in the errors. With connections or joints that
        follow others, A Y Sigma Y* A* by dense matrices, O(N^3), with A the inverse mass matrix through the connections
        (loops.mass_matrix_inverse) or of the independent joints. Contacts are ignored: their forces depend on the
        motion before.

        Parameters
        ----------
        q : (..., nq)
            Configurations. Leading axes broadcast.
        qd, tau : (..., nv)
            Joint velocities, rad/s or m/s, and torques, N m or N.
        parameters : (bodies, 10, 10), (10 bodies, 10 bodies), or an Identification, optional
            Covariance of (m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) of each link of body_names, I about the
            link's origin, in the link's frame. Bodies are independent of each other, or correlated in a full matrix (10
            bodies, 10 bodies), which costs one right side of the filter per column of its root. Any object with
            `.covariance` of one of these shapes stands for it. Default: the parameters are known.
        joints : dict or (nv, 4, 4), optional
            Variances of "armature", "damping", "friction" and "offset" by name, a number or (nv,) each, or the
            covariance of the four of each degree of freedom; not for those that `parameters` has.
        torque : (nv,) or float, optional
            Variance of the torque, (N m)^2 or N^2.
        links : str or sequence of str, optional
            Links whose accelerations are wanted too.
        wrenches : dict, optional
            As in forward_dynamics; they are known.
        inertias, armature : array_like, optional
            Model of each state, as in forward_dynamics.
        friction_speed : float
            Speed below which friction is viscous, as in identify.
        errors : str
            As in forward_dynamics.

        Returns
        -------
        array (..., nv), or AccelerationVariance
            Variances of the joint accelerations, (rad/s^2)^2 or (m/s^2)^2. With links an AccelerationVariance(joints,
            links): links is a dict from names to the covariance (..., 6, 6) of the (angular, linear) acceleration of
            the link's origin in the link's frame.

        Raises
        ------
        ArgumentError
            A covariance that is not symmetric or has a negative eigenvalue, a negative variance, an unknown name.
        SingularJointError, ShapeError, NotFiniteError
            As in forward_dynamics.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(3)
        >>> parameters = np.zeros((3, 10, 10))
        >>> parameters[2, 0, 0] = 0.01  # the mass of the last link, to 0.1 kg
        >>> variance = scene.forward_dynamics_variance([0.3, 0.2, 0.1], [0.0] * 3, [1.0, 0.0, 0.0], parameters=parameters, torque=0.01)
        >>> variance.shape, bool((variance > 0).all())
        ((3,), True)
        """
    @overload
    def forward_dynamics_variance(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        *,
        links: str | Collection[str],
        parameters: ArrayLike | object | None = None,
        joints: Mapping[str, ArrayLike] | ArrayLike | None = None,
        torque: ArrayLike | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        friction_speed: float = 0.01,
        errors: _Errors = "raise",
    ) -> AccelerationVariance: ...
    def inverse_dynamics_variance(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        *,
        parameters: ArrayLike | object | None = None,
        joints: Mapping[str, ArrayLike] | ArrayLike | None = None,
        torque: ArrayLike | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        friction_speed: float = 0.01,
        errors: _Errors = "raise",
    ) -> _Array:
        """Variances of the joint torques of inverse dynamics for uncertain parameters, in O(N).

        C is the covariance of the force that a body's parameter errors are, Y Sigma Y*. Torques are linear in the
        parameters: nothing is approximate. With connections or joints that follow others, by dense matrices, O(N^2).

        Parameters
        ----------
        q : (..., nq)
            Configurations. Leading axes broadcast.
        qd, qdd : (..., nv)
            Joint velocities, rad/s or m/s, and accelerations.
        parameters, joints, torque
            As in forward_dynamics_variance; torque: the variance of what is added to the torque, of a sensor's noise
            for instance.
        inertias, armature : array_like, optional
            Model of each state, as in inverse_dynamics. Variances are the same for all models, because torques are
            linear in the parameters.
        friction_speed, errors
            As in forward_dynamics_variance.

        Returns
        -------
        array (..., nv)
            Variances of the torques, (N m)^2 or N^2.

        Raises
        ------
        ArgumentError, ShapeError, NotFiniteError
            As forward_dynamics_variance; connections are no obstacle, since their forces are not part of these torques.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(3)
        >>> parameters = np.zeros((3, 10, 10))
        >>> parameters[:, 0, 0] = 0.01
        >>> variance = scene.inverse_dynamics_variance([0.3, 0.2, 0.1], [0.0] * 3, [1.0, 0.0, 0.0], parameters=parameters)
        >>> variance.shape
        (3,)
        """
    def momentum_observer(
        self,
        dt: float,
        *,
        torque_noise: ArrayLike,
        bandwidth: float,
        false_alarms_per_hour: float = 1.0,
        parameters: ArrayLike | object | None = None,
        load: tuple[str, ArrayLike] | None = None,
        velocity_noise: ArrayLike = 0.0,
        correlation_time: ArrayLike = 0.0,
        stiction: ArrayLike = 0.0,
        rest_speed: ArrayLike = 0.01,
    ) -> MomentumObserver:
        """Momentum observer of external joint torques that raises alarms at a stated rate.

        With connections, whose forces are unknown, external torques are observed as far as they act on motions that the
        connections allow. Contacts of the scene are ignored, because their forces are external ones.

        Parameters
        ----------
        dt : float
            Time between two steps, s.
        torque_noise : float or (nv,) array_like
            Density of the torque noise of each degree of freedom, (N m)^2 s, positive: the variance of its mean over a
            time T, times T. It includes friction that is not modeled.
        bandwidth : float
            Bandwidth K of the estimate, 1/s. A lower bandwidth detects smaller torques, with a longer delay.
        false_alarms_per_hour : float, default 1
            Number of alarms per hour without any contact.
        parameters : array_like or Identification, optional
            Covariance of the parameters, as in forward_dynamics_variance. With the parameters of joints of an
            Identification, `tau` given to the observer is without their friction. None: the parameters are exact.
        load : (str, (3,) array_like), optional
            Link and point in the link frame, m, of a load to detect. The alarm then tests its mass alone, which
            detects a load earlier than the test of all external torques.
        velocity_noise : float or (nv,) array_like, default 0
            Standard deviation of independent errors of each qd, rad/s or m/s.
        correlation_time : float or (nv,) array_like, default 0
            Correlation time T of the torque noise, s; zero for white noise. Its variance is torque_noise/(2 T).
        stiction : float or (nv,) array_like, default 0
            Largest torque of dry friction that holds a joint at rest and is not part of tau, N m or N. The alarm tests
            the part of the torque that friction of at most this size cannot explain.
        rest_speed : float or (nv,) array_like, default 0.01
            Joint velocity up to which a joint is at rest, rad/s or m/s.

        Returns
        -------
        observer : phipsi.estimation.MomentumObserver
            The observer; see its `step`.

        Raises
        ------
        ArgumentError
            A noise, bandwidth, step or rate that is not positive; a load that no joint moves; velocity noise, correlated
            noise or stiction with connections.
        ShapeError
            An array of an invalid shape.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> observer = scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=10.0)
        >>> torque, alarm = observer.step([0.3, 0.2, 0.1], [0.0] * 3, scene.gravity_torque([0.3, 0.2, 0.1]))
        >>> torque.shape, bool(alarm)
        ((3,), False)
        """
    def observer(
        self,
        dt: float,
        sensors: Collection[Sensor],
        *,
        q: ArrayLike,
        qd: ArrayLike | None = None,
        torque_noise: ArrayLike,
        wrenches: Collection[ExternalWrench] = (),
        initial: ArrayLike = (0.1, 0.1),
        history: int = 1000,
    ) -> Observer:
        """Create an observer of joint motion, external wrenches and sensor biases from any sensors: a Kalman filter.

        Connections are measurements without noise: the estimate satisfies them, and so does its error, to first order.
        Contacts of the scene are ignored, because their forces are external ones: estimate them as wrenches, or give
        Contact sensors. With joints that follow others, states and errors are those of the independent joints.

        Parameters
        ----------
        dt : float
            Time between two steps, s.
        sensors : collection of phipsi.estimation.Sensor
            Encoder, Gyro, Accelerometer, TorqueSensor and Contact objects with different names.
        q : (..., nq) array_like
            Initial joint positions, rad or m. Leading axes are robots that are observed together.
        qd : (..., nv) array_like, optional
            Initial joint velocities, rad/s or m/s; zero by default.
        torque_noise : float or (nv,) array_like
            Density of the torque noise, (N m)^2 s. It includes friction that is not modeled. Zero for degrees of
            freedom without torque, such as a free joint.
        wrenches : collection of phipsi.estimation.ExternalWrench, optional
            External wrenches to estimate.
        initial : (float, float) or (2 nv,) array_like, optional
            Initial standard deviations of q in its tangent space and of qd: two values, or one per component.
        history : int, default 1000
            Number of past steps that `smooth` covers.

        Returns
        -------
        observer : phipsi.estimation.Observer
            The observer; see its `step` and `smooth`.

        Raises
        ------
        ArgumentError
            An invalid argument, an unknown link or joint, two sensors with the same name.
        ConstraintError
            Initial positions or velocities that violate the connections; see loops.project.
        ShapeError, NotFiniteError
            An invalid array. The message names the argument.

        Examples
        --------
        >>> from phipsi.estimation import Encoder
        >>> scene = phipsi.scenes.chain(3)
        >>> observer = scene.observer(1e-3, [Encoder(noise=1e-4)], q=[0.3, 0.2, 0.1], torque_noise=0.01)
        >>> estimate = observer.step(scene.gravity_torque([0.3, 0.2, 0.1]), {"encoder": [0.3, 0.2, 0.1]})
        >>> estimate.q.shape, estimate.covariance.shape
        ((3,), (6, 6))
        """
    def _variance(
        self,
        forward: bool,
        state: tuple[ArrayLike, ArrayLike, ArrayLike],
        roots: _Array,
        torque: _Array,
        joints: _Array | None,
        friction_speed: float,
        links: list[str] | None,
        wrenches: Any,
        inertias: Any,
        armature: Any,
        errors: str,
    ) -> _Array: ...
    def _sensor_prediction(
        self, given: tuple[Any, ...], state: list[_Array], tau: _Array
    ) -> tuple[list[_Array], list[bool]]: ...
    def optimize(
        self,
        q0: ArrayLike,
        qd0: ArrayLike | None = None,
        *,
        dt: float,
        steps: int,
        costs: _Term | Iterable[_Term],
        tau: ArrayLike | None = None,
        start: MotionPlan | tuple[ArrayLike, ...] | None = None,
        effort: bool | ArrayLike | None = True,
        limits: bool = True,
        iterations: int = 100,
        tolerance: float = 1e-6,
        limit_tolerance: float = 1e-6,
        friction_speed: float = 0.2,
        smoothing: float = 0.0,
        uncertainty: MotionUncertainty | ArrayLike | object | None = None,
    ) -> MotionPlan:
        """Motion of least cost with its feedback law: iterative LQR with limits of effort and other inequalities.

        Parameters
        ----------
        q0 : (nq,) array_like
            Initial configuration.
        qd0 : (nv,) array_like, optional
            Initial joint velocities; None: at rest.
        dt : float
            Time step, s.
        steps : int
            Number of steps.
        costs : term or list of terms
            Terms of phipsi.control (State, Effort, EffortRate, Function) and tasks of phipsi.tasks: half the squares of
            errors divided by their standard deviations, times dt, at the knots before each step. Terminal(term) acts at
            the end and is not multiplied by dt, During(term, first, last) at some knots. A leading axis of the target
            of a task is that of its knots. NotPositive(function) is an inequality instead of a cost.
        tau : (nv,) or (steps, nv) array_like, optional
            First joint torques; None: those that hold q0 against gravity.
        start : MotionPlan or tuple of array_like, optional
            First q (steps, nq) and qd (steps, nv) of the knots after q0, which the torques need not lead to (multiple
            shooting), as from MotionPlan.shift; None: the motion of the first torques.
        effort : bool or array_like, default True
            Limits of the torques: True: those of the joints; None: no limits; numbers, (nv,) or (2, nv) with smallest and
            largest torques. A joint with the limit 0 has no control, nor has a floating base.
        limits : bool, default True
            If true, positions and speeds stay within the limits of the joints, at the knots after the start.
        iterations : int, default 100
            Largest number of iterations; 0: only the feedback law about the start.
        tolerance : float, default 1e-6
            The search ends when the model has a decrease of at most this share of the cost.
        limit_tolerance : float, default 1e-6
            Largest violation of an inequality, in its unit.
        friction_speed : float, default 0.2
            Speed below which friction is viscous, rad/s or m/s; smaller values are nearer to dry friction and need more
            iterations.
        smoothing : float, default 0
            Length by which contacts are relaxed, m, as in Scene.simulate, so that a search finds contacts that the first
            motion does not have; 0: contacts do not act.
        uncertainty : phipsi.estimation.MotionUncertainty or covariance, optional
            Uncertainty of the start, the parameters and the torques, as of MotionPlan.expected: the plan has the least
            expected cost under its law, instead of the least cost of the motion. None: no uncertainty.

        Returns
        -------
        plan : phipsi.control.MotionPlan
            q, qd, tau, gains, cost, converged, reason and history, with policy, shift, resume, show and save.

        Raises
        ------
        ArgumentError
            Friction curves, and friction of joints that others follow; terms and limits that do not fit; smoothing with
            connections, with joints that follow others, and with contacts that rebound.
        ConstraintError
            A start that violates the connections.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Warns
        -----
        PlanWarning
            A contact or two shapes that touch along the plan, which is made without contacts: points that stay in contact
            are connections, and smoothing lets contacts act. Connections that the steps of the plan leave by more than 1 mm.

        Notes
        -----
        A step is v' = v + dt a, q' = integrate(q, dt v'), that of simulate(method="implicit-euler"): springs, damping and
        friction act at its end (those of joints that others follow at its start, as of simulate with
        "semi-implicit-euler"), and accelerations satisfy the connections. With limits=False joints pass their stops.

        With smoothing, v' is the velocity after a step of simulate(smoothing=...) with method="contact", and its derivatives
        are adjoints of that step, one for each joint velocity.

        The Riccati recursion of the linear-quadratic model about the motion is the Kalman filter of the dynamics, run
        from the end of the time to its start; the second derivatives are those of Gauss and Newton. Stages in which it
        cancels are computed again in array form. Step lengths are tried in lanes. O(steps nv^3) per iteration. Inequalities
        are an augmented Lagrangian. Results have the same bits on any number of threads.

        With an uncertainty, the plan of least cost is moved along the gradient of the expected cost, of which the change
        of the law is a part, until it has no further decrease: each change is a search.

        Examples
        --------
        >>> from phipsi import control
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> goal = control.Terminal(phipsi.tasks.Position("link6", (0.5, 0.1, 0.4)))
        >>> plan = scene.optimize([0.1] * 6, dt=0.02, steps=50, costs=[control.Effort(10.0), goal])
        >>> plan.converged, bool(abs(scene.placement(plan.q[-1], "link6")[:3, 3] - [0.5, 0.1, 0.4]).max() < 1e-3)
        (True, True)
        """
    def identify(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        tau: ArrayLike,
        *,
        fit: Collection[
            Literal[
                "armature", "damping", "friction", "offset", "stribeck", "load", "friction_asymmetry", "damping_asymmetry",
                "joint_damping", "joint_friction",
            ]
        ] = (),
        noise: ArrayLike | None = None,
        trust: float | Mapping[str, float] | ArrayLike = 1.0,
        keep: Collection[str] = (),
        friction_speed: float = 0.01,
        stribeck_speed: float = 0.1,
        time: ArrayLike | None = None,
        transmission: ArrayLike | None = None,
        tau_delay: float = 0.0,
        acceleration_noise: ArrayLike | None = None,
        instruments: tuple[ArrayLike, ArrayLike, ArrayLike] | None = None,
        blocks: int = 20,
        total_mass: tuple[float, float] | None = None,
        outliers: float | None = None,
    ) -> Identification:
        """Most probable inertial and joint parameters from measured motion and torques, with confidence intervals.

        Parameters
        ----------
        q : (k, nq) array_like
            Joint positions of k measured states in the order of time, rad or m.
        qd : (k, nv) array_like
            Joint velocities, rad/s or m/s, for instance of phipsi.smooth.
        qdd : (k, nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.
        tau : (k, nv) array_like
            Measured joint torques, N m or N; NaN: not measured. With `transmission`: motor torques, (k, motors).
        fit : collection of str, optional
            Joint parameters to identify too: "armature", "damping", "friction", "offset", "stribeck" (friction that
            decreases with speed) and "load" (friction proportional to the joint torque), and "friction_asymmetry" and
            "damping_asymmetry", half of the difference of "friction" and "damping" between positive and negative
            velocities. With `transmission` these are parameters of motors, and "joint_damping" and "joint_friction" are
            parameters of joints, if no motor moves them alone. Other parameters keep the values of the scene.
        noise : float or (nv,) array_like, optional
            Standard deviation of the torques, N m or N. None: estimated from the residuals of least squares, which
            needs at least twice as many measured torques as parameters.
        trust : float, dict of float or (bodies,) array_like, default 1
            Weight of the parameters of the scene: each parameter is expected within about 1 / sqrt(trust) of them,
            relatively. It does not apply to joint parameters that the scene lacks. A dict has the weights of links of
            body_names, an array those of all, from 1e-6 to 1e9; other links and parameters of joints then have 1.
        keep : collection of str, optional
            Names in body_names whose inertias remain.
        friction_speed : float, default 0.01
            Speed of a joint below which friction is viscous, rad/s or m/s. For a motor it is multiplied by the norm of
            its row of `transmission`.
        stribeck_speed : float, default 0.1
            Speed of a joint at which the friction of "stribeck" has decreased to 1/e, rad/s or m/s; of a motor likewise.
        time : (k,) array_like, optional
            Times of the rows, s, increasing. With times, gaps, repeated times, inconsistent units and a delay of up to
            1 s between the clocks of q and tau are detected, and the delay has a standard deviation.
        transmission : (motors, nv) array_like, optional
            Matrix B of motor velocities = B qd, with motors = nv: joint torques are B^T times motor torques. Armature,
            damping, friction, offsets and noise then are those of the motors.
        tau_delay : float, default 0
            Delay of the torques relative to q, s. They are shifted by linear interpolation; requires `time`.
        acceleration_noise : (nv,) array_like, optional
            Standard deviation of the noise in qdd, as phipsi.smooth(...).acceleration_noise, for the prediction of the
            bias that it causes.
        instruments : tuple of (q, qd, qdd), optional
            Commanded trajectory, used as instrumental variables. They remove the bias caused by noise in the measured
            motion.
        blocks : int, default 20
            Number of time blocks of the jackknife. Neighboring blocks are merged, down to eight blocks, if their
            residuals are correlated or if they have fewer than two torques per parameter.
        total_mass : (float, float), optional
            Mass of all links of body_names together and its standard deviation, kg, for instance of scales.
        outliers : float, optional
            Number of standard deviations beyond which a torque is not used, at least 2, for instance 5. The standard
            deviation is a robust one, of the median of the absolute residuals, and identification and rejection
            alternate. None: all torques are used. Not for scenes with connections.

        Returns
        -------
        identification : Identification
            The new scene, parameters, intervals, base parameters, residuals, and for each parameter the share that the
            data determine.

        Raises
        ------
        ArgumentError
            Too few measurements, unknown names, decreasing times, noise below the rounding of the torques, bodies of
            the scene without mass.
        ShapeError, NotFiniteError
            Invalid arrays.

        Warns
        -----
        LogWarning
            Inconsistent units or clocks, gaps, repeated times; torques of another unit or sign than the model's, of
            exchanged joints or without gravity; accelerations by differences; friction or armature that is not fitted;
            torques that no bodies of positive mass explain. Each names the joint, the numbers found and expected, and
            the fix.
        IdentificationWarning
            A predicted bias above 0.2 standard deviations; parameters that a scene does not have, such as asymmetric
            friction and friction at rest below zero.
        InertiaWarning
            A body of the scene whose inertia no rigid body can have. The iteration starts from the nearest one that
            can.

        Notes
        -----
        Maximum a posteriori with a Wishart prior on the second moments of mass of each body: convex, and every body
        receives an inertia that a rigid body can have. With connections, whose forces are unknown, the measured torques
        enter as far as they act on motions that the connections allow: the torque of a joint without motor is 0, a state
        with a torque that was not measured is omitted, and `noise` is one number. With joints that follow others, q, qd,
        qdd and tau are those of the independent joints. Contacts are ignored: give torques of a robot that touches
        nothing. Intervals come from the delete-one-block jackknife, which is
        valid for correlated residuals. The memory does not grow with k. phipsi.estimation.Accumulator reads logs that
        do not fit into memory.

        Examples
        --------
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM).with_properties(damping=0.0, friction=0.0)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 6))
        >>> tau = scene.with_payload("link6", 1.0).inverse_dynamics(q, qd, qdd)
        >>> found = scene.identify(q, qd, qdd, tau, noise=0.01)
        >>> bool((found.after < 1e-3).all())     # N m
        True
        """

    def excitation(
        self,
        duration: float,
        *,
        limits: Limits | None = None,
        harmonics: int = 5,
        fit: Collection[Literal["armature", "damping", "friction", "offset", "stribeck", "load"]] = (),
        noise: ArrayLike | None = None,
        rate: float = 100.0,
        iterations: int = 300,
        seed: int = 0,
    ) -> Excitation:
        """Periodic joint trajectory within limits that excites the parameters: a D-optimal Fourier series.

        Parameters
        ----------
        duration : float
            Length of the trajectory, one period, s.
        limits : Limits, optional
            Limits of positions, velocities, accelerations, jerk and torques, of which the trajectory uses 90 %. None:
            those of the scene. A position without a limit stays within 1 rad or 0.2 m of its neutral value.
        harmonics : int, default 5
            Number of frequencies of the series, multiples of 1 / duration.
        fit : collection of str, optional
            Joint parameters to identify too, as in identify.
        noise : float or (nv,) array_like, optional
            Standard deviation of the torques, N m or N, for the information that the search maximizes and for the
            predicted standard deviations. None: 1 % of the limit of effort; without a limit, of the largest torque of
            the first random motion.
        rate : float, default 100
            Samples per second.
        iterations : int, default 300
            Number of steps of the search.
        seed : int, default 0
            Seed of its random steps.

        Returns
        -------
        excitation : Excitation
            Times, q, qd, qdd, the torques of the scene, the predicted standard deviations of the base parameters, and
            the noise.

        Raises
        ------
        ArgumentError
            A scene with joints of several axes, or limits that no trajectory meets.

        Notes
        -----
        Bayesian D-optimality: the log-determinant of the information of the whole trajectory about the base parameters,
        with rows divided by `noise`, plus the information of the prior of `identify`. The motion is as large as the
        limits allow. Bodies without mass and joint parameters that the scene lacks have no prior.

        Examples
        --------
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> found = scene.excitation(4.0, iterations=5, rate=25.0)
        >>> found.q.shape
        (100, 6)
        """

    def plan(self) -> Plan:
        """Simplifications of this scene: which computations are skipped, why, and how many operations that saves.

        Returns
        -------
        plan : Plan
            Its items are Simplification objects; printed, it is a list.

        Examples
        --------
        >>> plan = phipsi.scenes.chain(3).plan()
        >>> plan.bodies, plan.links
        (3, 4)
        """

    @overload
    def estimate(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        *,
        noise: ArrayLike = 0.0,
        measured: Iterable[str] | ArrayLike | None = None,
        prior_acceleration: ArrayLike | None = None,
        acceleration_variance: float = 1.0,
        wrenches: Mapping[str, ArrayLike] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        covariance: Literal[True],
        method: Literal["sequential", "batch"] = "sequential",
        errors: _Errors = "raise",
    ) -> _EstimateWithCovariance:
        """Forces, accelerations and torques from noisy measurements of joint torques, in O(N) (2.1, 2.7).

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        tau : (..., nv) array_like
            Measured joint torques, N m or N. Entries that a masked array masks are not measured.
        noise : float or (..., nv) array_like, default 0
            Variance of each measurement, (N m)^2 or N^2; 0: exact, inf: not measured.
        measured : iterable of str or (nv,) array_like of bool, optional
            Names of the measured joints, or a mask; tau and noise of the others are not read. None: all joints.
        prior_acceleration : (..., nv) array_like, optional
            Prior mean a0 of the joint accelerations, zero by default.
        acceleration_variance : float, default 1
            s: prior variance of the acceleration of 1 kg m^2, (rad/s^2)^2, and of 1 kg, (m/s^2)^2.
        wrenches : dict of str to (..., 6) array_like, optional
            External forces by link name (links on fixed joints too): (moment, force) at the origin and in the frame of
            the link, N m and N.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        covariance : bool, default False
            If true, compute the covariances of the errors too.
        method : {"sequential", "batch"}, default "sequential"
            Filter and smoother, or the dense equations of section 2 as a check: O(N^3), at most 300 degrees of freedom.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        estimate : Estimate
            Named tuple with the means of acceleration, torque, force and process, the log likelihood, and the
            covariances.

        Raises
        ------
        SingularJointError
            A measured joint without inertia along its axis; with covariance, any joint.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        Model: W ~ N(b + Q phi* H* a0, s Q), so the prior of the accelerations is N(a0, s M^-1). A joint that is not
        measured keeps its mean a0, as if it were locked there, and its variance; its torque follows. If all joints are
        measured without noise, the result is forward dynamics. Variances are accurate to eps times those of the prior
        (docs/estimation.md).

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd, tau = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.1, 0.0, 0.0]
        >>> estimate = scene.estimate(q, qd, tau)
        >>> np.allclose(estimate.acceleration, scene.forward_dynamics(q, qd, tau))
        True
        >>> scene.estimate(q, qd, tau, measured=["j0"], covariance=True).acceleration_variance.shape
        (3,)
        """
    @overload
    def estimate(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        *,
        noise: ArrayLike = 0.0,
        measured: Iterable[str] | ArrayLike | None = None,
        prior_acceleration: ArrayLike | None = None,
        acceleration_variance: float = 1.0,
        wrenches: Mapping[str, ArrayLike] | None = None,
        covariance: bool = False,
        method: Literal["sequential", "batch"] = "sequential",
        errors: _Errors = "raise",
    ) -> Estimate: ...

    def factor(self, q: ArrayLike, *, form: _Form = "auto", tolerance: float | None = None) -> Factor:
        """Factorize the mass matrix at q, to solve and multiply with it, and for the operators of the paper (3.1, 3.6).

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        form : {"auto", "covariance", "square-root"}, default "auto"
            Form of the covariance P; see forward_dynamics.
        tolerance : float, optional
            Largest accepted relative error in the forms "auto" and "square-root"; see forward_dynamics.

        Returns
        -------
        factor : Factor
            solve(tau) and mul(a) are O(N); its operators compose as the equations of the paper do. Batched if q is.

        Raises
        ------
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> factor = scene.factor([0.3, 0.2, 0.1])
        >>> np.allclose(factor.mul(factor.solve([1.0, 2.0, 3.0])), [1.0, 2.0, 3.0])
        True
        """

    def random_model(
        self, q: ArrayLike, qd: ArrayLike | None = None, *, acceleration_variance: float = 1.0
    ) -> RandomModel:
        """Create a model with random forces on bodies at q, to sample joint torques (1.1 to 1.6).

        Parameters
        ----------
        q : (nq,) array_like
            Joint positions, rad or m.
        qd : (nv,) array_like, optional
            Joint velocities, rad/s or m/s: the mean force is the bias force b(k), including gravity. None: the mean is
            zero.
        acceleration_variance : float, default 1
            s: variance of the acceleration of 1 kg m^2, (rad/s^2)^2. It scales all covariances.

        Returns
        -------
        model : RandomModel
            The model.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid array, a variance that is not positive, or an inertia that no rigid body can have, with its link.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> model = scene.random_model([0.3, 0.2, 0.1])
        >>> np.allclose(model.mass_matrix(method="sigma-points").mass_matrix, scene.mass_matrix([0.3, 0.2, 0.1]))
        True
        """

    def check(self, q: ArrayLike) -> dict[str, float]:
        """Relative residuals of the identities of the paper at q, by name.

        Parameters
        ----------
        q : (nq,) array_like
            Joint positions, rad or m.

        Returns
        -------
        residuals : dict of str to float
            Name of the identity and its relative residual: rounding is a few eps times nv, or times the condition
            number of M if an inverse is involved.

        Raises
        ------
        ArgumentError
            A scene of more than 300 degrees of freedom, or an invalid q.
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        Factorization against faer's LDLT, operators against their definitions, closed forms against each other, and the
        dynamics at a fixed velocity and torque.

        Examples
        --------
        >>> max(phipsi.scenes.chain(3).check([0.3, 0.2, 0.1]).values()) < 1e-12
        True
        """

    def to_c(
        self,
        directory: str | os.PathLike[str] | None = None,
        *,
        name: str = "robot",
        functions: Iterable[_Function] | None = None,
        dtype: Literal["float64", "float32"] = "float64",
        batches: bool = False,
        tolerance: float | None = None,
    ) -> dict[str, str]:
        """Generate C99 code for the dynamics of this robot, which depends on libm only.

        Parameters
        ----------
        directory : str or os.PathLike, optional
            Directory to write the files to; it is created if necessary. None: no files.
        name : str, default "robot"
            Prefix of files and functions, a C identifier.
        functions : str, or iterable of str or tuple, optional
            "forward_dynamics", "inverse_dynamics", "bias_torque", "mass_matrix", "mass_matrix_inverse",
            "forward_dynamics_derivatives", "inverse_dynamics_derivatives", "forward_dynamics_jvp",
            "forward_dynamics_vjp", "inverse_dynamics_jvp", "inverse_dynamics_vjp" and "placements"; with connections
            also "constrained_dynamics", but no derivatives and products of forward dynamics; with contacts also
            "contact_gaps", "contact_velocities" and, without connections and mimic joints, "contact_gram". The names of
            functions that have a form, except "contact_gram", followed by "_watched" also return a margin per state,
            negative if precision may be lost; "factor_watched" is the margin of the factor of M alone. Functions of one
            link are ("placement", link), ("jacobian", link) and ("jacobian", link, frame). None: all without a margin
            that are not of one link.
        dtype : {"float64", "float32"}, default "float64"
            Scalar type of the code.
        batches : bool, default False
            If true, add functions for batches, such as NAME_forward_dynamics_batch(count, ...), vectorized over
            states with the vector extensions of GCC and Clang.
        tolerance : float, optional
            Error to which the margins refer, as in forward_dynamics; infinity: the margins of functions with
            connections do not include an error estimate.

        Returns
        -------
        files : dict of str to str
            File names and contents: NAME.c, NAME.h, test_NAME.c and a Makefile.

        Raises
        ------
        ArgumentError
            An invalid name, unknown functions or links, links with equal names in C, functions without code for the
            connections, contacts or mimic joints of the scene, and chains of more than 300 joints for the inverse mass
            matrix and the forward derivatives.
        OSError
            Files that cannot be written.

        Notes
        -----
        Each function, for instance NAME_forward_dynamics(q, qd, tau, qdd), is a sequence of operations for one state
        without allocations: constants are folded, and operations that this robot does not need are omitted. Several
        results are consecutive arguments: NAME_forward_dynamics_derivatives(q, qd, tau, dqdd_dq, dqdd_dqd, Minv).
        Functions of one link contain its name, as NAME_jacobian_tool0_world(q, jacobian), with _ for characters that C
        does not allow. The order of q and qd is that of the scene. Results equal those of form "covariance" to
        rounding, without an error estimate. Wrenches and changed parameters are not supported. `make test` in the
        directory compares the code with the scene at one state.

        With connections, forward_dynamics and constrained_dynamics (whose fourth argument is the compliance of each
        row, zero for rigid rows) factor the rows in a fixed order. Only the functions with a margin report states for
        which this is not valid, because rows depend on each other or the state violates the connections.

        Examples
        --------
        >>> files = phipsi.scenes.chain(3).to_c(name="arm", functions=["forward_dynamics"])
        >>> sorted(files)
        ['Makefile', 'arm.c', 'arm.h', 'test_arm.c']
        """

    def to_rust(
        self,
        directory: str | os.PathLike[str] | None = None,
        *,
        name: str = "robot",
        functions: Iterable[_Function] | None = None,
    ) -> dict[str, str]:
        """Generate a Rust crate for the dynamics of this robot, which depends on `core` only.

        Parameters
        ----------
        directory : str or os.PathLike, optional
            Directory to write the files to; it is created if necessary. None: no files.
        name : str, default "robot"
            Name of the crate.
        functions : iterable of str or tuple, optional
            As in to_c.

        Returns
        -------
        files : dict of str to str
            File names and contents: Cargo.toml, src/lib.rs, src/dynamics.rs, src/lanes.rs, src/numbers.rs,
            tests/reference.rs.

        Raises
        ------
        ArgumentError
            An invalid name, and as to_c.
        OSError
            Files that cannot be written.

        Notes
        -----
        Each function, for instance forward_dynamics(&q, &qd, &tau) -> [T; NV], is a sequence of operations in safe code
        without allocations, for any type with the trait Number of src/dynamics.rs: f64 and f32 (feature "std", enabled
        by default), Lanes<T, N> of src/lanes.rs for N states at once, or your own type. Functions such as
        forward_dynamics_batch take slices of states. Results equal those of form "covariance" to rounding, without an
        error estimate. `cargo test` compares the crate with the scene at one state.

        Examples
        --------
        >>> files = phipsi.scenes.chain(3).to_rust(functions=["mass_matrix"])
        >>> "pub fn mass_matrix" in files["src/dynamics.rs"]
        True
        """

    def to_cuda(
        self,
        directory: str | os.PathLike[str] | None = None,
        *,
        name: str = "robot",
        functions: Iterable[_Function] | None = None,
        dtype: Literal["float64", "float32"] = "float64",
    ) -> dict[str, str]:
        """Generate CUDA kernels for the dynamics of this robot.

        Parameters
        ----------
        directory : str or os.PathLike, optional
            Directory to write the files to; it is created if necessary. None: no files.
        name : str, default "robot"
            Prefix of files and kernels.
        functions : iterable of str or tuple, optional
            As in to_c.
        dtype : {"float64", "float32"}, default "float64"
            Scalar type of the code.

        Returns
        -------
        files : dict of str to str
            File names and contents: NAME.cu, one_thread.h, test_NAME.cu and a Makefile.

        Raises
        ------
        ArgumentError
            An invalid name, and as to_c.
        OSError
            Files that cannot be written.

        Notes
        -----
        Each kernel, for instance extern "C" NAME_forward_dynamics(count, q, qd, tau, qdd) with an unsigned long long
        count, computes one state per thread. Entry i of the q of state s is q[i * count + s]. NAME.cu has no includes:
        NVRTC compiles it at run time (phipsi.compile(device="cuda")), or nvcc does. Results equal those of form
        "covariance" to rounding, without an error estimate. `make test` compares the kernels with the scene at one
        state on a GPU; `make test-c` does so with the C compiler.

        Examples
        --------
        >>> files = phipsi.scenes.chain(3).to_cuda(functions=["forward_dynamics"])
        >>> "robot.cu" in files
        True
        """

    def to_urdf(self, path: str | os.PathLike[str] | None = None, *, name: str = "robot") -> str:
        """Write the scene as URDF, which from_urdf reads back to the same numbers, apart from the rounding of angles.

        Parameters
        ----------
        path : str or os.PathLike, optional
            File to write. None: no file.
        name : str, default "robot"
            Name of the robot.

        Returns
        -------
        text : str
            The URDF.

        Raises
        ------
        ArgumentError
            Parts that URDF cannot represent: connections, contacts, screw and universal joints, springs of joints with
            several coordinates, losses of a floating base. The message names the part.

        Notes
        -----
        The free joint of a floating base is not written: read the file with floating_base=True. The start and the
        keyframes are not written, with a ModelWarning. Armature, stiffness and rest are attributes of <dynamics>, which
        other programs ignore. Shapes are copied from the URDF of the scene if it still exists; those of a MuJoCo model are
        written as <visual>, without meshes and ellipsoids, and other colliders of links as <collision>, without hulls,
        height fields and colliders of the base, with a ModelWarning. A revolute joint without limits is written as
        continuous.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3)
        >>> copy = phipsi.Scene.from_urdf(scene.to_urdf())
        >>> copy.joint_names == scene.joint_names
        True
        """

    def random_configuration(
        self, seed: int | np.random.Generator | None = None, *, size: int | tuple[int, ...] = ()
    ) -> _Array:
        """Draw random configurations: joint positions uniformly within the limits, orientations uniformly.

        Parameters
        ----------
        seed : int or numpy.random.Generator, optional
            Seed or generator; None: fresh entropy.
        size : int or tuple of int, default ()
            Batch axes.

        Returns
        -------
        q : (*size, nq) ndarray
            Configurations. Without limits, or with a limit beyond 20 rad or m, an angle is drawn from (-pi, pi) and a
            length from (-1, 1) m. Coupled joints and connections are not considered; see loops.project.

        Raises
        ------
        ArgumentError
            Any other seed or size.

        Examples
        --------
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> q = scene.random_configuration(7, size=100)
        >>> bool(np.all((scene.limits.lower <= q) & (q <= scene.limits.upper)))
        True
        """

    @overload
    def show(
        self,
        motion: Trajectory | ArrayLike | None = None,
        *,
        t: ArrayLike | None = None,
        forces: tuple[ArrayLike, ArrayLike] | None = None,
        urdf: str | os.PathLike[str] | None = None,
        to: None = None,
        port: int = 0,
        host: str = "127.0.0.1",
        title: str | None = None,
        browser: bool | None = None,
        collision: bool = False,
    ) -> Viewer:
        """Show a configuration or a motion of the robot in a browser; needs the extra phipsi[view].

        Parameters
        ----------
        motion : (nq,) or (k, nq) array_like, or Trajectory, optional
            A configuration, configurations at the times t, or a trajectory of one state. None: the start,
            initial().
        t : (k,) array_like, optional
            Times of the configurations, s.
        forces : tuple of two (k, n, 3) array_like, optional
            (at, force): arrows at points in the base frame, m and N, drawn to scale. None: those of the contacts or
            connections of a Trajectory, if known.
        urdf : str or os.PathLike, optional
            File whose meshes are drawn. None: that of the scene. Links without a shape are drawn as capsules of their
            inertia.
        to : str or os.PathLike, optional
            File for a self-contained page (.html) or a picture (.png; .webp, animated for a motion). Nothing is served
            then.
        port : int, default 0
            Port of the server; 0 selects a free one.
        host : str, default "127.0.0.1"
            Address of the server. "0.0.0.0" makes the viewer accessible from other machines.
        title : str, optional
            Title of the page and of the panel. None: the name of the robot.
        browser : bool, optional
            True: open a browser with a server. None: that at a prompt; in a notebook, the viewer is displayed below the
            cell; in a script, a temporary self-contained page opens, which outlives the script, and its address is
            printed.
        collision : bool, default False
            True: the colliders are drawn instead of the shapes of the links.

        Returns
        -------
        viewer : phipsi.view.Viewer or pathlib.Path
            update(q) moves the robot, wait() serves it until Ctrl-C, close() ends it. With `to`, the path of the page.

        Raises
        ------
        ImportError
            The extra `view` is not installed.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Warns
        -----
        MeshWarning
            A mesh that is not found.

        Examples
        --------
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> viewer = scene.show(scene.neutral(), browser=False)
        >>> viewer.close()
        """

    @overload
    def show(
        self,
        motion: Trajectory | ArrayLike | None = None,
        *,
        to: str | os.PathLike[str],
        t: ArrayLike | None = None,
        forces: tuple[ArrayLike, ArrayLike] | None = None,
        urdf: str | os.PathLike[str] | None = None,
        port: int = 0,
        host: str = "127.0.0.1",
        title: str | None = None,
        browser: bool | None = None,
        collision: bool = False,
    ) -> Path: ...
    def __copy__(self) -> Scene: ...
    def __deepcopy__(self, memo: Any, /) -> Scene: ...
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]: ...

    @property
    def loops(self) -> Loops:
        """The connections of a scene, which close kinematic loops and couple joints."""

    @property
    def contacts(self) -> Contacts:
        """The contacts of a scene that have names: points and spheres on planes, spheres and boxes."""

@final
class Loops:
    """The connections of a scene, which close kinematic loops and couple joints."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the connections in the order of their creation: the keys of the forces of dynamics."""

    @property
    def tolerance(self) -> float:
        """Geometric tolerance of linkages, an angle in rad or a relative length; see SceneBuilder.build."""

    def rows(self, connection: str, /) -> slice[int, int, int]:
        """Slice of the rows of a connection in error, bias and jacobian.

        Parameters
        ----------
        connection : str
            Name of the connection.

        Returns
        -------
        slice
            Position of the rows.

        Raises
        ------
        ArgumentError
            An unknown name. The message lists the names that exist.

        Examples
        --------
        >>> builder = phipsi.scenes.chain(3).to_builder().connect("pin", "point", "link2")
        >>> builder.couple("gear", "j2", "j1").build().loops.rows("gear")
        slice(3, 4, 1)
        """

    def error(self, q: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """Constraint error of each row of the connections; zero if the connections are closed.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        error : (..., m) ndarray
            Errors, rad or m; rows has the rows of each connection, angular rows first.

        Raises
        ------
        ConstraintError
            A rod of length zero.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        Origins: m, in the axes of the first frame. Rotations: 2 sin(t/2) about the axis, with the angle t. Direction of
        an axis: the two components across it. Distance: current length minus `length`. Coupling: coordinate minus its
        nominal value.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1").build()
        >>> scene.loops.error([0.0, 0.1, 0.3]).round(3)
        array([0.2])
        """

    def jacobian(self, q: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """Constraint Jacobian J of the connections: J qd is the time derivative of error, at every q.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        J : (..., m, nv) ndarray
            Jacobian, SI units.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(m depth) operations.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1").build()
        >>> scene.loops.jacobian([0.0, 0.1, 0.3])
        array([[ 0., -1.,  1.]])
        """

    def bias(self, q: ArrayLike, qd: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """Constraint bias J' qd: the second time derivative of error at zero joint accelerations.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        bias : (..., m) ndarray
            Acceleration of each row, rad/s^2 or m/s^2.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(N + m depth) operations.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3).to_builder().connect("pin", "point", "link2").build()
        >>> q, qd = np.array([0.3, 0.2, 0.1]), np.array([1.0, 0.5, 0.2])
        >>> ahead, behind = (scene.loops.jacobian(q + h * qd) @ qd for h in (1e-6, -1e-6))
        >>> np.allclose(scene.loops.bias(q, qd), (ahead - behind) / 2e-6)
        True
        """

    def dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        *,
        compliance: ArrayLike | None = None,
        form: _Form = "auto",
        tolerance: float | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> ConstrainedDynamics:
        """Joint accelerations and constraint forces with connections: M qdd + bias = tau + J^T f, J qdd + J' qd = 0.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        tau : (..., nv) array_like
            Joint torques, N m or N; those of a free joint are (force, moment).
        compliance : float or (..., m) array_like, optional
            Compliance of each row of the connections in the order of loops.rows, (m/s^2)/N or (rad/s^2)/(N m), not
            negative. None: the connections are rigid.
        form : {"auto", "covariance", "square-root"}, default "auto"
            Form of the covariance P; see forward_dynamics.
        tolerance : float, optional
            Largest accepted relative error in the forms "auto" and "square-root"; see forward_dynamics.
        wrenches : dict of str to (..., 6) array_like, optional
            External forces by link name (links on fixed joints too): (moment, force) at the origin and in the frame of
            the link, N m and N.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        dynamics : ConstrainedDynamics
            Named tuple: qdd (..., nv); forces, a dict from connection names to (..., rows); rank (...) and residual
            (...).

        Raises
        ------
        ConstraintError
            No forces satisfy all rows (contradicting connections), or positions or velocities violate the connections
            by more than 1e-3 (m or rad; relative to the fastest joint velocity above 1) without compliance. Attributes:
            .connections, .residual and .state. project closes the connections.
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(N + m^2 depth + m^3) for m rows: unit forces along the rows run inward through the filter of the tree, and
        their Gram matrix is J M^-1 J^T. With compliance, the rows are measurements with that noise, J qdd + J' qd =
        -compliance f: contradicting rows compromise, and dependent rows share their force.

        A force acts from the connection on `link`, (moment, force) in the rows that it has, at the origin and in the
        axes of its first frame; the other link receives the opposite. The force of a rod is positive in compression;
        that of a coupling acts along its joint. If rows are dependent, qdd is unique and the forces have the least sum
        (J M^-1 J^T)_ii f_i^2.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1").build()
        >>> dynamics = scene.loops.dynamics([0.0, 0.1, 0.1], np.zeros(3), [0.0, 0.1, 0.0])
        >>> np.allclose(dynamics.qdd[1], dynamics.qdd[2]), dynamics.forces["gear"].shape
        (True, (1,))
        """

    def project(
        self,
        q: ArrayLike,
        qd: ArrayLike | None = None,
        *,
        compliance: ArrayLike | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> Projection:
        """Nearest configuration that closes the connections, and nearest joint velocities that keep them closed.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like, optional
            Joint velocities, rad/s or m/s.
        compliance : float or (..., m) array_like, optional
            Compliance of each row of the connections in the order of loops.rows, (m/s^2)/N or (rad/s^2)/(N m), not
            negative. None: the connections are rigid.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        projection : Projection
            Named tuple: q; qd, or None; rank (...), the number of independent rows, lower in a singular configuration.

        Raises
        ------
        ConstraintError
            An error remains: no small displacement closes the connections. Attributes: .connections, .residual and
            .state.
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Warns
        -----
        LinkageWarning
            Once per scene: rows count as dependent that are not dependent within rounding, or axes of a loop are nearly
            parallel.

        Notes
        -----
        Newton steps -M^-1 J^T (J M^-1 J^T)^+ error, each of least kinetic energy and at most 0.5 rad or m per joint;
        velocities minus M^-1 J^T (J M^-1 J^T)^+ J qd, as by an inelastic impact. With compliance, the result minimizes
        half the squared distance from q in the kinetic-energy metric plus the sum of error^2 / (2 compliance).

        Combinations of rows that move joints by less than tolerance count as dependent if the rank of the
        intended linkage is lower by as many: a linkage drawn with few digits keeps its mobility. Their errors remain,
        at most 10 times the tolerance; error has them.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1").build()
        >>> closed = scene.loops.project([0.0, 0.1, 0.3])
        >>> np.allclose(scene.loops.error(closed.q), 0.0)
        True
        """

    def inverse_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        *,
        actuated: Iterable[str] | ArrayLike | None = None,
        form: _Form = "auto",
        tolerance: float | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> ConstrainedInverseDynamics:
        """Joint torques and constraint forces for given joint accelerations: tau + J^T f = M qdd + bias.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (..., nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.
        actuated : iterable of str or (nv,) array_like of bool, optional
            Names of the actuated joints, or a mask; the torque of all others is zero. None: all joints.
        form : {"auto", "covariance", "square-root"}, default "auto"
            Form of the covariance P; see forward_dynamics.
        tolerance : float, optional
            Largest accepted relative error in the forms "auto" and "square-root"; see forward_dynamics.
        wrenches : dict of str to (..., 6) array_like, optional
            External forces by link name (links on fixed joints too): (moment, force) at the origin and in the frame of
            the link, N m and N.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        dynamics : ConstrainedInverseDynamics
            Named tuple: tau (..., nv); forces and rank as in dynamics; residual (...), the largest entry of
            J qdd + J' qd, which is not rounding if no torques cause these accelerations.

        Raises
        ------
        ArgumentError
            A joint outside of `actuated` needs a torque, or an invalid argument.
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        If there is a choice, tau minimizes tau^T M^-1 tau: torques that do not load the connections.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1").build()
        >>> q, qd, qdd = [0.0, 0.1, 0.1], np.zeros(3), np.ones(3)
        >>> dynamics = scene.loops.inverse_dynamics(q, qd, qdd, actuated=["j0", "j1"])
        >>> float(dynamics.tau[2])
        0.0
        """

    def mass_matrix_inverse(
        self,
        q: ArrayLike,
        *,
        form: _Form = "auto",
        tolerance: float | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Inverse mass matrix through the connections: M^-1 - M^-1 J^T (J M^-1 J^T)^+ J M^-1.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        form : {"auto", "covariance", "square-root"}, default "auto"
            Form of the covariance P; see forward_dynamics.
        tolerance : float, optional
            Largest accepted relative error in the forms "auto" and "square-root"; see forward_dynamics.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        inverse : (..., nv, nv) ndarray
            Change of the joint accelerations per joint torque, SI units; symmetric, of rank nv minus that of J.

        Raises
        ------
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        ArgumentError
            A scene of more than 4000 degrees of freedom, too many for dense matrices.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(nv^3), as a Gram matrix without a subtraction: no eigenvalue is negative beyond rounding.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1").build()
        >>> inverse = scene.loops.mass_matrix_inverse([0.0, 0.1, 0.1])
        >>> np.allclose(scene.loops.jacobian([0.0, 0.1, 0.1]) @ inverse, 0.0)
        True
        """

    def __reduce__(self) -> tuple[Any, ...]: ...

@final
class Contacts:
    """The contacts of a scene that have names: points and spheres on planes, spheres and boxes."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the contacts in the order of their creation, that of gaps and of Trajectory.contacts."""

    def gaps(self, q: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """Distance of each contact from its surface; negative below the surface.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        gaps : (..., contacts) ndarray
            Distance, m, in the order of names.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(depth) per contact.

        Examples
        --------
        >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
        >>> scene = builder.contact("foot", "ball", friction=0.5, radius=0.1).build(floating_base=True)
        >>> scene.contacts.gaps([[0, 0, 0.3, 0, 0, 0, 1], [0, 0, 0.05, 0, 0, 0, 1]]).round(3)
        array([[ 0.2 ],
               [-0.05]])
        """

    def velocities(self, q: ArrayLike, qd: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """Velocity of each contact relative to its surface, at the point of the link nearest to it, in the base frame.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        v : (..., contacts, 3) ndarray
            Velocity, m/s, in the order of names.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        O(depth) per contact.

        Examples
        --------
        >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
        >>> scene = builder.contact("foot", "ball", friction=0.5, radius=0.1).build(floating_base=True)
        >>> scene.contacts.velocities([0, 0, 0.1, 0, 0, 0, 1], [1, 0, 0, 0, 0, 0])
        array([[1., 0., 0.]])
        """

    def gram(
        self,
        q: ArrayLike,
        *,
        form: _Form = "auto",
        tolerance: float | None = None,
        inertias: ArrayLike | None = None,
        armature: ArrayLike | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """J M^-1 J^T of the points of all contacts: their velocities, in the base frame, due to unit impulses on them.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        form : {"auto", "covariance", "square-root"}, default "auto"
            Form of the covariance P; see forward_dynamics.
        tolerance : float, optional
            Largest accepted relative error in the forms "auto" and "square-root"; see forward_dynamics.
        inertias : (..., bodies, 10) array_like, optional
            Inertial parameters of each state instead of those of the scene, in the order of Scene.inertial_parameters: a
            model per state.
        armature : (..., nv) array_like or float, optional
            Armature of each state instead of that of the scene, kg m^2 or kg.
        errors : {"raise", "nan"}, default "raise"
            "nan": the results of invalid states are NaN, and one BadStateWarning lists them; see forward_dynamics.

        Returns
        -------
        gram : (..., contacts, 3, contacts, 3) ndarray
            Velocity of contact i along axis a of the base frame due to a unit impulse on contact j along axis b, 1/kg,
            in the order of names. Symmetric.

        Raises
        ------
        SingularJointError
            A joint without inertia along its axis: its pivot D(k) is lost in rounding.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Notes
        -----
        J qd are those of velocities. All contacts are included, open ones too. The factor of M and one right-hand side
        per row, O(m N + m^2 nv) for m rows. With connections M^-1 is loops.mass_matrix_inverse, with mimic joints that
        of the independent joints; then, and for contacts with other links, spheres or boxes, O(nv^2 (nv + m)).

        Examples
        --------
        >>> builder = phipsi.SceneBuilder().link("ball", mass=2.0, inertia=0.004 * np.eye(3))
        >>> scene = builder.contact("foot", "ball", friction=0.5, radius=0.1).build(floating_base=True)
        >>> scene.contacts.gram([0, 0, 0.1, 0, 0, 0, 1])[0, :, 0, :].round(3)
        array([[3. , 0. , 0. ],
               [0. , 3. , 0. ],
               [0. , 0. , 0.5]])
        """

    def __reduce__(self) -> tuple[Any, ...]: ...

@final
class SceneBuilder:
    """Builder of a Scene: collects links, joints, connections and contacts by name; build() checks them.

    Every method that adds a part returns the builder, so calls can be chained. Builders can be pickled and copied;
    a copy is independent.

    Examples
    --------
    >>> import phipsi
    >>> builder = phipsi.SceneBuilder().link("base").link("rod", mass=1.0, com=(0, 0, -0.5))
    >>> scene = builder.joint("hinge", "revolute", "base", "rod", axis=(0, 1, 0)).build()
    >>> scene.mass_matrix([0.0])
    array([[0.25]])
    """

    def __new__(cls) -> SceneBuilder: ...
    def link(
        self,
        name: str,
        mass: float = 0.0,
        com: ArrayLike | None = None,
        inertia: ArrayLike | None = None,
        *,
        shape: Shape | Sequence[Shape] | None = None,
        collide: bool = False,
        friction: float = 1.0,
    ) -> SceneBuilder:
        """Add a link.

        Parameters
        ----------
        name : str
            Name of the link.
        mass : float, default 0
            Mass, kg. A link without mass and inertia is a frame.
        com : (3,) array_like, optional
            Center of mass in the link frame, m. None: the center of the shapes if the inertia is theirs, otherwise
            (0, 0, 0).
        inertia : (3, 3) array_like, optional
            Inertia about the center of mass, with axes parallel to the link frame, kg m^2. None: that of a uniform body
            of these shapes about its center; without shapes a point mass.
        shape : phipsi.shapes.Box, Sphere, Cylinder, Capsule or Mesh, or a sequence of them, optional
            Shapes with which `show` draws the link. Volumes of several shapes are added, also where they overlap.
        collide : bool, default False
            True: the shapes are colliders as well, as those of collider(). Their names are that of the link, followed by
            "/0", "/1", ... if there are several.
        friction : float, default 1
            Coefficient of Coulomb friction of these colliders.

        Returns
        -------
        builder : SceneBuilder
            The same builder.

        Raises
        ------
        ShapeError, ArgumentError
            Invalid com, inertia or shape. The message names the link; build() checks the rest.

        Warns
        -----
        InertiaWarning
            The inertia is that of the shapes, and com is not their center: the uniform body is moved to com. Or a shape
            is a Mesh, and the link is a point mass.

        Examples
        --------
        >>> builder = phipsi.SceneBuilder().link("base")
        >>> builder = builder.link("ball", mass=2.0, shape=phipsi.shapes.Sphere(0.1))
        >>> builder.joint("free", "floating", "base", "ball").build().total_mass
        2.0
        """

    def joint(
        self,
        name: str,
        type: _JointType,
        parent: str,
        child: str,
        *,
        xyz: ArrayLike = (0, 0, 0),
        rpy: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        axis: ArrayLike = (0, 0, 1),
        pitch: float | None = None,
        armature: float = 0.0,
        damping: float = 0.0,
        friction: float = 0.0,
        friction_offset: float = 0.0,
        stribeck: float = 0.0,
        stribeck_speed: float = 0.1,
        load_friction: float = 0.0,
        stiffness: float = 0.0,
        rest: ArrayLike | None = None,
        lower: float | None = None,
        upper: float | None = None,
        velocity: float | None = None,
        effort: float | None = None,
        acceleration: float | None = None,
        deceleration: float | None = None,
        jerk: float | None = None,
        mimic: str | None = None,
        mimic_multiplier: float = 1.0,
        mimic_offset: float = 0.0,
    ) -> SceneBuilder:
        """Add a joint. The links that it names may be added later.

        Parameters
        ----------
        name : str
            Name of the joint.
        type : str
            "fixed", "revolute", "continuous", "prismatic", "screw", "planar", "universal", "spherical" or "floating".
        parent : str
            Name of the parent link.
        child : str
            Name of the child link.
        xyz : (3,) array_like, default (0, 0, 0)
            Origin of the child frame at zero configuration, in the parent frame, m.
        rpy : (3,) array_like, optional
            Orientation of the child frame at zero configuration, rad: R = Rz(yaw) Ry(pitch) Rx(roll).
        rotation : (3, 3) array_like, optional
            The same as a matrix, instead of rpy.
        axis : (3,) array_like, or "x", "y", "z", "-x", "-y" or "-z", default (0, 0, 1)
            Axis in the child frame, of any length.
        pitch : float, optional
            Pitch of a screw joint, m/rad.
        armature : float, default 0
            Rotor inertia of each degree of freedom, kg m^2 or kg, part of the mass matrix.
        damping : float, default 0
            Viscous damping, N m s/rad or N s/m, in simulations.
        friction : float, default 0
            Coulomb friction, N m or N, in simulations.
        friction_offset : float, default 0
            Half of the difference between friction in the positive and in the negative direction, N m or N.
        stribeck : float, default 0
            Excess of friction at rest over Coulomb friction, N m or N, which decreases by
            exp(-(qd / stribeck_speed)^2).
        stribeck_speed : float, default 0.1
            Speed at which that part has decreased to 1/e, rad/s or m/s.
        load_friction : float, default 0
            Friction per torque that the joint transmits, below 1.
        stiffness : float, default 0
            Stiffness of the spring, N m/rad or N/m, in simulations.
        rest : float or array_like, optional
            Coordinates of the joint where the spring is at rest. None: the neutral ones.
        lower : float, optional
            Lower position limit, rad or m: a stop in simulations.
        upper : float, optional
            Upper position limit, rad or m: a stop in simulations.
        velocity : float, optional
            Velocity limit, rad/s or m/s; reported only.
        effort : float, optional
            Effort limit, N m or N; reported only.
        acceleration, deceleration, jerk : float, optional
            Limits of the acceleration, of the deceleration, rad/s^2 or m/s^2, and of the jerk, rad/s^3 or m/s^3;
            reported only.
        mimic : str, optional
            Name of a joint to follow, with build(mimic="couple").
        mimic_multiplier : float, default 1
            Factor of the coordinate of that joint.
        mimic_offset : float, default 0
            Offset that is added, rad or m.

        Returns
        -------
        builder : SceneBuilder
            The same builder.

        Raises
        ------
        SceneError
            An unknown type, or a screw joint without a pitch.
        ShapeError, ArgumentError
            Invalid arrays. The message names the joint; build() checks the rest.

        Examples
        --------
        >>> builder = phipsi.SceneBuilder().link("base").link("slider", mass=2.0)
        >>> scene = builder.joint("rail", "prismatic", "base", "slider", axis=(1, 0, 0), upper=0.5).build()
        >>> scene.limits.upper
        array([0.5])
        """

    def connect(
        self,
        name: str,
        kind: Literal["point", "axis", "weld", "distance", "rod"],
        link: str,
        other: str | None = None,
        *,
        xyz: ArrayLike = (0, 0, 0),
        rpy: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        other_xyz: ArrayLike | None = None,
        other_rpy: ArrayLike | None = None,
        other_rotation: ArrayLike | None = None,
        axis: ArrayLike | None = None,
        length: float | None = None,
    ) -> SceneBuilder:
        """Close a kinematic loop: connect a frame on a link with a frame on another link or on the base.

        Parameters
        ----------
        name : str
            Name of the connection.
        kind : {"point", "axis", "weld", "distance", "rod"}
            "point": the origins coincide (3 rows). "axis": a hinge: the origins and the direction `axis` coincide (5
            rows). "weld": the frames coincide (6 rows). "distance" or "rod": the origins are `length` apart (1 row).
        link : str
            Name of the first link, which may be added later.
        other : str, optional
            Name of the second link. None: the base.
        xyz : (3,) array_like, default (0, 0, 0)
            Origin of the first frame in `link`, m.
        rpy : (3,) array_like, optional
            Orientation of the first frame in `link`, rad, as in joint.
        rotation : (3, 3) array_like, optional
            The same as a matrix, instead of rpy.
        other_xyz : (3,) array_like, optional
            Origin of the second frame in `other`, m.
        other_rpy : (3,) array_like, optional
            Orientation of the second frame in `other`, rad.
        other_rotation : (3, 3) array_like, optional
            The same as a matrix. None of the three: the second frame is where the first one is in the neutral
            configuration.
        axis : (3,) array_like, optional
            Direction in both frames, for "axis"; z by default.
        length : float, optional
            Length, m, for "distance" and "rod"; by default that in the neutral configuration.

        Returns
        -------
        builder : SceneBuilder
            The same builder.

        Raises
        ------
        SceneError
            An unknown kind, or an axis or a length that the kind does not have.
        ShapeError, ArgumentError
            Invalid arrays. The message names the connection; build() checks the rest.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3).to_builder().connect("pin", "point", "link2", xyz=(0, 0, 0.3)).build()
        >>> scene.loops.names, scene.loops.jacobian([0.3, 0.2, 0.1]).shape
        (('pin',), (3, 3))
        """

    def actuator(
        self,
        name: str,
        joint: str,
        *,
        gear: float = 1.0,
        kp: float | None = None,
        kv: float | None = None,
        gain: ArrayLike | None = None,
        bias: ArrayLike | None = None,
        ctrlrange: ArrayLike | None = None,
        forcerange: ArrayLike | None = None,
        timeconst: float | None = None,
        actrange: ArrayLike | None = None,
    ) -> SceneBuilder:
        """Add an actuator of a joint with one degree of freedom, or replace the one with the same name.

        Parameters
        ----------
        name : str
            Name of the actuator.
        joint : str
            Name of the joint, which may be added later.
        gear : float, default 1
            Joint torque per force of the actuator, and its length and velocity per joint position and velocity.
        kp : float, optional
            Gain of a position servo, whose force is kp (control - length) - kv velocity.
        kv : float, optional
            Gain of the velocity; without kp that of a velocity servo, whose force is kv (control - velocity).
        gain : (3,) array_like, optional
            Coefficients of the control (constant, by length, by velocity), instead of kp and kv; (1, 0, 0) without
            both: a motor. (0, 0, -kv) is a damper.
        bias : (3,) array_like, optional
            Force without control (constant, by length, by velocity), instead of kp and kv.
        ctrlrange : (2,) array_like, optional
            Smallest and largest control, to which controls are clipped.
        forcerange : (2,) array_like, optional
            Smallest and largest force, to which the force is clipped before the gear.
        timeconst : float, optional
            Time constant of a first-order filter of the control, s; inf: the input is the time integral of the control.
        actrange : (2,) array_like, optional
            Smallest and largest output of the filter or integral.

        Returns
        -------
        builder : SceneBuilder
            The same builder.

        Raises
        ------
        ShapeError, ArgumentError
            kp or kv together with gain or bias, or invalid arrays. The message names the actuator; build() checks the
            rest.

        Notes
        -----
        The torques of all actuators of a joint together are clipped to its effort limit.

        Examples
        --------
        >>> builder = phipsi.scenes.chain(2).to_builder()
        >>> builder = builder.actuator("shoulder", "j0", kp=100.0, kv=10.0).actuator("elbow", "j1", gear=50.0)
        >>> builder.build().actuators.names
        ('shoulder', 'elbow')
        """
    def _set_actuators(self, actuators: list[tuple[Any, ...]]) -> None: ...
    def start(
        self, q: Mapping[str, ArrayLike] | None = None, qd: Mapping[str, ArrayLike] | None = None, *, keyframe: str | None = None
    ) -> SceneBuilder:
        """Set the start, from which motions begin by default, or add a keyframe. Replaces the one with the same name.

        Parameters
        ----------
        q : dict of str to float or array_like, optional
            Joint positions by joint name, rad or m. The joints may be added later.
        qd : dict of str to float or array_like, optional
            Joint velocities by joint name, rad/s or m/s.
        keyframe : str, optional
            Name of the keyframe. None: the start.

        Returns
        -------
        builder : SceneBuilder
            The same builder.

        Raises
        ------
        ShapeError, ArgumentError
            Arguments that are not dicts, or invalid values. The message names the joint; build() checks the rest.

        Notes
        -----
        Joints that the start does not name are neutral and at rest; those that a keyframe does not name are as in the
        start. build() raises ArgumentError for unknown joints, quaternions that are not of unit norm, and joints that
        follow others (mimic) and are elsewhere; SceneError for a wrong number of values.

        Examples
        --------
        >>> builder = phipsi.scenes.chain(3).to_builder().start({"j1": 0.5})
        >>> scene = builder.start({"j2": -1.0}, {"j0": 0.1}, keyframe="kick").build()
        >>> scene.initial(), scene.initial("kick"), scene.initial_velocity("kick")
        (array([0. , 0.5, 0. ]), array([ 0. ,  0.5, -1. ]), array([0.1, 0. , 0. ]))
        """
    def collider(
        self,
        name: str,
        shape: ColliderShape,
        *,
        link: str | None = None,
        friction: float = 1.0,
        restitution: float = 0.0,
        groups: int = 1,
        mask: int = 1,
    ) -> SceneBuilder:
        """Add a shape that touches the other colliders in simulations.

        Parameters
        ----------
        name : str
            Name of the collider.
        shape : phipsi.shapes.Box, Sphere, Cylinder, Capsule, Mesh, Hull, HalfSpace or HeightField
            The shape. A mesh stands for its convex hull.
        link : str, optional
            Name of the link that carries it. It may be added later. None: the base.
        friction : float, default 1
            Coefficient of Coulomb friction, not negative. Of two shapes that touch, the larger one counts.
        restitution : float, default 0
            Coefficient of restitution, from 0 (no rebound) to 1 (elastic). Of two shapes, the larger one counts.
        groups : int, default 1
            Groups that the shape belongs to, as bits.
        mask : int, default 1
            Groups that it can touch, as bits: two shapes can touch if `groups` of one and `mask` of the other have a bit
            in common.

        Returns
        -------
        builder : SceneBuilder
            The same builder.

        Raises
        ------
        ArgumentError
            An invalid shape. The message names the collider.

        Notes
        -----
        Shapes on links that cannot move against each other do not touch, nor do those of parent and child, unless the
        parent cannot move, or collisions_with_parents allows it. build() raises SceneError for duplicate names, unknown
        links, a half space or a height field on a link that moves, points without volume, and values out of range.

        Examples
        --------
        >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
        >>> builder = builder.collider("ball", phipsi.shapes.Sphere(0.1), link="ball")
        >>> builder.collider("ground", phipsi.shapes.HalfSpace()).build(floating_base=True).collider_names
        ('ball', 'ground')
        """
    def collider_pair(
        self,
        first: str,
        second: str,
        *,
        friction: float | None = None,
        restitution: float | None = None,
        margin: float = 0.0,
    ) -> SceneBuilder:
        """Let two colliders touch in any case, with values of their own.

        Parameters
        ----------
        first, second : str
            Names of the colliders. They may be added later.
        friction : float, optional
            Coefficient of Coulomb friction. None: the larger one of both.
        restitution : float, optional
            Coefficient of restitution. None: the larger one of both.
        margin : float, default 0
            Distance at which the contact begins to act, m.

        Returns
        -------
        builder : SceneBuilder
            The same builder.

        Notes
        -----
        build() raises SceneError for names that do not exist, for shapes that cannot move against each other, and for
        values out of range.

        Examples
        --------
        >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
        >>> builder = builder.collider("ball", phipsi.shapes.Sphere(0.1), link="ball")
        >>> builder = builder.collider("ground", phipsi.shapes.HalfSpace()).collider_pair("ball", "ground", friction=0.3)
        """
    def exclude(self, first: str | None, second: str | None) -> SceneBuilder:
        """Exclude the colliders of two links from touching each other.

        Parameters
        ----------
        first, second : str or None
            Names of the links; None: the base.

        Returns
        -------
        builder : SceneBuilder
            The same builder.

        Notes
        -----
        collider_pair prevails. build() raises SceneError for an unknown link.

        Examples
        --------
        >>> builder = phipsi.SceneBuilder().link("a").link("b", mass=1.0).joint("hinge", "revolute", "a", "b")
        >>> builder.exclude("a", "b").build().nv
        1
        """
    def collisions_with_parents(self, allowed: bool) -> SceneBuilder:
        """Set whether the colliders of a link touch those of its parent.

        Parameters
        ----------
        allowed : bool
            True: they touch. By default they do not, unless the parent cannot move.

        Returns
        -------
        builder : SceneBuilder
            The same builder.

        Examples
        --------
        >>> phipsi.SceneBuilder().link("a").collisions_with_parents(True).build().nv
        0
        """
    def contact(
        self,
        name: str,
        link: str,
        *,
        friction: float,
        xyz: ArrayLike = (0, 0, 0),
        radius: float = 0.0,
        normal: ArrayLike = (0, 0, 1),
        offset: float = 0.0,
        restitution: float = 0.0,
        other: str | None = None,
        other_xyz: ArrayLike = (0, 0, 0),
        other_rpy: ArrayLike | None = None,
        other_rotation: ArrayLike | None = None,
        other_radius: float | None = None,
        other_size: ArrayLike | None = None,
    ) -> SceneBuilder:
        """Add a contact of a sphere or a point on a link with a plane, sphere or box, with Coulomb friction.

        Parameters
        ----------
        name : str
            Name of the contact.
        link : str
            Name of the link, which a joint moves. It may be added later.
        friction : float
            Coefficient of Coulomb friction, not negative.
        xyz : (3,) array_like, default (0, 0, 0)
            Center of the sphere in the link frame, m.
        radius : float, default 0
            Radius, m; 0: a point.
        normal : (3,) array_like, default (0, 0, 1)
            Outward normal of the plane in the second frame (by default the base frame), of any length.
        offset : float, default 0
            Distance of the plane from the origin of that frame along the normal, m.
        restitution : float, default 0
            Coefficient of restitution, from 0 (no rebound) to 1 (elastic).
        other : str, optional
            Name of the link of the surface. None: the base.
        other_xyz : (3,) array_like, default (0, 0, 0)
            Origin of the second frame in `other`, m.
        other_rpy : (3,) array_like, optional
            Orientation of the second frame in `other`, rad, as in joint.
        other_rotation : (3, 3) array_like, optional
            The same as a matrix, instead of other_rpy.
        other_radius : float, optional
            The surface is a sphere of this radius about the origin of the second frame, m; 0: a point.
        other_size : (3,) array_like, optional
            The surface is a box about the origin of the second frame: lengths of its edges, m, as in shapes.Box.

        Returns
        -------
        builder : SceneBuilder
            The same builder.

        Raises
        ------
        ShapeError, ArgumentError
            Invalid arrays, or arguments of more than one surface. The message names the contact.

        Notes
        -----
        Contacts act in simulations only. collider() adds shapes that touch all others. The normal of
        a sphere or box is the direction from its nearest point to the center of the sphere on `link`; for a center
        inside of a box, the normal of the nearest face. Forces are those on `link`. build() raises SceneError for
        duplicate names, links that are unknown or cannot move, two links that are rigidly attached to each other, a
        normal of length zero, and values out of range.

        Examples
        --------
        >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
        >>> scene = builder.contact("foot", "ball", friction=0.5, radius=0.1).build(floating_base=True)
        >>> scene.contacts.gaps([0, 0, 0.3, 0, 0, 0, 1]).round(3)
        array([0.2])

        Two balls:

        >>> builder = phipsi.SceneBuilder().link("world")
        >>> for name in ("a", "b"):
        ...     builder = builder.link(name, mass=1.0, inertia=0.004 * np.eye(3)).joint(name, "floating", "world", name)
        >>> builder = builder.contact("balls", "a", friction=0.0, radius=0.1, other="b", other_radius=0.1)
        >>> builder.build().contacts.gaps([0, 0, 0.3, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1]).round(3)
        array([0.1])
        """

    def couple(
        self,
        name: str,
        joint: str,
        other: str | None = None,
        *,
        multiplier: float = 1.0,
        offset: float = 0.0,
        polynomial: ArrayLike | None = None,
    ) -> SceneBuilder:
        """Couple two joints by a constraint force (1 row): a coordinate is a polynomial of the other, linear by default.

        Linear: coordinate = multiplier * other coordinate + offset.

        Parameters
        ----------
        name : str
            Name of the connection.
        joint : str
            Name of a joint with one axis, which may be added later.
        other : str, optional
            Name of the other joint with one axis. None: the coordinate equals offset.
        multiplier : float, default 1
            Factor of the coordinate of the other joint.
        offset : float, default 0
            Offset, rad or m.
        polynomial : array_like, optional
            One to five coefficients (a0, a1, ..., a4) instead of multiplier and offset, in powers of rad or m:
            coordinate = a0 + a1 x + a2 x^2 + a3 x^3 + a4 x^4 with the coordinate x of the other joint.

        Returns
        -------
        builder : SceneBuilder
            The same builder.

        Raises
        ------
        SceneError
            A polynomial without another joint, or with a multiplier or an offset.
        ShapeError
            A wrong number of coefficients.

        Notes
        -----
        build() raises SceneError for unknown joints, joints with several axes and non-finite numbers. The constraint
        force acts along (1, -P'(x)) on the two joints, where P is the polynomial.

        Examples
        --------
        >>> scene = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1", multiplier=-2.0).build()
        >>> scene.loops.error([0.0, 0.1, 0.0]).round(3)
        array([0.2])
        >>> cam = phipsi.scenes.chain(3).to_builder().couple("cam", "j2", "j0", polynomial=(0.1, 0.0, 2.0)).build()
        >>> cam.loops.jacobian([0.5, 0.0, 0.6])
        array([[-2.,  0.,  1.]])
        """

    def attach(
        self,
        scene: Scene,
        link: str,
        *,
        prefix: str = "",
        xyz: ArrayLike = (0, 0, 0),
        rpy: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        name: str | None = None,
    ) -> SceneBuilder:
        """Attach another robot to a link by a fixed joint, such as a gripper to an arm.

        Parameters
        ----------
        scene : Scene
            The other robot. A floating base of it becomes fixed.
        link : str
            Name of the link of this builder that carries its root link.
        prefix : str, default ""
            Begin of all its names here, for names that both robots have.
        xyz, rpy, rotation
            Pose of its root link in the frame of the link, as in joint().
        name : str, optional
            Name of the fixed joint. None: that of its root link with the prefix, followed by "_mount".

        Returns
        -------
        builder : SceneBuilder
            The same builder.

        Raises
        ------
        ArgumentError, ShapeError
            An unknown link, names that both robots have, or an invalid pose.

        Notes
        -----
        Its joints, connections, contacts, colliders, actuators, start and keyframes come with it, but colliders of its
        base, such as a ground, do not. Gravity and the other settings are those of this builder.

        Examples
        --------
        >>> arm, gripper = phipsi.scenes.chain(3), phipsi.scenes.chain(2)
        >>> builder = arm.to_builder().attach(gripper, "link2", prefix="finger_", xyz=(0, 0, 0.3))
        >>> builder.build().joint_names
        ('j0', 'j1', 'j2', 'finger_j0', 'finger_j1')
        """

    def build(
        self,
        floating_base: bool | None = None,
        gravity: ArrayLike | None = None,
        strict: bool | None = None,
        *,
        leave_out: Collection[_Switch] | None = None,
        mimic: Literal["couple", "free"] | None = None,
        tolerance: float | None = None,
    ) -> Scene:
        """Check all parts and create the Scene. The builder can be used again.

        Parameters
        ----------
        floating_base : bool, optional
            If true, add a free joint below the root link, as in Scene.from_urdf.
        gravity : (3,) array_like, optional
            Gravity in the base frame, m/s^2.
        strict : bool, optional
            If true, unphysical inertias raise instead of warning.
        leave_out : collection of str, optional
            Names of the simplifications to allow: "fixed_joints", "base_links", "permuted_axes", "oblique_axes",
            "zero_velocity" and "zero_gravity". None: all. They change results by rounding only; see Scene.plan.
        mimic : {"free", "couple"}, optional
            Treatment of mimic joints, as in Scene.from_urdf.
        tolerance : float, optional
            Geometric tolerance of linkages, 0 to 0.1: an angle in rad, or a length relative to the reach of the loop.
            Rows of connections that are dependent within it count as dependent, with a LinkageWarning at the first call
            that finds one (see Scene.loops.project). Default: 3e-5, or 5e-3, 2e-3 or 2e-4 for a URDF whose angles have two,
            three or four decimals. With strict=True, only rows that are dependent within rounding count.

        Returns
        -------
        scene : Scene
            The scene.

        Raises
        ------
        SceneError
            No link, duplicate names, an unknown parent or child, two parents, two roots, a cycle, an axis of length
            zero, non-finite numbers, negative mass, armature, damping or friction, lower above upper, a floating base
            of a floating robot, or connections and contacts that name unknown or unsuitable parts. The message names
            the part.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Warns
        -----
        InertiaWarning
            An inertia that no rigid body can have.
        MimicWarning
            A mimic joint that is independent.

        Notes
        -----
        None means the value of the builder: a fixed base, gravity (0, 0, -9.81), strict=False, all simplifications and
        mimic="free" in a new builder; the values of the scene in a builder from Scene.to_builder.

        Examples
        --------
        >>> builder = phipsi.SceneBuilder().link("base", mass=1.0)
        >>> scene = builder.build(floating_base=True, gravity=(0, 0, 0))
        >>> scene.nv
        6
        """

    def _set_file(self, file: str | os.PathLike[str]) -> None: ...
    def _add_shapes(self, text: str) -> None: ...
    def __copy__(self) -> SceneBuilder: ...
    def __deepcopy__(self, memo: Any, /) -> SceneBuilder: ...
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]: ...

def _numbers(name: str, value: ArrayLike, scene: Scene | None = None, coordinates: bool = False, /) -> _Array: ...
def _panic_for_tests(place: str, /) -> None: ...
def _panic_place(message: str, /) -> str: ...
def _rebuild_builder(description: tuple[Any, ...], /) -> SceneBuilder: ...
def _rebuild_factor(scene: Scene, q: ArrayLike, form: str, tolerance: float | None = None, /) -> RawFactor: ...
def _rebuild_random_model(
    scene: Scene, q: list[float], qd: list[float] | None, acceleration_variance: float, /
) -> RandomModel: ...
def _rebuild_scene(description: tuple[Any, ...], /) -> Scene: ...
def _rebuild_simulator(
    scene: Scene,
    q: ArrayLike,
    qd: ArrayLike,
    keywords: dict[str, Any],
    numbers: ArrayLike,
    begun: list[int],
    steps: int,
    method: str,
    /,
) -> Simulator: ...
def _function_table() -> list[dict[str, Any]]: ...
def _unwritten(count: int, /) -> _Array: ...
def _rotate_chosen(triangle: _Array, wide: _Array, chosen: list[int], last: _Array, /) -> None: ...
def _rotate_rows(triangle: _Array, rows: _Array, /) -> None: ...
def _log_likelihood(time: _Array, position: _Array, variance: _Array, density: float, prior: tuple[float, float, float], /) -> tuple[float, float, int]: ...
def _smooth_log(time: _Array, position: _Array, variance: _Array, density: float, prior: tuple[float, float, float], /) -> _Array: ...

@final
class _Optimizer:
    def __new__(
        cls,
        scene: Scene,
        times: tuple[float, int],
        terms: list[tuple[str, int, int, bool, Any]],
        effort: list[list[float]] | None,
        has_limits: bool,
        settings: tuple[float, float, float, float],
    ) -> _Optimizer: ...
    def retarget(self, terms: list[tuple[str, int, int, bool, Any]]) -> None: ...
    def solve(
        self,
        state: tuple[_Array, _Array],
        tau: _Array | None,
        states: tuple[_Array, _Array] | None,
        iterations: int,
    ) -> tuple[list[_Array], bool, float, str, _Array]: ...
    def linearization(self) -> tuple[list[_Array], list[int]]: ...

@final
class _Observer:
    def __new__(
        cls,
        scene: Scene,
        dt: float,
        sensors: list[tuple[Any, ...]],
        torque_noise: list[float],
        wrenches: list[tuple[Any, ...]],
        initial: list[float],
        history: int,
        state: tuple[_Array, _Array],
        batch: tuple[int, ...],
    ) -> _Observer: ...
    def process(self) -> list[_Array]: ...
    def step(self, tau: _Array, readings: _Array, dt: float, acting: _Array) -> tuple[list[_Array], bool]: ...
    def smooth(self) -> tuple[list[_Array], _Array]: ...
    def prior(self) -> list[_Array]: ...
    def window(self) -> list[list[tuple[float, int]]]: ...
    def window_without(self, robot: int, sensor: int) -> list[tuple[float, int]]: ...
    def transition(self, q: _Array, qd: _Array, rest: _Array, tau: _Array) -> list[_Array]: ...
    def numbers(self) -> _Array: ...
    def resume(self, numbers: _Array) -> None: ...

@final
class Simulator:
    """States that are advanced by calls of step, for controllers, learning and real-time loops.

    Create it with Scene.simulator. The batch has the axes to which q, qd and the targets of pd broadcast; large
    batches are vectorized and run on threads. Results are bit-identical to those of Scene.simulate, for any
    division of the steps into calls and any batch. Intermediate results are preallocated.

    During a call, other calls on the same simulator raise ArgumentError. Copies and pickles are independent
    simulators at the same state.

    Examples
    --------
    >>> simulator = phipsi.scenes.chain(3).simulator([0.3, 0.2, 0.1], [1.0, 0.0, 0.0], dt=1e-3)
    >>> for step in range(10):
    ...     simulator.step(tau=-0.1 * simulator.qd)
    >>> np.allclose(simulator.t, 0.01)
    True
    """

    def step(
        self,
        tau: ArrayLike | None = None,
        steps: int = 1,
        *,
        target: ArrayLike | None = None,
        target_rate: ArrayLike | None = None,
        control: Mapping[str, ArrayLike] | ArrayLike | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        frame: Literal["link", "world"] | None = "link",
    ) -> None:
        """Advance all states by steps of dt, with constant joint torques.

        Parameters
        ----------
        tau : (..., nv) array_like, optional
            Joint torques, N m or N, which broadcast to the batch. None: zero.
        steps : int, default 1
            Number of steps.
        target : (..., nq) array_like, optional
            New target of pd, from this step on. None: the last one.
        target_rate : (..., nv) array_like, optional
            New target velocity of pd, likewise.
        control : (..., n) array_like or dict of str to float, optional
            New controls of scene.actuators, from this step on, of a simulator that was created with controls. None: the
            last ones.
        wrenches : dict of str to (..., 6) array_like, optional
            External forces in the steps of this call by link name: (moment, force) at the origin of the link, N m and
            N, which broadcast to the batch. None: none.
        frame : {"link", "world"}, default "link"
            Axes of the wrenches: those of the link, with which they rotate, or those of the base.

        Raises
        ------
        SimulationError
            The motion diverges or a pivot is lost. .step, .joint, .state and .trajectory (one row) describe it. All
            states are at the last step that all of them finished; reset(q, qd, states=error.state) lets the others
            continue.
        SimulationInterrupted
            Ctrl-C (a KeyboardInterrupt), likewise. Other exceptions of signal handlers are raised unchanged.
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument; no state has moved.

        Examples
        --------
        >>> simulator = phipsi.scenes.chain(3).simulator([0.3, 0.2, 0.1], dt=1e-3)
        >>> simulator.step([0.5, 0.0, 0.0], steps=100)
        >>> bool(simulator.qd[0] > 0.0)
        True
        """
    def _advance(
        self, tau: ArrayLike | None, steps: int, target: ArrayLike | None, target_rate: ArrayLike | None, /
    ) -> None: ...
    def reset(
        self,
        q: ArrayLike,
        qd: ArrayLike | None = None,
        *,
        states: Any = None,
        activation: Mapping[str, ArrayLike] | ArrayLike | None = None,
    ) -> None:
        """Set states and their times to a new start; the other states remain.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like, optional
            Joint velocities, rad/s or m/s; zero by default.
        states : optional
            Selection of states as in array[states] = q: a mask, an index, a list of indices or a slice. None: all.
        activation : (..., n) array_like or dict, optional
            Activations of the actuators of these states; None: zero. The controls remain.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.

        Warns
        -----
        ContactWarning, LimitWarning
            Contacts that start below their surface, and joints that start outside of limits that are stops.

        Notes
        -----
        If the call raises, all states are unchanged.

        Examples
        --------
        >>> simulator = phipsi.scenes.chain(3).simulator(np.zeros((4, 3)), dt=1e-3)
        >>> simulator.step(steps=10)
        >>> simulator.reset([0.3, 0.2, 0.1], states=2)
        >>> simulator.t
        array([0.01, 0.01, 0.  , 0.01])
        """
    @property
    def q(self) -> _Array:
        """Current joint positions, (..., nq), rad or m, a copy."""
    @property
    def qd(self) -> _Array:
        """Current joint velocities, (..., nv), rad/s or m/s, a copy."""
    @property
    def control(self) -> _Array | None:
        """Controls of the actuators, (..., n), a copy; None without control."""
    @property
    def activation(self) -> _Array | None:
        """Activations of the actuators, (..., n), a copy, zero for those without one; None without control."""
    @property
    def t(self) -> Any:
        """Time since the start or last reset of each state, (...), s: a float for one state, otherwise an array."""
    @property
    def steps(self) -> int:
        """Number of steps since the creation of the simulator; reset does not change it."""
    @property
    def dt(self) -> float:
        """Step, s."""
    @property
    def method(self) -> str:
        """Integration method, one of the names of Scene.simulate."""
    @property
    def scene(self) -> Scene:
        """Scene that is simulated."""
    @property
    def batch(self) -> tuple[int, ...]:
        """Shape of the batch; () for one state."""
    @property
    def contacts(self) -> ContactMotion | None:
        """Contact forces of the last step and impulses since the start, a ContactMotion; None without contacts."""

    def take_stops(self) -> list[StopImpact]:
        """Return the impacts of joints on their stops since the last call, and clear the list.

        Returns
        -------
        stops : list of StopImpact
            Sorted by state and time; times are those of each state.

        Examples
        --------
        >>> builder = phipsi.SceneBuilder().link("rail").link("cart", mass=1.0)
        >>> scene = builder.joint("x", "prismatic", "rail", "cart", axis=(1, 0, 0), upper=0.5).build()
        >>> simulator = scene.simulator([0.0], [1.0], dt=0.01)
        >>> simulator.step(steps=100)
        >>> [(stop.joint, stop.limit, round(stop.speed, 3)) for stop in simulator.take_stops()]
        [('x', 'upper', 1.0)]
        """
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]: ...

@final
class RandomModel:
    """Random forces on the bodies at one configuration, and the joint torques that they cause (1.1 to 1.6).

    Create it with Scene.random_model. s is the acceleration variance, (rad/s^2)^2 of 1 kg m^2; v has the variance s
    times the armature.

    Examples
    --------
    >>> model = phipsi.scenes.chain(3).random_model([0.3, 0.2, 0.1])
    >>> model.nv, model.dimension
    (3, 18)
    """

    @property
    def nv(self) -> int:
        """Number of degrees of freedom."""

    @property
    def dimension(self) -> int:
        """Random numbers per sample: six per body (rods and point masses: fewer), one per joint with armature."""

    @property
    def acceleration_variance(self) -> float:
        """Acceleration variance s, (rad/s^2)^2 of 1 kg m^2."""

    def sample(self, samples: int, *, seed: int, first: int | None = None) -> Samples:
        """Samples of the process W, the force X = phi W and the torque T = H X + v.

        Parameters
        ----------
        samples : int
            Number of samples.
        seed : int
            Seed, from 0 to 2^64 - 1.
        first : int, optional
            Number of the first sample, 0 by default. Sample i of a seed does not depend on the others or on the
            threads.

        Returns
        -------
        samples : Samples
            Named tuple: process and force, (samples, nv, 6), in body frames with one block per degree of freedom as in
            Factor; torque, (samples, nv).

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.
        OutOfMemoryError
            A result that does not fit in memory. The message names the argument that determines its size.

        Examples
        --------
        >>> model = phipsi.scenes.chain(3).random_model([0.3, 0.2, 0.1])
        >>> one, other = model.sample(4, seed=1), model.sample(2, seed=1, first=2)
        >>> np.array_equal(one.torque[2:], other.torque)
        True
        """

    def sample_torque(self, samples: int, *, seed: int, first: int | None = None) -> _Array:
        """Samples of the joint torques T = H X + v only, equal to those of sample.

        Parameters
        ----------
        samples : int
            Number of samples.
        seed : int
            Seed, from 0 to 2^64 - 1.
        first : int, optional
            Number of the first sample, 0 by default.

        Returns
        -------
        torque : (samples, nv) ndarray
            Joint torques, N m or N.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.
        OutOfMemoryError
            A result that does not fit in memory. The message names the argument that determines its size.

        Examples
        --------
        >>> model = phipsi.scenes.chain(3).random_model([0.3, 0.2, 0.1])
        >>> np.array_equal(model.sample_torque(4, seed=1), model.sample(4, seed=1).torque)
        True
        """

    def mass_matrix(
        self,
        samples: int | None = None,
        *,
        seed: int | None = None,
        method: Literal["monte-carlo", "sobol", "sigma-points"] = "monte-carlo",
        confidence: float = 0.95,
        replicates: int = 8,
    ) -> MassEstimate:
        """Estimate the mass matrix from sampled joint torques, with confidence intervals (5.1).

        Parameters
        ----------
        samples : int, optional
            Number of samples; for "sobol" replicates times a power of two, for "sigma-points" none.
        seed : int, optional
            Seed, from 0 to 2^64 - 1; for "sigma-points" none.
        method : {"monte-carlo", "sobol", "sigma-points"}, default "monte-carlo"
            Independent samples, with an error of samples^-1/2; scrambled Sobol points, about samples^-1; or sigma
            points, exact.
        confidence : float, default 0.95
            Confidence of the interval of each entry, between 0 and 1.
        replicates : int, default 8
            Number of scrambles, at least 2, for "sobol" only.

        Returns
        -------
        estimate : MassEstimate
            Named tuple (mass_matrix, standard_error, low, high, samples, confidence).

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument or an unknown name. The message names the argument and the state.
        OutOfMemoryError
            A result that does not fit in memory. The message names the argument that determines its size.

        Notes
        -----
        The memory does not grow with the number of samples.

        Examples
        --------
        >>> model = phipsi.scenes.chain(3).random_model([0.3, 0.2, 0.1])
        >>> estimate = model.mass_matrix(2000, seed=1)
        >>> bool((estimate.low <= estimate.high).all())
        True
        """

    def __copy__(self) -> RandomModel: ...
    def __deepcopy__(self, memo: Any, /) -> RandomModel: ...
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]: ...

@final
class RawFactor:
    """Compiled part of phipsi.operators.Factor: applies operators by name."""

    @property
    def nv(self) -> int:
        """Number of degrees of freedom."""

    @property
    def batch(self) -> tuple[int, ...]:
        """Leading axes of the configurations."""

    def log_det(self) -> Any:
        """log det M of every configuration, with the shape of the batch."""

    def pivots(self) -> _Array:
        """Pivots D of every configuration, (..., nv)."""

    def shape(self, kind: str, /) -> tuple[int, int]:
        """Shape (rows, columns) of an operator."""

    def apply(self, kind: str, transpose: bool, x: ArrayLike, /) -> _Array:
        """Product of an operator, or of its transpose, with x, (..., columns), by a sweep."""

    def update(self, q: ArrayLike, /) -> int:
        """Update the factors to the configurations q, of the same shape; returns the number of recomputed bodies."""

    def dense(self, kind: str, /) -> _Array:
        """Operator as a matrix, (..., rows, columns), from its definition and not by a sweep."""

    def __copy__(self) -> RawFactor: ...
    def __deepcopy__(self, memo: Any, /) -> RawFactor: ...
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]: ...

@final
class Reference:
    """Joint accelerations in double-double arithmetic, the reference of a report."""

    def toarray(self) -> _Array:
        """Reference rounded to float64, (n, nv)."""

@final
class Exact:
    """Quantity of one state in double-double arithmetic, and errors measured against it.

    quantity: one of QUANTITIES; q: (nq,), qd: (nv,); u: (nv,), torques, or accelerations for "inverse dynamics".
    Raises ArgumentError for an unknown quantity, ShapeError and NotFiniteError for arrays, and SingularJointError.
    """

    def __new__(cls, scene: Scene, quantity: str, q: ArrayLike, qd: ArrayLike, u: ArrayLike) -> Exact: ...
    def toarray(self) -> _Array:
        """Exact result rounded to float64, (nv,) or (nv * nv,)."""

    def difference(self, found: ArrayLike, /) -> tuple[float, _Array]:
        """Relative error of a result of another program: the max-norm, and each component relative to its own size."""

    def error(self, method: str) -> tuple[float, _Array, str | None]:
        """Error of a method: (max-norm, components, reason).

        method: one of FORMS; for other quantities than forward dynamics, the recursion of the library. After a failure,
        the errors are NaN and the reason is a text, otherwise None.
        """

    def sensitivity(self, draws: int = 4, seed: int = 0) -> dict[str, tuple[float, _Array]]:
        """Change of the exact result for one unit in the last place of an input: kind to (max-norm, components)."""

    def time(self, method: str, repeats: int) -> float:
        """Median time (ns) of a method of forward dynamics on this state over repeats calls."""

BUNDLED_ARM: str
FORMS: tuple[str, ...]
QUANTITIES: tuple[str, ...]
METHODS: tuple[str, ...]
ROUTES: tuple[str, ...]

def residuals(scene: Scene, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> list[tuple[str, float, bool]]:
    """Residuals at one state, as (name, relative residual, whether rounding grows with the condition number of M)."""

def reference(scene: Scene, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> Reference:
    """Accelerations of n states in double-double arithmetic, about 31 digits; q: (n, nq), qd and tau: (n, nv)."""

def measure(
    scene: Scene,
    method: str,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike,
    reference: Reference,
    repeats: int,
) -> tuple[float, _Array]:
    """Median time per state (ns) of a method, and the error of each state compared with the reference.

    Times `Scene::evaluate` in Rust, one state per call; the error is that of the same calls, the largest over the
    joints relative to the largest acceleration, or NaN after an invalid pivot. method: one of METHODS; repeats: passes over
    the states.
    """

def growth(bodies: int, repeats: int) -> tuple[float, float, float]:
    """Median time per body (ns) on a chain: forward dynamics in the forms "auto" and "covariance", inverse dynamics.

    Times `Scene::evaluate` in Rust, one state per call, over repeats passes.
    """

def method_call(method: str) -> tuple[str, str | None]:
    """Rust function of a method of METHODS, and its form; None if its calls have no form."""

def emergence(scene: Scene, q: ArrayLike, route: str, samples: int, seed: int, repeats: int) -> tuple[float, float]:
    """Median time (ns) of a route from q to the mass matrix, and its error relative to double-double arithmetic.

    route: one of ROUTES; samples and seed: for "monte-carlo" and "sobol" (a power of two); repeats: number of
    timings. The error is in the Frobenius norm.
    """

def operator_growth(bodies: int, repeats: int) -> list[tuple[str, float]]:
    """Median time per body (ns) of each operator, and with a star of its transpose, on a chain: (name, ns)."""

def extreme(
    name: str, value: float | None, bodies: int | None, seed: int
) -> tuple[Scene, _Array, _Array, _Array, str, float, str, tuple[float, ...]]:
    """Extreme case as (scene, q, qd, tau, name, value, parameter, values); see phipsi.scenes.extreme."""

def extreme_names() -> tuple[str, ...]:
    """Names of the extreme cases; see phipsi.scenes.names."""

def chain(n: int) -> Scene:
    """Chain of n equal links; see phipsi.scenes.chain."""

def set_num_threads(threads: int | None) -> None:
    """Set the number of threads for batches in this process and its forks; running calls keep theirs.

    Parameters
    ----------
    threads : int or None
        Number of threads, including that of the caller; 1: only that. None or 0: RAYON_NUM_THREADS, or one per
        core, which is the initial setting.

    Raises
    ------
    ArgumentError
        An invalid number, or more threads than the system provides. The previous setting remains.

    Notes
    -----
    Results are bit-identical for any number of threads.

    Examples
    --------
    >>> phipsi.set_num_threads(1)
    >>> phipsi.get_num_threads()
    1
    >>> phipsi.set_num_threads(None)
    """

def get_num_threads() -> int:
    """Number of threads that the next batch uses; 1 if it runs on that of the caller. Starts the threads if necessary.

    Returns
    -------
    threads : int
        Number of threads, including that of the caller.

    Examples
    --------
    >>> phipsi.get_num_threads() >= 1
    True
    """
