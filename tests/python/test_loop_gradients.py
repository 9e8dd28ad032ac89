"""Gradients of simulated closed loops, compared with differences of the simulation along states that satisfy the
connections.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import phipsi
import pytest
import test_loops_lagrange as lagrange
from conftest import random_rotation
from oracle_mpmath import CONTEXT, mpf
from tolerances import assert_near, size, slope_of_order_4

METHODS = ("semi-implicit-euler", "rk4", "dormand-prince-5", "implicit-euler", "rosenbrock-2", "rosenbrock-3")


def add(builder: phipsi.SceneBuilder, name: str, parent: str, at: tuple[float, float, float], length: float, mass: float = 1.0, **joint: object) -> None:
    builder.link(name, mass=mass, com=(0.02, 0.01, length / 2), inertia=np.diag([length**2 / 12] * 2 + [1e-3]))
    joint = {"type": "continuous", "xyz": at, "axis": (0, 1, 0), "armature": 1e-3, **joint}
    builder.joint(f"{name}_joint", parent=parent, child=name, **joint)  # type: ignore[arg-type]


def four_bar(kind: str = "axis", again: bool = False, mass: float = 1.0, limited: bool = False) -> phipsi.Scene:
    builder = phipsi.SceneBuilder().link("ground")
    limits = {"type": "revolute", "lower": -1.0, "upper": 0.55, "velocity": 99, "effort": 99} if limited else {}
    add(builder, "crank", "ground", (0, 0, 0), 0.2, **limits)
    add(builder, "coupler", "crank", (0, 0, 0.2), 0.4, mass)
    add(builder, "rocker", "ground", (0.3, 0, 0), 0.3)
    axis = {"axis": (0, 1, 0)} if kind == "axis" else {}
    for name in ("pin", "again") if again else ("pin",):
        builder.connect(name, kind, "coupler", "rocker", xyz=(0, 0, 0.4), other_xyz=(0, 0, 0.3), **axis)
    return builder.build()


def tangle(floating: bool = False) -> phipsi.Scene:
    """Joints of several kinds in space, with a weld, a rod and a point between branches."""
    random = np.random.default_rng(5)
    builder = phipsi.SceneBuilder().link("base", mass=2.0, inertia=np.diag([0.1, 0.2, 0.15]))
    kinds = ("revolute", "spherical", "revolute", "prismatic", "spherical", "revolute", "spherical", "revolute")
    for k, kind in enumerate(kinds):
        parent = "base" if k < 2 else f"link{k - 2}"
        builder.link(f"link{k}", mass=1.0, com=random.uniform(-0.1, 0.1, 3), inertia=np.diag([0.02, 0.03, 0.025]))
        axis = {} if kind == "spherical" else {"axis": random.uniform(-1, 1, 3)}
        limits = {"lower": -9, "upper": 9, "velocity": 99, "effort": 99} if kind in ("revolute", "prismatic") else {}
        builder.joint(f"joint{k}", kind, parent, f"link{k}", xyz=random.uniform(-0.4, 0.4, 3), **axis, **limits)
    builder.connect("weld", "weld", "link7", "link6", xyz=random.uniform(-0.2, 0.2, 3), rotation=random_rotation(random))
    builder.connect("rod", "rod", "link4", "link5", xyz=(0.1, 0, 0.2), other_xyz=(0.3, 0.1, 0))
    builder.connect("point", "point", "link3", None if floating else "link2", xyz=(0, 0.2, 0.1))
    return builder.build(floating_base=floating)


def quadruped() -> phipsi.Scene:
    """A floating body on four legs, whose feet points hold, as in solo12."""
    builder = phipsi.SceneBuilder().link("body", mass=3.0, inertia=np.diag([0.02, 0.05, 0.06]))
    for leg, (x, y) in {"a": (0.2, 0.1), "b": (0.2, -0.1), "c": (-0.2, 0.1), "d": (-0.2, -0.1)}.items():
        parent, at = "body", (x, y, 0.0)
        for part, axis, length in (("hip", (1, 0, 0), 0.0), ("thigh", (0, 1, 0), 0.16), ("shank", (0, 1, 0), 0.16)):
            name = f"{leg}_{part}"
            builder.link(name, mass=0.2, com=(0.01, 0.0, -length / 2), inertia=np.diag([4e-4, 5e-4, 2e-4]))
            builder.joint(f"{name}_joint", "continuous", parent, name, xyz=at, axis=axis, armature=1e-3)
            parent, at = name, (0.0, 0.0, -0.16 if part != "hip" else 0.0)
        builder.connect(leg, "point", f"{leg}_shank", xyz=(0, 0, -0.16))
    return builder.build(floating_base=True)


SCENES: dict[str, Callable[[], phipsi.Scene]] = {
    "four-bar": four_bar,
    "four-bar on a point": lambda: four_bar("point"),
    "redundant": lambda: four_bar("point", again=True),
    "tangle": tangle,
    "floating": lambda: tangle(floating=True),
    "quadruped": quadruped,
}


def start(scene: phipsi.Scene, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A state that satisfies the connections, away from singular positions."""
    random = np.random.default_rng(seed)
    q = np.array([0.5, 0.8, 0.2]) if scene.nq == 3 else scene.integrate(scene.neutral(), random.uniform(-0.2, 0.2, scene.nv))
    found = scene.loops.project(q, random.uniform(-1, 1, scene.nv))
    return found.q, found.qd


