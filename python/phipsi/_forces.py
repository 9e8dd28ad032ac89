"""Where the forces of contacts and connections act in a motion: what is drawn as arrows."""

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
    """Whose they are: "contact", "connection" or "given"."""
    at: _Array
    """Where they act, (k, n, 3), m."""
    force: _Array
    """What they are, (k, n, 3), N; NaN where it is not known."""
    names: tuple[str, ...] = ()
    """Of the contacts or connections."""


def given(at: ArrayLike, force: ArrayLike, rows: int) -> Forces:
    """Forces that somebody gives, (rows, n, 3) each."""
    found = [np.array(_core._numbers("forces", one)) for one in (at, force)]
    for one in found:
        if one.ndim != 3 or one.shape != (rows, one.shape[1], 3) or one.shape != found[0].shape:
            raise ShapeError(f"forces: found shapes {found[0].shape} and {found[1].shape}; expected ({rows}, n, 3) twice: where they act, and what they are")
    return Forces("given", found[0], found[1])


def of_motion(path: Trajectory, rows: NDArray[np.int_]) -> Forces | None:
    """Those of the contacts or the connections of a motion of one state, in these rows; None where there are none, or torques are not known.

    Moments of connections, forces along joints and the impulses of rebounds are no arrows, and are left out.
    """
    scene = path.scene
    if path.contacts is not None:
        force = np.stack([path.contacts.force[name][rows] for name in scene.contact_names], axis=1)
        return Forces("contact", _contact_points(scene, path.q[rows]), force, scene.contact_names)
    if not scene.connection_names:
        return None
    try:
        told = path.connection_forces()
    except ArgumentError:  # tau was a function, or a simulator went there
        return None
    found = _connections(scene, path.q[rows], {name: force[rows] for name, force in told.items()})
    if not found:
        return None
    at, force = (np.stack(parts, axis=1) for parts in zip(*found.values(), strict=True))
    return Forces("connection", at, force, tuple(found))


def _contact_points(scene: Scene, q: _Array) -> _Array:
    """The point of each contact's sphere that is nearest to its plane, (k, contacts, 3)."""
    placements, points = scene.placements(q), []
    for _, link, centre, radius, normal, *_ in scene._contacts():
        place = placements[link]
        out = np.asarray(normal) / np.linalg.norm(normal)
        points.append(place[:, :3, :3] @ np.asarray(centre) + place[:, :3, 3] - radius * out)
    return np.stack(points, axis=1)


def _connections(scene: Scene, q: _Array, told: dict[str, _Array]) -> dict[str, tuple[_Array, _Array]]:
    """Origins of the first frames, and forces on their links, (k, 3) each, of all connections that have any."""
    placements, found = scene.placements(q), {}

    def frame(link: str | None, shift: tuple[list[float], list[float]]) -> tuple[_Array, _Array]:
        """The axes, (k, 3, 3), and the origin, (k, 3), of a frame on a link, or on the world."""
        rotation, origin = np.reshape(shift[0], (3, 3)), np.asarray(shift[1])
        place = np.broadcast_to(np.eye(4), (len(q), 4, 4)) if link is None else placements[link]
        return place[:, :3, :3] @ rotation, place[:, :3, :3] @ origin + place[:, :3, 3]

    for name, kind, _, _, _, link, other, first, second in scene._connections():
        if kind in ("point", "axis", "weld"):
            axes, origin = frame(link, first)
            # Rows of moments come first.
            force = (axes @ told[name][:, -3:, None])[..., 0]
        elif kind in ("distance", "rod") and second is not None:
            (_, origin), (_, end) = frame(link, first), frame(other, second)
            along = origin - end
            force = told[name][:, :1] * along / np.linalg.norm(along, axis=1, keepdims=True)
        else:
            continue
        found[name] = (origin, force)
    return found
