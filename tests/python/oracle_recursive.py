"""Forward dynamics of long trees in O(N) with 34 digits (mpmath), for a `Tree` with orthonormal rotations.

The oracle of `oracle_mpmath` is dense and limited to a dozen bodies; this one is for thousands. It uses body frames,
6 x 6 inertias and one step of elimination per degree of freedom; `test_long_chains` compares the two on small trees.
"""

from __future__ import annotations

import mpmath
import numpy as np
from oracle_mpmath import Joint, Link, Tree

CONTEXT = mpmath.mp.clone()
CONTEXT.dps = 34
mpf = CONTEXT.mpf
Entries = np.ndarray


def exact(values: object) -> Entries:
    doubles = np.asarray(values, dtype=float)
    return np.array([mpf(float(x)) for x in doubles.flat], dtype=object).reshape(doubles.shape)


def zeros(*shape: int) -> Entries:
    return np.full(shape, mpf(0), dtype=object)


def identity(n: int) -> Entries:
    return np.where(np.eye(n, dtype=bool), mpf(1), mpf(0)).astype(object)


def skew(a: Entries) -> Entries:
    o = mpf(0)
    return np.array([[o, -a[2], a[1]], [a[2], o, -a[0]], [-a[1], a[0], o]], dtype=object)


def turn(axis: Entries, angle: object) -> Entries:
    s = skew(axis)
    return identity(3) + s * CONTEXT.sin(angle) + (s @ s) * (1 - CONTEXT.cos(angle))


def orthonormal(doubles: Entries) -> Entries:
    """The rotation nearest to a matrix of doubles, by Newton's iteration for the polar factor."""
    found = exact(doubles)
    for _ in range(3):
        found = found @ (3 * identity(3) - found.T @ found) / 2
    return found


def of_quaternion(q: Entries) -> Entries:
    q = q / CONTEXT.sqrt(q @ q)
    v = skew(q[:3])
    return identity(3) + 2 * q[3] * v + 2 * (v @ v)


def motion(joint: Joint, q: Entries) -> tuple[Entries, Entries, Entries]:
    """Rotation and displacement of a joint, and the columns of its velocities in the child frame, (6, nv), angular
    first.
    """
    axis = exact(joint.axis)
    axis = axis / CONTEXT.sqrt(axis @ axis)
    columns = zeros(6, joint.nv)
    match joint.kind:
        case "revolute" | "continuous":
            columns[:3, 0] = axis
            return turn(axis, q[0]), zeros(3), columns
        case "prismatic":
            columns[3:, 0] = axis
            return identity(3), axis * q[0], columns
        case "screw":
            columns[:3, 0], columns[3:, 0] = axis, axis * mpf(joint.pitch)
            return turn(axis, q[0]), axis * (mpf(joint.pitch) * q[0]), columns
        case "spherical":
            columns[:3] = identity(3)
            return of_quaternion(q), zeros(3), columns
        case "floating":
            columns[3:, :3] = columns[:3, 3:] = identity(3)
            return of_quaternion(q[3:]), q[:3], columns
        case kind:
            assert kind == "fixed"
            return identity(3), zeros(3), columns


def shift(rotation: Entries, lever: Entries) -> Entries:
    """phi: forces on the child, at the parent."""
    found = zeros(6, 6)
    found[:3, :3] = found[3:, 3:] = rotation
    found[:3, 3:] = skew(lever) @ rotation
    return found


def crossed(v: Entries) -> Entries:
    """v x for motions; for forces it is minus the transpose."""
    found = zeros(6, 6)
    found[:3, :3] = found[3:, 3:] = skew(v[:3])
    found[3:, :3] = skew(v[3:])
    return found


def inertia_of(link: Link) -> Entries:
    """About the link origin, (6, 6)."""
    mass, com, found = mpf(link.mass), skew(exact(link.com)), zeros(6, 6)
    found[:3, :3] = exact(link.inertia) - com @ com * mass
    found[:3, 3:], found[3:, :3] = com * mass, -com * mass
    found[3:, 3:] = identity(3) * mass
    return found


def forward_dynamics(tree: Tree, q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> Entries:
    """Joint accelerations, (nv) mpf. Only vectors are stored per body: 100,000 bodies fit into a gigabyte."""
    q, qd, tau = exact(q), exact(qd), exact(tau)
    links = {link.name: link for link in tree.links}
    joints = tree.order if tree.floating_base else tree.joints
    place = {"" if tree.floating_base else tree.links[0].name: -1}
    parents, rows, moved, columns, velocities, coriolis = ([] for _ in range(6))
    at_q = at_v = 0
    for k, joint in enumerate(joints):
        rotation, along, s = motion(joint, q[at_q : at_q + joint.nq])
        origin = orthonormal(joint.rotation)
        moved.append((origin @ rotation, exact(joint.xyz) + origin @ along))
        parents.append(place[joint.parent])
        place[joint.child] = k
        relative = s @ qd[at_v : at_v + joint.nv] if joint.nv else zeros(6)
        velocity = relative + (shift(*moved[k]).T @ velocities[parents[k]] if parents[k] >= 0 else zeros(6))
        rows.append(at_v)
        columns.append(s)
        velocities.append(velocity)
        coriolis.append(crossed(velocity) @ relative)
        at_q, at_v = at_q + joint.nq, at_v + joint.nv
    arrived: dict[int, tuple[Entries, Entries]] = {}
    steps: list[list[tuple[int, Entries, Entries, object]]] = [[] for _ in parents]
    for k in reversed(range(len(parents))):
        own = inertia_of(links[joints[k].child])
        inertia, force = arrived.pop(k, (zeros(6, 6), zeros(6)))
        force = force - crossed(velocities[k]).T @ (own @ velocities[k])
        inertia = inertia + own
        # Velocity-dependent acceleration, before that of the joint.
        force = force + inertia @ coriolis[k]
        for i in reversed(range(columns[k].shape[1])):
            h, row = columns[k][:, i], rows[k] + i
            gain = inertia @ h
            pivot = h @ gain + mpf(joints[k].armature)
            left = tau[row] - h @ force
            inertia = inertia - np.outer(gain, gain) / pivot
            force = force + gain * (left / pivot)
            steps[k].append((row, h, gain / pivot, left / pivot))
        if (parent := parents[k]) >= 0:
            phi = shift(*moved[k])
            before = arrived.get(parent, (zeros(6, 6), zeros(6)))
            arrived[parent] = (before[0] + phi @ inertia @ phi.T, before[1] + phi @ force)
    base = zeros(6)
    base[3:] = -exact(tree.gravity)
    found, accelerations = zeros(len(tau)), []
    for k, parent in enumerate(parents):
        a = shift(*moved[k]).T @ (accelerations[parent] if parent >= 0 else base)
        for row, h, gain, left in reversed(steps[k]):
            found[row] = left - gain @ a
            a = a + h * found[row]
        accelerations.append(a + coriolis[k])
    return found
