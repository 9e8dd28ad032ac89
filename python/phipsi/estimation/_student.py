"""Quantiles of Student's distribution, for jackknife intervals from few blocks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ArgumentError, of_argument

__all__ = ["student_quantile"]

_Array = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)


def student_quantile(level: float, degrees: ArrayLike) -> _Array:
    """Quantile t with P(|T| <= t) = level of Student's distribution; infinite degrees: the normal distribution.

    With t = sqrt(degrees) tan(theta), P is the normalized integral of cos^(degrees - 1) from 0 to theta. The function
    uses bisection on theta and Gauss-Legendre quadrature. Raises ArgumentError for a level that is not between 0 and 1.
    """
    if not 0.0 < level < 1.0:
        expected = "expected a probability between 0 and 1, for instance 0.95"
        raise of_argument(ArgumentError, "level", f"found {level}; {expected}")
    given = np.minimum(np.asarray(degrees, float), 1e6)
    normal = np.array(
        [2.0 * math.exp(math.lgamma((n + 1) / 2) - math.lgamma(n / 2)) / math.sqrt(math.pi) for n in given.ravel()]
    )
    nu, low, high = given.ravel(), np.zeros(given.size), np.full(given.size, 0.5 * np.pi)
    # The density is negligible beyond 40 standard deviations.
    high = np.where(nu > 100.0, np.arctan(40.0 / np.sqrt(nu)), high)
    for _ in range(60):
        middle = 0.5 * (low + high)
        theta = 0.5 * middle[:, None] * (_NODES + 1.0)
        share = normal * 0.5 * middle * np.sum(_WEIGHTS * np.cos(theta) ** (nu[:, None] - 1.0), axis=1)
        low, high = np.where(share < level, middle, low), np.where(share < level, high, middle)
    return np.asarray((np.sqrt(nu) * np.tan(0.5 * (low + high))).reshape(given.shape))
