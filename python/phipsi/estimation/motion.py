"""Estimates of an observer: external wrenches, and the motion of a robot with its covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._summary import summarized

__all__ = ["ExternalWrench", "ObserverEstimate", "SmoothedMotion"]

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class ExternalWrench:
    """External wrench on a link for estimation: a random walk, or an Ornstein-Uhlenbeck process.

    Attributes
    ----------
    link : str
        Name of the link. The wrench (moment, force) acts at the link origin and is expressed in the link frame.
    density : float or (6,)
        Density of the driving white noise, (N m)^2/s and N^2/s. The standard deviation of a random walk after a time t
        is sqrt(density t).
    correlation_time : float
        Correlation time, s; infinite for a random walk. The stationary variance is density correlation_time / 2.
    deviation : float or (6,), optional
        Initial standard deviation. Default: zero for a random walk, otherwise the stationary standard deviation.

    Examples
    --------
    >>> import phipsi
    >>> from phipsi.estimation import ExternalWrench
    >>> ExternalWrench("hand", density=4.0).correlation_time
    inf
    """

    link: str
    density: ArrayLike
    correlation_time: float = math.inf
    deviation: ArrayLike | None = None


@summarized
class ObserverEstimate(NamedTuple):
    """Estimate of the observer at the time of the readings of a step."""

    q: _Array
    """Configuration, (..., nq)."""
    qd: _Array
    """Joint velocities, (..., nv)."""
    wrenches: dict[str, _Array]
    """(moment, force) on each link at the link origin in the link frame, (..., 6)."""
    biases: dict[str, _Array]
    """Biases by sensor name, (..., 3)."""
    covariance: _Array
    """Covariance of the error (q in its tangent space, qd, wrenches, biases), (..., n, n), in the order of the
    arguments."""
    nis: _Array
    """Normalized innovation squared of the latest time with complete readings, (...); NaN if there is no such time
    yet."""
    nis_size: NDArray[np.int_]
    """Number of readings in `nis`, (...)."""
    rejected: dict[str, NDArray[np.bool_]]
    """Readings of that time beyond the gate of their sensor, which were not processed, by its name, (..., m)."""


@summarized
class SmoothedMotion(NamedTuple):
    """Smoothed estimates: the estimate at each time from the readings of all times."""

    time: _Array
    """Times since the first step, (steps,), s."""
    q: _Array
    """(steps, ..., nq)."""
    qd: _Array
    """(steps, ..., nv)."""
    wrenches: dict[str, _Array]
    """(steps, ..., 6) each."""
    biases: dict[str, _Array]
    """(steps, ..., 3) each."""
    covariance: _Array
    """(steps, ..., n, n), as in ObserverEstimate."""
