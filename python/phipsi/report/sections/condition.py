"""Condition number of the mass matrix, and its effect on each method."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ..pipeline import Section
from ..plotting import Axis, Chart, Panel, Plot, Series, level
from ..progress import Reporter
from ..robot import EPS, Report
from ..states import Array
from ..text import symbols
from .accuracy import Accuracy


def _collect(report: Report, _: Reporter) -> dict[str, Any]:
    values = report.conditions
    rank = int(np.linalg.matrix_rank(report.scene.mass_matrix(report.states.q[0]), hermitian=True))
    return {"min": values.min(), "median": float(np.median(values)), "max": values.max(), "rank": rank, "values": values}


def _plots(report: Report) -> Iterable[Plot]:
    rows = [row for row in report.parts["accuracy"] if np.isfinite(row.error_median)]
    if rows:
        yield error_against_condition(rows, report.conditions)


def error_against_condition(rows: Sequence[Accuracy], conditions: Array) -> Chart:
    """Error of every state against the condition number of M."""
    eps = EPS
    finite = conditions[np.isfinite(conditions)]
    low, high = float(finite.min()), float(finite.max())
    pad = max((high / low) ** 0.06, 1.08)
    highest, lowest = max(row.error_max for row in rows), min(row.error_median for row in rows)
    x = Axis.powers("condition number of M at the state", low / pad, high * pad, form=".3~g")
    y = Axis.powers("relative error of accelerations", max(0.02 * eps, lowest / 20.0), max(highest * 3.0, 30.0 * eps))
    marks = [Series(symbols(row.method), row.color(), conditions, row.errors, mark=5, shade=0.55) for row in rows]
    return Chart("error-against-condition", [Panel(x, y, [level("machine epsilon", eps, x), *marks])])


SECTION = Section("condition", "Conditioning", _collect, _plots)
