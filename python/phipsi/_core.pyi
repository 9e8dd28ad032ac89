"""The compiled half of phipsi: scenes, and the algorithms on them."""

import os
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias, final, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._functions import Function as _Function
from ._motion import PD, ContactMotion, MomentumCorrection, StopImpact, Trajectory
from ._ode import Ode
from ._results import (
    Accuracy,
    ConstrainedDynamics,
    ConstrainedInverseDynamics,
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
from .estimation import Excitation
from .estimation._identification import Identification
from .operators import Factor
from .tasks import InverseKinematics, Task
from .view import Viewer

__all__ = [
    "BUNDLED_ARM",
    "Exact",
    "FORMS",
    "METHODS",
    "QUANTITIES",
    "ROUTES",
    "RandomModel",
    "RawFactor",
    "Reference",
    "Scene",
    "SceneBuilder",
    "Simulator",
    "__version__",
    "_log_likelihood",
    "_numbers",
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
# mypy takes type[np.float32] for something of type[np.float64]: overloads of the two are told to ignore that.
_Float32: TypeAlias = type[np.float32] | np.dtype[np.float32] | Literal["float32"]
_Errors: TypeAlias = Literal["raise", "nan"]
_Form: TypeAlias = Literal["auto", "covariance", "joseph", "square-root"]
_Frame: TypeAlias = Literal["local", "world", "local-world-aligned"]
_Kind: TypeAlias = Literal["spatial", "classical"]
_Method: TypeAlias = Literal["auto", "semi-implicit-euler", "rk4", "dormand-prince-5", "implicit-euler", "rosenbrock-2", "rosenbrock-3", "contact"]
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
    "renamed_axes",
    "tilted_axes",
    "zero_velocity",
    "zero_gravity",
]
_JointType: TypeAlias = Literal[
    "fixed", "revolute", "continuous", "prismatic", "screw", "planar", "universal", "spherical", "floating"
]

@final
class Scene:
    """An articulated system: bodies, joints, gravity, and the names of them; immutable, for any number of threads.

    Made by Scene.from_urdf, from_mujoco, from_pinocchio, phipsi.load or SceneBuilder.build. SI units and radians. Spatial 6-vectors are angular first:
    wrench = (moment, force), velocity = (angular, linear). Movable joints are in depth-first order, siblings in file order.

    Arrays are (..., nq) or (..., nv): leading batch axes broadcast, rank in = rank out. Lists, float32, integers, strided
    and Fortran-ordered arrays are converted; C-contiguous float64 is used without a copy. In q a revolute joint is an angle
    (rad), a prismatic one a length (m), a screw an angle (its pitch in m/rad), a planar one (u, v, theta), a universal one
    two angles (about x, then y), a spherical one a quaternion (x, y, z, w), a free one (x, y, z, qx, qy, qz, qw) with the
    rates (linear, angular) in the body's frame.
    Quaternions may be off unit norm by 1e-3, and are normalised.

    Arguments raise ShapeError, NotFiniteError or ArgumentError (see phipsi.errors), naming the argument and the state.
    The GIL is released in all calls longer than some microseconds; large batches run on several threads (as many as
    RAYON_NUM_THREADS says, else one a core), with the same bits for any number of them. On the main thread Ctrl-C ends any long call within
    some tenths of a second, on all threads of it; out is partly written then.

    Results that memory has no room for raise OutOfMemoryError (a MemoryError), naming the arguments that ask for them and the bytes.

    An argument of one state may be a dict from joint names to numbers (arrays for joints of several coordinates). Labels are matched by
    joint name, or refused: the index of a pandas Series, the columns of a DataFrame (pandas, polars, Arrow) or the last dimension
    of an xarray DataArray; a default RangeIndex is none. Masked entries raise but in estimate. Neither is silently dropped.

    Scenes pickle, compare and hash by identity; copies are the scene itself.
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
    ) -> Scene:
        """The scene of a URDF file or text.

        source: a path (str or os.PathLike), or the XML itself: a str that starts with "<" after white space.
        floating_base: puts a free joint under the root link, "root_joint", or with "_" behind where the file has that name
        (it is joint_names[0]). gravity: (3,), m/s^2, in the base frame. strict: what is warned of raises, but for mimic
        joints whose source is there. leave_out: names of what may be left out, of "fixed_joints",
        "base_links", "renamed_axes", "tilted_axes", "zero_velocity" and "zero_gravity"; None: all.
        Results are the same to rounding, but operators and estimates need the first two (ArgumentError).
        mimic: "couple", joints with <mimic> follow the joint that they name, and have no coordinates of their own: q, tau and M are those of the others; or "free", they
        are independent, and a MimicWarning names each. Coupled scenes have all of kinematics, dynamics, derivatives and simulation; what has no form for them
        says so (operators, estimation, operational space, gradients of simulations and by parameters).

        Raises SceneError for a file that cannot be read or built, naming link or joint; ArgumentError for a source that is
        neither. Warns InertiaWarning for inertias that no body can have and for moving links that all have no mass,
        MimicWarning for free mimic joints, LimitWarning for limits that mean nothing (they are taken as none), and
        UnknownTagWarning, once, for elements, attributes and text that are not understood (they are passed over).
        """

    @staticmethod
    def from_mujoco(
        source: Any,
        *,
        gravity: ArrayLike | None = None,
        strict: bool = False,
        leave_out: Collection[_Switch] | None = None,
        ignore: Collection[_Ignored] = (),
    ) -> Scene:
        """The scene of a MuJoCo model: its bodies, joints, armature, damping, frictionloss, springs and limits. Needs phipsi[mujoco].

        source: a path of MJCF, URDF or .mjb, as MuJoCo reads them, XML, mujoco.MjModel or mujoco.MjSpec. gravity: (3,), m/s^2; None: the model's. strict: what is
        warned about raises. leave_out: as in Scene.from_urdf. ignore: names of parts of the model to omit, without a warning: "actuators" (armature and damping of those
        that do not act on a hinge or slide), "armature" and "friction" (of free joints), "contacts", "equality", "flexes", "fluid", "gravcomp", "limits" (of ball
        joints), "mocap", "nonlinear" (springs, damping, plasticity), "plugins", "softness" (of equality constraints) and "tendons".

        Joints and bodies keep their names and order; a joint whose anchor is off its body's origin, or that is not its body's last, moves a link
        "body/joint". Sites with names become links that are fixed to their bodies. Bodies and joints without a name get "body3", "joint0" and so on; where the file has such a name, or a
        site has that of a body, "_" is appended or "/site". phipsi.mujoco converts states and forces: the conventions differ at ball and free joints.

        Equality constraints connect, weld and joint (linear) become connections, by their names or "equality 0" and so on; they are rigid: solref and solimp are
        not read, neither are those of limits and friction. Armature and damping of actuators are added to those of their joint, times the square of the gear ratio; their
        forcerange gives the joint's effort limit. Stops are at range, moved inward by margin. Controls, sensors and the integrator are not read.

        Raises SceneError for a model that cannot be read, and for parts of it that change the motion and that scenes do not have, by name, with the `ignore` that omits them: other
        equality constraints, tendons with springs, losses or armature, gravcomp, a medium denser than air, plugins, deformable objects, nonlinear springs and damping, springs, friction
        and armature of free joints, mocap bodies that carry or hold others. Raises ImportError without the extra; ArgumentError for other sources. Warns ModelWarning for contacts, limits of
        tendons and ball joints, air and soft equality constraints, which are omitted; MeshWarning for missing files that no inertia depends on; otherwise as SceneBuilder.build does, with
        MimicWarning for joints that an ignored equality ties linearly.
        """
    @staticmethod
    def from_pinocchio(
        model: Any,
        *,
        gravity: ArrayLike | None = None,
        strict: bool = False,
        leave_out: Collection[_Switch] | None = None,
    ) -> Scene:
        """The scene of a Pinocchio model: its joints, inertias, armature, damping, dry friction, limits and gravity.

        model: pinocchio.Model. gravity: (3,), m/s^2; None: the model's. strict: unphysical inertias raise instead of warning. leave_out: as in Scene.from_urdf.

        Joints keep their names, bodies those of their frames, in depth-first order. phipsi.pinocchio takes states from Pinocchio's conventions to phipsi's and
        back. A body that is fixed to another keeps its frame; its mass is in the other one, as Pinocchio has it.

        Raises SceneError, naming the joint, for composite and mimic joints, for those of Euler angles, and for planar joints with armature or friction (Pinocchio applies
        them along axes of the body, phipsi along those of the parent); ImportError without Pinocchio; ArgumentError for
        what is no model. Warns as SceneBuilder.build does.
        """
    @property
    def file(self) -> Path | None:
        """The file, URDF or MJCF, that the scene comes from, a pathlib.Path; None where it comes from text or code."""

    @property
    def nq(self) -> int:
        """Number of coordinates in q."""

    @property
    def nv(self) -> int:
        """Number of degrees of freedom: the length of qd, qdd and tau."""

    @property
    def armature(self) -> _Array:
        """Armature of each degree of freedom, (nv,), kg m^2 or kg; a copy. It is the variance of the measurement noise."""

    @property
    def damping(self) -> _Array:
        """Viscous damping of each degree of freedom, (nv,), N m s/rad or N s/m; a copy. Simulation only."""

    @property
    def friction(self) -> _Array:
        """Coulomb friction of each degree of freedom, (nv,), N m or N; a copy. Simulation only."""

    @property
    def stiffness(self) -> _Array:
        """Stiffness of each degree of freedom's spring, (nv,), N m/rad or N/m; a copy. Simulation only."""

    @property
    def rest(self) -> _Array:
        """The configuration where the springs are at rest, (nq,); a copy."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the movable joints, in the order of q; the free joint of a floating base is the first, "root_joint"."""

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the links that the movable joints carry, in the order of joint_names."""

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of all links, depth first, those on fixed joints included."""

    @property
    def gravity(self) -> _Array:
        """Gravity in the base frame, (3,), m/s^2; a copy."""

    @property
    def total_mass(self) -> float:
        """Mass of all links that move, kg: those on fixed joints to them included, links on the base not, nor rotors (armature is no mass)."""

    @property
    def limits(self) -> Limits:
        """Limits by degree of freedom, as the named tuple Limits(lower, upper, velocity, effort) of arrays (nv,).

        rad or m, rad/s or m/s, N m or N; infinite where there is none; a joint of several degrees of freedom repeats its own.
        Positions are stops in simulations (limits="report" switches them off); velocity and effort are reported only.
        """

    def q_index(self, joint: str, /) -> slice[int, int, int]:
        """Where a joint is in q, a slice.

        Raises ArgumentError, with the names that there are, for an unknown joint.
        """

    def v_index(self, joint: str, /) -> slice[int, int, int]:
        """Where a joint is in qd, qdd and tau, a slice.

        Raises ArgumentError, with the names that there are, for an unknown joint.
        """

    def neutral(self) -> _Array:
        """The neutral configuration, (nq,): zero everywhere, the identity (0, 0, 0, 1) for quaternions."""

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
        out: _Array | None = None,
        dtype: _Float64 = None,
        errors: _Errors = "raise",
        return_info: Literal[False] = False,
    ) -> _Array:
        """Joint accelerations from joint torques, in O(N): the smoother's estimates given the torques as measurements.

        q: (..., nq); qd, tau: (..., nv); SI units, radians; leading axes broadcast. wrenches: dict from link names (links on fixed joints
        too) to (..., 6), each a (moment, force) acting on that link, at its origin and in its frame. form: how P is carried: "covariance"
        (3.6), "joseph", "square-root" (right at extreme mass ratios too, at about twice the time), or "auto", which takes the first and recomputes a state
        in square-root form, and in double-double arithmetic where that is not enough, if its estimated error exceeds the tolerance and what rounding of the
        forces by a unit in the last place makes of it. tolerance: the largest accepted error relative to the largest acceleration, above 0 and below 1, for the forms "auto"
        and "square-root"; None: max(5e-14, 4 n eps), n being the number of degrees of freedom on the longest path to the base. out: C-contiguous, of the
        result's shape and dtype, overlapping no argument; it is returned. dtype: float64, or float32 to compute in twice as many SIMD
        lanes: about 6 digits, fewer by those of the condition number of M; a state that loses more than 4 in form "auto" is done in
        float64 and rounded, and so is all that docs/lanes.md lists. Arguments are converted to it.
        errors: "raise", or "nan" to go on past bad states (numbers that are not finite, a quaternion off unit norm, a singular joint,
        an overflow): their results are NaN, and one BadStateWarning has .states and .reasons. Wrong shapes raise all the same.

        **tau of a free joint is (force, moment), as its qd is (linear, angular); wrenches are (moment, force).**

        return_info: whether to tell the accuracy too, one entry a state, for about five times the time in the forms "covariance" and
        "square-root", next to nothing in "auto".

        Of a scene with connections the accelerations go through them, as constrained_dynamics has them; no error is estimated.
        Contacts act in simulation only: of a scene with contacts these are the accelerations of the tree.

        Returns qdd, (..., nv), with M qdd + bias = tau + J^T w (4.4 to 4.11); with return_info (qdd, Accuracy): .form, the form that gave
        the result; .error, the estimated error of the largest acceleration; and .bound, the bound that this error meets.

        Raises SingularJointError where a joint has no inertia along its axis; ConstraintError where connections contradict each other; ArgumentError,
        naming the link, for the square-root form of an inertia that no body can have; ShapeError, NotFiniteError, ArgumentError, each naming the
        argument and the state. After an error out is partly written.
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
        pd: PD | tuple[ArrayLike, ...] | None = None,
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
    ) -> RolloutGradients:
        """Gradients of a function of a trajectory, by the adjoint of every step: Trajectory.vjp with everything said once more.

        q: (..., rows, nq); qd: (..., rows, nv): the rows that simulate recorded, the first at the start. cotangent_q, cotangent_qd: (..., rows, nv), the gradients of the
        function by these, that by q in the tangent space of each row, as dq in inverse_dynamics_jvp. dt, steps, tau, tau_steps, method, record_every, pd, armature, damping,
        stiffness, rest, friction, friction_speed, form, tolerance, limits, restitution: as simulate had them; tau is an array. parameters: whether to give the gradients by inertias too.

        Steps between rows are made again: with record_every=1 none is. O(N) a stage of a step; steps after the last row change nothing. The memory of a thread grows with the
        root of the steps between two rows.

        Returns a phipsi.RolloutGradients (q, qd, tau, armature, damping, stiffness, friction, parameters), of each state by itself: q, qd, tau and what acts at the joints
        (..., nv), tau (..., steps, nv) where tau_steps was given, parameters (..., bodies, 10) or None. Where no torque was given, tau is as for a constant one.

        Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument; SingularJointError; OutOfMemoryError.
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
        pd: PD | tuple[ArrayLike, ...] | None = None,
        armature: ArrayLike | None = None,
        damping: ArrayLike | None = None,
        stiffness: ArrayLike | None = None,
        rest: ArrayLike | None = None,
        friction: ArrayLike | None = None,
        friction_speed: float | None = None,
        form: Literal["auto", "covariance"] = "auto",
        tolerance: float | None = None,
        progress: Callable[[int, int], object] | None = None,
        conserve_momentum: bool = False,
        baumgarte: float | None = None,
        compliance: ArrayLike | None = None,
        limits: Literal["stop", "report"] | None = None,
        restitution: float = 0.0,
        accuracy: float | None = None,
        duration: float | None = None,
    ) -> Trajectory:
        """Simulates states in time: one state or a batch, with a step that is stable for stiff springs, damping, gains, dry friction and joint stops.

        With d damping, f friction, k stiffness and differences on the manifold,

            M(q) dv/dt + bias(q, v) = tau - d v - f sign(v) - k (q - rest) + kp (target - q) + kd (target_rate - v) + stops

        and dq/dt = v on the manifold: quaternions stay unit, free joints move on SE(3).

        Parameters
        ----------
        q : (..., nq)
            Configurations at the start. Leading axes of all arguments broadcast.
        qd : (..., nv)
            Joint velocities at the start, rad/s or m/s.
        dt : float
            Step, s. With accuracy and duration it is the time between rows, a thousandth of duration by default.
        steps : int
            Number of steps; or give duration.
        tau : (..., nv), or callable
            Torque, constant, or a function of (t, q, qd) that is called once per step with the whole batch and returns (..., nv). Held over each step: a
            function is followed to first order in dt by every method.
        tau_steps : (..., steps, nv)
            Torque of each step, instead of tau.
        method : str
            "auto" (the default) is "rosenbrock-2" (order 2), or "rk4" (explicit, order 4) where springs, damping and gains are slow at this step, by bounds at the
            first state: Trajectory.integrator reports which. "auto" divides steps in which joints rotate too far for the method, into at most 1024 substeps. The other
            methods never divide for accuracy: "semi-implicit-euler" (order 1), "rk4", "dormand-prince-5" (order 5), "implicit-euler" (order 1), "rosenbrock-2",
            "rosenbrock-3" (order 3). The implicit ones take
            springs, damping and pd as measurement noise r + h d + h^2 k at the cost of an explicit stage, and are L-stable for them. Scenes with contacts have one
            method, "contact" (order 1), which "auto" stands for.
        record_every : int
            Steps between two rows.
        pd : PD(kp, kd, target, target_rate)
            Control law that is evaluated within the step.
        armature, damping, stiffness, friction : (nv,) or float, optional
            Instead of the scene's.
        rest : (nq,), optional
            Configuration where springs are at rest, instead of the scene's.
        friction_speed : float, optional
            Zero or None: exact Coulomb friction. A joint at rest stays exactly at rest while friction can hold it. Positive: regularized friction
            -f v / sqrt(v^2 + friction_speed^2), with which joints creep, rad/s or m/s. None stands for 0.01 in scenes with contacts or
            connections, where friction is always regularized: Trajectory.friction_speed reports it.
        form : str
            "auto" recomputes a step whose estimated error exceeds the tolerance in square-root form; "covariance" checks the pivots only.
        tolerance : float, optional
            Of form "auto", as in forward_dynamics.
        progress : callable, optional
            Called with (steps done, steps) at most twenty times per second.
        conserve_momentum : bool
            Each floating tree conserves its momentum, and its center of mass follows its parabola, to rounding: each step ends with a rigid motion of the tree,
            as large as the step's error in them, O(N). Every tree must be connected to the base by a free joint without tau, pd, damping, stiffness, friction
            or armature.
        compliance : float or array_like (m,), optional
            Compliance of each row of the connections, (m/s^2)/N or (rad/s^2)/(N m), zero or above, in the order of connection_rows: accelerations, and the projection that ends each
            step, let rows give way by it, and states need not meet the connections at the start. The default is none.
        baumgarte : float, optional
            For scenes with connections. None: positions and velocities are projected onto them after each step (see project). A rate a in 1/s:
            J qdd + J' qd = -2 a J qd - a^2 error.
        limits : str, optional
            "stop", the default: joint limits are stops that a joint with one degree of freedom does not pass. "report": limits do nothing, and
            Trajectory.violations lists them. A joint that starts outside of its limits is moved back without a jump of its velocity, with a LimitWarning.
        restitution : float
            Coefficient of restitution of the stops, 0 to 1. A rebound that would end within the step is none.
        accuracy : float, optional
            Error control: the estimated error of each substep, in rad or m and relative to the fastest joint velocity where that exceeds 1, is at most this. Changes between
            sticking and sliding and impacts on stops are located within 1e-7 dt. Trajectory.estimated_error is the sum of the estimates.
        duration : float, optional
            Simulated time, s, instead of steps.

        Returns
        -------
        Trajectory
            Rows t (rows,), q (..., rows, nq), qd (..., rows, nv), the first at the start; integrator, substeps, events and stops; energy_audit() and error_estimate();
            momentum_correction, drift and contacts where they apply. Bit for bit the same for any number of threads.

        Raises
        ------
        SimulationError
            Motion diverges, a pivot is lost, connections cannot hold, no impulses meet the law of contacts to 1e-5, or tau raises. .trajectory has the rows of the finished steps.
        SimulationInterrupted
            Ctrl-C (a KeyboardInterrupt), likewise.
        ConstraintError
            A start that does not meet the connections.
        OutOfMemoryError, ShapeError, NotFiniteError, ArgumentError
            Each names the argument and the state.

        Notes
        -----
        O(N) per stage. A step in which a joint sticks, slips or meets a stop is one implicit Euler step whose set-valued law is solved by block principal pivoting, with one
        factorization per pivot; a short substep where joints are fast. In scenes with contacts (see SceneBuilder.contact) each step ends with impulses that meet their law, and
        approaches faster than what gravity gives in a step rebound by Poisson's law; O(N + m^2 depth + m^3) for m rows of contacts that touch.

        Examples
        --------
        >>> import phipsi
        >>> scene = phipsi.scenes.chain(3)
        >>> path = scene.simulate([0.3, 0.2, 0.1], [0.0] * 3, dt=1e-3, steps=1000, record_every=100)
        >>> path.q.shape, path.integrator
        ((11, 3), 'rk4')
        """

    def simulator(
        self,
        q: ArrayLike,
        qd: ArrayLike | None = None,
        *,
        dt: float,
        method: _Method = "auto",
        pd: PD | tuple[ArrayLike, ...] | None = None,
        armature: ArrayLike | None = None,
        damping: ArrayLike | None = None,
        stiffness: ArrayLike | None = None,
        rest: ArrayLike | None = None,
        friction: ArrayLike | None = None,
        friction_speed: float | None = None,
        form: Literal["auto", "covariance"] = "auto",
        tolerance: float | None = None,
        conserve_momentum: bool = False,
        baumgarte: float | None = None,
        compliance: ArrayLike | None = None,
        limits: Literal["stop", "report"] | None = None,
        restitution: float = 0.0,
        accuracy: float | None = None,
    ) -> Simulator:
        """Creates a simulator: states that are advanced call by call, as a controller or a learner does.

        Parameters
        ----------
        q : (..., nq)
            Configurations at the start.
        qd : (..., nv), optional
            Joint velocities at the start; zero by default. Leading axes broadcast to those of the batch.
        dt : float
            Step, s.
        method, pd, armature, damping, stiffness, rest, friction, friction_speed, form, tolerance, conserve_momentum, baumgarte, compliance, limits, restitution, accuracy
            As in simulate, for all steps.

        Returns
        -------
        Simulator
            Simulator.step(tau) costs one forward dynamics per stage, and some tenths of a microsecond.

        Raises
        ------
        OutOfMemoryError, ShapeError, NotFiniteError, ArgumentError
            Each names the argument and the state.

        Examples
        --------
        >>> import phipsi
        >>> simulator = phipsi.scenes.chain(3).simulator([0.3, 0.2, 0.1], dt=1e-3)
        >>> simulator.step(steps=10)
        >>> simulator.steps
        10
        """
    def ode(
        self,
        *,
        tau: ArrayLike | Callable[[float, _Array, _Array], ArrayLike] | None = None,
        pd: PD | tuple[ArrayLike, ...] | None = None,
        damping: ArrayLike | None = None,
        stiffness: ArrayLike | None = None,
        rest: ArrayLike | None = None,
        friction: ArrayLike | None = None,
        friction_speed: float = 0.01,
    ) -> Ode:
        """The equations of motion for SciPy's solve_ivp: right side and Jacobian in tangent coordinates, and a solver with error control
        on the manifold.

        tau: (nv,), constant, or a function of (t, q, qd), which is asked at every stage. pd, damping, stiffness, rest, friction:
        as in simulate; friction_speed: positive, rad/s or m/s, for the solvers need smooth friction. Returns an Ode; Ode.solve(q, qd, t_span, method=..., rtol=..., atol=...) gives a Trajectory.

        Raises ImportError without SciPy; ShapeError, NotFiniteError, ArgumentError.
        """

    @overload
    def inverse_dynamics(  # type: ignore[overload-overlap]
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        *,
        wrenches: Mapping[str, ArrayLike] | None = None,
        out: _Array | None = None,
        dtype: _Float64 = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """Joint torques from joint accelerations, in O(N), gravity and armature included.

        q: (..., nq); qd, qdd: (..., nv); SI units, radians; leading axes broadcast. wrenches, out, dtype and errors as in forward_dynamics.

        **tau of a free joint is (force, moment), as its qd and qdd are (linear, angular); wrenches are (moment, force).**

        Returns tau, (..., nv) = H phi (Q lambda + b) + armature qdd - J^T w (1.5, 2.9, 2.10).

        Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
        """

    @overload
    def inverse_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        *,
        wrenches: Mapping[str, ArrayLike] | None = None,
        out: _Single | None = None,
        dtype: _Float32,
        errors: _Errors = "raise",
    ) -> _Single: ...

    @overload
    def bias_torque(  # type: ignore[overload-overlap]
        self, q: ArrayLike, qd: ArrayLike, *, out: _Array | None = None, dtype: _Float64 = None, errors: _Errors = "raise"
    ) -> _Array:
        """The bias torque H phi b: what the joints must give so that none accelerates, gravity included.

        q: (..., nq); qd: (..., nv); leading axes broadcast; out, dtype and errors as in forward_dynamics. Returns (..., nv), N m or N.

        Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
        """

    @overload
    def bias_torque(
        self, q: ArrayLike, qd: ArrayLike, *, out: _Single | None = None, dtype: _Float32, errors: _Errors = "raise"
    ) -> _Single: ...

    @overload
    def gravity_torque(  # type: ignore[overload-overlap]
        self, q: ArrayLike, *, out: _Array | None = None, dtype: _Float64 = None, errors: _Errors = "raise"
    ) -> _Array:
        """The torques that hold the scene against gravity, dU/dq along the tangent of q: the bias torque at rest.

        q: (..., nq); out, dtype and errors as in forward_dynamics. Returns (..., nv), N m or N. O(N).

        Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
        """

    @overload
    def gravity_torque(
        self, q: ArrayLike, *, out: _Single | None = None, dtype: _Float32, errors: _Errors = "raise"
    ) -> _Single: ...

    @overload
    def mass_matrix(  # type: ignore[overload-overlap]
        self, q: ArrayLike, *, out: _Array | None = None, dtype: _Float64 = None, errors: _Errors = "raise"
    ) -> _Array:
        """The joint-space mass matrix, the covariance of the measurements (5.1), armature on its diagonal.

        q: (..., nq); out, dtype and errors as in forward_dynamics. Returns (..., nv, nv), full and exactly symmetric, SI units. Large batches of
        matrices take less time into an out that was used before: new memory is cleared by the system first.

        Raises ArgumentError above 4000 degrees of freedom: inverse_dynamics multiplies by the matrix without forming it.
        Raises ShapeError, NotFiniteError, ArgumentError for a bad q, naming the state.
        """

    @overload
    def mass_matrix(
        self, q: ArrayLike, *, out: _Single | None = None, dtype: _Float32, errors: _Errors = "raise"
    ) -> _Single: ...

    @overload
    def mass_matrix_inverse(  # type: ignore[overload-overlap]
        self, q: ArrayLike, *, form: _Form = "auto", tolerance: float | None = None, out: _Array | None = None, dtype: _Float64 = None, errors: _Errors = "raise"
    ) -> _Array:
        """The inverse of the mass matrix in closed form (6.1), without forming or factoring the matrix.

        q: (..., nq). form, tolerance, out, dtype and errors: as in forward_dynamics, the error being that of the factor of M. Returns (..., nv, nv), full and exactly symmetric, SI units: the tree's,
        whatever connections there are (constrained_mass_matrix_inverse is through them).

        Raises ArgumentError above 4000 degrees of freedom: forward_dynamics multiplies by the inverse without forming it.
        Raises SingularJointError, ShapeError, NotFiniteError, ArgumentError, naming the state.
        """

    @overload
    def mass_matrix_inverse(
        self, q: ArrayLike, *, form: _Form = "auto", tolerance: float | None = None, out: _Single | None = None, dtype: _Float32, errors: _Errors = "raise"
    ) -> _Single: ...

    def placements(self, q: ArrayLike, *, errors: _Errors = "raise") -> dict[str, _Array]:
        """Where every link is: a dict from link names to homogeneous matrices, link frame to base frame.

        q: (..., nq). Each value: (..., 4, 4), [[R, p], [0, 1]] with p in m; an array of its own, in the order of link_names.

        errors: as in forward_dynamics. Raises ShapeError, NotFiniteError, ArgumentError for a bad q, naming the state.
        """

    def placement(self, q: ArrayLike, link: str | Iterable[str], *, errors: _Errors = "raise") -> _Array:
        """Where a link is, or several: homogeneous matrices, link frame to base frame.

        q: (..., nq). link: a name, or a sequence of L names (links on the base and repeated ones too). Only the joints between the base and these links
        are computed: O(depth); placements has all links by name.

        Returns (..., 4, 4) for a name, (..., L, 4, 4) for a sequence: [[R, p], [0, 1]] with p in m.

        errors: as in forward_dynamics. Raises ArgumentError for an unknown link; ShapeError, NotFiniteError, ArgumentError for a bad q, naming the state.
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
        """The velocity of a link against the base, (angular, linear): J qd.

        q: (..., nq); qd: (..., nv); leading axes broadcast. link: its name. at: a point (3,) in the link's frame, m, that stays where it is on the link;
        the link's origin by default. frame: what the velocity is written in,

        - "local": the point's velocity in the link's axes;
        - "local-world-aligned": the same in the base's axes;
        - "world": the spatial velocity in the base's frame: the linear half is that of what is on the link at the base's origin, whatever at is.

        They are Pinocchio's LOCAL, LOCAL_WORLD_ALIGNED and WORLD, angular half first. Returns (..., 6), rad/s and m/s. O(depth).

        errors: as in forward_dynamics. Raises ArgumentError for an unknown link or frame; ShapeError, NotFiniteError, ArgumentError, each naming the
        argument and the state.
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
        """The acceleration of a link against the base, (angular, linear), at joint accelerations qdd; gravity is not in it.

        q: (..., nq); qd, qdd: (..., nv); leading axes broadcast. link, frame, at: as in velocity. kind: "spatial", the rate of the spatial velocity, as
        in Newton and Euler's equations of motion; or "classical", whose linear half is the acceleration of the point itself: w x v more.

        Returns (..., 6), rad/s^2 and m/s^2. O(depth).

        errors: as in forward_dynamics. Raises ArgumentError for an unknown link, frame or kind; otherwise as velocity.
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
        """The Jacobian J of a link: its velocity (angular, linear) is J qd.

        q: (..., nq). link, frame, at: as in velocity; by default at the link's origin and in its own frame. Returns (..., 6, nv), SI units; in frame
        "local" a wrench w on the link there gives the joint torques J^T w. Columns of joints that do not move the link are zero.

        errors: as in forward_dynamics. Raises ArgumentError for an unknown link or frame; ShapeError, NotFiniteError, ArgumentError, each naming the
        argument and the state.
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
        """The rate J' of the Jacobian of a link along qd, entry by entry as jacobian writes it in this frame.

        q: (..., nq); qd: (..., nv); leading axes broadcast. link, frame, at: as in velocity. Returns (..., 6, nv), SI units.

        J qdd + J' qd is the spatial acceleration in the frames "local" and "world". The frame "local-world-aligned" moves with the point but does not
        turn, so that it is the classical one there. jacobian_rate_product has J' qd alone, in O(depth).

        errors: as in forward_dynamics. Raises as jacobian.
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
        """J' qd of a link, without J': the acceleration that rates alone give, as jacobian_rate @ qd.

        q: (..., nq); qd: (..., nv); leading axes broadcast. link, frame, at: as in velocity. Returns (..., 6), rad/s^2 and m/s^2: spatial in the frames
        "local" and "world", classical in "local-world-aligned". O(depth).

        errors: as in forward_dynamics. Raises as jacobian.
        """

    def inverse_dynamics_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        *,
        wrenches: Mapping[str, ArrayLike] | None = None,
        out: _Array | None = None,
        errors: _Errors = "raise",
    ) -> InverseDynamicsDerivatives:
        """Derivatives of inverse dynamics, in the tangent space of q: dtau/dq, dtau/dqd and dtau/dqdd = M, analytic, in O(N depth).

        q: (..., nq); qd, qdd: (..., nv); SI units, radians; leading axes broadcast. wrenches and errors: as in forward_dynamics; they stay as they
        are in their link's frame.

        Row i is the torque tau_i. Column j of dtau_dq is the derivative along integrate(q, v) by v_j: an angle or a length for joints of one axis, a
        rotation in the child's frame for spherical joints, (linear, angular) in the child's frame for free joints. Armature is in M alone. Entries of
        joints on different branches are zero.

        out: C-contiguous float64, (..., 3, nv, nv), overlapping no argument, of which the results are views; large batches take half the time into one that was
        used before.

        Returns a phipsi.InverseDynamicsDerivatives (dtau_dq, dtau_dqd, M), each (..., nv, nv), SI units.

        Raises ArgumentError above 4000 degrees of freedom; ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
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
        out: _Array | None = None,
        errors: _Errors = "raise",
    ) -> ForwardDynamicsDerivatives:
        """Derivatives of forward dynamics, in the tangent space of q: dqdd/dq = -M^-1 dtau/dq, dqdd/dqd = -M^-1 dtau/dqd and dqdd/dtau = M^-1.

        q: (..., nq); qd, tau: (..., nv); SI units, radians; leading axes broadcast. form, wrenches and errors: as in forward_dynamics; wrenches stay as
        they are in their link's frame. In form "auto" a state is recomputed in double-double arithmetic, which takes some thirty times as long, where the error of
        the factor of M exceeds the tolerance of forward_dynamics, or the estimated error of a derivative 1e-11 of its largest entry. tolerance: replaces both.

        Row i is the acceleration qdd_i; columns as in inverse_dynamics_derivatives, whose results at the accelerations of the state are multiplied by
        M^-1 (6.1).

        out: as in inverse_dynamics_derivatives.

        Returns a phipsi.ForwardDynamicsDerivatives (dqdd_dq, dqdd_dqd, Minv), each (..., nv, nv), SI units.

        Raises SingularJointError where a joint has no inertia along its axis; ArgumentError above 4000 degrees of freedom, and for the square-root form
        of an inertia that no body can have; ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
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
        errors: _Errors = "raise",
    ) -> LinearSystem:
        """The linear system dx/dt = A x + B u of small deviations from the motion through a state, x = (tangent of q, change of qd), u a change of tau.

        q: (..., nq); qd, tau: (..., nv); SI units, radians; leading axes broadcast. form, tolerance, wrenches and errors: as in forward_dynamics_derivatives.

        A = [[-ad(qd), 1], [dqdd_dq, dqdd_dqd]], B = [[0], [M^-1]]. ad(qd) is zero at rest and for joints of one axis; it is the cross product by the
        angular velocity for spherical joints, and the bracket of (linear, angular) velocities for free joints, since the deviation is in axes that turn
        with the motion: difference(q, q of the neighbour).

        Returns a phipsi.LinearSystem (A, B), (..., 2 nv, 2 nv) and (..., 2 nv, nv), in continuous time, SI units.

        Raises as forward_dynamics_derivatives.
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
        errors: _Errors = "raise",
    ) -> _Array:
        """The change of joint torques along a direction, in O(N) and without any matrix: dtau_dq dq + dtau_dqd dqd + M dqdd.

        q: (..., nq); qd, qdd: (..., nv); dq, dqd, dqdd: (..., nv), dq in the tangent space of q; SI units, radians; leading axes broadcast. wrenches and errors: as
        in forward_dynamics; wrenches stay as they are in their link's frame.

        dq is a change as integrate(q, dq) adds it: an angle or a length for joints of one axis, a rotation in the child's frame for spherical joints,
        (linear, angular) in the child's frame for free joints. Armature is in M.

        What is constant may change too, as inverse_dynamics_vjp has it: dwrenches, a dict from link names to (..., 6); dparameters, (..., bodies, 10); darmature, (..., nv);
        dgravity, (..., 3).

        Returns dtau, (..., nv), N m or N.

        Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
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
        errors: _Errors = "raise",
    ) -> InverseDynamicsGradients:
        """The gradients of cotangent . tau, in O(N) and without any matrix: cotangent dtau_dq, cotangent dtau_dqd and M cotangent.

        q: (..., nq); qd, qdd, cotangent: (..., nv); SI units, radians; leading axes broadcast. wrenches and errors: as in forward_dynamics. parameters: whether to
        give the gradients by inertias, armature and gravity too.

        The gradient by q is in its tangent space, (..., nv), as dq in inverse_dynamics_jvp.

        Returns a phipsi.InverseDynamicsGradients (q, qd, qdd, wrenches, parameters, armature, gravity); what is not asked for is None.

        Raises as inverse_dynamics_jvp.
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
        errors: _Errors = "raise",
    ) -> _Array:
        """The change of joint accelerations along a direction, in O(N) and without any matrix: dqdd_dq dq + dqdd_dqd dqd + M^-1 dtau.

        q: (..., nq); qd, tau: (..., nv); dq, dqd, dtau: (..., nv), dq in the tangent space of q, as in inverse_dynamics_jvp; SI units, radians; leading axes
        broadcast. form, wrenches and errors: as in forward_dynamics; wrenches stay as they are in their link's frame. tolerance: as in
        forward_dynamics_derivatives.

        dwrenches, dparameters, darmature, dgravity: as in inverse_dynamics_jvp.

        One more right side of the filter, with the gains of the state. In form "auto" a state is recomputed in double-double arithmetic where the estimated error of the
        factor of M or of the product exceeds the tolerance.

        Returns dqdd, (..., nv), rad/s^2 or m/s^2.

        Raises SingularJointError where a joint has no inertia along its axis; ArgumentError for the square-root form of an inertia that no body can have;
        ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
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
        errors: _Errors = "raise",
    ) -> ForwardDynamicsGradients:
        """The gradients of cotangent . qdd, in O(N) and without any matrix: cotangent dqdd_dq, cotangent dqdd_dqd and M^-1 cotangent.

        q: (..., nq); qd, tau, cotangent: (..., nv); SI units, radians; leading axes broadcast. form, tolerance, wrenches and errors: as in forward_dynamics_jvp. parameters: whether
        to give the gradients by inertias, armature and gravity too.

        The gradient by q is in its tangent space, (..., nv), as dq in inverse_dynamics_jvp. x = M^-1 cotangent is filter and smoother once more; all other
        gradients are those of inverse_dynamics_vjp at the accelerations of the state, of -x.

        Returns a phipsi.ForwardDynamicsGradients (q, qd, tau, wrenches, parameters, armature, gravity); what is not asked for is None.

        Raises as forward_dynamics_jvp.
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
        errors: _Errors = "raise",
    ) -> InverseDynamicsGradients:
        """The Hessian of cotangent . tau times a direction, in O(N): how the gradients of inverse_dynamics_vjp change along (dq, dqd, dqdd).

        q: (..., nq); qd, qdd, cotangent, dq, dqd, dqdd: (..., nv); SI units, radians; leading axes broadcast. wrenches and errors: as in forward_dynamics.

        The gradient by q is that in the tangent space at q, which moves along: on spherical and free joints that Hessian is not symmetric. One state at a time,
        on dual numbers.

        Returns a phipsi.InverseDynamicsGradients (q, qd, qdd), the others None.

        Raises as inverse_dynamics_jvp.
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
        errors: _Errors = "raise",
    ) -> ForwardDynamicsGradients:
        """The Hessian of cotangent . qdd times a direction, in O(N): how the gradients of forward_dynamics_vjp change along (dq, dqd, dtau).

        q: (..., nq); qd, tau, cotangent, dq, dqd, dtau: (..., nv); SI units, radians; leading axes broadcast. form, tolerance, wrenches and errors: as
        in forward_dynamics_jvp.

        One factor and four right sides; otherwise as inverse_dynamics_hvp.

        Returns a phipsi.ForwardDynamicsGradients (q, qd, tau), the others None.

        Raises as forward_dynamics_jvp.
        """

    def coriolis_matrix(
        self, q: ArrayLike, qd: ArrayLike, *, out: _Array | None = None, errors: _Errors = "raise"
    ) -> _Array:
        """The Coriolis matrix C: C qd is the torque of the rates alone, and dM/dt - 2 C is antisymmetric.

        q: (..., nq); qd: (..., nv); leading axes broadcast; out and errors as in forward_dynamics. Returns (..., nv, nv), SI units. For joints of one axis it is the one
        of Christoffel's symbols. Computed in O(N depth).

        Raises ArgumentError above 4000 degrees of freedom; ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
        """

    def mass_matrix_derivative(
        self, q: ArrayLike, qd: ArrayLike, *, out: _Array | None = None, errors: _Errors = "raise"
    ) -> _Array:
        """dM/dt, how the mass matrix changes along the rates: C + C^T with the Coriolis matrix C.

        q: (..., nq); qd: (..., nv); leading axes broadcast; out and errors as in forward_dynamics. Returns (..., nv, nv), exactly symmetric, SI units. Armature is
        constant and not in it. Computed in O(N depth).

        Raises ArgumentError above 4000 degrees of freedom; ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
        """

    def operational_inverse_inertia(
        self,
        q: ArrayLike,
        links: str | Iterable[str],
        *,
        xyz: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        form: _Form = "auto",
        tolerance: float | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """The operational-space inverse inertia J M^-1 J^T of links, in O(N) from the co-states' covariance (5.6, 5.7, Psi A).

        q: (..., nq). links: a name, or m names (links on the base and repeated ones too). xyz: (3,) or (m, 3), m, and
        rotation: (3, 3) or (m, 3, 3): the task frame's origin and axes in its link's frame, by default the link's own; the same
        for the whole batch. form, tolerance and errors: as in forward_dynamics.

        Returns (..., 6m, 6m), full and exactly symmetric, SI units. Wrenches (moment, force) on the frames, each at its origin and in
        its axes, stacked, times this is how they change the frames' (angular, linear) accelerations, in the tree without connections. Defined in singular
        configurations too, where operational_inertia is not; zero for links on the base.

        Raises ArgumentError for an unknown link, no link, or a rotation that is none (to within 1e-9); SingularJointError, ShapeError,
        NotFiniteError, naming the state.
        """

    def operational_inertia(
        self,
        q: ArrayLike,
        links: str | Iterable[str],
        *,
        xyz: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        directions: ArrayLike | None = None,
        form: _Form = "auto",
        tolerance: float | None = None,
        errors: _Errors = "raise",
    ) -> _Array:
        """The operational-space inertia (S J M^-1 J^T S^T)^-1 of task directions S.

        q, links, xyz, rotation, form, tolerance, errors: as in operational_inverse_inertia. directions: S, (k, 6m), each row a direction over the
        stacked (angular, linear) velocities of the frames; all 6m by default; the same for the whole batch.

        Returns (..., k, k), exactly symmetric and positive definite.

        Raises SingularTaskError, with .links, .rank, .directions and .state, where the scene cannot move in all directions
        independently: an eigenvalue of the inverse inertia, each direction scaled to the terms that form it, is not above
        64 k eps. Otherwise as operational_inverse_inertia.
        """

    @property
    def connection_names(self) -> tuple[str, ...]:
        """Names of the connections that close loops, in the order they were made: the keys of the forces of constrained_dynamics."""

    @property
    def tolerance(self) -> float:
        """Geometric tolerance of linkages, an angle in rad or a length over the reach of the loop: see SceneBuilder.build. Zero with strict=True."""

    def connection_rows(self, connection: str, /) -> slice[int, int, int]:
        """Where a connection is among the rows of constraint_error, constraint_bias and constraint_jacobian, a slice.

        Raises ArgumentError, with the names that there are, for an unknown connection.
        """

    def without_connections(self) -> Scene:
        """The same tree without the connections, for what knows trees only."""

    @property
    def contact_names(self) -> tuple[str, ...]:
        """Names of the contacts, in the order they were made: the last axis of contact_gaps, and the keys of Trajectory.contacts."""

    def contact_gaps(self, q: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """How far each contact is above its plane, (..., contacts), m; below zero where it is under it.

        q: (..., nq). errors: as in forward_dynamics. O(depth) each.

        Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
        """

    def contact_velocities(self, q: ArrayLike, qd: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """The velocity of the point of each link that is nearest to its contact's plane, (..., contacts, 3), m/s, in the base frame.

        q: (..., nq); qd: (..., nv). errors: as in forward_dynamics. O(depth) each.

        Raises as contact_gaps.
        """

    def without_contacts(self) -> Scene:
        """The same scene without the contacts, for what knows none."""

    def constraint_error(self, q: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """How far each row of the connections is from holding, (..., m): the rows of one connection are those of connection_rows.

        q: (..., nq). errors: as in forward_dynamics. Origins in m, in the first frame's axes; rotations as 2 sin(t/2) about their axis, t the angle,
        which is t where it is small; of an axis the two directions across it: the first frame's x and y, turned with it the short way from z to the
        axis; angular rows before linear ones. A distance less its length, m; the coordinate of a joint less what it should be.

        Raises ConstraintError for a rod whose ends coincide; ShapeError, NotFiniteError, ArgumentError, naming the state.
        """

    def constraint_jacobian(self, q: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """The Jacobian of the connections, (..., m, nv): J qd is the rate of constraint_error, exactly and at every q.

        q: (..., nq). errors: as in forward_dynamics. O(m depth), beside the zeros.

        Raises as constraint_error.
        """

    def constraint_bias(self, q: ArrayLike, qd: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """J' qd of the connections, (..., m): the second derivative of constraint_error where no joint accelerates.

        q: (..., nq); qd: (..., nv). errors: as in forward_dynamics. O(m depth).

        Raises as constraint_error.
        """

    def constrained_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        *,
        compliance: ArrayLike | None = None,
        form: _Form = "auto",
        tolerance: float | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        errors: _Errors = "raise",
    ) -> ConstrainedDynamics:
        """Joint accelerations through the connections, and the forces of these: M qdd + bias = tau + J^T forces with J qdd + J' qd = 0.

        q: (..., nq); qd, tau: (..., nv). form, tolerance, wrenches, errors: as in forward_dynamics, the error being that of the tree's factor. Unit forces along the rows run inward through the tree's
        filter; their Gram matrix is J M^-1 J^T. O(N + m^2 depth + m^3) for m rows.

        compliance: how much each row gives way, (m/s^2)/N or (rad/s^2)/(N m), zero or above: one number, or (..., m) in the order of connection_rows. The rows are J qdd + J' qd =
        -compliance forces then, measurements with that noise: rows that contradict each other get a compromise, and rows that depend on each other share their force by it.

        Returns a phipsi.ConstrainedDynamics: qdd (..., nv); forces, a dict from names of connections to (..., rows); rank (...) and residual (...). A
        force is what the connection does to its link, (moment, force) as far as it has rows of them, at the origin of its first frame and in that
        frame's axes; the other link gets the opposite. That of a rod is positive where it pushes, that of a coupling acts along its joint. Where rows
        depend on each other, qdd is unique and the forces are those of least sum (J M^-1 J^T)_ii forces_i^2.

        Raises ConstraintError, with .connections, .residual and .state, where no forces meet all rows: connections that contradict each other; and
        where positions or velocities are further than 1e-3 from the connections (m or rad; m/s or rad/s, relative to the fastest joint where that is faster than 1; see project), unless compliance
        is given. Otherwise as forward_dynamics.
        """

    def project(
        self, q: ArrayLike, qd: ArrayLike | None = None, *, compliance: ArrayLike | None = None, errors: _Errors = "raise"
    ) -> Projection:
        """The configuration nearest to q that meets the connections, and the velocities nearest to qd that keep them so.

        q: (..., nq); qd: (..., nv) or None. errors: as in forward_dynamics. Newton steps -M^-1 J^T (J M^-1 J^T)^+ error, each of least kinetic
        energy, and no longer than 0.5 rad or m at any joint; velocities less M^-1 J^T (J M^-1 J^T)^+ J qd, as by an impact without rebound.

        compliance: how much each row gives way, as in constrained_dynamics: one number, or (..., m). The result is then where half the squared distance from q, by kinetic energy, plus
        the sum of error^2/(2 compliance) is least.

        Combinations of rows that move joints by less than Scene.tolerance, where the linkage that is meant has a rank that is lower by as many, count as dependent: a linkage that is drawn with
        few digits keeps its mobility. Their errors stay, at most 10 times the tolerance, and constraint_error gives them.

        Returns a phipsi.Projection: q, qd (None without one), and rank (...), how many rows are independent there: fewer than elsewhere where the
        mechanism is singular.

        Warns LinkageWarning, once for a scene, where rows count as dependent that are not to within rounding, and where axes of a loop miss being parallel by little more than the tolerance.

        Raises ConstraintError, with .connections, .residual and .state, where an error stays: no small moves from there meet the connections;
        SingularJointError, ShapeError, NotFiniteError, ArgumentError, naming the state.
        """

    def constrained_inverse_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        *,
        actuated: Iterable[str] | ArrayLike | None = None,
        form: _Form = "auto",
        tolerance: float | None = None,
        wrenches: Mapping[str, ArrayLike] | None = None,
        errors: _Errors = "raise",
    ) -> ConstrainedInverseDynamics:
        """Joint torques, and forces of the connections, that give the accelerations: tau + J^T forces = M qdd + bias.

        q: (..., nq); qd, qdd: (..., nv). actuated: names of joints with motors, or a boolean array (nv,); None: all. tau is zero at the others. Where
        that leaves a choice, tau has the least tau^T M^-1 tau: torques that do not load the connections. wrenches, form, tolerance, errors: as in
        forward_dynamics.

        Returns a phipsi.ConstrainedInverseDynamics: tau (..., nv); forces, rank as in constrained_dynamics; residual (...), the largest entry of J
        qdd + J' qd: where it is not rounding, no torques give these accelerations.

        Raises ArgumentError, named actuated, where a joint without a motor would need a torque; otherwise as inverse_dynamics.
        """

    def constrained_mass_matrix_inverse(self, q: ArrayLike, *, form: _Form = "auto", tolerance: float | None = None, errors: _Errors = "raise") -> _Array:
        """How torques accelerate the joints through the connections, (..., nv, nv): M^-1 - M^-1 J^T (J M^-1 J^T)^+ J M^-1, symmetric and of lower rank.

        q: (..., nq). form, tolerance, errors: as in forward_dynamics. A Gram matrix: nothing is subtracted, and no eigenvalue is negative beyond rounding. O(nv^3).

        Raises ArgumentError above 4000 degrees of freedom; otherwise as mass_matrix_inverse and constraint_error.
        """

    def energy(self, q: ArrayLike, qd: ArrayLike, *, errors: _Errors = "raise") -> Energy:
        """Kinetic energy (armature included) and potential energy, as the named tuple Energy(kinetic, potential).

        q: (..., nq); qd: (..., nv); leading axes broadcast. Each (...), J; the potential is zero with the mass centre at the
        base's origin.

        errors: as in forward_dynamics. Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
        """

    def kinetic_energy(self, q: ArrayLike, qd: ArrayLike, *, errors: _Errors = "raise") -> _Array | np.float64:
        """Kinetic energy alone, armature included: half of qd M qd.

        q: (..., nq); qd: (..., nv); leading axes broadcast. Returns (...), J. O(N).

        errors: as in forward_dynamics. Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
        """

    def momentum(self, q: ArrayLike, qd: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """Spatial momentum of all moving bodies: (angular about the base's origin, linear), in the base frame.

        q: (..., nq); qd: (..., nv); leading axes broadcast. Returns (..., 6), N m s and N s. Armature adds nothing here.

        errors: as in forward_dynamics. Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
        """

    def center_of_mass(self, q: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """The mass centre of all links that move, in the base frame.

        q: (..., nq). Returns (..., 3), m, from the base's origin. O(N). Links on the base are not part of it.

        errors: as in forward_dynamics. Raises ArgumentError where nothing that moves has mass; ShapeError, NotFiniteError, ArgumentError for a bad q,
        naming the state.
        """

    def center_of_mass_velocity(self, q: ArrayLike, qd: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """The velocity of the mass centre in the base's axes: linear momentum by mass.

        q: (..., nq); qd: (..., nv); leading axes broadcast. Returns (..., 3), m/s. O(N).

        errors: as in forward_dynamics. Raises as center_of_mass, naming the argument.
        """

    def center_of_mass_acceleration(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """The acceleration of the mass centre in the base's axes, at joint accelerations qdd; gravity is not in it.

        q: (..., nq); qd, qdd: (..., nv); leading axes broadcast. Returns (..., 3), m/s^2: times total_mass it is the force from outside, weight included,
        that such a motion takes. O(N).

        errors: as in forward_dynamics. Raises as center_of_mass, naming the argument.
        """

    def center_of_mass_jacobian(self, q: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """The Jacobian J of the mass centre: its velocity in the base's axes is J qd.

        q: (..., nq). Returns (..., 3, nv), SI units: the linear rows of centroidal_momentum_matrix by mass. O(N).

        errors: as in forward_dynamics. Raises as center_of_mass.
        """

    def centroidal_momentum_matrix(self, q: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """The centroidal momentum matrix A: the momentum of all links that move, (angular about the mass centre, linear) in the base's axes, is A qd.

        q: (..., nq). Returns (..., 6, nv), SI units. O(N): column j is r S of the composite inertia (3.5) of what is outboard of joint j. Armature adds
        nothing. Rows are angular, then linear; Pinocchio's Ag has (linear, angular).

        errors: as in forward_dynamics. Raises as center_of_mass.
        """

    def centroidal_momentum_matrix_rate(self, q: ArrayLike, qd: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """The rate A' of the centroidal momentum matrix along qd: the momentum about the mass centre changes at A qdd + A' qd.

        q: (..., nq); qd: (..., nv); leading axes broadcast. Returns (..., 6, nv), SI units, rows as those of A. O(N). For a tree that floats that is
        weight and wrenches, the moment about the mass centre.

        errors: as in forward_dynamics. Raises as center_of_mass, naming the argument.
        """

    def integrate(self, q: ArrayLike, v: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """The configuration reached from q by the constant velocity v in unit time, on the manifold.

        q: (..., nq); v: (..., nv); leading axes broadcast. Returns (..., nq), quaternions of unit norm. A free joint moves
        along the screw of its twist, a spherical joint turns about its rate, all others add.

        errors: as in forward_dynamics. Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
        """

    def difference(self, q0: ArrayLike, q1: ArrayLike, *, errors: _Errors = "raise") -> _Array:
        """The velocity that takes q0 to q1 in unit time, the inverse of integrate; rotations go the short way.

        q0, q1: (..., nq); leading axes broadcast. Returns (..., nv), SI units.

        errors: as in forward_dynamics. Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
        """

    def lock(self, joints: Iterable[str], q: ArrayLike) -> Scene:
        """A new scene with the named joints fixed where q, (nq,), has them; names of links stay.

        What is locked is folded into the bodies around it and costs nothing. Locking "root_joint" gives a fixed base.

        Raises ArgumentError for an unknown joint; ShapeError, NotFiniteError or ArgumentError for a bad q.
        """

    def link(self, name: str, /) -> Link:
        """The link of that name, those on fixed joints too: the named tuple Link(name, mass, com, inertia, parent, joint).

        Raises ArgumentError, with the names that there are, for an unknown link.
        """

    def joint(self, name: str, /) -> Joint:
        """The joint of that name, fixed ones too: the named tuple Joint(name, type, parent, child, xyz, ...).

        Raises ArgumentError, with the names that there are, for an unknown joint.
        """

    @property
    def links(self) -> dict[str, Link]:
        """All links by name, in the order of link_names: a dict of Link, made anew."""

    @property
    def joints(self) -> dict[str, Joint]:
        """All joints by name, fixed ones too, in the order they were given, a floating base's first: a dict of Joint, made anew."""

    def _connections(self) -> list[tuple[Any, ...]]: ...
    def _contacts(self) -> list[tuple[Any, ...]]: ...
    def to_builder(self) -> SceneBuilder:
        """A builder that holds what the scene was made of: links, joints, gravity, base, and what is left out.

        build() without arguments gives a scene with the same results, bit for bit; links and joints can be added before.
        """

    def with_properties(
        self,
        *,
        armature: Mapping[str, ArrayLike] | ArrayLike | None = None,
        damping: Mapping[str, ArrayLike] | ArrayLike | None = None,
        friction: Mapping[str, ArrayLike] | ArrayLike | None = None,
        stiffness: Mapping[str, ArrayLike] | ArrayLike | None = None,
    ) -> Scene:
        """A new scene with other properties of joints; what is not given stays.

        armature: kg m^2 or kg; damping: N m s/rad or N s/m; friction: N m or N; stiffness: N m/rad or N/m. Each is a dict from joint
        names to numbers, one number for all movable joints (a floating base's "root_joint" among them: name joints to leave it out),
        or an array: (nv,), or a number a joint in the order of joint_names. A joint has one number for all its degrees of freedom.

        Raises ArgumentError, named after the property, for a joint that is unknown or fixed and for a value that is negative or
        not finite; ShapeError.
        """

    def with_payload(
        self, link: str, mass: float, com: ArrayLike = (0, 0, 0), inertia: ArrayLike | None = None
    ) -> Scene:
        """A new scene with a rigid body added to a link: what a gripper holds, a tool, a battery.

        link: its name. mass: kg. com: (3,), the body's mass centre in the link's frame, m. inertia: (3, 3), about that mass centre,
        axes parallel to the link's frame, kg m^2; None for a point mass. On a link of the base it changes nothing.

        Raises ArgumentError for an unknown link and for a mass that is negative; ShapeError, ArgumentError for arrays. Warns
        InertiaWarning where link and body together have an inertia that no body can have.
        """

    def with_inertias(self, links: Mapping[str, tuple[float, ArrayLike, ArrayLike | None]]) -> Scene:
        """A new scene whose named links have other inertias: of a better model, of an identification, of a random robot for learning.

        links: from names to (mass, com, inertia): kg; (3,), the mass centre in the link's frame, m; (3, 3), about the mass centre, axes parallel to the link's
        frame, kg m^2, or None for a point mass. Other links keep theirs, those that are fixed onto a named one too.

        Raises ArgumentError for an unknown link and for a mass that is negative; ShapeError, ArgumentError for arrays, by the link's name. Warns
        InertiaWarning for inertias that no body can have.
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
        errors: _Errors = "raise",
    ) -> _Array:
        """Joint velocities that reduce the tasks' errors, one step of a control loop: within velocity and position limits.

        tasks: as in inverse_kinematics; targets with leading axes are a batch, which broadcasts with that of q. q:
        (..., nq). dt: the time that the velocities are held, s. gain: the share of the errors that is taken away in it;
        below 1 errors fall exponentially. damping: of the largest entry of J^T J over deviations; more keeps velocities
        small near singular configurations. limits: whether joints, and joints that follow them, keep to theirs; a joint
        beyond its position limit returns as fast as its velocity limit allows, whatever the tasks want. velocity:
        velocity limits instead of those of the joints, (..., nv) or one number, rad/s and m/s, infinite for none: a
        floating base has limits only here. errors: as in forward_dynamics.

        Minimizes half the squares of J qd dt + gain e over the standard deviations, and damping, over the velocities
        that limits and connections allow: exactly, by a projected Newton method. Connections are hard constraints:
        errors that they have at q are taken away, as far as limits allow. Where that step would raise the cost, or pass
        its minimum along the way, it is computed again with more damping, so that joints come to rest where a target is
        out of reach. O(tasks depth + nv^3).

        Returns qd, (..., nv), rad/s and m/s.

        Raises as inverse_kinematics; ArgumentError for a dt, gain or damping that is not above zero.
        """

    def inverse_kinematics(
        self,
        tasks: Task | Collection[Task],
        q0: ArrayLike | None = None,
        *,
        starts: int = 20,
        posture: float | None = None,
        limits: bool = True,
        tolerance: float = 1e-9,
        iterations: int = 100,
        metric: Literal["coordinates", "mass"] = "coordinates",
        covariance: bool = False,
        seed: int = 0,
        errors: _Errors = "raise",
    ) -> InverseKinematics:
        """Joint positions that meet tasks, within joint limits and with closed connections; the most probable ones.

        tasks: a task of phipsi.tasks or a list of them: Pose, Position, Orientation, Direction, LookAt, CenterOfMass,
        JointPosition; targets with leading axes are a batch, which broadcasts with that of q0. q0: (..., nq), the first
        start; None: neutral. starts: the largest number of configurations that it starts from, those after the first
        drawn within the limits, of a few draws the nearest to the tasks. posture: None, or a standard deviation, rad
        and m: how far joints are expected from q0, for robots that tasks leave free. limits: whether joints, and joints
        that follow them, stay within theirs; a q0 beyond them starts at them, and a joint that has room for a whole
        turn gets past them on the way. tolerance: a task is reached where its error is at most this, m and rad.
        iterations: the largest number of steps from each start. metric: what steps are damped by, "coordinates", or
        "mass", kinetic energy: joints that carry much mass move less. covariance: whether to compute it. seed: of the
        starts. errors: as in forward_dynamics; a bad state has NaN for q and errors, and reached False.

        Minimizes half the squares of all errors over their standard deviations, by Levenberg and Marquardt's steps on
        the manifold, each the exact minimum of its model within the limits: no step makes it worse. Connections are
        hard constraints: every step ends where they are closed. The same bits for any number of threads. O(tasks depth
        + nv^3) a step.

        Returns a phipsi.tasks.InverseKinematics: q, reached, errors, starts, iterations and the covariance.

        Raises ArgumentError for what is no task, unknown links and joints, and values out of range; ShapeError,
        NotFiniteError, naming the task and the state; ConstraintError where no start leads to closed connections.
        """
    def regressor(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, *, errors: _Errors = "raise") -> NDArray[np.float64]:
        """The joint torque regressor Y: torques are linear in the inertial parameters, inverse_dynamics(q, qd, qdd) = Y pi + armature qdd.

        q: (..., nq); qd, qdd: (..., nv); SI units, radians; leading axes broadcast. errors: as in forward_dynamics.

        Entry (i, b, p) is the derivative of torque i by parameter p of the link body_names[b], with what is fixed onto it: the parameters are
        (m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz), in the axes of the link, I about the link's origin, as in Identification.parameters. It is zero where the link is
        not outboard of the joint. Computed in O(N depth).

        Returns (..., nv, bodies, 10).

        Raises ArgumentError for a scene with connections; ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.

        >>> import phipsi
        >>> scene = phipsi.scenes.chain(3)
        >>> scene.regressor([0.1, 0.2, 0.3], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]).shape
        (3, 3, 10)
        """

    def identify(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        tau: ArrayLike,
        *,
        fit: Collection[Literal["armature", "damping", "friction", "offset", "stribeck", "load"]] = (),
        noise: ArrayLike | None = None,
        trust: float = 1.0,
        keep: Collection[str] = (),
        friction_speed: float = 0.01,
        stribeck_speed: float = 0.1,
        time: ArrayLike | None = None,
        transmission: ArrayLike | None = None,
        tau_delay: float = 0.0,
        acceleration_noise: ArrayLike | None = None,
        instruments: tuple[ArrayLike, ArrayLike, ArrayLike] | None = None,
        blocks: int = 20,
    ) -> Identification:
        """The most probable inertias, and what acts at the joints, from measured motion and torques, with intervals that hold for noise of any spectrum.

        Each body gets inertias that a body can have: maximum a posteriori with a Wishart prior on its second moments of mass, which is convex. Intervals are by the
        delete-one-block jackknife over blocks of time, so that they hold where residuals are correlated, which those of real robots are.

        Parameters
        ----------
        q : (k, nq) array_like
            Positions, rad or m, in the order of time.
        qd, qdd : (k, nv) array_like
            Velocities and accelerations, for instance of `phipsi.smooth`.
        tau : (k, nv) array_like
            Measured torques, N m or N; NaN where one was not measured. With `transmission`: of the motors, (k, motors).
        fit : collection of str
            What is found beside inertias, of "armature", "damping", "friction", "offset", "stribeck" (friction that falls with velocity) and "load" (friction proportional to the
            torque that the joint carries). What is not fitted is the model's: its armature, damping, friction and springs are part of the torques.
        noise : array_like, optional
            Standard deviation of the torques, one number or one per torque: the weights. None: that of the residuals of least squares, which takes at least twice as many
            measured torques as there are parameters that they determine.
        trust : float
            Weight of the model's own inertias: each parameter is expected within about 1 / sqrt(trust) of them, relatively.
        keep : collection of str
            Names of body_names whose inertias stay.
        friction_speed : float
            Velocity below which dry friction becomes viscous, rad/s or m/s.
        stribeck_speed : float
            Velocity at which the friction of "stribeck" has fallen to 1/e.
        time : (k,) array_like, optional
            Times of the rows, s, rising. With them gaps, repeated times, units that disagree, and clocks of q and tau that disagree are found and reported.
        transmission : (motors, nv) array_like, optional
            B of motor velocities = B qd, motors = nv: joint torques are B^T times those of the motors. Armature, damping, friction, offsets and noise are then the motors'.
        tau_delay : float
            How much later than q the torques are, s; they are shifted back by linear interpolation. Needs `time`.
        acceleration_noise : array_like, optional
            Standard deviation of the noise in qdd, (nv,), as `phipsi.smooth(...).acceleration_noise` has it: predicts the bias that it causes.
        instruments : tuple of array_like, optional
            (q, qd, qdd) of the trajectory that was commanded: instrumental variables, which remove the bias by noise in the measured motion.
        blocks : int
            The number of blocks of time of the jackknife. Each should be longer than half the correlation time of the residuals: where neighboring blocks are correlated, or have fewer than two torques per parameter, they are
            merged, down to eight.

        Returns
        -------
        phipsi.Identification
            The new scene, parameters, intervals, base parameters, residuals, and the share of each parameter that the data decide.

        Raises
        ------
        ArgumentError
            Too few measurements, unknown names, times that fall, noise below the rounding of the torques, and bodies of the model without mass.
        ShapeError, NotFiniteError
            Arrays of wrong shapes, and numbers that are not finite.

        Warns
        -----
        LogWarning
            Units and clocks that disagree; gaps and repeated times.
        IdentificationWarning
            A predicted bias above 0.2 standard deviations.
        InertiaWarning
            Bodies of the model whose inertia no body can have: they start from the nearest that one can have.

        Notes
        -----
        States are read in blocks: memory does not grow with k. For logs that do not fit into memory: phipsi.estimation.Accumulator.
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
        """A periodic trajectory that excites the parameters: Fourier series within limits, whose determinant of the information matrix is largest (D-optimal).

        Parameters
        ----------
        duration : float
            Length of the trajectory, s: one period.
        limits : phipsi.Limits, optional
            Limits of position, velocity and torque. None: those of the scene. Where one is infinite, positions stay within 1 rad or 0.2 m of the middle.
        harmonics : int
            Frequencies of the series, multiples of 1/duration.
        fit : collection of str
            As in identify.
        noise : array_like, optional
            Standard deviation of the torques, for the predicted standard deviations; 1 % of the largest torque by default.
        rate : float
            Samples per second.
        iterations : int
            Steps of the search.
        seed : int
            Of its random steps.

        Returns
        -------
        phipsi.estimation.Excitation
            Times, q, qd, qdd, torques of the model, and the standard deviations that the base parameters will have.

        Raises
        ------
        ArgumentError
            A scene with joints that are not of one axis, or limits that leave no room.
        """

    def plan(self) -> Plan:
        """What this scene does not need and was left out when it was built, why, and what that saved."""

    def estimate(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        torque: ArrayLike,
        *,
        noise: ArrayLike = 0.0,
        measured: Iterable[str] | ArrayLike | None = None,
        prior_acceleration: ArrayLike | None = None,
        acceleration_variance: float = 1.0,
        wrenches: Mapping[str, ArrayLike] | None = None,
        covariance: bool = False,
        method: Literal["sequential", "batch"] = "sequential",
        errors: _Errors = "raise",
    ) -> Estimate:
        """Forces, accelerations and torques given the torques of some joints, with noise: conditional means (2.1, 2.7), in O(N).

        q: (..., nq); qd, torque: (..., nv), N m or N; leading axes broadcast. noise: variance of each measurement, (N m)^2 or N^2, one
        number or (..., nv); 0 is exact, inf is not measured. measured: None (all), names of joints, or a boolean array (nv,); torque and
        noise of the other joints are not read, and entries that a masked array (numpy.ma) masks are not measured. prior_acceleration:
        (..., nv), the mean a0 of the accelerations before, zero by default. acceleration_variance: s, the variance of the acceleration of
        one kg m^2, (rad/s^2)^2, and of one kg, (m/s^2)^2. wrenches and errors: as in forward_dynamics. covariance: the covariances of the
        errors too. method: "sequential" (filter and smoother) or "batch" (section 2 with dense matrices, O(N^3), at most 300 degrees of
        freedom: a check).

        Under the model W ~ N(b + Q phi* H* a0, s Q), accelerations are N(a0, s M^-1) before anything is measured. A joint that is not
        measured keeps its mean a0 (as if locked there) and its variance; its torque is what that takes. All joints measured without
        noise: forward dynamics. Variances are right to eps times those of the prior (docs/estimation.md).

        Returns a phipsi.Estimate.

        Raises SingularJointError where a measured joint has no inertia along its axis (with covariance: any joint); ArgumentError for an
        unknown joint or method, noise that is negative or NaN, or a variance that is not positive; ShapeError, NotFiniteError, naming the
        argument and the state.
        """

    def factor(self, q: ArrayLike, *, form: _Form = "auto", tolerance: float | None = None) -> Factor:
        """M = (1 + K) D (1 + K*) at q by one sweep (3.1, 3.6), and the operators phi, Psi, K, L, D, P it is made of.

        q: (..., nq); the factor is batched where q is. form, tolerance: as in forward_dynamics. Returns a phipsi.Factor: solve(tau) and mul(a) are O(N), and its
        operators compose as the paper's equations do.

        Raises SingularJointError, naming joint and state; ShapeError, NotFiniteError or ArgumentError for a bad q.
        """

    def random_model(
        self, q: ArrayLike, qd: ArrayLike | None = None, *, acceleration_variance: float = 1.0
    ) -> RandomModel:
        """The spatially random model at q (1.1 to 1.6), to draw from: forces on the bodies, the joint torques that they cause.

        q: (nq,). qd: (nv,), rates: the mean of the forces is then the bias force b(k), gravity included; without rates the
        model is centred. acceleration_variance: (rad/s^2)^2, of one kg m^2 of inertia; it scales all covariances.

        Raises ArgumentError for a variance that is not positive, and for an inertia that no body can have, naming the link;
        ShapeError or NotFiniteError for bad arrays.
        """

    def check(self, q: ArrayLike) -> dict[str, float]:
        """Residuals of the paper's identities at q, (nq,): name of the identity to its relative residual.

        Factorisation against faer's LDLT, operators against their definitions, closed forms against each other, and the
        dynamics at a fixed rate and torque. Rounding is a few eps times nv, or times the condition number of M where an
        inverse is involved.

        Raises SingularJointError; ArgumentError beyond 300 degrees of freedom; ShapeError or NotFiniteError for a bad q.
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
        """Generates C99 code for the dynamics of this robot, which depends on libm only: a dict from file names to their contents, NAME.c, NAME.h, test_NAME.c and a Makefile.

        directory: the directory to which the files are also written, created if necessary; None: no files are written. name: prefix of files and functions. functions: names among "forward_dynamics",
        "inverse_dynamics", "bias_torque", "mass_matrix", "mass_matrix_inverse", "forward_dynamics_derivatives", "inverse_dynamics_derivatives", "forward_dynamics_jvp",
        "forward_dynamics_vjp", "inverse_dynamics_jvp", "inverse_dynamics_vjp", "placements", "forward_dynamics_watched", "mass_matrix_inverse_watched" and "factor_watched", which also return a margin for each
        state, negative if precision may be lost; and functions of one link, ("placement", link), ("jacobian", link) and ("jacobian", link, frame), with frame as in jacobian. None: all functions without a margin that are
        not for one link. dtype: "float64" or "float32", the type of the code. batches: True to add functions for batches, such as NAME_forward_dynamics_batch(count, ...), vectorized over states with the vector
        extensions of GCC and Clang. tolerance: the error to which the margins refer, as in forward_dynamics.

        Each function, for instance NAME_forward_dynamics(q, qd, tau, qdd), is a sequence of operations for one state, without allocations: constants are folded, and operations that this robot does not
        need are omitted. Several results are consecutive arguments, as in NAME_forward_dynamics_derivatives(q, qd, tau, dqdd_dq, dqdd_dqd, Minv). Functions of one link have its name in theirs, as in
        NAME_jacobian_tool0_world(q, jacobian), with _ for characters that C does not allow. The order of q and qd is that of the scene; SI units, radians. The results equal those of form "covariance" to rounding,
        without an error estimate. Wrenches and changed parameters are not supported. `make test` in the directory compiles the code and compares it with the scene at one state.

        Raises ArgumentError for a name that is not a C identifier, unknown functions and links, and links whose functions would have the same name in C; for dynamics of a scene with connections, for a scene with
        coupled joints (mimic="couple"), and for the inverse mass matrix and the derivatives of forward dynamics of chains of more than 300 joints; OSError if files cannot be written.
        """

    def to_rust(
        self,
        directory: str | os.PathLike[str] | None = None,
        *,
        name: str = "robot",
        functions: Iterable[_Function] | None = None,
    ) -> dict[str, str]:
        """The dynamics of this robot as a Rust crate that needs `core` alone, a dict from names of files to their texts: Cargo.toml, src/lib.rs, src/dynamics.rs, src/lanes.rs, src/numbers.rs and tests/reference.rs.

        directory: where to write them too, made where it is not there; None: nowhere. name: of the crate. functions: as of to_c.

        Each function is one straight line of operations in safe code, forward_dynamics(&q, &qd, &tau) -> [T; NV] for instance, without allocations, for any T of the trait Number that src/dynamics.rs defines: f64 and f32 by
        the standard library (feature "std", on unless switched off), Lanes<T, N> of src/lanes.rs for N states at once, or a type of yours; forward_dynamics_batch and its like take slices of states. Order of q
        and qd as in the scene; SI units, radians. Results are those of form "covariance" to rounding: digits that it loses are not noticed. `cargo test` in the directory compares with the scene at one state.

        Raises ArgumentError for a name that no crate can have, and as to_c; OSError where files cannot be written.
        """

    def to_cuda(
        self,
        directory: str | os.PathLike[str] | None = None,
        *,
        name: str = "robot",
        functions: Iterable[_Function] | None = None,
        dtype: Literal["float64", "float32"] = "float64",
    ) -> dict[str, str]:
        """The dynamics of this robot as CUDA kernels, a dict from names of files to their texts: NAME.cu, one_thread.h, test_NAME.cu and a Makefile.

        directory: where to write them too, made where it is not there; None: nowhere. name: what files and kernels begin with. functions: as of to_c. dtype: "float64" or "float32", the numbers of the code.

        Each kernel takes many states, one a thread: NAME_forward_dynamics(count, q, qd, tau, qdd) for instance, extern "C", with `count` an unsigned long long. Number i of the q of state s is q[i * count + s]. NAME.cu includes nothing: NVRTC
        compiles it at run time, as phipsi.compile(device="cuda") does, or nvcc. Order of q and qd as in the scene; SI units, radians. Results are those of form "covariance" to rounding: digits that it loses are not
        noticed. `make test` in the directory compares with the scene at one state on a GPU; `make test-c` does so by the C compiler, where threads are a loop.

        Raises ArgumentError as to_c; OSError where files cannot be written.
        """

    def to_urdf(self, path: str | os.PathLike[str] | None = None, *, name: str = "robot") -> str:
        """The scene as URDF, which from_urdf reads back to the same numbers but for the rounding of angles; a str.

        path: a file to write it to; None: none. name: of the robot. The free joint of a floating base is not written: read it with floating_base=True. Armature,
        stiffness and rest are attributes of <dynamics>, which other programs pass over. Shapes are those of the scene's file, where it is a URDF that is still there. A revolute joint without limits is written as
        continuous.

        Raises ArgumentError for what URDF cannot hold, by name: connections, contacts, screw and universal joints, springs at joints of several coordinates, losses of a
        floating base.
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
        title: str | None = None,
        browser: bool = True,
    ) -> Viewer:
        """Shows the robot in a browser: one pose with a slider a joint, or a motion with a play button. Needs phipsi[view].

        motion: None, the neutral configuration; (nq,), a configuration; (k, nq), configurations at the times t, (k,), s; or a Trajectory of one state.
        forces: (at, force), (k, n, 3) each, arrows at points in the base frame, m, and N; None: those of the contacts or connections of a Trajectory, where
        they are known. They are drawn to scale, with one on the ground that says how many newtons it is.
        urdf: the file whose meshes are drawn; None: the one that the scene was read from. Links without a shape there are drawn as capsules of their
        inertia. to: a file (.html or .htm) that gets the page, which holds all it needs and opens without phipsi or a network; nothing is served then. port: of
        127.0.0.1; 0: any that is free. title: of the panel. browser: whether to open one.

        Returns a phipsi.view.Viewer: update(q) moves the robot, wait() keeps a script going, close() ends it; with `to` the path of the page.

        Raises ImportError without the extra; ShapeError, NotFiniteError, ArgumentError. Warns MeshWarning where a mesh is not found.
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
        title: str | None = None,
        browser: bool = True,
    ) -> Path: ...
    def __copy__(self) -> Scene: ...
    def __deepcopy__(self, memo: Any, /) -> Scene: ...
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]: ...

@final
class SceneBuilder:
    """Collects links and joints by name, each call returning the builder; build() checks them and makes the Scene.

    Builders pickle and copy; a copy goes its own way.
    """

    def __new__(cls) -> SceneBuilder: ...
    def link(
        self,
        name: str,
        mass: float = 0.0,
        com: ArrayLike = (0, 0, 0),
        inertia: ArrayLike | None = None,
    ) -> SceneBuilder:
        """Adds a link.

        mass: kg. com: (3,), mass centre in the link's frame, m. inertia: (3, 3), about the mass centre, axes parallel to
        the link's frame, kg m^2; None for a point mass. A link without mass and inertia is a mere frame.

        Raises ShapeError or ArgumentError for com and inertia, naming the link; build() checks the rest.
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
        stiffness: float = 0.0,
        rest: ArrayLike | None = None,
        lower: float | None = None,
        upper: float | None = None,
        velocity: float | None = None,
        effort: float | None = None,
        mimic: str | None = None,
        mimic_multiplier: float = 1.0,
        mimic_offset: float = 0.0,
    ) -> SceneBuilder:
        """Adds a joint; the links that it names may come later.

        type: "fixed", "revolute", "continuous", "prismatic", "screw", "planar", "universal", "spherical" or "floating". xyz: (3,), m,
        and rpy: (3,), rad, R = Rz(yaw) Ry(pitch) Rx(roll), or rotation: (3, 3): the child's frame at zero configuration
        seen from the parent's. axis: (3,), in the child's frame, of any length. pitch: m/rad, for a screw. armature: kg m^2
        or kg for each degree of freedom, part of the mass matrix. damping (N m s/rad or N s/m), friction (N m or N),
        stiffness (N m/rad or N/m) and rest (the joint's coordinates there, None: the neutral ones): simulation only. lower, upper,
        velocity, effort: limits; lower and upper are stops in simulations, the others are reported. mimic: a joint that this one should follow, as mimic_multiplier
        times its coordinate plus mimic_offset (rad or m); build(mimic="couple") has it follow.

        Raises SceneError for an unknown type or a missing pitch; ShapeError or ArgumentError for arrays, naming the joint;
        build() checks the rest.
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
        """Closes a loop: connects a frame on a link with a frame on another, or on the world.

        kind: "point" (the origins coincide: 3 rows), "axis" (the origins coincide, and the direction axis, (3,), in both frames, None: z: a hinge, 5
        rows), "weld" (the frames coincide: 6 rows), "distance" or "rod" (the origins are length apart, m; None: as in the neutral configuration: 1
        row). link, other: names of links, which may come later; None: the world, the base's frame. xyz: (3,), m, and rpy: (3,), rad, or rotation: (3,
        3): the first frame seen from link, as in joint. other_xyz, other_rpy, other_rotation: the second seen from other; none of them: where the
        first frame is in the neutral configuration.

        Raises SceneError for an unknown kind, and an axis or a length that the kind has not; ShapeError or ArgumentError for arrays, naming the
        connection; build() checks the rest.
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
    ) -> SceneBuilder:
        """Adds a contact: a sphere on a link, or a point of it, that does not go through a plane of the world. Simulation only.

        name: of the contact. link: the name of a link, which may come later. xyz: (3,), the sphere's centre in the link's frame, m. radius: m; 0: a
        point. normal: (3,), out of the ground, in the base frame, of any length, and offset: m: the plane is where the unit normal times y is offset.
        friction: Coulomb's coefficient mu, zero or more. restitution: from 0 (no rebound) to 1 (elastic). Two links do not touch each other, and
        nothing is searched: what may touch is what is named.

        Raises ShapeError or ArgumentError for arrays, naming the contact. build() raises SceneError, naming the contact, for a name used twice, a
        link that is not there or cannot move, a normal without direction, numbers that are out of range or not finite, and connections beside
        contacts.
        """

    def couple(
        self, name: str, joint: str, other: str | None = None, *, multiplier: float = 1.0, offset: float = 0.0
    ) -> SceneBuilder:
        """Couples a joint to another: its coordinate is multiplier times that one's, plus offset (rad or m), kept by a force: 1 row.

        name: of the connection. joint, other: names of joints of one axis, which may come later; other None: the coordinate is offset.

        build() raises SceneError for joints that are not there or have several axes, and for numbers that are not finite.
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
        """Checks everything and makes the Scene; the builder can be used again.

        floating_base: puts a free joint under the root link, named as in Scene.from_urdf. gravity: (3,), m/s^2, in the base
        frame. strict: unphysical inertias raise instead of warning. leave_out, mimic: as in Scene.from_urdf. What is None is as the
        builder has it: a fixed base, (0, 0, -9.81), False, all and "free" in a new one, the scene's own in one from Scene.to_builder.

        tolerance: geometric tolerance of linkages, an angle in rad or a length over the reach of the loop, 0 to 0.1: rows of connections that depend on each other to within it
        count as dependent, with a LinkageWarning at the first call that finds one (Scene.project has the details). None: 3e-5; 5e-3, 2e-3 or 2e-4 for a URDF whose angles have two, three or four
        decimals. With strict=True only rows that depend on each other to within rounding do, and an axis that is drawn 1e-6 rad off makes a planar linkage rigid.

        Raises SceneError, naming link or joint, for: no link, a name used twice, an unknown parent or child, two parents,
        two roots, a cycle, an axis without direction, numbers that are not finite, negative mass, armature, damping or
        friction, lower above upper, a floating base of what floats already; naming the connection, for links or joints that are not there or cannot be connected. Warns InertiaWarning for
        inertias that no body can have, and MimicWarning, as Scene.from_urdf does.
        """

    def _set_file(self, file: str | os.PathLike[str]) -> None: ...
    def __copy__(self) -> SceneBuilder: ...
    def __deepcopy__(self, memo: Any, /) -> SceneBuilder: ...
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]: ...

def _numbers(name: str, value: ArrayLike, scene: Scene | None = None, coordinates: bool = False, /) -> _Array: ...
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
    /,
) -> Simulator: ...
def _unwritten(count: int, /) -> _Array: ...
def _rotate_chosen(triangle: _Array, wide: _Array, chosen: list[int], last: _Array, /) -> None: ...
def _rotate_rows(triangle: _Array, rows: _Array, /) -> None: ...
def _log_likelihood(time: _Array, position: _Array, variance: _Array, density: float, prior: tuple[float, float, float], /) -> tuple[float, float, int]: ...
def _smooth_log(time: _Array, position: _Array, variance: _Array, density: float, prior: tuple[float, float, float], /) -> _Array: ...

@final
class Simulator:
    """States that are advanced call by call: what a controller, a learner or a game loop steps.

    Made by Scene.simulator. A step has the bits that it has in Scene.simulate, however steps are cut into calls, and whatever states are beside it.
    Scratch is kept between steps. The batch, (...), has the axes that q, qd and the targets of pd broadcast to; large ones run in lanes and on threads.

    One call at a time: while one is under way, others on the same simulator (of other threads, or of a signal handler) raise ArgumentError. Copies and
    pickles are simulators of their own, at the same state, which go on with the same bits.
    """

    def step(self, tau: ArrayLike | None = None, steps: int = 1) -> None:
        """Makes steps of dt in all states, tau held over them.

        tau: (nv,), or (..., nv) with axes that broadcast to the batch, N m or N; None: zero. steps: how many.

        Returns nothing: q, qd and t are the new state.

        Raises SimulationError where motion diverges or a pivot is lost, with .step, .joint, .state and .trajectory, whose one row is the state now:
        all states, and their times, are after the last step that all of them finished. reset(q, qd, states=error.state) lets the others go on.
        Raises SimulationInterrupted (a KeyboardInterrupt) on Ctrl-C, likewise; ShapeError, NotFiniteError, ArgumentError, after which nothing has moved.
        """
    def reset(self, q: ArrayLike, qd: ArrayLike | None = None, *, states: Any = None) -> None:
        """Begins states anew, at time zero; the others stay as they are.

        q: (..., nq); qd: (..., nv), zero if not given. states: None for all, or whatever selects states of an array of the batch's shape in NumPy: a
        mask of that shape, an index, a list of them, a slice. q and qd broadcast to what it selects, as in array[states] = q.

        Warns (LimitWarning) of joints that begin beyond limits that are stops, as Scene.simulator does. Raises ShapeError, NotFiniteError, ArgumentError, each naming the
        argument and the state; all states are then as they were.
        """
    @property
    def q(self) -> _Array:
        """Configurations now, (..., nq); a copy."""
    @property
    def qd(self) -> _Array:
        """Rates now, (..., nv); a copy."""
    @property
    def t(self) -> Any:
        """How long each state has moved since it began or was reset, (...), s: a number for one state, else an array, a copy."""
    @property
    def steps(self) -> int:
        """How many steps were made, resets or not."""
    @property
    def dt(self) -> float:
        """The step, s."""
    @property
    def method(self) -> str:
        """How states are advanced, one of the names that Scene.simulate has for it."""
    @property
    def scene(self) -> Scene:
        """The scene that moves."""
    @property
    def batch(self) -> tuple[int, ...]:
        """The axes of the batch; () for one state."""
    @property
    def contacts(self) -> ContactMotion | None:
        """The contacts now, a ContactMotion: force of the last step, impulse of all impacts since the state began or was reset; None for a scene without contacts."""

    @property
    def momentum_correction(self) -> MomentumCorrection | None:
        """The largest corrections that conserve_momentum made in each state since it began or was reset, a MomentumCorrection; None without it."""
    def take_stops(self) -> list[StopImpact]:
        """Returns the impacts of joints on their stops since the last call, and forgets them.

        Returns
        -------
        list of StopImpact
            By state and time; times are those of each state.
        """
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]: ...

@final
class RandomModel:
    """The spatially random model of a scene at one configuration (1.1 to 1.6): w(k) ~ N(b(k), s M(k)), X = phi W, T = H X + v.

    Made by Scene.random_model. s is the acceleration variance, (rad/s^2)^2 of one kg m^2; v has the variance s times the armature.
    """

    @property
    def nv(self) -> int:
        """Number of degrees of freedom."""

    @property
    def dimension(self) -> int:
        """Random numbers a sample: six a body (fewer for rods, point masses and frames), one a joint with armature."""

    @property
    def acceleration_variance(self) -> float:
        """s, (rad/s^2)^2 of one kg m^2."""

    def sample(self, samples: int, *, seed: int, first: int | None = None) -> Samples:
        """Samples of the model: the named tuple Samples(process, force, torque).

        samples: how many; seed: an integer from 0 to 2^64 - 1; first: the number of the first sample, 0 if not given. Sample i
        of a seed is the same whatever is drawn with it and on however many threads. process and force: (samples, nv, 6), W and
        X = phi W in body frames, a block a degree of freedom as in Factor; torque: (samples, nv), T = H X + v.

        Raises ArgumentError for a bad count or seed; OutOfMemoryError for more samples than there is room for.
        """

    def sample_torque(self, samples: int, *, seed: int, first: int | None = None) -> _Array:
        """The torques alone of the same samples, (samples, nv): arguments and errors as of sample()."""

    def mass_matrix(
        self,
        samples: int | None = None,
        *,
        seed: int | None = None,
        method: Literal["monte-carlo", "sobol", "sigma-points"] = "monte-carlo",
        confidence: float = 0.95,
        replicates: int = 8,
    ) -> MassEstimate:
        """The mass matrix as the covariance of T (5.1), with what is known of its error: the named tuple MassEstimate.

        method: "monte-carlo", independent samples, whose error falls as samples^-1/2; "sobol", scrambled Sobol points, samples
        being replicates times a power of two, about samples^-1; "sigma-points", exact, which takes neither samples nor seed.
        confidence: of the interval of each entry, between 0 and 1. replicates: scrambles, at least 2, for "sobol" only.

        Memory does not grow with the samples.

        Raises ArgumentError, naming the argument; OutOfMemoryError for more replicates than there is room for.
        """

    def __copy__(self) -> RandomModel: ...
    def __deepcopy__(self, memo: Any, /) -> RandomModel: ...
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]: ...

@final
class RawFactor:
    """The compiled half of phipsi.operators.Factor: applies operators by name."""

    @property
    def nv(self) -> int:
        """Number of degrees of freedom."""

    @property
    def batch(self) -> tuple[int, ...]:
        """Leading axes of the configurations."""

    def log_det(self) -> Any:
        """log det M of every configuration, shape of the batch."""

    def pivots(self) -> _Array:
        """D of every configuration, (..., nv)."""

    def shape(self, kind: str, /) -> tuple[int, int]:
        """(rows, columns) of the operator of that name."""

    def apply(self, kind: str, transpose: bool, x: ArrayLike, /) -> _Array:
        """The operator of that name times x, (..., columns), by a sweep; its transpose's if so said."""

    def update(self, q: ArrayLike, /) -> int:
        """Moves every factor to its configuration in q, the shape that the factor was made with; how many bodies were computed anew, in all."""

    def dense(self, kind: str, /) -> _Array:
        """The operator of that name as a matrix, (..., rows, columns), built from its definition and not by a sweep."""

    def __copy__(self) -> RawFactor: ...
    def __deepcopy__(self, memo: Any, /) -> RawFactor: ...
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]: ...

