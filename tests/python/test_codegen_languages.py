"""One robot as a Rust crate and as C code in float: generated files, arguments of the command, and compiled code in
float32 compared with the scene's methods.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from conftest import random_scene
from test_codegen import FUNCTIONS, parts, states
from tolerances import in_float32

import phipsi
from phipsi.errors import ArgumentError, NotFiniteError
from phipsi.report.codegen import codegen

COMPILER = os.environ.get("CC", "cc")
CRATE = ["Cargo.toml", "src/lib.rs", "src/dynamics.rs", "src/lanes.rs", "src/numbers.rs", "tests/reference.rs"]


def test_a_crate_has_what_is_asked_for() -> None:
    files = phipsi.scenes.chain(3).to_rust(name="tail", functions=["mass_matrix"])
    assert list(files) == CRATE
    assert 'name = "tail"' in files["Cargo.toml"] and "pub fn mass_matrix<T: Number>(q: &[T; 3]) -> [T; 9]" in files["src/dynamics.rs"]
    assert not any("forward_dynamics" in text for text in files.values())
    # The result does not depend on the rotation of the first joint, and no sine is computed twice.
    assert "q[0]" not in files["src/dynamics.rs"] and files["src/dynamics.rs"].count("q[1].sin_cos()") == 1


def test_the_command_writes_a_crate_that_passes_its_test(tmp_path: Path) -> None:
    done = CliRunner().invoke(codegen, ["-o", str(tmp_path), "--lang", "rust", "--name", "bundled", "-f", "forward_dynamics"])
    assert done.exit_code == 0, done.output
    assert f"cargo test --manifest-path {tmp_path}" in done.output.replace("\n", "") and all((tmp_path / file).exists() for file in CRATE)
    if shutil.which("rustc") is None:
        pytest.skip("no rustc here; what was written is there")
    rustc = ["rustc", "--edition", "2021", "-D", "warnings", "-L", "."]
    subprocess.run([*rustc, "--crate-type", "rlib", "--crate-name", "bundled", "--cfg", 'feature="std"', "--check-cfg", 'cfg(feature, values("std"))', "src/lib.rs"], cwd=tmp_path, check=True, timeout=300)
    subprocess.run([*rustc, "--test", "tests/reference.rs", "-o", "reference", "--extern", "bundled"], cwd=tmp_path, check=True, timeout=300)
    said = subprocess.run([str(tmp_path / "reference")], check=True, capture_output=True, text=True, timeout=300).stdout
    assert "2 passed; 0 failed" in said


def test_the_command_writes_kernels_in_float(tmp_path: Path) -> None:
    done = CliRunner().invoke(codegen, ["-o", str(tmp_path), "--lang", "cuda", "--name", "bundled", "-f", "mass_matrix", "--float32"])
    assert done.exit_code == 0 and "make test" not in done.output.split("test-c")[-1], done.output
    assert "bundled_mass_matrix(unsigned long long count, const float *__restrict__ q" in (tmp_path / "bundled.cu").read_text(encoding="utf-8")


@pytest.mark.usefixtures("c_compiler")
def test_the_command_writes_batches_in_float(tmp_path: Path) -> None:
    done = CliRunner().invoke(codegen, ["-o", str(tmp_path), "-f", "bias_torque", "--float32", "--batches"])
    assert done.exit_code == 0, done.output
    made = subprocess.run(["make", "-s", "test", f"CC={COMPILER}", "CFLAGS=-std=c99 -O1"], cwd=tmp_path, check=True, capture_output=True, text=True, timeout=300)
    assert {line.rpartition(":")[0] for line in made.stdout.splitlines()} == {"bias_torque", "bias_torque, in lanes"}


@pytest.mark.parametrize(("flags", "message"), [(["--lang", "rust", "--float32"], "--float32"), (["--lang", "cuda", "--batches"], "--batches"), (["--lang", "fortran"], "fortran")])
def test_flags_of_other_languages_are_refused(flags: list[str], message: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(codegen, ["-o", str(tmp_path / "none"), *flags])
    assert done.exit_code == 2 and message in done.output and not (tmp_path / "none").exists()


@pytest.mark.parametrize(("options", "message"), [({"name": "fn"}, "name"), ({"name": "a-b"}, "name"), ({"functions": ["fly"]}, "fly"), ({"functions": []}, "functions")])
def test_broken_options_of_crates_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        phipsi.scenes.chain(2).to_rust(**options)  # type: ignore[arg-type]


@pytest.mark.parametrize(("options", "message"), [({"name": "7dof"}, "name"), ({"functions": ["fly"]}, "fly"), ({"dtype": "int8"}, "dtype")])
def test_broken_options_of_kernels_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        phipsi.scenes.chain(2).to_cuda(**options)  # type: ignore[arg-type]


@pytest.mark.usefixtures("c_compiler")
def test_compiled_in_float32(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Small batches.
    monkeypatch.setattr("phipsi._compile.FEW", dict.fromkeys(phipsi._compile.FEW, 16))
    scene = random_scene(1, 4, floating_base=True, armature=0.1)
    fast = phipsi.compile(scene, dtype="float32", flags=["-O0"], cache=tmp_path)
    assert fast.dtype == np.float32
    for shape, given in (((37,), "float32"), ((37,), "float64"), ((2, 3), "float32"), ((2, 3), "float64")):
        q, qd, u = states(scene, shape)
        numbers = {"q": q.astype(given), "qd": qd.astype(given), "u": u.astype(given)}
        numbers |= {"dq": numbers["qd"], "dqd": numbers["u"], "du": numbers["qd"]}
        cond = float(np.max(np.linalg.cond(scene.mass_matrix(q))))
        for function, reads in FUNCTIONS.items():
            arguments = [numbers[name] for name in reads]
            all_expected, all_found = parts(getattr(scene, function)(*arguments)), parts(getattr(fast, function)(*arguments))
            bound = in_float32(1e-14 * (cond + 16) * max(float(np.max(np.abs(part))) for part in all_expected))
            for found, expected in zip(all_found, all_expected, strict=True):
                assert found.dtype == np.float32 and found.shape == expected.shape
                np.testing.assert_allclose(found, expected, rtol=0, atol=bound, err_msg=function)


@pytest.mark.usefixtures("c_compiler")
def test_far_angles_in_float32(tmp_path: Path) -> None:
    scene = phipsi.scenes.chain(3)
    fast = phipsi.compile(scene, ["mass_matrix"], dtype="float32", flags=["-O1"], cache=tmp_path)
    q = np.random.default_rng(0).uniform(-1, 1, (64, 3)).astype(np.float32) * np.float32(10.0) ** np.arange(64, dtype=np.float32)[:, None].clip(0, 9)
    expected = scene.mass_matrix(q.astype(np.float64))
    np.testing.assert_allclose(fast.mass_matrix(q), expected, rtol=0, atol=1e-6 * float(np.max(np.abs(expected))))
    q[5] = np.nan
    with pytest.raises(NotFiniteError):
        fast.mass_matrix(q)


@pytest.mark.parametrize("compiler", [COMPILER, "arm-none-eabi-gcc"])
def test_code_in_float_asks_for_nothing_but_sines(compiler: str, tmp_path: Path) -> None:
    nm = compiler.replace("gcc", "nm") if compiler.endswith("-gcc") else "nm"
    for program in (compiler, nm):
        if shutil.which(program) is None:
            pytest.skip(f"no {program} here")
    chip = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"] if compiler.startswith("arm") else []
    random_scene(0, 8, armature=0.1).to_c(tmp_path, dtype="float32")
    subprocess.run([compiler, "-std=c99", "-O1", "-fno-math-errno", *chip, "-c", "robot.c"], cwd=tmp_path, check=True, timeout=300)
    said = subprocess.run([nm, "-u", "robot.o"], cwd=tmp_path, check=True, capture_output=True, text=True, timeout=300).stdout
    asked = {line.split()[-1].lstrip("_") for line in said.splitlines() if line.strip()}
    assert {"sinf", "cosf"} & asked or "sincosf" in asked
    # Neither memory nor arithmetic in double.
    assert asked <= {"sinf", "cosf", "sincosf", "sqrtf"}
