"""Scene.from_mujoco(contacts="plane"): shapes and parameters compared with MuJoCo's, and robots on their floor."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mujoco_models import shipped
from tolerances import EPS, assert_near

import phipsi
from phipsi.errors import ArgumentError, LimitWarning, ModelWarning, SceneError

mujoco = pytest.importorskip("mujoco")

import phipsi.mujoco  # noqa: E402

#: A free body with one geom above a tilted floor.
MODEL = """<mujoco><worldbody><geom name="floor" type="plane" size="5 5 1" pos="0.1 -0.2 0.3" euler="10 -20 0" {floor}/>
<body name="body" pos="0 0 1"><freejoint/><geom name="geom" pos="0.05 0.02 -0.01" euler="30 10 20" mass="1" {geom}/></body>
{more}</worldbody>{tail}</mujoco>"""
GEOMS = {
    "sphere": 'type="sphere" size="0.2"',
    "capsule": 'type="capsule" size="0.1 0.3"',
    "box": 'type="box" size="0.1 0.2 0.3"',
    "cylinder": 'type="cylinder" size="0.1 0.3"',
    "mesh": 'type="mesh" mesh="wedge"',
}
ASSET = '<asset><mesh name="wedge" vertex="0 0 0  0.5 0 0  0 0.4 0  0 0 0.3  0.1 0.1 0.05"/></asset>'


def model(kind: str = "sphere", floor: str = "", geom: str = "", more: str = "", tail: str = "") -> str:
    return MODEL.format(floor=floor, geom=f"{GEOMS[kind]} {geom}", more=more, tail=tail + ASSET * (kind == "mesh"))


def scene(text: str, **options: Any) -> phipsi.Scene:
    return phipsi.Scene.from_mujoco(text, contacts="plane", **options)


@pytest.mark.parametrize("kind", GEOMS)
def test_shapes_are_those_of_mujoco(kind: str) -> None:
    """Poses of the colliders at random states, and the largest extent of each along random directions."""
    text = model(kind)
    own, theirs = scene(text), mujoco.MjModel.from_xml_string(text)
    data, random = mujoco.MjData(theirs), np.random.default_rng(0)
    colliders = {name: (link, frame, solid) for name, link, frame, solid, *_ in own._collisions()[0]}
    for _ in range(20):
        data.qpos[:] = [*random.uniform(-1, 1, 2), random.uniform(2, 3), *random.normal(size=4)]
        mujoco.mj_normalizeQuat(theirs, data.qpos)
        mujoco.mj_kinematics(theirs, data)
        places = own.placements(phipsi.mujoco.to_state(own, data.qpos)[0])
        link, (turn, origin), (solid, *_) = colliders["floor"]
        floor = places[link][:3, :3] @ np.reshape(turn, (3, 3))
        assert solid == "half space" and np.allclose(floor[:, 2], data.geom_xmat[0].reshape(3, 3)[:, 2], atol=1e-14)
        assert abs(floor[:, 2] @ (origin - data.geom_xpos[0])) < 1e-14
        link, (turn, origin), solid = colliders["geom"]
        direction = random.normal(size=3)
        along = np.reshape(turn, (3, 3)).T @ places[link][:3, :3].T @ direction
        found = direction @ (places[link] @ [*origin, 1.0])[:3] + extent(*solid, along)
        expected = direction @ data.geom_xpos[1] + support(theirs, data, 1, direction)
        assert_near(found, expected, 256 * EPS if kind != "mesh" else 1e-6)  # MuJoCo stores vertices as float32


def extent(kind: str, numbers: list[float], points: list[list[float]], direction: np.ndarray) -> float:
    """Largest distance of a solid from its origin along a direction."""
    across, along = np.hypot(*direction[:2]), abs(direction[2])
    if kind in ("sphere", "capsule"):
        return numbers[0] * float(np.linalg.norm(direction)) + (0.5 * numbers[1] * along if kind == "capsule" else 0.0)
    if kind == "cylinder":
        return float(numbers[0] * across + 0.5 * numbers[1] * along)
    return float(np.abs(direction) @ numbers / 2.0) if kind == "box" else float((np.array(points) @ direction).max())


def support(model: Any, data: Any, geom: int, direction: np.ndarray) -> float:
    """Largest distance of the geom from its center along a direction, from the definition of each kind."""
    turn, size = data.geom_xmat[geom].reshape(3, 3), model.geom_size[geom]
    local, kind = turn.T @ direction, mujoco.mjtGeom(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return float(size[0] * np.linalg.norm(local))
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return float(size[0] * np.linalg.norm(local) + size[1] * abs(local[2]))
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return float(np.abs(local) @ size)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return float(size[0] * np.hypot(*local[:2]) + size[1] * abs(local[2]))
    return float((model.mesh_vert @ local).max())


@pytest.mark.parametrize(
    ("floor", "geom", "friction"),
    [
        ('friction="0.3 0.1 0.1"', 'friction="0.7 0.2 0.2"', 0.7),
        ('friction="0.3 0.1 0.1" priority="1"', 'friction="0.7 0.2 0.2"', 0.3),
        ('condim="1"', 'condim="1" friction="0.7 0.2 0.2"', 0.0),
    ],
)
def test_friction_is_that_of_mujoco(floor: str, geom: str, friction: float) -> None:
    """A sphere slides on the floor with the friction that MuJoCo combines."""
    text = model("sphere", floor, geom)
    own, theirs = scene(text), mujoco.MjModel.from_xml_string(text)
    ((_, found, _, _),) = own._touching()
    assert found == friction
    data = mujoco.MjData(theirs)
    data.qpos[2] = 0.45
    mujoco.mj_forward(theirs, data)
    assert data.ncon == 1
    if data.contact[0].dim > 1:
        assert data.contact[0].friction[0] == friction


def test_margins_are_those_of_mujoco() -> None:
    text = model("sphere", 'margin="0.02"', 'margin="0.03"')
    theirs = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(theirs)
    data.qpos[2] = 0.45
    mujoco.mj_forward(theirs, data)
    ((_, _, _, margin),) = scene(text)._touching()
    assert_near(margin, data.contact[0].includemargin, 64 * EPS)


def test_filters_are_those_of_mujoco() -> None:
    assert scene(model("sphere", 'contype="2" conaffinity="2"'))._touching() == []
    excluded = model("sphere", tail='<contact><exclude body1="world" body2="body"/></contact>')
    assert scene(excluded)._touching() == []
    paired = model("sphere", 'contype="0" conaffinity="0"', tail='<contact><pair geom1="floor" geom2="geom" friction="0.4 0.4 0 0 0"/></contact>')
    assert scene(paired)._touching() == [(["floor", "geom"], 0.4, 0.0, 0.0)]
    assert scene(model("sphere", tail='<option><flag contact="disable"/></option>')).collider_names == ()


PAIRS = """<mujoco><worldbody><geom name="block" type="box" size="0.3 0.2 0.1" pos="0.1 0 -0.5" euler="10 20 30"/>
<body name="a" pos="0 0 1"><freejoint/><geom name="ball" size="0.1" pos="0.05 0 0.02"/></body>
<body name="b" pos="1 0 1"><freejoint/><geom name="brick" type="box" size="0.1 0.2 0.3" euler="20 0 40" pos="0 0.1 0"/>
<geom name="knob" size="0.05" pos="0 0 0.4"/></body></worldbody><default><geom contype="0" conaffinity="0"/></default>
<contact><pair geom1="ball" geom2="brick" friction="0.4 0.4 0 0 0"/><pair geom1="knob" geom2="ball" condim="1"/>
<pair geom1="block" geom2="ball" margin="0.01"/>{more}</contact></mujoco>"""


def test_each_pair_is_read() -> None:
    """With contacts="plane", and of boxes too."""
    text = PAIRS.format(more='<pair geom1="block" geom2="brick"/>')
    found = {frozenset(names): (friction, margin) for names, friction, _, margin in scene(text)._touching()}
    given = {("ball", "block"): (1.0, 0.01), ("ball", "brick"): (0.4, 0.0), ("knob", "ball"): (0.0, 0.0), ("block", "brick"): (1.0, 0.0)}
    assert found == {frozenset(names): values for names, values in given.items()}


def test_without_the_argument_the_warning_names_it() -> None:
    with pytest.warns(ModelWarning, match='contacts="all"'):
        assert phipsi.Scene.from_mujoco(model()).collider_names == ()


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (model("sphere", geom='condim="4"'), "condim 4"),
        (model("sphere", geom='condim="6"'), "condim 6"),
        (model("sphere", geom='solref="0.1 1"', floor='solref="0.1 1"'), "softer or less damped than MuJoCo's default"),
        (model("sphere", tail='<option o_solref="-10000 0"><flag override="enable"/></option>'), "softer or less damped"),
        (model("sphere", tail='<contact><pair geom1="floor" geom2="geom" friction="1 1 0 0 0" solreffriction="0.5 1"/></contact>'), "softer or less damped"),
        (model("sphere", geom='adhesion="2"', floor='adhesion="3"'), "adhesion 5 N of the contact of 'floor' and 'geom'"),
        (model("sphere", geom='adhesion="2"', floor='adhesion="3" priority="1"'), "adhesion 3 N"),
        (model("sphere", tail='<contact><pair geom1="floor" geom2="geom" friction="1 1 0 0 0" adhesion="4"/></contact>'), "adhesion 4 N"),
        (model("sphere", floor='surfacevel="0.3 0 0 0 0 0"'), r"surface velocity \(surfacevel\) of the contact of 'floor' and 'geom'"),
        (model("sphere", geom='surfacevel="0 0 0 0 0 2"', tail='<contact><pair geom1="floor" geom2="geom" friction="1 1 0 0 0"/></contact>'), "surface velocity"),
        (model("sphere", more='<body pos="1 0 1"><freejoint/><geom size="0.1"/></body>'), "only contacts with fixed planes"),
        (model("sphere").replace('type="sphere" size="0.2"', 'type="ellipsoid" size="0.1 0.2 0.3"'), "the geom 'geom', an ellipsoid: it touches nothing"),
        (
            model("sphere", tail='<contact><pair geom1="floor" geom2="geom" condim="3" friction="0.4 0.5 0 0 0"/></contact>'),
            "friction 0.4 and 0.5",
        ),
    ],
)
def test_unsupported_contacts_warn_or_raise(text: str, match: str) -> None:
    with pytest.warns(ModelWarning, match=match):
        scene(text)
    with pytest.raises(SceneError, match=match):
        scene(text, strict=True)


@pytest.mark.parametrize(
    "text",
    [
        model("sphere", geom='adhesion="2"', floor='priority="1"'),
        model("sphere", geom='adhesion="2"', tail='<contact><pair geom1="floor" geom2="geom" friction="1 1 0 0 0"/></contact>'),
        model("sphere", more='<geom size="0.1" contype="0" conaffinity="0" surfacevel="1 0 0 0 0 0" adhesion="1"/>'),
        model("sphere", geom='solref="-1000 5"', floor='solref="-1000 5"'),
    ],
)
def test_what_does_not_act_does_not_warn(text: str) -> None:
    assert scene(text, strict=True)._touching() == [(["floor", "geom"], 1.0, 0.0, 0.0)]


PARAMETERS = [("", f'solref="{of}"') for of in ("0.02 1", "0.005 1", "0.02 0.9", "0.001 0.2", "0.1 1", "0.05 2", "-10000 -250", "-10000 -20", "-10000 0", "-500 -50", "-1000 5")]
PARAMETERS += [(f'solimp="{of}"', "") for of in ("0.9 0.99 0.001", "0.015 1 0.036", "0.99 0.99 0.1", "0 0.99 0.01", "0.5 0.8 0.001", "0.9 0.99 0.002 0.4 3", "0.9 0.97 0.02 0.1 1")]
PARAMETERS += [('solimp="0.99 0.99 0.001"', 'solref="0.01 1"'), ('solimp="0.5 0.5 0.001"', 'solref="0.01 1"'), ('solimp="0.99 0.99 0.001"', 'solref="-3000 -110"')]


@pytest.mark.parametrize(("solimp", "solref"), PARAMETERS)
def test_constraints_that_bounce_or_sink_more_than_by_default_warn(solimp: str, solref: str) -> None:
    """A sphere on its floor in MuJoCo: how far it sinks at rest and in an impact, and how fast it rises then, beside the
    default.
    """
    text = f"""<mujoco><option timestep="1e-5"/><default><geom {solimp} {solref}/></default><worldbody><geom type="plane" size="1 1 1"/>
    <body pos="0 0 0.1"><joint type="slide" axis="0 0 1"/><geom size="0.1"/></body></worldbody></mujoco>"""

    def motion(text: str) -> np.ndarray:
        data = mujoco.MjData(theirs := mujoco.MjModel.from_xml_string(text))
        theirs.opt.gravity[:], theirs.opt.timestep = [0.0, 0.0, -100.0], 1e-4
        for _ in range(20000):
            mujoco.mj_step(theirs, data)
        rest = -float(data.qpos[0])
        theirs.opt.gravity[:], theirs.opt.timestep = 0.0, 1e-5
        mujoco.mj_resetData(theirs, data)
        data.qpos[0], data.qvel[0], depth, speed = 1e-4, -1.0, 0.0, 0.0
        while data.time < 0.15 and data.qpos[0] < 1e-3:
            mujoco.mj_step(theirs, data)
            depth, speed = max(depth, -float(data.qpos[0])), max(speed, float(data.qvel[0]))
        return np.array([rest, depth, speed])

    share = motion(text) / motion(text.replace(solimp, "").replace(solref, ""))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene(text)
    assert [str(one.message)[:60] for one in caught if "softer or less damped" in str(one.message)][1:] == []
    assert bool(caught) == (share.max() > 1.06), share


def test_height_fields_have_the_surface_of_mujoco() -> None:
    """Rays of MuJoCo meet the surface, at distance zero of phipsi: not square, turned, each cell with its diagonal."""
    text = """<mujoco><asset><hfield name="hills" nrow="4" ncol="6" size="1.2 0.7 0.4 0.1"/></asset><worldbody>
    <geom name="hills" type="hfield" hfield="hills" pos="0.1 -0.2 0.3" euler="10 -20 50"/>
    <body><freejoint/><geom name="probe" size="0.01"/></body></worldbody></mujoco>"""
    theirs, random = mujoco.MjModel.from_xml_string(text), np.random.default_rng(0)
    theirs.hfield_data[:] = random.uniform(size=24)
    data, own = mujoco.MjData(theirs), phipsi.load(theirs, contacts="all")
    data.qpos[2] = -9.0
    mujoco.mj_forward(theirs, data)
    frame, met = data.geom_xmat[0].reshape(3, 3), np.zeros(1, np.int32)
    for x, y in random.uniform(-0.99, 0.99, (200, 2)):
        start = data.geom_xpos[0] + frame @ [1.2 * x, 0.7 * y, 1.0]
        point = start - mujoco.mj_ray(theirs, data, start, -frame[:, 2], None, 1, -1, met, None) * frame[:, 2]
        assert met[0] == 0
        assert_near(own.distances([*point, 0, 0, 0, 1]).distance, [-0.01], 1e-9)


@pytest.mark.parametrize("more", ['<geom type="plane" size="5 5 1"/>', '<geom type="hfield" hfield="hills" pos="0.5 0 0"/>', ""])
@pytest.mark.parametrize("base", [0.4, 1.2])
def test_a_height_field_with_space_below_warns(more: str, base: float) -> None:
    """A ball passes below it in MuJoCo, if its base does not fill the space; here it would be moved above."""
    text = f"""<mujoco><asset><hfield name="hills" nrow="2" ncol="2" size="1 1 0.1 {base}" elevation="0 0 0 1"/></asset><worldbody>
    <geom name="roof" type="hfield" hfield="hills" pos="0 0 1"/>{more}<body pos="0 0 0.3"><freejoint/><geom size="0.1"/></body></worldbody></mujoco>"""
    theirs = mujoco.MjModel.from_xml_string(text)
    mujoco.mj_forward(theirs, data := mujoco.MjData(theirs))
    is_free = bool(more) and data.ncon == 0
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        phipsi.load(text, contacts="all")
    assert ["'roof' with space below: it fills" in str(one.message) for one in caught] == [True] * is_free
    assert bool(data.ncon) == (base > 0.7)


def test_a_bad_argument() -> None:
    with pytest.raises(ArgumentError, match=r"contacts: found 'planes'; expected \"all\", \"plane\" or None"):
        phipsi.Scene.from_mujoco(model(), contacts="planes")  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="contacts: found 'planes'"):
        phipsi.load(phipsi.BUNDLED_ARM, contacts="planes")  # type: ignore[arg-type]


def test_equality_constraints_and_contacts_act_together() -> None:
    tied = model(
        "sphere", more='<body name="other" pos="1 0 1"><freejoint/><geom size="0.1" contype="0" conaffinity="0"/></body>',
        tail='<equality><connect name="tie" body1="body" body2="other" anchor="0.5 0 0"/></equality>',
    )  # fmt: skip
    both = scene(tied)
    assert both.collider_names == ("floor", "geom") and both.loops.names == ("tie",)
    assert scene(tied, ignore=("equality",)).loops.names == ()


ROBOTS = [path for path in shipped() if path.stem in ("ant", "half_cheetah", "hopper", "humanoid", "walker2d")]


@pytest.mark.skipif(not ROBOTS, reason="Gymnasium is not installed")
@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_robots_of_gymnasium_stay_on_their_floor(path: Path) -> None:
    """Dropped onto the floor, passive: no point sinks into it, and at the end some point touches it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        robot = scene(str(path))
    model = mujoco.MjModel.from_xml_path(str(path))
    q, _ = phipsi.mujoco.to_state(robot, start(model))
    margin = np.array([margin for *_, margin in robot._touching()])
    assert np.all(robot.distances(q).distance > margin)
    with warnings.catch_warnings():
        # Knees of the humanoid and ankles of the ant start beyond their limits.
        warnings.simplefilter("ignore", LimitWarning)
        run = robot.simulate(q, np.zeros(robot.nv), dt=0.002, duration=1.5, record_every=25)
    gaps = robot.distances(run.q).distance - margin
    assert -1e-6 < gaps.min() and gaps[-1].min() < 0.02
    assert run.contacts is not None
    of = run.contacts.shapes
    on_robot = np.where(of.pair[:, 0] == robot.collider_names.index("floor"), -1.0, 1.0) * of.force[:, 2]
    assert on_robot[of.row >= len(run) - 5].sum() / 5 > 0.5 * 9.81 * robot.total_mass


def start(model: Any) -> np.ndarray:
    """The first configuration of the environment, that of the file or its init_qpos; free robots start 0.1 m higher."""
    known = [model.numeric(at).data for at in range(model.nnumeric) if model.numeric(at).name == "init_qpos"]
    qpos = np.array(known[0] if known else model.qpos0)
    if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE:
        qpos[2] += 0.1
    return qpos
