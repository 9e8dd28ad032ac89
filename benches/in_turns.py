"""Times of calls that take each other's place, and the page that they go to."""

import time
from collections.abc import Callable
from pathlib import Path


def least(turns: int, *calls: Callable[[], object]) -> list[float]:
    """The least time of each, s, in so many turns."""
    times: list[list[float]] = [[] for _ in calls]
    for _ in range(turns):
        for own, call in zip(times, calls, strict=True):
            begin = time.perf_counter()
            call()
            own.append(time.perf_counter() - begin)
    return [min(own) for own in times]


def write(page: Path | None, title: str, how: list[str], lines: list[str], not_shown: str) -> None:
    """Writes a page, if one is asked for: how it was measured, a table, and what that does not show."""
    if page:
        page.write_text("\n".join([f"# {title}", "", *how, "", *lines, "", f"Not shown: {not_shown}", ""]), encoding="utf-8")
