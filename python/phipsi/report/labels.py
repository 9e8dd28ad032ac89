"""Where the names beside a figure go: two columns, in the order of what they name, none over another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Anchor:
    """Names at a point of the picture."""

    names: tuple[str, ...]
    x: float
    y: float


@dataclass(frozen=True)
class Label:
    """Names under each other for the point (at_x, at_y); `top` is the middle of the first row."""

    names: tuple[str, ...]
    x: float
    top: float
    left: bool
    at_x: float
    at_y: float


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
                groups[k] = Anchor(group.names + anchor.names, group.x, group.y)
                break
        else:
            groups.append(anchor)
    return groups


def columns(anchors: Sequence[Anchor], width: float, column: float, height: float, row: float) -> list[Label]:
    """Names left and right of a figure as wide as `width` less two columns; about half of them on each side."""
    by_x = sorted(gathered(anchors, 7.0), key=lambda anchor: anchor.x)
    rows = [len(anchor.names) for anchor in by_x]
    total = sum(rows)
    # Not more names on one side than there is room for, and not all on one side.
    most = max(int((height - row) // row), total // 2 + 1)
    split = sum(anchor.x < width / 2 for anchor in by_x)
    while split > 0 and sum(rows[:split]) > min(most, total - total // 3):
        split -= 1
    while split < len(by_x) and sum(rows[split:]) > min(most, total - total // 3) and sum(rows[: split + 1]) <= most:
        split += 1
    return [
        *_column(by_x[:split], column, True, height, row),
        *_column(by_x[split:], width - column, False, height, row),
    ]


def _column(anchors: Sequence[Anchor], x: float, left: bool, height: float, row: float) -> list[Label]:
    ordered = sorted(anchors, key=lambda anchor: round(anchor.y, 1))
    # A little air between groups.
    sizes = [row * len(anchor.names) + 3.0 for anchor in ordered]
    middles = spread([anchor.y for anchor in ordered], sizes, 4.0, height - 4.0)
    return [
        Label(
            tuple(map(shortened, anchor.names)), x, middle - row * (len(anchor.names) - 1) / 2, left, anchor.x, anchor.y
        )
        for anchor, middle in zip(ordered, middles, strict=True)
    ]


def shortened(name: str, most: int = 36) -> str:
    """A name that fits into a column."""
    return name if len(name) <= most else f"{name[: most - 1]}…"
