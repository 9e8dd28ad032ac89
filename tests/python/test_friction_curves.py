"""Friction that depends on direction, speed and load: motion against SciPy, thresholds in closed form, identification of
the parameters of a scene, and files.
"""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tolerances import assert_near, assert_same_bits, product

import phipsi
from phipsi.errors import ArgumentError, SceneError

ALL = {"friction": 1.0, "stribeck": 0.8, "stribeck_speed": 0.3, "load_friction": 0.2, "friction_offset": 0.3}
Q = np.array([0.1, -0.5, 0.4, 0.2, 0.3, -0.2])
QD = np.array([3.0, -2.0, 2.5, -4.0, 3.0, 4.0])


def block(gravity: float = 0.0, **joint: Any) -> phipsi.Scene:
    builder = phipsi.SceneBuilder().link("rail").link("block", mass=2.0)
    return builder.joint("x", "prismatic", "rail", "block", axis=(1, 0, 0), **joint).build(gravity=(-gravity, 0, 0))


def arm() -> phipsi.Scene:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    terms = {"joint1": 0.1, "joint3": -0.2}
    return scene.with_properties(friction=0.5, stribeck=0.4, stribeck_speed=0.3, load_friction=0.1, friction_offset=terms)


def reaching(scene: phipsi.Scene, u: Any, v: Any, s: Any) -> np.ndarray:
    """Torques t that reach the bodies, t = u - o - s (f + g exp(-(v/v0)^2) + c |t|), by iteration."""
    offset, stribeck, speed, share = scene.friction_terms
    t = np.zeros_like(u)
    for _ in range(40):
        t = u - offset - s * (scene.friction + stribeck * np.exp(-((v / speed) ** 2)) + share * np.abs(t))
    return t


def reference(scene: phipsi.Scene, q: Any, qd: Any, tau: Any, duration: float) -> np.ndarray:
    """The end of a motion in which all joints keep their direction."""
    n = len(q)
    s = np.where(np.sign(qd) == 0.0, np.sign(tau), np.sign(qd))

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        t = reaching(scene, tau - scene.damping * y[n:], y[n:], s)
        return np.concatenate([y[n:], scene.forward_dynamics(y[:n], y[n:], t)])

    return np.asarray(solve_ivp(rates, (0.0, duration), np.concatenate([q, qd]), rtol=1e-12, atol=1e-13, method="DOP853").y[:, -1])


@pytest.mark.parametrize(
    ("method", "order"),
    [("rk4", 4), ("rosenbrock-2", 2), ("rosenbrock-3", 3), ("implicit-euler", 1), ("semi-implicit-euler", 1)],
)
def test_sliding_joints_move_as_scipy_says(method: Any, order: int) -> None:
    scene, tau = arm(), np.array([2.0, -9.0, 3.0, 0.5, -0.2, 0.1])
    expected = reference(scene, Q, QD, tau, 0.05)
    errors = []
    for steps in (20, 40):
        path = scene.simulate(Q, QD, tau=tau, dt=0.05 / steps, steps=steps, method=method)
        assert path.events == 0 and np.all(path.qd * np.sign(QD) > 0.0)
        errors.append(np.abs(np.concatenate([path.q[-1], path.qd[-1]]) - expected).max())
    assert errors[0] < 1.2 * 2.0**order * errors[1] + 1e-13 and errors[1] < {4: 1e-10, 3: 1e-8, 2: 2e-6, 1: 3e-3}[order]
    plain = scene.with_properties(stribeck=0.0, load_friction=0.0, friction_offset=0.0)
    assert np.abs(plain.simulate(Q, QD, tau=tau, dt=0.05, steps=1).qd[-1] - expected[6:]).max() > 0.05


@pytest.mark.parametrize("tau", [5.0, -4.0])
def test_a_block_starts_to_slide(tau: float) -> None:
    scene = block(**ALL)
    path = scene.simulate([0.0], [0.0], tau=[tau], dt=1e-3, steps=500)
    assert_near([path.q[-1, 0], path.qd[-1, 0]], reference(scene, np.zeros(1), np.zeros(1), np.array([tau]), 0.5), 1e-6)


