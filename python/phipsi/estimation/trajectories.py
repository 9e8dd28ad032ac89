"""Trajectories with error bands: first-order propagation of covariances through a simulation, with a check by
sampling."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ArgumentError, InertiaWarning, ShapeError, of_argument
from ._manifold import exponential, joint_groups, lower_root
from .uncertainty import JOINT_PARAMETERS, ParameterCovariance, _joint_covariance, _per_joint, covariance_root

if TYPE_CHECKING:
    from .._core import Scene
    from .._motion import Trajectory

__all__ = ["Bands", "MotionUncertainty", "with_bands"]

_Array = NDArray[np.float64]

#: Integration method whose steps are linearized.
METHOD: Final = "semi-implicit-euler"
#: Relative standard deviation below which a value is rounding error.
ROUNDING = 1e-12


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
    initial : (2 nv, 2 nv), optional
        Initial covariance: of q in its tangent space, then of qd.
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
    >>> unsure = MotionUncertainty(initial=np.diag([1e-6, 1e-6, 0.0, 0.0]), check="unscented")
    >>> path = scene.simulate(
    ...     [0.3, 0.2],
    ...     [0.0, 0.0],
    ...     dt=1e-3,
    ...     steps=100,
    ...     method="semi-implicit-euler",
    ...     limits="report",
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

    If it differs much from 1, the first-order bands are inaccurate. NaN for variances that are zero within rounding.
    """


def with_bands(path: Trajectory, uncertainty: Any) -> Trajectory:
    """Trajectory with `bands`, from a MotionUncertainty or a covariance of parameters."""
    if not isinstance(uncertainty, MotionUncertainty):
        uncertainty = MotionUncertainty(parameters=uncertainty)
    _check_linear(path)
    return replace(path, bands=_Propagation(path, uncertainty).bands())


def _check_linear(path: Trajectory) -> None:
    """Raise ArgumentError for simulations that cannot be linearized."""
    given, scene = path.given or {}, path.scene
    if path.method != METHOD:
        raise of_argument(
            ArgumentError,
            "method",
            f"found {path.method!r}; expected {METHOD!r} with covariance: the bands are those of its steps",
        )
    if path.record_every != 1:
        raise of_argument(
            ArgumentError,
            "record_every",
            f"found {path.record_every}; expected 1 with covariance: each step is linearized at its own state",
        )
    if path.applied is not None:
        raise of_argument(
            ArgumentError,
            "tau",
            "found a function with covariance; expected an array, tau_steps or pd: the derivative of a function by the"
            " state is not known",
        )
    if scene.connection_names or scene.contact_names:
        raise of_argument(
            ArgumentError, "covariance", "found a scene with connections or contacts; expected a tree without contacts"
        )
    if given.get("conserve_momentum"):
        raise of_argument(ArgumentError, "conserve_momentum", "found True with covariance; expected False")
    friction = np.asarray(scene.friction if given.get("friction") is None else given["friction"])
    if np.any(friction > 0.0) and not path.friction_speed > 0.0:
        raise of_argument(
            ArgumentError,
            "friction_speed",
            "found exact Coulomb friction with covariance; expected a positive speed: stiction has no derivative",
        )
    if path.stops or (path.limits == "stop" and np.any(path.events > 0)):
        raise of_argument(
            ArgumentError,
            "limits",
            "found joints that reached their stops with covariance; expected a motion within limits, or"
            ' limits="report"',
        )


