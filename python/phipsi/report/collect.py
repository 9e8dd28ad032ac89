"""Everything that a report says, measured; and the same as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core, errors
from .._core import Scene
from .._results import Omission
from . import auto_cost, calls, emergence, kinds, left_out, machine, measure, states
from .auto_cost import Cost
from .calls import CallTime, KindError
from .emergence import Emergence
from .measure import DENSE_CAP, Accuracy, Growth, OperatorGrowth, Residual
from .progress import Reporter
from .structure import Tree, tree_of
from .worker import WorkerError

Array = NDArray[np.float64]

#: Beyond this, M^-1 is not formed either.
INVERSE_CAP = 2000
#: What forward dynamics is called in Rust.
FORWARD = _core.method_call(_core.METHODS[0])[0]


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    states: int
    residual_states: int
    repeats: int
    sizes: tuple[int, ...]
    growth_repeats: int

    @staticmethod
    def of(nv: int, quick: bool, count: int | None) -> Effort:
        """Enough for steady medians, or enough to look at."""
        # The composite matrices cost the cube of 6 nv.
        dense = 32 if nv <= 12 else 10 if nv <= 60 else 3
        if quick:
            number = count or 64
            return Effort(number, min(number, dense), 3, (10, 30, 100, 300, 1000, 3000, 10_000), 5)
        number = count or 400
        sizes = tuple(m * 10**k for k in range(1, 5) for m in (1, 2, 5)) + (100_000,)
        return Effort(number, min(number, 4 * dense), 5, sizes, 9)


@dataclass
class Report:
    """What was measured on one scene; `missing` says why a part is empty."""

    name: str
    source: str
    scene: Scene
    tree: Tree
    warnings: Sequence[str]
    seed: int
    quick: bool
    effort: Effort
    date: str
    machine: dict[str, str | int | None]
    mass_matrix: Array | None = None
    rank: int | None = None
    conditions: Array = field(default_factory=lambda: np.empty(0))
    residuals: list[Residual] = field(default_factory=list)
    accuracy: list[Accuracy] = field(default_factory=list)
    calls: list[CallTime] = field(default_factory=list)
    costs: list[Cost] = field(default_factory=list)
    kind_errors: list[KindError] = field(default_factory=list)
    emergence: Emergence | None = None
    growth: list[Growth] = field(default_factory=list)
    operators: list[OperatorGrowth] = field(default_factory=list)
    left_out: dict[str, left_out.Times] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether no residual is beyond its bound."""
        return all(residual.passed for residual in self.residuals)

    def call(self, text: str, form: str | None, *, batch: bool) -> CallTime | None:
        """The time of one call from Python, of one state or of a batch."""
        rows = (row for row in self.calls if (row.call, row.form, row.batch > 1) == (text, form, batch))
        return next(rows, None)

    def of(self, method: str, precision: str) -> Accuracy | None:
        """The row of one method in one precision."""
        rows = (row for row in self.accuracy if (row.method, row.precision) == (method, precision))
        return next(rows, None)


def collect(
    scene: Scene,
    reporter: Reporter,
    *,
    name: str,
    source: str,
    warnings: Sequence[str] = (),
    quick: bool = False,
    count: int | None = None,
    seed: int = 0,
) -> Report:
    """Measures a scene; what it cannot have is noted in `missing`."""
    effort = Effort.of(scene.nv, quick, count)
    date = datetime.now(timezone.utc).isoformat(timespec="seconds")
    tree = tree_of(scene)
    report = Report(name, source, scene, tree, warnings, seed, quick, effort, date, machine.describe())
    if scene.nv == 0:
        for part in ("residuals", "calls", "accuracy", "condition", "emergence"):
            report.missing[part] = (
                "Nothing moves in this scene: it has no degree of freedom, so there is nothing to compute."
            )
    else:
        drawn = states.draw(scene, tree, effort.states, seed)
        _states(report, drawn, reporter)
        _emergence(report, drawn, reporter)
    tick = reporter.stage("Growth with size", measure.GROWTH_ROUNDS * len(effort.sizes))
    report.growth = measure.growth(effort.sizes, effort.growth_repeats, tick)
    tick = reporter.stage("Operators on chains", measure.GROWTH_ROUNDS * len(measure.OPERATOR_SIZES))
    report.operators = measure.operator_growth(effort.growth_repeats, tick)
    return report


