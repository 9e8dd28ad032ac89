"""Actuators of scenes: from code and URDF, changed scenes, controls of simulations and simulators, gradients."""

from __future__ import annotations

import copy
import pickle
import warnings
from typing import Any

import numpy as np
import pytest
from tolerances import EPS, assert_near, size

import phipsi
from phipsi.errors import ArgumentError, ModelWarning, NotFiniteError, SceneError, ShapeError, SimulationError

#: Kinds of actuators of the joints of a chain.
KINDS: dict[str, dict[str, Any]] = {
    "motor": {"gear": 5.0, "ctrlrange": (-1, 1)},
    "position": {"kp": 40.0, "kv": 4.0, "gear": 2.0},
    "bounded": {"kp": 300.0, "kv": 10.0, "forcerange": (-2, 5)},
    "velocity": {"kv": 10.0, "gear": -2.0},
    "lag": {"kp": 40.0, "kv": 4.0, "timeconst": 0.05, "actrange": (-0.6, 0.6)},
    "integral": {"kp": 40.0, "kv": 4.0, "timeconst": np.inf},
}


def chain(kinds: list[str]) -> phipsi.Scene:
    builder = phipsi.scenes.chain(len(kinds)).to_builder()
    for at, kind in enumerate(kinds):
        builder = builder.actuator(kind, f"j{at}", **KINDS[kind])
    return builder.build()


def all_kinds() -> phipsi.Scene:
    return chain(list(KINDS))


def test_actuators_are_a_sequence_with_names_and_a_table() -> None:
    actuators = all_kinds().actuators
    assert len(actuators) == 6 and actuators[0] is actuators["motor"] and [one.name for one in actuators] == list(KINDS)
    assert [one.kind for one in actuators] == ["motor", "position", "position", "velocity", "position of a filter", "position of an integral"]
    assert (actuators["position"].kp, actuators["position"].kv) == (40.0, 4.0)
    lines = repr(actuators).splitlines()
    assert lines[0].split() == ["name", "joint", "kind", "gear", "kp", "kv", "ctrlrange", "forcerange"]
    assert lines[3].split() == ["bounded", "j2", "position", "1", "300", "10", "-", "-2,", "5"]
    assert repr(phipsi.scenes.chain(2).actuators) == "no actuators"


def test_an_actuator_replaces_that_of_the_same_name() -> None:
    scene = all_kinds().to_builder().actuator("motor", "j0", kp=7.0).build()
    assert len(scene.actuators) == 6 and scene.actuators["motor"].kp == 7.0


@pytest.mark.parametrize(
    "change",
    [
        lambda scene: scene.to_builder().build(),
        lambda scene: pickle.loads(pickle.dumps(scene)),
        lambda scene: pickle.loads(pickle.dumps(scene.to_builder())).build(),
        copy.deepcopy,
        lambda scene: scene.with_payload("link5", 0.2, [0, 0, 0.1], np.eye(3) * 1e-3),
        lambda scene: scene.with_properties(armature=0.1),
    ],
)
def test_changed_scenes_have_the_same_actuators(change: Any) -> None:
    scene = all_kinds()
    assert tuple(change(scene).actuators) == tuple(scene.actuators)


def test_locked_joints_have_no_actuators() -> None:
    locked = all_kinds().lock(["j0", "j3"], np.zeros(6))
    assert locked.actuators.names == ("position", "bounded", "lag", "integral")
    assert_near(locked.actuators.torques({"position": 1.0}), [80.0, 0.0, 0.0, 0.0], 0.0)


@pytest.mark.parametrize(
    ("joint", "given", "error", "match"),
    [
        ("j9", {}, ArgumentError, 'actuator "m": found "j9"'),
        ("root_joint", {}, SceneError, 'actuator "m": found joint "root_joint" with 6 degrees of freedom'),
        ("j0", {"gear": np.nan}, SceneError, 'actuator "m": found NaN in its gear'),
        ("j0", {"ctrlrange": (1, -1)}, SceneError, 'actuator "m": found a range from 1 to -1'),
        ("j0", {"timeconst": 0.0}, SceneError, 'actuator "m": found the time constant 0'),
        ("j0", {"kp": 1.0, "gain": (1, 0, 0)}, ArgumentError, 'gain of actuator "m": found kp or kv, and gain or bias'),
        ("j0", {"actrange": (0, 1)}, ArgumentError, 'actrange of actuator "m": found a range without a time constant'),
        ("j0", {"forcerange": 3.0}, ShapeError, 'forcerange of actuator "m"'),
    ],
)
def test_invalid_actuators_are_named(joint: str, given: dict[str, Any], error: type[Exception], match: str) -> None:
    with pytest.raises(error, match=match):
        phipsi.scenes.chain(2).to_builder().actuator("m", joint, **given).build(floating_base=True)


