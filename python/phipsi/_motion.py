"""What a simulation gives: trajectories, their energy, and the limits they break."""

from __future__ import annotations

import copy
import warnings
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from .errors import ArgumentError, InertiaWarning, LimitWarning, SimulationError, SimulationInterrupted, of_argument, place_in_time

if TYPE_CHECKING:
    from ._core import Scene
    from ._results import RolloutGradients
    from .estimation import Bands

__all__ = [
    "PD",
    "ContactMotion",
    "ContactState",
    "EnergyAudit",
    "MomentumCorrection",
    "MotionEnergy",
    "StopImpact",
    "Trajectory",
    "Violation",
]

_Array = NDArray[np.float64]
_Number = TypeVar("_Number", np.float64, np.int8)


class PD(NamedTuple):
    """A control law for Scene.simulate: the torque kp (target - q) + kd (target_rate - v), the difference on the manifold.

    Methods that are implicit take it implicitly: gains may be as stiff as one likes.
    """

    kp: ArrayLike
    """Proportional gains, (nv,) or a number, N m/rad or N/m."""
    kd: ArrayLike
    """Derivative gains, (nv,) or a number, N m s/rad or N s/m."""
    target: ArrayLike
    """Configurations to go to, (..., nq)."""
    target_rate: ArrayLike | None = None
    """Rates to go to, (..., nv); None: zero."""


class MotionEnergy(NamedTuple):
    """Energy along a trajectory, (..., rows) each, J."""

    kinetic: _Array
    """Half of qd M qd, armature included."""
    potential: _Array
    """Of gravity; zero with the mass centre at the base's origin."""
    spring: _Array
    """Of the joints' springs; the control law's not among them."""

    @property
    def total(self) -> _Array:
        """The sum."""
        return self.kinetic + self.potential + self.spring


class MomentumCorrection(NamedTuple):
    """The largest correction of a step that kept the momentum of floating trees, (...) each."""

    velocity: _Array
    """sqrt(E'/(E + E')): E' the kinetic energy of the correction as a motion of its own, E the tree's before it, rotors left out."""
    position: _Array
    """How far the mass centre was moved, m."""


class ContactState(IntEnum):
    """What a contact does in a step: the numbers in ContactMotion.state."""

    OPEN = 0
    """Nothing presses on it."""
    STICKING = 1
    """It is pressed, and the friction that holds it is below mu times the normal force."""
    SLIDING = 2
    """It is pressed and slips, with friction at its bound; without friction, whether it slips or not."""


class ContactMotion(NamedTuple):
    """The contacts of a motion, by name, in every row: (..., rows), or (..., rows, 3) in the base frame; and what all steps told, (...)."""

    gap: dict[str, _Array]
    """How far each is above its plane in the row, (..., rows), m; below zero where it is under it."""
    slip: dict[str, _Array]
    """Velocity in the plane of the point nearest to it in the row, (..., rows, 3), m/s."""
    force: dict[str, _Array]
    """Force on the link in the step that led to the row, impacts left out, (..., rows, 3), N; zero in the first row."""
    impulse: dict[str, _Array]
    """Impulse on the link of all impacts with a rebound since the row before, (..., rows, 3), N s."""
    state: dict[str, NDArray[np.int8]]
    """What each did in the step that led to the row, (..., rows), a ContactState: 0 open, 1 sticking, 2 sliding; open in the first row.

    It is the end of the step that counts. Where a rebound has parted them by then, it is what they did in the impact.
    """
    residual: _Array
    """The worst residual of a step, (...): what is left of the law of contacts, as a velocity beside the fastest contact's.

    Above 1e-5 the run ends with a SimulationError.
    """
    converged: NDArray[np.bool_]
    """Whether every step met 1e-10, or the rounding of its own numbers, (...)."""
    iterations: NDArray[np.int_]
    """Iterations of all solves, (...): matrices that were factorised."""
    lost_in_impacts: _Array
    """Kinetic energy that impacts and landings took, (...), J."""
    lost_in_friction: _Array
    """What friction took, (...), J."""
    expansion_kept: _Array
    """The least part of a rebound with which the kinetic energy after the impact is at most that before it, (...): 1 where none was reduced."""
    impulse_kept: _Array
    """The least part of an impulse with which the kinetic energy of an impact does not rise, (...): below 1 only where a solve did not converge."""
    depth: _Array
    """The deepest that a contact was under its plane at a step's end, before it was moved out, (...), m."""


