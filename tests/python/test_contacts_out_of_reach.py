"""Contacts that cannot act in a step leave it as it is: the step of the scene without contacts, with the same bits."""

from __future__ import annotations

import copy
import pickle

import motion_scenes
import numpy as np
import pytest
import tolerances
from test_contacts import at, ball, box
from test_stops_in_loops import four_bar

import phipsi
from phipsi.errors import ArgumentError, SimulationError

FAR = 100.0
"""Distance of the plane below the base, m."""


def with_plane(scene: phipsi.Scene, **contact: object) -> phipsi.Scene:
    """The same scene with a contact of its last link with a plane far below."""
    contact = {"xyz": (0.1, 0.05, 0.02), "friction": 0.5, "offset": -FAR, **contact}
    return scene.to_builder().contact("far", scene.link_names[-1], **contact).build()


def chain(n: int) -> phipsi.Scene:
    """Pendulums, each on the last one, about axes that are not parallel."""
    builder = phipsi.SceneBuilder().link("base")
    for k in range(n):
        builder.link(f"link{k}", 1.0, (0, 0, -0.2), np.diag([0.015, 0.015, 0.002]))
        builder.joint(f"joint{k}", "continuous", f"link{k - 1}" if k else "base", f"link{k}", xyz=(0, 0, -0.4 if k else 0), axis=(0.3 * (k % 2), 1, 0))
    return builder.build()


def assert_same(path: phipsi.Trajectory, expected: phipsi.Trajectory) -> None:
    assert np.isfinite(path.q).all() and np.array_equal(path.q, expected.q) and np.array_equal(path.qd, expected.qd)
    assert (path.integrator, path.limits) == (expected.integrator, expected.limits)
    assert all(np.array_equal(a, b) for a, b in zip(path.works, expected.works, strict=True))
    assert np.array_equal(path.substeps, expected.substeps) and path.stops == expected.stops
    assert path.contacts is not None
    for name in path.scene.contacts.names:
        assert not path.contacts.force[name].any() and not path.contacts.impulse[name].any()
        assert (path.contacts.state[name] == phipsi.ContactState.OPEN).all() and (path.contacts.gap[name] > 0.0).all()


def test_an_arm_held_by_friction_stays_where_it_is() -> None:
    arm = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
    q = np.linspace(0.3, 0.8, arm.nq)
    holding = 1.2 * np.abs(arm.inverse_dynamics(q, np.zeros(arm.nv), np.zeros(arm.nv))) + 0.1
    run = {"dt": 1e-2, "steps": 1000, "record_every": 100, "friction": holding}
    path = with_plane(arm).simulate(q, np.zeros(arm.nv), **run)
    assert np.array_equal(path.q, np.tile(q, (11, 1))) and not path.qd.any()
    assert_same(path, arm.simulate(q, np.zeros(arm.nv), **run))


@pytest.mark.parametrize("method", ["auto", "rk4", "semi-implicit-euler", "implicit-euler", "rosenbrock-2", "rosenbrock-3", "dormand-prince-5"])
def test_every_method_has_its_bits_and_its_order(method: str) -> None:
    robot = chain(4)
    q, qd = np.array([0.4, -0.3, 0.5, 0.2]), np.array([1.0, -0.5, 0.3, 0.8])
    assert_same(*(s.simulate(q, qd, dt=2e-3, steps=200, method=method) for s in (with_plane(robot), robot)))


def test_a_far_contact_leaves_the_order_at_four() -> None:
    scene = with_plane(chain(3))
    ends = [scene.simulate([0.4, -0.3, 0.5], [2.0, -1.0, 3.0], dt=0.4 / n, steps=n, method="rk4").q[-1] for n in (80, 160, 320)]
    order = np.log2(np.abs(ends[0] - ends[1]).max() / np.abs(ends[1] - ends[2]).max())
    assert 3.8 < order < 4.8


def test_a_passive_chain_at_ten_milliseconds_does_not_diverge() -> None:
    robot = chain(5)
    q = np.array([0.3, -0.4, 0.5, 0.2, 0.7])
    path, expected = (s.simulate(q, np.linspace(2.0, -2.0, 5), dt=1e-2, steps=1000, record_every=10) for s in (with_plane(robot), robot))
    assert_same(path, expected)
    energy = path.energy().total
    assert np.ptp(energy) < 1e-4 * np.ptp(path.energy().kinetic)


