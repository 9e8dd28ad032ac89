"""Noise of a momentum observer, estimated from a log without contact."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from .._summary import summarized
from ..errors import ArgumentError, ShapeError, of_argument
from ._values import positive

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["MomentumNoise", "momentum_noise"]

_Array = NDArray[np.float64]

#: Least number of rows of a log.
ROWS = 100
#: Bands of frequency in which the periodogram is averaged.
BANDS = 200
#: Correlation times that are tried, between the step and a third of the log, and improvements of the best.
TIMES, REFINED = 24, 20
#: Sweeps for the two densities of a spectrum.
SWEEPS = 60
#: Gain of the log-likelihood that a correlation time must have over white noise.
WORTH = 3.0


@summarized
class MomentumNoise(NamedTuple):
    """Noise of joint torques and velocities, as arguments of Scene.momentum_observer."""

    torque_noise: _Array
    """Density of the torque noise, (nv,), (N m)^2 s."""
    correlation_time: _Array
    """Correlation time of the torque noise, (nv,), s; zero for white noise."""
    velocity_noise: _Array
    """Standard deviation of errors of the velocities, (nv,), rad/s or m/s."""


def momentum_noise(scene: Scene, dt: float, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> MomentumNoise:
    """Estimate torque noise, its correlation time and velocity noise from a log without contact.

    The residuals are the changes of the momentum M qd from one row to the next, less those of the model. Torque noise n
    adds its impulse over dt, and errors e of the velocities add the change of M e. The spectra of these two differ: an
    Ornstein-Uhlenbeck process and 2 - 2 cos(omega dt). Their sizes, and the correlation time, maximize Whittle's
    likelihood of the periodogram of each joint. Model errors are part of the residuals, and so of the noise. A joint at
    rest is held by friction: exclude such parts of the log, or give their friction in tau.

    Parameters
    ----------
    scene : Scene
        The robot, without connections.
    dt : float
        Time between two rows, s.
    q, qd, tau : (k, nq), (k, nv), (k, nv)
        Positions, velocities and joint torques, at least 100 rows. Torques act from a row to the next. The model does
        not include damping, friction and springs of the scene: add their torques to tau, as in the observer's step.

    Returns
    -------
    MomentumNoise
        Named tuple (torque_noise, correlation_time, velocity_noise), (nv,) each.

    Raises
    ------
    ArgumentError
        A scene with connections, a log that is too short, or residuals that are zero.
    ShapeError, NotFiniteError
        Arrays of invalid shapes or values.

    Examples
    --------
    >>> import numpy as np, phipsi
    >>> from phipsi.estimation import momentum_noise
    >>> scene, random = phipsi.scenes.chain(2), np.random.default_rng(0)
    >>> q, qd = np.zeros((4000, 2)), 0.01 * random.normal(size=(4000, 2))     # at rest: qd is noise
    >>> tau = scene.gravity_torque(q) + np.sqrt(1e-5 / 1e-3) * random.normal(size=(4000, 2))
    >>> noise = momentum_noise(scene, 1e-3, q, qd, tau)
    >>> bool(np.all(np.abs(noise.torque_noise / 1e-5 - 1.0) < 0.3)), noise.velocity_noise.round(2)
    (True, array([0.01, 0.01]))
    >>> observer = scene.momentum_observer(1e-3, bandwidth=10.0, **noise._asdict())
    """
    dt = positive("dt", dt)
    if scene.loops.names:
        raise of_argument(ArgumentError, "scene", "found connections, whose forces are unknown; expected a tree")
    given = (("q", q, scene, True), ("qd", qd, scene), ("tau", tau, scene))
    q_, qd_, tau_ = (np.asarray(_core._numbers(*one)) for one in given)
    for name, array in (("q", q_), ("qd", qd_), ("tau", tau_)):
        if array.ndim != 2 or len(array) != len(q_):
            found = f"found shape {array.shape}; expected one row per time, as the other arrays"
            raise of_argument(ShapeError, name, found)
    if len(q_) < ROWS:
        raise of_argument(ArgumentError, "q", f"found {len(q_)} rows; expected at least {ROWS}")
    flow = np.einsum("kji,kj->ki", scene.coriolis_matrix(q_, qd_), qd_) - scene.gravity_torque(q_)
    mass = np.asarray(scene.mass_matrix(q_))
    momentum = np.einsum("kij,kj->ki", mass, qd_)
    residuals = np.diff(momentum, axis=0) - dt * (tau_[:-1] + 0.5 * (flow[1:] + flow[:-1]))
    if not np.all(residuals.any(axis=0)):
        found = "found torques that the model explains without noise; expected a measured log"
        raise of_argument(ArgumentError, "tau", found)
    # In units of velocity, noise of velocities does not mix between joints.
    in_velocity = np.linalg.solve(0.5 * (mass[1:] + mass[:-1]), residuals[..., None])[..., 0]
    torques = [_fitted(column, dt) for column in residuals.T]
    velocities = [_fitted(column, dt) for column in in_velocity.T]
    density, time = np.array([(white, time) for white, time, _ in torques]).T
    return MomentumNoise(density, time, np.sqrt([variance for _, _, variance in velocities]))


def _fitted(residuals: _Array, dt: float) -> tuple[float, float, float]:
    """Density and correlation time of the noise of which residuals are the impulses, and variance of the other noise."""
    count = len(residuals)
    power = np.abs(np.fft.rfft(residuals)[1:]) ** 2 / count
    omega = 2.0 * np.pi * np.arange(1, len(power) + 1) / count
    # Averages over bands that are wider at high frequencies: the spectra are smooth there.
    edges = np.unique(np.round(np.geomspace(1, len(power) + 1, BANDS)).astype(int)) - 1
    sizes = np.diff(edges).astype(float)
    power, omega = (np.add.reduceat(one[: edges[-1]], edges[:-1]) / sizes for one in (power, omega))
    differenced = 2.0 - 2.0 * np.cos(omega)
    scale = float(power @ sizes) / count
    known: dict[float, tuple[float, float, float]] = {}
    #: Densities of the last correlation time: those of the next are near.
    sizes_of = [0.5 * scale / dt, 0.25 * scale]

    def cost(time: float) -> float:
        """Least cost, minus the log-likelihood, of a correlation time."""
        # Density 1, and its impulses over dt: that of the process, sampled.
        shape = np.full(len(omega), dt)
        if time > 0.0:
            kept = math.exp(-dt / time)
            shape = dt * (1.0 - kept) ** 2 / (1.0 - 2.0 * kept * np.cos(omega) + kept**2)
        a, b = sizes_of
        for _ in range(SWEEPS):
            # Each step raises the likelihood, and keeps both positive.
            model = a * shape + b * differenced
            ratio, weight = sizes * power / model**2, sizes / model
            a *= math.sqrt(float(ratio @ shape) / float(weight @ shape))
            b *= math.sqrt(float(ratio @ differenced) / float(weight @ differenced))
        model = a * shape + b * differenced
        found = float(sizes @ (np.log(model) + power / model))
        # A size of zero would stay zero.
        sizes_of[:] = max(a, 1e-6 * scale / dt), max(b, 1e-6 * scale)
        known[time] = found, a, b
        return found

    white = cost(0.0)
    times = np.geomspace(dt, count * dt / 3.0, TIMES)
    at = int(np.argmin([cost(float(time)) for time in times]))
    low, high = math.log(times[max(0, at - 1)]), math.log(times[min(TIMES - 1, at + 1)])
    for _ in range(REFINED):
        one, other = low + 0.382 * (high - low), low + 0.618 * (high - low)
        low, high = (low, other) if cost(math.exp(one)) < cost(math.exp(other)) else (one, high)
    best = min(known, key=lambda time: known[time][0])
    best = best if known[best][0] < white - WORTH else 0.0
    return known[best][1], best, known[best][2]
