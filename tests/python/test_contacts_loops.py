"""Contacts on robots with connections or mimic joints, and contacts between two links: dense steps from the
definitions, closed forms, conservation laws, and refused arguments.
"""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from test_cassie import STIFFNESS, biped

import phipsi
from phipsi.errors import ArgumentError, NotFiniteError, SceneError, ShapeError, SimulationError

G = 9.81
SLIDES, STICKS, OPEN = phipsi.ContactState.SLIDING, phipsi.ContactState.STICKING, phipsi.ContactState.OPEN


def pose(x: float, y: float = 0.0, z: float = 0.0) -> list[float]:
    return [x, y, z, 0.0, 0.0, 0.0, 1.0]


# A leg that is a closed loop


def leg(
    friction: float = 0.8, restitution: float = 0.0, *, joints: tuple[str, ...] = ("thigh", "crank"), shift: float = 0.0, stop: float = np.inf
) -> phipsi.Scene:
    """A hip on a vertical rail. Thigh and crank are joints below it; a rod ties the crank to the shank, whose end is the
    foot: a four-bar in the plane y = 0. `joints`: the order of the two branches. `stop`: limit of the thigh about -0.4.
    """
    builder = phipsi.SceneBuilder().link("world").link("hip", mass=3.0, inertia=0.02 * np.eye(3))
    builder.joint("rail", "prismatic", "world", "hip", axis=(0, 0, 1), xyz=(shift, 0, 0))

    def bar(name: str, parent: str, xyz: tuple[float, float, float], length: float, mass: float) -> None:
        builder.link(name, mass=mass, com=(0, 0, -length / 2), inertia=mass * length**2 / 12 * np.diag([1, 1, 0.02]))
        limits = {"lower": -0.4 - stop, "upper": -0.4 + stop} if name == "thigh" and np.isfinite(stop) else {}
        builder.joint(name, "revolute" if limits else "continuous", parent, name, xyz=xyz, axis=(0, 1, 0), damping=0.05, **limits)

    for joint in joints:
        if joint == "thigh":
            bar("thigh", "hip", (0, 0, 0), 0.3, 0.8)
            bar("shank", "thigh", (0, 0, -0.3), 0.4, 0.5)
        else:
            bar("crank", "hip", (0.1, 0, 0), 0.3, 0.4)
    builder.connect("tie", "distance", "crank", "shank", xyz=(0, 0, -0.3), other_xyz=(0.1, 0, 0.02), length=0.06)
    for i, y in enumerate((-0.05, 0.05)):
        builder.contact(f"foot{i}", "shank", xyz=(0, y, -0.4), friction=friction, restitution=restitution)
    return builder.build()


def standing(scene: phipsi.Scene) -> np.ndarray:
    """A bent closed configuration with the feet on the ground, which is at z = 0."""
    q = np.zeros(scene.nq)
    q[scene.q_index("thigh")], q[scene.q_index("shank")], q[scene.q_index("crank")] = -0.4, 0.7, -0.35
    q = scene.loops.project(q)[0]
    q[scene.q_index("rail")] -= scene.contacts.gaps(q)[0]
    assert np.abs(scene.loops.error(q)).max() < 1e-12 and np.abs(scene.contacts.gaps(q)).max() < 1e-12
    return q


def foot_jacobian(scene: phipsi.Scene, q: np.ndarray) -> np.ndarray:
    """Rows x, y, z of the two feet, (6, nv), by derivatives of forward kinematics along each joint."""
    rows = [scene.contacts.velocities(q, unit).ravel() for unit in np.eye(scene.nv)]
    return np.array(rows).T


def onto_loop(scene: phipsi.Scene, q: np.ndarray) -> np.ndarray:
    """Newton steps of least kinetic energy onto the connection."""
    for _ in range(8):
        through = np.linalg.solve(scene.mass_matrix(q), scene.loops.jacobian(q).T)
        q = scene.integrate(q, -through @ np.linalg.solve(scene.loops.jacobian(q) @ through, scene.loops.error(q)))
    return q


