"""What was not computed, why that changes nothing, and what it saves: the scene beside the same one with one switch off, in turns."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ... import errors
from ..._core import Scene
from ..._results import Simplification
from .. import kinds
from ..pipeline import Section
from ..progress import Reporter
from ..robot import FORWARD, Report
from ..states import States
from ..timing import TURNS, Of, Once, in_turns, looped, threads

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


#: Where a pickled scene has the names of what is left out.
LEFT_OUT = 6


def without(scene: Scene, switch: str) -> Scene:
    """The same scene with one switch off."""
    rebuild, (description,) = scene.__reduce__()
    left_out = [name for name in description[LEFT_OUT] if name != switch]
    again: Scene = rebuild((*description[:LEFT_OUT], left_out, *description[LEFT_OUT + 1 :]))
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
            call, count, *loops = pair
            try:
                times = np.median(in_turns(loops, True), axis=0) / count
            except errors.PhipsiError:
                continue
            at = f"{kinds.RANDOM}, qd = 0" if (item.switch or "").startswith("zero_") else kinds.RANDOM
            of = Of("Python", call, "covariance", at, len(states))
            found[name_of(item)] = Times(of, *map(float, times))
    return found


def name_of(item: Simplification) -> str:
    """What the times of an item are found by."""
    return item.switch or item.what


def _pair(scene: Scene, states: States, item: Simplification) -> tuple[str, int, Once, Once] | None:
    """What is timed for an item: the call, of how many states, with this left out, and without."""
    if item.switch is not None:
        # Two of the switches are for calls at rest.
        here = replace(states, qd=np.zeros_like(states.qd)) if item.switch.startswith("zero_") else states
        return FORWARD, len(here), _forward(scene, here), _forward(without(scene, item.switch), here)
    if "share q" in item.what:
        factor = scene.factor(states.q[0], form="covariance")
        here = replace(states, q=np.broadcast_to(states.q[0], states.q.shape))
        return f"factor.solve(tau) beside {FORWARD}", len(here), looped(factor.solve, [(here.tau,)]), _forward(scene, here)
    if "only the last joint" in item.what:
        # There and back, so that each call moves it.
        step = np.zeros(scene.nv)
        step[-1] = 0.1
        both = [(states.q[0],), (scene.integrate(states.q[0], step),)]
        moving, anew = scene.factor(*both[1], form="covariance"), partial(scene.factor, form="covariance")
        return "factor.update(q) beside scene.factor(q)", len(both), looped(moving.update, both), looped(anew, both)
    return None


def _forward(scene: Scene, states: States) -> Once:
    return looped(partial(scene.forward_dynamics, form="covariance"), [states.arrays])


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


SECTION = Section("plan", "Work that is left out", _collect, shown=lambda _: TURNS[True])
