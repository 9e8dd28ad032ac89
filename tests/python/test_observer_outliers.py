"""Gates of observers reject outliers, and report them; steps of other durations; copies in the middle of a run."""

from __future__ import annotations

import pickle
import sys
import warnings
from pathlib import Path

import numpy as np
import phipsi
import pytest
from phipsi.errors import ArgumentError, DivergenceWarning
from phipsi.estimation import Encoder, Gyro, nees
from tolerances import assert_near, assert_same_bits

sys.path.insert(0, str(Path(__file__).parents[2] / "benches"))
import observers as bench
from truth import moved


def run_with_outliers(gate: float, share: float = 0.01, runs: int = 40, steps: int = 60) -> tuple[float, np.ndarray, np.ndarray]:
    """NEES/n of the arm with encoders of which a share of the readings is off by 0.05 rad; rejected and bad readings."""
    case, rng = bench.swift_case(False, 4e-3), np.random.default_rng(3)
    scene, noise = case.scene, 1e-4
    q0, qd0 = np.tile(case.q, (runs, 1)), np.tile(case.qd, (runs, 1))
    observer = scene.observer(case.dt, [Encoder(noise=noise, gate=gate)], q=q0, qd=qd0, torque_noise=case.torque_noise, initial=case.initial, history=0)
    e = case.initial * rng.normal(size=(runs, 12))
    q, qd = q0 + e[:, :6], qd0 + e[:, 6:]
    errors, rejected, bad = [], [], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for step in range(steps):
            tau = case.control(step * case.dt, q, qd)
            bad.append(rng.random((runs, 6)) < share)
            estimate = observer.step(tau, {"encoder": q + noise * rng.normal(size=q.shape) + 0.05 * bad[-1] * rng.choice([-1.0, 1.0], size=q.shape)})
            rejected.append(estimate.rejected["encoder"])
            errors.append(nees(np.concatenate([q - estimate.q, qd - estimate.qd], axis=-1), estimate.covariance) / 12)
            torque = tau + np.sqrt(case.torque_noise / case.dt) * rng.normal(size=q.shape)
            q, qd = moved(scene, q, qd, lambda q, qd, torque=torque: scene.forward_dynamics(q, qd, torque), case.dt)
    return float(np.mean(errors)), np.array(rejected), np.array(bad)


def test_a_gate_rejects_outliers() -> None:
    off, none, _ = run_with_outliers(1.0)
    assert off > 10.0 and not none.any()
    found, rejected, bad = run_with_outliers(0.9999)
    assert 0.9 <= found <= 1.1, found
    assert np.all(rejected[bad]) and np.mean(rejected[~bad]) < 1e-3
    clean, wrongly, _ = run_with_outliers(0.99, share=0.0)
    # Correct readings are rejected with the stated probability.
    count = wrongly.size
    assert abs(np.sum(wrongly) - 0.01 * count) <= 5.0 * np.sqrt(0.01 * count)
    assert 0.9 <= clean <= 1.15, clean


def test_a_rejected_reading_is_a_missing_one() -> None:
    """The estimate, its NIS and their numbers are those without the reading."""
    scene = phipsi.scenes.chain(3)
    tip = scene.link_names[-1]
    sensors = [Encoder(noise=1e-3, gate=0.999), Gyro(link=tip, noise=1e-2, gate=0.999), Gyro(name="second", link=tip, noise=1e-2)]
    one, other = (scene.observer(1e-2, sensors, q=np.zeros(3), torque_noise=0.1) for _ in range(2))
    for step in range(6):
        encoder, gyro = np.full(3, 1e-3 * step), np.zeros(3)
        wrong, missing = encoder.copy(), encoder.copy()
        if step == 3:
            wrong[1], missing[1] = 2.0, np.nan
        found = one.step(np.zeros(3), {"encoder": wrong, "gyro": gyro + (1e6 if step == 4 else 0.0), "second": gyro})
        expected = other.step(np.zeros(3), {"encoder": missing, "gyro": None if step == 4 else gyro, "second": gyro})
        assert list(found.rejected["encoder"]) == [False, step == 3, False] and np.all(found.rejected["gyro"] == (step == 4))
        assert not found.rejected["second"].any() and found.nis_size == expected.nis_size
        assert_near(found.nis, expected.nis, 1e-12 * float(expected.nis))
        for name in ("q", "qd", "covariance"):
            assert_near(getattr(found, name), getattr(expected, name), 1e-14)


