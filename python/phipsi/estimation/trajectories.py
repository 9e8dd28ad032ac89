"""Trajectories with error bands: first-order propagation of covariances through a simulation, with a check by
sampling."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from .._arguments import numbers
from .._friction import check_coulomb
from .._motion_parts import has_steps, of_rows, with_steps
from .._summary import summarized
from .._trajectory_files import OF_CONTACTS
from ..errors import ArgumentError, InertiaWarning, ShapeError, UncertaintyWarning, of_argument, warn
from ._allowed import Tangent, tangent_of_connections
from ._manifold import lower_root
from ._modes import PER_CONTACT, ModeMargins, contact_velocities, free_arguments
from .uncertainty import JOINT_PARAMETERS, ParameterCovariance, _joint_covariance, _per_joint, covariance_root

if TYPE_CHECKING:
    from .._core import Scene
    from .._motion import Trajectory

__all__ = ["Bands", "MotionUncertainty", "with_bands"]

_Array = NDArray[np.float64]
_Index = NDArray[np.int_]

#: Relative standard deviation below which a value is rounding error.
ROUNDING = 1e-12
#: Speed of regularized friction for variances of friction in a simulation without friction, rad/s or m/s.
FRICTION_SPEED: Final = 0.01
#: Arguments of Scene.simulate in which states can differ, for all states or (..., n), beside the inertias.
OF_STATES = ("armature", "damping", "stiffness", "friction", *OF_CONTACTS)
#: Largest number of values of the derivatives of rows that are computed in one call.
VALUES = 4_000_000


@dataclass(frozen=True, kw_only=True)
class MotionUncertainty:
    """Uncertainty of a simulation, for Scene.simulate(covariance=...).

    Attributes
    ----------
    parameters : optional
        Covariance of the inertial parameters, as in Scene.forward_dynamics_variance. The errors are constant along
        a trajectory.
    joints : optional
        Variances of "armature", "damping", "friction" and "offset" of the joints, as in
        Scene.forward_dynamics_variance. The errors are constant along a trajectory.
    initial : (2 nv, 2 nv) or (2 nv,), optional
        Initial covariance, or variances: of q in its tangent space, then of qd. With connections, errors that leave
        them are projected onto them as by Scene.loops.project, with least kinetic energy.
    torque_noise : (nv,) or float, optional
        Density of white torque noise, (N m)^2 s.
    check : str, optional
        "unscented" or "monte-carlo": check of the first-order result by sampled simulations. "unscented" runs two
        simulations per standard deviation of parameters and initial state; it does not support torque noise.
    samples : int
        Number of simulations of "monte-carlo".
    seed : int
        Seed of "monte-carlo".

    Examples
    --------
    >>> import numpy as np, phipsi
    >>> from phipsi.estimation import MotionUncertainty
    >>> scene = phipsi.scenes.chain(2)
    >>> unsure = MotionUncertainty(initial=[1e-6, 1e-6, 0.0, 0.0], check="unscented")
    >>> path = scene.simulate(
    ...     [0.3, 0.2],
    ...     [0.0, 0.0],
    ...     dt=1e-3,
    ...     steps=100,
    ...     covariance=unsure,
    ... )
    >>> path.bands.q.shape, bool(abs(path.bands.ratio[-1, :2] - 1.0).max() < 0.01)
    ((101, 2), True)
    """

    parameters: Any = None
    joints: Any = None
    initial: ArrayLike | None = None
    torque_noise: ArrayLike = 0.0
    check: str | None = None
    samples: int = 200
    seed: int = 0


@summarized
class Bands(NamedTuple):
    """Error bands of a trajectory, for each row."""

    q: _Array
    """Standard deviations of q in its tangent space, (..., rows, nv)."""
    qd: _Array
    """Standard deviations of qd, (..., rows, nv)."""
    covariance: _Array
    """Covariance of (q in its tangent space, qd), (..., rows, 2 nv, 2 nv)."""
    ratio: _Array | None
    """Ratio of sampled variance to first-order variance, (..., rows, 2 nv); None without a check.

    If it differs much from 1, the first-order bands are inaccurate. Infinite if only the first-order variance is zero,
    NaN if both are, within rounding.
    """


def with_bands(path: Trajectory, uncertainty: Any) -> Trajectory:
    """Trajectory with `bands`, from a MotionUncertainty or a covariance of parameters."""
    if not isinstance(uncertainty, MotionUncertainty):
        uncertainty = MotionUncertainty(parameters=uncertainty)
    _check_linear(path)
    return replace(path, bands=_Propagation(path, uncertainty).bands())


def _check_linear(path: Trajectory) -> None:
    """Raise ArgumentError for simulations that cannot be linearized."""
    given = path.given or {}
    if callable(given.get("tau")) or path.applied is not None:
        raise of_argument(
            ArgumentError,
            "tau",
            "found a function with covariance; expected an array, tau_steps or pd: the derivative of a function by the"
            " state is not known",
        )
    if given.get("accuracy") is not None:
        raise of_argument(
            ArgumentError,
            "accuracy",
            f"found {given['accuracy']:g} with covariance; expected None: the bands are those of fixed steps",
        )
    if path.stops:
        raise of_argument(
            ArgumentError,
            "limits",
            "found joints that reached their stops with covariance; expected a motion within limits, or"
            ' limits="report": the derivative of the time of an impact is not known',
        )


class _Rows(NamedTuple):
    """Derivatives of linear functions of the state at rows by the row before and what acts in between."""

    state: _Array
    """By the state (q in its tangent space, qd), (..., rows, functions, 2 nv)."""
    torque: _Array
    """By the torques of the steps, (..., rows, functions, steps, nv)."""
    constant: _Array
    """By one standard deviation of each constant parameter, (..., rows, functions, columns)."""
    margins: _Array
    """Margins of the contacts, (..., rows, contacts), m/s."""

    def of(self, basis: _Array | None) -> _Rows:
        """Derivatives of the state from those of its coordinates in a basis, (..., rows, 2 nv, functions)."""
        if basis is None:
            return self
        by_torque = np.einsum("...if,...fsj->...isj", basis, self.torque)
        return self._replace(state=basis @ self.state, torque=by_torque, constant=basis @ self.constant)


class _Propagation:
    """Propagation of the columns of a covariance root."""

    def __init__(self, path: Trajectory, uncertainty: MotionUncertainty) -> None:
        self.path, self.scene, self.given, self.unsure = path, path.scene, path.given or {}, uncertainty
        nv = self.scene.nv
        check_coulomb(self.scene, "uncertainty")
        self.parameters = ParameterCovariance(self.scene, uncertainty.parameters)
        self.noise = _per_joint(self.scene, "torque_noise", uncertainty.torque_noise)
        initial = np.zeros(2 * nv) if uncertainty.initial is None else numbers("initial", uncertainty.initial)
        if initial.shape == (2 * nv,):
            initial = np.diag(initial)
        if initial.shape != (2 * nv, 2 * nv):
            expected = f"{(2 * nv, 2 * nv)}, or {(2 * nv,)} for variances"
            raise of_argument(ShapeError, "initial", f"found shape {initial.shape}; expected {expected}")
        self.initial = covariance_root("initial", initial)
        joints = _joint_covariance(self.scene, uncertainty.joints, self.parameters)
        #: Columns of the four parameters of each degree of freedom that belong to those of the bodies.
        self.of_joints = self.parameters._joints(nv)
        #: Degree of freedom of each column, and the column of its four parameters.
        self.joints: list[tuple[int, _Array]] = []
        for row in range(nv if joints is not None else 0):
            assert joints is not None
            self.joints += [(row, column) for column in covariance_root(f"joints[{row}]", joints[row]).T]
        self.damping, self.friction = (self._own(name) for name in ("damping", "friction"))
        # Without friction the speed does not act, except in the derivative by friction.
        exact = None if np.any(self.friction > 0.0) else FRICTION_SPEED
        self.speed = self.given.get("friction_speed") or exact
        #: The solution of the contact law depends on the step before, so that every step is a row there.
        self.every = path.record_every if self.scene.contacts.names else 1
        self.whole = self._every_step() if self.every > 1 else path
        #: True if margins of contacts are compared with errors; samples and smoothed contacts have no modes.
        self.has_modes = bool(
            self.scene.contacts.names and uncertainty.check is None and not self.given.get("smoothing")
        )
        #: True if states satisfy the connections; their errors are then tangent to them.
        self.rigid = bool(self.scene.loops.names) and self._is_rigid()
        if self.rigid:
            self.initial = self._tangent(np.array([0])).projection[..., 0, :, :] @ self.initial

    def _is_rigid(self) -> bool:
        """Return whether no connection has compliance; raises ArgumentError for initial errors if only some have."""
        compliance = np.asarray(0.0 if self.given.get("compliance") is None else self.given["compliance"], float)
        if self.initial.size and np.any(compliance > 0.0) and np.any(compliance == 0.0):
            raise of_argument(
                ArgumentError,
                "initial",
                "found an initial covariance with rigid connections and connections with compliance; expected"
                " compliance of all rows or of none",
            )
        return not np.any(compliance > 0.0)

    def _tangent(self, rows: _Index) -> Tangent:
        """Tangent space of the connections at rows."""
        path = self.whole
        return tangent_of_connections(self.scene, path.q[..., rows, :], path.qd[..., rows, :], **path._own_inertias)

    def _every_step(self) -> Trajectory:
        """The same simulation with a row for each step."""
        path, given = self.path, {name: value for name, value in self.path._arguments().items() if value is not None}
        with warnings.catch_warnings():
            # The simulation has issued them.
            warnings.simplefilter("ignore")
            return self.scene.simulate(path.q[..., 0, :], path.qd[..., 0, :], **(given | {"record_every": 1}))

    def _own(self, name: str) -> _Array:
        value = self.given.get(name)
        own = getattr(self.scene, name) if value is None else _core._numbers(name, value, self.scene, False)
        return np.broadcast_to(own, np.broadcast_shapes(own.shape, (self.scene.nv,)))

    def _torques(self) -> _Array:
        """Given torques of all steps, (..., steps, nv)."""
        tau = self.given.get("tau_steps")
        if tau is None:
            tau = np.asarray(self.given.get("tau", np.zeros(self.scene.nv)), float)[..., None, :]
        return np.broadcast_to(tau, np.broadcast_shapes(np.shape(tau), (self.path.steps, self.scene.nv)))

    def bands(self) -> Bands:
        path, nv = self.path, self.scene.nv
        batch, rows = path.q.shape[:-2], path.q.shape[-2]
        noisy = bool(np.any(self.noise > 0.0))
        deviation_of_noise = np.sqrt(self.noise / path.dt)
        constant = np.zeros((*batch, 2 * nv, 1))
        root = np.broadcast_to(self.initial, (*batch, *self.initial.shape[-2:]))
        covariance = np.zeros((*batch, rows, 2 * nv, 2 * nv))
        covariance[..., 0, :, :] = root @ np.swapaxes(root, -1, -2)
        at, held, modes = 0, np.zeros(nv, bool), ModeMargins(self.whole)

        def through(found: _Rows, row: int) -> tuple[_Array, _Array]:
            """Constant columns, and the others, of the functions at a row."""
            flow = found.state[..., row, :, :]
            # Parameter errors are the same in all steps: keep their columns separate.
            columns = [flow @ constant + found.constant[..., row, :, :], flow @ root]
            if noisy:
                pushed = found.torque[..., row, :, :, :] * deviation_of_noise
                columns[1] = np.concatenate([columns[1], pushed.reshape(*pushed.shape[:-2], math.prod(pushed.shape[-2:]))], axis=-1)
            return columns[0], columns[1]

        for found, free in self._rows():
            # Errors of the state before a row do not change the velocity of a joint that friction holds.
            held |= np.any(np.all(found.state[..., nv:, :] == 0.0, axis=-1), axis=tuple(range(len(batch) + 1)))
            for row in range(found.state.shape[-3]):
                without = None if free is None else np.concatenate(through(free, row), axis=-1)
                constant, root = through(found, row)
                if noisy:
                    root = lower_root(root)
                at += 1
                both = np.concatenate([constant, root], axis=-1)
                if at % self.every == 0:
                    covariance[..., at // self.every, :, :] = both @ np.swapaxes(both, -1, -2)
                if self.has_modes:
                    modes.note(at, found.margins[..., row, :], both, without)
        modes.warn()
        if self.unsure.check is None:
            self._warn_of_shapes()
            if np.any(held & (self.friction > 0.0)):
                joint = next(name for name in self.scene.joint_names if np.any(held[self.scene.v_index(name)]))
                warn(
                    f"covariance: found joint {joint!r} held by friction in some steps, so that errors of these steps"
                    ' are zero to first order; compare with check="monte-carlo", or use friction_speed=0.01',
                    UncertaintyWarning,
                )
        deviation = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
        ratio = None if self.unsure.check is None else self._ratio(deviation**2)
        return Bands(deviation[..., :nv], deviation[..., nv:], covariance, ratio)

    def _warn_of_shapes(self) -> None:
        """Warn of shapes that touch: their modes are not compared with errors."""
        contacts = self.path.contacts
        if contacts is None or not contacts.shapes.names:
            return
        pairs = contacts.shapes.pairs()
        if pairs or (not self.scene.contacts.names and np.any(contacts.iterations > 0)):
            found = f"shapes that touch ({pairs[0][0]!r} and {pairs[0][1]!r})" if pairs else "shapes that touch between the rows"
            warn(
                f"covariance: found {found}; the bands are those of fixed modes (open, sticking, sliding), and errors"
                ' that change a mode of shapes are not found; compare with check="monte-carlo"',
                UncertaintyWarning,
            )

    def _rows(self) -> Iterator[tuple[_Rows, _Rows | None]]:
        """Derivatives of rows after the first, and of the velocities of contacts in steps that they do not affect."""
        path, scene, every = self.whole, self.scene, self.whole.record_every
        batch, rows = path.q.shape[:-2], (self.path.q.shape[-2] - 1) * self.every
        most = max(2 * scene.nv, PER_CONTACT * len(scene.contacts.names))
        has_bodies = len(self.parameters.columns) > 0 or path.inertias is not None
        bodies = len(scene.body_names) if has_bodies else 0
        values = math.prod(batch) * most * ((5 + every) * scene.nv + 10 * bodies)
        size = max(1, VALUES // max(1, values))
        given = {name: value for name, value in path._arguments().items() if name not in ("tau", "tau_steps")}
        for first in range(0, rows, size):
            # method="auto" selects an integrator at the first state: put the first row before all others.
            at = np.concatenate([[0], np.arange(first, min(first + size, rows))])
            ends = self._tangent(at + 1) if self.rigid else None
            functions = np.eye(2 * scene.nv) if ends is None else ends.coordinates
            found = self._derivatives(scene, functions, at, given | {"friction_speed": self.speed})
            free = None
            if self.has_modes and np.any(ModeMargins(path).closed(at[1:] + 1)):
                functions = contact_velocities(scene, path.q[..., at, :], path.dt, self.given.get("contact_friction"))
                own = free_arguments(given) | {"friction_speed": self.speed or FRICTION_SPEED}
                free = self._derivatives(scene.without_contacts(), functions, at, own)
            yield found.of(None if ends is None else ends.basis[..., 1:, :, :]), free

    def _derivatives(self, scene: Scene, functions: _Array, at: _Index, given: dict[str, Any]) -> _Rows:
        """Derivatives of linear functions of the state, (..., rows, functions, 2 nv), by the adjoint of the steps from
        rows `at` to the next ones; those of the first are omitted.
        """
        path, nv, every, columns = self.whole, scene.nv, self.whole.record_every, self.parameters.columns
        batch, rows = path.q.shape[:-2], (len(path) - 1) * every
        given = given | {"steps": every, "record_every": every, "parameters": len(columns) > 0} | path._own_inertias
        # The properties are those of a state, not of a row.
        read = {"damping": self.damping, "friction": self.friction}
        differ = [name for name in OF_STATES if given.get(name) is not None]
        given |= {name: of_rows(np.asarray(read.get(name, given[name]))) for name in differ}
        if given.get("pd") is not None:
            # So are the targets.
            given["pd"] = tuple(part if np.ndim(part) < 2 else np.asarray(part)[..., None, :] for part in given["pd"])
        if given.get("wrenches") is not None:
            # Likewise the wrenches that are the same in all steps.
            given["wrenches"] = {
                link: np.asarray(wrench)[..., None, :, :] if np.ndim(wrench) > 1 and not has_steps(wrench) else wrench
                for link, wrench in given["wrenches"].items()
            }

        def divided(values: _Array) -> _Array:
            return values[..., :rows, :].reshape(*values.shape[:-2], rows // every, every, values.shape[-1])

        def of_steps(values: _Array) -> _Array:
            return np.asarray(divided(values)[..., at, :, :])

        given = with_steps(given, of_steps)
        tau = divided(self._torques())
        # The derivative of function i is state i of the leading axis.
        functions = np.broadcast_to(functions, (*(1,) * (len(batch) + 3 - functions.ndim), *functions.shape))
        units = np.moveaxis(functions, -2, 0)
        wanted = np.stack([np.zeros_like(units), units], axis=-2)
        try:
            found = scene.simulate_vjp(
                *(np.stack([state[..., at, :], state[..., at + 1, :]], axis=-2) for state in (path.q, path.qd)),
                *np.split(wanted, 2, axis=-1),
                tau_steps=tau[..., at, :, :],
                **given,
            )
        except ArgumentError as error:
            if not ((scene.contacts.names or scene.collider_names) and error.argument in ("q", "qd")):
                raise
            raise of_argument(
                ArgumentError,
                "covariance",
                "found a step with contacts that its initial state does not determine, because their law has several"
                " solutions there; expected less friction, or smoothing",
            ) from error
        by_state = np.moveaxis(np.concatenate([found.q, found.qd], axis=-1), 0, -2)[..., 1:, :, :]
        by_tau = np.moveaxis(found.tau, 0, -3)[..., 1:, :, :, :]
        constant = np.zeros((*by_state.shape[:-1], 1))
        offset = -np.sum(found.tau, axis=-2)
        each = np.stack([found.armature, found.damping, found.friction, offset], axis=-1)
        if found.parameters is not None:
            by_columns = np.einsum("...bp,sbp->...s", found.parameters, columns)
            if self.of_joints.any():
                by_columns = by_columns + np.einsum("...ja,sja->...s", each, self.of_joints)
            constant = np.moveaxis(by_columns, 0, -2)[..., 1:, :, :]
        if self.joints:
            own = np.stack([each[..., row, :] @ column for row, column in self.joints], axis=-1)
            constant = np.concatenate([constant, np.moveaxis(own, 0, -2)[..., 1:, :, :]], axis=-1)
        margins = np.zeros((*batch, len(at) - 1, len(found.contacts)))
        for i, contact in enumerate(found.contacts.values()):
            margins[..., i] = contact.margin[0][..., 1:]
        return _Rows(by_state, by_tau, constant, margins)

    # Sampled simulations

    def _ratio(self, variance: _Array) -> _Array:
        """Ratio of the variance of sampled simulations to the first-order variance."""
        unsure, parts = self.unsure, [len(self.parameters.columns), len(self.joints), self.initial.shape[-1]]
        size = sum(parts)
        noisy = bool(np.any(self.noise > 0.0))
        if unsure.check == "unscented":
            if noisy:
                raise of_argument(ArgumentError, "check", 'found "unscented" with torque noise; expected "monte-carlo"')
            points = math.sqrt(size) * np.concatenate([np.eye(size), -np.eye(size)])
        elif unsure.check == "monte-carlo":
            if not (unsure.samples == int(unsure.samples) and unsure.samples >= 2):
                raise of_argument(
                    ArgumentError, "samples", f"found {unsure.samples}; expected a whole number, at least 2"
                )
            points = np.random.default_rng(unsure.seed).normal(size=(int(unsure.samples), size))
        else:
            raise of_argument(
                ArgumentError, "check", f'found {unsure.check!r}; expected "unscented", "monte-carlo" or None'
            )
        rng = np.random.default_rng([unsure.seed, 1])
        away = []
        for point in points:
            of_bodies, of_joints, of_start = np.split(point, np.cumsum(parts)[:2])
            path = self._run(of_bodies, of_joints, self.initial @ of_start, rng if noisy else None)
            away.append(np.concatenate([self.scene.difference(self.path.q, path.q), path.qd - self.path.qd], axis=-1))
        if not away:
            return np.full(variance.shape, np.nan)
        spread = np.asarray(away)
        # The variance about the mean of the simulations: the shift of the mean is a bias.
        found = np.var(spread, axis=0, ddof=1 if unsure.check == "monte-carlo" else 0)
        # A variance below this share of the largest variance of its kind, or of some units in the last place of the
        # states, is rounding error.
        halves = variance.reshape(*variance.shape[:-1], 2, self.scene.nv)
        largest = np.max(halves, axis=(-1, -3), keepdims=True, initial=0.0) * ROUNDING**2
        sizes = np.array([max(1.0, float(np.max(np.abs(x), initial=0.0))) for x in (self.path.q, self.path.qd)])
        least = np.maximum(largest, (16 * np.finfo(float).eps * sizes[:, None]) ** 2)
        least = np.broadcast_to(least, halves.shape).reshape(variance.shape)
        known, unknown = variance > least, np.where(found > least, np.inf, np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(known, found / variance, unknown)

    def _run(self, of_bodies: _Array, of_joints: _Array, start: _Array, rng: np.random.Generator | None) -> Trajectory:
        """Simulate with given errors, in standard deviations."""
        path, nv, given = (
            self.path,
            self.scene.nv,
            {name: value for name, value in self.given.items() if value is not None},
        )
        scene, change = self.scene, np.einsum("s,sbp->bp", of_bodies, self.parameters.columns)
        if path.inertias is not None:
            given["inertias"] = path.inertias + change
        elif len(of_bodies):
            with warnings.catch_warnings():
                # Sampled parameters need not be physically consistent; only their mean is.
                warnings.simplefilter("ignore", InertiaWarning)
                scene = scene.with_inertial_parameters(scene.inertial_parameters + change)
        changed = np.einsum("s,sja->ja", of_bodies, self.of_joints)
        for (row, column), amount in zip(self.joints, of_joints, strict=True):
            changed[row] += amount * column
        armature, damping, friction = (
            np.asarray(own) + changed[:, at] for at, own in enumerate((path.armature, self.damping, self.friction))
        )
        for name, value in zip(JOINT_PARAMETERS, (armature, damping, friction), strict=False):
            if np.any(value < 0.0):
                raise of_argument(
                    ArgumentError,
                    "joints",
                    f"found a deviation of {name} that makes it negative in a simulation of the check; expected smaller"
                    " ones, or check=None",
                )
        q, qd = path.q[..., 0, :], path.qd[..., 0, :]
        for name in ("tau", "tau_steps", "accuracy"):
            given.pop(name, None)
        tau = self._torques()[..., : path.steps, :] - changed[:, 3]
        tau = np.broadcast_to(tau, np.broadcast_shapes(tau.shape, (*q.shape[:-1], path.steps, nv)))
        if rng is not None:
            tau = tau + np.sqrt(self.noise / path.dt) * rng.normal(size=tau.shape)
        given |= {
            "method": path.method,
            "armature": armature,
            "damping": damping,
            "friction": friction,
            "stiffness": path.stiffness,
            "rest": path.rest,
        }
        if np.any(friction > 0.0):
            given["friction_speed"] = self.speed
        q, qd = self.scene.integrate(q, start[..., :nv]), qd + start[..., nv:]
        if self.rigid:
            closed = self.scene.loops.project(q[..., None, :], qd[..., None, :], **path._own_inertias)
            assert closed.qd is not None
            q, qd = closed.q[..., 0, :], closed.qd[..., 0, :]
        return scene.simulate(
            q,
            qd,
            dt=path.dt,
            steps=path.steps,
            record_every=path.record_every,
            tau_steps=tau,
            **given,
        )
