"""One robot as machine code of its own, by the system's C compiler."""

from __future__ import annotations

import ctypes
import hashlib
import logging
import math
import os
import pickle
import platform
import shlex
import shutil
import signal
import stat
import subprocess
import tempfile
import time
import warnings
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import cache as cached
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

from . import _xla
from ._arguments import names_of
from ._batches import Batches, Entry, entry
from ._cuda import CompiledForCuda, compile_for_cuda
from ._functions import ARGUMENTS, COMPILED, IN_FORM, THROUGH_CONNECTIONS, Function, Functions, functions_of, method_of, parts, row_count, rows_of, said, shapes, symbol
from ._results import ConstrainedDynamics, by_connection
from .errors import ArgumentError, CacheWarning, ConstraintError, LinkageWarning, LongCodeWarning, of_argument, warn

if TYPE_CHECKING:
    from ._core import Scene
    from ._functions import _Errors

__all__ = ["Compiled", "compile"]

_LOGGER = logging.getLogger("phipsi")
_Array: TypeAlias = NDArray[Any]
#: Flags for every compiler. Functions of one state are not used here, and would take half of the compilation time.
ALWAYS = ("-std=c99", "-ffp-contract=fast", "-fno-math-errno", "-shared", "-fPIC", "-DROBOT_BATCHES_ALONE")
#: Number of operations above which a warning states the time, and the approximate time of a compiler per operation, s.
LONG, SECONDS_EACH = 50_000, 4e-4
#: Functions that are compiled with the margin of their error estimate in form "auto".
WATCHED: dict[str, Any] = {name: row["watched"] for name, row in COMPILED.items() if row["watched"]}
#: The other functions with a form have no margin of their own: the margin of the factor of M, which they all use, is compiled with them.
WATCH, WATCHES = "factor_watched", tuple(name for name in IN_FORM if name not in WATCHED)
#: The functions that phipsi.jax calls.
IN_JAX = (
    "forward_dynamics", "inverse_dynamics", "bias_torque", "mass_matrix", "forward_dynamics_derivatives", "inverse_dynamics_derivatives", "placement", "jacobian",
)  # fmt: skip
#: The number of states below which the call of the scene takes less time.
FEW: dict[str, int] = {name: row["few"] for name, row in COMPILED.items()}
#: Methods of scenes that compute in dtype themselves.
IN_DTYPE = tuple(name for name, row in COMPILED.items() if row["has_dtype"])


