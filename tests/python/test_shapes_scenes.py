"""Scenes of shapes with known answers, and compared with MuJoCo: rolling, flush seams, stairs, a gripper, dominoes."""

from __future__ import annotations

from typing import Any

import numpy as np
import phipsi
import pytest
from phipsi import shapes
from test_shapes_touch import at, free, on_ground

G = 9.81


def quaternion(turn: np.ndarray) -> np.ndarray:
    """(x, y, z, w) of a rotation vector."""
    angle = float(np.linalg.norm(turn))
    return np.r_[np.sin(angle / 2) * turn / angle, np.cos(angle / 2)]


# Rolling


def steady_coin(radius: float, thickness: float, tilt: float, precession: float) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """A uniform disk of 1 kg that rolls on its rim in a circle: orientation, spin about the axis relative to the precession,
    velocity and angular velocity, from Euler's equations. The axis is tilted from the vertical.
    """
    across, spread = radius**2 / 4 + thickness**2 / 12, radius**2 / 4 - thickness**2 / 12
    axis = np.array([0.0, np.sin(tilt), np.cos(tilt)])
    up = np.array([0.0, 0.0, 1.0])
    out = -up + axis * axis[2]
    arm = radius * out / np.linalg.norm(out) - 0.5 * thickness * axis

    def moment(spin: float) -> float:
        turning = precession * up + spin * axis
        force = precession * np.cross(up, -np.cross(turning, arm)) + G * up
        momentum = across * turning + spread * (turning @ axis) * axis
        return float((np.cross(arm, force) - precession * np.cross(up, momentum))[0])

    # Linear in the spin.
    spin = -moment(0.0) / (moment(1.0) - moment(0.0))
    turning = precession * up + spin * axis
    return np.stack([[1.0, 0, 0], np.cross(axis, [1.0, 0, 0]), axis], axis=1), spin, -np.cross(turning, arm), turning


def test_a_coin_rolls_on_its_rim_in_a_circle() -> None:
    """The steady motion of the closed form, for the center and the axis, of order 1 in the step."""
    radius, thickness, tilt, precession, duration = 0.1, 0.02, np.radians(60.0), 3.0, 0.5
    place, _, velocity, turning = steady_coin(radius, thickness, tilt, precession)
    scene = on_ground(("coin", shapes.Cylinder(radius, thickness)))
    height = radius * np.sin(tilt) + 0.5 * thickness * np.cos(tilt)
    q = np.r_[0.0, 0.0, height, quaternion(np.array([-tilt, 0.0, 0.0]))]
    found = []
    for steps in (250, 500):
        path = scene.simulate(q, np.r_[place.T @ velocity, place.T @ turning], dt=duration / steps, steps=steps)
        assert path.contacts.converged
        found.append(np.r_[path.q[-1, :3], scene.placement(path.q[-1], "coin")[:3, 2]])
    angle = precession * duration
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    center = np.cross([0.0, 0.0, 1.0], velocity) / precession
    expected = np.r_[center - turn @ center + [0.0, 0.0, height], turn @ place[:, 2]]
    errors = [np.abs(one - expected).max() for one in found]
    assert errors[1] < 0.55 * errors[0] < 0.02
    # Extrapolated to zero: an error of order 2.
    assert np.abs(2 * found[1] - found[0] - expected).max() < 1e-3


ROUND = {
    "ball": shapes.Sphere(0.1), "capsule": shapes.Capsule(0.1, 0.33, rpy=(np.pi / 2, 0, 0)), "cylinder": shapes.Cylinder(0.1, 0.33, rpy=(np.pi / 2, 0, 0)),
}  # fmt: skip


def tiles(kind: str) -> phipsi.SceneBuilder:
    """Flat ground in pieces: boxes, hulls, or the triangles of a height field."""
    builder = phipsi.SceneBuilder().link("world")
    if kind == "heights":
        return builder.collider("ground", shapes.HeightField(np.zeros((11, 11)), (2.0, 2.0)))
    corners = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.5, 0.5) for z in (-0.05, 0.05)])
    for i in range(10):
        place = (0.2 * i - 0.9, 0.0, -0.05)
        builder.collider(f"tile{i}", shapes.Box((0.2, 1.0, 0.1), xyz=place) if kind == "box" else shapes.Hull(corners, xyz=place))
    return builder


