"""Inverse kinematics, compared with pink, mink and dynibo in one run: number of poses reached, and time per pose.

Usage: python benches/inverse_kinematics.py [--poses 1000] [--markdown FILE]; `make inverse-kinematics` creates the
environment.

All programs have the same poses, which are those of the arm at random configurations within its limits, and the same
first starting configuration. phipsi draws the later ones itself: from four draws each (sixteen from the fourth start
on) the one nearest to the pose; the others get random configurations. Each pose is one call, timed as the minimum of
five; a pose is reached if position and rotation are within 1e-8 (m, rad), with the same largest number of steps per
start. pink and mink solve a quadratic program per step, in Python with DAQP; they are designed for control at a fixed
rate, and here they take full steps with their smallest damping. They solve fewer poses, because they take longer.
dynibo takes damped steps with its default damping and longest step, and its results beyond the joint limits are
rejected.
"""

import argparse
import re
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import phipsi
import phipsi.pinocchio
import pinocchio as pin
from phipsi import tasks
from robots import ROBOTS
#: Link of the target: one that all programs have, the last movable one.
ARMS = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "wrist_3_link"),
    "panda": ("panda_description/urdf/panda.urdf", "panda_link7"),
    "kinova": ("kinova_description/robots/kinova.urdf", None),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", None),
    "iiwa14": (str(Path(__file__).resolve().parents[1] / "tests/data/iiwa14.urdf"), "link7"),
}
TOLERANCE, STEPS, STARTS = 1e-8, 100, 20
#: Number of poses of the slow programs, and number of timings of each pose, of which the shortest counts.
FEW, REPEATS = 100, 5
FAST = ("phipsi", "dynibo")

Solver = Callable[[np.ndarray, np.ndarray], int]
"""From a pose, (4, 4), and starting configurations, (k, nq): number of starts; 0 if none succeeded."""


