"""New scenes from a scene: conversion to a builder, other properties, payloads; and links and joints by name."""

from __future__ import annotations

import copy
import pickle
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import random_scene, random_states
from tolerances import assert_near, assert_same_bits, product, size

import phipsi
from phipsi.errors import ArgumentError, InertiaWarning, NotFiniteError, SceneError, ShapeError, SingularJointError

URDF = """
<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2" rpy="0 0 1"/><mass value="2"/>
    <inertia ixx="0.03" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/></inertial></link>
  <link name="tool"/>
  <link name="finger"><inertial><mass value="0.1"/><inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 3 4"/>
    <origin xyz="0 0 0.5" rpy="0 0 0.5"/><limit lower="-1" upper="2" velocity="3" effort="4"/><dynamics damping="0.1" friction="0.2"/></joint>
  <joint name="mount" type="fixed"><parent link="upper"/><child link="tool"/><origin xyz="0 0 0.4"/></joint>
  <joint name="grip" type="prismatic"><parent link="tool"/><child link="finger"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.04" velocity="1" effort="1"/><mimic joint="shoulder" multiplier="-0.5" offset="0.25"/></joint>
</robot>
"""


@pytest.fixture
def urdf() -> phipsi.Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return phipsi.Scene.from_urdf(URDF)


def results(scene: phipsi.Scene) -> list[np.ndarray]:
    q, qd, tau = random_states(scene, 3, (2,))
    return [
        scene.forward_dynamics(q, qd, tau),
        scene.inverse_dynamics(q, qd, tau),
        scene.mass_matrix(q),
        scene.mass_matrix_inverse(q),
        scene.armature,
        scene.damping,
        scene.friction,
        scene.stiffness,
        scene.rest,
        scene.gravity,
        *scene.limits,
        *scene.placements(q).values(),
    ]


def assert_equal_scenes(one: phipsi.Scene, other: phipsi.Scene) -> None:
    assert (one.joint_names, one.body_names, one.link_names) == (other.joint_names, other.body_names, other.link_names)
    assert repr(one) == repr(other)
    for found, expected in zip(results(one), results(other), strict=True):
        assert_same_bits(found, expected)


def floating() -> phipsi.Scene:
    return random_scene(5, 9, armature=0.2, floating_base=True)


SCENES = {
    "arm": lambda: phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM, gravity=(0.1, 0.2, -3)),
    "mixed": lambda: random_scene(4, 9, armature=0.1),
    "floating": floating,
    "floating with properties": lambda: floating().with_properties(armature=0.3, damping=0.1),
    "locked": lambda: floating().lock(["joint2", "joint5"], random_states(floating(), 1).q),
    "locked base": lambda: floating().lock(["root_joint"], random_states(floating(), 1).q),
    "nothing left out": lambda: random_scene(6, 5).to_builder().build(leave_out=()),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_builder_of_a_scene_builds_it_again(name: str) -> None:
    scene = SCENES[name]()
    assert_equal_scenes(scene.to_builder().build(), scene)
    assert_equal_scenes(pickle.loads(pickle.dumps(scene)), scene)
    assert [item.count for item in scene.to_builder().build().plan().items] == [item.count for item in scene.plan().items]


@pytest.mark.parametrize("remade", [copy.copy, copy.deepcopy, lambda builder: pickle.loads(pickle.dumps(builder))])
def test_builders_pickle_and_copy(remade: Any) -> None:
    scene = floating()
    builder = scene.to_builder()
    other = remade(builder)
    assert_equal_scenes(other.build(), scene)
    # The copies are independent.
    other.link("more").joint("to more", "revolute", "base", "more")
    assert "more" not in builder.build().link_names
    assert "more" in other.build().link_names


def test_what_is_given_to_build_wins() -> None:
    builder = floating().to_builder()
    assert builder.build(floating_base=False).joint_names[0] != "root_joint"
    assert_same_bits(builder.build(gravity=(1, 2, 3)).gravity, np.array([1.0, 2.0, 3.0]))
    assert phipsi.SceneBuilder().link("base").build().joint_names == ()


def test_a_builder_takes_more_parts(urdf: phipsi.Scene) -> None:
    with pytest.warns(phipsi.errors.MimicWarning):
        scene = urdf.to_builder().link("camera", 0.2).joint("neck", "revolute", "upper", "camera").build()
    assert scene.joint_names == ("shoulder", "grip", "neck")


