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
from phipsi.errors import ArgumentError
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
