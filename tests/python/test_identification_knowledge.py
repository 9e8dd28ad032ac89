"""Identification with knowledge beside the log (mass, priors of links), outliers, asymmetric friction, and residuals."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from capabilities import build
from test_identify import arm, like, states
from tolerances import assert_near, recursion, size

import phipsi
from phipsi.errors import ArgumentError, IdentificationWarning, LogWarning, ShapeError
from phipsi.estimation import Accumulator
from phipsi.estimation._most_probable import most_probable
from phipsi.estimation._problem import Problem


@pytest.mark.parametrize("kind", ["arm", "floating", "mimic", "contacts"])
def test_parameters_of_a_scene_are_those_of_its_regressor(kind: str) -> None:
    scene = {"arm": lambda: arm(0), "floating": lambda: arm(13, 3, base=True), "mimic": lambda: build("mimic", False), "contacts": lambda: build("tree", True)}[kind]()
    draw = np.random.default_rng(0)
    q = scene.integrate(np.broadcast_to(scene.neutral(), (4, scene.nq)), draw.uniform(-1, 1, (4, scene.nv)))
    qd, qdd = draw.uniform(-1, 1, (2, 4, scene.nv))
    assert scene.inertial_parameters.shape == (len(scene.body_names), 10)
    tau = np.einsum("kibp,bp->ki", scene.regressor(q, qd, qdd), scene.inertial_parameters)
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
    total = float(np.sum(built.inertial_parameters[:, 0]))
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
    assert_near(read.inertial_parameters, found.parameters, 1e-9 * size(found.parameters))
    assert_near(read.damping, list(found.joints["damping"].values()), 1e-12)


def test_each_link_has_its_own_trust() -> None:
    """A mapping is the array of the weights, equal weights are a scalar, and a trusted link keeps its parameters."""
    scene = arm(1, bodies=3)
    q, qd, qdd = states(scene, 300)
    tau = like(scene, 2).inverse_dynamics(q, qd, qdd) + 0.1 * np.random.default_rng(0).standard_normal((300, 3))
    found = {name: scene.identify(q, qd, qdd, tau, noise=0.1, trust=trust) for name, trust in {
        "mapping": {"link2": 1e9}, "array": [1.0, 1e9, 1.0], "all": {"link1": 2.5, "link2": 2.5, "link3": 2.5}, "scalar": 2.5, "one": 1.0,
    }.items()}  # fmt: skip
    assert_near(found["mapping"].own, found["array"].own, 1e-12)
    assert_near(found["all"].own, found["scalar"].own, 1e-9)
    # Relative errors of a prior are about 1/sqrt(trust), and the data pull with 1/noise^2 = 100 each.
    off, plain = (np.abs(found[name].parameters[1] - scene.inertial_parameters[1]).max() for name in ("mapping", "one"))
    assert 0.0 < off < 0.2 * plain
    assert found["mapping"].deviations[1, 0] < 1e-3 < found["one"].deviations[1, 0]


@pytest.mark.parametrize("decades", [3, 6])
def test_weights_that_differ_by_orders_of_magnitude(decades: int) -> None:
    """The gradient of the definition, in standard deviations of the result, is zero for priors of any weights."""
    scene = arm(1, bodies=4)
    q, qd, qdd = states(scene, 200)
    draw = np.random.default_rng(0)
    tau = like(scene, 2).inverse_dynamics(q, qd, qdd) + 0.3 * qd + 0.2 * np.sign(qd) + 0.05 * draw.standard_normal((200, 4))
    problem = Problem(Accumulator(scene, fit=["damping", "friction"], block_length=20).add(q, qd, qdd, tau))
    rows, target = problem.least_squares(np.full(4, 0.05))
    triangle, upper = rows @ problem.to_own, np.triu_indices(4)
    for _ in range(5):
        trust = 10.0 ** draw.uniform(-decades, decades, 12)
        z, root = most_probable(triangle, target, trust, 4)
        gradient = triangle.T @ (triangle @ z - target)
        gradient[40:] += 0.5 * trust[4:] * (1.0 - 1.0 / z[40:])
        for body in range(4):
            moments = np.zeros((4, 4))
            moments[upper] = z[10 * body : 10 * body + 10]
            moments = moments + np.triu(moments, 1).T
            change = 0.5 * trust[body] * (np.eye(4) - np.linalg.inv(moments))
            gradient[10 * body : 10 * body + 10] += ((2.0 - np.eye(4)) * change)[upper]
        assert np.linalg.norm(root.T @ gradient) < 1e-3


def test_asymmetric_friction_is_found_and_named() -> None:
    scene = arm(1, bodies=3)
    q, qd, qdd = states(scene, 400)
    sign, fit = qd / np.sqrt(qd**2 + 0.01**2), ["damping", "friction", "friction_asymmetry", "damping_asymmetry"]
    truth = dict(zip(fit, (0.3, 0.5, 0.2, -0.1), strict=True))
    exact = like(scene, 2).inverse_dynamics(q, qd, qdd) + 0.5 * sign + 0.2 * np.abs(sign) + 0.3 * qd - 0.1 * np.abs(qd)
    tau = exact + 0.02 * np.random.default_rng(0).standard_normal((400, 3))
    with pytest.warns(IdentificationWarning, match="fit: a scene has no friction_asymmetry of joint1, .*damping_asymmetry of joint3; its friction is the same in both directions"):
        found = scene.identify(q, qd, qdd, tau, fit=fit)
    for kind, value in truth.items():
        for name, estimate in found.joints[kind].items():
            assert abs(estimate - value) < 5.0 * found.joint_deviations[kind][name] < 0.05
    assert np.abs(found.torques(q, qd, qdd) - exact).max() < 0.03
    assert np.all(found.torques_variance(q, qd, qdd) < 0.01**2) and not any(found.marks()[1]["friction_asymmetry"].values())
    with pytest.raises(ArgumentError, match="parameters: found friction_asymmetry of 'joint1'; expected armature, damping, friction and offsets"):
        scene.simulate(q[0], qd[0], dt=1e-3, steps=1, covariance=found)
    # Friction that accelerates the joint in one direction is marked.
    with pytest.warns(IdentificationWarning):
        odd = scene.identify(q, qd, qdd, tau - 0.4 * sign, fit=fit, noise=0.02)
    assert set(odd.marks()[1]["friction_asymmetry"].values()) == {"!"}


@pytest.mark.parametrize("fit", [["stribeck"], ["stribeck", "friction"]])
def test_friction_at_rest_below_zero_is_named(fit: list[str]) -> None:
    """A scene cannot have it: the estimate stays, with a mark, and the scene has the nearest value."""
    scene = arm(1, bodies=3).with_properties(friction={"joint2": 0.1})
    q, qd, qdd = states(scene, 400)
    sign = qd / np.sqrt(qd**2 + 0.01**2)
    tau = scene.inverse_dynamics(q, qd, qdd) + sign * (0.1 - 0.4 * np.exp(-((qd / 0.5) ** 2)))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = scene.identify(q, qd, qdd, tau, fit=fit, stribeck_speed=0.5, noise=0.02)
    assert any("fit: found stribeck of 'joint1' of" in str(one.message) and "friction at rest is below zero" in str(one.message) for one in caught)
    dry, stribeck = (np.array([found.joints.get(kind, {}).get(name, own) for name, own in zip(scene.joint_names, values, strict=True)]) for kind, values in (("friction", scene.friction), ("stribeck", np.zeros(3))))
    assert np.all(dry + stribeck < 0.0)
    assert_near(found.scene.friction_terms[1], -dry, 1e-12)
    assert all("!" in mark for mark in found.marks()[1]["stribeck"].values())


def test_residuals_and_report(tmp_path: Path) -> None:
    scene = arm(2, bodies=3)
    q, qd, qdd = states(scene, 400)
    tau = like(scene, 3).inverse_dynamics(q, qd, qdd) + np.random.default_rng(0).standard_normal((400, 3))
    found = scene.identify(q[:300], qd[:300], qdd[:300], tau[:300])
    tau[350, 1] = np.nan
    off = found.residuals(q, qd, qdd, tau)
    assert np.isnan(off[350, 1]) and np.isnan(off).sum() == 1
    assert_near(np.nan_to_num(off), np.nan_to_num(tau - found.torques(q, qd, qdd)), 1e-12)
    page = found.report(tmp_path / "arm & co.html", q, qd, qdd, tau, time=0.01 * np.arange(400), fitted=300)
    text = page.read_text(encoding="utf-8")
    for words in ("arm &amp; co", "The last 100 of 400 states were not fitted", "autocorrelation", "mean by speed", "model before", 'id="plot-residuals"', 'id="plot-spectrum"'):
        assert words in text
    with pytest.raises(ArgumentError, match="fitted: found 401; expected at most 400"):
        found.report(page, q, qd, qdd, tau, fitted=401)
    with pytest.raises(ShapeError, match=r"tau: found shape \(3,\); expected \(k, 3\)"):
        found.report(page, q, qd, qdd, np.zeros(3))


def test_the_residuals_of_a_loop_are_those_that_its_motions_feel() -> None:
    scene = build("loop", False)
    draw = np.random.default_rng(0)
    q = scene.loops.project(scene.integrate(np.broadcast_to(scene.neutral(), (60, scene.nq)), draw.uniform(-0.3, 0.3, (60, scene.nv)))).q
    qd = scene.loops.project(q, draw.uniform(-1, 1, q.shape)).qd
    qdd = scene.forward_dynamics(q, qd, draw.uniform(-1, 1, q.shape))
    tau = scene.inverse_dynamics(q, qd, qdd) + scene.damping * qd
    found = scene.identify(q, qd, qdd, tau, noise=0.01)
    # Forces of the connection do no work on them.
    forces = np.einsum("kij,kj->ki", np.eye(scene.nv) - scene.mass_matrix(q) @ scene.loops.mass_matrix_inverse(q), draw.uniform(-5, 5, q.shape))
    assert np.abs(found.residuals(q, qd, qdd, tau + forces)).max() < 0.01
    assert np.all(found.explained_variance(q, qd, qdd, tau + forces) > 0.99)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"trust": {"link9": 2.0}}, "trust: found 'link9', no link of body_names; expected names of links to identify"),
        ({"trust": {"link1": 2.0}, "keep": ["link1"]}, "trust: found 'link1', a link in keep"),
        ({"trust": [1.0, 1e-7, 1.0]}, "trust: found 1e-07; expected weights of 1e-06 to 1e\\+09"),
        ({"trust": [1.0, -1.0, 1.0]}, "trust: found -1.0; expected finite numbers above zero, one for each link"),
        ({"trust": 1e20}, "trust: found 1e\\+20; expected a weight of 1e-15 to 1e\\+15"),
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
