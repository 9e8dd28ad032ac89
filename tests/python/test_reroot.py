"""The same robot with another root link: equal poses and energies, and dynamics that are equal in mapped coordinates."""

from __future__ import annotations

import numpy as np
import phipsi
import pytest
from conftest import random_scene
from phipsi.errors import ArgumentError
from tolerances import assert_near, inverse, product, size

KINDS = ("revolute", "prismatic", "screw", "continuous", "fixed")


def robot(seed: int, floating_base: bool) -> phipsi.Scene:
    return random_scene(seed, 9, kinds=KINDS, armature=0.1, floating_base=floating_base)


def rows(scene: phipsi.Scene, names: tuple[str, ...]) -> list[int]:
    """Degrees of freedom of joints of one axis, in this order."""
    return [scene.v_index(name).start for name in names]


def links_of(scene: phipsi.Scene) -> tuple[str, ...]:
    """The root, one link in the middle, and the last."""
    return (scene.link_names[0], scene.link_names[4], scene.link_names[-1])


def mapped(scene: phipsi.Scene, turned: phipsi.Scene, link: str, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The coordinates of the same configuration, and the matrix T with the velocities T qd."""
    names = scene.joint_names[1:]
    there, t = turned.neutral(), np.zeros((turned.nv, scene.nv))
    there[[turned.q_index(name).start for name in names]] = q[[scene.q_index(name).start for name in names]]
    there[:7] = free(scene.placement(q, link))
    t[rows(turned, names), rows(scene, names)] = 1.0
    jacobian = scene.jacobian(q, link)
    t[:6] = np.concatenate([jacobian[3:], jacobian[:3]])
    return there, t


def free(pose: np.ndarray) -> np.ndarray:
    """Coordinates of a free joint."""
    trace = np.array([1 + r @ pose.diagonal()[:3] for r in ([1, -1, -1], [-1, 1, -1], [-1, -1, 1], [1, 1, 1])])
    most = int(np.argmax(trace))
    r = pose[:3, :3]
    x, y, z, w = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], trace[3]
    xy, xz, yz = r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1]
    whole = np.array([[trace[0], xy, xz, x], [xy, trace[1], yz, y], [xz, yz, trace[2], z], [x, y, z, w]])[most]
    return np.concatenate([pose[:3, 3], whole / np.linalg.norm(whole)])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("at", range(3))
def test_a_floating_robot_is_the_same(seed: int, at: int) -> None:
    scene, random = robot(seed, True), np.random.default_rng(seed)
    link = links_of(scene)[at]
    turned = scene.rerooted(link)
    assert turned.joint_names[0] == "root_joint" and set(turned.joint_names) == set(scene.joint_names)
    q = scene.random_configuration(random)
    qd = random.normal(size=scene.nv)
    there, t = mapped(scene, turned, link, q)
    poses, others = scene.placements(q), turned.placements(there)
    for name, pose in poses.items():
        assert_near(others[name], pose, product(100, 10.0))
    tau = random.normal(size=turned.nv)
    mass, cond = scene.mass_matrix(q), float(np.linalg.cond(scene.mass_matrix(q)))
    assert_near(t.T @ turned.mass_matrix(there) @ t, mass, product(1000, 10.0 * size(mass)))
    for one, other in zip(scene.energy(q, qd), turned.energy(there, t @ qd), strict=True):
        assert_near(one, other, product(1000, 10.0 * (1.0 + size(one))))
    qdd, accelerations = scene.forward_dynamics(q, qd, t.T @ tau), turned.forward_dynamics(there, t @ qd, tau)
    names = scene.joint_names[1:]
    assert_near(accelerations[rows(turned, names)], qdd[rows(scene, names)], 100.0 * inverse(cond, size(qdd)))
    expected = scene.acceleration(q, qd, qdd, link)
    assert_near(turned.acceleration(there, t @ qd, accelerations, link), expected, 100.0 * inverse(cond, size(qdd)))
    # The way back.
    again = turned.rerooted(scene.link_names[0])
    there, t = mapped(scene, again, scene.link_names[0], q)
    assert_near(t.T @ again.mass_matrix(there) @ t, mass, product(1000, 10.0 * size(mass)))


@pytest.mark.parametrize("seed", range(3))
def test_a_robot_held_at_another_link(seed: int) -> None:
    """The free robot with the velocities of its base that hold the link at rest."""
    fixed, scene, random = robot(seed, False), robot(seed, True), np.random.default_rng(seed)
    link = links_of(scene)[2]
    turned = fixed.rerooted(link)
    q = scene.random_configuration(random)
    q[:7] = free(np.linalg.inv(scene.placement(np.concatenate([scene.neutral()[:7], q[7:]]), link)))
    assert_near(scene.placement(q, link), np.eye(4), product(100, 10.0))
    jacobian, names = scene.jacobian(q, link), fixed.joint_names
    held = np.concatenate([-np.linalg.solve(jacobian[:, :6], jacobian[:, 6:]), np.eye(fixed.nv)])
    held = held[:, [at - 6 for at in rows(scene, names)]]
    there = turned.neutral()
    at = rows(turned, names)
    there[[turned.q_index(name).start for name in names]] = q[[scene.q_index(name).start for name in names]]
    expected = held.T @ scene.mass_matrix(q) @ held
    assert_near(turned.mass_matrix(there)[np.ix_(at, at)], expected, product(1000, 100.0 * size(expected)))
    expected = held.T @ scene.gravity_torque(q)
    assert_near(turned.gravity_torque(there)[at], expected, product(1000, 100.0 * size(expected)))


def test_a_loop_between_links_remains() -> None:
    tree, random = robot(0, True), np.random.default_rng(1)
    one, other = tree.body_names[-1], tree.body_names[1]
    q = tree.random_configuration(2)
    length = float(np.linalg.norm(tree.placement(q, one)[:3, 3] - tree.placement(q, other)[:3, 3]))
    scene = tree.to_builder().connect("rod", "distance", one, other, other_xyz=(0, 0, 0), length=length).build()
    turned = scene.rerooted(one)
    there, t = mapped(scene, turned, one, q)
    qd, tau = scene.loops.project(q, random.normal(size=scene.nv)).qd, random.normal(size=turned.nv)
    assert turned.loops.names == ("rod",) and abs(turned.loops.error(there)[0]) < 1e-12
    qdd, found = scene.forward_dynamics(q, qd, t.T @ tau), turned.forward_dynamics(there, t @ qd, tau)
    names = scene.joint_names[1:]
    assert_near(found[rows(turned, names)], qdd[rows(scene, names)], 1e4 * product(scene.nv, size(qdd)))


def test_coupled_joints_remain() -> None:
    builder = phipsi.SceneBuilder().link("palm", 0.4, inertia=1e-3 * np.eye(3))
    for name, side, follows in (("left", 1, {}), ("right", -1, {"mimic": "left_joint", "mimic_multiplier": 0.5, "mimic_offset": 0.01})):
        builder.link(name, 0.1, (0, 0, 0.02), 1e-4 * np.eye(3))
        builder.joint(f"{name}_joint", "prismatic", "palm", name, xyz=(0, 0.02 * side, 0.05), axis=(0, side, 0), **follows)
    scene = builder.build(floating_base=True, mimic="couple")
    turned, q = scene.rerooted("right"), scene.random_configuration(1)
    there, t = mapped(scene, turned, "right", q)
    mass = scene.mass_matrix(q)
    assert_near(t.T @ turned.mass_matrix(there) @ t, mass, product(100, 10.0 * size(mass)))


def test_limits_losses_actuators_contacts_and_starts_come_with_it() -> None:
    builder = robot(0, True).to_builder().start({"joint2": 0.3, "root_joint": [0, 0, 1, 0, 0, 0, 1]}).start({"joint2": 0.1}, keyframe="low")
    scene = builder.contact("tip", "link8", friction=0.5).actuator("motor", "joint2", gear=10.0).build()
    turned = scene.rerooted(scene.link_names[-1])
    assert turned.contacts.names == ("tip",) and turned.actuators.names == ("motor",)
    for keyframe in (None, "low"):
        here, there = scene.placements(scene.initial(keyframe)), turned.placements(turned.initial(keyframe))
        assert all(np.allclose(there[name], pose, atol=1e-12) for name, pose in here.items())
    for of in ("damping", "friction", "armature"):
        names = scene.joint_names[1:]
        assert np.array_equal(getattr(turned, of)[rows(turned, names)], getattr(scene, of)[rows(scene, names)])
    assert turned.joint("joint2").lower == scene.joint("joint2").lower
    assert scene.rerooted(scene.link_names[0]).joint_names == scene.joint_names


def test_what_cannot_be_reversed_is_named() -> None:
    chain = phipsi.scenes.chain(3)
    with pytest.raises(ArgumentError, match='link: found "tool"|tool'):
        chain.rerooted("tool")
    for kind in ("planar", "universal", "spherical"):
        builder = phipsi.SceneBuilder().link("a", 1.0, inertia=np.eye(3)).link("b", 1.0, inertia=np.eye(3)).joint("odd", kind, "a", "b")
        with pytest.raises(ArgumentError, match=f'joint "odd" of type {kind}'):
            builder.build().rerooted("b")
        assert builder.build().rerooted("a").nv == builder.build().nv
    with pytest.raises(ArgumentError, match='contact "tip" of the base'):
        chain.to_builder().contact("tip", "link2", friction=0.5).build().rerooted("link2")
    with pytest.raises(ArgumentError, match='connection "pin" of the base'):
        chain.to_builder().connect("pin", "point", "link2").build().rerooted("link1")
    with pytest.raises(ArgumentError, match='velocities in the keyframe "fast"'):
        builder = chain.to_builder().start(qd={"j1": 1.0}, keyframe="fast")
        builder.build(floating_base=True).rerooted("link1")
    heavy = phipsi.SceneBuilder().link("world").link("box", 1.0, inertia=np.eye(3)).link("lid", 1.0, inertia=np.eye(3))
    heavy.joint("free", "floating", "world", "box", armature=0.1).joint("hinge", "revolute", "box", "lid")
    with pytest.raises(ArgumentError, match='free joint "free" with armature'):
        heavy.build().rerooted("lid")


def test_a_free_joint_of_a_file_carries_the_new_root() -> None:
    builder = phipsi.SceneBuilder().link("world").link("box", 1.0, inertia=np.eye(3)).link("lid", 2.0, (0.1, 0, 0), inertia=np.eye(3))
    builder.joint("free", "floating", "world", "box", xyz=(0, 0, 1)).joint("hinge", "revolute", "box", "lid", xyz=(0.2, 0, 0), axis=(0, 1, 0))
    scene = builder.start({"free": [0.3, 0, 0, 0, 0, 0, 1], "hinge": 0.4}).build()
    turned = scene.rerooted("lid")
    assert turned.joint("free").child == "lid" and turned.joint("free").parent == "world"
    for name, pose in scene.placements(scene.initial()).items():
        assert np.allclose(turned.placements(turned.initial())[name], pose, atol=1e-13)
