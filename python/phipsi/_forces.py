"""Points of application of contact and connection forces along a trajectory, for force arrows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from ._core import Scene
from ._motion import Trajectory
from .errors import ArgumentError, ShapeError

_Array = NDArray[np.float64]


class Forces(NamedTuple):
    """Forces on links, in the base frame."""

    what: str
    """Source of the forces: "contact", "connection" or "given"."""
    at: _Array
    """Points of application, (k, n, 3), m."""
    force: _Array
    """Forces, (k, n, 3), N; NaN where a force is unknown."""
    names: tuple[str, ...] = ()
    """Names of the contacts or connections."""


def given(at: ArrayLike, force: ArrayLike, rows: int) -> Forces:
    """Forces of an argument, (rows, n, 3) each."""
    found = [np.array(_core._numbers("forces", one)) for one in (at, force)]
    for one in found:
        if one.ndim != 3 or one.shape != (rows, one.shape[1], 3) or one.shape != found[0].shape:
            raise ShapeError(f"forces: found shapes {found[0].shape} and {found[1].shape}; expected ({rows}, n, 3) for the points and for the forces")
    return Forces("given", found[0], found[1])


def of_motion(path: Trajectory, rows: NDArray[np.int_]) -> Forces | None:
    """Forces of the contacts or connections of a single-state trajectory in the given rows; None if there are none, or
    if the torques are unknown.

    Moments of connections, forces along joints and impulses of rebounds are omitted: arrows cannot show them.
    """
    scene = path.scene
    if path.contacts is not None:
        at, force = scene._contact_points(path.q[rows]), np.zeros((len(rows), 0, 3))
        if scene.contact_names:
            force = np.stack([path.contacts.force[name][rows] for name in scene.contact_names], axis=1)
        shapes = path.contacts.shapes
        per_row = [np.flatnonzero(shapes.row == row) for row in rows]
        most = max((len(which) for which in per_row), default=0)
        there, push = np.zeros((len(rows), most, 3)), np.zeros((len(rows), most, 3))
        for k, which in enumerate(per_row):
            there[k, : len(which)], push[k, : len(which)] = shapes.point[which], shapes.force[which]
        return Forces("contact", np.concatenate([at, there], axis=1), np.concatenate([force, push], axis=1), scene.contact_names)
    if not scene.constraint_names:
        return None
    try:
        by_name = path.constraint_forces()
    except ArgumentError:  # tau was a function, or the trajectory is that of a Simulator
        return None
    found = _connections(scene, path.q[rows], {name: force[rows] for name, force in by_name.items()})
    if not found:
        return None
    at, force = (np.stack(parts, axis=1) for parts in zip(*found.values(), strict=True))
    return Forces("connection", at, force, tuple(found))


def _connections(scene: Scene, q: _Array, forces: dict[str, _Array]) -> dict[str, tuple[_Array, _Array]]:
    """Origins of the first frames of the connections and the forces on their links, (k, 3) each; connections without a
    force vector are omitted.
    """
    placements, found = scene.placements(q), {}

    def frame(link: str | None, shift: tuple[list[float], list[float]]) -> tuple[_Array, _Array]:
        """Axes, (k, 3, 3), and origin, (k, 3), of a frame on a link or on the base."""
        rotation, origin = np.reshape(shift[0], (3, 3)), np.asarray(shift[1])
        place = np.broadcast_to(np.eye(4), (len(q), 4, 4)) if link is None else placements[link]
        return place[:, :3, :3] @ rotation, place[:, :3, :3] @ origin + place[:, :3, 3]

    for name, kind, _, _, _, link, other, first, second in scene._connections():
        if kind in ("point", "axis", "weld"):
            axes, origin = frame(link, first)
            # Rows of moments come first.
            force = (axes @ forces[name][:, -3:, None])[..., 0]
        elif kind in ("distance", "rod") and second is not None:
            (_, origin), (_, end) = frame(link, first), frame(other, second)
            along = origin - end
            force = forces[name][:, :1] * along / np.linalg.norm(along, axis=1, keepdims=True)
        else:
            continue
        found[name] = (origin, force)
    return found
