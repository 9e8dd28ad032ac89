"""Compiled robots by kind of state, cost of the error estimate, and cost of a call: tables of benches/compiled.py."""

import math
import tempfile
import time
import timeit
from collections.abc import Callable, Iterator
from functools import partial

import closed_loops
import numpy as np
import phipsi
import phipsi._compile
from in_turns import least

#: Robots of all tables.
ROBOTS = ("ur5", "panda", "g1")
#: Sizes of batches, to find the smallest one for which compiled code is faster.
COUNTS = (8, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)
#: Functions of the table of calls, and their numbers of arrays.
CALLS = {
    "forward_dynamics": 3,
    "inverse_dynamics": 3,
    "mass_matrix": 1,
    "mass_matrix_inverse": 1,
    "forward_dynamics_derivatives": 3,
    "inverse_dynamics_derivatives": 3,
    "forward_dynamics_jvp": 6,
    "forward_dynamics_vjp": 4,
}
#: Functions with an error estimate.
WATCHED = ("forward_dynamics", "mass_matrix_inverse", "forward_dynamics_derivatives", "forward_dynamics_jvp", "forward_dynamics_vjp")
#: Not compiled for a humanoid here, because the compilation takes minutes.
LONG = ("forward_dynamics_derivatives", "inverse_dynamics_derivatives", "forward_dynamics_jvp", "forward_dynamics_vjp")


class Counting:
    """A scene that counts the states for which forward dynamics is requested."""

    def __init__(self, scene: phipsi.Scene) -> None:
        self.scene, self.states = scene, 0

    def forward_dynamics(self, q: np.ndarray, *others: np.ndarray, **options: str) -> np.ndarray:
        self.states += len(q)
        return self.scene.forward_dynamics(q, *others, **options)


