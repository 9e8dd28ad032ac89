"""Scenes in several processes and threads."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import subprocess
import sys
import threading
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from conftest import PATIENCE, State, join, methods, random_scene, random_states
from tolerances import assert_same_bits

import phipsi
from phipsi.errors import ArgumentError, SceneError, SingularJointError


@pytest.mark.parametrize("protocol", range(2, pickle.HIGHEST_PROTOCOL + 1))
@pytest.mark.parametrize("floating_base", [False, True])
def test_a_pickled_scene_has_the_same_bits(method: str, protocol: int, floating_base: bool) -> None:
    scene = random_scene(7, 11, armature=0.1, floating_base=floating_base)
    again: phipsi.Scene = pickle.loads(pickle.dumps(scene, protocol))
    assert repr(again) == repr(scene)
    assert again.joint_names == scene.joint_names and again.link_names == scene.link_names
    for mine, other in zip(scene.limits, again.limits, strict=True):
        assert_same_bits(mine, other)
    state = random_states(scene, 0, (2,))
    evaluate, arguments = methods(scene, state)[method]
    evaluate_again, _ = methods(again, state)[method]
    assert_same_bits(np.asarray(evaluate_again(*arguments)), np.asarray(evaluate(*arguments)))


def test_a_locked_scene_pickles() -> None:
    scene = random_scene(8, 9, floating_base=True)
    q = random_states(scene, 0).q
    locked = scene.lock(scene.joint_names[:3], q)
    again = pickle.loads(pickle.dumps(locked))
    state = random_states(locked, 1)
    assert_same_bits(again.forward_dynamics(*state), locked.forward_dynamics(*state))


def test_unpickling_does_not_warn_again() -> None:
    builder = phipsi.SceneBuilder().link("base").link("rod", 1.0, (0, 0, 0), np.diag([1.0, 1.0, 3.0]))
    with pytest.warns(phipsi.errors.InertiaWarning):
        scene = builder.joint("hinge", "revolute", "base", "rod", mimic=None).build()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pickle.loads(pickle.dumps(scene))


def test_a_pickle_of_another_version_says_so(arm: phipsi.Scene) -> None:
    rebuild, (description,) = arm.__reduce__()
    with pytest.raises(SceneError, match="pickled scene: found version 999"):
        rebuild((999, *description[1:]))


def test_errors_pickle(arm: phipsi.Scene) -> None:
    """Exceptions are passed between processes."""
    builder = phipsi.SceneBuilder().link("base").link("rod")
    scene = builder.joint("hinge", "revolute", "base", "rod").build()
    with pytest.raises(SingularJointError) as found:
        scene.forward_dynamics(np.zeros((2, 1)), [0.0], [0.0])
    again = pickle.loads(pickle.dumps(found.value))
    assert str(again) == str(found.value)
    assert (again.joint, again.link, again.state) == ("hinge", "rod", 0)


def large(scene: phipsi.Scene) -> State:
    """Enough states for several threads."""
    return random_states(scene, 0, (500,))


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork on this system")
def test_a_forked_process_has_threads_of_its_own(arm: phipsi.Scene) -> None:
    """The threads of a batch do not survive a fork; the child must not wait for them."""
    state = large(arm)
    expected = arm.forward_dynamics(*state)
    with warnings.catch_warnings():
        # Python 3.12 and later warn of a fork with several threads, which is tested here.
        warnings.simplefilter("ignore", DeprecationWarning)
        with multiprocessing.get_context("fork").Pool(1) as pool:
            found = pool.apply_async(arm.forward_dynamics, state).get(timeout=120)
    assert_same_bits(found, expected)


@pytest.mark.parametrize("threads", ["1", "3"])
def test_the_number_of_threads_changes_no_bit(mixed: phipsi.Scene, threads: str) -> None:
    state = large(mixed)
    program = "import pickle, sys; scene, state = pickle.load(sys.stdin.buffer); "
    program += "sys.stdout.buffer.write(scene.forward_dynamics(*state).tobytes())"
    done = subprocess.run(
        [sys.executable, "-c", program],
        input=pickle.dumps((mixed, tuple(state))),
        env={**os.environ, "RAYON_NUM_THREADS": threads},
        capture_output=True,
        check=True,
        timeout=120,
    )
    found = np.frombuffer(done.stdout).reshape(-1, mixed.nv)
    assert_same_bits(found, mixed.forward_dynamics(*state))


@pytest.fixture
def threads_of_the_machine() -> Iterator[int]:
    """Restores the number of threads."""
    phipsi.set_num_threads(None)
    yield phipsi.get_num_threads()
    phipsi.set_num_threads(None)


def test_the_number_of_threads_is_set(mixed: phipsi.Scene, threads_of_the_machine: int) -> None:
    state = large(mixed)
    expected = mixed.forward_dynamics(*state)
    for threads in (1, 2, 3, 7, 1):
        phipsi.set_num_threads(threads)
        assert phipsi.get_num_threads() == threads
        assert_same_bits(mixed.forward_dynamics(*state), expected)
    phipsi.set_num_threads(0)
    assert phipsi.get_num_threads() == threads_of_the_machine >= 1


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are listed by Linux")
def test_threads_are_kept_where_their_number_changes(mixed: phipsi.Scene, threads_of_the_machine: int) -> None:
    """A thread that ends leaks memory: without reuse, programs that change the number in every batch would grow without
    limit.
    """
    state = large(mixed)
    phipsi.set_num_threads(4)
    mixed.forward_dynamics(*state)
    before = set(os.listdir("/proc/self/task"))
    for threads in (1, 2, 3, 4) * 5:
        phipsi.set_num_threads(threads)
        mixed.forward_dynamics(*state)
    # Threads of previous tests may end meanwhile.
    assert set(os.listdir("/proc/self/task")) <= before


@pytest.mark.parametrize("nonsense", [-1, 1.5, "two", 2**70, True, 10**9, [2]])
def test_numbers_of_threads_that_are_refused(threads_of_the_machine: int, nonsense: object) -> None:
    phipsi.set_num_threads(2)
    with pytest.raises(ArgumentError, match="threads: found"):
        phipsi.set_num_threads(nonsense)  # type: ignore[arg-type]
    assert phipsi.get_num_threads() == 2


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork on this system")
def test_a_forked_process_keeps_the_number_of_threads(mixed: phipsi.Scene, threads_of_the_machine: int) -> None:
    state = large(mixed)
    phipsi.set_num_threads(3)
    expected = mixed.forward_dynamics(*state)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        with multiprocessing.get_context("fork").Pool(1) as pool:
            assert pool.apply_async(phipsi.get_num_threads).get(timeout=120) == 3
            assert_same_bits(pool.apply_async(mixed.forward_dynamics, state).get(timeout=120), expected)
            pool.apply_async(phipsi.set_num_threads, (2,)).get(timeout=120)
            assert pool.apply_async(phipsi.get_num_threads).get(timeout=120) == 2
            assert_same_bits(pool.apply_async(mixed.forward_dynamics, state).get(timeout=120), expected)
    assert phipsi.get_num_threads() == 3


def test_eight_threads_on_one_scene(mixed: phipsi.Scene, method: str) -> None:
    states = [random_states(mixed, seed) for seed in range(8)]
    expected = [np.asarray(methods(mixed, state)[method][0](*methods(mixed, state)[method][1])) for state in states]
    meet = threading.Barrier(8)

    def work(worker: int) -> list[np.ndarray]:
        evaluate, arguments = methods(mixed, states[worker])[method]
        meet.wait(timeout=60)
        return [np.asarray(evaluate(*arguments)) for _ in range(50)]

    with ThreadPoolExecutor(8) as pool:
        for results, one in zip(pool.map(work, range(8)), expected, strict=True):
            for result in results:
                assert_same_bits(result, one)


def test_eight_threads_with_large_batches(mixed: phipsi.Scene) -> None:
    state = large(mixed)
    expected = mixed.forward_dynamics(*state)
    with ThreadPoolExecutor(8) as pool:
        for found in pool.map(lambda _: mixed.forward_dynamics(*state), range(8)):
            assert_same_bits(found, expected)


@pytest.fixture
def no_forced_switches() -> Iterator[None]:
    """Python switches threads only if one releases the GIL."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1000.0)
    yield
    sys.setswitchinterval(before)


@pytest.mark.usefixtures("no_forced_switches")
def test_the_gil_is_released(arm: phipsi.Scene) -> None:
    """This thread runs while another one is in a batch, which is possible only if the batch releases the GIL."""
    state, limit = large(arm), 2000
    arm.forward_dynamics(*state)
    rounds = 0
    seen, started = False, threading.Lock()
    started.acquire()

    def work() -> None:
        nonlocal rounds
        started.release()
        while not seen and rounds < limit:
            rounds += 1
            arm.forward_dynamics(*state)

    worker = threading.Thread(target=work, daemon=True)
    worker.start()
    assert started.acquire(timeout=PATIENCE)
    at, seen = rounds, True
    join(worker)
    assert at < limit
