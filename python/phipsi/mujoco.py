"""Models of MuJoCo: as scenes, and states and forces from its conventions to phipsi's and back. Needs phipsi[mujoco].

>>> import mujoco, phipsi.mujoco                                        # doctest: +SKIP
>>> scene = phipsi.Scene.from_mujoco("humanoid.xml")                    # doctest: +SKIP
>>> q, qd = phipsi.mujoco.to_state(scene, data.qpos, data.qvel)         # doctest: +SKIP

The order of joints is the same. What differs: MuJoCo writes quaternions (w, x, y, z) and the linear velocity of a free joint in axes of the world,
phipsi (x, y, z, w) and in axes of the body. Scenes without ball and free joints need no conversion.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arguments import leading, vectors
from ._core import Scene, SceneBuilder
from .errors import ArgumentError, SceneError

if TYPE_CHECKING:
    import mujoco

__all__ = ["from_accelerations", "from_forces", "from_state", "to_accelerations", "to_forces", "to_state"]

_Array = NDArray[np.float64]

#: Types of joints, as MuJoCo numbers them.
FREE, BALL, SLIDE, HINGE = range(4)
KINDS = {FREE: "floating", BALL: "spherical", SLIDE: "prismatic", HINGE: "revolute"}
#: mjtEq, mjtTrn, mjtDsbl: what is looked for.
EQUALITY_CONNECT, EQUALITY_WELD, EQUALITY_JOINT = range(3)
#: mjtObj: what the ends of an equality constraint are, where they are bodies.
OBJECT_BODY = 1
TRANSMISSION_JOINT = (0, 1)
#: What a model may have that a scene has not, and that `ignore` may name.
IGNORED = ("equality", "flexes", "fluid", "gravcomp", "nonlinear", "plugins", "tendons")


# A model as a scene


def read(
    source: mujoco.MjModel | mujoco.MjSpec | str | os.PathLike[str],
    gravity: ArrayLike | None,
    strict: bool,
    leave_out: Collection[Any] | None,
    ignore: Collection[str],
) -> Scene:
    """As Scene.from_mujoco, which calls it."""
    for name in ignore:
        if name not in IGNORED:
            raise ArgumentError(f"ignore: found {name!r}; expected names of {', '.join(IGNORED)}")
    model, file = compiled(source)
    for what, found, remedy in beyond(model):
        if what not in ignore:
            raise SceneError(f"source: found {found}; expected a model without: {remedy}, or read it without them by ignore=({what!r},)")
    # Of a joint that a connection ties nothing is to be warned.
    builder, mimics = SceneBuilder().link(body_name(model, 0)), _mimics(model) if "equality" in ignore else {}
    for body in range(1, model.nbody):
        _add_body(builder, model, body, mimics)
    for at in [] if "equality" in ignore else _active(model):
        _add_connection(builder, model, at)
    if file is not None:
        builder._set_file(file)
    if gravity is None:
        gravity = np.zeros(3) if _disabled(model, "mjDSBL_GRAVITY") else model.opt.gravity
    return builder.build(gravity=gravity, strict=strict, leave_out=leave_out)


def compiled(source: Any) -> tuple[mujoco.MjModel, Path | None]:
    """MuJoCo's model of a file, of XML, of a specification or of itself; and the file, where there is one."""
    try:
        import mujoco
    except ImportError:
        raise ImportError('Scene.from_mujoco: found no package mujoco; install it with: pip install "phipsi[mujoco]"') from None
    if isinstance(source, mujoco.MjModel):
        return source, None
    if isinstance(source, mujoco.MjSpec):
        return source.compile(), None
    if not isinstance(source, str | os.PathLike):
        raise ArgumentError(f"source: found {type(source).__name__}; expected a path, XML, mujoco.MjModel or mujoco.MjSpec")
    try:
        if isinstance(source, str) and source.lstrip().startswith("<"):
            return mujoco.MjModel.from_xml_string(source), None
        file = Path(source)
        if not file.is_file():
            raise SceneError(f"source: found {str(source)[:100]!r}, which is no file; expected the path of a model, or XML")
        if file.suffix == ".mjb":
            return mujoco.MjModel.from_binary_path(str(file)), None
        return mujoco.MjModel.from_xml_path(str(file)), file.resolve()
    except (ValueError, mujoco.FatalError) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(f"source: MuJoCo cannot read it: {' '.join(str(error).split())}") from None