@pytest.mark.parametrize(("friction", "state"), [(0.9, STICKS), (0.05, SLIDES)])
def test_a_step_is_the_dense_solution_of_its_equations(friction: float, state: int) -> None:
    """M (v' - v) = h (tau - bias) + J_k^T lambda + J_c^T p, J_k v' = 0, and the rows of the contact mode; two feet that
    are equally loaded count as one.
    """
    scene = leg(friction)
    free, h, q = scene.without_contacts().without_constraints(), 1e-3, standing(scene)
    tau = np.linspace(-0.3, 0.4, scene.nv)
    path = scene.simulate(q, np.zeros(scene.nv), dt=h, steps=1, tau=tau, friction_speed=1.0)
    told = path.contacts
    assert told is not None and told.residual <= 1e-10 and (told.state["foot0"][1], told.state["foot1"][1]) == (state, state)

    # Damping is implicit.
    mass = free.mass_matrix(q) + h * np.diag(scene.damping)
    loop = scene.loops.jacobian(q)
    feet = foot_jacobian(scene, q)
    feet = 0.5 * (feet[:3] + feet[3:])
    start = np.linalg.solve(mass, h * (tau - free.bias_torque(q, np.zeros(scene.nv))))
    if state == STICKS:
        rows = feet[[0, 2]]
        forces = rows.T
    else:
        # The direction of sliding is that of the solution without friction.
        both = np.vstack([loop, feet[2]])
        through = np.linalg.solve(mass, both.T)
        slip = feet[0] @ (start - through @ np.linalg.solve(both @ through, both @ start))
        rows, forces = feet[2:], (feet[2] - friction * np.sign(slip) * feet[0])[:, None]
    both, push = np.vstack([loop, rows]), np.column_stack([loop.T, forces])
    through = np.linalg.solve(mass, push)
    multipliers = -np.linalg.solve(both @ through, both @ start)
    v = start + through @ multipliers
    ends = onto_loop(free_of(scene), scene.integrate(q, h * v))
    assert np.abs(path.q[1] - ends).max() < 1e-12
    exact = free.mass_matrix(ends)
    loop = scene.loops.jacobian(ends)
    through = np.linalg.solve(exact, loop.T)
    v -= through @ np.linalg.solve(loop @ through, loop @ v)
    assert np.abs(path.qd[1] - v).max() < 1e-11 * np.abs(v).max()
    force = (told.force["foot0"] + told.force["foot1"])[1]
    expected = [multipliers[1], multipliers[2]] if state == STICKS else [-friction * np.sign(slip) * multipliers[1], multipliers[1]]
    assert np.allclose(force[[0, 2]] * h, expected, rtol=1e-9, atol=1e-12)


def free_of(scene: phipsi.Scene) -> phipsi.Scene:
    """The same scene with its connections, without contacts; mass matrices are those of the tree."""
    return scene.without_contacts()


def held(scene: phipsi.Scene, q: np.ndarray) -> phipsi.PD:
    """Stiff control of the thigh and the crank."""
    kp = np.zeros(scene.nv)
    kp[scene.v_index("thigh")] = kp[scene.v_index("crank")] = 400.0
    return phipsi.PD(kp, kp / 20.0, q)


def test_a_four_bar_leg_stands_and_its_forces_are_in_balance() -> None:
    scene = leg()
    q = standing(scene)
    path = scene.simulate(q, np.zeros(scene.nv), dt=1e-3, steps=2000, pd=held(scene, q), record_every=100)
    told = path.contacts
    assert told is not None and told.converged and told.residual <= 1e-10
    assert path.drift.max() < 1e-12 and min(gap.min() for gap in told.gap.values()) > -1e-9
    assert np.abs(path.qd[-1]).max() < 1e-8 and np.abs(path.q[-1] - path.q[-2]).max() < 1e-9
    force = told.force["foot0"][-1] + told.force["foot1"][-1]
    assert np.isclose(force[2], scene.total_mass * G, rtol=1e-6)
    # Static equilibrium of the tree under torques, contact forces and the force of the connection.
    tree, end = scene.without_contacts().without_constraints(), path.q[-1]
    tie = path.constraint_forces()["tie"][-1]
    feet = np.concatenate([told.force["foot0"][-1], told.force["foot1"][-1]])
    balance = path.torques()[-1] + foot_jacobian(scene, end).T @ feet + scene.loops.jacobian(end).T @ tie
    assert np.abs(balance - tree.gravity_torque(end)).max() < 1e-5


def test_a_joint_stop_holds_a_loop_on_the_ground() -> None:
    """Without motors the leg gives way until the thigh is at its stop, and rests."""
    scene = leg(stop=0.05)
    q = standing(scene)
    path = scene.simulate(q, np.zeros(scene.nv), dt=1e-3, steps=1500, record_every=50)
    told, thigh = path.contacts, path.q[:, scene.q_index("thigh")][:, 0]
    assert told is not None and told.converged and told.residual <= 1e-10
    assert np.abs(thigh + 0.4).max() < 0.05 + 1e-9 and abs(abs(thigh[-1] + 0.4) - 0.05) < 1e-9
    assert np.abs(path.qd[-1]).max() < 1e-6 and path.drift.max() < 1e-12
    assert min(gap.min() for gap in told.gap.values()) > -1e-9
    assert [impact.joint for impact in path.stops][:1] == ["thigh"]


