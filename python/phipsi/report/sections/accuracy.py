"""Error against run time: every method, compared with double-double arithmetic."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ... import _core
from ..pipeline import Section
from ..plotting import COLORS, Axis, Chart, Panel, Plot, Series, level
from ..progress import Reporter
from ..robot import DENSE_CAP, EPS, Report, median, rust
from ..states import Array
from ..text import symbols
from ..timing import Of

#: Number of interleaved measurements of each method.
ROUNDS = 5
#: Largest number of degrees of freedom for which M^-1 is formed.
INVERSE_CAP = 2000
#: Name of forward dynamics in Rust.
FORWARD = _core.method_call(_core.METHODS[0])[0]


@dataclass(frozen=True)
class Accuracy:
    """One method over all states; error and time belong to the same calls."""

    method: str
    ns_per_state: float
    """Median time of `Scene::evaluate` in Rust, one state per call."""
    errors: Array
    """Largest error relative to the largest acceleration, of each state; NaN if the method encountered an invalid
    pivot.
    """

    @property
    def of(self) -> Of:
        """Description of the timed call."""
        return rust(*_core.method_call(self.method))

    @property
    def error_median(self) -> float:
        """Median over the states without failure."""
        return median(self.errors)

    @property
    def error_max(self) -> float:
        """Maximum over the states without failure."""
        return float(np.max(self.errors[np.isfinite(self.errors)], initial=-np.inf)) if self.failed_states < len(self.errors) else np.nan

    @property
    def failed_states(self) -> int:
        """Number of states in which the method encountered an invalid pivot."""
        return int(np.count_nonzero(~np.isfinite(self.errors)))

    @property
    def digits_lost(self) -> float:
        """log10 of the median error in units of eps; negative if it is less than one unit."""
        return self.digits(self.error_median)

    def color(self) -> str:
        """Color in all plots and tables."""
        return COLORS[_core.METHODS.index(self.method) % len(COLORS)]

    def digits(self, error: float) -> float:
        """log10 of an error in units of eps."""
        return float(np.log10(max(error, 1e-300) / EPS)) if np.isfinite(error) else float("nan")


def accuracy(report: Report, reporter: Reporter) -> list[Accuracy]:
    """Error against run time: every method, compared with double-double arithmetic, `auto` first.

    The time is the median over the rounds of the median over the passes of each round. Methods that form a
    matrix are omitted for large scenes.
    """
    scene, states, methods = report.scene, report.solvable, _core.METHODS
    if scene.nv > DENSE_CAP:
        inverse = scene.nv <= INVERSE_CAP
        methods = tuple(m for m in methods if _core.method_call(m)[0] == FORWARD or (inverse and "M^-1" in m))
    reference = _core.reference(scene, *states.arrays)
    # Interleaved, so that changes of the clock rate affect all methods equally.
    rounds = [
        [_core.measure(scene, method, *states.arrays, reference, report.effort.repeats) for method in methods]
        for _ in reporter.each("Error against run time", range(ROUNDS))
    ]
    times = np.median([[ns for ns, _ in row] for row in rounds], axis=0)
    return [Accuracy(method, float(ns), errors) for method, ns, (_, errors) in zip(methods, times, rounds[-1], strict=True)]


def _plots(report: Report) -> Iterable[Plot]:
    rows: list[Accuracy] = report.parts["accuracy"]
    if any(row.failed_states < len(row.errors) for row in rows):
        yield error_against_time(rows)


def error_against_time(rows: Sequence[Accuracy]) -> Chart:
    """Median time of `Scene::evaluate` against the error of every state."""
    usable = [row for row in rows if np.isfinite(row.error_median)]
    times = [1e-9 * row.ns_per_state for row in usable]
    x = Axis.times("median time of a call in Rust, one state", min(times) / 1.5, max(times) * 1.25)
    errors = [np.maximum(row.errors[np.isfinite(row.errors)], EPS * 1e-3) for row in usable]
    low = min([EPS / 4, *(float(np.quantile(e, 0.02)) for e in errors)])
    high = max([EPS * 12, *(float(e.max()) for e in errors)])
    y = Axis.powers("relative error of accelerations", low / 1.8, high * 2.2)
    series = [level("machine epsilon", EPS, x)]
    generator = np.random.default_rng(0)
    for row, values in zip(usable, errors, strict=True):
        name, ink, at = symbols(row.method), row.color(), 1e-9 * row.ns_per_state
        # Spread horizontally, so that points do not overlap.
        spread = at * np.exp(generator.uniform(-0.02, 0.02, len(values)))
        series += [
            Series(name, ink, spread, values, mark=4, shade=0.3, told=False),
            Series(name, ink, [at, at], [row.error_median, row.error_max], line=1.0, told=False),
            Series(name, ink, [at], [row.error_max], mark=10, symbol="dash", note="worst state"),
            Series(name, ink, [at], [row.error_median], mark=10, note="median"),
        ]
    return Chart("error-against-time", [Panel(x, y, series)])


SECTION = Section("accuracy", "Error and run time of every method", accuracy, _plots, empty=[])
