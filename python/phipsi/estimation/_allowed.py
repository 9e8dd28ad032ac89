"""Motions that the connections of a scene allow.

The forces of connections are J* f. They do no work on these motions, so that torques are determined only as far as they
act on them: U* tau, with U orthonormal, and J U = 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["Tangent", "allowed_motions", "mobility", "on_connections", "tangent_of_connections"]

_Array = NDArray[np.float64]


def allowed_motions(scene: Scene, q: _Array, transmission: _Array | None = None) -> _Array:
    """Orthonormal joint velocities U that the connections allow at q, as columns, (..., nv, nv); the others are zero.

    With a transmission B, velocities of the motors. A M, with A the inverse mass matrix through the connections, is a
    projector on these motions: its singular values are zero, or one and more. The rank is that of the scene, which
    also knows the tolerance of its linkages.
    """
    projector = scene.loops.mass_matrix_inverse(q) @ scene.mass_matrix(q)
    if transmission is not None:
        projector = transmission @ projector @ np.linalg.inv(transmission)
    left, values, _ = np.linalg.svd(projector)
    return np.asarray(left * (values > 0.5)[..., None, :])


def on_connections(scene: Scene, q: _Array, qd: _Array) -> tuple[_Array, _Array, _Array]:
    """States on the connections near the given ones, and accelerations that they allow; those without one are omitted."""
    with np.errstate(invalid="ignore"):
        found = scene.loops.project(q, qd, errors="nan")
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


class Tangent(NamedTuple):
    """Tangent space of the connections at states (q in its tangent space, qd)."""

    projection: _Array
    """Derivative of Scene.loops.project, (..., 2 nv, 2 nv)."""
    basis: _Array
    """Errors that the connections allow, as columns, (..., 2 nv, 2 m) for m motions; columns can be zero."""
    coordinates: _Array
    """Coordinates of such an error in the basis, (..., 2 m, 2 nv)."""


def tangent_of_connections(scene: Scene, q: _Array, qd: _Array, inertias: _Array | None = None) -> Tangent:
    """Errors of states that connections allow; `inertias`: those of the states, None: of the scene.

    A projection with least kinetic energy moves q by P dq and qd by P dqd + K P dq, with P = A M and K = d(A M)/dq qd.
    A M qd is the acceleration at rest that the torque M qd + g causes, so that K is its derivative, plus A times that
    of the torque.
    """
    rest = np.zeros_like(qd)
    torque = scene.inverse_dynamics(q, rest, qd, inertias=inertias)
    of_torque = scene.inverse_dynamics_derivatives(q, rest, qd, inertias=inertias)
    of_motion = scene.forward_dynamics_derivatives(q, rest, torque, inertias=inertias)
    inverse = of_motion[2]
    projector, by_q = inverse @ of_torque[2], of_motion[0] + inverse @ of_torque[0]
    motions = allowed_motions(scene, q)
    motions = motions[..., : int(np.max(np.sum(motions.any(axis=-2), axis=-1), initial=0))]
    back, zero = np.swapaxes(motions, -1, -2), np.zeros_like(motions)
    turned = by_q @ motions
    return Tangent(
        np.block([[projector, np.zeros_like(projector)], [by_q @ projector, projector]]),
        np.block([[motions, zero], [turned, motions]]),
        np.block([[back, np.swapaxes(zero, -1, -2)], [-back @ turned @ back, back]]),
    )