def test_a_loop_dropped_on_its_feet_never_gains_energy_in_impacts() -> None:
    """Random closed states with the feet on the ground that approach it, in steps that are too short for other forces
    to act: the kinetic energy does not increase, and the loop stays closed.
    """
    random = np.random.default_rng(3)
    for _ in range(60):
        scene = leg(random.choice([0.0, 0.3, 1.0]), random.choice([0.0, 0.5, 1.0]))
        q = np.zeros(scene.nq)
        q[scene.q_index("thigh")], q[scene.q_index("shank")], q[scene.q_index("crank")] = -0.4, 0.7, -0.35
        q, qd, _ = scene.loops.project(q + random.uniform(-0.1, 0.1, scene.nq), random.normal(size=scene.nv))
        assert qd is not None
        q[scene.q_index("rail")] -= scene.contacts.gaps(q)[0]
        path = scene.simulate(q, qd, dt=1e-9, steps=1)
        before, after = scene.kinetic_energy(q, qd), scene.kinetic_energy(path.q[1], path.qd[1])
        assert after <= before * (1.0 + 1e-6) and path.drift.max() < 1e-12
        assert path.contacts is not None and path.contacts.residual <= 1e-10
        if scene.contacts.velocities(q, qd)[0, 2] < -1e-3:
            assert path.contacts.state["foot0"][1] != OPEN
            assert scene.contacts.velocities(path.q[1], path.qd[1])[0, 2] > -1e-6


def test_the_order_of_joints_and_the_position_of_the_base_do_not_matter() -> None:
    first = leg()
    q = standing(first)
    path = first.simulate(q, np.zeros(first.nv), dt=1e-3, steps=200, pd=held(first, q), tau=np.array([5.0, 1.0, 0, 0]))
    for other in (leg(joints=("crank", "thigh")), leg(shift=10.0)):
        order = [other.v_index(joint).start for joint in first.joint_names]
        there, tau = np.zeros(4), np.zeros(4)
        there[order], tau[order] = q, [5.0, 1.0, 0, 0]
        again = other.simulate(there, np.zeros(4), dt=1e-3, steps=200, pd=held(other, there), tau=tau)
        assert np.abs(again.q[:, order] - path.q).max() < 1e-9
        assert path.contacts is not None and again.contacts is not None
        assert np.allclose(again.contacts.force["foot0"], path.contacts.force["foot0"], atol=1e-4)


def test_batches_pickles_and_simulators_are_the_same_motion() -> None:
    scene = leg()
    q = standing(scene)
    starts = np.stack([q, scene.loops.project(q + 0.01)[0]])
    law = phipsi.PD(held(scene, q).kp, held(scene, q).kd, starts)
    path = scene.simulate(starts, np.zeros((2, scene.nv)), dt=1e-3, steps=20, pd=law)
    for state in range(2):
        alone = scene.simulate(starts[state], np.zeros(scene.nv), dt=1e-3, steps=20, pd=phipsi.PD(law.kp, law.kd, starts[state]))
        assert np.array_equal(alone.q, path.q[state])
    simulator = copy.deepcopy(pickle.loads(pickle.dumps(scene))).simulator(starts, np.zeros((2, scene.nv)), dt=1e-3, pd=law)
    for _ in range(20):
        simulator.step()
    assert np.array_equal(simulator.q, path.q[:, -1])


def test_a_biped_with_closed_legs_stands() -> None:
    """Cassie's legs with a foot plate of four points each, held by its motors: it does not sink or drift in 1 s."""
    builder = biped(True).to_builder()
    bare = biped(True)
    q = bare.neutral()
    places, center = bare.placements(q), bare.center_of_mass(q)
    low = min(places[f"{side} sole"][2, 3] for side in ("left", "right")) - 0.05
    for side in ("left", "right"):
        sole = places[f"{side} sole"]
        for i, (dx, dy) in enumerate([(-0.12, -0.04), (-0.12, 0.04), (0.12, -0.04), (0.12, 0.04)]):
            point = sole[:3, :3].T @ (np.array([center[0] + dx, sole[1, 3] + dy, low]) - sole[:3, 3])
            builder.contact(f"{side}{i}", f"{side} sole", xyz=point, offset=low, friction=0.8)
    scene = builder.build().with_properties(
        stiffness={f"{side} spring": STIFFNESS for side in ("left", "right")}, damping={f"{side} spring": 100.0 for side in ("left", "right")}
    )
    kp = np.zeros(scene.nv)
    for side in ("left", "right"):
        for motor in ("roll", "yaw", "pitch", "knee", "foot"):
            kp[scene.v_index(f"{side} {motor}")] = 8000.0
    law = phipsi.PD(kp, kp / 20, q)
    settled = scene.simulate(q, np.zeros(scene.nv), dt=1e-3, steps=2000, pd=law, record_every=2000)
    path = scene.simulate(settled.q[-1], settled.qd[-1], dt=1e-3, steps=1000, pd=law, record_every=100)
    told = path.contacts
    assert told is not None and told.converged and told.residual <= 1e-10
    assert path.drift.max() < 1e-11 and min(gap.min() for gap in told.gap.values()) > -1e-9
    assert np.abs(path.q - path.q[0]).max() < 1e-6 and np.abs(path.qd[-1]).max() < 1e-7
    assert np.isclose(sum(told.force.values())[-1][2], scene.total_mass * G, rtol=1e-7)


