"""Conserved quantities: energy, and the momentum of floating trees without gravity."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .cases import Case
from .runs import Path

Array = NDArray[np.float64]


class Drift(NamedTuple):
    """Largest change over the rows of a run; None if the quantity is not conserved in the scene."""

    energy: float | None
    """Relative to the largest kinetic energy of the run."""
    angular: float | None
    """Angular momentum about the origin of the world, relative to its magnitude."""
    linear: float | None


def drift(case: Case, path: Path) -> Drift:
    """For a run that did not fail."""
    scene = case.scene
    energy = angular = linear = None
    if case.conserves:
        parts = scene.energy(path.q, path.qd)
        stretch = path.q[:, scene.nq - scene.nv :]
        total = np.asarray(parts.kinetic) + np.asarray(parts.potential) + 0.5 * (scene.stiffness * stretch**2).sum(axis=-1)
        energy = float(np.max(np.abs(total - total[0])) / np.max(parts.kinetic))
    if scene.nq != scene.nv and not np.any(scene.gravity):
        momentum = scene.momentum(path.q, path.qd)
        angular, linear = (_change(momentum[:, part]) for part in (slice(0, 3), slice(3, 6)))
    return Drift(energy, angular, linear)


def _change(vectors: Array) -> float:
    return float(np.max(np.linalg.norm(vectors - vectors[0], axis=-1)) / np.linalg.norm(vectors[0]))
