"""The compiled half of phipsi: scenes, and the algorithms on them."""

import os
from collections.abc import Iterable, Mapping
from typing import Any, Final, Literal, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._results import Energy, Limits

__all__ = ["Scene", "SceneBuilder", "__version__", "_rebuild_scene"]

__version__: Final[str]

_Array: TypeAlias = NDArray[np.float64]
_Form: TypeAlias = Literal["auto", "covariance", "joseph", "square-root"]
_JointType: TypeAlias = Literal[
    "fixed", "revolute", "continuous", "prismatic", "screw", "planar", "spherical", "floating"
]

@final
class Scene:
    """An articulated system: bodies, joints, gravity, and the names of them; immutable, for any number of threads.

    Made by :meth:`from_urdf` or :meth:`SceneBuilder.build`. SI units and radians. Spatial 6-vectors are angular first:
    wrench = (moment, force), velocity = (angular, linear). Movable joints are in depth-first order, siblings in file order.

    Arrays are (..., nq) or (..., nv): leading batch axes broadcast, rank in = rank out. Lists, float32, integers, strided
    and Fortran-ordered arrays are converted; C-contiguous float64 is used without a copy. In q a revolute joint is an angle
    (rad), a prismatic one a length (m), a screw an angle (its pitch in m/rad), a planar one (u, v, theta), a spherical one a
    quaternion (x, y, z, w), a free one (x, y, z, qx, qy, qz, qw) with the rates (linear, angular) in the body's frame.
    Quaternions may be off unit norm by 1e-3, and are normalised.

    Arguments raise ShapeError, NotFiniteError or ArgumentError (see phipsi.errors), naming the argument and the state.
    The GIL is released in all calls longer than some microseconds; large batches run on several threads (as many as
    RAYON_NUM_THREADS says, else one a core), with the same bits for any number of them.

    Scenes pickle, compare and hash by identity; copies are the scene itself.
    """

    @staticmethod
    def from_urdf(
        source: str | os.PathLike[str],
        *,
        floating_base: bool = False,
        gravity: ArrayLike = (0, 0, -9.81),
        strict: bool = False,
    ) -> Scene:
        """The scene of a URDF file or text.

        source: a path, or the XML itself: a str that starts with "<" after white space. floating_base: puts a free joint,
        "root_joint", under the root link. gravity: (3,), m/s^2, in the base frame. strict: unphysical inertias raise.

        Raises SceneError for a file that cannot be read or built, naming link or joint; ArgumentError for another source.
        Warns InertiaWarning for inertias that no body can have, MimicWarning for mimic joints (they stay free).
        """

    @property
    def nq(self) -> int:
        """Number of coordinates in q."""

    @property
    def nv(self) -> int:
        """Number of degrees of freedom: the length of qd, qdd and tau."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the movable joints, in the order of q; the free joint of a floating base is "root_joint"."""

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
    def limits(self) -> Limits:
        """Limits by degree of freedom: the named tuple Limits(lower, upper, velocity, effort) of arrays (nv,).

        rad or m, rad/s or m/s, N m or N; infinite where there is none; a joint of several degrees of freedom repeats its
        own. Reported, never enforced.
        """

    def q_index(self, joint: str, /) -> slice[int, int, int]:
        """Where a joint is in q. Raises ArgumentError, with the names that there are, for an unknown joint."""

    def v_index(self, joint: str, /) -> slice[int, int, int]:
        """Where a joint is in qd, qdd and tau. Raises ArgumentError, with the names that there are, for an unknown joint."""

    def neutral(self) -> _Array:
        """The neutral configuration, (nq,): zero everywhere, the identity (0, 0, 0, 1) for quaternions."""

    def forward_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        tau: ArrayLike,
        *,
        form: _Form = "auto",
        wrenches: Mapping[str, ArrayLike] | None = None,
        out: _Array | None = None,
    ) -> _Array:
        """Joint accelerations from joint torques, in O(N): the smoother's estimates given the torques as measurements.

        q: (..., nq); qd, tau: (..., nv). wrenches: dict from link names (links on fixed joints too) to (..., 6), each a
        (moment, force) acting on that link, at its origin and in its frame. form: "auto" or "covariance" (equation 3.6).
        out: C-contiguous float64 of the result's shape that overlaps no argument; it is returned.

        Returns qdd, (..., nv), with M qdd + bias = tau + J^T w (equations 4.4 to 4.11).

        Raises SingularJointError where a joint has no inertia along its axis; NotBuiltError for "joseph" and "square-root",
        which are to come. After an error out is partly written.
        """

    def inverse_dynamics(
        self,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        *,
        wrenches: Mapping[str, ArrayLike] | None = None,
        out: _Array | None = None,
    ) -> _Array:
        """Joint torques from joint accelerations, in O(N), gravity and armature included.

        q: (..., nq); qd, qdd: (..., nv); wrenches and out as in forward_dynamics.

        Returns tau, (..., nv) = H phi (Q lambda + b) + armature qdd - J^T w (equations 1.5, 2.9, 2.10).
        """

    def bias_torque(self, q: ArrayLike, qd: ArrayLike) -> _Array:
        """The bias torque H phi b: what the joints must give so that none accelerates, gravity included.

        q: (..., nq); qd: (..., nv). Returns (..., nv), N m or N.
        """

    def mass_matrix(self, q: ArrayLike) -> _Array:
        """The joint-space mass matrix, the covariance of the measurements (5.1), armature on its diagonal.

        q: (..., nq). Returns (..., nv, nv), full and exactly symmetric.

        Raises ArgumentError above 4000 degrees of freedom: inverse_dynamics multiplies by the matrix without forming it.
        """

    def mass_matrix_inverse(self, q: ArrayLike) -> _Array:
        """The inverse of the mass matrix in closed form (6.1), without forming or factoring the matrix.

        q: (..., nq). Returns (..., nv, nv), full and exactly symmetric.

        Raises SingularJointError; ArgumentError above 4000 degrees of freedom: forward_dynamics multiplies by the inverse
        without forming it.
        """

    def placements(self, q: ArrayLike) -> dict[str, _Array]:
        """Where every link is: a dict from link names to homogeneous matrices, link frame to base frame.

        q: (..., nq). Each value: (..., 4, 4), [[R, p], [0, 1]] with p in m; an array of its own, in the order of link_names.
        """

    def jacobian(self, q: ArrayLike, link: str) -> _Array:
        """The Jacobian J of a link: its spatial velocity (angular, linear), at its origin and in its own frame, is J qd.

        q: (..., nq). Returns (..., 6, nv); a wrench w on the link there gives the joint torques J^T w.

        Raises ArgumentError for an unknown link.
        """

    def energy(self, q: ArrayLike, qd: ArrayLike) -> Energy:
        """Kinetic energy (armature included) and potential energy: the named tuple Energy(kinetic, potential).

        q: (..., nq); qd: (..., nv). Each (...), J; the potential is zero with the mass centre at the base's origin.
        """

    def momentum(self, q: ArrayLike, qd: ArrayLike) -> _Array:
        """Spatial momentum of all moving bodies: (angular about the base's origin, linear), in the base frame.

        q: (..., nq); qd: (..., nv). Returns (..., 6), N m s and N s. Armature adds nothing here.
        """

    def integrate(self, q: ArrayLike, v: ArrayLike) -> _Array:
        """The configuration reached from q by the constant velocity v in unit time, on the manifold.

        q: (..., nq); v: (..., nv). Returns (..., nq), quaternions of unit norm. A free joint moves along the screw of its
        twist, a spherical joint turns about its rate, all others add.
        """

    def difference(self, q0: ArrayLike, q1: ArrayLike) -> _Array:
        """The velocity that takes q0 to q1 in unit time, the inverse of integrate; rotations go the short way.

        q0, q1: (..., nq). Returns (..., nv).
        """

    def lock(self, joints: Iterable[str], q: ArrayLike) -> Scene:
        """A new scene with the named joints fixed where q, (nq,), has them; names of links stay.

        What is locked is folded into the bodies around it and costs nothing. Locking "root_joint" gives a fixed base.

        Raises ArgumentError for an unknown joint.
        """

    def plan(self) -> dict[str, Any]:
        """What is left out of the computation, and why: for now the fixed joints that were merged away."""

    def __copy__(self) -> Scene: ...
    def __deepcopy__(self, memo: Any, /) -> Scene: ...
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]: ...

