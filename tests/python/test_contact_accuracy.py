"""Error control (`accuracy=`) in scenes with contacts: closed forms of bounces and slides, a double pendulum on a plane
by SciPy, stops, robots at rest, batches, and steps in which no contact can act.
"""

from __future__ import annotations

import copy
import pickle
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from test_contacts import at, ball, biped, box, standing
from test_contacts_out_of_reach import assert_same, chain, with_plane
from tolerances import assert_near, assert_same_bits

import phipsi
from phipsi.errors import ArgumentError

G = 9.81
BOUND = 100.0
"""Largest error after some tenths of a second, relative to the accuracy of each substep, as in test_energy_audit."""


def height(t: float, fall: float, restitution: float) -> tuple[float, float, bool]:
    """Height and velocity of a point that falls from `fall`, and whether it has come to rest."""
    speed, start = np.sqrt(2 * G * fall), 0.0
    if t < speed / G:
        return fall - G * t * t / 2, -G * t, False
    start = speed / G
    while True:
        speed *= restitution
        flight = 2 * speed / G
        if flight < 1e-14:
            return 0.0, 0.0, True
        if t < start + flight:
            return speed * (t - start) - G * (t - start) ** 2 / 2, speed - G * (t - start), False
        start += flight


@pytest.mark.parametrize("accuracy", [1e-5, 1e-8])
@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_a_bouncing_ball_follows_its_parabolas(restitution: float, accuracy: float) -> None:
    scene, spin = ball(0.0, restitution), [0.3, 0.0, 0.0, 0.0, 0.0, 2.0]
    path = scene.simulate(at(z=0.5), spin, dt=2e-2, steps=100, accuracy=accuracy)
    expected = np.array([height(t, 0.4, restitution) for t in path.t])
    error = np.abs(path.q[:, 2] - 0.1 - expected[:, 0]).max()
    assert error <= BOUND * accuracy and error <= 10 * path.estimated_error + 1e-12, (error, path.estimated_error)
    # The velocity jumps at an impact.
    slow = np.abs(path.qd[:, 2] - expected[:, 1])
    assert np.sort(slow)[-3] <= BOUND * accuracy and path.estimated_error <= BOUND * accuracy
    assert_near(path.q[:, 0], 0.3 * path.t, 1e-9)
    if restitution < 1.0:
        assert expected[-1, 2] and np.abs(path.qd[-1, 2]) <= BOUND * accuracy
        assert_near(path.contacts.force["ground"][-1], [0, 0, 0.5 * G], 1e-6)
    audit = path.energy_audit()
    assert abs(audit.remainder) <= 1e3 * accuracy and np.isclose(audit.contacts, -0.5 * G * 0.4 * (restitution < 1.0), atol=1e3 * accuracy)


@pytest.mark.parametrize("accuracy", [1e-5, 1e-8])
def test_a_box_slides_to_rest_where_friction_stops_it(accuracy: float) -> None:
    path = box(0.5).simulate(at(), [2.0, 0, 0, 0, 0, 0], dt=2e-2, steps=40, accuracy=accuracy)
    ends = 2.0 / (0.5 * G)
    t = np.minimum(path.t, ends)
    assert_near(path.q[:, 0], 2.0 * t - 0.25 * G * t * t, BOUND * accuracy)
    assert_near(path.qd[:, 0], 2.0 - 0.5 * G * t, BOUND * accuracy)
    assert np.abs(path.qd[-1]).max() <= accuracy and path.estimated_error <= BOUND * accuracy
    force = sum(path.contacts.force.values())
    assert_near(force[5], [-0.5 * 2.0 * G, 0, 2.0 * G], 1e-6)
    assert_near(force[-1], [0, 0, 2.0 * G], 1e-6)
    assert np.isclose(path.contacts.lost_in_friction, 0.5 * 2.0 * 2.0**2, rtol=1e-3) and abs(path.energy_audit().remainder) <= 1e3 * accuracy