def test_compliant_connections_are_refused() -> None:
    scene = leg()
    q = standing(scene)
    with pytest.raises(ArgumentError, match="compliance.*contacts"):
        scene.simulate(q, np.zeros(scene.nv), dt=1e-3, steps=1, compliance=np.array([1e-3]))


# A gripper with a mimic joint


CUBE, WEIGHT = 0.04, 0.5


def gripper(friction: float, *, mimic: bool = True, closed: float = 0.0) -> phipsi.Scene:
    """A palm on a vertical rail with two fingers, the second of which follows the first, and a free box between them.
    Coordinates: rail, left finger, (right finger), box.
    """
    builder = phipsi.SceneBuilder().link("world").link("palm", mass=1.0, inertia=0.01 * np.eye(3))
    builder.joint("rail", "prismatic", "world", "palm", axis=(0, 0, 1))
    for side, name in ((-1.0, "left"), (1.0, "right")):
        builder.link(name, mass=0.1, inertia=1e-4 * np.eye(3))
        follows = {"mimic": "left"} if name == "right" and mimic else {}
        builder.joint(name, "prismatic", "palm", name, axis=(-side, 0, 0), xyz=(side * (CUBE / 2 + closed), 0, 0), **follows)
    inertia = WEIGHT / G * CUBE**2 / 6 * np.eye(3)
    builder.link("box", mass=WEIGHT / G, inertia=inertia).joint("free", "floating", "world", "box")
    if not mimic:
        builder.couple("gear", "right", "left")
    for name in ("left", "right"):
        for i, (y, z) in enumerate([(-0.01, -0.01), (-0.01, 0.01), (0.01, -0.01), (0.01, 0.01)]):
            builder.contact(f"{name}{i}", name, xyz=(0, y, z), friction=friction, other="box", other_size=[CUBE] * 3)
    return builder.build(mimic="couple" if mimic else None)


def grip(scene: phipsi.Scene, force: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, phipsi.PD]:
    """Start with the box between the fingers, the torque of the first finger, and stiff control of the rail."""
    q, tau, kp = scene.neutral(), np.zeros(scene.nv), np.zeros(scene.nv)
    tau[scene.v_index("left")] = force
    kp[scene.v_index("rail")] = 1e5
    return q, np.zeros(scene.nv), tau, phipsi.PD(kp, kp / 50, q)


@pytest.mark.parametrize("mimic", [True, False])
@pytest.mark.parametrize(("excess", "falls"), [(1.001, False), (0.999, True)])
def test_a_gripper_holds_a_box_up_to_the_limit_of_friction(excess: float, falls: bool, mimic: bool) -> None:
    """Each finger presses with F/2 and carries at most mu F/2: the box falls with g (1 - mu F / (m g)) below that."""
    force, mu = 4.0, excess * WEIGHT / 4.0
    scene = gripper(mu, mimic=mimic)
    scene = scene.lock(["rail"], scene.neutral())
    tau = np.zeros(scene.nv)
    tau[scene.v_index("left")] = force
    path = scene.simulate(scene.neutral(), np.zeros(scene.nv), dt=1e-3, steps=100, tau=tau)
    told = path.contacts
    assert told is not None and told.residual <= 1e-10
    assert abs(path.qd[-1, scene.v_index("free")][2] + falls * G * (1.0 - excess) * 0.1) < 1e-9
    press = sum(told.force[f"left{i}"][-1, 0] for i in range(4))
    assert np.isclose(press, -force / 2, rtol=1e-6)
    assert {told.state["left0"][-1]} == {SLIDES if falls else STICKS}
    assert np.isclose(sum(f[-1, 2] for f in told.force.values()), -WEIGHT * min(1.0, excess), rtol=1e-4)


