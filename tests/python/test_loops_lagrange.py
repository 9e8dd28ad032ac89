"""Closed loops compared with Lagrange's equations in minimal coordinates, by mpmath with 60 digits.

The oracle has the pose of every body as an explicit function of the independent angles: closed loops are solved by
the intersection of two circles, and no constraint force occurs. Its derivatives are central differences with a step of
1e-20, whose error is below 30 digits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import phipsi
import pytest
from oracle_mpmath import CONTEXT, mpf
from tolerances import FAR, assert_near, of_order, recursion

STEP = mpf(10) ** -20
GRAVITY = 9.81
Coordinates = Callable[[Sequence[Any]], list[Any]]


class Bar(NamedTuple):
    """A body that moves in the plane y = 0: mass, center of mass (x, z) and moment of inertia about it."""

    mass: float
    com: tuple[float, float]
    inertia: float


CRANK, COUPLER = Bar(1.3, (0.02, 0.1), 0.011), Bar(0.8, (-0.03, 0.25), 0.031)
ROCKER, PISTON = Bar(1.7, (0.01, 0.22), 0.043), Bar(0.9, (0.04, 0.03), 0.01)
#: Lengths of crank, coupler and rocker, and the distance of the two pivots on the ground, m.
R, L, C, D = 0.2, 0.5, 0.4, 0.45


class Mechanism(NamedTuple):
    scene: phipsi.Scene
    coordinates: Coordinates
    """The joint coordinates of the tree as functions of the independent angles."""
    poses: Callable[[Sequence[Any]], list[tuple[Bar, Any, Any, Any]]]
    """Of every body: the position (x, z) of its joint frame and its angle about y, as functions of the joint coordinates."""


def add(builder: phipsi.SceneBuilder, name: str, parent: str, at: tuple[float, float], bar: Bar, kind: str = "continuous") -> None:
    limits = {"lower": -9, "upper": 9, "velocity": 99, "effort": 99} if kind == "prismatic" else {}
    axis = (1, 0, 0) if kind == "prismatic" else (0, 1, 0)
    builder.link(name, mass=bar.mass, com=(bar.com[0], 0, bar.com[1]), inertia=bar.inertia * np.diag([1, 1, 0.5]))
    builder.joint(name, kind, parent, name, xyz=(at[0], 0, at[1]), axis=axis, **limits)


def end(x: Any, z: Any, angle: Any, length: float) -> tuple[Any, Any]:
    """The far end of a bar that begins at (x, z)."""
    return x + length * CONTEXT.sin(angle), z + length * CONTEXT.cos(angle)


def meet(a: tuple[Any, Any], ra: float, b: tuple[Any, Any], rb: float) -> tuple[Any, Any]:
    """An intersection of the circles about a and b."""
    x, z, ra, rb = b[0] - a[0], b[1] - a[1], mpf(ra), mpf(rb)
    square = x * x + z * z
    along = (square + ra * ra - rb * rb) / (2 * square)
    across = CONTEXT.sqrt(ra * ra / square - along * along)
    return a[0] + along * x - across * z, a[1] + along * z + across * x


def angle(a: tuple[Any, Any], b: tuple[Any, Any]) -> Any:
    return CONTEXT.atan2(b[0] - a[0], b[1] - a[1])


def four_bar(kind: str) -> Mechanism:
    """A crank and rocker; the crank can rotate fully."""
    builder = phipsi.SceneBuilder().link("ground")
    add(builder, "crank", "ground", (0, 0), CRANK)
    add(builder, "coupler", "crank", (0, R), COUPLER)
    add(builder, "rocker", "ground", (D, 0), ROCKER)
    axis = {"axis": (0, 1, 0)} if kind == "axis" else {}
    builder.connect("pin", kind, "coupler", "rocker", xyz=(0, 0, L), other_xyz=(0, 0, C), **axis)
    ground = (mpf(D), mpf(0))

    def coordinates(free: Sequence[Any]) -> list[Any]:
        tip = end(mpf(0), mpf(0), free[0], R)
        pin = meet(tip, L, ground, C)
        return [free[0], angle(tip, pin) - free[0], angle(ground, pin)]

    def poses(q: Sequence[Any]) -> list[tuple[Bar, Any, Any, Any]]:
        tip = end(mpf(0), mpf(0), q[0], R)
        return [(CRANK, mpf(0), mpf(0), q[0]), (COUPLER, *tip, q[0] + q[1]), (ROCKER, *ground, q[2])]

    return Mechanism(builder.build(), coordinates, poses)


def rod() -> Mechanism:
    """A crank and a rocker that a rod without mass connects."""
    builder = phipsi.SceneBuilder().link("ground")
    add(builder, "crank", "ground", (0, 0), CRANK)
    add(builder, "rocker", "ground", (D, 0), ROCKER)
    builder.connect("rod", "rod", "crank", "rocker", xyz=(0, 0, R), other_xyz=(0, 0, C), length=L)
    ground = (mpf(D), mpf(0))

    def coordinates(free: Sequence[Any]) -> list[Any]:
        return [free[0], angle(ground, meet(end(mpf(0), mpf(0), free[0], R), L, ground, C))]

    def poses(q: Sequence[Any]) -> list[tuple[Bar, Any, Any, Any]]:
        return [(CRANK, mpf(0), mpf(0), q[0]), (ROCKER, *ground, q[1])]

    return Mechanism(builder.build(), coordinates, poses)


def slider_crank() -> Mechanism:
    builder = phipsi.SceneBuilder().link("ground")
    add(builder, "crank", "ground", (0, 0), CRANK)
    add(builder, "coupler", "crank", (0, R), COUPLER)
    add(builder, "piston", "ground", (0, 0), PISTON, "prismatic")
    builder.connect("pin", "axis", "coupler", "piston", xyz=(0, 0, L), other_xyz=(0, 0, 0), axis=(0, 1, 0))

    def coordinates(free: Sequence[Any]) -> list[Any]:
        tip = end(mpf(0), mpf(0), free[0], R)
        slide = tip[0] + CONTEXT.sqrt(mpf(L) ** 2 - tip[1] ** 2)
        return [free[0], angle(tip, (slide, mpf(0))) - free[0], slide]

    def poses(q: Sequence[Any]) -> list[tuple[Bar, Any, Any, Any]]:
        tip = end(mpf(0), mpf(0), q[0], R)
        return [(CRANK, mpf(0), mpf(0), q[0]), (COUPLER, *tip, q[0] + q[1]), (PISTON, q[2], mpf(0), mpf(0))]

    return Mechanism(builder.build(), coordinates, poses)


def five_bar() -> Mechanism:
    """Two cranks and two couplers: two degrees of freedom."""
    builder = phipsi.SceneBuilder().link("ground")
    add(builder, "crank", "ground", (0, 0), CRANK)
    add(builder, "coupler", "crank", (0, R), COUPLER)
    add(builder, "other_crank", "ground", (D, 0), PISTON)
    add(builder, "other_coupler", "other_crank", (0, R), ROCKER)
    builder.connect("pin", "point", "coupler", "other_coupler", xyz=(0, 0, L), other_xyz=(0, 0, C))
    ground = (mpf(D), mpf(0))

    def coordinates(free: Sequence[Any]) -> list[Any]:
        tip, other = end(mpf(0), mpf(0), free[0], R), end(*ground, free[1], R)
        pin = meet(tip, L, other, C)
        return [free[0], angle(tip, pin) - free[0], free[1], angle(other, pin) - free[1]]

    def poses(q: Sequence[Any]) -> list[tuple[Bar, Any, Any, Any]]:
        tip, other = end(mpf(0), mpf(0), q[0], R), end(*ground, q[2], R)
        return [(CRANK, mpf(0), mpf(0), q[0]), (COUPLER, *tip, q[0] + q[1]), (PISTON, *ground, q[2]), (ROCKER, *other, q[2] + q[3])]

    return Mechanism(builder.build(), coordinates, poses)


MECHANISMS: dict[str, tuple[Callable[[], Mechanism], int]] = {
    "four-bar, axis": (lambda: four_bar("axis"), 1),
    "four-bar, point": (lambda: four_bar("point"), 1),
    "rod": (rod, 1),
    "slider-crank": (slider_crank, 1),
    "five-bar": (five_bar, 2),
}


def bodies(mechanism: Mechanism, free: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Weights (mass, mass, inertia) and coordinates (x, z of the center of mass, angle) of all bodies."""
    weights, found = [], []
    for bar, x, z, turn in mechanism.poses(mechanism.coordinates(free)):
        sine, cosine, (cx, cz) = CONTEXT.sin(turn), CONTEXT.cos(turn), bar.com
        weights += [mpf(bar.mass), mpf(bar.mass), mpf(bar.inertia)]
        found += [x + cosine * cx + sine * cz, z - sine * cx + cosine * cz, turn]
    return np.array(weights), np.array(found)


