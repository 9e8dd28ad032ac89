"""Parts of a trajectory: control law, energies, contacts, impacts and limit violations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from ._summary import summarized

if TYPE_CHECKING:
    from ._core import Scene

__all__ = [
    "PD",
    "ContactGradients",
    "ContactMotion",
    "ContactState",
    "EnergyAudit",
    "ModeChange",
    "MotionEnergy",
    "StopImpact",
    "Violation",
]

_Array = NDArray[np.float64]
_Number = TypeVar("_Number", np.float64, np.int8)


class PD(NamedTuple):
    """Proportional-derivative control law for Scene.simulate: tau = kp (target - q) + kd (target_rate - qd), up to the
    limits of effort and of motors.

    The difference target - q is taken on the manifold. Implicit methods treat the law implicitly, so that the
    gains can be arbitrarily stiff. Limits apply within the step: at a limit the torque is constant, and otherwise the
    step is the one without limits.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.scenes.chain(3)
    >>> law = phipsi.PD(kp=1e4, kd=1e3, target=[0.3] * 3)
    >>> path = scene.simulate([0.0] * 3, [0.0] * 3, dt=1e-3, steps=2000, pd=law)
    >>> bool(abs(path.q[-1] - 0.3).max() < 0.01)
    True
    """

    kp: ArrayLike
    """Proportional gains, (..., nv), N m/rad or N/m. A scalar is the gain of all joints but free ones, which have no
    motor.
    """
    kd: ArrayLike
    """Derivative gains, likewise, N m s/rad or N s/m."""
    target: ArrayLike | None = None
    """Target configurations, (..., nq). None: not needed if kp is zero, or if the call has targets of each step."""
    target_rate: ArrayLike | None = None
    """Target joint velocities, (..., nv); None: zero."""
    effort: ArrayLike | bool | None = None
    """Largest torque of the law in both directions, (..., nv), or a scalar for all joints but free ones, N m or N.
    True: scene.limits.effort. None: no limits.
    """
    stall: ArrayLike | None = None
    """Torques at rest of motors whose largest torque declines with the speed, stall (1 - qd / no_load_speed), (..., nv);
    None: the limits of effort. The torque is also within the limits of effort.
    """
    no_load_speed: ArrayLike | None = None
    """Speeds at which the torque of these motors is zero, (..., nv), rad/s or m/s; None: it does not decline."""


def of_motors(scene: Scene, given: ArrayLike, free: float = 0.0) -> ArrayLike:
    """A gain or limit of PD for each degree of freedom: a scalar is that of all joints but free ones."""
    if isinstance(given, Mapping) or np.ndim(given):
        return given
    values = np.full(scene.nv, given, dtype=np.float64)
    for joint in scene.joint_names:
        if scene.joints[joint].type == "floating":
            values[scene.v_index(joint)] = free
    return values


def efforts(path: Any, given: dict[str, Any]) -> _Array:
    """Torques of the motors in every row: tau and pd, within the limits that the simulation enforces."""
    scene, v = path.scene, path.qd

    def read(name: str, value: ArrayLike, coordinates: bool = False) -> _Array:
        return np.asarray(_core._numbers(name, value, scene, coordinates))

    begun = np.minimum(np.arange(len(path)) * path.record_every, max(path.steps - 1, 0))
    u = np.zeros_like(v)
    if path.applied is not None:
        u = u + path.applied
    elif given.get("tau") is not None:
        u = u + read("tau", given["tau"])[..., None, :]
    if given.get("tau_steps") is not None and path.steps:
        u = u + read("tau_steps", given["tau_steps"])[..., begun, :]
    law = None if given.get("pd") is None else PD(*given["pd"])
    if law is not None:
        kp, kd = (read(name, of_motors(scene, gain))[..., None, :] for name, gain in (("kp", law.kp), ("kd", law.kd)))
        rates = law.target_rate
        if given.get("target_rates") is not None and path.steps:
            rate = read("target_rates", given["target_rates"])[..., begun, :]
        else:
            rate = np.zeros(1) if rates is None else read("target_rate", rates)[..., None, :]
        if given.get("targets") is not None and path.steps:
            target = read("targets", given["targets"], True)[..., begun, :]
        else:
            target = read("target", scene.neutral() if law.target is None else law.target, True)[..., None, :]
        control = kd * (rate - v) - kp * path._displacement(target, path.q)

        def bound(name: str, value: Any) -> _Array:
            """Bounds in each row, infinite if they are not given."""
            if value is None or value is False:
                return np.full((1, 1), np.inf)
            return np.asarray(scene.limits.effort if value is True else read(name, of_motors(scene, value, np.inf)))[..., None, :]

        limit, speed = bound("effort", law.effort), bound("no_load_speed", law.no_load_speed)
        stall = bound("stall", law.effort if law.stall is None else law.stall)
        with np.errstate(invalid="ignore"):
            decline = np.where(np.isinf(stall) | np.isinf(speed), 0.0, v * stall / speed)
        lower, upper = -np.clip(stall + decline, 0.0, limit), np.clip(stall - decline, 0.0, limit)
        is_sum = given.get("effort") == "clip"
        u = np.clip(u + control, lower, upper) if is_sum else u + np.clip(control, lower, upper)
    if given.get("effort") == "clip":
        u = np.clip(u, -scene.limits.effort, scene.limits.effort)
    return np.asarray(u)


@summarized
class MotionEnergy(NamedTuple):
    """Energy along a trajectory, (..., rows) each, J.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.scenes.chain(3)
    >>> path = scene.simulate([0.3] * 3, [0.0] * 3, dt=1e-3, steps=100)
    >>> path.energy().total.shape
    (101,)
    """

    kinetic: _Array
    """Kinetic energy qd* M qd / 2, armature included."""
    potential: _Array
    """Potential energy of gravity; zero if the center of mass is at the origin of the base."""
    spring: _Array
    """Energy of the joint springs, without that of the control law."""

    @property
    def total(self) -> _Array:
        """Sum of kinetic, potential and spring energy, (..., rows), J."""
        return self.kinetic + self.potential + self.spring


class ContactState(IntEnum):
    """State of a contact in a step: the values of ContactMotion.state.

    Examples
    --------
    >>> import phipsi
    >>> int(phipsi.ContactState.STICKING)
    1
    """

    OPEN = 0
    """The normal force is zero."""
    STICKING = 1
    """The normal force is positive, and the slip is below 1e-9 of the velocity of the fastest contact."""
    SLIDING = 2
    """The contact slips, and the friction force is at its bound. A contact without friction has this state
    at any slip speed, also at zero.
    """


@summarized
class ContactMotion(NamedTuple):
    """Contacts of a trajectory by name, in every row: (..., rows), or (..., rows, 3) in the base frame; and totals over
    all steps, (...).

    Examples
    --------
    >>> import phipsi
    >>> ball = phipsi.SceneBuilder().link("world").link("ball", mass=1.0, inertia=[[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    >>> ball = ball.joint("z", "prismatic", "world", "ball", axis=(0, 0, 1)).contact("floor", "ball", radius=0.1, friction=0.5)
    >>> path = ball.build().simulate([0.5], [0.0], dt=1e-3, steps=1000)
    >>> int(path.contacts.state["floor"][-1]) != phipsi.ContactState.OPEN
    True
    """

    gap: dict[str, _Array]
    """Signed distance to the surface, (..., rows), m; negative below the surface."""
    slip: dict[str, _Array]
    """Tangential velocity of the point nearest to the surface, relative to it, (..., rows, 3), m/s."""
    force: dict[str, _Array]
    """Force on the link in the step that ends at the row, without impacts, (..., rows, 3), N; zero in the first row.

    The opposite force acts on the link of the surface, if there is one.
    """
    impulse: dict[str, _Array]
    """Impulse on the link of all impacts with rebound since the previous row, (..., rows, 3), N s."""
    state: dict[str, NDArray[np.int8]]
    """ContactState in the step that ends at the row, (..., rows): 0 open, 1 sticking, 2 sliding; open in the first row.

    The state is that at the end of the step. If a rebound has separated the contact by then, it is the state at
    the end of the impact.
    """
    residual: _Array
    """Largest residual of the contact law in a step, (...): a velocity relative to that of the fastest contact.

    Above 1e-5 the simulation ends with SimulationError.
    """
    converged: NDArray[np.bool_]
    """Whether the solver met 1e-10, or the rounding level of its values, in every step, (...)."""
    iterations: NDArray[np.int_]
    """Number of iterations of all solves, (...): the number of factorized matrices."""
    lost_in_impacts: _Array
    """Kinetic energy lost in impacts, (...), J: in rebounds, in landings of contacts that do not rest at the start of the step, and in jams
    whose impulse accelerates the slip. With `smoothing`, the work against normal forces, which can be negative.
    """
    lost_in_friction: _Array
    """Energy dissipated by friction, (...), J; not negative."""
    expansion_kept: _Array
    """Smallest fraction of a rebound that was applied so that an impact does not increase the kinetic energy, (...); 1
    if no rebound was reduced.
    """
    impulse_kept: _Array
    """Smallest fraction of an impulse that was applied so that an impact does not increase the kinetic energy, (...);
    below 1 only if a solve did not converge.
    """
    depth: _Array
    """Largest penetration at the end of a step, before it was corrected, (...), m; with smoothing it is not corrected."""
    bias: _Array
    """With smoothing, the largest residual of the exact contact law in a step, as residual, (...); 0 without."""
    hover: _Array
    """With smoothing, the largest gap at the end of a step of a contact that carries at least its equal share of the
    weight of its tree, (...), m; 0 without.
    """
    creep: _Array
    """With smoothing, the largest slip speed at the end of a step of a contact whose state is STICKING, (...), m/s; 0
    without.
    """
    shapes: ShapeContacts
    """Points at which shapes touch in the recorded rows."""


@summarized
class ShapeContacts(NamedTuple):
    """Points at which colliders touch, one entry per point, sorted by state and row.

    Examples
    --------
    >>> import phipsi
    >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
    >>> builder = builder.collider("ball", phipsi.shapes.Sphere(0.1), link="ball").collider("ground", phipsi.shapes.HalfSpace())
    >>> ball = builder.build(floating_base=True)
    >>> path = ball.simulate([0, 0, 0.1, 0, 0, 0, 1], [0] * 6, dt=1e-3, steps=10)
    >>> path.contacts.shapes.pairs(), path.contacts.shapes.force[-1].round(6)
    ([('ball', 'ground')], array([0.  , 0.  , 9.81]))
    """

    names: tuple[str, ...]
    """Names of the colliders of the scene."""
    state: NDArray[np.int_]
    """Index of the state in the batch, (k,); 0 for one state."""
    row: NDArray[np.int_]
    """Index of the row; the forces act in the step that ends there, (k,)."""
    pair: NDArray[np.int_]
    """Indices of the two colliders in `names`, the smaller one first, (k, 2)."""
    point: _Array
    """Where the force acts at the end of the step, in the base frame, (k, 3), m."""
    normal: _Array
    """Unit normal toward the first collider, in the base frame, (k, 3)."""
    gap: _Array
    """Distance of the shapes at the end of the step, (k,), m; negative for penetration."""
    force: _Array
    """Force on the first collider in the step, in the base frame, (k, 3), N; the opposite force acts on the second."""
    impulse: _Array
    """Impulse on the first collider of a rebound in the step, in the base frame, (k, 3), N s."""

    def pairs(self) -> list[tuple[str, str]]:
        """Names of the pairs that touched, each once, in the order of their first contact.

        Returns
        -------
        pairs : list of (str, str)
            Names of both colliders.

        Examples
        --------
        >>> import phipsi
        >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
        >>> builder = builder.collider("ball", phipsi.shapes.Sphere(0.1), link="ball")
        >>> path = builder.build(floating_base=True).simulate([0, 0, 0.1, 0, 0, 0, 1], [0] * 6, dt=1e-3, steps=10)
        >>> path.contacts is None
        True
        """
        return list(dict.fromkeys((self.names[i], self.names[j]) for i, j in self.pair.tolist()))


@summarized
class EnergyAudit(NamedTuple):
    """Energy balance of a simulation, (...) each, J: the work of everything that acts at the joints, from the start to
    the last step.

    Examples
    --------
    >>> import phipsi
    >>> scene = phipsi.scenes.chain(3)
    >>> path = scene.simulate([0.3] * scene.nv, [0.0] * scene.nv, dt=1e-3, steps=100)
    >>> bool(abs(path.energy_audit().remainder) < 1e-6)
    True
    """

    torque: _Array
    """Work of tau, and of the wrenches on links."""
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
    """Change minus the sum of all works: the error of the integrator, and that of the works, which are sums over
    steps.
    """
    relative_error: _Array
    """The absolute value of the remainder, relative to the largest of the kinetic energy, the range of the potential
    energy, and each work.
    """

    def __getattr__(self, name: str) -> NoReturn:
        """Name the new attribute where the old one is read."""
        new = "; it was renamed to 'relative_error'" if name == "share" else ""
        raise AttributeError(f"'EnergyAudit' object has no attribute {name!r}{new}", name=name, obj=self)


@summarized
class ContactGradients(NamedTuple):
    """Gradients of a scalar function of a trajectory by one contact, and its margin, independently for each state.

    Examples
    --------
    >>> import phipsi
    >>> builder = phipsi.SceneBuilder().link("puck", mass=1.0, inertia=[[1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> scene = builder.contact("foot", "puck", friction=0.5).build(floating_base=True)
    >>> path = scene.simulate([0, 0, 0, 0, 0, 0, 1], [1, 0, 0, 0, 0, 0], dt=1e-3, steps=100)
    >>> speed = [[0] * 6] * 100 + [[1, 0, 0, 0, 0, 0]]
    >>> round(float(path.vjp(cotangent_qd=speed).contacts["foot"].friction), 3)     # -g t
    -0.981
    """

    friction: _Array
    """With respect to the coefficient of friction, (...)."""
    restitution: _Array
    """With respect to the coefficient of restitution, (...); of the impacts that rebound."""
    offset: _Array
    """With respect to the offset of the plane, (...); NaN for a contact with a sphere or a box, and for shapes."""
    normal: _Array
    """With respect to the unit normal of the plane, tangent to the unit sphere, (..., 3), in the frame in which
    SceneBuilder.contact gives it: the base frame, or the second frame of a contact with another link. NaN for a contact
    with a sphere or a box, and for shapes.
    """
    margin: _Array
    """Smallest distance from another mode over all steps, (...), m/s: the change of a velocity of the contact after which
    it would open, close, stick or slide. The gradients hold within this distance.
    """
    margin_step: _Array
    """The step with this distance, counted from zero, (...)."""


class ModeChange(NamedTuple):
    """Change of the state of a contact between two steps of a trajectory.

    Examples
    --------
    >>> import phipsi
    >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=[[1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> scene = builder.contact("ground", "ball", friction=0.5, radius=0.1).build(floating_base=True)
    >>> path = scene.simulate([0, 0, 0.11, 0, 0, 0, 1], [0, 0, -1, 0, 0, 0], dt=1e-3, steps=20)
    >>> change = path.vjp(path.qd).mode_changes[0]
    >>> change.contact, change.before.name, change.after.name
    ('ground', 'OPEN', 'STICKING')
    """

    contact: str | tuple[str, str]
    """Name of the contact, or the names of two colliders, for each of their points of contact that changes."""
    step: int
    """The first step in the new state, counted from zero."""
    before: ContactState
    """State in the step before."""
    after: ContactState
    """State in this step."""
    state: int | tuple[int, ...] | None
    """Index of the state in the batch; None for a single state."""


def mode_change(contact: str | tuple[str, str], step: int, before: float, after: float, state: int | tuple[int, ...] | None) -> ModeChange:
    """The change between two states with these numbers."""
    return ModeChange(contact, step, ContactState(int(before)), ContactState(int(after)), state)


class StopImpact(NamedTuple):
    """Impact of a joint on a stop.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> arm = phipsi.load(phipsi.BUNDLED_ARM)
    >>> path = arm.simulate(np.zeros(6), np.zeros(6), dt=1e-3, steps=1000)
    >>> [impact.joint for impact in path.stops][:1]
    ['joint2']
    """

    joint: str
    """Name of the joint."""
    limit: str
    """Stop: "lower" or "upper"."""
    time: float
    """Time at the end of the step or substep of the impact, s."""
    speed: float
    """Speed of the joint before the impact, rad/s or m/s."""
    impulse: float
    """Impulse of the stop on the joint, N m s or N s."""
    state: int | tuple[int, ...] | None
    """Index of the state in the batch; None for a single state."""


class Violation(NamedTuple):
    """A limit that a trajectory exceeds in at least one recorded row.

    Examples
    --------
    >>> import numpy as np
    >>> import phipsi
    >>> arm = phipsi.load(phipsi.BUNDLED_ARM)
    >>> path = arm.simulate(np.zeros(6), np.zeros(6), dt=1e-3, steps=1000, limits="report")
    >>> [violation.limit for violation in path.violations()][:1]
    ['upper']
    """

    joint: str
    """Name of the joint."""
    limit: str
    """Limit: "lower", "upper", "velocity" or "effort"; of actuators "control of NAME", "force of NAME", or "torque of
    actuators" of a joint.
    """
    bound: float
    """Value of the limit."""
    worst: float
    """Coordinate, velocity or torque furthest beyond the limit."""
    time: float
    """Time of the first row beyond the limit, s."""
    rows: int
    """Number of rows beyond the limit, over all states."""


def no_shapes(scene: Scene) -> ShapeContacts:
    """No contacts of shapes."""
    return shape_contacts(scene.collider_names, np.zeros((0, 17)))


def shape_contacts(names: tuple[str, ...], values: _Array) -> ShapeContacts:
    """Contacts of shapes from their values, (k, 17)."""
    state, row, pair = values[:, 0].astype(np.int_), values[:, 1].astype(np.int_), values[:, 2:4].astype(np.int_)
    point, normal, force, impulse = (values[:, first : first + 3] for first in (5, 8, 11, 14))
    return ShapeContacts(names, state, row, pair, point, normal, values[:, 4], force, impulse)


#: Arguments of Scene.simulate with a value for each step.
OF_STEPS = {"tau_steps", "targets", "target_rates"}


def with_steps(given: dict[str, Any], change: Callable[[_Array], _Array]) -> dict[str, Any]:
    """Arguments of Scene.simulate with `change` of those that have an axis of steps, (..., steps, n)."""
    changed: dict[str, Any] = {name: change(np.asarray(given[name])) for name in OF_STEPS & set(given)}
    if given.get("wrenches") is not None:
        changed["wrenches"] = {link: change(np.asarray(wrench)) if has_steps(wrench) else wrench for link, wrench in given["wrenches"].items()}
    return given | changed


def of_rows(values: _Array) -> _Array:
    """Numbers of all states or of each, for arrays with an axis of rows."""
    return values if values.ndim < 2 else values[..., None, :]


def has_steps(wrench: ArrayLike) -> bool:
    """True for a wrench of Scene.simulate that changes from step to step."""
    shape = np.shape(wrench)
    return len(shape) > 1 and shape[-2] != 1


def applied_wrenches(path: Any) -> dict[str, _Array]:
    """The given wrenches in every row, those of the step that begins there, on links in their frames, by name of the link:
    arrays that broadcast to (..., rows, 6).
    """
    given, wrenches = path.given or {}, dict[str, _Array]()
    begun = np.minimum(np.arange(len(path)) * path.record_every, max(path.steps - 1, 0))
    for link, value in (given.get("wrenches") or {}).items():
        wrench = np.asarray(value, np.float64)
        wrench = wrench[..., begun, :] if has_steps(wrench) else wrench
        if given.get("frame") == "world":
            turn = path.scene.placement(path.q, link)[..., :3, :3]
            wrench = np.concatenate([np.einsum("...ji,...j->...i", turn, part) for part in np.split(wrench, 2, axis=-1)], axis=-1)
        wrenches[link] = wrench
    return wrenches


def contact_wrenches(scene: Scene, q: _Array, contacts: ContactMotion) -> dict[str, _Array]:
    """Contact forces as wrenches (moment, force) on links, in their frames, by name of the link, (..., rows, 6)."""
    wrenches = dict[str, _Array]()
    places, points = scene.placements(q), scene._contact_points(q)
    for at, (name, link, *rest) in enumerate(scene._contacts()):
        other = rest[6]
        for body, sign in ((link, 1.0), (other, -1.0)):
            if body is None:
                continue
            turn, origin = places[body][..., :3, :3], places[body][..., :3, 3]
            force = sign * contacts.force[name]
            moment = np.cross(points[..., at, :] - origin, force)
            local = [np.einsum("...ji,...j->...i", turn, vector) for vector in (moment, force)]
            wrenches[body] = wrenches.get(body, 0.0) + np.concatenate(local, axis=-1)
    shapes, links = contacts.shapes, [link for _, link, *_ in scene._collisions()[0]]
    batch, rows = q.shape[:-2], q.shape[-2]
    for end, sign in ((0, 1.0), (1, -1.0)):
        of = np.array([links[i] if links[i] in places else "" for i in shapes.pair[:, end]], dtype=object)
        for body in set(of.tolist()) - {""}:
            which = of == body
            row = shapes.state[which], shapes.row[which]
            place = places[body].reshape(-1, rows, 4, 4)[row]
            force, moment = sign * shapes.force[which], sign * np.cross(shapes.point[which] - place[:, :3, 3], shapes.force[which])
            wrench = np.concatenate([np.einsum("kji,kj->ki", place[:, :3, :3], vector) for vector in (moment, force)], axis=-1)
            total = np.zeros((int(np.prod(batch)), rows, 6))
            np.add.at(total, row, wrench)
            wrenches[body] = wrenches.get(body, 0.0) + total.reshape(*batch, rows, 6)
    return wrenches


def first_rows(contacts: ContactMotion, rows: int, axis: int) -> ContactMotion:
    """The rows that were filled."""
    which = (slice(None),) * axis + (slice(rows),)

    def first(of: dict[str, NDArray[_Number]]) -> dict[str, NDArray[_Number]]:
        return {name: values[which] for name, values in of.items()}

    gap, slip, force, impulse = first(contacts.gap), first(contacts.slip), first(contacts.force), first(contacts.impulse)
    return contacts._replace(gap=gap, slip=slip, force=force, impulse=impulse, state=first(contacts.state))