@final
class SceneBuilder:
    """Collects links and joints by name, each call returning the builder; build() checks them and makes the Scene."""

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
        lower: float | None = None,
        upper: float | None = None,
        velocity: float | None = None,
        effort: float | None = None,
        mimic: str | None = None,
    ) -> SceneBuilder:
        """Adds a joint; the links that it names may come later.

        xyz: (3,), m, and rpy: (3,), rad, R = Rz(yaw) Ry(pitch) Rx(roll), or rotation: (3, 3): the child's frame at zero
        configuration seen from the parent's. axis: (3,), in the child's frame, of any length. pitch: m/rad, for a screw.
        armature: kg m^2 or kg for each degree of freedom, part of the mass matrix. damping and friction: simulation only.
        lower, upper, velocity, effort: limits, reported and never enforced. mimic: a joint that this one should follow; it
        stays free.

        Raises SceneError for an unknown type or a missing pitch; ShapeError or ArgumentError for arrays, naming the joint;
        build() checks the rest.
        """

    def build(
        self,
        floating_base: bool = False,
        gravity: ArrayLike = (0, 0, -9.81),
        strict: bool = False,
    ) -> Scene:
        """Checks everything and makes the Scene; the builder can be used again.

        floating_base: puts a free joint, "root_joint", under the root link. gravity: (3,), m/s^2, in the base frame.
        strict: unphysical inertias raise instead of warning.

        Raises SceneError, naming link or joint, for: no link, a name used twice, an unknown parent or child, two parents,
        two roots, a cycle, an axis without direction, numbers that are not finite, negative mass, armature, damping or
        friction, lower above upper. Warns InertiaWarning and MimicWarning as Scene.from_urdf does.
        """

def _rebuild_scene(description: tuple[Any, ...], /) -> Scene: ...
