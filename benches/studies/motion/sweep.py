"""Springs from soft to stiff at one step size: the transition near h omega = 1 between resolved and damped
oscillations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from phipsi.report.pipeline import Findings
from phipsi.report.progress import Reporter
from . import cases
from .cases import Case
from .order import local
from .reference import FAR, Exact, reference, ringing
from .runs import METHODS, Path, distance, runner

#: s; the order is computed between the two.
STEPS = (1e-3, 5e-4)
#: Exponents of the springs, full and quick: stiffness 10^(e / 2) N m/rad.
FULL, QUICK = range(2, 19), range(2, 19, 2)
#: Stiffness, N m/rad, above which oscillations are omitted, because a reference would take too long.
RINGING = {True: 1e6, False: 1e7}


class Spring(NamedTuple):
    """One method at one spring."""

    stiffness: float
    """Stiffness, N m/rad."""
    ringing: bool
    """Whether the initial state is off the slow manifold."""
    method: str
    turned: float
    """h omega of the larger step, rad."""
    errors: tuple[float | None, ...]
    """Error at each of STEPS, rad; None if the run failed or the error is unknown."""
    order: float | None
    rate_errors: tuple[float | None, ...]
    """The same for joint velocities, rad/s."""
    rate_order: float | None
    failed: bool
    reference: float
    """Error of the reference, rad."""
    rate_reference: float
    """The same for joint velocities, rad/s."""
    steps: tuple[float, ...] = STEPS


def sweep(study: Findings, reporter: Reporter) -> list[Spring]:
    """Every method at every spring, from both initial states."""
    quick = study.quick
    chosen = [10.0 ** (e / 2) for e in (QUICK if quick else FULL)]
    pairs = [(k, rings) for k in chosen for rings in (False, True) if not rings or k <= RINGING[quick]]
    rows = []
    for stiffness, rings in reporter.each("Springs from soft to stiff", pairs):
        case = cases.held(stiffness, ringing=rings)
        exact = ringing(case) if rings else reference(case, 20_000)
        rows += [_spring(case, exact, stiffness, method.name) for method in METHODS]
    return rows


def _spring(case: Case, exact: Exact, stiffness: float, method: str) -> Spring:
    run = runner(case, method)
    paths = [run(h, round(case.time / h)) for h in STEPS]
    failed = any(path.failure is not None for path in paths)
    places = _known(paths, lambda path: distance(case, exact.q, path.q[-1]), exact.error)
    rates = _known(paths, lambda path: float(np.max(np.abs(path.qd[-1] - exact.qd))), exact.rate_error)
    return Spring(
        stiffness, case.rings, method, STEPS[0] * case.omega, places, _order(places), rates, _order(rates), failed,
        exact.error, exact.rate_error,
    )  # fmt: skip


def _known(paths: Sequence[Path], error: Callable[[Path], float], own: float) -> tuple[float | None, ...]:
    found = [None if path.failure else error(path) for path in paths]
    return tuple(e if e is not None and e >= FAR * own else None for e in found)


def _order(errors: tuple[float | None, ...]) -> float | None:
    coarse, fine = errors
    return None if coarse is None or fine is None else local(coarse, fine)
