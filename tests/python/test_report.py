"""The report: its values, its page, and scenes for which parts are missing. No test asserts a time."""

from __future__ import annotations

import io
import json
import math
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import phipsi
import pytest
from click.testing import CliRunner
from phipsi import _core
from phipsi._core import BUNDLED_ARM, METHODS, ROUTES
from phipsi.report import auto_cost, commands, draw, interactive, kinds, pipeline, plotting, robot, sections, states, terminal, text
from phipsi.report.progress import Silent
from phipsi.report.sections import calls, emergence, residuals
from phipsi.report.structure import tree_of
from rich.console import Console
from tolerances import SIGMAS, assert_near, product

sys.path.insert(0, str(Path(__file__).parents[2] / "benches"))
import auto_states

#: Order of the page: properties of the robot, then the computation.
PARTS = (
    "view", "scene", "joints", "mass", "calls", "kinds",
    "plan", "accuracy", "residuals", "condition", "emergence", "growth", "limits", "provenance",
)  # fmt: skip
PLOTS = ("skeleton", "mass-matrix", "error-against-time", "error-against-condition", "emergence", "emergence-slopes", "growth")
INERTIA = np.diag([0.1, 0.1, 0.05])


def arm() -> phipsi.Scene:
    return phipsi.Scene.from_urdf(BUNDLED_ARM)


def mixed() -> phipsi.Scene:
    """Branches, and every kind of joint."""
    builder = phipsi.SceneBuilder().link("base")
    kinds = ("spherical", "prismatic", "planar", "revolute", "fixed", "screw", "floating", "continuous")
    for k, kind in enumerate(kinds):
        parent = "base" if k == 0 else f"l{(k + 1) // 2}"
        builder = builder.link(f"l{k + 1}", mass=1.0 + k, com=(0.1, 0.0, 0.2), inertia=INERTIA)
        pitch = {"pitch": 0.1} if kind == "screw" else {}
        builder = builder.joint(f"j{k + 1}", kind, parent, f"l{k + 1}", xyz=(0.0, 0.1, 0.3), **pitch)
    return builder.build()


def written(scene: phipsi.Scene, folder: Path, **options: Any) -> tuple[dict[str, Any], str]:
    found = pipeline.collect(sections.ROBOT, robot.Report(True, "<robot> & co", "here", scene, **options), Silent())
    (page,) = pipeline.write(sections.ROBOT, found, folder)
    return json.loads((folder / "report.json").read_text()), page.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def bundled(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], str, Path]:
    folder = tmp_path_factory.mktemp("report")
    result = CliRunner().invoke(commands.group, ["report", "--quick", "-o", str(folder)])
    assert result.exit_code == 0, result.output
    return json.loads((folder / "report.json").read_text()), (folder / "index.html").read_text(encoding="utf-8"), folder


def numbers(tree: Any) -> Iterator[float]:
    if isinstance(tree, dict):
        tree = list(tree.values())
    if isinstance(tree, list):
        for item in tree:
            yield from numbers(item)
    elif isinstance(tree, float):
        yield tree


def test_numbers_of_the_bundled_arm(bundled: tuple[dict[str, Any], str, Path]) -> None:
    found = bundled[0]
    assert found["passed"] is True
    assert found["missing"] == {}
    assert found["scene"]["nv"] == 6
    assert len(found["scene"]["joints"]) == 7
    assert all(math.isfinite(number) for number in numbers(found))
    assert found["states"] == {"count": 64, "for_residuals": 32, "seed": 0, "quick": True}
    assert found["machine"]["phipsi"] == phipsi.__version__
    assert {"cpu", "cores", "os", "python", "commit", "compiler"} <= found["machine"].keys()
    assert found["plan"]["bodies"] == 6
    assert found["condition"]["min"] <= found["condition"]["median"] <= found["condition"]["max"]
    assert found["growth"]["rows"][-1]["bodies"] == 10_000
    operators = found["growth"]["operators"]
    assert operators["bodies"][-1] == 10_000
    assert {"phi", "phi*", "Psi_A", "Lambda", "S*", "G", "M_inv"} <= {row["name"] for row in operators["rows"]}
    assert all(len(row["ns_per_body"]) == 4 and min(row["ns_per_body"]) > 0.0 for row in operators["rows"])


