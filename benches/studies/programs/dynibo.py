"""dynibo: `forward_dynamics` of a URDF file. Its gravity is fixed, and URDF has no armature."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from phipsi import Scene
from .model import Array, Inertial, Model, Refused, Solver, World, read

#: Standard gravity, m/s^2, which dynibo uses and which cannot be changed.
GRAVITY = (0.0, 0.0, -9.80665)


def _numbers(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def _link(name: str, inertial: Inertial | None) -> str:
    if inertial is None:
        return f'<link name="{name}"/>'
    mass, center, central = inertial
    entries = " ".join(
        f'i{"xyz"[row]}{"xyz"[column]}="{float(central[row, column])!r}"'
        for row in range(3)
        for column in range(row, 3)
    )
    return (
        f'<link name="{name}"><inertial><origin xyz="{_numbers(center)}" rpy="0 0 0"/><mass value="{mass!r}"/>'
        f"<inertia {entries}/></inertial></link>"
    )


def urdf(model: Model) -> str:
    """The model as URDF, with joints without limits, because positions are not compared with them."""
    lines = [_link(model.base, model.base_inertial)]
    for part in model.parts:
        kind = "continuous" if part.kind == "revolute" else part.kind
        lines.append(_link(part.child, part.inertial))
        lines.append(
            f'<joint name="{part.name}" type="{kind}"><parent link="{part.parent}"/><child link="{part.child}"/>'
            f'<origin xyz="{_numbers(part.lever)}" rpy="0 0 0"/><axis xyz="{_numbers(part.axis)}"/>'
            '<limit lower="-1e30" upper="1e30" effort="1e30" velocity="1e30"/></joint>'
        )
    return '<robot name="scene">\n' + "\n".join(lines) + "\n</robot>\n"


def _order(model: Model) -> list[int]:
    """Order of the joints in dynibo: breadth first, siblings in file order. It has no names for a check."""
    order, links = [], [model.base]
    while links:
        link = links.pop(0)
        for index, part in enumerate(model.parts):
            if part.parent == link:
                order.append(index)
                links.append(part.child)
    return order


def solver(dynibo: Any, scene: Scene) -> Solver:
    """Forward dynamics. A floating base has (angular, linear) velocities in the world frame."""
    origin = read(scene)
    if tuple(origin.gravity) != GRAVITY:
        raise Refused(f"gravity is {GRAVITY} there")
    if any(part.armature for part in origin.parts):
        raise Refused("a URDF has no armature")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.urdf"
        path.write_text(urdf(origin), encoding="utf-8")
        try:
            robot = (dynibo.FloatingRobot if origin.floating else dynibo.Robot).from_urdf(path)
        except dynibo.DyniboError as error:
            raise Refused(str(error)) from None
    order = np.array(_order(origin))
    first = 6 if origin.floating else 0

    def solve(q: Array, qd: Array, tau: Array) -> Array:
        joints = q[7 if origin.floating else 0 :][order], qd[first:][order], tau[first:][order]
        qdd = np.empty_like(qd)
        try:
            if not origin.floating:
                qdd[order] = robot.forward_dynamics(*joints)
                return qdd
            base = World.of(q, qd)
            state = dynibo.BaseState(
                frame=dynibo.Pose(translation=tuple(q[:3]), rotation_xyzw=tuple(q[3:7])),
                velocity=dynibo.Twist(angular=tuple(base.rotation @ qd[3:6]), linear=tuple(base.rotation @ qd[:3])),
            )
            forces = np.concatenate([base.rotation @ tau[3:6], base.rotation @ tau[:3], joints[2]])
            found = robot.forward_dynamics(state, joints[0], joints[1], forces)
        except dynibo.DyniboError as error:
            raise Refused(str(error)) from None
        qdd[:3], qdd[3:6] = base.linear(found[3:6]), base.rotation.T @ found[:3]
        qdd[6 + order] = found[6:]
        return qdd

    return solve
