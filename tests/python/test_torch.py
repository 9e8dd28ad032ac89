"""phipsi.torch: gradcheck, torch.func, batches; for robots with and without quaternions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tolerances import assert_near, product, size

import phipsi

torch = pytest.importorskip("torch")

import phipsi.torch  # noqa: E402
from phipsi import _calls  # noqa: E402
from phipsi.errors import ArgumentError, BadStateWarning, NotFiniteError, ShapeError  # noqa: E402

# Forward mode of torch calls deprecated functions of torch.
pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:FutureWarning", "ignore:.torch.jit.script_method.:FutureWarning")

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "forward_dynamics": phipsi.torch.forward_dynamics,
    "inverse_dynamics": phipsi.torch.inverse_dynamics,
    "integrate": phipsi.torch.integrate,
}


def floating() -> phipsi.Scene:
    builder = phipsi.SceneBuilder()
    for name in ("body", "ball", "arm"):
        builder.link(name, mass=1.3, com=(0.05, -0.02, 0.1), inertia=np.diag([0.02, 0.03, 0.025]))
    builder.joint("shoulder", "spherical", "body", "ball", xyz=(0.1, 0.0, 0.2))
    builder.joint("elbow", "revolute", "ball", "arm", xyz=(0.0, 0.0, 0.3), axis=(0, 1, 0))
    return builder.build(floating_base=True)


SCENES = {"chain": lambda: phipsi.scenes.chain(4), "floating": floating}


def arguments(scene: phipsi.Scene, name: str, *batch: int) -> list[Any]:
    random = np.random.default_rng(5)
    q = scene.integrate(np.broadcast_to(scene.neutral(), (*batch, scene.nq)), random.uniform(-1, 1, (*batch, scene.nv)))
    rates = random.uniform(-1, 1, (2, *batch, scene.nv))
    given = (q, rates[0]) if name == "integrate" else (q, *rates)
    return [torch.tensor(argument, requires_grad=True) for argument in given]


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_gradcheck(kind: str, name: str) -> None:
    scene = SCENES[kind]()
    function = lambda *given: FUNCTIONS[name](scene, *given)  # noqa: E731
    assert torch.autograd.gradcheck(function, arguments(scene, name, 2), check_forward_ad=True)


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_vmap_and_jacobians(kind: str, name: str) -> None:
    scene = SCENES[kind]()
    function = lambda *given: FUNCTIONS[name](scene, *given)  # noqa: E731
    given = [argument.detach() for argument in arguments(scene, name, 3)]
    expected = getattr(scene, name)(*(argument.numpy() for argument in given))
    assert_near(torch.vmap(function)(*given).numpy(), expected, product(scene.nv, size(expected)))
    for of in (torch.func.jacrev, torch.func.jacfwd):
        found = torch.vmap(of(function))(*given)
        each = torch.stack([of(function)(*row) for row in zip(*given, strict=True)])
        assert_near(found.numpy(), each.numpy(), product(scene.nv, size(each.numpy())))


@pytest.mark.parametrize("kind", SCENES)
def test_gradients_of_a_rollout(kind: str) -> None:
    scene = SCENES[kind]()
    q, qd, _ = arguments(scene, "forward_dynamics", 2)
    tau = torch.tensor(np.random.default_rng(2).uniform(-1, 1, (2, 5, scene.nv)), requires_grad=True)
    function = lambda *given: phipsi.torch.simulate(scene, *given, dt=0.02, record_every=2, method="rk4")  # noqa: E731
    assert torch.autograd.gradcheck(function, (q, qd, tau))
    given = [argument.detach() for argument in (q, qd, tau)]
    path = scene.simulate(*(a.numpy() for a in given[:2]), tau_steps=given[2].numpy(), dt=0.02, steps=5, record_every=2, method="rk4")
    for found in (function(*given), torch.vmap(function)(*given)):
        assert_near(found[0].numpy(), path.q, product(scene.nv, size(path.q)))
        assert_near(found[1].numpy(), path.qd, product(scene.nv, size(path.qd)))
    loss = lambda *given: sum((rows**2).sum() for rows in function(*given))  # noqa: E731
    every = torch.func.grad(loss, argnums=(0, 1, 2))(*given)
    each = torch.vmap(torch.func.grad(loss, argnums=(0, 1, 2)))(*given)
    for one, other in zip(every, each, strict=True):
        assert_near(one.numpy(), other.numpy(), product(64 * scene.nv, size(one.numpy())))


@pytest.mark.parametrize("dtype", ["bfloat16", "float16", "float32", "float64"])
def test_results_have_the_dtype_of_the_promotion(dtype: str) -> None:
    scene = phipsi.scenes.chain(3)
    given = [argument.detach().to(getattr(torch, dtype)) for argument in arguments(scene, "forward_dynamics")]
    assert phipsi.torch.forward_dynamics(scene, *given).dtype == getattr(torch, dtype)
    assert phipsi.torch.forward_dynamics(scene, given[0].int(), *given[1:]).dtype == getattr(torch, dtype)
    wider = [given[0], given[1].requires_grad_(), given[2].double()]
    found = phipsi.torch.forward_dynamics(scene, *wider)
    found.sum().backward()
    assert found.dtype == torch.float64 and given[1].grad.dtype == getattr(torch, dtype)


@pytest.mark.parametrize("of", [torch.tensor, np.array, list])
def test_integers_are_converted_as_by_the_scene(of: Callable[..., Any]) -> None:
    scene = phipsi.scenes.chain(3)
    q, qd, tau = [[1, 0, -1], [2, 1, -1], [0, 3, 1]]
    expected = scene.forward_dynamics(q, qd, tau)
    found = phipsi.torch.forward_dynamics(scene, of(q), of(qd), of(tau))
    assert found.dtype == (torch.get_default_dtype() if of is torch.tensor else torch.float64)
    assert_near(found.double().numpy(), expected, np.finfo(np.float32).eps * size(expected))
    rows = phipsi.torch.simulate(scene, of(q), torch.tensor(qd, dtype=torch.float64), torch.zeros(4, 3, dtype=torch.int64), dt=0.01)
    assert_near(rows[1].numpy(), scene.simulate(q, qd, dt=0.01, steps=4).qd, product(3, size(expected)))


@pytest.mark.parametrize("dtype", ["complex128", "bool"])
@pytest.mark.parametrize("name", [*FUNCTIONS, "simulate"])
def test_other_numbers_are_refused_as_by_the_scene(name: str, dtype: str) -> None:
    scene = phipsi.scenes.chain(3)
    given = [argument.detach() for argument in arguments(scene, "integrate" if name == "integrate" else "forward_dynamics")]
    given[1] = given[1].to(getattr(torch, dtype))
    function = FUNCTIONS.get(name, lambda scene, *given: phipsi.torch.simulate(scene, *given[:2], given[2][None], dt=0.01))
    with pytest.raises(ArgumentError, match=f"^(qd|v): found dtype {dtype}; expected an array of real numbers"):
        function(scene, *given)


@pytest.mark.parametrize("at", range(3))
def test_a_wrong_width_is_refused(at: int) -> None:
    scene = floating()
    given = [argument.detach() for argument in arguments(scene, "forward_dynamics", 2)]
    given[at] = given[at][..., :1]
    for function in (phipsi.torch.forward_dynamics, lambda scene, q, qd, tau: phipsi.torch.simulate(scene, q, qd, tau[:, None], dt=0.01)):
        with pytest.raises(ShapeError, match=rf"^{('q', 'qd', 'tau')[at]}: found shape .*; expected \(\.\.\., .*{(scene.nq, scene.nv, scene.nv)[at]}\)$"):
            function(scene, *given)


def test_a_gradient_by_a_constant_is_refused() -> None:
    scene = phipsi.scenes.chain(3)
    zeros, damping = torch.zeros(3), torch.ones(3, requires_grad=True)
    with pytest.raises(ArgumentError, match="damping: found a tensor that requires gradients"):
        phipsi.torch.simulate(scene, zeros, zeros, zeros[None], dt=0.01, damping=damping)


@pytest.mark.parametrize("kind", SCENES)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_bad_states_are_nan(kind: str, name: str) -> None:
    scene = SCENES[kind]()
    given = [argument.detach() for argument in arguments(scene, name, 4)]
    expected = FUNCTIONS[name](scene, *given)
    given[1][2, 0] = torch.nan
    given[1].requires_grad_()
    with pytest.warns(BadStateWarning, match="1 of 4 states"):
        found = FUNCTIONS[name](scene, *given, errors="nan")
        found[[0, 1, 3]].sum().backward()
    good = [0, 1, 3]
    assert torch.isnan(found[2]).all() and torch.equal(found[good], expected[good])
    assert torch.isnan(given[1].grad[2]).all() and torch.isfinite(given[1].grad[good]).all()
    with pytest.raises(NotFiniteError, match="state 2"):
        FUNCTIONS[name](scene, *given)


def test_bad_rollouts_are_nan() -> None:
    scene = floating()
    q, qd, _ = (argument.detach() for argument in arguments(scene, "forward_dynamics", 3))
    tau = torch.ones(3, 4, scene.nv, dtype=torch.float64)
    tau[1, 2, 3] = torch.inf
    tau.requires_grad_()
    with pytest.warns(BadStateWarning, match="1 of 3 states"):
        rows, _ = phipsi.torch.simulate(scene, q, qd, tau, dt=0.01, errors="nan")
    rows[[0, 2]].sum().backward()
    assert torch.isnan(rows[1]).all() and torch.isfinite(rows[[0, 2]]).all()
    assert torch.isnan(tau.grad[1]).all() and torch.isfinite(tau.grad[[0, 2]]).all()


def test_functions_of_configurations_and_their_gradients() -> None:
    """Values are those of the scene; derivatives those of the host (test_calls.py)."""
    scene = phipsi.load(phipsi.BUNDLED_ARM, floating_base=True)
    link, given = "flange", scene.random_configuration(3, size=2)
    q, task = torch.tensor(given), phipsi.tasks.Position("flange", (0.1, 0.2, 0.3))
    cases = [
        (lambda q: phipsi.torch.placement(scene, q, link), scene.placement(given, link), _calls.placement(scene, link)),
        (lambda q: phipsi.torch.jacobian(scene, q, link, frame="world"), scene.jacobian(given, link, frame="world"), _calls.jacobian(scene, link, "world")),
        (lambda q: phipsi.torch.mass_matrix(scene, q), scene.mass_matrix(given), _calls.mass_matrix(scene)),
        (lambda q: phipsi.torch.center_of_mass(scene, q), scene.center_of_mass(given), _calls.center_of_mass(scene)),
        (lambda q: phipsi.torch.task_residual(scene, q, task), scene.placement(given, link)[..., :3, 3] - task.target, _calls.task_residual(scene, task)),
    ]
    for function, expected, call in cases:
        assert_near(function(q).numpy(), expected, product(scene.nv, size(expected)))
        found = torch.func.jacrev(function)(q[0]).numpy().reshape(call.size, scene.nq)
        assert_near(found, call.derivatives(given[0])[0], product(scene.nv, 1.0 + size(found)))
    zero = torch.zeros(scene.nv, dtype=torch.float64)
    expected = scene.bias_torque(given, np.zeros(scene.nv))
    assert_near(phipsi.torch.bias_torque(scene, q, zero).numpy(), expected, product(scene.nv, size(expected)))


def test_an_unknown_function_lists_those_that_exist() -> None:
    with pytest.raises(AttributeError, match="phipsi.torch: found no 'energy'; expected one of bias_torque, .* task_residual"):
        phipsi.torch.energy  # noqa: B018
