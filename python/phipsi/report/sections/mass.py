"""Mass matrix of one pose, and the inertia at each joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..._trajectory_files import columns
from .. import draw
from ..pipeline import Section
from ..plotting import Matrix
from ..progress import Reporter
from ..robot import EPS, Report
from ..states import Array
from ..text import significant
from .joints import MOST_ROWS

#: Number of poses for the range of inertias.
POSES = 64


@dataclass(frozen=True)
class Inertia:
    """Range of a diagonal entry of M over the random poses: kg m², or kg for prismatic joints."""

    name: str
    type: str
    least: float
    most: float


def _collect(report: Report, _: Reporter) -> dict[str, Any]:
    report.needs_dense()
    scene, tree = report.scene, report.tree
    diagonals = np.array([np.diagonal(scene.mass_matrix(q)) for q in report.states.q[:POSES]])
    names = [name[2:] for name in columns(scene, "v")]
    kinds = [tree.joints[joint].type for joint in scene.joint_names for _ in range(*scene.v_index(joint).indices(scene.nv))]
    least, most = diagonals.min(axis=0), diagonals.max(axis=0)
    links = sorted((link for link in tree.links.values() if link.mass > 0.0), key=lambda link: -link.mass)
    return {
        "poses": len(diagonals),
        "center_of_mass": scene.center_of_mass(draw.pose(scene, tree)[0]),
        "links": [{"name": link.name, "mass": link.mass} for link in links],
        "inertias": [Inertia(*row) for row in zip(names, kinds, least.tolist(), most.tolist(), strict=True)],
    }


def _plot(report: Report) -> Matrix:
    """|M|; zeros, and entries below the rounding error of the largest entry, are white."""
    sizes: Array = np.abs(report.scene.mass_matrix(report.states.q[0]))
    names = [name[2:] for name in columns(report.scene, "v")]
    return Matrix("mass-matrix", np.where(sizes > EPS * sizes.max(), sizes, np.nan), names, "|M|, kg m², kg m or kg")


def _shown(report: Report) -> dict[str, Any]:
    found = report.parts["mass"]
    rows = found["inertias"][6:] if report.tree.floating else found["inertias"]
    cells = [
        (row.name, *(f"{significant(value)} {'kg' if row.type == 'prismatic' else 'kg m²'}" for value in (row.least, row.most)))
        for row in rows[:MOST_ROWS]
    ]
    return {"rows": cells, "more": max(len(rows) - MOST_ROWS, 0), "pose": draw.pose(report.scene, report.tree)[1]}


SECTION = Section("mass", "Mass and inertia", _collect, lambda report: [_plot(report)], shown=_shown)