def test_armature_enters_the_mass_matrix(arm: phipsi.Scene) -> None:
    q = random_states(arm, 0).q
    changed = arm.with_properties(armature={"joint3": 0.5})
    difference = changed.mass_matrix(q) - arm.mass_matrix(q)
    expected = np.zeros((7, 7))
    expected[3, 3] = 0.5 - arm.armature[3]
    assert_near(difference, expected, product(7, size(changed.mass_matrix(q))))
    assert arm.armature[3] != 0.5


PROPERTIES = ("armature", "damping", "friction", "stiffness")


@pytest.mark.parametrize("name", PROPERTIES)
def test_properties_by_name_by_array_and_by_number(name: str) -> None:
    scene = floating()
    joints = scene.joint_names
    before = getattr(scene, name)
    # By name: the others are unchanged.
    changed = scene.with_properties(**{name: {"joint1": 0.7, "root_joint": 0.9}})
    expected = before.copy()
    expected[scene.v_index("joint1")] = 0.7
    expected[scene.v_index("root_joint")] = 0.9
    assert_same_bits(getattr(changed, name), expected)
    for other in set(PROPERTIES) - {name}:
        assert_same_bits(getattr(changed, other), getattr(scene, other))
    # One value, one per joint, one per degree of freedom.
    assert_same_bits(getattr(scene.with_properties(**{name: 0.25}), name), np.full(scene.nv, 0.25))
    each = 0.1 + np.arange(len(joints))
    by_row = np.concatenate([np.full(scene.v_index(joint).stop - scene.v_index(joint).start, x) for joint, x in zip(joints, each, strict=True)])
    for given in (each, by_row, {joint: x for joint, x in zip(joints, each, strict=True)}):
        assert_same_bits(getattr(scene.with_properties(**{name: given}), name), by_row)
    # Properties are preserved, including conversion to a builder.
    assert_same_bits(getattr(changed.with_properties(), name), expected)
    assert_same_bits(getattr(changed.to_builder().build(), name), expected)


def test_several_properties_at_once(arm: phipsi.Scene) -> None:
    scene = arm.with_properties(armature=0.1, damping={"joint0": 2.0}, friction=np.arange(7.0), stiffness=3)
    assert_same_bits(scene.armature, np.full(7, 0.1))
    assert scene.damping[0] == 2.0
    assert_same_bits(scene.friction, np.arange(7.0))
    assert_same_bits(scene.stiffness, np.full(7, 3.0))


def test_properties_simulate_as_the_keywords_of_simulate_do() -> None:
    scene = random_scene(2, 5)
    q, qd, _ = random_states(scene, 0)
    given = {"damping": 0.3, "stiffness": 2.0, "friction": 0.1, "armature": 0.2}
    one = scene.with_properties(**given).simulate(q, qd, dt=1e-3, steps=20)
    other = scene.simulate(q, qd, dt=1e-3, steps=20, **given)
    assert_near(one.q, other.q, product(100, size(other.q)))


BROKEN_PROPERTIES: dict[str, tuple[dict[str, Any], type[Exception], str]] = {
    "unknown": ({"armature": {"elbow": 1}}, ArgumentError, 'armature: found "elbow"; expected one of "shoulder", "grip"'),
    "fixed": ({"damping": {"mount": 1}}, ArgumentError, 'damping: found "mount"; expected one of "shoulder"'),
    "negative": ({"friction": -1.0}, ArgumentError, 'friction: found -1 for joint "shoulder"; expected finite numbers'),
    "NaN": ({"stiffness": {"grip": np.nan}}, ArgumentError, 'stiffness: found NaN for joint "grip"'),
    "infinite": ({"armature": [0.0, np.inf]}, ArgumentError, 'armature: found inf for joint "grip"'),
    "shape": ({"armature": np.zeros(5)}, ShapeError, r"armature: found shape \(5,\)"),
    "axes": ({"armature": np.zeros((1, 2))}, ShapeError, r"armature: found shape \(1, 2\)"),
    "key": ({"armature": {3: 1.0}}, ArgumentError, "armature: found the key 3; expected names of joints"),
    "text": ({"damping": "much"}, ArgumentError, "damping: found dtype <U4"),
    "no number": ({"damping": {"grip": None}}, ArgumentError, r'damping\["grip"\]: found dtype object from None'),
    "vector": ({"damping": {"grip": [1.0, 2.0]}}, ShapeError, r'damping\["grip"\]: found shape \(2,\)'),
}


