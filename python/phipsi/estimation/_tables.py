"""Tables and named arrays of logs: which column is the position, velocity, acceleration or torque of which joint."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ArgumentError, LogWarning, of_argument, warn

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["ALIASES", "arrays_of", "by_names", "listed", "read_csv", "times_of"]

_Array = NDArray[np.float64]

#: Names of the arrays of a log in files.
NAMES = {
    "time": "t timestamp stamp",
    "q": "position positions pos joint_position joint_positions",
    "qd": "velocity velocities vel qdot dq joint_velocity joint_velocities",
    "qdd": "acceleration accelerations acc accel qddot ddq joint_acceleration joint_accelerations",
    "tau": "effort efforts torque torques joint_effort joint_efforts joint_torque joint_torques",
}
#: Alternative names, and those of the arrays.
ALIASES = {alias: name for name, aliases in NAMES.items() for alias in (name, *aliases.split())}
#: Names of the joints next to the arrays.
LABELS = ("joint_names", "names", "name", "joints")
#: Units at the end of the name of a column of times, in s.
UNITS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "nsec": 1e-9, "nanosec": 1e-9}
TIME = re.compile(r"(?:.*[/.:])?[_%]*(?:t|time|timestamp|stamp)(?:[ _.\[(/]*(" + "|".join(UNITS) + r")[\])]?)?", re.IGNORECASE)
#: Quantity and index: position[0], position.0, position0, q_1, q1.
INDEXED = re.compile(r"(?:.*[/.:])?([a-z_]+?)(\[|[._])?(\d+)\]?", re.IGNORECASE)
#: Separators between topic, joint and quantity.
SEPARATED = "/.:"
#: Largest number of columns in a message.
LISTED = 20


def read_csv(path: Path) -> dict[str, _Array | list[str]]:
    """Columns of a text file by name: numbers, NaN where a cell is empty; texts where there are other ones."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise of_argument(ArgumentError, "log", f"found {error}; expected a table as text") from None
    lines = [line for line in text.splitlines() if line.strip()]
    head = lines[0] if lines else ""
    separator = max(",;\t", key=head.count)
    rows = list(csv.reader(lines, delimiter=separator, skipinitialspace=True))
    if len(rows) < 2:
        raise of_argument(ArgumentError, "log", f"found {len(rows)} lines in {str(path)!r}; expected names of columns, and rows")
    names = [name.strip() for name in rows[0]]
    for at, row in enumerate(rows):
        # A separator at the end of each row is an empty cell.
        if len(row) != len(names) and any(cell.strip() for cell in row[len(names) :]) or len(row) < len(names):
            found = f"found {len(row)} cells in row {at} of {str(path)!r}; expected {len(names)}, one per column"
            raise of_argument(ArgumentError, "log", found)
    return {name: _values([row[at].strip() for row in rows[1:]], separator == ";") for at, name in enumerate(names) if name}


def _values(cells: list[str], decimal_comma: bool) -> _Array | list[str]:
    try:
        return np.array([float(cell.replace(",", ".") if decimal_comma else cell) if cell else np.nan for cell in cells])
    except ValueError:
        return cells


def listed(names: Iterable[str]) -> str:
    """Names in a message."""
    known = list(names)
    more = f" and {len(known) - LISTED} more" if len(known) > LISTED else ""
    return ", ".join(known[:LISTED]) + more if known else "none"


def times_of(columns: Mapping[str, _Array | list[str]]) -> NDArray[Any] | None:
    """Times, (k,), from the column with the shortest name of a time; in s if the name contains a unit, as integers if they are whole."""
    found = {name: match for name in columns if (match := TIME.fullmatch(name)) is not None}
    if not found:
        return None
    name = min(found, key=len)
    values, unit = _numbers(name, columns), found[name][1]
    if unit is not None:
        # A stamp of ROS has two columns.
        rest = next((_numbers(other, columns) for end in ("nanosec", "nsec") if (other := name[: -len(unit)] + end) in columns), None)
        return values * UNITS[unit.lower()] + (0.0 if rest is None or unit.lower() == "nanosec" else 1e-9 * rest)
    return values.astype(np.int64) if np.isfinite(values).all() and np.array_equal(values, np.round(values)) else values


def arrays_of(columns: Mapping[str, _Array | list[str]], scene: Scene) -> dict[str, _Array]:
    """q, qd, qdd and tau, (k, nv), from named columns."""
    found: dict[str, dict[int, str]] = {}
    indexed: dict[str, dict[int, str]] = {}
    joints = sorted(scene.joint_names, key=len, reverse=True)
    for name in columns:
        of_joint, of_index = _joint(name, joints), INDEXED.fullmatch(name)
        if of_joint is not None:
            _once(found.setdefault(of_joint[0], {}), scene.v_index(of_joint[1]).start, name)
        elif of_index is not None and (kind := ALIASES.get(of_index[1].lower().rstrip("_"))) not in (None, "time"):
            _once(indexed.setdefault(str(kind), {}), int(of_index[3]), name)
    for kind, by_index in indexed.items():
        if kind not in found:
            found[kind] = _in_order(kind, by_index, columns, scene)
    arrays: dict[str, _Array] = {}
    for kind, of_joints in found.items():
        lacking = [at for at in range(scene.nv) if at not in of_joints]
        if lacking:
            joint = scene.joint_names[lacking[0]] if len(scene.joint_names) == scene.nv else f"number {lacking[0]}"
            expected = f"{joint}.{kind} or {kind}{lacking[0] + 1}, or a joint that does not move: Scene.lock, --lock"
            text = f"found no column {kind} of joint {joint!r} in the columns {listed(columns)}; expected {expected}"
            raise of_argument(ArgumentError, "log", text)
        arrays[kind] = np.stack([_numbers(of_joints[at], columns) for at in range(scene.nv)], axis=1)
    return arrays


