"""Other programs on the extreme scenes, where they are installed: Pinocchio in both its conventions, MuJoCo.

Their models are built from the same numbers as the scene's, not through a file: frames of the extreme scenes are parallel at zero
configuration, so that nothing is rounded on the way but the lengths of axes.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._core import Scene

Array = NDArray[np.float64]
#: (q, qd, tau) to accelerations.
Solver = Callable[[Array, Array, Array], Array]

#: Larger scenes are not given to peers: Pinocchio's data hold several dense matrices of that order.
LARGEST = 300


class Peer(NamedTuple):
    """A program, and how it is asked."""

    name: str
    version: str
    solver: Callable[[Scene], Solver]


class Refused(Exception):
    """The peer does not take the scene; the message says why."""


def installed() -> list[Peer]:
    """The peers that can be imported."""
    found: list[Peer] = []
    try:
        pin: Any = importlib.import_module("pinocchio")
    except ImportError:
        pass
    else:
        version = f"Pinocchio {pin.__version__}"
        for name, convention in (("Pinocchio, local", "LOCAL"), ("Pinocchio, world", "WORLD")):
            chosen = getattr(pin.Convention, convention)
            found.append(Peer(name, version, partial(_pinocchio, pin, convention=chosen)))
    try:
        mujoco: Any = importlib.import_module("mujoco")
    except ImportError:
        pass
    else:
        found.append(Peer("MuJoCo", f"MuJoCo {mujoco.__version__}", partial(_mujoco, mujoco)))
    return found


class _Part(NamedTuple):
    """A joint and the link that it carries."""

    name: str
    kind: str
    parent: str
    child: str
    lever: Array
    axis: Array
    armature: float
    inertial: tuple[float, Array, Array] | None


def _parts(scene: Scene) -> tuple[bool, tuple[float, Array, Array] | None, list[_Part]]:
    """Whether the base floats, its inertia, and the joints, parents first."""
    _, (description,) = scene.__reduce__()
    _, _gravity, floating, _strict, links, joints = description
    inertials: dict[str, tuple[float, Array, Array] | None] = {}
    for name, inertial in links:
        if inertial is None:
            inertials[name] = None
            continue
        mass, centre, (xx, xy, xz, yy, yz, zz) = inertial
        inertials[name] = (mass, np.array(centre), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    parts = []
    for name, kind, _pitch, parent, child, (rotation, lever), axis, (armature, _, _), _limits, _mimic in joints:
        if kind not in ("revolute", "prismatic") or not np.array_equal(np.reshape(rotation, (3, 3)), np.eye(3)):
            raise Refused(f"a {kind} joint, or a turned frame")
        direction = np.array(axis) / np.linalg.norm(axis)
        parts.append(_Part(name, kind, parent, child, np.array(lever), direction, armature, inertials[child]))
    return floating, inertials[links[0][0]], parts


def _check_size(parts: list[_Part]) -> None:
    if len(parts) > LARGEST:
        raise Refused(f"not compared beyond {LARGEST} bodies")


def _pinocchio(pin: Any, scene: Scene, convention: Any) -> Solver:
    floating, base, parts = _parts(scene)
    _check_size(parts)
    model = pin.Model()
    model.gravity.linear[:] = scene.gravity
    here = pin.SE3.Identity()
    at = {parts[0].parent: 0}
    if floating:
        at[parts[0].parent] = model.addJoint(0, pin.JointModelFreeFlyer(), here, "root_joint")
        if base is not None:
            model.appendBodyToJoint(at[parts[0].parent], pin.Inertia(*base), here)
    coordinate = {
        "revolute": (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ, pin.JointModelRevoluteUnaligned),
        "prismatic": (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ, pin.JointModelPrismaticUnaligned),
    }
    for part in parts:
        along = np.flatnonzero(part.axis)
        of_kind = coordinate[part.kind]
        joint = of_kind[along[0]]() if len(along) == 1 else of_kind[3](*part.axis)
        at[part.child] = model.addJoint(at[part.parent], joint, pin.SE3(np.eye(3), part.lever), part.name)
        if part.inertial is not None:
            model.appendBodyToJoint(at[part.child], pin.Inertia(*part.inertial), here)
    if list(model.names)[1:] != list(scene.joint_names):
        raise Refused("another order of the joints")
    model.armature = np.array(scene.armature)
    data = model.createData()
    return lambda q, qd, tau: np.array(pin.aba(model, data, q, qd, tau, convention))


@contextmanager
def _quiet(mujoco: Any) -> Iterator[None]:
    """Without a handler MuJoCo's warnings go to the terminal and into a file in the working directory."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def _mujoco(mujoco: Any, scene: Scene) -> Solver:
    floating, _, parts = _parts(scene)
    if floating:
        raise Refused("not compared with a floating base")
    _check_size(parts)

    def numbers(values: Array) -> str:
        return " ".join(repr(float(value)) for value in values)

    children: dict[str, list[_Part]] = {}
    for part in parts:
        children.setdefault(part.parent, []).append(part)

    def body(part: _Part) -> str:
        inertial = ""
        if part.inertial is not None:
            mass, centre, central = part.inertial
            diagonal = numbers(np.diag(central))
            inertial = f'<inertial mass="{mass!r}" pos="{numbers(centre)}" diaginertia="{diagonal}"/>'
        kind = "hinge" if part.kind == "revolute" else "slide"
        joint = f'<joint name="{part.name}" type="{kind}" axis="{numbers(part.axis)}" armature="{part.armature!r}"/>'
        inner = "".join(body(child) for child in children.get(part.child, []))
        return f'<body pos="{numbers(part.lever)}">{inertial}{joint}{inner}</body>'

    tree = "".join(body(part) for part in children[parts[0].parent])
    text = (
        '<mujoco><compiler angle="radian" inertiafromgeom="false"/>'
        f'<option gravity="{numbers(scene.gravity)}"><flag constraint="disable"/></option>'
        f"<worldbody>{tree}</worldbody></mujoco>"
    )
    try:
        with _quiet(mujoco):
            model = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        raise Refused(str(error).partition("Element")[0].removeprefix("Error: ").strip()) from None
    data = mujoco.MjData(model)

    def solve(q: Array, qd: Array, tau: Array) -> Array:
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, qd, tau
        with _quiet(mujoco):
            mujoco.mj_forward(model, data)
        return np.array(data.qacc_smooth)

    return solve
