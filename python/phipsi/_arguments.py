"""Arguments that are not plain arrays of numbers: labeled entries are matched with joints by name, or refused; never by
position alone.

Labels are detected by the attributes of a class, not by its module: Series and DataFrames of pandas (modin,
cuDF, polars), DataArrays of xarray and Tables of Arrow. None of these packages is imported.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._signals import by_handler
from .errors import ArgumentError, NotFiniteError, ShapeError, of_argument

if TYPE_CHECKING:
    from ._core import Scene

__all__ = [
    "array_of", "check_result", "check_tree", "collider_pairs", "flags", "has_followers", "is_masked", "leading", "names_of", "not_numbers", "numbers", "split_mask", "states_of", "vectors",
    "whole",
]  # fmt: skip

#: Largest depth of nested lists that are searched, because a list may contain itself.
DEEPEST = 8
#: Largest number of names in a message.
LISTED = 12
#: Joints that the entries of an argument belong to, with the number of entries of each, in order; None if there are none.
Joints = Sequence[tuple[str, int]] | None


def array_of(name: str, value: Any, joints: Joints, width: int) -> NDArray[Any]:
    """The argument as an array of real numbers with entries in the order of the joints; the last axis should have
    `width` entries.
    """
    value = _resolved(name, value, joints, width)
    try:
        array = np.asarray(value)
    except MemoryError:
        raise
    except Exception as cause:
        if by_handler(cause):
            raise
        raise not_numbers(name, f"what NumPy cannot read ({cause})") from cause
    if array.dtype.kind not in "fiu":
        raise _of_dtype(name, value, array.dtype)
    return array


def numbers(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """The argument as float64 of any shape, without labels; complex numbers, booleans and masks are refused."""
    return np.asarray(array_of(name, value, None, 0), np.float64)


def finite(name: str, value: ArrayLike, shape: tuple[int, ...] | None = None) -> NDArray[np.float64]:
    """As `numbers`, contiguous, of one shape, without NaN and infinities."""
    found = np.ascontiguousarray(numbers(name, value)) if np.ndim(value) else numbers(name, value)
    if shape is not None and found.shape != shape:
        raise of_argument(ShapeError, name, f"found shape {found.shape}; expected {shape}")
    check_finite(name, found)
    return found


def whole(name: str, value: Any, least: int, expected: str = "", most: int = 2**53) -> int:
    """A whole number from `least` to `most`; `expected` describes it in the message."""
    expected = expected or f"a whole number, at least {least}"
    is_number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if not (is_number and math.isfinite(value) and value == int(value) and value >= least):
        raise _refused(name, f"{value!r}", expected)
    if value > most:
        raise _refused(name, f"{value!r}", f"{expected} and at most {most:g}")
    return int(value)


def collider_pairs(name: str, value: Any) -> list[tuple[str, str]]:
    """Pairs of names of colliders, of which one may be given alone."""
    try:
        given = list(value)
        pairs = [tuple(given)] if given and all(isinstance(of, str) for of in given) else [tuple(of) for of in given]
    except TypeError:
        pairs = [()]
    if isinstance(value, (str, Mapping)) or not all(len(of) == 2 and all(isinstance(end, str) for end in of) for of in pairs):
        raise _refused(name, f"{value!r}", "the names of two colliders, or a sequence of such pairs")
    return pairs


def names_of(value: Iterable[Any]) -> tuple[Any, ...]:
    """Names, of which one may be given alone."""
    return (value,) if isinstance(value, str) else tuple(value)


def check_result(what: str, values: ArrayLike) -> None:
    """Refuse a result with NaN or infinities: finite arguments can still overflow."""
    check_finite(f"{what} (result; the arguments overflow)", values)


def check_finite(what: str, values: ArrayLike, expected: str = "finite numbers") -> None:
    """Refuse NaN and infinities."""
    is_finite = np.isfinite(values).ravel()
    if is_finite.all():
        return
    index = int(is_finite.argmin())
    found = str(np.ravel(values)[index]).replace("nan", "NaN")
    error = of_argument(NotFiniteError, what, f"found {found} at index {index}; expected {expected}")
    error.index = index
    raise error


def vectors(name: str, values: ArrayLike, size: int) -> NDArray[np.float64]:
    """Vectors of another program's state, (..., size)."""
    found = numbers(name, values)
    check_shape(name, found, size)
    return found


def check_shape(name: str, found: NDArray[np.float64], size: int) -> None:
    """Refuse arrays that are not (..., size)."""
    if found.ndim == 0 or found.shape[-1] != size:
        raise of_argument(ShapeError, name, f"found shape {found.shape}; expected (..., {size})")