def test_a_mimic_joint_and_a_coupling_of_joints_are_the_same_motion() -> None:
    paths = []
    for mimic in (True, False):
        scene = gripper(0.4, mimic=mimic, closed=0.01)
        q, qd, tau, law = grip(scene, 4.0)
        q[scene.q_index("free")][2] = 0.0
        path = scene.simulate(q, qd, dt=1e-3, steps=150, tau=tau, pd=law)
        box = path.q[:, scene.q_index("free")]
        paths.append((box, path.q[:, scene.q_index("left")]))
    assert np.abs(paths[0][0] - paths[1][0]).max() < 1e-9 and np.abs(paths[0][1] - paths[1][1]).max() < 1e-9


def test_a_limit_of_a_joint_that_cannot_move_is_no_row() -> None:
    """A joint that follows another with multiplier 0 stays at its limit; the other one falls onto the ground."""
    builder = phipsi.SceneBuilder().link("world")
    for name, follows in (("a", {}), ("b", {"mimic": "a", "mimic_multiplier": 0.0})):
        builder.link(name, mass=1.0, inertia=0.01 * np.eye(3))
        builder.joint(name, "prismatic", "world", name, axis=(0, 0, 1), lower=0.0, upper=1.0, **follows)
    scene = builder.contact("ground", "a", friction=0.5, offset=0.1).build(mimic="couple")
    path = scene.simulate([0.3], [0.0], dt=1e-3, steps=400)
    assert abs(path.q[-1, 0] - 0.1) < 1e-12 and path.contacts is not None and path.contacts.residual <= 1e-10
    assert np.isclose(path.contacts.force["ground"][-1, 2], G)


def test_a_gripper_lifts_a_box() -> None:
    scene = gripper(0.5)
    q, qd, tau, law = grip(scene, 8.0)
    target = q.copy()
    target[scene.q_index("rail")] = 0.1
    path = scene.simulate(q, qd, dt=1e-3, steps=1500, tau=tau, pd=phipsi.PD(law.kp / 200, law.kp / 1500, target))
    box = scene.q_index("free")
    lifted = path.q[-1, box][2] - path.q[-1, scene.q_index("rail")][0]
    assert path.q[-1, box][2] > 0.04 and abs(lifted) < 1e-6
    followed = path.q[:, scene.q_index("left")]
    assert path.q.shape[1] == scene.nq == 9 and np.abs(followed).max() < 1e-9
    assert scene.contacts.gaps(path.q[-1]).min() > -1e-9
    assert np.abs(scene.contacts.velocities(path.q[-1], path.qd[-1])).max() < 1e-6


# Contacts between two links


def balls(masses: tuple[float, float] = (1.0, 2.0), *, friction: float = 0.0, restitution: float = 1.0, swap: bool = False) -> phipsi.Scene:
    """Two free balls of radius 0.1, without gravity."""
    builder = phipsi.SceneBuilder().link("world")
    for name, mass in zip("ab", masses, strict=True):
        builder.link(name, mass=mass, inertia=0.4 * mass * 0.1**2 * np.eye(3)).joint(name, "floating", "world", name)
    first, second = ("b", "a") if swap else ("a", "b")
    builder.contact("hit", first, friction=friction, radius=0.1, restitution=restitution, other=second, other_radius=0.1)
    return builder.build(gravity=(0, 0, 0))


@pytest.mark.parametrize("restitution", [0.0, 0.3, 1.0])
def test_balls_collide_as_in_closed_form(restitution: float) -> None:
    """Head on and obliquely without friction: Newton's law along the line of centers, and the other velocities keep
    their values. In the closed form, m = m1 m2 / (m1 + m2).
    """
    m1, m2 = 1.0, 2.0
    scene = balls((m1, m2), restitution=restitution)
    for angle in (0.0, 0.5, 1.2):
        n = np.array([np.cos(angle), np.sin(angle), 0.0])
        q = np.array(pose(0, 0, 0) + pose(*(0.2 * n)))
        u1, u2 = np.array([2.0, 0.3, -0.4]), np.array([-1.0, 0.1, 0.2])
        path = scene.simulate(q, np.concatenate([u1, np.zeros(3), u2, np.zeros(3)]), dt=1e-4, steps=1)
        impulse = (1.0 + restitution) * m1 * m2 / (m1 + m2) * ((u1 - u2) @ n) * n
        assert np.allclose(path.qd[1], np.concatenate([u1 - impulse / m1, np.zeros(3), u2 + impulse / m2, np.zeros(3)]), atol=1e-12)
        told = path.contacts
        assert told is not None
        # The impulse is that on the first link; without a rebound it is a force during the step.
        assert np.allclose(told.impulse["hit"][1] + 1e-4 * told.force["hit"][1], -impulse, atol=1e-12)


