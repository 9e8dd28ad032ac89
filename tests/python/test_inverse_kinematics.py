"""Scene.inverse_kinematics: what it reaches on real arms, by Pinocchio's placements; batches; each task; what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import phipsi
import pytest
from oracle_pinocchio import ROBOTS, Oracle, load
from phipsi import tasks
from phipsi.errors import ArgumentError, NotFiniteError, ShapeError
from tolerances import assert_near, assert_same_bits, inverse, product

ARM = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
HAND = ARM.body_names[-1]
#: Arms that people have, the link that is their hand, and whether all joints have limits.
ARMS = {"ur_description/urdf/ur5_robot.urdf": "tool0", "panda_description/urdf/panda.urdf": "panda_link8", "iiwa_description/urdf/iiwa14.urdf": "iiwa_link_ee"}


def within(scene: phipsi.Scene, count: int, seed: int) -> np.ndarray:
    """Configurations within the limits, or half a turn where there are none."""
    lower, upper = (np.clip(one, -np.pi, np.pi) for one in (scene.limits.lower, scene.limits.upper))
    return np.random.default_rng(seed).uniform(lower, upper, (count, scene.nv))


@pytest.mark.parametrize("file", ARMS)
def test_poses_of_real_arms(file: str) -> None:
    if not (ROBOTS / file).is_file():
        pytest.skip(f"no {file}")
    scene, _ = load(file, False)
    link = ARMS[file]
    q = within(scene, 100, 1)
    targets = scene.placement(q, link)
    found = scene.inverse_kinematics(tasks.Pose(link, targets), within(scene, 100, 2))
    assert np.count_nonzero(found.reached) >= 99
    limits = scene.limits
    assert np.all(found.q >= limits.lower) and np.all(found.q <= limits.upper)
    oracle = Oracle(file, False, scene)
    for at in np.flatnonzero(found.reached)[:20]:
        there = oracle.placements(found.q[at])[link]
        assert_near(there, targets[at], 1e-8)
        assert found.position_error[at] <= 1e-9 and found.rotation_error[at] <= 1e-9


def test_a_batch_is_its_states_one_by_one() -> None:
    targets = ARM.placement(within(ARM, 6, 3), HAND).reshape(2, 3, 4, 4)
    start = within(ARM, 3, 4)
    found = ARM.inverse_kinematics([tasks.Pose(HAND, targets)], start, covariance=True)
    assert found.q.shape == (2, 3, 6) and found.covariance is not None and found.covariance.shape == (2, 3, 6, 6)
    assert found.reached.shape == (2, 3)  # type: ignore[union-attr]
    for i in range(2):
        for j in range(3):
            one = ARM.inverse_kinematics([tasks.Pose(HAND, targets[i, j])], start[j], covariance=True)
            assert_same_bits(one.q, found.q[i, j])
            assert one.covariance is not None
            assert_same_bits(one.covariance, found.covariance[i, j])
            assert isinstance(one.reached, bool) and isinstance(one.starts, int) and np.ndim(one.position_error) == 0


@pytest.mark.parametrize(
    "task",
    [
        tasks.Position(HAND, (0.5, 0.2, 0.3), at=(0.0, 0.05, 0.1)),
        tasks.Orientation(HAND, [[0, 0, 1], [1, 0, 0], [0, 1, 0]]),
        tasks.Direction(HAND, (0.0, 0.0, -2.0), axis=(0.0, 3.0, 0.0)),
        tasks.LookAt(HAND, (1.0, 1.0, 0.0), at=(0.0, 0.0, 0.1)),
        tasks.JointPosition("joint3", 0.4),
    ],
    ids=lambda task: type(task).__name__,
)
def test_each_task_is_met(task: Any) -> None:
    found = ARM.inverse_kinematics(task)
    assert found.reached
    place = ARM.placement(found.q, HAND)
    rotation, origin = place[:3, :3], place[:3, 3]
    if isinstance(task, tasks.Position):
        assert_near(origin + rotation @ task.at, np.array(task.target), 2e-9)
    elif isinstance(task, tasks.Orientation):
        assert_near(rotation, np.array(task.target, float), 2e-9)
    elif isinstance(task, tasks.Direction):
        assert_near(rotation @ [0, 1, 0], np.array([0.0, 0.0, -1.0]), 2e-9)
    elif isinstance(task, tasks.LookAt):
        way = np.array(task.target) - (origin + rotation @ task.at)
        assert_near(rotation[:, 2], way / np.linalg.norm(way), 2e-9)
    else:
        assert_near(found.q[2], 0.4, 2e-9)


def test_a_mass_centre_and_a_hand_of_a_floating_robot() -> None:
    scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM, floating_base=True)
    place = np.eye(4)
    place[:3, 3] = 0.4, 0.1, 0.3
    found = scene.inverse_kinematics([tasks.CenterOfMass((0.1, 0.2, 0.3)), tasks.Pose(HAND, place)])
    assert found.reached
    assert_near(scene.center_of_mass(found.q), np.array([0.1, 0.2, 0.3]), 2e-9)
    assert_near(scene.placement(found.q, HAND), place, 4e-9)


def test_the_smaller_deviation_wins() -> None:
    """Two points for one hand: the answer is their mean with the inverse variances as weights, where the arm can go anywhere."""
    near, far = np.array([0.5, 0.1, 0.3]), np.array([0.5, 0.2, 0.3])
    found = ARM.inverse_kinematics([tasks.Position(HAND, near, position=1e-3), tasks.Position(HAND, far, position=2e-3)], starts=1)
    assert not found.reached
    assert_near(ARM.placement(found.q, HAND)[:3, 3], (4 * near + far) / 5, 1e-6)


def test_a_posture_and_its_covariance() -> None:
    q0 = np.array([0.2, -0.5, 0.7, 0.1, 0.3, 0.0])
    target = ARM.placement(q0, HAND)[:3, 3] + [0.01, 0.02, -0.01]
    found = ARM.inverse_kinematics(tasks.Position(HAND, target, position=1e-4), q0, posture=0.3, tolerance=1e-4, covariance=True)
    assert found.reached and found.starts == 1 and found.covariance is not None
    linear = ARM.jacobian(found.q, HAND, frame="local-world-aligned")[3:]
    precision = linear.T @ linear / 1e-8 + np.eye(6) / 0.09
    expected = np.linalg.inv(precision)
    assert_near(found.covariance, expected, inverse(float(np.linalg.cond(precision)), np.max(np.abs(expected))))


def test_limits_hold_or_not() -> None:
    beyond = np.where(np.arange(6) == 1, ARM.limits.upper + 0.5, 0.1)
    target = ARM.placement(beyond, HAND)
    held = ARM.inverse_kinematics(tasks.JointPosition("joint2", beyond[1]), beyond)
    assert not held.reached
    assert_near(held.q[1], ARM.limits.upper[1], product(1, 1.0))
    free = ARM.inverse_kinematics(tasks.Pose(HAND, target), beyond, limits=False)
    assert free.reached
    assert_same_bits(free.q, beyond)


def test_the_number_of_threads_changes_nothing() -> None:
    targets = ARM.placement(within(ARM, 64, 5), HAND)
    before = phipsi.get_num_threads()
    try:
        results = []
        for count in (1, 2):
            phipsi.set_num_threads(count)
            results.append(ARM.inverse_kinematics(tasks.Pose(HAND, targets)).q)
    finally:
        phipsi.set_num_threads(before)
    assert_same_bits(*results)


POSITION = tasks.Position(HAND, (0.5, 0.1, 0.3))


@pytest.mark.parametrize(
    ("given", "kind", "message"),
    [
        ({"tasks": 3}, TypeError, "int"),
        ({"tasks": [3]}, ArgumentError, "tasks: found int at 0; expected Pose, Position"),
        ({"tasks": POSITION._replace(link="foot")}, ArgumentError, r"tasks\[0\].link: found \"foot\""),
        ({"tasks": tasks.JointPosition("knee", 0.0)}, ArgumentError, r"tasks\[0\].joint: found \"knee\""),
        ({"tasks": POSITION._replace(target=(0.0, 1.0))}, ShapeError, r"tasks\[0\].target: found shape \(2,\); expected \(..., 3\)"),
        ({"tasks": tasks.Pose(HAND, np.eye(3))}, ShapeError, r"tasks\[0\].target: found shape \(3, 3\); expected \(..., 4, 4\)"),
        ({"tasks": tasks.Pose(HAND, np.diag([1.0, 2.0, 1.0, 1.0]))}, ArgumentError, "target of task 0.*a rotation matrix"),
        ({"tasks": tasks.Direction(HAND, (0, 0, 0))}, ArgumentError, r"tasks\[0\].target: found an axis without direction"),
        ({"tasks": POSITION._replace(at=(0, 0))}, ShapeError, r"tasks\[0\].at: found shape \(2,\)"),
        ({"tasks": POSITION._replace(target=(0, 0, np.nan))}, NotFiniteError, "target of task 0: found NaN"),
        ({"tasks": POSITION._replace(position=0.0)}, ArgumentError, "position deviation of task 0"),
        ({"q0": np.zeros(5)}, ShapeError, "q0"),
        ({"q0": np.full(6, np.nan)}, NotFiniteError, "q0"),
        ({"starts": 0}, ArgumentError, "starts: found 0"),
        ({"tolerance": -1.0}, ArgumentError, "tolerance: found -1"),
        ({"posture": 0.0}, ArgumentError, "posture: found 0"),
    ],
)
def test_bad_arguments(given: dict[str, Any], kind: type[Exception], message: str) -> None:
    arguments = {"tasks": POSITION} | given
    with pytest.raises(kind, match=message):
        ARM.inverse_kinematics(**arguments)


