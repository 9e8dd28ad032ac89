"""Names with $, _, ^, of other scripts and of control characters in every picture; pytest makes warnings errors."""

from __future__ import annotations

import logging
import re
from pathlib import Path
from xml.sax.saxutils import quoteattr

import matplotlib as mpl
import numpy as np
import phipsi
import pytest
from click.testing import CliRunner
from matplotlib import font_manager
from phipsi.report import commands, draw, motion, names, pipeline, simulate  # noqa: F401  # the last registers its command
from phipsi.report.progress import Silent
from phipsi.report.run import RUN, Run
from phipsi.report.plotting import STYLE
from phipsi.report.structure import tree_of

NAMES = {
    "dollars": "$x_1^$",
    "one dollar": "cost$",
    "mathematics": r"$\alpha_{2}$ \$",
    "broken mathematics": r"$\frac{$",
    "underscore first": "_hidden",
    "carets": "a^b_c^^__",
    "tex": r"\textbf{%&#~}",
    "japanese": "右肩_関節",
    "chinese": "机械臂",
    "korean": "팔꿈치",
    "arabic": "مرفق",
    "greek": "Δθ₁",
    "emoji": "🤖🦾",
    "joined emoji": "👩‍🔧️",
    "private": "\ue000\U000f0000",
    "markup": "<b>&amp;[red]",
    "quotes": "\"'`",
    "empty": "",
    "space": "  ",
    "long": "very_long_name_" * 20,
}
CONTROLS = {"control": "a\x07b\x1b[0m", "lines": "one\ntwo\ttabs\r", "marks": "\u202e\u200bz\ufeff"}


def scene_of(name: str) -> phipsi.Scene:
    builder = phipsi.SceneBuilder().link(f"{name} base").link(name, 1.0, (0.1, 0, 0.2), np.eye(3)).link(f"{name} tip", 1.0, (0, 0, 0.1))
    builder.joint(name, "revolute", f"{name} base", name, axis=(0, 1, 0), xyz=(0, 0, 0.1))
    return builder.joint(f"{name}2", "spherical", name, f"{name} tip", xyz=(0, 0, 0.3), armature=0.1).build()


@pytest.mark.parametrize("case", [*NAMES, *CONTROLS])
def test_the_pictures_of_a_simulation(case: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    scene = scene_of((NAMES | CONTROLS)[case])
    path = scene.simulate(scene.neutral(), np.full(4, 0.1), dt=1e-3, steps=5)
    with caplog.at_level(logging.WARNING):
        motion.write(path, tmp_path, table=True)
        found = Run(False, NAMES.get(case, case), path, tree_of(scene), np.ones_like(path.qd))
        pipeline.write(RUN, pipeline.collect(RUN, found, Silent()), tmp_path)
    assert not caplog.records
    assert {file.name for file in tmp_path.iterdir()} >= {"index.html", "motion.png", "stroboscope.png", "trajectory.csv"}


@pytest.mark.parametrize("case", NAMES)
def test_the_command(case: str, tmp_path: Path) -> None:
    name = quoteattr(NAMES[case])
    body = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    robot = tmp_path / "robot.urdf"
    robot.write_text(
        f'<robot name={name}><link name="base"/><link name={name}>{body}</link><joint name={name} type="continuous">'
        f'<parent link="base"/><child link={name}/></joint></robot>',
        encoding="utf-8",
    )
    if not NAMES[case].strip():
        return  # refused by the reader, or not, by its own rules
    result = CliRunner().invoke(commands.group, ["simulate", str(robot), "-o", str(tmp_path / "out"), "--time", "0.01"])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out" / "motion.png").stat().st_size > 1000


@pytest.mark.parametrize("case", [*NAMES, *CONTROLS])
def test_the_figure_of_the_robot(case: str, caplog: pytest.LogCaptureFixture) -> None:
    scene = scene_of((NAMES | CONTROLS)[case])
    with caplog.at_level(logging.WARNING):
        found = draw.skeleton(scene, tree_of(scene), scene.neutral())
    assert not caplog.records
    assert found.png.startswith(b"\x89PNG") and found.svg.startswith("<svg")


def shown(name: str) -> str:
    """The name as it stands in the picture."""
    scene = scene_of(name)
    path = scene.simulate(scene.neutral(), np.zeros(4), dt=1e-3, steps=1)
    svg = motion.motion_plot(path).svg
    return svg.replace("&amp;", "&").replace("&lt;", "<").replace("&gt;", ">")


@pytest.mark.parametrize("case", ["dollars", "one dollar", "mathematics", "underscore first", "carets", "tex", "greek"])
def test_names_that_the_font_has_are_shown_as_they_are(case: str) -> None:
    assert NAMES[case] in shown(NAMES[case])


def test_names_that_no_font_has_are_spelled_out() -> None:
    assert r">a\ue000b" in shown("a\ue000b")
    assert r">one\ntwo" in shown("one\ntwo")


def test_a_font_that_has_them_is_found() -> None:
    with mpl.rc_context(STYLE):
        default = tuple(mpl.rcParams["font.family"])
        families = names._families("臂é", default)
        for character in "臂é":
            at = (*default, *families)
            known = names.readable(character, at)
            assert known == (character if any(names._has(family, character) for family in at) else character.encode("unicode_escape").decode())
        # A font of everything that is installed for the purpose of the test.
        assert names._families("e", default) == []


def test_a_fallback_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """A family that has what the default one lacks, here made up of two that the plotting library ships."""
    lacking = next(
        chr(code) for code in range(0x2000, 0x30000)
        if chr(code).isprintable() and names._has("STIXGeneral", chr(code)) and not names._has("DejaVu Sans", chr(code))
    )  # fmt: skip
    with mpl.rc_context(STYLE):
        assert names._families(lacking, ("DejaVu Sans",)) != []
    assert lacking in shown(f"a{lacking}b")
    assert {entry.name for entry in font_manager.fontManager.ttflist} >= {"STIXGeneral", "DejaVu Sans"}


def test_settings_of_the_user_do_not_matter(tmp_path: Path) -> None:
    with mpl.rc_context({"text.usetex": True, "text.parse_math": True}):
        scene = scene_of("a_b$")
        path = scene.simulate(scene.neutral(), np.zeros(4), dt=1e-3, steps=1)
        assert re.search(r">a_b\$<", motion.motion_plot(path).svg)
