"""Colliders of files: the pairs that can touch, with friction and margin, are those of MuJoCo; shapes of `<collision>`."""

from __future__ import annotations

import itertools
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mujoco_models import shipped
from tolerances import EPS, assert_near

import phipsi
from phipsi.errors import ArgumentError, MeshWarning, ModelWarning, SceneError

mujoco = pytest.importorskip("mujoco")

import phipsi.mujoco  # noqa: E402

MESH = '<asset><mesh name="wedge" vertex="-0.5 -0.4 -0.3  0.7 0 0  0 0.6 0  0 0 0.5  0.1 0.1 0.05"/></asset>'
KINDS = ('type="sphere" size="0.5"', 'type="capsule" size="0.4 0.3"', 'type="box" size="0.3 0.5 0.4"', 'type="cylinder" size="0.5 0.4"', 'type="mesh" mesh="wedge"')

Touching = dict[frozenset[str], tuple[float, float]]


def read(text: Any, contacts: Any = "all", **options: Any) -> phipsi.Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        return phipsi.load(text, contacts=contacts, **options)


def touching(scene: phipsi.Scene) -> Touching:
    return {frozenset(names): (friction, margin) for names, friction, _, margin in scene._touching()}


def by_mujoco(model: Any, *, planes: bool = False) -> Touching:
    """Pairs that collide in MuJoCo at qpos0, where the geoms overlap, with sliding friction and margin."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found = {}
    explicit = {frozenset((int(model.pair_geom1[at]), int(model.pair_geom2[at]))) for at in range(model.npair)}
    for contact in data.contact[: data.ncon]:
        ends = frozenset(map(int, contact.geom))
        if planes and ends not in explicit and not any(model.geom_type[end] == mujoco.mjtGeom.mjGEOM_PLANE for end in ends):
            continue
        names = frozenset(model.geom(end).name or f"geom{end}" for end in ends)
        # MuJoCo raises a friction of zero to 1e-5.
        friction = float(contact.friction[0]) if contact.dim > 1 and contact.friction[0] > 1e-5 else 0.0
        found[names] = (friction, float(contact.includemargin))
    return found


def overlapping(seed: int) -> str:
    """A model whose geoms all overlap at qpos0: welded bodies, bodies with up to three joints, and every rule of contacts."""
    draw = np.random.default_rng(seed)
    names = itertools.count()

    def numbers(size: int, scale: float) -> str:
        return " ".join(f"{value:.17g}" for value in scale * draw.standard_normal(size))

    def geom(kind: str) -> str:
        rules = {
            "friction": f"{draw.choice([0.0, 0.3, 1.0, 1.5])} 0.01 0.001", "condim": draw.choice([1, 3, 3, 4]), "priority": draw.choice([-1, 0, 0, 0, 2]),
            "contype": draw.choice([0, 1, 2, 3, -1, 1 << 30, -(1 << 31)]), "conaffinity": draw.choice([0, 1, 2, 3, -1, 1 << 30, -(1 << 31)]),
            "margin": draw.choice([0.0, 0.02, 0.125]), "gap": 0.0,
        }  # fmt: skip
        rules["gap"] = float(rules["margin"]) / 2 if draw.random() < 0.3 else 0.0
        return f'<geom name="g{next(names)}" {kind} mass="1" ' + " ".join(f'{name}="{value}"' for name, value in rules.items()) + "/>"

    bodies, children = int(draw.integers(4, 9)), dict[int, list[str]]()
    for body in range(bodies, 0, -1):
        parent = int(draw.integers(0, body))
        joints = {0: "", 1: '<joint axis="0 1 0"/>', 2: '<joint axis="0 1 0"/><joint axis="1 0 0" pos="0.1 0 0"/>', 3: '<joint type="ball"/>'}[int(draw.integers(0, 4))]
        if parent == 0 and draw.random() < 0.5:
            joints = "<freejoint/>"
        inner = "".join(geom(f'{draw.choice(KINDS)} pos="{numbers(3, 0.05)}" quat="{numbers(4, 1.0)}"') for _ in range(draw.integers(0, 3)))
        text = f'<body name="b{body}" quat="{numbers(4, 1.0)}">{joints}<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{inner}{"".join(children.get(body, ()))}</body>'
        children.setdefault(parent, []).insert(0, text)
    world = geom(f'type="plane" size="1 1 1" quat="{numbers(4, 1.0)}"') + geom('type="plane" size="1 1 1"') + geom(str(draw.choice(KINDS)))
    count = next(names)
    excludes = "".join(f'<exclude body1="{one}" body2="{two}"/>' for one, two in [draw.choice(["world", *(f"b{i}" for i in range(1, bodies + 1))], 2, replace=False)])
    chosen = {tuple(sorted(draw.choice(count, 2, replace=False).tolist())) for _ in range(3)}
    pairs = "".join(f'<pair geom1="g{i}" geom2="g{j}" friction="{draw.choice([0.2, 0.9])} 0.2 0 0 0" condim="{draw.choice([1, 3])}" margin="0.03"/>' for i, j in chosen)
    flags = f'filterparent="{draw.choice(["enable", "disable"])}" override="{draw.choice(["enable", "disable", "disable"])}"'
    option = f'<option o_margin="0.25" o_friction="0.7 0.7 0.01 0.001 0.001"><flag {flags}/></option>'
    return f"<mujoco>{option}{MESH}<worldbody>{world}{''.join(children.get(0, ()))}</worldbody><contact>{excludes}{pairs}</contact></mujoco>"


@pytest.mark.parametrize("seed", range(60))
def test_pairs_of_random_models_are_those_of_mujoco(seed: int) -> None:
    """contype, conaffinity, parent and child, exclude, pair, priority, condim, margin, gap and override."""
    text = overlapping(seed)
    model = mujoco.MjModel.from_xml_string(text)
    # A plane and a plane do not collide in MuJoCo, and a <pair> of two geoms that cannot move has no effect.
    rigid = {model.geom(geom).name: int(model.body_weldid[model.geom_bodyid[geom]]) for geom in range(model.ngeom)}
    for contacts in ("all", "plane"):
        found, expected = touching(read(text, contacts)), by_mujoco(model, planes=contacts == "plane")
        expected = {names: values for names, values in expected.items() if len({rigid[name] for name in names}) == 2}
        assert found.keys() == expected.keys()
        for names, values in expected.items():
            assert_near(found[names], values, 4 * EPS)


def test_mocap_bodies_do_not_touch_their_children() -> None:
    text = """<mujoco><worldbody><geom name="w" size="1"/><body mocap="true"><geom name="a" size="0.1"/><body><joint/><geom name="b" size="0.1"/></body></body>
    <body><freejoint/><geom name="f" size="0.1"/></body></worldbody></mujoco>"""
    expected = by_mujoco(mujoco.MjModel.from_xml_string(text))
    assert touching(read(text, ignore=["mocap"])) == expected and len(expected) == 4


def test_more_kinds_of_planes_than_groups_of_colliders() -> None:
    """With contacts="plane", 32 kinds of planes have groups; the pairs of others are named."""
    planes = "".join(f'<geom name="p{i}" type="plane" size="1 1 1" contype="{i}" conaffinity="0"/>' for i in range(1, 41))
    balls = "".join(f'<body><freejoint/><geom name="b{i}" size="0.1" contype="0" conaffinity="{1 << i}"/></body>' for i in range(6))
    text = f"<mujoco><worldbody>{planes}{balls}</worldbody></mujoco>"
    expected = by_mujoco(mujoco.MjModel.from_xml_string(text), planes=True)
    assert touching(read(text, "plane")) == expected and len(expected) > 80


@pytest.mark.parametrize("path", [path for path in shipped() if path.stem in ("ant", "humanoid", "pusher", "walker2d")], ids=lambda path: path.stem)
def test_pairs_of_robots_of_gymnasium_are_those_of_mujoco(path: Path) -> None:
    """With spheres as geoms and a large margin, every pair that can touch is a contact of MuJoCo."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.geom_type[model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE] = mujoco.mjtGeom.mjGEOM_SPHERE
    model.geom_margin[:] = model.pair_margin[:] = 1e3
    if hasattr(model, "body_margin"):
        model.body_margin[:] = 1e3
    names = phipsi.mujoco.Names(model).geoms
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    expected = {frozenset(names[end] for end in contact.geom) for contact in data.contact[: data.ncon]}
    assert touching(read(path)).keys() == expected and len(expected) > 3


