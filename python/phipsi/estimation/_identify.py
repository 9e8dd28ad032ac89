"""Implementation of Scene.identify: checks of a log in memory, and identification from it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._arguments import names_of
from ..errors import ArgumentError, of_argument
from ._accumulator import Accumulator, _log
from ._checks import checked_time, shifted, warn_of_motion
from ._faults import Clock, warn_of_faults
from ._identification import Identification, _combinations, checked_mass, checked_trust, solved
from ._problem import Problem

if TYPE_CHECKING:
    from .._core import Scene

__all__ = ["identify"]

_Array = NDArray[np.float64]

#: Smallest number of standard deviations of outliers; the largest number of rounds of rejection; and the standard
#: deviation of a normal distribution per median of the absolute value.
LEAST, ROUNDS, TO_DEVIATION = 2.0, 8, 1.4826


def identify(
    scene: Scene,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    tau: ArrayLike,
    *,
    fit: Collection[str] = (),
    noise: ArrayLike | None = None,
    trust: float | Mapping[str, float] | ArrayLike = 1.0,
    keep: Collection[str] = (),
    friction_speed: float = 0.01,
    stribeck_speed: float = 0.1,
    time: ArrayLike | None = None,
    transmission: ArrayLike | None = None,
    tau_delay: float = 0.0,
    acceleration_noise: ArrayLike | None = None,
    instruments: tuple[ArrayLike, ArrayLike, ArrayLike] | None = None,
    blocks: int = 20,
    total_mass: tuple[float, float] | None = None,
    outliers: float | None = None,
) -> Identification:
    """Implementation of Scene.identify."""
    checked_trust(scene, trust)
    if total_mass is not None:
        checked_mass(total_mass)
    if outliers is not None:
        if not (np.isfinite(outliers) and outliers >= LEAST):
            expected = f"expected a number of standard deviations, at least {LEAST:g}"
            raise of_argument(ArgumentError, "outliers", f"found {outliers}; {expected}")
        if scene.loops.names:
            found = "found a scene with connections, which determine sums of the torques"
            raise of_argument(ArgumentError, "outliers", f"{found}; expected None")
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
    kinds, keep = names_of(fit), names_of(keep)

    def accumulated(tau: _Array, kinds: tuple[str, ...], load: Scene | None) -> Accumulator:
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

    def of(tau: _Array) -> Accumulator:
        load = None
        if "load" in kinds:
            # Friction depends on the model torque, because the measured torque contains noise.
            others = tuple(kind for kind in kinds if kind != "load")
            if others or len(keep) < len(scene.body_names):
                load = solved(accumulated(tau, others, None), noise, trust, total_mass=total_mass).scene
        return accumulated(tau, kinds, load)

    rejected = np.zeros(tau.shape, dtype=bool)
    if outliers is not None:
        def identified(tau: _Array) -> Identification:
            return solved(of(tau), noise, trust, total_mass=total_mass, check=False)

        rejected = _outliers(identified, (q, qd, qdd, tau), outliers)
        tau = np.where(rejected, np.nan, tau)
    accumulator = of(tau)
    tau = accumulator.columns.measured(q, tau)
    clock = Clock(float("nan"), float("nan"))
    if sound:
        used = _combinations(accumulator.columns).columns
        weights = None if noise is None else Problem(accumulator).checked_noise(noise)
        # Otherwise the bias is predicted or removed.
        differences = acceleration_noise is None and instruments is None
        clock, sound = warn_of_faults(accumulator.columns, used, times, (q, qd, qdd, tau), weights, differences)
    counts = np.sum(rejected, axis=0)
    return solved(accumulator, noise, trust, total_mass=total_mass, clock=clock, outliers=counts, check=sound)


def _outliers(
    identified: Callable[[_Array], Identification], log: tuple[_Array, _Array, _Array, _Array], deviations: float
) -> NDArray[np.bool_]:
    """Torques whose residuals exceed a number of robust standard deviations, (k, motors).

    Rejection and identification alternate until the set of rejected torques stays the same.
    """
    q, qd, qdd, tau = log
    rejected = np.zeros(tau.shape, dtype=bool)
    for _ in range(ROUNDS):
        with warnings.catch_warnings():
            # The last identification issues them.
            warnings.simplefilter("ignore", UserWarning)
            found = identified(np.where(rejected, np.nan, tau))
        size = np.abs(tau - found.torques(q, qd, qdd))
        measured = [one[np.isfinite(one)] for one in size.T]
        sigma = TO_DEVIATION * np.array([np.median(one) if len(one) else np.nan for one in measured])
        # Residuals of the size of rounding have no outliers.
        beyond = size > deviations * np.maximum(sigma, found.noise * 1e-3)
        if np.array_equal(beyond, rejected):
            break
        rejected = beyond
    return rejected
