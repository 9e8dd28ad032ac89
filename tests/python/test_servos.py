"""Control laws with limits of effort, targets that change, and the effort of joints, compared with closed forms, SciPy,
MuJoCo, the equations of motion of each step, and central differences.
"""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tolerances import assert_near, assert_same_bits, product, size

import phipsi


def cart(mass: float = 2.0, **joint: Any) -> phipsi.Scene:
    builder = phipsi.SceneBuilder().link("rail").link("cart", mass=mass)
    return builder.joint("x", "prismatic", "rail", "cart", axis=(1, 0, 0), **joint).build(gravity=(0, 0, 0))


def arm(seed: int = 3, joints: int = 4) -> phipsi.Scene:
    """A chain of random links with limits of effort."""
    random = np.random.default_rng(seed)
    builder = phipsi.SceneBuilder().link("base")
    for k in range(joints):
        turn = np.diag(random.uniform(0.01, 0.03, 3))
        builder = builder.link(f"link{k}", mass=random.uniform(0.5, 2.0), com=random.uniform(-0.1, 0.2, 3), inertia=turn)
        parent = "base" if k == 0 else f"link{k - 1}"
        axis = np.eye(3)[k % 3]
        builder = builder.joint(f"joint{k}", "revolute", parent, f"link{k}", xyz=(0.0, 0.0, 0.3), axis=axis, effort=10.0 / (k + 1))
    return builder.build()


def applied(scene: phipsi.Scene, path: phipsi.Trajectory) -> np.ndarray:
    """The torques of the motors in each step of "implicit-euler" or "contact", from the equations of motion at its start."""
    accelerations = np.diff(path.qd, axis=-2) / path.dt
    return np.asarray(scene.inverse_dynamics(path.q[..., :-1, :], path.qd[..., :-1, :], accelerations))


def law(scene: phipsi.Scene, path: phipsi.Trajectory, pd: phipsi.PD, limit: np.ndarray | float) -> np.ndarray:
    """The law at the end of each step, where the joints move on with the last velocity."""
    ends = path.q[..., :-1, :] + path.dt * path.qd[..., 1:, :]
    torque = np.asarray(pd.kp) * (np.asarray(pd.target) - ends) - np.asarray(pd.kd) * path.qd[..., 1:, :]
    return np.clip(torque, -limit, limit)


@pytest.mark.parametrize("method", ["auto", "implicit-euler", "semi-implicit-euler", "rk4", "rosenbrock-2", "rosenbrock-3"])
def test_a_servo_far_from_its_target_accelerates_evenly_and_settles(method: Any) -> None:
    scene, limit = cart(), 10.0
    path = scene.simulate([0.0], [0.0], dt=1e-3, steps=6000, pd=phipsi.PD(200.0, 40.0, [1.0], effort=limit), method=method)
    even = int(np.argmax(200.0 * (1.0 - path.q[:, 0]) - 40.0 * path.qd[:, 0] < limit)) - 2
    assert even > 100
    np.testing.assert_allclose(path.qd[:even, 0], 5.0 * path.t[:even], rtol=1e-11, atol=1e-14)
    shift = {"implicit-euler": 0.5, "semi-implicit-euler": 0.5}.get(method, 0.0) * path.dt * path.qd[:even, 0]
    np.testing.assert_allclose(path.q[:even, 0], 2.5 * path.t[:even] ** 2 + shift, rtol=1e-11, atol=1e-14)
    assert abs(path.q[-1, 0] - 1.0) < 1e-5 and abs(path.qd[-1, 0]) < 1e-5
    # No step has more force than the limit.
    assert np.abs(np.diff(path.qd[:, 0])).max() <= 5.0 * path.dt * (1.0 + 1e-10)
    assert np.abs(path.torques()).max() == limit


@pytest.mark.parametrize("accuracy", [None, 1e-8])
@pytest.mark.parametrize("gains", [(200.0, 8.0), (40.0, 12.0)])
def test_two_joints_move_as_scipy_integrates_them(gains: tuple[float, float], accuracy: float | None) -> None:
    scene = phipsi.scenes.chain(2)
    limit, target = np.array([3.0, 2.0]), np.array([0.9, -0.7])
    pd = phipsi.PD(*gains, target, effort=limit)
    q, qd = np.array([-0.5, 0.4]), np.array([0.3, -1.0])
    time: Any = {"duration": 1.5, "accuracy": accuracy} if accuracy else {"dt": 5e-4, "steps": 3000}
    path = scene.simulate(q, qd, pd=pd, **time)

    def right(_: float, y: np.ndarray) -> np.ndarray:
        torque = np.clip(gains[0] * (target - y[:2]) - gains[1] * y[2:], -limit, limit)
        return np.concatenate([y[2:], np.linalg.solve(scene.mass_matrix(y[:2]), torque - scene.bias_torque(y[:2], y[2:]))])

    exact = solve_ivp(right, (0.0, 1.5), np.concatenate([q, qd]), rtol=1e-11, atol=1e-12, max_step=2e-3).y[:, -1]
    assert_near(np.concatenate([path.q[-1], path.qd[-1]]), exact, 1e-5 if accuracy else 2e-3)
    # Without error control, steps in which a motor reaches its limit or leaves it are not divided.
    assert (path.events > 0) == (accuracy is not None)


