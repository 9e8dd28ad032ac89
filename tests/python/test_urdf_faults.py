"""Documents that deviate from URDF: accepted if they are unambiguous, otherwise an error with a suggestion."""

from __future__ import annotations

import re

import numpy as np
import pytest
from urdf_texts import ARM, arm

import phipsi
from phipsi.errors import SceneError

SAME = {
    "a declaration after a comment": ("<robot", "<!-- by hand -->\n<?xml version='1.0'?>\n<robot"),
    "two declarations": ("<robot", "<?xml version='1.0'?>\n<?xml version='1.0'?>\n<robot"),
    "dashes in a comment": ('<link name="base"/>', '<!-- -- base -- --- <link/> & ---><link name="base"/>'),
    "an undeclared prefix": ("</robot>", "<gazebo><sensor:camera>a<b/></sensor:camera></gazebo></robot>"),
    "an undeclared prefix on an attribute": ("</robot>", '<gazebo gz:type="a:b"/></robot>'),
    "all at once": ("<robot", "<!-- -- -->\n<?xml version='1.0'?>\n<robot a:b='>'"),
    "a byte order mark": ("<robot", "\ufeff\n<?xml version='1.0'?>\n<robot"),
    "a document type": ("<robot", "<!DOCTYPE robot>\n<robot"),
}


@pytest.mark.parametrize("name", SAME)
def test_accepted_as_other_programs_do(name: str) -> None:
    scene = phipsi.Scene.from_urdf(arm(*SAME[name]), strict=True)
    np.testing.assert_array_equal(scene.mass_matrix([0.3, 0.2]), phipsi.Scene.from_urdf(ARM).mass_matrix([0.3, 0.2]))


REFUSED = {
    "a bare &": ('name="base"', 'name="a & b"', r"line 2, column 15: found a bare &; expected &amp; in its place"),
    "an unknown entity": ('name="base"', 'name="a&b;"', r"line 2, column \d+: found &b;.*&amp;"),
    "a bare <": ('name="base"', 'name="a<b"', r"line 2, column \d+: found a bare <.*; expected &lt; in its place"),
    "a prefix on what is read": ("<link ", "<a:link ", r"line 2, column 2: found <a:link>.*'a' is not declared; expected <link>"),
    "after what was restated": ("<robot", "<!-- -- --><robot a:b='1'><link></robot><robot", r"line 1, column 33"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_with_what_to_change(name: str) -> None:
    old, new, message = REFUSED[name]
    with pytest.raises(SceneError, match=message):
        phipsi.Scene.from_urdf(arm(old, new))


XACRO = {
    "an element of robot": ("</robot>", '<xacro:include filename="a"/></robot>', "<xacro:include>"),
    "an element of link": ('<link name="base"/>', '<link name="base"><xacro:inertia m="1"/></link>', "<xacro:inertia>"),
    "an element of inertial": ("<inertial>", "<inertial><xacro:if/>", "<xacro:if>"),
    "an element of joint": ("</joint>", "<xacro:if value='1'/></joint>", "<xacro:if>"),
    "a mass": ('value="1"', 'value="${m}"', re.escape('"${m}" in value of <mass>')),
    "a name": ('<link name="base"/>', '<link name="${prefix}base"/>', re.escape('"${prefix}base" in name of <link>')),
    "a parent": ('<parent link="base"', '<parent link="${p}base"', re.escape("${p}base")),
    "an axis": ('"0 1 0"', '"0 $(arg y) 0"', re.escape("$(arg y)")),
    "a limit": ('effort="2"', 'effort="${2*pi}"', re.escape("${2*pi}")),
    "a multiplier": ("</joint>", '<mimic joint="slide" multiplier="${2}"/></joint>', "multiplier of <mimic>"),
    "a text": ("<inertial>", "<inertial>${a}", "text of <inertial>"),
    "an unknown element": ("</robot>", '<include filename="$(find a)/b"/></robot>', "filename of <include>"),
    "the name of robot": ('name="arm"', 'name="$(arg name)"', "name of <robot>"),
}


@pytest.mark.parametrize("name", XACRO)
def test_what_xacro_would_have_replaced(name: str) -> None:
    old, new, message = XACRO[name]
    with pytest.raises(SceneError, match=message) as caught:
        phipsi.Scene.from_urdf(arm(old, new))
    for part in ("URDF, line ", "xacro in.xacro > out.urdf", "pip install xacro"):
        assert part in str(caught.value)


def test_xacro_without_its_declaration() -> None:
    with pytest.raises(SceneError, match=r"line 2, column 1: found <xacro:a>.*run xacro"):
        phipsi.Scene.from_urdf("<robot>\n<xacro:a/></robot>")


@pytest.mark.parametrize(("root", "words"), [("mujoco", "MJCF"), ("sdf", "SDF"), ("world", "SDF"), ("model", "SDF")])
def test_other_formats(root: str, words: str) -> None:
    with pytest.raises(SceneError, match=f"root element <{root}>.*<robot>.*{words}.*convert it to URDF.*SceneBuilder"):
        phipsi.Scene.from_urdf(f"<{root}/>")


def test_a_robot_without_links_says_what_was_not_understood() -> None:
    with pytest.raises(SceneError, match=r"without links; not understood: <Link> in <robot> \(line 1; is it <link>\?\)"):
        phipsi.Scene.from_urdf('<robot><Link name="a"/></robot>')


def test_a_misspelt_joint_is_told_where_the_tree_falls_apart() -> None:
    text = arm('<joint name="slide"', '<jiont name="slide"').replace("</joint>\n</robot>", "</jiont>\n</robot>")
    with pytest.raises(SceneError, match=r'link "lower": found a second root.*<jiont> in <robot> \(line 10; is it <joint>\?\)'):
        phipsi.Scene.from_urdf(text)


def test_a_parent_world_that_is_not_declared() -> None:
    with pytest.raises(SceneError, match=r'joint "hinge": found parent link "world".*<link name="world"/> in the file'):
        phipsi.Scene.from_urdf(arm('<parent link="base"/>', '<parent link="world"/>'))


def test_numbers_in_messages_are_short() -> None:
    for old, new in [('value="1"', 'value="-1e200"'), ('armature="0.3"', 'armature="-1e-200"')]:
        with pytest.raises(SceneError, match="-1e") as caught:
            phipsi.Scene.from_urdf(arm(old, new))
        assert len(str(caught.value)) < 120