def leading(q: NDArray[np.float64], v: NDArray[np.float64]) -> tuple[int, ...]:
    """Leading axes that configurations and velocities broadcast to."""
    try:
        return np.broadcast_shapes(q.shape[:-1], v.shape[:-1])
    except ValueError:
        raise of_argument(ShapeError, "q", f"found leading axes {q.shape[:-1]} and {v.shape[:-1]}; expected leading axes that broadcast") from None


def flags(name: str, value: Any, joints: Joints, width: int) -> list[bool] | None:
    """Entries of a boolean array (width,); None for other dtypes, for instance an index of names."""
    try:
        if np.asarray(value).dtype.kind != "b":
            return None
    except Exception as error:
        if by_handler(error):
            raise
        return None
    array = np.asarray(_resolved(name, value, joints, width))
    if array.shape != (width,):
        raise _wrong_shape(name, array, f"({width},)")
    entries: list[bool] = array.tolist()
    return entries


def is_masked(value: Any) -> bool:
    """Whether the value is a masked array, even with an empty mask: a view would not show later changes of the data."""
    return isinstance(value, np.ma.MaskedArray)


def split_mask(value: Any) -> tuple[Any, NDArray[np.float64]] | None:
    """A masked array with zeros at masked entries, and a second array with infinity there and zeros elsewhere; None if
    nothing is masked.
    """
    mask = _mask_of(value)
    return None if mask is None else (value.filled(0), np.where(mask, np.inf, 0.0))


def _resolved(name: str, value: Any, joints: Joints, width: int) -> Any:
    """The argument without labels, with entries in the order of the joints. NumPy reports values that are not
    numbers.
    """
    if _is_number(value) or type(value) is np.ndarray:
        return value
    if type(value) in (list, tuple):
        _check_entries(name, value)
        return value
    _refuse_masked(name, value)
    if isinstance(value, Mapping):
        return _by_joint(name, value, joints, width)
    labels = _labels(name, value)
    return value if labels is None else _matched(name, value, labels, joints)


def _is_number(value: Any) -> bool:
    """Whether the value is a number of Python or any NumPy scalar; neither has labels."""
    return type(value) in (float, int) or isinstance(value, np.generic)


def _strange(name: str, sequence: Any, depth: int = 1) -> Iterator[tuple[str, int, Any]]:
    """Entries of nested lists and tuples that are neither numbers nor arrays: label, index in the list, and value."""
    if set(map(type, sequence)) <= {float, int}:
        return
    for at, entry in enumerate(sequence):
        if type(entry) in (list, tuple):
            if depth <= DEEPEST:
                yield from _strange(f"{name}[{at}]", entry, depth + 1)
        elif not _is_number(entry) and type(entry) is not np.ndarray:
            yield f"{name}[{at}]", at, entry


def _check_entries(name: str, sequence: Any) -> None:
    """Refuse labels and masks within lists and tuples, which would be lost."""
    for label, _, entry in _strange(name, sequence):
        if isinstance(entry, str):
            continue
        _refuse_masked(label, entry)
        labels = None if isinstance(entry, Mapping) else _labels(name, entry)
        if isinstance(entry, Mapping) or (labels and labels[1] is not None):
            expected = "numbers: names within a list are not matched; stack the states in one array, or in one table with a column a joint"
            raise _refused(label, _described(entry), expected)


def states_of(states: Any, batch: tuple[int, ...]) -> tuple[tuple[int, ...], NDArray[np.uintp]]:
    """Shape of the part of a batch that `states` selects, with the rules of NumPy indexing, and the flattened
    indices of the states.
    """
    every = np.arange(math.prod(batch), dtype=np.uintp).reshape(batch)
    try:
        found = np.asarray(every[states])
    except Exception as error:
        if by_handler(error):
            raise
        expected = f"a mask of shape {batch}, an index, a list of them, or a slice"
        raise _refused("states", f"{_described(states)} ({error})", expected) from error
    return found.shape, found.reshape(-1)


def _mask_of(value: Any) -> NDArray[np.bool_] | None:
    """Mask of a masked array, of its shape, if any entry is masked."""
    if not is_masked(value):
        return None
    mask = np.ma.getmaskarray(value)
    # Records have one mask per field; they are refused because of their dtype.
    return mask if mask.dtype.kind == "b" and mask.any() else None