class Compiled(Functions[_Array]):
    """Functions of one scene as machine code; batches are vectorized over states and run on the number of threads of set_num_threads.

    Each method takes the arguments of the method of the scene with the same name, except form and dtype, which are those of phipsi.compile, and returns its results to rounding. In form "auto" the scene recomputes
    states whose error estimate exceeds the tolerance; contact_gram uses the estimate of the factor of M, which a function of its own computes first. In form "covariance" a loss of precision is not detected.

    With connections, forward_dynamics and constrained_dynamics factor the rows in a fixed order, in both forms. The scene computes states for which this is not valid: rows depend on each other, a residual exceeds
    rounding, or the state violates the connections. Rows that move no joint are skipped.

    The method of the scene is called for few states, for arguments that are invalid or not contiguous, with errors="nan", and for arguments without compiled code (wrenches, return_info, at, parameters, changes of
    constants). out is as in the method of the scene, with the dtype of the code; results are written to it directly, those of derivatives some states at a time. Methods of functions that were not compiled raise
    ArgumentError.
    """

    library: Path
    """The file of the machine code."""
    form: Literal["auto", "covariance"]
    """The form of forward_dynamics, mass_matrix_inverse, and the derivatives and products of forward dynamics."""
    tolerance: float | None
    """The largest accepted error of form "auto", as in Scene.forward_dynamics."""

    def __init__(
        self,
        scene: Scene,
        functions: tuple[Function, ...],
        library: Path,
        form: Literal["auto", "covariance"],
        dtype: str,
        tolerance: float | None = None,
        jax: bool = False,
    ) -> None:
        super().__init__(scene, functions, dtype)
        self.library, self.form, self.tolerance = library, form, tolerance
        #: The options of the call of compile, for pickling.
        self._options: dict[str, Any] = {"form": form, "dtype": dtype, "tolerance": tolerance}
        self._is_rounded = self.dtype != np.float64
        _check_owner(library)
        code = ctypes.CDLL(str(library))
        self._rows = rows_of(scene)
        self._rigid = np.zeros(row_count(scene))
        self._code = {parts(function): self._batches(code, function) for function in functions}
        self._keywords = {parts(function): self._fixed(parts(function)) for function in functions}
        #: The operations of XLA, for phipsi.jax; None if they were not compiled.
        self._operations = None
        if jax:
            operations = _operations(scene, functions, self.form).items()
            self._operations = {of: _xla.registered(code, library, operation, self.dtype) for of, operation in operations}

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles the scene and the options; unpickling compiles again, or loads from the cache."""
        return _compiled, (self.scene, self.functions, self._options)

    def _fixed(self, function: tuple[str, ...]) -> dict[str, Any]:
        """Arguments of the scene's method that were chosen when it was compiled."""
        name, of = function[0], function[1:]
        form: dict[str, Any] = {"form": self.form} if name in IN_FORM and self.form != "auto" else {}
        if name in IN_FORM and self.tolerance is not None:
            form = {"tolerance": self.tolerance}
        dtype = {"dtype": self.dtype} if name in IN_DTYPE and self.dtype != np.float64 else {}
        return {**form, **dtype, **({"frame": of[1]} if len(of) > 1 else {})}

    def _batches(self, code: ctypes.CDLL, function: Function) -> Batches:
        """One function of the library."""
        of = parts(function)
        name, known = of[0], _entry(self.scene, function, self.form)
        called = entry(code, known.batch, len(known.reads) + len(known.results) + (known.margin == ""))
        batches = Batches(called, known.reads, known.results, self.dtype, FEW[name])

        def again(*states: _Array) -> Any:
            if name != "constrained_dynamics":
                return method_of(self.scene, name)(*states, **self._fixed(of))
            *state, compliance = states
            found = self.scene.loops.dynamics(*state, compliance=compliance if compliance.any() else None, **self._fixed(of))
            return found.qdd, np.concatenate([*found.forces.values()], axis=-1), found.rank, found.residual

        if known.margin is not None:
            batches.watched(again, entry(code, known.margin, 2) if known.margin else None)
        return batches

    def _run(
        self, function: tuple[str, ...], given: tuple[Any, ...], out: _Array | None = None, errors: _Errors = "raise", more: dict[str, Any] | None = None
    ) -> Any:
        code = self._code.get(function)
        if code is None:
            raise self._missing(function)
        if more is None and isinstance(errors, str) and errors in ("raise", "nan"):
            found = code(given, out)
            if found is not None:
                return found
            if out is None and errors == "raise" and not self._is_rounded:
                # The short way: a state at a time is what most calls are of.
                return method_of(self.scene, function[0])(*given, *function[1:2], **self._keywords[function])
        return self._by_scene(function, given, out, errors, more)

    def _through_connections(self, state: tuple[Any, ...], compliance: Any, wrenches: Any, errors: _Errors) -> ConstrainedDynamics:
        code = self._code.get(("constrained_dynamics",))
        if code is None:
            raise self._missing(("constrained_dynamics",))
        if wrenches is None and isinstance(errors, str) and errors in ("raise", "nan"):
            found = code((*state, self._rigid if compliance is None else compliance))
            if found is not None:
                vector, forces, rank, residual = found
                return ConstrainedDynamics(*by_connection(vector, forces, rank, residual, self._rows))
        return self.scene.loops.dynamics(*state, compliance=compliance, wrenches=wrenches, errors=errors, **self._keywords[("constrained_dynamics",)])

    def _several_placements(self, q: Any, links: tuple[str, ...], errors: _Errors) -> Any:
        functions = [("placement", link) for link in links]
        for function in functions:
            if function not in self._code:
                raise self._missing(function)
        found = [self._code[function]((q,)) for function in functions]
        if not found or errors not in ("raise", "nan") or any(part is None for part in found):
            return _in_dtype(self.scene.placement(q, links, errors=errors), self.dtype)
        return np.stack(found, axis=-3)

    def _by_scene(self, function: tuple[str, ...], given: tuple[Any, ...], out: _Array | None, errors: _Errors, more: dict[str, Any] | None) -> Any:
        """Result of the method of the scene, whose errors are complete."""
        name, keywords = function[0], self._keywords[function]
        rounds = self._is_rounded and "dtype" not in keywords
        keywords = {**keywords, **(more or {}), "errors": errors}
        if out is not None and not rounds:
            keywords["out"] = out
        found = method_of(self.scene, name)(*given, *function[1:2], **keywords)
        if rounds:
            found = _in_dtype(found, self.dtype)
            if out is not None:
                return _rounded_into(out, found, given)
        return found