ROBOT = """<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="c"><inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="one" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="30" velocity="5"/></joint>
<joint name="two" type="continuous"><parent link="b"/><child link="c"/><axis xyz="1 0 0"/></joint>{}</robot>"""
SIMPLE = "<type>transmission_interface/SimpleTransmission</type>"


def transmission(name: str, joint: str, actuator: str, reduction: str = "", kind: str = SIMPLE) -> str:
    return f'<transmission name="{name}">{kind}<joint name="{joint}"/><actuator name="{actuator}">{reduction}</actuator></transmission>'


def test_transmissions_of_urdf_are_motors() -> None:
    text = ROBOT.format(transmission("t1", "one", "m1", "<mechanicalReduction>50</mechanicalReduction>") + transmission("t2", "two", "m2"))
    scene = phipsi.Scene.from_urdf(text, strict=True)
    actuators = scene.actuators
    assert actuators.names == ("m1", "m2") and actuators.joints == ("one", "two")
    assert_near(actuators.gear, [50.0, 1.0], 0.0)
    assert_near(actuators.ctrlrange[0], [-0.6, 0.6], EPS)
    assert np.array_equal(actuators.ctrlrange[1], [-np.inf, np.inf])
    assert_near(actuators.torques({"m1": 0.5, "m2": 2.0}), [25.0, 2.0], 64 * EPS)
    assert_near(actuators.torques({"m1": 5.0}), [30.0, 0.0], 64 * EPS)
    assert phipsi.Scene.from_urdf(text.partition("<transmission")[0] + "</robot>").actuators.names == ()


@pytest.mark.parametrize(
    "ratios",
    [
        '<mechanicalReduction>1</mechanicalReduction><drake:gear_ratio value="10"/>',
        '<drake:gear_ratio value="10"/><mechanicalReduction>1</mechanicalReduction>',
        "<gearRatio>10</gearRatio>",
    ],
)
def test_the_gear_of_a_motor_is_that_of_its_rotor(ratios: str) -> None:
    """The rotor turns gear times as fast as the joint, so that its kinetic energy is that of the armature."""
    rotor = '<drake:rotor_inertia value="0.01"/>'
    text = ROBOT.format(transmission("t1", "one", "m1", rotor + ratios)).replace('name="r"', 'name="r" xmlns:drake="http://drake.mit.edu"')
    scene = phipsi.Scene.from_urdf(text)
    assert_near(scene.actuators.gear, [10.0], 0.0)
    assert_near(scene.actuators.ctrlrange, [[-3.0, 3.0]], 4 * EPS)
    assert_near(scene.armature[:1], scene.actuators.gear**2 * 0.01, 4 * EPS)


def test_motors_are_written_as_transmissions() -> None:
    text = ROBOT.format(transmission("t1", "one", "m1", "<mechanicalReduction>-50</mechanicalReduction>") + transmission("t2", "two", "m2"))
    scene = phipsi.Scene.from_urdf(text)
    assert tuple(phipsi.Scene.from_urdf(scene.to_urdf()).actuators) == tuple(scene.actuators)
    servo = scene.to_builder().actuator("m2", "two", kp=3.0).build()
    with pytest.warns(ModelWarning, match=r"scene: found actuators \('m2'\), which URDF cannot represent"):
        assert phipsi.Scene.from_urdf(servo.to_urdf()).actuators.names == ("m1",)


def test_transmissions_that_are_not_read_are_named() -> None:
    parts = [
        transmission("t1", "one", "m1", kind="<type>transmission_interface/DifferentialTransmission</type>"),
        transmission("t2", "ghost", "m2"),
        transmission("t3", "two", "m3", "<mechanicalReduction>ten</mechanicalReduction>"),
        transmission("t4", "two", "m3"),
    ]
    actuators = phipsi.Scene.from_urdf(ROBOT.format("".join(parts)), strict=True).actuators
    assert actuators.names == ("m3_3",) and list(actuators.unsupported) == ["m1", "m2", "m3"]
    assert "SimpleTransmission" in actuators.unsupported["m1"] and "gear ratio" in actuators.unsupported["m3"]


