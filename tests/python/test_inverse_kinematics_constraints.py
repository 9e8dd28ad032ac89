"""Connections, coupled joints and limits: hard constraints of inverse kinematics and of its joint velocities."""

from __future__ import annotations

import numpy as np
import phipsi
import pytest
from phipsi import tasks
from phipsi.errors import ArgumentError, ConstraintError, SceneError
from tolerances import assert_near


def bar(builder: phipsi.SceneBuilder, name: str, parent: str, at: tuple[float, float, float], length: float, **limits: float) -> None:
    builder.link(name, mass=1.0, com=(0, 0, length / 2), inertia=np.diag([length**2 / 12] * 2 + [1e-3]))
    builder.joint(name, "revolute" if limits else "continuous", parent, name, xyz=at, axis=(0, 1, 0), **limits)


def four_bar(**limits: dict[str, float]) -> phipsi.Scene:
    """The linkage of docs/how-to/closed-loops.md."""
    builder = phipsi.SceneBuilder().link("ground")
    bar(builder, "crank", "ground", (0, 0, 0), 0.2, **limits.get("crank", {}))
    bar(builder, "coupler", "crank", (0, 0, 0.2), 0.4, **limits.get("coupler", {}))
    bar(builder, "rocker", "ground", (0.3, 0, 0), 0.3, **limits.get("rocker", {}))
    builder.connect("pin", "axis", "coupler", "rocker", xyz=(0, 0, 0.4), other_xyz=(0, 0, 0.3), axis=(0, 1, 0))
    return builder.build()


FOUR_BAR = four_bar()
CLOSED = FOUR_BAR.loops.project([0.5, 0.8, 0.2]).q
TIP = (0.0, 0.0, 0.2)


def opened(scene: phipsi.Scene, q: np.ndarray) -> float:
    return float(np.abs(scene.loops.error(q)).max())


# Connections


@pytest.mark.parametrize("seed", range(5))
def test_a_linkage_reaches_what_it_can_reach_and_stays_closed(seed: int) -> None:
    start = FOUR_BAR.loops.project([0.5 + 0.3 * seed, 0.8, 0.2]).q
    target = FOUR_BAR.placement(FOUR_BAR.loops.project([0.9, 0.6, 0.3]).q, "coupler")[:3, 3]
    found = FOUR_BAR.inverse_kinematics(tasks.Position("coupler", target), start)
    assert found.reached and opened(FOUR_BAR, found.q) <= 1e-12
    assert_near(FOUR_BAR.placement(found.q, "coupler")[:3, 3], target, 2e-9)


def test_an_open_start_is_closed() -> None:
    found = FOUR_BAR.inverse_kinematics(tasks.JointPosition("crank", 0.9), [0.5, 0.8, 0.2])
    assert found.reached and opened(FOUR_BAR, found.q) <= 1e-12
    assert_near(found.q[0], 0.9, 2e-9)


def test_what_the_tree_alone_would_reach_is_not_reached() -> None:
    """Smallest distance of the loop from the target, compared with a scan of the crank."""
    target = np.array([0.2, 0.0, -0.1])
    point = (0.0, 0.0, 0.1)
    tree = FOUR_BAR.without_constraints()
    assert tree.inverse_kinematics(tasks.Position("coupler", target, at=point), CLOSED).reached
    found = FOUR_BAR.inverse_kinematics(tasks.Position("coupler", target, at=point), CLOSED)
    assert not found.reached and opened(FOUR_BAR, found.q) <= 1e-12
    least, q = np.inf, CLOSED
    for crank in np.linspace(0.0, 2 * np.pi, 200):
        for _ in range(30):
            q = q + [np.sin(crank - q[0]) * 0.3, 0.0, 0.0]
            try:
                q = FOUR_BAR.loops.project(q).q
            except ConstraintError:
                break
        else:
            place = FOUR_BAR.placement(q, "coupler")
            least = min(least, float(np.linalg.norm(place[:3, 3] + place[:3, :3] @ point - target)))
    assert found.position_error <= least + 1e-4


