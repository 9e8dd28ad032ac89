"""Tables and texts of the stability report."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ... import scenes
from ..page import Block, Code, Figure, Heading, Table, flowed
from ..text import plural, time
from .loops import DENSE
from .measure import COVARIANCE, DERIVED_FORMS, ROOT, TIMED, Derived, Error, Point, Recursion, Stability
from .plots import SWEEPS

RUN_TIME = """\
One point per method. A method without a point failed. Times are for one state on one thread, calls of Scene::evaluate in Rust (dense methods: with faer).
"""
AIM = """\
The accuracy target is an error of at most 1e-13 in the max-norm (largest error relative to the largest acceleration), and of at most 1e-12
per component (each error relative to the acceleration itself), or 20 times the sensitivity of the problem if that is larger. It is missed in these cases:
"""
SWEPT = """\
The gray area is below the sensitivity of the problem: the change of the exact result if the values that define the problem change by
one unit in the last place.
"""
RECURSIONS = "For each case, the value with the largest error of a component relative to its sensitivity, if the error exceeds 1e-13:"
DERIVATIVES = "For each case, the value with the largest error of the covariance form; errors in the max-norm:"
LOOPS = """\
Accelerations of six bars in a plane, hinged to each other and at both ends to the ground: a tree of six joints, closed by a hinge.
The mass of some bars is the ratio times that of the others. The reference is the exact solution of the equations of motion in fractions.
Errors are in the max-norm, the maximum over the states.
"""
CASES = """\
Each value is the maximum over the states. auto is the default form. The columns state and parameters are sensitivities; – means that a method failed or was not
compared in all states, for the reason above.
"""


def number(value: float) -> str:
    """A parameter value, such as 1e12 or 0.1."""
    if value == 0.0 or 1e-2 <= value < 1e4:
        return f"{value:g}"
    exponent = math.floor(math.log10(value) + 1e-9)
    return f"{value / 10.0**exponent:g}e{exponent}"


def error(value: float) -> str:
    """An error, such as 2e-9."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    return f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e+")


def beyond(found: Stability) -> list[Block]:
    """Cases in which the square-root form misses its target, in either norm: number of states and largest error."""
    grouped: dict[tuple[str, float, str], list[tuple[float, float]]] = {}
    for point in found.points:
        own, aim = point.errors[ROOT], point.aim
        for norm, ours, allowed in (("max-norm", own.norm, aim.norm), ("components", own.component, aim.component)):
            if not ours <= allowed:
                grouped.setdefault((point.name, point.value, norm), []).append((ours, allowed))
    rows = []
    for (name, value, norm), group in grouped.items():
        states = sum((point.name, point.value) == (name, value) for point in found.points)
        worst = max(group, key=lambda pair: pair[0] / pair[1])
        rows.append([name, number(value), norm, f"{len(group)} of {states}", *map(error, worst)])
    return [flowed(AIM), Table(("case", "value", "norm", "states", "worst error", "target"), rows, 3)]


def pictures(found: Stability) -> list[Block]:
    """Plots."""
    states = f"Each point is the maximum over {len(found.seeds)} states; the gray area is below the sensitivity."
    sweeps = [Figure(name, f"{caption} {states}") for name, (_, _, caption) in SWEEPS.items()]
    return [flowed(SWEPT), *sweeps, Figure("error-against-run-time", flowed(RUN_TIME))]


def timed(found: Stability) -> list[Block]:
    """Times of the forms."""
    rows, ratios = [], []
    for name, value in TIMED:
        chosen = found.timed(name, value)
        base = next(row.ns for row in chosen if row.method == COVARIANCE)
        for row in chosen:
            if row.method == ROOT:
                ratios.append(row.ns / base)
            rows.append([f"{name}, {number(value)}", row.method, time(row.ns), f"{row.ns / base:.2f}", error(row.norm)])
    words = f"The square-root form takes {min(ratios):.1f} to {max(ratios):.1f} times as long as the covariance form."
    return [words, Table(("case", "method", "time", "relative to covariance", "max-norm error"), rows, 3)]


