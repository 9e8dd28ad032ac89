"""The errors and warnings of phipsi.

Every message names the argument, link or joint, what was found, what was expected, and the remedy where there is one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from ._motion import Trajectory

__all__ = [
    "ArgumentError",
    "BadStateWarning",
    "CacheWarning",
    "ConstraintError",
    "DivergenceWarning",
    "InertiaWarning",
    "LimitWarning",
    "LinkageWarning",
    "LongCodeWarning",
    "MeshWarning",
    "MimicWarning",
    "ModelWarning",
    "NotFiniteError",
    "OutOfMemoryError",
    "PhipsiError",
    "SceneError",
    "ShapeError",
    "SimulationError",
    "SimulationInterrupted",
    "SingularJointError",
    "SingularTaskError",
    "UnknownTagWarning",
]


class PhipsiError(Exception):
    """The base of all errors that phipsi raises on purpose."""


class SceneError(PhipsiError, ValueError):
    """A scene that cannot be read or built: a cycle, an unknown parent, a negative mass, malformed XML."""


class ArgumentError(PhipsiError, ValueError):
    """An argument whose type or value cannot be used, or a name that is not there."""

    argument: str = ""
    """Name of the argument."""


class ShapeError(PhipsiError, ValueError):
    """An array whose shape does not fit the scene, or whose leading axes do not broadcast with the others."""

    argument: str = ""
    """Name of the argument."""


class NotFiniteError(PhipsiError, ValueError):
    """A NaN or an infinity in an argument, or a result that overflowed."""

    argument: str = ""
    """Name of the argument (or result)."""
    index: int = 0
    """Index of the entry within its state."""
    state: int | tuple[int, ...] | None = None
    """Index of the state in the batch, a tuple if the batch has several axes; None for a single state."""


_OfArgument = TypeVar("_OfArgument", ArgumentError, ShapeError, NotFiniteError, "OutOfMemoryError")


def of_argument(kind: type[_OfArgument], argument: str, message: str) -> _OfArgument:
    """The error of an argument, which its message begins with."""
    error = kind(f"{argument}: {message}")
    error.argument = argument
    return error


def place_in_time(step: int, t: float) -> str:
    """A step and its time, s, as messages name them."""
    return f"step {step} (t = {t:.6f} s)" if abs(t) < 1e9 else f"step {step} (t = {t:.6g} s)"


class SingularJointError(PhipsiError, ArithmeticError):
    """A joint without inertia along its axis: its pivot D(k) of equation 3.6 is lost in rounding.

    Add inertia about the axis (Scene.with_payload), or give the joint armature (Scene.with_properties).
    """

    joint: str = ""
    """Name of the joint."""
    link: str = ""
    """Name of the link that the joint carries."""
    pivot: float = float("nan")
    """The pivot found, kg m^2 or kg."""
    state: int | tuple[int, ...] | None = None
    """Index of the state in the batch, a tuple if the batch has several axes; None for a single state."""


class SingularTaskError(PhipsiError, ArithmeticError):
    """Task directions without an operational-space inertia: the scene cannot move in all of them independently.

    The inverse inertia is defined there: use operational_inverse_inertia, or leave out directions.
    """

    links: tuple[str, ...] = ()
    """Names of the links, in the order of the call."""
    rank: int = 0
    """How many of the directions are independent."""
    directions: int = 0
    """How many directions the task has."""
    state: int | tuple[int, ...] | None = None
    """Index of the state in the batch, a tuple if the batch has several axes; None for a single state."""


class ConstraintError(PhipsiError, ArithmeticError):
    """Connections that cannot hold: they contradict each other, or a state does not meet them and cannot be brought to.

    Scene.project gives positions and velocities that meet the connections, where there are any nearby.
    """

    connections: tuple[str, ...] = ()
    """Names of the connections."""
    residual: float = 0.0
    """The largest error (rad or m), or what is left of its rate (by s) or of its second derivative (by s^2)."""
    state: int | tuple[int, ...] | None = None
    """Index of the state in the batch, a tuple if the batch has several axes; None for a single state."""


class OutOfMemoryError(PhipsiError, MemoryError):
    """A size that there is no memory for, refused before anything is computed where that can be known."""

    argument: str = ""
    """Name of the argument that says how large."""
    bytes: int = 0
    """What it would take."""
    free: int | None = None
    """What is free, where that is known and was the reason."""


class SimulationError(PhipsiError, ArithmeticError):
    """A simulation that could not go on: motion diverged, a pivot was lost, or the function for tau raised.

    The cause is chained (__cause__); the steps before are kept.
    """

    trajectory: Trajectory
    """The rows of the steps that were finished; of a Simulator, which keeps none, the one row where it is now."""
    step: int = 0
    """Index of the step at fault, from zero: so many were finished."""
    joint: str = ""
    """Name of the joint at fault; empty where tau raised."""
    state: int | tuple[int, ...] | None = None
    """Index of the state in the batch, a tuple if the batch has several axes; None for a single state, or where tau raised."""


class SimulationInterrupted(KeyboardInterrupt):
    """A simulation that was stopped by Ctrl-C; the steps before are kept."""

    trajectory: Trajectory
    """The rows of the steps that were finished; of a Simulator, which keeps none, the one row where it is now."""
    step: int = 0
    """How many steps were finished."""


class InertiaWarning(UserWarning):
    """A link whose inertia no body can have, or a URDF whose moving links all have no mass; it is computed with as it is."""


class LimitWarning(UserWarning):
    """Limits in a URDF that mean nothing (lower above upper, velocity or effort below zero), which are taken as none; or joints that start outside of their limits."""


class CacheWarning(UserWarning):
    """A cache of compiled code that cannot be written: the code is compiled again in each process."""


class LinkageWarning(UserWarning):
    """Rows of connections that depend on each other to within the tolerance of the scene, but not to within rounding, and count as dependent: a linkage that is drawn with few digits."""


class LongCodeWarning(UserWarning):
    """Code of a robot that the compiler will take long for."""


class MimicWarning(UserWarning):
    """A joint that should follow another; it is taken as an independent coordinate."""


class ModelWarning(UserWarning):
    """Parts of a MuJoCo model that a scene does not have and that were omitted: contacts, limits of tendons and ball joints, air, soft constraints."""


class DivergenceWarning(UserWarning):
    """An observer whose innovations are larger than it states: a model, a noise or a sensor is another than it was given."""

    sensor: str = ""
    """Name of the sensor whose innovations are the furthest off."""
    state: tuple[int, ...] = ()
    """Index of the robot in the batch, () for one."""


class UnknownTagWarning(UserWarning):
    """Elements, attributes or text of a URDF that are not understood and were passed over: one warning for a file."""


class MeshWarning(UserWarning):
    """Shapes of a URDF or MuJoCo model that are not drawn, because their file was not found or cannot be read."""


class BadStateWarning(UserWarning):
    """States of a call with errors="nan" that could not be computed: their results are NaN, all others are as they would be.

    ``with warnings.catch_warnings(record=True) as caught: ...`` keeps it, as ``caught[0].message``; a filter that makes it an error raises
    it, and the results are lost.
    """

    states: tuple[int | tuple[int, ...], ...] = ()
    """Indices of the bad states in the batch, ascending: numbers, tuples if the batch has several axes, () for a single state."""
    reasons: tuple[PhipsiError, ...] = ()
    """What errors="raise" would have raised for each of them alone, with its attributes."""
