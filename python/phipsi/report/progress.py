"""Progress on a terminal: a bar where there is one, otherwise a line for each part of the work."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn


class Reporter(Protocol):
    """Told what is being done."""

    def stage(self, name: str, steps: int) -> Callable[[], None]:
        """A part of the work begins; call the result after each of its steps."""
        ...


class Silent:
    """Says nothing."""

    def stage(self, name: str, steps: int) -> Callable[[], None]:
        return lambda: None


class Lines:
    """One short line a part."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def stage(self, name: str, steps: int) -> Callable[[], None]:
        self._console.print(f"{name} ...", highlight=False)
        return lambda: None


class Bars:
    """A bar a part."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def stage(self, name: str, steps: int) -> Callable[[], None]:
        task = self._progress.add_task(name, total=steps)
        return lambda: self._progress.advance(task)


@contextmanager
def reporter(console: Console) -> Iterator[Reporter]:
    """Bars on a terminal, lines elsewhere."""
    if not console.is_terminal:
        yield Lines(console)
        return
    columns = (TextColumn("{task.description:<28}"), BarColumn(40), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        yield Bars(progress)
