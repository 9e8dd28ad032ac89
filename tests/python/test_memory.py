"""Sizes that exceed the memory raise an error with the name of the argument: they never terminate the interpreter."""

from __future__ import annotations

import inspect
import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from large_calls import LARGE, NO_MEMORY, Large

import phipsi
from phipsi import _core
from phipsi._glossary import HINTS
from phipsi.errors import ArgumentError, OutOfMemoryError

#: Names of parameters that determine a number of elements.
SIZES = {
    "n", "bodies", "count", "directions", "draws", "length", "links", "number", "record_every", "repeats", "replicates", "rows", "samples",
    "size", "states", "steps",
}  # fmt: skip

#: Methods with states of any batch size that allocate nothing per state, and the observer, whose arrays are those of NumPy.
NO_BATCH = {"lock", "random_model", "check", "observer"}


def public() -> Iterator[tuple[str, str, list[str]]]:
    """Object, name and parameter names of each public function or method."""
    scopes = {"": phipsi, "scenes": phipsi.scenes, "_core": _core}
    for scope in (phipsi.Scene, phipsi.Loops, phipsi.Contacts, phipsi.SceneBuilder, phipsi.RandomModel, phipsi.Factor, phipsi.Simulator, _core.Exact):
        scopes[scope.__name__] = scope
    for place, scope in scopes.items():
        for name in vars(scope):
            if name.startswith("_") or name in HINTS or not inspect.isroutine(thing := getattr(scope, name)):
                continue
            yield place, name, list(inspect.signature(thing).parameters)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of the address space are Linux's")
@pytest.mark.parametrize(("name", "large"), LARGE.items(), ids=LARGE.keys())
def test_too_large_is_refused_by_name(name: str, large: Large) -> None:
    child = Path(__file__).with_name("large_calls.py")
    run = subprocess.run([sys.executable, str(child), name], capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, f"ended with {run.returncode}: {run.stderr[-2000:]}"
    assert run.stdout, "nothing was refused"
    found = json.loads(run.stdout)
    assert found["argument"] == large.argument, found
    assert re.match(rf"{re.escape(large.argument)}: no room for (.*, )?\d+ bytes", found["text"]), found
    assert found["class"] == "OutOfMemoryError" and found["after"]


def test_every_parameter_that_is_a_size_is_tried() -> None:
    tried = NO_MEMORY.union(*(large.covers for large in LARGE.values()))
    sizes = {f"{name}.{parameter}" for _, name, parameters in public() for parameter in parameters if parameter in SIZES}
    assert sizes <= tried, sorted(sizes - tried)


#: Classes with methods of states, and how large_calls begins their names.
GROUPS = {"Scene": "", "Loops": "loops.", "Contacts": "contacts."}


def test_every_method_with_a_batch_is_tried() -> None:
    batched = {
        f"{GROUPS[place]}{name}" for place, name, parameters in public() if place in GROUPS and {"q", "q0"} & set(parameters) and name not in NO_BATCH
    }
    assert batched <= set(LARGE), sorted(batched - set(LARGE))


COUNTS: dict[str, tuple[str, Callable[[phipsi.Scene, object], object]]] = {
    "chain": ("n", lambda scene, count: phipsi.scenes.chain(count)),
    "extreme": ("bodies", lambda scene, count: phipsi.scenes.extreme("heavy-tip", bodies=count)),
    "extreme, seed": ("seed", lambda scene, count: phipsi.scenes.extreme("heavy-tip", seed=count)),
    "sample": ("samples", lambda scene, count: scene.random_model(np.zeros(7)).sample(count, seed=1)),
    "sample, seed": ("seed", lambda scene, count: scene.random_model(np.zeros(7)).sample(3, seed=count)),
    "sample_torque": ("samples", lambda scene, count: scene.random_model(np.zeros(7)).sample_torque(count, seed=1)),
    "mass_matrix": ("samples", lambda scene, count: scene.random_model(np.zeros(7)).mass_matrix(count, seed=1)),
    "replicates": (
        "replicates",
        lambda scene, count: scene.random_model(np.zeros(7)).mass_matrix(8, seed=1, method="sobol", replicates=count),
    ),
    "steps": ("steps", lambda scene, count: scene.simulate(np.zeros(7), np.zeros(7), dt=1e-3, steps=count)),
    "record_every": (
        "record_every",
        lambda scene, count: scene.simulate(np.zeros(7), np.zeros(7), dt=1e-3, steps=4, record_every=count),
    ),
    "simulator.step": ("steps", lambda scene, count: scene.simulator(np.zeros(7), dt=1e-3).step(None, count)),
    "growth": ("bodies", lambda scene, count: _core.growth(count, 1)),
    "repeats": ("repeats", lambda scene, count: _core.growth(2, count)),
    "operator_growth": ("bodies", lambda scene, count: _core.operator_growth(count, 1)),
    "emergence": ("repeats", lambda scene, count: _core.emergence(scene, np.zeros(7), "recursion", 1, 0, count)),
    "emergence, samples": ("samples", lambda scene, count: _core.emergence(scene, np.zeros(7), "recursion", count, 0, 1)),
}

NO_COUNTS = [-1, -(10**30), 10**30, 2**64, 1.5, 3.0, "three", None, True, np.bool_(True), np.array([3, 4]), np.nan]


#: Arguments that may be None.
MAY_BE_NONE = ("bodies", "record_every", "replicates", "samples")


@pytest.mark.parametrize(
    ("argument", "call", "count"),
    [
        pytest.param(argument, call, count, id=f"{name}-{count!r}")
        for name, (argument, call) in COUNTS.items()
        for count in NO_COUNTS
        if count is not None or argument not in MAY_BE_NONE
    ],
)
def test_what_is_no_count_is_refused_by_name(
    chain: phipsi.Scene, argument: str, call: Callable[[phipsi.Scene, object], object], count: object
) -> None:
    with pytest.raises(ArgumentError, match=argument) as caught:
        call(chain, count)
    assert caught.value.argument == argument


@pytest.mark.parametrize("count", [8, np.int64(8), np.uint8(8), np.array(8)], ids=["int", "int64", "uint8", "0-d"])
@pytest.mark.parametrize(("argument", "call"), COUNTS.values(), ids=COUNTS.keys())
def test_numbers_of_numpy_count(
    chain: phipsi.Scene, argument: str, call: Callable[[phipsi.Scene, object], object], count: object
) -> None:
    if argument == "replicates":
        assert call(chain, count) is not None
    else:
        call(chain, count)


def test_more_than_is_free_is_refused_and_not_promised(chain: phipsi.Scene) -> None:
    """Less than the machine has, so that the system would grant it and terminate the process on writing."""
    with open("/proc/meminfo") as file:
        lines = dict(line.split(":") for line in file)
    free = 1024 * (int(lines["MemAvailable"].split()[0]) + int(lines["SwapFree"].split()[0]))
    model = chain.random_model(np.zeros(7))
    with pytest.raises(OutOfMemoryError, match="bytes.* are free") as caught:
        model.sample(int(1.02 * free / (13 * 7 * 8)), seed=1)
    error = caught.value
    assert error.argument == "samples" and error.free is not None and error.bytes > 0.9 * error.free


@pytest.fixture(scope="module")
def chain() -> phipsi.Scene:
    return phipsi.scenes.chain(7)
