"""Scenes that are included in the package: a chain, and extreme cases by name.

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


def __dir__() -> list[str]:
    return __all__


class Extreme(NamedTuple):
    """An extreme case at one value of its parameter, with one state.

    Examples
    --------
    >>> import phipsi
    >>> phipsi.scenes.extreme("heavy-tip").name
    'heavy-tip'
    """

    scene: Scene
    """Scene with the links `link0`, ... on the joints `joint0`, ... from the base outward."""
    q: NDArray[np.float64]
    """Configuration, (nq,). All values of the state are generic and, except for quaternions, exactly representable in
    float32.
    """
    qd: NDArray[np.float64]
    """Joint velocities, (nv,), rad/s or m/s."""
    tau: NDArray[np.float64]
    """Joint torques, (nv,), N m or N."""
    name: str
    """Name of the case, one of names()."""
    value: float
    """Value of the parameter."""
    parameter: str
    """Description of the parameter, with its unit."""
    values: tuple[float, ...]
    """Suggested values for a parameter sweep."""


def names() -> tuple[str, ...]:
    """Names of the extreme cases.

    Returns
    -------
    tuple of str
        Names, for the argument `name` of extreme.

    Examples
    --------
    >>> import phipsi
    >>> "heavy-tip" in phipsi.scenes.names()
    True
    """
    return _core.extreme_names()


def extreme(name: str, value: float | None = None, *, bodies: int | None = None, seed: int = 0) -> Extreme:
    """Build an extreme case: a scene with a given value of its parameter, and one state.

    Parameters
    ----------
    name : str
        Name of the case, one of names().
    value : float, optional
        Value of the parameter; None: the default of the case.
    bodies : int, optional
        Number of joints; None: the default of the case.
    seed : int
        Seed of the state, and of the masses of "log-uniform-masses". Equal arguments give equal cases.

    Returns
    -------
    Extreme
        Scene and state. With "zero-inertia" at 0 the scene is built, but its forward dynamics raises for the last
        joint.

    Raises
    ------
    ArgumentError
        If the name is unknown, the value is not valid for the case, or the number of bodies is out of range.
    OutOfMemoryError
        If the memory for the bodies is not available.

    Notes
    -----
    The cost is O(bodies).

    Examples
    --------
    >>> import phipsi
    >>> phipsi.scenes.extreme("heavy-tip", 1e6, bodies=4).scene.nv
    4
    """
    return Extreme(*_core.extreme(name, value, bodies, seed))


def chain(n: int) -> Scene:
    """Build a serial chain of equal links, as used in the benchmarks.

    Each link has a length of 0.3 m and a mass of 1 kg; the joints are revolute about z, with successive axes at right
    angles.

    Parameters
    ----------
    n : int
        Number of links.

    Returns
    -------
    Scene
        The chain.

    Raises
    ------
    ArgumentError
        If n is not a nonnegative integer.
    OutOfMemoryError
        If the memory for the links is not available.

    Examples
    --------
    >>> import phipsi
    >>> phipsi.scenes.chain(3).nv
    3
    """
    return _core.chain(n)
