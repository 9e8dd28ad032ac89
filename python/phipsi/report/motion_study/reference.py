"""The reference of each case: two solutions of different kinds, whose difference is taken for its error."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .cases import Case
from .runs import distance

Array = NDArray[np.float64]

#: An error is shown if it is so many times larger than the reference's own.
FAR = 30.0
#: Steps in which springs are followed by rk4, at most.
MOST_STEPS = 200_000
#: The fastest spring turns by so much in a step there, rad.
RESOLVED = 0.05
#: Steps of the second solution where springs are not followed: on the slow manifold nothing is as fast.
SLOW_STEPS = 4000


class Exact(NamedTuple):
    """What a case ends with."""

    q: Array
    qd: Array
    error: float
    """Between the two solutions, as errors are measured; eps times the size of q at least."""
    by: str
    """How it was computed."""
    beside: str
    """And the other solution."""


def reference(case: Case, most: int = MOST_STEPS) -> Exact:
    """An adaptive solution by SciPy, and beside it one of fixed steps in the core, extrapolated."""
    turns = case.time * case.omega
    adaptive, tolerance = ("DOP853", 1e-13) if turns < 2e3 else ("Radau", 1e-12)
    path = case.scene.ode().solve(
        case.q, case.qd, (0.0, case.time), method=adaptive, rtol=tolerance, atol=0.1 * tolerance
    )
    q, qd = path.q[-1], path.qd[-1]
    steps = max(64 * case.first, 10 * int(np.ceil(turns / RESOLVED / 10)))
    method = "rk4"
    if steps > most:
        method, steps = "rosenbrock-3", SLOW_STEPS
    other = extrapolated(case, method, steps)
    error = max(distance(case, q, other), rounding(q))
    return Exact(
        q, qd, error,
        f"SciPy's {adaptive}, tolerance {tolerance:.0e}, {path.steps} steps",
        f"{method} with {steps} and {2 * steps} steps, extrapolated",
    )  # fmt: skip


def ringing(case: Case) -> Exact:
    """For springs that ring: rk4 with small steps, extrapolated, and beside it the same with twice the steps, which is kept."""
    steps = 10 * int(np.ceil(max(case.time * case.omega / RESOLVED, 64 * case.first) / 10))
    first, second = (extrapolated(case, "rk4", count) for count in (steps, 2 * steps))
    by = f"rk4 with {2 * steps} and {4 * steps} steps, extrapolated"
    error = max(distance(case, second, first), rounding(second))
    return Exact(second, np.full(case.scene.nv, np.nan), error, by, f"with {steps} and {2 * steps} steps")


def rounding(q: Array) -> float:
    """What no solution in float64 is known better than."""
    return float(np.finfo(np.float64).eps) * max(1.0, float(np.max(np.abs(q))))


def extrapolated(case: Case, method: str, steps: int) -> Array:
    """The configuration at the end by Richardson's extrapolation of two runs, on the manifold."""
    order = {"rk4": 4, "rosenbrock-3": 3}[method]
    ends = [
        case.scene.simulate(
            case.q, case.qd, dt=case.time / count, steps=count, method=method, record_every=count
        ).q[-1]
        for count in (steps, 2 * steps)
    ]
    further = case.scene.difference(ends[0], ends[1]) / (2.0**order - 1.0)
    return case.scene.integrate(ends[1], further)
