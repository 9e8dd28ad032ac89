"""A small robot as URDF, for tests that change one part of it."""

from __future__ import annotations

import warnings

import phipsi

ARM = """<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
<link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 0.1" rpy="0.1 0 0"/><mass value="1"/>
<inertia ixx="0.1" ixy="0.01" ixz="0.02" iyy="0.11" iyz="0.03" izz="0.12"/></inertial></link>
<link name="lower"><inertial><origin xyz="0 0 0.2"/><mass value="2"/>
<inertia ixx="0.2" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.2"/></inertial></link>
<joint name="hinge" type="revolute"><origin xyz="0 0 1" rpy="0 0.2 0"/><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="2" velocity="3"/>
<dynamics damping="0.1" friction="0.2" armature="0.3" stiffness="0.4" rest="0.5"/></joint>
<joint name="slide" type="prismatic"><parent link="upper"/><child link="lower"/><axis xyz="0 0 1"/></joint>
</robot>"""


def arm(old: str = "", new: str = "") -> str:
    """The arm with the first occurrence of a text replaced."""
    assert old in ARM, old
    return ARM.replace(old, new, 1)


def load(text: str, **options: object) -> tuple[phipsi.Scene, list[warnings.WarningMessage]]:
    """The scene of a text, and its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = phipsi.Scene.from_urdf(text, **options)  # type: ignore[arg-type]
    return scene, caught
