"""The errors and warnings of phipsi.

Each message names the argument, link or joint, what was found, what was expected, and a fix if there is one.

>>> import phipsi
>>> scene = phipsi.load(phipsi.BUNDLED_ARM)
>>> try:
...     scene.forward_dynamics([0.0] * 5, [0.0] * 6, [0.0] * 6)
... except phipsi.errors.ShapeError as error:
...     print(error.argument)
q
"""

from __future__ import annotations

import contextlib
import difflib
import sys
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from ._motion import Trajectory

__all__ = [
    "ArgumentError",
    "BadStateWarning",
    "CacheWarning",
    "ConstraintError",
    "ContactWarning",
    "IdentificationWarning",
    "DivergenceWarning",
    "FrictionWarning",
    "InertiaWarning",
    "InternalError",
    "LimitWarning",
    "LinkageWarning",
    "LogWarning",
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
    "PlanWarning",
    "UncertaintyWarning",
    "UnitsWarning",
    "UnknownTagWarning",
]


def __dir__() -> list[str]:
    return __all__


class PhipsiError(Exception):
    """Base class of all errors that phipsi raises."""

    __slots__ = ()  # as Exception, so that it can replace the base class of another exception: adopt_panics


class InternalError(PhipsiError):
    """A fault of phipsi itself, not of the call: a panic of the compiled half. Later calls are not affected.

    Report it with the call, the robot and the message. With the environment variable RUST_BACKTRACE=1, the place is
    also printed with a backtrace.
    """

    place: str = ""
    """File and line of the sources where it occurred."""


def adopt_panics(panic: type[BaseException]) -> None:
    """Turn the exception of PyO3 for a panic, which is not an Exception, into InternalError where it is created."""

    def become(self: Any, message: str | InternalError = "") -> None:
        from ._core import __version__, _panic_place

        self.__class__ = InternalError
        if isinstance(message, InternalError):  # Python before 3.12 creates it again, as the class is another one
            self.args, self.place = message.args, message.place
            return
        self.place = _panic_place(message)
        asks = "this is a fault of phipsi, please report it with the call and the robot"
        self.args = (f"internal error: {message} ({self.place}, phipsi {__version__}); {asks}",)

    # If a later Python does not allow this, phipsi can be imported all the same, and panics remain those of PyO3.
    with contextlib.suppress(TypeError):
        panic.__bases__ = (PhipsiError,)
        panic.__init__ = become  # type: ignore[method-assign, assignment]


class SceneError(PhipsiError, ValueError):
    """A scene cannot be read or built: a kinematic cycle, an unknown parent, a negative mass, malformed XML."""


class ArgumentError(PhipsiError, ValueError):
    """An argument has an unsupported type or value, or names an unknown link, joint or option."""

    argument: str = ""
    """Name of the argument."""


class ShapeError(PhipsiError, ValueError):
    """The shape of an array does not match the scene, or its leading axes do not broadcast with those of the other
    arguments.
    """

    argument: str = ""
    """Name of the argument."""


class NotFiniteError(PhipsiError, ValueError):
    """An argument contains NaN or infinity, or a result overflowed."""

    argument: str = ""
    """Name of the argument or result."""
    index: int = 0
    """Index of the entry within its state."""
    state: int | tuple[int, ...] | None = None
    """Index of the state in the batch; a tuple if the batch has several axes; None for a single state."""


_OfArgument = TypeVar("_OfArgument", ArgumentError, ShapeError, NotFiniteError, "OutOfMemoryError")


def of_argument(kind: type[_OfArgument], argument: str, message: str) -> _OfArgument:
    """The error of an argument; its message begins with the name of the argument."""
    error = kind(f"{argument}: {message}")
    error.argument = argument
    return error


#: The folder of the package, whose frames are not code of the user.
_PACKAGE = str(Path(__file__).parent / "_")[:-1]


