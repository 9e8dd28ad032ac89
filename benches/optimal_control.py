"""Optimal control: times and minima beside Crocoddyl's, the loop of a controller, stiff weights, and the expected cost.

Usage: python benches/optimal_control.py [--markdown FILE]; `make optimal-control` installs Crocoddyl from PyPI. Needs example-robot-data (with Pinocchio).
"""

import argparse
import os
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import crocoddyl
import mpmath as mp
import numpy as np
import pinocchio as pin
import robots
from in_turns import write

import phipsi
from phipsi import control, estimation, tasks

TURNS, RUNS = 15, 10_000
#: Weights of both: efforts, and (position, velocity) of the way; those of the goal and of the last velocity.
EFFORT, WAY, GOAL, REST = 1e-3, (1e-2, 1e-1), 1e4, 1.0


@dataclass
class Problem:
    """One problem, for both."""

    name: str
    scene: phipsi.Scene
    model: Any
    q0: np.ndarray
    link: str
    target: np.ndarray
    steps: int
    dt: float
    free: int = 0
    feet: list[str] = field(default_factory=list)
    tau: np.ndarray | None = None


def deviation(weight: float) -> float:
    return float(1.0 / np.sqrt(weight))


def costs(problem: Problem) -> list[Any]:
    goal = tasks.Position(problem.link, problem.target, position=deviation(GOAL))
    way = control.State(problem.q0, 0.0, *(deviation(weight) for weight in WAY))
    return [control.Effort(deviation(EFFORT)), way, control.Terminal(goal), control.Terminal(control.State(velocity=deviation(REST)))]


def ours(problem: Problem, **given: Any) -> control.MotionPlan:
    start = {"tau": problem.tau, "limits": False, "effort": None, "tolerance": 1e-12, "iterations": 200}
    return problem.scene.optimize(problem.q0, dt=problem.dt, steps=problem.steps, costs=costs(problem), **(start | given))


def theirs(problem: Problem) -> Any:
    model = problem.model
    state = crocoddyl.StateMultibody(model)
    motors = crocoddyl.ActuationModelFloatingBase(state) if problem.free else crocoddyl.ActuationModelFull(state)
    x0, nv = np.concatenate([problem.q0, np.zeros(model.nv)]), model.nv

    def weighted(weights: list[float]) -> Any:
        activation = crocoddyl.ActivationModelWeightedQuad(np.repeat(weights, nv))
        return crocoddyl.CostModelResidual(state, activation, crocoddyl.ResidualModelState(state, x0, motors.nu))

    def node(is_end: bool) -> Any:
        cost = crocoddyl.CostModelSum(state, motors.nu)
        if is_end:
            frame = crocoddyl.ResidualModelFrameTranslation(state, model.getFrameId(problem.link), problem.target, motors.nu)
            cost.addCost("goal", crocoddyl.CostModelResidual(state, frame), GOAL)
            cost.addCost("rest", weighted([0.0, REST]), 1.0)
        else:
            cost.addCost("effort", crocoddyl.CostModelResidual(state, crocoddyl.ResidualModelControl(state, motors.nu)), EFFORT)
            cost.addCost("way", weighted(list(WAY)), 1.0)
        if not problem.feet:
            dynamics = crocoddyl.DifferentialActionModelFreeFwdDynamics(state, motors, cost)
        else:
            contacts = crocoddyl.ContactModelMultiple(state, motors.nu)
            for foot in problem.feet:
                point = problem.scene.placement(problem.q0, foot)[:3, 3]
                contacts.addContact(foot, crocoddyl.ContactModel3D(state, model.getFrameId(foot), point, pin.LOCAL_WORLD_ALIGNED, motors.nu, np.zeros(2)))
            dynamics = crocoddyl.DifferentialActionModelContactFwdDynamics(state, motors, contacts, cost, 0.0, True)
        return crocoddyl.IntegratedActionModelEuler(dynamics, 0.0 if is_end else problem.dt)

    shooting = crocoddyl.ShootingProblem(x0, [node(False) for _ in range(problem.steps)], node(True))
    solver = crocoddyl.SolverFDDP(shooting)
    solver.th_stop = 1e-12
    first = np.zeros(nv) if problem.tau is None else problem.tau
    efforts = [first[problem.free :].copy() for _ in range(problem.steps)]
    return solver, shooting.rollout(efforts), efforts


