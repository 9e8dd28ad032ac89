"""Propagation of covariances of parameters and torques through forward and inverse dynamics."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._arguments import check_finite, has_followers, numbers
from .._random import generator_of
from .._summary import summarized
from ..errors import ArgumentError, BadStateWarning, ShapeError, of_argument
from ._columns import OF_JOINTS, Columns, Extra, flattened
from ._sampling import sample
from ._values import each, positive

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["AccelerationVariance", "ParameterCovariance", "forward_dynamics_variance", "inverse_dynamics_variance"]

_Array = NDArray[np.float64]

#: Joint parameters of a degree of freedom, in the order of the kernel.
JOINT_PARAMETERS = ("armature", "damping", "friction", "offset")
#: Relative bound on the eigenvalues of a correlation matrix: a negative eigenvalue beyond it is an error, otherwise it
#: is rounding.
ROUNDING = 1e-12


@summarized
class AccelerationVariance(NamedTuple):
    """Variances of the accelerations of forward dynamics."""

    joints: _Array
    """Variances of the joint accelerations, (..., nv), (rad/s^2)^2 or (m/s^2)^2."""
    links: dict[str, _Array]
    """Covariance of the (angular, linear) acceleration of each link origin in the link frame, (..., 6, 6)."""


class ParameterCovariance:
    """Covariance of the parameters of a scene as columns of its root: inertial parameters of bodies in the link frames,
    and parameters of joints or motors that are correlated with them.

    Parameters
    ----------
    scene : Scene
        The scene.
    parameters : array_like, Identification, ParameterCovariance or None
        (bodies, 10, 10), (10 bodies, 10 bodies), an object with such a `.covariance`, or an object with the parameters
        of joints too, for a scene with the same bodies and joints. See Scene.forward_dynamics_variance.

    Raises
    ------
    ArgumentError
        A matrix that is not a covariance; a covariance of the parameters of another robot.
    ShapeError, NotFiniteError
        An invalid array.

    Examples
    --------
    >>> import numpy as np, phipsi
    >>> from phipsi.estimation import ParameterCovariance
    >>> scene = phipsi.scenes.chain(2)
    >>> q, qd, qdd = np.random.default_rng(0).normal(size=(3, 50, 2))
    >>> tau = scene.inverse_dynamics(q, qd, qdd) + 0.2 * qd
    >>> found = scene.identify(q, qd, qdd, tau, fit=["damping"], noise=0.01)
    >>> covariance = ParameterCovariance(found.scene, found)
    >>> covariance.columns.shape[1:], covariance.extras.shape[1:]
    ((2, 10), (2,))
    """

    blocks: _Array | None
    """Roots of the covariances of the bodies, (bodies, rank, 10); None if bodies are correlated with each other or with
    joints."""
    extras: _Array
    """Columns of the parameters of joints or motors, (number, extras), in the order of `names`; the inertial parameters
    of the same errors are `columns`."""

    def __init__(self, scene: Scene, parameters: Any) -> None:
        whole = getattr(parameters, "parameter_covariance", parameters)
        if isinstance(whole, ParameterCovariance):
            whole._check_robot(scene)
            self.__dict__.update(whole.__dict__, _scene=scene)
            return
        self._scene = scene
        bodies = len(scene.body_names)
        self.blocks = np.zeros((bodies, 0, 10))
        self.extras = np.zeros((0, 0))
        self._columns: _Array | None = None
        self._model: Columns | None = None
        if parameters is None:
            return
        given = numbers("parameters", getattr(parameters, "covariance", parameters))
        full = (10 * bodies, 10 * bodies)
        if given.shape not in ((bodies, 10, 10), full):
            raise of_argument(
                ShapeError,
                "parameters",
                f"found shape {given.shape}; expected {(bodies, 10, 10)}, or {full} for correlated bodies",
            )
        if given.shape == full and bodies > 0:
            blocks = given.reshape(bodies, 10, bodies, 10).transpose(0, 2, 1, 3)
            beside = blocks[~np.eye(bodies, dtype=bool)]
            if np.any(beside != 0.0):
                self.blocks = None
                self._columns = covariance_root("parameters", given).T.reshape(-1, bodies, 10)
                return
            given = blocks[np.arange(bodies), np.arange(bodies)]
        if bodies:
            # Eigenvalues are in ascending order, so that nonzero columns come last.
            roots = covariance_roots("parameters", given).transpose(0, 2, 1)
            used = roots.any(axis=(0, 2))
            self.blocks = np.ascontiguousarray(roots[:, used])

    @property
    def columns(self) -> _Array:
        """All columns, (number, bodies, 10). They have O(bodies^2) entries and are computed on demand."""
        if self._columns is None:
            assert self.blocks is not None
            body, column = np.nonzero(self.blocks.any(axis=-1))
            self._columns = np.zeros((len(body), len(self.blocks), 10))
            self._columns[np.arange(len(body)), body] = self.blocks[body, column]
        return self._columns

    def sample(self, n: int, *, seed: np.random.Generator | int | None = None) -> dict[str, _Array]:
        """Sample models that a physical robot can have, with the parameters of the scene as their mean.

        Parameters
        ----------
        n : int
            Number of models.
        seed : numpy.random.Generator or int, optional
            Generator or seed; None: unpredictable.

        Returns
        -------
        models : dict of str to array
            Keywords of Scene.simulate: "inertias", (n, bodies, 10), and those of "armature", "damping" and "friction"
            that are uncertain, (n, nv). Scene.forward_dynamics and other functions of the dynamics take "inertias" and
            "armature".

        Raises
        ------
        ArgumentError
            An uncertain inertia that is on the bound of what a rigid body can have, such as that of a point mass;
            uncertain offsets of friction and motors.

        Notes
        -----
        The samples have this covariance to first order. A relative change e of the pseudo-inertia of a body becomes
        the factor e + sqrt(1 + e^2), which is positive, so that no sample leaves what a rigid body can have; a
        positive property of a joint likewise. A property that is zero becomes the positive part of its change.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> from phipsi.estimation import ParameterCovariance
        >>> scene = phipsi.scenes.chain(2)
        >>> covariance = ParameterCovariance(scene, np.diag(([0.01] + [0.0] * 9) * 2))
        >>> models = covariance.sample(1000, seed=0)
        >>> path = scene.simulate([0.1, 0.2], np.zeros(2), dt=1e-3, steps=10, **models)
        >>> path.q.shape
        (1000, 11, 2)
        """
        return sample(self, self._scene, n, generator_of(seed))

    @classmethod
    def _of_root(cls, model: Columns, root: _Array) -> ParameterCovariance:
        """Covariance L L^T of the parameters of `model` from the root L, (width, number)."""
        found = cls(model.scene, None)
        bodies, number = 10 * len(model.free), root.shape[1]
        found._columns = np.zeros((number, len(model.scene.body_names), 10))
        found._columns[:, model.free] = root[:bodies].T.reshape(number, -1, 10)
        found.blocks, found.extras, found._model = None, np.ascontiguousarray(root[bodies:].T), model
        return found

    @property
    def names(self) -> tuple[tuple[str, str], ...]:
        """Joint or motor, and kind of parameter, of each entry of `extras`."""
        return tuple((extra.name, extra.kind) for extra in self._extras)

    @property
    def _extras(self) -> list[Extra]:
        return [] if self._model is None else self._model.extras

    def _check_robot(self, scene: Scene) -> None:
        """Raise ArgumentError for a scene with other bodies or joints."""
        if self._model is None:
            own, name = [str(self.columns.shape[1])], "number of bodies"
            its = [str(len(scene.body_names))]
        else:
            own, its, name = list(self._model.scene.body_names), list(scene.body_names), "bodies"
            if own == its:
                own, its, name = list(self._model.scene.joint_names), list(scene.joint_names), "joints"
        if own != its:
            found = f"found the covariance of a robot with the {name} {', '.join(own)}"
            raise of_argument(ArgumentError, "parameters", f"{found}; expected {', '.join(its)}, those of the scene")

    def arrays(self) -> dict[str, _Array]:
        """Arrays for numpy.savez, from which `from_arrays` restores the covariance.

        Returns
        -------
        arrays : dict
            "root", (number, 10 bodies + extras), and the settings of the identification for the extras.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> from phipsi.estimation import ParameterCovariance
        >>> scene = phipsi.scenes.chain(2)
        >>> covariance = ParameterCovariance(scene, np.diag([0.01] + [0.0] * 19))
        >>> arrays = covariance.arrays()
        >>> ParameterCovariance.from_arrays(scene, arrays).columns.shape
        (1, 2, 10)
        """
        columns = self.columns
        found = {"root": np.concatenate([columns.reshape(len(columns), -1), self.extras.reshape(len(columns), -1)], 1)}
        if self._model is None:
            return found
        settings = {"fit": self._model.fit, "friction_speed": self._model.slow, "stribeck_speed": self._model.stribeck}
        found |= {name: np.asarray(value) for name, value in settings.items() if self._model.fit}
        if self._model.transmission is not None:
            found["transmission"] = self._model.transmission
        return found

    @classmethod
    def from_arrays(cls, scene: Scene, arrays: Mapping[str, Any]) -> ParameterCovariance:
        """Restore a covariance from the arrays that `arrays` returns.

        Parameters
        ----------
        scene : Scene
            A scene with the bodies and joints of the robot.
        arrays : mapping
            The arrays, by name.

        Returns
        -------
        covariance : ParameterCovariance
            The covariance.

        Raises
        ------
        ShapeError, ArgumentError
            Arrays of another robot, or invalid ones.

        Examples
        --------
        >>> import numpy as np, phipsi
        >>> from phipsi.estimation import ParameterCovariance
        >>> scene = phipsi.scenes.chain(2)
        >>> ParameterCovariance.from_arrays(scene, {"root": np.ones((3, 20))}).columns.shape
        (3, 2, 10)
        """
        fit = tuple(str(kind) for kind in np.ravel(arrays.get("fit", ())))
        slow, stribeck = float(arrays.get("friction_speed", 0.01)), float(arrays.get("stribeck_speed", 0.1))
        model = Columns(scene, fit, (), slow, stribeck, arrays.get("transmission"))
        root = numbers("root", arrays["root"])
        if root.ndim != 2 or root.shape[1] != model.width:
            raise of_argument(ShapeError, "root", f"found shape {root.shape}; expected (number, {model.width})")
        check_finite("root", root)
        return cls._of_root(model, root.T)

    def _extra_torques(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> _Array:
        """Joint torques of the changes of the parameters of joints and motors, (number, ..., nv)."""
        if self._model is None or not self.extras.any():
            return np.zeros(())
        batch, flat = flattened(self._model.scene, q, qd, qdd)
        finite = np.logical_and.reduce([np.isfinite(one).all(axis=1) for one in flat])
        moved = np.full((len(self.extras), len(finite), self._model.scene.nv), np.nan)
        by_extra = self._model.to_joints(np.swapaxes(self._model.of_extras(*(one[finite] for one in flat)), 1, 2))
        moved[:, finite] = np.einsum("se,kev->skv", self.extras, by_extra)
        return moved.reshape(len(moved), *batch, moved.shape[-1])

    def _torques(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, scene: Scene, errors: Any = "raise") -> _Array:
        """Joint torques that the changes of the parameters cause in a scene at (q, qd, qdd), (number, ..., nv)."""
        of_bodies = np.einsum("...ibp,sbp->s...i", scene.regressor(q, qd, qdd, errors=errors), self.columns)
        return np.asarray(of_bodies + self._extra_torques(q, qd, qdd))

    def _joints(self, nv: int) -> _Array:
        """Columns of armature, damping, friction and offset of each degree of freedom, (number, nv, 4).

        Raises ArgumentError for parameters that a simulation does not have.
        """
        found = np.zeros((len(self.columns), nv, 4))
        for extra, column in zip(self._extras, self.extras.T, strict=True):
            assert self._model is not None
            joint = self._model.of_joint(extra)
            kind = OF_JOINTS.get(extra.kind, extra.kind)
            if joint is None or kind not in JOINT_PARAMETERS:
                expected = "expected armature, damping, friction and offsets of single joints, or the covariance of the"
                expected += " bodies alone (Identification.covariance)"
                raise of_argument(ArgumentError, "parameters", f"found {extra.kind} of {extra.name!r}; {expected}")
            rows = self._model.scene.v_index(joint[0])
            found[:, rows, JOINT_PARAMETERS.index(kind)] += joint[1] * column[:, None]
        return found


def covariance_root(name: str, covariance: _Array) -> _Array:
    """Root L, (n, rank), of a covariance L L*, after a check; without columns of the size of rounding errors."""
    root = covariance_roots(name, covariance[None], single=True)[0]
    kept: _Array = root[:, root.any(axis=0)]
    return kept


def covariance_roots(name: str, covariances: _Array, single: bool = False) -> _Array:
    """Roots of covariances, (..., n, n); columns of the size of rounding errors are zero."""
    check_finite(name, covariances, "a covariance, with zeros for what is known")
    deviations = np.sqrt(np.maximum(np.diagonal(covariances, axis1=-2, axis2=-1), 0.0))
    scale = np.where(deviations > 0.0, deviations, 1.0)
    unit = covariances / (scale[:, :, None] * scale[:, None, :])
    transposed = np.swapaxes(unit, -1, -2)

    def named(at: int) -> str:
        return name if single else f"{name}[{at}]"

    uneven = ~np.all(np.abs(unit - transposed) <= 1e-9, axis=(-2, -1))
    if uneven.any():
        raise of_argument(
            ArgumentError,
            named(int(np.argmax(uneven))),
            "found a matrix that is not symmetric; expected a covariance, for instance 0.5 * (C + C.T)",
        )
    values, vectors = np.linalg.eigh(0.5 * (unit + transposed))
    bound = ROUNDING * np.maximum(1.0, np.max(np.abs(values), axis=-1, initial=0.0))
    negative = ~np.all(values >= -bound[:, None], axis=-1)
    if negative.any():
        at = int(np.argmax(negative))
        found = f"found a matrix with an eigenvalue of {values[at, 0]:.3g} relative to its variances"
        raise of_argument(
            ArgumentError, named(at), f"{found}; expected a covariance, whose eigenvalues are zero or positive"
        )
    kept = np.where(values > 1e-3 * bound[:, None], values, 0.0)
    roots: _Array = scale[:, :, None] * vectors * np.sqrt(kept)[:, None, :]
    return roots


def _per_joint(scene: Scene, name: str, value: ArrayLike) -> _Array:
    """Variances of the degrees of freedom, (nv,), from a scalar or (nv,)."""
    refused = "found a variance that is negative or not finite; expected zero or positive ones"
    return each(name, value, scene.nv, refused)


def _joint_covariance(scene: Scene, joints: Any, parameters: ParameterCovariance) -> _Array | None:
    """Joint covariance, (nv, 4, 4), from a mapping of variances or an array.

    Raises ArgumentError for parameters of joints whose covariance `parameters` has too.
    """
    if joints is None:
        return None
    found = _of_joints(scene, joints)
    given = {name for at, name in enumerate(JOINT_PARAMETERS) if found[:, at, at].any()}
    twice = [kind for _, kind in parameters.names if kind in given]
    if twice:
        text = f"found variances of {twice[0]}, which parameters has too; expected one of them, or"
        raise of_argument(
            ArgumentError, "joints", f"{text} parameters=found.covariance, which is that of the bodies alone"
        )
    return found


def _of_joints(scene: Scene, joints: Any) -> _Array:
    if not isinstance(joints, Mapping):
        given = numbers("joints", joints)
        if given.shape != (scene.nv, 4, 4):
            raise of_argument(
                ShapeError,
                "joints",
                f"found shape {given.shape}; expected {(scene.nv, 4, 4)}, or a dict of variances by"
                f" {', '.join(JOINT_PARAMETERS)}",
            )
        for row, own in enumerate(given):
            covariance_root(f"joints[{row}]", own)
        return np.ascontiguousarray(given)
    covariance = np.zeros((scene.nv, 4, 4))
    for name, value in joints.items():
        if name not in JOINT_PARAMETERS:
            raise of_argument(
                ArgumentError, "joints", f"found {name!r}; expected names of {', '.join(JOINT_PARAMETERS)}"
            )
        at = JOINT_PARAMETERS.index(name)
        covariance[:, at, at] = _per_joint(scene, f"joints[{name!r}]", value)
    return covariance


def _has_rows(scene: Scene) -> bool:
    """Return whether the scene has connections, or joints that follow others.

    Their variances are formed from dense matrices.
    """
    return bool(scene.loops.names) or has_followers(scene)


def _torque_covariance(
    scene: Scene,
    state: tuple[ArrayLike, ArrayLike, ArrayLike],
    parameters: ParameterCovariance,
    noise: _Array,
    of_joints: tuple[Any, float],
    errors: Literal["raise", "nan"],
) -> _Array:
    """Covariance of the torque errors at (q, qd, qdd), (..., nv, nv): of parameters, joint parameters and torques."""
    torques = parameters._torques(*state, scene, errors)
    joints, slow = of_joints
    covariance = _joint_covariance(scene, joints, parameters)
    own = np.broadcast_to(noise, torques.shape[1:])
    if covariance is not None:
        qd, qdd = (np.broadcast_to(np.asarray(x, float), own.shape) for x in state[1:])
        by = np.stack([qdd, qd, qd / np.sqrt(qd**2 + slow**2), np.ones_like(qd)], axis=-1)
        own = own + np.einsum("...ia,iab,...ib->...i", by, covariance, by)
    return np.asarray(np.einsum("s...i,s...j->...ij", torques, torques) + own[..., None] * np.eye(scene.nv))


@contextlib.contextmanager
def _warned() -> Iterator[None]:
    """Calls for the same states as one before, which has issued their BadStateWarning."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BadStateWarning)
        yield


