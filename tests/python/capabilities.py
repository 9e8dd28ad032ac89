"""Capabilities on kinds of scenes: trees, mimic joints and loops, each with and without a contact 100 m out of reach.

The oracle is dense algebra on Jacobians from the definition, in NumPy: it reads nothing of phipsi. A mechanism has four
bodies on the joints x = (crank, coupler, pendulum, rocker). A scene has the coordinates q with x = G q + o, and motions
N u of q: all of them, or those that the pin between coupler and rocker allows.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np
import phipsi
from phipsi.estimation import Encoder, MotionUncertainty
from scipy.stats import chi2
from tolerances import assert_near, assert_same_bits, slope_of_order_4

KINDS = ("tree", "mimic", "loop")
FAR = 100.0
"""Distance of the contact out of reach, m."""
GRAVITY = np.array([0.0, 0.0, -9.81])
STEP = 1e-3
"""Step of differences of fourth order: 11 digits of a smooth function, 8 of its derivatives."""


class Body(NamedTuple):
    """A body on a revolute joint."""

    name: str
    parent: int
    xyz: tuple[float, float, float]
    axis: tuple[float, float, float]
    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float]
    armature: float


BODIES = (
    Body("crank", -1, (0, 0, 0), (0, 1, 0), 1.0, (0.01, 0.01, 0.08), (0.01, 0.012, 0.003), 0.01),
    Body("coupler", 0, (0, 0, 0.2), (0, 1, 0), 0.8, (0.02, 0.0, 0.16), (0.011, 0.012, 0.004), 0.0),
    Body("pendulum", 1, (0, 0.05, 0.2), (0.6, 0.0, 0.8), 0.5, (0.1, 0.05, -0.1), (0.004, 0.003, 0.002), 0.02),
    Body("rocker", -1, (0.3, 0, 0), (0, 1, 0), 1.2, (-0.01, 0.0, 0.12), (0.012, 0.014, 0.003), 0.0),
)
#: The pin of the loop, on coupler and rocker.
PIN = ((1, np.array([0, 0, 0.4])), (3, np.array([0, 0, 0.3])))
MULTIPLIER, OFFSET = -0.5, 0.1
N = len(BODIES)
ENTRIES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


def skew(a: np.ndarray) -> np.ndarray:
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def slope(function: Callable[[float], Any], step: float = STEP) -> np.ndarray:
    """A derivative at zero by central differences of fourth order."""
    return np.asarray(slope_of_order_4(function, step))


class Tree:
    """Kinematics of all bodies in the base frame, from the definition, and what follows from it by virtual work."""

    def __init__(self, x: np.ndarray, xd: np.ndarray) -> None:
        self.xd, at = xd, {-1: (np.eye(3), np.zeros(3), np.zeros((3, N)), np.zeros((3, N)), np.zeros(3), np.zeros(3))}
        for k, body in enumerate(BODIES):
            rotation, position, angular, linear, alpha, accel = at[body.parent]
            axis, lever = rotation @ np.array(body.axis), rotation @ np.array(body.xyz)
            s, omega = skew(np.array(body.axis)), angular @ xd
            turned = rotation @ (np.eye(3) + np.sin(x[k]) * s + (1 - np.cos(x[k])) * (s @ s))
            linear, accel = linear - skew(lever) @ angular, accel + skew(alpha) @ lever + skew(omega) @ (skew(omega) @ lever)
            alpha = alpha + skew(omega) @ axis * xd[k]
            angular = angular + np.outer(axis, np.eye(N)[k])
            at[k] = (turned, position + lever, angular, linear, alpha, accel)
        self.at = at

    @cached_property
    def mass_matrix(self) -> np.ndarray:
        total = np.diag([body.armature for body in BODIES])
        for k, body in enumerate(BODIES):
            rotation, _, angular, linear, _, _ = self.at[k]
            center = linear - skew(rotation @ np.array(body.com)) @ angular
            total = total + body.mass * center.T @ center + angular.T @ rotation @ np.diag(body.inertia) @ rotation.T @ angular
        return total

    def regressor(self, xdd: np.ndarray) -> np.ndarray:
        """Derivative of the joint torques by the parameters of each body, (N, bodies, 10)."""
        found = np.empty((N, N, 10))
        for k in range(N):
            rotation, _, angular, linear, alpha, accel = self.at[k]
            omega, alpha, accel = angular @ self.xd, angular @ xdd + alpha, linear @ xdd + accel - GRAVITY
            spin = skew(alpha) + skew(omega) @ skew(omega)
            found[:, k, 0] = linear.T @ accel
            for i in range(3):
                h = rotation[:, i]
                found[:, k, 1 + i] = linear.T @ (spin @ h) + angular.T @ np.cross(h, accel)
            for p, (i, j) in enumerate(ENTRIES):
                unit = np.zeros((3, 3))
                unit[i, j] = unit[j, i] = 1.0
                inertia = rotation @ unit @ rotation.T
                found[:, k, 4 + p] = angular.T @ (inertia @ alpha + np.cross(omega, inertia @ omega))
        return found

    @cached_property
    def bias(self) -> np.ndarray:
        torque = np.zeros(N)
        for k, body in enumerate(BODIES):
            rotation, _, angular, linear, alpha, accel = self.at[k]
            com, omega, inertia = rotation @ np.array(body.com), angular @ self.xd, rotation @ np.diag(body.inertia) @ rotation.T
            force = body.mass * (accel + skew(alpha) @ com + skew(omega) @ (skew(omega) @ com) - GRAVITY)
            torque += (linear - skew(com) @ angular).T @ force + angular.T @ (inertia @ alpha + skew(omega) @ (inertia @ omega))
        return torque

    def point(self, k: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position of a point of a body, its Jacobian, and its acceleration without joint accelerations."""
        rotation, position, angular, linear, alpha, accel = self.at[k]
        lever, omega = rotation @ at, angular @ self.xd
        return position + lever, linear - skew(lever) @ angular, accel + skew(alpha) @ lever + skew(omega) @ (skew(omega) @ lever)


