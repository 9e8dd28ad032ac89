"""Faults of logs: each is an error or a warning that names the argument, the joint and one fix, and a good log has none."""

from __future__ import annotations

import re
import warnings
from typing import Any

import numpy as np
import pytest
from logs import STEP, arm_of_three, fourier

import phipsi
from phipsi.errors import ArgumentError, LogWarning, NotFiniteError

Log = dict[str, Any]


def good(count: int = 2000) -> tuple[phipsi.Scene, Log]:
    scene, time = arm_of_three(), STEP * np.arange(count)
    q, qd, qdd = fourier(time)
    tau = scene.inverse_dynamics(q, qd, qdd) + scene.damping * qd + scene.friction * qd / np.sqrt(qd**2 + 0.01**2)
    return scene, {"q": q, "qd": qd, "qdd": qdd, "tau": tau + 0.05 * np.random.default_rng(0).standard_normal(tau.shape), "time": time, "noise": 0.05}


def test_a_good_log_has_no_warning() -> None:
    scene, log = good()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = scene.identify(**log)
    assert abs(found.clock_offset) < 0.3 * STEP


def repeated(log: Log) -> Log:
    time = log["time"].copy()
    time[100] = time[99]
    return log | {"time": time}


def gap(log: Log) -> Log:
    keep = np.r_[0:800, 1200:2000]
    return {name: one[keep] if isinstance(one, np.ndarray) else one for name, one in log.items()}


def late(log: Log, delay: float) -> Log:
    scene, _ = good(10)
    q, qd, qdd = fourier(log["time"] - delay)
    tau = scene.inverse_dynamics(q, qd, qdd) + scene.damping * qd + scene.friction * qd / np.sqrt(qd**2 + 0.01**2)
    return log | {"tau": tau + 0.05 * np.random.default_rng(0).standard_normal(tau.shape)}


FAULTS: dict[str, tuple[Any, str]] = {
    "repeated times": (repeated, "time: found 1 repeated times, the first 0.495 at row 100; np.unique"),
    "gap": (gap, r"time: found 1 gaps, the longest of 2 s after 3.995 s, with steps of 0.005 s elsewhere; add the parts one by one"),
    "velocities in degrees": (lambda log: log | {"qd": np.degrees(log["qd"])}, "qd: found a numerical derivative of q that is 0.017.* times qd at joint 'joint1': qd is probably in degrees and q in rad"),
    "positions in degrees": (lambda log: log | {"q": np.degrees(log["q"])}, "qd: found a numerical derivative of q that is 57.* times qd at joint 'joint1': q is probably in degrees and qd in rad"),
    "accelerations in degrees": (lambda log: log | {"qdd": np.degrees(log["qdd"])}, "qdd: found a numerical derivative of qd that is 0.017.* times qdd at joint 'joint1': qdd is probably in degrees"),
    "inches": (lambda log: log | {"qdd": 39.4 * log["qdd"]}, "qdd: found a numerical derivative of qd that is 0.025.* times qdd at joint 'joint1': their units are inconsistent"),
    "milliseconds": (lambda log: log | {"time": 1e3 * log["time"]}, "qd: found a numerical derivative of q that is 0.001 times qd at joint 'joint1': time is probably in ms"),
    "counts": (lambda log: log | {"q": np.round(log["q"] * 65536 / (2 * np.pi))}, "q: found whole numbers up to .* at joint 'joint1', probably encoder counts; expected rad: multiply by 2 pi / counts"),
    "currents": (lambda log: log | {"tau": 0.02 * log["tau"], "noise": 0.001}, "tau: found torques proportional to those of the model with the factors .*, probably motor currents; expected N m or N, with factors of about 1: multiply"),
    "late torques": (lambda log: late(log, 0.02), r"tau: found torques that lag q by (19|20|21)(\.\d+)? \+- 0\.\d+ ms: .* for q and tau: tau_delay=0.0\d+ corrects it"),
    "early torques": (lambda log: late(log, -0.013), r"tau: found torques that lead q by 1\d(\.\d+)? \+- 0\.\d+ ms: .*: tau_delay=-0.01\d* corrects it"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_reported(fault: str) -> None:
    scene, log = good()
    change, message = FAULTS[fault]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene.identify(**change(log))
    texts = [str(one.message) for one in caught if one.category is LogWarning]
    assert any(re.match(message, text) for text in texts), texts
    assert all(one.filename == __file__ for one in caught if one.category is LogWarning)


def test_degrees_within_limits_are_recognized_without_times() -> None:
    scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
    q, qd, qdd = np.random.default_rng(0).uniform(-1, 1, (3, 200, 6))
    tau = scene.inverse_dynamics(q, qd, qdd)
    with pytest.warns(LogWarning, match=r"q: found .* at joint 'joint\d', outside its limits of .* rad, but within them if q is in degrees; expected rad: np.deg2rad\(q\)"):
        scene.identify(np.degrees(q), qd, qdd, tau, noise=1.0)


def test_a_delay_that_is_given_is_taken_out() -> None:
    scene, log = good()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = scene.identify(**late(log, 0.02), tau_delay=0.02)
    assert abs(found.clock_offset) < 0.3 * STEP
    assert np.all(found.after < 0.06)


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        ({"time": -STEP * np.arange(2000)}, ArgumentError, "time: found -0.005 after -?0 at row 1; expected times that rise: sort all arrays by np.argsort"),
        ({"q": np.full((2000, 3), np.nan)}, NotFiniteError, "q"),
        ({"tau": np.full((2000, 3), np.nan)}, ArgumentError, "tau: found no measured torque: all are NaN"),
    ],
)
def test_a_fault_that_leaves_no_answer_is_an_error(change: Log, kind: type[Exception], message: str) -> None:
    scene, log = good()
    with pytest.raises(kind, match=message):
        scene.identify(**(log | change))
