"""What the public calls take, called from Python: one state, and a batch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import _core, errors
from .._core import Scene
from . import auto_cost, kinds
from .kinds import Array, Drawn
from .measure import DENSE_CAP, median
from .timing import BATCH, Arguments, Once, in_turns, one_by_one, one_thread

#: Of forward dynamics, `auto` first, as it is what a call does that names none.
FORMS = ("auto", "covariance", "square-root", "joseph")
#: Numbers that the matrices of a batch have at the most.
MOST_NUMBERS = 4_000_000


@dataclass(frozen=True)
class CallTime:
    """Median time of one public call from Python, on one thread."""

    call: str
    form: str | None
    """None where the call has none."""
    states: str
    """One of KINDS."""
    batch: int
    """States of a call."""
    ns: float
    """ns a state."""


@dataclass(frozen=True)
class _Call:
    text: str
    form: str | None
    run: Callable[..., Any]
    takes: int
    """How many of q, qd, tau it takes."""
    is_matrix: bool = False


def _calls(scene: Scene) -> list[_Call]:
    def forward(form: str) -> Callable[..., Any]:
        return lambda q, qd, tau: scene.forward_dynamics(q, qd, tau, form=form)  # type: ignore[call-overload]

    def inverse(form: str) -> Callable[..., Any]:
        return lambda q: scene.mass_matrix_inverse(q, form=form)  # type: ignore[call-overload]

    found = [_Call("scene.forward_dynamics(q, qd, tau)", form, forward(form), 3) for form in FORMS]
    found.append(_Call("scene.inverse_dynamics(q, qd, qdd)", None, scene.inverse_dynamics, 3))
    found.append(_Call("scene.bias_torque(q, qd)", None, scene.bias_torque, 2))
    if scene.nv <= DENSE_CAP:
        found.append(_Call("scene.mass_matrix(q)", None, scene.mass_matrix, 1, True))
        found += [_Call("scene.mass_matrix_inverse(q)", form, inverse(form), 1, True) for form in FORMS[:2]]
    return found


def measured(scene: Scene, drawn: Drawn, quick: bool) -> list[CallTime]:
    """Every call at the random states, in turns: one state a call, and a batch. Without a call that a form refuses."""
    states = kinds.state(scene, drawn, kinds.RANDOM)
    rows = []
    with one_thread():
        usable = [call for call in _calls(scene) if _answers(call, states)]
        for is_batch in (False, True):
            sized = [_sized(scene, call, states, is_batch) for call in usable]
            times = in_turns([_loop(call, arguments) for call, (_, arguments) in zip(usable, sized, strict=True)], quick)
            for call, (size, arguments), ns in zip(usable, sized, np.median(times, axis=0), strict=True):
                per_state = float(ns) / (size * len(arguments))
                rows.append(CallTime(call.text, call.form, kinds.RANDOM, size, per_state))
    return rows


def _answers(call: _Call, states: Arguments) -> bool:
    try:
        call.run(*(array[:1] for array in states[: call.takes]))
    except errors.PhipsiError:
        return False
    return True


def _sized(scene: Scene, call: _Call, states: Arguments, is_batch: bool) -> tuple[int, list[Arguments]]:
    """States a call, and the arguments of each call."""
    taken = states[: call.takes]
    if not is_batch:
        return 1, one_by_one(taken)
    size = max(2, min(len(states[0]), MOST_NUMBERS // scene.nv**2)) if call.is_matrix else len(states[0])
    return size, [tuple(array[:size] for array in taken)]


def _loop(call: _Call, calls: list[Arguments]) -> Once:
    def once() -> None:
        for arguments in calls:
            call.run(*arguments)

    return once


def batch_of(scene: Scene, q: Array, qd: Array, tau: Array, seed: int) -> Drawn:
    """BATCH states, those given over and over, to make every kind of; for the calls' times."""
    at = np.arange(BATCH) % len(q)
    return kinds.of(scene, q[at], qd[at], tau[at], np.random.default_rng((seed, 2)))


@dataclass(frozen=True)
class KindError:
    """Error of forward dynamics at states of one kind in one form, from Python.

    Of each state the largest error of an acceleration over the largest acceleration, or over that of bias torque alone where this is
    more: of what is held still nothing is left to be compared with.
    """

    kind: str
    form: str
    median: float
    worst: float


def kind_errors(scene: Scene, drawn: Drawn, count: int) -> list[KindError]:
    """The errors of the first `count` states of every kind against double-double, for "auto" and "covariance"."""
    rows = []
    first = Drawn(drawn.q[:count], drawn.qd[:count], drawn.tau[:count], drawn.joint[:count])
    for kind in kinds.KINDS:
        q, qd, tau = kinds.state(scene, first, kind)
        try:
            exact = _core.reference(scene, q, qd, tau).toarray()
            alone = scene.forward_dynamics(q, qd, np.zeros_like(tau))
            found = {form: scene.forward_dynamics(q, qd, tau, form=form) for form in auto_cost.FORMS}  # type: ignore[call-overload]
        except errors.PhipsiError:
            continue
        scale = np.maximum(np.abs(exact), np.abs(alone)).max(axis=1)
        for form, values in found.items():
            off = np.abs(values - exact).max(axis=1)
            relative = np.divide(off, scale, out=np.zeros_like(off), where=off > 0.0)
            rows.append(KindError(kind, form, median(relative), float(relative.max())))
    return rows
