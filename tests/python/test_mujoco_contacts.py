"""Scene.from_mujoco(contacts="plane"): the points of geoms compared with MuJoCo's contacts, and robots on their floor."""

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
#: Distance of a cylinder's rim from the polygon of its points, relative to the radius.
SAGITTA = 1.0 - np.cos(np.pi / 8)


def model(kind: str = "sphere", floor: str = "", geom: str = "", more: str = "", tail: str = "") -> str:
    return MODEL.format(floor=floor, geom=f"{GEOMS[kind]} {geom}", more=more, tail=tail + ASSET * (kind == "mesh"))


def scene(text: str, **options: Any) -> phipsi.Scene:
    return phipsi.Scene.from_mujoco(text, contacts="plane", **options)


@pytest.mark.parametrize("kind", GEOMS)
def test_the_distance_is_that_of_mujoco(kind: str) -> None:
    """The smallest gap is the distance that mj_geomDistance finds, in random poses of the body; for a cylinder up to the rim."""
    text = model(kind)
    own, theirs = scene(text), mujoco.MjModel.from_xml_string(text)
    data, random = mujoco.MjData(theirs), np.random.default_rng(0)
    geom, plane = theirs.geom("geom").id, theirs.geom("floor").id
    for _ in range(20):
        data.qpos[:] = [*random.uniform(-1, 1, 2), random.uniform(2, 3), *random.normal(size=4)]
        mujoco.mj_kinematics(theirs, data)
        q, _ = phipsi.mujoco.to_state(own, data.qpos)
        normal = data.geom_xmat[plane].reshape(3, 3)[:, 2]
        expected = normal @ (data.geom_xpos[geom] - data.geom_xpos[plane]) - support(theirs, data, geom, -normal)
        found = float(own.contact_gaps(q / np.where(np.arange(7) < 3, 1.0, np.linalg.norm(q[3:]))).min())
        if kind == "cylinder":
            assert expected - 1e-12 <= found <= expected + SAGITTA * 0.1
        else:
            assert_near(found, expected, 64 * EPS * 10 if kind != "mesh" else 1e-6)  # MuJoCo stores vertices as float32


