"""phipsi.load: files and texts of each kind, names of robot_descriptions, what it refuses."""

from __future__ import annotations

import sys
import types
from pathlib import Path

import numpy as np
import pytest
from mujoco_models import ARM

import phipsi
from phipsi.errors import ArgumentError, SceneError

XACRO = """<?xml version="1.0"?>
<robot name="rods" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="mass" default="2.0"/>
  <xacro:macro name="rod" params="name parent">
    <link name="${name}"><inertial><origin xyz="0 0 0.5"/><mass value="$(arg mass)"/>
      <inertia ixx="0.2" iyy="0.2" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="to_${name}" type="continuous"><parent link="${parent}"/><child link="${name}"/><axis xyz="0 1 0"/></joint>
  </xacro:macro>
  <link name="base"/>
  <xacro:rod name="first" parent="base"/>
  <xacro:rod name="second" parent="first"/>
</robot>
"""


@pytest.fixture
def xacro_file(tmp_path: Path) -> Path:
    pytest.importorskip("xacro")
    file = tmp_path / "rods.urdf.xacro"
    file.write_text(XACRO)
    return file


def test_a_urdf() -> None:
    assert phipsi.load(phipsi.BUNDLED_ARM).joint_names == phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM).joint_names
    assert phipsi.load(phipsi.BUNDLED_ARM, floating_base=True).nv == 12
    assert not np.any(phipsi.load(phipsi.BUNDLED_ARM, gravity=(0, 0, 0)).gravity)


def test_a_xacro(xacro_file: Path) -> None:
    scene = phipsi.load(xacro_file)
    assert scene.joint_names == ("to_first", "to_second")
    assert (scene.total_mass, scene.file) == (4.0, xacro_file)
    assert phipsi.load(str(xacro_file), xacro_arguments={"mass": 3}).total_mass == 6.0
    assert phipsi.load(XACRO).file is None


def test_shapes_of_a_xacro_are_written_back(xacro_file: Path) -> None:
    shape = '<visual><geometry><sphere radius="$(arg mass)"/></geometry></visual>'
    xacro_file.write_text(XACRO.replace("</inertial>", f"</inertial>{shape}"))
    assert phipsi.load(xacro_file).to_urdf().count('<sphere radius="2.0"') == 2


def test_what_xacro_has_expanded_is_a_urdf(monkeypatch: pytest.MonkeyPatch) -> None:
    """It may still name xacro, and have its elements in comments."""
    monkeypatch.setitem(sys.modules, "xacro", None)
    text = phipsi.BUNDLED_ARM.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', 1).replace("</robot>", "<!-- <xacro:arm/> --></robot>")
    assert phipsi.load(text).nv == 6


def test_a_xacro_that_cannot_be_expanded(xacro_file: Path) -> None:
    xacro_file.write_text(XACRO.replace("${name}", "${nome}"))
    with pytest.raises(SceneError, match="source: xacro cannot expand it: .*nome"):
        phipsi.load(xacro_file)


def test_a_xacro_without_the_package(xacro_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xacro", None)
    with pytest.raises(ImportError, match="pip install xacro"):
        phipsi.load(xacro_file)


def test_a_mujoco_model() -> None:
    pytest.importorskip("mujoco")
    assert phipsi.load(f"<!-- <robot/> -->{ARM}").joint_names[0] == "yaw"


@pytest.mark.parametrize("field", ["URDF_PATH", "MJCF_PATH"])
def test_a_name_of_robot_descriptions(field: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With modules that stand for the package's, which fetch robots from the network."""
    file = tmp_path / "robot.xml"
    file.write_text(phipsi.BUNDLED_ARM if field == "URDF_PATH" else ARM)
    package = types.ModuleType("robot_descriptions")
    package.__path__, package.__spec__ = [], types.SimpleNamespace()  # type: ignore[assignment]
    module = types.ModuleType("robot_descriptions.some_description")
    setattr(module, field, str(file))
    monkeypatch.setitem(sys.modules, "robot_descriptions", package)
    monkeypatch.setitem(sys.modules, "robot_descriptions.some_description", module)
    scene = phipsi.load("some_description")
    assert scene.file == file
    with pytest.raises(SceneError, match="'other_description'; expected a file, or a module of robot_descriptions"):
        phipsi.load("other_description")


def test_a_name_without_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("phipsi._load.find_spec", lambda name: None)
    with pytest.raises(ImportError, match="pip install robot_descriptions"):
        phipsi.load("ur5e_description")


def test_what_is_no_robot() -> None:
    with pytest.raises(ArgumentError, match="source: found int; expected a path of URDF"):
        phipsi.load(3)


def test_a_file_that_is_not_there() -> None:
    with pytest.raises(SceneError, match="'nowhere.urdf', which cannot be read"):
        phipsi.load("nowhere.urdf")


@pytest.mark.parametrize("given", [{"floating_base": True}, {"xacro_arguments": {"a": "b"}}])
def test_arguments_without_use(given: dict[str, object]) -> None:
    pytest.importorskip("mujoco")
    with pytest.raises(ArgumentError, match=f"(?s){next(iter(given))}: found .* which has no use for it"):
        phipsi.load(ARM, **given)  # type: ignore[arg-type]


def test_arguments_of_xacro_for_a_urdf() -> None:
    with pytest.raises(ArgumentError, match="xacro_arguments: found"):
        phipsi.load(phipsi.BUNDLED_ARM, xacro_arguments={"a": "b"})
