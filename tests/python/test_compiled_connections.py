"""Compiled scenes with connections and with mimic joints: compared with the methods of the scene and with dense
equations; states that the scene computes; refused arguments.
"""

from __future__ import annotations

import os
import pickle
import shutil
import subprocess
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_codegen import FUNCTIONS, Recorder, assert_same
from test_constraints import bars, linkage, tangle
from test_linkages import LINKAGES
from test_mimic import Case
from tolerances import assert_near, assert_same_bits, inverse, size

import phipsi
from phipsi.errors import ArgumentError, ConstraintError, LinkageWarning, ShapeError

COMPILER = os.environ.get("CC", "cc")
pytestmark = pytest.mark.usefixtures("c_compiler")


def rods() -> phipsi.Scene:
    """A chain with a rod and a gear."""
    builder = phipsi.scenes.chain(5).to_builder()
    builder.connect("rod", "distance", "link2", xyz=(0.1, 0, 0.2), other_xyz=(0.5, 0.4, 0.1))
    return builder.couple("gear", "j4", "j3", multiplier=-2.0).build()


def cams() -> phipsi.Scene:
    """A chain whose joints follow polynomials of others: a joint of a joint, inward and outward."""
    builder = phipsi.scenes.chain(5).to_builder()
    builder.couple("inward", "j1", "j3", polynomial=(0.1, 0.5, -0.8, 0.4, 0.3))
    return builder.couple("outward", "j4", "j1", polynomial=(0.0, 1.0, 2.0)).build()


#: Scenes whose rows are independent but for rows that move no joint.
SCENES: dict[str, Callable[[], phipsi.Scene]] = {
    "four-bar": linkage,
    "four-bar on a point": lambda: linkage("point"),
    "rod and gear": rods,
    "cams": cams,
    "tree": lambda: tangle(0, ("revolute", "prismatic"), 14),
    "floating tree": lambda: tangle(1, ("revolute", "prismatic"), 14, floating_base=True),
    "all joints": lambda: tangle(3, ("revolute", "prismatic", "spherical", "screw", "floating"), 9),
}
BOTH = ["forward_dynamics", "constrained_dynamics"]


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("compiled")


@pytest.fixture(autouse=True)
def _small_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("phipsi._compile.FEW", dict.fromkeys(phipsi._compile.FEW, 16))


