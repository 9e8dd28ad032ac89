"""Articulated-body dynamics with 60 digits (mpmath) from the definitions, independent of phipsi except for the input.

Everything is in the base frame, and only the kinematics is recursive: M = sum over links of J^T I J, and the torque
is the virtual work of the inertial, gravity and applied forces of each link. M = (1 + K) D (1 + K)^T, with 1 + K unit
upper triangular, is the Cholesky factorization from the last row, and L = 1 - (1 + K)^-1. Vectors are NumPy arrays of
mpf.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import mpmath
import numpy as np

import phipsi

DIGITS = 60
CONTEXT = mpmath.mp.clone()
CONTEXT.dps = DIGITS
mpf = CONTEXT.mpf

RATES = {"fixed": 0, "planar": 3, "spherical": 3, "floating": 6}
COORDINATES = {"fixed": 0, "planar": 3, "spherical": 4, "floating": 7}


@dataclass(frozen=True)
class Link:
    name: str
    mass: float
    com: np.ndarray
    inertia: np.ndarray


@dataclass(frozen=True)
class Joint:
    name: str
    kind: str
    parent: str
    child: str
    xyz: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    axis: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    pitch: float | None = None
    armature: float = 0.0

    @property
    def nv(self) -> int:
        return RATES.get(self.kind, 1)

    @property
    def nq(self) -> int:
        return COORDINATES.get(self.kind, 1)


@dataclass(frozen=True)
class Tree:
    """Links and joints in file order; the first link is the root."""

    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    floating_base: bool = False

    def scene(self) -> phipsi.Scene:
        """The scene that phipsi reads from it."""
        builder = phipsi.SceneBuilder()
        for link in self.links:
            builder.link(link.name, link.mass, link.com, link.inertia)
        for j in self.joints:
            builder.joint(
                j.name, j.kind, j.parent, j.child, xyz=j.xyz, rotation=j.rotation, axis=j.axis, pitch=j.pitch,
                armature=j.armature,
            )  # fmt: skip
        return builder.build(floating_base=self.floating_base, gravity=self.gravity)

    @cached_property
    def order(self) -> tuple[Joint, ...]:
        """All joints depth first, siblings in file order, preceded by the free joint of a floating base."""
        found: list[Joint] = []
        if self.floating_base:
            found.append(Joint("root_joint", "floating", "", self.links[0].name))

        def visit(link: str) -> None:
            for joint in self.joints:
                if joint.parent == link:
                    found.append(joint)
                    visit(joint.child)

        visit(self.links[0].name)
        return tuple(found)

    @property
    def nv(self) -> int:
        return sum(joint.nv for joint in self.order)


def exact(values: object) -> np.ndarray:
    """Exact conversion of doubles to mpf; mpf are unchanged."""
    if isinstance(values, np.ndarray) and values.dtype == object:
        return values
    doubles = np.asarray(values, dtype=float)
    return np.array([mpf(float(x)) for x in doubles.flat], dtype=object).reshape(doubles.shape)


def rounded(values: np.ndarray) -> np.ndarray:
    return np.array([float(x) for x in np.asarray(values, dtype=object).flat]).reshape(np.shape(values))


def zeros(*shape: int) -> np.ndarray:
    return np.full(shape, mpf(0), dtype=object)


def identity(n: int) -> np.ndarray:
    return np.array([[mpf(int(i == j)) for j in range(n)] for i in range(n)], dtype=object).reshape(n, n)


def skew(a: np.ndarray) -> np.ndarray:
    o = mpf(0)
    return np.array([[o, -a[2], a[1]], [a[2], o, -a[0]], [-a[1], a[0], o]], dtype=object)


def unit(a: np.ndarray) -> np.ndarray:
    return a / CONTEXT.sqrt(a @ a)


def turn(axis: np.ndarray, angle: object) -> np.ndarray:
    """Rodrigues' rotation about a unit axis."""
    s = skew(axis)
    return identity(3) + s * CONTEXT.sin(angle) + (s @ s) * (1 - CONTEXT.cos(angle))


