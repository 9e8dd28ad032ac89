"""Observers: linearization by differences, filter and smoother against dense algebra, consistency over seeded runs, alarms at their stated rate, and bad arguments by name."""

from __future__ import annotations

import copy
import doctest
import importlib
import sys
import warnings
from pathlib import Path

import numpy as np
import phipsi
import pytest
import scipy.special
import scipy.stats
from conftest import random_rotation, random_scene
from phipsi.errors import ArgumentError, DivergenceWarning, NotFiniteError, ShapeError, SingularTaskError
from phipsi.estimation import (
    Accelerometer,
    Contact,
    Encoder,
    ExternalWrench,
    Gyro,
    Observer,
    TorqueSensor,
    alarm_threshold,
    consistency_bounds,
    mean_time_to_alarm,
    nees,
    nis,
)
from phipsi.estimation._chi_square import chi_square_cdf, chi_square_quantile
from phipsi.estimation._records import Record, State
from scipy.integrate import trapezoid
from tolerances import assert_near

sys.path.insert(0, str(Path(__file__).parents[2] / "benches"))
import momentum_observer as alarms
import observers as bench

STEP = 1e-4
#: Of differences of fourth order with that step, relative to the derivative's size: truncation is 1e-16, rounding 1e-11.
DIFFERENCES = 1e-9


def differences(function: object, size: int) -> np.ndarray:
    """The derivative of a function of a vector at zero, by central differences of fourth order."""
    columns = []
    for unit in np.eye(size):
        f = lambda t, unit=unit: function(t * unit)
        columns.append((8.0 * (f(STEP) - f(-STEP)) - (f(2.0 * STEP) - f(-2.0 * STEP))) / (12.0 * STEP))
    return np.stack(columns, axis=-1)


@pytest.fixture(scope="module")
def mixed() -> tuple[Observer, State, np.ndarray]:
    """An observer of a branching floating robot with joints of all kinds, and a state of it in motion."""
    random = np.random.default_rng(0)
    scene = random_scene(7, 8, floating_base=True, kinds=("revolute", "spherical", "planar", "screw", "universal", "prismatic", "continuous"))
    links = scene.link_names[-2:]
    turn = random_rotation(random)
    sensors = [
        Encoder(noise=1e-3),
        Gyro(link=links[0], noise=1e-3, bias=0.1, rotation=turn),
        Accelerometer(link=links[0], noise=1e-2, bias=0.1, xyz=(0.1, 0.2, 0.3), rotation=turn),
        Accelerometer(name="other", link=links[1], noise=1.0, xyz=(0.1, 0.2, 0.3)),
        TorqueSensor(noise=0.1),
        Contact(link=links[1], noise=0.1, xyz=(0.3, 0.2, 0.1)),
    ]
    q = scene.integrate(scene.neutral(), random.normal(size=scene.nv))
    wrenches = [ExternalWrench(links[0], density=1.0, correlation_time=0.5), ExternalWrench(links[1], density=1.0)]
    observer = scene.observer(0.01, sensors, q=q, qd=random.normal(size=scene.nv), torque_noise=0.1, wrenches=wrenches)
    prior = observer._prior
    return observer, prior._replace(rest=random.normal(size=prior.rest.shape)), 5.0 * random.normal(size=scene.nv)


def perturbed(observer: Observer, state: State, e: np.ndarray) -> State:
    nv, n = observer.scene.nv, state.root.shape[-1]
    return state._replace(q=observer.scene.integrate(state.q, e[:nv]), qd=state.qd + e[nv : 2 * nv], rest=state.rest + e[2 * nv : n])


def test_the_step_is_linearized_exactly(mixed: tuple[Observer, State, np.ndarray]) -> None:
    observer, state, tau = mixed
    scene, nv, n = observer.scene, observer.scene.nv, state.root.shape[-1]

    def after(e: np.ndarray) -> tuple[State, np.ndarray]:
        record = Record(tau, {})
        record.root = np.zeros((n + nv, n + nv))
        found = observer._predict(perturbed(observer, state, e[:n]), e[n:], record)
        return found, record.flow

    base, flow = after(np.zeros(n + nv))

    def away(e: np.ndarray) -> np.ndarray:
        found, _ = after(e)
        return np.concatenate([scene.difference(base.q, found.q), found.qd - base.qd, found.rest - base.rest])

    expected = differences(away, n + nv)
    assert_near(flow, expected, DIFFERENCES * float(np.max(np.abs(expected))))


