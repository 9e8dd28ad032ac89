"""Results of simulations: trajectories, their energy, contacts, impacts and limit violations."""

from __future__ import annotations

import copy
import warnings
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from ._arguments import check_result
from ._friction import transmitted
from ._motion_parts import (
    PD,
    ContactGradients,
    ContactMotion,
    ContactState,
    EnergyAudit,
    ModeChange,
    MotionEnergy,
    ShapeContacts,
    StopImpact,
    Violation,
    applied_wrenches,
    contact_wrenches,
    efforts,
    first_rows,
    of_rows,
    shape_contacts,
    with_steps,
)
from ._recorded import Recorded
from ._signals import by_handler
from ._trajectory_files import TrajectoryFiles
from .errors import ArgumentError, ContactWarning, InertiaWarning, LimitWarning, SimulationError, SimulationInterrupted, of_argument, place_in_time, warn

if TYPE_CHECKING:
    from ._core import Scene
    from ._results import RolloutGradients
    from .estimation import Bands

__all__ = [
    "PD",
    "ContactGradients",
    "ContactMotion",
    "ContactState",
    "EnergyAudit",
    "ModeChange",
    "MotionEnergy",
    "ShapeContacts",
    "StopImpact",
    "Trajectory",
    "Violation",
]

_Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(TrajectoryFiles):
    """Recorded states of a simulation; returned by Scene.simulate.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.scenes.chain(3)
    >>> path = scene.simulate([0.3] * 3, [0.0] * 3, dt=1e-3, steps=100)
    >>> path.q.shape, float(path.t[-1])
    ((101, 3), 0.1)
    """

    scene: Scene
    """The simulated scene."""
    t: _Array
    """Times of the rows, (rows,), s."""
    q: _Array
    """Configurations, (..., rows, nq)."""
    qd: _Array
    """Joint velocities, (..., rows, nv)."""
    dt: float
    """Step size, s."""
    steps: int
    """Number of completed steps."""
    method: str
    """Method that was requested."""
    armature: _Array = field(repr=False)
    """Armature of the simulation, (nv,), or (..., nv) if states differ in it."""
    stiffness: _Array = field(repr=False)
    """Stiffness of the joint springs, (nv,), or (..., nv)."""
    rest: _Array = field(repr=False)
    """Configuration at which the joint springs are at rest, (nq,)."""
    inertias: _Array | None = field(default=None, repr=False)
    """Inertial parameters of the simulation, (bodies, 10), or (..., bodies, 10) if states differ in them; None: those of
    the scene.
    """
    contacts: ContactMotion | None = field(default=None, repr=False)
    """Contacts of the scene; None if it has none."""
    record_every: int = field(default=1, repr=False)
    """Number of steps between two rows."""
    integrator: str = field(default="", repr=False)
    """Integrator that advanced the states. With method="auto", the selected one: "rk4" or "rosenbrock-2"; with
    accuracy, "dormand-prince-5" or "rosenbrock-3". In scenes with contacts, that of the steps in which no contact can
    act; all others use "contact".
    """
    friction_speed: float = field(default=0.0, repr=False)
    """Speed below which friction was regularized, rad/s or m/s; 0: exact Coulomb friction. In scenes
    with contacts, that of the steps in which contacts act.
    """
    limits: str = field(default="report", repr=False)
    """Whether joint limits were stops: "stop" or "report"."""
    stops: list[StopImpact] = field(default_factory=list, repr=False)
    """Impacts of joints on their stops, by state and time. Resting contact with a stop is not an impact."""
    end: tuple[_Array, _Array] | None = field(default=None, repr=False)
    """State after the last step, q (..., nq) and qd (..., nv). It is also the last row if record_every divides the
    number of steps.
    """
    works: tuple[_Array, ...] = field(default=(), repr=False)
    """Works of energy_audit, (...) each, J."""
    substeps: NDArray[np.int_] = field(default_factory=lambda: np.array(1), repr=False)
    """Largest number of substeps of a step, (...)."""
    events: NDArray[np.int_] = field(default_factory=lambda: np.array(0), repr=False)
    """Number of substeps in which a joint stuck, began to slide, or reached or left a stop, (...). With accuracy, also
    those in which a contact did.
    """
    estimated_error: _Array = field(default_factory=lambda: np.array(np.nan), repr=False)
    """With accuracy, the sum of the estimated errors of all substeps, (...); otherwise NaN: use error_estimate."""
    bands: Bands | None = field(default=None, repr=False)
    """With covariance, the standard deviations and covariances of each row; otherwise None."""
    given: dict[str, Any] | None = field(default=None, repr=False)
    """Other arguments of Scene.simulate, for vjp; arrays are copies. None for a Simulator."""
    applied: _Array | None = field(default=None, repr=False)
    """Torques that a control function returned for the step that begins at each row (in the last row, for the last
    step), (..., rows, nv), N m or N; None if tau was not a function.
    """
    control: _Array | None = field(default=None, repr=False)
    """Controls as they were given, (n,) or (..., steps, n); None without control."""
    activation: _Array | None = field(default=None, repr=False)
    """Activations of the actuators after the last step, (..., n), for another call of simulate; zero for those without
    one. None without control.
    """
    start_activation: _Array | None = field(default=None, repr=False)
    """Activations at the start, likewise."""

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.t)

    def __repr__(self) -> str:
        batch = self.q.shape[:-2]
        states = f"{batch} states, " if batch else ""
        return f"<phipsi.Trajectory: {states}{len(self)} rows to t = {self.t[-1]:g} s, {self.steps} steps of {self.dt:g} s by {self.method}>"

    @property
    def drift(self) -> _Array:
        """Constraint error of the connections in every row, (..., rows): the largest entry of Scene.loops.error, m
        or rad; zero without connections.
        """
        if not self.scene.loops.names:
            return np.zeros(self.q.shape[:-1])
        drift: _Array = np.abs(self.scene.loops.error(self.q)).max(axis=-1)
        return drift

    def energy(self) -> MotionEnergy:
        """Kinetic, potential and spring energy in every row, with the armature and springs of the simulation.

        Returns
        -------
        MotionEnergy
            Energies, (..., rows) each, J.

        Examples
        --------
        >>> import phipsi
        >>> scene = phipsi.scenes.chain(3)
        >>> path = scene.simulate([0.3] * 3, [0.0] * 3, dt=1e-3, steps=100)
        >>> energy = path.energy()
        >>> bool(abs(energy.total[-1] - energy.total[0]) < 1e-6)
        True
        """
        energy = self.scene.energy(self.q, self.qd, **self._own_inertias)
        rotors = 0.5 * ((of_rows(self.armature) - self.scene.armature) * self.qd**2).sum(axis=-1)
        return MotionEnergy(np.asarray(energy.kinetic + rotors), np.asarray(energy.potential), self._springs())

    def energy_audit(self) -> EnergyAudit:
        """Energy balance from the start to the last step: works of torques and wrenches, damping, friction, control, stops and
        contacts, and the remainder.

        Works are accumulated in every step, recorded or not. The energy of a passive scene increases by at most the
        remainder.

        Returns
        -------
        EnergyAudit
            Works, change of the energy, and remainder, (...) each, J.

        Raises
        ------
        ArgumentError
            If the trajectory is that of a Simulator, whose initial state is not recorded.
        NotFiniteError
            If an energy overflows.

        Examples
        --------
        >>> import phipsi
        >>> scene = phipsi.scenes.chain(3)
        >>> path = scene.simulate([0.3] * 3, [0.0] * 3, dt=1e-3, steps=100)
        >>> bool(abs(path.energy_audit().remainder) < 1e-6)
        True
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
        check_result("energy audit", [change, remainder])
        sizes = [energy.kinetic.max(axis=-1), np.ptp(energy.potential + energy.spring, axis=-1)]
        rounding = 1e-12 * (np.abs(energy.kinetic) + np.abs(energy.potential) + np.abs(energy.spring)).max(axis=-1)
        scale = np.max([np.abs(size) for size in (*works, *sizes, rounding)], axis=0)
        relative_error = np.asarray(np.abs(remainder) / np.where(scale > 0.0, scale, 1.0))
        return EnergyAudit(torque, damping, friction, control, stops, contacts, change, remainder, relative_error)

    def error_estimate(self) -> _Array:
        """Estimated error of the configuration in every row: twice the largest entry of the difference from a more
        accurate simulation.

        Returns
        -------
        array
            Estimated error, (..., rows), rad or m; zero in the first row.

        Raises
        ------
        ArgumentError
            If tau was a function, if the trajectory is that of a Simulator, or with accuracy (use estimated_error).
        SimulationError
            If the more accurate simulation fails.

        Notes
        -----
        A simulation with method="auto" is repeated with error control (accuracy=1e-7), which resolves impacts,
        sticking, and vibrations that the step damps. With another method it is repeated with a third of the step; the
        estimate is then unreliable when the mode of friction or stops changes. The estimate does not include model
        errors such as those of regularized friction. For chaotic motion it grows with the error.

        Examples
        --------
        >>> import phipsi
        >>> scene = phipsi.scenes.chain(3)
        >>> path = scene.simulate([0.3] * 3, [0.0] * 3, dt=1e-3, steps=100)
        >>> bool(path.error_estimate().max() < 1e-4)
        True
        """
        given = {name: value for name, value in self._known().items() if value is not None}
        if given.pop("accuracy", None) is not None:
            raise of_argument(ArgumentError, "accuracy", "found a simulation with error control; expected one with fixed steps: use estimated_error")
        scene, start = self.scene, (self.q[..., 0, :], self.qd[..., 0, :])
        given |= {"method": self.method, **self._properties}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LimitWarning)
            warnings.simplefilter("ignore", ContactWarning)
            try:
                accurate = scene.simulate(*start, dt=self.dt, steps=self.steps, record_every=self.record_every, accuracy=1e-7, **given)
            except ArgumentError:
                # This method or scene does not support error control.
                given = with_steps(given, lambda values: np.repeat(values[..., : self.steps, :], 3, axis=-2))
                accurate = scene.simulate(*start, dt=self.dt / 3, steps=3 * self.steps, record_every=3 * self.record_every, **given)
        difference: _Array = 2.0 * np.abs(scene.difference(self.q, accurate.q)).max(axis=-1, initial=0.0)
        return difference

    def torques(self) -> _Array:
        """Joint torques in every row: tau of the step that begins there (in the last row, of the last step), springs,
        damping, friction and pd.

        The torques of stops, and of exact friction on a joint at rest, are results of the motion and are not
        included. Wrenches on links are not joint torques and are not included either.

        Returns
        -------
        array
            Torques, (..., rows, nv), N m or N.

        Raises
        ------
        ArgumentError
            If the trajectory is that of a Simulator or of Scene.ode.

        Examples
        --------
        >>> import phipsi
        >>> scene = phipsi.scenes.chain(3)
        >>> path = scene.simulate([0.3] * 3, [0.0] * 3, dt=1e-3, steps=100)
        >>> path.torques().shape
        (101, 3)
        """
        given, scene, v = self._known(by_function=True), self.scene, self.qd

        def own(name: str, usual: _Array) -> _Array:
            return usual if given.get(name) is None else of_rows(np.asarray(_core._numbers(name, given[name], scene, False)))

        u = -own("damping", scene.damping) * v - of_rows(self.stiffness) * self._displacement(self.rest, self.q)
        speed = self.friction_speed
        direction = v / np.sqrt(v**2 + speed**2) if speed > 0.0 else np.sign(v)
        return transmitted(scene, u + efforts(self, given), v, direction, own("friction", scene.friction))

    @property
    def connection_forces(self) -> NoReturn:
        """The former name of constraint_forces: raises AttributeError."""
        raise AttributeError(
            "connection_forces: found the former name of a method; expected constraint_forces",
            name="connection_forces",
            obj=self,
        )

    def constraint_forces(self) -> dict[str, _Array]:
        """Force of each connection on its link in every row: Scene.loops.dynamics with torques().

        Returns
        -------
        dict of str to array
            Forces by name of the connection, (..., rows, m), N m and N, with the signs and frames of
            Scene.loops.dynamics.

        Raises
        ------
        ArgumentError
            If the trajectory is that of a Simulator or of Scene.ode.

        Notes
        -----
        The cost per row is O(N) and quadratic in the number of constraints. The forces of contacts, which are
        included, are in contacts.force: those during the step that ends at the row, zero in the first row.

        Examples
        --------
        >>> import phipsi
        >>> scene = phipsi.scenes.chain(3)
        >>> path = scene.simulate([0.3] * 3, [0.0] * 3, dt=1e-3, steps=100)
        >>> path.constraint_forces()
        {}
        """
        scene = self.scene
        if not scene.loops.names:
            return {}
        own: dict[str, Any] = self._own_inertias
        if self.armature.ndim > 1:
            own["armature"] = of_rows(self.armature)
        elif not np.array_equal(self.armature, scene.armature):
            scene = scene.with_properties(armature=self.armature)
        given = {} if self.given is None or "compliance" not in self.given else {"compliance": self.given["compliance"]}
        wrenches = applied_wrenches(self)
        if self.contacts is not None:
            for link, wrench in contact_wrenches(self.scene, self.q, self.contacts).items():
                wrenches[link] = wrenches.get(link, 0.0) + wrench
        return dict(scene.loops.dynamics(self.q, self.qd, self.torques(), wrenches=wrenches, errors="nan", **given, **own).forces)

    def _displacement(self, rest: _Array, q: _Array) -> _Array:
        """Displacement from rest to q, (..., nv), as springs measure it: for a free joint the distance in the child
        frame, not the length of a screw motion.
        """
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
        # Joints without a spring have no energy at any distance, whose square can overflow.
        displacement = self._displacement(self.rest, self.q)
        springs: _Array = 0.5 * (of_rows(self.stiffness) * displacement * displacement).sum(axis=-1)
        return springs

    def momentum(self) -> _Array:
        """Spatial momentum (angular about the origin of the base, linear) in every row.

        Returns
        -------
        array
            Momentum, (..., rows, 6), kg m^2/s and kg m/s, in the base frame.

        Examples
        --------
        >>> import phipsi
        >>> scene = phipsi.scenes.chain(3)
        >>> path = scene.simulate([0.3] * 3, [0.0] * 3, dt=1e-3, steps=100)
        >>> path.momentum().shape
        (101, 6)
        """
        return self.scene.momentum(self.q, self.qd, **self._own_inertias)

    @property
    def _own_inertias(self) -> dict[str, Any]:
        """Inertial parameters as an argument for all rows, (..., 1, bodies, 10), if they are not those of the scene."""
        return {} if self.inertias is None else {"inertias": self.inertias[..., None, :, :]}

    def vjp(
        self, cotangent_q: ArrayLike | None = None, cotangent_qd: ArrayLike | None = None, *, parameters: bool = False
    ) -> RolloutGradients:
        """Gradients of a scalar function of this trajectory, by the adjoint of every step.

        Parameters
        ----------
        cotangent_q : array_like, (..., rows, nv), optional
            Gradient of the function with respect to q of every row, in the tangent space of the row: an angle
            or a length for joints with one axis, a rotation in the child frame for spherical joints, (linear,
            angular) in the child frame for free joints. None: zero.
        cotangent_qd : array_like, (..., rows, nv), optional
            Gradient of the function with respect to qd of every row. None: zero.
        parameters : bool
            True to compute the gradients with respect to inertial parameters.

        Returns
        -------
        RolloutGradients
            Gradients with respect to the initial state, the torques and the joint properties.

        Raises
        ------
        ArgumentError
            If tau was a function, or if the trajectory is that of a Simulator.
        PhipsiError
            As Scene.simulate_vjp.

        Notes
        -----
        Recorded rows are checkpoints; the steps between them are recomputed. With record_every=1 nothing is
        recomputed, except steps with contacts, which are differentiated in the modes of their contacts (open, sticking,
        sliding; docs/motion.md), and steps with connections. With coupled joints, gradients are those by the
        independent coordinates. The cost is O(N) per stage of a step.

        Examples
        --------
        >>> import phipsi
        >>> scene = phipsi.scenes.chain(3)
        >>> path = scene.simulate([0.3] * 3, [0.0] * 3, dt=1e-3, steps=100)
        >>> path.vjp(path.q).q.shape
        (3,)
        """
        given = self._arguments()
        nothing = np.zeros((len(self), self.scene.nv))
        cotangents = [nothing if cotangent is None else cotangent for cotangent in (cotangent_q, cotangent_qd)]
        found = self.scene.simulate_vjp(self.q, self.qd, *cotangents, parameters=parameters, **given)
        return found if self.control is None else found._replace(control=self.scene.actuators._gradients(self, found))

    def _arguments(self) -> dict[str, Any]:
        """Arguments of Scene.simulate, for Scene.simulate_vjp."""
        given = self._known()
        if given.pop("accuracy", None) is not None:
            raise of_argument(ArgumentError, "accuracy", "found a simulation with error control; expected one with fixed steps, which have gradients")
        given = with_steps(given, lambda values: values[..., : self.steps, :])
        own = {"dt": self.dt, "steps": self.steps, "method": self.method, "record_every": self.record_every}
        return {**given, **own, **self._properties}

    @property
    def _properties(self) -> dict[str, Any]:
        """Arguments of Scene.simulate that are fields."""
        return {name: getattr(self, name) for name in ("inertias", "armature", "stiffness", "rest")}

    @property
    def has_torques(self) -> bool:
        """Whether torques() is known: not for a Simulator, and for Scene.ode not if tau was a function."""
        return self.given is not None and (self.applied is not None or not isinstance(self.given.get("tau"), str))

    def _known(self, by_function: bool = False) -> dict[str, Any]:
        """Arguments of Scene.simulate; raises ArgumentError if they are not recorded. by_function: the recorded torques
        of a function suffice.
        """
        if self.given is None:
            raise of_argument(ArgumentError, "trajectory", "found the trajectory of a Simulator; expected one with all rows: use Scene.simulate")
        if isinstance(self.given.get("tau"), str) and not (by_function and self.applied is not None):
            raise of_argument(ArgumentError, "tau", "found a function; expected arrays: pass the values of the function as tau_steps")
        return dict(self.given)

    def violations(self) -> list[Violation]:
        """Limits of position, velocity and effort that recorded rows exceed.

        Velocities are never limited in a simulation; positions are limited with limits="stop", whose stops may push with
        any torque, and efforts with effort="clip" and with PD(effort=...). The effort of a joint is that of tau and pd
        for the step that begins at a row. It is not listed for a Simulator and for Scene.ode with a function tau.
        With control, the controls, forces and joint torques of actuators that are clipped to their ranges are listed,
        with the values before.

        Returns
        -------
        list of Violation
            Violations, in the order of the joints.

        Examples
        --------
        >>> import phipsi
        >>> scene = phipsi.scenes.chain(3)
        >>> path = scene.simulate([0.3] * 3, [0.0] * 3, dt=1e-3, steps=100)
        >>> path.violations()
        []
        """
        found = []
        limits = self.scene.limits
        motors = efforts(self, self._known(by_function=True)) if self.has_torques else None
        for joint in self.scene.joint_names:
            q, v = self.scene.q_index(joint), self.scene.v_index(joint)
            cases = []
            if q.stop - q.start == v.stop - v.start:
                cases = [("lower", self.q[..., q], limits.lower[v], -1.0), ("upper", self.q[..., q], limits.upper[v], 1.0)]
            cases.append(("velocity", self.qd[..., v], limits.velocity[v], 1.0))
            if motors is not None:
                cases.append(("effort", motors[..., v], limits.effort[v], 1.0))
            for limit, values, bounds, sign in cases:
                if not np.all(np.isinf(bounds)):
                    found += self._beyond(joint, limit, values, float(bounds[0]), sign)
        for joint, limit, values, ends in () if self.control is None else self.scene.actuators._clipped(self):
            for end, sign in zip(ends, (-1.0, 1.0), strict=True):
                if not np.isinf(end):
                    found += self._beyond(joint, limit, values[..., None], end, sign)
        return found

    def _beyond(self, joint: str, limit: str, values: _Array, bound: float, sign: float) -> list[Violation]:
        size = np.abs(values) if limit in ("velocity", "effort") else sign * values
        # The torque at a limit that is enforced is known to rounding.
        beyond = size > sign * bound + 1e-12 * abs(bound) * (limit not in ("lower", "upper", "velocity"))
        if not beyond.any():
            return []
        worst = values.reshape(-1)[np.argmax(size)]
        rows = beyond.any(axis=-1)
        first = rows.reshape(-1, rows.shape[-1]).any(axis=0).argmax()
        return [Violation(joint, limit, bound, float(worst), float(self.t[first]), int(rows.sum()))]


#: Placeholder for a torque that was a function: its gradients are unknown, and few functions can be pickled.
_FUNCTION = "a function"


def _kept(given: dict[str, Any]) -> dict[str, Any]:
    """Copies of the arguments, because the caller may modify them later."""

    def own(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value.copy()
        return _FUNCTION if callable(value) else copy.deepcopy(value)

    return {name: own(value) for name, value in given.items()}


def trajectory_of(
    q: _Array, qd: _Array, *, scene: Scene, dt: float, record_every: int, steps: int, given: dict[str, Any], **about: Any
) -> Trajectory:
    """Trajectory of the rows that `steps` steps have filled; about: the other fields of Trajectory."""
    rows = steps // record_every + 1
    t: _Array = np.arange(rows, dtype=np.float64) * (record_every * dt)
    if rows < q.shape[-2]:
        q, qd = q[..., :rows, :], qd[..., :rows, :]
        if about.get("contacts") is not None:
            about["contacts"] = first_rows(about["contacts"], rows, q.ndim - 2)
    tau = given.get("tau")
    applied = tau.rows(q.shape[:-2], rows, qd.shape[-1]) if isinstance(tau, Recorded) else None
    return Trajectory(scene, t, q, qd, dt, steps, record_every=record_every, given=_kept(given), applied=applied, **_outcome(about))


def _outcome(about: dict[str, Any]) -> dict[str, Any]:
    """Fields of a trajectory, with counts as integers and impacts by name."""
    most, events, error, unsettled = about.pop("counts")
    if np.any(unsettled):
        found = f"found no solution for the torques of friction and joint stops in {int(np.sum(unsettled))} steps"
        if about.get("contacts") is None:
            message = f"{found}, because the inertia of a link is not physical and the mass matrix is indefinite; a joint was locked there: load with strict=True to find the link"
            warn(message, InertiaWarning)
        else:
            message = f"{found}, or for limits of effort beside contacts, where a joint was at its limit; expected a smaller dt, or inertias that are physical (load with strict=True)"
            warn(message, ContactWarning)
    counts = (np.asarray(count).astype(np.int_) for count in (most, events))
    return about | dict(zip(("substeps", "events"), counts)) | {"estimated_error": np.asarray(error)}


def contacts_of(given: tuple[tuple[str, ...], tuple[str, ...]], rows: _Array, totals: _Array, shapes: _Array) -> ContactMotion:
    """Recorded values by name: rows (..., contacts * 11), the values of the steps, (..., 11), and the contacts of shapes,
    (k, 17). given: names of the contacts and of the colliders.
    """
    names, colliders = given
    each = rows.reshape(*rows.shape[:-1], len(names), 11)
    by_name = [{name: each[..., i, part] for i, name in enumerate(names)} for part in _PARTS]
    residual, converged, iterations, *rest = np.moveaxis(totals, -1, 0)
    gap, slip, force, impulse = by_name
    state = {name: each[..., i, 10].astype(np.int8) for i, name in enumerate(names)}
    solved = residual, converged > 0, iterations.astype(np.int_)
    return ContactMotion(gap, slip, force, impulse, state, *solved, *rest, shapes=shape_contacts(colliders, shapes))  # type: ignore[misc]


#: Indices of the gap, slip velocity, force and impulse in the values of a contact.
_PARTS: tuple[int | slice, ...] = (0, slice(1, 4), slice(4, 7), slice(7, 10))


def only_now(q: _Array, qd: _Array, *, scene: Scene, dt: float, steps: int, **about: Any) -> Trajectory:
    """Trajectory with one row: the state of a Simulator after `steps` steps; about: the other fields of Trajectory."""
    return Trajectory(scene, np.array([steps * dt]), q, qd, dt, steps, **_outcome(about))


def stopped(
    trajectory: Trajectory, cause: BaseException, joint: str | None, state: int | tuple[int, ...] | None, by_signal: bool
) -> BaseException:
    """Exception of a simulation that ended early, with the completed steps; without a joint if tau, progress or a signal
    handler raised the cause.
    """
    place = place_in_time(trajectory.steps, trajectory.steps * trajectory.dt)
    error: SimulationError | SimulationInterrupted
    if joint is not None:
        error = SimulationError(f"{place}: {cause}")
        error.joint, error.state = joint, state
    elif isinstance(cause, KeyboardInterrupt):
        error = SimulationInterrupted(f"stopped before {place}")
    elif isinstance(cause, Exception) and not by_signal and not by_handler(cause):
        error = SimulationError(f"{place}: {type(cause).__name__}: {cause}")
    else:
        return cause  # for instance SystemExit, or the TimeoutError of a signal handler, which are raised unchanged
    error.trajectory, error.step = trajectory, trajectory.steps
    error.__cause__ = None if isinstance(cause, KeyboardInterrupt) else cause
    return error
