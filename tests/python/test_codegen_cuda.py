"""CUDA kernels of a robot without a GPU: compiled as C with a loop over threads, compared with the scene's methods;
compiled by NVRTC without running; and the Python interface with a substitute for CuPy.

Nothing here runs on a GPU.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import re
import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import random_scene
from page_script import differences, script
from test_codegen import FUNCTIONS, parts
from tolerances import in_float32

import phipsi
from phipsi import _install
from phipsi.errors import ArgumentError, ShapeError

COMPILER = os.environ.get("CC", "cc")
EPSILON = {"float64": 1e-14, "float32": in_float32(1e-14)}


pytestmark = pytest.mark.usefixtures("c_compiler")


def states(scene: phipsi.Scene, shape: tuple[int, ...], dtype: str) -> dict[str, np.ndarray]:
    random = np.random.default_rng(0)
    q = scene.integrate(scene.neutral(), random.uniform(-1, 1, (*shape, scene.nv)))
    others = {name: random.uniform(-1, 1, (*shape, scene.nv)) for name in ("qd", "u", "dq", "dqd", "du")}
    return {name: array.astype(dtype) for name, array in ({"q": q} | others).items()}


def expected_of(scene: phipsi.Scene, function: str, given: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Result of the method, with the placements of all links concatenated."""
    found = parts(getattr(scene, function)(*(given[name] for name in FUNCTIONS[function])))
    return [np.stack(found, axis=-3)] if function == "placements" else found


def bound(scene: phipsi.Scene, function: str, given: dict[str, np.ndarray], dtype: str) -> float:
    """Scale of a difference; a bias torque near zero by chance is compared with the torques of the same motion."""
    measure = "inverse_dynamics" if function == "bias_torque" else function
    size = max(np.max(np.abs(part)) for part in expected_of(scene, measure, given))
    cond = float(np.max(np.linalg.cond(scene.mass_matrix(given["q"]))))
    return EPSILON[dtype] * (cond + 16) * float(size)


class Kernels:
    """Kernels of a source, compiled by the C compiler; arrays are addresses, as CuPy passes them."""

    def __init__(self, source: str, one_thread: str, into: Path) -> None:
        calls = []
        for function, reads in FUNCTIONS.items():
            if f" robot_{function}(" in source:
                results = 3 if "derivatives" in function or "vjp" in function else 1
                names = [*reads, *(f"out{i}" for i in range(results))]
                parameters = ", ".join(f"void *{name}" for name in names)
                calls.append(
                    f"void twin_{function}(unsigned long long count, unsigned long long threads, {parameters}) "
                    f"{{ ON_ALL_THREADS(threads, robot_{function}(count, {', '.join(names)})) }}\n"
                )
        for name, text in {"one_thread.h": one_thread, "robot.cu": source, "twin.c": '#include "one_thread.h"\n#include "robot.cu"\n' + "".join(calls)}.items():
            (into / name).write_text(text)
        subprocess.run([COMPILER, "-std=c99", "-O0", "-shared", "-fPIC", "twin.c", "-lm", "-o", "twin.so"], cwd=into, check=True, timeout=300)
        self.code = ctypes.CDLL(str(into / "twin.so"))

    def __call__(self, function: str, threads: int, count: int, *arrays: np.ndarray) -> None:
        assert all(array.flags.c_contiguous and array.shape[-1] == count for array in arrays)
        numbers = (ctypes.c_ulonglong(count), ctypes.c_ulonglong(threads))
        getattr(self.code, f"twin_{function}")(*numbers, *(ctypes.c_void_p(array.ctypes.data) for array in arrays))


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("seed", range(2))
def test_kernels_give_what_the_methods_give(seed: int, dtype: str, tmp_path: Path) -> None:
    scene = random_scene(seed, 8, floating_base=seed == 1, armature=0.1)
    files = scene.to_cuda(dtype=dtype)  # type: ignore[arg-type]
    kernels, count = Kernels(files["robot.cu"], files["one_thread.h"], tmp_path), 37
    given = states(scene, (count,), dtype)
    for function, reads in FUNCTIONS.items():
        expected = expected_of(scene, function, given)
        # One state more than the batch has: its threads write nothing.
        found = [np.full((part[0].size, count), np.nan, dtype) for part in expected]
        kernels(function, 64, count, *(np.ascontiguousarray(given[name].T) for name in reads), *found)
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one.T.reshape(other.shape), other, rtol=0, atol=bound(scene, function, given, dtype), err_msg=function)


