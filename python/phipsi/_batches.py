"""Machine code of one function on batches: which arrays it takes, how they reach it, and what its watch has the scene do once more."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from math import prod
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ._core import _unwritten, get_num_threads
from .errors import PhipsiError

__all__ = ["Batches", "entry"]

_Array: TypeAlias = NDArray[Any]
_Entry: TypeAlias = Callable[..., int]
#: A thread gets so many states at the least.
WORTH_A_THREAD = 2048
#: What lies between two steps of the code is kept to so many bytes, which caches have room for.
BETWEEN = 1 << 18
#: Arrays that are numbers and nothing else; others, as masked ones, are the scene's to read.
PLAIN = (np.ndarray, np.memmap)


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
        """reads: how many numbers each argument has of a state. shapes: of each result of a state. few: so many states are not worth the way."""
        self._run, self._reads, self._shapes, self.dtype = run, tuple(reads), tuple(shapes), dtype
        self._widths = [prod(shape) for shape in shapes]
        self._least = tuple(few * width for width in reads)
        self._steps = [dtype.itemsize * width for width in (*reads, *self._widths)]
        self._together = shapes[0] if len(shapes) == 1 else (len(shapes), *shapes[0])
        self._again: Callable[..., Any] | None = None
        self._watch: _Entry | None = None
        self._watch_width = 0

    def watched(self, again: Callable[..., Any], watch: _Entry | None = None, width: int = 0) -> Batches:
        """Has states whose margin is below zero done by again(*arrays). The margin is the function's own last result; or that of watch, of the same q, beside so many numbers that nobody reads."""
        self._again, self._watch, self._watch_width = again, watch, width
        if watch is None:
            self._steps.append(self.dtype.itemsize)
        return self

    def __call__(self, given: tuple[Any, ...], out: _Array | None = None) -> Any:
        is_few = True
        for value, least in zip(given, self._least, strict=True):
            if type(value) not in PLAIN:
                return None
            is_few = is_few and value.size < least
        if is_few:
            return None
        arrays = given if self._is_in_order(given) else self._in_order(given)
        if arrays is None:
            return None
        batch = arrays[0].shape[:-1]
        count = arrays[0].size // self._reads[0]
        if out is not None and not self._fits(out, batch, given):
            return None
        if len(self._shapes) == 1:
            return self._one(arrays, batch, count, out)
        return self._several(arrays, batch, count, out)

    def _one(self, arrays: Sequence[_Array], batch: tuple[int, ...], count: int, out: _Array | None) -> _Array | None:
        """The array of a function of one result."""
        shape, width = (*batch, *self._shapes[0]), self._widths[0]
        margins = None
        if self._again is None:
            result = self._unwritten(count * width).reshape(shape) if out is None else out
        elif out is None:
            # In one piece: the allocator gives the pages of several back to the system every time, which clears them anew.
            numbers = self._unwritten(count * (width + 1))
            result, margins = numbers[: count * width].reshape(shape), numbers[count * width :]
        else:
            result, margins = out, self._unwritten(count)
        addresses = [address(array) for array in arrays]
        addresses.append(address(result))
        if margins is not None and self._watch is None:
            addresses.append(address(margins))
        if not self._ran(count, addresses, margins, None):
            return None
        if margins is None or self._mended(arrays, margins, [result.reshape(count, *self._shapes[0])]):
            return result
        return None

    def _several(self, arrays: Sequence[_Array], batch: tuple[int, ...], count: int, out: _Array | None) -> list[_Array] | None:
        """The arrays of a function of several results: of their own memory, or views of out, (..., results, *shape)."""
        addresses, margins = [address(array) for array in arrays], None
        ends = np.cumsum([0, *(count * width for width in self._widths)]).tolist()
        numbers = self._unwritten(ends[-1] + (0 if self._again is None else count)) if out is None else None
        if self._again is not None:
            margins = self._unwritten(count) if numbers is None else numbers[ends[-1] :]
        if numbers is not None:
            pieces = [numbers[first:end] for first, end in zip(ends[:-1], ends[1:], strict=True)]
            results = [piece.reshape(*batch, *shape) for piece, shape in zip(pieces, self._shapes, strict=True)]
            flat = [piece.reshape(count, *shape) for piece, shape in zip(pieces, self._shapes, strict=True)]
            addresses += [address(piece) for piece in pieces]
        else:
            assert out is not None
            of_states = out.reshape(count, *self._together)
            flat = [of_states[:, at] for at in range(len(self._shapes))]
            results = [part.reshape(*batch, *shape) for part, shape in zip(flat, self._shapes, strict=True)]
        if not self._ran(count, addresses, margins, None if numbers is not None else out):
            return None
        return results if margins is None or self._mended(arrays, margins, flat) else None

    def _ran(self, count: int, addresses: list[int], margins: _Array | None, out: _Array | None) -> bool:
        """Runs the code on all states, on threads where they are many. Whether all numbers were finite."""
        watch = None if self._watch is None or margins is None else address(margins)
        threads = min(get_num_threads(), count // WORTH_A_THREAD) if count >= 2 * WORTH_A_THREAD else 1
        if threads > 1:
            cuts = [count * i // threads for i in range(threads + 1)]

            def piece(first: int, end: int) -> int:
                return self._piece(first, end, addresses, watch, out)

            with ThreadPoolExecutor(threads) as pool:
                return sum(pool.map(piece, cuts[:-1], cuts[1:])) == 0
        if watch is None and out is None:
            return self._run(count, *addresses) == 0
        return self._piece(0, count, addresses, watch, out) == 0

    def _piece(self, first: int, end: int, addresses: list[int], watch: int | None, out: _Array | None) -> int:
        """Some of the states: first what watches them, whose other result is written to little memory again and again, then the function itself. Faults."""
        faults, size = 0, self.dtype.itemsize
        if self._watch is not None and watch is not None:
            most = _at_a_time(size * self._watch_width)
            unread = np.empty(min(most, end - first) * self._watch_width, self.dtype)
            nowhere = address(unread)
            for at in range(first, end, most):
                faults += self._watch(min(most, end - at), addresses[0] + at * self._steps[0], nowhere, watch + at * size)
        if out is None:
            return faults + self._run(end - first, *(start + first * step for start, step in zip(addresses, self._steps, strict=True)))
        return faults + self._into(out, first, end, addresses)

    def _into(self, out: _Array, first: int, end: int, addresses: list[int]) -> int:
        """Some of the states into an array that has the results of each state side by side: the code writes each result of many states in a row, some states at a time. Faults."""
        faults, results = 0, len(self._shapes)
        most = _at_a_time(sum(self._steps[len(addresses) :]))
        of_states = out.reshape(-1, results, self._widths[0])
        some = np.empty((results, min(most, end - first), self._widths[0]), self.dtype)
        there = [address(some[at]) for at in range(results)]
        for at in range(first, end, most):
            length = min(most, end - at)
            faults += self._run(length, *(start + at * step for start, step in zip(addresses, self._steps, strict=False)), *there)
            of_states[at : at + length] = some[:, :length].swapaxes(0, 1)
        return faults

    def _mended(self, arrays: Sequence[_Array], margins: _Array, results: list[_Array]) -> bool:
        """States whose margin is below zero, or NaN, done once more; False where the scene is to say of all what is wrong."""
        if margins[margins.argmin()] >= 0:
            return True
        doubtful = np.flatnonzero(~(margins >= 0))
        assert self._again is not None
        try:
            better = self._again(*(array.reshape(margins.size, -1)[doubtful] for array in arrays))
        except PhipsiError:
            return False
        for result, part in zip(results, better if isinstance(better, tuple) else (better,), strict=False):
            result[doubtful] = part
        return True

    def _is_in_order(self, given: tuple[Any, ...]) -> bool:
        """Whether the code reads these arrays as they are."""
        batch = given[0].shape[:-1]
        for value, width in zip(given, self._reads, strict=True):
            flags = value.flags
            if value.dtype != self.dtype or value.shape != (*batch, width) or not (flags.c_contiguous and flags.aligned):
                return False
        return True

    def _in_order(self, given: tuple[Any, ...]) -> list[_Array] | None:
        """The same numbers as arrays of one batch that the code reads; None of what the scene is to look at."""
        if any(value.dtype not in (np.float64, self.dtype) or value.ndim == 0 for value in given):
            return None
        if any(value.shape[-1] != width for value, width in zip(given, self._reads, strict=True)):
            return None
        try:
            batch = np.broadcast_shapes(*(value.shape[:-1] for value in given))
        except ValueError:
            return None
        if prod(batch) == 0:
            return None
        # What is too large for float32 becomes infinite, which the code finds.
        with np.errstate(over="ignore"):
            wide = (np.broadcast_to(value, (*batch, value.shape[-1])) for value in given)
            return [np.require(value, self.dtype, ("C", "A")) for value in wide]

    def _fits(self, out: Any, batch: tuple[int, ...], given: tuple[Any, ...]) -> bool:
        """Whether the code may write to out; else the scene says what is wrong with it."""
        return (
            type(out) in PLAIN
            and out.dtype == self.dtype
            and out.shape == (*batch, *self._together)
            and out.flags.carray
            and not any(np.may_share_memory(out, value) for value in given)
        )

    def _unwritten(self, count: int) -> _Array:
        return _unwritten(count) if self.dtype == np.float64 else np.empty(count, self.dtype)


def address(array: Any) -> int:
    """Where its numbers begin."""
    try:
        # A quarter of the time of array.ctypes.data; of memory that may be written to.
        return ctypes.addressof(ctypes.c_char.from_buffer(array))
    except (TypeError, ValueError):
        there: int = array.ctypes.data
        return there


def _at_a_time(size: int) -> int:
    """How many states of so many bytes: whole registers of them."""
    return max(BETWEEN // max(size, 1), 64) // 16 * 16
