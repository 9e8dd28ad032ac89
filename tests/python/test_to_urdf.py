"""Scenes as URDF: reading the file gives an equal scene, and features that URDF cannot represent are refused by
name.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import phipsi
import pytest
from conftest import random_scene
from phipsi._pose import angles, from_rpy
from phipsi.errors import ArgumentError, ModelWarning
from tolerances import EPS, assert_near, assert_same_bits, product, size

KINDS = ("revolute", "continuous", "prismatic", "planar", "spherical", "floating", "fixed")


@pytest.mark.parametrize("floating", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_a_random_tree_comes_back(seed: int, floating: bool) -> None:
    scene = random_scene(seed, 9, kinds=KINDS, armature=0.1, floating_base=floating)
    if floating:
        scene = scene.with_properties(armature={scene.joint_names[0]: 0.0})
    back = phipsi.Scene.from_urdf(scene.to_urdf(), floating_base=floating, gravity=scene.gravity)
    assert back.joint_names == scene.joint_names and back.link_names == scene.link_names
    random = np.random.default_rng(seed)
    q = scene.integrate(scene.neutral(), random.uniform(-1, 1, scene.nv))
    qd, qdd = random.uniform(-1, 1, (2, scene.nv))
    for one, other in ((scene.mass_matrix(q), back.mass_matrix(q)), (scene.inverse_dynamics(q, qd, qdd), back.inverse_dynamics(q, qd, qdd))):
        assert_near(other, one, product(64 * scene.nv, size(one)))
    for name, joint in scene.joints.items():
        again = back.joints[name]
        assert_same_bits(np.array([again.armature, again.damping, again.friction]), np.array([joint.armature, joint.damping, joint.friction]))


def test_the_bundled_arm_comes_back_whole(tmp_path: Path) -> None:
    """Limits, losses and names are bitwise equal, rotations up to rounding; a second export is equal to the first."""
    scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
    text = scene.to_urdf(tmp_path / "arm.urdf", name="arm & <hand>")
    assert (tmp_path / "arm.urdf").read_text(encoding="utf-8") == text
    back = phipsi.Scene.from_urdf(tmp_path / "arm.urdf")
    for name, joint in scene.joints.items():
        again = back.joints[name]
        assert (again.type, again.parent, again.child) == (joint.type, joint.parent, joint.child)
        for field in ("lower", "upper", "velocity", "effort", "acceleration", "deceleration", "jerk", "armature", "damping", "friction", "stiffness"):
            assert getattr(again, field) == getattr(joint, field)
        assert_near(again.rotation, joint.rotation, product(3, 1.0))
        assert_same_bits(again.xyz, joint.xyz)
    for name, link in scene.links.items():
        assert_same_bits(back.links[name].inertia, link.inertia)


def test_springs_and_mimics_come_back() -> None:
    builder = phipsi.SceneBuilder().link("base").link("a", 1.0, (0, 0, 0.1), np.eye(3)).link("b", 1.0, (0, 0, 0.1), np.eye(3))
    builder.joint("j", "revolute", "base", "a", axis=(0, 1, 0), stiffness=3.0, rest=[0.2], lower=-1.0, upper=2.0)
    builder.joint("k", "prismatic", "a", "b", axis=(1, 0, 0), friction=0.3, mimic="j", mimic_multiplier=2.0, mimic_offset=0.1)
    with pytest.warns(phipsi.errors.MimicWarning):
        scene = builder.build()
    with pytest.warns(phipsi.errors.MimicWarning):
        back = phipsi.Scene.from_urdf(scene.to_urdf())
    assert (back.joints["j"].stiffness, back.joints["j"].rest.tolist()) == (3.0, [0.2])
    assert back.joints["k"].mimic == phipsi.Mimic("j", 2.0, 0.1)


def test_limits_of_the_second_version_come_back() -> None:
    """Also in a robot with a slide without bounds, which URDF 1.2 does not allow."""
    builder = phipsi.SceneBuilder().link("base").link("a", 1.0, (0, 0, 0.1), np.eye(3)).link("b", 1.0, (0, 0, 0.1), np.eye(3))
    builder.joint("j", "revolute", "base", "a", lower=-1.0, upper=2.0, acceleration=3.0, jerk=5.0).joint("k", "prismatic", "a", "b", deceleration=4.0)
    scene = builder.build()
    assert 'version="1.2"' in scene.to_urdf()
    back = phipsi.Scene.from_urdf(scene.to_urdf(), strict=True)
    assert all(np.array_equal(one, other) for one, other in zip(scene.limits, back.limits, strict=True))
    assert (scene.limits.deceleration.tolist(), scene.limits.acceleration.tolist()) == ([np.inf, 4.0], [3.0, np.inf])


def test_a_right_angle_of_pitch() -> None:
    for yaw in (0.0, 0.7, -2.0):
        turned = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]]) @ np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])
        builder = phipsi.SceneBuilder().link("base").link("a", 1.0, (0.1, 0.2, 0.3), np.eye(3))
        scene = builder.joint("j", "revolute", "base", "a", axis=(0, 1, 0), rotation=turned).build()
        back = phipsi.Scene.from_urdf(scene.to_urdf())
        assert_near(back.joints["j"].rotation, turned, product(3, 1.0))


def test_angles_near_a_right_angle_of_pitch() -> None:
    """The rotation matrix is exact although roll and yaw are not determined separately."""
    for short in 10.0 ** np.arange(-12.0, 0.0):
        turn = from_rpy(np.array([0.7, np.pi / 2 - short, -1.2]))
        assert_near(from_rpy(angles(turn)), turn, 8 * EPS)


def test_pinocchio_reads_it() -> None:
    pin = pytest.importorskip("pinocchio")
    scene = random_scene(3, 8, kinds=("revolute", "continuous", "prismatic", "fixed"))
    model = pin.buildModelFromXML(scene.to_urdf())
    model.gravity.linear = scene.gravity
    names = [model.names[joint] for joint in range(1, model.njoints)]
    assert set(names) == set(scene.joint_names)
    q = scene.integrate(scene.neutral(), np.random.default_rng(0).uniform(-1, 1, scene.nv))
    theirs = np.concatenate(
        [[np.cos(q[at]), np.sin(q[at])] if model.joints[i + 1].nq == 2 else [q[at]] for i, name in enumerate(names) if (at := scene.q_index(name).start) >= 0]
    )
    data = model.createData()
    mass = pin.crba(model, data, theirs)
    mass = np.triu(mass) + np.triu(mass, 1).T
    order = [scene.v_index(name).start for name in names]
    ours = scene.mass_matrix(q)[np.ix_(order, order)]
    assert_near(mass, ours, product(64 * scene.nv, size(ours)))


def test_what_urdf_cannot_hold_is_named() -> None:
    builder = phipsi.SceneBuilder().link("base").link("a", 1.0, (0, 0, 0.1), np.eye(3))
    with pytest.raises(ArgumentError, match="'twist' of type 'screw'"):
        builder.joint("twist", "screw", "base", "a", pitch=0.1).build().to_urdf()
    ball = phipsi.SceneBuilder().link("base").link("a", 1.0, (0, 0, 0.1), np.eye(3))
    with pytest.raises(ArgumentError, match="spring at joint 'ball'"):
        ball.joint("ball", "spherical", "base", "a", stiffness=1.0).build().to_urdf()
    free = phipsi.SceneBuilder().link("a", 1.0, (0, 0, 0.1), np.eye(3)).build(floating_base=True)
    with pytest.raises(ArgumentError, match="damping 0.5 at the free joint 'root_joint'"):
        free.with_properties(damping=0.5).to_urdf()


def test_shapes_of_the_file_are_kept(tmp_path: Path) -> None:
    """Materials too; a relative mesh path becomes absolute."""
    (tmp_path / "there").mkdir()
    link = '<link name="{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>{}</link>'
    shape = '<visual><geometry><mesh filename="{}"/></geometry><material name="red"/></visual><collision><geometry><sphere radius="2"/></geometry></collision>'
    text = '<robot name="r"><material name="red"><color rgba="1 0 0 1"/></material>' + link.format("a", shape.format("a.stl"))
    text += link.format("b", shape.format("package://p/b.stl"))
    text += '<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint></robot>'
    file = tmp_path / "there" / "robot.urdf"
    file.write_text(text)
    scene = phipsi.Scene.from_urdf(file).with_inertias({"b": (3.0, (0, 0, 0), np.eye(3))})
    root = ElementTree.fromstring(scene.to_urdf())
    assert [mesh.get("filename") for mesh in root.iter("mesh")] == [str(file.parent / "a.stl"), "package://p/b.stl"]
    assert len(list(root.iter("collision"))) == 2 and root.find("material/color") is not None
    assert phipsi.Scene.from_urdf(scene.to_urdf()).links["b"].mass == 3.0
    file.unlink()
    assert not list(ElementTree.fromstring(scene.to_urdf()).iter("mesh"))


def test_armature_alone_is_read_by_pinocchio() -> None:
    pin = pytest.importorskip("pinocchio")
    builder = phipsi.SceneBuilder().link("base").link("arm", 1.0, (0.1, 0.0, 0.0), np.eye(3))
    text = builder.joint("hinge", "revolute", "base", "arm", armature=0.5, lower=-1, upper=1, velocity=1, effort=1).build().to_urdf()
    assert pin.buildModelFromXML(text).nv == 1
    assert phipsi.Scene.from_urdf(text).armature[0] == 0.5


def test_contacts_are_refused_by_name() -> None:
    builder = phipsi.SceneBuilder().link("base").link("arm", 1.0, (0.1, 0.0, 0.0), np.eye(3)).joint("hinge", "revolute", "base", "arm", axis=(0, 1, 0))
    scene = builder.contact("toe", "arm", xyz=(0.2, 0.0, 0.0), friction=0.5).build()
    with pytest.raises(ArgumentError, match=r"scene: found contacts \('toe'\).*scene.without_contacts\(\)") as caught:
        scene.to_urdf()
    assert caught.value.argument == "scene"
    assert phipsi.Scene.from_urdf(scene.without_contacts().to_urdf()).nv == 1


def test_a_start_is_not_written_with_a_warning() -> None:
    builder = phipsi.scenes.chain(2).to_builder()
    for scene in (builder.start({"j0": 0.5}).build(), builder.start().start({}, keyframe="k").build()):
        with pytest.warns(phipsi.errors.ModelWarning, match="found a start or keyframes, which URDF cannot represent"):
            scene.to_urdf()


def test_colliders_come_back() -> None:
    """The colliders of links; a warning names the others. The shape of a link also has a visual element."""
    shapes = phipsi.shapes
    builder = phipsi.SceneBuilder().link("base", shape=shapes.Box((0.4, 0.3, 0.2), rpy=(0.1, 0.2, 0.3)), collide=True, friction=0.4)
    builder.link("arm", 1.0, inertia=np.eye(3)).joint("hinge", "revolute", "base", "arm", axis=(0, 1, 0), xyz=(0, 0, 0.5))
    builder.collider("ball", shapes.Sphere(0.1, xyz=(0.1, 0.2, 0.3)), link="arm", friction=0.3, restitution=0.2)
    builder.collider("rod", shapes.Capsule(0.02, 0.3, rpy=(0.3, 0.1, -0.2)), link="arm", friction=0.3, restitution=0.2)
    builder.collider("can", shapes.Cylinder(0.03, 0.2), link="arm", friction=0.3, restitution=0.2).collider("ground", shapes.HalfSpace(), friction=0.0)
    scene = builder.build()
    back = phipsi.load(scene.to_urdf(), contacts="all")
    own, found = ({(of[1], of[3][0]): of[2:6] for of in one._collisions()[0]} for one in (scene, back))
    assert own.keys() == found.keys() == {("base", "box"), ("arm", "sphere"), ("arm", "capsule"), ("arm", "cylinder"), (None, "half space")}
    for key, ((turn, origin), solid, *values) in own.items():
        (its_turn, its_origin), its_solid, *its_values = found[key]
        assert_near(np.array(its_turn), np.array(turn), 16 * EPS)
        assert (list(its_origin), list(its_solid[1]), its_values) == (list(origin), list(solid[1]), values)
    assert scene.to_urdf().count("<visual") == 1 and back.to_urdf().count("<collision") == 4
    builder.collider("wall", shapes.Box((1, 1, 1), xyz=(3, 0, 0))).collider("hull", shapes.Hull(np.vstack([np.zeros(3), np.eye(3)])), link="arm")
    with pytest.warns(phipsi.errors.ModelWarning, match="found colliders \\('wall', 'hull'\\), which URDF cannot represent; they are not written"):
        builder.build().to_urdf()


def test_geoms_of_a_mujoco_model_are_written_or_named(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    geoms = '<geom type="box" size="0.1 0.2 0.3" pos="1 2 3" euler="0 0 90" rgba="0 0 1 1"/><geom type="capsule" size="0.1 0.4"/>'
    text = f'<mujoco><worldbody><body name="arm"><joint name="j"/>{geoms}<geom type="ellipsoid" size="0.1 0.2 0.3"/></body></worldbody></mujoco>'
    (file := tmp_path / "arm.xml").write_text(text, encoding="utf-8")
    for source in (text, file):
        with pytest.warns(ModelWarning, match=r"shapes of a MuJoCo model \(1 of kind 'ellipsoid'\)"):
            robot = ElementTree.fromstring(phipsi.load(source).to_urdf())
        box, capsule = robot.findall("link[@name='arm']/visual")
        assert box.find("geometry/box").get("size") == "0.2 0.4 0.6"
        assert box.find("origin").get("xyz") == "1.0 2.0 3.0"
        assert_near(np.array(box.find("origin").get("rpy").split(), float), np.array([0.0, 0.0, np.pi / 2]), product(1, 2.0))
        assert box.find("material/color").get("rgba") == "0.0 0.0 1.0 1.0"
        assert capsule.find("geometry/capsule").attrib == {"radius": "0.1", "length": "0.8"}
