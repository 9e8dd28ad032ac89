"""The solver of the contact law: blocks on redundant corners, independent bodies in one scene, and contact states."""

from __future__ import annotations

import numpy as np
import phipsi
import pytest
from phipsi import ContactState
from tolerances import CONTACT, EQUAL_SPRINGS, FAR, assert_near

G = 9.81


def block(
    mu: float, edges: tuple[float, float, float], *, mass: float = 2.0, corners: int = 8, restitution: float = 0.0, height: float = 0.0, slope: float = 0.0
) -> phipsi.Scene:
    """A homogeneous block above the plane z = height, with gravity that is inclined by an angle of tangent `slope`."""
    a, b, c = edges
    builder = phipsi.SceneBuilder().link("block", mass=mass, inertia=mass / 12 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b]))
    for i in range(corners):
        xyz = [edge / 2 if i >> axis & 1 else -edge / 2 for axis, edge in enumerate(edges)]
        builder.contact(f"corner{i}", "block", xyz=xyz, friction=mu, restitution=restitution, offset=height)
    down = np.array([slope, 0.0, -1.0]) / np.hypot(slope, 1.0)
    return builder.build(floating_base=True, gravity=tuple(G * down))


def starts(edges: tuple[float, float, float], corners: int, height: float) -> tuple[np.ndarray, np.ndarray]:
    """At rest, sliding, and dropped from a twentieth of an edge; blocks on four corners hardly tilt."""
    random = np.random.default_rng(3)
    q, qd = np.zeros((10, 7)), random.uniform(-1, 1, (10, 6))
    q[:, 2], q[:, 6] = height + edges[2] / 2, 1.0
    q[5:, 2] += 0.05 * edges[0]
    qd[:, 3:5] *= 0.1 if corners == 4 else 1.0
    qd[:2] = 0.0
    return q, qd


@pytest.mark.parametrize("mass", [0.02, 2.0, 500.0])
@pytest.mark.parametrize("heights", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.1, -0.05, 0.02)])
def test_four_legs_share_the_weight_as_equal_springs(mass: float, heights: tuple[float, ...]) -> None:
    """A table with its center of mass off the middle, also on steps and under a force along the ground: the least sum of
    squares of the forces that balance it, whatever its mass and inertia.
    """
    com, gravity = np.array([0.15, 0.1, 0.0]), np.array([0.6, -0.4, -G])
    table = phipsi.SceneBuilder().link("table", mass, tuple(com), mass * np.diag([0.02, 0.05, 0.06]))
    balance = []
    for i, ((x, y), height) in enumerate(zip([(-0.4, -0.3), (-0.4, 0.3), (0.4, -0.3), (0.4, 0.3)], heights, strict=True)):
        foot = np.array([x, y, height - 0.5])
        table.contact(f"leg{i}", "table", xyz=tuple(foot), friction=2.0, offset=height)
        # Moments about the center of mass, about which the weight has none.
        lever = foot - com
        turns = [[0, -lever[2], lever[1]], [lever[2], 0, -lever[0]], [-lever[1], lever[0], 0]]
        balance.append(np.vstack([np.eye(3), turns]))
    expected = np.linalg.pinv(np.hstack(balance)) @ np.array([*(-mass * gravity), 0, 0, 0])
    path = table.build(floating_base=True, gravity=tuple(gravity)).simulate([0, 0, 0.5, 0, 0, 0, 1.0], np.zeros(6), dt=1e-3, steps=20)
    assert path.contacts is not None and np.abs(path.qd).max() <= 1e-9
    for row in (1, -1):
        found = np.concatenate([force[row] for force in path.contacts.force.values()])
        assert_near(found, expected, EQUAL_SPRINGS * mass * G)