def _refuse_masked(name: str, value: Any) -> None:
    mask = _mask_of(value)
    if mask is not None:
        found = f"a masked array with {mask.sum()} of {mask.size} entries masked, the first at index {mask.argmax()} (flattened)"
        expected = (
            "numbers for all entries (only the torque and noise of estimate may be masked: not measured); "
            ".filled(value) puts a number in their place"
        )
        raise _refused(name, found, expected)


def _by_joint(name: str, mapping: Mapping[Any, Any], joints: Joints, width: int) -> NDArray[np.float64]:
    """One state from a mapping from the names of all joints to their values."""
    what = _described(mapping)
    if joints is None:
        shape = f" of shape (..., {width})" if width else ""
        raise _refused(name, what, f"an array{shape}, because its entries do not belong to joints")
    for key in mapping:
        if not isinstance(key, str):
            raise _refused(name, f"the key {key!r}", "names of joints")
    _order(name, what, list(mapping), joints)
    numbers: list[float] = []
    for joint, count in joints:
        label = f"{name}[{_quoted(joint)}]"
        own = array_of(label, mapping[joint], None, count)
        if own.shape != (count,) and not (count == 1 and own.shape == ()):
            raise _wrong_shape(label, own, "() or (1,)" if count == 1 else f"({count},)")
        numbers += own.astype(np.float64).reshape(-1).tolist()
    return np.array(numbers)


#: Expression that returns the values without labels, and the labels of the last axis: None for the integers from 0, which equal the
#: position; names; or the reason why they cannot be matched.
_Labels = tuple[str, list[Any] | str | None]


def _labels(name: str, value: Any) -> _Labels | None:
    """Labels of a value, if it has any."""
    try:
        return _labels_of(value)
    except Exception as error:
        if by_handler(error):
            raise
        found = f"{type(value)} with labels that cannot be read ({error})"
        raise _refused(name, found, "an array of numbers") from error


def _labels_of(value: Any) -> _Labels | None:
    """Labels of a value. The attributes are looked up in its class, because a Series has its labels as
    attributes of the instance.
    """

    def has(*attributes: str) -> bool:
        return all(hasattr(type(value), attribute) for attribute in attributes)

    if isinstance(value, tuple) and has("_fields"):
        return "list(..)", list(value._fields)  # type: ignore[attr-defined]
    if has("column_names"):
        return ".to_pandas().to_numpy()", list(value.column_names)
    if has("columns", "collect"):
        return ".collect().to_numpy()", "its columns are not known before collect()"
    if has("columns"):
        return ".to_numpy()", _labels_of_table(value, has("index"))
    if has("iloc", "index"):
        return ".to_numpy()", _labels_of_index(value.index)
    if has("dims", "coords"):
        return ".to_numpy()", _labels_of_dimensions(value, has("data_vars"))
    if has("unit", "to_value") or has("units", "magnitude"):
        return " in SI units and radians, as a plain array", "units are not converted"
    return None


_ELSEWHERE = "the names are on another axis than the last; transpose it"


def _labels_of_index(index: Any) -> list[Any] | None:
    """Labels of an index of pandas."""
    if type(index).__name__ == "RangeIndex" and index.start == 0 and index.step == 1:
        return None
    return list(index)


def _has_names(labels: list[Any] | None) -> bool:
    return labels is not None and any(isinstance(label, str) for label in labels)


def _labels_of_table(table: Any, has_rows: bool) -> list[Any] | str | None:
    """Labels of the columns of a table. A label that is a time belongs to the state of a row, a name to a joint."""
    columns = _labels_of_index(table.columns)
    if columns is None and has_rows and not callable(table.index) and _has_names(_labels_of_index(table.index)):
        return _ELSEWHERE
    return columns


def _labels_of_dimensions(array: Any, is_dataset: bool) -> list[Any] | str | None:
    """Labels of the last dimension of an array of xarray."""
    if is_dataset:
        return "it has several arrays"
    labels = [array.coords[name].values.tolist() if name in array.coords else None for name in array.dims]
    if labels and labels[-1] is None and any(map(_has_names, labels)):
        return _ELSEWHERE
    return labels[-1] if labels else None


