"""Scenes from URDF: supported sources, and the interface of the reader in Python."""

from __future__ import annotations

import os
import pathlib
import warnings

import numpy as np
import pytest
from tolerances import assert_same_bits

import phipsi
from phipsi.errors import ArgumentError, InertiaWarning, MimicWarning, NotFiniteError, SceneError, ShapeError

INERTIAL = '<inertial><mass value="1"/><origin xyz="0 0 {z}"/><inertia ixx="{i}" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'


def robot(*, i: float = 1.0, mimic: str = "") -> str:
    """A shoulder, an elbow, and a tool on a fixed joint."""
    links = "".join(f'<link name="{name}">{INERTIAL.format(z=z, i=i)}</link>' for z, name in enumerate(("arm", "fore", "tool")))
    return f"""<robot name="two">
      <link name="base"/>{links}
      <joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
        <limit lower="-1" upper="2" effort="30" velocity="4"/></joint>
      <joint name="elbow" type="continuous"><parent link="arm"/><child link="fore"/>
        <origin xyz="0 0 1" rpy="0.1 0.2 0.3"/><axis xyz="0 1 0"/>{mimic}</joint>
      <joint name="weld" type="fixed"><parent link="fore"/><child link="tool"/><origin xyz="0 0 0.5"/></joint>
    </robot>"""


@pytest.fixture
def file(tmp_path: pathlib.Path) -> pathlib.Path:
    path = tmp_path / "рука <1>.urdf"
    path.write_text(robot(), encoding="utf-8")
    return path


def test_every_kind_of_source_gives_the_same_scene(file: pathlib.Path) -> None:
    class Like(os.PathLike[str]):
        def __fspath__(self) -> str:
            return str(file)

    text = robot()
    declared = '<?xml version="1.0"?>' + text
    expected = phipsi.Scene.from_urdf(text)
    for source in (file, str(file), Like(), "\n\t " + text, "\ufeff" + text, "\ufeff\n" + text, declared, "\n" + declared):
        scene = phipsi.Scene.from_urdf(source)
        assert scene.joint_names == expected.joint_names == ("shoulder", "elbow")
        assert_same_bits(scene.mass_matrix([0.1, 0.2]), expected.mass_matrix([0.1, 0.2]))


def test_keywords() -> None:
    scene = phipsi.Scene.from_urdf(robot(), floating_base=True, gravity=[1, 2, 3], strict=True)
    assert scene.joint_names == ("root_joint", "shoulder", "elbow")
    np.testing.assert_array_equal(scene.gravity, [1, 2, 3])
    assert scene.link_names == ("base", "arm", "fore", "tool")
    assert scene.body_names == ("base", "arm", "fore")
    np.testing.assert_array_equal(scene.limits.upper[6:], [2, np.inf])
    np.testing.assert_array_equal(scene.limits.effort[6:], [30, np.inf])
    with pytest.raises(TypeError):
        phipsi.Scene.from_urdf(robot(), True)  # type: ignore[misc]


def test_a_scene_has_no_constructor() -> None:
    with pytest.raises(TypeError):
        phipsi.Scene()


@pytest.mark.parametrize("source", [3, None, b"<robot/>", ["a.urdf"]])
def test_other_sources_are_refused(source: object) -> None:
    with pytest.raises(ArgumentError, match="source: found an object of type .*; expected a path"):
        phipsi.Scene.from_urdf(source)  # type: ignore[arg-type]


def test_files_that_cannot_be_read_are_named(tmp_path: pathlib.Path) -> None:
    for path in (tmp_path / "none.urdf", tmp_path):
        with pytest.raises(SceneError, match=path.name):
            phipsi.Scene.from_urdf(path)
    binary = tmp_path / "binary.urdf"
    binary.write_bytes(b"\xff\xfe\x00<robot>")
    with pytest.raises(SceneError):
        phipsi.Scene.from_urdf(binary)


@pytest.mark.parametrize("text", ["<", "<robot", "<robot name='x'/>", "<sdf/>", "<robot><link/></robot>", "<a>\0</a>"])
def test_text_that_is_no_robot(text: str) -> None:
    with pytest.raises(SceneError):
        phipsi.Scene.from_urdf(text)


def test_gravity_is_checked_by_name() -> None:
    with pytest.raises(ShapeError, match=r"gravity: found shape \(1,\); expected \(3,\)"):
        phipsi.Scene.from_urdf(robot(), gravity=[9.81])
    with pytest.raises((SceneError, NotFiniteError), match="gravity"):
        phipsi.Scene.from_urdf(robot(), gravity=[0, 0, np.nan])


def test_warnings_point_at_the_caller_and_strict_raises() -> None:
    with pytest.warns(InertiaWarning) as caught:
        scene = phipsi.Scene.from_urdf(robot(i=7.0))
    assert {warning.filename for warning in caught} == {__file__}
    assert [str(warning.message).split(":")[0] for warning in caught] == ['link "arm"', 'link "fore"', 'link "tool"']
    with pytest.raises(SceneError, match='link "arm"'):
        phipsi.Scene.from_urdf(robot(i=7.0), strict=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene.lock(["elbow"], scene.neutral())


def test_mimic_joints_stay_free_with_a_warning() -> None:
    with pytest.warns(MimicWarning, match='joint "elbow": mimics "shoulder"'):
        scene = phipsi.Scene.from_urdf(robot(mimic='<mimic joint="shoulder" multiplier="2"/>'))
    assert scene.nv == 2
