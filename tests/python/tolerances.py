"""All tolerances of the Python tests, which scale with eps, magnitude and conditioning."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

EPS = float(np.finfo(np.float64).eps)

STEP = EPS ** (1 / 3)
"""Step of a central difference: truncation and rounding error are both about EPS ** (2

3).
"""


ESTIMATE_SPREAD = 20.0
"""Largest ratio of the true to the estimated error of forward dynamics here; tests/auto has the bound over random
scenes.
"""

AUDIT = 0.01
"""Largest integration error relative to the exchanged energy with a step of some milliseconds; `phipsi simulate` warns
above it.
"""

SIGMAS = 6.0
"""Largest deviation of an estimate in standard errors: larger ones have a probability of 5e-10, and the seeds are
fixed.
"""


FAR = 1e-12
"""Largest difference of results of a mechanism 1,000 km from the origin and at the origin, relative to their magnitude,
and to the distance for positions.
"""


ITERATED = 2e-7
"""Distance of shapes with round edges, for sizes of some tenths: the largest difference of the bounds on it."""

SMOOTH_POINT = 1e-4
"""Nearest points of shapes with round edges, perpendicular to the distance, for the same sizes."""

SMOOTH_NORMAL = 2e-3
"""Normal of shapes with round edges: of the order of the square root of the error of the distance."""


def product(n: int, scale: float) -> float:
    """For products and sums over n terms without a solve."""
    return 64.0 * max(n, 1) * EPS * scale


def inverse(condition: float, scale: float) -> float:
    """For results that involve the inverse of a matrix with that condition number."""
    return 64.0 * condition * EPS * scale


def in_float32(bound: float) -> float:
    """The float32 bound for a rounding bound in float64; the constants of the scene are rounded too."""
    return bound * float(np.finfo(np.float32).eps) / EPS


def central_difference(scale: float) -> float:
    """For a derivative by differences with STEP; scale is the magnitude of the function and its third derivative."""
    return 32.0 * EPS ** (2 / 3) * scale


def size(*values: ArrayLike) -> float:
    """Largest absolute entry, at least one: for quantities whose natural unit is one."""
    return max([1.0, *(float(np.max(np.abs(v), initial=0.0)) for v in values)])


def assert_near(found: ArrayLike, expected: ArrayLike, bound: float) -> None:
    """Entry by entry within the bound; NaN and different shapes fail."""
    found, expected = np.asarray(found), np.asarray(expected)
    assert found.shape == expected.shape
    off = np.abs(found - expected)
    assert np.all(off <= bound), f"off by {np.max(off)}, bound {bound}"


def assert_same_bits(found: ArrayLike, expected: ArrayLike, what: str = "") -> None:
    """Bitwise equal, including the signs of zeros."""
    found, expected = np.asarray(found, dtype=np.float64), np.asarray(expected, dtype=np.float64)
    assert found.shape == expected.shape, what
    different = np.count_nonzero(found.reshape(-1).view(np.int64) != expected.reshape(-1).view(np.int64))
    assert not different, f"{what} {different} of {found.size} entries differ"


def recursion(n: int, scale: float) -> float:
    """For two recursions over n degrees of freedom without a solve, which both round."""
    return 8.0 * max(n, 1) * EPS * scale


def chain(n: int) -> float:
    """For accelerations of a chain of n joints, relative to the largest: rounding errors accumulate as in a
    random walk, and so do rotations.
    """
    return 8.0 * float(np.sqrt(n)) * EPS


def accepted(scale: float) -> float:
    """Tolerance of form `auto` in derivatives of forward dynamics and their products; scale is the largest entry."""
    return 1e-11 * scale


def solve(condition: float, scale: float) -> float:
    """For an inverse compared with one by a backward stable program: smaller than `inverse`, which allows for
    Pinocchio's errors.
    """
    return 8.0 * condition * EPS * scale


def sampling(samples: int, spread: ArrayLike) -> np.ndarray:
    """For the mean of that many samples, each with the standard deviation `spread`: five standard deviations of the
    mean.
    """
    return np.asarray(5.0 / np.sqrt(samples) * np.asarray(spread))


def square_root(sensitivity: float) -> float:
    """Max-norm error of the square-root form, in addition to the sensitivity of the problem to one unit in the last
    place.
    """
    return max(20.0 * sensitivity, 1e-13)


def of_order(order: int, step: float, scale: float) -> float:
    """For a method of that order with that step; scale is the derivative that its error is proportional to, times the
    duration.
    """
    return scale * step**order


EVENT_STEP = 1e-6
"""Step of a central difference through impacts and sticking: so short that joints stick, slip and reach their stops in
the same substeps.
"""


def through_events(scale: float) -> float:
    """For a derivative by differences with EVENT_STEP: rounding error of the function divided by the step, over some
    hundred steps of motion.
    """
    return 1e-7 * scale


CONTACT = 1e-10
"""Tolerance of the solver of contacts: residual of the law relative to the fastest contact."""
CONTACT_GRADIENT = 1e-6
"""Largest error of a gradient through contact inside one mode, relative to the largest gradient of its kind."""
REDUNDANT_GRADIENT = 1e-4
"""Largest error of a gradient through redundant contacts beside differences with a step of 1e-4, relative to the largest of
its kind: the rounding error of the shares, 1e-16 over the compliance of 1e-7, over the step, and a multiple of the compliance.
"""
EQUAL_SPRINGS = 1e-5
"""Relative error of the forces of redundant contacts beside those of equal springs: rounding errors of gaps over the
compliance.
"""
SMOOTHED_LAW = 1e-9
"""Relative error of the smoothed law by its definition, from recorded forces and velocities: the recorded velocity of a contact
under a large force has the rounding error of the larger velocities from which it follows.
"""
SMOOTHED_REST = 1e-3
"""Relative error of states at rest with smoothing: the motion toward rest after the simulated time."""
SMOOTHED_ENERGY = 1e-9
"""Rise of the sum of all energies in a step with smoothing, J: rounding, and the tolerance of the solver."""


def slope_of_order_4(value: Callable[[float], Any], step: float) -> Any:
    """A derivative at zero by differences of order 4: with a step of 1e-3, about 12 digits of a smooth function of unit
    size.
    """
    return (8 * (value(step) - value(-step)) - (value(2 * step) - value(-2 * step))) / (12 * step)