def test_the_covariance_is_along_the_connections() -> None:
    found = FOUR_BAR.inverse_kinematics(tasks.Position("coupler", FOUR_BAR.placement(CLOSED, "coupler")[:3, 3]), CLOSED, covariance=True)
    assert found.reached and found.covariance is not None
    assert_near(FOUR_BAR.loops.jacobian(found.q) @ found.covariance, np.zeros((5, 3)), 1e-12)
    # One motion remains: its variance is that of a measurement of the point.
    motion = np.linalg.svd(FOUR_BAR.loops.jacobian(found.q))[2][2]
    speed = FOUR_BAR.jacobian(found.q, "coupler", frame="local-world-aligned")[3:] @ motion
    assert_near(found.covariance, np.outer(motion, motion) * 1e-6 / (speed @ speed), 1e-9)


def test_connections_close_within_the_limits_of_joints() -> None:
    scene = four_bar(rocker={"lower": 0.1, "upper": 0.25}, crank={"lower": -3.0, "upper": 3.0})
    found = scene.inverse_kinematics(tasks.JointPosition("crank", -2.0), CLOSED)
    assert not found.reached and opened(scene, found.q) <= 1e-12
    assert 0.1 <= found.q[2] <= 0.25


def test_connections_that_cannot_close_are_named() -> None:
    scene = four_bar(crank={"lower": 0.5, "upper": 0.5}, coupler={"lower": 3.0, "upper": 3.1}, rocker={"lower": 3.0, "upper": 3.1})
    with pytest.raises(ConstraintError, match="pin.*limits=False") as caught:
        scene.inverse_kinematics(tasks.JointPosition("crank", 0.5), CLOSED)
    assert caught.value.connections == ("pin",)


def test_a_posture_and_a_batch_with_connections() -> None:
    targets = np.array([[0.6], [0.8], [1.0]])
    found = FOUR_BAR.inverse_kinematics(tasks.JointPosition("crank", targets[:, 0]), CLOSED, posture=0.5, tolerance=1e-3)
    assert found.reached.all()  # type: ignore[union-attr]
    assert max(opened(FOUR_BAR, q) for q in found.q) <= 1e-12


def test_a_ball_of_an_arm_stays_in_its_socket() -> None:
    """A floating arm whose hand is connected with the world: a spatial loop with a free joint."""
    builder = phipsi.SceneBuilder()
    for k in range(6):
        builder.link(f"link{k}", 1.0, (0.0, 0.0, 0.1), np.eye(3) * 0.01)
        if k:
            builder.joint(f"joint{k}", "revolute", f"link{k - 1}", f"link{k}", xyz=(0.0, 0.0, 0.2), axis=[(1, 0, 0), (0, 1, 0)][k % 2])
    builder.connect("socket", "point", "link5", xyz=(0.0, 0.0, 0.2))
    scene = builder.build(floating_base=True)
    random = np.random.default_rng(1)
    q = scene.loops.project(scene.integrate(scene.neutral(), 0.2 * random.normal(size=scene.nv))).q
    target = scene.placement(q, "link0")
    start = scene.integrate(q, 0.3 * random.normal(size=scene.nv))
    found = scene.inverse_kinematics(tasks.Pose("link0", target), start)
    assert found.reached and opened(scene, found.q) <= 1e-12
    qd = scene.inverse_kinematics_rates(tasks.Position("link0", (0.3, 0.2, 0.1)), q, dt=0.01)
    assert np.abs(qd).max() > 1e-2
    assert_near(scene.loops.jacobian(q) @ qd, np.zeros(3), 1e-9)


@pytest.mark.parametrize("target", [(0.4, 0.0, 0.3), (-0.5, 0.0, 0.5), (2.0, 0.0, 0.0)])
def test_velocities_keep_connections(target: tuple[float, float, float]) -> None:
    qd = FOUR_BAR.inverse_kinematics_rates(tasks.Position("coupler", target), CLOSED, dt=0.01, gain=0.1)
    assert np.abs(qd).max() > 1e-2
    assert_near(FOUR_BAR.loops.jacobian(CLOSED) @ qd, np.zeros(5), 1e-9)