def _once(found: dict[int, str], at: int, name: str) -> None:
    """Add a column; two of one quantity and joint are ambiguous."""
    if at in found:
        text = f"found the columns {found[at]!r} and {name!r}; expected one of them: remove that of the other topic"
        raise of_argument(ArgumentError, "log", text)
    found[at] = name


def _numbers(name: str, columns: Mapping[str, _Array | list[str]]) -> _Array:
    values = columns[name]
    if isinstance(values, list):
        at = next(at for at, cell in enumerate(values) if isinstance(_values([cell], True), list))
        raise of_argument(ArgumentError, "log", f"found {values[at]!r} in row {at} of column {name!r}; expected numbers")
    return values


def _joint(name: str, joints: Sequence[str]) -> tuple[str, str] | None:
    """Quantity and joint of a column: joint and quantity, in any order, after a topic."""
    for joint in joints:
        for at in (name.find(joint), name.rfind(joint)):
            if at < 0:
                continue
            before, after = name[:at], name[at + len(joint) :]
            if after[:1] in (*SEPARATED, "_") and after and (not before or before[-1] in SEPARATED):
                kind = ALIASES.get(after[1:].lower())
            elif not after and before[-1:] in (*SEPARATED, "_") and before:
                kind = ALIASES.get(re.split(f"[{SEPARATED}]", before[:-1])[-1].lower())
            else:
                kind = None
            if kind is not None and kind != "time":
                return kind, joint
    return None


def _in_order(kind: str, by_index: dict[int, str], columns: Mapping[str, _Array | list[str]], scene: Scene) -> dict[int, str]:
    """Columns with indices, by row of qd: those of a message begin at 0, with the names of the joints beside them; q1, q2, ... are in the order of the scene."""
    first = next(iter(by_index.values()))
    begin = 0 if 0 in by_index or "[" in first else 1
    names = {
        int(found[3]): values[0]
        for name, values in columns.items()
        if isinstance(values, list) and (found := INDEXED.fullmatch(name)) is not None and found[1].lower().rstrip("_") in LABELS
    }
    if names:
        places = {scene.v_index(joint).start: index for index, joint in names.items() if joint in scene.joint_names}
        return {at: by_index[index] for at, index in places.items() if index in by_index}
    if len(by_index) > scene.nv:
        text = f"found {len(by_index)} columns such as {first!r} without names of joints"
        raise of_argument(ArgumentError, "log", f"{text}; expected {scene.nv}, those of {', '.join(scene.joint_names)}: name the columns JOINT.{kind}")
    if begin == 0:
        order = ", ".join(scene.joint_names)
        warn(f"log: found columns such as {first!r} without names of joints; they are read in the order {order}: name the columns JOINT.{kind} if it is another", LogWarning)
    return {index - begin: name for index, name in by_index.items()}


def by_names(what: str, names: Sequence[str], values: Any, scene: Scene, coordinates: bool) -> Any:
    """Columns of an array of a file, (..., nq) or (..., nv), in the order of the scene, from the names of the joints in the file; other joints are omitted."""
    index, known, array = (scene.q_index if coordinates else scene.v_index), list(map(str, names)), np.asarray(values)
    expected = f"those of the scene: {', '.join(scene.joint_names)}, without joints that do not move (Scene.lock, --lock)"
    if lacking := [joint for joint in scene.joint_names if joint not in known]:
        raise of_argument(ArgumentError, what, f"found no joint {lacking[0]!r} in the joint_names {listed(known)}; expected {expected}")
    if len(set(known)) < len(known):
        raise of_argument(ArgumentError, what, f"found a joint twice in the joint_names {listed(known)}; expected {expected}")
    # The joints of other robots have one coordinate, as far as the file says.
    widths = [index(joint).stop - index(joint).start if joint in scene.joint_names else 1 for joint in known]
    if array.ndim == 0 or array.shape[-1] != sum(widths):
        raise of_argument(ArgumentError, what, f"found shape {array.shape} for the joint_names {listed(known)}; expected (..., {sum(widths)})")
    ends = dict(zip(known, np.cumsum(widths), strict=True))
    order = [ends[joint] - width + at for joint in scene.joint_names for width in [index(joint).stop - index(joint).start] for at in range(width)]
    return array[..., order]