@pytest.mark.parametrize("at", range(6))
def test_sensors_are_linearized_exactly(mixed: tuple[Observer, State, np.ndarray], at: int) -> None:
    observer, state, tau = mixed
    scene, nv, n = observer.scene, observer.scene.nv, state.root.shape[-1]
    sensor = observer.sensors[at]
    qdd, flow = observer._flow(state, tau)

    def reading(e: np.ndarray) -> np.ndarray:
        here = perturbed(observer, state, e[:n])
        found = sensor.predict(scene, observer._groups, (here.q, here.qd, observer._flow(here, tau + e[n:])[0]), tau)
        return found.value + (0.0 if found.by_noise is None else found.by_noise @ e[n:])

    found = sensor.predict(scene, observer._groups, (state.q, state.qd, qdd), tau)
    rows = np.zeros((len(found.value), n + nv))
    rows[:, :nv], rows[:, nv : 2 * nv] = found.by_q, found.by_qd
    if found.by_qdd is not None:
        rows += found.by_qdd @ flow
    if found.by_noise is not None:
        rows[:, n:] += found.by_noise
    expected = differences(reading, n + nv)
    assert_near(rows, expected, DIFFERENCES * max(1.0, float(np.max(np.abs(expected)))))


def test_an_accelerometer_reads_what_the_scene_says(mixed: tuple[Observer, State, np.ndarray]) -> None:
    observer, state, tau = mixed
    sensor, scene = observer.sensors[2], observer.scene
    qdd, _ = observer._flow(state, tau)
    found = sensor.predict(scene, observer._groups, (state.q, state.qd, qdd), tau).value
    point = scene.acceleration(state.q, state.qd, qdd, sensor.link, at=sensor.xyz, kind="classical")[3:]
    weight = scene.placement(state.q, sensor.link)[:3, :3].T @ scene.gravity
    assert_near(found, np.asarray(sensor.rotation).T @ (point - weight), 1e-11 * float(np.max(np.abs(found))))


def slider() -> phipsi.Scene:
    """Two sliders on each other along one axis, without gravity: exactly linear."""
    builder = phipsi.SceneBuilder().link("ground")
    for name, parent in (("first", "ground"), ("second", "first")):
        builder.link(name, 2.0, (0, 0, 0), np.eye(3))
        builder.joint(f"to_{name}", "prismatic", parent, name, axis=(1, 0, 0))
    return builder.build(gravity=(0.0, 0.0, 0.0))


