"""Scenes from URDF: supported sources, and the interface of the reader in Python."""

from __future__ import annotations

import os
import pathlib
import pickle
import warnings

import numpy as np
import pytest
from tolerances import assert_near, assert_same_bits, product

import phipsi
from phipsi.errors import ArgumentError, InertiaWarning, LimitWarning, MimicWarning, NotFiniteError, SceneError, ShapeError

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


BOUNDS = 'lower="-1" upper="2" effort="30" velocity="4"'
QUATERNION = 'quat_xyzw="0.2 -0.4 0.4 0.8"'
#: Rotation of QUATERNION: Rodrigues' formula for the axis (1, -2, 2) / 3 and cos(angle / 2) = 0.8.
AXIS = np.array([1.0, -2.0, 2.0]) / 3.0
CROSS = np.array([[0.0, -AXIS[2], AXIS[1]], [AXIS[2], 0.0, -AXIS[0]], [-AXIS[1], AXIS[0], 0.0]])
ROTATION = np.eye(3) + 0.96 * CROSS + (1.0 - 0.28) * CROSS @ CROSS


def of_version(version: str | None, *, origin: str = "", limit: str = BOUNDS, kind: str = "revolute", inertial: str = "") -> str:
    """A robot with one joint, in a version of URDF."""
    declared = "" if version is None else f'version="{version}"'
    return f"""<robot name="one" {declared}><link name="base"/>
      <link name="arm"><inertial><origin xyz="0.1 0.2 0.3" {inertial}/><mass value="2"/><inertia ixx="1" ixy="0.1" ixz="0" iyy="1.2" iyz="0" izz="1.5"/></inertial></link>
      <joint name="hinge" type="{kind}"><parent link="base"/><child link="arm"/><origin xyz="1 2 3" {origin}/><axis xyz="0 1 0"/><limit {limit}/></joint></robot>"""


@pytest.mark.parametrize("version", ["1.1", "1.2"])
def test_quaternions_of_origins(version: str) -> None:
    scene = phipsi.Scene.from_urdf(of_version(version, origin=QUATERNION, inertial=QUATERNION), strict=True)
    assert_near(scene.joint("hinge").rotation, ROTATION, product(3, 1.0))
    given = np.array([[1.0, 0.1, 0.0], [0.1, 1.2, 0.0], [0.0, 0.0, 1.5]])
    assert_near(scene.link("arm").inertia, ROTATION @ given @ ROTATION.T, product(9, 1.5))


