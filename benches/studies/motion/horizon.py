"""Duration for which the motion of the double pendulum can be compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phipsi import errors
from .cases import Case
from .runs import METHODS

Array = NDArray[np.float64]

#: rad; small compared with the motion, large compared with rounding.
MOVED = 1e-12
#: Number of random directions of the perturbation of the initial state.
DIRECTIONS = 8
#: Distance of the rows, s.
END, APART = 12.0, 0.25
#: Steps per second of the solutions by rk4, and of the methods.
FINE, SHOWN = 4096, 1024
#: Largest difference of the two references, rad.
AGREED = 1e-10


@dataclass(frozen=True)
class Horizon:
    """Growth of a small perturbation of the initial state, and of the difference of two references."""

    case: str
    t: Array
    """(n,), s."""
    growth: Array
    """(n,), maximum over the directions, relative to the initial perturbation."""
    difference: Array
    """(n,), difference of the references, rad."""
    errors: dict[str, Array]
    """(n,) by method, with steps of 1/SHOWN s; NaN after a failure."""

    def json(self) -> dict[str, Any]:
        """All values, with the settings."""
        return {
            "case": self.case, "seconds": self.end, "agreement": AGREED, "t": self.t, "growth": self.growth,
            "difference_of_references": self.difference, "step": 1.0 / SHOWN, "errors": self.errors,
        }  # fmt: skip

    @property
    def end(self) -> float:
        """Last time until which the references agree to AGREED, s."""
        apart = self.difference > AGREED
        return float(self.t[int(np.argmax(apart)) - 1] if apart.any() else self.t[-1])


def measure(case: Case, end: float = END) -> Horizon:
    """Both references every APART s, DOP853 and extrapolated rk4; the initial state perturbed in random directions;
    every method.
    """
    scene = case.scene
    count = round(end / APART)
    t: Array = np.linspace(APART, count * APART, count)
    first = _adaptive(case, t)
    coarse, fine = (_fixed(case, case.q, case.qd, factor * FINE, count, "rk4") for factor in (1, 2))
    second = scene.integrate(fine, scene.difference(coarse, fine) / 15.0)
    difference = np.abs(scene.difference(first, second)).max(axis=-1)
    random = np.random.default_rng(0)
    direction = random.normal(size=(DIRECTIONS, 2, scene.nv))
    direction *= MOVED / np.linalg.norm(direction, axis=(1, 2), keepdims=True)
    starts = np.concatenate([np.zeros((1, 2, scene.nv)), direction])
    q, qd = scene.integrate(np.tile(case.q, (DIRECTIONS + 1, 1)), starts[:, 0]), case.qd + starts[:, 1]
    moved = _fixed(case, q, qd, FINE, count, "rk4")
    growth: Array = np.abs(scene.difference(np.broadcast_to(moved[:1], moved[1:].shape).copy(), moved[1:])).max(axis=(0, -1)) / MOVED
    found = {}
    for method in METHODS:
        rows = _fixed(case, case.q, case.qd, SHOWN, count, method.name)
        error = np.full(count, np.nan)
        error[: len(rows)] = np.abs(scene.difference(first[: len(rows)], rows)).max(axis=-1)
        found[method.name] = error
    return Horizon(case.name, t, growth, difference, found)


def _adaptive(case: Case, t: Array) -> Array:
    """DOP853 restarted at every row, because its interpolation between steps is less accurate."""
    q, qd, before, rows = case.q, case.qd, 0.0, []
    for now in t:
        path = case.scene.ode().solve(q, qd, (before, now), rtol=1e-13, atol=1e-14)
        q, qd, before = path.q[-1], path.qd[-1], now
        rows.append(q)
    return np.array(rows)


def _fixed(case: Case, q: Array, qd: Array, rate: int, count: int, method: str) -> Array:
    every = round(rate * APART)
    try:
        path = case.scene.simulate(q, qd, dt=1.0 / rate, steps=every * count, method=method, record_every=every)
    except errors.SimulationError as error:
        path = error.trajectory
    return np.asarray(path.q[..., 1:, :])
