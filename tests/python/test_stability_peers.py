"""The stability study of benches/: phipsi's report with other programs."""

from __future__ import annotations

import importlib
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from phipsi.report import pipeline
from phipsi.report.progress import Silent
from phipsi.report.stability.measure import ROOT, Error, Other, Point
from tolerances import assert_near

import phipsi

sys.path.insert(0, str(Path(__file__).parents[2] / "benches"))
import static
from studies import programs, stability
from studies.programs import Peer
from studies.stability import AGREEMENT, COMPARED, ORDINARY, Compared, compared, worse


@pytest.fixture(scope="module")
def found() -> Compared:
    return stability.collect(Silent(), quick=True)


def test_the_study_is_the_report_with_the_peers_beside(found: Compared) -> None:
    names = [other.name for other in found.others]
    assert found.methods[5:] == tuple(names)
    for one in found.points:
        assert set(one.errors) == {*phipsi._core.FORMS, *names}
        for error in one.errors.values():
            assert math.isnan(error.norm) == math.isnan(error.component) == (error.reason is not None)
    sections = [section.key for section in COMPARED.sections]
    assert sections[0] == "worse" and sections[1:] == [section.key for section in phipsi.report.stability.STABILITY.sections]


def point(ours: float, theirs: float) -> Point:
    sensitivity = {"state": Error(1e-16, 1e-16), "axes": Error(2e-16, 1e-15)}
    errors = {form: Error(ours, ours) for form in phipsi._core.FORMS}
    errors["Peer"] = Error(theirs, theirs)
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
def test_where_phipsi_is_worse_is_found(
    found: Compared, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ours: float, theirs: float, expected: int
) -> None:
    monkeypatch.setattr(pipeline, "draw", lambda *_: [])
    peer = Other("Peer", "Peer 1", "#000000", lambda case, exact: Error(theirs, theirs))
    made = Compared(True, others=[peer], parts=found.parts | {"cases": [point(ours, theirs)]})
    rows = worse(made, ROOT)
    assert len(rows) == expected
    text = pipeline.write(COMPARED, made, None, tmp_path / "numerics.md", drawer=static.draw)[0].read_text(encoding="utf-8")
    assert text.index("Cases in which a peer is more accurate") < text.index("## Cases in which the square-root form misses")
    assert ("| heavy-tip | Peer |" in text) == bool(expected)


MODULES = {"MuJoCo": "mujoco", "Drake": "pydrake.all", "dynibo": "dynibo"}


def of_name(name: str) -> Peer:
    return next(peer for peer in programs.installed()[0] if peer.name == name)


@pytest.mark.parametrize("case", ORDINARY)
@pytest.mark.parametrize("name", MODULES)
def test_a_peer_agrees_with_pinocchio_where_nothing_is_extreme(name: str, case: str) -> None:
    pytest.importorskip("pinocchio")
    pytest.importorskip(MODULES[name])
    peer = of_name(name)
    made = phipsi.scenes.extreme(case, 1.0, seed=3)
    scene = made.scene if peer.gravity is None else programs.under_gravity(made.scene, peer.gravity)
    state = (made.q, made.qd, made.tau)
    if (name, case) == ("dynibo", "armature"):
        with pytest.raises(programs.Refused, match="armature"):
            peer.solver(scene)(*state)
        return
    expected = of_name("Pinocchio, local").solver(scene)(*state)
    assert_near(peer.solver(scene)(*state), expected, AGREEMENT * np.max(np.abs(expected)))


def test_every_peer_installed_is_compared(found: Compared) -> None:
    assert [other.name for other in found.others] == [peer.name for peer in programs.installed()[0]]


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
    with pytest.raises(programs.Refused, match=message):
        of_name(name).solver(phipsi.scenes.extreme(case, value).scene)


def test_programs_that_are_not_there_are_named(monkeypatch: pytest.MonkeyPatch, found: Compared, tmp_path: Path) -> None:
    def absent(name: str) -> None:
        raise ModuleNotFoundError(name)

    with monkeypatch.context() as patch:
        patch.setattr(importlib, "import_module", absent)
        others, lines = compared()
    assert others == []
    assert [line.split(" is not installed")[0] for line in lines] == ["Pinocchio", "MuJoCo", "Drake", "dynibo"]
    made = Compared(True, others=others, absent=lines, parts=found.parts | {"cases": [point(1.0, 1.0)]})
    monkeypatch.setattr(pipeline, "draw", lambda *_: [])
    for text in (page.read_text(encoding="utf-8") for page in pipeline.write(COMPARED, made, tmp_path, tmp_path / "n.md", drawer=static.draw)):
        assert text.index("pip install drake") < text.rindex("Cases in which the square-root form misses")
    assert pipeline.to_json(COMPARED, made)["not_compared"] == lines


@pytest.mark.parametrize("wrong", [1.0 + 1e-9, math.nan])
def test_a_peer_that_is_wrong_on_ordinary_scenes_is_left_out(wrong: float, monkeypatch: pytest.MonkeyPatch) -> None:
    good = Peer("Good", "Good 1", lambda scene: lambda q, qd, tau: scene.forward_dynamics(q, qd, tau))
    bad = Peer("Bad", "Bad 1", lambda scene: lambda q, qd, tau: wrong * scene.forward_dynamics(q, qd, tau))
    monkeypatch.setattr(programs, "installed", lambda: ([good, bad], ["Other is not installed."]))
    kept, lines = compared()
    assert [other.name for other in kept] == ["Good"]
    assert lines[0] == "Other is not installed."
    assert lines[1].startswith("Bad (Bad 1) has an error of ")
    assert len(lines) == 2


def test_a_peer_that_takes_no_ordinary_scene_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: phipsi.Scene) -> programs.Solver:
        raise programs.Refused("never")

    monkeypatch.setattr(programs, "installed", lambda: ([Peer("Shy", "Shy 1", refuse)], []))
    kept, lines = compared()
    assert kept == []
    assert len(lines) == 1


def test_the_pages_are_written(found: Compared, tmp_path: Path) -> None:
    index, markdown = stability.write(found, tmp_path / "report", tmp_path / "docs" / "numerics.md")
    for text in (index.read_text(encoding="utf-8"), markdown.read_text(encoding="utf-8")):
        assert text.index("Cases in which a peer is more accurate") < text.rindex("Cases in which the square-root form misses")
        assert all(other.name in text for other in found.others)
    assert "{%" not in text and "through their own builders" in text
    assert len(list((tmp_path / "docs").glob("*.png"))) == text.count("![") == 6
