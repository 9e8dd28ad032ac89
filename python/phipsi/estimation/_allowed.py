"""Motions that the connections of a scene allow.

The forces of connections are J* f. They do no work on these motions, so that torques are determined only as far as they
act on them: U* tau, with U orthonormal, and J U = 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["allowed_motions", "mobility", "on_connections"]

_Array = NDArray[np.float64]


def allowed_motions(scene: Scene, q: _Array, transmission: _Array | None = None) -> _Array:
    """Orthonormal joint velocities U that the connections allow at q, as columns, (..., nv, nv); the others are zero.

    With a transmission B, velocities of the motors. A M, with A the inverse mass matrix through the connections, is a
    projector on these motions: its singular values are zero, or one and more. The rank is that of the scene, which
    also knows the tolerance of its linkages.
    """
    projector = scene.constrained_mass_matrix_inverse(q) @ scene.mass_matrix(q)
    if transmission is not None:
        projector = transmission @ projector @ np.linalg.inv(transmission)
    left, values, _ = np.linalg.svd(projector)
    return np.asarray(left * (values > 0.5)[..., None, :])


def on_connections(scene: Scene, q: _Array, qd: _Array) -> tuple[_Array, _Array, _Array]:
    """States on the connections near the given ones, and accelerations that they allow; those without one are omitted."""
    with np.errstate(invalid="ignore"):
        found = scene.project(q, qd, errors="nan")
        assert found.qd is not None
        good = np.isfinite(found.q).all(axis=-1) & np.isfinite(found.qd).all(axis=-1)
        q, qd = found.q[good], found.qd[good]
    return q, qd, scene.forward_dynamics(q, qd, np.random.default_rng(2).normal(size=qd.shape))


def mobility(scene: Scene) -> int:
    """Number of independent motions, the least of some configurations near the neutral one: a singular one has more."""
    draw = np.random.default_rng(0)
    start = np.broadcast_to(scene.neutral(), (8, scene.nq))
    q = on_connections(scene, scene.integrate(start, 0.3 * draw.uniform(-1, 1, (8, scene.nv))), np.zeros((8, scene.nv)))[0]
    return int(np.min(np.sum(allowed_motions(scene, q).any(axis=-2), axis=-1), initial=scene.nv))
