"""Tasks of inverse kinematics: what should be where, and how exactly it is meant.

>>> import phipsi
>>> scene = phipsi.load(phipsi.BUNDLED_ARM)
>>> hand = phipsi.tasks.Position("link6", (0.5, 0.1, 0.4))
>>> scene.inverse_kinematics([hand]).reached
True

Positions, directions and rotations are in the base's frame, or in that of the link that a task is relative to; a target with leading axes is a batch. position and rotation are standard deviations, m and rad: of two tasks
that cannot both be met, the one with the smaller deviation wins; those that can be met all are, whatever their deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import ArgumentError, NotFiniteError, ShapeError, of_argument

__all__ = ["CenterOfMass", "Direction", "InverseKinematics", "JointPosition", "LookAt", "Orientation", "Pose", "Position", "Task"]

_Array = NDArray[np.float64]

#: Within what a task is meant, unless it says otherwise: a millimetre, a milliradian.
DEVIATION = 1e-3
ORIGIN, FORWARD = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)


class Pose(NamedTuple):
    """A link has a place: its frame, moved by `at`, is where the target says."""

    link: str
    """Name of the link."""
    target: ArrayLike
    """Homogeneous matrix, link to base, (..., 4, 4), as Scene.placement gives it; a rotation with three decimals or more is orthonormalized."""
    at: ArrayLike = ORIGIN
    """The point of the link that is meant, in its frame, (3,), m."""
    position: float = DEVIATION
    """Standard deviation of the position, m."""
    rotation: float = DEVIATION
    """Standard deviation of the rotation, rad."""
    relative_to: str | None = None
    """Name of the link in whose frame the target is; None: the base's."""


class Position(NamedTuple):
    """A point of a link is at a point."""

    link: str
    """Name of the link."""
    target: ArrayLike
    """(..., 3), m."""
    at: ArrayLike = ORIGIN
    """The point of the link, in its frame, (3,), m."""
    position: float = DEVIATION
    """Standard deviation, m."""
    relative_to: str | None = None
    """Name of the link in whose frame the target is; None: the base's."""


class Orientation(NamedTuple):
    """A link has an orientation."""

    link: str
    """Name of the link."""
    target: ArrayLike
    """Rotation matrix, link to base, (..., 3, 3); one with three decimals or more is orthonormalized."""
    rotation: float = DEVIATION
    """Standard deviation, rad."""
    relative_to: str | None = None
    """Name of the link in whose frame the target is; None: the base's."""


class Direction(NamedTuple):
    """An axis of a link has a direction; turning about it is free."""

    link: str
    """Name of the link."""
    target: ArrayLike
    """(..., 3), of any length."""
    axis: ArrayLike = FORWARD
    """In the link's frame, (3,), of any length."""
    rotation: float = DEVIATION
    """Standard deviation, rad."""
    relative_to: str | None = None
    """Name of the link in whose frame the target is; None: the base's."""


class LookAt(NamedTuple):
    """An axis through a point of a link points to a point: a camera that keeps something in view."""

    link: str
    """Name of the link."""
    target: ArrayLike
    """(..., 3), m."""
    axis: ArrayLike = FORWARD
    """In the link's frame, (3,), of any length."""
    at: ArrayLike = ORIGIN
    """The point of the link that the axis goes through, in its frame, (3,), m."""
    rotation: float = DEVIATION
    """Standard deviation, rad."""
    relative_to: str | None = None
    """Name of the link in whose frame the target is; None: the base's."""


class CenterOfMass(NamedTuple):
    """The mass centre of all that moves is at a point."""

    target: ArrayLike
    """(..., 3), m."""
    position: float = DEVIATION
    """Standard deviation, m."""


class JointPosition(NamedTuple):
    """A joint of one coordinate has a position."""

    joint: str
    """Name of the joint."""
    target: ArrayLike
    """(...), rad or m."""
    deviation: float = DEVIATION
    """Standard deviation, rad or m."""


