"""Tables on the terminal, for `phipsi check` and `phipsi bench`."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from . import text
from .emergence import PLAIN, SIGMA, SOBOL, Emergence
from .measure import Accuracy, Growth, Residual, spread


def residuals(console: Console, rows: Sequence[Residual]) -> None:
    """Every identity with its bound, and whether it holds."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("identity", overflow="fold")
    for title in ("median", "worst", "bound"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    for row in rows:
        mark = "[green]pass[/]" if row.passed else "[bold red]FAIL[/]"
        numbers = (f"{value:.1e}" for value in (row.median, row.worst, row.bound))
        table.add_row(row.name.replace("[", r"\["), *numbers, mark)
    console.print(table)


def accuracy(console: Console, title: str, rows: Sequence[Accuracy]) -> None:
    """Time and error of every method."""
    table = Table(box=None, pad_edge=False, header_style="bold", title=title, title_justify="left")
    table.add_column("method")
    table.add_column("precision")
    for name in ("time a state", "median error", "worst error"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(row.method, row.precision, text.time(row.ns), f"{row.median:.1e}", f"{row.worst:.1e}")
    console.print(table)


def growth(console: Console, rows: Sequence[Growth]) -> None:
    """Time a body by number of bodies."""
    title = "Time a body on a chain"
    table = Table(box=None, pad_edge=False, header_style="bold", title=title, title_justify="left")
    for name in ("bodies", "forward dynamics", "inverse dynamics"):
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(text.count(row.bodies), text.time(row.forward), text.time(row.inverse))
    console.print(table)
    forward, inverse = spread([row.forward for row in rows]), spread([row.inverse for row in rows])
    console.print(f"largest over smallest: {forward:.2f} forward, {inverse:.2f} inverse", highlight=False)


def emergence(console: Console, found: Emergence) -> None:
    """M from the random model, in a line."""
    parts = [
        f"{name} samples^{found.slopes[route].measured:.2f}"
        for name, route in (("Monte Carlo", PLAIN), ("Sobol", SOBOL))
        if route in found.slopes
    ]
    parts += [f"sigma points {point.error:.1e}" for point in found.of(SIGMA)]
    parts += [f"{rate.per_second:.1e} samples/s on {text.plural(rate.threads, 'thread')}" for rate in found.rates]
    if parts:
        line = f"M from the random model, error: {', '.join(parts)}"
        console.print(line, highlight=False, markup=False, soft_wrap=True)