def test_residuals_are_below_their_bounds(bundled: tuple[dict[str, Any], str, Path]) -> None:
    rows = bundled[0]["residuals"]
    assert len(rows) >= 15
    for row in rows:
        assert 0.0 <= row["median"] <= row["worst"]
        assert row["worst_in_bounds"] <= 1.0, row["name"]
        assert row["passed"] is True
    for word in ("faer's LDLT", "M M^-1 = 1", "inverse dynamics of forward dynamics", "K = L + K L", "energy"):
        assert any(word in row["name"] for row in rows), word


def test_errors_of_every_method(bundled: tuple[dict[str, Any], str, Path]) -> None:
    rows = bundled[0]["accuracy"]
    assert [row["method"] for row in rows] == list(METHODS)
    for row in rows:
        assert row["failed_states"] == 0
        assert len(row["errors"]) == 64
        assert 0.0 < row["error_median"] <= row["error_max"] <= 64 * bundled[0]["condition"]["max"] * robot.EPS
        assert row["ns_per_state"] > 0.0
        assert row["digits_lost"] == pytest.approx(math.log10(row["error_median"] / robot.EPS))


def rows_with_times(tree: Any) -> Iterator[dict[str, Any]]:
    """Every dictionary with a time, completed with the values of the enclosing levels."""
    if isinstance(tree, list):
        for item in tree:
            yield from rows_with_times(item)
    elif isinstance(tree, dict):
        if any(key.startswith("ns_") and value is not None for key, value in tree.items()):
            yield tree
        for value in tree.values():
            yield from rows_with_times(value)


def test_every_time_says_what_it_is_of(bundled: tuple[dict[str, Any], str, Path]) -> None:
    found = json.loads(json.dumps(bundled[0]))
    operators = found["growth"].pop("operators")
    rows = [*rows_with_times(found), operators, *(found["growth"][key] for key in ("forward", "covariance", "inverse"))]
    assert len(rows) > 14 + 14 + 32
    for row in rows:
        assert row["from"] in ("Rust", "Python"), row
        assert row["call"] and row["states"] and row["batch"] >= 1, row
        assert row["form"] in (None, "auto", "covariance", "square-root"), row
        # The general recursions are not public calls.
        assert row["from"] == "Python" or any(name in row["call"] for name in PUBLIC), row


PUBLIC = ("Scene::evaluate(", "Scene::random_model", "Composite::new", "Operator::apply")


def test_auto_comes_first(bundled: tuple[dict[str, Any], str, Path]) -> None:
    found, page, _ = bundled
    assert METHODS[0] == "auto"
    for part in ("accuracy", "calls", "kinds"):
        assert found[part][0]["form"] == "auto"
        assert "dynamics" in found[part][0]["call"].lower()
    assert {row["form"] for row in found["accuracy"]} >= {"auto", "covariance", "square-root", None}
    lead = page[page.index('<p class="lead">') : page.index('<div class="key">')]
    one, many = (
        next(row for row in found["calls"] if (row["form"], row["batch"] > 1) == ("auto", batch)) for batch in (False, True)
    )
    assert "called from Python" in lead and "form auto" in lead
    assert text.time(one["ns_per_state"]) in lead and text.time(many["ns_per_state"]) in lead


def test_one_state_and_a_batch_of_every_call(bundled: tuple[dict[str, Any], str, Path]) -> None:
    found = bundled[0]["calls"]
    for batch in (1, 256):
        rows = [row for row in found if row["batch"] == batch]
        forward = [row["form"] for row in rows if "forward_dynamics" in row["call"]]
        assert forward == ["auto", "covariance", "square-root"]
        for name in ("inverse_dynamics", "bias_torque", "mass_matrix(", "mass_matrix_inverse"):
            assert any(name in row["call"] for row in rows)
        assert all(row["from"] == "Python" and row["ns_per_state"] > 0.0 for row in rows)


