"""The condition number of the mass matrix, its picture, and what conditioning costs each method."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ..pipeline import Section
from ..plotting import Plot, direct_labels, fine_ticks, level, panels, power_ticks, styled, ticks
from ..progress import Reporter
from ..robot import EPS, Report
from ..states import Array
from ..text import power, scientific, symbols
from .accuracy import Accuracy


def _collect(report: Report, _: Reporter) -> dict[str, Any]:
    values = report.conditions
    rank = int(np.linalg.matrix_rank(_first(report), hermitian=True))
    return {"min": values.min(), "median": float(np.median(values)), "max": values.max(), "rank": rank, "values": values}


def _first(report: Report) -> Array:
    """The mass matrix at the first state."""
    return report.scene.mass_matrix(report.states.q[0])


def _plots(report: Report) -> Iterable[Plot]:
    yield mass_matrix(_first(report))
    rows = [row for row in report.parts["accuracy"] if row.precision == "float64" and np.isfinite(row.error_median)]
    if rows:
        yield error_against_condition(rows, report.conditions)


def _units(value: float) -> str:
    return f"{value:g}" if value < 1e4 else power(round(np.log10(value)))


@styled
def error_against_condition(rows: Sequence[Accuracy], conditions: Array) -> tuple[str, Figure]:
    """Digits lost, state by state, against the condition number of M."""
    eps = EPS["float64"]
    figure, ((axes,),) = panels((10.0, 3.7), margins=(0.075, 0.775, 0.96, 0.135))
    finite = conditions[np.isfinite(conditions)]
    low, high = float(finite.min()), float(finite.max())
    pad = max((high / low) ** 0.06, 1.08)
    highest, lowest = max(row.error_max for row in rows) / eps, min(row.error_median for row in rows) / eps
    axes.set(
        xscale="log", xlim=(low / pad, high * pad), xlabel="condition number of M at the state",
        yscale="log", ylim=(max(0.02, lowest / 20.0), max(highest * 3.0, 30.0)), ylabel="error in units of eps",
    )  # fmt: skip
    if high / low > 30:
        power_ticks(axes.xaxis, 8)
    else:
        fine_ticks(axes.xaxis, high / low, scientific)
    ticks(axes.yaxis, _units)
    level(axes, 1.0)
    entries = []
    for row in rows:
        values = row.errors / eps
        axes.plot(conditions, values, "o", ms=3.2, color=row.colour(), alpha=0.45, mew=0)
        at = int(np.argmax(np.where(np.isfinite(values), conditions, 0.0)))
        entries.append((float(conditions[at]), float(values[at]), symbols(row.method), row.colour()))
    direct_labels(axes, entries, 0.08)
    return "error-against-condition", figure


@styled
def mass_matrix(matrix: Array) -> tuple[str, Figure]:
    """|M| by colour; zeros, and what is only rounding beside the largest entry, are white."""
    figure, ((axes,),) = panels((4.9, 4.2), margins=(0.04, 0.86, 0.97, 0.05))
    sizes = np.abs(matrix)
    logs = np.log10(sizes, where=sizes > EPS["float64"] * sizes.max(), out=np.full_like(matrix, np.nan))
    bar = figure.colorbar(axes.imshow(logs, cmap="YlGnBu", interpolation="nearest"), ax=axes, fraction=0.045, pad=0.03)
    ticks(bar.ax.yaxis, lambda value: power(round(value)), MaxNLocator(integer=True, nbins=7))
    bar.outline.set_visible(False)  # type: ignore[operator,unused-ignore]
    bar.set_label("|M|, SI units (kg m², kg m, kg)")
    axes.set(xticks=[], yticks=[], xlabel=f"{len(matrix)} × {len(matrix)}, base to tip in the order of qd")
    return "mass-matrix", figure


SECTION = Section("condition", "Condition", _collect, _plots)
