"""Every tolerance of the Python tests, in one place: they scale with eps, size and conditioning."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

EPS = float(np.finfo(np.float64).eps)

STEP = EPS ** (1 / 3)
"""Step of a central difference: its truncation and its rounding are then both about EPS ** (2 / 3)."""


ESTIMATE_SPREAD = 20.0
"""How many times the estimated error of forward dynamics the true one may be here; over random scenes tests/auto has the bound."""

AUDIT = 0.01
"""The largest share of the exchanged energy that the integrator's error may have in a run with a step of some milliseconds; `phipsi simulate` warns above it."""

SIGMAS = 6.0
"""Standard errors that an estimate may be off: one in two billion is further, and the seeds are fixed."""


FAR = 1e-12
"""How far results of a mechanism 1,000 km from the origin may be from those at the origin, over their size, and over the distance where they are positions."""


def product(n: int, scale: float) -> float:
    """For products and sums over n terms without a solve."""
    return 64.0 * max(n, 1) * EPS * scale


def inverse(condition: float, scale: float) -> float:
    """Through the inverse of a matrix of that condition number."""
    return 64.0 * condition * EPS * scale


def in_float32(bound: float) -> float:
    """What a bound on rounding in float64 is in float32, where the numbers of the scene are rounded too."""
    return bound * float(np.finfo(np.float32).eps) / EPS


def central_difference(scale: float) -> float:
    """For a derivative by differences with STEP; scale is the size of the function and its third derivative."""
    return 32.0 * EPS ** (2 / 3) * scale


def size(*values: ArrayLike) -> float:
    """The largest absolute entry, at least one: for quantities whose natural unit is one."""
    return max([1.0, *(float(np.max(np.abs(v), initial=0.0)) for v in values)])


def assert_near(found: ArrayLike, expected: ArrayLike, bound: float) -> None:
    """Entry by entry within the bound; a NaN fails, and so does another shape."""
    found, expected = np.asarray(found), np.asarray(expected)
    assert found.shape == expected.shape
    off = np.abs(found - expected)
    assert np.all(off <= bound), f"off by {np.max(off)}, bound {bound}"


def assert_same_bits(found: ArrayLike, expected: ArrayLike, what: str = "") -> None:
    """Equal bit by bit, signs of zeros included."""
    found, expected = np.asarray(found, dtype=np.float64), np.asarray(expected, dtype=np.float64)
    assert found.shape == expected.shape, what
    different = np.count_nonzero(found.reshape(-1).view(np.int64) != expected.reshape(-1).view(np.int64))
    assert not different, f"{what} {different} of {found.size} entries differ"


def recursion(n: int, scale: float) -> float:
    """For one recursion over n degrees of freedom beside another: both round, neither solves."""
    return 8.0 * max(n, 1) * EPS * scale


def chain(n: int) -> float:
    """For accelerations of a chain of n joints, relative to the largest: rounding adds up as in a random walk, and so do rotations."""
    return 8.0 * float(np.sqrt(n)) * EPS


def accepted(scale: float) -> float:
    """The error that form `auto` accepts in derivatives of forward dynamics and their products; scale is the largest entry."""
    return 1e-11 * scale


def solve(condition: float, scale: float) -> float:
    """For an inverse beside one by a backward stable program: tighter than `inverse`, which allows for Pinocchio's."""
    return 8.0 * condition * EPS * scale


def sampling(samples: int, spread: ArrayLike) -> np.ndarray:
    """For the mean of that many draws, each with the standard deviation `spread`: five standard deviations of the mean."""
    return np.asarray(5.0 / np.sqrt(samples) * np.asarray(spread))


def square_root(sensitivity: float) -> float:
    """What the square-root form may be off in the max-norm, beside the problem's own sensitivity to one unit in the last place."""
    return max(20.0 * sensitivity, 1e-13)


def of_order(order: int, step: float, scale: float) -> float:
    """For a method of that order with that step; scale is the derivative that its error is proportional to, times the duration."""
    return scale * step**order


EVENT_STEP = 1e-6
"""Step of a central difference through impacts and sticking: so short that joints stick, slip and meet their stops in the same substeps."""


def through_events(scale: float) -> float:
    """For a derivative by differences with EVENT_STEP: rounding of the function over the step, over some hundred steps of motion."""
    return 1e-7 * scale