def test_the_states_that_robots_are_in_are_measured(bundled: tuple[dict[str, Any], str, Path]) -> None:
    found, page, _ = bundled
    rows = found["kinds"]
    for kind in kinds.KINDS:
        for batch in (1, 256):
            chosen = [row for row in rows if (row["states"], row["batch"]) == (kind, batch)]
            assert [row["form"] for row in chosen] == ["auto", "covariance"]
            assert all(row["ns_per_state"] > 0.0 and row["ns_over_covariance"] > 0.0 for row in chosen)
            # Compared with the accelerations of the bias alone, both forms are accurate.
            assert all(0.0 <= row["error_median"] <= row["error_max"] < 1e-12 for row in chosen), chosen
        assert f"<td>{kind}<br>" in page
    assert {kinds.REST, kinds.HELD, kinds.FALLING, kinds.MOVING} <= {row["states"] for row in rows}


class Counting:
    """A scene that counts the calls of its methods, by name and form."""

    def __init__(self, scene: phipsi.Scene) -> None:
        self.scene = scene
        self.seen: dict[tuple[str, str | None], list[int]] = {}

    def __getattr__(self, name: str) -> Any:
        found = getattr(self.scene, name)
        if not callable(found):
            return found

        def call(*arguments: Any, **options: Any) -> Any:
            states = np.shape(arguments[0])[0] if arguments and np.ndim(arguments[0]) > 1 else 1
            self.seen.setdefault((name, options.get("form")), []).append(states)
            return found(*arguments, **options)

        return call


def test_times_from_python_are_of_public_calls() -> None:
    scene = Counting(arm())
    drawn = kinds.draw(arm(), 8, 0)
    found = calls.measured(scene, drawn, True, Silent())  # type: ignore[arg-type]
    assert {(row.of.call.split("(")[0].removeprefix("scene."), row.of.form) for row in found} == set(scene.seen)
    for sizes in scene.seen.values():
        # Warm-up, then timing: one state per call, and all of them.
        assert sizes.count(1) >= 8 * 2 and sizes.count(8) >= 2


def test_the_costs_of_auto_are_of_public_calls_at_every_kind_of_state() -> None:
    scene = Counting(arm())
    found = auto_cost.measured(scene, kinds.draw(arm(), 8, 0), quick=True)  # type: ignore[arg-type]
    assert [(row.kind, row.batch) for row in found] == [(kind, batch) for kind in kinds.KINDS for batch in (1, 8)]
    timed = {key: sizes for key, sizes in scene.seen.items() if key[0] == "forward_dynamics"}
    assert set(timed) == {("forward_dynamics", form) for form in ("auto", "covariance")}
    for sizes in timed.values():
        assert sizes.count(8) >= len(kinds.KINDS) * 4


@pytest.mark.parametrize("floating_base", [False, True])
def test_kinds_of_states_are_what_they_say(floating_base: bool) -> None:
    scene = phipsi.Scene.from_urdf(BUNDLED_ARM, floating_base=floating_base)
    drawn = kinds.draw(scene, 12, 3)
    first = 6 if floating_base else 0
    assert kinds.first_joint(scene) == first
    assert (drawn.joint >= first).all()
    for kind in kinds.KINDS:
        q, qd, tau = kinds.state(scene, drawn, kind)
        assert (q == drawn.q).all()
        if kind in (kinds.HELD, kinds.PUSHED, kinds.REST, kinds.ONE_TORQUE):
            assert not qd.any()
        if kind in (kinds.REST, kinds.FALLING, kinds.ONE_RATE, kinds.MOVING):
            assert not tau.any()
        if kind in (kinds.ONE_RATE, kinds.MOVING):
            assert (np.count_nonzero(qd, axis=1) == 1).all()
        if kind == kinds.HELD:
            assert np.abs(scene.forward_dynamics(q, qd, tau)).max() < 1e-9
    again = kinds.draw(scene, 12, 3)
    assert (again.q == drawn.q).all() and (again.joint == drawn.joint).all()