def states(scene: phipsi.Scene, count: int) -> Iterator[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """Description and states of a kind: q, qd, tau."""
    random, still = np.random.default_rng(0), np.zeros((count, scene.nv))
    q = scene.integrate(scene.neutral(), random.uniform(-1, 1, (count, scene.nv)))
    qd, tau = random.uniform(-1, 1, (2, count, scene.nv))
    held = scene.gravity_torque(q)
    yield "random", q, qd, tau
    yield "passive, at rest, neutral", np.tile(scene.neutral(), (count, 1)), still, still
    yield "static equilibrium", q, still, held
    yield "passive, moving", q, qd, still
    yield "static equilibrium, one joint moving", q, np.eye(scene.nv)[np.arange(count) % scene.nv], held


def by_state(scenes: dict[str, phipsi.Scene], count: int, turns: int) -> Iterator[str]:
    """Forward dynamics for each kind of state, in both forms, and the number of recomputed states."""
    yield "| robot | state | scene, ns per state | compiled, with estimate | recomputed | scene, covariance | compiled, covariance |"
    yield "| --- | --- | --- | --- | --- | --- | --- |"
    for name, scene in scenes.items():
        watched, plain = (phipsi.compile(scene, ["forward_dynamics"], form=form) for form in ("auto", "covariance"))
        for kind, *state in states(scene, count):
            calls = [partial(scene.forward_dynamics, *state), partial(watched.forward_dynamics, *state)]
            calls += [partial(scene.forward_dynamics, *state, form="covariance"), partial(plain.forward_dynamics, *state)]
            times = [f"{1e9 * time / count:.0f}" for time in least(turns, *calls)]
            watched.scene = counting = Counting(scene)
            watched.forward_dynamics(*state)
            watched.scene = scene
            yield f"| {name} | {kind} | {times[0]} | {times[1]} | {counting.states} of {count} | {times[2]} | {times[3]} |"


def of_loops(count: int, turns: int) -> Iterator[str]:
    """Robots on the ground: both functions that are computed through the connections, with and without the estimate."""
    yield "| robot | joints, rows | function | scene, ns per state | compiled, with estimate | scene, covariance | compiled, covariance | recomputed | tree, ns per state | compiling, s | largest difference |"
    yield "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |"
    for name in ("solo12 on four points", "anymal on four points"):
        scene = closed_loops.held(*closed_loops.CASES[name])
        tree = scene.without_constraints()
        few = closed_loops.states(scene)
        at = tuple(np.tile(array, (count // closed_loops.STATES + 1, 1))[:count] for array in few)
        rows = len(scene.loops.error(at[0][0]))
        for function in ("forward_dynamics", "constrained_dynamics"):
            with tempfile.TemporaryDirectory() as directory:
                begin = time.perf_counter()
                watched = phipsi.compile(scene, [function], cache=directory)
                compiling = time.perf_counter() - begin
                plain = phipsi.compile(scene, [function], form="covariance", cache=directory)
                calls = [partial(getattr(of, function), *at) for of in (scene, watched)]
                calls += [partial(getattr(scene, function), *at, form="covariance"), partial(getattr(plain, function), *at)]
                calls.append(partial(tree.forward_dynamics, *at))
                *times, alone = (f"{1e9 * seconds / count:.0f}" for seconds in least(turns, *calls))
                qdd = [np.asarray(getattr(call(), "qdd", None) if function == "constrained_dynamics" else call()) for call in calls[:4]]
                apart = max(float(np.max(np.abs(found - qdd[0]))) for found in qdd) / float(np.max(np.abs(qdd[0])))
                again = ""
                if function == "forward_dynamics":
                    watched.scene = counting = Counting(scene)
                    watched.forward_dynamics(*at)
                    again = f"{counting.states} of {count}"
            yield f"| {name} | {scene.nv}, {rows} | {function.replace('_', ' ')} | {' | '.join(times)} | {again} | {alone} | {compiling:.1f} | {apart:.0e} |"


def of_watch(scenes: dict[str, phipsi.Scene], count: int, turns: int) -> Iterator[str]:
    """Each function with an error estimate, by the scene and compiled, with and without the estimate."""
    yield "| robot | function | scene, ns per state | compiled, with estimate | compiled, covariance |"
    yield "| --- | --- | --- | --- | --- |"
    for name, scene in scenes.items():
        functions = [function for function in WATCHED if name != "g1" or function not in LONG]
        watched, plain = (phipsi.compile(scene, functions, form=form) for form in ("auto", "covariance"))
        for function in functions:
            given = _given(scene, function, (count,))
            times = least(turns, *(partial(getattr(of, function), *given) for of in (scene, watched, plain)))
            yield f"| {name} | {function.replace('_', ' ')} | {' | '.join(f'{1e9 * time / count:.0f}' for time in times)} |"


def of_calls(scenes: dict[str, phipsi.Scene], turns: int) -> Iterator[str]:
    """Time of a call with few states by the scene and by compiled code, and the smallest batch for which compiled code
    is faster.
    """
    yield "| robot | function | one state: scene, us | compiled | 8 states: scene, us | machine code | equal at, states | used from |"
    yield "| --- | --- | --- | --- | --- | --- | --- | --- |"
    for name, scene in scenes.items():
        functions = [function for function in CALLS if name != "g1" or function not in LONG]
        usual = phipsi.compile(scene, functions)
        always = _always(scene, functions)
        for function in functions:
            one = _both(scene, usual, function, (), turns)
            times = {count: _both(scene, always, function, (count,), turns) for count in COUNTS}
            even = next((f"{count}" for count, (own, compiled) in times.items() if compiled <= own), f"over {COUNTS[-1]}")
            cells = [f"{1e6 * time:.1f}" for time in (*one, *times[8])]
            yield f"| {name} | {function.replace('_', ' ')} | {' | '.join(cells)} | {even} | {phipsi._compile.FEW[function]} |"


def _always(scene: phipsi.Scene, functions: list[str]) -> phipsi.Compiled:
    """Compiled so that batches of few states use the machine code too."""
    few = phipsi._compile.FEW
    phipsi._compile.FEW = dict.fromkeys(few, 2)
    try:
        return phipsi.compile(scene, functions)
    finally:
        phipsi._compile.FEW = few


def _both(scene: phipsi.Scene, fast: phipsi.Compiled, function: str, batch: tuple[int, ...], turns: int) -> tuple[float, float]:
    """Seconds per call of the scene and of the compiled function."""
    given = _given(scene, function, batch)
    repeats = max(5, 200 // max(1, math.prod(batch)))
    return _shortest(partial(getattr(scene, function), *given), turns, repeats), _shortest(partial(getattr(fast, function), *given), turns, repeats)


def _given(scene: phipsi.Scene, function: str, batch: tuple[int, ...]) -> list[np.ndarray]:
    """Random arguments."""
    random = np.random.default_rng(0)
    q = scene.integrate(scene.neutral(), random.uniform(-1, 1, (*batch, scene.nv)))
    return [q, *(random.uniform(-1, 1, (*batch, scene.nv)) for _ in range(CALLS[function] - 1))]


def _shortest(call: Callable[[], object], turns: int, repeats: int) -> float:
    return min(timeit.repeat(call, number=repeats, repeat=20 * turns)) / repeats
