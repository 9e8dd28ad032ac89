"""Trajectories that excite the parameters: periodic Fourier series within limits, D-optimal."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from .._arguments import check_tree, names_of, numbers
from .._friction import opposing
from ..errors import ArgumentError, ShapeError, of_argument
from ._base import combinations
from ._columns import Columns

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
#: Default noise of the torques, relative to the largest torque.
NOISE = 0.01


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
    """Increase of the log-determinant of the information matrix by the search."""


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
        raise of_argument(ArgumentError, "rate", f"found {duration * rate:.3g} samples in all; expected at most {MOST:g}")
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
    search = _Search(scene, float(duration), limits, int(harmonics), names_of(fit))
    best, gain = search.run(int(iterations), np.random.default_rng(seed))
    time = np.arange(round(duration * rate)) / rate
    q, qd, qdd = search.motion(best, time)
    columns = search.columns
    tau = _torques(scene, (q, qd, qdd), qd / np.sqrt(qd**2 + columns.slow**2))
    largest = np.max(np.abs(tau), axis=0)
    deviation = (
        NOISE * np.maximum(largest, 1e-6 * largest.max())
        if noise is None
        else np.asarray(_core._numbers("noise", noise))
    )
    if deviation.shape not in ((), (scene.nv,)) or not np.all(deviation > 0.0):
        raise of_argument(
            ShapeError, "noise", f"found shape {deviation.shape}; expected () or ({scene.nv},), above zero"
        )
    if not np.all((deviation >= NOISES[0]) & (deviation <= NOISES[1])):
        raise of_argument(ArgumentError, "noise", f"found {deviation}; expected from {NOISES[0]:g} to {NOISES[1]:g}")
    matrix = search.matrix(q, qd, qdd, np.broadcast_to(deviation, (scene.nv,)))
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
    )


def _torques(scene: Scene, motion: tuple[_Array, _Array, _Array], direction: _Array) -> _Array:
    """Torques of the motors in a motion (q, qd, qdd), (k, nv), with damping, friction and springs."""
    q, qd, qdd = motion
    reaching = scene.inverse_dynamics(q, qd, qdd)
    springs = scene.stiffness * scene.difference(np.broadcast_to(scene.rest, q.shape), q)
    return np.asarray(reaching + scene.damping * qd + opposing(scene, qd, direction, reaching) + springs)


class _Search:
    """Random search over Fourier coefficients, scaled to satisfy the limits."""

    def __init__(
        self, scene: Scene, duration: float, limits: Limits | None, harmonics: int, fit: tuple[str, ...]
    ) -> None:
        self.scene, self.harmonics, self.frequency = scene, harmonics, 2.0 * np.pi / duration
        self.columns = Columns(scene, fit)
        self.base = combinations(self.columns)
        given = scene.limits if limits is None else limits
        try:
            lower, upper, velocity, effort = (
                np.broadcast_to(numbers(f"limits.{name}", getattr(given, name)), (scene.nv,))
                for name in ("lower", "upper", "velocity", "effort")
            )
        except (AttributeError, ValueError):
            raise of_argument(
                ArgumentError,
                "limits",
                f"found {limits!r}; expected phipsi.Limits(lower, upper, velocity, effort), each (nv,)",
            ) from None
        half = np.array([LENGTH if scene.joints[name].type == "prismatic" else ANGLE for name in scene.joint_names])
        low = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper - 2.0 * half, -half))
        high = np.where(np.isfinite(upper), upper, low + 2.0 * half)
        room = (high > low) & (velocity > 0.0) & (effort > 0.0)
        if not room.all():
            raise of_argument(
                ArgumentError,
                "limits",
                f"found no room for joint {scene.joint_names[int(np.argmin(room))]!r}; expected lower < upper, velocity"
                " and effort above zero",
            )
        self.middle, self.half = 0.5 * (low + high), 0.5 * USED * (high - low)
        self.velocity, self.effort = USED * velocity, USED * effort
        self.times = np.arange(SEARCHED) / SEARCHED * duration
        if np.any(np.abs(self._torques(*self.motion(np.zeros(self._shape()), self.times))) > self.effort):
            found = np.max(
                np.abs(self._torques(*self.motion(np.zeros(self._shape()), self.times))) / self.effort, axis=0
            )
            joint = scene.joint_names[int(np.argmax(found))]
            raise of_argument(
                ArgumentError,
                "limits",
                f"found too little torque for joint {joint!r} to hold the middle of its range; expected more effort, or"
                " a range around another position",
            )

    def _shape(self) -> tuple[int, int]:
        """Shape of the coefficients: for each joint the offset, then the sine and the cosine of each harmonic."""
        return (2 * self.harmonics + 1, self.scene.nv)

    def motion(self, coefficients: _Array, time: _Array) -> tuple[_Array, _Array, _Array]:
        """Positions, velocities and accelerations. Coefficients are amplitudes relative to half the range."""
        found = [
            np.tile(self.middle + self.half * coefficients[0], (len(time), 1)),
            np.zeros((len(time), self.scene.nv)),
            np.zeros((len(time), self.scene.nv)),
        ]
        for harmonic in range(1, self.harmonics + 1):
            w = harmonic * self.frequency
            s, c = np.sin(w * time)[:, None], np.cos(w * time)[:, None]
            a, b = (self.half * coefficients[at] for at in (2 * harmonic - 1, 2 * harmonic))
            found[0] = found[0] + a * s + b * c
            found[1] = found[1] + w * (a * c - b * s)
            found[2] = found[2] - w * w * (a * s + b * c)
        return found[0], found[1], found[2]

    def _torques(self, q: _Array, qd: _Array, qdd: _Array) -> _Array:
        return _torques(self.scene, (q, qd, qdd), np.sign(qd))

    def fitted(self, coefficients: _Array) -> _Array:
        """Scale each joint to satisfy position and velocity limits; then scale all joints to satisfy torque limits."""
        found = coefficients.copy()
        found[0] = np.clip(found[0], -0.5, 0.5)
        q, qd, _ = self.motion(found, self.times)
        waves = np.abs(q - self.middle - self.half * found[0]).max(axis=0)
        room = self.half * (1.0 - np.abs(found[0]))
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.fmin(1.0, np.fmin(room / waves, self.velocity / np.abs(qd).max(axis=0)))
        found[1:] *= scale
        if self._allowed(found):
            return found
        low, high = 0.0, 1.0
        for _ in range(20):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._allowed(middle * found) else (low, middle)
        if low < LEAST:
            moved = np.abs(self._torques(*self.motion(LEAST * found, self.times))).max(axis=0)
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
        return bool(np.all(np.abs(self._torques(*self.motion(coefficients, self.times))) <= self.effort))

    def matrix(self, q: _Array, qd: _Array, qdd: _Array, deviation: _Array) -> _Array:
        """Independent columns at all states, divided by the noise."""
        rows, _ = self.columns.rows(q, qd, qdd)
        found = np.zeros((self.scene.nv, len(q), self.columns.width))
        for motor, (block, used) in enumerate(zip(rows, self.columns.used, strict=True)):
            found[motor][:, used] = block / deviation[motor]
        return np.asarray(found.reshape(-1, self.columns.width)[:, self.base.columns])

    def value(self, coefficients: _Array) -> float:
        """Log-determinant of the information matrix."""
        q, qd, qdd = self.motion(coefficients, self.times)
        torques = self._torques(q, qd, qdd)
        largest = np.abs(torques).max(axis=0)
        singular = np.linalg.svd(
            self.matrix(q, qd, qdd, np.maximum(largest, 1e-6 * largest.max(initial=1e-300))), compute_uv=False
        )
        return float(2.0 * np.sum(np.log(np.maximum(singular, 1e-300))))

    def run(self, iterations: int, random: np.random.Generator) -> tuple[_Array, float]:
        """Best coefficients of a random search with decreasing steps, and the increase over the start."""
        best = self.fitted(random.standard_normal(self._shape()) / np.sqrt(self.harmonics))
        first = value = self.value(best)
        for at in range(iterations):
            size = STEP[0] * (STEP[1] / STEP[0]) ** (at / iterations)
            step = size * random.standard_normal(self._shape())
            # Every second step changes only one joint.
            if at % 2:
                only = np.zeros(self.scene.nv)
                only[random.integers(self.scene.nv)] = 1.0
                step = step * only
            tried = self.fitted(best + step)
            if (found := self.value(tried)) > value:
                best, value = tried, found
        return best, value - first
