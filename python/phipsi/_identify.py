"""Inertias, and what acts at the joints, from measured motion and torques: the most probable ones that bodies can have.

Torques are linear in the parameters x: ten a body (mass, first moments, inertia about the link's origin), and where asked for armature, damping and
friction of the joints. With the regressor Y, measured torques tau and their standard deviations s, x is where

    1/2 sum ((tau - Y x) / s)^2 + trust/2 sum over bodies (tr(J0^-1 J) - log det J)

is least. J, 4x4 and linear in x, holds the second moments of a body's mass; a body can have x where J is positive definite, and the logarithm keeps it so. The
second sum is the prior, of Wishart's kind: its mode J0 is the body of the model. The function is convex; _most_probable finds its least value. Everything is computed in
multiples z of the prior, J = L Z L^T with J0 = L L^T, where the prior's mode is Z = 1. The rows of Y are read in blocks of states and kept as a triangle for each degree
of freedom, so that memory does not grow with the number of states.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from ._arguments import check_tree
from ._most_probable import BASIS, COLUMNS, ROWS, most_probable
from .errors import ArgumentError, InertiaWarning, OutOfMemoryError, ShapeError, of_argument

if TYPE_CHECKING:
    from ._core import Scene

__all__ = ["Identification"]

_Array = NDArray[np.float64]

#: What of the joints may be found too.
JOINTS = ("armature", "damping", "friction")
#: The least number of states whose regressors are computed at once.
CHUNK = 256
#: Combinations of parameters that the motion tells by less than this share of the best known one count as unknown.
UNKNOWN = 1e-8
#: Where the model has no armature, damping or friction, the prior's mode is this share of what would explain the torques alone.
SHARE = 1e-3
#: The least noise, relative to the torques: a multiple of the rounding of the regressor, which would count as knowledge with less.
ROUNDING = 2.0**-36
#: The largest torque, whose square is a number.
LARGEST = 1e100
#: Of a body that cannot be, principal second moments below this share of the largest one are raised to it; and the least radius of gyration, of the robot's size.
SLENDER, SMALL = 1e-3, 1e-2


class Identification(NamedTuple):
    """What measured torques tell of a robot's parameters."""

    scene: Scene
    """The robot with what was found. A body's numbers are at the link of body_names; links that are fixed onto it have none of their own."""
    parameters: _Array
    """(m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) of each link of body_names, (bodies, 10), I about the link's origin."""
    deviations: _Array
    """Their standard deviations, (bodies, 10), by data and prior together: about the prior's where the data tell nothing, zero for bodies that were kept."""
    joints: dict[str, dict[str, float]]
    """What was fitted of "armature", "damping" and "friction": from it to numbers by joint name."""
    noise: _Array
    """Standard deviation of the torques, (nv,), N m or N: as given, or as residuals have it, at least 1.5e-11 of the torques; NaN where none was measured."""
    before: _Array
    """Root mean square of measured torques less the model's, (nv,), N m or N; NaN where none was measured."""
    after: _Array
    """Root mean square of measured torques less those of what was found, (nv,)."""
    known: int
    """How many combinations of the parameters the motion tells: the number of base parameters, where it moves all joints richly."""


def identify(
    scene: Scene,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    tau: ArrayLike,
    *,
    fit: Collection[str] = (),
    noise: ArrayLike | None = None,
    trust: float = 1.0,
    keep: Collection[str] = (),
    friction_speed: float = 0.01,
) -> Identification:
    """As Scene.identify, which calls it."""
    check_tree(scene, "identify")
    for name, value in (("trust", trust), ("friction_speed", friction_speed)):
        if not (np.isfinite(value) and value > 0.0):
            raise of_argument(ArgumentError, name, f"found {value}; expected a finite number above zero")
    try:
        return _identified(scene, _Data(scene, q, qd, qdd, tau, fit, keep, friction_speed), noise, trust)
    except MemoryError:
        size = 10 * len(scene.body_names) + 1
        size = 8 * scene.nv * (size * (size + CHUNK) + 10 * len(np.asarray(q)))
        error = of_argument(OutOfMemoryError, "q", f"no room for {size} bytes; expected fewer states, or fewer bodies (Scene.lock)")
        error.bytes = size
        raise error from None


