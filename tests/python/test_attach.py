"""One robot attached to another, and a part of a robot as a scene of its own."""

import pickle

import numpy as np
import phipsi
import pytest
import tolerances
from phipsi.errors import ArgumentError, MimicWarning

HAND = """<robot name="hand"><link name="palm"><inertial><mass value="0.4"/><origin xyz="0 0 0.02"/>
<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><box size="0.1 0.1 0.02"/></geometry></visual></link>
<link name="left"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="right"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="open" type="prismatic"><parent link="palm"/><child link="left"/><origin xyz="0 0.02 0.05"/><axis xyz="0 1 0"/>
<limit lower="0" upper="0.04" effort="20" velocity="1"/></joint>
<joint name="follow" type="prismatic"><parent link="palm"/><child link="right"/><origin xyz="0 -0.02 0.05"/><axis xyz="0 -1 0"/>
<limit lower="0" upper="0.04" effort="20" velocity="1"/><mimic joint="open"/></joint></robot>"""


def hand(**given):
    builder = phipsi.load(HAND, mimic="couple").to_builder()
    builder.contact("pad", "left", friction=0.5, xyz=(0, -0.02, 0))
    builder.actuator("motor", "open", gear=10.0)
    builder.start({"open": 0.01}).start({"open": 0.03}, keyframe="wide")
    return builder.build(**given)


def joined(prefix="hand_"):
    arm = phipsi.load(phipsi.BUNDLED_ARM)
    return arm.to_builder().attach(hand(), "flange", prefix=prefix, xyz=(0, 0, 0.1), rpy=(0.3, 0.2, 0.1))


def by_hand():
    """The same robot, part by part."""
    builder = phipsi.load(phipsi.BUNDLED_ARM).to_builder()
    builder.link("hand_palm", 0.4, (0, 0, 0.02), 1e-3 * np.eye(3))
    builder.link("hand_left", 0.1, (0, 0, 0), 1e-4 * np.eye(3)).link("hand_right", 0.1, (0, 0, 0), 1e-4 * np.eye(3))
    builder.joint("mount", "fixed", "flange", "hand_palm", xyz=(0, 0, 0.1), rpy=(0.3, 0.2, 0.1))
    builder.joint("hand_open", "prismatic", "hand_palm", "hand_left", xyz=(0, 0.02, 0.05), axis=(0, 1, 0), lower=0, upper=0.04)
    builder.joint("hand_follow", "prismatic", "hand_palm", "hand_right", xyz=(0, -0.02, 0.05), axis=(0, -1, 0), lower=0, upper=0.04, mimic="hand_open")
    return builder.build(mimic="couple")


def test_the_dynamics_are_those_of_the_robot_from_its_parts():
    found, expected = joined().build(), by_hand()
    assert found.joint_names == expected.joint_names == (*phipsi.load(phipsi.BUNDLED_ARM).joint_names, "hand_open")
    rng = np.random.default_rng(0)
    q, qd, tau = rng.uniform(-0.5, 0.5, (3, 20, found.nv))
    q[:, -1] = rng.uniform(0, 0.04, 20)
    scale = tolerances.size(expected.forward_dynamics(q, qd, tau))
    tolerances.assert_near(found.forward_dynamics(q, qd, tau), expected.forward_dynamics(q, qd, tau), 1e-10 * scale)
    tolerances.assert_near(found.placement(q, "hand_right"), expected.placement(q, "hand_right"), tolerances.product(20, 1.0))
    assert found.total_mass == pytest.approx(expected.total_mass)


def test_contacts_actuators_starts_keyframes_and_limits_come_with_it():
    scene = joined().build()
    assert scene.contacts.names == ("hand_pad",) and scene.actuators.names == ("hand_motor",)
    assert scene.initial()[-1] == 0.01 and scene.initial("hand_wide")[-1] == 0.03
    assert scene.limits.upper[-1] == 0.04
    same = phipsi.scenes.chain(2).to_builder().attach(hand(), "link1").build()
    assert same.contacts.names == ("pad",) and same.initial("wide")[-1] == 0.03


