"""Page of `phipsi simulate`: the robot in motion, curves over time, energy, and exceeded limits."""

from __future__ import annotations

import colorsys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from .._core import Scene
from .._forces import are_of, of_motion, of_pairs
from .._motion import Trajectory
from .._trajectory_files import columns
from . import embed, motion
from .page import Block, Figure, Table
from .pipeline import Findings, Layout, Section, provenance
from .plotting import COLORS, GRAY, Axis, Chart, Panel, Series
from .progress import Reporter
from .states import Array
from .structure import Tree
from .text import plural, scientific

#: Number of points of a curve, limited by the resolution of a screen.
MOST_ROWS = 1200
#: Largest number of values in one hover label.
MOST_TOGETHER = 12
#: Number of legends: of joints, forces, energy, and constraint error.
MOST_LEGENDS = 4
#: Number of impacts in the table.
MOST_IMPACTS = 40
#: Number of pairs of colliders in the table of contacts, and of curves of their forces.
MOST_TOUCHING, MOST_PAIRS = 40, 10
#: Rows of the energy table that are always shown, and names of the rows.
ALWAYS = ("change", "remainder")
KINDS = {"torque": "work of given torques", "damping": "work of damping", "friction": "work of dry friction", "control": "work of the control law"}
KINDS |= {"stops": "work of joint stops", "contacts": "work of contacts", "change": "change of the energy", "remainder": "remainder"}
#: Colors of the curves, in order.
INKS = (*COLORS[:6], "#8c564b", "#7f7f7f", "#17becf", "#bcbd22")
#: Half width of an interval of 95 % of a normal distribution, in standard deviations.
INTERVAL = 1.96


@dataclass
class Run(Findings):
    """One simulation of one state."""

    name: str
    path: Trajectory
    tree: Tree
    torque: Array
    """Joint torques without springs, damping and friction, (rows, nv), N m or N."""
    error: float | None = None
    """Estimated error at the end, rad or m."""

    def head(self) -> dict[str, Any]:
        path = self.path
        return {"name": self.name, "steps": path.steps, "dt": path.dt, "method": path.integrator, "joints": list(path.scene.joint_names)}


def _view(run: Run, _: Reporter) -> dict[str, Any]:
    embed.check(run.path.scene)
    return {"seconds": float(run.path.t[-1])}


def over_time(run: Run) -> Chart:
    """Coordinates, joint velocities, torques and energies, one panel each."""
    path, scene = run.path, run.path.scene
    rows = np.unique(np.linspace(0, len(path) - 1, MOST_ROWS).round().astype(int))
    energy, effort = path.energy(), scene.limits.effort
    names = [name[2:] for name in columns(scene, "v")]
    found: list[tuple[str, Mapping[str, Array]]] = [
        ("q, rad or m", {name[2:]: path.q[rows, i] for i, name in enumerate(columns(scene, "q"))}),
        ("qd, rad/s or m/s", {name: path.qd[rows, i] for i, name in enumerate(names)}),
    ]
    shares = {name: run.torque[rows, i] / effort[i] for i, name in enumerate(names) if np.isfinite(effort[i]) and effort[i] > 0.0}
    if np.any(run.torque):
        found.append(("torque, N m or N", {name: run.torque[rows, i] for i, name in enumerate(names)}))
        if shares:
            found.append(("torque relative to its limit", shares))
    if (forces := of_motion(path, rows)) is not None:
        sizes = np.linalg.norm(forces.force, axis=-1)
        sizes_of = {name: sizes[:, i] for i, name in enumerate(forces.names) if name}
        for pair, force in list(of_pairs(path).items())[:MOST_PAIRS]:
            sizes_of[" on ".join(pair)] = np.linalg.norm(force[rows], axis=-1)
        if sizes_of:
            found.append((f"force of {forces.what}s, N", sizes_of))
    kinds = {"kinetic": energy.kinetic, "potential": energy.potential, "spring": energy.spring, "total": energy.total}
    found.append(("energy, J", {name: values[rows] for name, values in kinds.items() if name == "total" or np.any(values)}))
    if scene.loops.names:
        found.append(("constraint error, m or rad", {"drift": path.drift[rows]}))
    # Names of one legend, which the panels of joints share, have different colors.
    joints = list(dict.fromkeys(label for _, values in found[:2] for label in values))
    inks = dict(zip(joints, colors(len(joints)), strict=True))
    for _, values in found[2:]:
        others = [label for label in values if label not in inks]
        inks |= dict(zip(others, colors(len(others)), strict=True))
    time = Axis("time, s", form=".3~f", unit=" s")
    panels = []
    for title, values in found:
        series = [Series(label, inks[label], path.t[rows], one, line=1.6) for label, one in values.items()]
        if values is shares:
            ends = path.t[[0, -1]]
            series += [Series("limit of torque", GRAY, ends, [way, way], line=1.0, dash=True, told=False) for way in (1.0, -1.0)]
        for label, one in values.items():
            if (deviation := _deviation(path, title, label)) is not None:
                away = INTERVAL * deviation[rows]
                series += [Series(f"95 % band of {label}", inks[label], path.t[rows], one + way * away, line=0.8, dash=True, told=False) for way in (1.0, -1.0)]
        panels.append(Panel(time, Axis(title, form=".4~g"), series))
    return Chart("over-time", panels, height=200, linked=True, together=len(names) <= MOST_TOGETHER)


