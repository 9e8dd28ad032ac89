"""The stability report: what it measures, what it says first, and the command."""

from __future__ import annotations

import importlib
import json
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from phipsi.report import commands, stability
from phipsi.report.progress import Silent
from phipsi.report.stability import page, peers
from phipsi.report.stability.collect import (
    AGREEMENT,
    COVARIANCE,
    ORDINARY,
    ROOT,
    Error,
    Point,
    Stability,
    collect,
    compared,
    to_json,
    worse,
)
from phipsi.report.stability.peers import Peer
from tolerances import assert_near

import phipsi


@pytest.fixture(scope="module")
def found() -> Stability:
    return collect(Silent(), quick=True)


def test_every_case_and_value_is_there(found: Stability) -> None:
    for name in phipsi.scenes.names():
        values = phipsi.scenes.extreme(name).values
        skipped = {0.0} if name == "zero-inertia" else {v for v in values if name == "long-chain" and v > 1000}
        assert [point.value for point in found.of(name)] == [value for value in values if value not in skipped]
    assert "joint5" in found.singular
    for point in found.points:
        assert point.floor > 0.0
        assert set(point.errors) >= {
            (form, precision) for form in phipsi._core.FORMS for precision in ("float64", "float32")
        }
        assert point.errors[ROOT, "float64"].reason is None


def test_a_failure_has_a_reason_and_nothing_else_is_nan(found: Stability) -> None:
    for point in found.points:
        for error in point.errors.values():
            assert math.isnan(error.norm) == math.isnan(error.component) == (error.reason is not None)


def test_the_forms_are_told_apart(found: Stability) -> None:
    heavy = next(point for point in found.of("heavy-tip") if point.value == 1e12)
    assert heavy.errors[ROOT, "float64"].norm < 1e-12
    assert heavy.errors[COVARIANCE, "float64"].norm > 1e-6
    assert heavy.floor < 1e-14


def test_json_has_no_nan(found: Stability) -> None:
    text = json.dumps(to_json(found), allow_nan=False)
    again = json.loads(text)
    assert len(again["cases"]) == len(found.points)
    assert len(again["timed"]) == 32
    assert {row["quantity"] for row in again["recursions"]} == set(phipsi._core.QUANTITIES[1:])


def point(ours: float, theirs: float) -> Point:
    sensitivity = {"state": Error(1e-16, 1e-16), "axes": Error(2e-16, 1e-15)}
    errors = {
        (form, precision): Error(ours, ours) for form in phipsi._core.FORMS for precision in ("float64", "float32")
    }
    errors["Peer", "float64"] = Error(theirs, theirs)
    return Point("heavy-tip", 1.0, 0, 8, sensitivity, errors)


@pytest.mark.parametrize(
    ("ours", "theirs", "expected"),
    [
        (1e-9, 1e-10, 2),
        (1e-9, 1e-8, 0),
        (1.5e-15, 1e-17, 1),
        (1e-16, 1e-17, 0),
        (math.nan, 1e-8, 2),
        (1e-9, math.nan, 0),
    ],
)
def test_where_phipsi_is_worse_is_found(found: Stability, ours: float, theirs: float, expected: int) -> None:
    peer = Peer("Peer", "Peer 1", lambda scene: lambda q, qd, tau: tau)
    made = Stability(True, [0], found.date, found.machine, [peer], [point(ours, theirs)], found.timed, [])
    rows = worse(made, ROOT)
    assert len(rows) == expected
    text = page.markdown(made, [], "numerics")
    assert text.index("Where phipsi is worse than a peer") < text.index("## Where the square-root form misses")
    assert ("| heavy-tip | Peer |" in text) == bool(expected)


MODULES = {"MuJoCo": "mujoco", "Drake": "pydrake.all", "dynibo": "dynibo"}


def of_name(name: str) -> Peer:
    return next(peer for peer in peers.installed()[0] if peer.name == name)


@pytest.mark.parametrize("case", ORDINARY)
@pytest.mark.parametrize("name", MODULES)
def test_a_peer_agrees_with_pinocchio_where_nothing_is_extreme(name: str, case: str) -> None:
    pytest.importorskip("pinocchio")
    pytest.importorskip(MODULES[name])
    peer = of_name(name)
    made = phipsi.scenes.extreme(case, 1.0, seed=3)
    scene = made.scene if peer.gravity is None else peers.under_gravity(made.scene, peer.gravity)
    state = (made.q, made.qd, made.tau)
    if (name, case) == ("dynibo", "armature"):
        with pytest.raises(peers.Refused, match="armature"):
            peer.solver(scene)(*state)
        return
    expected = of_name("Pinocchio, local").solver(scene)(*state)
    assert_near(peer.solver(scene)(*state), expected, AGREEMENT * np.max(np.abs(expected)))


