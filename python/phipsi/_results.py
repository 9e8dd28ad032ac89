"""Results of several parts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Energy", "Limits"]


class Energy(NamedTuple):
    """Energy, J: NumPy scalars for one state, arrays of the batch's shape for many."""

    kinetic: NDArray[np.float64] | np.float64
    """Half of qd M qd, armature included."""
    potential: NDArray[np.float64] | np.float64
    """Minus gravity times the first moment of mass; zero with the mass centre at the base's origin."""


class Limits(NamedTuple):
    """Limits by degree of freedom, (nv,) each; infinite where there is none."""

    lower: NDArray[np.float64]
    """Smallest position, rad or m."""
    upper: NDArray[np.float64]
    """Largest position, rad or m."""
    velocity: NDArray[np.float64]
    """Largest speed, rad/s or m/s."""
    effort: NDArray[np.float64]
    """Largest torque or force, N m or N."""
