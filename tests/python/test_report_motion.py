"""The motion study of benches/: references, orders, failures, the page and the command. No test asserts a time."""

from __future__ import annotations

import dataclasses
import importlib
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import phipsi
import pytest
from click.testing import CliRunner
from phipsi.report import commands, pipeline
from phipsi.report.plotting import Plot
from phipsi.report.progress import Silent
from tolerances import assert_near, inverse, solve

BENCHES = Path(__file__).parents[2] / "benches"
sys.path.insert(0, str(BENCHES))
from studies import motion
from studies.motion import MOTION, Study, cases, collect, order, peers, reference, runs, slow, to_json
from studies.motion.collect import expected

SMOOTH = ("double pendulum", "arm", "floating tree", "chain of 64")
SPRINGS = ("springs 1e3", "springs 1e5", "springs 1e7", "springs 1e9")
EXPLICIT, IMPLICIT = ("semi-implicit-euler", "rk4"), ("implicit-euler", "rosenbrock-2", "rosenbrock-3")
#: Tolerance of a measured order in a quick run.
ORDER = 0.1


@pytest.fixture(scope="module")
def study() -> Study:
    threads = phipsi.get_num_threads()
    found = collect(Silent(), quick=True)
    assert phipsi.get_num_threads() == threads
    return found


@pytest.fixture(scope="module")
def drawn(study: Study) -> list[Plot]:
    """Drawing takes seconds."""
    return pipeline.draw(MOTION, study)


@pytest.fixture(scope="module")
def numbers(study: Study) -> dict[str, Any]:
    """report.json."""
    found: dict[str, Any] = json.loads(json.dumps(to_json(study), allow_nan=False))
    return found


def case_of(numbers: dict[str, Any], name: str) -> dict[str, Any]:
    return next(case for case in numbers["cases"] if case["name"] == name)


@pytest.mark.parametrize("name", SMOOTH)
def test_orders_on_smooth_scenes(numbers: dict[str, Any], name: str) -> None:
    orders = case_of(numbers, name)["orders"]
    for method, wanted in (*zip(EXPLICIT, (1, 4), strict=True), *zip(IMPLICIT, (1, 2, 3), strict=True)):
        assert abs(orders[method] - wanted) <= ORDER, (method, orders[method])


def test_orders_of_the_peers_are_those_of_their_integrators(study: Study) -> None:
    for peer in study.peers:
        for result in study.smooth:
            measured = result.order(peer.name)
            assert measured is not None
            # The runs of the Python loops are shorter: the double pendulum is not in its asymptotic range yet.
            assert abs(measured - expected(study, peer.name)) <= 2 * ORDER, (peer.name, result.case.name)


@pytest.mark.parametrize("name", SPRINGS)
def test_orders_on_the_slow_manifold(numbers: dict[str, Any], name: str) -> None:
    orders = case_of(numbers, name)["orders"]
    # With 1e5 N m/rad the phase of the fastest spring advances by about 1 rad in the finest steps, and the third
    # order is not reached exactly.
    loose = 0.25 if name == "springs 1e5" else ORDER
    for method, wanted in zip(IMPLICIT, (1, 2, 3), strict=True):
        assert abs(orders[method] - wanted) <= (ORDER if wanted < 3 else loose), (method, orders[method])


def at_a_millisecond(numbers: dict[str, Any], name: str, method: str) -> dict[str, Any]:
    found = [run for run in case_of(numbers, name)["runs"] if run["method"] == method and math.isclose(run["dt"], 1e-3)]
    (run,) = found
    return dict(run)


def test_springs_of_a_billion_are_lost_by_explicit_methods_and_kept_by_implicit_ones(numbers: dict[str, Any]) -> None:
    for method in EXPLICIT:
        run = at_a_millisecond(numbers, "springs 1e9", method)
        assert run["error"] is None and "hinge" in run["failure"]
    for method, bound in zip(IMPLICIT, (2e-3, 1e-7, 1e-9), strict=True):
        run = at_a_millisecond(numbers, "springs 1e9", method)
        assert run["failure"] is None and run["known"] and run["error"] <= bound, (method, run)


def test_implicit_methods_never_fail_on_stiff_scenes(study: Study) -> None:
    for result in study.stiff:
        for method in IMPLICIT:
            assert all(point.failure is None for point in result.points[method]), (result.case.name, method)


def test_ringing_is_damped_and_orders_reduce(study: Study) -> None:
    stiffest = max(row.stiffness for row in study.springs if row.ringing)
    for method in ("rosenbrock-2", "rosenbrock-3"):
        (row,) = [r for r in study.springs if r.ringing and r.stiffness == stiffest and r.method == method]
        assert row.turned > 5.0 and row.order is not None
        assert abs(row.order) <= 0.1, row
        quiet = [r for r in study.springs if not r.ringing and r.method == method and r.turned >= 20.0]
        for other in quiet:
            assert other.order is not None and abs(other.order - runs_order(method)) <= ORDER, other
    stiff = [r for r in study.springs if not r.ringing and r.method == "rosenbrock-3" and r.turned > 50.0]
    for row in stiff:
        assert row.rate_order is not None and row.rate_order <= 1.0, row


