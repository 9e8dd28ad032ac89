"""Momentum observer: external joint torques from motion and joint torques, with a specified false-alarm rate."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from .._arguments import check_finite, check_result, check_shape, numbers
from .._summary import summarized
from ..errors import ArgumentError, ShapeError, SingularTaskError, of_argument
from ._allowed import allowed_motions, mobility
from ._values import each, positive
from ._white import Belief, TorqueProcess, WhiteMomentum
from .alarms import alarm_threshold
from .uncertainty import ParameterCovariance

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["MomentumObserver", "ObservedTorque"]

_Array = NDArray[np.float64]

#: Smallest variance whose inverse is finite.
SMALLEST = 1.0 / float(np.finfo(float).max)
#: Smallest and largest product of bandwidth and step of a MomentumObserver.
FILTERED = (1e-9, 1e3)
#: Sweeps over the joints for the friction that explains most of a torque.
SWEEPS = 50


@summarized
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

    Noise of the velocities, M dqd in the momentum, and torque noise with a correlation time make r another process.
    With them, the alarm tests the same recursion of the innovations of a Kalman filter of momentum and torque noise,
    which are white. Its covariance is exact, and its correlation that of the threshold.

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
        long time T, times T. It includes friction that is not modeled.
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
        mass of a load at this point, one number, instead of all nv external torques. Therefore its threshold is lower
        and smaller loads are detected, also while the robot moves.
    velocity_noise : (nv,) or float, optional
        Standard deviation of independent errors of each qd, rad/s or m/s; zero by default.
    correlation_time : (nv,) or float, optional
        Correlation time T of the torque noise, s; zero, the default, for white noise. Its variance is torque_noise/(2 T).
    stiction : (nv,) or float, optional
        Largest torque of dry friction that holds a joint at rest and is not part of tau, N m or N; zero by default. The
        alarm tests the part that friction of at most this size cannot explain; its rate is then an upper bound.
    rest_speed : (nv,) or float, optional
        Joint velocity, rad/s or m/s, up to which a joint is at rest; 0.01 by default. Choose it above the noise of qd.

    Attributes
    ----------
    threshold : float
        Norm of the tested torque, in standard deviations, above which an alarm is raised; with `load`, the size of the
        estimated mass in standard deviations.
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
        velocity_noise: ArrayLike = 0.0,
        correlation_time: ArrayLike = 0.0,
        stiction: ArrayLike = 0.0,
        rest_speed: ArrayLike = 0.01,
    ) -> None:
        for name, value in (("dt", dt), ("bandwidth", bandwidth), ("false_alarms_per_hour", false_alarms_per_hour)):
            positive(name, value)
        if not scene.nv:
            raise of_argument(ArgumentError, "scene", "found no degrees of freedom; expected at least one joint that moves")
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
        not_negative = "found {least}; expected finite numbers, zero or positive"
        spread = each("velocity_noise", velocity_noise, scene.nv, not_negative)
        time = each("correlation_time", correlation_time, scene.nv, not_negative)
        self._stiction = each("stiction", stiction, scene.nv, not_negative)
        self._rest_speed = each("rest_speed", rest_speed, scene.nv, not_negative)
        process = TorqueProcess(density, time, self.dt)
        #: Variance of r for white torques of unit density.
        self._unit_variance = self._gain / (2.0 + self._gain) / dt
        with np.errstate(over="ignore"):
            self._variance = density * self._unit_variance
            if not process.is_white:
                self._variance = process.filtered_variance(self._gain, dt)
        if not np.all((self._variance > SMALLEST) & np.isfinite(self._variance)):
            raise of_argument(ArgumentError, "torque_noise", f"found {density}; expected densities whose variances at this bandwidth are positive numbers")
        self._deviation = np.sqrt(density)
        self._parameters = ParameterCovariance(scene, parameters)
        self._load = None if load is None else _checked_load(scene, load)
        self._connected = bool(scene.loops.names)
        self._white = WhiteMomentum(process, spread**2, self.dt) if spread.any() or time.any() else None
        #: Friction whose impulses oscillate through the innovations of correlated noise is larger there.
        self._allowed = self._stiction * np.maximum(1.0, 2.0 * bandwidth * time - 1.0)
        for name, given in (("velocity_noise", spread), ("correlation_time", time), ("stiction", self._stiction)):
            if given.any() and self._connected:
                found = f"found {given} for a scene with connections; expected zero"
                raise of_argument(ArgumentError, name, found)
        if self._stiction.any() and load is not None:
            found = f"found {self._stiction} with load; expected zero: the test of a mass does not know friction at rest"
            raise of_argument(ArgumentError, "stiction", found)
        tested = 1 if load is not None else mobility(scene) if self._connected else scene.nv
        self.threshold = alarm_threshold(false_alarms_per_hour, math.log1p(self._gain) / dt, dt, tested)
        self.reset()

    def reset(self, robots: Any = None) -> None:
        """Restart from zero external torque, for instance after an alarm. The next step only stores the momentum.

        Parameters
        ----------
        robots : int, slice or array, optional
            Robots of a batch that restart, as an index or mask of its leading axes; all of them by default, and the
            next step may then have another number of robots.

        Raises
        ------
        ArgumentError
            Robots that the batch does not have.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> observer = phipsi.scenes.chain(2).momentum_observer(1e-3, torque_noise=0.01, bandwidth=10.0)
        >>> torque, alarm = observer.step(np.zeros((3, 2)), np.zeros(2), np.zeros(2))
        >>> observer.reset(alarm)           # the robots with an alarm
        >>> observer.reset()                # all robots
        """
        if robots is not None:
            self._reset_some(robots)
            return
        self.joint_torque: _Array = np.zeros(self.scene.nv)
        self.alarm: NDArray[np.bool_] | bool = False
        self.covariance: _Array = np.diag(self._variance)
        self._q: _Array | None = None
        self._before: tuple[_Array, _Array, _Array, _Array] | None = None
        self._of_load, self._along, self._size = np.zeros(()), np.zeros(self.scene.nv), np.zeros(())
        #: Robots whose next step only stores the momentum.
        self._fresh: NDArray[np.bool_] = np.array(True)
        #: The tested torque, that of white innovations with its covariance, and the friction that it may contain.
        self._tested: _Array = np.zeros(self.scene.nv)
        self._of_white: _Array = np.zeros(self.scene.nv)
        self._of_test: _Array | None = None
        self._added: _Array | None = None
        self._friction: _Array = np.zeros(self.scene.nv)
        self._belief: Belief | None = None
        self._was_at_rest: NDArray[np.bool_] = np.zeros(self.scene.nv, bool)
        #: Motions that the connections allow, as columns; the others are zero.
        self._motions: _Array = np.eye(self.scene.nv)
        self.mass: _Array = np.array(np.nan)
        self.mass_deviation: _Array = np.array(np.inf)

    def _reset_some(self, robots: Any) -> None:
        batch = np.shape(self.alarm)
        fresh = self._fresh | np.zeros(batch, bool)
        try:
            fresh[robots] = True
        except (IndexError, ValueError, TypeError):
            found = f"found {robots!r}; expected an index or mask of the robots of step(), {batch}"
            raise of_argument(ArgumentError, "robots", found) from None
        self._fresh, self.alarm = fresh, np.asarray(self.alarm) & ~fresh
        self._of_load = np.where(fresh, 0.0, self._of_load)
        zero = fresh[..., None]
        self.joint_torque, self._of_white, self._friction = (
            np.where(zero, 0.0, own) for own in (self.joint_torque, self._of_white, self._friction)
        )

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
        # Functions of the scene check the others; this one acts in the next step.
        check_shape("tau", tau, scene.nv)
        check_finite("tau", tau)
        # C* qd - g: rate of change of the momentum without torques.
        flow = np.einsum("...ji,...j->...i", scene.coriolis_matrix(q, qd), qd) - scene.gravity_torque(q)
        mass = np.asarray(scene.mass_matrix(q))
        momentum = np.einsum("...ij,...j->...i", mass, qd)
        # The next step compares with them.
        check_result("momentum and its rate of change", [momentum, flow])
        if self._connected:
            self._motions = allowed_motions(scene, q)
        if self._before is None:
            self.joint_torque = np.zeros(np.broadcast_shapes(momentum.shape, tau.shape))
            self._of_load = np.zeros(self.joint_torque.shape[:-1])
            self._tested = self._friction = self.joint_torque
        else:
            self._advance(momentum, flow, mass, qd)
        if self._white is not None:
            self._belief = self._white.start(momentum, mass, self._belief, self._fresh, self.joint_torque.shape)
        self._fresh, self._was_at_rest = np.array(False), np.abs(qd) <= self._rest_speed
        if self._load is not None:
            # The direction at the start of an interval does not depend on the noise during it.
            self._along, self._size = self._directed(self._load_torque(q, qd, tau), mass)
        self._before, self._q = (momentum, flow, tau, self._motions), q
        self._added = self._of_parameters(q, qd, tau)
        self.covariance = self._covariance(mass)
        self.alarm = self._exceeds()
        return ObservedTorque(self.joint_torque.copy(), self.alarm)

    def _advance(self, momentum: _Array, flow: _Array, mass: _Array, qd: _Array) -> None:
        """Process the change of the momentum since the last step."""
        assert self._before is not None
        before, drift, torque, motions = self._before
        if before.shape != momentum.shape:
            raise of_argument(
                ShapeError,
                "q",
                f"found states of shape {momentum.shape} after states of shape {before.shape}; expected the same"
                " shape, or reset() first",
            )
        impulse = self.dt * (torque + 0.5 * (drift + flow))
        moved, old = momentum - before - impulse, ~self._fresh[..., None]
        if self._connected:
            # The mean of the projections at both ends: the forces of the connections cancel to second order.
            moved = 0.5 * (_projected(motions, moved) + _projected(self._motions, moved))
        moved = np.where(old, moved, 0.0)
        self.joint_torque = self._filtered(self.joint_torque, moved)
        if self._connected:
            self.joint_torque = _projected(self._motions, self.joint_torque)
        check_result("external joint torque", self.joint_torque)
        white, self._tested = moved, self.joint_torque
        if self._white is not None:
            assert self._belief is not None
            self._belief, white, density = self._white.step(self._belief, momentum, mass, impulse)
            white = np.where(old, white, 0.0)
            self._tested = self._filtered(self._of_white, white)
            self._of_white = self._tested
            now = self._unit_variance * density
            last = now if self._of_test is None else np.where(old[..., None], self._of_test, now)
            # As the variance of r = (r + gain n)/(1 + gain) changes with that of n.
            kept = 1.0 / (1.0 + self._gain) ** 2
            self._of_test = kept * last + (1.0 - kept) * now
        if self._load is not None:
            self._of_load = self._filtered(self._of_load, np.sum(self._along * white, axis=-1))
        if self._stiction.any():
            held = self._was_at_rest | (np.abs(qd) <= self._rest_speed)
            self._friction = np.where(old, self._filtered(self._friction, self.dt * self._allowed * held), 0.0)

    def _filtered(self, r: _Array, impulse: _Array) -> _Array:
        """The recursion of r."""
        return np.asarray((r + self._gain / self.dt * impulse) / (1.0 + self._gain))

    def _load_torque(self, q: _Array, qd: _Array, tau: _Array) -> _Array:
        """Joint torques that a point mass of 1 kg causes by its weight and inertia, (..., nv), N m or N."""
        assert self._load is not None
        scene, (link, point) = self.scene, self._load
        frame: Literal["local-world-aligned"] = "local-world-aligned"
        qdd = scene.forward_dynamics(q, qd, tau + self.joint_torque)
        moved = scene.acceleration(q, qd, qdd, link, frame=frame, at=point, kind="classical")[..., 3:]
        along = scene.jacobian(q, link, frame=frame, at=point)[..., 3:, :]
        return np.asarray(np.einsum("...iv,...i->...v", along, scene.gravity - moved))

    def _directed(self, weight: _Array, mass: _Array) -> tuple[_Array, _Array]:
        """Factors of the torques for the component along a torque, of unit density, and the size of that torque.

        In units of the noise, as far as it acts on motions that the connections allow. Zero for a zero torque.
        """
        if not self._connected and self._white is None:
            white = weight / self._deviation
            return _direction(white) / self._deviation, np.asarray(np.linalg.norm(white, axis=-1))
        density = np.diag(self._deviation**2)
        if self._white is not None:
            assert self._belief is not None
            density = self._white.density(self._belief, mass)
        root = self._root(density)
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

    def _of_parameters(self, q: _Array, qd: _Array, tau: _Array) -> _Array | None:
        """Covariance of the torques that parameter errors cause; None without errors."""
        columns = self._parameters.columns
        if not len(columns):
            return None
        qdd = self.scene.forward_dynamics(q, qd, tau + self.joint_torque)
        torques = self._parameters._torques(q, qd, qdd, self.scene)
        return np.asarray(np.einsum("s...i,s...j->...ij", torques, torques))

    def _covariance(self, mass: _Array) -> _Array:
        """Covariance of r without contact."""
        covariance = np.diag(self._variance)
        if self._white is not None:
            # The noise of the momentum is filtered as its change: 2 c^2/(1 + 1/(1 + gain)) with c = gain/(1 + gain)/dt.
            share = self._gain / ((1.0 + self._gain) * self.dt)
            covariance = covariance + 2.0 * share**2 * (1.0 + self._gain) / (2.0 + self._gain) * self._white.noise(mass)
        if self._added is not None:
            covariance = np.asarray(covariance + self._added)
            check_result("covariance of the external joint torque", covariance)
        if self._connected:
            projector = self._motions @ np.swapaxes(self._motions, -1, -2)
            covariance = projector @ covariance @ projector
        return covariance

    def _unexplained(self, covariance: _Array) -> _Array:
        """The tested torque less the friction that may hold joints at rest and explains most of it."""
        r, limit = self._tested, self._friction
        if not limit.any():
            return r
        held = np.clip(r, -limit, limit)
        precise = np.linalg.inv(covariance)
        if np.count_nonzero(precise - np.einsum("...ii->...i", precise)[..., None] * np.eye(len(self._stiction))):
            # Least squares with bounds, joint by joint.
            for _ in range(SWEEPS):
                for i in range(len(self._stiction)):
                    slope = np.einsum("...j,...j->...", precise[..., i, :], r - held)
                    moved = held[..., i] + slope / precise[..., i, i]
                    held[..., i] = np.clip(moved, -limit[..., i], limit[..., i])
        return np.asarray(r - held)

    def _exceeds(self) -> NDArray[np.bool_] | bool:
        square = np.zeros(())
        if self._load is not None:
            along, size = self._along, self._size
            variance: Any = self._unit_variance
            if self._added is not None:
                variance = variance + np.einsum("...i,...ij,...j->...", along, self._added, along)
            with np.errstate(divide="ignore", invalid="ignore"):
                self.mass = np.where(size > 0.0, self._of_load / size, np.nan)
                self.mass_deviation = np.sqrt(variance) / size
            check_result("torque of the load", size)
            check_result("mass of the load", np.where(size > 0.0, self.mass, self._of_load))
            square = self._of_load**2 / variance
        elif self._connected:
            white = np.linalg.solve(self._root(self.covariance), self._within(self.joint_torque)[..., None])
            square = np.sum(white[..., 0] ** 2, axis=-1)
        elif self._added is None and self._of_test is None:
            square = np.sum(self._unexplained(np.diag(self._variance)) ** 2 / self._variance, axis=-1)
        else:
            covariance = np.diag(self._variance) if self._of_test is None else self._of_test
            covariance = covariance if self._added is None else covariance + self._added
            r = self._unexplained(covariance)
            square = np.einsum("...i,...i->...", r, np.linalg.solve(covariance, r[..., None])[..., 0])
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