def _states(report: Report, drawn: states.States, reporter: Reporter) -> None:
    """The parts that need states: mass matrix, condition numbers, residuals, error against run time."""
    scene, effort, missing = report.scene, report.effort, report.missing
    few = drawn.first(effort.residual_states)
    methods = _core.METHODS
    if scene.nv > DENSE_CAP:
        note = (
            f"{scene.nv} degrees of freedom: nothing dense is built beyond {DENSE_CAP}, and this part compares with"
            " dense algebra."
        )
        missing["residuals"] = missing["condition"] = note
        methods = tuple(
            method
            for method in _core.METHODS
            if _core.method_call(method)[0] == FORWARD or (scene.nv <= INVERSE_CAP and "M^-1" in method)
        )
    else:
        report.mass_matrix = scene.mass_matrix(drawn.q[0])
        report.rank = int(np.linalg.matrix_rank(report.mass_matrix, hermitian=True))
        report.conditions = measure.condition_numbers(scene, drawn.q)
    try:
        scene.forward_dynamics(drawn.q, drawn.qd, drawn.tau)
    except errors.PhipsiError as error:
        missing["residuals"] = missing["calls"] = missing["accuracy"] = str(error)
        return
    tick = reporter.stage("What calls take", 3)
    batch = calls.batch_of(scene, drawn.q, drawn.qd, drawn.tau, report.seed)
    report.calls = calls.measured(scene, batch, report.quick)
    tick()
    report.costs = auto_cost.measured(scene, batch, quick=report.quick)
    tick()
    report.kind_errors = calls.kind_errors(scene, batch, min(len(batch.q), effort.states))
    tick()
    report.left_out = left_out.measured(scene, drawn)
    try:
        if "residuals" not in missing:
            tick = reporter.stage("Residuals", len(few))
            conditions = report.conditions[: len(few)]
            report.residuals = measure.residuals(scene, few, conditions, tick)
    except errors.PhipsiError as error:
        missing["residuals"] = str(error)
    try:
        tick = reporter.stage("Error against run time", measure.ROUNDS)
        report.accuracy = measure.accuracy(scene, drawn, methods, effort.repeats, tick)
    except errors.PhipsiError as error:
        missing["accuracy"] = str(error)


def _emergence(report: Report, drawn: states.States, reporter: Reporter) -> None:
    """M from the random model, at the first state."""
    try:
        report.emergence = emergence.measured(
            report.scene, drawn.q[0], report.seed, report.quick, report.missing, reporter
        )
    except (errors.PhipsiError, WorkerError) as error:
        report.missing["emergence"] = str(error)


def number(value: float) -> float | None:
    """A number that JSON can hold; None for NaN and infinities."""
    return float(value) if math.isfinite(value) else None


def to_json(report: Report) -> dict[str, Any]:
    """All numbers of a report; None where a method failed, and where a part is missing."""
    return {
        "format": 1,
        "date": report.date,
        "machine": report.machine,
        "passed": report.passed,
        "missing": report.missing,
        "scene": _scene(report),
        "states": {
            "count": report.effort.states,
            "for_residuals": report.effort.residual_states,
            "seed": report.seed,
            "quick": report.quick,
        },
        "plan": _plan(report),
        "residuals": [
            {
                "name": row.name,
                "median": number(row.median),
                "worst": number(row.worst),
                "bound": number(row.bound),
                "worst_in_bounds": number(row.ratio),
                "bound_grows_with_condition": row.through_inverse,
                "passed": row.passed,
            }
            for row in report.residuals
        ],
        "accuracy": [
            {
                "method": row.method,
                "precision": row.precision,
                **_rust(*_core.method_call(row.method), kinds.RANDOM),
                "ns_per_state": number(row.ns),
                "error_median": number(row.median),
                "error_max": number(row.worst),
                "digits_lost": number(row.digits_lost),
                "failed_states": row.failed,
                "errors": [number(error) for error in row.errors],
            }
            for row in report.accuracy
        ],
        "calls": [
            {**_python(row.call, row.form, row.states, row.batch), "ns_per_state": number(row.ns)} for row in report.calls
        ],
        "kinds": _kinds(report),
        "condition": _condition(report),
        "emergence": _emergence_numbers(report.emergence),
        "growth": _growth(report.growth) | {"operators": _operators(report.operators)},
    }


def _rust(call: str, form: str | None, states: str) -> dict[str, Any]:
    """What a time is of: a call in Rust, one state."""
    return {"from": "Rust", "call": call, "form": form, "states": states, "batch": 1}


def _python(call: str, form: str | None, states: str, batch: int) -> dict[str, Any]:
    """What a time is of: a call from Python, on one thread."""
    return {"from": "Python", "call": call, "form": form, "states": states, "batch": batch}


def _kinds(report: Report) -> list[dict[str, Any]]:
    """Forward dynamics at every kind of state: a row a form and size of call, with the error of the form."""
    errors_of = {(row.kind, row.form): row for row in report.kind_errors}
    rows = []
    for row in report.costs:
        for form, ns in (("auto", row.auto), ("covariance", row.covariance)):
            error = errors_of.get((row.kind, form))
            rows.append(
                {
                    **_python(left_out.FORWARD, form, row.kind, row.batch),
                    "meaning": kinds.MEANING[row.kind],
                    "ns_per_state": number(ns),
                    "ns_over_covariance": number(row.ratio if form == "auto" else 1.0),
                    "error_median": number(error.median) if error else None,
                    "error_max": number(error.worst) if error else None,
                }
            )
    return rows


