"""Inertial parameters of bodies, and their second moments of mass.

The ten parameters are (m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) about the link origin, in the link frame.

The parameters are physically consistent if the 4x4 matrix J of the second moments of mass, which is linear in them, is
positive definite.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ArgumentError, InertiaWarning, of_argument, warn
from ._most_probable import BASIS

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["bodies_of", "prior_of_bodies", "to_moments", "to_parameters"]

_Array = NDArray[np.float64]

#: Row and column in I of the last six parameters.
ENTRIES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
#: Lower bound of principal second moments relative to the largest one, and lower bound of the radius of gyration
#: relative to the size of the robot, for bodies that are not physically consistent.
SLENDER, SMALL = 1e-3, 1e-2


def prior_of_bodies(scene: Scene, free: Sequence[int]) -> tuple[list[_Array], _Array]:
    """Prior of the bodies at `free` in body_names.

    Return for each body the matrix (10, 10) from the entries of Z to its parameters, where J = L Z L^T and the model
    has J0 = L L^T; and the coordinates z of the model.
    """
    matrices: list[_Array] = []
    model: list[_Array] = []
    replaced = []
    own, size = scene.inertial_parameters, _size(scene)
    for at in free:
        body, moments = scene.body_names[at], to_moments(own[at])
        try:
            root = np.linalg.cholesky(moments)
        except np.linalg.LinAlgError:
            root = np.linalg.cholesky(_nearest(body, moments, size))
            replaced.append(body)
        matrices.append(np.array([to_parameters(root @ unit @ root.T) for unit in BASIS]).T)
        model.append(np.linalg.solve(matrices[-1], own[at]))
    if replaced:
        found = f"found inertias of {', '.join(map(repr, replaced))} that no body can have"
        text = (
            f"scene: {found}; identification starts from the nearest possible ones (keep=[...] leaves a body as it is)"
        )
        warn(text, InertiaWarning)
    return matrices, np.concatenate([*model, np.zeros(0)])


def bodies_of(scene: Scene) -> dict[str, str | None]:
    """Map each link to the link of body_names that it is or is fixed to; None for links fixed to the base."""
    moving, found = set(scene.body_names), dict[str, str | None]()
    links = scene.links
    for name in scene.link_names:
        parent = links[name].parent
        found[name] = name if name in moving else None if parent is None else found[parent]
    return found


def to_parameters(moments: _Array) -> _Array:
    """Parameters (m, h, I), (..., 10), from the second moments of mass J, (..., 4, 4)."""
    found = np.empty((*moments.shape[:-2], 10))
    found[..., 0], found[..., 1:4] = moments[..., 3, 3], moments[..., :3, 3]
    trace = np.trace(moments[..., :3, :3], axis1=-2, axis2=-1)
    for at, (i, j) in enumerate(ENTRIES, 4):
        found[..., at] = (trace if i == j else 0.0) - moments[..., i, j]
    return found


def to_moments(parameters: _Array) -> _Array:
    """Second moments of mass J, (..., 4, 4), from the parameters (m, h, I), (..., 10)."""
    found = np.empty((*parameters.shape[:-1], 4, 4))
    half_trace = 0.5 * (parameters[..., 4] + parameters[..., 6] + parameters[..., 9])
    for at, (i, j) in enumerate(ENTRIES, 4):
        found[..., i, j] = found[..., j, i] = (half_trace if i == j else 0.0) - parameters[..., at]
    found[..., :3, 3] = found[..., 3, :3] = parameters[..., 1:4]
    found[..., 3, 3] = parameters[..., 0]
    return found


def _nearest(body: str, moments: _Array, size: float) -> _Array:
    """Physically consistent second moments of mass near given ones.

    Principal second moments about the center of mass are raised to a share of the largest one.
    """
    mass = moments[3, 3]
    if mass <= 0.0:
        found = f"no mass of the body {body!r}"
        raise of_argument(
            ArgumentError,
            "scene",
            f"found {found}; expected an initial model (Scene.with_inertias), or its name in keep",
        )
    com = moments[:3, 3] / mass
    values, axes = np.linalg.eigh(moments[:3, :3] - mass * np.outer(com, com))
    values = np.maximum(values, max(SLENDER * float(values.max()), mass * (SMALL * size) ** 2))
    nearest = moments.copy()
    nearest[:3, :3] = (axes * values) @ axes.T + mass * np.outer(com, com)
    return nearest


def _size(scene: Scene) -> float:
    """Largest extent of the link origins at the neutral configuration, m; 1 if it is zero."""
    points = [place[:3, 3] for place in scene.placements(scene.neutral()).values()]
    return float(np.ptp(points, axis=0).max()) or 1.0