def _in_dtype(found: Any, dtype: np.dtype[Any]) -> Any:
    """Results of the scene as numbers of this kind."""
    if isinstance(found, dict):
        return {name: _in_dtype(value, dtype) for name, value in found.items()}
    if isinstance(found, tuple):
        return type(found)(*(_in_dtype(value, dtype) for value in found))
    return found if found is None else found.astype(dtype, copy=False)


def _rounded_into(out: Any, found: Any, given: tuple[Any, ...]) -> Any:
    """Derivatives of the scene, which are float64, in an out of other numbers: views of it."""
    expected = (*found[0].shape[:-2], len(found), *found[0].shape[-2:])
    of_others = any(isinstance(value, np.ndarray) and isinstance(out, np.ndarray) and np.may_share_memory(out, value) for value in given)
    if not isinstance(out, np.ndarray) or out.dtype != found[0].dtype or out.shape != expected or not out.flags.carray or of_others:
        said = f"{out.dtype} of shape {out.shape}" if isinstance(out, np.ndarray) else f"an object of type {type(out).__name__}"
        raise of_argument(ArgumentError, "out", f"found {said}; expected a C-contiguous {found[0].dtype} array of shape {expected}, writable, that overlaps no argument")
    for at, part in enumerate(found):
        out[..., at, :, :] = part
    return type(found)(*(out[..., at, :, :] for at in range(len(found))))