def parameters_of(body: Body) -> np.ndarray:
    com = np.array(body.com)
    inertia = np.diag(body.inertia) + body.mass * (com @ com * np.eye(3) - np.outer(com, com))
    return np.array([body.mass, *(body.mass * com), *(inertia[i, j] for i, j in ENTRIES)])


PARAMETERS = np.array([parameters_of(body) for body in BODIES])


def build(kind: str, far: bool, **joint: dict[str, Any]) -> phipsi.Scene:
    """The scene of a kind; `joint`: more properties of joints by name."""
    builder = phipsi.SceneBuilder().link("ground")
    for body in BODIES:
        builder.link(body.name, body.mass, body.com, np.diag(body.inertia))
        mimic = {"mimic": "crank", "mimic_multiplier": MULTIPLIER, "mimic_offset": OFFSET} if (kind, body.name) == ("mimic", "rocker") else {}
        parent = "ground" if body.parent < 0 else BODIES[body.parent].name
        kinds = {"lower": -20.0, "upper": 20.0, "effort": 1e3, "velocity": 1e3} | joint.get(body.name, {})
        builder.joint(body.name, "revolute", parent, body.name, xyz=body.xyz, axis=body.axis, armature=body.armature, **kinds, **mimic)
    if kind == "loop":
        builder.connect("pin", "axis", "coupler", "rocker", xyz=PIN[0][1], other_xyz=PIN[1][1], axis=(0, 1, 0))
    if far:
        builder.contact("far", "pendulum", xyz=(0.1, 0.05, 0.02), friction=0.5, offset=-FAR)
    return builder.build(mimic="couple" if kind == "mimic" else None)


