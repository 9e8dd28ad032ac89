"""The sections of the report on a robot, a file each: what is measured, and what is drawn."""

from __future__ import annotations

from ..pipeline import Layout, Section, provenance
from ..robot import Report
from . import accuracy, calls, condition, emergence_plots, growth, kinds, plan, residuals, scene, view

MEASURED = (view, scene, plan, residuals, calls, kinds, accuracy, condition, emergence_plots, growth)
LIMITS: Section[Report] = Section("limits", "What the figures do not show")
ROBOT: Layout[Report] = Layout("robot", "report.json", (*(one.SECTION for one in MEASURED), LIMITS, provenance()))