def test_a_control_loop_stays_closed() -> None:
    q = CLOSED
    target = FOUR_BAR.placement(FOUR_BAR.loops.project([0.9, 0.6, 0.3]).q, "coupler")[:3, 3]
    for _ in range(400):
        q = FOUR_BAR.integrate(q, 0.01 * FOUR_BAR.inverse_kinematics_rates(tasks.Position("coupler", target), q, dt=0.01, gain=0.05))
        assert opened(FOUR_BAR, q) <= 1e-4
    assert_near(FOUR_BAR.placement(q, "coupler")[:3, 3], target, 1e-6)


def test_velocities_close_an_open_start() -> None:
    q = CLOSED + [0.0, 0.01, 0.0]
    assert opened(FOUR_BAR, q) > 1e-3
    for _ in range(5):
        q = FOUR_BAR.integrate(q, 0.01 * FOUR_BAR.inverse_kinematics_rates(tasks.JointPosition("crank", q[0]), q, dt=0.01))
    assert opened(FOUR_BAR, q) <= 1e-12


def test_coupled_coordinates_are_kept() -> None:
    builder = phipsi.scenes.chain(4).to_builder()
    joints = builder.build().joint_names
    builder.couple("gear", joints[2], joints[0], multiplier=-0.5, offset=0.1)
    scene = builder.build()
    q = scene.loops.project([0.2, 0.3, 0.0, 0.4]).q
    target = scene.placement(q, scene.body_names[-1])[:3, 3]
    found = scene.inverse_kinematics(tasks.Position(scene.body_names[-1], target), [0.5, 0.1, 0.0, 0.1])
    assert found.reached
    assert_near(found.q[2], -0.5 * found.q[0] + 0.1, 1e-12)


# Coupled joints

FOLLOWER = """<robot name="pair"><link name="base"/>
<link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="leader" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="9" velocity="5"/></joint>
<joint name="follower" type="revolute"><parent link="a"/><child link="b"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/>
  <limit lower="{lower}" upper="{upper}" effort="9" velocity="1"/><mimic joint="leader" multiplier="-2" offset="0.1"/></joint></robot>"""


def test_limits_of_joints_that_follow_are_kept() -> None:
    scene = phipsi.Scene.from_urdf(FOLLOWER.format(lower=-1, upper=0.5), mimic="couple")
    for target, expected in ((2.0, 0.55), (-2.0, -0.2)):
        found = scene.inverse_kinematics(tasks.JointPosition("leader", target))
        assert not found.reached
        assert_near(found.q, [expected], 1e-12)
        assert scene.inverse_kinematics(tasks.JointPosition("leader", target), limits=False).reached
        q = np.zeros(1)
        for _ in range(50):
            qd = scene.inverse_kinematics_rates(tasks.JointPosition("leader", target), q, dt=0.05)
            # The follower is twice as fast.
            assert abs(qd[0]) <= 0.5 * (1 + 1e-12)
            q = q + 0.05 * qd
        assert_near(q, [expected], 1e-12)


def test_limits_of_followers_that_leave_no_room_are_named() -> None:
    scene = phipsi.Scene.from_urdf(FOLLOWER.format(lower=9, upper=10), mimic="couple")
    for call in (lambda: scene.inverse_kinematics(tasks.JointPosition("leader", 0.0)), lambda: scene.inverse_kinematics_rates(tasks.JointPosition("leader", 0.0), [0.0], dt=0.1)):
        with pytest.raises(SceneError, match=r"leader.*follower.*limits=False"):
            call()
    assert scene.inverse_kinematics(tasks.JointPosition("leader", 0.2), limits=False).reached


# Limits


def hinge(**limits: float) -> phipsi.Scene:
    builder = phipsi.SceneBuilder().link("base").link("arm", 1.0, (0.1, 0.0, 0.0), np.eye(3) * 0.01)
    return builder.joint("hinge", "revolute", "base", "arm", axis=(0, 0, 1), **limits).build()