def test_stops_hold_exactly() -> None:
    slide = motion_scenes.slide(lower=-1.0, upper=0.25)
    for restitution in (0.0, 0.6):
        path, expected = (s.simulate([0.0], [1.0], dt=1e-3, steps=600, restitution=restitution) for s in (with_plane(slide), slide))
        assert_same(path, expected)
        assert path.q.max() <= 0.25 and path.stops and abs(path.stops[0].speed - 1.0) < 1e-9


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("floating", [False, True])
def test_random_robots_do_not_notice_a_far_contact(seed: int, floating: bool) -> None:
    robot = motion_scenes.robot(seed, joints=2 + seed % 4, range_of_motion=0.8, floating_base=floating)
    q, qd = motion_scenes.start(robot, seed)
    run = {"dt": [1e-3, 5e-3][seed % 2], "steps": 150, "restitution": 0.3, "record_every": 3}
    kinds = [{}, {"radius": 0.2}, {"normal": (0.3, -0.2, 1.0)}]
    assert_same(with_plane(robot, **kinds[seed % 3]).simulate(q, qd, **run), robot.simulate(q, qd, **run))


def test_a_fast_spinning_body_is_divided_as_without_a_contact() -> None:
    body = box().without_contacts()
    spin = np.array([0, 0, 0, 60.0, 0.5, 40.0])
    path, expected = (s.simulate(at(z=0.0), spin, dt=1e-2, steps=100) for s in (with_plane(body), body))
    assert_same(path, expected)
    assert path.substeps > 1


def test_loops_and_coupled_joints_do_not_notice_a_far_contact() -> None:
    loop = four_bar(-10.0, 10.0)
    q, qd, _ = loop.loops.project([0.5, 0.8, 0.2], [2.0, 0.0, 0.0])
    for run in ({"friction": 0.01}, {"damping": 0.1}, {"method": "rosenbrock-3"}):
        assert_same(*(s.simulate(q, qd, dt=2e-3, steps=300, **run) for s in (with_plane(loop), loop)))
    stopped = four_bar(q[2] - 0.2, q[2] + 0.2)
    assert_same(*(s.simulate(q, qd, dt=1e-3, steps=300, restitution=0.5) for s in (with_plane(stopped), stopped)))
    builder = phipsi.SceneBuilder().link("base")
    for name, parent in (("a", "base"), ("b", "a"), ("c", "b")):
        builder.link(name, 1.0, (0, 0, 0.2), 0.01 * np.eye(3))
        more = {"mimic": "a", "mimic_multiplier": -0.5} if name == "b" else {}
        builder.joint(name, "continuous", parent, name, xyz=(0, 0, 0.4), axis=(0, 1, 0), friction=0.05, **more)
    mimic = builder.build(mimic="couple")
    far = builder.contact("far", "c", friction=0.5, offset=-FAR).build(mimic="couple")
    assert_same(*(s.simulate([0.3, 0.4], [1.0, -1.0], dt=2e-3, steps=300) for s in (far, mimic)))


def test_a_flight_has_the_bits_of_the_free_body_up_to_the_last_step() -> None:
    touching = ball(0.5)
    free = touching.without_contacts()
    start, qd = at(z=1.1), np.array([0.4, 0.0, 0.0, 3.0, 2.0, 1.0])
    path, expected = (s.simulate(start, qd, dt=1e-3, steps=600) for s in (touching, free))
    last = int(np.argmax(expected.q[:, 2] <= 0.1)) - 1
    assert 440 < last < 460
    assert np.array_equal(path.q[: last + 1], expected.q[: last + 1]) and np.array_equal(path.qd[: last + 1], expected.qd[: last + 1])
    assert abs(path.q[last + 1, 2] - 0.1) < 1e-12 and np.abs(path.q[last + 2 :, 2] - 0.1).max() < 1e-9
    assert path.contacts.state["ground"][last + 1] != phipsi.ContactState.OPEN
    audit = path.energy_audit()
    assert abs(audit.remainder) < 2e-2 * np.ptp(path.energy().potential)