def colors(count: int) -> list[str]:
    """Different colors: those of INKS, or hues in two lightnesses if there are more."""
    if count <= len(INKS):
        return list(INKS[:count])
    found = (colorsys.hls_to_rgb(i / count, 0.36 if i % 2 else 0.58, 0.75) for i in range(count))
    return ["#" + "".join(f"{round(255 * part):02x}" for part in color) for color in found]


def by_legend(chart: Chart) -> list[Chart]:
    """Charts of consecutive panels with the same names, so that each legend is below its curves."""
    groups: list[tuple[set[str], list[Panel]]] = []
    for panel in chart.panels:
        names = {one.name for one in panel.series}
        if groups and names & groups[-1][0]:
            groups[-1][1].append(panel)
            groups[-1][0].update(names)
        else:
            groups.append((names, [panel]))
    return [replace(chart, name=f"{chart.name}{f'-{i}' if i else ''}", panels=panels) for i, (_, panels) in enumerate(groups)]


def _deviation(path: Trajectory, title: str, joint: str) -> Array | None:
    """Standard deviations of a curve of a joint of one axis, if the trajectory has bands."""
    if path.bands is None or title[:2] not in ("q,", "qd") or joint not in path.scene.joint_names:
        return None
    own = path.scene.v_index(joint)
    bands = path.bands.q if title.startswith("q,") else path.bands.qd
    return bands[:, own.start] if own.stop - own.start == 1 else None


def _shown(run: Run) -> dict[str, Any]:
    return embed.robot(run.path.scene, run.path)


def _limits(run: Run) -> Sequence[Block]:
    broken = run.path.violations()
    if not broken:
        blocks: list[Block] = ["No recorded row exceeds a limit of position or velocity."]
    else:
        rows = [(one.joint, one.limit, *(f"{value:.4g}{unit(run.path.scene, one.joint, one.limit)}" for value in (one.bound, one.worst)), f"{one.time:.3g} s") for one in broken]
        blocks = [Table(("joint", "limit", "value", "worst value", "first exceeded at"), rows, 2)]
    if run.path.limits == "stop":
        found = run.path.stops
        blocks.append(f"Joint limits were stops, with {plural(len(found), 'impact')}." + (f" The first {MOST_IMPACTS}:" if len(found) > MOST_IMPACTS else ""))
        hits = [
            (one.joint, one.limit, f"{one.time:.4g} s", f"{one.speed:.3g}{unit(run.path.scene, one.joint, 'velocity')}", f"{one.impulse:.3g}{unit(run.path.scene, one.joint, 'impulse')}")
            for one in found[:MOST_IMPACTS]
        ]
        if hits:
            blocks.append(Table(("joint", "stop", "time", "speed", "impulse"), hits, 2))
    else:
        blocks.append("Joint limits were not enforced.")
    return blocks