class Function:
    """A scalar function of the rows of a simulation, and its gradients."""

    def __init__(self, scene: phipsi.Scene, q: np.ndarray, qd: np.ndarray, **given: object) -> None:
        self.scene, self.q, self.qd, self.given = scene, q, qd, given
        self.path = scene.simulate(q, qd, **given)
        self.by_q, self.by_qd = np.random.default_rng(3).uniform(-1, 1, (2, len(self.path), scene.nv))
        self.found = self.path.vjp(self.by_q, self.by_qd, parameters=True)
        self.scale = size(*self.found[:7])

    def value(self, q: np.ndarray | None = None, qd: np.ndarray | None = None, scene: phipsi.Scene | None = None, **changed: object) -> float:
        state = self.q if q is None else q, self.qd if qd is None else qd
        other = (scene or self.scene).simulate(*state, **{**self.given, **changed})
        return float(np.sum(self.by_q * self.scene.difference(self.path.q, other.q)) + np.sum(self.by_qd * other.qd))

    def check(self, gradient: float, value: Callable[[float], float], step: float) -> None:
        assert_near(gradient, slope_of_order_4(value, step), 1e-8 * self.scale)


def moved(scene: phipsi.Scene, q: np.ndarray, qd: np.ndarray, seed: int) -> Callable[[float], tuple[np.ndarray, np.ndarray]]:
    """States along a curve on the connections through (q, qd)."""
    d, e = np.random.default_rng(seed).uniform(-1, 1, (2, scene.nv))

    def state(h: float) -> tuple[np.ndarray, np.ndarray]:
        found = scene.loops.project(scene.integrate(q, h * d), qd + h * e)
        return found.q, found.qd

    return state


def check_all(function: Function, torques: int = 2) -> None:
    scene, q, qd, found = function.scene, function.q, function.qd, function.found
    for seed in range(3):
        at = moved(scene, q, qd, seed)
        by_q = np.array([slope_of_order_4(lambda h, i=i: scene.difference(q, at(h)[0])[i], 1e-4) for i in range(scene.nv)])
        by_qd = np.array([slope_of_order_4(lambda h, i=i: at(h)[1][i], 1e-4) for i in range(scene.nv)])
        function.check(found.q @ by_q + found.qd @ by_qd, lambda h: function.value(*at(h)), 1e-4)  # noqa: B023
    random = np.random.default_rng(9)
    tau = np.asarray(function.given["tau_steps"])
    for _ in range(torques):
        along = random.uniform(-1, 1, tau.shape)
        function.check(float(np.sum(found.tau * along)), lambda h: function.value(tau_steps=tau + h * along), 1e-3)  # noqa: B023
    for name in ("armature", "damping", "stiffness", "friction"):
        given = np.asarray(function.given[name])
        along = random.uniform(-1, 1, scene.nv) * given
        function.check(getattr(found, name) @ along, lambda h: function.value(**{name: given + h * along}), 1e-3)  # noqa: B023


