"""Where names beside a figure go: near what they name, in its order, none over another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple


class Anchor(NamedTuple):
    """Names at a point of the picture."""

    names: tuple[str, ...]
    x: float
    y: float


def spread(wanted: Sequence[float], sizes: Sequence[float], low: float, high: float) -> list[float]:
    """Middles of things of these sizes, near the wanted ones (which ascend), none over another, in low to high if they fit."""
    blocks: list[tuple[float, float, int]] = []  # wanted begin, length, members
    for want, size in zip(wanted, sizes, strict=True):
        begin, length, members = want - size / 2, size, 1
        while blocks and blocks[-1][0] + blocks[-1][1] > begin:
            before, ahead, count = blocks.pop()
            # The mean of where each member would have the block begin.
            begin = (before * count + (begin - ahead) * members) / (count + members)
            length, members = length + ahead, members + count
        blocks.append((begin, length, members))
    begins = []
    sizes_left = iter(sizes)
    for begin, _, members in blocks:
        for _ in range(members):
            begins.append(begin)
            begin += next(sizes_left)
    limit = high
    for k in range(len(begins) - 1, -1, -1):
        begins[k] = limit = min(begins[k], limit - sizes[k])
    limit = low
    for k, size in enumerate(sizes):
        begins[k] = max(begins[k], limit)
        limit = begins[k] + size
    return [begin + size / 2 for begin, size in zip(begins, sizes, strict=True)]


def gathered(anchors: Sequence[Anchor], near: float) -> list[Anchor]:
    """Anchors with those that lie closer than `near` made one."""
    groups: list[Anchor] = []
    for anchor in anchors:
        for k, group in enumerate(groups):
            if abs(group.x - anchor.x) + abs(group.y - anchor.y) < near:
                groups[k] = group._replace(names=group.names + anchor.names)
                break
        else:
            groups.append(anchor)
    return groups


def sides(anchors: Sequence[Anchor], middle: float) -> tuple[list[Anchor], list[Anchor]]:
    """Those whose names go left and right of the figure: by where they are, but at most about three in five names on one side."""
    by_x = sorted(anchors, key=lambda anchor: anchor.x)
    names = [len(anchor.names) for anchor in by_x]
    split = sum(anchor.x < middle for anchor in by_x)
    larger = [max(sum(names[:k]), sum(names[k:])) for k in range(len(by_x) + 1)]
    most = max(min(larger), 0.6 * sum(names))
    split = min((k for k, rows in enumerate(larger) if rows <= most), key=lambda k: abs(k - split))
    return by_x[:split], by_x[split:]