def test_states_of_a_batch_take_their_own_steps() -> None:
    scene = box(0.5, 0.3)
    free = scene.without_contacts()
    q = np.stack([at(z=z) for z in (0.1, 0.5, 30.0, 0.1, 2.0, 0.11, 0.3, 40.0, 0.1, 0.7, 50.0)])
    qd = np.random.default_rng(5).normal(size=(len(q), 6)) * [0.3, 0.3, 0.3, 2, 2, 2]
    run = {"dt": 2e-3, "steps": 70, "record_every": 7}
    path = scene.simulate(q, qd, **run)
    for i, (own_q, own_qd) in enumerate(zip(q, qd, strict=True)):
        alone = scene.simulate(own_q, own_qd, **run)
        assert np.array_equal(path.q[i], alone.q) and np.array_equal(path.qd[i], alone.qd)
        assert np.array_equal(path.contacts.force["corner0"][i], alone.contacts.force["corner0"])
        assert np.array_equal(path.contacts.impulse["corner0"][i], alone.contacts.impulse["corner0"])
    high = q[:, 2] > 20.0
    assert np.array_equal(path.q[high], free.simulate(q[high], qd[high], **run).q)
    assert path.contacts.force["corner0"].any()


def test_calls_of_a_simulator_and_copies_take_the_steps_of_one_run() -> None:
    scene = box(0.5, 0.3)
    q, qd = np.stack([at(z=0.3), at(z=5.0), at(z=0.1)]), np.tile([0.3, 0, 0, 1.0, 0.5, 0], (3, 1))
    expected = scene.simulate(q, qd, dt=2e-3, steps=150)
    simulator = scene.simulator(q, qd, dt=2e-3)
    for steps in (1, 40, 3, 56):
        simulator.step(steps=steps)
    for other in (simulator, copy.copy(simulator), pickle.loads(pickle.dumps(simulator))):
        other.step(steps=50)
        assert np.array_equal(other.q, expected.q[:, -1]) and np.array_equal(other.qd, expected.qd[:, -1])


def rod() -> phipsi.SceneBuilder:
    """A rod of 1 m about a horizontal axis at the height 0.99 m."""
    builder = phipsi.SceneBuilder().link("base").link("rod", 1.0, (0, 0, -0.5), np.diag([1 / 12, 1 / 12, 1e-3]))
    return builder.joint("axis", "continuous", "base", "rod", xyz=(0, 0, 0.99), axis=(0, 1, 0))


@pytest.mark.parametrize("method", ["auto", "rk4", "semi-implicit-euler"])
@pytest.mark.parametrize("speed", [30.0, 100.0, 300.0, 628.0])
def test_a_tip_that_passes_the_plane_within_a_step_is_not_missed(speed: float, method: str) -> None:
    # The tip is below the plane for 0.28 rad, less than a step, and above it at both ends.
    scene = rod().contact("tip", "rod", xyz=(0, 0, -1.0), friction=0.1).build(gravity=(0, 0, 0))
    dt = 0.5 / speed
    path = scene.simulate([-0.25 - 5 * 0.5], [speed], dt=dt, steps=8, method=method)
    assert (path.contacts.state["tip"] != phipsi.ContactState.OPEN).any() and path.contacts.force["tip"].any()
    assert abs(path.qd[-1, 0]) < 0.9 * speed and (path.contacts.gap["tip"] > -1e-6).all()


def test_a_tip_that_passes_another_body_within_a_step_is_not_missed() -> None:
    builder = rod().link("block", 1.0, inertia=0.01 * np.eye(3))
    builder.joint("rail", "prismatic", "base", "block", axis=(0, 0, 1))
    builder.contact("tip", "rod", xyz=(0, 0, -1.0), friction=0.1, other="block", other_size=(0.1, 0.1, 0.1))
    scene = builder.build(gravity=(0, 0, 0))
    path = scene.simulate([-0.25 - 5 * 0.5, -0.02], [100.0, 0.0], dt=5e-3, steps=8)
    assert path.contacts.force["tip"].any() and abs(path.qd[-1, 0]) < 50.0


def test_a_relaxing_spring_does_not_carry_a_tip_through_a_plane_unseen() -> None:
    # An implicit step ends far from its start with small velocities at both ends.
    scene = rod().contact("tip", "rod", xyz=(0, 0, -1.0), friction=0.0).build(gravity=(0, 0, 0))
    path = scene.simulate([-0.3], [0.0], dt=1e-2, steps=3, rest=[0.3], stiffness=1e9, damping=1e6)
    assert path.contacts.force["tip"].any() and path.q[-1, 0] < 0.0


