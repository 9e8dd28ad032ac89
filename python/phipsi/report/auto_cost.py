"""What form "auto" costs beside "covariance", by kind of state: Python calls, one state and a batch.

benches/auto_states.py runs it against wheels that are older than it: numpy, the public names of phipsi and kinds.py are all it uses.
"""

from __future__ import annotations

import statistics
import sys
import sysconfig
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import phipsi

from . import kinds

#: States of a batch.
BATCH = 256
#: States that are called one by one.
SINGLE = 16
FORMS = ("auto", "covariance")
#: Each pair is timed this often, in turns; quick: the second.
TURNS = (15, 5)
#: ns that a turn takes at least; quick: the second.
LEAST = (400_000, 100_000)
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


def measured(scene: phipsi.Scene, drawn: kinds.Drawn, *, quick: bool = False) -> list[Cost]:
    """The cost of every kind, one state and the batch of `drawn`; without a kind whose states have no answer."""
    rows = []
    with one_thread():
        for kind in kinds.KINDS:
            q, qd, tau = kinds.state(scene, drawn, kind)
            rows += [_cost(scene, kind, size, q, qd, tau, quick) for size in (1, len(q))]
    return [row for row in rows if row is not None]


def _cost(
    scene: phipsi.Scene, kind: str, size: int, q: kinds.Array, qd: kinds.Array, tau: kinds.Array, quick: bool
) -> Cost | None:
    calls = [(q, qd, tau)] if size > 1 else [tuple(map(np.array, one)) for one in zip(q, qd, tau)][:SINGLE]  # noqa: B905

    def loop(form: str) -> Callable[[], None]:
        def once() -> None:
            for call in calls:
                scene.forward_dynamics(*call, form=form)  # type: ignore[call-overload]

        return once

    states = size * len(calls)
    try:
        pairs = [
            tuple(_ns(loop(form), LEAST[quick]) / states for form in FORMS) for _ in range(TURNS[quick] + 1)
        ][1:]  # the first warms up
    except phipsi.errors.PhipsiError:
        return None
    auto, covariance = (statistics.median(times) for times in zip(*pairs))  # noqa: B905
    return Cost(kind, size, auto, covariance, statistics.median(a / c for a, c in pairs))


def _ns(once: Callable[[], None], least: int) -> float:
    """Time of one run, over as many as take `least` ns."""
    runs, start = 0, time.perf_counter_ns()
    while True:
        once()
        runs += 1
        elapsed = time.perf_counter_ns() - start
        if elapsed >= least:
            return elapsed / runs


@contextmanager
def one_thread() -> Iterator[None]:
    """Batches on one thread, and afterwards on as many as before."""
    before = phipsi.get_num_threads()
    phipsi.set_num_threads(1)
    try:
        yield
    finally:
        phipsi.set_num_threads(before)


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
    sources: Mapping[str, str | Path], *, quick: bool = False, seed: int = 0, tick: Callable[[], None] = lambda: None
) -> dict[tuple[str, str], list[Cost]]:
    """The costs on every robot (a path or URDF text by name), on a fixed and on a free base."""
    found = {}
    for base, floating in BASES.items():
        for name, source in sources.items():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)
                scene = phipsi.Scene.from_urdf(source, floating_base=floating)
            if scene.nv:
                found[base, name] = measured(scene, kinds.draw(scene, BATCH, seed), quick=quick)
            tick()
    return found


def table(costs: Costs, batch: bool) -> tuple[list[str], list[list[str]]]:
    """Robots, and a row a base and kind: auto over covariance, for the batch or for one state a call."""
    robots = list(dict.fromkeys(robot for _, robot in costs))
    rows = []
    for base in dict.fromkeys(base for base, _ in costs):
        for kind in kinds.KINDS:
            cells = [
                next((f"{row.ratio:.2f}" for row in costs.get((base, robot), ()) if _is(row, kind, batch)), "–")
                for robot in robots
            ]
            rows.append([f"{base}, {kind}", *cells])
    return robots, rows


def _is(row: Cost, kind: str, batch: bool) -> bool:
    return row.kind == kind and (row.batch > 1) is batch


#: What the tables show.
TITLE = "forward_dynamics from Python, form auto over covariance (medians, one thread)"
SIZES = {True: f"batches of {BATCH}", False: "one state a call"}


def markdown(costs: Costs) -> str:
    """Both tables as Markdown, with the times of the worst case, and what the kinds are."""
    parts = [f"phipsi {phipsi.__version__}: {TITLE}"]
    for batch, title in SIZES.items():
        robots, rows = table(costs, batch)
        lines = [[title, *robots], ["---"] + ["---:"] * len(robots), *rows]
        parts.append("\n".join(f"| {' | '.join(line)} |" for line in lines))
    every = [(row, base, robot) for (base, robot), rows in costs.items() for row in rows]
    row, base, robot = max(every, key=lambda one: one[0].ratio)
    size = f"a batch of {row.batch}" if row.batch > 1 else "one state a call"
    parts.append(
        f"Worst: {robot}, {base}, {row.kind}, {size}: auto {row.auto:.0f} ns a state, covariance {row.covariance:.0f}."
    )
    parts.append("\n".join(f"- {kind}: {meaning}" for kind, meaning in kinds.MEANING.items()))
    return "\n\n".join(parts)