def test_an_oblique_collision_with_friction_keeps_momentum() -> None:
    """The impulse is in the cone and acts at one point of both balls: linear and angular momentum are conserved."""
    scene = balls((1.0, 2.0), friction=0.3, restitution=0.7)
    random = np.random.default_rng(5)
    for _ in range(20):
        n = random.normal(size=3)
        q = np.array(pose(*random.normal(size=3)) + pose(0))
        q[7:10] = q[:3] + 0.2 * n / np.linalg.norm(n)
        qd = random.normal(size=12)
        path = scene.simulate(q, qd, dt=1e-9, steps=1)
        assert np.abs(path.momentum()[1] - path.momentum()[0]).max() < 1e-7
        assert np.abs(path.momentum()[1, 3:] - path.momentum()[0, 3:]).max() < 1e-12
        assert scene.kinetic_energy(path.q[1], path.qd[1]) <= scene.kinetic_energy(q, qd) * (1.0 + 1e-7)
        told = path.contacts
        assert told is not None and told.residual <= 1e-10
        impulse = told.impulse["hit"][1]
        along = -impulse @ n / np.linalg.norm(n)
        assert along >= 0.0 and np.linalg.norm(impulse + along * n / np.linalg.norm(n)) <= 0.3 * along * (1.0 + 1e-9) + 1e-15


def test_the_order_of_two_balls_does_not_matter() -> None:
    q, qd = np.array(pose(0, 0, 0) + pose(0.25, 0.05, 0.02)), np.array([3.0, 0, 0, 0, 0, 5.0, 0, 0, 0, 1.0, 0, 0])
    first, second = (balls(friction=0.4, restitution=0.6, swap=swap).simulate(q, qd, dt=1e-4, steps=400) for swap in (False, True))
    # The force acts at the nearest point of the first link: the points differ by the gap at the start of the step.
    assert np.abs(first.qd - second.qd).max() < 2e-3 and np.abs(first.qd[-1] - qd).max() > 0.5
    assert first.contacts is not None and second.contacts is not None
    assert np.allclose(first.contacts.impulse["hit"], -second.contacts.impulse["hit"], atol=1e-3)


def cart(surface: dict[str, object], *, at: tuple[float, float, float] = (0, 0, 0), link: str | None = "cart", gravity: float = G) -> phipsi.Scene:
    """A ball of radius 0.1 on a cart on a rail."""
    builder = phipsi.SceneBuilder().link("world").link("cart", mass=3.0, inertia=np.eye(3)).joint("rail", "prismatic", "world", "cart", axis=(1, 0, 0))
    builder.link("ball", mass=0.5, inertia=0.4 * 0.5 * 0.1**2 * np.eye(3)).joint("free", "floating", "world", "ball")
    builder.contact("on", "ball", friction=0.6, radius=0.1, other=link, other_xyz=at, **surface)
    return builder.build(gravity=(0, 0, -gravity))


SURFACES = pytest.mark.parametrize(
    ("surface", "at"),
    [({}, (0, 0, 0.05)), ({"normal": (0, 0, 2), "offset": 0.02}, (0, 0, 0.03)), ({"other_size": (2.0, 1.0, 0.1)}, (0, 0, 0))],
    ids=["plane", "offset", "box"],
)


@SURFACES
def test_a_ball_rolls_on_an_accelerated_cart(surface: dict[str, object], at: tuple[float, float, float]) -> None:
    """Rolling without slip, a uniform ball accelerates with 2/7 of the acceleration of the cart, and its force on the
    cart is the reaction.
    """
    scene = cart(surface, at=at)
    q = np.concatenate([[0.0], pose(0, 0, 0.15)])
    assert np.abs(scene.contacts.gaps(q)).max() < 1e-15
    a = 2.0
    tau = np.zeros(7)
    tau[0] = 3.0 * a + 0.5 * 2.0 / 7.0 * a
    path = scene.simulate(q, np.zeros(7), dt=1e-3, steps=300, tau=tau)
    # The velocity of the ball is in its own axes, which rotate.
    speed = np.linalg.norm(path.qd[-1, 1:4])
    assert np.allclose([path.qd[-1, 0], speed], [a * 0.3, 2.0 / 7.0 * a * 0.3], rtol=1e-9)
    assert np.isclose(path.qd[-1, 5], -(path.qd[-1, 0] - speed) / 0.1, rtol=1e-9)
    told = path.contacts
    assert told is not None
    assert np.allclose(told.force["on"][1:], [0.5 * 2.0 / 7.0 * a, 0, 0.5 * G], rtol=1e-8, atol=1e-9)
    assert (told.state["on"][1:] == STICKS).all() and told.residual <= 1e-10
    assert np.abs(told.slip["on"]).max() < 1e-9


