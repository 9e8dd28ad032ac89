"""Random states of a scene, reproducible by seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._core import Scene
from .structure import Tree

Array = NDArray[np.float64]

#: Limits beyond this value (rad or m) mean "no limit" in many files.
LARGEST_LIMIT = 20.0


@dataclass(frozen=True)
class States:
    """States of a scene, one per row; all values are exactly representable in float32."""

    q: Array
    """(n, nq)."""
    qd: Array
    """(n, nv)."""
    tau: Array
    """(n, nv)."""

    def __len__(self) -> int:
        return len(self.qd)

    @property
    def arrays(self) -> tuple[Array, Array, Array]:
        """q, qd and tau."""
        return self.q, self.qd, self.tau

    def first(self, count: int) -> States:
        """The first `count` states."""
        return States(*(values[:count] for values in self.arrays))


def draw(scene: Scene, tree: Tree, count: int, seed: int) -> States:
    """Draw states: positions within limits, joint velocities in (-1, 1), torques of the magnitude of the bias torque.

    A joint without limits is rotated in (-pi, pi) or translated in (-1, 1) m. The values are rounded to
    float32, so that both precisions have the same inputs.
    """
    generator = np.random.default_rng(seed)
    low, high = ranges(scene, tree)
    steps = generator.uniform(low, high, (count, scene.nv))
    q = in_float32(scene.integrate(scene.neutral(), steps))
    qd = in_float32(generator.uniform(-1.0, 1.0, (count, scene.nv)))
    size = np.abs(scene.bias_torque(q, qd)).max(axis=0, initial=0.0)
    size = np.where(size > 0.0, size, size.max(initial=0.0) or 1.0)
    tau = in_float32(generator.uniform(-1.0, 1.0, (count, scene.nv)) * size)
    return States(q, qd, tau)


def ranges(scene: Scene, tree: Tree) -> tuple[Array, Array]:
    """Smallest and largest displacement from neutral of every degree of freedom."""
    low, high = np.empty(scene.nv), np.empty(scene.nv)
    limits = scene.limits
    for name in scene.joint_names:
        at = scene.v_index(name)
        reach = np.array(REACH[tree.joints[name].type])
        low[at], high[at] = -reach, reach
        if len(reach) == 1:
            lower, upper = float(limits.lower[at][0]), float(limits.upper[at][0])
            if -LARGEST_LIMIT <= lower < upper <= LARGEST_LIMIT:
                low[at], high[at] = lower, upper
    return low, high


#: Largest displacement from neutral of a joint without limits, by degree of freedom: rad or m.
REACH: dict[str, list[float]] = {
    "revolute": [np.pi],
    "continuous": [np.pi],
    "screw": [np.pi],
    "prismatic": [1.0],
    "planar": [1.0, 1.0, np.pi],
    "spherical": [np.pi, np.pi, np.pi],
    "floating": [1.0, 1.0, 1.0, np.pi, np.pi, np.pi],
}


def in_float32(values: Array) -> Array:
    """The values rounded to float32, as float64."""
    return values.astype(np.float32).astype(np.float64)