def nearest_rotation(doubles: np.ndarray) -> np.ndarray:
    """The rotation nearest to a matrix of doubles, orthogonal to full precision, by Newton's iteration for the polar
    factor.
    """
    found = exact(doubles)
    for _ in range(3):
        found = found @ (3 * identity(3) - found.T @ found) / 2
    return found


def of_quaternion(q: np.ndarray) -> np.ndarray:
    """The rotation of (x, y, z, w), normalized."""
    v, w = unit(q)[:3], unit(q)[3]
    return identity(3) + 2 * w * skew(v) + 2 * (skew(v) @ skew(v))


def in_plane(normal: np.ndarray) -> np.ndarray:
    """Directions u, v of a planar joint, as columns: u is the projected coordinate axis with the smallest component
    along the normal.
    """
    least = min(range(3), key=lambda i: abs(normal[i]))
    e = identity(3)[least]
    u = unit(e - normal * (normal @ e))
    return np.stack([u, skew(normal) @ u], axis=1)


class State:
    """A tree at q and qd, doubles (exact) or mpf."""

    def __init__(self, tree: Tree, q: np.ndarray, qd: np.ndarray) -> None:
        self.tree, self.nv = tree, tree.nv
        self.gravity = exact(tree.gravity)
        q, qd = exact(q), exact(qd)
        self.qd = qd
        self.armature = zeros(self.nv)
        root = tree.links[0].name
        # By link: rotation, position, Jacobians (world) of both velocities, accelerations for qdd = 0.
        self.rotation, self.position = {"": identity(3)}, {"": zeros(3)}
        self.angular, self.linear = {"": zeros(3, self.nv)}, {"": zeros(3, self.nv)}
        self.angular_bias, self.linear_bias = {"": zeros(3)}, {"": zeros(3)}
        self.moves: dict[str, bool] = {}
        every = tree.order if tree.floating_base else (Joint("", "fixed", "", root), *tree.order)
        at_q = at_v = 0
        for joint in every:
            v = slice(at_v, at_v + joint.nv)
            self._add(joint, q[at_q : at_q + joint.nq], v)
            self.armature[v] = mpf(joint.armature)
            at_q, at_v = at_q + joint.nq, at_v + joint.nv
        assert (at_q, at_v) == (len(q), self.nv) and len(qd) == self.nv
        self.links = [link for link in tree.links if self.moves[link.name]]

    def _add(self, joint: Joint, q: np.ndarray, v: slice) -> None:
        parent, child = joint.parent, joint.child
        base = self.rotation[parent] @ nearest_rotation(joint.rotation)
        axis = unit(exact(joint.axis))
        turned, moved = identity(3), zeros(3)
        # Columns of the joint velocities: angular velocity in the child frame, linear velocity in the frame on the
        # parent side.
        spin, slide = zeros(3, joint.nv), zeros(3, joint.nv)
        match joint.kind:
            case "revolute" | "continuous":
                turned, spin[:, 0] = turn(axis, q[0]), axis
            case "prismatic":
                moved, slide[:, 0] = axis * q[0], axis
            case "screw":
                pitch = mpf(joint.pitch)
                turned, moved = turn(axis, q[0]), axis * (pitch * q[0])
                spin[:, 0], slide[:, 0] = axis, axis * pitch
            case "planar":
                plane = in_plane(axis)
                turned, moved = turn(axis, q[2]), plane @ q[:2]
                spin[:, 2], slide[:, :2] = axis, plane
            case "spherical":
                turned, spin = of_quaternion(q), identity(3)
            case "floating":
                turned, moved = of_quaternion(q[3:]), q[:3]
                slide[:, :3], spin[:, 3:] = turned, identity(3)
            case kind:
                assert kind == "fixed"
        rotation = base @ turned
        lever = base @ moved + self.rotation[parent] @ exact(joint.xyz)
        spin, slide = rotation @ spin, base @ slide
        self.rotation[child] = rotation
        self.position[child] = self.position[parent] + lever
        angular, linear = self.angular[parent].copy(), self.linear[parent] - skew(lever) @ self.angular[parent]
        angular[:, v] += spin
        linear[:, v] += slide
        self.angular[child], self.linear[child] = angular, linear

        omega, alpha = self.angular[parent] @ self.qd, self.angular_bias[parent]
        spun, slid = spin @ self.qd[v] + zeros(3), slide @ self.qd[v] + zeros(3)
        self.angular_bias[child] = alpha + skew(omega) @ spun
        # The directions of the velocities of a floating joint are constant in the rotating child frame; those of
        # other joints in the parent frame.
        turning = skew(spun) @ slid if joint.kind == "floating" else zeros(3)
        self.linear_bias[child] = (
            self.linear_bias[parent]
            + skew(alpha) @ lever
            + skew(omega) @ (skew(omega) @ lever + 2 * slid)
            + turning
        )
        self.moves[child] = bool(joint.nv) or self.moves.get(parent, False)

    def _inertia(self, link: Link) -> tuple[object, np.ndarray, np.ndarray, np.ndarray]:
        """Mass, offset of the center of mass, central inertia in the base frame, Jacobian of the center of mass."""
        rotation = self.rotation[link.name]
        lever = rotation @ exact(link.com)
        central = rotation @ exact(link.inertia) @ rotation.T
        return mpf(link.mass), lever, central, self.linear[link.name] - skew(lever) @ self.angular[link.name]

    @cached_property
    def mass_matrix(self) -> np.ndarray:
        total = identity(self.nv) * self.armature
        for link in self.links:
            mass, _, central, center = self._inertia(link)
            angular = self.angular[link.name]
            total = total + mass * (center.T @ center) + angular.T @ central @ angular
        return total

    @cached_property
    def bias_torque(self) -> np.ndarray:
        torque = zeros(self.nv)
        for link in self.links:
            mass, lever, central, center = self._inertia(link)
            omega, alpha = self.angular[link.name] @ self.qd, self.angular_bias[link.name]
            at_center = self.linear_bias[link.name] + skew(alpha) @ lever + skew(omega) @ (skew(omega) @ lever)
            moment = central @ alpha + skew(omega) @ (central @ omega)
            torque = torque + center.T @ (mass * (at_center - self.gravity)) + self.angular[link.name].T @ moment
        return torque

    def applied(self, wrenches: Mapping[str, np.ndarray]) -> np.ndarray:
        """Joint torques of wrenches (moment, force) on links, at their origins and in their frames."""
        torque = zeros(self.nv)
        for name, wrench in wrenches.items():
            moment, force = self.rotation[name] @ exact(wrench[:3]), self.rotation[name] @ exact(wrench[3:])
            torque = torque + self.angular[name].T @ moment + self.linear[name].T @ force
        return torque

    def inverse_dynamics(self, qdd: np.ndarray, wrenches: Mapping[str, np.ndarray]) -> np.ndarray:
        return self.mass_matrix @ exact(qdd) + self.bias_torque - self.applied(wrenches)

    def forward_dynamics(self, tau: np.ndarray, wrenches: Mapping[str, np.ndarray]) -> np.ndarray:
        return self.inverse @ (exact(tau) + self.applied(wrenches) - self.bias_torque)

    @cached_property
    def factors(self) -> tuple[np.ndarray, np.ndarray]:
        """(1 + K, diagonal of D), from the last row upward."""
        rest, upper, pivots = self.mass_matrix.copy(), identity(self.nv), zeros(self.nv)
        for j in reversed(range(self.nv)):
            pivots[j] = rest[j, j]
            upper[:j, j] = rest[:j, j] / pivots[j]
            rest[:j, :j] -= np.outer(upper[:j, j], rest[j, :j])
        return upper, pivots

    @cached_property
    def unit_inverse(self) -> np.ndarray:
        """(1 + K)^-1, by back substitution."""
        upper, found = self.factors[0], identity(self.nv)
        for i in reversed(range(self.nv)):
            found[i] -= upper[i, i + 1 :] @ found[i + 1 :] if i + 1 < self.nv else zeros(self.nv)
        return found

    @cached_property
    def inverse(self) -> np.ndarray:
        return self.unit_inverse.T @ (self.unit_inverse / self.factors[1][:, None])

    @property
    def log_det(self) -> object:
        return sum((CONTEXT.log(pivot) for pivot in self.factors[1]), mpf(0))

    @property
    def energy(self) -> tuple[object, object]:
        kinetic = (self.qd @ self.mass_matrix @ self.qd) / 2
        potential = mpf(0)
        for link in self.links:
            mass, lever, _, _ = self._inertia(link)
            potential -= mass * (self.gravity @ (self.position[link.name] + lever))
        return kinetic, potential

    @property
    def momentum(self) -> np.ndarray:
        """(angular about the base's origin, linear), in the base frame."""
        angular, linear = zeros(3), zeros(3)
        for link in self.links:
            mass, lever, central, center = self._inertia(link)
            push = mass * (center @ self.qd)
            linear = linear + push
            turning = central @ (self.angular[link.name] @ self.qd)
            angular = angular + turning + skew(self.position[link.name] + lever) @ push
        return np.concatenate([angular, linear])

    def jacobian(self, link: str) -> np.ndarray:
        """(angular, linear), at the link's origin and in its frame."""
        turn = self.rotation[link].T
        return np.concatenate([turn @ self.angular[link], turn @ self.linear[link]])

    def placement(self, link: str) -> np.ndarray:
        found = identity(4)
        found[:3, :3], found[:3, 3] = self.rotation[link], self.position[link]
        return found


