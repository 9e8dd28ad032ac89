"""phipsi.jax: values, forward and reverse derivatives, jit and vmap, for robots with and without quaternions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
from tolerances import assert_near, product, size

import phipsi

jax = pytest.importorskip("jax")
jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
from jax.test_util import check_grads  # noqa: E402

import phipsi.jax  # noqa: E402
from phipsi import _calls  # noqa: E402
from phipsi.errors import ArgumentError, BadStateWarning, NotFiniteError, ShapeError, SimulationError  # noqa: E402

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "forward_dynamics": phipsi.jax.forward_dynamics,
    "inverse_dynamics": phipsi.jax.inverse_dynamics,
    "integrate": phipsi.jax.integrate,
}


def tree() -> phipsi.Scene:
    """A floating body with a spherical joint, a prismatic joint and two hinges."""
    builder = phipsi.SceneBuilder()
    inertia = np.diag([0.02, 0.03, 0.025])
    for name in ("body", "ball", "slider", "arm", "hand"):
        builder.link(name, mass=1.3, com=(0.05, -0.02, 0.1), inertia=inertia)
    builder.joint("shoulder", "spherical", "body", "ball", xyz=(0.1, 0.0, 0.2))
    builder.joint("slide", "prismatic", "ball", "slider", xyz=(0.0, 0.1, 0.1), axis=(0.6, 0.0, 0.8))
    builder.joint("elbow", "revolute", "slider", "arm", xyz=(0.0, 0.0, 0.3), axis=(0, 1, 0))
    builder.joint("wrist", "revolute", "arm", "hand", xyz=(0.0, 0.0, 0.3), axis=(1, 0, 0))
    return builder.build(floating_base=True)


@pytest.fixture(scope="module", params=["chain", "tree"])
def scene(request: pytest.FixtureRequest) -> Iterator[phipsi.Scene]:
    yield phipsi.scenes.chain(4) if request.param == "chain" else tree()


def arguments(scene: phipsi.Scene, name: str, *batch: int) -> tuple[np.ndarray, ...]:
    random = np.random.default_rng(5)
    q = scene.integrate(np.broadcast_to(scene.neutral(), (*batch, scene.nq)), random.uniform(-1, 1, (*batch, scene.nv)))
    rates = random.uniform(-1, 1, (2, *batch, scene.nv))
    return (q, rates[0]) if name == "integrate" else (q, *rates)


def plain(scene: phipsi.Scene, name: str) -> Callable[..., np.ndarray]:
    return getattr(scene, name)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_values_are_those_of_the_scene_jitted_and_mapped(scene: phipsi.Scene, name: str) -> None:
    given = arguments(scene, name, 3)
    expected = plain(scene, name)(*given)
    function = jax.jit(lambda *given: FUNCTIONS[name](scene, *given))
    for found in (function(*given), jax.vmap(function)(*given), jnp.stack([function(*row) for row in zip(*given, strict=True)])):
        assert_near(np.asarray(found), expected, product(scene.nv, size(expected)))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_derivatives_forward_and_reverse(scene: phipsi.Scene, name: str) -> None:
    """Derivatives of the host (test_calls.py), with respect to every entry."""
    given = arguments(scene, name)
    function = lambda *given: FUNCTIONS[name](scene, *given)  # noqa: E731
    calls = {"forward_dynamics": _calls.forward_dynamics(scene, "auto"), "inverse_dynamics": _calls.inverse_dynamics(scene)}
    expected = calls.get(name, _calls.integrate(scene)).derivatives(*given)
    every = tuple(range(len(given)))
    for of in (jax.jacfwd, jax.jacrev):
        for found, derivative in zip(of(function, argnums=every)(*given), expected, strict=True):
            assert_near(np.asarray(found), derivative, product(scene.nv, size(derivative)))


def test_gradients_inside_a_jitted_loop_are_differences() -> None:
    """Ten steps of a chain, as in learning and predictive control."""
    scene = phipsi.scenes.chain(3)
    q, qd, tau = arguments(scene, "forward_dynamics")

    def end(tau: Any) -> Any:
        def step(state: Any, _: None) -> Any:
            q, qd = state
            qd = qd + 0.01 * phipsi.jax.forward_dynamics(scene, q, qd, tau)
            return (phipsi.jax.integrate(scene, q, 0.01 * qd), qd), None

        return (jax.lax.scan(step, (q, qd), None, length=10)[0][0] ** 2).sum()

    check_grads(jax.jit(end), (tau,), order=1, modes=("rev",), rtol=1e-4, atol=1e-6, eps=1e-4)


def test_a_batch_is_one_call_of_the_host(scene: phipsi.Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, ...]] = []
    plainly = _calls.on_host

    def counted(function: Any, arrays: tuple[Any, ...]) -> Any:
        asked.append(np.asarray(arrays[0]).shape)
        return plainly(function, arrays)

    monkeypatch.setattr(_calls, "on_host", counted)
    given = arguments(scene, "forward_dynamics", 16)
    gradient = jax.grad(lambda *given: phipsi.jax.forward_dynamics(scene, *given).sum(), argnums=2)
    jax.block_until_ready(jax.jit(jax.vmap(gradient))(*given))
    assert asked and all(shape[0] == 16 for shape in asked) and len(asked) <= 2


@pytest.mark.parametrize("dtype", ["float16", "float32", "float64"])
def test_results_have_the_dtype_of_the_promotion(scene: phipsi.Scene, dtype: str) -> None:
    given = [jnp.asarray(argument, dtype) for argument in arguments(scene, "forward_dynamics")]
    assert phipsi.jax.forward_dynamics(scene, *given).dtype == dtype
    wider = phipsi.jax.forward_dynamics(scene, given[0], given[1], given[2].astype("float64"))
    assert wider.dtype == "float64"


def test_integers_are_converted_as_by_the_scene() -> None:
    scene = phipsi.scenes.chain(3)
    q, qd, tau = np.array([[1, 0, -1], [2, 1, -1], [0, 3, 1]])
    expected = scene.forward_dynamics(q, qd, tau)
    for given in ((jnp.asarray(q), jnp.asarray(qd), jnp.asarray(tau)), (q.tolist(), qd, tau), ([jnp.asarray(1), 0, -1], qd, tau)):
        found = phipsi.jax.forward_dynamics(scene, *given)
        assert found.dtype == "float64"
        assert_near(np.asarray(found), expected, product(3, size(expected)))
    rows = phipsi.jax.simulate(scene, jnp.asarray(q), qd, np.zeros((4, 3), int), dt=0.01)
    assert_near(np.asarray(rows[1]), scene.simulate(q, qd, dt=0.01, steps=4).qd, product(3, size(expected)))


NO_NUMBERS: dict[str, Any] = {
    "complex128": lambda q: jnp.asarray(q) + 1j,
    "bool": lambda q: jnp.asarray(q) > 0,
    "bool of NumPy": lambda q: q > 0,
    "object": lambda q: [None] * len(q),
    "str": lambda q: "abc",
}


@pytest.mark.parametrize("kind", NO_NUMBERS)
@pytest.mark.parametrize("name", [*FUNCTIONS, "simulate"])
def test_other_numbers_are_refused_as_by_the_scene(name: str, kind: str) -> None:
    scene = phipsi.scenes.chain(3)
    value = NO_NUMBERS[kind](np.ones(3))
    with pytest.raises(ArgumentError) as expected:
        scene.integrate(scene.neutral(), value if isinstance(value, list | str) else np.asarray(value))
    function = FUNCTIONS.get(name, lambda scene, *given: phipsi.jax.simulate(scene, *given[:2], given[2][None], dt=0.01))
    given = arguments(scene, "integrate" if name == "integrate" else "forward_dynamics")
    with pytest.raises(ArgumentError) as found:
        function(scene, given[0], value, *given[2:])
    assert str(found.value).partition(": ")[2] == str(expected.value).partition(": ")[2]


@pytest.mark.parametrize("under", [lambda function: function, jax.jit, jax.make_jaxpr])
@pytest.mark.parametrize("at", range(3))
def test_a_wrong_width_is_refused_when_it_is_traced(scene: phipsi.Scene, at: int, under: Any) -> None:
    given = list(arguments(scene, "forward_dynamics", 2))
    given[at] = given[at][..., :-1]
    for function in (phipsi.jax.forward_dynamics, lambda scene, q, qd, tau: phipsi.jax.simulate(scene, q, qd, tau[:, None], dt=0.01)):
        with pytest.raises(ShapeError, match=rf"^{('q', 'qd', 'tau')[at]}: found shape \(.*\); expected \(\.\.\., .*{(scene.nq, scene.nv, scene.nv)[at]}\)(\n|$)"):
            under(lambda *given: function(scene, *given))(*given)  # noqa: B023


def test_leading_axes_that_do_not_broadcast_are_refused_when_traced(scene: phipsi.Scene) -> None:
    q, qd, tau = arguments(scene, "forward_dynamics", 3)
    with pytest.raises(ShapeError, match=r"^qd: found leading axes \(2,\); expected ones that broadcast with \(3,\) of q(\n|$)"):
        jax.jit(lambda *given: phipsi.jax.forward_dynamics(scene, *given))(q, qd[:2], tau)


BAD_OPTIONS: list[tuple[Any, str]] = [
    (lambda scene, *given: phipsi.jax.forward_dynamics(scene, *given, form="x"), 'form: found "x"'),
    (lambda scene, *given: phipsi.jax.inverse_dynamics(scene, *given, errors="x"), 'errors: found "x"'),
    (lambda scene, q, qd, tau: phipsi.jax.simulate(scene, q, qd, tau[None], dt=0.1, method="x"), 'method: found "x"'),
    (lambda scene, q, qd, tau: phipsi.jax.simulate(scene, q, qd, tau[None], dt=0.1, errors="x"), 'errors: found "x"'),
    (lambda scene, q, qd, tau: phipsi.jax.simulate(scene, q, qd, tau[None], dt=0.1, damping=tau), "damping: found a traced value"),
]


@pytest.mark.parametrize("number", range(len(BAD_OPTIONS)))
def test_bad_options_are_refused_when_traced(number: int) -> None:
    function, message = BAD_OPTIONS[number]
    scene = phipsi.scenes.chain(3)
    with pytest.raises(ArgumentError, match=message):
        jax.jit(lambda *given: function(scene, *given))(*arguments(scene, "forward_dynamics"))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_bad_states_are_nan(scene: phipsi.Scene, name: str) -> None:
    """The others are unaffected, in values and in derivatives, eagerly and under jit and vmap."""
    given = arguments(scene, name, 4)
    expected = np.asarray(FUNCTIONS[name](scene, *given))
    given[1][2, 0] = np.nan
    function = lambda *given: FUNCTIONS[name](scene, *given, errors="nan")  # noqa: E731
    for of in (function, jax.jit(function), jax.jit(jax.vmap(function))):
        with pytest.warns(BadStateWarning, match="1 of 4 states"):
            found = np.asarray(jax.block_until_ready(of(*given)))
        assert np.isnan(found[2]).all()
        assert_near(np.delete(found, 2, 0), np.delete(expected, 2, 0), 0.0)
    with pytest.warns(BadStateWarning):
        by_q = np.asarray(jax.block_until_ready(jax.jit(jax.vmap(jax.jacobian(function)))(*given)))
    assert np.isnan(by_q[2]).all() and np.isfinite(np.delete(by_q, 2, 0)).all()
    with pytest.raises(NotFiniteError, match="state 2"):
        FUNCTIONS[name](scene, *given)


def test_bad_rollouts_are_nan() -> None:
    """Bad initial states, diverging states, and a quaternion without a norm."""
    scene = tree()
    q, qd, tau = (array.copy() for array in rollout(scene, 2, 3))
    options: dict[str, Any] = {"dt": 0.02, "record_every": 2, "method": "rk4"}
    expected = phipsi.jax.simulate(scene, q, qd, tau, **options)
    q[0, 1, 3:7], qd[1, 0, 0], tau[1, 2, 3] = 0.0, np.nan, 1e290
    function = jax.jit(lambda *given: phipsi.jax.simulate(scene, *given, errors="nan", **options))
    with pytest.warns(BadStateWarning, match="3 of 6 states") as caught:
        found = jax.block_until_ready(function(q, qd, tau))
    warning: Any = next(one.message for one in caught if isinstance(one.message, BadStateWarning))
    assert warning.states == ((0, 1), (1, 0), (1, 2))
    assert [type(reason) for reason in warning.reasons] == [ArgumentError, NotFiniteError, SimulationError]
    good = np.ones((2, 3), bool)
    good[0, 1] = good[1, 0] = good[1, 2] = False
    for one, other in zip(found, expected, strict=True):
        assert np.isnan(np.asarray(one)[~good]).all()
        assert_near(np.asarray(one)[good], np.asarray(other)[good], 0.0)
    loss = lambda *given: sum((rows[good] ** 2).sum() for rows in phipsi.jax.simulate(scene, *given, errors="nan", **options))  # noqa: E731
    with pytest.warns(BadStateWarning):
        gradient = np.asarray(jax.grad(loss, argnums=2)(q, qd, tau))
    assert np.isnan(gradient[~good]).all() and np.isfinite(gradient[good]).all() and np.any(gradient[good])


EAGER: dict[str, Callable[..., Any]] = {
    "value": lambda scene, q, qd, tau: phipsi.jax.forward_dynamics(scene, q, qd, tau),
    "integrate": lambda scene, q, qd, tau: phipsi.jax.integrate(scene, q, qd),
    "gradient": lambda scene, *given: jax.grad(lambda *given: phipsi.jax.forward_dynamics(scene, *given).sum(), argnums=2)(*given),
    "vmap": lambda scene, *given: jax.vmap(lambda *given: phipsi.jax.inverse_dynamics(scene, *given))(*given),
    "simulate": lambda scene, q, qd, tau: phipsi.jax.simulate(scene, q, qd, tau[:, None], dt=0.01, damping=np.ones(scene.nv)),
    "vmap of simulate": lambda scene, *given: jax.vmap(lambda q, qd, tau: phipsi.jax.simulate(scene, q, qd, tau[None], dt=0.01, damping=np.ones(scene.nv)))(*given),
    "gradient of simulate": lambda scene, *given: jax.grad(
        lambda q, qd, tau: phipsi.jax.simulate(scene, q, qd, tau[:, None], dt=0.01, damping=np.ones(scene.nv))[0].sum(), argnums=2
    )(*given),
}


@pytest.mark.parametrize("kind", EAGER)
def test_eager_calls_compile_once(scene: phipsi.Scene, kind: str) -> None:
    compiled: list[str] = []

    def listen(event: str, _: float, **__: Any) -> None:
        if "compile" in event:
            compiled.append(event)

    given = [jnp.asarray(array) for array in arguments(scene, "forward_dynamics", 2)]
    EAGER[kind](scene, *given)
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        jax.jit(lambda x: x + 1.0)(given[0]).block_until_ready()
        assert compiled, "compilations are not counted"
        compiled.clear()
        for _ in range(3):
            jax.block_until_ready(EAGER[kind](scene, *given))
    finally:
        jax.monitoring.clear_event_listeners()
    assert compiled == []


def rollout(scene: phipsi.Scene, *batch: int) -> tuple[np.ndarray, ...]:
    q, qd, _ = arguments(scene, "forward_dynamics", *batch)
    return q, qd, np.random.default_rng(2).uniform(-1, 1, (*batch, 7, scene.nv))


@pytest.mark.parametrize("method", ["semi-implicit-euler", "rk4"])
def test_gradients_of_a_rollout(scene: phipsi.Scene, method: str) -> None:
    def function(*given: Any) -> Any:
        return phipsi.jax.simulate(scene, *given, dt=0.02, record_every=2, method=method)

    given = rollout(scene, 3)
    path = scene.simulate(given[0], given[1], tau_steps=given[2], dt=0.02, steps=7, record_every=2, method=method)
    for found in (jax.jit(function)(*given), jax.vmap(function)(*given)):
        assert_near(np.asarray(found[0]), path.q, product(scene.nv, size(path.q)))
        assert_near(np.asarray(found[1]), path.qd, product(scene.nv, size(path.qd)))
    check_grads(jax.jit(function), tuple(array[0] for array in given), order=1, modes=["rev"], atol=1e-4, rtol=1e-4)
    # For a shared initial state, the sum.
    loss = lambda q, qd, tau: sum((rows**2).sum() for rows in function(q, qd, tau))  # noqa: E731
    shared = jax.grad(loss)(given[0][0], given[1], given[2])
    each = jax.vmap(jax.grad(loss), in_axes=(None, 0, 0))(given[0][0], given[1], given[2])
    assert_near(np.asarray(shared), np.asarray(each).sum(axis=0), product(64 * scene.nv, size(np.asarray(each))))


def test_functions_of_configurations_and_their_gradients(scene: phipsi.Scene) -> None:
    """Values are those of the scene; derivatives those of the host (test_calls.py); one call for a batch."""
    link, q = scene.link_names[-1], jnp.asarray(arguments(scene, "forward_dynamics", 3)[0])
    task = phipsi.tasks.Position(link, (0.1, 0.2, 0.3))
    cases = [
        (lambda q: phipsi.jax.placement(scene, q, link), scene.placement(q, link), _calls.placement(scene, link)),
        (lambda q: phipsi.jax.jacobian(scene, q, link, frame="world"), scene.jacobian(q, link, frame="world"), _calls.jacobian(scene, link, "world")),
        (lambda q: phipsi.jax.mass_matrix(scene, q), scene.mass_matrix(q), _calls.mass_matrix(scene)),
        (lambda q: phipsi.jax.center_of_mass(scene, q), scene.center_of_mass(q), _calls.center_of_mass(scene)),
        (lambda q: phipsi.jax.task_residual(scene, q, task), scene.placement(q, link)[..., :3, 3] - task.target, _calls.task_residual(scene, task)),
    ]
    for function, expected, call in cases:
        assert_near(np.asarray(jax.jit(jax.vmap(function))(q)), expected, product(scene.nv, size(expected)))
        found = np.asarray(jax.jacrev(function)(q[0])).reshape(call.size, scene.nq)
        assert_near(found, call.derivatives(np.asarray(q[0]))[0], product(scene.nv, 1.0 + size(found)))
    zero = jnp.zeros(scene.nv)
    expected = scene.bias_torque(q, zero)
    assert_near(np.asarray(phipsi.jax.bias_torque(scene, q, zero)), expected, product(scene.nv, size(expected)))


def test_an_unknown_function_lists_those_that_exist() -> None:
    with pytest.raises(AttributeError, match="phipsi.jax: found no 'energy'; expected one of bias_torque, .* task_residual"):
        phipsi.jax.energy  # noqa: B018


#: Functions of phipsi.jax with compiled code, of (robot, *arguments).
COMPILED: dict[str, Callable[..., Any]] = {
    "forward_dynamics": phipsi.jax.forward_dynamics,
    "inverse_dynamics": phipsi.jax.inverse_dynamics,
    "bias_torque": lambda robot, q, qd, _: phipsi.jax.bias_torque(robot, q, qd),
    "mass_matrix": lambda robot, q, *_: phipsi.jax.mass_matrix(robot, q),
    "placement": lambda robot, q, *_: phipsi.jax.placement(robot, q, of_scene(robot).link_names[-1]),
    "jacobian": lambda robot, q, *_: phipsi.jax.jacobian(robot, q, of_scene(robot).link_names[-1]),
}


def of_scene(robot: Any) -> phipsi.Scene:
    return getattr(robot, "scene", robot)


@pytest.fixture(scope="module")
def compiled(scene: phipsi.Scene, tmp_path_factory: pytest.TempPathFactory) -> phipsi.Compiled:
    link = scene.link_names[-1]
    functions = [*list(COMPILED)[:4], "forward_dynamics_derivatives", "inverse_dynamics_derivatives", ("placement", link), ("jacobian", link)]
    return phipsi.compile(scene, functions, jax=True, flags=["-O1"], cache=tmp_path_factory.mktemp("cache"))


@pytest.mark.parametrize("name", COMPILED)
def test_compiled_functions_and_their_derivatives_are_those_of_the_scene(scene: phipsi.Scene, compiled: phipsi.Compiled, name: str) -> None:
    """Jitted, mapped and differentiated by each argument, for quaternions of any norm."""
    q, qd, tau = arguments(scene, name, 3)
    if scene.nq > scene.nv:
        q[1, 3:7] *= 1.7
    function, given = COMPILED[name], tuple(map(jnp.asarray, (q, qd, tau)))
    expected = function(scene, *given)
    found = jax.jit(lambda *x: function(compiled, *x))(*given)
    assert found.dtype == expected.dtype
    bound = product(100 * scene.nv, size(np.asarray(expected)))
    assert_near(np.asarray(found), np.asarray(expected), bound)
    assert_near(np.asarray(jax.jit(jax.vmap(lambda *x: function(compiled, *x)))(*given)), np.asarray(expected), bound)
    for at in range(3):
        by_scene = jax.jit(jax.jacrev(lambda *x: function(scene, *x).sum(0), argnums=at))(*given)
        by_code = jax.jit(jax.jacrev(lambda *x: function(compiled, *x).sum(0), argnums=at))(*given)
        assert_near(np.asarray(by_code), np.asarray(by_scene), product(1000 * scene.nv, size(np.asarray(by_scene))))


def test_a_jitted_loop_of_compiled_functions_calls_no_host(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    scene = phipsi.scenes.chain(4)
    robot = phipsi.compile(scene, ["forward_dynamics", "forward_dynamics_derivatives"], jax=True, flags=["-O1"], cache=tmp_path)
    q, qd = map(jnp.asarray, arguments(scene, "forward_dynamics")[:2])

    def end(of: Any, tau: jax.Array) -> jax.Array:
        def step(state: Any, _: None) -> Any:
            q, qd = state
            qd = qd + 1e-3 * phipsi.jax.forward_dynamics(of, q, qd, tau)
            return (q + 1e-3 * qd, qd), None

        return jnp.sum(jax.lax.scan(step, (q, qd), None, length=20)[0][0] ** 2)

    expected = jax.grad(lambda tau: end(scene, tau))(jnp.ones(scene.nv))
    calls: list[Any] = []
    monkeypatch.setattr(_calls, "on_host", lambda *given: calls.append(given))
    found = jax.jit(jax.grad(lambda tau: end(robot, tau)))(jnp.ones(scene.nv))
    assert not calls and np.abs(np.asarray(expected)).max() > 1e-6
    assert np.allclose(found, expected, rtol=1e-10, atol=0.0)


def test_bad_states_of_compiled_functions(scene: phipsi.Scene, compiled: phipsi.Compiled) -> None:
    q, qd, tau = map(jnp.asarray, arguments(scene, "forward_dynamics", 70))
    bad = tau.at[66, 1].set(jnp.nan)
    run = {errors: jax.jit(partial(phipsi.jax.forward_dynamics, compiled, errors=errors)) for errors in ("raise", "nan")}
    found = run["nan"](q, qd, bad)
    assert jnp.isnan(found[66]).all() and jnp.isfinite(jnp.delete(found, 66, axis=0)).all()
    with pytest.raises(Exception, match="forward_dynamics: state 66: found a number that is not finite"):
        run["raise"](q, qd, bad).block_until_ready()


def test_states_above_the_tolerance_are_not_silently_kept(tmp_path: Any) -> None:
    """Between a light link and a heavy one the covariance form is inaccurate."""
    builder = phipsi.SceneBuilder().link("base").link("light", 1e-9, inertia=1e-12 * np.eye(3)).link("heavy", 1e6, (0.1, 0, 0), 1e4 * np.eye(3))
    builder.joint("inner", "continuous", "base", "light", axis=(0, 1, 0))
    builder.joint("outer", "continuous", "light", "heavy", axis=(0, 1, 0))
    scene = builder.build()
    robot = phipsi.compile(scene, ["forward_dynamics"], jax=True, flags=["-O1"], cache=tmp_path)
    given = tuple(map(jnp.asarray, arguments(scene, "forward_dynamics")))
    assert jnp.isfinite(phipsi.jax.forward_dynamics(robot, *given)).all()
    assert jnp.isnan(jax.jit(partial(phipsi.jax.forward_dynamics, robot, errors="nan"))(*given)).all()
    with pytest.raises(Exception, match="state 0: found an estimated error above the tolerance"):
        jax.jit(partial(phipsi.jax.forward_dynamics, robot))(*given).block_until_ready()


def test_what_was_not_compiled_is_refused_by_name(tmp_path: Any) -> None:
    scene = phipsi.scenes.chain(2)
    robot, other = (phipsi.compile(scene, ["inverse_dynamics"], jax=jax, flags=["-O1"], cache=tmp_path) for jax in (True, False))
    q, qd, tau = arguments(scene, "forward_dynamics")
    assert np.allclose(phipsi.jax.inverse_dynamics(robot, q, qd, tau), scene.inverse_dynamics(q, qd, tau))
    with pytest.raises(ArgumentError, match="found forward_dynamics, which was not compiled; expected one of inverse_dynamics"):
        phipsi.jax.forward_dynamics(robot, q, qd, tau)
    with pytest.raises(ArgumentError, match="compiled without jax=True"):
        phipsi.jax.inverse_dynamics(other, q, qd, tau)
    with pytest.raises(ArgumentError, match="form 'square-root'"):
        phipsi.jax.forward_dynamics(robot, q, qd, tau, form="square-root")
    with pytest.raises(ArgumentError, match="expected a scene"):
        phipsi.jax.center_of_mass(robot, q)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="device='cuda'"):
        phipsi.compile(scene, device="cuda", jax=True)  # type: ignore[call-overload]