def test_the_c_compiler_runs_the_test_that_is_written(tmp_path: Path) -> None:
    files = random_scene(2, 6).to_cuda(tmp_path, name="arm", functions=["forward_dynamics", "mass_matrix"])
    assert list(files) == ["arm.cu", "one_thread.h", "test_arm.cu", "Makefile"]
    made = subprocess.run(["make", "-s", "test-c", f"CC={COMPILER}"], cwd=tmp_path, check=True, capture_output=True, text=True, timeout=300)
    assert [line.split(":")[0] for line in made.stdout.splitlines()] == ["forward_dynamics", "mass_matrix"]
    # A result that differs from that of the scene is an error.
    broken = (tmp_path / "arm.cu").read_text().replace("sine_and_cosine(g", "sine_and_cosine(1.0 + g")
    (tmp_path / "arm.cu").write_text(broken)
    assert subprocess.run(["make", "-s", "test-c", f"CC={COMPILER}"], cwd=tmp_path, check=False, capture_output=True, timeout=300).returncode != 0


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_nvrtc_compiles_the_kernels(dtype: str) -> None:
    """For a processor with compute capability 8.0, without a driver."""
    try:
        package = importlib.util.find_spec("nvidia.cuda_nvrtc")
    except ModuleNotFoundError:
        package = None
    if package is None or package.submodule_search_locations is None:
        pytest.skip("no NVRTC here: pip install nvidia-cuda-nvrtc-cu12")
    (folder,) = package.submodule_search_locations
    nvrtc = ctypes.CDLL(str(next(Path(folder).glob("lib/libnvrtc.so.*"))))
    source = random_scene(1, 8, floating_base=True).to_cuda(dtype=dtype)["robot.cu"].encode()  # type: ignore[arg-type]
    program, size = ctypes.c_void_p(), ctypes.c_size_t()
    assert nvrtc.nvrtcCreateProgram(ctypes.byref(program), source, b"robot.cu", 0, None, None) == 0
    options = (ctypes.c_char_p * 2)(b"--gpu-architecture=compute_80", b"--std=c++17")
    done = nvrtc.nvrtcCompileProgram(program, len(options), options)
    nvrtc.nvrtcGetProgramLogSize(program, ctypes.byref(size))
    log = ctypes.create_string_buffer(size.value)
    nvrtc.nvrtcGetProgramLog(program, log)
    assert (done, log.value.strip()) == (0, b"")
    assert nvrtc.nvrtcGetPTXSize(program, ctypes.byref(size)) == 0
    code = ctypes.create_string_buffer(size.value)
    assert nvrtc.nvrtcGetPTX(program, code) == 0
    assert code.value.decode().count(".visible .entry robot_") == len(FUNCTIONS)


class OnGpu(np.ndarray):
    """An array of the substitute for CuPy."""

    @property
    def device(self) -> Any:
        return nullcontext()


