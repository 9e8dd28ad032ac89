"""URDF: warnings for implausible values, axes of any length, rotor inertia, and floating bases."""

from __future__ import annotations

import numpy as np
import pytest
from tolerances import assert_same_bits
from urdf_texts import ARM, arm, load

import phipsi
from phipsi.errors import InertiaWarning, LimitWarning, SceneError, UnknownTagWarning

MASSLESS = """<robot><link name="base"/><link name="a"/><link name="b"/><link name="tool"/>
<joint name="j" type="revolute"><parent link="base"/><child link="a"/></joint>
<joint name="k" type="prismatic"><parent link="a"/><child link="b"/></joint>
<joint name="w" type="fixed"><parent link="b"/><child link="tool"/></joint></robot>"""
HEAVY = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>'


def test_moving_links_without_mass_are_told_once() -> None:
    _, caught = load(MASSLESS)
    assert [one.category for one in caught] == [InertiaWarning]
    assert str(caught[0].message).startswith('3 of 3 moving links have no mass: "a", "b", "tool"')
    assert caught[0].filename.endswith("urdf_texts.py")
    with pytest.raises(SceneError, match=r"3 of 3 moving links have no mass.*strict"):
        phipsi.Scene.from_urdf(MASSLESS, strict=True)


def test_mass_on_the_base_is_no_moving_mass_unless_the_base_floats() -> None:
    text = MASSLESS.replace('<link name="base"/>', '<link name="base">' + HEAVY)
    _, caught = load(text)
    assert [one.category for one in caught] == [InertiaWarning]
    assert load(text, floating_base=True)[1] == []


def test_zero_mass_is_no_mass() -> None:
    _, caught = load(MASSLESS.replace('<link name="tool"/>', '<link name="tool">' + HEAVY.replace('"1"', '"0"')))
    assert "3 of 3" in str(caught[0].message)


def test_some_mass_and_no_motion_are_quiet() -> None:
    assert load(MASSLESS.replace('<link name="tool"/>', '<link name="tool">' + HEAVY))[1] == []
    assert load('<robot><link name="a"/></robot>')[1] == []


def test_locking_what_has_the_mass_is_no_loading() -> None:
    text = MASSLESS.replace('<link name="a"/>', '<link name="a">' + HEAVY)
    assert phipsi.Scene.from_urdf(text, strict=True).lock(["j"], [0.0, 0.0]).nv == 1


@pytest.mark.parametrize(
    ("old", "new", "words", "limits"),
    [
        ('lower="-1"', 'lower="2"', "lower 2 above upper 1", (-np.inf, np.inf, 3, 2)),
        ('lower="-1" upper="1"', 'lower="1"', "lower 1 above upper 0", (-np.inf, np.inf, 3, 2)),
        ('velocity="3"', 'velocity="-3"', "velocity -3 below zero", (-1, 1, np.inf, 2)),
        ('effort="2"', 'effort="-1e200"', "effort -1e200 below zero", (-1, 1, 3, np.inf)),
    ],
)
def test_limits_that_mean_nothing_are_taken_as_none(old: str, new: str, words: str, limits: tuple[float, ...]) -> None:
    scene, caught = load(arm(old, new))
    assert [one.category for one in caught] == [LimitWarning]
    assert f'joint "hinge": {words}' in str(caught[0].message)
    found = scene.limits
    assert (found.lower[0], found.upper[0], found.velocity[0], found.effort[0]) == limits
    with pytest.raises(SceneError, match=f"{words}.*strict"):
        phipsi.Scene.from_urdf(arm(old, new), strict=True)


def test_a_scene_with_warnings_pickles_and_locks_in_silence() -> None:
    import pickle

    scene, _ = load(arm('lower="-1"', 'lower="2" odd="1"'))
    again = pickle.loads(pickle.dumps(scene))
    assert_same_bits(again.limits.upper, scene.limits.upper)
    assert scene.lock(["slide"], scene.neutral()).nv == 1


