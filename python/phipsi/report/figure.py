"""What every plot shares: the style, the axes, names beside points, SVG and PNG."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from numpy.typing import NDArray

from .labels import spread
from .text import power

Array = NDArray[np.float64]

#: By place in METHODS; apart for all kinds of colour vision.
COLOURS = ("#0072b2", "#009e73", "#d55e00", "#aa3377", "#56b4e9", "#e69f00", "#4d4d4d")
INK, FAINT = "#2b2f33", "#d9dde1"
#: Any, for the stubs of some versions of matplotlib list every key.
STYLE: Any = {
    "font.family": "sans-serif",
    "font.size": 8.5,
    # Names of robots have underscores, which TeX does not take for what they are.
    "text.usetex": False,
    "text.color": INK,
    "axes.edgecolor": "#8a9199",
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


def finished(name: str, figure: Figure) -> Plot:
    """The figure as SVG and PNG."""
    svg, png = io.StringIO(), io.BytesIO()
    figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
    figure.savefig(png, format="png", dpi=160)
    # The licence of the metadata is an address on the network, and says nothing about the plot.
    text = re.sub("<metadata>.*?</metadata>", "", svg.getvalue(), flags=re.DOTALL)
    return Plot(name, text[text.index("<svg") :], png.getvalue())


def power_ticks(axis: Any, most: int) -> None:
    """Ticks at powers of ten, at most so many."""
    axis.set_major_locator(LogLocator(numticks=most))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: power(round(np.log10(value)))))


def time_axis(axes: Axes, low: float, high: float) -> None:
    """A logarithmic axis of times in ns, ticks at 1, 2, 5."""
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    fine = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
    subs = fine if high / low < 12 else (1.0, 2.0, 5.0) if high / low < 300 else (1.0,)
    axes.xaxis.set_major_locator(LogLocator(subs=subs))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: plain_time(value)))


def plain_time(ns: float) -> str:
    for unit, size in (("s", 1e9), ("ms", 1e6), ("µs", 1e3)):
        if ns >= size * 0.999:
            return f"{ns / size:g} {unit}"
    return f"{ns:g} ns"


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
        axes.annotate(
            text,
            xy=(x, y),
            xytext=(1.025, height),
            textcoords="axes fraction",
            va="center",
            color=ink,
            arrowprops={
                "arrowstyle": "-",
                "color": ink,
                "lw": 0.6,
                "alpha": 0.55,
                "shrinkA": 2,
                "shrinkB": 5,
                "relpos": (0.0, 0.5),
            },
            annotation_clip=False,
        )


def _room(point: Array, points: Sequence[Array]) -> bool:
    """Whether a name fits right beside its point."""
    steps = [other - point for other in points if other is not point]
    return point[0] < 0.6 and not any(-0.05 < dx < 0.3 and abs(dy) < 0.25 for dx, dy in steps)
