"""Plots and tables of M from the random model: error against run time and against the number of samples."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ..pipeline import Section
from ..plotting import COLORS, INK, SOFT, Axis, Chart, Panel, Plot, Series, level
from ..robot import EPS, Report
from ..text import minus, power
from .emergence import DENSE, PLAIN, RECURSION, SAMPLED, SIGMA, SOBOL, Emergence, Point, Slope, collect

#: Colors and names of the methods.
INKS = {PLAIN: COLORS[2], SOBOL: COLORS[0], SIGMA: COLORS[1], RECURSION: COLORS[3], DENSE: SOFT}
NAMES = {
    PLAIN: "plain Monte Carlo",
    SOBOL: "scrambled Sobol points",
    SIGMA: "sigma points",
    RECURSION: "recursion (3.5)",
    DENSE: "dense product (5.1)",
}
#: Theoretical slopes, as text.
THEORY = {PLAIN: "−1/2", SOBOL: "about −1"}
#: Parts that can be missing separately, and their names on the page.
PARTS = {
    "sampling": "Samples",
    SOBOL: "Sobol points",
    PLAIN: "Plain Monte Carlo",
    DENSE: "Dense product",
    "samples a second": "Samples per second",
}


def _floor(error: float) -> float:
    """Error for a logarithmic axis: zero is drawn far below the rounding error."""
    return max(error, 1e-2 * EPS)


def error_against_time(found: Emergence) -> Chart:
    """Error of M against the time from q to M, for every method."""
    eps, points = EPS, found.points
    times, values = [_seconds(point) for point in points], [_floor(point.error) for point in points]
    x = Axis.times("median time from q to M, one thread", min(times) / 2.0, max(times) * 2.0)
    y = Axis.powers("relative error of M", min([*values, eps]) / 6.0, max([*values, eps * 100.0]) * 5.0)
    series = [level("machine epsilon", eps, x)]
    for route in SAMPLED:
        if along := found.along(route):
            series += _curve(found, route, along)
    for point in points:
        if point.route not in SAMPLED:
            series.append(Series(NAMES[point.route], INKS[point.route], [_seconds(point)], [_floor(point.error)], mark=11))
    return Chart("emergence", [Panel(x, y, series)], height=360)


def _seconds(point: Point) -> float:
    return 1e-9 * point.ns_median


def _curve(found: Emergence, route: str, points: Sequence[Point]) -> Iterable[Series]:
    """Points of one method, and a line with the measured slope through the last one."""
    name, ink, line = _named(found, route), INKS[route], found.slope(route)
    x, y = np.array([_seconds(point) for point in points]), np.array([_floor(point.error) for point in points])
    yield Series(name, ink, x, y, line=1.6, mark=6)
    if line is not None:
        # The time is proportional to the number of samples, apart from a constant setup time.
        yield Series(name, ink, x, y[-1] * (x / x[-1]) ** line.measured, line=1.0, dash=True, shade=0.7, told=False)


def _named(found: Emergence, route: str) -> str:
    line = found.slope(route)
    return NAMES[route] if line is None else f"{NAMES[route]}, slope {_slope(line)}, theory {THEORY[route]}"


def _slope(line: Slope) -> str:
    return minus(f"{line.measured:.2f} ± {line.standard_error:.2f}")


def error_against_samples(found: Emergence) -> Chart:
    """Error of M against the number of samples, with the fitted lines."""
    samples = [point.samples for point in found.points if point.samples]
    values = [_floor(point.error) for point in found.points if point.samples]
    low, high = min(samples) / 1.3, max(samples) * 1.3
    exponents = range(math.ceil(math.log2(low)), math.floor(math.log2(high)) + 1, 2)
    x = Axis("samples", low, high, [(2.0**one, power(one, 2)) for one in exponents], True, form="d")
    y = Axis.powers("relative error of M", min(values) / 1.8, max(values) * 1.8)
    series: list[Series] = []
    for route in SAMPLED:
        if found.along(route):
            series += _line(found, route)
    return Chart("emergence-slopes", [Panel(x, y, series)])


def _line(found: Emergence, route: str) -> Iterable[Series]:
    points, ink, line, name = found.along(route), INKS[route], found.slope(route), _named(found, route)
    n = np.array([point.samples or 1 for point in points], dtype=float)
    yield Series(name, ink, n, [_floor(point.error) for point in points], mark=7)
    if line is not None:
        yield Series(name, ink, n, [line.error(one) for one in n], line=1.2, told=False)
    if route == PLAIN and found.unit_error_in_theory is not None:
        # For independent samples the theory gives the error and not only the slope.
        yield Series("independent samples, theory", INK, n, found.unit_error_in_theory / np.sqrt(n), line=1.2, dash=True)


def _plots(report: Report) -> Iterable[Plot]:
    found: Emergence = report.parts["emergence"]
    if found.sampled():
        yield error_against_time(found)
        yield error_against_samples(found)


def _shown(report: Report) -> dict[str, Any]:
    """One row per method, at its largest number of samples if it takes one; and missing parts."""
    found: Emergence = report.parts["emergence"]
    ways = [(NAMES[route], ink, points[-1], THEORY.get(route, "exact")) for route, ink in INKS.items() if (points := found.along(route))]
    absent = {title: report.missing[part] for part, title in PARTS.items() if part in report.missing}
    return {"ways": ways, "recursion": found.along(RECURSION)[0].ns_median, "absent": absent}


SECTION = Section("emergence", "The mass matrix from random forces", collect, _plots, shown=_shown)
