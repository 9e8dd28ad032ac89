"""Momentum observers with noise of velocities, correlated torque noise, friction at rest, and noise from a log."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import phipsi
import pytest
import scipy.optimize
from phipsi.errors import ArgumentError, ShapeError
from phipsi.estimation import momentum_noise
from test_observers import slider
from tolerances import assert_near

sys.path.insert(0, str(Path(__file__).parents[2] / "benches"))
import momentum_observer as alarms


@pytest.mark.parametrize(("velocity", "time"), [(5e-3, 0.0), (5e-3, 0.05)])
def test_false_alarms_come_at_the_stated_rate(velocity: float, time: float) -> None:
    scene = alarms.bundled_arm().scene
    runs = [alarms.false_alarms(scene, 2.0, 20.0, 4e-3, 200, 100, seed, velocity=velocity, time=time) for seed in range(3)]
    count, expected = sum(one.count for one in runs), sum(one.count * one.stated / one.measured for one in runs)
    # The 95 % interval of the ratio overlaps with 0.9 to 1.1.
    low, high = ((count + by * 1.96 * np.sqrt(count)) / expected for by in (-1, 1))
    assert high >= 0.9 and low <= 1.1 and 0.85 <= count / expected <= 1.15, (low, high)


def test_velocity_noise_that_is_not_given_raises_false_alarms() -> None:
    found = alarms.false_alarms(alarms.bundled_arm().scene, 2.0, 20.0, 4e-3, 200, 100, 0, velocity=5e-3, given=False)
    assert found.measured > 4.0 * found.stated


def test_noise_of_zero_is_the_observer_of_white_torques() -> None:
    """The innovations of the filter without noise of velocities are the changes of momentum."""
    scene, random = phipsi.load(phipsi.BUNDLED_ARM), np.random.default_rng(2)
    plain, noisy = (scene.momentum_observer(1e-3, torque_noise=alarms.DENSITY, bandwidth=20.0, velocity_noise=v) for v in (0.0, 1e-12))
    q, qd, tau = np.full((3, 6), 0.4), 0.3 * random.normal(size=(3, 6)), random.normal(size=6)
    for _ in range(20):
        q, qd = q + 1e-3 * qd, qd + 1e-3 * random.normal(size=6)
        expected, _ = plain.step(q, qd, tau)
        noisy.step(q, qd, tau)
        assert_near(noisy.joint_torque, expected, 1e-12 * float(np.max(np.abs(expected), initial=1.0)))
    assert_near(noisy._tested, plain.joint_torque, 1e-9 * float(np.max(np.abs(plain.joint_torque))))
    assert_near(noisy._of_test, np.broadcast_to(np.diag(plain._variance), (3, 6, 6)), 1e-9 * float(np.max(plain._variance)))


@pytest.mark.parametrize("time", [0.0, 0.02, np.array([0.5, 0.0])])
def test_covariances_are_those_of_samples(time: float | np.ndarray) -> None:
    """Two sliders without gravity: the momentum is the integral of the torque noise, drawn at an eighth of the step."""
    scene, dt, robots, parts = slider(), 2e-3, 1000, 8
    times, density, spread = np.broadcast_to(time, 2), np.array([0.2, 0.1]), np.array([5e-3, 1e-2])
    observer = scene.momentum_observer(dt, torque_noise=density, bandwidth=30.0, velocity_noise=spread, correlation_time=time)
    random, inverse, h = np.random.default_rng(7), np.linalg.inv(scene.mass_matrix([0.0, 0.0])), dt / parts
    kept = np.array([np.exp(-h / one) if one else 0.0 for one in times])
    size = np.array([np.sqrt(s / (2.0 * one)) if one else np.sqrt(s / h) for s, one in zip(density, times, strict=True)])
    noise, momentum, tested = size * random.normal(size=(robots, 2)), np.zeros((robots, 2)), []
    for _ in range(100):
        found, _ = observer.step([0.0, 0.0], momentum @ inverse + spread * random.normal(size=(robots, 2)), [0.0, 0.0])
        tested.append(observer._tested)
        for _ in range(parts):
            after = kept * noise + size * np.sqrt(1.0 - kept**2) * random.normal(size=noise.shape)
            momentum, noise = momentum + h * np.where(times > 0.0, 0.5 * (noise + after), noise), after
    # Entries of the covariance of 1000 samples have relative errors of 4.5 %.
    for values, covariance in ((found, observer.covariance), (tested[-1], observer._of_test)):
        expected = np.broadcast_to(covariance, (robots, 2, 2))[0]
        scale = np.sqrt(np.diag(expected))
        assert_near(np.cov(values.T) / np.outer(scale, scale), expected / np.outer(scale, scale), 0.2)
    white = [np.linalg.solve(np.linalg.cholesky(observer._of_test[0]), values.T) for values in tested[-2:]]
    assert_near(white[1] @ white[0].T / robots, np.eye(2) / (1.0 + observer._gain), 0.2)


def test_a_constant_torque_is_found() -> None:
    """Both the estimate and the tested torque are the external torque, once the filters have settled."""
    scene, dt, push = slider(), 2e-3, np.array([3.0, -1.0])
    observer = scene.momentum_observer(dt, torque_noise=0.01, bandwidth=30.0, velocity_noise=1e-2, correlation_time=[0.05, 0.0])
    for step in range(800):
        _, alarm = observer.step([0.0, 0.0], np.linalg.solve(scene.mass_matrix([0.0, 0.0]), step * dt * push), [0.0, 0.0])
    assert alarm
    assert_near(observer.joint_torque, push, 1e-9)
    assert_near(observer._tested, push, 1e-9)


def test_a_load_is_weighed() -> None:
    arm = alarms.bundled_arm()
    observer = arm.scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=20.0, load=arm.load, velocity_noise=1e-3)
    held = arm.scene.with_payload(arm.load[0], 1.5, arm.load[1]).gravity_torque(arm.middle)
    for _ in range(1500):
        _, alarm = observer.step(arm.middle, np.zeros(6), held)
    assert alarm
    assert_near(observer.mass, 1.5, 1e-6)


def test_a_joint_that_friction_holds_raises_no_alarm() -> None:
    """Friction holds any torque up to its size; a torque beyond raises an alarm, and so does one of a joint that moves."""
    scene = phipsi.scenes.chain(3)
    q, held, rest = np.array([0.3, 0.2, 0.1]), scene.gravity_torque([0.3, 0.2, 0.1]), np.zeros(3)
    given = {"torque_noise": 0.01, "bandwidth": 20.0, "stiction": [2.0, 2.0, 0.0]}
    for more in ({}, {"velocity_noise": 1e-4}, {"correlation_time": 0.2}):
        observer = scene.momentum_observer(1e-3, **given, **more)
        for step in range(700):
            # The torque of the controller changes within friction.
            _, alarm = observer.step(q, rest, held + [1.9 * np.sin(0.01 * step), -1.9, 0.0])
            assert not alarm
        for _ in range(700):
            _, alarm = observer.step(q, rest, held + [20.0, 0.0, 0.0])
        assert alarm
    observer, without = (scene.momentum_observer(1e-3, **given | {"stiction": s}) for s in (given["stiction"], 0.0))
    for _ in range(500):
        observer.step(q, rest, held + [1.9, 0.0, 0.0]), without.step(q, rest, held + [1.9, 0.0, 0.0])
    assert without.alarm and not observer.alarm
    for _ in range(500):
        observer.step(q, [0.02, 0.0, 0.0], held + [1.9, 0.0, 0.0])
    assert observer.alarm


def test_friction_is_the_best_explanation() -> None:
    """Bounded least squares with a covariance that is not diagonal, against SciPy."""
    scene = phipsi.scenes.chain(3)
    sigma = np.zeros((3, 10, 10))
    sigma[:, 0, 0] = 0.01
    q, held = np.array([0.3, 0.2, 0.1]), scene.gravity_torque([0.3, 0.2, 0.1])
    observer = scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=20.0, parameters=sigma, stiction=[1.0, 0.5, 0.2])
    for _ in range(500):
        observer.step(q, np.zeros(3), held + [2.0, -1.0, 0.1])
    root = np.linalg.inv(np.linalg.cholesky(observer.covariance))
    limit = observer._friction
    best = scipy.optimize.lsq_linear(root, root @ observer.joint_torque, (-limit, limit), tol=1e-14)
    assert_near(np.sum((root @ observer._unexplained(observer.covariance)) ** 2), 2.0 * best.cost, 1e-6 * best.cost)


def test_robots_of_a_batch_restart_alone() -> None:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    for more in ({}, {"velocity_noise": 1e-3, "stiction": 0.1}, {"load": (scene.link_names[-1], (0.0, 0.0, 0.1))}):
        random = np.random.default_rng(3)
        both = scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=20.0, **more)
        one, other = (scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=20.0, **more) for _ in range(2))
        for step in range(30):
            q, qd, tau = 0.3 + 0.1 * random.normal(size=(2, 6)), random.normal(size=(2, 6)), random.normal(size=(2, 6))
            if step == 15:
                both.reset(1 if not more else [False, True])
                other.reset()
                assert_near(both.joint_torque[1], np.zeros(6), 0.0)
            found, alarm = both.step(q, qd, tau)
            for at, alone in enumerate((one, other)):
                own = alone.step(q[at], qd[at], tau[at])
                assert_near(found[at], own.joint_torque, 1e-11 * max(1.0, float(np.max(np.abs(found)))))
                assert alarm[at] == own.alarm
    with pytest.raises(ArgumentError, match=r"robots: found 2; expected an index or mask of the robots of step\(\), \(2,\)"):
        both.reset(2)


def test_noise_is_estimated_from_a_log() -> None:
    arm, dt, rows = alarms.bundled_arm(), 1e-3, 8000
    random, t = np.random.default_rng(1), 1e-3 * np.arange(rows)[:, None] + np.arange(6)
    q, qd, qdd = 0.3 * np.sin(2.0 * t), 0.6 * np.cos(2.0 * t), -1.2 * np.sin(2.0 * t)
    tau = arm.scene.inverse_dynamics(q, qd, qdd)
    tau[:-1] = 0.5 * (tau[:-1] + tau[1:])
    spread = np.array([5e-3, 4e-3, 6e-3, 5e-3, 1e-2, 2e-2])
    measured = qd + spread * random.normal(size=qd.shape)
    found = momentum_noise(arm.scene, dt, q, measured, tau + np.sqrt(alarms.DENSITY / dt) * random.normal(size=tau.shape))
    assert_near(found.velocity_noise / spread, np.ones(6), 0.05)
    assert_near(found.torque_noise / alarms.DENSITY, np.ones(6), 0.25)
    assert np.all(found.correlation_time < 5.0 * dt)
    kept, slow = np.exp(-dt / 0.05), [np.sqrt(alarms.DENSITY / 0.1) * random.normal(size=6)]
    for one in random.normal(size=(rows - 1, 6)):
        slow.append(kept * slow[-1] + np.sqrt(alarms.DENSITY / 0.1 * (1.0 - kept**2)) * one)
    found = momentum_noise(arm.scene, dt, q, measured, tau + np.array(slow))
    assert_near(found.velocity_noise / spread, np.ones(6), 0.05)
    assert_near(np.log(found.correlation_time / 0.05), np.zeros(6), 0.6)
    # The variance is better known than density and time.
    assert_near(found.torque_noise / found.correlation_time * 0.05 / alarms.DENSITY, np.ones(6), 0.35)


def test_logs_without_noise_are_refused() -> None:
    scene, still = phipsi.scenes.chain(2), np.zeros((200, 2))
    with pytest.raises(ArgumentError, match="tau: found torques that the model explains without noise"):
        momentum_noise(scene, 1e-3, still, still, scene.gravity_torque(still))
    with pytest.raises(ArgumentError, match="q: found 99 rows; expected at least 100"):
        momentum_noise(scene, 1e-3, still[:99], still[:99], still[:99])
    with pytest.raises(ShapeError, match=r"tau: found shape \(199, 2\)"):
        momentum_noise(scene, 1e-3, still, still, still[1:])


@pytest.mark.parametrize("name", ["velocity_noise", "correlation_time", "stiction", "rest_speed"])
def test_arguments(name: str) -> None:
    scene = phipsi.scenes.chain(2)
    for wrong in (-1.0, np.nan, np.inf):
        with pytest.raises(ArgumentError, match=f"{name}: found .*; expected finite numbers, zero or positive"):
            scene.momentum_observer(1e-3, torque_noise=1.0, bandwidth=1.0, **{name: wrong})
    with pytest.raises(ShapeError, match=rf"{name}: found shape \(3,\)"):
        scene.momentum_observer(1e-3, torque_noise=1.0, bandwidth=1.0, **{name: np.ones(3)})


def test_scenes_with_connections_have_white_torque_noise() -> None:
    import capabilities

    scene = capabilities.Case("loop", False).scene
    for name in ("velocity_noise", "correlation_time", "stiction"):
        with pytest.raises(ArgumentError, match=f"{name}: found .* for a scene with connections; expected zero"):
            scene.momentum_observer(1e-3, torque_noise=1.0, bandwidth=1.0, **{name: 0.1})
    with pytest.raises(ArgumentError, match="stiction: found .* with load"):
        arm = alarms.bundled_arm()
        arm.scene.momentum_observer(1e-3, torque_noise=1.0, bandwidth=1.0, load=arm.load, stiction=1.0)
