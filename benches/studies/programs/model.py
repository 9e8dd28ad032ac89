"""Joints and links of an extreme scene as values, from which the models of the peers are built."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phipsi import Scene

Array = NDArray[np.float64]
#: (q, qd, tau) to accelerations.
Solver = Callable[[Array, Array, Array], Array]

#: Largest scene for the peers, because Pinocchio's data contain several dense matrices of that order.
LARGEST = 300


class Refused(Exception):
    """The peer does not support the scene; the message gives the reason."""


class Inertial(NamedTuple):
    """Mass, kg, center of mass, m, and inertia about it (3, 3), kg m^2."""

    mass: float
    center: Array
    central: Array


class Part(NamedTuple):
    """A joint and its child link."""

    name: str
    kind: str
    parent: str
    child: str
    lever: Array
    axis: Array
    armature: float
    inertial: Inertial | None
    damping: float
    stiffness: float
    """Stiffness of a spring that is at rest at zero."""


@dataclass(frozen=True)
class Model:
    """A scene of revolute and prismatic joints whose frames are parallel at the zero configuration."""

    base: str
    floating: bool
    base_inertial: Inertial | None
    gravity: Array
    parts: Sequence[Part]
    """Parents first, in the order of the degrees of freedom."""

    def children(self, link: str) -> list[Part]:
        """Joints on that link, in their order."""
        return [part for part in self.parts if part.parent == link]


def read(scene: Scene) -> Model:
    """Values of a scene. Raises Refused if the scene is too large, or has another type of joint or a rotated frame."""
    if len(scene.joint_names) > LARGEST:
        raise Refused(f"not compared beyond {LARGEST} bodies")
    _, (description,) = scene.__reduce__()
    _, gravity, floating, _strict, links, joints, *_rest = description
    inertials: dict[str, Inertial | None] = {}
    for name, inertial in links:
        if inertial is None:
            inertials[name] = None
            continue
        mass, center, (xx, xy, xz, yy, yz, zz) = inertial
        central = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        inertials[name] = Inertial(mass, np.array(center), central)
    parts = []
    for name, kind, _pitch, parent, child, (rotation, lever), axis, (armature, damping, *_), _, _, (stiffness, _) in joints:
        if kind not in ("revolute", "prismatic") or not np.array_equal(np.reshape(rotation, (3, 3)), np.eye(3)):
            raise Refused(f"a {kind} joint, or a turned frame")
        direction = np.array(axis) / np.linalg.norm(axis)
        at = np.array(lever)
        parts.append(Part(name, kind, parent, child, at, direction, armature, inertials[child], damping, stiffness))
    names = {part.name: part for part in parts}
    ordered = [names[name] for name in scene.joint_names[1 if floating else 0 :]]
    base = next(part.parent for part in parts if part.parent not in {other.child for other in parts})
    return Model(base, floating, inertials[base], np.array(gravity), ordered)


def under_gravity(scene: Scene, gravity: tuple[float, float, float]) -> Scene:
    """The same scene with another gravity, m/s^2."""
    rebuild, (description,) = scene.__reduce__()
    version, _, *rest = description
    again: Scene = rebuild((version, gravity, *rest))
    return again


class World(NamedTuple):
    """State of a floating base in the world frame, the convention of some peers."""

    rotation: Array
    """Rotation matrix from the base frame to the world frame."""
    spin: Array
    """Angular velocity in the base frame, rad/s."""
    speed: Array
    """Linear velocity in the base frame, m/s."""

    @classmethod
    def of(cls, q: Array, qd: Array) -> World:
        """From q = (x, y, z, qx, qy, qz, qw, ...) and qd = (linear, angular, ...) in the base frame."""
        x, y, z, w = q[3:7]
        rotation = np.array(
            [
                [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
            ]
        ) / np.dot(q[3:7], q[3:7])  # fmt: skip
        return cls(rotation, qd[3:6].copy(), qd[:3].copy())

    def linear(self, along_world: Array) -> Array:
        """Derivative of the linear velocity in the base frame, from the acceleration of the origin in the world
        frame.
        """
        derivative: Array = self.rotation.T @ along_world - np.cross(self.spin, self.speed)
        return derivative
