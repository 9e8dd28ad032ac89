"""The plots: error against run time, error against condition number, growth, the mass matrix."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator
from numpy.typing import NDArray

from .figure import COLOURS, FAINT, STYLE, Plot, direct_labels, finished, power_ticks, time_axis
from .measure import EPS, PRECISIONS, Accuracy, Growth, median
from .text import count, power, scientific, significant, symbols

Array = NDArray[np.float64]


def colour(method: str, methods: Sequence[str]) -> str:
    """The colour of a method in every plot and table."""
    return COLOURS[list(methods).index(method) % len(COLOURS)]


def _units(value: float, _: int) -> str:
    return f"{value:g}" if value < 1e4 else power(round(np.log10(value)))


def error_against_time(rows: Sequence[Accuracy], methods: Sequence[str]) -> Plot:
    """Median time of a call of `Scene::evaluate` against the error of every state, one panel a precision on the same axis of times."""
    usable = [row for row in rows if np.isfinite(row.median)]
    times = [row.ns for row in usable] or [1.0, 10.0]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 5.9))
        panels = figure.subplots(2, 1, sharex=True, gridspec_kw={"hspace": 0.16})
        figure.subplots_adjust(left=0.075, right=0.775, top=0.955, bottom=0.09)
        for axes, precision in zip(panels, reversed(PRECISIONS), strict=True):
            time_axis(axes, min(times) / 1.5, max(times) * 1.25)
            _error_panel(axes, [row for row in usable if row.precision == precision], precision, methods)
        panels[-1].set_xlabel("median time of a call in Rust, one state (Scene::evaluate)")
        return finished("error-against-time", figure)


def _error_panel(axes: Axes, rows: Sequence[Accuracy], precision: str, methods: Sequence[str]) -> None:
    eps = EPS[precision]
    errors = [np.maximum(row.errors[np.isfinite(row.errors)], eps * 1e-3) for row in rows]
    low = min([eps / 4, *(float(np.quantile(e, 0.02)) for e in errors)])
    high = max([eps * 12, *(float(e.max()) for e in errors)])
    axes.set_yscale("log")
    axes.set_ylim(low / 1.8, high * 2.2)
    power_ticks(axes.yaxis, 9)
    axes.set_ylabel("relative error of the accelerations")
    axes.set_title(precision, loc="left", fontsize=9.5, fontweight="bold")
    axes.axhline(eps, color="#8a9199", lw=0.8, ls=(0, (4, 3)))
    axes.annotate(
        f"eps = {significant(eps * 10 ** -np.floor(np.log10(eps)), 2)}·{power(int(np.floor(np.log10(eps))))}",
        xy=(0.0, eps), xycoords=("axes fraction", "data"), xytext=(4, 3), textcoords="offset points",
        color="#6b7279", fontsize=7.5,
    )  # fmt: skip
    entries = []
    generator = np.random.default_rng(0)
    for row, values in zip(rows, errors, strict=True):
        ink = colour(row.method, methods)
        x = row.ns * np.exp(generator.uniform(-0.02, 0.02, len(values)))
        axes.plot(x, values, ".", ms=3.6, color=ink, alpha=0.3, mew=0, rasterized=len(values) > 500)
        axes.plot([row.ns, row.ns], [row.median, row.worst], color=ink, lw=0.9, alpha=0.8)
        axes.plot([row.ns], [row.worst], "_", ms=8, color=ink, mew=1.3)
        fill = ink if precision == "float64" else "white"
        axes.plot([row.ns], [row.median], "o" if precision == "float64" else "s", ms=6.5, color=ink, mfc=fill, mew=1.5)
        entries.append((row.ns, row.median, symbols(row.method), ink))
    direct_labels(axes, entries, 0.085)


def error_against_condition(rows: Sequence[Accuracy], conditions: Array, methods: Sequence[str]) -> Plot:
    """Digits lost, state by state, against the condition number of M, in float64."""
    chosen = [row for row in rows if row.precision == "float64" and np.isfinite(row.median)]
    eps = EPS["float64"]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 3.7))
        axes = figure.subplots()
        figure.subplots_adjust(left=0.075, right=0.775, top=0.96, bottom=0.135)
        finite = conditions[np.isfinite(conditions)]
        low, high = float(finite.min()), float(finite.max())
        pad = max((high / low) ** 0.06, 1.08)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlim(low / pad, high * pad)
        highest = max(row.worst for row in chosen) / eps
        lowest = min(median(row.errors) for row in chosen) / eps
        axes.set_ylim(max(0.02, lowest / 20.0), max(highest * 3.0, 30.0))
        if high / low > 30:
            power_ticks(axes.xaxis, 8)
        else:
            axes.xaxis.set_major_locator(
                LogLocator(
                    subs=(
                        (1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if high / low > 3 else (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 7, 8, 9)
                    )
                )
            )
            axes.xaxis.set_minor_locator(NullLocator())
            axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: scientific(value)))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(FuncFormatter(_units))
        axes.set_xlabel("condition number of M at the state")
        axes.set_ylabel("error in units of eps")
        axes.axhline(1.0, color="#8a9199", lw=0.8, ls=(0, (4, 3)))
        entries = []
        for row in chosen:
            ink = colour(row.method, methods)
            values = row.errors / eps
            axes.plot(conditions, values, "o", ms=3.2, color=ink, alpha=0.45, mew=0)
            at = int(np.argmax(np.where(np.isfinite(values), conditions, 0.0)))
            entries.append((float(conditions[at]), float(values[at]), symbols(row.method), ink))
        direct_labels(axes, entries, 0.08)
        return finished("error-against-condition", figure)


def growth(rows: Sequence[Growth]) -> Plot:
    """Time a body against the number of bodies."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 3.3))
        axes = figure.subplots()
        figure.subplots_adjust(left=0.075, right=0.775, top=0.95, bottom=0.15)
        bodies = np.array([row.bodies for row in rows])
        axes.set_xscale("log")
        axes.set_xlim(bodies.min() / 1.25, bodies.max() * 1.25)
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: count(round(value))))
        axes.set_xlabel("bodies in the chain")
        axes.set_ylabel("time a body, ns")
        entries = []
        for name, ink, values in (
            ("forward dynamics, auto", COLOURS[0], np.array([row.forward for row in rows])),
            ("forward dynamics, covariance", COLOURS[1], np.array([row.covariance for row in rows])),
            ("inverse dynamics", "#6b7279", np.array([row.inverse for row in rows])),
        ):
            axes.plot(bodies, values, "-o", color=ink, ms=4, lw=1.4)
            label = f"{name}\nmax / min = {values.max() / values.min():.2f}"
            entries.append((float(bodies[-1]), float(values[-1]), label, ink))
        axes.set_ylim(0.0, 1.15 * max(max(row.forward, row.covariance, row.inverse) for row in rows))
        axes.grid(axis="y", color=FAINT, lw=0.6)
        direct_labels(axes, entries, 0.2)
        return finished("growth", figure)


def mass_matrix(matrix: Array) -> Plot:
    """|M| by colour; zeros, and what is only rounding beside the largest entry, are white."""
    size = len(matrix)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.9, 4.2))
        axes = figure.subplots()
        figure.subplots_adjust(left=0.04, right=0.86, top=0.97, bottom=0.05)
        sizes = np.abs(matrix)
        shown = sizes > EPS["float64"] * sizes.max()
        logs = np.log10(sizes, where=shown, out=np.full_like(matrix, np.nan))
        image = axes.imshow(logs, cmap="YlGnBu", interpolation="nearest")
        bar = figure.colorbar(image, ax=axes, fraction=0.045, pad=0.03)
        bar.ax.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: power(round(value))))
        bar.outline.set_visible(False)
        bar.set_label("|M|, SI units (kg m², kg m, kg)")
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_xlabel(f"{size} × {size}, base to tip in the order of qd")
        return finished("mass-matrix", figure)