class EnergyAudit(NamedTuple):
    """Where the energy of a run went, (...) each, J: the work of everything that acts at the joints, from the start to the last step.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.scenes.chain(3)
    >>> path = scene.simulate([0.3] * scene.nv, [0.0] * scene.nv, dt=1e-3, steps=100)
    >>> bool(abs(path.energy_audit().remainder) < 1e-6)
    True
    """

    torque: _Array
    """Work of tau."""
    damping: _Array
    """Work of damping; zero or negative."""
    friction: _Array
    """Work of dry friction."""
    control: _Array
    """Work of pd."""
    stops: _Array
    """Work of the joint stops."""
    contacts: _Array
    """Work of contacts: impacts and sliding friction; zero without contacts."""
    change: _Array
    """Change of kinetic, potential and spring energy."""
    remainder: _Array
    """Change minus all works: the error of the integrator, and that of the works, which are sums over steps."""
    share: _Array
    """The remainder relative to the largest of: the kinetic energy, the range of the potential energy, and each work."""


class StopImpact(NamedTuple):
    """A joint that met one of its stops."""

    joint: str
    """Name of the joint."""
    limit: str
    """Which stop: "lower" or "upper"."""
    time: float
    """When, at the end of a step or substep, s."""
    speed: float
    """How fast the joint moved, rad/s or m/s."""
    impulse: float
    """The impulse of the stop on the joint, N m s or N s."""
    state: int | tuple[int, ...] | None
    """Index of the state in the batch; None for a single state."""


