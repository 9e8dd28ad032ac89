"""Inertias, and what acts at the joints, from measured motion and torques: the most probable ones that bodies can have.

Torques are linear in the parameters x: ten a body (mass, first moments, inertia about the link's origin), and where asked for armature, damping and
friction of the joints. With the regressor Y, measured torques tau and their standard deviations s, x is where

    1/2 sum ((tau - Y x) / s)^2 + trust/2 sum over bodies (tr(J0^-1 J) - log det J)

is least. J, 4x4 and linear in x, holds the second moments of a body's mass; a body can have x where J is positive definite, and the logarithm keeps it so. The
second sum is the prior, of Wishart's kind: its mode J0 is the body of the model. The function is convex: Newton's steps find its least value, with the
prior's weight lowered from where it balances the data. Everything is computed in multiples z of the prior, J = L Z L^T with J0 = L L^T, where the prior's mode is Z = 1.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from ._arguments import check_tree
from .errors import ArgumentError, OutOfMemoryError, PhipsiError, ShapeError, of_argument

if TYPE_CHECKING:
    from ._core import Scene

__all__ = ["Identification"]

_Array = NDArray[np.float64]

#: What of the joints may be found too.
JOINTS = ("armature", "damping", "friction")
#: States whose regressors are computed at once.
CHUNK = 256
#: By how much the prior's weight falls from round to round, and the most of Newton's steps within one.
FALL, STEPS = 8.0, 200
#: Newton's decrement, over the prior's weight, that ends a round, and the last one.
LOOSE, TIGHT = 1e-2, 1e-16
#: Combinations of parameters that the motion tells by less than this share of the best known one count as unknown.
UNKNOWN = 1e-8
#: Where the model has no armature, damping or friction, the prior's mode is this share of what would explain the torques alone.
SHARE = 1e-3
#: The entries of a symmetric 4x4 matrix on and above its diagonal; the symmetric matrices of one of them, and those as unit vectors.
ROWS, COLUMNS = np.triu_indices(4)
BASIS = np.array([[[float({a, b} == {i, j}) for b in range(4)] for a in range(4)] for i, j in zip(ROWS, COLUMNS, strict=True)])
ORTHONORMAL = BASIS / np.linalg.norm(BASIS, axis=(1, 2), keepdims=True)


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
    """Standard deviation of the torques, (nv,), N m or N: as given, or as residuals have it."""
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
        size = 8 * len(np.asarray(q)) * scene.nv * 10 * len(scene.body_names)
        error = of_argument(OutOfMemoryError, "q", f"no room for {size} bytes, several times; expected fewer states")
        error.bytes = size
        raise error from None


def _identified(scene: Scene, data: _Data, noise: ArrayLike | None, trust: float) -> Identification:
    weights = data.deviation() if noise is None else _noise(noise, scene.nv)
    rows = data.scaled / weights[data.dof][:, None]
    orthogonal, triangle = np.linalg.qr(rows)
    target = orthogonal.T @ (data.torques / weights[data.dof])
    z, spread = _most_probable(triangle, target, data.bodies, trust)
    parameters, deviations = data.own.copy(), np.zeros_like(data.own)
    for at, body in enumerate(data.free):
        part = slice(10 * at, 10 * at + 10)
        parameters[body] = data.to_parameters[at] @ z[part]
        deviations[body] = np.sqrt(np.diag(data.to_parameters[at] @ spread[part, part] @ data.to_parameters[at].T))
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
        data.residual(data.mode),
        data.residual(z),
        int(np.sum(singular > UNKNOWN * singular[0])) if singular.size else 0,
    )


def _noise(noise: ArrayLike, nv: int) -> _Array:
    found = np.asarray(noise, float)
    if found.shape not in ((), (nv,)):
        raise of_argument(ShapeError, "noise", f"found shape {found.shape}; expected () or ({nv},)")
    if not (np.all(np.isfinite(found)) and np.all(found > 0.0)):
        raise of_argument(ArgumentError, "noise", f"found {found.min()}; expected finite standard deviations above zero")
    return np.array(np.broadcast_to(found, (nv,)))


# The data


class _Data:
    """Measured torques, less what is not fitted, and how they change with multiples of the prior."""

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
        tau = np.array(tau, float)
        count = len(q) if q.ndim == 2 else 0
        for name, array, size in (("q", q, scene.nq), ("qd", qd, scene.nv), ("qdd", qdd, scene.nv), ("tau", tau, scene.nv)):
            if array.shape != (count, size) or count == 0:
                raise of_argument(ShapeError, name, f"found shape {array.shape}; expected (k, {size}), as many states as q has")
        if np.any(np.isinf(tau)):
            raise of_argument(ArgumentError, "tau", "found an infinity; expected numbers, NaN where a torque was not measured")
        self.fit, self.own = tuple(fit), own_parameters(scene)
        names = scene.body_names
        self.free = [at for at, name in enumerate(names) if name not in keep]
        self.bodies = len(self.free)
        self.to_parameters = [_from_multiples(names[at], self.own[at]) for at in self.free]
        rows = _regressor(scene, q, qd, qdd)
        sliding = qd / np.sqrt(qd**2 + slow**2)
        columns: dict[str, Any] = {"armature": qdd, "damping": qd, "friction": sliding}
        values: dict[str, Any] = {"armature": scene.armature, "damping": scene.damping, "friction": scene.friction}
        # Inverse dynamics has armature and the bodies; the rest is what the joints do by themselves.
        known = _springs(scene, q)
        for name in JOINTS:
            if name not in fit:
                known = known + values[name] * columns[name]
        kept = [at for at in range(len(names)) if at not in self.free]
        known = known + np.einsum("kibp,bp->ki", rows[:, :, kept], self.own[kept])
        each = [np.einsum("kip,pr->kir", rows[:, :, body], self.to_parameters[at]) for at, body in enumerate(self.free)]
        self.extras: list[tuple[str, str, float]] = []
        mode = [np.tile(np.eye(4)[ROWS, COLUMNS], self.bodies)]
        seen = np.isfinite(tau)
        for name in fit:
            for joint in scene.joint_names:
                of = scene.v_index(joint)
                column = np.zeros((count, scene.nv))
                column[:, of] = columns[name][:, of]
                moved = float(np.sqrt(np.mean(column[seen] ** 2))) if seen.any() else 0.0
                # A floating base has none of them, and a joint that stands still does not tell.
                if scene.joints[joint].type == "floating" or moved == 0.0:
                    continue
                model = float(values[name][of][0])
                prior = model or SHARE * float(np.sqrt(np.mean(np.where(seen, tau, 0.0)[:, of] ** 2))) / moved
                if prior == 0.0:
                    continue
                self.extras.append((name, joint, prior))
                each.append((prior * column)[:, :, None])
                mode.append(np.array([model / prior]))
        self.mode = np.concatenate(mode)
        scaled = np.concatenate(each, axis=2) if each else np.zeros((count, scene.nv, 0))
        self.nv = scene.nv
        self.dof = np.nonzero(seen)[1]
        self.scaled = scaled[seen]
        self.torques = (tau - known)[seen]
        if not self.scaled.shape[1]:
            raise of_argument(ArgumentError, "keep", "found all bodies, and nothing of the joints to fit; expected something to find")

    def residual(self, z: _Array) -> _Array:
        """Root mean square by degree of freedom of what multiples of the prior leave."""
        squares = (self.torques - self.scaled @ z) ** 2
        counts = np.bincount(self.dof, minlength=self.nv)
        with np.errstate(invalid="ignore"):
            return np.sqrt(np.bincount(self.dof, squares, minlength=self.nv) / counts)

    def deviation(self) -> _Array:
        """Standard deviation of the torques by degree of freedom, (nv,): what no parameters explain, bodies or not."""
        weights = np.ones(self.nv)
        counts = np.bincount(self.dof, minlength=self.nv)
        # Rounding, where the model explains all.
        least = np.finfo(float).eps * max(float(np.max(np.abs(self.torques), initial=0.0)), np.finfo(float).tiny)
        for _ in range(2):
            rows = self.scaled / weights[self.dof][:, None]
            z, _, rank, _ = np.linalg.lstsq(rows, self.torques / weights[self.dof], rcond=UNKNOWN)
            if len(self.torques) < 2 * rank:
                found = f"{len(self.torques)} measured torques for {rank} combinations of parameters"
                raise of_argument(ArgumentError, "tau", f"found {found}; expected at least {2 * rank}, or noise, their standard deviation")
            share = len(self.torques) / (len(self.torques) - rank)
            squares = np.bincount(self.dof, (self.torques - self.scaled @ z) ** 2, minlength=self.nv)
            weights = np.maximum(np.sqrt(share * squares / np.maximum(counts, 1)), least)
        return weights


def _regressor(scene: Scene, q: _Array, qd: _Array, qdd: _Array) -> _Array:
    """How torques change with the parameters of each body, (k, nv, bodies, 10)."""
    rows = np.empty((len(q), scene.nv, len(scene.body_names), 10))
    for begin in range(0, len(q), CHUNK):
        part = slice(begin, begin + CHUNK)
        found = scene.inverse_dynamics_vjp(q[part, None], qd[part, None], qdd[part, None], np.eye(scene.nv), parameters=True).parameters
        assert found is not None
        rows[part] = found
    return rows


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


def _from_multiples(body: str, own: _Array) -> _Array:
    """The matrix from the entries of Z to parameters, (10, 10)."""
    try:
        root = np.linalg.cholesky(to_moments(own))
    except np.linalg.LinAlgError:
        found = f"inertias of the body {body!r} that no body can have, or none"
        raise of_argument(ArgumentError, "scene", f"found {found}; expected a model of it to begin from (Scene.with_inertias), or its name in keep") from None
    return np.array([to_parameters(root @ unit @ root.T) for unit in BASIS]).T


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


# The most probable multiples


class _Point:
    """Multiples of the prior: Z = U U^T of each body and z = u^2 of the rest, which so stay positive; and steps y from them, Z + U Y U^T and z + u^2 y.

    Seen by y the prior's second derivative is the unit matrix, however large or slender a body has become.
    """

    def __init__(self, roots: _Array, rest: _Array) -> None:
        self.roots, self.rest = roots, rest

    @property
    def z(self) -> _Array:
        """The entries of Z on and above the diagonal, body by body, and the rest."""
        moments = self.roots @ np.swapaxes(self.roots, 1, 2)
        return np.concatenate([moments[:, ROWS, COLUMNS].ravel(), self.rest**2])

    def to_z(self) -> _Array:
        """How z changes with y."""
        found = np.zeros((10 * len(self.roots) + len(self.rest),) * 2)
        for at, root in enumerate(self.roots):
            part = slice(10 * at, 10 * at + 10)
            found[part, part] = (root @ ORTHONORMAL @ root.T)[:, ROWS, COLUMNS].T
        rest = np.arange(10 * len(self.roots), len(found))
        found[rest, rest] = self.rest**2
        return found

    def pull(self) -> _Array:
        """Half the prior's first derivative by y, which is zero at its mode: U^T U - 1 and u^2 - 1."""
        off = np.swapaxes(self.roots, 1, 2) @ self.roots - np.eye(4)
        return np.concatenate([np.einsum("bjk,ijk->bi", off, ORTHONORMAL).ravel(), self.rest**2 - 1.0])

    def rates(self, y: _Array) -> _Array:
        """By how much the logarithm's arguments change with a step: the eigenvalues of Y, and the rest."""
        changes = self.changes(y)
        return np.concatenate([np.linalg.eigvalsh(changes).ravel(), y[10 * len(self.roots) :]])

    def changes(self, y: _Array) -> _Array:
        """The matrices Y."""
        return np.asarray(np.einsum("bi,ijk->bjk", y[: 10 * len(self.roots)].reshape(-1, 10), ORTHONORMAL))

    def moved(self, y: _Array) -> _Point:
        """The point after a step within the wall."""
        grown = np.linalg.cholesky(np.eye(4) + self.changes(y))
        return _Point(self.roots @ grown, self.rest * np.sqrt(1.0 + y[10 * len(self.roots) :]))


