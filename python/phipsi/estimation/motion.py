"""What an observer estimates: external wrenches, and the motion of a robot with its covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["ExternalWrench", "ObserverEstimate", "SmoothedMotion"]

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class ExternalWrench:
    """A wrench on a link that the observer estimates: a random walk, or an Ornstein-Uhlenbeck process.

    Attributes
    ----------
    link : str
        The link; the wrench (moment, force) acts at its origin and is written in its frame.
    density : float or (6,)
        Density of its white rate, (N m)^2/s and N^2/s: a random walk has moved by sqrt(density t) after t.
    correlation_time : float
        s; infinite for a random walk. Otherwise its stationary variance is density correlation_time / 2.
    deviation : float or (6,), optional
        Standard deviation at the start; by default zero for a random walk, the stationary one otherwise.

    Examples
    --------
    >>> from phipsi.estimation import ExternalWrench
    >>> ExternalWrench("hand", density=4.0).correlation_time
    inf
    """

    link: str
    density: ArrayLike
    correlation_time: float = math.inf
    deviation: ArrayLike | None = None


class ObserverEstimate(NamedTuple):
    """What a step of the observer gives, at the time of its readings."""

    q: _Array
    """Configuration, (..., nq)."""
    qd: _Array
    """Joint velocities, (..., nv)."""
    wrenches: dict[str, _Array]
    """(moment, force) on each link at its origin in its frame, (..., 6)."""
    biases: dict[str, _Array]
    """Bias of each sensor that has one, by its name, (..., 3)."""
    covariance: _Array
    """Of the error (q in its tangent space, qd, wrenches, biases), (..., n, n), in the order of the arguments."""
    nis: _Array
    """Normalized innovation squared of all readings of this time, (...); NaN while delayed readings of it are still to come and none of an earlier time is complete."""
    nis_size: NDArray[np.int_]
    """The number of readings in it, (...)."""


class SmoothedMotion(NamedTuple):
    """The estimate at each time from the readings of all times."""

    time: _Array
    """(steps,), s since the first step."""
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
