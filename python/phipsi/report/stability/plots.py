"""The plots of the stability report: error against the parameter of a case, and against run time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..figure import FAINT, STYLE, Plot, direct_labels, finished, power_ticks, time_axis
from ..text import power
from .collect import CHOLESKY, COVARIANCE, LDLT, ROOT, TIMED, Error, Point, Stability

#: By method; apart for all kinds of colour vision.
COLOURS = {
    COVARIANCE: "#0072b2",
    ROOT: "#009e73",
    LDLT: "#d55e00",
    CHOLESKY: "#aa3377",
    "Pinocchio, local": "#222222",
    "Pinocchio, world": "#7f7f7f",
    "MuJoCo": "#b8860b",
    "Drake": "#56b4e9",
    "dynibo": "#e377c2",
}
FLOOR = "#c9ced3"

#: Plots against a parameter: file, case, how the axis is called.
SWEEPS = (
    ("error-against-tip-mass", "heavy-tip", "mass of the last of 8 links, kg (the others 1 kg)"),
    ("error-against-growth", "growing-masses", "mass of each of 8 links over that of the one before it"),
    ("error-against-links", "long-chain", "links of a nearly straight chain"),
    ("error-against-spin", "spin", "rates, rad/s"),
    ("error-against-lever", "long-lever", "distance between two joints in the middle, m"),
)


def draw(found: Stability) -> list[Plot]:
    """All plots."""
    drawn = [_sweep(found, *arguments) for arguments in SWEEPS]
    return [*drawn, _against_time(found)]


def _log(axes: Axes, title: str) -> None:
    axes.set_yscale("log")
    axes.set_ylabel("relative error of the accelerations")
    axes.set_title(title, loc="left", fontsize=9.5, fontweight="bold")
    axes.grid(axis="y", color=FAINT, lw=0.6)


def _sweep(found: Stability, name: str, case: str, label: str) -> Plot:
    """Error of every method against the parameter: left in the max-norm, right component by component."""
    points = found.of(case)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 4.0))
        panels = figure.subplots(1, 2)
        figure.subplots_adjust(left=0.07, right=0.83, top=0.91, bottom=0.13, wspace=0.24)
        for axes, title, of in (
            (panels[0], "max-norm", lambda error: error.norm),
            (panels[1], "component by component", lambda error: error.component),
        ):
            _curves(axes, found, points, of)
            _log(axes, title)
            axes.set_xscale("log")
            power_ticks(axes.xaxis, 8)
            axes.set_xlabel(label)
        limits = [limit for axes in panels for limit in axes.get_ylim()]
        # An error of ten is as wrong as one of 1e47.
        low, high = max(min(limits), 1e-18), min(max(limits), 10.0)
        for axes in panels:
            axes.set_ylim(low, high)
            power_ticks(axes.yaxis, 12)
        panels[1].set_ylabel("")
        _names(panels[1], found, points)
        return finished(name, figure)


def _curves(axes: Axes, found: Stability, points: Sequence[Point], of: Callable[[Error], float]) -> None:
    x = np.array([point.value for point in points])
    floor = np.array([max(of(error) for error in point.sensitivity.values()) for point in points])
    axes.fill_between(x, floor, 1e-30, color=FLOOR, alpha=0.55, lw=0, zorder=0)
    axes.plot(x, floor, color="#8a9199", lw=0.9, ls=(0, (4, 3)), zorder=1)
    every = [floor]
    for method in found.methods:
        y = np.array([of(point.errors[method, "float64"]) for point in points])
        y = np.where(np.isfinite(y), np.maximum(y, 1e-18), np.nan)
        every.append(y)
        thick = method in (ROOT, COVARIANCE)
        axes.plot(x, y, "-o", color=COLOURS.get(method, "#555555"), lw=1.7 if thick else 1.0, ms=4.2 if thick else 3.0,
                  zorder=4 if thick else 3)  # fmt: skip
    finite = np.concatenate(every)
    finite = finite[np.isfinite(finite) & (finite > 0)]
    axes.set_ylim(finite.min() / 3.0, min(finite.max() * 4.0, 1e3))
    axes.set_xlim(x.min() / 1.6, x.max() * max(1.6, (x.max() / x.min()) ** 0.08))


def _names(axes: Axes, found: Stability, points: Sequence[Point]) -> None:
    """The names of the curves, right of the axes, at their last points."""
    low, high = axes.get_ylim()
    entries = []
    for method in found.methods:
        known = [
            (p.value, p.errors[method, "float64"].component)
            for p in points
            if math.isfinite(p.errors[method, "float64"].component)
        ]
        if known:
            x, y = known[-1]
            entries.append((x, float(np.clip(y, low * 1.2, high / 1.2)), method, COLOURS.get(method, "#555555")))
    last = points[-1]
    floor = float(np.clip(last.component_floor, low * 1.2, high / 1.2))
    entries.append((last.value, floor, "sensitivity", "#6b7279"))
    direct_labels(axes, entries, 0.062)


def _against_time(found: Stability) -> Plot:
    """Time a state against error, one point a method, a panel a case."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 5.6))
        panels = figure.subplots(2, 2, sharey=True)
        figure.subplots_adjust(left=0.07, right=0.97, top=0.94, bottom=0.16, wspace=0.06, hspace=0.36)
        for axes, (name, value) in zip(panels.flat, TIMED, strict=True):
            rows = [row for row in found.timed if (row.name, row.value) == (name, value)]
            for row in rows:
                if math.isfinite(row.error.norm):
                    double = row.precision == "float64"
                    ink = COLOURS[row.method]
                    axes.plot([row.ns], [max(row.error.norm, 1e-18)], "o" if double else "s", ms=7, color=ink,
                              mfc=ink if double else "white", mew=1.5)  # fmt: skip
            _log(axes, f"{name}, {_plain(value)}")
            times = [row.ns for row in rows]
            time_axis(axes, min(times) / 1.25, max(times) * 1.25)
            point = next(p for p in found.of(name) if p.value == value)
            axes.axhline(point.floor, color="#8a9199", lw=0.9, ls=(0, (4, 3)))
            axes.set_ylim(1e-17, 1e2)
            power_ticks(axes.yaxis, 8)
            axes.set_xlabel("median time a state")
        for axes in panels[:, 1]:
            axes.set_ylabel("")
        for axes in panels[0, :]:
            axes.set_xlabel("")
        handles = [
            mpl.lines.Line2D([], [], marker="o", ls="", color=COLOURS[method], label=method)
            for method in COLOURS
            if any(row.method == method for row in found.timed)
        ]
        handles += [
            mpl.lines.Line2D([], [], marker="o", ls="", color="#555b61", label="float64"),
            mpl.lines.Line2D([], [], marker="s", ls="", color="#555b61", mfc="white", label="float32"),
            mpl.lines.Line2D([], [], color="#8a9199", ls=(0, (4, 3)), label="sensitivity"),
        ]
        figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False, fontsize=8,
                      columnspacing=1.4, handletextpad=0.4)  # fmt: skip
        return finished("error-against-run-time", figure)


def _plain(value: float) -> str:
    exponent = math.log10(value) if value > 0 else 0.0
    return power(round(exponent)) if value >= 1e4 or 0 < value < 1e-2 else f"{value:g}"