def everything(scene: phipsi.Scene, q: np.ndarray, steps: int) -> dict[str, object]:
    random = np.random.default_rng(2)
    some = lambda scale: random.uniform(0.1, 1.0, scene.nv) * scale  # noqa: E731
    return {
        "tau_steps": random.uniform(-2, 2, (steps, scene.nv)), "steps": steps, "armature": some(0.1), "damping": some(0.5),
        "stiffness": some(3.0), "friction": some(0.3), "friction_speed": 0.5, "rest": q, "limits": "report",
        "pd": phipsi.PD(some(3.0), some(0.5), q, np.zeros(scene.nv)),
    }  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("method", ["rk4", "rosenbrock-2"])
def test_of_loops_beside_differences(name: str, method: str) -> None:
    scene = SCENES[name]()
    q, qd = start(scene)
    check_all(Function(scene, q, qd, dt=0.01, method=method, **everything(scene, q, 4)))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("every", [1, 3])
def test_of_every_method_beside_differences(method: str, every: int) -> None:
    scene = tangle()
    q, qd = start(scene, 1)
    check_all(Function(scene, q, qd, dt=0.02, method=method, record_every=every, **everything(scene, q, 6)), torques=1)


@pytest.mark.parametrize("method", ["rk4", "implicit-euler"])
def test_of_compliant_rows_beside_differences(method: str) -> None:
    scene = four_bar()
    q, qd = start(scene)
    check_all(Function(scene, q, qd, dt=0.01, method=method, compliance=1e-2, **everything(scene, q, 6)))


