"""Actuators of MuJoCo models: torques compared with qfrc_actuator, motions compared with those of MuJoCo."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tolerances import EPS, assert_near, size

import phipsi
from phipsi.errors import ArgumentError, ModelWarning

mujoco = pytest.importorskip("mujoco")

import phipsi.mujoco  # noqa: E402

MODEL = """<mujoco><option><flag contact="disable"/></option><worldbody>
<body name="trunk" pos="0 0 1"><freejoint name="root"/><geom size="0.1"/>
<body><joint name="hip" axis="0 1 0"/><geom size="0.1" pos="0 0 0.2"/>
<body pos="0 0 0.4"><joint name="rail" type="slide" axis="0 0 1" actuatorfrcrange="-3 4" actuatorfrclimited="true"/><geom size="0.1"/></body>
</body></body></worldbody><actuator>
<motor name="motor" joint="hip" gear="3" ctrlrange="-1 1" ctrllimited="true"/>
<position name="servo" joint="rail" kp="20" kv="2" gear="2"/>
<velocity name="speed" joint="hip" kv="3" forcerange="-1 1" forcelimited="true"/>
<general joint="rail" gainprm="1 2 3" gaintype="affine" biastype="affine" biasprm="0.1 0.2 0.3"/>
{more}</actuator></mujoco>"""

#: A double pendulum with stops, and actuators of its two joints.
ARM = """<mujoco><option timestep="{dt}" integrator="implicitfast"><flag contact="disable"/></option><worldbody><body pos="0 0 1">
<joint name="a" axis="0 1 0" damping="1"/><geom type="capsule" size=".03" fromto="0 0 0 .4 0 0"/>
<body pos=".4 0 0"><joint name="b" axis="0 1 0" damping="1" {joint}/><geom type="capsule" size=".03" fromto="0 0 0 .4 0 0"/></body>
</body></worldbody><actuator>{actuators}</actuator></mujoco>"""

#: Actuators by kind, their controls, and attributes of the second joint.
KINDS: dict[str, tuple[str, list[float], str]] = {
    "position with kv": ('<position joint="a" kp="2000" kv="200"/><position joint="b" kp="2000" kv="20"/>', [0.3, -0.4], ""),
    "position with dampratio": ('<position joint="a" kp="500" dampratio="1"/><position joint="b" kp="200" dampratio="1"/>', [0.3, -0.4], ""),
    "position with gear 50": ('<position joint="a" kp="5" kv=".5" gear="50"/><position joint="b" kp=".5" kv=".05" gear="-50"/>', [15.0, 20.0], ""),
    "position with forcerange": ('<position joint="a" kp="500" kv="30" forcerange="-8 8"/><position joint="b" kp="200" kv="20" forcerange="-1 3"/>', [0.5, 0.7], ""),
    "position with a range above zero": ('<position joint="a" kp="500" kv="30" forcerange="-20 -2"/><position joint="b" kp="200" kv="20"/>', [0.0, 0.7], ""),
    "position of a filter": ('<position joint="a" kp="500" kv="30" timeconst=".1"/><position joint="b" kp="200" kv="20" timeconst=".2"/>', [0.5, 0.7], ""),
    "velocity": ('<velocity joint="a" kv="100"/><velocity joint="b" kv="10"/>', [0.3, -0.4], ""),
    "position and velocity": ('<position joint="b" kp="200"/><velocity joint="b" kv="20"/><motor joint="b"/><velocity joint="a" kv="100"/>', [0.3, 0.2, 1.0, 0.0], ""),
    "motor": ('<motor joint="a" gear="10" ctrlrange="-1 1"/><motor joint="b" forcerange="-1 1"/>', [-3.0, -4.0], ""),
    "motor and servo": ('<motor joint="b" forcerange="-1 1"/><position joint="b" kp="200" kv="20" forcerange="-2 2"/><velocity joint="a" kv="100"/>', [3.0, 0.7, 0.0], ""),
    "intvelocity": ('<intvelocity joint="a" kp="500" kv="30" actrange="-.2 .3"/><intvelocity joint="b" kp="200" kv="20" actrange="-1 1"/>', [0.8, -0.4], ""),
    "cylinder": ('<cylinder joint="a" area="3" timeconst=".2"/><cylinder joint="b" area="2" bias="0 -10 -1"/>', [1.0, -0.4], ""),
    "damper": ('<damper joint="a" kv="20" ctrlrange="0 1"/><damper joint="b" kv="5" ctrlrange="0 1"/>', [0.5, 1.7], ""),
    "actuatorfrcrange": ('<position joint="a" kp="500" kv="30"/><position joint="b" kp="200" kv="20"/>', [0.5, 0.7], 'actuatorfrcrange="-1 2"'),
    "actuatorfrcrange of a motor and a servo": ('<motor joint="b"/><position joint="b" kp="200" kv="20"/><velocity joint="a" kv="100"/>', [0.5, 0.7, 0.0], 'actuatorfrcrange="-1 2"'),
}


@pytest.fixture(scope="module")
def both() -> tuple[phipsi.Scene, Any]:
    return phipsi.Scene.from_mujoco(MODEL.format(more="")), mujoco.MjModel.from_xml_string(MODEL.format(more=""))


def test_torques_are_those_of_mujoco(both: tuple[phipsi.Scene, Any]) -> None:
    scene, model = both
    found = scene.actuators
    assert found.names == ("motor", "servo", "speed", "actuator3") and found.joints == ("hip", "rail", "hip", "rail")
    assert [one.kind for one in found] == ["motor", "position", "velocity", "general"]
    data, random = mujoco.MjData(model), np.random.default_rng(0)
    controls, states, expected = [], [], []
    for _ in range(30):
        data.qpos[7:], data.qvel[:], data.ctrl[:] = random.normal(size=2), random.normal(size=8), 2 * random.normal(size=4)
        mujoco.mj_forward(model, data)
        controls.append(data.ctrl.copy())
        states.append(phipsi.mujoco.to_state(scene, data.qpos, data.qvel))
        expected.append(data.qfrc_actuator.copy())
    q, qd = (np.stack(part) for part in zip(*states, strict=True))
    assert_near(found.torques(np.stack(controls), q, qd), np.stack(expected), 64 * EPS * size(expected))


@pytest.mark.parametrize("kind", KINDS)
def test_motions_are_those_of_mujoco(kind: str) -> None:
    """The difference is that of the integrators: it shrinks with MuJoCo's step, whose method has order one."""
    actuators, control, joint = KINDS[kind]
    differences = []
    for dt in (4e-4, 2e-4):
        model = mujoco.MjModel.from_xml_string(text := ARM.format(dt=dt, actuators=actuators, joint=joint))
        data, steps = mujoco.MjData(model), round(0.4 / dt)
        data.ctrl[:] = control
        for _ in range(steps):
            mujoco.mj_step(model, data)
        scene = phipsi.load(text)
        path = scene.simulate(scene.initial(), np.zeros(2), dt=dt, steps=steps, control=control)
        differences.append(np.abs(path.q[-1] - data.qpos).max() + 0.1 * np.abs(path.qd[-1] - data.qvel).max())
        assert path.activation is not None
        active = path.activation[scene.actuators.has_activation]
        assert_near(active, data.act, 2 * dt * size(control))
    assert differences[1] <= 1e-3 and differences[1] <= 0.6 * differences[0] + 1e-7, differences


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind.startswith(("position", "intvelocity", "actuatorfrcrange"))])
def test_stiff_servos_settle_where_those_of_mujoco_do(kind: str) -> None:
    """At 2 ms, where torques as a function of the state diverge."""
    actuators, control, joint = KINDS[kind]
    text = ARM.format(dt=0.002, actuators=actuators, joint=joint)
    data = mujoco.MjData(model := mujoco.MjModel.from_xml_string(text))
    data.ctrl[:] = control
    for _ in range(5000):
        mujoco.mj_step(model, data)
    scene = phipsi.load(text)
    path = scene.simulate(scene.initial(), np.zeros(2), dt=0.002, steps=5000, record_every=5000, control=control)
    # A velocity servo without a control creeps.
    assert_near(path.q[-1], data.qpos, 1e-4 if "<velocity" in actuators else 1e-6)