def test_fixed_shapes_of_the_world_and_height_fields_are_read() -> None:
    """Tables and steps touch what moves, not each other; the height field has MuJoCo's heights, turned by a quarter."""
    text = """<mujoco><asset><hfield name="hills" nrow="2" ncol="3" size="2 1 0.5 0.1" elevation="0 2 4  8 6 1"/></asset><worldbody>
    <geom name="hills" type="hfield" hfield="hills" pos="0 0 -1"/><geom name="table" type="box" size="1 1 0.1" pos="9 0 0"/>
    <body name="stand" pos="1 0 0"><geom name="leg" type="cylinder" size="0.1 0.4"/></body>
    <body pos="0 0 1"><freejoint/><geom name="ball" size="0.1"/></body></worldbody></mujoco>"""
    scene = read(text, strict=True)
    assert scene.collider_names == ("hills", "table", "leg", "ball")
    assert touching(scene).keys() == {frozenset((name, "ball")) for name in ("hills", "table", "leg")}
    (_, _, frame, (kind, numbers, _), *_), *others = scene._collisions()[0]
    assert kind == "height field" and frame[1] == [0.0, 0.0, -1.0] and [of[1] for of in others] == ["world", "stand", "body2"]
    assert numbers[:3] == [2.0, 2.0, 4.0]
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for column, row in itertools.product(range(3), range(2)):
        x, y = 0.999 * (-2.0 + 2.0 * column), 0.999 * (-1.0 + 2.0 * row)
        mujoco.mj_kinematics(model, data)
        distance = mujoco.mj_ray(model, data, [x, y, 1.0], [0.0, 0.0, -1.0], np.array([1, 0, 0, 0, 0, 0], np.uint8), 1, -1, np.zeros(1, np.int32))
        assert abs(2.0 - distance - numbers[3 + 2 * (2 - column) + row]) < 2e-3


