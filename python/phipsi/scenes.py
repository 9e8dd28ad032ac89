"""Scenes that ship with the library: a plain chain, and extreme cases by name.

>>> import phipsi
>>> case = phipsi.scenes.extreme("heavy-tip", 1e12)
>>> case.scene.nv, case.parameter
(8, 'mass of the last link, kg')
>>> case.scene.forward_dynamics(case.q, case.qd, case.tau).shape
(8,)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import _core
from ._core import Scene

__all__ = ["Extreme", "chain", "extreme", "names"]


class Extreme(NamedTuple):
    """An extreme case at one value of its parameter, with one state."""

    scene: Scene
    """Links `link0`, ... on joints `joint0`, ... from the base outward."""
    q: NDArray[np.float64]
    """Configuration, (nq,). All numbers of the state are generic, and but for quaternions ones that float32 holds."""
    qd: NDArray[np.float64]
    """Rates, (nv,), rad/s or m/s."""
    tau: NDArray[np.float64]
    """Torques or forces, (nv,), N m or N."""
    name: str
    """Its name, one of names()."""
    value: float
    """The value that was used."""
    parameter: str
    """What is swept, with its unit."""
    values: tuple[float, ...]
    """Values worth sweeping."""


def names() -> tuple[str, ...]:
    """The names of the extreme cases."""
    return _core.extreme_names()


def extreme(name: str, value: float | None = None, *, bodies: int | None = None, seed: int = 0) -> Extreme:
    """The extreme case of that name: its scene with the parameter at `value` and with `bodies` joints, and a state.

    What is not given is as usual for the case; `seed` picks the state, and the masses of "log-uniform-masses". The same
    arguments give the same case. "zero-inertia" at 0 builds, and its forward dynamics raises for its last joint. O(bodies).

    Raises ArgumentError for a name that is not there (with those that are), a value that the case has no meaning for, and
    too few or too many bodies; OutOfMemoryError for more than there is room for.
    """
    return Extreme(*_core.extreme(name, value, bodies, seed))


def chain(n: int) -> Scene:
    """A chain of n equal links, 0.3 m and 1 kg, revolute about z, successive axes at right angles: what the benches run.

    Raises ArgumentError where n is no whole number; OutOfMemoryError for more links than there is room for.
    """
    return _core.chain(n)