class Case:
    """A kind of scene, its oracle, and a state."""

    def __init__(self, kind: str, far: bool) -> None:
        self.kind, self.far = kind, far
        self.scene, self.plain = build(kind, far), build(kind, False)
        self.g, self.o = np.eye(N), np.zeros(N)
        if kind == "mimic":
            self.g, self.o = np.vstack([np.eye(3), [MULTIPLIER, 0, 0]]), np.array([0, 0, 0, OFFSET])
        self.nv = self.g.shape[1]
        self.free = 2 if kind == "loop" else self.nv
        u, ud = np.array([0.5, 0.8, 0.4, 0.2]), np.array([0.7, -0.4, 0.9, 0.3])
        if kind == "loop":
            u, ud = u[[0, 2]], ud[[0, 2]]
        self.u, self.ud = u[: self.free], ud[: self.free]
        self.q, self.qd = self.state(self.u, self.ud)
        self.tau, self.qdd = np.array([0.4, -0.3, 0.2, 0.1])[: self.nv], np.array([0.5, -1.0, 0.7, 0.3])[: self.nv]

    def value(self, call: Callable[[phipsi.Scene], Any]) -> Any:
        """The result of a call; with a contact out of reach, the bits are those without it."""
        found = call(self.scene)
        if self.far:
            for mine, other in zip(_arrays(found), _arrays(call(self.plain)), strict=True):
                assert_same_bits(mine, other)
        return found

    # The oracle

    def tree(self, q: np.ndarray, qd: np.ndarray) -> Tree:
        return Tree(self.g @ q + self.o, self.g @ qd)

    def rows(self, tree: Tree) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Error of the pin, its Jacobian, and its acceleration without joint accelerations, in the plane."""
        (first, a, b), (second, c, d) = (tree.point(k, at) for k, at in PIN)
        return (first - second)[[0, 2]], (a - c)[[0, 2]] @ self.g, (b - d)[[0, 2]]

    def motions(self, q: np.ndarray) -> np.ndarray:
        """N, (nv, free): the motions of crank and pendulum in a loop, else all."""
        if self.kind != "loop":
            return np.eye(self.nv)
        return _null_space(self.rows(self.tree(q, np.zeros(self.nv)))[1])

    def state(self, u: np.ndarray, ud: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates and velocities for those of the independent motions."""
        if self.kind != "loop":
            return np.array(u), np.array(ud)
        # The pin is where two circles meet: the tip of the crank and the foot of the rocker are its distances away.
        (_, (lx, lz)), (_, (fx, fz)) = ((0.0, (0.2 * np.sin(u[0]), 0.2 * np.cos(u[0]))), (0.0, (0.3, 0.0)))
        x, z = fx - lx, fz - lz
        square = x * x + z * z
        along = (square + 0.4**2 - 0.3**2) / (2 * square)
        across = np.sqrt(0.4**2 / square - along * along)
        px, pz = lx + along * x - across * z, lz + along * z + across * x
        q = np.array([u[0], np.arctan2(px - lx, pz - lz) - u[0], u[1], np.arctan2(px - fx, pz - fz)])
        return q, self.motions(q) @ ud

    def forward(self, q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Accelerations by elimination of the forces of the pin: the motions N solve N* M N a = N*(tau - h - M b)."""
        tree = self.tree(q, qd)
        mass, bias = self.g.T @ tree.mass_matrix @ self.g, self.g.T @ tree.bias
        if self.kind != "loop":
            return np.linalg.solve(mass, tau - bias)
        _, jacobian, drift = self.rows(tree)
        motions, known = _null_space(jacobian), -np.linalg.pinv(jacobian) @ drift
        return known + motions @ np.linalg.solve(motions.T @ mass @ motions, motions.T @ (tau - bias - mass @ known))

    def inverse(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        tree = self.tree(q, qd)
        return self.g.T @ (tree.mass_matrix @ self.g @ qdd + tree.bias)

    def mass(self, q: np.ndarray) -> np.ndarray:
        return self.g.T @ self.tree(q, np.zeros(self.nv)).mass_matrix @ self.g

    def mass_inverse(self, q: np.ndarray) -> np.ndarray:
        """Accelerations by torques: N (N* M N)^-1 N*."""
        motions = self.motions(q)
        return motions @ np.linalg.solve(motions.T @ self.mass(q) @ motions, motions.T)

    def regressor(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return np.einsum("ij,ikp->jkp", self.g, self.tree(q, qd).regressor(self.g @ qdd))

    def energy(self, q: np.ndarray, qd: np.ndarray) -> float:
        tree = self.tree(q, qd)
        height = sum(body.mass * tree.point(k, np.array(body.com))[0][2] for k, body in enumerate(BODIES))
        return float(0.5 * qd @ self.mass(q) @ qd + 9.81 * height)

    def run(self, u: np.ndarray, ud: np.ndarray, tau: np.ndarray, duration: float, steps: int) -> np.ndarray:
        """(u, ud) at the end, by the classical method of order 4 in independent coordinates."""
        pick = [0, 2] if self.kind == "loop" else list(range(self.nv))

        def rate(x: np.ndarray) -> np.ndarray:
            q, qd = self.state(x[: self.free], x[self.free :])
            return np.concatenate([x[self.free :], self.forward(q, qd, tau)[pick]])

        x, h = np.concatenate([u, ud]), duration / steps
        for _ in range(steps):
            a = rate(x)
            b = rate(x + 0.5 * h * a)
            c = rate(x + 0.5 * h * b)
            x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c))
        return x

    def path(self, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, dt: float) -> np.ndarray:
        """(q, qd) at the start of each step under the torques tau (steps, nv), by the same method at a quarter of dt."""
        pick, found = [0, 2] if self.kind == "loop" else list(range(self.nv)), []
        x = np.concatenate([q[pick], qd[pick]])
        for torque in tau:
            found.append(np.concatenate(self.state(x[: self.free], x[self.free :])))
            x = self.run(x[: self.free], x[self.free :], torque, dt, 4)
        return np.array(found)

    def end(self, duration: float, steps: int, change: np.ndarray | float = 0.0, tau: np.ndarray | None = None) -> np.ndarray:
        """(q, qd) at the end of a motion whose start is changed by (u, ud)."""
        x = np.concatenate([self.u, self.ud]) + change
        found = self.run(x[: self.free], x[self.free :], self.tau if tau is None else tau, duration, steps)
        return np.concatenate(self.state(found[: self.free], found[self.free :]))


def _null_space(jacobian: np.ndarray) -> np.ndarray:
    """Motions of the loop for unit velocities of crank and pendulum."""
    found = np.zeros((N, 2))
    found[0, 0] = found[2, 1] = 1.0
    found[[1, 3]] = -np.linalg.solve(jacobian[:, [1, 3]], jacobian[:, [0, 2]])
    return found


def _arrays(found: Any) -> list[np.ndarray]:
    if isinstance(found, dict):
        return [array for key in sorted(found) for array in _arrays(found[key])]
    if isinstance(found, tuple | list):
        return [array for part in found for array in _arrays(part)]
    return [] if found is None else [np.asarray(found, float)]


def _scaled(found: Any, expected: Any, bound: float) -> None:
    assert_near(found, expected, bound * max(1.0, float(np.max(np.abs(expected), initial=0.0))))


# Functions of one state


def forward_dynamics(c: Case) -> None:
    _scaled(c.value(lambda s: s.forward_dynamics(c.q, c.qd, c.tau)), c.forward(c.q, c.qd, c.tau), 1e-12)


def inverse_dynamics(c: Case) -> None:
    _scaled(c.value(lambda s: s.inverse_dynamics(c.q, c.qd, c.qdd)), c.inverse(c.q, c.qd, c.qdd), 1e-13)


def mass_matrix(c: Case) -> None:
    _scaled(c.value(lambda s: s.mass_matrix(c.q)), c.mass(c.q), 1e-13)
    _scaled(c.value(lambda s: s.mass_matrix_inverse(c.q)), np.linalg.inv(c.mass(c.q)), 1e-12)
    if c.kind == "loop":
        _scaled(c.value(lambda s: s.loops.mass_matrix_inverse(c.q)), c.mass_inverse(c.q), 1e-12)


def _along(c: Case, third: np.ndarray, d: np.ndarray) -> Callable[[float], np.ndarray]:
    """States (q, qd, third) along a direction of (u, ud, third): curves that satisfy the pin."""

    def at(by: float) -> np.ndarray:
        q, qd = c.state(c.u + by * d[: c.free], c.ud + by * d[c.free : 2 * c.free])
        return np.array([q, qd, third + by * d[2 * c.free :]])

    return at


def _functions(c: Case) -> tuple[tuple[str, Callable[..., np.ndarray], np.ndarray], ...]:
    return ("forward", c.forward, c.tau), ("inverse", c.inverse, c.qdd)


def derivatives(c: Case) -> None:
    for name, function, third in _functions(c):
        found = c.value(lambda s, name=name, third=third: getattr(s, f"{name}_dynamics_derivatives")(c.q, c.qd, third))
        for d in np.eye(2 * c.free + c.nv):
            at = _along(c, third, d)
            along = sum(matrix @ x for matrix, x in zip(found, slope(at), strict=True))
            _scaled(along, slope(lambda by, at=at, function=function: function(*at(by))), 1e-7)
        if name == "forward":
            a, b = c.value(lambda s: s.linearize(c.q, c.qd, c.tau))
            _scaled(a, np.block([[np.zeros((c.nv, c.nv)), np.eye(c.nv)], [found[0], found[1]]]), 1e-12)
            _scaled(b, np.concatenate([np.zeros((c.nv, c.nv)), found[2]]), 1e-12)


def products(c: Case) -> None:
    random = np.random.default_rng(1)
    for name, function, third in _functions(c):
        at, back = _along(c, third, random.normal(size=2 * c.free + c.nv)), random.normal(size=c.nv)
        expected, d = slope(lambda by, at=at, function=function: function(*at(by))), slope(at)
        _scaled(c.value(lambda s, name=name, third=third, d=d: getattr(s, f"{name}_dynamics_jvp")(c.q, c.qd, third, *d)), expected, 1e-7)
        found = c.value(lambda s, name=name, third=third, back=back: getattr(s, f"{name}_dynamics_vjp")(c.q, c.qd, third, back)[:3])
        _scaled(np.sum(np.array(found) * d), back @ expected, 1e-7)


def hessian_products(c: Case) -> None:
    """The second derivative of back . f along a curve x(s) is x' . (Hessian x') + gradient . x''."""
    random = np.random.default_rng(2)
    for name, function, third in _functions(c):
        for _ in range(3):
            at, back = _along(c, third, random.normal(size=2 * c.free + c.nv)), random.normal(size=c.nv)
            d, turned = slope(at), slope(lambda by, at=at: slope(lambda h: at(by + h)))
            twice = slope(lambda by, at=at, f=function, back=back: slope(lambda h: back @ f(*at(by + h)), 3e-3), 3e-3)
            gradient = getattr(c.scene, f"{name}_dynamics_vjp")(c.q, c.qd, third, back)[:3]
            found = c.value(lambda s, name=name, third=third, back=back, d=d: getattr(s, f"{name}_dynamics_hvp")(c.q, c.qd, third, back, *d)[:3])
            _scaled(np.sum(np.array(found) * d) + np.sum(np.array(gradient) * turned), twice, 1e-6)


def operational_inertia(c: Case) -> None:
    point, directions = np.array([0.1, 0.0, 0.05]), np.eye(6)[[4, 5]]
    tree = c.tree(c.q, c.qd)
    rotation, (_, linear, _) = tree.at[2][0], tree.point(2, point)
    jacobian = np.concatenate([rotation.T @ tree.at[2][2], rotation.T @ linear]) @ c.g
    expected = jacobian @ c.mass_inverse(c.q) @ jacobian.T
    _scaled(c.value(lambda s: s.operational_inverse_inertia(c.q, "pendulum", at=point)), expected, 1e-11)
    found = c.value(lambda s: s.operational_inertia(c.q, "pendulum", at=point, directions=directions))
    _scaled(found, np.linalg.inv(directions @ expected @ directions.T), 1e-10)


def inverse_kinematics(c: Case) -> None:
    wanted, _ = c.state(c.u + 0.1, c.ud)
    target = c.tree(wanted, c.qd).point(2, np.zeros(3))[0]
    found = c.value(lambda s: s.inverse_kinematics(phipsi.tasks.Position("pendulum", target), c.q, seed=1).q)
    tree = c.tree(found, c.qd)
    assert_near(tree.point(2, np.zeros(3))[0], target, 1e-8)
    if c.kind == "loop":
        assert_near(c.rows(tree)[0], np.zeros(2), 1e-8)


def batches(c: Case) -> None:
    states = [c.state(c.u + 0.02 * k, c.ud + 0.1 * k) for k in range(11)]
    q, qd = (np.array(part) for part in zip(*states, strict=True))
    whole = c.value(lambda s: s.forward_dynamics(q, qd, c.tau))
    path = c.value(lambda s: s.simulate(q, qd, tau=c.tau, dt=2e-3, steps=20).q)
    for k in range(11):
        assert_near(whole[k], c.scene.forward_dynamics(q[k], qd[k], c.tau), 1e-12 * float(np.max(np.abs(whole))))
        assert_near(path[k], c.scene.simulate(q[k], qd[k], tau=c.tau, dt=2e-3, steps=20).q, 1e-12)


def compiled(c: Case) -> None:
    code = phipsi.compile(c.scene, ["forward_dynamics", "inverse_dynamics"])
    _scaled(code.forward_dynamics(c.q, c.qd, c.tau), c.forward(c.q, c.qd, c.tau), 1e-11)
    _scaled(code.inverse_dynamics(c.q, c.qd, c.qdd), c.inverse(c.q, c.qd, c.qdd), 1e-12)


# Motion


METHODS = {"auto": 4, "rk4": 4, "semi-implicit-euler": 1, "implicit-euler": 1, "rosenbrock-2": 2, "rosenbrock-3": 3, "dormand-prince-5": 5}
DURATION = 0.1


def _run(c: Case, steps: int, **more: Any) -> np.ndarray:
    """(q, qd) at the end of a simulation of DURATION, with the bits of the scene without the contact."""

    def call(scene: phipsi.Scene) -> tuple[np.ndarray, np.ndarray]:
        path = scene.simulate(c.q, c.qd, tau=c.tau, dt=DURATION / steps, steps=steps, **more)
        return path.q, path.qd

    q, qd = c.value(call)
    return np.concatenate([q[-1], qd[-1]])


@cache
def _exact(kind: str) -> np.ndarray:
    return Case(kind, False).end(DURATION, 150)


def simulation(c: Case) -> None:
    """Every method converges with its order; "auto" has order 4."""
    for method, order in METHODS.items():
        steps = 10 if order == 5 else 40
        coarse, fine = (float(np.max(np.abs(_run(c, factor * steps, method=method) - _exact(c.kind)))) for factor in (1, 2))
        assert fine < 5e-2, (method, coarse, fine)
        assert np.log2(coarse / fine) > order - 0.4 or fine < 1e-9, (method, coarse, fine)


def error_control(c: Case) -> None:
    assert_near(_run(c, 4, accuracy=1e-9), _exact(c.kind), 1e-7)


def dry_friction(c: Case) -> None:
    """Friction holds what it can, bit by bit; what it cannot hold comes to rest and stays there."""
    still = np.zeros(c.nv)
    holding = 1.5 * np.abs(c.inverse(c.q, still, still)) + 0.2
    q, qd = c.value(lambda s: _states(s.simulate(c.q, still, dt=5e-3, steps=200, friction=holding)))
    assert np.array_equal(q, np.tile(c.q, (201, 1))) and not qd.any(), f"sinks by {np.abs(q - c.q).max():.1e} rad in 1 s"
    q, qd = c.value(lambda s: _states(s.simulate(c.q, c.qd, dt=5e-3, steps=200, friction=2 * holding)))
    assert np.abs(q[-1] - c.q).max() > 1e-3 and not qd[-100:].any() and np.array_equal(q[-100], q[-1])


def stops(c: Case) -> None:
    """A stop is not exceeded, and its impulse is that of a rebound: (1 + e) speed = impulse (M^-1)_jj."""
    ahead = (c.end(0.2, 20, tau=np.zeros(c.nv)) - np.concatenate([c.q, c.qd]))[1]
    bound = float(c.q[1] + 0.5 * ahead)
    limits = {"upper" if ahead > 0 else "lower": bound}
    scenes = {far: build(c.kind, far, coupler=limits) for far in {False, c.far}}
    for restitution in (0.0, 0.5):
        paths = {far: scene.simulate(c.q, c.qd, dt=1e-3, steps=300, restitution=restitution) for far, scene in scenes.items()}
        path = paths[c.far]
        assert_same_bits(path.q, paths[False].q)
        beyond = float(np.max((path.q[:, 1] - bound) * np.sign(ahead)))
        assert beyond <= 1e-12, f"exceeds the stop by {beyond:.1e} rad"
        impact = path.stops[0]
        q = path.q[int(np.round(impact.time / 1e-3))]
        expected = (1 + restitution) * impact.speed / c.mass_inverse(q)[1, 1]
        assert impact.joint == "coupler"
        assert abs(abs(impact.impulse) - expected) < 0.05 * expected, f"restitution {restitution}: impulse {impact.impulse:.3g}, expected {expected:.3g}"


def energy(c: Case) -> None:
    """A passive motion conserves the energy of the oracle."""
    q, qd = c.value(lambda s: _states(s.simulate(c.q, c.qd, dt=2e-3, steps=500, record_every=25)))
    total = np.array([c.energy(*row) for row in zip(q, qd, strict=True)])
    kinetic = max(0.5 * b @ c.mass(a) @ b for a, b in zip(q, qd, strict=True))
    assert np.ptp(total) < 1e-5 * kinetic, f"changes by {np.ptp(total) / kinetic:.1e} of the kinetic energy"


def gradients(c: Case) -> None:
    """The gradient of a function of the end of a simulation, along changes that the pin allows."""
    weights, steps = np.random.default_rng(3).normal(size=(2, c.nv)), 25

    def call(scene: phipsi.Scene) -> tuple[np.ndarray, ...]:
        path = scene.simulate(c.q, c.qd, tau=c.tau, dt=2e-3, steps=steps)
        by_q, by_qd = np.zeros((2, steps + 1, c.nv))
        by_q[-1], by_qd[-1] = weights
        found = path.vjp(by_q, by_qd)
        return found.q, found.qd, found.tau

    # With a contact out of reach the reverse sweep has other rounding errors, so that bits are not compared.
    found = np.array(call(c.scene))
    for d in np.random.default_rng(4).normal(size=(2, 2 * c.free + c.nv)):
        change, by_tau = d[: 2 * c.free], d[2 * c.free :]
        expected = slope(lambda by, change=change, by_tau=by_tau: weights.ravel() @ c.end(2e-3 * steps, steps, by * change, c.tau + by * by_tau))
        _scaled(np.sum(found * slope(_along(c, c.tau, d))), expected, 1e-6)


def bands(c: Case) -> None:
    """The covariance of the start, propagated to the end."""
    directions = 1e-3 * np.random.default_rng(5).normal(size=(3, 2 * c.free))
    start = np.array([slope(_along(c, c.tau, np.append(d, np.zeros(c.nv))))[:2].ravel() for d in directions])

    def call(scene: phipsi.Scene) -> np.ndarray:
        unsure = MotionUncertainty(initial=start.T @ start)
        return scene.simulate(c.q, c.qd, tau=c.tau, dt=2e-3, steps=25, covariance=unsure).bands.covariance[-1]

    end = np.array([slope(lambda by, d=d: c.end(0.05, 25, by * d)) for d in directions])
    expected = end.T @ end
    # As for gradients, a contact out of reach changes the rounding errors.
    found = call(c.scene)
    assert_near(found, expected, 1e-6 * float(np.max(np.abs(expected))))
    assert_near(found, call(c.plain), 1e-12 * float(np.max(np.abs(expected))))


# Parameters and estimation


def regressor(c: Case) -> None:
    _scaled(c.value(lambda s: s.regressor(c.q, c.qd, c.qdd)), c.regressor(c.q, c.qd, c.qdd), 1e-12)


def _moving(c: Case, count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random states with accelerations that the pin allows."""
    random = np.random.default_rng(seed)
    states = []
    for _ in range(count):
        q, qd = c.state(c.u + 0.6 * random.uniform(-1, 1, c.free), random.normal(size=c.free))
        qdd = c.motions(q) @ random.normal(size=c.free)
        if c.kind == "loop":
            _, jacobian, drift = c.rows(c.tree(q, qd))
            qdd = qdd - np.linalg.pinv(jacobian) @ drift
        states.append((q, qd, qdd))
    q, qd, qdd = (np.array(part) for part in zip(*states, strict=True))
    return q, qd, qdd