def _most_probable(triangle: _Array, target: _Array, bodies: int, trust: float) -> tuple[_Array, _Array]:
    """Where |target - triangle z|^2 / 2 and the prior of that weight are least, and the covariance of z there."""
    size = triangle.shape[1]
    point = _Point(np.tile(np.eye(4), (bodies, 1, 1)), np.ones(size - 10 * bodies))
    weight = max(trust, float(np.linalg.norm(triangle, 2)) ** 2)
    while True:
        last, decrement = weight <= trust, np.inf
        for _ in range(STEPS):
            scaled, root = triangle @ point.to_z(), np.sqrt(0.5 * weight)
            left = target - triangle @ point.z
            # Newton's step, as a least-squares problem: its matrix is not squared.
            rows = np.concatenate([scaled, root * np.eye(size)])
            step = np.linalg.lstsq(rows, np.concatenate([left, -root * point.pull()]), rcond=None)[0]
            before, decrement = decrement, float(np.sum((rows @ step) ** 2)) / weight
            # The last round ends where rounding does not let it fall.
            if decrement <= (TIGHT if last else LOOSE) or (last and decrement < 1e-8 and decrement > 0.25 * before):
                break
            point = point.moved(_length(scaled, left, point, step, weight) * step)
        else:
            raise PhipsiError(f"identify: found no least value in {STEPS} steps (decrement {decrement:g}); expected another trust or noise to give one")
        if last:
            return point.z, _covariance(scaled, point, weight)
        weight = max(trust, weight / FALL)


