"""Kinematic tree of a scene as described, including fixed joints."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from .._core import Scene
from .._results import Joint, Link

#: Name of the parent of a floating base, unless a link has that name.
WORLD = "world"


class Row(NamedTuple):
    """A joint in the printed tree."""

    joint: Joint
    link: Link
    level: int
    """Number of branchings above it; a chain stays on its level."""
    branch: bool
    """Whether it has siblings."""


@dataclass
class Tree:
    """All links and joints of a scene."""

    root: str
    links: dict[str, Link]
    joints: dict[str, Joint]
    """All joints, with a parent (the world if necessary) and an axis (zero if there is none)."""
    children: dict[str, list[Joint]] = field(default_factory=dict)
    floating: bool = False
    """Whether the first joint is the free joint of a floating base."""

    @property
    def mass(self) -> float:
        """Mass of all links, kg."""
        return sum(link.mass for link in self.links.values())

    @property
    def movable(self) -> list[Joint]:
        """Movable joints."""
        return [joint for joint in self.joints.values() if joint.type != "fixed"]

    @property
    def kinds(self) -> dict[str, int]:
        """Number of movable joints by type."""
        return dict(Counter(joint.type for joint in self.movable))

    @cached_property
    def numbers(self) -> dict[str, int]:
        """Numbers of the movable joints, from 1 in the order of `rows`."""
        moving = [row.joint.name for row in self.rows() if row.joint.type != "fixed"]
        # `rows` ends at links with an empty name.
        return {name: number for number, name in enumerate(dict.fromkeys([*moving, *(joint.name for joint in self.movable)]), 1)}

    def carries_motion(self, link: str) -> bool:
        """Whether the link or a link outboard of it carries a movable joint."""
        stack = [link]
        while stack:
            for joint in self.children.get(stack.pop(), []):
                if joint.type != "fixed":
                    return True
                stack.append(joint.child)
        return False

    def rows(self) -> Iterator[Row]:
        """Joints depth first; the level increases at links with several children."""
        stack = self._below(self.root, 0)
        while stack:
            row = stack.pop()
            yield row
            stack += self._below(row.joint.child, row.level)

    def _below(self, link: str, level: int) -> list[Row]:
        children = self.children.get(link, [])
        several = len(children) > 1
        return [Row(joint, self.links[joint.child], level + several, several) for joint in reversed(children)]


def tree_of(scene: Scene) -> Tree:
    """Tree of a scene, as described."""
    links = dict(scene.links)
    root = next(link.name for link in links.values() if link.parent is None)
    world = WORLD
    while world in links:
        world += "_"
    tree = Tree(root, links, {})
    for name, joint in scene.joints.items():
        # The free joint of a floating base has no parent link.
        if joint.parent is None:
            tree.root, tree.floating = world, True
        axis = np.zeros(3) if joint.axis is None else joint.axis
        tree.joints[name] = joint._replace(parent=joint.parent or world, axis=axis)
        tree.children.setdefault(joint.parent or world, []).append(tree.joints[name])
    return tree