def _scene(report: Report) -> dict[str, Any]:
    scene, tree = report.scene, report.tree
    return {
        "name": report.name,
        "source": report.source,
        "nq": scene.nq,
        "nv": scene.nv,
        "bodies": scene.plan().bodies,
        "links": scene.plan().links,
        "mass": tree.mass,
        "gravity": [float(g) for g in scene.gravity],
        "warnings": list(report.warnings),
        "joints": [
            {"name": joint.name, "type": joint.kind, "parent": joint.parent, "child": joint.child}
            for joint in tree.joints.values()
        ],
    }


def _plan(report: Report) -> dict[str, Any]:
    plan = report.scene.plan()
    times = report.left_out
    items = [
        {
            "what": item.what,
            "switch": item.switch,
            "count": item.count,
            "names": list(item.names),
            "why": item.why,
            "saved": item.saved,
            "operations": item.operations,
            **_saved(report, item, times.get(left_out.name_of(item))),
        }
        for item in plan.items
    ]
    return {"bodies": plan.bodies, "links": plan.links, "items": items}


def _saved(report: Report, item: Omission, times: left_out.Times | None) -> dict[str, Any]:
    """The times with an item left out and without, and what they are of."""
    if times is None:
        return {"ns_on": None, "ns_off": None}
    at = f"{kinds.RANDOM}, qd = 0" if (item.switch or "").startswith("zero_") else kinds.RANDOM
    of = _python(times.call, "covariance", at, report.effort.states)
    return {**of, "ns_on": number(times.on), "ns_off": number(times.off)}


def _condition(report: Report) -> dict[str, Any] | None:
    values = report.conditions
    if not values.size:
        return None
    return {
        "min": number(values.min()),
        "median": number(float(np.median(values))),
        "max": number(values.max()),
        "rank": report.rank,
        "values": [number(value) for value in values],
    }


def _emergence_numbers(found: Emergence | None) -> dict[str, Any] | None:
    if found is None:
        return None

    return {
        "seeds": found.seeds,
        "random_numbers_a_sample": found.dimension,
        "unit_error_in_theory": found.unit_error,
        "points": [
            {
                "route": point.route,
                "samples": point.samples,
                **_rust(emergence.CALLS[point.route], None, kinds.RANDOM),
                "ns_median": point.ns,
                "error": number(point.error),
            }
            for point in found.points
        ],
        "slopes": [
            {
                "route": route,
                "measured": number(line.measured),
                "standard_error": number(line.standard_error),
                "theory": line.theory,
                "at_one_sample": number(line.at_one),
            }
            for route, line in found.slopes.items()
        ],
        "coverage": {
            "samples": emergence.COVERAGE_SAMPLES,
            "seeds": found.coverage_seeds,
            "rows": [
                {"stated": row.confidence, "diagonal": _share(row.diagonal), "off_diagonal": _share(row.off_diagonal)}
                for row in found.coverage
            ],
        },
        "samples_a_second": [
            {
                "threads": rate.threads,
                "samples": rate.samples,
                **_rust(emergence.CALLS[emergence.PLAIN], None, kinds.RANDOM),
                "per_second": rate.per_second,
            }
            for rate in found.rates
        ],
    }


def _share(pair: tuple[float, float] | None) -> dict[str, float] | None:
    return {"share": pair[0], "standard_error": pair[1]} if pair else None


def _operators(rows: Sequence[OperatorGrowth]) -> dict[str, Any]:
    return {
        **_rust("Operator::apply, Operator::apply_transpose", "auto", "chain"),
        "bodies": list(measure.OPERATOR_SIZES),
        "rows": [{"name": row.name, "ns_per_body": list(row.ns), "max_over_min": row.spread} for row in rows],
    }


def _growth(rows: Sequence[Growth]) -> dict[str, Any]:
    return {
        "rows": [
            {
                "bodies": row.bodies,
                "forward_ns_per_body": row.forward,
                "covariance_ns_per_body": row.covariance,
                "inverse_ns_per_body": row.inverse,
            }
            for row in rows
        ],
        "forward": _rust(FORWARD, "auto", "chain"),
        "covariance": _rust(FORWARD, "covariance", "chain"),
        "inverse": _rust("Scene::evaluate(InverseDynamics)", None, "chain"),
        "forward_max_over_min": measure.spread([row.forward for row in rows]),
        "covariance_max_over_min": measure.spread([row.covariance for row in rows]),
        "inverse_max_over_min": measure.spread([row.inverse for row in rows]),
    }