def test_the_table_of_auto_over_covariance() -> None:
    costs = {
        ("fixed base", "one"): [auto_cost.Cost(kinds.HELD, 1, 300.0, 200.0, 1.5), auto_cost.Cost(kinds.HELD, 256, 3.0, 1.0, 3.0)],
        ("free base", "one"): [auto_cost.Cost(kinds.HELD, 256, 8.0, 2.0, 4.0)],
    }
    robots, rows = auto_cost.table(costs, True)
    assert robots == ["one"]
    assert ["fixed base, held", "3.00"] in rows and ["free base, held", "4.00"] in rows
    assert ["free base, held", "–"] in auto_cost.table(costs, False)[1]
    page = auto_states.markdown(auto_cost, costs)
    assert "| fixed base, held | 3.00 |" in page
    assert "Worst: one, free base, held, a batch of 256: auto 8 ns per state, covariance 2." in page


def test_the_page_needs_nothing_beside_itself(bundled: tuple[dict[str, Any], str, Path]) -> None:
    page = bundled[1]
    places = [page.index(f'<section id="{part}">') for part in PARTS]
    assert places == sorted(places)
    assert places[0] < page.index('<p class="lead">') < page.index('<div class="key">') < places[1]
    # The robot is a separate page, which test_view.py opens in a browser; test_plots.py opens the plots.
    page, frames = re.subn(r' srcdoc="[^"]*"', "", page)
    assert frames == 1
    page, scripts = re.subn(r"<script( type=\"application/json\")?>.*?</script>", "", page, flags=re.DOTALL)
    assert scripts == len(PLOTS) + 1
    assert "`" not in page
    # Namespaces are names and are not requested.
    fetched = re.findall(r"""(?:src|href|data)\s*=\s*["']([^"'#][^"']*)""", page)
    assert not [address for address in fetched if not address.startswith("data:")]
    assert not re.search(r"<script|<link|@import|url\((?!#)", page)
    resources = re.sub(r"""xmlns(:\w+)?="[^"]*"|<metadata>.*?</metadata>|<!DOCTYPE[^>]*>""", "", page, flags=re.S)
    assert "http://" not in resources
    assert "https://" not in resources


def test_the_page_names_what_it_draws(bundled: tuple[dict[str, Any], str, Path]) -> None:
    _, page, folder = bundled
    for name in ("joint1", "joint6", "flange_mount", *map(text.symbols, METHODS)):
        assert name in page
    contents = re.findall(r'<div class="plot" id="plot-([^"]*)".*?<script type="application/json">(.*?)</script>', page, flags=re.DOTALL)
    assert [name for name, _ in contents] == list(PLOTS)
    for name, content in contents:
        figure = json.loads(content)
        assert figure["traces"] and figure["wide"]["height"] > 200 and figure["narrow"]["height"] > 200, name
    assert {file.name for file in folder.iterdir()} == {"index.html", "report.json"}


def test_limits_and_gravity_of_the_bundled_arm(bundled: tuple[dict[str, Any], str, Path]) -> None:
    rows, scene = bundled[0]["joints"], arm()
    assert [row["name"] for row in rows] == list(scene.joint_names)
    limits = scene.limits
    for at, row in enumerate(rows):
        assert (row["lower"], row["upper"], row["velocity"], row["effort"]) == tuple(
            values[at] for values in (limits.lower, limits.upper, limits.velocity, limits.effort)
        )
        assert row["share"] == row["gravity_max"] / row["effort"]
    here = [row["gravity_here"] for row in rows]
    assert_near(here, scene.gravity_torque(scene.neutral()), product(6, 40.0))
    # Joints about the vertical have no gravity torque.
    assert rows[0]["gravity_max"] < 1e-9 < rows[1]["gravity_max"]
    assert rows[1]["gravity_max"] >= 37.0


def test_inertias_of_the_bundled_arm(bundled: tuple[dict[str, Any], str, Path]) -> None:
    found, scene = bundled[0]["mass"], arm()
    assert found["poses"] == 64
    for row, armature in zip(found["inertias"], (scene.joints[name].armature for name in scene.joint_names), strict=True):
        assert armature < row["least"] <= row["most"]
    assert found["links"][0]["name"] == "link2" and len(found["links"]) == 7
    assert_near(found["center_of_mass"], scene.center_of_mass(scene.neutral()), product(6, 1.0))


