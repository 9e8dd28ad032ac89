"""Tables of the page, and sentences that contain results."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from phipsi.report.page import Table
from phipsi.report.text import significant, time
from . import order
from .collect import Point, Result, Study
from .runs import METHODS

#: Method of phipsi, and the same method of the peers.
SAME = (
    ("semi-implicit-euler", ("MuJoCo Euler", "Pinocchio semi-implicit")),
    ("rk4", ("MuJoCo RK4", "Pinocchio rk4")),
)
#: rad or m; errors of the peers are compared above this value, where rounding is negligible.
COMPARED = 1e-10
#: s; the larger of the two steps for which orders on stiff scenes are shown.
COARSE = 1e-3


def error_text(value: float | None) -> str:
    """An error, such as 2e-9."""
    return "–" if value is None or not value > 0.0 else f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e").replace("e+", "e")


def _order_text(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def smooth_orders(study: Study) -> Table:
    """A row per method, a column per smooth scene."""
    names = [name for name in study.methods if any(name in result.points for result in study.smooth)]
    rows = [[name, *(_order_text(result.order(name)) for result in study.smooth)] for name in names]
    return Table(("method", *(result.case.name for result in study.smooth)), rows)


def drift_orders(study: Study) -> Table:
    """Slopes of the drifts: energy on every smooth scene, momentum if it is conserved."""
    tree = study.of("floating tree")
    columns = [(result, "energy") for result in study.smooth] + [(tree, "angular"), (tree, "linear")]
    names = [name for name in study.methods if any(name in result.points for result in study.smooth)]
    rows = [[name, *(_order_text(result.drift_order(name, kind)) for result, kind in columns)] for name in names]
    return Table(("method", *(f"{result.case.name}, {kind}" for result, kind in columns)), rows)


def adaptive_wins(study: Study) -> str:
    """Errors for which DOP853 is faster; empty if there are none."""
    ahead = []
    for result in study.smooth:
        least = [
            row.error for row in result.adaptive
            if row.known and not any(
                (point.error or 0.0) <= row.error and result.alone[method.name] * point.steps <= row.ns
                for method in METHODS for point in result.known(method.name)
            )
        ]  # fmt: skip
        if least:
            ahead.append(f"{result.case.name} (errors of {error_text(max(least))} and below)")
    if not ahead:
        return ""
    return f"No tested fixed step is as accurate and as fast as DOP853, in spite of its loop in Python, on: {', '.join(ahead)}."


def third_order(study: Study) -> str:
    """Cost of rosenbrock-3 on scenes that are not stiff."""
    ratios = []
    for result in study.smooth:
        ours = {point.steps: point.error for point in result.known("rosenbrock-3")}
        ratios += [ours[p.steps] / p.error for p in result.known("rk4") if p.error and ours.get(p.steps)]  # type: ignore[operator]
    if not ratios:
        return ""
    return (
        f"On smooth scenes the error of rosenbrock-3, which has the same number of stages, is {significant(min(ratios), 2)} to {significant(max(ratios), 2)} times"
        " that of rk4 at the same step."
    )


def _at(result: Result, method: str, dt: float) -> Point | None:
    return next((point for point in result.points.get(method, []) if abs(point.dt - dt) < 1e-9), None)


def _stiff_cell(result: Result, method: str, rates: bool) -> str:
    coarse, fine = _at(result, method, COARSE), _at(result, method, 0.5 * COARSE)
    if coarse is None or fine is None:
        return "–"
    fitted = _order_text(result.rate_order(method) if rates else result.order(method))
    if coarse.failure or fine.failure:
        return f"fails / {fitted}"
    pair = [(p.rate_error, p.rate_known) if rates else (p.error, p.known) for p in (coarse, fine)]
    (first, first_known), (second, second_known) = pair
    if first_known and second_known and first and second:
        return f"{_order_text(order.local(first, second))} / {fitted}"
    return f"– / {fitted}"


def stiff_orders(study: Study, *, rates: bool = False) -> Table:
    """Order between 1 ms and 0.5 ms, and over the finest steps; of configurations, or of joint velocities."""
    names = [name for name in study.methods if any(name in result.points for result in study.stiff)]
    rows = [[name, *(_stiff_cell(result, name, rates) for result in study.stiff)] for name in names]
    return Table(("method", *(result.case.name for result in study.stiff)), rows)


def _needed(result: Result, method: str) -> str:
    points = result.points.get(method)
    if points is None:
        return "–"
    failed = [point.dt for point in points if point.failure]
    if not failed:
        return "any"
    sound = [point.dt for point in points if not point.failure and point.dt < min(failed)]
    return f"{max(sound) * 1e6:.3g} µs" if sound else f"below {min(failed) * 1e6:.3g} µs"


def largest_steps(study: Study) -> Table:
    """Largest step such that no run with it or a smaller step fails."""
    names = [name for name in study.methods if any(name in result.points for result in study.stiff)]
    rows = [[name, *(_needed(result, name) for result in study.stiff)] for name in names]
    return Table(("method", *(result.case.name for result in study.stiff)), rows)


def references(study: Study) -> Table:
    """Computation of each reference, and its error relative to the smallest error shown."""
    rows = []
    for result in study.results:
        exact, smallest = result.exact, result.smallest()
        ratio = f"{smallest / exact.error:.0f}"
        rows.append([result.case.name, exact.by, exact.beside, error_text(exact.error), error_text(smallest), ratio])
    return Table(("scene", "reference", "beside it", "difference", "smallest error shown", "times"), rows, 3)


def scenes(study: Study) -> Table:
    """Descriptions of the scenes."""
    rows = []
    for result in study.results:
        case, omega = result.case, result.case.omega
        fastest = error_text(omega)
        rows.append([case.name, case.what, str(case.scene.nv), f"{case.time:g}", fastest])
    return Table(("scene", "what", "degrees of freedom", "time, s", "fastest rate of springs or dampers, 1/s"), rows, 2)


def step_times(study: Study) -> Table:
    """A row per method: time of a step for a single state, and in a batch, on each smooth scene."""
    names = [name for name in study.methods if any(name in result.alone for result in study.smooth)]

    def cell(result: Result, name: str) -> str:
        alone, batch = result.alone.get(name), result.batch.get(name)
        return "–" if alone is None else time(alone) + (f" / {time(batch)}" if batch is not None else "")

    rows = [[name, *(cell(result, name) for result in study.smooth)] for name in names]
    return Table(("method", *(result.case.name for result in study.smooth)), rows)


def _ratios(results: Sequence[Result], ours: Callable[[Result], float | None], theirs: Callable[[Result], float | None]) -> list[float]:
    pairs = [(ours(result), theirs(result)) for result in results]
    return [a / b for a, b in pairs if a is not None and b is not None]


def beside_peers(study: Study) -> list[str]:
    """Sentences: errors at the same step, and time of a step."""
    texts = []
    for mine, others in SAME:
        for other in others:
            if not any(other in result.points for result in study.results):
                continue
            apart = [
                abs(ours.error / theirs.error - 1.0)
                for result in study.smooth
                for ours in result.known(mine)
                for theirs in result.known(other)
                if ours.dt == theirs.dt and ours.error and theirs.error and ours.error >= COMPARED
            ]
            if apart:
                texts.append(
                    f"At the same step the errors of {mine} and of {other} on the smooth scenes, if above"
                    f" {error_text(COMPARED)}, differ by at most {error_text(max(apart))} relative to their magnitude."
                )
    for mine, other in (("semi-implicit-euler", "MuJoCo Euler"), ("rk4", "MuJoCo RK4"), ("implicit-euler", "MuJoCo implicitfast")):
        alone = _ratios(study.smooth, lambda r, m=mine: r.alone.get(m), lambda r, o=other: r.alone.get(o))  # type: ignore[misc]
        batch = _ratios(study.smooth, lambda r, m=mine: r.batch.get(m), lambda r, o=other: r.alone.get(o))  # type: ignore[misc]
        if alone and batch:
            texts.append(
                f"A step of {mine} takes {min(alone):.2g} to {max(alone):.2g} times as long as one of {other} for a single state, and"
                f" {min(batch):.2g} to {max(batch):.2g} times in a batch."
            )
    return texts


def explicit(study: Study) -> str:
    """Sentence on the failures of explicit methods."""
    result = study.of("springs 1e9")
    found = []
    for method in METHODS:
        failed = [point.dt for point in result.points[method.name] if point.failure]
        if failed:
            found.append(f"{method.name} at {min(failed) * 1e6:.3g} µs and more")
    return (
        f"Explicit methods fail for stiff springs unless the step resolves their oscillation: with springs of 1e9 N m/rad {', '.join(found)}. The implicit"
        " methods are stable at every tested step, but do not resolve motion that is faster than the step: an oscillating spring is damped, and the error"
        " is as large as the oscillation until the step resolves it; and the order of the velocities is reduced."
    )


def ringing(study: Study) -> str:
    """Sentence on oscillating springs, with results."""
    result = study.of("struck springs")
    rows = []
    for method in METHODS:
        point = _at(result, method.name, COARSE)
        if point is not None and method.implicit and point.error is not None:
            rows.append(f"{method.name} {error_text(point.error)} rad")
    fine = [f"{m.name} {_order_text(result.order(m.name))}" for m in METHODS]
    return (
        f"At 1 ms the phase of the fastest spring advances by {COARSE * result.case.omega:.1f} rad per step, and the errors are: {', '.join(rows)}; for"
        f" the two Rosenbrock methods this is the oscillation itself, which they damp. Orders over the finest steps:"
        f" {', '.join(fine)}."
    )
