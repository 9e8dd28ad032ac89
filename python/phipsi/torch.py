"""Dynamics inside PyTorch: autograd, forward mode and torch.func (vmap, jacrev, jacfwd) by phipsi's analytic derivatives.

>>> import phipsi, phipsi.torch, torch                                      # doctest: +SKIP
>>> scene = phipsi.Scene.from_urdf("ur5.urdf")                              # doctest: +SKIP
>>> tau = torch.zeros(scene.nv, dtype=torch.float64, requires_grad=True)    # doctest: +SKIP
>>> phipsi.torch.forward_dynamics(scene, q, qd, tau).square().sum().backward()   # doctest: +SKIP

Every function calls phipsi on the CPU, once for a whole batch (vmap included), in float64; results have the dtype and device of the arguments. Its derivative is the
analytic Jacobian, in one call; derivatives of second order are not there. q is taken as plain numbers: quaternions are normalised first, and gradients are by
their four numbers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

try:
    import torch
    from torch import Tensor
except ImportError as error:  # pragma: no cover
    raise ImportError("phipsi.torch needs PyTorch: pip install 'phipsi[torch]'") from error

import numpy as np

from . import _calls

if TYPE_CHECKING:
    from ._core import Scene

__all__ = ["forward_dynamics", "integrate", "inverse_dynamics", "simulate"]


def forward_dynamics(scene: Scene, q: Tensor, qd: Tensor, tau: Tensor, *, form: str = "auto", tolerance: float | None = None) -> Tensor:
    """Joint accelerations, as Scene.forward_dynamics: q (..., nq), qd and tau (..., nv); leading axes broadcast. form, tolerance: as there; derivatives have the same."""
    return _apply(_calls.forward_dynamics(scene, form, tolerance), q, qd, tau)


def inverse_dynamics(scene: Scene, q: Tensor, qd: Tensor, qdd: Tensor) -> Tensor:
    """Joint torques, as Scene.inverse_dynamics: q (..., nq), qd and qdd (..., nv); leading axes broadcast."""
    return _apply(_calls.inverse_dynamics(scene), q, qd, qdd)


def integrate(scene: Scene, q: Tensor, v: Tensor) -> Tensor:
    """q moved along v for a unit of time, as Scene.integrate: q (..., nq), v (..., nv); leading axes broadcast. A step is integrate(scene, q, dt * qd)."""
    return _apply(_calls.integrate(scene), q, v)


def simulate(scene: Scene, q: Tensor, qd: Tensor, tau: Tensor, *, dt: float, record_every: int = 1, **given: Any) -> tuple[Tensor, Tensor]:
    """Rows of q and qd, (..., rows, nq) and (..., rows, nv), as Scene.simulate: q (..., nq) and qd (..., nv) at the start, tau (..., steps, nv); leading axes broadcast.

    given: other keywords of Scene.simulate (method, pd, damping, ...). Gradients by q, qd and tau, by the adjoint of every step; no forward mode. Rows are checkpoints: with
    record_every=1 no step is made twice.
    """
    batch = torch.broadcast_shapes(q.shape[:-1], qd.shape[:-1], tau.shape[:-2])
    whole = (q.expand(*batch, scene.nq), qd.expand(*batch, scene.nv), tau.expand(*batch, *tau.shape[-2:]))
    return _Rollout.apply(_calls.Rollout(scene, record_every, dt=dt, **given), *whole)  # type: ignore[no-any-return]


def _apply(call: _calls.Call, *arguments: Tensor) -> Tensor:
    batch = torch.broadcast_shapes(*(argument.shape[:-1] for argument in arguments))
    whole = [argument.expand(*batch, argument.shape[-1]) for argument in arguments]
    return _Value.apply(call, *whole)  # type: ignore[no-any-return]


def _on_host(function: _calls.Host, arguments: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    found = _calls.on_host(function, tuple(argument.detach().cpu().numpy() for argument in arguments))
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
