"""State and record of one step of the observer, and the statistic of its divergence test."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ._chi_square import chi_square_quantile

__all__ = ["Record", "State", "innovation_ratios"]

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
    """Torques and readings of one time, and the linearization of its step."""

    tau: _Array
    readings: dict[str, _Array]
    #: Root of (x, n), and transition [F B].
    root: _Array | None = None
    flow: _Array | None = None


def innovation_ratios(sums: _Array, robots: int | None = None) -> _Array:
    """Normalized innovations squared relative to the bound of a consistent filter, (robots, sensors).

    `sums` are their sums and numbers of readings, (robots, sensors, 2); `robots` is the number that are tested together.
    """
    sizes = sums[..., 1]
    unlikely = UNLIKELY / max(1, len(sums) if robots is None else robots)
    bounds = {m: chi_square_quantile(1.0 - unlikely, float(m)) if m else math.inf for m in np.unique(sizes)}
    return np.asarray(sums[..., 0] / np.vectorize(bounds.__getitem__, otypes=[float])(sizes))