def row(problem: Problem) -> tuple[str, float]:
    plan = ours(problem)
    solver, states, efforts = theirs(problem)
    solver.solve(states, efforts, 200, True)
    optimizer, zero = plan._problem.optimizer, np.zeros(problem.scene.nv)
    first = np.ascontiguousarray(np.broadcast_to(zero if problem.tau is None else problem.tau, plan.tau.shape))
    cost, iterations = solver.cost, solver.iter
    count, times = max(1, min(plan.iterations, iterations, 5)), np.full(2, np.inf)
    for _ in range(TURNS):
        begin = time.perf_counter()
        optimizer.solve((problem.q0, zero), first, None, count)
        middle = time.perf_counter()
        solver.solve(states, efforts, count, True)
        times = np.minimum(times, [(middle - begin) / count, (time.perf_counter() - middle) / max(solver.iter, 1)])
    gap = plan.cost / cost - 1.0
    numbers = [f"{1e3 * times[0]:.2f}", f"{1e3 * times[1]:.2f}", f"{times[1] / times[0]:.1f}", str(plan.iterations), str(iterations), f"{plan.cost:.10g}", f"{gap:.1e}"]
    return f"| {problem.name} | " + " | ".join(numbers) + " |", times[1] / times[0]


def fixed(name: str, q0: np.ndarray, link: str, move: np.ndarray, steps: int) -> Problem:
    path = robots.ROBOTS / robots.FILES[name][0]
    scene = robots.load(robots.FILES[name][0]).with_properties(friction=0.0, damping=0.0)
    q0 = q0 if len(q0) else scene.neutral()
    return Problem(name, scene, pin.buildModelFromUrdf(str(path)), q0, link, scene.placement(q0, link)[:3, 3] + move, steps, 0.01, tau=scene.gravity_torque(q0))


def floating(name: str, link: str, move: np.ndarray, steps: int) -> Problem:
    path = robots.ROBOTS / robots.FILES[name][0]
    scene = robots.load(*robots.FILES[name]).with_properties(friction=0.0, damping=0.0).to_builder().build(floating_base=True, gravity=(0.0, 0.0, 0.0))
    model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    model.gravity = pin.Motion.Zero()
    target = scene.placement(scene.neutral(), link)[:3, 3] + move
    return Problem(f"{name}, floating, weightless", scene, model, scene.neutral(), link, target, steps, 0.01, free=6)


def standing(dt: float = 0.01, seconds: float = 0.5) -> Problem:
    """Solo12 on four fixed feet, which raises and moves its trunk."""
    feet = ["FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"]
    q0 = np.concatenate([[0, 0, 0.24, 0, 0, 0, 1], np.tile([0, 0.8, -1.6], 4)])
    free = robots.load(*robots.FILES["solo12"])
    # Rows in the axes of the world, as Crocoddyl's.
    builder = robots.load(robots.FILES["solo12"][0]).to_builder().link("world")
    builder = builder.joint("root_joint", "floating", "world", free.link_names[0])
    for foot in feet:
        builder = builder.connect(foot, "point", "world", foot, xyz=free.placement(q0, foot)[:3, 3], other_xyz=(0, 0, 0))
    scene = builder.build().with_properties(friction=0.0, damping=0.0)
    model = pin.buildModelFromUrdf(str(robots.ROBOTS / robots.FILES["solo12"][0]), pin.JointModelFreeFlyer())
    hold = free.gravity_torque(q0)
    rows = np.concatenate([free.jacobian(q0, foot, frame="local-world-aligned")[3:] for foot in feet])
    force = np.linalg.lstsq(rows[:, :6].T, hold[:6], rcond=None)[0]
    tau = hold - rows.T @ force
    tau[:6] = 0.0
    target = scene.placement(q0, "base_link")[:3, 3] + [0.03, 0.02, 0.05]
    return Problem(f"solo12 on four feet, {1e3 * dt:g} ms", scene, model, q0, "base_link", target, round(seconds / dt), dt, 6, feet, tau)


