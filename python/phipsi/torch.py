"""Dynamics inside PyTorch: autograd, forward mode and torch.func (vmap, jacrev, jacfwd) by phipsi's analytic derivatives.

>>> import phipsi, phipsi.torch, torch                                      # doctest: +SKIP
>>> scene = phipsi.Scene.from_urdf("ur5.urdf")                              # doctest: +SKIP
>>> tau = torch.zeros(scene.nv, dtype=torch.float64, requires_grad=True)    # doctest: +SKIP
>>> phipsi.torch.forward_dynamics(scene, q, qd, tau).square().sum().backward()   # doctest: +SKIP

Every function calls phipsi on the CPU, once for a whole batch (vmap included), in float64. Results have the device of the first argument and the floating dtype that the
arguments are promoted to, torch.get_default_dtype() if all are integers; other dtypes and wrong shapes raise ArgumentError and ShapeError. The derivative is the
analytic Jacobian, in one call; there are no derivatives of second order. q is taken as plain numbers: quaternions are normalised first, and gradients are by
their four numbers.

errors: "raise", or "nan" to return NaN for bad states, in results and derivatives, with one BadStateWarning, as in Scene.forward_dynamics.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import TYPE_CHECKING, Any

try:
    import torch
    from torch import Tensor
except ImportError as error:  # pragma: no cover
    raise ImportError("phipsi.torch needs PyTorch: pip install 'phipsi[torch]'") from error

import numpy as np

from . import _calls, _core
from .errors import ArgumentError, of_argument

if TYPE_CHECKING:
    from ._core import Scene

__all__ = ["forward_dynamics", "integrate", "inverse_dynamics", "simulate"]


def forward_dynamics(scene: Scene, q: Tensor, qd: Tensor, tau: Tensor, *, form: str = "auto", tolerance: float | None = None, errors: _calls.Errors = "raise") -> Tensor:
    """Joint accelerations, as Scene.forward_dynamics: q (..., nq), qd and tau (..., nv); leading axes broadcast. form, tolerance: as there; derivatives have the same."""
    return _apply(scene, _calls.forward_dynamics(scene, form, errors, tolerance), q, qd, tau)


def inverse_dynamics(scene: Scene, q: Tensor, qd: Tensor, qdd: Tensor, *, errors: _calls.Errors = "raise") -> Tensor:
    """Joint torques, as Scene.inverse_dynamics: q (..., nq), qd and qdd (..., nv); leading axes broadcast."""
    return _apply(scene, _calls.inverse_dynamics(scene, errors), q, qd, qdd)


def integrate(scene: Scene, q: Tensor, v: Tensor, *, errors: _calls.Errors = "raise") -> Tensor:
    """q moved along v for a unit of time, as Scene.integrate: q (..., nq), v (..., nv); leading axes broadcast. A step is integrate(scene, q, dt * qd)."""
    return _apply(scene, _calls.integrate(scene, errors), q, v)


def simulate(
    scene: Scene, q: Tensor, qd: Tensor, tau: Tensor, *, dt: float, record_every: int = 1, errors: _calls.Errors = "raise", **given: Any
) -> tuple[Tensor, Tensor]:
    """Rows of q and qd, (..., rows, nq) and (..., rows, nv), as Scene.simulate: q (..., nq) and qd (..., nv) at the start, tau (..., steps, nv); leading axes broadcast.

    given: other keywords of Scene.simulate (method, pd, damping, ...), which are constants: tensors that require gradients raise ArgumentError. Gradients by q, qd and tau,
    by the adjoint of every step; no forward mode. Rows are checkpoints: with record_every=1 no step is made twice.
    """
    for name, value in (("dt", dt), *given.items()):
        for part in value if isinstance(value, tuple) else (value,):
            if isinstance(part, Tensor) and part.requires_grad:
                raise of_argument(ArgumentError, name, "found a tensor that requires gradients; expected a constant: gradients are by q, qd and tau")
    rollout = _calls.Rollout(scene, record_every, errors, dt=dt, **given)
    return _Rollout.apply(rollout, *_whole(scene, rollout.names, (q, qd, tau), ((scene.nq,), (scene.nv,), (None, scene.nv))))  # type: ignore[no-any-return]


def _apply(scene: Scene, call: _calls.Call, *arguments: Any) -> Tensor:
    return _Value.apply(call, *_whole(scene, call.names, arguments, [(width,) for width in call.widths]))  # type: ignore[no-any-return]


def _whole(scene: Scene, names: Sequence[str], given: Sequence[Any], own: Sequence[tuple[int | None, ...]]) -> list[Tensor]:
    """The arguments as tensors of real numbers of one floating dtype, of one batch. own: the trailing axes of each."""
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
    """Derivatives or gradients; a function of its own, so that vmap asks for those of a whole batch."""

    generate_vmap_rule = False

    @staticmethod
    def forward(function: _calls.Host, *arguments: Tensor) -> tuple[Tensor, ...]:
        return _on_host(function, arguments)

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        pass

    @staticmethod
    def backward(ctx: Any, *_: Tensor) -> Any:
        raise NotImplementedError("phipsi.torch has no derivatives of second order")

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
