"""Read Pinocchio models (package `pin`), and convert states between the conventions of Pinocchio and phipsi.

>>> import pinocchio, phipsi.pinocchio                                  # doctest: +SKIP
>>> model = pinocchio.buildModelFromUrdf("robot.urdf")                  # doctest: +SKIP
>>> scene = phipsi.Scene.from_pinocchio(model)                          # doctest: +SKIP
>>> q, qd = phipsi.pinocchio.to_state(scene, model, q_pin, v_pin)       # doctest: +SKIP

Pinocchio represents joints without limits as (cos, sin) and planar joints as (x, y, cos, sin), with velocities
in the body frame, and numbers the joints in the order in which they were added; phipsi numbers them depth
first. Quaternions (x, y, z, w) and the velocities of free joints (linear, angular, in the body frame) are the
same. Spatial vectors are linear first in Pinocchio and angular first in phipsi.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arguments import leading, vectors
from ._core import Scene, SceneBuilder
from .errors import ArgumentError, SceneError

if TYPE_CHECKING:
    import pinocchio

__all__ = ["from_state", "to_state"]


def __dir__() -> list[str]:
    return __all__


_Array = NDArray[np.float64]

#: Joints of several degrees of freedom, as both programs know them.
KINDS = {"JointModelFreeFlyer": "floating", "JointModelSpherical": "spherical", "JointModelPlanar": "planar"}
TRANSLATION = "JointModelTranslation"


# A model as a scene


def read(model: pinocchio.Model, gravity: ArrayLike | None, strict: bool, leave_out: Collection[Any] | None) -> Scene:
    """Implementation of Scene.from_pinocchio."""
    try:
        import pinocchio as pin
    except ImportError:
        raise ImportError("Scene.from_pinocchio: found no package pinocchio; install it with: pip install pin") from None
    if not isinstance(model, pin.Model):
        raise ArgumentError(f"model: found {type(model).__name__}; expected pinocchio.Model")
    links = _own_links(model)
    builder, names = SceneBuilder(), _Taken([*links, *(body.name for body in _bodies(model))], model.names)
    for joint, link in enumerate(links):
        inertia = model.inertias[joint]
        builder.link(link, mass=float(inertia.mass), com=np.array(inertia.lever), inertia=_symmetric(inertia.inertia))
        if joint:
            _add_joint(builder, model, joint, links, names)
    _add_frames(builder, model, links, names)
    return builder.build(gravity=np.array(model.gravity.linear) if gravity is None else gravity, strict=strict, leave_out=leave_out)


def _own_links(model: pinocchio.Model) -> list[str]:
    """Link of each joint: the first body whose frame is that of the joint; otherwise a new link with the name of the
    joint.
    """
    links: dict[int, str] = {}
    bodies = list(_bodies(model))
    taken = {body.name for body in bodies}
    for body in bodies:
        if body.placement.isIdentity(0.0):
            links.setdefault(body.parentJoint, body.name)
    for joint in range(model.njoints):
        if joint not in links:
            links[joint] = _fresh(model.names[joint], taken)
    return [links[joint] for joint in range(model.njoints)]


def _bodies(model: pinocchio.Model) -> Iterator[Any]:
    import pinocchio as pin

    return (frame for frame in model.frames if frame.type == pin.FrameType.BODY)


class _Taken:
    """Names of links and joints that are in use, so that generated names are unique."""

    def __init__(self, links: Iterable[str], joints: Iterable[str]) -> None:
        self.links, self.joints = set(links), set(joints)

    def link(self, name: str) -> str:
        """An unused name for a link."""
        return _fresh(name, self.links)

    def joint(self, name: str) -> str:
        """An unused name for a joint."""
        return _fresh(name, self.joints)


def _fresh(name: str, taken: set[str]) -> str:
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _add_joint(builder: SceneBuilder, model: pinocchio.Model, joint: int, links: list[str], names: _Taken) -> None:
    """Add a joint, or the three prismatic joints of a translation."""
    place, name = model.jointPlacements[joint], model.names[joint]
    xyz, rotation = np.array(place.translation), np.array(place.rotation)
    parts = list(_parts(model, joint))
    parent = links[model.parents[joint]]
    for part in parts:
        kind, axis, pitch = (part.kind, part.axis, None) if part.kind else _of_one(model.joints[joint])
        child = links[joint] if part is parts[-1] else names.link(f"{links[joint]}/{part.name}")
        if child != links[joint]:
            builder.link(child)
        names.joints.add(part.name)
        numbers = _numbers(model, part, kind, name)
        builder.joint(part.name, kind, parent, child, xyz=xyz, rotation=rotation, axis=axis, pitch=pitch, **numbers)
        parent, xyz, rotation = child, np.zeros(3), np.eye(3)


class _Part(NamedTuple):
    """A joint of phipsi and its entries in q and v of Pinocchio."""

    name: str
    kind: Any
    """None for a joint with one degree of freedom: see _of_one."""
    axis: _Array
    q: slice
    v: slice


def _parts(model: pinocchio.Model, joint: int) -> Iterator[_Part]:
    """Joints of phipsi that represent a joint of Pinocchio."""
    there, name = model.joints[joint], model.names[joint]
    kind = there.shortname()
    q, v = slice(there.idx_q, there.idx_q + there.nq), slice(there.idx_v, there.idx_v + there.nv)
    up = np.array([0.0, 0.0, 1.0])
    if kind in KINDS:
        yield _Part(name, KINDS[kind], up, q, v)
    elif kind == TRANSLATION:
        known = set(model.names)
        for at, axis in enumerate(np.eye(3)):
            # The names of two translations cannot collide, because they end in the axis and underscores.
            yield _Part(_fresh(f"{name}_{'xyz'[at]}", known), "prismatic", axis, slice(q.start + at, q.start + at + 1), slice(v.start + at, v.start + at + 1))
    elif there.nv == 1 and not kind.startswith(("JointModelMimic", "JointModelComposite")):
        yield _Part(name, None, up, q, v)
    else:
        ours = "revolute, continuous, prismatic, helical, planar, translation, spherical (quaternion) and free-flyer joints"
        raise SceneError(f"model: found joint {name!r} of type {kind}; expected {ours}: compose the joint of these")


def _of_one(joint: Any) -> tuple[Any, _Array, float | None]:
    """Kind, axis and pitch of a joint with one degree of freedom."""
    moves = _subspace(joint)
    linear, angular = moves[:3], moves[3:]
    if not np.any(angular):
        return "prismatic", linear, None
    if np.any(linear):
        return "screw", angular, float(linear @ angular / (angular @ angular))
    return "continuous" if joint.nq == 2 else "revolute", angular, None


def _subspace(joint: Any) -> _Array:
    """Motion subspace of a joint with one degree of freedom, (linear, angular), in its own frame. It is exact, because
    it is computed in a model that contains only this joint.
    """
    import pinocchio as pin

    alone = pin.Model()
    alone.addJoint(0, joint, pin.SE3.Identity(), "joint")
    data = alone.createData()
    pin.computeJointJacobians(alone, data, pin.neutral(alone))
    return np.reshape(pin.getJointJacobian(alone, data, 1, pin.ReferenceFrame.LOCAL), 6)


def _numbers(model: pinocchio.Model, part: _Part, kind: str, name: str) -> dict[str, Any]:
    """Armature, damping, friction and limits of a joint, as keyword arguments of SceneBuilder.joint."""
    found: dict[str, Any] = {}
    upper = _first(model, "upperDryFrictionLimit", "friction")
    lower = getattr(model, "lowerDryFrictionLimit", -upper)
    frictions = {"friction": 0.5 * (upper - lower), "friction_offset": 0.5 * (upper + lower)}
    for ours, values in {"armature": model.armature, "damping": model.damping, **frictions}.items():
        own = np.array(values[part.v])
        if np.any(own != own[0]):
            raise SceneError(f"model: found {ours} {own.tolist()} at the joint {name!r}; expected equal values for all axes")
        if kind == "planar" and ours != "damping" and own[0]:
            why = "Pinocchio applies it in the body frame, phipsi in the parent frame"
            raise SceneError(f"model: found {ours} {own[0]:g} at the planar joint {name!r}; expected zero, or the joints PX, PY and RZ instead, because {why}")
        found[ours] = float(own[0])
    # Continuous joints and joints with several coordinates have no position limits in phipsi.
    if kind in ("revolute", "prismatic", "screw"):
        found |= {"lower": float(model.lowerPositionLimit[part.q][0]), "upper": float(model.upperPositionLimit[part.q][0])}
    if kind not in KINDS.values():
        speed, effort = _first(model, "upperVelocityLimit", "velocityLimit"), _first(model, "upperEffortLimit", "effortLimit")
        found |= {"velocity": float(speed[part.v][0]), "effort": float(effort[part.v][0])}
    return found


def _first(model: pinocchio.Model, *fields: str) -> Any:
    """The first of these fields that this version of Pinocchio has."""
    return next(getattr(model, field) for field in fields if hasattr(model, field))


def _add_frames(builder: SceneBuilder, model: pinocchio.Model, links: list[str], names: _Taken) -> None:
    """Add operational frames, and bodies that are fixed to others; the mass of these is already included there."""
    import pinocchio as pin

    own = set(links)
    for frame in model.frames:
        if frame.type == pin.FrameType.OP_FRAME:
            link = names.link(frame.name)
            where: dict[str, Any] = {"xyz": np.array(frame.placement.translation), "rotation": np.array(frame.placement.rotation)}
            builder.link(link).joint(names.joint(f"{link}/fixed"), "fixed", links[frame.parentJoint], link, **where)
    for body in _bodies(model):
        if body.name in own:
            continue
        above = model.frames[_first(body, "parentFrame", "previousFrame")]
        name = names.joint(above.name if above.type == pin.FrameType.FIXED_JOINT and above.name not in names.joints else f"{body.name}/fixed")
        place = body.placement
        builder.link(body.name)
        builder.joint(name, "fixed", links[body.parentJoint], body.name, xyz=np.array(place.translation), rotation=np.array(place.rotation))


def _symmetric(matrix: Any) -> _Array:
    full: _Array = np.array(matrix, float)
    return np.asarray(0.5 * (full + full.T))


# Conventions


def to_state(scene: Scene, model: pinocchio.Model, q: ArrayLike, v: ArrayLike | None = None) -> tuple[_Array, _Array]:
    """Convert a state of Pinocchio to one of phipsi.

    Joint torques and accelerations of robots without planar joints are converted like v.

    Parameters
    ----------
    scene : Scene
        Scene.from_pinocchio(model), or the scene of the URDF that the model was built from.
    model : pinocchio.Model
        The model.
    q : array_like, (..., model.nq)
        Configuration of Pinocchio.
    v : array_like, (..., model.nv), optional
        Velocities of Pinocchio; None: zero.

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
    ArgumentError
        If a joint of the model is not in the scene.

    Examples
    --------
    >>> import pinocchio, phipsi, phipsi.pinocchio  # doctest: +SKIP
    >>> model = pinocchio.buildModelFromUrdf("robot.urdf")  # doctest: +SKIP
    >>> scene = phipsi.Scene.from_pinocchio(model)  # doctest: +SKIP
    >>> q, qd = phipsi.pinocchio.to_state(scene, model, pinocchio.neutral(model))  # doctest: +SKIP
    """
    q, v = vectors("q", q, model.nq), np.zeros(model.nv) if v is None else vectors("v", v, model.nv)
    ours, rates = np.empty((*q.shape[:-1], scene.nq)), np.empty((*leading(q, v), scene.nv))
    for part, at, rows in _matched(scene, model):
        given, rate = q[..., part.q], v[..., part.v]
        if part.kind == "planar":
            ours[..., at] = np.concatenate([given[..., :2], np.arctan2(given[..., 3:], given[..., 2:3])], axis=-1)
            rates[..., rows] = _planar(given[..., 2:3], given[..., 3:], rate)
        else:
            ours[..., at] = np.arctan2(given[..., 1:], given[..., :1]) if given.shape[-1] == 2 else given
            rates[..., rows] = rate
    return ours, rates


def from_state(scene: Scene, model: pinocchio.Model, q: ArrayLike, qd: ArrayLike | None = None) -> tuple[_Array, _Array]:
    """Convert a state of phipsi to one of Pinocchio.

    Parameters
    ----------
    scene : Scene
        Scene.from_pinocchio(model), or the scene of the URDF that the model was built from.
    model : pinocchio.Model
        The model.
    q : array_like, (..., nq)
        Configuration.
    qd : array_like, (..., nv), optional
        Joint velocities, rad/s or m/s; None: zero.

    Returns
    -------
    q : array, (..., model.nq)
        Configuration of Pinocchio.
    v : array, (..., model.nv)
        Velocities of Pinocchio.

    Raises
    ------
    ShapeError
        If a last axis has a wrong size, or the leading axes do not broadcast.
    ArgumentError
        If a joint of the model is not in the scene.

    Examples
    --------
    >>> import pinocchio, phipsi, phipsi.pinocchio  # doctest: +SKIP
    >>> model = pinocchio.buildModelFromUrdf("robot.urdf")  # doctest: +SKIP
    >>> scene = phipsi.Scene.from_pinocchio(model)  # doctest: +SKIP
    >>> q_pin, v_pin = phipsi.pinocchio.from_state(scene, model, scene.neutral())  # doctest: +SKIP
    """
    q, qd = vectors("q", q, scene.nq), np.zeros(scene.nv) if qd is None else vectors("qd", qd, scene.nv)
    theirs, rates = np.empty((*q.shape[:-1], model.nq)), np.empty((*leading(q, qd), model.nv))
    for part, at, rows in _matched(scene, model):
        given, rate = q[..., at], qd[..., rows]
        if part.kind == "planar":
            cos, sin = np.cos(given[..., 2:]), np.sin(given[..., 2:])
            theirs[..., part.q] = np.concatenate([given[..., :2], cos, sin], axis=-1)
            rates[..., part.v] = _planar(cos, -sin, rate)
        else:
            unbounded = part.q.stop - part.q.start == 2
            theirs[..., part.q] = np.concatenate([np.cos(given), np.sin(given)], axis=-1) if unbounded else given
            rates[..., part.v] = rate
    return theirs, rates


def _matched(scene: Scene, model: pinocchio.Model) -> Iterator[tuple[_Part, slice, slice]]:
    """Joints of the model, and their entries in q and qd of phipsi."""
    known = set(scene.joint_names)
    for joint in range(1, model.njoints):
        for part in _parts(model, joint):
            if part.name not in known:
                raise ArgumentError(f"scene: found no joint {part.name!r}, which the model has; expected the scene of this model")
            yield part, scene.q_index(part.name), scene.v_index(part.name)


def _planar(cos: _Array, sin: _Array, rate: _Array) -> _Array:
    """Velocities of a planar joint, rotated by an angle."""
    x, y, turn = rate[..., 0:1], rate[..., 1:2], rate[..., 2:]
    turned: _Array = np.concatenate(np.broadcast_arrays(cos * x - sin * y, sin * x + cos * y, turn), axis=-1)
    return turned
