"""Scene.identify with transmissions, offsets, Stribeck and load dependent friction: what was put in is found."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from test_identify import arm, like, states
from tolerances import assert_near, size

import phipsi
from phipsi.errors import ArgumentError, IdentificationWarning, ShapeError

#: Motor 3 moves by the sum of two rates, as the last one of many wrists does; motor 2 is geared down and turned.
COUPLED = np.array([[1.0, 0.0, 0.0], [0.0, -2.0, 0.0], [0.0, 1.0, 1.0]])


def rates(qd: np.ndarray, transmission: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motor velocities and smooth signs: friction is viscous below 0.01 rad/s of a joint."""
    v = qd @ transmission.T
    return v, v / np.sqrt(v**2 + (0.01 * np.linalg.norm(transmission, axis=1)) ** 2)


def test_coupled_motors() -> None:
    scene = arm(2, bodies=3)
    built = like(scene, 3)
    q, qd, qdd = states(scene, 600)
    v, s = rates(qd, COUPLED)
    values = {"armature": np.array([0.2, 0.1, 0.05]), "damping": np.array([0.5, 0.3, 0.2]), "friction": np.array([0.4, 0.3, 0.6]), "offset": np.array([0.2, -0.3, 0.1])}
    own = values["armature"] * (qdd @ COUPLED.T) + values["damping"] * v + values["friction"] * s + values["offset"]
    tau = built.inverse_dynamics(q, qd, qdd) @ np.linalg.inv(COUPLED) + own
    with pytest.warns(IdentificationWarning, match=r"transmission: a scene has no armature of joint2\+joint3, damping of joint2\+joint3, friction of joint2\+joint3"):
        found = scene.identify(q, qd, qdd, tau, fit=list(values), noise=1e-3, transmission=COUPLED)
    assert np.all(found.after < 2e-3)
    for kind, value in values.items():
        assert list(found.joints[kind]) == ["joint1", "joint2", "joint2+joint3"]
        # Armature of the first motor is not separate from the inertia about its axis.
        at = slice(1 if kind == "armature" else 0, None)
        assert np.max(np.abs(np.array(list(found.joints[kind].values())) - value)[at]) < 0.01, kind
    # The scene has the parameters of motors that drive one joint, on the joint side of the gear.
    assert_near(found.scene.damping[1], 4 * found.joints["damping"]["joint2"], 1e-12)
    assert_near(found.scene.friction[1], 2 * found.joints["friction"]["joint2"], 1e-12)
    new = states(scene, 50, seed=9)
    v, s = rates(new[1], COUPLED)
    expected = built.inverse_dynamics(*new) @ np.linalg.inv(COUPLED) + values["armature"] * (new[2] @ COUPLED.T)
    expected += values["damping"] * v + values["friction"] * s + values["offset"]
    assert_near(found.torques(*new), expected, 5e-3 * size(expected))
    assert found.torques(*(one[0] for one in new)).shape == (3,)


def test_speeds_of_friction_are_those_of_joints() -> None:
    """A gear of 100 changes the units of the motor and nothing else."""
    scene, gear = arm(2, bodies=3), np.diag([100.0, -50.0, 100.0])
    q, qd, qdd = states(scene, 400)
    qd[::2] *= 0.02
    s = qd / np.sqrt(qd**2 + 0.05**2)
    tau = scene.inverse_dynamics(q, qd, qdd) + 0.5 * s + 0.3 * s * np.exp(-((qd / 0.2) ** 2))
    fit: dict[str, Any] = {"fit": ["friction", "stribeck"], "friction_speed": 0.05, "stribeck_speed": 0.2}
    of_joints = scene.identify(q, qd, qdd, tau, noise=1e-3, **fit)
    of_motors = scene.identify(q, qd, qdd, tau @ np.linalg.inv(gear), noise=1e-3 / np.abs(np.diag(gear)), transmission=gear, **fit)
    assert np.all(of_motors.after * np.abs(np.diag(gear)) < 2e-3)
    assert_near(of_motors.scene.friction, of_joints.scene.friction, 1e-4)
    assert_near(of_motors.scene.friction, np.full(3, 0.5), 1e-3)
    assert_near(of_motors.scene.friction_terms[1:3], of_joints.scene.friction_terms[1:3], 1e-4)


def test_friction_of_joints_beside_that_of_motors() -> None:
    """Motors 2 and 3 move joint 3 together, which has bearings of its own; joint 1 and its motor are one."""
    scene = arm(2, bodies=3)
    q, qd, qdd = states(scene, 800)
    v, s = rates(qd, COUPLED)
    own = 0.3 * s + 0.2 * v + (np.array([0.0, 0.0, 0.7]) * qd / np.sqrt(qd**2 + 0.01**2) + np.array([0.0, 0.0, 0.4]) * qd) @ np.linalg.inv(COUPLED)
    tau = scene.inverse_dynamics(q, qd, qdd) @ np.linalg.inv(COUPLED) + own
    fit = ["friction", "damping", "joint_friction", "joint_damping"]
    with pytest.warns(IdentificationWarning, match=r"friction of joint2\+joint3"):
        found = scene.identify(q, qd, qdd, tau, fit=fit, noise=1e-3, transmission=COUPLED)
        without = scene.identify(q, qd, qdd, tau, fit=fit[:2], noise=1e-3, transmission=COUPLED)
    assert np.all(found.after < 2e-3) and without.after.max() > 0.05
    assert list(found.joints["joint_friction"]) == list(found.joints["joint_damping"]) == ["joint3"]
    assert_near([found.joints["joint_friction"]["joint3"], found.joints["joint_damping"]["joint3"]], [0.7, 0.4], 0.01)
    assert_near(list(found.joints["friction"].values()), np.full(3, 0.3), 0.01)
    assert_near(found.scene.friction[2], 0.7, 0.01)
    # The variance of predicted torques has both.
    new = states(scene, 20, seed=9)
    covariance = found.scene.inverse_dynamics_variance(*new, parameters=found)
    columns = found.parameter_covariance._torques(*new, found.scene)
    assert_near(covariance, np.sum(columns**2, axis=0), 1e-9 * size(covariance))
    assert_near(found.torques_variance(*new), np.sum((columns @ np.linalg.inv(COUPLED)) ** 2, axis=0), 1e-9)
    with pytest.raises(ArgumentError, match="fit: found 'joint_friction' without a transmission; expected 'friction'"):
        scene.identify(q, qd, qdd, tau, fit=["joint_friction"], noise=1.0)


