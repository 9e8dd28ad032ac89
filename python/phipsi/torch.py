"""Dynamics in PyTorch: autograd, forward mode and torch.func (vmap, jacrev, jacfwd), with the analytic derivatives of
phipsi.

>>> import phipsi, phipsi.torch, torch                                      # doctest: +SKIP
>>> scene = phipsi.Scene.from_urdf("ur5.urdf")                              # doctest: +SKIP
>>> tau = torch.zeros(scene.nv, dtype=torch.float64, requires_grad=True)    # doctest: +SKIP
>>> phipsi.torch.forward_dynamics(scene, q, qd, tau).square().sum().backward()   # doctest: +SKIP

Each function calls phipsi on the CPU, once for a whole batch (vmap included), in float64. Results have the
device of the first argument and the floating dtype that the arguments are promoted to, or
torch.get_default_dtype() if all arguments are integers. Other dtypes raise ArgumentError and wrong shapes raise
ShapeError.

The derivative is the analytic Jacobian, computed in one call. Second derivatives are not supported. The entries
of q are independent variables: quaternions are normalized first, and gradients are with respect to their four
entries.

With errors="nan", bad states give NaN in results and derivatives, with one BadStateWarning.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import TYPE_CHECKING, Any

from . import _install

try:
    import torch
    from torch import Tensor
except ImportError as error:  # pragma: no cover
    raise ImportError(f"phipsi.torch needs PyTorch; install it with: {_install.command('torch')}") from error

import numpy as np

from . import _calls, _core
from .errors import ArgumentError, of_argument

if TYPE_CHECKING:
    from ._core import Scene

__all__ = [
    "bias_torque", "center_of_mass", "forward_dynamics", "integrate", "inverse_dynamics", "jacobian", "mass_matrix", "placement", "simulate",
    "task_residual",
] 


def __dir__() -> list[str]:
    return __all__


 # fmt: skip


def forward_dynamics(scene: Scene, q: Tensor, qd: Tensor, tau: Tensor, *, form: str = "auto", tolerance: float | None = None, errors: _calls.Errors = "raise") -> Tensor:
    """Joint accelerations, as Scene.forward_dynamics, with derivatives for PyTorch.

    Parameters
    ----------
    scene : Scene
        The scene.
    q : array, (..., nq)
        Joint positions, rad or m; quaternions are normalized.
    qd : array, (..., nv)
        Joint velocities, rad/s or m/s.
    tau : array, (..., nv)
        Joint torques, N m or N.
    form : str
        Form of the filter, as in Scene.forward_dynamics; derivatives use the same form.
    tolerance : float, optional
        Bound of the relative error for form="auto", as in Scene.forward_dynamics.
    errors : {"raise", "nan"}
        "raise" or "nan": bad states raise an error, or return NaN with one BadStateWarning, as in Scene.forward_dynamics.

    Returns
    -------
    Tensor
        Joint accelerations, (..., nv), rad/s^2 or m/s^2.

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype or a wrong shape.
    PhipsiError
        As Scene.forward_dynamics.

    Examples
    --------
    >>> import torch  # doctest: +SKIP
    >>> import phipsi, phipsi.torch  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.torch.forward_dynamics(scene, *(torch.zeros(6) for _ in range(3))).shape  # doctest: +SKIP
    """
    return _apply(scene, _calls.forward_dynamics(scene, form, errors, tolerance), q, qd, tau)


def inverse_dynamics(scene: Scene, q: Tensor, qd: Tensor, qdd: Tensor, *, errors: _calls.Errors = "raise") -> Tensor:
    """Joint torques, as Scene.inverse_dynamics, with derivatives for PyTorch.

    Parameters
    ----------
    scene : Scene
        The scene.
    q : array, (..., nq)
        Joint positions, rad or m; quaternions are normalized.
    qd : array, (..., nv)
        Joint velocities, rad/s or m/s.
    qdd : array, (..., nv)
        Joint accelerations, rad/s^2 or m/s^2.
    errors : {"raise", "nan"}
        "raise" or "nan": bad states raise an error, or return NaN with one BadStateWarning, as in Scene.forward_dynamics.

    Returns
    -------
    Tensor
        Joint torques, (..., nv), N m or N.

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype or a wrong shape.
    PhipsiError
        As Scene.inverse_dynamics.

    Examples
    --------
    >>> import torch  # doctest: +SKIP
    >>> import phipsi, phipsi.torch  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.torch.inverse_dynamics(scene, *(torch.zeros(6) for _ in range(3))).shape  # doctest: +SKIP
    """
    return _apply(scene, _calls.inverse_dynamics(scene, errors), q, qd, qdd)


def placement(scene: Scene, q: Tensor, link: str, *, errors: _calls.Errors = "raise") -> Tensor:
    """Pose of a link (forward kinematics), as Scene.placement, with derivatives for PyTorch.

    Parameters
    ----------
    scene : Scene
        The scene.
    q : array, (..., nq)
        Joint positions, rad or m; quaternions are normalized.
    link : str
        Name of the link.
    errors : {"raise", "nan"}
        "raise" or "nan": bad states raise an error, or return NaN with one BadStateWarning, as in Scene.forward_dynamics.

    Returns
    -------
    Tensor
        Homogeneous matrices from link to base frame, (..., 4, 4).

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype, value or shape.

    Examples
    --------
    >>> import torch  # doctest: +SKIP
    >>> import phipsi, phipsi.torch  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.torch.placement(scene, torch.zeros(6), "flange")  # doctest: +SKIP
    """
    return _apply(scene, _calls.placement(scene, link, errors), q)


def jacobian(scene: Scene, q: Tensor, link: str, *, frame: _calls.Frame = "local", errors: _calls.Errors = "raise") -> Tensor:
    """Jacobian (angular, linear) of a link, as Scene.jacobian, with derivatives for PyTorch.

    Parameters
    ----------
    scene : Scene
        The scene.
    q : array, (..., nq)
        Joint positions, rad or m; quaternions are normalized.
    link : str
        Name of the link.
    frame : {"local", "world", "local-world-aligned"}
        Frame of the result, as in Scene.velocity.
    errors : {"raise", "nan"}
        "raise" or "nan": bad states raise an error, or return NaN with one BadStateWarning, as in Scene.forward_dynamics.

    Returns
    -------
    Tensor
        Jacobian, (..., 6, nv).

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype, value or shape.

    Examples
    --------
    >>> import torch  # doctest: +SKIP
    >>> import phipsi, phipsi.torch  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.torch.jacobian(scene, torch.zeros(6), "flange")  # doctest: +SKIP
    """
    return _apply(scene, _calls.jacobian(scene, link, frame, errors), q)


def mass_matrix(scene: Scene, q: Tensor, *, errors: _calls.Errors = "raise") -> Tensor:
    """Mass matrix, as Scene.mass_matrix, with derivatives for PyTorch.

    Parameters
    ----------
    scene : Scene
        The scene.
    q : array, (..., nq)
        Joint positions, rad or m; quaternions are normalized.
    errors : {"raise", "nan"}
        "raise" or "nan": bad states raise an error, or return NaN with one BadStateWarning, as in Scene.forward_dynamics.

    Returns
    -------
    Tensor
        Mass matrix, (..., nv, nv), SI units.

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype, value or shape.

    Examples
    --------
    >>> import torch  # doctest: +SKIP
    >>> import phipsi, phipsi.torch  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.torch.mass_matrix(scene, torch.zeros(6))  # doctest: +SKIP
    """
    return _apply(scene, _calls.mass_matrix(scene, errors), q)


def bias_torque(scene: Scene, q: Tensor, qd: Tensor, *, errors: _calls.Errors = "raise") -> Tensor:
    """Bias torque (nonlinear effects), as Scene.bias_torque, with derivatives for PyTorch.

    Parameters
    ----------
    scene : Scene
        The scene.
    q : array, (..., nq)
        Joint positions, rad or m; quaternions are normalized.
    qd : array, (..., nv)
        Joint velocities, rad/s or m/s.
    errors : {"raise", "nan"}
        "raise" or "nan": bad states raise an error, or return NaN with one BadStateWarning, as in Scene.forward_dynamics.

    Returns
    -------
    Tensor
        Joint torques at which no joint accelerates, (..., nv), N m or N.

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype, value or shape.

    Examples
    --------
    >>> import torch  # doctest: +SKIP
    >>> import phipsi, phipsi.torch  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.torch.bias_torque(scene, torch.zeros(6), torch.zeros(6))  # doctest: +SKIP
    """
    return _apply(scene, _calls.bias_torque(scene, errors), q, qd)


def center_of_mass(scene: Scene, q: Tensor, *, errors: _calls.Errors = "raise") -> Tensor:
    """Center of mass of all moving links, as Scene.center_of_mass, with derivatives for PyTorch.

    Parameters
    ----------
    scene : Scene
        The scene.
    q : array, (..., nq)
        Joint positions, rad or m; quaternions are normalized.
    errors : {"raise", "nan"}
        "raise" or "nan": bad states raise an error, or return NaN with one BadStateWarning, as in Scene.forward_dynamics.

    Returns
    -------
    Tensor
        Position in the base frame, (..., 3), m.

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype, value or shape.

    Examples
    --------
    >>> import torch  # doctest: +SKIP
    >>> import phipsi, phipsi.torch  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.torch.center_of_mass(scene, torch.zeros(6))  # doctest: +SKIP
    """
    return _apply(scene, _calls.center_of_mass(scene, errors), q)


def task_residual(scene: Scene, q: Tensor, tasks: Any, *, errors: _calls.Errors = "raise") -> Tensor:
    """Errors of tasks of inverse kinematics, with derivatives for PyTorch.

    Parameters
    ----------
    scene : Scene
        The scene.
    q : array, (..., nq)
        Joint positions, rad or m; quaternions are normalized.
    tasks : task or list of tasks
        Tasks of phipsi.tasks, each with the target of one state, which is a constant.
    errors : {"raise", "nan"}
        "raise" or "nan": bad states raise an error, or return NaN with one BadStateWarning, as in Scene.forward_dynamics.

    Returns
    -------
    Tensor
        Errors of the tasks, one after another, (..., n), m and rad, not divided by their standard deviations. Of a pose: the
        rotation vector from the target to the link in the axes of the link, then the position minus the target. Of Direction
        and LookAt: the rotation vector from the target direction to the axis, in the axes of the target.

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype, value or shape.

    Examples
    --------
    >>> import torch  # doctest: +SKIP
    >>> import phipsi, phipsi.torch  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.torch.task_residual(scene, torch.zeros(6), phipsi.tasks.Position("flange", (0.5, 0.1, 0.4)))  # doctest: +SKIP
    """
    return _apply(scene, _calls.task_residual(scene, tasks, errors), q)


if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        raise _calls.missing(__name__, name)


def integrate(scene: Scene, q: Tensor, v: Tensor, *, errors: _calls.Errors = "raise") -> Tensor:
    """Configuration after moving along the tangent vector v, as Scene.integrate, with derivatives for PyTorch.

    Parameters
    ----------
    scene : Scene
        The scene.
    q : array, (..., nq)
        Joint positions, rad or m; quaternions are normalized.
    v : array, (..., nv)
        Tangent vector, rad or m: for a time step, dt times the joint velocities.
    errors : {"raise", "nan"}
        "raise" or "nan": bad states raise an error, or return NaN with one BadStateWarning, as in Scene.forward_dynamics.

    Returns
    -------
    Tensor
        Configuration, (..., nq).

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype or a wrong shape.
    PhipsiError
        As Scene.integrate.

    Examples
    --------
    >>> import torch  # doctest: +SKIP
    >>> import phipsi, phipsi.torch  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.torch.integrate(scene, torch.zeros(6), torch.zeros(6)).shape  # doctest: +SKIP
    """
    return _apply(scene, _calls.integrate(scene, errors), q, v)


def simulate(
    scene: Scene, q: Tensor, qd: Tensor, tau: Tensor, *, dt: float, record_every: int = 1, errors: _calls.Errors = "raise", **given: Any
) -> tuple[Tensor, Tensor]:
    """Simulate with given torques in each step, as Scene.simulate, with gradients for PyTorch.

    Parameters
    ----------
    scene : Scene
        The scene.
    q : array, (..., nq)
        Initial joint positions, rad or m; quaternions are normalized.
    qd : array, (..., nv)
        Initial joint velocities, rad/s or m/s.
    tau : array, (..., steps, nv)
        Joint torques of each step, N m or N.
    dt : float
        Step size, s.
    record_every : int
        Number of steps between recorded rows. Rows are checkpoints: with 1, no step is recomputed for gradients.
    errors : {"raise", "nan"}
        "raise" or "nan": bad states raise an error, or return NaN with one BadStateWarning, as in Scene.forward_dynamics.
    **given
        Other keyword arguments of Scene.simulate (method, pd, damping, ...). They are constants: tensors that
        require gradients raise ArgumentError.

    Returns
    -------
    q : Tensor, (..., rows, nq)
        Configurations.
    qd : Tensor, (..., rows, nv)
        Joint velocities, rad/s or m/s.

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype or a wrong shape, or is not a constant.
    PhipsiError
        As Scene.simulate.

    Notes
    -----
    Gradients with respect to q, qd and tau use the adjoint of every step (reverse mode); forward mode is not
    supported.

    Examples
    --------
    >>> import torch  # doctest: +SKIP
    >>> import phipsi, phipsi.torch  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> rows, _ = phipsi.torch.simulate(scene, torch.zeros(6), torch.zeros(6), torch.zeros((10, 6)), dt=1e-3)  # doctest: +SKIP
    """
    for name, value in (("dt", dt), *given.items()):
        for part in value if isinstance(value, tuple) else value.values() if isinstance(value, dict) else (value,):
            if isinstance(part, Tensor) and part.requires_grad:
                raise of_argument(ArgumentError, name, "found a tensor that requires gradients; expected a constant: gradients are by q, qd and tau")
    rollout = _calls.Rollout(scene, record_every, errors, dt=dt, **given)
    return _Rollout.apply(rollout, *_whole(scene, rollout.names, (q, qd, tau), ((scene.nq,), (scene.nv,), (None, scene.nv))))  # type: ignore[no-any-return]


def _apply(scene: Scene, call: _calls.Call, *arguments: Any) -> Tensor:
    found = _Value.apply(call, *_whole(scene, call.names, arguments, [(width,) for width in call.widths]))
    return found.reshape(*found.shape[:-1], *call.shape)  # type: ignore[no-any-return]


def _whole(scene: Scene, names: Sequence[str], given: Sequence[Any], own: Sequence[tuple[int | None, ...]]) -> list[Tensor]:
    """The arguments as tensors of real values of one floating dtype and one batch. own: the trailing axes of each."""
    tensors = [_tensor(scene, name, value) for name, value in zip(names, given, strict=True)]
    dtype = reduce(torch.promote_types, (tensor.dtype for tensor in tensors))
    dtype = dtype if dtype.is_floating_point else torch.get_default_dtype()
    batch = _calls.batch_of(names, [tuple(tensor.shape) for tensor in tensors], own)
    return [tensor.to(dtype).expand(*batch, *tensor.shape[tensor.ndim - len(trailing) :]) for tensor, trailing in zip(tensors, own, strict=True)]


def _tensor(scene: Scene, name: str, value: Any) -> Tensor:
    if not isinstance(value, Tensor):
        return torch.as_tensor(np.array(_core._numbers(name, value, scene, name == "q")))
    if value.is_complex() or value.dtype == torch.bool:
        _calls.refuse_dtype(name, value.dtype)
    return value


def _on_host(function: _calls.Host, arguments: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    found = _calls.on_host(function, tuple(argument.detach().to("cpu", torch.float64).numpy() for argument in arguments))
    like = arguments[0]
    each = found if isinstance(found, tuple) else (found,)
    return tuple(torch.as_tensor(np.ascontiguousarray(array), dtype=like.dtype, device=like.device) for array in each)


def _in_front(info: Any, dims: tuple[int | None, ...], arguments: tuple[Tensor, ...]) -> list[Tensor]:
    """The arguments with the axis of vmap first."""
    return [
        argument.expand(info.batch_size, *argument.shape) if dim is None else argument.movedim(dim, 0)
        for argument, dim in zip(arguments, dims, strict=True)
    ]


class _OnHost(torch.autograd.Function):
    """Derivatives or gradients, as a separate function, so that vmap computes them for a whole batch in one call."""

    generate_vmap_rule = False

    @staticmethod
    def forward(function: _calls.Host, *arguments: Tensor) -> tuple[Tensor, ...]:
        return _on_host(function, arguments)

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        pass

    @staticmethod
    def backward(ctx: Any, *_: Tensor) -> Any:
        raise NotImplementedError("phipsi.torch: found a request for second derivatives, which are not supported; expected first derivatives only")

    @staticmethod
    def vmap(info: Any, dims: Any, function: _calls.Host, *arguments: Tensor) -> Any:
        found = _OnHost.apply(function, *_in_front(info, dims[1:], arguments))
        return found, tuple(0 for _ in found)


class _Value(torch.autograd.Function):
    generate_vmap_rule = False

    @staticmethod
    def forward(call: _calls.Call, *arguments: Tensor) -> Tensor:
        return _on_host(call.value, arguments)[0]

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        call, *arguments = inputs
        ctx.call = call
        ctx.save_for_backward(*arguments)
        ctx.save_for_forward(*arguments)

    @staticmethod
    def backward(ctx: Any, cotangent: Tensor) -> Any:
        by_each = _OnHost.apply(ctx.call.derivatives, *ctx.saved_tensors)
        return None, *((cotangent.unsqueeze(-2) @ by_one).squeeze(-2) for by_one in by_each)

    @staticmethod
    def jvp(ctx: Any, _: Any, *tangents: Any) -> Any:
        by_each = _OnHost.apply(ctx.call.derivatives, *ctx.saved_tensors)
        moved = [(by_one @ tangent.unsqueeze(-1)).squeeze(-1) for by_one, tangent in zip(by_each, tangents, strict=True) if tangent is not None]
        return sum(moved[1:], moved[0])

    @staticmethod
    def vmap(info: Any, dims: Any, call: _calls.Call, *arguments: Tensor) -> Any:
        return _Value.apply(call, *_in_front(info, dims[1:], arguments)), 0


class _Rollout(torch.autograd.Function):
    generate_vmap_rule = False

    @staticmethod
    def forward(rollout: _calls.Rollout, *arguments: Tensor) -> tuple[Tensor, ...]:
        return _on_host(rollout.value, arguments)

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        rollout, q, _, tau = inputs
        ctx.rollout = rollout
        ctx.save_for_backward(q, tau, *output)

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> Any:
        return None, *_OnHost.apply(ctx.rollout.gradients, *ctx.saved_tensors, *cotangents)

    @staticmethod
    def vmap(info: Any, dims: Any, rollout: _calls.Rollout, *arguments: Tensor) -> Any:
        return _Rollout.apply(rollout, *_in_front(info, dims[1:], arguments)), (0, 0)
