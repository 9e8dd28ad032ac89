"""Simulation with dry friction, joint stops and fast rotation compared with closed forms: stick-slip, turning points,
static equilibrium, rebounds, Dzhanibekov's spin, orders, bitwise equality.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from conftest import KINDS, random_scene, random_states
from motion_scenes import GRAVITY, ROD_INERTIA, ROD_WEIGHT, pendulum, slide
from tolerances import EPS, assert_near, assert_same_bits, of_order, product, size

import phipsi
from phipsi.errors import ArgumentError, LimitWarning


class Belt:
    """A block with dry friction on a spring whose other end moves at a constant speed, and reverses when the
    block first stops.
    """

    mass, stiffness, friction, speed = 2.0, 50.0, 4.0, 0.1

    def __init__(self) -> None:
        self.rate = np.sqrt(self.stiffness / self.mass)
        self.slip = self.friction / (self.stiffness * self.speed)
        self.turn = self.slip + 2 * np.pi / self.rate
        self.slip_back = self.turn + 2 * self.slip
        self.end = self.slip_back + 2 * np.pi / self.rate

    def state(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position and velocity: at rest, a full slip forward, at rest, a full slip back."""

        def slipped(since: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            angle = self.rate * np.clip(since, 0.0, 2 * np.pi / self.rate)
            return self.speed / self.rate * (angle - np.sin(angle)), self.speed * (1.0 - np.cos(angle))

        along, back = slipped(t - self.slip), slipped(t - self.slip_back)
        return along[0] - back[0], along[1] - back[1]

    def force(self, t: np.ndarray) -> np.ndarray:
        """Mean force at the moving end in each step, through the spring."""
        since = np.maximum(t - self.turn, 0.0)
        integral = 0.5 * self.speed * t**2 - self.speed * since**2
        return self.stiffness * np.diff(integral) / np.diff(t)


@pytest.mark.parametrize("dt", [1e-2, 1e-3])
def test_a_pulled_block_sticks_exactly_and_slips_as_a_sinusoid(dt: float) -> None:
    belt = Belt()
    scene = slide(belt.mass, stiffness=belt.stiffness, friction=belt.friction)
    t = np.arange(round(belt.end / dt) - 2) * dt
    path = scene.simulate([0.0], [0.0], dt=dt, steps=len(t) - 1, tau_steps=belt.force(t)[:, None])
    x, v = belt.state(t)
    assert_near(path.q[:, 0], x, of_order(2, dt, belt.speed * belt.rate))
    assert_near(path.qd[:, 0], v, of_order(2, dt, belt.speed * belt.rate**2))
    sticks = (t < belt.slip) | ((t > belt.turn + 2 * dt) & (t < belt.slip_back))
    assert not path.qd[sticks].any() and np.all(path.qd[(t > belt.slip + 3 * dt) & (t < belt.turn - 3 * dt)] > 0.0)
    assert path.events > 0 and path.friction_speed == 0.0


@pytest.mark.parametrize("dt", [1e-2, 1e-3])
def test_amplitudes_decrease_by_twice_the_dead_band_until_the_mass_stops_in_it(dt: float) -> None:
    mass, stiffness, friction, away = 2.0, 50.0, 4.0, 1.0
    band, rate = friction / stiffness, np.sqrt(stiffness / mass)
    path = slide(mass, stiffness=stiffness, friction=friction).simulate([away], [0.0], dt=dt, steps=round(5.0 / dt))
    swings = np.arange(int(np.ceil((away - band) / (2 * band))) + 1)
    turns = (-1.0) ** swings * (away - 2 * band * swings)
    at = np.round(swings * np.pi / rate / dt).astype(int)
    bound = of_order(2, dt, away * rate**2)
    assert_near(path.q[at, 0], turns, bound)
    assert abs(turns[-1]) < band < abs(turns[-2])
    rests = path.t > swings[-1] * np.pi / rate + dt
    assert not path.qd[rests].any() and np.ptp(path.q[rests]) == 0.0
    assert_near(path.q[-1], turns[-1:], bound)


def stops_of_the_pendulum(friction: float, q: float) -> list[tuple[float, float]]:
    """Times and angles of the turning points of a pendulum released at q, until friction stops it, by SciPy with
    events.
    """
    integrate = pytest.importorskip("scipy.integrate")
    t, found = 0.0, []
    while ROD_WEIGHT * abs(np.sin(q)) > friction:
        way = -np.sign(q)

        def rate(_: float, y: np.ndarray, way: float = way) -> list[float]:
            return [y[1], (-ROD_WEIGHT * np.sin(y[0]) - friction * way) / ROD_INERTIA]

        def turned(since: float, y: np.ndarray, way: float = way) -> float:
            return float(y[1] * way) if since > 1e-3 else 1.0

        turned.terminal = True  # type: ignore[attr-defined]
        swing = integrate.solve_ivp(rate, (0.0, 10.0), [q, 0.0], events=turned, method="DOP853", rtol=1e-12, atol=1e-13)
        t, q = t + float(swing.t_events[0][0]), float(swing.y_events[0][0][0])
        found.append((t, q))
    return found


@pytest.mark.parametrize("dt", [1e-2, 1e-3])
def test_a_pendulum_with_dry_friction_stops_at_the_exact_angle(dt: float) -> None:
    turns = stops_of_the_pendulum(0.7, 1.5)
    path = pendulum(friction=0.7).simulate([1.5], [0.0], dt=dt, steps=round(6.0 / dt))
    assert len(turns) >= 4
    for t, q in turns:
        # The row nearest to the turning point is half a step from it.
        assert_near(path.q[round(t / dt)], [q], of_order(2, dt, ROD_WEIGHT / ROD_INERTIA))
    rests = path.t > turns[-1][0] + dt
    assert not path.qd[rests].any() and np.ptp(path.q[rests]) == 0.0
    assert_near(path.q[-1], [turns[-1][1]], of_order(2, dt, 1e-3 * ROD_WEIGHT / ROD_INERTIA))
    assert ROD_WEIGHT * abs(np.sin(path.q[-1, 0])) < 0.7


def test_a_held_arm_does_not_drift() -> None:
    chain, arm = phipsi.scenes.chain(7), phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
    for scene, q in ((chain, np.linspace(-0.5, 0.8, 7)), (arm, np.array([0.3, 0.4, -0.5, 0.2, 0.3, -0.1]))):
        friction = 1.01 * np.abs(scene.gravity_torque(q)) + 1e-6
        path = scene.simulate(q, np.zeros(scene.nv), dt=1e-3, steps=10_000, friction=friction, record_every=500)
        assert np.abs(path.q - q).max() == 0.0 and not path.qd.any()


def test_an_arm_pressed_against_its_stops_does_not_drift() -> None:
    arm = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
    q = arm.limits.upper.copy()
    tau = arm.gravity_torque(q) + 5.0
    path = arm.simulate(q, np.zeros(6), dt=1e-3, steps=10_000, friction=0.0, tau=tau, record_every=500)
    assert np.abs(path.q - q).max() == 0.0 and not path.qd.any() and path.stops == []
    free = arm.simulate(q, np.zeros(6), dt=1e-3, steps=100, friction=0.0, tau=tau, limits="report")
    assert np.all(free.q[-1] > q)


def test_a_joint_loaded_just_above_its_friction_moves() -> None:
    arm = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
    q = np.array([0.3, 0.4, -0.5, 0.2, 0.3, -0.1])
    friction, load = 1.01 * np.abs(arm.gravity_torque(q)) + 1e-6, np.abs(arm.gravity_torque(q))[1]
    for share, moves in ((1.0 + 1e-9, False), (1.0 - 1e-9, True)):
        friction[1] = share * load
        path = arm.simulate(q, np.zeros(6), dt=1e-3, steps=200, friction=friction)
        assert np.any(path.q[-1] != q) == moves and np.any(path.qd[-1] != 0.0) == moves


@pytest.mark.parametrize("dt", [1e-2, 1e-3])
def test_a_falling_mass_comes_to_rest_on_its_stop(dt: float) -> None:
    scene, mass, height = slide(2.0, (0, 0, 1), lower=0.0), 2.0, 1.0
    path = scene.simulate([height], [0.0], dt=dt, steps=round(1.0 / dt))
    (impact,) = path.stops
    speed, lands = np.sqrt(2 * GRAVITY * height), np.sqrt(2 * height / GRAVITY)
    assert (impact.joint, impact.limit, impact.state) == ("slide", "lower", None)
    assert lands <= impact.time <= lands + dt
    assert_near(impact.speed, speed, of_order(1, dt, GRAVITY))
    assert_near(impact.impulse, mass * speed, of_order(1, dt, mass * GRAVITY))
    rests = path.t > impact.time
    assert path.q.min() == 0.0 and not path.q[rests].any() and not path.qd[rests].any()
    assert np.diff(path.energy().total).max() <= product(3, mass * GRAVITY * height)


@pytest.mark.parametrize("dt", [1e-2, 1e-3])
def test_a_bouncing_mass_keeps_the_law_of_restitution(dt: float) -> None:
    """The time of an impact is accurate to a step, and the velocity to g dt."""
    scene, mass, height, rebound = slide(2.0, (0, 0, 1), lower=0.0), 2.0, 1.0, 0.8
    path = scene.simulate([height], [0.0], dt=dt, steps=round(6.0 / dt), restitution=rebound)
    assert 0.0 <= path.stops[0].time - np.sqrt(2 * height / GRAVITY) <= dt
    some = [impact for impact in path.stops if impact.speed > 10 * GRAVITY * dt]
    assert len(some) >= 5
    for one, other in itertools.pairwise(some):
        flight = 2 * rebound * one.speed / GRAVITY
        assert_near(other.time - one.time, flight, 1.01 * dt)
        assert_near(other.speed, rebound * one.speed, of_order(1, dt, GRAVITY))
        between = (path.t > one.time) & (path.t < other.time)
        assert_near(path.q[between].max(), 0.5 * (rebound * one.speed) ** 2 / GRAVITY, of_order(2, dt, GRAVITY))
    for impact in some:
        assert_near(impact.impulse, mass * (1 + rebound) * impact.speed, of_order(1, dt, 2 * mass * GRAVITY))
    assert not path.q[-1].any() and not path.qd[-1].any() and path.q.min() == 0.0
    assert np.diff(path.energy().total).max() <= product(3, mass * GRAVITY * height)


def test_bounces_are_exact_with_error_control() -> None:
    rebound, bounces = 0.8, 8
    path = slide(2.0, (0, 0, 1), lower=0.0).simulate([1.0], [0.0], dt=1e-2, duration=3.5, restitution=rebound, accuracy=1e-8)
    speeds = np.sqrt(2 * GRAVITY) * rebound ** np.arange(bounces)
    times = np.sqrt(2 / GRAVITY) + np.r_[0.0, np.cumsum(2 * speeds[1:] / GRAVITY)]
    assert_near([impact.time for impact in path.stops[:bounces]], times, 1e-6)
    assert_near([impact.speed for impact in path.stops[:bounces]], speeds, 1e-6)
    assert_near([impact.impulse for impact in path.stops[:bounces]], 2.0 * (1 + rebound) * speeds, 1e-5)


@pytest.mark.parametrize("upper", [1.3963, 1e3])
def test_error_control_lands_a_joint_that_is_one_rounding_error_from_its_stop(upper: float) -> None:
    builder = phipsi.SceneBuilder().link("base").link("block", 2.0).link("other", 2.0)
    builder.joint("slide", "prismatic", "base", "block", axis=(0, 1, 0), upper=upper)
    # It is so stiff that the method compares one substep with two, neither of which changes the position of the block.
    scene = builder.joint("stiff", "prismatic", "base", "other", axis=(0, 1, 0), damping=1e6).build()
    path = scene.simulate([np.nextafter(upper, 0.0), 0.0], [1e-6, 0.0], dt=1e-3, steps=3, accuracy=1e-6)
    assert np.all(path.q[1:, 0] == upper) and not path.qd[1:].any() and path.substeps < 100
    assert (path.stops[0].joint, path.stops[0].limit) == ("slide", "upper")


def test_reported_limits_let_the_joint_pass() -> None:
    scene = pendulum(lower=-0.3, upper=0.3)
    path = scene.simulate([0.2], [-4.0], dt=1e-3, steps=300, limits="report")
    free = pendulum().simulate([0.2], [-4.0], dt=1e-3, steps=300)
    assert_same_bits(path.q, free.q)
    assert (path.limits, path.stops) == ("report", []) and path.violations()[0].limit == "lower"
    stopped = scene.simulate([0.2], [-4.0], dt=1e-3, steps=300)
    assert stopped.limits == "stop" and stopped.q.min() == -0.3 and stopped.violations() == [] and stopped.stops[0].limit == "lower"


def test_coupled_joints_stop_and_stick_together() -> None:
    builder = phipsi.SceneBuilder().link("base")
    for name, joint in (("one", {"lower": -0.4, "upper": 0.3, "friction": 0.2}), ("two", {"mimic": "one", "mimic_multiplier": 2.0, "friction": 0.6})):
        builder.link(name, 1.0, (0, 0, -0.5), 0.05 * np.eye(3)).joint(name, "revolute", "base", name, axis=(0, 1, 0), **joint)
    scene = builder.build(mimic="couple")
    path = scene.simulate([0.1], [3.0], dt=1e-3, steps=4000, damping=0.05)
    assert (path.limits, path.friction_speed) == ("stop", 0.0)
    assert 0.29 < path.q.max() <= 0.3 and (path.stops[0].joint, path.stops[0].limit) == ("one", "upper")
    # Gravity torque of both rods, and friction of both joints, at the first.
    q = path.q[-1, 0]
    assert not path.qd[-1].any() and abs(ROD_WEIGHT * (np.sin(q) + 2 * np.sin(2 * q))) < 0.2 + 2 * 0.6


@pytest.mark.parametrize("call", ["simulate", "simulator"])
def test_a_start_outside_of_a_limit_warns_and_returns_without_a_jump(call: str) -> None:
    scene = pendulum(lower=-0.2, upper=0.5)
    with pytest.warns(LimitWarning, match='"hinge" at 0.7 beyond its upper limit 0.5'):
        if call == "simulator":
            scene.simulator([0.7], dt=1e-3)
            return
        path = scene.simulate([0.7], [0.0], dt=1e-3, steps=1000)
    back = np.argmax(path.q[:, 0] <= 0.5)
    kinetic, changes = path.energy().kinetic[: back + 1], np.diff(path.qd[: back + 1, 0])
    assert 0 < path.t[back] < 0.2 and np.all(path.q[back:] <= 0.5) and path.q.min() >= -0.2
    assert kinetic[1] < 1e-2 * kinetic.max() and np.abs(changes).max() < 0.05 * np.abs(path.qd[: back + 1]).max()


def test_a_reset_outside_of_a_limit_warns() -> None:
    scene = pendulum(lower=-0.2, upper=0.5)
    simulator = scene.simulator([[0.1], [0.2], [0.3]], dt=1e-3)
    simulator.reset([0.4])
    with pytest.warns(LimitWarning, match='"hinge" at -0.3 beyond its lower limit -0.2'):
        simulator.reset([[0.1], [-0.3]], states=[0, 2])
    # The others are not part of the call.
    simulator.reset([0.1], states=[1])
    scene.simulator([0.1], dt=1e-3, limits="report").reset([0.7])


def test_a_start_far_outside_of_a_limit_is_not_accelerated_beyond_reason() -> None:
    arm = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
    q = np.zeros(6)
    q[1] = 3.0
    with pytest.warns(LimitWarning, match='"joint2" at 3 beyond its upper limit'):
        path = arm.simulate(q, np.zeros(6), dt=1e-3, steps=3000)
    assert path.q[-1, 1] <= arm.limits.upper[1]
    # At most 1 rad/s, without more energy than gravity supplies through that angle.
    assert path.energy().kinetic.max() < 10.0 * np.ptp(path.energy().potential)


@pytest.mark.filterwarnings("ignore::phipsi.errors.LimitWarning")
def test_the_accuracy_determines_the_substeps_in_which_a_joint_returns() -> None:
    builder = phipsi.SceneBuilder().link("base").link("block", 2.0).link("rod", 1.0, (0, 0, -0.5), np.diag([0.08, 0.08, 0.001]))
    builder.joint("slide", "prismatic", "base", "block", axis=(1, 0, 0), lower=0.0)
    scene = builder.joint("hinge", "revolute", "base", "rod", axis=(0, 1, 0)).build()
    alone = pendulum().simulate([1.0], [0.0], dt=1e-3, steps=200, accuracy=1e-11).q[:, 0]
    runs = {accuracy: scene.simulate([-1.0, 1.0], [0.0, 0.0], dt=1e-3, steps=200, accuracy=accuracy) for accuracy in (1e-6, 1e-8)}
    for accuracy, path in runs.items():
        assert np.all(path.q[1:, 0] < 0.0) and path.q[-1, 0] > -0.9
        assert np.max(np.abs(path.q[:, 1] - alone)) <= path.estimated_error
        # Each is a step of order 1, with an error of h^2 times the acceleration of at most 20 m/s^2.
        assert path.substeps <= 1.5e-3 / np.sqrt(accuracy / 20.0) + 4
    assert runs[1e-6].substeps < runs[1e-8].substeps


PRINCIPAL = np.array([0.2, 0.3, 0.4])


def spinning(rate: float) -> tuple[phipsi.Scene, np.ndarray, np.ndarray]:
    """A free body that rotates almost about its middle principal axis."""
    scene = phipsi.SceneBuilder().link("top", 1.0, (0, 0, 0), np.diag(PRINCIPAL)).build(floating_base=True, gravity=(0, 0, 0))
    return scene, scene.neutral(), rate * np.array([0, 0, 0, 1e-3, 1.0, 0.0])


def test_fast_spin_about_the_middle_axis_keeps_energy_and_momentum() -> None:
    scene, q, qd = spinning(300.0)
    path = scene.simulate(q, qd, dt=1e-3, steps=10_000, record_every=10)
    total, momentum = path.energy().total, path.momentum()[:, :3]
    assert_near(total, np.full_like(total, total[0]), 1e-6 * total[0])
    assert_near(momentum, np.broadcast_to(momentum[0], momentum.shape), 1e-6 * np.linalg.norm(momentum[0]))
    assert path.substeps > 1 and path.qd[:, 4].min() < -299.0 and path.qd[:, 4].max() > 299.0


def test_the_middle_axis_flips_with_the_period_of_the_elliptic_integral() -> None:
    """L. D. Landau and E. M. Lifshitz, Mechanics, section 37: half a period is 2 K(k^2) divided by the rate."""
    special = pytest.importorskip("scipy.special")
    scene, q, qd = spinning(30.0)
    path = scene.simulate(q, qd, dt=1e-3, steps=10_000)
    i1, i2, i3 = PRINCIPAL
    energy, momentum = PRINCIPAL @ qd[3:] ** 2, PRINCIPAL**2 @ qd[3:] ** 2
    assert momentum < energy * i2
    parameter = (i3 - i2) * (momentum - energy * i1) / ((i2 - i1) * (energy * i3 - momentum))
    rate = np.sqrt((i2 - i1) * (energy * i3 - momentum) / (i1 * i2 * i3))
    w = path.qd[:, 4]
    at = np.nonzero(w[:-1] * w[1:] < 0.0)[0]
    flips = path.t[at] - w[at] * (path.t[at + 1] - path.t[at]) / (w[at + 1] - w[at])
    expected = 2.0 * special.ellipk(parameter) / rate
    assert len(flips) >= 6
    assert_near(np.diff(flips) / expected, np.ones(len(flips) - 1), 1e-7)


def errors_of_steps(scene: phipsi.Scene, counts: tuple[int, ...], seed: int, **law: object) -> tuple[list[float], list[str]]:
    """Errors after 0.16 s with that many steps compared with the explicit method with short steps; and the selected
    methods.
    """
    q, qd, tau = random_states(scene, seed)
    given = {"tau": 0.2 * tau, "limits": "report", **law}
    fine = scene.simulate(q, 0.3 * qd, dt=0.16 / 10_000, steps=10_000, method="rk4", record_every=10_000, **given)
    found, chosen = [], []
    for count in counts:
        path = scene.simulate(q, 0.3 * qd, dt=0.16 / count, steps=count, record_every=count, **given)
        assert path.substeps == 1 and path.events == 0
        off = scene.difference(fine.q[-1], path.q[-1]), path.qd[-1] - fine.qd[-1]
        found.append(float(np.abs(off).max()))
        chosen.append(path.integrator)
    return found, chosen


def test_the_default_has_order_two_where_it_is_implicit_and_four_where_it_is_explicit() -> None:
    for kinds, floating_base in ((("revolute", "prismatic"), False), (KINDS, True)):
        scene = random_scene(3, 6, kinds=kinds, floating_base=floating_base, armature=0.1)
        law = phipsi.PD(np.full(scene.nv, 400.0), np.full(scene.nv, 200.0), scene.neutral())
        for given, counts, method, order in (({"pd": law}, (80, 160, 320), "rosenbrock-2", 2), ({}, (20, 40, 80), "rk4", 4)):
            off, chosen = errors_of_steps(scene, counts, 3, **given)
            assert set(chosen) == {method}
            orders = np.log2(np.array(off[:-1]) / off[1:])
            assert np.all(np.abs(orders - order) < 0.35), (method, off)


@pytest.mark.filterwarnings("ignore:q. found joint .* limit:phipsi.errors.LimitWarning")
@pytest.mark.parametrize("kinds", [("revolute", "prismatic"), KINDS])
def test_events_have_the_same_bits_alone_in_a_batch_on_threads_and_in_pieces(kinds: tuple[str, ...]) -> None:
    scene = random_scene(5, 6, kinds=kinds, armature=0.1, floating_base=len(kinds) > 2)
    q, qd, tau = random_states(scene, 7, (37,))
    given = {"dt": 2e-3, "friction": 0.3, "restitution": 0.5, "damping": 0.05}
    path = scene.simulate(q, qd, steps=150, tau=tau, **given)
    assert path.events.sum() > 300 and path.stops
    before = phipsi.get_num_threads()
    try:
        for threads in (1, 3):
            phipsi.set_num_threads(threads)
            again = scene.simulate(q, qd, steps=150, tau=tau, **given)
            assert_same_bits(again.q, path.q)
            assert_same_bits(np.array(again.works), np.array(path.works))
            assert again.stops == path.stops
    finally:
        phipsi.set_num_threads(before)
    for i in (0, 5, 17, 36):
        alone = scene.simulate(q[i], qd[i], steps=150, tau=tau[i], **given)
        assert_same_bits(alone.qd, path.qd[i])
        assert_same_bits(np.array(alone.works), np.array(path.works)[:, i])
        assert alone.events == path.events[i] and alone.substeps == path.substeps[i]
        assert [impact[:-1] for impact in alone.stops] == [impact[:-1] for impact in path.stops if impact.state == i]
    simulator = scene.simulator(q, qd, **given)
    for steps in (1, 7, 0, 60, 82):
        simulator.step(tau, steps)
    assert_same_bits(simulator.q, path.q[:, -1])
    assert_same_bits(simulator.qd, path.qd[:, -1])
    assert simulator.take_stops() == path.stops and simulator.take_stops() == []


@pytest.mark.parametrize("dt", [1e-4, 1e-3, 1e-2, 1e-1])
def test_stiff_gains_and_large_friction_neither_diverge_nor_gain_energy(dt: float) -> None:
    arm = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
    q = np.array([0.3, 0.4, -0.5, 0.2, 0.3, -0.1])
    for kp, kd in itertools.product((1e4, 1e7, 1e10), (0.0, 1e-2, 1.0)):
        path = arm.simulate(q, np.zeros(6), dt=dt, steps=20, pd=phipsi.PD(kp, kd * kp, np.zeros(6)))
        total = path.energy().total + 0.5 * kp * (path.q**2).sum(axis=-1)
        assert np.all(np.diff(total) <= product(6, total[0])), (kp, kd)
    for friction in (1e2, 1e6):
        path = arm.simulate(q, np.full(6, 3.0), dt=dt, steps=20, friction=friction)
        assert np.all(np.diff(path.energy().total) <= product(6, size(path.energy().total))), friction


@pytest.mark.parametrize("ratio", [1e-12, 1e-6, 1e6, 1e12])
@pytest.mark.parametrize("dt", [1e-3, 1e-1])
def test_mass_ratios_do_not_gain_energy(ratio: float, dt: float) -> None:
    builder = phipsi.SceneBuilder().link("base").link("a", 1.0, (0, 0, -0.5), 0.05 * np.eye(3)).link("b", ratio, (0, 0, -0.5), 0.05 * ratio * np.eye(3))
    builder.joint("one", "revolute", "base", "a", axis=(0, 1, 0), damping=0.1, friction=0.05)
    scene = builder.joint("two", "revolute", "a", "b", xyz=(0, 0, -1), axis=(0, 1, 0), damping=0.1 * ratio).build()
    path = scene.simulate([1.0, -0.5], [0.0, 0.0], dt=dt, steps=round(2.0 / dt))
    total, kinetic = path.energy().total, path.energy().kinetic
    assert np.max(total - np.minimum.accumulate(total)) <= 1e-4 * kinetic.max() + 100 * EPS * size(total)


CALL = {"q": [0.0], "qd": [0.0], "dt": 1e-3, "steps": 3}
REFUSED = {
    "limits": ({"limits": "bounce"}, 'limits: found "bounce"; expected "stop" or "report"'),
    "restitution negative": ({"restitution": -0.1}, "restitution: found -0.1"),
    "restitution above one": ({"restitution": 1.1}, "restitution: found 1.1"),
    "restitution NaN": ({"restitution": np.nan}, "restitution: found NaN"),
    "accuracy zero": ({"accuracy": 0.0}, "accuracy: found 0"),
    "accuracy negative": ({"accuracy": -1e-6}, "accuracy: found -0.000001"),
    "accuracy NaN": ({"accuracy": np.nan}, "accuracy: found NaN"),
    "accuracy below rounding": ({"accuracy": 1e-13}, "accuracy: .* at least 1e-12"),
    "dt": ({"dt": None}, "dt: found None"),
    "steps": ({"steps": None}, "steps: found None"),
    "steps and duration": ({"duration": 0.003}, "duration: found steps and duration"),
    "duration negative": ({"steps": None, "duration": -1.0}, "duration: found -1"),
    "duration infinite": ({"steps": None, "duration": np.inf}, "duration: found inf"),
    "duration between steps": ({"steps": None, "duration": 0.00315}, "duration: found 0.00315 with dt 0.001"),
}


def test_a_valid_call() -> None:
    scene = slide(lower=-1.0, upper=1.0)
    path = scene.simulate(**CALL, limits="stop", restitution=0.5)
    assert_same_bits(scene.simulate([0.0], [0.0], dt=1e-3, duration=0.003, limits="stop", restitution=0.5).q, path.q)
    assert len(scene.simulate([0.0], [0.0], accuracy=1e-6, duration=2.0)) == 1001


@pytest.mark.parametrize("case", REFUSED)
def test_one_broken_argument_is_named(case: str) -> None:
    change, words = REFUSED[case]
    with pytest.raises(ArgumentError, match=words):
        slide(lower=-1.0, upper=1.0).simulate(**{**CALL, **change})
    if change.keys() <= {"limits", "restitution", "accuracy"}:
        with pytest.raises(ArgumentError, match=words):
            slide(lower=-1.0, upper=1.0).simulator([0.0], dt=1e-3, **change)
