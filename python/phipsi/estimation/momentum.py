"""Momentum observer: external joint torques from motion and joint torques, with a specified false-alarm rate."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from .._arguments import check_result, numbers, whole
from ..errors import ArgumentError, ShapeError, SingularTaskError, of_argument
from ._allowed import allowed_motions, mobility
from ._chi_square import chi_square_cdf
from ._values import each
from .uncertainty import ParameterCovariance

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["MomentumObserver", "ObservedTorque", "alarm_threshold", "mean_time_to_alarm"]

_Array = NDArray[np.float64]

#: Correction of a threshold for sampling, -zeta(1/2) / sqrt(2 pi), in standard deviations of the change between two
#: samples (Siegmund).
SAMPLING = 0.5826
#: Quadrature points per standard deviation.
POINTS = 40
#: Largest threshold, standard deviations, and largest number of components: the mean time to an alarm does not overflow.
LARGEST, LARGEST_SIZE = 32.0, 10**6
#: Smallest variance whose inverse is finite.
SMALLEST = 1.0 / float(np.finfo(float).max)
#: Smallest and largest product of bandwidth and step of a MomentumObserver.
FILTERED = (1e-9, 1e3)


def mean_time_to_alarm(threshold: float, rate: float, size: int) -> float:
    """Mean first-exit time of an Ornstein-Uhlenbeck process from a ball, with start at the center.

    The process has d = `size` independent components of unit variance. With the threshold c and the rate K,
    T = (1/K) int_0^c e^(x^2/2) x^(1-d) int_0^x z^(d-1) e^(-z^2/2) dz dx.

    Parameters
    ----------
    threshold : float
        Radius c in standard deviations.
    rate : float
        Rate K, 1/s: the autocorrelation of the process is e^(-K t).
    size : int
        Number of components d.

    Returns
    -------
    float
        Mean time, s.

    Raises
    ------
    ArgumentError
        A rate that is not positive, a size below 1, or a threshold above 32.

    Examples
    --------
    >>> import phipsi
    >>> from phipsi.estimation import mean_time_to_alarm
    >>> 3000 < mean_time_to_alarm(6.19, 10.0, 6) < 4000
    True
    """
    rate, size = _positive("rate", rate), whole("size", size, 1, most=LARGEST_SIZE)
    if not threshold <= LARGEST:
        raise of_argument(ArgumentError, "threshold", f"found {threshold}; expected at most {LARGEST:g} standard deviations")
    if threshold <= 0.0:
        return 0.0
    panels = max(1, math.ceil(threshold))
    nodes, weights = np.polynomial.legendre.leggauss(POINTS)
    width = threshold / panels
    x = (width * (np.arange(panels)[:, None] + 0.5 * (nodes + 1.0))).ravel()
    # The inner integral is 2^(d/2-1) Gamma(d/2) times the distribution function of chi-square at x^2.
    inner = np.exp(
        0.5 * x**2 + (1.0 - size) * np.log(x) + (0.5 * size - 1.0) * math.log(2.0) + math.lgamma(0.5 * size)
    ) * chi_square_cdf(x**2, size)
    return float(np.sum(0.5 * width * np.tile(weights, panels) * inner) / rate)


def alarm_threshold(false_alarms_per_hour: float, rate: float, dt: float, size: int) -> float:
    """Threshold, in standard deviations, for a given rate of false alarms of a sampled process.

    The process has unit covariance; see mean_time_to_alarm.

    Parameters
    ----------
    false_alarms_per_hour : float
        Number of alarms per hour; the process restarts from zero after each alarm.
    rate : float
        Rate K, 1/s: the correlation between two successive samples is e^(-K dt).
    dt : float
        Time between two samples, s.
    size : int
        Number of components.

    Returns
    -------
    float
        Threshold. It is lower than the threshold in continuous time by 0.5826 sqrt(2 K dt), because an excursion
        between two samples is not detected.

    Raises
    ------
    ArgumentError
        A number that is not positive, or a rate of alarms that no threshold up to 32 gives.

    Examples
    --------
    >>> import phipsi
    >>> from phipsi.estimation import alarm_threshold
    >>> round(alarm_threshold(1.0, 10.0, 1e-3, 6), 2)
    6.11
    """
    wanted = 3600.0 / _positive("false_alarms_per_hour", false_alarms_per_hour)
    rate, dt = _positive("rate", rate), _positive("dt", dt)
    low, high = 0.0, 1.0
    while mean_time_to_alarm(high, rate, size) < wanted:
        high *= 2.0
        if high > LARGEST:
            raise of_argument(
                ArgumentError,
                "false_alarms_per_hour",
                f"found {false_alarms_per_hour:g}, which requires a threshold above 32 standard deviations; expected"
                " more",
            )
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if mean_time_to_alarm(middle, rate, size) < wanted else (low, middle)
    threshold = high - SAMPLING * math.sqrt(2.0 * rate * dt)
    if not threshold > 0.5:
        found = (
            f"found {false_alarms_per_hour:g}: one alarm per {wanted:g} s, close to the time constant of the observer,"
            f" {1.0 / rate:g} s"
        )
        raise of_argument(ArgumentError, "false_alarms_per_hour", f"{found}; expected fewer")
    return threshold


class ObservedTorque(NamedTuple):
    """Result of a step of the momentum observer."""

    joint_torque: _Array
    """Estimate of the external joint torques, (..., nv), N m or N."""
    alarm: NDArray[np.bool_] | bool
    """True if the estimate exceeds the threshold, (...)."""


class MomentumObserver:
    """Observer of external joint torques with a specified rate of false alarms; see Scene.momentum_observer.

    The momentum p = M qd satisfies p' = tau + C* qd - g + tau_ext + n with the torque noise n. If tau_ext is a random
    walk, the steady-state Kalman filter is the momentum observer r' = K (p' - u - r), implemented in sampled form. It
    needs neither accelerations nor M^-1. Without contact, r is an Ornstein-Uhlenbeck process, whose successive samples
    are correlated. The threshold therefore follows from the mean first-exit time of this process from a ball.

    With connections, whose forces are unknown, torques are observed as far as they act on motions that the connections
    allow: joint_torque is the smallest torque with the same effect. Contacts of the scene are ignored, because their
    forces are external ones.

    Parameters
    ----------
    scene : Scene
        The robot.
    dt : float
        Time between two steps, s.
    torque_noise : (nv,) or float
        Density of the torque noise of each degree of freedom, (N m)^2 s, positive: the variance of its mean over a
        time T, times T. It includes friction that is not modeled.
    bandwidth : float
        Bandwidth K of the estimate, 1/s. A lower bandwidth detects smaller torques, with a longer delay.
    false_alarms_per_hour : float
        Number of alarms per hour without any contact.
    parameters : optional
        Covariance of the inertial parameters, as in Scene.forward_dynamics_variance. Parameter errors cause torques
        that do not average out; their covariance at the present state is added to the covariance of r. The errors are
        constant for one robot, so that the specified rate is an upper bound over robots.
    load : (str, (3,)), optional
        Link and point in the link frame, m, of a load to detect, as in Scene.with_payload. The alarm then tests the
        mass of a load at this point instead of all external torques. The component of the whitened torques along those
        that weight and inertia of the load cause is one process instead of nv. Its threshold is lower, and a load
        contributes to it with one sign while the robot moves.

    Attributes
    ----------
    threshold : float
        Norm of r, in standard deviations, above which an alarm is raised; with `load`, the size of the estimated mass
        in standard deviations.
    joint_torque : (..., nv)
        Latest estimate r.
    alarm : (...)
        True if the last step raised an alarm.
    covariance : (..., nv, nv)
        Covariance of r without contact, at the last step. With connections its rank is the number of motions.
    mass, mass_deviation : (...)
        With `load`, the estimate of its mass and the standard deviation without a load, kg, for a robot that moves
        slowly compared with the bandwidth. NaN and infinite where a load causes no joint torque.

    Raises
    ------
    ArgumentError
        Noise, bandwidth, step or rate that is not positive; a load that no joint moves.
    ShapeError
        An array of an invalid shape.

    Examples
    --------
    >>> import numpy as np, phipsi
    >>> scene = phipsi.scenes.chain(3)
    >>> observer = scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=10.0)
    >>> q, held = np.array([0.3, 0.2, 0.1]), scene.gravity_torque([0.3, 0.2, 0.1])
    >>> for _ in range(1000):  # at rest, with motor torques 2 N m below static equilibrium
    ...     torque, alarm = observer.step(q, np.zeros(3), held - [2.0, 0.0, 0.0])
    >>> torque.round(2), bool(alarm)
    (array([2., 0., 0.]), True)
    """

    def __init__(
        self,
        scene: Scene,
        dt: float,
        *,
        torque_noise: ArrayLike,
        bandwidth: float,
        false_alarms_per_hour: float = 1.0,
        parameters: Any = None,
        load: tuple[str, ArrayLike] | None = None,
    ) -> None:
        for name, value in (("dt", dt), ("bandwidth", bandwidth), ("false_alarms_per_hour", false_alarms_per_hour)):
            _positive(name, value)
        if not FILTERED[0] <= bandwidth * dt <= FILTERED[1]:
            low, high = (f"{limit / dt:.3g}" for limit in FILTERED)
            raise of_argument(ArgumentError, "bandwidth", f"found {bandwidth} with the step {dt} s; expected from {low} to {high} 1/s")
        refused = (
            "found a density that is not finite and positive; expected (N m)^2 s for all degrees of freedom,"
            " including a floating base"
        )
        density = each("torque_noise", torque_noise, scene.nv, refused, positive=True)
        self.scene, self.dt = scene, float(dt)
        ratio = (bandwidth * dt) ** 2
        steady = 0.5 * (math.sqrt(ratio * (ratio + 4.0)) - ratio)
        self._gain = steady / (1.0 - steady)
        # Stationary variance of r = (r + gain n) / (1 + gain); n has the variance density / dt.
        with np.errstate(over="ignore"):
            self._variance = density * (self._gain / (2.0 + self._gain) / dt)
        if not np.all((self._variance > SMALLEST) & np.isfinite(self._variance)):
            raise of_argument(ArgumentError, "torque_noise", f"found {density}; expected densities whose variances at this bandwidth are positive numbers")
        self._deviation = np.sqrt(density)
        self._parameters = ParameterCovariance(scene, parameters)
        self._load = None if load is None else _checked_load(scene, load)
        self._connected = bool(scene.constraint_names)
        tested = 1 if load is not None else mobility(scene) if self._connected else scene.nv
        self.threshold = alarm_threshold(false_alarms_per_hour, math.log1p(self._gain) / dt, dt, tested)
        self.reset()

    def reset(self) -> None:
        """Restart from zero external torque, for instance after an alarm. The next step only stores the momentum.

        Examples
        --------
        >>> import phipsi
        >>> observer = phipsi.scenes.chain(2).momentum_observer(1e-3, torque_noise=0.01, bandwidth=10.0)
        >>> observer.reset()
        """
        self.joint_torque: _Array = np.zeros(self.scene.nv)
        self.alarm: NDArray[np.bool_] | bool = False
        self.covariance: _Array = np.diag(self._variance)
        self._q: _Array | None = None
        self._before: tuple[_Array, _Array, _Array, _Array] | None = None
        self._of_load, self._along, self._size = np.zeros(()), np.zeros(self.scene.nv), np.zeros(())
        #: Motions that the connections allow, as columns; the others are zero.
        self._motions: _Array = np.eye(self.scene.nv)
        self.mass: _Array = np.array(np.nan)
        self.mass_deviation: _Array = np.array(np.inf)

    def step(self, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> ObservedTorque:
        """Process a sample of the motion, and the torque from this sample to the next.

        Parameters
        ----------
        q : (..., nq)
            Joint positions, rad or m. Leading axes are robots, identical in all steps.
        qd : (..., nv)
            Joint velocities, rad/s or m/s.
        tau : (..., nv)
            Joint torques from the present to the next step, N m or N. The model does not include damping, friction and
            springs of the scene: add their torques.

        Returns
        -------
        ObservedTorque
            Named tuple (joint_torque, alarm): external torques, (..., nv), and True if they exceed the threshold,
            (...). The torques of the first step are zero.

        Raises
        ------
        ShapeError, NotFiniteError
            As Scene.inverse_dynamics, and results that overflow. The observer is then unchanged.

        Examples
        --------
        >>> import phipsi
        >>> observer = phipsi.scenes.chain(2).momentum_observer(1e-3, torque_noise=0.01, bandwidth=10.0)
        >>> observer.step([0.0, 0.0], [0.0, 0.0], [0.0, 0.0]).joint_torque
        array([0., 0.])
        """
        before = dict(self.__dict__)
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                return self._step(q, qd, tau)
        except BaseException:
            # After an error the observer is unchanged.
            self.__dict__.update(before)
            raise

    def _step(self, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> ObservedTorque:
        scene = self.scene
        q, qd, tau = (
            np.array(_core._numbers(*one)) for one in (("q", q, scene, True), ("qd", qd, scene), ("tau", tau, scene))
        )
        # C* qd - g: rate of change of the momentum without torques.
        flow = np.einsum("...ji,...j->...i", scene.coriolis_matrix(q, qd), qd) - scene.gravity_torque(q)
        momentum = np.einsum("...ij,...j->...i", scene.mass_matrix(q), qd)
        if self._connected:
            self._motions = allowed_motions(scene, q)
        if self._before is None:
            self.joint_torque = np.zeros(np.broadcast_shapes(momentum.shape, tau.shape))
            self._of_load = np.zeros(self.joint_torque.shape[:-1])
        else:
            before, drift, torque, motions = self._before
            if before.shape != momentum.shape:
                raise of_argument(
                    ShapeError,
                    "q",
                    f"found states of shape {momentum.shape} after states of shape {before.shape}; expected the same"
                    " shape, or reset() first",
                )
            moved = momentum - before - self.dt * (torque + 0.5 * (drift + flow))
            if self._connected:
                # The mean of the projections at both ends: the forces of the connections cancel to second order.
                moved = 0.5 * (_projected(motions, moved) + _projected(self._motions, moved))
            self.joint_torque = (self.joint_torque + self._gain / self.dt * moved) / (1.0 + self._gain)
            if self._connected:
                self.joint_torque = _projected(self._motions, self.joint_torque)
            check_result("external joint torque", self.joint_torque)
            if self._load is not None:
                along = np.sum(self._along * moved, axis=-1)
                self._of_load = (self._of_load + self._gain / self.dt * along) / (1.0 + self._gain)
        if self._load is not None:
            # The direction at the start of an interval does not depend on the noise during it.
            self._along, self._size = self._directed(self._load_torque(q, qd, tau))
        self._before, self._q = (momentum, flow, tau, self._motions), q
        self.covariance = self._covariance(q, qd, tau)
        self.alarm = self._exceeds()
        return ObservedTorque(self.joint_torque.copy(), self.alarm)

    def _load_torque(self, q: _Array, qd: _Array, tau: _Array) -> _Array:
        """Joint torques that a point mass of 1 kg causes by its weight and inertia, (..., nv), N m or N."""
        assert self._load is not None
        scene, (link, point) = self.scene, self._load
        frame: Literal["local-world-aligned"] = "local-world-aligned"
        qdd = scene.forward_dynamics(q, qd, tau + self.joint_torque)
        moved = scene.acceleration(q, qd, qdd, link, frame=frame, at=point, kind="classical")[..., 3:]
        along = scene.jacobian(q, link, frame=frame, at=point)[..., 3:, :]
        return np.asarray(np.einsum("...iv,...i->...v", along, scene.gravity - moved))

    def _directed(self, weight: _Array) -> tuple[_Array, _Array]:
        """Factors of the torques for the component along a torque, of unit density, and the size of that torque.

        In units of the noise, as far as it acts on motions that the connections allow. Zero for a zero torque.
        """
        if not self._connected:
            white = weight / self._deviation
            return _direction(white) / self._deviation, np.asarray(np.linalg.norm(white, axis=-1))
        root = self._root(np.diag(self._deviation**2))
        within = np.asarray(np.linalg.solve(root, self._within(weight)[..., None]))[..., 0]
        along = self._motions @ np.linalg.solve(np.swapaxes(root, -1, -2), _direction(within)[..., None])
        return along[..., 0], np.asarray(np.linalg.norm(within, axis=-1))

    def _within(self, torque: _Array) -> _Array:
        """U* tau: torques on the motions that the connections allow; zero for the other columns of U."""
        return np.asarray(np.einsum("...ji,...j->...i", self._motions, torque))

    def _root(self, covariance: _Array) -> _Array:
        """Cholesky factor of U* C U, with a one for each zero column of U."""
        if not self._connected:
            return np.asarray(np.linalg.cholesky(covariance))
        missing = np.asarray(~self._motions.any(axis=-2))
        within = np.swapaxes(self._motions, -1, -2) @ covariance @ self._motions
        return np.asarray(np.linalg.cholesky(within + missing[..., None] * np.eye(self.scene.nv)))

    def _covariance(self, q: _Array, qd: _Array, tau: _Array) -> _Array:
        """Covariance of r without contact."""
        covariance = np.diag(self._variance)
        if len(self._parameters.columns):
            qdd = self.scene.forward_dynamics(q, qd, tau + self.joint_torque)
            torques = self._parameters._torques(q, qd, qdd, self.scene)
            covariance = np.asarray(covariance + np.einsum("s...i,s...j->...ij", torques, torques))
            check_result("covariance of the external joint torque", covariance)
        if self._connected:
            projector = self._motions @ np.swapaxes(self._motions, -1, -2)
            covariance = projector @ covariance @ projector
        return covariance

    def _exceeds(self) -> NDArray[np.bool_] | bool:
        r, square = self.joint_torque, np.zeros(())
        exact = not len(self._parameters.columns)
        if self._load is not None:
            along, size = self._along, self._size
            variance = self._variance[0] / self._deviation[0] ** 2
            if not exact:
                added = self.covariance - np.diag(self._variance)
                variance = variance + np.einsum("...i,...ij,...j->...", along, added, along)
            with np.errstate(divide="ignore", invalid="ignore"):
                self.mass = np.where(size > 0.0, self._of_load / size, np.nan)
                self.mass_deviation = np.sqrt(variance) / size
            check_result("torque of the load", size)
            check_result("mass of the load", np.where(size > 0.0, self.mass, self._of_load))
            square = self._of_load**2 / variance
        elif self._connected:
            white = np.linalg.solve(self._root(self.covariance), self._within(r)[..., None])
            square = np.sum(white[..., 0] ** 2, axis=-1)
        elif exact:
            square = np.sum(r**2 / self._variance, axis=-1)
        else:
            square = np.einsum("...i,...i->...", r, np.linalg.solve(self.covariance, r[..., None])[..., 0])
        # An infinite square is above every threshold, and NaN would be no alarm.
        check_result("alarm", np.where(np.isinf(square), 0.0, square))
        alarm = square > self.threshold**2
        return bool(alarm) if np.ndim(alarm) == 0 else alarm

    def wrench(self, link: str) -> _Array:
        """External wrench on a link by weighted least squares, joint_torque = J* w.

        The result is valid if no other external wrench acts on the robot.

        Parameters
        ----------
        link : str
            Name of the link.

        Returns
        -------
        array (..., 6)
            (moment, force) at the link origin in the link frame, N m and N.

        Raises
        ------
        SingularTaskError
            Fewer than six independent joints move the link, so that the torques do not determine the wrench.
        ArgumentError
            An unknown link; no step so far.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
        >>> observer = scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=10.0)
        >>> q = np.full(6, 0.5)
        >>> for _ in range(2000):
        ...     torque, alarm = observer.step(q, np.zeros(6), scene.gravity_torque(q))
        >>> observer.wrench(scene.link_names[-1]).shape
        (6,)
        """
        if self._q is None:
            raise of_argument(ArgumentError, "link", "found no step so far; expected step() before wrench()")
        root = self._root(self.covariance)
        torques = np.swapaxes(self.scene.jacobian(self._q, link), -1, -2)
        rows = np.linalg.solve(root, np.swapaxes(self._motions, -1, -2) @ torques if self._connected else torques)
        # Moments and forces have different units: normalize the columns by their effect on the joints.
        size = np.linalg.norm(rows, axis=-2, keepdims=True)
        left, values, right = np.linalg.svd(rows / np.where(size > 0.0, size, 1.0), full_matrices=False)
        if values.shape[-1] < 6 or not np.all(values[..., -1] > 1e-9 * values[..., 0]):
            error = SingularTaskError(
                f"link {link!r}: its joints do not move it in six independent directions in this state, so that joint"
                " torques do not determine its wrench; use joint_torque"
            )
            error.links = (link,)
            raise error
        white = np.linalg.solve(root, self._within(self.joint_torque)[..., None] if self._connected else self.joint_torque[..., None])
        scaled = np.swapaxes(right, -1, -2) @ ((np.swapaxes(left, -1, -2) @ white) / values[..., None])
        return np.asarray(scaled[..., 0] / size[..., 0, :])


def _positive(name: str, value: float) -> float:
    if not (np.isfinite(value) and value > 0.0):
        raise of_argument(ArgumentError, name, f"found {value}; expected a finite number above zero")
    return float(value)


def _checked_load(scene: Scene, load: Any) -> tuple[str, _Array]:
    """Link and point of a load that can act on the joints."""
    expected = "expected a link and a point in its frame, for instance (scene.link_names[-1], (0.0, 0.0, 0.1))"
    if not (isinstance(load, tuple) and len(load) == 2 and isinstance(load[0], str)):
        raise of_argument(ArgumentError, "load", f"found {load!r}; {expected}")
    link, point = load[0], numbers("load", load[1])
    if point.shape != (3,) or not np.isfinite(point).all():
        raise of_argument(ArgumentError, "load", f"found {load!r}; {expected}")
    if not np.any(scene.jacobian(scene.neutral(), link)):
        raise of_argument(ArgumentError, "load", f"found link {link!r}, which no joint moves; expected a moving link")
    return link, point


def _projected(motions: _Array, torque: _Array) -> _Array:
    """P tau with the orthogonal projector P = U U*."""
    return np.asarray(np.einsum("...ij,...kj,...k->...i", motions, motions, torque))


def _direction(weight: _Array) -> _Array:
    """Unit vector; zero for a zero vector."""
    size = np.linalg.norm(weight, axis=-1, keepdims=True)
    return np.asarray(weight / np.where(size > 0.0, size, 1.0))