class Violation(NamedTuple):
    """A limit that a trajectory breaks in some recorded row."""

    joint: str
    """Name of the joint."""
    limit: str
    """Which: "lower", "upper" or "velocity"."""
    bound: float
    """The limit."""
    worst: float
    """The coordinate or rate that is furthest beyond."""
    time: float
    """When it is first broken, s."""
    rows: int
    """In how many rows of how many states, all together."""


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """States through time: what Scene.simulate gives."""

    scene: Scene
    """The scene that moved."""
    t: _Array
    """Times of the rows, (rows,), s."""
    q: _Array
    """Configurations, (..., rows, nq)."""
    qd: _Array
    """Rates, (..., rows, nv)."""
    dt: float
    """The step, s."""
    steps: int
    """Steps that were made."""
    method: str
    """How."""
    armature: _Array = field(repr=False)
    """What it was computed with, (nv,)."""
    stiffness: _Array = field(repr=False)
    """The springs', (nv,)."""
    rest: _Array = field(repr=False)
    """Where they are at rest, (nq,)."""
    momentum_correction: MomentumCorrection | None = field(default=None, repr=False)
    """What conserve_momentum changed in the step where it changed most; None where that was not asked for."""
    contacts: ContactMotion | None = field(default=None, repr=False)
    """The contacts of the scene; None where it has none."""
    record_every: int = field(default=1, repr=False)
    """Steps between two rows."""
    integrator: str = field(default="", repr=False)
    """The method that advanced states: of "auto", the one that was chosen: "rk4" or "rosenbrock-2", with accuracy "dormand-prince-5" or "rosenbrock-3", and "contact"."""
    friction_speed: float = field(default=0.0, repr=False)
    """Below this speed friction was regularized, rad/s or m/s; 0: exact Coulomb friction."""
    limits: str = field(default="report", repr=False)
    """Whether joint limits were stops: "stop" or "report"."""
    stops: list[StopImpact] = field(default_factory=list, repr=False)
    """Impacts of joints on their stops, by state and time. A joint that rests on a stop has none."""
    end: tuple[_Array, _Array] | None = field(default=None, repr=False)
    """The state after the last step, q (..., nq) and qd (..., nv), which has a row of its own only where record_every divides the number of steps."""
    works: tuple[_Array, ...] = field(default=(), repr=False)
    """The works of energy_audit, (...) each, J."""
    substeps: NDArray[np.int_] = field(default_factory=lambda: np.array(1), repr=False)
    """The largest number of substeps that a step was divided into, (...)."""
    events: NDArray[np.int_] = field(default_factory=lambda: np.array(0), repr=False)
    """The number of substeps in which a joint stuck, began to slide, or met or left a stop, (...)."""
    estimated_error: _Array = field(default_factory=lambda: np.array(0.0), repr=False)
    """With accuracy, the sum of the estimated errors of all substeps, (...); else zero, and error_estimate gives one."""
    bands: Bands | None = field(default=None, repr=False)
    """Standard deviations and covariances of every row, with covariance; None without."""
    given: dict[str, Any] | None = field(default=None, repr=False)
    """The other arguments of Scene.simulate, for vjp; arrays are copies. None where a simulator went there."""

    def __len__(self) -> int:
        """The number of rows."""
        return len(self.t)

    def __repr__(self) -> str:
        batch = self.q.shape[:-2]
        states = f"{batch} states, " if batch else ""
        return f"<phipsi.Trajectory: {states}{len(self)} rows to t = {self.t[-1]:g} s, {self.steps} steps of {self.dt:g} s by {self.method}>"

    @property
    def drift(self) -> _Array:
        """How far every row is from the connections of the scene, (..., rows): the largest entry of Scene.constraint_error, m or rad; zero without connections."""
        if not self.scene.connection_names:
            return np.zeros(self.q.shape[:-1])
        drift: _Array = np.abs(self.scene.constraint_error(self.q)).max(axis=-1)
        return drift

    def energy(self) -> MotionEnergy:
        """Kinetic energy, that of gravity and that of the springs in every row, with the armature and springs of the run."""
        energy = self.scene.energy(self.q, self.qd)
        rotors = 0.5 * ((self.armature - self.scene.armature) * self.qd**2).sum(axis=-1)
        return MotionEnergy(np.asarray(energy.kinetic + rotors), np.asarray(energy.potential), self._springs())

    def energy_audit(self) -> EnergyAudit:
        """Where the energy went from the start to the last step: the work of torques, damping, friction, control, stops and contacts, and what they do not explain.

        Works are accumulated in every step, whether it has a row or not. The energy of what is passive grows by no more than the remainder.

        Returns
        -------
        EnergyAudit
            Work of each kind, change of the energy, and the remainder, (...) each, J.

        Raises
        ------
        ArgumentError
            Where a simulator went there, whose first row is not known.
        """
        if self.given is None:
            self._known()
        energy = self.energy()
        last = replace(self, q=self.end[0][..., None, :], qd=self.end[1][..., None, :]).energy() if self.end is not None else energy
        change = np.asarray(last.total[..., -1] - energy.total[..., 0])
        torque, damping, friction, control, stops = (np.asarray(work) for work in self.works)
        contacts = np.zeros(change.shape)
        if self.contacts is not None:
            contacts = contacts - self.contacts.lost_in_impacts - self.contacts.lost_in_friction
        works = [torque, damping, friction, control, stops, contacts]
        remainder = np.asarray(change - sum(works))
        sizes = [energy.kinetic.max(axis=-1), np.ptp(energy.potential + energy.spring, axis=-1)]
        rounding = 1e-12 * (np.abs(energy.kinetic) + np.abs(energy.potential) + np.abs(energy.spring)).max(axis=-1)
        scale = np.max([np.abs(size) for size in (*works, *sizes, rounding)], axis=0)
        share = np.asarray(np.abs(remainder) / np.where(scale > 0.0, scale, 1.0))
        return EnergyAudit(torque, damping, friction, control, stops, contacts, change, remainder, share)

    def error_estimate(self) -> _Array:
        """Estimated error of the configuration in every row, (..., rows), rad or m: the largest entry of the difference to a more accurate run, times 2.

        A run with method="auto" is made again with error control (accuracy=1e-7), which resolves impacts, sticking, and vibrations that the step damps. With another method,
        momentum conservation, contacts, connections or coupled joints it is made again with a third of the step: the estimate is then unreliable where modes of friction or stops
        change. Errors of the model cannot be seen, such as those of regularized friction. Where motion is chaotic the estimate grows as the error does.

        Returns
        -------
        array
            The estimate, (..., rows); zero in the first row.

        Raises
        ------
        ArgumentError
            Where tau was a function, where a simulator went there, and with accuracy, which has estimated_error.
        SimulationError
            Where the more accurate run fails.
        """
        given = {name: value for name, value in self._known().items() if value is not None}
        if given.pop("accuracy", None) is not None:
            raise of_argument(ArgumentError, "accuracy", "found a run with error control; expected one with fixed steps: estimated_error has the sum of its errors")
        scene, start = self.scene, (self.q[..., 0, :], self.qd[..., 0, :])
        given |= {"method": self.method, "armature": self.armature, "stiffness": self.stiffness, "rest": self.rest}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LimitWarning)
            try:
                accurate = scene.simulate(*start, dt=self.dt, steps=self.steps, record_every=self.record_every, accuracy=1e-7, **given)
            except ArgumentError:
                # This method or scene has no error control.
                if "tau_steps" in given:
                    given["tau_steps"] = np.repeat(np.asarray(given["tau_steps"])[..., : self.steps, :], 3, axis=-2)
                accurate = scene.simulate(*start, dt=self.dt / 3, steps=3 * self.steps, record_every=3 * self.record_every, **given)
        difference: _Array = 2.0 * np.abs(scene.difference(self.q, accurate.q)).max(axis=-1, initial=0.0)
        return difference

    def torques(self) -> _Array:
        """What acts at the joints in every row, (..., rows, nv), N m or N: tau of the step that begins there (of the last step in the last row), springs, damping,
        friction and pd.

        The torque of stops, and that of exact friction on a joint at rest, follow from the motion and are not among them.

        Raises ArgumentError where tau was a function, and where a simulator went there.
        """
        given, scene, v = self._known(), self.scene, self.qd

        def read(name: str, value: ArrayLike, coordinates: bool = False) -> _Array:
            return np.asarray(_core._numbers(name, value, scene, coordinates))

        def own(name: str, usual: _Array) -> _Array:
            return usual if given.get(name) is None else read(name, given[name])

        u = -own("damping", scene.damping) * v - self.stiffness * self._displacement(self.rest, self.q)
        speed = self.friction_speed
        u -= own("friction", scene.friction) * (v / np.sqrt(v**2 + speed**2) if speed > 0.0 else np.sign(v))
        if given.get("tau") is not None:
            u = u + read("tau", given["tau"])[..., None, :]
        if given.get("tau_steps") is not None and self.steps:
            begun = np.minimum(np.arange(len(self)) * self.record_every, self.steps - 1)
            u = u + read("tau_steps", given["tau_steps"])[..., begun, :]
        if given.get("pd") is not None:
            law = PD(*given["pd"])
            target = read("target", law.target, True)[..., None, :]
            rate = 0.0 if law.target_rate is None else read("target_rate", law.target_rate)[..., None, :]
            kp, kd = (read(name, gain) for name, gain in (("kp", law.kp), ("kd", law.kd)))
            u = u - kp * self._displacement(target, self.q) + kd * (rate - v)
        return np.asarray(u)

    def connection_forces(self) -> dict[str, _Array]:
        """What each connection does to its link in every row, (..., rows, m) by name: Scene.constrained_dynamics under torques(), with its signs and axes.

        NaN where velocities do not meet the connections, as with baumgarte they may not. Those of contacts are in contacts.force. O(N) a row, and the square of the rows.

        Raises as torques.
        """
        scene = self.scene
        if not scene.connection_names:
            return {}
        if not np.array_equal(self.armature, scene.armature):
            scene = scene.with_properties(armature=self.armature)
        given = {} if self.given is None or "compliance" not in self.given else {"compliance": self.given["compliance"]}
        return dict(scene.constrained_dynamics(self.q, self.qd, self.torques(), errors="nan", **given).forces)

    def _displacement(self, rest: _Array, q: _Array) -> _Array:
        """From rest to q, (..., nv), as springs measure it: of a free joint the distance in the child's axes, not the length of a screw."""
        away = np.asarray(self.scene.difference(rest, q))
        for joint in self.scene.joint_names:
            at, v = self.scene.q_index(joint), self.scene.v_index(joint)
            if at.stop - at.start == 7:
                moved, turn = q[..., at.start : at.start + 3] - rest[..., at.start : at.start + 3], q[..., at.start + 3 : at.stop]
                axis, real = -turn[..., :3], turn[..., 3:]
                twice = 2.0 * np.cross(axis, moved)
                away[..., v.start : v.start + 3] = moved + real * twice + np.cross(axis, twice)
        return away

    def _springs(self) -> _Array:
        springs: _Array = 0.5 * (self.stiffness * self._displacement(self.rest, self.q) ** 2).sum(axis=-1)
        return springs

    def momentum(self) -> _Array:
        """Spatial momentum (angular about the base's origin, linear) in every row, (..., rows, 6), in the base frame."""
        return self.scene.momentum(self.q, self.qd)

    def vjp(
        self, cotangent_q: ArrayLike | None = None, cotangent_qd: ArrayLike | None = None, *, parameters: bool = False
    ) -> RolloutGradients:
        """Gradients of a function of this trajectory, by the adjoint of every step: by the start, torques, and what acts at the joints.

        cotangent_q, cotangent_qd: (..., rows, nv), the gradients of the function by q and qd of every row; None: zero. That by q is in the tangent space of each row: an
        angle or a length for joints of one axis, a rotation in the child's frame for spherical joints, (linear, angular) in the child's frame for free joints. parameters:
        whether to give the gradients by inertias too.

        Recorded rows are checkpoints: between them steps are made again, with record_every=1 none. O(N) a stage of a step.

        Raises as Scene.simulate_vjp; ArgumentError where tau was a function, with conserve_momentum, and where a simulator went there.
        """
        given = self._arguments()
        nothing = np.zeros((len(self), self.scene.nv))
        cotangents = [nothing if cotangent is None else cotangent for cotangent in (cotangent_q, cotangent_qd)]
        return self.scene.simulate_vjp(self.q, self.qd, *cotangents, parameters=parameters, **given)

    def _arguments(self) -> dict[str, Any]:
        """How Scene.simulate was called, for Scene.simulate_vjp."""
        given = self._known()
        given.pop("baumgarte", None)
        given.pop("compliance", None)
        if given.pop("accuracy") is not None:
            raise of_argument(ArgumentError, "accuracy", "found a run with error control; expected one with fixed steps, which have gradients")
        if given.pop("conserve_momentum"):
            raise of_argument(ArgumentError, "conserve_momentum", "found True; expected a run without it, whose steps have gradients")
        if "tau_steps" in given:
            given["tau_steps"] = np.asarray(given["tau_steps"])[..., : self.steps, :]
        own = {"dt": self.dt, "steps": self.steps, "method": self.method, "record_every": self.record_every}
        return {**given, **own, "armature": self.armature, "stiffness": self.stiffness, "rest": self.rest}

    def _known(self) -> dict[str, Any]:
        """How Scene.simulate was called, where all of it is known."""
        if self.given is None:
            raise of_argument(ArgumentError, "trajectory", "found where a simulator went; expected all rows, by Scene.simulate")
        if isinstance(self.given.get("tau"), str):
            raise of_argument(ArgumentError, "tau", "found a function; expected arrays: what the function gave, as tau_steps")
        return dict(self.given)

    def violations(self) -> list[Violation]:
        """The limits of position and velocity that recorded rows break, in the order of the joints; velocities are never bounded, positions with limits="stop"."""
        found = []
        limits = self.scene.limits
        for joint in self.scene.joint_names:
            q, v = self.scene.q_index(joint), self.scene.v_index(joint)
            cases = []
            if q.stop - q.start == v.stop - v.start:
                cases = [("lower", self.q[..., q], limits.lower[v], -1.0), ("upper", self.q[..., q], limits.upper[v], 1.0)]
            cases.append(("velocity", self.qd[..., v], limits.velocity[v], 1.0))
            for limit, values, bounds, sign in cases:
                if not np.all(np.isinf(bounds)):
                    found += self._beyond(joint, limit, values, float(bounds[0]), sign)
        return found

    def _beyond(self, joint: str, limit: str, values: _Array, bound: float, sign: float) -> list[Violation]:
        size = np.abs(values) if limit == "velocity" else sign * values
        beyond = size > sign * bound
        if not beyond.any():
            return []
        worst = values.reshape(-1)[np.argmax(size)]
        rows = beyond.any(axis=-1)
        first = rows.reshape(-1, rows.shape[-1]).any(axis=0).argmax()
        return [Violation(joint, limit, bound, float(worst), float(self.t[first]), int(rows.sum()))]


