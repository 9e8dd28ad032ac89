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
    rate_error: float
    """The same of the rates; where the other solution damps springs, between two tolerances of this one."""
    by: str
    """How it was computed."""
    beside: str
    """And the other solution."""


def reference(case: Case, most: int = MOST_STEPS) -> Exact:
    """An adaptive solution by SciPy, and beside it one of fixed steps in the core, extrapolated."""
    turns = case.time * case.omega
    adaptive, tolerance, absolute = ("DOP853", 1e-13, 1e-14) if turns < 2e3 else ("Radau", 1e-12, 1e-16)
    q, qd, taken = _adaptive(case, adaptive, tolerance, absolute)
    steps = max(64 * case.first, 10 * int(np.ceil(turns / RESOLVED / 10)))
    method = "rk4"
    if steps > most:
        method, steps = "rosenbrock-3", SLOW_STEPS
    other, rates = extrapolated(case, method, steps)
    if method != "rk4":
        _, rates, _ = _adaptive(case, adaptive, 30.0 * tolerance, 30.0 * absolute)
    return Exact(
        q, qd, max(distance(case, q, other), rounding(q)), max(float(np.max(np.abs(rates - qd))), rounding(qd)),
        f"SciPy's {adaptive}, tolerance {tolerance:.0e}, {taken} steps",
        f"{method} with {steps} and {2 * steps} steps, extrapolated",
    )  # fmt: skip


def _adaptive(case: Case, method: str, tolerance: float, absolute: float) -> tuple[Array, Array, int]:
    path = case.scene.ode().solve(case.q, case.qd, (0.0, case.time), method=method, rtol=tolerance, atol=absolute)
    return path.q[-1], path.qd[-1], path.steps


def ringing(case: Case) -> Exact:
    """For springs that ring: rk4 with small steps, extrapolated, and beside it the same with twice the steps, which is kept."""
    steps = 10 * int(np.ceil(max(case.time * case.omega / RESOLVED, 64 * case.first) / 10))
    (first, before), (second, rates) = (extrapolated(case, "rk4", count) for count in (steps, 2 * steps))
    return Exact(
        second, rates, max(distance(case, second, first), rounding(second)),
        max(float(np.max(np.abs(rates - before))), rounding(rates)),
        f"rk4 with {2 * steps} and {4 * steps} steps, extrapolated", f"with {steps} and {2 * steps} steps",
    )  # fmt: skip


def rounding(values: Array) -> float:
    """What no solution in float64 is known better than."""
    return float(np.finfo(np.float64).eps) * max(1.0, float(np.max(np.abs(values))))


def extrapolated(case: Case, method: str, steps: int) -> tuple[Array, Array]:
    """q and qd at the end by Richardson's extrapolation of two runs, on the manifold."""
    order = {"rk4": 4, "rosenbrock-3": 3}[method]
    coarse, fine = (
        case.scene.simulate(case.q, case.qd, dt=case.time / count, steps=count, method=method, record_every=count)
        for count in (steps, 2 * steps)
    )
    share = 1.0 / (2.0**order - 1.0)
    further = case.scene.difference(coarse.q[-1], fine.q[-1]) * share
    return case.scene.integrate(fine.q[-1], further), fine.qd[-1] + share * (fine.qd[-1] - coarse.qd[-1])