def test_controls_and_activations_of_keyframes() -> None:
    more = '<intvelocity joint="hip" actrange="-2 2"/></actuator><keyframe><key name="home" ctrl="0.1 0.2 0.3 0.4 0.5" act="0.7"/><key/></keyframe></mujoco>'
    text = MODEL.format(more=more).rpartition("</actuator>")[0]
    found = phipsi.load(text).actuators
    data = mujoco.MjData(model := mujoco.MjModel.from_xml_string(text))
    mujoco.mj_resetDataKeyframe(model, data, 0)
    assert_near(found.keyframes["home"], data.ctrl, 0.0)
    assert_near(found.keyframe_activations["home"], [0.0, 0.0, 0.0, 0.0, 0.7], 0.0)
    assert_near(found.keyframes["key1"], np.zeros(5), 0.0)


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        ('<motor name="push" site="s"/>', "which does not act on a hinge or slide joint"),
        ('<muscle name="push" joint="hip" lengthrange="0 1"/>', "whose state is not that of an integrator or filter"),
        ('<motor name="push" joint="root" gear="1 0 0 0 0 0"/>', "which does not act on a hinge or slide joint"),
        ('<general name="push" joint="hip" dyntype="filter" dynprm="1" actearly="true"/>', "which has a delay or actearly"),
    ],
)
def test_actuators_that_a_scene_cannot_represent_are_named(more: str, reason: str) -> None:
    text = MODEL.format(more=more).replace('<geom size="0.1"/>', '<geom size="0.1"/><site name="s"/>', 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = phipsi.load(text)
    assert scene.actuators.unsupported == {"push": reason} and len(scene.actuators) == 4
    assert repr(scene.actuators).endswith(f"not supported: 'push', {reason}")
    start = scene.initial(), np.zeros(scene.nv)
    with pytest.raises(ArgumentError, match=f"control: found 'push', {reason}"):
        scene.simulate(*start, dt=1e-3, steps=1, control={"push": 1.0})
    with pytest.warns(ModelWarning, match=f"control: found 'push', {reason}"):
        scene.simulate(*start, dt=1e-3, steps=1, control=np.zeros(4))


def test_an_actuator_of_a_plugin_is_named() -> None:
    library = next((Path(mujoco.__file__).parent / "plugin").glob("*actuator*"), None)
    if library is None:
        pytest.skip("this version of MuJoCo has no plugins of actuators")
    mujoco.mj_loadPluginLibrary(str(library))
    plugin = '<extension><plugin plugin="mujoco.pid"><instance name="pid"><config key="kp" value="40"/></instance></plugin></extension>'
    text = MODEL.format(more='<plugin name="push" joint="hip" plugin="mujoco.pid" instance="pid"/>').replace("<mujoco>", f"<mujoco>{plugin}")
    assert phipsi.load(text).actuators.unsupported == {"push": "whose force a plugin computes"}


def test_disabled_actuators_do_not_act() -> None:
    text = MODEL.format(more="").replace('<flag contact="disable"/>', '<flag contact="disable" actuation="disable"/>')
    assert len(phipsi.load(text).actuators) == 0
    text = MODEL.format(more="").replace("<option>", '<option actuatorgroupdisable="3">').replace('name="motor"', 'name="motor" group="3"')
    assert phipsi.load(text).actuators.unsupported == {"motor": "whose group is disabled"}
