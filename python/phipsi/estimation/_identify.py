"""Implementation of Scene.identify: checks of a log in memory, and identification from it."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._arguments import names_of
from ..errors import ArgumentError, of_argument
from ._accumulator import Accumulator, _log
from ._checks import checked_time, shifted, warn_of_motion
from ._faults import Clock, warn_of_faults
from ._identification import Identification, _combinations, solved
from ._problem import Problem

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["identify"]

_Array = NDArray[np.float64]


def identify(
    scene: Scene,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    tau: ArrayLike,
    *,
    fit: Collection[str] = (),
    noise: ArrayLike | None = None,
    trust: float = 1.0,
    keep: Collection[str] = (),
    friction_speed: float = 0.01,
    stribeck_speed: float = 0.1,
    time: ArrayLike | None = None,
    transmission: ArrayLike | None = None,
    tau_delay: float = 0.0,
    acceleration_noise: ArrayLike | None = None,
    instruments: tuple[ArrayLike, ArrayLike, ArrayLike] | None = None,
    blocks: int = 20,
) -> Identification:
    """Implementation of Scene.identify."""
    if not (np.isfinite(trust) and trust > 0.0):
        raise of_argument(ArgumentError, "trust", f"found {trust}; expected a finite number above zero")
    q, qd, qdd, tau = _log(scene, q, qd, qdd, tau)
    times = None if time is None else checked_time(time, len(q))
    if not np.isfinite(tau_delay) or (tau_delay != 0.0 and times is None):
        raise of_argument(
            ArgumentError,
            "tau_delay",
            f"found {tau_delay}{' without time' if np.isfinite(tau_delay) else ''}; expected a finite delay in s, and"
            " time",
        )
    if tau_delay != 0.0 and times is not None:
        tau = shifted(tau, times, tau_delay)
    sound = warn_of_motion(scene, times, q, qd, qdd)

    def accumulated(kinds: tuple[str, ...], load: Scene | None) -> Accumulator:
        length = max(1, -(-len(q) // max(int(blocks), 1))) if isinstance(blocks, (int, np.integer)) else 1
        accumulator = Accumulator(
            scene,
            fit=kinds,
            keep=keep,
            friction_speed=friction_speed,
            stribeck_speed=stribeck_speed,
            transmission=transmission,
            load_model=load,
            instruments=instruments is not None,
            acceleration_noise=acceleration_noise,
            blocks=blocks,
            block_length=length,
        )
        return accumulator.add(q, qd, qdd, tau, instruments=instruments)

    kinds, keep, load = names_of(fit), names_of(keep), None
    if "load" in kinds:
        # Friction depends on the model torque, because the measured torque contains noise.
        others = tuple(kind for kind in kinds if kind != "load")
        if others or len(keep) < len(scene.body_names):
            load = solved(accumulated(others, None), noise, trust).scene
    accumulator = accumulated(kinds, load)
    tau = accumulator.columns.measured(q, tau)
    clock = Clock(float("nan"), float("nan"))
    if sound:
        used = _combinations(accumulator.columns).columns
        given = None if noise is None else Problem(accumulator).checked_noise(noise)
        # Otherwise the bias is predicted or removed.
        differences = acceleration_noise is None and instruments is None
        clock, sound = warn_of_faults(accumulator.columns, used, times, (q, qd, qdd, tau), given, differences)
    return solved(accumulator, noise, trust, clock=clock, check=sound)
