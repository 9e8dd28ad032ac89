"""Unknown parts of a URDF: one warning that lists them with their lines, an error if strict."""

from __future__ import annotations

import re
import string
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from urdf_texts import ARM, arm, load

import phipsi
from phipsi.errors import PhipsiError, SceneError, UnknownTagWarning

MIMIC = arm('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><mimic joint="hinge" multiplier="2" offset="1"/>')


def told(text: str) -> str:
    """The only warning for a text, which must be an UnknownTagWarning, and an error if strict."""
    _, caught = load(text)
    assert [one.category for one in caught] == [UnknownTagWarning]
    with pytest.raises(SceneError, match="strict"):
        phipsi.Scene.from_urdf(text, strict=True)
    return str(caught[0].message)


CASES = {
    "attribute of robot": ('name="arm"', 'name="arm" gravity="1"', "attribute gravity of <robot>", "line 1"),
    "element of robot": ('<link name="base"/>', '<link name="base"/><loop_joint name="x"/>', "<loop_joint> in <robot>", "line 2"),
    "attribute of link": ('<link name="base"/>', '<link name="base" mass="1"/>', 'attribute mass of link "base"', "line 2"),
    "element of link": ('<link name="base"/>', '<link name="base"><inertal/></link>', '<inertal> in link "base"', "<inertial>?"),
    "attribute of inertial": ("<inertial>", '<inertial mass="1">', 'attribute mass of <inertial> of link "upper"', "is an element"),
    "element of inertial": ("<inertial>", "<inertial><com/>", '<com> in <inertial> of link "upper"', "line 3"),
    "attribute of mass": ('value="1"', 'value="1" unit="lb"', 'attribute unit of <mass> of link "upper"', "line 3"),
    "attribute of inertia": ('ixx="0.1"', 'ixx="0.1" iyx="1"', 'attribute iyx of <inertia> of link "upper"', "line 4"),
    "attribute of origin": ('rpy="0 0.2 0"', 'ryp="0 0.2 0"', 'attribute ryp of <origin> of joint "hinge"', "rpy?"),
    "attribute of joint": ('type="revolute"', 'type="revolute" parent="x"', 'attribute parent of joint "hinge"', "line 7"),
    "element of joint": ("</joint>", "<spring/></joint>", '<spring> in joint "hinge"', "line 9"),
    "attribute of parent": ('<parent link="base"', '<parent link="base" xyz="0 0 1"', 'attribute xyz of <parent> of joint "hinge"', ""),
    "attribute of child": ('<child link="upper"', '<child link="upper" name="x"', 'attribute name of <child> of joint "hinge"', ""),
    "attribute of axis": ('<axis xyz="0 1 0"', '<axis xzy="0 1 0"', 'attribute xzy of <axis> of joint "hinge"', "xyz?"),
    "attribute of limit": ('lower="-1"', 'lowr="-1"', 'attribute lowr of <limit> of joint "hinge"', "lower?"),
    "attribute of dynamics": ('armature="0.3"', 'amature="0.3"', 'attribute amature of <dynamics> of joint "hinge"', "armature?"),
    "capitals": ('damping="0.1"', 'Damping="0.1"', "attribute Damping of <dynamics>", "damping?"),
    "an attribute as an element": (
        '<dynamics damping="0.1"',
        '<dynamics friction="0"><damping>1</damping></dynamics><material a="1"',
        '<damping> in <dynamics> of joint "hinge"',
        'an attribute: <dynamics damping="..."',
    ),
    "text for an attribute": ('<axis xyz="0 1 0"/>', "<axis>0 1 0</axis>", 'text "0 1 0" in <axis> of joint "hinge"', "line 8"),
    "text astray": ("</joint>", "</joint>/>", 'text "/>" in <robot>', "line 9"),
    "a second inertial": ("</inertial>", '</inertial><inertial><mass value="3"/></inertial>', "a second <inertial>", "first is read"),
    "a second axis": ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><axis xyz="1 0 0"/>', 'a second <axis> in joint "hinge"', "line 8"),
    "a joint of Drake": ("</robot>", '<drake:joint name="x"/></robot>', "<drake:joint> in <robot>", "line 11"),
    **{
        f"Gazebo's {name}": ("</robot>", f'<gazebo reference="upper"><{name}>{value}</{name}></gazebo></robot>', f'<{name}> in <gazebo> of "upper"', "line 11")
        for name, value in (("turnGravityOff", " true "), ("gravity", "0"), ("kinematic", "1"), ("springStiffness", "3e2"), ("dampingFactor", "0.1"))
    },
    "a joint of Gazebo": ("</robot>", '<gazebo><static>true</static><joint name="loop"><parent>base</parent></joint></gazebo></robot>', "<joint> in <gazebo> of <robot>", "<static> in"),
    "Bullet's factor": (
        '<link name="base"/>',
        '<link name="base"><contact><inertia_scaling value="3"/></contact></link>',
        "<inertia_scaling> in <contact>",
        "line 2",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_what_is_not_understood_is_listed_with_its_place(name: str) -> None:
    old, new, what, more = CASES[name]
    message = told(arm(old, new))
    assert message.startswith("URDF: ")
    assert what in message
    assert more in message


def test_the_dynamics_of_pandas_file() -> None:
    message = told(arm('damping="0.1" friction="0.2"', 'D="1" K="7000" mu_coulomb="0" mu_viscous="16"'))
    for name in ("D", "K", "mu_coulomb", "mu_viscous"):
        assert f'attribute {name} of <dynamics> of joint "hinge" (line 9' in message


def test_many_findings_are_one_short_warning() -> None:
    message = told(arm("</robot>", "".join(f"<odd{k}/>" for k in range(1000)) + "</robot>"))
    assert "<odd0> in <robot>" in message
    assert "and 988 more" in message
    assert len(message) < 1000


def test_findings_of_one_kind_leave_room_for_others() -> None:
    links = "".join(f'<link name="l{k}"><odd/></link>' for k in range(20))
    joints = "".join(f'<joint name="j{k}" type="fixed"><parent link="base"/><child link="l{k}"/></joint>' for k in range(20))
    message = told(arm("</robot>", links + joints + "<other/></robot>"))
    assert '<odd> in link "l2"' in message
    assert '"l3"' not in message
    assert "<other> in <robot>" in message
    assert message.endswith("and 17 more")


def test_a_file_is_named_and_lines_are_counted_from_its_top(tmp_path: object) -> None:
    path = str(tmp_path) + "/odd.urdf"
    with open(path, "w", encoding="utf-8") as file:
        file.write("\n\n" + arm("</robot>", "<odd/></robot>"))
    with pytest.warns(UnknownTagWarning, match=rf"{re.escape(path)}.*<odd> in <robot> \(line 13\)") as caught:
        phipsi.Scene.from_urdf(path)
    assert caught[0].filename == __file__
    with pytest.warns(UnknownTagWarning, match=r"line 13"):
        phipsi.Scene.from_urdf("\n\n" + arm("</robot>", "<odd/></robot>"))


QUIET = {
    "robot": ('name="arm"', 'name="arm" version="1.0" verbose="true"'),
    "links of old": ('<link name="base"/>', '<link name="base" type="laser"/>'),
    "looks": (
        '<link name="base"/>',
        '<link name="base"><visual><origin xyz="a"/><odd/>text</visual><collision verbose="1" odd="1"/><visual/><sensor/></link>',
    ),
    "other programs": (
        "</robot>",
        '<gazebo reference="base"><odd/><turnGravityOff>false</turnGravityOff><gravity>1</gravity><gravity/><springStiffness>0.0</springStiffness>'
        '<mu1>3</mu1><plugin><joint>hinge</joint></plugin></gazebo><gazebo/><transmission name="t"><odd/></transmission><material name="m"/>'
        '<ros2_control name="c" type="system"><hardware/></ros2_control><sensor name="s"/></robot>',
    ),
    "in a joint": ("</joint>", '<safety_controller k_velocity="1"/><calibration rising="0"/><gazebo/></joint>'),
    "expressions where nothing is read": (
        '<link name="base"/>',
        '<link name="base"><visual><geometry><mesh filename="$(find x)/y.stl"/></geometry><xacro:a/></visual></link>',
    ),
    "undeclared prefixes": (
        "</robot>",
        '<gazebo><sensor:camera name="c"><a gz:type="b"/></sensor:camera></gazebo><controller:x/></robot>',
    ),
    "undeclared prefixes of attributes": ('<link name="base"/>', '<link gz:type="x" name="base"/>'),
    "declared prefixes": ("</robot>", '<o:odd xmlns:o="urn:o" o:a="1"><link/></o:odd></robot>'),
    "comments": ("</robot>", "<!-- a -- b ---></robot>"),
}


@pytest.mark.parametrize("name", QUIET)
def test_what_never_enters_the_dynamics_is_quiet(name: str) -> None:
    text = arm(*QUIET[name])
    scene = phipsi.Scene.from_urdf(text, strict=True)
    q = [0.3, 0.2]
    np.testing.assert_array_equal(scene.mass_matrix(q), phipsi.Scene.from_urdf(ARM).mass_matrix(q))


def spans() -> list[tuple[int, int, str]]:
    """Position of each name of an element (in its opening tag) or attribute that is read."""
    assert ElementTree.fromstring(MIMIC) is not None
    found = []
    for match in re.finditer(r"<(\w+)|\s([a-z]+)=", MIMIC):
        group = 1 if match[1] else 2
        if match[group] not in ("robot", "name"):
            found.append((*match.span(group), match[group]))
    return found


@pytest.mark.parametrize(("start", "end", "name"), spans())
@pytest.mark.parametrize("kind", ["left out", "put in", "changed", "capital"])
def test_no_misspelling_passes_in_silence(start: int, end: int, name: str, kind: str) -> None:
    for at in range(len(name)):
        letter = string.ascii_lowercase[(string.ascii_lowercase.index(name[at]) + 7) % 26]
        changed = {"left out": "", "put in": name[at] + letter, "changed": letter, "capital": name[at].upper()}[kind]
        misspelt = name[:at] + changed + name[at + 1 :]
        if not misspelt:
            continue
        text = MIMIC[:start] + misspelt + MIMIC[end:]
        if MIMIC[start - 1] == "<":
            # The closing tag too, if the element has one.
            close = MIMIC.find(f"</{name}>", end)
            opening = MIMIC[end : MIMIC.index(">", end)]
            if close >= 0 and not opening.endswith("/"):
                text = MIMIC[:start] + misspelt + MIMIC[end:close] + f"</{misspelt}>" + MIMIC[close + len(name) + 3 :]
        try:
            _, caught = load(text)
        except PhipsiError:
            continue
        assert UnknownTagWarning in {one.category for one in caught}, misspelt
