"""Dynamics inside JAX: jit, vmap, grad, jacobian, forward and reverse, by phipsi's analytic derivatives.

>>> import jax, phipsi, phipsi.jax                                          # doctest: +SKIP
>>> jax.config.update("jax_enable_x64", True)                               # doctest: +SKIP
>>> scene = phipsi.Scene.from_urdf("ur5.urdf")                              # doctest: +SKIP
>>> loss = lambda tau: (phipsi.jax.forward_dynamics(scene, q, qd, tau) ** 2).sum()   # doctest: +SKIP
>>> jax.jit(jax.grad(loss))(tau)                                            # doctest: +SKIP

Every function calls phipsi on the host, once for a whole batch (vmap included), in float64. Results have the floating dtype that the arguments are promoted to, and
that of jnp.zeros(()) if all are integers; other dtypes and wrong shapes raise ArgumentError and ShapeError, at trace time under jit. The derivative is the analytic
Jacobian, from the host as well, in one call; there are no derivatives of second order. q is taken as plain numbers: quaternions are normalised first, and gradients are by
their four numbers.

errors: "raise", or "nan" to return NaN for bad states, in results and derivatives, with one BadStateWarning, as in Scene.forward_dynamics. Under jit an error of the host
ends the compiled program, and "nan" lets it go on.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

try:
    import jax
    import jax.numpy as jnp
except ImportError as error:  # pragma: no cover
    raise ImportError("phipsi.jax needs JAX: pip install 'phipsi[jax]'") from error

import numpy as np

from . import _calls, _core
from .errors import ArgumentError, of_argument

if TYPE_CHECKING:
    from ._core import Scene

__all__ = ["forward_dynamics", "integrate", "inverse_dynamics", "simulate"]


def forward_dynamics(scene: Scene, q: Any, qd: Any, tau: Any, *, form: str = "auto", tolerance: float | None = None, errors: _calls.Errors = "raise") -> jax.Array:
    """Joint accelerations, as Scene.forward_dynamics: q (..., nq), qd and tau (..., nv); leading axes broadcast. form, tolerance: as there; derivatives have the same."""
    return _apply(scene, _calls.forward_dynamics(scene, form, errors, tolerance), q, qd, tau)


def inverse_dynamics(scene: Scene, q: Any, qd: Any, qdd: Any, *, errors: _calls.Errors = "raise") -> jax.Array:
    """Joint torques, as Scene.inverse_dynamics: q (..., nq), qd and qdd (..., nv); leading axes broadcast."""
    return _apply(scene, _calls.inverse_dynamics(scene, errors), q, qd, qdd)


def integrate(scene: Scene, q: Any, v: Any, *, errors: _calls.Errors = "raise") -> jax.Array:
    """q moved along v for a unit of time, as Scene.integrate: q (..., nq), v (..., nv); leading axes broadcast. A step is integrate(scene, q, dt * qd)."""
    return _apply(scene, _calls.integrate(scene, errors), q, v)


def simulate(
    scene: Scene, q: Any, qd: Any, tau: Any, *, dt: float, record_every: int = 1, errors: _calls.Errors = "raise", **given: Any
) -> tuple[jax.Array, jax.Array]:
    """Rows of q and qd, (..., rows, nq) and (..., rows, nv), as Scene.simulate: q (..., nq) and qd (..., nv) at the start, tau (..., steps, nv); leading axes broadcast.

    given: other keywords of Scene.simulate (method, pd, damping, ...), which are constants: traced values raise ArgumentError. grad and vjp by q, qd and tau, by the adjoint of
    every step; no jvp. Rows are checkpoints: with record_every=1 no step is made twice.
    """
    for name, value in (("dt", dt), ("record_every", record_every), *given.items()):
        if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value)):
            raise of_argument(ArgumentError, name, "found a traced value; expected a constant: gradients are by q, qd and tau")
    rollout = _calls.Rollout(scene, record_every, errors, dt=dt, **given)
    arrays, dtype = _arrays(scene, rollout.names, (q, qd, tau))
    own = ((scene.nq,), (scene.nv,), (None, scene.nv))
    batch = _calls.batch_of(rollout.names, [array.shape for array in arrays], own)
    return _rollout(rollout, *(  # type: ignore[no-any-return]
        jnp.broadcast_to(array, (*batch, *array.shape[array.ndim - len(trailing) :])).astype(dtype) for array, trailing in zip(arrays, own, strict=True)
    ))


# Defined once: JAX compiles again for every new function object, and never frees what it compiled.
@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _rollout(rollout: _calls.Rollout, q: jax.Array, qd: jax.Array, tau: jax.Array) -> Any:
    rows, scene = rollout.rows(tau.shape[-2]), rollout.scene
    return _ask(rollout, "value", (q, qd, tau), (*q.shape[:-1], rows, scene.nq), (*q.shape[:-1], rows, scene.nv))


def _rollout_forward(rollout: _calls.Rollout, q: jax.Array, qd: jax.Array, tau: jax.Array) -> Any:
    rows = _rollout(rollout, q, qd, tau)
    return rows, (q, tau, *rows)


def _rollout_backward(rollout: _calls.Rollout, kept: Any, cotangents: Any) -> Any:
    q, tau, *_ = kept
    return _ask(rollout, "gradients", (*kept, *cotangents), q.shape, (*q.shape[:-1], rollout.scene.nv), tau.shape)


_rollout.defvjp(_rollout_forward, _rollout_backward)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _value(call: _calls.Call, *arguments: jax.Array) -> jax.Array:
    return _ask(call, "value", arguments, _shape(arguments, call.size))[0]


@_value.defjvp
def _(call: _calls.Call, arguments: tuple[jax.Array, ...], tangents: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
    by_each = _ask(call, "derivatives", arguments, *(_shape(arguments, call.size, width) for width in call.widths))
    moved = sum(jnp.einsum("...ij,...j->...i", by_one, tangent) for by_one, tangent in zip(by_each, tangents, strict=True))
    return _value(call, *arguments), jnp.asarray(moved)


def _shape(arguments: Sequence[jax.Array], *own: int) -> tuple[int, ...]:
    return (*jnp.broadcast_shapes(*(array.shape[:-1] for array in arguments)), *own)


class _Host(NamedTuple):
    """A method that is called on the host. Equal ones are one callback for JAX, which then does not compile again."""

    of: _calls.Call | _calls.Rollout
    method: str
    dtype: Any

    def __call__(self, *arrays: Any) -> tuple[Any, ...]:
        found = _calls.on_host(getattr(self.of, self.method), arrays)
        return tuple(np.asarray(array, self.dtype) for array in (found if isinstance(found, tuple) else (found,)))


def _ask(of: _calls.Call | _calls.Rollout, method: str, arguments: Sequence[jax.Array], *shapes: tuple[int, ...]) -> Any:
    """Calls the host, once for a whole batch; results of these shapes, of the dtype of the arguments."""
    host = _Host(of, method, arguments[0].dtype)
    if not any(isinstance(array, jax.core.Tracer) for array in arguments):
        # Nothing to compile, and phipsi's errors are raised as they are.
        device = next((array.device for array in arguments if array.committed and len(array.devices()) == 1), None)
        return tuple(jax.device_put(array, device) for array in host(*arguments))
    results = tuple(jax.ShapeDtypeStruct(shape, host.dtype) for shape in shapes)
    return jax.pure_callback(host, results, *arguments, vmap_method="expand_dims")


def _apply(scene: Scene, call: _calls.Call, *given: Any) -> jax.Array:
    arrays, dtype = _arrays(scene, call.names, given)
    _calls.batch_of(call.names, [array.shape for array in arrays], [(width,) for width in call.widths])
    return _value(call, *(array.astype(dtype) for array in arrays))  # type: ignore[no-any-return]


def _arrays(scene: Scene, names: Sequence[str], given: Sequence[Any]) -> tuple[list[jax.Array], Any]:
    """The arguments as arrays of real numbers, and the floating dtype that they are promoted to."""
    arrays = [_array(scene, name, value) for name, value in zip(names, given, strict=True)]
    dtype = jnp.result_type(*arrays)
    return arrays, dtype if jnp.issubdtype(dtype, jnp.floating) else jnp.zeros(()).dtype


def _array(scene: Scene, name: str, value: Any) -> jax.Array:
    if not isinstance(value, jax.Array):
        if any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(value)):
            value = jnp.asarray(value)
        elif type(value) is not np.ndarray or value.dtype.kind not in "fiu" or value.dtype.itemsize > 8:
            value = _core._numbers(name, value, scene, name == "q")
    if not (jnp.issubdtype(value.dtype, jnp.floating) or jnp.issubdtype(value.dtype, jnp.integer)):
        _calls.refuse_dtype(name, value.dtype)
    return jnp.asarray(value)
