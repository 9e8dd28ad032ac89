"""What every plot shares: the style, the axes, names beside points, SVG and PNG."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from typing import Any, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, NullLocator
from numpy.typing import NDArray

from .labels import spread
from .text import power

Array = NDArray[np.float64]
P = ParamSpec("P")

#: By place in METHODS; apart for all kinds of colour vision.
COLOURS = ("#0072b2", "#009e73", "#d55e00", "#aa3377", "#56b4e9", "#e69f00", "#4d4d4d")
INK, SOFT, GREY, FAINT = "#2b2f33", "#6b7279", "#8a9199", "#d9dde1"
DASHES = (0, (4, 3))
#: Any, for the stubs of some versions of matplotlib list every key.
STYLE: Any = {
    "font.family": "sans-serif",
    "font.size": 8.5,
    # Names of robots have underscores, which TeX does not take for what they are.
    "text.usetex": False,
    "text.color": INK,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": "#555b61",
    "ytick.color": "#555b61",
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    # Text stays text: it takes the page's typeface, which is narrower than the one that was measured here.
    "svg.fonttype": "none",
    "svg.hashsalt": "phipsi",
}


@dataclass(frozen=True)
class Plot:
    """A plot as SVG and as PNG."""

    name: str
    svg: str
    png: bytes


def styled(draw: Callable[P, tuple[str, Figure]]) -> Callable[P, Plot]:
    """Has a function that gives a name and a figure draw in the style above, and makes a plot of them."""

    @wraps(draw)
    def drawn(*arguments: P.args, **options: P.kwargs) -> Plot:
        with mpl.rc_context(STYLE):
            return finished(*draw(*arguments, **options))

    return drawn


def finished(name: str, figure: Figure) -> Plot:
    """The figure as SVG and PNG."""
    svg, png = io.StringIO(), io.BytesIO()
    figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
    figure.savefig(png, format="png", dpi=160)
    # The licence of the metadata is an address on the network, and says nothing about the plot.
    text = re.sub("<metadata>.*?</metadata>", "", svg.getvalue(), flags=re.DOTALL)
    return Plot(name, text[text.index("<svg") :], png.getvalue())


def panels(size: tuple[float, float], rows: int = 1, columns: int = 1, *, margins: Sequence[float], **options: Any) -> tuple[Figure, Any]:
    """A figure of that size, inches, and its axes (rows, columns); margins: left, right, top and bottom edge, as shares of the figure."""
    figure = Figure(figsize=size)
    space = {key: options.pop(key) for key in ("wspace", "hspace") if key in options}
    every = figure.subplots(rows, columns, squeeze=False, **options)
    figure.subplots_adjust(**dict(zip(("left", "right", "top", "bottom"), margins, strict=True)), **space)
    return figure, every


def log_log(axes: Axes, title: str, ylabel: str, xlabel: str) -> None:
    """Both axes logarithmic, with their names and a title."""
    axes.set(xscale="log", yscale="log", xlabel=xlabel, ylabel=ylabel)
    axes.set_title(title, loc="left", fontsize=9.5, fontweight="bold")
    axes.grid(axis="y", color=FAINT, lw=0.6)


def level(axes: Axes, value: float) -> None:
    """A dashed line across."""
    axes.axhline(value, color=GREY, lw=0.8, ls=DASHES)


def power_ticks(axis: Any, most: int) -> None:
    """Ticks at powers of ten, at most so many."""
    ticks(axis, lambda value: power(round(np.log10(value))), LogLocator(numticks=most))


def ticks(axis: Any, name: Callable[[float], str], locator: Any = None) -> None:
    """Ticks with names, where the locator wants them, and none between."""
    if locator is not None:
        axis.set_major_locator(locator)
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: name(value)))


def fine_ticks(axis: Any, reach: float, name: Callable[[float], str]) -> None:
    """Ticks of a logarithmic axis from its low end to so many times that: the finer, the less this is."""
    finest, fine = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0), (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
    subs = finest if reach < 3 else fine if reach < 12 else (1.0, 2.0, 5.0) if reach < 300 else (1.0,)
    ticks(axis, name, LogLocator(subs=subs))


def time_axis(axes: Axes, low: float, high: float) -> None:
    """A logarithmic axis of times in ns, ticks at 1, 2, 5."""
    axes.set(xscale="log", xlim=(low, high))
    fine_ticks(axes.xaxis, high / low, plain_time)


def plain_time(ns: float) -> str:
    """A time with its unit, no more digits than it has."""
    return EngFormatter("s").format_data(1e-9 * ns)


def direct_labels(axes: Axes, entries: Sequence[tuple[float, float, str, str]], gap: float = 0.065) -> None:
    """Names right of the axes, each with a line to its point: (x, y, text, colour)."""
    to_axes = axes.transData + axes.transAxes.inverted()
    points = [to_axes.transform((x, y)) for x, y, _, _ in entries]
    placed = []
    for (x, y, text, ink), point in zip(entries, points, strict=True):
        if _room(point, points):
            paper = {"fc": "white", "ec": "none", "alpha": 0.85, "pad": 1.0}
            axes.annotate(text, (x, y), xytext=(13, 0), textcoords="offset points", va="center", color=ink, bbox=paper)
        else:
            placed.append((float(point[1]), x, y, text, ink))
    placed.sort()
    heights = spread([entry[0] for entry in placed], [gap] * len(placed), 0.0, 1.0)
    for (_, x, y, text, ink), height in zip(placed, heights, strict=True):
        line = {"arrowstyle": "-", "color": ink, "lw": 0.6, "alpha": 0.55, "shrinkA": 2, "shrinkB": 5, "relpos": (0.0, 0.5)}
        axes.annotate(
            text, xy=(x, y), xytext=(1.025, height), textcoords="axes fraction", va="center", color=ink, arrowprops=line,
            annotation_clip=False,
        )  # fmt: skip


def _room(point: Array, points: Sequence[Array]) -> bool:
    """Whether a name fits right beside its point."""
    steps = [other - point for other in points if other is not point]
    return point[0] < 0.6 and not any(-0.05 < dx < 0.3 and abs(dy) < 0.25 for dx, dy in steps)