@pytest.mark.parametrize("case", BROKEN_PROPERTIES)
def test_one_broken_property(urdf: phipsi.Scene, case: str) -> None:
    given, error, message = BROKEN_PROPERTIES[case]
    with pytest.raises(error, match=message) as found:
        urdf.with_properties(**given)
    if error is ArgumentError and "[" not in message:
        assert found.value.argument == next(iter(given))


def test_a_joint_has_one_number_for_all_its_degrees_of_freedom() -> None:
    scene = random_scene(0, 1, kinds=("spherical",))
    assert_same_bits(scene.with_properties(damping={"joint0": [2.0, 2.0, 2.0]}).damping, np.full(3, 2.0))
    for given in ({"joint0": [1.0, 2.0, 3.0]}, [1.0, 2.0, 3.0]):
        with pytest.raises(ArgumentError, match='damping: found .* for joint "joint0"; expected one number for all'):
            scene.with_properties(damping=given)


def test_the_remedy_of_a_singular_joint_can_be_taken() -> None:
    scene = phipsi.SceneBuilder().link("base").link("mass", 1.0).joint("hinge", "revolute", "base", "mass").build()
    with pytest.raises(SingularJointError, match=r"scene\.with_properties\(armature=\{\"hinge\": 1e-3\}\)") as found:
        scene.forward_dynamics([0.0], [0.0], [1.0])
    remedy = str(found.value).split("for instance ")[1]
    mended = eval(remedy, {"scene": scene})
    assert_near(mended.forward_dynamics([0.0], [0.0], [1.0]), np.array([1e3]), product(1, 1e3))


def loaded_by_a_link(scene: phipsi.Scene, link: str, mass: float, com: np.ndarray, inertia: np.ndarray) -> phipsi.Scene:
    return scene.to_builder().link("load", mass, com, inertia).joint("clamp", "fixed", link, "load").build()


@pytest.mark.parametrize("link", ["base", "link2", "link6"])
@pytest.mark.parametrize("floating_base", [False, True])
def test_a_payload_is_a_link_that_is_welded_on(link: str, floating_base: bool) -> None:
    scene = random_scene(8, 7, floating_base=floating_base)
    mass, com, inertia = 3.0, np.array([0.1, -0.4, 0.2]), np.diag([0.02, 0.03, 0.04])
    found, expected = scene.with_payload(link, mass, com, inertia), loaded_by_a_link(scene, link, mass, com, inertia)
    q, qd, tau = random_states(scene, 0)
    m = expected.mass_matrix(q)
    assert_near(found.mass_matrix(q), m, product(60, size(m)))
    bias = expected.bias_torque(q, qd)
    assert_near(found.bias_torque(q, qd), bias, product(60, size(bias)))
    assert found.link_names == scene.link_names
    assert found.links[link].mass == scene.links[link].mass + mass
    if link == "base" and not floating_base:
        assert_same_bits(m, scene.mass_matrix(q))


def test_a_point_mass_far_away_keeps_its_digits() -> None:
    scene = random_scene(1, 3)
    own = scene.links["link1"]
    found = scene.with_payload("link1", own.mass, own.com + [1e8, 0, 0]).links["link1"]
    reduced = own.mass / 2
    assert_near(found.inertia, own.inertia + reduced * np.diag([0, 1e16, 1e16]), product(4, 1e16))
    # A payload without mass changes nothing.
    same = scene.with_payload("link1", 0.0).links["link1"]
    assert_same_bits(same.inertia, own.inertia)
    assert_same_bits(same.com, own.com)


def test_a_frame_can_carry_a_load(urdf: phipsi.Scene) -> None:
    tool = urdf.with_payload("tool", 0.5, (0, 0, 0.1)).link("tool")
    assert tool.mass == 0.5
    assert_same_bits(tool.com, np.array([0, 0, 0.1]))


BROKEN_PAYLOADS: dict[str, tuple[dict[str, Any], type[Exception], str]] = {
    "link": ({"link": "hand"}, ArgumentError, 'link: found "hand"; expected one of "base"'),
    "mass": ({"mass": -1.0}, ArgumentError, "mass: found -1; expected a finite mass, zero or positive"),
    "NaN mass": ({"mass": np.nan}, ArgumentError, "mass: found NaN"),
    "com": ({"com": [0.0, 0.0]}, ShapeError, r"com: found shape \(2,\)"),
    "com NaN": ({"com": [0.0, 0.0, np.nan]}, NotFiniteError, "com: found NaN at index 2"),
    "inertia": ({"inertia": np.eye(2)}, ShapeError, r"inertia: found shape \(2, 2\)"),
    "triangles": ({"inertia": [[1, 1, 0], [0, 1, 0], [0, 0, 1]]}, ArgumentError, "inertia: found a matrix whose two triangles"),
}


