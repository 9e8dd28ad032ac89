"""Gradients through sliding, sticking, substeps, returns to limits and control laws, compared with central differences
of the same steps; through impacts, rebounds and reversals of friction, with those of the motion.
"""

from __future__ import annotations

import numpy as np
import pytest
from motion_scenes import GRAVITY, robot, slide, start
from test_stops_in_loops import four_bar
from tolerances import EVENT_STEP, assert_near, assert_same_bits, of_order, product, size, through_events

import phipsi

#: Differences with respect to a start move contacts below their surface.
pytestmark = pytest.mark.filterwarnings("ignore::phipsi.errors.ContactWarning")

STEPS = 150

CASES: dict[str, tuple[dict[str, float], float, dict[str, object]]] = {
    "sliding": ({}, 1.0, {"steps": 20}),
    "sticking": ({"friction": 1.0}, 1.0, {}),
    "stuck": ({"friction": 30.0}, 1.0, {"steps": 40}),
    "divided steps": ({"friction": 0.0}, 60.0, {"steps": 5, "limits": "report"}),
    "return to a limit": ({"friction": 0.0, "range_of_motion": 0.2}, 0.1, {"steps": 40}),
    "control law": ({"friction": 0.0}, 1.0, {"pd": phipsi.PD(100.0, 10.0, np.array([0.2, -0.1, 0.1]), np.array([0.1, 0.0, -0.2]))}),
    "implicit Euler": ({"friction": 1.0}, 1.0, {"method": "implicit-euler"}),
    "order three": ({"friction": 1.0}, 1.0, {"method": "rosenbrock-3"}),
}
"""For each case: the robot, its initial speed, and arguments of simulate."""

#: Events that must occur in at least one robot of a case, by field of the trajectory.
HAPPENS = {"sticking": "events", "stuck": "events", "return to a limit": "events", "order three": "events"}