def _identified(scene: Scene, data: _Data, noise: ArrayLike | None, trust: float) -> Identification:
    weights = data.deviation() if noise is None else data.checked_noise(noise)
    triangle, target = data.weighted(weights)
    z, root = most_probable(triangle, target, data.bodies, trust)
    parameters, deviations = data.own.copy(), np.zeros_like(data.own)
    for at, body in enumerate(data.free):
        part = slice(10 * at, 10 * at + 10)
        parameters[body] = data.to_parameters[at] @ z[part]
        deviations[body] = np.linalg.norm(data.to_parameters[at] @ root[part], axis=1)
    joints: dict[str, dict[str, float]] = {name: {} for name in data.fit}
    for (name, joint, mode), value in zip(data.extras, z[10 * data.bodies :], strict=True):
        joints[name][joint] = float(mode * value)
    singular = np.linalg.svd(triangle, compute_uv=False)
    return Identification(
        _with(scene, data, parameters, joints),
        parameters,
        deviations,
        joints,
        weights,
        data.residual(data.model),
        data.residual(z),
        int(np.sum(singular > UNKNOWN * singular[0])) if singular.size else 0,
    )


# The data


class _Data:
    """Measured torques, less what is not fitted, and how they change with multiples of the prior: as one triangle for each degree of freedom."""

    def __init__(
        self, scene: Scene, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, tau: ArrayLike, fit: Collection[str], keep: Collection[str], slow: float
    ) -> None:
        for name in fit:
            if name not in JOINTS:
                raise of_argument(ArgumentError, "fit", f"found {name!r}; expected names of {', '.join(JOINTS)}")
        for name in keep:
            if name not in scene.body_names:
                raise of_argument(ArgumentError, "keep", f"found {name!r}; expected names of scene.body_names")
        q, qd, qdd = (np.array(_core._numbers(*one)) for one in (("q", q, scene, True), ("qd", qd, scene), ("qdd", qdd, scene)))
        tau = np.array(_core._numbers("tau", tau, scene))
        count = len(q) if q.ndim == 2 else 0
        for name, array, size in (("q", q, scene.nq), ("qd", qd, scene.nv), ("qdd", qdd, scene.nv), ("tau", tau, scene.nv)):
            if array.shape != (count, size) or count == 0:
                raise of_argument(ShapeError, name, f"found shape {array.shape}; expected (k, {size}), as many states as q has")
        if np.any(np.isinf(tau)):
            raise of_argument(ArgumentError, "tau", "found an infinity; expected numbers, NaN where a torque was not measured")
        # Reports what is not finite, by the index of the state.
        scene.inverse_dynamics(q, qd, qdd)
        seen = np.isfinite(tau)
        if (largest := float(np.max(np.abs(tau), where=seen, initial=0.0))) > LARGEST:
            raise of_argument(ArgumentError, "tau", f"found {largest:g}; expected torques below {LARGEST:g}, in N m or N")
        if not seen.any():
            raise of_argument(ArgumentError, "tau", "found no measured torque: all are NaN; expected some numbers")
        self.fit, self.own, self.nv = tuple(fit), own_parameters(scene), scene.nv
        names = scene.body_names
        self.free = [at for at, name in enumerate(names) if name not in keep]
        self.bodies = len(self.free)
        self.to_parameters, self.model = self._prior(scene)
        sliding = qd / np.sqrt(qd**2 + slow**2)
        columns: dict[str, _Array] = {"armature": qdd, "damping": qd, "friction": sliding}
        values: dict[str, Any] = {"armature": scene.armature, "damping": scene.damping, "friction": scene.friction}
        # Inverse dynamics has armature and the bodies; the rest is what the joints do by themselves.
        known = _springs(scene, q)
        for name in JOINTS:
            if name not in fit:
                known = known + values[name] * columns[name]
        self.extras: list[tuple[str, str, float]] = []
        of_extras: list[tuple[slice, _Array]] = []
        for name in fit:
            for joint in scene.joint_names:
                of = scene.v_index(joint)
                moved = float(np.sqrt(np.sum(columns[name][:, of][seen[:, of]] ** 2) / np.sum(seen)))
                # A floating base has none of them, and a joint that stands still does not tell.
                if scene.joints[joint].type == "floating" or moved == 0.0:
                    continue
                model = float(values[name][of][0])
                prior = model or SHARE * float(np.sqrt(np.mean(np.where(seen, tau, 0.0)[:, of] ** 2))) / moved
                if prior == 0.0:
                    continue
                self.extras.append((name, joint, prior))
                of_extras.append((of, prior * columns[name][:, of]))
                self.model = np.append(self.model, model / prior)
        width = len(self.model)
        if not width:
            raise of_argument(ArgumentError, "keep", "found all bodies, and nothing of the joints to fit; expected something to find")
        #: Torques that were measured, for each degree of freedom.
        self.counts = np.sum(seen, axis=0)
        #: The triangle of [rows, torques] for each degree of freedom, (r, width + 1), r at most the number of columns that are not zero.
        self.triangles = [np.zeros((0, width + 1)) for _ in range(self.nv)]
        for begin in range(0, count, chunk := max(CHUNK, 2 * width)):
            part = slice(begin, begin + chunk)
            rows = _regressor(scene, q[part], qd[part], qdd[part])
            block = np.zeros((self.nv, len(rows), width + 1))
            kept = [at for at in range(len(names)) if at not in self.free]
            block[:, :, -1] = (tau[part] - known[part] - np.einsum("kibp,bp->ki", rows[:, :, kept], self.own[kept])).T
            for at, body in enumerate(self.free):
                block[:, :, 10 * at : 10 * at + 10] = np.einsum("kip,pr->ikr", rows[:, :, body], self.to_parameters[at])
            for at, (of, column) in enumerate(of_extras, 10 * self.bodies):
                block[of, :, at] = column[part].T
            block[~seen[part].T] = 0.0
            self.triangles = [_triangle(np.concatenate(both)) for both in zip(self.triangles, block, strict=True)]

    def _prior(self, scene: Scene) -> tuple[list[_Array], _Array]:
        """For each body that is fitted the matrix from the entries of Z to parameters, (10, 10); and the z of the model."""
        matrices, model, mended = [], [], []
        size = _size(scene)
        for at in self.free:
            body, moments = scene.body_names[at], to_moments(self.own[at])
            try:
                root = np.linalg.cholesky(moments)
            except np.linalg.LinAlgError:
                root = np.linalg.cholesky(_nearest(body, moments, size))
                mended.append(body)
            matrices.append(np.array([to_parameters(root @ unit @ root.T) for unit in BASIS]).T)
            model.append(np.linalg.solve(matrices[-1], self.own[at]))
        if mended:
            found = f"found inertias of {', '.join(map(repr, mended))} that no body can have"
            text = f"scene: {found}; identification starts from the nearest possible ones (keep=[...] leaves a body as it is)"
            warnings.warn(text, InertiaWarning, stacklevel=5)
        return matrices, np.concatenate([*model, np.zeros(0)])

    def weighted(self, weights: _Array) -> tuple[_Array, _Array]:
        """The triangle of all rows over their standard deviations, and the torques in its rows."""
        triangle = _triangle(np.concatenate([rows / weight for rows, weight, count in zip(self.triangles, weights, self.counts, strict=True) if count]))
        return triangle[:, :-1], triangle[:, -1]

    def residual(self, z: NDArray[Any]) -> _Array:
        """Root mean square by degree of freedom of what multiples of the prior leave, (nv,); NaN where no torque was measured."""
        return self._mean([np.linalg.norm(rows @ np.append(z, -1.0)) for rows in self.triangles])

    def _mean(self, norms: list[Any]) -> _Array:
        return np.asarray(np.where(self.counts > 0, np.array(norms) / np.sqrt(np.maximum(self.counts, 1)), np.nan))

    def least(self) -> _Array:
        """The least noise, (nv,): rounding of the torques, and of what makes them up."""
        found = ROUNDING * self._mean([np.linalg.norm(rows * np.append(self.model, 1.0)) for rows in self.triangles])
        # A torque that nothing changes is as uncertain as the largest.
        return np.where(found == 0.0, max(float(np.nanmax(found)), float(np.finfo(float).tiny)), found)

    def checked_noise(self, noise: ArrayLike) -> _Array:
        """Given standard deviations, (nv,)."""
        found = np.asarray(_core._numbers("noise", noise))
        if found.shape not in ((), (self.nv,)):
            raise of_argument(ShapeError, "noise", f"found shape {found.shape}; expected () or ({self.nv},)")
        if not (np.all(np.isfinite(found)) and np.all(found > 0.0)):
            raise of_argument(ArgumentError, "noise", f"found {found.min()}; expected finite standard deviations above zero")
        found = np.array(np.broadcast_to(found, (self.nv,)))
        least = self.least()
        if np.any(below := found < least):
            at = int(np.argmax(below))
            message = f"found {found[at]:g} at index {at}; expected at least {least[at]:.1e}, below which rounding of the torques counts as knowledge"
            raise of_argument(ArgumentError, "noise", message)
        return found

    def deviation(self) -> _Array:
        """Standard deviation of the torques by degree of freedom, (nv,): what no parameters explain, bodies or not; NaN where none was measured."""
        least, measured = self.least(), int(np.sum(self.counts))
        if np.nanmax(least) <= np.finfo(float).tiny:
            message = "found states at which no torque depends on any parameter, and torques of zero; expected states that move, or noise, the standard deviation of the torques"
            raise of_argument(ArgumentError, "q", message)
        weights = np.where(self.counts > 0, 1.0, np.nan)
        for _ in range(2):
            triangle, target = self.weighted(weights)
            z, _, rank, _ = np.linalg.lstsq(triangle, target, rcond=UNKNOWN)
            if measured < 2 * rank:
                found = f"{measured} measured torques for {rank} combinations of parameters"
                raise of_argument(ArgumentError, "tau", f"found {found}; expected at least {2 * rank}, or noise, their standard deviation")
            weights = np.maximum(np.sqrt(measured / (measured - rank)) * self.residual(z), least)
        return weights