@overload
def compile(
    scene: Scene,
    functions: Iterable[Function] | None = None,
    *,
    device: Literal["cpu"] = "cpu",
    form: Literal["auto", "covariance"] | None = None,
    tolerance: float | None = None,
    dtype: Literal["float64", "float32"] = "float64",
    compiler: str | None = None,
    flags: Sequence[str] | None = None,
    cache: str | os.PathLike[str] | None = None,
    jax: bool = False,
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
    tolerance: float | None = None,
    dtype: Literal["float64", "float32"] = "float64",
    compiler: str | None = None,
    flags: Sequence[str] | None = None,
    cache: str | os.PathLike[str] | None = None,
    jax: bool = False,
) -> Compiled | CompiledForCuda:
    """Compile functions of one scene to machine code by the C compiler of the system, or to CUDA kernels.

    Parameters
    ----------
    scene : Scene
        The scene; its constants are folded into the code. For other inertias, compile
        scene.with_inertial_parameters(inertias).
    functions : str, or iterable of str or tuple, optional
        Names of functions as in Scene.to_c, and functions of one link: ("placement", link), ("jacobian", link) or ("jacobian", link, frame). None: all with code for the scene that are not of a link.
    device : {"cpu", "cuda"}, default "cpu"
        "cuda" compiles scene.to_cuda with NVRTC; it needs CuPy (phipsi[cuda]) and a GPU.
    form : {"auto", "covariance"}, optional
        "auto": the scene recomputes states whose error estimate exceeds the tolerance. "covariance": no error estimate, which takes less time. None: "auto" for float64 on the CPU, else "covariance".
    tolerance : float, optional
        Largest accepted relative error of form "auto"; see Scene.forward_dynamics.
    dtype : {"float64", "float32"}, default "float64"
        Type of the code and of the results. On the CPU, float64 arguments are rounded to it.
    compiler : str, optional
        Command of the compiler, with arguments if needed ("ccache gcc"). None: the environment variable CC, else cc.
    flags : sequence of str, optional
        Flags of optimization and of the processor. None: -O3 for this processor.
    cache : path, optional
        Directory of compiled libraries, by scene, compiler and flags. None: phipsi/compiled in the cache directory of the user.
    jax : bool, default False
        True: also as operations of XLA, so that functions of phipsi.jax with the result in place of the scene run without Python; needs JAX 0.5 or later.

    Returns
    -------
    compiled : Compiled or CompiledForCuda
        An object with the methods of the scene of the same names.

    Raises
    ------
    ArgumentError
        No compiler or no GPU, a compiler that fails, unknown functions, and scenes that Scene.to_c refuses.
    ImportError
        No CuPy with device="cuda".

    Warns
    -----
    LinkageWarning
        Connections whose rows depend on each other, for which the scene computes all states.
    LongCodeWarning
        Code that takes the compiler long, such as the derivatives of a humanoid.
    CacheWarning
        A cache that cannot be written; a temporary directory replaces it.

    Notes
    -----
    The CPU code is scene.to_c(batches=True), vectorized over states (SIMD). Form "auto" takes more time (docs/measured/compiled-times.md). With connections, states are checked in both forms, and the scene
    computes those whose rows depend on each other. A library in the cache that cannot be loaded is compiled again. compiler, flags and cache apply to device="cpu".

    Examples
    --------
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    >>> fast = phipsi.compile(scene, ["inverse_dynamics"])  # doctest: +SKIP
    >>> still = np.zeros(scene.nv)
    >>> np.allclose(fast.inverse_dynamics(scene.neutral(), still, still), scene.gravity_torque(scene.neutral()))  # doctest: +SKIP
    True
    """
    if device not in ("cpu", "cuda"):
        raise of_argument(ArgumentError, "device", f"found {device!r}; expected 'cpu' or 'cuda'")
    if form not in (None, "auto", "covariance"):
        raise of_argument(ArgumentError, "form", f"found {form!r}; expected 'auto' or 'covariance'")
    if form == "auto" and (device == "cuda" or dtype != "float64"):
        raise of_argument(ArgumentError, "form", f"found 'auto' with device={device!r} and dtype={dtype!r}; expected 'covariance': errors are estimated in float64 on the CPU only")
    if tolerance is not None and (form == "covariance" or device == "cuda" or dtype != "float64"):
        raise of_argument(ArgumentError, "tolerance", f"found {tolerance!r} with form 'covariance', which takes its result as it is; expected form='auto' (of float64, on the CPU), or no tolerance")
    names = None if functions is None else names_of(functions)
    known = functions_of(scene) if names is None else tuple(dict.fromkeys(names))
    through = [name for name in known if name in THROUGH_CONNECTIONS] if scene.loops.names else []
    if through and dtype != "float64":
        found = f"{dtype!r} for {through[0]} with connections ({', '.join(scene.loops.names[:8])}), whose states cannot be checked in it"
        raise of_argument(ArgumentError, "dtype", f"found {found}; expected 'float64', or other functions")
    if through and device == "cuda":
        found = f"{through[0]} with connections ({', '.join(scene.loops.names[:8])}), whose states are not checked on a GPU"
        raise of_argument(ArgumentError, "functions", f"found {found}; expected other functions, or device='cpu'")
    if through and (dependent := _dependent(scene)):
        message = f"functions: found {dependent} in {through[0]}; expected independent rows: the scene computes all states, so that compiled code takes more time"
        warn(message, LinkageWarning)
    if device == "cuda":
        for argument, value in (("compiler", compiler), ("flags", flags), ("cache", cache), ("jax", jax or None)):
            if value is not None:
                raise of_argument(ArgumentError, argument, f"found {value!r} with device='cuda', whose compiler is NVRTC; expected None")
        return compile_for_cuda(scene, known, dtype)
    command = _command(compiler or os.environ.get("CC") or "cc")
    kept: Literal["auto", "covariance"] = form or ("auto" if dtype == "float64" else "covariance")
    written = _written(known, WATCHED if kept == "auto" else {name: WATCHED[name] for name in through})
    judged = any(name in (*WATCHED.values(), WATCH) for name in written)
    accepted = tolerance if kept == "auto" else math.inf
    files = scene.to_c(name="robot", functions=written, dtype=dtype, batches=True, tolerance=accepted if judged else None)
    own = ("-mcpu=native",) if platform.machine() in ("aarch64", "arm64") else ("-march=native",)
    told = [*ALWAYS, *(("-O3", *own) if flags is None else flags)]
    if jax:
        files["robot.c"] += _xla.source([*_operations(scene, known, kept).values()], dtype)
        told += _xla.flags()
    key = _key(files, command, told)
    into = _writable((_caches() if cache is None else Path(cache)) / key)
    library = into / "robot.so"
    made = None
    if _is_whole(library):
        with suppress(OSError):
            made = Compiled(scene, known, library, kept, dtype, tolerance, jax)
    if made is None:
        if (operations := files["robot.c"].count("\n    const lanes ")) > LONG:
            message = f"functions: found {operations} operations in all, which a compiler takes about {operations * SECONDS_EACH:.0f} s for; expected fewer functions, or some patience"
            warn(message, LongCodeWarning)
        _build(files, [*command, *told], library)
        made = Compiled(scene, known, library, kept, dtype, tolerance, jax)
    made._options |= {"compiler": compiler, "flags": None if flags is None else list(flags), "cache": cache, "jax": jax}
    return made