@pytest.mark.parametrize("holder", ["tree", "contact far away", "loop beside"])
@pytest.mark.parametrize("weight", [0.0, 6.0])
def test_what_friction_holds_is_held(holder: str, weight: float) -> None:
    """At rest, u - W = -r with the friction r up to 1.8 + 0.2 |W| and the offset 0.3."""
    builder = block(gravity=weight / 2.0, **ALL).to_builder()
    if holder == "contact far away":
        builder = builder.contact("far", "block", normal=(0, 0, 1), offset=-100.0, friction=0.5)
    elif holder == "loop beside":
        for k, parent in enumerate(("rail", "bar0", "bar1")):
            builder = builder.link(f"bar{k}", mass=1.0, com=(0.5, 0, 0), inertia=np.eye(3) * 0.1)
            builder = builder.joint(f"hinge{k}", "revolute", parent, f"bar{k}", xyz=(float(k > 0), 0, 0), axis=(0, 0, 1))
        builder = builder.connect("tip", "point", "bar2", xyz=(1.0, 0, 0), other="rail", other_xyz=(1.5, 1.0, 0.0))
    scene = builder.build(gravity=(-weight / 2.0, 0, 0))
    q, at = scene.neutral(), scene.v_index("x").start
    if holder == "loop beside":
        q[scene.q_index("hinge0")], q[scene.q_index("hinge1")] = 0.9, -1.2
        q = scene.loops.project(q).q
    bound = 1.8 + 0.2 * weight
    for tau, moves in [(bound - 0.01, False), (bound + 0.01, True), (-bound + 0.01, False), (-bound - 0.01, True)]:
        torque = np.zeros(scene.nv)
        torque[at] = weight + 0.3 + tau
        lock = {} if holder != "loop beside" else {"damping": np.where(np.arange(scene.nv) == at, 0.0, 1e3)}
        path = scene.simulate(q, np.zeros(scene.nv), tau=torque, dt=1e-3, steps=20, **lock)
        assert (path.qd[-1, at] != 0.0) == moves, (holder, weight, tau, path.qd[-1])
        if moves:
            assert path.qd[-1, at] * tau > 0.0


def test_a_row_out_of_reach_and_a_second_state_change_no_bit() -> None:
    scene = arm()
    path = scene.simulate(Q, QD, dt=1e-3, steps=600)
    assert path.events > 0
    far = scene.to_builder().contact("far", "link6", normal=(0, 0, 1), offset=-100.0, friction=0.5).build()
    assert_same_bits(far.simulate(Q, QD, dt=1e-3, steps=600).q, path.q)
    both = scene.simulate(np.stack([Q, Q + 0.1]), np.stack([QD, -QD]), dt=1e-3, steps=600)
    assert_same_bits(both.q[0], path.q)


@pytest.mark.parametrize("friction", [0.0, 0.1, 0.4])
@pytest.mark.parametrize("speed", [2.0, -2.0])
@pytest.mark.parametrize("offset", [0.5, -0.5])
def test_an_offset_above_friction_is_a_constant_torque_of_a_moving_joint(friction: float, speed: float, offset: float) -> None:
    rod = phipsi.SceneBuilder().link("base").link("rod", 1.0, (0, 0, -0.5))
    scene = rod.joint("hinge", "revolute", "base", "rod", axis="y", friction=friction, friction_offset=offset).build()
    plain = scene.with_properties(friction_offset=0.0)
    for how in ({}, {"accuracy": 1e-8}):
        found = scene.simulate([0.0], [speed], dt=1e-3, steps=150, **how)
        expected = plain.simulate([0.0], [speed], tau=[-offset], dt=1e-3, steps=150, **how)
        assert np.all(expected.qd * speed > 0.0) and found.events == 0
        assert_near(found.q, expected.q, 1e-12 if not how else 1e-8)
    # At rest, and where it turns.
    turning = scene.simulate([0.3], [0.0], dt=1e-3, steps=1500, accuracy=1e-6)
    assert_near(turning.q, scene.simulate([0.3], [0.0], dt=1e-4, steps=15000, record_every=10).q, 1e-4)


@pytest.mark.parametrize("arguments", [{}, {"method": "rosenbrock-2"}, {"friction_speed": 0.01}])
def test_the_energy_balances(arguments: Any) -> None:
    audit = arm().simulate(Q, QD, dt=5e-4, steps=800, tau=[3.0, 20.0, 5.0, 1.0, 1.0, 0.5], **arguments).energy_audit()
    assert audit.friction < -3.0 and abs(audit.remainder) < 2e-3 * abs(audit.change)


def test_regularized_friction_is_near_the_exact_one() -> None:
    scene = arm()
    exact = scene.simulate(Q, QD, dt=1e-3, steps=50)
    near = scene.simulate(Q, QD, dt=1e-3, steps=50, friction_speed=1e-3)
    assert_near(near.qd[-1], exact.qd[-1], 1e-5)
    slow = block(**ALL).simulate([0.0], [0.0], tau=[1.5], dt=1e-3, steps=200, friction_speed=0.01)
    assert 0.0 < slow.qd[-1, 0] < 0.01


