"""The plots of the stability report: error against the parameter of a case, and against run time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ... import _core
from ..plotting import COLOURS, DASHES, GREY, SOFT, Plot, direct_labels, level, log_log, panels, power_ticks, styled, time_axis
from ..text import power
from .measure import COVARIANCE, ROOT, TIMED, Point, Stability

FLOOR = "#c9ced3"
ERROR = "relative error of the accelerations"
#: Plots against a parameter: file; case, how the axis is called, caption.
SWEEPS = {
    "error-against-tip-mass": ("heavy-tip", "mass of the last of 8 links, kg (the others 1 kg)", "Eight links, the last one heavier and heavier."),
    "error-against-growth": ("growing-masses", "mass of each of 8 links over that of the one before it", "Eight links, each heavier than the one before it."),
    "error-against-links": ("long-chain", "links of a nearly straight chain", "A nearly straight chain; nothing dense is formed beyond 1000 links."),
    "error-against-spin": ("spin", "rates, rad/s", "Twelve links, rates up to a million radians a second."),
    "error-against-lever": ("long-lever", "distance between two joints in the middle, m", "Eight links, two of the joints further and further apart."),
}


def draw(found: Stability) -> list[Plot]:
    """All plots."""
    return [*(_sweep(found, name, case, label) for name, (case, label, _) in SWEEPS.items()), _against_time(found)]


def _inks(found: Stability) -> dict[str, str]:
    """A colour a method."""
    return dict(zip(_core.FORMS, COLOURS, strict=False)) | {other.name: other.colour for other in found.others}


@styled
def _sweep(found: Stability, name: str, case: str, label: str) -> tuple[str, Figure]:
    """Error of every method against the parameter: left in the max-norm, right component by component."""
    points = found.of(case)
    figure, ((left, right),) = panels((10.0, 4.0), 1, 2, margins=(0.07, 0.83, 0.91, 0.13), wspace=0.24)
    for norm, (axes, title) in enumerate(((left, "max-norm"), (right, "component by component"))):
        log_log(axes, title, "" if norm else ERROR, label)
        _curves(axes, found, points, norm)
        power_ticks(axes.xaxis, 8)
    limits = [limit for axes in (left, right) for limit in axes.get_ylim()]
    for axes in (left, right):
        # An error of ten is as wrong as one of 1e47.
        axes.set_ylim(max(min(limits), 1e-18), min(max(limits), 10.0))
        power_ticks(axes.yaxis, 12)
    _names(right, found, points)
    return name, figure


def _curves(axes: Axes, found: Stability, points: Sequence[Point], norm: int) -> None:
    x = np.array([point.value for point in points])
    floor = np.array([float(point.floor[norm] or 0.0) for point in points])
    axes.fill_between(x, floor, 1e-30, color=FLOOR, alpha=0.55, lw=0, zorder=0)
    axes.plot(x, floor, color=GREY, lw=0.9, ls=DASHES, zorder=1)
    every = [floor]
    for method, ink in _inks(found).items():
        y = np.array([float(point.errors[method, "float64"][norm] or 0.0) for point in points])
        y = np.where(np.isfinite(y), np.maximum(y, 1e-18), np.nan)
        every.append(y)
        thick = method in (ROOT, COVARIANCE)
        axes.plot(x, y, "-o", color=ink, lw=1.7 if thick else 1.0, ms=4.2 if thick else 3.0, zorder=4 if thick else 3)
    finite = np.concatenate(every)
    finite = finite[np.isfinite(finite) & (finite > 0)]
    axes.set_ylim(finite.min() / 3.0, min(finite.max() * 4.0, 1e3))
    axes.set_xlim(x.min() / 1.6, x.max() * max(1.6, (x.max() / x.min()) ** 0.08))


def _names(axes: Axes, found: Stability, points: Sequence[Point]) -> None:
    """The names of the curves, right of the axes, at their last points."""
    low, high = axes.get_ylim()
    curves = {name: (ink, [(p.value, p.errors[name, "float64"].component) for p in points]) for name, ink in _inks(found).items()}
    curves["sensitivity"] = (SOFT, [(point.value, point.floor.component) for point in points])
    entries = []
    for name, (ink, curve) in curves.items():
        known = [(x, float(np.clip(y, low * 1.2, high / 1.2))) for x, y in curve if math.isfinite(y)]
        entries += [(*known[-1], name, ink)] if known else []
    direct_labels(axes, entries, 0.062)


@styled
def _against_time(found: Stability) -> tuple[str, Figure]:
    """Time a state against error, one point a method, a panel a case."""
    figure, axes = panels((10.0, 5.6), 2, 2, margins=(0.07, 0.97, 0.94, 0.16), sharey=True, wspace=0.06, hspace=0.36)
    inks = {method: ink for method, ink in _inks(found).items() if method in _core.FORMS}
    for at, (one, (name, value)) in enumerate(zip(axes.flat, TIMED, strict=True)):
        title = f"{name}, {f'{value:g}' if 1e-2 <= value < 1e4 else power(round(math.log10(value)))}"
        log_log(one, title, "" if at % 2 else ERROR, "median time a state" if at > 1 else "")
        rows = [row for precision in ("float64", "float32") for row in found.timed(name, value, precision)]
        for row in rows:
            if math.isfinite(row.norm):
                ink, double = inks[row.method], row.precision == "float64"
                marker, fill = ("o", ink) if double else ("s", "white")
                one.plot([row.ns], [max(row.norm, 1e-18)], marker, ms=7, color=ink, mfc=fill, mew=1.5)
        times = [row.ns for row in rows]
        time_axis(one, min(times) / 1.25, max(times) * 1.25)
        level(one, next(point for point in found.of(name) if point.value == value).floor.norm)
        one.set_ylim(1e-17, 1e2)
        power_ticks(one.yaxis, 8)
    handles = [Line2D([], [], marker="o", ls="", color=ink, label=method) for method, ink in inks.items()]
    handles += [
        Line2D([], [], marker="o", ls="", color="#555b61", label="float64"),
        Line2D([], [], marker="s", ls="", color="#555b61", mfc="white", label="float32"),
        Line2D([], [], color=GREY, ls=DASHES, label="sensitivity"),
    ]
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False, fontsize=8, columnspacing=1.4, handletextpad=0.4)
    return "error-against-run-time", figure
