"""Reference of each case: two solutions by different methods, whose difference is the estimate of the error."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .cases import Case
from .runs import distance

Array = NDArray[np.float64]

#: An error is shown if it is larger than that of the reference by this factor.
FAR = 30.0
#: Largest number of rk4 steps for springs.
MOST_STEPS = 200_000
#: Angle of the fastest spring per step, rad.
RESOLVED = 0.05
#: Steps of the second solution on the slow manifold, where springs are not resolved.
SLOW_STEPS = 4000


class Exact(NamedTuple):
    """Final state of a case."""

    q: Array
    qd: Array
    error: float
    """Difference of the two solutions, as errors are measured; at least eps times the magnitude of q."""
    rate_error: float
    """The same for joint velocities; if the other solution damps springs, between two tolerances of this one."""
    by: str
    """Method of the solution."""
    beside: str
    """Method of the other solution."""


def reference(case: Case, most: int = MOST_STEPS) -> Exact:
    """An adaptive solution by SciPy, and an extrapolated fixed-step solution in the core."""
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
    """For oscillating springs: extrapolated rk4 with small steps, and the same with twice the number of steps, which is
    used.
    """
    steps = 10 * int(np.ceil(max(case.time * case.omega / RESOLVED, 64 * case.first) / 10))
    (first, before), (second, rates) = (extrapolated(case, "rk4", count) for count in (steps, 2 * steps))
    return Exact(
        second, rates, max(distance(case, second, first), rounding(second)),
        max(float(np.max(np.abs(rates - before))), rounding(rates)),
        f"rk4 with {2 * steps} and {4 * steps} steps, extrapolated", f"with {steps} and {2 * steps} steps",
    )  # fmt: skip


def rounding(values: Array) -> float:
    """Lower bound of the error of any solution in float64."""
    return float(np.finfo(np.float64).eps) * max(1.0, float(np.max(np.abs(values))))


def extrapolated(case: Case, method: str, steps: int) -> tuple[Array, Array]:
    """Final q and qd by Richardson extrapolation of two runs, on the manifold."""
    order = {"rk4": 4, "rosenbrock-3": 3}[method]
    coarse, fine = (
        case.scene.simulate(case.q, case.qd, dt=case.time / count, steps=count, method=method, record_every=count)
        for count in (steps, 2 * steps)
    )
    share = 1.0 / (2.0**order - 1.0)
    further = case.scene.difference(coarse.q[-1], fine.q[-1]) * share
    return case.scene.integrate(fine.q[-1], further), fine.qd[-1] + share * (fine.qd[-1] - coarse.qd[-1])