def run_slider(delay: int, durations: np.ndarray) -> tuple[Observer, list, np.ndarray, np.ndarray]:
    """An observer of it through steps of these durations, its estimates, and mean and covariance of all states by dense least squares."""
    scene, steps, tau = slider(), len(durations), 0.7
    rng = np.random.default_rng(4)
    density = np.array([0, 0, 0, 0.5, 0, 0])
    wrench = ExternalWrench("second", density=density, correlation_time=tau, deviation=np.array([0, 0, 0, 1.0, 0, 0]))
    sensors = [Encoder(noise=0.02, joints=["to_first"], delay=delay), Accelerometer(link="second", noise=0.1, bias=0.3, bias_walk=0.05)]
    observer = scene.observer(0.05, sensors, q=[0.1, -0.2], torque_noise=[0.3, 0.2], wrenches=[wrench], initial=[0.2, 0.3, 0.4, 0.5])
    n, nv = 2 + 2 + 6 + 3, 2
    inverse = np.linalg.inv(scene.mass_matrix([0.0, 0.0]))
    by_force = inverse @ np.array([1.0, 1.0])
    start = np.zeros((nv, n + nv))
    start[:, 7], start[:, n:] = by_force, inverse
    accelerate = np.zeros((3, n + nv))
    accelerate[0] = start.sum(axis=0)
    accelerate[:, 10:13] += np.eye(3)
    encode = np.zeros((1, n + nv))
    encode[0, 0] = 1.0
    # Everything is linear in the independent numbers: the start, then of each step n, walk, the noise of readings, and the wrench within the step.
    per = nv + n + 4 + 1
    size = n + steps * per
    sigma = [np.array([0.2, 0.3, 0.4, 0.5, 0, 0, 0, 1, 0, 0, 0.3, 0.3, 0.3])]
    state = np.zeros((n, size))
    state[:, :n] = np.eye(n)
    states, readings, at = [], [], n
    for dt in durations:
        wide = np.zeros((n + nv, size))
        wide[:n] = state
        wide[n:, at : at + nv] = np.eye(nv)
        states.append(state)
        rows = np.concatenate([encode, accelerate]) @ wide
        rows[:, at + nv + n : at + per - 1] += np.eye(4)
        readings.append(rows)
        # x1 = F x + B n + G walk, with x = (q, qd, wrench, bias) and the mean of the wrenches at both ends.
        decay, a, growth, flow = np.exp(-dt / tau), start.copy(), np.eye(n), np.zeros((n, n + nv))
        a[:, 7] *= 0.5 * (1.0 + decay)
        growth[2:4, 7], growth[:2, 7] = 0.5 * dt * by_force, 0.25 * dt**2 * by_force
        flow[2:4] = dt * a
        flow[2:4, 2:4] += np.eye(2)
        flow[:2] = 0.5 * dt * flow[2:4]
        flow[:2, 2:4] += 0.5 * dt * np.eye(2)
        flow[:2, :2] += np.eye(2)
        flow[4:10, 4:10], flow[10:, 10:13] = decay * np.eye(6), np.eye(3)
        walk = np.concatenate([np.zeros(4), np.sqrt(0.5 * density * tau * -np.expm1(-2 * dt / tau)), 3 * [0.05 * np.sqrt(dt)]])
        # The mean of the wrench, given both ends, has a twelfth of the variance of its growth.
        within = np.zeros(n)
        within[2:4], within[:2] = dt / np.sqrt(12.0) * walk[7] * by_force, 0.5 * dt**2 / np.sqrt(12.0) * walk[7] * by_force
        state = flow @ wide
        state[:, at + nv : at + nv + n] += growth
        state[:, at + per - 1] += within
        sigma += [np.sqrt(np.array([0.3, 0.2]) / dt), walk, [0.02], 3 * [0.1], [1.0]]
        at += per
    sigma = np.concatenate(sigma)
    mean = np.concatenate([[0.1, -0.2], np.zeros(size - 2)])
    drawn = mean + sigma * rng.normal(size=size)
    taken = [rows @ drawn for rows in readings]
    # A few readings are missing, some in part.
    taken[7][0], taken[9][1:], taken[20][2] = np.nan, np.nan, np.nan
    estimates = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for k, dt in enumerate(durations):
            given = {"accelerometer": taken[k][1:]}
            if k >= delay:
                given["encoder"] = taken[k - delay][:1]
            estimates.append(observer.step([0.0, 0.0], given, dt=None if dt == 0.05 else dt))
    rows, values = np.concatenate(readings), np.concatenate(taken)
    arrived = np.ones(len(values), bool)
    arrived[[4 * k for k in range(steps - delay, steps)]] = False
    kept = arrived & ~np.isnan(values)
    rows, values = rows[kept], values[kept]
    p = np.diag(sigma**2)
    gain = np.linalg.solve(rows @ p @ rows.T, rows @ p).T
    posterior_mean, posterior = mean + gain @ (values - rows @ mean), p - gain @ rows @ p
    means = np.stack([s @ posterior_mean for s in states])
    covariances = np.stack([s @ posterior @ s.T for s in states])
    return observer, estimates, means, covariances


@pytest.mark.parametrize(("delay", "varied"), [(0, False), (3, False), (0, True), (3, True)])
def test_filter_and_smoother_of_a_linear_system_are_its_posterior(delay: int, varied: bool) -> None:
    durations = np.random.default_rng(5).choice([0.02, 0.05, 0.11], size=40) if varied else np.full(40, 0.05)
    observer, estimates, means, covariances = run_slider(delay, durations)
    smoothed = observer.smooth()
    assert_near(smoothed.time, np.concatenate([[0.0], np.cumsum(durations)[:-1]]), 1e-14)
    found = np.concatenate([smoothed.q, smoothed.qd, smoothed.wrenches["second"], smoothed.biases["accelerometer"]], axis=-1)
    # The wrench has components without any variance, whose directions are exactly zero.
    assert_near(found, means, 1e-9 * float(np.max(np.abs(means))))
    assert_near(smoothed.covariance, covariances, 1e-9 * float(np.max(np.abs(covariances))))
    last = estimates[-1]
    assert_near(np.concatenate([last.q, last.qd]), means[-1][:4], 1e-9 * float(np.max(np.abs(means))))
    assert_near(last.covariance, covariances[-1], 1e-9 * float(np.max(np.abs(covariances))))


def test_missing_readings_of_a_batch_are_those_of_each() -> None:
    scene = phipsi.scenes.chain(2)
    given = {"torque_noise": 0.1, "initial": (0.1, 0.1)}
    both = scene.observer(0.01, [Encoder(noise=1e-3)], q=np.zeros((2, 2)), **given)
    each = [scene.observer(0.01, [Encoder(noise=1e-3)], q=np.zeros(2), **given) for _ in range(2)]
    for k in range(5):
        reading = np.array([[0.01, 0.02], [0.01, np.nan if k % 2 else 0.03]])
        whole = both.step(np.zeros(2), {"encoder": reading})
        for at in range(2):
            own = each[at].step(np.zeros(2), {"encoder": reading[at]})
            assert_near(whole.q[at], own.q, 1e-14)
            assert_near(whole.covariance[at], own.covariance, 1e-14)
            assert whole.nis_size[at] == own.nis_size == (1 if k % 2 and at else 2)


