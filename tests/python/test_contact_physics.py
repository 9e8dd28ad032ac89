"""Contacts compared with mechanics: stops, thresholds of sticking, impacts and rolling in closed form, Painleve's rod,
and the law, momentum and energy of random motions from the recorded impulses.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
import phipsi
import pytest
from phipsi import ContactState
from tolerances import CONTACT, EPS, FAR, assert_near, product

G = 9.81
RADIUS, MASS, MU = 0.1, 0.5, 0.3
"""Of the ball."""


def rotations(q: np.ndarray) -> np.ndarray:
    """Rotation matrices of the quaternions (x, y, z, w) in entries 3 to 6, (..., 3, 3)."""
    x, y, z, w = np.moveaxis(q[..., 3:7], -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def in_base(path: phipsi.Trajectory, entries: slice) -> np.ndarray:
    """Velocities of a free body in the base frame, (..., rows, 3)."""
    return np.einsum("...ij,...j->...i", rotations(path.q), path.qd[..., entries])


def block(mu: float, *, edges: tuple[float, float, float] = (0.4, 0.3, 0.2), restitution: float = 0.0, feet: float = 0.0, mass: float = 2.0,
          corners: int = 8, gravity: tuple[float, float, float] = (0, 0, -G), normal: tuple[float, float, float] = (0, 0, 1)) -> phipsi.Scene:  # fmt: skip
    """A homogeneous block on points, or on spheres of radius `feet`; 4 corners are those at the bottom."""
    a, b, c = edges
    builder = phipsi.SceneBuilder().link("block", mass=mass, inertia=mass / 12 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b]))
    for i in range(corners):
        x, y, z = (a if i & 1 else -a) / 2, (b if i & 2 else -b) / 2, (c if i & 4 else -c) / 2
        builder.contact(f"corner{i}", "block", xyz=(x, y, z + feet), radius=feet, friction=mu, restitution=restitution, normal=normal)
    return builder.build(floating_base=True, gravity=gravity)


def ball(mu: float = MU, restitution: float = 0.0, gravity: tuple[float, float, float] = (0, 0, -G)) -> phipsi.Scene:
    builder = phipsi.SceneBuilder().link("ball", mass=MASS, inertia=0.4 * MASS * RADIUS**2 * np.eye(3))
    return builder.contact("ground", "ball", radius=RADIUS, friction=mu, restitution=restitution).build(floating_base=True, gravity=gravity)


def at(z: float) -> np.ndarray:
    return np.array([0, 0, z, 0, 0, 0, 1.0])


def stop(speed: float, deceleration: float, dt: float) -> float:
    """The distance to the stop of a discrete motion whose velocity decreases by the same amount in each step.

    It differs from speed^2 / (2 deceleration) by at most speed dt / 2.
    """
    whole = int(speed / (deceleration * dt))
    return dt * (whole * speed - deceleration * dt * whole * (whole + 1) / 2)


# Stops.


@pytest.mark.parametrize("feet", [0.0, 0.05])
def test_blocks_stop_after_v_squared_over_two_mu_g(feet: float) -> None:
    random, dt = np.random.default_rng(0), 1e-3
    for _ in range(5):
        mu, speed, heading = random.uniform([0.1, 0.5, 0], [1.0, 3.0, 2 * np.pi])
        scene, along = block(mu, feet=feet, corners=4, mass=random.uniform(0.1, 10)), np.array([np.cos(heading), np.sin(heading)])
        path = scene.simulate(at(0.1), [*speed * along, 0, 0, 0, 0], dt=dt, steps=int(speed / (mu * G * dt)) + 20)
        expected = stop(speed, mu * G, dt)
        assert_near(path.q[-1, :2], expected * along, FAR)
        assert abs(expected - speed**2 / (2 * mu * G)) <= dt * speed / 2
        assert_near(path.qd[-1], np.zeros(6), FAR)
        assert_near(sum(path.contacts.impulse.values()), np.zeros((path.steps + 1, 3)), 0.0)


def test_a_spinning_block_stops_after_the_angle_of_constant_friction_torque() -> None:
    mu, spin, dt = 0.4, 12.0, 1e-3
    scene = block(mu, corners=4)
    lever, inertia = np.hypot(0.2, 0.15), 2.0 / 12 * (0.4**2 + 0.3**2)
    deceleration = mu * 2.0 * G * lever / inertia
    path = scene.simulate(at(0.1), [0, 0, 0, 0, 0, spin], dt=dt, steps=int(spin / (deceleration * dt)) + 20)
    found = 2 * np.arctan2(path.q[-1, 5], path.q[-1, 6])
    assert_near(found, np.asarray(stop(spin, deceleration, dt)), CONTACT)
    assert_near(path.q[-1, :3], at(0.1)[:3], CONTACT)


# Thresholds of sticking. Each is tested at a relative distance of ten tolerances of the solver on both sides.

EDGE = 10 * CONTACT


@pytest.mark.parametrize("side", [-EDGE, EDGE])
@pytest.mark.parametrize("mu", [0.3, 0.5, 1.0, 1.7])
@pytest.mark.parametrize("how", ["gravity", "plane", "push"])
def test_a_block_sticks_up_to_the_friction_angle(how: str, mu: float, side: float) -> None:
    dt, steps, slope = 1e-3, 500, np.arctan(mu * (1 + side))
    sine, cosine = np.sin(slope), np.cos(slope)
    start, still, force = at(0.1), np.zeros(6), np.zeros(6)
    acceleration = G * (sine - mu * cosine)
    if how == "gravity":
        scene = block(mu, corners=4, gravity=(G * sine, 0, -G * cosine))
    elif how == "plane":
        scene = block(mu, corners=4, normal=(sine, 0, cosine))
        start = np.array([0.1 * sine, 0, 0.1 * cosine, 0, np.sin(slope / 2), 0, np.cos(slope / 2)])
    else:
        scene, force[0] = block(mu, corners=4), mu * (1 + side) * 2.0 * G
        acceleration = mu * side * G
    path = scene.simulate(start, still, dt=dt, steps=steps, tau=force)
    assert_near(path.qd[-1, 0], np.asarray(max(acceleration, 0.0) * dt * steps), CONTACT * mu * G * dt * steps)


@pytest.mark.parametrize("side", [-EDGE, EDGE])
def test_a_ball_rolls_down_an_incline_up_to_seven_halves_of_the_friction_angle(side: float) -> None:
    dt, steps, slope = 1e-3, 200, np.arctan(3.5 * MU * (1 + side))
    scene = ball(gravity=(G * np.sin(slope), 0, -G * np.cos(slope)))
    path = scene.simulate(at(RADIUS), np.zeros(6), dt=dt, steps=steps)
    rolling, sliding = 5 / 7 * G * np.sin(slope), G * (np.sin(slope) - MU * np.cos(slope))
    assert_near(in_base(path, slice(3))[-1, 0], np.asarray(max(rolling, sliding) * dt * steps), FAR * G)
    slip = scene.contacts.velocities(path.q[-1], path.qd[-1])[0, 0]
    assert_near(slip, np.asarray(max(sliding - 2.5 * MU * G * np.cos(slope), 0.0) * dt * steps), FAR * G)


@pytest.mark.parametrize("part", [0.5, 1 - EDGE, 1 + EDGE, 2.0])
@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_an_oblique_impact_of_a_ball_sticks_up_to_the_friction_bound(restitution: float, part: float) -> None:
    """A ball that slides during the whole impact loses mu (1 + e) v_n; otherwise it rolls with 5/7 of its speed."""
    down = 1.5
    speed = 3.5 * MU * (1 + restitution) * down * part
    path = ball(MU, restitution, (0, 0, 0)).simulate(at(RADIUS), [speed, 0, -down, 0, 0, 0], dt=1e-3, steps=1)
    along = speed * 5 / 7 if part < 1 else speed - MU * (1 + restitution) * down
    assert_near(in_base(path, slice(3))[-1], np.array([along, 0, restitution * down]), CONTACT * speed)


# Rolling.


def test_a_sliding_ball_rolls_from_two_v_over_seven_mu_g_on_without_losses() -> None:
    speed, dt = 2.0, 1e-3
    path = ball().simulate(at(RADIUS), [speed, 0, 0, 0, 0, 0], dt=dt, steps=3000)
    velocity, rolls = in_base(path, slice(3))[:, 0], 2 * speed / (7 * MU * G)
    last = int(rolls / dt)
    assert_near(velocity[: last + 1], speed - MU * G * path.t[: last + 1], product(last, speed))
    assert_near(velocity[last + 1 :], np.full(path.steps - last, 5 / 7 * speed), FAR)
    state = path.contacts.state["ground"]
    assert (state[1 : last + 1] == ContactState.SLIDING).all() and (state[last + 1 :] == ContactState.STICKING).all()
    energy = path.energy().total
    assert_near(energy[last + 1 :], np.full(path.steps - last, 0.7 * MASS * (5 / 7 * speed) ** 2 + MASS * G * RADIUS), FAR)


def test_a_billiard_ball_with_spin_follows_a_parabola_and_then_a_line() -> None:
    velocity, spin, dt, steps = np.array([1.5, 0.4, 0.0]), np.array([8.0, -15.0, 25.0]), 1e-3, 1000
    path = ball().simulate(at(RADIUS), [*velocity, *spin], dt=dt, steps=steps)
    slip = velocity + np.cross(spin, [0, 0, -RADIUS])
    speed = np.linalg.norm(slip)
    slides = 2 * speed / (7 * MU * G)
    count = np.arange(int(slides / dt) + 1)[:, None]
    drag = MU * G * dt * slip / speed
    assert_near(path.q[count[:, 0], :3] - at(RADIUS)[:3], dt * (count * velocity - count * (count + 1) / 2 * drag), FAR)
    found, turn = in_base(path, slice(3)), in_base(path, slice(3, 6))
    assert_near(found[len(count) :], np.tile(velocity - 2 / 7 * slip, (steps + 1 - len(count), 1)), FAR)
    assert_near(turn[:, 2], np.full(steps + 1, spin[2]), FAR * spin[2])
    assert np.ptp(path.energy().total[len(count) :]) <= FAR


# Impacts of a rocking block.


@pytest.mark.parametrize(("width", "height"), [(0.2, 0.6), (0.3, 0.4), (0.6, 0.2)])
def test_a_rocking_block_lands_as_housner_s(width: float, height: float) -> None:
    """It rotates on about the other edge with 1 - 3/2 sin^2(a) of its speed, or stops if this is negative."""
    scene = block(5.0, edges=(width, 0.3, height), corners=4, gravity=(0, 0, 0))
    spin = 0.8
    # About the edge at x = -width / 2, so that the other edge arrives.
    path = scene.simulate(at(height / 2), [spin * height / 2, 0, -spin * width / 2, 0, spin, 0], dt=1e-4, steps=1)
    kept = max(0.0, 1 - 1.5 * width**2 / (width**2 + height**2)) * spin
    expected = np.array([kept * height / 2, 0, kept * width / 2])
    assert_near(in_base(path, slice(3))[-1], expected, FAR)
    assert_near(path.qd[-1, 3:], np.array([0, kept, 0]), FAR)


# Painleve's rod: with friction above 4/3, a sliding rod can press itself into the ground.


def rod(mu: float, restitution: float = 0.0) -> phipsi.Scene:
    """A homogeneous rod of 2 m and 1 kg in the plane: coordinates x and z of its center, and angle from the vertical."""
    builder = phipsi.SceneBuilder().link("ground").link("across").link("up").link("rod", mass=1.0, inertia=np.diag([1 / 3, 1 / 3, 1e-3]))
    builder.joint("x", "prismatic", "ground", "across", axis=(1, 0, 0)).joint("z", "prismatic", "across", "up", axis=(0, 0, 1))
    builder.joint("turn", "continuous", "up", "rod", axis=(0, 1, 0))
    return builder.contact("tip", "rod", xyz=(0, 0, -1.0), friction=mu, restitution=restitution).build()


def stiffness(angle: float, mu: float) -> float:
    """Normal acceleration of the tip that slides to -x per normal force; negative in the paradox regime."""
    return 1 + 3 * np.sin(angle) * (np.sin(angle) - mu * np.cos(angle))


@pytest.mark.parametrize("dt", [1e-3, 1e-5])
@pytest.mark.parametrize(("mu", "angle"), [(0.5, 0.6), (1.3, 0.45), (1.5, 0.5), (2.0, 0.6), (3.0, 1.0), (2.0, 1.1)])
def test_painleve_s_rod_slides_or_jams_at_once(mu: float, angle: float, dt: float) -> None:
    scene, q, qd = rod(mu), np.array([0, np.cos(angle), angle]), np.array([-3.0, 0, 0])
    path = scene.simulate(q, qd, dt=dt, steps=1)
    force, state = path.contacts.force["tip"][-1], path.contacts.state["tip"][-1]
    paradox = stiffness(angle, mu) < 0
    assert paradox == (mu in (1.5, 3.0) or (mu == 2.0 and angle < 1))
    assert np.diff(path.energy().total)[0] <= 0
    if not paradox:
        # The force of a sliding rod that starts without rotation.
        normal = G / stiffness(angle, mu)
        assert state == ContactState.SLIDING
        # A gap of one rounding error changes the force by that divided by dt^2.
        assert_near(force, np.array([mu * normal, 0, normal]), 64 * EPS / dt**2 / stiffness(angle, mu))
        return
    # No finite force meets the law: an impulse stops the tip, however short the step.
    assert state == ContactState.STICKING
    matrix = scene.mass_matrix(q)
    jacobian = np.array([[1, 0, -np.cos(angle)], [0, 1, np.sin(angle)]])
    free = qd + [0, -G * dt, 0]
    impulse = -np.linalg.solve(jacobian @ np.linalg.solve(matrix, jacobian.T), jacobian @ free)
    assert abs(impulse[0]) <= mu * impulse[1] and impulse[1] > 0.1
    assert_near(force[[0, 2]] * dt, impulse, FAR)
    assert_near(path.qd[-1], free + np.linalg.solve(matrix, jacobian.T @ impulse), FAR)


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_painleve_s_rod_gains_no_energy(restitution: float) -> None:
    """Any friction, angle and rotation, also where sliding, sticking and lifting off all meet the law (slow rotation)."""
    random, count = np.random.default_rng(1), 300
    paradox = 0
    for mu in (1.0, 1.4, 2.0, 5.0):
        angle = random.uniform(-1.4, 1.4, count)
        q = np.stack([np.zeros(count), np.cos(angle), angle], axis=-1)
        spin, slide, fall = random.uniform([[-6], [-4], [-1]], [[6], [4], [0]], (3, count)) * (random.uniform(size=(3, count)) < 0.7)
        # Velocities of the center for a tip that slides with `slide` and arrives with `fall`.
        qd = np.stack([slide + spin * np.cos(angle), fall - spin * np.sin(angle), spin], axis=-1)
        scene = rod(mu, restitution)
        path = scene.simulate(q, qd, dt=1e-5, steps=1)
        free = qd + [0, -G * 1e-5, 0]
        kinetic = path.energy().kinetic[:, 1]
        bound = scene.energy(q, free).kinetic
        assert (kinetic <= bound * (1 + CONTACT)).all()
        assert (path.contacts.residual <= CONTACT).all() and path.contacts.converged.all()
        paradox += int(np.sum(stiffness(angle, -mu * np.sign(slide)) < 0))
    assert paradox > 50


def test_painleve_s_rod_rises_no_higher_than_it_started() -> None:
    """The whole motion: the rod slides, jams, flips and lands again."""
    angle = 0.6
    path = rod(2.0).simulate([0, np.cos(angle), angle], [-3.0, 0, 0], dt=1e-4, steps=3000)
    energy = path.energy().total
    assert np.max(energy) <= energy[0] * (1 + 1e-4) and energy[-1] < 0.9 * energy[0]
    assert path.contacts.converged and path.contacts.gap["tip"].min() >= -CONTACT


# The law, the balance of momentum and the energy of random motions, from the recorded impulses.


def chain(mu: float, restitution: float) -> phipsi.Scene:
    """Four links about oblique axes that fall onto the ground below their base."""
    builder, parent = phipsi.SceneBuilder().link("base"), "base"
    for i in range(4):
        builder.link(f"link{i}", mass=1.0 - 0.1 * i, com=(0, 0, -0.25), inertia=np.diag([0.02, 0.02, 0.004]))
        axis = (1, 0.3, 0) if i % 2 else (0, 1, 0)
        builder.joint(f"joint{i}", "continuous", parent, f"link{i}", xyz=(0, 0, -0.5 if i else 0), axis=axis)
        parent = f"link{i}"
        builder.contact(f"end{i}", parent, xyz=(0, 0, -0.5), friction=mu, restitution=restitution, offset=-0.9)
    return builder.build()


def quadruped(mu: float, restitution: float) -> phipsi.Scene:
    """A trunk on four legs with three joints each; contacts at the feet, the knees and the corners of the trunk."""
    builder = phipsi.SceneBuilder().link("trunk", mass=8.0, inertia=np.diag([0.05, 0.18, 0.2]))
    touch = {"friction": mu, "restitution": restitution}
    for x, y in ((0.2, 0.12), (0.2, -0.12), (-0.2, 0.12), (-0.2, -0.12)):
        leg = f"{'front' if x > 0 else 'rear'}_{'left' if y > 0 else 'right'}"
        builder.link(f"{leg}_hip", mass=0.3, inertia=5e-4 * np.eye(3))
        builder.joint(f"{leg}_abduction", "continuous", "trunk", f"{leg}_hip", xyz=(x, y, 0), axis=(1, 0, 0))
        for part, parent, drop, mass in (("thigh", "hip", 0.0, 0.8), ("shank", "thigh", -0.2, 0.3)):
            builder.link(f"{leg}_{part}", mass=mass, com=(0, 0, -0.1), inertia=mass * np.diag([3.4e-3, 3.4e-3, 4e-4]))
            builder.joint(f"{leg}_{part}", "continuous", f"{leg}_{parent}", f"{leg}_{part}", xyz=(0, 0, drop), axis=(0, 1, 0))
        builder.contact(f"{leg}_foot", f"{leg}_shank", xyz=(0, 0, -0.2), radius=0.025, **touch)
        builder.contact(f"{leg}_knee", f"{leg}_thigh", xyz=(0, 0, -0.2), radius=0.03, **touch)
        builder.contact(f"{leg}_corner", "trunk", xyz=(x, y, -0.06), **touch)
    return builder.build(floating_base=True)


class Steps(NamedTuple):
    """All steps of a batch of trajectories: (steps, ...), with velocities and rows at the configuration at the start."""

    start: np.ndarray
    """Velocities, (steps, nv)."""
    free: np.ndarray
    """Velocities at the end of the step without contacts."""
    end: np.ndarray
    mass: np.ndarray
    jacobian: np.ndarray
    """(steps, contacts, 3, nv)."""
    gap: np.ndarray
    held: np.ndarray
    """Impulses of persistent contact and of impacts without rebound, (steps, contacts, 3), N s."""
    struck: np.ndarray
    """Impulses of rebounds."""


def steps_of(scene: phipsi.Scene, path: phipsi.Trajectory, dt: float) -> Steps:
    def flat(rows: np.ndarray) -> np.ndarray:
        return rows.reshape(-1, *rows.shape[2:])

    q, qd, end = flat(path.q[:, :-1]), flat(path.qd[:, :-1]), flat(path.qd[:, 1:]).copy()
    acceleration = scene.without_contacts().forward_dynamics(q, qd, np.zeros_like(qd))
    if scene.nq > scene.nv:
        # The step is in the axes at its start; recorded velocities are in those of their row.
        acceleration[:, :3] += np.cross(qd[:, 3:6], qd[:, :3])
        before, after = (rotations(flat(rows)) for rows in (path.q[:, :-1], path.q[:, 1:]))
        end[:, :3] = np.einsum("sji,sjk,sk->si", before, after, end[:, :3])
    units = [scene.contacts.velocities(q, np.broadcast_to(unit, end.shape)) for unit in np.eye(scene.nv)]
    told = [np.stack([flat(part[name][:, 1:]) for name in scene.contacts.names], axis=1) for part in (path.contacts.force, path.contacts.impulse)]
    gap = np.maximum(scene.contacts.gaps(q), 0.0)
    return Steps(qd, qd + dt * acceleration, end, scene.mass_matrix(q), np.stack(units, axis=-1), gap, told[0] * dt, told[1])


@functools.cache
def random_motion(kind: str, mu: float, restitution: float, dt: float, method: str = "contact") -> tuple[phipsi.Scene, phipsi.Trajectory]:
    random = np.random.default_rng(2)
    if kind == "block":
        scene = block(mu, restitution=restitution)
        q, qd = np.tile(at(0.4), (10, 1)), random.uniform(-2, 2, (10, 6))
    elif kind == "chain":
        scene = chain(mu, restitution)
        q = np.concatenate([np.pi / 2 + random.uniform(-0.2, 0.2, (10, 1)), random.uniform(-0.3, 0.3, (10, 3))], axis=1)
        qd = random.uniform(-1, 1, (10, 4))
    else:
        scene = quadruped(mu, restitution)
        q = np.tile(np.concatenate([at(0.45), [0.0, 0.7, -1.4] * 4]), (4, 1))
        qd = random.uniform(-1, 1, (4, 18))
    return scene, scene.simulate(q, qd, dt=dt, steps=round(0.7 / dt), method=method)


KINDS = ("block", "chain", "quadruped")


@pytest.mark.parametrize("mu", [0.0, 0.3, 0.8])
@pytest.mark.parametrize("kind", KINDS)
def test_recorded_impulses_meet_the_law_and_balance_momentum(kind: str, mu: float) -> None:
    """Signorini's condition, the cone and maximal dissipation, and M dv = J* p, in every step, without rebounds."""
    dt = 1e-3
    scene, path = random_motion(kind, mu, 0.0, dt)
    _, free, end, mass, jacobian, gap, p, _ = steps_of(scene, path, dt)
    velocity = np.einsum("scij,sj->sci", jacobian, end)
    normal, slip, sliding = velocity[..., 2] + gap / dt, velocity[..., :2], np.linalg.norm(velocity[..., :2], axis=-1)
    near = p[..., 2] > 0
    assert np.sum(near) > 500
    impulses, speeds = float(np.max(np.abs(p))), float(np.max(np.abs(velocity[near])))
    assert path.contacts.converged.all()
    assert np.min(p[..., 2]) >= 0.0
    assert np.min(normal) >= -CONTACT * speeds
    assert np.max(p[..., 2] * normal) <= CONTACT * impulses * speeds
    assert np.max(np.linalg.norm(p[..., :2], axis=-1) - mu * p[..., 2]) <= CONTACT * impulses
    power = mu * p[..., 2] * sliding + np.sum(p[..., :2] * slip, axis=-1)
    assert -CONTACT * impulses * speeds <= np.min(power) and np.max(power) <= CONTACT * max(mu, 1.0) * impulses * speeds
    change, given = np.einsum("sij,sj->si", mass, end - free), np.einsum("scij,sci->sj", jacobian, p)
    assert_near(change, given, product(scene.nv, float(np.max(np.abs(mass))) * float(np.max(np.abs(end)))))


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("kind", KINDS)
def test_contacts_do_no_positive_work_in_any_step(kind: str, restitution: float) -> None:
    """The work of an impulse p is p times the mean of the velocities before and after, with any friction and rebound."""
    dt = 1e-3
    for mu in (0.0, 0.8):
        scene, path = random_motion(kind, mu, restitution, dt)
        start, free, end, mass, jacobian, _, held, struck = steps_of(scene, path, dt)
        assert (np.max(struck) > 0) == (restitution > 0)
        rebound = free + np.linalg.solve(mass, np.einsum("scij,sci->sj", jacobian, struck)[..., None])[..., 0]
        velocities = (start + rebound) / 2, (rebound + end) / 2
        works = [np.einsum("sci,scij,sj->s", p, jacobian, v) for p, v in zip((struck, held), velocities, strict=True)]
        kinetic = 0.5 * float(np.max(np.einsum("si,sij,sj->s", end, mass, end)))
        assert np.max(works) <= CONTACT * kinetic
        if mu == 0.0 and restitution == 1.0:
            assert np.min(works) >= -CONTACT * kinetic
        else:
            assert np.min(works) < -1e-3 * kinetic
        assert (path.energy_audit().contacts <= product(path.steps, kinetic)).all()
        if kind == "block" and restitution < 1.0:
            # A passive free body: the error of the integrator is a loss while it falls.
            assert np.max(np.diff(path.energy().total)) <= FAR
        # By default, steps in which no contact can act have the order of their method.
        _, default = random_motion(kind, mu, restitution, dt, "auto")
        rises = [float(np.sum(np.maximum(0.0, np.diff(of.energy().total)))) for of in (default, path)]
        assert rises[0] <= max(1.2 * rises[1], 100 * FAR * kinetic), rises