def unit(scene: Scene, joint: str, what: str) -> str:
    """Unit, with a space before it, of a limit of a Violation or of an impulse of a joint; empty for controls of actuators, whose units are their own."""
    if what.startswith("control"):
        return ""
    units = {"lower": ("rad", "m"), "upper": ("rad", "m"), "velocity": ("rad/s", "m/s"), "impulse": ("N m s", "N s")}
    return " " + units.get(what, ("N m", "N"))[scene.joints[joint].type == "prismatic"]


class Touch(NamedTuple):
    """A pair of colliders that touches in recorded rows."""

    first: str
    second: str
    largest_force: float
    """Largest sum of the forces at their points, N."""
    begin: float
    """Time of the first and of the last row in which they touch, s."""
    end: float


def touches(path: Trajectory) -> list[Touch]:
    """The pairs of colliders that touch in recorded rows, the largest force first."""
    found = []
    for pair, force in of_pairs(path).items():
        shapes = path.contacts.shapes  # type: ignore[union-attr]  # there are pairs
        at = path.t[shapes.row[are_of(shapes, pair)]]
        found.append(Touch(*pair, float(np.linalg.norm(force, axis=1).max()), float(at.min()), float(at.max())))
    return found


def _contacts(run: Run) -> Sequence[Block]:
    found = run.parts["contacts"]
    if not found:
        return ["No shapes touch in a recorded row."]
    rows = [(one.first, one.second, f"{one.largest_force:.4g} N", f"{one.begin:.4g} s", f"{one.end:.4g} s") for one in found[:MOST_TOUCHING]]
    more = f" The {MOST_TOUCHING} with the largest forces:" if len(found) > MOST_TOUCHING else ""
    verb = "touches" if len(found) == 1 else "touch"
    return [f"{plural(len(found), 'pair')} of shapes {verb} in the recorded rows.{more}", Table(("shape", "shape", "largest force", "first contact", "last contact"), rows, 2)]


def _energy(run: Run) -> Sequence[Block]:
    audit = run.path.energy_audit()
    rows = [(KINDS.get(kind, kind), f"{float(value):.4g}") for kind, value in audit._asdict().items() if kind != "relative_error" and (value != 0.0 or kind in ALWAYS)]
    share = 100.0 * float(audit.relative_error)
    verdict = f"The remainder, the error of the integrator, is {share:.2g} % of the energy exchanged."
    if audit.relative_error > motion.SHARE:
        verdict += f" That is more than 1 %: use a smaller step{motion.or_control(run.path.scene, ' or error control')}."
    blocks: list[Block] = [Table(("work or change", "J"), rows, 1), verdict]
    if run.path.estimated_error > 0.0:
        blocks.append(f"Sum of the estimated errors of all substeps: {scientific(float(run.path.estimated_error))} rad or m.")
    elif run.error is not None:
        blocks.append(f"Estimated error of the final configuration, by comparison with a more accurate simulation: {scientific(run.error)} rad or m.")
    return blocks


def _pictures(_: Run) -> Sequence[Block]:
    return [Figure("stroboscope", "The robot at equidistant times, later ones more intense, and the paths of its tips. Drag to rotate the view.")]


def _over_time(_: Run) -> Sequence[Block]:
    # Figures that were not drawn are omitted.
    more = [Figure(f"over-time-{i}", "") for i in range(1, MOST_LEGENDS)]
    return [Figure("over-time", ""), *more, "Click a name to hide its curve, double-click it to hide all others. Drag to zoom in, double-click to reset."]


RUN: Layout[Run] = Layout(
    "run",
    "run.json",
    (
        Section("view", "The motion", _view, shown=_shown),
        Section("curves", "Over time", plots=lambda run: by_legend(over_time(run)), blocks=_over_time),
        Section("energy", "Energy and error", blocks=_energy),
        Section("contacts", "Shapes that touch", lambda run, _: touches(run.path), blocks=_contacts),
        Section("limits", "Limits", blocks=_limits),
        Section("pictures", "Stroboscopic picture", plots=lambda run: [motion.stroboscope(run.path, run.tree)], blocks=_pictures),
        provenance(),
    ),
)


def layout(scene: Scene) -> Layout[Run]:
    """The page of a scene: without colliders, it has no section of shapes that touch."""
    return RUN if scene.collider_names else replace(RUN, sections=[one for one in RUN.sections if one.key != "contacts"])