def identification(c: Case) -> None:
    """Torques of another robot identify it; in a loop, its pin carries arbitrary forces during the measurement."""
    random, noise = np.random.default_rng(6), 1e-3
    true = np.array([parameters_of(body._replace(mass=(1.0 + 0.1 * k) * body.mass, com=np.array(body.com) + 0.01)) for k, body in enumerate(BODIES)])
    armature = c.g.T @ np.diag([body.armature for body in BODIES]) @ c.g

    def torques(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, theta: np.ndarray) -> np.ndarray:
        return np.einsum("ikp,kp->i", c.regressor(q, qd, qdd), theta) + armature @ qdd

    motion = _moving(c, 150, 7)
    tau = np.array([torques(*row, true) for row in zip(*motion, strict=True)])
    if c.kind == "loop":
        tau += np.array([random.normal(size=2) @ c.rows(c.tree(q, qd))[1] for q, qd, _ in zip(*motion, strict=True)])
    tau += noise * random.normal(size=tau.shape)
    found = c.value(lambda s: s.identify(*motion, tau, noise=noise).parameters)
    errors = []
    for theta in (c.scene.inertial_parameters, found):
        off = [c.motions(row[0]).T @ (torques(*row, theta) - torques(*row, true)) for row in zip(*_moving(c, 20, 8), strict=True)]
        errors.append(float(np.sqrt(np.mean(np.square(off)))))
    assert errors[1] < 2 * noise < 0.1 * errors[0], errors