@pytest.mark.parametrize(("kp", "dt"), [(1e3, 1e-3), (1e6, 4e-3)])
@pytest.mark.parametrize("effort", [None, True])
def test_servos_settle_within_friction(kp: float, dt: float, effort: Any) -> None:
    scene, goal = arm(), np.array([0.5, -0.3, 0.2, 0.1, 0.4, 0.3])
    path = scene.simulate(Q, np.zeros(6), dt=dt, steps=int(3.0 / dt), pd=phipsi.PD(kp, 2.0 * kp**0.5, goal, effort=effort))
    held = 1.1 * np.abs(scene.gravity_torque(goal)) + 1.1 * (0.9 + 0.2)
    assert np.all(np.abs(path.q[-1] - goal) <= held / kp) and np.abs(path.qd[-1]).max() < 1e-9


def test_what_is_identified_moves_and_is_identified_again() -> None:
    """Scene, torques of its motion, fit, motion of the fit, and a fit of that motion."""
    fit = ("friction", "damping", "offset", "stribeck", "load")
    start = block(gravity=4.0)
    true = block(gravity=4.0, friction=1.0, damping=0.7, stribeck=0.6, stribeck_speed=0.1, load_friction=0.1, friction_offset=0.25)

    def moved(scene: phipsi.Scene, seed: int) -> phipsi.Identification:
        random, t = np.random.default_rng(seed), np.arange(4000) * 1e-3
        tau = 8.5 + 6.0 * np.sin(2.0 * np.pi * 0.8 * t) + 5.0 * np.sin(2.0 * np.pi * 2.7 * t)
        path = scene.simulate([0.0], [0.1], tau_steps=tau[:, None], dt=1e-3, steps=4000)
        rows = np.flatnonzero(np.abs(path.qd[:-1, 0]) > 0.02)
        qdd = np.diff(path.qd, axis=0)[rows] / path.dt
        middle = 0.5 * (path.qd[rows] + path.qd[rows + 1])
        noisy = tau[rows, None] + random.normal(0.0, 0.02, (len(rows), 1))
        return start.identify(path.q[rows], middle, qdd, noisy, fit=fit, friction_speed=1e-4, noise=0.02, keep=["block"])

    found = moved(true, 1)
    again = moved(found.scene, 2)
    for one, expected in ((found, true), (again, found.scene)):
        values = expected.joint("x")
        named = {"friction": values.friction, "damping": values.damping, "offset": values.friction_offset, "stribeck": values.stribeck, "load": values.load_friction}
        for kind, value in named.items():
            deviation = one.joint_deviations[kind]["x"]
            assert deviation < 0.05 and abs(one.joints[kind]["x"] - value) < 4.0 * deviation + 2e-3, (kind, value, one.joints[kind])
    assert abs(found.scene.joint("x").stribeck) > 0.3


def test_files_and_copies_keep_all_terms() -> None:
    scene = arm()
    for other in (phipsi.load(scene.to_urdf()), pickle.loads(pickle.dumps(scene)), scene.to_builder().build()):
        assert_same_bits(other.friction_terms, scene.friction_terms)
        assert other.joint("joint3").friction_offset == -0.2
    assert_near(scene.friction_terms[:, 2], [-0.2, 0.4, 0.3, 0.1], product(1, 1.0))
    path = scene.simulate(Q, QD, dt=1e-3, steps=2)
    assert_near(path.torques()[0], reaching(scene, -scene.damping * QD, QD, np.sign(QD)), product(50, 50.0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"load_friction": 1.0}, r"load_friction 1; expected a number from 0 to below 1"),
        ({"stribeck": -2.0}, "stribeck -2.* with friction 1"),
        ({"stribeck_speed": 0.0}, "stribeck_speed 0.*expected a finite speed above zero"),
        ({"friction_offset": np.inf}, "friction_offset inf"),
    ],
)
def test_impossible_terms_are_refused(change: Any, message: str) -> None:
    block(**ALL)
    with pytest.raises(SceneError, match=message):
        block(**(ALL | change))


def test_what_has_no_such_friction_says_so() -> None:
    scene = block(**ALL)
    path = scene.simulate([0.0], [1.0], dt=1e-3, steps=5)
    with pytest.raises(ArgumentError, match="gradients with friction_offset, stribeck or load_friction of joint \"x\""):
        path.vjp(cotangent_q=np.ones_like(path.q))
    with pytest.raises(ArgumentError, match="ode: found friction_offset at the joint 'x'"):
        scene.ode()
    builder = scene.to_builder().link("finger", mass=1.0).joint("y", "prismatic", "rail", "finger", axis=(0, 1, 0), mimic="x")
    coupled = builder.build(mimic="couple")
    with pytest.raises(ArgumentError, match="of joint \"x\", which follows others or moves them"):
        coupled.simulate([0.0], [1.0], dt=1e-3, steps=5)
