"""Tasks of inverse kinematics: a quantity of the robot, its target and the standard deviation with which it is to be
met.

>>> import phipsi
>>> scene = phipsi.load(phipsi.BUNDLED_ARM)
>>> hand = phipsi.tasks.Position("link6", (0.5, 0.1, 0.4))
>>> scene.inverse_kinematics([hand]).reached
True

Targets are expressed in the base frame, or in the frame of the link `relative_to`. Leading axes of a target are
a batch. `position` (m) and `rotation` (rad) are standard deviations: they weight tasks that cannot be met
together. Tasks that can be met together are all met, independently of their deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arguments import collider_pairs, numbers
from ._summary import summarized
from .errors import ArgumentError, NotFiniteError, ShapeError, of_argument

__all__ = ["CenterOfMass", "Direction", "Distance", "InverseKinematics", "JointPosition", "LookAt", "Orientation", "Pose", "Position", "Task"]


def __dir__() -> list[str]:
    return __all__


_Array = NDArray[np.float64]

#: Default standard deviation of a task, m and rad.
DEVIATION = 1e-3
#: The same of a distance.
DISTANCE_DEVIATION = 1e-4
ORIGIN, FORWARD = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)


class Pose(NamedTuple):
    """Task: the frame of a link, translated by `at`, has a given pose.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> task = phipsi.tasks.Pose("link6", scene.placement([0.3] * 6, "link6"))
    >>> bool(scene.inverse_kinematics(task).reached)
    True
    """

    link: str
    """Name of the link."""
    target: ArrayLike
    """Pose of the link, homogeneous matrix from link to base, (..., 4, 4), as Scene.placement returns it. A rotation
    with at least three correct decimals is orthonormalized.
    """
    at: ArrayLike = ORIGIN
    """Point of the link, in the link frame, (3,), m."""
    position: float = DEVIATION
    """Standard deviation of the position, m."""
    rotation: float = DEVIATION
    """Standard deviation of the rotation, rad."""
    relative_to: str | None = None
    """Name of the link whose frame the target is expressed in; None: the base frame."""


class Position(NamedTuple):
    """Task: a point of a link has a given position.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> task = phipsi.tasks.Position("link6", (0.5, 0.1, 0.4))
    >>> bool(scene.inverse_kinematics(task).reached)
    True
    """

    link: str
    """Name of the link."""
    target: ArrayLike
    """Position, (..., 3), m."""
    at: ArrayLike = ORIGIN
    """Point of the link, in the link frame, (3,), m."""
    position: float = DEVIATION
    """Standard deviation of the position, m."""
    relative_to: str | None = None
    """Name of the link whose frame the target is expressed in; None: the base frame."""


class Orientation(NamedTuple):
    """Task: a link has a given orientation.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> task = phipsi.tasks.Orientation("link6", scene.placement([0.3] * 6, "link6")[:3, :3])
    >>> bool(scene.inverse_kinematics(task).reached)
    True
    """

    link: str
    """Name of the link."""
    target: ArrayLike
    """Rotation matrix from link to base, (..., 3, 3). A matrix with at least three correct decimals is
    orthonormalized.
    """
    rotation: float = DEVIATION
    """Standard deviation of the rotation, rad."""
    relative_to: str | None = None
    """Name of the link whose frame the target is expressed in; None: the base frame."""


class Direction(NamedTuple):
    """Task: an axis of a link points in a given direction; the rotation about that axis is free.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> task = phipsi.tasks.Direction("link6", (0, 0, -1))
    >>> bool(scene.inverse_kinematics(task).reached)
    True
    """

    link: str
    """Name of the link."""
    target: ArrayLike
    """Direction, (..., 3), of any positive length."""
    axis: ArrayLike = FORWARD
    """Axis of the link, in the link frame, (3,), of any positive length."""
    rotation: float = DEVIATION
    """Standard deviation of the angle, rad."""
    relative_to: str | None = None
    """Name of the link whose frame the target is expressed in; None: the base frame."""


class LookAt(NamedTuple):
    """Task: an axis through a point of a link points to a target point, as the optical axis of a camera.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> task = phipsi.tasks.LookAt("link6", (0.5, 0.1, 0.0))
    >>> bool(scene.inverse_kinematics(task).reached)
    True
    """

    link: str
    """Name of the link."""
    target: ArrayLike
    """Target point, (..., 3), m."""
    axis: ArrayLike = FORWARD
    """Axis of the link, in the link frame, (3,), of any positive length."""
    at: ArrayLike = ORIGIN
    """Point of the link that the axis passes through, in the link frame, (3,), m."""
    rotation: float = DEVIATION
    """Standard deviation of the angle, rad."""
    relative_to: str | None = None
    """Name of the link whose frame the target is expressed in; None: the base frame."""


class CenterOfMass(NamedTuple):
    """Task: the center of mass of all moving bodies has a given position.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> task = phipsi.tasks.CenterOfMass(scene.center_of_mass([0.3] * 6))
    >>> bool(scene.inverse_kinematics(task).reached)
    True
    """

    target: ArrayLike
    """Position in the base frame, (..., 3), m."""
    position: float = DEVIATION
    """Standard deviation of the position, m."""


class JointPosition(NamedTuple):
    """Task: a joint with one coordinate has a given position.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> task = phipsi.tasks.JointPosition("joint2", -0.4)
    >>> bool(scene.inverse_kinematics(task).reached)
    True
    """

    joint: str
    """Name of the joint."""
    target: ArrayLike
    """Joint position, (...), rad or m."""
    deviation: float = DEVIATION
    """Standard deviation, rad or m."""


class Distance(NamedTuple):
    """Task: two colliders are at least a given distance apart, so that a solution avoids the table and the robot itself.

    The error is zero from `lower` on, and lower - distance below it. It is reported as a position error.

    Examples
    --------
    >>> import phipsi
    >>> builder = phipsi.SceneBuilder().link("rail").link("slide", mass=1.0).joint("x", "prismatic", "rail", "slide", axis="x")
    >>> builder = builder.collider("slide", phipsi.shapes.Sphere(0.1), link="slide").collider("wall", phipsi.shapes.Sphere(0.1))
    >>> scene = builder.build()
    >>> found = scene.inverse_kinematics(phipsi.tasks.Distance(lower=0.05), [0.1])
    >>> found.reached, found.q.round(3)
    (True, array([0.25]))
    """

    pair: tuple[str, str] | Sequence[tuple[str, str]] | None = None
    """Names of two colliders, or a sequence of such pairs; None: all pairs that can touch."""
    lower: ArrayLike = 0.0
    """Least distance, (...), m; negative for a largest penetration. It is met to within the tolerance: add a margin if
    the colliders must not touch.
    """
    position: float = DISTANCE_DEVIATION
    """Standard deviation, m. It is smaller than those of other tasks by default: of a target inside of the table,
    the result is in front of the table, to within a percent of the error of the target.
    """


@summarized
class InverseKinematics(NamedTuple):
    """Result of inverse kinematics.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> found = scene.inverse_kinematics([phipsi.tasks.Position("link6", (0.5, 0.1, 0.4))])
    >>> found.q.shape, found.reached
    ((6,), True)
    """

    q: _Array
    """Configuration, (..., nq), within the joint limits and on the constraints of the connections."""
    reached: NDArray[np.bool_] | bool
    """Whether the errors of all tasks are within the tolerance, (...). Otherwise q is the best local minimum that was
    found; this does not prove that no solution exists.
    """
    position_error: _Array | np.float64
    """Largest distance of a task from its target, (...), m."""
    rotation_error: _Array | np.float64
    """Largest angle of a task from its target, (...), rad."""
    starts: NDArray[np.int64] | int
    """Number of starting configurations that were used, (...)."""
    iterations: NDArray[np.int64] | int
    """Number of iterations, summed over all starting configurations, (...)."""
    covariance: _Array | None = None
    """Covariance of q in its tangent space, (..., nv, nv), from the standard deviations of the tasks and of the
    posture.
    It is zero at joints that are at a limit, and infinite in directions that no task determines if no posture is
    given. None if it was not requested.
    """


Task: TypeAlias = Pose | Position | Orientation | Direction | LookAt | CenterOfMass | JointPosition | Distance

#: Name of each kind on the Rust side, and the number of values of a target.
KINDS: dict[type, tuple[str, int]] = {
    Pose: ("pose", 16), Position: ("position", 3), Orientation: ("orientation", 9), Direction: ("direction", 3), LookAt: ("look-at", 3),
    CenterOfMass: ("center-of-mass", 3), JointPosition: ("joint", 1), Distance: ("distance", 1),
}  # fmt: skip

#: Trailing axes of targets that are matrices.
SQUARE: dict[str, tuple[int, int]] = {"pose": (4, 4), "orientation": (3, 3)}

_Unpacked = tuple[str, str, str, Sequence[float], Sequence[float], float, float, _Array, int, str | None]


if TYPE_CHECKING:

    class _InverseKinematicsWithCovariance(InverseKinematics):
        """The result with covariance=True, for type checkers."""

        covariance: _Array


def unpacked(tasks: Any) -> list[_Unpacked]:
    """Tasks as the Rust side takes them: kind, name for error messages, link or joint, point, axis, deviations, target
    with its values in the last axis, their number, and the link that the target is relative to.
    """
    given = [tasks] if type(tasks) in KINDS else list(tasks)
    return [part for at, task in enumerate(given) for part in (_distances(at, task) if type(task) is Distance else [_one(at, task)])]


def _one(at: int, task: Any) -> _Unpacked:
    if type(task) not in KINDS:
        raise of_argument(ArgumentError, "tasks", f"found {type(task).__name__} at {at}; expected {', '.join(kind.__name__ for kind in KINDS)} of phipsi.tasks")
    kind, width = KINDS[type(task)]
    name = f"tasks[{at}]"
    target = _numbers(name, "target", task.target)
    square = SQUARE.get(kind)
    if square is not None:
        if target.shape[-2:] != square:
            raise of_argument(ShapeError, f"{name}.target", f"found shape {target.shape}; expected (..., {square[0]}, {square[1]})")
        target = target.reshape(*target.shape[:-2], width)
    elif kind == "joint":
        target = target[..., None]
    elif target.ndim == 0 or target.shape[-1] != width:
        raise of_argument(ShapeError, f"{name}.target", f"found shape {target.shape}; expected (..., {width})")
    point, axis = getattr(task, "at", ORIGIN), getattr(task, "axis", FORWARD)
    # Most tasks use the defaults.
    point = ORIGIN if point is ORIGIN else _triple(name, "at", point).tolist()
    axis = FORWARD if axis is FORWARD else unit(f"{name}.axis", _triple(name, "axis", axis)).tolist()
    deviation = getattr(task, "deviation", DEVIATION)
    position, rotation = float(getattr(task, "position", deviation)), float(getattr(task, "rotation", deviation))
    on = task.joint if kind == "joint" else getattr(task, "link", "")
    return kind, name, on, point, axis, position, rotation, target, width, getattr(task, "relative_to", None)


def _distances(at: int, task: Distance) -> list[_Unpacked]:
    name = f"tasks[{at}]"
    pairs = [("", None)] if task.pair is None else collider_pairs(f"{name}.pair", task.pair)
    if not pairs:
        raise of_argument(ArgumentError, f"{name}.pair", "found no pair; expected the names of two colliders, a sequence of such pairs, or None for all pairs")
    lower = _numbers(name, "lower", task.lower)[..., None]
    position = float(task.position)
    # The second collider is in the place of the link that a task is relative to.
    return [("distance", name, first, ORIGIN, FORWARD, position, DEVIATION, lower, 1, second) for first, second in pairs]


def _numbers(name: str, field: str, value: ArrayLike) -> _Array:
    return numbers(f"{name}.{field}", value)


def _triple(name: str, field: str, value: ArrayLike) -> _Array:
    found = _numbers(name, field, value)
    if found.shape != (3,):
        raise of_argument(ShapeError, f"{name}.{field}", f"found shape {found.shape}; expected (3,)")
    return found


def unit(name: str, axis: _Array) -> _Array:
    """The axis, or direction, with unit length."""
    if not np.isfinite(axis).all():
        raise of_argument(NotFiniteError, name, f"found {axis.tolist()}; expected finite numbers")
    largest = np.abs(axis).max()
    if largest == 0.0:
        raise of_argument(ArgumentError, name, "found an axis without direction; expected one of any length above zero")
    scaled = axis / largest  # avoids overflow and underflow of the squares
    return np.asarray(scaled / np.linalg.norm(scaled))


#: Results of a state that could not be computed: reached, errors, starts, iterations.
NO_NUMBERS = np.array([0.0, np.nan, np.nan, 0.0, 0.0])


def gathered(numbers: _Array, nq: int, nv: int, covariance: bool) -> InverseKinematics:
    """Results of a batch from the Rust side, one row per state."""
    q, beside, rest = numbers[..., :nq].copy(), numbers[..., nq : nq + 5], numbers[..., nq + 5 :]
    room = rest.reshape(*numbers.shape[:-1], nv, nv).copy() if covariance else None
    if numbers.ndim == 1:
        reached, position, rotation, starts, iterations = np.where(np.isnan(beside), NO_NUMBERS, beside).tolist()
        return InverseKinematics(q, bool(reached), np.float64(position), np.float64(rotation), int(starts), int(iterations), room)
    each = np.moveaxis(np.where(np.isnan(beside), NO_NUMBERS, beside), -1, 0)
    return InverseKinematics(q, each[0] != 0.0, each[1].copy(), each[2].copy(), each[3].astype(np.int64), each[4].astype(np.int64), room)
