"""Error bars of variances and observers against what they state: docs/measured/uncertainty.md.

Usage: python benches/observers.py [--quick] [--seed N] [--only PART ...] [--markdown FILE]

Parts: variance (accuracy and cost), consistency (NIS and NEES), alarms (false alarms stated and measured), pickup (delay until a load is noticed), textbook (the filter against a
plain extended Kalman filter), filterpy (the same runs through its unscented filter; pip install filterpy). Everything is seeded; intervals are 95 % intervals of the count or of chi-square. Times depend on the machine: run on an idle one.
"""

import argparse
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import phipsi
from momentum_observer import DENSITY, of_alarms, of_pickup
from phipsi.estimation import Accelerometer, Contact, Encoder, ExternalWrench, Gyro, consistency_bounds, nees
from truth import SUBSTEPS, moved

#: Sets of runs, each with a seed of its own.
SEEDS = 3


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
    qd: np.ndarray | float = 0.0


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


def swift_case(imu: bool, dt: float) -> Case:
    """The bundled arm at about 14 rad/s^2, with encoders, or with an IMU on the tool too; without external wrenches."""
    case = arm_case(imu)
    scene, middle, size, rate, phase = case.scene, case.q, 0.55, 6.0, np.arange(6)

    def control(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        wave, slope = size * np.sin(rate * t + phase), size * rate * np.cos(rate * t + phase)
        return scene.inverse_dynamics(q, qd, -(rate**2) * wave + 100.0 * (middle + wave - q) + 20.0 * (slope - qd))

    start = middle + size * np.sin(phase)
    return case._replace(name=f"swift {case.name}", wrenches=[], q=start, qd=size * rate * np.cos(phase), dt=dt, control=control)


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


def processes(case: Case, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Factor of wrenches and biases over a time, and standard deviation of their growth, from their definition."""
    decay, walk = [], []
    for wrench in case.wrenches:
        time_ = wrench.correlation_time
        added = duration if np.isinf(time_) else -0.5 * time_ * np.expm1(-2.0 * duration / time_)
        decay += 6 * [np.exp(-duration / time_)]
        walk += list(np.sqrt(np.broadcast_to(wrench.density, 6) * added))
    for sensor in case.sensors:
        if sensor.biases is not None:
            decay += 3 * [1.0]
            walk += 3 * [sensor.biases[1] * np.sqrt(duration)]
    return np.array(decay), np.array(walk)


class Consistency(NamedTuple):
    """Results of runs with a known true state."""

    nis: float
    bounds: tuple[float, float]
    nees: float
    #: Standard error of `nees`, from the spread of the runs.
    nees_error: float
    nees_inside: float
    smoothed: float
    beyond_99: float
    correlation: float
    #: Root mean square of the joint accelerations, rad/s^2 and m/s^2.
    acceleration: float


def consistency(case: Case, runs: int, steps: int, seed: int, smooth: bool = True) -> Consistency:
    """NIS over all steps of all runs against its bounds, and NEES/n at each step over the runs."""
    rng = np.random.default_rng(seed)
    scene, nv, dt = case.scene, case.scene.nv, case.dt
    start = np.broadcast_to(case.q, (runs, scene.nq))
    observer = scene.observer(
        dt, case.sensors, q=start, qd=case.qd + np.zeros(nv), torque_noise=case.torque_noise, wrenches=case.wrenches, initial=case.initial, history=steps if smooth else 0
    )
    # The truth is drawn from the initial covariance of the filter.
    root = observer._prior.root
    e = np.einsum("...ij,...j->...i", root, rng.normal(size=root.shape[:-1]))
    q, qd, rest = scene.integrate(start, e[:, :nv]), case.qd + e[:, nv : 2 * nv], e[:, 2 * nv :]
    values, sizes, errors, truth, accelerations = [], [], [], [], []
    decay, walk = processes(case, dt / SUBSTEPS)
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
            accelerations.append(qdd)
            now = np.concatenate([estimate.q, estimate.qd, *estimate.wrenches.values(), *estimate.biases.values()], axis=-1)
            errors.append(nees(_error(case, now, q, qd, rest), estimate.covariance))
            truth.append((q, qd, rest))
            torque = tau + noise
            for _ in range(SUBSTEPS):
                wrenches = {wrench.link: rest[:, 6 * i : 6 * i + 6] for i, wrench in enumerate(case.wrenches)}
                q, qd = moved(scene, q, qd, lambda q, qd, torque=torque, w=wrenches: scene.forward_dynamics(q, qd, torque, wrenches=w), dt / SUBSTEPS, 1)
                rest = decay * rest + walk * rng.normal(size=rest.shape)
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
    centered = values_ - m
    correlation = float(np.mean(centered[1:] * centered[:-1]) / np.mean(centered**2))
    beyond = float(np.mean(values_ > consistency_bounds(m, 1, 0.98)[1]))
    inside = float(np.mean((of_steps > step_low) & (of_steps < step_high)))
    of_runs = np.array(errors).mean(axis=0) / n
    error = float(of_runs.std(ddof=1) / np.sqrt(runs))
    strength = float(np.sqrt(np.mean(np.square(accelerations))))
    return Consistency(float(values_.mean()) / m, (low / m, high / m), float(of_runs.mean()), error, inside, smoothed, beyond, correlation, strength)


def _error(case: Case, estimate: np.ndarray, q: np.ndarray, qd: np.ndarray, rest: np.ndarray) -> np.ndarray:
    nq, nv = case.scene.nq, case.scene.nv
    return np.concatenate([case.scene.difference(estimate[..., :nq], q), qd - estimate[..., nq : nq + nv], rest - estimate[..., nq + nv :]], axis=-1)


# Variances: accuracy and cost


def parameters_of(scene: phipsi.Scene, seed: int, rank: int) -> np.ndarray:
    """Covariances of the bodies' parameters, relative to the sizes that they have."""
    rng = np.random.default_rng(seed)
    size = np.array([0.1, 0.02, 0.02, 0.02, *(0.005 * np.ones(6))])
    root = rng.normal(size=(len(scene.body_names), 10, rank)) * size[:, None]
    return root @ root.transpose(0, 2, 1)


def accuracy(scene: phipsi.Scene, states: int, seed: int) -> float:
    """The largest error of the variances against dense algebra, relative to the largest variance and over the condition of M.

    Dense: J C J* with J = -M^-1 Y, Y the regressor by central differences of inverse dynamics, which is linear in the parameters: exact to rounding.
    """
    rng = np.random.default_rng(seed)
    q = scene.integrate(np.broadcast_to(scene.neutral(), (states, scene.nq)), rng.normal(size=(states, scene.nv)))
    qd, tau = rng.normal(size=(states, scene.nv)), 10.0 * rng.normal(size=(states, scene.nv))
    sigma, torque = parameters_of(scene, seed, 10), rng.uniform(0.0, 1.0, scene.nv)
    found = scene.forward_dynamics_variance(q, qd, tau, parameters=sigma, torque=torque)
    qdd = scene.forward_dynamics(q, qd, tau)
    zero = np.zeros(scene.nv)
    units = np.eye(10 * len(scene.body_names)).reshape(-1, 1, len(scene.body_names), 10)
    columns = np.moveaxis(scene.inverse_dynamics_jvp(q, qd, qdd, zero, zero, zero, dparameters=units), 0, -1)
    mass = scene.mass_matrix(q)
    inverse = np.linalg.inv(mass)
    blocks = columns.reshape(states, scene.nv, -1, 10)
    x = np.einsum("snbp,bpr,smbr->snm", blocks, sigma, blocks) + np.diag(torque)
    expected = np.einsum("sij,sjk,sik->si", inverse, x, inverse)
    off = np.max(np.abs(found - expected), axis=1) / np.max(expected, axis=1)
    return float(np.max(off / np.linalg.cond(mass)))


def seconds(work: Callable[[], object], repeats: int) -> float:
    """The shortest of some calls."""
    best = float("inf")
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - begin)
    return best


class Cost(NamedTuple):
    """Times of one state in a batch on one thread, us."""

    bodies: int
    forward: float
    rank_one: float
    full: float


def cost(scene: phipsi.Scene, states: int) -> Cost:
    rng = np.random.default_rng(0)
    q = scene.integrate(np.broadcast_to(scene.neutral(), (states, scene.nq)), rng.normal(size=(states, scene.nv)))
    qd, tau = rng.normal(size=(2, states, scene.nv))
    threads = phipsi.get_num_threads()
    phipsi.set_num_threads(1)
    try:
        plain = seconds(lambda: scene.forward_dynamics(q, qd, tau), 7)
        variances = [seconds(lambda sigma=parameters_of(scene, 1, rank): scene.forward_dynamics_variance(q, qd, tau, parameters=sigma, torque=0.1), 3) for rank in (1, 10)]
    finally:
        phipsi.set_num_threads(threads)
    return Cost(len(scene.body_names), *(1e6 * t / states for t in (plain, *variances)))


# A textbook filter on one problem


def textbook(seed: int = 3, steps: int = 300) -> tuple[float, float, float, float]:
    """A pendulum with an encoder: the largest difference to a textbook extended Kalman filter, of the estimate in its standard deviations and of these; microseconds a step of both.

    The textbook's is written out here, with a covariance and the gain P H* S^-1, as in filterpy.
    """
    rng = np.random.default_rng(seed)
    scene = phipsi.SceneBuilder().link("base").link("rod", 1.0, (0, 0, -0.5), np.diag([0.1, 0.1, 0.01])).joint("hinge", "revolute", "base", "rod", axis=(0, 1, 0)).build()
    inertia, weight = float(scene.mass_matrix([0.0])[0, 0]), 0.5 * 9.81
    dt, density, noise = 0.01, 0.05, 0.02
    observer = scene.observer(dt, [Encoder(noise=noise)], q=[0.5], torque_noise=density, initial=(0.1, 0.2), history=0)
    x, p = np.array([0.5, 0.0]), np.diag([0.01, 0.04])
    truth = x + np.array([0.1, 0.2]) * rng.normal(size=2)
    off_mean = off_deviation = ours = theirs = 0.0
    for step in range(steps):
        tau = np.sin(0.05 * step)
        z = truth[0] + noise * rng.normal()
        begin = time.perf_counter()
        estimate = observer.step([tau], {"encoder": [z]})
        ours += time.perf_counter() - begin
        begin = time.perf_counter()
        h = np.array([[1.0, 0.0]])
        s = h @ p @ h.T + noise**2
        gain = p @ h.T / s
        x, p = x + gain[:, 0] * (z - x[0]), (np.eye(2) - gain @ h) @ p
        at = x.copy(), p.copy()
        middle = x[0] + 0.5 * dt * x[1]
        slope, rate = -weight * np.cos(middle) / inertia, x[1] + dt * (tau - weight * np.sin(middle)) / inertia
        # dqd1 = dqd + dt A (dq + dt/2 dqd) + dt n/I, dq1 = dq + dt (dqd + dqd1)/2
        of_rate = np.array([dt * slope, 1.0 + 0.5 * dt**2 * slope])
        f = np.array([[1.0, 0.5 * dt] + 0.5 * dt * of_rate, of_rate])
        b = np.array([0.5 * dt, 1.0]) * dt / inertia
        x = np.array([x[0] + 0.5 * dt * (x[1] + rate), rate])
        p = f @ p @ f.T + np.outer(b, b) * density / dt
        theirs += time.perf_counter() - begin
        deviation = np.sqrt(np.diag(at[1]))
        off_mean = max(off_mean, float(np.max(np.abs(np.concatenate([estimate.q, estimate.qd]) - at[0]) / deviation)))
        off_deviation = max(off_deviation, float(np.max(np.abs(np.sqrt(np.diag(estimate.covariance)) / deviation - 1.0))))
        torque = tau + np.sqrt(density / dt) * rng.normal()
        q, qd = moved(scene, truth[:1], truth[1:], lambda q, qd, torque=torque: (torque - weight * np.sin(q)) / inertia, dt)
        truth = np.concatenate([q, qd])
    return off_mean, off_deviation, 1e6 * ours / steps, 1e6 * theirs / steps


class Fused(NamedTuple):
    """A filter on the runs of the arm with encoders."""

    #: Root mean squares of the errors of q, rad, and qd, rad/s, after the first tenth of a second.
    q: float
    qd: float
    nees: float
    nis: float
    #: Microseconds of processor time a step.
    time: float


def with_filterpy(runs: int, steps: int, seed: int, dt: float = 4e-3) -> tuple[Fused, Fused]:
    """The bundled arm with encoders under torque noise: the observer, and the unscented filter of filterpy with the same model, noise and start.

    filterpy has no derivatives of the robot, so that its unscented filter is the one that needs none. Its process noise is set before each step, from the mass matrix at the
    estimate.
    """
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    rng, case = np.random.default_rng(seed), arm_case(False)
    scene, nv, noise = case.scene, 6, 1e-4
    initial = np.repeat([1e-3, 1e-2], nv)
    found: list[list[np.ndarray]] = [[], []]
    times = [0.0, 0.0]
    for _ in range(runs):
        observer = scene.observer(dt, [Encoder(noise=noise)], q=case.q, torque_noise=DENSITY, initial=initial, history=0)

        def after(x: np.ndarray, h: float, tau: np.ndarray) -> np.ndarray:
            middle = x[nv:] + 0.5 * h * scene.forward_dynamics(x[:nv], x[nv:], tau)
            qd = x[nv:] + h * scene.forward_dynamics(x[:nv] + 0.5 * h * x[nv:], middle, tau)
            return np.concatenate([x[:nv] + 0.5 * h * (x[nv:] + qd), qd])

        points = MerweScaledSigmaPoints(2 * nv, alpha=0.1, beta=2.0, kappa=0.0)
        theirs = UnscentedKalmanFilter(2 * nv, nv, dt, hx=lambda x: x[:nv], fx=after, points=points)
        theirs.x, theirs.P, theirs.R = np.concatenate([case.q, np.zeros(nv)]), np.diag(initial**2), noise**2 * np.eye(nv)
        truth = theirs.x + initial * rng.normal(size=2 * nv)
        for step in range(steps):
            q, qd = truth[:nv], truth[nv:]
            z = q + noise * rng.normal(size=nv)
            tau = case.control(step * dt, q, qd)
            begin = time.process_time()
            estimate = observer.step(tau, {"encoder": z})
            times[0] += time.process_time() - begin
            begin = time.process_time()
            if step == 0:
                theirs.sigmas_f = points.sigma_points(theirs.x, theirs.P)
            theirs.update(z)
            at, covariance, nis = theirs.x.copy(), theirs.P.copy(), float(theirs.y @ np.linalg.solve(theirs.S, theirs.y))
            push = dt * scene.mass_matrix_inverse(theirs.x[:nv]) * np.sqrt(DENSITY / dt)
            push = np.concatenate([0.5 * dt * push, push])
            theirs.Q = push @ push.T
            theirs.predict(tau=tau)
            times[1] += time.process_time() - begin
            if step >= round(0.1 / dt):
                for one, x, p, value in ((found[0], np.concatenate([estimate.q, estimate.qd]), estimate.covariance, float(estimate.nis)), (found[1], at, covariance, nis)):
                    error = x - truth
                    one.append(np.array([np.mean(error[:nv] ** 2), np.mean(error[nv:] ** 2), float(nees(error, p)) / (2 * nv), value / nv]))
            torque = tau + np.sqrt(DENSITY / dt) * rng.normal(size=nv)
            truth = np.concatenate(moved(scene, q, qd, lambda q, qd, torque=torque: scene.forward_dynamics(q, qd, torque), dt))
    means = [np.mean(one, axis=0) for one in found]
    ours, others = (Fused(*np.sqrt(mean[:2]), *mean[2:], 1e6 * spent / (runs * steps)) for mean, spent in zip(means, times, strict=True))
    return ours, others


# The page


def of_variance(options: argparse.Namespace) -> list[str]:
    rows = [("bundled arm", phipsi.load(phipsi.BUNDLED_ARM)), ("floating base with legs", floating_scene()), ("chain of 7", phipsi.scenes.chain(7))]
    lines = ["## Variances of forward dynamics", "", "Error: the largest one against J C J* with dense matrices, relative to the largest variance and divided by the condition of M; asked for: 1e-12.", ""]
    lines += ["| scene | states | largest error over cond M |", "|---|---|---|"]
    lines += [f"| {name} | 200 | {accuracy(scene, 200, options.seed):.1e} |" for name, scene in rows]
    lines += ["", "Time of one state in a batch on one thread, us. Both run vectorized over states. Asked for: at most 6 times forward dynamics, and linear to 10,000 bodies.", ""]
    lines += ["| scene | bodies | forward dynamics | variances, rank one | full | full over forward dynamics | full per body |", "|---|---|---|---|---|---|---|"]
    lengths = (100, 1000) if options.quick else (100, 1000, 10_000)
    for name, scene in [*rows, *((f"chain of {n}", phipsi.scenes.chain(n)) for n in lengths)]:
        found = cost(scene, max(64, 20_000 // max(1, scene.nv)))
        lines.append(
            f"| {name} | {found.bodies} | {found.forward:.2f} | {found.rank_one:.1f} | {found.full:.1f} | {found.full / found.forward:.1f} | {found.full / found.bodies:.2f} |"
        )
    return lines


def of_consistency(options: argparse.Namespace) -> list[str]:
    runs, steps = (50, 50) if options.quick else (100, 250)
    lines = [
        "## Consistency of the Kalman filter",
        "",
        f"{runs} runs of {steps} steps. The truth moves by the classical method of order 4 at a quarter of the filter's step; torque noise is constant over a step of the filter. NIS/m: mean over all steps of all runs over the number of readings, and its 95 % interval. NEES/n: mean, and the share of steps whose mean"
        " over the runs is within its 95 % interval (steps of one run are correlated). Beyond: the share of NIS beyond their 99 % point.",
        "",
        "| scene | step, ms | rms of accelerations | seed | NIS/m | 95 % interval | inside | NIS beyond 99 % | lag-one correlation of NIS | NEES/n | steps inside | smoother NEES/n |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    swift = [swift_case(False, dt) for dt in (2e-3, 4e-3, 1e-2)] + [swift_case(True, 4e-3)]
    for case in (arm_case(False), arm_case(True), floating_case(), *swift):
        values = []
        for seed in range(options.seed, options.seed + SEEDS):
            f = consistency(case, runs, steps, seed, smooth=seed == options.seed)
            values.append(f.nis)
            smoothed = f"{f.smoothed:.3f}" if seed == options.seed else ""
            cells = f"{100 * f.beyond_99:.2f} % | {f.correlation:.4f} | {f.nees:.3f} +- {f.nees_error:.3f} | {100 * f.nees_inside:.1f} % | {smoothed}"
            lines.append(f"| {case.name} | {1e3 * case.dt:g} | {f.acceleration:.1f} | {seed} | {_inside(f.nis, f.bounds)} | {cells} |")
        # The interval of the mean of independent sets is narrower by the root of their number.
        low, high = (1.0 + (bound - 1.0) / np.sqrt(SEEDS) for bound in f.bounds)
        lines.append(f"| {case.name} | {1e3 * case.dt:g} | | all | {_inside(float(np.mean(values)), (low, high))} | | | | | |")
    lines += ["", "A consistent filter misses one 95 % interval in twenty, for any seed. The table therefore has three sets of runs, and all of them combined."]
    return lines


def _inside(value: float, bounds: tuple[float, float]) -> str:
    return f"{value:.4f} | [{bounds[0]:.4f}, {bounds[1]:.4f}] | {'yes' if bounds[0] < value < bounds[1] else 'no'}"


def of_bands(options: argparse.Namespace) -> list[str]:
    from phipsi.estimation import MotionUncertainty

    scene = phipsi.load(phipsi.BUNDLED_ARM)
    q, steps = np.array([0.3, -0.6, 0.9, 0.1, 0.4, 0.0]), 200
    runs = {"dt": 2e-3, "steps": steps, "tau": scene.gravity_torque(q), "damping": 0.0, "friction": 0.0}
    lines = [
        "## Trajectories with bands",
        "",
        f"The bundled arm for {1e3 * steps * runs['dt']:.0f} ms under constant torques; relative errors of masses (with their first moments) as stated, one standard deviation. Ratio: variance of the runs over the first-order variance"
        " at the end, range over q and qd.",
        "",
        "| error of masses | way | runs | ratio, least | ratio, largest | processor time, s |",
        "|---|---|---|---|---|---|",
    ]
    samples = 200 if options.quick else 2000
    for relative in (0.01, 0.05, 0.2):
        columns = np.array([relative * scene.link(name).mass * np.array([1.0, *scene.link(name).com, 0, 0, 0, 0, 0, 0]) for name in scene.body_names])
        sigma = columns[:, :, None] * columns[:, None, :]
        for way in (None, "unscented", "monte-carlo"):
            unsure = MotionUncertainty(parameters=sigma, check=way, samples=samples, seed=options.seed)
            begin = time.process_time()
            path = scene.simulate(q, np.zeros(6), covariance=unsure, **runs)
            took = time.process_time() - begin
            ratio = np.ones(12) if way is None else path.bands.ratio[-1]
            count = {None: 1, "unscented": 12, "monte-carlo": samples}[way]
            lines.append(f"| {100 * relative:g} % | {way or 'first order'} | {count} | {ratio.min():.3f} | {ratio.max():.3f} | {took:.3f} |")
    lines += ["", f"The standard error of a ratio by Monte Carlo is about {np.sqrt(2.0 / samples):.3f}. The time of a checked run contains that of the first order. The default method is rk4 here."]
    return lines


def step_time(batch: tuple[int, ...], repeats: int = 100) -> float:
    """Microseconds a step of one arm with an IMU and a wrench, of a batch of that shape."""
    case = arm_case(True)
    q = np.broadcast_to(case.q, (*batch, 6))
    observer = case.scene.observer(case.dt, case.sensors, q=q, torque_noise=case.torque_noise, wrenches=case.wrenches, initial=case.initial, history=0)
    still = -case.scene.placement(case.q, case.scene.link_names[-1])[:3, :3].T @ case.scene.gravity
    readings, tau = {"encoder": case.q, "gyro": np.zeros(3), "accelerometer": still}, case.scene.gravity_torque(case.q)
    with warnings.catch_warnings():
        # A robot whose readings have no noise.
        warnings.simplefilter("ignore")
        observer.step(tau, readings)
        return 1e6 * seconds(lambda: observer.step(tau, readings), repeats) / max(1, int(np.prod(batch)))


def of_textbook(options: argparse.Namespace) -> list[str]:
    mean, deviation, ours, theirs = textbook(options.seed)
    one, many = step_time(()), step_time((100,), 10)
    return [
        "## Against a textbook filter",
        "",
        "A pendulum with an encoder, 300 steps, and an extended Kalman filter written out in NumPy with covariances and derivatives by hand.",
        "",
        f"Largest difference of the estimates: {mean:.1e} standard deviations; of the standard deviations: {deviation:.1e}, relative. A step takes {ours:.0f} us, {theirs:.0f} us in the textbook filter, which knows only this pendulum.",
        "",
        f"A step of the six-joint arm with an IMU and a wrench (24 states, 12 readings), from Python: {one:.0f} us alone, {many:.0f} us per robot in batches of 100. The aim is 20 us from Rust: `cargo bench --bench motion --features urdf,lanes observer`.",
    ]


def of_filterpy(options: argparse.Namespace) -> list[str]:
    try:
        import filterpy
    except ModuleNotFoundError:
        return ["## Compared with filterpy", "", "filterpy is not installed: pip install filterpy."]
    runs, steps = (2, 50) if options.quick else (20, 200)
    lines = [
        "## Compared with filterpy",
        "",
        f"The bundled arm with encoders (1e-4 rad), torque noise as above, {runs} runs of {steps} steps of 4 ms. The unscented Kalman filter of filterpy {filterpy.__version__} has the same model (one call of `forward_dynamics` per sigma"
        " point), the same noise and the same start. Both are called from Python, one robot at a time.",
        "",
        "| filter | error of q, rad | error of qd, rad/s | NEES/n | NIS/m | processor time of a step, us |",
        "|---|---|---|---|---|---|",
    ]
    for name, one in zip(("phipsi `observer`", "filterpy, unscented"), with_filterpy(runs, steps, options.seed), strict=True):
        lines.append(f"| {name} | {one.q:.3e} | {one.qd:.3e} | {one.nees:.3f} | {one.nis:.3f} | {one.time:.0f} |")
    return [*lines, "", "Errors are root mean squares after the first 0.1 s. A consistent filter has NEES/n and NIS/m of 1."]


PARTS = {"variance": of_variance, "bands": of_bands, "consistency": of_consistency, "alarms": of_alarms, "pickup": of_pickup, "textbook": of_textbook, "filterpy": of_filterpy}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer runs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="the page")
    options = parser.parse_args()
    lines = ["# Uncertainty: stated and measured", "", f"Written by `python benches/observers.py --seed {options.seed}`. Everything is seeded; times depend on the machine.", ""]
    for part in options.only:
        found = PARTS[part](options)
        print("\n".join(found), flush=True)
        lines += [*found, ""]
    if options.markdown is not None:
        options.markdown.parent.mkdir(parents=True, exist_ok=True)
        options.markdown.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
