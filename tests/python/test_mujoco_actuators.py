"""phipsi.mujoco.actuators: torques compared with qfrc_actuator of MuJoCo."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tolerances import EPS, assert_near, size

import phipsi
from phipsi.errors import ArgumentError, ModelWarning, NotFiniteError, SceneError, ShapeError

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


@pytest.fixture(scope="module")
def both() -> tuple[phipsi.Scene, Any]:
    return phipsi.Scene.from_mujoco(MODEL.format(more="")), mujoco.MjModel.from_xml_string(MODEL.format(more=""))


def test_torques_are_those_of_mujoco(both: tuple[phipsi.Scene, Any]) -> None:
    scene, model = both
    found = phipsi.mujoco.actuators(scene, model)
    assert found.names == ("motor", "servo", "speed", "actuator3") and found.joints == ("hip", "rail", "hip", "rail")
    data, random = mujoco.MjData(model), np.random.default_rng(0)
    controls, states, expected = [], [], []
    for _ in range(30):
        data.qpos[7:], data.qvel[:], data.ctrl[:] = random.normal(size=2), random.normal(size=8), 2 * random.normal(size=4)
        mujoco.mj_forward(model, data)
        controls.append(data.ctrl.copy())
        states.append(phipsi.mujoco.to_state(scene, data.qpos, data.qvel))
        expected.append(data.qfrc_actuator.copy())
    q, qd = (np.stack(part) for part in zip(*states, strict=True))
    tau = found.torques(np.stack(controls), q, qd)
    assert_near(tau, np.stack(expected), 64 * EPS * size(expected))
    assert_near(found.law(controls[0])(0.0, q[0], qd[0]), expected[0], 64 * EPS * size(expected))


def test_controls_by_name(both: tuple[phipsi.Scene, Any]) -> None:
    found = phipsi.mujoco.actuators(*both)
    assert_near(found.torques({"motor": 0.5}), found.torques([0.5, 0.0, 0.0, 0.0]), 0.0)
    with pytest.raises(ArgumentError, match="ctrl: found 'servos'; expected names of servo, motor, speed"):
        found.torques({"servos": 1.0})


def test_controls_of_keyframes() -> None:
    text = MODEL.format(more="").replace("</mujoco>", '<keyframe><key name="home" ctrl="0.1 0.2 0.3 0.4"/><key/></keyframe></mujoco>')
    found = phipsi.mujoco.actuators(phipsi.load(text), text)
    data = mujoco.MjData(model := mujoco.MjModel.from_xml_string(text))
    mujoco.mj_resetDataKeyframe(model, data, 0)
    assert_near(found.keyframes["home"], data.ctrl, 0.0)
    assert_near(found.keyframes["key1"], np.zeros(4), 0.0)


def test_a_control_of_wrong_length(both: tuple[phipsi.Scene, Any]) -> None:
    with pytest.raises(ShapeError, match=r"ctrl: found shape \(3,\); expected \(..., 4\)"):
        phipsi.mujoco.actuators(*both).torques([0.0, 0.0, 0.0])


def test_a_control_that_is_not_finite(both: tuple[phipsi.Scene, Any]) -> None:
    with pytest.raises(NotFiniteError, match="ctrl"):
        phipsi.mujoco.actuators(*both).torques([0.0, 0.0, np.nan, 0.0])


@pytest.mark.parametrize(
    ("more", "match"),
    [
        ('<motor name="push" site="s"/>', "'push', which does not act on a hinge or slide joint"),
        ('<general name="lag" joint="hip" dyntype="filter" dynprm="0.1"/>', "'lag', which has a state"),
        ('<motor name="thrust" joint="root" gear="1 0 0 0 0 0"/>', "'thrust', which does not act on a hinge or slide joint"),
    ],
)
def test_unsupported_actuators_warn_or_raise(both: tuple[phipsi.Scene, Any], more: str, match: str) -> None:
    model = mujoco.MjModel.from_xml_string(MODEL.format(more=more).replace('<geom size="0.1"/>', '<geom size="0.1"/><site name="s"/>', 1))
    with pytest.warns(ModelWarning, match=match):
        found = phipsi.mujoco.actuators(both[0], model)
    assert len(found) == 4
    with pytest.raises(SceneError, match=match):
        phipsi.mujoco.actuators(both[0], model, strict=True)


def test_a_scene_without_a_file_needs_a_source() -> None:
    with pytest.raises(ArgumentError, match="source: found None"):
        phipsi.mujoco.actuators(phipsi.scenes.chain(2))
