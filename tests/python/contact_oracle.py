"""One step of one floating body with one contact in a given mode, as dense algebra from the definitions in mpmath, and
its derivatives by differences with 40 digits; shares no code with phipsi.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import mpmath as mp

DIGITS = 40
STEP = mp.mpf(10) ** -13


def vector(values: Any) -> Any:
    return mp.matrix([mp.mpf(value) if isinstance(value, mp.mpf) else mp.mpf(float(value)) for value in values])


def skew(a: Any) -> Any:
    return mp.matrix([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def cross(a: Any, b: Any) -> Any:
    return skew(a) * b


def dot(a: Any, b: Any) -> Any:
    return (a.T * b)[0]


def norm(a: Any) -> Any:
    return mp.sqrt(dot(a, a))


def exponential(w: Any) -> Any:
    angle = norm(w)
    if angle == 0:
        return mp.eye(3)
    return mp.eye(3) + mp.sin(angle) / angle * skew(w) + (1 - mp.cos(angle)) / angle**2 * skew(w) * skew(w)


def small_logarithm(turn: Any) -> Any:
    """The rotation vector of a small rotation, to second order."""
    return vector([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2


def rotation(q: Any) -> Any:
    x, y, z, w = (mp.mpf(float(value)) for value in q)
    s = 2 / (x * x + y * y + z * z + w * w)
    return mp.matrix(
        [
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
        ]
    )


@dataclass
class Body:
    """State, inertia, torque and contact; (linear, angular) in the axes of the body."""

    position: Any
    turn: Any
    velocity: Any
    torque: Any
    parameters: Any
    normal: Any
    offset: Any
    center: Any
    radius: Any
    friction: Any
    restitution: Any
    gravity: Any
    h: Any

    def moved(self, along: int, by: Any) -> Body:
        """The state displaced in its tangent space."""
        step = vector([by if i == along % 3 else mp.mpf(0) for i in range(3)])
        if along < 3:
            return replace(self, position=self.position + self.turn * step)
        return replace(self, turn=self.turn * exponential(step))

    def after(self, sticks: bool, rebounds: bool) -> tuple[Any, Any, Any]:
        """Position, rotation and velocity at the end of the step."""
        m, first = self.parameters[0], vector(self.parameters[1:4])
        xx, xy, yy, xz, yz, zz = self.parameters[4:]
        inertia = mp.matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        v, w, h, turn = vector(self.velocity[:3]), vector(self.velocity[3:]), self.h, self.turn
        mass = mp.matrix(6, 6)
        mass[:3, :3], mass[:3, 3:], mass[3:, :3], mass[3:, 3:] = m * mp.eye(3), -skew(first), skew(first), inertia
        down = turn.T * self.gravity
        bias = mp.matrix(6, 1)
        bias[:3] = m * cross(w, v) + cross(w, cross(w, first)) - m * down
        bias[3:] = cross(first, cross(w, v)) + cross(w, inertia * w) - cross(first, down)
        free = self.velocity + h * mp.lu_solve(mass, self.torque - bias)
        free[:3] = vector(free[:3]) + h * cross(w, v)
        n = self.normal
        gap = dot(n, self.position + turn * self.center) - self.radius - self.offset
        arm = self.center - self.radius * (turn.T * n)
        rows = mp.matrix(3, 6)
        rows[:, :3], rows[:, 3:] = turn, -turn * skew(arm)
        response = mp.inverse(mass) * rows.T
        g, along = rows * response, mp.eye(3) - n * n.T

        def law(c: Any, least: Any = None, target: Any = 0) -> Any:
            """The impulse, in the base frame, that satisfies the three equations of the mode."""

            def defect(*p: Any) -> Any:
                p = vector(p)
                u = g * p + c
                normal = dot(n, u) + target if least is None else dot(n, p) - least
                slip = along * u
                return list((slip if sticks else along * p + self.friction * dot(n, p) * slip / norm(slip)) + n * normal)

            start = -mp.lu_solve(g, c)
            if not sticks:
                normal = dot(n, start) if least is None else least
                slip = along * (c + normal * g * n)
                start = normal * (n - self.friction * slip / norm(slip))
            return vector(mp.findroot(defect, list(start), tol=mp.mpf(10) ** (10 - 2 * DIGITS), maxsteps=60))

        if rebounds:
            middle = rows * (self.velocity + free) / 2
            first_phase = law(middle)
            impulse = first_phase + law(middle + g * first_phase, least=self.restitution * dot(n, first_phase))
        else:
            impulse = law(rows * free, target=gap / h)
        end = free + response * impulse
        position, after = self.position + h * turn * vector(end[:3]), turn * exponential(h * vector(end[3:]))
        end[:3] = after.T * turn * vector(end[:3])
        return position, after, end

    def ends_at(self, velocity: Any, mode: tuple[bool, bool]) -> bool:
        """Whether the step in this mode ends with this velocity."""
        try:
            with mp.workdps(DIGITS):
                end = self.after(*mode)[2]
        except ValueError:  # no solution in this mode
            return False
        return max(abs(end[i] - mp.mpf(float(velocity[i]))) for i in range(6)) < 1e-9


def gradient(body: Body, mode: tuple[bool, bool], bars: tuple[Any, Any], changes: list[Callable[[Body, Any], Body]]) -> list[float]:
    """Derivatives, along the changes, of bars[0] . (tangent of the end) + bars[1] . (velocities at the end)."""
    with mp.workdps(DIGITS):
        position, turn, _ = body.after(*mode)
        by_q, by_v = vector(bars[0]), vector(bars[1])

        def value(changed: Body) -> Any:
            x, r, v = changed.after(*mode)
            tangent = list(turn.T * (x - position)) + list(small_logarithm(turn.T * r))
            return dot(by_q, vector(tangent)) + dot(by_v, v)

        return [float((value(change(body, STEP)) - value(change(body, -STEP))) / (2 * STEP)) for change in changes]
