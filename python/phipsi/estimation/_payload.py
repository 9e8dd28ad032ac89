"""The load of a link from a log with and a log without it, and the gains of drives from a known load.

The columns of a load on link l are those of the link itself, W_l. With the parameters x of the robot and p of the load,

    y1 = W1 x                 torques without the load,
    y2 = W2 x + W2_l p        torques with it.

Least squares of both logs together estimates x and p. Errors of the model that are the same in both logs cancel in p:
any error of the inertias, which are part of x, and, if the motion of both logs is the same, also errors that no x
explains, because p then depends on y2 - y1 alone. The jackknife deletes blocks of both logs in pairs, so that errors
that cancel in the estimate also cancel in its covariance.

With currents c instead of torques and a known load p, the current of a motor with the gain g (N m/A) is

    c1 = W1 x',    c2 = W2 x' + (1/g) W2_l p,    x' = x/g,

with other x' for each motor. The noise is in c alone, so that 1/g is unbiased; a log alone determines x' and no gain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ArgumentError, of_argument
from ._accumulator import Block, _halved, _joined, merged_triangles
from ._bodies import bodies_of, to_moments, to_parameters
from ._identification import CORRELATED, FEWEST_BLOCKS, FEWEST_LONG, _combinations, _correlation, _jackknife
from ._problem import UNKNOWN, Problem
from ._student import student_quantile

if TYPE_CHECKING:
    from .._core import Scene
    from ._accumulator import Accumulator

__all__ = ["DriveGains", "Payload", "identify_gains", "identify_payload"]

_Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Payload:
    """Load of a link, estimated from the difference of two logs, without a prior."""

    link: str
    """Link that carries the load."""
    parameters: _Array
    """(m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz), (10,), in the frame of the link, I about its origin; NaN for
    those that the motion does not determine."""
    covariance: _Array
    """Covariance of the parameters, (10, 10), from the errors of both logs; infinite variances for those that the
    motion does not determine."""
    blocks: int
    """Number of pairs of blocks of the jackknife."""

    @property
    def mass(self) -> float:
        """Mass, kg."""
        return float(self.parameters[0])

    @property
    def com(self) -> _Array:
        """Center of mass, (3,), m, in the frame of the link, as in Scene.with_payload."""
        return np.asarray(self.parameters[1:4] / self.parameters[0])

    @property
    def inertia(self) -> _Array:
        """Inertia about the center of mass in the axes of the link, (3, 3), kg m^2, as in Scene.with_payload.

        No body has it if its errors are larger than itself, as those of a small load: compare `deviations`.
        """
        moments, com = to_moments(self.parameters), self.com
        sigma = moments[:3, :3] - self.mass * np.outer(com, com)
        return np.asarray(np.trace(sigma) * np.eye(3) - sigma)

    @property
    def deviations(self) -> _Array:
        """Standard deviations of the parameters, (10,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def interval(self, level: float = 0.95) -> tuple[_Array, _Array]:
        """Confidence intervals of the parameters.

        Parameters
        ----------
        level : float, default 0.95
            Probability that the interval contains the parameter.

        Returns
        -------
        lower, upper : (10,) ndarray
            Ends of the intervals.

        Raises
        ------
        ArgumentError
            A level that is not between 0 and 1.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> from phipsi.estimation import Accumulator
        >>> scene = phipsi.scenes.chain(3)
        >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 200, 3))
        >>> tau = [one.inverse_dynamics(q, qd, qdd) for one in (scene, scene.with_payload(scene.body_names[2], 0.5))]
        >>> empty, loaded = (Accumulator(scene, block_length=10).add(q, qd, qdd, one) for one in tau)
        >>> lower, upper = loaded.identify_payload(scene.body_names[2], without=empty).interval()
        >>> lower.shape
        (10,)
        """
        half = student_quantile(level, self.blocks - 1.0) * self.deviations
        return self.parameters - half, self.parameters + half


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Torque per current of each motor, from logs of currents with and without a known load."""

    names: tuple[str, ...]
    """Motors."""
    gains: _Array
    """Gains, (motors,), N m/A or N/A; NaN for motors on whose currents the load has no effect, and without currents."""
    deviations: _Array
    """Standard deviations of the gains, (motors,); infinite for motors without gain."""
    blocks: int
    """Number of pairs of blocks of the jackknife."""

    def interval(self, level: float = 0.95) -> tuple[_Array, _Array]:
        """Confidence intervals of the gains.

        Parameters
        ----------
        level : float, default 0.95
            Probability that the interval contains the gain.

        Returns
        -------
        lower, upper : (motors,) ndarray
            Ends of the intervals: those of 1/gain, which is what the data determine linearly. (-inf, inf) if that
            interval contains zero.

        Raises
        ------
        ArgumentError
            A level that is not between 0 and 1.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> from phipsi.estimation import Accumulator
        >>> scene = phipsi.scenes.chain(3)
        >>> link, com, draw = scene.body_names[2], (0.1, 0.0, 0.2), np.random.default_rng(0)
        >>> q, qd, qdd = draw.normal(size=(3, 200, 3))
        >>> torques = [one.inverse_dynamics(q, qd, qdd) for one in (scene, scene.with_payload(link, 2.0, com))]
        >>> empty, loaded = (Accumulator(scene, block_length=10).add(q, qd, qdd, one / 8.0) for one in torques)
        >>> lower, upper = loaded.identify_gains(link, 2.0, com, without=empty).interval()
        >>> lower.shape
        (3,)
        """
        inverse = 1.0 / self.gains
        half = student_quantile(level, self.blocks - 1.0) * self.deviations / self.gains**2
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = 1.0 / (inverse + half), 1.0 / (inverse - half)
        known = np.abs(inverse) > half
        return np.where(known, ends[0], -np.inf), np.where(known, ends[1], np.inf)


def identify_payload(
    loaded: Accumulator, link: str, without: Accumulator, noise: ArrayLike | None = None
) -> Payload:
    """Implementation of Accumulator.identify_payload."""
    pair = _Pair(loaded, without, link)
    if noise is None:
        # One standard deviation for both logs: otherwise errors of the model do not cancel.
        both = [problem.deviation() ** 2 for problem in pair.problems]
        counts = [problem.counts for problem in pair.problems]
        total = sum(np.where(n > 0, n * one, 0.0) for n, one in zip(counts, both, strict=True))
        weights = np.sqrt(total / np.maximum(np.sum(counts, axis=0), 1))
    else:
        weights = pair.problems[0].checked_noise(noise)
    place = pair.place
    # From the frame of the link to that of the body that it is fixed to.
    to_body = np.array([to_parameters(place @ to_moments(unit) @ place.T) for unit in np.eye(10)]).T
    values, root, determined, blocks = pair.least_squares(weights, pair.selected @ to_body)
    covariance = root @ root.T
    covariance[~determined, ~determined] = np.inf
    return Payload(link, np.where(determined, values, np.nan), covariance, blocks)


def identify_gains(
    loaded: Accumulator, load: tuple[str, float, ArrayLike, ArrayLike | None], without: Accumulator
) -> DriveGains:
    """Implementation of Accumulator.identify_gains."""
    pair, columns = _Pair(loaded, without, load[0]), loaded.columns
    if columns.connected:
        found = "found a scene with connections, which mix the torques of all motors"
        raise of_argument(ArgumentError, "without", f"{found}; expected a scene without")
    _check_homogeneous(columns.scene, columns.fit, columns.keep)
    scene = columns.scene
    changed = (scene.with_payload(*load[:3], inertia=load[3]).inertial_parameters - scene.inertial_parameters)[pair.body]
    inverse, deviations, blocks = *np.full((2, columns.motors), np.nan), 0
    for motor in range(columns.motors):
        if not all(problem.counts[motor] for problem in pair.problems):
            continue
        column = (pair.selected @ changed)[:, None]
        values, root, determined, blocks = pair.least_squares(np.ones(columns.motors), column, motor)
        if determined[0]:
            inverse[motor], deviations[motor] = values[0], np.linalg.norm(root[0])
    with np.errstate(divide="ignore"):
        gains = 1.0 / inverse
        spread = np.where(np.isfinite(inverse), deviations * gains**2, np.inf)
    return DriveGains(tuple(columns.motor_names), gains, spread, blocks)


def _check_homogeneous(scene: Scene, fit: tuple[str, ...], keep: tuple[str, ...]) -> None:
    """Raise ArgumentError for known torques, which currents do not contain in a known proportion."""
    if keep:
        expected = "expected none: the scale of currents is not known"
        raise of_argument(ArgumentError, "keep", f"found {keep[0]!r}; {expected}")
    for name in ("armature", "damping", "friction", "stiffness"):
        if name not in fit and np.any(getattr(scene, name)):
            other = f"expected {name!r} in fit" if name != "stiffness" else "expected a scene without springs"
            raise of_argument(ArgumentError, "fit", f"found {name} of the scene, which is not fitted; {other}")
    for name, values in zip(("offset", "stribeck"), scene.friction_terms[:2], strict=True):
        if name not in fit and np.any(values):
            found = f"found {name} of the scene, which is not fitted"
            raise of_argument(ArgumentError, "fit", f"{found}; expected {name!r} in fit")


class _Pair:
    """Two logs of the same columns, in pairs of blocks of time."""

    def __init__(self, loaded: Accumulator, without: Accumulator, link: str) -> None:
        columns = loaded.columns
        if not (hasattr(without, "columns") and columns.same_as(without.columns)):
            found = "found an accumulator of other columns"
            expected = "expected the same scene, fit, keep and transmission"
            raise of_argument(ArgumentError, "without", f"{found}; {expected}")
        if loaded.instruments or without.instruments:
            raise of_argument(ArgumentError, "instruments", "found accumulators with instruments; expected none")
        scene = columns.scene
        if "load" in columns.fit or np.any(scene.friction_terms[3]):
            found = "found friction by load, which changes with the load"
            raise of_argument(ArgumentError, "fit", f"{found}; expected friction of other kinds")
        body = bodies_of(scene).get(link)
        if body is None:
            found = f"found {link!r}, which does not move" if link in scene.link_names else f"found {link!r}"
            raise of_argument(ArgumentError, "link", f"{found}; expected a link of {', '.join(scene.body_names)}")
        self.body = scene.body_names.index(body)
        if self.body not in columns.free:
            found = f"found {link!r} on {body!r}, a link in keep"
            raise of_argument(ArgumentError, "link", f"{found}; expected a link that is identified")
        places = scene.placements(scene.neutral())
        #: Pose of the link in the frame of the body.
        self.place = np.linalg.solve(places[body], places[link])
        #: From the parameters of the body to all columns.
        self.selected = np.zeros((columns.width, 10))
        first = 10 * columns.free.index(self.body)
        self.selected[first : first + 10] = np.eye(10)
        self.at = _combinations(columns).columns
        self.problems = (Problem(without), Problem(loaded))
        count = min(len(problem.blocks) for problem in self.problems)
        if count < FEWEST_BLOCKS:
            found = f"found logs of {count} blocks of time"
            expected = f"expected at least {FEWEST_BLOCKS}: more states, or a smaller block_length"
            raise of_argument(ArgumentError, "without", f"{found}; {expected}")
        self.blocks = [_merged(problem.blocks, count) for problem in self.problems]

    def rows(
        self, triangles: list[list[_Array]], weights: _Array, added: _Array, only: int | None
    ) -> tuple[_Array, _Array]:
        """Rows [W1 0; W2 W2 added] of the independent columns of the robot and of the load, and torques."""
        parts, targets = [], []
        for share, problem, own in zip((0.0, 1.0), self.problems, triangles, strict=True):
            rows = problem.rows(own, weights, only)
            parts.append(np.concatenate([rows.right[:, self.at], share * rows.right @ added], axis=1))
            targets.append(rows.target)
        return np.concatenate(parts), np.concatenate(targets)

    def least_squares(
        self, weights: _Array, added: _Array, only: int | None = None
    ) -> tuple[_Array, _Array, NDArray[np.bool_], int]:
        """Estimates of the load, a root of their covariance, which of them are determined, and the number of blocks."""
        whole = self.rows([problem.whole for problem in self.problems], weights, added, only)
        triangle = merged_triangles([np.column_stack(whole)])
        rows, target = triangle[:, :-1], triangle[:, -1]
        scale = np.linalg.norm(rows, axis=0)
        scale[scale == 0.0] = 1.0
        orthogonal, singular, right = np.linalg.svd(rows / scale, full_matrices=False)
        kept = singular > UNKNOWN * singular.max(initial=0.0)
        root = right[kept].T / singular[kept] / scale[:, None]
        values = root @ (orthogonal.T[kept] @ target)
        determined = np.sum(right[kept] ** 2, axis=0) > 1.0 - 1e-6
        blocks = self.blocks

        def of_blocks() -> list[tuple[_Array, _Array]]:
            """Whitened information and score of each pair of blocks."""
            found = []
            for pair in zip(*blocks, strict=True):
                part, torques = self.rows([one.triangles for one in pair], weights, added, only)
                white = part @ root
                found.append((white.T @ white, white.T @ (torques - part @ values)))
            return found

        while len(blocks[0]) >= 2 * FEWEST_LONG and _correlation([score for _, score in of_blocks()]) > CORRELATED:
            blocks = [_halved(one) for one in blocks]
        one = np.eye(root.shape[1])
        moved = [np.asarray(np.linalg.lstsq(one - own, score, rcond=None)[0], float) for own, score in of_blocks()]
        own = slice(len(self.at), None)
        return values[own], root[own] @ _jackknife(moved), determined[own], len(moved)


def _merged(blocks: list[Block], count: int) -> list[Block]:
    """Blocks, merged to that number."""
    found = []
    for part in np.array_split(np.arange(len(blocks)), count):
        block = blocks[part[0]]
        for at in part[1:]:
            block = _joined(block, blocks[at])
        found.append(block)
    return found
