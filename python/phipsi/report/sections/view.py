"""The robot in motion, one joint after another."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..._random import ranges
from .. import draw, embed
from ..pipeline import Section
from ..progress import Reporter
from ..robot import Report
from ..states import Array

#: Duration of the motion of a joint, s; largest duration of all, s; frames per second.
A_JOINT, ALL, RATE = 1.6, 16.0, 15.0
#: Amplitude of a joint: rad; fraction of the size of the robot.
TURN, SLIDE = 0.8, 0.1


def one_by_one(report: Report) -> tuple[Array, Array]:
    """Times, s, and configurations: each joint in turn moves to both sides of the pose of the figure, within its
    limits.
    """
    scene, start = report.scene, draw.pose(report.scene, report.tree)[0]
    low, high = ranges(scene)
    reach = np.full(scene.nv, TURN)
    for name in scene.joint_names:
        if report.tree.joints[name].type == "prismatic":
            reach[scene.v_index(name)] = SLIDE * _size(report)
    # A floating base does not move, unless the robot has no other joints.
    first = 6 if report.tree.floating and scene.nv > 6 else 0
    away = scene.difference(scene.neutral(), start)
    frames = max(int(min(A_JOINT, ALL / (scene.nv - first)) * RATE), 4)
    swing = np.sin(np.linspace(0.0, 2.0 * np.pi, frames, endpoint=False))
    steps = np.zeros(((scene.nv - first) * frames + 1, scene.nv))
    for i in range(first, scene.nv):
        rows = slice((i - first) * frames, (i - first + 1) * frames)
        steps[rows, i] = np.clip(away[i] + reach[i] * swing, min(low[i], away[i]), max(high[i], away[i])) - away[i]
    return np.arange(len(steps)) / RATE, scene.integrate(start, steps)


def _size(report: Report) -> float:
    from ...view.shapes import robot_size

    return robot_size(report.scene)


def _collect(report: Report, _: Reporter) -> dict[str, Any]:
    embed.check(report.scene)
    return {"file": None if report.scene.file is None else str(report.scene.file)}


def _shown(report: Report) -> dict[str, Any]:
    t, q = one_by_one(report)
    return embed.robot(report.scene, q, t)


SECTION = Section("view", "In motion", _collect, shown=_shown)
