"""Random configurations of a scene."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .errors import ArgumentError, OutOfMemoryError, of_argument

if TYPE_CHECKING:
    from ._core import Scene

_Array = NDArray[np.float64]

#: Limits beyond this value (rad or m) mean "no limit" in many files.
LARGEST_LIMIT = 20.0
#: Largest displacement from neutral of a joint without limits, by degree of freedom: rad or m.
REACH: dict[str, list[float]] = {
    "revolute": [np.pi],
    "continuous": [np.pi],
    "screw": [np.pi],
    "prismatic": [1.0],
    "planar": [1.0, 1.0, np.pi],
    "universal": [np.pi, np.pi],
    "spherical": [np.pi, np.pi, np.pi],
    "floating": [1.0, 1.0, 1.0, np.pi, np.pi, np.pi],
}


def ranges(scene: Scene) -> tuple[_Array, _Array]:
    """Smallest and largest displacement from neutral of every degree of freedom, (nv,) each."""
    low, high = np.empty(scene.nv), np.empty(scene.nv)
    limits, joints = scene.limits, scene.joints
    for name in scene.joint_names:
        at = scene.v_index(name)
        reach = np.array(REACH[joints[name].type])
        low[at], high[at] = -reach, reach
        if len(reach) == 1:
            lower, upper = float(limits.lower[at][0]), float(limits.upper[at][0])
            has_lower, has_upper = abs(lower) <= LARGEST_LIMIT, abs(upper) <= LARGEST_LIMIT
            low[at] = lower if has_lower else upper - 2.0 * reach if has_upper else -reach
            high[at] = upper if has_upper else low[at] + 2.0 * reach
    return low, high


def generator_of(seed: Any) -> np.random.Generator:
    """The argument `seed`: a generator, or one from a seed."""
    try:
        return np.random.default_rng(seed)
    except (TypeError, ValueError):
        raise of_argument(ArgumentError, "seed", f"found {seed!r}; expected a seed (an integer, 0 or larger) or a numpy.random.Generator") from None


def configuration(scene: Scene, seed: Any, size: Any) -> _Array:
    """Implementation of Scene.random_configuration."""
    generator = generator_of(seed)
    try:
        batch = np.broadcast_shapes(() if size is None else size)
    except (TypeError, ValueError):
        raise of_argument(ArgumentError, "size", f"found {size!r}; expected a number of configurations, or a tuple of numbers") from None
    if not scene.nv and math.prod(batch):
        return np.zeros((*batch, 0))
    low, high = ranges(scene)
    shape = (*batch, scene.nv)
    try:
        displacements = generator.uniform(low, high, shape)
    except (MemoryError, ValueError):  # ValueError: more bytes than an address has
        raise of_argument(OutOfMemoryError, "size", f"no room for {8 * math.prod(shape)} bytes") from None
    q = np.asarray(scene.integrate(scene.neutral(), displacements))
    for name in scene.joint_names:
        at = scene.q_index(name)
        if at.stop - at.start in (4, 7):
            turn = generator.standard_normal((*batch, 4))
            q[..., at.stop - 4 : at.stop] = turn / np.linalg.norm(turn, axis=-1, keepdims=True)
    return q
