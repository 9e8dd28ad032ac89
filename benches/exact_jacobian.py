"""Rosenbrock steps with the exact Jacobian instead of springs and damping only: the possible gain in accuracy.

The methods of `scene.simulate` use only springs and damping, exactly and in O(N). Here they are implemented with
dense algebra, from the tableau in src/motion/method.rs, with either matrix; errors are relative to a solution with
128 times as many steps.
"""

from typing import Any

import numpy as np

import phipsi

STEPS, FINER, TIME = 64, 128, 0.5
#: Stiffness and damping of every joint, N m/rad and N m s/rad.
SPRINGS = ((0.0, 0.0), (1e2, 1e0), (1e4, 1e2), (1e6, 1e4))

G2, G3 = 1 - np.sqrt(0.5), 1 / 3
#: alpha and gamma, by row.
METHODS: dict[str, tuple[list[list[float]], list[list[float]]]] = {
    "rosenbrock-2": ([[], [1.0]], [[G2], [-2 * G2, G2]]),
    "rosenbrock-3": (
        [[], [0.43], [0.76, -0.3423115642741963], [0.05, 1.3191924901415706, -0.5249756136841377]],
        [
            [G3],
            [-0.2114318054434813, G3],
            [-0.5557832109761233, 0.8345209661608292, G3],
            [0.11816464233462023, -0.4764203180840643, 0.18070546595867785, G3],
        ],
    ),
}
WEIGHTS = {
    "rosenbrock-2": [0.5, 0.5],
    "rosenbrock-3": [a + g for a, g in zip([*METHODS["rosenbrock-3"][0][3], 0.0], METHODS["rosenbrock-3"][1][3], strict=True)],
}

Array = np.ndarray[Any, np.dtype[np.float64]]


class Sprung:
    """A chain of seven links with springs and dampers, y = (q, v)."""

    def __init__(self, stiffness: float, damping: float) -> None:
        self.scene = phipsi.scenes.chain(7)
        random = np.random.default_rng(0)
        self.start = random.uniform(-1, 1, 14)
        self.rest, self.stiffness, self.damping = self.start[:7].copy(), stiffness, damping

    def parts(self, y: Array) -> tuple[Array, Array, Array]:
        q, v = y[:7], y[7:]
        return q, v, -self.stiffness * (q - self.rest) - self.damping * v

    def rate(self, y: Array) -> Array:
        q, v, tau = self.parts(y)
        return np.concatenate([v, self.scene.forward_dynamics(q, v, tau)])

    def jacobian(self, y: Array, exact: bool) -> Array:
        by_q, by_v, inverse = self.scene.forward_dynamics_derivatives(*self.parts(y))
        of_springs = np.hstack([-self.stiffness * inverse, -self.damping * inverse])
        return np.vstack([np.eye(7, 14, 7), of_springs + (np.hstack([by_q, by_v]) if exact else 0.0)])

    def run(self, method: str, steps: int, exact: bool) -> Array:
        (alpha, gamma), h, y = METHODS[method], TIME / steps, self.start
        for _ in range(steps):
            stages: list[Array] = []
            for a, g in zip(alpha, gamma, strict=True):
                at = y + h * sum((x * k for x, k in zip(a, stages, strict=True)), np.zeros(14))
                matrix = h * self.jacobian(at, exact)
                right = self.rate(at) + matrix @ sum((x * k for x, k in zip(g[:-1], stages, strict=True)), np.zeros(14))
                stages.append(np.linalg.solve(np.eye(14) - g[-1] * matrix, right))
            y = y + h * sum((x * k for x, k in zip(WEIGHTS[method], stages, strict=True)), np.zeros(14))
        return y


def rows() -> list[list[str]]:
    """Stiffness and damping, method, and the errors of both."""
    found = []
    for stiffness, damping in SPRINGS:
        chain = Sprung(stiffness, damping)
        truth = chain.run("rosenbrock-3", FINER * STEPS, exact=False)
        for method in METHODS:
            errors = [np.max(np.abs(chain.run(method, STEPS, exact) - truth)) for exact in (False, True)]
            found.append([f"{stiffness:g}, {damping:g}: {method}", *(f"{error:.1e}" for error in errors)])
    return found
