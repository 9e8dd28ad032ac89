"""The robot as a figure: links as segments, joints with their axes, names at the sides, in SVG."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._core import Scene
from .labels import Anchor, Label, columns
from .states import ranges
from .structure import Joint, Tree
from .text import escape

Array = NDArray[np.float64]

#: Colours of the parts, in the order of the key.
INK, MERGED, TURN, SLIDE, FREE = "#2b2f33", "#b9bec4", "#0072b2", "#d55e00", "#009e73"
WIDTH, COLUMN, ROW, MARGIN = 1060.0, 250.0, 14.0, 24.0
#: Names of more joints than this do not fit beside a figure.
MOST_NAMES = 90
COLOURS = {"prismatic": SLIDE, "planar": FREE, "spherical": FREE, "floating": FREE}


@dataclass(frozen=True)
class View:
    """Orthographic, z up; world points to picture points."""

    right: Array
    up: Array
    towards: Array
    scale: float = 1.0
    shift: tuple[float, float] = (0.0, 0.0)

    @staticmethod
    def of(azimuth: float, elevation: float) -> View:
        """Seen from that direction, rad."""
        ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
        return View(np.array([-sa, ca, 0.0]), np.array([-se * ca, -se * sa, ce]), np.array([ce * ca, ce * sa, se]))

    def flat(self, point: Array) -> tuple[float, float]:
        """Where a point is in the picture; y down."""
        x, y = float(self.right @ point), float(self.up @ point)
        return self.scale * x + self.shift[0], -self.scale * y + self.shift[1]


def pose(scene: Scene, tree: Tree) -> tuple[Array, str]:
    """A configuration that shows the robot, and what to call it."""
    low, high = ranges(scene, tree)
    neutral = scene.neutral()
    step = np.clip(np.zeros(scene.nv), low, high)
    caption = "at the neutral configuration" if not step.any() else "at neutral, moved to within the limits"
    q = scene.integrate(neutral, step)
    points = _origins(scene, tree, q)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) if len(points) else np.zeros(2)
    if len(spread) > 1 and spread[1] < 0.15 * spread[0] and scene.nv > 2:
        bend = np.clip(np.where(np.arange(scene.nv) % 2, 0.6, 0.45), low, high)
        return scene.integrate(neutral, bend), "bent by about 0.5 rad a joint, for at neutral the joints are in line"
    return q, caption


def _origins(scene: Scene, tree: Tree, q: Array) -> Array:
    placements = scene.placements(q)
    return np.array([placements[joint.child][:3, 3] for joint in tree.joints.values() if joint.child in placements])


def skeleton(scene: Scene, tree: Tree, q: Array) -> str:
    """The figure as an SVG element."""
    placements = {tree.root: np.eye(4), **scene.placements(q)}
    origins = {name: placement[:3, 3] for name, placement in placements.items()}
    cloud = np.array(list(origins.values()))
    joints = [joint for joint in tree.joints.values() if not joint.fixed]
    named = joints if len(joints) <= MOST_NAMES else []
    size = float(np.ptp(cloud, axis=0).max()) or 1.0
    best = _best(cloud, size)
    height = max(_natural_height(best, cloud), min(760.0, ROW * (len(named) / 2 + 5)))
    view = _framed(best, cloud, size, height, COLUMN if named else MARGIN)
    marks = [_ground(view, size)]
    marks += _segments(view, tree, origins)
    marks += [_mass(view, tree, name, placement) for name, placement in placements.items() if name in tree.links]
    radius = _radius(view, tree, origins)
    marks += [_joint(view, joint, placements[joint.child], radius) for joint in joints]
    anchors = [Anchor((joint.name,), *view.flat(origins[joint.child])) for joint in named]
    marks += [_label(label) for label in columns(anchors, WIDTH, COLUMN, height, ROW)]
    return (
        f'<svg class="skeleton" xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:.0f} {height:.0f}" '
        f'role="img" aria-label="Skeleton of the robot" font-size="11.5" font-family="Helvetica, Arial, sans-serif">'
        f"{''.join(marks)}</svg>"
    )


def _best(cloud: Array, size: float) -> View:
    """The direction from which the joints cover the largest rectangle."""
    azimuths = np.radians(np.arange(-150.0, 211.0, 15.0) + 7.0)
    views = [View.of(azimuth, np.radians(14.0)) for azimuth in azimuths]

    def area(view: View) -> float:
        flat = np.array([view.flat(point) for point in cloud])
        wide, high = np.ptp(flat, axis=0)
        # Of two opposite views the one from the front, or with x to the right, is chosen.
        favour = 1.0 + 0.02 * view.towards[0] + 0.02 * view.right[0]
        return float((wide + 0.2 * size) * (high + 0.2 * size) * favour)

    return max(views, key=area)


def _natural_height(view: View, cloud: Array) -> float:
    """More for a figure that stands than for one that lies."""
    wide, high = np.ptp(np.array([view.flat(point) for point in cloud]), axis=0)
    return float(np.clip(360.0 * high / (wide or 1.0), 330.0, 600.0))


def _framed(view: View, cloud: Array, size: float, height: float, side: float) -> View:
    flat = np.array([view.flat(point) for point in cloud])
    low, high = flat.min(axis=0) - 0.06 * size, flat.max(axis=0) + 0.06 * size
    wide, tall = WIDTH - 2 * side - 40.0, height - 2 * MARGIN
    scale = min(wide / (high[0] - low[0]), tall / (high[1] - low[1]))
    middle = (low + high) / 2 * scale
    shift = (WIDTH / 2 - float(middle[0]), height / 2 - float(middle[1]))
    return View(view.right, view.up, view.towards, scale, shift)


def _radius(view: View, tree: Tree, origins: dict[str, Array]) -> float:
    """Size of a joint's mark in metres: a share of a typical link."""
    lengths = [
        float(np.linalg.norm(origins[joint.child] - origins[joint.parent]))
        for joint in tree.joints.values()
        if not joint.fixed and joint.parent in origins
    ]
    long = [length for length in lengths if length * view.scale > 4.0]
    typical = float(np.median(long)) if long else 30.0 / view.scale
    return min(max(0.16 * typical * view.scale, 4.5), 15.0) / view.scale


