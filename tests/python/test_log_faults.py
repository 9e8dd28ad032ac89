"""Ten gross faults of torques, on several robots and joints: none is silent, each warning has the joint, the numbers and the fix; sound logs have none."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from logs import ENCODER, FIT, NOISES, ROBOTS, arm_of_four, arm_of_three, gross_faults, motion, recorded

import phipsi
from phipsi.errors import LogWarning

Array = np.ndarray


def warned(scene: phipsi.Scene, log: dict[str, Array], **given: Any) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene.identify(**log, **given)
    return [str(one.message) for one in caught if one.category is LogWarning]


@pytest.mark.parametrize("robot", ROBOTS)
def test_no_gross_fault_is_silent(robot: str) -> None:
    for name, scene, log, fit in gross_faults(ROBOTS[robot](), 21):
        assert warned(scene, log, fit=fit), name


def at_joint(log: dict[str, Array], change: Callable[[Array], Array]) -> dict[str, Array]:
    return log | {"tau": change(log["tau"].copy())}


def opposed(tau: Array, joint: int) -> Array:
    tau[:, joint] *= -1.0
    return tau


def exchanged(tau: Array, one: int, other: int) -> Array:
    tau[:, [one, other]] = tau[:, [other, one]]
    return tau


@pytest.mark.parametrize("robot", ["three", "arm"])
def test_torques_of_another_unit_or_sign_are_reported(robot: str) -> None:
    scene = ROBOTS[robot]()
    log = recorded(scene, 1)
    for factor in (2.5, 0.02, 0.45):
        (text,) = warned(scene, at_joint(log, lambda tau, factor=factor: factor * tau), fit=FIT)
        found = re.match(r"tau: found torques proportional to those of the model with the factors '\w+': ([\d.]+).*; expected N m or N, with factors of about 1: multiply by", text)
        assert found is not None and 0.6 < float(found[1]) / factor < 1.6, text
    (text,) = warned(scene, at_joint(log, np.negative), fit=FIT)
    assert re.match(r"tau: found torques of the opposite sign of the model's, with the factors '\w+': (-|negative).*; expected 1, .*: change the sign of tau$", text), text


@pytest.mark.parametrize("robot", ["four"])
def test_the_sign_of_each_joint_is_reported(robot: str) -> None:
    """The warning names this joint only."""
    scene = ROBOTS[robot]()
    log = recorded(scene, 2)
    for joint, name in enumerate(scene.joint_names):
        (text,) = warned(scene, at_joint(log, lambda tau, joint=joint: opposed(tau, joint)), fit=FIT)
        assert re.match(rf"tau: found torques of the opposite sign .* '{name}': [^,]*; .*: change the sign of '{name}' in tau$|fit: found residuals of '{name}' .*: check the sign of tau at '{name}'", text), text


@pytest.mark.parametrize("robot", ["four", "arm"])
def test_exchanged_joints_are_reported(robot: str) -> None:
    scene = ROBOTS[robot]()
    log, names = recorded(scene, 3), scene.joint_names
    for one, other in ((0, 1), (1, 2), (0, scene.nv - 1)):
        texts = warned(scene, at_joint(log, lambda tau, one=one, other=other: exchanged(tau, one, other)), fit=FIT)
        assert len(texts) == 1 and texts[0].startswith(f"tau: found torques of '{names[one]}' and '{names[other]}' of which the model explains"), texts
        assert "exchange the two columns of tau" in texts[0]


@pytest.mark.parametrize("robot", ["arm"])
def test_missing_gravity_is_reported(robot: str) -> None:
    scene = ROBOTS[robot]()
    log = recorded(scene, 4)
    (text,) = warned(scene, log | {"tau": log["tau"] - scene.gravity_torque(log["q"])}, fit=FIT)
    assert re.match(r"tau: found torques with -?0\.\d\d of the gravity torque of the model, which is .* at '\w+'; expected 1: add scene.gravity_torque\(q\)", text), text


@pytest.mark.parametrize("delay", [0.3, -0.2, 0.8])
def test_a_long_delay_is_reported_with_its_standard_deviation(delay: float) -> None:
    scene, word = arm_of_four(), "lag" if delay > 0 else "lead"
    (text,) = warned(scene, recorded(scene, 5, delay=delay), fit=FIT)
    found = re.match(rf"tau: found torques that {word} q by ([\d.]+) \+- ([\d.]+) ms: .*; expected one clock for q and tau: tau_delay=(-?[\d.]+) corrects it", text)
    assert found is not None and abs(float(found[1]) - 1e3 * abs(delay)) < 5.0 * float(found[2]) < 20.0, text


def test_the_standard_deviation_of_the_clock_holds() -> None:
    """Over logs with correlated residuals."""
    scene, off = arm_of_three(), []
    for seed in range(12):
        log = recorded(scene, seed, kind=NOISES[seed % 4], noise=0.1, delay=0.003, seconds=10.0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LogWarning)
            found = scene.identify(**log, fit=FIT)
        off.append((found.clock_offset - 0.003) / found.clock_deviation)
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.7 and np.max(np.abs(off)) < 5.0
    assert "+-" in str(found).splitlines()[-1]


@pytest.mark.parametrize("robot", ["four"])
def test_accelerations_by_differences_are_reported(robot: str) -> None:
    scene = ROBOTS[robot]()
    log = recorded(scene, 6)
    time, q = log["time"], log["q"] + ENCODER * np.random.default_rng(0).standard_normal(log["q"].shape)
    qd = np.gradient(q, time, axis=0)
    (text,) = warned(scene, log | {"q": q, "qd": qd, "qdd": np.gradient(qd, time, axis=0)}, fit=FIT)
    assert re.match(r"qdd: found noise at '\w+' of about [\d.]+ rad/s\^2 or m/s\^2, .* % of the inertial torque, which the torques do not follow; expected less than .*: use phipsi.smooth\(time, q\)", text), text
    smoothed = phipsi.smooth(time, q, cutoff=4.0)
    assert not warned(scene, log | {"q": smoothed.q, "qd": smoothed.qd, "qdd": smoothed.qdd}, fit=FIT)


@pytest.mark.parametrize("robot", ["four"])
def test_friction_that_is_not_fitted_is_reported(robot: str) -> None:
    scene = ROBOTS[robot]()
    cases = (
        (scene, recorded(scene, 7, stribeck=0.8), FIT, "stribeck"),
        (scene.with_properties(friction=0.5 * scene.friction), recorded(scene, 8), (), "friction"),
        (scene.with_properties(damping=0.0), recorded(scene, 9), ("friction",), "damping"),
    )
    for model, log, fit, kind in cases:
        texts = warned(model, log, fit=fit)
        named = [re.match(rf"fit: found residuals of '(\w+)' that {kind} of -?[\d.]+ \+- [\d.]+ explains beyond that of the scene, .* % of their variance; expected none: add '{kind}' to fit", text) for text in texts]
        assert any(named), texts
    assert not warned(scene, recorded(scene, 7, stribeck=0.8), fit=(*FIT, "stribeck"), stribeck_speed=0.08)


def test_torques_that_no_bodies_explain_are_reported() -> None:
    """A model whose gravity points up: each torque alone has a factor that is possible."""
    scene = arm_of_three()
    q, qd, qdd = motion(3, np.arange(1000) * 0.01, 3)
    tau = scene.inverse_dynamics(q, qd, qdd) - 2.0 * scene.gravity_torque(q) + scene.damping * qd + scene.friction * qd / np.sqrt(qd**2 + 0.01**2)
    texts = warned(scene, {"q": q, "qd": qd, "qdd": qdd, "tau": tau + 0.02 * np.random.default_rng(0).standard_normal(tau.shape)}, fit=FIT)
    assert texts, "silent"


def test_standing_still_is_no_current() -> None:
    scene = arm_of_three()
    time = np.arange(1000) * 0.01
    q = np.broadcast_to([0.3, -0.2, 0.5], (1000, 3))
    tau = 0.5 * scene.gravity_torque(q) + 0.02 * np.random.default_rng(0).standard_normal((1000, 3))
    assert not warned(scene, {"q": q, "qd": 0.0 * q, "qdd": 0.0 * q, "tau": tau, "time": time}, noise=0.02)


@pytest.mark.parametrize("robot", ROBOTS)
def test_sound_logs_have_no_warning(robot: str) -> None:
    """With residuals of four spectra, of three sizes, exact and smoothed motion."""
    scene = ROBOTS[robot]()
    for seed in range(4):
        log = recorded(scene, 100 + seed, kind=NOISES[seed % 4], noise=(0.005, 0.05, 0.3)[seed % 3], seconds=(10.0, 20.0)[seed % 2])
        if seed % 5 == 0:
            smoothed = phipsi.smooth(log["time"], log["q"] + ENCODER * np.random.default_rng(seed).standard_normal(log["q"].shape), cutoff=6.0)
            log |= {"q": smoothed.q, "qd": smoothed.qd, "qdd": smoothed.qdd}
        assert not warned(scene, log, fit=(FIT, (*FIT, "armature"))[seed % 2]), seed