def _covariance(scaled: _Array, point: _Point, weight: float) -> _Array:
    """The inverse of the second derivative by z."""
    _, singular, right = np.linalg.svd(scaled)
    variances = np.full(len(right), 2.0 / weight)
    variances[: len(singular)] = 1.0 / (singular**2 + 0.5 * weight)
    root = point.to_z() @ right.T * np.sqrt(variances)
    return np.asarray(root @ root.T)


def _length(scaled: _Array, left: _Array, point: _Point, step: _Array, weight: float) -> float:
    """The best length of a step: where the slope along it, which rises, is zero."""
    rates, along = point.rates(step), scaled @ step
    # tr Z and z change evenly, their logarithms do not.
    constant = -float(along @ left) + 0.5 * weight * float(point.pull() @ step + np.sum(rates))
    square = float(along @ along)

    def slope(length: float) -> float:
        return constant + square * length - 0.5 * weight * float(np.sum(rates / (1.0 + length * rates)))

    # Beyond the wall no body can be; without one the slope turns somewhere.
    wall = 1.0 / float(-rates.min()) if rates.size and rates.min() < 0.0 else np.inf
    low, high = 0.0, min(1.0, 0.5 * wall)
    while slope(high) < 0.0 and high < 1e6:
        low, high = high, min(2.0 * high, 0.5 * (high + wall))
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if slope(middle) < 0.0 else (low, middle)
    return low
