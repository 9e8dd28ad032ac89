"""Time of form "auto" relative to "covariance" by kind of state: Python calls, one state and a batch.

benches/auto_states.py also runs this file with older wheels. Therefore it uses only public names of phipsi,
kinds.py and timing.py.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

import phipsi

from phipsi import examples
from . import kinds
from .timing import BATCH, Arguments, in_turns, looped, one_by_one, threads

FORMS = ("auto", "covariance")
#: Robots of example-robot-data, below its folder robots/.
ROBOTS = {
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "panda": "panda_description/urdf/panda.urdf",
    "anymal": "anymal_b_simple_description/robots/anymal.urdf",
    "g1": "g1_description/urdf/g1_29dof_rev_1_0.urdf",
    "talos": "talos_data/robots/talos_reduced.urdf",
}


@dataclass(frozen=True)
class Cost:
    """Times of `scene.forward_dynamics(q, qd, tau, form=...)` called from Python on one thread, ns per state,
    medians.
    """

    kind: str
    batch: int
    """Number of states per call."""
    auto: float
    covariance: float
    ratio: float
    """auto relative to covariance: median over the interleaved timings."""


def of_kind(scene: phipsi.Scene, drawn: kinds.Drawn, kind: str, quick: bool) -> list[Cost]:
    """Times of one kind, for one state and for the batch of `drawn`, without calls that raise."""
    rows, states = [], kinds.state(scene, drawn, kind)
    with threads(1):
        for size, calls in ((1, one_by_one(states)), (len(drawn.q), [states])):
            try:
                rows.append(_cost(scene, kind, size, calls, quick))
            except phipsi.errors.PhipsiError:
                continue
    return rows


def measured(scene: phipsi.Scene, drawn: kinds.Drawn, *, quick: bool = False) -> list[Cost]:
    """Times of every kind."""
    return [row for kind in kinds.KINDS for row in of_kind(scene, drawn, kind, quick)]


def _cost(scene: phipsi.Scene, kind: str, size: int, calls: Sequence[Arguments], quick: bool) -> Cost:
    forms = [looped(partial(scene.forward_dynamics, form=form), calls) for form in FORMS]
    times = in_turns(forms, quick) / (size * len(calls))
    auto, covariance = map(float, np.median(times, axis=0))
    return Cost(kind, size, auto, covariance, float(np.median(times[:, 0] / times[:, 1])))


def example_robots() -> dict[str, Path]:
    """Robots of example-robot-data by name, if this interpreter has the package."""
    folder = examples.folder()
    return {} if folder is None else {name: folder / path for name, path in ROBOTS.items() if (folder / path).is_file()}


#: Results by base and robot.
Costs = Mapping[tuple[str, str], Sequence[Cost]]
BASES = {"fixed base": False, "free base": True}


def of_robots(
    sources: Mapping[str, str | Path],
    *,
    quick: bool = False,
    seed: int = 0,
    each: Callable[[Sequence[tuple[str, str]]], Iterable[tuple[str, str]]] = iter,
    read: Callable[..., phipsi.Scene] = phipsi.load,
) -> dict[tuple[str, str], list[Cost]]:
    """Times for every robot (a source of phipsi.load by name), with a fixed and a free base; `each` iterates over the
    cases, and `read` reads a source.
    """
    found = {}
    for base, name in each([(base, name) for base in BASES for name in sources]):
        scene = _on(sources[name], BASES[base], read)
        if scene is not None and scene.nv:
            found[base, name] = measured(scene, kinds.draw(scene, BATCH, seed), quick=quick)
    return found


def _on(source: str | Path, floating: bool, read: Callable[..., phipsi.Scene]) -> phipsi.Scene | None:
    """The robot with that base; None if the robot already has a free base, or its file determines the base."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            return read(source, floating_base=floating)
        except phipsi.errors.PhipsiError:
            if not floating:
                raise
            return None


def table(costs: Costs, batch: bool) -> tuple[list[str], list[list[str]]]:
    """Robots, and one row per base and kind: auto relative to covariance, for the batch or for one state per call."""
    robots = list(dict.fromkeys(robot for _, robot in costs))
    rows = []
    for base in dict.fromkeys(base for base, _ in costs):
        for kind in kinds.KINDS:
            wanted = [[row for row in costs.get((base, robot), ()) if (row.kind, row.batch > 1) == (kind, batch)] for robot in robots]
            rows.append([f"{base}, {kind}", *(f"{found[0].ratio:.2f}" if found else "–" for found in wanted)])
    return robots, rows


#: Title of the tables.
TITLE = "forward_dynamics from Python, time of form auto relative to covariance (medians, one thread)"
SIZES = {True: f"batches of {BATCH}", False: "one state per call"}
