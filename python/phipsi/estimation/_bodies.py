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

__all__ = ["bodies_of", "own_parameters", "prior_of_bodies", "to_moments", "to_parameters", "with_parameters"]

_Array = NDArray[np.float64]

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
    own, size = own_parameters(scene), _size(scene)
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


def own_parameters(scene: Scene) -> _Array:
    """Ten parameters of each link of body_names and the links fixed to it, (bodies, 10), in the link frame."""
    places, of = scene.placements(scene.neutral()), bodies_of(scene)
    moments = {name: np.zeros((4, 4)) for name in scene.body_names}
    for link in scene.links.values():
        body = of[link.name]
        if body is None or link.mass == 0.0 and not np.any(link.inertia):
            continue
        place = np.linalg.solve(places[body], places[link.name])
        sigma = 0.5 * np.trace(link.inertia) * np.eye(3) - link.inertia
        local = np.zeros((4, 4))
        local[:3, :3] = sigma + link.mass * np.outer(link.com, link.com)
        local[:3, 3] = local[3, :3] = link.mass * link.com
        local[3, 3] = link.mass
        moments[body] += place @ local @ place.T
    return np.array([to_parameters(moments[name]) for name in scene.body_names]).reshape(-1, 10)


def bodies_of(scene: Scene) -> dict[str, str | None]:
    """Map each link to the link of body_names that it is or is fixed to; None for links fixed to the base."""
    moving, found = set(scene.body_names), dict[str, str | None]()
    links = scene.links
    for name in scene.link_names:
        parent = links[name].parent
        found[name] = name if name in moving else None if parent is None else found[parent]
    return found


def to_parameters(moments: _Array) -> _Array:
    """Parameters (m, h, I) from the second moments of mass J."""
    sigma, (hx, hy, hz) = moments[:3, :3], moments[:3, 3]
    inertia = np.trace(sigma) * np.eye(3) - sigma
    return np.array(
        [moments[3, 3], hx, hy, hz, *(inertia[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))]
    )


def to_moments(parameters: _Array) -> _Array:
    """Second moments of mass J from the parameters (m, h, I)."""
    m, hx, hy, hz, xx, xy, yy, xz, yz, zz = parameters
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    found = np.empty((4, 4))
    found[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    found[:3, 3] = found[3, :3] = hx, hy, hz
    found[3, 3] = m
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


def with_parameters(scene: Scene, free: Sequence[int], parameters: _Array) -> Scene:
    """Scene with new parameters of the bodies at `free`, including the links fixed to them."""
    names, of = scene.body_names, bodies_of(scene)
    found = {names[at] for at in free}
    links: dict[str, tuple[float, ArrayLike, ArrayLike | None]] = {
        link: (0.0, np.zeros(3), None) for link, body in of.items() if body in found and link not in found
    }
    for at in free:
        moments = to_moments(parameters[at])
        mass, com = moments[3, 3], moments[:3, 3] / moments[3, 3]
        sigma = moments[:3, :3] - mass * np.outer(com, com)
        links[names[at]] = (float(mass), com, np.trace(sigma) * np.eye(3) - sigma)
    return scene.with_inertias(links)
