"""Progress on a terminal: a bar, or one line for each part of the work if the output is not a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

T = TypeVar("T")


class Reporter:
    """Receives the progress of the work and shows it as lines or bars."""

    def __init__(self, console: Console, bars: Progress | None = None) -> None:
        self._console, self._bars = console, bars

    def each(self, name: str, pieces: Sequence[T]) -> Iterator[T]:
        """Iterate over the pieces of a part of the work."""
        if self._bars is not None:
            return iter(self._bars.track(pieces, description=name))
        self._console.print(f"{name} ...", highlight=False)
        return iter(pieces)

    def counter(self, name: str) -> Callable[[int, int], None] | None:
        """A callback for the number of completed and total steps; None if nothing would be shown."""
        if self._bars is None:
            return None
        update = partial(self._bars.update, self._bars.add_task(name))
        return lambda done, steps: update(completed=done, total=steps)


class Silent(Reporter):
    """A reporter without output."""

    def __init__(self) -> None:
        super().__init__(Console(quiet=True))


@contextmanager
def reporter(console: Console) -> Iterator[Reporter]:
    """Bars on a terminal, lines otherwise."""
    if not console.is_terminal:
        yield Reporter(console)
        return
    columns = (TextColumn("{task.description:<28}"), BarColumn(40), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        yield Reporter(console, progress)