@pytest.mark.parametrize("ground", ["box", "hull", "heights"])
@pytest.mark.parametrize("name", ROUND)
def test_round_shapes_roll_over_flush_seams_as_over_a_plane(ground: str, name: str) -> None:
    scene = free("body", ROUND[name], builder=tiles(ground)).build()
    path = scene.simulate(at((-0.2, 0.03, 0.1)), [1.0, 0, 0, 0, 10.0, 0], dt=2e-3, steps=200)
    assert np.abs(path.q[:, 2] - 0.1).max() < 1e-9
    assert np.allclose(path.q[-1, :3], [0.2, 0.03, 0.1], rtol=0, atol=1e-7)


def test_a_ball_rests_on_both_sides_of_a_valley() -> None:
    """Each side carries m g / (2 cos), along its normal."""
    heights = np.abs(np.linspace(-1, 1, 9))[None, :] * 0.5 * np.ones((3, 1))
    builder = phipsi.SceneBuilder().link("world").collider("valley", shapes.HeightField(heights, (2.0, 1.0)), friction=0.0)
    scene = free("ball", shapes.Sphere(0.15), friction=0.0, builder=builder).build()
    q = at((0, 0.03, 0.15 * np.sqrt(1.25)))
    path = scene.simulate(q, np.zeros(6), dt=2e-3, steps=50)
    assert np.abs(path.q[-1] - q).max() < 1e-9
    of = path.contacts.shapes
    force = np.abs(of.force[of.row == 50])
    assert np.allclose(force, [[0.25 * G, 0.0, 0.5 * G]] * 2, rtol=0, atol=1e-8)


BODIES = {
    "ball": shapes.Sphere(0.1), "box": shapes.Box((0.3, 0.1, 0.05)), "capsule": shapes.Capsule(0.06, 0.2), "cylinder": shapes.Cylinder(0.1, 0.2),
    "hull": shapes.Hull([[x, 0.7 * y, 0.5 * z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)]),
}  # fmt: skip


@pytest.mark.parametrize("name", BODIES)
def test_bodies_tumble_over_rough_terrain_without_sinking_into_it(name: str) -> None:
    """Peaks, ridges and valleys; the distance of a height field is that of its nearest triangle."""
    heights = 0.06 * np.random.default_rng(5).standard_normal((9, 9))
    heights[[0, -1]] = heights[:, [0, -1]] = 0.5
    builder = phipsi.SceneBuilder().link("world").collider("terrain", shapes.HeightField(heights, (2.0, 2.0)))
    builder.link("body", mass=1.0, inertia=0.004 * np.eye(3)).joint("free", "floating", "world", "body")
    scene = builder.collider("body", BODIES[name], link="body").build()
    draw = np.random.default_rng(1)
    turn = draw.standard_normal(4)
    q = np.r_[0.0, 0.05, 0.4, turn / np.linalg.norm(turn)]
    path = scene.simulate(q, np.r_[0.3 * draw.standard_normal(3), 2 * draw.standard_normal(3)], dt=2e-3, steps=300)
    assert path.contacts.converged and path.contacts.depth < 1e-3
    assert scene.distances(path.q[::30]).distance.min() > -1e-4 and np.diff(path.energy().total).max() < 1e-4


def test_the_flat_end_of_a_cylinder_rests_on_a_ridge() -> None:
    heights = -0.5 * np.abs(np.linspace(-1, 1, 9))[None, :] * np.ones((3, 1))
    builder = phipsi.SceneBuilder().link("world").collider("ridge", shapes.HeightField(heights, (2.0, 1.0)))
    scene = free("body", shapes.Cylinder(0.1, 0.2), builder=builder).build()
    q = at((0, 0.2, 0.1))
    assert np.abs(scene.simulate(q, np.zeros(6), dt=2e-3, steps=40).q[-1] - q).max() < 1e-9


# Stairs


def stairs(friction: float = 0.5) -> phipsi.SceneBuilder:
    """Four steps of 0.1 m along x, each 0.3 m long, above the ground."""
    builder = phipsi.SceneBuilder().link("world").collider("ground", shapes.HalfSpace(), friction=friction)
    for i in range(4):
        height = 0.1 * (4 - i)
        builder.collider(f"step{i}", shapes.Box((0.3, 1.0, height), xyz=(0.3 * i, 0, height / 2)), friction=friction)
    return builder


LYING = (np.pi / 2, 0, 0)