@pytest.mark.parametrize(
    ("geom", "match"),
    [
        ('type="ellipsoid" size="0.1 0.2 0.3"', "the geom 'odd', an ellipsoid"),
        ('type="hfield" hfield="hills"', "the geom 'odd', a height field on a body that moves"),
        ('type="mesh" mesh="flat"', "the geom 'odd', a mesh whose vertices have no convex hull with a volume"),
    ],
)
def test_geoms_without_a_shape_are_named(geom: str, match: str) -> None:
    text = f"""<mujoco><asset><hfield name="hills" nrow="2" ncol="2" size="1 1 1 1"/>
    <mesh name="flat" vertex="0 0 0  1 0 0  0 1 0  1 1 1e-5" inertia="shell"/></asset><worldbody>
    <body pos="0 0 1"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><geom name="odd" {geom}/></body>
    <body pos="0 0 2"><freejoint/><geom name="ball" size="0.1"/></body></worldbody></mujoco>"""
    with pytest.warns(ModelWarning, match=match):
        assert phipsi.load(text, contacts="all").collider_names == ("ball",)
    with pytest.raises(SceneError, match=match):
        phipsi.load(text, contacts="all", strict=True)


def test_a_geom_whose_file_is_missing_touches_nothing(tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text(
        """<mujoco><asset><mesh name="lost" file="lost.stl"/></asset><worldbody><geom name="floor" type="plane" size="1 1 1"/>
        <body><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><geom name="lost" type="mesh" mesh="lost"/><geom name="ball" size="0.1"/></body></worldbody>
        <contact><pair geom1="lost" geom2="floor"/></contact></mujoco>"""
    )
    with pytest.warns(MeshWarning, match=r"lost\.stl.*touch nothing"):
        assert phipsi.load(tmp_path / "robot.xml", contacts="all").collider_names == ("floor", "ball")


# URDF

LINKS = """<link name="base"><collision><geometry><box size="1 0.5 0.2"/></geometry></collision></link>
<link name="arm"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
 <collision><origin xyz="0.1 0 0.2" rpy="0.1 0.2 0.3"/><geometry><cylinder radius="0.1" length="0.4"/></geometry></collision>
 <collision><origin quat_xyzw="0 0 0.7071067811865476 0.7071067811865476"/><geometry><capsule radius="0.05" length="0.3"/></geometry></collision>
 <contact><lateral_friction value="0.4"/><restitution value="0.2"/></contact></link>
<link name="pad"><collision><origin xyz="0 0 2"/><geometry><sphere radius="0.05"/></geometry></collision></link>
<link name="hand"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
 <collision><origin xyz="0 0 3"/><geometry><mesh filename="{mesh}" scale="2 1 -1"/></geometry></collision></link>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/></joint>
<joint name="glue" type="fixed"><parent link="arm"/><child link="pad"/></joint>
<joint name="wrist" type="continuous"><parent link="pad"/><child link="hand"/><axis xyz="0 1 0"/></joint>
<gazebo reference="hand"><mu1>0.7</mu1><mu2>0.7</mu2></gazebo>"""


def robot(folder: Path, links: str = LINKS) -> Path:
    (folder / "wedge.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    (folder / "robot.urdf").write_text(f'<robot name="r" version="1.1">{links.format(mesh="package://anywhere/wedge.obj")}</robot>')
    return folder / "robot.urdf"


def test_collision_elements_become_colliders(tmp_path: Path) -> None:
    scene = read(robot(tmp_path))
    found = {name: (link, solid, friction, restitution) for name, link, _, solid, friction, restitution, *_ in scene._collisions()[0]}
    assert found["ground"] == (None, ("half space", [], []), 0.0, 0.0)
    assert found["base"] == ("base", ("box", [1.0, 0.5, 0.2], []), 1.0, 0.0)
    assert found["arm/0"] == ("arm", ("cylinder", [0.1, 0.4], []), 0.4, 0.2)
    assert found["arm/1"] == ("arm", ("capsule", [0.05, 0.3], []), 0.4, 0.2)
    link, (kind, _, points), friction, _ = found["hand"]
    assert (link, kind, friction) == ("hand", "hull", 0.7)
    assert sorted(points) == [[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [2.0, 0.0, 0.0]]
    frames = {name: frame for name, _, frame, *_ in scene._collisions()[0]}
    place = phipsi.pose((0.1, 0, 0.2), rpy=(0.1, 0.2, 0.3))
    assert_near(np.reshape(frames["arm/0"][0], (3, 3)), place[:3, :3], 4 * EPS)
    assert_near(frames["arm/0"][1], place[:3, 3], 0.0)
    assert_near(np.reshape(frames["arm/1"][0], (3, 3)), [[0, -1, 0], [1, 0, 0], [0, 0, 1]], 8 * EPS)


def test_links_of_a_urdf_touch_the_ground_and_with_all_each_other(tmp_path: Path) -> None:
    """Links that a joint connects do not touch, nor those that are fixed to them; the ground has the friction of the link."""
    path, moving = robot(tmp_path), ("arm/0", "arm/1", "pad", "hand")
    on_ground = {frozenset(("ground", name)): friction for name, friction in zip((*moving, "base"), (0.4, 0.4, 1.0, 0.7, 1.0), strict=True)}
    free = {names: friction for names, (friction, _) in touching(read(path, "plane", floating_base=True)).items()}
    assert free == on_ground
    free = {names: friction for names, (friction, _) in touching(read(path, floating_base=True)).items()}
    assert free == {**on_ground, frozenset(("base", "hand")): 1.0}
    fixed = read(path)
    del on_ground[frozenset(("ground", "base"))]
    assert touching(fixed).keys() >= {frozenset(("base", "hand")), frozenset(("ground", "hand")), frozenset(("ground", "pad"))}
    assert not {frozenset(("base", name)) for name in moving[:3]} & touching(fixed).keys()


def test_links_that_overlap_at_the_neutral_configuration_do_not_touch(tmp_path: Path) -> None:
    """As in MoveIt; a warning names them."""
    links = LINKS.replace('<origin xyz="0 0 3"/>', '<origin xyz="0 0 0.05"/>')
    with pytest.warns(ModelWarning, match="overlap at the neutral configuration, of 'base' and 'hand'; these links"):
        scene = phipsi.load(robot(tmp_path, links), contacts="all", floating_base=True)
    assert frozenset(("base", "hand")) not in touching(scene) and frozenset(("ground", "hand")) in touching(scene)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (('<box size="1 0.5 0.2"/>', '<box size="1 0 0.2"/>'), "base: size of Box: found .*0.2"),
        (('<sphere radius="0.05"/>', '<sphere radius="0"/>'), "pad: radius of Sphere: found 0"),
        (('<box size="1 0.5 0.2"/>', '<box size="1 0.5"/>'), "base: size of <box>"),
        (('<sphere radius="0.05"/>', "<cone/>"), "pad: found no <geometry> with box"),
        (("{mesh}", "nowhere.stl"), "hand: no file 'nowhere.stl'"),
    ],
)
def test_shapes_of_a_urdf_that_cannot_be_read_are_named(tmp_path: Path, change: tuple[str, str], match: str) -> None:
    path = robot(tmp_path, LINKS.replace(*change))
    with pytest.warns(MeshWarning, match=match):
        assert len(phipsi.load(path, contacts="plane", floating_base=True).collider_names) == 5
    with pytest.raises(SceneError, match=match):
        phipsi.load(path, contacts="plane", strict=True)


def test_parameters_of_contacts_that_are_not_read_are_named(tmp_path: Path) -> None:
    path = robot(tmp_path, LINKS.replace('<restitution value="0.2"/>', '<rolling_friction value="0.1"/>'))
    with pytest.warns(ModelWarning, match="<rolling_friction> of 'arm'"):
        phipsi.load(path, contacts="plane", floating_base=True)


def test_invalid_contacts_of_a_urdf() -> None:
    with pytest.raises(ArgumentError, match="contacts: found 'points'; expected \"all\", \"plane\" or None"):
        phipsi.load(phipsi.BUNDLED_ARM, contacts="points")  # type: ignore[arg-type]


def test_shapes_of_a_xacro_are_read(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    (tmp_path / "ball.xacro").write_text(
        """<robot name="ball" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="radius" default="0.1"/>
        <link name="ball"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
        <collision><geometry><sphere radius="$(arg radius)"/></geometry></collision></link></robot>"""
    )
    scene = read(tmp_path / "ball.xacro", floating_base=True, xacro_arguments={"radius": "0.3"})
    assert scene._collisions()[0][1][3] == ("sphere", [0.3], []) and touching(scene).keys() == {frozenset(("ground", "ball"))}
    assert scene.file == tmp_path / "ball.xacro"


# Meshes

CORNERS = np.array(list(itertools.product((-0.1, 0.1), repeat=3)))
SIDES = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])
NAN = np.full((1, 3), np.nan)


