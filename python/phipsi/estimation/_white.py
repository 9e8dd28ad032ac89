"""White innovations of the momentum of a robot without contact, with noisy velocities and correlated torque noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Belief", "TorqueProcess", "WhiteMomentum"]

_Array = NDArray[np.float64]

#: Step over correlation time below which the variance of the impulse is computed by its series.
SHORT = 1e-2


class TorqueProcess:
    """Ornstein-Uhlenbeck torque noise n of each degree of freedom, and its impulse, the integral over a step.

    The density S is that of white noise with the same impulse over a long time: the stationary variance is S/(2 T) with
    the correlation time T. With T = 0 the noise is white. Over a step h, with a = e^(-h/T): n1 = a n + w and impulse
    T (1 - a) n + v, where w and v are correlated.
    """

    def __init__(self, density: _Array, time: _Array, dt: float) -> None:
        self.density, self.is_white = density, not time.any()
        with np.errstate(divide="ignore", over="ignore"):
            x = np.where(time > 0.0, dt / np.where(time > 0.0, time, 1.0), np.inf)
            #: Factor of n over a step, and impulse by n.
            self.decay, self.lever = np.exp(-x), -time * np.expm1(-x)
            self.stationary = np.where(time > 0.0, density / np.where(time > 0.0, 2.0 * time, 1.0), 0.0)
        #: Variances of v and w, and their covariance.
        short = x**3 * (1.0 / 3.0 - x * (0.25 - x * (7.0 / 60.0 - x / 24.0)))
        with np.errstate(invalid="ignore"):
            impulse = time * np.where(x < SHORT, short, x + 2.0 * np.expm1(-x) - 0.5 * np.expm1(-2.0 * x))
        self.impulse = density * np.where(time > 0.0, impulse, dt)
        self.growth = -self.stationary * np.expm1(-2.0 * x)
        self.both = 0.5 * density * np.where(time > 0.0, np.expm1(-x) ** 2, 0.0)

    def filtered_variance(self, gain: float, dt: float) -> _Array:
        """Stationary variance of r = (r + gain m/dt)/(1 + gain) for the impulses m, (nv,)."""
        kept, share = 1.0 / (1.0 + gain), gain / ((1.0 + gain) * dt)
        variance = self.impulse + self.lever**2 * self.stationary
        # Covariances of impulses l steps apart: lever (both + decay lever stationary) decay^(l - 1).
        lagged = self.lever * (self.both + self.decay * self.lever * self.stationary)
        return np.asarray(share**2 / (1.0 - kept**2) * (variance + 2.0 * kept * lagged / (1.0 - kept * self.decay)))


class Belief(NamedTuple):
    """Estimate of momentum and torque noise, (..., n), and its covariance."""

    state: _Array
    covariance: _Array


class WhiteMomentum:
    """Kalman filter of (momentum, torque noise) without contact; its innovations are white for any of these noises.

    The measured momentum is M (qd + e), with e the noise of the velocities. Innovations are in units of an impulse: an
    external torque that is constant adds dt times itself to them.
    """

    def __init__(self, process: TorqueProcess, velocity_variance: _Array, dt: float) -> None:
        self._process, self._dt, self._velocity_variance = process, dt, velocity_variance
        nv = len(velocity_variance)
        self._nv, self._size = nv, nv if process.is_white else 2 * nv
        self._flow, self._added = np.eye(nv), np.diag(process.impulse)
        if not process.is_white:
            self._flow = np.block([[np.eye(nv), np.diag(process.lever)], [np.zeros((nv, nv)), np.diag(process.decay)]])
            both = np.diag(process.both)
            self._added = np.block([[self._added, both], [both, np.diag(process.growth)]])

    def noise(self, mass: _Array) -> _Array:
        """Covariance of the measured momentum, M V M."""
        return np.asarray((mass * self._velocity_variance) @ mass)

    def start(
        self, momentum: _Array, mass: _Array, belief: Belief | None, fresh: NDArray[np.bool_], shape: tuple[int, ...]
    ) -> Belief:
        """The belief, begun at the measured momentum for fresh robots; `shape` is that of all torques, (..., nv)."""
        if belief is not None and not fresh.any():
            return belief
        nv, size = self._nv, self._size
        state, covariance = np.zeros((*shape[:-1], size)), np.zeros((*shape[:-1], size, size))
        state[..., :nv], covariance[..., :nv, :nv] = momentum, self.noise(mass)
        if size > nv:
            covariance[..., nv:, nv:] = np.diag(self._process.stationary)
        if belief is None:
            return Belief(state, covariance)
        return Belief(
            np.where(fresh[..., None], state, belief.state),
            np.where(fresh[..., None, None], covariance, belief.covariance),
        )

    def _gains(self, belief: Belief, noise: _Array) -> tuple[_Array, _Array, _Array, _Array]:
        """Covariance of the prediction, the gain K, 1 - K H, and the innovation's answer to a constant torque, over dt.

        The error z of the prediction under the torque tau is F (1 - K H) z + [dt tau, 0].
        """
        nv, size = self._nv, self._size
        predicted = self._flow @ belief.covariance @ self._flow.T + self._added
        gain = np.swapaxes(np.linalg.solve(predicted[..., :nv, :nv] + noise, predicted[..., :nv, :]), -1, -2)
        kept = np.eye(size) - np.concatenate([gain, np.zeros((*gain.shape[:-1], size - nv))], axis=-1)
        lag = np.eye(size) - self._flow @ kept
        answer = np.linalg.solve(lag, np.broadcast_to(np.eye(size)[:, :nv], (*lag.shape[:-1], nv)))[..., :nv, :]
        return predicted, gain, kept, answer

    def density(self, belief: Belief, mass: _Array) -> _Array:
        """Density of the next innovation: its covariance over dt, at an unchanged mass matrix."""
        noise = self.noise(mass)
        predicted, _, _, answer = self._gains(belief, noise)
        return self._density(predicted, noise, answer)

    def _density(self, predicted: _Array, noise: _Array, answer: _Array) -> _Array:
        root = np.linalg.cholesky(predicted[..., : self._nv, : self._nv] + noise)
        half = np.linalg.solve(answer, root)
        return np.asarray(half @ np.swapaxes(half, -1, -2) / self._dt)

    def step(self, belief: Belief, momentum: _Array, mass: _Array, impulse: _Array) -> tuple[Belief, _Array, _Array]:
        """The belief after a step with the given impulse and a measured momentum, the innovation and its density."""
        nv, noise = self._nv, self.noise(mass)
        state = np.einsum("ij,...j->...i", self._flow, belief.state)
        state[..., :nv] += impulse
        predicted, gain, kept, answer = self._gains(belief, noise)
        innovation = momentum - state[..., :nv]
        state = state + np.einsum("...ij,...j->...i", gain, innovation)
        turned = np.swapaxes(gain, -1, -2)
        # Joseph's form.
        covariance = kept @ predicted @ np.swapaxes(kept, -1, -2) + gain @ noise @ turned
        white = np.linalg.solve(answer, innovation[..., None])[..., 0]
        return Belief(state, covariance), white, self._density(predicted, noise, answer)
