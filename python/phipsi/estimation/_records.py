"""State and records of the observer, and the statistic of its divergence test."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._chi_square import chi_square_quantile
from ._values import each

__all__ = ["Record", "State", "innovation_ratios", "nonnegative"]

_Array = NDArray[np.float64]

#: Probability of a false positive of a divergence test.
UNLIKELY = 1e-9


class State(NamedTuple):
    q: _Array
    qd: _Array
    #: Wrenches, then biases.
    rest: _Array
    #: Root of the covariance, (..., n, n).
    root: _Array


@dataclass
class Record:
    """Readings of one time, and results of the latest filter pass."""

    tau: _Array
    readings: dict[str, _Array]
    state: State | None = None
    #: Root of (x, n) after the update, noise estimate, transition [F B], and next prior.
    root: _Array | None = None
    noise: _Array | None = None
    flow: _Array | None = None
    after: State | None = None
    nis: _Array | None = None
    size: NDArray[np.int_] | None = None
    #: NIS and number of readings of each sensor.
    by_sensor: dict[str, tuple[_Array, NDArray[np.int_]]] | None = None


def innovation_ratios(records: Sequence[Record], names: Sequence[str], batch: tuple[int, ...]) -> _Array:
    """Normalized innovations squared of some sensors, (...), relative to the bound of a consistent filter."""
    total, size = np.zeros(batch), np.zeros(batch, int)
    for record in records:
        for name, (value, count) in (record.by_sensor or {}).items():
            if name in names:
                total, size = total + value, size + count
    unlikely = UNLIKELY / max(1, total.size)
    bounds = {int(m): chi_square_quantile(1.0 - unlikely, float(m)) if m else math.inf for m in np.unique(size)}
    return np.asarray(total / np.vectorize(bounds.__getitem__, otypes=[float])(size))


def nonnegative(name: str, value: ArrayLike, size: int) -> _Array:
    """Nonnegative values, (size,), from a scalar or (size,)."""
    refused = "found a number that is negative or not finite; expected zero or positive ones"
    return each(name, np.asarray(value, float), size, refused)
