"""phipsi.torch: gradcheck, torch.func, batches; of robots with quaternions and without."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tolerances import assert_near, product, size

import phipsi

torch = pytest.importorskip("torch")

import phipsi.torch  # noqa: E402

# Forward mode of torch calls what torch itself has deprecated.
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
