"""Maximum a posteriori parameters from accumulated measurements, and their intervals.

Torques are linear in the parameters x: ten per body (mass, first moments, inertia about the link origin) and the
fitted motor parameters. With rows W and measured torques y, both divided by their standard deviations, x minimizes

    1/2 |y - W x|^2 + trust/2 sum over bodies (tr(J0^-1 J) - log det J)

The 4x4 matrix J, linear in x, holds the second moments of mass of a body. A body is physically consistent if J is
positive definite, which the logarithm ensures. The second sum is a Wishart prior; its mode J0 is the body of the model.
The function is convex. _most_probable minimizes it in coordinates z relative to the prior, J = L Z L^T with J0 = L L^T,
in which the mode of the prior is Z = 1. A parameter of either sign is the difference of two positive ones.

Intervals do not assume independent residuals. With the Hessian H at the minimum, deletion of block g of the log changes
the estimate by d_g = -(H - B_g)^-1 s_g, with the information B_g and the score s_g of the block. The covariance is the
sum of the delete-one-block jackknife, (G - 1)/G sum (d_g - mean)(d_g - mean)^T, and of the contribution of the prior,
H^-1 P H^-1 with the part P of H from the prior. For independent residuals this sum is H^-1.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..errors import ArgumentError, IdentificationWarning, ShapeError, of_argument
from ._accumulator import Accumulator, Block, _halved, merged_triangles
from ._base import BaseParameters, Combinations, combinations
from ._bodies import prior_of_bodies, with_parameters
from ._columns import PROPERTIES, SIGNED, Columns
from ._most_probable import most_probable
from ._student import student_quantile

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["Identification", "solved"]

_Array = NDArray[np.float64]

#: Relative singular value below which a combination of parameters counts as not determined by the motion.
UNKNOWN = 1e-8
#: Prior mode of armature, damping and friction that the model lacks, relative to the value that alone would explain the
#: torques; and scale of offsets.
SHARE, OFFSET = 1e-3, 0.05
#: Lower bound of the noise relative to the torques. It is a multiple of the rounding error of the regressor, which a
#: smaller noise would treat as information.
ROUNDING = 2.0**-36
#: Share of the variance from the data below which the interval of a parameter is the interval of the prior; and the
#: bias, in standard deviations, above which a warning is raised.
DECIDED, BIAS = 0.9, 0.2
#: With fewer blocks, intervals assume independent residuals.
FEWEST_BLOCKS = 4
#: Neighboring blocks are merged if the correlation of their scores exceeds the first number, or if they have fewer
#: torques per parameter than the second, until the third number of blocks is reached.
CORRELATED, ROWS, FEWEST_LONG = 0.1, 2.0, 8


@dataclass(frozen=True, eq=False)
class Identification:
    """Parameters of a robot, estimated from measured torques."""

    columns: Columns = field(repr=False)
    """The linear model."""
    own: _Array = field(repr=False)
    """All parameters in the order of the columns."""
    scene: Scene
    """The robot with the estimates. The inertia of a body belongs to its link in body_names; links fixed to it have
    none."""
    parameters: _Array
    """(m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) of each link of body_names, (bodies, 10); I about the link
    origin, in the link frame."""
    covariance: _Array
    """Covariance of the parameters, (10 bodies, 10 bodies), from data and prior; zero for kept bodies.
    Scene.forward_dynamics_variance accepts it, or this object."""
    root: _Array
    """Root L of the covariance L L^T of all parameters, (bodies, 10, columns)."""
    share: _Array
    """Share of the variance of each parameter that comes from the data, (bodies, 10). Below 0.9 the interval is the
    interval of the prior; NaN for kept bodies."""
    joints: dict[str, dict[str, float]]
    """Estimates of each kind in `fit` by the name of the joint or motor. The motor "joint5+joint6" has the sum of two
    joint velocities."""
    joint_deviations: dict[str, dict[str, float]]
    """Standard deviations of `joints`."""
    base: BaseParameters
    """Base parameters by least squares without the prior, with their intervals."""
    noise: _Array
    """Standard deviation of the torques, (nv,), N m or N: as given, or of the residuals, at least 1.5e-11 of the
    torques; NaN for motors without measured torques."""
    before: _Array
    """Root mean square of measured minus model torques, (nv,), N m or N; NaN for motors without measured torques."""
    after: _Array
    """Root mean square of measured minus estimated torques, (nv,), N m or N."""
    known: int
    """Number of combinations of parameters that the motion determines. It is the number of base parameters if the
    motion excites all joints."""
    blocks: int
    """Number of time blocks of the jackknife; 1 if there are too few states, in which case intervals assume independent
    residuals."""
    states: int
    """Number of states."""
    clock_offset: float = float("nan")
    """Delay of the torques relative to q, s, estimated from the residuals; NaN without times."""

    @property
    def deviations(self) -> _Array:
        """Standard deviations of the parameters, (bodies, 10); zero for kept bodies.

        Parameters that the data do not determine have about the standard deviations of the prior.
        """
        return np.asarray(np.sqrt(np.sum(self.root**2, axis=2)))

    def interval(self, level: float = 0.95) -> tuple[_Array, _Array]:
        """Confidence intervals of the parameters.

        Parameters
        ----------
        level : float, default 0.95
            Probability that the interval contains the parameter.

        Returns
        -------
        lower, upper : (bodies, 10) ndarray
            Ends of the intervals.

        Raises
        ------
        ArgumentError
            A level that is not between 0 and 1.

        Notes
        -----
        The part of the variance that comes from the data has Student's distribution with blocks - 1 degrees of freedom
        (Welch and Satterthwaite). If `share` is below 0.9, the interval is the interval of the prior: it is valid on
        average over robots that are built like the model, not for each robot.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> found = scene.identify(q, qd, qdd, scene.inverse_dynamics(q, qd, qdd), noise=0.01)
        >>> lower, upper = found.interval(0.95)
        >>> lower.shape, bool((lower < upper).all())
        ((2, 10), True)
        """
        if not 0.0 < level < 1.0:
            raise of_argument(
                ArgumentError, "level", f"found {level}; expected a probability between 0 and 1, for instance 0.95"
            )
        with np.errstate(divide="ignore"):
            degrees = np.where(
                np.nan_to_num(self.share) > 0.0, max(self.blocks - 1, 1) / np.nan_to_num(self.share) ** 2, np.inf
            )
        if self.blocks < FEWEST_BLOCKS:
            degrees = np.full_like(degrees, np.inf)
        half = student_quantile(level, degrees) * self.deviations
        return self.parameters - half, self.parameters + half

    def torques(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> _Array:
        """Predict measured torques, with friction, offsets and the transmission.

        Parameters
        ----------
        q : (..., nq) array_like
            Joint positions, rad or m.
        qd : (..., nv) array_like
            Joint velocities, rad/s or m/s.
        qdd : (..., nv) array_like
            Joint accelerations, rad/s^2 or m/s^2.

        Returns
        -------
        torques : (..., motors) ndarray
            Motor torques, N m or N; without a transmission, joint torques.

        Raises
        ------
        ShapeError, NotFiniteError
            An invalid argument. The message names it.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> tau = scene.inverse_dynamics(q, qd, qdd)
        >>> found = scene.identify(q, qd, qdd, tau, noise=0.01)
        >>> bool(np.abs(found.torques(q, qd, qdd) - tau).max() < 0.01)
        True
        """
        q, qd, qdd = (
            np.asarray(_core._numbers(*one))
            for one in (("q", q, self.scene, True), ("qd", qd, self.scene), ("qdd", qdd, self.scene))
        )
        try:
            batch = np.broadcast_shapes(q.shape[:-1], qd.shape[:-1], qdd.shape[:-1])
        except ValueError:
            raise of_argument(
                ShapeError,
                "q",
                f"found leading axes {q.shape[:-1]}, {qd.shape[:-1]} and {qdd.shape[:-1]}; expected ones that"
                " broadcast",
            ) from None
        q, qd, qdd = (np.broadcast_to(one, (*batch, one.shape[-1])).reshape(-1, one.shape[-1]) for one in (q, qd, qdd))
        return predicted(self.columns, self.own, q, qd, qdd).reshape(*batch, -1)

    def undecided(self) -> list[tuple[str, str]]:
        """Parameters whose intervals are the intervals of the prior.

        Returns
        -------
        parameters : list of (str, str)
            Link and parameter, for instance ("link1", "m*cx").

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.scenes.chain(2)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
        >>> found = scene.identify(q, qd, qdd, scene.inverse_dynamics(q, qd, qdd), noise=0.01)
        >>> (scene.body_names[0], "m") in found.undecided()
        True
        """
        entries = ("m", "m*cx", "m*cy", "m*cz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
        names = self.scene.body_names
        return [(names[body], entries[entry]) for body, entry in np.argwhere(self.share < DECIDED)]

    def __str__(self) -> str:
        """Return a summary of a few lines."""
        decided, total = int(np.sum(self.share >= DECIDED)), int(np.sum(np.isfinite(self.share)))
        lines = [
            f"identification from {self.states} states: {self.known} combinations of parameters determined",
            (
                f"intervals by a jackknife of {self.blocks} blocks"
                if self.blocks >= FEWEST_BLOCKS
                else "intervals for independent residuals: too few states for a jackknife"
            ),
            (
                f"{decided} of {total} parameters of bodies are determined by the data; the intervals of the others are"
                " those of the prior"
            ),
        ]
        ratios = self.base.bias / self.base.deviations
        if np.isfinite(ratios).any():
            worst = float(np.nanmax(np.abs(ratios)))
            lines.append(f"predicted bias by noise in the accelerations: at most {worst:.2g} standard deviations")
        if np.isfinite(self.clock_offset):
            lines.append(f"torques are {1e3 * self.clock_offset:.3g} ms later than positions")
        return "\n".join(lines)


def predicted(columns: Columns, own: _Array, q: _Array, qd: _Array, qdd: _Array, chunk: int = 4096) -> _Array:
    """Motor torques for given parameters, (k, motors)."""
    found = np.empty((len(q), columns.motors))
    for begin in range(0, len(q), chunk):
        part = slice(begin, begin + chunk)
        rows, found[part] = columns.rows(q[part], qd[part], qdd[part])
        for motor, (block, used) in enumerate(zip(rows, columns.used, strict=True)):
            found[part, motor] += block @ own[used]
    return found


class _Rows(NamedTuple):
    """Least-squares problem of some rows: information left^T right, score left^T (y - right x).

    Without instruments, left equals right.
    """

    left: _Array
    right: _Array
    target: _Array


class _Problem:
    """Accumulated measurements, in coordinates z relative to the prior."""

    def __init__(self, accumulator: Accumulator, stacklevel: int) -> None:
        columns = accumulator.columns
        self.accumulator, self.columns = accumulator, columns
        self.blocks: list[Block] = _for_jackknife(accumulator)
        if not self.blocks:
            raise of_argument(ArgumentError, "q", "found no states; expected some (Accumulator.add)")
        self.counts = np.sum([block.counts for block in self.blocks], axis=0)
        if not self.counts.any():
            raise of_argument(ArgumentError, "tau", "found no measured torque: all are NaN; expected finite torques")
        self.whole = [
            merged_triangles([block.triangles[motor] for block in self.blocks]) for motor in range(columns.motors)
        ]
        matrices, self.model = prior_of_bodies(columns.scene, columns.free, stacklevel + 1)
        self.bodies = len(columns.free)
        scales, places, model = [], [], []
        for at, extra in enumerate(columns.extras, 10 * self.bodies):
            rows = list(extra.rows)
            moved = np.sqrt(sum(self._column_norm(motor, at) ** 2 for motor in rows))
            # The parameters of a motor at rest cannot be identified.
            if moved == 0.0:
                continue
            squares, count = float(np.sum(accumulator._squares[rows])), float(np.sum(self.counts[rows]))
            alone = np.sqrt(squares) / moved
            scale = (
                OFFSET * np.sqrt(squares / max(count, 1.0))
                if extra.kind in SIGNED
                else extra.model or SHARE * float(alone)
            )
            if scale == 0.0:
                continue
            signs = (1.0, -1.0) if extra.kind in SIGNED else (1.0,)
            scales += [sign * scale for sign in signs]
            places += [at] * len(signs)
            model += [extra.model / scale] if len(signs) == 1 else [1.0, 1.0]
        self.to_own = np.zeros((columns.width, 10 * self.bodies + len(scales)))
        for at, matrix in enumerate(matrices):
            self.to_own[10 * at : 10 * at + 10, 10 * at : 10 * at + 10] = matrix
        for z, (place, scale) in enumerate(zip(places, scales, strict=True), 10 * self.bodies):
            self.to_own[place, z] = scale
        self.fitted = sorted(set(places))
        self.model = np.append(self.model, model)
        if not self.to_own.shape[1]:
            raise of_argument(
                ArgumentError,
                "keep",
                "found all bodies, and no joint parameter that the motion determines; expected at least one parameter"
                " to identify",
            )
        self.projections = (
            [self._projection(motor) for motor in range(columns.motors)] if accumulator.instruments else None
        )

    def _column_norm(self, motor: int, column: int) -> float:
        used = self.columns.used[motor]
        (at,) = np.nonzero(used == column)
        first = len(used) if self.accumulator.instruments else 0
        return float(np.linalg.norm(self.whole[motor][:, first + at[0]])) if len(at) else 0.0

    def _plain(self, triangle: _Array, motor: int) -> _Array:
        """[W y] of a triangle, without instruments."""
        return triangle[:, len(self.columns.used[motor]) :] if self.accumulator.instruments else triangle

    def _projection(self, motor: int) -> _Array:
        """Least-squares coefficients of the columns in terms of the instruments."""
        size = len(self.columns.used[motor])
        triangle = self.whole[motor]
        instruments, columns = triangle[:, :size], triangle[:, size : 2 * size]
        norms = np.linalg.norm(instruments, axis=0)
        norms[norms == 0.0] = 1.0
        return np.asarray(np.linalg.lstsq(instruments / norms, columns, rcond=UNKNOWN)[0] / norms[:, None])

    def rows(self, triangles: list[_Array], weights: _Array) -> _Rows:
        """All rows divided by their standard deviations, in physical parameters."""
        lefts: list[_Array] = []
        rights: list[_Array] = []
        targets: list[_Array] = []
        for motor, (triangle, weight, used) in enumerate(zip(triangles, weights, self.columns.used, strict=True)):
            if not (self.counts[motor] and len(triangle)):
                continue
            plain = self._plain(triangle, motor) / weight
            left = (
                plain[:, :-1]
                if self.projections is None
                else triangle[:, : len(used)] @ self.projections[motor] / weight
            )
            for to, part in ((lefts, left), (rights, plain[:, :-1])):
                whole = np.zeros((len(plain), self.columns.width))
                whole[:, used] = part
                to.append(whole)
            targets.append(plain[:, -1])
        if not targets:
            empty = np.zeros((0, self.columns.width))
            return _Rows(empty, empty, np.zeros(0))
        return _Rows(np.concatenate(lefts), np.concatenate(rights), np.concatenate(targets))

    def least_squares(self, weights: _Array) -> tuple[_Array, _Array]:
        """Matrix A and vector b of min |b - A x|^2 in physical parameters; with instruments, two-stage least
        squares."""
        rows = self.rows(self.whole, weights)
        if self.projections is None:
            return rows.right, rows.target
        # left^T (y - right x) = 0, and left^T right = left^T left: b is the component of y in the span of the projected
        # columns.
        orthogonal, singular, right = np.linalg.svd(rows.left, full_matrices=False)
        keep = singular > UNKNOWN * singular.max(initial=0.0)
        return (singular[:, None] * right)[keep], orthogonal.T[keep] @ rows.target

    def residual(self, own: _Array) -> _Array:
        """Root mean square residual of each motor, (motors,); NaN for motors without measured torques."""
        norms = [
            np.linalg.norm(self._plain(triangle, motor) @ np.append(own[used], -1.0))
            for motor, (triangle, used) in enumerate(zip(self.whole, self.columns.used, strict=True))
        ]
        return self._mean(norms)

    def _mean(self, norms: list[Any]) -> _Array:
        return np.asarray(np.where(self.counts > 0, np.array(norms) / np.sqrt(np.maximum(self.counts, 1)), np.nan))

    def least(self) -> _Array:
        """Lower bound of the noise, (motors,): rounding error of the torques and of their terms."""
        own = self.to_own @ self.model
        norms = [
            np.linalg.norm(self._plain(triangle, motor) * np.append(own[used], 1.0))
            for motor, (triangle, used) in enumerate(zip(self.whole, self.columns.used, strict=True))
        ]
        found = ROUNDING * self._mean(norms)
        # A torque that does not depend on any parameter has the largest of the bounds.
        return np.where(found == 0.0, max(float(np.nanmax(found)), float(np.finfo(float).tiny)), found)

    def checked_noise(self, noise: ArrayLike) -> _Array:
        """Standard deviations given by the user, (motors,)."""
        found, motors = np.asarray(_core._numbers("noise", noise)), self.columns.motors
        if found.shape not in ((), (motors,)):
            raise of_argument(ShapeError, "noise", f"found shape {found.shape}; expected () or ({motors},)")
        if not (np.all(np.isfinite(found)) and np.all(found > 0.0)):
            raise of_argument(
                ArgumentError, "noise", f"found {found.min()}; expected finite standard deviations above zero"
            )
        found = np.array(np.broadcast_to(found, (motors,)))
        least = self.least()
        if np.any(below := found < least):
            at = int(np.argmax(below))
            message = (
                f"found {found[at]:g} at index {at}; expected at least {least[at]:.1e}, the rounding error of the"
                " torques"
            )
            raise of_argument(ArgumentError, "noise", message)
        return found

    def deviation(self) -> _Array:
        """Standard deviation of the torques, (motors,), from the residuals of unconstrained least squares.

        NaN for motors without measured torques.
        """
        least, measured = self.least(), int(np.sum(self.counts))
        if np.nanmax(least) <= np.finfo(float).tiny:
            message = (
                "found states at which no torque depends on any parameter, and torques of zero; expected states that"
                " move, or noise, the standard deviation of the torques"
            )
            raise of_argument(ArgumentError, "q", message)
        weights = np.where(self.counts > 0, 1.0, np.nan)
        for _ in range(2):
            rows, target = self.least_squares(weights)
            z, _, rank, _ = np.linalg.lstsq(rows @ self.to_own, target, rcond=UNKNOWN)
            if measured < 2 * rank:
                found = f"{measured} measured torques for {rank} combinations of parameters"
                raise of_argument(
                    ArgumentError,
                    "tau",
                    f"found {found}; expected at least {2 * rank}, or noise, their standard deviation",
                )
            weights = np.maximum(np.sqrt(measured / (measured - rank)) * self.residual(self.to_own @ z), least)
        return weights


def solved(
    accumulator: Accumulator,
    noise: ArrayLike | None,
    trust: float,
    *,
    stacklevel: int,
    clock_offset: float = float("nan"),
) -> Identification:
    """Identify the parameters from all states of an accumulator."""
    if not (np.isfinite(trust) and trust > 0.0):
        raise of_argument(ArgumentError, "trust", f"found {trust}; expected a finite number above zero")
    problem = _Problem(accumulator, stacklevel + 1)
    columns = problem.columns
    weights = problem.deviation() if noise is None else problem.checked_noise(noise)
    rows, target = problem.least_squares(weights)
    triangle = merged_triangles([np.column_stack([rows @ problem.to_own, target])])
    z, root = most_probable(triangle[:, :-1], triangle[:, -1], problem.bodies, trust)
    own = problem.to_own @ z
    # This call merges blocks that are too short.
    base = base_parameters(problem, weights)
    by_data, by_prior = _columns_of_covariance(problem, weights, own, root)
    parameters = columns.own.copy()
    full = np.zeros((len(parameters), 10, by_data.shape[1] + by_prior.shape[1]))
    share = np.full(parameters.shape, np.nan)
    for at, body in enumerate(columns.free):
        part = slice(10 * at, 10 * at + 10)
        parameters[body] = own[part]
        full[body] = np.concatenate([by_data[part], by_prior[part]], axis=1)
        share[body] = np.sum(by_data[part] ** 2, axis=1) / np.sum(full[body] ** 2, axis=1)
    joints: dict[str, dict[str, float]] = {kind: {} for kind in columns.fit}
    spread: dict[str, dict[str, float]] = {kind: {} for kind in columns.fit}
    for at in problem.fitted:
        extra = columns.extras[at - 10 * problem.bodies]
        joints[extra.kind][extra.name] = float(own[at])
        spread[extra.kind][extra.name] = float(np.sqrt(np.sum(by_data[at] ** 2) + np.sum(by_prior[at] ** 2)))
    singular = np.linalg.svd(triangle[:, :-1], compute_uv=False)
    blocks = len(problem.blocks) if len(problem.blocks) >= FEWEST_BLOCKS else 1
    found = Identification(
        columns,
        own,
        _scene(columns, parameters, joints, stacklevel + 1),
        parameters,
        _squared(full),
        full,
        share,
        joints,
        spread,
        base,
        weights,
        problem.residual(problem.to_own @ problem.model),
        problem.residual(own),
        int(np.sum(singular > UNKNOWN * singular[0])) if singular.size else 0,
        blocks,
        accumulator.states,
        clock_offset,
    )
    _warn_of_bias(found, stacklevel + 1)
    return found


def _squared(root: _Array) -> _Array:
    """Covariance L L^T of a root L, (bodies, 10, columns)."""
    flat = root.reshape(-1, root.shape[2])
    return np.asarray(flat @ flat.T)


def _warn_of_bias(found: Identification, stacklevel: int) -> None:
    with np.errstate(invalid="ignore"):
        ratios = np.abs(found.base.bias) / found.base.deviations
    if not np.isfinite(ratios).any() or float(np.nanmax(ratios)) <= BIAS:
        return
    worst = int(np.nanargmax(ratios))
    text = (
        f"acceleration_noise: predicts a bias of {ratios[worst]:.2g} standard deviations of"
        f" {found.base.names[worst]!r}, {int(np.sum(ratios > BIAS))} of {len(ratios)} above {BIAS}"
    )
    fix = "give instruments=(q, qd, qdd) of the commanded trajectory, or smooth with a lower cutoff"
    warnings.warn(f"{text}; {fix}", IdentificationWarning, stacklevel=stacklevel)


def _for_jackknife(accumulator: Accumulator) -> list[Block]:
    """Blocks of the accumulator, merged to about the requested number."""
    found = accumulator.blocks()
    while 2 * len(found) >= 3 * accumulator.wanted:
        found = _halved(found)
    return found


def _columns_of_covariance(problem: _Problem, weights: _Array, own: _Array, root: _Array) -> tuple[_Array, _Array]:
    """Columns of a root of the covariance of all parameters: from the data, and from the prior."""
    whole = problem.rows(problem.whole, weights)
    scaled = problem.to_own @ root
    left, right = whole.left @ scaled, whole.right @ scaled
    information = left.T @ (left if problem.projections is not None else right)
    values, vectors = np.linalg.eigh(information)
    # Share of the prior in the Hessian, which is the identity in these coordinates.
    by_prior = scaled @ vectors * np.sqrt(np.clip(1.0 - values, 0.0, 1.0))
    if len(problem.blocks) < FEWEST_BLOCKS:
        return scaled @ vectors * np.sqrt(np.clip(values, 0.0, 1.0)), by_prior
    moved: list[_Array] = []
    for block in problem.blocks:
        rows = problem.rows(block.triangles, weights)
        of_block = (rows.left @ scaled).T
        moved.append(
            np.asarray(
                np.linalg.solve(
                    np.eye(len(information)) - of_block @ (rows.right @ scaled),
                    of_block @ (rows.target - rows.right @ own),
                ),
                float,
            )
        )
    return scaled @ _jackknife(moved), by_prior


def _jackknife(moved: list[_Array]) -> _Array:
    """Columns of a root of the jackknife covariance, from the change of the estimate by deletion of each block."""
    changes = np.array(moved).T
    return np.asarray(np.sqrt((len(moved) - 1) / len(moved)) * (changes - changes.mean(axis=1, keepdims=True)))


def base_parameters(problem: _Problem, weights: _Array) -> BaseParameters:
    """Estimate base parameters by least squares, with their covariance and predicted bias."""
    columns = problem.columns
    found: Combinations = _combinations(columns)
    at, count = found.columns, len(found.columns)
    rows, target = problem.least_squares(weights)
    scale = np.linalg.norm(rows[:, at], axis=0)
    determined = scale > 0.0
    scale = np.where(determined, scale, 1.0)
    orthogonal, singular, right = np.linalg.svd(rows[:, at] / scale, full_matrices=False)
    kept = singular > UNKNOWN * singular.max(initial=0.0)
    # Whitening: the estimates are root @ orthogonal^T @ target.
    root: _Array = right[kept].T / singular[kept] / scale[:, None]
    determined &= np.sum(right[kept] ** 2, axis=0) > 1.0 - 1e-6
    values = root @ (orthogonal.T[kept] @ target)
    own = np.zeros(columns.width)
    own[at] = values

    def scores() -> Iterator[tuple[_Array, _Array, _Array]]:
        """Yield the whitened columns, left and right, and the score of each block."""
        for block in problem.blocks:
            part = problem.rows(block.triangles, weights)
            of_block = (part.left[:, at] @ root).T
            yield of_block, part.right[:, at] @ root, of_block @ (part.target - part.right @ own)

    torques = float(np.sum(problem.counts))
    while len(problem.blocks) >= 2 * FEWEST_LONG and (
        torques < ROWS * root.shape[1] * len(problem.blocks)
        or _correlation([score for _, _, score in scores()]) > CORRELATED
    ):
        problem.blocks = _halved(problem.blocks)
    moved: list[_Array] = []
    for of_block, right_of_block, score in scores():
        remaining = np.eye(root.shape[1]) - of_block @ right_of_block
        moved.append(np.asarray(np.linalg.lstsq(remaining, score, rcond=None)[0], float))
    by_data = root @ _jackknife(moved) if len(moved) >= FEWEST_BLOCKS else root
    covariance = by_data @ by_data.T
    covariance[~determined, ~determined] = np.inf
    model = columns.own[columns.free].ravel()
    model = found.matrix @ np.append(model, [extra.model for extra in columns.extras])
    names = columns.names()
    degrees = float(len(moved) - 1) if len(moved) >= FEWEST_BLOCKS else np.inf
    bias = (
        _bias(problem, weights, (at, root, values))
        if problem.accumulator.acceleration_noise is not None
        else np.full(count, np.nan)
    )
    return BaseParameters(
        tuple(names[i] for i in at), found.matrix, tuple(names), values, np.asarray(model), covariance, degrees, bias
    )


def _correlation(scores: list[_Array]) -> float:
    """Correlation of the scores of neighboring blocks; about -1 / blocks if they are independent."""
    all_scores = np.array(scores)
    total = float(np.sum(all_scores**2))
    return float(np.sum(all_scores[1:] * all_scores[:-1])) / total if total > 0.0 else 0.0


def _combinations(columns: Columns) -> Combinations:
    """Independent combinations of the columns; cached."""
    if "_combinations" not in columns.__dict__:
        columns.__dict__["_combinations"] = combinations(columns)
    found: Combinations = columns.__dict__["_combinations"]
    return found


def _bias(problem: _Problem, weights: _Array, estimate: tuple[NDArray[np.intp], _Array, _Array]) -> _Array:
    """Predicted bias of the base parameters, -(B + X)^-1 X x; zero with instruments.

    B is the information of the motion, and X is the information that acceleration noise adds. The measurements give B +
    X and the biased x' = (B + X)^-1 B x, so that the bias is -B^-1 X x'. The noise also affects torques that are not
    part of the columns, for instance the torques of known armatures.
    """
    at, root, values = estimate
    if problem.projections is not None:
        return np.zeros(len(at))
    parts = []
    for noise, weight, used, count in zip(
        problem.accumulator._noise, weights, problem.columns.used, problem.counts, strict=True
    ):
        if count and len(noise):
            whole = np.zeros((len(noise), problem.columns.width + 1))
            whole[:, np.append(used, problem.columns.width)] = noise / weight
            parts.append(whole[:, np.append(at, problem.columns.width)])
    if not parts:
        return np.zeros(len(at))
    changes = np.concatenate(parts)
    added, known = changes[:, :-1], changes[:, -1]
    scaled = added @ root
    return np.asarray(
        -root
        @ np.linalg.lstsq(np.eye(root.shape[1]) - scaled.T @ scaled, scaled.T @ (added @ values + known), rcond=None)[0]
    )


def _scene(columns: Columns, parameters: _Array, joints: dict[str, dict[str, float]], stacklevel: int) -> Scene:
    """Scene with the estimated parameters."""
    scene = with_parameters(columns.scene, columns.free, parameters)
    properties: dict[str, dict[str, float]] = {}
    omitted = []
    for extra in columns.extras:
        value = joints.get(extra.kind, {}).get(extra.name)
        if value is None or extra.kind not in PROPERTIES:
            continue
        if columns.transmission is None:
            properties.setdefault(extra.kind, {})[extra.name] = value
            continue
        row = columns.transmission[extra.rows[0]]
        (entries,) = np.nonzero(row)
        if len(entries) != 1:
            omitted.append(f"{extra.kind} of {extra.name}")
            continue
        joint = scene.joint_names[int(entries[0])]
        ratio = abs(float(row[entries[0]]))
        properties.setdefault(extra.kind, {})[joint] = value * (ratio if extra.kind == "friction" else ratio**2)
    if omitted:
        text = (
            f"transmission: a scene has no {', '.join(omitted)}, which acts on several joints; Identification.torques"
            " includes it, Identification.scene does not"
        )
        warnings.warn(text, IdentificationWarning, stacklevel=stacklevel)
    return scene.with_properties(**properties) if properties else scene