def warn(message: str | Warning, category: type[Warning] | None = None) -> None:
    """Issue a warning at the line of the user's code that called the package."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, category, stacklevel=level)


def known_names(name: str, known: Iterable[str]) -> str:
    """Names for the message about an unknown one, the closest match first."""
    names = list(known)
    closest = difflib.get_close_matches(name, names, 1)
    return ", ".join([*closest, *(one for one in names if one not in closest)])


def place_in_time(step: int, t: float) -> str:
    """A step and its time, s, for messages."""
    return f"step {step} (t = {t:.6f} s)" if abs(t) < 1e9 else f"step {step} (t = {t:.6g} s)"


class SingularJointError(PhipsiError, ArithmeticError):
    """A joint has no inertia along its axis: its pivot D(k) (equation 3.6) is below the rounding error.

    Add inertia about the axis (Scene.with_payload) or armature to the joint (Scene.with_properties).
    """

    joint: str = ""
    """Name of the joint."""
    link: str = ""
    """Name of the link outboard of the joint."""
    pivot: float = float("nan")
    """Computed pivot, kg m^2 or kg."""
    state: int | tuple[int, ...] | None = None
    """Index of the state in the batch; a tuple if the batch has several axes; None for a single state."""


class SingularTaskError(PhipsiError, ArithmeticError):
    """The operational-space inertia is undefined, because the scene cannot move in all task directions independently.

    The inverse inertia is defined: use Scene.operational_inverse_inertia, or omit dependent directions.
    """

    links: tuple[str, ...] = ()
    """Names of the links, in the order of the call."""
    rank: int = 0
    """Number of independent directions."""
    directions: int = 0
    """Number of directions of the task."""
    state: int | tuple[int, ...] | None = None
    """Index of the state in the batch; a tuple if the batch has several axes; None for a single state."""


class ConstraintError(PhipsiError, ArithmeticError):
    """Connections cannot be satisfied: they contradict each other, or a state violates them and cannot be
    projected onto them.

    Scene.loops.project computes the nearest positions and velocities that satisfy the connections, if there are any.
    """

    connections: tuple[str, ...] = ()
    """Names of the connections."""
    residual: float = 0.0
    """Largest remaining error: of the position (rad or m), or of its first (1/s) or second (1/s^2) time derivative."""
    state: int | tuple[int, ...] | None = None
    """Index of the state in the batch; a tuple if the batch has several axes; None for a single state."""


class OutOfMemoryError(PhipsiError, MemoryError):
    """The memory for an argument or a result is not available; if the size is known in advance, the error is raised
    before the computation.
    """

    argument: str = ""
    """Name of the argument that determines the size."""
    bytes: int = 0
    """Required memory, bytes."""
    free: int | None = None
    """Free memory, bytes, if it is known and was the reason; otherwise None."""


class SimulationError(PhipsiError, ArithmeticError):
    """A simulation ended early, because the motion diverged, a joint became singular, or the function for tau raised an
    exception.

    The exception is chained (`__cause__`); the attributes contain the completed steps.
    """

    trajectory: Trajectory
    """Rows of the completed steps; of a Simulator, which records no rows, the current state."""
    step: int = 0
    """Index of the failed step, from zero: the number of completed steps."""
    joint: str = ""
    """Name of the joint that caused the error; empty if tau raised an exception."""
    state: int | tuple[int, ...] | None = None
    """Index of the state in the batch; a tuple if the batch has several axes; None for a single state, or if tau raised
    an exception.
    """


class SimulationInterrupted(KeyboardInterrupt):
    """A simulation was interrupted by Ctrl-C; the attributes contain the completed steps."""

    trajectory: Trajectory
    """Rows of the completed steps; of a Simulator, which records no rows, the current state."""
    step: int = 0
    """Number of completed steps."""


class IdentificationWarning(UserWarning):
    """A result of an identification that is less certain than its intervals: the predicted bias by noise in the measured motion is large, or the scene cannot represent all of it."""


class InertiaWarning(UserWarning):
    """The inertia of a link is physically impossible, its radius of gyration is far beyond the size of the scene, it is
    that of a uniform shape whose center is not the center of mass, or no moving link of a URDF has mass; the values are
    used unchanged.
    """


class FrictionWarning(UserWarning):
    """Exact joint friction (friction_speed=0) is requested in a scene with contacts, where it is regularized in the steps
    in which contacts act.
    """


class ContactWarning(UserWarning):
    """A motion starts with contacts below their surface, which the first steps move out."""


class LimitWarning(UserWarning):
    """Limits of a URDF are invalid (lower above upper, negative velocity or effort, not of its version) and are ignored,
    all limits of a joint are zero, which locks it, a joint starts outside its limits, or the connections of a closed
    mechanism prevent a stop from acting.
    """


class CacheWarning(UserWarning):
    """The cache of compiled code cannot be written; each process compiles the code again."""


class LinkageWarning(UserWarning):
    """Constraints of a linkage are linearly dependent to within the tolerance of the scene, but not to within rounding,
    and count as dependent: the dimensions of the linkage have few digits. Or phipsi.compile found dependent constraints,
    for which the scene computes all states.
    """


class LogWarning(UserWarning):
    """A log of measurements that contradicts itself or the model: units, clocks, gaps, repeated times."""


class LongCodeWarning(UserWarning):
    """The generated code of a robot will take the compiler a long time."""


class MimicWarning(UserWarning):
    """A joint that should follow another joint is an independent coordinate."""


class ModelWarning(UserWarning):
    """Parts of a MuJoCo model that a scene cannot represent are omitted: contacts, limits of tendons and ball joints,
    air, soft constraints. Or the start and the keyframes of a scene, which URDF cannot represent.
    """


class PlanWarning(UserWarning):
    """A plan of Scene.optimize whose motion touches something, which it does not know, or leaves the connections of the
    scene.
    """


class DivergenceWarning(UserWarning):
    """Readings differ from the predictions of an observer by more than it states: check its model, noise and sensors."""

    sensor: str = ""
    """Name of the sensor whose readings differ most from their predictions."""
    state: tuple[int, ...] = ()
    """Index of the robot in the batch, () for one."""


class UncertaintyWarning(UserWarning):
    """Error bands of a simulation that first order does not describe: of joints held by friction, whose error is zero to
    first order, and of contacts that errors can bring into another mode (open, sticking, sliding).
    """


class UnitsWarning(UserWarning):
    """A value that is probably in another unit: joint limits in degrees, target positions in millimeters, or a step of
    seconds that does not resolve the motion.
    """


class UnknownTagWarning(UserWarning):
    """Unknown elements, attributes or text of a URDF are ignored; one warning per file."""


class MeshWarning(UserWarning):
    """Meshes of a URDF or MuJoCo model are not drawn, because their files were not found or cannot be read."""


class BadStateWarning(UserWarning):
    """States of a call with errors="nan" could not be computed: their results are NaN; all other results are
    unaffected.

    ``with warnings.catch_warnings(record=True) as caught: ...`` gives access to the warning as
    ``caught[0].message``. If a filter turns the warning into an error, the results are lost.
    """

    states: tuple[int | tuple[int, ...], ...] = ()
    """Indices of the bad states in the batch, ascending: integers; tuples if the batch has several axes; () for
    a single state.
    """
    reasons: tuple[PhipsiError, ...] = ()
    """Exception that errors="raise" would have raised for each of these states, with its attributes."""