def variances(c: Case) -> None:
    random = np.random.default_rng(9)
    root = random.normal(size=(N, 10, 10)) * np.array([0.1, 0.02, 0.02, 0.02, *(0.005 * np.ones(6))])[:, None]
    sigma, torque = root @ root.transpose(0, 2, 1), random.uniform(0.0, 0.1, c.nv)

    def spread(qdd: np.ndarray) -> np.ndarray:
        y = c.regressor(c.q, c.qd, qdd)
        return np.einsum("ikp,kpr,jkr->ij", y, sigma, y) + np.diag(torque)

    inverse = c.mass_inverse(c.q)
    expected = np.diag(inverse @ spread(c.forward(c.q, c.qd, c.tau)) @ inverse.T)
    _scaled(c.value(lambda s: s.forward_dynamics_variance(c.q, c.qd, c.tau, parameters=sigma, torque=torque)), expected, 1e-10)
    _scaled(c.value(lambda s: s.inverse_dynamics_variance(c.q, c.qd, c.qdd, parameters=sigma, torque=torque)), np.diag(spread(c.qdd)), 1e-11)


def momentum_observer(c: Case) -> None:
    """The external torque of a motion, as far as it acts on motions that the pin allows."""
    external, steps, dt = 2.0 * np.array([0.5, -0.8, 0.4, 0.3])[: c.nv], 200, 1e-3
    damped = {"damping": 0.2}
    for pushed in (external, np.zeros(c.nv)):
        path = c.plain.simulate(c.q, np.zeros(c.nv), tau=c.tau + pushed, dt=dt, steps=steps, **damped)

        def call(scene: phipsi.Scene, path: phipsi.Trajectory = path) -> tuple[np.ndarray, bool]:
            observer = scene.momentum_observer(dt, torque_noise=1e-4, bandwidth=200.0)
            for q, qd in zip(path.q, path.qd, strict=True):
                found = observer.step(q, qd, c.tau - 0.2 * qd)
            return found.joint_torque, np.array(found.alarm)

        found, alarm = c.value(call)
        motions = c.motions(path.q[-1])
        expected = motions @ np.linalg.lstsq(motions, pushed, rcond=None)[0]
        assert bool(alarm) == bool(pushed.any())
        assert_near(found, expected, 0.05 * float(np.max(np.abs(external))))


