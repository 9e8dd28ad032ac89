"""Square-root error-state Kalman filter of the motion of a robot on its manifold, and fixed-interval smoother.

The state is (q, qd, wrenches, biases). Its error e is a tangent vector, truth = estimate (+) e, where (+) on q is
Scene.integrate. The filter propagates a root L of the covariance, P = L L*, by orthogonal transformations from the
right; it never subtracts covariances. The torque noise n of a step is part of the state during the update, because
accelerometers measure its effect. The prediction removes it from the state.
"""

from __future__ import annotations

import math
import warnings
from collections import deque
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..errors import ArgumentError, DivergenceWarning, NotFiniteError, ShapeError, of_argument
from ._manifold import exponential, joint_groups, lower_root
from ._records import Record, State, innovation_ratios, nonnegative
from .motion import ExternalWrench, ObserverEstimate, SmoothedMotion
from .sensors import Contact, Sensor

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["Observer"]

_Array = NDArray[np.float64]

#: Number of steps of a divergence test.
WINDOW = 100
#: Relative singular value below which a direction of a root counts as zero variance.
SINGULAR = 1e-12


class Observer:
    """Error-state Kalman filter of joint motion, external wrenches and sensor biases; see Scene.observer.

    Each step processes the readings of the present time, then advances by dt: a = FD(q, qd, tau + n, w), qd + dt a, and
    q (+) dt (qd + dt a). Readings are linearized at the prediction. The model does not include damping, friction and
    springs of the scene: add their torques to tau, and their uncertainty to torque_noise.

    Parameters
    ----------
    scene : Scene
        The robot, without connections, contacts and joints that follow others.
    dt : float
        Time between two steps, s.
    sensors : sequence of Encoder, Gyro, Accelerometer, TorqueSensor, Contact
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
        if not (np.isfinite(dt) and dt > 0.0):
            raise of_argument(ArgumentError, "dt", f"found {dt}; expected a time in s, finite and positive")
        if not (history == int(history) and history >= 0):
            raise of_argument(
                ArgumentError, "history", f"found {history}; expected a whole number of steps, zero or more"
            )
        self.scene, self.dt, self.sensors, self.wrenches = scene, float(dt), tuple(sensors), tuple(wrenches)
        self._check_sensors()
        start_q = np.array(_core._numbers("q", q, scene, True))
        start_qd = np.array(_core._numbers("qd", np.zeros(scene.nv) if qd is None else qd, scene))
        batch = np.broadcast_shapes(start_q.shape[:-1], start_qd.shape[:-1])
        density = nonnegative("torque_noise", torque_noise, scene.nv)
        self._torque_deviation = np.sqrt(density / dt)
        self._with_bias = [sensor for sensor in self.sensors if sensor.biases is not None]
        self._groups = joint_groups(scene)
        nv = scene.nv
        self.names = tuple(f"{kind}[{row}]" for kind in ("q", "qd") for row in range(nv))
        self.names += tuple(f"wrench on {wrench.link}[{i}]" for wrench in self.wrenches for i in range(6))
        self.names += tuple(f"bias of {sensor.name}[{i}]" for sensor in self._with_bias for i in range(3))
        deviations = [self._initial(initial)]
        decay: list[_Array] = []
        walk: list[_Array] = []
        for wrench in self.wrenches:
            own = self._wrench_process(wrench)
            for found, part in zip((decay, walk, deviations), own, strict=True):
                found.append(part)
        for sensor in self._with_bias:
            start, growth = sensor.biases or (0.0, 0.0)
            for found, number in zip((decay, walk, deviations), (1.0, growth * math.sqrt(dt), start), strict=True):
                found.append(np.full(3, number))
        self._decay = np.concatenate([*decay, np.zeros(0)])
        self._walk = np.concatenate([*walk, np.zeros(0)])
        root = np.diag(np.concatenate(deviations))
        n = len(root)
        self._prior = State(
            np.broadcast_to(start_q, (*batch, scene.nq)).copy(),
            np.broadcast_to(start_qd, (*batch, nv)).copy(),
            np.zeros((*batch, n - 2 * nv)),
            np.broadcast_to(root, (*batch, n, n)).copy(),
        )
        self._lag = max((sensor.delay for sensor in self.sensors), default=0)
        self._pending: list[Record] = []
        self._history: deque[Record] = deque(maxlen=int(history))
        self._steps = 0
        self._window: list[Record] = []
        self._window_prior = self._prior

    # Arguments

    def _check_sensors(self) -> None:
        seen: set[str] = set()
        for sensor in self.sensors:
            if not isinstance(sensor, Sensor):
                raise of_argument(
                    ArgumentError,
                    "sensors",
                    f"found {type(sensor).__name__}; expected Encoder, Gyro, Accelerometer, TorqueSensor or Contact of"
                    " phipsi.estimation",
                )
            if sensor.name in seen:
                raise of_argument(
                    ArgumentError,
                    "sensors",
                    f'found two sensors with the name {sensor.name!r}; expected different names: name="..."',
                )
            seen.add(sensor.name)
            if not (sensor.delay == int(sensor.delay) and sensor.delay >= 0):
                raise of_argument(
                    ArgumentError,
                    f"delay of {sensor.name!r}",
                    f"found {sensor.delay}; expected a whole number of steps, zero or more",
                )
            noise = np.asarray(sensor.noise, float)
            size = sensor.size(self.scene)
            if noise.shape not in ((), (size,)) or not np.all(np.isfinite(noise) & (noise > 0.0)):
                raise of_argument(
                    ArgumentError,
                    f"noise of {sensor.name!r}",
                    f"found {sensor.noise!r}; expected a standard deviation, one number or {size}, finite and positive",
                )
            for deviation in sensor.biases or ():
                if not (np.isfinite(deviation) and deviation >= 0.0):
                    raise of_argument(
                        ArgumentError,
                        f"bias of {sensor.name!r}",
                        f"found {deviation}; expected standard deviations, zero or positive",
                    )

    def _initial(self, initial: Any) -> _Array:
        nv = self.scene.nv
        given = np.asarray(initial, float)
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
        return given

    def _wrench_process(self, wrench: ExternalWrench) -> tuple[_Array, _Array, _Array]:
        """Decay factor, added and initial standard deviations, (6,) each."""
        self.scene.link(wrench.link)
        if [other.link for other in self.wrenches].count(wrench.link) > 1:
            raise of_argument(
                ArgumentError, "wrenches", f"found two wrenches on the link {wrench.link!r}; expected one"
            )
        density = nonnegative(f"density of the wrench on {wrench.link!r}", wrench.density, 6)
        time = wrench.correlation_time
        if not time > 0.0:
            raise of_argument(
                ArgumentError, "correlation_time", f"found {time}; expected a time in s, positive or infinite"
            )
        walks = math.isinf(time)
        decay = 1.0 if walks else math.exp(-self.dt / time)
        added = density * self.dt if walks else -0.5 * density * time * math.expm1(-2.0 * self.dt / time)
        start = np.zeros(6) if walks else np.sqrt(0.5 * density * time)
        if wrench.deviation is not None:
            start = np.sqrt(nonnegative(f"deviation of the wrench on {wrench.link!r}", np.square(wrench.deviation), 6))
        return np.full(6, decay), np.sqrt(added), start

    def _readings(self, readings: Mapping[str, Any]) -> dict[str, _Array]:
        """Readings by sensor name, (..., m); NaN for missing readings."""
        known = {sensor.name: sensor for sensor in self.sensors}
        for name in readings:
            if name not in known:
                raise of_argument(
                    ArgumentError, "readings", f"found {name!r}; expected names of sensors: {', '.join(known)}"
                )
        found = {}
        batch = self._prior.q.shape[:-1]
        for name, sensor in known.items():
            size = sensor.size(self.scene)
            given = readings.get(name)
            value = np.full(size, np.nan) if given is None else np.asarray(given)
            if isinstance(sensor, Contact) and given is not None:
                if value.dtype != bool:
                    raise of_argument(
                        ArgumentError,
                        f"readings[{name!r}]",
                        f"found {given!r}; expected True during contact, otherwise False or None",
                    )
                value = np.where(value[..., None], np.zeros(size), np.nan)
            value = np.asarray(value, float)
            if value.shape[-1:] != (size,):
                raise of_argument(
                    ShapeError, f"readings[{name!r}]", f"found shape {value.shape}; expected (..., {size})"
                )
            if np.any(np.isinf(value)):
                raise of_argument(
                    NotFiniteError,
                    f"readings[{name!r}]",
                    "found an infinity; expected finite readings, or NaN for missing ones",
                )
            try:
                found[name] = np.broadcast_to(value, (*batch, size))
            except ValueError:
                raise of_argument(
                    ShapeError,
                    f"readings[{name!r}]",
                    f"found shape {value.shape}; expected one that broadcasts to {(*batch, size)}",
                ) from None
        return found

    # The filter

    def step(self, tau: ArrayLike, readings: Mapping[str, Any]) -> ObserverEstimate:
        """Process the readings of the present time, and advance by dt under the torques tau.

        Parameters
        ----------
        tau : (..., nv)
            Joint torques from the present time to the next, N m or N.
        readings : dict
            Readings (..., m) by sensor name. A missing key, None or NaN means no reading. A reading of a sensor with a
            delay belongs to the time `delay` steps ago; readings of times before the first step are ignored.

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
        scene, batch = self.scene, self._prior.q.shape[:-1]
        torque = np.asarray(_core._numbers("tau", tau, scene))
        try:
            torque = np.broadcast_to(torque, (*batch, scene.nv))
        except ValueError:
            raise of_argument(
                ShapeError, "tau", f"found shape {torque.shape}; expected one that broadcasts to {(*batch, scene.nv)}"
            ) from None
        present = self._readings(readings)
        self._pending.append(Record(torque.copy(), {}))
        for sensor in self.sensors:
            if sensor.delay < len(self._pending):
                self._pending[-1 - sensor.delay].readings[sensor.name] = present[sensor.name]
        # Delayed readings change past estimates: filter all later times again.
        state = self._prior
        for record in self._pending:
            state = self._through(state, record)
        last, complete = self._pending[-1], None
        if len(self._pending) > self._lag:
            complete = self._pending.pop(0)
            assert complete.after is not None
            self._prior = complete.after
            self._history.append(complete)
            self._watch(complete)
        self._steps += 1
        assert last.state is not None
        nis = np.full(batch, np.nan) if complete is None else complete.nis
        size = np.zeros(batch, int) if complete is None else complete.size
        wrenches, biases = self._named(last.state.rest)
        covariance = last.state.root @ np.swapaxes(last.state.root, -1, -2)
        return ObserverEstimate(
            last.state.q.copy(), last.state.qd.copy(), wrenches, biases, covariance, np.asarray(nis), np.asarray(size)
        )

    def _through(self, prior: State, record: Record) -> State:
        """Update by the readings of a record, then predict the next time."""
        updated, noise = self._update(prior, record)
        after = self._predict(updated, noise, record)
        record.after = after
        return after

    def _named(self, rest: _Array) -> tuple[dict[str, _Array], dict[str, _Array]]:
        m = 6 * len(self.wrenches)
        wrenches = {wrench.link: rest[..., 6 * i : 6 * i + 6].copy() for i, wrench in enumerate(self.wrenches)}
        return wrenches, {
            sensor.name: rest[..., m + 3 * i : m + 3 * i + 3].copy() for i, sensor in enumerate(self._with_bias)
        }

    def _flow(self, state: State, tau: _Array) -> tuple[_Array, _Array]:
        """Accelerations, and their derivatives by state and torque noise, (..., nv, n + nv)."""
        scene = self.scene
        wrenches, _ = self._named(state.rest)
        qdd = scene.forward_dynamics(state.q, state.qd, tau, wrenches=wrenches or None)
        by_q, by_qd, inverse = scene.forward_dynamics_derivatives(state.q, state.qd, tau, wrenches=wrenches or None)[:3]
        by_wrench = [inverse @ np.swapaxes(scene.jacobian(state.q, link), -1, -2) for link in wrenches]
        by_bias = np.zeros((*qdd.shape, 3 * len(self._with_bias)))
        return qdd, np.concatenate([by_q, by_qd, *by_wrench, by_bias, inverse], axis=-1)

    def _update(self, prior: State, record: Record) -> tuple[State, _Array]:
        scene, nv, n = self.scene, self.scene.nv, prior.root.shape[-1]
        batch = prior.q.shape[:-1]
        widened = np.zeros((*batch, n + nv, n + nv))
        widened[..., :n, :n] = prior.root
        widened[..., np.arange(n, n + nv), np.arange(n, n + nv)] = self._torque_deviation
        flow = qdd = None
        rows, errors, deviations, spans = [], [], [], []
        at = 0
        for sensor in self.sensors:
            reading = record.readings.get(sensor.name)
            if reading is None:
                continue
            seen = ~np.isnan(reading)
            if not seen.any():
                continue
            if sensor.needs_acceleration and flow is None:
                qdd, flow = self._flow(prior, record.tau)
            predicted = sensor.predict(scene, self._groups, (prior.q, prior.qd, qdd), record.tau)
            size = reading.shape[-1]
            own = np.zeros((*batch, size, n + nv))
            own[..., :nv], own[..., nv : 2 * nv] = predicted.by_q, predicted.by_qd
            if predicted.by_qdd is not None and flow is not None:
                own += predicted.by_qdd @ flow
            if predicted.by_noise is not None:
                own[..., n:] += predicted.by_noise
            error = reading - predicted.value
            if sensor in self._with_bias:
                place = 6 * len(self.wrenches) + 3 * self._with_bias.index(sensor)
                own[..., :, 2 * nv + place : 2 * nv + place + 3] += np.eye(3)
                error = error - prior.rest[..., place : place + 3]
            rows.append(np.where(seen[..., None], own, 0.0))
            errors.append(np.where(seen, error, 0.0))
            deviations.append(np.where(seen, np.broadcast_to(sensor.noise, (size,)), 1.0))
            spans.append((sensor.name, slice(at, at + size), seen.sum(axis=-1)))
            at += size
        record.nis, record.size, record.by_sensor = np.zeros(batch), np.zeros(batch, int), {}
        if not rows:
            record.state, record.root, record.noise = prior, widened, np.zeros((*batch, nv))
            return prior, record.noise
        h, e, r = np.concatenate(rows, axis=-2), np.concatenate(errors, axis=-1), np.concatenate(deviations, axis=-1)
        before = np.zeros((*batch, at + n + nv, at + n + nv))
        before[..., np.arange(at), np.arange(at)] = r
        before[..., :at, at:] = h @ widened
        before[..., at:, at:] = widened
        after = lower_root(before)
        root, gain, left = after[..., :at, :at], after[..., at:, :at], after[..., at:, at:]
        white = np.linalg.solve(root, e[..., None])[..., 0]
        change = np.einsum("...ij,...j->...i", gain, white)
        for name, span, count in spans:
            marginal = root[..., span, :]
            own = e[..., span]
            value = np.einsum(
                "...i,...i->...", own, np.linalg.solve(marginal @ np.swapaxes(marginal, -1, -2), own[..., None])[..., 0]
            )
            record.by_sensor[name] = (value, count)
        record.nis = np.sum(white**2, axis=-1)
        record.size = np.asarray(sum(count for _, _, count in spans))
        state = self._corrected(prior, change[..., :n], left)
        record.state, record.root, record.noise = state, state.root, change[..., n:]
        # Root of the state without the torque noise, whose estimate remains in the record.
        state = state._replace(root=lower_root(state.root[..., :n, :]))
        record.state = state
        return state, record.noise

    def _corrected(self, prior: State, change: _Array, root: _Array) -> State:
        """Apply a correction to the state, and transport the error to the tangent space at the new q, to first
        order."""
        nv = self.scene.nv
        _, right = exponential(self._groups, change[..., :nv])
        root = root.copy()
        root[..., :nv, :] = right @ root[..., :nv, :]
        q = self.scene.integrate(prior.q, change[..., :nv])
        return State(q, prior.qd + change[..., nv : 2 * nv], prior.rest + change[..., 2 * nv :], root)

    def _predict(self, state: State, noise: _Array, record: Record) -> State:
        scene, nv, h = self.scene, self.scene.nv, self.dt
        n = 2 * nv + state.rest.shape[-1]
        qdd, by_all = self._flow(state, record.tau + noise)
        qd = state.qd + h * qdd
        back, right = exponential(self._groups, h * qd)
        flow = np.zeros((*qd.shape[:-1], n, n + nv))
        flow[..., nv : 2 * nv, :] = h * by_all
        flow[..., np.arange(nv, 2 * nv), np.arange(nv, 2 * nv)] += 1.0
        flow[..., :nv, :] = h * (right @ flow[..., nv : 2 * nv, :])
        flow[..., :nv, :nv] += back
        rest = np.arange(2 * nv, n)
        flow[..., rest, rest] = self._decay
        assert record.root is not None
        added = np.zeros((*qd.shape[:-1], n, len(rest)))
        added[..., rest, rest - 2 * nv] = self._walk
        root = lower_root(np.concatenate([flow @ record.root, added], axis=-1))
        record.flow = flow
        return State(scene.integrate(state.q, h * qd), qd, self._decay * state.rest, root)

    # Divergence

    def _watch(self, record: Record) -> None:
        """After each window of steps, warn if innovations of a sensor are inconsistent with their covariance."""
        self._window.append(record)
        if len(self._window) < WINDOW:
            return
        worst: tuple[float, str, tuple[int, ...]] | None = None
        for sensor in self.sensors:
            ratio = innovation_ratios(self._window, [sensor.name], self._prior.q.shape[:-1])
            state = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
            if not ratio[state] <= 1.0 and (worst is None or ratio[state] > worst[0]):
                worst = (float(ratio[state]), sensor.name, tuple(map(int, state)))
        if worst is not None:
            self._warn(*worst)
        self._window, self._window_prior = [], self._prior

    def _warn(self, ratio: float, name: str, state: tuple[int, ...]) -> None:
        """Warn about divergence, and name the sensor without which the other sensors are most consistent.

        A faulty sensor also increases the innovations of the other sensors.
        """
        others, found = [sensor.name for sensor in self.sensors], {}
        for left_out in others if len(others) > 1 else ():
            prior, records = self._window_prior, []
            for record in self._window:
                again = Record(record.tau, {key: value for key, value in record.readings.items() if key != left_out})
                prior = self._through(prior, again)
                records.append(again)
            batch = self._prior.q.shape[:-1]
            ratios = [innovation_ratios(records, [other], batch)[state] for other in others if other != left_out]
            found[left_out] = float(max(ratios))
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
        warnings.warn(warning, stacklevel=4)

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
        records = [*self._history, *self._pending]
        if not records:
            raise of_argument(
                ArgumentError,
                "history",
                "found no step to smooth; expected step() before smooth(), and history above zero",
            )
        last = records[-1].state
        assert last is not None
        found = [last]
        for record in reversed(records[:-1]):
            found.append(self._smoothed(record, found[-1]))
        found.reverse()
        begin = self._steps - len(records)
        wrenches, biases = self._named(np.stack([state.rest for state in found]))
        roots = np.stack([state.root for state in found])
        return SmoothedMotion(
            np.arange(begin, self._steps) * np.float64(self.dt),
            np.stack([state.q for state in found]),
            np.stack([state.qd for state in found]),
            wrenches,
            biases,
            roots @ np.swapaxes(roots, -1, -2),
        )

    def _smoothed(self, record: Record, later: State) -> State:
        """Smooth one time from the smoothed state of the next: G = P [F B]* P1^-1, and P as a sum of squares."""
        state, root, flow, predicted = record.state, record.root, record.flow, record.after
        assert state is not None and root is not None and flow is not None and predicted is not None
        nv, n = self.scene.nv, state.root.shape[-1]
        carried = flow @ root
        # P1 = L1 L1*: rows are normalized, so that zero variance is distinguished from small variance.
        size = np.linalg.norm(predicted.root, axis=-1, keepdims=True)
        size = np.where(size > 0.0, size, 1.0)
        inverse = np.linalg.pinv(predicted.root / size, rcond=SINGULAR)
        backward = (inverse @ (carried / size)) @ np.swapaxes(root[..., :n, :], -1, -2)
        gain = np.swapaxes(inverse, -1, -2) @ backward
        gain = np.swapaxes(gain / size, -1, -2)
        moved = np.concatenate(
            [self.scene.difference(predicted.q, later.q), later.qd - predicted.qd, later.rest - predicted.rest], axis=-1
        )
        added = np.zeros((*state.qd.shape[:-1], n, n - 2 * nv))
        added[..., np.arange(2 * nv, n), np.arange(n - 2 * nv)] = self._walk
        whole = np.concatenate([root[..., :n, :] - gain @ carried, gain @ added, gain @ later.root], axis=-1)
        return self._corrected(state, np.einsum("...ij,...j->...i", gain, moved), lower_root(whole))
