"""Trajectories that excite the parameters: periodic Fourier series within limits, D-optimal."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from .._arguments import check_tree, names_of, numbers
from .._friction import opposing
from .._summary import summarized
from ..errors import ArgumentError, InertiaWarning, of_argument
from ._base import combinations
from ._bodies import prior_of_bodies
from ._columns import Columns
from ._values import each

if TYPE_CHECKING:
    from .._core import Scene
    from .._results import Limits

__all__ = ["Excitation", "excitation"]

_Array = NDArray[np.float64]

#: Half the range of a joint without position limits: angle, rad, and length, m.
ANGLE, LENGTH = 1.0, 0.2
#: Share of each limit that the trajectory uses, and number of states at which the search evaluates a candidate.
USED, SEARCHED = 0.9, 120
#: Standard deviations of the first and the last step of the search, relative to the amplitudes.
STEP = (0.5, 0.02)
#: Minimum share of the range that the motion covers.
LEAST = 1e-3
#: Largest number of samples of a trajectory, and smallest and largest noise whose square does not overflow or vanish.
MOST, NOISES = 10**8, (1e-100, 1e100)
#: Default noise of the torques, relative to the limits of effort.
NOISE = 0.01
#: Standard deviation of a parameter without a prior, SI units.
WIDE = 1e3


@summarized
class Excitation(NamedTuple):
    """Excitation trajectory, and predicted accuracy of the parameters. The initial velocity is not zero."""

    time: _Array
    """Times of one period, (k,), s."""
    q: _Array
    """Positions, (k, nv), rad or m."""
    qd: _Array
    """Velocities, (k, nv)."""
    qdd: _Array
    """Accelerations, (k, nv)."""
    tau: _Array
    """Torques of the model with friction, damping and springs, (k, nv)."""
    names: tuple[str, ...]
    """Names of the base parameters: for each, the parameter with the coefficient 1."""
    deviations: _Array
    """Predicted standard deviations of the base parameters, (base,), for independent noise at the times of the
    trajectory."""
    model: _Array
    """Base parameters of the model, (base,)."""
    condition: float
    """Condition number of the normalized columns."""
    improvement: float
    """Increase of the log-determinant of the information matrix, with the prior, by the search."""
    noise: _Array
    """Standard deviation of the torques, (nv,), N m or N: as given, or the default."""


def excitation(
    scene: Scene,
    duration: float,
    *,
    limits: Limits | None = None,
    harmonics: int = 5,
    fit: Collection[str] = (),
    noise: ArrayLike | None = None,
    rate: float = 100.0,
    iterations: int = 300,
    seed: int = 0,
) -> Excitation:
    """Implementation of Scene.excitation."""
    check_tree(scene, "excitation")
    for name, value in (("duration", duration), ("rate", rate)):
        if not (isinstance(value, (int, float, np.number)) and np.isfinite(value) and value > 0.0):
            raise of_argument(ArgumentError, name, f"found {value!r}; expected a finite number above zero")
    for name, count in (("harmonics", harmonics), ("iterations", iterations)):
        if not (isinstance(count, (int, np.integer)) and count >= 1):
            raise of_argument(ArgumentError, name, f"found {count!r}; expected a whole number, at least 1")
    if duration * rate > MOST:
        found = f"found {duration * rate:.3g} samples in all; expected at most {MOST:g}"
        raise of_argument(ArgumentError, "rate", found)
    if 2 * harmonics > duration * rate:
        raise of_argument(
            ArgumentError,
            "rate",
            f"found {rate:g} samples per second for a frequency of {harmonics / duration:g} Hz; expected more than"
            f" {2 * harmonics / duration:g}",
        )
    if scene.nq != scene.nv:
        raise of_argument(
            ArgumentError,
            "excitation",
            "found joints that are not of one axis; expected joints of one axis only (Scene.lock removes others)",
        )
    time, random = np.arange(round(duration * rate)) / rate, np.random.default_rng(seed)
    search = _Search(scene, (float(duration), len(time)), limits, int(harmonics), names_of(fit))
    start = search.start(random)
    deviation = _noise(scene, noise, search, start)
    best, gain = search.run(int(iterations), deviation, start, random)
    q, qd, qdd = search.motion(best, time)
    columns = search.columns
    tau = _torques(scene, (q, qd, qdd), qd / np.sqrt(qd**2 + columns.slow**2))
    matrix = search.matrix((q, qd, qdd), deviation)
    scale = np.linalg.norm(matrix, axis=0)
    singular, right = np.linalg.svd(matrix / scale, full_matrices=False)[1:]
    deviations = np.sqrt(np.sum((right / singular[:, None]) ** 2, axis=0)) / scale
    base, names = search.base, columns.names()
    model = base.matrix @ np.append(columns.own[columns.free].ravel(), [extra.model for extra in columns.extras])
    return Excitation(
        time,
        q,
        qd,
        qdd,
        tau,
        tuple(names[at] for at in base.columns),
        deviations,
        model,
        float(singular[0] / singular[-1]),
        gain,
        deviation,
    )


def _noise(scene: Scene, noise: ArrayLike | None, search: _Search, start: _Array) -> _Array:
    """Standard deviations of the torques, (nv,): given, or a share of the limits of effort, without limits of the
    torques of the first motion."""
    if noise is None:
        largest = np.max(np.abs(search.torques(start)), axis=0)
        unlimited = np.maximum(largest, 1e-6 * largest.max())
        return NOISE * np.where(np.isfinite(search.effort), search.effort / USED, unlimited)
    refused = "found {least}; expected finite standard deviations above zero"
    found = each("noise", np.asarray(_core._numbers("noise", noise)), scene.nv, refused, positive=True)
    if not np.all((found >= NOISES[0]) & (found <= NOISES[1])):
        raise of_argument(ArgumentError, "noise", f"found {found}; expected from {NOISES[0]:g} to {NOISES[1]:g}")
    return found


def _torques(scene: Scene, motion: tuple[_Array, _Array, _Array], direction: _Array) -> _Array:
    """Torques of the motors in a motion (q, qd, qdd), (k, nv), with damping, friction and springs."""
    q, qd, qdd = motion
    reaching = scene.inverse_dynamics(q, qd, qdd)
    springs = scene.stiffness * scene.difference(np.broadcast_to(scene.rest, q.shape), q)
    return np.asarray(reaching + scene.damping * qd + opposing(scene, qd, direction, reaching) + springs)


class _Search:
    """Random search over Fourier coefficients, scaled to satisfy the limits.

    The objective is Bayesian D-optimality, log det(1 + V^T V). The rows V are those of the whole trajectory, divided by
    the noise of the torques, for base parameters in coordinates in which their prior has unit covariance. The noise is
    the same for all motions, so that strong motion pays; the prior makes the determinant finite for parameters that a
    motion does not excite.
    """

    def __init__(
        self, scene: Scene, size: tuple[float, int], limits: Limits | None, harmonics: int, fit: tuple[str, ...]
    ) -> None:
        self.scene, (duration, self.samples) = scene, size
        #: Angular frequencies of the harmonics, times the imaginary unit.
        self.waves = 2j * np.pi / duration * np.arange(1, harmonics + 1)
        self.columns = Columns(scene, fit)
        self.base = combinations(self.columns)
        self.prior = _prior(self.columns, self.base.matrix)
        given = scene.limits if limits is None else limits
        try:
            lower, upper, effort, *rates = (
                np.broadcast_to(numbers(f"limits.{name}", getattr(given, name)), (scene.nv,))
                for name in ("lower", "upper", "effort", "velocity", "acceleration", "deceleration", "jerk")
            )
        except (AttributeError, ValueError):
            raise of_argument(
                ArgumentError, "limits", f"found {limits!r}; expected phipsi.Limits(lower, upper, ...), each (nv,)"
            ) from None
        half = np.array([LENGTH if scene.joints[name].type == "prismatic" else ANGLE for name in scene.joint_names])
        low = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper - 2.0 * half, -half))
        high = np.where(np.isfinite(upper), upper, low + 2.0 * half)
        room = (high > low) & (effort > 0.0) & np.all([limit > 0.0 for limit in rates], axis=0)
        if not room.all():
            raise of_argument(
                ArgumentError,
                "limits",
                f"found no room for joint {scene.joint_names[int(np.argmin(room))]!r}; expected lower < upper, and the"
                " others above zero",
            )
        velocity, acceleration, deceleration, jerk = rates
        self.middle, self.half, self.effort = 0.5 * (low + high), 0.5 * USED * (high - low), USED * effort
        #: Limits of the first three derivatives of the positions.
        self.rates = USED * np.stack([velocity, np.minimum(acceleration, deceleration), jerk])
        self.times = np.arange(SEARCHED) / SEARCHED * duration
        held = np.abs(self.torques(np.zeros((2 * harmonics + 1, scene.nv)))).max(axis=0) / self.effort
        if np.any(held > 1.0):
            raise of_argument(
                ArgumentError,
                "limits",
                f"found too little torque for joint {scene.joint_names[int(np.argmax(held))]!r} to hold the middle of"
                " its range; expected more effort, or a range around another position",
            )

    def motion(self, coefficients: _Array, time: _Array, derivatives: int = 2) -> list[_Array]:
        """Positions and their derivatives. Coefficients are relative to half the range: for each joint the offset,
        then the sine and the cosine of each harmonic, (2 harmonics + 1, nv)."""
        waves, amplitudes = np.exp(np.outer(time, self.waves)), coefficients[2::2] - 1j * coefficients[1::2]
        found = [(waves * self.waves**order @ amplitudes).real * self.half for order in range(derivatives + 1)]
        found[0] += self.middle + self.half * coefficients[0]
        return found

    def torques(self, coefficients: _Array) -> _Array:
        q, qd, qdd = self.motion(coefficients, self.times)
        return _torques(self.scene, (q, qd, qdd), np.sign(qd))

    def fitted(self, coefficients: _Array) -> _Array:
        """Scale each joint to satisfy the limits of its position and derivatives; then scale all joints to satisfy
        those of the torques."""
        found = coefficients.copy()
        found[0] = np.clip(found[0], -0.5, 0.5)
        q, *rates = self.motion(found, self.times, 3)
        waves = np.abs(q - self.middle - self.half * found[0]).max(axis=0)
        scales = [limit / np.abs(rate).max(axis=0) for limit, rate in zip(self.rates, rates, strict=True)]
        found[1:] *= np.min([self.half * (1.0 - np.abs(found[0])) / waves, *scales], axis=0)
        if self._allowed(found):
            return found
        low, high = 0.0, 1.0
        for _ in range(20):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._allowed(middle * found) else (low, middle)
        if low < LEAST:
            moved = np.abs(self.torques(LEAST * found)).max(axis=0)
            joint = self.scene.joint_names[int(np.argmax(moved / self.effort))]
            raise of_argument(
                ArgumentError,
                "limits",
                f"found too little torque for joint {joint!r} to move: {moved.max():.3g} needed; expected more effort,"
                " or a range around another position",
            )
        return np.asarray(low * found)

    def _allowed(self, coefficients: _Array) -> bool:
        """Return whether torques are within limits."""
        return bool(np.all(np.abs(self.torques(coefficients)) <= self.effort))

    def matrix(self, motion: Sequence[_Array], noise: _Array) -> _Array:
        """Independent columns at all states, divided by the noise."""
        rows, _ = self.columns.rows(*motion)
        found = np.zeros((self.scene.nv, len(motion[0]), self.columns.width))
        for motor, (block, used) in enumerate(zip(rows, self.columns.used, strict=True)):
            found[motor][:, used] = block / noise[motor]
        return np.asarray(found.reshape(-1, self.columns.width)[:, self.base.columns])

    def value(self, coefficients: _Array, noise: _Array) -> float:
        """Log-determinant of the information matrix of the trajectory and the prior, relative to that of the prior."""
        # Each state of the search stands for several samples of the trajectory.
        each = np.sqrt(SEARCHED / self.samples) * noise
        rows = self.matrix(self.motion(coefficients, self.times), each) @ self.prior
        return float(np.linalg.slogdet(np.eye(rows.shape[1]) + rows.T @ rows)[1])

    def start(self, random: np.random.Generator) -> _Array:
        """Random coefficients within the limits."""
        return self.fitted(random.standard_normal((2 * len(self.waves) + 1, self.scene.nv)))

    def run(self, iterations: int, noise: _Array, best: _Array, random: np.random.Generator) -> tuple[_Array, float]:
        """Best coefficients of a random search with decreasing steps, and the increase over the start."""
        first = value = self.value(best, noise)
        for at in range(iterations):
            size = STEP[0] * (STEP[1] / STEP[0]) ** (at / iterations)
            step = size * random.standard_normal(best.shape)
            # Every second step changes only one joint.
            if at % 2:
                only = np.zeros(self.scene.nv)
                only[random.integers(self.scene.nv)] = 1.0
                step = step * only
            tried = self.fitted(best + step)
            if (found := self.value(tried, noise)) > value:
                best, value = tried, found
        return best, value - first


def _prior(columns: Columns, base: _Array) -> _Array:
    """Root L of the prior covariance L L^T of the base parameters, (base, base), as in Scene.identify; without a prior
    for bodies without mass and joint parameters that the scene lacks."""
    width = columns.width
    root = np.zeros((width, width))
    for at, body in enumerate(columns.free):
        part = slice(10 * at, 10 * at + 10)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InertiaWarning)
            try:
                root[part, part] = prior_of_bodies(columns.scene, [body])[0][0]
            except ArgumentError:
                root[part, part] = WIDE * np.eye(10)
    for at, extra in enumerate(columns.extras, 10 * len(columns.free)):
        root[at, at] = extra.model or WIDE
    # The Hessian of the prior is 1/2 in these coordinates.
    return np.asarray(np.linalg.qr(np.sqrt(2.0) * (base @ root).T)[1].T)
