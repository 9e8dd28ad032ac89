"""Points of application of contact and connection forces along a trajectory, for force arrows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from ._core import Scene
from ._motion import Trajectory
from ._motion_parts import ShapeContacts
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
    """Names of the contacts or connections, (n,); empty for points of shapes, which differ from row to row."""


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
        if scene.contacts.names:
            force = np.stack([path.contacts.force[name][rows] for name in scene.contacts.names], axis=1)
        there, push = _of_shapes(scene, path.contacts.shapes, rows)
        names = (*scene.contacts.names, *[""] * there.shape[1])
        return Forces("contact", np.concatenate([at, there], axis=1), np.concatenate([force, push], axis=1), names)
    if not scene.loops.names:
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


def of_pairs(path: Trajectory) -> dict[tuple[str, str], _Array]:
    """Forces of the pairs of colliders that touch in recorded rows of a single-state trajectory, on the first collider,
    (rows, 3), N, by the names of the colliders; the largest force first.
    """
    if path.contacts is None:
        return {}
    shapes, found = path.contacts.shapes, dict[tuple[str, str], _Array]()
    for pair in shapes.pairs():
        which = are_of(shapes, pair)
        found[pair] = np.zeros((len(path), 3))
        np.add.at(found[pair], shapes.row[which], shapes.force[which])
    return dict(sorted(found.items(), key=lambda one: -float(np.linalg.norm(one[1], axis=1).max())))


def are_of(shapes: ShapeContacts, pair: tuple[str, str]) -> NDArray[np.bool_]:
    """Whether each contact is one of these colliders, (k,)."""
    are: NDArray[np.bool_] = np.all(shapes.pair == [shapes.names.index(name) for name in pair], axis=1)
    return are


def _of_shapes(scene: Scene, shapes: ShapeContacts, rows: NDArray[np.int_]) -> tuple[_Array, _Array]:
    """Points at which shapes touch and the forces there, (k, n, 3) each; zero where a row has fewer points.

    The force is that on the first collider, or on the second if the base carries the first.
    """
    begin, end = (np.searchsorted(shapes.row, rows, side) for side in ("left", "right"))
    at, force = (np.zeros((len(rows), int(np.max(end - begin, initial=0)), 3)) for _ in range(2))
    joints = {joint.child: joint for joint in scene.joints.values()}

    def moves(link: str | None) -> bool:
        while link in joints:
            if joints[link].type != "fixed":
                return True
            link = joints[link].parent
        return False

    sign = np.array([1.0 if moves(link) else -1.0 for _, link, *_ in scene._collisions()[0]])
    push = sign[shapes.pair[:, 0], None] * shapes.force
    for k, (first, last) in enumerate(zip(begin, end, strict=True)):
        at[k, : last - first], force[k, : last - first] = shapes.point[first:last], push[first:last]
    return at, force


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