KINDS = ("revolute", "prismatic", "continuous", "screw", "planar", "spherical", "floating", "fixed")


def random_tree(
    random: np.random.Generator,
    joints: int,
    *,
    kinds: Sequence[str] = KINDS,
    most: int = 12,
    branching: float = 0.4,
    armature: float = 0.0,
    gravity: tuple[float, float, float] = (0.3, -0.5, -9.6),
    floating_base: bool = False,
) -> Tree:
    """A tree of bodies of about 1 kg and 0.3 m with at most that many degrees of freedom; the joint types are used in
    shuffled order.
    """

    def rotation() -> np.ndarray:
        q, _ = np.linalg.qr(random.normal(size=(3, 3)))
        return q * np.sign(np.linalg.det(q))

    def link(name: str) -> Link:
        frame = rotation()
        a, b, c = random.uniform(0.01, 0.05, 3)
        inertia = frame @ np.diag([b + c, a + c, a + b]) @ frame.T
        return Link(name, random.uniform(0.5, 2.0), random.uniform(-0.3, 0.3, 3), 0.5 * (inertia + inertia.T))

    order = list(random.permutation(kinds))
    links, found = [link("base")], []
    room = most - 6 * floating_base
    for k in range(joints):
        kind = str(order[k % len(order)])
        if RATES.get(kind, 1) > room:
            continue
        room -= RATES.get(kind, 1)
        parent = links[random.integers(len(links))] if random.uniform() < branching else links[-1]
        found.append(
            Joint(
                f"joint{k}", kind, parent.name, f"link{k}", random.uniform(-0.5, 0.5, 3), rotation(), random.normal(size=3),
                0.2 if kind == "screw" else None,
                armature * random.uniform(0.1, 1.0) if kind != "fixed" and random.uniform() < 0.7 else 0.0,
            )  # fmt: skip
        )
        links.append(link(f"link{k}"))
    return Tree(tuple(links), tuple(found), gravity, floating_base)


STEP = mpf(10) ** -20
"""Step of central differences: a third of the digits for the step, a third for the truncation error."""


def moved(tree: Tree, q: np.ndarray, rate: np.ndarray, by: object) -> np.ndarray:
    """q moved along a velocity, to first order in the step (to second order in a central difference)."""
    found, at_q, at_v = q.copy(), 0, 0
    for joint in tree.order:
        here, v = found[at_q : at_q + joint.nq], rate[at_v : at_v + joint.nv] * by
        if joint.kind == "floating":
            here[:3] = here[:3] + of_quaternion(here[3:]) @ v[:3]
        if joint.kind in ("spherical", "floating"):
            quaternion, half = unit(here[-4:]), v[-3:] / 2
            here[-4:-1] = quaternion[:3] + quaternion[3] * half + skew(quaternion[:3]) @ half
            here[-1] = quaternion[3] - quaternion[:3] @ half
        else:
            here[:] = here + v
        at_q, at_v = at_q + joint.nq, at_v + joint.nv
    return found


def derivative(function: Callable[[object], object], at: object = 0) -> object:
    return (function(at + STEP) - function(at - STEP)) / (2 * STEP)
