"""M from the random model on the page: error against run time and against the number of samples, and the numbers of its tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from ..pipeline import Section
from ..plotting import COLOURS, DASHES, INK, SOFT, Plot, direct_labels, level, panels, power_ticks, styled, ticks, time_axis
from ..robot import EPS, Report
from ..text import minus, power, scientific, time
from .emergence import DENSE, PLAIN, RECURSION, SAMPLED, SIGMA, SOBOL, Emergence, Point, Slope, collect

#: By way, apart for all kinds of colour vision; names as the page has them.
INKS = {PLAIN: COLOURS[2], SOBOL: COLOURS[0], SIGMA: COLOURS[1], RECURSION: COLOURS[3], DENSE: SOFT}
NAMES = {
    PLAIN: "plain Monte Carlo",
    SOBOL: "scrambled Sobol points",
    SIGMA: "sigma points",
    RECURSION: "recursion (3.5)",
    DENSE: "dense product (5.1)",
}
#: The slopes that theory gives, as text.
THEORY = {PLAIN: "−1/2", SOBOL: "about −1"}
#: What may be missing here while the rest is not, and what the page calls it.
PARTS = {
    "sampling": "Samples",
    SOBOL: "Sobol points",
    PLAIN: "Plain Monte Carlo",
    DENSE: "Dense product",
    "samples a second": "Samples a second",
}


def _floor(error: float) -> float:
    """An error with a place on a logarithmic axis: one that is zero is drawn far below rounding."""
    return max(error, 1e-2 * EPS["float64"])


@styled
def error_against_time(found: Emergence) -> tuple[str, Figure]:
    """Error of M against the time from q to it, every way."""
    figure, ((axes,),) = panels((10.0, 5.0), margins=(0.075, 0.775, 0.975, 0.105))
    eps, points = EPS["float64"], found.points
    times, values = [point.ns_median for point in points], [_floor(point.error) for point in points]
    low, exact = min(times) / 2.0, max(point.ns_median for point in points if point.route not in SAMPLED)
    # The names of single points need room right of them.
    time_axis(axes, low, max(max(times) * 1.6, low * (exact / low) ** (1.0 / 0.6)))
    axes.set(yscale="log", ylim=(min([*values, eps]) / 6.0, max([*values, eps * 100.0]) * 5.0))
    axes.set(xlabel="median time from q to M, one thread", ylabel="relative error of M, Frobenius norm")
    power_ticks(axes.yaxis, 10)
    level(axes, eps)
    entries = [(axes.get_xlim()[1], eps, f"flat line of rounding,\neps = {scientific(eps)}", SOFT)]
    entries += [_curve(axes, found, route) for route in SAMPLED if found.along(route)]
    direct_labels(axes, entries, 0.1)
    _exact(axes, sorted((p for p in points if p.route not in SAMPLED), key=lambda point: point.ns_median))
    return "emergence", figure


def _curve(axes: Axes, found: Emergence, route: str) -> tuple[float, float, str, str]:
    """The points of one way, a line of the measured slope through the last one, and the label."""
    ink, line, points = INKS[route], found.slope(route), found.along(route)
    x, y = np.array([point.ns_median for point in points]), np.array([_floor(point.error) for point in points])
    axes.plot(x, y, "-o", color=ink, ms=4, lw=1.4, zorder=3)
    if line is None:
        return x[-1], y[-1], NAMES[route], ink
    # The time is proportional to the number of samples but for the setup, which bends the curve where they are few.
    axes.plot(x, y[-1] * (x / x[-1]) ** line.measured, color=ink, lw=0.9, ls=DASHES, alpha=0.7)
    return x[-1], y[-1], f"{NAMES[route]}\nslope {_slope(line)} (dashed)", ink


def _exact(axes: Axes, points: Sequence[Point]) -> None:
    """Single points, by time, with names above them in steps: the first is the highest, so that no line meets a name."""
    to_axes = axes.transData + axes.transAxes.inverted()
    places = [(point.ns_median, _floor(point.error)) for point in points]
    top = max((to_axes.transform(at)[1] for at in places), default=0.0)
    for k, (point, at) in enumerate(zip(points, places, strict=True)):
        ink, height = INKS[point.route], top + 0.09 + 0.075 * (len(points) - 1 - k)
        axes.plot(*at, "o", color=ink, ms=7, zorder=3)
        axes.annotate(
            f" {NAMES[point.route]}, {time(point.ns_median)}, error {scientific(point.error)}", xy=at,
            xytext=(float(to_axes.transform(at)[0]), height), textcoords="axes fraction", va="center", color=ink,
            arrowprops={"arrowstyle": "-", "color": ink, "lw": 0.6, "alpha": 0.55, "relpos": (0.0, 0.5), "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip


def _slope(line: Slope) -> str:
    return minus(f"{line.measured:.2f} ± {line.standard_error:.2f}")


@styled
def error_against_samples(found: Emergence) -> tuple[str, Figure]:
    """Error of M against the number of samples, with the lines whose slopes are measured."""
    figure, ((axes,),) = panels((10.0, 3.7), margins=(0.075, 0.775, 0.96, 0.14))
    samples = [point.samples for point in found.points if point.samples]
    values = [_floor(point.error) for point in found.points if point.samples]
    axes.set_xscale("log", base=2)
    axes.set(yscale="log", xlabel="samples", ylabel="relative error of M")
    axes.set(xlim=(min(samples) / 1.3, max(samples) * 1.3), ylim=(min(values) / 1.8, max(values) * 1.8))
    ticks(axes.xaxis, lambda value: power(round(np.log2(value)), 2), LogLocator(base=2, subs=(1.0,), numticks=20))
    power_ticks(axes.yaxis, 8)
    if max(values) < 30.0 * min(values):
        ticks(axes.yaxis, lambda value: scientific(value, 0), LogLocator(subs=(1.0, 2.0, 5.0)))
    direct_labels(axes, [_line(axes, found, route) for route in SAMPLED if found.along(route)], 0.2)
    return "emergence-slopes", figure


def _line(axes: Axes, found: Emergence, route: str) -> tuple[float, float, str, str]:
    points, ink, line = found.along(route), INKS[route], found.slope(route)
    n = np.array([point.samples or 1 for point in points], dtype=float)
    axes.plot(n, [_floor(point.error) for point in points], "o", color=ink, ms=4.5, zorder=3)
    if line is None:
        return n[-1], _floor(points[-1].error), NAMES[route], ink
    axes.plot(n, [line.error(one) for one in n], "-", color=ink, lw=1.2)
    text = f"{NAMES[route]}\nslope {_slope(line)}\ntheory {THEORY[route]}"
    if route == PLAIN and found.unit_error_in_theory is not None:
        # Where theory knows the error itself, and not its slope alone.
        axes.plot(n, found.unit_error_in_theory / np.sqrt(n), color=INK, lw=0.9, ls=DASHES)
        text += " (dashed)"
    return n[-1], line.error(n[-1]), text, ink


def _plots(report: Report) -> Iterable[Plot]:
    found: Emergence = report.parts["emergence"]
    if found.sampled():
        yield error_against_time(found)
        yield error_against_samples(found)


def _shown(report: Report) -> dict[str, Any]:
    """A row a way, at its largest number of samples where it takes one; and what is missing."""
    found: Emergence = report.parts["emergence"]
    ways = [(NAMES[route], ink, points[-1], THEORY.get(route, "exact")) for route, ink in INKS.items() if (points := found.along(route))]
    absent = {title: report.missing[part] for part, title in PARTS.items() if part in report.missing}
    return {"ways": ways, "recursion": found.along(RECURSION)[0].ns_median, "absent": absent}


SECTION = Section("emergence", "The mass matrix emerges", collect, _plots, shown=_shown)