def test_names_are_escaped(tmp_path: Path) -> None:
    found, page = written(arm(), tmp_path, warnings=["<b>warning</b>"], count=4)
    assert found["scene"]["name"] == "<robot> & co"
    assert "<robot>" not in page
    assert "&lt;robot&gt; &amp; co" in page
    assert "<b>warning</b>" not in page


def without_times(tree: Any) -> Any:
    if isinstance(tree, dict):
        changing = ("date", "growth", "samples_a_second")
        return {k: without_times(v) for k, v in tree.items() if k not in changing and not k.startswith("ns_")}
    return [without_times(item) for item in tree] if isinstance(tree, list) else tree


def test_the_same_seed_gives_the_same_numbers() -> None:
    first, again, other = (
        without_times(
            pipeline.to_json(sections.ROBOT, pipeline.collect(sections.ROBOT, robot.Report(True, "", "", arm(), seed, 8), Silent()))
        )
        for seed in (3, 3, 4)
    )
    assert first == again
    assert first["accuracy"] != other["accuracy"]
    assert first["emergence"]["points"][0] != other["emergence"]["points"][0]


def test_a_residual_beyond_its_bound_exits_with_1_and_is_on_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(residuals, "SLACK", 1e-9)
    result = CliRunner().invoke(commands.group, ["report", "--quick", "--states", "4", "-o", str(tmp_path)])
    assert result.exit_code == 1
    assert json.loads((tmp_path / "report.json").read_text())["passed"] is False
    assert "✗ exceeded" in (tmp_path / "index.html").read_text(encoding="utf-8")


def test_a_residual_that_is_not_a_number_fails() -> None:
    row = residuals.residual("r", np.array([0.0, math.nan]), np.ones(2), False)
    assert not row.passed


def test_a_singular_scene_has_a_page(tmp_path: Path) -> None:
    scene = (
        phipsi.SceneBuilder()
        .link("base")
        .link("arm", mass=1.0, com=(0, 0, 0.1), inertia=INERTIA)
        .link("tip")
        .joint("shoulder", "revolute", "base", "arm", axis=(0, 1, 0))
        .joint("massless", "revolute", "arm", "tip", axis=(0, 1, 0))
        .build()
    )
    found, page = written(scene, tmp_path)
    assert found["missing"].keys() == {"residuals", "calls", "accuracy"}
    assert "massless" in found["missing"]["accuracy"]
    assert found["residuals"] == found["calls"] == found["kinds"] == found["accuracy"] == []
    assert found["condition"]["rank"] == 1
    assert "1 of 2" in page
    assert found["passed"] is True
    for part in PARTS:
        assert f'<section id="{part}">' in page


def test_a_scene_where_nothing_moves_has_a_page(tmp_path: Path) -> None:
    scene = phipsi.SceneBuilder().link("base", mass=1.0, com=(0, 0, 0), inertia=INERTIA).build()
    found, page = written(scene, tmp_path)
    assert found["missing"].keys() == {"view", "joints", "mass", "residuals", "calls", "accuracy", "condition", "emergence"}
    assert found["emergence"] is None
    assert "This scene has no degree of freedom" in page


def test_a_scene_too_large_for_dense_algebra_has_a_page(tmp_path: Path) -> None:
    builder = phipsi.SceneBuilder().link("l0")
    for k in range(320):
        builder = builder.link(f"l{k + 1}", mass=1.0, com=(0, 0, 0.1), inertia=INERTIA)
        axis = (1, 0, 0) if k % 2 else (0, 0, 1)
        builder = builder.joint(f"j{k}", "revolute", f"l{k}", f"l{k + 1}", xyz=(0, 0, 0.2), axis=axis)
    found, page = written(builder.build(), tmp_path, count=4)
    # The number of cores determines if a rate can be measured in time.
    assert found["missing"].keys() - {"samples a second"} == {"view", "mass", "residuals", "condition", "sobol", "dense product"}
    assert {point["route"] for point in found["emergence"]["points"]} == {"monte-carlo", "sigma-points", "recursion"}
    assert "1920 random numbers a sample" in page
    assert {row["method"] for row in found["accuracy"]} == set(METHODS[:4])
    assert {row["form"] for row in found["calls"]} == {None, "auto", "covariance", "square-root"}
    assert "320 degrees of freedom" in page


