"""Motions that are the truth of a filter, smoother or observer: the classical method of order 4 at a quarter of its step.

A truth that is drawn from the step of the filter itself, or from a simulation with the same step, does not show the errors of that step.
"""

from collections.abc import Callable

import numpy as np
import phipsi
from phipsi.estimation._manifold import exponential, joint_groups

#: Substeps of a step of the filter.
SUBSTEPS = 4


def moved(
    scene: phipsi.Scene, q: np.ndarray, qd: np.ndarray, accelerate: Callable[[np.ndarray, np.ndarray], np.ndarray], duration: float, parts: int = SUBSTEPS
) -> tuple[np.ndarray, np.ndarray]:
    """States (..., nq) and (..., nv) after a time, with the accelerations of `accelerate(q, qd)`.

    Runge-Kutta-Munthe-Kaas of order 4: q = q0 (+) u, and u' = Jr(u)^-1 qd with the right Jacobian Jr of the step u.
    """
    groups, h = joint_groups(scene), duration / parts
    is_flat = bool(np.all(groups[0] == groups[1]))

    def rates(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        along = v if is_flat else np.linalg.solve(exponential(groups, u)[1], v[..., None])[..., 0]
        return along, accelerate(scene.integrate(q, u), v)

    for _ in range(parts):
        u1, a1 = rates(np.zeros(qd.shape), qd)
        u2, a2 = rates(0.5 * h * u1, qd + 0.5 * h * a1)
        u3, a3 = rates(0.5 * h * u2, qd + 0.5 * h * a2)
        u4, a4 = rates(h * u3, qd + h * a3)
        q, qd = scene.integrate(q, h / 6.0 * (u1 + 2.0 * u2 + 2.0 * u3 + u4)), qd + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return q, qd
