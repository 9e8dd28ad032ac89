"""One robot as C code: compiled by the system's compiler and called by ctypes, compared with the scene's methods;
refused arguments.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from conftest import random_scene
from oracle_mpmath import KINDS, State, derivative, exact, identity, moved, random_tree, rounded
from tolerances import assert_near, recursion, size, solve

import phipsi
from phipsi.errors import ArgumentError, LongCodeWarning, NotFiniteError, ShapeError
from phipsi.report.codegen import codegen

COMPILER = os.environ.get("CC", "cc")
FUNCTIONS = {
    "forward_dynamics": ("q", "qd", "u"),
    "inverse_dynamics": ("q", "qd", "u"),
    "bias_torque": ("q", "qd"),
    "mass_matrix": ("q",),
    "mass_matrix_inverse": ("q",),
    "forward_dynamics_derivatives": ("q", "qd", "u"),
    "inverse_dynamics_derivatives": ("q", "qd", "u"),
    "forward_dynamics_jvp": ("q", "qd", "u", "dq", "dqd", "du"),
    "forward_dynamics_vjp": ("q", "qd", "u", "dq"),
    "inverse_dynamics_jvp": ("q", "qd", "u", "dq", "dqd", "du"),
    "inverse_dynamics_vjp": ("q", "qd", "u", "dq"),
    "placements": ("q",),
}


def parts(result: object) -> list[np.ndarray]:
    """The arrays of a result, in any container."""
    if isinstance(result, dict):
        return list(result.values())
    return [part for part in result if part is not None] if isinstance(result, tuple) else [np.asanyarray(result)]


def assert_same(found: object, expected: object, cond: float) -> None:
    """Up to rounding relative to the largest of all results, because some consist of rounding errors."""
    assert type(found) is type(expected)
    bound = 1e-14 * (cond + 16) * size(*parts(expected))
    for one, other in zip(parts(found), parts(expected), strict=True):
        assert_near(one, other, bound)


@pytest.fixture(autouse=True)
def _small_batches(c_compiler: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Small batches.
    monkeypatch.setattr("phipsi._compile.FEW", dict.fromkeys(phipsi._compile.FEW, 16))


def library(scene: phipsi.Scene, into: Path) -> ctypes.CDLL:
    scene.to_c(into, name="arm")
    made = into / "arm.so"
    subprocess.run([COMPILER, "-std=c99", "-O0", "-shared", "-fPIC", "arm.c", "-lm", "-o", str(made)], cwd=into, check=True, timeout=300)
    return ctypes.CDLL(str(made))


@pytest.mark.parametrize("seed", range(3))
def test_compiled_code_gives_what_the_methods_give(seed: int, tmp_path: Path) -> None:
    scene = random_scene(seed, 7 - 3 * (seed == 1), floating_base=seed == 1)
    code, random = library(scene, tmp_path), np.random.default_rng(seed)
    for _ in range(3):
        state = {"q": scene.integrate(scene.neutral(), random.uniform(-1, 1, scene.nv))}
        state |= {name: random.uniform(-1, 1, scene.nv) for name in ("qd", "u", "dq", "dqd", "du")}
        cond = float(np.linalg.cond(scene.mass_matrix(state["q"])))
        for function, reads in FUNCTIONS.items():
            expected = parts(getattr(scene, function)(*(state[name] for name in reads)))
            if function == "placements":
                expected = [np.stack(expected)]
            found = [np.full(part.shape, np.nan) for part in expected]
            addresses = (ctypes.c_void_p(array.ctypes.data) for array in [*(state[name] for name in reads), *found])
            getattr(code, f"arm_{function}")(*addresses)
            assert_same(tuple(found), tuple(expected), cond)


def test_functions_that_are_asked_for_are_all_there_are() -> None:
    files = phipsi.scenes.chain(3).to_c(name="tail", functions=["mass_matrix"])
    assert list(files) == ["tail.c", "tail.h", "test_tail.c", "Makefile"]
    assert "tail_mass_matrix(" in files["tail.h"] and "forward_dynamics" not in files["tail.c"]
    # The result does not depend on the rotation of the first joint: no sine and no gravity is computed twice.
    assert "q[0]" not in files["tail.c"] and files["tail.c"].count("sin(q[1])") == 1
    assert "float" in phipsi.scenes.chain(3).to_c(dtype="float32")["robot.h"]


def test_the_command_writes_what_make_tests(tmp_path: Path) -> None:
    into = tmp_path / "made"
    done = CliRunner().invoke(codegen, ["-o", str(into), "--name", "bundled", "-f", "forward_dynamics", "-f", "mass_matrix"])
    assert done.exit_code == 0, done.output
    assert str(into / "bundled.c") in done.output
    made = subprocess.run(["make", "-s", "test", f"CC={COMPILER}", "CFLAGS=-std=c99 -O0"], cwd=into, check=True, capture_output=True, text=True, timeout=300)
    assert [line.split(":")[0] for line in made.stdout.splitlines()][-2:] == ["forward_dynamics", "mass_matrix"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"name": "7dof"}, "name"),
        ({"functions": ["fly"]}, "fly"),
        ({"functions": []}, "functions"),
        ({"functions": "mass_matrices"}, "functions"),
        ({"functions": ["placement"]}, "link"),
        ({"functions": [("placement", "hand")]}, "hand"),
        ({"functions": [("mass_matrix", "link0")]}, "mass_matrix"),
        ({"functions": [("jacobian", "link0", "sideways")]}, "sideways"),
        ({"dtype": "int8"}, "dtype"),
    ],
)
def test_broken_options_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        phipsi.scenes.chain(2).to_c(**options)  # type: ignore[arg-type]


def test_derivatives_through_connections_are_refused() -> None:
    builder = phipsi.scenes.chain(3).to_builder()
    builder.connect("tip", "point", "link2", xyz=(0, 0, 0.3))
    scene = builder.build()
    for function in ("forward_dynamics_derivatives", "forward_dynamics_jvp", "forward_dynamics_vjp"):
        with pytest.raises(ArgumentError, match="tip"):
            scene.to_c(functions=[function])
    # Neither the poses of links nor inverse dynamics depend on them.
    assert "robot_inverse_dynamics_vjp(" in scene.to_c(functions=["inverse_dynamics_vjp"])["robot.h"]
    assert "robot_placement_link2(" in scene.to_c(functions=[("placement", "link2")])["robot.h"]


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("compiled")


def states(scene: phipsi.Scene, shape: tuple[int, ...], seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    q = scene.integrate(scene.neutral(), random.uniform(-1, 1, (*shape, scene.nv)))
    return q, random.uniform(-1, 1, (*shape, scene.nv)), random.uniform(-1, 1, (*shape, scene.nv))


def states_of_people(scene: phipsi.Scene, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Twenty states: random, at rest, static equilibrium, passive, one joint moving; the third is a torque."""
    q, qd, tau = states(scene, (20,), seed)
    q[4:8] = scene.neutral()
    qd[4:12] = tau[4:8] = tau[12:] = 0.0
    tau[8:12] = scene.bias_torque(q[8:12], qd[8:12])
    qd[16:] = np.eye(scene.nv)[scene.nv // 2]
    return q, qd, tau


@pytest.mark.parametrize("seed", range(2))
def test_batches_of_compiled_scenes(seed: int, cache: Path) -> None:
    scene = random_scene(seed, 6 - 2 * seed, floating_base=seed == 1)
    fast = phipsi.compile(scene, flags=["-O0"], cache=cache)
    assert fast.functions == tuple(FUNCTIONS) and fast.scene is scene and f"{scene.nv} degrees" in repr(fast)
    directions = np.random.default_rng(seed).uniform(-1, 1, (3, scene.nv))
    for q, qd, u in (*(states(scene, shape, seed) for shape in ((19,), (4, 6), (1,), ())), states_of_people(scene, seed)):
        given = {"q": q, "qd": qd, "u": u, "dq": directions[0], "dqd": directions[1], "du": directions[2]}
        cond = float(np.max(np.linalg.cond(scene.mass_matrix(q))))
        for function, reads in FUNCTIONS.items():
            expected = getattr(scene, function)(*(given[name] for name in reads))
            assert_same(getattr(fast, function)(*(given[name] for name in reads)), expected, cond)
    # Leading axes broadcast, and angles of a million turns are valid.
    q, qd, u = states(scene, (20,), seed)
    one = fast.inverse_dynamics(q, qd[0], u[0])
    np.testing.assert_allclose(one, scene.inverse_dynamics(q, qd[0], u[0]), rtol=0, atol=1e-12 * float(np.max(np.abs(one))))


def test_far_angles_and_threads(cache: Path) -> None:
    scene = phipsi.scenes.chain(3)
    fast = phipsi.compile(scene, ["forward_dynamics"], flags=["-O0"], cache=cache)
    q, qd, u = states(scene, (5000,))
    q[7] *= 1e9
    q[8] += 2e3 * np.pi
    expected = scene.forward_dynamics(q, qd, u)
    before = phipsi.get_num_threads()
    try:
        results = []
        for threads in (1, 2):
            phipsi.set_num_threads(threads)
            results.append(fast.forward_dynamics(q, qd, u))
    finally:
        phipsi.set_num_threads(before)
    np.testing.assert_array_equal(*results)
    np.testing.assert_allclose(results[0], expected, rtol=0, atol=1e-10 * float(np.max(np.abs(expected))))


def test_what_was_compiled_once_is_loaded_again(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = phipsi.scenes.chain(2)
    first = phipsi.compile(scene, ["mass_matrix"], flags=["-O1"], cache=cache)
    assert phipsi.compile(scene, ["mass_matrix"], flags=["-O1"], cache=cache).library == first.library
    assert phipsi.compile(scene, ["mass_matrix"], flags=["-O0"], cache=cache).library != first.library
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache / "own"))
    assert phipsi.compile(scene, ["mass_matrix"], flags=["-O0"]).library.is_relative_to(cache / "own" / "phipsi")


