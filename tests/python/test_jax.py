"""phipsi.jax: values, derivatives forward and reverse, jit and vmap, of robots with quaternions and without."""

from __future__ import annotations

from collections.abc import Callable, Iterator
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

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "forward_dynamics": phipsi.jax.forward_dynamics,
    "inverse_dynamics": phipsi.jax.inverse_dynamics,
    "integrate": phipsi.jax.integrate,
}


def tree() -> phipsi.Scene:
    """A floating body with a spherical joint, a slide and two hinges."""
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
    """Those of the host (test_calls.py), by every number."""
    given = arguments(scene, name)
    function = lambda *given: FUNCTIONS[name](scene, *given)  # noqa: E731
    calls = {"forward_dynamics": _calls.forward_dynamics(scene, "auto"), "inverse_dynamics": _calls.inverse_dynamics(scene)}
    expected = calls.get(name, _calls.integrate(scene)).derivatives(*given)
    every = tuple(range(len(given)))
    for of in (jax.jacfwd, jax.jacrev):
        for found, derivative in zip(of(function, argnums=every)(*given), expected, strict=True):
            assert_near(np.asarray(found), derivative, product(scene.nv, size(derivative)))


def test_gradients_inside_a_jitted_loop_are_differences() -> None:
    """Ten steps of a chain, the way that learning and predictive control use it."""
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


def test_float32_stays_float32(scene: phipsi.Scene) -> None:
    given = [jnp.asarray(argument, jnp.float32) for argument in arguments(scene, "forward_dynamics")]
    assert phipsi.jax.forward_dynamics(scene, *given).dtype == jnp.float32


def test_a_wrong_width_is_refused(scene: phipsi.Scene) -> None:
    q, qd, tau = arguments(scene, "forward_dynamics")
    with pytest.raises(Exception, match="tau"):
        jax.block_until_ready(phipsi.jax.forward_dynamics(scene, q, qd, tau[:-1]))


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
    # Of a start that all share the sum.
    loss = lambda q, qd, tau: sum((rows**2).sum() for rows in function(q, qd, tau))  # noqa: E731
    shared = jax.grad(loss)(given[0][0], given[1], given[2])
    each = jax.vmap(jax.grad(loss), in_axes=(None, 0, 0))(given[0][0], given[1], given[2])
    assert_near(np.asarray(shared), np.asarray(each).sum(axis=0), product(64 * scene.nv, size(np.asarray(each))))
