"""Forces during a simulation: torques, forces of connections and contacts, and the positions of their arrows."""

from __future__ import annotations

import numpy as np
import phipsi
import pytest
from conftest import random_states
from phipsi import PD
from phipsi._forces import given, of_motion, of_pairs
from phipsi.errors import ArgumentError, ShapeError
from tolerances import EPS, assert_near, inverse, product, size

BODY = {"mass": 2.0, "com": (0.1, 0.0, -0.2), "inertia": np.diag([0.03, 0.05, 0.04])}


@pytest.mark.parametrize("kind", ["mixed", "floating"])
@pytest.mark.parametrize("friction_speed", [0.0, 0.01])
def test_torques_make_the_motion(kind: str, friction_speed: float, request: pytest.FixtureRequest) -> None:
    """A semi-implicit Euler step is dt times the acceleration by the torques: of springs, losses, a control law and
    given torques, also in free and spherical joints.

    The torques exclude those of the stops, which are disabled. Exact friction is constant in a step in which every
    joint slides in one direction: short steps have no others.
    """
    scene: phipsi.Scene = request.getfixturevalue(kind)
    q, qd, tau = random_states(scene, 7, (3,))
    target = random_states(scene, 8)[0]
    own = np.random.default_rng(2).uniform(0.5, 2.0, (4, scene.nv))
    law, dt = PD(own[0], own[1], target, qd[1]), 0.01 if friction_speed > 0.0 else 1e-5
    steps = np.random.default_rng(3).uniform(-1.0, 1.0, (4, scene.nv))
    how = {"damping": own[2], "friction": own[3], "stiffness": 3.0, "rest": random_states(scene, 9)[0], "method": "semi-implicit-euler"}
    how |= {"friction_speed": friction_speed, "limits": "report"}
    for torque in ({"tau": tau}, {"tau_steps": steps}):
        path = scene.simulate(q, qd, dt=dt, steps=4, pd=law, **torque, **how)
        found = path.torques()
        assert found.shape == path.qd.shape
        for row in range(4):
            rate = (path.qd[:, row + 1] - path.qd[:, row]) / dt
            expected = scene.inverse_dynamics(path.q[:, row], path.qd[:, row], rate)
            condition = max(np.linalg.norm(m) for m in scene.mass_matrix(path.q[:, row]))
            assert_near(found[:, row], expected, inverse(condition, size(path.qd, expected) / dt))
        assert not path.events.any()


def test_gradients_of_a_function_for_torques_are_not_known() -> None:
    path = phipsi.scenes.chain(2).simulate([0.1, 0.2], [0.0, 0.0], dt=1e-3, steps=2, tau=lambda t, q, qd: -qd)
    with pytest.raises(ArgumentError, match="tau: found a function"):
        path.vjp(path.q)


def hung(kind: str) -> phipsi.Scene:
    """A body attached to the world by one connection at a distance from its center of mass."""
    builder = phipsi.SceneBuilder().link("body", **BODY)
    return builder.connect("hook", kind, "body", xyz=(0.0, 0.3, 0.1), other_xyz=(0.4, 0.3, 0.9 if kind == "rod" else 0.1), rpy=(0.4, 0.2, 0.1)).build(floating_base=True)


@pytest.mark.parametrize("kind", ["point", "rod", "weld"])
def test_forces_of_connections_are_what_moves_the_center_of_mass(kind: str) -> None:
    """Newton: m a = m g + force, with the accelerations of the simulation."""
    scene = hung(kind)
    start = scene.neutral()
    if kind != "rod":
        start[0] += 0.4
    q, qd, _ = scene.loops.project(start, [0.1, 0.2, 0.3, 1.0, -2.0, 0.5])
    path = scene.simulate(q, qd, dt=1e-4, steps=400, record_every=200)
    found = of_motion(path, np.arange(3))
    assert found is not None and found.names == ("hook",) and found.at.shape == found.force.shape == (3, 1, 3)
    qdd = scene.forward_dynamics(path.q, path.qd, np.zeros_like(path.qd))
    expected = BODY["mass"] * (scene.center_of_mass_acceleration(path.q, path.qd, qdd) - scene.gravity)
    assert np.linalg.norm(expected) > 1.0
    assert_near(found.force[:, 0], expected, 1e6 * EPS * size(expected))
    # Point of application: on the body.
    place = scene.placement(path.q, "body")
    assert_near(found.at[:, 0], place[:, :3, :3] @ [0.0, 0.3, 0.1] + place[:, :3, 3], product(9, size(path.q)))
    if kind == "rod":
        along = found.at[:, 0] - [0.4, 0.3, 0.9]
        assert_near(np.cross(along, found.force[:, 0]), np.zeros((3, 3)), 1e4 * EPS * size(expected))