class Foreign:
    """An array of another library that claims to be on a GPU."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = array

    def __dlpack_device__(self) -> tuple[int, int]:
        return (2, 0)

    def __dlpack__(self, **_: Any) -> Any:
        return self.array.__dlpack__()


class CudaError(RuntimeError):
    """The exception of CuPy."""


def stand_in(one_thread: str, into: Path, devices: Callable[[], int] = lambda: 1) -> Any:
    """The used part of CuPy; its GPU is the C compiler."""

    def taken(make: Callable[..., Any]) -> Callable[..., OnGpu]:
        return lambda *given, **named: make(*given, **named).view(OnGpu)

    class RawModule:
        def __init__(self, *, code: str, options: tuple[str, ...]) -> None:
            assert options == ("--std=c++17",)
            self.kernels = Kernels(code, one_thread, into)

        def get_function(self, name: str) -> Callable[..., None]:
            def launch(blocks: tuple[int], threads: tuple[int], given: tuple[Any, ...]) -> None:
                count, *arrays = given
                assert isinstance(count, np.uint64) and all(isinstance(array, OnGpu) for array in arrays)
                self.kernels(name.removeprefix("robot_"), blocks[0] * threads[0], int(count), *arrays)

            return launch

    runtime = SimpleNamespace(getDeviceCount=devices, CUDARuntimeError=CudaError)
    made: dict[str, Any] = {name: taken(getattr(np, name)) for name in ("ascontiguousarray", "asarray", "broadcast_to", "empty", "from_dlpack")}
    made["random"] = SimpleNamespace(uniform=taken(np.random.default_rng(0).uniform))
    return SimpleNamespace(ndarray=OnGpu, float32=np.float32, RawModule=RawModule, cuda=SimpleNamespace(runtime=runtime), **made)


@pytest.fixture
def gpu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    cupy = stand_in(phipsi.scenes.chain(1).to_cuda()["one_thread.h"], tmp_path)
    monkeypatch.setitem(sys.modules, "cupy", cupy)
    return cupy


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_batches_of_any_shape_and_library(gpu: Any, dtype: str) -> None:
    scene = random_scene(3, 6, floating_base=True, armature=0.1)
    fast = phipsi.compile(scene, device="cuda", dtype=dtype)  # type: ignore[arg-type]
    assert isinstance(fast, phipsi.CompiledForCuda) and fast.functions == tuple(FUNCTIONS) and dtype in repr(fast)
    for shape in ((70,), (3, 5), (1,), (), (0,)):
        given = states(scene, shape, dtype)
        for function, reads in FUNCTIONS.items():
            all_expected = parts(getattr(scene, function)(*(given[name] for name in reads)))
            all_found = parts(getattr(fast, function)(*(Foreign(given[name]) for name in reads)))
            for found, expected in zip(all_found, all_expected, strict=True):
                assert isinstance(found, OnGpu) and found.shape == expected.shape and found.dtype == dtype
                if expected.size:
                    np.testing.assert_allclose(found, expected, rtol=0, atol=bound(scene, function, given, dtype), err_msg=function)
    # Leading axes broadcast, and results are valid arguments.
    given = {name: gpu.asarray(array) for name, array in states(scene, (4, 3), dtype).items()}
    qdd = fast.forward_dynamics(given["q"], given["qd"][0], given["u"][0, 0])
    tau = fast.inverse_dynamics(given["q"], given["qd"][0], qdd)
    np.testing.assert_allclose(tau, np.broadcast_to(given["u"][0, 0], tau.shape), rtol=0, atol=EPSILON[dtype] * 1e4 * float(np.max(np.abs(tau))))


@pytest.mark.usefixtures("gpu")
def test_the_output_of_the_page_is_that_of_the_substitute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "cuda.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    exec(compile(script(page), "cuda.md", "exec"), {"__name__": "__main__"})
    assert not differences(page, capsys.readouterr().out, every=True)


def test_arguments_that_are_broken_are_named(gpu: Any) -> None:
    scene = phipsi.scenes.chain(3)
    fast = phipsi.compile(scene, ["forward_dynamics"], device="cuda")
    q = gpu.asarray(np.zeros((5, 3)))
    assert fast.forward_dynamics(q, q, q).shape == (5, 3)
    with pytest.raises(ArgumentError, match=r"qd: .*ndarray.*cupy\.asarray\(qd\)"):
        fast.forward_dynamics(q, np.zeros((5, 3)), q)
    with pytest.raises(ArgumentError, match="tau: .*list"):
        fast.forward_dynamics(q, q, [0.0, 0.0, 0.0])
    with pytest.raises(ArgumentError, match="q: found float32; expected the compiled dtype float64"):
        fast.forward_dynamics(q.astype(np.float32), q, q)
    with pytest.raises(ShapeError, match=r"tau: .*\(5, 2\); expected \(\.\.\., 3\)"):
        fast.forward_dynamics(q, q, q[:, :2])
    with pytest.raises(ShapeError, match="broadcast"):
        fast.forward_dynamics(q, q[:2], q)
    with pytest.raises(ArgumentError, match="functions: .*mass_matrix"):
        fast.mass_matrix(q)


@pytest.mark.parametrize(("argument", "value"), [("out", np.zeros((5, 3))), ("errors", "nan"), ("wrenches", {"tip": np.zeros(6)}), ("return_info", True)])
def test_what_only_the_scene_takes_is_refused(gpu: Any, argument: str, value: object) -> None:
    fast = phipsi.compile(phipsi.scenes.chain(3), ["forward_dynamics"], device="cuda")
    q = gpu.asarray(np.zeros((5, 3)))
    assert fast.forward_dynamics(q, q, q).shape == (5, 3)
    with pytest.raises(ArgumentError, match=rf"{argument}: found .*GPU.*scene\.forward_dynamics"):
        fast.forward_dynamics(q, q, q, **{argument: value})


def test_what_only_the_cpu_has_is_refused(gpu: Any) -> None:
    scene = phipsi.scenes.chain(2)
    for name, value in (("compiler", "cc"), ("flags", ["-O1"]), ("cache", ".")):
        with pytest.raises(ArgumentError, match=f"{name}: .*NVRTC"):
            phipsi.compile(scene, device="cuda", **{name: value})  # type: ignore[call-overload]
    with pytest.raises(ArgumentError, match="device: found 'gpu'"):
        phipsi.compile(scene, device="gpu")  # type: ignore[call-overload]
    with pytest.raises(ArgumentError, match="dtype"):
        phipsi.compile(scene, device="cuda", dtype="float16")  # type: ignore[call-overload]
    with pytest.raises(ArgumentError, match="functions"):
        phipsi.compile(scene, [], device="cuda")


def test_without_cupy_or_a_gpu_the_way_out_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = phipsi.scenes.chain(2)
    monkeypatch.setitem(sys.modules, "cupy", None)
    with pytest.raises(ImportError, match=re.escape(_install.command("cuda"))):
        phipsi.compile(scene, device="cuda")

    def no_driver() -> int:
        raise CudaError("no driver")

    for devices in (no_driver, lambda: 0):
        monkeypatch.setitem(sys.modules, "cupy", stand_in("", tmp_path, devices))
        with pytest.raises(ArgumentError, match="device: found no GPU.*device='cpu'"):
            phipsi.compile(scene, device="cuda")
