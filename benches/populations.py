"""Time of a batch whose states have a model each, relative to the same batch with one model.

Usage: python benches/populations.py [--markdown FILE] [ROBOT ...]; `make populations`. ROBOT: files; by default the bundled arm, and ur5, panda, solo12, g1 and talos where example-robot-data is installed (with Pinocchio).
"""

import argparse
import os
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from in_turns import least, write

import phipsi

STATES, TURNS, STEPS = 1000, 25, 20
NAMES = ("ur5", "panda", "solo12", "g1", "talos")


def robots(names: list[str]) -> Iterator[tuple[str, phipsi.Scene]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in names:
            yield Path(name).stem, phipsi.load(name)
        if names:
            return
        yield "bundled arm", phipsi.load(phipsi.BUNDLED_ARM)
        try:
            from robots import FILES, load
        except ImportError:
            return
        yield from ((name, load(*FILES[name])) for name in NAMES)


def row(name: str, scene: phipsi.Scene) -> str:
    rng = np.random.default_rng(0)
    q = scene.integrate(scene.neutral(), 0.5 * rng.normal(size=(STATES, scene.nv)))
    qd, tau = rng.normal(size=(2, STATES, scene.nv))
    inertias = rng.uniform(0.8, 1.2, (STATES, len(scene.body_names), 1)) * scene.inertial_parameters
    armature = scene.armature + rng.uniform(0.1, 0.2, (STATES, scene.nv))
    own, run = {"inertias": inertias, "armature": armature}, {"dt": 1e-3, "steps": STEPS, "record_every": STEPS, "limits": "report", "friction": 0.0}
    functions: list[Callable[..., object]] = [
        partial(scene.forward_dynamics, q, qd, tau),
        partial(scene.inverse_dynamics, q, qd, tau),
        partial(scene.mass_matrix, q),
        partial(scene.forward_dynamics_derivatives, q, qd, tau),
        partial(scene.simulate, q, 0.1 * qd, **run),
    ]
    cells = []
    for function in functions:
        one, many = least(TURNS, partial(function, armature=armature[0]), partial(function, **own))
        cells.append(f"{many / one:.2f}")
    scenes = [scene.with_inertial_parameters(of).with_properties(armature=dict(zip(scene.joint_names, each, strict=False))) for of, each in zip(inertias[:20], armature, strict=False)]
    (alone,) = least(3, lambda: [scene.forward_dynamics(*state) for scene, *state in zip(scenes, q, qd, tau, strict=False)])
    one, _ = least(TURNS, functions[0], lambda: None)
    return f"| {name} | " + " | ".join([*cells, f"{alone / 20 / one * STATES:.3g}"]) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robots", nargs="*", metavar="ROBOT")
    parser.add_argument("--markdown", type=Path)
    options = parser.parse_args()
    phipsi.set_num_threads(1)
    lines = [
        "| robot | forward dynamics | inverse dynamics | mass matrix | derivatives of forward dynamics | simulation | a scene per state |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, scene in robots(options.robots):
        lines.append(row(name, scene))
        print(lines[-1], flush=True)
    how = [
        f"Written by `make populations` (benches/populations.py): time of {STATES} states with {STATES} models (inertias and armature) over that of {STATES} states with one model, on one thread, minima of {TURNS} interleaved timings; load of the machine during the last 1, 5 and 15 minutes: {', '.join(f'{load:.1f}' for load in os.getloadavg())}.",
        f"**Simulation**: {STEPS} steps without stops and dry friction, the start of the run included. **A scene per state**: forward dynamics of one state in its own scene, over the time per state of the batch with one model; scenes that exist already.",
    ]
    write(options.markdown, "Models that differ between states, measured", how, lines, "scenes with connections or contacts, whose simulations compute one state after another, and the square-root form, which computes each state in a scene of its own.")


if __name__ == "__main__":
    main()
