"""Where names beside a figure go: near what they name, in its order, none over another."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from statistics import fmean
from typing import NamedTuple


class Anchor(NamedTuple):
    """Names at a point of the picture."""

    names: tuple[str, ...]
    x: float
    y: float


def spread(wanted: Sequence[float], sizes: Sequence[float], low: float, high: float) -> list[float]:
    """Middles of things of these sizes, near the wanted ones (which ascend), none over another, in low to high if they fit."""
    ends = list(accumulate(sizes, initial=0.0))
    # Where all of them would begin, were each the one that is where it is wanted. Neighbours that meet share their mean.
    blocks: list[list[float]] = []
    for want, size, ahead in zip(wanted, sizes, ends, strict=False):
        blocks.append([want - size / 2 - ahead])
        while len(blocks) > 1 and fmean(blocks[-2]) > fmean(blocks[-1]):
            last = blocks.pop()
            blocks[-1] += last
    begins = [max(low, min(fmean(block), high - ends[-1])) for block in blocks for _ in block]
    return [begin + ahead + size / 2 for begin, ahead, size in zip(begins, ends, sizes, strict=False)]


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
