"""The robot in a browser: drawn shapes, errors, and self-contained pages, in a headless Chromium if it is installed."""

from __future__ import annotations

import os
import pickle
import re
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np
import phipsi
import pytest
from browsing import PATIENCE, Opened, browser, needs_browser  # noqa: F401  # one is a fixture
from click.testing import CliRunner
from phipsi.errors import ArgumentError, MeshWarning, NotFiniteError, ShapeError
from phipsi.report import commands, simulate, view_robot  # noqa: F401  # the last two register their commands
from tolerances import assert_near, product

# `make dev` does not install it.
pytest.importorskip("viser")
import phipsi.view  # noqa: E402
import trimesh  # noqa: E402
from phipsi._forces import Forces  # noqa: E402
from phipsi.view.arrows import Arrows  # noqa: E402
from phipsi.view.player import HOST, MOST, NIGHT, PORTS, RATE, Motion  # noqa: E402
from phipsi.view.shapes import find, robot_size, shapes_of  # noqa: E402

LINK = '<inertial><mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
#: A link with a shape of each kind; one without shapes.
SHAPES = f"""<robot name="r"><material name="red"><color rgba="1 0 0 1"/></material>
<link name="base"><visual><geometry><box size="0.2 0.2 0.1"/></geometry></visual></link>
<link name="arm">{LINK}
<visual><origin xyz="0 0 0.25"/><geometry><cylinder radius="0.05" length="0.5"/></geometry><material name="red"/></visual>
<visual><origin xyz="0 0 0.5" rpy="0 0 1"/><geometry><sphere radius="0.07"/></geometry></visual>
<visual><geometry><mesh filename="package://thing/meshes/part.stl" scale="0.001 0.001 0.001"/></geometry></visual></link>
<link name="bare"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="2" effort="10" velocity="3"/></joint>
<joint name="turn" type="continuous"><parent link="arm"/><child link="bare"/></joint></robot>"""


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """A package of a robot, with one mesh in millimeters."""
    meshes = tmp_path / "thing" / "meshes"
    meshes.mkdir(parents=True)
    trimesh.creation.box(extents=(100, 100, 300)).export(str(meshes / "part.stl"))
    file = tmp_path / "thing" / "urdf" / "robot.urdf"
    file.parent.mkdir()
    file.write_text(SHAPES, encoding="utf-8")
    return file