def test_a_copy_of_an_observer_is_independent() -> None:
    scene = phipsi.scenes.chain(2)
    observer = scene.observer(0.01, [Encoder(noise=1e-3)], q=np.zeros(2), torque_noise=0.1)
    observer.step(np.zeros(2), {"encoder": [0.01, 0.02]})
    other = copy.deepcopy(observer)
    found = [each.step(np.zeros(2), {"encoder": [0.02, 0.02]}) for each in (observer, other)]
    assert np.array_equal(found[0].covariance, found[1].covariance) and np.array_equal(found[0].q, found[1].q)
    assert len(other.smooth().time) == 2
    other.step(np.zeros(2), {})
    assert len(observer.smooth().time) == 2


@pytest.mark.parametrize("case", [bench.arm_case(False), bench.arm_case(True), bench.floating_case()], ids=lambda case: case.name)
def test_innovations_are_what_the_filter_states(case: bench.Case) -> None:
    """The truth moves by steps of order 4 at a quarter of the filter's step, and wrenches change within it."""
    found = bench.consistency(case, runs=30, steps=30, seed=2, smooth=False)
    low, high = found.bounds
    # Bounds of 95 %: twice as wide here, so that another rounding does not decide.
    assert 1.0 - 2.0 * (1.0 - low) <= found.nis <= 1.0 + 2.0 * (high - 1.0)
    assert 0.85 <= found.nees <= 1.15
    assert abs(found.correlation) <= 4.0 / np.sqrt(900)


@pytest.mark.parametrize(("imu", "dt", "steps"), [(False, 2e-3, 60), (False, 4e-3, 50), (False, 1e-2, 40), (True, 4e-3, 50)])
def test_errors_on_fast_motion_are_those_that_the_filter_states(imu: bool, dt: float, steps: int) -> None:
    """14 rad/s^2, truth by steps of order 4 at a quarter of dt: a step of order 1 has NEES/n of 6, 20, 131; 437 with an IMU."""
    found = bench.consistency(bench.swift_case(imu, dt), runs=60, steps=steps, seed=5, smooth=dt == 1e-2)
    assert 12.0 <= found.acceleration <= 18.0
    low, high = found.nees - 3.0 * found.nees_error, found.nees + 3.0 * found.nees_error
    assert low <= 1.0 <= high or 0.95 <= found.nees <= 1.05, found
    assert 0.9 <= found.nees <= 1.1, found
    assert not found.smoothed > 1.1, found
    assert 1.0 - 2.0 * (1.0 - found.bounds[0]) <= found.nis <= 1.0 + 2.0 * (found.bounds[1] - 1.0)


def test_an_accelerometer_without_the_noise_that_it_feels_is_inconsistent() -> None:
    # The pitfall of leaving D out: innovations are then far larger than stated, which the bound above would show.
    class Deaf(Accelerometer):
        def predict(self, *arguments: object) -> object:
            return super().predict(*arguments)._replace(by_noise=None)

    case = bench.arm_case(True)
    observer = case.scene.observer(case.dt, case.sensors, q=case.q, torque_noise=case.torque_noise, wrenches=case.wrenches)
    _, flow = observer._flow(observer._prior, case.control(0.0, case.q, np.zeros(6)))
    feels = observer.sensors[2].predict(case.scene, observer._groups, (case.q, np.zeros(6), np.zeros(6)), np.zeros(6)).by_qdd @ flow[:, -6:]
    assert float(np.max(np.linalg.norm(feels * observer._torque_deviation, axis=-1))) > 2.0 * float(np.max(case.sensors[2].noise))


def standing(wrong: str) -> str:
    """The sensor that is named where a robot stands and one of its sensors, or its torque, is not what was stated."""
    case = bench.arm_case(True)
    rng = np.random.default_rng(1)
    scene = case.scene
    sensors = [*case.sensors, Gyro(name="second gyro", link=scene.link_names[-1], noise=5e-3)]
    observer = scene.observer(case.dt, sensors, q=case.q, torque_noise=1e-3 * case.torque_noise, initial=case.initial)
    q, tool = case.q, scene.link_names[-1]
    held = scene.gravity_torque(q) + (np.array([0.0, 40.0, 0.0, 0.0, 0.0, 0.0]) if wrong == "torque" else 0.0)
    still = -scene.placement(q, tool)[:3, :3].T @ scene.gravity
    off = {"gyro": 0.0, "second gyro": 0.0, "encoder": 0.0} | {wrong: 1.0}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(100):
            reading = {
                "encoder": q + 1e-4 * rng.normal(size=6) * (1.0 + 20.0 * off["encoder"]),
                # In degrees where it is wrong.
                "gyro": 5e-3 * rng.normal(size=3) * (1.0 + 56.3 * off["gyro"]),
                "second gyro": 5e-3 * rng.normal(size=3) * (1.0 + 56.3 * off["second gyro"]),
                "accelerometer": still + 0.05 * rng.normal(size=3),
            }
            observer.step(held, reading)
    assert len(caught) == 1 and isinstance(caught[0].message, DivergenceWarning)
    if wrong == "torque":
        assert "no single sensor" in str(caught[0].message)
    return caught[0].message.sensor


