"""Models of MuJoCo: as scenes, and states and forces from its conventions to phipsi's and back. Needs phipsi[mujoco].

>>> import mujoco, phipsi.mujoco                                        # doctest: +SKIP
>>> scene = phipsi.Scene.from_mujoco("humanoid.xml")                    # doctest: +SKIP
>>> q, qd = phipsi.mujoco.to_state(scene, data.qpos, data.qvel)         # doctest: +SKIP

The order of joints is the same. What differs: MuJoCo writes quaternions (w, x, y, z) and the linear velocity of a free joint in axes of the world,
phipsi (x, y, z, w) and in axes of the body. Scenes without ball and free joints need no conversion.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arguments import leading, vectors
from ._core import Scene, SceneBuilder
from ._mjcf import BALL, EQUALITY_JOINT, EQUALITY_WELD, FREE, HINGE, SLIDE, WIDTHS, Names
from ._mjcf import compiled, connected, equalities, field, has_constraints, is_disabled, joint_actuators, stops, ties_bodies
from ._mujoco_gaps import check
from .errors import SceneError

if TYPE_CHECKING:
    import os

    import mujoco

__all__ = ["from_accelerations", "from_forces", "from_state", "to_accelerations", "to_forces", "to_state"]

_Array = NDArray[np.float64]

#: Types of joints: MuJoCo's, and phipsi's.
KINDS = {FREE: "floating", BALL: "spherical", SLIDE: "prismatic", HINGE: "revolute"}


# A model as a scene


def read(
    source: mujoco.MjModel | mujoco.MjSpec | str | os.PathLike[str],
    gravity: ArrayLike | None,
    strict: bool,
    leave_out: Collection[Any] | None,
    ignore: Collection[str],
) -> Scene:
    """As Scene.from_mujoco, which calls it."""
    model, file = compiled(source, strict)
    names = Names(model)
    check(model, names, ignore, strict)
    builder = _Reader(model, names, ignore).builder()
    if file is not None:
        builder._set_file(file)
    if gravity is None:
        gravity = np.zeros(3) if is_disabled(model, "GRAVITY") else model.opt.gravity
    return builder.build(gravity=gravity, strict=strict, leave_out=leave_out)


class _Frame(NamedTuple):
    """A place: what it makes of axes, and where its origin is, m."""

    rotation: _Array
    origin: _Array

    def then(self, rotation: _Array, origin: _Array) -> _Frame:
        """A place that is given in this one."""
        return _Frame(self.rotation @ rotation, self.origin + self.rotation @ origin)


class _Reader:
    """Adds the elements of a model to a builder, each in constant time."""

    def __init__(self, model: mujoco.MjModel, names: Names, ignore: Collection[str]) -> None:
        self.model, self.names, self.ignore = model, names, ignore
        self.scene = SceneBuilder().link(names.bodies[0])
        self.sites: list[list[int]] = [[] for _ in range(model.nbody)]
        for site, body in enumerate(model.site_bodyid.tolist()):
            self.sites[body].append(site)
        self.actuators: dict[int, list[tuple[int, float]]] = {}
        for at, joint, gear in joint_actuators(model):
            self.actuators.setdefault(joint, []).append((at, gear))
        self.low, self.high = stops(model)
        # A MimicWarning is not due for joints that a connection ties.
        self.mimics = self._mimics() if "equality" in ignore else {}

    def builder(self) -> SceneBuilder:
        """The builder, with all elements."""
        self._add_sites(0)
        for body in range(1, self.model.nbody):
            self._add_body(body)
            self._add_sites(body)
        for at in [] if "equality" in self.ignore else equalities(self.model):
            self._add_connection(at)
        return self.scene

    def _add_body(self, body: int) -> None:
        """A body and its joints. The first joint is the outermost from the body: MuJoCo moves the body by each, in axes that the ones before have turned.

        A joint's axis goes through the origin of the link that it moves. So a joint whose anchor is not the body's origin moves a link of its own, to
        which the body is fixed; so does each joint of a body but its last.
        """
        model, names = self.model, self.names
        name, parent = names.bodies[body], names.bodies[model.body_parentid[body]]
        place = _Frame(rotation(model.body_quat[body]), model.body_pos[body])
        first, count = model.body_jntadr[body], model.body_jntnum[body]
        own = _moves_body(model, first + count - 1) if count else False
        for joint in range(first, first + count):
            kind, anchor, axis = model.jnt_type[joint], model.jnt_pos[joint], model.jnt_axis[joint]
            zero = model.qpos0[model.jnt_qposadr[joint]]
            if kind == FREE:
                place = _Frame(np.eye(3), np.zeros(3))
            elif kind == SLIDE:
                place = place.then(np.eye(3), -zero * axis)
            else:
                place = place.then(_turn(axis, -zero) if kind == HINGE else np.eye(3), anchor)
            of_body = own and joint == first + count - 1
            child = name if of_body else names.link(f"{name}/{names.joints[joint]}")
            if not of_body:
                self.scene.link(child)
            where = {"xyz": place.origin, "rotation": place.rotation, "axis": axis}
            self.scene.joint(names.joints[joint], self._kind(joint), parent, child, **where, **self._numbers(joint), **self.mimics.get(joint, {}))
            parent, place = child, _Frame(np.eye(3), -anchor if kind in (HINGE, BALL) else np.zeros(3))
        inertia = rotation(model.body_iquat[body])
        moments = inertia @ np.diag(model.body_inertia[body]) @ inertia.T
        self.scene.link(name, mass=float(model.body_mass[body]), com=model.body_ipos[body], inertia=0.5 * (moments + moments.T))
        if not own:
            self.scene.joint(names.joint(f"{name}/fixed"), "fixed", parent, name, xyz=place.origin, rotation=place.rotation)

    def _add_sites(self, body: int) -> None:
        """The sites of a body that have names, as links without mass."""
        model, names = self.model, self.names
        for site in self.sites[body]:
            if name := names.sites[site]:
                where = {"xyz": model.site_pos[site], "rotation": rotation(model.site_quat[site])}
                self.scene.link(name).joint(names.joint(f"{name}/fixed"), "fixed", names.bodies[body], name, **where)

    def _is_limited(self, joint: int) -> bool:
        is_possible = self.low[joint] <= self.high[joint] or "limits" not in self.ignore
        return bool(self.model.jnt_limited[joint]) and is_possible and has_constraints(self.model, "LIMIT")

    def _kind(self, joint: int) -> Any:
        kind = KINDS[int(self.model.jnt_type[joint])]
        return "continuous" if kind == "revolute" and not self._is_limited(joint) else kind

    def _numbers(self, joint: int) -> dict[str, Any]:
        """Armature, losses, spring and limits of a joint, as SceneBuilder.joint takes them."""
        model = self.model
        kind, dof, at = model.jnt_type[joint], model.jnt_dofadr[joint], model.jnt_qposadr[joint]
        dofs = slice(dof, dof + WIDTHS[int(kind)])
        found: dict[str, Any] = {}
        for ours, theirs in (("armature", "dof_armature"), ("damping", "dof_damping"), ("friction", "dof_frictionloss")):
            values = getattr(model, theirs)[dofs]
            if kind == FREE and ours in self.ignore:
                continue
            if np.any(values != values[0]):
                of = self.names.joints[joint]
                raise SceneError(f"source: found {theirs} {values.tolist()} at the joint {of!r}; expected one number for all its axes")
            found[ours] = float(values[0])
        for ours in ("armature", "damping"):
            if (values := field(model, f"actuator_{ours}")) is not None:
                found[ours] = found.get(ours, 0.0) + sum(float(values[actuator]) * gear**2 for actuator, gear in self.actuators.get(joint, []))
        if is_disabled(model, "DAMPER"):
            found["damping"] = 0.0
        if not has_constraints(model, "FRICTIONLOSS"):
            found["friction"] = 0.0
        if kind != FREE and model.jnt_stiffness[joint] and not is_disabled(model, "SPRING"):
            rest = model.qpos_spring[at : at + (4 if kind == BALL else 1)]
            found |= {"stiffness": float(model.jnt_stiffness[joint]), "rest": np.roll(rest, -1) if kind == BALL else rest}
        if kind in (HINGE, SLIDE):
            if self._is_limited(joint):
                found |= {"lower": float(self.low[joint]), "upper": float(self.high[joint])}
            if (effort := self._effort(joint)) is not None:
                found["effort"] = effort
        return found

    def _effort(self, joint: int) -> float | None:
        """The largest force that actuators can give a joint, N m or N; None where nothing bounds it."""
        model = self.model
        if model.jnt_actfrclimited[joint]:
            return float(np.abs(model.jnt_actfrcrange[joint]).max())
        acting = self.actuators.get(joint, [])
        if not acting or not all(model.actuator_forcelimited[at] for at, _ in acting):
            return None
        return float(sum(np.abs(model.actuator_forcerange[at]).max() * abs(gear) for at, gear in acting))

    def _add_connection(self, at: int) -> None:
        """An equality constraint as a rigid connection: solref and solimp are not read."""
        model, names = self.model, self.names
        kind, data, name = model.eq_type[at], model.eq_data[at], names.equalities[at]
        ends = int(model.eq_obj1id[at]), int(model.eq_obj2id[at])
        if kind == EQUALITY_JOINT:
            offset, slope = self._line(at)
            other = names.joints[ends[1]] if ends[1] >= 0 else None
            self.scene.couple(name, names.joints[ends[0]], other, multiplier=slope, offset=offset)
            return
        bodies = connected(model, at)
        if ties_bodies(model, at):
            first, second = _Frame(np.eye(3), data[0:3]), _Frame(np.eye(3), data[3:6])
            if kind == EQUALITY_WELD:
                first, second = _Frame(rotation(data[6:10]), data[3:6]), _Frame(np.eye(3), data[0:3])
        else:
            first, second = (_Frame(rotation(model.site_quat[site]), model.site_pos[site]) for site in ends)
        # A weld without a scale of torques resists none.
        is_weld = kind == EQUALITY_WELD and data[10] != 0.0
        self.scene.connect(
            name,
            "weld" if is_weld else "point",
            names.bodies[bodies[0]],
            names.bodies[bodies[1]],
            xyz=first.origin,
            rotation=first.rotation,
            other_xyz=second.origin,
            other_rotation=second.rotation,
        )

    def _line(self, at: int) -> tuple[float, float]:
        """Offset and slope of a linear equality of joints, in their coordinates: MuJoCo has it between distances from qpos0."""
        model = self.model
        follower, leader = int(model.eq_obj1id[at]), int(model.eq_obj2id[at])
        offset, slope = (float(x) for x in model.eq_data[at][:2])
        zero = float(model.qpos0[model.jnt_qposadr[follower]])
        of = float(model.qpos0[model.jnt_qposadr[leader]]) if leader >= 0 else 0.0
        return zero + offset - slope * of, slope

    def _mimics(self) -> dict[int, dict[str, Any]]:
        """Joints that follow another linearly by an ignored equality constraint, as SceneBuilder.joint takes it."""
        model = self.model
        found: dict[int, dict[str, Any]] = {}
        for at in equalities(model):
            leader = int(model.eq_obj2id[at])
            if model.eq_type[at] == EQUALITY_JOINT and leader >= 0 and not np.any(model.eq_data[at][2:5]):
                offset, slope = self._line(at)
                follower = int(model.eq_obj1id[at])
                found[follower] = {"mimic": self.names.joints[leader], "mimic_multiplier": slope, "mimic_offset": offset}
        return found


def _moves_body(model: mujoco.MjModel, joint: int) -> bool:
    """Whether the axis of a body's last joint goes through the body's origin."""
    return bool(model.jnt_type[joint] in (FREE, SLIDE) or not np.any(model.jnt_pos[joint]))


def rotation(quaternion: ArrayLike) -> _Array:
    """The matrix of a unit quaternion (w, x, y, z)."""
    w, x, y, z = np.asarray(quaternion, float) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _turn(axis: _Array, angle: float) -> _Array:
    """The matrix of a turn about a unit axis by an angle, rad."""
    return rotation(np.concatenate([[np.cos(0.5 * angle)], np.sin(0.5 * angle) * axis]))


# Conventions


def to_state(scene: Scene, qpos: ArrayLike, qvel: ArrayLike | None = None) -> tuple[_Array, _Array]:
    """Configuration q, (..., nq), and rates qd, (..., nv), of MuJoCo's qpos and qvel.

    qvel: None for zeros.

    Raises ShapeError where the last axes are not nq and nv, or the others do not broadcast.
    """
    qpos = vectors("qpos", qpos, scene.nq)
    qvel = np.zeros(scene.nv) if qvel is None else vectors("qvel", qvel, scene.nv)
    q = _reordered(scene, qpos, -1)
    return q, _turned(scene, q, qvel, inward=True)


def from_state(scene: Scene, q: ArrayLike, qd: ArrayLike | None = None) -> tuple[_Array, _Array]:
    """MuJoCo's qpos, (..., nq), and qvel, (..., nv), of a configuration and rates.

    qd: None for zeros.

    Raises ShapeError as to_state does.
    """
    q = vectors("q", q, scene.nq)
    qd = np.zeros(scene.nv) if qd is None else vectors("qd", qd, scene.nv)
    return _reordered(scene, q, 1), _turned(scene, q, qd, inward=False)


def to_forces(scene: Scene, q: ArrayLike, qfrc: ArrayLike) -> _Array:
    """Joint torques tau, (..., nv), N m or N, of MuJoCo's generalised forces (qfrc_applied, qfrc_bias, ...).

    q: phipsi's configuration, (..., nq), of to_state.

    Raises ShapeError as to_state does.
    """
    return _turned(scene, vectors("q", q, scene.nq), vectors("qfrc", qfrc, scene.nv), inward=True)


def from_forces(scene: Scene, q: ArrayLike, tau: ArrayLike) -> _Array:
    """MuJoCo's generalised forces, (..., nv), of joint torques; q and errors as in to_forces."""
    return _turned(scene, vectors("q", q, scene.nq), vectors("tau", tau, scene.nv), inward=False)


