"""The plots of the motion report."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from phipsi.report.plotting import DASHES, GREY, Plot, log_log, panels, power_ticks, styled, time_axis
from . import horizon
from .collect import ROUNDING, Adaptive, Point, Result, Study
from .reference import FAR
from .runs import METHODS, WRONG

#: Colour, marker, line, filled, size; colours apart for all kinds of colour vision, a hue an integrator whoever runs it.
EULER, RK4, IMPLICIT, SECOND, THIRD = "#0072b2", "#222222", "#56b4e9", "#e69f00", "#d55e00"
Look = tuple[str, str, object, bool, float]
LOOKS: dict[str, Look] = {
    "semi-implicit-euler": (EULER, "o", "-", True, 4.2),
    "rk4": (RK4, "o", "-", True, 4.2),
    "implicit-euler": (IMPLICIT, "o", (0, (3, 2)), True, 3.2),
    "rosenbrock-2": (SECOND, "o", "-", True, 4.2),
    "rosenbrock-3": (THIRD, "o", "-", True, 4.2),
    "MuJoCo Euler": ("#009e73", "s", (0, (1, 2)), False, 6.0),
    "MuJoCo implicitfast": ("#117744", "D", (0, (1, 2)), False, 8.0),
    "MuJoCo RK4": ("#009e73", "^", (0, (1, 2)), False, 6.5),
    "Pinocchio semi-implicit": ("#aa3377", "s", (0, (1, 2)), False, 9.5),
    "Pinocchio rk4": ("#aa3377", "^", (0, (1, 2)), False, 10.0),
    "DOP853": ("#8c6bb1", "x", "-", True, 5.0),
    "Radau": ("#8c6bb1", "+", "-", True, 6.5),
}
UNKNOWN = "#c9ced3"
#: Where failed runs are marked, one height a method, and the axis' end.
FAILED, TOP = 4.0, 3e3

#: rad: beyond it two angles have nothing to do with each other.
LOST = 3.0

PHIPSI = tuple(method.name for method in METHODS)


def stiff(study: Study) -> list[Plot]:
    """The springs, and the other stiff scenes."""
    springs = [result for result in study.stiff if result.case.name.startswith("springs")]
    others = [result for result in study.stiff if result not in springs]
    return [_stiff(study, "work-precision-springs", springs), _stiff(study, "work-precision-other-stiff", others)]


def smooth(study: Study) -> list[Plot]:
    """A plot a scene."""
    return [_smooth(study, result) for result in study.smooth]


def file_name(result: Result) -> str:
    """Of the diagram of a smooth scene."""
    return f"work-precision-{result.case.name.replace(' ', '-')}"


def _line(axes: Axes, name: str, x: Sequence[float], y: Sequence[float | None]) -> None:
    ink, marker, dashes, filled, size = LOOKS[name]
    values = [np.nan if value is None else value for value in y]
    axes.plot(
        x, values, color=ink, marker=marker, ls=dashes, ms=size, mfc=ink if filled else "none", mew=1.0,
        lw=1.5 if name in PHIPSI else 0.9, zorder=4 if name in PHIPSI else 3,
    )  # fmt: skip


def _legend(figure: Figure, names: Iterable[str], height: float, *extra: Line2D) -> None:
    handles = []
    for name in names:
        ink, marker, dashes, filled, size = LOOKS[name]
        mfc = ink if filled else "none"
        handles.append(Line2D([], [], color=ink, marker=marker, ls=dashes, ms=min(size, 7.0), mfc=mfc, lw=1.2, label=name))
    handles += extra
    columns = min(len(handles), 6)
    figure.legend(
        handles=handles, loc="lower center", ncols=columns, frameon=False, fontsize=8, bbox_to_anchor=(0.5, height),
        columnspacing=1.5, handlelength=2.6,
    )  # fmt: skip


def _unknown() -> Line2D:
    return Line2D([], [], color=UNKNOWN, lw=7, alpha=0.55, label=f"within {FAR:.0f} times the reference's own error")


def _failure() -> Line2D:
    return Line2D([], [], color="#555b61", marker="x", ls="", ms=5, label="failed, in the colour of the method")


def _floor(axes: Axes, result: Result) -> None:
    axes.axhspan(1e-30, FAR * result.exact.error, color=UNKNOWN, alpha=0.55, lw=0, zorder=0)
    axes.axhline(result.exact.error, color=GREY, lw=0.9, ls=DASHES, zorder=1)


def _names(study: Study, results: Sequence[Result]) -> list[str]:
    return [name for name in study.methods if any(name in result.points for result in results)]


def _against_step(axes: Axes, study: Study, result: Result) -> None:
    for name in _names(study, [result]):
        known = result.known(name)
        _line(axes, name, [point.dt for point in known], [point.error for point in known])
    _failures(axes, study, result, lambda name, point: point.dt)
    _floor(axes, result)
    power_ticks(axes.xaxis, 6)


def _failures(axes: Axes, study: Study, result: Result, x: Callable[[str, Point], float]) -> None:
    """Runs that failed, above the line, a row a method."""
    failing = [name for name in study.methods if any(p.failure for p in result.points.get(name, []))]
    for row, name in enumerate(failing):
        failed = [point for point in result.points[name] if point.failure]
        axes.plot([x(name, p) for p in failed], [FAILED * 2.4**row] * len(failed), "x", ms=4, color=LOOKS[name][0], mew=1.1)
    if failing:
        axes.axhline(WRONG * 1.6, color=GREY, lw=0.7)


def _against_time(axes: Axes, study: Study, result: Result, ns: dict[str, float], *, adaptive: bool) -> list[float]:
    """Error against run time of a simulated second; gives the times, ns."""
    seen = []
    for name in _names(study, [result]):
        if name not in ns:
            continue
        known = result.known(name)
        x = [ns[name] * point.steps / result.case.time for point in known]
        _line(axes, name, x, [point.error for point in known])
        seen += x
    for name in ("DOP853", "Radau") if adaptive else ():
        rows: list[Adaptive] = [row for row in result.adaptive if row.method == name and row.known and row.error < WRONG]
        _line(axes, name, [row.ns / result.case.time for row in rows], [row.error for row in rows])
        seen += [row.ns / result.case.time for row in rows]
    _floor(axes, result)
    return seen


def _limits(every: Sequence[Axes], results: Sequence[Result]) -> None:
    errors = [p.error for r in results for rows in r.points.values() for p in rows if p.known and p.error is not None]
    errors += [row.error for r in results for row in r.adaptive if row.known]
    failed = any(p.failure for r in results for rows in r.points.values() for p in rows)
    low = min(min(errors) / 30.0, min(r.exact.error for r in results) / 2.0)
    for axes in every:
        axes.set_ylim(low, TOP if failed else max(errors) * 6.0)
        power_ticks(axes.yaxis, 9)


ERROR = "error at the end, rad or m"
STEP = "step, s"
RUN = "run time of a simulated second"


@styled
def _smooth(study: Study, result: Result) -> tuple[str, Figure]:
    """Against step, against time of one state, against time of a state in a batch."""
    figure, (every,) = panels((10.6, 4.3), 1, 3, margins=(0.065, 0.985, 0.92, 0.255), sharey=True, wspace=0.08)
    log_log(every[0], "against step", ERROR, STEP)
    _against_step(every[0], study, result)
    log_log(every[1], "against time, one state alone", "", RUN)
    first = _against_time(every[1], study, result, result.alone, adaptive=True)
    log_log(every[2], "against time, a state of a batch of 64", "", RUN)
    batch = result.batch | {name: ns for name, ns in result.alone.items() if name not in result.batch}
    second = _against_time(every[2], study, result, batch, adaptive=False)
    for axes in every[1:]:
        time_axis(axes, min(first + second) / 2, max(first + second) * 2)
    _limits(every, [result])
    shown = [*_names(study, [result]), *dict.fromkeys(row.method for row in result.adaptive)]
    _legend(figure, shown, 0.0, _unknown())
    return file_name(result), figure


@styled
def _stiff(study: Study, name: str, results: Sequence[Result]) -> tuple[str, Figure]:
    """A column a scene: against step above, against time of one state below."""
    figure, every = panels((11.4, 7.4), 2, len(results), margins=(0.06, 0.98, 0.95, 0.155), sharey=True, wspace=0.09, hspace=0.25)
    times: list[float] = []
    for column, result in enumerate(results):
        upper, lower = every[:, column]
        left = column == 0
        log_log(upper, result.case.name, ERROR if left else "", STEP)
        _against_step(upper, study, result)
        log_log(lower, "", ERROR if left else "", RUN)
        times += _against_time(lower, study, result, result.alone, adaptive=True)
    for axes in every[1]:
        time_axis(axes, min(times) / 3, max(times) * 3)
    _limits(list(every.flat), results)
    shown = [*_names(study, results), *dict.fromkeys(row.method for r in results for row in r.adaptive)]
    _legend(figure, shown, 0.0, _unknown(), _failure())
    return name, figure


@styled
def horizon_plot(study: Study) -> tuple[str, Figure]:
    """Growth and references left, the methods' errors right."""
    seen = study.horizon
    case = study.results[0].case
    figure, ((left, right),) = panels((10.6, 4.2), 1, 2, margins=(0.065, 0.985, 0.92, 0.22), wspace=0.17)
    moved = seen.growth * horizon.MOVED
    left.plot(seen.t, moved, color="#009e73", lw=1.4, marker="o", ms=2.5)
    left.plot(seen.t, seen.difference, color="#aa3377", lw=1.4, marker="o", ms=2.5)
    left.text(0.98, 0.06, "difference of two references", color="#aa3377", transform=left.transAxes, ha="right")
    left.text(0.98, 0.12, f"a change of {horizon.MOVED:.0e} in the start", color="#009e73", transform=left.transAxes, ha="right")
    for name in PHIPSI:
        lost = np.logical_or.accumulate(~(seen.errors[name] <= LOST))
        errors = np.where(lost | (seen.errors[name] < FAR * seen.difference), np.nan, seen.errors[name])
        ink, _, dashes, _, _ = LOOKS[name]
        right.plot(seen.t, errors, color=ink, ls=dashes, lw=1.4, marker="o", ms=2.5)  # type: ignore[arg-type,unused-ignore]
    right.fill_between(seen.t, 1e-30, FAR * seen.difference, color=UNKNOWN, alpha=0.55, lw=0)
    for axes, title, label in (
        (left, "what becomes of a small difference", "rad"),
        (right, f"error of the methods, h = 1/{horizon.SHOWN} s", "error, rad"),
    ):
        log_log(axes, title, label, "time, s")
        axes.set_xscale("linear")
        axes.axvline(case.time, color="#555b61", lw=1.0)
        axes.axvline(seen.end, color="#555b61", lw=1.0, ls=DASHES)
        axes.set_ylim(1e-16, 100.0)
        axes.set_xlim(0.0, seen.t[-1])
        power_ticks(axes.yaxis, 9)
    lines = [
        Line2D([], [], color="#555b61", lw=1.0, label="end of the diagrams below"),
        Line2D([], [], color="#555b61", lw=1.0, ls=DASHES, label="horizon"),
    ]
    _legend(figure, PHIPSI, 0.0, *lines, _unknown())
    return "horizon", figure


