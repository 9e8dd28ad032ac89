"""Error bars of variances and observers against what they state: docs/measured/uncertainty.md.

Usage: python benches/observers.py [--quick] [--seed N] [--only PART ...] [--markdown FILE]

Parts: variance (accuracy and cost), consistency (NIS and NEES), alarms (false alarms stated and measured), pickup (delay until a load is noticed), textbook (the filter against a
plain extended Kalman filter). Everything is seeded; intervals are 95 % intervals of the count or of chi-square. Times depend on the machine: run on an idle one.
"""

import argparse
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import phipsi
from phipsi.estimation import Accelerometer, Contact, Encoder, ExternalWrench, Gyro, MomentumObserver, alarm_threshold, consistency_bounds, nees

#: Torque noise of an arm of the size of a UR5, (N m)^2 s.
DENSITY = np.array([2.0, 2.0, 1.0, 0.3, 0.3, 0.3]) ** 2 / 100.0


# Consistency


class Case(NamedTuple):
    """One scene with sensors, for runs whose truth is known."""

    name: str
    scene: phipsi.Scene
    sensors: list
    wrenches: list
    q: np.ndarray
    torque_noise: np.ndarray
    dt: float
    initial: np.ndarray
    #: Joint torques (runs, nv) at a time and state.
    control: Callable[[float, np.ndarray, np.ndarray], np.ndarray]


