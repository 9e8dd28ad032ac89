"""Stability report: errors of every form and of dense algebra on the extreme scenes, compared with the sensitivity of
the problems.
"""

from __future__ import annotations

from ..pipeline import Layout, Section, provenance
from . import loops, measure, plots, tables
from .measure import Stability

__all__ = ["STABILITY", "Stability"]

STABILITY: Layout[Stability] = Layout(
    "stability",
    "stability.json",
    (
        Section("beyond", "Cases in which the square-root form misses its accuracy target", blocks=tables.beyond),
        Section("sweeps", "Error against the parameter", plots=plots.draw, blocks=tables.pictures),
        Section("timed", "Error against run time", measure.timed, blocks=tables.timed),
        Section("recursions", "Inverse dynamics, bias torque, mass matrix", measure.recursions, blocks=tables.recursions),
        Section("derivatives", "Derivatives of forward dynamics", measure.derivatives, blocks=tables.derivatives),
        Section("loops", "Closed loops", loops.measure, blocks=tables.loops),
        Section("singular", "Singular scenes", measure.singular, blocks=tables.singular),
        Section("failed", "Failures", blocks=tables.failed),
        Section("cases", "Every case", measure.cases, blocks=tables.cases),
        provenance(),
    ),
)
