"""Identification with knowledge beside the log (the mass of the robot), with outliers, and the explained variance."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from capabilities import build
from test_identify import arm, like, states
from tolerances import assert_near, recursion, size

import phipsi
from phipsi.errors import ArgumentError, LogWarning, ShapeError
from phipsi.estimation import Accumulator


@pytest.mark.parametrize("kind", ["arm", "floating", "mimic", "contacts"])
def test_parameters_of_a_scene_are_those_of_its_regressor(kind: str) -> None:
    scene = {"arm": lambda: arm(0), "floating": lambda: arm(13, 3, base=True), "mimic": lambda: build("mimic", False), "contacts": lambda: build("tree", True)}[kind]()
    draw = np.random.default_rng(0)
    q = scene.integrate(np.broadcast_to(scene.neutral(), (4, scene.nq)), draw.uniform(-1, 1, (4, scene.nv)))
    qd, qdd = draw.uniform(-1, 1, (2, 4, scene.nv))
    assert scene.parameters.shape == (len(scene.body_names), 10)
    tau = np.einsum("kibp,bp->ki", scene.regressor(q, qd, qdd), scene.parameters)
    # The armature of each joint is apart.
    own = scene.inverse_dynamics(q, qd, qdd)
    armature = scene.inverse_dynamics(q, qd, qdd) - scene.with_properties(armature=0.0).inverse_dynamics(q, qd, qdd)
    assert_near(tau, own - armature, 10.0 * recursion(scene.nv, size(tau)))


def test_a_weighed_robot() -> None:
    """The mass of the first link does not act on torques; the sum of masses, which scales measure, determines it."""
    scene = arm(1)
    built = like(scene, 2)
    q, qd, qdd = states(scene, 400)
    tau = built.inverse_dynamics(q, qd, qdd) + 0.05 * np.random.default_rng(0).standard_normal((400, 6))
    total = float(np.sum(built.parameters[:, 0]))
    plain, found = (scene.identify(q, qd, qdd, tau, noise=0.05, total_mass=mass) for mass in (None, (total, 0.01)))
    assert abs(np.sum(plain.parameters[:, 0]) - total) > 0.1
    assert abs(np.sum(found.parameters[:, 0]) - total) < 0.03
    ones = np.zeros((6, 10))
    ones[:, 0] = 1.0
    of_sum = [float(np.sqrt(ones.ravel() @ one.covariance @ ones.ravel())) for one in (plain, found)]
    assert of_sum[0] > 0.3 and 0.005 < of_sum[1] < 0.0101
    # The prediction of torques is that of the log.
    assert_near(found.after, plain.after, 1e-3)
    with pytest.warns(LogWarning, match="no bodies of positive mass explain"):
        kept = scene.identify(q, qd, qdd, tau, noise=0.05, total_mass=(total, 1e-4), keep=["link2"])
    assert abs(np.sum(kept.parameters[:, 0]) - total) < 1e-3
    again = Accumulator(scene, block_length=20).add(q, qd, qdd, tau).identify(noise=0.05, total_mass=(total, 0.01))
    assert_near(again.parameters, found.parameters, 1e-6)


def test_outliers_are_not_used() -> None:
    scene = arm(2, bodies=3)
    built, draw = like(scene, 3), np.random.default_rng(0)
    q, qd, qdd = states(scene, 800)
    exact = built.inverse_dynamics(q, qd, qdd) + 0.4 * qd
    tau = exact + 0.1 * draw.standard_normal((800, 3))
    bad = draw.uniform(size=tau.shape) < 0.01
    spoiled = tau + bad * draw.uniform(5.0, 30.0, tau.shape)
    clean, found, plain = (
        scene.identify(q, qd, qdd, measured, fit=["damping"], outliers=limit) for measured, limit in ((tau, None), (spoiled, 6.0), (spoiled, None))
    )
    assert np.array_equal(found.outliers, bad.sum(axis=0)) and "torques were not used" in str(found)
    assert not plain.outliers.any() and not clean.outliers.any()
    new = states(scene, 50, seed=9)
    errors = [np.sqrt(np.mean((one.torques(*new) - built.inverse_dynamics(*new) - 0.4 * new[1]) ** 2)) for one in (clean, found, plain)]
    assert errors[1] < 1.5 * errors[0] < 0.3 * errors[2]
    assert_near(found.noise, np.full(3, 0.1), 0.015)


def test_explained_variance_of_other_data() -> None:
    scene = arm(2, bodies=3)
    built, draw = like(scene, 3), np.random.default_rng(0)
    q, qd, qdd = states(scene, 600)
    tau = built.inverse_dynamics(q, qd, qdd) + 0.5 * draw.standard_normal((600, 3))
    found = scene.identify(q[:300], qd[:300], qdd[:300], tau[:300])
    tau[400:450, 1], tau[:, 2] = np.nan, np.nan
    shares = found.explained_variance(q[300:], qd[300:], qdd[300:], tau[300:])
    for motor in (0, 1):
        seen = np.isfinite(tau[300:, motor])
        off = (tau[300:] - found.torques(q[300:], qd[300:], qdd[300:]))[seen, motor]
        assert_near(shares[motor], 1.0 - np.mean(off**2) / np.var(tau[300:, motor][seen]), 1e-12)
        assert shares[motor] > 0.5
    assert np.isnan(shares[2])
    with pytest.raises(ShapeError, match=r"tau: found shape \(3,\); expected \(k, 3\)"):
        found.explained_variance(q, qd, qdd, np.zeros(3))


def test_the_identified_robot_is_written_with_its_numbers() -> None:
    scene = arm(2, bodies=3)
    q, qd, qdd = states(scene, 300)
    tau = like(scene, 3).inverse_dynamics(q, qd, qdd) + 0.4 * qd
    found = scene.identify(q, qd, qdd, tau, fit=["damping"], noise=0.01)
    read = phipsi.Scene.from_urdf(found.scene.to_urdf())
    assert_near(read.parameters, found.parameters, 1e-9 * size(found.parameters))
    assert_near(read.damping, list(found.joints["damping"].values()), 1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"total_mass": 3.0}, r"total_mass: found 3.0; expected the mass of all links of body_names and its standard deviation, kg"),
        ({"total_mass": (3.0, 0.0)}, r"total_mass: found \(3.0, 0.0\)"),
        ({"trust": np.inf}, "trust: found inf; expected a finite number above zero"),
        ({"outliers": 1.0}, "outliers: found 1.0; expected a number of standard deviations, at least 2"),
    ],
)
def test_bad_arguments(change: dict[str, Any], message: str) -> None:
    scene = arm(9, bodies=3)
    q, qd, qdd = states(scene, 100)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ArgumentError, match=message):
            scene.identify(q, qd, qdd, scene.inverse_dynamics(q, qd, qdd), noise=0.1, **change)


def test_outliers_of_a_loop_are_refused() -> None:
    scene = build("loop", False)
    zero = np.zeros((10, 4))
    with pytest.raises(ArgumentError, match="outliers: found a scene with connections, which determine sums of the torques"):
        scene.identify(zero, zero, zero, zero, noise=1.0, outliers=5.0)