#: What is kept of a torque that was a function: its gradients are not known, and few functions can be pickled.
_FUNCTION = "a function"


def _kept(given: dict[str, Any]) -> dict[str, Any]:
    """What was given, as it is now: whoever gave it may write to it later."""

    def own(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value.copy()
        return _FUNCTION if callable(value) else copy.deepcopy(value)

    return {name: own(value) for name, value in given.items()}


def trajectory_of(
    q: _Array, qd: _Array, *, scene: Scene, dt: float, record_every: int, steps: int, given: dict[str, Any], **about: Any
) -> Trajectory:
    """The trajectory of the rows that `steps` steps have filled; about: the other fields of Trajectory."""
    rows = steps // record_every + 1
    t: _Array = np.arange(rows, dtype=np.float64) * (record_every * dt)
    if rows < q.shape[-2]:
        q, qd = q[..., :rows, :], qd[..., :rows, :]
        if about.get("contacts") is not None:
            about["contacts"] = _first_rows(about["contacts"], rows, q.ndim - 2)
    return Trajectory(scene, t, q, qd, dt, steps, record_every=record_every, given=_kept(given), **_outcome(about))


def _outcome(about: dict[str, Any]) -> dict[str, Any]:
    """The fields of a trajectory, with counts as integers and impacts by name."""
    most, events, error, unsettled = about.pop("counts")
    if np.any(unsettled):
        message = (
            f"in {int(np.sum(unsettled))} steps no torques of friction and joint stops agree, because the mass matrix is indefinite: a link's inertia is not physical; a joint was held"
            " in place (strict=True on loading names such links)"
        )
        warnings.warn(message, InertiaWarning, stacklevel=2)
    counts = (np.asarray(count).astype(np.int_) for count in (most, events))
    return about | dict(zip(("substeps", "events"), counts)) | {"estimated_error": np.asarray(error)}


def contacts_of(names: tuple[str, ...], rows: _Array, told: _Array) -> ContactMotion:
    """Recorded numbers by name: rows (..., contacts * 11), and what steps told, (..., 8)."""
    each = rows.reshape(*rows.shape[:-1], len(names), 11)
    by_name = [{name: each[..., i, part] for i, name in enumerate(names)} for part in _PARTS]
    residual, converged, iterations, *rest = np.moveaxis(told, -1, 0)
    gap, slip, force, impulse = by_name
    state = {name: each[..., i, 10].astype(np.int8) for i, name in enumerate(names)}
    impacts, friction, expansion, kept, depth = rest
    solved = residual, converged > 0, iterations.astype(np.int_)
    return ContactMotion(gap, slip, force, impulse, state, *solved, impacts, friction, expansion, kept, depth)


#: Where the gap, slip velocity, force and impulse of a contact are in its numbers.
_PARTS: tuple[int | slice, ...] = (0, slice(1, 4), slice(4, 7), slice(7, 10))


def _first_rows(contacts: ContactMotion, rows: int, axis: int) -> ContactMotion:
    """Those that were filled."""
    which = (slice(None),) * axis + (slice(rows),)

    def first(of: dict[str, NDArray[_Number]]) -> dict[str, NDArray[_Number]]:
        return {name: values[which] for name, values in of.items()}

    gap, slip, force, impulse = first(contacts.gap), first(contacts.slip), first(contacts.force), first(contacts.impulse)
    return contacts._replace(gap=gap, slip=slip, force=force, impulse=impulse, state=first(contacts.state))


def only_now(q: _Array, qd: _Array, *, scene: Scene, dt: float, steps: int, **about: Any) -> Trajectory:
    """The trajectory of one row, where `steps` steps of a simulator have come; about: the other fields of Trajectory."""
    return Trajectory(scene, np.array([steps * dt]), q, qd, dt, steps, **_outcome(about))


def stopped(
    trajectory: Trajectory, cause: BaseException, joint: str | None, state: int | tuple[int, ...] | None
) -> BaseException:
    """The exception of a simulation that ended early, with what was computed; no joint is at fault where tau or progress raised the cause."""
    place = place_in_time(trajectory.steps, trajectory.steps * trajectory.dt)
    error: SimulationError | SimulationInterrupted
    if joint is not None:
        error = SimulationError(f"{place}: {cause}")
        error.joint, error.state = joint, state
    elif isinstance(cause, KeyboardInterrupt):
        error = SimulationInterrupted(f"stopped before {place}")
    elif isinstance(cause, Exception):
        error = SimulationError(f"{place}: {type(cause).__name__}: {cause}")
    else:
        return cause  # SystemExit and its like go their way
    error.trajectory, error.step = trajectory, trajectory.steps
    error.__cause__ = None if isinstance(cause, KeyboardInterrupt) else cause
    return error
