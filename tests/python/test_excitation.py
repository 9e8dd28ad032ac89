"""Scene.excitation: within limits, periodic, consistent, better than where the search began; and its predicted deviations are those of an identification."""

from __future__ import annotations

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
