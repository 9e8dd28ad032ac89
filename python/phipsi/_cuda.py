"""One robot as CUDA kernels, compiled at run time by NVRTC through CuPy."""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import ArgumentError, ShapeError, of_argument

if TYPE_CHECKING:
    from ._core import Scene

__all__ = ["CompiledForCuda", "compile_for_cuda"]

#: What NVRTC is told.
OPTIONS = ("--std=c++17",)
#: Threads of a block; of long programs a thread takes most of the registers that it may have.
THREADS = 64
#: Kinds of memory in DLPack that a GPU of CUDA reads: its own, and managed.
ON_GPU = (2, 13)


class CompiledForCuda:
    """Functions of one scene as CUDA kernels, one state a thread; arguments are arrays on the GPU, whatever library made them, results are CuPy arrays.

    Each method takes arrays of CuPy, PyTorch, JAX or of others that DLPack passes on, of the dtype that was compiled, (..., nq) and (..., nv), whose leading axes broadcast. Results are those of the
    scene's method of that name to rounding, in form "covariance": digits that this loses are not noticed, and states are not looked at, so that NaN comes of what is not finite. Work is queued on
    CuPy's current stream. Kernels read each component of all states in a row: arrays whose memory has it so, as results have, are not copied.
    """

    scene: Scene
    """The scene that it was compiled from."""
    functions: tuple[str, ...]
    """What was compiled."""
    dtype: np.dtype[Any]
    """The dtype of arguments and results."""
    source: str
    """The kernels, CUDA C++."""

    def __init__(self, scene: Scene, functions: tuple[str, ...], dtype: str, source: str, cupy: Any) -> None:
        self.scene, self.functions, self.dtype, self.source = scene, functions, np.dtype(dtype), source
        self._cupy = cupy
        module = cupy.RawModule(code=source, options=OPTIONS)
        self._kernels = {function: module.get_function(f"robot_{function}") for function in functions}

    def __repr__(self) -> str:
        return f"<phipsi.CompiledForCuda of {self.scene.nv} degrees of freedom, {self.dtype}: {', '.join(self.functions)}>"

    def forward_dynamics(self, q: Any, qd: Any, tau: Any) -> Any:
        """Joint accelerations from joint torques, (..., nv), as Scene.forward_dynamics in form "covariance"."""
        return self._run("forward_dynamics", {"q": q, "qd": qd, "tau": tau}, (self.scene.nv,))

    def inverse_dynamics(self, q: Any, qd: Any, qdd: Any) -> Any:
        """Joint torques from joint accelerations, (..., nv), as Scene.inverse_dynamics."""
        return self._run("inverse_dynamics", {"q": q, "qd": qd, "qdd": qdd}, (self.scene.nv,))

    def bias_torque(self, q: Any, qd: Any) -> Any:
        """The torques that let no joint accelerate, (..., nv), as Scene.bias_torque."""
        return self._run("bias_torque", {"q": q, "qd": qd}, (self.scene.nv,))

    def mass_matrix(self, q: Any) -> Any:
        """The mass matrix, (..., nv, nv), as Scene.mass_matrix."""
        return self._run("mass_matrix", {"q": q}, (self.scene.nv, self.scene.nv))

    def mass_matrix_inverse(self, q: Any) -> Any:
        """Its inverse, (..., nv, nv), as Scene.mass_matrix_inverse in form "covariance"."""
        return self._run("mass_matrix_inverse", {"q": q}, (self.scene.nv, self.scene.nv))

    def _run(self, function: str, given: dict[str, Any], shape: tuple[int, ...]) -> Any:
        kernel, cupy = self._kernels.get(function), self._cupy
        if kernel is None:
            raise of_argument(ArgumentError, "functions", f"found {function}, which was not compiled; expected one of {', '.join(self.functions)}")
        arrays = {name: self._array(name, value) for name, value in given.items()}
        for name, array in arrays.items():
            width = self.scene.nq if name == "q" else self.scene.nv
            if array.ndim == 0 or array.shape[-1] != width:
                raise of_argument(ShapeError, name, f"found shape {array.shape}; expected (..., {width})")
        try:
            batch = np.broadcast_shapes(*(array.shape[:-1] for array in arrays.values()))
        except ValueError:
            shapes = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
            raise of_argument(ShapeError, "q", f"found leading axes that do not broadcast: {shapes}; expected those of one batch") from None
        count, width = prod(batch), prod(shape)
        with arrays["q"].device:
            columns = [_by_components(cupy, array, batch, count) for array in arrays.values()]
            out = cupy.empty((width, count), dtype=self.dtype)
            if count and width:
                kernel(((count + THREADS - 1) // THREADS,), (THREADS,), (np.uint64(count), *columns, out))
        return out.T.reshape(*batch, *shape)

    def _array(self, name: str, value: Any) -> Any:
        """The argument as an array of CuPy, its memory shared."""
        if not isinstance(value, self._cupy.ndarray):
            where = value.__dlpack_device__()[0] if hasattr(value, "__dlpack_device__") else None
            if where not in ON_GPU:
                found = f"{type(value).__name__} that is not on a GPU"
                raise of_argument(ArgumentError, name, f"found {found}; expected an array there: cupy.asarray({name}) takes it there")
            value = self._cupy.from_dlpack(value)
        if value.dtype != self.dtype:
            raise of_argument(ArgumentError, name, f"found {value.dtype}; expected {self.dtype}, which was compiled: convert it, or compile with dtype={str(value.dtype)!r}")
        return value


def _by_components(cupy: Any, array: Any, batch: tuple[int, ...], count: int) -> Any:
    """(width, states), one component of all states in a row."""
    width = array.shape[-1]
    return cupy.ascontiguousarray(cupy.broadcast_to(array, (*batch, width)).reshape(count, width).T)


def compile_for_cuda(scene: Scene, names: tuple[str, ...], dtype: str) -> CompiledForCuda:
    """What phipsi.compile(device="cuda") gives."""
    try:
        import cupy
    except ImportError as error:
        raise ImportError("phipsi.compile(device='cuda') needs CuPy: pip install 'phipsi[cuda]'; device='cpu' needs none") from error
    source = scene.to_cuda(name="robot", functions=names, dtype=dtype)["robot.cu"]  # type: ignore[arg-type]
    try:
        found = cupy.cuda.runtime.getDeviceCount()
    except cupy.cuda.runtime.CUDARuntimeError as error:
        raise of_argument(ArgumentError, "device", f"found no GPU ({error}); expected a GPU with its driver, or device='cpu'") from error
    if found == 0:
        raise of_argument(ArgumentError, "device", "found no GPU; expected one, or device='cpu'")
    return CompiledForCuda(scene, names, dtype, source, cupy)
