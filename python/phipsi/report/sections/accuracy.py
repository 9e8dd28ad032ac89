"""Error against run time: every method in both precisions, against double-double."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ... import _core
from ..pipeline import Section
from ..plotting import COLOURS, Axis, Chart, Panel, Plot, Series, level
from ..progress import Reporter
from ..robot import DENSE_CAP, EPS, PRECISIONS, Report, median, rust
from ..states import Array
from ..text import symbols
from ..timing import Of

#: Times each method is measured, in turns with the others.
ROUNDS = 5
#: Beyond this many degrees of freedom M^-1 is not formed.
INVERSE_CAP = 2000
#: What forward dynamics is called in Rust.
FORWARD = _core.method_call(_core.METHODS[0])[0]


@dataclass(frozen=True)
class Accuracy:
    """One method in one precision over all states; error and time are of the same calls."""

    method: str
    precision: str
    ns_per_state: float
    """Median time of `Scene::evaluate` in Rust, one state a call."""
    errors: Array
    """Of each state: largest error over largest acceleration; NaN where the method met a bad pivot."""

    @property
    def of(self) -> Of:
        """What is timed."""
        return rust(*_core.method_call(self.method))

    @property
    def error_median(self) -> float:
        """Of the states where it did not fail."""
        return median(self.errors)

    @property
    def error_max(self) -> float:
        """The same."""
        return float(np.max(self.errors[np.isfinite(self.errors)], initial=-np.inf)) if self.failed_states < len(self.errors) else np.nan

    @property
    def failed_states(self) -> int:
        """States where the method met a bad pivot."""
        return int(np.count_nonzero(~np.isfinite(self.errors)))

    @property
    def digits_lost(self) -> float:
        """log10 of the median error in units of eps; below zero where it is less than one unit."""
        return self.digits(self.error_median)

    def colour(self) -> str:
        """Its colour in every plot and table."""
        return COLOURS[_core.METHODS.index(self.method) % len(COLOURS)]

    def digits(self, error: float) -> float:
        """The same of an error."""
        return float(np.log10(max(error, 1e-300) / EPS[self.precision])) if np.isfinite(error) else float("nan")


def accuracy(report: Report, reporter: Reporter) -> list[Accuracy]:
    """Error against run time: every method in both precisions, against double-double, `auto` first.

    The time is the median over the rounds of each round's median of some passes. Large scenes go without what forms a matrix.
    """
    scene, states, methods = report.scene, report.solvable, _core.METHODS
    if scene.nv > DENSE_CAP:
        inverse = scene.nv <= INVERSE_CAP
        methods = tuple(m for m in methods if _core.method_call(m)[0] == FORWARD or (inverse and "M^-1" in m))
    reference = _core.reference(scene, *states.arrays)
    cases = [(method, precision) for precision in PRECISIONS for method in methods]
    # In rounds, so that a change of the machine's pace falls on all methods alike.
    rounds = [
        [_core.measure(scene, *case, *states.arrays, reference, report.effort.repeats) for case in cases]
        for _ in reporter.each("Error against run time", range(ROUNDS))
    ]
    times = np.median([[ns for ns, _ in row] for row in rounds], axis=0)
    return [Accuracy(*case, float(ns), errors) for case, ns, (_, errors) in zip(cases, times, rounds[-1], strict=True)]


def _plots(report: Report) -> Iterable[Plot]:
    rows: list[Accuracy] = report.parts["accuracy"]
    if any(row.failed_states < len(row.errors) for row in rows):
        yield error_against_time(rows)


def error_against_time(rows: Sequence[Accuracy]) -> Chart:
    """Median time of a call of `Scene::evaluate` against the error of every state, one panel a precision on the same axis of times."""
    usable = [row for row in rows if np.isfinite(row.error_median)]
    times = [1e-9 * row.ns_per_state for row in usable]
    x = Axis.times("median time of a call in Rust, one state", min(times) / 1.5, max(times) * 1.25)
    # The better precision, which most use, comes first.
    return Chart("error-against-time", [_panel([row for row in usable if row.precision == one], one, x) for one in PRECISIONS])


def _panel(rows: Sequence[Accuracy], precision: str, x: Axis) -> Panel:
    eps = EPS[precision]
    errors = [np.maximum(row.errors[np.isfinite(row.errors)], eps * 1e-3) for row in rows]
    low = min([eps / 4, *(float(np.quantile(e, 0.02)) for e in errors)])
    high = max([eps * 12, *(float(e.max()) for e in errors)])
    y = Axis.powers("relative error of accelerations", low / 1.8, high * 2.2)
    series = [level("one unit of rounding (eps)", eps, x)]
    generator = np.random.default_rng(0)
    for row, values in zip(rows, errors, strict=True):
        name, ink, at = symbols(row.method), row.colour(), 1e-9 * row.ns_per_state
        # Beside each other, so that each is seen.
        spread = at * np.exp(generator.uniform(-0.02, 0.02, len(values)))
        series += [
            Series(name, ink, spread, values, mark=4, shade=0.3, told=False),
            Series(name, ink, [at, at], [row.error_median, row.error_max], line=1.0, told=False),
            Series(name, ink, [at], [row.error_max], mark=10, symbol="dash", note="worst state"),
            Series(name, ink, [at], [row.error_median], mark=10, hollow=precision == "float32", note="median"),
        ]
    return Panel(x, y, series, precision)


SECTION = Section("accuracy", "Error and run time of every method", accuracy, _plots, empty=[])