def test_a_scene_knows_its_file(robot: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(robot.parent)
    scene = phipsi.Scene.from_urdf("robot.urdf")
    assert scene.file == robot
    assert scene.lock(["turn"], scene.neutral()).file == robot
    assert scene.to_builder().build().file == robot
    assert phipsi.Scene.from_urdf(SHAPES).file is None
    assert phipsi.scenes.chain(3).file is None


def test_shapes_of_a_file(robot: Path) -> None:
    scene = phipsi.Scene.from_urdf(robot)
    shapes = shapes_of(scene, None)
    assert [shape.link for shape in shapes] == ["base", "arm", "arm", "arm"]
    box, cylinder, ball, mesh = (shape.mesh for shape in shapes)
    assert_near(box.extents, [0.2, 0.2, 0.1], product(3, 1.0))
    assert_near(cylinder.bounds[:, 2], [-0.25, 0.25], product(3, 1.0))
    assert_near(ball.bounds[1], [0.07] * 3, 1e-3)
    assert_near(mesh.extents, [0.1, 0.1, 0.3], 1e-6)
    assert_near(shapes[1].place[:3, 3], [0, 0, 0.25], product(3, 1.0))
    assert cylinder.visual.material.baseColorFactor[:3].tolist() == [255, 0, 0]


#: A body with a shape of each kind of MuJoCo.
MUJOCO = """<mujoco><option><flag contact="disable"/></option><asset><mesh name="tetra" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/><material name="red" rgba="1 0 0 1"/></asset><worldbody>
<geom type="plane" size="1 1 1"/><body name="arm" pos="0 0 1"><joint axis="0 1 0"/>
<geom type="box" size="0.1 0.2 0.3" pos="1 2 3" euler="0 0 90" rgba="0 0 1 1"/><geom type="sphere" size="0.2"/><geom type="capsule" size="0.1 0.4"/>
<geom type="cylinder" size="0.1 0.4"/><geom type="ellipsoid" size="0.1 0.2 0.3"/><geom type="mesh" mesh="tetra" material="red"/>
<geom type="sphere" size="5" group="3"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("given", ["file", "text", "model", "binary file", "attached file", "attached model"])
def test_shapes_of_a_mujoco_model(tmp_path: Path, given: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    file = tmp_path / "arm.xml"
    file.write_text(MUJOCO, encoding="utf-8")
    model = mujoco.MjModel.from_xml_path(str(file))
    if given == "binary file":
        mujoco.mj_saveModel(model, str(file := tmp_path / "arm.mjb"))
    scene = phipsi.load({"text": MUJOCO, "model": model, "attached model": model}.get(given, file))
    prefix = "a_b_" if "attached" in given else ""
    if prefix:
        part = phipsi.scenes.chain(1).to_builder().attach(scene, "link0", prefix="b_").build()
        scene = phipsi.SceneBuilder().link("world").attach(part, "world", prefix="a_").build()
    scene = pickle.loads(pickle.dumps(scene))
    shapes = shapes_of(scene, None)
    assert [shape.link for shape in shapes] == [f"{prefix}arm"] * 6
    extents = [shape.mesh.extents for shape in shapes]
    for found, expected in zip(extents, [(0.2, 0.4, 0.6), (0.4,) * 3, (0.2, 0.2, 1.0), (0.2, 0.2, 0.8), (0.2, 0.4, 0.6)], strict=False):
        assert np.max(np.abs(found - expected)) < 0.01
    assert_near(shapes[0].place, np.array([[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]), product(1, 3.0))
    # MuJoCo rotates a mesh to its principal axes, and changes its pose accordingly.
    corners = np.hstack([shapes[5].mesh.vertices, np.ones((4, 1))]) @ shapes[5].place.T
    assert np.max(np.abs(np.sort(corners[:, :3], axis=0) - np.sort(np.vstack([np.zeros(3), np.eye(3)]), axis=0))) < 1e-6
    assert [tuple(shape.mesh.visual.material.baseColorFactor) for shape in shapes][::5] == [(0, 0, 255, 255), (255, 0, 0, 255)]


def test_shapes_of_a_xacro(robot: Path) -> None:
    pytest.importorskip("xacro")
    file = robot.parent / "robot.xacro"
    file.write_text(SHAPES.replace('<robot name="r">', '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="size" value="0.4"/>').replace("0.2 0.2 0.1", "${size} 0.2 0.1"))
    shapes = shapes_of(phipsi.load(file), None)
    assert [shape.link for shape in shapes] == ["base", "arm", "arm", "arm"]
    assert_near(shapes[0].mesh.extents, np.array([0.4, 0.2, 0.1]), product(1, 1.0))


def test_capsules_stand_for_inertias() -> None:
    """For a rod along an oblique axis: as long as the box with its inertia, centered at its center of mass, along the
    axis.
    """
    axis = np.array([1.0, 2.0, 2.0]) / 3.0
    long, thin, mass = 0.6, 0.04, 2.0
    across, along = mass * (long**2 + thin**2) / 12, mass * thin**2 / 6
    inertia = across * np.eye(3) + (along - across) * np.outer(axis, axis)
    builder = phipsi.SceneBuilder().link("base").link("rod", mass, 0.3 * axis, inertia)
    scene = builder.joint("hinge", "revolute", "base", "rod", axis=(0, 0, 1)).build()
    capsule = shapes_of(scene, None)[-1]
    assert capsule.link == "rod"
    points = trimesh.transform_points(capsule.mesh.vertices, capsule.place)
    reach = points @ axis
    assert_near([reach.min(), reach.max()], [0.0, long], 1e-2)
    radius = np.linalg.norm(points - np.outer(reach, axis), axis=1).max()
    assert 0.45 * thin <= radius <= 1.2 * max(0.5 * thin, 0.012 * robot_size(scene))
    assert np.linalg.det(capsule.place) > 0.0


def test_a_mesh_that_is_lost_is_named(robot: Path) -> None:
    (robot.parents[1] / "meshes" / "part.stl").unlink()
    scene = phipsi.Scene.from_urdf(robot)
    with pytest.warns(MeshWarning, match=r"arm: no file 'package://thing/meshes/part.stl'"):
        assert len(shapes_of(scene, None)) == 3


def test_a_page_tells_of_a_lost_mesh(robot: Path, tmp_path: Path) -> None:
    (robot.parents[1] / "meshes" / "part.stl").unlink()
    result = CliRunner().invoke(commands.group, ["simulate", str(robot), "-o", str(tmp_path / "out"), "--time", "0.01"])
    assert result.exit_code == 0, result.output
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "shapes that are not drawn: arm: no file &#39;package://thing/meshes/part.stl&#39;" in page
    assert "This robot has no shapes" not in page


def test_meshes_are_found(robot: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    part = robot.parents[1] / "meshes" / "part.stl"
    for name in ("package://thing/meshes/part.stl", "../meshes/part.stl", str(part), f"file://{part}"):
        assert find(name, robot).samefile(part)
    far = tmp_path / "elsewhere" / "robot.urdf"
    with pytest.raises(FileNotFoundError):
        find("package://thing/meshes/part.stl", Path("/nowhere/robot.urdf"))
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    assert find("package://thing/meshes/part.stl", far).samefile(part)


BROKEN: dict[str, bytes] = {
    "empty.stl": b"",
    "header.stl": bytes(84),
    "cut.stl": bytes(80) + b"\x10\0\0\0" + b"abc",
    "text.stl": b"solid x\n facet normal 0 0",
    "nothing.stl": b"solid\nendsolid\n",
    "corner.obj": b"v 0 0\nf 1 2 9\n",
    "cut.ply": b"ply\nformat ascii 1.0\nelement vertex 9\n",
    "no.glb": b"glTFxxxx",
    "some.format": b"abc",
    "no.dae": b"garbage",
    "empty.dae": b"<COLLADA></COLLADA>",
}


@pytest.mark.parametrize("name", BROKEN)
def test_meshes_that_cannot_be_read_are_named(robot: Path, name: str) -> None:
    """For any exception of the reader of their format; the other shapes are drawn."""
    (robot.parent / name).write_bytes(BROKEN[name])
    robot.write_text(SHAPES.replace("package://thing/meshes/part.stl", name), encoding="utf-8")
    with pytest.warns(MeshWarning, match=f"shapes that are not drawn: arm: '{name}' (has no triangles|cannot be read)"):
        shapes = shapes_of(phipsi.Scene.from_urdf(robot), None)
    assert [shape.link for shape in shapes] == ["base", "arm", "arm"]


def test_what_a_mesh_reader_raises_is_a_warning(robot: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Like pycollada's DaeMalformedError, if it is installed."""

    class Malformed(Exception):
        pass

    def load(*_: object, **__: object) -> None:
        raise Malformed("line 1")

    monkeypatch.setattr(trimesh, "load", load)
    with pytest.warns(MeshWarning, match=r"part.stl' cannot be read \(Malformed: line 1\); expected readable files"):
        assert len(shapes_of(phipsi.Scene.from_urdf(robot), None)) == 3


@pytest.mark.parametrize("port", [99999, -1, 65536, 80.5, "8080", True])
def test_ports_that_are_none_are_refused(port: Any) -> None:
    with pytest.raises(ArgumentError, match="port: found .*; expected an integer from 1 to 65535, or 0"):
        phipsi.scenes.chain(2).show(port=port, browser=False)


def test_a_port_in_use_is_passed_over() -> None:
    with phipsi.scenes.chain(2).show(browser=False) as first:
        port = int(first.url.rpartition(":")[2])
        with phipsi.scenes.chain(2).show(port=port, browser=False) as second:
            assert port < int(second.url.rpartition(":")[2]) < port + PORTS


def test_the_last_port_in_use_does_not_hang() -> None:
    with socket.socket() as taken:
        try:
            taken.bind((HOST, 65535))
            taken.listen()
        except OSError:
            pytest.skip("in use already")
        with pytest.raises(ArgumentError, match="port: found 65535, which cannot be used"):
            phipsi.scenes.chain(2).show(port=65535, browser=False)


@pytest.mark.parametrize("name", ["x.mp4", "x.gif", "x", "x.html.jpg"])
def test_files_that_are_no_pages_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ArgumentError, match="to: found '.*'; expected a path that ends in .html, .htm, .png, .webp"):
        phipsi.scenes.chain(2).show(to=tmp_path / name)
    assert not (tmp_path / name).exists()
    assert phipsi.scenes.chain(2).show(to=tmp_path / "x.HTM").read_text(encoding="utf-8").lstrip()[:9].lower() == "<!doctype"


