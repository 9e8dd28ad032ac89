"""Plots of docs/measured/benchmarks.md: ratios by model, and time by number of bodies."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator
from phipsi.report.plotting import COLORS, FAINT
from phipsi.report.text import brief_time, power
from static import STYLE, finished, ticks
from studies.programs import INKS

Row = dict[str, Any]

NAMES = {
    "forward_dynamics": "forward dynamics",
    "inverse_dynamics": "inverse dynamics",
    "mass_matrix": "mass matrix",
    "mass_matrix_inverse": "inverse of the mass matrix",
    "inverse_dynamics_derivatives": "derivatives of inverse dynamics",
    "forward_dynamics_derivatives": "derivatives of forward dynamics",
}
MARKERS = "osD^vPX*"


class Picture(NamedTuple):
    """A plot as a separate file."""

    name: str
    png: bytes


#: model, series, ratio: median, minimum and maximum (equal if there is no range)
Dot = tuple[str, str, tuple[float, float, float]]


def _ink(series: str, index: int) -> str:
    """Color by the library at the beginning of a series' name, as in the stability study; otherwise by position."""
    library = series.partition(":")[0].partition(",")[0]
    return INKS.get(library, COLORS[index % len(COLORS)])


def draw(
    one: Sequence[Row], batches: Sequence[Row], calls: Sequence[Row], arrays: Sequence[Row], growth: Sequence[Row]
) -> list[Picture]:
    """Groups with results."""
    plots = []
    for name, rows in (("one-state", one), ("batches", batches)):
        dots = [(row["model"], NAMES[row["group"].removesuffix("_batch")], _range(row["ratio"])) for row in rows]
        plots += _ratios(name, [("", dots)], "times faster than Pinocchio in C++")
    for name, rows in (("python", calls), ("python-batches", arrays)):
        panels = []
        for operation in dict.fromkeys(row["operation"] for row in rows):
            dots = [
                (row["model"], f"{row['library']}: {row['call']}", (row["ratio"],) * 3)
                for row in rows
                if row["operation"] == operation and row["ratio"] and not row["library"].startswith("phipsi")
            ]
            panels.append((NAMES.get(operation.removesuffix("_batch"), operation), dots))
        plots += _ratios(name, [panel for panel in panels if panel[1]], "times faster than the peer")
    return [*plots, *_growth(growth)]


def _range(ratio: Row) -> tuple[float, float, float]:
    return ratio["median"], ratio["min"], ratio["max"]


def _ratios(name: str, panels: Sequence[tuple[str, Sequence[Dot]]], label: str) -> list[Picture]:
    """A panel per operation, a column per model, a marker per series; 1 means equal times."""
    panels = [panel for panel in panels if panel[1]]
    if not panels:
        return []
    with mpl.rc_context(STYLE):
        rows = (len(panels) + 1) // 2
        columns = min(2, len(panels))
        width, height, under = 10.0, 2.7, 0.95  # inches; below: names of models, and the legend
        figure = Figure(figsize=(width, rows * (height + under) + 0.3))
        every = figure.subplots(rows, columns, squeeze=False)
        whole = figure.get_figheight()
        figure.subplots_adjust(
            left=0.06,
            right=0.985,
            top=1 - 0.3 / whole,
            bottom=under / whole,
            hspace=(under + 0.15) / height,
            wspace=0.14,
        )
        for axes in every.flat[len(panels) :]:
            axes.set_visible(False)
        for axes, (heading, dots) in zip(every.flat, panels, strict=False):
            _panel(axes, heading, dots, label)
        return [Picture(name, finished(figure))]


def _panel(axes: Axes, heading: str, dots: Sequence[Dot], label: str) -> None:
    models = list(dict.fromkeys(model for model, _, _ in dots))
    series = list(dict.fromkeys(which for _, which, _ in dots))
    for index, which in enumerate(series):
        shift = 0.5 * (index - (len(series) - 1) / 2) / max(len(series), 1)
        chosen = [(models.index(model) + shift, *ratios) for model, one, ratios in dots if one == which]
        ink = _ink(which, index)
        fill = "white" if "threads" in which else ink
        places, medians, lows, highs = zip(*chosen, strict=True)
        axes.vlines(places, lows, highs, color=ink, lw=1.0)
        axes.plot(places, medians, MARKERS[index % len(MARKERS)], color=ink, mfc=fill, mew=1.2, ms=5, label=which)
    axes.axhline(1.0, color="#8a9199", lw=1.0, zorder=0)
    axes.set_yscale("log")
    ratios = [ratio for _, _, ratios in dots for ratio in ratios]
    low, high = min([*ratios, 1.0]) / 1.3, max([*ratios, 1.0]) * 1.3
    axes.set_ylim(low, high)
    marks: list[float] = []
    # Finer for a narrow range, in which there would be one tick.
    for steps in ((1, 2, 5), (1, 1.5, 2, 3, 5, 8), (1, 1.2, 1.4, 1.6, 1.8, 2, 2.5, 3, 4, 5, 6, 7, 8, 9)):
        if len(marks) < 3:
            every = [m * 10.0**e for e in range(-2, 4) for m in steps]
            marks = [mark for mark in every if low <= mark <= high]
    axes.yaxis.set_major_locator(FixedLocator(marks))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_xticks(range(len(models)), models)
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="y", color=FAINT, lw=0.6)
    axes.set_ylabel(label)
    axes.set_title(heading, loc="left", fontsize=9.5, fontweight="bold")
    axes.legend(
        frameon=False,
        fontsize=7,
        loc="upper left",
        bbox_to_anchor=(0.0, -0.07),
        ncols=2,
        handletextpad=0.2,
        columnspacing=1.0,
    )


def _growth(rows: Sequence[Row]) -> list[Picture]:
    """Time per body against the number of bodies, one curve per algorithm: constant for linear growth."""
    curves: dict[str, list[tuple[int, float]]] = {}
    for row in rows:
        if row["elements"]:
            which = "/".join(row["id"].split("/")[1:-1])
            curves.setdefault(which, []).append((row["elements"], row["ns"] / row["elements"]))
    if not curves:
        return []
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 3.6), layout="constrained")
        axes = figure.subplots()
        for index, (which, points) in enumerate(curves.items()):
            axes.plot(*zip(*sorted(points), strict=True), f"-{MARKERS[index % len(MARKERS)]}", color=_ink(which, index),
                      ms=4, lw=1.4, label=NAMES.get(which, which))  # fmt: skip
        axes.set_xscale("log")
        ticks(axes.xaxis, lambda value: power(round(math.log10(value))), LogLocator(numticks=8))
        axes.set_ylim(0.0, 1.15 * max(ns for points in curves.values() for _, ns in points))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: brief_time(value) if value else "0"))
        axes.grid(axis="y", color=FAINT, lw=0.6)
        axes.set_xlabel("bodies of a chain")
        axes.set_ylabel("time a body, one thread")
        axes.legend(frameon=False, fontsize=8)
        return [Picture("growth", finished(figure))]
