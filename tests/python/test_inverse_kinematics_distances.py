"""tasks.Distance in inverse kinematics: solutions avoid the table, the robot itself, and named pairs."""

from __future__ import annotations

import numpy as np
import phipsi
import pytest
from phipsi import shapes, tasks
from phipsi.errors import ArgumentError, NotFiniteError, PhipsiError
from test_collider_distances import arm
from tolerances import assert_near


def reacher(joints: int = 5) -> phipsi.Scene:
    """A planar-ish arm of capsules over a table whose edge is in the way."""
    builder = phipsi.SceneBuilder().link("ground").collider("table", shapes.Box((0.6, 1.0, 0.1), xyz=(0.6, 0, 0.3)))
    parent = "ground"
    for at in range(joints):
        name = f"arm{at}"
        builder.link(name, mass=1.0, inertia=0.01 * np.eye(3))
        builder.joint(name, "revolute", parent, name, xyz=(0, 0, 0.25 if at else 0.0), axis=(0, 1, 0) if at else (0, 0, 1), lower=-2.8, upper=2.8)
        builder.collider(name, shapes.Capsule(0.04, 0.25, xyz=(0, 0, 0.125)), link=name)
        parent = name
    builder.link("hand").joint("wrist", "fixed", parent, "hand", xyz=(0, 0, 0.25))
    return builder.build()


def test_an_arm_reaches_around_a_table() -> None:
    scene = reacher()
    random = np.random.default_rng(1)
    # Targets above and below the table.
    targets = np.column_stack([random.uniform(0.35, 0.6, 30), random.uniform(-0.1, 0.1, 30), np.where(np.arange(30) % 2, 0.15, 0.5)])
    reach = tasks.Position("hand", targets)
    free = scene.inverse_kinematics(reach)
    found = scene.inverse_kinematics([reach, tasks.Distance(lower=0.01)])
    through = scene.distances(free.q).distance.min(axis=-1) < 0.01
    assert np.count_nonzero(through) >= 5
    assert np.count_nonzero(found.reached) >= 27
    ok = np.asarray(found.reached)
    assert scene.distances(found.q[ok]).distance.min() >= 0.01 - 1e-9
    assert_near(scene.placement(found.q[ok], "hand")[:, :3, 3], targets[ok], 1e-9)
    assert np.all(np.abs(found.q) <= 2.8)


def test_an_arm_does_not_pass_through_itself() -> None:
    scene = reacher()
    folded = np.array([0.0, 2.7, 2.7, 2.7, 0.3])
    assert scene.distances(folded).distance.min() < -0.02
    found = scene.inverse_kinematics(tasks.Distance(lower=0.02), folded)
    assert found.reached and scene.distances(found.q).distance.min() >= 0.02 - 1e-9


@pytest.mark.parametrize("lower", [-0.01, 0.0, 0.05])
def test_a_deep_penetration_is_pushed_out(lower: float) -> None:
    builder = phipsi.SceneBuilder().link("block", mass=1.0, inertia=np.eye(3)).collider("block", shapes.Box((0.2, 0.2, 0.2)), link="block")
    scene = builder.collider("floor", shapes.HalfSpace()).collider("wall", shapes.Box((0.1, 2, 2), xyz=(0.5, 0, 0))).build(floating_base=True)
    start = np.array([0.48, 0.1, -0.6, 0.1, 0.2, 0.3, 0.0])
    start[3:] = [*(0.3 * start[3:6]), np.sqrt(1 - 0.09 * np.sum(start[3:6] ** 2))]
    found = scene.inverse_kinematics(tasks.Distance(lower=lower), start)
    assert found.reached and found.position_error <= 1e-9
    assert scene.distances(found.q).distance.min() >= lower - 1e-9
    assert scene.distances(found.q).distance.min() <= lower + 0.05


def test_an_inequality_that_holds_changes_nothing() -> None:
    scene = reacher()
    q = np.array([0.3, -0.5, 0.4, 0.2, 0.1])
    reach = tasks.Position("hand", scene.placement(q, "hand")[:3, 3])
    alone = scene.inverse_kinematics(reach, q + 0.05)
    both = scene.inverse_kinematics([reach, tasks.Distance(("table", "arm4"), lower=0.01)], q + 0.05)
    assert np.array_equal(alone.q, both.q) and both.iterations == alone.iterations