def differences(scene: phipsi.Scene, q: np.ndarray, qd: np.ndarray, seed: int, **given: object) -> phipsi.Trajectory:
    """Compare every gradient of a random function of the rows with central differences."""
    random = np.random.default_rng(seed)
    steps = int(given.setdefault("steps", STEPS))  # type: ignore[call-overload]
    given.setdefault("dt", 1e-3)
    given |= {"record_every": 5, "friction": scene.friction, "damping": scene.damping}
    tau = random.uniform(-0.3, 0.3, (steps, scene.nv))
    path = scene.simulate(q, qd, tau_steps=tau, **given)
    weights = random.normal(size=(2, len(path), scene.nv))
    found = path.vjp(*weights)

    def value(q: np.ndarray = q, qd: np.ndarray = qd, tau: np.ndarray = tau, **changed: object) -> float:
        other = scene.simulate(q, qd, tau_steps=tau, **{**given, **changed})
        return float(np.sum(weights[0] * scene.difference(path.q, other.q)) + np.sum(weights[1] * other.qd))

    def compare(kind: str, gradient: float, *ends: float) -> None:
        slope = (ends[0] - ends[1]) / (2 * EVENT_STEP)
        assert abs(gradient - slope) <= through_events(size(*found[:3])), f"{kind}: {gradient} against {slope}"

    for i, unit in enumerate(EVENT_STEP * np.eye(scene.nv)):
        compare("q", found.q[i], *(value(q=scene.integrate(q, change)) for change in (unit, -unit)))
        if qd[i] != 0.0:
            # At rest, friction opposes either change.
            compare("qd", found.qd[i], *(value(qd=qd + change) for change in (unit, -unit)))
        for kind, values in (("friction", scene.friction), ("damping", scene.damping)):
            if values[i] > 0.0:
                compare(kind, getattr(found, kind)[i], *(value(**{kind: values + change}) for change in (unit, -unit)))
        for n in (0, steps // 2, steps - 1):
            changed = np.zeros_like(tau)
            changed[n] = unit
            compare("tau", found.tau[n, i], *(value(tau=tau + change) for change in (changed, -changed)))
    return path


@pytest.mark.filterwarnings("ignore:q. found joint .* limit:phipsi.errors.LimitWarning")
@pytest.mark.parametrize("case", CASES)
def test_gradients_are_those_of_the_steps_that_were_made(case: str) -> None:
    make, speed, given = CASES[case]
    paths = []
    for seed in range(4):
        scene = robot(seed, **make)  # type: ignore[arg-type]
        q, qd = start(scene, seed)
        if case == "stuck":
            qd[0] = 0.0
        paths.append(differences(scene, q if speed >= 1.0 else 1.5 * q, speed * qd, seed, **given))
    if case in HAPPENS:
        assert any(bool(getattr(path, HAPPENS[case])) for path in paths)
    if case == "divided steps":
        assert all(path.substeps > 4 for path in paths)


@pytest.mark.parametrize("restitution", [0.5, 1.0])
def test_the_gradient_of_a_bounce_includes_the_time_of_the_impact(restitution: float) -> None:
    """A mass that falls from a height on the stop of its slide, in closed form."""
    height, duration, gravity = 1.0, 0.7, GRAVITY
    scene = slide(2.0, (0, 0, 1), lower=0.0)
    path = scene.simulate([height], [0.0], dt=1e-3, duration=duration, restitution=restitution)
    speed, rising = np.sqrt(2 * gravity * height), duration - np.sqrt(2 * height / gravity)
    assert_near(path.q[-1, 0], restitution * speed * rising - 0.5 * gravity * rising**2, of_order(2, 1e-3, gravity))
    later = -1.0 / speed
    by_height = restitution * gravity / speed, restitution * gravity / speed + gravity * -later
    expected = by_height[0] * rising + restitution * speed * later - gravity * rising * later, by_height[1]
    assert expected[0] < 1.0
    for k, weights in enumerate(np.eye(2)):
        of_rows = np.zeros((2, len(path), 1))
        of_rows[:, -1, 0] = weights
        assert_near(path.vjp(*of_rows).q[0], expected[k], 1e-5 * expected[1])


@pytest.mark.parametrize(("restitution", "friction", "bound"), [(0.6, 0.0, 1e-4), (1.0, 0.0, 1e-4), (0.0, 0.0, 5e-2), (0.6, 0.3, 1e-2)])
def test_gradients_through_impacts_are_those_of_the_motion(restitution: float, friction: float, bound: float) -> None:
    """Compared with differences of simulations with error control, in which times of impacts are exact to 1e-10."""
    impacts = 0
    for seed in range(3):
        scene = robot(seed, range_of_motion=0.35, friction=friction)
        q, qd = start(scene, seed)
        weights = np.random.default_rng(seed).normal(size=(2, scene.nv))
        given = {"restitution": restitution, "damping": scene.damping}
        path = scene.simulate(q, qd, dt=1e-3, steps=STEPS, **given)
        of_rows = np.zeros((2, len(path), scene.nv))
        of_rows[:, -1] = weights
        found = path.vjp(*of_rows)
        impacts += len(path.stops)

        def value(change: np.ndarray, scene: phipsi.Scene = scene, q: np.ndarray = q, qd: np.ndarray = qd, weights: np.ndarray = weights, path: phipsi.Trajectory = path, given: dict[str, object] = given) -> float:
            other = scene.simulate(scene.integrate(q, change[0]), qd + change[1], dt=1e-3 * STEPS, steps=1, accuracy=1e-10, **given)
            return float(weights[0] @ scene.difference(path.q[-1], other.q[-1]) + weights[1] @ other.qd[-1])

        for unit in 1e-5 * np.eye(2 * scene.nv):
            change = unit.reshape(2, scene.nv)
            slope = (value(change) - value(-change)) / 2e-5
            assert_near(np.sum(1e5 * change * [found.q, found.qd]), slope, bound * size(found.q, found.qd))
    assert impacts >= 4


@pytest.mark.parametrize("friction", [2.0, 8.0, 20.0])
@pytest.mark.parametrize("dt", [1e-2, 1.3e-3])
def test_a_block_that_slides_up_an_incline_and_back_has_the_gradients_of_the_closed_form(friction: float, dt: float) -> None:
    """The velocity after the reversal has the derivative a+/a with respect to that at the start; zero if it stays."""
    mass, angle, speed, steps = 2.0, 0.7, 3.0, round(1.0 / dt)
    scene = slide(mass, (np.cos(angle), 0.0, np.sin(angle)), friction=friction)
    before, after = (-GRAVITY * np.sin(angle) - friction / mass, min(0.0, -GRAVITY * np.sin(angle) + friction / mass))
    path = scene.simulate([0.0], [speed], dt=dt, steps=steps)
    turning = -speed / before
    assert_near(path.qd[-1, 0], after * (dt * steps - turning), of_order(1, dt, 1.0))
    for weights, expected in (((0.0, 1.0), after / before), ((1.0, 0.0), turning + after / before * (dt * steps - turning))):
        assert_near(at_end(path, np.array(weights)[:, None]).qd[0], expected, of_order(1, dt, 0.02))


@pytest.mark.parametrize("kind", ["loop", "mimic"])
def test_coupled_blocks_that_slide_back_have_the_gradients_of_the_closed_form(kind: str) -> None:
    """Blocks of 2 and 3 kg that move together."""
    builder = phipsi.SceneBuilder().link("base").link("left", 2.0).link("right", 3.0).joint("left", "prismatic", "base", "left", axis=(1, 0, 0), friction=3.0)
    if kind == "loop":
        scene = builder.joint("right", "prismatic", "base", "right", axis=(1, 0, 0)).couple("together", "left", "right").build()
    else:
        scene = builder.joint("right", "prismatic", "base", "right", axis=(1, 0, 0), mimic="left").build(mimic="couple")
    path = scene.simulate(np.zeros(scene.nq), np.ones(scene.nv), tau=[-8.0] + [0.0] * (scene.nv - 1), dt=1e-2, steps=100)
    by_qd = np.zeros((101, scene.nv))
    by_qd[-1, 0] = 1.0
    assert_near(path.vjp(cotangent_qd=by_qd).qd.sum(), 5.0 / 11.0, product(100, 1.0))


def test_gradients_through_reversals_of_friction_are_those_of_the_motion() -> None:
    """Two joints, one of which slides back. The differences of the steps are off by 29 %."""
    scene = robot(3, joints=2, friction=0.6, damping=0.1)
    gradients_of_the_motion(scene, *start(scene, 3), 1e-3, 600)


def dropped(friction: float = 0.0, restitution: float = 0.0) -> phipsi.Scene:
    """A free body whose center is the contact point."""
    builder = phipsi.SceneBuilder().link("ball", mass=0.5, inertia=0.002 * np.eye(3))
    return builder.contact("ground", "ball", friction=friction, restitution=restitution).build(floating_base=True)


def at_end(path: phipsi.Trajectory, weights: np.ndarray) -> phipsi.RolloutGradients:
    """Gradients of weights @ (q, qd) of the last row."""
    of_rows = np.zeros((2, len(path), path.scene.nv))
    of_rows[:, -1] = weights
    return path.vjp(*of_rows)


def bounces(height: float, restitution: float, duration: float, plane: float = 0.0) -> np.ndarray:
    """Height and velocity after bounces from rest, from parabola to parabola."""
    z, v, left = height - plane, 0.0, duration
    while (fall := (v + np.sqrt(v**2 + 2 * GRAVITY * z)) / GRAVITY) < left:
        z, v, left = 0.0, restitution * (GRAVITY * fall - v), left - fall
    return np.array([plane + z + v * left - 0.5 * GRAVITY * left**2, v - GRAVITY * left])


@pytest.mark.parametrize("dt", [1e-3, 5e-3])
@pytest.mark.parametrize(("restitution", "duration"), [(0.5, 0.35), (0.8, 0.35), (0.5, 0.6), (1.0, 0.9)])
def test_a_ball_bounces_as_in_closed_form_with_its_gradients(restitution: float, duration: float, dt: float) -> None:
    """Over one bounce and over two, exactly: d z / d z0 = -e and not +1 right after an impact."""
    scene, step = dropped(restitution=restitution), 1e-6
    path = scene.simulate([0, 0, 0.3, 0, 0, 0, 1.0], np.zeros(6), dt=dt, duration=duration)
    expected = bounces(0.3, restitution, duration)
    assert_near(np.array([path.q[-1, 2], path.qd[-1, 2]]), expected, 1e-11)
    by = lambda of: (of(step) - of(-step)) / (2 * step)  # noqa: E731
    slopes = by(lambda x: bounces(0.3 + x, restitution, duration)), by(lambda x: bounces(0.3, restitution + x, duration)), by(lambda x: bounces(0.3, restitution, duration, x))
    for k, weights in enumerate(np.eye(2)):
        found = at_end(path, np.outer(weights, np.eye(6)[2]))
        ground = found.contacts["ground"]
        assert_near(np.array([found.q[2], ground.restitution, ground.offset]), np.array([slope[k] for slope in slopes]), through_events(100.0))


def test_the_gradient_right_after_a_bounce_has_the_sign_of_the_motion() -> None:
    path = dropped(restitution=0.8).simulate([0, 0, 1e-4, 0, 0, 0, 1.0], [0, 0, -1.0, 0, 0, 0], dt=1e-3, steps=1)
    assert_near(at_end(path, np.outer([1.0, 0.0], np.eye(6)[2])).q[2], -0.8, 1e-1)


def test_a_landing_without_rebound_has_the_gradients_of_the_motion() -> None:
    """The body stays on the plane, and slides there: x changes by the friction coefficient times the height."""
    mu = 0.2
    path = dropped(mu).simulate([0, 0, 0.3, 0, 0, 0, 1.0], [1.0, 0, 0, 0, 0, 0], dt=1e-3, duration=0.35)
    assert path.qd[-1, 0] > 0.1 and abs(path.q[-1, 2]) < 1e-9
    for kind, direction, expected in ((0, 2, 0.0), (1, 2, 0.0), (0, 0, mu), (1, 0, 0.0)):
        found = at_end(path, np.outer(np.eye(2)[kind], np.eye(6)[direction])).q[2]
        assert_near(found, expected, 1e-6), (kind, direction)


def test_bounces_that_die_out_end_and_have_no_gradient() -> None:
    path = dropped(restitution=0.5).simulate([0, 0, 0.3, 0, 0, 0, 1.0], np.zeros(6), dt=1e-3, duration=1.0)
    assert abs(path.q[-1, 2]) < 1e-9 and abs(path.qd[-1, 2]) < 1e-9
    assert np.diff(path.energy().total).max() < 1e-9
    assert_near(at_end(path, np.outer([1.0, 1.0], np.eye(6)[2])).q[2], 0.0, 1e-6)


def gradients_of_the_motion(scene: phipsi.Scene, q: np.ndarray, qd: np.ndarray, dt: float, steps: int, **given: object) -> None:
    """Compare gradients with differences of simulations with error control, along states that satisfy the connections."""
    path, step = scene.simulate(q, qd, dt=dt, steps=steps, **given), 1e-5
    weights = np.random.default_rng(3).normal(size=(2, scene.nv))
    found = at_end(path, weights)

    def value(state: tuple[np.ndarray, np.ndarray]) -> float:
        end = scene.simulate(*state, dt=dt * steps, steps=1, accuracy=1e-10, **given)
        return float(weights[0] @ scene.difference(path.q[-1], end.q[-1]) + weights[1] @ end.qd[-1])

    for change in np.eye(2 * scene.nv).reshape(-1, 2, scene.nv):
        states = [(scene.integrate(q, by * change[0]), qd + by * change[1]) for by in (step, -step)]
        if scene.loops.names:
            states = [tuple(scene.loops.project(*state)[:2]) for state in states]
        along = np.array([scene.difference(states[1][0], states[0][0]), states[0][1] - states[1][1]])
        slope = (value(states[0]) - value(states[1])) / (2 * step)
        assert_near(float(np.sum(along * [found.q, found.qd])) / (2 * step), slope, 1e-2 * size(found.q, found.qd))


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_gradients_of_a_double_pendulum_that_bounces_are_those_of_the_motion(friction: float) -> None:
    builder = phipsi.SceneBuilder().link("base")
    for name, parent, at in (("upper", "base", 0.0), ("lower", "upper", -0.5)):
        builder.link(name, 1.0, (0, 0, -0.25), np.diag([0.02, 0.02, 0.001]))
        builder.joint(f"hinge of {name}", "revolute", parent, name, xyz=(0, 0, at), axis=(0, 1, 0))
    scene = builder.contact("tip", "lower", xyz=(0, 0, -0.5), friction=friction, restitution=0.6, offset=-0.9).build()
    q, qd = np.array([0.5, 0.2]), np.array([0.5, -0.2])
    assert (scene.simulate(q, qd, dt=1e-3, steps=300).contacts.impulse["tip"][:, 2] > 0).sum() == 1
    gradients_of_the_motion(scene, q, qd, 2.5e-4, 1200)


@pytest.mark.parametrize("restitution", [0.5, 1.0])
def test_gradients_of_a_linkage_that_rebounds_from_its_stop_are_those_of_the_motion(restitution: float) -> None:
    q, qd, _ = four_bar(-9.0, 9.0).loops.project([0.5, 0.8, 0.2], [1.0, 0.0, 0.0])
    scene = four_bar(-9.0, q[2] + 0.05)
    assert scene.simulate(q, qd, dt=1e-3, steps=150, restitution=restitution).stops
    gradients_of_the_motion(scene, q, qd, 1e-3, 150, restitution=restitution)


def test_gradients_of_a_floating_robot_that_sticks() -> None:
    """With a long step, for which the second stage of a free joint is far from the first."""
    scene = robot(2, floating_base=True, friction=2.0)
    q, qd = start(scene, 2)
    assert differences(scene, q, qd, 2, dt=1e-2, steps=40).events > 0


def test_a_stuck_joint_has_no_gradient_by_its_torque() -> None:
    scene = robot(0, friction=1e3)
    path = scene.simulate(np.zeros(3), np.zeros(3), dt=1e-3, steps=20, tau=[0.1, 0.1, 0.1])
    found = path.vjp(np.ones((21, 3)), np.ones((21, 3)))
    assert not path.qd.any() and not found.tau.any()
    assert_near(found.q, np.full(3, 21.0), product(21, 21.0))


@pytest.mark.parametrize("restitution", [0.0, 0.6])
def test_a_batch_has_the_gradients_of_its_states(restitution: float) -> None:
    scene = robot(1, range_of_motion=0.35)
    starts = [start(scene, seed) for seed in range(11)]
    q, qd = (np.stack(values) for values in zip(*starts, strict=True))
    given = {"dt": 1e-3, "steps": 200, "restitution": restitution, "record_every": 10}
    path = scene.simulate(q, qd, **given)
    assert path.events.any() and path.stops
    weights = np.random.default_rng(1).normal(size=(2, 11, 21, 3))
    whole = path.vjp(*weights)
    for i in range(11):
        alone = scene.simulate(q[i], qd[i], **given).vjp(*weights[:, i])
        for one, of_all in zip(alone[:7], whole[:7], strict=True):
            assert_near(one, of_all[i], product(3 * 200, size(of_all[i])))
    before = phipsi.get_num_threads()
    try:
        phipsi.set_num_threads(3)
        again = path.vjp(*weights)
    finally:
        phipsi.set_num_threads(before)
    for one, other in zip(again[:7], whole[:7], strict=True):
        assert_same_bits(one, other)
