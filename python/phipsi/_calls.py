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
def forward_dynamics(scene: Scene, form: str) -> Call:
    """qdd of (q, qd, tau)."""
    coordinates = Coordinates(scene)

    def value(q: Array, qd: Array, tau: Array) -> Array:
        return np.asarray(scene.forward_dynamics(coordinates.normalised(q), qd, tau, form=form))  # type: ignore[call-overload]

    def derivatives(q: Array, qd: Array, tau: Array) -> tuple[Array, ...]:
        by_q, by_qd, minv = scene.forward_dynamics_derivatives(coordinates.normalised(q), qd, tau, form=form)  # type: ignore[arg-type]
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


def on_host(function: Host, arrays: tuple[ArrayLike, ...]) -> Any:
    """Calls a function with float64 arrays."""
    return function(*(np.asarray(array, dtype=np.float64) for array in arrays))
