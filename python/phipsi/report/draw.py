"""Stick figure of the robot: links between joints, joint axes, centers of mass."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .._core import Scene
from .._random import ranges
from .plotting import GRAY, INK, SOFT, Part, Space
from .states import Array
from .structure import Tree
from .text import significant

#: Colors of the parts.
MERGED, TURN, SLIDE, FREE, MASS = "#b9bec4", "#0072b2", "#d55e00", "#009e73", "#e69f00"
COLORS = {"fixed": MERGED, "prismatic": SLIDE, "planar": FREE, "spherical": FREE, "floating": FREE}
KINDS = {"axes of revolute joints": TURN, "axes of prismatic joints": SLIDE, "joints with several degrees of freedom": FREE}
#: More numbers than these overlap; they are shown after a click in the legend.
MOST_NUMBERS = 60


class View(NamedTuple):
    """Orthographic view, z up."""

    right: Array
    up: Array
    toward: Array

    @staticmethod
    def of(azimuth: float, elevation: float) -> View:
        """View from a direction given by azimuth and elevation, rad."""
        ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
        return View(np.array([-sa, ca, 0.0]), np.array([-se * ca, -se * sa, ce]), np.array([ce * ca, ce * sa, se]))

    @staticmethod
    def best(cloud: Array) -> View:
        """View in which the points, (n, 3), cover the largest rectangle."""
        size = float(np.ptp(cloud, axis=0).max()) or 1.0
        views = [View.of(azimuth, np.radians(14.0)) for azimuth in np.radians(np.arange(-150.0, 211.0, 15.0) + 7.0)]

        def area(view: View) -> float:
            wide, high = np.ptp(view.flat(cloud), axis=0)
            # Prefers the view from the front, or with x to the right, to the opposite one.
            favor = 1.0 + 0.02 * view.toward[0] + 0.02 * view.right[0]
            return float((wide + 0.2 * size) * (high + 0.2 * size) * favor)

        return max(views, key=area)

    def flat(self, points: Array) -> Array:
        """Coordinates to the right and upward in the picture, (..., 3) to (..., 2)."""
        return points @ np.stack([self.right, self.up], axis=-1)


def pose(scene: Scene, tree: Tree) -> tuple[Array, str]:
    """A configuration that shows the robot, and its description."""
    low, high = ranges(scene)
    step = np.clip(np.zeros(scene.nv), low, high)
    q = scene.integrate(scene.neutral(), step)
    placements = scene.placements(q)
    points = np.array([placements[joint.child][:3, 3] for joint in tree.joints.values() if joint.child in placements])
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) if len(points) else np.zeros(2)
    if len(spread) > 1 and spread[1] < 0.15 * spread[0] and scene.nv > 2:
        bend = np.clip(np.where(np.arange(scene.nv) % 2, 0.6, 0.45), low, high)
        return scene.integrate(scene.neutral(), bend), "bent by about 0.5 rad per joint, because the joints are collinear in the neutral configuration"
    return q, "at the neutral configuration" if not step.any() else "at the neutral configuration, moved within the limits"


def skeleton(scene: Scene, tree: Tree, q: Array) -> Space:
    """The robot at a configuration: links as lines between joints, joint axes, centers of mass."""
    placements = {tree.root: np.eye(4), **scene.placements(q)}
    origins = {name: placement[:3, 3] for name, placement in placements.items()}
    cloud = np.array(list(origins.values()))
    size = float(np.ptp(cloud, axis=0).max()) or 1.0
    parts = [*_links(tree, origins), *_masses(tree, placements), *_joints(tree, placements, 0.04 * size)]
    parts.append(_numbers(tree, origins, 0.02 * size))
    base = [Part("axes of the base", GRAY, np.array([np.zeros(3), 0.15 * size * way]), line=3.0, names=("", letter), shown=False)
            for letter, way in zip("xyz", np.eye(3), strict=True)]  # fmt: skip
    return Space("skeleton", [part for part in (*parts, *base) if len(part.points)], View.best(cloud).toward)


def segments(pairs: Sequence[tuple[Array, Array]]) -> Array:
    """Separate lines as points: (3 n, 3)."""
    gap = np.full(3, np.nan)
    return np.array([point for a, b in pairs for point in (a, b, gap)]).reshape(-1, 3)


def _links(tree: Tree, origins: dict[str, Array]) -> list[Part]:
    """Lines from the origin of the parent to that of the child; merged links in gray."""
    moving: list[tuple[Array, Array]] = []
    merged: list[tuple[Array, Array]] = []
    for joint in tree.joints.values():
        if joint.parent in origins and joint.type != "floating":
            tail = joint.type == "fixed" and not tree.carries_motion(joint.child)
            (merged if tail else moving).append((origins[joint.parent], origins[joint.child]))
    return [Part("links", INK, segments(moving), line=7.0), Part("links on fixed joints", MERGED, segments(merged), line=3.0)]


def _masses(tree: Tree, placements: dict[str, Array]) -> list[Part]:
    """A sphere at each center of mass; its volume is proportional to the mass."""
    links = [tree.links[name] for name in placements if name in tree.links]
    heavy = [link for link in links if link.mass > 0.0 and np.isfinite(link.com).all()]
    places = np.array([placements[link.name][:3, :3] @ link.com + placements[link.name][:3, 3] for link in heavy]).reshape(-1, 3)
    masses = np.array([link.mass for link in heavy])
    sizes = np.maximum(24.0 * np.cbrt(masses / masses.max(initial=1e-300)), 3.0)
    texts = [f"{link.name}\n{significant(link.mass)} kg, center of mass" for link in heavy]
    return [Part("centers of mass", MASS, places, marks=sizes, texts=texts, shade=0.45)]


def _joints(tree: Tree, placements: dict[str, Array], reach: float) -> list[Part]:
    """Joint axes by kind, extended by `reach`, m, to both sides, and a marker with the name."""
    parts = []
    for name, ink in KINDS.items():
        joints = [joint for joint in tree.movable if COLORS.get(joint.type, TURN) == ink]
        centers = np.array([placements[joint.child][:3, 3] for joint in joints]).reshape(-1, 3)
        axes = [
            (center - reach * axis, center + reach * axis)
            for joint, center in zip(joints, centers, strict=True)
            if joint.axis is not None and np.any(axis := placements[joint.child][:3, :3] @ joint.axis)
        ]
        texts = [f"{joint.name}\n{tree.numbers[joint.name]}: {joint.type}\n{joint.parent} → {joint.child}" for joint in joints]
        parts += [Part(name, ink, segments(axes), line=5.0), Part(name, ink, centers, marks=6.0, texts=texts)]
    return parts


def _numbers(tree: Tree, origins: dict[str, Array], near: float) -> Part:
    """Numbers of the joints, because names would overlap; joints closer than `near` share a label."""
    groups: list[tuple[Array, list[int]]] = []
    for joint in sorted(tree.movable, key=lambda joint: tree.numbers[joint.name]):
        at, number = origins[joint.child], tree.numbers[joint.name]
        group = next((numbers for place, numbers in groups if np.linalg.norm(place - at) < near), None)
        if group is None:
            groups.append((at, [number]))
        else:
            group.append(number)
    texts = [_spans(numbers) for _, numbers in groups]
    return Part("numbers of joints", SOFT, np.array([at for at, _ in groups]).reshape(-1, 3), names=texts, shown=len(groups) <= MOST_NUMBERS)


def _spans(numbers: Sequence[int]) -> str:
    """Ascending numbers with ranges, such as 2–4, 9."""
    starts = [number for number in numbers if number - 1 not in numbers]
    ends = [number for number in numbers if number + 1 not in numbers]
    return ", ".join(str(a) if a == b else f"{a}–{b}" for a, b in zip(starts, ends, strict=True))
