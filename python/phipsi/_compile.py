"""One robot as machine code of its own, by the system's C compiler."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import accumulate
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._core import _unwritten, get_num_threads
from ._cuda import CompiledForCuda, compile_for_cuda
from ._functions import FUNCTIONS, IN_FORM, Function, Functions, parts, symbol
from .errors import ArgumentError, LongCodeWarning, PhipsiError, of_argument

if TYPE_CHECKING:
    from ._core import Scene

__all__ = ["Compiled", "compile"]

_Array: TypeAlias = NDArray[Any]
#: What every compiler is told. Functions of one state are not called from here, and would take half the time.
ALWAYS = ("-std=c99", "-ffp-contract=fast", "-fno-math-errno", "-shared", "-fPIC", "-DROBOT_BATCHES_ALONE")
#: So many operations, and roughly how long a compiler takes for each.
LONG, SECONDS_EACH = 50_000, 4e-4
#: What is compiled of functions that watch what rounding does.
WATCHED: dict[str, Any] = {name: f"{name}_watched" for name in ("forward_dynamics", "mass_matrix_inverse")}
#: Fewer states are faster by the scene's own call, whose way from Python is shorter.
FEW = 16
#: A thread gets so many states at the least.
WORTH_A_THREAD = 2048


class Compiled(Functions[_Array]):
    """Functions of one scene as machine code that holds nothing else; batches run as many states at once as the processor's registers hold, on as many threads as set_num_threads says.

    Each method takes the arrays of the scene's method of that name and gives its results to rounding. In form "auto" forward_dynamics and mass_matrix_inverse watch what rounding does, and states that may
    have lost digits are done by the scene's own method; else, and in derivatives and products, the form is "covariance": digits that it loses are not noticed. Few states, and arguments or
    results that are not in order, are done by the scene's own method too, which says what is wrong. Results have the dtype that was compiled. Methods of functions that were not compiled raise ArgumentError.
    """

    library: Path
    """The file of the machine code."""
    form: Literal["auto", "covariance"]
    """How forward_dynamics and mass_matrix_inverse keep their digits."""

    def __init__(self, scene: Scene, functions: tuple[Function, ...], library: Path, form: Literal["auto", "covariance"], dtype: str) -> None:
        super().__init__(scene, functions, dtype)
        self.library, self.form = library, form
        self._watched = WATCHED if form == "auto" else {}
        code = ctypes.CDLL(str(library))
        self._code = {parts(function): getattr(code, f"robot_{symbol(self._watched.get(str(function), function))}_batch") for function in functions}

    def _run(self, function: tuple[str, ...], given: dict[str, ArrayLike], shapes: Sequence[tuple[int, ...]]) -> list[_Array] | None:
        run = self._code.get(function)
        if run is None:
            raise self._missing(function)
        ready = self._ready(tuple(given.values()))
        if ready is None:
            return None
        arrays, batch = ready
        count, is_watched = prod(batch), function[0] in self._watched
        if is_watched:
            shapes = [*shapes, (1,)]
        # In one piece: the allocator gives the pages of several back to the system every time, which clears them anew.
        ends = list(accumulate((count * prod(shape) for shape in shapes), initial=0))
        numbers: _Array = _unwritten(ends[-1]) if self.dtype == np.float64 else np.empty(ends[-1], self.dtype)
        results = [numbers[first:end].reshape(*batch, *shape) for first, end, shape in zip(ends[:-1], ends[1:], shapes, strict=True)]

        def piece(first: int, end: int) -> int:
            addresses = (ctypes.c_void_p(array.ctypes.data + array.itemsize * first * (array.size // count)) for array in (*arrays, *results))
            fault: int = run(ctypes.c_size_t(end - first), *addresses)
            return fault

        threads = min(get_num_threads(), count // WORTH_A_THREAD)
        if threads > 1:
            cuts = [count * i // threads for i in range(threads + 1)]
            with ThreadPoolExecutor(threads) as pool:
                faults = sum(pool.map(piece, cuts[:-1], cuts[1:]))
        else:
            faults = piece(0, count)
        if faults:
            return None
        return self._mended(function[0], arrays, results) if is_watched else results

    def _mended(self, name: str, arrays: list[_Array], results: list[_Array]) -> list[_Array] | None:
        """The result, states whose margin is below zero done by the scene; None where the scene is to say of all what is wrong."""
        result, margins = results
        doubtful = np.flatnonzero(~(margins >= 0))
        if doubtful.size:
            count = margins.size
            try:
                better = getattr(self.scene, name)(*(array.reshape(count, -1)[doubtful] for array in arrays))
            except PhipsiError:
                return None
            result.reshape(count, *better.shape[1:])[doubtful] = better
        return [result]

    def _ready(self, given: tuple[ArrayLike, ...]) -> tuple[list[_Array], tuple[int, ...]] | None:
        """Arrays of all states, one after another, and the leading axes; None of what the scene is to look at."""
        scene = self.scene
        widths = [scene.nq, *[scene.nv] * (len(given) - 1)]
        if not all(isinstance(value, np.ndarray) and value.dtype in (np.float64, self.dtype) and value.ndim > 0 for value in given):
            return None
        arrays: list[Any] = list(given)
        if [array.shape[-1] for array in arrays] != widths or scene.nv == 0:
            return None
        shapes = {array.shape[:-1] for array in arrays}
        try:
            batch = shapes.pop() if len(shapes) == 1 else np.broadcast_shapes(*shapes)
        except ValueError:
            return None
        if prod(batch) < FEW:
            return None
        if shapes:
            arrays = [np.broadcast_to(array, (*batch, array.shape[-1])) for array in arrays]
        return [np.ascontiguousarray(array, self.dtype) for array in arrays], batch

    def _by_scene(self, function: tuple[str, ...], given: dict[str, ArrayLike]) -> Any:
        name, *of = function
        form = "auto" if name in self._watched else "covariance"
        keywords = {"form": form} if name in IN_FORM else {"frame": of[1]} if len(of) > 1 else {}
        return _in_dtype(getattr(self.scene, name)(*given.values(), *of[:1], **keywords), self.dtype)


def _in_dtype(found: Any, dtype: np.dtype[Any]) -> Any:
    """Results of the scene as numbers of this kind."""
    if isinstance(found, dict):
        return {name: _in_dtype(value, dtype) for name, value in found.items()}
    if isinstance(found, tuple):
        return type(found)(*(_in_dtype(value, dtype) for value in found))
    return found if found is None else found.astype(dtype, copy=False)


@overload
def compile(
    scene: Scene,
    functions: Iterable[Function] | None = None,
    *,
    device: Literal["cpu"] = "cpu",
    form: Literal["auto", "covariance"] | None = None,
    dtype: Literal["float64", "float32"] = "float64",
    compiler: str | None = None,
    flags: Sequence[str] | None = None,
    cache: str | os.PathLike[str] | None = None,
) -> Compiled: ...
@overload
def compile(
    scene: Scene,
    functions: Iterable[Function] | None = None,
    *,
    device: Literal["cuda"],
    form: Literal["covariance"] | None = None,
    dtype: Literal["float64", "float32"] = "float64",
) -> CompiledForCuda: ...
def compile(  # noqa: A001  # phipsi.compile
    scene: Scene,
    functions: Iterable[Function] | None = None,
    *,
    device: Literal["cpu", "cuda"] = "cpu",
    form: Literal["auto", "covariance"] | None = None,
    dtype: Literal["float64", "float32"] = "float64",
    compiler: str | None = None,
    flags: Sequence[str] | None = None,
    cache: str | os.PathLike[str] | None = None,
) -> Compiled | CompiledForCuda:
    """Compiles functions of one scene by the system's C compiler: scene.to_c(batches=True) into a library that is loaded at once. Or for a GPU, scene.to_cuda through CuPy and NVRTC.

    functions: as of to_c, of one link ("placement", link), ("jacobian", link) or ("jacobian", link, frame); None: all that are of no one link. device: "cpu" or "cuda", which needs CuPy (phipsi[cuda]) and a GPU. form: "auto" hands states that may have lost digits to the scene, "covariance"
    does not look, and takes less time; None: "auto", and "covariance" of float32 and on a GPU, where "auto" is not to be had. dtype: "float64" or "float32", the numbers of the code and of results; on the CPU, arguments of
    float64 are rounded to it. compiler: its command; None: that of the environment variable CC, or cc. flags: for this processor and of how fast the code is to be; None: -O3 for this
    processor. cache: a directory that keeps libraries by scene, compiler and flags, so that the next call takes no time; None: phipsi/compiled where the user's caches are. These three are of device="cpu".

    Warns (LongCodeWarning) before the compiler begins on code that it takes long for, as for the derivatives of a humanoid. Raises ArgumentError where there is no compiler, or it fails, where there is no GPU, and as to_c; ImportError without CuPy.
    """
    if device not in ("cpu", "cuda"):
        raise of_argument(ArgumentError, "device", f"found {device!r}; expected 'cpu' or 'cuda'")
    if form not in (None, "auto", "covariance"):
        raise of_argument(ArgumentError, "form", f"found {form!r}; expected 'auto' or 'covariance'")
    if form == "auto" and (device == "cuda" or dtype != "float64"):
        raise of_argument(ArgumentError, "form", f"found 'auto' with device={device!r} and dtype={dtype!r}; expected 'covariance': states are watched in float64 on the CPU")
    names = None if functions is None else tuple(functions)
    known = FUNCTIONS if names is None else tuple(dict.fromkeys(names))
    if device == "cuda":
        for argument, value in (("compiler", compiler), ("flags", flags), ("cache", cache)):
            if value is not None:
                raise of_argument(ArgumentError, argument, f"found {value!r} with device='cuda', whose compiler is NVRTC; expected None")
        return compile_for_cuda(scene, known, dtype)
    command = compiler or os.environ.get("CC") or "cc"
    found = shutil.which(command)
    if found is None:
        raise of_argument(ArgumentError, "compiler", f"found no {command}; expected a C compiler (GCC or Clang): install one, or name it")
    kept: Literal["auto", "covariance"] = form or ("auto" if dtype == "float64" else "covariance")
    written = tuple(WATCHED.get(str(name), name) for name in known) if kept == "auto" else known
    files = scene.to_c(name="robot", functions=written, dtype=dtype, batches=True)
    own = ("-mcpu=native",) if platform.machine() in ("aarch64", "arm64") else ("-march=native",)
    told = [*ALWAYS, *(("-O3", *own) if flags is None else flags)]
    into = (_caches() if cache is None else Path(cache)) / _key(files, found, told)
    library = into / "robot.so"
    if not library.exists():
        if (operations := files["robot.c"].count("\n    const lanes ")) > LONG:
            message = f"functions: found {operations} operations in all, which a compiler takes about {operations * SECONDS_EACH:.0f} s for; expected fewer functions, or some patience"
            warnings.warn(message, LongCodeWarning, stacklevel=2)
        _build(files, [found, *told], library)
    return Compiled(scene, known, library, kept, dtype)


def _caches() -> Path:
    """Where the user's caches are."""
    there = os.environ.get("XDG_CACHE_HOME")
    return (Path(there) if there else Path.home() / ".cache") / "phipsi" / "compiled"


def _key(files: dict[str, str], compiler: str, flags: list[str]) -> str:
    """What the machine code depends on, as a name."""
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True, check=False).stdout
    parts = [files["robot.c"], files["robot.h"], compiler, version, *flags, platform.machine(), _processor()]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]


def _processor() -> str:
    """What this processor can do, for code that is made for it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith(("flags", "Features"))), platform.processor())


def _build(files: dict[str, str], command: list[str], library: Path) -> None:
    """Compiles in a directory of its own; whoever is first leaves the library for all."""
    library.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=library.parent) as directory:
        for name in ("robot.c", "robot.h"):
            (Path(directory) / name).write_text(files[name], encoding="utf-8")
        done = subprocess.run([*command, "robot.c", "-lm", "-o", "robot.so"], cwd=directory, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            said = done.stderr.strip()[-500:]
            raise of_argument(ArgumentError, "compiler", f"found that {command[0]} failed: {said}; expected GCC or Clang with flags that it knows")
        os.replace(Path(directory) / "robot.so", library)
