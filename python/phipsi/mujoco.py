"""Read MuJoCo models, and convert states and forces between the conventions of MuJoCo and phipsi. Needs phipsi[mujoco].

>>> import mujoco, phipsi.mujoco                                        # doctest: +SKIP
>>> scene = phipsi.Scene.from_mujoco("humanoid.xml")                    # doctest: +SKIP
>>> q, qd = phipsi.mujoco.to_state(scene, data.qpos, data.qvel)         # doctest: +SKIP

The order of the joints is the same. MuJoCo stores quaternions as (w, x, y, z) and expresses the linear velocity
of a free joint in the world frame; phipsi stores (x, y, z, w) and uses the body frame. Scenes without ball
joints and free joints need no conversion.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Collection, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arguments import leading, vectors
from ._colliders import check_contacts
from ._core import Scene, SceneBuilder
from ._mjcf import BALL, EQUALITY_JOINT, EQUALITY_WELD, FREE, HINGE, SLIDE, WIDTHS, Names
from ._mjcf import along_world, compiled, connected, equalities, field, has_constraints, is_disabled, joint_actuators, joint_name, link_name, stops, ties_bodies
from ._mjcf_actuators import actuator_tuples
from ._mjcf_contacts import Collisions
from ._mjcf_geoms import of_model, to_text
from ._mujoco_gaps import check
from .errors import SceneError

if TYPE_CHECKING:
    import os

    import mujoco

__all__ = ["from_accelerations", "from_forces", "from_state", "joint_name", "link_name", "to_accelerations", "to_forces", "to_state"]


def __dir__() -> list[str]:
    return __all__


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
    contacts: str | None = None,
) -> Scene:
    """Implementation of Scene.from_mujoco."""
    check_contacts(contacts)
    model, file = compiled(source, strict)
    names = Names(model)
    collisions = Collisions(model, contacts)
    check(model, names, ignore, strict, collisions)
    builder = _Reader(model, names, ignore).builder()
    if contacts is not None:
        collisions.add(builder, names)
    builder._set_actuators(actuator_tuples(model, names))
    if file is not None:
        builder._set_file(file)
    elif (geoms := of_model(model)).shapes:
        builder._add_shapes(to_text(geoms))
    if gravity is None:
        gravity = np.zeros(3) if is_disabled(model, "GRAVITY") else model.opt.gravity
    import mujoco

    scene = builder.build(gravity=gravity, strict=strict, leave_out=leave_out)
    starts = [(None, model.qpos0, None), *zip(names.keyframes, model.key_qpos, model.key_qvel, strict=True)]
    if len(starts) == 1 and np.array_equal(to_state(scene, model.qpos0)[0], scene.neutral()):
        return scene
    for keyframe, given, qvel in starts:
        # As in MuJoCo's kinematics, where quaternions have any length.
        mujoco.mj_normalizeQuat(model, qpos := given.copy())
        q, qd = to_state(scene, qpos, qvel)
        of_q, of_qd = ({joint: x[at(joint)] for joint in scene.joint_names} for x, at in ((q, scene.q_index), (qd, scene.v_index)))
        builder.start(of_q, of_qd, keyframe=keyframe)
    with warnings.catch_warnings():
        # The first scene, which converts the states, has given these warnings.
        warnings.simplefilter("ignore")
        return builder.build(gravity=gravity, strict=strict, leave_out=leave_out)


class _Frame(NamedTuple):
    """A frame: its rotation matrix and its origin, m."""

    rotation: _Array
    origin: _Array

    def then(self, rotation: _Array, origin: _Array) -> _Frame:
        """A frame that is given relative to this one."""
        return _Frame(self.rotation @ rotation, self.origin + self.rotation @ origin)


class _Part(NamedTuple):
    """A joint of a scene that represents a joint of MuJoCo, or a part of it."""

    suffix: str
    """Text after the name of MuJoCo's joint; empty for the outermost part."""
    kind: int
    """Type of the part, as MuJoCo numbers joints."""
    dof: int
    """Its first degree of freedom in qvel."""
    at: int
    """Its first coordinate in qpos."""
    axis: _Array | None = None
    """Axis; None: that of MuJoCo's joint."""


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
        # No MimicWarning for joints that a connection couples.
        self.mimics = self._mimics() if "equality" in ignore else {}

    def builder(self) -> SceneBuilder:
        """The builder with all elements."""
        self._add_sites(0)
        for body in range(1, self.model.nbody):
            self._add_body(body)
            self._add_sites(body)
        for at in [] if "equality" in self.ignore else equalities(self.model):
            self._add_connection(at)
        return self.scene

    def _add_body(self, body: int) -> None:
        """Add a body and its joints, from the parent outward: MuJoCo expresses each joint in the frame that the
        previous ones have moved.

        The axis of a joint of phipsi passes through the origin of its child link. Therefore each joint whose
        anchor differs from the origin of the body, and each joint of a body except the last, gets an additional
        link.
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
            last = own and joint == first + count - 1
            for part in self._parts(joint):
                child = name if last and not part.suffix else names.link(f"{name}/{names.joints[joint]}{part.suffix}")
                if child != name:
                    self.scene.link(child)
                called = names.joint(names.joints[joint] + part.suffix) if part.suffix else names.joints[joint]
                where: dict[str, Any] = {"xyz": place.origin, "rotation": place.rotation, "axis": axis if part.axis is None else part.axis}
                self.scene.joint(called, self._kind(joint, part), parent, child, **where, **self._numbers(joint, part), **self.mimics.get(joint, {}))
                parent, place = child, _Frame(np.eye(3), -anchor if kind in (HINGE, BALL) else np.zeros(3))
        inertia = rotation(model.body_iquat[body])
        moments = inertia @ np.diag(model.body_inertia[body]) @ inertia.T
        self.scene.link(name, mass=float(model.body_mass[body]), com=model.body_ipos[body], inertia=0.5 * (moments + moments.T))
        if not own:
            self.scene.joint(names.joint(f"{name}/fixed"), "fixed", parent, name, xyz=place.origin, rotation=place.rotation)

    def _add_sites(self, body: int) -> None:
        """Add the named sites of a body as massless links."""
        model, names = self.model, self.names
        for site in self.sites[body]:
            if name := names.sites[site]:
                where = {"xyz": model.site_pos[site], "rotation": rotation(model.site_quat[site])}
                self.scene.link(name).joint(names.joint(f"{name}/fixed"), "fixed", names.bodies[body], name, **where)

    def _is_limited(self, joint: int) -> bool:
        is_possible = self.low[joint] <= self.high[joint] or "limits" not in self.ignore
        return bool(self.model.jnt_limited[joint]) and is_possible and has_constraints(self.model, "LIMIT")

    def _parts(self, joint: int) -> list[_Part]:
        """The joints of the scene that represent a joint: one, except for a free joint with properties along the axes of
        the world, which is three prismatic joints along these axes and a ball joint. Their coordinates and velocities
        are those of MuJoCo.
        """
        model = self.model
        kind, dof, at = int(model.jnt_type[joint]), int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
        if kind == FREE and any(name not in self.ignore for name in along_world(model, joint)):
            slides = [_Part(f"/{axis}", SLIDE, dof + i, at + i, np.eye(3)[i]) for i, axis in enumerate("xyz")]
            return [*slides, _Part("", BALL, dof + 3, at + 3)]
        return [_Part("", kind, dof, at)]

    def _kind(self, joint: int, part: _Part) -> Any:
        kind = KINDS[part.kind]
        return "continuous" if kind == "revolute" and not self._is_limited(joint) else kind

    def _numbers(self, joint: int, part: _Part) -> dict[str, Any]:
        """Armature, damping, friction, spring and limits of a joint, as keyword arguments of SceneBuilder.joint."""
        model = self.model
        kind, at, is_free = part.kind, part.at, model.jnt_type[joint] == FREE
        dofs = slice(part.dof, part.dof + WIDTHS[kind])
        found: dict[str, Any] = {}
        for ours, theirs in (("armature", "dof_armature"), ("damping", "dof_damping"), ("friction", "dof_frictionloss")):
            values = getattr(model, theirs)[dofs]
            if is_free and ours in self.ignore:
                continue
            if np.any(values != values[0]):
                of = self.names.joints[joint]
                raise SceneError(f"source: found {theirs} {values.tolist()} at the joint {of!r}; expected equal values for all axes")
            found[ours] = float(values[0])
        for ours in ("armature", "damping"):
            if (values := field(model, f"actuator_{ours}")) is not None:
                found[ours] = found.get(ours, 0.0) + sum(float(values[actuator]) * gear**2 for actuator, gear in self.actuators.get(joint, []))
        if is_disabled(model, "DAMPER"):
            found["damping"] = 0.0
        if not has_constraints(model, "FRICTIONLOSS"):
            found["friction"] = 0.0
        has_spring = kind != FREE and not (is_free and "nonlinear" in self.ignore)
        if has_spring and model.jnt_stiffness[joint] and not is_disabled(model, "SPRING"):
            rest = model.qpos_spring[at : at + (4 if kind == BALL else 1)]
            found |= {"stiffness": float(model.jnt_stiffness[joint]), "rest": np.roll(rest, -1) if kind == BALL else rest}
        if kind in (HINGE, SLIDE) and not is_free:
            if self._is_limited(joint):
                found |= {"lower": float(self.low[joint]), "upper": float(self.high[joint])}
            if (effort := self._effort(joint)) is not None:
                found["effort"] = effort
        return found

    def _effort(self, joint: int) -> float | None:
        """Largest force of the actuators on a joint, N m or N; None if it is unbounded."""
        model = self.model
        if model.jnt_actfrclimited[joint]:
            return float(np.abs(model.jnt_actfrcrange[joint]).max())
        acting = self.actuators.get(joint, [])
        if not acting or not all(model.actuator_forcelimited[at] for at, _ in acting):
            return None
        return float(sum(np.abs(model.actuator_forcerange[at]).max() * abs(gear) for at, gear in acting))

    def _add_connection(self, at: int) -> None:
        """Add an equality constraint as a rigid connection; solref and solimp are ignored."""
        model, names = self.model, self.names
        kind, data, name = model.eq_type[at], model.eq_data[at], names.equalities[at]
        ends = int(model.eq_obj1id[at]), int(model.eq_obj2id[at])
        if kind == EQUALITY_JOINT:
            coefficients, joint = self._polynomial(at), names.joints[ends[0]]
            if ends[1] >= 0:
                self.scene.couple(name, joint, names.joints[ends[1]], polynomial=coefficients)
            else:
                self.scene.couple(name, joint, offset=coefficients[0])
            return
        bodies = connected(model, at)
        if ties_bodies(model, at):
            first, second = _Frame(np.eye(3), data[0:3]), _Frame(np.eye(3), data[3:6])
            if kind == EQUALITY_WELD:
                first, second = _Frame(rotation(data[6:10]), data[3:6]), _Frame(np.eye(3), data[0:3])
        else:
            first, second = (_Frame(rotation(model.site_quat[site]), model.site_pos[site]) for site in ends)
        # A weld with a torque scale of zero does not constrain the rotation.
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

    def _polynomial(self, at: int) -> list[float]:
        """Coefficients of a joint equality in joint coordinates, that of degree zero first. MuJoCo defines them relative
        to qpos0: x - x0 = P(y - y0); without the joint of y, x - x0 is the constant of P.
        """
        model = self.model
        follower, leader = int(model.eq_obj1id[at]), int(model.eq_obj2id[at])
        given = [float(a) for a in model.eq_data[at][:5]]
        x0 = float(model.qpos0[model.jnt_qposadr[follower]])
        y0 = float(model.qpos0[model.jnt_qposadr[leader]]) if leader >= 0 else 0.0
        of_powers = [sum(given[j] * math.comb(j, k) * (-y0) ** (j - k) for j in range(k, 5)) for k in range(5)]
        return [x0 + of_powers[0], *of_powers[1:]]

    def _mimics(self) -> dict[int, dict[str, Any]]:
        """Joints that follow another joint linearly by an ignored equality constraint, as keyword arguments of
        SceneBuilder.joint.
        """
        model = self.model
        found: dict[int, dict[str, Any]] = {}
        for at in equalities(model):
            leader = int(model.eq_obj2id[at])
            if model.eq_type[at] == EQUALITY_JOINT and leader >= 0 and not np.any(model.eq_data[at][2:5]):
                offset, slope, *_ = self._polynomial(at)
                follower = int(model.eq_obj1id[at])
                found[follower] = {"mimic": self.names.joints[leader], "mimic_multiplier": slope, "mimic_offset": offset}
        return found


def _moves_body(model: mujoco.MjModel, joint: int) -> bool:
    """Whether the axis of the last joint of a body passes through the origin of the body."""
    return bool(model.jnt_type[joint] in (FREE, SLIDE) or not np.any(model.jnt_pos[joint]))


def rotation(quaternion: ArrayLike) -> _Array:
    """Rotation matrix of a unit quaternion (w, x, y, z)."""
    w, x, y, z = np.asarray(quaternion, float) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _turn(axis: _Array, angle: float) -> _Array:
    """Rotation matrix for an angle, rad, about a unit axis."""
    return rotation(np.concatenate([[np.cos(0.5 * angle)], np.sin(0.5 * angle) * axis]))


# Conventions


def to_state(scene: Scene, qpos: ArrayLike, qvel: ArrayLike | None = None) -> tuple[_Array, _Array]:
    """Convert a state of MuJoCo to one of phipsi.

    Parameters
    ----------
    scene : Scene
        Scene of the model.
    qpos : array_like, (..., nq)
        Positions of MuJoCo.
    qvel : array_like, (..., nv), optional
        Velocities of MuJoCo; None: zero.

    Returns
    -------
    q : array, (..., nq)
        Configuration.
    qd : array, (..., nv)
        Joint velocities, rad/s or m/s.

    Raises
    ------
    ShapeError
        If a last axis has a wrong size, or the leading axes do not broadcast.

    Examples
    --------
    >>> import mujoco, phipsi, phipsi.mujoco  # doctest: +SKIP
    >>> model = mujoco.MjModel.from_xml_path("humanoid.xml")  # doctest: +SKIP
    >>> data = mujoco.MjData(model)  # doctest: +SKIP
    >>> scene = phipsi.Scene.from_mujoco(model)  # doctest: +SKIP
    >>> q, qd = phipsi.mujoco.to_state(scene, data.qpos, data.qvel)  # doctest: +SKIP
    """
    qpos = vectors("qpos", qpos, scene.nq)
    qvel = np.zeros(scene.nv) if qvel is None else vectors("qvel", qvel, scene.nv)
    q = _reordered(scene, qpos, -1)
    return q, _turned(scene, q, qvel, inward=True)


def from_state(scene: Scene, q: ArrayLike, qd: ArrayLike | None = None) -> tuple[_Array, _Array]:
    """Convert a state of phipsi to one of MuJoCo.

    Parameters
    ----------
    scene : Scene
        Scene of the model.
    q : array_like, (..., nq)
        Configuration.
    qd : array_like, (..., nv), optional
        Joint velocities, rad/s or m/s; None: zero.

    Returns
    -------
    qpos : array, (..., nq)
        Positions of MuJoCo.
    qvel : array, (..., nv)
        Velocities of MuJoCo.

    Raises
    ------
    ShapeError
        If a last axis has a wrong size, or the leading axes do not broadcast.

    Examples
    --------
    >>> import mujoco, phipsi, phipsi.mujoco  # doctest: +SKIP
    >>> model = mujoco.MjModel.from_xml_path("humanoid.xml")  # doctest: +SKIP
    >>> data = mujoco.MjData(model)  # doctest: +SKIP
    >>> scene = phipsi.Scene.from_mujoco(model)  # doctest: +SKIP
    >>> data.qpos[:], data.qvel[:] = phipsi.mujoco.from_state(scene, scene.neutral())  # doctest: +SKIP
    """
    q = vectors("q", q, scene.nq)
    qd = np.zeros(scene.nv) if qd is None else vectors("qd", qd, scene.nv)
    return _reordered(scene, q, 1), _turned(scene, q, qd, inward=False)


def to_forces(scene: Scene, q: ArrayLike, qfrc: ArrayLike) -> _Array:
    """Convert generalized forces of MuJoCo (qfrc_applied, qfrc_bias, ...) to joint torques.

    Parameters
    ----------
    scene : Scene
        Scene of the model.
    q : array_like, (..., nq)
        Configuration in the convention of phipsi, from to_state.
    qfrc : array_like, (..., nv)
        Generalized forces of MuJoCo.

    Returns
    -------
    array
        Joint torques, (..., nv), N m or N.

    Raises
    ------
    ShapeError
        If a last axis has a wrong size, or the leading axes do not broadcast.

    Examples
    --------
    >>> import mujoco, phipsi, phipsi.mujoco  # doctest: +SKIP
    >>> model = mujoco.MjModel.from_xml_path("humanoid.xml")  # doctest: +SKIP
    >>> data = mujoco.MjData(model)  # doctest: +SKIP
    >>> scene = phipsi.Scene.from_mujoco(model)  # doctest: +SKIP
    >>> tau = phipsi.mujoco.to_forces(scene, q, data.qfrc_bias)  # doctest: +SKIP
    """
    return _turned(scene, vectors("q", q, scene.nq), vectors("qfrc", qfrc, scene.nv), inward=True)


def from_forces(scene: Scene, q: ArrayLike, tau: ArrayLike) -> _Array:
    """Convert joint torques to generalized forces of MuJoCo.

    Parameters
    ----------
    scene : Scene
        Scene of the model.
    q : array_like, (..., nq)
        Configuration in the convention of phipsi, from to_state.
    tau : array_like, (..., nv)
        Joint torques, N m or N.

    Returns
    -------
    array
        Generalized forces of MuJoCo, (..., nv).

    Raises
    ------
    ShapeError
        If a last axis has a wrong size, or the leading axes do not broadcast.

    Examples
    --------
    >>> import mujoco, phipsi, phipsi.mujoco  # doctest: +SKIP
    >>> model = mujoco.MjModel.from_xml_path("humanoid.xml")  # doctest: +SKIP
    >>> data = mujoco.MjData(model)  # doctest: +SKIP
    >>> scene = phipsi.Scene.from_mujoco(model)  # doctest: +SKIP
    >>> data.qfrc_applied[:] = phipsi.mujoco.from_forces(scene, q, tau)  # doctest: +SKIP
    """
    return _turned(scene, vectors("q", q, scene.nq), vectors("tau", tau, scene.nv), inward=False)


def to_accelerations(scene: Scene, q: ArrayLike, qd: ArrayLike, qacc: ArrayLike) -> _Array:
    """Convert qacc of MuJoCo to joint accelerations.

    Parameters
    ----------
    scene : Scene
        Scene of the model.
    q, qd : array_like, (..., nq) and (..., nv)
        State in the convention of phipsi, from to_state.
    qacc : array_like, (..., nv)
        Accelerations of MuJoCo.

    Returns
    -------
    array
        Joint accelerations, (..., nv), rad/s^2 or m/s^2. For a free joint the linear part is the time
        derivative of the linear velocity in the body frame, which differs from the rotated acceleration by w x
        v.

    Raises
    ------
    ShapeError
        If a last axis has a wrong size, or the leading axes do not broadcast.

    Examples
    --------
    >>> import mujoco, phipsi, phipsi.mujoco  # doctest: +SKIP
    >>> model = mujoco.MjModel.from_xml_path("humanoid.xml")  # doctest: +SKIP
    >>> data = mujoco.MjData(model)  # doctest: +SKIP
    >>> scene = phipsi.Scene.from_mujoco(model)  # doctest: +SKIP
    >>> qdd = phipsi.mujoco.to_accelerations(scene, q, qd, data.qacc)  # doctest: +SKIP
    """
    q, qd, qacc = (vectors(name, value, size) for name, value, size in (("q", q, scene.nq), ("qd", qd, scene.nv), ("qacc", qacc, scene.nv)))
    return _turned(scene, q, qacc, inward=True) - _spin(scene, qd)


def from_accelerations(scene: Scene, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> _Array:
    """Convert joint accelerations to qacc of MuJoCo.

    Parameters
    ----------
    scene : Scene
        Scene of the model.
    q, qd : array_like, (..., nq) and (..., nv)
        State in the convention of phipsi, from to_state.
    qdd : array_like, (..., nv)
        Joint accelerations, rad/s^2 or m/s^2.

    Returns
    -------
    array
        Accelerations of MuJoCo, (..., nv).

    Raises
    ------
    ShapeError
        If a last axis has a wrong size, or the leading axes do not broadcast.

    Examples
    --------
    >>> import mujoco, phipsi, phipsi.mujoco  # doctest: +SKIP
    >>> model = mujoco.MjModel.from_xml_path("humanoid.xml")  # doctest: +SKIP
    >>> data = mujoco.MjData(model)  # doctest: +SKIP
    >>> scene = phipsi.Scene.from_mujoco(model)  # doctest: +SKIP
    >>> qacc = phipsi.mujoco.from_accelerations(scene, q, qd, qdd)  # doctest: +SKIP
    """
    q, qd, qdd = (vectors(name, value, size) for name, value, size in (("q", q, scene.nq), ("qd", qd, scene.nv), ("qdd", qdd, scene.nv)))
    return _turned(scene, q, qdd + _spin(scene, qd), inward=False)


def _wide(scene: Scene, at: Callable[[str], slice], width: int) -> Iterator[slice]:
    """Slices of the joints with that many entries: 4 coordinates for a ball joint; 7 coordinates or 6 velocities for a
    free joint.
    """
    return (part for part in map(at, scene.joint_names) if part.stop - part.start == width)


def _reordered(scene: Scene, q: _Array, by: int) -> _Array:
    """Configurations with cyclically shifted quaternions: by -1 from (w, x, y, z), by 1 to (w, x, y, z)."""
    found = np.array(q)
    for at in _wide(scene, scene.q_index, 4):
        found[..., at] = np.roll(found[..., at], by, axis=-1)
    for at in _wide(scene, scene.q_index, 7):
        part = slice(at.start + 3, at.stop)
        found[..., part] = np.roll(found[..., part], by, axis=-1)
    return found


def _turned(scene: Scene, q: _Array, v: _Array, *, inward: bool) -> _Array:
    """Velocities with the linear part of free joints rotated from the world frame to the body frame (inward), or
    back.
    """
    found = np.array(np.broadcast_to(v, (*leading(q, v), v.shape[-1])))
    places = zip(_wide(scene, scene.q_index, 7), _wide(scene, scene.v_index, 6), strict=True)
    for at, rows in places:
        quaternion = q[..., at.start + 3 : at.stop]
        quaternion = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
        axis, w = quaternion[..., :3], quaternion[..., 3:]
        part = slice(rows.start, rows.start + 3)
        linear = found[..., part]
        # For the quaternion (u, w): v + 2 w u x v + 2 u x (u x v); the sign of w selects the direction.
        across = np.cross(axis, linear)
        found[..., part] = linear + 2.0 * ((-w if inward else w) * across + np.cross(axis, across))
    return found


def _spin(scene: Scene, qd: _Array) -> _Array:
    """w x v of free joints; zero for other joints."""
    found = np.zeros_like(qd)
    for at in _wide(scene, scene.v_index, 6):
        found[..., at.start : at.start + 3] = np.cross(qd[..., at.start + 3 : at.stop], qd[..., at.start : at.start + 3])
    return found
