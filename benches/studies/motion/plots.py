"""Plots of the motion report."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from phipsi.report.plotting import GRAY, Axis, Chart, Panel, Plot, Series, level
from . import horizon
from .collect import ROUNDING, Point, Result, Study
from .reference import FAR
from .runs import METHODS, WRONG


class Look(NamedTuple):
    """Style of the curves of a method."""

    ink: str
    symbol: str = "circle"
    dash: bool = False
    hollow: bool = False
    size: float = 7.0


#: Colors that are distinguishable with color vision deficiency, one hue per integrator.
LOOKS: dict[str, Look] = {
    "semi-implicit-euler": Look("#0072b2"),
    "rk4": Look("#222222"),
    "implicit-euler": Look("#56b4e9", dash=True, size=5.0),
    "rosenbrock-2": Look("#e69f00"),
    "rosenbrock-3": Look("#d55e00"),
    "MuJoCo Euler": Look("#009e73", "square", True, True, 9.0),
    "MuJoCo implicitfast": Look("#117744", "diamond", True, True, 11.0),
    "MuJoCo RK4": Look("#009e73", "triangle-up", True, True, 10.0),
    "Pinocchio semi-implicit": Look("#aa3377", "square", True, True, 13.0),
    "Pinocchio rk4": Look("#aa3377", "triangle-up", True, True, 14.0),
    "DOP853": Look("#8c6bb1", "x", size=8.0),
    "Radau": Look("#8c6bb1", "cross", size=10.0),
}
#: Position of the markers of failed runs, one height per method, and end of the axis.
FAILED, TOP = 4.0, 3e3
#: rad; larger differences of angles are meaningless.
LOST = 3.0

PHIPSI = tuple(method.name for method in METHODS)
UNKNOWN = f"within {FAR:.0f} times the error of the reference"
ERROR, STEP, RUN = "final error, rad or m", "step, s", "run time per simulated second"


def stiff(study: Study) -> list[Plot]:
    """Scenes with springs, and other stiff scenes."""
    springs = [result for result in study.stiff if result.case.name.startswith("springs")]
    others = [result for result in study.stiff if result not in springs]
    return [_stiff(study, "work-precision-springs", springs), _stiff(study, "work-precision-other-stiff", others)]


def smooth(study: Study) -> list[Plot]:
    """A plot per scene."""
    return [_smooth(study, result) for result in study.smooth]


def file_name(result: Result) -> str:
    """Title of the panel of a smooth scene."""
    return f"work-precision-{result.case.name.replace(' ', '-')}"


def _line(name: str, x: Sequence[float], y: Sequence[float | None], note: str = "") -> Series:
    look = LOOKS[name]
    values = [np.nan if value is None else value for value in y]
    line = 2.0 if name in PHIPSI else 1.2
    return Series(name, look.ink, x, values, line, look.size, look.symbol, look.dash, look.hollow, note=note)


def _crosses(name: str, x: Sequence[float], height: float) -> Series:
    """Steps at which the method failed."""
    return Series(name, LOOKS[name].ink, x, [height] * len(x), mark=8.0, symbol="x", note="failed")


def _area(name: str, top: float, x: Axis) -> Series:
    assert x.low is not None and x.high is not None
    return Series(name, GRAY, [x.low, x.high], [top, top], line=1.0, dash=True, below=True, told=False)


def _upright(name: str, at: float, y: Axis, *, dash: bool = False) -> Series:
    assert y.low is not None and y.high is not None
    return Series(name, "#555b61", [at, at], [y.low, y.high], line=1.2, dash=dash, told=False)


def _names(study: Study, results: Sequence[Result]) -> list[str]:
    return [name for name in study.methods if any(name in result.points for result in results)]


def _wide(title: str, values: Iterable[float], by: float = 1.6) -> Axis:
    """A logarithmic axis for the values."""
    known = [value for value in values if value > 0.0 and np.isfinite(value)] or [1.0]
    return Axis.powers(title, min(known) / by, max(known) * by)


def _steps(results: Sequence[Result]) -> Axis:
    return _wide(STEP, [point.dt for result in results for rows in result.points.values() for point in rows])


def _against_step(study: Study, result: Result, x: Axis, y: Axis, title: str) -> Panel:
    series = [_area(UNKNOWN, FAR * result.exact.error, x)]
    for name in _names(study, [result]):
        known = result.known(name)
        series.append(_line(name, [point.dt for point in known], [point.error for point in known]))
    return Panel(x, y, [*series, *_failures(study, result, lambda point: point.dt, x)], title)


def _failures(study: Study, result: Result, at: Callable[[Point], float], x: Axis) -> list[Series]:
    """Failed runs, above the line, a row per method."""
    failing = [name for name in study.methods if any(p.failure for p in result.points.get(name, []))]
    rows = [
        _crosses(name, [at(point) for point in result.points[name] if point.failure], FAILED * 2.4**row)
        for row, name in enumerate(failing)
    ]
    return [level("crosses above: failed", WRONG * 1.6, x), *rows] if rows else []


def _run_times(result: Result, ns: dict[str, float], adaptive: bool) -> list[tuple[str, list[float], list[float | None]]]:
    """Run time per simulated second, s, and error of every method."""
    found: list[tuple[str, list[float], list[float | None]]] = []
    for name in (name for name in result.points if name in ns):
        known = result.known(name)
        found.append((name, [1e-9 * ns[name] * point.steps / result.case.time for point in known], [point.error for point in known]))
    for name in ("DOP853", "Radau") if adaptive else ():
        rows = [row for row in result.adaptive if row.method == name and row.known and row.error < WRONG]
        if rows:
            found.append((name, [1e-9 * row.ns / result.case.time for row in rows], [row.error for row in rows]))
    return found


def _times(found: Iterable[tuple[str, list[float], list[float | None]]]) -> Axis:
    every = [time for _, times, _ in found for time in times]
    return Axis.times(RUN, min(every) / 2.0, max(every) * 2.0)


def _against_time(study: Study, result: Result, ns: dict[str, float], x: Axis, y: Axis, title: str, *, adaptive: bool) -> Panel:
    order = [*study.methods, "DOP853", "Radau"]
    found = sorted(_run_times(result, ns, adaptive), key=lambda row: order.index(row[0]))
    return Panel(x, y, [_area(UNKNOWN, FAR * result.exact.error, x), *(_line(*row) for row in found)], title)


def _errors(results: Sequence[Result]) -> Axis:
    errors = [p.error for r in results for rows in r.points.values() for p in rows if p.known and p.error]
    errors += [row.error for r in results for row in r.adaptive if row.known]
    failed = any(p.failure for r in results for rows in r.points.values() for p in rows)
    low = min(min(errors) / 30.0, min(r.exact.error for r in results) / 2.0)
    return Axis.powers(ERROR, low, TOP if failed else max(errors) * 6.0)


def _smooth(study: Study, result: Result) -> Chart:
    """Error against step, time of one state, and time per state in a batch."""
    batch = result.batch | {name: ns for name, ns in result.alone.items() if name not in result.batch}
    x, y = _times(_run_times(result, result.alone, True) + _run_times(result, batch, False)), _errors([result])
    panels = [
        _against_step(study, result, _steps([result]), y, "against step"),
        _against_time(study, result, result.alone, x, y, "against time, one state", adaptive=True),
        _against_time(study, result, batch, x, y, "against time per state, batch of 64", adaptive=False),
    ]
    return Chart(file_name(result), panels, 3, 320)


def _stiff(study: Study, name: str, results: Sequence[Result]) -> Chart:
    """One row per scene: error against step left, against time of one state right."""
    y, panels = _errors(results), []
    x = _times([row for result in results for row in _run_times(result, result.alone, True)])
    for result in results:
        panels.append(_against_step(study, result, _steps(results), y, result.case.name))
        panels.append(_against_time(study, result, result.alone, x, y, result.case.name, adaptive=True))
    return Chart(name, panels, 2)


def horizon_plot(study: Study) -> Chart:
    """Growth and references left, errors of the methods right."""
    seen = study.horizon
    end = study.results[0].case.time
    x = Axis("time, s", 0.0, float(seen.t[-1]))
    y = [Axis.powers(title, 1e-16, 100.0) for title in ("difference, rad", "error, rad")]
    left = [
        Series(f"perturbation of the initial state by {horizon.MOVED:.0e}", "#009e73", seen.t, seen.growth * horizon.MOVED, 1.6, 5.0),
        Series("difference of two references", "#aa3377", seen.t, seen.difference, 1.6, 5.0),
    ]
    right = [Series(UNKNOWN, GRAY, seen.t, FAR * seen.difference, 1.0, dash=True, below=True, told=False)]
    for name in PHIPSI:
        lost = np.logical_or.accumulate(~(seen.errors[name] <= LOST))
        errors = np.where(lost | (seen.errors[name] < FAR * seen.difference), np.nan, seen.errors[name])
        right.append(Series(name, LOOKS[name].ink, seen.t, errors, 1.6, 5.0, dash=LOOKS[name].dash))
    titles = ("growth of a small difference", f"error of the methods, h = 1/{horizon.SHOWN} s")
    panels = []
    for series, axis, title in zip((left, right), y, titles, strict=True):
        ends = [_upright("end of the diagrams below", end, axis), _upright("horizon", seen.end, axis, dash=True)]
        panels.append(Panel(x, axis, [*series, *ends], title))
    return Chart("horizon", panels, 2, 320)


def stiffness(study: Study) -> Chart:
    """Error above and order below, against h omega: configurations and velocities on the slow manifold, configurations
    of oscillating springs.
    """
    columns = (
        ("on the slow manifold", False, "errors", "order", "error after 0.1 s, h = 1 ms, rad"),
        ("error of the velocities", False, "rate_errors", "rate_order", "error of rates, rad/s"),
        ("off the slow manifold: oscillating spring", True, "errors", "order", "error, rad"),
    )
    x = _wide("h ω for h = 1 ms", [row.turned for row in study.springs])
    known = [error for row in study.springs for _, _, errors, _, _ in columns for error in getattr(row, errors) if error]
    return Chart("stiffness", [
        panel for title, rings, errors, order, unit in columns
        for panel in (_spring_errors(study, x, rings, errors, title, Axis.powers(unit, min(known) / 3.0, 300.0)), _spring_orders(study, x, rings, order, title))
    ], 2, 260)  # fmt: skip


def _spring_errors(study: Study, x: Axis, rings: bool, errors: str, title: str, y: Axis) -> Panel:
    series = [_upright("h ω = 1", 1.0, y, dash=True)]
    for row, name in enumerate(PHIPSI):
        rows = [one for one in study.springs if one.method == name and one.ringing == rings]
        series.append(_line(name, [one.turned for one in rows], [getattr(one, errors)[0] for one in rows]))
        failed = [one.turned for one in rows if one.failed]
        if failed:
            series.append(_crosses(name, failed, 150.0 * 0.3**row))
    return Panel(x, y, series, title)


def _spring_orders(study: Study, x: Axis, rings: bool, order: str, title: str) -> Panel:
    low, high = -1, 5
    y = Axis("order between 1 ms and 0.5 ms", low - 0.1, high + 0.1, [(float(value), str(value)) for value in range(low, high + 1)], form=".2f")
    series = [_upright("h ω = 1", 1.0, y, dash=True)]
    for name in PHIPSI:
        rows = [one for one in study.springs if one.method == name and one.ringing == rings]
        # An order beyond the axis means that a run was close to failure, or that its error changed its sign.
        orders = [getattr(one, order) for one in rows]
        shown = [None if value is None or not low <= value <= high else value for value in orders]
        series.append(_line(name, [one.turned for one in rows], shown))
    return Panel(x, y, series, f"{title}: order")


def drift(study: Study) -> Chart:
    """Energy of four scenes, angular and linear momentum of the floating tree, against step."""
    wanted: list[tuple[Result, str, str]] = [(result, "energy", "energy") for result in study.smooth]
    tree = study.of("floating tree")
    wanted += [(tree, "angular", "angular momentum"), (tree, "linear", "linear momentum")]
    panels = []
    for result, kind, title in wanted:
        x = _steps([result])
        curves = []
        for name in _names(study, [result]):
            rows = [(point.dt, getattr(point.drift, kind)) for point in result.points[name] if not point.failure]
            curves.append(_line(name, [h for h, _ in rows], [value if value else None for _, value in rows]))
        known = [value for curve in curves for value in curve.y if value and np.isfinite(value)]
        y = Axis.powers("largest relative drift", max(min([*known, ROUNDING]) / 3.0, 1e-16), max([*known, ROUNDING]) * 3.0)
        panels.append(Panel(x, y, [_area("affected by rounding", ROUNDING, x), *curves], f"{result.case.name}: {title}"))
    return Chart("drift", panels, 2, 280)