def test_a_motion_is_shown_evenly() -> None:
    scene = phipsi.scenes.chain(2)
    path = scene.simulate([0.1, 0.2], [0.0, 0.0], dt=1e-3, steps=1000)
    times, rows = Motion(scene, path, None).frames()
    assert len(times) == len(rows) == RATE + 1
    assert (times[0], times[-1]) == (0.0, path.t[-1])
    assert np.array_equal(rows[-1], path.q[-1]) and np.array_equal(rows[0], path.q[0])
    assert np.max(np.abs(np.diff(times) - 1.0 / RATE)) < 1e-9
    long = Motion(scene, np.zeros((2, 2)), [0.0, 1e5]).frames()[0]
    assert len(long) == MOST


#: Invalid arguments, and the names in the messages.
BAD: dict[str, tuple[tuple[Any, ...], dict[str, Any], type[Exception], str]] = {
    "too many coordinates": ((np.zeros(3),), {}, ShapeError, "q"),
    "several motions": ((np.zeros((2, 2, 2)),), {"t": [0.0, 1.0]}, ShapeError, "q"),
    "not a number": (([0.0, np.nan],), {}, NotFiniteError, "q"),
    "no times": ((np.zeros((3, 2)),), {}, ArgumentError, "t"),
    "too few times": ((np.zeros((3, 2)),), {"t": [0.0, 1.0]}, ArgumentError, "t"),
    "falling times": ((np.zeros((2, 2)),), {"t": [1.0, 0.0]}, ArgumentError, "t"),
    "forces of other rows": ((np.zeros(2),), {"forces": (np.zeros((2, 1, 3)), np.zeros((2, 1, 3)))}, ShapeError, "forces"),
    "no such file": ((), {"urdf": "/nowhere/robot.urdf"}, ArgumentError, "urdf"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_shown(case: str, tmp_path: Path) -> None:
    arguments, how, error, name = BAD[case]
    with pytest.raises(error, match=rf"^{name}"):
        phipsi.scenes.chain(2).show(*arguments, to=tmp_path / "page.html", **how)
    assert not (tmp_path / "page.html").exists()


class Drawn(SimpleNamespace):
    """A viser server that records what is drawn."""

    def __init__(self) -> None:
        super().__init__(scene=self)

    def add_arrows(self, name: str, points: np.ndarray, color: Any, **how: Any) -> SimpleNamespace:
        setattr(self, name, SimpleNamespace(points=points, visible=how.get("visible", True)))
        return getattr(self, name)

    def add_frame(self, name: str, **how: Any) -> SimpleNamespace:
        setattr(self, name, SimpleNamespace(position=(0.0, 0.0, 0.0), visible=how["visible"]))
        return getattr(self, name)

    def add_label(self, name: str, text: str, **how: Any) -> SimpleNamespace:
        setattr(self, name, SimpleNamespace(text=text, visible=True))
        return getattr(self, name)


def test_arrows_are_to_scale() -> None:
    """Lengths are proportional to newtons, with a labeled reference arrow on the ground; zero and unknown
    forces are not drawn.
    """
    force = np.zeros((50, 2, 3))
    force[10:30, 0, 2] = 30.0
    force[20:40, 1] = (0.0, 3.0, 4.0)
    force[39, 1] = np.nan
    at = np.random.default_rng(0).uniform(-1.0, 1.0, force.shape)
    drawn = Drawn()
    arrows = Arrows.of(drawn, Forces("contact", at, force), 2.0, np.zeros(3), -1.0)
    assert arrows is not None
    text, key = getattr(drawn, "/newtons/label").text, getattr(drawn, "/newtons").points
    assert text == "contact forces: 20 N"
    meters = np.linalg.norm(key[0, 1] - key[0, 0]) / 20.0
    assert_near(key[..., 2], np.full((1, 2), -1.0), product(1, 1.0))
    frames, shown = ([getattr(drawn, f"/forces/{i}{part}") for i in range(2)] for part in ("", "/arrow"))
    for frame, seen in ((0, []), (15, [0]), (25, [0, 1]), (35, [1]), (39, []), (45, [])):
        arrows.show(frame)
        assert [i for i in range(2) if frames[i].visible] == seen
        for i in seen:
            assert_near(frames[i].position, at[frame, i], 0.0)
            assert_near(shown[i].points, [[np.zeros(3), meters * force[frame, i]]], 1e-6)
            assert 0.0 < shown[i].head_length <= 0.51 * meters * np.linalg.norm(force[frame, i])
    arrows.turn(False, 15)
    assert not frames[0].visible and not getattr(drawn, "/newtons").visible
    assert Arrows.of(drawn, Forces("contact", at, np.zeros_like(force)), 2.0, np.zeros(3), -1.0) is None


def test_a_served_robot_moves_and_ends(robot: Path) -> None:
    scene = phipsi.Scene.from_urdf(robot)
    with scene.show(browser=False) as viewer:
        with urllib.request.urlopen(viewer.url, timeout=20) as answer:
            assert answer.status == 200 and b"<html" in answer.read()
        viewer.update([0.5, 0.1])
        with pytest.raises(ShapeError, match="q"):
            viewer.update([0.5])
    with pytest.raises(OSError):
        urllib.request.urlopen(viewer.url, timeout=5)
    assert "closed" in repr(viewer)


def test_the_camera_follows_a_robot_that_moves_far(robot: Path) -> None:
    """The world moves instead of the camera: the robot stays near the middle, and the ground under it."""
    scene = phipsi.Scene.from_urdf(robot, floating_base=True)
    way = np.tile(scene.neutral(), (91, 1))
    way[:, 0] = np.linspace(0.0, 40.0, 91)
    size, axes = robot_size(scene), slice(0, 2)
    with scene.show(way, t=np.linspace(0.0, 3.0, 91), browser=False) as viewer:
        stage = viewer._stage
        assert np.linalg.norm(stage.extent.middle[axes]) < 2.0 * size
        for row in (0, 45, 90):
            stage.update(way[row], stage.way[row])
            center = np.add(stage.parents[0].position, scene.center_of_mass(way[row]))
            assert np.linalg.norm((center - stage.start)[axes]) < 4.0  # the mean of 15 frames is behind at the ends
            assert np.all(np.abs(np.subtract(stage.ground.position, stage.beneath)) < stage.tile)
    with scene.show(way[0], browser=False) as viewer:
        for row in (3, 30, 90, 0):
            viewer.update(way[row])
            center = np.add(viewer._stage.parents[0].position, scene.center_of_mass(way[row]))
            assert np.linalg.norm((center - viewer._stage.start)[axes]) < 0.71 * size
        place, still = viewer._stage.parents[0].position, scene.neutral()
        still[-1] += 0.1
        viewer.update(still)
        assert np.array_equal(viewer._stage.parents[0].position, place)


def test_the_command(tmp_path: Path) -> None:
    run = CliRunner().invoke
    result = run(commands.group, ["simulate", "-o", str(tmp_path), "--time", "0.1"])
    assert result.exit_code == 0, result.output
    for more in ([], ["--motion", str(tmp_path / "trajectory.npz")]):
        result = run(commands.group, ["view", "-o", str(tmp_path / "page.html"), *more])
        assert result.exit_code == 0, result.output
        assert "__VISER_EMBED_DATA__" in (tmp_path / "page.html").read_text(encoding="utf-8")
    result = run(commands.group, ["view", "-o", str(tmp_path / "page.html"), "--motion", str(tmp_path / "index.html")])
    assert result.exit_code == 2 and "--motion" in result.output
    result = run(commands.group, ["view", "-o", str(tmp_path / "page.html"), "--keyframe", "home"])
    assert result.exit_code == 2 and 'keyframe: found "home"; expected none, because the scene has no keyframes' in result.output


# In a browser


def differing(one: np.ndarray, other: np.ndarray) -> int:
    """Number of visibly different pixels of two pictures."""
    return int(np.count_nonzero(np.abs(one - other).max(axis=-1) > 30.0))


def check_player(opened: Opened, frame: Any) -> None:
    """The canvas is not empty; it is static while paused, and a click on play starts the motion."""
    canvas = frame.locator("canvas").last
    canvas.wait_for(timeout=PATIENCE)
    button = frame.locator("button:has(svg.tabler-icon-player-pause-filled), button:has(svg.tabler-icon-player-pause)").first
    button.wait_for(timeout=PATIENCE)
    opened.page.wait_for_timeout(1500)
    button.dispatch_event("click")
    # A busy machine without a graphics processor draws the last picture late; a player that plays is never static for so long.
    opened.page.wait_for_timeout(1000)
    still = opened.picture(canvas)
    for _ in range(20):
        opened.page.wait_for_timeout(1500)
        before, still = still, opened.picture(canvas)
        if differing(before, still) < 50:
            break
    else:
        raise AssertionError("pause does not stop the motion")
    assert len(np.unique(still.reshape(-1, 3), axis=0)) > 50
    play = frame.locator("button:has(svg.tabler-icon-player-play-filled), button:has(svg.tabler-icon-player-play)").first
    play.dispatch_event("click")
    for _ in range(12):
        opened.page.wait_for_timeout(300)
        if differing(still, opened.picture(canvas)) > 200:
            return
    raise AssertionError("nothing moves")


@needs_browser
def test_a_page_plays_without_a_network(browser: Any, tmp_path: Path) -> None:
    scene = phipsi.scenes.chain(3)
    path = scene.simulate([0.5, 0.3, 0.2], [2.0, -1.0, 3.0], dt=1e-3, steps=3000, method="rk4", record_every=10)
    file = scene.show(path, to=tmp_path / "page.html")
    assert file.stat().st_size < 3e6 and NIGHT in file.read_text(encoding="utf-8")
    with Opened(browser, file, 600) as opened:
        check_player(opened, opened.page)
        opened.check(file)


def run_script(text: str, folder: Path) -> tuple[str, list[str]]:
    """The output of a script, and the addresses that it opens in a browser."""
    opened = folder / "opened.txt"
    (folder / "browser.sh").write_text(f'#!/bin/sh\necho "$1" >> {opened}\n', encoding="utf-8")
    (folder / "browser.sh").chmod(0o755)
    (folder / "script.py").write_text(text, encoding="utf-8")
    environment = os.environ | {"BROWSER": f"{folder / 'browser.sh'} %s", "TMPDIR": str(folder), "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, str(folder / "script.py")], env=environment, capture_output=True, text=True, timeout=PATIENCE / 1e3, check=True)
    return done.stdout, opened.read_text(encoding="utf-8").split() if opened.exists() else []


FALL = """import phipsi
scene = phipsi.scenes.chain(3)
path = scene.simulate([0.5, 0.3, 0.2], [2.0, -1.0, 3.0], dt=1e-3, steps=3000, method="rk4", record_every=10)
"""
posix = pytest.mark.skipif(os.name != "posix", reason="the browser is a script of a shell")


@posix
@needs_browser
def test_the_page_of_a_script_remains_after_its_end(browser: Any, tmp_path: Path) -> None:
    printed, opened = run_script(FALL + "scene.show(path)", tmp_path)
    assert printed.split() == opened and len(opened) == 1
    file = Path(unquote(urlsplit(opened[0]).path))
    assert file.is_relative_to(tmp_path)
    with Opened(browser, file, 600) as shown:
        shown.page.locator("canvas").last.wait_for(timeout=PATIENCE)
        shown.check(file)


@posix
def test_a_script_that_asks_for_a_server_gets_one(tmp_path: Path) -> None:
    """With browser=True or a port; or later by update(), which a page cannot follow."""
    served = FALL + """
viewer = scene.show(path, browser=True)
assert viewer.url.startswith("http:")
viewer.close()
viewer = scene.show(path, port=8000, browser=False)
viewer.close()
viewer = scene.show()
assert viewer.url.startswith("file:")
viewer.update([0.1, 0.2, 0.3])
assert viewer.url.startswith("http:")
viewer.close()
viewer.wait()
"""
    printed, opened = run_script(served, tmp_path)
    assert [url.partition(":")[0] for url in opened] == ["http", "file", "http"] and printed.split() == opened[1:]


def green(picture: np.ndarray) -> int:
    """Number of green pixels, the color of arrows."""
    return int(np.count_nonzero((picture[..., 1] > picture[..., 0] + 25) & (picture[..., 1] > picture[..., 2])))


@needs_browser
def test_forces_are_arrows(browser: Any, tmp_path: Path) -> None:
    """Green if forces are given, and nowhere else."""
    scene, seen, tries = phipsi.scenes.chain(3), [], 20
    push = np.array([[[0.2, 0.2, 0.2]]]), np.array([[[0.0, 0.0, 20.0]]])
    for forces in (push, None):
        file = scene.show(np.array([0.5, 0.3, 0.2]), forces=forces, to=tmp_path / "page.html")
        with Opened(browser, file, 500) as opened:
            canvas = opened.page.locator("canvas").last
            canvas.wait_for(timeout=PATIENCE)
            for _ in range(tries):
                opened.page.wait_for_timeout(500)
                seen.append(green(opened.picture(canvas)))
                if forces is not None and seen[-1] > 100:
                    break
            opened.check(file)
        # The page without forces has as much time, and more.
        tries = len(seen) + 2 if forces is not None else tries
    assert max(seen[:-tries]) > 100 and max(seen[-tries:]) == 0


@needs_browser
@pytest.mark.parametrize("width", [1400, 400])
def test_the_page_of_a_simulation(browser: Any, tmp_path: Path, width: int, robot: Path) -> None:
    state = tmp_path / "state.json"
    state.write_text('{"qd": {"hinge": 6.0, "turn": 3.0}}', encoding="utf-8")
    result = CliRunner().invoke(commands.group, ["simulate", str(robot), "-o", str(tmp_path / "out"), "--time", "3", "--state", str(state), "--hold", "20", "1"])
    assert result.exit_code == 0, result.output
    file = tmp_path / "out" / "index.html"
    with Opened(browser, file, width) as opened:
        check_player(opened, opened.page.frame_locator("iframe.robot"))
        curves = next(plot for plot in opened.plots() if plot["name"] == "plot-over-time")
        assert {"hinge", "turn"} <= set(curves["legend"]) and "total" not in curves["legend"]
        assert any("total" in plot["legend"] for plot in opened.plots())
        titles = " ".join(opened.page.locator("#plot-over-time [class*='title']").all_text_contents())
        assert "torque, N m or N" in titles and "torque relative to its limit" in titles
        assert opened.wide() <= width
        opened.check(file)


@needs_browser
def test_the_report_opens_with_the_robot(browser: Any, tmp_path: Path) -> None:
    result = CliRunner().invoke(commands.group, ["report", "--quick", "--states", "4", "-o", str(tmp_path)])
    assert result.exit_code == 0, result.output
    file = tmp_path / "index.html"
    with Opened(browser, file, 1400) as opened:
        assert re.sub(r"\s+", " ", opened.page.locator("h2").first.inner_text()) == "The robot"
        check_player(opened, opened.page.frame_locator("iframe.robot"))
        # On a phone the page has the width of the phone, and wide tables scroll separately.
        opened.resize(400)
        assert opened.wide() <= 400
        opened.check(file)


def test_colors_of_a_geom_come_before_those_of_its_material(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    geoms = '<geom type="sphere" size="1" material="red" rgba="0 0 1 1"/><geom type="sphere" size="1" material="red"/><geom type="sphere" size="1"/>'
    file = tmp_path / "ball.xml"
    file.write_text(
        '<mujoco><option><flag contact="disable"/></option><asset><material name="red" rgba="1 0 0 1"/></asset><worldbody>'
        f'<body><freejoint/>{geoms}</body></worldbody></mujoco>',
        encoding="utf-8",
    )
    colors = [tuple(shape.mesh.visual.material.baseColorFactor[:3]) for shape in shapes_of(phipsi.load(file), None)]
    assert colors == [(0, 0, 255), (255, 0, 0), (128, 128, 128)]


def test_a_robot_is_shown_at_its_start() -> None:
    scene = phipsi.scenes.chain(2).to_builder().start({"j0": 0.5}).build()
    assert_near(Motion(scene, None, None).q, np.array([[0.5, 0.0]]), 0.0)
