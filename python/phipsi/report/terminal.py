"""Tables on the terminal for `phipsi check` and `phipsi bench`, and the summary of `phipsi report`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from . import auto_cost, kinds, text
from .auto_cost import Costs
from .robot import FORWARD, Report
from .sections.accuracy import Accuracy
from .sections.calls import CallTime
from .sections.emergence import PLAIN, SIGMA, SOBOL, Emergence
from .sections.growth import TIMED
from .sections.residuals import Residual


#: Space between two columns.
GAP = 2


def line(console: Console, words: str, style: str | None = None) -> None:
    """Print text without markup in one line, independent of the width of the terminal."""
    console.print(words, style=style, highlight=False, markup=False, soft_wrap=True)


def table(console: Console, title: str, heads: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> None:
    """Print a table with a title; the first `words` columns are text, the others numbers. Numbers that the width of the
    console has no room for follow in further tables.
    """
    if title:
        line(console, title, "italic")
    rows = [list(row) for row in rows]
    widths = [max(Text.from_markup(cell).cell_len for cell in (head.replace("[", r"\["), *(row[at] for row in rows))) for at, head in enumerate(heads)]
    parts: list[list[int]] = [[]]
    for at in range(words, len(heads)):
        if parts[-1] and sum(widths[one] + GAP for one in [*range(words), *parts[-1], at]) - GAP > console.width:
            parts.append([])
        parts[-1].append(at)
    for part in parts:
        chosen = [*range(words), *part]
        _part(console, [heads[at] for at in chosen], [[row[at] for at in chosen] for row in rows], words)


def _part(console: Console, heads: Sequence[str], rows: Iterable[Sequence[str]], words: int) -> None:
    """One table."""
    made = Table(box=None, pad_edge=False, header_style="bold")
    for at, head in enumerate(heads):
        number = at >= words
        made.add_column(head.replace("[", r"\["), justify="right" if number else "left", no_wrap=number, overflow="fold")
    for row in rows:
        made.add_row(*row)
    console.print(made)


def residuals(console: Console, rows: Sequence[Residual]) -> None:
    """Print every identity with its residual, its bound, and whether it holds."""
    cells = [
        [row.name.replace("[", r"\["), *(f"{value:.1e}" for value in (row.median, row.worst, row.bound)),
         "[green]pass[/]" if row.passed else "[bold red]FAIL[/]"]
        for row in rows
    ]  # fmt: skip
    table(console, "", ("identity", "median", "worst", "bound", ""), cells)


def accuracy(console: Console, title: str, rows: Sequence[Accuracy]) -> None:
    """Print time and error of every method: `Scene::evaluate` in Rust, one state per call."""
    cells = [
        [row.method, text.time(row.ns_per_state), f"{row.error_median:.1e}", f"{row.error_max:.1e}"] for row in rows
    ]
    table(console, title, ("method", "call in Rust", "median error", "worst error"), cells, 2)


def calls(console: Console, title: str, rows: Sequence[CallTime]) -> None:
    """Print the time of every public call from Python, for one state and in a batch, ns per state."""
    batches = {(row.of.call, row.of.form): row for row in rows if row.of.batch > 1}
    cells = []
    for row in rows:
        if row.of.batch == 1:
            many = batches[row.of.call, row.of.form]
            in_batch = f"{text.time(many.ns_per_state)} of {many.of.batch}"
            cells.append([row.of.call, row.of.form or "", text.time(row.ns_per_state), in_batch])
    table(console, title, ("call from Python", "form", "one state", "in a batch"), cells, 2)


def auto_costs(console: Console, costs: Costs) -> None:
    """Print the time of form "auto" relative to "covariance" by kind of state and robot, batches first, and the
    definitions of the kinds.
    """
    for batch, size in auto_cost.SIZES.items():
        robots, rows = auto_cost.table(costs, batch)
        table(console, f"{auto_cost.TITLE}, {size}", ("state", *robots), rows)
    for kind, meaning in kinds.MEANING.items():
        line(console, f"{kind}: {meaning}", "dim")


def growth(console: Console, found: Mapping[str, Any]) -> None:
    """Print the time per body by number of bodies."""
    title, rows = "Time per body on a chain: Scene::evaluate in Rust, one state per call", found["rows"]
    cells = [[text.count(row.bodies), *(text.time(row.of(kind)) for kind in TIMED)] for row in rows]
    table(console, title, ("bodies", "forward, auto", "forward, covariance", "inverse"), cells, 0)
    spreads = (found[f"{kind}_max_over_min"] for kind in TIMED)
    line(console, "largest over smallest: {:.2f} auto, {:.2f} covariance, {:.2f} inverse".format(*spreads))


def summary(console: Console, found: Report) -> None:
    """Print the time of forward dynamics, the estimates of M from samples, and the missing parts."""
    one, many = (found.call(batch=batch) for batch in (False, True))
    if one is not None and many is not None:
        line(
            console,
            f"{FORWARD} from Python, form auto: {text.time(one.ns_per_state)} for one state, {text.time(many.ns_per_state)} per state in"
            f" batches of {many.of.batch}, on one thread",
        )
    if found.parts["emergence"] is not None:
        _emergence(console, found.parts["emergence"])
    for part, reason in found.missing.items():
        line(console, f"no {part}: {reason}", "yellow")


def _emergence(console: Console, found: Emergence) -> None:
    names = {PLAIN: "Monte Carlo", SOBOL: "Sobol"}
    parts = [f"{names[one.route]} samples^{one.measured:.2f}" for one in found.slopes]
    parts += [f"sigma points {point.error:.1e}" for point in found.along(SIGMA)]
    parts += [f"{rate.per_second:.1e} samples/s on {text.plural(rate.threads, 'thread')}" for rate in found.samples_a_second]
    if parts:
        line(console, f"M from the random model, error: {', '.join(parts)}")
