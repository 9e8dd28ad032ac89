"""The tree of a scene, links and joints with what the drawing needs, from the scene's own description."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .._core import Scene

Array = NDArray[np.float64]

#: Above the root link of a floating base, unless a link has that name.
WORLD = "world"


@dataclass(frozen=True)
class Link:
    """A link as the user gave it."""

    name: str
    mass: float
    """kg; 0 without inertia."""
    centre: Array
    """Mass centre in the link's frame, (3,), m."""


@dataclass(frozen=True)
class Joint:
    """A joint as the user gave it; fixed ones too, which the scene has merged."""

    name: str
    kind: str
    parent: str
    child: str
    axis: Array
    """(3,), in the child's frame."""
    armature: float
    mimic: str | None

    @property
    def fixed(self) -> bool:
        return self.kind == "fixed"


@dataclass
class Row:
    """A joint in the printed tree."""

    joint: Joint
    link: Link
    level: int
    """Branchings above it: a chain stays on its level."""
    branch: bool
    """Whether it has siblings."""


@dataclass
class Tree:
    """All links and joints of a scene."""

    root: str
    links: dict[str, Link]
    joints: dict[str, Joint]
    children: dict[str, list[Joint]] = field(default_factory=dict)
    floating: bool = False
    """Whether the first joint is the free one of a floating base."""

    @property
    def mass(self) -> float:
        """Mass of all links, kg."""
        return sum(link.mass for link in self.links.values())

    def carries_motion(self, link: str) -> bool:
        """Whether a joint that moves is on the link or beyond it."""
        stack = [link]
        while stack:
            for joint in self.children.get(stack.pop(), []):
                if not joint.fixed:
                    return True
                stack.append(joint.child)
        return False

    def kinds(self) -> dict[str, int]:
        """How many movable joints there are of each kind."""
        counts: dict[str, int] = {}
        for joint in self.joints.values():
            if not joint.fixed:
                counts[joint.kind] = counts.get(joint.kind, 0) + 1
        return counts

    def rows(self) -> Iterator[Row]:
        """Joints depth first; the level goes up where a link has several children."""
        first = self.children.get(self.root, [])
        several = len(first) > 1
        stack = [(joint, int(several), several) for joint in reversed(first)]
        while stack:
            joint, level, branch = stack.pop()
            yield Row(joint, self.links[joint.child], level, branch)
            children = self.children.get(joint.child, [])
            several = len(children) > 1
            stack.extend((child, level + several, several) for child in reversed(children))


def tree_of(scene: Scene) -> Tree:
    """The tree of a scene, as it was described."""
    tree = Tree("", {}, {})
    for link in scene.links.values():
        tree.links[link.name] = Link(link.name, link.mass, link.com)
        if link.joint is None:
            tree.root = link.name
    world = WORLD
    while world in tree.links:
        world += "_"
    for name, joint in scene.joints.items():
        axis = np.zeros(3) if joint.axis is None else joint.axis
        mimic = None if joint.mimic is None else joint.mimic.joint
        # A floating base's free joint has no parent link.
        if joint.parent is None:
            tree.root, tree.floating = world, True
        parent = world if joint.parent is None else joint.parent
        tree.joints[name] = Joint(name, joint.type, parent, joint.child, axis, joint.armature, mimic)
    for described in tree.joints.values():
        tree.children.setdefault(described.parent, []).append(described)
    return tree
