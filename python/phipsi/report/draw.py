"""The robot as a figure: links as segments, joints with their axes, names at the sides."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._core import Scene
from .._results import Joint
from .labels import Anchor, gathered, sides, spread
from .names import write_names
from .plotting import GREY, INK, panels, styled
from .states import Array, ranges
from .structure import Tree

#: Colours of the parts, in the order of the key.
MERGED, TURN, SLIDE, FREE, MASS = "#b9bec4", "#0072b2", "#d55e00", "#009e73", "#e69f00"
COLOURS = {"fixed": MERGED, "prismatic": SLIDE, "planar": FREE, "spherical": FREE, "floating": FREE}
#: Width of the figure, inches, and the share of it that a column of names takes.
WIDTH, COLUMN = 10.0, 0.24
#: Height of a name, inches; names of more joints than this do not fit beside a figure.
ROW, MOST_NAMES = 0.15, 90


class View(NamedTuple):
    """Orthographic, z up."""

    right: Array
    up: Array
    towards: Array

    @staticmethod
    def of(azimuth: float, elevation: float) -> View:
        """Seen from that direction, rad."""
        ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
        return View(np.array([-sa, ca, 0.0]), np.array([-se * ca, -se * sa, ce]), np.array([ce * ca, ce * sa, se]))

    @staticmethod
    def best(cloud: Array) -> View:
        """The direction from which the points, (n, 3), cover the largest rectangle."""
        size = float(np.ptp(cloud, axis=0).max()) or 1.0
        views = [View.of(azimuth, np.radians(14.0)) for azimuth in np.radians(np.arange(-150.0, 211.0, 15.0) + 7.0)]

        def area(view: View) -> float:
            wide, high = np.ptp(view.flat(cloud), axis=0)
            # Of two opposite views the one from the front, or with x to the right, is chosen.
            favour = 1.0 + 0.02 * view.towards[0] + 0.02 * view.right[0]
            return float((wide + 0.2 * size) * (high + 0.2 * size) * favour)

        return max(views, key=area)

    def flat(self, points: Array) -> Array:
        """Right and up in the picture, (..., 3) to (..., 2)."""
        return points @ np.stack([self.right, self.up], axis=-1)


def pose(scene: Scene, tree: Tree) -> tuple[Array, str]:
    """A configuration that shows the robot, and what to call it."""
    low, high = ranges(scene, tree)
    step = np.clip(np.zeros(scene.nv), low, high)
    q = scene.integrate(scene.neutral(), step)
    placements = scene.placements(q)
    points = np.array([placements[joint.child][:3, 3] for joint in tree.joints.values() if joint.child in placements])
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) if len(points) else np.zeros(2)
    if len(spread) > 1 and spread[1] < 0.15 * spread[0] and scene.nv > 2:
        bend = np.clip(np.where(np.arange(scene.nv) % 2, 0.6, 0.45), low, high)
        return scene.integrate(scene.neutral(), bend), "bent by about 0.5 rad a joint, for at neutral the joints are in line"
    return q, "at the neutral configuration" if not step.any() else "at neutral, moved to within the limits"


@styled
def skeleton(scene: Scene, tree: Tree, q: Array) -> tuple[str, Figure]:
    """The figure of the robot at a configuration."""
    placements = {tree.root: np.eye(4), **scene.placements(q)}
    origins = {name: placement[:3, 3] for name, placement in placements.items()}
    cloud = np.array(list(origins.values()))
    named = tree.movable if len(tree.movable) <= MOST_NAMES else []
    size = float(np.ptp(cloud, axis=0).max()) or 1.0
    view = View.best(cloud)
    low, high = view.flat(cloud).min(axis=0) - 0.06 * size, view.flat(cloud).max(axis=0) + 0.06 * size
    # More for a figure that stands than for one that lies, and room for the names.
    height = max(float(np.clip(3.4 * (high[1] - low[1]) / (high[0] - low[0]), 3.1, 5.7)), min(7.2, ROW * (len(named) / 2 + 5)))
    side = COLUMN if named else 0.03
    figure, ((axes,),) = panels((WIDTH, height), margins=(side, 1.0 - side, 0.97, 0.03))
    axes.set_axis_off()
    room = np.array([WIDTH * (1.0 - 2.0 * side), 0.94 * height])
    # Metres in an inch, alike in both directions.
    share = float(np.max((high - low) / room))
    (left, bottom), (right, top) = ((low + high) / 2 + way * share * room / 2 for way in (-1.0, 1.0))
    axes.set(xlim=(left, right), ylim=(bottom, top))
    _ground(axes, view, size)
    _links(axes, view, tree, origins)
    _masses(axes, view, tree, placements)
    scale = 72.0 / share
    radius = _radius(scale, tree, origins)
    for joint in tree.movable:
        _joint(axes, view, joint, placements[joint.child], radius, scale)
    _names(axes, [Anchor((joint.name,), *map(float, view.flat(origins[joint.child]))) for joint in named], 7.0 / scale, height)
    return "skeleton", figure


def _radius(scale: float, tree: Tree, origins: dict[str, Array]) -> float:
    """Size of a joint's mark in metres: a share of a typical link."""
    ends = [(origins[joint.child], origins[str(joint.parent)]) for joint in tree.movable if joint.parent in origins]
    long = [length for a, b in ends if (length := float(np.linalg.norm(a - b)) * scale) > 3.0]
    return float(np.clip(0.16 * np.median(long or [20.0]), 3.0, 10.0)) / scale


