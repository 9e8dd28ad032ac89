"""Timing of calls from Python: interleaved, on one thread.

benches/auto_states.py also runs this file with older wheels. Therefore it uses only public names of phipsi.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import phipsi

Array = NDArray[np.float64]
#: Arguments of a call.
Arguments = tuple[Array, ...]
#: Function that is timed.
Once = Callable[[], None]

#: Number of states of a batch.
BATCH = 256
#: Number of states for calls with one state.
SINGLE = 16
#: Number of interleaved timings of the compared calls; the second with quick.
TURNS = (15, 5)
#: Shortest duration of one timing, ns; the second with quick.
LEAST = (400_000, 100_000)
#: The timings end after this time, ns, but not before the third.
ENOUGH = 4_000_000_000


@dataclass(frozen=True)
class Of:
    """Description of a measured time."""

    from_: str
    """Programming language of the caller."""
    call: str
    form: str | None
    """None if the call has no form."""
    states: str
    """Kind of the states: one of kinds.KINDS, or "chain"."""
    batch: int = 1
    """Number of states per call."""


def in_turns(loops: Sequence[Once], quick: bool) -> NDArray[np.float64]:
    """Times of the loops, ns per run: (turns, loops). The loops are interleaved, so that changes of the clock rate
    affect all of them equally.
    """
    least, turns, start = LEAST[quick], [], time.perf_counter_ns()
    for turn in range(TURNS[quick] + 1):
        row = [_ns(once, least) for once in loops]
        if turn:  # the first turn is a warm-up
            turns.append(row)
        if len(turns) >= 3 and time.perf_counter_ns() - start > ENOUGH:
            break
    return np.array(turns)


def _ns(once: Once, least: int) -> float:
    """Time of one run, averaged over at least `least` ns."""
    runs, start = 0, time.perf_counter_ns()
    while True:
        once()
        runs += 1
        elapsed = time.perf_counter_ns() - start
        if elapsed >= least:
            return elapsed / runs


def looped(call: Callable[..., object], arguments: Sequence[Arguments]) -> Once:
    """A function that calls with each of the arguments in sequence."""

    def once() -> None:
        for each in arguments:
            call(*each)

    return once


def one_by_one(states: Arguments) -> list[Arguments]:
    """The first SINGLE states, each as the arguments of a separate call."""
    return [tuple(np.array(array[k]) for array in states) for k in range(min(SINGLE, len(states[0])))]


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Run batches on that many threads, then restore the previous number."""
    before = phipsi.get_num_threads()
    phipsi.set_num_threads(count)
    try:
        yield
    finally:
        phipsi.set_num_threads(before)
