"""Variances, densities and standard deviations that are given once or for each component."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._arguments import numbers
from ..errors import ArgumentError, ShapeError, of_argument

__all__ = ["each", "positive"]

_Array = NDArray[np.float64]


def each(name: str, value: ArrayLike, size: int, refused: str, *, positive: bool = False) -> _Array:
    """Finite nonnegative values, (size,), from a scalar or (size,); with `positive` values above zero.

    `refused` is the message of the error for other values; "{least}" in it is replaced by the least value.
    """
    if type(value) is float and 0.0 < value < np.inf:
        # The most frequent argument, without arrays of one number.
        return np.full(size, value)
    found = numbers(name, value)
    if found.shape not in ((), (size,)):
        raise of_argument(ShapeError, name, f"found shape {found.shape}; expected () or ({size},)")
    if not (np.isfinite(found) & ((found > 0.0) if positive else (found >= 0.0))).all():
        raise of_argument(ArgumentError, name, refused.replace("{least}", str(found.min())))
    return np.full(size, found) if found.ndim == 0 else np.array(found)


def positive(name: str, value: float) -> float:
    """A finite number above zero."""
    found = numbers(name, value)
    if not (found.ndim == 0 and np.isfinite(found) and found > 0.0):
        raise of_argument(ArgumentError, name, f"found {value}; expected a finite number above zero")
    return float(found)