@pytest.mark.parametrize("dt", [1e-2, 1e-3])
@pytest.mark.parametrize("corners", [4, 8])
@pytest.mark.parametrize("mu", [0.3, 0.8])
def test_blocks_on_redundant_corners_meet_the_law_in_few_iterations(mu: float, corners: int, dt: float) -> None:
    """At most eight iterations per step on average, far from the origin too, where gaps have errors of 1e-13 m."""
    for edges, mass, height in (((0.4, 0.3, 0.2), 2.0, 0.0), ((0.1, 0.1, 0.1), 0.013, 1000.0), ((1.7, 0.9, 0.05), 900.0, 0.0)):
        scene = block(mu, edges, mass=mass, corners=corners, height=height)
        steps = round(0.3 / dt)
        contacts = scene.simulate(*starts(edges, corners, height), dt=dt, steps=steps).contacts
        assert contacts is not None
        assert (contacts.residual <= CONTACT).all() and contacts.converged.all()
        assert np.mean(contacts.iterations) <= 400 + 8 * steps


def bodies(names: tuple[str, ...], *, pair: bool = False, slip: bool = True) -> phipsi.Scene:
    """Free cubes and balls on the ground; with `pair`, the balls "b" and "d" can touch each other."""
    builder = phipsi.SceneBuilder().link("world")
    for name in names:
        builder.link(name, mass=1.5, inertia=0.01 * np.eye(3)).joint(f"{name} joint", "floating", "world", name)
        if name in "ac":
            for i in range(8):
                xyz = [0.1 if i >> axis & 1 else -0.1 for axis in range(3)]
                builder.contact(f"{name}{i}", name, xyz=xyz, friction=0.4, restitution=0.3)
        else:
            builder.contact(f"{name} ball", name, radius=0.1, friction=0.5 if slip else 0.0, restitution=0.6)
    if pair:
        builder.contact("pair", "b", radius=0.1, friction=0.2, restitution=0.5, other="d", other_radius=0.1)
    return builder.build()


ALL = ("a", "b", "c", "d", "e", "f")


def state_of(name: str) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(ord(name))
    turn = random.normal(size=4)
    if name in "bd":
        # Two balls that approach each other.
        x, y = (0.0, 0.0) if name == "b" else (0.25, 0.03)
        return np.array([x, y, 0.2, 0, 0, 0, 1.0]), np.concatenate([[1.0 - 8 * x, 0, 0], random.uniform(-1, 1, 3)])
    return np.concatenate([[0, 0, 0.3], turn / np.linalg.norm(turn)]), random.uniform(-1, 1, 6)


def simulated(scene: phipsi.Scene, names: tuple[str, ...], dt: float = 2e-3) -> phipsi.Trajectory:
    """All steps are contact steps: by default, the contacts of one body decide on the step of the others."""
    q, qd = (np.concatenate(parts) for parts in zip(*map(state_of, names), strict=True))
    return scene.simulate(q, qd, dt=dt, steps=150, method="contact")


def test_independent_bodies_move_as_if_alone() -> None:
    together = simulated(bodies(ALL), ALL)
    assert together.contacts is not None and together.contacts.converged.all()
    iterations = 0
    for i, name in enumerate(ALL):
        alone = simulated(bodies((name,)), (name,))
        assert alone.contacts is not None and alone.contacts.converged.all()
        iterations += int(alone.contacts.iterations)
        assert np.max(np.abs(together.q[:, 7 * i : 7 * i + 7] - alone.q)) <= FAR
        assert np.max(np.abs(together.qd[:, 6 * i : 6 * i + 6] - alone.qd)) <= FAR
        for contact in alone.contacts.impulse:
            assert np.max(np.abs(together.contacts.gap[contact] - alone.contacts.gap[contact])) <= FAR
    # The solves of a step are repeated for all groups when another contact closes.
    assert 0 < int(together.contacts.iterations) <= 3 * iterations


def test_a_pair_couples_two_bodies_and_no_others() -> None:
    both = ("b", "d")
    together, alone = simulated(bodies(ALL, pair=True), ALL), simulated(bodies(both, pair=True), both)
    apart = simulated(bodies(both), both)
    assert alone.contacts is not None and np.max(np.abs(alone.contacts.impulse["pair"])) > 0.01
    assert np.max(np.abs(alone.q - apart.q)) > 0.01
    for i, name in enumerate(ALL):
        expected = alone.q[:, 7 * both.index(name) :][:, :7] if name in both else simulated(bodies((name,)), (name,)).q
        assert np.max(np.abs(together.q[:, 7 * i : 7 * i + 7] - expected)) <= FAR


