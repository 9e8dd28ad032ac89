"""What phipsi.jax and phipsi.torch share: functions of plain numbers on the host, with their derivatives."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._coordinates import Array, Coordinates

if TYPE_CHECKING:
    from ._core import Scene

#: One array of results, or one a derivative, from the arguments; leading axes are batches and broadcast.
Host = Callable[..., Any]


class Call:
    """A function of a scene: its value, its derivatives by each argument (by the numbers of q, not by its tangent), and the shape of a result."""

    def __init__(self, value: Host, derivatives: Host, widths: tuple[int, ...], size: int) -> None:
        self.value = value
        self.derivatives = derivatives
        #: How many numbers each argument and the result have.
        self.widths = widths
        self.size = size


def _by_coordinates(coordinates: Coordinates, q: Array, by_tangent: NDArray[np.float64]) -> Array:
    return np.asarray(by_tangent @ coordinates.tangents(q))


@lru_cache(maxsize=32)
def forward_dynamics(scene: Scene, form: str, tolerance: float | None = None) -> Call:
    """qdd of (q, qd, tau)."""
    coordinates = Coordinates(scene)

    def value(q: Array, qd: Array, tau: Array) -> Array:
        return np.asarray(scene.forward_dynamics(coordinates.normalised(q), qd, tau, form=form, tolerance=tolerance))  # type: ignore[call-overload]

    def derivatives(q: Array, qd: Array, tau: Array) -> tuple[Array, ...]:
        by_q, by_qd, minv = scene.forward_dynamics_derivatives(coordinates.normalised(q), qd, tau, form=form, tolerance=tolerance)  # type: ignore[arg-type]
        return _by_coordinates(coordinates, q, by_q), by_qd, minv

    return Call(value, derivatives, (scene.nq, scene.nv, scene.nv), scene.nv)


@lru_cache(maxsize=32)
def inverse_dynamics(scene: Scene) -> Call:
    """tau of (q, qd, qdd)."""
    coordinates = Coordinates(scene)

    def value(q: Array, qd: Array, qdd: Array) -> Array:
        return np.asarray(scene.inverse_dynamics(coordinates.normalised(q), qd, qdd))

    def derivatives(q: Array, qd: Array, qdd: Array) -> tuple[Array, ...]:
        by_q, by_qd, mass = scene.inverse_dynamics_derivatives(coordinates.normalised(q), qd, qdd)
        return _by_coordinates(coordinates, q, by_q), by_qd, mass

    return Call(value, derivatives, (scene.nq, scene.nv, scene.nv), scene.nv)


@lru_cache(maxsize=32)
def integrate(scene: Scene) -> Call:
    """q (+) v of (q, v)."""
    coordinates = Coordinates(scene)

    def value(q: Array, v: Array) -> Array:
        return np.asarray(scene.integrate(coordinates.normalised(q), v))

    return Call(value, coordinates.integrated, (scene.nq, scene.nv), scene.nq)


class Rollout:
    """States through time with torques of their own in every step, as functions of plain numbers: the rows, and the gradients of a scalar of them."""

    def __init__(self, scene: Scene, record_every: int, **given: Any) -> None:
        self.scene, self.record_every, self.given = scene, record_every, given
        self.coordinates = Coordinates(scene)

    def value(self, q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
        """The rows of (q, qd, tau): (..., rows, nq) and (..., rows, nv)."""
        path = self.scene.simulate(self.coordinates.normalised(q), qd, tau_steps=tau, **self._steps(tau))
        return path.q, path.qd

    def gradients(self, q: Array, tau: Array, rows: Array, rates: Array, by_rows: Array, by_rates: Array) -> tuple[Array, Array, Array]:
        """By q, qd and tau, where those by the rows and their rates are given."""
        rows = self.coordinates.normalised(rows)
        by_tangents = np.einsum("...i,...ij->...j", by_rows, self.coordinates.changes(rows))
        found = self.scene.simulate_vjp(rows, rates, by_tangents, by_rates, tau_steps=tau, **self._steps(tau))
        return np.einsum("...i,...ij->...j", found.q, self.coordinates.tangents(q)), found.qd, found.tau

    def _steps(self, tau: Array) -> dict[str, Any]:
        return {**self.given, "steps": tau.shape[-2], "record_every": self.record_every}

    def rows(self, steps: int) -> int:
        """How many rows so many steps give."""
        return steps // self.record_every + 1


def on_host(function: Host, arrays: tuple[ArrayLike, ...]) -> Any:
    """Calls a function with float64 arrays."""
    return function(*(np.asarray(array, dtype=np.float64) for array in arrays))