@pytest.mark.parametrize("kind", ["chain", "quadruped"])
def test_the_energy_of_passive_robots_rises_by_the_error_of_the_integrator_only(kind: str) -> None:
    """The remainder of the energy audit is of first order in the step; contacts only dissipate."""
    left = []
    for dt in (2e-3, 2.5e-4):
        _, path = random_motion(kind, 0.5, 0.0, dt)
        audit = path.energy_audit()
        assert (audit.contacts < 0).all()
        left.append(float(np.mean(np.abs(audit.remainder))))
    print(kind, left)
    assert left[1] <= left[0] / 3


def test_the_linear_momentum_of_free_bodies_changes_by_weight_and_recorded_impulses() -> None:
    dt = 1e-3
    for scene, mass, height in ((ball(MU, 0.7), MASS, 0.5), (block(0.5, restitution=0.5), 2.0, 0.4), (block(0.5), 2.0, 0.4)):
        qd = np.random.default_rng(3).uniform(-2, 2, (10, 6))
        path = scene.simulate(np.tile(at(height), (10, 1)), qd, dt=dt, steps=700, method="contact")
        contacts = path.contacts
        given = sum(contacts.force[name] * dt + contacts.impulse[name] for name in scene.contacts.names)[:, 1:] + [0, 0, -mass * G * dt]
        change = mass * np.diff(in_base(path, slice(3)), axis=1)
        assert np.max(given) > 0.1
        # The removal of a penetration rotates the body, and its velocities with it.
        rotated = mass * np.max(np.abs(path.qd)) * float(np.max(contacts.depth)) / 0.1
        assert_near(change, given, product(8, float(np.max(np.abs(given)))) + rotated)