@styled
def stiffness(study: Study) -> tuple[str, Figure]:
    """Error above and order below, against h omega: configurations and rates on the slow manifold, configurations of what rings."""
    low, high = -1, 5
    columns = (
        ("on the slow manifold", False, "errors", "order", "error after 0.1 s, h = 1 ms, rad"),
        ("the same, error of the rates", False, "rate_errors", "rate_order", "rad/s"),
        ("off the slow manifold: the spring rings", True, "errors", "order", "rad"),
    )
    figure, every = panels((11.4, 6.4), 2, 3, margins=(0.06, 0.99, 0.95, 0.14), sharex=True, sharey="row", wspace=0.12, hspace=0.14)
    for column, (title, rings, errors, order, unit) in enumerate(columns):
        upper, lower = every[:, column]
        log_log(upper, title, unit, "")
        log_log(lower, "", "order between 1 ms and 0.5 ms" if column == 0 else "", "h ω for h = 1 ms")
        lower.set_yscale("linear")
        for name in PHIPSI:
            rows = [row for row in study.springs if row.method == name and row.ringing == rings]
            x = [row.turned for row in rows]
            _line(upper, name, x, [getattr(row, errors)[0] for row in rows])
            # Beyond the axis an order says that a run was about to fail, or that its error was changing its sign.
            orders = [getattr(row, order) for row in rows]
            _line(lower, name, x, [None if value is None or not low <= value <= high else value for value in orders])
            failed = [row.turned for row in rows if row.failed]
            place = 0.96 - 0.045 * PHIPSI.index(name)
            upper.plot(failed, [place] * len(failed), "x", ms=4.5, color=LOOKS[name][0], transform=upper.get_xaxis_transform())
        for axes in (upper, lower):
            axes.axvline(1.0, color=GREY, lw=0.8, ls=DASHES)
            power_ticks(axes.xaxis, 8)
        lower.set_ylim(low - 0.1, high + 0.1)
        lower.set_yticks(range(low, high + 1))
    power_ticks(every[0, 0].yaxis, 9)
    every[0, 0].set_ylim(top=300.0)
    _legend(figure, PHIPSI, 0.0, Line2D([], [], color="#555b61", marker="x", ls="", ms=5, label="failed, at 1 or 0.5 ms"))
    figure.align_ylabels(every[:, 0])
    return "stiffness", figure


