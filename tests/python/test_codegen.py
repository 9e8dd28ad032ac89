"""One robot as C: compiled by the system's compiler and called by ctypes, beside the scene's methods; what is refused."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from conftest import random_scene

import phipsi
from phipsi.errors import ArgumentError, NotFiniteError, ShapeError
from phipsi.report.codegen import codegen

COMPILER = os.environ.get("CC", "cc")
FUNCTIONS = {
    "forward_dynamics": ("q", "qd", "u"),
    "inverse_dynamics": ("q", "qd", "u"),
    "bias_torque": ("q", "qd"),
    "mass_matrix": ("q",),
    "mass_matrix_inverse": ("q",),
}


@pytest.fixture(autouse=True)
def _compiler() -> None:
    if shutil.which(COMPILER) is None:
        pytest.skip("no C compiler here")


def library(scene: phipsi.Scene, into: Path) -> ctypes.CDLL:
    scene.to_c(into, name="arm")
    made = into / "arm.so"
    subprocess.run([COMPILER, "-std=c99", "-O1", "-shared", "-fPIC", "arm.c", "-lm", "-o", str(made)], cwd=into, check=True)
    return ctypes.CDLL(str(made))


@pytest.mark.parametrize("seed", range(3))
def test_compiled_code_gives_what_the_methods_give(seed: int, tmp_path: Path) -> None:
    scene = random_scene(seed, 7, floating_base=seed == 1)
    code, random = library(scene, tmp_path), np.random.default_rng(seed)
    for _ in range(3):
        state = {
            "q": scene.integrate(scene.neutral(), random.uniform(-1, 1, scene.nv)),
            "qd": random.uniform(-1, 1, scene.nv),
            "u": random.uniform(-1, 1, scene.nv),
        }
        cond = float(np.linalg.cond(scene.mass_matrix(state["q"])))
        for function, reads in FUNCTIONS.items():
            expected = getattr(scene, function)(*(state[name] for name in reads))
            found = np.full(expected.shape, np.nan)
            getattr(code, f"arm_{function}")(*(ctypes.c_void_p(state[name].ctypes.data) for name in reads), ctypes.c_void_p(found.ctypes.data))
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14 * (cond + 16) * float(np.max(np.abs(expected))), err_msg=function)


def test_functions_that_are_asked_for_are_all_there_are() -> None:
    files = phipsi.scenes.chain(3).to_c(name="tail", functions=["mass_matrix"])
    assert list(files) == ["tail.c", "tail.h", "test_tail.c", "Makefile"]
    assert "tail_mass_matrix(" in files["tail.h"] and "forward_dynamics" not in files["tail.c"]
    # Nothing of it turns with the first joint, and neither sine nor gravity is there twice.
    assert "q[0]" not in files["tail.c"] and files["tail.c"].count("sin(q[1])") == 1
    assert "float" in phipsi.scenes.chain(3).to_c(dtype="float32")["robot.h"]


def test_the_command_writes_what_make_tests(tmp_path: Path) -> None:
    into = tmp_path / "made"
    done = CliRunner().invoke(codegen, ["-o", str(into), "--name", "bundled", "-f", "forward_dynamics", "-f", "mass_matrix"])
    assert done.exit_code == 0, done.output
    assert str(into / "bundled.c") in done.output
    made = subprocess.run(["make", "-s", "test", f"CC={COMPILER}", "CFLAGS=-std=c99 -O1"], cwd=into, check=True, capture_output=True, text=True)
    assert [line.split(":")[0] for line in made.stdout.splitlines()][-2:] == ["forward_dynamics", "mass_matrix"]


@pytest.mark.parametrize(("options", "message"), [({"name": "7dof"}, "name"), ({"functions": ["fly"]}, "fly"), ({"functions": []}, "functions"), ({"dtype": "int8"}, "dtype")])
def test_broken_options_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        phipsi.scenes.chain(2).to_c(**options)  # type: ignore[arg-type]


def test_scenes_with_connections_are_refused() -> None:
    builder = phipsi.scenes.chain(3).to_builder()
    builder.connect("tip", "point", "link2", xyz=(0, 0, 0.3))
    with pytest.raises(ArgumentError, match="tip"):
        builder.build().to_c()


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("compiled")


def states(scene: phipsi.Scene, shape: tuple[int, ...], seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    q = scene.integrate(scene.neutral(), random.uniform(-1, 1, (*shape, scene.nv)))
    return q, random.uniform(-1, 1, (*shape, scene.nv)), random.uniform(-1, 1, (*shape, scene.nv))


@pytest.mark.parametrize("seed", range(2))
def test_batches_of_compiled_scenes(seed: int, cache: Path) -> None:
    scene = random_scene(seed, 6, floating_base=seed == 1)
    fast = phipsi.compile(scene, flags=["-O1"], cache=cache)
    assert fast.functions == tuple(FUNCTIONS) and fast.scene is scene and f"{scene.nv} degrees" in repr(fast)
    for shape in ((19,), (4, 6), (1,), ()):
        q, qd, u = states(scene, shape, seed)
        given = {"q": q, "qd": qd, "u": u}
        cond = float(np.max(np.linalg.cond(scene.mass_matrix(q))))
        for function, reads in FUNCTIONS.items():
            expected = getattr(scene, function)(*(given[name] for name in reads))
            found = getattr(fast, function)(*(given[name] for name in reads))
            assert found.shape == expected.shape
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14 * (cond + 16) * float(np.max(np.abs(expected))), err_msg=function)
    # Leading axes broadcast, and angles of a million turns are angles.
    q, qd, u = states(scene, (20,), seed)
    one = fast.inverse_dynamics(q, qd[0], u[0])
    np.testing.assert_allclose(one, scene.inverse_dynamics(q, qd[0], u[0]), rtol=0, atol=1e-12 * float(np.max(np.abs(one))))


def test_far_angles_and_threads(cache: Path) -> None:
    scene = phipsi.scenes.chain(3)
    fast = phipsi.compile(scene, ["forward_dynamics"], flags=["-O1"], cache=cache)
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


def test_bad_states_are_told_as_by_the_scene(cache: Path) -> None:
    scene = random_scene(1, 4, floating_base=True)
    fast = phipsi.compile(scene, ["forward_dynamics"], flags=["-O1"], cache=cache)
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


def test_compilers_that_are_none_or_fail_are_named(cache: Path) -> None:
    scene = phipsi.scenes.chain(2)
    with pytest.raises(ArgumentError, match="no-such-compiler"):
        phipsi.compile(scene, compiler="no-such-compiler", cache=cache)
    with pytest.raises(ArgumentError, match="failed"):
        phipsi.compile(scene, flags=["--no-such-flag"], cache=cache)
