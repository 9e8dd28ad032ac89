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

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..errors import ArgumentError, IdentificationWarning, PhipsiError, ShapeError, of_argument, warn
from ._accumulator import Accumulator, _halved, merged_triangles
from ._base import BaseParameters, Combinations, combinations
from ._bodies import with_parameters
from ._columns import PROPERTIES, Columns, per_joint
from ._faults import BEYOND, Clock, beyond_bodies, warn_of_bodies
from ._most_probable import most_probable
from ._problem import UNKNOWN, Problem
from ._student import student_quantile

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["Identification", "solved"]

_Array = NDArray[np.float64]

#: Share of the variance from the data below which the interval of a parameter is the interval of the prior; and the
#: bias, in standard deviations, above which a warning is raised.
DECIDED, BIAS = 0.9, 0.2
#: With fewer blocks, intervals assume independent residuals.
FEWEST_BLOCKS = 4
#: Neighboring blocks are merged if the correlation of their scores exceeds the first number, or if they have fewer
#: torques per parameter than the second, until the third number of blocks is reached.
CORRELATED, ROWS, FEWEST_LONG = 0.1, 2.0, 8
#: Weight of the prior with which it is checked whether possible bodies explain the torques.
FLAT = 1e-4


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
    clock_deviation: float = float("nan")
    """Standard deviation of `clock_offset`, s, by blocks of time; NaN without times."""

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
            spread = f"{1e3 * self.clock_offset:.3g} +- {1e3 * self.clock_deviation:.2g} ms"
            lines.append(f"torques are {spread} later than positions")
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


def solved(
    accumulator: Accumulator,
    noise: ArrayLike | None,
    trust: float,
    *,
    clock: Clock = Clock(float("nan"), float("nan")),
    check: bool = True,
) -> Identification:
    """Identify the parameters from all states of an accumulator."""
    if not (np.isfinite(trust) and trust > 0.0):
        raise of_argument(ArgumentError, "trust", f"found {trust}; expected a finite number above zero")
    problem = Problem(accumulator)
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
        _scene(columns, parameters, joints),
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
        clock.offset,
        clock.deviation,
    )
    if check:
        _check_bodies(problem, triangle, weights, found)
    _warn_of_bias(found)
    return found


def _squared(root: _Array) -> _Array:
    """Covariance L L^T of a root L, (bodies, 10, columns)."""
    flat = root.reshape(-1, root.shape[2])
    return np.asarray(flat @ flat.T)


def _check_bodies(problem: Problem, triangle: _Array, weights: _Array, found: Identification) -> None:
    """Warn if the residuals of possible bodies exceed those of least squares, with a prior of almost no weight."""
    independent = np.zeros(problem.columns.width)
    independent[_combinations(problem.columns).columns] = found.base.values
    free, after = problem.residual(independent), found.after
    if beyond_bodies(weights, free, after).max(initial=0.0) <= BEYOND:
        return
    try:
        z, _ = most_probable(triangle[:, :-1], triangle[:, -1], problem.bodies, FLAT)
        after = problem.residual(problem.to_own @ z)
    except PhipsiError:
        pass
    if (beyond := beyond_bodies(weights, free, after)).max(initial=0.0) > BEYOND:
        warn_of_bodies(problem.columns.motor_names, beyond, free, after)


def _warn_of_bias(found: Identification) -> None:
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
    warn(f"{text}; {fix}", IdentificationWarning)


def _columns_of_covariance(problem: Problem, weights: _Array, own: _Array, root: _Array) -> tuple[_Array, _Array]:
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


def base_parameters(problem: Problem, weights: _Array) -> BaseParameters:
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


def _bias(problem: Problem, weights: _Array, estimate: tuple[NDArray[np.intp], _Array, _Array]) -> _Array:
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


def _scene(columns: Columns, parameters: _Array, joints: dict[str, dict[str, float]]) -> Scene:
    """Scene with the estimated parameters."""
    scene = with_parameters(columns.scene, columns.free, parameters)
    properties: dict[str, dict[str, float]] = {}
    omitted = []
    for extra in columns.extras:
        value = joints.get(extra.kind, {}).get(extra.name)
        if value is None:
            continue
        joint, ratio, name = extra.name, 1.0, PROPERTIES[extra.kind]
        if columns.transmission is not None:
            row = columns.transmission[extra.rows[0]]
            (entries,) = np.nonzero(row)
            if len(entries) != 1:
                omitted.append(f"{extra.kind} of {extra.name}")
                continue
            joint, ratio = scene.joint_names[int(entries[0])], float(row[entries[0]])
        properties.setdefault(name, {})[joint] = value * per_joint(extra.kind, ratio)
        if extra.kind == "stribeck":
            properties.setdefault("stribeck_speed", {})[joint] = columns.stribeck / abs(ratio)
    if omitted:
        text = (
            f"transmission: a scene has no {', '.join(omitted)}, which acts on several joints; Identification.torques"
            " includes it, Identification.scene does not"
        )
        warn(text, IdentificationWarning)
    return scene.with_properties(**properties) if properties else scene