def _matched(name: str, value: Any, labels: _Labels, joints: Joints) -> Any:
    """Values of a labeled array, in the order of the joints."""
    remedy, along = labels
    # Names of the fields of a tuple are used only for joints.
    if along is None or (joints is None and isinstance(value, tuple)):
        return value
    what = _described(value)

    def refused(why: str) -> ArgumentError:
        if joints is None:
            expected = f"numbers without labels: {name}{remedy}"
        else:
            names = _listed([joint for joint, _ in joints])
            expected = f"labels that are the names of the joints ({names}), or numbers alone in their order: {name}{remedy}"
        return _refused(name, f"{what}: {why}", expected)

    if isinstance(along, str):
        raise refused(along)
    if joints is None:
        raise refused("it has labels, which this argument does not use")
    for joint, count in joints:
        if count != 1:
            why = f"joint {_quoted(joint)} has {count} entries here, which one label cannot distinguish: pass a dict from names to arrays"
            raise refused(why)
    if not _has_names(along):
        raise refused("its labels are no names")
    order = _order(name, what, along, joints)
    array = np.asarray(value)
    if array.shape[-1:] != (len(along),):
        raise refused("its labels are not those of its last axis")
    return array.take(order, -1)


def _order(name: str, what: str, labels: list[Any], joints: Sequence[tuple[str, int]]) -> list[int]:
    """Index of the label of each joint; every joint must have exactly one label, and every label a joint."""
    known = [joint for joint, _ in joints]
    labels = [label if isinstance(label, str) else "a label that is no string" for label in labels]
    counts, names = Counter(labels), set(known)
    unknown = [label for label in labels if label not in names]
    twice = [label for label, count in counts.items() if count > 1 and label in names]
    missing = [joint for joint in known if joint not in counts]
    faults = (("without", missing), ("with names that are not movable joints,", unknown), ("with twice", twice))
    faults_found = [f"{how} {_listed(names)}" for how, names in faults if names]
    if faults_found:
        raise _refused(name, f"{what} {' and '.join(faults_found)}", f"every joint once: {_listed(known)}")
    places = {label: at for at, label in enumerate(labels)}
    return [places[joint] for joint in known]


def _of_dtype(name: str, value: Any, dtype: np.dtype[Any]) -> ArgumentError:
    """The error for a value whose dtype in NumPy is not real."""
    is_sequence = type(value) in (list, tuple)
    # For booleans and complex numbers the dtype is sufficient.
    if isinstance(value, np.ndarray) or (is_sequence and dtype.kind in "bc"):
        return not_numbers(name, f"dtype {dtype}")
    if is_sequence:
        culprits = (f" (entry {at} is {_described(entry)})" for _, at, entry in _strange(name, value) if not isinstance(entry, np.ndarray))
        return not_numbers(name, f"dtype {dtype}{next(culprits, '')}")
    return not_numbers(name, f"dtype {dtype} from {_described(value)}", _remedy(value))


def not_numbers(name: str, found: str, remedy: str = "") -> ArgumentError:
    """The error for an argument that is not an array of real numbers."""
    return _refused(name, found, f"an array of real numbers (float64; float32 and integers are converted){remedy}")


def _remedy(value: Any) -> str:
    """Suggestion for an object that is not an array of numbers."""
    if isinstance(value, str):
        return ""
    if hasattr(type(value), "toarray"):
        return "; .toarray() gives one"
    if hasattr(type(value), "__next__") or hasattr(type(value), "__iter__"):
        return "; list(..) or numpy.fromiter gives one, where it has an order"
    return ""


def _described(value: Any) -> str:
    """Type and module of an object, for messages."""
    if value is None:
        return "None"
    kind = type(value)
    module = "" if kind.__module__ == "builtins" else f"{kind.__module__}."
    return f"an object of type {module}{kind.__qualname__}"


def _quoted(name: str) -> str:
    return json.dumps(name, ensure_ascii=False)


def _listed(names: Sequence[str]) -> str:
    """Quoted names, shortened if there are many."""
    more = f", ... ({len(names)} in all)" if len(names) > LISTED else ""
    return ", ".join(map(_quoted, names[:LISTED])) + more


def _refused(name: str, found: str, expected: str) -> ArgumentError:
    return of_argument(ArgumentError, name, f"found {found}; expected {expected}")


def _wrong_shape(name: str, array: NDArray[Any], expected: str) -> ShapeError:
    return of_argument(ShapeError, name, f"found shape {array.shape}; expected {expected}")


def has_followers(scene: Scene) -> bool:
    """Return whether joints of the scene follow others, and have no coordinates of their own."""
    # Links of such joints are bodies too. The joints themselves are described by dicts, which take ten times as long.
    return len(scene.body_names) > len(scene.joint_names)


def check_tree(scene: Scene, what: str) -> None:
    """Refuse a scene with connections in functions that support only trees."""
    if scene.loops.names:
        names = ", ".join(map(repr, scene.loops.names[:8]))
        message = f"found a scene with connections ({names}); expected a tree: scene.without_constraints() is the same one without them"
        raise of_argument(ArgumentError, what, message)
