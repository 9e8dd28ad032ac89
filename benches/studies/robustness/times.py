"""Time of the default: error against run time, simulations with error control, and steps compared with forward
dynamics.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import mujoco
import numpy as np

import phipsi
from in_turns import least
from robots import ROBOTS, load
from . import common
from .common import Array, Finding, Options, Section
from .peer import INTEGRATORS, Peer

CASES = {"panda": "panda_description/urdf/panda.urdf", "talos_reduced": "talos_data/robots/talos_reduced.urdf"}
STEPS = (5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4)
#: Duration, s, interval of the rows for errors, s, and gain of the PD law, N m/rad.
DURATION, ROW, GAIN = 0.3, 1e-2, 1e4
#: Errors for which the run time is interpolated.
ERRORS = (1e-3, 1e-5)
#: Other methods of phipsi in the table.
METHODS = ("rosenbrock-3", "rk4")
#: Tolerance of the references.
REFERENCE = 1e-11
TURNS, QUICK_TURNS = 9, 3


class Motion:
    """A robot without dry friction from a random moving state, passive or with a PD law whose target is the initial
    state.
    """

    def __init__(self, file: str, law: bool) -> None:
        self.scene = load(file).with_properties(friction=0.0)
        self.q, self.qd = common.random_poses(self.scene, 1)[0], np.random.default_rng(1).uniform(-1, 1, self.scene.nv)
        mass = np.diag(self.scene.mass_matrix(self.q))
        self.kp, self.kd = np.full(self.scene.nv, GAIN), 2 * np.sqrt(GAIN * mass)
        self.more: dict[str, Any] = {"pd": phipsi.PD(self.kp, self.kd, self.q)} if law else {}
        self.peer = Peer((ROBOTS / file).read_text(encoding="utf-8"), self.scene, constraints=False, actuators=law)
        self.peer.model.dof_frictionloss[:] = 0
        if law:
            self.peer.set_gains(self.kp, self.kd)
        rows = np.linspace(0, DURATION, round(DURATION / ROW) + 1)
        ode = self.scene.ode(**self.more)
        self.reference, check = (ode.solve(self.q, self.qd, (0, DURATION), method="Radau", rtol=k * REFERENCE, atol=k * REFERENCE, t_eval=rows).q for k in (1, 100))
        self.uncertainty = self.error(check)

    def error(self, q: Array) -> float:
        return float(np.max(common.distance(self.scene, self.reference, q)))

    def start_peer(self) -> None:
        self.peer.start(self.q, self.qd)
        if self.more:
            self.peer.set_target(self.kp, self.kd, self.q, np.zeros_like(self.qd))

    def acceleration_difference(self) -> float:
        """Relative difference of the initial accelerations between the programs, without law and damping: whether they
        have the same model.
        """
        ours = self.scene.forward_dynamics(self.q, self.qd, -self.scene.damping * self.qd - (self.kd * self.qd if self.more else 0.0))
        self.start_peer()
        mujoco.mj_forward(self.peer.model, self.peer.data)
        theirs = np.empty_like(ours)
        theirs[self.peer.v_here] = self.peer.data.qacc[self.peer.v_there]
        return float(np.max(np.abs(ours - theirs)) / np.max(np.abs(ours)))

    def ours(self, method: str, dt: float) -> tuple[float, Callable[[], object]]:
        """The error, infinite if the run fails, and a function that runs it for timing."""
        steps, more = round(DURATION / dt), self.more | common.NO_STOPS
        found = common.run(self.scene, self.q, self.qd, method, dt=dt, duration=DURATION, rows=round(DURATION / ROW), **more).trajectory
        error = np.inf if found is None else self.error(found.q)
        return error, lambda: self.scene.simulate(self.q, self.qd, dt=dt, steps=steps, record_every=steps, method=method, **more)

    def theirs(self, integrator: str, dt: float) -> tuple[float, Callable[[], object]]:
        """The same for MuJoCo."""
        steps = round(DURATION / dt)
        self.peer.integrate_with(integrator, dt)
        self.start_peer()
        found = self.peer.rows(steps, round(ROW / dt))

        def again() -> None:
            self.peer.integrate_with(integrator, dt)
            self.start_peer()
            mujoco.mj_step(self.peer.model, self.peer.data, nstep=steps)

        return (np.inf if found is None else self.error(found[0])), again


def at_error(points: list[tuple[float, float]], error: float) -> str:
    """Run time, ms, for an error, interpolated logarithmically; points are (error, ms) from coarse to fine."""
    for (coarse, short), (fine, long) in zip(points, points[1:], strict=False):
        if np.isfinite(coarse) and coarse > error >= fine:
            share = np.log(coarse / error) / np.log(coarse / fine)
            return f"{short * (long / short) ** share:.2g}"
    for fine, ms in points:
        if fine <= error:
            return f"at most {ms:.2g}"
    return "not reached"


def error_at(points: list[tuple[float, float]], ms: float) -> float | None:
    """Smallest error of the runs within a time; None if there is none."""
    return min((error for error, long in points if long <= ms), default=None)


def least_ratio(ours: list[tuple[float, float]], theirs: list[tuple[float, float]]) -> float:
    """Smallest ratio of their error to ours within the same time; infinite if all their runs fail, NaN if all ours
    fail.
    """
    if not any(np.isfinite(error) for error, _ in ours):
        return np.nan
    ratios = [error / own for error, ms in theirs if np.isfinite(error) and (own := error_at(ours, ms)) is not None]
    failed = not any(np.isfinite(error) for error, _ in theirs)
    return min(ratios, default=np.inf if failed else np.nan)


def error_against_time(options: Options) -> Section:
    """Error and time of phipsi and MuJoCo at the same steps, compared with an independent reference."""
    texts, findings = [], []
    steps = STEPS[1:4] if options.quick else STEPS
    for name, file in CASES.items():
        for law in (False, True):
            label = f"{name}, {f'PD with {GAIN:g} N m/rad' if law else 'passive'}"
            common.progress(f"error against time: {label}")
            motion = Motion(file, law)
            programs = {f"phipsi `{method}`": (motion.ours, method) for method in dict.fromkeys((options.method, *METHODS))}
            programs |= {f"MuJoCo {integrator}": (motion.theirs, integrator) for integrator in INTEGRATORS}
            points: dict[str, list[tuple[float, float]]] = {program: [] for program in programs}
            for dt in steps:
                found = {program: make(which, dt) for program, (make, which) in programs.items()}
                finite = [program for program in found if np.isfinite(found[program][0])]
                seconds = dict(zip(finite, least(QUICK_TURNS if options.quick else TURNS, *(found[program][1] for program in finite)), strict=True))
                for program, (error, _) in found.items():
                    points[program].append((error, 1e3 * seconds.get(program, np.nan)))
            rows = []
            for program, measured in points.items():
                cells = [f"{error:.0e}" if np.isfinite(error) else "failed" for error, _ in measured]
                per_step = 1e6 * measured[-1][1] * steps[-1] / DURATION
                rows.append([program, *cells, f"{per_step:.0f}" if np.isfinite(per_step) else "failed", *(at_error(measured, error) for error in ERRORS)])
            head = [label, *(f"{1e3 * dt:g} ms" for dt in steps), "ns per step", *(f"ms to {error:g}" for error in ERRORS)]
            texts.append(
                f"{common.table(head, rows)}\n\nThe reference has an uncertainty of {motion.uncertainty:.0e}; accelerations of the programs at the start differ by {motion.acceleration_difference():.0e}."
            )
            quantity = f"error of MuJoCo's Euler over that of the default in at most the same time, {label}"
            ratio = least_ratio(points[f"phipsi `{options.method}`"], points["MuJoCo Euler"])
            findings.append(Finding(quantity, "MuJoCo fails at all steps" if np.isinf(ratio) else f"{ratio:.3g} or more", "above 1", ratio > 1))
    text = (
        f"Dry friction, joint stops and contacts are off in both programs. Random pose and joint velocities, {DURATION:g} s. Errors: largest difference of positions in rows {1e3 * ROW:g} ms apart, rad or m, to SciPy's Radau through `scene.ode` at {REFERENCE:g}. "
        "Times: one state, a call for the whole run, one thread, the least of runs in turns; *ns per step* is at the smallest step, *ms to* is the run time at which an error is reached, interpolated between the steps.\n\n" + "\n\n".join(texts)
    )
    return Section("Error against time", text, findings)


def error_controlled(options: Options) -> Section:
    """Run time of `accuracy=` compared with SciPy through `scene.ode` at the same tolerance."""
    tolerance, first, duration = 1e-6, 1.0, 2.0 if options.quick else 10.0
    common.progress("error control")
    scene = load(CASES["panda"])
    q, qd, ode = common.random_poses(scene, 1)[0], np.zeros(scene.nv), scene.ode()
    quantity = f"error-controlled run of panda at {tolerance:g}, {duration:g} s: times faster than through SciPy"

    def solve(method: str, duration: float, tolerance: float = tolerance) -> phipsi.Trajectory:
        return ode.solve(q, qd, (0, duration), method=method, rtol=tolerance, atol=tolerance)

    own = "`simulate(accuracy=...)`"
    calls: dict[str, Callable[[float], phipsi.Trajectory]] = {f"`scene.ode`, {method}": partial(solve, method) for method in ("RK45", "DOP853", "Radau", "LSODA")}
    calls[own] = lambda duration: scene.simulate(q, qd, accuracy=tolerance, duration=duration, **common.NO_STOPS)
    reference = solve("DOP853", first, 1e-12).q[-1]
    rows, seconds = [], {}
    for name, call in calls.items():
        try:
            error, steps = common.distance(scene, reference, call(first).q[-1]), call(duration).steps
        except (TypeError, phipsi.errors.PhipsiError) as failure:
            rows.append([name, f"failed: {str(failure).splitlines()[0]}", "", ""])
            continue
        seconds[name] = least(QUICK_TURNS, partial(call, duration))[0]
        rows.append([name, f"{1e3 * seconds[name]:.3g}", str(steps), f"{error:.1e}"])
    text = (
        f"Passive from a random pose at rest, the damping of its file, no stops, absolute and relative tolerance {tolerance:g}. The motion is chaotic: errors, rad or m, compared with DOP853 at 1e-12, are those after "
        f"{first:g} s. Tolerances bound the error of a step, not that of the end, so that errors differ.\n\n"
        + common.table(["panda", f"ms for {duration:g} s", "steps", f"error after {first:g} s"], rows)
    )
    ours = seconds.pop(own, None)
    if ours is None:
        return Section("Error control", text, [Finding(quantity, "not measured", "10", None)])
    ratio = min(seconds.values()) / ours
    return Section("Error control", text, [Finding(quantity, f"{ratio:.3g} (the fastest of SciPy's methods)", "10", ratio >= 10)])


def cost(options: Options) -> Section:
    """Time of a step relative to one forward dynamics, in batches, where the overhead of the call from Python is
    negligible.
    """
    states, steps = 256, 20
    rows, findings = [], []
    for name, file, floating in (("ur5", "ur_description/urdf/ur5_robot.urdf", False), ("g1", "g1_description/urdf/g1_29dof_rev_1_0.urdf", True)):
        common.progress(f"cost: {name}")
        scene, random = load(file, floating), np.random.default_rng(0)
        q = scene.integrate(scene.neutral(), random.uniform(-0.2, 0.2, (states, scene.nv)))
        first = scene.nq - len(scene.limits.lower[6 if floating else 0 :])
        q[:, first:] = np.clip(q[:, first:], scene.limits.lower[-(scene.nq - first) :] + 1e-3, scene.limits.upper[-(scene.nq - first) :] - 1e-3)
        qd, tau, out = random.uniform(-0.1, 0.1, (states, scene.nv)), np.zeros((states, scene.nv)), np.empty((states, scene.nv))
        methods = list(dict.fromkeys((options.method, "semi-implicit-euler", "rk4", "rosenbrock-2")))

        def advance(method: str) -> Callable[[], object]:
            return lambda: scene.simulate(q, qd, tau=tau, dt=1e-4, steps=steps, record_every=steps, method=method)  # noqa: B023

        many: Callable[[], object] = lambda: [scene.forward_dynamics(q, qd, tau, out=out) for _ in range(steps)]  # noqa: B023, E731
        seconds = least(QUICK_TURNS if options.quick else TURNS, many, *(advance(method) for method in methods))
        dynamics, *times = (1e9 * second / steps / states for second in seconds)
        rows.append([name, f"{dynamics:.0f}", *(f"{own:.0f} ({own / dynamics:.2f})" for own in times)])
        findings.append(Finding(f"step of the default over one forward dynamics, {name}", f"{times[0] / dynamics:.2f}", "at most 3", times[0] <= 3 * dynamics))
    text = (
        f"Batches of {states} states on one thread from Python, ns per state, and in brackets the ratio to forward dynamics; passive, {steps} steps per call. g1 has a floating base.\n\n"
        + common.table(["", "forward dynamics", *(f"`{method}`" for method in methods)], rows)
    )
    return Section("Cost of a step", text, findings)