def test_a_sliding_ball_rolls_from_two_v_over_seven_mu_g_on() -> None:
    path = ball(0.3).simulate(at(), [1.0, 0, 0, 0, 0, 0], dt=1e-2, steps=30, accuracy=1e-8)
    t = np.minimum(path.t, 2.0 / (7 * 0.3 * G))
    assert_near(path.q[:, 0], t - 0.15 * G * t * t + 5 / 7 * (path.t - t), 1e-6)
    assert path.estimated_error < 1e-5 and path.contacts.state["ground"][5] == phipsi.ContactState.SLIDING
    assert path.contacts.state["ground"][-1] == phipsi.ContactState.STICKING


@pytest.mark.parametrize("tan", [0.4, 0.6])
def test_a_box_on_an_incline_sticks_or_slides_back(tan: float) -> None:
    cos = 1 / np.sqrt(1 + tan * tan)
    path = box(0.5, gravity=(-G * tan * cos, 0, -G * cos)).simulate(at(), [1.0, 0, 0, 0, 0, 0], dt=2e-2, steps=50, accuracy=1e-7)
    up, down = G * cos * (tan + 0.5), G * cos * max(tan - 0.5, 0.0)
    first, rest = np.minimum(path.t, 1 / up), np.maximum(path.t - 1 / up, 0.0)
    assert_near(path.q[:, 0], first - up * first**2 / 2 - down * rest**2 / 2, 1e-5)
    assert path.contacts.state["corner0"][-1] == (phipsi.ContactState.SLIDING if tan > 0.5 else phipsi.ContactState.STICKING)


