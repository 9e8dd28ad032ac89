"""What a plot shows, as data: series on axes, a matrix by colour, or lines in space. interactive.py draws it in a page, benches/static.py as a picture."""

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

#: By place in METHODS; apart for all kinds of colour vision.
COLOURS = ("#0072b2", "#009e73", "#d55e00", "#aa3377", "#56b4e9", "#e69f00", "#4d4d4d")
INK, SOFT, GREY, FAINT = "#2b2f33", "#6b7279", "#8a9199", "#d9dde1"
#: Marks of an axis at the most, of powers of ten and of longer names: so many fit on a phone.
MOST_POWERS, MOST_TICKS = 8, 5
#: Where marks of a logarithmic axis may be in a decade, finest first.
STEPS = ((1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0), (1.0, 2.0, 5.0), (1.0, 3.0), (1.0,))


@dataclass(frozen=True)
class Axis:
    """One axis of a panel."""

    title: str
    low: float | None = None
    """Its ends; None: as the values are."""
    high: float | None = None
    ticks: Sequence[tuple[float, str]] | None = None
    """Values with names; None: whatever fits."""
    log: bool = False
    form: str = ".3~g"
    """How a value under the mouse is written (d3-format)."""
    unit: str = ""
    """Behind it."""

    @staticmethod
    def powers(title: str, low: float, high: float, form: str = ".2~e") -> Axis:
        """Logarithmic, with marks at powers of ten, and others where there are fewer than two."""
        found = range(math.ceil(math.log10(low)), math.floor(math.log10(high)) + 1)
        every = math.ceil(len(found) / MOST_POWERS) or 1
        ticks = [(10.0**e, power(e)) for e in found if e % every == 0] if len(found) > 1 else log_ticks(low, high, _number)
        return Axis(title, low, high, ticks, True, form)

    @staticmethod
    def times(title: str, low: float, high: float) -> Axis:
        """Logarithmic, of times in seconds."""
        return Axis(title, low, high, log_ticks(low, high, lambda s: brief_time(1e9 * s)), True, ".3~s", "s")


def log_ticks(low: float, high: float, name: Callable[[float], str]) -> list[tuple[float, str]]:
    """Marks of a logarithmic axis with their names: the finest that are not more than MOST_TICKS."""
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    found: list[float] = []
    for steps in STEPS:
        found = [value for e in exponents for m in steps if low <= (value := m * 10.0**e) <= high]
        if len(found) <= MOST_TICKS:
            break
    if len(found) > MOST_TICKS:
        every = math.ceil(len(found) / MOST_TICKS)
        found = [value for value in found if round(math.log10(value)) % every == 0]
    if len(found) < 3:
        # Hardly a logarithmic axis: marks at even distances.
        size = 10.0 ** math.floor(math.log10((high - low) / MOST_TICKS))
        step = next(m * size for m in (1.0, 2.0, 5.0, 10.0) if (high - low) / (m * size) <= MOST_TICKS)
        found = [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
    return [(value, name(value)) for value in found]


def _number(value: float) -> str:
    if 1e-3 <= value < 1e5:
        return f"{value:.3g}" if value < 1e3 else count(round(value))
    digits, exponent = f"{value:.1e}".split("e")
    return f"{digits.removesuffix('.0')}·{power(int(exponent))}"


@dataclass(frozen=True)
class Series:
    """Points of one name: marks, a line, or both. All series of a name have one entry in the legend, and are hidden together."""

    name: str
    ink: str
    x: Values
    y: Values
    line: float = 0.0
    """Its width, px; 0: no line."""
    mark: float = 0.0
    """The size of the marks, px; 0: none."""
    symbol: str = "circle"
    """circle, square, diamond, triangle-up, x, cross or dash."""
    dash: bool = False
    hollow: bool = False
    shade: float = 1.0
    """Its opacity."""
    below: bool = False
    """Whether the area below it is filled."""
    told: bool = True
    """Whether the mouse over it shows its name and its numbers."""
    note: str = ""
    """Behind the name there."""


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
    """Lines or marks in space under one name."""

    name: str
    ink: str
    points: Array
    """(n, 3), m. Of lines: one after the other, NaN between lines that do not meet."""
    line: float = 0.0
    marks: Values | float = 0.0
    """Sizes, px."""
    texts: Sequence[str] = ()
    """What the mouse shows of each point."""
    names: Sequence[str] = ()
    """What stands beside each point."""
    shade: float = 1.0
    shown: bool = True
    """Whether it is there before its entry in the legend is clicked."""


@dataclass(frozen=True)
class Space:
    """Lines and marks in space, turned with the mouse."""

    name: str
    parts: Sequence[Part]
    towards: Array
    """From where it is seen, (3,)."""


Plot: TypeAlias = "Chart | Matrix | Space"


def level(name: str, value: float, x: Axis) -> Series:
    """A dashed line across."""
    assert x.low is not None and x.high is not None
    return Series(name, GREY, [x.low, x.high], [value, value], line=1.0, dash=True, told=False)
