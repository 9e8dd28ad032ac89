"""Random states of a scene, reproducible by seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._core import Scene
from .._random import ranges

Array = NDArray[np.float64]


@dataclass(frozen=True)
class States:
    """States of a scene, one per row."""

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


def draw(scene: Scene, count: int, seed: int) -> States:
    """Draw states: positions within limits, joint velocities in (-1, 1), torques of the magnitude of the bias torque.

    A joint without limits is rotated in (-pi, pi) or translated in (-1, 1) m. Connections are satisfied.
    """
    generator = np.random.default_rng(seed)
    low, high = ranges(scene)
    steps = generator.uniform(low, high, (count, scene.nv))
    q = scene.integrate(scene.neutral(), steps)
    qd = generator.uniform(-1.0, 1.0, (count, scene.nv))
    if scene.loops.names:
        nearest = scene.loops.project(q, qd)
        q, qd = nearest.q, np.asarray(nearest.qd)
    size = np.abs(scene.bias_torque(q, qd)).max(axis=0, initial=0.0)
    size = np.where(size > 0.0, size, size.max(initial=0.0) or 1.0)
    tau = generator.uniform(-1.0, 1.0, (count, scene.nv)) * size
    return States(q, qd, tau)
