"""Compiled code of one function for batches: accepted arrays, memory layout, and recomputation of states whose error
estimate exceeds the tolerance.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import accumulate
from math import prod
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ._core import _unwritten, get_num_threads
from .errors import PhipsiError

__all__ = ["Batches", "Entry", "entry"]

_Array: TypeAlias = NDArray[Any]
_Entry: TypeAlias = Callable[..., int]
addressof, numbers_of = ctypes.addressof, ctypes.c_char.from_buffer
#: Smallest number of states per thread.
WORTH_A_THREAD = 2048
#: Size of intermediate blocks, bytes, chosen to fit in the L2 cache of a core. With a quarter of it, derivatives of an arm with out take 10 % longer.
BETWEEN = 1 << 20


class Entry(NamedTuple):
    """A function of a library: its name, that of its batches, the numbers per state of its arguments, the shapes of its results, and the name of the function that computes its margin, "" if the margin is its own last
    result, None without margins.
    """

    name: str
    batch: str
    reads: tuple[int, ...]
    results: tuple[tuple[int, ...], ...]
    margin: str | None


def entry(code: ctypes.CDLL, name: str, arrays: int) -> _Entry:
    """A function of the library. Its arguments are a count and the addresses of that many arrays; it returns 1 if a
    value was not finite.
    """
    function = getattr(code, name)
    # Declared once: wrapping each number in each call takes twice as long.
    function.argtypes = [ctypes.c_size_t, *[ctypes.c_void_p] * arrays]
    function.restype = ctypes.c_int
    return function  # type: ignore[no-any-return]


class Batches:
    """One compiled function for arrays (..., n). Returns one array of shape (..., *shape) or a list of several; None if
    the scene has to compute the call.
    """

    def __init__(self, run: _Entry, reads: Sequence[int], shapes: Sequence[tuple[int, ...]], dtype: np.dtype[Any], few: int) -> None:
        """reads: number of values per state of each argument. shapes: shape of each result of a state; with out all are
        of equal size. few: batches with fewer states are computed by the scene.
        """
        self._run, self._reads, self.dtype = run, tuple(reads), dtype
        self._shape, self._results, self._width = shapes[0], len(shapes), prod(shapes[0])
        self._whole = self._shape if len(shapes) == 1 else (len(shapes), *self._shape)
        #: For results of several shapes: each shape, and the first value of each result.
        self._several = None if len(set(shapes)) == 1 else [*zip(shapes, accumulate(map(prod, shapes), initial=0), strict=False)]
        self._total = sum(map(prod, shapes))
        # Results without entries always count as few.
        self._least = tuple(max(few * width, 1) for width in reads)
        self._steps = [dtype.itemsize * width for width in (*reads, *map(prod, shapes))]
        self._unwritten: Callable[[int], _Array] = _unwritten if dtype == np.float64 else partial(np.empty, dtype=dtype)
        self._again: Callable[..., Any] | None = None
        self._watch: _Entry | None = None

    def watched(self, again: Callable[..., Any], watch: _Entry | None = None) -> Batches:
        """Recompute states with a negative margin by again(*arrays). The margin is the last result of the function, or
        that of `watch` for the same q.
        """
        self._again, self._watch = again, watch
        if watch is None:
            self._steps.append(self.dtype.itemsize)
        return self

    def __call__(self, given: tuple[Any, ...], out: _Array | None = None) -> Any:
        # Only plain arrays: the scene reads others, for instance masked arrays.
        is_few = True
        for value, least in zip(given, self._least):  # noqa: B905  # strict costs time
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
        """The results: in new memory, or in out, of which several results are views."""
        count = arrays[0].size // self._reads[0]
        size, several, margins = count * self._width, self._results > 1, None
        results: Any = out
        if self._again is not None:
            # One allocation together with the results: the allocator returns the pages of several allocations to the system, which clears them each time.
            numbers = self._unwritten(count + (count * self._total if out is None else 0))
            margins = numbers[-count:]
            if out is None:
                results = numbers[:-count]
        elif out is None:
            results = self._unwritten(count * self._total)
        if self._several is not None:
            first = address(results)
            addresses += [first + self.dtype.itemsize * count * begin for _, begin in self._several]
        elif out is None or not several:
            first = address(results)
            addresses += [first + self.dtype.itemsize * size * at for at in range(self._results)] if several else [first]
        if margins is not None and self._watch is None:
            addresses.append(address(margins))
        is_finite = self._ran(count, addresses, margins, out if several else None)
        if not is_finite and margins is None:
            return None
        if self._several is not None:
            results = [results[count * begin : count * (begin + prod(shape))].reshape(*batch, *shape) for shape, begin in self._several]
        elif out is None:
            results = results.reshape(self._results, *batch, *self._shape) if several else results.reshape(*batch, *self._shape)
        elif several:
            results = np.moveaxis(out, len(batch), 0)
        if margins is None or (is_finite and margins[margins.argmin()] >= 0):
            return list(results) if several else results
        if not self._mended(arrays, margins, results):
            return None
        # Values of states that the scene has recomputed may not have been finite.
        if not is_finite and not all(np.isfinite(result).all() for result in (results if several else [results])):
            return None
        return list(results) if several else results

    def _ran(self, count: int, addresses: list[int], margins: _Array | None, out: _Array | None) -> bool:
        """Run the code on all states, on several threads if there are many. Returns whether all values were finite."""
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
        """Run the code on some of the states: first the error estimate, then the function itself. Returns the number of
        faults.
        """
        faults, size = 0, self.dtype.itemsize
        if self._watch is not None and watch is not None:
            faults += self._watch(end - first, addresses[0] + first * self._steps[0], watch + first * size)
        if out is None:
            return faults + self._run(end - first, *(start + first * step for start, step in zip(addresses, self._steps, strict=True)))
        return faults + self._into(out, first, end, addresses)

    def _into(self, out: _Array, first: int, end: int, addresses: list[int]) -> int:
        """Write some of the states into an array that stores the results of each state contiguously; the code writes
        each result of many states contiguously. Returns the number of faults.
        """
        faults, width = 0, len(self._reads)
        most = _at_a_time(self.dtype.itemsize * self._width * self._results)
        of_states = out.reshape(-1, self._results, self._width)
        some = np.empty((self._results, min(most, end - first), self._width), self.dtype)
        there = [address(result) for result in some]
        for at in range(first, end, most):
            length = min(most, end - at)
            reads = (start + at * step for start, step in zip(addresses[:width], self._steps, strict=False))
            margins = (start + at * self.dtype.itemsize for start in addresses[width:])
            faults += self._run(length, *reads, *there, *margins)
            of_states[at : at + length] = some[:, :length].swapaxes(0, 1)
        return faults

    def _mended(self, arrays: Sequence[_Array], margins: _Array, results: _Array) -> bool:
        """Recompute the states whose margin is negative or NaN; False if the scene has to compute the call and
        raise.
        """
        uncertain = np.flatnonzero(~(margins >= 0))
        if not uncertain.size:
            return False
        assert self._again is not None
        try:
            better = self._again(*(array.reshape(margins.size, -1)[uncertain] for array in arrays))
        except PhipsiError:
            return False
        among = np.unravel_index(uncertain, arrays[0].shape[:-1])
        for result, part in zip(results, better, strict=False) if self._results > 1 else [(results, better)]:
            result[among] = part
        return True

    def _addresses(self, given: tuple[Any, ...]) -> list[int] | None:
        """Addresses of arrays that the code can read without a copy; None if there are others."""
        batch, found = given[0].shape[:-1], []
        for value, width in zip(given, self._reads):  # noqa: B905  # as above
            if value.dtype is not self.dtype or value.shape != (*batch, width) or not value.flags.carray:
                return None
            found.append(addressof(numbers_of(value)))
        return found

    def _in_order(self, given: tuple[Any, ...]) -> list[_Array]:
        """Copies of the arguments as arrays of one batch that the code can read; an empty list if the scene has to
        compute the call.
        """
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
        # Values beyond the range of float32 become infinite, which the code detects.
        with np.errstate(over="ignore"):
            wide = (np.broadcast_to(value, (*batch, value.shape[-1])) for value in given)
            return [np.require(value, self.dtype, ("C", "A")) for value in wide]

    def _fits(self, out: Any, batch: tuple[int, ...], given: tuple[Any, ...]) -> bool:
        """Whether the code may write to out; otherwise the scene raises the error."""
        return (
            type(out) in (np.ndarray, np.memmap)
            and out.dtype == self.dtype
            and out.shape == (*batch, *self._whole)
            and out.flags.carray
            and not any(np.may_share_memory(out, value) for value in given)
        )


def address(array: Any) -> int:
    """Address of the first entry of an array."""
    try:
        # Takes a quarter of the time of array.ctypes.data; requires writable memory.
        return addressof(numbers_of(array))
    except (TypeError, ValueError):
        there: int = array.ctypes.data
        return there


def _at_a_time(size: int) -> int:
    """Number of states of that size per block: a multiple of the register width."""
    return max(BETWEEN // max(size, 1), 64) // 16 * 16