def _line(axes: Axes, view: View, a: Array, b: Array, ink: str, width: float) -> None:
    axes.plot(*view.flat(np.array([a, b])).T, color=ink, lw=width, solid_capstyle="round")


def _ground(axes: Axes, view: View, size: float) -> None:
    """The base frame's axes at its origin."""
    for name, direction in zip("xyz", np.eye(3), strict=True):
        tip = 0.11 * size * direction
        _line(axes, view, np.zeros(3), tip, GREY, 0.7)
        x, y = view.flat(1.25 * tip)
        axes.text(x, y, name, color=GREY, style="italic", ha="center", va="center", fontsize=7.5)


def _links(axes: Axes, view: View, tree: Tree, origins: dict[str, Array]) -> None:
    """Parent's origin to child's, far ones first; what was merged in grey."""
    found = []
    for joint in tree.joints.values():
        if joint.parent in origins and joint.type != "floating":
            a, b = origins[joint.parent], origins[joint.child]
            tail = joint.type == "fixed" and not tree.carries_motion(joint.child)
            found.append((not tail, float(view.towards @ (a + b)), a.tolist(), b.tolist()))
    for carries, _, a, b in sorted(found):
        _line(axes, view, a, b, *((INK, 2.9) if carries else (MERGED, 1.0)))


def _masses(axes: Axes, view: View, tree: Tree, placements: dict[str, Array]) -> None:
    """A disc at each mass centre; its area grows with the mass."""
    links = [tree.links[name] for name in placements if name in tree.links]
    heavy = [link for link in links if link.mass > 0.0 and np.isfinite(link.com).all()]
    if heavy:
        places = view.flat(np.array([placements[link.name][:3, :3] @ link.com + placements[link.name][:3, 3] for link in heavy]))
        masses = np.array([link.mass for link in heavy])
        axes.scatter(places[:, 0], places[:, 1], s=np.maximum(300.0 * masses / masses.max(), 1.0), color=MASS, alpha=0.28, lw=0)


def _joint(axes: Axes, view: View, joint: Joint, placement: Array, radius: float, scale: float) -> None:
    """The axis and, for a turning joint, the circle around it: so large, m, at so many points a metre."""
    centre, ink = placement[:3, 3], COLOURS.get(joint.type, TURN)
    x, y = view.flat(centre)
    if joint.type in ("floating", "spherical"):
        axes.plot([x], [y], "o", ms=2.0 * radius * scale, mfc="none", color=ink, mew=1.1)
    else:
        assert joint.axis is not None
        axis = placement[:3, :3] @ joint.axis
        across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        across /= np.linalg.norm(across)
        angles = np.linspace(0.0, 2 * np.pi, 25)[:, None]
        if joint.type != "prismatic":
            ring = centre + radius * (np.cos(angles) * across + np.sin(angles) * np.cross(axis, across))
            axes.fill(*view.flat(ring).T, fc="#ffffffbf", ec=ink, lw=1.0, zorder=3)
        _line(axes, view, centre - 1.5 * radius * axis, centre + 1.5 * radius * axis, ink, 1.0)
        if joint.type == "prismatic":
            axes.plot([x], [y], "s", ms=0.9 * radius * scale, mfc="white", color=ink, mew=1.0)
            return
    axes.plot([x], [y], "o", ms=3.0, color=ink, mew=0, zorder=4)


def _names(axes: Axes, anchors: list[Anchor], near: float, height: float) -> None:
    """Names in a column left and one right, each with a thin line to its joint."""
    low, high = axes.get_ylim()
    texts, written = [], []
    for left, column in zip((True, False), sides(gathered(anchors, near), float(np.mean(axes.get_xlim()))), strict=True):
        ordered = sorted(column, key=lambda anchor: anchor.y)
        heights = [(ROW * len(anchor.names) + 0.03) / height for anchor in ordered]
        places = spread([(anchor.y - low) / (high - low) for anchor in ordered], heights, 0.0, 1.0)
        elbow = {"arrowstyle": "-", "color": "#9aa1a8", "lw": 0.6, "shrinkA": 2, "shrinkB": 0, "relpos": (float(left), 0.5),
                 "connectionstyle": f"arc,angleA={0 if left else 180},armA=12,rad=0"}  # fmt: skip
        for anchor, place in zip(ordered, places, strict=True):
            texts.append(axes.annotate(
                "", (anchor.x, anchor.y), xytext=(-0.02 if left else 1.02, place), textcoords="axes fraction", va="center",
                ha="right" if left else "left", annotation_clip=False, arrowprops=elbow,
            ))  # fmt: skip
            written.append(anchor.names)
    write_names(texts, written)
