"""Terms of the cost of Scene.optimize, and their form on the Rust side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._arguments import numbers, whole
from ..errors import ArgumentError, ShapeError, of_argument
from ..tasks import KINDS, Task

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["During", "Effort", "EffortRate", "Function", "NotPositive", "State", "Terminal", "Term", "read"]

_Array = NDArray[np.float64]


class State(NamedTuple):
    """Cost of the deviation from a state or from a path of states.

    Examples
    --------
    >>> from phipsi import control
    >>> rest = control.Terminal(control.State(qd=0.0, velocity=0.01))
    """

    q: ArrayLike | None = None
    """Configuration, (nq,), or one for each knot, (knots, nq); None: the neutral one."""
    qd: ArrayLike = 0.0
    """Joint velocities, a number, (nv,) or (knots, nv), rad/s or m/s."""
    position: ArrayLike = np.inf
    """Standard deviation of q in its tangent space, a number or (nv,), rad or m; inf: no cost."""
    velocity: ArrayLike = np.inf
    """Standard deviation of qd, a number or (nv,), rad/s or m/s; inf: no cost."""


class Effort(NamedTuple):
    """Cost of the joint torques, or of their deviation from given ones.

    Examples
    --------
    >>> from phipsi import control
    >>> cost = control.Effort(10.0)
    """

    deviation: ArrayLike
    """Standard deviation, a number or (nv,), N m or N; inf: no cost."""
    tau: ArrayLike = 0.0
    """Joint torques, a number, (nv,) or (knots, nv), N m or N."""


class EffortRate(NamedTuple):
    """Cost of the rate of the joint torques, for smooth efforts.

    Examples
    --------
    >>> from phipsi import control
    >>> cost = control.EffortRate(100.0)
    """

    deviation: ArrayLike
    """Standard deviation, a number or (nv,), N m/s or N/s; inf: no cost."""
    before: ArrayLike | None = None
    """Joint torques before the first step, (nv,); None: the change to the first ones has no cost."""


class Function(NamedTuple):
    """Cost of residuals that a function computes.

    Examples
    --------
    >>> from phipsi import control
    >>> slow = control.Function(lambda q, qd, tau: 0.1 * qd[:, :1] ** 2)
    """

    residuals: Callable[[_Array, _Array, _Array], ArrayLike]
    """Function of q (k, nq), qd (k, nv) and tau (k, nv) of the knots of the term to residuals (k, m): half their squares
    are the cost. The torques of the end of the motion are zero.
    """
    derivatives: Callable[[_Array, _Array, _Array], Any] | None = None
    """Function of the same arguments to the derivatives by q in its tangent space, by qd and by tau, (k, m, nv) each, or
    None for those that are zero. None: differences of the residuals, whose relative error is about 1e-9.
    """


class Terminal(NamedTuple):
    """A term at the end of the motion; it is not multiplied by the time step.

    Examples
    --------
    >>> import phipsi
    >>> from phipsi import control
    >>> goal = control.Terminal(phipsi.tasks.Position("link6", (0.5, 0.1, 0.4)))
    """

    term: Any
    """Term, or task of phipsi.tasks."""


class During(NamedTuple):
    """A term at some knots only.

    Examples
    --------
    >>> from phipsi import control
    >>> still = control.During(control.State(velocity=0.1), 20, 30)
    """

    term: Any
    """Term, or task of phipsi.tasks."""
    first: int
    """First knot; knot k is the state before step k."""
    last: int
    """Last knot, inclusive; `steps` is the end of the motion."""


class NotPositive(NamedTuple):
    """Inequality: the residuals of a function are at most zero at every knot of the motion after the start.

    Examples
    --------
    >>> from phipsi import control
    >>> below = control.NotPositive(control.Function(lambda q, qd, tau: q[:, :1] - 1.0))
    """

    term: Any
    """Function, or During of one."""


Term: TypeAlias = State | Effort | EffortRate | Function | Terminal | During | NotPositive | Task

#: A term on the Rust side: kind, first and last knot, whether it is an inequality, and its arguments.
_Given = tuple[str, int, int, bool, Any]

#: Largest relative step of differences of residuals: the root of the rounding, for central differences its cube root.
STEP = 6e-6


def read(scene: Scene, costs: Any, steps: int, start: tuple[_Array, _Array]) -> list[_Given]:
    """The terms as the Rust side takes them."""
    given = [costs] if _is_term(costs) else list(costs)
    if not given:
        raise ArgumentError("costs: found none; expected terms of phipsi.control and phipsi.tasks, of which one has a cost of the efforts")
    return [_one(scene, f"costs[{at}]", term, steps, start) for at, term in enumerate(given)]


def _is_term(value: Any) -> bool:
    return isinstance(value, (State, Effort, EffortRate, Function, Terminal, During, NotPositive)) or type(value) in KINDS


def _one(scene: Scene, name: str, term: Any, steps: int, start: tuple[_Array, _Array]) -> _Given:
    first, last, is_limit = 0, steps - 1, False
    if isinstance(term, NotPositive):
        term, first, last, is_limit = term.term, 1, steps, True
        inner = term.term if isinstance(term, During) else term
        if not isinstance(inner, Function):
            raise of_argument(ArgumentError, name, f"found NotPositive of {type(inner).__name__}; expected a Function or During of one")
    if isinstance(term, Terminal):
        term, first, last = term.term, steps, steps
    elif isinstance(term, During):
        first, last = (whole(f"{name}.{what}", value, 0) for what, value in (("first", term.first), ("last", term.last)))
        if not first <= last <= steps:
            raise of_argument(ArgumentError, name, f"found knots {first} to {last}; expected knots in order, of 0 to {steps}")
        term = term.term
    if isinstance(term, (Terminal, During, NotPositive)):
        raise of_argument(ArgumentError, name, f"found {type(term).__name__} within another; expected a term or a task")
    if not _is_term(term):
        raise of_argument(ArgumentError, name, f"found {type(term).__name__}; expected a term of phipsi.control or a task of phipsi.tasks")
    if isinstance(term, (Effort, EffortRate)):
        if first == steps:
            raise of_argument(ArgumentError, name, "found a cost of efforts at the end of the motion; expected knots before it")
        last = min(last, steps - 1)
    kind, arguments = _arguments(scene, name, term, (first, last), start, steps)
    return kind, first, last, is_limit, arguments


def _arguments(
    scene: Scene, name: str, term: Any, knots: tuple[int, int], start: tuple[_Array, _Array], steps: int
) -> tuple[str, Any]:
    count, nv = knots[1] - knots[0] + 1, scene.nv
    if isinstance(term, State):
        q = scene.neutral() if term.q is None else _each(f"{name}.q", term.q, scene.nq, count)
        spread = [weights(f"{name}.{what}", value, nv) for what, value in (("position", term.position), ("velocity", term.velocity))]
        return "state", (np.ravel(q), np.ravel(_each(f"{name}.qd", term.qd, nv, count)), *spread)
    if isinstance(term, Effort):
        tau = _each(f"{name}.tau", term.tau, nv, count)
        return "effort", (np.ravel(tau), weights(f"{name}.deviation", term.deviation, nv))
    if isinstance(term, EffortRate):
        before = np.zeros(0) if term.before is None else _each(f"{name}.before", term.before, nv, 1)
        return "rate", (weights(f"{name}.deviation", term.deviation, nv), np.ravel(before))
    if isinstance(term, Function):
        called = _Residuals(scene, name, term)
        q, qd = (np.repeat(of[None], count, axis=0) for of in start)
        return "function", (called, called.of(q, qd, np.zeros((count, nv))).shape[1])
    return "tasks", [term]


def _each(name: str, value: ArrayLike, width: int, count: int) -> _Array:
    """One entry for all knots, (width,), or one for each, (count, width)."""
    array = numbers(name, value)
    if array.ndim == 0:
        array = np.full(width, float(array))
    if array.shape not in {(width,), (count, width)}:
        raise of_argument(ShapeError, name, f"found shape {array.shape}; expected ({width},) or ({count}, {width}), one for each knot")
    return np.ascontiguousarray(array)


def weights(name: str, deviation: ArrayLike, nv: int) -> _Array:
    array = np.broadcast_to(numbers(name, deviation), (nv,)) if np.ndim(deviation) == 0 else numbers(name, deviation)
    if array.shape != (nv,):
        raise of_argument(ShapeError, name, f"found shape {array.shape}; expected a number or ({nv},)")
    if not (array > 0.0).all():
        raise of_argument(ArgumentError, name, f"found {array[~(array > 0.0)][0]}; expected positive deviations, or inf for no cost")
    return 1.0 / array


class _Residuals:
    """Residuals of a function of the user with their derivatives, checked."""

    def __init__(self, scene: Scene, name: str, term: Function) -> None:
        self.scene, self.name, self.term = scene, name, term
        if not callable(term.residuals):
            raise of_argument(ArgumentError, f"{name}.residuals", f"found {term.residuals!r}; expected a function of (q, qd, tau)")

    def of(self, q: _Array, qd: _Array, tau: _Array) -> _Array:
        found = np.asarray(self.term.residuals(q, qd, tau), np.float64)
        if found.ndim != 2 or len(found) != len(q):
            raise of_argument(ShapeError, f"{self.name}.residuals", f"found residuals of shape {found.shape}; expected ({len(q)}, m), a row for each knot")
        return np.ascontiguousarray(found)

    def __call__(self, q: _Array, qd: _Array, tau: _Array) -> tuple[_Array, list[_Array]]:
        found = self.of(q, qd, tau)
        shape = (*found.shape, self.scene.nv)
        if self.term.derivatives is None:
            return found, self._differences(q, qd, tau, shape)
        given = self.term.derivatives(q, qd, tau)
        names = ("q", "qd", "tau")
        if not isinstance(given, Sequence) or len(given) != len(names):
            raise of_argument(ShapeError, f"{self.name}.derivatives", f"found {type(given).__name__}; expected three arrays: by q, qd and tau")
        all_of = []
        for name, by in zip(names, given, strict=True):
            array = np.zeros(shape) if by is None else np.asarray(by, np.float64)
            if array.shape != shape:
                raise of_argument(ShapeError, f"{self.name}.derivatives", f"found shape {array.shape} by {name}; expected {shape}")
            all_of.append(np.ascontiguousarray(array))
        return found, all_of

    def _differences(self, q: _Array, qd: _Array, tau: _Array, shape: tuple[int, ...]) -> list[_Array]:
        results = [np.zeros(shape) for _ in range(3)]
        for column in range(self.scene.nv):
            step = np.zeros(self.scene.nv)
            step[column] = STEP
            for by, moved in zip(results, self._moved(q, qd, tau, step), strict=True):
                by[..., column] = (self.of(*moved[0]) - self.of(*moved[1])) / (2.0 * STEP)
        return results

    def _moved(self, q: _Array, qd: _Array, tau: _Array, step: _Array) -> list[list[tuple[_Array, _Array, _Array]]]:
        along_q = [(self.scene.integrate(q, sign * step), qd, tau) for sign in (1.0, -1.0)]
        along_qd = [(q, qd + sign * step, tau) for sign in (1.0, -1.0)]
        along_tau = [(q, qd, tau + sign * step) for sign in (1.0, -1.0)]
        return [along_q, along_qd, along_tau]