def beyond(model: mujoco.MjModel) -> Iterator[tuple[str, str, str]]:
    """What acts in a model and is not in a scene: its name for `ignore`, what was found, and why it cannot be read."""
    for at in _active(model):
        is_curved = model.eq_type[at] == EQUALITY_JOINT and np.any(model.eq_data[at][2:5])
        if is_curved or model.eq_type[at] not in (EQUALITY_CONNECT, EQUALITY_WELD, EQUALITY_JOINT):
            remedy = "connections are of kind connect, weld and joint, that one linear"
            yield "equality", f"the equality constraint {_name(model.equality(at), at)}", remedy
    for at in range(model.ntendon):
        acting = (model.tendon_stiffness, model.tendon_damping, model.tendon_frictionloss, model.tendon_limited, _of(model, "tendon_armature"))
        if any(np.any(each[at]) for each in acting if each is not None):
            yield "tendons", f"the tendon {_name(model.tendon(at), at)}, with springs, losses, armature or limits", "scenes have no tendons"
    if model.nflex:
        yield "flexes", f"{model.nflex} deformable objects (flex)", "bodies are rigid"
    for at in _where(model.body_gravcomp):
        yield "gravcomp", f"gravcomp {model.body_gravcomp[at]:g} at the body {body_name(model, at)!r}", "weight acts on all bodies"
    if model.opt.density or model.opt.viscosity:
        yield "fluid", f"a medium of density {model.opt.density:g} and viscosity {model.opt.viscosity:g}", "robots move in vacuum"
    for at in _where(model.body_plugin >= 0):
        yield "plugins", f"a plugin at the body {body_name(model, at)!r}", "plugins are not read"
    for field, of, name in (
        ("jnt_stiffnesspoly", "the joint", _joint_name),
        ("dof_dampingpoly", "the degree of freedom", lambda model, dof: _joint_name(model, model.dof_jntid[dof])),
        ("jnt_springyield", "the joint", _joint_name),
    ):
        for at in _rows(_of(model, field)):
            yield "nonlinear", f"{field} at {of} {name(model, at)!r}", "springs and damping are linear"
    plastic = _of(model, "jnt_plasticadr")
    for at in [] if plastic is None else _where(plastic >= 0):
        yield "nonlinear", f"plasticity at the joint {_joint_name(model, at)!r}", "springs are elastic"
    for at in _where(model.jnt_type == FREE):
        if model.jnt_stiffness[at]:
            yield "nonlinear", f"stiffness at the free joint {_joint_name(model, at)!r}", "its spring is another one than phipsi's"


class _Frame(NamedTuple):
    """A place: what it makes of axes, and where its origin is, m."""

    rotation: _Array
    origin: _Array

    def then(self, rotation: _Array, origin: _Array) -> _Frame:
        """A place that is given in this one."""
        return _Frame(self.rotation @ rotation, self.origin + self.rotation @ origin)


