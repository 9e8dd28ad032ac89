"""Memory of large results is reused only if the previous results have been deleted."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import phipsi
import pytest
from conftest import at_once, random_states

#: States whose mass matrices, with forty joints, take 33 megabytes.
MANY = 2650


@pytest.fixture(scope="module")
def scene() -> phipsi.Scene:
    return phipsi.scenes.chain(40)


@pytest.fixture(scope="module")
def q(scene: phipsi.Scene) -> np.ndarray:
    return random_states(scene, 11, (MANY,))[0]


def address(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


def test_results_that_somebody_has_are_never_written_to(scene: phipsi.Scene, q: np.ndarray) -> None:
    made = [scene.mass_matrix(q + shift) for shift in range(4)]
    expected = [matrix.copy() for matrix in made]
    parts = [made.pop()[5:9, 1:], memoryview(made.pop()), made.pop().T, made.pop().reshape(-1).view(np.uint64)]
    gc.collect()
    for shift in range(4):
        scene.mass_matrix(q - 1.0 - shift)
    wanted = expected[3][5:9, 1:], expected[2], expected[1].T, expected[0].reshape(-1).view(np.uint64)
    for part, as_before in zip(parts, wanted, strict=True):
        np.testing.assert_array_equal(np.asarray(part), as_before)


def test_memory_that_nobody_has_is_written_again(scene: phipsi.Scene, q: np.ndarray) -> None:
    q = q[10:]  # a size that was not used before
    first = scene.mass_matrix(q)
    place, reference, expected = address(first), weakref.ref(first), first.copy()
    # Changes of one array do not affect the next one.
    first.flags.writeable = False
    first.shape = (-1,)
    del first
    assert reference() is None, "the array itself is gone: its memory alone is kept"
    again = scene.mass_matrix(q)
    assert address(again) == place and again.flags.writeable and again.flags.c_contiguous
    np.testing.assert_array_equal(again, expected)


def test_memory_that_somebody_froze_is_left_alone(scene: phipsi.Scene, q: np.ndarray) -> None:
    frozen = scene.mass_matrix(q)
    place = address(frozen)
    assert frozen.base is not None
    frozen.base.flags.writeable = False
    del frozen
    again = scene.mass_matrix(q)
    assert address(again) != place and again.flags.writeable


def test_threads_get_memory_of_their_own(scene: phipsi.Scene, q: np.ndarray) -> None:
    expected = [scene.mass_matrix(q + shift).copy() for shift in range(3)]
    wrong = []

    def work(shift: int) -> None:
        for _ in range(3):
            if not np.array_equal(scene.mass_matrix(q + shift), expected[shift]):
                wrong.append(shift)

    at_once(work, 3)
    assert not wrong