def test_an_actuator_of_a_joint_that_follows_is_not_supported() -> None:
    text = ROBOT.format(transmission("t1", "two", "m1")).replace('<axis xyz="1 0 0"/>', '<axis xyz="1 0 0"/><mimic joint="one"/>')
    assert "follows another one" in phipsi.load(text, mimic="couple").actuators.unsupported["m1"]
    assert phipsi.load(text, mimic="free").actuators.names == ("m1",)


# Controls of simulations


def run(scene: phipsi.Scene, control: Any, **given: Any) -> phipsi._motion.Trajectory:
    return scene.simulate(np.full(scene.nv, 0.1), np.zeros(scene.nv), dt=1e-3, control=control, **given)


def test_controls_by_name_are_those_of_an_array() -> None:
    scene = all_kinds()
    named = run(scene, {"position": 0.5, "lag": 0.2}, steps=50)
    assert_near(named.q, run(scene, [0.0, 0.5, 0.0, 0.0, 0.2, 0.0], steps=50).q, 0.0)
    path = run(scene, {"position": np.linspace(0, 1, 50), "lag": 0.2}, steps=50)
    assert path.control is not None and path.control.shape == (50, 6)


def test_controls_of_steps_that_are_equal_are_a_constant_control() -> None:
    scene = all_kinds()
    control = np.array([0.4, 0.3, -0.2, 0.5, 0.4, -0.6])
    one = run(scene, control, steps=60)
    for many in (np.tile(control, (60, 1)), control[None]):
        assert_near(run(scene, many, steps=60).q, one.q, 64 * EPS)


def test_batches_are_their_states() -> None:
    scene = all_kinds()
    control = np.random.default_rng(0).normal(size=(3, 20, 6))
    together = run(scene, control, steps=20)
    for state in range(3):
        assert_near(together.q[state], run(scene, control[state], steps=20).q, 0.0)
    assert together.activation is not None and together.activation.shape == (3, 6)


def test_a_run_continues_with_its_activations() -> None:
    scene = all_kinds()
    control = np.random.default_rng(1).normal(size=(40, 6))
    whole = run(scene, control, steps=40)
    first = run(scene, control[:25], steps=25)
    rest = scene.simulate(first.q[-1], first.qd[-1], dt=1e-3, steps=15, control=control[25:], activation=first.activation)
    assert_near(rest.q[-1], whole.q[-1], 1e-12)
    assert_near(rest.activation, whole.activation, 64 * EPS)


def test_activations_are_the_exact_solution() -> None:
    scene = all_kinds()
    path = run(scene, {"lag": 0.5, "integral": -2.0}, steps=100)
    assert_near(path.activation, [0, 0, 0, 0, 0.5 * (1 - np.exp(-2.0)), -0.2], 1e-12)
    assert_near(run(scene, {"lag": 5.0}, steps=500).activation[4], 0.6, 0.0)  # actrange


@pytest.mark.parametrize("tau", [None, np.full(6, 0.3), lambda t, q, qd: np.full(6, 0.3)], ids=["none", "array", "function"])
def test_torques_of_the_caller_are_added_to_those_of_motors(tau: Any) -> None:
    scene = all_kinds()
    given = {} if tau is None else {"tau": tau}
    own = 0.0 if tau is None else 0.3
    found = run(scene, {"motor": np.linspace(-2, 2, 30)}, steps=30, **given)
    motors = np.zeros((30, 6))
    motors[:, 0] = 5.0 * np.clip(np.linspace(-2, 2, 30), -1, 1)
    expected = run(scene, np.zeros(6), steps=30, tau_steps=motors + own)
    assert_near(found.q, expected.q, 1e-12)


def test_torques_of_rows_are_those_of_the_actuators() -> None:
    scene = chain(["motor", "position", "bounded", "velocity"])
    control = np.random.default_rng(2).normal(size=(30, 4))
    path = run(scene, control, steps=30)
    expected = scene.actuators.torques(control, path.q[:-1], path.qd[:-1])
    assert_near(path.torques()[:-1], expected, 1e-9 * size(expected))


def test_files_have_the_controls(tmp_path: Any) -> None:
    scene = all_kinds()
    path = run(scene, np.random.default_rng(6).normal(size=(5, 6)), steps=5)
    path.save(tmp_path / "motion.npz")
    back = phipsi.Trajectory.load(tmp_path / "motion.npz", scene)
    for name in ("control", "activation", "start_activation"):
        assert_near(getattr(back, name), getattr(path, name), 0.0)
    assert_near(back.vjp(cotangent_qd=np.ones((6, 6))).control, path.vjp(cotangent_qd=np.ones((6, 6))).control, 0.0)