def sensor_observer(c: Case) -> None:
    """Errors of many robots have the covariance that the observer states."""
    random, robots, steps, dt, density = np.random.default_rng(10), 30, 12, 4e-3, 1e-3
    motions = c.motions(c.q)
    spread = motions @ np.linalg.cholesky(np.linalg.inv(motions.T @ motions))
    pick = [0, 2] if c.kind == "loop" else list(range(c.nv))
    start = [c.state(c.u + (spread @ (0.01 * random.normal(size=c.free)))[pick], np.zeros(c.free))[0] for _ in range(robots)]
    rates = (spread @ (0.05 * random.normal(size=(c.free, robots)))).T
    rates = np.array([c.motions(q) @ qd[pick] for q, qd in zip(start, rates, strict=True)])
    pushes = c.tau + np.sqrt(density / dt) * random.normal(size=(robots, steps, c.nv))
    paths = np.array([c.path(q, qd, tau, dt) for q, qd, tau in zip(start, rates, pushes, strict=True)])
    readings = paths[..., : c.nv] + 1e-3 * random.normal(size=(robots, steps, c.nv))

    def call(scene: phipsi.Scene) -> tuple[np.ndarray, ...]:
        start = np.tile(c.q, (robots, 1))
        observer = scene.observer(dt, [Encoder(noise=1e-3)], q=start, torque_noise=density, initial=(0.01, 0.05))
        for k in range(steps):
            found = observer.step(np.tile(c.tau, (robots, 1)), {"encoder": readings[:, k]})
        return found.q, found.qd, found.covariance

    q, qd, covariance = c.value(call)
    rows = [*pick, *(c.nv + at for at in pick)]
    errors = (np.concatenate([q, qd], axis=-1) - paths[:, -1])[:, rows]
    total = sum(e @ np.linalg.solve(p[np.ix_(rows, rows)], e) for e, p in zip(errors, covariance, strict=True))
    low, high = chi2.ppf([1e-4, 1 - 1e-4], errors.size)
    assert low < total < high, (low, total, high)
    if c.kind == "loop":
        assert max(np.max(np.abs(c.rows(c.tree(x, np.zeros(N)))[0])) for x in q) < 1e-6