def test_a_gate_that_rejects_most_readings_is_reported() -> None:
    scene = phipsi.scenes.chain(2)
    observer = scene.observer(1e-3, [Encoder(noise=1e-4, gate=0.999)], q=np.zeros((2, 2)), torque_noise=1e-6, initial=(1e-4, 1e-4), history=0)
    with pytest.warns(DivergenceWarning, match=r"sensor 'encoder' of robot \(1,\): its gate rejected 200 of 200 readings") as caught:
        for _ in range(100):
            observer.step(scene.gravity_torque(np.zeros(2)), {"encoder": [[0.0, 0.0], [1.0, 1.0]]})
    assert caught[0].message.sensor == "encoder" and caught[0].message.state == (1,)


@pytest.mark.parametrize("gate", [0.0, -0.1, 1.1, np.nan, [0.9, 0.9]])
def test_gates_are_probabilities(gate: object) -> None:
    with pytest.raises(ArgumentError, match="gate of 'encoder': found .*; expected a probability above 0 and at most 1"):
        phipsi.scenes.chain(2).observer(1e-3, [Encoder(noise=1e-3, gate=gate)], q=np.zeros(2), torque_noise=0.1)


def test_a_step_of_another_duration_is_that_of_an_observer_with_this_step() -> None:
    scene = phipsi.scenes.chain(3)
    sensors = [Encoder(noise=1e-3), Gyro(link=scene.link_names[-1], noise=1e-2, bias=0.1, bias_walk=0.01)]
    given = {"q": np.full(3, 0.2), "torque_noise": 0.1}
    one, other = (scene.observer(dt, sensors, **given) for dt in (2e-3, 7e-3))
    for step in range(5):
        readings = {"encoder": np.full(3, 0.2 + 1e-3 * step), "gyro": np.zeros(3)}
        found, expected = one.step(np.ones(3), readings, dt=7e-3), other.step(np.ones(3), readings)
        assert_same_bits(found.covariance, expected.covariance)
        assert_same_bits(found.qd, expected.qd)
    for wrong in (0.0, -1e-3, np.nan, np.inf):
        with pytest.raises(ArgumentError, match="dt: found .*; expected a time in s"):
            one.step(np.ones(3), {}, dt=wrong)
    assert_same_bits(one.step(np.ones(3), {}, dt=7e-3).q, other.step(np.ones(3), {}).q)


def test_pickles_continue_with_the_same_bits() -> None:
    """In the middle of a run with gates, delays, missing readings and steps of different durations."""
    scene, random = phipsi.load(phipsi.BUNDLED_ARM), np.random.default_rng(1)
    sensors = [Encoder(noise=1e-3, gate=0.99), Gyro(link=scene.link_names[-1], noise=1e-2, delay=2)]
    observer = scene.observer(2e-3, sensors, q=np.full((2, 6), 0.4), torque_noise=0.1, history=20)
    steps = [(1e-3 * random.integers(1, 5), 0.4 + 2e-3 * random.normal(size=(2, 6)), 0.1 * random.normal(size=(2, 3))) for _ in range(24)]

    def advance(own: phipsi.estimation.Observer, part: list) -> list[np.ndarray]:
        found = []
        for dt, q, gyro in part:
            estimate = own.step(scene.gravity_torque(q), {"encoder": q, "gyro": gyro}, dt=dt)
            found += [estimate.q, estimate.qd, estimate.covariance, estimate.nis, estimate.rejected["encoder"]]
        smoothed = own.smooth()
        return [*found, smoothed.time, smoothed.q, smoothed.covariance]

    advance(observer, steps[:12])
    again = pickle.loads(pickle.dumps(observer))
    found, expected = advance(again, steps[12:]), advance(observer, steps[12:])
    assert any(one.dtype == bool and one.any() for one in found)
    for one, other in zip(found, expected, strict=True):
        assert_same_bits(one, other)
