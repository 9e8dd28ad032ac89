"""Time of one call of forward dynamics in a program of JAX: through Python, and as an operation of XLA; needs JAX 0.5 or later and a C compiler.

python benches/jax_calls.py [FILE ...]: the bundled arm, and robots of these files
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import phipsi
import phipsi.jax

jax.config.update("jax_enable_x64", True)
#: Calls per measurement, and measurements in turn, of which the fastest counts.
CALLS, TURNS = 300, 7


def seconds(run: Callable[[], Any]) -> float:
    """The time of one call."""
    began = time.perf_counter()
    for _ in range(CALLS):
        last = run()
    jax.block_until_ready(last)
    return (time.perf_counter() - began) / CALLS


def main(names: list[str]) -> None:
    print("| robot | directly | JAX, nothing else | JAX, scene | JAX, compiled | gradient, scene | gradient, compiled |\n| --- | --- | --- | --- | --- | --- | --- |")
    for name in ["arm", *names]:
        scene = phipsi.load(phipsi.BUNDLED_ARM if name == "arm" else name)
        robot = phipsi.compile(scene, ["forward_dynamics", "forward_dynamics_derivatives"], jax=True)
        q, rates = scene.integrate(scene.neutral(), np.full(scene.nv, 0.1)), np.full((2, scene.nv), 0.1)
        given = tuple(map(jnp.asarray, (q, *rates)))
        add = jax.jit(lambda q, qd, tau: qd + tau)
        runs: list[Callable[[], Any]] = [lambda: scene.forward_dynamics(q, *rates), lambda: add(*given)]
        for of in (scene, robot):
            runs.append(lambda f=jax.jit(lambda *x, of=of: phipsi.jax.forward_dynamics(of, *x)): f(*given))
        for of in (scene, robot):
            loss = jax.jit(jax.grad(lambda *x, of=of: jnp.sum(phipsi.jax.forward_dynamics(of, *x) ** 2), argnums=2))
            runs.append(lambda f=loss: f(*given))
        for run in runs:
            run()
        times = np.min([[seconds(run) for run in runs] for _ in range(TURNS)], axis=0)
        print(f"| {name} | " + " | ".join(f"{1e6 * one:.3g} us" for one in times) + " |")


if __name__ == "__main__":
    main(sys.argv[1:])
