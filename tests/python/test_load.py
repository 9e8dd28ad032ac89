"""phipsi.load: files and texts of each format, names of robot_descriptions, refused sources."""

from __future__ import annotations

import pickle
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from mujoco_models import ARM

import phipsi
from phipsi.errors import ArgumentError, MeshWarning, SceneError

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


def with_shape(kind: str) -> str:
    shape = f'<{kind}><geometry><sphere radius="$(arg mass)"/></geometry></{kind}>'
    return XACRO.replace('<xacro:arg name="mass" default="2.0"/>', "").replace("</inertial>", f"</inertial>{shape}")


def test_shapes_of_a_xacro_with_arguments(xacro_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Shapes follow the arguments of load, also in another process."""
    xacro_file.write_text(with_shape("visual"))
    scenes = {mass: phipsi.load(xacro_file, xacro_arguments={"mass": mass}) for mass in ("3", "4")}
    monkeypatch.setattr("phipsi._xacro._arguments", {})
    for mass, scene in scenes.items():
        assert pickle.loads(pickle.dumps(scene)).to_urdf().count(f'<sphere radius="{mass}"') == 2


def test_collision_shapes_of_a_xacro_with_arguments(xacro_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without visual shapes the file is expanded again, or its shapes are omitted if the arguments are unknown."""
    xacro_file.write_text(with_shape("collision"))
    scene = phipsi.load(xacro_file, xacro_arguments={"mass": "3"})
    assert scene.to_urdf().count('<sphere radius="3"') == 2
    other = phipsi.load(xacro_file, xacro_arguments={"mass": "4"})
    with pytest.warns(MeshWarning, match="shapes of the xacro 'rods.urdf.xacro' are omitted, because .* it was read with different arguments"):
        assert "sphere" not in other.to_urdf()
    # Another process does not know them.
    monkeypatch.setattr("phipsi._xacro._arguments", {})
    with pytest.warns(MeshWarning, match="it needs arguments"):
        text = scene.to_urdf()
    assert phipsi.load(text).total_mass == 6.0


def test_what_xacro_has_expanded_is_a_urdf(monkeypatch: pytest.MonkeyPatch) -> None:
    """Expanded text may still contain the namespace, and xacro elements in comments."""
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
    """With substitutes for the modules of the package, which download robots."""
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
    with pytest.raises(ArgumentError, match="source: found int; expected a path or text of URDF"):
        phipsi.load(3)


def test_a_file_that_is_not_there() -> None:
    with pytest.raises(SceneError, match="'nowhere.urdf', which cannot be read"):
        phipsi.load("nowhere.urdf")


@pytest.mark.parametrize("given", [{"floating_base": True}, {"xacro_arguments": {"a": "b"}}])
def test_arguments_without_use(given: dict[str, object]) -> None:
    pytest.importorskip("mujoco")
    with pytest.raises(ArgumentError, match=f"(?s){next(iter(given))}: found .* which does not apply to"):
        phipsi.load(ARM, **given)  # type: ignore[arg-type]


def test_arguments_of_xacro_for_a_urdf() -> None:
    with pytest.raises(ArgumentError, match="xacro_arguments: found"):
        phipsi.load(phipsi.BUNDLED_ARM, xacro_arguments={"a": "b"})


def test_an_unknown_argument_of_xacro(xacro_file: Path) -> None:
    with pytest.raises(ArgumentError, match=r"xacro_arguments: found 'mas', which the file does not have; expected 'mass'\?"):
        phipsi.load(xacro_file, xacro_arguments={"mas": "3"})
    with pytest.raises(ArgumentError, match="found 'xyzzy', which the file does not have; expected names of 'mass'"):
        phipsi.load(XACRO, xacro_arguments={"xyzzy": "3"})
    with pytest.raises(ArgumentError, match="found 'mass', which the file does not have; expected none"):
        phipsi.load(XACRO.replace('<xacro:arg name="mass" default="2.0"/>', "").replace("$(arg mass)", "1"), xacro_arguments={"mass": "3"})
    # As with the ur_type of Universal Robots: the default names a file that does not exist.
    xacro_file.write_text(XACRO.replace('<link name="base"/>', '<xacro:arg name="kind" default="none"/><xacro:include filename="$(arg kind).xacro"/><link name="base"/>'))
    with pytest.raises(ArgumentError, match=r"xacro_arguments: found 'kin', which the file does not have; expected 'kind'\?"):
        phipsi.load(xacro_file, xacro_arguments={"kin": "x"})
    with pytest.raises(SceneError, match="xacro cannot expand it: .*none.xacro"):
        phipsi.load(xacro_file)


def test_an_argument_that_is_declared_where_it_is_not_needed(xacro_file: Path) -> None:
    """In a branch that is not evaluated, or in an included file."""
    branch = '<xacro:if value="false"><xacro:arg name="tool" default="none"/></xacro:if><xacro:include filename="more.xacro"/>'
    xacro_file.write_text(XACRO.replace('<link name="base"/>', f'<link name="base"/>{branch}'))
    (xacro_file.parent / "more.xacro").write_text('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="more" default="1"/></robot>')
    assert phipsi.load(xacro_file, xacro_arguments={"tool": "none", "more": "2"}).nv == 2


def test_a_missing_argument_of_xacro_is_named(xacro_file: Path) -> None:
    for inside in ("$(arg mass)", "${xacro.arg('mass')}"):
        text = XACRO.replace('<xacro:arg name="mass" default="2.0"/>', "").replace("$(arg mass)", inside)
        xacro_file.write_text(text)
        for source in (text, xacro_file):
            with pytest.raises(ArgumentError, match=r"xacro_arguments: found none for 'mass', which the file needs; expected xacro_arguments={'mass': \.\.\.}"):
                phipsi.load(source)


@pytest.mark.parametrize("variable", [None, "ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "package.xml", "above"])
def test_packages_are_found_without_ros(variable: str | None, xacro_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the file, above it, by its package.xml, and in folders of the environment."""
    for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)
    place = xacro_file.parent / "parts"
    if variable in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        elsewhere = xacro_file.parent / "elsewhere"
        place = elsewhere / ("parts" if variable == "ROS_PACKAGE_PATH" else "share/parts")
        monkeypatch.setenv(variable, f"/nowhere:{elsewhere}")
    elif variable == "package.xml":
        place = xacro_file.parent
        (place / "package.xml").write_text("<package><name>parts</name></package>")
    elif variable == "above":
        xacro_file = place / "robots" / xacro_file.name
        xacro_file.parent.mkdir(parents=True)
    place.mkdir(parents=True, exist_ok=True)
    (place / "mass.xacro").write_text('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="kilograms" value="5.0"/></robot>')
    include = '<xacro:include filename="$(find parts)/mass.xacro"/><link name="base"/>'
    xacro_file.write_text(XACRO.replace('<link name="base"/>', include).replace("$(arg mass)", "${kilograms}"))
    assert phipsi.load(xacro_file).total_mass == 10.0


def test_a_package_that_is_not_found(xacro_file: Path) -> None:
    text = XACRO.replace('<link name="base"/>', '<xacro:include filename="$(find parts)/mass.xacro"/><link name="base"/>')
    xacro_file.write_text(text)
    with pytest.raises(SceneError, match=r"found \$\(find parts\), and no folder 'parts' above or beside the file; expected .* ROS_PACKAGE_PATH or AMENT_PREFIX_PATH"):
        phipsi.load(xacro_file)
    with pytest.raises(SceneError, match="no folder 'parts' anywhere, as the source is text"):
        phipsi.load(text)
    # The packages of one file are not used for the next one.
    assert phipsi.load(XACRO).nv == 2


@pytest.mark.parametrize("source", [phipsi.BUNDLED_ARM, XACRO])
def test_parts_to_ignore_of_a_urdf(source: str) -> None:
    with pytest.raises(ArgumentError, match="ignore: found .* which does not apply to"):
        phipsi.load(source, ignore=["tendons"])


MACROS = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="size" value="1"/>
<!-- <xacro:macro name="former" params="x"></xacro:macro> -->
<xacro:macro name="inertia" params="m"><inertial><mass value="${m}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></xacro:macro>
<xacro:macro params="prefix parent:='a ${1 > 0}' hand:=^|true scale:=${1 + 2} *origin **blocks" name="arm"><link name="${prefix}"><xacro:inertia m="1"/></link></xacro:macro>
<xacro:macro name='tool'><link name="tool"/></xacro:macro></robot>"""


@pytest.mark.parametrize("included", [True, False])
def test_a_xacro_of_macros_names_them(tmp_path: Path, included: bool) -> None:
    """Macros that no other macro calls, with their parameters; also of an included file."""
    pytest.importorskip("xacro")
    file = tmp_path / "macros.xacro"
    file.write_text(MACROS, encoding="utf-8")
    if included:
        file = tmp_path / "robot.xacro"
        file.write_text('<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="macros.xacro"/></robot>', encoding="utf-8")
    with pytest.raises(SceneError) as found:
        phipsi.load(file)
    text = "a xacro that defines macros and no links; expected a file that includes it and calls one of them, as <xacro:arm .../>: "
    assert text + "arm(prefix, parent=..., hand=..., scale=..., *origin, **blocks); tool()" in str(found.value)
    assert "inertia" not in str(found.value) and "former" not in str(found.value)
    # A call of the macro works.
    calling = file.read_text(encoding="utf-8").replace("</robot>", '<xacro:arm prefix="p"><origin/><extra/></xacro:arm></robot>')
    file.write_text(calling, encoding="utf-8")
    assert phipsi.load(file).link_names == ("p",)


def test_a_xacro_without_macros_and_links() -> None:
    pytest.importorskip("xacro")
    with pytest.raises(SceneError, match="without links"):
        phipsi.load('<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="size" value="1"/></robot>')


@pytest.mark.parametrize(("name", "content"), [("part.stl", b"solid part\nendsolid"), ("PART.STL", bytes(84)), ("part.obj", b"v 0 0 0\n"), ("part.dae", b'<?xml version="1.0"?><COLLADA/>')])
def test_a_mesh_is_no_robot(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SceneError, match=rf"source: found '{name}', a mesh; expected a path .*SceneBuilder.link\(shape=phipsi.shapes.Mesh\(path\)\)"):
        phipsi.load(tmp_path / name)


def test_a_byte_order_mark_is_no_path() -> None:
    assert phipsi.load("\ufeff" + phipsi.BUNDLED_ARM).nv == 6
    assert phipsi.load("\ufeff" + phipsi.BUNDLED_ARM, contacts="plane").nv == 6


def test_a_part_of_a_mujoco_model() -> None:
    with pytest.raises(SceneError, match="found root element <mujocoinclude>; expected a whole robot: load an MJCF file that includes this one"):
        phipsi.load("<mujocoinclude/>")
    with pytest.raises(SceneError, match="only URDF is read, not MJCF; use phipsi.load in Python"):
        phipsi.Scene.from_urdf("<mujoco/>")


def test_text_that_is_no_robot(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello", encoding="utf-8")
    with pytest.raises(SceneError, match="expected XML with a <robot> element") as found:
        phipsi.load(tmp_path / "notes.txt")
    assert "from_urdf_file" not in str(found.value)