@pytest.mark.parametrize("case", BROKEN_PAYLOADS)
def test_one_broken_payload(urdf: phipsi.Scene, case: str) -> None:
    given, error, message = BROKEN_PAYLOADS[case]
    valid: dict[str, Any] = {"link": "tool", "mass": 1.0, "com": (0, 0, 0), "inertia": np.eye(3)}
    with pytest.raises(error, match=message) as found:
        urdf.with_payload(**(valid | given))
    assert found.value.argument == next(iter(given), case)  # type: ignore[attr-defined]


def test_an_unphysical_load_warns_once_and_raises_if_strict(arm: phipsi.Scene) -> None:
    with pytest.warns(InertiaWarning, match='link "link3"'):
        loaded = arm.with_payload("link3", 1.0, (0, 0, 0), np.diag([1.0, 1.0, 30.0]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loaded.with_properties(damping=1.0)
    strict = arm.to_builder().build(strict=True)
    with pytest.raises(SceneError, match='link "link3"'):
        strict.with_payload("link3", 1.0, (0, 0, 0), np.diag([1.0, 1.0, 30.0]))


def test_links_are_read_back(urdf: phipsi.Scene) -> None:
    assert tuple(urdf.links) == urdf.link_names
    upper = urdf.link("upper")
    assert (upper.name, upper.mass, upper.parent, upper.joint) == ("upper", 2.0, "base", "shoulder")
    assert_same_bits(upper.com, np.array([0, 0, 0.2]))
    c, s = np.cos(1.0), np.sin(1.0)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    assert_near(upper.inertia, turn @ np.diag([0.03, 0.02, 0.01]) @ turn.T, product(3, 1.0))
    base = urdf.links["base"]
    assert (base.mass, base.parent, base.joint) == (0.0, None, None)
    assert_same_bits(base.inertia, np.zeros((3, 3)))
    assert urdf.links["tool"].joint == "mount"


def test_joints_are_read_back(urdf: phipsi.Scene) -> None:
    assert tuple(urdf.joints) == ("shoulder", "mount", "grip")
    shoulder = urdf.joint("shoulder")
    assert (shoulder.type, shoulder.parent, shoulder.child, shoulder.pitch) == ("revolute", "base", "upper", None)
    assert shoulder.axis is not None
    assert_near(shoulder.axis, np.array([0, 0.6, 0.8]), product(3, 1.0))
    assert (shoulder.damping, shoulder.friction, shoulder.armature, shoulder.stiffness) == (0.1, 0.2, 0.0, 0.0)
    assert (shoulder.lower, shoulder.upper, shoulder.velocity, shoulder.effort) == (-1.0, 2.0, 3.0, 4.0)
    assert shoulder.mimic is None
    assert_same_bits(shoulder.xyz, np.array([0, 0, 0.5]))
    assert_near(shoulder.rotation[:, 0], np.array([np.cos(0.5), np.sin(0.5), 0]), product(3, 1.0))
    assert_same_bits(shoulder.rest, np.zeros(1))
    grip = urdf.joints["grip"]
    assert grip.mimic == ("shoulder", -0.5, 0.25)
    assert grip.mimic is not None and (grip.mimic.joint, grip.mimic.multiplier, grip.mimic.offset) == ("shoulder", -0.5, 0.25)
    mount = urdf.joints["mount"]
    assert (mount.type, mount.axis, mount.rest.shape) == ("fixed", None, (0,))


def test_a_floating_base_is_read_back() -> None:
    scene = floating().with_properties(damping={"root_joint": 0.5})
    root = scene.joint("root_joint")
    assert (root.type, root.parent, root.child, root.damping) == ("floating", None, "base", 0.5)
    assert_same_bits(root.rest, np.array([0, 0, 0, 0, 0, 0, 1.0]))
    assert scene.link("base").joint == "root_joint"
    assert next(iter(scene.joints)) == "root_joint"


def test_what_is_read_back_builds_the_scene_again() -> None:
    scene = floating()
    builder = phipsi.SceneBuilder()
    for link in scene.links.values():
        builder.link(link.name, link.mass, link.com, link.inertia)
    for joint in scene.joints.values():
        if joint.parent is None:
            continue
        fields = joint._asdict()
        fields |= {"axis": (0, 0, 1) if joint.axis is None else joint.axis, "mimic": None}
        fields = {name: fields[name] for name in fields if name not in ("name", "type", "parent", "child")}
        builder.joint(joint.name, joint.type, joint.parent, joint.child, **fields)  # type: ignore[arg-type]
    again = builder.build(floating_base=True, gravity=scene.gravity)
    q, qd, tau = random_states(scene, 0)
    m = scene.mass_matrix(q)
    assert_near(again.mass_matrix(q), m, product(100, size(m)))


def test_locked_joints_are_fixed_when_read_back() -> None:
    scene = floating()
    locked = scene.lock(["joint2"], scene.neutral())
    assert locked.joint("joint2").type == "fixed"
    assert locked.joint("joint2").child == scene.joint("joint2").child


def test_arrays_that_are_read_back_are_read_only(urdf: phipsi.Scene) -> None:
    with pytest.raises(ValueError, match="read-only"):
        urdf.link("upper").inertia[:] = 0.0


def test_what_is_read_back_pickles(urdf: phipsi.Scene) -> None:
    joint = pickle.loads(pickle.dumps(urdf.joint("grip")))
    assert joint.mimic == urdf.joint("grip").mimic


def test_unknown_names(urdf: phipsi.Scene) -> None:
    with pytest.raises(ArgumentError, match='link: found "hand"; expected one of "base", "upper"'):
        urdf.link("hand")
    with pytest.raises(ArgumentError, match='joint: found "elbow"; expected one of "shoulder", "grip"'):
        urdf.joint("elbow")


def test_mimics_of_the_builder() -> None:
    builder = phipsi.SceneBuilder().link("a").link("b", 1.0, inertia=np.eye(3)).link("c", 1.0, inertia=np.eye(3))
    builder.joint("one", "revolute", "a", "b")
    builder.joint("two", "revolute", "b", "c", mimic="one", mimic_multiplier=2.0, mimic_offset=-1.0)
    with pytest.warns(phipsi.errors.MimicWarning):
        scene = builder.build()
    assert scene.joint("two").mimic == ("one", 2.0, -1.0)
    assert pickle.loads(pickle.dumps(scene)).joint("two").mimic == ("one", 2.0, -1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        bad = phipsi.SceneBuilder().link("a").link("b").joint("one", "revolute", "a", "b", mimic="x", mimic_multiplier=np.inf)
        with pytest.raises(SceneError, match='joint "one": found a mimic with multiplier inf'):
            bad.build()


def test_a_real_file_goes_round(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(URDF, encoding="utf-8")
    with pytest.warns(phipsi.errors.MimicWarning):
        scene = phipsi.Scene.from_urdf(path, floating_base=True).with_payload("base", 1.0, inertia=np.eye(3))
    with pytest.warns(phipsi.errors.MimicWarning):
        again = scene.to_builder().build()
    assert_equal_scenes(again, scene)


def started() -> phipsi.Scene:
    """A floating robot with a start and two keyframes."""
    builder = floating().to_builder().start({"joint2": 0.3, "joint5": -0.2, "root_joint": [1, 2, 3, 0, 0, 0.6, 0.8]}, {"joint5": 0.5})
    builder.start({"joint5": 0.7}, keyframe="one").start({"joint2": 0.1}, {"joint2": [2.0], "root_joint": range(6)}, keyframe="two")
    return builder.build()


def test_starts_remain_in_changed_scenes() -> None:
    scene = started()
    two, five, root = (scene.q_index(name) for name in ("joint2", "joint5", "root_joint"))
    assert scene.keyframes == ("one", "two")
    # Joints that a keyframe does not name are as in the start.
    expected = scene.neutral()
    expected[two], expected[five], expected[root] = 0.3, -0.2, [1, 2, 3, 0, 0, 0.6, 0.8]
    assert_same_bits(scene.initial(), expected)
    expected[five] = 0.7
    assert_same_bits(scene.initial("one"), expected)
    expected[two], expected[five] = 0.1, -0.2
    assert_same_bits(scene.initial(1), expected)
    rates = np.zeros(scene.nv)
    rates[scene.v_index("joint5")] = 0.5
    assert_same_bits(scene.initial_velocity(), rates)
    rates[scene.v_index("joint2")], rates[scene.v_index("root_joint")] = 2.0, np.arange(6.0)
    assert_same_bits(scene.initial_velocity("two"), rates)
    changed = {
        "builder": scene.to_builder().build(),
        "pickle": pickle.loads(pickle.dumps(scene)),
        "pickled builder": pickle.loads(pickle.dumps(scene.to_builder())).build(),
        "payload": scene.with_payload("joint5" if "joint5" in scene.link_names else scene.body_names[3], 0.1),
        "properties": scene.with_properties(armature=0.3),
        "gravity": scene.to_builder().build(gravity=(0, 0, 1)),
        "without contacts": scene.without_contacts().without_constraints(),
    }
    for name, other in changed.items():
        assert other.keyframes == scene.keyframes, name
        for keyframe in (None, *scene.keyframes):
            assert_same_bits(other.initial(keyframe), scene.initial(keyframe))
            assert_same_bits(other.initial_velocity(keyframe), scene.initial_velocity(keyframe))


@pytest.mark.parametrize("joint", ["joint5", "root_joint"])
def test_locked_joints_leave_the_starts(joint: str) -> None:
    scene = started()
    locked = scene.lock([joint], scene.initial("two"))
    assert locked.keyframes == ("one", "two")
    for keyframe in (None, "one", "two"):
        assert_same_bits(locked.initial(keyframe), np.delete(scene.initial(keyframe), scene.q_index(joint)))
        assert_same_bits(locked.initial_velocity(keyframe), np.delete(scene.initial_velocity(keyframe), scene.v_index(joint)))


def test_a_start_with_the_same_name_replaces_the_first_one() -> None:
    builder = phipsi.scenes.chain(2).to_builder().start({"j0": 1.0}).start({"j0": 2.0}, keyframe="k").start({"j1": 3.0}).start({}, keyframe="k")
    scene = builder.build()
    assert scene.keyframes == ("k",)
    assert_same_bits(scene.initial("k"), np.array([0.0, 3.0]))


def test_joints_that_follow_have_no_start_of_their_own(urdf: phipsi.Scene) -> None:
    """grip = -0.5 shoulder + 0.25."""
    builder = urdf.to_builder().start({"shoulder": 0.2, "grip": 0.15}).start({"shoulder": 0.4}, {"shoulder": 1.0}, keyframe="k")
    with pytest.raises(ArgumentError, match='keyframe "k": found 0.15 at index 1; expected 0.0'):
        builder.build(mimic="couple")
    coupled = builder.start({"shoulder": 0.4, "grip": 0.05}, keyframe="k").start({"shoulder": 0.2}).build(mimic="couple")
    assert_same_bits(coupled.initial("k"), np.array([0.4]))
    assert coupled.initial_velocity("k").shape == (1,)
    with pytest.raises(ArgumentError, match='start: found 0.3 at index 1; expected 0.15.*follows another'):
        builder.start({"shoulder": 0.2, "grip": 0.3}).build(mimic="couple")


@pytest.mark.parametrize(
    ("start", "error", "message"),
    [
        ({"q": {"knee": 1.0}, "keyframe": "a"}, ArgumentError, 'keyframe "a": found "knee"; expected one of "root_joint", "j0", "j1"'),
        ({"q": {"j0": [1.0, 2.0]}}, SceneError, 'start: found 2 numbers for q of joint "j0"; expected 1'),
        ({"qd": {"j0": []}, "keyframe": "a"}, SceneError, 'keyframe "a": found 0 numbers for qd of joint "j0"; expected 1'),
        ({"q": {"j1": np.nan}}, NotFiniteError, "q of start"),
        ({"qd": {"j1": np.inf}, "keyframe": "a"}, NotFiniteError, 'qd of keyframe "a"'),
        ({"q": {"root_joint": [0.0] * 7}}, ArgumentError, "q of start: found a quaternion of norm 0"),
        ({"q": [0.0, 1.0]}, ArgumentError, r"q: found \[0.0, 1.0\]; expected a dict"),
        ({"q": {3: 1.0}}, ArgumentError, "q: found the key 3; expected names of joints"),
        ({"qd": {"j0": [[1.0]]}}, ShapeError, r'qd\["j0"\]: found shape \(1, 1\)'),
    ],
)  # fmt: skip
def test_starts_that_cannot_be_are_refused(start: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        phipsi.scenes.chain(2).to_builder().start(**start).build(floating_base=True)
