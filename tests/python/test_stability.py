"""The stability report: measurements, summary, and the command."""

from __future__ import annotations

import json
import math
import re
import sys
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from browsing import Opened, browser, needs_browser  # noqa: F401  # one is a fixture
from click.testing import CliRunner
from phipsi.report import commands, pipeline
from phipsi.report.progress import Silent
from phipsi.report.stability import STABILITY, Stability, loops
from phipsi.report.stability.measure import AUTO, COVARIANCE, ROOT

import phipsi

sys.path.insert(0, str(Path(__file__).parents[2] / "benches"))
import static


@pytest.fixture(scope="module")
def found() -> Stability:
    return pipeline.collect(STABILITY, Stability(True), Silent())


def test_every_case_and_value_is_there(found: Stability) -> None:
    for name in phipsi.scenes.names():
        values = phipsi.scenes.extreme(name).values
        skipped = {0.0} if name == "zero-inertia" else {v for v in values if name == "long-chain" and v > 1000}
        assert [point.value for point in found.of(name)] == [value for value in values if value not in skipped]
    assert "joint5" in found.parts["singular"]
    for point in found.points:
        assert point.floor.norm > 0.0
        assert set(point.errors) >= set(phipsi._core.FORMS)
        assert point.errors[ROOT].reason is None


def test_a_failure_has_a_reason_and_nothing_else_is_nan(found: Stability) -> None:
    for point in found.points:
        for error in point.errors.values():
            assert math.isnan(error.norm) == math.isnan(error.component) == (error.reason is not None)


def test_the_forms_are_told_apart(found: Stability) -> None:
    heavy = next(point for point in found.of("heavy-tip") if point.value == 1e12)
    assert heavy.errors[ROOT].norm < 1e-12
    assert heavy.errors[COVARIANCE].norm > 1e-6
    assert heavy.errors[AUTO].norm < 1e-12
    assert heavy.floor.norm < 1e-14


def test_loops_keep_their_digits_where_covariances_and_dense_algebra_do_not(found: Stability) -> None:
    rows = {(row.heavy, row.ratio): row for row in found.parts["loops"]}
    assert set(rows) == {("none", 1.0)} | {(name, ratio) for name in loops.HEAVY for ratio in loops.RATIOS[1:]}
    for key, row in rows.items():
        assert row.sensitivity.norm > 0.0
        for form in ("auto", "square-root"):
            assert row.errors[form].norm <= max(2e-12, 20 * row.sensitivity.norm), (key, form)
    heavy = rows["last", 1e8]
    assert heavy.errors["square-root"].norm < 1e-13 < 1e-11 < min(heavy.errors[key].norm for key in ("covariance", loops.DENSE))


