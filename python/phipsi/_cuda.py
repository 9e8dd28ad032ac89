"""Functions of one robot as CUDA kernels, compiled at run time by NVRTC through CuPy."""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

from ._functions import ARGUMENTS, Function, Functions, parts, shapes, symbol
from ._install import command
from .errors import ArgumentError, ShapeError, of_argument

if TYPE_CHECKING:
    from ._core import Scene
    from ._functions import _Errors

__all__ = ["CompiledForCuda", "compile_for_cuda"]

#: Options of NVRTC.
OPTIONS = ("--std=c++17",)
#: Threads per block; a thread of a long kernel uses most of the available registers.
THREADS = 64
#: Device types of DLPack that a CUDA GPU can read: device memory and managed memory.
ON_GPU = (2, 13)


class CompiledForCuda(Functions[Any]):
    """Functions of one scene as CUDA kernels with one state per thread; returned by phipsi.compile(device="cuda").

    Each method takes arrays on the GPU, (..., nq) and (..., nv), whose leading axes broadcast: of CuPy,
    PyTorch, JAX or another library that supports DLPack, with the compiled dtype. Results are CuPy arrays, and
    equal those of the scene's method of the same name with form "covariance" up to rounding.

    The kernels do not estimate the loss of precision and do not check the states: input that is not finite
    gives NaN. Work is queued on the current stream of CuPy. The arguments out, errors="nan", wrenches and other
    options of the scene's methods raise ArgumentError. The kernels read each component of all states
    contiguously; arrays with this memory layout, such as results, are not copied.

    Examples
    --------
    >>> import cupy, phipsi  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> fast = phipsi.compile(scene, functions=("forward_dynamics",), device="cuda")  # doctest: +SKIP
    >>> fast.forward_dynamics(*(cupy.zeros((1000, 6)) for _ in range(3))).shape  # doctest: +SKIP
    (1000, 6)
    """

    source: str
    """CUDA C++ source of the kernels."""

    def __init__(self, scene: Scene, functions: tuple[Function, ...], dtype: str, source: str, cupy: Any) -> None:
        super().__init__(scene, functions, dtype)
        self.source, self._numpy = source, cupy
        module = cupy.RawModule(code=source, options=OPTIONS)
        self._kernels = {parts(function): module.get_function(f"robot_{symbol(function)}") for function in functions}

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the scene and the options; unpickling compiles again."""
        return compile_for_cuda, (self.scene, self.functions, self.dtype.name)

    def _run(self, function: tuple[str, ...], given: tuple[Any, ...], out: Any = None, errors: _Errors = "raise", more: dict[str, Any] | None = None) -> Any:
        kernel, cupy = self._kernels.get(function), self._numpy
        if kernel is None:
            raise self._missing(function)
        _refuse({"out": out, "errors": None if errors == "raise" else errors, **(more or {})}, function[0])
        arrays = {name: self._array(name, value) for name, value in zip(ARGUMENTS[function[0]], given, strict=True)}
        for name, array in arrays.items():
            width = self.scene.nq if name == "q" else self.scene.nv
            if array.ndim == 0 or array.shape[-1] != width:
                raise of_argument(ShapeError, name, f"found shape {array.shape}; expected (..., {width})")
        try:
            batch = np.broadcast_shapes(*(array.shape[:-1] for array in arrays.values()))
        except ValueError:
            those = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
            raise of_argument(ShapeError, "q", f"found leading axes that do not broadcast: {those}; expected leading axes of one batch") from None
        parts_of_one = shapes(function, self.scene)
        count, widths = prod(batch), [prod(shape) for shape in parts_of_one]
        with arrays["q"].device:
            columns = [_by_components(cupy, array, batch, count) for array in arrays.values()]
            results = [cupy.empty((width, count), dtype=self.dtype) for width in widths]
            if count and any(widths):
                kernel(((count + THREADS - 1) // THREADS,), (THREADS,), (np.uint64(count), *columns, *results))
        found = [result.T.reshape(*batch, *shape) for result, shape in zip(results, parts_of_one, strict=True)]
        return found if len(found) > 1 else found[0]

    def _array(self, name: str, value: Any) -> Any:
        """The argument as an array of CuPy that shares its memory."""
        if not isinstance(value, self._numpy.ndarray):
            where = value.__dlpack_device__()[0] if hasattr(value, "__dlpack_device__") else None
            if where not in ON_GPU:
                found = f"{type(value).__name__} that is not on a GPU"
                raise of_argument(ArgumentError, name, f"found {found}; expected an array on the GPU: use cupy.asarray({name})")
            value = self._numpy.from_dlpack(value)
        if value.dtype != self.dtype:
            raise of_argument(ArgumentError, name, f"found {value.dtype}; expected the compiled dtype {self.dtype}: convert the array, or compile with dtype={str(value.dtype)!r}")
        return value


def _refuse(more: dict[str, Any], function: str) -> None:
    """Refuse arguments of the scene's method that the kernels do not support."""
    for name, value in more.items():
        if value is not None and value is not False:
            found = repr(value) if isinstance(value, (str, bool)) else f"an object of type {type(value).__name__}"
            raise of_argument(ArgumentError, name, f"found {found}; expected no {name}, which kernels on a GPU do not support: use scene.{function}")


def _by_components(cupy: Any, array: Any, batch: tuple[int, ...], count: int) -> Any:
    """Array (width, states), with each component of all states contiguous."""
    width = array.shape[-1]
    return cupy.ascontiguousarray(cupy.broadcast_to(array, (*batch, width)).reshape(count, width).T)


def compile_for_cuda(scene: Scene, functions: tuple[Function, ...], dtype: str) -> CompiledForCuda:
    """Implementation of phipsi.compile(device="cuda")."""
    try:
        import cupy
    except ImportError as error:
        text = f"phipsi.compile(device='cuda') needs CuPy; install it with: {command('cuda')}; or use device='cpu'"
        raise ImportError(text) from error
    source = scene.to_cuda(name="robot", functions=functions, dtype=dtype)["robot.cu"]  # type: ignore[arg-type]
    try:
        found = cupy.cuda.runtime.getDeviceCount()
    except cupy.cuda.runtime.CUDARuntimeError as error:
        raise of_argument(ArgumentError, "device", f"found no GPU ({error}); expected a GPU with its driver: use device='cpu'") from error
    if found == 0:
        raise of_argument(ArgumentError, "device", "found no GPU; expected one: use device='cpu'")
    return CompiledForCuda(scene, functions, dtype, source, cupy)