@pytest.mark.parametrize("method", ["implicit-euler", "contact"])
@pytest.mark.parametrize("kp", [1e2, 1e4, 1e6])
def test_the_torque_of_every_step_is_the_clipped_law(kp: float, method: Any) -> None:
    scene = arm()
    if method == "contact":
        builder = scene.to_builder().contact("far", "link3", friction=0.5, offset=-90.0)
        scene = builder.build()
    limit = scene.limits.effort
    pd = phipsi.PD(kp, kp / 20, np.array([0.4, -0.3, 0.5, 0.2]), effort=True)
    path = scene.simulate(np.zeros(4), np.zeros(4), dt=1e-3, steps=1500, pd=pd, method=method)
    torque = applied(scene, path)
    scale = limit + 1e-9 * kp
    assert np.all(np.abs(torque) <= limit + 1e-9 * scale)
    np.testing.assert_allclose(torque, law(scene, path, pd, limit), rtol=0, atol=1e-8 * scale.max())
    beyond = np.isclose(np.abs(torque), limit, rtol=1e-9).mean(axis=0)
    assert beyond.max() > 0.02 and beyond.min() < 0.98


def test_random_servos_stay_stable() -> None:
    random, scene = np.random.default_rng(11), arm()
    for _ in range(60):
        kp, dt = 10.0 ** random.uniform(2, 6), 10.0 ** random.uniform(-4, np.log10(4e-3))
        kd, limit = kp * 10.0 ** random.uniform(-3, 0), 10.0 ** random.uniform(-1, 3)
        target = random.uniform(-1.5, 1.5, 4)
        path = scene.simulate(random.uniform(-1.5, 1.5, 4), random.uniform(-3, 3, 4), dt=dt, steps=150, pd=phipsi.PD(kp, kd, target, effort=limit))
        energy = path.energy()
        gained = energy.total - energy.total[0]
        # Motors add at most the limit times the way.
        way = np.abs(np.diff(path.q, axis=0)).sum()
        assert gained.max() <= limit * way + 0.05 * energy.kinetic.max() + 1e-9, (kp, kd, limit, dt)
        assert np.abs(path.torques()).max() <= limit * (1.0 + 1e-12)


def test_a_limit_that_is_never_reached_changes_no_bit() -> None:
    scene = arm()
    q, qd, target = np.full(4, 0.2), np.full(4, -0.1), np.array([0.4, -0.3, 0.5, 0.2])
    for method in ("auto", "implicit-euler", "rosenbrock-3"):
        own, limited = (scene.simulate(q, qd, dt=1e-3, steps=200, pd=phipsi.PD(300.0, 20.0, target, effort=effort), method=method) for effort in (None, 1e9))
        assert_same_bits(own.q, limited.q)
        assert_same_bits(own.qd, limited.qd)


@pytest.mark.parametrize("method", ["implicit-euler", "rosenbrock-2", "rk4"])
def test_lanes_are_the_states_one_by_one(method: Any) -> None:
    random, scene, n = np.random.default_rng(5), arm(), 11
    q, target = random.uniform(-1, 1, (n, 4)), random.uniform(-1, 1, (n, 4))
    kp = 10.0 ** random.uniform(1, 2 if method == "rk4" else 5, (n, 4))
    kp[3], kp[5, 1] = 0.0, 0.0
    effort = random.uniform(0.1, 20.0, (n, 4))
    effort[2] = np.inf
    how: Any = {"dt": 2e-3, "steps": 200, "method": method}
    path = scene.simulate(q, np.zeros(4), pd=phipsi.PD(kp, 0.1 * kp, target, effort=effort), **how)
    for i in range(n):
        alone = scene.simulate(q[i], np.zeros(4), pd=phipsi.PD(kp[i], 0.1 * kp[i], target[i], effort=effort[i]), **how)
        if kp[i].all():
            assert_same_bits(path.q[i], alone.q)
            assert_same_bits(path.qd[i], alone.qd)
        else:
            # The kernels have noise for a gain that is zero in this state alone.
            assert_near(path.q[i], alone.q, 1e-12)