def test_its_shapes_are_drawn():
    from phipsi.view.shapes import of_file

    assert {shape.link for shape in of_file(joined().build(), None)} >= {"hand_palm"}


def test_shapes_of_mjcf_files_are_drawn(tmp_path):
    pytest.importorskip("mujoco")
    from phipsi.view.shapes import of_file

    file = tmp_path / "finger.xml"
    body = '<body name="{}" pos="0 0 0.1"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint axis="0 1 0"/><geom type="box" size=".01 .02 .03"/>{}</body>'
    file.write_text(f"<mujoco><worldbody>{body.format('near', body.format('far', ''))}</worldbody></mujoco>")
    finger = phipsi.load(file)
    once = phipsi.scenes.chain(2).to_builder().attach(finger, "link1", prefix="a_").attach(finger, "link0", prefix="b_").build()
    twice = pickle.loads(pickle.dumps(phipsi.load(phipsi.BUNDLED_ARM).to_builder().attach(once, "flange", prefix="c_").build()))
    for scene, prefixes in ((finger, [""]), (once, ["a_", "b_"]), (twice, ["c_a_", "c_b_"])):
        drawn = [shape for shape in of_file(scene, None) if shape.link.endswith(("near", "far"))]
        assert sorted(shape.link for shape in drawn) == sorted(prefix + link for prefix in prefixes for link in ("near", "far"))
        assert all(np.allclose(shape.mesh.extents, [0.02, 0.04, 0.06]) for shape in drawn)


def test_colliders_come_with_it_but_not_its_ground():
    builder = phipsi.SceneBuilder().link("box", 1.0, shape=phipsi.shapes.Box((0.1, 0.1, 0.1)), collide=True)
    box = builder.collider("ground", phipsi.shapes.HalfSpace()).build(floating_base=True)
    # The start of its free joint, which becomes fixed, does not come with it.
    box = box.to_builder().start({"root_joint": [0, 0, 1.0, 0, 0, 0, 1]}).build()
    scene = phipsi.scenes.chain(2).to_builder().attach(box, "link1", prefix="a_").attach(box, "link0", prefix="b_", xyz=(0, 0.3, 0)).build()
    assert [name.split("_")[0] for name in scene.collider_names] == ["a", "b"]


def test_a_part_is_the_robot_that_was_attached():
    whole, own = joined().build(), hand()
    part = whole.subtree("hand_palm")
    assert part.joint_names == ("hand_open",) and part.contacts.names == ("hand_pad",) and part.actuators.names == ("hand_motor",)
    assert part.initial("hand_wide")[0] == 0.03
    q = [[0.02]]
    tolerances.assert_near(part.mass_matrix(q), own.mass_matrix(q), tolerances.product(10, 1.0))
    loose = whole.subtree("hand_palm", floating_base=True)
    assert loose.nv == 7 and loose.total_mass == pytest.approx(0.6)
    arm = phipsi.load(phipsi.BUNDLED_ARM)
    outer = arm.subtree(arm.body_names[2])
    assert outer.joint_names == arm.joint_names[3:]
    poses = outer.placement(np.zeros(outer.nv), "flange")
    expected = np.linalg.inv(arm.placement(arm.neutral(), arm.body_names[2])) @ arm.placement(arm.neutral(), "flange")
    tolerances.assert_near(poses, expected, tolerances.product(10, 1.0))


def test_what_is_wrong_is_named():
    arm = phipsi.load(phipsi.BUNDLED_ARM)
    with pytest.raises(ArgumentError, match="tool"):
        arm.to_builder().attach(hand(), "tool")
    with pytest.raises(ArgumentError, match="prefix"):
        arm.to_builder().attach(arm, "flange")
    with pytest.warns(MimicWarning):
        free = phipsi.load(HAND)
    with pytest.raises(ArgumentError, match="mimic"):
        free.to_builder().attach(hand(), "palm", prefix="other_")
    with pytest.raises(ArgumentError, match="wrist"):
        arm.subtree("wrist")
    loop = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j0").build()
    with pytest.raises(ArgumentError, match="gear"):
        loop.subtree("link1")