@pytest.mark.parametrize(("name", "ratio"), [("last", 1e8), ("third", 1e-8), ("every other", 1.0)])
def test_exact_accelerations_are_those_of_places_in_fifty_digits(name: str, ratio: float) -> None:
    one = loops.linkage(loops.HEAVY[name], ratio, 3)
    with mpmath.workdps(60):
        length, com, mass, inertia, q, qd, tau = (
            [mpmath.mpf(x) for x in row] for row in (one.length, one.com, one.mass, one.inertia, one.q, one.qd, one.tau)
        )
        n, h = len(q), mpmath.mpf(10) ** -20

        def places(joints: list[Any]) -> list[Any]:
            """For every link, z and x of its center of mass and its angle, each times the square root of its inertia;
            the position error of the end is attributed to the last link.
            """
            end, angle, rows = mpmath.mpc(0), mpmath.mpf(0), []
            for k in range(n):
                angle += joints[k]
                center = mpmath.sqrt(mass[k]) * (end + com[k] * mpmath.expj(angle))
                rows += [center.real, center.imag, mpmath.sqrt(inertia[k]) * angle]
                end += length[k] * mpmath.expj(angle)
            missing = mpmath.expj(-angle) * (mpmath.mpc(0, loops.APART) - end)
            return [*rows, missing.real, missing.imag]

        def along(step: list[Any], size: int) -> list[Any]:
            return places([x + size * h * v for x, v in zip(q, step, strict=True)])

        units = [[mpmath.mpf(i == k) for i in range(n)] for k in range(n)]
        columns = [[(a - b) / (2 * h) for a, b in zip(along(unit, 1), along(unit, -1), strict=True)] for unit in units]
        curved = [(a - 2 * m + b) / h**2 for a, m, b in zip(along(qd, 1), places(q), along(qd, -1), strict=True)]
        # Gauss: of the accelerations that satisfy the constraint at the end, those nearest to the free accelerations.
        free = [-mpmath.sqrt(mass[k // 3]) * mpmath.mpf(loops.GRAVITY) if k % 3 == 0 else mpmath.mpf(0) for k in range(3 * n)]
        short = [f - c for f, c in zip(free, curved, strict=False)]
        matrix, right = mpmath.zeros(n + 2), mpmath.zeros(n + 2, 1)
        for i, column in enumerate(columns):
            for k, other in enumerate(columns):
                matrix[i, k] = mpmath.fdot(column[: 3 * n], other[: 3 * n])
            for k in range(2):
                matrix[i, n + k] = matrix[n + k, i] = column[3 * n + k]
            right[i] = tau[i] + mpmath.fdot(column[: 3 * n], short)
        right[n], right[n + 1] = -curved[3 * n], -curved[3 * n + 1]
        expected = np.array([float(x) for x in mpmath.lu_solve(matrix, right)[:n]])
    assert np.abs(one.exact() - expected).max() <= 2 * np.finfo(float).eps * np.abs(expected).max()


def test_json_has_no_nan(found: Stability) -> None:
    text = json.dumps(pipeline.to_json(STABILITY, found), allow_nan=False)
    again = json.loads(text)
    assert len(again["cases"]) == len(found.points)
    assert len(again["timed"]) == 4 * len(phipsi._core.FORMS)
    assert {row["quantity"] for row in again["recursions"]} == set(phipsi._core.QUANTITIES[1:4])
    assert {row["case"] for row in again["derivatives"]} >= {"heavy-tip", "long-lever"}


def test_the_pages_are_written(found: Stability, tmp_path: Path) -> None:
    index, markdown = pipeline.write(STABILITY, found, tmp_path / "report", tmp_path / "docs" / "numerics.md", drawer=static.draw)
    text = index.read_text(encoding="utf-8")
    assert text.index("Cases in which the square-root form misses") < text.index("heavy-tip")
    assert "`" not in re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    assert text.count('<div class="plot"') == 6
    assert {file.name for file in (tmp_path / "report").iterdir()} == {"index.html", "stability.json"}
    written = markdown.read_text(encoding="utf-8")
    assert "{{" not in written and "{%" not in written and "peer" not in written.partition("## Failures")[0]
    pictures = list((tmp_path / "docs").glob("*.png"))
    assert len(pictures) == 6
    for picture in pictures:
        assert f"({picture.name})" in written
    assert "## Loss of precision in the covariance form" in written
    for name in phipsi.scenes.names():
        assert f"### {name}" in written


@needs_browser
def test_every_plot_is_drawn(browser: Any, tmp_path: Path, found: Stability) -> None:  # noqa: F811
    (file,) = pipeline.write(STABILITY, found, tmp_path)
    with Opened(browser, file, 400) as opened:
        for width in (400, 1400):
            opened.resize(width)
            plots = opened.plots()
            assert len(plots) == 6
            for plot in plots:
                assert plot["drawn"] > 0 and not plot["cut"] and not plot["over"], plot
            assert opened.wide() <= width
        opened.check(file)


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, found: Stability) -> None:
    monkeypatch.setattr(pipeline, "collect", lambda *_: found)
    result = CliRunner().invoke(commands.group, ["report", "--stability", "-o", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out" / "index.html").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["--stability"],
        ["robot.urdf", "--stability", "-o", "out"],
        ["--stability", "-o", "out", "--states", "3"],
        [],
    ],
)
def test_options_that_do_not_go_together(arguments: list[str]) -> None:
    result = CliRunner().invoke(commands.group, ["report", *arguments])
    assert result.exit_code == 2
    assert "Error" in result.output