def _triangle(rows: _Array) -> _Array:
    """R of QR, of the columns that are not zero: a joint moves the bodies after it alone."""
    used = rows.any(axis=0)
    found = np.zeros((min(len(rows), int(used.sum())), rows.shape[1]))
    found[:, used] = np.linalg.qr(rows[:, used], mode="r")
    return found


def _regressor(scene: Scene, q: _Array, qd: _Array, qdd: _Array) -> _Array:
    """How torques change with the parameters of each body, (k, nv, bodies, 10)."""
    found = scene.inverse_dynamics_vjp(q[:, None], qd[:, None], qdd[:, None], np.eye(scene.nv), parameters=True).parameters
    assert found is not None
    return found


def _springs(scene: Scene, q: _Array) -> _Array:
    """Torques that hold the springs, (k, nv)."""
    return np.asarray(scene.stiffness * scene.difference(np.broadcast_to(scene.rest, q.shape), q))


# Bodies


def own_parameters(scene: Scene) -> _Array:
    """The ten parameters of each link of body_names with what is fixed onto it, (bodies, 10), about the link's origin in its axes."""
    places, of = scene.placements(scene.neutral()), bodies_of(scene)
    moments = {name: np.zeros((4, 4)) for name in scene.body_names}
    for link in scene.links.values():
        body = of[link.name]
        if body is None or link.mass == 0.0 and not np.any(link.inertia):
            continue
        place = np.linalg.solve(places[body], places[link.name])
        sigma = 0.5 * np.trace(link.inertia) * np.eye(3) - link.inertia
        local = np.zeros((4, 4))
        local[:3, :3] = sigma + link.mass * np.outer(link.com, link.com)
        local[:3, 3] = local[3, :3] = link.mass * link.com
        local[3, 3] = link.mass
        moments[body] += place @ local @ place.T
    return np.array([to_parameters(moments[name]) for name in scene.body_names]).reshape(-1, 10)


