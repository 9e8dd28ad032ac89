"""One run of one method: its states, or the reason of its failure."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phipsi import errors
from .cases import Case

Array = NDArray[np.float64]

#: Number of recorded times in addition to the initial one; steps are a multiple of it.
ROWS = 10
#: Configuration error, rad or m, above which a run counts as failed.
WRONG = 1.0


class Method(NamedTuple):
    """A fixed-step method of scene.simulate."""

    name: str
    stages: int
    order: int
    implicit: bool


METHODS = (
    Method("semi-implicit-euler", 1, 1, False),
    Method("rk4", 4, 4, False),
    Method("implicit-euler", 1, 1, True),
    Method("rosenbrock-2", 2, 2, True),
    Method("rosenbrock-3", 4, 3, True),
)


class Path(NamedTuple):
    """ROWS + 1 states in phipsi's coordinates; fewer, and the reason, if the run failed."""

    q: Array
    qd: Array
    failure: str | None = None


#: From a case, a step (s) and a number of steps to the states.
Runner = Callable[[float, int], Path]


def runner(case: Case, method: str) -> Runner:
    """Runs of scene.simulate."""

    def run(dt: float, steps: int) -> Path:
        try:
            path = case.scene.simulate(case.q, case.qd, dt=dt, steps=steps, method=method, record_every=steps // ROWS)
        except errors.SimulationError as error:
            path, text = error.trajectory, " ".join(str(error).split())
            return Path(path.q, path.qd, text)
        return Path(path.q, path.qd)

    return run


def distance(case: Case, exact: Array, found: Array) -> float:
    """Largest component of the difference on the manifold, rad or m; a rotation counts as its rotation vector."""
    return float(np.max(np.abs(case.scene.difference(exact, found))))