def test_clipped_controls_and_forces_are_violations() -> None:
    scene = chain(["motor", "bounded"])
    found = run(scene, {"motor": 3.0, "bounded": 4.0}, steps=10).violations()
    by_limit = {one.limit: one for one in found}
    assert by_limit["control of 'motor'"].bound == 1.0 and by_limit["control of 'motor'"].worst == 3.0 and by_limit["control of 'motor'"].joint == "j0"
    force = by_limit["force of 'bounded'"]
    assert force.bound == 5.0 and force.worst > 1000.0 and (force.joint, force.time) == ("j1", 0.0)
    assert run(scene, {"motor": 0.5, "bounded": 0.1}, steps=1).violations() == []


@pytest.mark.parametrize(
    ("control", "given", "error", "match"),
    [
        ({"motors": 1.0}, {}, ArgumentError, "control: found 'motors'; expected names of motor"),
        ([0.0] * 5, {}, ShapeError, r"control: found shape \(5,\); expected \(..., 6\)"),
        (np.zeros((7, 6)), {}, ShapeError, r"control: found shape \(7, 6\); expected \(6,\) or \(..., 10, 6\)"),
        ([np.nan] * 6, {}, NotFiniteError, "control"),
        ([0.0] * 6, {"pd": phipsi.PD(1.0, 1.0, [0.0] * 6)}, ArgumentError, "pd: found pd and control"),
        ([0.0] * 6, {"effort": "clip"}, ArgumentError, "effort: found 'clip' and control"),
        (None, {"activation": [0.0] * 6}, ArgumentError, "activation: found activations without control"),
    ],
)
def test_invalid_controls_are_named(control: Any, given: dict[str, Any], error: type[Exception], match: str) -> None:
    with pytest.raises(error, match=match):
        run(all_kinds(), control, steps=10, **given)


def test_controls_need_actuators() -> None:
    with pytest.raises(ArgumentError, match="control: found controls for a scene without actuators"):
        phipsi.scenes.chain(2).simulate([0, 0], [0, 0], dt=1e-3, steps=1, control=[])


def test_an_early_end_has_the_controls() -> None:
    def fail(t: float, q: Any, qd: Any) -> Any:
        if t > 4.5e-3:
            raise ValueError("no")
        return np.zeros(6)

    with pytest.raises(SimulationError) as caught:
        run(all_kinds(), np.zeros(6), steps=10, tau=fail)
    assert len(caught.value.trajectory) == 6 and caught.value.trajectory.control is not None


@pytest.mark.parametrize(
    ("second", "match"),
    [
        ({"kp": 1.0, "forcerange": (-1, 1)}, "2 servos at the joint 'j0', of which 'two' has a force range"),
        ({"bias": (0, 50, 0)}, "'one', 'two' with a negative stiffness at the joint 'j0'"),
        ({"bias": (0, 0, 50)}, "'one', 'two' with a negative damping at the joint 'j0'"),
        ({"kp": 1.0, "forcerange": (-np.inf, 1)}, "2 servos"),
    ],
)
def test_actuators_whose_sum_is_no_law_are_named(second: dict[str, Any], match: str) -> None:
    builder = phipsi.scenes.chain(1).to_builder().actuator("one", "j0", kp=10.0, kv=1.0).actuator("two", "j0", **second)
    scene = builder.build() if "negative" not in match else None
    with pytest.raises(ArgumentError, match=match):
        (scene or builder.build()).simulate([0.0], [0.0], dt=1e-3, steps=1, control=[0.0, 0.0])


def test_gains_that_follow_controls_are_constant_in_a_run() -> None:
    scene = phipsi.scenes.chain(2).to_builder().actuator("brake", "j0", gain=(0, 0, -5.0)).build()
    damped = scene.with_properties(damping={"j0": 2.5})
    start = [0.3, 0.2], [1.0, 0.0]
    path = scene.simulate(*start, dt=1e-3, steps=200, control=[0.5])
    assert_near(path.q, damped.simulate(*start, dt=1e-3, steps=200, method=path.integrator).q, 1e-6)
    with pytest.raises(ArgumentError, match="control: found controls of 'brake', and with them gains, that change"):
        scene.simulate(*start, dt=1e-3, steps=2, control=[[0.5], [0.6]])
    with pytest.raises(ArgumentError, match="'brake' with a negative damping"):
        scene.simulate(*start, dt=1e-3, steps=2, control=[-0.5])
    simulator = scene.simulator(*start, dt=1e-3, control=[0.5])
    simulator.step(steps=200)
    assert_near(simulator.q, path.q[-1], 0.0)
    with pytest.raises(ArgumentError, match="control: found controls of 'brake'"):
        simulator.step(control=[0.6])