def arm(steps: int = 100) -> Problem:
    scene = phipsi.load(phipsi.BUNDLED_ARM).with_properties(friction=0.0, damping=0.0)
    model = pin.buildModelFromXML(phipsi.BUNDLED_ARM)
    model.armature = np.array(scene.armature)
    q0 = np.full(6, 0.1)
    return Problem("bundled arm", scene, model, q0, "link6", np.array([0.5, 0.1, 0.4]), steps, 0.01, tau=scene.gravity_torque(q0))


def loop_rate() -> str:
    """Loops of a controller of the arm with 20 knots, one iteration each, from Python."""
    problem = arm(20)
    plan = ours(problem)
    q, qd, times = problem.q0, np.zeros(6), []
    for _ in range(500):
        begin = time.perf_counter()
        plan = plan.resume(q, qd)
        tau = plan.policy(0, q, qd)
        times.append(time.perf_counter() - begin)
        qdd = problem.scene.forward_dynamics(q, qd, tau)
        qd = qd + problem.dt * qdd
        q = q + problem.dt * qd
    return f"{1e-3 / np.median(times):.1f} kHz in the median, {1e-3 / np.quantile(times, 0.99):.1f} kHz in 99 of 100"


def stiff_error(ratio: float) -> tuple[float, int]:
    """Largest relative error of the controls of a linear problem, against 60 digits, and the stages in array form."""
    builder, last = phipsi.SceneBuilder().link("base"), "base"
    for i, mass in enumerate([1.1, 0.9, 0.6]):
        builder = builder.link(f"l{i}", mass=mass).joint(f"j{i}", "prismatic", last, f"l{i}", axis="x", stiffness=5.0, damping=1.0)
        last = f"l{i}"
    scene, steps, dt, end = builder.build(), 12, 0.05, float(1.0 / np.sqrt(ratio))
    x0, goal = np.array([0.3, -0.2, 0.1, 0.0, 0.1, 0.0]), np.array([1.0, 2.0, 3.0])
    terms = [control.Effort(1.0), control.State(goal, 0.0, 1.0, 1.0), control.Terminal(control.State(goal, 0.0, end, end))]
    plan = scene.optimize(x0[:3], x0[3:], dt=dt, steps=steps, costs=terms, limits=False, effort=None, tolerance=1e-14)
    a, b = (of.tolist() for of in plan._problem.optimizer.linearization()[0][:2])
    with mp.workdps(60):
        # The recursion itself with 60 digits, then the controls.
        weights = [mp.mpf(dt)] * 6
        value, slope = mp.diag([mp.mpf(ratio)] * 6), -mp.mpf(ratio) * mp.matrix([*goal, 0, 0, 0])
        laws = []
        for k in reversed(range(steps)):
            step, gain = mp.matrix(a[k]), mp.matrix(b[k])
            inner = gain.T * value * gain + mp.mpf(dt) * mp.eye(3)
            inverse = inner**-1
            law, offset = inverse * (gain.T * value * step), inverse * (gain.T * slope)
            closed = step - gain * law
            slope = closed.T * slope - mp.diag(weights) * mp.matrix([*goal, 0, 0, 0])
            value = mp.diag(weights) + step.T * value * closed
            laws.append((law, offset, step, gain))
        state, exact = mp.matrix(x0.tolist()), []
        for law, offset, step, gain in reversed(laws):
            effort = -law * state - offset
            exact.append([float(of) for of in effort])
            state = step * state + gain * effort
    return float(abs(plan.tau - np.array(exact)).max() / abs(np.array(exact)).max()), plan.history[0].array_stages