@styled
def drift(study: Study) -> tuple[str, Figure]:
    """Energy of four scenes, angular and linear momentum of the floating tree, against step."""
    figure, every = panels((10.6, 7.0), 2, 3, margins=(0.065, 0.985, 0.95, 0.15), wspace=0.2, hspace=0.3)
    wanted: list[tuple[Result, str, str]] = [(result, "energy", "energy") for result in study.smooth]
    tree = study.of("floating tree")
    wanted += [(tree, "angular", "angular momentum"), (tree, "linear", "linear momentum")]
    for axes, (result, kind, title) in zip(every.flat, wanted, strict=True):
        log_log(axes, f"{result.case.name}: {title}", "largest relative drift", STEP)
        for name in _names(study, [result]):
            rows = [(point.dt, getattr(point.drift, kind)) for point in result.points[name] if not point.failure]
            _line(axes, name, [h for h, _ in rows], [value if value else None for _, value in rows])
        power_ticks(axes.xaxis, 6)
        power_ticks(axes.yaxis, 8)
        axes.axhspan(1e-30, ROUNDING, color=UNKNOWN, alpha=0.55, lw=0, zorder=0)
        axes.set_ylim(bottom=max(axes.get_ylim()[0], 1e-16))
    for axes in (*every[0, 1:], *every[1, 1:]):
        axes.set_ylabel("")
    near = Line2D([], [], color=UNKNOWN, lw=7, alpha=0.55, label="rounding has a part in it")
    _legend(figure, _names(study, study.smooth), 0.0, near)
    return "drift", figure
