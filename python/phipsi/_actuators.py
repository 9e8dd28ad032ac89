"""Actuators of a scene: maps from controls to joint torques, and the control law of a simulation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from ._motion_parts import PD
from ._recorded import torques
from .errors import ArgumentError, ModelWarning, NotFiniteError, ShapeError, SimulationError, SimulationInterrupted, known_names, of_argument, warn

if TYPE_CHECKING:
    from ._core import Scene, Simulator
    from ._motion import Trajectory
    from ._results import RolloutGradients

__all__ = ["Actuator", "Actuators"]

_Array = NDArray[np.float64]


class Actuator(NamedTuple):
    """An actuator: torque = gear force, with force = gain · (1, l, v) u + bias · (1, l, v), clipped to forcerange, for the
    length l = gear q and its rate v = gear qd. The input u is the control, clipped to ctrlrange, or the activation.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.scenes.chain(1).to_builder().actuator("servo", "j0", kp=20.0, kv=2.0, gear=3.0).build()
    >>> scene.actuators["servo"].kind, scene.actuators["servo"].kp
    ('position', 20.0)
    """

    name: str
    """Name of the actuator."""
    joint: str
    """Name of its joint."""
    gear: float
    """Joint torque per force."""
    gain: tuple[float, float, float]
    """Coefficients of the input: constant, by length, by velocity."""
    bias: tuple[float, float, float]
    """Force without input: constant, by length, by velocity."""
    ctrlrange: tuple[float, float]
    """Smallest and largest control; infinite without limits."""
    forcerange: tuple[float, float]
    """Smallest and largest force; infinite without limits."""
    torquerange: tuple[float, float]
    """Smallest and largest torque of all actuators of the joint together (actuatorfrcrange), N m or N."""
    timeconst: float | None
    """Time constant of the activation, s; inf: an integrator; None: no activation, the input is the control."""
    actrange: tuple[float, float]
    """Smallest and largest activation."""

    @property
    def kp(self) -> float:
        """Gain of a position servo."""
        return -self.bias[1]

    @property
    def kv(self) -> float:
        """Gain of the velocity."""
        return -self.bias[2]

    @property
    def kind(self) -> str:
        """"motor", "position", "velocity", "damper" or "general", with " of an integral" or " of a filter" for those with
        an activation.
        """
        constant, stiffness, speed = self.bias
        kind = "general"
        if self.gain[1:] == (0.0, 0.0) and constant == 0.0:
            if stiffness == speed == 0.0:
                kind = "motor"
            elif self.gain[0] == -stiffness:
                kind = "position"
            elif stiffness == 0.0 and self.gain[0] == -speed:
                kind = "velocity"
        elif self.bias == (0.0, 0.0, 0.0) and self.gain[:2] == (0.0, 0.0):
            kind = "damper"
        if self.timeconst is None:
            return kind
        return f"{kind} of {'an integral' if np.isinf(self.timeconst) else 'a filter'}"


class Law(NamedTuple):
    """Control law of inputs: joint torques clip(kp (target - q) + kd (rate - qd), limits) + tau."""

    kp: _Array
    kd: _Array
    target: _Array
    """Target configurations, (..., nq)."""
    rate: _Array
    tau: _Array


class Actuators(Sequence[Actuator]):
    """Actuators of a scene, in the order of the controls: Scene.actuators.

    Examples
    --------
    >>> import phipsi
    >>> builder = phipsi.scenes.chain(2).to_builder().actuator("hip", "j0", gear=50.0).actuator("knee", "j1", kp=100.0, kv=10.0)
    >>> builder.build().actuators
    name  joint  kind      gear  kp   kv  ctrlrange  forcerange
    hip   j0     motor     50    0    0   -          -
    knee  j1     position  1     100  10  -          -
    """

    def __init__(self, scene: Scene, given: list[tuple[Any, ...]]) -> None:
        self.scene = scene
        known = set(scene.joint_names)
        #: Actuators that a scene cannot represent, by name, with the reason.
        self.unsupported: dict[str, str] = {}
        found, keys = [], []
        for name, joint, gear, gain, bias, (control, force, torque), activation, keyframes, reason in given:
            if reason is None and joint not in known:
                reason = f"whose joint {joint!r} follows another one (mimic)"
            if reason is not None:
                self.unsupported[name] = reason
                continue
            time, active = activation or (None, [-np.inf, np.inf])
            found.append(Actuator(name, joint, gear, tuple(gain), tuple(bias), tuple(control), tuple(force), tuple(torque), time, tuple(active)))
            keys.append(keyframes)
        self._all = tuple(found)
        #: Names of the actuators.
        self.names = tuple(one.name for one in found)
        #: Name of the joint of each actuator.
        self.joints = tuple(one.joint for one in found)
        count = len(found)
        #: Gear ratio of each actuator, (n,): joint torque per force.
        self.gear = np.array([one.gear for one in found])
        #: Smallest and largest control of each actuator, (n, 2).
        self.ctrlrange = np.array([one.ctrlrange for one in found]).reshape(count, 2)
        #: Smallest and largest force of each actuator before the gear ratio, (n, 2).
        self.forcerange = np.array([one.forcerange for one in found]).reshape(count, 2)
        #: Controls of each keyframe, (n,), and activations, (n,), by its name.
        self.keyframes, self.keyframe_activations = (
            {key: np.array([of.get(key, (0.0, 0.0))[part] for of in keys]) for key in scene.keyframes} for part in (0, 1)
        )
        self._gain, self._bias = (np.array([getattr(one, what) for one in found]).reshape(count, 3) for what in ("gain", "bias"))
        self._rows = np.array([scene.v_index(joint).start for joint in self.joints], dtype=np.intp)
        self._columns = np.array([scene.q_index(joint).start for joint in self.joints], dtype=np.intp)
        self._times = np.array([np.nan if one.timeconst is None else one.timeconst for one in found])
        self._actrange = np.array([one.actrange for one in found]).reshape(count, 2)
        #: Whether each actuator has an activation, (n,).
        self.has_activation = ~np.isnan(self._times)
        self._neutral = np.asarray(scene.neutral())
        self._plan()

    def _plan(self) -> None:
        """Determine how the torques of each joint are clipped: clip(servos + motors, limits) where no servo has a range of
        its own, and clip(servo, limits) + motors elsewhere.
        """
        nv = self.scene.nv
        effort = np.asarray(self.scene.limits.effort)
        #: Smallest and largest torque of all actuators of a joint together, (2, nv).
        self._joint_limits = np.stack([-effort, effort])
        for one, row in zip(self._all, self._rows, strict=True):
            self._joint_limits[:, row] = np.clip(self._joint_limits[:, row], *one.torquerange)
        #: Actuators whose force depends on the state, (n,), and joints that have one, (nv,).
        self._servo = np.any(self._gain[:, 1:] != 0.0, axis=1) | np.any(self._bias[:, 1:] != 0.0, axis=1)
        self._has_servo, self._adds = np.zeros(nv, bool), np.zeros(nv, bool)
        self._has_servo[self._rows[self._servo]] = True
        self._limits, self._conflicts = self._joint_limits.copy(), list[str]()
        with np.errstate(invalid="ignore"):
            own = np.sort(np.nan_to_num(self.gear[:, None] * self.forcerange, posinf=np.inf, neginf=-np.inf), axis=1)
        for row in np.flatnonzero(self._has_servo).tolist():
            here = self._rows == row
            servos, (low, high), sums = np.flatnonzero(here & self._servo), self._limits[:, row], own[here].sum(axis=0)
            bounded = [at for at in servos.tolist() if np.isfinite(own[at]).any()]
            if not bounded:
                continue
            name, joint = self.names[bounded[0]], self.joints[bounded[0]]
            self._adds[row] = here.sum() > 1
            self._limits[:, row] = own[bounded[0]] if self._adds[row] else np.clip(own[bounded[0]], low, high)
            if len(servos) > 1:
                self._conflicts.append(f"{len(servos)} servos at the joint {joint!r}, of which {name!r} has a force range; expected a range of the joint, or one servo")
            elif self._adds[row] and (sums[0] < low - 1e-9 * abs(low) or sums[1] > high + 1e-9 * abs(high)):
                self._conflicts.append(f"{name!r} with a force range, and a motor at the joint {joint!r}, which limits their sum; expected one of the ranges")
        for at in np.flatnonzero(self._servo).tolist():
            if np.isfinite(self._limits[:, self._rows[at]]).sum() == 1:
                self._conflicts.append(f"{self.names[at]!r} with a torque that is limited in one direction, {self._limits[:, self._rows[at]].tolist()}; expected two finite limits, or none")
        # The limits of a control law are symmetric; the center of an interval is a constant torque.
        is_limited = np.isfinite(self._limits).all(axis=0) & self._has_servo
        with np.errstate(invalid="ignore"):
            self._center = np.where(is_limited, self._limits.mean(axis=0), 0.0)
            self._effort = np.where(is_limited, 0.5 * (self._limits[1] - self._limits[0]), np.inf)
        self._limits -= self._center
        # Sums of the torques of actuators over joints, (n, nv): within the limits of the servo, and beside it.
        each = np.zeros((len(self), nv))
        each[np.arange(len(self)), self._rows] = 1.0
        self.has_servos = bool(self._servo.any())
        is_beside = self._adds & ~self._servo[:, None]
        self._within, self._beside = each * ~is_beside, each * is_beside
        #: Whether some torques are constant during a step.
        self.has_torques = bool(self._beside.any() or self._center.any() or not self._servo.all() or np.any(self._gain[:, 1:]))
        #: Gains that do not depend on controls; None if they do.
        self._gains: tuple[_Array, ...] | None = None
        if not np.any(self._gain[:, 1:]) and not self._conflicts:
            self._gains = self._gains_of(np.zeros(len(self)))

    def __len__(self) -> int:
        """Number of actuators."""
        return len(self._all)

    @overload
    def __getitem__(self, at: int | str) -> Actuator: ...
    @overload
    def __getitem__(self, at: slice) -> tuple[Actuator, ...]: ...
    def __getitem__(self, at: int | str | slice) -> Actuator | tuple[Actuator, ...]:
        """An actuator by index or name, or a tuple of several."""
        return self._all[self._place("actuator", at) if isinstance(at, str) else at]

    def __iter__(self) -> Iterator[Actuator]:
        """The actuators, in the order of the controls."""
        return iter(self._all)

    def __repr__(self) -> str:
        def text(ends: tuple[float, float]) -> str:
            return "-" if np.isinf(ends).all() else f"{ends[0]:g}, {ends[1]:g}"

        rows: list[tuple[str, ...]] = [("name", "joint", "kind", "gear", "kp", "kv", "ctrlrange", "forcerange")]
        for one in self._all:
            numbers = (f"{value + 0.0:g}" for value in (one.gear, one.kp, one.kv))
            rows.append((one.name, one.joint, one.kind, *numbers, text(one.ctrlrange), text(one.forcerange)))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
        lines += [f"not supported: {name!r}, {reason}" for name, reason in self.unsupported.items()]
        return "\n".join(lines if self._all else ["no actuators", *lines[1:]])

    def _place(self, argument: str, name: str) -> int:
        if name in self.unsupported:
            raise of_argument(ArgumentError, argument, f"found {name!r}, {self.unsupported[name]}; expected an actuator that is supported")
        if name not in self.names:
            raise of_argument(ArgumentError, argument, f"found {name!r}; expected names of {known_names(name, self.names) or 'actuators, which the scene does not have'}")
        return self.names.index(name)

    # Controls

    def control(self, values: Mapping[str, ArrayLike] | ArrayLike, argument: str = "control") -> _Array:
        """Controls as an array, from an array or by name.

        Parameters
        ----------
        values : array_like, (..., n), or mapping from names to array_like
            Controls in the order of `names`, or by name; those that a mapping does not contain are 0.
        argument : str
            Name in messages.

        Returns
        -------
        array
            Controls, (..., n).

        Raises
        ------
        ArgumentError, ShapeError, NotFiniteError
            An unknown name, a wrong shape, or a control that is not finite.

        Examples
        --------
        >>> import phipsi
        >>> builder = phipsi.scenes.chain(2).to_builder().actuator("hip", "j0", gear=50.0).actuator("knee", "j1", gear=50.0)
        >>> builder.build().actuators.control({"knee": 0.5})
        array([0. , 0.5])
        """
        if isinstance(values, Mapping):
            given = {self._place(argument, name): np.asarray(_core._numbers(f"{argument}[{name!r}]", value)) for name, value in values.items()}
            try:
                parts = np.broadcast_arrays(*given.values(), np.zeros(()))
            except ValueError:
                shapes = ", ".join(str(value.shape) for value in given.values())
                raise of_argument(ShapeError, argument, f"found shapes {shapes}; expected ones that broadcast") from None
            found = np.zeros((*parts[-1].shape, len(self)))
            for at, part in zip(given, parts[:-1], strict=True):
                found[..., at] = part
        else:
            found = np.asarray(_core._numbers(argument, values))
        if found.shape[-1:] != (len(self),):
            more = f" (without {', '.join(map(repr, self.unsupported))}, which are not supported)" if self.unsupported else ""
            raise of_argument(ShapeError, argument, f"found shape {found.shape}; expected (..., {len(self)}){more}")
        if not np.isfinite(found).all():
            raise of_argument(NotFiniteError, argument, "found NaN or infinity; expected finite numbers")
        return found

    def torques(self, control: Mapping[str, ArrayLike] | ArrayLike, q: ArrayLike | None = None, qd: ArrayLike | None = None) -> _Array:
        """Joint torques of controls at a state.

        Parameters
        ----------
        control : array_like, (..., n), or mapping from names to array_like
            Controls, as in `control`; for actuators with an activation, the activation.
        q : array_like, (..., nq), optional
            Joint positions; None: neutral.
        qd : array_like, (..., nv), optional
            Joint velocities; None: zero.

        Returns
        -------
        array
            Joint torques, (..., nv), N m or N.

        Raises
        ------
        ArgumentError, ShapeError, NotFiniteError
            As `control`, for q and qd too, or actuators of one joint whose limits cannot be combined.

        Notes
        -----
        A function of the state that is evaluated between steps is explicit: a simulation with tau=lambda t, q, qd:
        scene.actuators.torques(...) diverges for stiff servos. Use simulate(control=...), which evaluates the servos
        within the step.

        Examples
        --------
        >>> import phipsi
        >>> scene = phipsi.scenes.chain(2).to_builder().actuator("knee", "j1", kp=100.0, gear=2.0).build()
        >>> scene.actuators.torques({"knee": 0.5})
        array([  0., 100.])
        """
        scene = self.scene
        q = np.asarray(scene.neutral() if q is None else _core._numbers("q", q, scene, True))
        qd = np.zeros(scene.nv) if qd is None else np.asarray(_core._numbers("qd", qd, scene, False))
        for name, value, width in (("q", q, scene.nq), ("qd", qd, scene.nv)):
            if value.shape[-1:] != (width,):
                raise of_argument(ShapeError, name, f"found shape {value.shape}; expected (..., {width})")
        force = self._forces(self._inputs(self.control(control)), q, qd)
        tau = np.zeros((*force.shape[:-1], scene.nv))
        clipped = self.gear * np.clip(force, *self.forcerange.T)
        for at, row in enumerate(self._rows):
            tau[..., row] += clipped[..., at]
        tau[..., self._rows] = np.clip(tau, *self._joint_limits)[..., self._rows]
        return tau

    def _inputs(self, control: _Array) -> _Array:
        """Controls clipped to their ranges; activations as they are."""
        return np.where(self.has_activation, control, np.clip(control, *self.ctrlrange.T))

    def _forces(self, inputs: _Array, q: _Array, qd: _Array) -> _Array:
        """Forces before they are clipped, (..., n)."""
        length, velocity = self.gear * q[..., self._columns], self.gear * qd[..., self._rows]
        (g0, g1, g2), (b0, b1, b2) = self._gain.T, self._bias.T
        return np.asarray((g0 + g1 * length + g2 * velocity) * inputs + b0 + b1 * length + b2 * velocity)

    # The control law of a simulation

    def _activations(self, control: _Array, start: _Array, dt: float) -> tuple[_Array, _Array]:
        """Inputs of the steps, (..., steps, n), from their controls, and the activations after them, (..., n): each
        activation is constant during a step and advances by its exact solution for a constant control.
        """
        inputs = np.array(np.broadcast_to(np.clip(control, *self.ctrlrange.T), (*np.broadcast_shapes(control.shape[:-2], start.shape[:-1]), *control.shape[-2:])))
        now, share = start, self._shares(dt)
        for step in range(inputs.shape[-2] if self.has_activation.any() else 0):
            given = inputs[..., step, :].copy()
            inputs[..., step, :] = np.where(self.has_activation, now, given)
            now = np.clip(share[0] * now + share[1] * given, *self._actrange.T)
        return inputs, np.where(self.has_activation, now, 0.0)

    def _shares(self, dt: float) -> _Array:
        """Factors of the activation and the control in the activation after a step, (2, n)."""
        decay = np.exp(-dt / np.where(self.has_activation, self._times, 1.0))
        is_integral = np.isinf(self._times)
        return np.stack([np.where(is_integral, 1.0, decay), np.where(is_integral, dt, 1.0 - decay)])

    def _law(self, inputs: _Array) -> Law:
        """Gains, targets and torques of inputs, (..., n)."""
        if self._conflicts:
            raise of_argument(ArgumentError, "control", f"found {self._conflicts[0]}")
        kp, kd, by_kp, by_kd, is_free = self._gains if self._gains is not None else self._gains_of(inputs)
        torque = self._torque_of(self._gain[:, 0] * inputs + self._bias[:, 0])
        constant = torque @ self._within - self._center
        tau = np.zeros(self.scene.nv)
        if self.has_torques:
            tau = self._center + torque @ self._beside + is_free * np.clip(constant, *self._limits)
        target = np.empty((*constant.shape[:-1], self.scene.nq))
        target[...] = self._neutral
        target[..., self._columns] = (constant * by_kp)[..., self._rows]
        return Law(kp, kd, target, constant * by_kd, tau)

    def _torque_of(self, force: _Array) -> _Array:
        """Joint torque of a force that does not depend on the state; only motors are clipped here, and servos by their limits."""
        return np.asarray(self.gear * (force if self._servo.all() else np.where(self._servo, force, np.clip(force, *self.forcerange.T))))

    def _gains_of(self, inputs: _Array) -> tuple[_Array, ...]:
        """kp and kd of inputs, (..., nv), the factors of a torque in the target and in its rate, and the joints without
        gains.
        """
        slope = inputs[..., None] * self._gain + self._bias
        kp, kd = (-(self.gear**2 * slope[..., part]) @ (self._within + self._beside) for part in (1, 2))
        for what, gain in (("stiffness", kp), ("damping", kd)):
            if (gain < 0.0).any():
                joint = next(joint for joint in self.joints if (gain[..., self.scene.v_index(joint)] < 0.0).any())
                of = ", ".join(repr(one.name) for one in self._all if one.joint == joint)
                raise of_argument(ArgumentError, "control", f"found {of} with a negative {what} at the joint {joint!r}; expected one that is zero or positive")
        with np.errstate(divide="ignore"):
            by_kp = np.where(kp > 0.0, 1.0 / kp, 0.0)
            by_kd = np.where((kp > 0.0) | (kd == 0.0), 0.0, 1.0 / kd)
        return kp, kd, by_kp, by_kd, (kp == 0.0) & (kd == 0.0)

    def _gradients(self, path: Trajectory, found: RolloutGradients) -> _Array:
        """Gradient by the controls of a trajectory, as they were given, from those by torques and targets."""
        control, inputs = self._of_path(path)
        given = path.given or {}
        _, _, by_kp, by_kd, is_free = self._gains if self._gains is not None else self._gains_of(inputs)

        def of_steps(values: _Array | None, name: str) -> _Array:
            if values is None:
                return np.zeros((1, self.scene.nv))
            found = values if given.get(name) is not None else values[..., None, :]
            return found.sum(axis=-2, keepdims=True) if inputs.shape[-2] == 1 else found

        by_tau, by_target, by_rate = of_steps(found.tau, "tau_steps"), of_steps(found.target, "targets"), of_steps(found.target_rate, "target_rates")
        force = self._gain[:, 0] * inputs + self._bias[:, 0]
        constant = self._torque_of(force) @ self._within - self._center
        is_free = is_free & (constant >= self._limits[0]) & (constant <= self._limits[1])
        by_constant = by_target * by_kp + by_rate * by_kd + by_tau * is_free
        by_torque = by_constant @ self._within.T + by_tau @ self._beside.T
        acts = self._servo | ((force >= self.forcerange[:, 0]) & (force <= self.forcerange[:, 1]))
        by_input = self._gain[:, 0] * self.gear * by_torque * acts
        # The gradient by gains is not known.
        by_input = np.where(np.any(self._gain[:, 1:] != 0.0, axis=1), np.nan, by_input)
        by_control = self._reverse(by_input, control, inputs, path.dt)
        by_control = by_control * ((control >= self.ctrlrange[:, 0]) & (control <= self.ctrlrange[:, 1]))
        asked = path.control.shape[:-1][-1:] if path.control is not None else ()
        return np.asarray(by_control if asked == (path.steps,) else by_control.sum(axis=-2, keepdims=asked == (1,)))

    def _of_path(self, path: Trajectory) -> tuple[_Array, _Array]:
        """Controls and inputs of the steps of a trajectory, (..., steps, n); of one step if all have the same."""
        assert path.control is not None and path.start_activation is not None
        control = path.control if path.control.ndim > 1 else path.control[None]
        if self.has_activation.any():
            control = np.broadcast_to(control, (*control.shape[:-2], max(path.steps, 1), len(self)))
        elif control.shape[-2] > 1:
            control = control[..., : max(path.steps, 1), :]
        return control, self._activations(control, path.start_activation, path.dt)[0]

    def _reverse(self, by_input: _Array, control: _Array, inputs: _Array, dt: float) -> _Array:
        """Gradients by the controls of the steps from those by their inputs: the adjoint of activations()."""
        if not self.has_activation.any():
            return by_input
        by_control, (kept, added) = by_input.copy(), self._shares(dt)
        clipped = np.clip(control, *self.ctrlrange.T)
        after = np.zeros(by_input[..., 0, :].shape)
        for step in reversed(range(by_input.shape[-2])):
            following = kept * inputs[..., step, :] + added * clipped[..., step, :]
            after = after * ((following >= self._actrange[:, 0]) & (following <= self._actrange[:, 1]))
            by_control[..., step, :] = np.where(self.has_activation, added * after, by_input[..., step, :])
            after = np.where(self.has_activation, by_input[..., step, :] + kept * after, 0.0)
        return by_control

    def _clipped(self, path: Trajectory) -> Iterator[tuple[str, str, _Array, tuple[float, float]]]:
        """Joint, what is clipped, its values in the rows, (..., rows), and the range, of a trajectory with controls."""
        control, inputs = self._of_path(path)
        rows = np.minimum(np.arange(len(path)) * path.record_every, max(path.steps - 1, 0)) if control.shape[-2] > 1 else np.zeros(len(path), int)
        force = self._forces(inputs[..., rows, :], path.q, path.qd)
        sums = (self.gear * np.clip(force, *self.forcerange.T)) @ (self._within + self._beside)
        for at, one in enumerate(self):
            yield one.joint, f"control of {one.name!r}", control[..., rows, at], one.ctrlrange
            yield one.joint, f"force of {one.name!r}", force[..., at], one.forcerange
        for joint, row in dict(zip(self.joints, self._rows.tolist(), strict=True)).items():
            yield joint, "torque of actuators", sums[..., row], tuple(self._joint_limits[:, row])

    def _keywords(self, law: Law) -> dict[str, Any]:
        """Keywords of Scene.simulator for a control law."""
        if not self.has_servos:
            return {}
        return {"pd": PD(law.kp, law.kd, law.target, law.rate, self._effort if np.isfinite(self._effort).any() else None)}


def simulate(scene: Scene, q: ArrayLike, qd: ArrayLike, control: Any, activation: Any, tau: Any = None, tau_steps: Any = None, **given: Any) -> Trajectory:
    """Scene.simulate with controls: (n,), or (..., steps, n), where an axis of one step is for all steps."""
    actuators, asked = controlled(scene, control, given)
    steps, dt = given["steps"], given["dt"]
    u = asked if asked.ndim > 1 else asked[None]
    if u.shape[-2] not in (1, steps):
        raise of_argument(ShapeError, "control", f"found shape {asked.shape}; expected ({len(actuators)},) or (..., {steps}, {len(actuators)})")
    start = np.zeros(len(actuators)) if activation is None else actuators.control(activation, "activation")
    if actuators.has_activation.any():
        u = np.broadcast_to(u, (*u.shape[:-2], max(steps, 1), len(actuators)))
    inputs, last = actuators._activations(u, start, dt)
    law = actuators._law(inputs)
    is_constant = inputs.shape[-2] == 1
    if not is_constant and any(np.any(gain != gain[..., :1, :]) for gain in law[:2] if gain.ndim > 1):
        raise _changing_gains(actuators, "that change from step to step; expected constant ones")
    at_start = Law(*(part if part.ndim == 1 else np.asarray(part[..., 0, :]) for part in law))
    given |= actuators._keywords(at_start)
    if "pd" in given and not is_constant:
        given |= {"targets": law.target, "target_rates": law.rate}
    if actuators.has_torques:
        own = at_start.tau if is_constant else law.tau
        tau, tau_steps = _sum_of_torques(scene, own, is_constant, tau, tau_steps, dt, steps)
    given |= {"tau": tau, "tau_steps": tau_steps}
    about: dict[str, Any] = {"control": asked, "start_activation": start}
    try:
        path: Trajectory = scene.simulate(q, qd, **given)
    except (SimulationError, SimulationInterrupted) as error:
        error.trajectory = replace(error.trajectory, **about)
        raise
    return replace(path, **about, activation=last)


def controlled(scene: Scene, control: Any, given: Mapping[str, Any]) -> tuple[Actuators, _Array]:
    """The actuators of a scene that has some, and the controls; those that are not supported are named in a warning."""
    actuators, lost = scene.actuators, scene.actuators.unsupported
    for name in ("pd", "targets", "target_rates"):
        if given.get(name) is not None:
            raise of_argument(ArgumentError, name, f"found {name} and control; expected one of them: the servos of the scene are the control law")
    if given.get("effort") == "clip":
        raise of_argument(ArgumentError, "effort", "found 'clip' and control; expected no value: the effort limits of joints clip the torques of their actuators already")
    if not actuators:
        more = "".join(f"; {name!r} is an actuator {reason}" for name, reason in list(lost.items())[:1])
        raise of_argument(ArgumentError, "control", f"found controls for a scene without actuators{more}; expected tau, or actuators from SceneBuilder.actuator")
    controls = actuators.control(control)
    if lost:
        name, reason = next(iter(lost.items()))
        more = f", and {len(lost) - 1} more actuators that a scene cannot represent" if len(lost) > 1 else ""
        warn(f"control: found {name!r}, {reason}{more}; their forces do not act", ModelWarning)
    return actuators, controls


def _changing_gains(actuators: Actuators, rest: str) -> ArgumentError:
    """An error for controls on which gains depend."""
    names = ", ".join(repr(one.name) for one in actuators if any(one.gain[1:]))
    return of_argument(ArgumentError, "control", f"found controls of {names}, and with them gains, {rest}")


def _sum_of_torques(scene: Scene, own: _Array, is_constant: bool, tau: Any, tau_steps: Any, dt: float, steps: int) -> tuple[Any, Any]:
    """tau and tau_steps of Scene.simulate: the torques of motors, (..., nv) or (..., steps, nv), and those of the caller."""
    if is_constant and own.ndim > 1:
        own, is_constant = np.repeat(own[..., None, :], max(steps, 1), axis=-2), False
    if callable(tau):
        return (lambda t, q, qd: torques(tau, scene, t, q, qd) + (own if is_constant else own[..., round(t / dt), :])), tau_steps
    if tau_steps is not None:
        return tau, np.asarray(_core._numbers("tau_steps", tau_steps, scene, False)) + (own[..., None, :] if is_constant else own)
    given = np.zeros(1) if tau is None else np.asarray(_core._numbers("tau", tau, scene, False))
    return (given + own, None) if is_constant else (None, given[..., None, :] + own)


class Drive:
    """Actuators of a Simulator: their controls and activations, (..., n), which remain until the next call changes them."""

    def __init__(self, scene: Scene, control: Any, activation: Any, dt: float, given: Mapping[str, Any]) -> None:
        self.actuators, self.control = controlled(scene, control, given)
        self._dt = dt
        self.activation = self.read(activation)

    def keywords(self) -> dict[str, Any]:
        """Keywords of Scene.simulator."""
        law = self._law()
        self._gains = law[:2]
        return self.actuators._keywords(law)

    def _law(self) -> Law:
        actuators = self.actuators
        return actuators._law(np.where(actuators.has_activation, self.activation, np.clip(self.control, *actuators.ctrlrange.T)))

    def spread(self, batch: tuple[int, ...]) -> None:
        """Give each state of the batch its own values."""
        self.control, self.activation = (self._of_batch(name, getattr(self, name), batch).copy() for name in ("control", "activation"))

    @staticmethod
    def _of_batch(name: str, values: _Array, batch: tuple[int, ...]) -> _Array:
        try:
            return np.broadcast_to(values, (*batch, values.shape[-1]))
        except ValueError:
            raise of_argument(ShapeError, name, f"found shape {values.shape}; expected one that broadcasts to {(*batch, values.shape[-1])}") from None

    def step(self, simulator: Simulator, tau: Any, steps: int, control: Any) -> None:
        """Simulator.step with the controls, or those of the last call."""
        if control is not None:
            self.control = self._of_batch("control", self.actuators.control(control), simulator.batch).copy()
        given = None if tau is None else np.asarray(_core._numbers("tau", tau, self.actuators.scene, False))
        has_activation = bool(self.actuators.has_activation.any())
        for _ in range(steps if has_activation else 1):
            law = self._law()
            if law.kp is not self._gains[0] and any(np.any(gain != before) for gain, before in zip(law[:2], self._gains, strict=True)):
                raise _changing_gains(self.actuators, "that change; expected those of the creation of the simulator")
            torque = given if not self.actuators.has_torques else law.tau if given is None else given + law.tau
            targets = (law.target, law.rate) if self.actuators.has_servos else (None, None)
            simulator._advance(torque, 1 if has_activation else steps, *targets)
            if has_activation:
                self.activation = self.actuators._activations(self.control[..., None, :], self.activation, self._dt)[1]

    def read(self, activation: Any) -> _Array:
        """Activations for reset; None: zero."""
        return np.zeros(len(self.actuators)) if activation is None else self.actuators.control(activation, "activation")

    def reset(self, states: Any, activation: _Array) -> None:
        """Set the activations of states."""
        self.activation[... if states is None else states] = activation
