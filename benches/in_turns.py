"""Interleaved timing of calls, and output of the page."""

import time
from collections.abc import Callable
from pathlib import Path


def least(turns: int, *calls: Callable[[], object]) -> list[float]:
    """The shortest time of each, s, over that many interleaved timings."""
    times: list[list[float]] = [[] for _ in calls]
    for _ in range(turns):
        for own, call in zip(times, calls, strict=True):
            begin = time.perf_counter()
            call()
            own.append(time.perf_counter() - begin)
    return [min(own) for own in times]


def write(page: Path | None, title: str, how: list[str], lines: list[str], not_shown: str) -> None:
    """Write a page if one is requested: conditions of the measurement, a table, and its limitations."""
    if page:
        page.write_text("\n".join([f"# {title}", "", *how, "", *lines, "", f"Not shown: {not_shown}", ""]), encoding="utf-8")
