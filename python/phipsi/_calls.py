"""Common part of phipsi.jax and phipsi.torch: functions of real arrays on the host, with their derivatives."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arguments import not_numbers
from ._chart import skew
from ._coordinates import Array, Coordinates, right_jacobian, rotation_vector
from .errors import ArgumentError, BadStateWarning, PhipsiError, ShapeError, of_argument, warn
from .tasks import unit, unpacked

if TYPE_CHECKING:
    from ._core import Scene

#: Returns one array of results, or one per derivative; leading axes of the arguments are batch axes and broadcast.
Host = Callable[..., Any]
Errors = Literal["raise", "nan"]
Frame = Literal["local", "world", "local-world-aligned"]


class Call:
    """A function of a scene: its value, its derivatives with respect to each argument (to the entries of q, not to its
    tangent), and the shape of a result, whose entries are on one axis here.
    """

    def __init__(self, value: Host, derivatives: Host, names: tuple[str, ...], widths: tuple[int, ...], shape: int | tuple[int, ...]) -> None:
        self.value = value
        self.derivatives = derivatives
        #: Names and widths of the arguments, and shape and number of entries of the result.
        self.names = names
        self.widths = widths
        self.shape = (shape,) if isinstance(shape, int) else shape
        self.size = int(np.prod(self.shape))
        # With an empty batch the scene checks its options now, and not in the callback of a compiled graph.
        value(*(np.zeros((0, width)) for width in widths))


@lru_cache(maxsize=32)
def forward_dynamics(scene: Scene, form: str, errors: Errors = "raise", tolerance: float | None = None) -> Call:
    """qdd as a function of (q, qd, tau)."""
    coordinates = Coordinates(scene)

    def value(q: Array, qd: Array, tau: Array) -> Array:
        return np.asarray(scene.forward_dynamics(coordinates.normalized(q), qd, tau, form=form, tolerance=tolerance, errors=errors))  # type: ignore[call-overload]

    def derivatives(q: Array, qd: Array, tau: Array) -> tuple[Array, ...]:
        by_q, by_qd, minv = scene.forward_dynamics_derivatives(coordinates.normalized(q), qd, tau, form=form, tolerance=tolerance, errors=errors)  # type: ignore[arg-type]
        return coordinates.by_entries(q, by_q), by_qd, minv

    return Call(value, derivatives, ("q", "qd", "tau"), (scene.nq, scene.nv, scene.nv), scene.nv)


@lru_cache(maxsize=32)
def inverse_dynamics(scene: Scene, errors: Errors = "raise") -> Call:
    """tau as a function of (q, qd, qdd)."""
    coordinates = Coordinates(scene)

    def value(q: Array, qd: Array, qdd: Array) -> Array:
        return np.asarray(scene.inverse_dynamics(coordinates.normalized(q), qd, qdd, errors=errors))

    def derivatives(q: Array, qd: Array, qdd: Array) -> tuple[Array, ...]:
        by_q, by_qd, mass = scene.inverse_dynamics_derivatives(coordinates.normalized(q), qd, qdd, errors=errors)
        return coordinates.by_entries(q, by_q), by_qd, mass

    return Call(value, derivatives, ("q", "qd", "qdd"), (scene.nq, scene.nv, scene.nv), scene.nv)


@lru_cache(maxsize=32)
def integrate(scene: Scene, errors: Errors = "raise") -> Call:
    """q (+) v as a function of (q, v)."""
    coordinates = Coordinates(scene)

    def value(q: Array, v: Array) -> Array:
        return np.asarray(scene.integrate(coordinates.normalized(q), v, errors=errors))

    def derivatives(q: Array, v: Array) -> tuple[Array, ...]:
        if errors == "raise":
            return coordinates.integrated(q, v)
        bad = np.asarray(np.isnan(value(q, v)).any(axis=-1))
        q, v = (np.where(bad[..., None], harmless, array) for harmless, array in ((scene.neutral(), q), (0.0, v)))
        return tuple(np.where(bad[..., None, None], np.nan, one) for one in coordinates.integrated(q, v))

    return Call(value, derivatives, ("q", "v"), (scene.nq, scene.nv), scene.nq)


def _of_configuration(scene: Scene, shape: tuple[int, ...], of_q: Host, by_tangent: Host) -> Call:
    """A function of q alone, from arrays (..., *shape) and its derivatives by the tangent of q, (..., *shape, nv)."""
    coordinates = Coordinates(scene)
    size = int(np.prod(shape))

    def value(q: Array) -> Array:
        found = np.asarray(of_q(coordinates.normalized(q)))
        return found.reshape(*q.shape[:-1], size)

    def derivatives(q: Array) -> tuple[Array, ...]:
        found = np.asarray(by_tangent(coordinates.normalized(q)))
        return (coordinates.by_entries(q, found.reshape(*q.shape[:-1], size, scene.nv)),)

    return Call(value, derivatives, ("q",), (scene.nq,), shape)


@lru_cache(maxsize=32)
def placement(scene: Scene, link: str, errors: Errors = "raise") -> Call:
    """Pose of a link as a function of q."""

    def by_tangent(q: Array) -> Array:
        return _pose_derivative(scene.placement(q, link, errors=errors), scene.jacobian(q, link, errors=errors))

    return _of_configuration(scene, (4, 4), lambda q: scene.placement(q, link, errors=errors), by_tangent)


def _pose_derivative(pose: Array, jacobian: Array) -> Array:
    """Derivatives (..., 4, 4, nv) of poses, for Jacobians (angular, linear) in the frame of the pose."""
    moved = np.zeros((*jacobian.shape[:-2], jacobian.shape[-1], 4, 4))
    moved[..., :3, :3] = skew(np.swapaxes(jacobian[..., :3, :], -1, -2))
    moved[..., :3, 3] = np.swapaxes(jacobian[..., 3:, :], -1, -2)
    return np.moveaxis(pose[..., None, :, :] @ moved, -3, -1)


@lru_cache(maxsize=32)
def jacobian(scene: Scene, link: str, frame: Frame = "local", errors: Errors = "raise") -> Call:
    """Jacobian of a link as a function of q."""
    each = np.eye(scene.nv)

    def by_tangent(q: Array) -> Array:
        # The rate is linear in the joint velocities.
        return np.moveaxis(scene.jacobian_rate(q[..., None, :], each, link, frame=frame, errors=errors), -3, -1)

    return _of_configuration(scene, (6, scene.nv), lambda q: scene.jacobian(q, link, frame=frame, errors=errors), by_tangent)


@lru_cache(maxsize=32)
def mass_matrix(scene: Scene, errors: Errors = "raise") -> Call:
    """Mass matrix as a function of q."""
    each = np.eye(scene.nv)

    def by_tangent(q: Array) -> Array:
        return np.moveaxis(scene.mass_matrix_derivative(q[..., None, :], each, errors=errors), -3, -1)

    return _of_configuration(scene, (scene.nv, scene.nv), lambda q: scene.mass_matrix(q, errors=errors), by_tangent)


@lru_cache(maxsize=32)
def center_of_mass(scene: Scene, errors: Errors = "raise") -> Call:
    """Center of mass as a function of q."""
    return _of_configuration(
        scene, (3,), lambda q: scene.center_of_mass(q, errors=errors), lambda q: scene.center_of_mass_jacobian(q, errors=errors)
    )


@lru_cache(maxsize=32)
def bias_torque(scene: Scene, errors: Errors = "raise") -> Call:
    """Bias torque as a function of (q, qd)."""
    coordinates = Coordinates(scene)

    def value(q: Array, qd: Array) -> Array:
        return np.asarray(scene.bias_torque(coordinates.normalized(q), qd, errors=errors))

    def derivatives(q: Array, qd: Array) -> tuple[Array, ...]:
        by_q, by_qd, _ = scene.inverse_dynamics_derivatives(coordinates.normalized(q), qd, np.zeros(scene.nv), errors=errors)
        return coordinates.by_entries(q, by_q), by_qd

    return Call(value, derivatives, ("q", "qd"), (scene.nq, scene.nv), scene.nv)


def task_residual(scene: Scene, tasks: Any, errors: Errors = "raise") -> Call:
    """Errors of tasks of inverse kinematics as a function of q: the rotation before the position of each task."""
    return _task_residual(scene, pickle.dumps(unpacked(tasks)), errors)


#: Number of residuals of each kind of task.
RESIDUALS = {"pose": 6, "position": 3, "orientation": 3, "direction": 3, "look-at": 3, "center-of-mass": 3, "joint": 1}


@lru_cache(maxsize=32)
def _task_residual(scene: Scene, pickled: bytes, errors: Errors) -> Call:
    given = pickle.loads(pickled)
    for kind, name, on, *_, target, _width, _ in given:
        if target.ndim > 1:
            raise of_argument(ShapeError, f"{name}.target", f"found the leading axes {target.shape[:-1]}; expected the target of one state")
        if kind == "direction":
            unit(f"{name}.target", target)
        if kind == "joint" and scene.q_index(on).stop - scene.q_index(on).start != 1:
            raise of_argument(ArgumentError, name, f"found joint {on!r} of several coordinates; expected a joint with one")

    def each(q: Array, derivative: bool) -> Array:
        parts: list[Array] = []
        for kind, _, on, at, axis, *_, target, _, relative_to in given:
            if kind == "center-of-mass":
                parts.append(scene.center_of_mass_jacobian(q, errors=errors) if derivative else scene.center_of_mass(q, errors=errors) - target)
            elif kind == "joint":
                row = np.zeros((*q.shape[:-1], 1, scene.nv))
                row[..., scene.v_index(on)] = 1.0
                parts.append(row if derivative else q[..., scene.q_index(on)] - target)
            else:
                parts += _frame_residuals(scene, q, kind, on, (np.array(at), np.array(axis)), target, relative_to, derivative, errors)
        empty = np.zeros((*q.shape[:-1], 0, *[scene.nv] * derivative))
        return np.concatenate([empty, *parts], axis=-2 if derivative else -1)

    count = sum(RESIDUALS[kind] for kind, *_ in given)
    return _of_configuration(scene, (count,), lambda q: each(q, False), lambda q: each(q, True))


def _frame_residuals(
    scene: Scene,
    q: Array,
    kind: str,
    link: str,
    on_link: tuple[Array, Array],
    target: Array,
    relative_to: str | None,
    derivative: bool,
    errors: Errors,
) -> list[Array]:
    """Residuals of a task of the frame of a link, or their derivatives by the tangent of q: the rotation vector from
    the target to the link in the axes of the link, and the distance of the point from the target; for directions, the
    rotation vector from the target to the axis.
    """
    at, axis = on_link
    pose, motion = scene.placement(q, link, errors=errors), None
    if derivative:
        motion = scene.jacobian(q, link, errors=errors)
    if relative_to is not None:
        base = scene.placement(q, relative_to, errors=errors)
        back = np.swapaxes(base[..., :3, :3], -1, -2)
        pose = np.concatenate([back @ pose[..., :3, :3], back @ (pose[..., :3, 3:] - base[..., :3, 3:])], axis=-1)
        if motion is not None:
            of_base = scene.jacobian(q, relative_to, errors=errors)
            turn, arm = np.swapaxes(pose[..., :3, :3], -1, -2), skew(pose[..., :3, 3])
            carried = [turn @ of_base[..., :3, :], turn @ (of_base[..., 3:, :] - arm @ of_base[..., :3, :])]
            motion = motion - np.concatenate(carried, axis=-2)
    turn, place = pose[..., :3, :3], pose[..., :3, 3]
    if kind in ("direction", "look-at"):
        way = target - place - turn @ at if kind == "look-at" else np.broadcast_to(target, place.shape)
        of_axis = turn @ axis
        if motion is None:
            return [_direction(of_axis, way)[0]]
        moved = np.zeros_like(motion[..., 3:, :]) if kind == "direction" else turn @ (skew(at) @ motion[..., :3, :] - motion[..., 3:, :])
        _, by_rotation, by_way = _direction(of_axis, way)
        return [by_rotation @ turn @ motion[..., :3, :] + by_way @ moved]
    wanted = target.reshape(4, 4)[:3, :3] if kind == "pose" else target.reshape(3, 3) if kind == "orientation" else None
    goal = target.reshape(4, 4)[:3, 3] if kind == "pose" else target if kind == "position" else None
    found = []
    if wanted is not None:
        vector = rotation_vector(wanted.T @ turn)
        if motion is None:
            found.append(vector)
        else:
            right = right_jacobian(-skew(vector), np.linalg.norm(vector, axis=-1))
            found.append(np.linalg.inv(right) @ motion[..., :3, :])
    if goal is not None:
        found.append(place + turn @ at - goal if motion is None else turn @ (motion[..., 3:, :] - skew(at) @ motion[..., :3, :]))
    return found


#: Largest quotient of an angle and its sine in a derivative; the exact one is infinite for opposite directions. The
#: gradient of the angle does not depend on it.
STEEPEST = 10.0


def _direction(axis: Array, way: Array) -> tuple[Array, Array, Array]:
    """Rotation vector e from a vector to a unit axis, angle n with n perpendicular to both, and its derivatives by the
    rotation of the axis and by the vector. For opposite directions n is any perpendicular direction.
    """
    length = np.linalg.norm(way, axis=-1, keepdims=True)
    # A vector of length zero has no direction: the axis points to it.
    target = np.where(length > 0.0, way / np.where(length > 0.0, length, 1.0), axis)
    across = np.cross(target, axis)
    sine, cosine = np.linalg.norm(across, axis=-1, keepdims=True), (target * axis).sum(-1, keepdims=True)
    least = np.eye(3)[np.abs(axis).argmin(-1)]
    sideways = np.cross(axis, least)
    n = np.where(sine > 0.0, across / np.where(sine > 0.0, sine, 1.0), sideways / np.linalg.norm(sideways, axis=-1, keepdims=True))
    angle = np.arctan2(sine, cosine)
    steep = np.where(angle < STEEPEST * sine, angle / np.where(sine > 0.0, sine, 1.0), np.where(cosine > 0.0, 1.0, STEEPEST))[..., None]
    by_rotation = _outer(n, n) + steep * _outer(np.cross(target, n), np.cross(axis, n))
    by_target = steep * _outer(np.cross(n, axis), n) - _outer(n, np.cross(n, target))
    onto = (np.eye(3) - _outer(target, target)) / np.where(length > 0.0, length, 1.0)[..., None]
    return n * angle, by_rotation, by_target @ onto


def _outer(a: Array, b: Array) -> Array:
    return np.asarray(a[..., :, None] * b[..., None, :])


#: The functions of phipsi.jax and phipsi.torch.
SUPPORTED = (
    "bias_torque", "center_of_mass", "forward_dynamics", "integrate", "inverse_dynamics", "jacobian", "mass_matrix", "placement", "simulate",
    "task_residual",
)  # fmt: skip


def missing(module: str, name: str) -> AttributeError:
    """The error for a function that a module does not have."""
    return AttributeError(f"{module}: found no {name!r}; expected one of {', '.join(SUPPORTED)}", name=name)


class Rollout:
    """Trajectories with given torques in every step, as functions of real arrays: the rows, and the gradients of a
    scalar function of them.

    Two instances are equal if their scene is the same object and their options are equal, so that JAX compiles
    their callbacks once.
    """

    names = ("q", "qd", "tau")

    def __init__(self, scene: Scene, record_every: int, errors: Errors = "raise", **options: Any) -> None:
        self.scene, self.record_every, self.errors, self.options = scene, record_every, errors, options
        self.coordinates = Coordinates(scene)
        # Without states and steps the scene checks its options now, and not in the callback of a compiled graph.
        q, qd, tau = np.zeros((0, scene.nq)), np.zeros((0, scene.nv)), np.zeros((0, 0, scene.nv))
        self._rows(q, qd, tau)
        scene.integrate(q, qd, errors=errors)
        try:
            self._key: Any = (scene, record_every, errors, pickle.dumps(sorted(options.items())))
        except Exception:  # options that cannot be pickled are compared by identity
            self._key = (id(self),)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rollout) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def value(self, q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
        """Rows for (q, qd, tau): (..., rows, nq) and (..., rows, nv)."""
        if self.errors == "raise":
            return self._rows(q, qd, tau)
        batch = np.broadcast_shapes(q.shape[:-1], qd.shape[:-1], tau.shape[:-2])
        q, qd = (np.broadcast_to(array, (*batch, array.shape[-1])).reshape(-1, array.shape[-1]) for array in (q, qd))
        tau = np.broadcast_to(tau, (*batch, *tau.shape[-2:])).reshape(-1, *tau.shape[-2:])
        reasons: dict[int, PhipsiError] = {}
        rows = self.rows(tau.shape[-2])
        found = (np.full((len(q), rows, self.scene.nq), np.nan), np.full((len(q), rows, self.scene.nv), np.nan))
        good = np.isfinite(q).all(-1) & np.isfinite(qd).all(-1) & np.isfinite(tau).all((-1, -2))
        for turn, _ in self.coordinates.turns:
            good &= q[:, turn].any(-1)
        left = np.flatnonzero(good)
        for state in np.setdiff1d(np.arange(len(q)), left):
            try:
                self._rows(q[state], qd[state], tau[state])
            except PhipsiError as reason:
                reasons[int(state)] = reason
        while len(left):
            try:
                found[0][left], found[1][left] = self._rows(q[left], qd[left], tau[left])
                break
            except PhipsiError as reason:
                at = getattr(reason, "state", None)
                if not isinstance(at, int):
                    raise
                reasons[int(left[at])] = self._alone(q[left[at]], qd[left[at]], tau[left[at]], reason)
                left = np.delete(left, at)
        if reasons:
            self._warn(reasons, batch)
        return found[0].reshape(*batch, *found[0].shape[1:]), found[1].reshape(*batch, *found[1].shape[1:])

    def gradients(self, q: Array, tau: Array, rows: Array, rates: Array, by_rows: Array, by_rates: Array) -> tuple[Array, Array, Array]:
        """Gradients with respect to q, qd and tau, given those with respect to the rows; NaN where the rows are NaN."""
        if self.errors == "raise":
            return self._gradients(q, tau, rows, rates, by_rows, by_rates)
        batch = np.broadcast_shapes(q.shape[:-1], *(array.shape[:-2] for array in (tau, rows, rates, by_rows, by_rates)))
        given = [np.broadcast_to(q, (*batch, q.shape[-1]))]
        given += [np.broadcast_to(array, (*batch, *array.shape[-2:])) for array in (tau, rows, rates, by_rows, by_rates)]
        bad = np.isnan(given[2]).any((-1, -2))
        found = tuple(np.full(shape, np.nan) for shape in (given[0].shape, (*batch, self.scene.nv), given[1].shape))
        for whole, part in zip(found, self._gradients(*(array[~bad] for array in given)), strict=True):
            whole[~bad] = part
        return found  # type: ignore[return-value]

    def _rows(self, q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
        path = self.scene.simulate(self.coordinates.normalized(q), qd, tau_steps=tau, **self._steps(tau))
        return path.q, path.qd

    def _gradients(self, q: Array, tau: Array, rows: Array, rates: Array, by_rows: Array, by_rates: Array) -> tuple[Array, Array, Array]:
        rows = self.coordinates.normalized(rows)
        by_tangents = np.einsum("...i,...ij->...j", by_rows, self.coordinates.changes(rows))
        found = self.scene.simulate_vjp(rows, rates, by_tangents, by_rates, tau_steps=tau, **self._steps(tau))
        return self.coordinates.by_entries(q, found.q[..., None, :])[..., 0, :], found.qd, found.tau

    def _alone(self, q: Array, qd: Array, tau: Array, reason: PhipsiError) -> PhipsiError:
        """Error of a single state, whose message contains no index within the remaining states."""
        try:
            self._rows(q, qd, tau)
        except PhipsiError as alone:
            return alone
        return reason

    @staticmethod
    def _warn(reasons: dict[int, PhipsiError], batch: tuple[int, ...]) -> None:
        """One warning for all bad states of a batch."""
        states = sorted(reasons)
        where = [tuple(int(at) for at in np.unravel_index(state, batch)) if batch else () for state in states]
        several = "is" if len(states) == 1 else "are"
        first = f"{reasons[states[0]]} (index {where[0]} of the batch {batch})" if batch else str(reasons[states[0]])
        text = f"{len(states)} of {int(np.prod(batch))} states could not be computed and {several} NaN: {first} (the warning's .states and .reasons have all)"
        warning = BadStateWarning(text)
        warning.states = tuple(at[0] if len(at) == 1 else at for at in where)
        warning.reasons = tuple(reasons[state] for state in states)
        warn(warning)

    def _steps(self, tau: Array) -> dict[str, Any]:
        return {**self.options, "steps": tau.shape[-2], "record_every": self.record_every}

    def rows(self, steps: int) -> int:
        """Number of recorded rows for this number of steps."""
        return steps // self.record_every + 1


def on_host(function: Host, arrays: tuple[ArrayLike, ...]) -> Any:
    """Call a function with float64 arrays."""
    return function(*(np.asarray(array, dtype=np.float64) for array in arrays))


def batch_of(names: Sequence[str], shapes: Sequence[tuple[int, ...]], own: Sequence[tuple[int | None, ...]]) -> tuple[int, ...]:
    """Leading axes that the arguments broadcast to; raises ShapeError like the methods of the scene. own: trailing axes
    of each argument, None for any length.
    """
    batch: tuple[int, ...] = ()
    for name, shape, trailing in zip(names, shapes, own, strict=True):
        fits = len(shape) >= len(trailing) and all(want in (None, has) for has, want in zip(shape[len(shape) - len(trailing) :], trailing, strict=True))
        if not fits:
            expected = ", ".join("steps" if width is None else str(width) for width in trailing)
            raise of_argument(ShapeError, name, f"found shape {tuple(shape)}; expected (..., {expected})")
        leading = tuple(shape[: len(shape) - len(trailing)])
        try:
            batch = np.broadcast_shapes(batch, leading)
        except ValueError:
            raise of_argument(ShapeError, name, f"found leading axes {leading}; expected ones that broadcast with {batch} of {names[0]}") from None
    return batch


def refuse_dtype(name: str, dtype: Any) -> None:
    """Raise the ArgumentError that the methods of the scene raise for values that are not real."""
    raise not_numbers(name, f"dtype {str(dtype).removeprefix('torch.')}")
