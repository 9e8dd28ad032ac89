"""The torques that a control function returns during a simulation."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import _core
from .errors import ArgumentError, ShapeError, of_argument

if TYPE_CHECKING:
    from ._core import Scene

_Array = NDArray[np.float64]


def torques(tau: Callable[..., Any], scene: Scene, t: float, q: _Array, qd: _Array) -> _Array:
    """The torques that a control function returns, which broadcast to the shape of qd."""
    name = "tau(t, q, qd)"
    try:
        value = tau(t, q, qd)
    except TypeError as error:
        # Without a frame of the function, the call itself failed.
        if error.__traceback__ is not None and error.__traceback__.tb_next is not None:
            raise
        expected = f"a function of (t, q, qd) that returns torques of shape {qd.shape}"
        raise of_argument(ArgumentError, name, f"found that the call failed ({error}); expected {expected}") from error
    found = np.asarray(_core._numbers(name, value, scene))
    try:
        fits = np.broadcast_shapes(found.shape, qd.shape) == qd.shape
    except ValueError:
        fits = False
    if not fits:
        raise of_argument(ShapeError, name, f"found shape {found.shape}; expected {qd.shape}")
    return found


class Recorded:
    """A control function of Scene.simulate that keeps the torques of the steps that begin at a recorded row, and those
    of the last step.
    """

    def __init__(self, scene: Scene, tau: Callable[..., Any], every: int) -> None:
        self._scene, self._tau, self._every = scene, tau, every
        self._steps = 0
        self._rows: list[_Array] = []
        self._last: _Array | None = None

    def __call__(self, t: float, q: _Array, qd: _Array) -> _Array:
        """The torques of the next step, (..., nv); called once per step."""
        # A copy, because the function may return the same array for each step.
        self._last = np.array(torques(self._tau, self._scene, t, q, qd))
        if self._steps % self._every == 0:
            self._rows.append(self._last)
        self._steps += 1
        return self._last

    def rows(self, batch: tuple[int, ...], count: int, nv: int) -> _Array:
        """Torques of the step that begins at each of `count` rows, (..., rows, nv); in the last row, if no step begins
        there, those of the last step.
        """
        rows = self._rows[:count]
        if self._last is None:
            rows = [np.zeros(nv)] * count
        elif len(rows) < count:
            rows = [*rows, self._last]
        return np.stack([np.broadcast_to(row, (*batch, nv)) for row in rows], axis=-2)