@final
class Reference:
    """Joint accelerations in double-double, the reference of a report."""

    def toarray(self) -> _Array:
        """The reference rounded to float64, (n, nv)."""

@final
class Exact:
    """A quantity of one state in double-double arithmetic, and what is measured against it.

    quantity: one of QUANTITIES; q: (nq,), qd: (nv,); u: (nv,), torques, or accelerations for "inverse dynamics".
    Raises ArgumentError for an unknown quantity, ShapeError and NotFiniteError for arrays, SingularJointError.
    """

    def __new__(cls, scene: Scene, quantity: str, q: ArrayLike, qd: ArrayLike, u: ArrayLike) -> Exact: ...
    def toarray(self) -> _Array:
        """The answer rounded to float64, (nv,) or (nv * nv,)."""

    def difference(self, found: ArrayLike, /) -> tuple[float, _Array]:
        """How far numbers of another program are from it, relative: the max-norm, and each component against its own size."""

    def error(self, method: str, precision: str = "float64") -> tuple[float, _Array, str | None]:
        """The error of one method (one of FORMS; the library's recursion for other quantities than forward dynamics) in
        "float64" or "float32": (max-norm, components, reason); NaN and a reason where the method failed, else None.
        """

    def sensitivity(self, draws: int = 4, seed: int = 0) -> dict[str, tuple[float, _Array]]:
        """By how much the answer changes when numbers move by one unit in the last place: kind of number to (max-norm, components)."""

    def time(self, method: str, precision: str, repeats: int) -> float:
        """Median time of one method on this state over repeats calls, ns; for forward dynamics."""