def test_the_mass_matrix_emerges(bundled: tuple[dict[str, Any], str, Path]) -> None:
    found, page, _ = bundled
    part = found["emergence"]
    points = part["points"]
    assert tuple(dict.fromkeys(point["route"] for point in points)) == ROUTES
    for point in points:
        assert point["ns_median"] > 0.0
        assert 0.0 < point["error"] < 1.0
        if point["samples"] is None:
            assert point["error"] <= product(6 * found["scene"]["nv"], 1.0)
    sizes = [point["samples"] for point in points if point["route"] == "sobol"]
    assert sizes == [2**k for k in range(6, 15)]
    slopes = {row["route"]: row for row in part["slopes"]}
    assert -0.6 < slopes["monte-carlo"]["measured"] < -0.4
    assert -1.2 < slopes["sobol"]["measured"] < -0.8
    assert all(0.0 < row["standard_error"] < 0.1 for row in slopes.values())
    assert "slope −0." in page and "sigma points" in page


def test_the_error_of_plain_sampling_is_what_theory_expects() -> None:
    scene = arm()
    q = np.full(scene.nq, 0.3)
    m, model = scene.mass_matrix(q), scene.random_model(q)
    squares = 50 * np.array([np.sum((model.mass_matrix(50, seed=k).mass_matrix - m) ** 2) for k in range(4000)])
    squares /= np.sum(m**2)
    standard_error = squares.std() / math.sqrt(len(squares))
    assert standard_error <= 0.05
    assert abs(squares.mean() - emergence.unit_error(m) ** 2) <= SIGMAS * standard_error


def test_intervals_hold_as_often_as_they_say(bundled: tuple[dict[str, Any], str, Path]) -> None:
    coverage = bundled[0]["emergence"]["coverage"]
    assert (coverage["samples"], coverage["seeds"]) == (100, 400)
    assert [row["stated"] for row in coverage["rows"]] == [0.8, 0.95, 0.99]
    for row in coverage["rows"]:
        for entries in (row["diagonal"], row["off_diagonal"]):
            assert 0.0 < entries["standard_error"] < 0.02
            assert abs(entries["share"] - row["stated"]) <= SIGMAS * entries["standard_error"]


def test_samples_a_second_on_one_core_and_on_all(bundled: tuple[dict[str, Any], str, Path]) -> None:
    rates = bundled[0]["emergence"]["samples_a_second"]
    assert [rate["threads"] for rate in rates] == sorted({1, phipsi.get_num_threads()})
    assert all(0.0 < rate["per_second"] < math.inf for rate in rates)
    assert len({rate["samples"] for rate in rates}) == 1


def test_the_slope_of_a_straight_line() -> None:
    points = [emergence.Point("sobol", n, 1.0, 3.0 * n**-0.75) for n in (64, 256, 1024, 8192)]
    line = emergence.slope(points, -1.0)
    assert line is not None
    assert line.measured == pytest.approx(-0.75)
    assert line.standard_error == pytest.approx(0.0, abs=1e-12)
    assert line.error(100.0) == pytest.approx(3.0 * 100.0**-0.75)
    assert emergence.slope(points[:2], -1.0) is None
    assert emergence.slope([*points, emergence.Point("sobol", 2, 1.0, 0.0)], -1.0) is None


def test_an_inertia_that_no_body_has_is_not_sampled_but_reported(tmp_path: Path) -> None:
    builder = phipsi.SceneBuilder().link("base").link("odd", 1.0, com=(0.3, 0, 0), inertia=np.diag([-0.01, 0.1, 0.1]))
    with pytest.warns(phipsi.errors.InertiaWarning):
        scene = builder.joint("hinge", "revolute", "base", "odd", axis=(0, 0, 1)).build()
    found, page = written(scene, tmp_path, count=4)
    assert "odd" in found["missing"]["sampling"]
    assert {point["route"] for point in found["emergence"]["points"]} == {"recursion", "dense product"}
    assert found["emergence"]["slopes"] == found["emergence"]["samples_a_second"] == []
    assert "Samples not available: inertia of link" in page
    assert 'id="plot-emergence"' not in page
    assert all(math.isfinite(number) for number in numbers(found))