def _entry(scene: Scene, function: Function, form: str) -> Entry:
    """Arguments, results and margin of a compiled function."""
    of = parts(function)
    name, reads = of[0], [scene.nq, *[scene.nv] * (len(ARGUMENTS[of[0]]) - 1)]
    if name == "constrained_dynamics":
        reads[-1] = row_count(scene)
    tells = name in WATCHED and (form == "auto" or (name in THROUGH_CONNECTIONS and bool(scene.loops.names)))
    margin = "" if tells else f"robot_{WATCH}_batch" if form == "auto" and name in WATCHES else None
    return Entry(said([of]), f"robot_{WATCHED[name] if tells else symbol(function)}_batch", tuple(reads), tuple(shapes(of, scene)), margin)


def _operations(scene: Scene, functions: tuple[Function, ...], form: str) -> dict[tuple[str, ...], Entry]:
    """The functions that are operations of XLA too."""
    return {parts(function): _entry(scene, function, form) for function in functions if parts(function)[0] in IN_JAX}


def _dependent(scene: Scene) -> str | None:
    """A description of rows that depend on each other in each of several configurations, besides rows that move no joint."""
    steps = np.random.default_rng(0).uniform(-0.1, 0.1, (3, scene.nv))
    # A scene warns once, and not of these configurations.
    other: Scene = pickle.loads(pickle.dumps(scene))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LinkageWarning)
            closed = other.loops.project(scene.integrate(scene.neutral(), steps))
    except ConstraintError:
        # No configuration is known, so neither is the rank.
        return None
    rows = np.abs(other.loops.jacobian(closed.q)).max(axis=-1)
    moving = np.count_nonzero(rows > 1e-9 * rows.max(), axis=-1)
    if not np.all(closed.rank < moving):
        return None
    return f"connections of rank {np.max(closed.rank)} with {np.max(moving)} rows that move joints"


def _compiled(scene: Scene, functions: tuple[Function, ...], options: dict[str, Any]) -> Compiled:
    """Reconstruct from a pickle."""
    made: Compiled = compile(scene, functions, **options)
    return made


def _command(command: str) -> list[str]:
    """A compiler's command as a list: a path, spaces and all, or a program with its arguments."""
    try:
        parts = [command] if shutil.which(command) else shlex.split(command)
    except ValueError as error:
        raise of_argument(ArgumentError, "compiler", f"found {command!r}, which is no command ({error}); expected a C compiler (GCC or Clang)") from None
    found = shutil.which(parts[0]) if parts else None
    if found is None:
        raise of_argument(ArgumentError, "compiler", f"found no {command}; expected a C compiler (GCC or Clang): install one, or name it")
    return [found, *parts[1:]]


def _writable(directory: Path) -> Path:
    """The directory, made if it was not there; or one of the same name in a temporary cache, until this process ends."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        if not _is_whole(directory / "robot.so"):
            tempfile.TemporaryFile(dir=directory).close()
        return directory
    except OSError as error:
        why = f"found {str(directory.parent)!r}, which cannot be written ({error.strerror})"
        message = f"cache: {why}; the library is built in a temporary directory of this process; expected a directory of your own"
        warn(message, CacheWarning)
        into = Path(_temporary().name) / directory.name
        into.mkdir(exist_ok=True)
        return into


@cached
def _temporary() -> tempfile.TemporaryDirectory[str]:
    """A cache that is removed when this process ends."""
    return tempfile.TemporaryDirectory(prefix="phipsi-")


def _written(functions: tuple[Function, ...], watched: dict[str, Any]) -> tuple[Any, ...]:
    """Functions in the code: those with an error estimate include its margin; form "auto" also needs the margin of the factor."""
    watches = [WATCH] if watched is WATCHED and any(name in WATCHES for name in functions) else []
    return tuple(dict.fromkeys([*(watched.get(str(name), name) for name in functions), *watches]))


def _caches() -> Path:
    """Where the user's caches are. A relative XDG_CACHE_HOME is ignored, as its specification says: it would be another directory from each working directory."""
    there = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (there if there.is_absolute() else Path.home() / ".cache") / "phipsi" / "compiled"