def to_accelerations(scene: Scene, q: ArrayLike, qd: ArrayLike, qacc: ArrayLike) -> _Array:
    """Joint accelerations qdd, (..., nv), rad/s^2 or m/s^2, of MuJoCo's qacc.

    q, qd: phipsi's, of to_state: a free joint's linear velocity is seen from the body, so that its rate lacks w x v.

    Raises ShapeError as to_state does.
    """
    q, qd, qacc = (vectors(name, value, size) for name, value, size in (("q", q, scene.nq), ("qd", qd, scene.nv), ("qacc", qacc, scene.nv)))
    return _turned(scene, q, qacc, inward=True) - _spin(scene, qd)


def from_accelerations(scene: Scene, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> _Array:
    """MuJoCo's qacc, (..., nv), of joint accelerations; q, qd and errors as in to_accelerations."""
    q, qd, qdd = (vectors(name, value, size) for name, value, size in (("q", q, scene.nq), ("qd", qd, scene.nv), ("qdd", qdd, scene.nv)))
    return _turned(scene, q, qdd + _spin(scene, qd), inward=False)


def _wide(scene: Scene, at: Callable[[str], slice], width: int) -> Iterator[slice]:
    """Joints of so many numbers: 4 coordinates are a ball joint's, 7 a free joint's, and 6 degrees of freedom too."""
    return (part for part in map(at, scene.joint_names) if part.stop - part.start == width)


def _reordered(scene: Scene, q: _Array, by: int) -> _Array:
    """Quaternions turned in their order: by -1 from (w, x, y, z), by 1 to it."""
    found = np.array(q)
    for at in _wide(scene, scene.q_index, 4):
        found[..., at] = np.roll(found[..., at], by, axis=-1)
    for at in _wide(scene, scene.q_index, 7):
        part = slice(at.start + 3, at.stop)
        found[..., part] = np.roll(found[..., part], by, axis=-1)
    return found


def _turned(scene: Scene, q: _Array, v: _Array, *, inward: bool) -> _Array:
    """The linear part of free joints from axes of the world to those of the body (inward), or back."""
    found = np.array(np.broadcast_to(v, (*leading(q, v), v.shape[-1])))
    places = zip(_wide(scene, scene.q_index, 7), _wide(scene, scene.v_index, 6), strict=True)
    for at, rows in places:
        quaternion = q[..., at.start + 3 : at.stop]
        quaternion = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
        axis, w = quaternion[..., :3], quaternion[..., 3:]
        part = slice(rows.start, rows.start + 3)
        linear = found[..., part]
        # Of the quaternion u: v + 2 w u x v + 2 u x (u x v), with the sign of w for the way.
        across = np.cross(axis, linear)
        found[..., part] = linear + 2.0 * ((-w if inward else w) * across + np.cross(axis, across))
    return found


def _spin(scene: Scene, qd: _Array) -> _Array:
    """w x v of free joints, zero elsewhere."""
    found = np.zeros_like(qd)
    for at in _wide(scene, scene.v_index, 6):
        found[..., at.start : at.start + 3] = np.cross(qd[..., at.start + 3 : at.stop], qd[..., at.start : at.start + 3])
    return found