def _add_body(builder: SceneBuilder, model: mujoco.MjModel, body: int, mimics: dict[int, dict[str, Any]]) -> None:
    """A body and its joints. The first joint is the outermost from the body: MuJoCo moves the body by each, in axes that the ones before have turned.

    A joint's axis goes through the origin of the link that it moves. So a joint whose anchor is not the body's origin moves a link of its own, to
    which the body is fixed; so does each joint of a body but its last.
    """
    name, parent = body_name(model, body), body_name(model, model.body_parentid[body])
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
        child = name if of_body else f"{name}/{_joint_name(model, joint)}"
        if not of_body:
            builder.link(child)
        where = {"xyz": place.origin, "rotation": place.rotation, "axis": axis}
        builder.joint(_joint_name(model, joint), _kind(model, joint), parent, child, **where, **_numbers(model, joint), **mimics.get(joint, {}))
        parent, place = child, _Frame(np.eye(3), -anchor if kind in (HINGE, BALL) else np.zeros(3))
    inertia = rotation(model.body_iquat[body])
    moments = inertia @ np.diag(model.body_inertia[body]) @ inertia.T
    builder.link(name, mass=float(model.body_mass[body]), com=model.body_ipos[body], inertia=0.5 * (moments + moments.T))
    if not own:
        builder.joint(f"{name}/fixed", "fixed", parent, name, xyz=place.origin, rotation=place.rotation)


def _moves_body(model: mujoco.MjModel, joint: int) -> bool:
    """Whether the axis of a body's last joint goes through the body's origin."""
    return bool(model.jnt_type[joint] in (FREE, SLIDE) or not np.any(model.jnt_pos[joint]))


def _kind(model: mujoco.MjModel, joint: int) -> Any:
    kind = KINDS[int(model.jnt_type[joint])]
    return "continuous" if kind == "revolute" and not model.jnt_limited[joint] else kind


def _numbers(model: mujoco.MjModel, joint: int) -> dict[str, Any]:
    """Armature, losses, spring and limits of a joint, as SceneBuilder.joint takes them."""
    kind, dof, at = model.jnt_type[joint], model.jnt_dofadr[joint], model.jnt_qposadr[joint]
    dofs = slice(dof, dof + {FREE: 6, BALL: 3}.get(kind, 1))
    found: dict[str, Any] = {}
    for ours, theirs in (("armature", "dof_armature"), ("damping", "dof_damping"), ("friction", "dof_frictionloss")):
        values = getattr(model, theirs)[dofs]
        if np.any(values != values[0]):
            raise SceneError(f"source: found {theirs} {values.tolist()} at the joint {_joint_name(model, joint)!r}; expected one number for all its axes")
        found[ours] = float(values[0])
    if kind != FREE and model.jnt_stiffness[joint] and not _disabled(model, "mjDSBL_SPRING"):
        rest = model.qpos_spring[at : at + (4 if kind == BALL else 1)]
        found |= {"stiffness": float(model.jnt_stiffness[joint]), "rest": np.roll(rest, -1) if kind == BALL else rest}
    if _disabled(model, "mjDSBL_DAMPER"):
        found["damping"] = 0.0
    if kind in (HINGE, SLIDE) and model.jnt_limited[joint]:
        found |= {"lower": float(model.jnt_range[joint, 0]), "upper": float(model.jnt_range[joint, 1])}
    if kind in (HINGE, SLIDE) and (effort := _effort(model, joint)) is not None:
        found["effort"] = effort
    return found


def _effort(model: mujoco.MjModel, joint: int) -> float | None:
    """The largest force that actuators can give a joint, N m or N; None where nothing bounds it."""
    if model.jnt_actfrclimited[joint]:
        return float(np.abs(model.jnt_actfrcrange[joint]).max())
    acting = [at for at in range(model.nu) if model.actuator_trntype[at] in TRANSMISSION_JOINT and model.actuator_trnid[at, 0] == joint]
    if not acting or not all(model.actuator_forcelimited[at] for at in acting):
        return None
    return float(sum(np.abs(model.actuator_forcerange[at]).max() * abs(model.actuator_gear[at, 0]) for at in acting))


def _active(model: mujoco.MjModel) -> list[int]:
    """The equality constraints that act."""
    return [] if _disabled(model, "mjDSBL_EQUALITY") else [at for at in range(model.neq) if model.eq_active0[at]]