BUNDLED_ARM: str
FORMS: tuple[str, ...]
QUANTITIES: tuple[str, ...]
METHODS: tuple[str, ...]
ROUTES: tuple[str, ...]

def residuals(scene: Scene, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> list[tuple[str, float, bool]]:
    """Residuals at one state, as (name, relative residual, whether rounding grows with the condition number of M)."""

def reference(scene: Scene, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> Reference:
    """The accelerations of n states in double-double, about 31 digits; q: (n, nq), qd, tau: (n, nv)."""

def measure(
    scene: Scene,
    method: str,
    precision: str,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike,
    reference: Reference,
    repeats: int,
) -> tuple[float, _Array]:
    """Median time a state (ns) of one method in one precision, and the error of each state against the reference.

    What is timed is `Scene::evaluate` in Rust, one state a call, and the error is that of the same calls. method: one of METHODS;
    precision: "float64" or "float32"; repeats: passes over the states. The error is the largest over the joints, relative to the largest
    acceleration; NaN where the method met a bad pivot.
    """

def growth(bodies: int, repeats: int) -> tuple[float, float, float]:
    """`Scene::evaluate` in Rust on a chain of bodies equal links, one state a call, median ns a body over repeats passes: forward
    dynamics in form "auto" and in form "covariance", and inverse dynamics.
    """

def method_call(method: str) -> tuple[str, str | None]:
    """What a method of METHODS calls in Rust, and the form it asks for; None where its calls have none."""

def emergence(scene: Scene, q: ArrayLike, route: str, samples: int, seed: int, repeats: int) -> tuple[float, float]:
    """Median time (ns) of one route from q to the mass matrix, and its relative error (Frobenius norm, against double-double).

    route: one of ROUTES; samples and seed are for "monte-carlo" and "sobol" (a power of two); repeats: how often it is timed.
    """

def operator_growth(bodies: int, repeats: int) -> list[tuple[str, float]]:
    """Applying each operator, and with a star its transpose, on a chain of bodies equal links: (name, median ns a body)."""

def extreme(
    name: str, value: float | None, bodies: int | None, seed: int
) -> tuple[Scene, _Array, _Array, _Array, str, float, str, tuple[float, ...]]:
    """The extreme case of that name, as (scene, q, qd, tau, name, value, parameter, values); see phipsi.scenes.extreme."""

def extreme_names() -> tuple[str, ...]:
    """The names of the extreme cases."""

def chain(n: int) -> Scene:
    """A chain of n equal links; see phipsi.scenes.chain."""

def set_num_threads(threads: int | None) -> None:
    """Sets how many threads batches use from now on, in this process and those that it forks; calls under way keep theirs.

    threads: the caller's and others, 1 for none beside the caller's; None or 0 for what the environment variable
    RAYON_NUM_THREADS says, or as many as the machine has, which is what a process begins with. Results have the same bits for any number.

    Raises ArgumentError for what is no number of threads, or for more than the system gives; what was set before then stays.
    """

def get_num_threads() -> int:
    """How many threads the next batch uses; 1 where it runs on the caller's alone. Starts them where they are not there yet."""