@pytest.mark.parametrize("wrong", ["gyro", "second gyro", "encoder", "torque"])
def test_divergence_names_the_sensor(wrong: str) -> None:
    named = standing(wrong)
    assert wrong in (named, "torque")


# The momentum observer


def test_chi_square_is_scipys() -> None:
    for size in (1, 2, 3, 6, 60, 3600, 100_000):
        for probability in (1e-9, 0.025, 0.5, 0.975, 1.0 - 1e-9):
            expected = scipy.stats.chi2.ppf(probability, size)
            assert_near(chi_square_quantile(probability, size), expected, 1e-8 * expected)
        x = np.array([0.0, 0.3 * size, size, 1.2 * size])
        assert_near(chi_square_cdf(x, size), scipy.stats.chi2.cdf(x, size), 1e-9)


def test_time_to_an_alarm_is_the_integral() -> None:
    # One component: T = sqrt(pi/2)/K int_0^c e^(x^2/2) erf(x/sqrt 2) dx.
    x = np.linspace(0.0, 3.0, 200_001)
    expected = np.sqrt(np.pi / 2.0) / 20.0 * trapezoid(np.exp(x**2 / 2.0) * scipy.special.erf(x / np.sqrt(2.0)), x)
    assert_near(mean_time_to_alarm(3.0, 20.0, 1), expected, 1e-8 * expected)
    assert 6.0 < alarm_threshold(1.0, 10.0, 2e-3, 6) < 6.1


@pytest.mark.parametrize(("size", "bandwidth", "dt"), [(1, 20.0, 2e-3), (1, 20.0, 1e-2), (6, 20.0, 2e-3)])
def test_false_alarms_come_at_the_stated_rate(size: int, bandwidth: float, dt: float) -> None:
    found = alarms.false_alarms_of_residual(size, 0.1, bandwidth, dt, alarms=1500, robots=4000, seed=3)
    assert abs(found.measured / found.stated - 1.0) <= 0.1


def test_samples_taken_for_independent_would_be_off() -> None:
    # The pitfall: a threshold by chi-square for each sample.
    independent = np.sqrt(scipy.stats.chi2.isf(0.1 * 2e-3, 6))
    assert independent > alarm_threshold(360.0, 20.0, 2e-3, 6) + 0.2


@pytest.mark.parametrize("floating_base", [False, True])
def test_momentum_changes_by_what_acts(floating_base: bool) -> None:
    scene = random_scene(11, 6, kinds=("revolute", "spherical", "prismatic", "planar"), floating_base=floating_base, armature=0.1)
    rng = np.random.default_rng(5)
    external, tau = rng.normal(size=scene.nv), rng.normal(size=scene.nv)
    off = []
    for dt in (1e-3, 5e-4):
        q, qd = scene.integrate(scene.neutral(), rng.normal(size=scene.nv) * 0 + 0.3), np.full(scene.nv, 0.4)
        observer = scene.momentum_observer(dt, torque_noise=1.0, bandwidth=100.0)
        path = scene.simulate(q, qd, tau=tau + external, dt=dt, steps=round(0.2 / dt), method="rk4", limits="report")
        for k in range(len(path.t)):
            found, _ = observer.step(path.q[k], path.qd[k], tau)
        off.append(float(np.max(np.abs(found - external))))
    assert off[1] <= 0.01 and off[0] <= 0.01


def test_parameter_errors_raise_the_covariance() -> None:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    sigma = np.zeros((6, 10, 10))
    sigma[:, 0, 0] = 0.01
    q = np.full(6, 0.4)
    known = scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=10.0)
    unsure = scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=10.0, parameters=sigma)
    held = scene.gravity_torque(q)
    known.step(q, np.zeros(6), held), unsure.step(q, np.zeros(6), held)
    added = unsure.covariance - known.covariance
    assert_near(np.diag(added), scene.inverse_dynamics_variance(q, np.zeros(6), np.zeros(6), parameters=sigma), 1e-9 * float(np.max(added)))
    assert unsure.threshold == known.threshold