def arm(name: str) -> tuple[phipsi.Scene, str]:
    """The arm alone, without shapes, and the link of the target."""
    file, link = ARMS[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = phipsi.Scene.from_urdf(ROBOTS / file)
        # A scene from text has no file, and therefore no shapes.
        scene = phipsi.Scene.from_urdf(phipsi.Scene.from_urdf(scene.to_urdf()).to_urdf())
    return scene, link or scene.body_names[-1]


def ours(scene: phipsi.Scene, link: str) -> Solver:
    def solve(pose: np.ndarray, starts: np.ndarray) -> int:
        found = scene.inverse_kinematics(tasks.Pose(link, pose), starts[0], starts=STARTS, iterations=STEPS, tolerance=TOLERANCE)
        return int(found.starts) if found.reached else 0

    return solve


def pink(scene: phipsi.Scene, link: str) -> Solver:
    import pink as other
    from pink.limits import ConfigurationLimit
    from pink.tasks import FrameTask

    model = pin.buildModelFromXML(scene.to_urdf())
    data, limit = model.createData(), ConfigurationLimit(model, config_limit_gain=1.0)

    def solve(pose: np.ndarray, starts: np.ndarray) -> int:
        task = FrameTask(link, position_cost=1.0, orientation_cost=1.0, lm_damping=1e-8, gain=1.0)
        task.set_target(pin.SE3(pose))
        for at, start in enumerate(starts, 1):
            state = other.Configuration(model, data, phipsi.pinocchio.from_state(scene, model, start)[0])
            for _ in range(STEPS):
                error = task.compute_error(state)
                if np.linalg.norm(error[:3]) <= TOLERANCE and np.linalg.norm(error[3:]) <= TOLERANCE:
                    return at
                rates = other.solve_ik(state, [task], 1.0, solver="daqp", damping=1e-10, limits=[limit], safety_break=False)
                state.integrate_inplace(rates, 1.0)
        return 0

    return solve


def mink(scene: phipsi.Scene, link: str) -> Solver:
    import mink as other
    import mujoco

    model = mujoco.MjModel.from_xml_string(scene.to_urdf())
    limit = other.ConfigurationLimit(model, gain=0.99)

    def solve(pose: np.ndarray, starts: np.ndarray) -> int:
        task = other.FrameTask(link, "body", position_cost=1.0, orientation_cost=1.0, lm_damping=1e-8, gain=1.0)
        task.set_target(other.SE3.from_matrix(pose))
        for at, start in enumerate(starts, 1):
            state = other.Configuration(model, q=start)
            for _ in range(STEPS):
                error = task.compute_error(state)
                if np.linalg.norm(error[:3]) <= TOLERANCE and np.linalg.norm(error[3:]) <= TOLERANCE:
                    return at
                rates = other.solve_ik(state, [task], 1.0, solver="daqp", damping=1e-10, limits=[limit])
                state.integrate_inplace(rates, 1.0)
        return 0

    return solve


def dynibo(scene: phipsi.Scene, link: str) -> Solver:
    import dynibo as other

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.urdf"
        # It does not support coupled joints; here those are fingers, which do not move the link of the target.
        file.write_text(re.sub(r"<mimic\b[^>]*/>", "", scene.to_urdf()), encoding="utf-8")
        robot = other.Robot.from_urdf(str(file))
    at = robot.link_id(link)
    options = other.IkOptions(max_iterations=STEPS, translation_tolerance=TOLERANCE, rotation_tolerance=TOLERANCE)

    def solve(pose: np.ndarray, starts: np.ndarray) -> int:
        x, y, z, *rotation = pin.SE3ToXYZQUAT(pin.SE3(pose))
        target = other.Pose(translation=(x, y, z), rotation_xyzw=tuple(rotation))
        for number, start in enumerate(starts, 1):
            try:
                robot.inverse_kinematics(start, at, target, options=options)
            except other.SolverError:
                continue
            return number
        return 0

    return solve


def measured(solve: Solver, poses: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number of starts for each pose, and time, s."""
    taken, times = [], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solve(poses[0], starts[0])
        for pose, own in zip(poses, starts, strict=True):
            shortest = np.inf
            for _ in range(REPEATS):
                begin = time.perf_counter()
                try:
                    count = solve(pose, own)
                except Exception:  # a quadratic program without a solution
                    count = 0
                shortest = min(shortest, time.perf_counter() - begin)
            taken.append(count)
            times.append(shortest)
    return np.array(taken), np.array(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=1000)
    parser.add_argument("--markdown", type=Path)
    given = parser.parse_args()
    phipsi.set_num_threads(1)
    lines = [
        f"| arm | program | poses | 1 start | {STARTS // 2} starts | {STARTS} starts | per pose, us (median) | relative to phipsi |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name in ARMS:
        if not (ROBOTS / ARMS[name][0]).is_file():
            continue
        scene, link = arm(name)
        lower, upper = (np.clip(one, -np.pi, np.pi) for one in (scene.limits.lower, scene.limits.upper))
        random = np.random.default_rng(0)
        poses = scene.placement(random.uniform(lower, upper, (given.poses, scene.nv)), link)
        starts = random.uniform(lower, upper, (given.poses, STARTS, scene.nv))
        reference = None
        for program, make in (("phipsi", ours), ("dynibo", dynibo), ("pink", pink), ("mink", mink)):
            count = given.poses if program in FAST else min(FEW, given.poses)
            taken, times = measured(make(scene, link), poses[:count], starts[:count])
            reference = reference or np.median(times)
            shares = [f"{100 * np.mean((taken > 0) & (taken <= most)):.1f} %" for most in (1, STARTS // 2, STARTS)]
            median = np.median(times)
            lines.append(f"| {name} | {program} | {count} | {' | '.join(shares)} | {1e6 * median:.3g} | {median / reference:.3g} |")
            print(lines[-1], flush=True)
    if given.markdown:
        head, body = (__doc__ or "").split("\n\n", 1)
        note = body.split("\n\n", 1)[1].strip()
        given.markdown.write_text(f"# Times of inverse kinematics\n\n{head} This page is generated: `make inverse-kinematics`.\n\n{note}\n\n" + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
