"""The page of `phipsi simulate`: the robot in motion, what moves it, and the limits that it breaks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from .._motion import Trajectory
from . import embed, motion
from .page import Block, Figure, Table
from .pipeline import Findings, Layout, Section, provenance
from .plotting import Plot
from .progress import Reporter
from .states import Array
from .structure import Tree

#: Rows that curves show: a screen has no more points.
MOST_ROWS = 1200


@dataclass
class Run(Findings):
    """One simulation of one state."""

    name: str
    path: Trajectory
    tree: Tree
    torque: Array
    """What acts at the joints beside springs, damping and friction, (rows, nv), N m or N."""

    def head(self) -> dict[str, Any]:
        path = self.path
        return {"name": self.name, "steps": path.steps, "dt": path.dt, "method": path.method, "joints": list(path.scene.joint_names)}


def _view(run: Run, _: Reporter) -> dict[str, Any]:
    embed.check(run.path.scene)
    return {"seconds": float(run.path.t[-1])}


def _curves(run: Run) -> dict[str, Any]:
    """Curves that answer to the mouse, where their library is there."""
    return {"curves": None if embed.lacking() is not None else Markup("").join([embed.library(), embed.curves("over-time", *panels(run))])}


def panels(run: Run) -> tuple[Array, Sequence[tuple[str, Mapping[str, Array]]]]:
    """Times, and by what stands on the axis the curves by their names."""
    path, scene = run.path, run.path.scene
    rows = np.unique(np.linspace(0, len(path) - 1, MOST_ROWS).round().astype(int))
    energy, effort = path.energy(), scene.limits.effort
    q = {name[2:]: path.q[rows, i] for i, name in enumerate(motion.columns(scene, "q"))}
    names = [name[2:] for name in motion.columns(scene, "v")]
    rates = {name: path.qd[rows, i] for i, name in enumerate(names)}
    found: list[tuple[str, Mapping[str, Array]]] = [("q, rad or m", q), ("qd, rad/s or m/s", rates)]
    shares = {name: run.torque[rows, i] / effort[i] for i, name in enumerate(names) if np.isfinite(effort[i]) and effort[i] > 0.0}
    if np.any(run.torque):
        found.append(("torque, N m or N", {name: run.torque[rows, i] for i, name in enumerate(names)}))
        if shares:
            ends = {"limit": np.ones(len(rows)), "limit the other way": -np.ones(len(rows))}
            found.append(("torque / its limit", shares | ends))
    kinds = {"kinetic": energy.kinetic, "of gravity": energy.potential, "of springs": energy.spring, "total": energy.total}
    found.append(("energy, J", {name: values[rows] for name, values in kinds.items() if name == "total" or np.any(values)}))
    return path.t[rows], found


def _shown(run: Run) -> dict[str, Any]:
    return embed.robot(run.path.scene, run.path.t, run.path.q)


def _limits(run: Run) -> Sequence[Block]:
    broken = run.path.violations()
    if not broken:
        return ["No recorded row is beyond a limit of position or speed."]
    rows = [(one.joint, one.limit, f"{one.bound:g}", f"{one.time:.3g}", f"{one.worst:.4g}") for one in broken]
    return ["Limits are told, never enforced.", Table(("joint", "limit", "at", "first beyond it, s", "worst"), rows, 2)]


def _plots(run: Run) -> list[Plot]:
    return [motion.motion_plot(run.path), motion.stroboscope(run.path, run.tree)]


def _pictures(_: Run) -> Sequence[Block]:
    return [Figure("stroboscope", "The robot at instants evenly through the motion, from pale to dark, with the paths of its tips.")]


RUN: Layout[Run] = Layout(
    "run",
    "run.json",
    (
        Section("view", "The motion", _view, shown=_shown),
        Section("curves", "Over time", shown=_curves),
        Section("limits", "Limits", blocks=_limits),
        Section("pictures", "In one picture", plots=_plots, blocks=_pictures),
        provenance(),
    ),
)
