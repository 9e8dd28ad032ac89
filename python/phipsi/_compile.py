"""One robot as machine code of its own, by the system's C compiler."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import re
import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import accumulate
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._core import _unwritten, get_num_threads
from ._results import (
    ForwardDynamicsDerivatives,
    ForwardDynamicsGradients,
    InverseDynamicsDerivatives,
    InverseDynamicsGradients,
)
from .errors import ArgumentError, LongCodeWarning, of_argument

if TYPE_CHECKING:
    from ._core import Scene

__all__ = ["Compiled", "compile"]

_Array: TypeAlias = NDArray[np.float64]
_Results = TypeVar("_Results")
_OfScene = Literal[
    "forward_dynamics",
    "inverse_dynamics",
    "bias_torque",
    "mass_matrix",
    "mass_matrix_inverse",
    "forward_dynamics_derivatives",
    "inverse_dynamics_derivatives",
    "forward_dynamics_jvp",
    "forward_dynamics_vjp",
    "inverse_dynamics_jvp",
    "inverse_dynamics_vjp",
    "placements",
]
_Frame = Literal["local", "world", "local-world-aligned"]
#: What to_c and compile know: a name, or of one link (name, link) and (name, link, frame).
Function: TypeAlias = (
    _OfScene | tuple[Literal["placement"], str] | tuple[Literal["jacobian"], str] | tuple[Literal["jacobian"], str, _Frame]
)
#: All of them that are of no one link.
FUNCTIONS: tuple[_OfScene, ...] = get_args(_OfScene)
#: Those that the scene does in a form.
IN_FORM = (
    "forward_dynamics",
    "mass_matrix_inverse",
    "forward_dynamics_derivatives",
    "forward_dynamics_jvp",
    "forward_dynamics_vjp",
)

#: What every compiler is told. Functions of one state are not called from here, and would take half the time.
ALWAYS = ("-std=c99", "-ffp-contract=fast", "-fno-math-errno", "-shared", "-fPIC", "-DROBOT_BATCHES_ALONE")
#: So many operations, and roughly how long a compiler takes for each.
LONG, SECONDS_EACH = 50_000, 4e-4
#: Fewer states are faster by the scene's own call, whose way from Python is shorter.
FEW = 16
#: A thread gets so many states at the least.
WORTH_A_THREAD = 2048
#: How far the squared norm of a quaternion may be off.
SLACK = 1e-3


class Compiled:
    """Functions of one scene as machine code that holds nothing else; batches run as many states at once as the processor's registers hold, on as many threads as set_num_threads says.

    Each method takes the arrays of the scene's method of that name and gives its results to rounding, in form "covariance": digits that this loses are not noticed. Few states, and arguments
    or results that are not in order, are done by the scene's own method, which says what is wrong. Methods of functions that were not compiled raise ArgumentError.
    """

    scene: Scene
    """The scene that it was compiled from."""
    functions: tuple[Function, ...]
    """What was compiled."""
    library: Path
    """The file of the machine code."""

    def __init__(self, scene: Scene, functions: tuple[Function, ...], library: Path) -> None:
        self.scene, self.functions, self.library = scene, functions, library
        code = ctypes.CDLL(str(library))
        self._code = {_parts(function): getattr(code, f"robot_{_symbol(function)}_batch") for function in functions}
        self._rates, self._pairs = (scene.nv,), (scene.nv, scene.nv)
        joints = (scene.joints[name] for name in scene.joint_names)
        ends = [scene.q_index(joint.name).stop for joint in joints if joint.type in ("spherical", "floating")]
        self._quaternions = [slice(end - 4, end) for end in ends]

    def __repr__(self) -> str:
        return f"<phipsi.Compiled of {self.scene.nv} degrees of freedom: {_said(self.functions)}>"

    def forward_dynamics(self, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> _Array:
        """Joint accelerations from joint torques, (..., nv), as Scene.forward_dynamics in form "covariance"."""
        return self._one(("forward_dynamics",), (q, qd, tau), self._rates)

    def inverse_dynamics(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> _Array:
        """Joint torques from joint accelerations, (..., nv), as Scene.inverse_dynamics."""
        return self._one(("inverse_dynamics",), (q, qd, qdd), self._rates)

    def bias_torque(self, q: ArrayLike, qd: ArrayLike) -> _Array:
        """The torques that let no joint accelerate, (..., nv), as Scene.bias_torque."""
        return self._one(("bias_torque",), (q, qd), self._rates)

    def mass_matrix(self, q: ArrayLike) -> _Array:
        """The mass matrix, (..., nv, nv), as Scene.mass_matrix."""
        return self._one(("mass_matrix",), (q,), self._pairs)

    def mass_matrix_inverse(self, q: ArrayLike) -> _Array:
        """Its inverse, (..., nv, nv), as Scene.mass_matrix_inverse in form "covariance"."""
        return self._one(("mass_matrix_inverse",), (q,), self._pairs)

    def forward_dynamics_derivatives(self, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> ForwardDynamicsDerivatives:
        """dqdd_dq, dqdd_dqd and Minv, (..., nv, nv) each, as Scene.forward_dynamics_derivatives in form "covariance"."""
        return self._several(("forward_dynamics_derivatives",), (q, qd, tau), 3 * [self._pairs], ForwardDynamicsDerivatives)

    def inverse_dynamics_derivatives(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> InverseDynamicsDerivatives:
        """dtau_dq, dtau_dqd and M, (..., nv, nv) each, as Scene.inverse_dynamics_derivatives."""
        return self._several(("inverse_dynamics_derivatives",), (q, qd, qdd), 3 * [self._pairs], InverseDynamicsDerivatives)

    def forward_dynamics_jvp(self, q: ArrayLike, qd: ArrayLike, tau: ArrayLike, dq: ArrayLike, dqd: ArrayLike, dtau: ArrayLike) -> _Array:
        """The change of joint accelerations along (dq, dqd, dtau), (..., nv), as Scene.forward_dynamics_jvp in form "covariance"."""
        return self._one(("forward_dynamics_jvp",), (q, qd, tau, dq, dqd, dtau), self._rates)

    def forward_dynamics_vjp(self, q: ArrayLike, qd: ArrayLike, tau: ArrayLike, cotangent: ArrayLike) -> ForwardDynamicsGradients:
        """The gradients of cotangent . qdd by q, qd and tau, (..., nv) each, as Scene.forward_dynamics_vjp in form "covariance"."""
        return self._several(("forward_dynamics_vjp",), (q, qd, tau, cotangent), 3 * [self._rates], ForwardDynamicsGradients)

    def inverse_dynamics_jvp(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, dq: ArrayLike, dqd: ArrayLike, dqdd: ArrayLike) -> _Array:
        """The change of joint torques along (dq, dqd, dqdd), (..., nv), as Scene.inverse_dynamics_jvp."""
        return self._one(("inverse_dynamics_jvp",), (q, qd, qdd, dq, dqd, dqdd), self._rates)

    def inverse_dynamics_vjp(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike, cotangent: ArrayLike) -> InverseDynamicsGradients:
        """The gradients of cotangent . tau by q, qd and qdd, (..., nv) each, as Scene.inverse_dynamics_vjp."""
        return self._several(("inverse_dynamics_vjp",), (q, qd, qdd, cotangent), 3 * [self._rates], InverseDynamicsGradients)

    def placements(self, q: ArrayLike) -> dict[str, _Array]:
        """Where every link is, a dict from link names to homogeneous matrices (..., 4, 4), as Scene.placements."""
        links = self.scene.link_names
        all_links = self._run(("placements",), (q,), [(len(links), 4, 4)])
        if all_links is None:
            return self.scene.placements(q)
        return {link: np.ascontiguousarray(all_links[0][..., at, :, :]) for at, link in enumerate(links)}

    def placement(self, q: ArrayLike, link: str | Iterable[str]) -> _Array:
        """Where a link is, or several, homogeneous matrices (..., 4, 4) or (..., L, 4, 4), as Scene.placement: each that was compiled as ("placement", link)."""
        if isinstance(link, str):
            return self._one(("placement", link), (q,), (4, 4))
        names = tuple(link)
        return np.stack([self._one(("placement", name), (q,), (4, 4)) for name in names], axis=-3) if names else self.scene.placement(q, names)

    def jacobian(self, q: ArrayLike, link: str, *, frame: _Frame = "local") -> _Array:
        """The Jacobian of a link, (..., 6, nv), as Scene.jacobian: of a link and a frame that were compiled as ("jacobian", link, frame)."""
        return self._one(("jacobian", link, frame), (q,), (6, self.scene.nv))

    def _one(self, function: tuple[str, ...], given: tuple[ArrayLike, ...], shape: tuple[int, ...]) -> _Array:
        """A function of one result."""
        found = self._run(function, given, [shape])
        return self._by_scene(function, given) if found is None else found[0]

    def _several(self, function: tuple[str, ...], given: tuple[ArrayLike, ...], shapes: Sequence[tuple[int, ...]], kind: Callable[..., _Results]) -> _Results:
        """A function of several results, and what they are put into."""
        found = self._run(function, given, shapes)
        return self._by_scene(function, given) if found is None else kind(*found)

    def _run(self, function: tuple[str, ...], given: tuple[ArrayLike, ...], shapes: Sequence[tuple[int, ...]]) -> list[_Array] | None:
        """The results; None of what the scene is to do."""
        run = self._code.get(function)
        if run is None:
            raise of_argument(ArgumentError, "functions", f"found {_said([function])}, which was not compiled; expected one of {_said(self.functions)}")
        ready = self._ready(given)
        if ready is None:
            return None
        arrays, batch = ready
        count = prod(batch)
        # In one piece: the allocator gives the pages of several back to the system every time, which clears them anew.
        ends = list(accumulate((count * prod(shape) for shape in shapes), initial=0))
        numbers = _unwritten(ends[-1])
        results = [numbers[first:end].reshape(*batch, *shape) for first, end, shape in zip(ends[:-1], ends[1:], shapes, strict=True)]

        def piece(first: int, end: int) -> None:
            addresses = (ctypes.c_void_p(array.ctypes.data + 8 * first * (array.size // count)) for array in (*arrays, *results))
            run(ctypes.c_size_t(end - first), *addresses)

        threads = min(get_num_threads(), count // WORTH_A_THREAD)
        if threads > 1:
            cuts = [count * i // threads for i in range(threads + 1)]
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(piece, cuts[:-1], cuts[1:]))
        else:
            piece(0, count)
        return results if bool(np.isfinite(numbers).all()) else None

    def _ready(self, given: tuple[ArrayLike, ...]) -> tuple[list[_Array], tuple[int, ...]] | None:
        """Arrays of all states, one after another, and the leading axes; None of what the scene is to look at."""
        scene = self.scene
        widths = [scene.nq, *[scene.nv] * (len(given) - 1)]
        if not all(isinstance(value, np.ndarray) and value.dtype == np.float64 and value.ndim > 0 for value in given):
            return None
        arrays: list[Any] = list(given)
        if [array.shape[-1] for array in arrays] != widths or scene.nv == 0:
            return None
        shapes = {array.shape[:-1] for array in arrays}
        try:
            batch = shapes.pop() if len(shapes) == 1 else np.broadcast_shapes(*shapes)
        except ValueError:
            return None
        if prod(batch) < FEW or not all(np.isfinite(array).all() for array in arrays):
            return None
        for at in self._quaternions:
            if not bool((np.abs((arrays[0][..., at] ** 2).sum(axis=-1) - 1.0) <= SLACK).all()):
                return None
        if shapes:
            arrays = [np.broadcast_to(array, (*batch, array.shape[-1])) for array in arrays]
        return [np.ascontiguousarray(array) for array in arrays], batch

    def _by_scene(self, function: tuple[str, ...], given: tuple[ArrayLike, ...]) -> Any:
        name, *of = function
        keywords = {"form": "covariance"} if name in IN_FORM else {"frame": of[1]} if len(of) > 1 else {}
        return getattr(self.scene, name)(*given, *of[:1], **keywords)


def _parts(function: Function) -> tuple[str, ...]:
    """The name, and of one link the link and for Jacobians the frame."""
    if isinstance(function, str):
        return (function,)
    return (*function, "local") if len(function) == 2 and function[0] == "jacobian" else tuple(function)


def _symbol(function: Function) -> str:
    """What the code calls it."""
    parts = _parts(function)
    return "_".join(re.sub(r"[^0-9A-Za-z]", "_", part) for part in parts[: 2 if parts[2:] == ("local",) else 3])


def _said(functions: Iterable[Function | tuple[str, ...]]) -> str:
    """In words."""
    return ", ".join(function if isinstance(function, str) else " ".join(function) for function in functions)


def compile(  # noqa: A001  # phipsi.compile
    scene: Scene,
    functions: Iterable[Function] | None = None,
    *,
    compiler: str | None = None,
    flags: Sequence[str] | None = None,
    cache: str | os.PathLike[str] | None = None,
) -> Compiled:
    """Compiles functions of one scene by the system's C compiler: scene.to_c(batches=True) into a library that is loaded at once.

    functions: as of to_c, of one link ("placement", link), ("jacobian", link) or ("jacobian", link, frame); None: all that are of no one link. compiler: its command; None: that of the environment variable CC, or cc. flags: for this processor and of how fast the code is to be; None: -O3 for this
    processor. cache: a directory that keeps libraries by scene, compiler and flags, so that the next call takes no time; None: phipsi/compiled where the user's caches are.

    Warns (LongCodeWarning) before the compiler begins on code that it takes long for, as for the derivatives of a humanoid. Raises ArgumentError where there is no compiler, or it fails, and as to_c.
    """
    command = compiler or os.environ.get("CC") or "cc"
    found = shutil.which(command)
    if found is None:
        raise of_argument(ArgumentError, "compiler", f"found no {command}; expected a C compiler (GCC or Clang): install one, or name it")
    names = None if functions is None else tuple(functions)
    files = scene.to_c(name="robot", functions=names, batches=True)
    own = ("-mcpu=native",) if platform.machine() in ("aarch64", "arm64") else ("-march=native",)
    told = [*ALWAYS, *(("-O3", *own) if flags is None else flags)]
    into = (_caches() if cache is None else Path(cache)) / _key(files, found, told)
    library = into / "robot.so"
    if not library.exists():
        if (operations := files["robot.c"].count("\n    const lanes ")) > LONG:
            message = f"functions: found {operations} operations in all, which a compiler takes about {operations * SECONDS_EACH:.0f} s for; expected fewer functions, or some patience"
            warnings.warn(message, LongCodeWarning, stacklevel=2)
        _build(files, [found, *told], library)
    return Compiled(scene, FUNCTIONS if names is None else tuple(dict.fromkeys(names)), library)


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
