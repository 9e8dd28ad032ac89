"""Dynamics inside JAX: jit, vmap, grad, jacobian, forward and reverse, by phipsi's analytic derivatives.

>>> import jax, phipsi, phipsi.jax                                          # doctest: +SKIP
>>> jax.config.update("jax_enable_x64", True)                               # doctest: +SKIP
>>> scene = phipsi.Scene.from_urdf("ur5.urdf")                              # doctest: +SKIP
>>> loss = lambda tau: (phipsi.jax.forward_dynamics(scene, q, qd, tau) ** 2).sum()   # doctest: +SKIP
>>> jax.jit(jax.grad(loss))(tau)                                            # doctest: +SKIP

Every function calls phipsi on the host, once for a whole batch (vmap included), in float64; results have the dtype of the arguments. Its derivative is the analytic
Jacobian, from the host as well, in one call; derivatives of second order are not there. q is taken as plain numbers: quaternions are normalised first, and gradients are by
their four numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

try:
    import jax
    import jax.numpy as jnp
except ImportError as error:  # pragma: no cover
    raise ImportError("phipsi.jax needs JAX: pip install 'phipsi[jax]'") from error

import numpy as np

from . import _calls

if TYPE_CHECKING:
    from ._core import Scene

__all__ = ["forward_dynamics", "integrate", "inverse_dynamics", "simulate"]


def forward_dynamics(scene: Scene, q: Any, qd: Any, tau: Any, *, form: str = "auto", tolerance: float | None = None) -> jax.Array:
    """Joint accelerations, as Scene.forward_dynamics: q (..., nq), qd and tau (..., nv); leading axes broadcast. form, tolerance: as there; derivatives have the same."""
    return _apply(_calls.forward_dynamics(scene, form, tolerance), (q, qd, tau))


def inverse_dynamics(scene: Scene, q: Any, qd: Any, qdd: Any) -> jax.Array:
    """Joint torques, as Scene.inverse_dynamics: q (..., nq), qd and qdd (..., nv); leading axes broadcast."""
    return _apply(_calls.inverse_dynamics(scene), (q, qd, qdd))


def integrate(scene: Scene, q: Any, v: Any) -> jax.Array:
    """q moved along v for a unit of time, as Scene.integrate: q (..., nq), v (..., nv); leading axes broadcast. A step is integrate(scene, q, dt * qd)."""
    return _apply(_calls.integrate(scene), (q, v))


def simulate(
    scene: Scene, q: Any, qd: Any, tau: Any, *, dt: float, record_every: int = 1, **given: Any
) -> tuple[jax.Array, jax.Array]:
    """Rows of q and qd, (..., rows, nq) and (..., rows, nv), as Scene.simulate: q (..., nq) and qd (..., nv) at the start, tau (..., steps, nv); leading axes broadcast.

    given: other keywords of Scene.simulate (method, pd, damping, ...). grad and vjp by q, qd and tau, by the adjoint of every step; no jvp. Rows are checkpoints: with
    record_every=1 no step is made twice.
    """
    arrays = [jnp.asarray(array) for array in (q, qd, tau)]
    dtype = jnp.result_type(*arrays, jnp.float32)
    batch = jnp.broadcast_shapes(*(array.shape[:-own] for array, own in zip(arrays, (1, 1, 2), strict=True)))
    start, rates, torques = (jnp.broadcast_to(a, (*batch, *a.shape[a.ndim - own :])).astype(dtype) for a, own in zip(arrays, (1, 1, 2), strict=True))
    rollout = _calls.Rollout(scene, record_every, dt=dt, **given)
    steps = torques.shape[-2]

    def ask(function: _calls.Host, arguments: Sequence[jax.Array], *shapes: tuple[int, ...]) -> Any:
        lead = arguments[0].shape[:-1]
        return _ask(function, arguments, tuple(jax.ShapeDtypeStruct((*lead, *shape), dtype) for shape in shapes))

    @jax.custom_vjp
    def function(q: jax.Array, qd: jax.Array, tau: jax.Array) -> Any:
        rows = rollout.rows(steps)
        return ask(rollout.value, (q, qd, tau), (rows, scene.nq), (rows, scene.nv))

    def forward(q: jax.Array, qd: jax.Array, tau: jax.Array) -> Any:
        rows = function(q, qd, tau)
        return rows, (q, tau, *rows)

    def backward(kept: Any, cotangents: Any) -> Any:
        return ask(rollout.gradients, (*kept, *cotangents), (scene.nq,), (scene.nv,), (steps, scene.nv))

    function.defvjp(forward, backward)
    return function(start, rates, torques)  # type: ignore[no-any-return]


def _ask(function: _calls.Host, arguments: Sequence[jax.Array], shapes: Any) -> Any:
    """Calls the host, once for a whole batch; results of these shapes, all of one dtype."""
    dtype = jax.tree.leaves(shapes)[0].dtype

    def host(*given: Any) -> Any:
        return jax.tree.map(lambda array: np.asarray(array, dtype), _calls.on_host(function, given))

    return jax.pure_callback(host, shapes, *arguments, vmap_method="expand_dims")


def _apply(call: _calls.Call, given: tuple[Any, ...]) -> jax.Array:
    arrays = [jnp.asarray(array) for array in given]
    dtype = jnp.result_type(*arrays, jnp.float32)

    def shape(arguments: Sequence[jax.Array], *own: int) -> Any:
        batch = jnp.broadcast_shapes(*(array.shape[:-1] for array in arguments))
        return jax.ShapeDtypeStruct((*batch, *own), dtype)

    @jax.custom_jvp
    def function(*arguments: jax.Array) -> jax.Array:
        return _ask(call.value, arguments, shape(arguments, call.size))  # type: ignore[no-any-return]

    @function.defjvp
    def _(arguments: tuple[jax.Array, ...], tangents: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
        shapes = tuple(shape(arguments, call.size, width) for width in call.widths)
        by_each = _ask(call.derivatives, arguments, shapes)
        moved = sum(jnp.einsum("...ij,...j->...i", by_one, tangent) for by_one, tangent in zip(by_each, tangents, strict=True))
        return function(*arguments), jnp.asarray(moved)

    return function(*(array.astype(dtype) for array in arrays))