class _Propagation:
    """Propagation of the columns of a covariance root."""

    def __init__(self, path: Trajectory, uncertainty: MotionUncertainty) -> None:
        self.path, self.scene, self.given, self.unsure = path, path.scene, path.given or {}, uncertainty
        nv = self.scene.nv
        self.parameters = ParameterCovariance(self.scene, uncertainty.parameters)
        self.noise = _per_joint(self.scene, "torque_noise", uncertainty.torque_noise)
        initial = np.zeros((2 * nv, 2 * nv)) if uncertainty.initial is None else np.asarray(uncertainty.initial, float)
        if initial.shape != (2 * nv, 2 * nv):
            raise of_argument(ShapeError, "initial", f"found shape {initial.shape}; expected {(2 * nv, 2 * nv)}")
        self.initial = covariance_root("initial", initial)
        joints = _joint_covariance(self.scene, uncertainty.joints)
        #: Degree of freedom of each column, and the column of its four parameters.
        self.joints: list[tuple[int, _Array]] = []
        for row in range(nv if joints is not None else 0):
            assert joints is not None
            self.joints += [(row, column) for column in covariance_root(f"joints[{row}]", joints[row]).T]
        speed = path.friction_speed or 0.01
        self.damping, self.friction = (self._own(name) for name in ("damping", "friction"))
        kp = kd = np.zeros(nv)
        if self.given.get("pd") is not None:
            kp, kd = (np.broadcast_to(np.asarray(gain, float), (nv,)) for gain in self.given["pd"][:2])
        self.stiffness, self.speed = path.stiffness + kp, speed
        self.kd = kd
        turning = joint_groups(self.scene)
        if np.any((self.stiffness != 0.0) & (turning[0] != turning[1])):
            raise of_argument(
                ArgumentError,
                "stiffness",
                "found springs or gains on a spherical or free joint with covariance; expected none there",
            )

    def _own(self, name: str) -> _Array:
        value = self.given.get(name)
        return np.broadcast_to(
            np.asarray(getattr(self.scene, name) if value is None else value, float), (self.scene.nv,)
        )

    def bands(self) -> Bands:
        path, scene, nv, h = self.path, self.scene, self.scene.nv, self.path.dt
        model = (
            scene if np.array_equal(path.armature, scene.armature) else scene.with_properties(armature=path.armature)
        )
        q, qd = path.q[..., :-1, :], path.qd[..., :-1, :]
        tau = path.torques()[..., :-1, :]
        batch, steps = q.shape[:-2], q.shape[-2]
        qdd = model.forward_dynamics(q, qd, tau)
        by_q, by_qd, inverse = model.forward_dynamics_derivatives(q, qd, tau)[:3]
        by_q = by_q - inverse * self.stiffness
        slope = self.speed**2 / (qd**2 + self.speed**2) ** 1.5
        by_qd = by_qd - inverse * (self.damping + self.kd + self.friction * slope)[..., None, :]
        columns = self._columns(model, (q, qd, tau), qdd, inverse)
        noise = inverse * np.sqrt(self.noise / h)
        noisy = bool(np.any(self.noise > 0.0))
        constant = np.zeros((*batch, 2 * nv, columns.shape[-1]))
        root = np.broadcast_to(self.initial, (*batch, *self.initial.shape))
        covariance = np.zeros((*batch, steps + 1, 2 * nv, 2 * nv))
        groups = joint_groups(scene)
        for k in range(steps + 1):
            both = np.concatenate([constant, root], axis=-1)
            covariance[..., k, :, :] = both @ np.swapaxes(both, -1, -2)
            if k == steps:
                break
            back, right = exponential(groups, h * path.qd[..., k + 1, :])
            flow = np.zeros((*batch, 2 * nv, 2 * nv))
            flow[..., nv:, :nv], flow[..., nv:, nv:] = h * by_q[..., k, :, :], np.eye(nv) + h * by_qd[..., k, :, :]
            flow[..., :nv, :] = h * (right @ flow[..., nv:, :])
            flow[..., :nv, :nv] += back
            # Parameter errors are the same in all steps: keep their columns separate.
            constant = flow @ constant + self._pushed(h * columns[..., k, :, :], right)
            root = flow @ root
            if noisy:
                root = lower_root(np.concatenate([root, self._pushed(h * noise[..., k, :, :], right)], axis=-1))
        deviation = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
        ratio = None if self.unsure.check is None else self._ratio(deviation**2)
        return Bands(deviation[..., :nv], deviation[..., nv:], covariance, ratio)

    def _pushed(self, change: _Array, right: _Array) -> _Array:
        """Change of (q, qd) caused by a change of qd in a step."""
        return np.concatenate([self.path.dt * (right @ change), change], axis=-2)

    def _columns(self, model: Scene, state: tuple[_Array, _Array, _Array], qdd: _Array, inverse: _Array) -> _Array:
        """Change of qdd by one standard deviation of each parameter, (..., steps, nv, columns)."""
        q, qd, tau = state
        nv, columns = self.scene.nv, self.parameters.columns
        found = np.zeros((*qdd.shape, 0))
        if len(columns):
            zero = np.zeros(nv)
            changes = columns.reshape(-1, *(1,) * (qdd.ndim - 1), *columns.shape[1:])
            found = np.moveaxis(model.forward_dynamics_jvp(q, qd, tau, zero, zero, zero, dparameters=changes), 0, -1)
        weights = np.stack([qdd, qd, qd / np.sqrt(qd**2 + self.speed**2), np.ones_like(qd)], axis=-1)
        own = [-inverse[..., :, row] * (weights[..., row, :] @ column)[..., None] for row, column in self.joints]
        return np.concatenate([found, np.stack(own, axis=-1)], axis=-1) if own else found

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
        # A variance below this share of the largest variance of its kind is rounding error.
        halves = variance.reshape(*variance.shape[:-1], 2, -1)
        least = np.repeat(np.max(halves, axis=(-1, -3), keepdims=True) * ROUNDING**2, halves.shape[-1], axis=-1)
        known = variance > np.broadcast_to(least, halves.shape).reshape(variance.shape)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(known, found / variance, np.nan)

    def _run(self, of_bodies: _Array, of_joints: _Array, start: _Array, rng: np.random.Generator | None) -> Trajectory:
        """Simulate with given errors, in standard deviations."""
        path, nv, given = (
            self.path,
            self.scene.nv,
            {name: value for name, value in self.given.items() if value is not None},
        )
        scene = (
            _with_parameters(self.scene, np.einsum("s,sbp->bp", of_bodies, self.parameters.columns))
            if len(of_bodies)
            else self.scene
        )
        changed = np.zeros((nv, 4))
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
        tau = given.pop("tau_steps", None)
        if tau is None:
            tau = np.asarray(given.pop("tau", np.zeros(nv)), float)[..., None, :]
        tau = np.asarray(tau, float)[..., : path.steps, :] + changed[:, 3] * -1.0
        tau = np.broadcast_to(tau, np.broadcast_shapes(tau.shape, (*q.shape[:-1], path.steps, nv)))
        if rng is not None:
            tau = tau + np.sqrt(self.noise / path.dt) * rng.normal(size=tau.shape)
        given |= {
            "armature": armature,
            "damping": damping,
            "friction": friction,
            "stiffness": path.stiffness,
            "rest": path.rest,
        }
        if np.any(friction > 0.0):
            given["friction_speed"] = self.speed
        return scene.simulate(
            self.scene.integrate(q, start[:nv]),
            qd + start[nv:],
            dt=path.dt,
            steps=path.steps,
            method=METHOD,
            tau_steps=tau,
            **given,
        )


def _with_parameters(scene: Scene, change: _Array) -> Scene:
    """Scene with changed inertial parameters of its bodies."""
    inertias = {}
    for name, d in zip(scene.body_names, change, strict=True):
        if not d.any():
            continue
        link = scene.link(name)
        mass = link.mass + d[0]
        if not mass > 0.0:
            raise of_argument(
                ArgumentError,
                "parameters",
                f"found a deviation that makes the mass of {name!r} {mass:.3g} kg in a simulation of the check;"
                " expected smaller ones, or check=None",
            )
        xx, xy, yy, xz, yz, zz = d[4:]
        shift = np.asarray(link.com)
        about = (
            np.asarray(link.inertia)
            + link.mass * (shift @ shift * np.eye(3) - np.outer(shift, shift))
            + np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        )
        com = (link.mass * shift + d[1:4]) / mass
        inertias[name] = mass, com, about - mass * (com @ com * np.eye(3) - np.outer(com, com))
    with warnings.catch_warnings():
        # Sampled parameters need not be physically consistent; only their mean is.
        warnings.simplefilter("ignore", InertiaWarning)
        return scene.with_inertias(inertias)
