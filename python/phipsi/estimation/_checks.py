"""Checks of times, units and derivatives of logs. Errors and LogWarnings name the argument and the joint."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..errors import ArgumentError, LogWarning, ShapeError, of_argument, warn

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["checked_time", "in_seconds", "shifted", "warn_of_motion"]

_Array = NDArray[np.float64]

#: Units of times other than s: length, s; median steps, and times since 1970, from which times are in this unit. A log in
#: s has smaller ones. Steps of ms are also those of a slow log in s, if they are not whole numbers.
UNITS = (("ns", 1e-9, 5e4, 1e17), ("us", 1e-6, 50.0, 1e14), ("ms", 1e-3, 0.5, 1e11))
#: Minimum length of a gap in time, in median steps.
GAP = 10.0
#: Ratio between measured and numerical derivatives beyond which units are inconsistent, and minimum correlation for it.
RATIO, CORRELATED = 1.5, 0.9
#: Largest plausible angle of a joint with limits, rad; integers beyond the second value are encoder counts.
FAR, FEW = 1e3, 20.0


def in_seconds(time: ArrayLike) -> _Array:
    """Times in s. Those that are counts of ns, us or ms, by their size or their steps, are converted, with a warning."""
    found = np.asarray(_core._numbers("time", time))
    if found.ndim != 1 or len(found) < 2 or not np.isfinite(found).all():
        return found
    step, whole = float(np.median(np.abs(np.diff(found)))), np.asarray(time).dtype.kind in "iu"
    for unit, length, least, since_1970 in UNITS:
        if abs(found[0]) < since_1970 and step < least:
            continue
        rate = f"a median step of {step:.3g}, which is {1.0 / (length * step):.3g} Hz in {unit}" if step > 0.0 else f"{found[0]:.3g}"
        if unit == "ms" and abs(found[0]) < since_1970 and not whole:
            warn(f"time: found {rate}; expected s: 1e-3 * time if it is in ms", LogWarning)
            return found
        warn(f"time: found {rate}; expected s: read as {unit}; {length:g} * time avoids this warning", LogWarning)
        return length * found
    return found


def checked_time(time: ArrayLike, count: int) -> _Array:
    """Return the times, (k,), s, after a check that they do not decrease. Warn about units, gaps and repeated times."""
    found = np.asarray(_core._numbers("time", time))
    if found.shape != (count,):
        raise of_argument(ShapeError, "time", f"found shape {found.shape}; expected ({count},), one time per row")
    if not np.isfinite(found).all():
        at = int(np.flatnonzero(~np.isfinite(found))[0])
        raise of_argument(ArgumentError, "time", f"found {found[at]} at row {at}; expected finite times, s")
    steps = np.diff(found)
    if np.any(steps < 0.0):
        at = int(np.flatnonzero(steps < 0.0)[0])
        message = (
            f"found {found[at + 1]:g} after {found[at]:g} at row {at + 1}; expected times that rise: sort all arrays"
            " by np.argsort(time)"
        )
        raise of_argument(ArgumentError, "time", message)
    found = in_seconds(time)
    steps = np.diff(found)
    if repeated := int(np.sum(steps == 0.0)):
        at = int(np.flatnonzero(steps == 0.0)[0])
        warn(
            f"time: found {repeated} repeated times, the first {found[at]:g} at row {at + 1}; np.unique(time,"
            " return_index=True) gives rows without them",
            LogWarning,
        )
    usual = float(np.median(steps)) if len(steps) else 0.0
    if usual > 0.0 and np.any(gaps := steps > GAP * usual):
        at = int(np.argmax(steps))
        text = (
            f"time: found {int(gaps.sum())} gaps, the longest of {steps[at]:.3g} s after {found[at]:g} s, with steps of"
            f" {usual:.3g} s elsewhere"
        )
        warn(
            f"{text}; add the parts one by one to a phipsi.estimation.Accumulator if they are separate logs",
            LogWarning,
        )
    return found


class _Joint(NamedTuple):
    name: str
    q: int
    v: int
    angle: bool


def _one_axis(scene: Scene) -> list[_Joint]:
    found = []
    for name in scene.joint_names:
        of, at = scene.v_index(name), scene.q_index(name)
        kind = scene.joints[name].type
        if of.stop - of.start == 1 and at.stop - at.start == 1:
            found.append(_Joint(name, at.start, of.start, kind not in ("prismatic",)))
    return found


def warn_of_motion(scene: Scene, time: _Array | None, q: _Array, qd: _Array, qdd: _Array) -> bool:
    """Warn about positions in degrees or encoder counts, and about inconsistent derivatives; return whether there was no
    warning."""
    limits, texts = scene.limits, []
    for joint in _one_axis(scene):
        values = q[:, joint.q]
        low, high = float(limits.lower[joint.v]), float(limits.upper[joint.v])
        reach = float(np.max(np.abs(values)))
        if not joint.angle:
            continue
        limited = np.isfinite(low) and np.isfinite(high) and high > low
        whole = reach > FEW and np.array_equal(values, np.round(values))
        if whole or (limited and reach > FAR):
            found = f"{reach:.3g} at joint {joint.name!r} with limits of {low:.3g} and {high:.3g} rad"
            if whole:
                found = f"whole numbers up to {reach:.3g} at joint {joint.name!r}, probably encoder counts"
            texts.append(f"q: found {found}; expected rad: multiply by 2 pi / counts per revolution")
        elif limited:
            beyond = max(low - float(values.min()), float(values.max()) - high)
            # Within the limits as degrees, and far outside of them as radians.
            if (
                beyond > 2.0 * (high - low)
                and low - 0.1 <= np.radians(values.min())
                and np.radians(values.max()) <= high + 0.1
            ):
                text = (
                    f"q: found {reach:.3g} at joint {joint.name!r}, outside its limits of {low:.3g} and {high:.3g} rad,"
                    " but within them if q is in degrees; expected rad: np.deg2rad(q)"
                )
                texts.append(text)
    steps = np.zeros(0) if time is None else np.diff(time)
    usual = float(np.median(steps)) if len(steps) else 0.0
    near = (steps > 0.0) & (steps < GAP * usual)
    for joint in _one_axis(scene) if len(steps) > 8 else ():
        for name, of, values, derivative in (
            ("qd", "q", q[:, joint.q], qd[:, joint.v]),
            ("qdd", "qd", qd[:, joint.v], qdd[:, joint.v]),
        ):
            differences, means = np.diff(values)[near] / steps[near], 0.5 * (derivative[1:] + derivative[:-1])[near]
            ratio = _ratio(differences, means)
            if ratio is not None and not 1.0 / RATIO < ratio < RATIO:
                # With mixed units each derivative is off; with times in ms, both are off by the same factor.
                hint = (
                    f"{name} is probably in degrees and {of} in rad"
                    if abs(ratio * 57.3 - 1.0) < 0.15
                    else f"{of} is probably in degrees and {name} in rad"
                    if abs(ratio / 57.3 - 1.0) < 0.15
                    else "time is probably in ms"
                    if abs(ratio * 1e3 - 1.0) < 0.05
                    else "their units are inconsistent"
                )
                text = (
                    f"{name}: found a numerical derivative of {of} that is {ratio:.3g} times {name} at joint"
                    f" {joint.name!r}: {hint}; expected rad, s and their derivatives"
                )
                texts.append(text)
    for text in texts:
        warn(text, LogWarning)
    return not texts


def _ratio(found: _Array, expected: _Array) -> float | None:
    """Constant factor between two correlated signals; None if they are not correlated."""
    squares, others, both = float(found @ found), float(expected @ expected), float(found @ expected)
    if squares == 0.0 or others == 0.0 or abs(both) < CORRELATED * np.sqrt(squares * others):
        return None
    return both / others


def shifted(tau: _Array, time: _Array, delay: float) -> _Array:
    """Torques with a delay removed by linear interpolation; NaN outside of the log and next to missing torques."""
    found = np.empty_like(tau)
    for motor in range(tau.shape[1]):
        found[:, motor] = np.interp(time + delay, time, tau[:, motor], left=np.nan, right=np.nan)
    return found
