"""Time of a step: for a single state, and per state in a batch, on one thread."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from .cases import Case
from .peers import Peer
from .runs import METHODS, ROWS

#: Number of states of a batch.
BATCH = 64
#: Approximate product of steps, stages and degrees of freedom in a timed run.
WORK = 6000


def times(case: Case, peers: list[Peer], turns: int) -> tuple[dict[str, float], dict[str, float]]:
    """Time of a step, ns, for a single state, and per state in a batch; the minimum of several timings, because other
    load only increases times. Peers compute states one by one.

    The time does not depend on the step size, except for states that `form="auto"` recomputes.
    """
    # So small that explicit methods remain stable with springs.
    dt = 1e-3 / max(case.omega, 1.0 / case.time)
    alone: dict[str, Callable[[], float]] = {}
    batch: dict[str, Callable[[], float]] = {}
    for method in METHODS:
        work = WORK / (method.stages * (case.scene.nv + 2))
        alone[method.name] = _simulated(case, method.name, dt, ROWS * max(1, round(work / ROWS)), 1)
        batch[method.name] = _simulated(case, method.name, dt, max(2, round(4 * work / BATCH)), BATCH)
    for peer in peers:
        if peer.timed:
            work = WORK / (peer.stages * (case.scene.nv + 2))
            alone[peer.name] = _stepped(case, peer, dt, ROWS * max(1, round(4 * work / ROWS)))
    return _least(alone, turns), _least(batch, turns)


def _simulated(case: Case, method: str, dt: float, steps: int, states: int) -> Callable[[], float]:
    q, qd = (np.tile(x, (states, 1)) if states > 1 else x for x in (case.q, case.qd))

    def once() -> float:
        start = time.perf_counter_ns()
        case.scene.simulate(q, qd, dt=dt, steps=steps, method=method, record_every=steps)
        return (time.perf_counter_ns() - start) / (steps * states)

    return once


def _stepped(case: Case, peer: Peer, dt: float, steps: int) -> Callable[[], float]:
    run = peer.runner(case)

    def once() -> float:
        start = time.perf_counter_ns()
        run(dt, steps)
        return (time.perf_counter_ns() - start) / steps

    return once


def _least(runs: dict[str, Callable[[], float]], turns: int) -> dict[str, float]:
    for run in runs.values():
        run()
    taken = [{name: run() for name, run in runs.items()} for _ in range(turns)]
    return {name: min(row[name] for row in taken) for name in runs}
