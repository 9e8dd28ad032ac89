"""What form "auto" costs beside "covariance", by kind of state: Python calls, one state and a batch.

benches/auto_states.py runs it against wheels that are older than it: the public names of phipsi, kinds.py and timing.py are all it uses.
"""

from __future__ import annotations

import sys
import sysconfig
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

import phipsi

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
    """Times of `scene.forward_dynamics(q, qd, tau, form=...)` called from Python on one thread, ns a state, medians."""

    kind: str
    batch: int
    """States of a call; 1: a call a state."""
    auto: float
    covariance: float
    ratio: float
    """auto over covariance: median over the turns, in each of which one follows the other."""


def of_kind(scene: phipsi.Scene, drawn: kinds.Drawn, kind: str, quick: bool) -> list[Cost]:
    """The cost of one kind, one state and the batch of `drawn`; without what has no answer."""
    rows, states = [], kinds.state(scene, drawn, kind)
    with threads(1):
        for size, calls in ((1, one_by_one(states)), (len(drawn.q), [states])):
            try:
                rows.append(_cost(scene, kind, size, calls, quick))
            except phipsi.errors.PhipsiError:
                continue
    return rows


def measured(scene: phipsi.Scene, drawn: kinds.Drawn, *, quick: bool = False) -> list[Cost]:
    """The cost of every kind."""
    return [row for kind in kinds.KINDS for row in of_kind(scene, drawn, kind, quick)]


def _cost(scene: phipsi.Scene, kind: str, size: int, calls: Sequence[Arguments], quick: bool) -> Cost:
    forms = [looped(partial(scene.forward_dynamics, form=form), calls) for form in FORMS]
    times = in_turns(forms, quick) / (size * len(calls))
    auto, covariance = map(float, np.median(times, axis=0))
    return Cost(kind, size, auto, covariance, float(np.median(times[:, 0] / times[:, 1])))


def example_robots() -> dict[str, Path]:
    """The robots of example-robot-data where this interpreter has them, by name."""
    # Of the wheel, and of conda.
    prefixes = Path(sysconfig.get_path("purelib")) / "cmeel.prefix", Path(sys.prefix)
    folders = [prefix / "share" / "example-robot-data" / "robots" for prefix in prefixes]
    return {
        name: folder / path for name, path in ROBOTS.items() for folder in reversed(folders) if (folder / path).is_file()
    }


#: Kind of base, robot, and what was measured.
Costs = Mapping[tuple[str, str], Sequence[Cost]]
BASES = {"fixed base": False, "free base": True}


def of_robots(
    sources: Mapping[str, str | Path],
    *,
    quick: bool = False,
    seed: int = 0,
    each: Callable[[Sequence[tuple[str, str]]], Iterable[tuple[str, str]]] = iter,
) -> dict[tuple[str, str], list[Cost]]:
    """The costs on every robot (a path or URDF text by name), on a fixed and on a free base; `each` hands them out."""
    found = {}
    for base, name in each([(base, name) for base in BASES for name in sources]):
        scene = _on(sources[name], BASES[base])
        if scene is not None and scene.nv:
            found[base, name] = measured(scene, kinds.draw(scene, BATCH, seed), quick=quick)
    return found


def _on(source: str | Path, floating: bool) -> phipsi.Scene | None:
    """The robot on that base; None where a free one cannot be: it floats already."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            return phipsi.Scene.from_urdf(source, floating_base=floating)
        except phipsi.errors.PhipsiError:
            if not floating:
                raise
            return None


def table(costs: Costs, batch: bool) -> tuple[list[str], list[list[str]]]:
    """Robots, and a row a base and kind: auto over covariance, for the batch or for one state a call."""
    robots = list(dict.fromkeys(robot for _, robot in costs))
    rows = []
    for base in dict.fromkeys(base for base, _ in costs):
        for kind in kinds.KINDS:
            wanted = [[row for row in costs.get((base, robot), ()) if (row.kind, row.batch > 1) == (kind, batch)] for robot in robots]
            rows.append([f"{base}, {kind}", *(f"{found[0].ratio:.2f}" if found else "–" for found in wanted)])
    return robots, rows


#: What the tables show.
TITLE = "forward_dynamics from Python, form auto over covariance (medians, one thread)"
SIZES = {True: f"batches of {BATCH}", False: "one state a call"}