def test_of_inertial_parameters_beside_heavier_links() -> None:
    q, qd = start(four_bar())
    function = Function(four_bar(), q, qd, dt=0.01, steps=10, method="rk4")
    # A heavier link at the same center of mass and with the same moments about it.
    x, y, z = 0.02, 0.01, 0.2
    point = np.array([1.0, x, y, z, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
    assert function.found.parameters is not None
    gradient = float(function.found.parameters[1] @ point)
    assert abs(gradient) > 1e-6
    function.check(gradient, lambda h: function.value(scene=four_bar(mass=1.0 + h)), 1e-2)


def test_large_corrections_are_differentiated() -> None:
    """Steps so long that the projections move joints by some degrees."""
    scene = four_bar()
    found = scene.loops.project([0.5, 0.8, 0.2], [6.0, -5.0, 4.0])
    given = everything(scene, found.q, 3)
    free = scene.without_constraints().simulate(found.q, found.qd, dt=0.05, method="semi-implicit-euler", **given)
    assert np.abs(scene.loops.error(free.q[1])).max() > 1e-3
    check_all(Function(scene, found.q, found.qd, dt=0.05, method="semi-implicit-euler", **given))


def test_a_redundant_connection_changes_nothing() -> None:
    q, qd = start(four_bar("point"))
    one, two = (Function(four_bar("point", again), q, qd, dt=0.01, steps=20, method="rk4") for again in (False, True))
    for once, twice in zip(one.found[:7], two.found[:7], strict=True):
        assert_near(twice, once, 1e-10 * one.scale)


def test_connections_change_the_gradients() -> None:
    q, qd = start(four_bar())
    given = {"dt": 0.01, "steps": 10, "method": "rk4"}
    loop, tree = Function(four_bar(), q, qd, **given), Function(four_bar().without_constraints(), q, qd, **given)
    assert np.abs(loop.found.q - tree.found.q).max() > 1e-2
    # The torque of a joint acts on all joints of the loop.
    last = np.zeros_like(loop.by_q)
    last[-1, 2] = 1.0
    assert np.abs(loop.path.vjp(last).tau[0]) > 1e-5 and np.abs(tree.path.vjp(last).tau[0]) < 1e-15


def test_batches_and_steps_between_rows_are_as_singles() -> None:
    scene = quadruped()
    states = [start(scene, seed) for seed in range(5)]
    q, qd = (np.array(part) for part in zip(*states, strict=True))
    given = {"dt": 1e-3, "steps": 12, "method": "rosenbrock-2", "damping": 0.3}
    path = scene.simulate(q, qd, **given)
    last = np.zeros((len(path), scene.nv))
    last[-1] = np.linspace(-1, 1, scene.nv)
    found = path.vjp(last, -last)
    for i in range(5):
        alone = scene.simulate(q[i], qd[i], record_every=6, **given)
        one = alone.vjp(last[::6], -last[::6])
        for part, of_one in zip(found[:7], one[:7], strict=True):
            assert_near(part[i], of_one, 1e-9 * size(of_one))


def test_of_divided_steps_of_a_loop_beside_differences() -> None:
    scene = four_bar()
    q, qd, _ = scene.loops.project([0.5, 0.8, 0.2], [12.0, 0.0, 0.0])
    function = Function(scene, q, qd, dt=5e-3, steps=4, tau=np.zeros(3))
    assert function.path.substeps > 1
    for seed in range(2):
        at = moved(scene, q, qd, seed)
        by_q, by_qd = (slope_of_order_4(lambda h, i=i: at(h)[i], 1e-4) for i in (0, 1))  # noqa: B023
        function.check(function.found.q @ by_q + function.found.qd @ by_qd, lambda h: function.value(*at(h)), 1e-5)  # noqa: B023
    for i, unit in enumerate(np.eye(3)):
        function.check(function.found.tau[i], lambda h: function.value(tau=h * unit), 1e-3)  # noqa: B023


def five_bar(upper: float | None = None) -> phipsi.Scene:
    """Two degrees of freedom: one joint can be held while the others move."""
    builder = phipsi.SceneBuilder().link("ground")
    limits = {} if upper is None else {"type": "revolute", "lower": -9.0, "upper": upper, "velocity": 99, "effort": 99}
    add(builder, "crank", "ground", (0, 0, 0), 0.2, **limits)
    add(builder, "coupler", "crank", (0, 0, 0.2), 0.4)
    add(builder, "rocker", "ground", (0.3, 0, 0), 0.2)
    add(builder, "arm", "rocker", (0, 0, 0.2), 0.4)
    builder.connect("pin", "point", "coupler", "arm", xyz=(0, 0, 0.4), other_xyz=(0, 0, 0.4))
    return builder.build()


def check_in_modes(scene: phipsi.Scene, q: np.ndarray, qd: np.ndarray, still: bool = False, **given: object) -> Function:
    """By states on the connections, by torques, by friction and by masses, in the modes of the run."""
    function = Function(scene, q, qd, **given)
    found, random = function.found, np.random.default_rng(9)
    for seed in range(3):
        at = moved(scene, q, qd, seed)
        states = (lambda h, at=at: (at(h)[0], qd)) if still else at
        by_q = np.array([slope_of_order_4(lambda h, i=i: scene.difference(q, states(h)[0])[i], 1e-4) for i in range(scene.nv)])  # noqa: B023
        by_qd = np.array([slope_of_order_4(lambda h, i=i: states(h)[1][i], 1e-4) for i in range(scene.nv)])  # noqa: B023
        function.check(found.q @ by_q + found.qd @ by_qd, lambda h: function.value(*states(h)), 1e-5)  # noqa: B023
    tau = np.asarray(given["tau"])
    along = random.uniform(-1, 1, tau.shape)
    function.check(float(found.tau @ along), lambda h: function.value(tau=tau + h * along), 1e-4)
    if "friction" in given:
        friction = np.asarray(given["friction"])
        function.check(float(found.friction @ friction), lambda h: function.value(friction=friction * (1 + h)), 1e-4)
    function.check(float(found.armature.sum()), lambda h: function.value(armature=np.full(scene.nv, 1e-3 + h)), 1e-4)
    return function


@pytest.mark.parametrize("method", ["rk4", "rosenbrock-2"])
def test_of_a_joint_that_reaches_its_stop(method: str) -> None:
    """The steps before, the impact, and rest; test_event_gradients has the gradients of rebounds."""
    scene = four_bar(limited=True)
    found = scene.loops.project([0.5, 0.8, 0.2], [1.0, 0.0, 0.0])
    given = {"dt": 0.01, "steps": 9, "method": method, "tau": [1.0, 0.1, 0.0]}
    path = check_in_modes(scene, found.q, found.qd, **given).path
    at_stop = np.abs(path.q[:, 0] - 0.55) <= 1e-5
    assert 1 <= at_stop.sum() < 9 and not at_stop[:2].any()
    assert not (path.qd[:, 0] < -1e-2).any()


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_of_a_joint_that_rests_at_its_stop(friction: float) -> None:
    """From the first step on, while the other joints move."""
    found = five_bar().loops.project([-0.5, 0.9, -0.1, 0.3], [0.3, 0.0, 0.2, 0.0])
    scene = five_bar(upper=found.q[0] + 1e-3)
    rubbing = {"friction": [friction, 0.0, 0.0, 0.1], "friction_speed": 0.0} if friction else {}
    path = check_in_modes(scene, found.q, found.qd, dt=0.01, steps=6, method="rk4", tau=[5.0, 0.0, 0.5, 0.1], **rubbing).path
    beyond = path.q[1:, 0] - found.q[0] - 1e-3
    assert np.all(beyond <= 1e-9) and np.all(beyond >= -1e-4) and np.abs(path.qd[-1, 1:]).min() > 1e-2


@pytest.mark.parametrize("method", ["rk4", "implicit-euler"])
def test_of_a_joint_that_friction_holds(method: str) -> None:
    scene = five_bar()
    q = scene.loops.project([-0.5, 0.9, -0.1, 0.3]).q
    given = {"dt": 0.01, "steps": 6, "method": method, "tau": [0.5, 0.0, 2.0, 0.1], "friction": [9.0, 0.0, 0.2, 0.0], "friction_speed": 0.0}
    path = check_in_modes(scene, q, np.zeros(4), still=True, **given).path
    assert np.abs(path.q[:, 0] - q[0]).max() <= 1e-12 and np.abs(path.qd[-1, 1:]).min() > 1e-2


def test_of_a_linkage_that_friction_holds() -> None:
    scene = four_bar()
    q = scene.loops.project([0.5, 0.8, 0.2]).q
    given = {"dt": 0.01, "steps": 5, "method": "rk4", "tau": [0.1, 0.0, 0.0], "friction": [20.0, 0.1, 0.1], "friction_speed": 0.0}
    path = check_in_modes(scene, q, np.zeros(3), still=True, **given).path
    assert np.array_equal(path.q[-1], q)


def test_of_joints_that_slide_and_then_stick() -> None:
    scene = four_bar()
    found = scene.loops.project([0.5, 0.8, 0.2], [0.6, 0.0, 0.0])
    given = {"dt": 0.002, "steps": 14, "method": "rk4", "tau": [0.0, 0.0, 0.0], "friction": [6.0, 0.1, 0.1], "friction_speed": 0.0}
    path = check_in_modes(scene, found.q, found.qd, **given).path
    assert np.all(path.qd[-1] == 0) and np.abs(path.qd[2]).max() > 1e-2


def gripper(by_rows: bool = False) -> phipsi.Scene:
    """An arm with two fingers and a tip that follow others, as mimic joints or by rows of joint coordinates."""
    builder = phipsi.SceneBuilder().link("base")
    add(builder, "arm", "base", (0, 0, 0.1), 0.4)
    for name, x, other, ratio, offset in (("left", 0.05, None, 1.0, 0.0), ("right", -0.05, "left", -1.5, 0.1), ("tip", 0.0, "arm", 0.5, 0.0)):
        follows = {"mimic": f"{other}_joint", "mimic_multiplier": ratio, "mimic_offset": offset} if other and not by_rows else {}
        add(builder, name, "arm", (x, 0, 0.4), 0.15, **follows)
        if other and by_rows:
            builder.couple(name, f"{name}_joint", f"{other}_joint", multiplier=ratio, offset=offset)
    return builder.build() if by_rows else builder.build(mimic="couple")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("every", [1, 3])
def test_of_coupled_joints_beside_differences(method: str, every: int) -> None:
    scene = gripper()
    q, qd = np.array([0.3, 0.4]), np.array([0.5, -0.8])
    given = everything(scene, q, 6)
    function = Function(scene, q, qd, dt=0.02, method=method, record_every=every, **given)
    found, random = function.found, np.random.default_rng(1)
    assert found.q.shape == (2,) and found.tau.shape == (6, 2) and found.damping.shape == (2,)
    for i, unit in enumerate(np.eye(2)):
        function.check(found.q[i], lambda h: function.value(q=q + h * unit), 1e-3)  # noqa: B023
        function.check(found.qd[i], lambda h: function.value(qd=qd + h * unit), 1e-3)  # noqa: B023
    along = random.uniform(-1, 1, (6, 2))
    tau = np.asarray(given["tau_steps"])
    function.check(float(np.sum(found.tau * along)), lambda h: function.value(tau_steps=tau + h * along), 1e-2)
    for name in ("armature", "damping", "stiffness", "friction"):
        value = np.asarray(given[name])
        function.check(getattr(found, name) @ value, lambda h: function.value(**{name: value * (1 + h)}), 1e-3)  # noqa: B023


def test_of_coupled_joints_through_events_of_exact_friction() -> None:
    """A finger reverses, and steps are divided: compared with differences of simulations with error control."""
    scene = gripper()
    start = [np.array([0.3, 0.4]), np.array([0.5, -0.8]), np.array([0.05, 0.02])]
    run = lambda q, qd, friction, **given: scene.simulate(q, qd, friction=friction, damping=0.1, **given)  # noqa: E731
    path = run(*start, dt=2e-3, steps=200)
    assert np.ptp(np.sign(path.qd[:, 1])) == 2
    by_rows = np.zeros((2, *path.q.shape))
    by_rows[:, -1] = [[1.0, -0.5], [0.7, 0.3]]
    found = path.vjp(*by_rows)

    def value(*start: np.ndarray) -> float:
        end = run(*start, dt=0.4, steps=1, accuracy=1e-11)
        return float(np.sum(by_rows[:, -1] * [end.q[-1], end.qd[-1]]))

    for k, gradient in enumerate((found.q, found.qd, found.friction)):
        for i, unit in enumerate(1e-5 * np.eye(2)):
            ends = [value(*(x + by * unit if k == of else x for of, x in enumerate(start))) for by in (1.0, -1.0)]
            assert_near(gradient[i], (ends[0] - ends[1]) / 2e-5, 1e-2 * size(found.q))


def test_coupled_joints_are_joints_on_a_connection() -> None:
    """The gradients by minimal coordinates are those of a loop with rows of joint coordinates, reduced."""
    coupled, rows = gripper(), gripper(by_rows=True)
    assert rows.nv == 4 and coupled.nv == 2
    into = np.zeros((4, 2))
    for joint, other, ratio in (("arm", "arm", 1.0), ("left", "left", 1.0), ("right", "left", -1.5), ("tip", "arm", 0.5)):
        into[rows.v_index(f"{joint}_joint"), coupled.v_index(f"{other}_joint")] = ratio
    q, qd = np.array([0.3, 0.4]), np.array([0.5, -0.8])
    offset = np.zeros(4)
    offset[rows.v_index("right_joint")] = 0.1
    one = coupled.simulate(q, qd, dt=0.01, steps=20, method="rk4")
    other = rows.simulate(into @ q + offset, into @ qd, dt=0.01, steps=20, method="rk4")
    assert_near(other.q, one.q @ into.T + offset, 1e-12)
    cotangents = np.random.default_rng(0).uniform(-1, 1, (2, 21, 4))
    of_rows = other.vjp(*cotangents, parameters=True)
    found = one.vjp(*(part @ into for part in cotangents), parameters=True)
    assert_near(found.q, of_rows.q @ into, 1e-10 * size(found.q))
    assert_near(found.qd, of_rows.qd @ into, 1e-10 * size(found.qd))
    assert found.parameters is not None and found.parameters.shape == (4, 10)
    assert_near(found.parameters, of_rows.parameters, 1e-10 * size(found.parameters))


class Dense:
    """Steps of the four-bar linkage of test_loops_lagrange with 60 digits, from the definitions: kinetic and potential
    energy of its bodies in the coordinates of the tree, and the position of its pin.
    """

    def __init__(self, dt: float) -> None:
        self.mechanism, self.dt = lagrange.four_bar("point"), mpf(dt)

    def places(self, q: np.ndarray) -> np.ndarray:
        """Centers of mass and angles of the bodies, then the error of the pin in the axes of the coupler."""
        poses = self.mechanism.poses(q)
        found = []
        for bar, x, z, turn in poses:
            sine, cosine, (cx, cz) = CONTEXT.sin(turn), CONTEXT.cos(turn), bar.com
            found += [x + cosine * cx + sine * cz, z - sine * cx + cosine * cz, turn]
        (_, *coupler), (_, *rocker) = poses[1:]
        ends = [lagrange.end(*place, length) for place, length in ((coupler, lagrange.L), (rocker, lagrange.C))]
        x, z = (a - b for a, b in zip(*ends, strict=True))
        sine, cosine = CONTEXT.sin(coupler[2]), CONTEXT.cos(coupler[2])
        return np.array([*found, cosine * x - sine * z, sine * x + cosine * z])

    def at(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """M, its derivatives of the places, and J."""
        weights = np.array([mpf(x) for bar, *_ in self.mechanism.poses(q) for x in (bar.mass, bar.mass, bar.inertia)])
        columns = np.stack([lagrange.directional(self.places, q, unit)[0] for unit in np.eye(3) * mpf(1)], axis=1)
        return columns[:9].T @ (weights[:, None] * columns[:9]), columns, weights

    @staticmethod
    def solve(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.array(list(CONTEXT.lu_solve(CONTEXT.matrix(a.tolist()), CONTEXT.matrix(b.tolist()))))

    def pushed(self, q: np.ndarray, free: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """x with M x = free + J^T lambda and J x = wanted."""
        mass, columns, _ = self.at(q)
        rows = columns[9:]
        whole = np.block([[mass, -rows.T], [rows, np.zeros((2, 2)) * mpf(1)]])
        return self.solve(whole, np.concatenate([free, wanted]))[:3]

    def accelerations(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
        _, columns, weights = self.at(q)
        turning = lagrange.directional(self.places, q, v)[1]
        load = weights * turning[:9]
        load[1::3] += weights[1::3] * mpf(lagrange.GRAVITY)
        return self.pushed(q, tau - columns[:9].T @ load, -turning[9:])

    def step(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray, method: str) -> tuple[np.ndarray, np.ndarray]:
        h = self.dt
        if method == "rk4":
            stages: list[tuple[np.ndarray, np.ndarray]] = []
            for share in (0, mpf(1) / 2, mpf(1) / 2, 1):
                before = stages[-1] if stages else (v * 0, v * 0)
                speed = v + h * share * before[1]
                stages.append((speed, self.accelerations(q + h * share * before[0], speed, tau)))
            weights = [mpf(1) / 6, mpf(1) / 3, mpf(1) / 3, mpf(1) / 6]
            change = [sum(w * stage[i] for w, stage in zip(weights, stages, strict=True)) for i in (0, 1)]
            q, v = q + h * change[0], v + h * change[1]
        else:
            v = v + h * self.accelerations(q, v, tau)
            q = q + h * v
        for _ in range(7):
            q = q + self.pushed(q, 0 * v, -self.places(q)[9:])
        rows = self.at(q)[1][9:]
        return q, v + self.pushed(q, 0 * v, -rows @ v)


@pytest.mark.parametrize("method", ["rk4", "semi-implicit-euler"])
def test_of_two_steps_beside_60_digits(method: str) -> None:
    dense, random = Dense(0.02), np.random.default_rng(4)
    scene, free, rate = dense.mechanism.scene, mpf(0.6), mpf(3)
    tau, (by_q, by_qd) = random.uniform(-1, 1, 3), random.uniform(-1, 1, (2, 3))

    def start_at(free: Any, rate: Any) -> tuple[np.ndarray, np.ndarray]:
        coordinates = lambda x: np.array(dense.mechanism.coordinates(x))  # noqa: E731
        at = np.array([free])
        return coordinates(at), rate * lagrange.directional(coordinates, at, np.array([mpf(1)]))[0]

    def value(free: Any = free, rate: Any = rate, tau: np.ndarray = tau) -> Any:
        q, v = start_at(free, rate)
        for _ in range(2):
            q, v = dense.step(q, v, np.array([mpf(x) for x in tau]), method)
        return by_q @ q + by_qd @ v

    q, qd = (part.astype(float) for part in start_at(free, rate))
    path = scene.simulate(q, qd, dt=0.02, steps=2, method=method, tau=tau)
    assert_near(float(by_q @ path.q[-1] + by_qd @ path.qd[-1]), float(value()), 1e-12)
    rows = np.zeros((2, 3, 3))
    rows[0, -1], rows[1, -1] = by_q, by_qd
    found, h = path.vjp(*rows), mpf(10) ** -4
    # The derivatives of the start by the angle and the rate of the crank.
    along_q, along_qd = (
        np.array([slope_of_order_4(lambda step: start_at(free + step, rate)[part][i], h) for i in range(3)])  # noqa: B023
        for part in (0, 1)
    )
    by_free = slope_of_order_4(lambda step: value(free=free + step), h)
    by_rate = slope_of_order_4(lambda step: value(rate=rate + step), h)
    scale = size(found.q, found.qd, found.tau)
    assert_near(found.q @ along_q + found.qd @ along_qd, by_free, 1e-10 * scale)
    assert_near(found.qd @ (qd / float(rate)), by_rate, 1e-10 * scale)
    for i, unit in enumerate(np.eye(3)):
        assert_near(found.tau[i], slope_of_order_4(lambda step: value(tau=tau + step * unit), h), 1e-10 * scale)  # noqa: B023


@pytest.mark.parametrize("name", ["four-bar", "redundant", "quadruped"])
def test_steps_without_corrections_are_differentiated_as_projected(name: str) -> None:
    """Steps so short that they end on the connections to rounding."""
    scene = SCENES[name]()
    q, qd = start(scene)
    check_all(Function(scene, q, qd, dt=1e-4, method="rk4", **everything(scene, q, 4)))


def test_gradients_do_not_depend_on_changes_that_the_projection_removes() -> None:
    """With rows of the end alone, a start off the connections counts as its projection after the first step."""
    scene = four_bar()
    q, qd = start(scene)
    path = scene.simulate(q, qd, dt=1e-4, steps=3, method="rk4")
    last = np.zeros_like(path.q)
    last[-1] = [0.3, -0.7, 0.4]
    found = path.vjp(last)
    # A change of q along M^-1 J^T is removed, to first order in dt.
    minv_jt = np.linalg.solve(scene.mass_matrix(q), scene.loops.jacobian(q).T)
    removed = minv_jt[:, np.abs(minv_jt).max(0) > 1e-9]
    assert np.all(np.abs(found.q @ removed) <= 1e-3 * np.linalg.norm(removed, axis=0))


@pytest.mark.parametrize("kind", ["point", "weld"])
@pytest.mark.parametrize("how", [{}, {"damping": 0.1}, {"friction": 0.1}, {"method": "rosenbrock-2"}])
def test_a_mechanism_that_connections_lock_has_gradients(kind: str, how: dict[str, Any]) -> None:
    """Its velocities are rounding errors as small as numbers can be, whose reciprocals overflow."""
    builder = phipsi.SceneBuilder().link("base").link("a", 1.0, (0.1, 0, 0), 0.01 * np.eye(3)).link("b", 1.0, (0.1, 0, 0), 0.01 * np.eye(3))
    builder.joint("x", "prismatic", "base", "a", axis="x").joint("h", "revolute", "a", "b", axis=(0, 1, 0.2), xyz=(0.3, 0, 0))
    scene = builder.connect("lock", kind, "b", xyz=(0.1, 0.2, 0.3)).build()
    for qd in ([0.0, 0.0], [5e-324, -5e-324]):
        path = scene.simulate([0.0, 0.0], qd, dt=1e-3, steps=5, tau=[0.3, 0.2], **how)
        last = np.zeros_like(path.qd)
        last[-1] = 1.0
        found = path.vjp(last, last)
        for gradient in (found.tau, found.damping, found.friction):
            assert_near(gradient, np.zeros(2), 1e-12)
        assert np.isfinite(found.q).all()
