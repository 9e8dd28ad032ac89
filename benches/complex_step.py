"""Forward dynamics of an arm with revolute joints in NumPy, for real and complex values, for complex-step
differentiation; phipsi supports only real values.

Newton-Euler for the bias and for the columns of M, then a dense solution. No value is conjugated.
"""

from typing import Any

import numpy as np

import phipsi

Array = np.ndarray[Any, Any]


class Arm:
    """Constants of a scene that is a chain of revolute joints."""

    def __init__(self, scene: phipsi.Scene) -> None:
        joints, links = scene.joints, scene.links
        self.joints = [joints[name] for name in scene.joint_names]
        self.links = [links[joint.child] for joint in self.joints]
        if any(joint.type not in ("revolute", "continuous") for joint in self.joints):
            raise ValueError("an arm of revolute joints is expected")
        self.gravity = scene.gravity

    def torques(self, q: Array, qd: Array, qdd: Array, gravity: Array) -> Array:
        """Inverse dynamics, (..., nv), by an outward and an inward sweep."""
        shape = np.broadcast_shapes(q.shape, qd.shape, qdd.shape)
        q, qd, qdd = (np.broadcast_to(one, shape).astype(np.result_type(q, qd, qdd)) for one in (q, qd, qdd))
        zero = np.zeros((*shape[:-1], 3), q.dtype)
        w, dw, a = zero, zero, zero - gravity
        kept = []
        for i, (joint, link) in enumerate(zip(self.joints, self.links, strict=True)):
            turn = joint.rotation @ rotation(joint.axis, q[..., i])
            a = a + np.cross(dw, joint.xyz) + np.cross(w, np.cross(w, joint.xyz))
            w, dw, a = (np.einsum("...ji,...j->...i", turn, one) for one in (w, dw, a))
            rate = joint.axis * qd[..., i, None]
            w = w + rate
            dw = dw + joint.axis * qdd[..., i, None] + np.cross(w, rate)
            force = link.mass * (a + np.cross(dw, link.com) + np.cross(w, np.cross(w, link.com)))
            moment = dw @ link.inertia + np.cross(w, w @ link.inertia) + np.cross(link.com, force)
            kept.append((turn, force, moment))
        tau = np.empty(shape, q.dtype)
        force, moment = zero, zero
        for i in reversed(range(len(self.joints))):
            joint, (turn, own_force, own_moment) = self.joints[i], kept[i]
            force, moment = force + own_force, moment + own_moment
            tau[..., i] = moment @ joint.axis + joint.armature * qdd[..., i]
            force, moment = (np.einsum("...ij,...j->...i", turn, one) for one in (force, moment))
            moment = moment + np.cross(joint.xyz, force)
        return tau

    def accelerations(self, q: Array, qd: Array, tau: Array) -> Array:
        """Forward dynamics, (..., nv)."""
        nv = len(self.joints)
        bias = self.torques(q, qd, np.zeros(nv), self.gravity)
        mass = self.torques(q[..., None, :], np.zeros(nv), np.eye(nv), np.zeros(3))
        return np.linalg.solve(np.swapaxes(mass, -1, -2), (tau - bias)[..., None])[..., 0]

    def by_configuration(self, q: Array, qd: Array, tau: Array, step: float = 1e-100) -> Array:
        """dqdd/dq, (..., nv, nv), one complex step per column: without a difference, and therefore without
        cancellation.
        """
        moved = q[..., None, :] + 1j * step * np.eye(len(self.joints))
        return np.swapaxes(self.accelerations(moved, qd[..., None, :], tau[..., None, :]).imag / step, -1, -2)


def rotation(axis: Array, angle: Array) -> Array:
    """Rotation about a unit vector, (..., 3, 3): the columns are the rotated axes."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)