def test_without_the_coupling_the_residual_is_larger() -> None:
    """So that the coupling is what explains the torques."""
    scene = arm(2, bodies=3)
    q, qd, qdd = states(scene, 600)
    v, s = rates(qd, COUPLED)
    tau = (scene.inverse_dynamics(q, qd, qdd) @ np.linalg.inv(COUPLED) + 0.5 * v + 0.6 * s) @ COUPLED
    found = scene.identify(q, qd, qdd, tau, fit=["damping", "friction"], noise=1e-2)
    assert found.after[1] > 0.1


def test_noise_is_that_of_motors() -> None:
    scene, sigma = arm(2, bodies=3), np.array([0.3, 0.1, 0.02])
    q, qd, qdd = states(scene, 3000)
    tau = scene.inverse_dynamics(q, qd, qdd) @ np.linalg.inv(COUPLED) + sigma * np.random.default_rng(0).standard_normal((3000, 3))
    found = scene.identify(q, qd, qdd, tau, transmission=COUPLED)
    assert_near(found.noise / sigma, np.ones(3), 0.1)


@pytest.mark.parametrize(("kind", "value"), [("offset", -0.7), ("offset", 0.7), ("stribeck", 0.4), ("load", 0.08)])
def test_other_friction(kind: str, value: float) -> None:
    scene = arm(9, bodies=3)
    built = like(scene, 10)
    draw = np.random.default_rng(3)
    q, qd, qdd = states(scene, 1500)
    # Slow motion too, where Stribeck friction is.
    qd[::2] = 0.2 * draw.standard_normal((750, 3))
    s = qd / np.sqrt(qd**2 + 0.01**2)
    own = {"offset": np.ones_like(qd), "stribeck": s * np.exp(-((qd / 0.1) ** 2)), "load": s * np.abs(built.inverse_dynamics(q, qd, qdd))}[kind]
    tau = built.inverse_dynamics(q, qd, qdd) + value * own + 0.3 * s
    found = scene.identify(q, qd, qdd, tau, fit=["friction", kind], noise=1e-3)
    assert_near(np.array(list(found.joints[kind].values())), np.full(3, value), 0.05 * abs(value))
    assert_near(np.array(list(found.joints["friction"].values())), np.full(3, 0.3), 0.05)
    assert set(found.joint_deviations) == {"friction", kind} and all(0 < x < 1 for x in found.joint_deviations[kind].values())


GOOD: dict[str, Any] = {"noise": 0.1, "transmission": COUPLED}


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        ({"transmission": np.eye(2)}, ShapeError, r"transmission: found shape \(2, 2\); expected \(3, 3\)"),
        ({"transmission": np.zeros((3, 3))}, ArgumentError, "transmission: found a matrix that is not finite or has no inverse"),
        ({"fit": ["stickiness"]}, ArgumentError, "fit: found 'stickiness'; expected names of armature, damping, friction, offset, stribeck, load"),
        ({"stribeck_speed": 0.0}, ArgumentError, "stribeck_speed: found 0.0"),
        ({"tau_delay": 0.1}, ArgumentError, "tau_delay: found 0.1 without time"),
        ({"acceleration_noise": -1.0}, ArgumentError, "acceleration_noise: found -1.0"),
        ({"blocks": 1}, ArgumentError, "blocks: found 1"),
        ({"instruments": (np.zeros((9, 3)),) * 3}, ShapeError, "instruments: found no three arrays of 100 states"),
    ],
)
def test_bad_arguments(change: dict[str, Any], kind: type[Exception], message: str) -> None:
    scene = arm(9, bodies=3)
    q, qd, qdd = states(scene, 100)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(kind, match=message):
            scene.identify(q, qd, qdd, scene.inverse_dynamics(q, qd, qdd), **(GOOD | change))


def test_a_transmission_of_a_floating_base_is_refused() -> None:
    scene = arm(9, bodies=2, base=True)
    q = np.tile(scene.neutral(), (50, 1))
    with pytest.raises(ArgumentError, match="transmission: found a scene with joint 'root_joint' of several degrees of freedom"):
        scene.identify(q, np.zeros((50, 8)), np.zeros((50, 8)), np.zeros((50, 8)), transmission=np.eye(8), noise=1.0)
    assert isinstance(scene, phipsi.Scene)
