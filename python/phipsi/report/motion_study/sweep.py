"""Springs from soft to stiff at one step: where h omega is near 1, between what a step follows and what it damps."""

from __future__ import annotations

from typing import NamedTuple

from ..progress import Reporter
from . import cases
from .order import local
from .reference import FAR, reference, ringing
from .runs import METHODS, distance, runner

#: s; the order is that between the two.
STEPS = (1e-3, 5e-4)
#: Exponents of the springs, full and quick: stiffness 10^(e / 2) N m/rad.
FULL, QUICK = range(2, 19), range(2, 19, 2)
#: Springs beyond this, N m/rad, are not shown ringing: a reference would take too long.
RINGING = {True: 1e6, False: 1e7}


class Spring(NamedTuple):
    """One method at one spring."""

    stiffness: float
    """N m/rad."""
    ringing: bool
    """Whether the start is off the slow manifold."""
    method: str
    turned: float
    """h omega of the larger step, rad."""
    errors: tuple[float | None, ...]
    """At each of STEPS, rad; None where the run failed or the error is not known."""
    order: float | None
    failed: bool
    reference: float
    """The reference's own error, rad."""


def sweep(reporter: Reporter, *, quick: bool) -> list[Spring]:
    """Every method at every spring, from both starts."""
    chosen = [10.0 ** (e / 2) for e in (QUICK if quick else FULL)]
    pairs = [(k, rings) for k in chosen for rings in (False, True) if not rings or k <= RINGING[quick]]
    tick = reporter.stage("Springs from soft to stiff", len(pairs))
    rows = []
    for stiffness, rings in pairs:
        case = cases.held(stiffness, ringing=rings)
        exact = ringing(case) if rings else reference(case, 20_000)
        for method in METHODS:
            run = runner(case, method.name)
            paths = [run(h, round(case.time / h)) for h in STEPS]
            errors = [None if path.failure else distance(case, exact.q, path.q[-1]) for path in paths]
            known = tuple(e if e is not None and e >= FAR * exact.error else None for e in errors)
            order = local(known[0], known[1]) if known[0] is not None and known[1] is not None else None
            failed = any(path.failure is not None for path in paths)
            rows.append(
                Spring(stiffness, rings, method.name, STEPS[0] * case.omega, known, order, failed, exact.error)
            )
        tick()
    return rows