@pytest.mark.parametrize("length", ["1e200", "1e-200", "5e-324", "1.7e308", "1e-13"])
def test_an_axis_of_any_length(length: str) -> None:
    scene = phipsi.Scene.from_urdf(arm('"0 1 0"', f'"0 {length} 0"'))
    assert_same_bits(scene.mass_matrix([0.3, 0.2]), phipsi.Scene.from_urdf(ARM).mass_matrix([0.3, 0.2]))
    oblique = phipsi.Scene.from_urdf(arm('"0 1 0"', f'"{length} -{length} 0"'))
    expected = phipsi.Scene.from_urdf(arm('"0 1 0"', '"1 -1 0"'))
    np.testing.assert_allclose(oblique.mass_matrix([0.3, 0.2]), expected.mass_matrix([0.3, 0.2]), rtol=1e-13, atol=1e-15)


NO_ARMATURE = arm(' armature="0.3"', "")


def driven(actuator: str, around: str = "", **joint: str) -> str:
    """The arm without armature, with a transmission on its hinge."""
    kind = joint.get("kind", "<type>transmission_interface/SimpleTransmission</type>")
    name = joint.get("name", "hinge")
    transmission = f'<transmission name="t">{kind}<joint name="{name}"/>{around}<actuator name="m">{actuator}</actuator></transmission>'
    return NO_ARMATURE.replace("</robot>", transmission + "</robot>")


INERTIA, RATIO = '<drake:rotor_inertia value="2e-4"/>', '<drake:gear_ratio value="100"/>'


@pytest.mark.parametrize(
    ("text", "armature"),
    [
        (driven(INERTIA + RATIO), 2.0),
        (driven(INERTIA), 2e-4),
        (driven(RATIO), 0.0),
        (driven("<mechanicalReduction>100</mechanicalReduction>"), 0.0),
        (driven(INERTIA + "<mechanicalReduction>-100</mechanicalReduction>"), 2.0),
        (driven(INERTIA, "<mechanicalReduction>100</mechanicalReduction>"), 2.0),
        (driven(INERTIA + RATIO + "<mechanicalReduction>1</mechanicalReduction>"), 2.0),
        (driven("<motorInertia>2e-4</motorInertia><mechanicalReduction>100</mechanicalReduction>"), 2.0),
        (driven("<rotorInertia>2e-4</rotorInertia><gearRatio>100</gearRatio>"), 2.0),
        (driven("<drake:rotor_inertia>2e-4</drake:rotor_inertia>" + RATIO), 2.0),
        (driven(INERTIA + RATIO, kind=""), 2.0),
        (driven(INERTIA + RATIO).replace("<robot", '<robot xmlns:drake="http://drake.mit.edu"'), 2.0),
        (NO_ARMATURE.replace("</joint>", INERTIA + RATIO + "</joint>", 1), 2.0),
        (NO_ARMATURE.replace("</joint>", INERTIA + "</joint>", 1), 2e-4),
    ],
)
def test_rotor_inertia_is_armature(text: str, armature: float) -> None:
    scene = phipsi.Scene.from_urdf(text, strict=True)
    np.testing.assert_allclose(scene.armature, [armature, 0.0], rtol=1e-15)
    without = phipsi.Scene.from_urdf(NO_ARMATURE).mass_matrix([0.3, 0.2])
    np.testing.assert_allclose(scene.mass_matrix([0.3, 0.2]) - without, np.diag([armature, 0.0]), atol=1e-15)


