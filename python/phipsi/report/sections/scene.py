"""Properties of the robot: facts, figure, kinematic tree."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .. import draw
from ..draw import TURN
from ..pipeline import Section
from ..plotting import Plot
from ..progress import Reporter
from ..robot import Report
from ..structure import Row
from ..text import scientific

#: Largest number of rows of the tree.
MOST_ROWS = 400


def _collect(report: Report, _: Reporter) -> dict[str, Any]:
    scene, tree, plan = report.scene, report.tree, report.scene.plan()
    return {
        "name": report.name,
        "source": report.source,
        "nq": scene.nq,
        "nv": scene.nv,
        "bodies": plan.bodies,
        "links": plan.links,
        "mass": tree.mass,
        "gravity": scene.gravity,
        "warnings": report.warnings,
        "joints": [{"name": j.name, "type": j.type, "parent": j.parent, "child": j.child} for j in tree.joints.values()],
    }


def _plots(report: Report) -> list[Plot]:
    return [draw.skeleton(report.scene, report.tree, draw.pose(report.scene, report.tree)[0])]


def _shown(report: Report) -> dict[str, Any]:
    rows = list(report.tree.rows())
    return {
        "pose": draw.pose(report.scene, report.tree)[1],
        "source": Path(report.source).name,
        "rows": [_row(row) for row in rows[:MOST_ROWS]],
        "more": max(len(rows) - MOST_ROWS, 0),
    }


def _row(row: Row) -> dict[str, Any]:
    joint = row.joint
    mass = f"{scientific(row.link.mass, 2)} kg" if row.link.mass > 0.0 else ""
    kind = "" if joint.type == "fixed" else f"{joint.type}{_axis(row)}"
    details = " · ".join(text for text in (kind, mass) if text)
    ink, rails = draw.COLORS.get(joint.type, TURN), min(row.level, 12) - row.branch
    return {"joint": joint, "ink": ink, "details": details, "rails": rails, "branch": row.branch}


def _axis(row: Row) -> str:
    """Letter of the axis, if it is a coordinate axis of the frame."""
    if row.joint.type not in ("revolute", "continuous", "prismatic", "screw"):
        return ""
    axis = row.joint.axis
    assert axis is not None
    at = int(np.argmax(np.abs(axis)))
    if abs(abs(axis[at]) - 1.0) > 1e-9:
        return " skew"
    return f" {'−' if axis[at] < 0 else ''}{'xyz'[at]}"


SECTION = Section("scene", "Links and joints", _collect, _plots, shown=_shown)
