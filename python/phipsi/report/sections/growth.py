"""Time per body on chains, by number of bodies: constant if the time is O(N)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ... import _core
from ..pipeline import Section
from ..plotting import COLORS, SOFT, Axis, Chart, Panel, Series, log_ticks
from ..progress import Reporter
from ..robot import Report, rust, spread
from ..text import count
from .accuracy import FORWARD

#: Number of measurements of each chain.
ROUNDS = 3
#: Sizes of the chains for operators.
OPERATOR_SIZES = (10, 100, 1000, 10_000)
#: Timed calls and their names.
TIMED = {
    "forward": ("forward dynamics, auto", FORWARD, "auto"),
    "covariance": ("forward dynamics, covariance", FORWARD, "covariance"),
    "inverse": ("inverse dynamics", "Scene::evaluate(InverseDynamics)", None),
}


class Row(NamedTuple):
    """Time per body on a chain of equal links, ns: `Scene::evaluate` in Rust, one state per call."""

    bodies: int
    forward_ns_per_body: float
    covariance_ns_per_body: float
    inverse_ns_per_body: float

    def of(self, kind: str) -> float:
        """Time of one of TIMED."""
        return float(getattr(self, f"{kind}_ns_per_body"))


def growth(sizes: Sequence[int], repeats: int, reporter: Reporter) -> dict[str, Any]:
    """Time per body of forward and inverse dynamics, by number of bodies."""
    best = np.full((len(sizes), len(TIMED)), np.inf)
    # Other load only increases times; the minimum over the rounds of the medians removes it.
    for row, bodies in reporter.each("Growth with size", list(zip(best, sizes, strict=True)) * ROUNDS):
        np.minimum(row, _core.growth(bodies, repeats), out=row)
    rows = [Row(bodies, *map(float, times)) for bodies, times in zip(sizes, best, strict=True)]
    spreads = {f"{kind}_max_over_min": spread([row.of(kind) for row in rows]) for kind in TIMED}
    return {"rows": rows, **{kind: rust(call, form, "chain") for kind, (_, call, form) in TIMED.items()}, **spreads}


def operators(repeats: int, reporter: Reporter) -> dict[str, Any]:
    """Time per body of every operator and its transpose (a star), by number of bodies."""
    best: dict[str, list[float]] = {}
    for at, bodies in reporter.each("Operators on chains", list(enumerate(OPERATOR_SIZES)) * ROUNDS):
        for name, ns in _core.operator_growth(bodies, repeats):
            times = best.setdefault(name, [float("inf")] * len(OPERATOR_SIZES))
            times[at] = min(times[at], ns)
    rows = [{"name": name, "ns_per_body": times, "max_over_min": spread(times)} for name, times in best.items()]
    return {"of": rust("Operator::apply, Operator::apply_transpose", "auto", "chain"), "bodies": OPERATOR_SIZES, "rows": rows}


def _collect(report: Report, reporter: Reporter) -> dict[str, Any]:
    effort = report.effort
    return growth(effort.sizes, effort.growth_repeats, reporter) | {"operators": operators(effort.growth_repeats, reporter)}


def _plot(rows: Sequence[Row]) -> Chart:
    bodies = [float(row.bodies) for row in rows]
    low, high = min(bodies) / 1.25, max(bodies) * 1.25
    x = Axis("bodies in the chain", low, high, log_ticks(low, high, lambda value: count(round(value))), True)
    series = []
    for (kind, (name, _, _)), ink in zip(TIMED.items(), (*COLORS[:2], SOFT), strict=True):
        values = [row.of(kind) for row in rows]
        series.append(Series(f"{name}, largest / smallest {spread(values):.2f}", ink, bodies, values, line=1.6, mark=6))
    highest = max(float(np.max(one.y)) for one in series)
    return Chart("growth", [Panel(x, Axis("time per body, ns", 0.0, 1.15 * highest, form=".3~g"), series)], height=260)


SECTION = Section("growth", "Time against the number of bodies", _collect, lambda report: [_plot(report.parts["growth"]["rows"])], shown=lambda _: ROUNDS)