def forward_dynamics_variance(
    scene: Scene,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike,
    *,
    parameters: Any = None,
    joints: Any = None,
    torque: ArrayLike | None = None,
    links: str | Sequence[str] | None = None,
    wrenches: Any = None,
    inertias: Any = None,
    armature: Any = None,
    friction_speed: float = 0.01,
    errors: Literal["raise", "nan"] = "raise",
) -> _Array | AccelerationVariance:
    """Implementation of Scene.forward_dynamics_variance."""
    found = ParameterCovariance(scene, parameters)
    noise = _per_joint(scene, "torque", 0.0 if torque is None else torque)
    speed = positive("friction_speed", friction_speed)
    names = [links] if isinstance(links, str) else list(links or ())
    own: dict[str, Any] = {"inertias": inertias, "armature": armature}
    if _has_rows(scene):
        qdd = scene.forward_dynamics(q, qd, tau, wrenches=wrenches, errors=errors, **own)
        of = scene.loops if scene.loops.names else scene
        with _warned():
            inverse = of.mass_matrix_inverse(q, errors=errors, **own)
            spread = _torque_covariance(scene, (q, qd, qdd), found, noise, (joints, speed), errors)
            jacobians = {name: scene.jacobian(q, name, errors=errors) for name in names}
        whole = inverse @ spread @ np.swapaxes(inverse, -1, -2)
        whole = np.where(np.isfinite(qdd).all(axis=-1)[..., None, None], whole, np.nan)
        variances = np.diagonal(whole, axis1=-2, axis2=-1).copy()
        if links is None:
            return variances
        return AccelerationVariance(
            variances, {name: j @ whole @ np.swapaxes(j, -1, -2) for name, j in jacobians.items()}
        )
    independent = np.zeros((len(scene.body_names), 0, 10)) if found.blocks is None else found.blocks
    both = scene._variance(
        True,
        (q, qd, tau),
        independent,
        noise,
        _joint_covariance(scene, joints, found),
        speed,
        names or None,
        wrenches,
        inertias,
        armature,
        errors,
    )
    of_joints = both[..., : scene.nv].copy() if names else both
    of_links = {
        name: both[..., scene.nv + 36 * at :][..., :36].reshape(*both.shape[:-1], 6, 6) for at, name in enumerate(names)
    }
    if found.blocks is None:
        zero = np.zeros(scene.nv)
        columns = found.columns.reshape(-1, *(1,) * (both.ndim - 1), *found.columns.shape[1:])
        # An error of a joint parameter acts as a torque, at the acceleration found.
        pushed = zero
        with _warned():
            if found.extras.any():
                qdd = scene.forward_dynamics(q, qd, tau, wrenches=wrenches, errors=errors, **own)
                pushed = -found._extra_torques(q, qd, qdd)
            moved = scene.forward_dynamics_jvp(
                q, qd, tau, zero, zero, pushed, dparameters=columns, wrenches=wrenches, errors=errors, **own
            )
            jacobians = {name: scene.jacobian(q, name, errors=errors) for name in names}
        of_joints += np.sum(moved**2, axis=0)
        for name, covariance in of_links.items():
            changes = np.einsum("...iv,s...v->s...i", jacobians[name], moved)
            of_links[name] = covariance + np.einsum("s...i,s...j->...ij", changes, changes)
    return AccelerationVariance(of_joints, of_links) if links is not None else of_joints