STATES: dict[str, tuple[float, float, float, float]] = {
    "at rest on its target": (0.0, 0.0, 5.0, 0.0),
    "in equilibrium below its limit": (0.0, 0.0, 30.0, 19.62),
    "exactly at its limit": (0.0, 0.0, 19.62, 19.62),
    "beyond its limit": (0.0, 0.0, 10.0, 19.62),
}


@pytest.mark.parametrize("name", STATES)
def test_states_of_equilibrium(name: str) -> None:
    """A mass of 2 kg on a vertical rail: above its limit the servo falls with the rest of its weight."""
    q, qd, limit, weight = STATES[name]
    builder = phipsi.SceneBuilder().link("rail").link("mass", mass=2.0)
    scene = builder.joint("z", "prismatic", "rail", "mass", axis=(0, 0, 1)).build(gravity=(0, 0, -weight / 2.0))
    kp, kd = 1000.0, 90.0
    start = q - (min(weight, limit) / kp if name != "beyond its limit" else 0.5)
    path = scene.simulate([start], [qd], dt=1e-3, steps=1000, pd=phipsi.PD(kp, kd, [0.0], effort=limit))
    fall = -max(weight - limit, 0.0) / 2.0
    np.testing.assert_allclose(path.qd[:, 0], fall * path.t, rtol=1e-9, atol=1e-10)


def linkage() -> phipsi.Scene:
    """Four bars, the crank of which has a motor."""
    builder = phipsi.SceneBuilder().link("ground")
    for name, parent, x, length in (("crank", "ground", 0.0, 0.2), ("coupler", "crank", 0.0, 0.4), ("rocker", "ground", 0.3, 0.3)):
        builder = builder.link(name, 1.0, (0, 0, length / 2), np.diag([length**2 / 12] * 2 + [1e-3]))
        at = (0, 0, 0.2) if name == "coupler" else (x, 0, 0)
        builder = builder.joint(name, "continuous", parent, name, xyz=at, axis=(0, 1, 0), effort=3.0 if name == "crank" else None)
    return builder.connect("pin", "axis", "coupler", "rocker", xyz=(0, 0, 0.4), other_xyz=(0, 0, 0.3), axis=(0, 1, 0)).build()


KINDS = ("tree", "mimic", "loop")


def kind(name: str) -> tuple[phipsi.Scene, np.ndarray, np.ndarray]:
    """A scene, a configuration, and a target that its connections allow."""
    if name == "tree":
        return arm(), np.full(4, 0.3), np.full(4, -0.6)
    if name == "mimic":
        builder = phipsi.SceneBuilder().link("base").link("a", mass=1.0, com=(0.2, 0, 0), inertia=0.02 * np.eye(3)).link("b", mass=0.5, com=(0.1, 0, 0), inertia=0.01 * np.eye(3))
        builder = builder.joint("lead", "revolute", "base", "a", axis=(0, 1, 0), effort=4.0)
        builder = builder.joint("follow", "revolute", "a", "b", xyz=(0.4, 0, 0), axis=(0, 1, 0), mimic="lead", mimic_multiplier=-2.0, mimic_offset=0.1)
        return builder.build(mimic="couple"), np.array([0.3]), np.array([1.0])
    scene = linkage()
    q = scene.loops.project(scene.neutral(), np.zeros(scene.nv)).q
    moved = scene.loops.project(q + np.r_[0.4, np.zeros(scene.nv - 1)], np.zeros(scene.nv)).q
    return scene, q, moved