def one_mesh(folder: Path, vertices: Any, triangles: Any) -> Path:
    """A link whose shape is a mesh."""
    lines = [f"v {x} {y} {z}\n" for x, y, z in vertices] + [f"f {' '.join(str(i + 1) for i in triangle)}\n" for triangle in triangles]
    (folder / "one.obj").write_text("".join(lines))
    link = '<link name="a"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    (folder / "robot.urdf").write_text(f'<robot name="r">{link}<collision><geometry><mesh filename="one.obj"/></geometry></collision></link></robot>')
    return folder / "robot.urdf"


@pytest.mark.parametrize(
    ("vertices", "triangles"),
    [
        (CORNERS, SIDES[:6]),
        (CORNERS, SIDES[:, ::-1]),
        (CORNERS, np.concatenate([SIDES, [[0, 0, 1], [1, 1, 1]]])),
        (np.concatenate([CORNERS, CORNERS]), np.concatenate([SIDES, SIDES + 8])),
        (np.concatenate([CORNERS, CORNERS + 1e-13]), np.concatenate([SIDES, SIDES + 8])),
        (np.concatenate([CORNERS, [[5, 5, 5]], NAN]), SIDES),
    ],
    ids=["open", "inverted", "degenerate triangles", "duplicate vertices", "almost equal vertices", "unused vertices"],
)
def test_meshes_with_defects_have_the_hull_of_their_triangles(tmp_path: Path, vertices: Any, triangles: Any) -> None:
    scene = phipsi.load(one_mesh(tmp_path, vertices, triangles), contacts="all", floating_base=True)
    for turn in (np.eye(4)[3], np.array([0.2, -0.5, 0.1, 0.8]) / np.linalg.norm([0.2, -0.5, 0.1, 0.8])):
        q = np.r_[0.0, 0.0, 5.0, turn]
        corners = CORNERS @ scene.placement(q, "a")[2, :3]
        assert abs(scene.distances(q).distance[0] - 5.0 - corners.min()) < 1e-12


