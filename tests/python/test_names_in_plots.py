"""Names with $, _, ^, of other scripts and with control characters on pages; pytest makes warnings errors."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import phipsi
import pytest
from click.testing import CliRunner
from phipsi.report import commands, draw, interactive, pipeline, simulate  # noqa: F401  # the last registers its command
from phipsi.report.progress import Silent
from phipsi.report.run import RUN, Run
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
    "arabic": "مرفق",
    "greek": "Δθ₁",
    "joined emoji": "👩‍🔧️",
    "private": "\ue000\U000f0000",
    "markup": "<b>&amp;[red]",
    "script": "</script><script>",
    "template": "%{x}{{ y }}",
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


def contents(page: str) -> list[dict[str, Any]]:
    """The plots of a page."""
    return [json.loads(text) for text in re.findall(r'<script type="application/json">(.*?)</script>', page, flags=re.DOTALL)]


@pytest.mark.parametrize("case", [*NAMES, *CONTROLS])
def test_the_page_of_a_simulation(case: str, tmp_path: Path) -> None:
    name = (NAMES | CONTROLS)[case]
    scene = scene_of(name)
    path = scene.simulate(scene.neutral(), np.full(4, 0.1), dt=1e-3, steps=5)
    found = Run(False, name, path, tree_of(scene), np.ones_like(path.qd))
    (page,) = pipeline.write(RUN, pipeline.collect(RUN, found, Silent()), tmp_path)
    text = page.read_bytes().decode()
    curves, _, picture = contents(text)  # of joints, of energies, in space
    # Plotly interprets names as HTML; ours contain none.
    assert html.escape(interactive.shortened(name), quote=False) in {trace["name"] for trace in curves["traces"]}
    assert picture["traces"]
    legend = re.findall(r"<button[^>]*><i [^>]*>.?</i>(.*?)</button>", text, flags=re.DOTALL)
    assert name in map(html.unescape, legend)


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
        return  # refused by the reader or not, by its own rules
    result = CliRunner().invoke(commands.group, ["simulate", str(robot), "-o", str(tmp_path / "out"), "--time", "0.01"])
    assert result.exit_code == 0, result.output
    assert len(contents((tmp_path / "out" / "index.html").read_text(encoding="utf-8"))) == 3


@pytest.mark.parametrize("case", [*NAMES, *CONTROLS])
def test_the_figure_of_the_robot(case: str) -> None:
    name = (NAMES | CONTROLS)[case]
    scene = scene_of(name)
    (figure,) = contents(interactive.markup(draw.skeleton(scene, tree_of(scene), scene.neutral())))
    told = [text for trace in figure["traces"] for text in trace.get("hovertext", ())]
    parts = name.split("\n")
    assert any(text.startswith(html.escape(interactive.shortened(parts[0]), quote=False)) for text in told)