def test_a_box_that_does_not_move_is_a_plane() -> None:
    """The same motion as with a plane of the world, and as with a box or plane of the world."""
    q, qd = np.concatenate([[0.0], pose(0, 0, 0.3)]), np.array([0.0, 0.5, 0.2, 0, 1.0, 2.0, 3.0])
    scenes = [
        cart({"offset": 0.05}, link=None), cart({}, at=(0, 0, 0.05), link=None), cart({"other_size": (2.0, 1.0, 0.1)}, link=None),
        cart({}, at=(0, 0, 0.05)).lock(["rail"], np.concatenate([[0.0], pose(0)])), cart({"other_size": (2.0, 1.0, 0.1)}).lock(["rail"], np.concatenate([[0.0], pose(0)])),
    ]  # fmt: skip
    paths = [scene.simulate(q[-scene.nq :], qd[-scene.nv :], dt=1e-3, steps=400) for scene in scenes]
    for path in paths[1:]:
        assert np.abs(path.q[:, -7:] - paths[0].q[:, -7:]).max() < 1e-10


def test_a_ball_falls_off_the_edge_of_a_box() -> None:
    """Beyond the face it pivots about the edge, whose normal is toward the center of the ball, and then falls."""
    scene = cart({"other_size": (2.0, 1.0, 0.1)}, link=None)
    q, qd = np.concatenate([[0.0], pose(0.9, 0, 0.15)]), np.array([0, 0.4, 0, 0, 0, 4.0, 0])
    path = scene.simulate(q, qd, dt=1e-3, steps=1200)
    told = path.contacts
    assert told is not None and told.gap["on"].min() > -1e-6 and told.converged
    past = path.q[:, 1] > 1.0
    touching = past & (told.state["on"] != OPEN)
    assert touching.any() and path.q[-1, 3] < -0.5
    center = path.q[touching][:, 1:4] - [1.0, 0.0, 0.05]
    assert np.abs(np.linalg.norm(center, axis=1) - 0.1).max() < 1e-3
    energy = path.energy().total
    assert (np.diff(energy) < 1e-3).all()


def test_a_box_lands_on_another_box() -> None:
    """A cube that falls onto a larger one, which stands on the ground: both come to rest, and the forces are the
    weights that they carry.
    """
    builder = phipsi.SceneBuilder().link("world")
    for name, edge in (("low", 0.2), ("high", 0.1)):
        builder.link(name, mass=2.0, inertia=2.0 / 6 * edge**2 * np.eye(3)).joint(name, "floating", "world", name)
        for i in range(8):
            corner = (np.array([i & 1, i >> 1 & 1, i >> 2 & 1]) - 0.5) * edge
            surface = {"other": "low", "other_size": (0.2, 0.2, 0.2)} if name == "high" else {}
            builder.contact(f"{name}{i}", name, xyz=corner, friction=0.6, **surface)
    scene = builder.build()
    q = np.array(pose(0, 0, 0.1) + pose(0.03, 0.02, 0.28))
    q[10:14] = np.array([0.03, -0.05, 0.1, 1.0]) / np.linalg.norm([0.03, -0.05, 0.1, 1.0])
    path = scene.simulate(q, np.zeros(12), dt=1e-3, steps=800)
    told = path.contacts
    assert told is not None and told.residual <= 1e-8 and told.depth < 1e-4
    assert np.abs(path.qd[-1]).max() < 1e-6 and abs(path.q[-1, 9] - 0.25) < 1e-6
    up = sum(told.force[f"high{i}"][-1] for i in range(8))
    down = sum(told.force[f"low{i}"][-1] for i in range(8))
    assert np.allclose(up, [0, 0, 2 * G], atol=1e-4) and np.allclose(down, [0, 0, 4 * G], atol=1e-4)


