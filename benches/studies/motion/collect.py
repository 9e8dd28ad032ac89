"""Measurements of the motion report."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from phipsi import errors
from phipsi.report.pipeline import Findings
from phipsi.report.progress import Reporter
from . import cases, order, peers, timing
from .cases import Case
from .drift import Drift, drift
from .horizon import Horizon
from .reference import FAR, Exact, reference
from .runs import METHODS, WRONG, Path, Runner, distance, runner
from .sweep import Spring


class Effort(NamedTuple):
    """Extent of the measurement."""

    work: float
    """Steps times stages times degrees of freedom of the longest run."""
    calls: int
    """Steps times stages of the longest run of a peer in Python."""
    followed: int
    """Largest number of steps of a reference that resolves springs."""
    turns: int
    """Number of timings of a step."""
    tolerances: Sequence[float]
    """Tolerances of the adaptive methods."""


QUICK = Effort(1.7e5, 6_000, 20_000, 5, (1e-4, 1e-7, 1e-10))
FULL = Effort(1e6, 30_000, 200_000, 15, tuple(10.0**-e for e in range(3, 13)))


#: Relative drifts below this are near the rounding error, because the potential energy is large compared with its
#: changes.
ROUNDING = 1e-12
#: Radau needs many short steps to resolve oscillating springs: tighter tolerances are omitted for them.
RINGING = 1e-5


class Point(NamedTuple):
    """A run: final error, and largest drift."""

    steps: int
    dt: float
    """Step, s."""
    error: float | None
    """Final error, rad or m; None if the run failed."""
    known: bool
    """Whether the error is far above that of the reference."""
    drift: Drift
    failure: str | None
    rate_error: float | None = None
    """Final error of the joint velocities, rad/s or m/s, largest component."""
    rate_known: bool = False


class Adaptive(NamedTuple):
    """A run of an adaptive method."""

    method: str
    tolerance: float
    steps: int
    ns: float
    error: float
    known: bool


@dataclass
class Result:
    """Results for one case."""

    case: Case
    exact: Exact
    points: dict[str, list[Point]] = field(default_factory=dict)
    """By method, peers included, from coarse to fine."""
    adaptive: list[Adaptive] = field(default_factory=list)
    alone: dict[str, float] = field(default_factory=dict)
    """Time of a step, ns, one state."""
    batch: dict[str, float] = field(default_factory=dict)
    """Time of a step per state, ns, in a batch."""
    refused: list[str] = field(default_factory=list)
    """Message of a peer that refuses the scene."""

    def known(self, method: str) -> list[Point]:
        """Runs with a known error."""
        return [point for point in self.points.get(method, []) if point.known]

    def order(self, method: str) -> float | None:
        """Slope over the finest runs."""
        known = self.known(method)
        return order.fitted([point.dt for point in known], [point.error or math.nan for point in known])

    def rate_order(self, method: str) -> float | None:
        """The same for joint velocities."""
        known = [point for point in self.points.get(method, []) if point.rate_known]
        return order.fitted([point.dt for point in known], [point.rate_error or math.nan for point in known])

    def drift_order(self, method: str, kind: str) -> float | None:
        """Slope of a drift ("energy", "angular", "linear") against the step, above the rounding error."""
        rows = [(point.dt, getattr(point.drift, kind)) for point in self.points.get(method, [])]
        above = [(dt, value) for dt, value in rows if value is not None and value >= ROUNDING]
        return order.fitted([dt for dt, _ in above], [value for _, value in above])

    def json(self) -> dict[str, Any]:
        """All values; the runs as rows."""
        case, exact, names = self.case, self.exact, list(self.points)
        return {
            "name": case.name,
            "what": case.what,
            "stiff": case.stiff,
            "degrees_of_freedom": case.scene.nv,
            "seconds": case.time,
            "omega": case.omega,
            "reference": {
                "by": exact.by, "beside": exact.beside, "error": exact.error, "rate_error": exact.rate_error,
                "smallest_error_shown": self.smallest(),
            },
            "orders": {name: self.order(name) for name in names},
            "rate_orders": {name: self.rate_order(name) for name in names},
            "drift_orders": {kind: {name: self.drift_order(name, kind) for name in names} for kind in Drift._fields},
            "ns_a_step": {"alone": self.alone, "batch": self.batch},
            "refused": self.refused,
            "runs": [
                {"method": name, "steps": point.steps, "dt": point.dt, "error": point.error, "known": point.known,
                 "rate_error": point.rate_error, "rate_known": point.rate_known,
                 "energy_drift": point.drift.energy, "angular_momentum_drift": point.drift.angular,
                 "linear_momentum_drift": point.drift.linear, "failure": point.failure}
                for name, points in self.points.items() for point in points
            ],
            "adaptive": self.adaptive,
        }  # fmt: skip

    def smallest(self) -> float:
        """Smallest error that is shown."""
        shown = [p.error for rows in self.points.values() for p in rows if p.known and p.error is not None]
        return min([*shown, *(row.error for row in self.adaptive if row.known)], default=math.nan)


@dataclass
class Study(Findings):
    """All results."""

    peers: Sequence[peers.Peer] = ()
    versions: Sequence[str] = ()
    absent: Sequence[str] = ()
    """A line on each program that is not installed."""

    @property
    def methods(self) -> tuple[str, ...]:
        """phipsi's and the peers'."""
        return (*(method.name for method in METHODS), *(peer.name for peer in self.peers))

    @property
    def results(self) -> list[Result]:
        """All cases."""
        results: list[Result] = self.parts["cases"]
        return results

    @property
    def horizon(self) -> Horizon:
        """Duration for which the motion of the first case can be compared."""
        seen: Horizon = self.parts["horizon"]
        return seen

    @property
    def springs(self) -> list[Spring]:
        """Every method at every spring."""
        rows: list[Spring] = self.parts["springs"]
        return rows

    def of(self, name: str) -> Result:
        """Results of that case."""
        return next(result for result in self.results if result.case.name == name)

    @property
    def smooth(self) -> list[Result]:
        """Results without stiff joints."""
        return [result for result in self.results if not result.case.stiff]

    @property
    def stiff(self) -> list[Result]:
        """Results with stiff joints."""
        return [result for result in self.results if result.case.stiff]

    def head(self) -> dict[str, Any]:
        """Programs and methods."""
        return {
            "quick": self.quick,
            "peers": self.versions,
            "not_compared": self.absent,
            "errors_shown_above_reference_times": FAR,
            "methods": [{"method": name, "order": expected(self, name)} for name in self.methods],
        }

    def provenance(self) -> list[tuple[str, str]]:
        """Hardware and programs."""
        noisy = "times vary with other load on the machine; errors, orders and drifts are the same in every run"
        quick = [("quick", "fewer steps, tolerances and springs")] if self.quick else []
        return [*super().provenance(), ("programs compared", ", ".join(self.versions) or "none"), ("times", noisy), *quick]


def expected(study: Study, method: str) -> int:
    """Nominal order of a method on smooth motion."""
    orders = {row.name: row.order for row in METHODS} | {peer.name: peer.order for peer in study.peers}
    return orders[method]


def results(study: Study, reporter: Reporter) -> list[Result]:
    """Measure every case. Quick: fewer steps and tolerances."""
    effort = QUICK if study.quick else FULL
    found = [Result(case, reference(case, effort.followed)) for case in reporter.each("References", cases.cases())]
    for result in reporter.each("Error against step", found):
        _fixed(result, study.peers, effort)
    for result in reporter.each("Adaptive methods", found):
        result.adaptive += _adaptive(result.case, result.exact, effort)
    for result in reporter.each("Time of a step", found):
        takes = [peer for peer in study.peers if peer.name in result.points]
        result.alone, result.batch = timing.times(result.case, takes, effort.turns)
    return found


def _fixed(result: Result, others: Sequence[peers.Peer], effort: Effort) -> None:
    case, exact = result.case, result.exact
    size = (case.scene.nv + 2) * (2 if case.stiff else 1)
    for method in METHODS:
        most = effort.work / (method.stages * size)
        result.points[method.name] = _ladder(case, exact, runner(case, method.name), most)
    for peer in others:
        most = (effort.work / size if peer.timed else effort.calls) / peer.stages
        try:
            run = peer.runner(case)
        except peers.Refused as refused:
            result.refused.append(f"{peer.name}: {refused}")
            continue
        result.points[peer.name] = _ladder(case, exact, run, most)


def _ladder(case: Case, exact: Exact, run: Runner, most: float) -> list[Point]:
    """Runs with increasing numbers of steps, until the error is unknown or the number is too large; at least four."""
    points: list[Point] = []
    steps = case.first
    while len(points) < 4 or steps <= most:
        dt = case.time / steps
        points.append(_point(case, exact, steps, dt, run(dt, steps)))
        last = points[-1]
        if last.failure is None and not last.known and (last.error or 0.0) < 1e-6:
            break
        steps *= 2
    return points


def _point(case: Case, exact: Exact, steps: int, dt: float, path: Path) -> Point:
    nothing = Drift(None, None, None)
    if path.failure is not None:
        return Point(steps, dt, None, False, nothing, path.failure)
    error = distance(case, exact.q, path.q[-1])
    if not error <= WRONG:
        return Point(steps, dt, None, False, nothing, f"final error {error:.1e} rad or m")
    rates = float(np.max(np.abs(path.qd[-1] - exact.qd)))
    return Point(
        steps, dt, error, error >= FAR * exact.error, drift(case, path), None, rates, rates >= FAR * exact.rate_error
    )


def _adaptive(case: Case, exact: Exact, effort: Effort) -> list[Adaptive]:
    """DOP853 if it can resolve the springs, Radau for stiff scenes; for oscillating springs, Radau at loose tolerances
    only.
    """
    methods = ["DOP853"] if case.time * case.omega < 500.0 else []
    if case.stiff:
        methods.append("Radau")
    rows = []
    for method in methods:
        for tolerance in effort.tolerances:
            if method == "Radau" and case.rings and tolerance < RINGING:
                continue
            row = _solved(case, exact, method, tolerance)
            if row is not None:
                rows.append(row)
    return rows


def _solved(case: Case, exact: Exact, method: str, tolerance: float) -> Adaptive | None:
    ode = case.scene.ode()

    def once() -> tuple[float, Any]:
        start = time.perf_counter_ns()
        path = ode.solve(
            case.q, case.qd, (0.0, case.time), method=method, rtol=tolerance, atol=tolerance, t_eval=[case.time]
        )
        return float(time.perf_counter_ns() - start), path

    try:
        taken = [once() for _ in range(2)]
    except errors.SimulationError:
        return None
    error = distance(case, exact.q, taken[0][1].q[-1])
    return Adaptive(
        method, tolerance, taken[0][1].steps, min(ns for ns, _ in taken), error, error >= FAR * exact.error
    )