def recursions(found: Stability) -> list[Block]:
    """For each case and quantity, the value with the largest error of a component relative to its sensitivity."""

    def above(row: Recursion) -> float:
        ratio = row.component / max(row.sensitivity.component, 1e-15)
        return ratio if math.isfinite(ratio) else 0.0

    worst: dict[tuple[str, str], Recursion] = {}
    for row in found.parts["recursions"]:
        key = (row.quantity, row.case)
        if (row.component > 1e-13 or row.norm > 1e-14) and (key not in worst or above(row) > above(worst[key])):
            worst[key] = row
    rows = [
        [row.quantity, row.case, number(row.value), *map(error, (row.norm, row.sensitivity.norm, row.component, row.sensitivity.component))]
        for row in sorted(worst.values(), key=lambda row: row.quantity)
    ]
    return [RECURSIONS, Table(("quantity", "case", "value", "max-norm", "sensitivity", "components", "sensitivity"), rows, 2)]


def derivatives(found: Stability) -> list[Block]:
    """For each case, the value with the largest error of the covariance form, or its failure, and the errors of every
    form.
    """
    worst: dict[str, Derived] = {}
    for row in found.parts["derivatives"]:
        known = worst.get(row.case)
        if known is None or _lost(row) > _lost(known):
            worst[row.case] = row
    rows = [
        [row.case, number(row.value), error(row.sensitivity.norm), *(error(row.errors[form].norm) for form in DERIVED_FORMS)]
        for row in worst.values()
    ]
    return [DERIVATIVES, Table(("case", "value", "sensitivity", *DERIVED_FORMS), rows, 2)]


def loops(found: Stability) -> list[Block]:
    """One linkage per ratio, and the errors of every form and of dense algebra."""
    methods = (*DERIVED_FORMS, DENSE)
    rows = [
        [row.heavy, number(row.ratio), error(row.sensitivity.norm), *(error(row.errors[method].norm) for method in methods)]
        for row in found.parts["loops"]
    ]
    return [flowed(LOOPS), Table(("heavy", "ratio", "sensitivity", *methods), rows, 2)]


def _lost(row: Derived) -> float:
    lost = row.errors["covariance"].norm
    return math.inf if math.isnan(lost) else lost


def singular(found: Stability) -> list[Block]:
    """Error of the singular case."""
    return ["A body without inertia about the axis of its joint raises an error; it is not regularized:", Code(found.parts["singular"])]


def failed(found: Stability) -> list[Block]:
    """Failures of methods, with reasons."""
    counted: dict[tuple[str, str], list[str]] = {}
    for point in found.points:
        for method, one in point.errors.items():
            if one.reason:
                counted.setdefault((method, one.reason), []).append(f"{point.name} {number(point.value)}")
    rows = [[*key, str(len(where)), ", ".join(list(dict.fromkeys(where))[:3])] for key, where in counted.items()]
    return [Table(("method", "reason", "states", "such as"), rows, 99)]


def cases(found: Stability) -> list[Block]:
    """Two tables per case."""
    blocks: list[Block] = [flowed(CASES)]
    for name in found.names:
        points = found.of(name)
        freedom = plural(points[-1].degrees_of_freedom, "degree")
        words = f"Value: {scenes.extreme(name).parameter}. {freedom} of freedom at the last value."
        blocks += [Heading(name), words, "Max-norm:", _numbers(found, points, 0), "Per component:", _numbers(found, points, 1)]
    return blocks


def _numbers(found: Stability, points: Sequence[Point], norm: int) -> Table:
    """One row per point: sensitivities, and the error of every method, in one of the norms of Error."""
    rows = []
    for point in points:
        shown: list[Error] = [point.sensitivity["state"], point.parameters]
        shown += [point.errors[method] for method in found.methods]
        rows.append([number(point.value), *(error(float(one[norm] or 0.0)) for one in shown)])
    return Table(("value", "state", "parameters", *found.methods), rows)
