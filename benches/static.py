"""Charts as PNG for pages in Markdown, and the common style of the plots in docs/. Needs matplotlib."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from phipsi.report.plotting import FAINT, GRAY, INK, Axis, Chart, Plot, Series

#: Any, because the stubs of some versions of matplotlib list all keys.
STYLE: Any = {
    "font.family": "sans-serif",
    "font.size": 8.5,
    # Names contain underscores, which TeX would interpret.
    "text.usetex": False,
    "text.color": INK,
    "axes.edgecolor": GRAY,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": "#555b61",
    "ytick.color": "#555b61",
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
}
MARKERS = {"circle": "o", "square": "s", "diamond": "D", "triangle-up": "^", "x": "x", "cross": "+", "dash": "_"}
#: Inches: width of a figure, of a pixel of a page, space above a panel, below it, and per line of the legend.
WIDTH, PIXEL, ABOVE, BELOW, LINE = 10.0, 0.0095, 0.35, 0.5, 0.2
#: Legend entries per line, for names of typical length.
ACROSS = 150


def finished(figure: Figure) -> bytes:
    """Figure as PNG."""
    png = io.BytesIO()
    figure.savefig(png, format="png", dpi=160)
    return png.getvalue()


def draw(plot: Plot) -> bytes:
    """Chart as PNG; other plots exist only on HTML pages."""
    if not isinstance(plot, Chart):
        raise TypeError(f"plot: found a {type(plot).__name__}, {plot.name}; expected a Chart")
    with mpl.rc_context(STYLE):
        return finished(_chart(plot))


def ticks(axis: Any, name: Callable[[float], str], locator: Any = None) -> None:
    """Labels for the ticks of the locator, without minor labels."""
    if locator is not None:
        axis.set_major_locator(locator)
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: name(value)))


def _chart(chart: Chart) -> Figure:
    columns = min(chart.columns, len(chart.panels))
    rows = -(-len(chart.panels) // columns)
    first = {one.name: one for panel in reversed(chart.panels) for one in reversed(panel.series)}
    names = list(dict.fromkeys(one.name for panel in chart.panels for one in panel.series))
    across = max(1, min(len(names), ACROSS // (max(map(len, names)) + 8)))
    legend = LINE * -(-len(names) // across) + 0.1
    height = rows * (chart.height * PIXEL + ABOVE + BELOW) + legend
    figure = Figure(figsize=(WIDTH, height))
    every = figure.subplots(rows, columns, squeeze=False)
    figure.subplots_adjust(
        left=0.07, right=0.985, top=1.0 - ABOVE / height, bottom=(BELOW + legend) / height,
        hspace=(ABOVE + BELOW) / (chart.height * PIXEL), wspace=0.16 if columns < 3 else 0.22,
    )  # fmt: skip
    for axes in every.flat[len(chart.panels) :]:
        axes.set_visible(False)
    for at, (axes, panel) in enumerate(zip(every.flat, chart.panels, strict=False)):
        _axis(axes, "x", panel.x)
        _axis(axes, "y", panel.y)
        if at % columns and panel.y.title == chart.panels[0].y.title:
            axes.set_ylabel("")
        axes.grid(axis="y", color=FAINT, lw=0.6)
        axes.set_title(panel.title, loc="left", fontsize=9.5, fontweight="bold")
        bottom = axes.get_ylim()[0]
        for one in panel.series:
            _series(axes, one, bottom)
    handles = [Line2D([], [], label=name, **_look(first[name])) for name in names]
    figure.legend(handles=handles, loc="lower center", ncols=across, frameon=False, fontsize=8, columnspacing=1.5, handlelength=2.4)
    return figure


def _axis(axes: Axes, which: str, axis: Axis) -> None:
    axes.set(**{f"{which}label": axis.title, f"{which}scale": "log" if axis.log else "linear"})
    if axis.low is not None and axis.high is not None:
        axes.set(**{f"{which}lim": (axis.low, axis.high)})
    if axis.ticks is not None:
        names = dict(axis.ticks)
        ticks(axes.xaxis if which == "x" else axes.yaxis, lambda value: names[value], FixedLocator(list(names)))


def _look(one: Series) -> dict[str, Any]:
    return {
        "color": one.ink, "alpha": one.shade, "lw": 0.75 * one.line, "ls": ("--" if one.dash else "-") if one.line else "",
        "marker": MARKERS[one.symbol] if one.mark else "", "ms": 0.62 * one.mark, "mfc": "white" if one.hollow else one.ink, "mew": 1.0,
    }  # fmt: skip


def _series(axes: Axes, one: Series, bottom: float) -> None:
    x, y = np.asarray(one.x, dtype=float), np.asarray(one.y, dtype=float)
    axes.plot(x, y, **_look(one))
    if one.below:
        axes.fill_between(x, y, bottom, color="#c9ced3", alpha=0.45, lw=0, zorder=0)
