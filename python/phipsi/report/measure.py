"""The figures of a report: residuals, error and time of each method, condition numbers, growth with size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .. import _core
from .._core import Scene
from .states import States

Array = NDArray[np.float64]
#: Called after every piece of work.
Tick = Callable[[], None]

#: Unit roundoff by precision: the distance from 1 to the next number.
EPS = {"float64": float(np.finfo(np.float64).eps), "float32": float(np.finfo(np.float32).eps)}
PRECISIONS = ("float64", "float32")
#: Times each method is measured, in turns with the others.
ROUNDS = 5
#: The same for the growth with size.
GROWTH_ROUNDS = 3
#: Beyond this many degrees of freedom nothing dense is built.
DENSE_CAP = 300
#: Residuals may be this many times eps times size or condition number.
SLACK = 64.0


def median(values: Array) -> float:
    """The median of the numbers that are finite; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


@dataclass(frozen=True)
class Residual:
    """One identity over all states."""

    name: str
    median: float
    worst: float
    bound: float
    """The bound at the state where the residual is worst in units of it."""
    ratio: float
    """Largest residual in units of its bound."""
    through_inverse: bool
    """Whether the bound is 64 cond(M) eps; otherwise 64 nv eps."""

    @property
    def passed(self) -> bool:
        return self.ratio <= 1.0


def residuals(scene: Scene, states: States, conditions: Array, tick: Tick) -> list[Residual]:
    """Every identity at every state, against its bound; `conditions`: cond(M) of each state."""
    values: dict[str, list[float]] = {}
    grows: dict[str, bool] = {}
    for q, qd, tau in zip(states.q, states.qd, states.tau, strict=True):
        for name, value, through_inverse in _core.residuals(scene, q, qd, tau):
            values.setdefault(name, []).append(value)
            grows[name] = through_inverse
        tick()
    by_size = np.full(len(states), SLACK * scene.nv * EPS["float64"])
    # The condition number of a small matrix may be below its size, and so the sums of nv terms decide.
    by_condition = np.maximum(by_size, SLACK * conditions * EPS["float64"])
    return [
        _residual(name, np.array(v), by_condition if grows[name] else by_size, grows[name])
        for name, v in values.items()
    ]


def _residual(name: str, values: Array, bounds: Array, through_inverse: bool) -> Residual:
    ratios = values / bounds
    # A NaN is the worst there is: argmax finds it.
    at = int(np.argmax(ratios))
    return Residual(
        name, float(np.median(values)), float(values.max()), float(bounds[at]), float(ratios[at]), through_inverse
    )


@dataclass(frozen=True)
class Accuracy:
    """One method in one precision over all states; error and time are of the same calls."""

    method: str
    precision: str
    ns: float
    """Median time of `Scene::evaluate` in Rust, one state a call."""
    errors: Array
    """Of each state: largest error over largest acceleration; NaN where the method met a bad pivot."""

    @property
    def median(self) -> float:
        return median(self.errors)

    @property
    def worst(self) -> float:
        finite = self.errors[np.isfinite(self.errors)]
        return float(finite.max()) if finite.size else float("nan")

    @property
    def failed(self) -> int:
        """States where the method met a bad pivot."""
        return int(np.count_nonzero(~np.isfinite(self.errors)))

    @property
    def digits_lost(self) -> float:
        """log10 of the median error in units of eps; below zero where it is less than one unit."""
        return self._digits(self.median)

    @property
    def digits_lost_worst(self) -> float:
        """The same of the worst state."""
        return self._digits(self.worst)

    def _digits(self, error: float) -> float:
        return float(np.log10(max(error, 1e-300) / EPS[self.precision])) if np.isfinite(error) else float("nan")


def accuracy(scene: Scene, states: States, methods: Sequence[str], repeats: int, tick: Tick) -> list[Accuracy]:
    """Error against run time: every method in both precisions, against double-double, `auto` first.

    The time is the median over the rounds of each round's median of `repeats` passes.
    """
    reference = _core.reference(scene, states.q, states.qd, states.tau)
    cases = [(method, precision) for precision in PRECISIONS for method in methods]
    times: list[list[float]] = [[] for _ in cases]
    errors: list[Array] = []
    # In rounds, so that a change of the machine's pace falls on all methods alike.
    for _ in range(ROUNDS):
        errors = []
        for case, measured in zip(cases, times, strict=True):
            ns, found = _core.measure(scene, *case, states.q, states.qd, states.tau, reference, repeats)
            measured.append(ns)
            errors.append(found)
        tick()
    return [Accuracy(*case, float(np.median(ns)), found) for case, ns, found in zip(cases, times, errors, strict=True)]


def condition_numbers(scene: Scene, q: Array) -> Array:
    """cond(M), largest over smallest singular value, of each state; (n, nq) to (n,)."""
    return np.array([float(np.linalg.cond(scene.mass_matrix(one))) for one in q])


@dataclass(frozen=True)
class Growth:
    """Time a body on a chain of equal links, ns: `Scene::evaluate` in Rust, one state a call."""

    bodies: int
    forward: float
    """Forward dynamics in form "auto"."""
    covariance: float
    """The same in form "covariance"."""
    inverse: float


def growth(sizes: Sequence[int], repeats: int, tick: Tick) -> list[Growth]:
    """Time a body of forward and inverse dynamics, by number of bodies."""
    rows: dict[int, Growth] = {}
    # Other load only ever adds time, and rarely to the same size twice: the least of the rounds' medians.
    for _ in range(GROWTH_ROUNDS):
        for bodies in sizes:
            times = _core.growth(bodies, repeats)
            known = rows.get(bodies, Growth(bodies, *times))
            before = (known.forward, known.covariance, known.inverse)
            rows[bodies] = Growth(bodies, *(min(pair) for pair in zip(before, times, strict=True)))
            tick()
    return list(rows.values())


#: Chains that operators are applied on.
OPERATOR_SIZES = (10, 100, 1000, 10_000)


@dataclass(frozen=True)
class OperatorGrowth:
    """Time a body of applying one operator, ns, on chains of OPERATOR_SIZES links; a star is its transpose."""

    name: str
    ns: tuple[float, ...]

    @property
    def spread(self) -> float:
        """Largest over smallest: about 1 where applying is linear in the number of bodies."""
        return spread(self.ns)


def operator_growth(repeats: int, tick: Tick) -> list[OperatorGrowth]:
    """Time a body of applying every operator and its transpose, by number of bodies."""
    best: dict[str, list[float]] = {}
    for _ in range(GROWTH_ROUNDS):
        for at, bodies in enumerate(OPERATOR_SIZES):
            for name, ns in _core.operator_growth(bodies, repeats):
                times = best.setdefault(name, [float("inf")] * len(OPERATOR_SIZES))
                times[at] = min(times[at], ns)
            tick()
    return [OperatorGrowth(name, tuple(times)) for name, times in best.items()]


def spread(values: Sequence[float]) -> float:
    """Largest over smallest."""
    return max(values) / min(values)