@pytest.mark.parametrize("q", [1.5, -1.5])
@pytest.mark.parametrize("target", [2.0, 0.5, -0.5, -2.0])
def test_a_joint_beyond_its_limit_returns(q: float, target: float) -> None:
    scene = hinge(lower=-1.0, upper=1.0, velocity=2.0)
    qd = scene.inverse_kinematics_rates(tasks.JointPosition("hinge", target), [q], dt=0.01)
    assert_near(qd, [-2.0 * np.sign(q)], 1e-12)
    # To the limit within one long step, and on toward the target.
    qd = scene.inverse_kinematics_rates(tasks.JointPosition("hinge", target), [q], dt=10.0)
    assert_near(q + 10.0 * qd, [np.clip(target, -1.0, 1.0)], 1e-5)
    free = hinge(lower=-1.0, upper=1.0)
    assert_near(q + 0.01 * free.inverse_kinematics_rates(tasks.JointPosition("hinge", target), [q], dt=0.01), [np.clip(target, -1.0, 1.0)], 1e-5)


@pytest.mark.parametrize("seed", range(12))
def test_joints_of_an_arm_beyond_their_limits_return(seed: int) -> None:
    scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
    random, limits, dt = np.random.default_rng(seed), scene.limits, 0.01
    q = random.uniform(limits.lower, limits.upper)
    at = random.integers(0, scene.nv)
    q[at] = limits.upper[at] + 0.5
    target = scene.placement(random.uniform(limits.lower, limits.upper), scene.body_names[-1])
    qd = scene.inverse_kinematics_rates(tasks.Pose(scene.body_names[-1], target), q, dt=dt)
    assert_near(qd[at], -limits.velocity[at], 1e-12)
    assert np.all(np.abs(qd) <= limits.velocity * (1 + 1e-12))


def test_limits_of_joints_of_two_axes() -> None:
    builder = phipsi.SceneBuilder().link("base").link("arm", 1.0, (0.0, 0.0, 0.3), np.eye(3) * 0.01)
    scene = builder.joint("cardan", "universal", "base", "arm", axis=(0, 0, 1), lower=-0.3, upper=0.4).build()
    q = np.array([0.9, -0.8])
    target = scene.placement(q, "arm")
    held = scene.inverse_kinematics(tasks.Pose("arm", target))
    assert not held.reached
    assert np.all(held.q >= -0.3) and np.all(held.q <= 0.4)
    assert scene.inverse_kinematics(tasks.Pose("arm", target), limits=False).reached
    qd = scene.inverse_kinematics_rates(tasks.Pose("arm", target), np.zeros(2), dt=0.1)
    assert np.all(0.1 * qd >= -0.3 - 1e-12) and np.all(0.1 * qd <= 0.4 + 1e-12)


@pytest.mark.parametrize("velocity", [0.5, [0.3, 0.3, 0.3, 0.2, 0.2, 0.2, 1, 1, 1, 1, 1, 1]])
def test_velocity_limits_of_a_floating_base(velocity: float | list[float]) -> None:
    scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM, floating_base=True)
    hand = tasks.Position(scene.body_names[-1], (5.0, 2.0, 1.0))
    assert np.abs(scene.inverse_kinematics_rates(hand, scene.neutral(), dt=0.01)).max() > 1.0
    qd = scene.inverse_kinematics_rates(hand, scene.neutral(), dt=0.01, velocity=velocity)
    assert np.all(np.abs(qd) <= np.asarray(velocity) * (1 + 1e-12)) and np.abs(qd).max() > 0.1


def test_velocity_limits_are_read_per_state() -> None:
    scene = hinge(lower=-1.0, upper=1.0, velocity=2.0)
    qd = scene.inverse_kinematics_rates(tasks.JointPosition("hinge", 1.0), [0.0], dt=0.01, velocity=[[0.1], [np.inf], [0.0]])
    assert_near(qd, [[0.1], [100.0], [0.0]], 1e-3)


@pytest.mark.parametrize(
    ("given", "message"),
    [({"velocity": -1.0}, "velocity: found -1 for joint \"hinge\""), ({"velocity": np.nan}, "velocity: found NaN"), ({"velocity": 1.0, "limits": False}, "velocity: .*limits=True")],
)
def test_bad_velocity_limits_are_refused(given: dict[str, float], message: str) -> None:
    scene = hinge(lower=-1.0, upper=1.0)
    with pytest.raises(ArgumentError, match=message):
        scene.inverse_kinematics_rates(tasks.JointPosition("hinge", 1.0), [0.0], dt=0.01, **given)