def empirical() -> tuple[float, float, float]:
    """Mean cost of noisy runs over the stated one, its standard error, and the share of the noise in the cost."""
    problem = arm(50)
    scene, plan, rng = problem.scene, ours(problem), np.random.default_rng(0)
    bodies, density = len(scene.body_names), 0.2
    covariance = np.zeros((bodies, 10, 10))
    covariance[:, 0, 0] = (0.02 * scene.inertial_parameters[:, 0]) ** 2
    stated = plan.expected(estimation.MotionUncertainty(parameters=covariance, torque_noise=density, initial=np.full(12, 1e-6)))
    q = plan.q[0] + 1e-3 * rng.normal(size=(RUNS, 6))
    qd = 1e-3 * rng.normal(size=(RUNS, 6))
    models = np.repeat(np.array(scene.inertial_parameters)[None], RUNS, axis=0)
    models[:, :, 0] *= 1.0 + 0.02 * rng.normal(size=(RUNS, bodies))
    cost = np.zeros(RUNS)
    for k in range(len(plan.tau)):
        tau = plan.tau[k] - np.concatenate([q - plan.q[k], qd - plan.qd[k]], axis=1) @ plan.gains[k].T
        cost += 0.5 * plan.dt * (EFFORT * (tau**2).sum(1) + WAY[0] * ((q - problem.q0) ** 2).sum(1) + WAY[1] * (qd**2).sum(1))
        noisy = tau + np.sqrt(density / plan.dt) * rng.normal(size=(RUNS, 6))
        qd = qd + plan.dt * scene.forward_dynamics(q, qd, noisy, inertias=models)
        q = q + plan.dt * qd
    hand = scene.placement(q, problem.link)[:, :3, 3] - problem.target
    cost += 0.5 * (GOAL * (hand**2).sum(1) + REST * (qd**2).sum(1))
    return cost.mean() / stated.cost, cost.std() / np.sqrt(RUNS) / stated.cost, 1.0 - plan.cost / stated.cost


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--markdown", type=Path)
    arguments = parser.parse_args()
    phipsi.set_num_threads(1)
    lines = ["| problem | here, ms an iteration | Crocoddyl, ms | ratio | iterations | Crocoddyl's | cost | relative difference of the costs |", "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |"]
    each = [
        arm(),
        fixed("ur5", np.array([0, -1, 1, 0, 0.3, 0.0]), "tool0", np.array([0.1, 0.1, -0.1]), 100),
        floating("talos", "arm_left_7_link", np.array([0.1, 0.1, 0.0]), 50),
        *(standing(dt) for dt in (0.01, 0.005, 0.0025)),
    ]
    for problem in each:
        lines.append(row(problem)[0])
        print(lines[-1], flush=True)
    ratio, error, share = empirical()
    stiff = {weight: stiff_error(weight) for weight in (1.0, 1e6, 1e12)}
    lines += ["", "| | |", "| --- | --- |"]
    lines.append(f"| loop of model predictive control, bundled arm, 20 knots, from Python | {loop_rate()} |")
    for weight, (found, stages) in stiff.items():
        lines.append(f"| error of the controls, weight of the end {weight:g} times that of the way | {found:.1e} relative, {stages} of 12 stages in array form |")
    lines.append(f"| mean cost of {RUNS:,} noisy runs over the stated expected cost | {ratio:.4f}, standard error {error:.4f}; noise is {100 * share:.1f} % of the cost |")
    print("\n".join(lines))
    load = ", ".join(f"{of:.1f}" for of in os.getloadavg())
    how = [
        f"Written by `make optimal-control` (benches/optimal_control.py): time of one iteration of `Scene.optimize` and of Crocoddyl {crocoddyl.__version__} (SolverFDDP, wheel from PyPI, one thread) on the same problems, minima of {TURNS} interleaved timings; load of the machine during the last 1, 5 and 15 minutes: {load}.",
        "The costs are those of a hand or trunk that reaches a point and rests, with weights of efforts, positions and velocities on the way. Solo12 is fixed at four feet, whose accelerations are zero in the axes of the world.",
    ]
    write(arguments.markdown, "Optimal control, measured", how, lines, "contacts that open or slide, which `Scene.optimize` refuses, and Crocoddyl on several threads.")


if __name__ == "__main__":
    main()
