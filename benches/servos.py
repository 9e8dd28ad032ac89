"""Steps of servos at their limits of effort compared with steps without limits, the step rate of the environments of
docs/how-to/gymnasium.md, and random servos at any gain, in one run.

Usage: python benches/servos.py [--runs N] [--markdown FILE]; `make servos`.

Servos: all joints of a robot go to targets that are far away, so that most motors are at a limit; the same law without
limits is the reference. Environments: 1,024 arms in one simulator, four steps of 5 ms per action. Random servos: chains
of 2 to 7 links with random gains from 1e2 to 1e6, time steps from 0.1 to 4 ms, limits of effort, and for every third
run motors whose torque declines with speed. A run fails if it raises, if a number is not finite, if a motor exceeds
its limit, or if the energy grows by more than the work that motors can do. Times are the minimum of several interleaved
timings on one thread.
"""

import argparse
import os
from pathlib import Path

import numpy as np
import phipsi
from in_turns import least, write
from robots import load

ROBOTS = {"UR5": ("ur_description/urdf/ur5_robot.urdf", False), "g1": ("g1_description/urdf/g1_29dof_rev_1_0.urdf", True)}
DT, STEPS, STATES, TURNS = 1e-3, 200, 64, 9


def robot(name: str) -> phipsi.Scene:
    path, floating = ROBOTS[name]
    return load(path, floating_base=floating)


def laws(scene: phipsi.Scene, states: int | None) -> tuple[np.ndarray, dict[str, phipsi.PD]]:
    """Configurations, and the same law with limits that most motors reach, with motors, and without."""
    random = np.random.default_rng(0)
    shape = (scene.nv,) if states is None else (states, scene.nv)
    at = random.uniform(-0.2, 0.2, shape)
    motor = np.ones(scene.nv)
    for joint in scene.joint_names:
        if scene.joint(joint).type == "floating":
            motor[scene.v_index(joint)] = 0.0
    q = scene.integrate(scene.neutral(), at * motor)
    target = scene.integrate(q, motor * random.uniform(0.5, 1.0, shape) * random.choice([-1.0, 1.0], shape))
    inertia = np.diagonal(scene.mass_matrix(scene.neutral()))
    kp, kd = 400.0 * inertia * motor, 40.0 * inertia * motor
    limit = np.where(motor > 0.0, 60.0 * inertia, np.inf)
    return q, {
        "no limits": phipsi.PD(kp, kd, target),
        "limits of effort": phipsi.PD(kp, kd, target, effort=limit),
        "motors": phipsi.PD(kp, kd, target, effort=limit, stall=1.2 * limit, no_load_speed=np.where(motor > 0.0, 8.0, np.inf)),
    }


def steps(lines: list[str]) -> None:
    for name in ROBOTS:
        scene = robot(name)
        for states in (None, STATES):
            q, given = laws(scene, states)
            still = np.zeros(scene.nv)
            count = STEPS if states is None else STEPS // 4

            def run(law: phipsi.PD, scene=scene, q=q, still=still, count=count) -> phipsi.Trajectory:
                return scene.simulate(q, still, dt=DT, steps=count, pd=law, record_every=count, limits="report", friction=0.0, form="covariance")

            times = least(TURNS, *(lambda law=law: run(law) for law in given.values()))
            per_step = [1e6 * time / count / (states or 1) for time in times]
            path = scene.simulate(q, still, dt=DT, steps=count, pd=given["limits of effort"], limits="report", friction=0.0)
            limit = np.asarray(given["limits of effort"].effort)
            share = np.mean((np.abs(path.torques()) >= limit * (1.0 - 1e-9))[..., np.isfinite(limit)])
            batch = "one state" if states is None else f"{states} states"
            lines.append(f"| {name} | {batch} | {per_step[0]:.2f} | {per_step[1]:.2f} | {per_step[1] / per_step[0]:.2f} | {per_step[2] / per_step[0]:.2f} | {100 * share:.0f} % |")
            print(lines[-1], flush=True)


def environments(lines: list[str]) -> None:
    arm = phipsi.load(phipsi.BUNDLED_ARM)
    home, builder = np.array([0.3, -0.6, 0.9, 0.1, 0.4, 0.0]), arm.to_builder()
    for joint in arm.joint_names:
        builder.actuator(joint, joint, kp=400.0, kv=40.0)
    scene, random = builder.build(), np.random.default_rng(1)
    for states in (1, 32, 1024):
        worlds = scene.simulator(np.tile(home, (states, 1)), dt=0.005, control=home)
        actions = home + 0.2 * random.uniform(-1.0, 1.0, (20, states, 6))

        def act(worlds=worlds, actions=actions) -> None:
            for action in actions:
                worlds.step(control=action, steps=4)

        (time,) = least(3, act)
        lines.append(f"| {states:,} | {1e6 * time / (20 * 4 * states):.2f} | {20 * 4 * states / time:,.0f} |")
        print(lines[-1], flush=True)