class Rods(NamedTuple):
    """Two rods in a vertical plane, by their angles to the vertical: the second one touches a frictional plane."""

    offset: float
    restitution: float
    friction: float
    lengths: tuple[float, float] = (0.5, 0.6)
    masses: tuple[float, float] = (1.0, 0.7)

    def scene(self) -> phipsi.Scene:
        builder, parent, top = phipsi.SceneBuilder().link("base"), "base", 0.0
        for name, mass, length in zip(("upper", "lower"), self.masses, self.lengths, strict=True):
            builder.link(name, mass, (0, 0, -length / 2), mass * length**2 / 12 * np.diag([1, 1, 1e-3]))
            builder.joint(name, "continuous", parent, name, xyz=(0, 0, top), axis=(0, 1, 0))
            parent, top = name, -length
        contact = {"friction": self.friction, "restitution": self.restitution, "offset": self.offset}
        return builder.contact("tip", "lower", xyz=(0, 0, top), **contact).build(gravity=(0, 0, -G))

    def equations(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mass matrix and right-hand side."""
        (a, b, da, db), (l1, l2), (m1, m2) = x, self.lengths, self.masses
        c = m2 * l1 * l2 / 2
        mass = np.array([[m1 * l1**2 / 3 + m2 * l1**2, c * np.cos(a - b)], [c * np.cos(a - b), m2 * l2**2 / 3]])
        gravity = G * np.array([(m1 / 2 + m2) * l1 * np.sin(a), m2 * l2 / 2 * np.sin(b)])
        return mass, -gravity - c * np.sin(a - b) * np.array([db**2, -(da**2)])

    def gap(self, x: np.ndarray) -> float:
        return float(-np.dot(self.lengths, np.cos(x[:2])) - self.offset)

    def rows(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Normal and tangential rows, and the bias of the normal acceleration."""
        lengths, sin, cos = np.array(self.lengths), np.sin(x[:2]), np.cos(x[:2])
        return lengths * sin, -lengths * cos, float(np.dot(lengths, cos * x[2:] ** 2))

    def push(self, x: np.ndarray) -> np.ndarray:
        """The generalized force of a unit normal force that slides."""
        normal, tangent, _ = self.rows(x)
        return normal - self.friction * np.sign(tangent @ x[2:]) * tangent

    def force(self, x: np.ndarray) -> float:
        """The normal force on the plane."""
        mass, right = self.equations(x)
        normal, _, bias = self.rows(x)
        return float(-(bias + normal @ np.linalg.solve(mass, right)) / (normal @ np.linalg.solve(mass, self.push(x))))

    def end(self, q: np.ndarray, qd: np.ndarray, duration: float) -> tuple[np.ndarray, np.ndarray, int, int]:
        """Relative angles and rates at the end, the number of impacts, and that of intervals of contact."""
        x, t, touching, impacts, slides = np.concatenate([np.cumsum(q), np.cumsum(qd)]), 0.0, False, 0, 0

        def rate(_: float, x: np.ndarray) -> np.ndarray:
            mass, right = self.equations(x)
            return np.concatenate([x[2:], np.linalg.solve(mass, right + (self.force(x) * self.push(x) if touching else 0.0))])

        def closes(_: float, x: np.ndarray) -> float:
            return self.force(x) if touching else self.gap(x)

        def stops(_: float, x: np.ndarray) -> float:
            return float(self.rows(x)[1] @ x[2:]) if touching and self.friction else 1.0

        closes.terminal, closes.direction, stops.terminal = True, -1, True
        while t < duration:
            found = solve_ivp(rate, (t, duration), x, method="DOP853", rtol=1e-12, atol=1e-13, events=(closes, stops))
            t, x = found.t[-1], found.y[:, -1]
            assert not found.t_events[1].size, "the tip comes to rest"
            if not found.t_events[0].size:
                break
            if touching:
                touching = False
                continue
            normal, tangent, _ = self.rows(x)
            before, mass, impacts = x.copy(), self.equations(x)[0], impacts + 1
            x[2:] -= (1 + self.restitution) * (normal @ x[2:]) * np.linalg.solve(mass, self.push(x)) / (normal @ np.linalg.solve(mass, self.push(x)))
            assert not self.friction or (tangent @ before[2:]) * (tangent @ x[2:]) > 0
            if self.restitution == 0.0 and self.force(x) > 0:
                touching, slides = True, slides + 1
        return np.append(x[0], x[1] - x[0]), np.append(x[2], x[3] - x[2]), impacts, slides


@pytest.mark.parametrize(("restitution", "friction"), [(0.0, 0.0), (0.0, 0.2), (0.5, 0.0), (1.0, 0.0)])
def test_a_double_pendulum_that_hits_a_plane_is_that_of_scipy(restitution: float, friction: float) -> None:
    rods = Rods(-0.9, restitution, friction)
    scene, impacts, slides = rods.scene(), 0, 0
    for seed in range(3):
        random = np.random.default_rng(seed)
        q, qd = np.array([0.9, 0.3]) + 0.2 * random.normal(size=2), np.array([-2.0, 1.0]) + random.normal(size=2)
        *expected, hits, touched = rods.end(q, qd, 0.5)
        impacts, slides = impacts + hits, slides + touched
        for accuracy in (1e-4, 1e-6):
            path = scene.simulate(q, qd, dt=0.05, steps=10, accuracy=accuracy)
            error = max(np.abs(path.q[-1] - expected[0]).max(), np.abs(path.qd[-1] - expected[1]).max() / np.abs(path.qd).max())
            assert error <= BOUND * accuracy and error <= 10 * path.estimated_error, (seed, accuracy, error, path.estimated_error)
            # The sum over all substeps in which the tip slides.
            assert path.estimated_error <= 10 * BOUND * accuracy
    assert impacts >= 3 and (slides >= 3 or restitution > 0)


def test_a_cart_that_slides_into_a_stop_rebounds_from_it() -> None:
    builder = phipsi.SceneBuilder().link("world").link("cart", mass=2.0).link("shoe", mass=1.0)
    builder.joint("x", "prismatic", "world", "cart", axis=(1, 0, 0), lower=-5, upper=0.25).joint("z", "prismatic", "cart", "shoe", axis=(0, 0, 1))
    scene = builder.contact("shoe", "shoe", friction=0.3).build()
    path = scene.simulate([0.0, 0.0], [1.0, 0.0], dt=1e-2, steps=80, accuracy=1e-8, restitution=0.5)
    slows = 0.3 * 1.0 * G / 3.0
    speed = np.sqrt(1 - 2 * slows * 0.25)
    hits = (1 - speed) / slows
    after = np.minimum(path.t - hits, 0.5 * speed / slows)
    expected = np.where(path.t < hits, path.t - slows * path.t**2 / 2, 0.25 - 0.5 * speed * after + slows * after**2 / 2)
    assert_near(path.q[:, 0], expected, 1e-6)
    assert len(path.stops) == 1 and abs(path.stops[0].time - hits) < 1e-6 and abs(path.stops[0].speed - speed) < 1e-6
    assert path.q[:, 0].max() <= 0.25 and np.abs(path.qd[-1]).max() <= 1e-9


@pytest.mark.parametrize("mimic", [True, False])
@pytest.mark.parametrize("accuracy", [1e-5, 1e-8])
@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_masses_that_fall_together_follow_the_parabolas_of_one(restitution: float, accuracy: float, mimic: bool) -> None:
    """As mimic joints, or on a connection; the ground acts on one of them."""
    builder = phipsi.SceneBuilder().link("base").link("left", 2.0).link("right", 3.0)
    builder.joint("one", "prismatic", "base", "left", axis=(0, 0, 1)).joint("two", "prismatic", "base", "right", axis=(0, 0, 1), mimic="one" if mimic else None)
    if not mimic:
        builder.connect("beam", "point", "left", "right")
    scene = builder.contact("ground", "right", friction=0.0, restitution=restitution).build(**({"mimic": "couple"} if mimic else {}))
    path = scene.simulate(np.full(scene.nq, 0.4), np.zeros(scene.nv), dt=2e-2, steps=60, accuracy=accuracy)
    expected = np.array([height(t, 0.4, restitution)[0] for t in path.t])
    for q in path.q.T:
        assert np.abs(q - expected).max() <= min(BOUND * accuracy, 10 * path.estimated_error + 1e-12)


def test_robots_at_rest_are_not_divided() -> None:
    path = box(0.5).simulate(at(), np.zeros(6), dt=1e-2, steps=100, accuracy=1e-9)
    assert path.substeps <= 20 and path.estimated_error < 1e-9 and np.abs(path.q - at()).max() < 1e-9
    scene = biped()
    q, qd, law = standing(scene)
    path = scene.simulate(q, qd, pd=law, dt=1e-2, steps=60, accuracy=1e-6)
    assert_near(sum(path.contacts.force.values())[-1], [0, 0, scene.total_mass * G], 1e-3)
    again = scene.simulate(path.q[-1], path.qd[-1], pd=law, dt=1e-2, steps=10, accuracy=1e-6)
    assert again.substeps <= 40 and again.estimated_error < 1e-5


def test_the_estimate_covers_the_error_of_a_rod_that_slides_and_slips() -> None:
    rod = phipsi.SceneBuilder().link("rod", mass=1.0, inertia=np.diag([1 / 3, 1 / 3, 1e-3])).contact("tip", "rod", xyz=(0, 0, -1.0), friction=0.4)
    lean = np.array([0, 0, np.cos(0.6), 0, np.sin(0.3), 0, np.cos(0.3)])
    start = [1.0, 0, 0, 0, 1.0, 0]
    scene = rod.build(floating_base=True)
    fine = scene.simulate(lean, start, dt=1e-2, steps=10, accuracy=1e-7)
    for accuracy in (1e-3, 1e-5):
        path = scene.simulate(lean, start, dt=1e-2, steps=10, accuracy=accuracy)
        error = np.abs(path.q - fine.q).max()
        assert error <= 10 * path.estimated_error and error <= BOUND * accuracy, (error, path.estimated_error)


def starts() -> tuple[np.ndarray, np.ndarray]:
    """States of a box that slides, falls, or is far away."""
    q = np.stack([at(z=z) for z in (0.1, 0.15, 30.0, 0.1, 0.3)])
    return q, np.random.default_rng(5).normal(size=(len(q), 6)) * [0.3, 0.3, 0.3, 2, 2, 2]


def test_states_of_a_batch_and_calls_of_a_simulator_have_the_same_bits() -> None:
    scene, run = box(0.5, 0.3), {"dt": 1e-2, "accuracy": 1e-3}
    q, qd = starts()
    path = scene.simulate(q, qd, steps=6, **run)
    for i, start in enumerate(zip(q, qd, strict=True)):
        alone = scene.simulate(*start, steps=6, **run)
        assert_same_bits(path.q[i], alone.q)
        assert_same_bits(path.qd[i], alone.qd)
        assert_same_bits(path.contacts.force["corner0"][i], alone.contacts.force["corner0"])
        assert path.estimated_error[i] == alone.estimated_error
    high = q[:, 2] > 20.0
    assert_same_bits(path.q[high], scene.without_contacts().simulate(q[high], qd[high], steps=6, **run).q)
    simulator = scene.simulator(q, qd, **run)
    for steps in (1, 1, 2):
        simulator.step(steps=steps)
    for other in (simulator, copy.copy(simulator), pickle.loads(pickle.dumps(simulator))):
        other.step(steps=2)
        assert_same_bits(other.q, path.q[:, -1])
        assert_same_bits(other.qd, path.qd[:, -1])


@pytest.mark.parametrize("more", [{}, {"friction": 0.05}, {"friction": 30.0}, {"stiffness": 20.0, "damping": 0.3}])
def test_a_contact_out_of_reach_leaves_the_bits_of_error_control(more: dict[str, float]) -> None:
    robot = chain(4)
    q, qd = np.array([0.4, -0.3, 0.5, 0.2]), np.array([1.0, -0.5, 0.3, 0.8])
    run = {"dt": 5e-2, "steps": 10, "accuracy": 1e-7, **more}
    paths = [s.simulate(q, qd, **run) for s in (with_plane(robot), robot)]
    assert_same(*paths)
    assert paths[0].estimated_error == paths[1].estimated_error


def test_a_tip_that_passes_the_plane_within_a_long_step_is_not_missed() -> None:
    def swing(offset: float) -> phipsi.Trajectory:
        scene = chain(1).to_builder().contact("tip", "link0", xyz=(0, 0, -0.4), friction=0.0, offset=offset).build()
        return scene.simulate([-1.0], [0.0], dt=1.0, steps=1, accuracy=1e-4)

    assert swing(-0.399).contacts.force["tip"].any() and not swing(-0.401).contacts.force["tip"].any()


def test_relaxed_contacts_have_error_control() -> None:
    scene, run = ball(0.3), {"smoothing": 1e-3, "limits": "report", "dt": 5e-2, "steps": 6}
    fine = scene.simulate(at(z=0.102), [0.5, 0, 0, 0, 0, 0], **(run | {"dt": 1e-5, "steps": 30_000, "record_every": 5_000}))
    errors = [np.abs(scene.simulate(at(z=0.102), [0.5, 0, 0, 0, 0, 0], accuracy=accuracy, **run).q - fine.q).max() for accuracy in (1e-4, 1e-7)]
    assert errors[1] < 1e-4 and errors[0] < 1e-2, errors


def test_trajectories_with_error_control_have_no_gradient() -> None:
    path = ball(0.3).simulate(at(), np.zeros(6), dt=1e-2, steps=2, accuracy=1e-6)
    with pytest.raises(ArgumentError, match="accuracy: found a simulation with error control"):
        path.vjp(np.ones((3, 6)))
    with pytest.raises(ArgumentError, match="accuracy: found error control with a fixed method"):
        ball(0.3).simulate(at(), np.zeros(6), dt=1e-2, steps=2, accuracy=1e-6, method="contact")
