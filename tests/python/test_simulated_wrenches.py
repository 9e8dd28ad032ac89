"""Wrenches on links in simulations: closed forms, Newton and Euler's equations by SciPy, forward dynamics with the same
wrenches, MuJoCo, static equilibrium, gradients beside differences, the energy balance, and errors.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import contact_robots
import motion_scenes
import numpy as np
import phipsi
import pytest
import test_loop_gradients as loops
from capabilities import build
from phipsi.errors import ArgumentError, NotFiniteError, ShapeError
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from tolerances import CONTACT_GRADIENT, EVENT_STEP, assert_near, assert_same_bits, recursion, size, slope_of_order_4

FRAMES = ("link", "world")
METHODS = ("semi-implicit-euler", "rk4", "dormand-prince-5", "implicit-euler", "rosenbrock-2", "rosenbrock-3")
INERTIA = np.array([[0.2, 0.01, -0.02], [0.01, 0.3, 0.03], [-0.02, 0.03, 0.25]])
CENTER = np.array([0.1, -0.05, 0.07])


def body(center: Any = (0.0, 0.0, 0.0), inertia: Any = INERTIA, gravity: tuple[float, ...] = (0.0, 0.0, 0.0)) -> phipsi.Scene:
    """A free body of 2 kg; "tool" is welded to it."""
    builder = phipsi.SceneBuilder().link("body", 2.0, center, inertia).link("tool")
    return builder.joint("weld", "fixed", "body", "tool", xyz=(0.3, 0.1, -0.2), rpy=(0.4, -0.3, 0.9)).build(floating_base=True, gravity=gravity)


def wrench_of(scene: phipsi.Scene, q: np.ndarray, link: str, wrench: Any, frame: str) -> np.ndarray:
    """The wrench in the axes of the link, by its pose."""
    turn = scene.placement(q, link)[:3, :3]
    return np.asarray(wrench) if frame == "link" else np.concatenate([turn.T @ part for part in np.split(np.asarray(wrench), 2)])


def torque_of(scene: phipsi.Scene, q: np.ndarray, wrenches: dict[str, Any], frame: str) -> np.ndarray:
    """J^T F."""
    axes = {"link": "local", "world": "local-world-aligned"}[frame]
    return np.asarray(sum(scene.jacobian(q, link, frame=axes).T @ wrench for link, wrench in wrenches.items()))


# Motion


@pytest.mark.parametrize("method", METHODS)
def test_a_constant_force_accelerates_a_free_body(method: str) -> None:
    scene, force = body(inertia=np.diag([0.2, 0.3, 0.25])), np.array([3.0, -1.0, 2.0])
    path = scene.simulate(scene.neutral(), np.zeros(6), dt=1e-2, steps=100, method=method, wrenches={"body": [0.0, 0.0, 0.5, *force]}, frame="world")
    turn = path.scene.placement(path.q[-1], "body")
    # The axis of the torque is a principal axis: w = n t / I.
    assert_near(path.qd[-1, 3:], [0.0, 0.0, 0.5 / 0.25], recursion(100, 2.0))
    error = {"semi-implicit-euler": 1e-2, "implicit-euler": 1e-2, "rosenbrock-2": 1e-4}.get(method, 5e-6)
    assert_near(turn[:3, :3] @ path.qd[-1, :3], force / 2.0, error * size(force))
    assert_near(turn[:3, 3], force / 4.0, error * size(force))


@pytest.mark.parametrize("frame", FRAMES)
def test_a_free_body_obeys_newton_and_euler(frame: str) -> None:
    scene, wrench = body(CENTER), np.array([0.3, -0.4, 0.2, 1.0, 2.0, -1.5])
    moment, force = np.split(wrench, 2)

    def rates(_: float, x: np.ndarray) -> np.ndarray:
        # x = (center of mass, its velocity, rotation vector's quaternion, angular velocity in the body)
        turn, w = Rotation.from_quat(x[6:10]), x[10:]
        f, n = (force, moment) if frame == "link" else (turn.inv().apply(force), turn.inv().apply(moment))
        about = n - np.cross(CENTER, f)
        x4 = np.concatenate([x[9] * w + np.cross(x[6:9], w), [-x[6:9] @ w]]) / 2
        return np.concatenate([x[3:6], turn.apply(f) / 2.0, x4, np.linalg.solve(INERTIA, about - np.cross(w, INERTIA @ w))])

    w = np.array([0.5, -1.0, 0.7])
    start = np.concatenate([CENTER, np.cross(w, CENTER), [0, 0, 0, 1], w])
    end = solve_ivp(rates, (0.0, 1.0), start, "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    path = scene.simulate(scene.neutral(), [0, 0, 0, *w], dt=5e-3, steps=200, method="dormand-prince-5", wrenches={"body": wrench}, frame=frame)
    place = scene.placement(path.q[-1], "body")
    assert_near(path.qd[-1, 3:], end[10:], 1e-9)
    assert_near(place[:3, :3], Rotation.from_quat(end[6:10]).as_matrix(), 1e-9)
    assert_near(place[:3, :3] @ CENTER + place[:3, 3], end[:3], 1e-9)


@pytest.mark.parametrize("frame", FRAMES)
def test_stages_have_the_accelerations_of_forward_dynamics(frame: str) -> None:
    scene = motion_scenes.robot(2, joints=4, friction=0.0, damping=0.0)
    q, v = motion_scenes.start(scene, 2)
    given = {"link3": np.array([0.3, -0.2, 0.4, 2.0, -1.0, 3.0]), "link1": np.array([-0.5, 0.2, 0.1, 1.0, 2.0, -2.0])}
    path = scene.simulate(q, v, dt=0.02, steps=5, method="rk4", limits="report", wrenches=given, frame=frame)
    h = 0.02
    for row in range(5):
        assert_near(path.q[row], q, recursion(20, size(q)))
        a = lambda q, v: scene.forward_dynamics(q, v, np.zeros(4), wrenches={k: wrench_of(scene, q, k, w, frame) for k, w in given.items()})  # noqa: E731
        k1 = a(q, v)
        k2 = a(q + h / 2 * v, v2 := v + h / 2 * k1)
        k3 = a(q + h / 2 * v2, v3 := v + h / 2 * k2)
        k4 = a(q + h * v3, v4 := v + h * k3)
        q, v = q + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    assert_near(path.qd[-1], v, recursion(100, size(v)))


def test_the_motion_is_mujocos() -> None:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string("""<mujoco><option timestep="0.002" integrator="RK4"><flag contact="disable"/></option><worldbody>
    <body pos="0 0.1 1"><joint name="a" axis="0 1 0.2"/><inertial pos="0.1 0 0.2" mass="1" diaginertia="0.02 0.03 0.01"/>
    <body name="arm" pos="0.1 0 0.4"><joint name="b" axis="1 0 0.3" pos="0.02 0 0"/><inertial pos="0 0.05 0.1" mass="0.8" diaginertia="0.02 0.01 0.01"/>
    <body name="tip" pos="0 0 0.3" euler="20 10 30"><joint name="c" type="ball"/><inertial pos="0 0 0" mass="0.5" diaginertia="0.01 0.012 0.008"/></body>
    </body></body></worldbody></mujoco>""")
    data, scene = mujoco.MjData(model), phipsi.Scene.from_mujoco(model)
    data.qvel[:] = [0.3, -0.5, 0.2, 0.4, -0.3]
    # MuJoCo's wrenches are (force, moment) at the center of mass, which is the origin of the tip, in the axes of the world.
    force, moment = np.array([2.0, -1.0, 3.0]), np.array([0.05, 0.1, -0.04])
    data.xfrc_applied[model.body("tip").id] = [*force, *moment]
    start = phipsi.mujoco.to_state(scene, data.qpos, data.qvel)
    path = scene.simulate(*start, dt=0.002, steps=100, method="rk4", wrenches={"tip": [*moment, *force]}, frame="world")
    for _ in range(100):
        mujoco.mj_step(model, data)
    q, qd = phipsi.mujoco.to_state(scene, data.qpos, data.qvel)
    # MuJoCo integrates a quaternion to another order in the stages: the error of both is that of a step.
    assert_near(scene.difference(q, path.q[-1]), np.zeros(5), 1e-8)
    assert_near(path.qd[-1], qd, 1e-7)
    without = scene.simulate(*start, dt=0.002, steps=100, method="rk4")
    assert np.max(np.abs(without.qd[-1] - qd)) > 1.0


@pytest.mark.parametrize("kind", ["tree", "mimic", "loop"])
@pytest.mark.parametrize("frame", FRAMES)
def test_a_balanced_mechanism_stays_at_rest(kind: str, frame: str) -> None:
    scene, q = static(kind)
    wrenches = {scene.link_names[-1]: np.array([0.4, -0.3, 0.5, 2.0, -1.0, 3.0]), scene.link_names[-2]: np.array([0.1, 0.2, -0.1, 1.0, 0.5, -2.0])}
    balance = scene.inverse_dynamics(q, np.zeros(scene.nv), np.zeros(scene.nv)) - torque_of(scene, q, wrenches, frame)
    for method in METHODS:
        path = scene.simulate(q, np.zeros(scene.nv), dt=1e-3, steps=5, method=method, tau=balance, wrenches=wrenches, frame=frame)
        assert_near(path.qd[-1], np.zeros(scene.nv), 1e-11)
    moving = scene.simulate(q, np.zeros(scene.nv), dt=1e-3, steps=5, tau=balance)
    assert np.max(np.abs(moving.qd)) > 1e-3


def static(kind: str) -> tuple[phipsi.Scene, np.ndarray]:
    scene = build(kind, False)
    if kind == "loop":
        return scene, scene.loops.project(np.array([0.5, 0.8, -0.3, 0.2]), np.zeros(4)).q
    return scene, np.array([0.5, 0.8, -0.3, 0.2])[: scene.nq]


@pytest.mark.parametrize("push", [4.5, 5.5])
def test_a_box_slides_beyond_its_friction_cone(push: float) -> None:
    mass, mu = 1.0, 0.5
    builder = phipsi.SceneBuilder().link("box", mass, (0, 0, 0), np.diag([0.01] * 3))
    for i, (x, y) in enumerate([(0.1, 0.1), (0.1, -0.1), (-0.1, 0.1), (-0.1, -0.1)]):
        builder.contact(f"corner{i}", "box", xyz=(x, y, -0.05), friction=mu)
    scene = builder.build(floating_base=True, gravity=(0, 0, -10.0))
    # The force acts at the height of the ground.
    wrench = [0.0, -0.05 * push, 0.0, push, 0.0, 0.0]
    path = scene.simulate([0, 0, 0.05, 0, 0, 0, 1], np.zeros(6), dt=1e-3, steps=100, wrenches={"box": wrench}, frame="world")
    assert_near(path.qd[-1, 0], max(0.0, push - mu * mass * 10.0) / mass * 0.1, 1e-6)
    audit = path.energy_audit()
    assert_near(audit.torque, push * path.q[-1, 0], 1e-4 * size(push))
    assert audit.relative_error <= 1e-2
    accurate = scene.simulate(path.q[0], np.zeros(6), dt=1e-2, steps=10, accuracy=1e-6, wrenches={"box": wrench}, frame="world")
    assert_near(accurate.qd[-1, 0], path.qd[-1, 0], 1e-5)
    back = scene.simulator(path.q[0], dt=1e-3)
    back.step(steps=100, wrenches={"box": wrench}, frame="world")
    assert_same_bits(back.qd, path.qd[-1])


# Shapes


def test_each_state_and_step_has_its_wrench() -> None:
    scene, random = motion_scenes.robot(3, floating_base=True), np.random.default_rng(4)
    states, steps = 11, 4
    q = np.stack([motion_scenes.start(scene, seed)[0] for seed in range(states)])
    qd = random.uniform(-1, 1, (states, scene.nv))
    given = {"base": random.normal(size=6), "link0": random.normal(size=(states, 1, 6)), "link1": random.normal(size=(steps, 6)), "link2": random.normal(size=(states, steps, 6))}
    run = lambda at, wrenches: scene.simulate(q[at], qd[at], dt=1e-2, steps=steps, wrenches=wrenches, frame="world")  # noqa: E731
    path = run(slice(None), given)
    by_qd = random.normal(size=path.qd.shape)
    found = path.vjp(None, by_qd)
    assert found.wrenches is not None
    shapes = {link: array.shape for link, array in found.wrenches.items()}
    assert shapes == {"base": (states, 6), "link0": (states, 1, 6), "link1": (states, steps, 6), "link2": (states, steps, 6)}
    for state in range(states):
        own = {"base": given["base"], "link0": given["link0"][state], "link1": given["link1"], "link2": given["link2"][state]}
        one = run(state, own)
        assert_same_bits(one.qd, path.qd[state])
        each = {link: np.broadcast_to(wrench, (steps, 6)) for link, wrench in own.items()}
        assert_same_bits(run(state, each).qd, one.qd)
        alone = one.vjp(None, by_qd[state]).wrenches
        assert alone is not None
        for link, array in alone.items():
            assert_near(array, found.wrenches[link][state], 1e-12 * size(array))
    whole = run(0, {link: np.broadcast_to(wrench[0] if np.ndim(wrench) == 3 else wrench, (steps, 6)) for link, wrench in given.items()})
    sums = whole.vjp(None, by_qd[0]).wrenches
    assert sums is not None
    assert_near(sums["base"].sum(axis=0), found.wrenches["base"][0], 1e-12 * size(sums["base"]))


def test_steps_of_a_simulator_are_those_of_simulate() -> None:
    scene, random = motion_scenes.robot(3), np.random.default_rng(4)
    q, qd = motion_scenes.start(scene, 1)
    wrenches = random.normal(size=(5, 6))
    wrenches[3] = 0.0
    path = scene.simulate(q, qd, dt=1e-2, steps=5, wrenches={"link2": wrenches})
    simulator = scene.simulator(np.stack([q] * 3), np.stack([qd] * 3), dt=1e-2)
    for step in range(5):
        # Wrenches act in one call.
        simulator.step(wrenches=None if step == 3 else {"link2": [wrenches[step]] * 3})
    assert_near(simulator.qd, [path.qd[-1]] * 3, recursion(5, size(path.qd)))
    before = simulator.qd
    with pytest.raises(ArgumentError, match="link9"):
        simulator.step(wrenches={"link9": np.zeros(6)})
    with pytest.raises(ShapeError, match=r"wrenches\['link2'\]|wrenches\[\"link2\"\]"):
        simulator.step(wrenches={"link2": np.zeros((2, 6))})
    assert_same_bits(simulator.qd, before)


def test_they_act_beside_actuators() -> None:
    builder = phipsi.SceneBuilder().link("base").link("block", 2.0).joint("slide", "prismatic", "base", "block", axis=(1, 0, 0))
    scene = builder.actuator("motor", "slide").build()
    given: dict[str, Any] = {"wrenches": {"block": [0, 0, 0, 3.0, 0, 0]}}
    path = scene.simulate([0.0], [0.0], dt=1e-2, steps=10, control=[1.0], **given)
    assert_near(path.qd[-1], [0.1 * (1.0 + 3.0) / 2.0], recursion(10, 1.0))
    simulator = scene.simulator([0.0], dt=1e-2, control=[1.0])
    simulator.step(steps=10, **given)
    assert_same_bits(simulator.qd, path.qd[-1])
    simulator.step(steps=10)
    assert_near(simulator.qd, [0.2 + 0.1 * 1.0 / 2.0], recursion(20, 1.0))


def test_a_contact_out_of_reach_changes_nothing() -> None:
    near, far = build("tree", False), build("tree", True)
    q, qd = static("tree")[1], np.array([0.3, -0.2, 0.4, 0.1])
    given: dict[str, Any] = {"dt": 1e-2, "steps": 5, "wrenches": {"pendulum": np.arange(6.0)}, "frame": "world"}
    one, other = (scene.simulate(q, qd, **given) for scene in (near, far))
    assert_same_bits(one.qd, other.qd)
    by_one, by_other = (path.vjp(one.q).wrenches for path in (one, other))
    assert by_one is not None
    assert by_other is not None
    assert_near(by_other["pendulum"], by_one["pendulum"], 1e-12 * size(by_one["pendulum"]))


def test_a_link_that_is_welded_to_a_body_or_to_the_base() -> None:
    scene = body(CENTER)
    wrench = np.array([0.3, -0.4, 0.2, 1.0, 2.0, -1.5])
    for frame in FRAMES:
        run = lambda **given: scene.simulate(scene.neutral(), [0, 0, 0, 0.5, -1.0, 0.7], dt=1e-2, steps=20, method="rk4", frame=frame, **given)  # noqa: B023, E731
        of_tool = run(wrenches={"tool": wrench})
        steps = np.zeros((20, 6))
        # The same force on the body, for the first step.
        place = scene.placement(np.asarray(scene.neutral()), "tool")
        n, f = np.split(wrench, 2) if frame == "world" else (place[:3, :3] @ wrench[:3], place[:3, :3] @ wrench[3:])
        steps[0] = [*(n + np.cross(place[:3, 3], f)), *f]
        if frame == "link":
            assert_near(run(wrenches={"body": steps[0]}).qd, of_tool.qd, 1e-12)
        else:
            assert_near(run(wrenches={"body": steps}).qd[1], of_tool.qd[1], 1e-2)
    fixed = motion_scenes.pendulum()
    pushed = fixed.simulate([0.3], [0.0], dt=1e-2, steps=10, wrenches={"base": wrench})
    assert_same_bits(pushed.q, fixed.simulate([0.3], [0.0], dt=1e-2, steps=10).q)
    by_base = pushed.vjp(np.ones((11, 1))).wrenches
    assert by_base is not None
    assert not by_base["base"].any()


# Gradients


def by_differences(scene: phipsi.Scene, q: np.ndarray, qd: np.ndarray, given: dict[str, Any], bound: float, step: float = 1e-3, at: Callable[[float], Any] | None = None) -> phipsi.Trajectory:
    """Compares the gradients of a function of all rows by wrenches and the start with differences; `at`: a curve of starts."""
    random = np.random.default_rng(5)
    path = scene.simulate(q, qd, **given)
    by_q, by_qd = random.uniform(-1, 1, (2, *path.qd.shape))
    found = path.vjp(by_q, by_qd)
    assert found.wrenches is not None

    def value(q: np.ndarray = q, qd: np.ndarray = qd, **changed: Any) -> float:
        other = scene.simulate(q, qd, **{**given, **changed})
        return float(np.sum(by_q * scene.difference(path.q, other.q)) + np.sum(by_qd * other.qd))

    scale = size(*(np.linalg.norm(array) for array in (*found.wrenches.values(), found.q, found.qd)))
    for link, wrench in given["wrenches"].items():
        assert np.max(np.abs(found.wrenches[link])) > 1e-6
        along = random.uniform(-1, 1, np.shape(wrench))
        of = lambda h: value(wrenches={**given["wrenches"], link: np.asarray(wrench) + h * along})  # noqa: B023, E731
        assert_near(np.sum(found.wrenches[link] * along), slope_of_order_4(of, step), bound * scale)
    if at is not None:
        d = slope_of_order_4(lambda h: scene.difference(q, at(h)[0]), 1e-4)
        e = slope_of_order_4(lambda h: at(h)[1], 1e-4)
        assert_near(found.q @ d + found.qd @ e, slope_of_order_4(lambda h: value(*at(h)), min(step, 1e-4)), bound * scale)
        return path
    for _ in range(2):
        d, e = random.uniform(-1, 1, (2, scene.nv))
        assert_near(found.q @ d, slope_of_order_4(lambda h: value(scene.integrate(q, h * d)), step), bound * scale)  # noqa: B023
        assert_near(found.qd @ e, slope_of_order_4(lambda h: value(qd=qd + h * e), step), bound * scale)  # noqa: B023
    return path


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("method", METHODS)
def test_gradients_of_a_floating_tree(mixed_tree: phipsi.Scene, method: str, frame: str) -> None:
    scene, random = mixed_tree, np.random.default_rng(6)
    q = scene.integrate(scene.neutral(), random.uniform(-0.5, 0.5, scene.nv))
    qd = random.uniform(-0.5, 0.5, scene.nv)
    links = scene.link_names
    wrenches = {links[0]: random.normal(size=6), links[-1]: random.normal(size=(6, 6)), links[3]: random.normal(size=6)}
    by_differences(scene, q, qd, {"dt": 0.02, "steps": 6, "record_every": 2, "method": method, "frame": frame, "wrenches": wrenches, "limits": "report"}, 1e-9)


@pytest.fixture(scope="module")
def mixed_tree() -> phipsi.Scene:
    """A floating base and two branches with joints of all kinds, and a link on a fixed joint at the tip."""
    random = np.random.default_rng(7)
    builder = phipsi.SceneBuilder().link("base", 2.0, CENTER, INERTIA)
    for k, kind in enumerate(("spherical", "revolute", "prismatic", "screw", "planar", "universal", "revolute")):
        parent = "base" if k < 2 else f"link{k - 2}"
        axis: dict[str, Any] = {} if kind in ("spherical", "universal") else {"axis": random.normal(size=3)}
        axis |= {"pitch": 0.2} if kind == "screw" else {}
        axis |= {"lower": -9.0, "upper": 9.0} if kind in ("revolute", "prismatic") else {}
        builder.link(f"link{k}", 1.0, random.uniform(-0.1, 0.1, 3), np.diag([0.02, 0.03, 0.025]))
        builder.joint(f"joint{k}", kind, parent, f"link{k}", xyz=random.uniform(-0.3, 0.3, 3), rpy=random.uniform(-1, 1, 3), damping=0.1, **axis)
    builder.link("tip").joint("weld", "fixed", "link6", "tip", xyz=(0.1, 0.2, -0.1), rpy=(0.3, 0.5, -0.8))
    return builder.build(floating_base=True)


@pytest.mark.parametrize("frame", FRAMES)
def test_gradients_with_mimic_joints_and_pd(frame: str) -> None:
    scene, q = static("mimic")
    link = scene.link_names[-1]
    given = {"dt": 0.01, "steps": 5, "frame": frame, "wrenches": {link: np.array([0.4, -0.3, 0.5, 2.0, -1.0, 3.0])}, "pd": phipsi.PD(50.0, 2.0, q + 0.1)}
    by_differences(scene, q, np.linspace(0.3, -0.2, scene.nv), given, 1e-9)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize(("name", "method"), [("four-bar", "rosenbrock-2"), ("floating", "rk4")])
def test_gradients_of_a_loop(name: str, method: str, frame: str) -> None:
    scene = loops.SCENES[name]()
    q, qd = loops.start(scene)
    random = np.random.default_rng(8)
    wrenches = {scene.link_names[-1]: random.normal(size=6), scene.link_names[1]: random.normal(size=(4, 6))}
    given = {"dt": 0.01, "steps": 4, "method": method, "frame": frame, "wrenches": wrenches}
    by_differences(scene, q, qd, given, 1e-8, at=loops.moved(scene, q, qd, 1))


@pytest.mark.parametrize("frame", FRAMES)
def test_gradients_of_a_sliding_box(frame: str) -> None:
    scene = contact_robots.block(0.3).build()
    bottom = contact_robots.EDGES[2] / 2
    q, qd = np.array([0, 0, bottom, 0, 0, 0, 1.0]), np.array([1.0, 0.5, 0, 0, 0, 0.2])
    given = {"dt": 2e-3, "steps": 10, "frame": frame, "wrenches": {"block": np.array([0.02, -0.03, 0.1, 2.0, 1.0, -3.0])}}
    path = scene.simulate(q, qd, **given)
    assert path.contacts is not None
    assert any(np.any(state == phipsi.ContactState.SLIDING) for state in path.contacts.state.values())
    random = np.random.default_rng(5)
    by_q, by_qd = random.uniform(-1, 1, (2, *path.qd.shape))
    found = path.vjp(by_q, by_qd).wrenches
    assert found is not None

    def value(wrench: np.ndarray) -> float:
        other = scene.simulate(q, qd, **{**given, "wrenches": {"block": wrench}})
        return float(np.sum(by_q * scene.difference(path.q, other.q)) + np.sum(by_qd * other.qd))

    each = [slope_of_order_4(lambda h, e=e: value(given["wrenches"]["block"] + h * e), 1e-4) for e in np.eye(6)]
    assert_near(found["block"], each, CONTACT_GRADIENT * size(each))
    assert np.max(np.abs(found["block"])) > 1e-4


def test_gradients_through_stops_and_friction() -> None:
    """Compared with differences of simulations with error control, as in test_event_gradients."""
    scene = motion_scenes.robot(7, range_of_motion=0.4, friction=0.3)
    q, qd = motion_scenes.start(scene, 7, away=0.1)
    wrench = np.array([0.0, 0.1, 0.0, 20.0, -10.0, 3.0])
    run = lambda wrench, **given: scene.simulate(q, qd, frame="world", wrenches={"link2": wrench}, **given)  # noqa: E731
    path = run(wrench, dt=1e-3, steps=150)
    assert path.stops and path.events > 2
    assert_near(path.energy_audit().relative_error, 0.0, 1e-2)
    by_qd = np.zeros_like(path.qd)
    by_qd[-1] = [1.0, -0.5, 0.7]
    found = path.vjp(None, by_qd).wrenches
    assert found is not None
    value = lambda wrench: float(by_qd[-1] @ run(wrench, dt=0.15, steps=1, accuracy=1e-10).qd[-1])  # noqa: E731
    each = [(value(wrench + EVENT_STEP * e) - value(wrench - EVENT_STEP * e)) / (2 * EVENT_STEP) for e in np.eye(6)]
    assert_near(found["link2"], each, 1e-2 * size(each))


# Energy, error control, covariance, files


@pytest.mark.parametrize("frame", FRAMES)
def test_the_energy_balance_contains_the_work_of_wrenches(frame: str) -> None:
    scene = motion_scenes.robot(2, joints=4, friction=0.0, damping=0.0, floating_base=True)
    q, qd = motion_scenes.start(scene, 2)
    run = lambda **given: scene.simulate(q, qd, limits="report", wrenches={"link3": [0.3, -0.2, 0.4, 4.0, -3.0, 9.0]}, frame=frame, **given)  # noqa: E731
    audit = run(dt=1e-3, steps=400, method="rk4").energy_audit()
    assert abs(audit.torque) > 0.1
    assert abs(audit.remainder) <= 1e-8 * abs(audit.torque)
    accurate = run(dt=1e-2, steps=40, accuracy=1e-9)
    assert_near(accurate.energy_audit().torque, audit.torque, 1e-7 * abs(audit.torque))
    assert abs(accurate.energy_audit().remainder) <= 1e-7 * abs(audit.torque)
    assert_near(accurate.qd[-1], run(dt=1e-3, steps=400, method="rk4").qd[-1], 1e-6)


def test_error_estimate_covariance_and_files(tmp_path: Path) -> None:
    scene = motion_scenes.robot(2, friction=0.0)
    q, qd = motion_scenes.start(scene, 2)
    wrenches = {"link2": np.linspace(-3, 3, 60).reshape(10, 6), "link1": np.array([0.2, 0.1, 0.3, 1.0, -1.0, 2.0])}
    run = lambda **given: scene.simulate(q, qd, **({"dt": 5e-3, "steps": 10, "frame": "world", "limits": "report", "wrenches": wrenches} | given))  # noqa: E731
    path = run()
    assert 0.0 < path.error_estimate().max() < 1e-6
    path.save(tmp_path / "path.npz")
    loaded = phipsi.Trajectory.load(tmp_path / "path.npz", scene)
    by_qd = np.ones_like(path.qd)
    one, other = path.vjp(None, by_qd).wrenches, loaded.vjp(None, by_qd).wrenches
    assert one is not None
    assert other is not None
    for link in wrenches:
        assert_same_bits(one[link], other[link])
    # The covariance of the start, by the derivatives of the end, which depend on the wrenches.
    initial = np.full(6, 1e-6)
    bands = run(covariance=phipsi.estimation.MotionUncertainty(initial=initial), record_every=2).bands
    assert bands is not None
    flow = np.empty((6, 6))
    for i, e in enumerate(np.eye(6)):
        end = lambda h: scene.simulate(scene.integrate(q, h * e[:3]), qd + h * e[3:], dt=5e-3, steps=10, frame="world", limits="report", wrenches=wrenches)  # noqa: B023, E731
        flow[:, i] = slope_of_order_4(lambda h: np.concatenate([scene.difference(path.q[-1], end(h).q[-1]), end(h).qd[-1]]), 1e-3)  # noqa: B023
    assert_near(bands.covariance[-1], flow * initial @ flow.T, 1e-8 * size(flow) * 1e-6)


def test_constraint_forces_are_those_with_the_wrenches() -> None:
    scene, q = static("loop")
    wrench = np.array([0.4, -0.3, 0.5, 2.0, -1.0, 3.0])
    link = scene.link_names[-1]
    path = scene.simulate(q, np.zeros(scene.nv), dt=1e-3, steps=2, wrenches={link: wrench}, frame="world")
    expected = scene.loops.dynamics(q, np.zeros(scene.nv), np.zeros(scene.nv), wrenches={link: wrench_of(scene, q, link, wrench, "world")}).forces
    for name, force in path.constraint_forces().items():
        assert_near(force[0], expected[name], 1e-10 * size(force))
        assert np.max(np.abs(force[0])) > 0.1


# Errors


@pytest.mark.parametrize(
    ("changed", "error", "text"),
    [
        ({"wrenches": {"hand": np.zeros(6)}}, ArgumentError, "hand"),
        ({"wrenches": {"rod": np.zeros(5)}}, ShapeError, "rod"),
        ({"wrenches": {"rod": np.zeros((4, 6))}}, ShapeError, r"\(6,\), \(\.\.\., 3, 6\), or \(\.\.\., 1, 6\)"),
        ({"wrenches": {"rod": [np.nan, 0, 0, 0, 0, 0]}}, NotFiniteError, "rod"),
        ({"wrenches": np.zeros(6)}, ArgumentError, "wrenches"),
        ({"frame": "base"}, ArgumentError, "frame.*link.*world"),
    ],
)
def test_errors_name_the_argument(changed: dict[str, Any], error: type[Exception], text: str) -> None:
    scene = motion_scenes.pendulum()
    given: dict[str, Any] = {"dt": 1e-3, "steps": 3, "wrenches": {"rod": np.ones(6)}, "frame": "world"}
    path = scene.simulate([0.1], [0.0], **given)
    with pytest.raises(error, match=text):
        scene.simulate([0.1], [0.0], **{**given, **changed})
    with pytest.raises(error, match=text):
        scene.simulate_vjp(path.q, path.qd, path.qd, path.qd, **{**given, **changed})


def test_calls_without_wrenches_refuse_them() -> None:
    scene = motion_scenes.pendulum()
    with pytest.raises(TypeError, match="wrenches"):
        scene.simulator([0.1], dt=1e-3, wrenches={"rod": np.ones(6)})  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="wrenches"):
        scene.ode(wrenches={"rod": np.ones(6)})  # type: ignore[call-arg]
    assert scene.simulate([0.1], [0.0], dt=1e-3, steps=3).vjp(np.ones((4, 1))).wrenches is None
    assert_same_bits(scene.simulate([0.1], [0.0], dt=1e-3, steps=3, wrenches={}).q, scene.simulate([0.1], [0.0], dt=1e-3, steps=3).q)