def arm_case(imu: bool) -> Case:
    """The bundled arm on a sine, with encoders and a wrench on the tool; with an IMU on the tool and an Ornstein-Uhlenbeck wrench."""
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    tool = scene.link_names[-1]
    middle = np.array([0.3, -0.6, 0.9, 0.1, 0.4, 0.0])
    sensors: list = [Encoder(noise=1e-4)]
    wrench = ExternalWrench(tool, density=np.array([1.0, 1.0, 1.0, 100.0, 100.0, 100.0]), deviation=np.array([0.1, 0.1, 0.1, 1.0, 1.0, 1.0]))
    if imu:
        sensors += [Gyro(link=tool, noise=5e-3, bias=0.02, bias_walk=1e-3), Accelerometer(link=tool, noise=0.05, xyz=(0.02, 0.0, 0.03), bias=0.1, bias_walk=5e-3)]
        wrench = ExternalWrench(tool, density=np.array([2.0, 2.0, 2.0, 200.0, 200.0, 200.0]), correlation_time=0.3)
    kp, kd = np.array([200.0, 200.0, 100.0, 20.0, 20.0, 5.0]), np.array([20.0, 20.0, 10.0, 2.0, 2.0, 0.5])

    def control(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        target = middle + 0.3 * np.sin(2.0 * t + np.arange(6))
        return scene.gravity_torque(q) + kp * (target - q) - kd * qd

    name = "arm with IMU" if imu else "arm"
    return Case(name, scene, sensors, [wrench], middle, DENSITY, 4e-3, np.repeat([1e-3, 1e-2], 6), control)


def floating_scene() -> phipsi.Scene:
    """A trunk that floats, with two legs of three joints."""
    builder = phipsi.SceneBuilder().link("world")
    builder.link("trunk", 8.0, (0, 0, 0.02), np.diag([0.10, 0.12, 0.08]))
    builder.joint("root", "floating", "world", "trunk")
    for side, y in (("left", 0.1), ("right", -0.1)):
        names = [f"{side}_hip", f"{side}_thigh", f"{side}_shank"]
        for name, mass, length in zip(names, (0.5, 1.0, 0.6), (0.02, 0.2, 0.2), strict=True):
            builder.link(name, mass, (0, 0, -0.5 * length), mass * np.diag([0.004, 0.004, 0.002]))
        builder.joint(f"{side}_abduction", "revolute", "trunk", names[0], xyz=(0, y, -0.05), axis=(1, 0, 0))
        builder.joint(f"{side}_swing", "revolute", names[0], names[1], xyz=(0, 0, -0.02), axis=(0, 1, 0))
        builder.joint(f"{side}_knee", "revolute", names[1], names[2], xyz=(0, 0, -0.2), axis=(0, 1, 0))
    return builder.build()


def floating_case() -> Case:
    """The floating robot held by a wrench on its trunk that wanders, with an IMU with biases and encoders."""
    scene = floating_scene()
    sensors = [
        Encoder(noise=2e-4),
        Gyro(link="trunk", noise=3e-3, bias=0.02, bias_walk=1e-3),
        Accelerometer(link="trunk", noise=0.05, xyz=(0.03, 0.0, 0.05), bias=0.1, bias_walk=5e-3),
    ]
    wrench = ExternalWrench("trunk", density=np.array([1.0, 1.0, 1.0, 100.0, 100.0, 100.0]), correlation_time=0.5)
    q = scene.neutral()
    legs = np.array([0.1, -0.4, 0.8, -0.1, -0.4, 0.8])
    q[7:] = legs
    noise = np.concatenate([np.zeros(6), np.full(6, 0.02)])

    def control(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        tau = np.zeros(qd.shape)
        target = legs + 0.2 * np.sin(3.0 * t + np.arange(6))
        tau[..., 6:] = 20.0 * (target - q[..., 7:]) - 1.0 * qd[..., 6:]
        return tau

    return Case("floating base with IMU", scene, sensors, [wrench], q, noise, 4e-3, np.repeat([0.01, 0.02], 12), control)


class Consistency(NamedTuple):
    """What runs with a known truth gave."""

    nis: float
    bounds: tuple[float, float]
    nees: float
    nees_inside: float
    smoothed: float
    beyond_99: float
    correlation: float


def consistency(case: Case, runs: int, steps: int, seed: int, smooth: bool = True) -> Consistency:
    """NIS over all steps of all runs against its bounds, and NEES/n at each step over the runs."""
    rng = np.random.default_rng(seed)
    scene, nv, dt = case.scene, case.scene.nv, case.dt
    start = np.broadcast_to(case.q, (runs, scene.nq))
    observer = scene.observer(
        dt, case.sensors, q=start, torque_noise=case.torque_noise, wrenches=case.wrenches, initial=case.initial, history=steps if smooth else 0
    )
    # The truth is drawn from what the filter is told.
    root = observer._prior.root
    e = np.einsum("...ij,...j->...i", root, rng.normal(size=root.shape[:-1]))
    q, qd, rest = scene.integrate(start, e[:, :nv]), e[:, nv : 2 * nv], e[:, 2 * nv :]
    values, sizes, errors, truth = [], [], [], []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for step in range(steps):
            tau = case.control(step * dt, q, qd)
            noise = np.sqrt(case.torque_noise / dt) * rng.normal(size=(runs, nv))
            wrenches = {wrench.link: rest[:, 6 * i : 6 * i + 6] for i, wrench in enumerate(case.wrenches)}
            qdd = scene.forward_dynamics(q, qd, tau + noise, wrenches=wrenches)
            readings, at = {}, 6 * len(case.wrenches)
            for sensor in case.sensors:
                if isinstance(sensor, Contact):
                    continue
                value = sensor.predict(scene, observer._groups, (q, qd, qdd), tau).value
                value = value + np.asarray(sensor.noise) * rng.normal(size=value.shape)
                if sensor.biases is not None:
                    value = value + rest[:, at : at + 3]
                    at += 3
                readings[sensor.name] = value
            estimate = observer.step(tau, readings)
            values.append(estimate.nis)
            sizes.append(estimate.nis_size)
            now = np.concatenate([estimate.q, estimate.qd, *estimate.wrenches.values(), *estimate.biases.values()], axis=-1)
            errors.append(nees(_error(case, now, q, qd, rest), estimate.covariance))
            truth.append((q, qd, rest))
            qd = qd + dt * qdd
            q = scene.integrate(q, dt * qd)
            rest = observer._decay * rest + observer._walk * rng.normal(size=rest.shape)
    values_, n = np.array(values), root.shape[-1]
    m = int(sizes[0][0])
    low, high = consistency_bounds(m, values_.size)
    of_steps = np.array(errors).mean(axis=1)
    step_low, step_high = consistency_bounds(n, runs)
    smoothed = float("nan")
    if smooth:
        found = observer.smooth()
        all_now = np.concatenate([found.q, found.qd, *found.wrenches.values(), *found.biases.values()], axis=-1)
        smoothed = float(np.mean([nees(_error(case, now, *true), p) for now, true, p in zip(all_now, truth, found.covariance, strict=True)])) / n
    centred = values_ - m
    correlation = float(np.mean(centred[1:] * centred[:-1]) / np.mean(centred**2))
    beyond = float(np.mean(values_ > consistency_bounds(m, 1, 0.98)[1]))
    inside = float(np.mean((of_steps > step_low) & (of_steps < step_high)))
    return Consistency(float(values_.mean()) / m, (low / m, high / m), float(of_steps.mean()) / n, inside, smoothed, beyond, correlation)


def _error(case: Case, estimate: np.ndarray, q: np.ndarray, qd: np.ndarray, rest: np.ndarray) -> np.ndarray:
    nq, nv = case.scene.nq, case.scene.nv
    return np.concatenate([case.scene.difference(estimate[..., :nq], q), qd - estimate[..., nq : nq + nv], rest - estimate[..., nq + nv :]], axis=-1)


# Alarms


class Alarms(NamedTuple):
    """False alarms of a momentum observer without contact."""

    stated: float
    measured: float
    count: int


def false_alarms(scene: phipsi.Scene, rate: float, bandwidth: float, dt: float, alarms: int, robots: int, seed: int) -> Alarms:
    """Alarms a second of robots that move under torque noise alone, each reset after an alarm."""
    rng = np.random.default_rng(seed)
    density = np.resize(DENSITY, scene.nv)
    observer = scene.momentum_observer(dt, torque_noise=density, bandwidth=bandwidth, false_alarms_per_hour=3600.0 * rate)
    middle = np.resize([0.3, -0.6, 0.9, 0.1, 0.4, 0.0], scene.nv)
    q, qd = np.broadcast_to(middle, (robots, scene.nv)).copy(), np.zeros((robots, scene.nv))
    count = steps = 0
    while count < alarms:
        tau = scene.gravity_torque(q) + 100.0 * (middle - q) - 20.0 * qd
        _, alarm = observer.step(q, qd, tau)
        count += int(np.sum(alarm))
        observer.joint_torque[np.asarray(alarm)] = 0.0
        steps += 1
        noise = np.sqrt(density / dt) * rng.normal(size=qd.shape)
        qd = qd + dt * scene.forward_dynamics(q, qd, tau + noise)
        q = q + dt * qd
    return Alarms(rate, count / (steps * dt * robots), count)


def false_alarms_of_residual(size: int, rate: float, bandwidth: float, dt: float, alarms: int, robots: int, seed: int) -> Alarms:
    """The same of the residual alone, whose recursion the robot does not enter: for long times."""
    rng = np.random.default_rng(seed)
    observer = phipsi.scenes.chain(size).momentum_observer(dt, torque_noise=1.0, bandwidth=bandwidth, false_alarms_per_hour=3600.0 * rate)
    gain, deviation = observer._gain, np.sqrt(observer._variance[0])
    r = np.zeros((robots, size))
    count = steps = 0
    while count < alarms:
        r = (r + gain / np.sqrt(dt) * rng.normal(size=r.shape)) / (1.0 + gain)
        alarm = np.sum(r**2, axis=-1) > (observer.threshold * deviation) ** 2
        count += int(alarm.sum())
        r[alarm] = 0.0
        steps += 1
    return Alarms(rate, count / (steps * dt * robots), count)


class Arm(NamedTuple):
    """An arm that picks something up."""

    scene: phipsi.Scene
    middle: np.ndarray
    link: str
    #: Where on the link the load's center of mass is, m.
    load: tuple[float, float, float]


def bundled_arm() -> Arm:
    scene = phipsi.load(phipsi.BUNDLED_ARM)
    return Arm(scene, np.array([0.3, -0.6, 0.9, 0.1, 0.4, 0.0]), scene.link_names[-1], (0.0, 0.0, 0.1))


def pickup(arm: Arm, bandwidth: float, runs: int, seed: int, mass: float = 1.0, dt: float = 2e-3) -> tuple[np.ndarray, float]:
    """Seconds until a moving arm notices that it holds a load, at one false alarm an hour, in each run (inf where it did not within 1 s), and the threshold."""
    rng = np.random.default_rng(seed)
    scene, middle = arm.scene, arm.middle
    loaded = scene.with_payload(arm.link, mass, arm.load)
    observer = scene.momentum_observer(dt, torque_noise=DENSITY, bandwidth=bandwidth, false_alarms_per_hour=1.0)
    phase = rng.uniform(0.0, 2.0 * np.pi, size=(runs, 6))
    kp, kd = np.array([200.0, 200.0, 100.0, 20.0, 20.0, 5.0]), np.array([20.0, 20.0, 10.0, 2.0, 2.0, 0.5])
    q, qd = middle + 0.3 * np.sin(phase), 0.6 * np.cos(phase)
    begin, delay = round(1.0 / dt), np.full(runs, np.inf)
    for step in range(round(2.0 / dt)):
        target, rate = middle + 0.3 * np.sin(2.0 * step * dt + phase), 0.6 * np.cos(2.0 * step * dt + phase)
        tau = scene.gravity_torque(q) + kp * (target - q) + kd * (rate - qd)
        _, alarm = observer.step(q, qd, tau)
        if step < begin:
            observer.joint_torque[np.asarray(alarm)] = 0.0
        else:
            delay = np.where(np.asarray(alarm) & np.isinf(delay), (step - begin) * dt, delay)
        robot = scene if step < begin else loaded
        noise = np.sqrt(DENSITY / dt) * rng.normal(size=qd.shape)
        qd = qd + dt * robot.forward_dynamics(q, qd, tau + noise)
        q = q + dt * qd
    return delay, observer.threshold