def test_samples_are_drawn_on_as_many_threads_as_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[str, int]] = []

    def drawn(scene: phipsi.Scene, q: Any, route: str, *_: int) -> tuple[float, float]:
        seen.append((route, phipsi.get_num_threads()))
        return 1e6, 1e-3

    monkeypatch.setattr(_core, "get_num_threads", lambda: 3)
    monkeypatch.setattr(_core, "emergence", drawn)
    before = phipsi.get_num_threads()
    missing: dict[str, str] = {}
    found = emergence.measured(arm(), np.zeros(6), 0, True, missing, Silent())
    assert phipsi.get_num_threads() == before and missing == {}
    assert [rate.threads for rate in found.samples_a_second] == [1, 3]
    assert seen[-2:] == [("monte-carlo", 1), ("monte-carlo", 3)]
    # All errors and times are those of one thread; the first calls only check whether a method is available.
    assert {threads for _, threads in seen[2:-2]} == {1}


def test_sampling_that_fails_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuses(*_: Any) -> None:
        raise phipsi.errors.OutOfMemoryError("no such luck")

    monkeypatch.setattr(_core, "emergence", refuses)
    found, page = written(arm(), tmp_path, count=4)
    assert "no such luck" in found["missing"]["emergence"]
    assert found["emergence"] is None
    assert "no such luck" in page


def test_every_kind_of_joint_is_drawn_and_measured(tmp_path: Path) -> None:
    found, page = written(mixed(), tmp_path, count=6)
    assert found["missing"] == {}
    assert found["passed"] is True, [row for row in found["residuals"] if not row["passed"]]
    for kind in ("spherical", "prismatic", "planar", "screw", "floating", "continuous"):
        assert kind in page


def test_states_are_within_limits() -> None:
    scene = arm()
    drawn = states.draw(scene, 50, 1)
    limits = scene.limits
    assert (drawn.q >= limits.lower - 1e-6).all()
    assert (drawn.q <= limits.upper + 1e-6).all()
    assert (np.abs(drawn.qd) <= 1.0).all()
    for values in (drawn.q, drawn.qd, drawn.tau):
        assert np.ptp(values, axis=0).all()


def test_states_are_on_the_connections() -> None:
    """Otherwise a robot with a closed loop has no times, errors and identities: forward dynamics refuses its states."""
    scene = arm().to_builder().couple("gear", "joint4", "joint5", polynomial=(0.1, 0.5, 0.2)).build()
    drawn = states.draw(scene, 8, 0)
    q, qd = (values[:, [scene.q_index(name).start for name in ("joint4", "joint5")]] for values in (drawn.q, drawn.qd))
    assert_near(q[:, 0], 0.1 + 0.5 * q[:, 1] + 0.2 * q[:, 1] ** 2, 1e-12)
    assert_near(qd[:, 0], (0.5 + 0.4 * q[:, 1]) * qd[:, 1], 1e-12)
    found = pipeline.collect(sections.ROBOT, robot.Report(True, "arm", "here", scene, count=8), Silent())
    assert not found.missing and found.passed


def test_the_tree_of_a_floating_base_starts_at_the_world() -> None:
    tree = tree_of(phipsi.Scene.from_urdf(BUNDLED_ARM, floating_base=True))
    rows = list(tree.rows())
    assert tree.root == "world"
    assert [row.joint.name for row in rows][:2] == ["root_joint", "joint1"]
    assert rows[0].joint.type == "floating"


def test_a_straight_chain_is_bent_for_the_drawing() -> None:
    builder = phipsi.SceneBuilder().link("l0")
    for k in range(4):
        builder = builder.link(f"l{k + 1}", mass=1.0, com=(0, 0, 0.1), inertia=INERTIA)
        builder = builder.joint(f"j{k}", "revolute", f"l{k}", f"l{k + 1}", xyz=(0, 0, 0.2), axis=(0, 1, 0))
    scene = builder.build()
    q, caption = draw.pose(scene, tree_of(scene))
    assert "bent" in caption
    assert np.abs(q).min() > 0.1


