"""Velocities and accelerations from a log of positions, by smoothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from .._summary import summarized
from ..errors import ArgumentError, LogWarning, ShapeError, of_argument, warn
from ._checks import checked_time
from ._values import each

__all__ = ["Smoothed", "smooth"]

_Array = NDArray[np.float64]

#: Number of samples for the estimation of noise and bandwidth, and number of pieces of the log that they are taken
#: from.
SAMPLED, PIECES = 8000, 4
#: Initial standard deviations relative to the largest differences and to the noise, large enough to have no weight.
WIDE = 1e3
#: Smallest range of positions, relative to the largest one or to 1 rad or m: the scale of a joint at rest.
REST = 1e-12
#: Inverse of the largest number of encoder steps per change that counts as a multiple of the step.
WHOLE = 1e-3
#: Number of innovations per piece that depend on its initial state.
START = 2
#: Distance from the ends of the log, in periods of the bandwidth, within which residuals contain signal.
ENDS = 1.5
#: Steps of the search for the bandwidth.
STEPS = 40


@summarized
@dataclass(frozen=True, eq=False)
class Smoothed:
    """Smoothed positions, velocities and accelerations, with their uncertainty."""

    time: _Array
    """Times, (k,), s."""
    q: _Array
    """Positions, (k, n)."""
    qd: _Array
    """Velocities, (k, n)."""
    qdd: _Array
    """Accelerations, (k, n)."""
    variances: _Array
    """Variances of q, qd and qdd, (3, k, n), from remaining noise and attenuated signal."""
    noise: _Array
    """Standard deviation of the noise in the measured positions, (n,), given or estimated."""
    cutoff: _Array
    """Frequency above which the smoother attenuates, (n,), Hz."""
    acceleration_noise: _Array
    """Standard deviation of the noise in the accelerations, (n,): the `acceleration_noise` of Scene.identify."""


def smooth(
    time: ArrayLike, q: ArrayLike, *, noise: ArrayLike | None = None, cutoff: ArrayLike | None = None
) -> Smoothed:
    """Compute velocities and accelerations from measured positions, by a quintic smoothing spline.

    In the middle of a long uniform log, the smoother is the zero-phase filter 1/(1 + (f/cutoff)^6). Times may have any
    spacing.

    Parameters
    ----------
    time : (k,) array_like
        Times, s, not decreasing.
    q : (k, n) or (k,) array_like
        Measured positions of joints of one axis, rad or m; NaN: not measured.
    noise : array_like, optional
        Standard deviation of the positions, scalar or (n,). None: maximum likelihood, with at least the quantization
        noise of an encoder.
    cutoff : array_like, optional
        Bandwidth, Hz, scalar or (n,). None: maximum likelihood.

    Returns
    -------
    Smoothed
        q, qd, qdd, each (k, n), and `variances`, (3, k, n).

    Raises
    ------
    ArgumentError
        Decreasing times, fewer than three measured positions, noise or cutoff that is not above zero.
    ShapeError
        Arrays of different lengths.

    Warns
    -----
    LogWarning
        Gaps, repeated times, and positions that jump by a revolution.

    Notes
    -----
    Square-root Kalman filter and Rauch-Tung-Striebel fixed-interval smoother, O(k). The state is (q, qd, qdd). The
    process noise is white jerk of density (2 pi cutoff)^6 noise^2 h with the mean step h.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> time = np.arange(0.0, 2.0, 0.005)
    >>> found = phipsi.smooth(time, np.sin(3 * time) + 1e-4 * np.random.default_rng(0).standard_normal(400))
    >>> float(np.abs(found.qdd[20:-20] + 9 * np.sin(3 * time[20:-20, None])).max()) < 0.5
    True
    """
    values = np.asarray(_core._numbers("q", q))
    if values.ndim == 1:
        values = values[:, None]
    if values.ndim != 2 or len(values) == 0:
        raise of_argument(ShapeError, "q", f"found shape {values.shape}; expected (k, n): a row per time")
    if np.any(np.isinf(values)):
        raise of_argument(ArgumentError, "q", "found an infinity; expected finite positions, or NaN for missing ones")
    times = checked_time(time, len(values))
    deviation, bandwidth = _given("noise", noise, values.shape[1]), _given("cutoff", cutoff, values.shape[1])
    parts, deviations, cutoffs, passed = [], [], [], []
    for joint in range(values.shape[1]):
        found = _Joint(times, np.ascontiguousarray(values[:, joint]), joint)
        sd, hertz = found.settings(
            None if deviation is None else float(deviation[joint]),
            None if bandwidth is None else float(bandwidth[joint]),
        )
        parts.append(found.smooth(sd, hertz))
        deviations.append(sd)
        cutoffs.append(hertz)
        passed.append(sd * np.sqrt(found.step * (2.0 * np.pi * hertz) ** 5 / 18.0))
    whole = np.stack(parts, axis=2)
    q_found, qd, qdd = (np.ascontiguousarray(whole[:, at]) for at in range(3))
    variances = np.ascontiguousarray(np.moveaxis(whole[:, 3:], 1, 0))
    return Smoothed(times, q_found, qd, qdd, variances, np.array(deviations), np.array(cutoffs), np.array(passed))


def _given(name: str, value: ArrayLike | None, count: int) -> _Array | None:
    if value is None:
        return None
    found = np.asarray(_core._numbers(name, value))
    return each(name, found, count, "found {least}; expected finite numbers above zero", positive=True)


class _Part(NamedTuple):
    time: _Array
    position: _Array
    relative: _Array


class _Joint:
    """The log of one joint."""

    def __init__(self, time: _Array, position: _Array, joint: int) -> None:
        self.time, self.position = np.ascontiguousarray(time), position
        seen = np.isfinite(position)
        if int(seen.sum()) < 3 or len(np.unique(time[seen])) < 3:
            raise of_argument(
                ArgumentError,
                "q",
                f"found {int(seen.sum())} measured positions in column {joint}; expected at least three at different"
                " times",
            )
        measured, steps = position[seen], np.diff(time[seen])
        self.step = float((time[seen][-1] - time[seen][0]) / (seen.sum() - 1))
        changes = np.abs(np.diff(measured))
        if np.any(
            jumps := (np.abs(changes - 2.0 * np.pi) < 0.5)
            & (steps < 3.0 * self.step)
            & (changes > 20.0 * np.median(changes) + 1.0)
        ):
            at = int(np.flatnonzero(jumps)[0])
            text = (
                f"q: found a jump of {changes[at]:.3g} in column {joint} at row {int(np.flatnonzero(seen)[at + 1])}, a"
                " revolution; np.unwrap(q, axis=0) removes it"
            )
            warn(text, LogWarning)
        self.quantum = _quantum(changes)
        #: Variances relative to white quantization noise: they are three times larger at low velocity.
        self.relative = np.ones(len(position))
        if self.quantum > 0.0:
            slow = np.append(changes, changes[-1:]) < 2.0 * self.quantum
            self.relative[np.flatnonzero(seen)[slow]] = 3.0
        self.range = max(float(np.ptp(measured)), REST * max(1.0, float(np.max(np.abs(measured)))))
        self.wide = self._wide(time[seen], measured)
        pieces = max(1, min(PIECES, len(position) // (SAMPLED // PIECES)))
        length = min(len(position), SAMPLED // pieces if len(position) > SAMPLED else len(position))
        begins = np.linspace(0, len(position) - length, pieces).astype(int) if length < len(position) else [0]
        self.pieces = [slice(int(begin), int(begin) + length) for begin in begins]

    def _prior(self, noise: float) -> tuple[float, float, float]:
        """Initial standard deviations of position, velocity and acceleration for a standard deviation of the noise."""
        position, velocity, acceleration = self.wide
        noise *= WIDE
        return max(position, noise), max(velocity, noise / self.step), max(acceleration, noise / self.step**2)

    def _wide(self, time: _Array, measured: _Array) -> tuple[float, float, float]:
        """Standard deviations of position, velocity and acceleration above all finite differences."""
        moving = np.append(True, np.diff(time) > 0.0)
        time, measured = time[moving], measured[moving]
        rates = np.diff(measured) / np.diff(time)
        bends = np.diff(rates) / (0.5 * (time[2:] - time[:-2]))
        least = self.range / max(float(time[-1] - time[0]), self.step)
        velocity = max(float(np.max(np.abs(rates))), least)
        return (
            WIDE * self.range,
            WIDE * velocity,
            WIDE * max(float(np.max(np.abs(bends), initial=0.0)), velocity / max(float(time[-1] - time[0]), self.step)),
        )

    def likelihood(self, variance: float, hertz: float) -> tuple[float, float, int]:
        """Sum of e^2 / a and of log a over the innovations, and their number."""
        density = (2.0 * np.pi * hertz) ** 6 * variance * self.step
        sums = [
            _core._log_likelihood(
                self.time[part],
                self.position[part],
                variance * self.relative[part],
                density,
                self._prior(float(np.sqrt(variance))),
            )
            for part in self.pieces
        ]
        squares, logarithms, counts = map(sum, zip(*sums, strict=True))
        return float(squares), float(logarithms), int(counts)

    def settings(self, noise: float | None, cutoff: float | None) -> tuple[float, float]:
        """Standard deviation of the noise, and bandwidth; by maximum likelihood if not given."""
        least = max(self.quantum / np.sqrt(12.0), 1e-9 * self.range)
        if noise is not None and cutoff is not None:
            return noise, cutoff

        def at(log_hertz: float) -> tuple[float, float]:
            """Negative of twice the log-likelihood, and the corresponding standard deviation of the noise."""
            hertz = float(np.exp(log_hertz))
            variance = noise**2 if noise is not None else self.range**2 * 1e-6
            squares, logarithms, count = self.likelihood(variance, hertz)
            count = max(count - START * len(self.pieces), 1)
            if noise is not None:
                return squares + logarithms, noise
            # Innovations scale with the noise at a given bandwidth.
            scale = max(squares / count, least**2 / variance)
            return squares / scale + logarithms + count * np.log(scale), float(np.sqrt(scale * variance))

        if cutoff is not None:
            return max(self._left(cutoff), least), cutoff
        low, high = np.log(0.5 / (self.time[-1] - self.time[0])), np.log(0.45 / self.step)
        grid = np.linspace(low, max(high, low + 0.1), STEPS // 2)
        best = int(np.argmin([at(float(one))[0] for one in grid]))
        left, right = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, len(grid) - 1)])
        golden = 0.5 * (np.sqrt(5.0) - 1.0)
        for _ in range(STEPS // 3):
            one, other = right - golden * (right - left), left + golden * (right - left)
            if at(one)[0] < at(other)[0]:
                right = other
            else:
                left = one
        middle = 0.5 * (left + right)
        return at(middle)[1], float(np.exp(middle))

    def _left(self, hertz: float) -> float:
        """Standard deviation of the noise from the residuals of a smoother of the given bandwidth.

        The innovations are not suitable, because they contain signal that the bandwidth delays.
        """
        squares, share, count = 0.0, 0.0, 0
        for part in self.pieces:
            own = _Part(self.time[part], self.position[part], self.relative[part])
            density = (2.0 * np.pi * hertz) ** 6 * self.step
            found = _core._smooth_log(own.time, own.position, own.relative, density, self._prior(1.0))
            seen = np.isfinite(own.position)
            # The effective bandwidth is lower near the ends.
            inner = (own.time > own.time[0] + ENDS / hertz) & (own.time < own.time[-1] - ENDS / hertz)
            if (seen & inner).sum() > 0.2 * seen.sum():
                seen &= inner
            squares += float(np.sum((own.position - found[:, 0])[seen] ** 2 / own.relative[seen]))
            # The variance of the residuals is the variance of the noise minus the variance of the estimate.
            share += float(np.sum(1.0 - found[seen, 3] / own.relative[seen]))
            count += int(seen.sum())
        return float(np.sqrt(squares / max(share, 1e-3 * count)))

    def smooth(self, noise: float, hertz: float) -> _Array:
        """q, qd, qdd and their variances, (k, 6)."""
        density = (2.0 * np.pi * hertz) ** 6 * noise**2 * self.step
        return _core._smooth_log(self.time, self.position, noise**2 * self.relative, density, self._prior(noise))


def _quantum(changes: _Array) -> float:
    """Encoder step of which all positions are multiples; 0 if there is no such step."""
    moved = changes[changes > 0.0]
    if len(moved) < 20:
        return 0.0
    # The most frequent small change is the step, or a multiple of it.
    step = float(np.min(moved))
    if step < 1e-9 * float(np.max(moved)):
        return 0.0
    counts = moved / step
    off = np.abs(counts - np.round(counts))
    near = counts < 1.0 / WHOLE
    return step if near.sum() > 10 and float(np.quantile(off[near], 0.95)) < 0.05 else 0.0
