"""Meaning of the methods, by identities between them on trees with all types of joints."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import random_scene, random_states
from tolerances import STEP, assert_near, central_difference, inverse, product, size

import phipsi

SEEDS = range(4)


def condition(m: np.ndarray) -> float:
    return float(np.linalg.cond(m))


def unit(n: int, j: int) -> np.ndarray:
    return np.eye(n)[j]


@pytest.mark.parametrize("seed", SEEDS)
def test_integrate_and_difference_undo_each_other(seed: int) -> None:
    scene = random_scene(seed, 12, floating_base=True)
    random = np.random.default_rng(seed)
    q = random_states(scene, seed, (6,)).q
    v = random.uniform(-1.0, 1.0, (6, scene.nv))
    assert_near(scene.difference(q, scene.integrate(q, v)), v, product(1, 4.0 * size(q)))
    other = random_states(scene, seed + 100, (6,)).q
    reached = scene.integrate(q, scene.difference(q, other))
    # q and -q are one rotation.
    assert_near(scene.difference(other, reached), np.zeros((6, scene.nv)), product(4, 4.0 * size(other)))


@pytest.mark.parametrize("seed", SEEDS)
def test_jacobian_is_the_derivative_of_placements(seed: int) -> None:
    scene = random_scene(seed, 10, floating_base=seed % 2 == 0)
    q = random_states(scene, seed).q
    steps = STEP * np.eye(scene.nv)
    here, after, before = (scene.placements(x) for x in (q, scene.integrate(q, steps), scene.integrate(q, -steps)))
    for link in scene.link_names:
        rotation = here[link][:3, :3]
        rate = rotation.T @ (after[link] - before[link])[:, :3, :] / (2 * STEP)
        # R^T dR is the skew matrix of the angular velocity in the link frame.
        numeric = np.stack([rate[:, 2, 1], rate[:, 0, 2], rate[:, 1, 0], *rate[..., 3].T])
        assert_near(scene.jacobian(q, link), numeric, central_difference(size(*here.values()) * 4.0))


@pytest.mark.parametrize("seed", SEEDS)
def test_wrenches_act_through_the_jacobian(seed: int) -> None:
    scene = random_scene(seed, 10, armature=0.1)
    q, qd, tau = random_states(scene, seed)
    random = np.random.default_rng(seed)
    wrenches = {link: random.uniform(-3.0, 3.0, 6) for link in scene.link_names}
    as_torque = sum(scene.jacobian(q, link).T @ wrench for link, wrench in wrenches.items())
    inverse_dynamics = scene.inverse_dynamics(q, qd, tau, wrenches=wrenches)
    without = scene.inverse_dynamics(q, qd, tau)
    assert_near(inverse_dynamics, without - as_torque, product(scene.nv, size(without, as_torque)))
    bound = inverse(condition(scene.mass_matrix(q)), size(tau, as_torque, scene.bias_torque(q, qd)))
    assert_near(
        scene.forward_dynamics(q, qd, tau, wrenches=wrenches), scene.forward_dynamics(q, qd, tau + as_torque), bound
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_the_mass_matrix_ties_the_algorithms_together(seed: int) -> None:
    scene = random_scene(seed, 10, armature=0.1 * (seed % 2))
    q, qd, tau = random_states(scene, seed)
    m, bias = scene.mass_matrix(q), scene.bias_torque(q, qd)
    assert (m == m.T).all() and (scene.mass_matrix_inverse(q) == scene.mass_matrix_inverse(q).T).all()
    scale = size(tau, bias, m)
    qdd = scene.forward_dynamics(q, qd, tau)
    assert_near(m @ qdd + bias, tau, inverse(condition(m), scale))
    assert_near(scene.inverse_dynamics(q, qd, qdd), tau, inverse(condition(m), scale))
    assert_near(scene.inverse_dynamics(q, qd, tau), m @ tau + bias, product(scene.nv, size(tau) * scale))
    assert_near(scene.mass_matrix_inverse(q) @ m, np.eye(scene.nv), inverse(condition(m), size(m)))


@pytest.mark.parametrize("seed", SEEDS)
def test_energy(seed: int) -> None:
    scene = random_scene(seed, 10, armature=0.1)
    q, qd, _ = random_states(scene, seed)
    kinetic, potential = scene.energy(q, qd)
    assert_near(kinetic, 0.5 * qd @ scene.mass_matrix(q) @ qd, product(scene.nv, size(kinetic)))
    steps = STEP * np.eye(scene.nv)
    still = np.zeros(scene.nv)
    after, before = (scene.energy(scene.integrate(q, s), still).potential for s in (steps, -steps))
    weight = scene.bias_torque(q, still)
    assert_near((after - before) / (2 * STEP), weight, central_difference(4.0 * size(potential, weight)))


@pytest.mark.parametrize("seed", SEEDS)
def test_momentum_of_a_free_scene_is_that_of_its_root(seed: int) -> None:
    """The first six rows of M qd are the momentum in the frame of the root, linear before angular."""
    scene = random_scene(seed, 8, floating_base=True)
    q, qd, _ = random_states(scene, seed)
    root = scene.placements(q)["base"]
    by_root = (scene.mass_matrix(q) @ qd)[:6]
    linear = root[:3, :3] @ by_root[:3]
    angular = root[:3, :3] @ by_root[3:] + np.cross(root[:3, 3], linear)
    found = scene.momentum(q, qd)
    assert_near(found, np.concatenate([angular, linear]), product(scene.nv, size(found)))


@pytest.mark.parametrize("seed", SEEDS)
def test_momentum_of_a_free_scene_changes_by_its_weight_alone(seed: int) -> None:
    for gravity in ((0.0, 0.0, 0.0), (0.3, -0.5, -9.6)):
        scene = random_scene(seed, 8, floating_base=True, gravity=gravity)
        q, qd, tau = random_states(scene, seed)
        tau[:6] = 0.0
        qdd = scene.forward_dynamics(q, qd, tau)
        after, before = (
            scene.momentum(scene.integrate(q, h * qd), qd + h * qdd) for h in (STEP, -STEP)
        )
        rate = (after - before) / (2 * STEP)
        # Mass: linear momentum for a unit velocity of the root, at rest otherwise.
        mass = np.linalg.norm(scene.momentum(q, unit(scene.nv, 0))[3:])
        bound = central_difference(64.0 * size(qd, qdd) ** 3)
        assert_near(rate[3:], mass * np.asarray(gravity), bound)
        if not any(gravity):
            assert_near(rate[:3], np.zeros(3), bound)


@pytest.mark.parametrize("seed", SEEDS)
def test_locked_joints_leave_the_rest_as_it_is(seed: int) -> None:
    scene = random_scene(seed, 10, armature=0.1, floating_base=seed % 2 == 0)
    random = np.random.default_rng(seed)
    q, qd, tau = random_states(scene, seed)
    locked_names = [name for name in scene.joint_names if random.uniform() < 0.5]
    free_names = [name for name in scene.joint_names if name not in locked_names]
    assert locked_names and free_names
    part = scene.lock(locked_names, q)
    assert set(part.joint_names) == set(free_names)
    assert set(scene.link_names) <= set(part.link_names)
    rows = np.concatenate([np.r_[scene.v_index(name)] for name in part.joint_names])
    positions = np.concatenate([np.r_[scene.q_index(name)] for name in part.joint_names])

    m = scene.mass_matrix(q)
    assert_near(part.mass_matrix(q[positions]), m[np.ix_(rows, rows)], product(scene.nv, size(m)))
    moved = np.zeros(scene.nv)
    moved[rows] = qd[rows]
    bias = scene.bias_torque(q, moved)
    assert_near(part.bias_torque(q[positions], qd[rows]), bias[rows], product(scene.nv, size(bias, m) * size(qd) ** 2))
    here, there = scene.placements(q), part.placements(q[positions])
    for link in scene.link_names:
        assert_near(there[link], here[link], product(scene.nv, size(here[link])))
    kinetic = part.energy(q[positions], qd[rows]).kinetic
    assert_near(kinetic, scene.energy(q, moved).kinetic, product(scene.nv, size(kinetic)))


def test_everything_locked_leaves_no_joint(mixed: phipsi.Scene) -> None:
    q = random_states(mixed, 0).q
    still = mixed.lock(mixed.joint_names, q)
    assert still.nv == 0
    here, there = mixed.placements(q), still.placements([])
    for link in mixed.link_names:
        assert_near(there[link], here[link], product(10, size(here[link])))