def test_contacts_carry_a_ball() -> None:
    normal = np.array([0.0, 0.6, 0.8])
    builder = phipsi.SceneBuilder().link("ball", 2.0, inertia=np.eye(3) * 0.01)
    scene = builder.contact("ground", "ball", xyz=(0.01, 0.0, 0.02), radius=0.1, friction=0.4, normal=3.0 * normal, offset=0.05).build(floating_base=True)
    q = scene.neutral()
    q[:3] = 0.2 * normal
    path = scene.simulate(q, np.zeros(6), dt=1e-3, steps=300, record_every=20)
    rows = np.arange(len(path))
    found = of_motion(path, rows)
    assert found is not None and found.what == "contact" and path.contacts is not None
    assert_near(found.at[:, 0] @ normal - 0.05, path.contacts.gap["ground"], product(20, size(found.at)))
    assert np.array_equal(found.force[:, 0], path.contacts.force["ground"])
    assert found.force[-1, 0] @ normal > 10.0


def test_shapes_that_touch_have_arrows_on_the_body_that_moves() -> None:
    """Up, where they act, also if the ground is the first collider; rows can have fewer points."""
    for is_first in (True, False):
        builder = phipsi.SceneBuilder().link("box", 2.0, inertia=np.eye(3) * 0.01)
        for name in ("ground", "box") if is_first else ("box", "ground"):
            shape = phipsi.shapes.HalfSpace() if name == "ground" else phipsi.shapes.Box((0.2, 0.2, 0.2))
            builder.collider(name, shape, link=None if name == "ground" else name)
        scene = builder.build(floating_base=True)
        path = scene.simulate([0.3, 0.2, 0.1, 0, 0, 0, 1], np.zeros(6), dt=1e-3, steps=3)
        found = of_motion(path, np.arange(4))
        assert found is not None and found.what == "contact" and found.at.shape == found.force.shape == (4, 4, 3) and found.names == ("",) * 4
        assert not found.force[0].any()
        for row in range(1, 4):
            assert_near(found.force[row].sum(axis=0), np.array([0.0, 0.0, 2.0 * 9.81]), 1e-9)
            assert_near(np.sort(found.at[row, :, 0]), np.array([0.2, 0.2, 0.4, 0.4]), 1e-9)
        ((pair, force),) = of_pairs(path).items()
        assert set(pair) == {"box", "ground"} and force.shape == (4, 3)
        assert_near(np.abs(force[1:, 2]), np.full(3, 2.0 * 9.81), 1e-9)


def test_a_coupling_has_no_arrow() -> None:
    builder = phipsi.SceneBuilder().link("base")
    for name in ("one", "two"):
        builder.link(name, **BODY).joint(name, "continuous", "base", name, axis=(0, 1, 0))
    scene = builder.couple("gear", "one", "two", multiplier=2.0).build()
    path = scene.simulate([0.0, 0.0], [2.0, 1.0], dt=1e-3, steps=5)
    assert path.constraint_forces()["gear"].shape == (6, 1)
    assert of_motion(path, np.arange(6)) is None


def test_forces_that_are_given_have_a_row_each() -> None:
    assert given(np.zeros((4, 2, 3)), np.ones((4, 2, 3)), 4).force.shape == (4, 2, 3)
    for at in (np.zeros((3, 2, 3)), np.zeros((4, 2, 2)), np.zeros((2, 3)), np.zeros((4, 1, 3))):
        with pytest.raises(ShapeError, match=r"forces: .*expected \(4, n, 3\)"):
            given(at, np.ones((4, 2, 3)), 4)
