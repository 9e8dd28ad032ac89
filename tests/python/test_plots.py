"""Plots of pages in a browser: all are drawn, nothing is cut off or overlaps, names are buttons, and there are no
network requests.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import phipsi
import pytest
from browsing import Opened, browser, needs_browser  # noqa: F401  # one is a fixture
from phipsi.report import draw, interactive, pipeline, robot, sections
from phipsi.report.page import Figure
from phipsi.report.pipeline import Findings, Layout, Section
from phipsi.report.plotting import Axis, Chart, Matrix, Panel, Part, Plot, Series, Space
from phipsi.report.progress import Silent
from phipsi.report.structure import tree_of

sys.path.insert(0, str(Path(__file__).parents[2] / "benches"))
import static

WIDTHS = (400, 1400)
LONG = "a_rather_long_name_of_a_joint_of_the_left_hand_of_a_robot"
NAMES = [LONG, f"{LONG}_2", "short", "<b>bold</b>", "$x_1^$", "&amp;", "%{x}", "右肩_関節"]
#: Moves the mouse to the first point of a curve, until its hover label shows.
HOVER = """([at, name]) => { const canvas = document.querySelector('.canvas'); Plotly.Fx.hover(canvas, [{curveNumber: at, pointNumber: 0}], 'xy');
const shown = canvas.querySelector('.hoverlayer').textContent; return shown.startsWith(name) && shown.includes(': 200ns'); }"""


def written(plots: Sequence[Plot], folder: Path) -> Path:
    """A page with only plots."""
    blocks = [Figure(plot.name, "") for plot in plots]
    only = Section[Findings]("plots", "Plots", plots=lambda _: plots, blocks=lambda _: blocks)
    # Independent of page.html of a layout: that of the stability report needs results.
    (folder / "templates" / "bare").mkdir(parents=True)
    (folder / "templates" / "bare" / "page.html").write_text('{% extends "page.html" %}', encoding="utf-8")
    layout: Layout[Findings] = Layout("bare", "numbers.json", (only,), (folder / "templates",))
    (page,) = pipeline.write(layout, Findings(True), folder)
    return page


def chart(names: Sequence[str], columns: int = 2) -> Chart:
    x = Axis.times("how long a call takes, as a rather long title that needs more than a line", 1e-7, 1e-5)
    y = Axis.powers("relative error of accelerations", 1e-17, 1e-3)
    series = [Series(name, "#0072b2", [2e-7, 1e-6, 8e-6], [10.0**-k, 1e-9, 1e-8], line=1.5, mark=6) for k, name in enumerate(names, 5)]
    return Chart("chart", [Panel(x, y, series, title) for title in ("one", "another", "a third")], columns)


def check(browser: Any, file: Path, names: Sequence[str]) -> list[dict[str, Any]]:  # noqa: F811
    """The page on a phone, and in a window that becomes wide; the plots there."""
    plots: list[dict[str, Any]] = []
    with Opened(browser, file, WIDTHS[0]) as opened:
        for width in WIDTHS:
            opened.resize(width)
            plots = opened.plots()
            assert [plot["name"] for plot in plots] == [f"plot-{name}" for name in names]
            for plot in plots:
                assert plot["traces"] > 0 and plot["drawn"] > 0, plot
                assert not plot["cut"] and not plot["over"], plot
                assert plot["width"] > 0.8 * min(width, 380)
            assert opened.wide() <= width
        opened.check(file)
    return plots


@needs_browser
def test_every_plot_of_a_report(browser: Any, tmp_path: Path) -> None:  # noqa: F811
    scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
    found = pipeline.collect(sections.ROBOT, robot.Report(True, "arm", "", scene, count=8), Silent())
    found.missing["view"] = "test_view.py opens it"
    (file,) = pipeline.write(sections.ROBOT, found, tmp_path)
    names = ("skeleton", "mass-matrix", "error-against-time", "error-against-condition", "emergence", "emergence-slopes", "growth")
    plots = check(browser, file, names)
    legend = next(plot["legend"] for plot in plots if plot["name"] == "plot-error-against-time")
    assert {"auto", "covariance", "dense Cholesky (faer)"} <= set(legend)


@needs_browser
def test_long_names_and_many_panels(browser: Any, tmp_path: Path) -> None:  # noqa: F811
    matrix = Matrix("matrix", 10.0 ** -np.arange(49.0).reshape(7, 7) / 8, NAMES, "size")
    space = Space("space", [Part("line", "#222222", np.eye(3), line=3.0), Part("dots", "#0072b2", np.eye(3), marks=6.0, texts=NAMES[:3])], np.ones(3))
    plots = check(browser, written([chart(NAMES), matrix, space], tmp_path), ("chart", "matrix", "space"))
    assert plots[0]["legend"] == NAMES


@needs_browser
def test_names_under_the_mouse_are_what_they_are(browser: Any, tmp_path: Path) -> None:  # noqa: F811
    """No tag is interpreted, no formula is typeset."""
    file = written([chart(NAMES)], tmp_path)
    with Opened(browser, file, 400) as opened:
        opened.plots()
        for at, name in enumerate(NAMES):
            opened.page.wait_for_function(HOVER, arg=[at, interactive.shortened(name)], timeout=20_000, polling=100)
        opened.check(file)


@needs_browser
def test_names_are_buttons(browser: Any, tmp_path: Path) -> None:  # noqa: F811
    file = written([chart(["one", "two", "three"])], tmp_path)
    shown = "() => document.querySelector('.canvas').data.map(trace => trace.visible !== false)"
    with Opened(browser, file, 1400) as opened:
        opened.plots()
        opened.page.get_by_role("button", name="two").click()
        assert opened.page.evaluate(shown) == [True, False, True] * 3
        assert opened.page.get_by_role("button", name="two").get_attribute("aria-pressed") == "false"
        opened.page.get_by_role("button", name="two").click()
        assert opened.page.evaluate(shown) == [True] * 9
        opened.page.get_by_role("button", name="three").dblclick()
        assert opened.page.evaluate(shown) == [False, False, True] * 3
        # The same after the window has become narrow, with one panel per row.
        opened.resize(400)
        assert opened.page.evaluate(shown) == [False, False, True] * 3
        opened.page.get_by_role("button", name="three").dblclick()
        assert opened.page.evaluate(shown) == [True] * 9
        assert opened.wide() <= 400
        opened.check(file)


def figure(plot: Plot) -> dict[str, Any]:
    """Contents of the page."""
    (content,) = re.findall(r'<script type="application/json">(.*?)</script>', interactive.markup(plot), flags=re.DOTALL)
    found: dict[str, Any] = json.loads(content)
    return found


def test_numbers_that_are_none_are_gaps() -> None:
    axis = Axis("x")
    plot = Chart("c", [Panel(axis, axis, [Series("s", "#000000", [0.0, 1.0, np.inf], [1.0, np.nan, 2.0], line=1.0)])])
    (trace,) = figure(plot)["traces"]
    assert trace["x"] == [0.0, 1.0, None] and trace["y"] == [1.0, None, 2.0]


def test_a_script_cannot_be_ended_by_a_name() -> None:
    text = str(interactive.markup(chart(["</script><script>alert(1)</script>"])))
    assert text.count("<script") == 1 and text.count("</script") == 1


def test_every_joint_and_mass_is_told_in_the_figure() -> None:
    scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM, floating_base=True)
    tree = tree_of(scene)
    traces = figure(draw.skeleton(scene, tree, scene.neutral()))["traces"]
    told = [text for trace in traces for text in trace.get("hovertext", ())]
    for joint in tree.movable:
        assert any(text.startswith(f"{joint.name}<br>{tree.numbers[joint.name]}: {joint.type}") for text in told)
    for link in tree.links.values():
        if link.mass > 0.0:
            assert any(text.startswith(f"{link.name}<br>") and "kg" in text for text in told)
    written_beside = [text for trace in traces if "text" in trace["mode"] for text in trace["text"]]
    assert written_beside[:4] == ["1–2", "3", "4", "5–7"]


def test_pictures_for_markdown() -> None:
    assert static.draw(chart(["one", LONG])).startswith(b"\x89PNG")
    with pytest.raises(TypeError, match="expected a Chart"):
        static.draw(Space("s", [], np.ones(3)))
