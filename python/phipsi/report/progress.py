"""Progress on a terminal: a bar where there is one, otherwise a line for each part of the work."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

T = TypeVar("T")


class Reporter:
    """Told what is being done; says one short line a part."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def each(self, name: str, pieces: Sequence[T]) -> Iterator[T]:
        """The pieces of a part of the work, one after the other; the next is asked for when one is done."""
        self._console.print(f"{name} ...", highlight=False)
        yield from pieces

    def counter(self, name: str) -> Callable[[int, int], None] | None:
        """What is told how many of how many steps are done; None where nothing would be shown."""
        return None


class Silent(Reporter):
    """Says nothing."""

    def __init__(self) -> None:
        super().__init__(Console(quiet=True))


class Bars(Reporter):
    """A bar a part."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def each(self, name: str, pieces: Sequence[T]) -> Iterator[T]:
        return iter(self._progress.track(pieces, description=name))

    def counter(self, name: str) -> Callable[[int, int], None]:
        task = self._progress.add_task(name)
        return lambda done, steps: self._progress.update(task, completed=done, total=steps)


@contextmanager
def reporter(console: Console) -> Iterator[Reporter]:
    """Bars on a terminal, lines elsewhere."""
    if not console.is_terminal:
        yield Reporter(console)
        return
    columns = (TextColumn("{task.description:<28}"), BarColumn(40), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        yield Bars(progress)