@pytest.mark.parametrize(
    ("text", "armature", "words"),
    [
        (driven(INERTIA + RATIO, name="ghost"), 0.0, "one joint of this file"),
        (driven(INERTIA + RATIO, kind="<type>transmission_interface/DifferentialTransmission</type>"), 0.0, "one joint of this file"),
        (driven(INERTIA + RATIO, '<joint name="slide"/>'), 0.0, "one joint of this file"),
        (driven(INERTIA + RATIO + "<mechanicalReduction>7</mechanicalReduction>"), 2.0, "the gear ratio 100 is read"),
        (driven(INERTIA + RATIO).replace('friction="0.2"', 'armature="3"'), 3.0, "armature is given already"),
        (driven('<drake:rotor_inerta value="1"/>'), 0.0, "<drake:rotor_inerta> in <actuator>"),
        (driven('<darke:rotor_inertia value="1"/>'), 0.0, "<darke:rotor_inertia> in <actuator>"),
        (driven(INERTIA + '<drake:gear_rato value="1"/>'), 2e-4, "<drake:gear_rato> in <actuator>"),
        (NO_ARMATURE.replace("</joint>", '<drake:rotor_inerti value="1"/></joint>', 1), 0.0, "<drake:rotor_inerti> in <joint>"),
    ],
)
def test_rotor_inertia_that_is_not_read_is_told(text: str, armature: float, words: str) -> None:
    scene, caught = load(text)
    assert [one.category for one in caught] == [UnknownTagWarning]
    assert words in str(caught[0].message)
    np.testing.assert_allclose(scene.armature, [armature, 0.0], rtol=1e-15)


@pytest.mark.parametrize(
    ("actuator", "words"),
    [
        ("<drake:rotor_inertia/>", r'"" in <drake:rotor_inertia>.*a finite number'),
        ('<drake:rotor_inertia value="1 2"/>', r'"1 2" in <drake:rotor_inertia>'),
        ('<drake:rotor_inertia value="-1"/>', r"-1 in <drake:rotor_inertia>.*zero or positive"),
        ('<drake:rotor_inertia value="1e200"/><drake:gear_ratio value="1e200"/>', r'joint "hinge": found armature inf'),
        (INERTIA + '<drake:gear_ratio value="nan"/>', r'"nan" in <drake:gear_ratio>'),
        (INERTIA + "<mechanicalReduction>${r}</mechanicalReduction>", r"run xacro"),
    ],
)
def test_rotor_inertia_that_is_no_number_is_refused(actuator: str, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        phipsi.Scene.from_urdf(driven(actuator))


def test_a_joint_of_the_file_may_have_the_name_of_the_floating_base() -> None:
    text = ARM.replace('joint name="slide"', 'joint name="root_joint"')
    scene = phipsi.Scene.from_urdf(text, floating_base=True)
    assert scene.joint_names == ("root_joint_", "hinge", "root_joint")
    expected = phipsi.Scene.from_urdf(ARM, floating_base=True)
    q = expected.neutral()
    assert_same_bits(scene.mass_matrix(q), expected.mass_matrix(q))
    locked = scene.lock(["root_joint_"], q)
    assert locked.joint_names == ("hinge", "root_joint")
    assert locked.nv == 2
    assert scene.lock(["root_joint"], q).joint_names == ("root_joint_", "hinge")
    from phipsi.report.structure import tree_of

    assert list(tree_of(scene).joints) == ["root_joint_", "hinge", "root_joint"]


def test_what_floats_already_gets_no_floating_base() -> None:
    joint = '<link name="{0}"/><joint name="free" type="floating"><parent link="{0}"/><child link="base"/></joint></robot>'
    for root in ("world", "ground"):
        text = ARM.replace("</robot>", joint.format(root))
        assert phipsi.Scene.from_urdf(text).nv == 8
        with pytest.raises(SceneError, match=rf'root link "{root}": found joint "free".*floats already.*floating_base=False'):
            phipsi.Scene.from_urdf(text, floating_base=True)


def test_a_fixed_world_may_float() -> None:
    joint = '<link name="world"/><joint name="weld" type="fixed"><parent link="world"/><child link="base"/></joint></robot>'
    scene = phipsi.Scene.from_urdf(ARM.replace("</robot>", joint), floating_base=True)
    assert scene.nv == 8
    from phipsi.report.structure import tree_of

    assert tree_of(scene).mass == 3.0


def test_a_scene_without_mass_from_code_is_meant_so() -> None:
    builder = phipsi.SceneBuilder().link("base").link("rod").joint("hinge", "revolute", "base", "rod")
    assert builder.build(strict=True).nv == 1
