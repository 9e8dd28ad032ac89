"""Time a body on chains, by number of bodies: flat where the work is O(N)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from ... import _core
from ..pipeline import Section
from ..plotting import COLOURS, FAINT, SOFT, direct_labels, panels, styled, ticks
from ..progress import Reporter
from ..robot import Report, rust, spread
from ..text import count
from .accuracy import FORWARD

#: Times each chain is measured.
ROUNDS = 3
#: Chains that operators are applied on.
OPERATOR_SIZES = (10, 100, 1000, 10_000)
#: What is timed, and what it is called.
TIMED = {
    "forward": ("forward dynamics, auto", FORWARD, "auto"),
    "covariance": ("forward dynamics, covariance", FORWARD, "covariance"),
    "inverse": ("inverse dynamics", "Scene::evaluate(InverseDynamics)", None),
}


class Row(NamedTuple):
    """Time a body on a chain of equal links, ns: `Scene::evaluate` in Rust, one state a call."""

    bodies: int
    forward_ns_per_body: float
    covariance_ns_per_body: float
    inverse_ns_per_body: float

    def of(self, kind: str) -> float:
        """The time of one of TIMED."""
        return float(getattr(self, f"{kind}_ns_per_body"))


def growth(sizes: Sequence[int], repeats: int, reporter: Reporter) -> dict[str, Any]:
    """Time a body of forward and inverse dynamics, by number of bodies."""
    best = np.full((len(sizes), len(TIMED)), np.inf)
    # Other load only ever adds time, and rarely to the same size twice: the least of the rounds' medians.
    for row, bodies in reporter.each("Growth with size", list(zip(best, sizes, strict=True)) * ROUNDS):
        np.minimum(row, _core.growth(bodies, repeats), out=row)
    rows = [Row(bodies, *map(float, times)) for bodies, times in zip(sizes, best, strict=True)]
    spreads = {f"{kind}_max_over_min": spread([row.of(kind) for row in rows]) for kind in TIMED}
    return {"rows": rows, **{kind: rust(call, form, "chain") for kind, (_, call, form) in TIMED.items()}, **spreads}


def operators(repeats: int, reporter: Reporter) -> dict[str, Any]:
    """Time a body of applying every operator and its transpose (a star), by number of bodies."""
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


@styled
def _plot(rows: Sequence[Row]) -> tuple[str, Figure]:
    figure, ((axes,),) = panels((10.0, 3.3), margins=(0.075, 0.775, 0.95, 0.15))
    bodies = np.array([row.bodies for row in rows])
    limits = (bodies.min() / 1.25, bodies.max() * 1.25)
    axes.set(xscale="log", xlim=limits, xlabel="bodies in the chain", ylabel="time a body, ns")
    ticks(axes.xaxis, lambda value: count(round(value)))
    entries, highest = [], 0.0
    for (kind, (name, _, _)), ink in zip(TIMED.items(), (*COLOURS[:2], SOFT), strict=True):
        values = np.array([row.of(kind) for row in rows])
        axes.plot(bodies, values, "-o", color=ink, ms=4, lw=1.4)
        entries.append((float(bodies[-1]), float(values[-1]), f"{name}\nmax / min = {spread(values.tolist()):.2f}", ink))
        highest = max(highest, float(values.max()))
    axes.set_ylim(0.0, 1.15 * highest)
    axes.grid(axis="y", color=FAINT, lw=0.6)
    direct_labels(axes, entries, 0.2)
    return "growth", figure


SECTION = Section(
    "growth", "Growth with size", _collect, lambda report: [_plot(report.parts["growth"]["rows"])], shown=lambda _: ROUNDS
)