def chain(random: np.random.Generator) -> phipsi.Scene:
    builder, parent = phipsi.SceneBuilder().link("base"), "base"
    for k in range(int(random.integers(2, 8))):
        turn = np.diag(10.0 ** random.uniform(-4, -1) * random.uniform(0.8, 1.2, 3))
        builder.link(f"link{k}", 10.0 ** random.uniform(-1, 1), random.uniform(-0.2, 0.2, 3), turn + 1e-3 * np.eye(3))
        axis = random.normal(size=3)
        builder.joint(f"joint{k}", "revolute", parent, f"link{k}", xyz=random.uniform(-0.4, 0.4, 3), axis=axis, friction=random.choice([0.0, 0.1]))
        parent = f"link{k}"
    return builder.build()


def random_runs(count: int) -> list[str]:
    """The failures of random servos."""
    random, failures = np.random.default_rng(7), []
    for run in range(count):
        if run % 15 == 0:
            scene = chain(random)
        n = scene.nv
        kp, dt = 10.0 ** random.uniform(2, 6), 10.0 ** random.uniform(-4, np.log10(4e-3))
        kd, limit = kp * 10.0 ** random.uniform(-3, 0), 10.0 ** random.uniform(-1, 3)
        motor = {"stall": limit * random.uniform(0.8, 1.5), "no_load_speed": 10.0 ** random.uniform(-0.5, 1.5)} if run % 3 == 2 else {}
        law = phipsi.PD(kp, kd, random.uniform(-1.5, 1.5, n), effort=limit, **motor)
        try:
            path = scene.simulate(random.uniform(-1.5, 1.5, n), random.uniform(-3, 3, n), dt=dt, steps=100, pd=law)
        except Exception as error:  # every kind of failure counts
            failures.append(f"run {run}: {type(error).__name__}: {error}")
            continue
        energy, way = path.energy(), np.abs(np.diff(path.q, axis=0)).sum()
        bound = limit * way + 0.05 * energy.kinetic.max() + 1e-9
        friction = np.abs(scene.friction).max()
        if not (np.isfinite(path.qd).all() and (energy.total - energy.total[0]).max() <= bound and np.abs(path.torques()).max() <= limit * (1.0 + 1e-12) + friction):
            failures.append(f"run {run}: gained {(energy.total - energy.total[0]).max():.3g} J, at most {bound:.3g} J")
    return failures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=4500)
    parser.add_argument("--markdown", type=Path)
    options = parser.parse_args()
    phipsi.set_num_threads(1)
    lines = ["## Steps at the limits of effort", "", "| robot | batch | no limits, us | limits, us | ratio | ratio with motors | torques at a limit |", "| --- | --- | --- | --- | --- | --- | --- |"]
    steps(lines)
    lines += ["", "## Environments", "", "| states | us per step and state | steps per second |", "| --- | --- | --- |"]
    environments(lines)
    failures = random_runs(options.runs)
    lines += ["", "## Random servos", "", f"{len(failures)} of {options.runs:,} runs failed.", *(f"- {failure}" for failure in failures[:20])]
    print("\n".join(lines[-1 - len(failures[:20]) :]))
    how = [
        f"Written by `make servos` (benches/servos.py): one thread, minimum of {TURNS} interleaved timings; load of the machine during the last 1, 5 and 15 minutes: {', '.join(f'{load:.1f}' for load in os.getloadavg())}.",
        "**Steps**: 1 ms, toward targets that most motors cannot follow without a limit, microseconds per step and state; ratios to the same law without limits. **Environments**: the arm of [Gymnasium](../how-to/gymnasium.md) with its servos, exact friction and stops, four steps of 5 ms per action.",
        "**Random servos**: chains of 2 to 7 links, gains of 1e2 to 1e6, steps of 0.1 to 4 ms, in every third run motors whose torque declines with speed. A run fails if it raises, is not finite, exceeds a limit of effort, or gains more energy than its motors can give.",
    ]
    write(options.markdown, "Servos at their limits, measured", how, lines, "other programs, whose servos at their limits are compared on [motion](../motion.md#limits-of-effort); batches on several threads.")


if __name__ == "__main__":
    main()
