"""A trajectory as files and pictures: state files in, npz and CSV out, joints and energy over time, a stroboscopic figure."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .. import _core, errors
from .._core import Scene
from .._motion import Trajectory
from .draw import View
from .names import write_names
from .plotting import COLOURS, FAINT, INK, styled
from .states import Array
from .structure import Tree

#: What a state file may say.
KEYS = ("q", "qd", "tau")
#: Figures of the robot in a stroboscopic picture.
FLASHES = 9
#: Curves with names; more are drawn without.
MOST_NAMES = 12


def read_state(path: Path, scene: Scene) -> dict[str, Array]:
    """q, qd and tau of a state file, JSON or npz; neutral and zeros where it says nothing.

    In JSON each is a list, or a mapping from joint names to a number or a list. Raises ArgumentError, naming file and key.
    """
    state = {"q": scene.neutral(), "qd": np.zeros(scene.nv), "tau": np.zeros(scene.nv)}
    for key, value in _read(path).items():
        if key not in KEYS:
            raise errors.ArgumentError(f"{path}: found {key!r}; expected {', '.join(KEYS)}")
        name, usual = f"{path}: {key}", state[key]
        if isinstance(value, Mapping):
            indices = scene.q_index if key == "q" else scene.v_index
            value = {joint: usual[indices(joint)] for joint in scene.joint_names} | dict(value)
        state[key] = _core._numbers(name, value, scene, key == "q")
        if state[key].shape != usual.shape:
            raise errors.ShapeError(f"{name}: found shape {state[key].shape}; expected {usual.shape}")
    return state


def _read(path: Path) -> Mapping[str, Any]:
    try:
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as archive:
                return {key: archive[key] for key in archive.files}
        found = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, EOFError) as error:
        raise errors.ArgumentError(f"{path}: found {error}; expected a state as JSON or .npz") from None
    if not isinstance(found, Mapping):
        raise errors.ArgumentError(f"{path}: found a {type(found).__name__}; expected an object with {', '.join(KEYS)}")
    return found


def write(path: Trajectory, folder: Path, *, table: bool) -> list[Path]:
    """Writes trajectory.npz, and trajectory.csv where a table is asked for; gives the files."""
    scene = path.scene
    archive = folder / "trajectory.npz"
    np.savez(
        archive, t=path.t, q=path.q, qd=path.qd, dt=path.dt, method=path.method, joint_names=np.array(scene.joint_names)
    )
    files = [archive]
    if table:
        files.append(folder / "trajectory.csv")
        _table(path, files[-1])
    return files


def columns(scene: Scene, letter: str) -> list[str]:
    """What the entries of q ("q"), or of qd (another letter), are called: the letter, a colon and the joint."""
    index = scene.q_index if letter == "q" else scene.v_index
    names = []
    for joint in scene.joint_names:
        at = index(joint)
        count = at.stop - at.start
        names += [f"{letter}:{joint}"] if count == 1 else [f"{letter}:{joint}[{i}]" for i in range(count)]
    return names


def _table(path: Trajectory, file: Path) -> None:
    with file.open("w", newline="", encoding="utf-8") as stream:
        out = csv.writer(stream)
        out.writerow(["t", *columns(path.scene, "q"), *columns(path.scene, "qd")])
        # repr: every digit comes back.
        out.writerows([repr(float(x)) for x in row] for row in np.column_stack([path.t, path.q, path.qd]))


@styled
def motion_plot(path: Trajectory) -> tuple[str, Figure]:
    """Coordinates, rates, and energy over time."""
    energy, names = path.energy(), columns(path.scene, "q")
    figure = Figure(figsize=(7.2, 6.6), layout="constrained")
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=(1.25, 1.0, 1.0))
    curves = _curves(top, path.t, path.q)
    _curves(middle, path.t, path.qd)
    top.set(ylabel="coordinates (rad, m)")
    middle.set(ylabel="rates (rad/s, m/s)")
    bottom.set(ylabel="energy (J)", xlabel="time (s)")
    kinds = (("kinetic", energy.kinetic), ("of gravity", energy.potential), ("of springs", energy.spring))
    for colour, (name, values) in zip(COLOURS, kinds, strict=False):
        if np.any(values):
            bottom.plot(path.t, values, color=colour, lw=1.2, label=name)
    bottom.plot(path.t, energy.total, color=INK, lw=1.6, label="total")
    beside: Any = {"frameon": False, "loc": "upper left", "bbox_to_anchor": (1.0, 1.02), "fontsize": 7.5}
    bottom.legend(**beside)
    for axes in (top, middle, bottom):
        axes.grid(color=FAINT, lw=0.5)
        axes.margins(x=0.01)
    if 0 < len(names) <= MOST_NAMES:
        legend = top.legend(curves, [str(i) for i in range(len(names))], **beside)
        write_names(legend.get_texts(), [[name[2:]] for name in names])
    return "motion", figure


def _curves(axes: Axes, t: Array, values: Array) -> list[Line2D]:
    colours = mpl.colormaps["viridis"](np.linspace(0.0, 0.92, max(values.shape[1], 1)))
    return [axes.plot(t, values[:, i], color=colours[i], lw=1.1)[0] for i in range(values.shape[1])]


@styled
def stroboscope(path: Trajectory, tree: Tree, flashes: int = FLASHES) -> tuple[str, Figure]:
    """The robot at instants evenly through the motion, links as lines between joints, from pale to dark; its tips' paths between."""
    at, dense = (np.unique(np.linspace(0, len(path) - 1, count).round().astype(int)) for count in (flashes, 400))
    bones = [(joint.parent, joint.child) for joint in tree.joints.values() if joint.parent in tree.links]
    tips = [link for link in tree.links if not tree.children.get(link)] or [tree.root]
    frozen, flown = path.scene.placements(path.q[at]), path.scene.placements(path.q[dense])
    origins = {name: placement[:, :3, 3] for name, placement in frozen.items()}
    view = View.best(np.concatenate(list(origins.values())))
    figure = Figure(figsize=(7.2, 5.4), layout="constrained")
    axes = figure.add_subplot()
    for tip in tips:
        axes.plot(*view.flat(flown[tip][:, :3, 3]).T, color=COLOURS[2], lw=0.7, alpha=0.6)
    ends = np.array([[view.flat(origins[str(end)]) for end in bone] for bone in bones]).reshape(-1, 2, len(at), 2)
    for i, shade in enumerate(np.linspace(0.18, 1.0, len(at))):
        lines = ends[:, :, i]
        axes.add_collection(LineCollection(list(lines), colors=COLOURS[0], alpha=shade, linewidths=1.0 + 1.4 * shade))
        axes.plot(*lines[:, 1].T, "o", color=INK, alpha=shade, ms=2.6, lw=0)
    axes.set_aspect("equal", "datalim")
    axes.autoscale()
    axes.margins(0.08)
    axes.set_axis_off()
    title = f"{len(at)} instants from t = {path.t[0]:g} s (pale) to {path.t[-1]:g} s (dark); z up; orange: paths of the tips"
    axes.set_title(title, fontsize=8.5, color="#5c646c")
    return "stroboscope", figure
