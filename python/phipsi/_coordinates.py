"""Configurations as independent real values, for libraries that differentiate with respect to each entry.

A configuration is normalized before it is used, so that every function of it is defined for all values of its
entries.
Coordinates with one axis are their own tangents. A quaternion (x, y, z, w) = (v, s) has the tangent
2 (s dv + dv x v - v ds) / |q|^2 in the child frame, and the position of a free joint has the tangent R^T dp.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ._chart import by_quaternion, skew

if TYPE_CHECKING:
    from ._core import Scene

Array = NDArray[np.float64]

#: Angle, rad, below which the right Jacobian is computed by its series, because the closed form suffers from cancellation.
SMALL = 0.5
#: Number of terms of the series; the next term is below 1e-17.
TERMS = 14


def rotation(quaternion: Array) -> Array:
    """Rotation matrices of quaternions (x, y, z, w) of any norm, (..., 4) to (..., 3, 3)."""
    return np.swapaxes(by_quaternion(quaternion[..., None, :], np.eye(3)), -1, -2)


def rotation_vector(matrix: Array) -> Array:
    """Rotation vectors of rotation matrices, (..., 3, 3) to (..., 3): the axis times an angle from 0 to pi."""
    m = matrix
    # The row of the largest entry of 4 (x, y, z, w)(x, y, z, w)^T suffers the least from cancellation.
    trace = np.trace(m, axis1=-2, axis2=-1)
    diagonal = np.diagonal(m, axis1=-2, axis2=-1)
    lower = [m[..., 2, 1], m[..., 0, 2], m[..., 1, 0]]
    upper = [m[..., 1, 2], m[..., 2, 0], m[..., 0, 1]]
    w = [one - other for one, other in zip(lower, upper, strict=True)]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    square = [1.0 - trace + 2.0 * diagonal[..., i] for i in range(3)] + [1.0 + trace]
    rows = [[square[0], xy, xz, w[0]], [xy, square[1], yz, w[1]], [xz, yz, square[2], w[2]], [*w, square[3]]]
    table = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    largest = np.stack(square, axis=-1).argmax(axis=-1)
    quaternion = np.take_along_axis(table, largest[..., None, None], axis=-2)[..., 0, :]
    quaternion = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    quaternion = np.where(quaternion[..., 3:] < 0.0, -quaternion, quaternion)
    sine = np.linalg.norm(quaternion[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, quaternion[..., 3:])
    return np.asarray(np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 2.0) * quaternion[..., :3])


def right_jacobian(a: Array, angle: Array) -> Array:
    """Sum of a^i / (i + 1)!, for -a the matrix of a Lie bracket of a rotation by this angle, with or without a
    translation: (..., n, n), n = 3 or 6.
    """
    identity = np.eye(a.shape[-1])
    series = np.broadcast_to(identity, a.shape)
    for i in range(TERMS, 1, -1):
        series = identity + a @ series / i
    f = np.where(angle < SMALL, 1.0, angle)[..., None, None]
    sin, cos = np.sin(f), np.cos(f)
    once = (4 - f * sin - 4 * cos) / (2 * f**2)
    twice = (4 * f - 5 * sin + f * cos) / (2 * f**3)
    thrice = (2 - f * sin - 2 * cos) / (2 * f**4)
    last = (2 * f - 3 * sin + f * cos) / (2 * f**5)
    closed = identity + a @ (once * identity + a @ (twice * identity + a @ (thrice * identity + a * last)))
    return np.where((angle < SMALL)[..., None, None], series, closed)


class Coordinates:
    """Entries of the quaternions of a scene, and conversions between changes of q and tangents."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        #: (quaternion, angular) of every spherical and free joint: slices of q and v.
        self.turns: list[tuple[slice, slice]] = []
        #: (position, quaternion, linear, angular) of every free joint.
        self.moves: list[tuple[slice, slice, slice, slice]] = []
        #: Slices of q and v in order, and whether they are those of a quaternion: of each spherical and free joint, and
        #: of all other joints between them.
        self._parts: list[tuple[slice, slice, bool]] = []
        plain: list[tuple[int, int]] = []
        for joint in scene.joint_names:
            q, v = scene.q_index(joint), scene.v_index(joint)
            if q.stop - q.start == 4:
                self.turns.append((slice(q.start, q.stop), slice(v.start, v.stop)))
            elif q.stop - q.start == 7:
                turn, angular = slice(q.start + 3, q.stop), slice(v.start + 3, v.stop)
                self.turns.append((turn, angular))
                self.moves.append((slice(q.start, q.start + 3), turn, slice(v.start, v.start + 3), angular))
            else:
                plain.extend(zip(range(q.start, q.stop), range(v.start, v.stop), strict=True))
            turns, begin = q.stop - q.start != v.stop - v.start, (q.start, v.start)
            if self._parts and not (turns or self._parts[-1][2]):
                last_q, last_v, _ = self._parts.pop()
                begin = (last_q.start, last_v.start)
            self._parts.append((slice(begin[0], q.stop), slice(begin[1], v.stop), turns))
        self._plain = tuple(np.array(plain, dtype=np.intp).reshape(-1, 2).T)

    def normalized(self, q: Any, xp: Any = np) -> Any:
        """The configurations with unit quaternions, (..., nq). Zero and infinite quaternions are unchanged, so that the
        scene reports them. xp: numpy or jax.numpy.
        """
        q = np.array(q, dtype=np.float64) if xp is np else q
        if not self.turns:
            return q
        parts = []
        for in_q, _, turns in self._parts:
            part = q[..., in_q]
            if turns:
                norm = xp.linalg.norm(part[..., -4:], axis=-1, keepdims=True)
                unit = part[..., -4:] / xp.where((norm > 0) & (norm < np.inf), norm, 1.0)
                part = xp.concatenate([part[..., :-4], unit], axis=-1)
            parts.append(part)
        return xp.concatenate(parts, axis=-1)

    def by_entries(self, q: Any, by_tangent: Any, xp: Any = np) -> Any:
        """Derivatives by the entries of q, (..., n, nq), from those by its tangent, (..., n, nv), for q with quaternions
        of any norm. xp: numpy or jax.numpy.
        """
        if not self.turns:
            return by_tangent
        parts = []
        for in_q, in_v, turns in self._parts:
            rows = by_tangent[..., in_v]
            if not turns:
                parts.append(rows)
                continue
            turn, angular = q[..., None, in_q][..., -4:], rows[..., -3:]
            # A zero quaternion has no tangent: its results are NaN or have raised before.
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                norm = xp.linalg.norm(turn, axis=-1, keepdims=True)
                v, s = turn[..., :3] / norm, turn[..., 3:] / norm
                by_turn = [s * angular - xp.cross(angular, v), -xp.sum(angular * v, axis=-1, keepdims=True)]
                by_turn = [2.0 * one / norm for one in by_turn]
            if rows.shape[-1] == 6:
                # R times the row: the tangent of a position is R^T dp.
                linear = rows[..., :3]
                across = 2.0 * xp.cross(xp.broadcast_to(v, linear.shape), linear)
                by_turn = [linear + s * across + xp.cross(xp.broadcast_to(v, linear.shape), across), *by_turn]
            parts.append(xp.concatenate(by_turn, axis=-1))
        return xp.concatenate(parts, axis=-1)

    def changes(self, q: Array) -> Array:
        """E with dq = E tangent, (..., nq, nv), for normalized configurations: T E = 1."""
        e = np.zeros((*q.shape[:-1], self.scene.nq, self.scene.nv))
        in_q, in_v = self._plain
        e[..., in_q, in_v] = 1.0
        for turn, angular in self.turns:
            v, s = q[..., turn][..., :3], q[..., turn][..., 3, None, None]
            e[..., turn, angular] = 0.5 * np.concatenate([s * np.eye(3) + skew(v), -v[..., None, :]], axis=-2)
        for place, turn, linear, _ in self.moves:
            e[..., place, linear] = rotation(q[..., turn])
        return e

    def integrated(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Derivatives of q (+) v, (..., nq, nq) and (..., nq, nv), with respect to the entries of q and v, for q with
        quaternions of any norm.
        """
        batch = np.broadcast_shapes(q.shape[:-1], v.shape[:-1])
        q, v = np.broadcast_to(q, (*batch, self.scene.nq)), np.broadcast_to(v, (*batch, self.scene.nv))
        along, by_v = np.zeros((2, *batch, self.scene.nv, self.scene.nv))
        both = np.arange(self.scene.nv)
        along[..., both, both] = by_v[..., both, both] = 1.0
        free = {angular.start for *_, angular in self.moves}
        blocks = [(angular, -skew(v[..., angular])) for _, angular in self.turns if angular.start not in free]
        for _, _, linear, angular in self.moves:
            turning, moving = -skew(v[..., angular]), -skew(v[..., linear])
            # Order: (linear, angular).
            bracket = np.block([[turning, moving], [np.zeros_like(turning), turning]])
            blocks.append((slice(linear.start, angular.stop), bracket))
        for rows, a in blocks:
            angle = np.linalg.norm(v[..., rows][..., -3:], axis=-1)
            jacobian = right_jacobian(a, angle)
            along[..., rows, rows] = np.eye(a.shape[-1]) + a @ jacobian
            by_v[..., rows, rows] = jacobian
        end = self.changes(self.scene.integrate(self.normalized(q), v))
        return self.by_entries(q, end @ along), end @ by_v
