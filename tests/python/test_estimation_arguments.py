"""Arguments of Scene.estimate: masks, shapes, joints without inertia; one broken argument per test."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import phipsi
import pytest
from conftest import random_states
from phipsi.errors import ArgumentError, NotFiniteError, ShapeError, SingularJointError
from tolerances import assert_same_bits


def test_a_mask_is_infinite_noise(mixed: phipsi.Scene) -> None:
    q, qd, y = random_states(mixed, 5)
    names = [mixed.joint_names[i] for i in (0, 2, 3)]
    mask = np.zeros(mixed.nv, bool)
    for name in names:
        mask[mixed.v_index(name)] = True
    broken = np.where(mask, y, np.nan)
    expected = mixed.estimate(q, qd, y, noise=np.where(mask, 0.5, np.inf), covariance=True)
    for measured in (names, tuple(names), iter(names), mask, mask.tolist(), np.array(names)):
        found = mixed.estimate(q, qd, broken, noise=0.5, measured=measured, covariance=True)
        for one, other in zip(found, expected, strict=True):
            assert_same_bits(one, other)
    # The noise of a joint that is not measured is ignored.
    found = mixed.estimate(q, qd, broken, noise=np.where(mask, 0.5, np.nan), measured=names)
    assert_same_bits(found.force, expected.force)


def test_shapes_broadcast_and_covariances_come_when_asked_for(mixed: phipsi.Scene) -> None:
    n = mixed.nv
    q, qd, y = random_states(mixed, 6, (3, 1))
    noise = np.abs(random_states(mixed, 7, (4,)).tau)
    prior = random_states(mixed, 8, (2, 1, 1)).qd
    found = mixed.estimate(q, qd, y, noise=noise, prior_acceleration=prior, covariance=True)
    assert isinstance(found, phipsi.Estimate)
    shapes = ((n,), (n,), (n, 6), (n, 6), (), (n,), (n,), (n, 6, 6), (n, 6, 6))
    assert [part.shape for part in found] == [(2, 3, 4, *shape) for shape in shapes]
    one = mixed.estimate(q[1, 0], qd[1, 0], y[1, 0], noise=noise[2], prior_acceleration=prior[1, 0, 0], covariance=True)
    for whole, single in zip(found, one, strict=True):
        assert_same_bits(whole[1, 1, 2], single)
    assert isinstance(one.log_likelihood, np.float64)
    without = mixed.estimate(q, qd, y, noise=noise, prior_acceleration=prior)
    assert without[5:] == (None,) * 4
    for whole, single in zip(found[:5], without[:5], strict=True):
        assert_same_bits(whole, single)


def test_no_joints_and_no_states(welded: phipsi.Scene, mixed: phipsi.Scene) -> None:
    for method in ("sequential", "batch"):
        found = welded.estimate([], [], [], covariance=True, method=method)
        assert found.force.shape == (0, 6) and found.process_covariance.shape == (0, 6, 6) and found.log_likelihood == 0.0
    none = mixed.estimate(np.zeros((0, mixed.nq)), np.zeros(mixed.nv), np.zeros(mixed.nv), covariance=True)
    assert none.force_covariance.shape == (0, mixed.nv, 6, 6) and none.log_likelihood.shape == (0,)


def ghost(armature: float = 0.0) -> phipsi.Scene:
    """An arm whose finger has no inertia."""
    builder = phipsi.SceneBuilder().link("base").link("arm", mass=1.0, com=(0.1, 0, 0)).link("tip")
    builder.joint("shoulder", "revolute", "base", "arm").joint("finger", "revolute", "arm", "tip", armature=armature)
    return builder.build()


def test_a_joint_without_inertia() -> None:
    zero = np.zeros(2)
    with pytest.raises(SingularJointError, match="finger") as caught:
        ghost().estimate(np.zeros((3, 2)), zero, zero)
    assert (caught.value.joint, caught.value.state) == ("finger", 0)
    # It has no effect if it is not measured, or measured with noise; but the variance of its acceleration is
    # undefined.
    assert np.all(ghost().estimate(zero, zero, [0.1, 5.0], measured=["shoulder"]).acceleration != [0.0, 1.0])
    assert np.isfinite(ghost().estimate(zero, zero, [0.1, 5.0], noise=0.5).acceleration).all()
    with pytest.raises(SingularJointError, match="finger"):
        ghost().estimate(zero, zero, zero, measured=["shoulder"], covariance=True)
    assert ghost(0.1).estimate(zero, zero, zero, covariance=True).acceleration_variance[1] == 0.0
    for options in ({}, {"measured": ["shoulder"], "covariance": True}):
        with pytest.raises(ArgumentError, match="not positive definite"):
            ghost().estimate(zero, zero, zero, method="batch", **options)


def call(scene: phipsi.Scene, **replaced: Any) -> phipsi.Estimate:
    q, qd, torque = random_states(scene, 0)
    arguments: dict[str, Any] = {"q": q, "qd": qd, "tau": torque, "noise": 0.5}
    return scene.estimate(**(arguments | replaced))


def test_the_call_is_valid(arm: phipsi.Scene) -> None:
    assert all(np.isfinite(part).all() for part in call(arm, covariance=True))


NAN = np.array([0, 0, np.nan, 0, 0, 0, 0])
BROKEN: dict[str, tuple[dict[str, Any], type[Exception], str]] = {
    "q": ({"q": np.zeros(6)}, ShapeError, "q: found shape (6,); expected (..., 7)"),
    "qd": ({"qd": NAN}, NotFiniteError, "qd: found NaN at index 2"),
    "the former name": ({"torque": np.zeros(7)}, ArgumentError, "torque: found a value; expected tau, the present name"),
    "torque": ({"tau": np.zeros(8)}, ShapeError, "tau: found shape (8,); expected (..., 7)"),
    "torque NaN": ({"tau": NAN}, NotFiniteError, "tau: found NaN at index 2; expected finite numbers"),
    "torque NaN in a batch": ({"tau": [[1.0] * 7, NAN]}, NotFiniteError, "tau: found NaN at index 2 in state 1"),
    "torque text": ({"tau": ["1"] * 7}, ArgumentError, "tau: found dtype <U1"),
    "noise negative": ({"noise": -1.0}, ArgumentError, 'noise: found -1 for joint "joint0"; expected a variance in (N m)^2'),
    "noise of a joint": ({"noise": [1, 1, 1, -2, 1, 1, 1]}, ArgumentError, 'noise: found -2 for joint "joint3"'),
    "noise NaN": ({"noise": NAN}, ArgumentError, 'noise: found NaN for joint "joint2"'),
    "noise shape": ({"noise": np.zeros(3)}, ShapeError, "noise: found shape (3,); expected (..., 7)"),
    "noise bool": ({"noise": True}, ArgumentError, "noise: found dtype bool"),
    "noise None": ({"noise": [None] * 7}, ArgumentError, "noise: found dtype object"),
    "noise overflow": ({"noise": 1e300, "acceleration_variance": 1e-300}, ArgumentError, "noise: found 1e300"),
    "variance zero": ({"acceleration_variance": 0.0}, ArgumentError, "acceleration_variance: found 0; expected a variance of"),
    "variance negative": ({"acceleration_variance": -1.0}, ArgumentError, "acceleration_variance: found -1"),
    "variance NaN": ({"acceleration_variance": np.nan}, ArgumentError, "acceleration_variance: found NaN"),
    "variance infinite": ({"acceleration_variance": np.inf}, ArgumentError, "acceleration_variance: found inf"),
    "prior": ({"prior_acceleration": np.zeros(6)}, ShapeError, "prior_acceleration: found shape (6,); expected (..., 7)"),
    "prior NaN": ({"prior_acceleration": NAN}, NotFiniteError, "prior_acceleration: found NaN at index 2"),
    "unknown joint": ({"measured": ["elbow"]}, ArgumentError, 'measured: found "elbow"; expected one of "joint0", "joint1"'),
    "one unknown joint": ({"measured": "elbow"}, ArgumentError, 'measured: found "elbow"; expected one of "joint0", "joint1"'),
    "mask length": ({"measured": np.ones(6, bool)}, ShapeError, "measured: found shape (6,); expected (7,)"),
    "mask of numbers": ({"measured": np.ones(7)}, ArgumentError, "measured: found array([1."),
    "mask a number": ({"measured": 3}, ArgumentError, "measured: found 3"),
    "method": ({"method": "dense"}, ArgumentError, 'method: found "dense"; expected "sequential" or "batch"'),
    "wrenches": ({"wrenches": {"hand": np.zeros(6)}}, ArgumentError, 'wrenches: found "hand"'),
    "axes": ({"q": np.zeros((3, 7)), "noise": np.ones((2, 7))}, ShapeError, "noise: found shape (2, ...)"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_one_broken_argument(arm: phipsi.Scene, case: str) -> None:
    replaced, error, message = BROKEN[case]
    with pytest.raises(error, match=re.escape(message)):
        call(arm, **replaced)


def test_batch_refuses_large_scenes() -> None:
    builder = phipsi.SceneBuilder().link("base")
    for k in range(301):
        builder.link(f"link{k}", mass=1.0, inertia=np.eye(3))
        builder.joint(f"joint{k}", "revolute", f"link{k - 1}" if k else "base", f"link{k}")
    scene, zero = builder.build(), np.zeros(301)
    assert np.isfinite(scene.estimate(zero, zero, zero).force).all()
    with pytest.raises(ArgumentError, match=re.escape('method: found "batch" for 301 degrees of freedom; expected at most 300')):
        scene.estimate(zero, zero, zero, method="batch")