@pytest.mark.parametrize(
    ("version", "origin", "message"),
    [
        (None, QUATERNION, r'joint "hinge": found quat_xyzw in <origin> of a file of version 1.0; expected <robot version="1.1">, or the rotation as rpy'),
        ("1.0", QUATERNION + ' rpy="0 0 0"', "quat_xyzw in <origin> of a file of version 1.0"),
        ("1.1", QUATERNION + ' rpy="0 0 0"', 'joint "hinge": found rpy and quat_xyzw in <origin>; expected one of them'),
        ("1.2", 'quat_xyzw="0 0 1"', 'found "0 0 1" in quat_xyzw of <origin>; expected four numbers'),
        ("1.2", 'quat_xyzw="0 0 0 0"', 'found "0 0 0 0" in quat_xyzw of <origin>; expected a quaternion x y z w of norm 1'),
        ("1.2", 'quat_xyzw="0 0 nan 1"', "expected a quaternion x y z w of norm 1"),
    ],
)
def test_quaternions_that_are_no_rotation(version: str | None, origin: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        phipsi.Scene.from_urdf(of_version(version, origin=origin))


@pytest.mark.parametrize("version", ["1.3", "2.0", "1", "1.0.0", "1.0~pre6", ""])
def test_unknown_versions(version: str) -> None:
    with pytest.raises(SceneError, match=f'URDF: found version "{version}" of <robot>; expected one of the versions 1.0, 1.1, 1.2, or no version'):
        phipsi.Scene.from_urdf(of_version(version))


#: Acceleration, deceleration and jerk in a Joint.
LIMITS = slice(phipsi.Joint._fields.index("acceleration"), phipsi.Joint._fields.index("jerk") + 1)


@pytest.mark.parametrize(
    ("attributes", "expected"),
    [
        ('acceleration="10" deceleration="5" jerk="200"', (10.0, 5.0, 200.0)),
        ('acceleration="10"', (10.0, 10.0, np.inf)),
        ('deceleration="5"', (np.inf, 5.0, np.inf)),
        ("", (np.inf, np.inf, np.inf)),
    ],
)
def test_limits_of_acceleration_and_jerk(attributes: str, expected: tuple[float, ...]) -> None:
    """Of URDF 1.2, where a deceleration that is not given is limited as the acceleration is; ignored with a warning in older files."""
    scene = phipsi.Scene.from_urdf(of_version("1.2", limit=f"{BOUNDS} {attributes}"), strict=True)
    assert scene.joint("hinge")[LIMITS] == expected
    assert tuple(float(limit[0]) for limit in scene.limits) == (-1.0, 2.0, 4.0, 30.0, *expected)
    again = phipsi.Scene.from_urdf(scene.to_urdf(), strict=True)
    assert (again.joint("hinge")[LIMITS], pickle.loads(pickle.dumps(scene)).limits) == (expected, scene.limits)
    assert scene.to_builder().build().joint("hinge")[LIMITS] == expected
    if attributes:
        older = of_version("1.1", limit=f"{BOUNDS} {attributes}")
        with pytest.warns(LimitWarning, match=r'joint "hinge": \w+ [0-9]+, which requires <robot version="1.2">'):
            scene = phipsi.Scene.from_urdf(older)
        assert scene.joint("hinge")[LIMITS] == (np.inf, np.inf, np.inf)
        with pytest.raises(SceneError, match='which requires <robot version="1.2">'):
            phipsi.Scene.from_urdf(older, strict=True)


@pytest.mark.parametrize(
    ("version", "limit", "bounds", "message"),
    [
        ("1.1", 'lower="-1"', (-1.0, 0.0), None),
        ("1.2", 'lower="-1"', (-1.0, np.inf), "no upper, which URDF 1.2 requires"),
        ("1.2", "", (-np.inf, np.inf), "no lower, which URDF 1.2 requires, no upper, which URDF 1.2 requires"),
        ("1.2", BOUNDS + ' jerk="-1"', (-1.0, 2.0), "jerk -1 below zero"),
    ],
)
def test_bounds_by_version(version: str, limit: str, bounds: tuple[float, float], message: str | None) -> None:
    text = of_version(version, limit=limit)
    if message is None:
        scene = phipsi.Scene.from_urdf(text, strict=True)
    else:
        with pytest.warns(LimitWarning, match=message):
            scene = phipsi.Scene.from_urdf(text)
    assert (scene.joint("hinge").lower, scene.joint("hinge").upper, scene.joint("hinge").jerk) == (*bounds, np.inf)


@pytest.mark.parametrize("version", [None, "1.0", "1.1", "1.2", "1.3", "2.0", "1", "1.0.0", "1.0~pre6", ""])
@pytest.mark.parametrize("origin", ['rpy="0.1 0.2 0.3"', QUATERNION, QUATERNION + ' rpy="0 0 0"', 'quat_xyzw="0 0 1"', 'quat_xyzw="0 0 a 1"'])
def test_urdfdom_reads_the_same_versions(version: str | None, origin: str) -> None:
    """With the same rotation, except that urdfdom ignores quaternions in files of version 1.0, which phipsi refuses."""
    pin = pytest.importorskip("pinocchio", minversion="4.1")
    text = of_version(version, origin=origin)
    if version in (None, "1.0") and "quat_xyzw" in origin:
        with pytest.raises(SceneError):
            phipsi.Scene.from_urdf(text)
        return
    try:
        model = pin.buildModelFromXML(text)
    except ValueError:
        with pytest.raises(SceneError):
            phipsi.Scene.from_urdf(text)
        return
    assert_near(phipsi.Scene.from_urdf(text).joint("hinge").rotation, model.jointPlacements[1].rotation, product(9, 1.0))


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_joints_whose_limits_are_all_zero(kind: str) -> None:
    """As exporters write limits that were not entered."""
    zero = 'lower="0" upper="0" effort="0" velocity="0"'
    with pytest.warns(LimitWarning, match='^joint "hinge" with limits of zero for lower, upper, effort and velocity: locked in simulations; .*remove <limit>'):
        scene = phipsi.Scene.from_urdf(of_version(None, limit=zero, kind=kind))
    assert scene.joint("hinge").upper == 0.0
    with pytest.raises(SceneError, match="limits: found joint .hinge. with limits .* expected joints that can move"):
        phipsi.Scene.from_urdf(of_version(None, limit=zero, kind=kind), strict=True)
    for other in ('effort="0" velocity="0"', 'lower="0" upper="0" effort="1" velocity="0"'):
        phipsi.Scene.from_urdf(of_version(None, limit=other, kind=kind), strict=True)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e6])
def test_inertias_far_too_large_for_their_mass(unit: float) -> None:
    """In kg mm^2 in place of kg m^2: a radius of gyration of 1,000 times that of the body."""
    text = robot().replace('ixx="1.0"', f'ixx="{unit}"').replace('iyy="1"', f'iyy="{unit}"').replace('izz="1"', f'izz="{unit}"')
    if unit < 1e3:
        phipsi.Scene.from_urdf(text, strict=True)
        return
    with pytest.warns(InertiaWarning, match=r'^link "(arm|fore|tool)": radius of gyration 1\.225e3 m, \d+ times the size of the scene') as caught:
        phipsi.Scene.from_urdf(text)
    assert [str(warning.message).split('"')[1] for warning in caught] == ["arm", "fore", "tool"]
    with pytest.raises(SceneError, match="radius of gyration .*expected an inertia about the center of mass in kg m"):
        phipsi.Scene.from_urdf(text, strict=True)