def test_every_peer_installed_is_compared() -> None:
    assert [peer.name for peer in compared()[0]] == [peer.name for peer in peers.installed()[0]]


@pytest.mark.parametrize(
    ("name", "case", "value", "message"),
    [
        ("MuJoCo", "massless-middle", 0.0, "mjMINVAL"),
        ("dynibo", "heavy-tip", 1.0, "gravity"),
        ("Drake", "long-chain", 1000, "beyond"),
    ],
)
def test_what_a_peer_does_not_take_it_says(name: str, case: str, value: float, message: str) -> None:
    pytest.importorskip(MODULES[name])
    with pytest.raises(peers.Refused, match=message):
        of_name(name).solver(phipsi.scenes.extreme(case, value).scene)


def test_programs_that_are_not_there_are_named(monkeypatch: pytest.MonkeyPatch, found: Stability) -> None:
    def absent(name: str) -> None:
        raise ModuleNotFoundError(name)

    with monkeypatch.context() as patch:
        patch.setattr(importlib, "import_module", absent)
        others, lines = compared()
    assert others == []
    assert [line.split(" is not installed")[0] for line in lines] == ["Pinocchio", "MuJoCo", "Drake", "dynibo"]
    made = Stability(True, [0], found.date, found.machine, others, [point(1.0, 1.0)], found.timed, absent=lines)
    for text in (page.markdown(made, [], "numerics"), page.html(made, [])):
        assert text.index("pip install drake") < text.index("Where the square-root form misses")
    assert to_json(made)["not_compared"] == lines


@pytest.mark.parametrize("wrong", [1.0 + 1e-9, math.nan])
def test_a_peer_that_is_wrong_on_ordinary_scenes_is_left_out(wrong: float, monkeypatch: pytest.MonkeyPatch) -> None:
    good = Peer("Good", "Good 1", lambda scene: lambda q, qd, tau: scene.forward_dynamics(q, qd, tau))
    bad = Peer("Bad", "Bad 1", lambda scene: lambda q, qd, tau: wrong * scene.forward_dynamics(q, qd, tau))
    monkeypatch.setattr(peers, "installed", lambda: ([good, bad], ["Other is not installed."]))
    kept, lines = compared()
    assert kept == [good]
    assert lines[0] == "Other is not installed."
    assert lines[1].startswith("Bad (Bad 1) is off by ")
    assert len(lines) == 2


def test_a_peer_that_takes_no_ordinary_scene_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: phipsi.Scene) -> peers.Solver:
        raise peers.Refused("never")

    monkeypatch.setattr(peers, "installed", lambda: ([Peer("Shy", "Shy 1", refuse)], []))
    kept, lines = compared()
    assert kept == []
    assert len(lines) == 1


def test_the_pages_are_written(found: Stability, tmp_path: Path) -> None:
    index = stability.write(found, tmp_path / "report")
    text = index.read_text(encoding="utf-8")
    assert text.index("Where phipsi is worse than a peer") < text.index("heavy-tip")
    assert text.count("<svg") == 6
    assert len(list((tmp_path / "report").glob("*.png"))) == 6
    written = stability.write_markdown(found, tmp_path / "docs" / "numerics.md").read_text(encoding="utf-8")
    assert "{{" not in written
    for picture in (tmp_path / "docs").glob("*.png"):
        assert f"({picture.name})" in written
    assert "Why deleting a column does not" in written
    for name in phipsi.scenes.names():
        assert f"### {name}" in written


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, found: Stability) -> None:
    monkeypatch.setattr(stability, "collect", lambda *_, **__: found)
    result = CliRunner().invoke(commands.group, ["report", "--stability", "-o", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out" / "index.html").exists()
    result = CliRunner().invoke(commands.group, ["report", "--stability", "--markdown", str(tmp_path / "n.md")])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "n.md").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["--stability"],
        ["--markdown", "n.md"],
        ["-o", "out", "--markdown", "n.md"],
        ["robot.urdf", "--stability", "-o", "out"],
        ["--stability", "-o", "out", "--states", "3"],
        [],
    ],
)
def test_options_that_do_not_go_together(arguments: list[str]) -> None:
    result = CliRunner().invoke(commands.group, ["report", *arguments])
    assert result.exit_code == 2
    assert "Error" in result.output
