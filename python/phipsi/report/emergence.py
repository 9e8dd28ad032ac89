"""M from samples of the random model (5.1): error, time and slope of each way to it, coverage, samples a second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .. import _core, errors
from .._core import RandomModel, Scene
from . import machine, worker
from .measure import DENSE_CAP
from .progress import Reporter
from .worker import Job

Array = NDArray[np.float64]

PLAIN, SOBOL, SIGMA, RECURSION, DENSE = _core.ROUTES
#: What is timed of each way, all in Rust: what it makes is made within the time, and dropped.
CALLS = {
    PLAIN: "Scene::random_model, RandomModel::mass_matrix(MonteCarlo)",
    SOBOL: "Scene::random_model, RandomModel::sobol_estimate",
    SIGMA: "Scene::random_model, RandomModel::mass_matrix(SigmaPoints)",
    RECURSION: "Scene::evaluate(MassMatrix)",
    DENSE: "Composite::new, Composite::mass_matrix",
}
#: The ways that take a number of samples, and the slope of log error on log samples that theory gives them.
SAMPLED = {PLAIN: -0.5, SOBOL: -1.0}
#: Beyond this many degrees of freedom sigma points take seconds.
CAP = 1000
#: Samples of each estimate whose intervals are counted, and the confidences that they state.
COVERAGE_SAMPLES, CONFIDENCES = 100, (0.8, 0.95, 0.99)
#: Samples that one thread sums up at a time, as in the core: a rate on threads needs several of them for each.
PIECE = 2**14


@dataclass(frozen=True)
class Effort:
    """How much is drawn. It rests on what work should cost, not on a clock, so the same seed gives the same numbers."""

    sizes: tuple[int, ...]
    seeds: int
    size_ns: float
    """What all seeds of one number of samples may take."""
    coverage_seeds: int
    rate_ns: float
    """What measuring the rate on one core may take."""
    rate_pieces: int
    """Pieces a thread, where there is time for them."""

    @staticmethod
    def of(nv: int, quick: bool) -> Effort:
        coverage = 400 if nv <= 100 else 100
        if quick:
            return Effort(tuple(2**k for k in range(6, 15)), 6, 6e8, coverage, 1e9, 4)
        return Effort(tuple(2**k for k in range(6, 21)), 12, 2.6e10, coverage, 1e10, 16)


def cost(route: str, dimension: int, nv: int) -> float:
    """About what one sample takes on one thread, ns."""
    return (16.0 if route == SOBOL else 8.0) * dimension + 0.2 * nv * nv


@dataclass(frozen=True)
class Slope:
    """The straight line through log error over log samples, by least squares."""

    measured: float
    standard_error: float
    theory: float
    at_one: float
    """Error where the line meets one sample."""

    def error(self, samples: float) -> float:
        """On the line."""
        return self.at_one * float(samples**self.measured)


@dataclass(frozen=True)
class Point:
    """A way to M, with a number of samples where it takes one."""

    route: str
    samples: int | None
    ns: float
    """Median over the seeds, or of all passes."""
    error: float
    """Frobenius norm over that of M; the root of the mean square over the seeds."""


@dataclass(frozen=True)
class Coverage:
    """How often an interval held its entry; None without such entries."""

    confidence: float
    diagonal: tuple[float, float] | None
    """Share, and its standard error from the scatter of the seeds."""
    off_diagonal: tuple[float, float] | None


@dataclass(frozen=True)
class Rate:
    """Samples a second of Monte Carlo, from q to its estimate of M."""

    threads: int
    samples: int
    per_second: float


@dataclass
class Emergence:
    """What was measured at one state."""

    seeds: int
    dimension: int | None = None
    """Random numbers a sample."""
    unit_error: float | None = None
    """The error that theory expects of plain sampling, times the root of the number of samples."""
    points: list[Point] = field(default_factory=list)
    slopes: dict[str, Slope] = field(default_factory=dict)
    coverage: list[Coverage] = field(default_factory=list)
    coverage_seeds: int = 0
    rates: list[Rate] = field(default_factory=list)

    @property
    def sampled(self) -> bool:
        """Whether anything was drawn."""
        return any(point.samples for point in self.points)

    def of(self, route: str) -> list[Point]:
        """The points of one way, by number of samples."""
        return [point for point in self.points if point.route == route]


def measured(
    scene: Scene, q: Array, seed: int, quick: bool, missing: dict[str, str], reporter: Reporter
) -> Emergence | None:
    """M every way at q; what cannot be had is noted in `missing`."""
    if scene.nv > CAP:
        missing["emergence"] = f"{scene.nv} degrees of freedom: M is not sampled beyond {CAP}."
        return None
    matrix = scene.mass_matrix(q)
    if not np.any(matrix):
        missing["emergence"] = "The mass matrix is zero at this state: there is nothing to estimate."
        return None
    effort = Effort.of(scene.nv, quick)
    model = _model(scene, q, missing)
    plan = _plan(scene, q, model, effort, missing)
    found = Emergence(effort.seeds)
    if model is not None:
        found.dimension = model.dimension
        found.unit_error = _unit_error(matrix)
    _errors(scene, q, seed, plan, found, reporter)
    for route, theory in SAMPLED.items():
        line = slope(found.of(route), theory)
        if line is not None:
            found.slopes[route] = line
    if model is not None:
        tick = reporter.stage("Coverage of intervals", len(CONFIDENCES))
        found.coverage_seeds = effort.coverage_seeds
        seeds = _seeds(seed, 1, effort.coverage_seeds)
        for confidence in CONFIDENCES:
            found.coverage.append(_coverage(model, matrix, confidence, seeds))
            tick()
        _rates(scene, q, effort, found, missing, reporter)
    return found


def _model(scene: Scene, q: Array, missing: dict[str, str]) -> RandomModel | None:
    try:
        return scene.random_model(q)
    except errors.PhipsiError as error:
        missing["sampling"] = str(error)
        return None


@dataclass(frozen=True)
class _Way:
    route: str
    sizes: tuple[int, ...]
    """Empty for a way without samples."""
    repeats: int


def _plan(scene: Scene, q: Array, model: RandomModel | None, effort: Effort, missing: dict[str, str]) -> list[_Way]:
    """The ways that this scene can be asked for."""
    nv = scene.nv
    passes = 301 if nv <= 12 else 31 if nv <= 60 else 3
    ways = []
    if model is not None:
        for route in SAMPLED:
            try:
                _core.emergence(scene, q, route, 1, 0, 1)
            except errors.PhipsiError as error:
                missing[route] = str(error)
                continue
            # The core computes M thrice for one time and one error.
            sample = 3.0 * effort.seeds * cost(route, model.dimension, nv)
            sizes = tuple(n for n in effort.sizes if n * sample <= effort.size_ns)
            if sizes:
                ways.append(_Way(route, sizes, 1))
            else:
                missing[route] = f"{nv} degrees of freedom: even {effort.sizes[0]} samples take too long."
        ways.append(_Way(SIGMA, (), passes))
    ways.append(_Way(RECURSION, (), passes))
    if nv <= DENSE_CAP:
        ways.append(_Way(DENSE, (), passes if nv <= 60 else 1))
    else:
        missing[DENSE] = f"{nv} degrees of freedom: nothing dense is built beyond {DENSE_CAP}."
    return ways


def _errors(scene: Scene, q: Array, seed: int, ways: Sequence[_Way], found: Emergence, reporter: Reporter) -> None:
    """Error and time of every way on one thread, in rounds so that a change of the machine's pace falls on all alike."""
    rounds = found.seeds
    cases = [(way, n) for way in ways for n in way.sizes or (None,)]
    # Seeds of their own for each size: the same ones would begin with the same samples, and the errors would go together.
    seeds = _seeds(seed, 0, rounds * len(cases)).reshape(rounds, len(cases))
    # Dense products of large scenes take seconds, and always give the same.
    jobs = [
        [Job(way.route, n or 1, int(one), way.repeats) for (way, n), one in zip(cases, row, strict=True)]
        for row in seeds
    ]
    heavy = {way.route for way in ways if not way.sizes and way.repeats == 1}
    jobs[1:] = [[job for job in row if job.route not in heavy] for row in jobs[1:]]
    flat = [job for row in jobs for job in row]
    tick = reporter.stage("M from the random model", len(flat))
    answers: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for job, answer in zip(flat, worker.run(scene, q, flat, 1, tick), strict=True):
        answers.setdefault((job.route, job.samples), []).append(answer)
    for way, n in cases:
        ns, error = np.array(answers[way.route, n or 1]).T
        found.points.append(Point(way.route, n, float(np.median(ns)), float(np.sqrt(np.mean(error**2)))))


