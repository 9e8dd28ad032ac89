"""Time of the public calls from Python, for one state and a batch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ... import errors
from ..._core import Scene
from .. import kinds
from ..kinds import Drawn
from ..pipeline import Section
from ..progress import Reporter
from ..robot import DENSE_CAP, FORWARD, Report
from ..timing import Arguments, Of, in_turns, looped, one_by_one, threads

#: Forms of forward dynamics; `auto`, the default, comes first.
FORMS = ("auto", "covariance", "square-root")
#: Largest number of entries of the matrices of a batch.
MOST_NUMBERS = 4_000_000


@dataclass(frozen=True)
class CallTime:
    """Median time of one public call from Python, on one thread."""

    of: Of
    ns_per_state: float


@dataclass(frozen=True)
class _Call:
    text: str
    form: str | None
    run: Callable[..., Any]
    takes: int
    """Number of arguments of q, qd, tau."""
    is_matrix: bool = False


def _calls(scene: Scene) -> list[_Call]:
    found = [_Call(FORWARD, form, partial(scene.forward_dynamics, form=form), 3) for form in FORMS]
    found.append(_Call("scene.inverse_dynamics(q, qd, qdd)", None, scene.inverse_dynamics, 3))
    found.append(_Call("scene.bias_torque(q, qd)", None, scene.bias_torque, 2))
    if scene.nv <= DENSE_CAP:
        found.append(_Call("scene.mass_matrix(q)", None, scene.mass_matrix, 1, True))
        inverse = scene.mass_matrix_inverse
        found += [_Call("scene.mass_matrix_inverse(q)", form, partial(inverse, form=form), 1, True) for form in FORMS[:2]]
    return found


def measured(scene: Scene, drawn: Drawn, quick: bool, reporter: Reporter) -> list[CallTime]:
    """Time of every call at the random states, interleaved: one state per call, and a batch. Calls whose form
    raises are omitted.
    """
    states = kinds.state(scene, drawn, kinds.RANDOM)
    rows = []
    with threads(1):
        usable = [call for call in _calls(scene) if _answers(call, states)]
        for is_batch in reporter.each("Time of calls", (False, True)):
            sized = [_sized(scene, call, states, is_batch) for call in usable]
            loops = [looped(call.run, arguments) for call, (_, arguments) in zip(usable, sized, strict=True)]
            times = np.median(in_turns(loops, quick), axis=0)
            for call, (size, arguments), ns in zip(usable, sized, times, strict=True):
                of = Of("Python", call.text, call.form, kinds.RANDOM, size)
                rows.append(CallTime(of, float(ns) / (size * len(arguments))))
    return rows


def _answers(call: _Call, states: Arguments) -> bool:
    try:
        call.run(*(array[:1] for array in states[: call.takes]))
    except errors.PhipsiError:
        return False
    return True


def _sized(scene: Scene, call: _Call, states: Arguments, is_batch: bool) -> tuple[int, list[Arguments]]:
    """Number of states per call, and the arguments of each call."""
    taken = states[: call.takes]
    if not is_batch:
        return 1, one_by_one(taken)
    size = max(2, min(len(states[0]), MOST_NUMBERS // scene.nv**2)) if call.is_matrix else len(states[0])
    return size, [tuple(array[:size] for array in taken)]


def _collect(report: Report, reporter: Reporter) -> list[CallTime]:
    return measured(report.scene, report.batch, report.quick, reporter)


SECTION = Section("calls", "Time of calls", _collect, empty=[])
