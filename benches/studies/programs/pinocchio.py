"""Pinocchio: `aba` of its own model, in either convention."""

from __future__ import annotations

from typing import Any

import numpy as np

from phipsi import Scene
from .model import Array, Refused, Solver, read


def load(pin: Any, scene: Scene) -> Any:
    """Pinocchio's model of the scene."""
    origin = read(scene)
    model = pin.Model()
    model.gravity.linear[:] = origin.gravity
    here = pin.SE3.Identity()
    at = {origin.base: 0}
    if origin.floating:
        at[origin.base] = model.addJoint(0, pin.JointModelFreeFlyer(), here, "root_joint")
        if origin.base_inertial is not None:
            model.appendBodyToJoint(at[origin.base], pin.Inertia(*origin.base_inertial), here)
    coordinate = {
        "revolute": (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ, pin.JointModelRevoluteUnaligned),
        "prismatic": (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ, pin.JointModelPrismaticUnaligned),
    }
    for part in origin.parts:
        along = np.flatnonzero(part.axis)
        of_kind = coordinate[part.kind]
        joint = of_kind[along[0]]() if len(along) == 1 else of_kind[3](*part.axis)
        at[part.child] = model.addJoint(at[part.parent], joint, pin.SE3(np.eye(3), part.lever), part.name)
        if part.inertial is not None:
            model.appendBodyToJoint(at[part.child], pin.Inertia(*part.inertial), here)
    if list(model.names)[1:] != list(scene.joint_names):
        raise Refused("another order of the joints")
    model.armature = np.array(scene.armature)
    return model


def solver(pin: Any, convention: Any, scene: Scene) -> Solver:
    """Forward dynamics in that convention."""
    model = load(pin, scene)
    data = model.createData()

    def solve(q: Array, qd: Array, tau: Array) -> Array:
        return np.array(pin.aba(model, data, q, qd, tau, convention))

    return solve
