"""Square-root error-state Kalman filter of the motion of a robot on its manifold, and fixed-interval smoother.

The state is (q, qd, wrenches, biases). Its error e is a tangent vector, truth = estimate (+) e, where (+) on q is
Scene.integrate. The filter and the smoother are compiled code (src/estimation/observer); this class reads their
arguments, names their results, and tests the innovations for divergence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from .._arguments import check_shape, leading, numbers, whole
from ..errors import ArgumentError, DivergenceWarning, NotFiniteError, ShapeError, of_argument, warn
from ._manifold import joint_groups
from ._records import Record, State, innovation_ratios
from ._values import each
from .motion import ExternalWrench, ObserverEstimate, SmoothedMotion
from .sensors import Contact, Pose, Sensor

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["Observer"]

_Array = NDArray[np.float64]

#: Number of steps of a divergence test, as in compiled code.
WINDOW = 100


class Observer:
    """Observer of joint motion, external wrenches and sensor biases, by an error-state Kalman filter; see Scene.observer.

    Each step processes the readings of the present time, then advances by dt in a step of order 2: qd1 = qd + dt a and
    q (+) dt (qd + qd1)/2. The acceleration is that of its middle, a = FD(q (+) dt qd/2, qd + dt a0/2, tau + n,
    (w + w1)/2), where a0 = FD(q, qd, tau + n, w) and w1 are the wrenches at the end. Readings are linearized at the
    prediction. The model does not include damping, friction and
    springs of the scene: add their torques to tau, and their uncertainty to torque_noise.

    Parameters
    ----------
    scene : Scene
        The robot. Its connections are measurements without noise; its contacts are ignored.
    dt : float
        Time between two steps, s.
    sensors : sequence of Encoder, Gyro, Accelerometer, TorqueSensor, Contact, Pose
        Sensors with different names.
    q, qd : (..., nq), (..., nv)
        Initial estimate; qd is zero by default. Leading axes are robots that are observed together.
    torque_noise : (nv,) or float
        Density of the torque noise, (N m)^2 s. It includes friction that is not modeled. Zero for degrees of freedom
        without torque, such as a free joint.
    wrenches : sequence of ExternalWrench
        External wrenches to estimate.
    initial : (2 nv,) or (float, float)
        Initial standard deviations of q in its tangent space and of qd: two values, or one per component.
    history : int
        Number of past steps that smooth() covers.

    Attributes
    ----------
    names : tuple of str
        Names of the components of the error, in the order of the covariance.

    Raises
    ------
    ArgumentError, ShapeError, NotFiniteError
        An invalid argument, or an unknown or duplicate name. The message names the argument.

    Warns
    -----
    DivergenceWarning
        The innovations of a sensor over 100 steps are inconsistent with their covariance. The attribute `sensor` names
        the sensor without which the others are consistent.

    Examples
    --------
    >>> import numpy as np, phipsi
    >>> from phipsi.estimation import Encoder, ExternalWrench
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> tool, q = scene.link_names[-1], np.full(6, 0.5)
    >>> observer = scene.observer(
    ...     2e-3,
    ...     [Encoder(noise=1e-5)],
    ...     q=q,
    ...     torque_noise=1e-3,
    ...     wrenches=[ExternalWrench(tool, density=100.0)],
    ...     initial=(1e-4, 1e-4),
    ... )
    >>> held = scene.gravity_torque(q)
    >>> for _ in range(50):
    ...     estimate = observer.step(held, {"encoder": q})
    >>> estimate.wrenches[tool].shape, estimate.covariance.shape
    ((6,), (18, 18))
    >>> observer.smooth().q.shape
    (50, 6)
    """

    def __init__(
        self,
        scene: Scene,
        dt: float,
        sensors: Sequence[Sensor],
        *,
        q: ArrayLike,
        qd: ArrayLike | None = None,
        torque_noise: ArrayLike,
        wrenches: Sequence[ExternalWrench] = (),
        initial: Any = (0.1, 0.1),
        history: int = 1000,
    ) -> None:
        history = whole("history", history, 0, "a whole number of steps, zero or more")
        self.scene, self.dt, self.sensors, self.wrenches = scene, float(dt), tuple(sensors), tuple(wrenches)
        start_q = np.asarray(_core._numbers("q", q, scene, True))
        start_qd = np.asarray(_core._numbers("qd", np.zeros(scene.nv) if qd is None else qd, scene))
        check_shape("q", start_q, scene.nq)
        check_shape("qd", start_qd, scene.nv)
        self._batch = leading(start_q, start_qd)
        robots, nv = math.prod(self._batch), scene.nv
        refused = "found a number that is negative or not finite; expected zero or positive ones"
        density = each("torque_noise", torque_noise, nv, refused)
        #: Arguments of the compiled filter.
        self._settings = (
            self.dt,
            [self._checked(sensor) for sensor in self.sensors],
            density.tolist(),
            [self._process_of(wrench) for wrench in self.wrenches],
            self._initial(initial),
            history,
            (
                np.ascontiguousarray(np.broadcast_to(start_q, (*self._batch, scene.nq))).reshape(robots, scene.nq),
                np.ascontiguousarray(np.broadcast_to(start_qd, (*self._batch, nv))).reshape(robots, nv),
            ),
            self._batch,
        )
        self._filter = _core._Observer(scene, *self._settings)
        self._torque_deviation = np.sqrt(density / dt)
        self._decay, self._walk = self._filter.process()
        self._groups = joint_groups(scene)
        self._with_bias = [sensor for sensor in self.sensors if sensor.biases is not None]
        self.names = tuple(f"{kind}[{row}]" for kind in ("q", "qd") for row in range(nv))
        self.names += tuple(f"wrench on {wrench.link}[{i}]" for wrench in self.wrenches for i in range(6))
        self.names += tuple(f"bias of {sensor.name}[{i}]" for sensor in self._with_bias for i in range(3))
        self._places: dict[str, tuple[Sensor, slice]] = {}
        at = 0
        for sensor in self.sensors:
            size = sensor.size(scene)
            self._places[sensor.name] = sensor, slice(at, at + size)
            at += size
        self._none = np.full((*self._batch, at), np.nan)
        self._has_gates = any(np.any(np.asarray(sensor.gate) != 1.0) for sensor in self.sensors)
        #: Numbers of rejected readings in a window, (..., sensors).
        self._rejected = np.zeros((*self._batch, len(self.sensors)), int)

    def __getstate__(self) -> dict[str, Any]:
        """Attributes, with the state of the filter as numbers."""
        return self.__dict__ | {"_filter": self._filter.numbers()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Create the filter again, in its state."""
        self.__dict__.update(state)
        self._filter = _core._Observer(self.scene, *self._settings)
        self._filter.resume(state["_filter"])

    # Arguments

    def _checked(self, sensor: Sensor) -> tuple[Any, ...]:
        """Arguments of a sensor in compiled code."""
        if not isinstance(sensor, Sensor):
            raise of_argument(
                ArgumentError,
                "sensors",
                f"found {type(sensor).__name__}; expected Encoder, Gyro, Accelerometer, TorqueSensor, Contact or Pose"
                " of phipsi.estimation",
            )
        if sensor._kind is None or type(sensor).predict is not Sensor.predict:
            raise of_argument(
                ArgumentError,
                "sensors",
                f"found {type(sensor).__name__}, which has its own predict(); expected Encoder, Gyro, Accelerometer,"
                " TorqueSensor, Contact or Pose of phipsi.estimation, whose predictions are compiled",
            )
        return sensor._compiled(self.scene)

    def _process_of(self, wrench: ExternalWrench) -> tuple[Any, ...]:
        """Arguments of a wrench in compiled code."""
        refused = "found a number that is negative or not finite; expected zero or positive ones"

        def six(name: str, given: ArrayLike) -> list[float]:
            found = each(f"{name} of the wrench on {wrench.link!r}", given, 6, refused)
            return [float(number) for number in found]

        deviation = None if wrench.deviation is None else six("deviation", wrench.deviation)
        return wrench.link, six("density", wrench.density), float(wrench.correlation_time), deviation

    def _initial(self, initial: Any) -> list[float]:
        nv = self.scene.nv
        given = numbers("initial", initial)
        if given.shape == (2,) and nv != 1:
            given = np.repeat(given, nv)
        if given.shape != (2 * nv,):
            raise of_argument(ShapeError, "initial", f"found shape {given.shape}; expected two numbers, or {(2 * nv,)}")
        if not np.all(np.isfinite(given) & (given >= 0.0)):
            raise of_argument(
                ArgumentError,
                "initial",
                "found a standard deviation that is negative or not finite; expected zero or positive ones",
            )
        return [float(number) for number in given]

    def _readings(self, readings: Mapping[str, Any]) -> _Array:
        """Readings of all sensors, (..., m); NaN for missing readings."""
        found = self._none.copy()
        for name, given in readings.items():
            if name not in self._places:
                raise of_argument(
                    ArgumentError, "readings", f"found {name!r}; expected names of sensors: {', '.join(self._places)}"
                )
            if given is None:
                continue
            sensor, place = self._places[name]
            size = place.stop - place.start
            if isinstance(sensor, Contact):
                value = np.asarray(given)
                if value.dtype != bool:
                    raise of_argument(
                        ArgumentError,
                        f"readings[{name!r}]",
                        f"found {given!r}; expected True during contact, otherwise False or None",
                    )
                value = np.where(value[..., None], np.zeros(size), np.nan)
            elif isinstance(sensor, Pose):
                value = sensor._vector(given)
            else:
                # None stands for a missing component too.
                if isinstance(given, (list, tuple)):
                    given = [np.nan if one is None else one for one in given]
                value = numbers(f"readings[{name!r}]", given)
            if value.shape[-1:] != (size,):
                raise of_argument(
                    ShapeError, f"readings[{name!r}]", f"found shape {value.shape}; expected (..., {size})"
                )
            try:
                found[..., place] = value
            except ValueError:
                raise of_argument(
                    ShapeError,
                    f"readings[{name!r}]",
                    f"found shape {value.shape}; expected one that broadcasts to {(*self._batch, size)}",
                ) from None
            if np.isinf(found[..., place]).any():
                raise of_argument(
                    NotFiniteError,
                    f"readings[{name!r}]",
                    "found an infinity; expected finite readings, or NaN for missing ones",
                )
        return found

    # The filter

    def step(
        self,
        tau: ArrayLike,
        readings: Mapping[str, Any],
        *,
        dt: float | None = None,
        acting: Mapping[str, Any] | None = None,
    ) -> ObserverEstimate:
        """Process the readings of the present time, and advance by dt under the torques tau.

        Parameters
        ----------
        tau : (..., nv)
            Joint torques from the present time to the next, N m or N.
        readings : dict
            Readings (..., m) by sensor name; poses (..., 4, 4). A missing key, None or NaN means no reading. A reading
            of a sensor with a delay belongs to the time `delay` steps ago; readings of times before the first step are ignored.
        dt : float, optional
            Time to the next step, s; by default that of the observer. Delays remain numbers of steps.
        acting : dict, optional
            For the links of external wrenches, True if the wrench acts from the present time, (...). Without contact,
            False: the wrench is zero, without error. When it acts again, it has its initial deviation. By default, all
            wrenches act.

        Returns
        -------
        ObserverEstimate
            The estimate at the present time, its covariance, and the normalized innovation squared of the latest time
            with complete readings, which without delays is the present time.

        Raises
        ------
        ShapeError, NotFiniteError, ArgumentError
            An invalid argument. The message names the argument or the sensor.

        Examples
        --------
        >>> import phipsi
        >>> from phipsi.estimation import Encoder
        >>> scene = phipsi.scenes.chain(2)
        >>> observer = scene.observer(1e-3, [Encoder(noise=1e-4)], q=[0.0, 0.0], torque_noise=0.01)
        >>> observer.step([0.0, 0.0], {"encoder": [1e-3, 0.0]}).q.round(6)
        array([0.001, 0.   ])
        """
        scene, batch = self.scene, self._batch
        torque = np.asarray(_core._numbers("tau", tau, scene))
        if torque.shape != (*batch, scene.nv):
            try:
                torque = np.broadcast_to(torque, (*batch, scene.nv))
            except ValueError:
                raise of_argument(
                    ShapeError,
                    "tau",
                    f"found shape {torque.shape}; expected one that broadcasts to {(*batch, scene.nv)}",
                ) from None
        duration = self.dt if dt is None else float(numbers("dt", dt))
        flags = self._acting(acting or {})
        given = self._readings(readings)
        found, is_complete = self._filter.step(torque.ravel(), given.ravel(), duration, flags.ravel())
        q, qd, rest, covariance, nis, size, outliers = found
        rejected = {name: outliers[..., place] > 0.0 for name, (_, place) in self._places.items()}
        if self._has_gates:
            self._rejected = self._rejected + np.stack([own.sum(axis=-1) for own in rejected.values()], axis=-1)
        if is_complete and self.sensors:
            self._watch()
        return ObserverEstimate(q, qd, *self._named(rest), covariance, nis, size.astype(int), rejected)

    def _acting(self, acting: Mapping[str, Any]) -> _Array:
        """One for each wrench that acts, otherwise zero, (..., wrenches)."""
        links = [wrench.link for wrench in self.wrenches]
        found = np.ones((*self._batch, len(links)))
        for link, flag in acting.items():
            if link not in links:
                expected = f"expected links of wrenches: {', '.join(links) or 'none, there are no wrenches'}"
                raise of_argument(ArgumentError, "acting", f"found {link!r}; {expected}")
            value = np.asarray(flag)
            if value.dtype != bool:
                raise of_argument(ArgumentError, f"acting[{link!r}]", f"found {flag!r}; expected True or False")
            try:
                found[..., links.index(link)] = value
            except ValueError:
                expected = f"expected one that broadcasts to {self._batch}"
                raise of_argument(ShapeError, f"acting[{link!r}]", f"found shape {value.shape}; {expected}") from None
        return found

    def _named(self, rest: _Array) -> tuple[dict[str, _Array], dict[str, _Array]]:
        m = 6 * len(self.wrenches)
        wrenches = {wrench.link: rest[..., 6 * i : 6 * i + 6].copy() for i, wrench in enumerate(self.wrenches)}
        return wrenches, {
            sensor.name: rest[..., m + 3 * i : m + 3 * i + 3].copy() for i, sensor in enumerate(self._with_bias)
        }

    @property
    def _prior(self) -> State:
        """The estimate before the readings of the next step."""
        return State(*self._filter.prior())

    def _flow(self, state: State, tau: _Array) -> tuple[_Array, _Array]:
        """Accelerations, and their derivatives by state and torque noise, (nv, n + nv), for tests."""
        *_, qdd, by_error = self._filter.transition(state.q, state.qd, state.rest, tau)
        return qdd, by_error

    def _predict(self, state: State, noise: _Array, record: Record) -> State:
        """The next state without readings, and [F B] into the record, for tests."""
        q, qd, rest, record.flow, *_ = self._filter.transition(state.q, state.qd, state.rest, record.tau + noise)
        return State(q, qd, rest, state.root)

    # Divergence

    def _watch(self) -> None:
        """Warn if innovations of a sensor in a window are inconsistent with their covariance."""
        sums = np.array(self._filter.window())
        if self._has_gates:
            self._warn_of_gates(sums[..., 1])
        ratios = innovation_ratios(sums)
        if np.all(ratios <= 1.0):
            return
        robot, sensor, state = self._largest(ratios)
        self._warn(float(ratios[robot, sensor]), sensor, robot, state)

    def _largest(self, of_sensors: _Array) -> tuple[int, int, tuple[int, ...]]:
        """Robot and sensor of the largest value, (robots, sensors), and the index of the robot in the batch."""
        robot, sensor = map(int, np.unravel_index(int(np.argmax(of_sensors)), of_sensors.shape))
        state = tuple(map(int, np.unravel_index(robot, self._batch))) if self._batch else ()
        return robot, sensor, state

    def _warn_of_gates(self, processed: _Array) -> None:
        """Warn if gates rejected most readings of a sensor in a window: the filter may follow a wrong estimate."""
        rejected = self._rejected.reshape(processed.shape)
        self._rejected = np.zeros_like(self._rejected)
        if np.all(rejected <= processed):
            return
        robot, sensor, state = self._largest(rejected - processed)
        name, place = self.sensors[sensor].name, f" of robot {state}" if state else ""
        count = int(rejected[robot, sensor])
        warning = DivergenceWarning(
            f"sensor {name!r}{place}: its gate rejected {count} of {count + int(processed[robot, sensor])} readings in"
            f" {WINDOW} steps: the estimate or the noise is wrong; increase gate or noise, or create the observer again"
        )
        warning.sensor, warning.state = name, state
        warn(warning)

    def _warn(self, ratio: float, sensor: int, robot: int, state: tuple[int, ...]) -> None:
        """Warn about divergence, and name the sensor without which the other sensors are most consistent.

        A faulty sensor also increases the innovations of the other sensors.
        """
        names, found = [own.name for own in self.sensors], {}
        name, robots = names[sensor], math.prod(self._batch)
        for left_out, _ in enumerate(names if len(names) > 1 else ()):
            ratios = innovation_ratios(np.array([self._filter.window_without(robot, left_out)]), robots)
            found[names[left_out]] = float(max(np.delete(ratios[0], left_out)))
        best = min(found, key=found.__getitem__) if found else name
        alone = not found or found[best] <= 1.0
        place = f" of robot {state}" if state else ""
        if alone:
            what = (
                f"sensor {best!r}{place}: its readings do not agree with the others and the model"
                if found
                else f"sensor {best!r}{place}: its readings do not agree with the model"
            )
            fix = "its noise, delay, bias, units or frame differ from the settings; increase its noise, or remove it"
        else:
            best, what = (
                name,
                f"sensor {name!r}{place}: its innovations are the largest, and no single sensor explains them",
            )
            fix = "torques, torque_noise, wrenches or the model differ from the robot; increase torque_noise"
        warning = DivergenceWarning(
            f"{what}: innovations squared of the last {WINDOW} steps are {ratio:.3g} times the largest value that noise"
            f" explains: {fix}"
        )
        warning.sensor, warning.state = best, state
        warn(warning)

    # The smoother

    def smooth(self) -> SmoothedMotion:
        """Smooth the last `history` steps: estimate each from the readings of all of them (fixed-interval smoother).

        Returns
        -------
        SmoothedMotion
            Times, states, wrenches, biases and covariances; the first axis is time.

        Raises
        ------
        ArgumentError
            Before the first step, or with history=0.

        Examples
        --------
        >>> import phipsi
        >>> from phipsi.estimation import Encoder
        >>> scene = phipsi.scenes.chain(2)
        >>> observer = scene.observer(1e-3, [Encoder(noise=1e-4)], q=[0.0, 0.0], torque_noise=0.01)
        >>> for _ in range(10):
        ...     estimate = observer.step([0.0, 0.0], {"encoder": [0.0, 0.0]})
        >>> observer.smooth().covariance.shape
        (10, 4, 4)
        """
        (q, qd, rest, covariance), time = self._filter.smooth()
        wrenches, biases = self._named(rest)
        return SmoothedMotion(time, q, qd, wrenches, biases, covariance)