def gains_of(name: str, scene: phipsi.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Gains, in a loop of its first joint alone, and limits."""
    on = np.ones(scene.nv)
    if name == "loop":
        on[1:] = 0.0
    return on, {"tree": np.array([10.0, 5.0, 3.0, 2.0]), "mimic": np.array([4.0]), "loop": np.full(scene.nv, 3.0)}[name]


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("kp", [50.0, 1e5])
def test_every_kind_of_scene_has_the_same_law(name: str, kp: float) -> None:
    """With small steps all kinds of scenes move alike, and stiff servos settle at their target."""
    scene, q, target = kind(name)
    on, limit = gains_of(name, scene)
    pd = phipsi.PD(kp * on, 0.1 * kp * on, target, effort=limit)
    coupled: Any = {"mimic": "couple"} if name == "mimic" else {}
    far = scene.to_builder().contact("far", scene.body_names[-1], friction=0.5, xyz=(0.05, 0, 0.1), offset=-90.0).build(**coupled)
    ends = []
    cases: Any = ((scene, "auto"), (far, "auto"), (far, "contact"))
    for one, method in cases:
        path = one.simulate(q, np.zeros(scene.nv), dt=1e-3, steps=800, pd=pd, limits="report", method=method)
        assert np.abs(path.torques()).max() < np.inf
        ends.append((path.q, path.qd))
    assert_same_bits(ends[0][0], ends[1][0])
    assert_same_bits(ends[0][1], ends[1][1])
    assert np.abs(ends[0][0] - ends[2][0]).max() < 0.05
    finer = far.simulate(q, np.zeros(scene.nv), dt=1e-4, steps=8000, record_every=10, pd=pd, limits="report", method="contact")
    assert np.abs(ends[0][0] - finer.q).max() < 0.01


def compared(scene: phipsi.Scene, q: np.ndarray, qd: np.ndarray, given: dict[str, Any], along: np.ndarray | None = None) -> phipsi.Trajectory:
    """Compare the gradients of a random function of the rows with central differences; `along`: the velocities that connections allow."""
    random = np.random.default_rng(2)
    path = scene.simulate(q, qd, **given)
    weights = random.normal(size=(2, len(path), scene.nv))
    found: Any = path.vjp(*weights)

    def value(q: np.ndarray = q, qd: np.ndarray = qd, **changed: Any) -> float:
        other = scene.simulate(q, qd, **{**given, **changed})
        return float(np.sum(weights[0] * scene.difference(path.q, other.q)) + np.sum(weights[1] * other.qd))

    step = 1e-5
    scale = size(found.q, found.qd, found.tau, found.target)

    def near(gradient: float, change: Any) -> None:
        slope = (8.0 * (change(step) - change(-step)) - (change(2 * step) - change(-2 * step))) / (12.0 * step)
        assert abs(gradient - slope) <= 1e-8 * scale, f"{gradient} against {slope}, {scale}"

    pd = given["pd"]
    for i, unit in enumerate(np.eye(scene.nv)):
        if along is None:
            near(found.q[i], lambda h: value(q=scene.integrate(q, h * unit)))  # noqa: B023
            near(found.qd[i], lambda h: value(qd=qd + h * unit))  # noqa: B023
        near(found.tau[i], lambda h: value(tau=given["tau"] + h * unit))  # noqa: B023
        if "targets" in given:
            for n in (0, 7):
                at = np.zeros_like(given["targets"])
                at[n, i] = 1.0
                near(found.target[n, i], lambda h: value(targets=given["targets"] + h * at))  # noqa: B023
        else:
            near(found.target[i], lambda h: value(pd=pd._replace(target=scene.integrate(pd.target, h * unit))))  # noqa: B023
        near(found.target_rate[i], lambda h: value(pd=pd._replace(target_rate=pd.target_rate + h * unit)))  # noqa: B023
    return path


@pytest.mark.parametrize("method", ["auto", "implicit-euler", "rosenbrock-3", "rk4"])
@pytest.mark.parametrize("name", ["tree", "mimic"])
@pytest.mark.parametrize("clip", [None, "clip"])
def test_gradients_go_through_limits_as_differences_do(name: str, method: Any, clip: Any) -> None:
    scene, q, target = kind(name)
    on, limit = gains_of(name, scene)
    pd = phipsi.PD(60.0 * on, 4.0 * on, target, 0.1 * on, effort=0.8 * limit)
    if name == "mimic":
        pd = pd._replace(kp=12.0 * on, kd=1.5 * on)
    given = {"dt": 2e-3, "steps": 120 if name == "mimic" else 60, "pd": pd, "tau": 0.3 * on, "method": method, "limits": "report", "effort": clip}
    path = compared(scene, q, -0.5 * on, given)
    torque = np.abs(path.torques() - (0.0 if clip else 0.3)) / (0.8 * limit)
    assert (torque > 1.0 - 1e-9).any() and (torque < 0.99).any()


@pytest.mark.parametrize("clip", [None, "clip"])
def test_gradients_of_targets_that_change(clip: Any) -> None:
    scene = arm()
    random = np.random.default_rng(8)
    targets = random.uniform(-1.0, 1.0, (40, 4)) * np.linspace(0.0, 1.0, 40)[:, None]
    pd = phipsi.PD(40.0, 3.0, None, np.full(4, 0.2), effort=True)
    given = {"dt": 2e-3, "steps": 40, "pd": pd, "tau": np.full(4, 0.2), "targets": targets, "record_every": 4, "effort": clip}
    compared(scene, np.full(4, 0.1), np.full(4, 0.2), given)


def test_gradients_of_servos_of_spherical_and_free_joints() -> None:
    builder = phipsi.SceneBuilder().link("a", 1.0, (0.1, 0.05, 0.2), np.diag([0.03, 0.04, 0.05]))
    builder = builder.link("b", 0.7, (0.0, 0.1, 0.1), np.diag([0.02, 0.01, 0.02])).joint("ball", "spherical", "a", "b", xyz=(0, 0, 0.4))
    scene = builder.build(floating_base=True)
    random = np.random.default_rng(4)
    q, target = (scene.integrate(scene.neutral(), random.uniform(-0.6, 0.6, 9)) for _ in range(2))
    pd = phipsi.PD(np.full(9, 30.0), np.full(9, 2.0), target, np.full(9, 0.1), effort=np.r_[np.full(6, 12.0), np.full(3, 4.0)])
    for method in ("auto", "implicit-euler"):
        compared(scene, q, random.uniform(-0.4, 0.4, 9), {"dt": 2e-3, "steps": 50, "pd": pd, "tau": np.zeros(9), "method": method})


@pytest.mark.parametrize("friction", [0.0, 0.2])
@pytest.mark.parametrize("clip", [None, "clip"])
def test_gradients_go_through_limits_in_loops(friction: float, clip: Any) -> None:
    scene, q, target = kind("loop")
    on, limit = gains_of("loop", scene)
    pd = phipsi.PD(10.0 * on, 1.0 * on, target, np.zeros(scene.nv), effort=0.6 * limit)
    given = {"dt": 2e-3, "steps": 100, "pd": pd, "tau": 0.1 * on, "limits": "report", "friction": friction, "effort": clip}
    path = compared(scene, q, np.zeros(scene.nv), given, along=on)
    assert friction == 0.0 or path.events > 0


@pytest.mark.parametrize("clip", [None, "clip"])
def test_gradients_go_through_limits_beside_contacts(clip: Any) -> None:
    q = np.array([0.2, 0.7, 0.1, 0.3])
    where: Any = {"friction": 0.6, "xyz": (0.1, 0, 0.2), "radius": 0.05}
    above = float(arm().to_builder().contact("floor", "link3", **where).build().contacts.gaps(q)[0])
    scene = arm().to_builder().contact("floor", "link3", **where, offset=above - 0.03).build()
    pd = phipsi.PD(60.0, 4.0, np.array([0.5, 1.6, 0.4, 0.8]), np.zeros(4), effort=True)
    path = compared(scene, q, np.zeros(4), {"dt": 2e-3, "steps": 120, "pd": pd, "tau": np.full(4, 0.1), "effort": clip, "limits": "report"})
    assert path.contacts is not None and (path.contacts.state["floor"] > 0).sum() > 10


def test_targets_of_each_step_are_those_of_a_loop_of_calls() -> None:
    scene, random = arm(), np.random.default_rng(6)
    targets, rates = random.uniform(-1, 1, (3, 50, 4)), random.uniform(-1, 1, (50, 4))
    q = random.uniform(-1, 1, (3, 4))
    path = scene.simulate(q, np.zeros(4), dt=1e-3, steps=50, pd=phipsi.PD(80.0, 5.0, effort=True), targets=targets, target_rates=rates)
    simulator = scene.simulator(q, dt=1e-3, pd=phipsi.PD(80.0, 5.0, q, effort=True))
    for n in range(50):
        simulator.step(target=targets[:, n], target_rate=rates[n])
    assert_same_bits(simulator.q, path.q[:, -1])
    # The last targets hold, also in copies and pickles.
    for other in (copy.deepcopy(simulator), pickle.loads(pickle.dumps(simulator))):
        other.step(steps=3)
        simulator_now = copy.copy(simulator)
        simulator_now.step(steps=3)
        assert_same_bits(other.q, simulator_now.q)
    file_names = ("targets", "target_rates", "pd")
    assert path.given is not None and all(name in path.given for name in file_names)


def test_a_saved_trajectory_keeps_limits_and_targets(tmp_path: Path) -> None:
    scene = arm()
    targets = np.linspace(0, 1, 20)[:, None] * np.ones(4)
    for effort in (True, 3.0, None):
        path = scene.simulate(np.zeros(4), np.zeros(4), dt=1e-3, steps=20, pd=phipsi.PD(80.0, 5.0, effort=effort), targets=targets, effort="clip")
        path.save(tmp_path / "path.npz")
        again = phipsi.Trajectory.load(tmp_path / "path.npz", scene)
        assert_same_bits(again.torques(), path.torques())
        first, second = (one.vjp(path.q).target for one in (again, path))
        assert first is not None and second is not None
        assert_same_bits(first, second)


def test_effort_is_listed_and_clipped() -> None:
    scene = cart(effort=10.0)
    loud = scene.simulate([0.0], [0.0], dt=1e-3, steps=10, tau=[50.0])
    assert [(one.limit, one.bound, one.worst, one.rows) for one in loud.violations()] == [("effort", 10.0, 50.0, 11)]
    assert np.isclose(loud.qd[-1, 0], 0.25)
    for more in ({"tau": [50.0]}, {"tau_steps": np.full((10, 1), 50.0)}, {"tau": lambda t, q, qd: [50.0]}, {"tau": [50.0], "pd": phipsi.PD(0.0, 1.0)}):
        clipped = scene.simulate([0.0], [0.0], dt=1e-3, steps=10, effort="clip", **more)
        assert np.isclose(clipped.qd[-1, 0], 0.05, rtol=1e-12) and clipped.violations() == []
        assert_near(clipped.torques(), np.full((11, 1), 10.0), product(1, 10.0))
    # The law alone has 10 N here, and the applied force 4 N more.
    both = scene.simulate([0.0], [0.0], dt=1e-3, steps=10, tau=[4.0], pd=phipsi.PD(1e3, 10.0, [1.0], effort=True))
    assert np.isclose(both.qd[-1, 0], 0.07) and both.violations()[0].worst == 14.0
    assert np.isclose(scene.simulate([0.0], [0.0], dt=1e-3, steps=10, tau=[4.0], pd=phipsi.PD(1e3, 10.0, [1.0]), effort="clip").qd[-1, 0], 0.05)


def test_what_is_refused_names_its_fix() -> None:
    scene, free = arm(), phipsi.SceneBuilder().link("box", 1.0, inertia=np.eye(3)).build(floating_base=True)
    how: Any = {"dt": 1e-3, "steps": 4}
    q, qd = np.zeros(4), np.zeros(4)

    def refused(text: str, scene: phipsi.Scene = scene, q: Any = q, qd: Any = qd, **given: Any) -> None:
        with pytest.raises(phipsi.errors.PhipsiError, match=text):
            scene.simulate(q, qd, **how, **given)

    refused("pd.target: found None", pd=phipsi.PD(1.0, 1.0))
    refused("targets without a control law", targets=np.zeros((4, 4)))
    refused("targets: found shape", pd=phipsi.PD(1.0, 1.0), targets=np.zeros((3, 4)))
    refused("pd.effort: found -1", pd=phipsi.PD(1.0, 1.0, q, effort=-1.0))
    refused("effort: found a scene without limits", phipsi.scenes.chain(4), effort="clip")
    refused('effort: found "clamp"', effort="clamp")
    touching = free.to_builder().contact("floor", "box", friction=0.5, offset=-1.0).build(floating_base=True)
    refused("free joint", touching, free.neutral(), np.zeros(6), pd=phipsi.PD(np.ones(6), np.ones(6), free.neutral(), effort=np.ones(6)))
    with pytest.raises(phipsi.errors.ArgumentError, match="targets without a control law"):
        scene.simulator(q, dt=1e-3).step(target=q)
    with pytest.raises(phipsi.errors.ArgumentError, match="pd.effort"):
        scene.ode(pd=phipsi.PD(1.0, 1.0, q, effort=1.0))


def test_one_gain_is_that_of_the_joints_with_a_motor() -> None:
    builder = phipsi.SceneBuilder().link("body", 2.0, inertia=0.1 * np.eye(3))
    builder = builder.link("leg", 0.5, (0, 0, -0.2), 0.01 * np.eye(3)).joint("hip", "revolute", "body", "leg", axis=(0, 1, 0), effort=3.0)
    scene = builder.build(floating_base=True)
    q = scene.neutral()
    own = np.r_[np.zeros(6), 1.0]
    how: Any = {"dt": 1e-3, "steps": 50, "limits": "report"}
    for one, each in ((phipsi.PD(50.0, 4.0, q), phipsi.PD(50.0 * own, 4.0 * own, q)), (phipsi.PD(0, 4.0), phipsi.PD(0 * own, 4.0 * own, q))):
        start = np.r_[np.zeros(6), 0.7]
        for effort in (None, 0.5, True):
            first, second = (scene.simulate(q, start, pd=law._replace(effort=effort), **how) for law in (one, each))
            assert_same_bits(first.q, second.q)
            assert_same_bits(first.torques(), second.torques())


def test_position_servos_of_mujoco_with_force_limits() -> None:
    """The bundled arm with position servos: the same motion, limits and rest."""
    mujoco = pytest.importorskip("mujoco")
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    spec = mujoco.MjSpec.from_string(phipsi.BUNDLED_ARM)
    spec.option.timestep, spec.option.integrator = 1e-4, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    spec.option.gravity = [0.0, 0.0, -9.81]
    kp, kd, limit = 900.0, 90.0, np.array([60.0, 90.0, 40.0, 6.0, 4.0, 2.0])
    for name, force in zip(scene.joint_names, limit, strict=True):
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=kp, kv=kd)
        servo.forcelimited, servo.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, [-force, force]
    model = spec.compile()
    model.dof_frictionloss[:], model.dof_armature[:], model.dof_damping[:] = 0.0, scene.armature, scene.damping
    data = mujoco.MjData(model)
    target = np.array([0.8, -0.9, 1.1, 0.4, -0.7, 0.5])
    data.ctrl[:] = target
    rows, most = [data.qpos.copy()], np.zeros(6)
    for n in range(20000):
        mujoco.mj_step(model, data)
        most = np.maximum(most, np.abs(data.qfrc_actuator))
        if n % 100 == 99:
            rows.append(data.qpos.copy())
    pd = phipsi.PD(kp, kd, target, effort=limit)
    path = scene.simulate(np.zeros(6), np.zeros(6), dt=1e-3, steps=2000, record_every=10, pd=pd, friction=0.0, limits="report")
    assert np.all(most == limit)
    assert_near(path.q, np.stack(rows), 5e-3)
    assert_near(path.q[-1], rows[-1], 2e-4)
    assert_near(path.qd[-1], np.zeros(6), 1e-3)


@pytest.mark.parametrize("method", ["implicit-euler", "rosenbrock-2", "rosenbrock-3"])
@pytest.mark.parametrize("effort", [None, 10.0])
def test_the_work_of_a_stiff_law_is_that_of_its_torque_within_the_step(method: Any, effort: float | None) -> None:
    path = cart().simulate([0.0], [0.5], dt=2e-3, steps=400, pd=phipsi.PD(1e4, 500.0, [1.0], effort=effort), method=method)
    audit = path.energy_audit()
    assert_near(audit.control, audit.change, product(400, float(np.abs(path.energy().kinetic).max())))


MOTOR: dict[str, Any] = {"effort": 8.0, "stall": 12.0, "no_load_speed": 3.0}


@pytest.mark.parametrize("method", ["auto", "implicit-euler", "semi-implicit-euler", "rosenbrock-3"])
def test_the_torque_of_a_motor_declines_with_its_speed(method: Any) -> None:
    """A cart of 2 kg that drives against a law far from its target: 8 N, then 12 N (1 - v/3), then the brake."""
    scene, goal = cart(), 4.0

    def rates(_: float, y: np.ndarray) -> list[float]:
        low, high = -np.clip(12.0 + 4.0 * y[1], 0.0, 8.0), np.clip(12.0 - 4.0 * y[1], 0.0, 8.0)
        return [y[1], min(max(200.0 * (goal - y[0]) - 40.0 * y[1], low), high) / 2.0]

    path = scene.simulate([0.0], [-4.0], dt=1e-3, steps=3000, pd=phipsi.PD(200.0, 40.0, [goal], **MOTOR), method=method)
    found = solve_ivp(rates, (0.0, 3.0), [0.0, -4.0], t_eval=path.t, rtol=1e-9, atol=1e-11, max_step=2e-3)
    assert np.abs(path.q[:, 0] - found.y[0]).max() < 5e-3 and 2.7 < path.qd.max() < 3.0
    assert_near(path.torques()[0, 0], 8.0, 1e-12)
    # Beyond its speed a motor can only brake.
    for goal, torque in ((100.0, 0.0), (-100.0, -8.0)):
        fast = scene.simulate([0.0], [5.0], dt=1e-3, steps=50, pd=phipsi.PD(200.0, 40.0, [goal], **MOTOR), method=method)
        assert_near(fast.qd[:, 0], 5.0 + torque / 2.0 * fast.t, 1e-12)


def test_motors_stay_stable_and_within_their_limits() -> None:
    random, scene = np.random.default_rng(12), arm()
    for _ in range(40):
        kp, dt = 10.0 ** random.uniform(2, 6), 10.0 ** random.uniform(-4, np.log10(4e-3))
        kd, stall, speed = kp * 10.0 ** random.uniform(-3, 0), 10.0 ** random.uniform(-1, 2), 10.0 ** random.uniform(-1, 1.5)
        pd = phipsi.PD(kp, kd, random.uniform(-1.5, 1.5, 4), effort=stall * random.uniform(0.5, 1.5), stall=stall, no_load_speed=speed)
        path = scene.simulate(random.uniform(-1.5, 1.5, 4), random.uniform(-3, 3, 4), dt=dt, steps=150, pd=pd)
        energy = path.energy()
        way = np.abs(np.diff(path.q, axis=0)).sum()
        assert (energy.total - energy.total[0]).max() <= 1.5 * stall * way + 0.05 * energy.kinetic.max() + 1e-9, (pd, dt)


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("clip", [None, "clip"])
def test_gradients_go_through_limits_that_decline(name: str, clip: Any) -> None:
    scene, q, target = kind(name)
    on, limit = gains_of(name, scene)
    kp, kd = {"tree": (60.0, 4.0), "mimic": (12.0, 1.5), "loop": (10.0, 1.0)}[name]
    speed = {"tree": 2.0, "mimic": 5.0, "loop": 3.0}[name]
    pd = phipsi.PD(kp * on, kd * on, target, 0.1 * on, effort=0.6 * limit, stall=0.65 * limit, no_load_speed=speed)
    given = {"dt": 2e-3, "steps": 60, "pd": pd, "tau": 0.1 * on, "limits": "report", "effort": clip}
    path = compared(scene, q, np.zeros(scene.nv), given, along=on if name == "loop" else None)
    plain = scene.simulate(q, np.zeros(scene.nv), **{**given, "pd": pd._replace(no_load_speed=None, stall=None)})
    assert np.abs(path.qd - plain.qd).max() > 1e-2


def test_motors_beside_contacts_in_lanes_and_in_files(tmp_path: Path) -> None:
    scene, target = arm(), np.array([0.5, 1.6, 0.4, 0.8])
    pd = phipsi.PD(60.0, 4.0, target, effort=True, stall=12.0, no_load_speed=np.array([2.0, 3.0, 1.0, 2.0]))
    path = scene.simulate(np.zeros(4), np.zeros(4), dt=1e-3, steps=300, pd=pd)
    far = scene.to_builder().contact("far", "link3", friction=0.5, offset=-90.0).build()
    assert_same_bits(far.simulate(np.zeros(4), np.zeros(4), dt=1e-3, steps=300, pd=pd).q, path.q)
    near = far.simulate(np.zeros(4), np.zeros(4), dt=1e-4, steps=3000, record_every=10, pd=pd, method="contact")
    assert np.abs(near.q - path.q).max() < 3e-3
    how: Any = {"dt": 1e-3, "steps": 300, "method": "rosenbrock-2"}
    speeds = np.stack([np.array([2.0, 3.0, 1.0, 2.0]), np.full(4, np.inf), np.full(4, 0.5)])
    many = scene.simulate(np.zeros((3, 4)), np.zeros(4), pd=pd._replace(no_load_speed=speeds), **how)
    assert_same_bits(many.q[0], scene.simulate(np.zeros(4), np.zeros(4), pd=pd, **how).q)
    plain = pd._replace(stall=None, no_load_speed=None, effort=np.minimum(scene.limits.effort, 12.0))
    assert_near(many.q[1], scene.simulate(np.zeros(4), np.zeros(4), pd=plain, **how).q, 1e-12)
    simulator = scene.simulator(np.zeros(4), np.zeros(4), dt=1e-3, pd=pd)
    simulator.step(steps=100)
    copied = pickle.loads(pickle.dumps(simulator))
    for one in (simulator, copied):
        one.step(steps=200)
        assert_near(one.q, path.q[-1], 1e-13)
    idle = scene.simulator(np.zeros(4), np.zeros(4), dt=1e-3, pd=pd._replace(stall=np.array([12.0, 0.0, 12.0, 12.0])))
    again = pickle.loads(pickle.dumps(idle))
    for one in (idle, again):
        one.step(steps=50)
    assert_near(again.q, idle.q, 1e-13)
    path.save(tmp_path / "path.npz")
    assert_same_bits(phipsi.Trajectory.load(tmp_path / "path.npz", scene).torques(), path.torques())


def test_motors_that_do_not_exist_are_refused() -> None:
    scene = cart()
    scene.simulate([0.0], [0.0], dt=1e-3, steps=1, pd=phipsi.PD(1.0, 1.0, [1.0], **MOTOR))
    for change, message in (
        ({"effort": None, "stall": None}, "pd.stall: found None without pd.effort"),
        ({"no_load_speed": None}, "pd.no_load_speed: found None"),
        ({"no_load_speed": 0.0}, "pd.no_load_speed: found 0; expected speeds that are positive"),
        ({"stall": -1.0}, "pd.stall: found -1; expected limits that are zero or positive"),
    ):
        with pytest.raises(phipsi.errors.ArgumentError, match=message):
            scene.simulate([0.0], [0.0], dt=1e-3, steps=1, pd=phipsi.PD(1.0, 1.0, [1.0], **(MOTOR | change)))