def bodies_of(scene: Scene) -> dict[str, str | None]:
    """For each link the link of body_names that it is fixed onto, or is; None on the base."""
    moving, found = set(scene.body_names), dict[str, str | None]()
    links = scene.links
    for name in scene.link_names:
        parent = links[name].parent
        found[name] = name if name in moving else None if parent is None else found[parent]
    return found


def to_parameters(moments: _Array) -> _Array:
    """(m, h, I) of the second moments of mass J."""
    sigma, (hx, hy, hz) = moments[:3, :3], moments[:3, 3]
    inertia = np.trace(sigma) * np.eye(3) - sigma
    return np.array([moments[3, 3], hx, hy, hz, *(inertia[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))])


def to_moments(parameters: _Array) -> _Array:
    """The second moments of mass J of (m, h, I)."""
    m, hx, hy, hz, xx, xy, yy, xz, yz, zz = parameters
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    found = np.empty((4, 4))
    found[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    found[:3, 3] = found[3, :3] = hx, hy, hz
    found[3, 3] = m
    return found


def _nearest(body: str, moments: _Array, size: float) -> _Array:
    """The second moments of mass of a body that can be, near ones that no body can have: its principal ones, about the center of mass, are raised to a share of the largest."""
    mass = moments[3, 3]
    if mass <= 0.0:
        found = f"no mass of the body {body!r}"
        raise of_argument(ArgumentError, "scene", f"found {found}; expected a model of it to begin from (Scene.with_inertias), or its name in keep")
    com = moments[:3, 3] / mass
    values, axes = np.linalg.eigh(moments[:3, :3] - mass * np.outer(com, com))
    values = np.maximum(values, max(SLENDER * float(values.max()), mass * (SMALL * size) ** 2))
    nearest = moments.copy()
    nearest[:3, :3] = (axes * values) @ axes.T + mass * np.outer(com, com)
    return nearest


def _size(scene: Scene) -> float:
    """The largest extent of the joints' frames at the neutral configuration, m; 1 where all are at one place."""
    points = [place[:3, 3] for place in scene.placements(scene.neutral()).values()]
    return float(np.ptp(points, axis=0).max()) or 1.0


def _with(scene: Scene, data: _Data, parameters: _Array, joints: dict[str, dict[str, float]]) -> Scene:
    """The scene with what was found."""
    names, of = scene.body_names, bodies_of(scene)
    found = {names[at] for at in data.free}
    links: dict[str, tuple[float, ArrayLike, ArrayLike | None]] = {
        link: (0.0, np.zeros(3), None) for link, body in of.items() if body in found and link not in found
    }
    for at in data.free:
        moments = to_moments(parameters[at])
        mass, com = moments[3, 3], moments[:3, 3] / moments[3, 3]
        sigma = moments[:3, :3] - mass * np.outer(com, com)
        links[names[at]] = (float(mass), com, np.trace(sigma) * np.eye(3) - sigma)
    changed = scene.with_inertias(links)
    properties: dict[str, Any] = {name: values for name, values in joints.items() if values}
    return changed.with_properties(**properties) if properties else changed
