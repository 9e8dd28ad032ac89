"""Chi-square distribution function and its inverse, for any number of degrees of freedom."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["chi_square_cdf", "chi_square_quantile"]


def chi_square_cdf(x: ArrayLike, size: float) -> NDArray[np.float64]:
    """Chi-square distribution function with `size` degrees of freedom: the incomplete gamma function P(size/2, x/2)."""
    a, half = size / 2.0, np.atleast_1d(np.asarray(x, float)) / 2.0
    low = half < a + 1.0
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        factor = np.exp(a * np.log(half) - half - math.lgamma(a))
        small = np.where(half > 0.0, factor * _series(a, np.where(low, half, 1.0)), 0.0)
        large = 1.0 - factor * _fraction(a, np.where(low, a + 2.0, half))
    return np.asarray(np.where(low, small, large).reshape(np.shape(x)))


def _series(a: float, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Power series of gamma(a, x) / (x^a e^-x), which converges fast for x < a + 1."""
    term = np.full_like(x, 1.0 / a)
    total = term.copy()
    k = a
    while np.any(term > 1e-17 * total):
        k += 1.0
        term = term * x / k
        total += term
    return total


def _fraction(a: float, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Continued fraction of Gamma(a, x) / (x^a e^-x) by the Lentz method, which converges fast for x > a + 1."""
    b = x + 1.0 - a
    c, d = np.full_like(x, 1e300), 1.0 / b
    h = d.copy()
    for i in range(1, 100_000):
        an = -i * (i - a)
        b = b + 2.0
        d, c = 1.0 / (an * d + b), b + an / c
        step = c * d
        h *= step
        if np.all(np.abs(step - 1.0) < 1e-15):
            break
    return h


@functools.lru_cache(maxsize=256)
def chi_square_quantile(probability: float, size: float) -> float:
    """Chi-square quantile with `size` degrees of freedom, by safeguarded Newton iteration."""
    low, high = 0.0, size + 10.0
    while float(chi_square_cdf(high, size)) < probability:
        low, high = high, 2.0 * high
    x = min(max(size, 0.5 * (low + high)), high)
    for _ in range(200):
        off = float(chi_square_cdf(x, size)) - probability
        low, high = (x, high) if off < 0.0 else (low, x)
        density = math.exp(
            (0.5 * size - 1.0) * math.log(x) - 0.5 * x - 0.5 * size * math.log(2.0) - math.lgamma(0.5 * size)
        )
        step = off / density if density > 0.0 else math.inf
        following = x - step if low < x - step < high else 0.5 * (low + high)
        if abs(following - x) <= 1e-14 * x or not low < high:
            return following
        x = following
    return x