def _line(view: View, a: Array, b: Array, style: str) -> str:
    (x1, y1), (x2, y2) = view.flat(a), view.flat(b)
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" {style}/>'


def _ground(view: View, size: float) -> str:
    """The base frame's axes at its origin."""
    marks = []
    for name, direction in zip("xyz", np.eye(3), strict=True):
        tip = 0.11 * size * direction
        marks.append(_line(view, np.zeros(3), tip, 'stroke="#8a9199" stroke-width="1"'))
        x, y = view.flat(1.25 * tip)
        marks.append(
            f'<text x="{x:.1f}" y="{y + 3:.1f}" text-anchor="middle" fill="#8a9199" font-style="italic">{name}</text>'
        )
    return "".join(marks)


def _segments(view: View, tree: Tree, origins: dict[str, Array]) -> list[str]:
    """Parent's origin to child's, far ones first; what was merged in grey."""
    found = []
    for joint in tree.joints.values():
        if joint.parent not in origins or joint.kind == "floating":
            continue
        a, b = origins[joint.parent], origins[joint.child]
        tail = joint.fixed and not tree.carries_motion(joint.child)
        style = (
            f'stroke="{MERGED}" stroke-width="1.4"'
            if tail
            else f'stroke="{INK}" stroke-width="4.2" stroke-linecap="round"'
        )
        found.append((not tail, float(view.towards @ (a + b)), _line(view, a, b, style)))
    return [mark for _, _, mark in sorted(found)]


def _mass(view: View, tree: Tree, name: str, placement: Array) -> str:
    """A disc at the mass centre; its area grows with the mass."""
    link = tree.links[name]
    if link.mass <= 0.0 or not np.isfinite(link.centre).all():
        return ""
    x, y = view.flat(placement[:3, :3] @ link.centre + placement[:3, 3])
    heaviest = max(other.mass for other in tree.links.values())
    radius = 13.0 * np.sqrt(link.mass / heaviest)
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{max(radius, 0.8):.1f}" fill="#e69f00" fill-opacity="0.28"/>'


def _joint(view: View, joint: Joint, placement: Array, radius: float) -> str:
    """The axis and, for a turning joint, the circle around it."""
    centre, colour = placement[:3, 3], COLOURS.get(joint.kind, TURN)
    x, y = view.flat(centre)
    dot = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.2" fill="{colour}"/>'
    if joint.kind in ("floating", "spherical"):
        size = radius * view.scale
        return (
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{size:.1f}" fill="none" stroke="{colour}" stroke-width="1.6"/>{dot}'
        )
    axis = placement[:3, :3] @ joint.axis
    axis = axis / (float(np.linalg.norm(axis)) or 1.0)
    mark = _line(
        view, centre - 1.5 * radius * axis, centre + 1.5 * radius * axis, f'stroke="{colour}" stroke-width="1.5"'
    )
    if joint.kind == "prismatic":
        side = 0.9 * radius * view.scale
        box = f'<rect x="{x - side / 2:.1f}" y="{y - side / 2:.1f}" width="{side:.1f}" height="{side:.1f}" '
        return f'{mark}{box}fill="#fff" stroke="{colour}" stroke-width="1.5"/>'
    across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    across /= np.linalg.norm(across)
    other = np.cross(axis, across)
    angles = np.linspace(0.0, 2 * np.pi, 25)[:-1]
    ring = [view.flat(centre + radius * (np.cos(t) * across + np.sin(t) * other)) for t in angles]
    path = " ".join(f"{px:.1f},{py:.1f}" for px, py in ring)
    circle = f'<polygon points="{path}" fill="#fff" fill-opacity="0.75" stroke="{colour}" stroke-width="1.5"/>'
    return circle + mark + dot


def _label(label: Label) -> str:
    """Names at the side, and the thin line to their joint."""
    way = 1.0 if label.left else -1.0
    middle = label.top + ROW * (len(label.names) - 1) / 2
    bar, elbow = label.x + 5 * way, label.x + 20 * way
    points = f"{bar:.1f},{middle:.1f} {elbow:.1f},{middle:.1f} {label.at_x:.1f},{label.at_y:.1f}"
    marks = [f'<polyline points="{points}" fill="none" stroke="#9aa1a8" stroke-width="0.7"/>']
    if len(label.names) > 1:
        ends = f'y1="{label.top - 5:.1f}" y2="{label.top + ROW * (len(label.names) - 1) + 5:.1f}"'
        marks.append(f'<line x1="{bar:.1f}" x2="{bar:.1f}" {ends} stroke="#9aa1a8" stroke-width="0.9"/>')
    anchor = "end" if label.left else "start"
    for k, name in enumerate(label.names):
        y = label.top + ROW * k + 4
        marks.append(f'<text x="{label.x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{INK}">{escape(name)}</text>')
    return "".join(marks)
