"""Pictures of robots as PNG and WebP, and the display of viewers in notebooks."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import numpy as np
import phipsi
import pytest
from phipsi.errors import ArgumentError
from phipsi.shapes import Box, Capsule, Cylinder, HalfSpace, HeightField, Hull, Sphere

pytest.importorskip("viser")
from phipsi.view import picture, player  # noqa: E402
from phipsi.view.player import Motion, _in_notebook  # noqa: E402
from phipsi.view.shapes import extent, shapes_of, travel  # noqa: E402
from PIL import Image  # noqa: E402


def cube(color: object = (1.0, 0.0, 0.0)) -> phipsi.Scene:
    builder = phipsi.SceneBuilder().link("base").link("cube", 1.0, inertia=np.eye(3), shape=Box((1, 1, 1), color=color))  # type: ignore[arg-type]
    return builder.joint("slide", "prismatic", "base", "cube", axis=(0, 1, 0)).build()


def drawn(scene: phipsi.Scene, tmp_path: Path) -> np.ndarray:
    scene.show(to=tmp_path / "x.png")
    with Image.open(tmp_path / "x.png") as opened:
        return np.asarray(opened.convert("RGB"), float)


def test_a_cube_has_three_faces_of_its_color(tmp_path: Path) -> None:
    pixels = drawn(cube(), tmp_path)
    assert pixels.shape == (600, 800, 3)
    red = (pixels[..., 0] > 60) & (pixels[..., 1] < 30) & (pixels[..., 2] < 30)
    # A cube seen from outside: its silhouette is a hexagon within the frame, and each visible face has one shade.
    rows, columns = np.nonzero(red)
    assert 0.1 < red.mean() < 0.6 and rows.min() > 10 and rows.max() < 590 and columns.min() > 10 and columns.max() < 790
    shades, counts = np.unique(pixels[red][:, 0].round(-1), return_counts=True)
    assert np.sum(counts > 0.1 * red.sum()) == 3, (shades, counts)


def test_the_nearer_shape_hides_the_other(tmp_path: Path) -> None:
    toward = np.array([1.15, 0.85, 0.6])
    builder = phipsi.SceneBuilder().link("base", shape=[Sphere(0.3, color=(1, 0, 0)), Sphere(0.3, xyz=tuple(toward), color=(0, 0, 1))])
    scene = builder.link("arm", 1.0, inertia=np.eye(3)).joint("hinge", "revolute", "base", "arm").build()
    pixels = drawn(scene, tmp_path)
    blue, red = (np.sum((pixels[..., one] > 60) & (pixels[..., other] < 30)) for one, other in ((2, 0), (0, 2)))
    assert blue > 1000 and red < 0.1 * blue


HEIGHTS = np.array([[0.0, 0.1, 0.3], [0.2, 0.0, 0.1]])
CORNERS = np.array([[0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3], [-0.1, -0.1, -0.1]])
#: Colliders, and the points that their meshes must reach, in their frames.
COLLIDERS = {
    "box": (Box((0.2, 0.4, 0.6)), [[0.1, 0.2, 0.3], [-0.1, -0.2, -0.3]]),
    "sphere": (Sphere(0.3), [[0, 0, 0.3], [0, 0, -0.3]]),
    "capsule": (Capsule(0.1, 0.4), [[0, 0, 0.3], [0, 0, -0.3]]),
    "cylinder": (Cylinder(0.1, 0.4), [[0.1, 0, 0.2], [0.1, 0, -0.2]]),
    "hull": (Hull(CORNERS), CORNERS),
    "field": (HeightField(HEIGHTS, (2.0, 1.0)), [[x, y, HEIGHTS[j, i]] for j, y in enumerate((-0.5, 0.5)) for i, x in enumerate((-1.0, 0.0, 1.0))]),
}


@pytest.mark.parametrize("name", COLLIDERS)
def test_a_collider_is_drawn_where_it_touches(name: str) -> None:
    """On the base, and turned about x by a quarter: (x, y, z) is at (x, -z, y)."""
    shape, corners = COLLIDERS[name]
    moved = shape._replace(xyz=(1.0, 2.0, 3.0), **({} if name == "sphere" else {"rpy": (np.pi / 2, 0.0, 0.0)}))  # type: ignore[attr-defined]
    scene = phipsi.SceneBuilder().link("ball", 1.0, inertia=np.eye(3)).collider("ground", HalfSpace()).collider(name, moved).build(floating_base=True)
    (drawn,) = shapes_of(scene, None, collision=True)
    points = np.hstack([drawn.mesh.vertices, np.ones((len(drawn.mesh.vertices), 1))]) @ drawn.place.T
    x, y, z = np.transpose(corners)
    for corner in np.column_stack([1.0 + x, 2.0 - z, 3.0 + y]):
        assert np.linalg.norm(points[:, :3] - corner, axis=1).min() < 1e-12
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    assert drawn.link == "" and np.all(points[:, 1] <= 2.0 - low[2] + 1e-12) and np.all(points[:, 1] >= 2.0 - high[2] - 1e-12)


def test_colliders_are_shown_instead_of_shapes_and_those_of_the_base_always(tmp_path: Path) -> None:
    """The red cube of the link, its green collider, and a green table."""
    builder = phipsi.SceneBuilder().link("base").link("cube", 1.0, inertia=np.eye(3), shape=Box((1, 1, 1), color=(1, 0, 0)))
    builder.joint("slide", "prismatic", "base", "cube", axis=(0, 1, 0)).collider("cube", Sphere(0.5), link="cube")
    scene = builder.collider("table", Box((2, 2, 0.1), xyz=(0, 0, -1))).build()
    found = {}
    for collision in (False, True):
        scene.show(to=tmp_path / "x.png", collision=collision)
        with Image.open(tmp_path / "x.png") as opened:
            pixels = np.asarray(opened.convert("RGB"), float)
        red, green = (np.mean(pixels[..., at] > 1.5 * pixels[..., 1 - at]) for at in (0, 1))
        found[collision] = red, green
    assert found[False][0] > 0.02 and found[False][1] > 0.02
    assert found[True][0] == 0.0 and found[True][1] > found[False][1]
    assert [shape.link for shape in shapes_of(scene, None)] == ["cube", ""]
    assert [shape.link for shape in shapes_of(scene, None, collision=True)] == ["cube", ""]


def test_a_large_floor_does_not_make_a_robot_small() -> None:
    arm = phipsi.load(phipsi.BUNDLED_ARM)
    with_floor = arm.to_builder().collider("floor", Box((200.0, 200.0, 1.0), xyz=(0.0, 0.0, -0.5))).build()
    q = arm.neutral()[None]
    sizes = [np.ptp(extent(scene, shapes_of(scene, None), q).points, axis=0).max() for scene in (arm, with_floor)]
    assert sizes[1] < 6.0 * sizes[0]


def test_the_camera_follows_a_robot_that_moves_far() -> None:
    scene, rows = cube(), np.linspace(0.0, 2.0, 40)[:, None]
    shift = travel(scene, rows)
    assert np.allclose(shift[20], [0, rows[20, 0], 0], atol=1e-12) and np.all(np.diff(shift[:, 1]) >= 0.0)
    assert not travel(scene, 0.2 * rows).any()
    shapes = shapes_of(scene, None)
    near, far = (np.ptp(extent(scene, shapes, rows, by).points, axis=0).max() for by in (shift, 0.0 * shift))
    assert near < 0.8 * far
    # The cube stays in the middle of the picture, and the tiles of the ground move.
    motion = Motion(scene, rows, np.linspace(0.0, 1.0, 40))
    first, last = (np.asarray(one, float) for one in picture.frames(scene, motion, shapes, [8, 24], (80, 60)))
    red = [np.argwhere(one[..., 0] > 1.5 * one[..., 1]).mean(axis=0) for one in (first, last)]
    assert np.allclose(*red, atol=3.0) and np.abs(first - last).max() > 5.0


def test_progress_is_shown_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert list(picture._shown(iter("ab"), 2, Path("x.webp"))) == ["a", "b"] and not capsys.readouterr().err  # type: ignore[arg-type]
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert list(picture._shown(iter("ab"), 2, Path("x.webp"))) == ["a", "b"]  # type: ignore[arg-type]


def test_every_vertex_is_within_the_frame() -> None:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    q = np.array([[0.3] * 6, [-1.0] * 6])
    shapes, placements = shapes_of(scene, None), scene.placements(q)
    space = extent(scene, shapes, q)
    for aspect in (0.5, 1.0, 2.0):
        size = (round(400 * aspect), 400)
        camera = picture._Camera(space.camera(aspect), size)
        for shape in shapes:
            for place in placements[shape.link]:
                at = camera.seen(np.asarray(shape.mesh.vertices) @ (place @ shape.place)[:3, :3].T + (place @ shape.place)[:3, 3])
                assert np.all((at[:, :2] > 0.0) & (at[:, :2] < picture.SAMPLES * np.array(size)))


def test_a_motion_is_an_animation(tmp_path: Path) -> None:
    scene = cube()
    scene.show(np.linspace(0, 1, 5)[:, None], t=np.linspace(0, 0.2, 5), to=tmp_path / "x.webp")
    with Image.open(tmp_path / "x.webp") as opened:
        assert opened.n_frames == 5 and opened.size == picture.MOVING


def test_forces_are_drawn(tmp_path: Path) -> None:
    scene = cube((1, 1, 1))
    scene.show([0.0], forces=([[[0.0, 0.0, 0.5]]], [[[0.0, 0.0, 9.0]]]), to=tmp_path / "with.png")
    with Image.open(tmp_path / "with.png") as opened:
        pixels = np.asarray(opened.convert("RGB"), float)
    assert np.sum((pixels[..., 1] > 1.3 * pixels[..., 0]) & (pixels[..., 1] > 40)) > 100


@pytest.mark.parametrize("name", ["x.mp4", "x.gif", "x", "x.html.jpg"])
def test_other_files_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ArgumentError, match="to: found '.*'; expected a path that ends in .html, .htm, .png, .webp"):
        cube().show(to=tmp_path / name)
    assert not (tmp_path / name).exists()


def test_a_page_has_the_name_of_the_robot(tmp_path: Path) -> None:
    page = phipsi.load(phipsi.BUNDLED_ARM).show(to=tmp_path / "x.html").read_text(encoding="utf-8")
    assert re.findall("<title>(.*?)</title>", page) == ["puma560"]
    page = cube().show(to=tmp_path / "x.html", title="a < b").read_text(encoding="utf-8")
    assert re.findall("<title>(.*?)</title>", page) == ["a &lt; b"]


def test_a_notebook_shows_the_viewer_as_a_page() -> None:
    with cube().show(browser=False) as viewer:
        html = viewer._repr_html_()
    assert html.startswith('<iframe title="phipsi" srcdoc="&lt;!') and html.count("<iframe") == 1
    assert not _in_notebook()


def test_hosts(monkeypatch: pytest.MonkeyPatch) -> None:
    with cube().show(host="0.0.0.0", browser=False) as viewer:
        assert viewer.url.startswith("http://127.0.0.1:")


@pytest.mark.parametrize(("host", "message"), [(3, "host: found 3; expected the address"), ("203.0.113.7", "host: found '203.0.113.7', which is not an address of this machine")])
def test_a_host_that_is_not_valid_is_refused(host: object, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        cube().show(host=host, browser=False)  # type: ignore[call-overload]


def test_sliders_have_units_and_three_digits(monkeypatch: pytest.MonkeyPatch) -> None:
    from viser import GuiApi

    found: list[tuple[object, ...]] = []
    real = GuiApi.add_slider
    monkeypatch.setattr(GuiApi, "add_slider", lambda gui, *given: found.append(given) or real(gui, *given))
    phipsi.load(phipsi.BUNDLED_ARM).show(browser=False).close()
    cube().show([0.12345], browser=False).close()
    name, low, high, step, value = found[0]
    assert (name, step) == ("joint1, rad", 1e-3) and value == 0.0
    assert np.isclose(low, -2.792) and np.isclose(high, 2.792)  # type: ignore[arg-type]
    assert found[-1][0] == "slide, m" and found[-1][4] == 0.12345


def test_motions_are_those_of_pages() -> None:
    motion = Motion(cube(), [0.0], None)
    (only,) = picture.frames(cube(), motion, shapes_of(cube(), None), [0], (40, 30))
    assert only.size == (40, 30)


def test_each_legend_has_its_own_colors() -> None:
    from phipsi.report.run import Run, by_legend, colors, over_time
    from phipsi.report.structure import tree_of

    scene = phipsi.scenes.chain(14)
    path = scene.simulate([0.1] * 14, [0.0] * 14, dt=1e-3, steps=3)
    joints, energy = by_legend(over_time(Run(False, "chain", path, tree_of(scene), np.zeros_like(path.qd))))
    inks = {one.name: one.ink for one in joints.panels[0].series}
    assert len(set(inks.values())) == 14 and len(joints.panels) == 2
    assert all(inks[one.name] == one.ink for one in joints.panels[1].series)
    assert "total" in [one.name for one in energy.panels[0].series] and (joints.name, energy.name) == ("over-time", "over-time-1")
    for count in (1, 10, 11, 60):
        assert len(set(colors(count))) == count and all(re.fullmatch("#[0-9a-f]{6}", color) for color in colors(count))


def test_the_name_of_the_project_stays_latin() -> None:
    from phipsi.report.text import symbols

    assert symbols("phipsi.compile, H phi Q phi* H*, phi . Phi") == "phipsi.compile, H φ Q φ* H*, φ · Φ"


def test_the_command_writes_pictures(tmp_path: Path) -> None:
    from click.testing import CliRunner
    from phipsi.report import commands, view_robot  # noqa: F401  # registers the command

    result = CliRunner().invoke(commands.group, ["view", "-o", str(tmp_path / "arm.png")])
    assert result.exit_code == 0, result.output
    with Image.open(tmp_path / "arm.png") as opened:
        assert opened.size == picture.SIZE
    assert "--host" in CliRunner().invoke(commands.group, ["view", "--help"]).output


def test_the_camera_of_a_narrow_page_is_farther_away(tmp_path: Path) -> None:
    page = cube().show(to=tmp_path / "x.html").read_text(encoding="utf-8")
    (cameras,) = re.findall(r"const found = (\[\[.*?\]\])\.filter", page)
    aspects, positions = zip(*json.loads(cameras), strict=True)
    away = np.linalg.norm(np.array(positions), axis=1)
    assert list(aspects) == sorted(aspects) and np.all(np.diff(away) <= 1e-9) and away[0] > 2.0 * away[-1]
    # Before the scripts of the viewer, which read the position.
    assert page.index("initialCameraPosition") < page.index("__VISER_EMBED_DATA__")


def test_the_camera_of_a_page_follows_too() -> None:
    """The page moves its world back, so that the robot stays in front of the camera."""
    scene, rows = cube(), np.linspace(0.0, 2.0, 40)[:, None]
    for q, follows in ((rows, True), (0.2 * rows, False)):
        stage = player._Stage(scene, shapes_of(scene, None), 0, Motion(scene, q, np.linspace(0.0, 1.0, 40)))
        assert "<html" in stage.html(motion := Motion(scene, q, np.linspace(0.0, 1.0, 40)), "title")
        last = travel(scene, motion.frames()[1])[-1]
        assert np.allclose(stage.parents[0].position, -last, atol=1e-6) and bool(last.any()) == follows
        assert np.allclose(np.array(stage.center.position) + last, scene.center_of_mass(q[-1]), atol=1e-6)
        stage.close()
