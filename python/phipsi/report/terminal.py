"""Tables on the terminal, for `phipsi check` and `phipsi bench`."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from . import auto_cost, kinds, text
from .auto_cost import Costs
from .calls import CallTime
from .collect import Report
from .emergence import PLAIN, SIGMA, SOBOL, Emergence
from .left_out import FORWARD
from .measure import Accuracy, Growth, Residual, spread


def _titled(console: Console, title: str, table: Table) -> None:
    """The table under its title, which stays in one line however narrow the table is."""
    console.print(title, style="italic", highlight=False, markup=False, soft_wrap=True)
    console.print(table)


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
    """Time and error of every method: `Scene::evaluate` in Rust, one state a call."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("method")
    table.add_column("precision")
    for name in ("call in Rust", "median error", "worst error"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(row.method, row.precision, text.time(row.ns), f"{row.median:.1e}", f"{row.worst:.1e}")
    _titled(console, title, table)


def calls(console: Console, title: str, rows: Sequence[CallTime]) -> None:
    """What every public call takes from Python, one state and a batch, ns a state."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("call from Python", overflow="fold")
    table.add_column("form")
    table.add_column("one state", justify="right", no_wrap=True)
    table.add_column("in a batch", justify="right", no_wrap=True)
    batches = {(row.call, row.form): row for row in rows if row.batch > 1}
    for row in rows:
        if row.batch == 1:
            many = batches[row.call, row.form]
            table.add_row(row.call, row.form or "", text.time(row.ns), f"{text.time(many.ns)} of {many.batch}")
    _titled(console, title, table)


def forward(console: Console, found: Report) -> None:
    """What forward dynamics takes, in a line."""
    one, many = (found.call(FORWARD, "auto", batch=batch) for batch in (False, True))
    if one is not None and many is not None:
        line = (
            f"{FORWARD} from Python, form auto: {text.time(one.ns)} for one state, {text.time(many.ns)} a state in batches of"
            f" {many.batch}, on one thread"
        )
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def auto_costs(console: Console, costs: Costs) -> None:
    """Form auto over covariance by kind of state and robot, batches first; and what the kinds are."""
    for batch, size in auto_cost.SIZES.items():
        robots, rows = auto_cost.table(costs, batch)
        table = Table(box=None, pad_edge=False, header_style="bold")
        table.add_column("state", no_wrap=True)
        for robot in robots:
            table.add_column(robot.replace("[", r"\["), justify="right", no_wrap=True)
        for row in rows:
            table.add_row(*row)
        _titled(console, f"{auto_cost.TITLE}, {size}", table)
    for kind, meaning in kinds.MEANING.items():
        console.print(f"{kind}: {meaning}", highlight=False, markup=False, soft_wrap=True, style="dim")


def growth(console: Console, rows: Sequence[Growth]) -> None:
    """Time a body by number of bodies."""
    title = "Time a body on a chain: Scene::evaluate in Rust, one state a call"
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("bodies", "forward, auto", "forward, covariance", "inverse"):
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(text.count(row.bodies), text.time(row.forward), text.time(row.covariance), text.time(row.inverse))
    _titled(console, title, table)
    spreads = [spread([getattr(row, kind) for row in rows]) for kind in ("forward", "covariance", "inverse")]
    line = "largest over smallest: {:.2f} auto, {:.2f} covariance, {:.2f} inverse".format(*spreads)
    console.print(line, highlight=False)


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