def test_velocities_are_relative_and_differences_of_gaps() -> None:
    """The normal velocity of a pair is the derivative of its gap."""
    random = np.random.default_rng(1)
    for scene in (balls(), cart({"other_size": (0.4, 0.3, 0.2)}), cart({"normal": (1, 2, 3)})):
        for _ in range(5):
            q, qd = scene.integrate(scene.neutral(), random.normal(size=scene.nv)), random.normal(size=scene.nv)
            h = 1e-6
            rate = (scene.contacts.gaps(scene.integrate(q, h * qd)) - scene.contacts.gaps(scene.integrate(q, -h * qd))) / (2 * h)
            gradient = np.array([(scene.contacts.gaps(scene.integrate(q, h * e)) - scene.contacts.gaps(scene.integrate(q, -h * e))) / (2 * h) for e in np.eye(scene.nv)])
            assert np.allclose(rate, gradient.T @ qd, atol=1e-7)
            # The tangential part does not change the gap: the velocity along the normal alone does.
            v = scene.contacts.velocities(q, qd)[0]
            assert abs(rate[0]) <= np.linalg.norm(v) + 1e-7


def test_descriptions_of_pairs_survive_copies() -> None:
    scene = cart({"other_size": (0.4, 0.3, 0.2), "other_rpy": (0.1, 0.2, 0.3)}, at=(0.1, 0.2, 0.3))
    q = np.concatenate([[0.3], pose(0.2, 0.1, 0.5)])
    for other in (pickle.loads(pickle.dumps(scene)), copy.deepcopy(scene), scene.to_builder().build(), pickle.loads(pickle.dumps(scene.to_builder())).build(gravity=(0, 0, -G))):
        assert np.array_equal(other.contacts.gaps(q), scene.contacts.gaps(q))
    assert scene.without_contacts().contacts.names == ()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"other": "bax"}, '"bax"'),
        ({"other": "ball"}, "rigidly attached"),
        ({"other_radius": -0.1}, "radius"),
        ({"other_radius": np.nan}, "radius"),
        ({"other_size": (1, 1, 0)}, "size"),
        ({"other_size": (1, np.inf, 1)}, "size|finite"),
        ({"other_size": (1, 1)}, "size"),
        ({"other_radius": 0.1, "other_size": (1, 1, 1)}, "several surfaces"),
        ({"other_radius": 0.1, "normal": (0, 0, 1)}, "several surfaces"),
        ({"other_size": (1, 1, 1), "offset": 0.1}, "several surfaces"),
        ({"other_rpy": (0, 0, 1), "other_rotation": np.eye(3)}, "rotation"),
        ({"other_rotation": 2 * np.eye(3)}, "rotation"),
        ({"other_xyz": (0, np.nan, 0)}, "finite"),
    ],
)
def test_broken_pairs_are_refused_by_name(options: dict[str, object], message: str) -> None:
    builder = phipsi.SceneBuilder().link("world")
    for name in ("cart", "ball"):
        builder.link(name, mass=1.0, inertia=np.eye(3)).joint(name, "floating", "world", name)
    with pytest.raises((SceneError, ArgumentError, ShapeError), match=message) as caught:
        builder.contact("pair", "ball", **{"friction": 0.5, "other": "cart", **options}).build()
    assert "pair" in str(caught.value)


def test_a_pair_of_links_without_relative_motion_is_refused() -> None:
    builder = phipsi.SceneBuilder().link("world").link("tool").joint("weld", "fixed", "ball", "tool")
    builder.link("ball", mass=1.0, inertia=np.eye(3)).joint("ball", "floating", "world", "ball")
    with pytest.raises(SceneError, match='contact "pair".*rigidly attached'):
        builder.contact("pair", "tool", friction=0.5, other="ball", other_radius=0.1).build()
    with pytest.raises(SceneError, match='contact "pair".*cannot move'):
        phipsi.SceneBuilder().link("world").contact("pair", "world", friction=0.5, other_radius=0.1).build()


def test_spheres_with_one_center_have_no_normal() -> None:
    scene, q = balls(), np.array(pose(0) + pose(0))
    with pytest.raises(NotFiniteError, match="gap"):
        scene.contacts.gaps(q)
    with pytest.raises(SimulationError, match='"hit".*centers coincide'):
        scene.simulate(q, np.zeros(12), dt=1e-3, steps=1)


def test_locking_keeps_pairs_that_can_still_touch() -> None:
    scene = balls()
    q = np.array(pose(0) + pose(0.5))
    assert scene.lock(["b"], q).contacts.names == ("hit",) and scene.lock(["a", "b"], q).contacts.names == ()
    with pytest.raises(SceneError, match='contact "hit".*"a", which cannot move'):
        scene.lock(["a"], q)


def test_forces_are_drawn_at_the_points_of_contact() -> None:
    scene = cart({"other_size": (2.0, 1.0, 0.1)})
    points = scene._contact_points(np.array([[0.3, *pose(0.1, 0.2, 0.15)]]))
    assert np.allclose(points, [[[0.1, 0.2, 0.05]]])