@pytest.mark.parametrize("shape", [shapes.Box((0.1, 0.1, 0.1)), shapes.Sphere(0.05), shapes.Capsule(0.05, 0.1, rpy=LYING), shapes.Cylinder(0.05, 0.1, rpy=LYING)])
def test_bodies_come_down_stairs_in_their_plane(shape: Any) -> None:
    """Edges of steps touch along the common length, not in a point beside the center: nothing yaws."""
    scene = free("body", shape, friction=0.5, builder=stairs()).build()
    path = scene.simulate(at((0, 0.013, 0.45)), [1.5 if isinstance(shape, shapes.Box) else 0.5, 0, 0, 0, 0, 0], dt=2e-3, steps=600)
    assert path.q[-1, 2] < 0.36 and np.diff(path.energy().total).max() < 1e-9
    assert np.abs(path.q[:, 1] - 0.013).max() < 1e-9 and np.abs(path.qd[:, [3, 5]]).max() < 1e-7


def test_a_box_rests_on_the_stairs_where_that_of_mujoco_rests() -> None:
    mujoco = pytest.importorskip("mujoco")
    geoms = "".join(f'<geom type="box" size="0.15 0.5 {0.05 * (4 - i)}" pos="{0.3 * i} 0 {0.05 * (4 - i)}"/>' for i in range(4))
    text = f"""<mujoco><option timestep="0.0005" cone="elliptic" impratio="10"/><default><geom friction="0.5"/></default><worldbody>
    <geom type="plane" size="5 5 1"/>{geoms}<body pos="0 0 0.45"><freejoint/><geom type="box" size="0.05 0.05 0.05" mass="1"/></body></worldbody></mujoco>"""
    scene = phipsi.load(text, contacts="all")
    for speed in (0.7, 1.0):
        path = scene.simulate(scene.initial(), [speed, 0, 0, 0, 0, 0], dt=2e-3, steps=400)
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        data.qvel[0] = speed
        while data.time < 0.8:
            mujoco.mj_step(model, data)
        assert np.abs(path.qd[-1]).max() < 1e-9 and np.abs(data.qvel).max() < 1e-3
        assert np.abs(path.q[-1, :3] - data.qpos[:3]).max() < 2e-3


# A gripper, and dominoes

