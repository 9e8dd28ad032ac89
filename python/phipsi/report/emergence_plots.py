"""The plots of M from the random model: error against run time, and against the number of samples."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from .emergence import DENSE, PLAIN, RECURSION, SAMPLED, SIGMA, SOBOL, Emergence, Point, Slope
from .figure import COLOURS, INK, STYLE, Plot, direct_labels, finished, power_ticks, time_axis
from .measure import EPS
from .text import minus, power, scientific, time

GREY = "#6b7279"
#: By way, apart for all kinds of colour vision; names as the page has them.
INKS = {PLAIN: COLOURS[2], SOBOL: COLOURS[0], SIGMA: COLOURS[1], RECURSION: COLOURS[3], DENSE: GREY}
NAMES = {
    PLAIN: "plain Monte Carlo",
    SOBOL: "scrambled Sobol points",
    SIGMA: "sigma points",
    RECURSION: "recursion (3.5)",
    DENSE: "dense product (5.1)",
}
#: The slopes that theory gives, as text.
THEORY = {PLAIN: "−1/2", SOBOL: "about −1"}
DASHES = (0, (4, 3))


def _floor(error: float) -> float:
    """An error with a place on a logarithmic axis: one that is zero is drawn far below rounding."""
    return max(error, 1e-2 * EPS["float64"])


def error_against_time(found: Emergence) -> Plot:
    """Error of M against the time from q to it, every way."""
    times = [point.ns for point in found.points]
    values = [_floor(point.error) for point in found.points]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 5.0))
        axes = figure.subplots()
        figure.subplots_adjust(left=0.075, right=0.775, top=0.975, bottom=0.105)
        low, exact = min(times) / 2.0, max(point.ns for point in found.points if point.route not in SAMPLED)
        # The names of single points need room right of them.
        time_axis(axes, low, max(max(times) * 1.6, low * (exact / low) ** (1.0 / 0.6)))
        axes.set_yscale("log")
        axes.set_ylim(min([*values, EPS["float64"]]) / 6.0, max([*values, EPS["float64"] * 100.0]) * 5.0)
        power_ticks(axes.yaxis, 10)
        axes.set_xlabel("median time from q to M, one thread")
        axes.set_ylabel("relative error of M, Frobenius norm")
        eps = EPS["float64"]
        axes.axhline(eps, color="#8a9199", lw=0.8, ls=DASHES)
        entries = [(axes.get_xlim()[1], eps, f"flat line of rounding,\neps = {scientific(eps)}", GREY)]
        for route in SAMPLED:
            points = found.of(route)
            if points:
                entries.append(_curve(axes, points, route, found.slopes.get(route)))
        direct_labels(axes, entries, 0.1)
        _exact(axes, sorted((p for p in found.points if p.route not in SAMPLED), key=lambda point: point.ns))
        return finished("emergence", figure)


def _curve(axes: Axes, points: Sequence[Point], route: str, line: Slope | None) -> tuple[float, float, str, str]:
    """The points of one way, a line of the measured slope through the last one, and the label."""
    ink = INKS[route]
    x, y = np.array([point.ns for point in points]), np.array([_floor(point.error) for point in points])
    axes.plot(x, y, "-o", color=ink, ms=4, lw=1.4, zorder=3)
    if line is None:
        return x[-1], y[-1], NAMES[route], ink
    # The time is proportional to the number of samples but for the setup, which bends the curve where they are few.
    axes.plot(x, y[-1] * (x / x[-1]) ** line.measured, color=ink, lw=0.9, ls=DASHES, alpha=0.7)
    return x[-1], y[-1], f"{NAMES[route]}\nslope {_slope(line)} (dashed)", ink


def _exact(axes: Axes, points: Sequence[Point]) -> None:
    """Single points, by time, with names above them in steps: the first is the highest, so that no line meets a name."""
    to_axes = axes.transData + axes.transAxes.inverted()
    top = max((to_axes.transform((point.ns, _floor(point.error)))[1] for point in points), default=0.0)
    for k, point in enumerate(points):
        ink, at = INKS[point.route], (point.ns, _floor(point.error))
        axes.plot(*at, "o", color=ink, ms=7, zorder=3)
        across = float(to_axes.transform(at)[0])
        height = top + 0.09 + 0.075 * (len(points) - 1 - k)
        axes.plot(
            [point.ns, point.ns],
            [at[1], axes.transData.inverted().transform(axes.transAxes.transform((across, height)))[1]],
            color=ink,
            lw=0.6,
            alpha=0.55,
        )
        axes.annotate(
            f"{NAMES[point.route]}, {time(point.ns)}, error {scientific(point.error)}", xy=(across, height),
            xycoords="axes fraction", xytext=(4, 0), textcoords="offset points", va="center", color=ink,
        )  # fmt: skip


def _slope(line: Slope) -> str:
    return minus(f"{line.measured:.2f} ± {line.standard_error:.2f}")


def error_against_samples(found: Emergence) -> Plot:
    """Error of M against the number of samples, with the lines whose slopes are measured."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 3.7))
        axes = figure.subplots()
        figure.subplots_adjust(left=0.075, right=0.775, top=0.96, bottom=0.14)
        axes.set_xscale("log", base=2)
        axes.set_yscale("log")
        samples = [point.samples for point in found.points if point.samples]
        values = [_floor(point.error) for point in found.points if point.samples]
        axes.set_xlim(min(samples) / 1.3, max(samples) * 1.3)
        axes.set_ylim(min(values) / 1.8, max(values) * 1.8)
        axes.xaxis.set_major_locator(LogLocator(base=2, subs=(1.0,), numticks=20))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: power(round(np.log2(value)), 2)))
        axes.set_xlabel("samples")
        axes.set_ylabel("relative error of M")
        power_ticks(axes.yaxis, 8)
        if max(values) < 30.0 * min(values):
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: scientific(value, 0)))
        entries = [entry for route in SAMPLED for entry in _line(axes, found, route)]
        direct_labels(axes, entries, 0.2)
        return finished("emergence-slopes", figure)


def _line(axes: Axes, found: Emergence, route: str) -> list[tuple[float, float, str, str]]:
    points, ink = found.of(route), INKS[route]
    if not points:
        return []
    n = np.array([point.samples or 1 for point in points], dtype=float)
    axes.plot(n, [_floor(point.error) for point in points], "o", color=ink, ms=4.5, zorder=3)
    line = found.slopes.get(route)
    if line is None:
        return [(n[-1], _floor(points[-1].error), NAMES[route], ink)]
    axes.plot(n, [line.error(one) for one in n], "-", color=ink, lw=1.2)
    text = f"{NAMES[route]}\nslope {_slope(line)}\ntheory {THEORY[route]}"
    if route == PLAIN and found.unit_error is not None:
        # Where theory knows the error itself, and not its slope alone.
        axes.plot(n, found.unit_error / np.sqrt(n), color=INK, lw=0.9, ls=DASHES)
        text += " (dashed)"
    return [(n[-1], line.error(n[-1]), text, ink)]
