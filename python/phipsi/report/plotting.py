"""Plots as data: series on axes, a matrix by color, or lines in space. interactive.py draws them on a page,
benches/static.py as pictures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .text import brief_time, count, power

Array = NDArray[np.float64]
Values: TypeAlias = "Sequence[float] | Array"

#: Colors by index in METHODS; distinguishable with color vision deficiency.
COLORS = ("#0072b2", "#009e73", "#d55e00", "#aa3377", "#56b4e9", "#e69f00", "#4d4d4d")
INK, SOFT, GRAY, FAINT = "#2b2f33", "#6b7279", "#8a9199", "#d9dde1"
#: Largest number of ticks of an axis, with powers of ten and with longer labels, for narrow screens.
MOST_POWERS, MOST_TICKS = 8, 5
#: Length of an axis on a narrow screen, and width of a character of its labels, px.
NARROW, DIGIT = 280.0, 6.5
#: Possible positions of ticks in a decade of a logarithmic axis, finest first.
STEPS = ((1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0), (1.0, 2.0, 5.0), (1.0, 3.0), (1.0,))


@dataclass(frozen=True)
class Axis:
    """One axis of a panel."""

    title: str
    low: float | None = None
    """Ends of the axis; None: the range of the values."""
    high: float | None = None
    ticks: Sequence[tuple[float, str]] | None = None
    """Values with labels; None: automatic."""
    log: bool = False
    form: str = ".3~g"
    """Format of a value in the hover label (d3-format)."""
    unit: str = ""
    """Unit after the value."""

    @staticmethod
    def powers(title: str, low: float, high: float, form: str = ".2~e") -> Axis:
        """Logarithmic axis with ticks at powers of ten, and more ticks if there are fewer than two."""
        found = range(math.ceil(math.log10(low)), math.floor(math.log10(high)) + 1)
        every = math.ceil(len(found) / MOST_POWERS) or 1
        ticks = [(10.0**e, power(e)) for e in found if e % every == 0] if len(found) > 1 else log_ticks(low, high, _number)
        return Axis(title, low, high, ticks, True, form)

    @staticmethod
    def times(title: str, low: float, high: float) -> Axis:
        """Logarithmic axis of times in seconds."""
        return Axis(title, low, high, log_ticks(low, high, lambda s: brief_time(1e9 * s)), True, ".3~s", "s")


def log_ticks(low: float, high: float, name: Callable[[float], str]) -> list[tuple[float, str]]:
    """Ticks of a logarithmic axis with their labels: the finest of at most MOST_TICKS whose labels do not overlap."""
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    found = [[m * 10.0**e for e in exponents for m in steps] for steps in STEPS]
    found += [[10.0**e for e in exponents if e % every == 0] for every in range(2, len(exponents))]
    # For a range below a decade: equidistant.
    size = 10.0 ** math.floor(math.log10((high - low) / MOST_TICKS))
    steps = [m * size for m in (1.0, 2.0, 5.0, 10.0, 20.0)]
    found += [[k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)] for step in steps]
    ticks = [[(value, name(value)) for value in values if low <= value <= high] for values in found]
    legible = [row for row in ticks if len(row) <= MOST_TICKS and _fit(row, math.log(high / low))]
    return next((row for row in legible if len(row) > 2), max(legible, key=len, default=[]))


def _fit(ticks: Sequence[tuple[float, str]], length: float) -> bool:
    """Whether the labels do not overlap on an axis of NARROW pixels, for the logarithm of its range."""
    pairs = zip(ticks, ticks[1:], strict=False)
    apart = [NARROW * math.log(b / a) / length - DIGIT * (len(left) + len(right) + 2) / 2 for (a, left), (b, right) in pairs]
    return all(gap > 0.0 for gap in apart)


def _number(value: float) -> str:
    if 1e-3 <= value < 1e5:
        return f"{value:.3g}" if value < 1e3 else count(round(value))
    digits, exponent = f"{value:.1e}".split("e")
    return f"{digits.removesuffix('.0')}·{power(int(exponent))}"


@dataclass(frozen=True)
class Series:
    """Points with one name: markers, a line, or both. Series with the same name share one legend entry."""

    name: str
    ink: str
    x: Values
    y: Values
    line: float = 0.0
    """Line width, px; 0: no line."""
    mark: float = 0.0
    """Marker size, px; 0: no markers."""
    symbol: str = "circle"
    """circle, square, diamond, triangle-up, x, cross or dash."""
    dash: bool = False
    hollow: bool = False
    shade: float = 1.0
    """Opacity."""
    below: bool = False
    """Whether the area below it is filled."""
    told: bool = True
    """Whether the hover label shows its name and values."""
    note: str = ""
    """Text after the name in the hover label."""


@dataclass(frozen=True)
class Panel:
    """Series on two axes."""

    x: Axis
    y: Axis
    series: Sequence[Series]
    title: str = ""


@dataclass(frozen=True)
class Chart:
    """Panels; on a narrow page they are one under the other."""

    name: str
    panels: Sequence[Panel]
    columns: int = 1
    height: int = 300
    """Of a panel, px."""
    linked: bool = False
    """Whether all panels have the x axis of the last one."""
    together: bool = False
    """Whether the mouse shows all series at its x."""


@dataclass(frozen=True)
class Matrix:
    """A square matrix by the logarithm of the size of its entries; what is NaN stays white."""

    name: str
    values: Array
    names: Sequence[str]
    """Of its rows and columns."""
    label: str


@dataclass(frozen=True)
class Part:
    """Lines or markers in space with one name."""

    name: str
    ink: str
    points: Array
    """(n, 3), m. Points of lines in sequence, with NaN between separate lines."""
    line: float = 0.0
    marks: Values | float = 0.0
    """Sizes, px."""
    texts: Sequence[str] = ()
    """Hover labels of the points."""
    names: Sequence[str] = ()
    """Labels of the points."""
    shade: float = 1.0
    shown: bool = True
    """Whether it is visible initially."""


@dataclass(frozen=True)
class Space:
    """Lines and markers in space; dragging rotates the view."""

    name: str
    parts: Sequence[Part]
    toward: Array
    """Direction of the viewer, (3,)."""


Plot: TypeAlias = "Chart | Matrix | Space"


def level(name: str, value: float, x: Axis) -> Series:
    """A dashed horizontal line."""
    assert x.low is not None and x.high is not None
    return Series(name, GRAY, [x.low, x.high], [value, value], line=1.0, dash=True, told=False)