def test_marks_of_an_axis_are_few_and_inside() -> None:
    for low, high in ((33.0, 46.0), (3e-7, 8e-5), (1e-17, 1e2), (0.5, 0.52), (2e-7, 3e-6), (9.5, 10_500.0)):
        for axis in (plotting.Axis.powers("", low, high), plotting.Axis.times("", low, high)):
            assert axis.ticks is not None
            values, names = zip(*axis.ticks, strict=True)
            assert 2 <= len(values) <= plotting.MOST_POWERS, (low, high, names)
            assert all(low <= value <= high for value in values) and list(values) == sorted(set(values))
            assert len(set(names)) == len(names)
    for low, high in np.exp(np.random.default_rng(1).uniform([-18.0, 0.02], [-4.0, 9.0], (300, 2)).cumsum(1)):
        # A label has digits of 6 px, and an axis of a narrow page is 280 px long.
        ticks = plotting.Axis.times("", low, high).ticks or ()
        centers = 280.0 * np.log([value / low for value, _ in ticks]) / np.log(high / low)
        halves = np.array([3.0 * len(name) for _, name in ticks])
        assert len(ticks) >= 2 and np.all(np.diff(centers) > halves[1:] + halves[:-1] + 3.0), (low, high, ticks)
    # A range of a billionth has as few candidates as any other.
    assert len(plotting.log_ticks(0.5, 0.5 + 1e-9, str)) <= plotting.MOST_TICKS
    assert [name for _, name in plotting.Axis.powers("", 1e-16, 1e-14).ticks or ()] == ["10⁻¹⁶", "10⁻¹⁵", "10⁻¹⁴"]


def test_numbers_as_text() -> None:
    assert text.scientific(2.14e-16) == "2.1\u00a0×\u00a010⁻¹⁶"
    assert text.scientific(math.inf) == "∞"
    assert text.scientific(39.2) == "39"
    assert text.significant(0.0) == "0"
    assert text.significant(1234.5) == "1\u202f234" or text.significant(1234.5) == "1\u202f235"
    assert text.time(1810.0) == "1.81 µs"
    assert text.time(2.5e6) == "2.50 ms"
    assert text.brief_time(1500.0) == "1.5 µs" and text.brief_time(999.9) == "1 µs" and text.brief_time(2e-3) == "0.002 ns"
    assert text.rate(8.94e5) == "0.89 million" and text.rate(1234.0) == "1\u202f200"
    assert text.count(100_000) == "100\u202f000"
    assert text.plural(1, "body", "bodies") == "1 body"
    assert text.symbols("M^-1 (6.1) times torque") == "M⁻¹ (6.1) × torque"


def test_minus_signs_of_tables_are_typographic() -> None:
    assert text.signed("-1.5 ± 2e-05") == "−1.5 ± 2e−05" and text.signed("(-1, -.2)") == "(−1, −.2)"
    assert text.signed("joint-1 a-b 3-4") == "joint-1 a-b 3-4"


def test_a_table_that_is_too_wide_continues_in_a_second_one() -> None:
    console = Console(width=30, record=True, file=io.StringIO())
    terminal.table(console, "", ("link", "first", "second", "third"), [("link1", "1.234567", "[b]2.34567[/]", "3.456789")])
    shown = console.export_text().splitlines()
    assert [line.split() for line in shown] == [["link", "first", "second"], ["link1", "1.234567", "2.34567"], ["link", "third"], ["link1", "3.456789"]]


def test_colors_of_plots_and_pages_have_dark_ones() -> None:
    own = {*plotting.COLORS, plotting.INK, plotting.SOFT, plotting.FAINT} - {"#56b4e9", "#e69f00"}
    assert own <= set(interactive.DARK)
    style = (Path(pipeline.__file__).parent / "templates" / "style.css").read_text(encoding="utf-8")
    light, _, dark = style.partition("@media screen and (prefers-color-scheme: dark)")
    assert set(re.findall(r"(--[a-z]+):", light)) == set(re.findall(r"(--[a-z]+):", dark.partition("html {")[0]))
    assert not re.findall(r"(?:color|background): #", dark.partition("}\n}")[2].replace("--", ""))