def runs_order(method: str) -> int:
    return next(row.order for row in runs.METHODS if row.name == method)


def test_references_are_far_below_every_error_shown(numbers: dict[str, Any]) -> None:
    assert numbers["errors_shown_above_reference_times"] == reference.FAR == 30.0
    for case in numbers["cases"]:
        own = case["reference"]["error"]
        assert 0.0 < own <= 1e-12
        shown = [run["error"] for run in (*case["runs"], *case["adaptive"]) if run["known"]]
        assert shown and min(shown) >= 30.0 * own
        assert case["reference"]["smallest_error_shown"] == min(shown)


#: Angles of the rods from the vertical and their velocities at 1 s: mpmath's odefun with 22 digits on Lagrange's
#: equations of `lagrange`, tolerance 1e-18.
AT_ONE_SECOND = (-2.402152250168684721688544, -0.3712350460598062891676202)


def test_the_double_pendulum_is_that_of_lagrange() -> None:
    """Different equations, arithmetic and integrator; the full second takes half a minute, so the result is stored
    here.
    """
    mpmath = pytest.importorskip("mpmath")
    case = cases.double_pendulum()
    exact = reference.reference(case)
    first, second = AT_ONE_SECOND
    assert_near(exact.q, [first, second - first], 10.0 * exact.error)
    short = dataclasses.replace(case, time=0.125)
    exact = reference.reference(short)
    with mpmath.workdps(20):
        first, second = (float(x) for x in mpmath.odefun(lagrange, 0, [2, 3, 0, 0], tol=mpmath.mpf(10) ** -16)(0.125)[:2])
    assert_near(exact.q, [first, second - first], 10.0 * exact.error)


def lagrange(_: Any, y: Any) -> list[Any]:
    """Two rods of 1 kg and 0.5 m, angles from the vertical: M (u', w') = r."""
    import mpmath

    a, b, u, w = y
    length, gravity = mpmath.mpf("0.5"), mpmath.mpf("9.81")
    about_center = length**2 / 12 * (1 + mpmath.mpf(1) / 400)
    one, two = about_center + 1.25 * length**2, about_center + 0.25 * length**2
    mixed, turn = 0.5 * length**2 * mpmath.cos(a - b), 0.5 * length**2 * mpmath.sin(a - b)
    r = -turn * w**2 - 1.5 * length * gravity * mpmath.sin(a)
    s = turn * u**2 - 0.5 * length * gravity * mpmath.sin(b)
    det = one * two - mixed**2
    return [u, w, (two * r - mixed * s) / det, (one * s - mixed * r) / det]


@pytest.mark.parametrize("stiffness", cases.SPRINGS)
def test_the_start_is_on_the_slow_manifold(stiffness: float) -> None:
    """The springs keep the joints on the slow manifold: the remaining accelerations are not larger than those of the
    slow motion.
    """
    case = cases.springs(stiffness)
    scene, fast = case.scene, case.scene.stiffness > 0.0
    accelerations = scene.forward_dynamics(case.q, case.qd, -scene.stiffness * case.q)
    slow_rate = float(np.max(np.abs(accelerations[~fast])))
    assert np.all(np.abs(accelerations[fast]) <= 10.0 * slow_rate * np.max(np.abs(case.q[fast])) + solve(1e4, slow_rate))
    assert slow.APART * slow_rate <= 0.1


def test_the_horizon(numbers: dict[str, Any]) -> None:
    seen = numbers["horizon"]
    growth, difference = np.array(seen["growth"]), np.array(seen["difference_of_references"])
    assert growth[-1] >= 1e8
    at = np.array(seen["t"]) <= seen["seconds"]
    assert np.all(difference[at] <= seen["agreement"]) and np.any(difference[~at] > seen["agreement"])
    assert case_of(numbers, "double pendulum")["seconds"] < seen["seconds"]


def test_drifts_fall_with_the_order(study: Study) -> None:
    for method, wanted in (*zip(EXPLICIT, (1, 4), strict=True), *zip(IMPLICIT, (1, 2, 3), strict=True)):
        for kind in ("energy", "angular", "linear"):
            slope = study.of("floating tree").drift_order(method, kind)
            assert slope is not None and abs(slope - wanted) <= 1.5 * ORDER, (method, kind, slope)
    assert all(point.drift.angular is None for points in study.of("arm").points.values() for point in points)


def test_peers_end_where_phipsi_does(study: Study) -> None:
    """Other programs with the same integrators: the difference of runs is of the magnitude of rounding, not of the
    errors of the methods.
    """
    if not study.peers:
        pytest.skip("no peer is installed")
    case = cases.floating_tree()
    pairs = {"rk4": ("MuJoCo RK4", "Pinocchio rk4")}
    for method, names in pairs.items():
        ours = runs.runner(case, method)(case.time / 100, 100)
        for peer in study.peers:
            if peer.name in names:
                theirs = peer.runner(case)(case.time / 100, 100)
                apart = runs.distance(case, ours.q[-1], theirs.q[-1])
                # MuJoCo expresses the velocity of the free body in another frame: same order, other constants.
                assert apart <= 1e-7, (peer.name, apart)


