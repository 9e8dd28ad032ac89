"""The sections of the report on a robot, a file each: what is measured, and what is drawn."""

from __future__ import annotations

from ..pipeline import Layout, Section, provenance
from ..robot import Report
from . import accuracy, calls, condition, emergence_plots, growth, kinds, plan, residuals, scene

ROBOT: Layout[Report] = Layout(
    "robot",
    "report.json",
    (
        scene.SECTION,
        plan.SECTION,
        residuals.SECTION,
        calls.SECTION,
        kinds.SECTION,
        accuracy.SECTION,
        condition.SECTION,
        emergence_plots.SECTION,
        growth.SECTION,
        Section("limits", "What the figures do not show"),
        provenance(),
    ),
)
