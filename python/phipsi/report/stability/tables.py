"""The tables and words of the stability report."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ... import scenes
from ..page import Block, Code, Figure, Heading, Table, flowed
from ..robot import PRECISIONS
from ..text import plural, time
from .loops import DENSE
from .measure import COVARIANCE, DERIVED_FORMS, ROOT, TIMED, Derived, Error, Point, Recursion, Stability
from .plots import SWEEPS

RUN_TIME = """\
One point a method; filled circles float64, hollow squares float32. A method without a point failed. Times are of one thread and one
state, calls of Scene::evaluate in Rust (the dense methods: with faer).
"""
AIM = """\
The aim is an error of at most 1e-13 in the max-norm (largest error over the largest acceleration), and of at most 1e-12 component by
component (each acceleration against its own size); or 20 times the problem's own sensitivity where that is larger. It is missed by:
"""
SWEPT = """\
The grey area is below the problem's sensitivity: the change of the exact answer when the numbers that describe the problem move by
one unit in the last place.
"""
RECURSIONS = "For each case the value where a component is furthest above its sensitivity, if it loses more than 1e-13:"
DERIVATIVES = "For each case the value where the covariance form loses most; errors in the max-norm:"
LOOPS = """\
Accelerations of six bars in a plane, hinged to each other and at both ends to the ground: a tree of six joints, closed by a hinge.
Some bars have the ratio times the mass of the others. The reference is their equations of motion solved in exact fractions. Errors in
the max-norm, the worst of the states.
"""
CASES = """\
Each number is the worst of the states, of the errors as of the sensitivities. The columns state and parameters are sensitivities; –
means that a method failed or was not compared at every state, with the reason above.
"""


def number(value: float) -> str:
    """A parameter, such as 1e12 or 0.1."""
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
    """Where the square-root form misses its aim, in either norm: how often, and the worst."""
    grouped: dict[tuple[str, float, str], list[tuple[float, float]]] = {}
    for point in found.points:
        own, aim = point.errors[ROOT, "float64"], point.aim
        for norm, ours, allowed in (("max-norm", own.norm, aim.norm), ("components", own.component, aim.component)):
            if not ours <= allowed:
                grouped.setdefault((point.name, point.value, norm), []).append((ours, allowed))
    rows = []
    for (name, value, norm), group in grouped.items():
        states = sum((point.name, point.value) == (name, value) for point in found.points)
        worst = max(group, key=lambda pair: pair[0] / pair[1])
        rows.append([name, number(value), norm, f"{len(group)} of {states}", *map(error, worst)])
    return [flowed(AIM), Table(("case", "value", "norm", "states", "worst error", "aim there"), rows, 3)]


def pictures(found: Stability) -> list[Block]:
    """The plots."""
    states = f"Each point is the worst of {len(found.seeds)} states; the grey area is below the sensitivity."
    sweeps = [Figure(name, f"{caption} {states}") for name, (_, _, caption) in SWEEPS.items()]
    return [flowed(SWEPT), *sweeps, Figure("error-against-run-time", flowed(RUN_TIME))]


def timed(found: Stability) -> list[Block]:
    """What the forms cost."""
    rows, ratios = [], []
    for name, value in TIMED:
        for precision in PRECISIONS:
            chosen = found.timed(name, value, precision)
            base = next(row.ns for row in chosen if row.method == COVARIANCE)
            for row in chosen:
                if row.method == ROOT and precision == "float64":
                    ratios.append(row.ns / base)
                rows.append([f"{name}, {number(value)}", precision, row.method, time(row.ns), f"{row.ns / base:.2f}", error(row.norm)])
    words = f"In float64 the square-root form takes {min(ratios):.1f} to {max(ratios):.1f} times the time of the covariance form here."
    return [words, Table(("case", "precision", "method", "time", "over covariance", "max-norm error"), rows, 3)]


def recursions(found: Stability) -> list[Block]:
    """The worst point of each case for each quantity: the component furthest above what the problem allows."""

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
    """Of each case the value where the covariance form loses most, or fails, and the errors of every form there."""
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
    """A linkage of every ratio, and the errors of every form and of dense algebra."""
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
    """What is refused."""
    return ["A body without inertia about its joint's axis is refused, not regularised:", Code(found.parts["singular"])]


def failed(found: Stability) -> list[Block]:
    """Which methods failed where, and why."""
    counted: dict[tuple[str, str, str], list[str]] = {}
    for point in found.points:
        for (method, precision), one in point.errors.items():
            if one.reason:
                counted.setdefault((method, precision, one.reason), []).append(f"{point.name} {number(point.value)}")
    rows = [[*key, str(len(where)), ", ".join(list(dict.fromkeys(where))[:3])] for key, where in counted.items()]
    return [Table(("method", "precision", "reason", "states", "such as"), rows, 99)]


def cases(found: Stability) -> list[Block]:
    """Two tables a case."""
    blocks: list[Block] = [flowed(CASES)]
    for name in found.names:
        points = found.of(name)
        freedom = plural(points[-1].degrees_of_freedom, "degree")
        words = f"Value: {scenes.extreme(name).parameter}. {freedom} of freedom at the last value."
        blocks += [Heading(name), words, "Max-norm:", _numbers(found, points, 0), "Component by component:", _numbers(found, points, 1)]
    return blocks


def _numbers(found: Stability, points: Sequence[Point], norm: int) -> Table:
    """A row a point: what the problem allows, and the error of every method, in one of the norms of Error."""
    singles = (ROOT, COVARIANCE)
    rows = []
    for point in points:
        shown: list[Error] = [point.sensitivity["state"], point.parameters]
        shown += [point.errors[method, "float64"] for method in found.methods]
        shown += [point.errors[method, "float32"] for method in singles]
        rows.append([number(point.value), *(error(float(one[norm] or 0.0)) for one in shown)])
    return Table(("value", "state", "parameters", *found.methods, "root, float32", "covariance, float32"), rows)
