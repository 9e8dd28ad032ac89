"""Scene.excitation: within limits, periodic, consistent, better than where the search began; and its predicted deviations are those of an identification."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from logs import arm_of_three

import phipsi
from phipsi.errors import ArgumentError



@pytest.fixture(scope="module")
def arm() -> phipsi.Scene:
    return phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)


def test_it_is_within_limits_and_consistent(arm: phipsi.Scene) -> None:
    found, limits = arm.excitation(8.0, iterations=40, rate=200.0), arm.limits
    assert found.q.shape == (1600, 6) and found.improvement > 1.0
    assert np.all((limits.lower < found.q) & (found.q < limits.upper))
    assert np.all(np.abs(found.qd) <= limits.velocity) and np.all(np.abs(found.tau) <= limits.effort)
    step = 1 / 200.0
    around = np.concatenate([found.q[-1:], found.q, found.q[:1]])
    assert np.max(np.abs((around[2:] - around[:-2]) / (2 * step) - found.qd)) < 1e-3 * np.max(np.abs(found.qdd))
    assert np.max(np.abs(np.gradient(found.qd, step, axis=0)[1:-1] - found.qdd[1:-1])) < 1e-2 * np.max(np.abs(found.qdd))


def test_limits_of_torque_bind(arm: phipsi.Scene) -> None:
    limits = arm.limits
    held = np.abs(arm.gravity_torque(0.5 * (limits.lower + limits.upper)))
    tight = limits._replace(effort=0.25 * limits.effort)
    assert np.all(np.abs(arm.excitation(4.0, limits=tight, iterations=10).tau) <= tight.effort)
    assert np.any(np.abs(arm.excitation(4.0, iterations=10).tau) > tight.effort)
    with pytest.raises(ArgumentError, match=r"limits: found too little torque for joint 'joint\d' to hold"):
        arm.excitation(4.0, limits=limits._replace(effort=np.full(6, 0.1 * held.max())))
    with pytest.raises(ArgumentError, match=r"limits: found too little torque for joint 'joint\d' to move"):
        arm.excitation(4.0, limits=limits._replace(effort=held + 0.5 * arm.friction))


def test_predicted_deviations_are_those_of_a_log() -> None:
    scene = arm_of_three()
    plan = scene.excitation(10.0, iterations=60, fit=["armature", "damping", "friction"], noise=0.2)
    draw, off = np.random.default_rng(0), []
    for _ in range(30):
        found = scene.identify(plan.q, plan.qd, plan.qdd, plan.tau + 0.2 * draw.standard_normal(plan.tau.shape), fit=["armature", "damping", "friction"], noise=0.2)
        off.append((found.base.values - found.base.model) / plan.deviations)
    assert found.base.names == plan.names
    # 30 logs: a standard deviation is known to 13 %.
    assert np.all((0.5 < np.std(off, axis=0)) & (np.std(off, axis=0) < 1.7)) and 0.9 < np.sqrt(np.mean(np.square(off))) < 1.1


def robot(name: str) -> phipsi.Scene:
    if name == "arm":
        return phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
    if name == "massless":
        # A file without the inertia of the last link, which another file may have.
        scene = phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)
        return scene.with_inertias({"link6": (0.0, np.zeros(3), np.zeros((3, 3)))})
    pin = pytest.importorskip("pinocchio")
    robots = Path(pin.__file__).resolve().parents[4] / "share/example-robot-data/robots"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if name == "UR5":
            return phipsi.Scene.from_urdf(robots / "ur_description/urdf/ur5_robot.urdf")
        scene = phipsi.Scene.from_urdf(robots / "panda_description/urdf/panda.urdf")
        return scene.lock([joint for joint in scene.joint_names if "finger" in joint], np.zeros(scene.nq))


def information(scene: phipsi.Scene, motion: tuple[np.ndarray, ...], noise: np.ndarray, basis: np.ndarray) -> float:
    """log det of the information of the bodies, in coordinates of an orthonormal basis of the directions that torques depend on."""
    rows = scene.regressor(*motion).reshape(len(motion[0]), scene.nv, -1) / noise[:, None]
    return float(2 * np.sum(np.log(np.linalg.svd(rows.reshape(-1, rows.shape[2]) @ basis, compute_uv=False))))


def random_motion(scene: phipsi.Scene, time: np.ndarray, draw: np.random.Generator, limits: Any) -> tuple[np.ndarray, ...]:
    """A motion of five harmonics as large as the limits of the excitation allow."""
    low, high = (np.where(np.isfinite(one), one, 2.0 * at) for one, at in ((limits.lower, -1), (limits.upper, 1)))
    middle, half = 0.5 * (low + high), 0.45 * (high - low)
    offset, amplitudes = half * draw.uniform(-0.5, 0.5, scene.nv), draw.standard_normal((5, scene.nv)) + 1j * draw.standard_normal((5, scene.nv))
    w = 2j * np.pi / (time[-1] + time[1]) * np.arange(1, 6)
    q, qd, qdd = ((np.exp(np.outer(time, w)) * w**order @ amplitudes).real for order in range(3))
    scale = np.minimum((half - np.abs(offset)) / np.abs(q).max(axis=0), 0.9 * limits.velocity / np.abs(qd).max(axis=0))
    while True:
        motion = (middle + offset + scale * q, scale * qd, scale * qdd)
        if np.all(np.abs(scene.inverse_dynamics(*motion) + scene.damping * motion[1] + scene.friction * np.sign(motion[1])) <= 0.9 * limits.effort):
            return motion
        scale = 0.9 * scale


@pytest.mark.parametrize("name", ["arm", "UR5", "panda"])
def test_it_has_more_information_than_the_best_of_200_random_motions(name: str) -> None:
    scene, draw = robot(name), np.random.default_rng(5)
    noise = np.full(scene.nv, 0.2)
    samples = scene.regressor(*draw.uniform(-2, 2, (3, 60, scene.nv))).reshape(60 * scene.nv, -1)
    _, singular, right = np.linalg.svd(samples)
    basis = right[: int(np.sum(singular > 1e-9 * singular[0]))].T
    time = np.arange(100) * 0.1
    best = max(information(scene, random_motion(scene, time, draw, scene.limits), noise, basis) for _ in range(200))
    plan = scene.excitation(10.0, noise=0.2, rate=10.0, iterations=100)
    assert information(scene, (plan.q, plan.qd, plan.qdd), noise, basis) > best + 3.0


def test_limits_of_acceleration_and_jerk_bind(arm: phipsi.Scene) -> None:
    free = arm.excitation(4.0, iterations=5, rate=400.0)
    acceleration, jerk = (0.3 * np.abs(one).max(axis=0) for one in (free.qdd, np.gradient(free.qdd, 1 / 400, axis=0)))
    for change in ({"acceleration": acceleration}, {"deceleration": acceleration}, {"jerk": jerk}):
        found = arm.excitation(4.0, iterations=5, rate=400.0, limits=arm.limits._replace(**change))
        of = np.abs(np.gradient(found.qdd, 1 / 400, axis=0) if "jerk" in change else found.qdd).max(axis=0)
        share = of / next(iter(change.values()))
        assert np.all(share < 1.0) and np.all(share > 0.5)


def test_the_noise_of_a_joint_changes_the_motion(arm: phipsi.Scene) -> None:
    """Where the torques of the last joints are exact, the search makes them decide more."""
    noise = np.array([1.0, 1.0, 1.0, 0.01, 0.01, 0.01])
    one, other = arm.excitation(6.0, noise=1.0, rate=20.0, iterations=80), arm.excitation(6.0, noise=noise, rate=20.0, iterations=80)
    assert np.any(one.q != other.q)
    rows = [arm.regressor(plan.q, plan.qd, plan.qdd).reshape(-1, 6, 60) / noise[:, None] for plan in (one, other)]
    ranks = [np.sort(np.linalg.svd(each.reshape(-1, 60), compute_uv=False))[::-1][:36] for each in rows]
    assert np.sum(np.log(ranks[1])) > np.sum(np.log(ranks[0]))
    default = arm.excitation(6.0, iterations=1, rate=20.0)
    np.testing.assert_allclose(default.noise, 0.01 * arm.limits.effort, rtol=1e-12)


def test_bodies_without_mass_and_weak_motion_have_a_plan() -> None:
    """One slow harmonic decides few parameters: the prior makes the determinant finite."""
    for scene in (robot("massless"), robot("arm")):
        plan = scene.excitation(100.0, harmonics=1, iterations=5, rate=1.0, fit=["armature", "friction", "offset"], noise=1.0)
        assert np.isfinite(plan.improvement) and plan.improvement >= 0.0


def test_the_same_seed_gives_the_same_trajectory() -> None:
    scene = arm_of_three()
    one, other, third = (scene.excitation(5.0, iterations=5, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.q, other.q)
    assert np.any(one.q != third.q)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"duration": -1.0}, "duration: found -1.0"),
        ({"harmonics": 0}, "harmonics: found 0; expected a whole number, at least 1"),
        ({"rate": 0.5}, "rate: found 0.5 samples per second for a frequency of 0.5 Hz"),
        ({"limits": 3.0}, "limits: found 3.0; expected phipsi.Limits"),
    ],
)
def test_bad_arguments(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        arm_of_three().excitation(**({"duration": 10.0} | change))


def test_joints_of_several_axes_are_refused() -> None:
    scene = phipsi.SceneBuilder().link("base").link("ball", 1.0, (0, 0, 0.1), 0.1 * np.eye(3)).joint("at", "spherical", "base", "ball").build()
    with pytest.raises(ArgumentError, match="excitation: found joints that are not of one axis"):
        scene.excitation(10.0)