FINGER = " ".join(f"{x} {y} {z}" for z, inner in ((-0.03, -0.01), (0.05, -0.015)) for x in (inner, 0.01) for y in (-0.02, 0.02))
GRIPPER = f"""<mujoco><option timestep="0.001" cone="elliptic" impratio="10"/><asset><mesh name="finger" vertex="{FINGER}"/></asset>
<default><geom friction="0.8"/></default><worldbody><geom name="floor" type="plane" size="1 1 1"/>
<body name="hand" pos="0 0 0.06"><joint name="lift" type="slide" axis="0 0 1"/><inertial pos="0 0 0" mass="0.5" diaginertia="1e-3 1e-3 1e-3"/>
 <body pos="-0.06 0 0"><joint name="left" type="slide" axis="1 0 0"/><geom name="left" type="mesh" mesh="finger" mass="0.05"/></body>
 <body pos="0.06 0 0" quat="0 0 0 1"><joint name="right" type="slide" axis="1 0 0"/><geom name="right" type="mesh" mesh="finger" mass="0.05"/></body></body>
<body pos="0 0 0.03"><freejoint/><geom name="object" OBJECT mass="0.2"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("kind", ['type="box" size="0.03 0.03 0.03"', 'type="sphere" size="0.03"', 'type="cylinder" size="0.03 0.03"'])
def test_a_gripper_with_mesh_fingers_lifts_as_in_mujoco(kind: str) -> None:
    """2 mu N carries the weight; the object rises with the hand, in MuJoCo less the creep of its soft friction."""
    mujoco = pytest.importorskip("mujoco")
    text = GRIPPER.replace("OBJECT", kind)
    scene = phipsi.load(text, contacts="all")
    simulator = scene.simulator(scene.initial(), np.zeros(scene.nv), dt=4e-3)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)

    def forces(time: float, height: float, speed: float) -> list[float]:
        """The fingers close with 4 N each; after 0.2 s the hand rises by 40 mm."""
        rises = time >= 0.2
        target = min(0.1 * (time - 0.2), 0.04) if rises else 0.0
        return [400.0 * (target - height) - 40.0 * speed + (0.6 + 0.2 * rises) * G, 4.0, 4.0]

    for i in range(200):
        simulator.step(np.r_[forces(4e-3 * i, simulator.q[0], simulator.qd[0]), np.zeros(6)])
        for k in range(4):
            data.qfrc_applied[:3] = forces(4e-3 * i + 1e-3 * k, data.qpos[0], data.qvel[0])
            mujoco.mj_step(model, data)
    rise = simulator.q[0]
    assert rise > 0.038 and abs(rise - data.qpos[0]) < 5e-4
    assert abs(simulator.q[5] - 0.03 - rise) < 1e-6 and abs(simulator.q[5] - data.qpos[5]) < 2e-3
    assert np.abs(simulator.q[1:3] - data.qpos[1:3]).max() < 2e-3
    assert set(map(frozenset, simulator.contacts.shapes.pairs())) == {frozenset(("left", "object")), frozenset(("right", "object"))}


def test_dominoes_fall_in_a_row_as_in_mujoco() -> None:
    mujoco = pytest.importorskip("mujoco")
    bodies = "".join(f'<body pos="{0.1 * i} 0 0.1"><freejoint/><geom type="box" size=".01 .05 .1" mass="1"/></body>' for i in range(3))
    text = f"""<mujoco><option timestep="0.0005" cone="elliptic" impratio="10"/><default><geom friction="0.6"/></default><worldbody>
    <geom type="plane" size="5 5 1"/>{bodies}</worldbody></mujoco>"""
    scene = phipsi.load(text, contacts="all")
    push = np.zeros(18)
    push[[0, 4]] = 0.25, 2.5
    path = scene.simulate(scene.initial(), push, dt=2e-3, steps=350)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qvel[:] = push
    while data.time < 0.7:
        mujoco.mj_step(model, data)
    assert path.contacts.converged and np.abs(path.qd[-1]).max() < 1e-6
    found, expected = path.q[-1].reshape(3, 7), data.qpos.reshape(3, 7)
    # Impacts are inelastic and instantaneous, those of MuJoCo are soft.
    assert np.abs(found[:, :3] - expected[:, :3]).max() < 0.015
    assert np.abs(found[:, 4] - expected[:, 5]).max() < 0.02


def test_ten_bricks_that_are_flush_stay() -> None:
    brick = shapes.Box((0.2, 0.1, 0.06))
    scene = on_ground(*((f"b{i}", brick) for i in range(10)))
    for places in ([(0.2 * i, 0, 0.03) for i in range(10)], [(0, 0, 0.03 + 0.06 * i) for i in range(10)]):
        q = at(*places)
        path = scene.simulate(q, np.zeros(60), dt=2e-3, steps=5)
        assert np.abs(path.q[-1] - q).max() < 1e-9 and path.contacts.converged


def test_bits_do_not_depend_on_the_number_of_threads() -> None:
    scene = on_ground(("a", shapes.Box((0.2, 0.2, 0.2))), ("b", shapes.Cylinder(0.05, 0.1)))
    draw = np.random.default_rng(1)
    q = np.tile(at((0, 0, 0.11), (0.02, 0.01, 0.27)), (9, 1))
    qd = draw.standard_normal((9, 12))
    before, paths = phipsi.get_num_threads(), []
    try:
        for threads in (1, 3):
            phipsi.set_num_threads(threads)
            paths.append(scene.simulate(q, qd, dt=4e-3, steps=12))
    finally:
        phipsi.set_num_threads(before)
    one, other = paths
    assert np.array_equal(one.q, other.q) and np.array_equal(one.qd, other.qd)
    assert len(one.contacts.shapes.row) > 50 and np.array_equal(one.contacts.shapes.force, other.contacts.shapes.force)
    cotangent = np.ones_like(one.qd)
    assert np.array_equal(one.vjp(cotangent).qd, other.vjp(cotangent).qd)


@pytest.mark.parametrize("shape", [shapes.Sphere(0.1), shapes.Cylinder(0.1, 0.2), shapes.Capsule(0.1, 0.2, rpy=LYING), shapes.Box((0.2, 0.2, 0.2))])
@pytest.mark.parametrize("ground", [shapes.Box((4.0, 4.0, 0.2), xyz=(0, 0, -0.1)), shapes.HeightField(np.zeros((5, 5)), (4.0, 4.0))])
def test_one_kilometer_from_the_origin_shapes_slide_as_at_the_origin(shape: Any, ground: Any) -> None:
    ends, far = [], np.array([1000.0, -1000.0, 500.0])
    for origin in (np.zeros(3), far):
        moved = ground._replace(xyz=tuple(np.asarray(ground.xyz) + origin))
        builder = phipsi.SceneBuilder().link("world").collider("ground", moved, friction=0.3)
        scene = free("body", shape, friction=0.3, builder=builder).build()
        path = scene.simulate(at(origin + [0, 0, 0.1]), [1.0, 0.2, 0, 0, 0, 0], dt=2e-3, steps=50)
        ends.append(path.q[-1] - np.r_[origin, np.zeros(4)])
    assert np.abs(ends[1] - ends[0]).max() < 1e-8