@pytest.mark.parametrize("width", [0.0, 1e-3])
def test_joints_that_return_to_a_narrow_range_while_their_robot_lands(width: float) -> None:
    """An impact can move a joint from beyond one limit to the other one, where it stops."""
    builder = phipsi.SceneBuilder().link("base", 0.1, (0.02, 0.0, 0.01), np.diag([1e-4, 8e-4, 8e-4]))
    for name, parent, axis in (("upper", "base", (1, 0, 0)), ("lower", "upper", (1, 0.3, 0))):
        builder.link(name, 0.3, (0.01, 0.0, 0.1), np.diag([4e-3, 4e-3, 2e-4]))
        builder.joint(f"hinge of {name}", "revolute", parent, name, xyz=(0.03, 0.0, 0.1), axis=axis, lower=0.0, upper=width, damping=0.05)
    scene = builder.contact("foot", "base", xyz=(0.05, 0.02, -0.02), friction=0.8).build(floating_base=True)
    random = np.random.default_rng(0)
    change = np.concatenate([np.zeros((20, 3)), random.uniform(-1, 1, (20, 3)), random.uniform(-0.05, 0.05, (20, 2))], axis=-1)
    q = scene.integrate(scene.neutral(), change)
    q[:, 2] += 0.05 - scene.contacts.gaps(q)[:, 0]
    with pytest.warns(phipsi.errors.LimitWarning, match="beyond its"):
        path = scene.simulate(q, np.zeros((20, 8)), dt=1e-3, steps=250)
    assert np.all(path.contacts.force["foot"][..., 2].max(-1) > 0)
    assert np.max(path.contacts.residual) <= CONTACT
    assert np.all(np.abs(scene.contacts.gaps(path.q[:, -1])) <= 1e-5)
    # They return with a time constant of 0.05 s.
    assert_near(path.q[:, -1, 7:], np.clip(path.q[:, -1, 7:], 0.0, width), 0.05 * np.exp(-4))
