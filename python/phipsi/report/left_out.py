"""What leaving out saves in time: the scene as it is beside the same scene with one switch off, in turns."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .. import errors
from .._core import Scene
from .._results import Omission
from .measure import median
from .states import States
from .timing import one_thread

#: The call that switches are timed with.
FORWARD = "scene.forward_dynamics(q, qd, tau)"
#: Each pair is timed this often, in turns.
TURNS = 15


class Times(NamedTuple):
    """Forward dynamics in covariance form from Python on one thread, all states in one call, ns a state, medians.

    Of the factor: a right side of `solve` beside forward dynamics at the same q, and an `update` beside a new factor, call by call.
    """

    on: float
    """As the scene is, or by the factor."""
    off: float
    """With this switch off, or without the factor."""
    call: str
    """What is called."""


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
    with one_thread():
        for item in scene.plan().items:
            pair = _pair(scene, states, item)
            if pair is None:
                continue
            name, call, on, off = pair
            try:
                rows = [(on(), off()) for _ in range(TURNS)]
            except errors.PhipsiError:
                continue
            ours, others = (median(times) for times in np.array(rows).T)
            found[name] = Times(ours, others, call)
    return found


def name_of(item: Omission) -> str:
    """What the times of an item are found by."""
    return item.switch or item.what


def _pair(scene: Scene, states: States, item: Omission) -> tuple[str, str, Timer, Timer] | None:
    """What is timed for an item: its name, the call, ns a state with this left out, and without."""
    if item.switch is not None:
        # Two of the switches are for calls at rest.
        qd = np.zeros_like(states.qd) if item.switch.startswith("zero_") else states.qd
        other = without(scene, item.switch)
        return name_of(item), FORWARD, lambda: _timed(scene, states, qd), lambda: _timed(other, states, qd)
    if "share q" in item.what:
        factor = scene.factor(states.q[0], form="covariance")
        here = replace(states, q=np.broadcast_to(states.q[0], states.q.shape))
        return (
            name_of(item),
            f"factor.solve(tau) beside {FORWARD}",
            lambda: _clocked(factor.solve, here.tau, len(here)),
            lambda: _timed(scene, here, here.qd),
        )
    if "last joint alone" in item.what:
        # There and back, so that each call moves it.
        step = np.zeros(scene.nv)
        step[-1] = 0.1
        both = np.array([states.q[0], scene.integrate(states.q[0], step)])
        moving = scene.factor(both[1], form="covariance")

        def updated(q: np.ndarray) -> None:
            for each in q:
                moving.update(each)

        def anew(q: np.ndarray) -> None:
            for each in q:
                scene.factor(each, form="covariance")

        return (
            name_of(item),
            "factor.update(q) beside scene.factor(q)",
            lambda: _clocked(updated, both, 2),
            lambda: _clocked(anew, both, 2),
        )
    return None


def _clocked(call: Callable[[np.ndarray], object], argument: np.ndarray, states: int) -> float:
    start = time.perf_counter_ns()
    call(argument)
    return (time.perf_counter_ns() - start) / states


def _timed(scene: Scene, states: States, qd: np.ndarray) -> float:
    start = time.perf_counter_ns()
    scene.forward_dynamics(states.q, qd, states.tau, form="covariance")
    return (time.perf_counter_ns() - start) / len(states)