def closed(scene: phipsi.Scene, count: int = 20, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States that satisfy the connections: moving with torques, passive and moving, passive at rest, at rest with
    torques; the last is neutral.
    """
    random = np.random.default_rng(seed)
    rest = np.array([0.5, 0.8, 0.2]) if scene.joint_names[:1] == ("crank",) else scene.neutral()
    q = scene.integrate(rest, random.uniform(-0.05, 0.05, (count, scene.nv)))
    found = scene.loops.project(q, random.uniform(-1, 1, (count, scene.nv)))
    q, qd, tau = found.q, found.qd, random.uniform(-5, 5, (count, scene.nv))
    assert qd is not None
    qd[count // 2 :] = 0.0
    tau[count // 4 : 3 * count // 4] = 0.0
    return q, qd, tau


def conditioning(scene: phipsi.Scene, q: np.ndarray) -> float:
    """That of M and of the rows that move joints."""
    found = []
    for one in q:
        mass, rows = scene.mass_matrix(one), scene.loops.jacobian(one)
        gram = rows @ np.linalg.solve(mass, rows.T)
        values = np.linalg.eigvalsh(gram)
        found.append(np.linalg.cond(mass) * values[-1] / np.min(values[values > 1e-12 * values[-1]]))
    return float(np.max(found))


@pytest.mark.parametrize("form", ["auto", "covariance"])
@pytest.mark.parametrize("name", SCENES)
def test_results_are_those_of_the_scene(name: str, form: Any, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The machine code computes all states."""
    scene = SCENES[name]()
    fast = phipsi.compile(scene, BOTH, form=form, flags=["-O0"], cache=cache)  # type: ignore[call-overload]
    given = closed(scene)
    expected = scene.loops.dynamics(*given, form=form)
    asked: list[tuple[str, int]] = []
    monkeypatch.setattr(fast, "scene", Recorder(scene, asked))
    qdd, found = fast.forward_dynamics(*given), fast.constrained_dynamics(*given)
    assert asked == []
    cond = conditioning(scene, given[0])
    assert type(found) is type(expected) and list(found.forces) == list(expected.forces)
    for one in (qdd, found.qdd):
        assert_near(one, expected.qdd, inverse(cond, size(expected.qdd)))
    for name_of_force, force in expected.forces.items():
        assert_near(found.forces[name_of_force], force, inverse(cond, size(*expected.forces.values())))
    np.testing.assert_array_equal(found.rank, expected.rank)
    assert found.rank.dtype == np.int64 and found.residual.shape == expected.residual.shape  # type: ignore[union-attr]
    assert np.all(found.residual <= inverse(cond, size(expected.qdd)))


@pytest.mark.parametrize("name", SCENES)
def test_results_satisfy_their_equations(name: str, cache: Path) -> None:
    """M qdd + bias = tau + J^T f and J qdd + J' qd = -compliance f, dense."""
    scene = SCENES[name]()
    fast = phipsi.compile(scene, BOTH, flags=["-O0"], cache=cache)
    q, qd, tau = closed(scene, seed=1)
    rows = scene.loops.jacobian(q)
    compliance = np.random.default_rng(0).uniform(0.01, 0.1, rows.shape[:-1])
    for soft in (np.zeros_like(compliance), compliance):
        found = fast.constrained_dynamics(q, qd, tau, compliance=soft)
        forces = np.concatenate([*found.forces.values()], axis=-1)
        load = np.einsum("sij,si->sj", rows, forces)
        bound = inverse(conditioning(scene, q), size(found.qdd, load))
        assert_near(scene.inverse_dynamics(q, qd, found.qdd), tau + load, bound)
        assert_near(np.einsum("sij,sj->si", rows, found.qdd) + scene.loops.bias(q, qd), -soft * forces, bound)
        expected = scene.loops.dynamics(q, qd, tau, compliance=soft)
        assert_near(found.qdd, expected.qdd, bound)


def parallelogram() -> phipsi.Scene:
    builder = phipsi.SceneBuilder().link("ground")
    for name, parent, xyz in (("crank", "ground", (0, 0, 0)), ("bar", "crank", (0, 0, 0.2)), ("rocker", "ground", (0.3, 0, 0))):
        builder.link(name, mass=1.0, com=(0, 0, 0.1), inertia=np.diag([4e-3, 4e-3, 1e-3]))
        builder.joint(name, "continuous", parent, name, xyz=xyz, axis=(0, 1, 0))
    tilted = np.array([[np.cos(0.7), 0, np.sin(0.7)], [0, 1, 0], [-np.sin(0.7), 0, np.cos(0.7)]])
    return builder.connect("pin", "point", "bar", "rocker", xyz=(0.3, 0, 0), other_xyz=(0, 0, 0.2), rotation=tilted).build()


def test_singular_configurations_are_computed_by_the_scene(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A parallelogram that is stretched has one independent row less."""
    scene = parallelogram()
    fast = phipsi.compile(scene, BOTH, flags=["-O0"], cache=cache)
    angle = np.linspace(0.1, 1.2, 20)
    angle[[3, 11]] = np.pi / 2
    q, still, tau = np.stack([angle, -angle, angle], axis=-1), np.zeros((20, 3)), np.random.default_rng(0).uniform(-1, 1, (20, 3))
    expected = scene.loops.dynamics(q, still, tau)
    assert np.all(expected.rank[[3, 11]] < expected.rank[0])  # type: ignore[index]
    asked: list[tuple[str, int]] = []
    monkeypatch.setattr(fast, "scene", Recorder(scene, asked))
    found = fast.constrained_dynamics(q, still, tau)
    assert asked == [("dynamics", 2)]
    np.testing.assert_array_equal(found.rank, expected.rank)
    assert_near(found.qdd, expected.qdd, 1e-9 * size(expected.qdd))
    assert_same_bits(found.qdd[[3, 11]], expected.qdd[[3, 11]])
    assert_near(found.forces["pin"], expected.forces["pin"], 1e-9 * size(expected.forces["pin"]))


@pytest.mark.parametrize("name", ["three cranks", "delta"])
def test_dependent_rows_are_computed_by_the_scene(name: str, cache: Path) -> None:
    """In all configurations."""
    builder, start, _ = LINKAGES[name](0.0)
    scene = builder.build()
    # The scene warns of the delta robot too.
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        fast = phipsi.compile(scene, BOTH, flags=["-O0"], cache=cache)
        found = scene.loops.project(np.tile(start, (17, 1)), np.random.default_rng(0).uniform(-1, 1, (17, scene.nv)))
    assert any(issubclass(one.category, LinkageWarning) and "functions: found connections of rank" in str(one.message) for one in caught)
    tau = np.random.default_rng(1).uniform(-1, 1, (17, scene.nv))
    expected = scene.loops.dynamics(found.q, found.qd, tau)
    compiled = fast.constrained_dynamics(found.q, found.qd, tau)
    np.testing.assert_array_equal(compiled.rank, expected.rank)
    assert_near(compiled.qdd, expected.qdd, 1e-9 * size(expected.qdd))
    for key, force in expected.forces.items():
        assert_near(compiled.forces[key], force, 1e-8 * size(*expected.forces.values()))


@pytest.mark.parametrize("form", ["auto", "covariance"])
@pytest.mark.parametrize("which", ["q", "qd"])
@pytest.mark.parametrize("make", [linkage, rods, cams])
def test_states_that_violate_the_connections_are_refused_as_by_the_scene(which: str, make: Any, form: Any, cache: Path) -> None:
    scene = make()
    fast = phipsi.compile(scene, BOTH, form=form, flags=["-O0"], cache=cache)  # type: ignore[call-overload]
    q, qd, tau = closed(scene)
    (q if which == "q" else qd)[13, 1] += 0.1
    with pytest.raises(ConstraintError) as expected:
        scene.forward_dynamics(q, qd, tau, form=form)
    for function in BOTH:
        with pytest.raises(ConstraintError) as told:
            getattr(fast, function)(q, qd, tau)
        assert str(told.value) == str(expected.value) and told.value.state == expected.value.state == 13


def test_functions_of_the_tree_are_compiled_too(cache: Path) -> None:
    """All functions with code for a scene with connections are compiled by default, and those of the tree are the same."""
    scene = linkage("point")
    fast = phipsi.compile(scene, flags=["-O0"], cache=cache)
    without = {"forward_dynamics_derivatives", "forward_dynamics_jvp", "forward_dynamics_vjp"}
    assert set(fast.functions) == {"constrained_dynamics", *FUNCTIONS} - without
    q, qd, u = closed(scene)
    given = {"q": q, "qd": qd, "u": u, "dq": u, "dqd": qd, "du": u}
    for function in set(FUNCTIONS) - without:
        arguments = [given[key] for key in FUNCTIONS[function]]
        assert_same(getattr(fast, function)(*arguments), getattr(scene, function)(*arguments), conditioning(scene, q))
    again = pickle.loads(pickle.dumps(fast))
    assert_same_bits(again.forward_dynamics(q, qd, u), fast.forward_dynamics(q, qd, u))


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"compliance": np.full(5, -1.0)}, ArgumentError, "compliance"),
        ({"compliance": np.full(4, 0.1)}, ShapeError, "compliance"),
        ({"compliance": np.full(5, np.nan)}, phipsi.errors.NotFiniteError, "compliance"),
        ({"qd": np.zeros((20, 4))}, ShapeError, "qd"),
        ({"wrenches": {"none": np.zeros(6)}}, ArgumentError, "none"),
        ({"errors": "no"}, ArgumentError, "errors"),
    ],
)
def test_broken_arguments_are_refused_as_by_the_scene(change: dict[str, Any], error: type[Exception], message: str, cache: Path) -> None:
    scene = linkage()
    fast = phipsi.compile(scene, BOTH, flags=["-O0"], cache=cache)
    q, qd, tau = closed(scene)
    assert np.isfinite(fast.constrained_dynamics(q, qd, tau).qdd).all()
    given = {"q": q, "qd": qd, "tau": tau, **change}
    with pytest.raises(error, match=message) as expected:
        scene.loops.dynamics(**given)
    with pytest.raises(error) as told:
        fast.constrained_dynamics(**given)
    assert str(told.value) == str(expected.value)


@pytest.mark.parametrize(
    ("functions", "options", "message"),
    [
        (["forward_dynamics_derivatives"], {}, 'functions: found forward_dynamics_derivatives for connections \\("pin"\\)'),
        (["forward_dynamics"], {"dtype": "float32"}, "dtype: found 'float32' for forward_dynamics with connections \\(pin\\)"),
        (["constrained_dynamics"], {"device": "cuda"}, "functions: found constrained_dynamics with connections \\(pin\\)"),
    ],
)
def test_what_has_no_code_is_refused(functions: list[Any], options: dict[str, Any], message: str, cache: Path) -> None:
    with pytest.raises(ArgumentError, match=message):
        phipsi.compile(linkage(), functions, **options)


def test_constrained_dynamics_of_trees_has_no_code(cache: Path) -> None:
    tree = bars().build()
    with pytest.raises(ArgumentError, match="constrained_dynamics for a scene without connections; expected forward_dynamics"):
        phipsi.compile(tree, ["constrained_dynamics"], cache=cache)
    fast = phipsi.compile(tree, ["mass_matrix"], flags=["-O0"], cache=cache)
    with pytest.raises(ArgumentError, match="functions: found constrained_dynamics, which was not compiled"):
        fast.constrained_dynamics(np.zeros(3), np.zeros(3), np.zeros(3))


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("name", ["four-bar", "rod and gear", "floating tree"])
def test_the_c_code_passes_its_test(name: str, dtype: Any, tmp_path: Path) -> None:
    names = [*BOTH, *(f"{name}_watched" for name in BOTH)] if dtype == "float64" else BOTH
    SCENES[name]().to_c(tmp_path, functions=names, dtype=dtype, batches=True)  # type: ignore[arg-type]
    made = subprocess.run(["make", "-s", "test", f"CC={COMPILER}", "CFLAGS=-std=c99 -O0"], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert made.returncode == 0, made.stdout + made.stderr


def geared(seed: int = 1) -> phipsi.Scene:
    """A tree with mimic joints."""
    return Case(seed, 7).scene


@pytest.mark.parametrize("make", [rods, geared])
def test_the_kernels_pass_their_test_in_c(make: Callable[[], phipsi.Scene], tmp_path: Path) -> None:
    scene = make()
    names = ["forward_dynamics_watched", "constrained_dynamics" if scene.loops.names else "forward_dynamics_vjp_watched"]
    scene.to_cuda(tmp_path, functions=names)  # type: ignore[arg-type]
    made = subprocess.run(["make", "-s", "test-c", f"CC={COMPILER}", "CFLAGS=-std=c99 -O0"], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert made.returncode == 0, made.stdout + made.stderr


@pytest.mark.parametrize("make", [rods, geared])
def test_the_crate_passes_its_test(make: Callable[[], phipsi.Scene], tmp_path: Path) -> None:
    if shutil.which("rustc") is None:
        pytest.skip("no rustc here")
    scene = make()
    names = ["forward_dynamics_watched", "constrained_dynamics" if scene.loops.names else "mass_matrix_inverse"]
    scene.to_rust(tmp_path, name="held", functions=names)  # type: ignore[arg-type]
    rustc = ["rustc", "--edition", "2021", "-D", "warnings", "-L", "."]
    library = ["--crate-type", "rlib", "--crate-name", "held", "--cfg", 'feature="std"', "--check-cfg", 'cfg(feature, values("std"))', "src/lib.rs"]
    subprocess.run([*rustc, *library], cwd=tmp_path, check=True, timeout=300)
    subprocess.run([*rustc, "--test", "tests/reference.rs", "-o", "reference", "--extern", "held"], cwd=tmp_path, check=True, timeout=300)
    said = subprocess.run([str(tmp_path / "reference")], capture_output=True, text=True, timeout=300)
    assert said.returncode == 0, said.stdout + said.stderr


@pytest.mark.parametrize("seed", range(4))
def test_scenes_with_mimic_joints(seed: int, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = Case(seed, 7)
    scene = case.scene
    fast = phipsi.compile(scene, flags=["-O0"], cache=cache)
    assert fast.functions == tuple(FUNCTIONS)
    random = np.random.default_rng(seed)
    q = scene.integrate(scene.neutral(), random.uniform(-1, 1, (20, scene.nv)))
    given = {"q": q} | {key: random.uniform(-1, 1, (20, scene.nv)) for key in ("qd", "u", "dq", "dqd", "du")}
    given["qd"][5:] = given["u"][:10] = 0.0
    expected = {name: getattr(scene, name)(*(given[key] for key in reads)) for name, reads in FUNCTIONS.items()}
    asked: list[tuple[str, int]] = []
    monkeypatch.setattr(fast, "scene", Recorder(scene, asked))
    cond = float(np.max(np.linalg.cond(scene.mass_matrix(q))))
    for function, reads in FUNCTIONS.items():
        assert_same(getattr(fast, function)(*(given[key] for key in reads)), expected[function], cond)
    assert asked == []


def test_links_of_scenes_with_mimic_joints(cache: Path) -> None:
    scene = geared()
    link = scene.link_names[-1]
    fast = phipsi.compile(scene, [("placement", link), ("jacobian", link), ("jacobian", link, "world")], flags=["-O0"], cache=cache)
    q = scene.integrate(scene.neutral(), np.random.default_rng(0).uniform(-1, 1, (20, scene.nv)))
    assert_near(fast.placement(q, link), scene.placement(q, link), 1e-13 * size(scene.placement(q, link)))
    for frame in ("local", "world"):
        expected = scene.jacobian(q, link, frame=frame)  # type: ignore[arg-type]
        assert_near(fast.jacobian(q, link, frame=frame), expected, 1e-13 * size(expected))  # type: ignore[arg-type]


def test_the_c_code_of_mimic_joints_passes_its_test(tmp_path: Path) -> None:
    geared().to_c(tmp_path, batches=True)
    made = subprocess.run(["make", "-s", "test", f"CC={COMPILER}", "CFLAGS=-std=c99 -O0"], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert made.returncode == 0, made.stdout + made.stderr