def _add_connection(builder: SceneBuilder, model: mujoco.MjModel, at: int) -> None:
    """An equality constraint as a connection, which is as stiff as can be: solref and solimp are not read."""
    kind, data, ends = model.eq_type[at], model.eq_data[at], (int(model.eq_obj1id[at]), int(model.eq_obj2id[at]))
    name = model.equality(at).name or f"equality {at}"
    if kind == EQUALITY_JOINT:
        offset, slope = _line(model, at)
        other = _joint_name(model, ends[1]) if ends[1] >= 0 else None
        builder.couple(name, _joint_name(model, ends[0]), other, multiplier=slope, offset=offset)
        return
    if model.eq_objtype[at] == OBJECT_BODY:
        bodies = ends
        first, second = _Frame(np.eye(3), data[0:3]), _Frame(np.eye(3), data[3:6])
        if kind == EQUALITY_WELD:
            first, second = _Frame(rotation(data[6:10]), data[3:6]), _Frame(np.eye(3), data[0:3])
    else:
        bodies = (int(model.site_bodyid[ends[0]]), int(model.site_bodyid[ends[1]]))
        first, second = (_Frame(rotation(model.site_quat[site]), model.site_pos[site]) for site in ends)
    builder.connect(
        name,
        "weld" if kind == EQUALITY_WELD else "point",
        body_name(model, bodies[0]),
        body_name(model, bodies[1]),
        xyz=first.origin,
        rotation=first.rotation,
        other_xyz=second.origin,
        other_rotation=second.rotation,
    )


def _line(model: mujoco.MjModel, at: int) -> tuple[float, float]:
    """Offset and slope of a linear equality of joints, in their coordinates: MuJoCo has it between distances from qpos0."""
    follower, leader = int(model.eq_obj1id[at]), int(model.eq_obj2id[at])
    offset, slope = (float(x) for x in model.eq_data[at][:2])
    zero = float(model.qpos0[model.jnt_qposadr[follower]])
    of = float(model.qpos0[model.jnt_qposadr[leader]]) if leader >= 0 else 0.0
    return zero + offset - slope * of, slope


def _mimics(model: mujoco.MjModel) -> dict[int, dict[str, Any]]:
    """Joints that follow another linearly by an equality constraint, as SceneBuilder.joint takes it: where constraints are ignored they stay known."""
    found: dict[int, dict[str, Any]] = {}
    for at in range(model.neq):
        follower, leader = int(model.eq_obj1id[at]), int(model.eq_obj2id[at])
        higher = model.eq_data[at][2:5]
        if model.eq_active0[at] and model.eq_type[at] == EQUALITY_JOINT and leader >= 0 and not np.any(higher):
            offset, slope = _line(model, at)
            found[follower] = {"mimic": _joint_name(model, leader), "mimic_multiplier": slope, "mimic_offset": offset}
    return found


def _disabled(model: mujoco.MjModel, flag: str) -> bool:
    import mujoco

    # Older versions have one flag for springs and dampers.
    bits: Any = mujoco.mjtDisableBit
    bit = getattr(bits, flag, None) or bits.mjDSBL_PASSIVE
    return bool(model.opt.disableflags & int(bit))


def _of(model: mujoco.MjModel, field: str) -> Any:
    """A field that older versions of MuJoCo do not have; None there."""
    return getattr(model, field, None)


def _where(condition: Any) -> list[int]:
    """Indices of what is true, or not zero."""
    return [int(at) for at in np.flatnonzero(condition)]


def _rows(values: Any) -> list[int]:
    """Rows that are not zero."""
    return [] if values is None or not len(values) else _where(np.any(np.reshape(values, (len(values), -1)) != 0.0, axis=1))


def _name(named: Any, at: int) -> str:
    return repr(named.name) if named.name else f"number {at}"


def body_name(model: mujoco.MjModel, body: int) -> str:
    return str(model.body(body).name or f"body{body}")


def _joint_name(model: mujoco.MjModel, joint: int) -> str:
    return str(model.joint(joint).name or f"joint{joint}")


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
