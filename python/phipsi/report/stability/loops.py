"""Closed loops with extreme mass ratios: a linkage, compared with its equations of motion in exact fractions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from ... import _core, errors
from ..progress import Reporter
from ..states import Array
from .measure import DERIVED_FORMS, DRAWS, Error, Stability, worst

#: Links whose mass is multiplied by the ratio.
HEAVY: dict[str, tuple[int, ...]] = {"first": (0,), "third": (2,), "last": (5,), "last two": (4, 5), "every other": (1, 3, 5)}
RATIOS = (1.0, 1e4, 1e8, 1e12)
LINKS, LENGTH = 6, 0.2
#: Distance of the fixed ends of the linkage, m, and gravity, m/s^2.
APART, GRAVITY = 0.4, 9.81
#: Joint angles around which the states are drawn.
ARCH = (-1.6, 0.5, 0.6, 0.6, 0.5, 0.6)
#: Dense algebra: M and J of phipsi, and the linear system of accelerations and forces in NumPy.
DENSE = "dense system, NumPy"
#: Bits of the fixed-point arithmetic for sines.
BITS = 200


class Loop(NamedTuple):
    """Largest error of the accelerations of a linkage over some states, by method."""

    heavy: str
    ratio: float
    errors: dict[str, Error]
    sensitivity: Error


class Linkage(NamedTuple):
    """A chain of bars with parallel axes y whose ends are fixed, and its state: all values that define the problem."""

    mass: Array
    inertia: Array
    """About each center of mass, kg m^2."""
    com: Array
    """From each joint to the center of mass of its link, m."""
    length: Array
    q: Array
    """Angles at the joints."""
    qd: Array
    tau: Array

    def scene(self) -> _core.Scene:
        """The chain, whose last link is connected to the world by a hinge."""
        builder = _core.SceneBuilder().link("ground")
        for k, length in enumerate(self.length):
            name, parent, at = f"link{k}", f"link{k - 1}" if k else "ground", self.length[k - 1] if k else 0.0
            builder.link(name, mass=self.mass[k], com=(0.0, 0.0, self.com[k]), inertia=self.inertia[k] * np.diag([1.0, 1.0, 0.1]))
            builder.joint(name, "revolute", parent, name, xyz=(0.0, 0.0, at), axis=(0.0, 1.0, 0.0))
        builder.connect("end", "axis", name, axis=(0.0, 1.0, 0.0), xyz=(0.0, 0.0, length), other_xyz=(APART, 0.0, 0.0))
        return builder.build(gravity=(0.0, 0.0, -GRAVITY))

    def exact(self) -> Array:
        """Joint accelerations, rounded once: M t'' + h = Q + J^T f with J t'' + J' t' = 0, for the angles t of
        the links from z.
        """
        mass, inertia, com, length, q, qd, tau = ([Fraction(x) for x in row.tolist()] for row in self)
        n = range(len(q))
        rates = list(accumulate(qd))
        sines = [_sine_and_cosine(angle) for angle in accumulate(q)]
        # Distance along each link that contributes to the center of mass of link k.
        reach = [[length[i] if i < k else com[k] if i == k else Fraction(0) for i in n] for k in n]
        couples = [[_sum(mass[k] * reach[k][i] * reach[k][j] for k in n) for j in n] for i in n]
        matrix, right = [], []
        for i, (sine, cosine) in enumerate(sines):
            apart = [(sine * c - cosine * s, cosine * c + sine * s) for s, c in sines]
            row = [couples[i][j] * apart[j][1] + (inertia[i] if i == j else 0) for j in n]
            matrix.append([*row, length[i] * cosine, -length[i] * sine])
            weight = Fraction(GRAVITY) * sine * _sum(mass[k] * reach[k][i] for k in n)
            across = _sum(couples[i][j] * apart[j][0] * rates[j] ** 2 for j in n)
            right.append(tau[i] - (tau[i + 1] if i + 1 < len(q) else 0) + weight - across)
        # The position error of the end is attributed to the last link, whose rotation moves it.
        speed = [_sum(row[len(q) + axis] * rate for row, rate in zip(matrix, rates, strict=True)) for axis in range(2)]
        gap = [Fraction(at) - _sum(length[i] * sines[i][axis] for i in n) for axis, at in enumerate((APART, 0.0))]
        matrix[-1][-2:] = [matrix[-1][-2] + gap[1], matrix[-1][-1] - gap[0]]
        turning = 2 * rates[-1] * speed[1] - rates[-1] ** 2 * gap[0], -2 * rates[-1] * speed[0] - rates[-1] ** 2 * gap[1]
        for axis in range(2):
            matrix.append([matrix[i][len(q) + axis] for i in n] + [Fraction(0)] * 2)
            right.append(_sum(length[i] * rates[i] ** 2 * sines[i][axis] for i in n) + turning[axis])
        of_links = _solve(matrix, right)[: len(q)]
        return np.array([float(x - before) for x, before in zip(of_links, [Fraction(0), *of_links], strict=False)])

    def moved(self, random: np.random.Generator) -> Linkage:
        """The problem with every value changed by one unit in the last place, in random directions."""
        return Linkage(*(np.nextafter(row, row + random.choice([-1.0, 1.0], row.shape)) for row in self))


def _sum(terms: Iterable[Fraction]) -> Fraction:
    return sum(terms, Fraction(0))


def _sine_and_cosine(angle: Fraction) -> tuple[Fraction, Fraction]:
    """Sine and cosine by their series in fixed point, accurate to about 1e-55 for angles of a few radians."""
    x = (angle.numerator << BITS) // angle.denominator
    sums, term, k = [0, 0], 1 << BITS, 0
    while term:
        sums[k % 2] += term if k % 4 < 2 else -term
        k += 1
        # Rounded toward zero: rounded down, a negative term would never become zero.
        term = int(Fraction(term * x, k << BITS))
    return Fraction(sums[1], 1 << BITS), Fraction(sums[0], 1 << BITS)


def _solve(matrix: list[list[Fraction]], right: list[Fraction]) -> list[Fraction]:
    """The exact solution, by Gauss-Jordan elimination."""
    rows = [[*row, b] for row, b in zip(matrix, right, strict=True)]
    for k in range(len(rows)):
        pivot = next(i for i in range(k, len(rows)) if rows[i][k] != 0)
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [x / rows[k][k] for x in rows[k]]
        for i, row in enumerate(rows):
            if i != k and row[k] != 0:
                rows[i] = [x - row[k] * y for x, y in zip(row, rows[k], strict=True)]
    return [row[-1] for row in rows]


def linkage(heavy: Sequence[int], ratio: float, seed: int) -> Linkage:
    """A linkage whose links `heavy` have `ratio` times the mass of the others, in a random state that satisfies the
    connection.
    """
    random = np.random.default_rng(seed)
    length = np.full(LINKS, LENGTH)
    q, qd = ARCH + random.uniform(-0.1, 0.1, LINKS), random.uniform(-1.0, 1.0, LINKS)
    even = Linkage(np.ones(LINKS), length**2 / 12.0, length / 2.0, length, q, qd, random.uniform(-1.0, 1.0, LINKS))
    held = even.scene().loops.project(q, qd)
    assert held.qd is not None
    mass = np.array([ratio if k in heavy else 1.0 for k in range(LINKS)])
    return even._replace(mass=mass, inertia=mass * even.inertia, q=held.q, qd=held.qd)


def measure(found: Stability, reporter: Reporter) -> list[Loop]:
    """Error of every form, and of dense algebra, on linkages of heavy and light links."""
    cases = [(name, ratio) for ratio in RATIOS for name in (HEAVY if ratio > 1.0 else ("none",))]
    return [_loop(*case, found.seeds) for case in reporter.each("Closed loops", cases)]


def _loop(name: str, ratio: float, seeds: Sequence[int]) -> Loop:
    measured: dict[str, list[Error]] = {}
    sensitivity = []
    for seed in seeds:
        one = linkage(HEAVY.get(name, ()), ratio, seed)
        exact, random = one.exact(), np.random.default_rng(seed)
        sensitivity += [_error(one.moved(random).exact(), exact) for _ in range(DRAWS)]
        scene = one.scene()
        for form in DERIVED_FORMS:
            try:
                found = _error(scene.loops.dynamics(one.q, one.qd, one.tau, form=form).qdd, exact)
            except errors.PhipsiError as error:
                found = Error(float("nan"), float("nan"), str(error))
            measured.setdefault(form, []).append(found)
        measured.setdefault(DENSE, []).append(_error(_dense(scene, one), exact))
    return Loop(name, ratio, {method: worst(rows) for method, rows in measured.items()}, worst(sensitivity))


def _error(accelerations: Array, exact: Array) -> Error:
    difference = np.abs(accelerations - exact)
    return Error.of(float(difference.max() / np.abs(exact).max()), difference / np.abs(exact))


def _dense(scene: _core.Scene, one: Linkage) -> Array:
    """Solution of [M, J^T; J, 0] with the two rows of the hinge in the plane; the other three are zero or depend on
    them.
    """
    plane = [2, 3]
    rows = scene.loops.jacobian(one.q)[plane]
    matrix = np.block([[scene.mass_matrix(one.q), rows.T], [rows, np.zeros((2, 2))]])
    right = np.concatenate([one.tau - scene.bias_torque(one.q, one.qd), -scene.loops.bias(one.q, one.qd)[plane]])
    solution: Array = np.linalg.solve(matrix, right)[: scene.nv]
    return solution
