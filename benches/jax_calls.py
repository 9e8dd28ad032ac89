"""Time of one call of forward dynamics in a jitted program of JAX: through Python, and as an operation of XLA.

Usage: python benches/jax_calls.py [--markdown FILE] [ROBOT ...]; `make jax-calls`. ROBOT: files, besides the bundled arm. Needs a C compiler and JAX 0.5 or later.
"""

import argparse
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from in_turns import least, write

import phipsi
import phipsi.jax

jax.config.update("jax_enable_x64", True)
CALLS, TURNS = 300, 9


def repeated(run: Callable[[], Any]) -> None:
    for _ in range(CALLS):
        last = run()
    jax.block_until_ready(last)


def row(name: str) -> str:
    scene = phipsi.load(phipsi.BUNDLED_ARM if name == "bundled arm" else name)
    robot = phipsi.compile(scene, ["forward_dynamics", "forward_dynamics_derivatives"], jax=True)
    q, rates = scene.integrate(scene.neutral(), np.full(scene.nv, 0.1)), np.full((2, scene.nv), 0.1)
    given = tuple(map(jnp.asarray, (q, *rates)))

    def loss(of: Any, *state: jax.Array) -> jax.Array:
        return jnp.sum(phipsi.jax.forward_dynamics(of, *state) ** 2)

    jitted = [jax.jit(lambda q, qd, tau: qd + tau)]
    jitted += [jax.jit(partial(phipsi.jax.forward_dynamics, of)) for of in (scene, robot)]
    jitted += [jax.jit(jax.grad(partial(loss, of), argnums=2)) for of in (scene, robot)]
    runs = [partial(scene.forward_dynamics, q, *rates), *(partial(one, *given) for one in jitted)]
    for run in runs:
        run()
    times = least(TURNS, *(partial(repeated, run) for run in runs))
    return f"| {name} | " + " | ".join(f"{1e6 * one / CALLS:.3g}" for one in times) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robots", nargs="*", metavar="ROBOT")
    parser.add_argument("--markdown", type=Path)
    options = parser.parse_args()
    lines = [
        "| robot | without JAX | sum of two arguments | scene | compiled | gradient, scene | gradient, compiled |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        *map(row, ["bundled arm", *options.robots]),
    ]
    print("\n".join(lines))
    how = [
        f"Written by `make jax-calls` (benches/jax_calls.py), JAX {jax.__version__}: microseconds per call of forward dynamics of one state, minimum of {TURNS} interleaved timings of {CALLS} calls; load of the machine during the last 1, 5 and 15 minutes: {', '.join(f'{load:.1f}' for load in os.getloadavg())}.",
        "**Scene**: `phipsi.jax.forward_dynamics(scene, ...)`, a callback. **Compiled**: with `phipsi.compile(scene, ..., jax=True)` in place of the scene. **Sum of two arguments**: a program that does nothing else, the time of JAX itself. **Gradients**: of the sum of squared accelerations with respect to torques.",
    ]
    write(options.markdown, "Calls from JAX, measured", how, lines, "batches, whose time per state is that of [batches](../how-to/batches.md) in both.")


if __name__ == "__main__":
    main()
