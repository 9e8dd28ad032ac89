"""Dynamics in JAX: jit, vmap, grad and jacobian in forward and reverse mode, with the analytic derivatives of phipsi.

>>> import jax, phipsi, phipsi.jax                                          # doctest: +SKIP
>>> jax.config.update("jax_enable_x64", True)                               # doctest: +SKIP
>>> scene = phipsi.Scene.from_urdf("ur5.urdf")                              # doctest: +SKIP
>>> loss = lambda tau: (phipsi.jax.forward_dynamics(scene, q, qd, tau) ** 2).sum()   # doctest: +SKIP
>>> jax.jit(jax.grad(loss))(tau)                                            # doctest: +SKIP

Each function calls phipsi on the host, once for a whole batch (vmap included), in float64. Results have the
floating dtype that the arguments are promoted to, or that of jnp.zeros(()) if all arguments are integers. Other
dtypes raise ArgumentError and wrong shapes raise ShapeError, under jit at trace time.

With phipsi.compile(scene, ..., jax=True) in place of the scene, programs of jit run the compiled functions without
Python. Derivatives do so too if they were compiled: "forward_dynamics_derivatives" for forward_dynamics, and
"inverse_dynamics_derivatives" for inverse_dynamics and bias_torque.

The derivative is the analytic Jacobian, which the host computes in one call. Second derivatives are not
supported. The entries of q are independent variables: quaternions are normalized first, and gradients are with
respect to their four entries.

With errors="nan", bad states give NaN in results and derivatives, with one BadStateWarning. With
errors="raise", an error on the host terminates a program that jit has compiled.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

from . import _install

try:
    import jax
    import jax.numpy as jnp
except ImportError as error:  # pragma: no cover
    raise ImportError(f"phipsi.jax needs JAX; install it with: {_install.command('jax')}") from error

import numpy as np

from . import _calls, _core
from ._compile import Compiled
from ._coordinates import Coordinates
from .errors import ArgumentError, of_argument

if TYPE_CHECKING:
    from ._core import Scene
    from ._xla import Target

__all__ = [
    "bias_torque", "center_of_mass", "forward_dynamics", "integrate", "inverse_dynamics", "jacobian", "mass_matrix", "placement", "simulate",
    "task_residual",
] 


def __dir__() -> list[str]:
    return __all__


 # fmt: skip


def forward_dynamics(scene: Scene | Compiled, q: Any, qd: Any, tau: Any, *, form: str = "auto", tolerance: float | None = None, errors: _calls.Errors = "raise") -> jax.Array:
    """Joint accelerations, as Scene.forward_dynamics, with derivatives for JAX.

    Parameters
    ----------
    scene : Scene or Compiled
        The scene, or its functions that phipsi.compile(..., jax=True) compiled.
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
    jax.Array
        Joint accelerations, (..., nv), rad/s^2 or m/s^2.

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype or a wrong shape.
    PhipsiError
        As Scene.forward_dynamics.

    Examples
    --------
    >>> import jax.numpy  # doctest: +SKIP
    >>> import phipsi, phipsi.jax  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.jax.forward_dynamics(scene, *(jax.numpy.zeros(6) for _ in range(3))).shape  # doctest: +SKIP
    """
    if isinstance(scene, Compiled):
        form, tolerance = _form(scene, form, tolerance)
    call = _calls.forward_dynamics(_scene(scene), form, errors, tolerance)
    return _apply(scene, _coded(scene, call, errors, ("forward_dynamics",), "forward_dynamics_derivatives"), q, qd, tau)


def inverse_dynamics(scene: Scene | Compiled, q: Any, qd: Any, qdd: Any, *, errors: _calls.Errors = "raise") -> jax.Array:
    """Joint torques, as Scene.inverse_dynamics, with derivatives for JAX.

    Parameters
    ----------
    scene : Scene or Compiled
        The scene, or its functions that phipsi.compile(..., jax=True) compiled.
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
    jax.Array
        Joint torques, (..., nv), N m or N.

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype or a wrong shape.
    PhipsiError
        As Scene.inverse_dynamics.

    Examples
    --------
    >>> import jax.numpy  # doctest: +SKIP
    >>> import phipsi, phipsi.jax  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.jax.inverse_dynamics(scene, *(jax.numpy.zeros(6) for _ in range(3))).shape  # doctest: +SKIP
    """
    call = _calls.inverse_dynamics(_scene(scene), errors)
    return _apply(scene, _coded(scene, call, errors, ("inverse_dynamics",), "inverse_dynamics_derivatives"), q, qd, qdd)


def placement(scene: Scene | Compiled, q: Any, link: str, *, errors: _calls.Errors = "raise") -> jax.Array:
    """Pose of a link (forward kinematics), as Scene.placement, with derivatives for JAX.

    Parameters
    ----------
    scene : Scene or Compiled
        The scene, or its functions that phipsi.compile(..., jax=True) compiled.
    q : array, (..., nq)
        Joint positions, rad or m; quaternions are normalized.
    link : str
        Name of the link.
    errors : {"raise", "nan"}
        "raise" or "nan": bad states raise an error, or return NaN with one BadStateWarning, as in Scene.forward_dynamics.

    Returns
    -------
    jax.Array
        Homogeneous matrices from link to base frame, (..., 4, 4).

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype, value or shape.

    Examples
    --------
    >>> import jax.numpy  # doctest: +SKIP
    >>> import phipsi, phipsi.jax  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.jax.placement(scene, jax.numpy.zeros(6), "flange")  # doctest: +SKIP
    """
    return _apply(scene, _coded(scene, _calls.placement(_scene(scene), link, errors), errors, ("placement", link)), q)


def jacobian(scene: Scene | Compiled, q: Any, link: str, *, frame: _calls.Frame = "local", errors: _calls.Errors = "raise") -> jax.Array:
    """Jacobian (angular, linear) of a link, as Scene.jacobian, with derivatives for JAX.

    Parameters
    ----------
    scene : Scene or Compiled
        The scene, or its functions that phipsi.compile(..., jax=True) compiled.
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
    jax.Array
        Jacobian, (..., 6, nv).

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype, value or shape.

    Examples
    --------
    >>> import jax.numpy  # doctest: +SKIP
    >>> import phipsi, phipsi.jax  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.jax.jacobian(scene, jax.numpy.zeros(6), "flange")  # doctest: +SKIP
    """
    return _apply(scene, _coded(scene, _calls.jacobian(_scene(scene), link, frame, errors), errors, ("jacobian", link, frame)), q)


def mass_matrix(scene: Scene | Compiled, q: Any, *, errors: _calls.Errors = "raise") -> jax.Array:
    """Mass matrix, as Scene.mass_matrix, with derivatives for JAX.

    Parameters
    ----------
    scene : Scene or Compiled
        The scene, or its functions that phipsi.compile(..., jax=True) compiled.
    q : array, (..., nq)
        Joint positions, rad or m; quaternions are normalized.
    errors : {"raise", "nan"}
        "raise" or "nan": bad states raise an error, or return NaN with one BadStateWarning, as in Scene.forward_dynamics.

    Returns
    -------
    jax.Array
        Mass matrix, (..., nv, nv), SI units.

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype, value or shape.

    Examples
    --------
    >>> import jax.numpy  # doctest: +SKIP
    >>> import phipsi, phipsi.jax  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.jax.mass_matrix(scene, jax.numpy.zeros(6))  # doctest: +SKIP
    """
    return _apply(scene, _coded(scene, _calls.mass_matrix(_scene(scene), errors), errors, ("mass_matrix",)), q)


def bias_torque(scene: Scene | Compiled, q: Any, qd: Any, *, errors: _calls.Errors = "raise") -> jax.Array:
    """Bias torque (nonlinear effects), as Scene.bias_torque, with derivatives for JAX.

    Parameters
    ----------
    scene : Scene or Compiled
        The scene, or its functions that phipsi.compile(..., jax=True) compiled.
    q : array, (..., nq)
        Joint positions, rad or m; quaternions are normalized.
    qd : array, (..., nv)
        Joint velocities, rad/s or m/s.
    errors : {"raise", "nan"}
        "raise" or "nan": bad states raise an error, or return NaN with one BadStateWarning, as in Scene.forward_dynamics.

    Returns
    -------
    jax.Array
        Joint torques at which no joint accelerates, (..., nv), N m or N.

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype, value or shape.

    Examples
    --------
    >>> import jax.numpy  # doctest: +SKIP
    >>> import phipsi, phipsi.jax  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.jax.bias_torque(scene, jax.numpy.zeros(6), jax.numpy.zeros(6))  # doctest: +SKIP
    """
    call = _calls.bias_torque(_scene(scene), errors)
    return _apply(scene, _coded(scene, call, errors, ("bias_torque",), "inverse_dynamics_derivatives"), q, qd)


def center_of_mass(scene: Scene, q: Any, *, errors: _calls.Errors = "raise") -> jax.Array:
    """Center of mass of all moving links, as Scene.center_of_mass, with derivatives for JAX.

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
    jax.Array
        Position in the base frame, (..., 3), m.

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype, value or shape.

    Examples
    --------
    >>> import jax.numpy  # doctest: +SKIP
    >>> import phipsi, phipsi.jax  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.jax.center_of_mass(scene, jax.numpy.zeros(6))  # doctest: +SKIP
    """
    return _apply(scene, _calls.center_of_mass(_not_compiled(scene), errors), q)


def task_residual(scene: Scene, q: Any, tasks: Any, *, errors: _calls.Errors = "raise") -> jax.Array:
    """Errors of tasks of inverse kinematics, with derivatives for JAX.

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
    jax.Array
        Errors of the tasks, one after another, (..., n), m and rad, not divided by their standard deviations. Of a pose: the
        rotation vector from the target to the link in the axes of the link, then the position minus the target. Of Direction
        and LookAt: the rotation vector from the target direction to the axis, in the axes of the target.

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype, value or shape.

    Examples
    --------
    >>> import jax.numpy  # doctest: +SKIP
    >>> import phipsi, phipsi.jax  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.jax.task_residual(scene, jax.numpy.zeros(6), phipsi.tasks.Position("flange", (0.5, 0.1, 0.4)))  # doctest: +SKIP
    """
    return _apply(scene, _calls.task_residual(_not_compiled(scene), tasks, errors), q)


if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        raise _calls.missing(__name__, name)


def integrate(scene: Scene, q: Any, v: Any, *, errors: _calls.Errors = "raise") -> jax.Array:
    """Configuration after moving along the tangent vector v, as Scene.integrate, with derivatives for JAX.

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
    jax.Array
        Configuration, (..., nq).

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype or a wrong shape.
    PhipsiError
        As Scene.integrate.

    Examples
    --------
    >>> import jax.numpy  # doctest: +SKIP
    >>> import phipsi, phipsi.jax  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> phipsi.jax.integrate(scene, jax.numpy.zeros(6), jax.numpy.zeros(6)).shape  # doctest: +SKIP
    """
    return _apply(scene, _calls.integrate(_not_compiled(scene), errors), q, v)


def simulate(
    scene: Scene, q: Any, qd: Any, tau: Any, *, dt: float, record_every: int = 1, errors: _calls.Errors = "raise", **given: Any
) -> tuple[jax.Array, jax.Array]:
    """Simulate with given torques in each step, as Scene.simulate, with gradients for JAX.

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
        Other keyword arguments of Scene.simulate (method, pd, damping, ...). They are constants: traced values raise
        ArgumentError.

    Returns
    -------
    q : jax.Array, (..., rows, nq)
        Configurations.
    qd : jax.Array, (..., rows, nv)
        Joint velocities, rad/s or m/s.

    Raises
    ------
    ArgumentError, ShapeError
        If an argument has an unsupported dtype or a wrong shape, or is not a constant.
    PhipsiError
        As Scene.simulate.

    Notes
    -----
    Gradients with respect to q, qd and tau use the adjoint of every step (grad and vjp); jvp is not supported.

    Examples
    --------
    >>> import jax.numpy  # doctest: +SKIP
    >>> import phipsi, phipsi.jax  # doctest: +SKIP
    >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # doctest: +SKIP
    >>> rows, _ = phipsi.jax.simulate(scene, jax.numpy.zeros(6), jax.numpy.zeros(6), jax.numpy.zeros((10, 6)), dt=1e-3)  # doctest: +SKIP
    """
    for name, value in (("dt", dt), ("record_every", record_every), *given.items()):
        if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value)):
            raise of_argument(ArgumentError, name, "found a traced value; expected a constant: gradients are by q, qd and tau")
    rollout = _calls.Rollout(_not_compiled(scene), record_every, errors, dt=dt, **given)
    arrays, dtype = _arrays(scene, rollout.names, (q, qd, tau))
    own = ((scene.nq,), (scene.nv,), (None, scene.nv))
    batch = _calls.batch_of(rollout.names, [array.shape for array in arrays], own)
    return _rollout(rollout, *(  # type: ignore[no-any-return]
        jnp.broadcast_to(array, (*batch, *array.shape[array.ndim - len(trailing) :])).astype(dtype) for array, trailing in zip(arrays, own, strict=True)
    ))


class _Coded:
    """A call whose value, and whose derivatives if they were compiled, are operations of XLA."""

    def __init__(self, robot: Compiled, call: _calls.Call, errors: _calls.Errors, value: tuple[str, ...], derivatives: str) -> None:
        operations = robot._operations
        if operations is None:
            found = "functions that were compiled without jax=True"
            raise of_argument(ArgumentError, "scene", f"found {found}; expected a scene, or phipsi.compile(scene, ..., jax=True)")
        if value not in operations:
            raise robot._missing(value)
        self.value, self.derivatives, self.errors = call.value, call.derivatives, errors
        self.names, self.widths, self.shape, self.size = call.names, call.widths, call.shape, call.size
        self.targets: dict[str, Target | None] = {"value": operations[value], "derivatives": operations.get((derivatives,))}
        self.coordinates = Coordinates(robot.scene)

    def ask(self, method: str, arguments: Sequence[jax.Array]) -> tuple[jax.Array, ...] | None:
        """The results of the call of the host with this name, as operations of XLA; None if they were not compiled."""
        target = self.targets[method]
        if target is None:
            return None
        batch, dtype = _shape(arguments), arguments[0].dtype
        q = arguments[0].astype(target.dtype)
        # A function of fewer arguments is that of more at zero: the bias torque is the inverse dynamics without accelerations.
        given = [self.coordinates.normalized(q, jnp), *arguments[1:], *(jnp.zeros(width) for width in target.reads[len(arguments) :])]
        arrays = [jnp.broadcast_to(array, (*batch, width)).astype(target.dtype) for array, width in zip(given, target.reads, strict=True)]
        results = [jax.ShapeDtypeStruct((*batch, *shape), target.dtype) for shape in target.results]
        found = jax.ffi.ffi_call(target.name, results, vmap_method="broadcast_all")(*arrays, raises=np.int32(self.errors == "raise"))
        if method == "value":
            return (found[0].reshape(*batch, self.size).astype(dtype),)
        by_q, *by_others = found[: len(arguments)]
        return tuple(one.astype(dtype) for one in (self.coordinates.by_entries(q, by_q, jnp), *by_others))


@lru_cache(maxsize=64)
def _code_of(robot: Compiled, call: _calls.Call, errors: _calls.Errors, value: tuple[str, ...], derivatives: str) -> _Coded:
    """One object for equal calls, for JAX recompiles for every new one."""
    return _Coded(robot, call, errors, value, derivatives)


def _coded(scene: Scene | Compiled, call: _calls.Call, errors: _calls.Errors, value: tuple[str, ...], derivatives: str = "") -> _calls.Call | _Coded:
    """The call, by compiled functions if these are given."""
    return _code_of(scene, call, errors, value, derivatives) if isinstance(scene, Compiled) else call


def _scene(robot: Scene | Compiled) -> Scene:
    return robot.scene if isinstance(robot, Compiled) else robot


def _not_compiled(scene: Scene) -> Scene:
    """The scene; raises for compiled functions."""
    if isinstance(scene, Compiled):
        raise of_argument(ArgumentError, "scene", "found compiled functions; expected a scene: this function of phipsi.jax calls the host")
    return scene


def _form(robot: Compiled, form: str, tolerance: float | None) -> tuple[str, float | None]:
    """The form and the tolerance that were compiled; others are refused."""
    if form not in ("auto", robot.form) or tolerance not in (None, robot.tolerance):
        found = f"form {form!r} and tolerance {tolerance!r} with functions that were compiled for {robot.form!r} and {robot.tolerance!r}"
        raise of_argument(ArgumentError, "form", f"found {found}; expected these, or the scene in place of its code")
    return robot.form, robot.tolerance


# Defined once: JAX recompiles for every new function object and never frees compiled code.
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
def _value(call: _calls.Call | _Coded, *arguments: jax.Array) -> jax.Array:
    return _ask(call, "value", arguments, _shape(arguments, call.size))[0]


@_value.defjvp
def _(call: _calls.Call | _Coded, arguments: tuple[jax.Array, ...], tangents: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
    by_each = _ask(call, "derivatives", arguments, *(_shape(arguments, call.size, width) for width in call.widths))
    moved = sum(jnp.einsum("...ij,...j->...i", by_one, tangent) for by_one, tangent in zip(by_each, tangents, strict=True))
    return _value(call, *arguments), jnp.asarray(moved)


def _shape(arguments: Sequence[jax.Array], *own: int) -> tuple[int, ...]:
    return (*jnp.broadcast_shapes(*(array.shape[:-1] for array in arguments)), *own)


class _Host(NamedTuple):
    """Callback on the host. Equal callbacks are identical for JAX, which therefore does not recompile."""

    of: _calls.Call | _Coded | _calls.Rollout
    method: str
    dtype: Any

    def __call__(self, *arrays: Any) -> tuple[Any, ...]:
        found = _calls.on_host(getattr(self.of, self.method), arrays)
        return tuple(np.asarray(array, self.dtype) for array in (found if isinstance(found, tuple) else (found,)))


def _ask(of: _calls.Call | _Coded | _calls.Rollout, method: str, arguments: Sequence[jax.Array], *shapes: tuple[int, ...]) -> Any:
    """Call the host once for a whole batch; results have these shapes and the dtype of the arguments."""
    host = _Host(of, method, arguments[0].dtype)
    if not any(isinstance(array, jax.core.Tracer) for array in arguments):
        # Outside of a trace nothing is compiled, and errors of phipsi are raised unchanged.
        device = next((array.device for array in arguments if array.committed and len(array.devices()) == 1), None)
        return tuple(jax.device_put(array, device) for array in host(*arguments))
    if isinstance(of, _Coded) and (found := of.ask(method, arguments)) is not None:
        return found
    results = tuple(jax.ShapeDtypeStruct(shape, host.dtype) for shape in shapes)
    return jax.pure_callback(host, results, *arguments, vmap_method="expand_dims")


def _apply(scene: Scene | Compiled, call: _calls.Call | _Coded, *given: Any) -> jax.Array:
    arrays, dtype = _arrays(_scene(scene), call.names, given)
    _calls.batch_of(call.names, [array.shape for array in arrays], [(width,) for width in call.widths])
    found = _value(call, *(array.astype(dtype) for array in arrays))
    return found.reshape(*found.shape[:-1], *call.shape)  # type: ignore[no-any-return]


def _arrays(scene: Scene, names: Sequence[str], given: Sequence[Any]) -> tuple[list[jax.Array], Any]:
    """The arguments as arrays of real values, and the floating dtype that they are promoted to."""
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