# Simulators


def test_a_simulator_is_the_simulation() -> None:
    scene = all_kinds()
    control = np.random.default_rng(3).normal(size=(20, 6))
    path = run(scene, control, steps=20)
    simulator = scene.simulator(np.full(6, 0.1), dt=1e-3, control=control[0])
    for each in control:
        simulator.step(control=each)
    assert_near(simulator.q, path.q[-1], 0.0)
    assert_near(simulator.activation, path.activation, 0.0)
    assert_near(simulator.control, control[-1], 0.0)


def test_controls_of_a_simulator_remain_until_the_next() -> None:
    scene = all_kinds()
    one, other = (scene.simulator(np.zeros((2, 6)), dt=1e-3, control={"integral": 1.0, "motor": 0.3}) for _ in range(2))
    one.step(steps=10)
    for _ in range(10):
        other.step(tau=np.zeros(6))
    assert_near(one.q, other.q, 0.0)
    copies = [copy.copy(one), pickle.loads(pickle.dumps(one))]
    one.step([0.1, 0, 0, 0, 0, 0], steps=3)
    for each in copies:
        assert_near(each.activation, np.tile([0, 0, 0, 0, 0, 0.01], (2, 1)), 1e-15)
        each.step([0.1, 0, 0, 0, 0, 0], steps=3)
        assert_near(each.q, one.q, 0.0)
    one.reset(np.zeros(6), states=1)
    assert_near(one.activation[:, 5], [0.013, 0.0], 1e-15)
    one.reset(np.zeros(6), activation={"integral": 0.5})
    assert_near(one.activation[:, 5], [0.5, 0.5], 0.0)


def test_a_simulator_without_control_has_no_actuators() -> None:
    scene = all_kinds()
    simulator = scene.simulator(np.zeros(6), dt=1e-3)
    simulator.step()
    assert simulator.control is None and simulator.activation is None
    assert_near(simulator.q, scene.simulate(np.zeros(6), np.zeros(6), dt=1e-3, steps=1).q[-1], 0.0)
    with pytest.raises(ArgumentError, match="control: found controls for a simulator without"):
        simulator.step(control=np.zeros(6))
    with pytest.raises(ArgumentError, match="target: found a target and control"):
        scene.simulator(np.zeros(6), dt=1e-3, control=np.zeros(6)).step(target=np.zeros(6))


# Gradients


@pytest.mark.parametrize("is_constant", [True, False])
def test_gradients_by_control_are_those_of_run(is_constant: bool) -> None:
    scene = all_kinds()
    random = np.random.default_rng(4)
    control = 0.5 * random.normal(size=6 if is_constant else (12, 6))
    control[..., 2] = 0.101  # within the force range of "bounded"
    weights = random.normal(size=(13, 6))

    def value(u: Any) -> float:
        return float((weights * run(scene, u, steps=12, method="rosenbrock-2").qd).sum())

    path = run(scene, control, steps=12, method="rosenbrock-2")
    found = path.vjp(cotangent_qd=weights).control
    assert found is not None and found.shape == control.shape
    expected, h = np.zeros_like(control), 1e-5
    for at in np.ndindex(control.shape):
        change = np.zeros_like(control)
        change[at] = h
        expected[at] = (value(control + change) - value(control - change)) / (2 * h)
    assert_near(found, expected, 1e-8 * size(expected))


def test_clipped_controls_have_no_gradients() -> None:
    scene = all_kinds()
    path = run(scene, {"motor": 3.0, "bounded": 4.0, "position": 0.2}, steps=5)
    found = path.vjp(cotangent_qd=np.ones((6, 6))).control
    assert found is not None and found[0] == 0.0 and abs(found[2]) == 0.0 and found[1] != 0.0


def test_a_batch_has_gradients_of_its_states() -> None:
    scene = all_kinds()
    control = 0.3 * np.random.default_rng(5).normal(size=(3, 8, 6))
    together = run(scene, control, steps=8).vjp(cotangent_qd=np.ones((3, 9, 6))).control
    for state in range(3):
        assert_near(together[state], run(scene, control[state], steps=8).vjp(cotangent_qd=np.ones((9, 6))).control, 1e-15 * size(together))


def test_without_control_there_is_no_gradient_by_it() -> None:
    assert phipsi.scenes.chain(2).simulate([0, 0], [0, 0], dt=1e-3, steps=2).vjp(cotangent_qd=np.ones((3, 2))).control is None
