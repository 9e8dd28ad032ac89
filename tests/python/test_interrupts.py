"""Every long call can be interrupted by Ctrl-C and leaves scenes unchanged."""

from __future__ import annotations

import functools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import join
from long_calls import LONG
from tolerances import assert_same_bits

import phipsi

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals to oneself")



def bound(pace: float) -> float:
    """Processor time, s. The documented bound is 0.2 s; two threads may use it twice, and builds without optimization
    get more, in proportion to their time for a scene.
    """
    return 1.0 + 40 * pace



@pytest.mark.parametrize("name", LONG)
def test_a_long_call_ends_soon_after_ctrl_c(name: str) -> None:
    child = Path(__file__).with_name("long_calls.py")
    run = subprocess.run([sys.executable, str(child), name], capture_output=True, text=True, timeout=600, check=False)
    assert run.returncode == 0, run.stderr[-2000:]
    found = json.loads(run.stdout)
    assert found["raised"] in ("KeyboardInterrupt", "SimulationInterrupted"), found
    assert found["late"] < bound(found["pace"]) and found["after"], found


class Alarm(Exception):
    """Exception of a custom handler."""


@pytest.fixture
def alarm() -> Iterator[None]:
    def handle(number: int, frame: object) -> None:
        raise Alarm

    before = signal.signal(signal.SIGALRM, handle)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


def test_any_handler_is_called_and_what_it_raises_is_raised(alarm: None) -> None:
    model = phipsi.scenes.chain(7).random_model(np.zeros(7))
    signal.setitimer(signal.ITIMER_REAL, 0.1)
    with pytest.raises(Alarm):
        model.mass_matrix(2**40, seed=1)


def test_a_handler_that_raises_nothing_changes_nothing() -> None:
    """The handler may call the interrupted method."""
    scene = phipsi.scenes.chain(7)
    model, factor = scene.random_model(np.full(7, 0.2)), scene.factor(np.full((2000, 7), 0.2))
    expected = model.mass_matrix(1_000_000, seed=1).mass_matrix
    called: list[float] = []

    def handle(number: int, frame: object) -> None:
        called.append(float(factor.solve(np.ones(7))[0, 0] + model.mass_matrix(20_000, seed=2).mass_matrix[0, 0]))

    before = signal.signal(signal.SIGALRM, handle)
    signal.setitimer(signal.ITIMER_REAL, 0.02)
    try:
        found = model.mass_matrix(1_000_000, seed=1).mass_matrix
        while not called:
            factor.update(np.full((2000, 7), 0.3))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert_same_bits(found, expected)


def test_an_interrupted_scene_and_factor_go_on_as_they_were(alarm: None) -> None:
    scene = phipsi.scenes.chain(7)
    q = np.linspace(-1, 1, 7 * 4000).reshape(4000, 7)
    factor = scene.factor(q)
    before, qdd = factor.solve(np.ones(7)), scene.forward_dynamics(q, q, q)
    signal.setitimer(signal.ITIMER_REAL, 0.05)
    with pytest.raises(Alarm):
        while True:
            factor.update(q + 1e-3)
            factor.update(q)
    moved = factor.solve(np.ones(7))
    fresh = scene.factor(q + 1e-3).solve(np.ones(7))
    assert np.array_equal(moved, before) or np.allclose(moved, fresh, rtol=1e-9)
    signal.setitimer(signal.ITIMER_REAL, 0.05)
    with pytest.raises(Alarm):
        while True:
            scene.forward_dynamics(np.tile(q, (20, 1)), q[0], q[0])
    assert_same_bits(scene.forward_dynamics(q, q, q), qdd)


def test_other_threads_are_not_interrupted(interruptible: None) -> None:
    """Only the main thread handles Ctrl-C."""
    model = phipsi.scenes.chain(7).random_model(np.zeros(7))
    found: list[phipsi.MassEstimate] = []
    other = threading.Thread(target=lambda: found.append(model.mass_matrix(1_000_000, seed=1)), daemon=True)
    other.start()
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(60)
    join(other)
    assert len(found) == 1 and np.isfinite(found[0].mass_matrix).all()


class Method:
    """A handler that is a method, and one that is an object with __call__."""

    def handle(self, number: int, frame: object) -> None:
        raise Alarm

    __call__ = handle


def slow(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    """Torques whose computation is interrupted by a handler in most cases."""
    for _ in range(2000):
        qd = -qd
    return np.zeros(7)


HANDLERS: dict[str, object] = {
    "function": None,
    "method": Method().handle,
    "object": Method(),
    "partial": functools.partial(Method.handle, None),
}
MOVING = {
    "simulate": lambda scene: scene.simulate(np.full(7, 0.3), np.zeros(7), dt=1e-5, steps=10**9, record_every=10**8),
    "tau": lambda scene: scene.simulate(np.full(7, 0.3), np.zeros(7), dt=1e-5, steps=10**9, record_every=10**8, tau=slow),
    "progress": lambda scene: scene.simulate(
        np.full(7, 0.3), np.zeros(7), dt=1e-5, steps=10**9, record_every=10**8, progress=lambda done, steps: time.sleep(0.2)
    ),
    "simulator": lambda scene: scene.simulator(np.full(7, 0.3), dt=1e-5).step(steps=10**9),
    "ode": lambda scene: scene.ode(tau=slow).solve(np.full(7, 0.3), np.zeros(7), (0.0, 1e6), max_steps=10**9),
    "argument": lambda scene: [scene.bias_torque(Slow(), np.zeros(7)) for _ in range(10**6)],
}


class Slow:
    """An array whose conversion is interrupted in most cases."""

    def __array__(self, dtype: object = None, copy: object = None) -> np.ndarray:
        time.sleep(1e-3)
        return np.zeros(7)


@pytest.mark.parametrize("handler", HANDLERS)
@pytest.mark.parametrize("name", MOVING)
def test_what_a_handler_raises_in_a_motion_is_raised_unchanged(alarm: None, name: str, handler: str) -> None:
    """It is no error of the motion, of the function for tau, or of an argument."""
    if HANDLERS[handler] is not None:
        signal.signal(signal.SIGALRM, HANDLERS[handler])  # type: ignore[arg-type]
    scene = phipsi.scenes.chain(7)
    signal.setitimer(signal.ITIMER_REAL, 0.1)
    with pytest.raises(Alarm):
        MOVING[name](scene)


def test_the_same_exception_of_a_function_is_an_error_of_the_motion(alarm: None) -> None:
    def broken(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        raise Alarm

    with pytest.raises(phipsi.errors.SimulationError, match="step 0 .*Alarm") as found:
        phipsi.scenes.chain(7).simulate(np.full(7, 0.3), np.zeros(7), dt=1e-3, steps=10, tau=broken)
    assert isinstance(found.value.__cause__, Alarm)
