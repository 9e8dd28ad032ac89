"""Initial states on the slow manifold: the springs have the deflections of the slow motion, so that they do not
oscillate.

At rest, by time symmetry, fast joints have zero velocity there. Their positions follow from the torques that keep
them on the slow motion, k q = -(M a + bias), with the accelerations of the manifold. The remaining oscillation has an
amplitude of (slow rate

fast rate)^4 times the deflection.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phipsi import Scene

Array = NDArray[np.float64]

#: s; interval of the second difference along the slow motion.
APART = 1e-3


def at_rest(scene: Scene, q: Array, fast: NDArray[np.bool_]) -> Array:
    """q with the `fast` joints moved to the slow manifold, velocities zero; all joints have one axis, springs are at
    rest at zero.
    """
    zero = np.zeros(scene.nv)
    here, acceleration = _held(scene, q, zero, zero, fast)
    # The slow motion over a short interval, and the resulting motion of the fast joints.
    later = here + np.where(fast, 0.0, 0.5 * acceleration * APART**2)
    there, _ = _held(scene, later, np.where(fast, 0.0, acceleration * APART), zero, fast)
    bend = np.where(fast, 2.0 * (there - here) / APART**2, 0.0)
    return _held(scene, here, zero, bend, fast)[0]


def _held(scene: Scene, q: Array, qd: Array, bend: Array, fast: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Positions of the fast joints at which their springs cause the accelerations `bend`; and all accelerations."""
    q, slow = q.copy(), ~fast
    for _ in range(60):
        mass, bias = scene.mass_matrix(q), scene.bias_torque(q, qd) + scene.stiffness * np.where(slow, q, 0.0)
        acceleration = np.where(fast, bend, 0.0)
        rest = -(bias + mass @ acceleration)[slow]
        acceleration[slow] = np.linalg.solve(mass[np.ix_(slow, slow)], rest)
        placed = -(mass @ acceleration + bias)[fast] / scene.stiffness[fast]
        moved = float(np.max(np.abs(placed - q[fast]), initial=0.0))
        q[fast] = placed
        if moved <= 1e-18:
            break
    return q, acceleration
