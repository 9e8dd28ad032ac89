"""Drake: time derivatives of a continuous-time MultibodyPlant."""

from __future__ import annotations

from typing import Any

import numpy as np

from phipsi import Scene
from .model import Array, Inertial, Model, Refused, Solver, World, read


def _inertia(drake: Any, inertial: Inertial | None) -> Any:
    if inertial is None:
        return drake.SpatialInertia.Zero()
    mass, center, central = inertial
    rotational = drake.RotationalInertia(
        central[0, 0], central[1, 1], central[2, 2], central[0, 1], central[0, 2], central[1, 2]
    )
    # Raises for invalid values.
    return drake.SpatialInertia.MakeFromCentralInertia(mass, center, rotational)


def _plant(drake: Any, model: Model) -> tuple[Any, list[Any]]:
    """The plant, and the joints in the order of the scene."""
    plant = drake.MultibodyPlant(time_step=0.0)
    plant.mutable_gravity_field().set_gravity_vector(model.gravity)
    bodies = {model.base: plant.world_body()}
    joints = []
    if model.floating:
        base = plant.AddRigidBody(model.base, _inertia(drake, model.base_inertial))
        bodies[model.base] = base
        world = plant.world_frame()
        joints.append(plant.AddJoint(drake.QuaternionFloatingJoint("root_joint", world, base.body_frame())))
    for part in model.parts:
        body = plant.AddRigidBody(part.child, _inertia(drake, part.inertial))
        bodies[part.child] = body
        offset = drake.RigidTransform(part.lever)
        frame = plant.AddFrame(drake.FixedOffsetFrame(f"at_{part.name}", bodies[part.parent].body_frame(), offset))
        kind = drake.RevoluteJoint if part.kind == "revolute" else drake.PrismaticJoint
        joint = plant.AddJoint(kind(part.name, frame, body.body_frame(), part.axis))
        joints.append(joint)
        if part.armature:
            # Rotor inertia times the squared gear ratio, 1; its input is zero.
            plant.AddJointActuator(f"of_{part.name}", joint).set_default_rotor_inertia(part.armature)
    plant.Finalize()
    return plant, joints


def _message(error: Exception) -> str:
    """First sentence of the message, without Drake's source line."""
    text = " ".join(str(error).split())
    _, marker, after = text.partition("): ")
    text = after if marker else text
    return text.partition(". ")[0].rstrip(".")


def solver(drake: Any, scene: Scene) -> Solver:
    """Forward dynamics. A floating base has (angular, linear) velocities in the world frame, and coordinates (w, x, y,
    z, position).
    """
    origin = read(scene)
    try:
        plant, joints = _plant(drake, origin)
        context = plant.CreateDefaultContext()
    except (RuntimeError, ValueError) as error:
        raise Refused(_message(error)) from None
    port = plant.get_applied_generalized_force_input_port()
    at_q = np.concatenate([j.position_start() + np.arange(j.num_positions()) for j in joints])
    at_v = np.concatenate([j.velocity_start() + np.arange(j.num_velocities()) for j in joints])

    def solve(q: Array, qd: Array, tau: Array) -> Array:
        positions, rates, forces = np.empty_like(q), np.empty_like(qd), np.empty_like(tau)
        positions[at_q], rates[at_v], forces[at_v] = q, qd, tau
        if origin.floating:
            base = World.of(q, qd)
            positions[at_q[:7]] = q[[6, 3, 4, 5, 0, 1, 2]]
            for to, of in ((rates, qd), (forces, tau)):
                to[at_v[:6]] = np.concatenate([base.rotation @ of[3:6], base.rotation @ of[:3]])
        plant.SetPositions(context, positions)
        plant.SetVelocities(context, rates)
        port.FixValue(context, forces)
        try:
            derivatives = plant.EvalTimeDerivatives(context).CopyToVector()
        except RuntimeError as error:
            raise Refused(_message(error)) from None
        qdd: Array = derivatives[plant.num_positions() :][at_v]
        if origin.floating:
            qdd[:6] = np.concatenate([base.linear(qdd[3:6]), base.rotation.T @ qdd[:3]])
        return qdd

    return solve
