"""Joint limits and gravity torques."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..._trajectory_files import columns
from .. import draw
from ..pipeline import Section
from ..progress import Reporter
from ..robot import Report
from ..text import minus, significant

#: Largest number of rows of the table.
MOST_ROWS = 120


@dataclass(frozen=True)
class Row:
    """One coordinate of a joint: limits in rad or m, rad/s or m/s, N m or N; infinite if there is none."""

    name: str
    """Name of the joint, with an index if it has several coordinates."""
    type: str
    lower: float
    upper: float
    velocity: float
    effort: float
    gravity_here: float
    """Gravity torque in the pose of the figure, N m or N."""
    gravity_max: float
    """Largest absolute gravity torque over the random poses."""

    @property
    def share(self) -> float | None:
        """Largest gravity torque relative to the limit; None without a limit."""
        return self.gravity_max / self.effort if np.isfinite(self.effort) and self.effort > 0.0 else None


def _collect(report: Report, _: Reporter) -> list[Row]:
    scene, tree = report.scene, report.tree
    poses = scene.gravity_torque(report.states.q)
    here, most = scene.gravity_torque(draw.pose(scene, tree)[0]), np.abs(poses).max(axis=0)
    limits, names = scene.limits, [name[2:] for name in columns(scene, "v")]
    rows = []
    for joint in scene.joint_names:
        at = scene.v_index(joint)
        for i in range(at.start, at.stop):
            own = (limits.lower[i], limits.upper[i], limits.velocity[i], limits.effort[i], here[i], most[i])
            rows.append(Row(names[i], tree.joints[joint].type, *map(float, own)))
    return rows


def _shown(report: Report) -> dict[str, Any]:
    """Text of each row, without the free joint of a floating base, which has no actuator."""
    every: Sequence[Row] = report.parts["joints"]
    rows = every[6:] if report.tree.floating else every
    shares = {row.name: row.share for row in rows if row.share is not None}
    return {
        "rows": [_texts(row) for row in rows[:MOST_ROWS]],
        "more": max(len(rows) - MOST_ROWS, 0),
        "worst": max(shares.items(), key=lambda pair: pair[1], default=None),
        "pose": draw.pose(report.scene, report.tree)[1],
    }


def _texts(row: Row) -> dict[str, Any]:
    angle, force = ("m", "N") if row.type == "prismatic" else ("rad", "N m")
    span = "none" if np.isinf(row.lower) and np.isinf(row.upper) else f"{_number(row.lower)} to {_number(row.upper)} {angle}"
    return {
        "name": row.name, "type": row.type, "span": span, "speed": _with(row.velocity, f"{angle}/s"), "effort": _with(row.effort, force),
        "here": _with(row.gravity_here, force), "most": _with(row.gravity_max, force), "share": row.share,
    }  # fmt: skip


def _number(value: float) -> str:
    return minus(f"{value:.3g}") if np.isfinite(value) else "∞" if value > 0 else "−∞"


def _with(value: float, unit: str) -> str:
    if not np.isfinite(value):
        return "none"
    return f"{significant(value) if abs(value) >= 1e-9 else 0} {unit}"


SECTION = Section("joints", "Limits and gravity", _collect, shown=_shown, empty=[])