def test_states_in_doubt_are_done_by_the_scene(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a heavy tip the covariance form loses all precision; ordinary states are not passed to the scene."""
    names = ["forward_dynamics", "mass_matrix_inverse"]
    heavy = phipsi.scenes.extreme("heavy-tip", 1e9).scene
    q, qd, u = states(heavy, (3, 8))
    fast, loses = (phipsi.compile(heavy, names, form=form, flags=["-O0"], cache=cache) for form in (None, "covariance"))  # type: ignore[arg-type]
    assert (fast.form, loses.form) == ("auto", "covariance")
    for name, given in (("forward_dynamics", (q, qd, u)), ("mass_matrix_inverse", (q,))):
        expected = getattr(heavy, name)(*given)
        assert_near(getattr(fast, name)(*given), expected, 1e-12 * size(expected))
        assert np.max(np.abs(getattr(loses, name)(*given) - expected)) > 1e-10 * size(expected)
    # Of typical states, only those of a straight robot are recomputed, which the scene estimates with two test
    # vectors.
    arm = phipsi.scenes.chain(5)
    handed: list[tuple[str, int]] = []
    q, qd, u = states_of_people(arm, 0)
    fast = phipsi.compile(arm, names, flags=["-O0"], cache=cache)
    expected, inverse = arm.forward_dynamics(q, qd, u), arm.mass_matrix_inverse(q)
    monkeypatch.setattr(fast, "scene", Recorder(arm, handed))
    cond = float(np.max(np.linalg.cond(arm.mass_matrix(q))))
    assert_same(fast.forward_dynamics(q, qd, u), expected, cond)
    assert_same(fast.mass_matrix_inverse(q), inverse, cond)
    assert handed in ([], [("forward_dynamics", 4)])


class Recorder:
    """A scene that records the called methods and the numbers of states."""

    def __init__(self, scene: phipsi.Scene | phipsi.Loops | phipsi.Contacts, asked: list[tuple[str, int]]) -> None:
        self.scene, self.asked = scene, asked

    def __getattr__(self, name: str) -> object:
        found = getattr(self.scene, name)
        if isinstance(found, phipsi.Loops | phipsi.Contacts):
            return Recorder(found, self.asked)
        if not callable(found):
            return found

        def noted(q: np.ndarray, *given: object, **options: object) -> object:
            self.asked.append((name, len(q)))
            return found(q, *given, **options)

        return noted


def test_what_the_scene_refuses_of_states_in_doubt_it_is_asked_of_all(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Messages contain the index of a state within the whole batch."""
    heavy, asked = phipsi.scenes.extreme("heavy-tip", 1e9).scene, []
    fast = phipsi.compile(heavy, ["forward_dynamics"], flags=["-O0"], cache=cache)
    light = phipsi.scenes.extreme("heavy-tip", 1.0).scene
    q, qd, u = states(heavy, (24,))

    class Refusing:
        nq, nv = heavy.nq, heavy.nv

        def forward_dynamics(self, q: np.ndarray, *given: np.ndarray, form: str = "auto") -> np.ndarray:
            asked.append(len(q))
            if len(asked) == 1:
                raise NotFiniteError("q: refused")
            return light.forward_dynamics(q, *given, form=form)  # type: ignore[arg-type]

    monkeypatch.setattr(fast, "scene", Refusing())
    np.testing.assert_array_equal(fast.forward_dynamics(q, qd, u), light.forward_dynamics(q, qd, u))
    assert 0 < asked[0] <= 24 and asked[1:] == [24]


@pytest.mark.parametrize(("options", "message"), [({"form": "joseph"}, "form"), ({"form": "auto", "dtype": "float32"}, "form: .*covariance"), ({"dtype": "int8"}, "dtype")])
def test_forms_that_are_not_compiled_are_refused(options: dict[str, str], message: str, cache: Path) -> None:
    with pytest.raises(ArgumentError, match=message):
        phipsi.compile(phipsi.scenes.chain(2), ["forward_dynamics"], cache=cache, **options)  # type: ignore[call-overload]


def test_bad_states_are_told_as_by_the_scene(cache: Path) -> None:
    scene = random_scene(1, 4, floating_base=True)
    fast = phipsi.compile(scene, ["forward_dynamics"], flags=["-O0"], cache=cache)
    q, qd, u = states(scene, (20,))
    for change, error in ((lambda: qd.__setitem__((3, 0), np.nan), NotFiniteError), (lambda: q.__setitem__((2, slice(3, 7)), 2.0), ArgumentError)):
        q, qd, u = states(scene, (20,))
        change()
        with pytest.raises(error) as told:
            fast.forward_dynamics(q, qd, u)
        with pytest.raises(error) as expected:
            scene.forward_dynamics(q, qd, u)
        assert str(told.value) == str(expected.value)
    with pytest.raises(ShapeError):
        fast.forward_dynamics(q[:, :-1], qd, u)
    with pytest.raises(ArgumentError, match="bias_torque"):
        fast.bias_torque(q, qd)


def test_long_code_is_announced(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("phipsi._compile.LONG", 5)
    scene = phipsi.scenes.chain(2)
    with pytest.warns(LongCodeWarning, match="operations"):
        phipsi.compile(scene, ["bias_torque"], flags=["-O0"], cache=cache)
    # Code in the cache needs no compiler.
    phipsi.compile(scene, ["bias_torque"], flags=["-O0"], cache=cache)


def test_compilers_that_are_none_or_fail_are_named(cache: Path) -> None:
    scene = phipsi.scenes.chain(2)
    with pytest.raises(ArgumentError, match="no-such-compiler"):
        phipsi.compile(scene, compiler="no-such-compiler", cache=cache)
    with pytest.raises(ArgumentError, match="failed"):
        phipsi.compile(scene, flags=["--no-such-flag"], cache=cache)


@pytest.mark.parametrize("seed", range(4))
def test_compiled_derivatives_against_60_digits(seed: int, cache: Path) -> None:
    """Matrices, products and kinematics on trees with all types of joints, from the definitions with 60 digits."""
    random = np.random.default_rng(seed)
    tree = random_tree(random, 6, kinds=tuple(np.roll(KINDS, seed)), most=8, armature=0.3 * (seed % 2), floating_base=seed == 3, branching=0.5)
    scene = tree.scene()
    n, last = scene.nv, scene.link_names[-1]
    functions = [name for name in FUNCTIONS if "derivatives" in name or "jvp" in name or "vjp" in name]
    fast = phipsi.compile(scene, [*functions, "placements", ("placement", last), ("jacobian", last)], flags=["-O0"], cache=cache)  # type: ignore[list-item]
    q = scene.integrate(scene.neutral(), random.uniform(-2.5, 2.5, n))
    qd, u, cotangent, *along = random.uniform(-2.0, 2.0, (6, n))
    here, at_q, rates = State(tree, q, qd), exact(q), exact(qd)
    batch = [np.tile(values, (20, 1)) for values in (q, qd, u)]

    def of_torques(accelerations: np.ndarray) -> list[np.ndarray]:
        """dtau/dq and dtau/dqd at these accelerations, and M."""
        by_q = [derivative(lambda h, e=e: State(tree, moved(tree, at_q, e, h), rates).inverse_dynamics(accelerations, {})) for e in identity(n)]
        by_qd = [derivative(lambda h, e=e: State(tree, at_q, rates + e * h).inverse_dynamics(accelerations, {})) for e in identity(n)]
        return [np.stack(by_q, axis=1), np.stack(by_qd, axis=1), here.mass_matrix]

    inverse = here.inverse
    of_accelerations = [*(-inverse @ matrix for matrix in of_torques(here.forward_dynamics(u, {}))[:2]), inverse]
    condition = float(np.linalg.cond(rounded(here.mass_matrix)))
    for name, matrices, conditioned in (("inverse", of_torques(exact(u)), False), ("forward", of_accelerations, True)):
        expected = [rounded(matrix) for matrix in matrices]
        scale = n * size(*expected)
        bound = solve(condition, scale) if conditioned else recursion(n, scale)
        for one, other in zip(getattr(fast, f"{name}_dynamics_derivatives")(*batch), expected, strict=True):
            assert_near(one[7], other, bound)
        change = sum(matrix @ exact(direction) for matrix, direction in zip(matrices, along, strict=True))
        assert_near(getattr(fast, f"{name}_dynamics_jvp")(*batch, *along)[7], rounded(change), bound)
        for one, matrix in zip(getattr(fast, f"{name}_dynamics_vjp")(*batch, cotangent)[:3], matrices, strict=True):
            assert_near(one[7], rounded(exact(cotangent) @ matrix), bound)
    for link, placement in fast.placements(batch[0]).items():
        assert_near(placement[7], rounded(here.placement(link)), recursion(n, 4.0))
    assert_near(fast.placement(batch[0], last)[7], rounded(here.placement(last)), recursion(n, 4.0))
    assert_near(fast.jacobian(batch[0], last)[7], rounded(here.jacobian(last)), recursion(n, 4.0))


def test_functions_of_links(cache: Path) -> None:
    scene = random_scene(1, 8, floating_base=True)
    middle, last = scene.link_names[4], scene.link_names[-1]
    asked = [("placement", middle), ("placement", last), ("jacobian", last), ("jacobian", last, "world"), ("jacobian", middle, "local-world-aligned"), ("jacobian", last, "local")]
    fast = phipsi.compile(scene, asked, flags=["-O0"], cache=cache)  # type: ignore[arg-type]
    for shape in ((19,), (3, 7), ()):
        q = states(scene, shape)[0]
        assert_same(fast.placement(q, last), scene.placement(q, last), 1.0)
        assert_same(fast.placement(q, [middle, last, middle]), scene.placement(q, [middle, last, middle]), 1.0)
        assert_same(fast.placement(q, []), scene.placement(q, []), 1.0)
        assert_same(fast.jacobian(q, last), scene.jacobian(q, last), 1.0)
        assert_same(fast.jacobian(q, last, frame="world"), scene.jacobian(q, last, frame="world"), 1.0)
        aligned = fast.jacobian(q, middle, frame="local-world-aligned")
        assert_same(aligned, scene.jacobian(q, middle, frame="local-world-aligned"), 1.0)
    for call in (lambda: fast.jacobian(q, middle), lambda: fast.placement(q, "base"), lambda: fast.placements(q)):
        with pytest.raises(ArgumentError, match=f"jacobian {last} world"):
            call()


def test_the_command_writes_functions_of_links(tmp_path: Path) -> None:
    link = phipsi.load(phipsi.BUNDLED_ARM).link_names[-1]
    asked = [argument for function in (f"placement:{link}", f"jacobian:{link}:world", "inverse_dynamics_derivatives") for argument in ("-f", function)]
    done = CliRunner().invoke(codegen, ["-o", str(tmp_path / "made"), *asked])
    assert done.exit_code == 0, done.output
    header = (tmp_path / "made" / "robot.h").read_text()
    assert f"robot_placement_{link}(" in header and f"robot_jacobian_{link}_world(" in header and "double dtau_dqd[" in header
    for wrong in ("fly", "placement", f"mass_matrix:{link}"):
        done = CliRunner().invoke(codegen, ["-o", str(tmp_path / "none"), "-f", wrong])
        assert done.exit_code == 2 and wrong in done.output and "jacobian:LINK:FRAME" in done.output


def test_long_programs_are_cut_in_pieces(cache: Path) -> None:
    scene = random_scene(3, 7)
    function = "forward_dynamics_derivatives"
    text = scene.to_c(functions=[function], batches=True)["robot.c"]
    assert f"{function}_1(" in text and f"{function}_lanes_1(" in text
    fast = phipsi.compile(scene, [function], flags=["-O0"], cache=cache)
    q, qd, tau = states(scene, (20,))
    cond = float(np.max(np.linalg.cond(scene.mass_matrix(q))))
    assert_same(fast.forward_dynamics_derivatives(q, qd, tau), scene.forward_dynamics_derivatives(q, qd, tau), cond)


@pytest.mark.parametrize(("method", "name"), [("to_c", "arm.c"), ("to_c", "arm.h"), ("to_cuda", "arm.cu"), ("to_rust", "arm.rs")])
def test_a_directory_with_the_name_of_a_file_is_refused(tmp_path: Path, method: str, name: str) -> None:
    """A directory of that name would be created."""
    scene = phipsi.scenes.chain(2)
    with pytest.raises(ArgumentError, match=f"directory: found '.*{name}', the name of a file; expected a directory for the files .* with name='arm'"):
        getattr(scene, method)(tmp_path / name, functions=["mass_matrix"])
    assert not (tmp_path / name).exists()
    (tmp_path / name).mkdir()
    getattr(scene, method)(tmp_path / name, functions=["mass_matrix"])
    assert any((tmp_path / name).iterdir())
