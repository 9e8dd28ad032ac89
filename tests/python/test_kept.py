"""Memory of large results, kept for results to come: only where nobody has the old ones any more."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator

import numpy as np
import phipsi
import pytest
from phipsi.errors import ArgumentError
from conftest import at_once, random_states

USUAL = 128 << 20
#: States whose mass matrices, of six joints, take four megabytes in either precision.
MANY = 1 << 15


@pytest.fixture(autouse=True)
def _as_when_a_process_begins() -> Iterator[None]:
    phipsi.set_kept_memory(0)
    phipsi.set_kept_memory(USUAL)
    yield
    phipsi.set_kept_memory(0)
    phipsi.set_kept_memory(USUAL)


@pytest.fixture(scope="module")
def scene() -> phipsi.Scene:
    return phipsi.scenes.chain(6)


@pytest.fixture(scope="module")
def q(scene: phipsi.Scene) -> np.ndarray:
    return random_states(scene, 11, (MANY,))[0]


def address(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


def test_results_that_somebody_has_are_never_written_to(scene: phipsi.Scene, q: np.ndarray) -> None:
    kept = [scene.mass_matrix(q + shift) for shift in range(4)]
    expected = [matrix.copy() for matrix in kept]
    parts = [kept.pop()[5:9, 1:], memoryview(kept.pop()), kept.pop().T, kept.pop().reshape(-1).view(np.uint64)]
    gc.collect()
    for shift in range(8):
        scene.mass_matrix(q - 1.0 - shift)
    wanted = expected[3][5:9, 1:], expected[2], expected[1].T, expected[0].reshape(-1).view(np.uint64)
    for part, as_before in zip(parts, wanted, strict=True):
        np.testing.assert_array_equal(np.asarray(part), as_before)


def test_memory_that_nobody_has_is_written_again(scene: phipsi.Scene, q: np.ndarray) -> None:
    first = scene.mass_matrix(q)
    place, reference = address(first), weakref.ref(first)
    held = scene.mass_matrix(q)
    assert address(held) != place
    del first
    assert reference() is None, "the array itself is gone: its memory alone is kept"
    again = scene.mass_matrix(q)
    assert address(again) == place
    np.testing.assert_array_equal(again, held)
    # What somebody did to an array is not done to the next one.
    again.flags.writeable = False
    again.shape = (-1,)
    del again
    anew = scene.mass_matrix(q)
    assert address(anew) == place and anew.flags.writeable and anew.flags.c_contiguous and anew.shape == held.shape


def test_memory_that_somebody_froze_is_left_alone(scene: phipsi.Scene, q: np.ndarray) -> None:
    frozen = scene.mass_matrix(q)
    place = address(frozen)
    assert frozen.base is not None
    frozen.base.flags.writeable = False
    del frozen
    again = scene.mass_matrix(q)
    assert address(again) != place and again.flags.writeable


def test_sizes_and_kinds_have_memory_of_their_own(scene: phipsi.Scene, q: np.ndarray) -> None:
    place = address(scene.mass_matrix(q))
    assert phipsi.get_kept_memory() == 8 * 36 * MANY
    fewer = scene.mass_matrix(q[:-8])
    single = scene.mass_matrix(q, dtype=np.float32)
    assert fewer.dtype == np.float64 and single.dtype == np.float32
    assert phipsi.get_kept_memory() == 36 * (8 * MANY + 8 * (MANY - 8) + 4 * MANY)
    assert address(scene.mass_matrix(q)) == place


def test_no_more_is_kept_than_was_allowed(scene: phipsi.Scene, q: np.ndarray) -> None:
    size = 8 * 36 * MANY
    phipsi.set_kept_memory(2 * size)
    held = [scene.mass_matrix(q) for _ in range(3)]
    assert phipsi.get_kept_memory() == 2 * size
    place = address(held[2])
    phipsi.set_kept_memory(size)
    assert phipsi.get_kept_memory() == size
    del held
    assert address(scene.mass_matrix(q)) == place, "what was used last stays"
    phipsi.set_kept_memory(0)
    assert phipsi.get_kept_memory() == 0
    scene.mass_matrix(q)
    assert phipsi.get_kept_memory() == 0
    # What is too large by itself drives nothing out.
    phipsi.set_kept_memory(size)
    place = address(scene.mass_matrix(q))
    scene.mass_matrix(np.concatenate((q, q)))
    assert phipsi.get_kept_memory() == size and address(scene.mass_matrix(q)) == place
    # The system's allocator keeps what is small.
    phipsi.set_kept_memory(0)
    phipsi.set_kept_memory(USUAL)
    scene.mass_matrix(q[:100])
    assert phipsi.get_kept_memory() == 0


def test_threads_get_memory_of_their_own(scene: phipsi.Scene, q: np.ndarray) -> None:
    expected = [scene.mass_matrix(q + shift) for shift in range(4)]
    wrong = []

    def work(shift: int) -> None:
        for _ in range(5):
            if not np.array_equal(scene.mass_matrix(q + shift), expected[shift]):
                wrong.append(shift)

    at_once(work, 4)
    assert not wrong


@pytest.mark.parametrize("given", [-1, 1.5, "all", None])
def test_what_is_no_number_of_bytes_is_refused(given: object) -> None:
    with pytest.raises(ArgumentError, match="bytes"):
        phipsi.set_kept_memory(given)  # type: ignore[arg-type]