def test_the_wrench_of_a_push_is_found() -> None:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    observer = scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=20.0)
    q, tool = np.array([0.3, -0.6, 0.9, 0.1, 0.4, 0.0]), scene.link_names[-1]
    push = np.array([0.2, -0.1, 0.3, 5.0, -4.0, 3.0])
    held = scene.gravity_torque(q) - scene.jacobian(q, tool).T @ push
    for _ in range(1500):
        torque, alarm = observer.step(q, np.zeros(6), held)
    assert alarm
    assert_near(observer.wrench(tool), push, 1e-9)
    assert_near(torque, scene.jacobian(q, tool).T @ push, 1e-9)


def test_a_pickup_is_noticed() -> None:
    delay, threshold = alarms.pickup(alarms.bundled_arm(), 20.0, runs=20, seed=1)
    assert 5.5 < threshold < 6.5
    assert float(np.median(delay)) <= 0.06 and float(np.max(delay)) <= 1.0


def test_a_load_at_a_point_is_noticed_earlier() -> None:
    arm = alarms.bundled_arm()
    of_all, threshold_of_all = alarms.pickup(arm, 10.0, runs=60, seed=1)
    of_load, threshold = alarms.pickup(arm, 10.0, runs=60, seed=1, load=True)
    assert 4.5 < threshold < 5.0 < threshold_of_all
    for share, bound in ((0.5, 0.05), (0.9, 0.15)):
        assert np.quantile(of_load, share) <= min(bound, np.quantile(of_all, share))
    # No test that knows less than the torque itself is much faster.
    assert np.quantile(of_load, 0.5) >= 0.8 * np.quantile(alarms.shortest_delay(arm, 60, 1), 0.5)


def test_false_alarms_of_a_load_come_at_the_stated_rate() -> None:
    arm = alarms.bundled_arm()
    found = alarms.false_alarms(arm.scene, 2.0, 20.0, 4e-3, alarms=800, robots=200, seed=3, load=arm.load)
    # The standard error of 800 alarms is 4 %.
    assert abs(found.measured / found.stated - 1.0) <= 0.12


def test_the_mass_of_a_load_is_estimated() -> None:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    load, q = (scene.link_names[-1], (0.0, 0.02, 0.1)), np.array([0.3, -0.6, 0.9, 0.1, 0.4, 0.0])
    loaded = scene.with_payload(load[0], 1.5, load[1])
    observer = scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=20.0, load=load)
    held = loaded.gravity_torque(np.stack([q, q + 0.1]))
    for _ in range(1500):
        observer.step(np.stack([q, q + 0.1]), np.zeros(6), held)
    assert_near(observer.mass, [1.5, 1.5], 1e-9)
    weight = loaded.gravity_torque(q) - scene.gravity_torque(q)
    # Stationary variance K S / 2 of the torque along that of 1 kg, divided by that torque.
    expected = np.sqrt(20.0 * 0.01 / 2.0) / np.linalg.norm(weight / 1.5)
    assert_near(observer.mass_deviation[0], expected, 0.02 * expected)
    assert np.all(observer.alarm)


def test_a_load_that_causes_no_torque_has_no_mass() -> None:
    # A vertical axis through a robot at rest.
    scene = phipsi.SceneBuilder().link("base").link("table", 1.0, (0.3, 0, 0), np.eye(3)).joint("turn", "revolute", "base", "table", axis=(0, 0, 1)).build()
    observer = scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=20.0, load=("table", (0.3, 0.0, 0.0)))
    for _ in range(3):
        _, alarm = observer.step([0.0], [0.0], [0.0])
    assert np.isnan(observer.mass) and np.isposinf(observer.mass_deviation) and not alarm


def test_parameter_errors_raise_the_deviation_of_the_mass() -> None:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    sigma = np.zeros((6, 10, 10))
    sigma[-1, 0, 0] = 0.3**2  # at the origin of the link, as a load there
    q, load = np.full(6, 0.4), (scene.body_names[-1], (0.0, 0.0, 0.0))
    found = []
    for parameters in (None, sigma):
        observer = scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=10.0, parameters=parameters, load=load)
        observer.step(q, np.zeros(6), scene.gravity_torque(q))
        found.append(float(observer.mass_deviation))
    assert_near(found[1], np.hypot(found[0], 0.3), 1e-9)


