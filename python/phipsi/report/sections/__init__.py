"""Sections of the report on a robot, one file each: measurement and plots. The properties of the robot come first, then
the method.
"""

from __future__ import annotations

from dataclasses import replace

from ..pipeline import Layout, Section, provenance
from ..robot import Report
from . import accuracy, calls, condition, emergence_plots, growth, joints, kinds, mass, plan, residuals, scene, view

USER = (view, scene, joints, mass, calls, kinds)
THEORY = (plan, accuracy, residuals, condition, emergence_plots, growth)
LIMITS: Section[Report] = Section("limits", "Limitations of the measurements")


def _part(title: str, sections: list[Section[Report]]) -> list[Section[Report]]:
    """The same sections with the title of a part."""
    return [replace(sections[0], part=title), *sections[1:]]


ROBOT: Layout[Report] = Layout(
    "robot",
    "report.json",
    (
        *_part("The robot", [one.SECTION for one in USER]),
        *_part("Computation and accuracy", [*(one.SECTION for one in THEORY), LIMITS, provenance()]),
    ),
)