def test_a_target_in_the_table_ends_in_front_of_it() -> None:
    scene = reacher()
    target = tasks.Position("hand", (0.6, 0.0, 0.32))
    found = scene.inverse_kinematics([target, tasks.Distance([("table", "arm4"), ("table", "arm3")])], starts=5)
    assert not found.reached
    assert -1e-3 <= scene.distances(found.q, pairs=[("table", "arm4")]).distance[0] <= 1e-3
    assert 0.02 < found.position_error < 0.2
    # A larger deviation gives way.
    soft = scene.inverse_kinematics([target, tasks.Distance([("table", "arm4"), ("table", "arm3")], position=1e-2)], starts=5)
    assert scene.distances(soft.q, pairs=[("table", "arm4")]).distance[0] < -0.02


def test_lower_bounds_are_a_batch_and_errors_are_reported() -> None:
    builder = phipsi.SceneBuilder().link("rail").link("slide", mass=1.0).joint("x", "prismatic", "rail", "slide", axis="x", lower=-1, upper=0.4)
    scene = builder.collider("slide", shapes.Sphere(0.1), link="slide").collider("wall", shapes.Sphere(0.1), link="rail").build()
    found = scene.inverse_kinematics(tasks.Distance(("slide", "wall"), lower=[0.0, 0.1, 0.9]), [0.1], starts=1)
    assert_near(found.q[:2, 0], [0.2, 0.3], 1e-9)
    assert found.reached.tolist() == [True, True, False]  # type: ignore[union-attr]
    assert_near(found.position_error[2], 0.7, 1e-9)
    assert scene.inverse_kinematics(tasks.Distance(lower=0.7), [0.1]).reached
    moved = scene.inverse_kinematics_rates(tasks.Distance(lower=0.05), [0.1], dt=0.1)
    assert_near(moved, [1.5], 1e-5)
    assert_near(scene.inverse_kinematics_rates(tasks.Distance(lower=0.05), [0.3], dt=0.1), [0.0], 0.0)


def test_coupled_joints_and_covariance() -> None:
    scene = arm(mimic=True).build(mimic="couple")
    q = np.random.default_rng(3).uniform(-2, 2, (400, scene.nq))
    least = scene.distances(q).distance.min(axis=-1)
    starts = q[least < -0.01][:5]
    assert len(starts) == 5
    found = scene.inverse_kinematics(tasks.Distance(), starts)
    assert np.all(found.reached) and scene.distances(found.q).distance.min() >= -1e-9
    near = scene.inverse_kinematics(tasks.Distance(), starts[0], posture=1.0, tolerance=1e-3, covariance=True)
    assert near.covariance is not None and np.isfinite(near.covariance).all()
    assert scene.distances(near.q).distance.min() >= -1e-3


def test_refused_arguments_are_named() -> None:
    scene = reacher(3)
    for task, error, message in [
        (tasks.Distance(("arm0", "nothing")), ArgumentError, r"tasks\[0\]\.pair.*nothing.*arm0"),
        (tasks.Distance(("arm0", "arm0")), ArgumentError, r"tasks\[0\]\.pair.*twice"),
        (tasks.Distance([]), ArgumentError, r"tasks\[0\]\.pair.*no pair"),
        (tasks.Distance("arm0"), ArgumentError, r"tasks\[0\]\.pair"),  # type: ignore[arg-type]
        (tasks.Distance(lower=np.nan), NotFiniteError, "lower of task 0"),
        (tasks.Distance(position=0.0), PhipsiError, "position"),
    ]:
        with pytest.raises(error, match=message):
            scene.inverse_kinematics(task)
    with pytest.raises(ArgumentError, match=r"tasks\[0\]\.pair.*SceneBuilder\.collider"):
        phipsi.load(phipsi.BUNDLED_ARM).inverse_kinematics(tasks.Distance())