def test_many_balls_share_a_scene_without_a_dense_matrix() -> None:
    """1,500 balls would need a matrix of 162 MB and a factor of 3e10 operations per step."""
    count, dt = 1500, 4e-3
    builder = phipsi.SceneBuilder().link("world")
    for i in range(count):
        builder.link(f"ball{i}", mass=1.0 + i, inertia=0.004 * (1.0 + i) * np.eye(3)).joint(f"joint{i}", "floating", "world", f"ball{i}")
        builder.contact(f"ball{i}", f"ball{i}", radius=0.1, friction=0.5)
    scene = builder.build()
    q, qd = np.tile([0, 0, 0.1, 0, 0, 0, 1.0], count), np.tile([1.0, 0, 0, 0, 0, 0], count)
    path = scene.simulate(q, qd, dt=dt, steps=3, record_every=3)
    assert path.contacts is not None and path.contacts.converged
    # Each ball slides: its center slows by mu g.
    speed = np.linalg.norm(path.qd[-1].reshape(count, 6)[:, :3], axis=1)
    assert np.max(np.abs(speed - (1.0 - 0.5 * G * 3 * dt))) <= FAR
    assert int(path.contacts.iterations) <= 5 * 3 * count


@pytest.mark.parametrize("mu", [0.1, 0.3, 0.5, 0.8, 1.3])
def test_a_block_exactly_at_the_friction_angle_sticks(mu: float) -> None:
    edges = (0.4, 0.3, 0.2)
    q = np.array([0, 0, 0.1, 0, 0, 0, 1.0])
    for slope, expected in ((mu, ContactState.STICKING), (mu * (1 - 1e-9), ContactState.STICKING), (mu * (1 + 1e-6), ContactState.SLIDING)):
        path = block(mu, edges, corners=4, slope=slope).simulate(q, np.zeros(6), dt=1e-2, steps=20)
        assert path.contacts is not None
        states = np.stack([path.contacts.state[f"corner{i}"][1:] for i in range(4)])
        pressed = np.stack([path.contacts.force[f"corner{i}"][1:, 2] for i in range(4)]) > 1e-6
        assert pressed.any(axis=0).all()
        assert (states[pressed] == expected).all()
        assert (np.max(np.abs(path.qd)) <= CONTACT) == (expected == ContactState.STICKING)


def test_the_state_of_a_rebound_is_that_of_its_slip() -> None:
    """A corner of a block hits the ground: it slides if it slips after the impact, also if the direction turned."""
    random, dt = np.random.default_rng(8), 1e-3
    edges = (0.4, 0.3, 0.2)
    turned = dict.fromkeys(ContactState, 0)
    for mu in (0.05, 0.2, 0.4, 1.0):
        scene = block(mu, edges, restitution=0.6)
        quaternion = random.normal(size=(40, 4))
        q = np.concatenate([np.zeros((40, 3)), quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)], axis=1)
        q[:, 2] -= np.min(scene.contacts.gaps(q), axis=1)
        qd = random.uniform(-2, 2, (40, 6))
        corner = np.argmin(scene.contacts.gaps(q), axis=1)
        approach = scene.contacts.velocities(q, qd)[np.arange(40), corner, 2]
        path = scene.simulate(q, qd, dt=dt, steps=1)
        assert path.contacts is not None
        for i in np.flatnonzero(approach < -0.5):
            names = [name for name in scene.contacts.names if path.contacts.impulse[name][i, 1, 2] > 0]
            if names != [f"corner{corner[i]}"]:
                continue
            # Velocities at the end, in the axes at the start of the step.
            turn = scene.difference(q[i], path.q[i, 1])[3:]
            end = path.qd[i, 1].copy()
            end[:3] += np.cross(turn, end[:3]) + 0.5 * np.cross(turn, np.cross(turn, end[:3]))
            slip = np.linalg.norm(scene.contacts.velocities(q[i], end)[corner[i], :2])
            state = ContactState(int(path.contacts.state[names[0]][i, 1]))
            # Gravity and the turn of the axes change the slip by their share of the step.
            assert (state == ContactState.SLIDING) == (slip > 2e-2) or 1e-3 < slip < 2e-2
            turned[state] += 1
    assert turned[ContactState.SLIDING] > 20 and turned[ContactState.STICKING] > 5