class InverseKinematics(NamedTuple):
    """What inverse kinematics found."""

    q: _Array
    """The configuration, (..., nq), within the limits of the joints and with closed connections."""
    reached: NDArray[np.bool_] | bool
    """Whether every task's error is within the tolerance, (...). Where it is not, q is the best that was found: a local minimum, which does not prove that there is none."""
    position_error: _Array | np.float64
    """The largest distance of a task from its target, (...), m."""
    rotation_error: _Array | np.float64
    """The largest angle of a task, (...), rad."""
    starts: NDArray[np.int64] | int
    """How many starts were used, (...)."""
    iterations: NDArray[np.int64] | int
    """Steps over all starts, (...)."""
    covariance: _Array | None = None
    """Of q in its tangent space, (..., nv, nv), as deviations of tasks and posture have it; zero at joints that are at a limit, infinite where a motion is left undetermined and there is no
    posture. None where it was not asked for."""


Task: TypeAlias = Pose | Position | Orientation | Direction | LookAt | CenterOfMass | JointPosition

#: By the names that Rust knows them by; width of a target.
KINDS: dict[type, tuple[str, int]] = {
    Pose: ("pose", 16), Position: ("position", 3), Orientation: ("orientation", 9), Direction: ("direction", 3), LookAt: ("look-at", 3),
    CenterOfMass: ("center-of-mass", 3), JointPosition: ("joint", 1),
}  # fmt: skip

#: The last axes of targets that are matrices.
SQUARE: dict[str, tuple[int, int]] = {"pose": (4, 4), "orientation": (3, 3)}

_Unpacked = tuple[str, str, str, Sequence[float], Sequence[float], float, float, _Array, int, str | None]


def unpacked(tasks: Any) -> list[_Unpacked]:
    """For Rust: kind, what errors call it, link or joint, point, axis, deviations, target with its numbers in the last axis, how many these are, and the link that it is relative to."""
    given = [tasks] if type(tasks) in KINDS else list(tasks)
    return [_one(at, task) for at, task in enumerate(given)]


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
    # Most calls have neither.
    point = ORIGIN if point is ORIGIN else _triple(name, "at", point).tolist()
    axis = FORWARD if axis is FORWARD else _unit(f"{name}.axis", _triple(name, "axis", axis)).tolist()
    deviation = getattr(task, "deviation", DEVIATION)
    position, rotation = float(getattr(task, "position", deviation)), float(getattr(task, "rotation", deviation))
    on = task.joint if kind == "joint" else getattr(task, "link", "")
    return kind, name, on, point, axis, position, rotation, target, width, getattr(task, "relative_to", None)


def _numbers(name: str, field: str, value: ArrayLike) -> _Array:
    try:
        return np.asarray(value, float)
    except (TypeError, ValueError):
        raise of_argument(ArgumentError, f"{name}.{field}", f"found {type(value).__name__}, which is no array of numbers") from None


def _triple(name: str, field: str, value: ArrayLike) -> _Array:
    found = _numbers(name, field, value)
    if found.shape != (3,):
        raise of_argument(ShapeError, f"{name}.{field}", f"found shape {found.shape}; expected (3,)")
    return found


def _unit(name: str, axis: _Array) -> _Array:
    """Of unit length."""
    if not np.isfinite(axis).all():
        raise of_argument(NotFiniteError, name, f"found {axis.tolist()}; expected finite numbers")
    largest = np.abs(axis).max()
    if largest == 0.0:
        raise of_argument(ArgumentError, name, "found an axis without direction; expected one of any length above zero")
    scaled = axis / largest  # squares of small or large numbers are none
    return np.asarray(scaled / np.linalg.norm(scaled))


#: Of a state that could not be computed: reached, errors, starts, iterations.
NO_NUMBERS = np.array([0.0, np.nan, np.nan, 0.0, 0.0])


def gathered(numbers: _Array, nq: int, nv: int, covariance: bool) -> InverseKinematics:
    """From Rust: the results of a batch, a row a state."""
    q, beside, rest = numbers[..., :nq].copy(), numbers[..., nq : nq + 5], numbers[..., nq + 5 :]
    room = rest.reshape(*numbers.shape[:-1], nv, nv).copy() if covariance else None
    if numbers.ndim == 1:
        reached, position, rotation, starts, iterations = np.where(np.isnan(beside), NO_NUMBERS, beside).tolist()
        return InverseKinematics(q, bool(reached), np.float64(position), np.float64(rotation), int(starts), int(iterations), room)
    each = np.moveaxis(np.where(np.isnan(beside), NO_NUMBERS, beside), -1, 0)
    return InverseKinematics(q, each[0] != 0.0, each[1].copy(), each[2].copy(), each[3].astype(np.int64), each[4].astype(np.int64), room)