def test_gradients_of_a_flight_are_those_of_the_free_body() -> None:
    robot = chain(4)
    q, qd = np.array([0.4, -0.3, 0.5, 0.2]), np.array([1.0, -0.5, 0.3, 0.8])
    by_q = np.random.default_rng(3).normal(size=(61, 4))
    for more in ({}, {"friction": 0.05}, {"friction": 30.0}, {"stiffness": 2.0, "damping": 0.3}, {"record_every": 10}):
        rows = by_q[:: more.get("record_every", 1)]
        paths = [s.simulate(q, qd, dt=2e-3, steps=60, **more) for s in (with_plane(robot), robot)]
        assert_same(*paths)
        found, expected = (path.vjp(rows) for path in paths)
        for name in ("q", "qd", "tau", "damping", "friction", "armature"):
            mine, other = getattr(found, name), getattr(expected, name)
            assert np.abs(mine - other).max() <= tolerances.CONTACT * max(1.0, np.abs(other).max()), name
        assert found.mode_changes == [] and found.contacts["far"].friction == 0.0 and found.contacts["far"].margin > 1.0


def test_gradients_of_a_flight_and_a_slide_are_differences() -> None:
    scene = ball(0.3)
    start, qd = at(z=0.15), np.array([1.0, 0.2, 0.0, 0.0, 1.0, 0.0])

    def end(dqd: np.ndarray) -> np.ndarray:
        return scene.simulate(start, qd + dqd, dt=1e-3, steps=200).q[-1, :2]

    path = scene.simulate(start, qd, dt=1e-3, steps=200)
    states = path.contacts.state["ground"]
    assert (states[:90] == phipsi.ContactState.OPEN).all() and states[-1] != phipsi.ContactState.OPEN
    # Cotangents of a free joint are in the axes of the body: this is R* (1, 0.5, 0).
    x, y, z, w = path.q[-1, 3:]
    rotation = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]])
    by_q = np.zeros((201, 6))
    by_q[-1, :3] = np.array([1.0, 0.5]) @ rotation
    found = path.vjp(by_q)
    assert found.mode_changes and np.isfinite(found.contacts["ground"].margin)
    for row in (0, 1, 3, 4):
        step = np.zeros(6)
        step[row] = 1e-6
        slope = ((end(step) - end(-step)) / 2e-6) @ [1.0, 0.5]
        assert abs(found.qd[row] - slope) <= 1e-5 * max(1.0, abs(slope)), row


def test_gradients_of_a_loop_with_a_far_contact_are_those_of_the_loop() -> None:
    loop = four_bar(-10.0, 10.0)
    q, qd, _ = loop.loops.project([0.5, 0.8, 0.2], [2.0, 0.0, 0.0])
    by_q = np.random.default_rng(4).normal(size=(41, 3))
    found, expected = (s.simulate(q, qd, dt=2e-3, steps=40).vjp(by_q) for s in (with_plane(loop), loop))
    for name in ("q", "qd", "tau"):
        mine, other = getattr(found, name), getattr(expected, name)
        assert np.abs(mine - other).max() <= tolerances.CONTACT * max(1.0, np.abs(other).max()), name


def test_the_contact_method_is_that_of_every_step() -> None:
    scene = with_plane(chain(3))
    run = {"dt": 1e-3, "steps": 50}
    contact, auto = (scene.simulate([0.4, -0.3, 0.5], [2.0, -1.0, 3.0], method=method, **run) for method in ("contact", "auto"))
    assert (contact.integrator, auto.integrator) == ("contact", "rk4")
    assert 1e-6 < np.abs(contact.q[-1] - auto.q[-1]).max() < 1e-2
    assert contact.friction_speed == auto.friction_speed == 0.01
    with pytest.raises(ArgumentError, match=r'method: found "rk4" with smoothing'):
        scene.simulate([0.4, -0.3, 0.5], np.zeros(3), method="rk4", smoothing=1e-3, **run)


def test_a_motion_that_diverges_far_from_contacts_has_the_error_of_the_free_scene() -> None:
    robot = chain(3)
    texts = []
    for scene in (with_plane(robot), robot):
        with pytest.raises(SimulationError) as found:
            scene.simulate(np.zeros((2, 3)), np.stack([np.zeros(3), [30.0, -30.0, 10.0]]), dt=1e-1, steps=300, method="semi-implicit-euler")
        texts.append((str(found.value), found.value.step, found.value.state))
    assert texts[0] == texts[1]
