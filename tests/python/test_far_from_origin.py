"""Results do not depend on the position of a mechanism: each method of a scene, moved by up to 1,000 km and rotated,
compared with the same at the origin.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import phipsi
import pytest
from conftest import random_rotation, random_scene
from tolerances import FAR, assert_near, size

DISTANCE = 1e6


def placed(rotation: np.ndarray, at: np.ndarray) -> np.ndarray:
    """A pose as (4, 4)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, at
    return pose


def quaternion_of(rotation: np.ndarray) -> np.ndarray:
    """(x, y, z, w) of a rotation whose trace is not near -1."""
    w = 0.5 * np.sqrt(1.0 + np.trace(rotation))
    skew = rotation - rotation.T
    return np.array([skew[2, 1], skew[0, 2], skew[1, 0], 4.0 * w * w]) / (4.0 * w)


def times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The product of two quaternions (x, y, z, w)."""
    v = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.append(v, a[3] * b[3] - a[:3] @ b[:3])


#: New poses of the base: a rotation and a position in integer meters, whose addition causes no rounding.
MOVES = {
    "moved": (np.eye(3), np.array([DISTANCE, -DISTANCE / 2, DISTANCE / 4])),
    "rotated": (random_rotation(np.random.default_rng(5)), np.zeros(3)),
    "both": (random_rotation(np.random.default_rng(8)), np.array([-DISTANCE, DISTANCE / 2, DISTANCE / 8])),
}


class Pair:
    """A floating scene in a state near the origin, and the same scene moved with its gravity, contacts and
    connections.
    """

    def __init__(self, make: Callable[[], phipsi.SceneBuilder], move: str) -> None:
        self.rotation, self.at = MOVES[move]
        gravity = np.array([0.3, -0.5, -9.6])
        builder = make()
        self.near = builder.build(floating_base=True, gravity=gravity)
        self.far = builder.build(floating_base=True, gravity=self.rotation @ gravity)
        random = np.random.default_rng(3)
        q = self.near.integrate(self.near.neutral(), random.uniform(-0.3, 0.3, self.near.nv))
        # A multiple of a power of two, so that it is unchanged by the addition of the distance.
        q[:3] = np.round(q[:3] * 2.0**20) / 2.0**20
        self.q = q
        self.qd, self.tau, self.more = random.uniform(-1, 1, (3, self.near.nv))
        if self.near.loops.names:
            self.q, self.qd, _ = self.near.loops.project(self.q, self.qd)
            self.q[:3] = q[:3] if not np.any(self.rotation - np.eye(3)) else self.q[:3]
        self.moved_q = self.moved(self.q)

    def moved(self, q: np.ndarray) -> np.ndarray:
        """Configurations of the moved scene."""
        q = np.array(q)
        flat = q.reshape(-1, q.shape[-1])
        for one in flat:
            one[:3] = self.rotation @ one[:3] + self.at
            turned = times(quaternion_of(self.rotation), one[3:7])
            one[3:7] = turned / np.linalg.norm(turned)
        return flat.reshape(q.shape)

    def same(self, ask: Callable[[phipsi.Scene, np.ndarray], Any], scale: float = 1.0) -> None:
        """Equal results in body frames; scale: amplification of rounding errors by the problem."""
        near, far = (np.asarray(ask(scene, q)) for scene, q in ((self.near, self.q), (self.far, self.moved_q)))
        assert_near(far, near, FAR * scale * size(near))


def tree() -> phipsi.SceneBuilder:
    return random_scene(4, 9, kinds=("revolute", "prismatic", "screw", "planar", "spherical", "continuous")).to_builder()


def loops() -> phipsi.SceneBuilder:
    """A floating base with a four-bar linkage, whose hinge has three redundant constraints, a rod and a coupled
    joint.
    """
    builder = phipsi.SceneBuilder().link("ground", mass=1.0, com=(0.1, 0, 0), inertia=np.diag([0.1, 0.1, 0.1]))
    for name, parent, xyz, length in (
        ("crank", "ground", (0, 0, 0), 0.2),
        ("coupler", "crank", (0, 0, 0.2), 0.4),
        ("rocker", "ground", (0.3, 0, 0), 0.3),
    ):
        builder.link(name, mass=1.0, com=(0, 0, length / 2), inertia=np.diag([length**2 / 12] * 2 + [1e-3]))
        builder.joint(name, "continuous", parent, name, xyz=xyz, axis=(0, 1, 0))
    builder.link("wheel", mass=0.5, inertia=np.diag([0.01, 0.01, 0.01])).joint("wheel", "continuous", "ground", "wheel", xyz=(0, 0.2, 0))
    builder.couple("gear", "wheel", "rocker", multiplier=2.0)
    return builder.connect("pin", "axis", "coupler", "rocker", xyz=(0, 0, 0.4), other_xyz=(0, 0, 0.3), axis=(0, 1, 0))


@pytest.fixture(params=MOVES)
def trees(request: pytest.FixtureRequest) -> Pair:
    return Pair(tree, request.param)


@pytest.fixture(params=MOVES)
def linkages(request: pytest.FixtureRequest) -> Pair:
    return Pair(loops, request.param)


def test_dynamics_of_trees(trees: Pair) -> None:
    pair, (qd, tau, u) = trees, (trees.qd, trees.tau, trees.more)
    pair.same(lambda scene, q: scene.forward_dynamics(q, qd, tau), 10)
    for form in ("covariance", "square-root"):
        pair.same(lambda scene, q, form=form: scene.forward_dynamics(q, qd, tau, form=form), 10)
    wrench = {"link5": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]}
    pair.same(lambda scene, q: scene.forward_dynamics(q, qd, tau, wrenches=wrench), 10)
    pair.same(lambda scene, q: scene.inverse_dynamics(q, qd, u))
    pair.same(lambda scene, q: scene.bias_torque(q, qd))
    pair.same(lambda scene, q: scene.gravity_torque(q))
    pair.same(lambda scene, q: scene.mass_matrix(q))
    pair.same(lambda scene, q: scene.mass_matrix_inverse(q), 10)
    pair.same(lambda scene, q: scene.coriolis_matrix(q, qd))
    pair.same(lambda scene, q: scene.mass_matrix_derivative(q, qd))
    pair.same(lambda scene, q: scene.kinetic_energy(q, qd))
    pair.same(lambda scene, q: scene.factor(q).solve(tau), 10)
    pair.same(lambda scene, q: scene.factor(q).log_det)


def test_derivatives_of_trees(trees: Pair) -> None:
    pair, (qd, tau, u) = trees, (trees.qd, trees.tau, trees.more)
    pair.same(lambda scene, q: np.concatenate(scene.inverse_dynamics_derivatives(q, qd, u)))
    pair.same(lambda scene, q: np.concatenate(scene.forward_dynamics_derivatives(q, qd, tau)), 10)
    pair.same(lambda scene, q: scene.linearize(q, qd, tau)[0], 10)
    pair.same(lambda scene, q: scene.inverse_dynamics_jvp(q, qd, u, tau, u, qd))
    pair.same(lambda scene, q: scene.forward_dynamics_jvp(q, qd, tau, u, tau, qd), 10)
    for name in ("inverse_dynamics_vjp", "forward_dynamics_vjp"):
        pair.same(lambda scene, q, name=name: np.stack(getattr(scene, name)(q, qd, tau, u)[:3]), 10)
    for name in ("inverse_dynamics_hvp", "forward_dynamics_hvp"):
        pair.same(lambda scene, q, name=name: np.stack(getattr(scene, name)(q, qd, tau, u, tau, qd, u)[:3]), 100)


def test_kinematics_of_trees(trees: Pair) -> None:
    pair, (qd, u) = trees, (trees.qd, trees.more)
    rotation, links = pair.rotation, ("link3", "link8")
    local = {"frame": "local"}
    for link in links:
        pair.same(lambda scene, q, link=link: scene.jacobian(q, link, **local))
        pair.same(lambda scene, q, link=link: scene.jacobian_rate(q, qd, link, **local))
        pair.same(lambda scene, q, link=link: scene.jacobian_rate_product(q, qd, link, **local))
        pair.same(lambda scene, q, link=link: scene.velocity(q, qd, link, **local))
        pair.same(lambda scene, q, link=link: scene.acceleration(q, qd, u, link, **local))
        pair.same(lambda scene, q, link=link: scene.operational_inverse_inertia(q, link), 10)
        pair.same(lambda scene, q, link=link: scene.operational_inertia(q, link), 100)
        # In the base frame, at the link: rotated with it.
        both = np.kron(np.eye(2), rotation)
        aligned = [scene.velocity(q, qd, link, frame="local-world-aligned") for scene, q in ((pair.near, pair.q), (pair.far, pair.moved_q))]
        assert_near(aligned[1], both @ aligned[0], FAR * size(aligned[0]))
        near, far = (scene.placement(q, link) for scene, q in ((pair.near, pair.q), (pair.far, pair.moved_q)))
        expected = placed(rotation, pair.at) @ near
        assert_near(far[:3, :3], expected[:3, :3], FAR)
        assert_near(far[:3, 3], expected[:3, 3], FAR * size(pair.at))


def test_quantities_of_the_whole_tree(trees: Pair) -> None:
    pair, (qd, u) = trees, (trees.qd, trees.more)
    rotation, states = pair.rotation, ((pair.near, pair.q), (pair.far, pair.moved_q))
    near, far = (scene.center_of_mass(q) for scene, q in states)
    assert_near(far, rotation @ near + pair.at, FAR * size(pair.at))
    both = np.kron(np.eye(2), rotation)
    for ask, turn in (
        (lambda scene, q: scene.center_of_mass_velocity(q, qd), rotation),
        (lambda scene, q: scene.center_of_mass_acceleration(q, qd, u), rotation),
        (lambda scene, q: scene.center_of_mass_jacobian(q), rotation),
        (lambda scene, q: scene.centroidal_momentum_matrix(q), both),
        (lambda scene, q: scene.centroidal_momentum_matrix_rate(q, qd), both),
    ):
        near, far = (np.asarray(ask(scene, q)) for scene, q in states)
        assert_near(far, turn @ near, FAR * size(near))
    near, far = (scene.momentum(q, qd) for scene, q in states)
    expected = both @ near
    expected[:3] += np.cross(pair.at, expected[3:])
    assert_near(far, expected, FAR * size(near) * size(pair.at))
    near, far = (scene.energy(q, qd) for scene, q in states)
    lift = -pair.near.total_mass * (pair.far.gravity @ pair.at)
    assert_near(far.kinetic, near.kinetic, FAR * size(near.kinetic))
    assert_near(far.potential, near.potential + lift, FAR * size(lift, near.potential))


def test_steps_between_configurations(trees: Pair) -> None:
    pair, u = trees, trees.more
    there, far = pair.near.integrate(pair.q, u), pair.far.integrate(pair.moved_q, u)
    expected = pair.moved(there)
    assert_near(far, expected, FAR * size(pair.at))
    assert_near(pair.far.difference(pair.moved_q, far), u, FAR * size(pair.at))


@pytest.mark.parametrize("options", [{}, {"method": "rk4"}], ids=["default", "rk4"])
def test_motion_of_trees(trees: Pair, options: dict[str, Any]) -> None:
    pair, tau = trees, trees.tau.copy()
    tau[:6] = 0.0
    pair.same(lambda scene, q: scene.simulate(q, pair.qd, dt=1e-3, steps=50, tau=tau, **options).qd[-1], 10)
    ends = [
        scene.simulate(q, pair.qd, dt=1e-3, steps=50, tau=tau, **options).q[-1]
        for scene, q in ((pair.near, pair.q), (pair.far, pair.moved_q))
    ]
    assert_near(ends[1], pair.moved(ends[0]), FAR * size(pair.at))


def test_linkages(linkages: Pair) -> None:
    pair, (qd, tau, u) = linkages, (linkages.qd, linkages.tau, linkages.more)
    pair.same(lambda scene, q: scene.loops.error(q))
    pair.same(lambda scene, q: scene.loops.jacobian(q))
    pair.same(lambda scene, q: scene.loops.bias(q, qd))
    pair.same(lambda scene, q: scene.loops.dynamics(q, qd, tau).rank)
    pair.same(lambda scene, q: scene.loops.dynamics(q, qd, tau).qdd, 100)
    pair.same(lambda scene, q: scene.loops.dynamics(q, qd, tau).forces["pin"], 100)
    pair.same(lambda scene, q: scene.loops.dynamics(q, qd, tau, form="square-root").qdd, 100)
    pair.same(lambda scene, q: scene.loops.dynamics(q, qd, tau, compliance=1e-3).qdd, 100)
    pair.same(lambda scene, q: scene.forward_dynamics(q, qd, tau), 100)
    pair.same(lambda scene, q: scene.loops.inverse_dynamics(q, qd, u).tau, 100)
    pair.same(lambda scene, q: scene.loops.mass_matrix_inverse(q), 100)
    pair.same(lambda scene, q: np.concatenate(scene.forward_dynamics_derivatives(q, qd, tau)), 100)
    pair.same(lambda scene, q: np.stack(scene.forward_dynamics_vjp(q, qd, tau, u)[:3]), 100)
    pair.same(lambda scene, q: scene.forward_dynamics_jvp(q, qd, tau, u, tau, qd), 100)
    # Exactly zero for joints that move both ends equally.
    assert not np.any(pair.far.loops.jacobian(pair.moved_q)[:, :6])


def test_projection_and_motion_of_linkages(linkages: Pair) -> None:
    pair = linkages
    assert pair.near.loops.project(pair.q).rank == 3
    away = np.concatenate([np.zeros(6), [0.02, -0.01, 0.03, 0.01]])
    opened, moved = pair.near.integrate(pair.q, away), pair.far.integrate(pair.moved_q, away)
    near, far = pair.near.loops.project(opened, pair.qd), pair.far.loops.project(moved, pair.qd)
    assert far.rank == near.rank == 3
    assert_near(far.q, pair.moved(near.q), FAR * size(pair.at))
    assert_near(far.q[7:], near.q[7:], FAR * 100)
    assert_near(far.qd, near.qd, FAR * 100)
    near, far = (scene.simulate(q, pair.qd, dt=1e-3, steps=200) for scene, q in ((pair.near, pair.q), (pair.far, pair.moved_q)))
    assert near.drift.max() <= FAR and far.drift.max() <= FAR
    assert_near(far.q[-1, 7:], near.q[-1, 7:], FAR * 1000)
    assert_near(far.qd[-1], near.qd[-1], FAR * 1000)
    simulator = pair.far.simulator(pair.moved_q, pair.qd, dt=1e-3)
    simulator.step(steps=200)
    assert np.array_equal(simulator.q, far.q[-1])


def fixed_linkage(rotation: np.ndarray, at: np.ndarray) -> phipsi.Scene:
    """A four-bar linkage on the ground, described at its position."""
    builder = phipsi.SceneBuilder().link("ground")
    for name, parent, xyz, length in (
        ("crank", "ground", (0, 0, 0), 0.25),
        ("coupler", "crank", (0, 0, 0.25), 0.5),
        ("rocker", "ground", (0.375, 0, 0), 0.375),
    ):
        builder.link(name, mass=1.0, com=(0, 0, length / 2), inertia=np.diag([length**2 / 12] * 2 + [1e-3]))
        own = {"xyz": xyz} if parent != "ground" else {"xyz": rotation @ np.array(xyz, dtype=float) + at, "rotation": rotation}
        builder.joint(name, "continuous", parent, name, axis=(0, 1, 0), **own)
    builder.connect("pin", "axis", "coupler", "rocker", xyz=(0, 0, 0.5), other_xyz=(0, 0, 0.375), axis=(0, 1, 0))
    return builder.build(gravity=rotation @ np.array([0.3, -0.5, -9.6]))


@pytest.mark.parametrize("move", MOVES)
def test_a_linkage_that_is_drawn_far_away(move: str) -> None:
    rotation, at = MOVES[move]
    near, far = fixed_linkage(np.eye(3), np.zeros(3)), fixed_linkage(rotation, at)
    if np.any(rotation - np.eye(3)) and np.any(at):
        # Its constants are rounded: to 1e-10 m at this distance.
        bound = FAR * size(at)
    else:
        bound = FAR * 1000
    start = near.loops.project([0.5, 0.8, 0.2], [1.0, 0.0, 0.0])
    there = far.loops.project([0.5, 0.8, 0.2], [1.0, 0.0, 0.0])
    assert there.rank == start.rank == 2
    assert_near(there.q, start.q, bound)
    assert_near(there.qd, start.qd, bound)
    ends = [scene.simulate(state.q, state.qd, dt=1e-3, steps=200).q[-1] for scene, state in ((near, start), (far, there))]
    assert_near(ends[1], ends[0], 100 * bound)


@pytest.mark.parametrize("move", MOVES)
def test_contacts(move: str) -> None:
    rotation, at = MOVES[move]
    normal = rotation @ np.array([0.0, 0.0, 1.0])
    ends = []
    for turn, place in ((np.eye(3), np.zeros(3)), (rotation, at)):
        builder = phipsi.SceneBuilder().link("box", mass=1.0, inertia=np.diag([0.1, 0.2, 0.15]))
        up = turn @ np.array([0.0, 0.0, 1.0])
        for i, corner in enumerate(((0.25, 0.25, -0.125), (-0.25, 0.25, -0.125), (0.25, -0.25, -0.125), (-0.25, -0.25, -0.125))):
            builder.contact(f"corner{i}", "box", xyz=corner, normal=up, offset=float(up @ place), friction=0.5)
        scene = builder.build(floating_base=True, gravity=turn @ np.array([0.0, 0.0, -9.81]))
        q = np.concatenate([turn @ np.array([0.0, 0.0, 0.15]) + place, quaternion_of(turn)])
        qd = np.array([0.5, 0.1, 0.0, 0.2, 0.1, 0.3])
        path = scene.simulate(q, qd, dt=1e-3, steps=100)
        ends.append((scene.contacts.gaps(q), scene.contacts.velocities(q, qd), path.qd[-1]))
    (gaps, velocities, end), (far_gaps, far_velocities, far_end) = ends
    assert_near(far_gaps, gaps, FAR * size(at))
    assert_near(np.linalg.norm(far_velocities, axis=-1), np.linalg.norm(velocities, axis=-1), FAR * 10)
    # The height above the plane is a difference of two distances.
    assert_near(far_end, end, 1e4 * FAR * size(at))
    assert np.isclose(np.linalg.norm(normal), 1.0)


def test_inverse_kinematics(trees: Pair) -> None:
    pair = trees
    target = pair.near.integrate(pair.q, np.concatenate([np.zeros(6), np.full(pair.near.nv - 6, 0.05)]))
    for scene, q, goal in ((pair.near, pair.q, target), (pair.far, pair.moved_q, pair.moved(target))):
        task = phipsi.tasks.Pose("link8", scene.placement(goal, "link8"))
        found = scene.inverse_kinematics([task], q)
        left = found.error if hasattr(found, "error") else 0.0
        assert found.reached and np.max(left) <= max(1e-6, FAR * size(pair.at))