def inverse_dynamics_variance(
    scene: Scene,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    *,
    parameters: Any = None,
    joints: Any = None,
    torque: ArrayLike | None = None,
    inertias: Any = None,
    armature: Any = None,
    friction_speed: float = 0.01,
    errors: Literal["raise", "nan"] = "raise",
) -> _Array:
    """Implementation of Scene.inverse_dynamics_variance."""
    found = ParameterCovariance(scene, parameters)
    noise = _per_joint(scene, "torque", 0.0 if torque is None else torque)
    speed = positive("friction_speed", friction_speed)
    if _has_rows(scene):
        spread = _torque_covariance(scene, (q, qd, qdd), found, noise, (joints, speed), errors)
        variances = np.diagonal(spread, axis1=-2, axis2=-1).copy()
        # A model changes no variance, but it has a shape and can be invalid, and so can a state without uncertain parameters.
        with _warned():
            torques = scene.inverse_dynamics(q, qd, qdd, inertias=inertias, armature=armature, errors=errors)
        return np.where(np.isfinite(torques).all(axis=-1, keepdims=True), variances, np.nan)
    independent = np.zeros((len(scene.body_names), 0, 10)) if found.blocks is None else found.blocks
    variance = scene._variance(
        False,
        (q, qd, qdd),
        independent,
        noise,
        _joint_covariance(scene, joints, found),
        speed,
        None,
        None,
        inertias,
        armature,
        errors,
    )
    if found.blocks is None:
        zero = np.zeros(scene.nv)
        columns = found.columns.reshape(-1, *(1,) * (variance.ndim - 1), *found.columns.shape[1:])
        with _warned():
            moved = scene.inverse_dynamics_jvp(q, qd, qdd, zero, zero, zero, dparameters=columns, errors=errors)
        moved = moved + found._extra_torques(q, qd, qdd)
        variance = variance + np.sum(moved**2, axis=0)
    return variance
