"""M from samples of the random model (5.1): error, time and convergence rate of each method, coverage, samples
per second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ... import _core, errors
from ..._core import RandomModel, Scene
from ..pipeline import Missing
from ..progress import Reporter
from ..robot import DENSE_CAP, Report, rust
from ..states import Array
from ..timing import Of, threads

PLAIN, SOBOL, SIGMA, RECURSION, DENSE = _core.ROUTES
#: Timed call of each method, in Rust; the time includes the allocation of the results.
CALLS = {
    PLAIN: "Scene::random_model, RandomModel::mass_matrix(MonteCarlo)",
    SOBOL: "Scene::random_model, RandomModel::sobol_estimate",
    SIGMA: "Scene::random_model, RandomModel::mass_matrix(SigmaPoints)",
    RECURSION: "Scene::evaluate(MassMatrix)",
    DENSE: "Composite::new, Composite::mass_matrix",
}
#: Methods with a number of samples, and the theoretical slope of log error against log samples.
SAMPLED = {PLAIN: -0.5, SOBOL: -1.0}
#: Largest number of degrees of freedom; beyond it sigma points take seconds.
CAP = 1000
#: Samples of each estimate for the coverage, and the stated confidences.
COVERAGE_SAMPLES, CONFIDENCES = 100, (0.8, 0.95, 0.99)
#: Samples that one thread accumulates at a time, as on the Rust side; a rate on several threads needs several pieces per thread.
PIECE = 2**14


class Effort(NamedTuple):
    """Number of samples. It depends on estimated operation counts and not on a clock, so that equal seeds give equal
    results.
    """

    sizes: tuple[int, ...]
    seeds: int
    size_ns: float
    """Time budget of all seeds with one number of samples."""
    rate_ns: float
    """Time budget for the rate on one core."""
    rate_pieces: int
    """Pieces per thread, within the time budget."""


QUICK = Effort(tuple(2**k for k in range(6, 15)), 6, 6e8, 1e9, 4)
FULL = Effort(tuple(2**k for k in range(6, 21)), 12, 2.6e10, 1e10, 16)


def cost(route: str, dimension: int, nv: int) -> float:
    """Approximate time of one sample on one thread, ns."""
    return (16.0 if route == SOBOL else 8.0) * dimension + 0.2 * nv * nv


class Slope(NamedTuple):
    """Least-squares line of log error against log samples."""

    route: str
    measured: float
    standard_error: float
    theory: float
    at_one_sample: float
    """Value of the line at one sample."""

    def error(self, samples: float) -> float:
        """Value of the line."""
        return self.at_one_sample * float(samples**self.measured)


class Point(NamedTuple):
    """A method for M, with its number of samples if it takes one."""

    route: str
    samples: int | None
    ns_median: float
    """Median over the seeds, or over all passes."""
    error: float
    """Frobenius norm of the error relative to that of M; root mean square over the seeds."""

    @property
    def of(self) -> Of:
        """Description of the timed call."""
        return rust(CALLS[self.route])


class Rate(NamedTuple):
    """Samples per second of Monte Carlo, from q to the estimate of M."""

    threads: int
    samples: int
    of: Of
    per_second: float


@dataclass
class Emergence:
    """Results at one state."""

    seeds: int
    random_numbers_a_sample: int | None = None
    unit_error_in_theory: float | None = None
    """Theoretical error of independent samples, times the square root of the number of samples."""
    points: list[Point] = field(default_factory=list)
    slopes: list[Slope] = field(default_factory=list)
    coverage: dict[str, Any] | None = None
    """Fraction of intervals that contain the exact entry, by stated confidence."""
    samples_a_second: list[Rate] = field(default_factory=list)

    def sampled(self) -> bool:
        """Whether samples were drawn."""
        return any(point.samples for point in self.points)

    def along(self, route: str) -> list[Point]:
        """Points of one method, by number of samples."""
        return [point for point in self.points if point.route == route]

    def slope(self, route: str) -> Slope | None:
        """Line through the points of one method; None if there is none."""
        return next((line for line in self.slopes if line.route == route), None)


def collect(report: Report, reporter: Reporter) -> Emergence:
    """M by every method at the first state of a report."""
    return measured(report.scene, report.states.q[0], report.seed, report.quick, report.missing, reporter)


def measured(scene: Scene, q: Array, seed: int, quick: bool, missing: dict[str, str], reporter: Reporter) -> Emergence:
    """M by every method at q. Reasons for missing parts are stored in `missing`. Raises Missing if there is no
    result.
    """
    if scene.nv > CAP:
        raise Missing(f"{scene.nv} degrees of freedom: M is sampled for at most {CAP}.")
    matrix = scene.mass_matrix(q)
    if not np.any(matrix):
        raise Missing("The mass matrix is zero at this state: no estimate is possible.")
    effort = QUICK if quick else FULL
    model = None
    try:
        model = scene.random_model(q)
    except errors.PhipsiError as error:
        missing["sampling"] = str(error)
    cases = _cases(scene, q, model, effort, missing)
    found = Emergence(effort.seeds)
    with threads(1):
        found.points = _errors(scene, q, seed, cases, effort.seeds, reporter)
    lines = (slope(found.along(route), theory) for route, theory in SAMPLED.items())
    found.slopes = [line for line in lines if line is not None]
    if model is not None:
        found.random_numbers_a_sample, found.unit_error_in_theory = model.dimension, unit_error(matrix)
        seeds = _seeds(seed, 1, 400 if scene.nv <= 100 else 100)
        rows = [_covered(model, matrix, confidence, seeds) for confidence in reporter.each("Coverage of intervals", CONFIDENCES)]
        found.coverage = {"samples": COVERAGE_SAMPLES, "seeds": len(seeds), "rows": rows}
        found.samples_a_second = _rates(scene, q, model, effort, missing, reporter)
    return found


class _Case(NamedTuple):
    """A method, its number of samples if it takes one, and the number of timings."""

    route: str
    samples: int | None
    repeats: int


def _cases(scene: Scene, q: Array, model: RandomModel | None, effort: Effort, missing: dict[str, str]) -> list[_Case]:
    """Methods that this scene supports."""
    nv = scene.nv
    passes = 301 if nv <= 12 else 31 if nv <= 60 else 3
    found = []
    if model is not None:
        for route in SAMPLED:
            try:
                _core.emergence(scene, q, route, 1, 0, 1)
            except errors.PhipsiError as error:
                missing[route] = str(error)
                continue
            # The Rust side computes M three times for one time and one error.
            sample = 3.0 * effort.seeds * cost(route, model.dimension, nv)
            sizes = [_Case(route, n, 1) for n in effort.sizes if n * sample <= effort.size_ns]
            if not sizes:
                missing[route] = f"{nv} degrees of freedom: even {effort.sizes[0]} samples take too long."
            found += sizes
        found.append(_Case(SIGMA, None, passes))
    found.append(_Case(RECURSION, None, passes))
    if nv <= DENSE_CAP:
        found.append(_Case(DENSE, None, passes if nv <= 60 else 1))
    else:
        missing[DENSE] = f"{nv} degrees of freedom: dense matrices are formed for at most {DENSE_CAP}."
    return found


def _errors(scene: Scene, q: Array, seed: int, cases: Sequence[_Case], rounds: int, reporter: Reporter) -> list[Point]:
    """Error and time of every case, in rounds, so that changes of the clock rate affect all cases equally."""
    # Separate seeds for each size: with equal seeds the errors would be correlated.
    seeds = _seeds(seed, 0, rounds * len(cases))
    answers: dict[_Case, list[tuple[float, float]]] = {}
    for case, one in reporter.each("M from the random model", list(zip([*cases] * rounds, seeds, strict=True))):
        known = answers.setdefault(case, [])
        # Dense products of large scenes take seconds and are deterministic.
        if not known or case.samples or case.repeats > 1:
            known.append(_core.emergence(scene, q, case.route, case.samples or 1, int(one), case.repeats))
    found = []
    for case, known in answers.items():
        ns, error = np.array(known).T
        found.append(Point(case.route, case.samples, float(np.median(ns)), float(np.sqrt(np.mean(error**2)))))
    return found


def _seeds(seed: int, purpose: int, count: int) -> NDArray[np.int64]:
    return np.random.default_rng((seed, purpose)).integers(0, 2**63, count)


def unit_error(matrix: Array) -> float:
    """Error of one sample: the variance of the product T_i T_j of centered normal variables is M_ii M_jj + M_ij^2."""
    square = float(np.sum(matrix**2))
    return float(np.sqrt((float(np.trace(matrix)) ** 2 + square) / square))


def slope(points: Sequence[Point], theory: float) -> Slope | None:
    """Least-squares line of log error against log samples; None for fewer than three points, or if an error is zero."""
    if len(points) < 3 or not all(point.error > 0.0 for point in points):
        return None
    samples, found = np.array([(float(point.samples or 1), point.error) for point in points]).T
    (measured, at_one), covariance = np.polyfit(np.log(samples), np.log(found), 1, cov=True)
    return Slope(points[0].route, float(measured), float(np.sqrt(covariance[0, 0])), theory, float(np.exp(at_one)))


def _covered(model: RandomModel, matrix: Array, confidence: float, seeds: NDArray[np.int64]) -> dict[str, Any]:
    """Fraction of the entries whose intervals contain the exact value, and its standard error; None if no torques vary.

    The fraction is over entries; its standard error is over seeds, which are independent.
    """
    size = np.diagonal(matrix) > 0.0
    varies = np.outer(size, size)
    diagonal = np.eye(len(matrix), dtype=bool)
    held = []
    for seed in seeds:
        estimate = model.mass_matrix(COVERAGE_SAMPLES, seed=int(seed), confidence=confidence)
        assert estimate.low is not None and estimate.high is not None
        held.append((estimate.low <= matrix) & (matrix <= estimate.high))
    every = np.array(held)

    def share(chosen: NDArray[np.bool_]) -> dict[str, float] | None:
        if not chosen.any():
            return None
        shares = every[:, chosen].mean(axis=1)
        return {"share": float(shares.mean()), "standard_error": float(shares.std(ddof=1) / np.sqrt(len(shares)))}

    return {"stated": confidence, "diagonal": share(diagonal & varies), "off_diagonal": share(~diagonal & varies)}


def _rates(
    scene: Scene, q: Array, model: RandomModel, effort: Effort, missing: dict[str, str], reporter: Reporter
) -> list[Rate]:
    """Rates on one thread and on all cores, for the same samples."""
    repeats, cores = 3, _core.get_num_threads()
    piece = PIECE * cost(PLAIN, model.dimension, scene.nv) * (repeats + 2)
    # Limited by the estimated time, at least one per thread; independent of a clock.
    pieces = cores * max(1, min(effort.rate_pieces, int(effort.rate_ns / piece / cores)))
    if pieces * piece > 4 * effort.rate_ns:
        missing["samples a second"] = f"{scene.nv} degrees of freedom: enough samples for {cores} threads take too long."
        return []
    rates = []
    for count in reporter.each("Samples per second", sorted({1, cores})):
        with threads(count):
            ns, _ = _core.emergence(scene, q, PLAIN, pieces * PIECE, 0, repeats)
        rates.append(Rate(count, pieces * PIECE, rust(CALLS[PLAIN]), pieces * PIECE / ns * 1e9))
    return rates