def test_joints_that_follow_others_have_external_torques() -> None:
    builder = phipsi.SceneBuilder().link("base").link("arm", 1.0, (0, 0, 0.3), np.diag([0.1, 0.1, 0.01])).joint("shoulder", "revolute", "base", "arm", axis=(0, 1, 0))
    for at, name in enumerate(("left", "right")):
        builder.link(name, 0.5 + 0.2 * at, (0, 0.02, 0.1), np.diag([0.01, 0.01, 0.001]))
        follow = {"mimic": "to_left", "mimic_multiplier": -2.0} if at else {}
        builder.joint(f"to_{name}", "revolute" if at else "prismatic", "arm", name, xyz=(0, 0, 0.5), axis=(1, 0, 0), **follow)
    scene = builder.build(mimic="couple")
    external, tau, dt = np.array([0.7, -0.4]), np.array([0.2, 0.1]), 5e-4
    observer = scene.momentum_observer(dt, torque_noise=1.0, bandwidth=100.0)
    path = scene.simulate([0.3, 0.1], [0.4, 0.1], tau=tau + external, dt=dt, steps=400, method="rk4", limits="report")
    for k in range(len(path.t)):
        found, _ = observer.step(path.q[k], path.qd[k], tau)
    assert_near(found, external, 0.01)
    sigma = np.zeros((3, 10, 10))
    sigma[2, 0, 0] = 0.01
    uncertain = scene.momentum_observer(dt, torque_noise=1.0, bandwidth=100.0, parameters=sigma)
    uncertain.step(path.q[0], path.qd[0], tau)
    qdd = scene.forward_dynamics(path.q[0], path.qd[0], tau)
    moved = scene.regressor(path.q[0], path.qd[0], qdd)[:, 2, 0]
    assert_near(uncertain.covariance - observer.covariance, 0.01 * np.outer(moved, moved), 1e-12)


