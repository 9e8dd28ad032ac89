"""What leaving out saves in time: the scene as it is beside the same scene with one switch off, in turns."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from .. import errors
from .._core import Scene
from .measure import median
from .states import States

#: Each pair is timed this often, in turns.
TURNS = 15


class Times(NamedTuple):
    """Forward dynamics in covariance form, all states in one call, ns a state, medians."""

    on: float
    """As the scene is."""
    off: float
    """With this switch off."""


def without(scene: Scene, switch: str) -> Scene:
    """The same scene with one switch off."""
    rebuild, (description,) = scene.__reduce__()
    *rest, left_out, locked = description
    again: Scene = rebuild((*rest, [name for name in left_out if name != switch], locked))
    return again


def measured(scene: Scene, states: States) -> dict[str, Times]:
    """The times of every switch that leaves something out of this scene; where the pair cannot both be timed, none."""
    found = {}
    for switch in (item.switch for item in scene.plan().items):
        if switch is None:
            continue
        # Two of the switches are for calls at rest.
        qd = np.zeros_like(states.qd) if switch.startswith("zero_") else states.qd
        both = (scene, without(scene, switch))
        rows = []
        try:
            for _ in range(TURNS):
                rows.append([_timed(each, states, qd) for each in both])
        except errors.PhipsiError:
            continue
        on, off = np.array(rows).T
        found[switch] = Times(median(on), median(off))
    return found


def _timed(scene: Scene, states: States, qd: np.ndarray) -> float:
    start = time.perf_counter_ns()
    scene.forward_dynamics(states.q, qd, states.tau, form="covariance")
    return (time.perf_counter_ns() - start) / len(states)