def _seeds(seed: int, purpose: int, count: int) -> NDArray[np.int64]:
    return np.random.default_rng((seed, purpose)).integers(0, 2**63, count)


def _unit_error(matrix: Array) -> float:
    """Of one sample: the variance of the product T_i T_j of centred normal numbers is M_ii M_jj + M_ij^2."""
    square = float(np.sum(matrix**2))
    return float(np.sqrt((float(np.trace(matrix)) ** 2 + square) / square))


def slope(points: Sequence[Point], theory: float) -> Slope | None:
    """The line of least squares through log error over log samples; None below three points, or where an error is zero."""
    if len(points) < 3 or not all(point.error > 0.0 for point in points):
        return None
    x = np.log([float(point.samples or 1) for point in points])
    y = np.log([point.error for point in points])
    middle = x - x.mean()
    spread = float(middle @ middle)
    measured = float(middle @ y) / spread
    off = y - y.mean() - measured * middle
    standard_error = float(np.sqrt(off @ off / (len(points) - 2) / spread))
    return Slope(measured, standard_error, theory, float(np.exp(y.mean() - measured * x.mean())))


def _coverage(model: RandomModel, matrix: Array, confidence: float, seeds: NDArray[np.int64]) -> Coverage:
    """Over entries whose torques vary; a sum is over entries, its standard error over seeds, which are independent."""
    size = np.diagonal(matrix) > 0.0
    varies = np.outer(size, size)
    diagonal = np.eye(len(matrix), dtype=bool)
    held = []
    for seed in seeds:
        estimate = model.mass_matrix(COVERAGE_SAMPLES, seed=int(seed), confidence=confidence)
        assert estimate.low is not None and estimate.high is not None
        held.append((estimate.low <= matrix) & (matrix <= estimate.high))
    every = np.array(held)

    def share(chosen: NDArray[np.bool_]) -> tuple[float, float] | None:
        if not chosen.any():
            return None
        shares = every[:, chosen].mean(axis=1)
        return float(shares.mean()), float(shares.std(ddof=1) / np.sqrt(len(shares)))

    return Coverage(confidence, share(diagonal & varies), share(~diagonal & varies))


def _rates(
    scene: Scene, q: Array, effort: Effort, found: Emergence, missing: dict[str, str], reporter: Reporter
) -> None:
    """On one core and on all, the same samples, one process after the other."""
    repeats, cores = 3, machine.threads()
    pieces = effort.rate_pieces * cores
    assert found.dimension is not None
    piece = PIECE * cost(PLAIN, found.dimension, scene.nv) * (repeats + 2)
    while pieces > cores and pieces * piece > effort.rate_ns:
        pieces //= 2
    if pieces * piece > 4 * effort.rate_ns:
        missing["samples a second"] = (
            f"{scene.nv} degrees of freedom: enough samples for {cores} threads take too long."
        )
        return
    samples = pieces * PIECE
    used = sorted({1, cores})
    tick = reporter.stage("Samples a second", len(used))
    for threads in used:
        ((ns, _),) = worker.run(scene, q, [Job(PLAIN, samples, 0, repeats)], threads, tick)
        found.rates.append(Rate(threads, samples, samples / ns * 1e9))