class TestArguments:
    scene = phipsi.scenes.chain(2)

    def observer(self, **changed: object) -> object:
        given = {"sensors": [Encoder(noise=1e-3)], "q": [0.0, 0.0], "torque_noise": 0.1} | changed
        return self.scene.observer(given.pop("dt", 1e-3), given.pop("sensors"), **given)

    def test_two_sensors_of_one_name(self) -> None:
        with pytest.raises(ArgumentError, match="sensors.*two sensors.*'encoder'"):
            self.observer(sensors=[Encoder(noise=1.0), Encoder(noise=1.0)])

    def test_noise_of_zero(self) -> None:
        with pytest.raises(ArgumentError, match="noise of 'encoder'.*positive"):
            self.observer(sensors=[Encoder(noise=0.0)])

    def test_an_unknown_link(self) -> None:
        with pytest.raises(ArgumentError, match="nowhere"):
            self.observer(sensors=[Gyro(link="nowhere", noise=1.0)])

    def test_an_unknown_reading(self) -> None:
        with pytest.raises(ArgumentError, match="readings.*'gyro'.*encoder"):
            self.observer().step([0.0, 0.0], {"gyro": [0.0] * 3})

    def test_a_reading_of_another_shape(self) -> None:
        with pytest.raises(ShapeError, match=r"readings\['encoder'\].*\(3,\).*\(\.\.\., 2\)"):
            self.observer().step([0.0, 0.0], {"encoder": [0.0] * 3})

    def test_an_infinite_reading(self) -> None:
        with pytest.raises(NotFiniteError, match="readings.*infinity"):
            self.observer().step([0.0, 0.0], {"encoder": [0.0, np.inf]})

    def test_a_contact_that_is_no_flag(self) -> None:
        with pytest.raises(ArgumentError, match="readings.*True"):
            self.observer(sensors=[Contact(link=self.scene.link_names[-1], noise=1.0)]).step([0.0, 0.0], {"contact": 0.3})

    def test_a_sensor_with_its_own_prediction(self) -> None:
        class Own(Encoder):
            def predict(self, *arguments: object) -> object:
                return super().predict(*arguments)

        with pytest.raises(ArgumentError, match=r"sensors.*Own.*predict\(\)"):
            self.observer(sensors=[Own(noise=1.0)])

    def test_a_negative_bias(self) -> None:
        with pytest.raises(ArgumentError, match="bias of 'gyro'.*zero or positive"):
            self.observer(sensors=[Gyro(link=self.scene.link_names[-1], noise=1.0, bias=-0.1)])

    def test_noise_of_two_axes(self) -> None:
        with pytest.raises(ShapeError, match=r"noise of 'encoder'.*\(1, 2\)"):
            self.observer(sensors=[Encoder(noise=[[1.0, 1.0]])])

    @pytest.mark.parametrize("delay", [10**11, 10_001, -1, 0.5, np.nan, np.inf, True, "1"])
    def test_delays(self, delay: object) -> None:
        with pytest.raises(ArgumentError, match="delay of 'encoder': found .*; expected (a whole number of steps, zero or more|at most 10000 steps)"):
            self.observer(sensors=[Encoder(noise=1.0, delay=delay)])

    @pytest.mark.parametrize("history", [-1, 0.5, np.nan, np.inf, 10**30, "1"])
    def test_histories(self, history: object) -> None:
        with pytest.raises(ArgumentError, match="history: found .*; expected a whole number of steps, zero or more"):
            self.observer(history=history)

    def test_a_negative_step(self) -> None:
        with pytest.raises(ArgumentError, match="dt"):
            self.observer(dt=-1.0)
        with pytest.raises(ArgumentError, match="dt"):
            self.scene.momentum_observer(-1.0, torque_noise=1.0, bandwidth=1.0)

    def test_two_wrenches_on_a_link(self) -> None:
        with pytest.raises(ArgumentError, match="wrenches.*two"):
            self.observer(wrenches=[ExternalWrench(self.scene.link_names[-1], 1.0)] * 2)

    def test_smoothing_before_the_first_step(self) -> None:
        with pytest.raises(ArgumentError, match=r"history.*step\(\)"):
            self.observer().smooth()

    def test_a_torque_noise_of_zero(self) -> None:
        with pytest.raises(ArgumentError, match="torque_noise.*positive"):
            self.scene.momentum_observer(1e-3, torque_noise=[1.0, 0.0], bandwidth=1.0)

    def test_loads(self) -> None:
        for load in ("tip", ("tip",), ("tip", (0.0, 0.0)), ("tip", (0.0, 0.0, np.nan))):
            with pytest.raises(ArgumentError, match="load: .*expected a link and a point"):
                self.scene.momentum_observer(1e-3, torque_noise=1.0, bandwidth=1.0, load=load)
        with pytest.raises(ArgumentError, match="load: found link .* no joint moves"):
            self.scene.momentum_observer(1e-3, torque_noise=1.0, bandwidth=1.0, load=(self.scene.link_names[0], (0.0, 0.0, 0.0)))
        with pytest.raises(ArgumentError, match="nowhere"):
            self.scene.momentum_observer(1e-3, torque_noise=1.0, bandwidth=1.0, load=("nowhere", (0.0, 0.0, 0.0)))

    def test_alarms_as_often_as_the_observer_follows(self) -> None:
        with pytest.raises(ArgumentError, match="false_alarms_per_hour.*fewer"):
            self.scene.momentum_observer(1e-3, torque_noise=1.0, bandwidth=1.0, false_alarms_per_hour=1e5)

    def test_a_wrench_that_two_joints_do_not_determine(self) -> None:
        observer = self.scene.momentum_observer(1e-3, torque_noise=1.0, bandwidth=1.0)
        with pytest.raises(ArgumentError, match=r"step\(\)"):
            observer.wrench(self.scene.link_names[-1])
        observer.step([0.1, 0.2], [0.0, 0.0], [0.0, 0.0])
        with pytest.raises(SingularTaskError, match="joint_torque"):
            observer.wrench(self.scene.link_names[-1])

    def test_a_batch_that_changes(self) -> None:
        observer = self.scene.momentum_observer(1e-3, torque_noise=1.0, bandwidth=1.0)
        observer.step([0.1, 0.2], [0.0, 0.0], [0.0, 0.0])
        with pytest.raises(ShapeError, match=r"reset\(\)"):
            observer.step([[0.1, 0.2]], [0.0, 0.0], [0.0, 0.0])


@pytest.mark.parametrize("module", ["alarms", "consistency", "momentum", "motion", "noise", "observer", "sensors", "trajectories"])
def test_examples_of_the_docstrings_run(module: str) -> None:
    found = doctest.testmod(importlib.import_module(f"phipsi.estimation.{module}"))
    assert found.attempted > 0 and found.failed == 0


def test_nees_is_in_the_units_of_the_covariance() -> None:
    assert_near(nees([3e6, 1e-6], np.diag([1e12, 1e-12])), 10.0, 1e-12)
    assert_near(nis([2.0], [[4.0]]), 1.0, 1e-15)
    with pytest.raises(ArgumentError, match="covariance.*zero"):
        nees([0.0, 1.0], np.diag([0.0, 1.0]))
    with pytest.raises(ArgumentError, match="positive definite"):
        nees([0.0, 1.0], np.ones((2, 2)))
    low, high = consistency_bounds(3, 50)
    assert_near(low, scipy.stats.chi2.ppf(0.025, 150) / 50, 1e-7)
    assert_near(high, scipy.stats.chi2.ppf(0.975, 150) / 50, 1e-7)
    with pytest.raises(ArgumentError, match="level"):
        consistency_bounds(3, 50, 1.5)