def directional(function: Callable[[np.ndarray], np.ndarray], at: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first and the second derivative in a direction."""
    back, here, front = (function(at + k * STEP * along) for k in (-1, 0, 1))
    return (front - back) / (2 * STEP), (front - 2 * here + back) / STEP**2


def lagrange(mechanism: Mechanism, free: np.ndarray, rates: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Joint coordinates, velocities and accelerations in double precision: X^T W (X a + x'') = Q^T tau - X^T weight."""
    n = len(free)

    def tree(at: np.ndarray) -> np.ndarray:
        return np.array(mechanism.coordinates(at))

    def body(at: np.ndarray) -> np.ndarray:
        return bodies(mechanism, at)[1]

    units = [np.array([mpf(i == k) for k in range(n)]) for i in range(n)]
    columns, joints = (np.stack([directional(function, free, unit)[0] for unit in units], axis=1) for function in (body, tree))
    weights = bodies(mechanism, free)[0]
    load = weights * directional(body, free, rates)[1]
    load[1::3] += weights[1::3] * mpf(GRAVITY)
    mass, force = columns.T @ (weights[:, None] * columns), joints.T @ tau - columns.T @ load
    acceleration = np.array(list(CONTEXT.lu_solve(CONTEXT.matrix(mass.tolist()), CONTEXT.matrix(force.tolist()))))
    qdd = joints @ acceleration + directional(tree, free, rates)[1]
    return tree(free).astype(float), (joints @ rates).astype(float), qdd.astype(float)


@pytest.mark.parametrize("name", MECHANISMS)
def test_accelerations_are_those_of_lagrange(name: str) -> None:
    make, mobility = MECHANISMS[name]
    mechanism, random = make(), np.random.default_rng(0)
    n = mechanism.scene.nv
    for _ in range(4):
        free = np.array([mpf(x) for x in random.uniform([-1.0, 0.5][:mobility], [1.5, 1.2][:mobility])])
        rates = np.array([mpf(x) for x in random.uniform(-4, 4, mobility)])
        tau = random.uniform(-1, 1, n)
        q, qd, expected = lagrange(mechanism, free, rates, np.array([mpf(x) for x in tau]))
        assert_near(mechanism.scene.loops.error(q), np.zeros(len(mechanism.scene.loops.error(q))), recursion(n, 1.0))
        found = mechanism.scene.loops.dynamics(q, qd, tau)
        assert n - found.rank == mobility
        assert_near(found.qdd, expected, recursion(n, float(np.max(np.abs(expected)))))


def full_turn(mechanism: Mechanism, start: float, rate: float) -> float:
    """Time of one rotation of the crank without torques, s.

    From conservation of energy, dt = d(angle) sqrt(m / (2 (E - V))). The integrand is periodic and smooth, so the
    trapezoidal rule converges geometrically.
    """

    def terms(at: Any) -> tuple[Any, Any]:
        weights, here = bodies(mechanism, [at])
        slope = (bodies(mechanism, [at + STEP])[1] - bodies(mechanism, [at - STEP])[1]) / (2 * STEP)
        return sum(weights * slope * slope), mpf(GRAVITY) * sum(weights[1::3] * here[1::3])

    mass, potential = terms(mpf(start))
    energy, found = mass * mpf(rate) ** 2 / 2 + potential, []
    for count in (128, 256):
        values = [terms(mpf(start) + 2 * CONTEXT.pi * k / count) for k in range(count)]
        found.append(2 * CONTEXT.pi / count * sum(CONTEXT.sqrt(m / (2 * (energy - v))) for m, v in values))
    assert abs(found[1] - found[0]) <= mpf(10) ** -18
    return float(found[1])


@pytest.mark.parametrize("name", ["four-bar, point", "rod", "slider-crank"])
def test_a_turn_of_the_crank_takes_the_time_from_the_energy_and_ends_where_it_began(name: str) -> None:
    """By a method of order 4, with an error that decreases by at least 2^3.5 per halving."""
    mechanism, start, rate = MECHANISMS[name][0](), 0.4, 8.0
    duration = full_turn(mechanism, start, rate)
    q, qd, _ = lagrange(mechanism, np.array([mpf(start)]), np.array([mpf(rate)]), np.array([mpf(0)] * mechanism.scene.nv))
    errors = []
    for steps in (400, 800, 1600):
        path = mechanism.scene.simulate(q, qd, dt=duration / steps, steps=steps, limits="report")
        assert path.integrator == "rk4" and path.drift.max() <= FAR
        errors.append([abs(path.q[-1, 0] - q[0] - 2 * np.pi), np.max(np.abs(path.qd[-1] - qd)) / rate])
    coarse, middle, fine = np.max(errors, axis=1)
    print(f"{name}: {duration:.6f} s, errors {coarse:.1e} {middle:.1e} {fine:.1e}")
    assert middle <= coarse / 2**3.5 and fine <= middle / 2**3.5 and fine <= of_order(4, duration / steps, 100 * rate**4)
