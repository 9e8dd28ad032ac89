"""Simplifications of the scene, their reasons and savings: the time with and without each of them, interleaved."""

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
    """Forward dynamics in covariance form from Python on one thread, all states in one call, ns per state, medians.

    For a factor: one right-hand side of `solve` compared with forward dynamics at the same q, and an `update`
    compared with a new factor, per call.
    """

    of: Of | None
    """Description of the call."""
    ns_on: float | None
    """With the simplification, or with the factor."""
    ns_off: float | None
    """Without this simplification, or without the factor."""


#: Index of the names of simplifications in a pickled scene.
LEFT_OUT = 6


def without(scene: Scene, switch: str) -> Scene:
    """The same scene without one simplification."""
    rebuild, (description,) = scene.__reduce__()
    left_out = [name for name in description[LEFT_OUT] if name != switch]
    again: Scene = rebuild((*description[:LEFT_OUT], left_out, *description[LEFT_OUT + 1 :]))
    return again


def measured(scene: Scene, states: States) -> dict[str, Times]:
    """Times of the simplifications of this scene by switch, and of calls on the factor by description; pairs
    that cannot both be timed are omitted.
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
    """Key of the times of an item."""
    return item.switch or item.what


def _pair(scene: Scene, states: States, item: Simplification) -> tuple[str, int, Once, Once] | None:
    """Timed loops of an item: the call, the number of states, the loop with the simplification, and the loop without
    it.
    """
    if item.switch is not None:
        # Two of the simplifications concern calls at rest.
        here = replace(states, qd=np.zeros_like(states.qd)) if item.switch.startswith("zero_") else states
        return FORWARD, len(here), _forward(scene, here), _forward(without(scene, item.switch), here)
    if "share q" in item.what:
        factor = scene.factor(states.q[0], form="covariance")
        here = replace(states, q=np.broadcast_to(states.q[0], states.q.shape))
        return f"factor.solve(tau) compared with {FORWARD}", len(here), looped(factor.solve, [(here.tau,)]), _forward(scene, here)
    if "only the last joint" in item.what:
        # Alternates between two configurations, so that each call changes the joint.
        step = np.zeros(scene.nv)
        step[-1] = 0.1
        both = [(states.q[0],), (scene.integrate(states.q[0], step),)]
        moving, new = scene.factor(*both[1], form="covariance"), partial(scene.factor, form="covariance")
        return "factor.update(q) compared with scene.factor(q)", len(both), looped(moving.update, both), looped(new, both)
    return None


def _forward(scene: Scene, states: States) -> Once:
    return looped(partial(scene.forward_dynamics, form="covariance"), [states.arrays])


def _collect(report: Report, _: Reporter) -> dict[str, Any]:
    plan = report.scene.plan()
    try:
        times = measured(report.scene, report.solvable) if report.scene.nv else {}
    except errors.PhipsiError:
        times = {}
    fields = ("what", "switch", "count", "names", "why", "saved", "operations")
    nothing = Times(None, None, None)
    items = [{**{name: getattr(item, name) for name in fields}, "of": times.get(name_of(item), nothing)} for item in plan.items]
    return {"bodies": plan.bodies, "links": plan.links, "items": items}


SECTION = Section("plan", "Simplifications", _collect, shown=lambda _: TURNS[True])