def _states(path: phipsi.Trajectory) -> tuple[np.ndarray, np.ndarray]:
    return path.q, path.qd


#: The capabilities, in the order of the table.
CELLS: dict[str, Callable[[Case], None]] = {
    "forward dynamics": forward_dynamics,
    "inverse dynamics": inverse_dynamics,
    "mass matrix and its inverse": mass_matrix,
    "derivatives, linearization": derivatives,
    "products of derivatives (vjp, jvp)": products,
    "products of Hessians (hvp)": hessian_products,
    "operational inertia": operational_inertia,
    "inverse kinematics": inverse_kinematics,
    "batches": batches,
    "compiled functions": compiled,
    "simulation, every method with its order": simulation,
    "error control (`accuracy=`)": error_control,
    "exact dry friction": dry_friction,
    "joint stops, restitution": stops,
    "conservation of energy": energy,
    "gradient of a simulation": gradients,
    "covariance of a simulation": bands,
    "regressor": regressor,
    "identification": identification,
    "variances of accelerations and torques": variances,
    "momentum observer": momentum_observer,
    "sensor observer": sensor_observer,
}

#: Cells that do not hold, by capability, kind and contact: "refused: " and a part of the message, or "does not hold: "
#: and the reason.
EXCEPTIONS: dict[str, dict[tuple[str, bool], str]] = {}


def outcome(capability: str, kind: str, far: bool) -> str:
    """The cell of the table: "holds", "refused: ..." or "does not hold: ..."."""
    return EXCEPTIONS.get(capability, {}).get((kind, far), "holds")


def table() -> list[str]:
    """Lines of the table, and the number of cells that hold."""
    columns = [(kind, far) for kind in KINDS for far in (False, True)]
    cells = {name: [outcome(name, *column) for column in columns] for name in CELLS}
    holds = sum(cell == "holds" for row in cells.values() for cell in row)
    heads = [f"{kind}{', contact out of reach' if far else ''}" for kind, far in columns]
    return [
        f"{holds} of {len(CELLS) * len(columns)} cells hold.",
        "",
        f"| capability | {' | '.join(heads)} |",
        f"|{' --- |' * (len(columns) + 1)}",
        *(f"| {name} | {' | '.join(row)} |" for name, row in cells.items()),
    ]
