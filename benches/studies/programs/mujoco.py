"""MuJoCo: `mj_forward` of an MJCF text, without contacts, limits and other constraints."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from phipsi import Scene
from .model import Array, Inertial, Model, Part, Refused, Solver, World, read

#: No value is raised to a bound, averaged or derived from shapes; errors of MuJoCo remain.
COMPILER = '<compiler angle="radian" inertiafromgeom="false" balanceinertia="false" boundmass="0" boundinertia="0"/>'


@contextmanager
def quiet(mujoco: Any) -> Iterator[None]:
    """Handler for MuJoCo's warnings, which otherwise go to the terminal and to a file in the working directory."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def _numbers(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def _inertial(inertial: Inertial | None) -> str:
    if inertial is None:
        return ""
    mass, center, central = inertial
    diagonal = np.diag(central)
    if np.array_equal(central, np.diag(diagonal)):
        about = f'diaginertia="{_numbers(diagonal)}"'
    else:
        about = f'fullinertia="{_numbers(np.array([*diagonal, central[0, 1], central[0, 2], central[1, 2]]))}"'
    return f'<inertial mass="{mass!r}" pos="{_numbers(center)}" {about}/>'


def _body(model: Model, part: Part, moving: bool) -> str:
    kind = "hinge" if part.kind == "revolute" else "slide"
    forces = f' damping="{part.damping!r}" stiffness="{part.stiffness!r}"' if moving else ""
    joint = f'<joint name="{part.name}" type="{kind}" axis="{_numbers(part.axis)}" armature="{part.armature!r}"{forces}/>'
    inner = "".join(_body(model, child, moving) for child in model.children(part.child))
    return f'<body pos="{_numbers(part.lever)}">{_inertial(part.inertial)}{joint}{inner}</body>'


def mjcf(model: Model, *, moving: bool = False) -> str:
    """The model as MJCF; with `moving`, including springs and damping, and without the reset of diverging states."""
    tree = "".join(_body(model, part, moving) for part in model.children(model.base))
    if model.floating:
        tree = f"<body>{_inertial(model.base_inertial)}<freejoint/>{tree}</body>"
    reset = ' autoreset="disable"' if moving else ""
    gravity = f'<option gravity="{_numbers(model.gravity)}"><flag constraint="disable"{reset}/></option>'
    return f"<mujoco>{COMPILER}{gravity}<worldbody>{tree}</worldbody></mujoco>"


def load(mujoco: Any, origin: Model, *, moving: bool = False) -> Any:
    """MuJoCo's model. Raises Refused with its message."""
    try:
        with quiet(mujoco):
            model = mujoco.MjModel.from_xml_string(mjcf(origin, moving=moving))
    except ValueError as error:
        raise Refused(str(error).partition("Element")[0].removeprefix("Error: ").strip()) from None
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint) for joint in range(model.njnt)]
    if names[1 if origin.floating else 0 :] != [part.name for part in origin.parts]:
        raise Refused("another order of the joints")
    return model


def solver(mujoco: Any, scene: Scene) -> Solver:
    """Forward dynamics. A free joint has its linear velocities, forces and accelerations in the world frame."""
    origin = read(scene)
    model = load(mujoco, origin)
    data = mujoco.MjData(model)

    def solve(q: Array, qd: Array, tau: Array) -> Array:
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, qd, tau
        if origin.floating:
            base = World.of(q, qd)
            data.qpos[3:7] = q[[6, 3, 4, 5]]
            data.qvel[:3], data.qfrc_applied[:3] = base.rotation @ qd[:3], base.rotation @ tau[:3]
        with quiet(mujoco):
            mujoco.mj_forward(model, data)
        qdd = np.array(data.qacc)
        if origin.floating:
            qdd[:3] = base.linear(qdd[:3])
        return qdd

    return solve