def test_json_has_what_the_page_shows(numbers: dict[str, Any], study: Study) -> None:
    assert numbers["format"] == 1 and numbers["quick"] is True
    assert tuple(case["name"] for case in numbers["cases"][:8]) == SMOOTH + SPRINGS
    for case in numbers["cases"]:
        assert {run["method"] for run in case["runs"]} >= {*EXPLICIT, *IMPLICIT}
        for run in case["runs"]:
            assert (run["error"] is None) == (run["failure"] is not None)
    assert {row["method"] for row in numbers["springs"]} == {*EXPLICIT, *IMPLICIT}
    assert len(study.results) == len(numbers["cases"])


def test_the_pages_are_written(study: Study, drawn: list[Plot], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(pipeline, "draw", lambda *_: drawn)
    index, markdown = motion.write(study, tmp_path / "report", tmp_path / "docs" / "motion-report.md")
    text = index.read_text(encoding="utf-8")
    places = [text.index(f"<h2>{section.title}</h2>") for section in MOTION.sections]
    assert places == sorted(places) and MOTION.sections[0].key == "losses"
    assert text.count('<div class="plot"') == 9
    assert json.loads((tmp_path / "report" / "report.json").read_text(encoding="utf-8"))["format"] == 1
    written = markdown.read_text(encoding="utf-8")
    for picture in (tmp_path / "docs").glob("*.png"):
        assert f"({picture.name})" in written and picture.read_bytes().startswith(b"\x89PNG")
    assert written.count("![") == 9


def test_the_report_is_made_without_peers(monkeypatch: pytest.MonkeyPatch, study: Study, tmp_path: Path) -> None:
    def absent(name: str) -> None:
        raise ModuleNotFoundError(name)

    with monkeypatch.context() as patch:
        patch.setattr(importlib, "import_module", absent)
        found, versions, lines = peers.installed()
    assert found == [] and versions == []
    assert sorted(line.split(" is not installed")[0] for line in lines) == ["MuJoCo", "Pinocchio"]
    names = {method.name for method in runs.METHODS}
    results = [
        dataclasses.replace(result, points={name: points for name, points in result.points.items() if name in names},
                            alone={name: ns for name, ns in result.alone.items() if name in names})
        for result in study.results
    ]  # fmt: skip
    bare = dataclasses.replace(study, peers=[], versions=[], absent=lines, parts=study.parts | {"cases": results})
    text = motion.write(bare, tmp_path)[0].read_text(encoding="utf-8")
    assert "pip install mujoco" in text and "mj_step" not in text and "MuJoCo RK4" not in text
    assert to_json(bare)["not_compared"] == lines


@pytest.mark.parametrize(
    ("steps", "errors", "expected"),
    [
        ([0.4, 0.2, 0.1, 0.05], [0.5, 4e-2, 1e-2, 2.5e-3], 2.0),
        ([0.1, 0.05, 0.025], [1e-4, math.nan, 1e-6], None),
        ([0.1, 0.05], [1e-2, 1e-3], None),
    ],
)
def test_slopes(steps: list[float], errors: list[float], expected: float | None) -> None:
    found = order.fitted(steps, errors)
    if expected is None:
        assert found is None
    else:
        assert_near(found, expected, inverse(10.0, expected))


@pytest.mark.parametrize("arguments", [[], ["-o", "out"], ["robot.urdf", "-o", "out"], ["--stability", "-o", "out"]])
def test_the_wheel_says_where_the_study_is(arguments: list[str]) -> None:
    result = CliRunner().invoke(commands.group, ["report", "--motion", *arguments])
    assert result.exit_code == 2
    assert result.output.startswith("Error: ") and "make motion" in result.output


@pytest.mark.parametrize("arguments", [["motion"], ["nothing", "-o", "out"], ["stability", "--seed", "x", "-o", "out"]])
def test_the_command_says_what_is_missing(arguments: list[str]) -> None:
    done = subprocess.run([sys.executable, str(BENCHES / "study.py"), *arguments], capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 2 and "usage:" in done.stderr and "Traceback" not in done.stderr


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, study: Study, drawn: list[Plot]) -> None:
    import study as script

    monkeypatch.setattr(pipeline, "draw", lambda *_: drawn)
    monkeypatch.setattr(motion, "collect", lambda *_, **__: study)
    monkeypatch.setattr(sys, "argv", ["study.py", "motion", "--quick", "-o", str(tmp_path / "out"), "--markdown", str(tmp_path / "m.md")])
    script.main()
    assert (tmp_path / "out" / "index.html").exists() and (tmp_path / "m.md").exists()