def support(model: Any, data: Any, geom: int, direction: np.ndarray) -> float:
    """Largest distance of the geom from its center along a direction, from the definition of each kind."""
    turn, size = data.geom_xmat[geom].reshape(3, 3), model.geom_size[geom]
    local, kind = turn.T @ direction, mujoco.mjtGeom(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return float(size[0] + size[1] * abs(local[2]))
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
    (contact,) = own._contacts()
    assert contact[6] == friction
    data = mujoco.MjData(theirs)
    data.qpos[2] = 0.45
    mujoco.mj_forward(theirs, data)
    assert data.ncon == 1
    if data.contact[0].dim > 1:
        assert data.contact[0].friction[0] == friction


def test_margins_raise_the_floor() -> None:
    text = model("sphere", 'margin="0.02"', 'margin="0.03"')
    theirs = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(theirs)
    data.qpos[2] = 0.45
    mujoco.mj_forward(theirs, data)
    raised = scene(model("sphere")).contact_gaps([0, 0, 1, 0, 0, 0, 1]) - scene(text).contact_gaps([0, 0, 1, 0, 0, 0, 1])
    assert_near(raised, [data.contact[0].includemargin], 64 * EPS)


def test_filters_are_those_of_mujoco() -> None:
    assert scene(model("sphere", 'contype="2" conaffinity="2"')).contact_names == ()
    excluded = model("sphere", tail='<contact><exclude body1="world" body2="body"/></contact>')
    assert scene(excluded).contact_names == ()
    paired = model("sphere", 'contype="0" conaffinity="0"', tail='<contact><pair geom1="floor" geom2="geom" friction="0.4 0.4 0 0 0"/></contact>')
    (contact,) = scene(paired)._contacts()
    assert contact[0] == "geom" and contact[6] == 0.4
    assert scene(model("sphere", tail='<option><flag contact="disable"/></option>')).contact_names == ()


PAIRS = """<mujoco><worldbody><geom name="block" type="box" size="0.3 0.2 0.1" pos="0.1 0 -0.5" euler="10 20 30"/>
<body name="a" pos="0 0 1"><freejoint/><geom name="ball" size="0.1" pos="0.05 0 0.02"/></body>
<body name="b" pos="1 0 1"><freejoint/><geom name="brick" type="box" size="0.1 0.2 0.3" euler="20 0 40" pos="0 0.1 0"/>
<geom name="knob" size="0.05" pos="0 0 0.4"/></body></worldbody><default><geom contype="0" conaffinity="0"/></default>
<contact><pair geom1="ball" geom2="brick" friction="0.4 0.4 0 0 0"/><pair geom1="knob" geom2="ball" condim="1"/>
<pair geom1="block" geom2="ball" margin="0.01"/>{more}</contact></mujoco>"""


def test_pairs_of_spheres_and_boxes_are_read() -> None:
    """The gaps are the distances that MuJoCo finds in random poses; the names are those of the sphere and of the other geom."""
    text = PAIRS.format(more="")
    own, theirs = scene(text), mujoco.MjModel.from_xml_string(text)
    data, random = mujoco.MjData(theirs), np.random.default_rng(2)
    given = {"ball on block": (1.0, 0.01), "ball on brick": (0.4, 0.0), "knob on ball": (0.0, 0.0)}
    assert {contact[0]: contact[6] for contact in own._contacts()} == {name: friction for name, (friction, _) in given.items()}
    compared = 0
    for _ in range(10):
        data.qpos[:] = random.normal(size=14)
        mujoco.mj_normalizeQuat(theirs, data.qpos)
        mujoco.mj_kinematics(theirs, data)
        q, _ = phipsi.mujoco.to_state(own, data.qpos)
        for name, gap in zip(own.contact_names, own.contact_gaps(q), strict=True):
            ends = [theirs.geom(end).id for end in name.split(" on ")]
            expected = mujoco.mj_geomDistance(theirs, data, *ends, 100.0, None) - given[name][1]
            if expected > 0.01:
                assert_near(gap, expected, 1e-6)
                compared += 1
    assert compared > 20


def test_pairs_of_two_boxes_warn() -> None:
    with pytest.warns(ModelWarning, match="each <pair> of spheres and boxes"):
        assert len(scene(PAIRS.format(more='<pair geom1="block" geom2="brick"/>')).contact_names) == 3


def test_without_the_argument_the_warning_names_it() -> None:
    with pytest.warns(ModelWarning, match='contacts="plane"'):
        assert phipsi.Scene.from_mujoco(model()).contact_names == ()


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (model("sphere", geom='condim="4"'), "condim 4"),
        (model("sphere", geom='condim="6"'), "condim 6"),
        (model("sphere", geom='solref="0.1 1"', floor='solref="0.1 1"'), "softer than MuJoCo's default"),
        (model("sphere", more='<body pos="1 0 1"><freejoint/><geom size="0.1"/></body>'), "only contacts with fixed planes"),
        (model("sphere").replace('type="sphere" size="0.2"', 'type="ellipsoid" size="0.1 0.2 0.3"'), "ellipsoids"),
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


def test_a_bad_argument() -> None:
    with pytest.raises(ArgumentError, match=r"contacts: found 'planes'; expected \"plane\" or None"):
        phipsi.Scene.from_mujoco(model(), contacts="planes")  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="contacts: found 'plane', which does not apply"):
        phipsi.load(phipsi.BUNDLED_ARM, contacts="plane")


def test_equality_constraints_and_contacts_act_together() -> None:
    tied = model(
        "sphere", more='<body name="other" pos="1 0 1"><freejoint/><geom size="0.1" contype="0" conaffinity="0"/></body>',
        tail='<equality><connect name="tie" body1="body" body2="other" anchor="0.5 0 0"/></equality>',
    )  # fmt: skip
    both = scene(tied)
    assert both.contact_names == ("geom",) and both.constraint_names == ("tie",)
    assert scene(tied, ignore=("equality",)).constraint_names == ()


def test_points_that_no_joint_moves_are_omitted() -> None:
    """A wheel whose geom is centered on a vertical axis cannot approach the floor."""
    text = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 0.2"><joint axis="0 0 1"/>
    <geom name="hub" size="0.1"/><geom name="arm" size="0.1" pos="0.3 0 0"/></body></worldbody></mujoco>"""
    assert scene(text).contact_names == ("arm",)


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
    assert np.all(robot.contact_gaps(q) > 0.0)
    with warnings.catch_warnings():
        # Knees of the humanoid and ankles of the ant start beyond their limits.
        warnings.simplefilter("ignore", LimitWarning)
        run = robot.simulate(q, np.zeros(robot.nv), dt=0.002, duration=1.5, record_every=25)
    gaps = robot.contact_gaps(run.q)
    assert -1e-6 < gaps.min() and gaps[-1].min() < 0.02
    assert run.contacts is not None and sum(force[-5:, 2].mean() for force in run.contacts.force.values()) > 0.5 * 9.81 * robot.total_mass


def start(model: Any) -> np.ndarray:
    """The first configuration of the environment, that of the file or its init_qpos; free robots start 0.1 m higher."""
    known = [model.numeric(at).data for at in range(model.nnumeric) if model.numeric(at).name == "init_qpos"]
    qpos = np.array(known[0] if known else model.qpos0)
    if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE:
        qpos[2] += 0.1
    return qpos
