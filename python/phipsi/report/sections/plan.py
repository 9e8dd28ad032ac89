"""What was not computed, why that changes nothing, and what it saves: the scene beside the same one with one switch off, in turns."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ... import errors
from ..._core import Omission, Scene
from .. import kinds
from ..pipeline import Section
from ..progress import Reporter
from ..robot import FORWARD, Array, Report, median
from ..states import States
from ..timing import Of, threads

#: Each pair is timed this often, in turns.
TURNS = 15


class Times(NamedTuple):
    """Forward dynamics in covariance form from Python on one thread, all states in one call, ns a state, medians.

    Of the factor: a right side of `solve` beside forward dynamics at the same q, and an `update` beside a new factor, call by call.
    """

    of: Of | None
    """What is called."""
    ns_on: float | None
    """As the scene is, or by the factor."""
    ns_off: float | None
    """With this switch off, or without the factor."""


#: Does something once; gives ns a state.
Timer = Callable[[], float]


def without(scene: Scene, switch: str) -> Scene:
    """The same scene with one switch off."""
    rebuild, (description,) = scene.__reduce__()
    *rest, left_out, locked, root = description
    again: Scene = rebuild((*rest, [name for name in left_out if name != switch], locked, root))
    return again


def measured(scene: Scene, states: States) -> dict[str, Times]:
    """The times of what is left out of this scene, by switch; of calls on the factor, by what the plan calls them.

    Where a pair cannot both be timed, there is none.
    """
    found = {}
    with threads(1):
        for item in scene.plan().items:
            pair = _pair(scene, states, item)
            if pair is None:
                continue
            call, on, off = pair
            try:
                rows = [(on(), off()) for _ in range(TURNS)]
            except errors.PhipsiError:
                continue
            at = f"{kinds.RANDOM}, qd = 0" if (item.switch or "").startswith("zero_") else kinds.RANDOM
            of = Of("Python", call, "covariance", at, len(states))
            found[name_of(item)] = Times(of, *(median(times) for times in np.array(rows).T))
    return found


def name_of(item: Omission) -> str:
    """What the times of an item are found by."""
    return item.switch or item.what


def _pair(scene: Scene, states: States, item: Omission) -> tuple[str, Timer, Timer] | None:
    """What is timed for an item: the call, ns a state with this left out, and without."""
    if item.switch is not None:
        # Two of the switches are for calls at rest.
        here = replace(states, qd=np.zeros_like(states.qd)) if item.switch.startswith("zero_") else states
        return FORWARD, _forward(scene, here), _forward(without(scene, item.switch), here)
    if "share q" in item.what:
        factor = scene.factor(states.q[0], form="covariance")
        here = replace(states, q=np.broadcast_to(states.q[0], states.q.shape))
        return f"factor.solve(tau) beside {FORWARD}", _clocked(lambda: factor.solve(here.tau), len(here)), _forward(scene, here)
    if "last joint alone" in item.what:
        # There and back, so that each call moves it.
        step = np.zeros(scene.nv)
        step[-1] = 0.1
        both = np.array([states.q[0], scene.integrate(states.q[0], step)])
        moving = scene.factor(both[1], form="covariance")
        return (
            "factor.update(q) beside scene.factor(q)",
            _clocked(lambda: [moving.update(q) for q in both], 2),
            _clocked(lambda: [scene.factor(q, form="covariance") for q in both], 2),
        )
    return None


def _forward(scene: Scene, states: States) -> Timer:
    return _clocked(lambda: scene.forward_dynamics(*states.arrays, form="covariance"), len(states))


def _clocked(call: Callable[[], object], states: int) -> Timer:
    def once() -> float:
        start = time.perf_counter_ns()
        call()
        return (time.perf_counter_ns() - start) / states

    return once


def _collect(report: Report, _: Reporter) -> dict[str, Any]:
    plan = report.scene.plan()
    try:
        times = measured(report.scene, report.solvable) if report.scene.nv else {}
    except errors.PhipsiError:
        times = {}
    told = ("what", "switch", "count", "names", "why", "saved", "operations")
    nothing = Times(None, None, None)
    items = [{**{name: getattr(item, name) for name in told}, "of": times.get(name_of(item), nothing)} for item in plan.items]
    return {"bodies": plan.bodies, "links": plan.links, "items": items}


SECTION = Section("plan", "Left out", _collect, shown=lambda _: TURNS)