def _check_owner(library: Path) -> None:
    """Refuses a library that another user can have written: loading it runs its code, and its name can be foretold.

    The file, its directory and the cache must be this user's or root's, and writable for no others; a cache may be a directory for all where each deletes only what is its own (/tmp).
    """
    if os.name != "posix":
        return
    library = library.resolve()
    for path in (library, library.parent, library.parent.parent):
        status = path.stat()
        shared = bool(status.st_mode & 0o002) or (bool(status.st_mode & 0o020) and not _is_alone_in(status.st_gid))
        if path.is_dir() and status.st_mode & stat.S_ISVTX:
            shared = False
        if status.st_uid in (os.geteuid(), 0) and not shared:
            continue
        found = f"{str(path)!r} of user {status.st_uid}, {stat.filemode(status.st_mode)}"
        expected = f"a file in directories that only user {os.geteuid()} can write: name another cache, or take these rights away (chmod go-w)"
        raise of_argument(ArgumentError, "cache", f"found {found}, so that another user can have written the library; expected {expected}")


def _is_alone_in(group: int) -> bool:
    """Whether a group is this user's own, as many systems make one for each user."""
    import grp
    import pwd

    try:
        name, found = pwd.getpwuid(os.geteuid()).pw_name, grp.getgrgid(group)
    except KeyError:
        return False
    return found.gr_name == name and set(found.gr_mem) <= {name}


def _key(files: dict[str, str], compiler: list[str], flags: list[str]) -> str:
    """Name of a library: a hash of everything on which its machine code depends."""
    version = _run([*compiler, "--version"]).stdout
    parts = [files["robot.c"], files["robot.h"], *compiler, version, *flags, platform.machine(), _processor()]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]


def _processor() -> str:
    """Instruction sets of this processor, for which code is compiled."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith(("flags", "Features"))), platform.processor())


def _build(files: dict[str, str], command: list[str], library: Path) -> None:
    """Compiles in a temporary directory; the first process to finish stores the library."""
    with tempfile.TemporaryDirectory(dir=library.parent) as directory:
        for name in ("robot.c", "robot.h"):
            (Path(directory) / name).write_text(files[name], encoding="utf-8")
        _LOGGER.info("compiling %d lines of C with %s", files["robot.c"].count("\n"), command[0])
        began = time.monotonic()
        done = _run([*command, "robot.c", "-lm", "-o", "robot.so"], directory)
        made = Path(directory) / "robot.so"
        if done.returncode != 0 or not made.is_file():
            said = done.stderr.strip()[-500:] or f"exit code {done.returncode}, and no library"
            raise of_argument(ArgumentError, "compiler", f"found that {command[0]} failed: {said}; expected GCC or Clang with flags that it knows")
        _LOGGER.info("compiled in %.1f s: %s", time.monotonic() - began, library)
        digest = Path(directory) / "digest"
        digest.write_text(_digest(made), encoding="utf-8")
        os.replace(made, library)
        os.replace(digest, library.with_suffix(".sha256"))


def _digest(library: Path) -> str:
    """Hash of a library."""
    return hashlib.sha256(library.read_bytes()).hexdigest()


def _is_whole(library: Path) -> bool:
    """Whether a library is there as it was built. One that was cut off, on a full disk for instance, would end the process that loads it."""
    try:
        return _digest(library) == library.with_suffix(".sha256").read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False


def _run(command: list[str], directory: str | None = None) -> subprocess.CompletedProcess[str]:
    """Runs a compiler, with its temporary files in the directory. Where this is interrupted all of its processes are ended."""
    environment = None if directory is None else {**os.environ, "TMPDIR": directory}
    pipe: Any = subprocess.PIPE
    try:
        # In a group of its own: the command is a driver, which starts others.
        process = subprocess.Popen(command, cwd=directory, stdout=pipe, stderr=pipe, text=True, errors="replace", env=environment, start_new_session=True)
    except OSError as error:
        raise of_argument(ArgumentError, "compiler", f"found that {command[0]} cannot be run ({error.strerror}); expected GCC or Clang") from None
    with process:
        try:
            out, err = process.communicate()
        except BaseException:
            with suppress(ProcessLookupError):
                if hasattr(os, "killpg"):
                    os.killpg(process.pid, signal.SIGKILL)
                else:
                    process.kill()
            process.wait()
            raise
    return subprocess.CompletedProcess(command, process.returncode, out, err)