@pytest.mark.parametrize(
    ("vertices", "triangles", "match"),
    [
        (np.concatenate([CORNERS, NAN]), np.concatenate([SIDES, [[0, 1, 8]]]), r"a vertex that is not finite in one\.obj"),
        (np.concatenate([CORNERS, np.inf * np.ones((1, 3))]), np.concatenate([SIDES, [[0, 1, 8]]]), r"a vertex that is not finite in one\.obj"),
        (CORNERS, SIDES[:0], r"no triangles in one\.obj"),
        (CORNERS[:3], [[0, 1, 2]], "3 points"),
        (CORNERS * [1, 1, 0], SIDES, "whose points have no volume"),
        (CORNERS * [1, 0, 0], SIDES, "points"),
        (CORNERS, [[0, 1, 99]], r"one\.obj cannot be read"),
    ],
    ids=["NaN", "infinite", "no triangles", "one triangle", "flat", "line", "wrong index"],
)
def test_meshes_without_a_hull_are_named(tmp_path: Path, vertices: Any, triangles: Any, match: str) -> None:
    """The link touches nothing; a shape of a builder is an error."""
    path = one_mesh(tmp_path, vertices, triangles)
    for contacts in ("all", "plane"):
        with pytest.warns(MeshWarning, match=f"a: .*{match}"):
            assert phipsi.load(path, contacts=contacts, floating_base=True).collider_names == ("ground",)
        with pytest.raises(SceneError, match=match):
            phipsi.load(path, contacts=contacts, strict=True)
    builder = phipsi.SceneBuilder().link("a", mass=1.0, inertia=np.eye(3))
    with pytest.raises((SceneError, ArgumentError), match=match):
        builder.collider("a", phipsi.shapes.Mesh(tmp_path / "one.obj"), link="a").build(floating_base=True)


def test_contacts_of_from_urdf_are_those_of_load(tmp_path: Path) -> None:
    path = robot(tmp_path)
    for contacts in ("all", "plane", None):
        for source in (path, path.read_text().replace("package://anywhere/", f"{tmp_path}/")):
            one, other = read(source, contacts), None
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ModelWarning)
                other = phipsi.Scene.from_urdf(source, contacts=contacts)
            assert one.collider_names == other.collider_names and touching(one) == touching(other)
            assert (contacts is None) == (one.collider_names == ())
    with pytest.raises(ArgumentError, match="contacts: found 'points'; expected \"all\", \"plane\" or None"):
        phipsi.Scene.from_urdf(path, contacts="points")  # type: ignore[arg-type]
