"""Machine code of one function on batches: which arrays it takes, how they reach it, and what its watch has the scene do once more."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from math import prod
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ._core import _unwritten, get_num_threads
from .errors import PhipsiError

__all__ = ["Batches", "entry"]

_Array: TypeAlias = NDArray[Any]
_Entry: TypeAlias = Callable[..., int]
addressof, numbers_of = ctypes.addressof, ctypes.c_char.from_buffer
#: A thread gets so many states at the least.
WORTH_A_THREAD = 2048
#: What lies between two steps of the code is kept to so many bytes, which a core's own cache has room for; of a quarter of that, out took derivatives of an arm a tenth longer.
BETWEEN = 1 << 20


def entry(code: ctypes.CDLL, name: str, arrays: int) -> _Entry:
    """A function of the library: a count, and the addresses of so many arrays; 1 where a number was not finite."""
    function = getattr(code, name)
    # Told once: numbers that are wrapped call by call take twice as long.
    function.argtypes = [ctypes.c_size_t, *[ctypes.c_void_p] * arrays]
    function.restype = ctypes.c_int
    return function  # type: ignore[no-any-return]


class Batches:
    """One function as machine code, called with arrays (..., n): the results, as one array of shape (..., *shape) or a list of several; None of what the scene is to do."""

    def __init__(self, run: _Entry, reads: Sequence[int], shapes: Sequence[tuple[int, ...]], dtype: np.dtype[Any], few: int) -> None:
        """reads: how many numbers each argument has of a state. shapes: of each result of a state, all the same size. few: fewer states are not worth the way."""
        self._run, self._reads, self.dtype = run, tuple(reads), dtype
        self._shape, self._results, self._width = shapes[0], len(shapes), prod(shapes[0])
        self._whole = self._shape if len(shapes) == 1 else (len(shapes), *self._shape)
        # Of no numbers there are always few.
        self._least = tuple(max(few * width, 1) for width in reads)
        self._steps = [dtype.itemsize * width for width in (*reads, *[self._width] * len(shapes))]
        self._unwritten: Callable[[int], _Array] = _unwritten if dtype == np.float64 else partial(np.empty, dtype=dtype)
        self._again: Callable[..., Any] | None = None
        self._watch: _Entry | None = None

    def watched(self, again: Callable[..., Any], watch: _Entry | None = None) -> Batches:
        """Has states whose margin is below zero done by again(*arrays). The margin is the function's own last result; or that of watch, of the same q."""
        self._again, self._watch = again, watch
        if watch is None:
            self._steps.append(self.dtype.itemsize)
        return self

    def __call__(self, given: tuple[Any, ...], out: _Array | None = None) -> Any:
        # Of arrays that are numbers and nothing else: others, as masked ones, are the scene's to read.
        is_few = True
        for value, least in zip(given, self._least):  # noqa: B905  # strict takes its time
            if type(value) is not np.ndarray and type(value) is not np.memmap:
                return None
            if value.size >= least:
                is_few = False
        if is_few:
            return None
        arrays: Sequence[_Array] = given
        addresses = self._addresses(given)
        if addresses is None:
            arrays = self._in_order(given)
            addresses = [address(array) for array in arrays]
        if not arrays:
            return None
        batch = arrays[0].shape[:-1]
        if out is not None and not self._fits(out, batch, given):
            return None
        return self._done(arrays, addresses, batch, out)

    def _done(self, arrays: Sequence[_Array], addresses: list[int], batch: tuple[int, ...], out: _Array | None) -> Any:
        """The results: in memory of their own, or in out, of which several are views."""
        count = arrays[0].size // self._reads[0]
        size, several, margins = count * self._width, self._results > 1, None
        results: Any = out
        if self._again is not None:
            # In one piece with the results: the allocator gives the pages of several back to the system every time, which clears them anew.
            numbers = self._unwritten(count + (size * self._results if out is None else 0))
            margins = numbers[-count:]
            if out is None:
                results = numbers[:-count]
        elif out is None:
            results = self._unwritten(size * self._results)
        if out is None or not several:
            first = address(results)
            addresses += [first + self.dtype.itemsize * size * at for at in range(self._results)] if several else [first]
        if margins is not None and self._watch is None:
            addresses.append(address(margins))
        if not self._ran(count, addresses, margins, out if several else None):
            return None
        if out is None:
            results = results.reshape(self._results, *batch, *self._shape) if several else results.reshape(*batch, *self._shape)
        elif several:
            results = np.moveaxis(out, len(batch), 0)
        if margins is not None and not margins[margins.argmin()] >= 0 and not self._mended(arrays, margins, results):
            return None
        return list(results) if several else results

    def _ran(self, count: int, addresses: list[int], margins: _Array | None, out: _Array | None) -> bool:
        """Runs the code on all states, on threads where they are many. Whether all numbers were finite."""
        watch = None if self._watch is None or margins is None else address(margins)
        if count >= 2 * WORTH_A_THREAD and (threads := min(get_num_threads(), count // WORTH_A_THREAD)) > 1:
            cuts = [count * i // threads for i in range(threads + 1)]

            def piece(first: int, end: int) -> int:
                return self._piece(first, end, addresses, watch, out)

            with ThreadPoolExecutor(threads) as pool:
                return sum(pool.map(piece, cuts[:-1], cuts[1:])) == 0
        if watch is None and out is None:
            return self._run(count, *addresses) == 0
        return self._piece(0, count, addresses, watch, out) == 0

    def _piece(self, first: int, end: int, addresses: list[int], watch: int | None, out: _Array | None) -> int:
        """Some of the states: first what watches them, then the function itself. Faults."""
        faults, size = 0, self.dtype.itemsize
        if self._watch is not None and watch is not None:
            faults += self._watch(end - first, addresses[0] + first * self._steps[0], watch + first * size)
        if out is None:
            return faults + self._run(end - first, *(start + first * step for start, step in zip(addresses, self._steps, strict=True)))
        return faults + self._into(out, first, end, addresses)

    def _into(self, out: _Array, first: int, end: int, addresses: list[int]) -> int:
        """Some of the states into an array that has the results of each state side by side: the code writes each result of many states in a row, some states at a time. Faults."""
        faults = 0
        most = _at_a_time(self.dtype.itemsize * self._width * self._results)
        of_states = out.reshape(-1, self._results, self._width)
        some = np.empty((self._results, min(most, end - first), self._width), self.dtype)
        there = [address(result) for result in some]
        for at in range(first, end, most):
            length = min(most, end - at)
            faults += self._run(length, *(start + at * step for start, step in zip(addresses, self._steps, strict=False)), *there)
            of_states[at : at + length] = some[:, :length].swapaxes(0, 1)
        return faults

    def _mended(self, arrays: Sequence[_Array], margins: _Array, results: _Array) -> bool:
        """States whose margin is below zero, or NaN, done once more; False where the scene is to say of all what is wrong."""
        doubtful = np.flatnonzero(~(margins >= 0))
        assert self._again is not None
        try:
            better = self._again(*(array.reshape(margins.size, -1)[doubtful] for array in arrays))
        except PhipsiError:
            return False
        among = np.unravel_index(doubtful, arrays[0].shape[:-1])
        for result, part in zip(results, better, strict=False) if self._results > 1 else [(results, better)]:
            result[among] = part
        return True

    def _addresses(self, given: tuple[Any, ...]) -> list[int] | None:
        """Where the numbers of arrays begin that the code reads as they are; None of others."""
        batch, found = given[0].shape[:-1], []
        for value, width in zip(given, self._reads):  # noqa: B905  # as above
            if value.dtype is not self.dtype or value.shape != (*batch, width) or not value.flags.carray:
                return None
            found.append(addressof(numbers_of(value)))
        return found

    def _in_order(self, given: tuple[Any, ...]) -> list[_Array]:
        """The same numbers as arrays of one batch that the code reads; no arrays of what the scene is to look at."""
        if any(value.dtype not in (np.float64, self.dtype) or value.ndim == 0 for value in given):
            return []
        if any(value.shape[-1] != width for value, width in zip(given, self._reads, strict=True)):
            return []
        try:
            batch = np.broadcast_shapes(*(value.shape[:-1] for value in given))
        except ValueError:
            return []
        if prod(batch) == 0:
            return []
        # What is too large for float32 becomes infinite, which the code finds.
        with np.errstate(over="ignore"):
            wide = (np.broadcast_to(value, (*batch, value.shape[-1])) for value in given)
            return [np.require(value, self.dtype, ("C", "A")) for value in wide]

    def _fits(self, out: Any, batch: tuple[int, ...], given: tuple[Any, ...]) -> bool:
        """Whether the code may write to out; else the scene says what is wrong with it."""
        return (
            type(out) in (np.ndarray, np.memmap)
            and out.dtype == self.dtype
            and out.shape == (*batch, *self._whole)
            and out.flags.carray
            and not any(np.may_share_memory(out, value) for value in given)
        )


def address(array: Any) -> int:
    """Where its numbers begin."""
    try:
        # A quarter of the time of array.ctypes.data; of memory that may be written to.
        return addressof(numbers_of(array))
    except (TypeError, ValueError):
        there: int = array.ctypes.data
        return there


def _at_a_time(size: int) -> int:
    """How many states of so many bytes: whole registers of them."""
    return max(BETWEEN // max(size, 1), 64) // 16 * 16
