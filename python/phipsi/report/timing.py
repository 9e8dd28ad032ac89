"""How calls from Python are timed: in turns, on one thread.

benches/auto_states.py runs it against wheels that are older than it: the public names of phipsi are all it uses.
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
#: Does something once.
Once = Callable[[], None]

#: States of a batch.
BATCH = 256
#: States that are called one by one.
SINGLE = 16
#: Calls that are compared are timed this often, in turns; quick: the second.
TURNS = (15, 5)
#: ns that a turn of one call takes at least; quick: the second.
LEAST = (400_000, 100_000)
#: Turns end early where they have taken so many ns, but not before three.
ENOUGH = 4_000_000_000


@dataclass(frozen=True)
class Of:
    """What a time is of."""

    from_: str
    """The language of the caller."""
    call: str
    form: str | None
    """None where the call has none."""
    states: str
    """Their kind: one of kinds.KINDS, or "chain"."""
    batch: int = 1
    """States of a call."""


def in_turns(loops: Sequence[Once], quick: bool) -> NDArray[np.float64]:
    """Times of the loops, ns a run: (turns, loops). One follows the other, so that a change of the machine's pace falls on all alike."""
    least, turns, start = LEAST[quick], [], time.perf_counter_ns()
    for turn in range(TURNS[quick] + 1):
        row = [_ns(once, least) for once in loops]
        if turn:  # the first warms up
            turns.append(row)
        if len(turns) >= 3 and time.perf_counter_ns() - start > ENOUGH:
            break
    return np.array(turns)


def _ns(once: Once, least: int) -> float:
    """Time of one run, over as many as take `least` ns."""
    runs, start = 0, time.perf_counter_ns()
    while True:
        once()
        runs += 1
        elapsed = time.perf_counter_ns() - start
        if elapsed >= least:
            return elapsed / runs


def looped(call: Callable[..., object], arguments: Sequence[Arguments]) -> Once:
    """The call with each of the arguments, one after the other."""

    def once() -> None:
        for each in arguments:
            call(*each)

    return once


def one_by_one(states: Arguments) -> list[Arguments]:
    """The first SINGLE of the states, each as the arguments of a call of its own."""
    return [tuple(np.array(array[k]) for array in states) for k in range(min(SINGLE, len(states[0])))]


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Batches on so many threads, and afterwards on as many as before."""
    before = phipsi.get_num_threads()
    phipsi.set_num_threads(count)
    try:
        yield
    finally:
        phipsi.set_num_threads(before)
